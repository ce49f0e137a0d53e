"""Performing a motion in time with every controller: limits on all that leaves, and an honest report."""

from __future__ import annotations

import numpy as np
import pytest
from performed import ARMS, arm_named, check_motion, drawn, quintic, random_reference, reference_through

import pinposture as pp
from pinposture.control import CONTROLLERS
from pinposture.errors import PostureWarning
from pinposture.task import Reference, perform

KNOWN = ("geodesic", "selection", "projection", "switching", "joint", "lm", "dls")
EXACT = ("geodesic", "joint", "lm", "switching", "projection")
"""Those that come to within rounding of a configuration that the target knows, or nearly so."""


def limits_of(arm: pp.Arm, acceleration: float | None = 12.0, dt: float = 0.02) -> pp.Limits:
    brake = None if acceleration is None else acceleration * arm.joint_units
    return pp.Limits(step=None, velocity=2.0 * arm.joint_units, dt=dt, acceleration=brake)


def test_every_controller_is_here() -> None:
    assert set(KNOWN) <= set(CONTROLLERS)


@pytest.mark.parametrize("acceleration", [None, 12.0])
@pytest.mark.parametrize("name", ARMS)
@pytest.mark.parametrize("controller", KNOWN)
def test_limits_hold_and_the_report_is_honest(controller: str, name: str, acceleration: float | None) -> None:
    arm = arm_named(name)
    plans = ((2, 0.2),) if controller == "selection" else ((1, 1.5), (2, 0.2))  # it takes long to settle
    for seed, seconds in plans:
        reference = random_reference(arm, seed, 2, seconds, share=0.3)
        limits = limits_of(arm, acceleration)
        motion = perform(reference, controller, limits)
        check_motion(motion, limits)
        tolerance = 1e-6 * arm.length
        assert motion.converged == (motion.run.status == "converged")
        if motion.converged:
            assert motion.mean_error[-1] <= 1.01 * tolerance
        else:
            assert motion.mean_error[-1] > tolerance
            assert motion.run.status in ("stalled", "max_steps", "no_control_points") and motion.run.reason
        assert motion.time_scale >= 1.0 - 1e-9
        if controller in EXACT[:2]:
            assert motion.converged


@pytest.mark.parametrize("controller", EXACT)
def test_what_is_slow_enough_is_followed_closely(controller: str) -> None:
    arm = arm_named("spatial")
    reference = random_reference(arm, 3, 3, 4.0, share=0.2)
    limits = limits_of(arm)
    motion = perform(reference, controller, limits)
    assert motion.converged and motion.time_scale == pytest.approx(1.0, abs=1e-9)
    assert motion.mean_error.max() < 0.05 * arm.length / arm.n_modules


@pytest.mark.parametrize("controller", KNOWN[1:])
def test_time_waits_for_an_arm_that_falls_behind(controller: str) -> None:
    # Joints half as fast as the plan asks: the clock slows down, and the arm is never far behind.
    arm = arm_named("spatial")
    reference = random_reference(arm, 4, 2, 1.0, share=0.3)
    fastest = np.abs(np.diff(reference.offsets, axis=0)).max() / reference.interval
    motion = perform(reference, controller, pp.Limits(step=None, velocity=0.5 * fastest, dt=0.02))
    assert motion.time_scale > 1.4
    if motion.converged:
        assert motion.mean_error.max() < 0.35 * arm.length / arm.n_modules


@pytest.mark.long
def test_a_faster_plan_takes_no_longer() -> None:
    arm = arm_named("planar")
    rng = np.random.default_rng(5)
    stops = [drawn(arm, rng) for _ in range(2)]
    for controller in ("geodesic", "joint"):
        fast, slow = (
            perform(reference_through(arm, stops, seconds, 81), controller, limits_of(arm))
            for seconds in (0.1, 8.0)
        )
        assert fast.duration < slow.duration == pytest.approx(8.0)
        assert fast.planned == pytest.approx(0.1) and fast.time_scale > 5.0


