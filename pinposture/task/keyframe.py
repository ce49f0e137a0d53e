"""Keyframes: postures to take at given times, and the schedule in which they are reached and left."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicHermiteSpline, PchipInterpolator, make_interp_spline

from pinposture._validation import as_number, finite_vector, is_whole
from pinposture.arm import Arm
from pinposture.collision import Scene
from pinposture.control.tasks import EndEffector
from pinposture.curve import Curve
from pinposture.errors import InvalidValue, PostureError, TaskError, UnknownName
from pinposture.placement.resolve import METHODS, PLACEMENTS

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Keyframe:
    """A posture to take at a given time.

    Attributes:
        curve: the shape to take.
        time: when to take it, counted from the beginning of the motion [s]; None if a duration is given.
        duration: time since the keyframe before, counted from the end of its hold [s]; or None. The first
            keyframe is at 0 and needs neither.
        hold: how long to stay there [s]. A keyframe with a hold is taken at rest, and so are the first and
            the last one; the motion passes through the others.
        name: a name; if empty, the keyframe is referred to by its number.
        placement: as for `resolve_targets`; None for what `usual_placement` says.
        roll: as for `resolve_targets` [rad].
        method: as for `resolve_targets`.
        tip: the task of one control point, usually the tip, while the arm takes the posture; None if there is
            none. A strict task takes precedence over the posture; any other is weighed against it.
        region: first and last control point that have to take the posture, 0-based, the last included; None
            for all. The others are free to serve the tip, and do not count.
        joints: joint positions near which to take the posture, as of `Arm.positions`, (nv,) [rad or m]; None
            for any. Where modules are placed by least squares, several configurations may take a posture
            equally well, and this selects one. Positions that do not fit the arm are ignored with a warning.
        trim: True to take the first part of a curve that is longer than the arm covers, by more than a
            module; False to refuse it.

    Raises:
        InvalidValue: a value other than described.
        UnknownName: a `placement` or `method` that does not exist.
    """

    curve: Curve
    time: float | None = None
    duration: float | None = None
    hold: float = 0.0
    name: str = ""
    placement: Literal["as_is", "translate", "align"] | None = None
    roll: float = 0.0
    method: Literal["auto", "sequential", "smooth", "closest"] = "auto"
    tip: EndEffector | None = None
    region: tuple[int, int] | None = None
    trim: bool = False
    joints: tuple[float, ...] | None = None

    def __post_init__(self) -> None:
        if not isinstance(self.name, str):
            raise InvalidValue("name", self.name, "text, or empty for the number of the keyframe")
        with naming(f"keyframe {self.name!r}" if self.name else "keyframe"):
            self._check()

    def _check(self) -> None:
        if not isinstance(self.curve, Curve):
            raise InvalidValue("curve", self.curve, "a Curve")
        if self.time is not None and self.duration is not None:
            given = {"time": self.time, "duration": self.duration}
            raise InvalidValue("time and duration", given, "one of them, and None for the other")
        for name in ("time", "duration", "hold"):
            value = getattr(self, name)
            if value is not None or name == "hold":
                as_number(name, value, "a finite number >= 0 [s]", lambda number: number >= 0.0)
        as_number("roll", self.roll, "a finite angle [rad]", lambda _: True)
        if self.placement not in (None, *PLACEMENTS):
            raise UnknownName("placement", self.placement, PLACEMENTS)
        if self.method not in METHODS:
            raise UnknownName("method", self.method, METHODS)
        if self.tip is not None and not isinstance(self.tip, EndEffector):
            raise InvalidValue("tip", self.tip, "an EndEffector, or None")
        if self.region is not None:
            ends = tuple(self.region) if isinstance(self.region, tuple | list) else ()
            if len(ends) != 2 or not all(map(is_whole, ends)) or not 0 <= ends[0] <= ends[1]:
                allowed = "two whole numbers (first, last), 0 <= first <= last"
                raise InvalidValue("region", self.region, allowed)
            object.__setattr__(self, "region", (int(ends[0]), int(ends[1])))
        if not isinstance(self.trim, bool):
            raise InvalidValue("trim", self.trim, "True or False")
        if self.joints is not None:
            joints = finite_vector("joints", self.joints, np.size(self.joints))
            object.__setattr__(self, "joints", tuple(joints.tolist()))


def usual_placement(scene: Scene | None) -> Literal["as_is", "align"]:
    """Return how curves are placed by default: among obstacles they stay where they are drawn."""
    return "as_is" if scene is not None and scene.obstacles else "align"


def check_keyframes(keyframes: tuple[Keyframe, ...], arm: Arm) -> None:
    """Refuse keyframes that make no motion of an arm.

    Raises:
        InvalidValue: fewer than two, or something else among them.
        TaskError: a region that the arm does not have; names the keyframe.
    """
    if len(keyframes) < 2 or not all(isinstance(each, Keyframe) for each in keyframes):
        raise InvalidValue("keyframes", keyframes, "two or more of Keyframe(...)")
    for index, keyframe in enumerate(keyframes):
        if keyframe.region is not None and keyframe.region[1] >= arm.n_modules:
            reason = f"its region is {keyframe.region}; the arm has control points 0 to {arm.n_modules - 1}"
            raise TaskError(title(keyframes, index), reason)


@contextmanager
def naming(where: str) -> Iterator[None]:
    """Put a name in front of the messages of errors, which keep their kind and data."""
    try:
        yield
    except TaskError:  # has one already
        raise
    except PostureError as error:
        error.args = (f"{where}: {error}",)
        raise


def title(keyframes: tuple[Keyframe, ...], index: int) -> str:
    """Return what to call a keyframe in a message: its number from 1, and its name if it has one."""
    name = keyframes[index].name
    return f"keyframe {index + 1} {name!r}" if name else f"keyframe {index + 1}"


# When each keyframe is reached and left, in whole control cycles.

CONTINUITIES = ("velocity", "acceleration")
"""What may be continuous in time, besides the posture itself."""

MOST_CYCLES = 1_000_000
"""The longest motion, in control cycles."""


class Stretch(NamedTuple):
    """A part of a motion that begins and ends at rest.

    Attributes:
        first: the keyframe at its beginning, 0-based.
        last: the keyframe at its end.
        rows: the row of each of its keyframes; that of the first is where its hold ends.
    """

    first: int
    last: int
    rows: NDArray[np.int64]


class Schedule(NamedTuple):
    """When keyframes are reached and left.

    Attributes:
        reached: the row at which each is reached, (K,); that of the first is 0.
        left: the row at which each is left; later if it is held, (K,).
        rests: whether the arm is at rest there, (K,).
    """

    reached: NDArray[np.int64]
    left: NDArray[np.int64]
    rests: NDArray[np.bool_]

    @property
    def rows(self) -> int:
        """Number of rows, including the first and the last."""
        return int(self.left[-1]) + 1

    @property
    def shortest(self) -> int:
        """Smallest number of rows from one keyframe to the next."""
        return int((self.reached[1:] - self.left[:-1]).min())

    def finer(self, times: int) -> Schedule:
        """Return the same schedule with so many rows for each."""
        return Schedule(times * self.reached, times * self.left, self.rests)

    def stretches(self) -> list[Stretch]:
        """Return the parts between rests, in order."""
        rests = np.flatnonzero(self.rests)
        return [
            Stretch(int(a), int(b), np.concatenate([self.left[a : a + 1], self.reached[a + 1 : b + 1]]))
            for a, b in pairwise(rests)
        ]


def schedule(keyframes: tuple[Keyframe, ...], interval: float) -> Schedule:
    """Set keyframes in time; all times are rounded to whole control cycles.

    Raises:
        TaskError: times that do not increase, naming the keyframe.
    """
    reached, left, end, longest = [], [], 0.0, MOST_CYCLES * interval
    for index, keyframe in enumerate(keyframes):
        where, before = title(keyframes, index), f"keyframe {index}"
        time, given = keyframe.time, keyframe.time or keyframe.duration or 0.0
        if index == 0:
            if given != 0.0:
                reason = f"it is at {given:g} s; the first keyframe is at 0, leave its time out"
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
    return Schedule(np.array(reached, dtype=np.int64), np.array(left, dtype=np.int64), rests)


def interpolate(stretch: Stretch, values: Array, continuity: str, rows: Sequence[int] | Array) -> Array:
    """Interpolate values along a stretch, at rest at its ends.

    With "velocity" the result is cubic between keyframes, and monotone there (slopes of Fritsch and Butland);
    with "acceleration" it is quintic, with a continuous fourth derivative, and may overshoot.

    Args:
        stretch: the stretch.
        values: values at its keyframes, (k, d).
        continuity: one of `CONTINUITIES`.
        rows: the rows at which to interpolate, (r,); need not be whole.

    Returns:
        Values (r, d).
    """
    # In units of the stretch, so that its fifth powers are harmless.
    begin, span = stretch.rows[0], stretch.rows[-1] - stretch.rows[0]
    knots = (stretch.rows - begin) / span
    x = np.clip((np.asarray(rows) - begin) / span, 0.0, 1.0)
    if continuity == "velocity":
        with np.errstate(over="ignore"):  # of inverse secants that vanish, to slopes of 0
            slopes = PchipInterpolator(knots, values)(knots, 1)
        slopes[0] = slopes[-1] = 0.0
        return np.asarray(CubicHermiteSpline(knots, values, slopes)(x))
    still = [(1, np.zeros(values.shape[1])), (2, np.zeros(values.shape[1]))]
    return np.asarray(make_interp_spline(knots, values, k=5, bc_type=(still, still))(x))
