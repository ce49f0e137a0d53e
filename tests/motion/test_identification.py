"""Identification from logs: against drives that share no code with it, and what it says it cannot tell."""

from __future__ import annotations

import json

import numpy as np
import pytest
from arms import template_arm
from scipy.integrate import solve_ivp

import pinposture as pp
from benchmarks.studies.identification import Conditions, covered, draw
from pinposture import kernels
from pinposture.errors import InvalidValue
from pinposture.motion.identification import identify
from pinposture.motion.log import Log
from pinposture.sim import DriveModel, Drives

MODEL = DriveModel(lag=0.2, friction=0.05, delay=0.03)


@pytest.fixture(scope="module")
def arm() -> pp.Arm:
    return template_arm("RyRz", 1)


def swings(times: np.ndarray, frequency: float = 0.4, size: float = 0.6) -> np.ndarray:
    """Commands of two joints that turn back and forth, (N, 2) [rad]."""
    waves = [np.sin(2.0 * np.pi * frequency * rate * times) for rate in (1.0, 1.7)]
    return size * np.column_stack(waves)


def followed(sent: np.ndarray, model: DriveModel, dt: float = 0.01) -> np.ndarray:
    """Positions of drives after each cycle, (N, n) [rad]."""
    drives = Drives(model, sent[0], dt)
    return np.array([drives.advance(row) for row in sent])


def log_of(model: DriveModel = MODEL, seconds: float = 12.0, frequency: float = 0.4, **about) -> Log:
    times = 0.01 * np.arange(round(seconds / 0.01))
    sent = swings(times, frequency)
    rng = np.random.default_rng(0)
    measured = followed(sent, model) + rng.normal(0.0, 3e-4, sent.shape)
    return Log(times, sent, times + 0.01, measured, **about)


def predict(sent_at, sent, times, start, model: DriveModel, shift=None) -> np.ndarray:
    positions = np.zeros(len(times))
    positions[0] = start
    drive = np.array([model.lag, model.delay, model.friction])
    shift = np.zeros(len(times)) if shift is None else shift
    kernels.follow_commands(sent_at, sent, times, shift, drive, positions)
    return positions


# The model.


@pytest.mark.parametrize("model", [MODEL, DriveModel(lag=0.02, friction=0.0, delay=0.0)])
def test_predicted_positions_are_those_of_drives_in_cycles(model: DriveModel) -> None:
    times = 0.01 * np.arange(400)
    sent = swings(times)[:, 0].copy()
    drives = followed(sent[:, None], model)[:, 0]
    found = predict(times, sent, np.append(0.0, times + 0.01), sent[0], model)
    np.testing.assert_allclose(found[1:], drives, rtol=0.0, atol=1e-12)


def test_predicted_positions_solve_the_differential_equation_at_any_times() -> None:
    rng = np.random.default_rng(1)
    sent_at = np.sort(rng.uniform(0.0, 3.0, 30))
    sent_at[0] = 0.0
    sent = rng.uniform(-1.0, 1.0, 30)
    times = np.sort(np.append(rng.uniform(0.0, 3.0, 50), 0.0))
    model = DriveModel(lag=0.3, friction=0.1, delay=0.0437)

    def rate(time: float, q: np.ndarray) -> np.ndarray:
        error = sent[max(np.searchsorted(sent_at + model.delay, time, side="right") - 1, 0)] - q
        return np.where(np.abs(error) > 0.1, (error - 0.1 * np.sign(error)) / 0.3, 0.0)

    solved = solve_ivp(rate, (0.0, 3.0), [0.2], t_eval=times, max_step=1e-3, rtol=1e-8)
    found = predict(sent_at, sent, times, 0.2, model)
    np.testing.assert_allclose(found, solved.y[0], rtol=0.0, atol=2e-3)


