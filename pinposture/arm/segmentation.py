"""Grouping of the joints of an arm into modules (Section 4.1)."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from pinposture.arm.kinematics import PARALLEL, Skeleton
from pinposture.arm.module_kinematics import is_registry_empty, joints_in_base_frame, registered_kinematics
from pinposture.errors import InvalidValue

Array = NDArray[np.float64]


class SegmentationSettings(NamedTuple):
    """How modules are found in a description."""

    link_tolerance: float = 0.02
    """Largest difference between links that count as equal, relative to the mean distance between
    joints."""

    max_period: int = 12
    """Longest period of repetition to search for, in joints."""

    sampled_postures: int = 16
    """Number of postures in which the end motion of a module is measured."""

    max_sample_angle: float = 1.2
    """Largest deviation of a joint from its position nearest zero in those postures [rad]."""

    min_motion: float = 0.05
    """Smallest sideways motion of the end per radian, relative to its distance from the module base."""

    min_distance: float = 1e-3
    """Smallest distance of the end from the module base, relative to the mean distance between joints."""

    max_extra_joints: int = 4
    """Number of joints by which a module may exceed the minimum where nothing repeats."""

    max_registered_joints: int = 24
    """Largest module with registered kinematics to search for, in joints."""

    max_idle_joints: int = 1
    """Number of joints that may move the end of a module beyond those needed to place it."""


SEGMENTATION = SegmentationSettings()


@dataclass(frozen=True)
class Segmentation:
    """A grouping of the joints of an arm into modules.

    Attributes:
        sizes: number of joints of each module, from base to tip.
        reason: explanation in words.
        period: number of joints after which the arm repeats; None if it does not, or was not analysed.
        can_follow: False if the end of some module cannot be placed on every curve, for instance because of
            parallel axes in a spatial arm; None if not analysed.
    """

    sizes: tuple[int, ...]
    reason: str
    period: int | None = None
    can_follow: bool | None = None


class Repetition(NamedTuple):
    """A run of joints that repeats a shorter one at least twice."""

    period: int  # number of joints after which it repeats
    first: int  # index of the first joint of the run
    stop: int  # index after its last joint


def equal_modules(joints: int, size: int) -> Segmentation:
    """Return modules with the same number of joints each.

    Raises:
        InvalidValue: not a divisor of the number of joints.
    """
    if size < 1 or joints % size:
        divisors = ", ".join(str(k) for k in range(1, joints + 1) if joints % k == 0)
        allowed = f"a divisor of {joints} joints: {divisors}"
        raise InvalidValue("split (joints per module)", size, allowed)
    return Segmentation((size,) * (joints // size), f"{count_joints(size)} for each module, as given")


def given_modules(joints: int, sizes: Sequence[int]) -> Segmentation:
    """Return modules with given numbers of joints.

    Raises:
        InvalidValue: the numbers are not positive or do not add up to the number of joints.
    """
    if not sizes or min(sizes) < 1 or sum(sizes) != joints:
        allowed = f"positive whole numbers that add up to {joints} joints"
        raise InvalidValue("split (sizes)", list(sizes), allowed)
    return Segmentation(tuple(sizes), "sizes as given")


def segment(skeleton: Skeleton) -> Segmentation:
    """Group the joints into the smallest modules whose ends can be placed on any curve.

    A module ends at the origin of the next joint, the last one at the tip. Its end must be able to move in
    every direction perpendicular to the line from its base to its end (see `EndMobility`), which also keeps
    control points apart. If the arm repeats, so do the cuts: they use the smallest number of periods that
    works, at the phase that gives the most modules. Otherwise the arm is cut into as many modules as
    possible, with the largest mobility of their ends. Joints before and after the repetition form their own
    modules if they can, else join a neighbour, as do joints that move nothing: a roll about the link at the
    tip, or a last joint without a link after it.

    If more joints than needed move the end of a module, as with consecutive parallel axes, its intermediate
    links are undetermined even if its end lies on the curve. Such a module is cut again, into pieces whose
    ends move in at least one perpendicular direction, as many as possible of them in both.

    Joints recognised by registered kinematics (`register_module_kinematics`) form their own modules; the
    rules above apply to the joints between them.

    Raises:
        InvalidValue: registered kinematics contradict the joints.
    """
    if not is_registry_empty():
        recognised = _find_registered(skeleton)
        if recognised:
            return _around_registered(skeleton, recognised)
    return _segment_unregistered(skeleton)


def _find_registered(skeleton: Skeleton) -> list[tuple[int, int, str]]:
    """Find modules with registered kinematics: first joint, joint after the last, and class of each.

    They cover as many joints as possible; among such choices there are as many modules as possible.
    """
    n = len(skeleton.names)
    columns = skeleton.columns
    last = {column: u for u, column in enumerate(columns.tolist())}
    first = {column: n - 1 - u for u, column in enumerate(columns[::-1].tolist())}
    best: list[tuple[int, int, list[tuple[int, int, str]]]] = [(0, 0, [])] * (n + 1)
    for start in range(n - 1, -1, -1):
        best[start] = best[start + 1]
        for stop in range(start + 1, min(start + SEGMENTATION.max_registered_joints, n) + 1):
            inner_columns = columns[start:stop].tolist()
            if any(first[column] < start or last[column] >= stop for column in inner_columns):
                continue  # coupled to joints outside
            inputs = [first[column] for column in dict.fromkeys(inner_columns)]
            part = slice(start, stop)
            limits = np.array([skeleton.lower[inputs], skeleton.upper[inputs]]) / skeleton.ratios[inputs]
            joints = joints_in_base_frame(
                names=skeleton.names[part],
                revolute=skeleton.revolute[part],
                axes=skeleton.axes[part],
                stations=skeleton.stations[[start, *range(start, stop), stop]],
                columns=columns[part],
                ratios=skeleton.ratios[part],
                limits=np.sort(limits, axis=0),
            )
            kinematics = registered_kinematics(joints)
            if kinematics is not None:
                covered, count, modules = best[stop]
                entry = (covered + stop - start, count + 1)
                if entry > best[start][:2]:
                    best[start] = (*entry, [(start, stop, type(kinematics).__name__), *modules])
    return best[0][2]


def _around_registered(skeleton: Skeleton, recognised: Sequence[tuple[int, int, str]]) -> Segmentation:
    """Return the modules with registered kinematics, and those formed by the joints between them."""
    sizes = list[int]()
    can_follow = True
    at = 0
    for start, stop, _ in (*recognised, (len(skeleton.names), 0, "")):
        if at < start:
            part = slice(at, start)
            parts = {name: getattr(skeleton, name)[part] for name in ("names", "axes", "revolute", "columns")}
            parts |= {name: getattr(skeleton, name)[part] for name in ("lower", "upper", "ratios")}
            between = _segment_unregistered(
                replace(skeleton, stations=skeleton.stations[at : start + 1], **parts)
            )
            sizes.extend(between.sizes)
            can_follow = can_follow and between.can_follow is not False
        if stop:
            sizes.append(stop - start)
        at = stop
    counts = Counter(name for *_, name in recognised)
    listed = ", ".join(f"{name} ({count})" for name, count in counts.items())
    reason = f"registered kinematics recognise modules: {listed}"
    if len(sizes) > len(recognised):
        reason += f"; {len(sizes) - len(recognised)} of the joints between and beside them"
    return Segmentation(tuple(sizes), reason, can_follow=can_follow)


def _segment_unregistered(skeleton: Skeleton) -> Segmentation:
    mobility = EndMobility(skeleton)
    n = len(skeleton.names)
    choices = []
    for repetition in find_repetitions(skeleton):
        for head in range(repetition.first, repetition.first + repetition.period):
            cuts = _repeated_cuts(mobility, repetition, head, n)
            if cuts is not None:
                sizes = _merge_unplaceable(mobility, cuts)
                usual = Counter(sizes).most_common(1)[0][1]
                choices.append((len(sizes), usual, -head, -repetition.period, sizes, repetition))
    if choices:
        *_, sizes, repetition = max(choices, key=lambda choice: choice[:4])
        return _explain(skeleton, mobility, _cut_redundant(mobility, sizes), repetition)
    sizes = _merge_unplaceable(mobility, _best_cuts(mobility, 0, n, mobility.can_place))
    return _explain(skeleton, mobility, _cut_redundant(mobility, sizes), None)


def find_repetitions(skeleton: Skeleton) -> list[Repetition]:
    """Find every run of joints that repeats, shortest period first.

    Two joints are alike if both turn or both slide and the links after them are alike up to a rigid motion or
    reflection. A link is described by invariants of joint position and choice of frames: its length, its
    components along both joint axes, the angle between the axes and their triple product with the link. The
    link after the last joint of the run may differ, because the next joint may.
    """
    links = _link_invariants(skeleton)
    n = len(skeleton.names)
    repetitions = []
    for period in range(1, min(n // 2, SEGMENTATION.max_period) + 1):
        same_kind = skeleton.revolute[:-period] == skeleton.revolute[period:]
        difference = np.abs(links[:-period] - links[period:])
        # NaN for the last joint: no axis after it.
        same_link = np.all(~(difference > SEGMENTATION.link_tolerance), axis=1)
        u = 0
        while u < n - period:
            first = u
            while u < n - period and same_kind[u] and same_link[u]:
                u += 1
            stop = u + period + (1 if u < n - period and same_kind[u] else 0)
            if stop - first >= 2 * period:
                repetitions.append(Repetition(period, first, stop))
            u += 1
    return repetitions


def _link_invariants(skeleton: Skeleton) -> Array:
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


class EndMotion(NamedTuple):
    """Motion of the end of a group of joints perpendicular to its span, per radian and unit distance.

    It is the median over several postures, not the minimum, because any module has singular ones. It is zero
    if the end stays at the base.
    """

    easiest: float  # in the direction of largest motion
    hardest: float  # in the last of the required directions
    movers: int  # number of joints that move it


class EndMobility:
    """Decides whether groups of joints can place their ends on any curve; results are cached.

    The end must be able to move in every direction perpendicular to the line from the base of the group to
    its end. This is a property of the joints, not of the zero posture, so it is measured in several postures;
    a straight or folded one would give the wrong answer.

    Attributes:
        needed: number of required directions: two in space, one in the plane.
    """

    def __init__(self, skeleton: Skeleton) -> None:
        self._skeleton = skeleton
        self._pitch = skeleton.length / len(skeleton.names)
        self._known: dict[tuple[int, int], EndMotion] = {}
        swing = np.where(skeleton.revolute, SEGMENTATION.max_sample_angle, self._pitch)
        middle = np.clip(0.0, skeleton.lower, skeleton.upper)
        swing[skeleton.base_slides] = 0.0
        low = np.maximum(skeleton.lower, middle - swing)
        high = np.minimum(skeleton.upper, middle + swing)
        size = (SEGMENTATION.sampled_postures, len(middle))
        self._positions = np.random.default_rng(0).uniform(low, high, size)
        # Coupled joints move together: the first of them within the narrowest range of all.
        first, number = np.unique(skeleton.columns, return_index=True, return_inverse=True)[1:]
        self._inputs = number
        self._ratios = skeleton.ratios
        self._coupled = len(first) < len(number)
        if self._coupled:
            least = np.full(len(first), np.inf)
            np.minimum.at(least, number, swing / np.abs(skeleton.ratios))
            swing = least[number] * np.abs(skeleton.ratios)
            middle = np.clip(0.0, skeleton.lower, skeleton.upper)[first][number] * skeleton.ratios
            low = np.maximum(skeleton.lower, middle - swing)
            high = np.minimum(skeleton.upper, middle + swing)
            size = (SEGMENTATION.sampled_postures, len(first))
            amount = np.random.default_rng(0).uniform(low[first], high[first], size)
            self._positions = amount[:, number] * skeleton.ratios
        last = np.zeros(len(first), dtype=np.intp)
        np.maximum.at(last, number, np.arange(len(number)))
        # Groups may begin and end where no joint before is coupled to one after.
        opened = np.maximum.accumulate(last[number])
        self._boundaries = {0, *(k + 1 for k in np.flatnonzero(opened == np.arange(len(number))))}
        self.needed = 2 if skeleton.normal is None else 1
        self._flat_ends = _flat_ends(skeleton)

    def can_place(self, first: int, stop: int) -> bool:
        """Whether joints first, ..., stop - 1 can place station `stop` on any curve through `first`."""
        return stop > self._flat_ends[first] and self.motion(first, stop).hardest > SEGMENTATION.min_motion

    def can_move(self, first: int, stop: int) -> bool:
        """Return whether those joints move station `stop` in at least one perpendicular direction."""
        return self.motion(first, stop).easiest > SEGMENTATION.min_motion

    def motion(self, first: int, stop: int) -> EndMotion:
        """Measure how those joints move station `stop`; zero if others are coupled to them."""
        if (first, stop) not in self._known:
            apart = {first, stop} <= self._boundaries
            self._known[first, stop] = self._measure(first, stop) if apart else EndMotion(0.0, 0.0, 0)
        return self._known[first, stop]

    def _measure(self, first: int, stop: int) -> EndMotion:
        normal = self._skeleton.normal
        ends, jacobians = self._jacobians(first, stop)
        distance = np.linalg.norm(ends, axis=1)
        apart = distance > SEGMENTATION.min_distance * self._pitch
        distance = np.where(apart, distance, 1.0)
        along = ends / distance[:, None]
        if normal is None:
            across = jacobians - along[:, :, None] * np.einsum("si,sij->sj", along, jacobians)[:, None]
        else:
            across = np.einsum("si,sij->sj", np.cross(normal, along), jacobians)[:, None]
        across = np.where(apart[:, None, None], across / distance[:, None, None], 0.0)
        sizes = np.zeros((SEGMENTATION.sampled_postures, self.needed))
        values = np.linalg.svd(across, compute_uv=False)[:, : self.needed]
        sizes[:, : values.shape[1]] = values
        single = np.median(np.linalg.norm(across, axis=1), axis=0)
        easiest, hardest = np.median(sizes, axis=0)[[0, -1]]
        # Rounded so that groups of equal motion compare equal in any order of summation.
        movers = int(np.sum(single > SEGMENTATION.min_motion))
        return EndMotion(round(float(easiest), 9), round(float(hardest), 9), movers)

    def _jacobians(self, first: int, stop: int) -> tuple[Array, Array]:
        """End relative to the base (s, 3) [m] and its Jacobian (s, 3, k) [m/rad] in each sampled posture."""
        arm = self._skeleton
        count = SEGMENTATION.sampled_postures
        end = np.zeros((count, 3))
        turn = np.broadcast_to(np.eye(3), (count, 3, 3))
        axes = []
        origins = []
        for u in range(first, stop):
            amount = self._positions[:, u, None] * arm.axes[u]
            axes.append(turn @ arm.axes[u])
            origins.append(end)
            if arm.revolute[u]:
                turn = turn @ Rotation.from_rotvec(amount).as_matrix()
            else:
                end = end + np.einsum("sij,sj->si", turn, amount)
            end = end + turn @ (arm.stations[u + 1] - arm.stations[u])
        columns = [
            np.cross(axis, end - origin) if turns else axis * self._pitch
            for axis, origin, turns in zip(axes, origins, arm.revolute[first:stop], strict=True)
        ]
        # Slides that carry the base keep their positions when the arm takes a shape.
        moved = np.where(arm.base_slides[first:stop], 0.0, np.stack(columns, axis=2))
        if not self._coupled:
            return end, moved
        inputs = np.unique(self._inputs[first:stop], return_inverse=True)[1]
        sums = (inputs[:, None] == np.arange(inputs.max() + 1)) * self._ratios[first:stop, None]
        return end, moved @ sums


def _flat_ends(skeleton: Skeleton) -> list[int]:
    """For each joint, the end of the longest group from there with parallel axes perpendicular to all links.

    In a spatial arm such a group moves its end in a single direction, which needs no measurement. In a planar
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


