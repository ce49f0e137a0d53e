"""Ways to read the thesis where it leaves a choice, and the runs of one reading."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from pinposture.study.reproduce.runs import MeasuredRun, Pool
from pinposture.thesis.scenarios import SCENARIOS

DEFAULT = "as built"

_METHODS = {name: name for name in ("selection", "projection", "switching")}

READINGS: Mapping[str, Mapping[str, str]] = {
    DEFAULT: _METHODS,
    "(5.9) as printed": _METHODS | {"projection": "projection, local"},
    "(4.8) as printed": _METHODS | {"selection": "selection, (4.8)"},
    "Figure 4.8 alone": _METHODS | {"switching": "switching, no waypoints"},
    "joints without limits": _METHODS
    | {"selection": "selection, free joints", "projection": "projection, free joints"},
}
"""Which variant stands for a method, by reading.

The posture control matrix (5.9) and the score (4.8) of a planar arm are built otherwise than printed, for
better, and switching has waypoints beyond Figure 4.8. The thesis does not say whether its joints have limits;
those of the arms here end at +-pi."""


class Reading(NamedTuple):
    """The runs of one reading.

    Attributes:
        pool: runs by scenario and variant.
        variants: the variant of each method.
    """

    pool: Pool
    variants: Mapping[str, str]

    def concerns(self, methods: Sequence[str]) -> bool:
        """Whether this reading has anything of its own to say about methods; the default one has."""
        return any(self._own(method) for method in methods) or self._is_default

    @property
    def _is_default(self) -> bool:
        return self.variants == READINGS[DEFAULT]

    def _own(self, method: str) -> bool:
        return self._is_default or self.variants[method] != method

    def runs(self, scenario: str, method: str) -> Sequence[MeasuredRun]:
        """Runs of a scenario by a method, by seed; none if this reading did not try it."""
        return self.pool.get((scenario, self.variants[method]), ())

    def each(self, scenarios: Sequence[str], methods: Sequence[str]) -> dict[str, Sequence[MeasuredRun]]:
        """Runs by "arm, scenario, method" in words, where there are any that are this reading's own."""
        found = {label(s, m): self.runs(s, m) for s in scenarios for m in methods if self._own(m)}
        return {name: runs for name, runs in found.items() if runs}

    def pairs(
        self, scenarios: Sequence[str], one: str, other: str
    ) -> dict[str, list[tuple[MeasuredRun, MeasuredRun]]]:
        """Runs of two methods on the same seeds, by "arm, scenario" in words, where there are any."""
        found = {label(s): list(zip(self.runs(s, one), self.runs(s, other), strict=False)) for s in scenarios}
        return {name: runs for name, runs in found.items() if runs}


def label(scenario: str, method: str = "") -> str:
    """What was tried, in words."""
    about = SCENARIOS[scenario]
    arm = "planar" if about.arm == "planar45" else "spatial"
    return ", ".join(filter(None, (arm, about.title, method)))


def median(values: Sequence[float] | np.ndarray) -> float:
    """The median; 0 of nothing, since a table has no place for what is not a number."""
    return float(np.median(values)) if len(values) else 0.0
