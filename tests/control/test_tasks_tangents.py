"""Tangent tasks: rows against finite differences, ways along great circles, and which link is meant."""

from __future__ import annotations

import pickle
import sys
import warnings
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sampling import examples
from task_arms import ARMS, STATES, arm_called, derivative, gauss_newton, state_of, target_of

import pinposture as pp
from pinposture.control import Tangents
from pinposture.control.tasks import link_axes, link_directions
from pinposture.curve import HELIX

sys.path.insert(0, str(Path(__file__).parents[1] / "arm"))

from rewriting import turned_frames

ROBOTS = (
    "panda_description/urdf/panda.urdf",
    "ur_description/urdf/ur5_robot.urdf",
    "kinova_description/robots/kinova.urdf",
)
TWO = ("spatial", "mixed")
ONE = ("planar", "scara")
NONE = ("gantry",)


def directions_near(state: pp.ArmState, angle: float, seed: int = 0) -> np.ndarray:
    """Directions at an angle from the links, (m, 3)."""
    rng = np.random.default_rng(seed)
    links = state.rotations[:, :, 0]  # template arms
    across = np.cross(links, rng.normal(size=links.shape))
    across /= np.linalg.norm(across, axis=1)[:, None]
    return np.cos(angle) * links + np.sin(angle) * across


@pytest.mark.parametrize(("name", "seed"), [case for case in STATES if case[0] in TWO])
@pytest.mark.parametrize("angle", [0.0, 1e-5, 0.9, 2.9, np.pi])
def test_rows_are_the_motion_of_the_links_in_space(name: str, seed: int | None, angle: float) -> None:
    """The basis of the rows is free: their products are compared, and the way that they show in space."""
    state = state_of(name, seed)
    arm = state.arm
    wanted = directions_near(state, angle)
    lever = 0.2
    jacobian, error = Tangents(wanted, length=lever).rows(state, target_of(arm))
    motion = lever * derivative(state, lambda at: at.rotations[:, :, 0])
    assert jacobian.shape == (2 * arm.n_modules, arm.nv)
    for k in range(arm.n_modules):
        rows = jacobian[2 * k : 2 * k + 2]
        apart = error[2 * k : 2 * k + 2]
        np.testing.assert_allclose(rows.T @ rows, motion[k].T @ motion[k], atol=1e-9)
        assert np.linalg.norm(apart) == pytest.approx(lever * angle, abs=1e-8)
        if 0.0 < angle < 3.0:
            # Along the great circle: the part of the direction asked for that lies across the link.
            link = state.rotations[k, :, 0]
            way = lever * angle * (wanted[k] - np.cos(angle) * link) / np.sin(angle)
            np.testing.assert_allclose(rows.T @ apart, motion[k].T @ way, atol=1e-9)


@pytest.mark.parametrize(("name", "seed"), STATES)
@pytest.mark.parametrize("angle", [1e-4, 0.9, 2.9])
def test_the_gradient_of_the_squared_error_is_exact(name: str, seed: int | None, angle: float) -> None:
    state = state_of(name, seed)
    task = Tangents(directions_near(state, angle), length=0.2)
    target = target_of(state.arm)
    jacobian, error = task.rows(state, target)
    found = derivative(state, lambda at: 0.5 * np.sum(task.rows(at, target).error ** 2))
    np.testing.assert_allclose(-error @ jacobian, found, atol=1e-8)


