"""The arm and its state against closed forms, finite differences and an independent index."""

from __future__ import annotations

import pickle
import sys
import warnings
from concurrent.futures import ThreadPoolExecutor
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
import pytest
from analytic import enumeration, planar, ryrz
from arm.describing import HERE, LINK, X, Y, Z, arm_text, limit, pairs
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.typing import NDArray

import pinposture as pp
from pinposture.arm import continuum_section
from pinposture.arm.configurations import JointLimits, check_joint_positions, plausible_positions
from pinposture.control import controller_named
from pinposture.errors import InvalidValue, UnknownName, no_warnings

L1 = 0.03
L2 = 0.02
SLIDE = pp.JointSpec("x", type="prismatic", lower=0.0, upper=0.05)
SLIDE_10 = pp.JointSpec("x", type="prismatic", lower=0.0, upper=0.5)
PLACEMENT = pin.SE3(pin.rpy.rpyToMatrix(0.3, -1.1, 2.0), np.array([0.4, -2.0, 0.7]))


@pytest.fixture(scope="module")
def arm() -> pp.Arm:
    return pp.Arm.from_template("RyRz", 6, (L1, L2))


@pytest.fixture(scope="module")
def placed() -> pp.Arm:
    return pp.Arm.from_template("RyRz", 6, (L1, L2), base_placement=PLACEMENT)


def finite_differences(arm: pp.Arm, q: np.ndarray, h: float = 1e-6) -> np.ndarray:
    steps = h * np.eye(arm.nv)
    ahead = [arm.at(arm.integrate(q, d)).points for d in steps]
    behind = [arm.at(arm.integrate(q, -d)).points for d in steps]
    return np.moveaxis(np.array(ahead) - np.array(behind), 0, -1) / (2 * h)


@given(st.integers(0, 10**6))
def test_placements_and_jacobians_equal_the_closed_form(arm: pp.Arm, placed: pp.Arm, seed: int) -> None:
    for one in (arm, placed):
        q = one.random(np.random.default_rng(seed))
        state = one.at(q)
        p0 = one.base_placement.translation
        E0 = one.base_placement.rotation
        np.testing.assert_allclose(state.points, ryrz.points(q, L1, L2, p0, E0), atol=1e-12)
        np.testing.assert_allclose(state.rotations, ryrz.rotations(q, L1, L2, p0, E0), atol=1e-12)
        for k in (1, 3, 6):
            expected = ryrz.jacobian(k, q, L1, L2, p0, E0)
            np.testing.assert_allclose(state.jacobians[k - 1], expected, atol=1e-12)


def test_planar_jacobians_equal_appendix_a() -> None:
    arm = pp.Arm.from_template("Rz", 5, (0.15,))
    q = arm.random(np.random.default_rng(1))
    state = arm.at(q)
    lengths = np.full(5, 0.15)
    assert arm.dimension == 2
    np.testing.assert_allclose(state.points[:, :2], planar.points(q, lengths), atol=1e-13)
    # The rows follow `plane`, which for this arm is (x, y).
    np.testing.assert_allclose(np.abs(arm.plane), np.eye(3)[:2], atol=1e-12)
    for k in range(1, 6):
        expected = np.zeros((2, 5))
        expected[:, :k] = planar.jacobian(k, q, lengths)[:, :k]
        np.testing.assert_allclose(arm.plane[:, :2] @ state.task_jacobians[k - 1], expected, atol=1e-13)


def test_jacobians_equal_finite_differences_with_continuous_and_sliding_joints() -> None:
    module = pp.ModuleTemplate(
        "mixed",
        (
            pp.JointSpec((1.0, 1.0, 0.3)),
            pp.JointSpec("z", type="continuous"),
            pp.JointSpec("x", type="prismatic", lower=0.0, upper=0.05),
        ),
        (0.02, 0.03, 0.04),
    )
    arm = pp.Arm.from_modules([module] * 3, base_placement=PLACEMENT)
    assert (arm.nq, arm.nv) == (12, 9)
    for seed in range(5):
        q = arm.random(np.random.default_rng(seed))
        state = arm.at(q)
        np.testing.assert_allclose(state.jacobians, finite_differences(arm, q), atol=1e-8)


