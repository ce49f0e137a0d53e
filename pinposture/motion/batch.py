"""The result of many runs of one arm: how each ended, and the motions."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pinposture.arm import Arm
from pinposture.control import Limits
from pinposture.control.checks import is_whole
from pinposture.errors import InvalidValue
from pinposture.motion.batch_motions import Motions
from pinposture.motion.ending import ROUNDING
from pinposture.motion.trajectory import Trajectory
from pinposture.scene import Scene
from pinposture.target import Target

Array = NDArray[np.float64]

FAILED = "failed"
"""Status of a run that an error ended."""


@dataclass(frozen=True, eq=False)
class Batch:
    """Many runs of one arm, in the order in which they were asked for.

    `batch[i]` is run i as a `Trajectory`, from 0, if the motions were kept; `len(batch)` their number, called
    count below.

    A run that failed is one that an error ended, for instance because the controller does not take such a
    target: it has the status "failed", the error for a reason, no steps, and ends where it began.

    Attributes:
        arm: the arm that moved.
        targets: the target posture of each run, or the one of all.
        controller: the controller and its parameters, in words.
        limits: what a step could not exceed.
        scene: what the arm was to keep clear of; None if nothing.
        max_steps: number of steps after which a run stopped.
        tolerance: mean point error at which a run had converged [m].
        status: as `Trajectory.status`, or "failed", (count,).
        reason: why each run ended, in words, (count,).
        steps: number of steps, (count,).
        start_error: posture error at the start, (count,) [m].
        final_error: posture error at the end, (count,) [m].
        mean_error: mean distance at the end of the control points that have a target from it, (count,) [m].
        sweep: length of the paths of all control points relative to the direct distances, (count,).
        clearance: smallest distance to an obstacle, or between parts of the arm, (count,) [m]; negative
            in penetration, infinite where there was no scene.
        q_start: configurations at the start, (count, nq).
        q_final: configurations at the end, (count, nq).
        motions: the whole motions, one behind the other; None if only the ends were kept.
    """

    arm: Arm
    targets: tuple[Target, ...]
    controller: str
    limits: Limits
    scene: Scene | None
    max_steps: int
    tolerance: float
    status: NDArray[np.str_]
    reason: NDArray[np.str_]
    steps: NDArray[np.intp]
    start_error: Array
    final_error: Array
    mean_error: Array
    sweep: Array
    clearance: Array
    q_start: Array
    q_final: Array
    motions: Motions | None = None

    def __post_init__(self) -> None:
        for value in vars(self).values():
            if isinstance(value, np.ndarray):
                value.flags.writeable = False

    def __len__(self) -> int:
        return len(self.status)

    def __getitem__(self, number: int) -> Trajectory:
        number = self._checked(number)
        if self.motions is None:
            allowed = 'keep="motions" in track_many, to have whole motions; q_start and q_final are here'
            raise InvalidValue("what was kept", "ends", allowed)
        target = self.target(number)
        return Trajectory(
            arm=self.arm,
            target=target,
            controller=self.controller,
            limits=self.limits,
            status=str(self.status[number]),
            reason=str(self.reason[number]),
            scene=self.scene,
            **self.motions.arrays_of(number, self.arm, target),
        )

    def __iter__(self) -> Iterator[Trajectory]:
        return (self[number] for number in range(len(self)))

    def _checked(self, number: int) -> int:
        # IndexError, not one of our own: it is what a sequence raises, and what ends loops over one.
        if not is_whole(number):
            raise TypeError(f"runs have whole numbers, not {number!r}")
        if not -len(self) <= number < len(self):
            raise IndexError(f"run {number} of {len(self)}")
        return int(number) % len(self)

    def target(self, number: int) -> Target:
        """The target posture of one run."""
        return self.targets[self._checked(number) if len(self.targets) > 1 else 0]

    @property
    def converged(self) -> NDArray[np.bool_]:
        """Which runs brought the mean point error within the tolerance, (count,)."""
        return np.asarray(self.status == "converged")

    @property
    def faults(self) -> tuple[str, ...]:
        """What went wrong in some of the runs, in words; empty if nothing did."""
        away, inside = (
            np.flatnonzero(~self.converged),
            np.flatnonzero(self.clearance < -ROUNDING * self.arm.length),
        )
        found = []
        if len(away):
            found.append(f"{len(away)} of {len(self)} runs did not get there")
        if len(inside):
            deepest = int(self.clearance.argmin())
            depth = f"{-1e3 * self.clearance[deepest]:.3g} mm in run {deepest}"
            found.append(f"in {len(inside)} runs something was inside of another, at most {depth}")
        return tuple(found)

    @property
    def verdict(self) -> str:
        """What to think of it, in one line."""
        return "; ".join(self.faults) or f"got there in all {len(self)} runs"

    def to_dict(self) -> dict[str, Any]:
        """The batch in numbers that JSON can hold, without the configurations; lengths in metres."""
        runs = [
            {
                "status": str(self.status[k]),
                "reason": str(self.reason[k]),
                "steps": int(self.steps[k]),
                "start_error": float(self.start_error[k]),
                "final_error": float(self.final_error[k]),
                "mean_error": float(self.mean_error[k]),
                "path_excess": float(self.sweep[k]),
                "clearance": None if self.scene is None else float(self.clearance[k]),
            }
            for k in range(len(self))
        ]
        return {
            "verdict": self.verdict,
            "count": len(self),
            "statuses": dict(Counter(self.status.tolist()).most_common()),
            "controller": self.controller,
            "arm_length": self.arm.length,
            "control_points": self.arm.n_modules,
            "max_steps": self.max_steps,
            "tolerance": self.tolerance,
            "moved": [None if each.moved is None else each.moved._asdict() for each in self.targets],
            "runs": runs,
        }

    def in_words(self) -> dict[str, str]:
        """What came of it, as a person reads it: names, and what there is to say."""
        ends = ", ".join(f"{n} {status}" for status, n in Counter(self.status.tolist()).most_common())
        words = {
            "verdict": self.verdict,
            "runs": f"{len(self)}: {ends}",
            "steps": _spread(self.steps, ".0f"),
            "mean error": f"{_spread(self.mean_error, '.2g')} m for each point, "
            f"{self.mean_error.max() / self.arm.length:.2g} of the arm length",
            "paths": f"of control points {_spread(self.sweep, '.3g')} times as long as straight ones",
        }
        moved = [each.moved for each in self.targets if each.moved]
        far = max(moved, key=attrgetter("distance"), default=None)
        if far is not None:
            words["curve"] = f"{far} to the base of the arm" + (" at most" if len(self.targets) > 1 else "")
        if self.scene is not None:
            words["clearance"] = f"{self.clearance.min():.4g} m where it is smallest, in run " + (
                f"{int(self.clearance.argmin())}; the margin is {self.scene.margin:.4g} m"
            )
        if not self.converged.all():
            worst = int(np.where(self.converged, -1.0, self.mean_error).argmax())
            words["worst"] = f"run {worst}, {self.status[worst]}: {self.reason[worst]}"
        failed = np.flatnonzero(self.status == FAILED)
        if len(failed):
            words["failed"] = f"{len(failed)}, run {failed[0]} first: {self.reason[failed[0]]}"
        return words

    def summary(self) -> str:
        """What came of it in a few lines."""
        words = self.in_words()
        width = max(map(len, words))
        return "\n".join(f"{name:{width}}  {text}" for name, text in words.items())

    def save(self, path: str | Path) -> Path:
        """Write the batch to one `.npz` file, all or nothing; it embeds the arm and the curves.

        Args:
            path: the file; ".npz" is added to a name without ending.

        Returns:
            The path written.

        Raises:
            FileError: the name has another ending, or the file cannot be written.
        """
        from pinposture.motion.batch_files import save_batch

        return save_batch(self, Path(path))

    @classmethod
    def load(cls, path: str | Path) -> Batch:
        """Read a batch that `save` wrote.

        Raises:
            FileError: the file is missing, or is not such a batch.
        """
        from pinposture.motion.batch_files import load_batch

        return load_batch(Path(path))

    def __repr__(self) -> str:
        kept = "ends" if self.motions is None else "motions"
        return f"Batch({len(self)} runs, {self.converged.sum()} converged, {kept} kept)"


def _spread(values: NDArray[Any], form: str) -> str:
    """Median and largest."""
    return f"{np.median(values):{form}} (median), at most {values.max():{form}}"
