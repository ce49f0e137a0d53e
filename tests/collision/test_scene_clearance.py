"""A scene around an arm: broad phase, self-collision, what is left out, and how it is remembered."""

from __future__ import annotations

import gc
import pickle
import threading
import weakref
from itertools import pairwise

import numpy as np
import pinocchio as pin
import pytest
from collision.arms_with_bodies import ARMS, around, described, geometry, modelled, planar, sliding, spatial
from hypothesis import given
from hypothesis import strategies as st
from sampling import examples

import pinposture as pp
from pinposture import kernels
from pinposture.collision import Box, Capsule, Closest, CollisionModel, Cylinder, HalfSpace, Scene, Sphere
from pinposture.collision.model import MOTION_TOLERANCE
from pinposture.errors import InvalidValue

# Obstacles drawn at random may touch the base.
pytestmark = pytest.mark.filterwarnings("ignore:.*overlapping in every posture")


@pytest.mark.parametrize("name", ARMS)
def test_nothing_near_is_missed(name):
    """Against all pairs: with an infinite distance no bound is ever good enough to leave one out."""
    rng = np.random.default_rng(7)
    arm = ARMS[name]()
    for _ in range(4):
        clearance = CollisionModel(arm, Scene(around(arm, rng), self_collision=True))
        for _ in range(5):
            state = arm.at(arm.random(rng))
            everything = clearance.nearest(state, np.inf)
            assert len(everything.distances) == len(clearance.pairs)
            assert np.all(np.diff(everything.distances) >= 0.0)
            assert everything.minimum == everything.distances[0]
            for within in (0.0, 0.05 * arm.length, 0.3 * arm.length):
                near = clearance.nearest(state, within)
                kept = everything.distances < within
                np.testing.assert_array_equal(near.distances, everything.distances[kept])
                np.testing.assert_allclose(near.jacobian, everything.jacobian[kept], atol=1e-12)
                assert near.pairs == everything.pairs[: len(near.pairs)]
                assert near.minimum == everything.minimum
            closest = clearance.minimum(state.q)
            assert closest.distance == pytest.approx(everything.minimum, abs=1e-12)
            assert closest.pair == everything.pair


@examples(25)
@given(st.integers(0, 10_000))
def test_distances_are_those_of_coal_and_never_larger(seed):
    rng = np.random.default_rng(seed)
    arm = ARMS[sorted(ARMS)[seed % len(ARMS)]]()
    clearance = CollisionModel(arm, Scene(around(arm, rng), self_collision=True))
    q = arm.random(rng)
    distances = clearance._distances
    placements = clearance._kinematics.place(q)
    near = distances.near(placements, np.inf)
    poses = distances._pose_bodies(placements, 0)
    assert sorted(near.pairs) == list(range(len(clearance.pairs)))
    all_by_coal = distances._measure(near.pairs, poses, distances._sides[near.pairs])
    for distance, by_coal in zip(near.distances, all_by_coal, strict=True):
        assert distance <= by_coal + 2e-4 * (by_coal < 0.0) + 2e-6
        if by_coal > 0.0:
            assert distance == pytest.approx(by_coal, abs=2e-6)


@pytest.mark.filterwarnings("ignore:.*nothing keeps them apart")
@pytest.mark.long
@pytest.mark.parametrize("name", ARMS)
@given(seed=st.integers(0, 2**32 - 1), size=st.sampled_from([0.01, 0.1, 0.5]))
@examples(8)
def test_the_minimum_between_is_that_of_dense_samples(name, seed, size):
    arm = ARMS[name]()
    rng = np.random.default_rng(seed)
    clearance = CollisionModel(arm, Scene(around(arm, rng), self_collision=True))
    q = arm.checked(arm.random(rng))
    dq = size * rng.normal(size=arm.nv) * arm.joint_units
    dense = clearance.minimum_along(q, np.linspace(0.0, 1.0, 300)[:, None] * dq).distance
    found = clearance.minimum_between(q, dq)
    assert found.distance <= dense + MOTION_TOLERANCE * arm.length
    assert found.distance <= clearance.minimum_along(q, dq[None]).distance + 1e-12  # nothing less at the end
    # It is the distance somewhere on the way: no sample is nearer than the points move between two samples.
    at = np.linspace(0.0, 1.0, 3001)[:, None] * dq
    assert found.distance >= clearance.minimum_along(q, at).distance - 2e-3 * arm.length
    if found.distance < 0.5 * arm.length:
        below = clearance.minimum_on_motions(q, np.stack([0.0 * dq, dq]), found.distance - 1e-3)
        assert below.distance >= found.distance - 1e-3


