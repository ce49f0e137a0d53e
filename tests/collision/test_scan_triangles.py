"""Lines and triangles: nearest points against non-negative least squares, deepest ones against sampling."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest
from collision.scans_by_hand import hull_distance
from hypothesis import given
from hypothesis import strategies as st
from sampling import examples

from pinposture.collision.scan_distances import closest_to_triangles, deepest_points

places = st.lists(st.sampled_from([-1.0, 0.0, 1.0, 0.5, 0.3, 1e-8]), min_size=3, max_size=3).map(np.array)


def on_line(point, a, b):
    way = b - a
    along = np.clip((point - a) @ way / max(way @ way, 1e-300), 0, 1)
    return np.linalg.norm(a + along * way - point) < 1e-9


@examples(300)
@given(places, places, places, places, places)
def test_lines_and_triangles_that_cross_touch_are_parallel_or_have_no_extent(a, b, u, v, w):
    found = closest_to_triangles(a[None], b[None], np.array([[u, v, w]]))
    first, second = found.first[0], found.second[0]
    expected = hull_distance(np.array([a, b]), np.array([u, v, w]))
    assert np.linalg.norm(first - second) == pytest.approx(expected, abs=2e-7)
    assert on_line(first, a, b)
    assert hull_distance(second[None], np.array([u, v, w])) < 2e-7


def test_many_at_once_are_told_as_one_by_one():
    rng = np.random.default_rng(0)
    for size in (1e-3, 1.0, 1e3):
        a, b = rng.normal(size=(2, 100, 3)) * size
        corners = rng.normal(size=(100, 3, 3)) * size
        found = closest_to_triangles(a, b, corners)
        gaps = np.linalg.norm(found.first - found.second, axis=1)
        expected = [hull_distance(np.array([p, q]), each) for p, q, each in zip(a, b, corners, strict=True)]
        np.testing.assert_allclose(gaps, expected, atol=1e-6 * size)
        assert np.sum(gaps == 0.0) > 3


def test_the_deepest_points_are_those_of_convex_functions():
    rng = np.random.default_rng(1)
    corners = rng.normal(size=(30, 3, 3))
    share = np.array([(u, v) for u in np.linspace(0, 1, 101) for v in np.linspace(0, 1, 101) if u + v <= 1])
    functions = {
        "cone": lambda x: np.linalg.norm(x - [0.1, 0.2, 0.3], axis=1),
        "plane": lambda x: x @ [1.0, -2.0, 0.5],
        "box": lambda x: np.abs(x / [1.0, 2.0, 0.3]).max(axis=1),
        "flat": lambda x: np.maximum(np.linalg.norm(x, axis=1) - 0.5, 0.0),
    }
    for name, function in functions.items():
        points, values = deepest_points(function, corners)
        np.testing.assert_allclose(function(points), values, atol=1e-12)
        for triangle, point, value in zip(corners, points, values, strict=True):
            sampled = function(triangle[0] + share @ (triangle[1:] - triangle[0])).min()
            assert sampled - 0.2 <= value <= sampled + 2e-5, name
            assert hull_distance(point[None], triangle) < 1e-6


def height(direction, points):
    return points @ np.array(direction)


def test_the_deepest_point_of_a_plane_is_a_corner():
    corners = np.array([[[0.0, 0, 0], [5, 0, 0], [0, 5, 0]]])
    for direction, corner in (([1, 1, 0], 0), ([-1, 0, 0], 1), ([0, -1, 0], 2)):
        points, _ = deepest_points(partial(height, direction), corners)
        np.testing.assert_allclose(points[0], corners[0, corner], atol=2e-5)
