"""Checks of arguments: types, names, numbers, points; errors name the argument and what is allowed."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Sequence
from numbers import Integral, Real
from types import UnionType
from typing import Any, TypeAlias

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from pinposture.errors import CurveError, InvalidValue, UnknownName
from pinposture.units import ROUNDING

Vector: TypeAlias = tuple[float, float, float]
Matrix: TypeAlias = tuple[Vector, Vector, Vector]

LARGEST_NUMBER = 1e30
SMALLEST_NUMBER = 1e-30
"""Largest number of any kind, smallest one above 0; no product of ten of them over- or underflows."""
LARGEST_COORDINATE = 1e9
"""Largest coordinate [m] and joint position [rad or m]; where an arm is known, see `Arm.require_near`."""
LARGEST_LENGTH = 1e4
"""Largest coordinate or size of an obstacle [m]; larger squares lose the digits that distances need."""
SMALLEST_LENGTH = 1e-9
"""Smallest size of something solid, and distance of points of a curve [m]: no product of two vanishes."""


def require_instance(name: str, value: object, kind: type | UnionType, allowed: str) -> None:
    """Raise InvalidValue, with the words `allowed`, unless a value is an instance of a class."""
    if not isinstance(value, kind):
        raise InvalidValue(name, value, allowed)


def require_function(name: str, value: object) -> None:
    """Raise InvalidValue unless a value is a function, or None."""
    if not (value is None or callable(value)):
        raise InvalidValue(name, value, "a function, or None")


def require_known(kind: str, name: object, known: Collection[str]) -> None:
    """Raise UnknownName unless a name is one of those known."""
    if not isinstance(name, str) or name not in known:
        raise UnknownName(kind, name, known)


def require_name(what: str, name: object) -> str:
    """Return a name; raise InvalidValue unless it is printable text that is not blank."""
    if not isinstance(name, str) or not name.strip() or not name.isprintable():
        raise InvalidValue(what, name, "printable text that is not blank")
    return name


def is_number(value: object) -> bool:
    """Return whether a value is a real number, of Python or numpy, and not a truth value."""
    return isinstance(value, Real) and not isinstance(value, bool)


def is_usable(value: object) -> bool:
    """Return whether a value is a number of at most `LARGEST_NUMBER` either way."""
    return is_number(value) and -LARGEST_NUMBER <= value <= LARGEST_NUMBER  # type: ignore[operator]


def require_positive(name: str, value: float, zero: bool = False) -> float:
    """Return a finite number > 0 (or >= 0), neither huge nor tiny, else raise InvalidValue."""
    if not (is_number(value) and (SMALLEST_NUMBER <= value <= LARGEST_NUMBER or (zero and value == 0))):
        allowed = f"a finite number {'>=' if zero else '>'} 0"
        extreme = is_number(value) and 0 < value < math.inf
        raise InvalidValue(
            name, value, f"{allowed}, from {SMALLEST_NUMBER:g} to {LARGEST_NUMBER:g}" if extreme else allowed
        )
    return float(value)


def require_share(name: str, value: float) -> float:
    """Return a number in [0, 1), else raise InvalidValue."""
    if not (is_number(value) and 0.0 <= value < 1.0):
        raise InvalidValue(name, value, "a number in [0, 1)")
    return float(value)


def is_whole(value: object) -> bool:
    """Return whether a value is a whole number, of Python or numpy, and not a truth value."""
    return isinstance(value, Integral) and not isinstance(value, bool)


def require_whole(name: str, value: int, least: int, most: int = 10**9) -> int:
    """Return a whole number of at least `least` and at most `most`, else raise InvalidValue."""
    if not (is_whole(value) and least <= value <= most):
        allowed = f"at least {least}" if is_whole(value) and value < least else f"{least} to {most}"
        raise InvalidValue(name, value, f"a whole number of {allowed}")
    return int(value)


def as_number(name: str, value: object, allowed: str, test: Callable[[float], bool]) -> float:
    """Read one finite number for which `test` holds, else raise InvalidValue with the words `allowed`."""
    number = float(value) if is_usable(value) else math.nan  # type: ignore[arg-type]
    if not (math.isfinite(number) and test(number)):
        extreme = is_number(value) and LARGEST_NUMBER < abs(value) < math.inf  # type: ignore[arg-type]
        unbounded = extreme and test(LARGEST_NUMBER)
        raise InvalidValue(name, value, f"{allowed}, at most {LARGEST_NUMBER:g}" if unbounded else allowed)
    return number


def as_generator(name: str, value: Any) -> np.random.Generator:
    """Return a generator of random numbers, given one, a seed, or None, else raise InvalidValue."""
    if not (value is None or isinstance(value, np.random.Generator) or (is_whole(value) and value >= 0)):
        raise InvalidValue(name, value, "a numpy.random.Generator, a whole number >= 0 as seed, or None")
    return np.random.default_rng(value)


def as_count(name: str, value: object, low: int, high: int) -> int:
    """Read an integer from `low` to `high`, else raise InvalidValue."""
    allowed = f"an integer from {low} to {high}"
    return int(as_number(name, value, allowed, lambda x: low <= x <= high and x == int(x)))


def length(name: str, value: Any, zero: bool = False) -> float:
    """Read a length above 0, or not below it [m], else raise InvalidValue."""
    least = 0.0 if zero else SMALLEST_LENGTH
    allowed = f"a length of {least:g} to {LARGEST_LENGTH:g} m"
    return as_number(name, value, allowed, lambda x: least <= x <= LARGEST_LENGTH)


def as_points(
    value: ArrayLike, least: int = 2, name: Callable[[int], str] = "point {}".format
) -> NDArray[np.float64]:
    """Read points given by a caller.

    Args:
        value: shape (n, 2), then z = 0, or (n, 3) [m].
        least: how many points are needed.
        name: what to call the i-th point in a message.

    Returns:
        The points, shape (n, 3) [m], a copy.

    Raises:
        CurveError: too few points, not 2 or 3 finite coordinates each, or coordinates beyond 1e9 m.
    """
    try:
        raw = np.asarray(value)
    except ValueError:  # rows of different lengths
        raw = np.empty(0, dtype=object)
    if raw.dtype.kind not in "iuf" or (raw.ndim != 2 and raw.size):
        raise _malformed(value, name)
    if len(raw) < least:
        count = f"{len(raw)} point{'s' * (len(raw) != 1)}"
        raise CurveError("points", f"{count} given, at least {least} needed")
    if raw.shape[1] not in (2, 3):
        raise CurveError("points", f"{raw.shape[1]} coordinates each; allowed: 2 (then z = 0) or 3")
    points = np.zeros((len(raw), 3))
    points[:, : raw.shape[1]] = raw
    bad = ~(np.abs(points) <= LARGEST_COORDINATE)  # true for NaN too
    if bad.any():
        i, axis = np.argwhere(bad)[0]
        raise CurveError(
            name(int(i)),
            f"{'xyz'[axis]} is {points[i, axis]}; allowed: finite, at most {LARGEST_COORDINATE:g} m in size",
        )
    return points


def _malformed(value: object, name: Callable[[int], str]) -> CurveError:
    """Return the error about the first row that keeps a value from being a table of numbers."""
    allowed = "allowed: rows of 2 or of 3 numbers"
    scalar = getattr(value, "ndim", 1) == 0
    if scalar or not isinstance(value, (Sequence, np.ndarray)) or isinstance(value, str):
        return CurveError("points", f"{_short(value)} is not a list of points; {allowed}")
    size = None
    for i, row in enumerate(value):
        if not isinstance(row, (Sequence, np.ndarray)) or isinstance(row, str):
            return CurveError(name(i), f"{_short(row)} is not a point; {allowed}")
        for entry in row:
            if not isinstance(entry, Real):
                return CurveError(name(i), f"{_short(entry)} is not a number; {allowed}")
        size = len(row) if size is None else size
        if len(row) != size:
            return CurveError(name(i), f"{len(row)} coordinates where {name(0)} has {size}; {allowed}")
    return CurveError("points", f"not a table of numbers; {allowed}")


def _short(value: object) -> str:
    text = repr(value)
    return text if len(text) < 60 else text[:57] + "..."


def check_distinct(points: NDArray[np.float64], name: Callable[[int], str] = "point {}".format) -> None:
    """Refuse consecutive points in the same place.

    Args:
        points: shape (n, 3) [m].
        name: what to call the i-th point in a message.

    Raises:
        CurveError: naming both points.
    """
    extent = float(np.linalg.norm(np.ptp(points, axis=0)))
    rounding = 1e-10 * float(np.abs(points).max())
    tolerance = max(ROUNDING * extent, rounding, SMALLEST_LENGTH)
    gaps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    repeated = np.flatnonzero(gaps <= tolerance)
    if repeated.size:
        i = int(repeated[0])
        where = ", ".join(f"{x:.6g}" for x in points[i])
        raise CurveError(
            f"{name(i)} and {name(i + 1)}",
            f"the same place ({where}); allowed: consecutive points more than {tolerance:.3g} m apart",
        )


def as_vector(name: str, value: ArrayLike) -> NDArray[np.float64]:
    """Read 3 finite numbers (or 2, then z = 0) into shape (3,), else raise InvalidValue."""
    allowed = f"3 finite numbers, or 2 (then z = 0), at most {LARGEST_COORDINATE:g} in size"
    try:
        raw = np.asarray(value)
    except ValueError:
        raise InvalidValue(name, value, allowed) from None
    numeric = raw.dtype.kind in "iuf" and raw.shape in ((2,), (3,))
    if not (numeric and (np.abs(raw) <= LARGEST_COORDINATE).all()):
        raise InvalidValue(name, value, allowed)
    vector = np.zeros(3)
    vector[: len(raw)] = raw
    return vector


def as_floats(name: str, values: ArrayLike, allowed: str = "numbers") -> NDArray[np.float64]:
    """Return a fresh C-contiguous array of floats, else raise InvalidValue with the words `allowed`."""
    try:
        if np.iscomplexobj(values):  # numpy would drop the imaginary parts
            raise TypeError
        return np.array(values, dtype=np.float64, order="C")
    except (TypeError, ValueError, OverflowError):
        raise InvalidValue(name, values, allowed) from None


def float_array(name: str, values: ArrayLike, shape: tuple[int, ...]) -> NDArray[np.float64]:
    """Return a fresh array of floats, finite or not.

    Raises:
        InvalidValue: not numbers, or another shape.
    """
    array = as_floats(name, values, f"numbers of shape {shape}")
    if array.shape != shape:
        raise InvalidValue(f"{name} (shape)", array.shape, f"{shape} for this arm")
    return array


def finite_array(
    name: str,
    values: ArrayLike,
    shape: tuple[int | None, ...] | None = None,
    largest: float = LARGEST_NUMBER,
) -> NDArray[np.float64]:
    """Return a fresh array of finite floats; None in the shape stands for any positive length.

    Raises:
        InvalidValue: not numbers, another shape, or an entry that is not finite or larger than `largest`
            either way; names the entry.
    """
    words = "finite numbers" if shape is None else f"finite numbers of shape {shape}".replace("None", "k")
    array = as_floats(name, values, words)
    if values is None:
        raise InvalidValue(name, None, words)
    if shape is not None:
        sizes = zip(array.shape, shape, strict=False)
        if array.ndim != len(shape) or not all(have == (want or max(have, 1)) for have, want in sizes):
            raise InvalidValue(f"{name} (shape)", array.shape, words)
    require_finite(name, array, largest)
    return array


def require_finite(name: str, array: NDArray[np.float64], largest: float = LARGEST_NUMBER) -> None:
    """Raise InvalidValue if an entry is not finite, or larger than `largest` either way; names the entry."""
    if np.vdot(array, array) <= largest * largest:  # in nearly every call; other products warn of overflow
        return
    for where in entries_beyond(array, largest)[:1]:
        number = float(array[tuple(where)])
        allowed = f"finite numbers{f' of at most {largest:g} in size' if math.isfinite(number) else ''}"
        raise InvalidValue(f"{name}{where.tolist() or ''}", number, allowed)


def entries_beyond(array: NDArray[np.float64], largest: float) -> NDArray[np.intp]:
    """Return the indices of entries that are not finite or larger than `largest` either way, (n, ndim)."""
    return np.argwhere(~(np.abs(array) <= largest))


def finite_vector(
    name: str, values: ArrayLike, size: int, largest: float = LARGEST_COORDINATE
) -> NDArray[np.float64]:
    """Return a fresh vector (size,) of finite floats.

    Raises:
        InvalidValue: not numbers, another shape, or an entry that is not finite or larger than `largest`
            either way; names the entry.
    """
    vector = float_array(name, values, (size,))
    require_finite(name, vector, largest)
    return vector


def set_fields(frozen: object, **values: object) -> None:
    """Set attributes of a frozen dataclass during its construction."""
    for name, value in values.items():
        object.__setattr__(frozen, name, value)


def make_read_only(*values: object) -> None:
    """Make the arrays among some values read-only."""
    for value in values:
        if isinstance(value, np.ndarray):
            value.flags.writeable = False


def rigid_placement(name: str, value: object) -> pin.SE3:
    """Return a fresh placement, from a `pin.SE3` or a homogeneous matrix (4, 4); the identity for None.

    Raises:
        InvalidValue: anything else, or a matrix that is not finite, or scales, shears or mirrors.
    """
    if value is None:
        return pin.SE3.Identity()
    try:
        matrix = np.array(value.homogeneous if isinstance(value, pin.SE3) else value, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        matrix = np.zeros(0)
    if matrix.shape == (4, 4) and np.all(np.isfinite(matrix)):
        require_finite(f"translation of {name}", matrix[:3, 3], LARGEST_COORDINATE)
        turn = matrix[:3, :3]
        proper = _is_orthogonal(turn) and np.linalg.det(turn) > 0.0
        if proper and np.allclose(matrix[3], (0.0, 0.0, 0.0, 1.0), atol=1e-12):
            return pin.SE3(turn, matrix[:3, 3])
    raise InvalidValue(name, value, "a pin.SE3, or a finite rigid transform (4, 4)")


def _is_orthogonal(matrix: NDArray[np.float64]) -> bool:
    return matrix.shape == (3, 3) and np.allclose(matrix @ matrix.T, np.eye(3), atol=1e-6)


def point(name: str, value: Any, allowed: str = "three finite numbers") -> Vector:
    """Read three finite numbers up to `LARGEST_LENGTH`, else raise InvalidValue."""
    numbers = _numbers(name, value, (3,), allowed)
    worst = int(np.argmax(np.abs(numbers)))
    if abs(numbers[worst]) > LARGEST_LENGTH:
        allowed = f"at most {LARGEST_LENGTH:g} either way"
        raise InvalidValue(f"{name}[{worst}]", float(numbers[worst]), allowed)
    x, y, z = numbers.tolist()
    return x, y, z


def direction(name: str, value: Any) -> Vector:
    """Return the unit vector along three finite numbers that are not all 0, else raise InvalidValue."""
    x, y, z = point(name, value)
    size = math.hypot(x, y, z)
    if size < SMALLEST_LENGTH:
        raise InvalidValue(name, value, "three numbers, not all 0")
    # A unit vector stays as it is, so that what is written to a file reads back the same.
    return (x, y, z) if abs(size - 1.0) < 1e-15 else (x / size, y / size, z / size)


def rotation(name: str, value: Any) -> Matrix:
    """Read a rotation: (3, 3), or roll, pitch and yaw [rad] as in URDF, or None for the identity.

    Raises:
        InvalidValue: anything else, or a matrix that scales, shears or mirrors.
    """
    allowed = "a rotation matrix (3, 3), or three angles: roll, pitch, yaw [rad]"
    if value is None:
        turn = np.eye(3)
    else:
        numbers = _numbers(name, value, None, allowed)
        if numbers.shape == (3,) and np.abs(numbers).max() > 2.0 * np.pi:
            raise InvalidValue(name, value, "angles within 2 pi either way, in rad, not in degrees")
        turn = pin.rpy.rpyToMatrix(*numbers) if numbers.shape == (3,) else numbers
        if not _is_orthogonal(turn):
            raise InvalidValue(name, value, allowed)
        if np.linalg.det(turn) < 0.0:
            raise InvalidValue(name, value, "a rotation; this matrix mirrors")
    x, y, z = (tuple(float(number) for number in row) for row in turn)
    return x, y, z  # type: ignore[return-value]


def _numbers(name: str, value: Any, shape: tuple[int, ...] | None, allowed: str) -> np.ndarray:
    try:
        array = np.array(value)
        numbers = array.astype(np.float64) if array.dtype.kind in "iuf" else np.zeros(0)
    except (TypeError, ValueError, OverflowError):
        numbers = np.zeros(0)
    if not numbers.size or (shape is not None and numbers.shape != shape) or not np.all(np.isfinite(numbers)):
        raise InvalidValue(name, value, allowed)
    return numbers
