"""The curve whose shape an arm takes: construction, motion, files; and curves by name."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import ValidationInfo
from scipy.interpolate import BSpline, make_interp_spline
from scipy.linalg import LinAlgError, solve, solveh_banded
from scipy.optimize import brentq
from scipy.sparse import csr_array, diags_array, eye_array

from pinposture import kernels
from pinposture._validation import (
    LARGEST_COORDINATE,
    as_count,
    as_floats,
    as_number,
    as_points,
    as_vector,
    check_distinct,
)
from pinposture.curve.geometry import MAX_DEGREE, Geometry, Parts, trim
from pinposture.errors import CurveError, FileError, InvalidValue, PostureError, did_you_mean
from pinposture.schema import (
    CheckedBy,
    Flag,
    NotAllowed,
    WrittenBy,
    call_described,
    checked,
    checked_number,
    in_file,
    in_si,
    is_file_name,
    one_of,
    read_by,
    read_keys,
    read_plain,
    read_within,
    refusing,
)
from pinposture.storage import parse_json, read_text, require_suffix, settled, write_text


def _direction(name: str, value: ArrayLike) -> NDArray[np.float64]:
    vector = as_vector(name, value)
    if np.linalg.norm(vector) < 1e-9:
        raise InvalidValue(name, value, "a direction, so not zero")
    return vector


_Degree = Annotated[int, CheckedBy(partial(as_count, low=1, high=MAX_DEGREE))]
_Point = Annotated[ArrayLike, CheckedBy(as_vector, "length")]
_Radius = Annotated[
    float, checked_number("a length from 1e-6 to 1e9 m", lambda x: 1e-6 <= x <= 1e9, "length")
]
_Pitch = Annotated[
    float, checked_number("0 m (a circle) or a length up to 1e6 m", lambda x: 0 <= x <= 1e6, "length")
]
_Turns = Annotated[float, checked_number("above 0, up to 1000", lambda x: 0 < x <= 1000)]
_Phase = Annotated[float, checked_number("a finite angle [rad]", lambda x: True, "angle")]
_Smoothing = Annotated[
    float,
    checked_number(
        "an RMS distance of 0 m (through the points) up to 1e9 m", lambda x: 0 <= x <= 1e9, "length"
    ),
]


@dataclass(frozen=True, eq=False, repr=False)
class Curve(Geometry):
    """A curve in space.

    Create one with `spline`, `line`, `helix`, `points`, `load` or `from_dict`; each is a B-spline. A curve is
    immutable: methods that change it return a new one. It can be pickled, and equals another if degree, knots
    and coefficients are identical. Coordinates are in metres, in the frame of the points from which it was
    created. `Geometry` provides the queries by arc length.
    """

    @classmethod
    @checked
    def spline(
        cls,
        control_points: ArrayLike,
        degree: _Degree = 3,
        through: Flag = False,
    ) -> Curve:
        """Create a spline from a few points.

        Args:
            control_points: shape (n, 3), or (n, 2) with z = 0, n > degree [m].
            degree: 1 to 5.
            through: False: a B-spline *controlled by* the points, which begins at the first, ends at the
                last, and only approaches those between (clamped, uniform knots). True: a spline *through* all
                the points (at chord-length parameters).

        Raises:
            CurveError: the points are too few, malformed, not finite or repeated, or give a cusp.
            InvalidValue: invalid `degree` or `through`.
        """
        points = as_points(control_points, least=2)
        if len(points) <= degree:
            reason = f"{len(points)} given; a spline of degree {degree} needs at least {degree + 1}"
            raise CurveError("points", reason)
        check_distinct(points)
        if through:
            return cls(*interpolate(points, degree))
        return cls(clamped_uniform_knots(len(points), degree), points, degree)

    @classmethod
    @checked
    def line(cls, a: _Point, b: _Point) -> Curve:
        """Create the straight line from `a` to `b`, each shape (3,), or (2,) with z = 0 [m].

        Raises:
            CurveError: `a` and `b` coincide.
            InvalidValue: one of them is not 2 or 3 finite numbers.
        """
        ends = np.stack([a, b])
        check_distinct(ends, ("a", "b").__getitem__)
        return cls(clamped_uniform_knots(2, 1), ends, 1)

    @classmethod
    @checked
    def helix(
        cls,
        radius: _Radius,
        pitch: _Pitch,
        turns: _Turns,
        axis: Annotated[ArrayLike, CheckedBy(_direction)] = (1, 0, 0),
        *,
        center: _Point = (0, 0, 0),
        phase: _Phase = 0.0,
        handedness: Annotated[Literal["right", "left"], one_of("handedness", "right", "left")] = "right",
    ) -> Curve:
        """Create a helix, or with pitch 0 a circle.

        It advances along `axis` while turning about it, like a common screw if right-handed. Phase 0 is the
        side of the axis towards +z, or towards +x if the axis is along z. The curve (6.17), x = 0.6 t,
        y = 0.06 sin(8 pi t), z = 0.06 cos(8 pi t), is `Curve.helix(0.06, 0.15, 4, handedness="left")`.

        The helix is a quintic spline, accurate to 1e-10 of the radius, in curvature and torsion to 1e-6.

        Args:
            radius: distance from the axis, at least 1e-6 [m].
            pitch: advance per turn, 0 or more [m].
            turns: number of turns, above 0, at most 1000; may be fractional.
            axis: direction, shape (3,), of any length.
            center: the point of the axis next to the start of the helix, shape (3,) [m].
            phase: start angle from phase 0, in the sense of rotation [rad].
            handedness: "right" or "left".

        Raises:
            UnknownName: another handedness.
            InvalidValue: another invalid argument, which is named.
        """
        along, zero, quarter = _frame(np.asarray(axis))
        if handedness == "left":
            quarter = -quarter
        spans = math.ceil(256 * turns)  # the error of torsion is 1.2e-7
        step = 2 * math.pi * turns / spans
        # The coefficients of a quintic spline with uniform knots lie on a helix, too. It is wider by a factor
        # that follows from the values 1, 26, 66, 26, 1 (of 120) of the basis at the knots. The knots extend
        # beyond the ends, because clamping would break the symmetry.
        wider = radius * 60 / (33 + 26 * math.cos(step) + math.cos(2 * step))
        knots = np.arange(-5, spans + 6) / spans
        fraction = np.arange(-2, spans + 3) / spans  # of the length, at each coefficient
        angle = (phase + 2 * math.pi * turns * fraction)[:, None]
        around = np.cos(angle) * zero + np.sin(angle) * quarter
        rising = (pitch * turns * fraction)[:, None] * along
        return cls(knots, np.asarray(center) + wider * around + rising, 5)

    @classmethod
    @checked
    def points(cls, points: ArrayLike, smoothing: _Smoothing = 0.0) -> Curve:
        """Create a curve from sampled or measured points.

        Args:
            points: shape (n, 3), or (n, 2) with z = 0, n >= 2 [m].
            smoothing: allowed RMS distance [m] of a smoother curve from the points; use about the RMS
                measurement error. 0: through the points (a cubic; a parabola through 3, a line through 2), as
                also for 3 points or fewer, or if no smoother curve is close enough.

        Raises:
            CurveError: the points are too few, malformed, not finite or repeated, or give a cusp.
            InvalidValue: invalid smoothing.
        """
        data = as_points(points)
        check_distinct(data)
        n = len(data)
        if smoothing > 0 and n > _Fit.degree:
            spans = 4
            while spans < n:
                fit = _Fit(data, spans)
                if fit.rms(fit.least) <= smoothing:
                    return cls(*fit.smoothest(smoothing))
                spans *= 2
        # Too few points to smooth, or no smoother curve is close enough.
        return cls(*interpolate(data, min(_Fit.degree, n - 1)))

    @classmethod
    def from_dict(cls, description: Mapping[str, Any]) -> Curve:
        """Create a curve from plain data, either from `to_dict` or written by hand.

        Args:
            description: the name of a constructor under "type" and its arguments under their names, as in
                {"type": "spline", "control_points": [...], "degree": 3, "through": True}. The types are
                "spline", "line", "helix", "points" (with the points under "points") and "bspline" (knots,
                coefficients, degree).

        Raises:
            UnknownName: no such type.
            InvalidValue: a missing key, one that does not exist, or as the constructor.
            CurveError: as the constructor.
        """
        curve: Curve = read_plain(_Described, description)
        return curve

    def to_dict(self) -> dict[str, Any]:
        """Return JSON-compatible data from which `from_dict` creates an equal curve."""
        return {
            "type": "bspline",
            "degree": self.degree,
            "knots": self.knots.tolist(),
            "coefficients": self.coefficients.tolist(),
        }

    @classmethod
    def load(cls, path: str | Path, scale: float = 1.0) -> Curve:
        """Read a curve from a file.

        Args:
            path: a .json file of `save`, or with a description as in `from_dict`, or with a plain list of
                points; or a .csv or .txt table with the columns x, y and optionally z [m], separated by
                commas, semicolons or spaces, with or without a header line, and with comments after '#'. A
                header may give another unit: x [mm] or x_mm, or cm. The curve passes through listed points
                as in `points`.
            scale: scale factor for its coordinates, such as 0.001 for a file in millimetres.

        Raises:
            FileError: an invalid file; names the line, row or key.
            InvalidValue: a scale that is not a number above 0.
        """
        path = Path(path)
        factor = as_number("scale", scale, "a finite number > 0", lambda x: x > 0.0)
        try:
            read = cls.from_dict(read_description(path))
            return read if factor == 1.0 else cls(read.knots, factor * read.coefficients, read.degree)
        except PostureError as error:
            if isinstance(error, FileError):
                raise
            raise FileError(path, str(error)) from error

    def save(self, path: str | Path) -> None:
        """Write the curve to a .json file, from which `load` creates an equal curve.

        An existing file is replaced atomically.

        Raises:
            FileError: the name does not end in .json, or the file cannot be written.
        """
        require_suffix(Path(path), ".json")
        write_text(Path(path), json.dumps(self.to_dict(), allow_nan=False) + "\n")

    @property
    def control_points(self) -> NDArray[np.float64] | None:
        """The control points, (n, 3) [m], if the curve has the form of `spline`; else None."""
        knots = self.knots - self.knots[0]
        even = clamped_uniform_knots(len(self.coefficients), self.degree)
        return self.coefficients if np.abs(knots / knots[-1] - even).max() <= 1e-12 else None

    def controlled(self, count: int, degree: int = 3) -> Curve:
        """Approximate this curve by one controlled by a few points, as in `spline`.

        This is the least-squares fit to samples of equal arc length, with the same ends. The parameter of
        each sample is its fraction of the length or that of this curve, whichever fits better. A curve that
        already has this form is returned unchanged.

        Args:
            count: number of control points, above the degree, at most 1000.
            degree: 1 to 5.

        Returns:
            The curve, with its `control_points`.

        Raises:
            InvalidValue: invalid count or degree.
            CurveError: the points are too few: the curve's velocity would vanish somewhere.
        """
        k = as_count("degree", degree, 1, MAX_DEGREE)
        n = as_count("count", count, k + 1, MAX_CONTROL_POINTS)
        if self.degree == k and len(self.coefficients) == n and self.control_points is not None:
            return self
        s = np.linspace(0.0, self.length, _samples(self, n))
        samples = self.at(s)
        knots = clamped_uniform_knots(n, k)
        # The curve's own parameter suits splines with more knots of this kind, the fraction of the length
        # curves whose parameter is unrelated to uniform knots.
        u = kernels.parameters_at(self._arc, s)
        begin = self.knots[self.degree]
        end = self.knots[-self.degree - 1]
        fits = []
        for parameters in ((u - begin) / (end - begin), s / self.length):
            basis = csr_array(BSpline.design_matrix(np.clip(parameters, 0.0, 1.0), knots, k))
            try:
                fits.append(_fit(basis, samples))
            except LinAlgError:  # no sample is near some control point
                continue
        coefficients, _ = min(fits, key=lambda fit: fit[1])
        check_distinct(coefficients, "control point {} of the nearest".format)
        return type(self)(knots, coefficients, k)

    def controlled_within(self, tolerance: float, degree: int = 3, most: int = 50) -> Curve:
        """Approximate this curve as in `controlled` with the fewest points within a tolerance.

        Args:
            tolerance: largest distance between the curves, in both directions [m].
            degree: 1 to 5.
            most: maximum number of control points.

        Raises:
            InvalidValue: an invalid argument, or a tolerance that `most` points cannot meet.
        """
        k = as_count("degree", degree, 1, MAX_DEGREE)
        last = as_count("most", most, k + 1, MAX_CONTROL_POINTS)
        near = as_number(
            "tolerance", tolerance, f"a distance above 0, up to {LARGEST_COORDINATE:g} m", lambda x: x > 0.0
        )
        nearest = np.inf
        for n in range(k + 1, last + 1):
            try:
                simpler = self.controlled(n, k)
            except CurveError:  # its velocity vanishes, as for a closed curve with few points
                continue
            # Few samples suffice to reject it, which is the most frequent case.
            apart = float(simpler.nearest(self.resample(COMPARISON.fewest)).distance.max())
            if apart <= near:
                apart = deviation(self, simpler)
                if apart <= near:
                    return simpler
            nearest = min(nearest, apart)
        allowed = f"{nearest:.4g} m or more with {last} control points at most, of degree {k}"
        raise InvalidValue("tolerance", tolerance, allowed if nearest < np.inf else "more control points")

    def moved(self, rotation: ArrayLike, translation: ArrayLike = (0, 0, 0)) -> Curve:
        """Return the curve rotated about the origin, then translated.

        Args:
            rotation: shape (3, 3), a proper rotation to within 1e-6.
            translation: shape (3,) [m].

        Raises:
            InvalidValue: invalid rotation or translation.
        """
        turn = as_floats("rotation", rotation, "a (3, 3) rotation matrix")
        # NaN compares false and is rejected here, too.
        stretch = float(np.abs(turn @ turn.T - np.eye(3)).max()) if turn.shape == (3, 3) else np.inf
        if not (stretch < 1e-6 and np.linalg.det(turn) > 0):
            raise InvalidValue("rotation", rotation, "a (3, 3) rotation matrix: orthonormal, determinant +1")
        shifted = self.coefficients @ turn.T + as_vector("translation", translation)
        return self._with_coefficients(shifted, stretch)

    def reversed(self) -> Curve:
        """Return the same curve in the opposite direction."""
        knots = (self.knots[0] + self.knots[-1]) - self.knots[::-1]
        return type(self)(knots, self.coefficients[::-1], self.degree)

    def trimmed(self, start: float, end: float) -> Curve:
        """Return the part between two arc lengths [m], which must be more than 1e-6 of the length apart.

        Raises:
            InvalidValue: invalid `start` or `end`.
        """
        span = 1e-6 * self.length
        length = self.length
        words = f"an arc length from {{}} to {{}} m, {span:.3g} m or more from the other end"
        low = as_number("start", start, words.format(0, length), lambda s: 0 <= s <= length - span)
        high = as_number(
            "end", end, words.format(low, length), lambda s: low + span <= s <= length * (1 + 1e-9)
        )
        begin, stop = kernels.parameters_at(self._arc, np.array([low, min(high, length)]))
        return type(self)(*trim(self._spline, float(begin), float(stop)))

    def insert_knot(self, u: float) -> Curve:
        """Return the same curve with one more knot and one more coefficient.

        The shape is unchanged. The new coefficients lie on the lines between the old ones (W. Boehm,
        "Inserting new knots into B-spline curves", Computer-Aided Design 12 (4), 1980).

        Args:
            u: the knot, a parameter of the B-spline between `knots[degree]` and `knots[-degree - 1]`.

        Raises:
            InvalidValue: not a number between the ends.
            CurveError: the knot already has a multiplicity of the degree, or is too close to another one.
        """
        t = self.knots
        k = self.degree
        n = len(self.coefficients)
        low = float(t[k])
        high = float(t[n])
        knot = as_number("u", u, f"a parameter between {low:g} and {high:g}", lambda x: low < x < high)
        before = t[: n + 1]
        after = t[k:]
        with np.errstate(divide="ignore"):  # u is not a knot of full multiplicity
            share = np.clip((knot - before) / (after - before), 0.0, 1.0)[:, None]
        points = np.pad(self.coefficients, ((1, 1), (0, 0)), "edge")
        knots = np.insert(t, np.searchsorted(t, knot, side="right"), knot)
        return type(self)(knots, share * points[1:] + (1.0 - share) * points[:-1], k)


def read_description(path: Path) -> dict[str, Any]:
    """Read a curve file into a description for `Curve.from_dict`.

    Raises:
        FileError: missing, unreadable, of another format, or a malformed line.
        CurveError: invalid points in a table; names the line.
    """
    suffix = require_suffix(path, ".json", ".csv", ".txt")
    text = read_text(path)
    if suffix != ".json":
        return {"type": "points", "points": _table(path, text)}
    content = parse_json(path, text)
    if isinstance(content, list):
        return {"type": "points", "points": content}
    if not isinstance(content, dict):
        raise FileError(path, f"contains {content!r}; allowed: an object with a 'type', or a list of points")
    return content


def _table(path: Path, text: str) -> list[list[float]]:
    """Return the rows of a table of coordinates, with or without a header line."""
    lines: list[int] = []
    rows: list[list[float]] = []
    headings: list[str] | None = None
    per_metre = 1.0
    for number, raw in enumerate(text.splitlines(), start=1):
        content = raw.partition("#")[0].strip()
        if not content:
            continue
        fields = _fields(content)
        values = [_coordinate(field) for field in fields]
        if not rows and headings is None and all(fields) and not any(value is not None for value in values):
            pattern = re.compile(r"([xyz])(?: *[\[(] *(m|cm|mm) *[\])]|_(m|cm|mm))?")
            matches = [pattern.fullmatch(field.strip("\"'").lower()) for field in fields]
            headings = [match[1] if match else "" for match in matches]
            units = {match[2] or match[3] or "m" for match in matches if match}
            if headings not in (["x", "y"], ["x", "y", "z"]) or len(units) > 1:
                allowed = "x, y or x, y, z, all in one unit (m; or x [mm], x [cm])"
                raise FileError(path, f"line {number}: columns {', '.join(fields)}; allowed: {allowed}")
            per_metre = {"m": 1.0, "cm": 100.0, "mm": 1000.0}[units.pop()]
            continue
        row = []
        for column, value in enumerate(values, start=1):
            if value is None:
                what = f"{fields[column - 1]!r} is not a number"
                raise FileError(path, f"line {number}, column {column}: {what}")
            row.append(value / per_metre)
        width = len(headings or (rows[0] if rows else row))
        if len(row) != width or width not in (2, 3):
            allowed = f"{width}, as before" if width in (2, 3) else "2 (then z = 0) or 3"
            raise FileError(path, f"line {number}: {len(row)} columns; allowed: {allowed}")
        lines.append(number)
        rows.append(row)
    if not rows:
        raise FileError(path, "contains no points")

    def name(i: int) -> str:
        return f"line {lines[i]}"

    check_distinct(as_points(rows, name=name), name)
    return rows


def _fields(content: str) -> list[str]:
    for separator in (";", ","):
        if separator in content:
            return [field.strip() for field in content.split(separator)]
    return content.split()


def _coordinate(field: str) -> float | None:
    try:
        return float(field)
    except ValueError:
        return None


Array = NDArray[np.float64]

MAX_CONTROL_POINTS = 1000


class ComparisonSamples(NamedTuple):
    """Samples for comparing a curve with another, at least."""

    fewest: int = 400
    """Number of samples."""

    per_point: int = 20
    """Number of samples per control point of the other curve."""

    per_span: int = 2
    """Number of samples per knot span of the curve, so that no winding is missed."""


COMPARISON = ComparisonSamples()


def chord_parameters(points: Array) -> Array:
    """Return the chord-length parameters (n,), from 0 to 1, of points (n, 3)."""
    along = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1)))
    return np.asarray(along / along[-1])


def clamped_uniform_knots(n: int, degree: int) -> Array:
    """Return uniform knots (n + degree + 1,) from 0 to 1, repeated at the ends to meet the end points."""
    inner = np.linspace(0, 1, n - degree + 1)
    return np.concatenate([np.zeros(degree), inner, np.ones(degree)])


def interpolate(points: Array, degree: int) -> Parts:
    """Interpolate points (n, 3) at chord-length parameters; for even degrees the knots are at midpoints."""
    spline = make_interp_spline(chord_parameters(points), points, k=degree)
    return spline.t, spline.c, degree


def _frame(axis: Array) -> tuple[Array, Array, Array]:
    """Return unit vectors along the axis, to phase 0, and to a quarter of a right-handed turn."""
    along = axis / np.linalg.norm(axis)
    up = np.array([0.0, 0.0, 1.0])
    if np.linalg.norm(np.cross(along, up)) < 1e-6:
        up = np.array([1.0, 0.0, 0.0])
    zero = up - (up @ along) * along
    zero /= np.linalg.norm(zero)
    return along, zero, np.cross(along, zero)


class _Fit:
    """Cubic smoothing splines with uniform knots and a penalty on the third derivative.

    A penalty on the second derivative would flatten the ends.
    """

    degree: ClassVar[int] = 3
    order: ClassVar[int] = 3

    def __init__(self, data: Array, spans: int) -> None:
        n_coefficients = spans + _Fit.degree
        self.data = data
        self.knots = clamped_uniform_knots(n_coefficients, _Fit.degree)
        self.basis = csr_array(BSpline.design_matrix(chord_parameters(data), self.knots, _Fit.degree))
        scale = spans / len(data)  # so that the entries of both matrices are of order one
        normal = (self.basis.T @ self.basis) * scale
        difference = self._difference(spans)
        self.normal = _upper_bands(normal)
        self.penalty = _upper_bands(difference.T @ difference)
        self.right = (self.basis.T @ data) * scale
        # Logarithms of the penalty weight: enough for a unique solution, and nearly a parabola.
        self.least = math.log(1e-8)
        self.most = math.log(1e-3 * spans ** (2 * _Fit.order))

    def _difference(self, spans: int) -> csr_array:
        """Return the matrix from coefficients to those of the third derivative, in units of one span."""
        knots = self.knots
        result = csr_array(eye_array(len(self.knots) - _Fit.degree - 1))
        for degree in range(_Fit.degree, _Fit.degree - _Fit.order, -1):
            widths = (knots[degree + 1 : -1] - knots[1 : -degree - 1]) / degree * spans
            result = diags_array(1 / widths) @ (result[1:] - result[:-1])
            knots = knots[1:-1]
        return result

    def coefficients(self, weight: float) -> Array:
        """Return the coefficients (n, 3) [m] for a logarithm of the penalty weight."""
        return np.asarray(solveh_banded(self.normal + math.exp(weight) * self.penalty, self.right))

    def rms(self, weight: float) -> float:
        """Return the RMS distance [m] from the points to the fit at their parameters."""
        rest = self.data - self.basis @ self.coefficients(weight)
        return math.sqrt(float((rest**2).sum(axis=1).mean()))

    def smoothest(self, distance: float) -> Parts:
        """Return the fit with the largest penalty that stays within `distance` [m]."""
        weight = self.most
        if self.rms(weight) > distance:
            weight = brentq(lambda w: self.rms(w) - distance, self.least, self.most, xtol=1e-6)
        return self.knots, self.coefficients(weight), _Fit.degree


def _upper_bands(matrix: csr_array) -> Array:
    """Return the diagonals of a symmetric matrix in LAPACK's order, from the uppermost to the main one."""
    bands = range(max(_Fit.degree, _Fit.order), -1, -1)
    return np.stack([np.append(np.zeros(i), matrix.diagonal(i)) for i in bands])


