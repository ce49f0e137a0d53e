"""Motions of arms that sag: the commands that are sent against it, and their limits."""

from __future__ import annotations

import numpy as np
import pytest
from arms import template_arm

import pinposture as pp
from pinposture.errors import InvalidValue, WeightUnknown
from pinposture.motion.joint_trajectory import find_peaks


def elastic(stiffness: float = 15.0) -> pp.Arm:
    return template_arm("RyRz", 8).with_stiffness(stiffness)


def run_to(arm: pp.Arm, limits: pp.Limits | None = None) -> pp.Run:
    target = pp.Target.from_configuration(arm, np.tile([-0.2, 0.1], 8))
    return pp.track(arm, target, arm.straight(), limits=limits)


def test_a_run_is_sent_as_the_commands_against_sag() -> None:
    arm = elastic()
    run = run_to(arm)
    sent = run.joint_trajectory(0.1, compensate=True)
    np.testing.assert_allclose(arm.sag(sent.positions), run.q, atol=1e-9)
    assert np.abs(sent.positions - run.q).max() > 0.005
    np.testing.assert_array_equal(run.joint_trajectory(0.1).positions, run.q)
    with pytest.raises(WeightUnknown, match="stiffness"):
        run_to(template_arm("RyRz", 8)).joint_trajectory(0.1, compensate=True)
    with pytest.raises(InvalidValue, match="compensate"):
        run.joint_trajectory(0.1, compensate="yes")


def test_commands_against_sag_keep_the_limits_of_the_run() -> None:
    arm = elastic()
    limits = pp.Limits(step=None, velocity=1.0, acceleration=8.0, dt=0.02)
    run = run_to(arm, limits)
    plain = run.joint_trajectory()
    sent = run.joint_trajectory(compensate=True)
    np.testing.assert_allclose(arm.sag(sent.positions), run.q, atol=1e-9)
    longer = sent.time[-1] / plain.time[-1]
    assert 1.0 < longer < 1.1
    peaks = find_peaks(sent.time, sent.positions)
    assert peaks.speeds.max() <= 1.0 + 1e-9
    assert peaks.accelerations.max() <= 8.0 + 1e-9
    assert max(peaks.speeds.max() / 1.0, peaks.accelerations.max() / 8.0) == pytest.approx(1.0)
    stiff = run_to(arm.with_stiffness(1e9), limits).joint_trajectory(compensate=True)
    assert stiff.time[-1] == pytest.approx(plain.time[-1], rel=1e-6)


def test_a_motion_in_time_is_sent_as_the_commands_against_sag() -> None:
    arm = elastic()
    keyframes = [
        pp.Keyframe(joints=tuple(arm.straight())),
        pp.Keyframe(joints=(-0.1, 0.05) * 8, duration=3.0),
    ]
    limits = pp.Limits(step=None, velocity=1.0, acceleration=8.0, dt=0.02)
    motion = pp.Task(arm, keyframes, limits).perform()
    sent = motion.joint_trajectory(compensate=True)
    plain = motion.joint_trajectory()
    assert 1.0 <= sent.time[-1] / plain.time[-1] < 1.1
    np.testing.assert_allclose(arm.sag(sent.positions), plain.positions, atol=1e-9)


def test_commands_against_sag_are_those_of_the_joints_that_drives_move() -> None:
    text = template_arm("RyRz", 4).urdf
    arm = pp.Arm.load(text, couplings={"m01_j1_y": ("m02_j1_y", -0.5, 0.1)}).with_stiffness(30.0)
    q = np.linspace(0.0, 0.2, 5)[:, None] * np.ones(arm.nv)
    sent = pp.JointTrajectory.from_configurations(arm, q, 0.1).compensated(arm)
    assert sent.joint_names[0] == "m02_j1_y"
    np.testing.assert_allclose(arm.sag(sent.configurations(arm)), q, atol=1e-9)
    assert np.abs(sent.configurations(arm) - q).max() > 1e-3
