"""What the simulated arm does, against closed forms and integrators of others."""

from __future__ import annotations

import mujoco
import numpy as np
import pinocchio as pin
import pytest
from scipy.integrate import solve_ivp
from simple_arms import (
    INERTIA,
    MASS,
    WEIGHT,
    inertial,
    joint,
    link,
    pendulum,
    quiet,
    quintic,
    quintic_peaks,
    robot,
)

import pinposture as pp
from pinposture import sim
from pinposture.errors import PostureWarning
from pinposture.sim.plant import PLANT, Plant


def still(arm: pp.Arm, q=None) -> list[np.ndarray]:
    return [arm.neutral() if q is None else np.asarray(q, dtype=float)] * 2


def test_without_servos_and_damping_energy_stays():
    arm = pp.Arm.from_template("RyRz", 3)
    plant = sim.build_plant_model(arm)  # nothing is sent to its servos, which therefore give nothing
    model = plant.model
    data = mujoco.MjData(plant.model)
    pinocchio = arm.model.createData()
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_RK4
    model.opt.timestep = 2e-4
    data.qpos[:] = plant.positions(np.array([0.4, -0.9, 0.3, 0.2, -0.5, 0.8]))
    energies = []
    places = []
    for _ in range(1000):
        mujoco.mj_step(model, data)
        q = np.array(data.qpos[plant.columns])
        v = np.array(data.qvel[plant.columns])
        energies.append(pin.computeMechanicalEnergy(arm.model, pinocchio, q, v))
        places.append(q)
    assert np.ptp(places, axis=0).min() > 0.1  # it does swing
    moved = np.ptp([pin.computePotentialEnergy(arm.model, pinocchio, q) for q in places])
    assert np.ptp(energies) < 1e-5 * moved


def test_a_two_link_arm_has_the_mass_matrix_of_the_textbook():
    m = MASS
    c = 0.3
    length = 0.5
    moment = 0.004
    arm = quiet(
        robot(
            link("base"),
            link("a", inertial()),
            link("b", inertial()),
            link("tip"),
            joint("j1", "base", "a", axis=(0, 0, 1)),
            joint("j2", "a", "b", axis=(0, 0, 1), at=(length, 0, 0)),
            joint("end", "b", "tip", "fixed", at=(length, 0, 0)),
        )
    )
    bend = 0.8
    second = moment + m * c**2
    coupled = second + m * length * c * np.cos(bend)
    first = moment + m * c**2 + second + m * length**2 + 2.0 * m * length * c * np.cos(bend)
    found = sim.mass_matrix(sim.build_plant_model(arm), np.array([0.3, bend]))
    np.testing.assert_allclose(found, [[first, coupled], [coupled, second]], rtol=1e-12)


def test_a_pendulum_sinks_onto_its_servo_as_a_damped_spring_does():
    servos = sim.Servos(frequency=8.0, timestep=1e-4)
    omega = 16.0 * np.pi
    ended = sim.simulate(pendulum(), still(pendulum()), servos, dt=0.005, hold=0.2)
    sag = WEIGHT / (omega**2 * INERTIA)
    expected = sag * (1.0 - np.exp(-omega * ended.time) * (1.0 + omega * ended.time))
    np.testing.assert_allclose(ended.q[:, 0], expected, atol=0.01 * sag)
    assert sag < 0.02  # small enough for the torque of the weight to stay the same


@pytest.mark.parametrize("template", ["RyRz", "RzRy"])
def test_at_rest_the_sag_is_the_torque_of_the_weight_over_the_stiffness(template):
    arm = pp.Arm.from_template(template, 5)
    q = arm.random(np.random.default_rng(4)) / 3.0
    plant = sim.build_plant_model(arm)
    ended = sim.simulate(arm, still(arm, q), dt=0.02, hold=2.0)
    rest = np.zeros(arm.nv)
    weight = pin.rnea(arm.model, arm.model.createData(), ended.q[-1], rest, rest)
    np.testing.assert_allclose(ended.torques[-1], weight, atol=1e-6 * np.abs(weight).max())
    sag = (q - ended.q[-1]) * plant.gains.stiffness[plant.columns]
    np.testing.assert_allclose(sag, weight, atol=1e-6 * np.abs(weight).max())


def test_the_tip_of_a_long_arm_sags_as_its_slowest_vibration_tells():
    for modules in (5, 40):
        arm = pp.Arm.from_template("RyRz", modules)
        ended = sim.simulate(arm, still(arm), dt=0.02, hold=1.0)
        assert 0.5 < ended.point_errors[-1, -1] / (9.81 / (20.0 * np.pi) ** 2) < 2.0


def test_a_slide_sags_by_its_weight():
    arm = pendulum("prismatic", (0, 0, 1))
    ended = sim.simulate(arm, still(arm), sim.Servos(frequency=5.0), dt=0.01, hold=1.0)
    np.testing.assert_allclose(ended.q[-1], -9.81 / (10.0 * np.pi) ** 2, rtol=1e-6)
    summary = ended.summary()
    assert summary["turning_joints"] is None
    assert summary["sliding_joints"]["unit"] == "m"