@pytest.mark.parametrize("name", ONE)
@pytest.mark.parametrize("seed", [None, 0, 1])
def test_where_links_turn_about_one_axis_there_is_one_row(name: str, seed: int | None) -> None:
    state = state_of(name, seed)
    arm = state.arm
    target = target_of(state.arm)
    axis = arm.base_placement.rotation[:, 2]
    links = state.rotations[:, :, 0]
    for angle in (0.0, 0.4, -2.0, 3.1):
        turned = links @ np.asarray(pin.exp3(angle * axis)).T
        jacobian, error = Tangents(turned, length=0.3).rows(state, target)
        np.testing.assert_allclose(error, 0.3 * angle, atol=1e-12)
        np.testing.assert_allclose(jacobian, 0.3 * axis @ state.angular_jacobians, atol=1e-12)
        lifted, apart = Tangents(turned + 0.75 * axis, length=0.3).rows(state, target)
        share = np.sqrt(0.8)  # 1 : 0.75 leaves 4 of 5 in the plane
        np.testing.assert_allclose(apart, share * 0.3 * angle, atol=1e-12)
        np.testing.assert_allclose(lifted, share * jacobian, atol=1e-12)
    jacobian, error = Tangents(np.tile(axis, (arm.n_modules, 1))).rows(state, target)
    np.testing.assert_allclose(jacobian, 0.0, atol=1e-7)  # the root of a rounding error
    np.testing.assert_allclose(error, 0.0, atol=1e-7)


@pytest.mark.parametrize("seed", [None, 0, 1])
def test_links_that_do_not_lie_across_the_axis_count_by_how_far_a_turn_moves_them(seed: int | None) -> None:
    state = state_of("tilted", seed)
    target = target_of(state.arm)
    axis = state.arm.chain.axes[0]
    for angle in (0.4, -2.0, 3.1):
        wanted = state.rotations[:, :, 0] @ np.asarray(pin.exp3(angle * axis)).T
        jacobian, error = Tangents(wanted, length=0.3).rows(state, target)
        motion = 0.3 * derivative(state, lambda at: at.rotations[:, :, 0])
        np.testing.assert_allclose(np.abs(jacobian), np.linalg.norm(motion, axis=1), atol=1e-8)
        step = np.zeros(6)
        step[0] = angle
        np.testing.assert_allclose(jacobian @ step, error, atol=1e-12)


@pytest.mark.parametrize("noise", [0.0, 1e-12, 1e-7])
def test_links_that_point_straight_down_are_no_exception(noise: float) -> None:
    down = pin.SE3(np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]]), np.zeros(3))
    arm = pp.Arm.from_template("RyRz", 3, base_placement=down)
    state = arm.at(np.full(6, noise))
    jacobian, error = Tangents([(1, 0, -1)] * 3, length=1.0).rows(state, target_of(arm))
    np.testing.assert_allclose(np.linalg.norm(error.reshape(3, 2), axis=1), np.pi / 4, atol=1e-6)
    for k in range(3):
        rows = jacobian[2 * k : 2 * k + 2]
        motion = derivative(state, lambda at: at.rotations[:, :, 0])[k]
        np.testing.assert_allclose(rows.T @ rows, motion.T @ motion, atol=1e-8)


def test_an_arm_that_only_slides_has_no_rows_and_a_wrist_has_two_where_it_turns() -> None:
    gantry = state_of("gantry", 0)
    wrist = state_of("wrist", 0)
    found = Tangents((1, 2, 3)).rows(gantry, target_of(gantry.arm))
    assert (found.jacobian.shape, found.error.shape) == ((0, 3), (0,))
    rows = [len(Tangents((1, 2, 3), k).rows(wrist, target_of(wrist.arm)).error) for k in range(4)]
    assert rows == [1, 1, 1, 2]
    assert Tangents([(1, 2, 3)] * 3, [0, 3, 1]).rows(wrist, target_of(wrist.arm)).jacobian.shape == (4, 6)


@given(
    st.sampled_from(sorted(ARMS)),
    st.integers(0, 10**6),
    st.sampled_from(["opposite", "along", "x", "-x", "y", "z", "-z"]),
    st.sampled_from([0.0, 1e-300, 1e-16, 1e-12]),
)
@examples(40)
def test_rows_are_finite_and_opposite_links_turn_one_way(
    name: str, seed: int, kind: str, noise: float
) -> None:
    state = state_of(name, seed if seed % 3 else None)
    arm = state.arm
    target = target_of(state.arm)
    links = link_directions(state, np.arange(arm.n_modules))
    sign = -1.0 if kind.startswith("-") else 1.0
    fixed = {"opposite": -links, "along": links}
    wanted = fixed.get(kind, np.tile(sign * np.eye(3)["xyz".find(kind[-1])], (arm.n_modules, 1)))
    jacobian, error = Tangents(wanted).rows(state, target)
    assert np.all(np.isfinite(jacobian)) and np.all(np.isfinite(error))
    assert np.abs(error).max(initial=0.0) <= (np.pi + 1e-8) * arm.characteristic_length
    if kind == "opposite":
        moved = wanted + noise * np.random.default_rng(seed).normal(size=wanted.shape)
        np.testing.assert_allclose(Tangents(moved).rows(state, target).error, error, atol=1e-8)
        if len(error):
            assert np.linalg.norm(error) > arm.characteristic_length
            assert np.linalg.norm(error @ jacobian) > 1e-6


