"""Motions of arms that sag: the commands that are sent against it, and their limits."""

from __future__ import annotations

import numpy as np
import pytest
from arms import template_arm

import pinposture as pp
from pinposture.errors import InvalidValue, MotionError, WeightUnknown


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
    assert run.faults == ()
    with pytest.raises(MotionError, match="of the commands against sag, limits are exceeded in") as caught:
        run.joint_trajectory(compensate=True)
    advice = str(caught.value).partition("lower by a factor of ")[2]
    factor = float(advice.split(";")[0].split()[0])
    assert 1.0 < factor < 1.2
    forced = run.joint_trajectory(force=True, compensate=True)
    assert np.abs(np.diff(forced.positions, axis=0)).max() <= 1.0 * 0.02 * factor * (1.0 + 1e-9)
    slower = pp.Limits(step=None, velocity=1.0 / factor, acceleration=8.0 / factor, dt=0.02)
    steps = np.diff(run_to(arm, slower).joint_trajectory(compensate=True, force=True).positions, axis=0)
    assert np.abs(steps).max() <= 0.02 * 1.001


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
    assert sent.time.tolist() == plain.time.tolist()
    np.testing.assert_allclose(arm.sag(sent.positions), plain.positions, atol=1e-9)


def test_commands_against_sag_are_those_of_the_joints_that_drives_move() -> None:
    text = template_arm("RyRz", 4).urdf
    arm = pp.Arm.load(text, couplings={"m01_j1_y": ("m02_j1_y", -0.5, 0.1)}).with_stiffness(30.0)
    q = np.linspace(0.0, 0.2, 5)[:, None] * np.ones(arm.nv)
    sent = pp.JointTrajectory.from_configurations(arm, q, 0.1).compensated(arm)
    assert sent.joint_names[0] == "m02_j1_y"
    np.testing.assert_allclose(arm.sag(sent.configurations(arm)), q, atol=1e-9)
    assert np.abs(sent.configurations(arm) - q).max() > 1e-3
