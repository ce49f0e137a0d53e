"""Coupled joints in the simulation, against Pinocchio, which knows them by its own mimic joints."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from arm.driven_arms import DRIVES, LEADERS, Robot, driven_arm
from scipy.integrate import solve_ivp

import pinposture as pp
from pinposture import sim
from pinposture.arm import continuum_section
from pinposture.arm.mjcf import load_mujoco
from pinposture.errors import PostureWarning
from pinposture.sim.model import full_mass_matrix
from pinposture.sim.plant import Plant


@pytest.fixture(scope="module")
def arm() -> pp.Arm:
    return pp.Arm.from_modules([continuum_section(4, 0.2)] * 3)


def test_inertia_of_the_degrees_of_freedom_is_that_of_pinocchio(arm):
    plant = sim.build_plant_model(arm, sim.Servos(armature=0.0))
    mujoco = load_mujoco()
    data = mujoco.MjData(plant.model)
    model = arm.model
    for seed in range(5):
        u = arm.positions(arm.random(seed))
        data.qpos[:] = plant.positions(u)
        mujoco.mj_forward(plant.model, data)
        found = plant.coupling.T @ full_mass_matrix(plant.model, data) @ plant.coupling
        upper = np.triu(pin.crba(model, model.createData(), arm.configuration(u)))
        expected = upper + np.triu(upper, 1).T
        np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-9)


@pytest.mark.long
def test_torques_at_rest_are_those_of_gravity(arm):
    plant_model = sim.build_plant_model(arm)
    u = arm.positions(arm.random(1)) * 0.5
    plant = Plant(plant_model, u, 0.01)
    for _ in range(300):
        plant.advance(u)
    model = arm.model.copy()
    model.gravity.linear = np.array([0.0, 0.0, -9.81])
    q = arm.configuration(plant.positions)
    expected = pin.computeGeneralizedGravity(model, model.createData(), q)
    np.testing.assert_allclose(plant.torques, expected, rtol=1e-4, atol=1e-6)


def test_a_fall_is_that_of_an_integrator_of_pinocchios_dynamics(arm):
    weak = pp.Arm.load(arm.urdf.replace('effort="0.0"', 'effort="1e-9"'))
    plant_model = sim.build_plant_model(weak, sim.Servos(armature=0.0, timestep=1e-4))
    model = weak.model.copy()
    start = np.full(6, 0.1)
    model.gravity.linear = np.array([0.0, 0.0, -9.81])
    data = model.createData()
    plant = Plant(plant_model, start, 0.01)
    for _ in range(10):
        plant.advance(start)

    def slope(_: float, y: np.ndarray) -> np.ndarray:
        upper = np.triu(pin.crba(model, model.createData(), y[:6]))  # used twice, it would add up
        forces = pin.rnea(model, data, y[:6], y[6:], np.zeros(6))
        return np.concatenate([y[6:], -np.linalg.solve(upper + np.triu(upper, 1).T, forces)])

    fall = solve_ivp(slope, (0.0, 0.1), np.concatenate([start, np.zeros(6)]), rtol=1e-9, atol=1e-12)
    moved = fall.y[:6, -1] - start
    assert np.abs(moved).max() > 0.02
    np.testing.assert_allclose(plant.positions - start, moved, atol=5e-3 * np.abs(moved).max())


@pytest.mark.long
def test_a_motion_is_followed_within_the_limits_of_the_servos(arm):
    arm = arm.with_effort(100.0)
    goal = arm.configuration(0.4 * arm.limits.upper)
    limits = pp.Limits(step=None, velocity=0.5, acceleration=2.0, dt=0.01)
    run = pp.track(arm, pp.Target.from_configuration(arm, goal), arm.straight(), limits=limits)
    simulation = sim.simulate(arm, run)
    assert simulation.converged, simulation.reason
    assert np.abs(simulation.joint_error).max() < 0.05
    np.testing.assert_array_less(np.abs(simulation.torques), 100.0 * (1.0 + 1e-9))


def test_joints_stop_at_their_limits():
    arm = pp.Arm.from_modules([continuum_section(3, 0.2, bend=0.3)])
    heavy = pp.Arm.load(arm.urdf.replace('effort="0.0"', 'effort="1e-9"'))
    plant = Plant(sim.build_plant_model(heavy), np.zeros(2), 0.01)
    for _ in range(200):
        assert plant.advance(np.zeros(2))
    # It hangs down: about y, by as much as its limit allows.
    assert np.all(plant.positions <= heavy.limits.upper)
    assert heavy.limits.upper[0] - plant.positions[0] < 2e-3


@pytest.fixture(scope="module")
def driven() -> pp.Arm:
    with pytest.warns(PostureWarning, match="locked"):
        return driven_arm()


HELD = dict(zip(DRIVES, (0.2, -0.05, 0.7, 0.1, -0.3), strict=True))


def test_the_plant_moves_all_joints_as_the_drives_of_the_robot_do(driven):
    """The actuator beside the chain, too; inertia and gravity of Pinocchio's model of all joints, by hand."""
    plant = sim.build_plant_model(driven, sim.Servos(armature=0.01))
    mujoco = load_mujoco()
    data = mujoco.MjData(plant.model)
    robot = Robot(HELD)
    dofs = {name: int(plant.model.joint(name).dofadr[0]) for name in robot.states()}
    data.qpos[:] = plant.positions(np.array(list(HELD.values())))
    assert {name: float(data.qpos[dof]) for name, dof in dofs.items()} == pytest.approx(robot.states())
    mujoco.mj_forward(plant.model, data)
    found = plant.of_arm.T @ full_mass_matrix(plant.model, data) @ plant.of_arm
    upper = np.triu(pin.crba(robot.model, robot.model.createData(), robot.configuration()))
    motion = robot.motion()
    expected = motion.T @ (upper + np.triu(upper, 1).T) @ motion + 0.01 * np.eye(5)
    np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-9)
    for name, limit in zip(DRIVES, plant.torque_limits[plant.columns], strict=True):
        column = robot.model.joints[robot.model.getJointId(name)].idx_v
        assert limit == pytest.approx(robot.model.upperEffortLimit[column])


