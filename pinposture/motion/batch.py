"""The results of many runs."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from operator import attrgetter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pinposture._validation import is_whole, make_read_only
from pinposture.arm import Arm
from pinposture.collision import Scene
from pinposture.control import Limits
from pinposture.errors import InvalidValue
from pinposture.motion.run import (
    CONFIGURATION_ARRAYS,
    CONTACT_TOLERANCE,
    RAISE_STEPS,
    STEP_ARRAYS,
    Arrays,
    Run,
    info_of,
)
from pinposture.placement import Target
from pinposture.units import error_text, length_text

Array = NDArray[np.float64]

FAILED = "failed"
"""Status of a run that an error ended."""


@dataclass(frozen=True, eq=False)
class Batch:
    """Many runs of one arm, in the order of their starts and targets.

    `batch[i]` is run i as a `Run`, 0-based, if the motions were kept; `len(batch)` is the number of
    runs, count below.

    A run that an error ends, for instance because the controller does not support its target, has the status
    "failed", the error as its reason, and no steps.

    Attributes:
        arm: the arm that moved.
        targets: the target posture of each run, or a single one for all.
        controller: name and parameters of the controller.
        limits: the limits of each step.
        scene: the obstacles; None: none.
        max_steps: largest number of steps after which a run stopped.
        tolerance: mean point error at which a run converged [m].
        status: as `Run.status`, or "failed", (count,).
        reason: why each run ended, (count,).
        steps: number of steps, (count,).
        start_error: posture error at the start, (count,) [m].
        final_error: posture error at the end, (count,) [m].
        mean_error: mean distance of the control points from their targets at the end, (count,) [m].
        path_length_ratio: length of the paths of all control points relative to the direct distances,
            (count,).
        clearance: smallest distance to an obstacle, or between parts of the arm, (count,) [m]; negative
            in penetration. Without a scene, that between parts of the arm.
        closest: names of the two that are that close, joined by "and", (count,); "" if there are none.
        q_start: configurations at the start, (count, nq).
        q_final: configurations at the end, (count, nq).
        motions: the arrays of each run, as `run_arrays` returns them; None if only the ends were kept.
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
    path_length_ratio: Array
    clearance: Array
    closest: NDArray[np.str_]
    q_start: Array
    q_final: Array
    motions: tuple[Arrays, ...] | None = None

    def __post_init__(self) -> None:
        make_read_only(*vars(self).values())
        for arrays in self.motions or ():
            make_read_only(*arrays.values())

    def __len__(self) -> int:
        return len(self.status)

    def __getitem__(self, number: int) -> Run:
        number = self._checked_number(number)
        if self.motions is None:
            allowed = '"motions" in track_many; the ends alone are in q_start and q_final'
            raise InvalidValue("keep", "ends", allowed)
        target = self.target(number)
        arrays = self.motions[number]
        points = np.array([self.arm.chain_at(q).points for q in arrays["q"]])
        return Run(
            arm=self.arm,
            target=target,
            controller=self.controller,
            limits=self.limits,
            status=str(self.status[number]),
            reason=str(self.reason[number]),
            scene=self.scene,
            points=points,
            point_errors=target.distances(points),
            info=info_of(arrays),
            held=(),
            **{name: arrays[name] for name in CONFIGURATION_ARRAYS + STEP_ARRAYS},
        )

    def __iter__(self) -> Iterator[Run]:
        return (self[number] for number in range(len(self)))

    def _checked_number(self, number: int) -> int:
        # IndexError, as for any sequence: it ends loops over one.
        if not is_whole(number):
            raise TypeError(f"a run is indexed by an integer, not by {number!r}")
        if not -len(self) <= number < len(self):
            raise IndexError(f"run {number} of {len(self)}")
        return int(number) % len(self)

    def target(self, number: int) -> Target:
        """Return the target posture of a run."""
        return self.targets[self._checked_number(number) if len(self.targets) > 1 else 0]

    @property
    def converged(self) -> NDArray[np.bool_]:
        """Which runs converged, (count,)."""
        return np.asarray(self.status == "converged")

    @cached_property
    def faults(self) -> tuple[str, ...]:
        """Messages on runs that did not converge, penetrations, and postures that no motor can hold."""
        away = np.flatnonzero(~self.converged)
        inside = np.flatnonzero(self.clearance < -CONTACT_TOLERANCE * self.arm.length)
        found = []
        if len(away):
            found.append(f"{len(away)} of {len(self)} runs did not reach the target")
        if len(inside):
            deepest = int(self.clearance.argmin())
            most = (
                f"most {self.closest[deepest]}, by {-1e3 * self.clearance[deepest]:.3g} mm in run {deepest}"
            )
            found.append(f"bodies penetrate in {len(inside)} of {len(self)} runs, {most}")
        loads = [self.arm.at(q).most_loaded() for q in self.q_final] if self.arm.torques_known else []
        heavy = {run: load for run, load in enumerate(loads) if load is not None and load.exceeded}
        if heavy:
            run, load = max(heavy.items(), key=lambda each: each[1].share)
            most = f"most in run {run}: {load}"
            found.append(f"the final posture cannot be held in {len(heavy)} of {len(self)} runs, {most}")
        return tuple(found)

    @property
    def verdict(self) -> str:
        """The result in one line."""
        return "; ".join(self.faults) or f"reached the target in all {len(self)} runs"

    def summary(self) -> dict[str, Any]:
        """Return the batch as data for JSON, without the configurations; lengths in metres."""
        names = ("status", "reason", "steps", "start_error", "final_error", "mean_error", "path_length_ratio")
        columns: dict[str, list[Any]] = {name: getattr(self, name).tolist() for name in names}
        columns["clearance"] = [each if np.isfinite(each) else None for each in self.clearance.tolist()]
        columns["closest"] = [each or None for each in self.closest.tolist()]
        runs = [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]
        return {
            "verdict": self.verdict,
            "faults": list(self.faults),
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
        """Return a readable summary as names and texts."""
        ends = ", ".join(f"{n} {status}" for status, n in Counter(self.status.tolist()).most_common())
        median_error = float(np.median(self.mean_error))
        words = {
            "verdict": self.verdict,
            "runs": f"{len(self)}: {ends}",
            "steps": _spread(self.steps, ".0f"),
            "mean error": f"median {length_text(median_error, self.arm.length)}, "
            f"largest {error_text(float(self.mean_error.max()), self.arm.length)}",
            "paths": f"{_spread(self.path_length_ratio, '.3g')} times as long as straight ones",
        }
        moved = [each.moved for each in self.targets if each.moved]
        far = max(moved, key=attrgetter("distance"), default=None)
        if far is not None:
            words["curve"] = f"{far} to the base of the arm" + (" at most" if len(self.targets) > 1 else "")
        if self.scene is not None:
            least = int(self.clearance.argmin())
            between = f", between {self.closest[least]}" if self.closest[least] else ""
            words["clearance"] = (
                f"{length_text(self.clearance[least])} where it is smallest, in run {least}{between}; "
                f"the margin is {length_text(self.scene.margin)}"
            )
        if not self.converged.all():
            worst = int(np.where(self.converged, -1.0, self.mean_error).argmax())
            words["worst"] = f"run {worst}, {self.status[worst]}: {self.reason[worst]}"
        enough = [reason.rpartition(f"{RAISE_STEPS} ")[2] for reason in self.reason.tolist()]
        known = [int(steps) for steps in enough if steps.isdecimal()]
        if known:
            words["out of steps"] = f"{RAISE_STEPS} {max(known)}, which is enough for {len(known)} of them"
        failed = np.flatnonzero(self.status == FAILED)
        if len(failed):
            words["failed"] = f"{len(failed)}, run {failed[0]} first: {self.reason[failed[0]]}"
        return words

    def __str__(self) -> str:
        words = self.in_words()
        width = max(map(len, words))
        return "\n".join(f"{name:{width}}  {text}" for name, text in words.items())

    def __repr__(self) -> str:
        kept = "ends" if self.motions is None else "motions"
        return f"Batch({len(self)} runs, {self.converged.sum()} converged, {kept} kept)"


def _spread(values: NDArray[Any], form: str) -> str:
    """Return the median and the maximum in words."""
    return f"{np.median(values):{form}} (median), at most {values.max():{form}}"
