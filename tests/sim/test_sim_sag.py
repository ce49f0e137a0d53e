"""Sag and its compensation, against MuJoCo: its equilibrium under load shares no formula with `Arm.sag`."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

import pinposture as pp
from pinposture import sim
from pinposture.arm import Weight, continuum_section
from pinposture.errors import InvalidValue, WeightUnknown
from pinposture.motion import Actuators, JointTrajectory, Tendon

MOUNTINGS = {
    "wall": pin.SE3.Identity(),
    "ceiling": pin.SE3(pin.rpy.rpyToMatrix(0.0, np.pi / 2.0, 0.0), np.zeros(3)),
    "floor": pin.SE3(pin.rpy.rpyToMatrix(0.0, -np.pi / 2.0, 0.0), np.zeros(3)),
}
DT = 0.02


def soft(arm: pp.Arm, frequency: float = 3.0) -> pp.Arm:
    return arm.with_stiffness(sim.Servos(frequency).stiffness(arm))


def snake(modules: int = 10, mounting: str = "wall") -> pp.Arm:
    """An arm of 1 m with a load at its tip."""
    link = 1.0 / modules
    module = pp.template("RyRz").with_lengths((0.3 * link, 0.7 * link))
    return pp.Arm.from_modules([module] * modules, base_placement=MOUNTINGS[mounting]).with_payload(0.05)


def on_tendons() -> pp.Arm:
    arm = snake()
    offsets = {"a": (0.02, 0.0), "b": (-0.01, 0.017), "c": (-0.01, -0.017)}
    tendons = {f"{name}{k}": Tendon(at, end=k) for k in range(arm.n_modules) for name, at in offsets.items()}
    return arm.with_stiffness(Actuators.from_tendons(arm, tendons).stiffness(2e4))


def sliding() -> pp.Arm:
    slide = pp.JointSpec("x", type="prismatic", lower=-0.05, upper=0.05)
    module = pp.ModuleTemplate("Sliding", [pp.JointSpec("y"), pp.JointSpec("z"), slide], [0.05, 0.1, 0.1])
    return soft(pp.Arm.from_modules([module] * 4).with_payload(0.05))


ARMS = {
    "on a wall": lambda: soft(snake()),
    "on a ceiling": lambda: soft(snake(mounting="ceiling")),
    "on the floor": lambda: soft(snake(mounting="floor")),
    "of 40 joints": lambda: soft(snake(20)),
    "on tendons": on_tendons,
    "with slides": sliding,
    "of coupled joints": lambda: soft(
        pp.Arm.from_modules([continuum_section(6, 0.3)] * 3).with_payload(0.05)
    ),
}


def bent(arm: pp.Arm) -> np.ndarray:
    return arm.configuration(0.1 * np.cos(0.7 * np.arange(arm.nv)) * arm.joint_units)


def rows_to(arm: pp.Arm, goal: np.ndarray, count: int = 60) -> np.ndarray:
    """A smooth way from the straight arm, (count, nq)."""
    share = np.linspace(0.0, 1.0, count)
    smooth = share**3 * (10.0 - 15.0 * share + 6.0 * share**2)
    return arm.integrate(arm.neutral(), smooth[:, None] * arm.difference(arm.neutral(), goal))


@pytest.mark.long
@pytest.mark.parametrize("make", ARMS.values(), ids=ARMS)
def test_a_simulated_arm_rests_where_it_sags_and_compensation_puts_it_where_it_should_be(make) -> None:
    arm = make()
    goal = bent(arm)
    rows = rows_to(arm, goal)
    hold = 12.0 if arm.weight.stiffness and isinstance(arm.weight.stiffness, tuple) else 3.0
    plain = sim.simulate(arm, rows, dt=DT, hold=hold, tolerance=0.1)
    tip = arm.at(goal).points[-1]
    sag = float(np.linalg.norm(plain.points[-1, -1] - tip))
    assert 5e-4 < sag < 0.1
    predicted = arm.at(arm.sag(goal)).points[-1]
    assert np.linalg.norm(plain.points[-1, -1] - predicted) < 0.005 * sag
    held = sim.simulate(arm, rows, dt=DT, hold=hold, compensate=True)
    assert held.converged
    assert np.linalg.norm(held.points[-1, -1] - tip) < 0.02 * sag
    assert held.target_errors[0].max() < 1e-9  # it starts as it is held
    lighter = arm.with_weight(Weight(stiffness=arm.weight.stiffness)).with_payload(0.04)
    off = sim.simulate(arm, lighter.compensate(rows), dt=DT, hold=hold, tolerance=0.1)
    assert np.linalg.norm(off.points[-1, -1] - tip) < 0.1 * sag


def test_servos_have_the_stiffness_of_the_arm() -> None:
    arm = snake(3)
    stiff = sim.Servos(4.0).stiffness(arm)
    plant = sim.build_plant_model(arm.with_stiffness(stiff))
    np.testing.assert_allclose(plant.gains.stiffness, stiff)
    assert plant.servos.frequency == pytest.approx(4.0)
    np.testing.assert_allclose(plant.gains.damping, 2.0 / (2.0 * np.pi * 4.0) * stiff)
    assert sim.build_plant_model(arm).servos.frequency == 10.0
    assert sim.build_plant_model(arm.with_stiffness(stiff), sim.Servos(7.0)).servos.frequency == 7.0
    some = arm.with_stiffness({arm.joint_names[0]: 3.0})
    with pytest.raises(WeightUnknown, match="stiffnesses of joints"):
        sim.build_plant_model(some)
    full = np.diag(stiff) + 0.1 * stiff.min()
    coupled = sim.build_plant_model(arm.with_stiffness(full))
    np.testing.assert_allclose(coupled.gains.stiffness, full)
    np.testing.assert_allclose(sim.Servos().stiffness(arm.with_stiffness(full)), full)


def test_the_frequency_is_that_of_the_slowest_vibration_on_its_springs() -> None:
    arm = snake(4).with_stiffness(30.0)
    plant = sim.build_plant_model(arm)
    mass = sim.mass_matrix(plant, arm.positions(arm.straight()))  # it is largest where the arm is straight
    slowest = float(np.sqrt(np.linalg.eigvals(np.linalg.solve(mass, arm.stiffness)).real.min()))
    assert 0.98 * slowest <= 2.0 * np.pi * plant.servos.frequency <= slowest * (1.0 + 1e-9)


def test_what_cannot_be_compensated_is_refused() -> None:
    arm = snake(3)
    rows = rows_to(arm, bent(arm), 5)
    with pytest.raises(WeightUnknown, match="stiffness"):
        sim.simulate(arm, rows, dt=DT, compensate=True)
    with pytest.raises(InvalidValue, match="False with servos that compensate gravity by torques"):
        sim.simulate(soft(arm), rows, sim.Servos(gravity_compensation=True), dt=DT, compensate=True)
    with pytest.raises(InvalidValue, match="gravity is False; allowed: True with compensate"):
        sim.simulate(soft(arm), rows, gravity=False, dt=DT, compensate=True)
    with pytest.raises(InvalidValue, match="compensate"):
        sim.simulate(soft(arm), rows, dt=DT, compensate=1)


def test_commands_for_a_motion_change_its_rates_too() -> None:
    arm = soft(snake(4))
    rows = rows_to(arm, bent(arm))
    motion = JointTrajectory.from_configurations(arm, rows, DT)
    sent = motion.compensated(arm)
    np.testing.assert_allclose(
        sent.positions, [arm.positions(each) for each in arm.compensate(rows)], atol=1e-12
    )
    again = JointTrajectory.from_configurations(arm, arm.compensate(rows), DT)
    np.testing.assert_allclose(sent.velocities, again.velocities, atol=1e-10)
    np.testing.assert_allclose(sent.accelerations, again.accelerations, atol=1e-8)
    assert sent.joint_names == motion.joint_names
    backwards = JointTrajectory(
        motion.joint_names[::-1],
        *(motion.time, motion.positions[:, ::-1], motion.velocities[:, ::-1], motion.accelerations[:, ::-1]),
        motion.units[::-1],
    )
    np.testing.assert_allclose(backwards.compensated(arm).positions, sent.positions)


def test_turns_of_continuous_joints_stay_in_the_commands() -> None:
    joints = [pp.JointSpec("z", type="continuous"), pp.JointSpec("y")]
    arm = pp.Arm.from_modules([pp.ModuleTemplate("Turning", joints, [0.0, 0.2])] * 2, MOUNTINGS["ceiling"])
    arm = arm.with_stiffness(20.0)
    positions = np.linspace(0.0, 1.0, 40)[:, None] * np.array([9.0, 0.3, -5.0, 0.2])
    motion = JointTrajectory.from_positions(arm.joint_names, positions, 0.1)
    assert np.abs(motion.compensated(arm).positions - positions).max() < 0.1


@pytest.mark.long
@pytest.mark.parametrize("name", ["on the floor", "on tendons", "with slides", "of coupled joints"])
def test_a_tracker_that_compensates_needs_no_feedback(name: str) -> None:
    arm = ARMS[name]()
    goal = bent(arm)
    limits = pp.Limits(step=None, dt=DT, velocity=1.0, acceleration=8.0)
    coupled = isinstance(arm.weight.stiffness, tuple)
    tips = []
    lighter = arm.with_weight(Weight(stiffness=arm.weight.stiffness)).with_payload(0.04)
    for model, compensate in ((arm, False), (arm, True), (lighter, True)):
        tracker = pp.Tracker(model, limits=limits, compensate=compensate, feedback_time_constant=np.inf)
        ended = sim.simulate_closed(
            arm,
            tracker,
            pp.Target.from_configuration(arm, goal),
            arm.straight(),
            *(12.0 if coupled else 5.0, DT),
        )
        tips.append(float(np.linalg.norm(ended.points[-1, -1] - arm.at(goal).points[-1])))
    assert tips[0] > 5e-4
    assert tips[1] < 0.02 * tips[0]
    assert tips[2] < 0.1 * tips[0]
