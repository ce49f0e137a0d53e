"""Sensors on links measure what the motion says: closed forms of a pendulum that turns evenly."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

import pinposture as pp
from pinposture.sim import LinkSensing, LinkSensors

EXACT = {"imu_noise": 0.0, "tip_noise": 0.0, "tip_turn_noise": 0.0}
DT = 1e-3


@pytest.fixture(scope="module")
def arm() -> pp.Arm:
    return pp.Arm.from_template("RyRz", modules=3)


def test_at_rest_the_acceleration_points_up_and_nothing_turns(arm: pp.Arm) -> None:
    sensors = LinkSensors(arm, LinkSensing(imus=1, **EXACT), DT)
    q = np.array([0.3, -0.2, 0.5, 0.1, -0.4, 0.2])
    sensors.move(q)
    first = sensors.read_inertial()
    sensors.move(q)
    sensors.move(q)
    assert sensors.links == ("m01_l2", "m02_l2", "tip")
    for before, reading in zip(first, sensors.read_inertial(), strict=True):
        np.testing.assert_allclose(reading.rotation @ reading.acceleration, [0.0, 0.0, 9.81], atol=1e-9)
        np.testing.assert_allclose(before.acceleration, reading.acceleration, atol=1e-12)
        np.testing.assert_allclose(reading.velocity, 0.0, atol=1e-9)
    data = arm.model.createData()
    pin.framesForwardKinematics(arm.model, data, q)
    expected = data.oMf[arm.model.getFrameId("m02_l2", pin.FrameType.BODY)].rotation
    np.testing.assert_allclose(sensors.read_inertial()[1].rotation, expected, atol=1e-12)


def test_an_arm_that_turns_evenly_about_its_base_feels_the_centripetal_acceleration(arm: pp.Arm) -> None:
    sensors = LinkSensors(arm, LinkSensing(imus=2, **EXACT), DT)
    assert sensors.links == ("m01_l2", "tip")
    speed = 2.0
    turns = arm.joint_names.index("m01_j2_z")
    for k in range(3):
        q = np.zeros(arm.nq)
        q[turns] = speed * DT * k
        sensors.move(q)
    data = arm.model.createData()
    pin.framesForwardKinematics(arm.model, data, 0.0 * q)
    joint = data.oMi[turns + 1].translation
    radius = np.linalg.norm(arm.at(0.0 * q).points[-1] - joint)
    tip = sensors.read_inertial()[-1]
    np.testing.assert_allclose(tip.velocity, [0.0, 0.0, speed], atol=1e-9)
    np.testing.assert_allclose(tip.acceleration, [-(speed**2) * radius, 0.0, 9.81], atol=1e-2)


def test_noise_is_as_large_as_said(arm: pp.Arm) -> None:
    sensing = LinkSensing(imus=1, imu_noise=0.02, tip_pose=True, tip_noise=0.003, tip_turn_noise=0.01)
    sensors = LinkSensors(arm, sensing, DT)
    q = np.zeros(arm.nq)
    for _ in range(3):
        sensors.move(q)
    state = arm.at(q)
    turns, accelerations, places, tip_turns = [], [], [], []
    for _ in range(400):
        for reading in sensors.read_inertial():
            turns.append(pin.log3(reading.rotation))
            accelerations.append(reading.acceleration - [0.0, 0.0, 9.81])
        tip = sensors.read_tip()
        assert tip is not None
        places.append(tip.translation - state.points[-1])
        tip_turns.append(pin.log3(state.rotations[-1].T @ tip.rotation))
    for rows, expected in ((turns, 0.02), (accelerations, 0.02 * 9.81), (places, 0.003), (tip_turns, 0.01)):
        assert np.std(rows) == pytest.approx(expected, rel=0.1)
        assert abs(np.mean(rows)) < 0.2 * expected


def test_without_sensors_there_are_no_readings(arm: pp.Arm) -> None:
    sensors = LinkSensors(arm, LinkSensing(), DT)
    sensors.move(np.zeros(arm.nq))
    assert sensors.read_inertial() == []
    assert sensors.read_tip() is None