@pytest.mark.parametrize("follows", [True, False])
def test_a_motion_is_followed_as_closely_as_theory_has_it(follows):
    way = 1.2
    duration = 1.5
    omega = 20.0 * np.pi
    arm = pendulum()
    rows = quintic([0.0], [way], duration, 0.01)
    servos = sim.Servos(speed_reference=follows)
    ended = sim.simulate(arm, rows, servos, gravity=False, dt=0.01)
    speed, acceleration = quintic_peaks(way, duration)
    lag = acceleration / omega**2 + (0.0 if follows else 2.0 * speed / omega)
    largest = ended.joint_error.max()
    assert largest <= 1.1 * lag
    assert largest >= 0.5 * lag
    assert ended.joint_error[-1].max() < 1e-6


def test_the_error_on_the_way_is_that_of_a_damped_spring_pushed_by_the_acceleration():
    from scipy.signal import TransferFunction, lsim

    omega = 20.0 * np.pi
    dt = 0.01
    rows = quintic([0.0], [1.2], 1.5, dt)
    ended = sim.simulate(pendulum(), rows, gravity=False, dt=dt)
    times = np.arange(0.0, ended.time[-1], 1e-4)
    pushes = np.pad(np.diff(rows[:, 0], 2) / dt**2, (1, 60))  # of the B-spline, even in each cycle
    spring = TransferFunction([1.0], [1.0, 2.0 * omega, omega**2])
    expected = lsim(spring, pushes[(times / dt + 1e-9).astype(int)], times, interp=False)[1]
    found = ended.commanded[:, 0] - ended.q[:, 0]
    asked = np.interp(ended.time, times, expected)
    np.testing.assert_allclose(found, asked, atol=0.03 * np.abs(asked).max())


def test_torques_of_a_motion_are_those_of_inverse_dynamics():
    arm = pp.Arm.from_template("RyRz", 4)
    rng = np.random.default_rng(8)
    dt = 0.01
    start = rng.uniform(-0.5, 0.5, arm.nv)
    end = rng.uniform(-0.5, 0.5, arm.nv)
    rows = quintic(start, end, 2.0, dt)
    ended = sim.simulate(arm, rows, sim.Servos(frequency=30.0, timestep=5e-4), dt=dt)
    speeds = np.gradient(rows, dt, axis=0)
    changes = np.diff(rows, 2, axis=0) / dt**2
    data = arm.model.createData()
    for k in range(50, 150, 10):  # half a cycle late, and a torque of the step before
        expected = pin.rnea(arm.model, data, rows[k], speeds[k], changes[k - 1])
        np.testing.assert_allclose(ended.torques[k], expected, atol=0.03 * np.abs(expected).max())


def test_set_points_go_half_way_between_rows_without_jumps_of_speed():
    arm = pendulum()
    dt = 0.02
    plant = Plant(sim.build_plant_model(arm, gravity=False), np.zeros(1), dt)
    rows = np.array([0.0, 0.0, 0.01, 0.03, 0.04, 0.04, 0.04])
    halves = []
    for row in rows[1:]:
        plant.advance(np.array([row]))
        halves.append(plant.set_points[0])
    np.testing.assert_allclose(halves, (rows[1:] + rows[:-1]) / 2.0, atol=1e-15)


@pytest.mark.parametrize("compensated", [False, True])
def test_a_servo_too_weak_for_the_weight_falls_as_under_a_constant_torque(compensated):
    limit = 0.6 * WEIGHT
    arm = pendulum()
    servos = sim.Servos(torque_limits=limit, timestep=1e-4, gravity_compensation=compensated)
    ended = sim.simulate(arm, still(arm), servos, dt=0.01, hold=0.4)

    def fall(_, state):
        return state[1], (WEIGHT * np.cos(state[0]) - limit) / INERTIA

    expected = solve_ivp(fall, (0.0, ended.time[-1]), (0.0, 0.0), t_eval=ended.time, rtol=1e-9, atol=1e-12)
    late = ended.time > 0.1  # until then a servo that has to be pushed aside first gives less
    np.testing.assert_allclose(ended.q[late, 0], expected.y[0][late], rtol=0.01 if compensated else 0.15)
    assert ended.q[-1, 0] > 0.3
    np.testing.assert_allclose(ended.torques[late], -limit)
    assert ended.saturated[0] > 0.9
    assert ended.finished


def hurried() -> tuple[pp.Arm, np.ndarray, float]:
    """A motion, and torque limits of 0.7 of what it takes."""
    arm = pp.Arm.from_template("Rz", 12, (0.1,))
    rng = np.random.default_rng(4)
    rows = quintic(rng.uniform(-0.5, 0.5, 12), rng.uniform(-0.5, 0.5, 12), 0.8, 0.02)
    return arm, rows, 0.7 * float(np.abs(sim.simulate(arm, rows, dt=0.02).torques).max())