@pytest.mark.parametrize("controller", KNOWN)
def test_an_arm_that_is_elsewhere(controller: str) -> None:
    arm = arm_named("spatial")
    rng = np.random.default_rng(6)
    reference = random_reference(arm, 6, 2, 2.0, share=0.2)
    q0 = reference.start + 0.2 * rng.normal(size=arm.nv)
    limits = limits_of(arm)
    motion = perform(reference, controller, limits, q0=q0)
    check_motion(motion, limits)
    np.testing.assert_array_equal(motion.q[0], q0)
    if motion.waypoints[0].row is None:
        assert "first posture" in motion.run.reason and motion.time_scale == 1.0
        assert motion.start_index == motion.steps
    else:
        assert 0 < motion.start_index == motion.waypoints[0].row
        assert motion.mean_error[motion.start_index] < 2e-6 * arm.length


@pytest.mark.parametrize("controller", ["selection", "lm"])
def test_what_cannot_be_done_is_given_up_and_said(controller: str) -> None:
    # Joints lock half way to the second posture, for a controller that is told of points out of reach.
    arm = pp.Arm.from_modules([pp.template("RyRz").with_limits(-0.4, 0.4)] * 4)
    start = arm.configuration(np.full(arm.nv, 0.1))
    offsets = quintic(41) * np.full(arm.nv, 0.6)
    reference = Reference(arm, 0.02, start, offsets, np.ones((41, arm.n_modules)))
    motion = perform(reference, controller, limits_of(arm))
    check_motion(motion, limits_of(arm))
    assert motion.run.reason
    # The targets are what limits allow of the reference.
    nearest = arm.at(arm.configuration(np.full(arm.nv, 0.4))).points
    np.testing.assert_allclose(motion.targets[-1], nearest, atol=1e-9)


def test_a_scene_is_watched_by_controllers_that_do_not_keep_clear() -> None:
    arm = arm_named("planar")
    scene = pp.Scene({"far": pp.Sphere((9.0, 0.0, 0.0), 0.1)})
    with pytest.warns(PostureWarning, match="joint"):
        motion = perform(random_reference(arm, 7), "joint", limits_of(arm), scene)
    assert motion.run.scene is scene and np.all(np.isfinite(motion.run.clearance))


def test_weights_leave_points_free() -> None:
    arm = arm_named("spatial")
    weights = np.array([0.0, 0.0, 1.0, 0.0, 1.0])
    rng = np.random.default_rng(8)
    stops = [drawn(arm, rng, 0.2) for _ in range(2)]
    for controller in ("geodesic", "lm", "dls"):
        motion = perform(reference_through(arm, stops, 2.0, 51, weights), controller, limits_of(arm))
        check_motion(motion, limits_of(arm))
        assert motion.target_mask.shape == (motion.steps + 1, 5)
        np.testing.assert_array_equal(motion.target_mask, np.tile(weights > 0, (motion.steps + 1, 1)))
        off = np.linalg.norm(motion.run.points - motion.targets, axis=2)
        np.testing.assert_allclose(motion.mean_error, off[:, weights > 0].mean(axis=1), atol=1e-12)
        assert motion.converged and motion.mean_error[-1] <= 1e-6 * arm.length


def test_weights_may_change_on_the_way() -> None:
    arm = arm_named("spatial")
    rng = np.random.default_rng(9)
    stops = [drawn(arm, rng, 0.2) for _ in range(2)]
    given = reference_through(arm, stops, 2.0, 51)
    weights = np.array(given.weights)
    weights[20:40, :3] = 0.0
    reference = Reference(arm, given.interval, given.start, given.offsets, weights, given.waypoints)
    motion = perform(reference, "geodesic", limits_of(arm))
    assert motion.converged and motion.mean_error.max() < 1e-9
    counts = motion.target_mask.sum(axis=1)
    assert counts[0] == counts[-1] == 5 and counts.min() == 2