@given(st.integers(0, 10**6), st.sampled_from([0.0, 1e-6, 0.3, 3.0]))
def test_indices_equal_those_of_the_section_jacobians(arm: pp.Arm, seed: int, amplitude: float) -> None:
    q = amplitude * np.random.default_rng(seed).uniform(-1, 1, 12)
    found = arm.at(q).manipulability()
    expected = enumeration.index_matrix(lambda s, i: ryrz.section_jacobian(i, s, q, L1, L2), 6)
    np.testing.assert_allclose(found, expected, atol=2e-7)
    assert np.all((found >= 0.0) & (found <= 1.0))


def test_indices_do_not_depend_on_where_the_arm_stands(arm: pp.Arm) -> None:
    far = pp.Arm.from_template(
        "RyRz", 6, (L1, L2), base_placement=pin.SE3(PLACEMENT.rotation, np.full(3, 50.0))
    )
    q = arm.random(np.random.default_rng(3))
    np.testing.assert_allclose(far.at(q).manipulability(), arm.at(q).manipulability(), atol=1e-7)


def test_an_arm_whose_joints_do_not_move_its_tip_lies_along_a_line() -> None:
    roll = pp.ModuleTemplate("Rx", (pp.JointSpec("x"),), (0.1,))
    with no_warnings():  # it is one module
        arm = pp.Arm.from_modules([roll] * 3)
    target = pp.resolve_targets(arm, pp.Curve.line([0.0, 0.0, 0.0], [0.0, 1.0, 0.0]), placement="align")
    np.testing.assert_allclose(target.points[-1], [0.3, 0.0, 0.0], atol=1e-9)
    assert pp.track(arm, target, arm.straight()).converged


def test_planar_indices_use_the_plane() -> None:
    arm = pp.Arm.from_template("Rz", 6, (0.15,))
    q = arm.random(np.random.default_rng(2))
    lengths = np.full(6, 0.15)

    def section(s: int, i: int) -> np.ndarray:
        # Heading of the section does not matter for singular values.
        return planar.jacobian(i - s, q[s:i], lengths[s:i])[:, : i - s]

    np.testing.assert_allclose(arm.at(q).manipulability(), enumeration.index_matrix(section, 6), atol=1e-7)


def test_state_is_read_only_and_does_not_change_with_later_states(arm: pp.Arm) -> None:
    rng = np.random.default_rng(0)
    state = arm.at(arm.random(rng))
    before = state.points.copy()
    arm.at(arm.random(rng))
    assert np.array_equal(state.points, before)
    for array in (state.q, state.points, state.rotations, state.jacobians, state.manipulability()):
        with pytest.raises(ValueError, match="read-only"):
            array[...] = 0.0


def test_the_callers_model_is_never_written_to() -> None:
    model = pin.buildSampleModelManipulator()
    before = model.saveToString()
    names = [frame.name for frame in model.frames if frame.parentJoint > 0]
    arm = pp.Arm.from_model(model, [names[2], names[-1]], base_placement=PLACEMENT)
    arm.at(arm.random(np.random.default_rng(0))).manipulability()
    assert model.saveToString() == before
    plain = pp.Arm.from_model(model, [names[2], names[-1]])
    q = arm.random(np.random.default_rng(1))
    moved = plain.at(q).points @ PLACEMENT.rotation.T + PLACEMENT.translation
    np.testing.assert_allclose(arm.at(q).points, moved, atol=1e-12)
    np.testing.assert_allclose(arm.at(q).jacobians, finite_differences(arm, q), atol=1e-8)


def test_a_model_without_limits_has_none() -> None:
    model = pin.buildSampleModelManipulator()
    model.lowerPositionLimit[:] = -np.finfo(float).max
    model.upperPositionLimit[:] = np.finfo(float).max
    arm = pp.Arm.from_model(model, [model.frames[-1].name])
    assert np.all(np.isinf(arm.limits.lower)) and np.all(np.isinf(arm.limits.upper))
    assert np.all(np.abs(arm.random(np.random.default_rng(0))) <= np.pi)


