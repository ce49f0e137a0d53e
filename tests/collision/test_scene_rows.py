"""Rows are derivatives of distances, and lead out where there is no derivative."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from collision.arms_with_bodies import ARMS, around, spatial
from hypothesis import given
from hypothesis import strategies as st
from sampling import examples

import pinposture as pp
from pinposture.collision import Box, Capsule, CollisionModel, Cylinder, Scene, Sphere
from pinposture.collision.model import escape_direction


def distances(clearance, arm, q):
    """Distance of each pair by its names; of a body of several solids, the nearest."""
    near = clearance.nearest(arm.at(q), np.inf)
    return dict(zip(near.pairs[::-1], near.distances[::-1], strict=True))


@pytest.mark.parametrize("name", ARMS)
def test_rows_are_the_derivatives_of_the_distances(name):
    rng = np.random.default_rng(3)
    arm = ARMS[name]()
    h = 1e-6
    compared = 0
    for _ in range(3):
        clearance = CollisionModel(arm, Scene(around(arm, rng), self_collision=True))
        q = arm.random(rng)
        near = clearance.nearest(arm.at(q), np.inf)
        first = [near.pairs.index(pair) for pair in dict.fromkeys(near.pairs)]
        rows = near.jacobian[first]
        pairs = [near.pairs[k] for k in first]
        values = near.distances[first]
        slopes = np.zeros((len(pairs), arm.nv))
        for u in range(arm.nv):
            ahead, behind = (
                distances(clearance, arm, arm.integrate(q, way * h * np.eye(arm.nv)[u])) for way in (1, -1)
            )
            slopes[:, u] = [(ahead[pair] - behind[pair]) / (2 * h) for pair in pairs]
        # A planar arm that crosses itself is shown the way out in its plane, where the distance stays.
        crossed = (np.abs(slopes).max(axis=1) < 1e-3) & (values < 0.0) & (arm.dimension == 2)
        size = max(1.0, arm.length, float(np.abs(slopes).max()))
        np.testing.assert_allclose(rows[~crossed], slopes[~crossed], atol=2e-4 * size)
        compared += int(np.sum(~crossed))
    assert compared > 20


@pytest.mark.parametrize("name", ["spatial", "described", "planar"])
def test_following_the_rows_leads_out_of_an_obstacle(name):
    rng = np.random.default_rng(5)
    arm = ARMS[name]()
    for kind in range(3):
        q = arm.random(rng) if name != "planar" else arm.configuration(rng.uniform(-0.3, 0.3, arm.nv))
        point = arm.at(q).points[-1]
        obstacle = (Sphere(point, 0.06), Box(point, (0.1, 0.1, 0.1)), Capsule(point, point + 0.1, 0.04))[kind]
        clearance = CollisionModel(arm, Scene({"o": obstacle}, self_collision=False))
        assert clearance.minimum(q).distance < -0.02
        for _ in range(200):
            near = clearance.nearest(arm.at(q), 0.005)
            if not len(near.distances):
                break
            short = 0.006 - near.distances
            dq = np.linalg.lstsq(near.jacobian, np.clip(short, 0.0, 0.005), rcond=1e-3)[0]
            q = arm.integrate(q, np.clip(dq, -0.1, 0.1))
        assert clearance.minimum(q).distance >= 0.005


def test_a_planar_arm_is_shown_a_way_in_its_plane():
    arm = pp.Arm.from_template("RzRz", modules=3)
    q = arm.straight()
    # A bar in the plane, across the last link: the shortest way from it is up, where the arm cannot go.
    bar = CollisionModel(
        arm, Scene({"bar": Capsule((0.8, -0.05, 0), (0.8, 0.3, 0), 0.03)}, self_collision=False)
    )
    near = bar.nearest(arm.at(q), 0.0)
    assert near.minimum == pytest.approx(-0.05)
    np.testing.assert_allclose(near.normals[0], (0.0, -1.0, 0.0), atol=1e-9)
    assert np.linalg.norm(near.jacobian[0]) > 0.1
    for _ in range(100):
        near = bar.nearest(arm.at(q), 0.005)
        if not len(near.distances):
            break
        q = arm.integrate(q, 0.005 * near.jacobian[0] / np.linalg.norm(near.jacobian[0]))
    assert bar.minimum(q).distance >= 0.005


@pytest.mark.parametrize(
    "obstacle",
    [
        Sphere((0.27, 0, 0), 0.05),
        Capsule((0.2, 0, 0), (0.29, 0, 0), 0.05),
        Capsule((0.27, -0.1, 0), (0.27, 0.1, 0), 0.05),
        Cylinder((0.2, 0, 0), (0.29, 0, 0), 0.05),
        Box((0.27, 0, 0), (0.1, 0.1, 0.1)),
    ],
)
def test_normals_exist_where_the_axes_meet(obstacle):
    arm = pp.Arm.from_template("RyRz", modules=6)
    clearance = CollisionModel(arm, Scene({"o": obstacle}, self_collision=False))
    near = clearance.nearest(arm.at(arm.straight()), 0.0)
    assert len(near.distances) > 0
    np.testing.assert_allclose(np.linalg.norm(near.normals, axis=1), 1.0, atol=1e-9)
    assert np.abs(near.jacobian).max() > 1e-3
    again = clearance.nearest(arm.at(arm.straight()), 0.0)
    np.testing.assert_array_equal(near.jacobian, again.jacobian)


def test_normals_point_from_the_obstacle_to_the_body():
    arm = spatial()
    rng = np.random.default_rng(0)
    around_it = {
        "a": Sphere(arm.chain.base + [0.2, 0.3, 0.1], 0.1),
        "b": Box(arm.chain.base - 0.4, (0.1,) * 3),
    }
    near = CollisionModel(arm, Scene(around_it, self_collision=False)).nearest(
        arm.at(arm.random(rng)), np.inf
    )
    for distance, (_, name), point, normal in zip(
        near.distances, near.pairs, near.points, near.normals, strict=True
    ):
        if name == "a":
            away = point - np.array(around_it["a"].center)
            assert np.linalg.norm(away) == pytest.approx(0.1 + distance, abs=1e-7)
            np.testing.assert_allclose(normal, away / np.linalg.norm(away), atol=1e-6)
        else:
            assert normal @ (point - np.array(around_it["b"].center)) > 0.0


def rates_of(found, own, arm, q):
    """Derivatives of the distances of contacts by the joints, from their places and Pinocchio's Jacobians."""
    data = arm.model.createData()
    pin.computeJointJacobians(arm.model, data, q)
    rows = np.zeros((len(own), arm.nv))
    for row, k in enumerate(own):
        for joint, sign in zip(found.carrying[k], (1.0, -1.0), strict=True):
            if joint:
                jacobian = pin.getJointJacobian(arm.model, data, int(joint), pin.LOCAL_WORLD_ALIGNED)
                apart = found.points[k] - data.oMi[int(joint)].translation
                moved = jacobian[:3] + np.cross(jacobian[3:].T, apart).T
                rows[row] += sign * found.normals[k] @ moved
    return rows


