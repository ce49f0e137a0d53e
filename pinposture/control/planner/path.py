"""Joint-space paths, and the second stage of the planner: their time parameterization."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from math import inf
from typing import Any, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from pinposture import kernels
from pinposture._validation import require_instance, require_positive
from pinposture.arm import Arm, ChainState
from pinposture.arm.weight import load_of
from pinposture.collision import Scene
from pinposture.control.limits import JointBounds, Limits, require_limits
from pinposture.control.planner.objective import Objective
from pinposture.errors import InvalidValue
from pinposture.kernels.arrays import TORQUE_LANES, PathParts, ProfileRows, TimedPathArrays
from pinposture.units import length_text

Array = NDArray[np.float64]


class PathSettings(NamedTuple):
    """How a path is sampled and timed."""

    most_step: float = 10.0
    """Largest joint motion of a step without limits, in `Arm.joint_units`."""

    short_motion: float = 0.1
    """Joint motion up to which joint interpolation is direct enough, in `Arm.joint_units`."""

    speed_share: float = 0.98
    """Share of the velocity limits that a profile uses; the rest is for corrections, and for
    differences between steps and a continuous motion. With all of it two runs would be 2 % shorter."""

    acceleration_share: float = 0.97
    """The same of the acceleration limits."""

    held_share: float = 0.98
    """Share of a torque limit that holding the arm may take on a path with `retime(effort=True)`."""

    least_parts: int = 128
    """Smallest number of parts of a path with constant acceleration each. Half of it lengthened eight
    runs of 40 joints by up to 1.1 %, twice of it shortened them by up to 0.5 %."""

    finer_ends: tuple[int, ...] = (4, 2, 2)
    """How many times as finely the outer pieces of a path with limits of torque are divided, from its
    ends on: the arm is slow there, and torques per acceleration change within a part. Without, 20
    motions of 100 joints took 0.9 % longer in the median, and up to 2 %; twice as fine ends would save
    0.1 %, parts of half the length 0.5 % (`benchmarks.peers.durations`)."""

    zero_slope: float = 1e-12
    """Slope of a path that counts as zero, relative to the largest."""


PATH = PathSettings()


class PathStep(NamedTuple):
    """A step along a path.

    Attributes:
        s: its end, in waypoints from the start, in [0, N]; unchanged if the limits admit no step ahead.
        left: largest remaining joint motion before the step, in `Arm.joint_units`.
        inside: whether it is within its limits.
        dq: the step, (nv,) [rad or m].
    """

    s: float
    left: float
    inside: bool
    dq: Array


@dataclass(frozen=True, eq=False)
class JointPath:
    """A path: waypoints connected by straight lines in joint space, and its objective.

    A position on the path is measured in waypoints from the start, in [0, N].

    Attributes:
        objective: what it was planned for, which includes the target posture.
        start: configuration at which the path begins, (nq,).
        offsets: displacement of each waypoint from the start, (N + 1, nv) [rad or m]; the first is zero.
        scene: the obstacles among which it was planned; None: none.
        attempt: number of paths to the same target that were abandoned before this one.
        blocked_by: message naming the pair that comes too close, and the constraints that the path violates;
            empty if it is clear.
        found_by: how it was found: "relaxation", "tree search" or "withdrawal".
        task_errors: errors of the tasks with priority at the start and the end, 2 x (r,) [m]. In between they
            should change linearly with the position. None: no path does, and the tasks count at the end.
    """

    objective: Objective
    start: Array
    offsets: Array
    scene: Scene | None = None
    attempt: int = 0
    blocked_by: str = ""
    found_by: str = "relaxation"
    task_errors: tuple[Array, Array] | None = (np.zeros(0), np.zeros(0))

    def __repr__(self) -> str:
        way = self.blocked_by or "clear"
        return f"JointPath({len(self.offsets)} waypoints, {length_text(self.length)}, {self.found_by}, {way})"

    @property
    def arm(self) -> Arm:
        """The arm."""
        return self.objective.arm

    @cached_property
    def positions(self) -> Array:
        """Joint positions at the start, (nv,) [rad or m]."""
        arm = self.objective.arm
        return arm.difference(arm.origin, self.start)

    @cached_property
    def slopes(self) -> Array:
        """Slope of the cubic spline at each waypoint, (N + 1, nv) [rad or m per waypoint]."""
        slopes = np.empty_like(self.offsets)
        kernels.spline_slopes(self.offsets, slopes)
        return slopes

    @cached_property
    def largest_held(self) -> Array:
        """Largest torque of each joint that holds the arm on its way, (nv,) [N m or N].

        On the curve through the waypoints, there and halfway between them.
        """
        s = np.linspace(0.0, self.end, 2 * int(self.end) + 1)
        torques = self.arm.dynamics.gravity_torques(self.positions + self.smooth_offset(s))
        return np.asarray(np.abs(torques).max(axis=0))

    @cached_property
    def end(self) -> float:
        """The last position, N."""
        return float(len(self.offsets) - 1)

    @cached_property
    def lengths(self) -> Array:
        """Length up to each waypoint, (N + 1,) [m], in the metric of `Objective.measure_pieces`."""
        return np.append(0.0, np.cumsum(self.objective.measure_pieces(self.positions, self.offsets)))

    @property
    def length(self) -> float:
        """Length in the metric of the planner [m]."""
        return float(self.lengths[-1])

    @cached_property
    def configurations(self) -> Array:
        """Configurations at the waypoints, (N + 1, nq)."""
        return self.arm.integrate(self.start, self.offsets)

    def offset(self, s: float | Array) -> Array:
        """Return the displacement from the start at a position, or (k,) of them, (..., nv) [rad or m]."""
        i, share = self._piece(s)
        return np.asarray((1.0 - share) * self.offsets[i] + share * self.offsets[i + 1])

    def smooth_offset(self, s: float | Array) -> Array:
        """Return the displacement from the start on the cubic spline through the waypoints; as `offset`."""
        many = np.array(s, dtype=np.float64, ndmin=1)
        filled = np.empty((len(many), self.offsets.shape[1]))
        kernels.smooth_offsets(self.offsets, self.slopes, many, filled)
        return filled if np.ndim(s) else filled[0]

    def _piece(self, s: float | Array) -> tuple[Any, Any]:
        """Return the waypoint before a position, and how far that is on the way to the next, in [0, 1]."""
        if np.ndim(s):
            i = np.minimum(np.asarray(s, dtype=np.intp), len(self.offsets) - 2)
            return i, (s - i)[:, None]
        first = min(int(s), len(self.offsets) - 2)
        return first, s - first

    def configuration(self, s: float) -> Array:
        """Return the configuration at a position, (nq,)."""
        return self.arm.integrate(self.start, self.offset(s))

    def offset_of(self, state: ChainState, s: float) -> Array:
        """Return the displacement (nv,) from the start to a state near a position, with its full turns."""
        filled = np.empty(state.arm.nv)
        kernels.path_offset(
            self.offsets, self.positions, state.raw_positions, state.arm.kinematics.endless, s, filled
        )
        return filled

    def revised(self, **changes: Any) -> JointPath:
        """Return the path with another objective or scene; cached values of the waypoints are kept."""
        other = replace(self, **changes)
        kept = {"positions", "slopes", "configurations", "largest_held", "end"} & vars(self).keys()
        vars(other).update({name: vars(self)[name] for name in kept})
        return other

    def within(self, position_limits: Array) -> JointPath:
        """Return the path with its spline slopes reduced to keep position limits, as the waypoints do.

        Args:
            position_limits: smallest and largest joint positions, (2, nv) [rad or m]; from a start beyond
                them, the curve returns.
        """
        lowest, highest = position_limits - self.positions
        room = np.minimum(np.maximum(highest, 0.0) - self.offsets, self.offsets - np.minimum(lowest, 0.0))
        # The curve is in the hull of its Bezier points: waypoints, and a third of a slope before and after.
        slopes = np.maximum(np.minimum(self.slopes, 3.0 * room), -3.0 * room)
        if np.array_equal(slopes, self.slopes):
            return self
        other = self.revised()
        vars(other)["slopes"] = slopes
        return other

    def bent(self, s: float, change: Array, position_limits: Array) -> JointPath:
        """Return the path to another end, with a displacement that grows linearly from a position on.

        Args:
            s: where the displacement begins.
            change: displacement of the end, (nv,) [rad or m].
            position_limits: smallest and largest joint positions, (2, nv) [rad or m].
        """
        shares = np.arange(len(self.offsets)) - s
        shares = np.maximum(shares / max(shares[-1], 1e-9), 0.0)
        offsets = self.offsets + shares[:, None] * change
        lowest, highest = position_limits - self.positions
        lowest = np.minimum(lowest, 0.0)
        highest = np.maximum(highest, 0.0)
        offsets = np.ascontiguousarray(np.minimum(np.maximum(offsets, lowest), highest))
        return replace(self, offsets=offsets)

    def step_along(self, state: ChainState, s: float, step_bounds: Array) -> PathStep:
        """Return the step to the farthest position such that the limits admit all positions up to it.

        Such steps always reach the end. Let L = sum over remaining pieces of max_j |dq_j| / b_j be the length
        of the remaining path in steps of its slowest joints, where b_j is the largest step of joint j, at
        most `PATH.most_step`. A step that does not reach the end has length b_j for some joint j, which
        travels no farther than along the pieces that the step passes. So L decreases by at least 1, and
        ceil(L) steps suffice.

        Args:
            state: the state of the arm.
            s: its position on the path.
            step_bounds: smallest and largest step, (2, nv) [rad or m].
        """
        dq = np.zeros(self.arm.nv)
        reached, left, inside = kernels.step_along(
            self.offsets,
            self.positions,
            state.raw_positions,
            self.arm.kinematics.endless,
            self.objective.chain.columns,
            self.objective.chain.units,
            s,
            step_bounds,
            PATH.most_step,
            dq,
        )
        return PathStep(reached, left, inside, dq)


# Time-optimal speed along a path with acceleration limits.
#
# The position s on the path advances by v per step. Joints then move by q' v per step, and this changes by
# q'' v^2 + q' u between steps, where u is the change of v. With the largest step b and its largest change A,
# less a reserve for corrections, each joint requires
#
# |q'| v <= b, |q' u + q'' v^2| <= A.
#
# A backward pass finds the speeds from which these can be kept up to the end, and a forward pass accelerates
# as much as those allow (as in TOPP-RA). Steps are means of the speed, so limits that hold at all times hold
# for steps.


class SpeedProfile:
    """The highest speed along a path, at its waypoints.

    Args:
        path: the path.
        bounds: the limits.
        max_rate: largest number of waypoints in one step; one number, or one for each piece, (N,).
        initial_speed: number of waypoints in the previous step, if the arm is moving.
        effort: torque limits that it keeps, too, (nv,) [N m or N]; None: none.
        strict: as for `torque_rows`.

    Attributes:
        parts: the parts of the path.
        rows: their limits.
        top: the highest speed at the ends of parts, (K + 1,) [waypoints per step].
        most: largest number of waypoints in one step.
    """

    def __init__(
        self,
        path: JointPath,
        bounds: JointBounds,
        max_rate: float | Array = inf,
        initial_speed: float = 0.0,
        effort: Array | None = None,
        strict: bool = False,
    ) -> None:
        n = path.offsets.shape[1]
        self._waypoints = len(path.offsets) - 1
        rates = np.full(self._waypoints, max_rate, dtype=np.float64)
        self.most = float(rates.max())
        brake = np.full(n, np.inf) if bounds.brake is None else PATH.acceleration_share * bounds.brake
        counts = np.full(self._waypoints, -(-PATH.least_parts // self._waypoints))
        if effort is not None:
            _divide_ends(counts)
        self.parts = PathParts(
            piece=np.repeat(np.arange(self._waypoints), counts), first=np.append(0, np.cumsum(counts))
        )
        count = len(self.parts.piece)
        if effort is None:
            shape = (count, 3, n)
            self.rows = ProfileRows(np.empty(shape), np.empty(shape), np.zeros(shape), brake)
        else:
            self.rows = torque_rows(path, bounds, effort, self.parts, brake, strict)
        self.top = np.empty(count + 1)
        kernels.find_speed_profile(
            path.offsets,
            path.slopes,
            PATH.speed_share * np.array(bounds.bound),
            initial_speed,
            rates,
            PATH.zero_slope,
            self.parts,
            self.rows,
            self.top,
        )

    @property
    def steps(self) -> float:
        """Number of steps to the end of the path, from its start."""
        speeds = np.maximum(self.top[1:] + self.top[:-1], 1e-9)
        lengths = 1.0 / np.diff(self.parts.first)[self.parts.piece]
        return float((2.0 * lengths / speeds).sum())

    def next(self, s: float, speed: float) -> float:
        """Return the number of waypoints to advance in this step, after `speed` in the previous one."""
        return kernels.next_path_speed(
            s,
            speed,
            PATH.zero_slope,
            self.most,
            self.parts,
            self.rows,
            self.top,
        )


def _divide_ends(counts: NDArray[np.intp]) -> None:
    """Divide the outer pieces of a path into more parts, (N,)."""
    most = int(counts[0])
    for i, finer in enumerate(PATH.finer_ends[: len(counts)]):
        counts[i] = max(counts[i], most * finer)
        counts[-1 - i] = max(counts[-1 - i], most * finer)


def torque_rows(
    path: JointPath, bounds: JointBounds, effort: Array, parts: PathParts, brake: Array, strict: bool
) -> ProfileRows:
    """Return the rows of a path with limits of torque; those of torques are filled.

    On the path, torques are M q' u + (M q'' + C q') x + g, with the mass matrix M, the Coriolis matrix C at
    the joint velocity q', and gravity g. They are sampled at waypoints, and where joints have moved by
    at most `PATH_SPEED.sampled_turn` in all, and cubic in between. Dry friction, and viscous friction at the
    velocity limit, count as if they always opposed the motors. Joints have no rows if their torques stay far
    below their limits in any motion on the path.

    Args:
        path: the path.
        bounds: the limits of the joints.
        effort: the torque limits, (nv,) [N m or N].
        parts: the parts of the path.
        brake: the limits of the first rows, of accelerations, (nv,).
        strict: whether a path that the motors cannot hold is refused. If not, it is passed slowly there.

    Raises:
        InvalidValue: limits without cycle time, viscous friction without a velocity limit, more friction than
            torque, or, if strict, a path that the motors cannot hold.
    """
    arm = path.arm
    dt = bounds.dt
    if dt is None:
        raise InvalidValue("limits.dt", None, "a cycle time, as torques depend on it")
    limit = effort - _friction(arm, bounds)
    held = np.empty(arm.nv)
    limits = np.empty(2 * arm.nv)
    count = len(parts.piece)
    # In one block: several would be given back to the system, and cleared by it for the next path.
    room = np.empty(9 * count * (2 * arm.nv + TORQUE_LANES))
    used, width = kernels.fill_torque_rows(
        arm.dynamics.indices,
        arm.dynamics.numbers,
        path.offsets,
        path.slopes,
        path.positions,
        dt,
        np.array([arm.joint_units, bounds.bound, brake, limit]),
        parts,
        room,
        limits,
        held,
    )
    if strict:
        _require_holdable(arm, held, PATH.held_share * limit)
    least = int(limit.argmin())
    if limit[least] <= 0.0:
        allowed = f"more than the friction of joint {arm.joint_names[least]!r} takes"
        raise InvalidValue("torque limit", float(effort[least]), allowed)
    a, b, c = room[: 9 * count * width].reshape(3, count, 3, width)
    return ProfileRows(a, b, c, limits[:used])


def _friction(arm: Arm, bounds: JointBounds) -> Array:
    """Return the torque that friction may take, (nv,) [N m or N]."""
    viscous = arm.dynamics.damping
    if not viscous.any():
        return arm.dynamics.dry_friction
    speed = np.where(viscous > 0.0, bounds.bound / cast(float, bounds.dt), 0.0)
    if np.any(np.isinf(speed)):
        joint = arm.joint_names[int(np.argmax(speed))]
        raise InvalidValue("limits.velocity", inf, f"a limit for joint {joint!r}, which has viscous friction")
    return np.asarray(arm.dynamics.dry_friction + viscous * speed)


def _require_holdable(arm: Arm, held: Array, limit: Array) -> None:
    """Check the largest torques that hold an arm on its path, (nv,), against their limits [N m or N]."""
    share = held / np.maximum(limit, 1e-300)
    joint = int(share.argmax())
    if share[joint] >= 1.0:
        load = load_of(arm.drives[joint], float(held[joint]), float(limit[joint]))
        allowed = (
            f"{100.0 * PATH.held_share:g} % of each torque limit, less friction; plan another path, or raise "
            "the limits with arm.with_effort(...)"
        )
        raise InvalidValue("holding the arm on the path", str(load), allowed)


@dataclass(frozen=True, eq=False)
class TimedPath:
    """A path with its time parameterization within limits.

    Attributes:
        path: the path.
        limits: the limits.
        bounds: the limits of the joints of the arm.
        profile: the highest speed along the path; None without acceleration limit and schedule. Each step
            then goes as far as its slowest joint can.
        max_rate: largest number of waypoints in one step, as for `retime`; infinite on a path without a
            schedule.
        effort: whether it keeps the torque limits of the arm, if the limits have none.
    """

    path: JointPath
    limits: Limits
    bounds: JointBounds
    profile: SpeedProfile | None
    max_rate: float | Array = inf
    effort: bool = False

    @cached_property
    def arrays(self) -> TimedPathArrays:
        """The path and its speed profile, for kernels."""
        path = self.path
        profile = self.profile
        if profile is None:
            return TimedPathArrays(
                offsets=path.offsets,
                slopes=np.empty((0, 0)),
                start=path.positions,
                top=np.empty(0),
                rows=ProfileRows(np.empty((0, 3, 0)), np.empty((0, 3, 0)), np.empty((0, 3, 0)), np.empty(0)),
                parts=PathParts(np.empty(0, dtype=np.intp), np.empty(0, dtype=np.intp)),
                most=inf,
                small=PATH.zero_slope,
            )
        return TimedPathArrays(
            offsets=path.offsets,
            slopes=path.slopes,
            start=path.positions,
            top=profile.top,
            rows=profile.rows,
            parts=profile.parts,
            most=profile.most,
            small=PATH.zero_slope,
        )

    @cached_property
    def torques(self) -> Array | None:
        """The torque limits that the profile keeps, (nv,) [N m or N]; None: none."""
        return profile_effort(self.path.arm, self.bounds, self.effort)

    @cached_property
    def is_held(self) -> bool:
        """Whether the motors hold the arm everywhere on the path, within the torque limits of its limits."""
        effort = self.bounds.effort
        return effort is None or bool(np.all(self.path.largest_held <= effort))

    @cached_property
    def scheduled(self) -> bool:
        """Whether the path has a schedule: the target moves along it, and the path is kept."""
        return bool(np.all(np.isfinite(self.max_rate)))

    @cached_property
    def s(self) -> Array:
        """Place after each step of an arm that follows the path undisturbed, (K + 1,) [waypoints].

        Without a profile the arm may cut corners at waypoints and arrive earlier.
        """
        end = self.path.end
        profile = self.profile
        if profile is None:
            bound = np.minimum(self.bounds.bound, PATH.most_step * self.path.arm.joint_units)
            pieces = np.abs(np.diff(self.path.offsets, axis=0)) / bound
            passed = np.concatenate([[0.0], np.cumsum(pieces.max(axis=1))])
            steps = np.append(np.arange(0.0, passed[-1]), passed[-1])
            return np.asarray(np.interp(steps, passed, np.arange(end + 1.0)))
        s = [0.0]
        speed = 0.0
        while s[-1] < end * (1.0 - PATH.zero_slope):
            speed = min(profile.next(s[-1], speed), end - s[-1])
            if speed <= 0.0:
                break
            s.append(s[-1] + speed)
        return np.array(s)

    @property
    def duration(self) -> float:
        """Time to the end of the path [s]; the number of steps if the limits have no `dt`."""
        return (len(self.s) - 1) * (1.0 if self.limits.dt is None else self.limits.dt)

    @cached_property
    def configurations(self) -> Array:
        """Configuration after each step, (K + 1, nq): with a profile, on the spline through the waypoints."""
        offset = self.path.offset if self.profile is None else self.path.smooth_offset
        return self.path.arm.integrate(self.path.start, offset(self.s))


def profile_effort(arm: Arm, bounds: JointBounds, effort: bool) -> Array | None:
    """Return the torque limits that a profile keeps, (nv,) [N m or N]; None: none."""
    if bounds.effort is not None:
        return bounds.effort if bounds.dt is not None or effort else None
    return arm.effort if effort else None


def retime(
    path: JointPath,
    limits: Limits | None = None,
    max_rate: float | Array = inf,
    initial_speed: float = 0.0,
    effort: bool = False,
) -> TimedPath:
    """Find the time parameterization of a path within limits: the second stage of `Geodesic`.

    It keeps the velocity and acceleration limits, with a reserve for corrections.

    Args:
        path: the path, as `plan` returns it.
        limits: the limits of each step; `Limits()` if None.
        max_rate: largest number of waypoints in one step; one number, or one for each of the N pieces. Finite
            numbers make the waypoints a schedule: the target moves along the path.
        initial_speed: number of waypoints in the previous step, if the arm already moves along the path.
        effort: whether the motors keep their torque limits, those of the limits or `Arm.effort`, on the whole
            path: by inverse dynamics with masses, armature and friction of the description, and what the arm
            carries. With torque limits, `Limits(effort=...)`, they do so in any case where they can hold the
            arm, and pass slowly where they can not.

    Raises:
        InvalidValue: not a path, limits that do not fit the arm, or a rate that is not positive. With
            `effort`, limits without `dt`, or a path that the motors cannot hold; names the joint.
        WeightUnknown: with `effort`, masses or all torque limits are not known.
    """
    require_instance("path", path, JointPath, "a JointPath, as `plan` returns it")
    limits = require_limits(limits)
    if isinstance(max_rate, np.ndarray):
        if max_rate.shape != (path.end,) or not np.all((max_rate > 0.0) & (max_rate < inf)):
            raise InvalidValue("max_rate", max_rate, f"one number > 0, or ({path.end:g},) finite ones")
    elif max_rate != inf:
        require_positive("max_rate", max_rate)
    require_positive("initial_speed", initial_speed, zero=True)
    require_instance("effort", effort, bool, "True or False")
    if effort:
        path.arm.require_effort()
        path.arm.require_masses()
    return time_path(path, limits, max_rate, initial_speed, effort, strict=effort)


def time_path(
    path: JointPath,
    limits: Limits,
    max_rate: float | Array = inf,
    initial_speed: float = 0.0,
    effort: bool = False,
    strict: bool = False,
) -> TimedPath:
    """Return a path with its time parameterization; as `retime`, without its checks.

    Args:
        path: the path.
        limits: the limits of each step.
        max_rate: as for `retime`.
        initial_speed: likewise.
        effort: likewise.
        strict: whether a path that the motors cannot hold is refused.
    """
    arm = path.objective.arm
    bounds = limits.for_arm(arm)
    torques = profile_effort(arm, bounds, effort)
    profile = None
    if bounds.brake is not None or torques is not None or np.all(np.isfinite(max_rate)):
        path = path.within(bounds.position_limits)
        profile = SpeedProfile(path, bounds, max_rate, initial_speed, torques, strict)
    return TimedPath(path, limits, bounds, profile, max_rate, effort)
