"""A path through joint space, the speed along it, and where a controller is on it."""

from __future__ import annotations

from functools import cached_property
from math import inf, isfinite
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pinposture import kernels
from pinposture.arm import Arm, ArmState
from pinposture.control.limits import JointBounds
from pinposture.control.planner.objective import Posture

# A way through joint space, and how far along it a step may go.

Array = NDArray[np.float64]
Whole = NDArray[np.int64]


FARTHEST = 10.0
"""Largest joint motion of a step where limits allow any, in `Arm.joint_units`."""


class Stride(NamedTuple):
    """A step along a path.

    Attributes:
        place: where it leads, as a number of waypoints from the start, in [0, N]; no farther than before if
            the limits do not admit more.
        left: largest joint motion left from where it begins to the end of the path, in `Arm.joint_units`.
        inside: whether it is within its limits.
        dq: the step, (nv,) [rad or m].
    """

    place: float
    left: float
    inside: bool
    dq: Array


class JointPath:
    """Waypoints joined by straight lines through joint space.

    Attributes:
        arm: the arm.
        start: configuration at which it begins, (nq,).
        positions: joint positions there, (nv,) [rad or m].
        offsets: displacement of each waypoint from the start, (N + 1, nv) [rad or m]; the first is zero.
    """

    def __init__(self, arm: Arm, start: Array, offsets: Array) -> None:
        self.arm, self.start, self.offsets = arm, start, np.ascontiguousarray(offsets)
        self.positions = arm.positions(start)

    @cached_property
    def slopes(self) -> Array:
        """How the displacement changes at each waypoint from one to the next, (N + 1, nv) [rad or m]."""
        return np.asarray(np.gradient(self.offsets, axis=0))

    @property
    def end(self) -> float:
        """The last place, which is the number of straight pieces N."""
        return float(len(self.offsets) - 1)

    def _at(self, values: Array, place: float) -> Array:
        i = min(int(place), len(values) - 2)
        share = place - i
        return np.asarray((1.0 - share) * values[i] + share * values[i + 1])

    def offset(self, place: float) -> Array:
        """Displacement from the start at a place, (nv,) [rad or m]."""
        return self._at(self.offsets, place)

    def smooth(self, place: float) -> Array:
        """The same on a curve through the waypoints, (nv,): cubic between two of them, without corners."""
        i = min(int(place), len(self.offsets) - 2)
        t = place - i
        before, after = (1.0 + 2.0 * t) * (1.0 - t) ** 2, t * t * (3.0 - 2.0 * t)
        here = before * self.offsets[i] + after * self.offsets[i + 1]
        return np.asarray(here + t * (1.0 - t) * ((1.0 - t) * self.slopes[i] - t * self.slopes[i + 1]))

    def configuration(self, place: float) -> Array:
        """Configuration at a place, (nq,)."""
        return self.arm.integrate(self.start, self.offset(place))

    def offset_of(self, state: ArmState, place: float) -> Array:
        """Displacement (nv,) from the start to a state near a place, the way round that it took."""
        here = self.offset(place)
        way = self.arm.integrate(self.start, here)
        return np.asarray(here + self.arm.difference(way, state.q))

    def bent(self, place: float, change: Array, edges: Array) -> JointPath:
        """The path with another end, bent more and more from a place on.

        Args:
            place: where bending begins, as a number of waypoints from the start.
            change: displacement of the end, (nv,) [rad or m].
            edges: joint positions to stay between, (2, nv) [rad or m].
        """
        shares = np.arange(len(self.offsets)) - place
        shares = np.maximum(shares / max(shares[-1], 1e-9), 0.0)
        offsets = self.offsets + shares[:, None] * change
        lowest, highest = edges - self.positions
        lowest, highest = np.minimum(lowest, 0.0), np.maximum(highest, 0.0)
        return JointPath(self.arm, self.start, np.minimum(np.maximum(offsets, lowest), highest))

    def stride(self, state: ArmState, place: float, columns: Whole, units: Array, sides: Array) -> Stride:
        """The step to the farthest place, going on from a place without a gap, that limits admit.

        Such steps come to the end, however long the way and however different the joints. Measure what is
        left of the way piece by piece, each in steps of its slowest joint: L = sum over pieces of
        max_j |dq_j| / b_j, with b_j the largest step of joint j, at most `FARTHEST`. A step that does not end
        at the end is as long as b_j for some joint j. That joint goes no farther in it than the pieces of the
        way that the step passes add up to, so L falls by 1 at least, and ceil(L) steps are enough.

        Args:
            state: where the arm is.
            place: where it is on the path, or was last.
            columns: the degrees of freedom that move on the path, (n,).
            units: the motion of each of them that counts as one, (n,) [rad or m].
            sides: smallest and largest step, (2, nv) [rad or m].
        """
        dq = np.zeros(self.arm.nv)
        positions, endless = state.forward.positions, self.arm.kinematics.endless
        given = self.offsets, self.positions, positions, endless, columns, units, place, sides, FARTHEST
        place, left, inside = kernels.step_along(*given, dq)
        return Stride(place, left, inside, dq)


