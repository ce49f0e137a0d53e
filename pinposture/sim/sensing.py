"""What the arm's sensors tell of it: never quite what is true, and never at once."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pinposture._validation import require_positive, require_share, require_whole

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Sensing:
    """How joint positions are measured; perfect unless told otherwise.

    Attributes:
        noise: standard deviation of each measurement [rad or m].
        resolution: what a measurement is a multiple of [rad or m]; 0 for any number.
        dropped: share of the cycles in which no measurement arrives.
        latency: how many cycles old a measurement is.
        seed: what noise and losses are drawn from.
    """

    noise: float = 0.0
    resolution: float = 0.0
    dropped: float = 0.0
    latency: int = 0
    seed: int = 0

    def __post_init__(self) -> None:
        require_positive("noise", self.noise, zero=True)
        require_positive("resolution", self.resolution, zero=True)
        require_share("dropped", self.dropped)
        require_whole("latency", self.latency, 0)
        require_whole("seed", self.seed, 0)


class Sensors:
    """Sensors of an arm under way."""

    def __init__(self, sensing: Sensing) -> None:
        self._sensing = sensing
        self._rng = np.random.default_rng(sensing.seed)
        self._kept: deque[Array] = deque(maxlen=sensing.latency + 1)

    def measure(self, positions: Array) -> Array | None:
        """What arrives in this cycle, (nv,) [rad or m]; None if nothing does.

        Args:
            positions: where the joints are, (nv,) [rad or m].
        """
        sensing = self._sensing
        told = positions + sensing.noise * self._rng.standard_normal(len(positions))
        if sensing.resolution > 0.0:
            told = sensing.resolution * np.round(told / sensing.resolution)
        self._kept.append(told)
        # Until the first has come through, the oldest there is stands for it: the arm was at rest.
        return None if self._rng.random() < sensing.dropped else self._kept[0]
