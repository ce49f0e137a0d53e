"""The result of a run: the motion, and what is needed to draw and to repeat it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pinposture.arm import Arm
from pinposture.control import Limits
from pinposture.control.sweep import sweep
from pinposture.motion.ending import faults, verdict
from pinposture.scene import Scene
from pinposture.target import Target
from pinposture.target.placement import distance_from_curve

if TYPE_CHECKING:
    from pinposture.motion.joint_trajectory import JointTrajectory
    from pinposture.motion.rates import Excess

Array = NDArray[np.float64]


class Switch(NamedTuple):
    """A change of method.

    Attributes:
        step: the first step of the new method, counted from 0.
        method: its name.
        reason: why it took over.
    """

    step: int
    method: str
    reason: str


@dataclass(frozen=True, eq=False)
class Trajectory:
    """A motion of an arm towards a target posture.

    Rows of the arrays over configurations begin with the start; rows over steps with the first step.

    Attributes:
        arm: the arm that moved.
        target: the target posture.
        controller: the controller and its parameters, in words.
        limits: what a step could not exceed.
        status: how it ended: "converged", "stalled", "no_control_points", "max_steps" or "stopped"; see
            `pinposture.motion.ending`.
        reason: why the run ended, in words.
        q: configurations, (steps + 1, nq).
        points: control points, (steps + 1, m, 3) [m], world frame.
        point_errors: distance of each control point from its target, (steps + 1, m) [m]; 0 if it has none.
        active: which control points were active, (steps, m).
        index: smallest manipulability index that the active set had to clear, (steps,).
        sigma_min: smallest singular value of the posture control matrix, (steps,) [m/rad].
        sigma_max: largest singular value of the posture control matrix, (steps,) [m/rad].
        rows: rows of the posture control matrix, (steps,).
        scale: factor by which the step was shortened to meet the step limit, (steps,).
        clipped: which joints were cut short at a position limit, (steps, nv).
        method: which of its methods the controller used, (steps,) names; empty where it has only one.
        switched: why it changed to that method, (steps,) sentences; empty where it did not.
        escape: whether the step was meant to lead out of a place where the posture error cannot fall,
            (steps,); it may rise there.
        relaxed: which constraints gave way because not all could hold, and which limits of speed and
            acceleration the configurations exceed, (steps,) lines; usually empty.
        clearance: smallest distance to an obstacle, or between parts of the arm, (steps + 1,) [m]; negative
            in penetration, infinite where there was no scene.
        scene: what the arm was to keep clear of; None if nothing.
    """

    arm: Arm
    target: Target
    controller: str
    limits: Limits
    status: str
    reason: str
    q: Array
    points: Array
    point_errors: Array
    active: NDArray[np.bool_]
    index: Array
    sigma_min: Array
    sigma_max: Array
    rows: NDArray[np.intp]
    scale: Array
    clipped: NDArray[np.bool_]
    method: NDArray[np.str_]
    switched: NDArray[np.str_]
    escape: NDArray[np.bool_]
    relaxed: NDArray[np.str_]
    clearance: Array
    scene: Scene | None = None

    def __post_init__(self) -> None:
        for value in vars(self).values():
            if isinstance(value, np.ndarray):
                value.flags.writeable = False

    @property
    def steps(self) -> int:
        """Number of steps taken."""
        return len(self.active)

    @property
    def converged(self) -> bool:
        """True if the mean point error came within the tolerance."""
        return self.status == "converged"

    @cached_property
    def faults(self) -> tuple[str, ...]:
        """Why it should not be handed to a robot, in words; empty if nothing speaks against it."""
        return faults(self)

    @property
    def verdict(self) -> str:
        """What to think of it, in one line."""
        return verdict(self)

    @cached_property
    def posture_error(self) -> Array:
        """Sum of the distances of the control points from their targets, (steps + 1,) [m]."""
        return np.asarray(self.point_errors.sum(axis=1))

    @cached_property
    def distance_from_curve(self) -> float | None:
        """How far the whole arm is from the curve of the target in the end [m]; None if that has no curve.

        The distance of the farthest place on its links, as `Target.distance_from_curve` has it for the
        posture that was to be taken.
        """
        if self.target.curve is None:
            return None
        return distance_from_curve(self.arm, self.q[-1], self.target.curve)

    @cached_property
    def sweep(self) -> float:
        """Length of the paths of all control points relative to the direct distances from start to end."""
        return sweep(self.points)

    @cached_property
    def excess(self) -> Excess | None:
        """How its configurations exceed the limits of speed and acceleration; None if they do not."""
        from pinposture.motion.rates import find_excess

        return find_excess(self)

    @cached_property
    def active_sets(self) -> tuple[tuple[int, ...], ...]:
        """Active control set of each step, indices of control points, 0-based."""
        return tuple(tuple(int(k) for k in np.flatnonzero(row)) for row in self.active)

    @cached_property
    def switches(self) -> tuple[Switch, ...]:
        """Where a controller that has several methods changed from one to another, and why."""
        changes = np.flatnonzero(self.switched != "")
        return tuple(Switch(int(k), str(self.method[k]), str(self.switched[k])) for k in changes)

    def joint_trajectory(self, dt: float | None = None, force: bool = False) -> JointTrajectory:
        """The run as joint positions, speeds and accelerations in time, ready to be exported.

        Args:
            dt: duration of a step [s]; that of the limits if None.
            force: True to have it in spite of its `faults`.

        Raises:
            MotionError: it has faults.
            InvalidValue: the limits know of no time and none is given, or they know of another.
        """
        from pinposture.motion.joint_trajectory import JointTrajectory

        return JointTrajectory.from_run(self, dt, force)

    def save(self, path: str | Path) -> Path:
        """Write the run to one `.npz` file, all or nothing; it embeds the arm and the curve.

        Args:
            path: the file; ".npz" is added to a name without ending.

        Returns:
            The path written.

        Raises:
            FileError: the name has another ending, or the file cannot be written.
        """
        from pinposture.motion.files import save_trajectory

        return save_trajectory(self, Path(path))

    @classmethod
    def load(cls, path: str | Path) -> Trajectory:
        """Read a run that `save` wrote.

        Raises:
            FileError: the file is missing, or is not such a run.
        """
        from pinposture.motion.files import load_trajectory

        return load_trajectory(Path(path))

    def __repr__(self) -> str:
        first, last = self.posture_error[0], self.posture_error[-1]
        return f"Trajectory({self.status}, {self.steps} steps, posture error {first:.4g} -> {last:.4g} m)"
