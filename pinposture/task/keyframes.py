"""From keyframes to a reference: curves interpolated over time, and joint positions for them."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from typing import Literal, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from pinposture._validation import (
    require_function,
    require_instance,
    require_known,
    require_positive,
    require_whole,
)
from pinposture.arm import Arm
from pinposture.control.limits import Limits
from pinposture.control.reach import require_within_reach
from pinposture.errors import InvalidValue, OutOfReach, warn_caller
from pinposture.kernels.arrays import FULL_TURN
from pinposture.placement.least_squares import FitProblem
from pinposture.task.keyframe import (
    CONTINUITIES,
    MOST_CYCLES,
    Keyframe,
    LeastSquaresFollower,
    ResolvedMotion,
    Schedule,
    SequentialFollower,
    Stretch,
    as_keyframes,
    check_keyframes,
    end_off,
    interpolate,
    lap_of,
    naming,
    resolve_keyframes,
    schedule,
    target_at,
    tip_shift,
    title,
)
from pinposture.task.reference import Bending, BentCurve, Reference, Waypoint, crossfade, ramp, window

__all__ = ["Keyframe", "keyframe_reference"]

logger = logging.getLogger(__name__)

# Joint positions for all rows between keyframes.

Array = NDArray[np.float64]
Progress = Callable[[int, int], object]


class TransitionSettings(NamedTuple):
    """How the rows from one keyframe to the next are found, and when other configurations are tried."""

    curves_per_chunk: int = 128
    """Number of curves that are computed at a time."""

    row_step: float = 0.05
    max_row_step: float = 0.06
    """Intended and largest accepted joint motion from one row to the next, in `Arm.joint_units`."""

    jump_halvings: int = 8
    jump_share: float = 0.1
    """Bisections in time that distinguish a jump from a long step, and the share of the step that may
    remain."""

    equal_error: float = 1e-7
    similar_error: float = 0.01
    """How much farther off its curve a keyframe may be if reached from the previous one than if resolved
    alone: in arm lengths, and in module lengths if other paths are farther off the curves."""

    max_shift: float = 0.05
    max_extra_error: float = 0.02
    """Largest joint motion by which the rows before a keyframe may be shifted to meet it [rad], and how
    much farther off the curve the arm may be in between before other configurations are tried [module
    lengths]."""

    min_travel: float = 12.0
    travel_ratio: float = 2.5
    """Largest joint motion from keyframe to keyframe: in rad, or relative to their distance if that is
    more. It prevents jumps where a local optimum ends."""

    most_solved: int = 400
    """Largest number of rows from one keyframe to the next at which least squares place the arm; cubic
    splines interpolate the rows in between. With 400 of 1,200, arms of 6 and 8 modules on the way to a bow
    are off by 2.4e-6 and 1.9e-7 rad at the others."""

    crossfade_starts: int = 13
    cost_rows: int = 33
    """Number of rows at which a transition to other configurations is tried, and its cost computed."""

    peak_speed_ratio: float = 1.9
    """Estimated ratio of the largest to the mean speed from one keyframe to the next."""

    min_rows: int = 16
    max_rows: int = 200_000
    """Smallest number of rows from one keyframe to the next, if that many rows in all suffice for it."""

    enough_rows: int = 10_000
    enough_rows_per_cycle: int = 4
    """Numbers of rows in all, and per cycle, beyond which long steps do not add rows. Those that a short
    time needs multiply the rows of all other times; 4 per cycle are enough for 10 rad/s in cycles of 20
    ms."""

    max_refinements: int = 3
    """Number of attempts, each with more rows, to make the steps between rows short."""


TRANSITION = TransitionSettings()


class StretchCurves:
    """The curves of a stretch, computed on demand.

    Args:
        bending: converts vectors to curves.
        vectors: those of the keyframes, (k, d).
        stretch: the stretch.
        continuity: one of `CONTINUITIES`.
    """

    def __init__(self, bending: Bending, vectors: Array, stretch: Stretch, continuity: str) -> None:
        self._bending = bending
        self._vectors = vectors
        self._stretch = stretch
        self._continuity = continuity
        self._chunk = -1
        self._made: list[BentCurve] = []

    def of(self, rows: Iterable[float]) -> list[BentCurve]:
        """Return the curves at rows, which are not necessarily whole."""
        numbers = np.fromiter(rows, dtype=np.float64)
        return self._bending.curves(interpolate(self._stretch, self._vectors, self._continuity, numbers))

    def at(self, row: int) -> BentCurve:
        """Return the curve at a row; efficient for consecutive rows."""
        chunk, offset = divmod(row, TRANSITION.curves_per_chunk)
        if chunk != self._chunk:
            begin = TRANSITION.curves_per_chunk * chunk
            self._made = self.of(range(begin, begin + TRANSITION.curves_per_chunk))
            self._chunk = chunk
        return self._made[offset]


class PieceEnd(NamedTuple):
    """A keyframe at one end of a piece of the motion.

    Attributes:
        row: its row.
        unknowns: unknowns of its fit, see `LeastSquaresFollower`.
        pinned: whether the motion has to meet these, and not only follow the curve equally well.
    """

    row: int
    unknowns: Array
    pinned: bool


class Motion(NamedTuple):
    """Joint positions for all rows.

    Attributes:
        rows: the row at which each keyframe is reached and left.
        per_cycle: rows per control cycle.
        positions: joint positions, (N + 1, nv) [rad or m]; continuous joints are unwrapped.
    """

    rows: Schedule
    per_cycle: int
    positions: Array


class RowSolver:
    """Finds joint positions for all rows.

    A whole stretch between rests is placed sequentially if that is continuous from keyframe to keyframe.
    Otherwise least squares follow the curve from each keyframe to the next. If that ends far from the next
    keyframe, they also follow it backward from there, and the motion changes over where that costs least.

    A stretch to or from a taught configuration is interpolated in joint space.
    """

    def __init__(
        self, arm: Arm, keyframes: tuple[Keyframe, ...], motion: ResolvedMotion, continuity: str
    ) -> None:
        self._arm = arm
        self._keyframes = keyframes
        self._motion = motion
        self._continuity = continuity
        self._bending = Bending(arm, motion.length)
        vector: Array | None = None
        self._vectors: list[Array | None] = []
        for keyframe in motion.keyframes:
            if keyframe.anchored is not None:
                vector = self._bending.vector(keyframe.anchored, vector)
            self._vectors.append(vector if keyframe.anchored is not None else None)
        sequential = motion.method == "sequential"
        self._sequential = SequentialFollower(arm) if sequential else None
        self._follower = LeastSquaresFollower(arm, "closest" if sequential else motion.method)
        self._endless = arm.kinematics.endless

    def solve(self, cycles: Schedule, progress: Progress | None = None) -> Motion:
        """Return the motion at given times, with rows so close that joints move little between them.

        Args:
            cycles: when each keyframe is reached and left, in control cycles.
            progress: called with the number of finished rows and the total number.
        """
        per_cycle = self._first_guess(cycles)
        for attempt in range(TRANSITION.max_refinements):
            rows = cycles.finer(per_cycle)
            positions = self._with_tips(rows, self._positions(rows, progress))
            longest = float((np.abs(np.diff(positions, axis=0)) / self._arm.joint_units).max())
            more = _rows_per_cycle(cycles, math.ceil(per_cycle * longest / TRANSITION.row_step))
            logger.debug("%d rows, the longest step %.3g", rows.rows, longest)
            if (
                longest <= TRANSITION.max_row_step
                or more <= per_cycle
                or attempt == TRANSITION.max_refinements - 1
            ):
                break
            per_cycle = more
        return Motion(rows, per_cycle, positions)

    def _positions(self, schedule: Schedule, progress: Progress | None) -> Array:
        """Return joint positions of all rows (N + 1, nv) [rad or m]; continuous joints are unwrapped."""

        def report(row: int) -> None:
            if progress is not None:
                progress(row, schedule.rows)

        positions = np.empty((schedule.rows, self._arm.nv))
        before = self._motion.keyframes[0].positions
        positions[: schedule.left[0] + 1] = before
        for stretch in schedule.stretches():
            rows = self._stretch(stretch, before, report)
            before = rows[-1]
            positions[stretch.rows[0] : stretch.rows[-1] + 1] = rows
            positions[stretch.rows[-1] : schedule.left[stretch.last] + 1] = before
        return np.asarray(np.clip(positions, self._arm.limits.lower, self._arm.limits.upper))

    def _first_guess(self, cycles: Schedule) -> int:
        """Estimate the rows per cycle for short steps from the distances between keyframes."""
        positions = np.array([keyframe.positions for keyframe in self._motion.keyframes])
        apart = (np.abs(np.diff(positions, axis=0)) / self._arm.joint_units).max(axis=1)
        speed = TRANSITION.peak_speed_ratio * float((apart / cycles.between).max())
        return _rows_per_cycle(cycles, math.ceil(speed / TRANSITION.row_step))

    def _with_tips(self, rows: Schedule, positions: Array) -> Array:
        """Shift the rows so that keyframes meet their tip tasks, smoothly in between."""
        arm = self._arm
        shifts = np.zeros((len(self._keyframes), arm.nv))
        for index, keyframe in enumerate(self._keyframes):
            if keyframe.tip is not None:
                where = title(self._keyframes, index)
                q = arm.configuration(positions[rows.reached[index]])
                with naming(where):
                    shifts[index] = tip_shift(arm, keyframe, self._motion.keyframes[index].target, q, where)
                try:
                    require_within_reach(arm, keyframe.tip)
                except OutOfReach as error:
                    warn_caller(f"{where}: {error}")
        if not np.any(shifts):
            return positions
        shifted = positions.copy()
        for stretch in rows.stretches():
            numbers = np.arange(stretch.rows[0], stretch.rows[-1] + 1)
            inner = shifts[stretch.first : stretch.last + 1]
            shifted[numbers] += interpolate(stretch, inner, self._continuity, numbers)
        for shift, reached, left in zip(shifts, rows.reached, rows.left, strict=True):
            if left > reached:
                shifted[reached : left + 1] = positions[reached : left + 1] + shift
        return np.asarray(np.clip(shifted, arm.limits.lower, arm.limits.upper))

    def _stretch(self, stretch: Stretch, before: Array, report: Callable[[int], None]) -> Array:
        """Return joint positions of the rows of a stretch, given those at its start."""
        vectors = self._vectors[stretch.first : stretch.last + 1]
        if any(vector is None for vector in vectors):
            return self._interpolate(stretch, before)
        own = np.array(cast(list[Array], vectors))
        curves = StretchCurves(self._bending, own, stretch, self._continuity)
        rows = self._place_sequentially(stretch, curves, before, report)
        return self._follow(stretch, curves, before, report) if rows is None else rows

    def _interpolate(self, stretch: Stretch, before: Array) -> Array:
        """Return joint positions of a stretch in joint space."""
        values = [before]
        for keyframe in self._motion.keyframes[stretch.first + 1 : stretch.last + 1]:
            values.append(self._unwrapped(keyframe.positions, values[-1]))
        own = np.array(values)
        numbers = np.arange(stretch.rows[0], stretch.rows[-1] + 1)
        rows = interpolate(stretch, own, self._continuity, numbers)
        rows[stretch.rows - stretch.rows[0]] = own  # to the last bit
        return rows

    def _unwrapped(self, positions: Array, before: Array) -> Array:
        """Return the positions with continuous joints in the turn nearest to the previous ones."""
        rounds = np.where(self._endless, np.round((before - positions) / FULL_TURN), 0.0)
        return np.asarray(positions + FULL_TURN * rounds)

    def _place_sequentially(
        self, stretch: Stretch, curves: StretchCurves, before: Array, report: Callable[[int], None]
    ) -> Array | None:
        """Return joint positions of a stretch; None if a row has none, or they jump."""
        if self._sequential is None:
            return None
        numbers = range(int(stretch.rows[0]), int(stretch.rows[-1]) + 1)
        rows = np.empty((len(numbers), self._arm.nv))
        for i, row in enumerate(numbers):
            placed = self._sequential.positions(curves.at(row))
            if placed is None:
                return None
            before = rows[i] = self._unwrapped(placed, before)
            if row % TRANSITION.curves_per_chunk == 0:
                report(row)
        steps = (np.abs(np.diff(rows, axis=0)) / self._arm.joint_units).max(axis=1)
        long = steps > TRANSITION.max_row_step
        for i in np.flatnonzero(long)[np.argsort(-steps[long])[:5]].tolist():
            if self._jumps(self._sequential, curves, numbers[i], rows[i], rows[i + 1]):
                return None
        # The interpolated curves are sampled differently from those of the keyframes.
        at = stretch.rows - stretch.rows[0]
        own = [self._motion.keyframes[k].positions for k in range(stretch.first, stretch.last + 1)]
        misses = [self._unwrapped(q, rows[i]) - rows[i] for q, i in zip(own, at.tolist(), strict=True)]
        if np.abs(np.array(misses) / self._arm.joint_units).max() > TRANSITION.max_shift:
            return None  # a keyframe has joints of its own
        return np.asarray(rows + interpolate(stretch, np.array(misses), self._continuity, numbers))

    def _jumps(
        self, follower: SequentialFollower, curves: StretchCurves, row: float, first: Array, last: Array
    ) -> bool:
        """Whether sequential placement jumps between a row and the next."""
        units = self._arm.joint_units
        width = 1.0
        whole = float((np.abs(last - first) / units).max())
        for _ in range(TRANSITION.jump_halvings):
            width /= 2.0
            placed = follower.positions(curves.of([row + width])[0])
            if placed is None:
                return True
            middle = self._unwrapped(placed, first)
            if np.abs((middle - first) / units).max() > np.abs((last - middle) / units).max():
                last = middle
            else:
                first = middle
                row = row + width
        return float((np.abs(last - first) / units).max()) > TRANSITION.jump_share * whole

    def _follow(
        self, stretch: Stretch, curves: StretchCurves, before: Array, report: Callable[[int], None]
    ) -> Array:
        """Return joint positions of a stretch by least squares, given those at its start.

        Slides move from their position at one keyframe to that at the next, so that the arm extends with the
        curve, and the hinges place it on the curve.
        """
        problem = self._follower.problem
        keyframes = self._motion.keyframes
        begin = int(stretch.rows[0])
        end = int(stretch.rows[-1])
        keyed = np.array([keyframe.positions for keyframe in keyframes[stretch.first : stretch.last + 1]])
        slid = interpolate(stretch, keyed, self._continuity, range(begin, end + 1))
        slid[stretch.rows - begin] = keyed  # to the last bit

        def problem_at(row: int) -> FitProblem:
            return problem.with_slides(slid[row - begin])

        start = PieceEnd(begin, problem.joined(before, keyframes[stretch.first].parameters), True)
        others = np.setdiff1d(np.flatnonzero(~self._arm.slides), problem.columns)
        rows = np.empty((end - begin + 1, self._arm.nv))
        rows[0] = before
        for k in range(stretch.first + 1, stretch.last + 1):
            resolved = keyframes[k]
            row = int(stretch.rows[k - stretch.first])
            own = problem.joined(self._unwrapped(resolved.positions, before), resolved.parameters)
            goal = PieceEnd(row, own, self._sequential is not None or resolved.fixed)
            unknowns = self._follow_piece(curves, problem_at, start, goal)
            for i in range(1, len(unknowns)):
                rows[start.row - begin + i] = problem_at(start.row + i).split(unknowns[i])[0]
            rows[start.row - begin + 1 : row - begin + 1, others] = before[others]
            before = rows[row - begin].copy()
            start = goal._replace(unknowns=unknowns[-1], pinned=True)
            report(row)
        return rows

    def _follow_piece(
        self,
        curves: StretchCurves,
        problem_at: Callable[[int], FitProblem],
        start: PieceEnd,
        end: PieceEnd,
    ) -> Array:
        """Return unknowns of all rows from one keyframe to the next, (r, n + m)."""
        count = end.row - start.row + 1
        every = math.ceil((count - 1) / TRANSITION.most_solved)
        solved = np.append(np.arange(0, count - 1, every), count - 1)
        bent = curves.of(start.row + solved)
        problems = [problem_at(row) for row in (start.row + solved).tolist()]
        fitted = problems[0].solve(bent[0], start.unknowns)
        shift = start.unknowns - fitted
        zero = np.zeros(len(fitted))
        distance = float(np.abs(end.unknowns - fitted).max())
        travel = max(TRANSITION.min_travel, TRANSITION.travel_ratio * distance)
        forward = _filled(solved, self._follower.follow(bent, problems, fitted, travel))
        arrival = problems[-1]
        last = bent[-1]
        goal = end.unknowns if end.pinned else arrival.solve(last, forward[-1])
        left = goal - forward[-1]
        best = arrival.distance(last, end.unknowns)
        met = float(np.abs(left).max()) <= TRANSITION.max_shift
        forward += ramp(count, shift, left if met else zero)

        sampled = np.unique(np.linspace(0, count - 1, TRANSITION.cost_rows).astype(np.int64))
        sampled_curves = curves.of(start.row + sampled)

        def errors(rows: Array) -> list[float]:
            return [
                problem_at(start.row + i).distance(curve, rows[i])
                for i, curve in zip(sampled.tolist(), sampled_curves, strict=True)
            ]

        def cost(rows: Array) -> float:
            return sum(error**2 for error in errors(rows))

        between = errors(forward)
        excess = between[-1] - best
        module = 1.0 / self._arm.n_modules
        most = best + TRANSITION.max_extra_error * module
        if met and excess <= TRANSITION.equal_error and max(between) <= most:
            return forward
        arrived = arrival.solve(last, end.unknowns)
        backward = self._follower.follow(bent[::-1], problems[::-1], arrived, travel)[::-1]
        backward = _filled(solved, backward) + ramp(count, zero, end.unknowns - arrived)
        starts = np.linspace(0, count - 1 - window(count), TRANSITION.crossfade_starts)
        mixed = [crossfade(forward, backward, int(at)) for at in np.unique(starts.astype(np.int64))]
        usable = met and excess <= TRANSITION.similar_error * module
        return min([forward, *mixed] if usable else mixed, key=cost)


def _filled(solved: NDArray[np.int64], values: Array) -> Array:
    """Return values of all rows, (r, n), from those of the solved rows (s,), (s, n)."""
    count = int(solved[-1]) + 1
    return values if len(solved) == count else np.asarray(CubicSpline(solved, values)(np.arange(count)))


# The reference.


def keyframe_reference(
    arm: Arm,
    keyframes: Sequence[Keyframe],
    interval: float,
    continuity: Literal["velocity", "acceleration"] = "velocity",
    progress: Progress | None = None,
    repeat: int = 1,
    limits: Limits | None = None,
) -> Reference:
    """Plan the motion through keyframes at given times.

    Between keyframes the bending of the curve is interpolated smoothly over time (see `Bending`), and the arm
    placed on it, each row starting from the previous one. Times are rounded to whole control cycles.

    All keyframes with an open method are resolved by the same one: sequential placement if it works for all
    of them and is continuous from each to the next, otherwise least squares. Where the curve in between bends
    more than the arm can, the arm comes as close to it as possible.

    To and from taught configurations the joints are interpolated, with the same timing. The arm is at rest
    between such a motion and one along curves.

    Between two keyframes, a control point has a target if it has one at either of them.

    The shape of the motion depends on the times between keyframes relative to each other. Where limits allow
    no motion as fast as that, it is the shape for times that they allow: asking for less time then changes
    nothing, and never makes the motion take longer.

    Args:
        arm: the arm.
        keyframes: two or more, in order.
        interval: duration of a control cycle [s]. Each has one or more rows, so that joints move about
            0.05 rad from one row to the next; farther if the times are much too short for the motion.
        continuity: what is continuous over time: the "velocity" of the curve, or also the "acceleration". The
            curve changes monotonically between keyframes, and is at rest at the first and the last keyframe
            and at those with a hold.
        progress: called with the number of finished rows and the total number.
        repeat: number of laps. If the last posture is not the first, the arm returns to the first in between,
            within the `duration` of the first keyframe; by default, within the longest time from one
            keyframe to the next. Each lap begins and ends at rest.
        limits: limits of the motion, of which speeds and accelerations count here; None: no limits.

    Returns:
        The reference at the times asked for, with a waypoint for each keyframe of each lap.

    Raises:
        InvalidValue: fewer than two keyframes, or an invalid keyframe, interval or number of laps.
        UnknownName: a `continuity` that does not exist.
        TaskError: times that do not increase, a tip task with priority that is out of reach; names the
            keyframe.
        TargetError: as `resolve_targets`; names the keyframe.
    """
    keyframes = as_keyframes(keyframes)
    check_keyframes(keyframes, arm)
    require_positive("interval", interval)
    require_known("continuity", continuity, CONTINUITIES)
    require_whole("repeat", repeat, 1)
    require_function("progress", progress)
    require_instance("limits", limits, Limits | None, "Limits(...), or None")
    tour = keyframes
    keyframes = tour if repeat == 1 else lap_of(tour, float(interval))
    cycles = schedule(keyframes, float(interval))
    cycles.rests[len(tour) - 1] = True
    most = MOST_CYCLES // (cycles.rows - 1)
    if repeat > most:
        raise InvalidValue("repeat", repeat, f"{most} at most, {MOST_CYCLES} control cycles")
    motion = resolve_keyframes(arm, keyframes)
    if repeat > 1:  # a lap ends as it begins, to the last bit
        again = motion.keyframes[0]._replace(fixed=True)
        motion = motion._replace(keyframes=(*motion.keyframes[:-1], again))
    solver = RowSolver(arm, keyframes, motion, continuity)
    solved = solver.solve(cycles, progress)
    slowed = None if limits is None else _slowed(arm, keyframes, motion, cycles, solved, limits)
    if slowed is not None:
        solved = solver.solve(slowed, progress)
    rows, per_cycle, positions = solved
    if progress is not None:
        progress(rows.rows, rows.rows)
    start = arm.configuration(positions[0])
    offsets = positions - positions[0]
    waypoints: list[Waypoint] = []
    for index, keyframe in enumerate(keyframes):
        row = int(rows.reached[index])
        q = arm.integrate(start, offsets[row])
        target = target_at(arm, keyframe, motion.keyframes[index].target, q)
        if index == len(tour):  # returned to the first
            target = waypoints[0].target
        name = keyframe.name or title(keyframes, index % len(tour))
        off = end_off(arm, keyframe, target)
        waypoints.append(Waypoint(name, row, target, keyframe.tip, keyframe.speed, end_off=off))
    weights = _weights(rows, [waypoint.target.weights for waypoint in waypoints])
    lap = Reference(arm, interval / per_cycle, start, offsets, weights, tuple(waypoints), numbered=True)
    if slowed is not None:
        durations = np.full(rows.rows - 1, interval / per_cycle)
        for k, duration in enumerate(interval * cycles.between / rows.between):
            durations[rows.left[k] : rows.reached[k + 1]] = duration
        lap = replace(lap, interval=float(durations.min()), durations=durations)
    return lap if repeat == 1 else _repeated(lap, len(tour), int(rows.left[len(tour) - 1]), repeat)


def _repeated(lap: Reference, count: int, end: int, repeat: int) -> Reference:
    """Repeat a lap of `count` keyframes; the last one ends at row `end`, before the return to the first."""
    rows = lap.rows - 1
    turns = np.where(lap.arm.kinematics.endless, np.round(lap.offsets[-1] / FULL_TURN), 0.0)
    offsets = []
    weights = []
    durations = []
    waypoints = [lap.waypoints[0]._replace(name=f"{lap.waypoints[0].name}, lap 1")]
    for number in range(repeat):
        last = number == repeat - 1
        kept = end + 1 if last else rows
        offsets.append(lap.offsets[:kept] + FULL_TURN * number * turns)
        weights.append(lap.weights[:kept])
        durations.append(np.diff(lap.times[: end + 1 if last else None]))
        for index, waypoint in enumerate(lap.waypoints[1 : count if last else None], start=1):
            name = f"{waypoint.name}, lap {number + 1 + index // count}"  # the return begins the next lap
            waypoints.append(waypoint._replace(name=name, row=number * rows + waypoint.row))
    return replace(
        lap,
        offsets=np.concatenate(offsets),
        weights=np.concatenate(weights),
        durations=None if lap.durations is None else np.concatenate(durations),
        waypoints=tuple(waypoints),
    )


def _slowed(
    arm: Arm,
    keyframes: tuple[Keyframe, ...],
    motion: ResolvedMotion,
    cycles: Schedule,
    solved: Motion,
    limits: Limits,
) -> Schedule | None:
    """Return a schedule with the cycles that limits require between keyframes; None if those there suffice.

    No motion is faster, whatever happens between the keyframes: from one at which a joint rests, it has to
    gain speed, and to lose it until the next at which it rests.

    Args:
        arm: the arm.
        keyframes: the keyframes.
        motion: the same, resolved.
        cycles: the schedule asked for, in cycles.
        solved: the motion at these times.
        limits: limits of the motion.
    """
    bounds = limits.for_arm(arm)
    moves = np.diff(solved.positions[solved.rows.reached], axis=0) * arm.moved
    rests = np.repeat(cycles.rests[:, None], arm.nv, axis=1)
    taught = np.array([keyframe.anchored is None for keyframe in motion.keyframes])
    turns = moves[:-1] * moves[1:] <= 0.0  # `interpolate` stops a joint where it turns back
    rests[1:-1] |= turns & taught[1:-1, None]
    ends = rests[:-1].astype(np.int64) + rests[1:]
    distance = np.abs(moves)
    speed = bounds.bound * np.array([[keyframe.speed] for keyframe in keyframes[1:]])
    needed = np.divide(distance, speed, out=np.zeros_like(distance), where=distance > 0.0)
    if bounds.brake is not None:
        gaining = ends * speed / (2.0 * bounds.brake)  # cycles lost at both ends, if full speed is reached
        short = distance <= speed * gaining
        needed = np.where(short, np.sqrt(2.0 * ends * distance / bounds.brake), needed + gaining)
    least = np.minimum(needed.max(axis=1), MOST_CYCLES)
    least *= TRANSITION.enough_rows / max(least.sum(), TRANSITION.enough_rows)
    between = np.maximum(cycles.between, np.floor(least).astype(np.int64))
    return None if np.array_equal(between, cycles.between) else cycles.with_between(between)


def _rows_per_cycle(cycles: Schedule, wanted: int) -> int:
    """Return the number of rows per cycle, if so many are wanted for short steps."""
    fewest = math.ceil(TRANSITION.min_rows / int(cycles.between.min()))
    enough = max(TRANSITION.enough_rows // cycles.rows, TRANSITION.enough_rows_per_cycle)
    return max(1, min(max(fewest, min(wanted, enough)), TRANSITION.max_rows // cycles.rows))


def _weights(rows: Schedule, masks: list[Array]) -> Array:
    """Return which control points have a target at each row, (N + 1, m)."""
    weights = np.empty((rows.rows, len(masks[0])))
    for index, mask in enumerate(masks):
        weights[rows.reached[index] : rows.left[index] + 1] = mask
        if index > 0:
            weights[rows.left[index - 1] + 1 : rows.reached[index]] = np.maximum(masks[index - 1], mask)
    return weights