@pytest.mark.parametrize("seed", range(4))
def test_the_minimum_among_many_obstacles_is_that_of_dense_samples(seed):
    """More pairs than are followed one by one; the arm also slides along walls."""
    arm = spatial()
    rng = np.random.default_rng(seed)
    crowd = {
        f"box {k}": Box(
            arm.length * rng.uniform(-0.9, 0.9, 3), arm.length * rng.uniform(0.005, 0.05 + 0.5 * (k < 3), 3)
        )
        for k in range(120)
    }
    clearance = CollisionModel(arm, Scene(crowd, self_collision=False))
    q = arm.checked(pp.arm.smooth_configuration(arm, rng, 0.8))
    dq = 0.05 * (1 + seed) * rng.normal(size=arm.nv) * arm.joint_units
    dense = clearance.minimum_along(q, np.linspace(0.0, 1.0, 1001)[:, None] * dq).distance
    found = clearance.minimum_between(q, dq).distance
    assert dense - 2e-3 * arm.length <= found <= dense + MOTION_TOLERANCE * arm.length


@pytest.mark.parametrize("seed", [4, 7, 10])
def test_a_long_motion_passes_over_no_small_ball(seed):
    """What was measured halfway of a motion bounds the distances in its halves, of each half its own."""
    arm = pp.Arm.from_template("RyRz", modules=20)
    rng = np.random.default_rng(seed)
    start, goal = (arm.checked(pp.arm.smooth_configuration(arm, rng, 0.6)) for _ in range(2))
    centers = rng.uniform(-0.5, 0.5, (60, 3)) + [0.0, 0.0, 0.4]
    balls = {f"ball {k}": Sphere(tuple(center), 0.004) for k, center in enumerate(centers)}
    clearance = CollisionModel(arm, Scene(balls, self_collision=False))
    change = arm.difference(start, goal)
    dense = clearance.minimum_along(start, np.linspace(0.0, 1.0, 2001)[:, None] * change).distance
    assert clearance.minimum_between(start, change).distance <= dense + MOTION_TOLERANCE * arm.length
    walk = np.linspace(0.0, 1.0, 9)[:, None] * change
    lowest = np.array(
        [
            clearance.minimum_along(start, one + np.linspace(0.0, 1.0, 251)[:, None] * (other - one)).distance
            for one, other in pairwise(walk)
        ]
    )
    asked = np.ones(8, dtype=np.bool_)
    for least in np.quantile(lowest, [0.3, 0.6]):
        contacts = clearance.contacts_along(start, walk, least + 0.05)
        kept = clearance.keep_distance(start, walk, least, asked, contacts)
        np.testing.assert_array_equal(kept, lowest >= least)


