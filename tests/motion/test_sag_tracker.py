"""A tracker that compensates sag, with drives whose joints rest where springs balance the load."""

from __future__ import annotations

from itertools import cycle

import numpy as np
import pytest
from arms import template_arm
from scipy.optimize import fsolve

import pinposture as pp
from pinposture.errors import InvalidValue, WeightUnknown
from pinposture.motion import Tracker

DT = 0.02
LIMITS = pp.Limits(step=None, dt=DT, velocity=1.0, acceleration=6.0)
SMOOTH = pp.Limits(step=None, dt=DT, velocity=1.0, acceleration=6.0, jerk=80.0)
GOAL = np.tile([-0.2, 0.1], 5)


def elastic(stiffness: float = 8.0) -> pp.Arm:
    return template_arm("RyRz", 5).with_payload(0.1).with_stiffness(stiffness)


def resting(arm: pp.Arm, command: np.ndarray, near: np.ndarray) -> np.ndarray:
    """Where springs balance the load, by a solver of its own."""

    def unbalanced(q: np.ndarray) -> np.ndarray:
        return arm.stiffness @ (q - command) + arm.at(q).gravity_torques

    return np.asarray(fsolve(unbalanced, near, xtol=1e-10))


def follow(
    tracker: Tracker, arm: pp.Arm, goal: np.ndarray, cycles: int = 150, durations=(None,)
) -> tuple[np.ndarray, np.ndarray]:
    """Let an arm on springs follow at once; return the sent and the measured positions."""
    tracker.update(pp.Target.from_configuration(arm, goal))
    measured = np.zeros(arm.nv)
    sent = [np.asarray(arm.compensate(measured))]
    met = [measured]
    for _, duration in zip(range(cycles), cycle(durations), strict=False):
        tracker.step(met[-1], duration)
        sent.append(tracker.positions)
        met.append(resting(arm, sent[-1], met[-1]))
    return np.array(sent), np.array(met)


def test_the_loaded_arm_is_where_the_target_is_without_any_feedback() -> None:
    arm = elastic()
    tracker = Tracker(arm, limits=LIMITS, compensate=True, feedback_time_constant=np.inf)
    sent, met = follow(tracker, arm, GOAL)
    assert tracker.report.status == "converged"
    np.testing.assert_allclose(met[-1], GOAL, atol=1e-8)
    np.testing.assert_allclose(sent[-1], arm.compensate(GOAL), atol=1e-8)
    np.testing.assert_allclose(tracker.command, sent[-1])
    assert np.abs(sent[-1] - GOAL).max() > 0.02
    np.testing.assert_allclose(met[1], met[0], atol=3e-3)  # drives that hold the arm do not jump
    plain = Tracker(arm, limits=LIMITS, feedback_time_constant=np.inf)
    _, sagged = follow(plain, arm, GOAL)
    assert np.abs(sagged[-1] - GOAL).max() > 0.02
    assert plain.report.status == "stalled"


@pytest.mark.long
def test_feedback_corrects_what_is_left_of_a_wrong_payload() -> None:
    arm = elastic()
    guess = template_arm("RyRz", 5).with_payload(0.08).with_stiffness(8.0)
    open_loop = Tracker(guess, limits=LIMITS, compensate=True, feedback_time_constant=np.inf)
    _, off = follow(open_loop, arm, GOAL)
    alone = Tracker(arm, limits=LIMITS, feedback_time_constant=np.inf)
    _, sagged = follow(alone, arm, GOAL)
    assert 0.0 < np.abs(off[-1] - GOAL).max() < 0.2 * np.abs(sagged[-1] - GOAL).max()
    closed = Tracker(guess, limits=LIMITS, compensate=True)
    _, corrected = follow(closed, arm, GOAL, 300)
    assert closed.report.status == "converged"
    np.testing.assert_allclose(corrected[-1], GOAL, atol=2e-6)


@pytest.mark.long
@pytest.mark.parametrize("limits", [LIMITS, SMOOTH], ids=["acceleration", "jerk"])
@pytest.mark.parametrize("durations", [(None,), (0.02, 0.007, 0.03, 0.015)], ids=["even", "uneven"])
def test_what_is_sent_keeps_all_limits(limits: pp.Limits, durations) -> None:
    arm = elastic(4.0)
    tracker = Tracker(arm, limits=limits, compensate=True)
    found: set[str] = set()
    tracker.update(pp.Target.from_configuration(arm, GOAL))
    q = np.zeros(arm.nv)
    before = q
    sent = []
    rng = np.random.default_rng(0)
    for number, duration in zip(range(400), cycle(durations), strict=False):
        if number in (60, 90, 200):  # another target on the way
            tracker.update(pp.Target.from_configuration(arm, rng.uniform(-0.4, 0.4, arm.nv)))
        dq = tracker.step(q, duration)
        found.update(tracker.report.violated_constraints)
        if number:
            np.testing.assert_allclose(tracker.positions - before, dq, atol=1e-12)
        before = tracker.positions
        sent.append(before)
        q = resting(arm, before, q)
    assert not found
    if durations == (None,):
        steps = np.diff(sent, axis=0)
        assert np.abs(steps).max() <= 1.0 * DT * (1.0 + 1e-6)
        assert np.abs(np.diff(steps, axis=0)).max() <= 6.0 * DT**2 * (1.0 + 1e-6)
        if limits is SMOOTH:
            assert np.abs(np.diff(steps, n=2, axis=0)).max() <= 80.0 * DT**3 * (1.0 + 1e-6)
    np.testing.assert_allclose(tracker.positions, arm.compensate(arm.configuration(q)), atol=1e-5)


