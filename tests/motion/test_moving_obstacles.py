"""Obstacles that move: margins judged by Pinocchio's kinematics and distances of segments in closed form."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from arms import template_arm
from sampling import cases

import pinposture as pp
from pinposture.collision import CollisionModel
from pinposture.collision.obstacles import displaced
from pinposture.control.controller import CONSTRAINTS
from pinposture.errors import InvalidValue, UnknownName

MARGIN = 0.005
THIN = 0.01
BALL = 0.06
DT = 0.01
LIMITS = pp.Limits(step=None, velocity=1.0, acceleration=5.0, dt=DT)


def arm() -> pp.Arm:
    return template_arm("RyRz", 20)


@cache
def kinematics() -> tuple[pin.Model, pin.Data, int]:
    """The model of the arm, data for it, and the frame of the tip."""
    model = arm().model
    return model, model.createData(), model.nframes - 1


def gap(q: np.ndarray, center: np.ndarray) -> float:
    """Distance of a ball from the links of the arm, which are capsules from joint to joint to the tip."""
    model, data, tip = kinematics()
    pin.framesForwardKinematics(model, data, q)
    nodes = np.array([data.oMi[joint].translation for joint in range(1, model.njoints)])
    nodes = np.vstack([nodes, data.oMf[tip].translation])
    ends = np.diff(nodes, axis=0)
    squares = np.maximum((ends**2).sum(axis=1), 1e-30)
    shares = np.clip(((center - nodes[:-1]) * ends).sum(axis=1) / squares, 0.0, 1.0)
    return float(np.linalg.norm(nodes[:-1] + shares[:, None] * ends - center, axis=1).min()) - BALL - THIN


def crossing(seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Start and goal, and a ball that flies at 0.2 m/s through one of them, but not through the base."""
    rng = np.random.default_rng(seed)
    while True:
        start, goal = (pp.arm.smooth_configuration(arm(), rng, 0.8) for _ in range(2))
        aim = arm().at(start if rng.random() < 0.5 else goal).points[rng.integers(8, 20)]
        direction = rng.normal(size=3)
        velocity = 0.2 * direction / np.linalg.norm(direction)
        origin = aim - velocity * rng.uniform(1.5, 4.0)
        places = origin + np.arange(0.0, 8.0, 0.05)[:, None] * velocity
        if np.linalg.norm(places, axis=1).min() > 0.16 and gap(start, origin) > 0.02:
            return start, goal, origin, velocity


def ball_scene() -> pp.Scene:
    return pp.Scene(
        {"ball": pp.Sphere((0, 0, 0), BALL)}, self_collision=False, margin=MARGIN, arm_radius=THIN
    )


@pytest.mark.long
@pytest.mark.parametrize("seed", cases([0, 2, 1], 2))
@pytest.mark.parametrize("deadline, planning", [(np.inf, "thread"), (1e-9, "thread"), (0.002, "process")])
def test_the_margin_to_a_ball_that_flies_by_is_kept(seed: int, deadline: float, planning: str) -> None:
    q, goal, origin, velocity = crossing(seed)
    scene = ball_scene()
    tracker = pp.Tracker(arm(), limits=LIMITS, scene=scene, deadline=deadline, planning=planning)
    # With a deadline that no step meets, the arm stays where it is, and still makes way.
    tracker.update(pp.Target.from_configuration(arm(), q if deadline == 1e-9 else goal))
    lowest = np.inf
    before = np.zeros(arm().nv)
    for cycle in range(2500):
        center = origin + cycle * DT * velocity
        moment = scene.moved({"ball": center}, velocities={"ball": velocity})
        dq = tracker.step(q, scene=moment)
        assert {each.partition(":")[0] for each in tracker.report.violated_constraints} <= {*CONSTRAINTS}
        if not tracker.report.violated_constraints:
            assert np.abs(dq).max() <= LIMITS.velocity * DT + 1e-9
            assert np.abs(dq - before).max() <= LIMITS.acceleration * DT**2 + 1e-9
        halfway = q + 0.5 * dq
        after = q + dq
        lowest = min(lowest, gap(halfway, center + 0.5 * DT * velocity), gap(after, center + DT * velocity))
        q = after
        before = dq
        passed = cycle > 800 and np.linalg.norm(center) > 1.2
        if passed and (deadline < np.inf or tracker.report.status == "converged"):
            break
    assert lowest >= MARGIN - 2e-4
    if deadline == np.inf:
        assert tracker.report.status == "converged"