def deviation(curve: Geometry, other: Geometry) -> float:
    """Return the largest distance between two curves [m], from samples of either to the other."""
    here = curve.resample(_samples(curve, len(other.coefficients)))
    there = other.resample(_samples(other, len(other.coefficients)))
    return max(float(other.nearest(here).distance.max()), float(curve.nearest(there).distance.max()))


def _samples(curve: Geometry, count: int) -> int:
    """Return the number of samples for comparing a curve with one of `count` control points."""
    spans = len(curve.coefficients) - curve.degree
    return max(COMPARISON.fewest, COMPARISON.per_point * count, COMPARISON.per_span * spans) + 1


def _fit(basis: csr_array, samples: Array) -> tuple[Array, float]:
    """Fit control points (n, 3) [m] to samples (m, 3) [m] by least squares, with fixed end points.

    Args:
        basis: value of each basis function at each sample, (m, n).
        samples: the samples.

    Returns:
        Control points, and the residual sum of squares [m^2].

    Raises:
        LinAlgError: the samples do not determine some control point.
    """
    coefficients = np.zeros((basis.shape[1], 3))
    coefficients[[0, -1]] = samples[[0, -1]]
    rest = samples - basis @ coefficients
    inner = basis[:, 1:-1]
    if inner.shape[1]:
        normal = (inner.T @ inner).toarray()
        coefficients[1:-1] = solve(normal, inner.T @ rest, assume_a="pos")
    left = samples - basis @ coefficients
    return coefficients, float(np.einsum("ij,ij->", left, left))


