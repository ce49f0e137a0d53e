"""The nearest place against brute force."""

from functools import cache

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sampling import examples

from pinposture.curve import Curve

CURVES = {
    "spline": lambda: Curve.spline(
        [[0, 0, 0], [1, 0, 0], [1, 1, 0.5], [0, 1, 1], [0, 0, 1.5], [1, 0.2, 0.1]]
    ),
    "through": lambda: Curve.spline([[0, 0], [1, 0], [1, 1], [0, 1], [0.4, 0.3]], through=True),
    "polygon": lambda: Curve.spline([[0, 0, 0], [1, 0, 0], [1, 1, 1], [0, 1, 0], [0.1, 0, 0.2]], degree=1),
    "helix": lambda: Curve.helix(0.3, 0.2, 4),
    "hairpin": lambda: Curve.spline([[0, 0], [0.999, 1], [0.001, 1], [1, 0]]),
    "line": lambda: Curve.line((0, 0, 0), (1, 1, 1)),
}
coordinate = st.floats(-2, 2)


@cache
def curve_called(name):
    return CURVES[name]()


@examples(100)
@given(st.sampled_from(sorted(CURVES)), st.tuples(coordinate, coordinate, coordinate))
def test_no_place_is_nearer_than_the_one_found(name, point):
    curve = curve_called(name)
    found = curve.nearest(point)
    dense = np.linalg.norm(curve.resample(20_001) - point, axis=1)
    assert found.distance <= dense.min() + 1e-12
    # The dense places miss the nearest one by at most half their spacing.
    assert found.distance >= dense.min() - curve.length / 40_000
    assert np.linalg.norm(curve.at(found.parameter) - point) == pytest.approx(found.distance, abs=1e-9)


@pytest.mark.parametrize("name", CURVES)
def test_places_on_the_curve_are_found(name):
    curve = curve_called(name)
    s = np.linspace(0, curve.length, 500)
    found = curve.nearest(curve.at(s))
    np.testing.assert_allclose(found.distance, 0, atol=1e-9)
    np.testing.assert_allclose(curve.at(found.parameter), curve.at(s), atol=1e-9)


def test_offset_along_the_normal_is_the_distance():
    circle = Curve.helix(0.5, 0, 0.75, axis=(0, 0, 1))
    s = np.linspace(0.1, circle.length - 0.1, 40)
    outward = circle.at(s) / 0.5
    found = circle.nearest(1.3 * circle.at(s) + [0, 0, 0.4])
    np.testing.assert_allclose(found.distance, np.hypot(0.15, 0.4), rtol=1e-10)
    np.testing.assert_allclose(found.parameter, s, atol=1e-8)
    np.testing.assert_allclose(circle.nearest(circle.at(s) - 0.2 * outward).parameter, s, atol=1e-8)


def test_beyond_the_ends_the_end_is_nearest():
    line = curve_called("line")
    assert tuple(line.nearest((-1, -1, -1))) == pytest.approx((0, np.sqrt(3)))
    assert tuple(line.nearest((2, 2, 2))) == pytest.approx((line.length, np.sqrt(3)))


def test_many_points_in_pieces_agree_with_one_at_a_time():
    curve = curve_called("helix")
    points = np.random.default_rng(3).normal(size=(3000, 3))
    found = curve.nearest(points)
    assert found.parameter.shape == found.distance.shape == (3000,)
    for i in range(0, 3000, 97):
        one = curve.nearest(points[i])
        assert isinstance(one.parameter, float)
        assert tuple(one) == pytest.approx((found.parameter[i], found.distance[i]), abs=1e-12)
    assert curve.nearest(np.empty((0, 3))).distance.shape == (0,)


def test_the_middle_of_a_circle_is_equally_far_from_all_of_it():
    circle = Curve.helix(0.5, 0, 1, axis=(0, 0, 1))
    assert circle.nearest((0, 0, 0)).distance == pytest.approx(0.5, rel=1e-12)
