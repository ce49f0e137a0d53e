"""Steering: paths against integration, postures against `follow_leader`, limits, obstacles, refusals."""

from __future__ import annotations

import itertools
from functools import cache

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sampling import examples
from scipy.integrate import solve_ivp

import pinposture as pp
from pinposture.arm import JointSpec, ModuleTemplate
from pinposture.errors import InvalidValue, PostureError
from pinposture.task import path_deviation
from pinposture.task.steering import STEERING, LaidPath

DT = 0.05
LIMITS = pp.Limits(dt=DT)
SPEED = 0.1


@cache
def fed(bend: float = 1.5, modules: int = 8, turn: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> pp.Arm:
    slide = ModuleTemplate("Feed", (JointSpec("x", "prismatic", 0.0, 0.6, velocity=0.2),), (0.03,))
    joints = tuple(JointSpec(axis, lower=-bend, upper=bend, velocity=2.0) for axis in ("y", "z"))
    crossed = ModuleTemplate("m", joints, (0.025, 0.025))
    placed = pin.SE3(pin.rpy.rpyToMatrix(*turn), np.zeros(3))
    return pp.Arm.from_modules([slide, *[crossed] * modules], base_placement=placed)


def driven(steering: pp.Steering, *orders: tuple[float, float, float], cycles: int = 20) -> list[np.ndarray]:
    """Steer with a speed [m/s] and a curvature [1/m] after the other; return the configurations."""
    rows = [steering.q]
    for speed, left, up in orders:
        for _ in range(cycles):
            steering.step(speed, (left, up))
            rows.append(steering.q)
    return rows


curvatures = st.tuples(st.floats(-6.0, 6.0), st.floats(-6.0, 6.0))


@examples(15)
@given(st.lists(st.tuples(st.floats(0.01, 0.3), curvatures), min_size=1, max_size=4))
def test_a_laid_path_is_the_integral_of_its_curvatures(pieces: list[tuple[float, tuple[float, float]]]):
    path = LaidPath(np.zeros(3), np.eye(3), 0.1, 0.2)
    for length, curvature in pieces:
        path = path.extended(path.end, length, np.array(curvature))
    begins = np.cumsum([0.1, *(length for length, _ in pieces)])

    def slope(s: float, state: np.ndarray) -> np.ndarray:
        frame = state[3:].reshape(3, 3)  # rows: ahead, left, up
        inside = 0.1 <= s < begins[-1]
        left, up = pieces[int(np.searchsorted(begins, s, side="right")) - 1][1] if inside else (0.0, 0.0)
        turn = [left * frame[1] + up * frame[2], -left * frame[0], -up * frame[0]]
        return np.concatenate([frame[0], *turn])

    state = np.concatenate([np.zeros(3), np.eye(3).ravel()])
    ends = [0.0, *begins, begins[-1] + 0.1]
    for begin, end in itertools.pairwise(ends):
        inner = np.nextafter(end, begin)
        state = solve_ivp(slope, (begin, inner), state, rtol=1e-10, atol=1e-12).y[:, -1]
        np.testing.assert_allclose(path.at([end])[0], state[:3], atol=1e-8)
        np.testing.assert_allclose(path.tangent([end])[0], state[3:6], atol=1e-8)
    assert path.length == pytest.approx(begins[-1] + 0.2)


def test_what_is_laid_anew_replaces_what_was_ahead_and_equal_arcs_are_one():
    path = LaidPath(np.zeros(3), np.eye(3), 0.1, 0.2).extended(0.1, 0.2, np.array([2.0, 0.0]))
    for at in (0.15, 0.2, 0.25):
        same = path.extended(at, 0.3 - at, np.array([2.0, 0.0]))
        np.testing.assert_allclose(same.at([0.05, 0.22, 0.3]), path.at([0.05, 0.22, 0.3]), atol=1e-15)
        assert len(same._arcs.begins) == 3
    other = path.extended(0.2, 0.1, np.array([0.0, 3.0]))
    np.testing.assert_array_equal(other.at([0.05, 0.2]), path.at([0.05, 0.2]))
    assert other.at([0.3])[0, 2] > 0.01 and path.at([0.3])[0, 2] == 0.0
    beyond = path.extended(0.4, 0.1, np.array([2.0, 0.0]))
    np.testing.assert_allclose(beyond.tangent([0.31, 0.39]), np.tile(path.tangent([0.3]), (2, 1)), atol=1e-12)


@pytest.mark.parametrize("turn", [0.0, np.pi / 2])
def test_the_tip_goes_left_and_up_as_seen_from_the_base(turn):
    arm = fed(turn=(0.0, 0.0, turn))
    back = pin.utils.rotate("z", -turn)
    for order, across in (((SPEED, 3.0, 0.0), [0.0, 1.0, 0.0]), ((SPEED, 0.0, 3.0), [0.0, 0.0, 1.0])):
        steering = pp.Steering(arm, LIMITS)
        begin = arm.at(steering.q).points[-1]
        driven(steering, order, order)
        moved = back @ (arm.at(steering.q).points[-1] - begin)
        assert moved @ across > 0.03
        assert abs(moved @ np.cross(across, [1.0, 0.0, 0.0])) < 1e-3
        np.testing.assert_allclose(steering.frame.T @ steering.frame, np.eye(3), atol=1e-12)


def test_an_arm_that_hangs_turns_left_by_the_world():
    arm = fed(turn=(0.0, np.pi / 2, 0.0))
    steering = pp.Steering(arm, LIMITS)
    driven(steering, (SPEED, 0.0, 3.0), (SPEED, 0.0, 3.0))
    assert arm.at(steering.q).points[-1][0] > 0.03  # "up" is along x of the world


def test_postures_are_those_of_a_leader_on_the_path_that_was_laid():
    arm = fed()
    steering = pp.Steering(arm, LIMITS)
    rows = driven(steering, (SPEED, 0.0, 0.0), (SPEED, 4.0, 0.0), (SPEED, -1.0, 3.0))
    assert steering.reason == ""
    path = steering.path
    led = pp.follow_leader(arm, path, 0.02, SPEED, placement="as_is", depth=steering.depth)
    np.testing.assert_allclose(led.configuration(led.rows - 1), steering.q, atol=2e-4)
    assert path_deviation(arm, rows, path, placement="as_is").percent < 1.0


def test_it_withdraws_by_the_postures_by_which_it_came_and_goes_there_again():
    steering = pp.Steering(fed(), LIMITS)
    rows = driven(steering, (SPEED, 0.0, 0.0), (SPEED, 4.0, 0.0), (SPEED, -1.0, 3.0))
    inside = steering.depth
    back = driven(steering, *[(-SPEED, 0.0, 0.0)] * 3)
    np.testing.assert_allclose(back, rows[::-1], atol=1e-6)
    steering.step(-SPEED)
    assert steering.reason == "stands: the arm is back at the entry"
    for _ in range(60):
        steering.step(SPEED)
    assert steering.depth == pytest.approx(inside)
    np.testing.assert_allclose(steering.q, rows[-1], atol=1e-6)


@pytest.mark.long
@examples(20)
@given(st.lists(st.tuples(st.floats(-0.5, 0.5), st.floats(-40.0, 40.0), st.floats(-40.0, 40.0)), max_size=4))
def test_whatever_is_asked_for_limits_are_kept_and_a_stand_is_explained(orders):
    arm = fed(bend=0.5)
    steering = pp.Steering(arm, LIMITS)
    fastest = STEERING.speed_share * LIMITS.for_arm(arm).bound
    for speed, left, up in orders:
        for _ in range(6):
            before = steering.depth
            at = steering.q
            target = steering.step(speed, (left, up))
            assert arm.within_limits(steering.q)
            assert np.all(np.abs(arm.difference(at, steering.q)) <= (1.0 + 1e-9) * fastest)
            np.testing.assert_allclose(target.velocity * DT, arm.difference(at, steering.q), atol=1e-12)
            moved = steering.depth - before
            assert moved * speed >= 0.0 and abs(moved) <= abs(speed) * DT * (1.0 + 1e-9) + 1e-15
            assert steering.reason or moved == pytest.approx(speed * DT)


def test_it_bends_as_far_as_joints_allow_and_says_so():
    steering = pp.Steering(fed(bend=0.3), LIMITS)
    told = set()
    for _ in range(90):
        steering.step(SPEED, (20.0, 0.0))
        told.add(steering.reason.split(":")[0])
    assert "bends less" in told
    points = steering.arm.at(steering.q).points
    assert steering.depth > 0.3 and points[-1, 1] > 0.05
    assert path_deviation(steering.arm, [steering.q], steering.path, placement="as_is").percent < 5.0


def test_what_was_refused_is_hardly_tried_again(monkeypatch):
    tried = []
    move = pp.Steering._move_on_arc
    monkeypatch.setattr(
        pp.Steering, "_move_on_arc", lambda *given: (tried.append(given[2][0]), move(*given))[1]
    )
    wall = pp.Scene({"wall": pp.Box((0.66, 0.0, 0.0), (0.1, 1.0, 1.0))}, margin=0.01, self_collision=False)
    steering = pp.Steering(fed(), LIMITS, wall)
    counts = []
    for curvature in [1.0] * 60 + [-1.0]:
        tried.clear()
        steering.step(SPEED, (curvature, 0.0))
        counts.append(len(tried))
    assert steering.reason.startswith("stands: ")
    assert counts[-1] == 5  # another direction
    assert counts[0] == 1 and counts[-2] == 2
    steering.scene = None
    shares = []
    for _ in range(5):
        tried.clear()
        steering.step(SPEED, (-1.0, 0.0))
        shares.append(-tried[-1])
    np.testing.assert_allclose(shares, [0.25, 0.5, 0.75, 1.0, 1.0])
    assert steering.reason == ""


def test_a_wall_stops_it_and_it_may_turn_away_or_withdraw():
    wall = pp.Scene({"wall": pp.Box((0.66, 0.0, 0.0), (0.1, 1.0, 1.0))}, margin=0.01, self_collision=False)
    arm = fed()
    model = pp.CollisionModel(arm, wall)
    steering = pp.Steering(arm, LIMITS, wall)
    rows = driven(steering, *[(SPEED, 0.0, 0.0)] * 3)
    assert steering.reason.startswith("stands: ") and "to wall" in steering.reason
    assert "less than 1 cm" in steering.reason or "less than 10 mm" in steering.reason
    assert model.minimum(steering.q).distance < 0.01 + SPEED * DT
    for _ in range(40):
        steering.step(-SPEED)
        rows.append(steering.q)
    rows += driven(steering, (SPEED, 12.0, 0.0), (SPEED, 12.0, 0.0), (SPEED, 0.0, 0.0))
    assert arm.at(steering.q).points[-1, 1] > 0.05
    assert min(model.minimum(q).distance for q in rows) >= 0.01


def test_an_arm_that_is_too_close_may_only_move_away():
    arm = fed()
    steering = pp.Steering(arm, LIMITS)
    driven(steering, (SPEED, 0.0, 0.0))
    tip = arm.at(steering.q).points[-1]
    ball = pp.Sphere(tuple(tip + [0.03, 0.0, 0.0]), 0.02)
    steering.scene = pp.Scene({"ball": ball}, margin=0.02, self_collision=False)
    at = steering.depth
    steering.step(SPEED)
    assert steering.depth == at and "ball" in steering.reason
    steering.step(-SPEED)
    assert steering.depth < at and steering.reason == ""


def test_it_stops_at_the_end_of_the_feed_and_where_the_first_joint_would_leave_the_path():
    steering = pp.Steering(fed(), LIMITS)
    while not steering.reason:
        steering.step(SPEED)
    assert steering.reason.endswith("the feed is at the end of its travel, 600 mm")
    assert steering.depth == pytest.approx(0.6)
    short = pp.Steering(fed(modules=3), LIMITS)
    driven(short, (SPEED, 4.0, 0.0), cycles=60)
    assert "moves straight" in short.reason
    assert short.depth < 0.2


def test_a_tracker_follows_it():
    arm = fed()
    limits = pp.Limits(dt=DT, acceleration=20.0)
    steering = pp.Steering(arm, limits)
    tracker = pp.Tracker(arm, limits=limits)
    rows = [steering.q]
    for cycle in range(70):
        target = steering.step(SPEED, (4.0, 2.0)) if cycle < 60 else steering.step(0.0)
        tracker.update(target)
        rows.append(arm.integrate(rows[-1], tracker.step(rows[-1])))
    np.testing.assert_allclose(rows[-1], steering.q, atol=1e-6)
    assert path_deviation(arm, rows, steering.path, placement="as_is").percent < 1.0


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: pp.Steering(pp.Arm.from_template("RyRz", 3), LIMITS), "prismatic"),
        (lambda: pp.Steering(fed(), pp.Limits()), "dt"),
        (lambda: pp.Steering(fed(), LIMITS, scene="cave"), "scene"),
        (lambda: pp.Steering(fed(), LIMITS, start=np.full(17, 0.1)), "straight arm"),
        (lambda: pp.Steering(fed(), LIMITS).step(np.nan), "speed"),
        (lambda: pp.Steering(fed(), LIMITS).step("fast"), "speed"),
        (lambda: pp.Steering(fed(), LIMITS).step(0.1, (1.0,)), "curvature"),
        (lambda: pp.Steering(fed(), LIMITS).step(0.1, (np.inf, 0.0)), "curvature"),
    ],
)
def test_what_cannot_be_steered_is_refused(make, words):
    with pytest.raises(InvalidValue, match=words):
        make()