def test_opposite_links_are_turned_round() -> None:
    for name in ("spatial", "planar"):
        state = state_of(name, None)
        wanted = -state.rotations[-1, :, 0]
        final, sizes = gauss_newton(Tangents(wanted, -1), state, 4)
        assert sizes[0] == pytest.approx(np.pi * state.arm.characteristic_length)
        np.testing.assert_allclose(final.rotations[-1, :, 0], wanted, atol=1e-12)


@pytest.mark.parametrize("name", ["spatial", "planar", "mixed"])
def test_plain_steps_converge_quadratically(name: str) -> None:
    for seed in range(3):
        state = state_of(name, seed + 20)
        arm = state.arm
        rng = np.random.default_rng(seed)
        goal = arm.at(arm.integrate(state.q, 0.05 * rng.uniform(-1, 1, arm.nv) * arm.joint_units))
        task = Tangents(goal.rotations[:, :, 0])
        rows = task.rows(state, target_of(arm)).jacobian * arm.joint_units
        smallest = np.linalg.svd(rows, compute_uv=False)[-1]
        final, sizes = gauss_newton(task, state, 8)
        assert sizes[-1] < 1e-13
        for before, after in pairwise(sizes):
            if before < 0.01 * arm.characteristic_length:
                assert after <= 20.0 * before**2 / smallest + 1e-14
        np.testing.assert_allclose(final.rotations[:, :, 0], goal.rotations[:, :, 0], atol=1e-12)


def test_tangents_of_a_curve_are_those_where_the_control_points_are() -> None:
    arm = pp.Arm.from_template("RyRz", 20)
    target = pp.resolve_targets(arm, HELIX)
    h = 1e-5
    places = target.parameters[:-1]
    expected = (target.curve.at(places + h) - target.curve.at(places - h)) / (2.0 * h)
    np.testing.assert_allclose(Tangents.of_curve(target).directions[:-1], expected, atol=1e-6)
    some = Tangents.of_curve(target, [3, -1], weight=0.5, length=0.01)
    assert (some.points, some.weight, some.length) == ((3, 19), 0.5, 0.01)
    np.testing.assert_allclose(some.directions[0], expected[3], atol=1e-6)
    assert Tangents.of_curve(target.region(4, 6)).points == (4, 5, 6)
    # The links of the posture on the curve are chords of it: near its tangents, not along them.
    error = Tangents.of_curve(target, length=1.0).rows(arm.at(target.q), target).error.reshape(-1, 2)
    assert 0.01 < np.linalg.norm(error, axis=1).max() < 0.4


def test_links_of_templates_lie_along_x_wherever_the_arm_stands() -> None:
    for name in ("spatial", "planar", "mixed", "wrist", "tilted"):
        for seed in (0, 1):
            state = state_of(name, seed)
            links = link_directions(state, np.arange(state.arm.n_modules))
            np.testing.assert_allclose(links, state.rotations[:, :, 0], atol=1e-12)


def robot(name: str) -> pp.Arm:
    prefix = next(
        p for p in Path(pin.__file__).parents if (p / "cmeel.prefix").is_dir() or p.name == "cmeel.prefix"
    )
    root = prefix if prefix.name == "cmeel.prefix" else prefix / "cmeel.prefix"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", pp.PostureWarning)
        return pp.Arm.load(root / "share/example-robot-data/robots" / name)