# How fast a path can be gone along where acceleration is limited.
#
# A place s on the path moves by v places per step. Joints then move by x' v per step, and change that by
# about x'' v^2 + x' a from one step to the next, a being the change of v. With b the largest step and A the
# largest change of it, of which a share is left to corrections, every joint asks for
#
# v <= b / |x'|, v^2 <= A / |x''|, |a| <= (A - |x''| v^2) / |x'|.
#
# Whoever slows down in time for the end, and for every place that is slow, also has v^2 <= v_next^2 + 2 |a|
# from one waypoint to the next. Between two waypoints the curve is taken to be as steep and as bent as at
# either of them, at most.

SPEED, PLANNED, TIMED = 0.95, 0.7, 0.9
"""Shares of the speed limit, and of the acceleration limit on ways of the controller's own and on those that
are given with their time, that are planned with; the rest is for corrections."""

CURVED = 0.8
"""Share of that, at most, for curves; the rest is always left for slowing down."""

SMALL = 1e-12
"""Slope of a path that is none, relative to the largest."""


class SpeedProfile:
    """The pace along a path, at its waypoints.

    Args:
        path: the path.
        bound: largest |dq| of each joint, (nv,) [rad or m]; may be infinite.
        brake: the most that dq may differ from that of the step before, (nv,) [rad or m]; None: any.
        most: the most waypoints to go in one step; infinite, or at least that many as time asks for.
        begin: waypoints that the step before went, if the arm is under way.

    Attributes:
        top: the fastest pace at each waypoint, (N + 1,) [waypoints per step].
    """

    def __init__(
        self, path: JointPath, bound: Array, brake: Array | None, most: float = inf, begin: float = 0.0
    ) -> None:
        shape = path.offsets.shape
        self._brake = np.full(shape[1], np.inf) if brake is None else np.array(brake)
        self._planned = PLANNED if most == inf else TIMED
        self._slope, self._bend = np.empty(shape), np.empty(shape)
        self._cap, self.top = np.empty(shape[0]), np.empty(shape[0])
        shares, into = (SPEED, self._planned, CURVED, SMALL), (self._slope, self._bend, self._cap, self.top)
        kernels.find_speed_profile(path.offsets, np.array(bound), self._brake, begin, most, *shares, *into)

    def next(self, place: float, pace: float) -> float:
        """Places to go in this step, after `pace` places in the step before."""
        given = self._slope, self._bend, self._cap, self.top, self._brake
        return kernels.next_path_speed(place, pace, *given, self._planned, CURVED)


# Where a controller is on its way.

DISTURBED = 0.05
"""Joint motion by which a measured configuration may differ from the expected one without a new way being
planned, in `Arm.joint_units`."""

PROGRESS = 0.005
"""Share of a path that counts as getting on, for an arm that is hindered."""