def test_each_motion_keeps_a_distance_as_its_samples_do():
    """Also from a mesh, which the kernel leaves open; motions that are not asked for are not checked.

    The farther the contacts at the ends of the motions are seen, the more pairs need no measurement between.
    """
    arm = spatial()
    rng = np.random.default_rng(5)
    clearance = CollisionModel(arm, Scene(around(arm, rng), self_collision=False))
    assert clearance._distances._open > 0
    q = arm.checked(arm.neutral())
    walk = np.cumsum(0.2 * rng.normal(size=(24, arm.nv)) * arm.joint_units, axis=0)
    shares = np.linspace(0.0, 1.0, 50)[:, None]
    motions = [one + shares * (other - one) for one, other in pairwise(walk)]
    lowest = np.array([clearance.minimum_along(q, motion).distance for motion in motions])
    asked = rng.random(len(lowest)) < 0.8
    slack = 5e-3 * arm.length
    for least in np.quantile(lowest, [0.3, 0.5, 0.7]):
        for beyond in (0.0, 0.1, 2.0):
            contacts = clearance.contacts_along(q, walk, least + beyond * arm.length)
            kept = clearance.keep_distance(q, walk, least, asked, contacts)
            assert not kept[~asked].any()
            assert kept[asked & (lowest > least + slack)].all()
            assert not kept[lowest < least - slack].any()
            assert 2 < kept.sum() < asked.sum() - 2


def test_the_minimum_between_sees_obstacles_move():
    arm = spatial()
    speed = np.array([0.0, 0.0, -0.5])
    above = tuple(arm.at(arm.neutral()).points[3] + [0.0, 0.0, 1.0])
    scene = Scene({"ball": Sphere(above, 0.05)}, self_collision=False).moved(
        {"ball": (0.0, 0.0, 0.0)}, velocities={"ball": speed}
    )
    model = CollisionModel(arm, scene)
    still = np.zeros((3, arm.nv))
    times = np.array([0.0, 1.0, 4.0])  # after two seconds the ball falls through the arm
    assert model.minimum_on_motions(arm.checked(arm.neutral()), still, times=times).distance < 0.0
    assert model.minimum_on_motions(arm.checked(arm.neutral()), still, times=0.25 * times).distance > 0.3
    assert scene.after(1.0).obstacles["ball"].center == pytest.approx(above + 1.0 * speed)
    assert scene.after(1.0).velocities == scene.velocities
    assert CollisionModel(arm, scene.after(2.0)).minimum(arm.neutral()).distance < 0.0
    for time in (-1.0, np.nan, np.inf):
        with pytest.raises(InvalidValue, match="time"):
            scene.after(time)


def test_a_moment_without_self_collision_belongs_to_the_scene_without_it():
    scene = Scene({"ball": Sphere((0.5, 0.0, 0.0), 0.05)}, self_collision=True)
    moment = scene.moved({"ball": (0.0, 0.0, 0.4)}, velocities={"ball": (0.0, 0.1, 0.0)})
    alone = moment.without_self_collision()
    assert not alone.self_collision
    assert alone.first == scene.without_self_collision()
    assert alone.obstacles == moment.obstacles
    assert (alone.velocities, alone.moving) == (moment.velocities, {"ball"})
    assert alone.without_self_collision() is alone


def test_a_step_over_a_thin_thing_is_seen_between_its_ends():
    arm = spatial(4)
    pole = arm.at(arm.configuration([0.0, 0.3] + [0.0] * 6)).points[-1]
    clearance = CollisionModel(arm, Scene({"pole": Sphere(pole, 0.005)}, self_collision=False))
    q = arm.neutral()
    dq = np.array([0.0, 0.6] + [0.0] * 6)
    assert clearance.minimum(q).distance > 0.05 and clearance.minimum(q + dq).distance > 0.05
    assert clearance.minimum_between(q, dq).distance < 0.0


def test_a_straight_arm_is_free_of_itself_and_a_curled_one_is_not():
    for arm in (spatial(12), planar(6), pp.Arm.from_template("RyRz", 20), sliding(4), modelled()):
        clearance = CollisionModel(arm, Scene(self_collision=True))
        assert clearance.minimum(arm.straight()).distance > 0.005
        alone = CollisionModel(arm, Scene(self_collision=False))
        assert alone.pairs == () and alone.minimum(arm.straight()) == Closest(np.inf, None)
    arm = planar(6)
    clearance = CollisionModel(arm, Scene(self_collision=True))
    ring = arm.configuration(np.full(arm.nv, 2 * np.pi / (arm.nv - 1)))
    closest = clearance.minimum(ring)
    assert closest.distance < 0.0
    assert {name[:3] for name in closest.pair} == {"m01", "m06"}