_CONSTRUCTORS: dict[str, Callable[..., Curve]] = {
    "spline": Curve.spline,
    "line": Curve.line,
    "helix": Curve.helix,
    "points": Curve.points,
    "bspline": Curve,
}
"""The functions that make a curve from a description, by its `type`."""

LINE = Curve.line((0.0, 0.0, 0.0), (1.1, 0.0, 0.0))
"""The singular target posture (6.16): a straight line, 1.1 m long."""

HELIX = Curve.helix(radius=0.06, pitch=0.15, turns=4, handedness="left")
"""The non-singular target posture (6.17): y = 0.06 sin(8 pi t), z = 0.06 cos(8 pi t), x = 0.6 t.

The thesis does not give the range of t. A helix of four turns (t = 1) is 1.62 m long; the arm covers 1 m."""

PLANAR_LINE = Curve.line((0.0, 0.0, 0.0), (7.425, 0.0, 0.0))
"""A straight line for the planar arm of Section 6.2, like (6.16) a tenth longer than the arm."""

CURVES = {"line": LINE, "helix": HELIX}
"""The curves by name, as on the command line."""

# Curves as values of other descriptions.


def _read_described(value: object, _: ValidationInfo) -> Curve:
    """Read a table with the name of a constructor as `type`, and its arguments."""
    if not isinstance(value, Mapping):
        raise NotAllowed(value, "a table with a 'type'")
    return call_described(value, _CONSTRUCTORS, "curve")


