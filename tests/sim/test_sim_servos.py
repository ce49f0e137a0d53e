"""Gains against the vibrations that they give, and torques within limits against trying every case."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sampling import examples
from scipy.linalg import eigh
from simple_arms import INERTIA, mass_matrix, pendulum

import pinposture as pp
from pinposture import sim
from pinposture.errors import InvalidValue
from pinposture.sim.model import torques_within_limits


def test_one_joint_swings_at_the_frequency_asked_for():
    plant = sim.build_plant_model(pendulum(), sim.Servos(frequency=3.0, damping=0.7))
    omega = 6.0 * np.pi
    np.testing.assert_allclose(plant.gains.stiffness, [omega**2 * INERTIA], rtol=1e-9)
    np.testing.assert_allclose(plant.gains.damping, [1.4 * omega * INERTIA], rtol=1e-9)


def test_no_vibration_of_an_arm_is_slower_and_the_slowest_is_damped_as_asked():
    arm = pp.Arm.from_template("RyRz", 8)
    servos = sim.Servos(frequency=4.0, damping=0.8)
    plant = sim.build_plant_model(arm, servos)
    stiffness, damping = (np.diag(gain[plant.columns]) for gain in plant.gains)
    slowest = []
    for q in (arm.straight(), arm.random(np.random.default_rng(5)), arm.random(np.random.default_rng(6))):
        squares, modes = eigh(stiffness, mass_matrix(arm, q))
        omegas = np.sqrt(squares)
        ratios = np.einsum("ij,ik,kj->j", modes, damping, modes) / (2.0 * omegas)
        np.testing.assert_allclose(ratios, 0.8 * omegas / (8.0 * np.pi), rtol=1e-6)
        slowest.append(omegas[0] / (2.0 * np.pi))
    assert min(slowest) >= 4.0 * (1.0 - 1e-6)
    assert slowest[0] == pytest.approx(4.0, rel=0.02)  # the straight one is the limpest


def test_rotors_make_servos_stiffer():
    plant = sim.build_plant_model(pendulum(), sim.Servos(frequency=3.0, armature=0.5))
    omega = 6.0 * np.pi
    np.testing.assert_allclose(plant.gains.stiffness, [omega**2 * (INERTIA + 0.5)], rtol=1e-9)


def test_servos_are_no_weaker_than_the_friction_of_their_joints():
    arm = pendulum(more='<dynamics damping="100" friction="20"/>')
    stiffness = sim.build_plant_model(arm, sim.Servos(frequency=1.0)).gains.stiffness
    np.testing.assert_allclose(stiffness, [120.0 / 0.01])


def test_a_servo_with_friction_rests_short_of_its_set_point_by_friction_over_stiffness():
    arm = pendulum()
    rubbing = sim.Servos(frequency=3.0, friction=0.4)
    stiffness = sim.build_plant_model(arm, sim.Servos(frequency=3.0)).gains.stiffness
    plant = sim.build_plant_model(arm, rubbing)
    np.testing.assert_array_equal(plant.gains.stiffness, stiffness)  # it does not count, as it is the servo's
    there = np.concatenate([np.linspace(0.0, 0.1, 250), np.full(50, 0.1)])  # slow, so that it does not coast
    motion = pp.JointTrajectory.from_configurations(arm, there[:, None], 0.02)
    ended = sim.simulate(arm, motion, servos=rubbing, gravity=False)
    assert 0.1 - float(ended.q[-1, 0]) == pytest.approx(0.4 / stiffness[0], rel=0.05)
    assert np.ptp(ended.q[-40:, 0]) < 1e-5  # it does not creep


@pytest.mark.parametrize(
    "options",
    [
        {"frequency": 0.0},
        {"frequency": np.nan},
        {"frequency": 1e300},
        {"damping": -1.0},
        {"damping": 1e308},
        {"timestep": 0.0},
        {"armature": 1e300},
        {"armature": -1e-3},
        {"friction": -1e-3},
        {"torque_limits": 0.0},
        {"torque_limits": "high"},
        {"gravity_compensation": 1},
        {"speed_reference": None},
    ],
)
def test_values_that_make_no_servo_are_refused(options):
    with pytest.raises(InvalidValue, match=next(iter(options))):
        sim.Servos(**options)


@examples(40)
@given(st.integers(0, 10_000))
def test_torques_within_limits_are_the_one_case_of_all_that_fits(seed):
    rng = np.random.default_rng(seed)
    n = 4
    root = rng.normal(size=(n, n))
    mobility = root @ root.T + 1e-3 * np.eye(n)
    unmoved = rng.normal(size=n)
    spring = rng.normal(size=n) * 3.0
    damping = 10.0 ** rng.uniform(-1, 3, n)
    limits = rng.uniform(0.1, 2.0, n)
    limits[0] = np.inf
    found = torques_within_limits(mobility, unmoved, spring, damping, -limits, limits)
    cases = []
    for sides in product((-1, 0, 1), repeat=n):
        at = np.array(sides)
        if at[0]:
            continue
        free = at == 0
        held = np.where(free, 0.0, at * np.where(free, 0.0, limits))
        # Free servos: u = s - D (v0 + W u); the others give all that they have.
        matrix = np.where(free[:, None], np.eye(n) + damping[:, None] * mobility, np.eye(n))
        given_ = np.linalg.solve(matrix, np.where(free, spring - damping * unmoved, held))
        asked = spring - damping * (unmoved + mobility @ given_)
        fits = np.where(free, np.abs(given_) <= limits, np.sign(asked) * at * np.abs(asked) >= limits)
        if np.all(fits):
            cases.append(given_)
    assert len(cases) == 1
    np.testing.assert_allclose(found, cases[0], atol=1e-6)
