"""Every bad input is refused by the right kind of error, which names the culprit."""

import numpy as np
import pytest
from sampling import seeds

from pinposture.curve import Curve
from pinposture.errors import CurveError, InvalidValue, UnknownName

NAN = float("nan")
SQUARE = [[0, 0], [1, 0], [1, 1], [0, 1]]
KNOTS = [0, 0, 0, 0, 0.5, 1, 1, 1, 1]
FIVE = [[0, 0], [1, 0], [1, 1], [0, 1], [0, 2]]


def line():
    return Curve.line((0, 0), (2, 0))


@pytest.mark.parametrize(
    ("make", "kind", "words"),
    [
        # points
        (lambda: Curve.points([[0, 0, 0]]), CurveError, ["1 point given", "at least 2"]),
        (lambda: Curve.points([]), CurveError, ["0 points given"]),
        (lambda: Curve.points(np.zeros((4, 4))), CurveError, ["4 coordinates", "2 (then z = 0) or 3"]),
        (lambda: Curve.points([[1], [2]]), CurveError, ["1 coordinates"]),
        (lambda: Curve.points([0.0, 1.0, 2.0]), CurveError, ["point 0", "0.0 is not a point"]),
        (lambda: Curve.points(np.array([0.0, 1.0])), CurveError, ["point 0", "not a point"]),
        (lambda: Curve.points(3.0), CurveError, ["3.0 is not a list of points"]),
        (lambda: Curve.points("a curve"), CurveError, ["'a curve' is not a list"]),
        (lambda: Curve.points(None), CurveError, ["None is not a list"]),
        (lambda: Curve.points([[0, 0], [1, None]]), CurveError, ["point 1", "None is not a number"]),
        (lambda: Curve.points([[0, 0], [1, 1j]]), CurveError, ["point 1", "1j is not a number"]),
        (
            lambda: Curve.points([[0, 0], [1, 2, 3]]),
            CurveError,
            ["point 1", "3 coordinates", "point 0 has 2"],
        ),
        (lambda: Curve.points([[0, 0], [1, 1], [NAN, 2]]), CurveError, ["point 2", "x is nan"]),
        (lambda: Curve.points([[0, 0, 0], [0, 0, np.inf]]), CurveError, ["point 1", "z is inf"]),
        (lambda: Curve.points([[0, 0], [0, 1e10]]), CurveError, ["point 1", "y is 1", "1e+09"]),
        (
            lambda: Curve.points([[0, 0], [1, 1], [1, 1], [2, 0]]),
            CurveError,
            ["point 1 and point 2", "(1, 1, 0)"],
        ),
        (lambda: Curve.points([[0, 0], [1, 1], [1, 1 + 1e-10]]), CurveError, ["point 1 and point 2"]),
        (lambda: Curve.points([[1, 1]] * 5), CurveError, ["point 0 and point 1"]),
        (lambda: Curve.points(SQUARE, -0.1), InvalidValue, ["smoothing is -0.1", "0 m"]),
        (lambda: Curve.points(SQUARE, NAN), InvalidValue, ["smoothing is nan"]),
        (lambda: Curve.points(SQUARE, "little"), InvalidValue, ["smoothing is 'little'"]),
        # splines
        (lambda: Curve.spline(SQUARE[:3]), CurveError, ["3 given", "degree 3", "at least 4"]),
        (lambda: Curve.spline(SQUARE, 5, through=True), CurveError, ["4 given", "degree 5", "at least 6"]),
        (lambda: Curve.spline(SQUARE, 0), InvalidValue, ["degree is 0", "1 to 5"]),
        (lambda: Curve.spline(SQUARE, 6), InvalidValue, ["degree is 6"]),
        (lambda: Curve.spline(SQUARE, 2.5), InvalidValue, ["degree is 2.5"]),
        (lambda: Curve.spline(SQUARE, True), InvalidValue, ["degree is True"]),
        (lambda: Curve.spline(SQUARE, 3, "yes"), InvalidValue, ["through is 'yes'", "true or false"]),
        (lambda: Curve.spline([[0, 0], [0, 0], [1, 1], [0, 1]]), CurveError, ["point 0 and point 1"]),
        # curves that stand still: a cusp, a turn on the spot, on a knot, and at the start
        (lambda: Curve.spline([[0, 0], [1, 1], [0, 1], [1, 0]]), CurveError, ["(0.5, 0.75, 0)", "cusp"]),
        (lambda: Curve.spline([[0, 0], [1, 0], [2, 0], [1.5, 0]]), CurveError, ["(1.63299, 0, 0)"]),
        (lambda: Curve.spline([[0, 0], [1, 0], [2, 0], [1, 0], [0, 0]], 3), CurveError, ["speed vanishes"]),
        (lambda: Curve([0, 0, 0, 1, 1, 1], [[0, 0], [0, 0], [1, 1]], 2), CurveError, ["(0, 0, 0)", "speed"]),
        (lambda: Curve([0, 0, 1, 1], [[1, 1], [1, 1]], 1), CurveError, ["(1, 1, 0)", "speed"]),
        # lines
        (lambda: Curve.line((1, 2), (1, 2)), CurveError, ["a and b", "same place", "(1, 2, 0)"]),
        (lambda: Curve.line((1,), (1, 2)), InvalidValue, ["a is (1,)", "3 finite numbers"]),
        (lambda: Curve.line((1, 2), (1, NAN)), InvalidValue, ["b is (1, nan)"]),
        (lambda: Curve.line((1, 2), ((1, 2), 3)), InvalidValue, ["b is ((1, 2), 3)"]),
        # helices
        (lambda: Curve.helix(-0.1, 1, 1), InvalidValue, ["radius is -0.1"]),
        (lambda: Curve.helix(0, 1, 1), InvalidValue, ["radius is 0"]),
        (lambda: Curve.helix(NAN, 1, 1), InvalidValue, ["radius is nan"]),
        (lambda: Curve.helix(1, -1, 1), InvalidValue, ["pitch is -1", "0 m (a circle)"]),
        (lambda: Curve.helix(1, 1, 0), InvalidValue, ["turns is 0", "above 0"]),
        (lambda: Curve.helix(1, 1, -2), InvalidValue, ["turns is -2"]),
        (lambda: Curve.helix(1, 1, 1e7), InvalidValue, ["turns", "1000"]),
        (lambda: Curve.helix(1, 1, 1, (0, 0, 0)), InvalidValue, ["axis is (0, 0, 0)", "not zero"]),
        (lambda: Curve.helix(1, 1, 1, (1, NAN, 0)), InvalidValue, ["axis"]),
        (lambda: Curve.helix(1, 1, 1, center=5), InvalidValue, ["center is 5"]),
        (lambda: Curve.helix(1, 1, 1, phase=np.inf), InvalidValue, ["phase is inf"]),
        (lambda: Curve.helix(1, 1, 1, handedness="up"), UnknownName, ["handedness", "'up'", "left"]),
        # B-splines from knots and coefficients
        (lambda: Curve(KNOTS[1:], FIVE, 3), CurveError, ["knots", "9 numbers"]),
        (lambda: Curve(["a"], FIVE, 3), CurveError, ["knots", "not a list of numbers"]),
        (lambda: Curve([*KNOTS[:-1], NAN], FIVE, 3), CurveError, ["knot 8", "nan"]),
        (lambda: Curve([0, 0, 0, 0, 2, 1, 1, 1, 1], FIVE, 3), CurveError, ["knots 4 and 5", "2.0, 1.0"]),
        (lambda: Curve([0, 0, 0, 0, 1e-17, 1, 1, 1, 1], FIVE, 3), CurveError, ["knots 3 and 4", "1e-17"]),
        (lambda: Curve([1.0] * 9, FIVE, 3), CurveError, ["from knot 1.0 to 1.0"]),
        (lambda: Curve([0, 0, 1, 1, 2, 2], SQUARE, 1), CurveError, ["knot 1.0", "2 times", "at most 1"]),
        (lambda: Curve(KNOTS, [*FIVE[:4], [0, NAN]], 3), CurveError, ["coefficient 4", "y is nan"]),
        # queries
        (lambda: line().at(-1e-3), InvalidValue, ["s is -0.001", "0 to 2 m"]),
        (lambda: line().tangent(2.001), InvalidValue, ["s is 2.001"]),
        (lambda: line().curvature([0, 1, 3, 1]), InvalidValue, ["s[2] is 3.0"]),
        (lambda: line().torsion([0, NAN]), InvalidValue, ["s[1] is nan"]),
        (lambda: line().at("half"), InvalidValue, ["s is 'half'"]),
        (lambda: line().at([[0, 1]]), InvalidValue, ["s is [[0, 1]]", "shape (n,)"]),
        (lambda: line().at([[0], [0, 1]]), InvalidValue, ["s is [[0], [0, 1]]"]),
        (lambda: line().resample(1), InvalidValue, ["n is 1", "2 to"]),
        (lambda: line().resample(10.5), InvalidValue, ["n is 10.5"]),
        (lambda: line().nearest([0, NAN, 0]), CurveError, ["point 0", "y is nan"]),
        (lambda: line().nearest([[0, 0], [0]]), CurveError, ["point 1", "1 coordinates"]),
        (lambda: line().nearest([0, 1, 2, 3]), CurveError, ["4 coordinates"]),
        # changes
        (lambda: line().moved(2 * np.eye(3)), InvalidValue, ["rotation", "orthonormal"]),
        (lambda: line().moved(-np.eye(3)), InvalidValue, ["rotation", "determinant +1"]),
        (lambda: line().moved(np.eye(2)), InvalidValue, ["rotation"]),
        (lambda: line().moved(np.full((3, 3), NAN)), InvalidValue, ["rotation"]),
        (lambda: line().moved("turn"), InvalidValue, ["rotation is 'turn'"]),
        (lambda: line().moved(np.eye(3), (0, 0, NAN)), InvalidValue, ["translation"]),
        (lambda: line().trimmed(-0.1, 1), InvalidValue, ["start is -0.1"]),
        (lambda: line().trimmed(0.5, 2.1), InvalidValue, ["end is 2.1", "0.5 to 2"]),
        (lambda: line().trimmed(1, 1), InvalidValue, ["end is 1"]),
        (lambda: line().trimmed(1, 0.5), InvalidValue, ["end is 0.5"]),
    ],
)
def test_bad_input_is_refused_by_name(make, kind, words):
    with pytest.raises(kind) as caught:
        make()
    assert type(caught.value) is kind
    for word in words:
        assert word in str(caught.value)