def test_a_path_that_was_not_laid_is_none():
    with pytest.raises(PostureError):
        _ = pp.Steering(fed(), LIMITS).path


@pytest.mark.long
@pytest.mark.parametrize("way", ["end of the feed", "wall", "entry"])
def test_it_slows_down_so_that_the_feed_can_stop(way: str):
    arm = fed()
    most = 0.2  # [m/s^2]
    limits = pp.Limits(dt=0.02, acceleration=most)
    wall = pp.Box((arm.length + 0.2, 0.0, 0.0), (0.02, 1.0, 1.0))
    scene = pp.Scene({"wall": wall} if way == "wall" else {}, margin=0.01)
    steering = pp.Steering(arm, limits, scene)
    depths = [0.0]
    speed = 0.0
    for cycle in range(1000):
        back = way == "entry" and cycle > 100
        speed = min(speed + 0.002, 0.15) if not back else max(speed - 0.002, -0.15)
        steering.step(speed)
        depths.append(steering.depth)
    changes = np.diff(depths, 2) / limits.dt**2
    assert np.abs(changes).max() <= most * 1.01
    assert steering.reason.startswith("stands")
    if way == "end of the feed":
        assert depths[-1] == pytest.approx(0.6)
    elif way == "entry":
        assert depths[-1] == pytest.approx(0.0, abs=1e-12)
    else:
        assert pp.CollisionModel(arm, scene).minimum(steering.q).distance == pytest.approx(0.01, abs=1e-3)
