"""Edits of a task: of a keyframe's shape as control points, of keyframes, obstacles and limits."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, TypeAlias, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import BSpline

from pinposture._validation import finite_vector, require_whole
from pinposture.arm import Arm
from pinposture.arm.weight import Load
from pinposture.collision.obstacles import Obstacle
from pinposture.control import controller_named
from pinposture.control.limits import cycle_of
from pinposture.curve import Curve
from pinposture.curve.curve import deviation
from pinposture.errors import CurveError, InvalidValue, TaskError
from pinposture.placement.target import beginning, place_curve
from pinposture.task import Keyframe, Task
from pinposture.task.follow_leader import Leader
from pinposture.task.keyframe import MOST_CYCLES, OF_A_CURVE, lap_of
from pinposture.task.phases import is_phased
from pinposture.units import length_text

Array = NDArray[np.float64]


class ShapeSettings(NamedTuple):
    """How curves are made and changed."""

    degree: int = 3
    """Degree of curves."""

    most_points: int = 32
    """Most control points of a fitted curve."""

    few_modules: int = 8
    """Number of modules up to which control points have knots of their own; of more modules, one for
    each."""

    fit_tolerance: float = 0.02
    """Deviation of a fitted curve, relative to the mean module length."""

    least_distance: float = 0.2
    """Smallest distance between control points, relative to the shortest module."""

    extra_length: float = 1.0
    """Length of a lengthened curve beyond the arm, in mean module lengths: modules cut corners."""

    most_extensions: int = 20
    """How often the last point is moved on before a curve counts as too short."""

    point_digits: int = 9
    """Digits behind the point of control points that are moved [m]."""

    joint_digits: int = 6
    """Digits behind the point of joint positions [rad or m]."""


SHAPE = ShapeSettings()


def keyframes_of(task: Task) -> tuple[Keyframe, ...]:
    """Return the keyframes of a task.

    Raises:
        TaskError: the task follows a leader and has no keyframes.
    """
    if isinstance(task.motion, Leader):  # which is a tuple, too
        raise TaskError("the task", "follows a leader; only tasks of keyframes can be edited")
    if is_phased(task.motion):
        raise TaskError("the task", "is divided into phases, of which only one can be edited at a time")
    return cast("tuple[Keyframe, ...]", task.motion)


def list_keyframes(task: Task, index: int) -> list[Keyframe]:
    """Return the keyframes of a task as a list in which the one at an index can be replaced.

    Raises:
        TaskError: there is no such keyframe, or no longer.
    """
    keyframes = list(keyframes_of(task))
    if not 0 <= index < len(keyframes):
        raise TaskError(f"keyframe {index + 1}", f"does not exist; allowed: 1 to {len(keyframes)}")
    return keyframes


@dataclass(frozen=True, eq=False)
class Shape:
    """Control points of a target curve in the world frame.

    The first is at the base of the arm and stays there. For a planar arm, the others stay in its plane.

    Attributes:
        points: (n, 3) [m], world frame; none for a taught configuration.
        degree: of the B-spline that they control.
        knots: of that B-spline, (n + degree + 1,); None for even ones, as of `Curve.spline`.
        off: largest distance between that curve and the part of the keyframe's curve that the arm needs [m];
            0 if the points are the keyframe's own.
    """

    points: Array
    degree: int = SHAPE.degree
    knots: Array | None = None
    off: float = 0.0

    @classmethod
    def of(cls, arm: Arm, keyframe: Keyframe) -> Shape:
        """Return the shape of a keyframe: its own control points, or a few that fit its curve."""
        if keyframe.curve is None:
            return cls(np.empty((0, 3)))
        laid, _ = place_curve(arm, keyframe.curve, keyframe.placement, keyframe.roll)
        begin, on_it = beginning(arm, laid)
        begin = begin if on_it else 0.0
        control_points = np.array(laid.coefficients)
        knots = laid.knots
        degree = laid.degree
        if begin == 0.0 and degree <= SHAPE.degree < len(control_points):
            if laid.control_points is not None and len(control_points) <= SHAPE.most_points:
                return cls(control_points, degree)
            if np.all(knots[: degree + 1] == knots[0]) and len(control_points) <= most_points(arm):
                return cls(control_points, degree, knots)
        end = min(laid.length, begin + required_length(arm))
        if begin > 0.0 or end < laid.length:
            laid = laid.trimmed(begin, end)
        tolerance = SHAPE.fit_tolerance * float(arm.chain.module_lengths.mean())
        try:
            fitted = laid.controlled_within(tolerance, most=SHAPE.most_points)
        except InvalidValue:  # too many windings for that many points
            fitted = laid.controlled(SHAPE.most_points)
        return cls(np.array(fitted.coefficients), fitted.degree, off=deviation(laid, fitted))

    @property
    def curve(self) -> Curve:
        """The curve that the points control.

        Raises:
            CurveError: points that give no curve.
        """
        if self.knots is None:
            return Curve.spline(self.points, self.degree)
        return Curve(self.knots, self.points, self.degree)

    def keyframe(self, before: Keyframe) -> Keyframe:
        """Return a keyframe with this shape, and all else as it was.

        The curve then stays where it was drawn, and the arm takes as much of it as it covers.

        Raises:
            CurveError: points that give no curve.
        """
        return replace(before, curve=self.curve, placement="as_is", roll=0.0, trim=True)

    def moved(self, arm: Arm, index: int, position: ArrayLike, others: Sequence[int] = ()) -> Shape:
        """Return the shape with one point moved, and perhaps others by as much.

        Where the curve becomes shorter than the arm, its last point is moved straight ahead. For a planar arm
        the position is projected into its plane.

        Args:
            arm: the arm that is to take the shape.
            index: of the point, 0-based.
            position: where to, (3,) [m], world frame.
            others: further points, 0-based.

        Raises:
            CurveError: a point is too close to another, or the points define no curve.
            InvalidValue: the first point, which is at the base of the arm, or not a position.
        """
        self._check_index(index)
        target = finite_vector("position", position, 3)
        if index == 0 and not math.dist(target, self.points[0]) <= 1e-9 * arm.length:
            raise InvalidValue("point 1", target.tolist(), "its position at the base of the arm")
        points = self.points.copy()
        together = sorted({index, *others} - {0})
        for number in together:
            self._check_index(number)
        points[together] = rounded(into_plane(arm, points[together] + (target - points[index])))
        after = replace(self, points=points)
        for number in together:
            after._check_distance(arm, number)
        return after._lengthened(arm)

    def inserted(self, arm: Arm, after: int) -> Shape:
        """Return the same curve with a further point on the line to the next one; neighbours are adjusted.

        Behind the last point it is before that one.

        Raises:
            CurveError: there is no room.
        """
        self._check_index(after)
        index = min(after, len(self.points) - 2) + 1
        if len(self.points) >= most_points(arm):
            reason = f"cannot be inserted: an arm of {arm.n_modules} modules takes {most_points(arm)} at most"
            raise CurveError(f"point {index + 1}", reason)
        curve = self.curve
        knots = curve.knots[index : index + self.degree + 1]  # any knot among these puts a point on that line
        middles = 0.5 * (knots[1:] + knots[:-1])
        # In the longest span; of equal ones, in that near the middle of the line.
        rank = np.diff(knots) - 1e-3 * np.abs(middles - 0.5 * (knots[0] + knots[-1]))
        curve = curve.insert_knot(float(middles[np.argmax(rank)]))
        more = replace(self, points=np.array(curve.coefficients), knots=curve.knots)
        more._check_distance(arm, index)
        return more

    def duplicated(self, arm: Arm, *indices: int) -> Shape:
        """Return the shape with a copy behind each of some points, 0-based; the points that it has stay.

        A copy is half way to the next point; that of the last one is straight on.

        Raises:
            CurveError: there is no room.
        """
        after = self
        copies = sorted(set(indices))
        for index in reversed(copies):
            after._check_index(index)
            points = after.points
            begin = min(index, len(points) - 2)
            copy = rounded(points[index] + 0.5 * (points[begin + 1] - points[begin]))
            knots = None if after.knots is None else after.inserted(arm, index).knots
            after = replace(after, points=np.insert(points, index + 1, copy, axis=0), knots=knots)
        if len(after.points) > SHAPE.most_points:
            reason = f"cannot be added: a curve has {SHAPE.most_points} control points at most"
            raise CurveError(f"point {copies[-1] + len(copies) + 1}", reason)
        for before, index in enumerate(copies, start=1):
            after._check_distance(arm, index + before)
        return after._lengthened(arm)

    def removed(self, arm: Arm, *indices: int) -> Shape:
        """Return the shape without some of its points; inserted ones leave the curve as it is.

        Raises:
            CurveError: too few would be left.
            InvalidValue: the first point, which is at the base of the arm.
        """
        after = self
        least = self.degree + 1
        for index in sorted(set(indices), reverse=True):
            after._check_index(index)
            if index == 0:
                raise InvalidValue("point 1", "deleted", "other points; this one is at the base of the arm")
            if len(after.points) <= least:
                reason = f"cannot be deleted: a curve of degree {self.degree} needs {least} control points"
                raise CurveError(f"point {index + 1}", reason)
            after = after._without(index, 1e-9 * arm.length)
        return after._lengthened(arm)

    def _without(self, index: int, tolerance: float) -> Shape:
        """Return the shape without a point, and without a knot if it has its own.

        Where a knot near the point can go without changing the curve by more than a tolerance [m], it does;
        the other points are adjusted. Otherwise they stay.
        """
        rest = np.delete(self.points, index, axis=0)
        if self.knots is None:
            return replace(self, points=rest)
        knots = self.knots
        k = self.degree
        n = len(self.points)
        near = range(max(index, k + 1), min(index + k + 1, n - 1) + 1)  # of the knots between the ends
        for j in near:
            fewer = np.delete(knots, j)
            insertion = BSpline(fewer, np.eye(n - 1), k).insert_knot(knots[j]).c
            before = np.linalg.lstsq(insertion, self.points, rcond=None)[0]
            if np.abs(insertion @ before - self.points).max() <= tolerance:
                return replace(self, points=before, knots=fewer)
        return replace(self, points=rest, knots=np.delete(knots, near[len(near) // 2]))

    def _check_index(self, index: int) -> None:
        if not 0 <= index < len(self.points):
            raise InvalidValue("point", index + 1, f"1 to {len(self.points)}")

    def _check_distance(self, arm: Arm, index: int) -> None:
        """Raise CurveError if a point is too close to another."""
        distances = np.linalg.norm(self.points - self.points[index], axis=1)
        distances[index] = np.inf
        other = int(np.argmin(distances))
        least = SHAPE.least_distance * float(arm.chain.module_lengths.min())
        if distances[other] < least:
            reason = f"is too close to point {other + 1}; allowed: {length_text(least)} or more from it"
            raise CurveError(f"point {index + 1}", reason)

    def _lengthened(self, arm: Arm) -> Shape:
        """Move the last point straight on until the curve is long enough.

        Raises:
            CurveError: the curve cannot be made long enough.
        """
        longer = self
        required = required_length(arm)
        for _ in range(SHAPE.most_extensions):
            missing = required - longer.curve.length
            if missing <= 0.0:
                return longer
            points = longer.points.copy()
            ahead = points[-1] - points[-2]
            # A little more: the curve grows by less than its last point moves.
            step = (missing + 0.01 * arm.length) / max(float(np.linalg.norm(ahead)), 1e-12)
            points[-1] = rounded(into_plane(arm, points[-1] + step * ahead))
            longer = replace(self, points=points)
        reason = (
            f"cannot be moved far enough to make the curve {length_text(required)} long, as the arm requires"
        )
        raise CurveError(f"point {len(self.points)}", reason)


def rounded(points: Array) -> Array:
    """Round coordinates [m] for task files, far below the accuracy of an arm."""
    return np.asarray(np.round(points, SHAPE.point_digits) + 0.0)  # no -0.0


def into_plane(arm: Arm, points: Array) -> Array:
    """Project points (m, 3) into the plane of a planar arm; for any other arm they stay as they are."""
    if arm.dimension != 2:
        return points
    base = arm.chain.base
    plane = arm.plane
    return np.asarray(base + (points - base) @ plane.T @ plane)


def most_points(arm: Arm) -> int:
    """Return how many control points a curve with knots of its own may have for an arm."""
    return min(max(arm.n_modules, SHAPE.few_modules), SHAPE.most_points)


def reshaped(index: int, change: Callable[[Arm, Shape], Shape], shape: Shape) -> Callable[[Task], Task]:
    """Return an edit that gives a keyframe, 0-based, another shape, made from the one that it has."""

    def edit(task: Task) -> Task:
        keyframes = list_keyframes(task, index)
        keyframes[index] = change(task.arm, shape).keyframe(keyframes[index])
        return task.edited(motion=tuple(keyframes))

    return edit


def required_length(arm: Arm) -> float:
    """Return how long a curve has to be for an arm, with some to spare [m]."""
    return float(arm.length + SHAPE.extra_length * arm.chain.module_lengths.mean())


Edit: TypeAlias = Callable[[Task], Task]


class KeyframeTimes(NamedTuple):
    """Times of keyframes."""

    new_gap: float = 1.0
    """Time from the keyframe before to a new one [s]."""

    least_gap: float = 0.05
    """Least time between keyframes, if the control cycle allows it [s]."""

    digits: int = 9
    """Digits behind the point of stored times."""

    tolerance: float = 1e-9
    """Difference of times that counts as none [s]."""


TIMES = KeyframeTimes()


def times_of(task: Task) -> list[float]:
    """Return when each keyframe is to be taken, counted from the beginning [s]."""
    times: list[float] = []
    left = 0.0
    for index, keyframe in enumerate(keyframes_of(task)):
        comes_back = index == 0 and task.repeat > 1  # its duration is the time to come back
        gap = None if comes_back else keyframe.duration
        times.append(left + (gap or 0.0) if keyframe.time is None else keyframe.time)
        left = times[-1] + keyframe.hold
    return times


class Pass(NamedTuple):
    """A keyframe in a lap of the motion."""

    keyframe: int  # 0-based
    lap: int  # 0-based
    time: float  # when it is to be taken [s]


def passes_of(task: Task) -> list[Pass]:
    """Return when each keyframe is to be taken, in all laps.

    The last keyframe of a closed tour begins the next lap, so that the first one is not listed again.
    """
    times = times_of(task)
    period = lap_time(task)
    closed = task.repeat > 1 and len(_lap(task)) == len(times)
    return [
        Pass(index, lap, lap * period + times[index])
        for lap in range(task.repeat)
        for index in range(int(closed and lap > 0), len(times))
    ]


def lap_time(task: Task) -> float:
    """Return how long a lap is to take, including the return to the first keyframe [s]."""
    times = times_of(task)
    keyframes = keyframes_of(task)
    lap = _lap(task)
    back = lap[-1].duration if len(lap) > len(times) else None
    return times[-1] + keyframes[-1].hold + (back or 0.0)


def _lap(task: Task) -> tuple[Keyframe, ...]:
    """Return the keyframes of a lap, as `lap_of`; without a return if no motion can have their times."""
    keyframes = keyframes_of(task)
    with suppress(TaskError):
        return keyframes if task.repeat == 1 else lap_of(keyframes, cycle_of(task.limits))
    return keyframes


def repeated(laps: int) -> Edit:
    """Repeat the tour for a number of laps; for a single one, the time to return to the first is dropped."""

    def edit(task: Task) -> Task:
        require_whole("laps", laps, 1)
        keyframes = list_keyframes(task, 0)
        if laps == 1:
            keyframes[0] = replace(keyframes[0], duration=None)
        return task.edited(motion=tuple(keyframes), repeat=laps)

    return edit


def with_keyframe(index: int, **changes: Any) -> Edit:
    """Change values of a keyframe: its name, hold, region and so on."""

    def edit(task: Task) -> Task:
        keyframes = list_keyframes(task, index)
        keyframes[index] = replace(keyframes[index], **changes)
        return task.edited(motion=tuple(keyframes))

    return edit


def joints_at(arm: Arm, q: Array) -> tuple[float, ...]:
    """Return the joint positions of a configuration (nq,), rounded for a keyframe, (nv,) [rad or m]."""
    return tuple(np.round(arm.positions(q), SHAPE.joint_digits).tolist())


def configuration_of(arm: Arm, keyframe: Keyframe) -> Array:
    """Return the configuration (nq,) of a taught keyframe."""
    return arm.configuration(np.clip(cast(Any, keyframe.joints), arm.limits.lower, arm.limits.upper))


def taught(index: int, q: Array) -> Edit:
    """Have a keyframe take a configuration (nq,), in place of its curve if it has one."""
    return lambda task: with_keyframe(index, curve=None, joints=joints_at(task.arm, q), **OF_A_CURVE)(task)


def retimed(index: int, time: float) -> Edit:
    """Move a keyframe to another time [s], after the one before it; the first stays at 0.

    The others keep their times unless the next one is reached; then all later ones are shifted.
    """

    def edit(task: Task) -> Task:
        keyframes = list_keyframes(task, index)
        gaps = _gaps(task)
        if index == 0:
            if time != 0.0:
                raise InvalidValue("time of keyframe 1", time, "0 s, the start of the motion")
            return _with_gaps(task, keyframes, gaps)
        least_gap = _min_gap(task)
        least = times_of(task)[index] - gaps[index] + least_gap
        if not least - TIMES.tolerance <= time < math.inf:
            allowed = f"{least:.4g} s or later, after the previous keyframe"
            raise InvalidValue(f"time of keyframe {index + 1}", time, allowed)
        later = time - times_of(task)[index]
        gaps[index] += later
        if index + 1 < len(gaps) and gaps[index + 1] - later >= least_gap - TIMES.tolerance:
            gaps[index + 1] -= later
        return _with_gaps(task, keyframes, gaps)

    return edit


def dragged(index: int, time: float) -> Edit:
    """Move a keyframe to another time [s], perhaps past others; these keep their times, and the first stays.

    Where another one, or its hold, is in the way, it goes to the nearest free time.
    """

    def edit(task: Task) -> Task:
        keyframes = list_keyframes(task, index)
        times = times_of(task)
        least = _min_gap(task)
        to = place_at(task, index, time)
        if index == 0:
            raise InvalidValue("time of keyframe 1", time, "0 s, the start of the motion")
        removed = keyframes.pop(index)
        _ = times.pop(index)
        left = [at + keyframe.hold for at, keyframe in zip(times, keyframes, strict=True)]
        low = left[to - 1] + least
        high = times[to] - removed.hold - least if to < len(times) else math.inf
        if not low <= high + TIMES.tolerance:
            allowed = (
                f"a place with {removed.hold + 2.0 * least:.4g} s between other keyframes and their holds"
            )
            raise InvalidValue(f"time of keyframe {index + 1}", time, allowed)
        keyframes.insert(to, removed)
        times.insert(to, min(max(time, low), high))
        left.insert(to, times[to] + removed.hold)
        return _with_gaps(task, keyframes, [0.0, *np.subtract(times[1:], left[:-1]).tolist()])

    return edit


def place_at(task: Task, index: int, time: float) -> int:
    """Return which keyframe one becomes when it is moved to another time [s], 0-based; the first stays."""
    return max(int(np.searchsorted(np.delete(times_of(task), index), time)), 1) if index > 0 else 0


def held(index: int, hold: float) -> Edit:
    """Hold a keyframe for another time [s]; later ones are shifted."""

    def edit(task: Task) -> Task:
        keyframes = list_keyframes(task, index)
        gaps = _gaps(task)
        keyframes[index] = replace(keyframes[index], hold=hold)
        return _with_gaps(task, keyframes, gaps)

    return edit


def added(index: int, name: str = "") -> Edit:
    """Add a keyframe after another, with the same shape, but no hold and no task of the tip.

    Later keyframes are shifted.
    """

    def edit(task: Task) -> Task:
        keyframes = list_keyframes(task, index)
        gaps = _gaps(task)
        added = replace(keyframes[index], time=None, duration=TIMES.new_gap, hold=0.0, name=name, tip=None)
        if keyframes[index].duration is None:
            added = replace(added, time=0.0, duration=None)
        keyframes.insert(index + 1, added)
        gaps.insert(index + 1, max(TIMES.new_gap, _min_gap(task)))
        return _with_gaps(task, keyframes, gaps)

    return edit


def removed(index: int) -> Edit:
    """Remove a keyframe; the others keep their times, except that the first is at 0."""

    def edit(task: Task) -> Task:
        keyframes = list_keyframes(task, index)
        gaps = _gaps(task)
        if len(keyframes) <= 2:
            raise TaskError(f"keyframe {index + 1}", "cannot be deleted: a motion needs two keyframes")
        if 0 < index < len(gaps) - 1:
            gaps[index + 1] += gaps[index] + keyframes[index].hold
        del keyframes[index], gaps[index]
        return _with_gaps(task, keyframes, gaps)

    return edit


def reordered(index: int, to: int) -> Edit:
    """Move a keyframe to another position in the order; holds and the gaps between positions stay."""

    def edit(task: Task) -> Task:
        keyframes = list_keyframes(task, index)
        if not 0 <= to < len(keyframes):
            raise TaskError(f"keyframe {index + 1}", "cannot be moved before the first or after the last")
        keyframes.insert(to, keyframes.pop(index))
        return _with_gaps(task, keyframes, _gaps(task))

    return edit


def with_controller(name: str) -> Edit:
    """Use another controller, with its default parameters."""
    return lambda task: task.edited(controller=controller_named(name))


def with_limits(**changes: Any) -> Edit:
    """Change limits of the task."""
    return lambda task: task.edited(limits=replace(task.limits, **changes))


def with_weight(**changes: Any) -> Edit:
    """Change what is known of the weight of the arm: its torque limits, its stiffness and so on."""
    return lambda task: task.edited(arm=task.arm.with_weight(replace(task.arm.weight, **changes)))


def with_tip_load(mass: float) -> Edit:
    """Have the arm carry a mass at its tip [kg], 0 for none; what it carries elsewhere stays."""

    def edit(task: Task) -> Task:
        others = [load for load in task.arm.weight.payloads if not is_at_tip(load)]
        at_tip = [Load(mass)] if mass != 0.0 else []
        return with_weight(payloads=(*others, *at_tip))(task)

    return edit


def is_at_tip(load: Load) -> bool:
    """Whether a load is a mere mass at the tip of the arm."""
    return load == Load(load.mass)


def differ_in_weight_alone(one: Arm, other: Arm) -> bool:
    """Whether two arms are the same, or but for their weights: they then look and move alike."""
    if one is other:
        return True
    if one.spec is None or other.spec is None or one.urdf != other.urdf:
        return False
    return replace(one.spec, weight=None) == replace(other.spec, weight=None)


def with_obstacle(name: str, obstacle: Obstacle | None, instead: str | None = None) -> Edit:
    """Add or replace an obstacle, or remove it.

    Args:
        name: of the obstacle.
        obstacle: the obstacle; None to remove it.
        instead: the name that it had; the obstacle keeps its position in the order.
    """

    def edit(task: Task) -> Task:
        scene = task.effective_scene
        listed = dict(scene.obstacles)
        if instead is not None and instead != name and name in listed:
            raise InvalidValue("name of an obstacle", name, "a name that no other obstacle has")
        if obstacle is None:
            listed.pop(name, None)
        elif instead is not None and instead in listed:
            renamed = {instead: (name, obstacle)}
            listed = dict(renamed.get(key, (key, item)) for key, item in listed.items())
        else:
            listed[name] = obstacle

        def renamed_in(names: Iterable[str]) -> list[str]:
            others = [name if other == instead else other for other in names]
            return [other for other in others if other in listed]

        carried = {
            name if key == instead else key: replace(
                carried_obstacle, beside=renamed_in(carried_obstacle.beside)
            )
            for key, carried_obstacle in scene.carried.items()
            if renamed_in([key])
        }
        touchable = renamed_in(scene.touchable)
        return task.edited(scene=replace(scene, obstacles=listed, touchable=touchable, carried=carried))

    return edit


def with_scene(**changes: Any) -> Edit:
    """Change values of the scene: its margin, self-collision and so on."""
    return lambda task: task.edited(scene=replace(task.effective_scene, **changes))


def _gaps(task: Task) -> list[float]:
    """Return the time from leaving the keyframe before to reaching each; 0 for the first [s]."""
    times = times_of(task)
    gaps = [0.0]
    left = 0.0
    for index, keyframe in enumerate(keyframes_of(task)):
        if index > 0:
            gaps.append(times[index] - left)
        left = times[index] + keyframe.hold
    return gaps


def _with_gaps(task: Task, keyframes: list[Keyframe], gaps: list[float]) -> Task:
    """Return the task with these keyframes and gaps; those given by time or by duration still are.

    Raises:
        InvalidValue: the motion would last too long.
    """
    timed: list[Keyframe] = []
    left = 0.0
    for index, (keyframe, gap) in enumerate(zip(keyframes, gaps, strict=True)):
        time = left + gap if index > 0 else 0.0
        by_duration = keyframe.duration is not None
        new, before = (gap, keyframe.duration) if by_duration else (time, keyframe.time)
        if index == 0:
            back = keyframe.duration if task.repeat == 1 else None
            by_duration = False
            new = 0.0
            before = keyframe.time or back or 0.0
        changes: dict[str, float | None] = {}
        if before is None or abs(before - new) > TIMES.tolerance:
            value = None if index == 0 else round(new, TIMES.digits)
            changes = {"time": None, "duration": value} if by_duration else {"time": value, "duration": None}
        timed.append(replace(keyframe, **changes) if changes else keyframe)  # type: ignore[arg-type]
        left = time + keyframe.hold
    longest = MOST_CYCLES * cycle_of(task.limits)
    if not left <= longest:
        raise InvalidValue("end of the motion", left, f"{longest:g} s at most, {MOST_CYCLES} control cycles")
    return task.edited(motion=tuple(timed))


def _min_gap(task: Task) -> float:
    return max(TIMES.least_gap, 2.0 * cycle_of(task.limits))
