"""Velocities of obstacles from their poses: twists of rigid motions, noise, jumps, stops, slow cameras."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from arms import template_arm
from sampling import cases

import pinposture as pp
from pinposture import kernels
from pinposture.motion.obstacle_velocities import ObstacleVelocities

DT = 0.01
NOISE = 1e-3

Pose = np.ndarray | pin.SE3


def one_obstacle(obstacle: Any = None) -> pp.Scene:
    return pp.Scene({"thing": obstacle or pp.Sphere((0.0, 0.0, 0.0), 0.05)}, self_collision=False)


def told(
    pose: Callable[[int], Pose], cycles: int, scene: pp.Scene | None = None, noise: float = 0.0
) -> list[np.ndarray]:
    """The velocity of an obstacle in each cycle, zero if it has none, with noise of its positions [m]."""
    scene = scene or one_obstacle()
    rng = np.random.default_rng(0)
    taken = ObstacleVelocities(scene, 1.0)
    found = []
    for cycle in range(cycles):
        place = pose(cycle)
        if noise:
            place = place + noise * rng.normal(size=3)
        moment = taken.advance(scene.moved({"thing": place}), DT)
        assert moment is not None
        found.append(np.resize([*moment.velocities.get("thing", (0.0, 0.0, 0.0)), 0.0, 0.0, 0.0], 6))
    return found


@pytest.mark.parametrize(
    "obstacle",
    [
        pp.Sphere((0.1, 0.2, 0.3), 0.1),
        pp.Box((0.1, 0.2, 0.3), (0.1, 0.2, 0.3)),
        pp.Capsule((0.0, 0.0, 0.0), (0.1, 0.2, 0.3), 0.1),
        pp.HalfSpace((0.1, 0.2, 0.3), (0.0, 0.6, 0.8)),
    ],
    ids=lambda each: each.type,
)
@pytest.mark.parametrize("seed", cases(range(3), 1))
def test_points_of_an_obstacle_have_the_velocity_of_a_rigid_motion(obstacle: Any, seed: int) -> None:
    """In unequal cycles, and in closed form: along the normals of its surface."""
    rng = np.random.default_rng(seed)
    scene = one_obstacle(obstacle)
    linear = rng.normal(size=3)
    spin = 0.3 * rng.normal(size=3)
    taken = ObstacleVelocities(scene, 1.0)
    time = 0.0
    for _ in range(12):
        passed = DT * rng.uniform(0.02, 1.0)
        time += passed
        turn = pin.exp3(time * spin)
        moment = taken.advance(scene.moved({"thing": pin.SE3(turn, time * linear)}), passed)
    assert moment is not None
    velocity = np.resize([*moment.velocities["thing"], 0.0, 0.0, 0.0], 6)
    shape = moment.obstacles["thing"]
    place = shape.pose(np.zeros(3))
    points = {
        "sphere": [(place.translation, axis) for axis in np.eye(3)],
        "half_space": [
            (place.translation + side, np.array(getattr(shape, "normal", None)))
            for side in place.rotation.T[:2]
        ],
        "capsule": [
            (place.act(np.array([0.0, 0.0, z])), axis) for z in (-0.2, 0.2) for axis in place.rotation.T[:2]
        ],
    }.get(obstacle.type, [(place.act(0.1 * corner), axis) for corner in np.eye(3) for axis in np.eye(3)])
    for point, normal in points:
        moved = velocity[:3] + np.cross(velocity[3:], point - place.translation)
        expected = linear + np.cross(spin, point - time * linear)
        assert normal @ moved == pytest.approx(normal @ expected, abs=0.02)


def test_a_constant_velocity_is_known_from_the_third_pose_on() -> None:
    velocity = np.array([0.3, -0.2, 0.1])
    found = told(lambda cycle: velocity * DT * max(cycle - 5, 0), 12)
    assert not np.any(found[:7])
    np.testing.assert_allclose(found[7:], np.tile([*velocity, 0.0, 0.0, 0.0], (5, 1)), atol=1e-9)


def test_the_fit_is_that_of_least_squares() -> None:
    rng = np.random.default_rng(0)
    times = np.cumsum(rng.uniform(0.5, 1.5, 40)) * DT
    values = np.array([1.0, 2.0, 3.0]) * times[:, None] + NOISE * rng.normal(size=(40, 3))
    rate = np.zeros(3)
    assert kernels.fit_rate(times, values, 0.0, rate)
    np.testing.assert_allclose(rate, np.polyfit(times, values, 1)[0], atol=1e-9)


def test_an_obstacle_that_only_jitters_stands() -> None:
    assert not np.any(told(lambda _: np.zeros(3), 2000, noise=NOISE))


def test_jitter_of_a_rotation_is_none() -> None:
    rng = np.random.default_rng(0)
    box = one_obstacle(pp.Box((0.1, 0.2, 0.3), (0.1, 0.2, 0.3)))
    assert not np.any(told(lambda _: pin.SE3(pin.exp3(NOISE * rng.normal(size=3)), np.zeros(3)), 1000, box))


@pytest.mark.parametrize("speed", [0.03, 0.2])
def test_a_velocity_is_told_from_noise(speed: float) -> None:
    found = np.array(told(lambda cycle: np.array([0.0, speed * DT * cycle, 0.0]), 300, noise=NOISE))
    assert not np.any(found[:, 3:])
    assert np.all(found[30:, 1] > 0.0)
    np.testing.assert_allclose(found[60:, :3], np.tile([0.0, speed, 0.0], (240, 1)), atol=0.01)


@pytest.mark.parametrize("before", range(1, 12))
@pytest.mark.parametrize("noise", [0.0, NOISE])
def test_a_jump_is_no_velocity(noise: float, before: int) -> None:
    assert not np.any(told(lambda cycle: np.array([0.5 * (cycle >= before), 0.0, 0.0]), 60, noise=noise))


def test_a_moving_obstacle_that_jumps_keeps_its_velocity() -> None:
    found = told(lambda cycle: np.array([0.2 * DT * cycle, 0.5 * (cycle >= 20), 0.0]), 40)
    np.testing.assert_allclose(found[3:], np.tile([0.2, 0.0, 0.0, 0.0, 0.0, 0.0], (37, 1)), atol=1e-9)


def test_an_obstacle_that_is_somewhere_else_in_each_cycle_has_no_velocity() -> None:
    rng = np.random.default_rng(0)
    assert not np.any(told(lambda _: rng.uniform(-0.5, 0.5, 3), 500))


@pytest.mark.parametrize("noise, cycles", [(0.0, 3), (NOISE, 12)])
def test_an_obstacle_that_stops_is_seen_to_stand(noise: float, cycles: int) -> None:
    found = told(lambda cycle: np.array([0.3 * DT * min(cycle, 60), 0.0, 0.0]), 120, noise=noise)
    assert found[60][0] == pytest.approx(0.3, abs=0.01)
    assert not np.any(found[60 + cycles :])


def test_an_obstacle_that_accelerates_is_followed_closely() -> None:
    """As a hand that moves to and fro by 10 cm once a second."""
    found = told(lambda cycle: np.array([0.1 * np.sin(2.0 * np.pi * DT * cycle), 0.0, 0.0]), 200)
    true = 0.2 * np.pi * np.cos(2.0 * np.pi * DT * np.arange(200))
    assert np.abs(np.array(found)[5:, 0] - true[5:]).max() < 0.2
    assert np.median(np.abs(np.array(found)[5:, 0] - true[5:])) < 0.05


@pytest.mark.parametrize("repeated", [False, True])
def test_between_the_pictures_of_a_slow_camera_the_velocity_stays(repeated: bool) -> None:
    """Without a scene the obstacle moves on; when the camera ends, it stands where it was last seen."""
    scene = one_obstacle()
    taken = ObstacleVelocities(scene, 1.0)
    seen = scene
    for cycle in range(100):
        news = cycle % 7 == 0 and cycle < 50
        if news:
            seen = scene.moved({"thing": (0.2 * DT * cycle, 0.0, 0.0)})
        moment = taken.advance(seen if news or repeated else None, DT)
        assert moment is not None
        place = moment.obstacles["thing"].center[0]
        if 21 <= cycle < 56:
            assert moment.velocities["thing"] == pytest.approx((0.2, 0.0, 0.0), abs=1e-9)
            assert place == pytest.approx(0.2 * DT * (cycle - cycle % 7 if repeated else cycle), abs=1e-9)
    assert not moment.velocities and place == pytest.approx(0.2 * DT * 49)


@pytest.mark.parametrize("velocity", [(0.0, 0.0, 0.0), (0.0, 0.1, 0.0), (0.0, 0.0, 0.0, 0.0, 0.0, 1.0)])
def test_a_told_velocity_counts(velocity: tuple[float, ...]) -> None:
    scene = one_obstacle()
    tracker = pp.Tracker(template_arm("RyRz", 4), limits=pp.Limits(dt=DT), scene=scene)
    for cycle in range(10):
        moment = scene.moved({"thing": (0.2 * DT * cycle, 5.0, 0.0)}, velocities={"thing": velocity})
        tracker.step(np.zeros(8), scene=moment)
        assert tracker.scene is moment
    tracker.step(np.zeros(8))
    assert tracker.scene is not None and dict(tracker.scene.velocities) == {"thing": velocity}


def test_another_scene_begins_anew() -> None:
    scene = one_obstacle()
    taken = ObstacleVelocities(scene, 1.0)
    for cycle in range(5):
        taken.advance(scene.moved({"thing": (DT * cycle, 0.0, 0.0)}), DT)
    other = one_obstacle(pp.Sphere((0.0, 0.0, 0.0), 0.06)).moved({"thing": (0.1, 0.0, 0.0)})
    moment = taken.advance(other, DT)
    assert moment is other