def test_a_step_ends_where_friction_holds_the_joint() -> None:
    times = np.linspace(0.0, 4.0, 81)
    found = predict(np.zeros(1), np.ones(1), times, 0.0, DriveModel(lag=0.2, friction=0.1, delay=0.0))
    np.testing.assert_allclose(found, 0.9 * (1.0 - np.exp(-times / 0.2)), atol=1e-12)


# What is identified.


def test_drives_are_identified(arm: pp.Arm) -> None:
    result = identify(arm, log_of())
    for drive in (result.drives, *result.joints.values()):
        assert drive.lag.value == pytest.approx(0.2, abs=2e-3)
        assert drive.delay.value == pytest.approx(0.03, abs=2e-3)
        assert drive.friction.value == pytest.approx(0.05, abs=1e-3)
        assert drive.explained > 0.9999
    assert result.model.lag == result.drives.lag.value
    for noise in result.noise.values():
        assert noise == pytest.approx(3e-4, rel=0.1)
    assert result.measured.period == pytest.approx(0.01)
    assert result.measured.stale == result.measured.missing == 0.0
    assert result.explained(log_of(frequency=0.3)) > 0.9999
    assert json.loads(json.dumps(result.summary()))["drives"]["lag"]["value"] == result.drives.lag.value
    assert "lag 0.2 (" in repr(result) and "stiffness" in repr(result)


def test_any_clock_order_names_and_units_give_the_same(arm: pp.Arm) -> None:
    log = log_of()
    known = identify(arm, log).drives
    epoch = 1.7e9 + log.command_time
    whole = np.floor(1.7e9 + log.time)
    stamps = np.column_stack([whole, np.round(1e9 * (1.7e9 + log.time - whole))])
    swapped = Log(
        epoch,
        np.rad2deg(log.commands)[:, ::-1],
        stamps,
        np.rad2deg(log.positions)[:, ::-1],
        joint_names=arm.joint_names[::-1],
        degrees=True,
    )
    found = identify(arm, swapped)
    for name in ("lag", "delay", "friction"):
        assert getattr(found.drives, name).value == pytest.approx(getattr(known, name).value, abs=1e-4)
    assert list(found.joints) == list(arm.joint_names)


def test_stale_rows_bursts_gaps_and_missing_numbers_change_little(arm: pp.Arm) -> None:
    log = log_of(seconds=20.0)
    rng = np.random.default_rng(2)
    positions = np.array(log.positions)
    for row in np.flatnonzero(rng.random(len(positions)) < 0.3)[1:]:
        positions[row] = positions[row - 1]
    positions[100:110] = np.nan
    positions[300, 1] = np.nan
    kept = np.ones(len(positions), dtype=bool)
    kept[700:900] = False
    time = np.array(log.time)
    time[1200:1205] = time[1200]
    time[1300] = np.nan
    result = identify(arm, Log(log.command_time, log.commands, time[kept], positions[kept]))
    assert result.drives.lag.value == pytest.approx(0.2, abs=4e-3)
    assert result.drives.delay.value == pytest.approx(0.03, abs=4e-3)
    assert result.drives.friction.value == pytest.approx(0.05, abs=2e-3)
    assert result.measured.stale == pytest.approx(0.3, abs=0.04)
    assert result.measured.missing == pytest.approx(12 / 1800)
    assert result.measured.period == pytest.approx(0.01)


def test_several_logs_count_together(arm: pp.Arm) -> None:
    logs = [log_of(seconds=6.0), log_of(seconds=9.0, frequency=0.3)]
    assert identify(arm, logs).drives.lag.value == pytest.approx(0.2, abs=2e-3)


