"""Curves controlled by a few points, against least squares and distances worked out here."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from nearest import distances_to_nearest
from sampling import cases, examples
from scipy.interpolate import BSpline
from scipy.spatial.transform import Rotation

from pinposture.curve import Curve
from pinposture.errors import CurveError, InvalidValue

POINTS = np.array([[0, 0, 0], [0.2, 0.1, 0], [0.3, 0.4, 0.2], [0.1, 0.5, 0.4], [-0.2, 0.3, 0.5], [0, 0, 0.7]])


@cache
def coil() -> Curve:
    return Curve.helix(0.1, 0.08, 2)


def even_knots(count: int, degree: int) -> np.ndarray:
    spans = count - degree
    return np.array([0] * degree + [i / spans for i in range(spans + 1)] + [1] * degree)


def least_squares(
    places: np.ndarray, shares: np.ndarray, count: int, degree: int
) -> tuple[np.ndarray, float]:
    """Control points by a dense design matrix, with the ends on the right-hand side, and what is left."""
    matrix = BSpline.design_matrix(shares, even_knots(count, degree), degree).toarray()
    right = places - np.outer(matrix[:, 0], places[0]) - np.outer(matrix[:, -1], places[-1])
    inner = np.linalg.lstsq(matrix[:, 1:-1], right, rcond=None)[0]
    return np.vstack([places[:1], inner, places[-1:]]), float(((right - matrix[:, 1:-1] @ inner) ** 2).sum())


def apart(one: Curve, other: Curve, samples: int = 3000) -> float:
    """The largest distance between two curves, each point of one to all of many points of the other."""
    a = one.resample(samples)
    b = other.resample(samples)
    return float(max(distances_to_nearest(a, b).max(), distances_to_nearest(b, a).max()))


@pytest.mark.parametrize("degree", [1, 2, 3, 4, 5])
@pytest.mark.parametrize("count", [7, 12, 30])
def test_it_is_the_solution_of_the_least_squares(count: int, degree: int) -> None:
    # The parameter of a helix is its arc length; its spans ask for two samples each.
    found = coil().controlled(count, degree)
    shares = np.linspace(0.0, 1.0, 1025)
    points, _ = least_squares(coil().at(coil().length * shares), shares, count, degree)
    np.testing.assert_allclose(found.coefficients, points, atol=1e-10)
    np.testing.assert_allclose(found.knots, even_knots(count, degree), atol=1e-15)
    assert found.degree == degree


@pytest.mark.parametrize(
    ("knots", "own"),
    [([0, 0, 0, 0, 0.9, 0.95, 1, 1, 1, 1], False), ([0, 0, 0, 0, 0.25, 0.5, 1, 1, 1, 1], True)],
)
def test_the_parameter_that_leaves_less_is_taken(knots: list[float], own: bool) -> None:
    curve = Curve(knots, POINTS, 3)
    dense = np.linspace(0.0, 1.0, 200_001)  # parameters at equal arc lengths, by chords
    chords = np.linalg.norm(np.diff(BSpline(knots, POINTS, 3)(dense), axis=0), axis=1)
    along = np.append(0.0, np.cumsum(chords))
    shares = np.linspace(0.0, 1.0, 401)
    parameters = np.interp(shares * along[-1], along, dense)
    places = BSpline(knots, POINTS, 3)(parameters)
    by_length, by_parameter = (least_squares(places, each, 8, 3) for each in (shares, parameters))
    assert (by_parameter[1] < 0.8 * by_length[1]) == own
    assert (by_parameter[1] > 1.2 * by_length[1]) != own
    better = by_parameter if own else by_length
    np.testing.assert_allclose(curve.controlled(8).coefficients, better[0], atol=1e-6)


@pytest.mark.parametrize("degree", [1, 2, 3, 4, 5])
def test_a_curve_of_this_kind_is_given_as_it_is(degree: int) -> None:
    curve = Curve.spline(POINTS, degree)
    assert curve.controlled(len(POINTS), degree) == curve
    np.testing.assert_array_equal(curve.controlled(len(POINTS), degree).control_points, POINTS)


@pytest.mark.parametrize("degree", [2, 3, 4])
def test_points_are_found_again_behind_more_knots(degree: int) -> None:
    spline = BSpline(even_knots(len(POINTS), degree), POINTS, degree)
    for knot in (0.15, 0.4, 0.77):
        spline = spline.insert_knot(knot)
    refined = Curve(spline.t, spline.c, degree)
    assert refined.control_points is None
    np.testing.assert_allclose(refined.controlled(len(POINTS), degree).control_points, POINTS, atol=1e-9)


@pytest.mark.statistics
def test_a_curve_by_more_points_comes_as_near_as_the_theory_says() -> None:
    # Cubic splines are of fourth order, quintic ones of sixth; in between that holds to a factor.
    for degree, order in ((1, 2), (3, 4), (5, 6)):
        errors = [apart(coil(), coil().controlled(n, degree), 4000) for n in (24, 48)]
        assert errors[0] / errors[1] > 0.8 * 2**order or errors[1] < 2e-4 / 4000


def test_control_points_are_told_of_nothing_else() -> None:
    spline = Curve.spline(POINTS)
    turned = spline.moved(Rotation.from_rotvec([0.3, 0.2, 0.1]).as_matrix(), (1, 2, 3))
    for curve in (spline, turned, spline.reversed(), Curve(spline.knots * 3 - 2, POINTS, 3)):
        np.testing.assert_array_equal(curve.control_points, curve.coefficients)
    np.testing.assert_array_equal(Curve.line((0, 0, 0), (1, 0, 0)).control_points, [[0, 0, 0], [1, 0, 0]])
    others = (
        coil(),
        Curve.points(POINTS),
        Curve.spline(POINTS, through=True),
        spline.trimmed(0.1, 0.9),
        Curve([0, 0, 0, 0, 0.3, 0.7, 1, 1, 1, 1], POINTS, 3),
    )
    assert [curve.control_points for curve in others] == [None] * 5


@examples(40)
@given(st.integers(0, 2**32 - 1), st.integers(1, 5), st.integers(1, 12), st.tuples(*[st.floats(-3, 3)] * 3))
def test_it_moves_with_the_curve_and_meets_its_ends(
    seed: int, degree: int, more: int, turn: tuple[float, float, float]
) -> None:
    points = np.cumsum(np.random.default_rng(seed).normal((0.3, 0, 0), 0.2, (9, 3)), axis=0)
    curve = Curve.points(points)
    count = degree + more
    rotation = Rotation.from_rotvec(turn).as_matrix()
    try:
        found = curve.controlled(count, degree)
    except CurveError:  # few points for a curve that turns back
        return
    moved = curve.moved(rotation, (1, -2, 0.5)).controlled(count, degree)
    expected = found.control_points @ rotation.T + (1, -2, 0.5)
    np.testing.assert_allclose(moved.control_points, expected, atol=1e-8)
    np.testing.assert_allclose(found.start, curve.start, atol=1e-12)
    np.testing.assert_allclose(found.end, curve.end, atol=1e-12)
    backwards = curve.reversed().controlled(count, degree)
    np.testing.assert_allclose(backwards.control_points, found.control_points[::-1], atol=1e-8)


@pytest.mark.long
@pytest.mark.parametrize("tolerance", cases([1e-3, 1e-4, 2e-2], quick=1))
def test_a_tolerance_chooses_the_fewest_points(tolerance: float) -> None:
    found = coil().controlled_within(tolerance)
    fewest = len(found.control_points)
    assert found == coil().controlled(fewest)
    assert apart(coil(), found) <= tolerance + 1e-3  # two samples may be so far apart
    assert coil().nearest(found.resample(2000)).distance.max() <= 1.001 * tolerance
    for count in range(4, fewest):
        fewer = coil().controlled(count)
        ways = (coil().nearest(fewer.resample(2000)), fewer.nearest(coil().resample(2000)))
        assert max(way.distance.max() for way in ways) > 0.999 * tolerance


@pytest.mark.long
def test_windings_are_not_passed_over() -> None:
    # Taken at 400 equal steps, this one would be a straight line.
    wound = Curve.helix(0.05, 0.02, 400)
    assert wound.controlled(4).length < 0.1 * wound.length
    with pytest.raises(InvalidValue, match=r"tolerance is 0\.01; allowed: 0\.05\d* m or more"):
        wound.controlled_within(0.01, most=12)


def test_closed_curves_take_the_points_that_it_needs() -> None:
    ring = Curve.helix(0.16, 0, 1)
    found = ring.controlled_within(1e-3)
    np.testing.assert_allclose(found.start, found.end, atol=1e-12)
    assert ring.nearest(found.resample(1000)).distance.max() <= 1e-3
    with pytest.raises(CurveError, match=r"control point 0 of the nearest and .* the same place"):
        ring.controlled(2, degree=1)
    with pytest.raises(InvalidValue, match="allowed: more control points"):
        ring.controlled_within(1e-3, degree=1, most=2)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: coil().controlled(3), "count is 3; allowed: an integer from 4 to 1000"),
        (lambda: coil().controlled(5.5), "count is 5.5"),
        (lambda: coil().controlled(True), "count is True"),
        (lambda: coil().controlled(1001), "count is 1001"),
        (lambda: coil().controlled(8, 6), "degree is 6; allowed: an integer from 1 to 5"),
        (lambda: coil().controlled_within(0.0), "tolerance is 0.0; allowed: a distance above 0"),
        (lambda: coil().controlled_within(float("nan")), "tolerance is nan"),
        (lambda: coil().controlled_within(1e-3, most=3), "most is 3; allowed: an integer from 4"),
    ],
)
def test_what_is_refused(call: object, message: str) -> None:
    with pytest.raises(InvalidValue, match=message):
        call()  # type: ignore[operator]
