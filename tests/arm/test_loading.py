"""What becomes of a description as an arm: refused for the true reason, or loaded with the due warnings."""

from __future__ import annotations

import json
import pickle
import time
import warnings

import numpy as np
import pinocchio as pin
import pytest
from arm.awkward import FINGERS, REFUSED, SILENT, WARNED
from arm.describing import LINK, Y, Z, arm_text, fixed, limit, links, moving, pairs, robot
from arm.faults import FAULTS

import pinposture as pp
from pinposture.errors import InvalidValue, PostureError, PostureWarning, URDFError


def loaded(text, **arguments):
    """The arm, and the warnings given on the way."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        arm = pp.Arm.load(text, **arguments)
    assert all(entry.category is PostureWarning and entry.filename == __file__ for entry in caught)
    return arm, [str(entry.message) for entry in caught]


def test_the_corpus_is_as_large_as_it_should_be():
    assert len(FAULTS) + len(REFUSED) + len(WARNED) + len(SILENT) >= 100


@pytest.mark.parametrize("fault", FAULTS)
def test_a_faulty_description_is_refused_as_an_arm_too(fault):
    start = time.perf_counter()
    text, element, words, _ = FAULTS[fault]
    with pytest.raises(URDFError) as caught:
        pp.Arm.load(text)
    assert caught.value.element == element and words in caught.value.reason
    assert time.perf_counter() - start < 1.0


@pytest.mark.parametrize("case", REFUSED)
def test_what_makes_no_arm_is_refused_for_the_true_reason(case):
    text, arguments, kind, words = REFUSED[case]
    with pytest.raises(PostureError) as caught:
        pp.Arm.load(text, **arguments)
    assert type(caught.value) is kind
    assert words in str(caught.value)


@pytest.mark.parametrize("case", WARNED)
def test_what_may_surprise_is_a_warning_and_stays_with_the_arm(case):
    text, arguments, joints, modules, words = WARNED[case]
    arm, messages = loaded(text, **arguments)
    assert (arm.nv, arm.n_modules) == (joints, modules)
    assert len(messages) == len(words)
    for message, expected in zip(messages, words, strict=True):
        assert expected in message
    assert arm.warnings == tuple(messages)
    assert np.all(np.isfinite(arm.at(arm.random(np.random.default_rng(0))).jacobians))


@pytest.mark.parametrize("case", SILENT)
def test_what_is_merely_awkward_loads_without_a_word(case):
    text, arguments, sizes = SILENT[case]
    arm, messages = loaded(text, **arguments)
    assert messages == [] and arm.warnings == ()
    assert [len(names) for names in arm.module_joints] == sizes
    assert len(set(arm.control_points)) == len(sizes)


def test_absent_limits_are_open_and_speeds_of_zero_or_infinity_are_none():
    joints = [
        ("revolute", Y, LINK, limit(velocity=0)),
        ("revolute", Z, LINK, limit(-1, 2, velocity="INF")),
        ("revolute", Y, LINK, limit(-1e16, 1e16, velocity=1e16)),
        ("prismatic", Z, LINK, limit(-0.5, 0.25, velocity=3)),
        ("continuous", Y, LINK, limit(-1, 1)),
    ]
    arm, _ = loaded(arm_text(joints))
    assert arm.limits.lower.tolist() == [-np.inf, -1.0, -np.inf, -0.5, -np.inf]
    assert arm.limits.upper.tolist() == [np.inf, 2.0, np.inf, 0.25, np.inf]
    assert arm.limits.velocity.tolist() == [np.inf, np.inf, np.inf, 3.0, 2.0]
    again, _ = loaded(arm.urdf)
    assert all(map(np.array_equal, again.limits, arm.limits))


def test_the_last_joint_may_be_continuous_and_still_has_no_limits():
    arm, _ = loaded(arm_text([("revolute", Y, LINK), ("continuous", Z, LINK, "")]))
    assert arm.limits.lower.tolist() == [-1.0, -np.inf]


def test_joints_off_the_chain_stand_where_the_file_puts_them():
    """A joint on the way to the base, nearest zero within its limits; one that follows it; one locked."""
    text = robot(
        links(["root", "a", "b", "l0", "l1"])
        + moving("lift", "root", "a", "prismatic", Z, "0 0 0", limit(0.2, 0.9))
        + moving(
            "lift2",
            "a",
            "b",
            "prismatic",
            Z,
            "0 0 0",
            limit(0, 9),
            '<mimic joint="lift" multiplier="2" offset="1"/>',
        )
        + moving("turn", "b", "l0", "revolute", Z, "0 0 0", limit(-3, 3))
        + moving("j1", "l0", "l1", axis=Z)
        + links(["tip"])
        + fixed("jt", "l1", "tip", LINK)
    )
    arm, messages = loaded(text, base="l0", tip="tip", locked={"turn": np.pi / 2})
    assert "2 joints off the chain" in messages[0]
    np.testing.assert_allclose(arm.chain.base, [0.0, 0.1, 0.2 + 1.4], atol=1e-12)
    np.testing.assert_allclose(arm.chain.points[-1], [0.0, 0.2, 1.6], atol=1e-12)


def test_a_locked_continuous_joint_stands_at_its_angle():
    joints = [("continuous", Z, "0 0 0", ""), *pairs(1)]
    arm, _ = loaded(arm_text(joints), locked={"j1": 0.7})
    np.testing.assert_allclose(arm.chain.base, 0.1 * np.array([np.cos(0.7), np.sin(0.7), 0.0]), atol=1e-12)


def test_followers_of_each_other_do_not_hang():
    more = [f'<mimic joint="{name}"/>' for name in ("mb", "ma", "mc")]
    extra = links("abc") + "".join(
        moving(f"m{name}", "l2", name, more=follow) for name, follow in zip("abc", more, strict=True)
    )
    arm, messages = loaded(arm_text(pairs(2), extra=extra))
    assert arm.nv == 4 and "3 joints off the chain" in messages[0]


def test_a_gripper_ends_the_arm_but_a_coupled_linkage_does_not():
    assert loaded(arm_text(pairs(2), extra=FINGERS))[0].report.tip == "tip"
    # The bar of a parallelogram follows joint 2, behind which more joints move by themselves.
    bar = links(["bar"]) + moving("jbar", "l0", "bar", more='<mimic joint="j2"/>')
    arm, messages = loaded(arm_text(pairs(2), extra=bar))
    assert (arm.nv, arm.report.tip) == (4, "tip")
    assert len(messages) == 2
    # Where there is nothing but a gripper, one of its fingers is the arm.
    alone = robot(links(["tip", "pad"]) + FINGERS + fixed("jp", "f1", "pad", LINK))
    assert loaded(alone)[0].chain.joints == ("finger1",)


def test_the_tip_is_the_farthest_link_behind_the_last_joint_not_the_deepest():
    camera = links("abc") + fixed("s1", "l4", "a", "0 0 0.03") + fixed("s2", "a", "b") + fixed("s3", "b", "c")
    assert loaded(arm_text(pairs(2), extra=camera))[0].report.tip == "tip"
    longer = camera.replace("0 0 0.03", "0 0 0.3")
    assert loaded(arm_text(pairs(2), extra=longer))[0].report.tip == "c"


def test_modules_end_at_the_origins_of_the_links_that_are_named():
    full, _ = loaded(arm_text(pairs(3)))
    arm, _ = loaded(arm_text(pairs(3)), split=["l3", "l5", "tip"])
    assert arm.module_joints == full.module_joints
    q = full.random(np.random.default_rng(0))
    np.testing.assert_allclose(arm.at(q).points, full.at(q).points, atol=1e-13)
    np.testing.assert_allclose(arm.at(q).jacobians, full.at(q).jacobians, atol=1e-13)
    mark = links(["mark"]) + fixed("jm", "l2", "mark", "0.03 0 0.02")
    arm, _ = loaded(arm_text(pairs(3), extra=mark), split=["mark", "tip"])
    assert [len(names) for names in arm.module_joints] == [2, 4]
    np.testing.assert_allclose(arm.chain.points[0], [0.23, 0.0, 0.02], atol=1e-13)


def test_a_sliding_link_is_moved_by_its_own_joint():
    joints = [("revolute", Y, LINK), ("prismatic", X_AXIS, LINK), ("revolute", Z, LINK)]
    arm, _ = loaded(arm_text(joints), split=["l2", "tip"])
    assert [len(names) for names in arm.module_joints] == [2, 1]
    assert np.any(arm.at(arm.neutral()).jacobians[0][:, 1])


X_AXIS = "1 0 0"


def test_what_was_decided_survives_pickling_and_saving(tmp_path):
    path = tmp_path / "arm.urdf"
    path.write_text(arm_text(pairs(2), extra=FINGERS))
    arm, messages = loaded(path, package_dirs=[tmp_path / "meshes"])
    assert arm.package_dirs == (str(tmp_path / "meshes"), str(tmp_path))
    described = json.loads(json.dumps(arm.to_dict()))
    for copy in (pickle.loads(pickle.dumps(arm)), pp.Arm.from_dict(described)):
        assert copy.report == arm.report
        assert copy.warnings == tuple(messages)
        assert copy.segmentation == arm.segmentation
    made = pp.Arm.from_model(pin.buildSampleModelManipulator(), ["effector_body"])
    assert made.warnings == made.package_dirs == () and made.report is None
    assert sum(made.segmentation.sizes) == made.nv


def test_the_same_name_of_link_and_joint_is_found_as_a_control_point():
    model = pin.buildModelFromXML(arm_text(pairs(2)).replace('"jt"', '"tip"'))
    arm = pp.Arm.from_model(model, ["l2", "tip"])
    np.testing.assert_allclose(arm.chain.points[-1], [0.5, 0.0, 0.0], atol=1e-13)


def test_a_model_whose_limits_are_crossed_is_refused():
    model = pin.buildModelFromXML(arm_text(pairs(2)))
    model.lowerPositionLimit[2] = 1.0
    model.upperPositionLimit[2] = -1.0
    with pytest.raises(InvalidValue, match=r"limits of joint 'j3' is \(1.0, -1.0\); allowed: lower <= upper"):
        pp.Arm.from_model(model, ["l2", "tip"])


def test_a_speed_limit_of_zero_is_reported_for_models_too():
    model = pin.buildModelFromXML(arm_text(pairs(2)))
    model.velocityLimit[:] = [0.0, 1.0, 0.0, 1.0]
    arm, messages = loaded(model)
    assert messages == ["the velocity limit of joints 'j1', 'j3' is 0; treated as no limit"]
    np.testing.assert_array_equal(arm.limits.velocity, [np.inf, 1.0, np.inf, 1.0])


INERTIA = '<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>'
CAPSULE = '<collision><geometry><capsule radius="0.01" length="0.03"/></geometry></collision>'


@pytest.mark.parametrize(
    "inside",
    [
        CAPSULE,
        "<collision/><visual/>",
        '<visual><geometry><torus radius="1"/></geometry></visual>',
        '<visual><geometry><box size="1 1"/></geometry><material/></visual>',
        '<visual><geometry><box size="1 1 1"/></geometry><material name="none"/></visual>',
        '<inertial><mass valu="1"/></inertial>',
        '<inertial><mass value="1"/></inertial>',
        f'<inertial><mass value="heavy"/>{INERTIA}</inertial>',
        f'<inertial><origin xyz="0 0"/><mass value="1"/>{INERTIA}</inertial>',
    ],
)
def test_loading_prints_nothing(capfd: pytest.CaptureFixture[str], inside: str) -> None:
    text = arm_text(pairs(2))
    material = '<material name="a"><color rgba="2 0"/></material><material name="b"/><gazebo reference="x"/>'
    changed = text.replace('<link name="l1"/>', f'<link name="l1">{inside}</link>')
    changed = changed.replace("</robot>", f"{material}</robot>")
    assert inside in changed
    arm = pp.Arm.load(changed)
    assert capfd.readouterr() == ("", "")
    assert arm.urdf == changed
    q = arm.random(0)
    np.testing.assert_array_equal(arm.at(q).points, pp.Arm.load(text).at(q).points)


def test_masses_are_in_the_model_as_in_that_of_pinocchio() -> None:
    text = pp.Arm.from_template("RyRz", 3).urdf
    for mine, its in zip(pp.Arm.load(text).model.inertias, pin.buildModelFromXML(text).inertias, strict=True):
        np.testing.assert_array_equal(mine.matrix(), its.matrix())