def test_slides_and_turns_are_compared_by_a_scale_that_can_be_chosen() -> None:
    modules = [pp.ModuleTemplate("s", (pp.JointSpec("y"), pp.JointSpec("z"), SLIDE), (0.02, 0.03, 0.05))] * 3
    arm = pp.Arm.from_modules(modules)
    q = arm.random(np.random.default_rng(1))
    assert arm.characteristic_length == pytest.approx(0.1)
    for unit in (0.1, 0.01):
        scaled = arm.with_characteristic_length(unit)
        expected = enumeration.index(arm.at(q).jacobians[2] * np.tile([1.0, 1.0, unit], 3))
        assert scaled.at(q).manipulability()[0, 3] == pytest.approx(expected, abs=1e-7)
        assert pickle.loads(pickle.dumps(scaled)).characteristic_length == unit
        assert pp.Arm.from_dict(scaled.to_dict()).characteristic_length == unit
    # Ten times the size: the same indices.
    ten = [pp.ModuleTemplate("s", (pp.JointSpec("y"), pp.JointSpec("z"), SLIDE_10), (0.2, 0.3, 0.5), 0.1)] * 3
    large = pp.Arm.from_modules(ten)
    bigger = q * np.tile([1.0, 1.0, 10.0], 3)
    np.testing.assert_allclose(large.at(bigger).manipulability(), arm.at(q).manipulability(), atol=1e-7)
    for name in ("selection", "projection"):
        goal = pp.Target.from_configuration(arm, arm.random(np.random.default_rng(2)))
        ten_times = pp.Target.from_points(large, 10.0 * goal.points)
        free = pp.Limits(step=100.0)
        small = controller_named(name).step(arm.at(q), goal, free).dq
        found = controller_named(name).step(large.at(bigger), ten_times, free).dq
        np.testing.assert_allclose(found, small * np.tile([1.0, 1.0, 10.0], 3), atol=1e-6)
    with pytest.raises(InvalidValue, match="characteristic_length"):
        arm.with_characteristic_length(0.0)


def test_links_fixed_to_the_world_move_with_the_base(placed: pp.Arm) -> None:
    frame = placed.model.frames[placed.model.getFrameId("base", pin.FrameType.BODY)]
    np.testing.assert_allclose(frame.placement.homogeneous, PLACEMENT.homogeneous, atol=1e-15)


def test_an_arm_pickles_and_survives_as_data(placed: pp.Arm) -> None:
    q = placed.random(np.random.default_rng(5))
    for copy in (pickle.loads(pickle.dumps(placed)), pp.Arm.from_dict(placed.to_dict())):
        assert copy.control_points == placed.control_points
        np.testing.assert_array_equal(copy.at(q).points, placed.at(q).points)
        np.testing.assert_array_equal(copy.at(q).jacobians, placed.at(q).jacobians)
        np.testing.assert_array_equal(copy.limits.lower, placed.limits.lower)


def test_modules_of_our_templates_are_found_in_a_file() -> None:
    for names in (("RyRz",) * 4, ("RyRz", "RzRy", "RzRy", "RyRz"), ("Rz",) * 7):
        made = pp.Arm.from_modules([pp.template(name) for name in names])
        loaded = pp.Arm.load(made.urdf)
        assert loaded.module_joints == made.module_joints
        assert loaded.dimension == made.dimension
    grouped = pp.Arm.load(made.urdf, split=[3, 2, 2])
    assert [len(joints) for joints in grouped.module_joints] == [3, 2, 2]
    with pytest.raises(InvalidValue, match="divisor of 7"):
        pp.Arm.load(made.urdf, split=3)
    with pytest.raises(InvalidValue, match="add up to 7"):
        pp.Arm.load(made.urdf, split=[3, 3])


def test_locked_joints_leave_the_chain_where_they_were_locked() -> None:
    full = pp.Arm.from_template("RyRz", 3, (L1, L2))
    name = full.module_joints[1][0]
    arm = pp.Arm.load(full.urdf, split=[2, 1, 2], locked={name: 0.4})
    assert arm.nv == 5
    q = arm.random(np.random.default_rng(0))
    # The first module now ends where the next joint that moves sits, one link farther on.
    np.testing.assert_allclose(arm.at(q).points[1:], full.at(np.insert(q, 2, 0.4)).points[1:], atol=1e-12)
    with pytest.raises(UnknownName, match="elbow"):
        pp.Arm.load(full.urdf, locked={"elbow": 0.0})


