"""Places at arc lengths against SciPy's B-splines and quadrature; what is measured anew and what is not."""

from __future__ import annotations

import pickle
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from sampling import examples
from scipy.interpolate import BSpline
from scipy.spatial.transform import Rotation

from pinposture import kernels
from pinposture.curve import Curve
from pinposture.errors import CurveError


def random_curve(seed: int, degree: int) -> Curve:
    """Uneven knots, repeated ones among them, clamped or not."""
    rng = np.random.default_rng(seed)
    n = degree + 1 + int(rng.integers(0, 6))
    knots = np.cumsum(rng.uniform(0.05, 1.0, n + degree + 1))
    if rng.random() < 0.5:
        knots[: degree + 1], knots[n:] = knots[degree], knots[n]
    if degree > 1 and n > degree + 2:
        knots[degree + 2] = knots[degree + 1]
    try:
        return Curve(knots, rng.normal(size=(n, 3)), degree)
    except CurveError:
        assume(False)
        raise


def quadrature(curve: Curve, end: float) -> float:
    """Arc length from the start to a parameter: 64 cells of 20 Gauss nodes in every span."""
    velocity = BSpline(curve.knots, curve.coefficients, curve.degree).derivative()
    inner = np.unique(curve.knots[curve.degree : len(curve.knots) - curve.degree])
    stations = np.append(inner[inner < end], end)
    nodes, weights = np.polynomial.legendre.leggauss(20)
    total = 0.0
    for a, b in pairwise(stations):
        half = (b - a) / 128
        u = a + half * (2 * np.arange(64)[:, None] + 1 + nodes)
        total += half * float(np.sum(np.linalg.norm(velocity(u), axis=2) @ weights))
    return total


@examples(30)
@given(st.integers(0, 10**6), st.integers(1, 5))
def test_arc_lengths_are_those_of_quadrature(seed: int, degree: int) -> None:
    """To 1e-10 of the length, for splines whose speed does not nearly vanish."""
    curve = random_curve(seed, degree)
    spline = BSpline(curve.knots, curve.coefficients, degree)
    assume(
        np.linalg.norm(spline.derivative()(np.linspace(*curve._arc.edges[[0, -1]], 500)), axis=1).min() > 0.05
    )
    for s in np.array([0.13, 0.5, 0.81]) * curve.length:
        u = float(kernels.parameters_at(curve._arc, np.array([s]))[0])
        assert quadrature(curve, u) == pytest.approx(s, abs=1e-10 * curve.length)
        np.testing.assert_allclose(curve.at(s), spline(u), atol=1e-13)


@examples(40)
@given(st.integers(0, 10**6), st.integers(1, 5))
def test_values_and_derivatives_are_those_of_scipy(seed: int, degree: int) -> None:
    curve = random_curve(seed, degree)
    spline = BSpline(curve.knots, curve.coefficients, degree)
    s = np.append(np.linspace(0, curve.length, 100), curve._arc.lengths)
    u = kernels.parameters_at(curve._arc, s)
    np.testing.assert_allclose(curve.at(s), spline(u), atol=1e-13)
    inside = np.abs(u[:, None] - curve.knots).min(axis=1) > 1e-9  # at a knot derivatives may jump
    for order in range(1, degree + 2):
        expected = spline(u, order) if order <= degree else np.zeros((len(u), 3))
        size = max(1.0, np.abs(expected).max())
        np.testing.assert_allclose(curve._values(u, order)[inside], expected[inside], atol=1e-12 * size)


def test_one_place_is_that_among_many() -> None:
    curve = random_curve(3, 3)
    s = np.linspace(0, curve.length, 50)
    np.testing.assert_array_equal([curve.at(float(each)) for each in s], curve.at(s))
    np.testing.assert_array_equal(curve.at(np.float64(s[7])), curve.at(s)[7])
    np.testing.assert_array_equal(curve.at(0), curve.start)


@examples(30)
@given(st.integers(0, 10**6), st.integers(1, 5))
def test_a_moved_curve_is_as_if_made_anew(seed: int, degree: int) -> None:
    """A motion keeps the measured length; making the curve of the moved coefficients measures it again."""
    curve = random_curve(seed, degree)
    rng = np.random.default_rng(seed)
    moved = curve.moved(Rotation.random(random_state=rng).as_matrix(), rng.normal(size=3))
    made = pickle.loads(pickle.dumps(moved))
    assert made == moved
    assert made.length == pytest.approx(moved.length, rel=1e-11)
    s = np.linspace(0, 1, 60)
    size = np.abs(moved.coefficients).max()
    np.testing.assert_allclose(made.at(s * made.length), moved.at(s * moved.length), atol=1e-10 * size)
    with pytest.raises(ValueError, match="read-only"):
        moved.coefficients[0, 0] = 1.0


def test_what_stretches_or_rounds_a_curve_is_measured_again() -> None:
    curve = Curve.helix(0.1, 0.2, 1)
    stretched = curve.moved(np.eye(3) * (1 + 2e-7))
    assert stretched.length / curve.length - 1 == pytest.approx(2e-7, rel=1e-3)
    small = Curve.spline([[0, 0], [1e-6, 0], [1e-6, 1e-6], [0, 1e-6]])
    far = small.moved(np.eye(3), (1.0, 0, 0))
    assert far.length == Curve(far.knots, far.coefficients, far.degree).length
    with pytest.raises(CurveError, match=r"coefficient .*at most 1e\+09 m"):
        curve.moved(np.eye(3), (0.9e9, 0, 0)).moved(np.eye(3), (0.9e9, 0, 0))
