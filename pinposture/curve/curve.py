"""The curve whose shape an arm takes: how to make, move, load and save one; and curves by name."""

from __future__ import annotations

import inspect
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pinposture._validation import as_number, as_points, as_vector, check_distinct
from pinposture.curve import construction
from pinposture.curve.geometry import Geometry, trim
from pinposture.errors import CurveError, FileError, InvalidValue, UnknownName
from pinposture.storage import read_text, write_text


@dataclass(frozen=True, eq=False, repr=False)
class Curve(Geometry):
    """A curve in space.

    Make one with `spline`, `line`, `helix`, `points`, `load` or `from_dict`; each is a B-spline. A curve is
    immutable: methods that change it return another. It pickles, and equals another if degree, knots and
    coefficients are equal to the last bit. Coordinates are in metres, in the frame of the points it was made
    of. `Geometry` has the queries by arc length.
    """

    @classmethod
    def spline(cls, control_points: ArrayLike, degree: int = 3, through: bool = False) -> Curve:
        """Make a spline from a few points.

        Args:
            control_points: shape (n, 3), or (n, 2) with z = 0, n > degree [m].
            degree: 1 to 5.
            through: False: a B-spline *controlled by* the points, which begins at the first, ends at the
                last, and only approaches those between (clamped, uniform knots). True: a spline *through* all
                the points (at chord-length parameters).

        Raises:
            CurveError: points that are too few, malformed, not finite or repeated, or that give a cusp.
            InvalidValue: the degree, or `through`.
        """
        return cls(*construction.spline(control_points, degree, through))

    @classmethod
    def line(cls, a: ArrayLike, b: ArrayLike) -> Curve:
        """Make the straight line from `a` to `b`, each shape (3,), or (2,) with z = 0 [m].

        Raises:
            CurveError: `a` and `b` are the same place.
            InvalidValue: one that is not 2 or 3 finite numbers.
        """
        return cls(*construction.line(a, b))

    @classmethod
    def helix(
        cls,
        radius: float,
        pitch: float,
        turns: float,
        axis: ArrayLike = (1, 0, 0),
        *,
        center: ArrayLike = (0, 0, 0),
        phase: float = 0.0,
        handedness: Literal["right", "left"] = "right",
    ) -> Curve:
        """Make a helix, or with pitch 0 a circle.

        It advances along `axis` while it turns about it, like a common screw if right-handed. Phase 0 is the
        side of the axis that lies towards +z, or towards +x if the axis is along z. The curve (6.17),
        x = 0.6 t, y = 0.06 sin(8 pi t), z = 0.06 cos(8 pi t), is
        `Curve.helix(0.06, 0.15, 4, handedness="left")`.

        The helix is approximated by a quintic spline: places to 1e-10 of the radius, curvature and torsion to
        1e-6.

        Args:
            radius: distance from the axis, at least 1e-6 [m].
            pitch: advance in one turn, 0 or more [m].
            turns: number of turns, above 0, at most 1000; need not be whole.
            axis: direction, shape (3,), of any length.
            center: the point of the axis beside which the helix starts, shape (3,) [m].
            phase: where it starts, as an angle from phase 0 in the sense in which it turns [rad].
            handedness: "right" or "left".

        Raises:
            InvalidValue: naming the argument.
        """
        return cls(
            *construction.helix(radius, pitch, turns, axis, center=center, phase=phase, handedness=handedness)
        )

    @classmethod
    def points(cls, xyz: ArrayLike, smoothing: float = 0.0) -> Curve:
        """Make a curve from sampled or measured points.

        Args:
            xyz: shape (n, 3), or (n, 2) with z = 0, n >= 2 [m].
            smoothing: RMS distance [m] from the points that is allowed for the curve to bend evenly; about
                the RMS length of the measurement errors. 0: through the points (a cubic; a parabola through
                3, a line through 2), as also for 3 points or fewer, or if no smoother curve is close enough.

        Raises:
            CurveError: points that are too few, malformed, not finite or repeated, or that give a cusp.
            InvalidValue: the smoothing.
        """
        return cls(*construction.points(xyz, smoothing))

    @classmethod
    def from_dict(cls, description: Mapping[str, Any]) -> Curve:
        """Make a curve from plain data, as `to_dict` gives it or as written by hand.

        Args:
            description: the name of a constructor under "type" and its arguments under their names, as in
                {"type": "spline", "control_points": [...], "degree": 3, "through": True}. The types are
                "spline", "line", "helix", "points" (where the points are under "points") and "bspline"
                (knots, coefficients, degree).

        Raises:
            UnknownName: a type or key that does not exist.
            CurveError: a missing key, or as the constructor.
            InvalidValue: as the constructor.
        """

        def points(points: ArrayLike, smoothing: float = 0.0) -> Curve:
            return cls.points(points, smoothing)

        def bspline(knots: Any, coefficients: Any, degree: int) -> Curve:
            return cls(knots, coefficients, degree)

        constructors: dict[str, Callable[..., Curve]] = {
            "spline": cls.spline,
            "line": cls.line,
            "helix": cls.helix,
            "points": points,
            "bspline": bspline,
        }
        kind, arguments = read_call(description, constructors)
        return constructors[kind](**arguments)

    def to_dict(self) -> dict[str, Any]:
        """Return the curve as plain data for JSON, of which `from_dict` makes an equal curve."""
        return {
            "type": "bspline",
            "degree": self.degree,
            "knots": self.knots.tolist(),
            "coefficients": self.coefficients.tolist(),
        }

    @classmethod
    def load(cls, path: str | Path) -> Curve:
        """Read a curve from a file.

        Args:
            path: a .json file as `save` writes it, or with a description as in `from_dict`, or with a bare
                list of points; or a .csv or .txt table with the columns x, y and perhaps z [m], separated by
                commas, semicolons or spaces, with or without a line of headings, '#' beginning a comment. The
                curve goes through listed points as in `points`.

        Raises:
            FileError: naming the file, and the line, row or key that is wrong.
        """
        path = Path(path)
        try:
            return cls.from_dict(read_description(path))
        except (CurveError, InvalidValue, UnknownName) as error:
            raise FileError(path, str(error)) from error

    def save(self, path: str | Path) -> None:
        """Write the curve to a .json file, from which `load` makes an equal curve.

        An existing file is replaced atomically.

        Raises:
            FileError: the name does not end in .json, or the file cannot be written.
        """
        write_json(Path(path), self.to_dict())

    @property
    def control_points(self) -> NDArray[np.float64] | None:
        """The points that control the curve, (n, 3) [m], if it is one as `spline` makes them; else None."""
        return construction.control_points(self)

    def controlled(self, count: int, degree: int = 3) -> Curve:
        """Return the curve controlled by a few points, as in `spline`, that comes nearest to this one.

        It is the least-squares fit to samples of equal arc length, with the same ends. The parameter of each
        sample is its fraction of the length or that of this curve, whichever fits better. A curve that is
        already controlled by so many points is returned unchanged.

        Args:
            count: number of control points, above the degree, at most 1000.
            degree: 1 to 5.

        Returns:
            The curve; its `control_points` are what controls it.

        Raises:
            InvalidValue: the count or the degree.
            CurveError: the points are too few for the curve: its velocity would vanish somewhere.
        """
        return type(self)(*construction.controlled(self, count, degree))

    def controlled_within(self, tolerance: float, degree: int = 3, most: int = 50) -> Curve:
        """Return the curve as in `controlled` with the fewest points within a distance of this one.

        Args:
            tolerance: largest distance between the curves, from either one to the other [m].
            degree: 1 to 5.
            most: largest number of control points.

        Raises:
            InvalidValue: an argument, or a tolerance that so many points cannot reach; says what they can.
        """
        return type(self)(*construction.controlled_within(self, tolerance, degree, most))

    def moved(self, rotation: ArrayLike, translation: ArrayLike = (0, 0, 0)) -> Curve:
        """Return the curve turned about the origin, then shifted.

        Args:
            rotation: shape (3, 3), a proper rotation to within 1e-6.
            translation: shape (3,) [m].

        Raises:
            InvalidValue: the rotation or the translation.
        """
        try:
            turn = np.asarray(rotation, dtype=float)
        except (TypeError, ValueError):
            turn = np.empty(0)
        # A NaN compares false, so it is refused here too.
        stretch = float(np.abs(turn @ turn.T - np.eye(3)).max()) if turn.shape == (3, 3) else np.inf
        if not (stretch < 1e-6 and np.linalg.det(turn) > 0):
            raise InvalidValue("rotation", rotation, "a (3, 3) rotation matrix: orthonormal, determinant +1")
        shifted = self.coefficients @ turn.T + as_vector("translation", translation)
        return self._with_coefficients(shifted, stretch)

    def reversed(self) -> Curve:
        """Return the same curve run from its end to its start."""
        knots = (self.knots[0] + self.knots[-1]) - self.knots[::-1]
        return type(self)(knots, self.coefficients[::-1], self.degree)

    def trimmed(self, start: float, end: float) -> Curve:
        """Return the part between two arc lengths [m], which must be more than 1e-6 of the length apart.

        Raises:
            InvalidValue: `start` or `end`.
        """
        span, length = 1e-6 * self.length, self.length
        words = f"an arc length from {{}} to {{}} m, {span:.3g} m or more from the other end"
        low = as_number("start", start, words.format(0, length), lambda s: 0 <= s <= length - span)
        high = as_number(
            "end", end, words.format(low, length), lambda s: low + span <= s <= length * (1 + 1e-9)
        )
        begin, stop = self._arc.parameter(np.array([low, min(high, length)]))
        return type(self)(*trim(self._spline, float(begin), float(stop)))


