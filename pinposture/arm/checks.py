"""Checks of numbers that come from outside."""

from __future__ import annotations

import warnings
from collections.abc import Sequence

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from pinposture.arm.limits import JointLimits
from pinposture.errors import InvalidValue, PostureWarning


def float_array(name: str, values: ArrayLike, shape: tuple[int, ...]) -> NDArray[np.float64]:
    """A fresh array of floats, finite or not.

    Raises:
        InvalidValue: not numbers, or another shape.
    """
    try:
        array = np.array(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise InvalidValue(name, values, f"numbers of shape {shape}") from None
    if array.shape != shape:
        raise InvalidValue(f"{name} (shape)", array.shape, f"{shape} for this arm")
    return array


def finite_vector(name: str, values: ArrayLike, size: int) -> NDArray[np.float64]:
    """A fresh vector (size,) of finite floats.

    Raises:
        InvalidValue: not numbers, another shape, or an entry that is not finite; names the entry.
    """
    vector = float_array(name, values, (size,))
    finite = np.isfinite(vector)
    if not finite.all():
        bad = int(np.argmin(finite))
        raise InvalidValue(f"{name}[{bad}]", float(vector[bad]), "finite numbers")
    return vector


TURN = 2.0 * np.pi
SLACK = 1e-4
"""How far outside of its limits a joint may be without a word [rad or m]: rounding to four digits."""

CLEARLY, SHARE, LEAST = 0.1, 0.5, 3
"""How far outside a joint counts among many [rad], which share of all these are, and how many at least."""

WOUND = 4.0 * TURN
"""From where on a joint without limits is taken to be given in degrees, if `SHARE` of them are [rad]."""

_ADVICE = "is it in degrees? np.deg2rad makes radians of them (--degrees on the command line)"


def check_joint_positions(
    name: str,
    positions: NDArray[np.float64],
    limits: JointLimits,
    slides: NDArray[np.bool_],
    joints: Sequence[str],
) -> None:
    """Look whether joint positions that somebody gave, as a start or a goal, can be meant.

    A `PostureWarning` tells of joints outside of their limits, and of many joints without limits that are
    wound by several turns.

    Args:
        name: what the positions are called.
        positions: one for each degree of freedom, (nv,) [rad or m].
        limits: those of the joints.
        slides: which of them slide, (nv,).
        joints: their names, (nv,).

    Raises:
        InvalidValue: a joint that turns is outside of its limits by more than a turn, or many are: degrees.
    """
    beyond = np.maximum(limits.lower - positions, positions - limits.upper)
    turning = np.where(slides, -np.inf, beyond)
    limited = ~slides & np.isfinite(np.minimum(-limits.lower, limits.upper))
    clearly = int(np.count_nonzero(limited & (beyond > CLEARLY)))
    in_degrees = turning.max() > TURN or clearly >= max(LEAST, SHARE * np.count_nonzero(limited))
    worst = int(np.argmax(turning if in_degrees else beyond))
    outside = np.flatnonzero(beyond > SLACK)
    if len(outside):
        unit = "m" if slides[worst] else "rad"
        allowed = f"{limits.lower[worst]:.4g} to {limits.upper[worst]:.4g} {unit}"
        which = f"joint {joints[worst]!r}"
        if in_degrees:
            more = f", and {len(outside) - 1} more joints are outside of theirs" if len(outside) > 1 else ""
            reason = f"{allowed}, the limits of {which}{more}; {_ADVICE}"
            raise InvalidValue(f"{name}[{worst}]", float(positions[worst]), reason)
        count = f"{len(outside)} joints" if len(outside) > 1 else "a joint"
        at = f"{which} is at {positions[worst]:.4g}, allowed {allowed}"
        warnings.warn(f"{name}: {count} outside of the limits; {at}", PostureWarning, stacklevel=4)
    free = ~slides & ~limited
    wound = int(np.count_nonzero(free & (np.abs(positions) > WOUND)))
    if wound >= max(LEAST, SHARE * np.count_nonzero(free)):
        most = int(np.argmax(np.where(free, np.abs(positions), 0.0)))
        turns = f"{wound} joints without limits are wound by more than {WOUND / TURN:g} turns"
        text = f"{name}: {turns}, {joints[most]!r} at {positions[most]:.4g} rad; {_ADVICE}"
        warnings.warn(text, PostureWarning, stacklevel=4)


def rigid_placement(name: str, value: object) -> pin.SE3:
    """A fresh placement: that of a `pin.SE3` or of a homogeneous matrix (4, 4); the identity for None.

    Raises:
        InvalidValue: anything else, or a matrix that is not finite, or scales, shears or mirrors.
    """
    if value is None:
        return pin.SE3.Identity()
    try:
        matrix = np.array(value.homogeneous if isinstance(value, pin.SE3) else value, dtype=np.float64)
    except (TypeError, ValueError):
        matrix = np.zeros(0)
    if matrix.shape == (4, 4) and np.all(np.isfinite(matrix)):
        turn = matrix[:3, :3]
        rigid = np.allclose(turn @ turn.T, np.eye(3), atol=1e-6) and np.linalg.det(turn) > 0.0
        if rigid and np.allclose(matrix[3], (0.0, 0.0, 0.0, 1.0), atol=1e-12):
            return pin.SE3(turn, matrix[:3, 3])
    raise InvalidValue(name, value, "a pin.SE3, or a finite rigid transform (4, 4)")