def _smallest_modules(mobility: EndMobility, first: int, stop: int) -> list[int]:
    """Return the ends of the smallest possible modules; joints may be left over before `stop`."""
    bounds = [first]
    while end := next((k for k in range(bounds[-1] + 1, stop + 1) if mobility.can_place(bounds[-1], k)), 0):
        bounds.append(end)
    return bounds[1:]


def _exhaustive_modules(mobility: EndMobility, first: int, stop: int) -> list[int]:
    """Return the ends of the smallest possible modules; leftover joints join the last one."""
    return [*_smallest_modules(mobility, first, stop)[:-1], stop]


def _best_cuts(
    mobility: EndMobility, first: int, stop: int, admissible: Callable[[int, int], bool]
) -> list[int]:
    """Return the ends of admissible pieces, by dynamic programming.

    The pieces maximise, in this order, how many can place their ends, their number, and their mobility.
    """
    best: dict[int, tuple[int, int, float, list[int]]] = {stop: (0, 0, np.inf, [])}
    for start in range(stop - 1, first - 1, -1):
        smallest = next((end for end in range(start + 1, stop) if admissible(start, end)), stop)
        largest = min(smallest + SEGMENTATION.max_extra_joints, stop)
        for end in dict.fromkeys([*range(smallest, largest), stop]):
            if end in best and admissible(start, end):
                placed, count, motion, cuts = best[end]
                placed += mobility.can_place(start, end)
                candidate = (
                    placed,
                    count + 1,
                    min(motion, mobility.motion(start, end).hardest),
                    [end, *cuts],
                )
                best[start] = max(best.get(start, candidate), candidate, key=lambda entry: entry[:3])
    return best[first][3] if first in best else [stop]


