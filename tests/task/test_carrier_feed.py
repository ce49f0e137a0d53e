"""A robot as the feed of an arm: its flange goes straight, and its joints stand in for the slide."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from arm.describing import HERE, LINK, Y, Z, arm_text, limit
from sampling import seeds

import pinposture as pp
from pinposture.errors import InvalidValue, ReachError
from pinposture.task.carrier_feed import CarriedDrives, CarrierClearance

LINKS = (0.2, 0.3, 0.25, 0.05, 0.05, 0.04)


def robot(**options: object) -> pp.Arm:
    """Six joints as those of industrial robots, with x out of the flange."""
    joints = [
        pp.JointSpec(axis, lower=-3.0, upper=3.0, velocity=1.5) for axis in ("z", "y", "y", "x", "y", "x")
    ]
    return pp.Arm.from_modules([pp.ModuleTemplate("Robot", joints, list(LINKS))], **options)


BENT = np.array([0.3, -1.2, 1.9, 0.4, 0.7, 0.1])
AHEAD = (1.0, 0.0, 0.0)


def flange(arm: pp.Arm, q: np.ndarray) -> pin.SE3:
    data = arm.model.createData()
    pin.framesForwardKinematics(arm.model, data, q)
    return data.oMf[arm.model.getFrameId(arm.tip)].copy()


@pytest.mark.parametrize("direction", [AHEAD, (0.0, 0.0, -2.0), (0.3, -0.2, 0.9)])
def test_the_flange_goes_straight_and_does_not_turn(direction: tuple[float, ...]) -> None:
    arm = robot()
    feed = pp.CarrierFeed(arm, BENT, stroke=0.15, direction=direction)
    begin = flange(arm, BENT)
    ahead = begin.rotation @ np.array(direction) / np.linalg.norm(direction)
    np.testing.assert_allclose(feed.base_placement.translation, begin.translation, atol=1e-12)
    np.testing.assert_allclose(feed.base_placement.rotation[:, 0], ahead, atol=1e-12)
    at = np.linspace(0.0, 0.15, 50)
    for s, q in zip(at, feed.at(at), strict=True):
        there = flange(arm, q)
        np.testing.assert_allclose(there.translation, begin.translation + s * ahead, atol=1e-6)
        np.testing.assert_allclose(there.rotation, begin.rotation, atol=1e-6)
    np.testing.assert_allclose(feed.at(0.0), BENT, atol=1e-12)
    assert (np.diff(feed.s) > 0.0).all()


@pytest.mark.parametrize("seed", seeds(6))
def test_the_stroke_that_is_possible_is_that_of_steps_along_the_line(seed: int) -> None:
    """Euler's steps with midpoints go on until a joint is at its limit, or turns without end."""
    arm = robot()
    start = arm.random(np.random.default_rng(seed))
    data = arm.model.createData()
    ahead = flange(arm, start).rotation[:, 0]

    def rates(q: np.ndarray) -> np.ndarray:
        frame = arm.model.getFrameId(arm.tip)
        moves = pin.computeFrameJacobian(arm.model, data, q, frame, pin.LOCAL_WORLD_ALIGNED)
        return np.linalg.solve(moves, np.append(ahead, np.zeros(3)))

    reached = 0.0
    q = start
    step = 1e-4
    while reached < 0.3 and (np.abs(q) <= 3.0).all() and np.abs(rates(q)).max() * arm.length < 100.0:
        q = q + step * rates(q + 0.5 * step * rates(q))
        reached += step
    try:
        feed = pp.CarrierFeed(arm, start, 0.3, AHEAD)
    except ReachError as error:
        assert reached < 0.3
        told = float(str(error).split("straight for ")[1].split(" mm")[0])
        assert told == pytest.approx(1e3 * reached, abs=0.5)
        assert ("limit" in str(error)) == (np.abs(q) > 2.999).any()
    else:
        np.testing.assert_allclose(feed.at(0.3), q, atol=2e-2)


def test_a_planar_robot_bends_by_the_law_of_cosines() -> None:
    joints = [("revolute", Z, at, limit(-3.0, 3.0)) for at in (HERE, "0.4 0 0", "0.4 0 0")]
    arm = pp.Arm.load(arm_text(joints))
    start = np.array([-1.0, 2.0, -1.0])  # two links of 0.4 m, the last link straight ahead
    tool = arm.at(start).points[-1][0] - 0.8 * np.cos(1.0)
    feed = pp.CarrierFeed(arm, start, 0.35, AHEAD)
    at = np.linspace(0.0, 0.35, 30)
    half = np.arccos(np.cos(1.0) + at / 0.8)
    np.testing.assert_allclose(feed.at(at), np.column_stack([-half, 2.0 * half, -half]), atol=1e-6)
    stretched = 0.8 - 0.8 * np.cos(1.0)
    with pytest.raises(ReachError, match="stretched or singular") as caught:
        pp.CarrierFeed(arm, start, 0.5, AHEAD)
    told = float(str(caught.value).split("straight for ")[1].split(" mm")[0])
    assert told == pytest.approx(1e3 * stretched, rel=1e-2)
    assert caught.value.position == pytest.approx((0.8 * np.cos(1.0) + tool + 0.5, 0.0, 0.0), abs=1e-9)
    with pytest.raises(ReachError, match="lacks joints"):
        pp.CarrierFeed(arm, start, 0.1, (0.0, 0.0, 1.0))


