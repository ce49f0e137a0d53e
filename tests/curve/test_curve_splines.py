"""Splines against formulas written out here, quadrature and finite differences."""

from itertools import pairwise
from math import comb

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sampling import examples
from scipy.integrate import quad
from scipy.interpolate import BSpline, insert

from pinposture.curve import Curve
from pinposture.errors import CurveError, InvalidValue

POINTS = np.array([[0, 0, 0], [0.2, 0.1, 0], [0.3, 0.4, 0.2], [0.1, 0.5, 0.4], [-0.2, 0.3, 0.5], [0, 0, 0.7]])


def bernstein(points, u):
    """Curve of the Bernstein polynomials, and its speed, at one u in [0, 1]."""
    n = len(points) - 1
    place = sum(comb(n, i) * u**i * (1 - u) ** (n - i) * points[i] for i in range(n + 1))
    steps = np.diff(points, axis=0) * n
    velocity = sum(comb(n - 1, i) * u**i * (1 - u) ** (n - 1 - i) * steps[i] for i in range(n))
    return place, np.linalg.norm(velocity)


def de_boor(points, knots, degree, u):
    """Basis functions by their recursion."""

    def basis(i, k):
        if k == 0:
            last = u == knots[-1] and knots[i] < knots[i + 1] == u
            return float(knots[i] <= u < knots[i + 1] or last)
        left = knots[i + k] - knots[i]
        right = knots[i + k + 1] - knots[i + 1]
        return (left and (u - knots[i]) / left * basis(i, k - 1)) + (
            right and (knots[i + k + 1] - u) / right * basis(i + 1, k - 1)
        )

    return sum(basis(i, degree) * point for i, point in enumerate(points))


@pytest.mark.parametrize("degree", [1, 2, 3, 4, 5])
def test_single_span_is_the_bernstein_form_measured_by_quadrature(degree):
    points = POINTS[: degree + 1]
    curve = Curve.spline(points, degree)
    total = quad(lambda u: bernstein(points, u)[1], 0, 1, epsabs=1e-13)[0]
    assert curve.length == pytest.approx(total, rel=1e-11)
    for u in np.linspace(0, 1, 11):
        s = quad(lambda u: bernstein(points, u)[1], 0, u, epsabs=1e-13)[0]
        np.testing.assert_allclose(curve.at(s), bernstein(points, u)[0], atol=1e-10 * total)


@pytest.mark.parametrize("degree", [1, 2, 3, 4, 5])
def test_controlled_spline_is_the_clamped_uniform_b_spline(degree):
    curve = Curve.spline(POINTS, degree)
    spans = len(POINTS) - degree
    knots = [0] * degree + [i / spans for i in range(spans + 1)] + [1] * degree
    dense = np.array([de_boor(POINTS, knots, degree, u) for u in np.linspace(0, 1, 41)])
    np.testing.assert_allclose(curve.nearest(dense).distance, 0, atol=1e-9)
    np.testing.assert_allclose(curve.start, POINTS[0], atol=1e-14)
    np.testing.assert_allclose(curve.end, POINTS[-1], atol=1e-14)


@pytest.mark.parametrize("degree", [1, 2, 3, 4, 5])
def test_interpolating_spline_passes_through_its_points_in_order(degree):
    curve = Curve.spline(POINTS, degree, through=True)
    found = curve.nearest(POINTS)
    np.testing.assert_allclose(found.distance, 0, atol=1e-12)
    assert (np.diff(found.parameter) > 0).all()
    np.testing.assert_allclose(curve.end, POINTS[-1], atol=1e-14)


def test_controlled_spline_does_not_pass_through_inner_points():
    assert (Curve.spline(POINTS).nearest(POINTS[1:-1]).distance > 1e-2).all()


def test_arc_length_agrees_with_quadrature_of_the_speed_of_many_spans():
    curve = Curve.spline(POINTS)
    spans = len(POINTS) - 3
    knots = [0] * 3 + [i / spans for i in range(spans + 1)] + [1] * 3

    def speed(u):
        steps = [
            3 * (POINTS[i + 1] - POINTS[i]) / (knots[i + 4] - knots[i + 1]) for i in range(len(POINTS) - 1)
        ]
        return np.linalg.norm(de_boor(steps, knots[1:-1], 2, u))

    s = 0.0
    for a in np.arange(spans) / spans:
        s += quad(speed, a, a + 1 / spans, epsabs=1e-12)[0]
        np.testing.assert_allclose(curve.at(s), de_boor(POINTS, knots, 3, a + 1 / spans), atol=1e-10)
    assert curve.length == pytest.approx(s, rel=1e-11)


@pytest.mark.parametrize("sharpness", [0.1, 1e-3, 1e-4])
def test_arc_length_holds_next_to_a_cusp(sharpness):
    # The loop (0,0), (1,1), (0,1), (1,0) has a cusp; drawn apart by little it turns in no space at all.
    points = np.array([[0, 0, 0], [1 - sharpness, 1, 0], [sharpness, 1, 0], [1, 0, 0]])
    curve = Curve.spline(points)
    pieces = np.concatenate([[0], 0.5 - np.logspace(-0.31, -7, 40), 0.5 + np.logspace(-7, -0.31, 40), [1]])
    total = sum(quad(lambda u: bernstein(points, u)[1], a, b, epsabs=1e-14)[0] for a, b in pairwise(pieces))
    assert curve.length == pytest.approx(total, rel=1e-10)
    np.testing.assert_allclose(curve.at(total / 2), bernstein(points, 0.5)[0], atol=1e-10)