@pytest.mark.long
def test_limits_hold_and_the_step_of_the_physics_does_not_matter():
    arm, rows, limit = hurried()
    coarse, fine = (
        sim.simulate(arm, rows, sim.Servos(torque_limits=limit, timestep=step), dt=0.02)
        for step in (1e-3, 2.5e-4)
    )
    for each in (coarse, fine):
        assert np.abs(each.torques).max() <= limit * (1.0 + 1e-9)
        assert np.all(each.saturated[:3] > 0.05)
        assert each.saturated.max() < 0.9
    assert coarse.point_errors.max() == pytest.approx(fine.point_errors.max(), rel=0.05)
    np.testing.assert_allclose(coarse.saturated, fine.saturated, atol=0.02)


@pytest.mark.long
def test_trying_and_the_program_find_the_same_torques(monkeypatch):
    arm, rows, limit = hurried()
    servos = sim.Servos(torque_limits=limit)
    tried = sim.simulate(arm, rows, servos, dt=0.02)
    monkeypatch.setattr("pinposture.sim.plant.PLANT", PLANT._replace(trials=0))
    worked_out = sim.simulate(arm, rows, servos, dt=0.02)
    np.testing.assert_allclose(worked_out.q, tried.q, atol=1e-6)
    np.testing.assert_allclose(worked_out.torques, tried.torques, atol=1e-3 * limit)
    np.testing.assert_allclose(worked_out.saturated, tried.saturated, atol=2e-3)


def test_compensation_bears_the_weight_within_the_limits():
    arm = pp.Arm.from_template("RyRz", 4)
    q = np.full(arm.nv, 0.2)
    borne = sim.simulate(arm, still(arm, q), sim.Servos(gravity_compensation=True), dt=0.02)
    assert borne.joint_error.max() < 1e-9
    rest = np.zeros(arm.nv)
    weight = pin.rnea(arm.model, arm.model.createData(), q, rest, rest)
    np.testing.assert_allclose(borne.torques, np.tile(weight, (len(borne.torques), 1)), atol=1e-9)
    limit = 0.5 * np.abs(weight).max()
    weak = sim.simulate(
        arm, still(arm, q), sim.Servos(gravity_compensation=True, torque_limits=limit), dt=0.02
    )
    assert np.abs(weak.torques).max() <= limit * (1.0 + 1e-9)
    assert weak.joint_error[-1].max() > 0.1


def test_a_joint_leans_on_its_stop():
    # Sent up to its stop with its weight the other way round pulling it on.
    arm = pendulum()
    ended = sim.simulate(arm, still(arm, [3.0]), sim.Servos(frequency=2.0), gravity=[0, 0, -9.81], dt=0.01)
    assert ended.finished
    assert ended.q.max() < 3.05
    pushed = sim.simulate(arm, still(arm, [3.0]), sim.Servos(frequency=2.0), gravity=[0, 0, 9.81], dt=0.01)
    assert pushed.finished
    assert pushed.q.max() < 3.05


def test_a_continuous_joint_counts_its_turns():
    arm = pendulum("continuous", (0, 0, 1))
    angles = quintic([0.0], [4.0 * np.pi], 3.0, 0.02)
    rows = [arm.configuration(angle) for angle in angles]
    ended = sim.simulate(arm, rows, gravity=False, dt=0.02)
    assert ended.joint_error.max() < 0.01
    np.testing.assert_allclose(ended.q[-1], arm.neutral(), atol=1e-6)


@pytest.mark.parametrize("limits", [True, False])
def test_an_unstable_arm_is_given_up_and_told(limits, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    arm = pp.Arm.from_template("RyRz", 6)
    servos = sim.Servos(frequency=2000.0, torque_limits=limits)
    with pytest.warns(PostureWarning, match="need physics steps below 0.000318 s to be stable"):
        ended = sim.simulate(arm, still(arm), servos, dt=0.02, hold=1.0)
    assert (ended.status, ended.finished) == ("unstable", False)
    assert any(f"joint {name!r} runs away at 0." in ended.reason for name in arm.joint_names)
    assert "servos of 2000 Hz need physics steps below 0.000318 s" in ended.reason
    for value in (ended.q, ended.points, ended.torques, ended.joint_error, ended.saturated):
        assert np.all(np.isfinite(value))
    assert len(ended.time) == len(ended.q) < 50
    assert list(tmp_path.iterdir()) == []


@pytest.mark.filterwarnings("ignore::pinposture.errors.PostureWarning")
def test_servos_are_stable_up_to_the_step_that_theory_has():
    arm = pp.Arm.from_template("RyRz", 6)
    for share, status in ((0.9, "converged"), (1.15, "unstable")):
        servos = sim.Servos(frequency=share * 2.0 / (np.pi * 1e-3))
        assert sim.simulate(arm, still(arm), servos, dt=0.02, hold=1.0).status == status