def test_contacts_along_a_path_are_the_nearest_pairs_at_each_place():
    rng = np.random.default_rng(4)
    arm = spatial()
    within = 0.2
    obstacles = {
        "ball": Sphere((0.3, 0.2, 0.1), 0.05),
        "rod": Capsule((0.1, -0.3, 0.0), (0.4, -0.2, 0.2), 0.03),
        "box": Box((0.0, 0.3, -0.3), (0.1, 0.2, 0.1)),
    }
    clearance = CollisionModel(arm, Scene(obstacles, self_collision=True, arm_radius=0.01))
    q = arm.random(rng)
    offsets = 0.3 * rng.normal(size=(20, arm.nv))
    compared = 0
    found = clearance.contacts_along(q, offsets, within)
    for k, offset in enumerate(offsets):
        near = clearance.nearest(arm.at(arm.integrate(q, offset)), within)
        own = np.flatnonzero(found.samples == k)
        own = own[np.argsort(found.distances[own], kind="stable")]
        np.testing.assert_allclose(found.distances[own], near.distances, atol=1e-12)
        assert found.minima[k] == pytest.approx(min(near.minimum, within), abs=1e-12)
        apart = near.distances > 0.0  # of pairs that overlap, only `nearest` finds a way out everywhere
        rates = rates_of(found, own[apart], arm, arm.integrate(q, offset))
        np.testing.assert_allclose(rates, near.jacobian[apart], atol=1e-9)
        compared += int(apart.sum())
    assert compared > 100


