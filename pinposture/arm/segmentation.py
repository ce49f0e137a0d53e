"""Where one module ends and the next begins (Section 4.1)."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from pinposture.arm.pattern import Repetition, repetitions
from pinposture.arm.placing import Placing
from pinposture.arm.skeleton import Skeleton
from pinposture.errors import InvalidValue

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
        adequate: False if the end of some module cannot be placed on every curve, for instance where axes are
            parallel in an arm that leaves every plane; None if not asked.
    """

    sizes: tuple[int, ...]
    reason: str
    period: int | None = None
    adequate: bool | None = None


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
        return Segmentation(tuple(sizes), reason, None, adequate=False)
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
    return Segmentation(tuple(sizes), "; ".join(parts), found.period if found else None, adequate=not bound)


def _joints(count: int) -> str:
    return "1 joint" if count == 1 else f"{count} joints"
