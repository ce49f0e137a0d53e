"""Targets that change: closed cycles of them, and changes in mid-run."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from planner_runs import arm_called, check_limits, within

import pinposture as pp
from pinposture.control import Memory

ROUNDS = 3


def cycled(arm: pp.Arm, targets: list[pp.Target], tolerance: float, rounds: int = ROUNDS) -> np.ndarray:
    """Configurations at the end of each round, (rounds, nq)."""
    q = arm.straight()
    ends = []
    for _ in range(rounds):
        for target in targets:
            run = pp.track(arm, target, q, tolerance=tolerance * arm.length, max_steps=400)
            assert run.converged, run.reason
            q = run.q[-1]
        ends.append(q)
    return np.array(ends)


def corners(arm: pp.Arm, known: bool, seed: int = 0) -> list[pp.Target]:
    rng = np.random.default_rng(seed)
    goals = [within(arm, pp.Limits(), rng, 0.4) for _ in range(4)]
    targets = [pp.Target.from_configuration(arm, goal) for goal in goals]
    return targets if known else [pp.Target.from_points(arm, each.points) for each in targets]


@pytest.mark.parametrize("name", ["planar", "spatial", "sliding"])
def test_a_cycle_of_known_configurations_does_not_drift(name: str) -> None:
    arm = arm_called(name)
    ends = cycled(arm, corners(arm, known=True), 1e-12)
    drift = np.abs(np.diff([arm.positions(q) for q in ends], axis=0)) / arm.joint_units
    assert drift.max() < 1e-9


@pytest.mark.parametrize("name", ["planar", "spatial"])
def test_a_cycle_of_postures_does_not_drift_where_points_settle_the_joints(name: str) -> None:
    arm = arm_called(name)
    ends = cycled(arm, corners(arm, known=False), 1e-10)
    assert np.abs(np.diff(ends[1:], axis=0)).max() < 1e-6


@pytest.mark.long
def test_tips_of_redundant_arms_drift_less_after_some_rounds() -> None:
    """Nothing settles the other joints, and no configuration is remembered: they find their place.

    Of single arms some drift more in a later round, so the medians of six draws are compared.
    """
    arm = arm_called("planar")
    drifts = []
    for seed in range(6):
        targets = [target.region(6, 6) for target in corners(arm, known=False, seed=seed)]
        ends = cycled(arm, targets, 1e-10, rounds=5)
        drifts.append(np.abs(np.diff(ends, axis=0)).max(axis=1))
    first, *_, last = np.median(drifts, axis=0)
    assert last < 0.5 * first


@pytest.mark.parametrize(("name", "acceleration"), [("planar", None), ("spatial", None), ("spatial", 5.0)])
def test_what_it_remembers_outlives_a_change_of_target(name: str, acceleration: float | None) -> None:
    """The target changes in mid-motion, twice, and once back to what it was; limits hold all the way."""
    arm = arm_called(name)
    limits = pp.Limits(step=0.1, dt=0.1, velocity=1.0, acceleration=acceleration)
    controller = pp.Geodesic()
    one, two, three = corners(arm, known=True, seed=3)[:3]
    two = pp.Target.from_points(arm, two.points)
    q = arm.straight()
    memory = None
    seen = [arm.straight()]
    for target, most in ((one, 4), (two, 4), (one, 3), (three, 600)):
        for _ in range(most):
            state = arm.at(q)
            if np.linalg.norm(target.points - state.points, axis=1).mean() <= 1e-6 * arm.length:
                break
            step = controller.step(state, target, limits, memory)
            q = arm.integrate(q, step.dq)
            memory = step.memory
            seen.append(q)
    check_limits(arm, limits, np.array(seen))
    assert np.linalg.norm(three.points - arm.at(q).points, axis=1).mean() <= 1e-6 * arm.length


def test_an_equal_target_does_not_make_it_plan_again() -> None:
    arm = arm_called("spatial")
    controller = pp.Geodesic()
    goal = within(arm, pp.Limits(), np.random.default_rng(1))
    q = arm.straight()
    memory = None
    paths = []
    for _ in range(5):
        step = controller.step(arm.at(q), pp.Target.from_configuration(arm, goal), None, memory)
        q = arm.integrate(q, step.dq)
        memory = step.memory
        paths.append(memory.progress.path)
    assert all(a is b for a, b in pairwise(paths))
    moved = controller.step(arm.at(q), pp.Target.from_configuration(arm, 0.9 * goal), None, memory)
    assert moved.memory.progress.path is not paths[-1]


def test_memory_of_another_arm_or_controller_is_no_memory() -> None:
    arm = arm_called("spatial")
    other = arm_called("planar")
    target = pp.Target.from_configuration(arm, within(arm, pp.Limits(), np.random.default_rng(1)))
    foreign = pp.Geodesic().step(
        other.at(other.straight()), pp.Target.from_configuration(other, np.full(7, 0.3))
    )
    strange = replace(foreign.memory, dq=np.zeros(arm.nv))
    fresh = pp.Geodesic().step(arm.at(arm.straight()), target)
    for memory in (strange, Memory(np.zeros(arm.nv))):
        step = pp.Geodesic().step(arm.at(arm.straight()), target, None, memory)
        np.testing.assert_array_equal(step.dq, fresh.dq)
