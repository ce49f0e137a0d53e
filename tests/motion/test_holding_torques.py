"""What results say of the torques that hold the arm: against Pinocchio's, row by row; nothing if unknown."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from arms import template_arm

import pinposture as pp
from pinposture.arm import JointLoad, smooth_configuration
from pinposture.errors import MotionError
from pinposture.motion import Tracker
from pinposture.motion.words import in_words


def weak(effort: float) -> pp.Arm:
    """An arm that needs 0.37 N m to hold itself straight out, and less where it bends upwards."""
    return template_arm("RyRz", 8).with_effort(effort)


def straight_line(arm: pp.Arm) -> pp.Target:
    return pp.Target.from_configuration(arm, arm.straight())


def bent(arm: pp.Arm) -> np.ndarray:
    q = np.zeros(arm.nq)
    q[::2] = -0.4
    return q


def run_to_straight(arm: pp.Arm) -> pp.Run:
    return pp.track(arm, straight_line(arm), bent(arm))


def judged(arm: pp.Arm, rows: np.ndarray) -> tuple[float, int, int]:
    """The largest share, and its row and joint, by Pinocchio alone."""
    data = arm.model.createData()
    still = np.zeros(arm.nv)
    shares = [np.abs(pin.rnea(arm.model, data, q, still, still)) / arm.effort for q in rows]
    row, joint = np.unravel_index(int(np.argmax(shares)), np.shape(shares))
    return float(np.max(shares)), int(row), int(joint)


def test_a_run_that_no_motor_can_hold_is_not_for_a_robot() -> None:
    arm = weak(0.3)
    run = run_to_straight(arm)
    share, row, joint = judged(arm, run.q)
    assert run.converged
    assert share > 1.0
    told = run.summary()["holding_torque"]
    assert (told["joint"], told["after_steps"]) == (arm.joint_names[joint], row)
    assert told["share"] == pytest.approx(share)
    clause = f"joint 'm01_j1_y' needs 0.3698 of 0.3 N m to hold the arm after {row} steps"
    assert clause in run.verdict
    assert run.faults == (clause,)
    with pytest.raises(MotionError, match=re.escape(clause)):
        run.joint_trajectory(0.1)
    run.joint_trajectory(0.1, force=True)
    assert in_words(run.summary())["torque at rest"].startswith("at most 123 % (m01_j1_y after")


def test_a_run_that_motors_hold_says_how_near_they_are() -> None:
    run = run_to_straight(weak(1.0))
    assert run.faults == ()
    assert run.summary()["holding_torque"]["share"] == pytest.approx(0.3698, abs=1e-4)
    assert in_words(run.summary())["torque at rest"].startswith("at most 37 %")


@pytest.mark.parametrize("unknown", ["limits", "masses"])
def test_nothing_is_said_where_masses_or_limits_are_not_known(unknown: str) -> None:
    arm = template_arm("RyRz", 4)
    if unknown == "masses":
        arm = pp.Arm.load(arm.urdf.replace("inertial", "ignored"), split=2).with_effort(1e-6)
    run = run_to_straight(arm)
    assert run.faults == ()
    assert run.summary()["holding_torque"] is None
    assert "torque at rest" not in in_words(run.summary())
    assert straight_line(arm).load(arm) is None


def test_a_target_and_a_reached_posture_say_it_before_the_motion() -> None:
    arm = weak(0.3)
    load = straight_line(arm).load(arm)
    assert isinstance(load, JointLoad)
    assert str(load) == "joint 'm01_j1_y' needs 0.3698 of 0.3 N m"
    points = pp.Target.from_points(arm, arm.at(arm.straight()).points)
    assert points.load(arm) is None
    (found,) = pp.reach(arm, (0.35, 0.05, 0.1), seed=0)
    share, _, joint = judged(arm, found.q[None])
    assert found.load is not None
    assert found.load.joint == arm.joint_names[joint]
    assert found.load.share == pytest.approx(share)
    assert found.summary()["holding_torque"]["share"] == pytest.approx(share)
    assert ("needs" in repr(found)) == (share > 1.0)


def test_keyframes_that_cannot_be_held_are_named() -> None:
    arm = weak(0.3)
    up = tuple(bent(arm))
    keyframes = [
        pp.Keyframe(joints=up, name="up"),
        pp.Keyframe(joints=(0.0,) * 16, duration=2.0, name="out"),
        pp.Keyframe(joints=up, duration=2.0, name="back"),
    ]
    motion = pp.move_through(arm, keyframes, limits=pp.Limits(step=None, dt=0.05, velocity=1.0))
    told = {place["name"]: place["too_heavy"] for place in motion.summary()["keyframes"]}
    assert told["back"] is None
    assert told["out"] is not None and told["out"].startswith("joint 'm01_j1_y' needs 0.36")
    assert any("to hold the arm" in fault for fault in motion.faults)
    assert "needs" in in_words(motion.summary())["keyframes"]


def test_a_batch_counts_the_postures_that_cannot_be_held() -> None:
    arm = weak(0.3)
    starts = np.array([bent(arm), 0.5 * bent(arm)])
    batch = pp.track_many(arm, straight_line(arm), starts)
    found = "the final posture cannot be held in 2 of 2 runs, most in run"
    assert any(fault.startswith(found) for fault in batch.faults)
    assert pp.track_many(weak(1.0), straight_line(arm), starts).faults == ()


@pytest.mark.long
def test_a_tracker_names_each_step_that_needs_more_torque_than_there_is() -> None:
    """The limits become lower while the arm moves, so that it cannot brake within them."""
    rng = np.random.default_rng(3)
    arm = template_arm("RyRz", 6).with_effort(0.28)
    limits = pp.Limits(step=None, velocity=2.0, dt=0.01, effort=True)
    tracker = Tracker(arm, limits=limits)
    data = arm.model.createData()
    q = q0 = arm.straight()
    before = np.zeros(arm.nv)
    told = []
    effort = 0.28
    goal = smooth_configuration(arm, rng, 0.5)
    for cycle in range(200):
        if cycle == 20:
            effort = 0.15
            tracker.limits = replace(limits, effort=effort)
        moved = min(cycle / 100.0, 1.0) * arm.difference(q0, goal)
        tracker.update(pp.Target.from_configuration(arm, arm.integrate(q0, moved)))
        dq = tracker.step(q)
        speed = dq / limits.dt
        torques = pin.rnea(arm.model, data, q, (before + speed) / 2.0, (speed - before) / limits.dt)
        share = np.abs(torques / effort).max()
        words = [each for each in tracker.report.violated_constraints if "for this step" in each]
        if abs(share - 1.0) > 1e-5:
            assert bool(words) == (share > 1.0)
        for text in words:
            needed = float(re.search(rf"needs ([\d.]+) of {effort} N m for this step", text)[1])
            assert needed == pytest.approx(share * effort, rel=1e-3)
        told += words
        before = speed
        q = arm.integrate(q, dq)
    assert 0 < len(told) < 100