def test_arc_lengths_beyond_an_end_by_rounding_are_that_end():
    assert line().length == 2
    np.testing.assert_array_equal(line().at([-1e-9, 2 + 1e-9]), [[0, 0, 0], [2, 0, 0]])


def test_close_points_are_told_apart_relative_to_their_extent():
    assert Curve.points([[0, 0], [1, 1], [1, 1 + 1e-8]]).length > 1
    assert Curve.points(np.array(SQUARE) * 1e-6).length == pytest.approx(Curve.points(SQUARE).length * 1e-6)
    for points in (
        [[0, 0], [100, 0], [100, 5e-8]],  # next to the extent
        [
            [1e6, 0],
            [1e6 + 1, 0],
            [1e6 + 1, 5e-5],
        ],  # next to the coordinates, whose rounding it would drown in
    ):
        with pytest.raises(CurveError, match="point 1 and point 2"):
            Curve.points(points)


@pytest.mark.parametrize("cusp", [0.05, 0.3, 0.5, 1 / np.sqrt(3), 0.99])
@pytest.mark.parametrize("seed", seeds(5))
def test_a_cusp_anywhere_is_found_and_placed(cusp, seed):
    # The derivative (u - cusp) (a + b u) vanishes at the cusp; integrated, and in Bernstein form.
    rng = np.random.default_rng(seed)
    a, b, start = rng.normal(size=(3, 3))
    linear = -cusp * a
    square = (a - cusp * b) / 2
    cubic = b / 3
    points = start + np.array([0 * a, linear / 3, (2 * linear + square) / 3, linear + square + cubic])
    place = start + linear * cusp + square * cusp**2 + cubic * cusp**3
    with pytest.raises(CurveError) as caught:
        Curve.spline(points)
    named = [float(x) for x in caught.value.what[len("curve at (") : -1].split(", ")]
    np.testing.assert_allclose(named, place, atol=1e-5)
    points[1] += 1e-3 * np.cross(a, b)  # led past it, the curve has a direction everywhere
    assert np.isfinite(Curve.spline(points).curvature(0))


@pytest.mark.parametrize("twice", [1, 2])
def test_a_stop_on_either_side_of_a_corner_is_found(twice):
    corner = [[0, 0], [1, 0], [1, 1], [0, 1], [0, 2]]
    knots = [0, 0, 0, 0.5, 0.5, 1, 1, 1]
    assert Curve(knots, corner, 2).length > 2
    corner[twice + 1] = corner[twice]
    with pytest.raises(CurveError, match=r"speed vanishes"):
        Curve(knots, corner, 2)


def test_a_span_of_no_length_is_found():
    with pytest.raises(CurveError, match=r"\(1, 0, 0\)"):
        Curve([0, 0, 1, 2, 3, 3], [[0, 0], [1, 0], [1, 1e-12], [2, 0]], 1)


def test_closed_curves_are_curves():
    ring = Curve.spline([*SQUARE, SQUARE[0]], through=True)
    np.testing.assert_allclose(ring.start, ring.end, atol=1e-14)
