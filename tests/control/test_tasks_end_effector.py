"""End-effector tasks: rows against finite differences, errors against scipy, and where plain steps end."""

from __future__ import annotations

import pickle
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sampling import examples
from scipy.spatial.transform import Rotation
from task_arms import ARMS, STATES, derivative, gauss_newton, random_rotation, state_of, target_of

import pinposture as pp
from pinposture.control import EndEffector

KINDS = ("position", "pose", "axis")
TURNS = {"spatial": 3, "planar": 1, "mixed": 3, "scara": 1, "wrist": 3, "tilted": 1, "gantry": 0}
"""How many rows an orientation has at the tip of each arm."""


def turned(state: pp.ArmState, angle: float, seed: int = 0, point: int = -1) -> pin.SE3:
    """A pose near that of a control point, turned by an angle about some axis in the world."""
    rng = np.random.default_rng(seed)
    turn = random_rotation(rng, angle) @ state.rotations[point]
    return pin.SE3(turn, state.points[point] + 0.05 * rng.normal(size=3))


def made(kind: str, state: pp.ArmState, angle: float, point: int = -1) -> EndEffector:
    pose = turned(state, angle, point=point)
    if kind == "position":
        return EndEffector(position=pose.translation, point=point)
    return EndEffector(pose=pose, point=point, direction_only=kind == "axis", length=1.0)


