"""What measurements do to where a command aims, against the loop as a linear differential equation."""

from __future__ import annotations

import numpy as np
import pytest
from arms import template_arm
from scipy.linalg import expm

import pinposture as pp
from pinposture.errors import InvalidValue
from pinposture.motion import Tracker
from pinposture.motion.feedback import FEEDBACK, Feedback
from pinposture.placement import Target

pytestmark = pytest.mark.filterwarnings("ignore:velocity .* is above")

LAG = 0.05
DT = 1e-3
FREE = pp.Limits(step=None, velocity=1e5, dt=DT)


@pytest.fixture(scope="session")
def arm() -> pp.Arm:
    return template_arm("RyRz", 4)


@pytest.fixture(scope="session")
def one() -> pp.Arm:
    return template_arm("Rz", 1)


def response(period: float, target: float, sag: float, seconds: float) -> np.ndarray:
    """The joint of the closed loop, sampled: T_s q' = c + sag - q, T b' = q - c - b, c = target - b."""
    matrix = np.array([[-1.0 / LAG, -1.0 / LAG], [1.0 / period, 0.0]])
    given = np.array([(target + sag) / LAG, -target / period])
    rest = -np.linalg.solve(matrix, given)
    times = np.arange(0.0, seconds, DT)
    return np.array([(rest + expm(matrix * t) @ -rest)[0] for t in times])


def driven(tracker: Tracker, q: np.ndarray, sag: np.ndarray | float, steps: int) -> np.ndarray:
    """Configurations of an arm whose drives follow the command with a lag, and sag."""
    dt = tracker.limits.dt
    found = []
    for _ in range(steps):
        found.append(q)
        tracker.step(q)
        arm = tracker.arm
        wanted = arm.integrate(tracker.command, np.broadcast_to(sag, arm.nv))
        # Exact for a command that stays as it is for a cycle.
        q = arm.integrate(q, (1.0 - np.exp(-dt / LAG)) * arm.difference(q, wanted))
    return np.array(found)


@pytest.mark.long
@pytest.mark.parametrize("controller", ["joint", "geodesic"])
@pytest.mark.parametrize("ratio", [1.0, 4.0, 10.0])
def test_the_loop_is_the_one_of_the_characteristic_polynomial(
    one: pp.Arm, controller: str, ratio: float
) -> None:
    tracker = Tracker(one, controller, FREE, feedback_time_constant=ratio * LAG)
    tracker.update(Target.from_configuration(one, np.array([0.1])))
    steps = 1000
    found = driven(tracker, np.zeros(1), 0.02, steps)[:, 0]
    theory = response(ratio * LAG, 0.1, 0.02, steps * DT)[:steps]
    assert np.abs(found - theory).max() < 0.03 * 0.1  # a cycle is a fiftieth of the lag
    # The roots of T T_s s^2 + T s + 1 are real from T = 4 T_s on: it does not swing on and on.
    swings = np.count_nonzero(np.diff(np.sign(np.round(found[1:] - 0.1, 4))))
    assert (ratio**2 - 4.0 * ratio >= 0.0) == (ratio >= 4.0)
    assert swings > 4 if ratio == 1.0 else swings <= 4
    assert found.max() / 0.1 - 1.0 == pytest.approx(theory.max() / 0.1 - 1.0, abs=0.03)
    assert found[-1] == pytest.approx(theory[-1], abs=2e-4)
    assert found[-1] == pytest.approx(0.1, abs=5e-3)


@pytest.mark.long
@pytest.mark.parametrize("controller", ["geodesic", "joint"])
@pytest.mark.parametrize("seed", range(2))
def test_an_arm_that_sags_and_lags_takes_the_posture_all_the_same(
    arm: pp.Arm, seed: int, controller: str
) -> None:
    rng = np.random.default_rng(seed)
    limits = pp.Limits(step=None, velocity=2.0, dt=0.01, acceleration=10.0)
    wanted = rng.uniform(-1, 1, arm.nv)
    sag = 0.03 * rng.normal(size=arm.nv)
    ends = {}
    for feedback in (0.25, np.inf):
        tracker = Tracker(arm, controller, limits, feedback_time_constant=feedback)
        tracker.update(Target.from_configuration(arm, wanted))
        path = driven(tracker, rng.uniform(-1, 1, arm.nv), sag, 500)
        ends[feedback] = np.abs(path[-1] - wanted).max()
        if controller == "joint":  # the way of "geodesic" is direct for points, and need not be for joints
            beyond = (path - wanted) * np.sign(wanted - path[0])
            assert beyond.max() < 0.1
    assert ends[0.25] < 1e-5
    assert ends[np.inf] == pytest.approx(np.abs(sag).max(), rel=1e-3)


@pytest.mark.long
def test_a_sag_that_would_need_a_command_beyond_the_limits_is_made_good_as_far_as_they_go() -> None:
    arm = pp.Arm.from_modules([pp.template("RyRz").with_limits(-0.5, 0.5)] * 3)
    limits = pp.Limits(step=None, velocity=2.0, dt=0.01, acceleration=10.0)
    tracker = Tracker(arm, "geodesic", limits)
    tracker.update(Target.from_configuration(arm, np.full(arm.nv, 0.49)))
    path = driven(tracker, np.zeros(arm.nv), -0.05, 400)
    assert tracker.command.max() <= 0.5 + 1e-12
    np.testing.assert_allclose(path[-1], 0.45, atol=1e-5)