def test_efforts_tell_gain_and_friction_as_a_torque(arm: pp.Arm) -> None:
    bare = log_of()
    arrived = np.searchsorted(bare.command_time + 0.03, bare.time, side="right") - 1
    rng = np.random.default_rng(5)
    effort = 4.0 * (bare.commands[np.maximum(arrived, 0)] - bare.positions) + 0.3
    effort += rng.normal(0.0, 0.02, effort.shape)
    log = Log(bare.command_time, bare.commands, bare.time, bare.positions, effort=effort)
    result = identify(arm, log)
    for drive in (result.drives, *result.joints.values()):
        assert drive.gain.value == pytest.approx(4.0, rel=0.05)  # commands arrive as positions are measured
        assert drive.friction_torque.value == pytest.approx(0.2, rel=0.05)
    assert "friction torque" not in result.not_identified
    random = Log(
        bare.command_time, bare.commands, bare.time, bare.positions, effort=rng.normal(size=effort.shape)
    )
    assert "of the variance of efforts" in identify(arm, random).not_identified["gain"]
    untold = identify(arm, bare).not_identified
    assert untold["gain"] == "the log has no efforts that change"
    assert untold["friction torque"] == "neither gain nor stiffness are identified"


@pytest.mark.long
def test_stiffness_and_payload_by_weight() -> None:
    arm = template_arm("RyRz", 4)
    seeds = (0, 3)  # with a known payload, and without one
    for seed in seeds:
        truth = draw(arm, np.random.default_rng(seed), Conditions(disturbance=1e-3))
        result = identify(arm, truth.log)
        assert result.drives.stiffness.value == pytest.approx(truth.stiffness, rel=0.02)
        assert (result.payload is None) == (truth.log.payload is not None)
        if result.payload is not None:
            assert result.payload.value == pytest.approx(truth.payload, abs=2e-3)


@pytest.mark.statistics
def test_intervals_cover_the_truth_in_ninety_of_a_hundred_draws() -> None:
    arm = template_arm("RyRz", 2)
    counts: dict[str, list[bool]] = {}
    for seed in range(15):
        truth = draw(arm, np.random.default_rng(seed), Conditions())
        result = identify(arm, truth.log)
        for name, covers in covered(result.drives, result.payload, truth).items():
            if covers is not None:
                counts.setdefault(name, []).append(covers)
    of_four = [counts[name] for name in ("lag", "delay", "friction", "stiffness")]
    # 90 of 100, and chance with sixty intervals; if they were half as wide, 59 of 100 would cover.
    assert np.mean(np.concatenate(of_four)) >= 0.85
    assert min(map(np.mean, of_four)) >= 0.75


# What is not identified.


def test_what_did_not_move_is_named(arm: pp.Arm) -> None:
    log = log_of()
    commands = np.array(log.commands)
    commands[:, 1] *= 0.1
    positions = followed(commands, MODEL)
    result = identify(arm, Log(log.command_time, commands, log.time, positions))
    name = arm.joint_names[1]
    assert result.joints[name].lag is None
    assert "it moved by" in result.not_identified[f"{name}: drive"]
    still = Log(log.command_time, commands * 0.0, log.time, positions * 0.0)
    nothing = identify(arm, still)
    assert nothing.not_identified["lag"] == "no joint moved"
    with pytest.raises(InvalidValue, match="no joint moved"):
        _ = nothing.model


def test_delay_is_not_told_from_the_lag_of_slow_commands(arm: pp.Arm) -> None:
    rng = np.random.default_rng(3)
    slow = log_of(frequency=0.05, seconds=40.0)
    noisy = np.array(slow.positions) + 0.01 * np.cumsum(rng.normal(0.0, 0.03, slow.positions.shape), axis=0)
    result = identify(arm, Log(slow.command_time, slow.commands, slow.time, noisy))
    assert result.drives.delay is None
    assert "commands change too slowly" in result.not_identified["delay"]
    assert result.model.delay == 0.0