def test_base_and_tip_choose_the_part_of_the_chain() -> None:
    full = pp.Arm.from_template("RyRz", 4, (L1, L2))
    links = [frame.name for frame in full.model.frames if frame.type == pin.FrameType.BODY]
    inner = next(name for name in links if name.startswith("m03"))
    with pytest.warns(pp.PostureWarning, match="off the chain"):
        arm = pp.Arm.load(full.urdf, tip=inner)
    assert arm.nv == 5
    assert arm.chain.joints == full.chain.joints[:5]


def test_straight_is_the_farthest_stretch_even_if_neutral_is_bent() -> None:
    module = pp.ModuleTemplate(
        "bent", (pp.JointSpec("z", lower=-2, upper=2), pp.JointSpec("y", lower=-2, upper=2)), (0.1, 0.1)
    )
    straight = pp.Arm.from_modules([module] * 2)
    # Turn every later joint's frame by 0.9 rad about its own axis: neutral is now a zigzag.
    root = ElementTree.fromstring(straight.urdf)
    for joint in root.findall("joint")[1:]:
        if joint.get("type") == "revolute":
            axis = np.array([float(x) for x in joint.find("axis").get("xyz").split()])
            joint.find("origin").set("rpy", " ".join(map(str, 0.9 * axis)))
    arm = pp.Arm.load(ElementTree.tostring(root, encoding="unicode"))
    assert np.linalg.norm(arm.at(arm.neutral()).points[-1]) < 0.35
    reach = np.linalg.norm(arm.at(arm.straight()).points[-1] - arm.chain.base)
    assert reach == pytest.approx(arm.length)
    assert arm.length == pytest.approx(0.4)


@pytest.mark.parametrize(("axis", "end"), [(X, 0.4), ("-1 0 0", -0.1)])
def test_slides_extend_the_straight_arm_to_their_limits_and_its_joints_are_at_zero(axis, end):
    arm = pp.Arm.load(arm_text([("prismatic", axis, HERE, limit(-0.1, 0.4)), *pairs(8)]))
    np.testing.assert_allclose(arm.straight(), [end, *[0.0] * 16], rtol=0, atol=1e-15)
    assert arm.within_limits(arm.straight(), tolerance=0.0)


@pytest.mark.parametrize(
    ("q", "message"),
    [
        (np.zeros(11), r"shape.*\(11,\).*\(12,\)"),
        (np.full(12, np.nan), r"q\[0\] is nan"),
        (np.r_[np.zeros(7), np.inf, np.zeros(4)], r"q\[7\] is inf"),
        ("abc", r"numbers of shape \(12,\)"),
        (np.zeros((12, 1)), "shape"),
    ],
)
def test_a_bad_configuration_is_named(arm: pp.Arm, q: object, message: str) -> None:
    with pytest.raises(InvalidValue, match=message):
        arm.at(q)


@pytest.mark.long
def test_one_number_per_joint_is_no_configuration_of_continuous_joints() -> None:
    module = pp.ModuleTemplate("c", (pp.JointSpec("y", type="continuous"), pp.JointSpec("z")), (0.1, 0.1))
    arm = pp.Arm.from_modules([module] * 2)
    with pytest.raises(InvalidValue, match=r"\(4,\); allowed: \(6,\) .* see Arm.configuration"):
        arm.at([0.1, 0.2, 0.3, 0.4])
    with pytest.raises(InvalidValue, match=r"q_measured .*\(5,\); allowed: \(6,\)"):
        pp.Tracker(arm, limits=pp.Limits(dt=0.01)).step([0.1] * 5)
    with pytest.raises(InvalidValue, match=r"\(5,\); allowed: \(6,\) for this arm$"):
        arm.at([0.1] * 5)


def test_a_singular_rotation_is_refused_for_continuous_joints() -> None:
    module = pp.ModuleTemplate("c", (pp.JointSpec("y", type="continuous"),) * 2, (0.1, 0.1))
    arm = pp.Arm.from_modules([module])
    with pytest.raises(InvalidValue, match="cosine and sine"):
        arm.at(np.zeros(4))
    positions = np.array([3.0, -0.5])
    np.testing.assert_allclose(arm.positions(arm.configuration(positions)), positions, atol=1e-12)


def test_control_points_must_exist_and_follow_the_chain() -> None:
    model = pin.buildSampleModelManipulator()
    names = [frame.name for frame in model.frames if frame.parentJoint > 0]
    with pytest.raises(UnknownName, match="nowhere"):
        pp.Arm.from_model(model, ["nowhere"])
    with pytest.raises(InvalidValue, match="base to tip"):
        pp.Arm.from_model(model, [names[-1], names[0]])
    with pytest.raises(InvalidValue, match="at least one frame"):
        pp.Arm.from_model(model, [])