_Described: TypeAlias = Annotated[Any, read_by(_read_described)]


def _read_curve(value: object, info: ValidationInfo) -> Curve:
    """Read a curve: a preset, a file, or a description."""
    source = in_file(info)
    if isinstance(value, Curve):
        return value
    if source is None:
        raise NotAllowed(value, "a Curve")
    description: object = value
    if isinstance(value, str) and (value in CURVES or not Path(value).suffix):
        if value not in CURVES:
            allowed = f"{', '.join(CURVES)}, a .json, .csv or .txt file, or a table with a type"
            raise NotAllowed(value, allowed, hint=did_you_mean(value, CURVES))
        curve = CURVES[value]
    elif isinstance(value, str):
        path = source.resolve(value)
        with refusing():
            curve = Curve.load(path)
        description = settled(path)
    elif not isinstance(value, Mapping):
        raise NotAllowed(value, "a name, a file, or a table with a type")
    elif "path" in value:
        table = read_keys(value, ("path", "scale"))
        if not is_file_name(table["path"]):
            raise NotAllowed(table["path"], "the name of a file as path")
        path = read_within("path", source.resolve, table["path"])
        with refusing(table):
            curve = Curve.load(path, table.get("scale", 1.0))
        description = {**table, "path": settled(path)}
    else:
        curve = _read_described(value, info)
        description = in_si(value, _CONSTRUCTORS[value["type"]])
    source.described[curve] = description
    return curve


def describe_curve(curve: Curve) -> dict[str, Any]:
    """Describe a curve by its control points, or by its knots and coefficients."""
    if curve.control_points is not None:
        points = curve.control_points.tolist()
        table: dict[str, Any] = {"type": "spline", "control_points": points, "degree": curve.degree}
        if curve.degree == 1 and len(points) == 2:
            table = {"type": "line", "a": points[0], "b": points[1]}
        with suppress(PostureError):  # points may be too close
            if Curve.from_dict(table) == curve:  # knots may be rounded
                if curve.degree == 3:
                    del table["degree"]
                return table
    return curve.to_dict()


CurveField: TypeAlias = Annotated[
    Curve,
    read_by(_read_curve),
    WrittenBy(lambda curve, file: file.find(curve, CurveField) or describe_curve(curve)),
]
"""A curve in a call; in a file also the name of a preset or of a file, or a description."""