@pytest.mark.long
@pytest.mark.parametrize("compensated", [False, True])
def test_torques_of_the_drives_hold_the_arm_against_gravity(driven, compensated):
    servos = sim.Servos(gravity_compensation=compensated, torque_limits=False)
    q = driven.configuration(driven.drives.joint_positions(HELD))
    done = sim.simulate(driven, [q] * 300, servos, dt=0.01)
    assert done.converged, done.reason
    robot = Robot(dict(zip(DRIVES, driven.drives.positions(driven.positions(done.q[-1])), strict=True)))
    gravity = pin.computeGeneralizedGravity(robot.model, robot.model.createData(), robot.configuration())
    np.testing.assert_allclose(done.torques[-1], robot.motion().T @ gravity, rtol=5e-3, atol=2e-3)
    largest = done.summary()["largest_torque"]
    assert largest["joint"] in DRIVES and done.summary()["largest_force"]["joint"] == "d"


@pytest.mark.long
def test_the_limit_of_a_servo_is_that_of_its_drive(driven):
    q = driven.configuration(driven.drives.joint_positions(HELD))
    needed = np.abs(driven.drives.torques(driven.at(q).gravity_torques))
    worst = int(needed.argmax())
    for share in (1.1, 0.9):
        done = sim.simulate(
            driven, [q] * 10, sim.Servos(torque_limits=share * needed[worst]), dt=0.01, hold=0.1
        )
        assert (DRIVES[worst] in done.summary()["saturated_joints"]) == (share < 1.0)
    assert DRIVES[worst] not in LEADERS  # or it would show nothing


@pytest.mark.long
def test_a_tracker_closes_the_loop_with_the_encoders_of_the_drives(driven):
    """The motor turns twice as far as the joint: half its resolution is left there."""
    limits = pp.Limits(step=None, dt=0.01, velocity=1.0, acceleration=5.0)
    goal = driven.configuration(driven.drives.joint_positions(HELD))
    servos = sim.Servos(gravity_compensation=True, torque_limits=False)
    tracker = pp.Tracker(driven, limits=limits)
    seen = []
    step = tracker.step
    tracker.step = lambda q, dt: seen.append(driven.positions(q)) or step(q, dt)
    target = pp.Target.from_configuration(driven, goal)
    sensing = sim.Sensing(resolution=0.01)
    done = sim.simulate_closed(driven, tracker, target, driven.straight(), 4.0, 0.01, servos, sensing=sensing)
    assert done.converged, done.reason
    read = driven.drives.positions(np.array(seen))
    off = np.abs(read / 0.01 - np.round(read / 0.01))[:, [0, 1, 3, 4]]
    assert off.max() < 1e-6
    np.testing.assert_allclose(driven.positions(done.q[-1]), driven.positions(goal), atol=0.03)