@pytest.mark.parametrize(
    "make",
    [
        lambda: Curve.spline(POINTS),
        lambda: Curve.spline(POINTS, 5, through=True),
        lambda: Curve.helix(0.1, 0.2, 2),
    ],
    ids=["spline", "through", "helix"],
)
def test_tangent_and_curvature_are_derivatives_by_arc_length(make):
    curve = make()
    s = np.linspace(0, 1, 57)[1:-1] * curve.length
    h = 1e-5 * curve.length
    by_difference = (curve.at(s + h) - curve.at(s - h)) / (2 * h)
    np.testing.assert_allclose(curve.tangent(s), by_difference, atol=1e-7)
    np.testing.assert_allclose(np.linalg.norm(curve.tangent(s), axis=1), 1, atol=1e-14)
    bending = np.linalg.norm(curve.tangent(s + h) - curve.tangent(s - h), axis=1) / (2 * h)
    np.testing.assert_allclose(curve.curvature(s), bending, rtol=1e-4)


def test_torsion_is_the_turning_of_the_binormal():
    curve = Curve.spline(POINTS, 5, through=True)
    s = np.linspace(0.05, 0.95, 40) * curve.length
    h = 1e-5 * curve.length

    def frame(s):
        tangent = curve.tangent(s)
        turn = (curve.tangent(s + h) - curve.tangent(s - h)) / (2 * h)
        normal = turn / np.linalg.norm(turn, axis=1)[:, None]
        return normal, np.cross(tangent, normal)

    change = (frame(s + 10 * h)[1] - frame(s - 10 * h)[1]) / (20 * h)
    expected = -np.einsum("ni,ni->n", change, frame(s)[0])
    np.testing.assert_allclose(curve.torsion(s), expected, rtol=1e-3, atol=1e-3)


def test_resampled_points_lie_at_equal_arc_lengths():
    curve = Curve.spline(POINTS)
    places = curve.resample(4001)
    np.testing.assert_array_equal(places[0], curve.start)
    np.testing.assert_array_equal(places[-1], curve.end)
    chords = np.linalg.norm(np.diff(places, axis=0), axis=1)
    np.testing.assert_allclose(chords, curve.length / 4000, rtol=1e-4)
    assert chords.sum() == pytest.approx(curve.length, rel=1e-6)


def test_scalars_and_arrays_give_the_same_values_in_their_own_shapes():
    curve = Curve.spline(POINTS)
    s = np.array([0, 0.3, 0.7]) * curve.length
    for query in (curve.at, curve.tangent):
        assert query(s).shape == (3, 3)
        assert query(s[1]).shape == (3,)
        np.testing.assert_array_equal(query(s[1]), query(list(s))[1])
        assert query([]).shape == (0, 3)
    for query in (curve.curvature, curve.torsion):
        assert query(s).shape == (3,)
        assert isinstance(query(s[1]), float)
        assert query(s[1]) == query(s)[1]


def test_polygon_has_corners_and_straight_sides():
    curve = Curve.spline([[0, 0], [1, 0], [1, 2]], degree=1)
    assert curve.length == pytest.approx(3)
    np.testing.assert_allclose(curve.tangent([0.5, 1.5]), [[1, 0, 0], [0, 1, 0]], atol=1e-14)
    np.testing.assert_allclose(curve.nearest([2, -1, 0]).distance, np.sqrt(2))
    np.testing.assert_allclose(curve.nearest([2, -1, 0]).parameter, 1)


@examples(60)
@given(st.integers(1, 5), st.integers(0, 2**32 - 1), st.lists(st.floats(0.01, 0.99), min_size=1, max_size=4))
def test_inserted_knots_are_those_of_scipy_and_keep_the_curve(degree, seed, knots):
    steps = np.random.default_rng(seed).normal((0.3, 0, 0), 0.1, (degree + 4, 3))
    curve = before = Curve.spline(np.cumsum(steps, axis=0), degree)
    tck = (curve.knots, list(curve.coefficients.T), degree)
    u = np.linspace(0, 1, 201)
    for knot in knots:
        try:
            curve = curve.insert_knot(knot)
        except CurveError:  # there already, as often as it can be, or almost
            return
        tck = insert(knot, tck)
        np.testing.assert_allclose(curve.knots, tck[0], atol=1e-15)
        np.testing.assert_allclose(
            curve.coefficients.T, np.array(tck[1])[:, : len(curve.coefficients)], atol=1e-12
        )
        places = [BSpline(each.knots, each.coefficients, degree)(u) for each in (before, curve)]
        np.testing.assert_allclose(places[1], places[0], atol=1e-12)
        s = np.linspace(0, before.length, 201)
        np.testing.assert_allclose(curve.at(s), before.at(s), atol=1e-11)
        assert Curve.from_dict(curve.to_dict()) == curve


def test_knots_beyond_the_ends_stay_when_one_is_inserted():
    helix = Curve.helix(0.1, 0.2, 1)
    finer = helix.insert_knot(0.3)
    assert len(finer.coefficients) == len(helix.coefficients) + 1
    s = np.linspace(0, helix.length, 101)
    np.testing.assert_allclose(finer.at(s), helix.at(s), atol=1e-13)


@pytest.mark.parametrize("u", [0, 1, -0.5, np.nan, np.inf, "half", None, True])
def test_knots_that_cannot_be_inserted(u):
    with pytest.raises(InvalidValue, match=r"u is .*allowed: a parameter between 0 and 1"):
        Curve.spline(POINTS).insert_knot(u)


def test_a_knot_that_would_break_the_curve_is_refused():
    curve = Curve.spline(POINTS, 2)
    corner = curve.insert_knot(0.5)  # there already: now a corner may be there
    with pytest.raises(CurveError, match=r"knot 0.5: given 3 times, which breaks the curve"):
        corner.insert_knot(0.5)