def _repeated_cuts(mobility: EndMobility, repetition: Repetition, head: int, n: int) -> list[int] | None:
    """Return cuts that repeat from joint `head` on, or None if they would cover less than half of the arm."""
    period = repetition.period
    stop = repetition.stop
    sizes = range(period, (stop - head) // 2 + 1, period)
    unit = next((size for size in sizes if mobility.can_place(head, head + size)), None)
    if unit is None:
        return None
    times = (stop - head) // unit
    if 2 * times * unit < n:
        return None
    within = [cut - head for cut in _exhaustive_modules(mobility, head, head + unit)]
    repeated = [head + k * unit + cut for k in range(times) for cut in within]
    tail = _exhaustive_modules(mobility, repeated[-1], n) if repeated[-1] < n else []
    return [*_smallest_modules(mobility, 0, head), *repeated, *tail]


def _merge_unplaceable(mobility: EndMobility, cuts: Sequence[int]) -> list[int]:
    """Merge modules that cannot place their ends with a neighbour and return the sizes."""
    bounds = [0, *cuts]
    k = 0
    while k < len(bounds) - 1:
        if len(bounds) == 2 or mobility.can_place(bounds[k], bounds[k + 1]):
            k += 1
        elif k > 0:
            del bounds[k]
            k -= 1
        else:
            del bounds[1]
    return [stop - start for start, stop in pairwise(bounds)]


def _cut_redundant(mobility: EndMobility, sizes: Sequence[int]) -> list[int]:
    """Cut modules moved by too many joints into pieces and return the sizes.

    A single piece bound to a plane stays with its neighbour, as does a single joint elsewhere.
    """
    result = list[int]()
    start = 0
    for size in sizes:
        stop = start + size
        cuts = [stop]
        if mobility.motion(start, stop).movers > mobility.needed + SEGMENTATION.max_idle_joints:
            cuts = _best_cuts(mobility, start, stop, mobility.can_move)
        pieces = list(pairwise([start, *cuts]))
        if sum(not mobility.can_place(*piece) for piece in pieces) < 2:
            pieces = [(start, stop)]
        result.extend(b - a for a, b in pieces)
        start = stop
    return result


def _explain(
    skeleton: Skeleton, mobility: EndMobility, sizes: Sequence[int], repetition: Repetition | None
) -> Segmentation:
    n = len(skeleton.names)
    kind, directions = (
        ("spatial", "two directions") if skeleton.normal is None else ("planar", "one direction")
    )
    need = f"the arm is {kind}, so the end of a module must move in {directions} across the curve"
    if len(sizes) == 1 and not mobility.can_place(0, n):
        reason = f"{need}; no group of its joints allows that, so the arm is one module"
        return Segmentation(tuple(sizes), reason, None, can_follow=False)
    usual = Counter(sizes).most_common(1)[0][0]
    bounds = np.cumsum([0, *sizes])
    bound = [k for k, (a, b) in enumerate(pairwise(bounds), 1) if not mobility.can_place(a, b)]
    if repetition is None:
        does = "this is the largest number of modules that meet this need" + (
            ", and pieces of others" if bound else ""
        )
        parts = [need, f"no pattern of joints repeats; {does}"]
    else:
        first = skeleton.names[repetition.first]
        last = skeleton.names[repetition.stop - 1]
        often = f"{count_joints(repetition.period)} at a time" if repetition.period > 1 else "joint by joint"
        does = "meets this need" if not bound else "is the most common one"
        repeats = f"the joints from {first!r} to {last!r} repeat {often}"
        parts = [need, f"{repeats}; a module of {count_joints(usual)} {does}"]
        others = [f"module {k} has {count_joints(size)}" for k, size in enumerate(sizes, 1) if size != usual]
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
    return Segmentation(
        tuple(sizes), "; ".join(parts), repetition.period if repetition else None, can_follow=not bound
    )


def count_joints(count: int) -> str:
    """Return "1 joint", "2 joints" and so on."""
    return "1 joint" if count == 1 else f"{count} joints"
