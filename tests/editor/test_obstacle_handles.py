"""Moving, turning and pulling obstacles, against what must not change and against places known by hand."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from editor.solid_distances import signed_distance
from hypothesis import given
from hypothesis import strategies as st
from sampling import examples
from scipy.spatial.transform import Rotation

import pinposture as pp
from pinposture.collision import Obstacle
from pinposture.collision.shapes import rotation_to
from pinposture.editor.obstacles import (
    HANDLING,
    ArmScale,
    at_pose,
    bounding_radius,
    moved,
    resized,
    size_handles,
)

MEASURES = ArmScale(np.array([0.5, 0.0, 0.0]), 1.0)
ROUNDING = 2.0 * 10.0**-HANDLING.digits

coordinates = st.floats(-2.0, 2.0).map(lambda x: round(x, 4))
vectors = st.tuples(coordinates, coordinates, coordinates)
sizes = st.floats(0.01, 1.0)
turns = st.integers(0, 2**32 - 1).map(lambda seed: Rotation.random(random_state=seed).as_matrix())


@st.composite
def obstacles(draw: st.DrawFn) -> Obstacle:
    center = np.array(draw(vectors))
    turn = draw(turns)
    kind = draw(st.sampled_from(["sphere", "box", "cylinder", "capsule", "half_space", "mesh", "scan"]))
    if kind == "sphere":
        return pp.Sphere(center, draw(sizes))
    if kind == "box":
        return pp.Box(center, (draw(sizes), draw(sizes), draw(sizes)), turn)
    if kind == "half_space":
        return pp.HalfSpace(center, turn[:, 2])
    if kind == "scan":
        points = np.random.default_rng(draw(st.integers(0, 9))).uniform(-1, 1, (20, 3)) * draw(sizes) + 0.3
        return pp.Scan(points, None, center=center, rotation=turn)
    if kind == "mesh":
        corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [0.9, 0.9, 0.9]]) * draw(sizes) + 0.3
        return pp.Mesh(corners, center, turn)
    way = draw(st.floats(0.2, 1.0)) * turn[:, 2]  # ends are rounded: of short rods that turns wide ones
    return (pp.Cylinder if kind == "cylinder" else pp.Capsule)(center, center + way, draw(sizes))


@given(obstacles(), vectors, st.integers(0, 1000))
@examples(150)
def test_moving_shifts_every_distance(obstacle, shift, seed):
    points = np.random.default_rng(seed).uniform(-3, 3, (40, 3))
    before = signed_distance(obstacle, points)
    after = signed_distance(moved(obstacle, shift), points + shift)
    np.testing.assert_allclose(after, before, atol=10 * ROUNDING)  # rounded ends of a short rod tilt it


@given(obstacles(), turns, vectors, st.integers(0, 1000))
@examples(150)
def test_turning_about_the_middle_carries_every_distance_along(obstacle, turn, place, seed):
    points = np.random.default_rng(seed).uniform(-3, 3, (40, 3))
    pose = obstacle.pose(MEASURES.middle)
    other = at_pose(obstacle, pin.SE3(turn, np.array(place)), MEASURES)
    along = (points - pose.translation) @ pose.rotation @ turn.T + place
    np.testing.assert_allclose(
        signed_distance(other, along), signed_distance(obstacle, points), atol=10 * ROUNDING
    )


@given(obstacles())
@examples(100)
def test_an_obstacle_put_where_it_is_stays(obstacle):
    points = np.random.default_rng(0).uniform(-3, 3, (40, 3))
    same = at_pose(obstacle, obstacle.pose(MEASURES.middle), MEASURES)
    np.testing.assert_allclose(
        signed_distance(same, points), signed_distance(obstacle, points), atol=10 * ROUNDING
    )


@given(obstacles())
@examples(100)
def test_a_handle_put_where_it_is_changes_nothing(obstacle):
    points = np.random.default_rng(0).uniform(-3, 3, (40, 3))
    for grip in size_handles(obstacle, MEASURES):
        same = resized(obstacle, grip.name, grip.position, MEASURES)
        np.testing.assert_allclose(
            signed_distance(same, points), signed_distance(obstacle, points), atol=10 * ROUNDING
        )


@given(obstacles())
@examples(100)
def test_handles_are_outside_by_the_gap(obstacle):
    places = np.array([grip.position for grip in size_handles(obstacle, MEASURES)]).reshape(-1, 3)
    np.testing.assert_allclose(signed_distance(obstacle, places), MEASURES.gap, atol=1e-9)


@given(obstacles(), st.floats(0.005, 0.5))
@examples(150)
def test_a_handle_follows_the_hand_along_its_axis(obstacle, by):
    pose = obstacle.pose(MEASURES.middle)
    for k, grip in enumerate(size_handles(obstacle, MEASURES)):
        if isinstance(obstacle, pp.HalfSpace):
            out = np.array(obstacle.normal)
        elif grip.name in ("start", "end"):
            out = (1.0 if grip.name == "end" else -1.0) * pose.rotation[:, 2]
        else:
            out = -pose.rotation[:, "xyz".index(grip.name) if grip.name in "xyz" else 0]
        there = grip.position + by * out
        after = size_handles(resized(obstacle, grip.name, there, MEASURES), MEASURES)[k]
        assert after.name == grip.name
        gone = after.position - there
        # the axes about the only axis of a cylinder may turn with its rounding: height is what counts
        assert abs(gone @ out) < 20 * ROUNDING


def test_a_box_is_pulled_at_one_face_and_the_face_across_stays():
    box = pp.Box((0.2, 0.1, 0.0), (0.2, 0.2, 0.4))
    wider = resized(box, "x", np.array([-0.3 - MEASURES.gap, 5.0, 7.0]), MEASURES)
    assert wider.center == pytest.approx((0.0, 0.1, 0.0))
    assert wider.size == pytest.approx((0.6, 0.2, 0.4))  # from -0.3 to 0.3, where the face across is


def test_pulled_beyond_itself_a_solid_stays_small_and_whole():
    box = resized(pp.Box((0, 0, 0), (0.2, 0.2, 0.2)), "z", np.array([0.0, 0.0, 9.0]), MEASURES)
    assert box.size == pytest.approx((0.2, 0.2, MEASURES.least))
    assert box.center == pytest.approx((0.0, 0.0, 0.1 - MEASURES.least / 2), abs=ROUNDING)
    ball = resized(pp.Sphere((0, 0, 0), 0.2), "radius", np.array([9.0, 0.0, 0.0]), MEASURES)
    assert ball.radius == pytest.approx(MEASURES.least)
    rod = pp.Cylinder((0, 0, 0), (0, 0, 0.3), 0.05)
    short = resized(rod, "end", np.array([0.0, 0.0, 0.0]), MEASURES)
    assert np.linalg.norm(np.subtract(short.end, short.start)) == pytest.approx(MEASURES.least)
    assert short.end[2] > 0.0  # it still points the way it did


def test_an_end_of_a_cylinder_goes_anywhere_and_the_other_stays():
    rod = pp.Cylinder((0.1, 0.0, 0.0), (0.1, 0.0, 0.3), 0.05)
    away = resized(rod, "end", np.array([0.1, 0.5 + MEASURES.gap, 0.0]), MEASURES)
    assert away.start == rod.start
    assert away.end == pytest.approx((0.1, 0.5, 0.0), abs=ROUNDING)
    pill = resized(pp.Capsule(rod.start, rod.end, 0.05), "start", np.array([0.1, 0.0, -0.5]), MEASURES)
    assert pill.end == rod.end
    assert pill.start == pytest.approx((0.1, 0.0, -0.5 + 0.05 + MEASURES.gap), abs=ROUNDING)


@given(obstacles(), st.integers(0, 1000))
@examples(100)
def test_nothing_reaches_beyond_its_reach(obstacle, seed):
    if isinstance(obstacle, pp.HalfSpace):
        assert bounding_radius(obstacle, MEASURES) == 0.0
        return
    way = np.random.default_rng(seed).normal(size=(60, 3))
    way *= (bounding_radius(obstacle, MEASURES) + 1e-9) / np.linalg.norm(way, axis=1)[:, None]
    outside = signed_distance(obstacle, obstacle.pose(MEASURES.middle).translation + way)
    assert outside.min() > -1e-9


@given(st.integers(0, 2**32 - 1))
def test_turns_lay_the_third_axis_where_they_should(seed):
    axis = np.random.default_rng(seed).normal(size=3)
    turn = rotation_to(axis)
    np.testing.assert_allclose(turn[:, 2], axis / np.linalg.norm(axis), atol=1e-9)
    np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-9)
    assert np.linalg.det(turn) == pytest.approx(1.0)


@pytest.mark.parametrize("axis", [(0, 0, 1), (0, 0, -1), (1e-9, 0, -1), (0, 1e-7, -1)])
def test_turns_upside_down_are_turns(axis):
    turn = rotation_to(axis)
    np.testing.assert_allclose(turn[:, 2], np.array(axis) / np.linalg.norm(axis), atol=1e-6)
    np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-6)


def test_a_moved_mesh_is_what_it_would_be_if_it_were_made_there():
    mesh = pp.Mesh(np.vstack([np.eye(3), np.zeros((1, 3))]), (0.1, 0.2, 0.3), (0.1, 0.0, 0.0))
    other = moved(mesh, (0.5, 0.0, -0.1))
    made = pp.Mesh(mesh.vertices, (0.6, 0.2, 0.2), mesh.rotation)
    assert other == made
    assert hash(other) == hash(made)
    assert mesh.center == (0.1, 0.2, 0.3)


def test_measures_of_an_arm():
    measures = ArmScale.of(pp.Arm.from_template("RyRz", modules=4))
    np.testing.assert_allclose(measures.middle, [0.5 * measures.length, 0, 0], atol=1e-12)