_TABLES = (".csv", ".txt")


def read_description(path: Path) -> dict[str, Any]:
    """Read a curve file into what `Curve.from_dict` takes.

    Raises:
        FileError: missing, unreadable, of another format, or a malformed line.
        CurveError: a line of a table that makes no curve, named by its number.
    """
    suffix = path.suffix.lower()
    if suffix not in (".json", *_TABLES):
        raise FileError(path, f"the name ends in {suffix!r}; allowed: .json, .csv, .txt")
    text = read_text(path)
    if suffix in _TABLES:
        return {"type": "points", "points": _table(path, text)}
    try:
        content = json.loads(text)
    except json.JSONDecodeError as error:
        raise FileError(path, f"line {error.lineno}, column {error.colno}: {error.msg}") from error
    except ValueError as error:  # a number of thousands of digits
        raise FileError(path, str(error)) from error
    except RecursionError as error:
        raise FileError(path, "lists within lists without end") from error
    if isinstance(content, list):
        return {"type": "points", "points": content}
    if not isinstance(content, dict):
        raise FileError(path, f"holds {content!r}; allowed: an object with a 'type', or a list of points")
    return content


def _table(path: Path, text: str) -> list[list[float]]:
    """Rows of a table of coordinates, with or without a line of headings."""
    lines: list[int] = []
    rows: list[list[float]] = []
    headings: list[str] | None = None
    for number, raw in enumerate(text.splitlines(), start=1):
        content = raw.partition("#")[0].strip()
        if not content:
            continue
        fields = _fields(content)
        values = [_number(field) for field in fields]
        if not rows and headings is None and all(fields) and not any(value is not None for value in values):
            headings = [field.strip("\"'").lower() for field in fields]
            if headings not in (["x", "y"], ["x", "y", "z"]):
                raise FileError(path, f"line {number}: columns {', '.join(fields)}; allowed: x, y or x, y, z")
            continue
        row = []
        for column, value in enumerate(values, start=1):
            if value is None:
                what = f"{fields[column - 1]!r} is not a number"
                raise FileError(path, f"line {number}, column {column}: {what}")
            row.append(value)
        width = len(headings or (rows[0] if rows else row))
        if len(row) != width or width not in (2, 3):
            wanted = f"{width}, as before" if width in (2, 3) else "2 (then z = 0) or 3"
            raise FileError(path, f"line {number}: {len(row)} columns; allowed: {wanted}")
        lines.append(number)
        rows.append(row)
    if not rows:
        raise FileError(path, "holds no points")

    def name(i: int) -> str:
        return f"line {lines[i]}"

    check_distinct(as_points(rows, name=name), name)
    return rows