def test_the_arm_on_its_slide_is_where_the_robot_carries_it() -> None:
    arm = robot(base_placement=pin.SE3(pin.rpy.rpyToMatrix(0.3, 0.2, -0.4), np.array([0.1, 0.2, 0.3])))
    feed = pp.CarrierFeed(arm, BENT, 0.15, direction=(0.0, 0.6, 0.8))
    slide = pp.ModuleTemplate("Feed", joints=(feed.joint,), link_lengths=(0.05,))
    fed = pp.Arm.from_modules([slide, *[pp.template("RyRz")] * 4], base_placement=feed.base_placement)
    bent = np.linspace(-0.3, 0.5, fed.nq)
    bent[0] = 0.0
    at_base = flange(arm, feed.at(0.0)).actInv(flange(fed, bent))
    bent[0] = 0.11
    carried = flange(arm, feed.at(0.11)) * at_base
    np.testing.assert_allclose(flange(fed, bent).homogeneous, carried.homogeneous, atol=1e-6)


def test_a_motion_is_sent_to_the_joints_of_the_robot_in_place_of_the_feed() -> None:
    arm = robot()
    feed = pp.CarrierFeed(arm, BENT, 0.15, AHEAD)
    slide = pp.ModuleTemplate("Feed", joints=(feed.joint,), link_lengths=(0.05,))
    fed = pp.Arm.from_modules([slide, *[pp.template("RyRz")] * 4], base_placement=feed.base_placement)
    time = np.linspace(0.0, 3.0, 301)
    s = 0.07 * (1.0 - np.cos(np.pi * time / 3.0))
    rest = np.linspace(-0.2, 0.3, fed.nv - 1)[None] * s[:, None]
    motion = pp.JointTrajectory.from_positions(
        [f"arm_{name}" for name in fed.joint_names], np.column_stack([s, rest]), time, ["m"] + 8 * ["rad"]
    )
    sent = feed.joint_trajectory(motion)
    assert sent.joint_names == (*arm.joint_names, *motion.joint_names[1:])
    assert sent.units == ("rad",) * 14
    np.testing.assert_array_equal(sent.time, time)
    for name in ("positions", "velocities", "accelerations"):
        np.testing.assert_array_equal(getattr(sent, name)[:, 6:], getattr(motion, name)[:, 1:])
    np.testing.assert_allclose(sent.positions[:, :6], feed.at(motion.positions[:, 0]), atol=1e-12)
    positions = sent.positions[:, :6]
    for rates, of in ((sent.velocities, positions), (sent.accelerations, sent.velocities[:, :6])):
        central = np.gradient(of, time, axis=0)[5:-5]
        np.testing.assert_allclose(rates[5:-5, :6], central, atol=2e-3 * np.abs(central).max())
    with pytest.raises(InvalidValue, match="the feed, a slide"):
        feed.joint_trajectory(sent)
    with pytest.raises(InvalidValue, match="joint"):  # the names are those of the robot
        names = ("slide", arm.joint_names[2])
        feed.joint_trajectory(pp.JointTrajectory.from_positions(names, np.zeros((3, 2)), 0.1, ("m", "rad")))


def test_at_its_largest_speed_the_robot_just_keeps_its_velocity_limits() -> None:
    arm = robot()
    feed = pp.CarrierFeed(arm, BENT, 0.15, AHEAD)
    at = np.linspace(0.0, 0.15, 3001)
    rates = np.abs(np.diff(feed.at(at), axis=0)) / at[1]
    assert feed.max_speed * rates.max() == pytest.approx(1.5, rel=1e-3)
    assert feed.joint.velocity == feed.max_speed
    assert (feed.joint.lower, feed.joint.upper) == (0.0, 0.15)


