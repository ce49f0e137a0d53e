"""Coupled joints against Pinocchio, finite differences, and the exact arc of constant curvature."""

from __future__ import annotations

import warnings
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from arm.describing import LINK, Y, Z, arm_text, limit, links, moving, robot
from hypothesis import given
from hypothesis import strategies as st

import pinposture as pp
from pinposture import kernels
from pinposture.arm import Coupling, JointSpec, ModuleTemplate, continuum_section, smooth_configuration
from pinposture.errors import InvalidValue, PostureWarning, UnknownName, URDFError
from pinposture.kernels.arrays import COUPLING, Rows


def coupled_arm(seed: int) -> pp.Arm:
    """Three sections of crossed hinges and some slides, each coupled by ratios and offsets of its own."""
    rng = np.random.default_rng(seed)
    body = links(["base"])
    before = "base"
    for section in range(3):
        for disk in range(int(rng.integers(1, 5))):
            for axis in "yzx" if seed % 3 == 0 else "yz":
                name = f"s{section}_{disk}_{axis}"
                kind = "prismatic" if axis == "x" else "revolute"
                ratio = rng.uniform(0.5, 1.5) * rng.choice([-1, 1])
                offset = rng.uniform(-0.1, 0.1)
                leader = f'joint="s{section}_0_{axis}" multiplier="{ratio}" offset="{0.1 * offset}"'
                vector = " ".join(
                    str(value) for value in np.eye(3)["xyz".index(axis)] + rng.normal(0, 0.1, 3)
                )
                edges = limit(-0.02, 0.03) if axis == "x" else limit(-0.8, 0.6)
                place = f"{rng.uniform(0.02, 0.06)} 0 0"
                more = f"<mimic {leader}/>" if disk else ""
                body += links([f"l_{name}"])
                body += moving(name, before, f"l_{name}", kind, vector, place, edges, more)
                before = f"l_{name}"
    body += links(["tip"]) + f'<joint name="end" type="fixed"><parent link="{before}"/><child link="tip"/>'
    return pp.Arm.load(robot(body + '<origin xyz="0.05 0 0"/></joint>'), tip="tip")


@pytest.mark.parametrize("seed", range(12))
def test_kinematics_are_those_of_pinocchio(seed):
    arm = coupled_arm(seed)
    data = arm.model.createData()
    rng = np.random.default_rng(seed)
    for _ in range(3):
        q = arm.random(rng)
        pin.computeJointJacobians(arm.model, data, q)
        pin.updateFramePlacements(arm.model, data)
        for state in (arm.at(q), arm.chain_at(q)):
            for k, name in enumerate(arm.control_points):
                frame = arm.model.getFrameId(name)
                jacobian = pin.getFrameJacobian(arm.model, data, frame, pin.LOCAL_WORLD_ALIGNED)
                np.testing.assert_allclose(state.points[k], data.oMf[frame].translation, atol=1e-12)
                np.testing.assert_allclose(state.rotations[k], data.oMf[frame].rotation, atol=1e-12)
                np.testing.assert_allclose(state.jacobians[k], jacobian[:3], atol=1e-12)
                np.testing.assert_allclose(state.angular_jacobians[k], jacobian[3:], atol=1e-12)


@pytest.mark.parametrize("seed", range(6))
def test_jacobians_are_finite_differences(seed):
    arm = coupled_arm(seed)
    step = 1e-6
    q = arm.random(seed)
    for state in (arm.at(q), arm.chain_at(q)):
        for j, unit in enumerate(np.eye(arm.nv)):
            ahead, behind = (arm.at(arm.integrate(q, sign * step * unit)).points for sign in (1, -1))
            np.testing.assert_allclose(state.jacobians[:, :, j], (ahead - behind) / (2 * step), atol=1e-9)


@pytest.mark.parametrize("seed", range(6))
def test_joints_are_where_the_description_says(seed):
    """All joints of the description move on their own in a model without couplings."""
    arm = coupled_arm(seed)
    rng = np.random.default_rng(seed)
    free = pin.buildModelFromXML(arm.urdf)
    data = free.createData()
    u = arm.random(rng)
    positions = dict(zip(arm.joint_names, arm.positions(u), strict=True))
    for each in arm.couplings:
        positions[each.joint] = each.ratio * positions[each.leader] + each.offset
    pin.framesForwardKinematics(free, data, np.array([positions[name] for name in list(free.names)[1:]]))
    tip = data.oMf[free.getFrameId("tip")].translation
    np.testing.assert_allclose(arm.at(u).points[-1], tip, atol=1e-12)