@pytest.mark.parametrize("bound", [limit(-1e6, 1e6), limit(-100, 100), limit()])
def test_a_base_that_slides_without_real_limits_is_left_where_it_is(bound):
    joints = [("prismatic", X, HERE, bound), ("prismatic", Y, HERE, bound), *pairs(3)]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        arm = pp.Arm.load(arm_text(joints))
    assert list(arm.base_slides) == [True] * 2 + [False] * 6
    assert np.all(arm.positions(arm.straight())[:2] == 0.0)
    tip = arm.at(arm.straight()).points[-1]
    assert np.linalg.norm(tip - arm.chain.base) == pytest.approx(arm.length, rel=1e-6)
    drawn = np.array([arm.positions(arm.random(np.random.default_rng(seed))) for seed in range(50)])
    assert 0.3 * arm.length < np.abs(drawn[:, :2]).max() <= arm.length
    assert np.abs(drawn[:, 2:]).max() <= 1.0


def test_real_limits_of_slides_are_drawn_from_to_their_ends():
    joints = [("prismatic", X, HERE, limit(0, 20)), *pairs(3)]
    arm = pp.Arm.load(arm_text(joints))
    drawn = [arm.positions(arm.random(np.random.default_rng(seed)))[0] for seed in range(200)]
    assert not arm.base_slides.any()
    assert 0.0 <= min(drawn) < 1.0
    assert 19.0 < max(drawn) <= 20.0


def test_hinges_with_limits_of_many_turns_are_drawn_from_one():
    joints = [("revolute", Y, LINK, limit(-1e6, 1e6)), ("revolute", Z, LINK, limit(-12, 12))] * 2
    arm = pp.Arm.load(arm_text(joints))
    drawn = np.abs([arm.positions(arm.random(np.random.default_rng(seed))) for seed in range(100)])
    assert np.all(drawn.max(axis=0)[[0, 2]] <= np.pi)
    assert np.all(drawn.max(axis=0)[[1, 3]] > 6.0)
    assert not arm.base_slides.any()


@given(st.sampled_from([-1.0, 1.0]), st.floats(-14.0, -3.0), st.floats(-3.1, 3.1))
def test_continuous_joints_are_told_apart_to_all_digits_near_half_a_turn(
    side: float, short: float, start: float
) -> None:
    """The angle between them is known in advance: half a turn less a little."""
    arm = pp.Arm.from_modules(
        [pp.ModuleTemplate("turning", [pp.JointSpec(axis, type="continuous") for axis in "yz"], [0.03] * 2)]
    )
    way = side * (np.pi - 10.0**short)
    one, other = (
        np.array([np.cos(a), np.sin(a), np.cos(b), np.sin(b)]) for a, b in [(start, 0.0), (start + way, way)]
    )
    np.testing.assert_allclose(arm.difference(one, other), [way, way], rtol=0.0, atol=2e-15)


def test_an_arm_tells_its_name_and_where_it_begins_and_ends() -> None:
    arm = pp.Arm.from_template("RyRz", 3)
    assert (arm.name, arm.base, arm.tip) == ("RyRz_3", "base", "tip")
    same = pp.Arm.from_model(arm.model, arm.control_points)
    assert (same.name, same.tip) == ("RyRz_3", arm.control_points[-1])
    assert same.base in [frame.name for frame in arm.model.frames]


def test_random_configurations_need_no_generator() -> None:
    arm = pp.Arm.from_template("RyRz", 3)
    np.testing.assert_array_equal(arm.random(5), arm.random(np.random.default_rng(5)))
    drawn = [arm.random() for _ in range(2)]
    assert np.abs(drawn[0] - drawn[1]).max() > 0.0
    assert all(arm.within_limits(q) for q in drawn)


def frame_placement(arm: pp.Arm, q: np.ndarray, frame: str) -> pin.SE3:
    data = arm.model.createData()
    pin.framesForwardKinematics(arm.model, data, q)
    return pin.SE3(data.oMf[arm.model.getFrameId(frame)])


