"""Torques of motions: against the power that changes the energy of the arm, and closed forms."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pinocchio as pin
import pytest
from arms import template_arm

import pinposture as pp
from pinposture.errors import InvalidValue, WeightUnknown

SLIDE = """<robot name="lift">
  <link name="base"/>
  <link name="cabin"><inertial><mass value="2.5"/><origin xyz="0 0 0.1"/>
    <inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="rail" type="prismatic"><parent link="base"/><child link="cabin"/><axis xyz="0 0 1"/>
    <limit lower="-5" upper="5" effort="40" velocity="100"/></joint>
  <link name="hook"/>
  <joint name="end" type="fixed"><parent link="cabin"/><child link="hook"/><origin xyz="0 0 0.3"/></joint>
</robot>"""


def bodies_at(arm: pp.Arm, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Centres of mass (k, 3) and orientations (k, 3, 3) of the bodies, from their placements alone."""
    data = arm.model.createData()
    pin.forwardKinematics(arm.model, data, q)
    placed = list(data.oMi)[1:]
    inertias = list(arm.model.inertias)[1:]
    centers = [place.act(inertia.lever) for place, inertia in zip(placed, inertias, strict=True)]
    return np.array(centers), np.array([place.rotation for place in placed])


def energy(arm: pp.Arm, motion: Callable[[float], np.ndarray], time: float) -> float:
    """Kinetic and potential energy in a motion; velocities are differences of placements."""
    h = 1e-3
    centers, rotations = bodies_at(arm, motion(time))
    samples = [bodies_at(arm, motion(time + k * h)) for k in (-2, -1, 1, 2)]
    shares = np.array([1.0, -8.0, 8.0, -1.0]) / (12.0 * h)
    speeds = sum(share * sample[0] for share, sample in zip(shares, samples, strict=True))
    turning = sum(share * sample[1] for share, sample in zip(shares, samples, strict=True))
    total = 0.0
    for k, inertia in enumerate(list(arm.model.inertias)[1:]):
        spin = rotations[k].T @ turning[k]
        angular = 0.5 * np.array([spin[2, 1] - spin[1, 2], spin[0, 2] - spin[2, 0], spin[1, 0] - spin[0, 1]])
        total += 0.5 * inertia.mass * float(speeds[k] @ speeds[k])
        total += 0.5 * float(angular @ inertia.inertia @ angular) + 9.81 * inertia.mass * centers[k, 2]
    return total


@pytest.mark.parametrize("template", ("RyRz", "Continuum", "Rz"))
def test_their_power_is_the_change_of_energy(template: str) -> None:
    arm = template_arm(template, 3).with_payload(0.3, com=(0.02, 0.01, 0.0)).with_cable(0.2)
    rng = np.random.default_rng(3)
    q = arm.integrate(arm.neutral(), rng.uniform(-1.0, 1.0, arm.nv))
    velocity, acceleration = rng.normal(size=(2, arm.nv))
    [torques] = arm.inverse_dynamics([q], [velocity], [acceleration])

    def motion(time: float) -> np.ndarray:
        return arm.integrate(q, time * velocity + 0.5 * time**2 * acceleration)

    h = 1e-3
    at = {k: energy(arm, motion, k * h) for k in (-2, -1, 1, 2)}
    slope = (8.0 * (at[1] - at[-1]) - (at[2] - at[-2])) / (12.0 * h)
    assert torques @ velocity == pytest.approx(slope, rel=1e-6)


def test_a_lift_needs_its_weight_and_its_acceleration() -> None:
    arm = pp.Arm.load(SLIDE, modules=1)
    found = arm.inverse_dynamics([[0.0], [1.0], [2.0]], [[0.0], [3.0], [-1.0]], [[0.0], [2.0], [-9.81]])
    np.testing.assert_allclose(found[:, 0], [2.5 * 9.81, 2.5 * 11.81, 0.0], atol=1e-12)


def test_at_rest_they_balance_gravity() -> None:
    arm = template_arm("RyRz", 5)
    rng = np.random.default_rng(1)
    q = rng.uniform(-1.0, 1.0, (3, arm.nv))
    found = arm.inverse_dynamics(q, np.zeros((3, arm.nv)), np.zeros((3, arm.nv)))
    np.testing.assert_allclose(found, [arm.at(each).gravity_torques for each in q], atol=1e-13)


def test_what_they_cannot_be_computed_for_is_named() -> None:
    arm = template_arm("RyRz", 2)
    rest = np.zeros((1, arm.nv))
    with pytest.raises(InvalidValue, match=r"velocities \(shape\)"):
        arm.inverse_dynamics([arm.neutral()], rest[:, 1:], rest)
    with pytest.raises(InvalidValue, match="accelerations"):
        arm.inverse_dynamics([arm.neutral()], rest, rest * np.nan)
    long = pp.Arm.from_template("RyRz", 51)
    rest = np.zeros((1, long.nv))
    with pytest.raises(InvalidValue, match="at most 100"):
        long.inverse_dynamics([long.neutral()], rest, rest)
    bare = pp.Arm.load(arm.urdf.replace("inertial", "ignored"), modules=2)
    rest = np.zeros((1, bare.nv))
    with pytest.raises(WeightUnknown):
        bare.inverse_dynamics([bare.neutral()], rest, rest)