def _fields(content: str) -> list[str]:
    for separator in (";", ","):
        if separator in content:
            return [field.strip() for field in content.split(separator)]
    return content.split()


def _number(field: str) -> float | None:
    try:
        return float(field)
    except ValueError:
        return None


def write_json(path: Path, content: Mapping[str, Any]) -> None:
    """Write a JSON file atomically.

    Raises:
        FileError: the name does not end in .json, or the file cannot be written.
    """
    if path.suffix.lower() != ".json":
        raise FileError(path, f"the name ends in {path.suffix!r}; allowed: .json")
    write_text(path, json.dumps(content, allow_nan=False) + "\n")


def read_call(
    description: object, constructors: Mapping[str, Callable[..., object]]
) -> tuple[str, dict[str, Any]]:
    """Check a description: a constructor's name under "type" and its arguments under their names.

    Args:
        description: for example {"type": "line", "a": [0, 0, 0], "b": [1, 0, 0]}.
        constructors: by type.

    Returns:
        The type, and the arguments by their names.

    Raises:
        CurveError: not a mapping, or a required key is missing.
        UnknownName: a type or a key that does not exist.
    """
    if not isinstance(description, Mapping):
        raise CurveError("description", f"{type(description).__name__}; allowed: an object with a 'type'")
    if "type" not in description:
        raise CurveError("description", f"needs the key 'type'; allowed: {', '.join(constructors)}")
    kind = description["type"]
    if not isinstance(kind, str) or kind not in constructors:
        raise UnknownName("type of curve", kind, constructors)
    keys = {
        name: parameter.default is inspect.Parameter.empty
        for name, parameter in inspect.signature(constructors[kind]).parameters.items()
    }
    for key in description:
        if key != "type" and key not in keys:
            raise UnknownName(f"key of a {kind!r} curve", key, keys)
    for key, needed in keys.items():
        if needed and key not in description:
            raise CurveError(f"{kind!r} curve", f"needs the key {key!r}")
    return kind, {key: description[key] for key in keys if key in description}


LINE = Curve.line((0.0, 0.0, 0.0), (1.1, 0.0, 0.0))
"""The singular target posture (6.16): a straight line, 1.1 m long."""

HELIX = Curve.helix(radius=0.06, pitch=0.15, turns=4, handedness="left")
"""The non-singular target posture (6.17): y = 0.06 sin(8 pi t), z = 0.06 cos(8 pi t), x = 0.6 t.

The thesis does not say where t ends. A helix of four turns (t = 1) is 1.62 m long; the arm covers 1 m."""

PLANAR_LINE = Curve.line((0.0, 0.0, 0.0), (7.425, 0.0, 0.0))
"""A straight line for the planar arm of Section 6.2, like (6.16) a tenth longer than the arm."""

CURVES = {"line": LINE, "helix": HELIX}
"""The curves by the names that the command line takes."""
