"""Coupled joints in the simulation, against Pinocchio, which knows them by its own mimic joints."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from scipy.integrate import solve_ivp

import pinposture as pp
from pinposture import sim
from pinposture.arm import continuum_section
from pinposture.arm.mjcf import load_mujoco
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