@pytest.mark.parametrize("seed", range(6))
def test_limits_hold_for_every_joint_and_some_joint_is_at_its_own(seed):
    arm = coupled_arm(seed)
    free = pin.buildModelFromXML(arm.urdf)
    for edge in (arm.limits.lower, arm.limits.upper):
        inside = []
        touching = dict.fromkeys(arm.joint_names, False)
        positions = dict(zip(arm.joint_names, edge, strict=True))
        members = [(name, name, 1.0, 0.0) for name in arm.joint_names] + list(arm.couplings)
        for name, leader, ratio, offset in members:
            at = free.joints[free.getJointId(name)].idx_q
            low = free.lowerPositionLimit[at]
            high = free.upperPositionLimit[at]
            position = ratio * positions[leader] + offset
            inside.append(low - 1e-12 <= position <= high + 1e-12)
            touching[leader] |= min(position - low, high - position) < 1e-12
        assert all(inside)
        assert all(touching.values())


def test_a_leader_may_come_behind_or_beside_and_followers_may_follow_followers():
    twice = '<mimic joint="b" multiplier="2" offset="1"/>'
    chain = (
        moving("a", "l0", "l1", axis=Y, limits=limit(-1, 1), more='<mimic joint="c" multiplier="2"/>')
        + moving("b", "l1", "l2", axis=Z, more='<mimic joint="motor" multiplier="-0.5" offset="0.1"/>')
        + moving("c", "l2", "l3", axis=Y, limits=limit(-1, 1, 3))
        + moving("d", "l3", "l4", axis=Z, limits=limit(-1, 2), more=twice)
        + moving("motor", "l0", "side", axis=Z, limits=limit(-0.4, 0.4, 6))
    )
    with pytest.warns(PostureWarning, match="locked: 1 at link 'l0' \\('motor'\\)"):
        arm = pp.Arm.load(robot(links([f"l{k}" for k in range(5)] + ["side"]) + chain), tip="l4")
    assert arm.joint_names == ("a", "b")
    first, second = arm.couplings
    assert first == Coupling("c", "a", 0.5, 0.0)
    assert second == Coupling("d", "b", 2.0, pytest.approx(1.0))
    np.testing.assert_allclose(arm.limits.lower, [-1.0, -0.1])  # b = 0.1 - 0.5 motor
    np.testing.assert_allclose(arm.limits.upper, [1.0, 0.3])
    assert arm.limits.velocity.tolist() == [2.0, 1.0]  # d: 2 / 2; the motor: 6 * 0.5


def leading(first: str, second: str) -> pp.Arm:
    """Two coupled slides and two coupled hinges, of which one or the other follows; then a free hinge."""
    follow = {
        "a": '<mimic joint="c" multiplier="2" offset="0.1"/>',
        "c": '<mimic joint="a" multiplier="0.5" offset="-0.05"/>',
    }
    slide = {
        "b": '<mimic joint="d" multiplier="-4" offset="0"/>',
        "d": '<mimic joint="b" multiplier="-0.25" offset="0"/>',
    }
    chain = (
        moving("a", "l0", "l1", axis=Y, limits=limit(-1, 1), more=follow["a"] if first == "c" else "")
        + moving("b", "l1", "l2", axis=Z, limits=limit(-0.4, 0.4), more=slide["b"] if second == "d" else "")
        + moving("c", "l2", "l3", axis=Y, limits=limit(-1, 1), more=follow["c"] if first == "a" else "")
        + moving(
            "d", "l3", "l4", "prismatic", Z, limits=limit(-0.1, 0.1), more=slide["d"] if second == "b" else ""
        )
        + moving("e", "l4", "l5", axis=Z, limits=limit(-1, 1))
    )
    return pp.Arm.load(robot(links([f"l{k}" for k in range(6)]) + chain), tip="l5")