def test_the_distance_of_two_links_of_a_bent_arm_in_closed_form():
    arm = pp.Arm.from_template("Rz", 4, (0.2,))
    q = arm.configuration([0.0, np.pi / 2, np.pi / 2, 0.0])  # a hairpin: two legs, 0.2 m apart
    near = CollisionModel(arm, Scene(self_collision=True)).nearest(arm.at(q), np.inf)
    by_pair = dict(zip(near.pairs, near.distances, strict=True))
    assert by_pair["m03_l1", "m01_l1"] == pytest.approx(0.2 - 2 * 0.02)
    assert by_pair["m04_l1", "m02_l1"] == pytest.approx(0.2 - 0.02)  # the last link begins with a flat end
    assert ("m02_l1", "m01_l1") not in by_pair


def test_bodies_that_touch_where_the_arm_is_straight_are_named():
    arm = pp.Arm.from_template("RyRz", 3)  # links of 25 mm, 20 mm thick
    clearance = CollisionModel(arm, Scene(self_collision=True))
    assert (
        "m02_l1",
        "m01_l1",
        "near each other where the arm is straight or neutral",
    ) in clearance.excluded_pairs
    assert ("m02_l2", "m01_l1") in clearance.pairs
    strict = CollisionModel(arm, Scene(self_collision=True, margin=0.0))
    assert strict.excluded_pairs == () and ("m02_l1", "m01_l1") in strict.pairs


def test_tubes_that_slide_in_one_another_may():
    tube = geometry('<box size="0.2 0.05 0.05"/>')
    arm = pp.Arm.load(described(["", tube, tube, tube], 0.01, slides=(3, 4)), split=4)
    clearance = CollisionModel(arm, Scene(self_collision=True))
    assert [(each.first, each.second) for each in clearance.excluded_pairs] == [("l4", "l2")]
    assert clearance.minimum(arm.neutral()).distance > 0.0


def test_an_arm_can_hit_its_own_base_but_a_base_hits_nothing():
    ball = geometry('<sphere radius="0.03"/>', "0.1 0 0")
    arm = pp.Arm.load(described([ball] * 4, base=geometry('<box size="0.1 0.4 0.1"/>', "-0.2 0 0")), split=2)
    scene = Scene({"floor": Sphere((-0.2, 0, 0), 0.1)}, self_collision=True)
    clearance = CollisionModel(arm, scene)
    assert ("l0", "floor") not in clearance.pairs and ("l1", "l0") not in clearance.pairs
    assert ("l4", "l0") in clearance.pairs
    hit = arm.configuration([0.0, np.pi / 2, 0.0, np.pi / 2])
    distances = dict(zip(*clearance.nearest(arm.at(hit), np.inf)[2::-2], strict=True))
    # The ball on the last link is at x = -0.1, y = 0.2 then, on the corner of the box's long side.
    assert distances["l4", "l0"] == pytest.approx(
        np.linalg.norm(np.maximum(np.abs(arm_ball(arm, hit) - [-0.2, 0, 0]) - [0.05, 0.2, 0.05], 0)) - 0.03,
        abs=1e-7,
    )


def arm_ball(arm, q):
    data = arm.model.createData()
    pin.forwardKinematics(arm.model, data, q)
    return data.oMi[4].act(np.array([0.1, 0, 0]))


