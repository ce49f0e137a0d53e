"""Paths through joint space, and the second stage of the planner: their time parameterization."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from math import inf, isfinite
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pinposture import kernels
from pinposture._validation import require_positive
from pinposture.arm import Arm, ArmState
from pinposture.collision import Scene
from pinposture.control.limits import JointBounds, Limits, require_limits
from pinposture.control.planner.objective import Objective
from pinposture.errors import InvalidValue

Array = NDArray[np.float64]

MAX_STEP = 10.0
"""Largest joint motion of a step where limits allow any, in `Arm.joint_units`."""

SHORT_MOTION = 0.1
"""Joint motion up to which joint interpolation will do, in `Arm.joint_units`: one step is no more direct."""

NO_ERRORS = np.zeros(0)


class Stride(NamedTuple):
    """A step along a path.

    Attributes:
        place: where it leads, in waypoints from the start, in [0, N]; where the arm was if the limits admit
            no step ahead.
        left: largest joint motion that was left before the step, in `Arm.joint_units`.
        inside: whether it is within its limits.
        dq: the step, (nv,) [rad or m].
    """

    place: float
    left: float
    inside: bool
    dq: Array


@dataclass(frozen=True, eq=False)
class JointPath:
    """A path: waypoints joined by straight lines in joint space, and its objective.

    A place on the path is a number of waypoints from the start, in [0, N].

    Attributes:
        objective: the objective, which includes the target posture.
        start: configuration at which the path begins, (nq,).
        offsets: displacement of each waypoint from the start, (N + 1, nv) [rad or m]; the first is zero.
        scene: the obstacles; None: none.
        attempt: number of paths to the same target that were abandoned before this one.
        hindrance: what the path comes too close to, in words; empty if it is clear.
        found_by: how it was found: "relaxation", "tree search" or "withdrawal".
        task_errors: errors of the tasks with priority at the start and at the end, 2 x (r,) [m]. In
            between they change linearly with the place.
    """

    objective: Objective
    start: Array
    offsets: Array
    scene: Scene | None = None
    attempt: int = 0
    hindrance: str = ""
    found_by: str = "relaxation"
    task_errors: tuple[Array, Array] = (NO_ERRORS, NO_ERRORS)

    @property
    def arm(self) -> Arm:
        """The arm."""
        return self.objective.arm

    @cached_property
    def positions(self) -> Array:
        """Joint positions at the start, (nv,) [rad or m]."""
        return self.arm.positions(self.start)

    @cached_property
    def slopes(self) -> Array:
        """Slope of the smooth curve at each waypoint, (N + 1, nv) [rad or m per waypoint]."""
        slopes = np.empty_like(self.offsets)
        kernels.spline_slopes(self.offsets, slopes)
        return slopes

    @property
    def end(self) -> float:
        """The last place, N."""
        return float(len(self.offsets) - 1)

    @cached_property
    def length(self) -> float:
        """Length in the metric of the planner [m]; see `Objective.measure_pieces`."""
        return float(self.objective.measure_pieces(self.positions, self.offsets).sum())

    @cached_property
    def configurations(self) -> Array:
        """Configurations at the waypoints, (N + 1, nq)."""
        return np.array([self.arm.integrate(self.start, offset) for offset in self.offsets])

    def offset(self, place: float) -> Array:
        """Return the displacement from the start at a place, (nv,) [rad or m]."""
        i = min(int(place), len(self.offsets) - 2)
        share = place - i
        return np.asarray((1.0 - share) * self.offsets[i] + share * self.offsets[i + 1])

    def smooth_offset(self, place: float) -> Array:
        """Return the same on natural cubic splines through the waypoints, (nv,)."""
        i = min(int(place), len(self.offsets) - 2)
        t = place - i
        before, after = (1.0 + 2.0 * t) * (1.0 - t) ** 2, t * t * (3.0 - 2.0 * t)
        here = before * self.offsets[i] + after * self.offsets[i + 1]
        return np.asarray(here + t * (1.0 - t) * ((1.0 - t) * self.slopes[i] - t * self.slopes[i + 1]))

    def configuration(self, place: float) -> Array:
        """Return the configuration at a place, (nq,)."""
        return self.arm.integrate(self.start, self.offset(place))

    def offset_of(self, state: ArmState, place: float) -> Array:
        """Return the displacement (nv,) from the start to a state near a place, turns of joints included."""
        here = self.offset(place)
        on_path = self.arm.integrate(self.start, here)
        return np.asarray(here + self.arm.difference(on_path, state.q))

    def revised(self, **changes: Any) -> JointPath:
        """Return the path with another objective or scene, and keep what its waypoints give."""
        other = replace(self, **changes)
        kept = {"positions", "slopes", "configurations"} & vars(self).keys()
        vars(other).update({name: vars(self)[name] for name in kept})
        return other

    def within(self, edges: Array) -> JointPath:
        """Return the path with a curve through its waypoints that stays between joint positions, as they do.

        Args:
            edges: the joint positions, (2, nv) [rad or m]. From a start beyond them, the curve comes back.
        """
        lowest, highest = edges - self.positions
        room = np.minimum(np.maximum(highest, 0.0) - self.offsets, self.offsets - np.minimum(lowest, 0.0))
        # The curve lies within the hull of its waypoints and of places a third of a slope beside them.
        slopes = np.maximum(np.minimum(self.slopes, 3.0 * room), -3.0 * room)
        if np.array_equal(slopes, self.slopes):
            return self
        other = self.revised()
        vars(other)["slopes"] = slopes
        return other

    def bent(self, place: float, change: Array, edges: Array) -> JointPath:
        """Return the path to another end, bent increasingly from a place on.

        Args:
            place: where bending begins.
            change: displacement of the end, (nv,) [rad or m].
            edges: joint positions to stay between, (2, nv) [rad or m].
        """
        shares = np.arange(len(self.offsets)) - place
        shares = np.maximum(shares / max(shares[-1], 1e-9), 0.0)
        offsets = self.offsets + shares[:, None] * change
        lowest, highest = edges - self.positions
        lowest, highest = np.minimum(lowest, 0.0), np.maximum(highest, 0.0)
        offsets = np.ascontiguousarray(np.minimum(np.maximum(offsets, lowest), highest))
        return replace(self, offsets=offsets)

    def stride(self, state: ArmState, place: float, sides: Array) -> Stride:
        """Return the step to the farthest place that the limits admit, all places before it included.

        Such steps come to the end, however long the path and however different the joints. Measure what is
        left of the path piece by piece, each in steps of its slowest joint: L = sum over pieces of
        max_j |dq_j| / b_j, with b_j the largest step of joint j, at most `MAX_STEP`. A step that does not end
        at the end is as long as b_j for some joint j. That joint goes no farther in it than the pieces of the
        path that the step passes add up to, so L falls by 1 at least, and ceil(L) steps are enough.

        Args:
            state: the state of the arm.
            place: where it is on the path, or was last.
            sides: smallest and largest step, (2, nv) [rad or m].
        """
        dq, objective = np.zeros(self.arm.nv), self.objective
        positions, endless = state.forward.positions, self.arm.kinematics.endless
        given = objective.columns, objective.chain.units, place, sides, MAX_STEP
        found = kernels.step_along(self.offsets, self.positions, positions, endless, *given, dq)
        return Stride(*found, dq)


# How fast a path can be followed where acceleration is limited.
#
# A place s on the path moves by v places per step. Joints then move by q' v per step, and change that by
# q'' v^2 + q' u from one step to the next, u being the change of v. With b the largest step and A the largest
# change of it, less a share that is left to corrections, every joint asks for
#
# |q'| v <= b, |q' u + q'' v^2| <= A.
#
# The time-optimal v under these is found by a pass from the end to the start, which leaves the speeds from
# which all that follows can be kept, and one from the start to the end, which accelerates as much as these
# allow (as TOPP-RA does). Steps are means of the speed, so that limits that hold at all times hold for them.

SPEED_SHARE, ACCELERATION_SHARE = 0.98, 0.97
"""Shares of the limits of speed and acceleration that the profile uses; the rest is for corrections."""

LEAST_PARTS = 128
"""Least number of parts of a path on which its acceleration is constant."""

ZERO_SLOPE = 1e-12
"""Slope of a path that counts as none, relative to the largest."""


class SpeedProfile:
    """The highest speed along a path, at its waypoints.

    Args:
        path: the path.
        bounds: the limits.
        max_rate: largest number of waypoints in one step.
        initial_speed: number of waypoints in the step before, if the arm is moving.

    Attributes:
        top: the highest speed at equal distances, (K + 1,) [waypoints per step].
    """

    def __init__(
        self, path: JointPath, bounds: JointBounds, max_rate: float = inf, initial_speed: float = 0.0
    ) -> None:
        n, self._waypoints, self._most = path.offsets.shape[1], len(path.offsets) - 1, max_rate
        count = -(-LEAST_PARTS // self._waypoints) * self._waypoints
        brake = np.full(n, np.inf) if bounds.brake is None else ACCELERATION_SHARE * bounds.brake
        rows = np.empty((count, 3, n)), np.empty((count, 3, n))
        self.top = np.empty(count + 1)
        bound = SPEED_SHARE * np.array(bounds.bound)
        given = path.offsets, path.slopes, bound, brake, initial_speed, max_rate, ZERO_SLOPE
        kernels.find_speed_profile(*given, *rows, self.top)
        self._rows = (brake, *rows)

    @property
    def steps(self) -> float:
        """Number of steps to the end of the path, from its start."""
        speeds = np.maximum(self.top[1:] + self.top[:-1], 1e-9)
        return float((2.0 * self._waypoints / len(speeds) / speeds).sum())

    def next(self, place: float, speed: float) -> float:
        """Return the places to go in this step, after `speed` places in the step before."""
        return kernels.next_path_speed(
            place, speed, ZERO_SLOPE, self._most, *self._rows, self.top, self._waypoints
        )


@dataclass(frozen=True, eq=False)
class TimedPath:
    """A path with its time parameterization within limits.

    Attributes:
        path: the path.
        limits: the limits.
        bounds: the limits of the joints of the arm.
        profile: the highest speed along the path; None if neither acceleration nor a schedule limits it. Each
            step then goes as far as its slowest joint can.
        max_rate: largest number of waypoints in one step; infinite on a path without a schedule.
    """

    path: JointPath
    limits: Limits
    bounds: JointBounds
    profile: SpeedProfile | None
    max_rate: float = inf

    @property
    def scheduled(self) -> bool:
        """Whether the path has a schedule: the target moves along it, and the path is kept."""
        return isfinite(self.max_rate)

    @cached_property
    def places(self) -> Array:
        """Place on the path after each step, (K + 1,) [waypoints], of an arm that follows it undisturbed.

        Without a profile the arm may cut corners between waypoints, and arrive earlier.
        """
        end, profile = self.path.end, self.profile
        if profile is None:
            bound = np.minimum(self.bounds.bound, MAX_STEP * self.path.arm.joint_units)
            pieces = np.abs(np.diff(self.path.offsets, axis=0)) / bound
            passed = np.concatenate([[0.0], np.cumsum(pieces.max(axis=1))])
            steps = np.append(np.arange(0.0, passed[-1]), passed[-1])
            return np.asarray(np.interp(steps, passed, np.arange(end + 1.0)))
        places, speed = [0.0], 0.0
        while places[-1] < end * (1.0 - ZERO_SLOPE):
            speed = min(profile.next(places[-1], speed), end - places[-1])
            if speed <= 0.0:
                break
            places.append(places[-1] + speed)
        return np.array(places)

    @property
    def duration(self) -> float:
        """Time to the end of the path [s]; the number of steps if the limits have no `dt`."""
        return (len(self.places) - 1) * (1.0 if self.limits.dt is None else self.limits.dt)

    @cached_property
    def configurations(self) -> Array:
        """Configuration after each step, (K + 1, nq): with a profile, on the curve through the waypoints."""
        offset = self.path.offset if self.profile is None else self.path.smooth_offset
        return np.array([self.path.arm.integrate(self.path.start, offset(place)) for place in self.places])


def retime(
    path: JointPath, limits: Limits | None = None, max_rate: float = inf, initial_speed: float = 0.0
) -> TimedPath:
    """Find the time parameterization of a path within limits: the second stage of `Geodesic`.

    It keeps the velocity and acceleration limits with a reserve for corrections, and brakes in time for slow
    places and for the end.

    Args:
        path: the path, as `plan` returns it.
        limits: the limits of each step; `Limits()` if None.
        max_rate: largest number of waypoints in one step. A finite number means that the waypoints are a
            schedule: the target moves along the path.
        initial_speed: number of waypoints in the step before, if the arm is moving along the path already.

    Raises:
        InvalidValue: not a path, limits that do not fit the arm, or a rate that is not positive.
    """
    if not isinstance(path, JointPath):
        raise InvalidValue("path", path, "a JointPath, as `plan` returns it")
    limits = require_limits(limits)
    if max_rate != inf:
        require_positive("max_rate", max_rate)
    require_positive("initial_speed", initial_speed, zero=True)
    bounds, profile = limits.for_arm(path.arm), None
    if bounds.brake is not None or max_rate != inf:
        path = path.within(bounds.edges)
        profile = SpeedProfile(path, bounds, max_rate, initial_speed)
    return TimedPath(path, limits, bounds, profile, max_rate)