@pytest.mark.long
def test_without_a_known_configuration_points_are_shifted_by_as_much(arm: pp.Arm) -> None:
    limits = pp.Limits(step=None, velocity=2.0, dt=0.01, acceleration=10.0)
    rng = np.random.default_rng(5)
    wanted = rng.uniform(-0.8, 0.8, arm.nv)
    sag = 0.02 * rng.normal(size=arm.nv)
    points = arm.at(wanted).points
    tracker = Tracker(arm, "geodesic", limits)
    tracker.update(Target.from_points(arm, points))
    path = driven(tracker, wanted + 0.2, sag, 900)
    off = np.linalg.norm(arm.at(path[-1]).points - points, axis=1).mean()
    assert off < 1e-3 * arm.length and tracker.report.mean_error == pytest.approx(off, abs=1e-6)


def longer(arm: pp.Arm, factor: float) -> pp.Arm:
    return pp.Arm.from_template("RyRz", arm.n_modules, (0.025 * factor, 0.025 * factor))


@pytest.mark.long
@pytest.mark.parametrize("interface", ["position", "velocity"])
def test_points_seen_from_outside_make_good_what_the_model_has_wrong(interface: str) -> None:
    model = pp.Arm.from_template("RyRz", 5, (0.025, 0.025))
    real = longer(model, 1.04)
    limits = pp.Limits(step=None, velocity=2.0, dt=0.02, acceleration=10.0)
    wanted = real.at(np.linspace(-0.5, 0.5, real.nv)).points
    off = {}
    for seen in (False, True):
        tracker = Tracker(model, "geodesic", limits, interface=interface)
        tracker.update(Target.from_points(model, wanted))
        q = 0.1 * np.ones(model.nv)
        for _ in range(500):
            points = real.at(q).points
            dq = tracker.step(q, points=points if seen else None)
            q = tracker.command if interface == "position" else q + dq
        off[seen] = np.linalg.norm(real.at(q).points - wanted, axis=1).mean()
        if seen:
            assert tracker.report.mean_error == pytest.approx(off[seen], rel=0.05, abs=1e-6)
    assert off[True] < 0.15 * off[False] and off[False] > 2e-3 * real.length


def test_points_that_are_not_seen_or_cannot_be_count_for_nothing(arm: pp.Arm) -> None:
    q = np.linspace(-0.3, 0.3, arm.nv)
    right = arm.at(q).points
    feedback = Feedback(arm, 0.25, 0.3, 0.5)
    feedback.update(q, right, 0.01)
    for spoilt in (np.nan, np.inf, -np.inf, 1e300, FEEDBACK.max_point_offset * arm.length * 1.01):
        points = right.copy()
        points[2, 1] += spoilt
        feedback.update(q, points, 0.01)
        np.testing.assert_allclose(feedback.points, right, atol=1e-12)
    target = Target.from_configuration(arm, q)
    assert feedback.compensate(target) is target


def test_estimates_follow_with_their_time_constant(arm: pp.Arm) -> None:
    q = np.zeros(arm.nv)
    off = 0.01
    feedback = Feedback(arm, 0.5, 0.3, 0.5)
    feedback.update(q, None, 0.02)
    feedback.apply_step(np.zeros(arm.nv))
    target = Target.from_configuration(arm, 0.2 * np.ones(arm.nv))
    for _ in range(30):
        feedback.update(q + off, None, 0.02)
        feedback.apply_step(np.zeros(arm.nv))
    shifted = feedback.compensate(target)
    np.testing.assert_allclose(shifted.q, 0.2 - off * (1.0 - np.exp(-30 * 0.02 / 0.5)), rtol=1e-9)
    np.testing.assert_allclose(shifted.points, arm.at(shifted.q).points, atol=1e-12)
    assert feedback.compensate(target) is shifted  # nothing has changed: the same target, so that ways stay


def far_off(feedback: Feedback, moving: bool, cycles: int) -> int | None:
    """After how many cycles an arm that is measured elsewhere is taken to be there; None if it is not."""
    nv = feedback.arm.nv
    feedback.update(np.zeros(nv), None, 0.01)
    far = np.full(nv, 1.0)
    for cycle in range(cycles):
        feedback.apply_step(np.full(nv, 1e-6 if moving else 0.0))
        seen = feedback.update(far, None, 0.01)
        if feedback.restarted:
            np.testing.assert_array_equal(seen.state.q, far)
            assert seen.reason == "" and seen.tracking_error == 0.0
            return cycle
        assert "from its expected position" in seen.reason
        assert seen.tracking_error == pytest.approx(1.0, abs=1e-3)
        assert np.abs(feedback.command).max() < 1e-3
    return None


def test_what_is_far_off_is_believed_only_when_repeated_by_an_arm_at_rest(arm: pp.Arm) -> None:
    assert far_off(Feedback(arm, 0.25, 0.3, 0.5), False, 200) == pytest.approx(50, abs=1)
    assert far_off(Feedback(arm, 0.25, 0.3, 0.5), True, 200) is None
    assert far_off(Feedback(arm, 0.25, 0.3, np.inf), False, 200) is None
    assert far_off(Feedback(arm, 0.25, 1.1, 0.5), False, 0) is None


def test_wrong_shapes_are_faults_of_the_program(arm: pp.Arm) -> None:
    feedback = Feedback(arm, 0.25, 0.3, 0.5)
    with pytest.raises(InvalidValue, match="q_measured"):
        feedback.update(np.zeros(arm.nq + 1), None, 0.01)
    with pytest.raises(InvalidValue, match="q_measured"):
        feedback.update("here", None, 0.01)
    with pytest.raises(InvalidValue, match="points"):
        feedback.update(None, np.zeros((arm.n_modules, 2)), 0.01)
    for bad in (None, np.full(arm.nq, np.nan)):
        seen = feedback.update(bad, None, 0.01)
        assert seen.state is None and seen.reason and seen.tracking_error is None
