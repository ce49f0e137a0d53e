"""Every controller keeps an acceleration limit, whether it moves or has nowhere to go."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import pinposture as pp
from pinposture.control import CONTROLLERS, Memory, controller_named

SLIDE = pp.JointSpec("x", type="prismatic", lower=-0.04, upper=0.05)
ENDLESS = pp.JointSpec("z", type="continuous")
SLIDING = pp.ModuleTemplate("slides", (pp.JointSpec("y"), SLIDE, ENDLESS), (0.03,) * 3)
ARMS = {
    "limited": lambda: pp.Arm.from_modules([pp.template("RyRz").with_limits(-0.8, 0.6)] * 5),
    "planar": lambda: pp.Arm.from_template("Rz", 8),
    "sliding": lambda: pp.Arm.from_modules([SLIDING] * 4),
}
ALLOWED = 1e-9
STAND = ("pinv", "task-constraints", "extended", "augmented", "dls", "lm")


@cache
def arm_called(name: str) -> pp.Arm:
    return ARMS[name]()


def posture(arm: pp.Arm, seed: int, amplitude: float = 0.6) -> np.ndarray:
    drawn = amplitude * arm.joint_units * np.random.default_rng(seed).uniform(-1.0, 1.0, arm.nv)
    return arm.configuration(np.clip(drawn, arm.limits.lower, arm.limits.upper))


def target_of(arm: pp.Arm, seed: int, kind: str) -> pp.Target:
    """Reachable with its configuration, or without, or out of reach."""
    target = pp.Target.from_configuration(arm, posture(arm, seed + 10**6))
    if kind == "known":
        return target
    stretch = 3.0 if kind == "far" else 1.0
    return pp.Target.from_points(arm, stretch * target.points)


@pytest.mark.parametrize("kind", ["known", "points", "far"])
@pytest.mark.parametrize("name", sorted(CONTROLLERS))
def test_every_controller_keeps_an_acceleration_limit(name: str, kind: str) -> None:
    if name == "joint" and kind != "known":
        kind = "known"
    for seed, (arm_kind, acceleration) in enumerate(zip(ARMS, (2.0, 8.0, 0.5), strict=True)):
        arm = arm_called(arm_kind)
        dt = 0.05
        limits = pp.Limits(step=0.1, dt=dt, velocity=1.5, acceleration=acceleration, position_margin=1e-3)
        q = np.clip(arm.positions(posture(arm, seed)), arm.limits.lower + 1e-3, arm.limits.upper - 1e-3)
        q = arm.configuration(q)
        memory = None
        before = np.zeros(arm.nv)
        moved = 0
        target = target_of(arm, seed, kind)
        controller = controller_named(name)
        for _ in range(50):
            state = arm.at(q)
            assert limits.step_bounds(state, before).violated_constraints == ()
            step = controller.step(state, target, limits, memory)
            assert np.all(np.abs(step.dq) <= 1.5 * dt + ALLOWED)
            assert np.all(np.abs(step.dq - before) <= acceleration * dt**2 + ALLOWED)
            np.testing.assert_array_equal(step.memory.dq, step.dq)
            q = arm.integrate(q, step.dq)
            memory = step.memory
            before = step.dq
            positions = arm.positions(q)
            moved = moved + bool(step.dq.any())
            assert np.all(positions >= arm.limits.lower + 1e-3 - ALLOWED)
            assert np.all(positions <= arm.limits.upper - 1e-3 + ALLOWED)
        assert moved > 10


@pytest.mark.parametrize("name", [*STAND, "selection", "projection", "switching"])
def test_who_has_nowhere_to_go_brakes_first(name: str) -> None:
    arm = arm_called("limited")
    limits = pp.Limits(step=0.1, dt=0.1, acceleration=3.0)  # dq changes by at most 0.03
    speed = np.linspace(-0.1, 0.1, 10)
    nowhere = pp.Target(arm.at(arm.straight()).points, np.zeros(5))
    q = arm.straight()
    memory = Memory(speed)
    left = [np.abs(speed).max()]
    for _ in range(4):
        step = controller_named(name).step(arm.at(q), nowhere, limits, memory)
        assert step.reason
        expected = np.sign(memory.dq) * np.maximum(np.abs(memory.dq) - 0.03, 0.0)
        np.testing.assert_allclose(step.dq, expected, atol=1e-15)
        q = arm.integrate(q, step.dq)
        memory = step.memory
        left.append(np.abs(step.dq).max())
    np.testing.assert_allclose(left, [0.1, 0.07, 0.04, 0.01, 0.0], atol=1e-12)
    assert not step.dq.any()
    # Without an acceleration limit it stands at once, as ever.
    assert not controller_named(name).step(arm.at(q), nowhere, None, Memory(speed)).dq.any()


@pytest.mark.parametrize("known", [True, False])
def test_switching_keeps_it_where_projection_cannot_move(known: bool) -> None:
    """Then the joints go by themselves along a known way, or Selection keeps control where none is known."""
    arm = pp.Arm.from_template("Rz", 3)
    limits = pp.Limits(step=0.02, dt=0.1, acceleration=0.3)
    folded = np.array([0.0, 2.5, -2.6])
    target = pp.Target.from_configuration(arm, folded + [0.3, 0.1, -0.2]).region(2, 2)
    method = pp.Switching(
        projection=pp.Projection(threshold=0.99, coupling="relative"), patience=0.1, progress=0.9
    )
    run = pp.track(arm, target if known else replace(target, q=None), folded, method, limits, max_steps=30)
    steps = np.diff(run.q, axis=0, prepend=folded[None])
    assert np.all(np.abs(np.diff(steps, axis=0)) <= 0.003 + ALLOWED)
    assert np.abs(steps).max() > 0.01  # several times what one step may change
    assert ("projection" in run.info["method"]) == known


def test_joints_stop_at_the_end_of_the_way_that_they_were_asked_to_go() -> None:
    """Joint interpolation asks for the whole way: it gets there without swinging past."""
    arm = arm_called("planar")
    limits = pp.Limits(step=0.1, dt=0.05, acceleration=2.0)
    run = pp.track(arm, target_of(arm, 3, "known"), posture(arm, 4), "joint", limits)
    assert run.converged
    assert run.steps < 50  # at 0.005 in each step, as from rest, it would be over 100
    left = run.target.q - run.q
    assert np.all(np.abs(np.diff(run.q, axis=0)) <= 0.1 + ALLOWED)
    assert np.all(np.diff(np.abs(left), axis=0) <= 1e-12)
    assert np.all(np.abs(np.diff(run.q, n=2, axis=0)) <= 2.0 * 0.05**2 + ALLOWED)


def test_joints_cut_short_for_braking_are_flagged_and_others_are_not() -> None:
    arm = arm_called("limited")
    limits = pp.Limits(step=0.1, dt=0.1, acceleration=1.0)  # dq changes by at most 0.01
    state = arm.at(np.r_[0.55, np.zeros(9)])
    limited = limits.apply(state, np.full(10, 0.1), np.full(10, 0.03))
    assert limited.scale == 1.0
    assert limited.clipped.tolist() == [True] + [False] * 9
    # 0.05 of room: 0.025 and 0.015 and 0.005 use up 0.045, so a little more than that may be taken.
    assert limited.dq[0] == pytest.approx(0.05 / 3 + 0.01)
    np.testing.assert_allclose(limited.dq[1:], 0.04)
