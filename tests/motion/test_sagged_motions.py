"""Motions of arms that sag: the commands that are sent against it, and their limits."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from arms import template_arm

import pinposture as pp
from pinposture.errors import InvalidValue, MotionError, NoEquilibrium, WeightUnknown
from pinposture.motion.joint_trajectory import find_peaks
from pinposture.motion.words import in_words


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
    assert np.abs(sent.configurations(arm) - q).max() > 1e-4


# Verdicts.


def test_a_verdict_says_how_far_the_loaded_arm_is_off() -> None:
    arm = elastic(8.0)
    run = run_to(arm)
    sagged = arm.at(arm.sag(run.q[-1])).points
    off = float(np.linalg.norm(sagged - run.points[-1], axis=1).mean())
    assert run.sagged.error == pytest.approx(off)
    assert run.faults == ()
    assert (
        f"; under load the arm ends {1e3 * off:.3g} mm from there, in the mean of its points" in run.verdict
    )
    assert run.summary()["sag"]["mean_error"] == pytest.approx(off)
    plain = run_to(template_arm("RyRz", 8))
    assert plain.sagged is None
    assert plain.summary()["sag"] is None
    assert in_words(run.summary())["sag"].startswith(f"under load the arm ends {1e3 * off:.3g} mm off")
    assert "sag" not in in_words(plain.summary())
    assert "load" not in plain.verdict


def test_an_arm_that_sags_into_an_obstacle_is_not_for_a_robot_unless_compensated() -> None:
    arm = elastic(8.0)
    goal = pp.Target.from_configuration(arm, np.zeros(arm.nq))
    start = np.tile([-0.2, 0.0], 8)
    sagged = arm.at(arm.sag(arm.straight())).points[-1]
    below = pp.Box(center=(sagged[0], 0.0, sagged[2] - 0.01), size=(0.04, 0.2, 0.02))
    run = pp.track(arm, goal, start, scene=pp.Scene({"table": below}, margin=0.001))
    assert run.converged
    model = pp.CollisionModel(arm, run.scene)
    distances = [model.minimum(arm.sag(q)).distance for q in run.q]
    row = int(np.argmin(distances))
    assert distances[row] < 0.0 < run.clearance.min()
    [fault] = run.faults
    assert fault.startswith("under load, ")
    assert fault.endswith(f"penetrate by {-1e3 * distances[row]:.3g} mm after {row} steps")
    assert run.summary()["sag"]["clearance"] == pytest.approx(distances[row])
    with pytest.raises(MotionError, match="under load, "):
        run.joint_trajectory(0.1)
    run.joint_trajectory(0.1, compensate=True)


def test_an_arm_that_gives_way_under_load_is_not_for_a_robot() -> None:
    upright = pin.SE3(pin.rpy.rpyToMatrix(0.0, -np.pi / 2.0, 0.0), np.zeros(3))
    arm = pp.Arm.from_template("RyRz", 8, base_placement=upright).with_stiffness(0.2)
    run = pp.track(arm, pp.Target.from_configuration(arm, arm.straight()), np.tile([0.2, 0.0], 8))
    assert run.sagged.error is None
    assert in_words(run.summary())["sag"].startswith("the arm has no stable rest, first after")
    [fault] = run.faults
    assert fault == f"under load, joint 'm01_j1_y' gives way after {run.sagged.row} steps"
    with pytest.raises(NoEquilibrium):
        run.joint_trajectory(0.1, compensate=True)