@pytest.mark.parametrize("name", ARMS)
def test_contacts_along_a_path_miss_no_pair(name):
    rng = np.random.default_rng(6)
    arm = ARMS[name]()
    within = 0.3
    clearance = CollisionModel(arm, Scene(around(arm, rng), self_collision=True))
    q = arm.random(rng)
    offsets = 0.3 * rng.normal(size=(10, arm.nv))
    found = clearance.contacts_along(q, offsets, within)
    for k, offset in enumerate(offsets):
        near = clearance.nearest(arm.at(arm.integrate(q, offset)), within)
        own = np.sort(found.distances[found.samples == k])
        assert len(own) >= len(near.distances)
        assert np.all(own[: len(near.distances)] <= near.distances + 1e-9)


SPACE = np.eye(3)
PLANE = np.eye(3)[:2]


@pytest.mark.parametrize(
    ("first", "second", "expected"),
    [
        ([(0, 0, 0), (1, 0, 0)], [(0.5, -1, 0), (0.5, 1, 0)], [(0, 0, 1), (0, 0, -1)]),  # they cross
        ([(0, 0, 0), (1, 0, 0)], [(0.5, 0.2, 0), (2, 0.2, 0)], [(0, -1, 0)]),  # side by side
        ([(0, 0, 0), (0, 0, 0)], [(0, 0, 0), (0, 0, 0)], [(0, 0, 1)]),  # two points in one place
    ],
)
def test_in_space_it_is_across_both(first, second, expected):
    found = escape_direction(np.array(first, float), np.array(second, float), SPACE)
    assert any(np.allclose(found, each) for each in expected)


def test_in_space_one_line_on_another_goes_across_it():
    line = np.array([(0, 0, 0), (1.0, 2, 3)])
    found = escape_direction(line, 2 * line, SPACE)
    assert found @ line[1] == pytest.approx(0.0, abs=1e-12) and np.linalg.norm(found) == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("first", "second", "expected"),
    [
        ([(0, 0, 0), (1, 0, 0)], [(0.9, -1, 0), (0.9, 1, 0)], (-1, 0, 0)),  # only its end is across
        ([(0, 0, 0), (1, 0, 0)], [(0.5, -0.1, 0), (0.5, 1, 0)], (0, -1, 0)),  # the other's end is nearer
        ([(0, 0, 0), (1, 0, 0)], [(0.5, -0.1, -1), (0.5, -0.1, 1)], (0, 1, 0)),  # an upright post beside
        ([(0, 0, 0), (0, 0, 1)], [(0.2, 0, 0), (0.2, 0, 1)], (-1, 0, 0)),  # two upright posts
        ([(0, 0, 0), (0, 0, 1)], [(0, 0, 0), (0, 0, 1)], (1, 0, 0)),  # in one place
    ],
)
def test_in_a_plane_it_is_the_shortest_way_out_within_it(first, second, expected):
    found = escape_direction(np.array(first, float), np.array(second, float), PLANE)
    np.testing.assert_allclose(found, expected, atol=1e-12)


places = st.lists(st.sampled_from([-1.0, 0.0, 1e-9, 0.3, 2.0]), min_size=6, max_size=6)


@examples(40)
@given(places, places, st.booleans())
def test_there_is_always_one(first, second, planar):
    plane = PLANE if planar else SPACE
    found = escape_direction(np.reshape(first, (2, 3)), np.reshape(second, (2, 3)), plane)
    assert np.linalg.norm(found) == pytest.approx(1.0)
    assert not planar or found[2] == 0.0
