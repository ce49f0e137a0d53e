"""The result of performing a motion in time: what the arm did, and what it should have done when."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pinposture.arm import Arm
from pinposture.control.limits import cycle_of
from pinposture.motion.joint_trajectory import JointTrajectory
from pinposture.motion.trajectory import Trajectory, require_no_faults
from pinposture.placement.curve_placement import Moved

Array = NDArray[np.float64]


class Waypoint(NamedTuple):
    """A named place of a motion, a keyframe for instance, and how the arm passed it.

    Attributes:
        name: what it is called.
        planned: when it was to be there, counted from when the arm sets out on the motion [s].
        reached: when it was, counted likewise, to the nearest cycle [s]; None if never.
        row: the row of the motion at that time; None if never.
        mean_error: mean distance of the control points from where they should be there [m]; None if never.
            A place that is passed between two cycles is missed by what the arm moves in half of one.
        off_curve: how far off the curve of this place the control points that follow it belong at most, where
            the arm cannot take the curve exactly [m]; None if there is no curve.
        tip_off: by how much the task of its tip is missed then [m]; None if there is none, or never.
        moved: how the curve of this place was moved from where it was drawn; None if there is no curve.
    """

    name: str
    planned: float
    reached: float | None
    row: int | None
    mean_error: float | None
    off_curve: float | None = None
    tip_off: float | None = None
    moved: Moved | None = None


@dataclass(frozen=True, eq=False)
class Motion:
    """A motion in time towards targets that move.

    Rows begin with the start; the arm is at rest there, and at the end unless `reason` says otherwise.

    Attributes:
        run: the motion as a run; its `target` is the last one, its errors are distances from the targets of
            the moment.
        targets: where the control points should have been, (steps + 1, m, 3) [m], world frame.
        target_mask: which control points had a target, (steps + 1, m).
        plan_time: the time of the plan at each row, (steps + 1,) [s]; 0 while the arm comes to where it
            begins.
        start_index: the row at which the arm sets out on the plan; before that it comes to its first
            posture. The last row if it did not get so far.
        planned: how long the plan takes if nothing slows it [s].
        waypoints: the named places, in order.
        deviations: where the arm left the planned path, or fell behind, in words.
    """

    run: Trajectory
    targets: Array
    target_mask: NDArray[np.bool_]
    plan_time: Array
    start_index: int
    planned: float
    waypoints: tuple[Waypoint, ...] = ()
    deviations: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for value in (self.targets, self.target_mask, self.plan_time):
            value.flags.writeable = False

    @property
    def arm(self) -> Arm:
        """The arm that moved."""
        return self.run.arm

    @property
    def dt(self) -> float:
        """Duration of a control cycle [s]."""
        return cycle_of(self.run.limits)

    @property
    def q(self) -> Array:
        """Configurations, (steps + 1, nq)."""
        return self.run.q

    @property
    def steps(self) -> int:
        """Number of control cycles."""
        return self.run.steps

    @property
    def converged(self) -> bool:
        """True if the arm took the last posture."""
        return self.run.converged

    @property
    def faults(self) -> tuple[str, ...]:
        """Why it should not be sent to a robot, in words; empty if it may be."""
        return self.run.faults

    @property
    def verdict(self) -> str:
        """What to think of it, in one line."""
        return self.run.verdict

    @cached_property
    def time(self) -> Array:
        """When the arm was at each configuration, (steps + 1,) [s]."""
        return np.asarray(self.dt * np.arange(self.steps + 1, dtype=np.float64))

    @property
    def duration(self) -> float:
        """How long the plan took, from setting out to its last place [s]."""
        arrived = np.flatnonzero(self.plan_time >= self.planned)
        last = int(arrived[0]) if len(arrived) else self.steps
        return (last - self.start_index) * self.dt

    @property
    def time_scale(self) -> float:
        """How many times as long as planned it took, as far as it came; 1 if nothing slowed it."""
        done = float(self.plan_time[-1])
        return self.duration / done if done > 0.0 else 1.0

    @cached_property
    def mean_error(self) -> Array:
        """Mean distance of the control points with a target from it, (steps + 1,) [m]."""
        return np.asarray(self.run.posture_error / self.target_mask.sum(axis=1))

    @cached_property
    def velocities(self) -> Array:
        """Joint speeds in each cycle, (steps, nv) [rad/s or m/s]."""
        moved = [self.arm.difference(a, b) for a, b in zip(self.q[:-1], self.q[1:], strict=True)]
        return np.reshape(moved, (self.steps, self.arm.nv)) / self.dt

    @cached_property
    def accelerations(self) -> Array:
        """How joint speeds change from one cycle to the next, from and to rest, (steps + 1, nv) [../s^2]."""
        rest = np.zeros((1, self.arm.nv))
        return np.diff(np.concatenate([rest, self.velocities, rest]), axis=0) / self.dt

    def joint_trajectory(self, force: bool = False) -> JointTrajectory:
        """The motion as joint positions, speeds and accelerations in time, ready to be exported.

        The arm stands still for one more cycle before and after it: players of such files fit splines to the
        rows, and would otherwise start and stop harder than the limits allow.

        Args:
            force: True to have it in spite of its `faults`.

        Raises:
            MotionError: it has faults.
        """
        require_no_faults(self.run, force)
        rows = np.concatenate([self.q[:1], self.q, self.q[-1:]])
        return JointTrajectory.from_configurations(self.arm, rows, self.dt)

    def __repr__(self) -> str:
        slow = self.converged and self.time_scale > 1.005
        slower = f", {self.time_scale:.3g} times as long as planned" if slow else ""
        return f"Motion({self.run.status}, {self.time[-1]:.4g} s{slower}, {len(self.waypoints)} places)"