def test_a_robot_that_comes_too_close_to_an_obstacle_is_refused() -> None:
    arm = robot()
    above = arm.at(BENT).points[-1]
    far = pp.Scene({"ball": pp.Sphere((-1.0, 0.0, 0.0), 0.1)}, margin=0.01)
    pp.CarrierFeed(arm, BENT, 0.15, AHEAD, scene=far)
    ahead = above + 0.2 * flange(arm, BENT).rotation[:, 0]
    near = pp.Scene({"ball": pp.Sphere(tuple(ahead), 0.08)}, margin=0.01)
    with pytest.raises(ReachError, match="ball"):
        pp.CarrierFeed(arm, BENT, 0.15, AHEAD, scene=near)


def test_a_robot_that_is_stretched_at_first_is_refused() -> None:
    arm = robot()
    with pytest.raises(ReachError, match=r"straight for .* of 100 mm, where the robot is stretched"):
        pp.CarrierFeed(arm, arm.straight(), 0.1, (-1.0, 0.0, 0.0))


def test_robots_of_seven_endless_joints_feed_as_well() -> None:
    kinds = [("continuous", axis, LINK, limit()) for axis in (Z, Y, Z, Y, Z, Y, Z)]
    arm = pp.Arm.load(arm_text(kinds))
    start = arm.configuration([3.0, 1.0, 0.3, -1.2, 0.4, 0.8, 3.1])
    feed = pp.CarrierFeed(arm, start, 0.05)
    begin = flange(arm, start)
    end = flange(arm, feed.at(0.05))
    np.testing.assert_allclose(begin.actInv(end).homogeneous[:3, 3], (0.0, 0.0, 0.05), atol=1e-6)
    np.testing.assert_allclose(end.rotation, begin.rotation, atol=1e-6)


def test_positions_beyond_the_stroke_are_refused() -> None:
    feed = pp.CarrierFeed(robot(), BENT, 0.15, AHEAD)
    for s in (-0.01, 0.16, [0.0, 0.2], np.nan, "far", np.zeros((2, 2))):
        with pytest.raises(InvalidValue):
            feed.at(s)
    for stroke in (0.0, -1.0, np.inf, np.nan, None):
        with pytest.raises(InvalidValue):
            pp.CarrierFeed(robot(), BENT, stroke, AHEAD)
    with pytest.raises(InvalidValue):
        pp.CarrierFeed(robot(), BENT, 0.1, (0.0, 0.0, 0.0))


def carried(feed: pp.CarrierFeed) -> pp.Arm:
    slide = pp.ModuleTemplate("Feed", joints=(feed.joint,), link_lengths=(0.05,))
    modules = [slide, *[pp.template("RyRz")] * 8]
    return pp.Arm.from_modules(modules, base_placement=feed.base_placement)


def test_the_drives_of_a_robot_stand_for_the_feed_and_tell_where_it_is() -> None:
    feed = pp.CarrierFeed(robot(), BENT, 0.15, AHEAD)
    arm = carried(feed)
    drives = CarriedDrives(feed, arm)
    for s in (0.0, 0.04, 0.15):
        sent = np.linspace(0.0, 0.3, arm.nv)
        sent[0] = s
        commands = drives.commands(sent)
        np.testing.assert_allclose(commands[:6], feed.at(s), atol=1e-12)
        measured = drives.measured(dict(zip(drives.names, commands, strict=True)))
        np.testing.assert_allclose([measured[name] for name in arm.drives.names], sent, atol=1e-9)
        off = commands + 0.01 * np.eye(len(commands))[1]
        there = drives.measured(dict(zip(drives.names, off, strict=True)))[arm.joint_names[0]]
        squares = [np.sum((feed.at(at) - off[:6]) ** 2) for at in np.linspace(0.0, 0.15, 2001)]
        assert there == pytest.approx(0.15 * int(np.argmin(squares)) / 2000, abs=1e-4)
    commands[2] += 0.1
    with pytest.raises(InvalidValue, match=r"on the way of the feed; it is 0\.0\d+ rad off|0\.1 rad off"):
        drives.measured(dict(zip(drives.names, commands, strict=True)))


@pytest.mark.parametrize("seed", seeds(4))
def test_rows_of_the_clearance_of_a_robot_are_derivatives(seed: int) -> None:
    feed = pp.CarrierFeed(robot(), BENT, 0.15, AHEAD)
    arm = carried(feed)
    clearance = CarrierClearance(feed, arm)
    rng = np.random.default_rng(seed)
    h = 1e-6
    for _ in range(400):
        q = rng.normal(0.0, 0.2, arm.nv)
        q[1 + seed % 2 :: 2] += rng.uniform(0.5, 0.9)
        q[0] = rng.uniform(0.01, 0.14)
        if 0.004 < clearance.closest(q).distance < 0.03:
            break
    matrix, lower, upper = clearance.rows(arm.at(q))
    worst = int(lower.argmax())
    assert clearance.margin - lower[worst] == pytest.approx(clearance.closest(q).distance, abs=1e-9)
    assert np.all(np.isinf(upper))
    slopes = [
        (clearance.closest(q + h * d).distance - clearance.closest(q - h * d).distance) / (2.0 * h)
        for d in np.eye(arm.nv)
    ]
    np.testing.assert_allclose(matrix[worst], slopes, atol=2e-4)
    assert "of the robot" in str(clearance.closest(q).pair)


