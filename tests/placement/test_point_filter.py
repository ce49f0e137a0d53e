"""Noisy measured points as smooth targets: against a Kalman filter written out, and by what comes of them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sampling import examples

import pinposture as pp
from pinposture.arm import smooth_configuration
from pinposture.control.measured_points import stationary_gains
from pinposture.errors import InvalidValue

DT = 0.01
NOISE = 1e-3


def arm_of(modules: int = 20) -> pp.Arm:
    return pp.Arm.from_template("RyRz", modules=modules)


@given(st.floats(-4.0, 3.0))
@examples(30)
def test_the_gains_are_those_to_which_the_riccati_equation_converges(exponent: float) -> None:
    ratio = 10.0**exponent  # acceleration and noise are one, and so is the cycle, but for this
    step = np.array([[1.0, 1.0], [0.0, 1.0]])
    jolt = ratio * np.array([0.5, 1.0])
    covariance = np.diag([1e3, 1e3])
    for _ in range(4000):
        foreseen = step @ covariance @ step.T + np.outer(jolt, jolt)
        gain = foreseen[:, 0] / (foreseen[0, 0] + 1.0)
        covariance = foreseen - np.outer(gain, foreseen[0])
    alpha, beta = stationary_gains(np.array(ratio))
    assert (alpha, beta) == pytest.approx(gain, rel=2e-3, abs=1e-9)


def moving(arm: pp.Arm, cycles: int) -> np.ndarray:
    """A posture that swings to another and back, every four seconds, (cycles, nv) [rad]."""
    one, other = (smooth_configuration(arm, np.random.default_rng(seed), 0.5) for seed in (1, 2))
    swing = 0.5 - 0.5 * np.cos(2.0 * np.pi * 0.25 * DT * np.arange(cycles))
    return one + swing[:, None] * (other - one)


def filtered(arm: pp.Arm, wanted: np.ndarray, noise: float, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    smooth = pp.PointFilter(arm, DT, NOISE)
    points = arm.kinematics.points(wanted)
    measured = points + noise * rng.normal(size=points.shape)
    return np.array([arm.positions(smooth.update(each).q) for each in measured])


@pytest.mark.long
def test_noise_of_a_millimetre_moves_joints_little_and_delays_them_less_than_two_cycles() -> None:
    """20 modules, 1 m: least squares in each cycle would be 0.08 rad off (rms), and jump by as much."""
    arm = arm_of()
    wanted = moving(arm, 1200)
    found = filtered(arm, wanted, NOISE)[200:]
    wanted = wanted[200:]
    jitter = np.diff(found - wanted, axis=0)
    assert jitter.std() < 0.01
    assert (found - wanted).std() < 0.03
    speed = np.gradient(wanted, axis=0)
    assert -np.sum((found - wanted) * speed) / np.sum(speed * speed) < 2.0  # cycles
    raw = [arm.positions(pp.fit_points(arm, each).q) for each in noisy_points(arm, wanted[:20])]
    assert np.std(np.array(raw) - wanted[:20]) > 0.05


def noisy_points(arm: pp.Arm, wanted: np.ndarray) -> np.ndarray:
    points = arm.kinematics.points(wanted)
    return points + NOISE * np.random.default_rng(3).normal(size=points.shape)


@pytest.mark.long
def test_a_steady_motion_without_noise_is_followed_without_delay() -> None:
    arm = arm_of(6)
    begin = smooth_configuration(arm, np.random.default_rng(0), 0.3)
    speed = np.linspace(-0.15, 0.15, arm.nv)
    wanted = begin + DT * np.arange(1200)[:, None] * speed[None]
    smooth = pp.PointFilter(arm, DT, NOISE)
    for each in arm.kinematics.points(wanted):
        target = smooth.update(each)
    np.testing.assert_allclose(arm.positions(target.q), wanted[-1], atol=2e-3)
    np.testing.assert_allclose(target.velocity, speed, atol=2e-2)
    still = [smooth.update(arm.kinematics.points(wanted[-1:])[0]) for _ in range(1500)][-1]
    np.testing.assert_allclose(arm.positions(still.q), wanted[-1], atol=1e-6)


@pytest.mark.long
def test_the_arm_follows_noisy_points_smoothly() -> None:
    arm = arm_of()
    limits = pp.Limits(step=None, dt=DT, velocity=2.0, acceleration=10.0)
    wanted = moving(arm, 700)
    tracker = pp.Tracker(arm, limits=limits)
    smooth = pp.PointFilter(arm, DT, NOISE)
    q = wanted[0]
    steps = []
    errors = []
    tracker.restart(q)
    for each, goal in zip(noisy_points(arm, wanted), wanted, strict=True):
        tracker.update(smooth.update(each))
        steps.append(tracker.step(q))
        q = arm.integrate(q, steps[-1])
        errors.append(np.linalg.norm(arm.at(q).points - arm.at(goal).points, axis=1).mean())
    dq = np.array(steps[200:])
    speed = np.gradient(wanted, axis=0)[200:]
    assert (dq - speed).std() < 0.01
    assert np.abs(np.diff(dq, axis=0)).max() <= 10.0 * DT**2 * (1.0 + 1e-9)
    assert np.mean(errors[200:]) < 5.0 * NOISE  # three coordinates, and limits of acceleration


def test_points_that_are_not_seen_are_left_out_and_a_jump_begins_anew() -> None:
    arm = arm_of(8)
    rng = np.random.default_rng(0)
    q = smooth_configuration(arm, rng, 0.4)
    points = arm.at(q).points.copy()
    smooth = pp.PointFilter(arm, DT, NOISE)
    smooth.update(points)
    hidden = points.copy()
    hidden[2:4] = np.nan
    np.testing.assert_allclose(smooth.update(hidden).points, points, atol=1e-9)
    target = smooth.update(np.full_like(points, np.nan))
    assert not target.velocity.any()
    other = arm.at(smooth_configuration(arm, rng, 0.8)).points
    jumped = smooth.update(other)
    np.testing.assert_allclose(jumped.points, other, atol=1e-6)
    assert not jumped.velocity.any()
    assert np.all(np.abs(arm.positions(jumped.q)) <= arm.limits.upper)


@pytest.mark.parametrize("name", ["dt", "noise", "acceleration"])
def test_what_cannot_be_filtered_is_refused_by_name(name: str) -> None:
    arm = arm_of(3)
    given = {"dt": DT, "noise": NOISE, "acceleration": 3.0, name: 0.0}
    with pytest.raises(InvalidValue, match=name):
        pp.PointFilter(arm, **given)
    with pytest.raises(InvalidValue, match="points"):
        pp.PointFilter(arm, DT, NOISE).update(np.zeros((2, 3)))
    with pytest.raises(InvalidValue, match="weight"):
        pp.PointFilter(arm, DT, NOISE).update(np.full((3, 3), np.nan))