class PathProgress(NamedTuple):
    """A way to a goal, and how far the arm has come on it.

    Attributes:
        posture: what is asked of the arm.
        path: the way to the configuration that does it best.
        place: where the arm is on it, in waypoints.
        bounds: the limits that the pace keeps.
        pace: how fast it may go along the path; None where neither acceleration nor time says so.
        speed: how fast it last did, in waypoints per step.
        passed: the place that the arm last passed in good time.
        waited: joint travel that the limits have allowed since then [rad].
        tries: how many ways were tried before this one.
        arrived: whether the path is behind the arm; what errors are left are then reduced directly.
        damping: factor of the damping with which they are.
        hindrance: what the best way that was found comes too close to, in words; empty if it is clear.
        expected: joint positions that the arm should have by now, (nv,) [rad or m]; None before the first
            step.
        bent: by how much the path was bent to end elsewhere since it was planned, (nv,) [rad or m]; None if
            not at all.
        most: the most waypoints to go in one step, on a way that was given together with its time; infinite
            on ways of the controller's own.
        strict_errors: errors of strict tasks at the start and at the goal, 2 x (r,) [m]; between, they are
            to change in proportion to the place.
    """

    posture: Posture
    path: JointPath
    bounds: JointBounds
    place: float = 0.0
    pace: SpeedProfile | None = None
    speed: float = 0.0
    passed: float = 0.0
    waited: float = 0.0
    tries: int = 0
    arrived: bool = False
    damping: float = 1.0
    hindrance: str = ""
    expected: Array | None = None
    bent: Array | None = None
    most: float = inf
    strict_errors: tuple[Array, Array] = (np.zeros(0), np.zeros(0))

    @property
    def given(self) -> bool:
        """Whether the way was given, with its time: then it stays while the target moves along it."""
        return isfinite(self.most)

    def gone_to(
        self, place: float, travel: float, hindered: bool, expected: Array | None = None
    ) -> PathProgress:
        """The progress after a step.

        Args:
            place: where the step leads.
            travel: joint travel that the limits allow in it [rad].
            hindered: whether it leads less far than limits, or the pace, would have it; what they allow is
                getting on, however little of the way it is.
            expected: joint positions that the arm should have then, (nv,) [rad or m]; None if unknown.
        """
        waits = hindered and place < self.passed + PROGRESS * self.path.end
        return self._replace(
            place=place,
            speed=place - self.place,
            passed=self.passed if waits else place,
            waited=self.waited + travel if waits else 0.0,
            expected=expected,
        )

    def leads_on(self, state: ArmState) -> bool:
        """Whether the arm is where the progress has it, or nearly: else the way begins anew where it is."""
        arm = self.posture.arm
        if arm is not state.arm or self.expected is None:
            return arm is state.arm
        chain = arm.kinematics
        given = self.expected, state.forward.positions, chain.endless, chain.columns, self.bounds.units
        return kernels.joint_distance(*given) <= DISTURBED

    def under_way(self, previous: Array | None) -> PathProgress:
        """The progress of an arm that already moves along its way, as far as the step before, (nv,), did."""
        if self.pace is None or previous is None or self.place > 0.0:
            return self
        ahead = self.path.offsets[1] - self.path.offsets[0]
        squares = float(ahead @ ahead)
        speed = max(float(ahead @ previous), 0.0) / squares if squares > 0.0 else 0.0
        speed, bounds = min(speed, self.path.end), self.bounds
        pace = SpeedProfile(self.path, bounds.bound, bounds.brake, self.most, speed)
        return self._replace(speed=speed, pace=pace)

    def within(self, bounds: JointBounds) -> PathProgress:
        """The same progress with the pace that other limits allow."""
        pace = None
        if bounds.brake is not None or self.given:
            pace = SpeedProfile(self.path, bounds.bound, bounds.brake, self.most)
        return self._replace(bounds=bounds, pace=pace)
