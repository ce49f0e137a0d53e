"""Many motions of one arm, one behind the other in the same arrays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pinposture.arm import Arm
from pinposture.motion.trajectory import Trajectory
from pinposture.target import Target

Array = NDArray[np.float64]
Text = NDArray[np.intp]

CONFIGURATION_ARRAYS = ("q", "clearance")
STEP_ARRAYS = ("active", "index", "sigma_min", "sigma_max", "rows", "scale", "clipped", "escape")
TEXT_ARRAYS = ("method", "switched", "relaxed")


@dataclass(frozen=True, eq=False)
class Motions:
    """The whole motions of a batch of `count` runs; ragged, since some take more steps than others.

    Run i has the configurations `offsets[i]` to `offsets[i + 1] - 1`, the first of which is its start. It has
    one step less, so its steps begin at `offsets[i] - i`. The arrays are those of `Trajectory`; what its
    texts say is listed once in `texts`, and steps have the number of theirs. Points and their errors are not
    kept: they follow from q.

    Attributes:
        offsets: where each run begins, and where the last one ends, (count + 1,).
        q: configurations, (all configurations, nq).
        clearance: smallest distances, (all configurations,) [m]; infinite where there was no scene.
        active: which control points were active, (all steps, m).
        index: smallest manipulability index that the active set had to clear, (all steps,).
        sigma_min: smallest singular value of the posture control matrix, (all steps,) [m/rad].
        sigma_max: its largest singular value, (all steps,) [m/rad].
        rows: its rows, (all steps,).
        scale: factor by which the step was shortened to meet the step limit, (all steps,).
        clipped: which joints were cut short at a position limit, (all steps, nv).
        escape: whether the step was meant to lead out of a place where the error cannot fall, (all steps,).
        method: which of its methods the controller used, number of the text, (all steps,).
        switched: why it changed to that method, number of the text, (all steps,).
        relaxed: which constraints gave way, number of the text, (all steps,).
        texts: what the texts say.
    """

    offsets: NDArray[np.intp]
    q: Array
    clearance: Array
    active: NDArray[np.bool_]
    index: Array
    sigma_min: Array
    sigma_max: Array
    rows: NDArray[np.intp]
    scale: Array
    clipped: NDArray[np.bool_]
    escape: NDArray[np.bool_]
    method: Text
    switched: Text
    relaxed: Text
    texts: tuple[str, ...]

    def __post_init__(self) -> None:
        for value in vars(self).values():
            if isinstance(value, np.ndarray):
                value.flags.writeable = False

    def arrays_of(self, number: int, arm: Arm, target: Target) -> dict[str, NDArray[Any]]:
        """The arrays of a `Trajectory`: those of one run.

        Args:
            number: which run, from 0.
            arm: the arm that moved.
            target: where its control points should have been.
        """
        whole = slice(int(self.offsets[number]), int(self.offsets[number + 1]))
        steps = slice(whole.start - number, whole.stop - number - 1)
        arrays: dict[str, NDArray[Any]] = {name: getattr(self, name)[whole] for name in CONFIGURATION_ARRAYS}
        arrays |= {name: getattr(self, name)[steps] for name in STEP_ARRAYS}
        for name in TEXT_ARRAYS:
            arrays[name] = np.array([self.texts[k] for k in getattr(self, name)[steps]], dtype=np.str_)
        arrays["points"] = np.array([arm.at(q).points for q in arrays["q"]])
        distances = np.linalg.norm(target.points - arrays["points"], axis=2)
        arrays["point_errors"] = distances * target.placed
        return arrays


def recorded(run: Trajectory) -> dict[str, NDArray[Any]]:
    """What `gathered` needs of a run."""
    return {name: getattr(run, name) for name in CONFIGURATION_ARRAYS + STEP_ARRAYS + TEXT_ARRAYS}


def gathered(runs: Sequence[dict[str, NDArray[Any]]]) -> Motions:
    """The motions of at least one run, each as `recorded` gave it, in their order."""
    sizes = [len(run["q"]) for run in runs]
    stacked: dict[str, Any] = {
        name: np.concatenate([run[name] for run in runs]) for name in CONFIGURATION_ARRAYS + STEP_ARRAYS
    }
    numbers: dict[str, int] = {}
    for name in TEXT_ARRAYS:
        # A text for each step would be as wide as the longest of all runs; nearly all are empty or the same.
        said = (str(text) for run in runs for text in run[name])
        stacked[name] = np.array([numbers.setdefault(text, len(numbers)) for text in said], dtype=np.intp)
    offsets = np.concatenate([[0], np.cumsum(sizes)]).astype(np.intp)
    return Motions(offsets=offsets, texts=tuple(numbers), **stacked)