@pytest.mark.parametrize(("first", "second"), [("a", "b"), ("c", "b"), ("a", "d"), ("c", "d")])
def test_exported_motions_name_the_joints_that_move_on_their_own(first, second, tmp_path):
    arm = leading(first, second)
    same = leading("a", "b")
    assert arm.drives.names == (first, second, "e")
    q = np.cumsum(np.random.default_rng(0).uniform(-0.02, 0.02, (20, 3)), axis=0)
    exported = pp.JointTrajectory.from_configurations(arm, q, 0.1)
    reference = pp.JointTrajectory.from_configurations(same, q, 0.1).with_coupled(same)
    every = exported.with_coupled(arm)
    assert exported.joint_names == (first, second, "e")
    assert sorted(every.joint_names) == sorted(reference.joint_names)
    columns = [reference.joint_names.index(name) for name in every.joint_names]
    for values in ("positions", "velocities", "accelerations"):
        np.testing.assert_allclose(getattr(every, values), getattr(reference, values)[:, columns], atol=1e-13)
    assert every.units == tuple(reference.units[column] for column in columns)
    free = pin.buildModelFromXML(arm.urdf)  # where the description, without couplings, has its tip
    for row, points in zip(every.positions, [arm.at(each).points for each in q], strict=True):
        data = free.createData()
        named = dict(zip(every.joint_names, row, strict=True))
        pin.framesForwardKinematics(free, data, np.array([named[name] for name in list(free.names)[1:]]))
        np.testing.assert_allclose(data.oMf[free.getFrameId("l5")].translation, points[-1], atol=1e-12)
    for file in ("motion.json", "motion.csv", "goal.yaml"):
        write = pp.motion.write_goal if file == "goal.yaml" else pp.save
        for motion in (exported, every):
            write(motion, tmp_path / file)
            read = pp.load(tmp_path / file)
            assert read.joint_names == motion.joint_names
            np.testing.assert_allclose(read.configurations(arm), q, atol=1e-9)
    again = pp.Arm.from_dict(arm.to_dict())
    assert again.drives == arm.drives
    np.testing.assert_allclose(
        reference.configurations(arm), q, atol=1e-12
    )  # whatever was exported of others


def test_a_motion_of_an_actuator_beside_the_chain_is_exported_and_checked():
    chain = (
        moving(
            "a",
            "l0",
            "l1",
            axis=Y,
            limits=limit(-1, 1),
            more='<mimic joint="motor" multiplier="-0.5" offset="0.1"/>',
        )
        + moving("b", "l1", "l2", axis=Z, limits=limit(-1, 1))
        + moving("motor", "l0", "side", "prismatic", axis=Z, limits=limit(-0.4, 0.4, 6))
    )
    with pytest.warns(PostureWarning, match="locked"):
        arm = pp.Arm.load(robot(links(["l0", "l1", "l2", "side"]) + chain), tip="l2")
    q = np.array([[0.1, 0.0], [0.0, 0.2]])
    exported = pp.JointTrajectory.from_configurations(arm, q, 1.0)
    assert exported.joint_names == ("motor", "b")
    assert exported.units == ("m", "rad")
    np.testing.assert_allclose(
        exported.positions, [[0.0, 0.0], [0.2, 0.2]], atol=1e-15
    )  # a = 0.1 - 0.5 motor
    every = exported.with_coupled(arm)
    assert every.joint_names == ("motor", "b", "a")
    wrong = replace(every, positions=every.positions + [0.01, 0.0, 0.0])
    with pytest.raises(InvalidValue, match=r"'motor' is 'up to 0\.01 off'; allowed: to follow"):
        wrong.matched(arm)
    with pytest.raises(InvalidValue, match="missing: 'motor'"):
        pp.JointTrajectory.from_positions(("b",), q[:, 1:], 1.0).matched(arm)


FOUR = [("revolute", Y, LINK, ""), ("revolute", Z, LINK, "")] * 2


def test_couplings_can_be_given():
    text = arm_text([(kind, axis, xyz, limit(-1, 1)) for kind, axis, xyz, _ in FOUR])
    arm = pp.Arm.load(text, couplings={"j3": "j1", "j4": ("j2", -0.5, 0.2)})
    assert arm.couplings == (Coupling("j3", "j1", 1.0, 0.0), Coupling("j4", "j2", -0.5, 0.2))
    assert arm.n_modules == 1
    again = pp.Arm.from_spec(arm.spec)
    assert again.couplings == arm.couplings
    np.testing.assert_array_equal(again.at(again.random(3)).points, arm.at(arm.random(3)).points)
    same = pp.Arm.load(arm.model)  # written as a description with <mimic>
    assert [each[:2] for each in same.couplings] == [each[:2] for each in arm.couplings]
    q = arm.random(5)
    np.testing.assert_allclose(same.at(q).points, arm.at(q).points, atol=1e-12)


