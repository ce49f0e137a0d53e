"""The camera sees everything."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from pinposture.viz.drawing import frame_points

CLOUDS = arrays(
    np.float64, st.tuples(st.integers(1, 30), st.just(3)), elements=st.floats(-10.0, 10.0, width=32)
)


@given(points=CLOUDS, aspect=st.floats(0.5, 3.0), opening=st.floats(0.2, 1.5))
def test_every_point_is_inside_the_picture(points, aspect, opening):
    framing = frame_points(points)
    distance = framing.distance(points, opening, aspect)
    right, up, near = framing.axes
    eye = framing.center + distance * near
    depth = (eye - points) @ near
    assert np.all(depth > 0.0)
    slope = np.tan(opening / 2.0) * (1.0 + 1e-9)
    assert np.all(np.abs((points - eye) @ up) <= slope * depth + 1e-12)
    assert np.all(np.abs((points - eye) @ right) <= slope * aspect * depth + 1e-12)


@given(points=CLOUDS)
def test_the_picture_is_upright_and_x_runs_to_the_right(points):
    framing = frame_points(points)
    right, up, near = framing.axes
    np.testing.assert_allclose(framing.axes @ framing.axes.T, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(np.cross(right, up), near, atol=1e-12)
    assert right[0] > 0.0
    assert up[2] > 0.0
    assert near[2] > 0.0
    assert framing.radius > 0.0


@pytest.mark.parametrize("flat", [0, 1, 2])
def test_a_flat_cloud_is_not_seen_edge_on(flat):
    points = np.random.default_rng(0).uniform(-1.0, 1.0, (100, 3))
    points[:, flat] = 0.0
    normal = np.eye(3)[flat]
    assert abs(frame_points(points).axes[2] @ normal) > 0.6