@pytest.mark.long
def test_limits_can_be_replaced_on_the_way() -> None:
    arm = elastic(4.0)
    tracker = Tracker(arm, limits=LIMITS, compensate=True)
    tracker.update(pp.Target.from_configuration(arm, GOAL))
    q = np.zeros(arm.nv)
    for number in range(500):
        if number == 20:
            tracker.limits = SMOOTH
        if number == 150:
            tracker.limits = pp.Limits(step=None, dt=DT, velocity=0.5, acceleration=3.0)
            tracker.update(pp.Target.from_configuration(arm, -GOAL))
        tracker.step(q)
        q = resting(arm, tracker.positions, q)
        if number not in range(20, 40) and number not in range(150, 170):
            assert not tracker.report.violated_constraints
    assert tracker.report.status == "converged"
    np.testing.assert_allclose(q, -GOAL, atol=1e-6)


def test_a_joint_at_its_limit_says_what_it_lacks_to_compensate() -> None:
    arm = elastic(4.0)
    upper = arm.limits.upper[0]
    lower = arm.limits.lower[0]
    goal = np.zeros(arm.nv)
    goal[0] = lower + 0.01  # against the load, the drive would have to go beyond
    tracker = Tracker(arm, limits=LIMITS, compensate=True)
    tracker.update(pp.Target.from_configuration(arm, goal))
    q = np.zeros(arm.nv)
    for _ in range(250):
        tracker.step(q)
        q = resting(arm, tracker.positions, q)
        assert lower - 1e-9 <= tracker.positions[0] <= upper + 1e-9
    needed = arm.at(goal).gravity_torques[0] / 4.0
    if lower <= goal[0] + needed <= upper:
        assert not tracker.report.violated_constraints
    else:
        [text] = tracker.report.violated_constraints
        assert text.startswith(f"position limit: joint {arm.joint_names[0]!r} lacks")


def test_what_cannot_be_compensated_is_refused() -> None:
    arm = elastic()
    with pytest.raises(WeightUnknown, match="stiffness"):
        Tracker(template_arm("RyRz", 5), limits=LIMITS, compensate=True)
    with pytest.raises(InvalidValue, match="False for drives that are sent velocities"):
        Tracker(arm, limits=LIMITS, compensate=True, interface="velocity")
    with pytest.raises(InvalidValue, match="compensate"):
        Tracker(arm, limits=LIMITS, compensate=1)
    assert Tracker(arm, limits=LIMITS, compensate=True).compensates
    assert not Tracker(arm, limits=LIMITS).compensates


def test_it_starts_anew_where_the_arm_is() -> None:
    arm = elastic()
    tracker = Tracker(arm, limits=LIMITS, compensate=True)
    tracker.restart(GOAL)
    np.testing.assert_allclose(tracker.positions, arm.compensate(GOAL), atol=1e-9)
    tracker.restart(np.zeros(arm.nv), dq=np.full(arm.nv, 0.001))
    np.testing.assert_allclose(tracker.positions, arm.compensate(np.zeros(arm.nv)), atol=1e-9)


def test_limits_that_change_in_motion_are_kept_at_once() -> None:
    arm = elastic(4.0)
    tracker = Tracker(arm, limits=LIMITS, compensate=True)
    tracker.update(pp.Target.from_configuration(arm, GOAL))
    q = np.zeros(arm.nv)
    sent = []
    for number in range(60):
        if number in (6, 9, 12):
            tracker.limits = pp.Limits(step=None, dt=DT, velocity=1.5, acceleration=6.0 + number)
        tracker.step(q)
        assert not tracker.report.violated_constraints
        sent.append(tracker.positions)
        q = resting(arm, sent[-1], q)
    changes = np.abs(np.diff(sent, n=2, axis=0))
    assert changes[:4].max() <= 6.0 * DT**2 * (1.0 + 1e-6)
    assert changes.max() <= 18.0 * DT**2 * (1.0 + 1e-6)
