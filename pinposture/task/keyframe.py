"""Keyframes: postures at given times, their schedule, and their configurations."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import fields, replace
from itertools import pairwise
from types import MappingProxyType
from typing import Annotated, Any, Literal, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationInfo, model_validator
from scipy.interpolate import BPoly

from pinposture import kernels
from pinposture._validation import is_usable, is_whole, require_instance
from pinposture.arm import Arm
from pinposture.arm.configurations import SLACK
from pinposture.collision import Scene
from pinposture.control.planner.damped_least_squares import PlanningProblem
from pinposture.control.planner.goal import find_goal
from pinposture.control.planner.objective import Objective
from pinposture.control.reach import bring_to_goal
from pinposture.control.tasks import EndEffector
from pinposture.curve import CURVES, Curve
from pinposture.curve.curve import CurveField
from pinposture.errors import InvalidValue, PostureError, TargetError, TaskError, raise_together, warn_caller
from pinposture.kernels.arrays import FULL_TURN, LengthArrays, SplineArrays
from pinposture.placement import Target, resolve_targets
from pinposture.placement.least_squares import FitProblem
from pinposture.placement.module_kinematics import group_runs, is_compiled
from pinposture.placement.resolve import METHODS, PLACEMENTS, PLACING, STIFFNESS, far_moved
from pinposture.placement.target import beginning, fitting_slides, length_misfit
from pinposture.schema import (
    Angle,
    Declared,
    Flag,
    NotAllowed,
    OutputFile,
    Refusal,
    Text,
    Time,
    check,
    declared,
    in_file,
    one_of,
    read_by,
)
from pinposture.task.document import Joints, joint_count_misfit
from pinposture.task.reference import AnchoredCurve, BentCurve
from pinposture.toml import Usual
from pinposture.units import length_text

Array = NDArray[np.float64]


OF_A_CURVE: Mapping[str, object] = MappingProxyType(
    {"placement": None, "roll": 0.0, "method": "auto", "trim": False}
)
"""Attributes of a keyframe that require a curve, and their defaults."""


def _read_region(value: Any, info: ValidationInfo) -> tuple[int, int]:
    """Read the first and the last control point; in a file, they are counted from 1."""
    source = in_file(info)
    first = 0 if source is None else 1
    ends = tuple(value) if isinstance(value, tuple | list) else ()
    if len(ends) != 2 or not all(map(is_whole, ends)):
        allowed = "two whole numbers: the first and the last control point"
        raise NotAllowed(value, f"{allowed}, counted from {first} at the base")
    if not first <= ends[0] <= ends[1]:
        raise NotAllowed(value, f"{first} or more, the last not before the first")
    if source is not None and ends[1] > source.arm.n_modules:
        raise Refusal(f"is {list(ends)}; the arm has control points 1 to {source.arm.n_modules}")
    return int(ends[0]) - first, int(ends[1]) - first


_SHARE = check(
    lambda value: is_usable(value) and 0.0 < value <= 1.0, "a share of the velocity limits, in (0, 1]"
)


@declared()
class Keyframe(Declared):
    """A posture to reach at a given time.

    The posture is that of a curve, or a taught configuration: `Keyframe(joints=arm.positions(q))`.

    Attributes:
        curve: the desired shape; None for a taught configuration, given by `joints`.
        time: its time from the start of the motion [s]; None if a duration is given.
        duration: its time from the end of the hold of the previous keyframe [s]; or None. The first keyframe
            is at 0 and needs neither; in a repeated tour, its duration is the time to return to it.
        hold: how long to stay there [s]. The arm is at rest at the first and the last keyframe and during a
            hold; it passes the others in motion.
        name: a name; if empty, messages use the number of the keyframe.
        placement: how the curve is placed: as_is, translate (its start to the base of the arm) or align (its
            first tangent to the axis of the arm, too); as_is for a file with obstacles, else align, if None.
        roll: additional rotation of an aligned curve about the axis of the arm [rad].
        method: how modules are placed: sequential (one by one, exactly), smooth (all at once, with little
            bending), closest (all at once), or auto; see `resolve_targets`.
        tip: a task of one control point, usually the tip, in this posture; None without one. A task with
            priority takes precedence over the posture; any other is weighted against it.
        region: first and last control point of the posture, 0-based, inclusive; None for all. The others are
            free for the tip task, and do not count.
        joints: joint positions as of `Arm.positions`, (nv,) [rad or m]. Without a curve, they are the
            posture. With a curve, they select one of several configurations that fit it equally well, as
            least squares may find; those that do not fit the arm are then ignored with a warning.
        trim: whether a curve may be longer than the arm, which takes its first part; if not, the distance of
            the tip from its end counts as distance from the curve, and one that is longer by more than a
            module, or a tenth of one if the arm has slides to extend, draws a warning.
        speed: largest share of the velocity limits for the motion to this keyframe, in (0, 1].

    Raises:
        InvalidValue: an invalid value.
        UnknownName: a `placement` or `method` that does not exist.
    """

    curve: CurveField | None = None
    time: Time | None = None
    duration: Time | None = None
    hold: Time = 0.0
    name: Text = ""
    placement: Annotated[Literal["as_is", "translate", "align"], one_of("placement", *PLACEMENTS)] | None = (
        None
    )
    roll: Angle = 0.0
    method: Annotated[Literal["auto", "sequential", "smooth", "closest"], one_of("method", *METHODS)] = "auto"
    tip: EndEffector | None = None
    region: Annotated[tuple[int, int], read_by(_read_region)] | None = None
    trim: Flag = False
    joints: Joints | None = None
    speed: Annotated[float, _SHARE] = 1.0

    @model_validator(mode="after")
    def _check(self, info: ValidationInfo) -> Keyframe:
        if self.curve is None:
            self._check_without_curve()
        if self.time is not None and self.duration is not None:
            times = {"time": self.time, "duration": self.duration}
            raise InvalidValue("time and duration", times, "one of them, and None for the other")
        source = in_file(info)
        if source is not None:
            curved = self.curve is not None
            misfit = length_misfit(source.arm, self.curve) if self.curve else joints_misfit(source.arm, self)
            if misfit:
                raise Refusal(misfit, "curve" if curved else "joints")
        return self

    def _check_without_curve(self) -> None:
        if self.joints is None:
            raise InvalidValue("curve", None, "a Curve; or None, with the joints to take")
        for name, default in OF_A_CURVE.items():
            if getattr(self, name) != default:
                raise InvalidValue(name, getattr(self, name), f"{default!r}, as there is no curve")

    def __repr__(self) -> str:
        values = {item.name: getattr(self, item.name) for item in fields(self)}
        options = [
            f"{name}={value!r}" for name, value in values.items() if value != getattr(type(self), name)
        ]
        return f"Keyframe({', '.join(options)})"

    @classmethod
    def subject(cls, values: Mapping[str, Any]) -> str:
        """Return the title of a keyframe in errors."""
        name = values.get("name", "")
        return f"keyframe {name!r}" if name and isinstance(name, str) else "keyframe"

    @classmethod
    def check_keys(cls, values: Mapping[str, Any]) -> tuple[str, ...]:
        """Refuse a keyframe without a posture, and keys of a curve where there is none."""
        if "curve" not in values:
            if "joints" not in values:
                raise Refusal("needs one of the keys 'curve', 'joints'")
            for key in OF_A_CURVE:
                if key in values:
                    raise Refusal("goes with 'curve', and there is none", key)
        return TABLE

    def to_table(self, file: OutputFile) -> dict[str, Any]:
        """Return the table; the default of its placement depends on the scene."""
        values = self.written(file)
        if self.curve is not None:
            default = usual_placement(file.scene, self.curve)
            values["placement"] = Usual(default) if self.placement == default else self.placement
        if self.region is not None:
            values["region"] = [end + 1 for end in self.region]
        return {key: values[key] for key in TABLE if key in values}


TABLE = (
    *("name", "time", "duration", "hold", "speed", "curve", "placement", "trim", "roll", "method"),
    *("region", "joints", "tip"),
)
"""Keys of the table of a keyframe, in the order in which they are written."""


def usual_placement(scene: Scene | None, curve: Curve) -> Literal["as_is", "align"]:
    """Return the default placement of a curve: as drawn if there are obstacles, unless it is a preset."""
    drawn_among_obstacles = scene is not None and scene.obstacles and curve not in CURVES.values()
    return "as_is" if drawn_among_obstacles else "align"


def as_keyframes(given: Iterable[Keyframe]) -> tuple[Keyframe, ...]:
    """Return keyframes as a tuple; raise InvalidValue unless all are keyframes."""
    listed = tuple(given) if isinstance(given, Iterable) else ()
    if not listed or not all(isinstance(keyframe, Keyframe) for keyframe in listed):
        raise InvalidValue("keyframes", given, "two or more of Keyframe(...)")
    return listed


def placed(keyframes: Sequence[Keyframe], scene: Scene | None) -> tuple[Keyframe, ...]:
    """Return the keyframes with the default placement where a curve has none of its own."""

    def own(keyframe: Keyframe) -> Keyframe:
        if keyframe.curve is None or keyframe.placement is not None:
            return keyframe
        return replace(keyframe, placement=usual_placement(scene, keyframe.curve))

    return tuple(map(own, keyframes))


def check_keyframes(keyframes: tuple[Keyframe, ...], arm: Arm) -> None:
    """Refuse keyframes that do not define a motion of an arm.

    Raises:
        InvalidValue: fewer than two, or not keyframes.
        TaskError: a region that the arm does not have, or a curve far too long; names the keyframe.
    """
    require_instance("arm", arm, Arm, "an Arm")
    if len(keyframes) < 2:
        raise InvalidValue("keyframes", keyframes, "two or more of Keyframe(...)")
    check_each_keyframe(keyframes, arm)


def check_each_keyframe(keyframes: tuple[Keyframe, ...], arm: Arm) -> None:
    """Refuse keyframes that do not fit an arm.

    Raises:
        TaskError: as `check_keyframes`.
    """
    misfits: list[PostureError] = []
    for index, keyframe in enumerate(keyframes):
        where = title(keyframes, index)
        if keyframe.region is not None and keyframe.region[1] >= arm.n_modules:
            reason = f"its region is {keyframe.region}; the arm has control points 0 to {arm.n_modules - 1}"
            misfits.append(TaskError(where, reason))
        misfit = "" if keyframe.curve is None else length_misfit(arm, keyframe.curve)
        if misfit:
            misfits.append(TaskError(where, f"the curve {misfit}"))
        misfit = joints_misfit(arm, keyframe) if keyframe.curve is None else ""
        if misfit:
            misfits.append(TaskError(where, f"joints {misfit}"))
    raise_together(misfits)


@contextmanager
def naming(where: str) -> Iterator[None]:
    """Prefix the messages of errors with a name; type and data are kept."""
    try:
        yield
    except TaskError:  # has one already
        raise
    except PostureError as error:
        error.args = (f"{where}: {error}",)
        raise


def title(keyframes: tuple[Keyframe, ...], index: int) -> str:
    """Return the title of a keyframe in messages: its number from 1, and its name if it has one."""
    name = keyframes[index].name
    return f"keyframe {index + 1} {name!r}" if name else f"keyframe {index + 1}"


# When each keyframe is reached and left, in whole control cycles.

CONTINUITIES = ("velocity", "acceleration")
"""What may be continuous in time, in addition to the posture."""

MOST_CYCLES = 1_000_000
"""Longest motion, in control cycles."""


class Stretch(NamedTuple):
    """A part of a motion that begins and ends at rest.

    Attributes:
        first: its first keyframe, 0-based.
        last: its last keyframe.
        rows: the row of each of its keyframes; for the first, the end of its hold.
    """

    first: int
    last: int
    rows: NDArray[np.int64]


class Schedule(NamedTuple):
    """When keyframes are reached and left.

    Attributes:
        reached: the row at which each is reached, (K,); that of the first is 0.
        left: the row at which each is left, (K,); later if it is held.
        rests: whether the arm is at rest there, (K,): at the first and the last, at those with a hold, and
            between motion along curves and motion in joint space.
    """

    reached: NDArray[np.int64]
    left: NDArray[np.int64]
    rests: NDArray[np.bool_]

    @property
    def rows(self) -> int:
        """Number of rows, including the first and the last."""
        return int(self.left[-1]) + 1

    @property
    def between(self) -> NDArray[np.int64]:
        """Numbers of rows from each keyframe to the next, (K - 1,)."""
        return self.reached[1:] - self.left[:-1]

    def finer(self, times: int) -> Schedule:
        """Return the same schedule with `times` as many rows."""
        return Schedule(times * self.reached, times * self.left, self.rests)

    def with_between(self, rows: NDArray[np.int64]) -> Schedule:
        """Return a schedule with other numbers of rows from each keyframe to the next, (K - 1,)."""
        later = np.append(0, np.cumsum(rows - self.between))
        return Schedule(self.reached + later, self.left + later, self.rests)

    def stretches(self) -> list[Stretch]:
        """Return the parts between rests, in order."""
        rests = np.flatnonzero(self.rests)
        return [
            Stretch(int(a), int(b), np.concatenate([self.left[a : a + 1], self.reached[a + 1 : b + 1]]))
            for a, b in pairwise(rests)
        ]


def schedule(keyframes: tuple[Keyframe, ...], interval: float) -> Schedule:
    """Schedule keyframes; all times are rounded to whole control cycles.

    Raises:
        TaskError: times that do not increase, naming the keyframe.
    """
    reached = []
    left = []
    end = 0.0
    longest = MOST_CYCLES * interval
    for index, keyframe in enumerate(keyframes):
        where = title(keyframes, index)
        before = f"keyframe {index}"
        time = keyframe.time
        seconds = keyframe.time or keyframe.duration or 0.0
        if index == 0:
            if keyframe.duration:
                reason = f"its duration is {seconds:g} s, the time to return to it in a repeated tour"
                raise TaskError(where, f"{reason}; leave it out, or set repeat to 2 or more")
            if seconds != 0.0:
                reason = f"it is at {seconds:g} s; the first keyframe is at 0, leave its time out"
                raise TaskError(where, reason)
            time = 0.0
        elif time is None:
            if keyframe.duration is None:
                raise TaskError(where, "it has neither a time nor a duration; give one of them [s]")
            time = end + keyframe.duration
        if index > 0 and time <= end:
            held = " left" if keyframes[index - 1].hold > 0.0 else ""
            reason = f"it is at {time:g} s, but {before} is{held} at {end:g} s; times have to increase"
            raise TaskError(where, reason)
        end = time + keyframe.hold
        if not end <= longest:
            reason = f"it ends at {end:g} s; with cycles of {interval:g} s, {longest:g} s at most"
            raise TaskError(where, reason)
        reached.append(round(time / interval))
        left.append(round(end / interval))
        if index > 0 and reached[-1] <= left[-2]:
            reason = f"it is in the same control cycle as {before}; they have to be {interval:g} s apart"
            raise TaskError(where, reason)
    rests = np.array([keyframe.hold > 0.0 for keyframe in keyframes])
    rests[0] = rests[-1] = True
    curved = np.array([keyframe.curve is not None for keyframe in keyframes])
    along = curved[:-1] & curved[1:]
    rests[1:-1] |= along[:-1] != along[1:]
    return Schedule(np.array(reached, dtype=np.int64), np.array(left, dtype=np.int64), rests)


def lap_of(keyframes: tuple[Keyframe, ...], interval: float) -> tuple[Keyframe, ...]:
    """Return the keyframes of one lap of a repeated tour, which ends with the posture of the first keyframe.

    A closed tour, whose last keyframe is the same posture as the first, is a lap already. Otherwise the arm
    returns to the first keyframe within its duration; by default, within the longest time from one keyframe
    to the next.

    Raises:
        TaskError: times that do not increase, or no time to return.
    """
    first = replace(keyframes[0], duration=None)
    last = keyframes[-1]
    there = (first, *keyframes[1:])
    when: dict[str, Any] = {"time": None, "duration": None, "hold": 0.0, "name": "", "speed": 1.0}
    back = keyframes[0].duration
    if back is None and replace(first, **when) == replace(last, **when):
        return there
    if back is None:
        cycles = schedule(there, interval)
        back = interval * int(cycles.between.max())
    if round(back / interval) < 1:
        reason = f"its duration is {back:g} s; the return to it takes at least a cycle of {interval:g} s"
        raise TaskError(title(keyframes, 0), reason)
    return *there, replace(first, time=None, duration=back, hold=0.0)


def interpolate(stretch: Stretch, values: Array, continuity: str, rows: Sequence[int] | Array) -> Array:
    """Interpolate values along a stretch, at rest at its ends.

    With "velocity" the result is cubic between keyframes, with "acceleration" quintic. Both are monotone from
    each keyframe to the next, whatever the times between them. At a keyframe the velocity is the smaller one
    of the mean velocities before and after it, and zero where these differ in sign. The acceleration is then
    nonzero only where the motion turns back. Thus a motion to or from a keyframe needs less velocity if the
    motion beyond that keyframe becomes faster.

    Args:
        stretch: the stretch.
        values: values at its keyframes, (k, d).
        continuity: one of `CONTINUITIES`.
        rows: the rows at which to interpolate, (r,); not necessarily whole.

    Returns:
        Values (r, d).
    """
    # In units of the stretch, so that fifth powers do not lose digits.
    begin = stretch.rows[0]
    span = stretch.rows[-1] - stretch.rows[0]
    knots = (stretch.rows - begin) / span
    x = np.clip((np.asarray(rows) - begin) / span, 0.0, 1.0)
    gaps = np.diff(knots)[:, None]
    means = np.diff(values, axis=0) / gaps
    derivatives = [values, _smaller_inside(means, means)]
    if continuity == "acceleration":
        # 5 gives the smallest peak acceleration from rest to rest: 0 has 15 % more, and 6, a cubic, 20 %.
        derivatives.append(5.0 * _smaller_inside(-means / gaps, means / gaps))
    return np.asarray(BPoly.from_derivatives(knots, np.stack(derivatives, axis=1))(x))


def _smaller_inside(before: Array, after: Array) -> Array:
    """Return the smaller one of two values at each inner keyframe, (k, d); zero if they differ in sign.

    Args:
        before: values for each interval at its end, (k - 1, d).
        after: values for each interval at its beginning, (k - 1, d).
    """
    before = before[:-1]
    after = after[1:]
    smaller = np.minimum(np.abs(before), np.abs(after)) * np.sign(before)
    inner = np.where(np.sign(before) == np.sign(after), smaller, 0.0)
    return np.pad(inner, ((1, 1), (0, 0)))


# Keyframes resolved for an arm: their configurations, by one method for all.


class ResolvingSettings(NamedTuple):
    """How keyframes are resolved, and when their posture and tip count as reached."""

    sequential_samples: int = 200_000
    """Samples of a curve in sequential placement. With fewer, joint accelerations would be rough, as
    control points move from one chord to the next."""

    curve_length_margin: float = 1.2
    """Length of curves between keyframes, relative to those at keyframes, of which the arm may cover
    less."""

    posture_tolerance: float = 1e-8
    """Mean distance of the control points from their targets at which a posture is reached, in arm
    lengths."""

    strict_tip: float = 1e-4
    """Largest error of a tip task with priority, in arm lengths."""

    sliding_rest: float = 0.1
    """Length of a curve that an arm with slides may leave uncovered without a warning, in module
    lengths."""

    viscosity: float = 3e-3
    """Cost of joint motion from one keyframe to the next relative to that of distances: root of the ratio,
    for `typical_rows` rows. It restrains joints that hardly change the shape, such as those that roll a
    nearly straight arm; others lag behind by a negligible amount."""

    typical_rows: int = 400
    """Rows from one keyframe to the next for which `viscosity` is given."""


RESOLVING = ResolvingSettings()


class Resolved(NamedTuple):
    """A keyframe resolved for an arm.

    Attributes:
        anchored: its curve in the world, and the position of the base on it; None for a taught configuration.
        target: its target, of the whole arm.
        positions: its joint positions, (nv,) [rad or m].
        fixed: whether the motion has to pass through these positions: they were given, or found by a method
            other than that of the motion.
    """

    anchored: AnchoredCurve | None
    target: Target
    positions: Array
    fixed: bool

    @property
    def parameters(self) -> Array:
        """Arc length of each control point, counted from the base of the arm, (m,) [m]."""
        anchored = cast(AnchoredCurve, self.anchored)
        return np.asarray(self.target.parameters, dtype=np.float64) - anchored.parameter


class ResolvedMotion(NamedTuple):
    """All keyframes of a motion, resolved.

    Attributes:
        keyframes: in order.
        method: how targets are found between them: "sequential", "smooth" or "closest".
        length: relevant length of each curve [m].
    """

    keyframes: tuple[Resolved, ...]
    method: str
    length: float


def resolve_keyframe(arm: Arm, keyframe: Keyframe, near: Target | None = None) -> Target:
    """Find the target of a single keyframe: its posture and tip task, as far as the arm can reach them.

    This is fast enough while a keyframe is being edited. A motion has the same posture at a keyframe with
    `joints`; others are resolved by one method for the whole motion, and reached by the nearest path.

    Args:
        arm: the arm.
        keyframe: the keyframe.
        near: as for `resolve_targets`; the joints of the keyframe if None.

    Raises:
        TargetError: as `resolve_targets`.
        TaskError: a tip task with priority that is out of reach.
        InvalidValue: a region that the arm does not have.
    """
    (keyframe,) = with_fitting_joints(arm, (keyframe,))
    target = _target(arm, keyframe, keyframe.method, near)
    if keyframe.tip is not None:
        q = cast(Array, target.q)
        shift = tip_shift(arm, keyframe, target, q, title((keyframe,), 0))
        return target_at(arm, keyframe, target, arm.integrate(q, shift))
    return target if keyframe.region is None else target.region(*keyframe.region)


def resolve_keyframes(arm: Arm, keyframes: tuple[Keyframe, ...]) -> ResolvedMotion:
    """Resolve all keyframes: those with `joints` near these, all others with an open method by a common one.

    That is sequential placement if closed forms place all keyframes without joints, otherwise the least
    squares method that works where they fail.

    Raises:
        TargetError: as `resolve_targets`; names the keyframe.
    """
    keyframes = with_fitting_joints(arm, keyframes)
    targets: list[Target] = []
    failures: list[PostureError] = []
    for index, keyframe in enumerate(keyframes):
        try:
            with naming(title(keyframes, index)):
                targets.append(_target(arm, keyframe, keyframe.method))
        except PostureError as failure:
            failures.append(failure)
    raise_together(failures)
    curved = [k for k, keyframe in enumerate(keyframes) if keyframe.curve is not None]
    free = [k for k in curved if keyframes[k].joints is None]
    methods = {targets[k].method for k in free or curved}
    method = "sequential"
    if methods != {"sequential"} or not is_compiled(arm) or np.any(arm.base_slides):
        method = "smooth" if "smooth" in methods else "closest"
    resolved = []
    for index, keyframe in enumerate(keyframes):
        target = targets[index]
        if keyframe.curve is None:
            positions = np.clip(np.array(keyframe.joints), arm.limits.lower, arm.limits.upper)
            resolved.append(Resolved(None, target, positions, True))
            continue
        if keyframe.method == "auto" and keyframe.joints is None and target.method != method:
            with suppress(TargetError):  # keep its own method
                target = _target(arm, keyframe, method)
        resolved.append(_resolved(arm, target, target.method != method or keyframe.joints is not None))
        _warn_of_rest(arm, keyframes, index, resolved[-1])
        if (
            keyframe.placement is None
            and target.moved is not None
            and target.moved.distance > PLACING.far * arm.length
        ):
            what = f"{title(keyframes, index)}: its curve"
            warn_caller(far_moved(arm, what, target.moved))
    longest = max([arm.length, *(float(resolved[k].parameters[-1]) for k in curved)])
    return ResolvedMotion(tuple(resolved), method, RESOLVING.curve_length_margin * longest)


def _resolved(arm: Arm, target: Target, fixed: bool) -> Resolved:
    curve = cast(Curve, target.curve)
    q = cast(Array, target.q)
    return Resolved(AnchoredCurve(curve, beginning(arm, curve)[0]), target, arm.positions(q), fixed)


def _target(arm: Arm, keyframe: Keyframe, method: str, near: Target | None = None) -> Target:
    """Resolve the target of the whole arm, near another target or the joints of the keyframe, if any."""
    curve = keyframe.curve
    if curve is None:
        return _of_joints(arm, keyframe)
    options: dict[str, Any] = {
        "placement": keyframe.placement or "align",
        "roll": keyframe.roll,
        "method": method,
    }
    if near is not None or keyframe.joints is None:
        return resolve_targets(arm, curve, RESOLVING.sequential_samples, near=near, **options)
    try:
        near = _of_joints(arm, keyframe)
        return resolve_targets(arm, curve, RESOLVING.sequential_samples, near=near, **options)
    except TargetError:
        target = resolve_targets(arm, curve, RESOLVING.sequential_samples, **options)
    where = f"keyframe {keyframe.name!r}" if keyframe.name else "a keyframe"
    text = "joints: its curve has no posture near them; they are ignored"
    warn_caller(f"{where}: {text}")
    return target


def _of_joints(arm: Arm, keyframe: Keyframe) -> Target:
    """Return the posture at the joints of a keyframe."""
    q = arm.configuration(np.clip(np.array(keyframe.joints), arm.limits.lower, arm.limits.upper))
    return Target(arm.chain_at(q).points, np.ones(arm.n_modules), q=q)


def _warn_of_rest(arm: Arm, keyframes: tuple[Keyframe, ...], index: int, resolved: Resolved) -> None:
    """Warn of a curve that is longer than the arm covers, unless it is to be trimmed."""
    anchored = cast(AnchoredCurve, resolved.anchored)
    covered = float(resolved.parameters[-1])
    length = anchored.curve.length - anchored.parameter
    share = RESOLVING.sliding_rest if np.any(fitting_slides(arm)) else 1.0
    allowed = share * float(arm.chain.module_lengths.max())
    if not keyframes[index].trim and length - covered > allowed:
        text = f"the arm takes the first {length_text(covered)} of its curve of {length_text(length)}"
        warn_caller(f"{title(keyframes, index)}: {text}; set trim to accept this")


def end_off(arm: Arm, keyframe: Keyframe, target: Target) -> float:
    """Return the distance of the tip from the end of its curve [m]; 0 if it does not have to be there."""
    if target.curve is None or keyframe.trim or not target.has_target[-1]:
        return 0.0
    tip = arm.chain.flattened(target.points[-1:])[0]
    return float(np.linalg.norm(tip - target.curve.at(target.curve.length)))


def tip_shift(arm: Arm, keyframe: Keyframe, target: Target, q: Array, where: str) -> Array:
    """Find the joint displacement (nv,) [rad or m] from a configuration to one that also meets the tip task.

    Args:
        arm: the arm.
        keyframe: the keyframe.
        target: its target, of the whole arm.
        q: the configuration of the target, (nq,).
        where: title of the keyframe in messages.

    Raises:
        TaskError: a task with priority that is out of reach.
    """
    if keyframe.tip is None:
        return np.zeros(arm.nv)
    objective = Objective(arm, target_at(arm, keyframe, target, q), (keyframe.tip,))
    position_limits = np.array([arm.limits.lower, arm.limits.upper])
    problem = PlanningProblem(objective, arm.chain_at(q), position_limits)
    state = find_goal(problem, RESOLVING.posture_tolerance * arm.length).state
    missed = 0.0
    if keyframe.tip.priority:  # the posture gives way: a compromise can end at a distance from the goal
        state, missed = bring_to_goal(arm, keyframe.tip, state)
    if missed > RESOLVING.strict_tip * arm.length:
        advice = "move it nearer, limit the posture to a region, or use a weight instead of priority"
        reason = f"its tip task with priority is missed by {length_text(missed)} in the closest posture found"
        raise TaskError(where, f"{reason}; {advice}")
    return np.asarray(arm.difference(q, state.q))


def target_at(arm: Arm, keyframe: Keyframe, target: Target, q: Array) -> Target:
    """Return the target of a keyframe with the control points of a configuration (nq,)."""
    points = arm.chain_at(q).points
    weights = np.ones(arm.n_modules)
    moved = target.moved
    result = Target(points, weights, q)
    if target.curve is not None:
        parameters, distances = map(np.asarray, target.curve.nearest(arm.chain.flattened(points)))
        result = Target(points, weights, q, target.curve, parameters, distances, target.method, moved=moved)
    return result if keyframe.region is None else result.region(*keyframe.region)


def with_fitting_joints(arm: Arm, keyframes: tuple[Keyframe, ...]) -> tuple[Keyframe, ...]:
    """Return the keyframes without `joints` that do not fit the arm, with a `PostureWarning`.

    Raises:
        TaskError: a taught configuration that does not fit.
    """
    fitting = []
    for index, keyframe in enumerate(keyframes):
        misfit = joints_misfit(arm, keyframe)
        if misfit and keyframe.curve is None:
            raise TaskError(title(keyframes, index), f"joints {misfit}")
        if misfit:
            warn_caller(f"{title(keyframes, index)}: joints {misfit}; they are ignored")
        fitting.append(replace(keyframe, joints=None) if misfit else keyframe)
    return tuple(fitting)


def joints_misfit(arm: Arm, keyframe: Keyframe) -> str:
    """Return why the joints of a keyframe do not fit the arm; empty if they do, or there are none."""
    if keyframe.joints is None:
        return ""
    if len(keyframe.joints) != arm.nv:
        return joint_count_misfit(arm, len(keyframe.joints))
    positions = np.array(keyframe.joints)
    over = np.maximum(positions - arm.limits.upper, arm.limits.lower - positions)
    worst = int(np.argmax(over))
    if over[worst] <= SLACK:
        return ""
    low = arm.limits.lower[worst]
    high = arm.limits.upper[worst]
    unit = "m" if arm.slides[worst] else "rad"
    joint = f"joint {worst + 1} {arm.joint_names[worst]!r}"
    value = positions[worst]
    text = f"is {value:.4g} {unit} for {joint}, whose limits are {low:.4g} and {high:.4g} {unit}"
    if unit == "rad" and abs(value) > FULL_TURN:
        text += f'; is it in degrees? np.deg2rad converts to radians; in a task file, write "{value:.4g} deg"'
    return text


# Joint positions for curves that change slightly from one row to the next.


class SequentialFollower:
    """Sequential placement on curves that begin at or near the base of the arm."""

    def __init__(self, arm: Arm) -> None:
        self._arm = arm
        self._run = group_runs(arm)[0]
        self._lower = arm.limits.lower[arm.columns]
        self._upper = arm.limits.upper[arm.columns]
        self._base = np.array(arm.chain.base)

    def positions(self, curve: BentCurve) -> Array | None:
        """Return joint positions (nv,) that place the control points on a curve; None if there are none."""
        ends = np.array([0.0, curve.length])
        breaks = np.concatenate([ends[:1], curve.s, ends[1:]])
        spline = SplineArrays(np.repeat(breaks, 2), curve.spline[None], 3, breaks)
        # The parameter is the arc length.
        length = LengthArrays(ends, ends, np.full((1, 2), 0.5 * curve.length))
        state = np.empty(9)
        state[0] = 0.0
        state[1:4] = self._base
        state[4:7] = curve.points[0]
        shift = np.zeros(len(self._arm.columns))
        stopped = kernels.place_modules(
            spline,
            length,
            RESOLVING.sequential_samples,
            self._run.numbers,
            self._run.shapes,
            self._lower,
            self._upper,
            state,
            shift,
            np.empty(self._arm.n_modules),
        )
        if stopped >= 0:
            return None
        positions = np.zeros(self._arm.nv)
        positions[self._arm.columns] = shift
        return positions


class LeastSquaresFollower:
    """Least squares of the whole arm, from a nearby guess.

    The unknowns are those of `least_squares`: joint positions, and arc lengths between control points, in
    units of the problem. Slides are given: least squares leave open how far the arm extends along a curve.
    """

    def __init__(self, arm: Arm, method: str) -> None:
        lengths = np.maximum(arm.chain.module_lengths, arm.chain.module_lengths.mean())
        self.problem = FitProblem(arm, 0.0, STIFFNESS[method] * float(np.median(lengths)))

    def follow(
        self, curves: Sequence[BentCurve], problems: Sequence[FitProblem], first: Array, travel: float
    ) -> Array:
        """Follow curves that change slightly, from unknowns that fit the first; return unknowns (r, n + m).

        Args:
            curves: the curves, r of them.
            problems: the problem of each, with its slides.
            first: unknowns of the first, (n + m,).
            travel: largest motion of the joints from the first to the last [rad, or arm lengths].
        """
        count = len(curves)
        filled = np.empty((count, len(first)))
        filled[0] = first
        jacobian = problems[0].evaluate(curves[0], first)[1]
        cost = RESOLVING.viscosity**2 * count / RESOLVING.typical_rows
        weight = cost * self.problem.stiffness(jacobian.T @ jacobian)
        for i in range(1, count):
            before = filled[i - 1]
            guess = before + (before - filled[i - 2] if i > 1 else 0.0)
            filled[i] = problems[i].solve(
                curves[i], guess, before=before, weight=weight, reach=travel / count
            )
        return filled
