"""Distances against projections and closed forms, and the two ways to compute them against each other."""

from __future__ import annotations

import coal
import numpy as np
import pinocchio as pin
import pytest
from collision.arms_with_bodies import single
from collision.solids_by_hand import separation
from hypothesis import given
from hypothesis import strategies as st
from sampling import examples, seeds

from pinposture.collision import Box, Capsule, CollisionModel, Cylinder, HalfSpace, Mesh, Scene, Sphere
from pinposture.collision.distances import JointFrames, Narrow, PairDistances, TreeKinematics

BODIES = {
    '<sphere radius="0.05"/>': Sphere((0.5, 0, 0), 0.05),
    '<cylinder radius="0.05" length="0.3"/>': Cylinder((0.35, 0, 0), (0.65, 0, 0), 0.05),
    '<capsule radius="0.05" length="0.3"/>': Capsule((0.35, 0, 0), (0.65, 0, 0), 0.05),
    '<box size="0.1 0.2 0.3"/>': Box((0.5, 0, 0), (0.3, 0.2, 0.1)),
}
CORNERS = np.array([[x, y, z] for x in (-0.1, 0.1) for y in (-0.2, 0.2) for z in (-0.05, 0.05)])


def obstacles(rng):
    """One of each kind, somewhere outside of the middle."""

    def somewhere(least=0.5):
        place = rng.normal(size=3)
        return np.array([0.5, 0, 0]) + place / np.linalg.norm(place) * rng.uniform(least, 1.2)

    def up(place):
        return (place - [0.5, 0, 0]) / np.linalg.norm(place - [0.5, 0, 0])

    far = somewhere()
    wall = somewhere(0.4)
    return {
        "sphere": Sphere(somewhere(), 0.1),
        "capsule": Capsule(far, far + 0.5 * up(far) + 0.1 * rng.normal(size=3), 0.1),
        "cylinder": Cylinder(somewhere(0.8), somewhere(0.8) + 1e-3, 0.1),
        "box": Box(somewhere(0.8), (0.1, 0.4, 0.5), rng.uniform(-3, 3, 3)),
        "half_space": HalfSpace(wall, -up(wall)),
    }


@pytest.mark.parametrize("shape", BODIES)
def test_distances_are_those_of_projections_to_and_fro(shape):
    rng = np.random.default_rng(0)
    body = BODIES[shape]
    compared = 0
    arm = single(shape, rpy="0 1.5707963267948966 0")
    state = arm.at(arm.neutral())
    for _ in range(5):
        around = obstacles(rng)
        near = CollisionModel(arm, Scene(around, self_collision=False)).nearest(state, np.inf)
        assert sorted(name for _, name in near.pairs) == sorted(around)
        for distance, (_, name) in zip(near.distances, near.pairs, strict=True):
            by_hand = separation(body, around[name])
            if by_hand > 1e-3:
                assert distance == pytest.approx(by_hand, abs=2e-6), name
                compared += 1
            else:
                assert distance < 2e-3
    assert compared > 15