def test_what_the_arm_is_mounted_on_is_no_obstacle_to_its_first_body():
    arm = pp.Arm.from_template(
        "RyRz", 4, base_placement=pin.SE3(pin.rpy.rpyToMatrix(0, -np.pi / 2, 0), np.zeros(3))
    )
    floor = HalfSpace((0, 0, 0), (0, 0, 1))
    far = Sphere((0.1, 0.1, 0.1), 0.01)
    clearance = CollisionModel(arm, Scene({"floor": floor, "ball": far}, self_collision=False))
    assert [(each.first, each.second) for each in clearance.excluded_pairs] == [("m01_l1", "floor")]
    assert clearance.excluded_pairs[0].reason == "the arm is mounted on it"
    assert clearance.minimum(arm.straight()).distance == pytest.approx(0.025 - 0.01)
    assert ("m01_l1", "ball") in clearance.pairs
    # A floor below the base can be met by every body.
    assert not CollisionModel(
        arm, Scene({"floor": HalfSpace((0, 0, -0.02), (0, 0, 1))}, self_collision=False)
    ).excluded_pairs


def test_the_nearest_is_exact_where_nothing_is_near():
    arm = spatial()
    clearance = CollisionModel(arm, Scene({"far": Box((5, 5, 5), (1, 1, 1))}, self_collision=False))
    near = clearance.nearest(arm.at(arm.straight()), 0.01)
    assert near.distances.shape == (0,) and near.jacobian.shape == (0, arm.nv) and near.pairs == ()
    assert near.points.shape == near.normals.shape == (0, 3)
    assert near.minimum == pytest.approx(clearance.minimum(arm.straight()).distance, abs=1e-12)
    assert near.pair == clearance.minimum(arm.straight()).pair
    nothing = CollisionModel(arm, Scene(self_collision=False)).nearest(arm.at(arm.straight()), np.inf)
    assert nothing.minimum == np.inf and nothing.pair is None and nothing.jacobian.shape == (0, arm.nv)


@pytest.mark.long
def test_clearances_are_remembered_as_long_as_the_arm_lives():
    arm = spatial()
    scene = Scene({"o": Sphere((1, 1, 1), 0.1)}, self_collision=False)
    clearance = CollisionModel(arm, scene)
    assert (
        CollisionModel(arm, scene)
        is clearance
        is CollisionModel(arm, Scene({"o": Sphere((1, 1, 1), 0.1)}, self_collision=False))
    )
    assert CollisionModel(arm, Scene({"o": Sphere((1, 1, 1), 0.2)}, self_collision=False)) is not clearance
    copy = pickle.loads(pickle.dumps(arm))
    assert CollisionModel(copy, scene) is not clearance
    gone = weakref.ref(arm)
    del arm
    gc.collect()
    assert gone() is None
    assert clearance.minimum(copy.straight()) == CollisionModel(copy, scene).minimum(copy.straight())


def test_many_scenes_around_one_arm_are_not_all_kept():
    arm = spatial(1)
    first = Scene(margin=0.001)
    clearance = CollisionModel(arm, first)
    for k in range(40):
        CollisionModel(arm, Scene(margin=0.01 + 0.001 * k))
    assert CollisionModel(arm, first) is not clearance


