"""Splines, lines and helices as B-splines."""

from __future__ import annotations

import math
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import make_interp_spline

from pinposture.curve.bspline import MAX_DEGREE, Parts
from pinposture.curve.checks import as_count, as_flag, as_number, as_points, as_vector, check_distinct
from pinposture.errors import CurveError, InvalidValue

_SPANS_PER_TURN = 256  # the torsion of a quintic with this many is right to 1.2e-7
_MAX_TURNS = 1000


def chord_parameters(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Parameters (n,) from 0 to 1 that increase with the distance along the polygon of `points` (n, 3)."""
    along = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1)))
    return np.asarray(along / along[-1])


def clamped_uniform_knots(n: int, degree: int) -> NDArray[np.float64]:
    """Even knots (n + degree + 1,) from 0 to 1, repeated at the ends: the curve meets its end points."""
    inner = np.linspace(0, 1, n - degree + 1)
    return np.concatenate([np.zeros(degree), inner, np.ones(degree)])


def interpolating(points: NDArray[np.float64], degree: int) -> Parts:
    """Spline through `points` (n, 3) at chord-length parameters; for even degrees the knots lie midway."""
    spline = make_interp_spline(chord_parameters(points), points, k=degree)
    return Parts(spline.t, spline.c, degree)


def spline(control_points: ArrayLike, degree: int, through: bool) -> Parts:
    """See `Curve.spline`."""
    k = as_count("degree", degree, 1, MAX_DEGREE)
    points = as_points(control_points, least=2)
    if len(points) <= k:
        raise CurveError("points", f"{len(points)} given; a spline of degree {k} needs at least {k + 1}")
    check_distinct(points)
    if as_flag("through", through):
        return interpolating(points, k)
    return Parts(clamped_uniform_knots(len(points), k), points, k)


def line(a: ArrayLike, b: ArrayLike) -> Parts:
    """See `Curve.line`."""
    ends = np.stack([as_vector("a", a), as_vector("b", b)])
    check_distinct(ends, ("a", "b").__getitem__)
    return Parts(clamped_uniform_knots(2, 1), ends, 1)


def helix(
    radius: float,
    pitch: float,
    turns: float,
    axis: ArrayLike,
    *,
    center: ArrayLike,
    phase: float,
    handedness: Literal["right", "left"],
) -> Parts:
    """See `Curve.helix`."""
    r = as_number("radius", radius, "a length from 1e-6 to 1e9 m", lambda x: 1e-6 <= x <= 1e9)
    rise = as_number("pitch", pitch, "0 m (a circle) or a length up to 1e6 m", lambda x: 0 <= x <= 1e6)
    n_turns = as_number("turns", turns, f"above 0, up to {_MAX_TURNS}", lambda x: 0 < x <= _MAX_TURNS)
    begin = as_number("phase", phase, "a finite angle [rad]", lambda x: True)
    if handedness not in ("right", "left"):
        raise InvalidValue("handedness", handedness, "'right' or 'left'")
    along, zero, quarter = _frame(as_vector("axis", axis), axis)
    if handedness == "left":
        quarter = -quarter
    spans = math.ceil(_SPANS_PER_TURN * n_turns)
    step = 2 * math.pi * n_turns / spans
    # The quintic spline with knots and coefficients evenly spaced in the angle has the symmetry of the helix,
    # so its coefficients lie on a helix too, wider by a factor that follows from the values 1, 26, 66, 26, 1
    # (of 120) of the basis at the knots. The knots go on beyond the ends; clamping them would break the
    # symmetry.
    wider = r * 60 / (33 + 26 * math.cos(step) + math.cos(2 * step))
    knots = np.arange(-5, spans + 6) / spans
    share = np.arange(-2, spans + 3) / spans  # of the way, at each coefficient
    angle = (begin + 2 * math.pi * n_turns * share)[:, None]
    around = np.cos(angle) * zero + np.sin(angle) * quarter
    rising = (rise * n_turns * share)[:, None] * along
    return Parts(knots, as_vector("center", center) + wider * around + rising, 5)


def _frame(
    axis: NDArray[np.float64], given: ArrayLike
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Unit vectors along the axis, to phase 0, and to a quarter of a right-handed turn."""
    size = float(np.linalg.norm(axis))
    if size < 1e-9:
        raise InvalidValue("axis", given, "a direction, so not zero")
    along = axis / size
    up = np.array([0.0, 0.0, 1.0])
    if np.linalg.norm(np.cross(along, up)) < 1e-6:
        up = np.array([1.0, 0.0, 0.0])
    zero = up - (up @ along) * along
    zero /= np.linalg.norm(zero)
    return along, zero, np.cross(along, zero)
