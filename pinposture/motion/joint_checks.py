"""Checks of joint motions that come from outside."""

from __future__ import annotations

from collections.abc import Iterable, Sequence, Sized
from numbers import Real

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pinposture.control.checks import require_positive
from pinposture.errors import InvalidValue

Array = NDArray[np.float64]

MENTIONED = 6
"""How many joints that do not fit are listed."""

SAME = 1e-9
"""Share by which two durations may differ and still count as one."""


def check_names(names: Sequence[str]) -> tuple[str, ...]:
    """The names, or InvalidValue unless they are different ones that a file can hold, at least one."""
    if isinstance(names, str) or not names:
        raise InvalidValue("joint_names", names, "a list of at least one name")
    for k, name in enumerate(names):
        if not (isinstance(name, str) and name and name.isprintable() and name == name.strip()):
            allowed = "a name: printable characters, no space before or after them"
            raise InvalidValue(f"joint_names[{k}]", name, allowed)
        if name in names[:k]:
            raise InvalidValue(
                f"joint_names[{k}]", name, f"a name of its own; joint {names.index(name)} has it"
            )
    return tuple(names)


def check_same_joints(names: Sequence[str], expected: Sequence[str]) -> None:
    """Raise InvalidValue unless these are the joints of an arm, in any order; names those that do not fit."""
    wrong = {
        "missing": [name for name in expected if name not in names],
        "unknown": [name for name in names if name not in expected],
    }
    if any(wrong.values()):
        told = "; ".join(f"{word}: {_listed(joints)}" for word, joints in wrong.items() if joints)
        raise InvalidValue(
            "joint_names", names, f"the {len(expected)} joints of the arm in any order ({told})"
        )


def row_count(name: str, values: ArrayLike) -> int:
    """How many rows or entries there are; raises InvalidValue if it is none, or no list at all."""
    alone = isinstance(values, np.ndarray) and values.ndim == 0
    rows = len(values) if isinstance(values, Sized) and not alone else 0
    if rows == 0:
        raise InvalidValue(name, values, "a list with at least one entry")
    return rows


def finite_array(name: str, values: ArrayLike, shape: tuple[int, ...] | None = None) -> Array:
    """A fresh read-only array of finite floats, of that shape if one is given.

    Raises:
        InvalidValue: not numbers, another shape, or an entry that is not finite; names the entry.
    """
    try:
        array = np.array(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise InvalidValue(name, values, f"numbers{'' if shape is None else f', {shape}'}") from None
    if shape is not None and array.shape != shape:
        raise InvalidValue(f"{name} (shape)", array.shape, str(shape))
    bad = np.argwhere(~np.isfinite(array))
    if len(bad):
        entry = ", ".join(map(str, bad[0]))
        raise InvalidValue(
            f"{name}[{entry}]" if entry else name, float(array[tuple(bad[0])]), "finite numbers"
        )
    array.flags.writeable = False
    return array


def check_times(time: Array) -> None:
    """Raise InvalidValue unless moments increase strictly from 0 or later."""
    if time[0] < 0.0:
        raise InvalidValue("time[0]", float(time[0]), "0 or later [s]")
    late = np.flatnonzero(np.diff(time) <= 0.0)
    if len(late):
        k = int(late[0]) + 1
        raise InvalidValue(f"time[{k}]", float(time[k]), f"more than time[{k - 1}], {float(time[k - 1])} s")


def moments(time: ArrayLike, rows: int) -> ArrayLike:
    """When rows are reached: as given, or at equal distances from 0 if one number was given [s].

    Raises:
        InvalidValue: one number that is not positive.
    """
    if not isinstance(time, Real):
        return time
    require_positive("time", time if isinstance(time, bool) else float(time))
    return float(time) * np.arange(rows)


def step_duration(dt: float | None, known: float | None) -> float:
    """The duration of the steps of a run [s]: that of its limits, or the one given.

    Raises:
        InvalidValue: there is none, it is not positive, or the two are not the same.
    """
    step = known if dt is None else dt
    if step is None:
        raise InvalidValue("dt", None, "the duration of a step [s]; the limits of this run have none")
    require_positive("dt", step)
    if known is not None and abs(step - known) > SAME * known:
        raise InvalidValue("dt", dt, f"{known} s, which the limits of this run have, or nothing")
    return step


def _listed(names: Iterable[str]) -> str:
    listed = [repr(name) for name in names]
    more = f" and {len(listed) - MENTIONED} more" if len(listed) > MENTIONED else ""
    return ", ".join(listed[:MENTIONED]) + more