@pytest.mark.long
def test_threads_do_not_disturb_each_other():
    arm = spatial(8)
    rng = np.random.default_rng(0)
    clearance = CollisionModel(arm, Scene(around(arm, rng), self_collision=True))
    starts = [arm.random(rng) for _ in range(4)]
    alone = [(clearance.minimum(q), clearance.nearest(arm.at(q), 0.1)) for q in starts]
    wrong = []

    def work(q, expected):
        for _ in range(60):
            near = clearance.nearest(arm.at(q), 0.1)
            if clearance.minimum(q) != expected[0] or not np.array_equal(near.jacobian, expected[1].jacobian):
                wrong.append(q)

    threads = [threading.Thread(target=work, args=each) for each in zip(starts, alone, strict=True)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not wrong


def test_results_stay_as_they_are_when_the_arm_moves_on():
    arm = spatial()
    rng = np.random.default_rng(0)
    clearance = CollisionModel(arm, Scene(around(arm, rng), self_collision=False))
    near = clearance.nearest(arm.at(arm.random(rng)), np.inf)
    before = [np.copy(each) for each in (near.distances, near.jacobian, near.points, near.normals)]
    clearance.nearest(arm.at(arm.random(rng)), np.inf)
    for each, was in zip((near.distances, near.jacobian, near.points, near.normals), before, strict=True):
        np.testing.assert_array_equal(each, was)


@pytest.mark.parametrize(
    ("ask", "words"),
    [
        (lambda c, arm: c.minimum(np.zeros(3)), "q (shape)"),
        (lambda c, arm: c.minimum(np.full(arm.nq, np.nan)), "q[0] is nan"),
        (lambda c, arm: c.minimum_between(np.zeros(2), np.zeros(arm.nv)), "q0 (shape)"),
        (lambda c, arm: c.minimum_between(arm.neutral(), np.zeros(2)), "dq (shape)"),
        (lambda c, arm: c.minimum_between(arm.neutral(), np.full(arm.nv, np.inf)), "dq[0] is inf"),
        (lambda c, arm: c.nearest(arm.at(arm.neutral()), -1), "within is -1"),
        (lambda c, arm: c.nearest(arm.at(arm.neutral()), np.nan), "within is nan"),
        (lambda c, arm: c.nearest(arm.at(arm.neutral()), "far"), "within is 'far'"),
        (lambda c, arm: c.nearest(arm.neutral(), 1), "state is"),
        (lambda c, arm: c.nearest(spatial().at(spatial().neutral()), 1), "state is"),
        (lambda c, arm: CollisionModel("arm", Scene()), "arm is 'arm'; allowed: an Arm"),
    ],
)
def test_bad_questions_are_refused_by_name(ask, words):
    arm = spatial()
    with pytest.raises(InvalidValue) as caught:
        ask(CollisionModel(arm, Scene({"o": Sphere((1, 1, 1), 0.1)}, self_collision=False)), arm)
    assert words in str(caught.value)


def test_one_joint_and_continuous_joints():
    for arm in (pp.Arm.from_template("Rz", 1), modelled()):
        scene = Scene(
            {"c": Capsule((0, 0.3, -1), (0, 0.3, 1), 0.02), "y": Cylinder((0, 0, 1), (0, 1, 1), 0.1)},
            self_collision=False,
        )
        near = CollisionModel(arm, scene).nearest(arm.at(arm.straight()), np.inf)
        assert near.jacobian.shape == (len(near.pairs), arm.nv) and np.all(np.isfinite(near.jacobian))


@pytest.mark.long
def test_an_arm_of_a_thousand_joints_has_a_scene() -> None:
    arm = pp.Arm.from_template("RyRz", 500)  # 25 m along x, links 20 mm thick
    scene = Scene(
        {"post": Sphere((12.3, 5.0, 0.0), 0.1), "floor": HalfSpace((0, 0, -1.0), (0, 0, 1))},
        self_collision=False,
    )
    clearance = CollisionModel(arm, scene)
    near = clearance.nearest(arm.at(arm.straight()), 1.5)
    radius = clearance._distances._arrays.radii[0]
    assert near.minimum == pytest.approx(1.0 - radius, abs=1e-9)
    assert {other for _, other in near.pairs} == {"floor"}
    step = np.zeros(arm.nv)
    step[1] = 0.1  # about z: the post comes nearer
    turned = clearance.minimum(arm.integrate(arm.straight(), step))
    assert turned.pair is not None and turned.distance <= 1.0 - radius + 1e-9


def test_a_moment_is_not_that_of_another_thread(monkeypatch):
    """Whatever another thread asks for between two instructions, here as soon as a moment is remembered."""

    class Remembered:
        def __get__(self, model, kind=None):
            return model.__dict__.get("last")

        def __set__(self, model, moment):
            other = model.__dict__.get("last")
            model.__dict__["last"] = moment if other is None else other  # put back at once

    arm = planar()
    still = Scene({"ball": Sphere(center=(2.0, 0.0, 0.0), radius=0.1)}, self_collision=False)
    one, two = (still.moved({"ball": (2.0, y, 0.0)}) for y in (1.0, 2.0))
    monkeypatch.setattr(CollisionModel, "_moment", Remembered(), raising=False)
    assert CollisionModel(arm, one).scene is one
    assert CollisionModel(arm, two).scene is two


def test_what_is_beside_the_base_is_left_out_with_a_warning_and_does_not_stop_the_arm():
    arm = pp.Arm.from_template("RyRz", 6)
    mount = pp.Scene({"mount": pp.HalfSpace([0, 0, 0], [1, 0, 0])}, self_collision=False, margin=0.02)
    with pytest.warns(pp.PostureWarning, match="m01_l2 to mount: within the margin however the arm bends"):
        clearance = pp.CollisionModel(arm, mount)
    assert ("m01_l2", "mount") in {(each.first, each.second) for each in clearance.excluded_pairs}
    assert ("m02_l1", "mount") in clearance.pairs  # which can keep the margin
    start = np.full(12, 0.1)
    run = pp.track(arm, pp.Target.from_configuration(arm, arm.neutral()), start, scene=mount)
    assert run.converged


def test_an_obstacle_around_the_base_is_reported_as_overlapping_in_every_posture():
    arm = pp.Arm.from_template(
        "RyRz", 6, link_lengths=[0.02, 0.03]
    )  # the second link starts 0.02 m from the base
    scene = Scene({"b": Sphere([0, 0, 0], 0.025)}, self_collision=False, margin=0.002)
    message = "^m01_l2 to b: overlapping in every posture; these collisions are ignored$"
    target = pp.Target.from_configuration(arm, arm.neutral())
    with pytest.warns(pp.PostureWarning, match=message) as caught:
        pp.track(arm, target, arm.straight(), scene=scene)
    assert caught[0].filename == __file__  # although the model is built deep inside of `track`
    model = CollisionModel(arm, scene)
    reasons = {each.first: each.reason for each in model.excluded_pairs if each.second == "b"}
    assert reasons["m01_l2"] == "overlapping in every posture" and ("m06_l2", "b") in model.pairs


def test_an_arm_inside_of_an_obstacle_is_told_so_for_all_of_its_bodies():
    arm = pp.Arm.from_template("RyRz", 6)
    clearance = pp.CollisionModel(
        arm, pp.Scene({"block": pp.Box([0, 0, 0], [9, 9, 9])}, self_collision=False)
    )
    assert not clearance.excluded_pairs or all(each.first == "m01_l1" for each in clearance.excluded_pairs)
    assert clearance.minimum(arm.neutral()).distance < -1.0


@pytest.mark.parametrize("turn", [-0.16, -0.2])
def test_a_bound_at_the_distance_sought_ends_the_search(turn, monkeypatch):
    """Bodies on both sides of a joint keep the bound of 5 mm: the distance sought less the tolerance.

    A search that halves the motion until that is decided does not end.
    """
    arm = pp.Arm.from_template("RyRz", modules=20)
    found = []
    search = kernels.smallest_distance_on_motions

    def record(*arguments):
        found.append(search(*arguments))
        return found[-1]

    monkeypatch.setattr(kernels, "smallest_distance_on_motions", record)
    moved = np.zeros((2, arm.nv))
    moved[1, 30:] = turn
    start = arm.checked(np.full(arm.nv, 0.1))
    model = pp.CollisionModel(arm, pp.Scene())
    least = 0.005 + MOTION_TOLERANCE * arm.length
    assert model.minimum_on_motions(start, moved, least, least).distance == np.inf
    assert [opened < 20 for _, _, opened in found] == [True]
    there = [
        model.minimum(arm.integrate(start, share * moved[1])).distance for share in np.linspace(0, 1, 50)
    ]
    assert min(there) >= least