@pytest.mark.parametrize(
    ("couplings", "error", "words"),
    [
        ({"j9": "j1"}, UnknownName, "moving joint is called 'j9'"),
        ({"j3": "j9"}, URDFError, "'j3': mimics joint 'j9', which does not exist"),
        ({"j3": ("j1", "much")}, InvalidValue, "couplings.j3"),
        ({"j3": ("j1", float("nan"))}, InvalidValue, "couplings.j3"),
        ({"j3": ()}, InvalidValue, "couplings.j3"),
        ({"j3": "j4", "j4": "j3"}, URDFError, "in a cycle"),
        ({"j3": ("j1", 1.0, 7.0)}, URDFError, "leave no room for a common motion"),
    ],
)
def test_couplings_that_mean_nothing_are_refused(couplings, error, words):
    text = arm_text([(kind, axis, xyz, limit(-1, 1)) for kind, axis, xyz, _ in FOUR])
    with pytest.raises(error) as caught:
        pp.Arm.load(text, couplings=couplings)
    assert words in str(caught.value)


def test_joints_that_follow_a_locked_one_are_held_where_it_puts_them():
    text = arm_text([(kind, axis, xyz, limit(-1, 1)) for kind, axis, xyz, _ in FOUR])
    held = pp.Arm.load(text, couplings={"j3": ("j1", 2.0, 0.1)}, locked={"j1": 0.2})
    same = pp.Arm.load(text, locked={"j1": 0.2, "j3": 0.5})
    assert held.joint_names == same.joint_names == ("j2", "j4")
    np.testing.assert_allclose(held.at([0.3, -0.2]).points, same.at([0.3, -0.2]).points, atol=1e-15)


def test_joints_that_turn_without_end_can_be_coupled():
    text = arm_text([("continuous", Y, LINK, ""), ("continuous", Z, LINK, "")] * 2)
    arm = pp.Arm.load(text, couplings={"j3": ("j1", 0.5), "j4": "j2"})
    assert (arm.nq, arm.nv) == (2, 2)
    assert np.all(np.isinf(arm.limits.upper))
    a = arm.at([0.0, 0.0]).points[-1]
    b = arm.at([2.0 * np.pi, 0.0]).points[-1]
    assert np.linalg.norm(a - b) > 0.1  # after a turn of j1 is j3 half a turn on


def test_modules_do_not_cut_through_coupled_joints():
    arm = pp.Arm.from_modules([continuum_section(disks) for disks in (2, 5, 3)])
    loaded = pp.Arm.load(arm.urdf)
    assert loaded.segmentation.sizes == (4, 10, 6)
    assert loaded.segmentation.can_follow
    with pytest.raises(InvalidValue, match="between coupled joints"):
        pp.Arm.load(arm.urdf, split=[5, 9, 6])


def test_every_posture_control_matrix_is_that_of_the_dense_jacobian():
    arm = coupled_arm(4)
    state = arm.chain_at(arm.random(1))
    known = arm.kinematics.task_constants
    screws = state.screws
    rows = Rows(known.every, known.dimensions, known.frames, COUPLING.full)
    for j in range(arm.nv):
        values = np.empty((arm.n_modules, 3))
        kernels.motions_along(screws, rows, np.eye(arm.nv)[j], values)
        expected = state.task_jacobians[:, :, j]
        np.testing.assert_allclose(values, expected, atol=1e-12)


@given(st.integers(0, 10_000))
def test_random_postures_are_reached_within_the_limits_of_all_joints(seed):
    arm = coupled_arm(seed % 12)
    rng = np.random.default_rng(seed)
    start, goal = (arm.random(rng) for _ in range(2))
    target = pp.Target.from_configuration(arm, goal)
    run = pp.track(arm, target, start, limits=pp.Limits(step=0.1), max_steps=500)
    assert run.converged, run
    for q in run.q:
        assert arm.within_limits(q)


@pytest.mark.parametrize("method", ["selection", "projection", "switching", "joint"])
def test_the_other_controllers_take_coupled_arms(method):
    arm = pp.Arm.from_template("Continuum", 6)
    rng = np.random.default_rng(0)
    start, goal = (smooth_configuration(arm, rng, 0.15) for _ in range(2))
    target = pp.Target.from_configuration(arm, goal)
    limits = pp.Limits(step=0.02)
    run = pp.track(arm, target, start, method, limits=limits, max_steps=300)
    assert np.all(np.isfinite(run.q))
    assert np.abs(np.diff(run.q, axis=0)).max() <= 0.02 * (1.0 + 1e-9)
    assert run.posture_error[-1] < 0.8 * run.posture_error[0]


