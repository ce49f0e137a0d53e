"""Trajectories: motions in time towards moving targets, and how they passed their waypoints."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pinposture._validation import make_read_only
from pinposture.arm import Arm
from pinposture.collision import CollisionModel
from pinposture.control.limits import cycle_of
from pinposture.motion.joint_trajectory import JointTrajectory
from pinposture.motion.run import (
    Run,
    closest,
    ending,
    holding_torque,
    joint_shares,
    largest_shares,
    rows_to_send,
    sag_as_data,
    torque_shares,
)
from pinposture.placement.target import Moved

Array = NDArray[np.float64]

NO_SLOWDOWN = 5e-3
"""Relative excess over the planned time that is attributed to whole cycles."""

OFF_THE_PATH = "an obstacle keeps the arm off the planned path"


class WaypointResult(NamedTuple):
    """A named waypoint of a motion, such as a keyframe, and how the arm passed it.

    Attributes:
        name: its name.
        planned: planned time from the start of the plan [s].
        reached: time at which the arm reached it, to the nearest cycle [s]; None if never.
        row: the row of the motion at that time; None if never.
        mean_error: mean distance of the control points from their targets at that time [m]; None if never.
            It can be as large as the motion in half a cycle.
        off_curve: largest distance of the targets of the control points from the curve of the waypoint, if
            the arm cannot take the curve exactly, or of the tip from the end of a curve that is not to be
            trimmed [m]; None without a curve. After following a leader, the largest distance of any part of
            the arm from the path on the way from the waypoint before, as `path_deviation` measures it.
        tip_off: error of the tip task at that time [m]; None without a tip task, or if never reached.
        moved: how its curve was moved from its original position; None without a curve.
        speed: largest share of the velocity limits for the motion to it.
        missed: whether the arm passed it at a distance, or left the path that it had to follow.
    """

    name: str
    planned: float
    reached: float | None
    row: int | None
    mean_error: float | None
    off_curve: float | None = None
    tip_off: float | None = None
    moved: Moved | None = None
    speed: float = 1.0
    missed: bool = False


@dataclass(frozen=True, eq=False)
class Trajectory:
    """A trajectory: a motion in time towards moving targets.

    Rows begin with the start. The arm is at rest there, and at the end unless `reason` says otherwise.

    Attributes:
        run: the motion as a run; its `target` is the last one, its errors refer to the targets of each row.
        targets: target positions of the control points, (steps + 1, m, 3) [m], world frame.
        target_mask: which control points had a target, (steps + 1, m).
        plan_time: time along the plan at each row, (steps + 1,) [s]; 0 while the arm moves to its first
            posture.
        start_index: the row at which the plan begins, after the motion to the first posture; the last row if
            that was not reached.
        planned: planned duration [s].
        waypoints: the waypoints, in order.
        deviations: messages on where the arm left the planned path or fell behind.
    """

    run: Run
    targets: Array
    target_mask: NDArray[np.bool_]
    plan_time: Array
    start_index: int
    planned: float
    waypoints: tuple[WaypointResult, ...] = ()
    deviations: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        make_read_only(*vars(self).values())

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
        """Whether the arm took all named postures, the last of them to within the tolerance."""
        return self.run.converged

    @property
    def faults(self) -> tuple[str, ...]:
        """Why it should not be sent to a robot; empty if it may be."""
        return self.run.faults

    @property
    def verdict(self) -> str:
        """The result in one line."""
        return self.run.verdict

    @cached_property
    def time(self) -> Array:
        """Time of each configuration, (steps + 1,) [s]."""
        return np.asarray(self.dt * np.arange(self.steps + 1, dtype=np.float64))

    @property
    def duration(self) -> float:
        """Time from the start to the end of the plan [s]."""
        arrived = np.flatnonzero(self.plan_time >= self.planned)
        last = int(arrived[0]) if len(arrived) else self.steps
        return (last - self.start_index) * self.dt

    @property
    def time_scale(self) -> float:
        """Actual duration relative to the planned one, up to where the arm stopped."""
        done = float(self.plan_time[-1])
        return self.duration / done if done > 0.0 else 1.0

    @cached_property
    def slowdown(self) -> str:
        """Message on how much slower than planned the motion was, and the main cause; empty if it was not."""
        if not self.time_scale > 1.0 + NO_SLOWDOWN:
            return ""
        causes = Counter(map(self._cause, self._slow_cycles))
        why = "".join(f": {cause} for {count * self.dt:.3g} s" for cause, count in causes.most_common(1))
        if why.startswith(f": {OFF_THE_PATH}") and self.run.scene is not None:
            row = min(self._slow_cycles, key=lambda cycle: float(self.run.clearance[cycle]))
            scene = self.run.scene_in(row, self.run.scene)
            pair = CollisionModel(self.arm, scene).minimum(self.q[row]).pair or ()
            why += f"; {' and '.join(pair)} come closest to each other"
        scale = self.time_scale
        slow = f"{scale:.3g} times as long as"
        if scale < 2.0:
            slow = f"{100.0 * (scale - 1.0):.3g} % slower than"
        return f"{slow} the {self.planned:.4g} s planned{why}"

    @property
    def _slow_cycles(self) -> list[int]:
        """The cycles in which the time of the plan advanced more slowly."""
        passed = np.diff(self.plan_time[self.start_index :])
        underway = np.flatnonzero(passed > 0.0)
        last = int(underway[-1]) if len(underway) else len(passed)  # the plan ends within a cycle
        slow = np.flatnonzero(passed[:last] < (1.0 - NO_SLOWDOWN) * self.dt)
        return [self.start_index + int(cycle) for cycle in slow]

    def _cause(self, cycle: int) -> str:
        """Return a clause on what slowed the arm in a cycle."""
        if self.plan_time[cycle] == self.plan_time[cycle + 1]:
            off_the_path = self.deviations and self.run.scene is not None
            return OFF_THE_PATH if off_the_path else "the arm is behind its targets"
        speeds, accelerations, jerks = self._shares
        used = {"velocity": speeds[cycle], "acceleration": accelerations[cycle : cycle + 2].max(axis=0)}
        used["torque"] = self._torque_shares[cycle : cycle + 2].max(axis=0)
        bounds = self.run.limits.for_arm(self.arm)
        if bounds.brake is not None and bounds.acceleration is not None and bounds.jerk is not None:
            # The jerk limit lowers the acceleration of the plan.
            planned = used["acceleration"] * (bounds.acceleration / bounds.brake)
            used["jerk"] = np.maximum(planned, jerks[cycle : cycle + 3].max(axis=0))
            used["acceleration"] = np.where(bounds.brake < bounds.acceleration, 0.0, used["acceleration"])
        kind = max(used, key=lambda kind: float(used[kind].max()))
        ahead = sum(waypoint.planned <= self.plan_time[cycle] for waypoint in self.waypoints)
        # The arm slows down before a keyframe with limited speed, and speeds up after it.
        near_by = [*self.waypoints[ahead : ahead + 2], *self.waypoints[max(ahead - 1, 0) : ahead]]
        slow = [waypoint for waypoint in near_by if waypoint.speed < 1.0]
        if slow and used[kind].max() < 0.85:  # from this share on, it is the limit that slows the arm
            return f"{slow[0].name} allows {100.0 * slow[0].speed:.3g} % of the velocity limits"
        return f"joint {self.arm.joint_names[int(used[kind].argmax())]} is at its {kind} limit"

    @cached_property
    def _shares(self) -> tuple[Array, Array, Array]:
        return joint_shares(self.run)

    @cached_property
    def _torque_shares(self) -> Array:
        return torque_shares(self.arm, self.run.q, self.run.limits)

    @cached_property
    def mean_error(self) -> Array:
        """Mean distance of the control points from their targets, (steps + 1,) [m]."""
        return np.asarray(self.run.posture_error / self.target_mask.sum(axis=1))

    @cached_property
    def velocities(self) -> Array:
        """Joint velocities in each cycle, (steps, nv) [rad/s or m/s]."""
        return self.run.displacements / self.dt

    @cached_property
    def accelerations(self) -> Array:
        """Joint accelerations between cycles, from and to rest, (steps + 1, nv) [rad/s^2 or m/s^2]."""
        rest = np.zeros((1, self.arm.nv))
        return np.diff(np.concatenate([rest, self.velocities, rest]), axis=0) / self.dt

    def summary(self) -> dict[str, Any]:
        """Return the results as JSON-compatible data [m, s].

        Errors are those along the plan, from its start to its end. The posture error, and the final error, is
        the sum of the distances of the control points from their targets, the mean error is their mean.
        """
        run = self.run
        begun = self.start_index
        errors = run.posture_error[begun:]
        means = self.mean_error[begun:]
        worst = begun + int(errors.argmax())
        worst_mean = begun + int(means.argmax())
        return {
            "kind": "motion",
            **ending(run),
            "steps": run.steps,
            "dt": self.dt,
            "time": float(self.time[-1]),
            "start_index": float(self.time[begun]),
            "planned": self.planned,
            "duration": self.duration,
            "time_scale": self.time_scale,
            "slowdown": self.slowdown,
            "done": float(self.plan_time[-1]),
            **{f"largest_{kind}": share for kind, share in largest_shares(run).items()},
            "keyframes": [
                {
                    **{
                        name: value
                        for name, value in waypoint._asdict().items()
                        if name not in ("row", "moved")
                    },
                    "moved": None if waypoint.moved is None else waypoint.moved._asdict(),
                    "too_heavy": self._too_heavy(waypoint),
                }
                for waypoint in self.waypoints
            ],
            "worst_posture_error": float(errors.max()),
            "worst_at": float(self.time[worst]),
            "mean_posture_error": float(errors.mean()),
            "worst_mean_error": float(means.max()),
            "worst_mean_at": float(self.time[worst_mean]),
            "mean_error": float(means.mean()),
            "final_error": float(errors[-1]),
            "mean_final_error": float(means[-1]),
            "largest_error": float(run.point_errors[begun:].max()),
            "arm_length": self.arm.length,
            "control_points": self.arm.n_modules,
            "clearance": closest(run),
            "holding_torque": holding_torque(run),
            "sag": sag_as_data(run),
            "deviations": list(self.deviations),
        }

    def _too_heavy(self, waypoint: WaypointResult) -> str | None:
        """Say that a joint has not the torque to hold the posture of a waypoint; None if none is known to."""
        if waypoint.row is None:
            return None
        load = self.arm.at(self.q[waypoint.row]).most_loaded()
        return str(load) if load is not None and load.exceeded else None

    def joint_trajectory(self, force: bool = False, compensate: bool = False) -> JointTrajectory:
        """Return the motion as a joint trajectory for export, with one cycle of rest before and after.

        Players fit splines to the rows, which without rest would start and stop harder than the limits allow.

        Args:
            force: True to return it despite its `faults`.
            compensate: as in `Run.joint_trajectory`.

        Raises:
            MotionError: it has faults.
            PostureError: as `Arm.compensate`.
        """
        sent = rows_to_send(self.run, force, compensate)
        rows = np.concatenate([sent.q[:1], sent.q, sent.q[-1:]])
        return JointTrajectory.from_configurations(self.arm, rows, sent.slowdown * self.dt)

    def __repr__(self) -> str:
        slower = f", {self.slowdown}" if self.converged and self.slowdown else ""
        return (
            f"Trajectory({self.run.status}, {self.time[-1]:.4g} s{slower}, {len(self.waypoints)} waypoints)"
        )
