"""The task of joints, on the manifold."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sampling import examples
from task_arms import ARMS, STATES, arm_called, derivative, gauss_newton, state_of, target_of

import pinposture as pp
from pinposture.control import ControlTask, JointPosture


@pytest.mark.parametrize(("name", "seed"), STATES)
@pytest.mark.parametrize("length", [None, 0.4])
def test_rows_equal_the_derivative_of_the_error(name: str, seed: int | None, length: float | None) -> None:
    state = state_of(name, seed)
    arm = state.arm
    target = target_of(state.arm)
    task = JointPosture(arm.random(np.random.default_rng(77)), length=length)
    jacobian, error = task.rows(state, target)
    assert error.shape == (arm.nv,)
    np.testing.assert_allclose(
        jacobian, -derivative(state, lambda at: task.rows(at, target).error), atol=1e-8
    )
    # A radian counts as the lever is long, and so does a slide of the sliding unit.
    unit = arm.characteristic_length
    expected = np.where(arm.slides, (length or unit) / unit, length or unit)
    np.testing.assert_allclose(np.diag(jacobian), expected, atol=1e-12)


def test_one_plain_step_arrives() -> None:
    for name in ARMS:
        state = state_of(name, 1)
        goal = state.arm.random(np.random.default_rng(5))
        final, sizes = gauss_newton(JointPosture(goal), state, 1)
        assert sizes[-1] < 1e-13
        np.testing.assert_allclose(final.q, goal, atol=1e-12)


@given(st.floats(-np.pi, np.pi), st.floats(-np.pi, np.pi))
@examples(40)
def test_continuous_joints_go_the_shorter_way_round(now: float, then: float) -> None:
    arm = arm_called("mixed")
    positions = np.zeros(9)
    wanted = np.zeros(9)
    positions[4] = now
    wanted[4] = then
    task = JointPosture(arm.configuration(wanted), length=1.0)
    jacobian, error = task.rows(arm.at(arm.configuration(positions)), target_of(arm))
    shorter = (then - now + np.pi) % (2.0 * np.pi) - np.pi
    assert abs(error[4]) == pytest.approx(abs(shorter), abs=1e-7)
    assert np.exp(1j * error[4]) == pytest.approx(np.exp(1j * shorter), abs=1e-7)
    assert np.all(np.delete(error, 4) == 0.0) and np.all(np.isfinite(jacobian))


def test_some_joints_only() -> None:
    state = state_of("mixed", 2)
    arm = state.arm
    target = target_of(state.arm)
    q = arm.random(np.random.default_rng(3))
    everything = JointPosture(q).rows(state, target)
    chosen = (arm.chain.joints[7], arm.chain.joints[0])
    some = JointPosture(q, joints=chosen).rows(state, target)
    np.testing.assert_array_equal(some.jacobian, everything.jacobian[[7, 0]])
    np.testing.assert_array_equal(some.error, everything.error[[7, 0]])
    assert JointPosture(q, joints=chosen[0]) == JointPosture(q, joints=list(chosen[:1]))
    assert hash(JointPosture(q, joints=chosen)) == hash(JointPosture(q.tolist(), joints=iter(chosen)))


def test_joints_off_the_chain_are_left_alone_by_every_task() -> None:
    model = pin.buildSampleModelManipulator()
    arm = pp.Arm.from_model(model, ["elbow_body", "wrist1_body"])
    state = arm.at(arm.random(np.random.default_rng(0)))
    target = target_of(arm)
    off = np.setdiff1d(np.arange(arm.nv), arm.columns)
    assert len(off) > 0
    tasks: list[ControlTask] = [
        JointPosture(arm.random(np.random.default_rng(1))),
        pp.EndEffector.held(arm.at(arm.neutral())),
        pp.Tangents((0.0, 0.2, 1.0), -1),
    ]
    for task in tasks:
        jacobian, error = task.rows(state, target)
        assert np.all(jacobian[:, off] == 0.0) and np.any(jacobian != 0.0)
        assert len(jacobian) == len(error)
        np.testing.assert_allclose(
            jacobian[:, off],
            -derivative(state, lambda at, t=task: t.rows(at, target).error)[:, off],
            atol=1e-8,
        )
    assert len(tasks[0].rows(state, target).error) == len(arm.columns)