@pytest.mark.parametrize(("name", "seed"), STATES)
@pytest.mark.parametrize("angle", [1e-5, 9e-4, 0.7, 2.5, 3.1])
def test_pose_rows_equal_the_derivative_of_the_error(name: str, seed: int | None, angle: float) -> None:
    state = state_of(name, seed)
    target = target_of(state.arm)
    for point in {0, state.arm.n_modules // 2, state.arm.n_modules - 1}:
        task = made("pose", state, angle, point)
        jacobian, error = task.rows(state, target)
        inner = point < state.arm.n_modules - 1
        turns = 1 if name == "wrist" and inner else TURNS[name]
        assert jacobian.shape == (len(error), state.arm.nv)
        assert len(error) == state.arm.dimension + turns
        expected = -derivative(state, lambda at, task=task: task.rows(at, target).error)
        np.testing.assert_allclose(jacobian, expected, rtol=0.0, atol=3e-8)


@pytest.mark.parametrize(("name", "seed"), STATES)
def test_position_rows_are_those_of_the_control_point_in_the_plane_of_the_arm(
    name: str, seed: int | None
) -> None:
    state = state_of(name, seed)
    arm = state.arm
    jacobian, error = made("position", state, 0.5).rows(state, target_of(arm))
    assert len(error) == arm.dimension
    expected = derivative(state, lambda at: arm.plane @ at.points[-1])
    np.testing.assert_allclose(jacobian, expected, atol=1e-8)
    apart = turned(state, 0.5).translation - state.points[-1]
    np.testing.assert_allclose(error, arm.plane @ apart, atol=1e-14)


@pytest.mark.parametrize(("name", "seed"), STATES)
@pytest.mark.parametrize("angle", [0.5, 3.0])
def test_the_gradient_of_the_squared_error_is_exact_for_the_axis_alone(
    name: str, seed: int | None, angle: float
) -> None:
    state = state_of(name, seed)
    target = target_of(state.arm)
    task = made("axis", state, angle)
    jacobian, error = task.rows(state, target)
    assert len(error) == state.arm.dimension + min(TURNS[name], 2)
    found = derivative(state, lambda at: 0.5 * np.sum(task.rows(at, target).error ** 2))
    np.testing.assert_allclose(-error @ jacobian, found, atol=1e-8)


@given(st.integers(0, 10**6), st.floats(0.0, np.pi - 1e-6))
@examples(40)
def test_orientation_errors_are_rotation_vectors(seed: int, angle: float) -> None:
    state = state_of("spatial", seed)
    wanted = turned(state, angle, seed)
    error = EndEffector(pose=wanted, length=2.0).rows(state, target_of(state.arm)).error[3:]
    expected = Rotation.from_matrix(wanted.rotation @ state.rotations[-1].T).as_rotvec()
    np.testing.assert_allclose(error, 2.0 * expected, atol=1e-8)


@pytest.mark.parametrize("name", ["planar", "scara", "tilted"])
@given(st.integers(0, 10**6), st.sampled_from([1.9, 2.9]))
@examples(10)
def test_an_orientation_out_of_reach_asks_for_the_nearest_one(name: str, seed: int, angle: float) -> None:
    """Against a scan of all turns about the one axis that there is."""
    state = state_of(name, seed)
    arm = state.arm
    wanted = turned(state, angle, seed).rotation
    axis = arm.chain.axes[0]
    angles = np.linspace(-np.pi, np.pi, 20001)
    all_turns = Rotation.from_rotvec(angles[:, None] * axis).as_matrix() @ state.rotations[-1]
    nearest = angles[np.argmin(np.linalg.norm(all_turns - wanted, axis=(1, 2)))]
    jacobian, error = EndEffector(pose=pin.SE3(wanted, np.zeros(3))).rows(state, target_of(arm))
    turns = axis @ arm.chain.axes.T * ~arm.slides
    share = jacobian[-1] @ turns / (turns @ turns) / arm.characteristic_length
    assert 0.0 < abs(share) <= 1.0 + 1e-12
    np.testing.assert_allclose(jacobian[-1], share * arm.characteristic_length * turns, atol=1e-12)
    assert error[-1] / (share * arm.characteristic_length) == pytest.approx(nearest, abs=4e-4)


def test_what_leaves_the_plane_does_not_change_what_is_asked_within_it() -> None:
    state = state_of("planar", 3)
    target = target_of(state.arm)
    normal = state.arm.base_placement.rotation[:, 2]
    within = pin.SE3(np.asarray(pin.exp3(0.8 * normal)) @ state.rotations[-1], state.points[-1] + 0.1)
    off = pin.SE3(
        np.asarray(pin.exp3(0.3 * state.arm.plane[0])) @ within.rotation, within.translation + normal
    )
    (jacobian, error), (tilted, apart) = (EndEffector(pose=p).rows(state, target) for p in (within, off))
    assert error[2] == pytest.approx(0.8 * state.arm.characteristic_length)
    np.testing.assert_allclose(apart[:2], error[:2], atol=1e-12)
    np.testing.assert_allclose(tilted[:2], jacobian[:2], atol=1e-15)
    share = tilted[2] @ jacobian[2] / (jacobian[2] @ jacobian[2])
    assert 0.9 < share < 1.0
    # Both rows ask for nearly the same turn: only its nearest value moves, to second order.
    assert apart[2] / share == pytest.approx(error[2], rel=0.05)


HALF_TURNS = [
    (1, 0, 0),
    (0, 1, 0),
    (0, 0, 1),
    (1, -1, 0),
    (0, -1, 1),
    (1, 1, 1),
    (-1, -1, -1),
    (-0.3, 0.8, 0.1),
]


@pytest.mark.parametrize("axis", HALF_TURNS)
@pytest.mark.parametrize("name", ARMS)
def test_half_a_turn_is_finite_bounded_and_not_left_to_rounding(name: str, axis: tuple[float, ...]) -> None:
    state = state_of(name, 2)
    target = target_of(state.arm)
    rng = np.random.default_rng(1)
    about = np.array(axis) / np.linalg.norm(axis)
    half = 2.0 * np.outer(about, about) - np.eye(3)
    base = EndEffector(pose=pin.SE3(half @ state.rotations[-1], state.points[-1]), length=1.0)
    jacobian, error = base.rows(state, target)
    assert np.all(np.isfinite(jacobian))
    assert np.linalg.norm(error) <= np.pi + 2e-9
    if TURNS[name] == 3:
        assert np.linalg.norm(error) == pytest.approx(np.pi, abs=1e-8)
        np.testing.assert_allclose(np.abs(error[-3:] @ about), np.pi, atol=1e-8)
    for _ in range(10):
        noise = np.asarray(pin.exp3(1e-13 * rng.normal(size=3)))
        other = EndEffector(pose=pin.SE3(noise @ base.pose[:3, :3], state.points[-1]), length=1.0)
        np.testing.assert_allclose(other.rows(state, target).error, error, atol=1e-7)


@given(st.lists(st.floats(-4.0, 4.0), min_size=3, max_size=3), st.sampled_from(sorted(ARMS)), st.booleans())
@examples(40)
def test_rows_are_finite_and_bounded_wherever_the_arm_looks(
    rotation: list[float], name: str, direction_only: bool
) -> None:
    state = state_of(name, None)
    task = EndEffector(
        pose=pin.SE3(np.asarray(pin.exp3(np.array(rotation))), np.zeros(3)), direction_only=direction_only
    )
    jacobian, error = task.rows(state, target_of(state.arm))
    assert np.all(np.isfinite(jacobian)) and np.all(np.isfinite(error))
    turns = error[state.arm.dimension :] / state.arm.characteristic_length
    assert np.linalg.norm(turns) <= np.pi + 1e-8


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", ["spatial", "planar", "mixed", "wrist"])
def test_plain_steps_converge_quadratically(name: str, kind: str) -> None:
    for seed in range(3):
        rng = np.random.default_rng(seed)
        state = state_of(name, seed + 10)
        arm = state.arm
        goal = arm.at(arm.integrate(state.q, 0.15 * rng.uniform(-1, 1, arm.nv) * arm.joint_units))
        hold = "position" if kind == "position" else "pose"
        task = EndEffector.held(goal, hold, direction_only=kind == "axis")
        final, sizes = gauss_newton(task, state, 7)
        assert sizes[-1] < 1e-13
        for before, after in pairwise(sizes):
            if before < 0.01 * arm.characteristic_length:
                assert after <= 30.0 * before**2 / arm.characteristic_length + 1e-14
        np.testing.assert_allclose(final.points[-1], goal.points[-1], atol=1e-12)
        if kind == "pose":
            np.testing.assert_allclose(final.rotations[-1], goal.rotations[-1], atol=1e-11)
        if kind == "axis":
            np.testing.assert_allclose(final.rotations[-1, :, 0], goal.rotations[-1, :, 0], atol=1e-11)


def test_what_is_held_has_no_error_and_a_moved_task_follows() -> None:
    state = state_of("mixed", 4)
    target = target_of(state.arm)
    for hold in ("position", "pose"):
        for point in (0, 1, -1, "module_02"):
            task = EndEffector.held(state, hold, point, weight=3.0, priority=True)
            assert (task.weight, task.priority, task.point) == (3.0, True, point)
            np.testing.assert_allclose(task.rows(state, target).error, 0.0, atol=1e-14)
    moved = replace(task, pose=pin.SE3(task.pose) * pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.2])))
    assert moved.weight == 3.0
    expected = state.rotations[1] @ (0.0, 0.0, 0.2)
    np.testing.assert_allclose(moved.rows(state, target).error, np.r_[expected, np.zeros(3)], atol=1e-14)


