"""Keyframes to a motion: curves interpolated in time, and the joint positions that take them."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Iterable, Sequence
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pinposture._validation import require_positive
from pinposture.arm import Arm
from pinposture.errors import InvalidValue, TaskError, UnknownName
from pinposture.placement.least_squares import refined
from pinposture.task.interpolation import Bending, BentCurve, crossfade, ramp, window
from pinposture.task.keyframe import (
    CONTINUITIES,
    Keyframe,
    Schedule,
    Stretch,
    interpolate,
    naming,
    schedule,
    title,
)
from pinposture.task.reference import Mark, Reference
from pinposture.task.resolving import Follower, InTurn, Keyed, resolve_keyframes, taken, tip_shift

# From keyframe to keyframe: the curves in between, and joint positions that take them.

Array = NDArray[np.float64]
Progress = Callable[[int, int], object]

CHUNK = 128
"""Curves that are made at a time."""

STEP, TOO_FAR = 0.05, 0.06
"""Joint motion from one row to the next that is aimed at, and that is still taken, in `Arm.joint_units`."""

HALVINGS, CONTINUOUS = 8, 0.1
"""How often time is halved to see whether a long step is a jump, and the share of it that is none."""

AS_GOOD, NEARLY = 1e-7, 0.01
"""How much farther from its curve than if it were resolved by itself a keyframe may be that is taken from the
one before: in arm lengths, and in module lengths if other ways there lead farther off the curves."""

NEAR, FAR = 0.05, 0.02
"""Joint motion over which a keyframe is met by a shift of the rows before [rad], and how far off the curve
the arm may be in between before other configurations are looked for [module lengths]."""

LONGEST, LONGER = 12.0, 2.5
"""How far joints move at most from keyframe to keyframe, if they move as fast as they may all the time [rad];
more if keyframes are farther than that apart, by a factor. So there is no jump where an optimum ends."""

PLACES, SEEN = 13, 33
"""Where a change to other configurations is tried, and the rows at which its cost is looked up."""


class Curves:
    """The curves of a stretch, made when they are asked for."""

    def __init__(self, bending: Bending, vectors: Array, stretch: Stretch, continuity: str) -> None:
        self._bending, self._vectors, self._stretch = bending, vectors, stretch
        self._continuity, self._chunk = continuity, -1
        self._made: list[BentCurve] = []

    def of(self, rows: Iterable[float]) -> list[BentCurve]:
        """Curves at some rows, which need not be whole."""
        asked = np.fromiter(rows, dtype=np.float64)
        return self._bending.curves(interpolate(self._stretch, self._vectors, self._continuity, asked))

    def at(self, row: int) -> BentCurve:
        """The curve at a row; cheap if its neighbours are asked for as well."""
        chunk, place = divmod(row, CHUNK)
        if chunk != self._chunk:
            self._chunk, self._made = chunk, self.of(range(CHUNK * chunk, CHUNK * (chunk + 1)))
        return self._made[place]


class Piece(NamedTuple):
    """What is known of a keyframe at one end of a piece of the motion.

    Attributes:
        row: its row.
        unknowns: of the fit that takes it, see `Follower`.
        pinned: whether these have to be met, and not only its curve as well as they do.
    """

    row: int
    unknowns: Array
    pinned: bool


class Between:
    """Finds joint positions for all rows.

    Sequential placement serves where it can, for a whole stretch between rests, if it leads continuously from
    keyframe to keyframe. Elsewhere least squares follow the curve from each keyframe to the next; and back
    from the next one, where that leads nowhere good; from the one to the other where it costs least.
    """

    def __init__(self, arm: Arm, keyed: Keyed, continuity: str) -> None:
        self._arm, self._keyed, self._continuity = arm, keyed, continuity
        self._bending = Bending(arm, keyed.length)
        vectors: list[Array] = []
        for keyframe in keyed.keyframes:
            vectors.append(self._bending.vector(keyframe.begun, vectors[-1] if vectors else None))
        self._vectors = np.array(vectors)
        in_turn = keyed.method == "sequential"
        self._in_turn = InTurn(arm) if in_turn else None
        self._follower = Follower(arm, "closest" if in_turn else keyed.method)
        self._endless = arm.kinematics.endless

    def positions(self, schedule: Schedule, progress: Progress | None = None) -> Array:
        """Joint positions of all rows (N + 1, nv) [rad or m]; those of continuous joints go on past pi.

        Args:
            schedule: when each keyframe is reached and left.
            progress: called with the number of rows that are done, and that of all.
        """

        def tell(row: int) -> None:
            if progress is not None:
                progress(row, schedule.rows)

        found = np.empty((schedule.rows, self._arm.nv))
        before = self._keyed.keyframes[0].positions
        found[: schedule.left[0] + 1] = before
        for stretch in schedule.stretches():
            curves = self._curves(stretch)
            rows = self._placed_in_turn(stretch, curves, before, tell)
            if rows is None:
                rows = self._followed(stretch, curves, before, tell)
            before = rows[-1]
            found[stretch.rows[0] : stretch.rows[-1] + 1] = rows
            found[stretch.rows[-1] : schedule.left[stretch.last] + 1] = before
        return np.asarray(np.clip(found, self._arm.limits.lower, self._arm.limits.upper))

    def _curves(self, stretch: Stretch) -> Curves:
        vectors = self._vectors[stretch.first : stretch.last + 1]
        return Curves(self._bending, vectors, stretch, self._continuity)

    def _near(self, positions: Array, before: Array) -> Array:
        """The same positions, with continuous joints as many times round as before."""
        rounds = np.where(self._endless, np.round((before - positions) / (2.0 * np.pi)), 0.0)
        return np.asarray(positions + 2.0 * np.pi * rounds)

    def _placed_in_turn(
        self, stretch: Stretch, curves: Curves, before: Array, tell: Callable[[int], None]
    ) -> Array | None:
        """Joint positions of a stretch by sequential placement; None where that has none, or jumps."""
        if self._in_turn is None:
            return None
        numbers = range(int(stretch.rows[0]), int(stretch.rows[-1]) + 1)
        rows = np.empty((len(numbers), self._arm.nv))
        for i, row in enumerate(numbers):
            placed = self._in_turn.positions(curves.at(row))
            if placed is None:
                return None
            before = rows[i] = self._near(placed, before)
            if row % CHUNK == 0:
                tell(row)
        longest = (np.abs(np.diff(rows, axis=0)) / self._arm.joint_units).max(axis=1)
        for i in np.flatnonzero(longest > TOO_FAR)[np.argsort(-longest[longest > TOO_FAR])[:5]].tolist():
            if self._jumps(curves, numbers[i], rows[i], rows[i + 1]):
                return None
        # Samples of the curves between keyframes are not those of the curves themselves.
        at = stretch.rows - stretch.rows[0]
        own = [self._keyed.keyframes[k].positions for k in range(stretch.first, stretch.last + 1)]
        misses = np.array([self._near(q, rows[i]) - rows[i] for q, i in zip(own, at.tolist(), strict=True)])
        if np.abs(misses / self._arm.joint_units).max() > NEAR:  # a keyframe has joints of its own
            return None
        return np.asarray(rows + interpolate(stretch, misses, self._continuity, numbers))

    def _jumps(self, curves: Curves, row: float, first: Array, last: Array) -> bool:
        """Whether sequential placement jumps between a row and the next."""
        assert self._in_turn is not None
        units, width = self._arm.joint_units, 1.0
        whole = float((np.abs(last - first) / units).max())
        for _ in range(HALVINGS):
            width /= 2.0
            placed = self._in_turn.positions(curves.of([row + width])[0])
            if placed is None:
                return True
            middle = self._near(placed, first)
            if np.abs((middle - first) / units).max() > np.abs((last - middle) / units).max():
                last = middle
            else:
                first, row = middle, row + width
        return float((np.abs(last - first) / units).max()) > CONTINUOUS * whole

    def _followed(
        self, stretch: Stretch, curves: Curves, before: Array, tell: Callable[[int], None]
    ) -> Array:
        """Joint positions of a stretch by least squares, from those at its beginning."""
        problem, in_turn = self._follower.problem, self._in_turn is not None
        first = self._keyed.keyframes[stretch.first]
        start = Piece(int(stretch.rows[0]), problem.joined(before, first.parameters), True)
        others = np.delete(np.arange(self._arm.nv), problem.columns)
        rows = np.empty((int(stretch.rows[-1]) - start.row + 1, self._arm.nv))
        rows[0] = before
        for k in range(stretch.first + 1, stretch.last + 1):
            resolved, row = self._keyed.keyframes[k], int(stretch.rows[k - stretch.first])
            own = problem.joined(self._near(resolved.positions, before), resolved.parameters)
            end = Piece(row, own, in_turn or resolved.fixed)
            unknowns = self._piece(curves, start, end)
            into = rows[start.row - int(stretch.rows[0]) :]
            for i in range(1, len(unknowns)):
                into[i] = problem.split(unknowns[i])[0]
            into[1 : len(unknowns), others] = before[others]
            before, start = into[len(unknowns) - 1].copy(), end._replace(unknowns=unknowns[-1], pinned=True)
            tell(row)
        return rows

    def _piece(self, curves: Curves, start: Piece, end: Piece) -> Array:
        """Unknowns of all rows from one keyframe to the next, (r, n + m)."""
        follower, numbers = self._follower, range(start.row, end.row + 1)
        count = len(numbers)
        first, last = curves.at(start.row), curves.at(end.row)
        begun = refined(follower.problem, first, start.unknowns)
        shift, nothing = start.unknowns - begun, np.zeros(len(begun))
        way = max(LONGEST, LONGER * float(np.abs(end.unknowns - begun).max()))
        forth = follower.march(curves.at, numbers, begun, way)
        goal = end.unknowns if end.pinned else refined(follower.problem, last, forth[-1])
        left, best = goal - forth[-1], follower.miss(last, end.unknowns)
        met = float(np.abs(left).max()) <= NEAR
        forth += ramp(count, shift, left if met else nothing)

        seen = np.unique(np.linspace(0, count - 1, SEEN).astype(np.int64))
        looked_at = curves.of(start.row + seen)

        def misses(rows: Array) -> list[float]:
            return [follower.miss(c, x) for c, x in zip(looked_at, rows[seen], strict=True)]

        def cost(rows: Array) -> float:
            return sum(miss**2 for miss in misses(rows))

        on_the_way = misses(forth)
        off, size = on_the_way[-1] - best, 1.0 / self._arm.n_modules
        if met and off <= AS_GOOD and max(on_the_way) <= best + FAR * size:
            return forth
        arrived = refined(follower.problem, last, end.unknowns)
        back = follower.march(curves.at, numbers[::-1], arrived, way)[::-1]
        back = back + ramp(count, nothing, end.unknowns - arrived)
        places = np.unique(np.linspace(0, count - 1 - window(count), PLACES).astype(np.int64))
        ways = [crossfade(forth, back, int(place)) for place in places]
        return min([forth, *ways] if met and off <= NEARLY * size else ways, key=cost)


# Keyframes to a reference: curves interpolated in time, and the targets that are resolved along them.

__all__ = ["Keyframe", "keyframe_reference"]

logger = logging.getLogger(__name__)

FASTEST = 1.9
"""How many times its mean a velocity is at most from one keyframe to the next, as a first guess."""

LEAST_ROWS, MOST_ROWS = 16, 200_000
"""The fewest rows from one keyframe to the next, and the most in all that are made for short steps."""

TRIES = 3
"""How often rows are made, finer each time, until the steps between them are short."""


def keyframe_reference(
    arm: Arm,
    keyframes: Sequence[Keyframe],
    interval: float,
    continuity: Literal["velocity", "acceleration"] = "velocity",
    progress: Progress | None = None,
) -> Reference:
    """Make the motion that takes a posture after the other, at given times.

    Between keyframes the curve is interpolated smoothly in time by its bending (see `interpolation`), and the
    target resolved along it, each row from the one before. At keyframes the curve is the user's own. Times
    are rounded to whole control cycles.

    All keyframes are resolved by one method, as far as they leave it open: sequential placement if that
    serves all of them and leads continuously from each to the next, else least squares. Where the curve in
    between bends more than the arm can, the arm comes as near to it as it can.

    While the arm is on the way from one keyframe to the next, a control point has a target if it has one at
    either of them.

    Args:
        arm: the arm.
        keyframes: in order, two at least.
        interval: duration of a control cycle [s]. There are one or more rows to each, so that joints move
            about 0.05 rad from one row to the next, if that takes less than `MOST_ROWS` rows.
        continuity: what is continuous in time: the "velocity" of the curve, which then is monotone between
            keyframes; or the "acceleration" too, which may overshoot. Both are zero at the first and the last
            keyframe and at those with a hold.
        progress: called with the number of rows that are done, and that of all.

    Returns:
        The reference, with a mark for each keyframe.

    Raises:
        InvalidValue: fewer than two keyframes, something else among them, an interval that is none.
        UnknownName: a `continuity` that does not exist.
        TaskError: times that do not increase, a curve that is too long, a strict task of the tip that is out
            of reach; names the keyframe.
        TargetError: as `resolve_targets`, with the name of the keyframe in front.
    """
    given = tuple(keyframes)
    if len(given) < 2 or not all(isinstance(each, Keyframe) for each in given):
        raise InvalidValue("keyframes", keyframes, "two or more of Keyframe(...)")
    require_positive("interval", interval)
    if continuity not in CONTINUITIES:
        raise UnknownName("continuity", continuity, CONTINUITIES)
    cycles = schedule(given, float(interval))
    for index, keyframe in enumerate(given):
        if keyframe.region is not None and keyframe.region[1] >= arm.n_modules:
            allowed = f"control points 0 to {arm.n_modules - 1}"
            raise TaskError(title(given, index), f"its region is {keyframe.region}; the arm has {allowed}")
    keyed = resolve_keyframes(arm, given)
    between = Between(arm, keyed, continuity)
    finer = _first_guess(arm, cycles, keyed)
    for attempt in range(TRIES):
        rows = cycles.finer(finer)
        positions = between.positions(rows, progress)
        positions = _with_tips(arm, given, keyed, rows, positions, continuity)
        longest = float((np.abs(np.diff(positions, axis=0)) / arm.joint_units).max())
        more = _finer(cycles, math.ceil(finer * longest / STEP))
        logger.debug("%d rows, the longest step %.3g", rows.rows, longest)
        if longest <= TOO_FAR or more <= finer or attempt == TRIES - 1:
            break
        finer = more
    if progress is not None:
        progress(rows.rows, rows.rows)
    start = arm.configuration(positions[0])
    offsets = positions - positions[0]
    marks, masks = [], []
    for index, resolved in enumerate(keyed.keyframes):
        row = int(rows.reached[index])
        q = arm.integrate(start, offsets[row])
        target = taken(arm, given[index], resolved.target, q)
        masks.append(target.weights)
        marks.append(Mark(given[index].name or title(given, index), row, target, given[index].tip))
    return Reference(arm, interval / finer, start, offsets, _weights(rows, masks), tuple(marks))


def _first_guess(arm: Arm, cycles: Schedule, keyed: Keyed) -> int:
    """How many rows to a cycle make steps short, to judge by what keyframes are apart."""
    positions = np.array([each.positions for each in keyed.keyframes])
    apart = (np.abs(np.diff(positions, axis=0)) / arm.joint_units).max(axis=1)
    speed = FASTEST * float((apart / (cycles.reached[1:] - cycles.left[:-1])).max())
    return _finer(cycles, max(math.ceil(LEAST_ROWS / cycles.shortest), math.ceil(speed / STEP)))


def _finer(cycles: Schedule, wanted: int) -> int:
    """So many rows to a cycle, but not too many in all."""
    return max(1, min(wanted, MOST_ROWS // cycles.rows))


def _with_tips(
    arm: Arm,
    keyframes: tuple[Keyframe, ...],
    keyed: Keyed,
    rows: Schedule,
    positions: Array,
    continuity: str,
) -> Array:
    """The rows shifted so that keyframes do what is asked of their tips; smoothly in between."""
    shifts = np.zeros((len(keyframes), arm.nv))
    for index, keyframe in enumerate(keyframes):
        if keyframe.tip is not None:
            q = arm.configuration(positions[rows.reached[index]])
            with naming(title(keyframes, index)):
                target, where = keyed.keyframes[index].target, title(keyframes, index)
                shifts[index] = tip_shift(arm, keyframe, target, q, where)
    if not np.any(shifts):
        return positions
    shifted = positions.copy()
    for stretch in rows.stretches():
        numbers = np.arange(stretch.rows[0], stretch.rows[-1] + 1)
        own = shifts[stretch.first : stretch.last + 1]
        shifted[numbers] += interpolate(stretch, own, continuity, numbers)
    for shift, reached, left in zip(shifts, rows.reached, rows.left, strict=True):
        if left > reached:
            shifted[reached : left + 1] = positions[reached : left + 1] + shift
    return np.asarray(np.clip(shifted, arm.limits.lower, arm.limits.upper))


def _weights(rows: Schedule, masks: list[Array]) -> Array:
    """Which control points have a target at each row, (N + 1, m)."""
    weights = np.empty((rows.rows, len(masks[0])))
    for index, mask in enumerate(masks):
        weights[rows.reached[index] : rows.left[index] + 1] = mask
        if index > 0:
            weights[rows.left[index - 1] + 1 : rows.reached[index]] = np.maximum(masks[index - 1], mask)
    return weights