@pytest.mark.parametrize("kind", ["feed", "coupled"])
def test_the_jacobian_of_any_frame_is_its_finite_difference(kind: str) -> None:
    if kind == "coupled":
        arm = pp.Arm.from_modules([continuum_section(3)] * 2, base_placement=PLACEMENT)
    else:
        slide = pp.ModuleTemplate("Feed", (SLIDE,), (0.05,), 0.01)
        arm = pp.Arm.from_modules([slide, *[pp.template("RyRz")] * 2], base_placement=PLACEMENT)
    q = arm.random(3)
    h = 1e-6
    bodies = [str(each.name) for each in arm.model.frames if each.type == pin.FrameType.BODY]
    for frame in (*bodies, *arm.control_points):
        expected = np.empty((6, arm.nv))
        for u, step in enumerate(h * np.eye(arm.nv)):
            ahead, behind = (
                frame_placement(arm, arm.integrate(q, sign * step), frame) for sign in (1.0, -1.0)
            )
            expected[:3, u] = (ahead.translation - behind.translation) / (2 * h)
            expected[3:, u] = pin.log3(ahead.rotation @ behind.rotation.T) / (2 * h)
        np.testing.assert_allclose(arm.at(q).jacobian(frame), expected, atol=1e-8, err_msg=frame)
    with pytest.raises(UnknownName, match="no frame is called 'nose'"):
        arm.at(q).jacobian("nose")


def test_the_jacobian_of_a_long_arm_is_that_of_its_control_points() -> None:
    arm = pp.Arm.from_template("RyRz", modules=60)
    state = arm.at(arm.random(0))
    tip = state.jacobian(arm.control_points[-1])
    np.testing.assert_array_equal(tip[:3], state.jacobians[-1])
    np.testing.assert_array_equal(tip[3:], state.angular_jacobians[-1])
    with pytest.raises(InvalidValue, match="a control point, as the arm has more than 100"):
        state.jacobian("base")


def test_degrees_count_for_joints_that_turn() -> None:
    slide = pp.ModuleTemplate("Feed", (SLIDE,), (0.05,), 0.01)
    arm = pp.Arm.from_modules([slide, pp.template("RyRz")])
    q = arm.from_degrees([0.02, 90.0, -45.0])
    np.testing.assert_allclose(arm.positions(q), [0.02, np.pi / 2, -np.pi / 4])
    np.testing.assert_allclose(arm.to_degrees(q), [0.02, 90.0, -45.0])
    with pytest.raises(InvalidValue, match="positions"):
        arm.from_degrees([1.0, 2.0])


@given(
    lower=arrays(float, 5, elements=st.one_of(st.just(-np.inf), st.floats(-10.0, -0.1))),
    upper=arrays(float, 5, elements=st.one_of(st.just(np.inf), st.floats(0.1, 10.0))),
    slides=arrays(bool, 5),
    positions=arrays(float, 5, elements=st.floats(-60.0, 60.0)),
)
def test_positions_called_plausible_pass_the_check_in_silence(
    lower: np.ndarray, upper: np.ndarray, slides: NDArray[np.bool_], positions: np.ndarray
) -> None:
    limits = JointLimits(lower, upper, np.ones(5))
    low, high = plausible_positions(limits, slides)
    assert np.all(low <= np.maximum(lower, -20.0)) and np.all(high >= np.minimum(upper, 20.0))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_joint_positions("q", np.clip(positions, low, high), limits, slides, list("abcde"))


def test_threads_may_share_an_arm(arm: pp.Arm) -> None:
    fresh = pp.Arm.from_template("RyRz", 6, (L1, L2))
    rows = np.random.default_rng(0).uniform(-1.0, 1.0, (40, arm.nv))

    def measure(q: np.ndarray) -> list[np.ndarray]:
        state = fresh.at(q)
        return [
            state.points,
            state.rotations,
            state.jacobians,
            state.manipulability(),
            state.chain_state.points,
        ]

    interval = sys.getswitchinterval()
    sys.setswitchinterval(1e-5)  # threads take turns within each call
    try:
        with ThreadPoolExecutor(4) as pool:
            found = list(pool.map(measure, rows))
    finally:
        sys.setswitchinterval(interval)
    for q, values in zip(rows, found, strict=True):
        for value, expected in zip(values, measure(q), strict=True):
            np.testing.assert_array_equal(value, expected)
