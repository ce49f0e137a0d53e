"""Keyframes to a reference: curves interpolated in time, and the targets that are resolved along them."""

from __future__ import annotations

import logging
import math
from collections.abc import Sequence
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from pinposture.arm import Arm
from pinposture.control.checks import require_positive
from pinposture.errors import InvalidValue, TaskError, UnknownName
from pinposture.task.between import STEP, TOO_FAR, Between, Progress
from pinposture.task.keyframe import Keyframe, naming, title
from pinposture.task.reference import Mark, Reference
from pinposture.task.resolving import Keyed, resolve_keyframes, taken, tip_shift
from pinposture.task.schedule import CONTINUITIES, Schedule, interpolate, schedule

Array = NDArray[np.float64]
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

    Between keyframes the curve is interpolated smoothly in time by its bending (see `task.bending`), and the
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