def test_a_pose_rounded_to_seven_digits_is_taken_as_a_rotation() -> None:
    pose = turned(state_of("spatial", 1), 1.0)
    task = EndEffector(pose=np.round(np.asarray(pose.homogeneous), 7))
    np.testing.assert_allclose(task.pose[:3, :3].T @ task.pose[:3, :3], np.eye(3), atol=1e-15)
    np.testing.assert_allclose(task.pose, pose.homogeneous, atol=1e-6)


def test_an_orientation_that_is_there_to_the_last_digit_has_no_error() -> None:
    arm = pp.Arm.from_template("RyRz", 2)
    jacobian, error = EndEffector(pose=np.eye(4)).rows(arm.at(arm.neutral()), target_of(arm))
    assert np.all(error[3:] == 0.0)
    np.testing.assert_allclose(
        jacobian[3:], arm.characteristic_length * arm.at(arm.neutral()).axes, atol=1e-15
    )


def test_tasks_are_values() -> None:
    pose = turned(state_of("spatial", 1), 1.0)
    task = EndEffector(pose=pose)
    assert task == EndEffector(pose=np.asarray(pose.homogeneous)) == pickle.loads(pickle.dumps(task))
    assert hash(task) == hash(EndEffector(pose=pose))
    for other in (replace(task, weight=2.0), replace(task, point=0), EndEffector(pose.translation), "task"):
        assert task != other
    assert EndEffector((0.0, 0.0, 1.0)) == EndEffector([-0.0, 0, 1])
    odd = EndEffector((0, 0, 1), point=np.int64(2), priority=np.True_)
    assert repr(odd) == repr(EndEffector((0, 0, 1), point=2, priority=True))
    assert hash(EndEffector((0.0, 0.0, 1.0))) == hash(EndEffector([-0.0, 0, 1]))
    with pytest.raises(ValueError, match="read-only"):
        task.pose[0, 0] = 2.0
    pose.translation = np.ones(3)
    assert task != EndEffector(pose=pose)