@pytest.mark.parametrize("name", ROBOTS)
def test_links_of_a_file_come_from_the_joint_before_the_control_point(name: str) -> None:
    arm = robot(name)
    data = arm.model.createData()
    for seed in range(3):
        state = arm.at(arm.random(np.random.default_rng(seed)))
        pin.forwardKinematics(arm.model, data, state.q)
        links = link_directions(state, np.arange(arm.n_modules))
        checked = 0
        for k, joints in enumerate(arm.module_joints):
            span = state.points[k] - data.oMi[arm.model.getJointId(joints[-1])].translation
            if np.linalg.norm(span) > 1e-3:
                np.testing.assert_allclose(links[k], span / np.linalg.norm(span), atol=1e-9)
                checked += 1
        assert checked > 0


def test_links_do_not_depend_on_the_frames_of_a_file() -> None:
    made = arm_called("spatial")
    plain = pp.Arm.load(made.urdf, split=2)
    turned = pp.Arm.load(turned_frames(made.urdf, np.random.default_rng(5)), split=2)
    points = np.arange(4)
    for seed in range(3):
        q = plain.random(np.random.default_rng(seed))
        expected = link_directions(plain.at(q), points)
        np.testing.assert_allclose(link_directions(turned.at(q), points), expected, atol=1e-9)


def test_a_last_joint_at_the_control_point_takes_the_link_before_it() -> None:
    """The roll axis of a wrist, which no configuration turns out of the link."""
    roll = pp.ModuleTemplate("roll", (pp.JointSpec("z"), pp.JointSpec("x")), (0.1, 0.0))
    arm = pp.Arm.from_modules([roll] * 2)
    np.testing.assert_allclose(link_axes(arm).links, np.tile((1.0, 0.0, 0.0), (2, 1)), atol=1e-12)
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelRZ(), pin.SE3.Identity(), "spin")
    turn = pin.SE3(pin.rpy.rpyToMatrix(0.4, 0.2, 0.1), np.zeros(3))
    model.addFrame(pin.Frame("still", joint, turn, pin.FrameType.OP_FRAME))
    more = model.addJoint(joint, pin.JointModelRY(), pin.SE3(np.eye(3), np.array([0, 0.3, 0])), "next")
    there = pin.SE3(turn.rotation, np.array([1e-9, 0.0, 0.0]))  # but for rounding
    model.addFrame(pin.Frame("end", more, there, pin.FrameType.OP_FRAME))
    odd = pp.Arm.from_model(model, ["still", "end"])
    assert link_axes(odd).links[0].tolist() == [1.0, 0.0, 0.0]  # nothing lies before it
    np.testing.assert_allclose(link_axes(odd).links[1], turn.rotation.T @ (0.0, 1.0, 0.0), atol=1e-6)


def test_a_link_comes_from_the_control_point_before_it_where_that_is_nearer() -> None:
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelRZ(), pin.SE3.Identity(), "first")
    side = pin.SE3(np.eye(3), np.array([0.1, 0.2, 0.0]))
    model.addFrame(pin.Frame("beside", joint, side, pin.FrameType.OP_FRAME))
    more = model.addJoint(joint, pin.JointModelRY(), pin.SE3(np.eye(3), np.array([0.1, 0.5, 0.0])), "second")
    model.addFrame(pin.Frame("end", more, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    arm = pp.Arm.from_model(model, ["beside", "end"])
    np.testing.assert_allclose(link_axes(arm).links[0], np.array([1.0, 2.0, 0.0]) / np.sqrt(5.0), atol=1e-12)
    np.testing.assert_allclose(link_axes(arm).links[1], (0.0, 1.0, 0.0), atol=1e-12)


def test_tasks_are_values() -> None:
    task = Tangents([(1, 0, 0), (0, 3, 0)], (0, "module_02"))
    assert task == Tangents([(2, 0, 0), (0, 1e-310, 0)], [np.int64(0), "module_02"])
    assert task == pickle.loads(pickle.dumps(task))
    assert hash(task) == hash(replace(task))
    for other in (replace(task, points=None), replace(task, points=(0, 1)), replace(task, weight=0.5)):
        assert task != other
    assert Tangents((0, 0, 1)) != Tangents([(0, 0, 1)] * 3)
    assert not task.priority