def elbow(feed: pp.CarrierFeed, s: float) -> np.ndarray:
    data = feed.carrier.model.createData()
    pin.forwardKinematics(feed.carrier.model, data, feed.at(s))
    return data.oMi[4].translation.copy()


@pytest.mark.parametrize("seed", seeds(4))
def test_a_robot_keeps_clear_of_obstacles_as_well(seed: int) -> None:
    feed = pp.CarrierFeed(robot(), BENT, 0.15, AHEAD)
    arm = carried(feed)
    s = float(np.random.default_rng(seed).uniform(0.02, 0.13))
    there = elbow(feed, s) + np.array([0.02, 0.02, 0.06])
    scene = pp.Scene({"ball": pp.Sphere(tuple(there), 0.03)}, self_collision=False)
    model = pp.CollisionModel(feed.carrier, scene)
    clearance = CarrierClearance(feed, arm, 0.02, scene)
    q = arm.straight()
    q[0] = s
    nearest = model.minimum(feed.at(s))
    assert clearance.closest(q) == (nearest.distance, (f"{nearest.pair[0]} of the robot", "ball"))
    matrix, lower, _ = clearance.rows(arm.at(q))
    worst = int(lower.argmax())
    assert clearance.margin - lower[worst] == pytest.approx(nearest.distance, abs=1e-9)
    assert not matrix[worst, 1:].any()
    h = 1e-6
    slope = (model.minimum(feed.at(s + h)).distance - model.minimum(feed.at(s - h)).distance) / (2.0 * h)
    assert matrix[worst, 0] == pytest.approx(slope, abs=2e-4)
    clearance.scene = None
    assert clearance.closest(q).distance > nearest.distance


@pytest.mark.parametrize("scene", [None, pp.Scene({"ball": pp.Sphere((0.35, 0.1, 0.5), 0.06)})])
def test_violations_at_many_states_are_those_of_the_rows_there(scene: pp.Scene | None) -> None:
    feed = pp.CarrierFeed(robot(), BENT, 0.15, AHEAD)
    arm = carried(feed)
    clearance = CarrierClearance(feed, arm, 0.02, scene)
    rng = np.random.default_rng(0)
    start = arm.at(arm.straight())
    offsets = rng.normal(0.0, 0.2, (200, arm.nv))
    offsets[:, 2::2] += rng.uniform(0.3, 0.9, (200, 1))
    offsets[:, 0] = rng.uniform(0.0, 0.15, 200)
    violations = clearance.violations(start, offsets)
    at_each = [clearance.rows(arm.at(arm.integrate(start.q, offset)))[1].max() for offset in offsets]
    np.testing.assert_allclose(violations, np.maximum(at_each, 0.0), atol=1e-9)
    assert 10 < np.count_nonzero(violations) < 190
    kept = offsets[violations == 0.0]
    np.testing.assert_array_equal(clearance.violations(start, kept), 0.0)


def test_an_arm_elsewhere_is_not_carried() -> None:
    feed = pp.CarrierFeed(robot(), BENT, 0.15, AHEAD)
    slide = pp.ModuleTemplate("Feed", joints=(feed.joint,), link_lengths=(0.05,))
    with pytest.raises(InvalidValue, match="at the flange"):
        CarriedDrives(feed, pp.Arm.from_modules([slide, pp.template("RyRz")]))
    with pytest.raises(InvalidValue, match="a slide, the feed"):
        CarrierClearance(feed, pp.Arm.from_template("RyRz", 3, base_placement=feed.base_placement))
    longer = pp.ModuleTemplate("Feed", (pp.JointSpec("x", type="prismatic", lower=0.0, upper=0.3),), (0.05,))
    with pytest.raises(InvalidValue, match="the stroke"):
        CarriedDrives(feed, pp.Arm.from_modules([longer], base_placement=feed.base_placement))


def test_the_feed_is_no_faster_than_its_robot() -> None:
    feed = pp.CarrierFeed(robot(), BENT, 0.15, AHEAD)
    arm = carried(feed)
    limits = feed.limits(arm, pp.Limits(dt=0.01, velocity=9.0))
    np.testing.assert_allclose(limits.velocity, [feed.max_speed] + [9.0] * (arm.nv - 1))