@pytest.mark.parametrize(
    ("about", "reason"),
    [
        ({}, "attitude of the arm is not known"),
        ({"gravity": (0.0, 0.0, -9.81), "in_contact": True}, "touched something"),
        ({"gravity": (0.0, 0.0, 0.0)}, "no gravity"),
    ],
)
def test_weight_is_told_only_of_a_free_arm_of_known_attitude(arm: pp.Arm, about, reason: str) -> None:
    result = identify(arm, log_of(**about))
    assert result.drives.stiffness is None
    assert result.payload is None
    assert reason in result.not_identified["stiffness"]
    assert reason in result.not_identified["payload"]


def test_positions_that_ignore_commands_are_not_a_drive(arm: pp.Arm) -> None:
    log = log_of()
    rng = np.random.default_rng(4)
    result = identify(
        arm, Log(log.command_time, rng.normal(size=log.commands.shape), log.time, log.positions)
    )
    assert result.drives.lag is None
    assert "of the variance" in result.not_identified["lag"]


def test_other_joints_and_joints_without_measurements_are_named(arm: pp.Arm) -> None:
    log = log_of()
    first = arm.joint_names[0]
    result = identify(arm, Log(log.command_time, log.commands, log.time, log.positions, (first, "gripper")))
    assert result.not_identified["gripper"] == "it is no joint of the arm"
    assert result.not_identified[arm.joint_names[1]] == "it is not in the log"
    lost = np.array(log.positions)
    lost[:, 1] = np.nan
    result = identify(arm, Log(log.command_time, log.commands, log.time, lost))
    assert "0 measurements" in result.not_identified[arm.joint_names[1]]
    assert result.drives.lag.value == pytest.approx(0.2, abs=3e-3)


def test_positions_in_degrees_that_are_not_said_to_be_are_refused(arm: pp.Arm) -> None:
    log = log_of()
    with pytest.raises(InvalidValue, match="degrees"):
        identify(
            arm, Log(log.command_time, np.rad2deg(log.commands), log.time, 3.0 * np.rad2deg(log.positions))
        )


def test_logs_of_another_arm_are_refused(arm: pp.Arm) -> None:
    log = log_of()
    with pytest.raises(InvalidValue, match="joints of the arm"):
        identify(arm, Log(log.command_time, log.commands, log.time, log.positions, ("a", "b")))
    with pytest.raises(InvalidValue, match="columns without names"):
        identify(template_arm("RyRz", 2), log)
    for given in (None, [], [log, 3], "log"):
        with pytest.raises(InvalidValue, match="a Log"):
            identify(arm, given)


def test_of_coupled_joints_the_driven_one_is_read() -> None:
    text = """<robot name="pair"><link name="base"/><link name="l1"/><link name="l2"/><link name="tip"/>
      <joint name="j1" type="revolute"><parent link="base"/><child link="l1"/><axis xyz="0 1 0"/>
        <limit lower="-3" upper="3" effort="1" velocity="1"/>
        <mimic joint="j2" multiplier="-0.5" offset="0.1"/></joint>
      <joint name="j2" type="revolute"><parent link="l1"/><child link="l2"/><origin xyz="0.1 0 0"/>
        <axis xyz="0 1 0"/><limit lower="-3" upper="3" effort="1" velocity="1"/></joint>
      <joint name="end" type="fixed"><parent link="l2"/><child link="tip"/><origin xyz="0.1 0 0"/></joint>
    </robot>"""
    arm = pp.Arm.load(text, split=2)
    assert arm.joint_names == ("j1",) and arm.drives.names == ("j2",)
    log = log_of()
    one = (log.command_time, log.commands[:, :1], log.time, log.positions[:, :1])
    found = identify(arm, Log(*one, ("j2",))).drives
    assert found.lag.value == pytest.approx(0.2, abs=3e-3)
    assert found.friction.value == pytest.approx(0.025, abs=1e-3)  # as an angle of j1, which leads in the arm
    assert identify(arm, Log(*one)).drives.friction == found.friction
    assert identify(arm, Log(*one, ("j1",))).drives.friction.value == pytest.approx(0.05, abs=2e-3)
