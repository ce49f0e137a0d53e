"""Where one module ends and the next begins (Section 4.1)."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from pinposture.arm.chain import PARALLEL, Skeleton
from pinposture.errors import InvalidValue

# Where the joints of an arm repeat.

Array = NDArray[np.float64]

ALIKE = 0.02
"""How far links that count as equal may differ, relative to the mean distance between joints."""
LONGEST_PERIOD = 12


class Repetition(NamedTuple):
    """A stretch of joints that repeats a shorter one at least twice.

    Attributes:
        period: number of joints after which it repeats.
        first: index of the first joint of the stretch.
        stop: index after its last joint.
    """

    period: int
    first: int
    stop: int


def repetitions(skeleton: Skeleton) -> list[Repetition]:
    """Every stretch of the arm that repeats, shortest period first.

    Two joints are alike if both turn or both slide and the links after them are alike up to a rigid motion
    or reflection. A link is described by quantities that no joint position and no choice of frames changes:
    its length, how far along either joint axis it reaches, the angle between the axes and their volume with
    the link. The link of the last joint of the stretch may differ, for what follows it may.
    """
    links, n = _links(skeleton), len(skeleton.names)
    found = []
    for period in range(1, min(n // 2, LONGEST_PERIOD) + 1):
        same_kind = skeleton.revolute[:-period] == skeleton.revolute[period:]
        difference = np.abs(links[:-period] - links[period:])
        same_link = np.all(~(difference > ALIKE), axis=1)  # the last joint has no axis after it: NaN
        u = 0
        while u < n - period:
            first = u
            while u < n - period and same_kind[u] and same_link[u]:
                u += 1
            stop = u + period + (1 if u < n - period and same_kind[u] else 0)
            if stop - first >= 2 * period:
                found.append(Repetition(period, first, stop))
            u += 1
    return found


def _links(skeleton: Skeleton) -> Array:
    """Invariants of the link after each joint, (n, 5), lengths relative to the mean."""
    spans = np.diff(skeleton.stations, axis=0) * (len(skeleton.names) / skeleton.length)
    before = skeleton.axes
    after = np.vstack([skeleton.axes[1:], np.full(3, np.nan)])
    along_before = np.einsum("ui,ui->u", before, spans)
    along_after = np.einsum("ui,ui->u", after, spans)
    angle = np.einsum("ui,ui->u", before, after)
    volume = np.einsum("ui,ui->u", np.cross(before, after), spans)
    invariants = np.stack([along_before, along_after, angle, volume], axis=1)
    return np.column_stack([np.linalg.norm(spans, axis=1), np.abs(invariants)])


# Can a group of joints put its end on a curve? The question that decides where a module ends (Section 4.1).
#
# The end must be able to move in every direction across the line from the base of the group to its end: in
# two of them in space, in one in the plane. Whether it can is a matter of the joints, not of the posture
# that the file calls zero, so it is asked in several postures; a straight or folded one would give the wrong
# answer.

POSTURES = 16
LEAST_MOTION = 0.05
"""How far one radian must move the end across, relative to its distance from the base of the group."""
LEAST_DISTANCE = 1e-3
"""How far the end must be from the base of the group, relative to the mean distance between joints."""
_SWING = 1.2
"""Largest excursion of a joint from its position nearest zero in the postures that are tried [rad]."""


class _Motion(NamedTuple):
    """How joints move their end across the line from their base to it, for one radian and unit distance.

    Attributes:
        easiest: in the direction in which they move it farthest.
        hardest: in the last of the directions that a curve asks for.
        movers: how many of them move it.
    """

    easiest: float
    hardest: float
    movers: int


class Placing:
    """Answers for one arm, remembered.

    Attributes:
        needed: in how many directions across a curve asks an end to move: two in space, one in the plane.
    """

    def __init__(self, skeleton: Skeleton) -> None:
        self._skeleton = skeleton
        self._pitch = skeleton.length / len(skeleton.names)
        self._known: dict[tuple[int, int], _Motion] = {}
        swing = np.where(skeleton.revolute, _SWING, self._pitch)
        middle = np.clip(0.0, skeleton.lower, skeleton.upper)
        swing[skeleton.base_slides] = 0.0
        low, high = np.maximum(skeleton.lower, middle - swing), np.minimum(skeleton.upper, middle + swing)
        self._positions = np.random.default_rng(0).uniform(low, high, (POSTURES, len(middle)))
        self.needed = 2 if skeleton.normal is None else 1
        self._leaving = _leaving(skeleton)

    def __call__(self, first: int, stop: int) -> bool:
        """True if joints first, ..., stop - 1 can place station `stop` on any curve through `first`."""
        return stop > self._leaving[first] and self.motion(first, stop) > LEAST_MOTION

    def motion(self, first: int, stop: int) -> float:
        """How far those joints move station `stop` in the direction across that is hardest for them.

        Returns:
            The motion for one radian, relative to the distance from station `first`: the median over the
            postures, not the least, because any module has singular ones. Zero if the end stays at the base.
        """
        return self._motion(first, stop).hardest

    def moves(self, first: int, stop: int) -> bool:
        """True if those joints move station `stop` in one direction across at least."""
        return self._motion(first, stop).easiest > LEAST_MOTION

    def movers(self, first: int, stop: int) -> int:
        """How many of those joints move station `stop` across."""
        return self._motion(first, stop).movers

    def _motion(self, first: int, stop: int) -> _Motion:
        if (first, stop) not in self._known:
            self._known[first, stop] = self._measured(first, stop)
        return self._known[first, stop]

    def _measured(self, first: int, stop: int) -> _Motion:
        normal = self._skeleton.normal
        ends, jacobians = self._motions(first, stop)
        distance = np.linalg.norm(ends, axis=1)
        apart = distance > LEAST_DISTANCE * self._pitch
        distance = np.where(apart, distance, 1.0)
        along = ends / distance[:, None]
        if normal is None:
            across = jacobians - along[:, :, None] * np.einsum("si,sij->sj", along, jacobians)[:, None]
        else:
            across = np.einsum("si,sij->sj", np.cross(normal, along), jacobians)[:, None]
        across = np.where(apart[:, None, None], across / distance[:, None, None], 0.0)
        sizes = np.zeros((POSTURES, self.needed))
        values = np.linalg.svd(across, compute_uv=False)[:, : self.needed]
        sizes[:, : values.shape[1]] = values
        single = np.median(np.linalg.norm(across, axis=1), axis=0)
        easiest, hardest = np.median(sizes, axis=0)[[0, -1]]
        # Rounded, so that groups that do the same are equal, however it was added up.
        return _Motion(round(float(easiest), 9), round(float(hardest), 9), int(np.sum(single > LEAST_MOTION)))

    def _motions(self, first: int, stop: int) -> tuple[Array, Array]:
        """End relative to the base (s, 3) [m] and its Jacobian (s, 3, k) [m/rad] in every posture tried."""
        arm = self._skeleton
        place, turn = np.zeros((POSTURES, 3)), np.broadcast_to(np.eye(3), (POSTURES, 3, 3))
        axes, origins = [], []
        for u in range(first, stop):
            amount = self._positions[:, u, None] * arm.axes[u]
            axes.append(turn @ arm.axes[u])
            origins.append(place)
            if arm.revolute[u]:
                turn = turn @ Rotation.from_rotvec(amount).as_matrix()
            else:
                place = place + np.einsum("sij,sj->si", turn, amount)
            place = place + turn @ (arm.stations[u + 1] - arm.stations[u])
        columns = [
            np.cross(axis, place - origin) if turns else axis * self._pitch
            for axis, origin, turns in zip(axes, origins, arm.revolute[first:stop], strict=True)
        ]
        # A base that drives anywhere stays where it is when the arm takes a shape.
        return place, np.where(arm.base_slides[first:stop], 0.0, np.stack(columns, axis=2))


def _leaving(skeleton: Skeleton) -> list[int]:
    """For each joint the end of the longest group from there on with parallel axes and all links across them.

    In a spatial arm such a group moves its end in one direction across: that needs no measuring. In a planar
    arm no group is too short.
    """
    n = len(skeleton.names)
    ends = list(range(1, n + 1)) if skeleton.normal is None else [0] * n
    for u in range(n - 2, -1, -1):
        turn = skeleton.revolute[u] and skeleton.revolute[u + 1]
        across = np.linalg.norm(np.cross(skeleton.axes[u], skeleton.axes[u + 1]))
        beside = np.abs(np.diff(skeleton.stations[u : u + 3], axis=0) @ skeleton.axes[u])
        flat = across < PARALLEL and np.all(beside < PARALLEL * skeleton.length)
        if skeleton.normal is None and turn and flat:
            ends[u] = ends[u + 1]
    return ends


SPARE = 4
"""How many joints beyond the fewest a module may have where nothing repeats."""

IDLE = 1
"""How many joints may move the end of a module beyond those that placing it takes."""


@dataclass(frozen=True)
class Segmentation:
    """How the joints of an arm were grouped into modules.

    Attributes:
        sizes: number of joints of each module, from base to tip.
        reason: why, in words.
        period: number of joints after which the arm repeats; None if it does not, or was not asked.
        can_follow: False if the end of some module cannot be placed on every curve, for instance where axes
            are parallel in an arm that leaves every plane; None if not asked.
    """

    sizes: tuple[int, ...]
    reason: str
    period: int | None = None
    can_follow: bool | None = None


def segment(skeleton: Skeleton) -> Segmentation:
    """Group the joints into the smallest modules whose ends can be placed on any curve.

    A module ends where the next joint sits, the last one at the tip. Its end must be able to move in every
    direction across the line from its base to its end (see `placing`), which also keeps control points apart.
    Where the arm repeats, the cuts repeat with it: they are made in one period, or in as many periods as it
    takes, and the phase is the one that gives most modules. Where it does not, there are as many modules as
    can be, cut so that the end of each moves as well as can be. Joints before and behind the repetition form
    modules of their own where they can, and join the neighbour where not, as do joints that move nothing: a
    roll about the link at the tip, a last joint with no link after it.

    A module whose end more joints move than that takes would leave the links between wherever they happen to
    be, however well its end lies on the curve: parallel axes in a row make such modules. It is cut once more,
    into pieces whose ends move in one direction across at least, as many of them as can be in both.

    Args:
        skeleton: the joints of the arm.

    Returns:
        The sizes of the modules, and why.
    """
    placing, n = Placing(skeleton), len(skeleton.names)
    choices = []
    for repetition in repetitions(skeleton):
        for head in range(repetition.first, repetition.first + repetition.period):
            cuts = _repeated(placing, repetition, head, n)
            if cuts is not None:
                sizes = _settled(placing, cuts)
                usual = Counter(sizes).most_common(1)[0][1]
                choices.append((len(sizes), usual, -head, -repetition.period, sizes, repetition))
    if choices:
        *_, sizes, found = max(choices, key=lambda choice: choice[:4])
        return _explained(skeleton, placing, _shortened(placing, sizes), found)
    sizes = _shortened(placing, _settled(placing, _most_modules(placing, n)))
    return _explained(skeleton, placing, sizes, None)


def equal_modules(joints: int, size: int) -> Segmentation:
    """The same number of joints for every module.

    Raises:
        InvalidValue: not a divisor of the number of joints.
    """
    if size < 1 or joints % size:
        divisors = ", ".join(str(k) for k in range(1, joints + 1) if joints % k == 0)
        allowed = f"a divisor of {joints} joints: {divisors}"
        raise InvalidValue("modules (joints per module)", size, allowed)
    return Segmentation((size,) * (joints // size), f"{_joints(size)} for each module, as asked")


def given_modules(joints: int, sizes: Sequence[int]) -> Segmentation:
    """A number of joints for each module.

    Raises:
        InvalidValue: numbers that are not positive or do not add up to the number of joints.
    """
    if not sizes or min(sizes) < 1 or sum(sizes) != joints:
        allowed = f"positive whole numbers that add up to {joints} joints"
        raise InvalidValue("modules (sizes)", list(sizes), allowed)
    return Segmentation(tuple(sizes), "sizes as asked")


def _filled(placing: Placing, first: int, stop: int) -> list[int]:
    """Where modules end if each is made as small as it can be; joints may be left before `stop`."""
    cuts, end = list[int](), first
    while True:
        start = end
        end = next((end for end in range(start + 1, stop + 1) if placing(start, end)), 0)
        if not end:
            return cuts
        cuts.append(end)


def _most_modules(placing: Placing, n: int) -> list[int]:
    """Where modules end if there are to be as many as possible, and the ends of all of them to move well."""
    best: dict[int, tuple[int, float, list[int]]] = {n: (0, np.inf, [])}
    for start in range(n - 1, -1, -1):
        smallest = next((end for end in range(start + 1, n) if placing(start, end)), n)
        for end in dict.fromkeys([*range(smallest, min(smallest + SPARE, n)), n]):
            if end in best and placing(start, end):
                count, motion, cuts = best[end]
                found = (count + 1, min(motion, placing.motion(start, end)), [end, *cuts])
                best[start] = max(best.get(start, found), found, key=lambda entry: entry[:2])
    return best[0][2] if 0 in best else [n]


def _cuts(placing: Placing, first: int, stop: int) -> list[int]:
    """Where modules end if each is made as small as it can be; what is left joins the last one."""
    return [*_filled(placing, first, stop)[:-1], stop]


def _repeated(placing: Placing, repetition: Repetition, head: int, n: int) -> list[int] | None:
    """Cuts that repeat from joint `head` on, or None if too little of the arm repeats in that way."""
    period, stop = repetition.period, repetition.stop
    sizes = range(period, (stop - head) // 2 + 1, period)
    unit = next((size for size in sizes if placing(head, head + size)), None)
    if unit is None:
        return None
    times = (stop - head) // unit
    if 2 * times * unit < n:
        return None
    within = [cut - head for cut in _cuts(placing, head, head + unit)]
    repeated = [head + k * unit + cut for k in range(times) for cut in within]
    tail = _cuts(placing, repeated[-1], n) if repeated[-1] < n else []
    return [*_filled(placing, 0, head), *repeated, *tail]


def _settled(placing: Placing, cuts: Sequence[int]) -> list[int]:
    """Sizes of the modules after each one that cannot place its end has joined its neighbour."""
    bounds = [0, *cuts]
    k = 0
    while k < len(bounds) - 1:
        if len(bounds) == 2 or placing(bounds[k], bounds[k + 1]):
            k += 1
        elif k > 0:
            del bounds[k]
            k -= 1
        else:
            del bounds[1]
    return [stop - start for start, stop in pairwise(bounds)]


def _shortened(placing: Placing, sizes: Sequence[int]) -> list[int]:
    """The sizes after each module that too many joints move has been cut into pieces.

    One piece that would be bound to a plane stays with its neighbour: so does a single joint elsewhere.
    """
    shortened, start = list[int](), 0
    for size in sizes:
        stop = start + size
        cuts = [stop]
        if placing.movers(start, stop) > placing.needed + IDLE:
            cuts = _most_pieces(placing, start, stop)
        pieces = list(pairwise([start, *cuts]))
        if sum(not placing(*piece) for piece in pieces) < 2:
            pieces = [(start, stop)]
        shortened.extend(b - a for a, b in pieces)
        start = stop
    return shortened


def _most_pieces(placing: Placing, first: int, stop: int) -> list[int]:
    """Where the pieces of a module end: as many as can be that place their ends, then as many as can be."""
    best: dict[int, tuple[int, int, float, list[int]]] = {stop: (0, 0, np.inf, [])}
    for start in range(stop - 1, first - 1, -1):
        smallest = next((end for end in range(start + 1, stop) if placing.moves(start, end)), stop)
        for end in dict.fromkeys([*range(smallest, min(smallest + SPARE, stop)), stop]):
            if end in best and placing.moves(start, end):
                whole, count, motion, cuts = best[end]
                whole += placing(start, end)
                found = (whole, count + 1, min(motion, placing.motion(start, end)), [end, *cuts])
                best[start] = max(best.get(start, found), found, key=lambda entry: entry[:3])
    return best[first][3] if first in best else [stop]


def _explained(
    skeleton: Skeleton, placing: Placing, sizes: Sequence[int], found: Repetition | None
) -> Segmentation:
    n = len(skeleton.names)
    if skeleton.normal is None:
        need = "the arm is spatial, so the end of a module must move in two directions across the curve"
    else:
        need = "the arm is planar, so the end of a module must move in one direction across the curve"
    if len(sizes) == 1 and not placing(0, n):
        reason = f"{need}; no group of its joints does that, so the arm is one module"
        return Segmentation(tuple(sizes), reason, None, can_follow=False)
    usual = Counter(sizes).most_common(1)[0][0]
    bounds = np.cumsum([0, *sizes])
    bound = [k for k, (start, stop) in enumerate(pairwise(bounds), 1) if not placing(start, stop)]
    if found is None:
        does = "these are the most modules that do that"
        parts = [
            need,
            f"no pattern of joints repeats; {does if not bound else does + ', and pieces of others'}",
        ]
    else:
        first, last = skeleton.names[found.first], skeleton.names[found.stop - 1]
        often = "every joint is like the next" if found.period == 1 else f"{_joints(found.period)} repeat"
        does = "does that" if not bound else "is the most common"
        parts = [need, f"from {first!r} to {last!r} {often}; a module of {_joints(usual)} {does}"]
        others = [f"module {k} has {_joints(size)}" for k, size in enumerate(sizes, 1) if size != usual]
        if others and not bound:
            listed = ", ".join(others[:4]) + (", ..." if len(others) > 4 else "")
            parts.append(
                f"{listed}: joints beside the pattern, or that move no control point, join a neighbour"
            )
    if bound:
        listed = ", ".join(map(str, bound[:8])) + (", ..." if len(bound) > 8 else "")
        parts.append(
            f"modules {listed}: too few of their joints' axes differ, so that their ends move in one "
            "direction only and follow a curve in one plane at a time"
        )
    return Segmentation(tuple(sizes), "; ".join(parts), found.period if found else None, can_follow=not bound)


def _joints(count: int) -> str:
    return "1 joint" if count == 1 else f"{count} joints"