@pytest.mark.long
@pytest.mark.parametrize("seed", cases([6, 5, 14], 1))
def test_a_chased_arm_whose_goal_is_blocked_keeps_limits_and_margin_with_few_queries(
    seed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A post sweeps through the goal, which moves, at 0.3 m/s; measurements are noisy."""
    queries = [0]
    original = CollisionModel.nearest

    def counted(*given: Any) -> Any:
        queries[-1] += 1
        return original(*given)

    monkeypatch.setattr(CollisionModel, "nearest", counted)
    rng = np.random.default_rng(seed)
    q = np.zeros(40)
    before = np.zeros(40)
    post = pp.Scene(
        {"post": pp.Capsule((0, 0, -1), (0, 0, 1), BALL)},
        self_collision=False,
        margin=2 * MARGIN,
        arm_radius=THIN,
    )
    goal = pp.arm.smooth_configuration(arm(), rng, 0.3)
    limits = pp.Limits(step=None, velocity=1.0, acceleration=4.0, dt=DT)
    tracker = pp.Tracker(arm(), limits=limits, scene=post)
    lowest = np.inf
    for cycle in range(700):
        y = -1.2 + 0.3 * DT * cycle
        wanted = goal * (1.0 + 0.15 * np.sin(0.01 * cycle))
        tracker.update(pp.Target.from_configuration(arm(), wanted))
        moment = post.moved({"post": (0.6, y, 0.0)}, velocities={"post": (0.0, 0.3, 0.0)})
        dq = tracker.step(q + rng.normal(0.0, 2e-3, 40), scene=moment)
        assert np.abs(dq).max() <= limits.velocity * DT + 1e-12
        assert np.abs(dq - before).max() <= limits.acceleration * DT**2 + 1e-12
        q = tracker.command
        before = dq
        height = np.clip(arm().at(q).points[:, 2], -1.0, 1.0)
        axis = np.column_stack([np.full(20, 0.6), np.full(20, y + 0.3 * DT), height])
        lowest = min(lowest, np.linalg.norm(arm().at(q).points - axis, axis=1).min() - BALL - THIN)
        queries.append(0)
    assert lowest >= 2 * MARGIN - 2e-4
    assert np.percentile(queries, 98) <= 20  # a whole search for a goal makes 70


@pytest.mark.long
def test_an_arm_at_its_position_limits_evades_with_noisy_measurements() -> None:
    rng = np.random.default_rng(0)
    scene = ball_scene()
    q = np.zeros(40)
    limits = replace(LIMITS, position_margin=3.0)
    q[0:8:2] = np.pi - 3.0
    q[8:16:2] = 3.0 - np.pi
    tracker = pp.Tracker(arm(), limits=limits, scene=scene, interface="velocity")
    tracker.update(pp.Target.from_configuration(arm(), q))
    aim = arm().at(q).points[14]
    velocity = np.array([0.0, 0.15, 0.0])
    lowest = np.inf
    for cycle in range(400):
        center = aim + (cycle - 150) * DT * velocity
        moment = scene.moved({"ball": center}, velocities={"ball": velocity})
        dq = tracker.step(q + rng.normal(0.0, 1e-3, 40), scene=moment)
        q = q + dq
        lowest = min(lowest, gap(q, center + DT * velocity))
    assert lowest >= 0.5 * MARGIN  # noise takes its share


@pytest.mark.long
@pytest.mark.parametrize("hit, velocity, point", [(60, (0, 0, -0.1), 18), (100, (0, 0.1, 0), 10)])
def test_an_arm_on_its_way_back_into_its_position_limits_evades(
    hit: int, velocity: tuple[float, ...], point: int
) -> None:
    """A ball would hit it in a certain cycle; the way back takes 160."""
    scene = ball_scene()
    q = np.zeros(40)
    lowest = np.inf
    q[0:8:2] = 0.3
    q[8:16:2] = -0.3
    limits = replace(LIMITS, velocity=0.1, position_margin=3.0)  # within 0.14 rad
    tracker = pp.Tracker(arm(), limits=limits, scene=scene)
    tracker.update(pp.Target.from_configuration(arm(), np.zeros(40)))
    aim = arm().at((1.0 - hit / 300.0) * q).points[point]
    speed = np.array(velocity)
    for cycle in range(250):
        center = aim + (cycle - hit) * DT * speed
        q = q + tracker.step(q, scene=scene.moved({"ball": center}, velocities={"ball": velocity}))
        lowest = min(lowest, gap(q, center + DT * speed))
    assert lowest >= MARGIN - 2e-4


@pytest.mark.long
@pytest.mark.parametrize("jerk, deadline", [(None, np.inf), (40.0, np.inf), (None, 1e-9)])
def test_each_step_beyond_the_acceleration_limit_is_reported(jerk: float | None, deadline: float) -> None:
    """A ball appears just before an arm that moves at full speed."""
    short = template_arm("RyRz", 2)
    limits = pp.Limits(step=None, velocity=1.0, acceleration=2.0, jerk=jerk, dt=DT)
    far = np.array([0.0, 0.0, 5.0])
    q = np.zeros(4)
    goal = np.array([1.5, 0.0, 0.0, 0.0])
    scene = pp.Scene({"ball": pp.Sphere(far, BALL)}, self_collision=False, margin=MARGIN, arm_radius=THIN)
    tracker = pp.Tracker(short, limits=limits, scene=scene, deadline=deadline, planning="thread")
    tracker.update(pp.Target.from_configuration(short, goal if deadline == np.inf else q))
    beyond = 0
    before = np.zeros(4)
    gap_ahead = 0.0003 if jerk is None else 0.0025
    if deadline < np.inf:
        before = np.array([0.005, 0.0, 0.0, 0.0])
        tracker.restart(q, before)
    for cycle in range(120):
        if cycle == (0 if deadline < np.inf else 25):
            ahead = short.at(q + 30 * before).points[-1] - short.at(q).points[-1]
            center = short.at(q).points[-1] + (BALL + THIN + gap_ahead) * ahead / np.linalg.norm(ahead)
            scene = scene.moved({"ball": center - far}, velocities={"ball": (1e-6, 0.0, 0.0)})
        dq = tracker.step(q, scene=scene)
        exceeded = np.abs(dq - before).max() > limits.acceleration * DT**2 * (1 + 1e-6)
        said = any(each.startswith("acceleration limit: ") for each in tracker.report.violated_constraints)
        assert said if exceeded else not said or jerk is not None  # which may be exceeded alone
        beyond = beyond + exceeded
        q = tracker.command
        before = dq
    assert beyond >= (1 if jerk is None else 3)


@pytest.mark.long
def test_a_detour_is_cut_short_once_the_obstacle_has_left() -> None:
    planar = template_arm("Rz", 8)
    start = np.full(8, 0.15)
    length = planar.length
    rng = np.random.default_rng(0)
    ball = pp.Sphere((0.5 * length, 0, 0), 0.05 * length)
    first = pp.Scene({"ball": ball}, self_collision=False, margin=0.005 * length, arm_radius=0.01 * length)

    def cycles_to_goal(leaves: int) -> int:
        tracker = pp.Tracker(planar, limits=LIMITS, scene=first)
        q = start
        tracker.update(pp.Target.from_configuration(planar, -start))
        for cycle in range(1000):
            moment = first.moved({"ball": (0.0, 0.0 if cycle < leaves else 9.0, 0.0)})
            tracker.step(q + rng.normal(0.0, 1e-4, 8), scene=moment)
            q = tracker.command
            if np.abs(q + start).max() < 1e-3:
                return cycle
        raise AssertionError(tracker.report)

    free, left, blocked = (cycles_to_goal(leaves) for leaves in (0, 20, 1000))
    assert left < 0.5 * (free + blocked)


def test_an_arm_that_nothing_comes_near_stays_where_it_is() -> None:
    scene = ball_scene()
    q = np.full(40, 0.05)
    tracker = pp.Tracker(arm(), limits=LIMITS, scene=scene)
    tracker.update(pp.Target.from_configuration(arm(), q))
    for cycle in range(20):
        moment = scene.moved({"ball": (0.0, 2.0, 0.01 * cycle)}, velocities={"ball": (0.0, 0.0, 1.0)})
        assert not np.any(tracker.step(q, scene=moment))


@pytest.mark.long
@pytest.mark.parametrize("first, reason", [("converged", "the target is"), ("holding", "no target")])
def test_an_arm_without_a_fresh_target_holds_and_evades_what_approaches(first: str, reason: str) -> None:
    scene = ball_scene()
    q = np.zeros(40)
    tracker = pp.Tracker(arm(), limits=LIMITS, scene=scene, timeout=0.5)
    if first == "converged":
        tracker.update(pp.Target.from_configuration(arm(), q))
    passed = 0.7 * arm().length
    statuses = []
    gaps = []
    for cycle in range(600):
        center = np.array([passed, 0.5 - 0.2 * DT * cycle, 0.02])  # straight through the resting arm
        tracker.step(q, scene=scene.moved({"ball": center}, velocities={"ball": (0.0, -0.2, 0.0)}))
        moved = np.any(tracker.command != q)
        q = tracker.command
        gaps.append(gap(q, center))
        statuses.append(tracker.report.status)
        assert (statuses[-1] == "evading") <= bool(moved)
        if statuses[-1] in ("holding", "evading"):
            assert reason in tracker.report.reason
    order = [status for k, status in enumerate(statuses) if k == 0 or status != statuses[k - 1]]
    assert order == [*dict.fromkeys([first, "holding"]), "evading", "holding"]
    assert min(gaps) > MARGIN - 1e-4


def test_velocities_need_the_duration_of_a_step() -> None:
    scene = ball_scene().moved({"ball": (0.5, 0.5, 0.0)}, velocities={"ball": (0.0, -0.1, 0.0)})
    controller = pp.Geodesic(scene=scene)
    target = pp.Target.from_configuration(arm(), np.full(40, 0.1))
    with pytest.raises(InvalidValue, match="dt"):
        controller.step(arm().at(np.zeros(40)), target)


@pytest.mark.long
def test_what_stands_still_does_not_repel_an_arm_while_something_else_moves() -> None:
    """The arm comes as near to a post beside its goal as without the ball, which is far away."""
    q = np.zeros(40)
    goal = np.full(40, 0.02)
    beside = arm().at(goal).points[-1] + [0.0, 0.0, MARGIN + BALL + THIN + 0.02]
    scene = pp.Scene(
        {"ball": pp.Sphere((0, 0, 0), BALL), "post": pp.Sphere(tuple(beside), BALL)},
        self_collision=False,
        margin=MARGIN,
        arm_radius=THIN,
    )
    cycles = []
    for speed in (0.0, 1e-6, 0.2):
        tracker = pp.Tracker(arm(), limits=LIMITS, scene=scene)
        here = q
        tracker.update(pp.Target.from_configuration(arm(), goal))
        for cycle in range(400):
            moment = scene.moved({"ball": (0, 3.0, speed * DT * cycle)}, velocities={"ball": (0, 0, speed)})
            here = here + tracker.step(here, scene=moment)
            if tracker.report.status == "converged":
                break
        cycles.append(cycle)
    assert max(cycles) <= min(cycles) + 2 < 300


@pytest.mark.long
@pytest.mark.parametrize("faster, velocity", [(2.0, 0.3), (4.0, 0.5)])
def test_an_arm_gets_out_of_the_way_of_a_ball_that_is_faster_than_it(faster: float, velocity: float) -> None:
    q, _, origin, flight = crossing(15)  # without an early retreat, the arm is hit
    limits = pp.Limits(step=None, velocity=velocity, dt=DT)
    scene = ball_scene()
    tracker = pp.Tracker(arm(), limits=limits, scene=scene)
    lowest = np.inf
    tracker.update(pp.Target.from_configuration(arm(), q))
    for cycle in range(400):
        center = origin + cycle * DT * faster * flight
        dq = tracker.step(q, scene=scene.moved({"ball": center}, velocities={"ball": faster * flight}))
        assert np.abs(dq).max() <= velocity * DT + 1e-12
        q = tracker.command
        lowest = min(lowest, gap(q, center + DT * faster * flight))
    assert MARGIN <= lowest < BALL


def test_an_arm_without_a_measurement_does_not_move() -> None:
    scene = ball_scene()
    q = np.zeros(40)
    tracker = pp.Tracker(arm(), limits=LIMITS, scene=scene)
    tracker.update(pp.Target.from_configuration(arm(), q))
    for cycle in range(250):
        center = np.array([0.7 * arm().length, 0.5 - 0.2 * DT * cycle, 0.02])
        moment = scene.moved({"ball": center}, velocities={"ball": (0.0, -0.2, 0.0)})
        assert not np.any(tracker.step(None if cycle else q, scene=moment))
        assert tracker.report.status == ("holding" if cycle else "converged")
    assert gap(q, center) < 0.0 and tracker.report.reason == "no measurement"


@pytest.mark.long
def test_obstacles_move_on_between_the_pictures_of_a_slow_camera() -> None:
    q, goal, origin, velocity = crossing(0)
    paths = []
    for period in (1, 7):
        scene = ball_scene()
        tracker = pp.Tracker(arm(), limits=LIMITS, scene=scene)
        here = q
        path = []
        tracker.update(pp.Target.from_configuration(arm(), goal))
        for cycle in range(400):
            center = origin + cycle * DT * velocity
            seen = scene.moved({"ball": center}, velocities={"ball": velocity})
            here = here + tracker.step(here, scene=None if cycle % period else seen)
            path.append(here)
        paths.append(path)
    np.testing.assert_allclose(paths[1], paths[0], atol=1e-6)
    assert np.ptp(paths[0], axis=0).max() > 0.1


def test_obstacles_move_from_where_they_were_first() -> None:
    box = pp.Box((0.1, 0.0, 0.0), (0.2, 0.1, 0.1), (0.0, 0.0, 0.3))
    rod = pp.Capsule((0.0, 0.0, 0.0), (0.0, 0.2, 0.0), 0.02)
    floor = pp.HalfSpace((0.0, 0.0, -1.0), (0.0, 0.0, 1.0))
    scene = pp.Scene({"box": box, "rod": rod, "floor": floor}, self_collision=False)
    motion = pin.SE3(pin.rpy.rpyToMatrix(0.1, -0.4, 0.7), np.array([0.3, -0.2, 0.4]))
    once = scene.moved({"box": motion, "rod": motion, "floor": motion})
    twice = scene.moved({"box": (1.0, 1.0, 1.0), "rod": motion}).moved({"box": motion, "floor": motion})
    assert once == twice
    corner = np.array([0.1, 0.05, -0.05])
    moved = once.obstacles["box"]
    placed = motion.act(np.array(box.center) + np.array(box.rotation) @ corner)
    np.testing.assert_allclose(np.array(moved.center) + np.array(moved.rotation) @ corner, placed, atol=1e-12)
    np.testing.assert_allclose(once.obstacles["rod"].end, motion.act(np.array(rod.end)), atol=1e-12)
    np.testing.assert_allclose(once.obstacles["floor"].normal, motion.rotation[:, 2], atol=1e-12)
    assert scene.moved({}) == scene


@pytest.mark.parametrize("seed", cases(range(4), 2))
def test_distances_in_a_moved_scene_are_those_of_one_made_there(seed: int) -> None:
    rng = np.random.default_rng(seed)
    first = pp.Scene(
        {
            "box": pp.Box((0.0, 0.0, 0.0), (0.2, 0.1, 0.3)),
            "ball": pp.Sphere((0.0, 0.0, 0.0), 0.05),
            "can": pp.Cylinder((0.0, 0.0, -0.1), (0.0, 0.0, 0.1), 0.04),
            "post": pp.Cylinder((0.6, 0.5, -1.0), (0.6, 0.5, 1.0), 0.03),
        },
        self_collision=False,
        arm_radius=THIN,
    )
    motions = {
        name: pin.SE3(pin.rpy.rpyToMatrix(*rng.uniform(-3.0, 3.0, 3)), rng.uniform(0.2, 0.4, 3))
        for name in ("box", "ball", "can")
    }
    moved = {name: displaced(first.obstacles[name], motion) for name, motion in motions.items()}
    there = pp.Scene({**first.obstacles, **moved}, self_collision=False, arm_radius=THIN)
    q = pp.arm.smooth_configuration(arm(), rng, 0.4)
    one, other = (CollisionModel(arm(), scene) for scene in (first.moved(motions), there))
    near = [model.nearest(arm().at(q), 0.5) for model in (one, other)]
    first_found, second_found = (dict(zip(n.pairs, n.distances, strict=True)) for n in near)
    shared = first_found.keys() & second_found.keys()
    assert len(shared) > 10
    for pair in shared:
        assert first_found[pair] == pytest.approx(second_found[pair], abs=1e-9)


def test_a_scan_moves_without_being_prepared_again() -> None:
    rng = np.random.default_rng(1)
    cloud = pp.Scan(rng.normal(size=(500, 3)) * 0.05)
    first = pp.Scene({"scan": cloud}, self_collision=False, margin=MARGIN, arm_radius=THIN)
    motion = pin.SE3(pin.rpy.rpyToMatrix(0.3, -1.0, 2.0), np.array([0.5, 0.2, 0.1]))
    CollisionModel(arm(), first)
    moved = first.moved({"scan": motion})
    q = pp.arm.smooth_configuration(arm(), rng, 0.3)
    assert moved.obstacles["scan"].tree is cloud.tree
    centers = (motion.rotation @ np.asarray(cloud.points).T).T + motion.translation
    nearest = min(gap(q, center) for center in centers) + BALL
    assert CollisionModel(arm(), moved).minimum(q).distance == pytest.approx(nearest, abs=1e-6)


def test_an_obstacle_that_stood_beside_the_base_counts_everywhere() -> None:
    """Beside the base a pair may be one that no motion parts, and is left out; not if the obstacle moves."""
    scene = pp.Scene({"ball": pp.Sphere((0.02, 0.0, 0.03), 0.02)}, self_collision=False, arm_radius=THIN)
    q = np.zeros(40)
    moved = scene.moved({"ball": (0.5, 0.0, -0.03)})
    assert CollisionModel(arm(), moved).minimum(q).distance == pytest.approx(-0.03, abs=1e-6)


def test_rates_of_an_obstacle_that_turns_are_those_of_later_moments() -> None:
    h = 1e-5
    bar = pp.Capsule((0.2, 0.4, -0.3), (0.6, 0.4, 0.3), 0.03)
    wall = pp.HalfSpace((0.0, 0.0, -0.3), (0.0, 0.0, 1.0))
    scene = pp.Scene({"bar": bar, "wall": wall}, self_collision=False, arm_radius=THIN)
    q = pp.arm.smooth_configuration(arm(), np.random.default_rng(0), 0.8)
    twists = {"bar": (0.1, -0.2, 0.3, 0.5, 1.0, -0.7), "wall": (0.0, 0.0, 0.1, 0.4, -0.3, 0.0)}
    moving = scene.moved({}, velocities=twists)
    near = CollisionModel(arm(), moving).nearest(arm().at(q), 0.5)
    later = CollisionModel(arm(), moving.after(h)).nearest(arm().at(q), 1.0)
    ahead = dict(zip(later.pairs, later.distances, strict=True))
    assert len(near.pairs) > 10
    for pair, distance, rate in zip(near.pairs, near.distances, near.rates, strict=True):
        assert rate == pytest.approx((ahead[pair] - distance) / h, abs=1e-3)
    turned = moving.after(0.5).obstacles["bar"]
    turn = pin.exp3(0.5 * np.array(twists["bar"][3:]))
    axis = np.array(turned.end) - np.array(turned.start)
    np.testing.assert_allclose(axis, turn @ (np.array(bar.end) - np.array(bar.start)), atol=1e-12)
    np.testing.assert_allclose(turned.pose(np.zeros(3)).translation, [0.45, 0.3, 0.15], atol=1e-12)


@pytest.mark.long
def test_rates_and_distances_in_time_are_those_of_later_moments() -> None:
    rng = np.random.default_rng(0)
    h = 1e-5
    place = np.array([0.4, 0.3, 0.2])
    velocity = rng.normal(size=3)
    post = {"post": pp.Cylinder((0.6, 0.5, -1.0), (0.6, 0.5, 1.0), 0.03)}
    scene = pp.Scene({**ball_scene().obstacles, **post}, margin=MARGIN, arm_radius=THIN, self_collision=True)

    def model_at(time: float) -> CollisionModel:
        moment = scene.moved({"ball": place + time * velocity}, velocities={"ball": velocity})
        return CollisionModel(arm(), moment)

    q = pp.arm.smooth_configuration(arm(), rng, 0.8)
    near = model_at(0.0).nearest(arm().at(q), 0.5)
    later = [model_at(time).nearest(arm().at(q), 1.0) for time in (h, -h)]
    ahead, behind = (dict(zip(n.pairs, n.distances, strict=True)) for n in later)
    for pair, rate in zip(near.pairs, near.rates, strict=True):
        assert rate == pytest.approx((ahead[pair] - behind[pair]) / (2.0 * h), abs=1e-4)
    path = 0.1 * np.cumsum(rng.normal(size=(3, 40)), axis=0)
    times = np.array([0.0, 0.3, 1.0])
    lowest = np.inf
    for time in np.linspace(0.0, 1.0, 1000):
        dq = np.array([np.interp(time, times, joint) for joint in path.T])
        lowest = min(lowest, model_at(time).minimum(q + dq).distance)
    found = model_at(0.0).minimum_on_motions(q, path, times=times).distance
    assert found == pytest.approx(lowest, abs=1.2e-4)


def test_what_does_not_fit_is_named() -> None:
    scene = ball_scene()
    with pytest.raises(UnknownName, match="bal1"):
        scene.moved({"bal1": (0.0, 0.0, 0.0)})
    with pytest.raises(UnknownName, match="bal1"):
        scene.moved({"ball": (0.0, 0.0, 0.0)}, velocities={"bal1": (0.0, 0.0, 0.0)})
    with pytest.raises(InvalidValue, match="placements"):
        scene.moved({"ball": (0.0, np.nan, 0.0)})
    with pytest.raises(InvalidValue, match="velocities"):
        scene.moved({}, velocities={"ball": 0.2})
    with pytest.raises(InvalidValue, match=r"velocities.ball.*six"):
        scene.moved({}, velocities={"ball": (0.0, 0.0, 0.0, 1.0)})
    with pytest.raises(InvalidValue, match=r"velocities.ball"):
        scene.moved({}, velocities={"ball": (0.0, 0.0, 0.0, 0.0, np.nan, 1.0)})
    with pytest.raises(InvalidValue, match=r"velocities.ball"):
        scene.moved({}, velocities={"ball": (0.0, 0.0, 0.0, 0.0, 1e5, 1.0)})
    turning = pp.Scene.from_dict(
        {**scene.to_dict(), "velocities": {"ball": [0, "1 cm/s", 0, 0, 0, "30 deg/s"]}}
    )
    assert turning.velocities["ball"] == pytest.approx((0.0, 0.01, 0.0, 0.0, 0.0, np.pi / 6.0))
    assert pp.Scene.from_dict(turning.to_dict()) == turning
    moving = scene.moved({"ball": (0.1, 0.2, 0.3)}, velocities={"ball": (0.0, 0.1, 0.0)})
    assert pp.Scene.from_dict(moving.to_dict()) == moving


@pytest.mark.parametrize(
    ("modules", "speed", "jerk", "least"),
    [(10, 0.03, None, 0.0099), (10, 0.03, 100.0, 0.0095), (5, 0.1, None, 0.0099)],
)
def test_an_arm_at_rest_evades_an_obstacle_whose_velocity_nobody_tells(
    modules: int, speed: float, jerk: float | None, least: float
) -> None:
    arm = template_arm("RyRz", modules)
    ball = pp.Sphere((0.04 * modules, 0.0, -0.075), 0.05)
    scene = pp.Scene({"ball": ball}, margin=0.01, self_collision=False, arm_radius=0.01)
    limits = pp.Limits(step=None, dt=0.01, velocity=2.0, acceleration=10.0, jerk=jerk)
    tracker = pp.Tracker(arm, limits=limits, scene=scene)
    tracker.update(pp.Target.from_configuration(arm, arm.straight()))
    q = arm.straight()
    distances = []
    statuses = []
    for cycle in range(round(6.0 / speed)):
        moment = scene.moved({"ball": (0.0, 0.0, speed * 0.01 * cycle)})  # 60 mm, through the arm
        q = arm.integrate(q, tracker.step(q, scene=moment))
        distances.append(pp.CollisionModel(arm, moment).minimum(q).distance)
        statuses.append(tracker.report.status)
    assert statuses[0] == "converged"
    assert statuses[-1] in ("moving", "stalled")
    assert min(distances) > least


def approach(seed: int) -> tuple[pp.Arm, np.ndarray, np.ndarray, np.ndarray, float]:
    """A small arm at rest; place, velocity and radius of a ball that comes towards one of its points."""
    rng = np.random.default_rng(seed)
    small = template_arm("RyRz", int(rng.integers(4, 9)))
    q = rng.uniform(-0.3, 0.3, small.nv)
    aim = small.at(q).points[rng.integers(small.n_modules // 2, small.n_modules)]
    direction = rng.normal(size=3)
    direction /= np.linalg.norm(direction)
    velocity = rng.uniform(0.05, 0.5) * small.length * direction
    return small, q, aim - 0.25 * small.length * direction, velocity, 0.06 * small.length


def gap_of(small: pp.Arm, q: np.ndarray, center: np.ndarray, radius: float) -> float:
    """Distance of a ball from the lines between the joints and the tip of an arm, in closed form."""
    data = small.model.createData()
    pin.framesForwardKinematics(small.model, data, q)
    nodes = [data.oMi[joint].translation for joint in range(1, small.model.njoints)]
    nodes = np.array([*nodes, data.oMf[small.model.getFrameId(small.control_points[-1])].translation])
    ends = np.diff(nodes, axis=0)
    squares = np.maximum((ends**2).sum(axis=1), 1e-30)
    shares = np.clip(((center - nodes[:-1]) * ends).sum(axis=1) / squares, 0.0, 1.0)
    return float(np.linalg.norm(nodes[:-1] + shares[:, None] * ends - center, axis=1).min()) - radius


@pytest.mark.parametrize("noise, least", [(0.0, 0.02), (1e-3, 0.01)])
@pytest.mark.parametrize("seed", cases(range(25), 2))
def test_no_ball_whose_velocity_nobody_tells_touches_a_small_arm(
    seed: int, noise: float, least: float
) -> None:
    """The command starts and stops a few times, not in each cycle."""
    small, q, origin, velocity, radius = approach(seed)
    rng = np.random.default_rng(seed)
    margin = 0.02 * small.length
    scene = pp.Scene(
        {"ball": pp.Sphere(tuple(origin), radius)}, margin=margin, self_collision=False, arm_radius=margin
    )
    limits = pp.Limits(step=None, dt=DT, velocity=1.5, acceleration=5.0)
    tracker = pp.Tracker(small, limits=limits, scene=scene)
    tracker.update(pp.Target.from_configuration(small, q))
    lowest = np.inf
    moves = [False]
    for cycle in range(int(0.35 * small.length / np.linalg.norm(velocity) / DT)):
        moved = velocity * DT * cycle
        dq = tracker.step(q, scene=scene.moved({"ball": moved + noise * rng.normal(size=3)}))
        q = small.integrate(q, dq)
        lowest = min(lowest, gap_of(small, q, origin + moved, radius + margin))
        moves.append(bool(np.abs(dq).max() > 1e-9))
    assert lowest > (least - 1e-4) * small.length
    assert np.count_nonzero(np.diff(moves)) <= 7


@pytest.mark.long
@pytest.mark.parametrize("seed", cases(range(12), 2))
def test_an_arm_goes_to_its_goal_as_soon_as_a_ball_has_left_it(seed: int) -> None:
    """Until then it goes beside the ball; from there, reducing the errors took 2.6 to 4.2 s."""
    robot = template_arm("RyRz", 8)
    rng = np.random.default_rng(seed)
    start, goal = (pp.arm.smooth_configuration(robot, rng, 0.7) for _ in range(2))
    ball = robot.at(goal).points[-3]
    scene = pp.Scene({"ball": pp.Sphere((0, 0, 0), 0.08 * robot.length)}, self_collision=False)
    limits = pp.Limits(step=None, velocity=2.0, acceleration=10.0, dt=DT)
    tracker = pp.Tracker(robot, limits=limits, scene=scene.moved({"ball": ball}))
    tracker.update(pp.Target.from_configuration(robot, goal))
    q = start
    for cycle in range(410):
        here = ball if cycle < 150 else ball + [0.0, 0.0, 3.0]
        q = robot.integrate(q, tracker.step(q, scene=scene.moved({"ball": here})))
        if cycle == 149:
            assert np.abs(robot.difference(q, goal)).max() > 0.05
    np.testing.assert_allclose(q, goal, atol=1e-9)