def test_bare_points_of_an_arm_with_coupled_and_free_modules_are_found():
    arm = pp.Arm.from_modules([continuum_section(6, 0.1), template_ryrz(), continuum_section(3, 0.1)] * 2)
    for seed in range(5):
        q = smooth_configuration(arm, np.random.default_rng(seed), 0.15)
        found = pp.fit_points(arm, arm.at(q).points)
        assert found.residual.max() < 1e-9 * arm.length


def template_ryrz() -> ModuleTemplate:
    return ModuleTemplate("RyRz", (JointSpec("y"), JointSpec("z")), (0.025, 0.025))


# Sections of constant curvature.


def arc_end(y: float, z: float, length: float) -> np.ndarray:
    """The end of an arc that begins along x and turns by the rotation vector (0, y, z), (3,) [m]."""
    angle = float(np.hypot(y, z))
    if angle < 1e-9:
        return np.array([length, 0.0, 0.0])
    radius = length / angle
    across = np.cross([0.0, y / angle, z / angle], [1.0, 0.0, 0.0])
    return radius * (np.sin(angle) * np.array([1.0, 0.0, 0.0]) + (1.0 - np.cos(angle)) * across)


def farthest_from_arc(disks: int, bend: float) -> float:
    """Largest distance of the end of a section from that of the arc, in lengths, over all directions."""
    arm = pp.Arm.from_modules([continuum_section(disks, 0.2)])
    worst = 0.0
    for direction in np.linspace(0.0, 2.0 * np.pi, 48, endpoint=False):
        y = bend * np.cos(direction)
        z = bend * np.sin(direction)
        end = arm.at(np.array([y, z]) / disks).points[-1]
        worst = max(worst, float(np.linalg.norm(end - arc_end(y, z, 0.2))) / 0.2)
    return worst


@pytest.mark.parametrize("bend", [np.pi / 2, np.pi])
def test_a_section_nears_the_arc_with_the_square_of_the_number_of_disks(bend):
    errors = np.array([farthest_from_arc(disks, bend) for disks in (5, 10, 20, 40)])
    np.testing.assert_array_less(3.5, errors[:-1] / errors[1:])
    assert errors[1] < 0.01


def test_a_section_can_follow_the_curvature_of_its_arc():
    arm = pp.Arm.from_modules([continuum_section(20, 0.2, bend=1.5)] * 3)
    feasible = arm.can_follow(pp.Curve.line([0.0, 0.0, 0.0], [0.5, 0.0, 0.0]))
    assert feasible.max_curvature == pytest.approx(1.5 / 0.2, rel=0.01)


def test_a_section_can_stretch():
    arm = pp.Arm.from_modules([continuum_section(8, 0.2, stretch=0.04)] * 3)
    assert (arm.nv, arm.n_modules) == (9, 3)
    assert arm.slides.tolist() == [False, False, True] * 3
    straight = arm.at(arm.neutral()).points
    long = arm.at(arm.limits.upper * arm.slides).points
    np.testing.assert_allclose(np.linalg.norm(long - straight, axis=1), [0.04, 0.08, 0.12], atol=1e-12)


@pytest.mark.parametrize(
    "make",
    [
        lambda: continuum_section(0),
        lambda: continuum_section(3, 0.2, stretch=0.2),
        lambda: continuum_section(3, -1.0),
        lambda: ModuleTemplate("A", (JointSpec("y"), JointSpec("y", follows=1)), (0.1, 0.1)),
        lambda: ModuleTemplate("A", (JointSpec("y", follows=0),), (0.1,)),
        lambda: JointSpec("y", follows=-1),
    ],
)
def test_templates_that_mean_nothing_are_refused(make):
    with pytest.raises(InvalidValue):
        make()


def test_curves_are_followed_by_sections():
    arm = pp.Arm.from_template("Continuum", 5)
    curve = pp.Curve.helix(radius=0.25, pitch=0.6, turns=2)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        target = pp.resolve_targets(arm, curve)
    assert target.q is not None
    assert target.distance_from_curve(arm) < 0.01
    assert arm.within_limits(target.q)