@pytest.mark.parametrize(
    ("shape", "obstacle", "depth"),
    [
        ('<sphere radius="0.05"/>', Sphere((0.52, 0, 0), 0.1), 0.13),
        ('<sphere radius="0.05"/>', Box((0.5, 0.01, 0), (2, 0.4, 3)), 0.05 + 0.19),
        ('<sphere radius="0.05"/>', Cylinder((0.5, 0.02, -1), (0.5, 0.02, 1), 0.1), 0.05 + 0.08),
        ('<sphere radius="0.05"/>', HalfSpace((0, 0, 0.2), (0, 0, 1)), 0.25),
        ('<box size="0.1 0.2 0.3"/>', HalfSpace((0, 0, 0.2), (0, 0, 2)), 0.35),
        ('<cylinder radius="0.05" length="0.3"/>', HalfSpace((0, 0, 0.2), (0, 0, 1)), 0.35),
        ('<capsule radius="0.05" length="0.3"/>', HalfSpace((0, 0, 0.2), (0, 0, 1)), 0.4),
        ('<box size="0.1 0.2 0.3"/>', Box((0.5, 0, 0.2), (1, 1, 0.3)), 0.1),
        ('<cylinder radius="0.05" length="0.3"/>', Cylinder((0.5, 0, 0.1), (0.5, 0, 1), 0.2), 0.05),
        ('<sphere radius="0.05"/>', Mesh(CORNERS, (0.5, 0, 0)), 0.1),
    ],
)
def test_depths_of_solids_that_overlap(shape, obstacle, depth):
    arm = single(shape)
    assert CollisionModel(arm, Scene({"o": obstacle}, self_collision=False)).minimum(
        arm.neutral()
    ).distance == pytest.approx(-depth, abs=1e-5)


def test_a_mesh_is_its_convex_hull_and_may_be_turned():
    arm = single('<capsule radius="0.05" length="0.3"/>')
    turn = (0.4, -0.7, 2.0)
    inside = np.random.default_rng(0).uniform(-0.05, 0.05, (20, 3))
    for center in ((0.9, 0.2, 0.3), (0.55, 0.1, 0.0)):
        mesh = Mesh(np.vstack([inside, CORNERS]), center, turn)
        box = Box(center, (0.2, 0.4, 0.1), turn)
        by_mesh, by_box = (
            CollisionModel(arm, Scene({"o": each}, self_collision=False)).minimum(arm.neutral())[0]
            for each in (mesh, box)
        )
        assert by_mesh == pytest.approx(by_box, abs=1e-7)


HERE = JointFrames(np.eye(3)[None, None], np.zeros((1, 1, 3)))


def contact(one, other):
    """Distance, point and normal of one solid and another, by the closed forms."""
    near = PairDistances([one.solid()], [0], [other.solid()], [(0, 1)]).near(HERE, np.inf)
    return near.distances[0], near.points[0], near.normals[0]


def by_coal(one, other):
    posed = []
    for each in (one.solid(), other.solid()):
        posed += [each.geometry, coal.Transform3s(each.rotation, each.position)]
    for request in Narrow().requests:
        distance = coal.distance(*posed, request, coal.DistanceResult())
        if abs(distance) < 1e100:
            break
    return distance


def pillar(rng):
    foot = rng.normal(size=3) * 0.3
    return Cylinder(foot, foot + rng.normal(size=3) * 10 ** rng.uniform(-1.5, 0.5), rng.uniform(0.02, 0.3))


def slab(rng):
    size = 10 ** rng.uniform(-1.5, 0.3, 3)
    turn = rng.uniform(-3, 3, 3) if rng.random() < 0.7 else np.zeros(3)
    return Box(rng.normal(size=3) * 0.3, size, turn)


KINDS = {
    "sphere": lambda rng: Sphere(rng.normal(size=3) * 0.3, 0.05),
    "capsule": lambda rng: Capsule(*rng.normal(size=(2, 3)) * 0.3, 0.05),
    "box": slab,
    "cylinder": pillar,
    "half_space": lambda rng: HalfSpace(rng.normal(size=3) * 0.3, rng.normal(size=3)),
}


def rods(rng):
    """Capsules in general, along an axis, and as short as points."""
    a, b = rng.normal(size=(2, 3)) * 0.4
    along = a + np.eye(3)[rng.integers(3)] * rng.uniform(0.05, 1.0)
    return [Capsule(a, b, 0.03), Capsule(a, along, 0.03), Sphere(a, 0.03)]


