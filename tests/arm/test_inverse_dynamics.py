"""Torques of motions: against the power that changes the energy of the arm, closed forms, and Pinocchio."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pinocchio as pin
import pytest
from arm.test_weight import each_arm
from arms import template_arm
from sampling import seeds
from scipy.interpolate import CubicHermiteSpline

import pinposture as pp
from pinposture import kernels
from pinposture.errors import InvalidValue, WeightUnknown
from pinposture.kernels.arrays import TorqueSamples

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
    arm = pp.Arm.load(SLIDE, split=1)
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
    bare = pp.Arm.load(arm.urdf.replace("inertial", "ignored"), split=2)
    rest = np.zeros((1, bare.nv))
    with pytest.raises(WeightUnknown):
        bare.inverse_dynamics([bare.neutral()], rest, rest)


def random_tree(rng: np.random.Generator) -> pp.Arm:
    """An arm of joints of all kinds with one degree of freedom, and with branches that hang off it."""
    turning = (pin.JointModelRX, pin.JointModelRY, pin.JointModelRUBX, pin.JointModelRUBZ)
    sliding = (pin.JointModelPX, pin.JointModelPZ)
    skew = (pin.JointModelRevoluteUnaligned, pin.JointModelPrismaticUnaligned)
    model = pin.Model()
    tip = last = 0
    for k in range(int(rng.integers(3, 12))):
        kind = rng.choice([*turning, *sliding, *skew])
        axis = rng.normal(size=3)
        joint = kind(axis / np.linalg.norm(axis)) if kind in skew else kind()
        branch = k > 1 and rng.uniform() < 0.3
        parent = int(rng.choice([tip, last])) if branch else tip  # in order of depth, for Pinocchio
        added = model.addJoint(parent, joint, pin.SE3.Random(), f"j{k}")
        model.appendBodyToJoint(added, pin.Inertia.FromBox(*rng.uniform(0.1, 1.0, 4)), pin.SE3.Random())
        tip = tip if branch else added
        last = added
    model.addFrame(pin.Frame("tip", tip, pin.SE3.Random(), pin.FrameType.OP_FRAME))
    model.armature = rng.uniform(0.0, 1.0, model.nv)
    model.gravity.linear = rng.normal(size=3) * 9.81
    return pp.Arm.from_model(model, ["tip"])


@pytest.mark.parametrize("seed", seeds(40))
def test_the_pass_agrees_with_pinocchio_on_random_trees(seed: int) -> None:
    rng = np.random.default_rng(seed)
    pin.seed(seed)
    arm = random_tree(rng)
    count = int(rng.choice([1, 5, 8, 19]))
    positions = rng.uniform(-2.0, 2.0, (count, arm.nv))
    q = [arm.configuration(row) for row in positions]
    velocities, accelerations = rng.normal(size=(2, count, arm.nv))
    data = arm.model.createData()
    exact = [pin.rnea(arm.model, data, *motion) for motion in zip(q, velocities, accelerations, strict=True)]
    size = float(np.abs(exact).max())
    found = arm.inverse_dynamics(q, velocities, accelerations)
    np.testing.assert_allclose(found, exact, rtol=0, atol=1e-12 * size)
    state = arm.chain_at(q[0])
    exact = pin.computeGeneralizedGravity(arm.model, data, q[0])
    np.testing.assert_allclose(state.gravity_torques, exact, rtol=0, atol=1e-12 * size)
    exact = pin.computeGeneralizedGravityDerivatives(arm.model, data, q[0])
    np.testing.assert_allclose(state.gravity_gradient, exact, rtol=0, atol=1e-12 * size)


@each_arm
def test_the_pass_agrees_with_pinocchio_on_coupled_joints_and_what_is_carried(make) -> None:
    arm = make()
    rng = np.random.default_rng(4)
    q = [arm.random(rng) for _ in range(3)]
    velocities, accelerations = rng.normal(size=(2, 3, arm.nv))
    data = arm.model.createData()
    exact = [pin.rnea(arm.model, data, *motion) for motion in zip(q, velocities, accelerations, strict=True)]
    found = arm.inverse_dynamics(q, velocities, accelerations)
    np.testing.assert_allclose(found, exact, rtol=0, atol=1e-11)


@each_arm
def test_torques_of_steps_are_those_of_their_mean_speed_where_they_meet(make) -> None:
    arm = make()
    rng = np.random.default_rng(8)
    start = arm.positions(arm.random(rng))
    dt = 0.1
    effort = rng.uniform(0.1, 2.0, arm.nv)
    effort[0] = np.inf  # not limited
    data = arm.model.createData()

    def share(torques: np.ndarray) -> float:
        return float(np.abs(torques / effort).max())

    for count in (0, 1, 6, 7, 8, 11):
        before, *steps = rng.normal(scale=0.01, size=(count + 1, arm.nv))
        loads = arm.dynamics.step_loads(start, before, np.reshape(steps, (count, arm.nv)), dt, effort)
        moving = []
        held = []
        at = start
        for one, other in zip([before, *steps], [*steps, np.zeros(arm.nv)], strict=True):
            q = arm.configuration(at)
            torques = pin.rnea(arm.model, data, q, (one + other) / (2.0 * dt), (other - one) / dt**2)
            moving.append(share(torques))
            held.append(share(pin.computeGeneralizedGravity(arm.model, data, q)))
            at = at + other
        np.testing.assert_allclose(loads.moving, max(*moving, held[-1]), rtol=1e-12, atol=1e-10)
        np.testing.assert_allclose(loads.held_before, held[0], rtol=1e-12, atol=1e-10)
        np.testing.assert_allclose(loads.held, max(held), rtol=1e-12, atol=1e-10)


@each_arm
def test_torques_along_a_path_are_those_of_its_motion(make) -> None:
    arm = make()
    rng = np.random.default_rng(5)
    start = rng.normal(size=arm.nv)
    offsets, slopes = rng.normal(size=(2, 4, arm.nv))
    dt = 0.1
    count = 12
    found = TorqueSamples(*np.empty((3, count, arm.nv)))
    dynamics = arm.dynamics
    kernels.path_torques(dynamics.indices, dynamics.numbers, offsets, slopes, start, dt, found)
    curve = CubicHermiteSpline(np.arange(4), start + offsets, slopes)
    places = np.linspace(0.0, 3.0, count)
    speed = rng.uniform(0.5, 2.0, (count, 1))
    change = rng.normal(size=(count, 1))
    q, first, second = (curve(places, order) for order in range(3))
    rates = first * speed / dt
    expected = dynamics.inverse_dynamics(q, rates, (first * change + second * speed**2) / dt**2)
    size = float(np.abs(expected).max())
    np.testing.assert_allclose(found.a * change + found.b * speed**2 + found.c, expected, atol=1e-12 * size)


def test_a_long_arm_needs_the_torques_of_its_parts() -> None:
    """The torques of joints near the tip are those of the part that they carry, on an arm of 300 joints."""
    long = pp.Arm.from_template("Rz", 300)
    rng = np.random.default_rng(6)
    q, velocities, accelerations = 0.1 * rng.normal(size=(3, 1, long.nv))
    rest = slice(250, None)
    for each in (q, velocities, accelerations):
        each[:, :250] = 0.0
    part = pp.Arm.from_template("Rz", 50)
    found = long.inverse_dynamics(q, velocities, accelerations)[:, rest]
    expected = part.inverse_dynamics(q[:, rest], velocities[:, rest], accelerations[:, rest])
    np.testing.assert_allclose(found, expected, atol=1e-12)


def test_joints_that_move_otherwise_are_left_to_pinocchio() -> None:
    pin.seed(1)
    model = pin.Model()
    first = model.addJoint(0, pin.JointModelRY(), pin.SE3.Random(), "first")
    model.appendBodyToJoint(first, pin.Inertia.FromBox(1.0, 0.1, 0.2, 0.3), pin.SE3.Identity())
    ball = model.addJoint(first, pin.JointModelSpherical(), pin.SE3.Random(), "ball")
    model.appendBodyToJoint(ball, pin.Inertia.FromBox(2.0, 0.1, 0.3, 0.2), pin.SE3.Random())
    model.addFrame(pin.Frame("tip", first, pin.SE3.Random(), pin.FrameType.OP_FRAME))
    arm = pp.Arm.from_model(model, ["tip"])
    q = pin.randomConfiguration(model, -np.ones(model.nq), np.ones(model.nq))
    velocity, acceleration = np.random.default_rng(0).normal(size=(2, arm.nv))
    exact = pin.rnea(model, model.createData(), q, velocity, acceleration)
    np.testing.assert_allclose(arm.inverse_dynamics([q], [velocity], [acceleration]), [exact], atol=1e-12)
    np.testing.assert_allclose(
        arm.chain_at(q).gravity_torques,
        pin.computeGeneralizedGravity(model, model.createData(), q),
        atol=1e-12,
    )


def test_many_turns_change_nothing() -> None:
    arm = template_arm("RyRz", 4)
    rng = np.random.default_rng(5)
    positions = rng.uniform(-3.0, 3.0, (19, arm.nv))
    turned = positions + 2.0 * np.pi * rng.integers(-1000, 1000, positions.shape)
    rates = rng.normal(size=positions.shape)
    found = arm.dynamics.inverse_dynamics(turned, rates, rates)
    np.testing.assert_allclose(found, arm.dynamics.inverse_dynamics(positions, rates, rates), atol=1e-10)
