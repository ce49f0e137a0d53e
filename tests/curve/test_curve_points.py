"""Curves from measured points."""

from itertools import pairwise

import numpy as np
import pytest

from pinposture.curve import Curve


def helix(t):
    return np.stack([0.6 * t, 0.06 * np.sin(8 * np.pi * t), 0.06 * np.cos(8 * np.pi * t)], axis=-1)


def turning(curve):
    """Angle through which the tangent turns [rad]."""
    return np.linalg.norm(np.diff(curve.tangent(np.linspace(0, curve.length, 4000)), axis=0), axis=1).sum()


@pytest.mark.parametrize(("n", "degree"), [(2, 1), (3, 2), (4, 3), (60, 3), (2000, 3)])
def test_without_smoothing_the_curve_meets_every_point(n, degree):
    points = helix(np.linspace(0, 1, n))
    curve = Curve.points(points)
    assert curve.degree == degree
    np.testing.assert_allclose(curve.nearest(points).distance, 0, atol=1e-12)
    np.testing.assert_allclose([curve.start, curve.end], points[[0, -1]], atol=1e-14)


def test_dense_samples_give_back_the_curve_they_came_from():
    curve = Curve.points(helix(np.linspace(0, 1, 2000)))
    true = Curve.helix(0.06, 0.15, 4, handedness="left")
    s = np.linspace(0, 1, 500)
    assert curve.length == pytest.approx(true.length, rel=1e-8)
    np.testing.assert_allclose(curve.at(s * curve.length), true.at(s * true.length), atol=1e-7)
    np.testing.assert_allclose(curve.curvature(s * curve.length), true.curvature(0), rtol=1e-3)


def test_uneven_samples_give_back_a_cubic_exactly():
    # Through=True and points agree, and uneven samples of a straight line stay on it.
    t = np.sort(np.random.default_rng(5).uniform(size=30))
    curve = Curve.points(t[:, None] * [1, 2, 3])
    assert curve.length == pytest.approx((t[-1] - t[0]) * np.sqrt(14), rel=1e-12)
    bent = np.stack([t, t**2], axis=1)
    assert Curve.points(bent) == Curve.spline(bent, through=True)


@pytest.mark.parametrize("n", [100, 500, 2000])
@pytest.mark.parametrize("noise", [2e-4, 1e-3])
def test_smoothing_takes_out_the_noise_and_keeps_within_its_distance(n, noise):
    rng = np.random.default_rng(n)
    points = helix(np.linspace(0, 1, n)) + rng.normal(scale=noise, size=(n, 3))
    smoothing = noise * np.sqrt(3)
    curve = Curve.points(points, smoothing)
    kept = np.sqrt((curve.nearest(points).distance ** 2).mean())
    assert 0.3 * smoothing < kept <= smoothing * (1 + 1e-6)
    true = Curve.helix(0.06, 0.15, 4, handedness="left")
    off = true.nearest(curve.resample(2000)).distance
    assert np.sqrt((off**2).mean()) < 1.2 * noise
    assert curve.length == pytest.approx(true.length, rel=0.02)
    # Curvature is what noise spoils.
    s = np.linspace(0.05, 0.95, 500)
    assert np.median(curve.curvature(s * curve.length)) == pytest.approx(true.curvature(0), rel=0.1)
    assert turning(curve) == pytest.approx(turning(true), rel=0.1)


def test_more_smoothing_turns_less():
    rng = np.random.default_rng(0)
    points = helix(np.linspace(0, 1, 400)) + rng.normal(scale=1e-3, size=(400, 3))
    angles = [turning(Curve.points(points, smoothing)) for smoothing in (0, 1e-3, 2e-3, 1e-2, 5e-2, 1.0)]
    assert all(a > b for a, b in pairwise(angles))
    assert angles[0] > 10 * angles[2]
    assert angles[2] == pytest.approx(turning(Curve.helix(0.06, 0.15, 4)), rel=0.1)


@pytest.mark.parametrize("n", [2, 3, 4, 5, 7])
@pytest.mark.parametrize("smoothing", [1e-9, 1e-3, 0.05, 10.0])
def test_few_points_can_be_smoothed(n, smoothing):
    points = np.array(
        [[0, 0, 0], [0.3, 0.1, 0], [0.5, 0, 0.2], [0.9, 0.1, 0.1], [1, 0.4, 0], [1.2, 0.3, 0], [2, 0, 0]]
    )[:n]
    curve = Curve.points(points, smoothing)
    assert np.sqrt((curve.nearest(points).distance ** 2).mean()) <= smoothing * (1 + 1e-6) + 1e-12
    assert curve.length > 0


def test_smoothing_below_the_detail_of_the_points_goes_through_them():
    points = np.random.default_rng(1).normal(size=(40, 3))
    np.testing.assert_allclose(Curve.points(points, 1e-7).nearest(points).distance, 0, atol=2e-7)