@pytest.mark.long
@pytest.mark.parametrize("kind", KINDS)
def test_the_closed_forms_agree_with_coal_and_are_never_larger(kind):
    rng = np.random.default_rng(1)
    apart = 0
    for _ in range(150):
        other = KINDS[kind](rng)
        for rod in rods(rng):
            (distance, point, normal), expected = contact(rod, other), by_coal(rod, other)
            assert distance <= expected + 2e-4 * (expected < 0.0) + 1e-6
            if expected > 1e-6:
                apart += 1
                assert distance == pytest.approx(expected, abs=1e-6)
                # The surface of the other is that far from the point, against the normal.
                assert np.linalg.norm(normal) == pytest.approx(1.0, abs=1e-9)
                ball = Sphere(point - distance * normal, 1e-6)
                assert separation(ball, other) == pytest.approx(0.0, abs=2e-5)
    assert apart > 100


@pytest.mark.long
@pytest.mark.parametrize("kind", ["box", "cylinder"])
def test_depths_are_the_lengths_of_shortest_translations(kind):
    """Along a unit vector n, what it takes is h(n) + g(-n), by the supports of both solids."""
    rng = np.random.default_rng(2)
    directions = rng.normal(size=(20_000, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    deep = 0
    for _ in range(200):
        other = KINDS[kind](rng)
        rod = rods(rng)[0]
        distance, _, normal = contact(rod, other)
        if distance >= -0.03:  # the axes are apart
            continue
        deep += 1
        ends = np.array([rod.start, rod.end])

        def needed(n, ends=ends, other=other):
            return support(other, n) - (n @ ends.T).min(axis=-1) + 0.03

        shortest = needed(directions).min()
        assert needed(normal[None])[0] == pytest.approx(-distance, abs=1e-9)
        if kind == "box":  # no direction is better
            assert -distance <= shortest + 1e-9
        assert by_coal(Capsule(*(ends + (1e-6 - distance) * normal), 0.03), other) >= -1e-7
    assert deep > 20


def support(shape, n):
    """The farthest that a solid reaches along unit vectors, (k,)."""
    if isinstance(shape, Box):
        turned = n @ np.array(shape.rotation)
        return n @ np.array(shape.center) + np.abs(turned) @ (np.array(shape.size) / 2.0)
    start = np.array(shape.start)
    end = np.array(shape.end)
    axis = (end - start) / np.linalg.norm(end - start)
    across = np.linalg.norm(n - (n @ axis)[:, None] * axis, axis=1)
    return np.maximum(n @ start, n @ end) + shape.radius * across


def test_a_rod_that_lies_flat_is_nearest_in_the_middle_of_what_is_above():
    box = Box((0.0, 0.0, 0.0), (0.4, 0.4, 0.2))
    distance, point, normal = contact(Capsule((-0.1, 0.0, 0.3), (0.9, 0.0, 0.3), 0.05), box)
    assert distance == pytest.approx(0.15)
    np.testing.assert_allclose(point, [0.05, 0.0, 0.25], atol=1e-12)
    np.testing.assert_allclose(normal, [0.0, 0.0, 1.0], atol=1e-12)


coordinates = st.lists(st.sampled_from([-1.0, 0.0, 1.0, 0.5, 1e-8]), min_size=3, max_size=3).map(np.array)


def rod_between(a, b):
    """A capsule, or a sphere where its ends are too near for one."""
    return Capsule(a, b, 1e-6) if np.linalg.norm(b - a) > 1e-6 else Sphere(a, 1e-6)


@examples(40)
@given(coordinates, coordinates, coordinates, coordinates)
def test_lines_that_are_parallel_cross_or_are_points(a, b, c, d):
    found, point, _ = contact(rod_between(a, b), rod_between(c, d))
    s = np.linspace(0.0, 1.0, 101)[:, None, None]
    t = np.linspace(0.0, 1.0, 101)[None, :, None]
    sampled = np.linalg.norm(a + s * (b - a) - c - t * (d - c), axis=2).min()
    assert found <= sampled + 1e-7
    assert found >= sampled - 0.02 * (np.linalg.norm(b - a) + np.linalg.norm(d - c)) - 3e-6
    along = np.clip((point - a) @ (b - a) / max((b - a) @ (b - a), 1e-300), 0.0, 1.0)
    np.testing.assert_allclose(a + along * (b - a), point, atol=3e-6)


def test_where_coal_cannot_tell_the_bound_serves(monkeypatch):
    arm = single('<cylinder radius="0.05" length="0.3"/>')
    scene = Scene({"o": Box((0.5, 0.5, 0), (0.1, 0.1, 0.1))}, self_collision=False)
    true = CollisionModel(arm, scene).minimum(arm.neutral()).distance
    clearance = CollisionModel(arm, scene)
    monkeypatch.setattr(coal, "distance", lambda *_: 1.7976931348623157e308)
    near = clearance.nearest(arm.at(arm.neutral()), np.inf)
    assert clearance.minimum(arm.neutral()).distance == near.minimum == near.distances[0]
    assert 0.0 < near.minimum <= true + 1e-9
    assert np.all(np.isfinite(near.jacobian))


def test_what_coal_cannot_tell_at_once_it_is_asked_less_exactly(monkeypatch):
    arm = single('<cylinder radius="0.05" length="0.3"/>')
    clearance = CollisionModel(arm, Scene({"o": Box((0.5, 0.5, 0), (0.1, 0.1, 0.1))}, self_collision=False))
    true = clearance.minimum(arm.neutral())
    ask = coal.distance
    answers = []

    def stubborn(*arguments):
        answers.append(1.7976931348623157e308 if len(answers) % 2 == 0 else ask(*arguments))
        return answers[-1]

    monkeypatch.setattr(coal, "distance", stubborn)
    assert clearance.minimum(arm.neutral()).distance == pytest.approx(true.distance, abs=1e-4)
    assert len(answers) == 2


def test_a_long_body_is_seen_by_a_small_box_anywhere_along_it():
    arm = single('<capsule radius="0.05" length="2"/>', rpy="0 1.5707963267948966 0")
    state = arm.at(arm.neutral())
    other = Sphere((0.5, 0, 0.45), 0.2)  # 0.2 m away, so that the box is looked at only if its bound says so
    for along in np.linspace(-0.5, 1.5, 41):
        clearance = CollisionModel(
            arm, Scene({"o": Box((along, 0.1, 0), (0.01, 0.01, 0.01)), "s": other}, self_collision=False)
        )
        assert clearance.nearest(state, 0.05).distances == pytest.approx([0.1 - 0.005 - 0.05], abs=1e-7)
        assert clearance.minimum(arm.neutral()).distance == pytest.approx(0.045, abs=1e-7)


@pytest.mark.long
def test_a_thousand_overlaps_have_finite_depths_and_unit_normals(monkeypatch):
    # The arm is inside of most of them however it turns: they would be left out.
    monkeypatch.setattr("pinposture.collision.model._always_close", lambda *given: [])
    arm = single('<cylinder radius="0.05" length="0.1"/>', xyz="0 0 0")
    rng = np.random.default_rng(0)
    state = arm.at(arm.neutral())
    for _ in range(20):
        around = {
            f"{kind}{k}": made
            for k in range(25)
            for kind, made in (
                ("c", Cylinder(rng.normal(size=3) * 0.1, rng.normal(size=3) * 0.1, 0.07)),
                ("b", Box(rng.normal(size=3) * 0.1, (0.2, 0.3, 0.4), rng.uniform(-3, 3, 3))),
            )
        }
        near = CollisionModel(arm, Scene(around, self_collision=False, margin=0.0)).nearest(state, np.inf)
        assert np.all(np.abs(near.distances) < 1.0)
        np.testing.assert_allclose(np.linalg.norm(near.normals, axis=1), 1.0, atol=1e-9)


def test_a_turned_body_is_where_its_frame_says():
    text = '<box size="0.1 0.2 0.3"/>'
    arm = single(text, rpy="0.3 -0.4 0.5")
    box = Box((0.5, 0, 0), (0.1, 0.2, 0.3), pin.rpy.rpyToMatrix(0.3, -0.4, 0.5))
    ball = Sphere((0.9, 0.3, 0.2), 0.1)
    assert CollisionModel(arm, Scene({"o": ball}, self_collision=False)).minimum(
        arm.neutral()
    ).distance == pytest.approx(separation(box, ball), abs=1e-7)


def tree(seed: int) -> pin.Model:
    """Joints of all kinds in random places, each on any of those before it."""
    rng = np.random.default_rng(seed)
    pin.seed(seed)
    model = pin.Model()
    axis = np.array([0.48, 0.6, 0.64])
    kinds = (
        pin.JointModelRX(),
        pin.JointModelRUBY(),
        pin.JointModelPZ(),
        pin.JointModelRevoluteUnaligned(axis),
        pin.JointModelPrismaticUnaligned(axis),
        pin.JointModelSpherical(),
        pin.JointModelPlanar(),
        pin.JointModelFreeFlyer(),
    )
    for number in range(16):
        parent = int(rng.integers(model.njoints))
        model.addJoint(parent, kinds[number % len(kinds)], pin.SE3.Random(), f"j{number}")
    return model


@pytest.mark.parametrize("seed", seeds(6))
def test_a_tree_of_joints_of_all_kinds_moves_as_in_pinocchio(seed):
    model = tree(seed)
    rng = np.random.default_rng(seed)
    kinematics = TreeKinematics(model)
    q = pin.integrate(model, pin.neutral(model), rng.normal(size=model.nv))
    offsets = rng.normal(size=(3, model.nv))
    single = [joint.idx_v for joint in model.joints[1:] if joint.nv == 1]
    offsets[:, np.setdiff1d(np.arange(model.nv), single)] = 0.0  # these turn in the frame of q
    placed = kinematics.place(q, offsets)
    data = model.createData()
    for offset, rotations, origins in zip(offsets, *placed, strict=True):
        pin.forwardKinematics(model, data, pin.integrate(model, q, offset))
        for joint in range(model.njoints):
            turn = rotations[joint] @ kinematics.turns[joint]
            np.testing.assert_allclose(turn, data.oMi[joint].rotation, atol=1e-12)
            np.testing.assert_allclose(origins[joint], data.oMi[joint].translation, atol=1e-11)


@pytest.mark.parametrize("seed", seeds(6))
def test_distances_in_a_tree_change_as_those_of_its_points(seed):
    model = tree(seed)
    rng = np.random.default_rng(seed)
    kinematics = TreeKinematics(model)
    q = pin.neutral(model)  # where the motion of every kind of joint is that of its tangent space
    first = rng.integers(1, model.njoints, 5)
    second = rng.integers(0, model.njoints, 5)
    points = rng.normal(size=(5, 3))
    normals = rng.normal(size=(5, 3))
    rows = kinematics.differentiate(kinematics.place(q), first, second, points, normals)

    before = model.createData()
    after = model.createData()
    pin.forwardKinematics(model, before, q)

    def heights(dq: np.ndarray) -> np.ndarray:
        """Both points of each contact along its normal, apart, after a motion from q."""
        pin.forwardKinematics(model, after, pin.integrate(model, q, dq))
        sides = [
            [after.oMi[int(j)].act(before.oMi[int(j)].actInv(p)) for j, p in zip(side, points, strict=True)]
            for side in (first, second)
        ]
        return np.einsum("ij,ij->i", normals, np.array(sides[0]) - np.array(sides[1]))

    step = 1e-6
    for column, unit in enumerate(np.eye(model.nv)):
        slope = (heights(step * unit) - heights(-step * unit)) / (2.0 * step)
        np.testing.assert_allclose(rows[:, column], slope, atol=1e-7)
