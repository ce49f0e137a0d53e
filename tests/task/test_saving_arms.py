"""The arm of a task that was saved: as it was described, a template, or a URDF file beside the task."""

from __future__ import annotations

import json
import pickle
import sys
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from arm.awkward import SILENT, WARNED
from arm.describing import LINK, arm_text, links, moving, pairs
from arm.test_example_robots import LOADED, ROBOTS
from arms import template_arm
from task.same_tasks import assert_same_arms

import pinposture as pp
from pinposture.arm import ArmSpec
from pinposture.errors import FileError, InvalidValue, PostureWarning

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

AWAKE = [(name, *case[:2]) for cases in (WARNED, SILENT) for name, case in cases.items()]


def six_modules() -> pp.Arm:
    return template_arm("RyRz", 6)


def arm_of(source: Any, **arguments: Any) -> pp.Arm:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", PostureWarning)
        return pp.Arm.load(source, **arguments)


def task_of(arm: pp.Arm, **more: Any) -> pp.Task:
    line = pp.Curve.line((0, 0, 0), (1, 0, 0))
    return pp.Task(
        arm, (pp.Keyframe(line), pp.Keyframe(line, time=1.0)), pp.Limits(step=None, dt=0.02), **more
    )


def saved(arm: pp.Arm, path: Path, **more: Any) -> tuple[pp.Arm, dict[str, Any]]:
    """The arm that comes back, and what the file says of it."""
    task_of(arm, **more).save(path)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", PostureWarning)
        return pp.Task.load(path).arm, tomllib.loads(path.read_text())["arm"]


@pytest.mark.parametrize(
    ("make", "table"),
    [
        (six_modules, {"template": "RyRz", "modules": 6}),
        (lambda: pp.Arm.from_template("Rz", 1), {"template": "Rz", "modules": 1}),
        (
            lambda: pp.Arm.from_template("RzRzRz", 2, (0.1, 1 / 3, 0)),
            {"template": "RzRzRz", "modules": 2, "link_lengths": [0.1, 1 / 3, 0]},
        ),
        (
            lambda: pp.Arm.from_template("RzRy", 2, base_placement=pin.SE3(np.eye(3), np.array([0, 0, 0.5]))),
            {"template": "RzRy", "modules": 2, "placement": {"position": [0, 0, 0.5]}},
        ),
        (
            lambda: six_modules().with_characteristic_length(0.2),
            {"template": "RyRz", "modules": 6, "characteristic_length": 0.2},
        ),
    ],
)
def test_an_arm_of_a_template_is_written_as_one(
    tmp_path: Path, make: Callable[[], pp.Arm], table: dict[str, Any]
) -> None:
    arm = make()
    again, written = saved(arm, tmp_path / "task.toml")
    assert written == table
    assert_same_arms(again, arm)
    assert [file.name for file in tmp_path.iterdir()] == ["task.toml"]


def test_an_arm_that_only_bears_the_name_of_a_template_is_not_taken_for_one(tmp_path: Path) -> None:
    arms = [
        pp.Arm.from_modules([pp.template("RyRz").with_limits(-1, 1)] * 2, name="RyRz_2"),
        pp.Arm.from_modules([pp.template("RzRy")] * 2, name="RyRz_2"),
        pp.Arm.from_modules([pp.template("RyRz")] * 2, name="RyRz_3"),
        pp.Arm.from_modules([pp.template("RyRz")] * 2, name="RyRz_0"),
        pp.Arm.load(pp.Arm.from_template("RyRz", 2).urdf, split=4),
    ]
    with pytest.warns(PostureWarning, match="1 joint off the chain"):
        arms.append(pp.Arm.load(pp.Arm.from_template("RyRz", 2).urdf, tip="m02_l1"))
    for number, arm in enumerate(arms):
        again, written = saved(arm, tmp_path / f"{number}.toml")
        assert written["urdf"] == f"{number}.urdf"
        assert_same_arms(again, arm)


XACRO = """<robot name="a" xmlns:xacro="http://www.ros.org/wiki/xacro">
<xacro:arg name="extra" default="false"/>
<link name="b"/><link name="l"/><link name="t"/>
<joint name="j" type="revolute"><parent link="b"/><child link="l"/><axis xyz="0 0 1"/>
<limit lower="-2" upper="2" effort="1" velocity="1"/>
<safety_controller k_velocity="1" soft_lower_limit="-1" soft_upper_limit="1"/></joint>
<joint name="f" type="fixed"><parent link="l"/><child link="t"/>
<origin xyz="$(arg pitch) 0 0"/></joint></robot>"""


def test_arguments_of_xacro_and_hard_limits_are_kept(tmp_path: Path) -> None:
    file = tmp_path / "arm.urdf.xacro"
    file.write_text(XACRO)
    for number, hard in enumerate((False, True)):
        arm = pp.Arm.load(file, xacro_args={"pitch": 0.25, "extra": True}, hard_limits=hard)
        again, written = saved(arm, tmp_path / f"{number}.toml")
        assert written["urdf"] == "arm.urdf.xacro"
        assert written["xacro_args"] == {"pitch": "0.25", "extra": "true"}
        assert written.get("hard_limits", False) == hard
        assert_same_arms(again, arm)
        assert (again.length, again.limits.upper[0]) == (0.25, 2.0 if hard else 1.0)
        assert again.spec == arm.spec
    file.write_text(XACRO.replace("$(arg pitch)", "0.5"))  # then the arm as it was is written out
    with pytest.warns(PostureWarning, match="it is written out"):
        again, written = saved(arm, tmp_path / "changed.toml")
    assert written == {"urdf": "changed.urdf", "hard_limits": True}
    assert_same_arms(again, arm)


def test_arguments_of_xacro_in_a_task_file_are_numbers_truth_values_or_text(tmp_path: Path) -> None:
    (tmp_path / "arm.urdf.xacro").write_text(XACRO)
    file = tmp_path / "task.toml"
    task_of(six_modules()).save(file)
    text = file.read_text()
    table = '[arm]\nurdf = "arm.urdf.xacro"\n'
    rest = text[text.index("[limits]") :]
    head = text[: text.index("[arm]")]
    file.write_text(head + table + "xacro_args = { pitch = 0.5, extra = true }\n" + rest)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", PostureWarning)
        task = pp.Task.load(file)
    assert task.arm.length == 0.5
    for given, says in (
        ("xacro_args = { pitch = 0.5, extre = true }", "arm.xacro_args"),
        ("xacro_args = 3", "arm.xacro_args: is 3; allowed: a table"),
        ("xacro_args = { pitch = [1] }", "arm.xacro_args"),
        ("", "--xacro-arg pitch:=..."),
        ('xacro_args = { pitch = "0.5" }\nhard_limits = 1', "arm.hard_limits: is 1; allowed: true or false"),
    ):
        file.write_text(head + table + given + "\n" + rest)
        with pytest.raises(FileError) as caught:
            pp.Task.load(file)
        assert says in str(caught.value)


@pytest.mark.parametrize(("name", "text", "arguments"), AWAKE, ids=[name for name, *_ in AWAKE])
def test_urdf_text_is_written_beside_the_task(
    tmp_path: Path, name: str, text: str, arguments: dict[str, Any]
) -> None:
    turn = pin.SE3(pin.rpy.rpyToMatrix(0.3, -0.2, 1.5), np.array([0.1, 0.2, 0.3]))
    for number, placement in enumerate((None, turn)):
        arm = arm_of(text, base_placement=placement, **arguments)
        again, written = saved(arm, tmp_path / f"walk.{number}.toml")
        assert written["urdf"] == f"walk.{number}.urdf"
        assert (tmp_path / f"walk.{number}.urdf").read_text() == arm.urdf
        assert_same_arms(again, arm)
        assert (again.report.base, again.report.tip) == (arm.report.base, arm.report.tip)


@pytest.mark.parametrize("name", LOADED)
def test_robots_that_others_wrote(tmp_path: Path, name: str) -> None:
    _, tip = LOADED[name]
    arm = arm_of(ROBOTS / name, tip=tip)
    again, _ = saved(arm, tmp_path / "task.toml")
    assert_same_arms(again, arm)
    assert set(arm.package_dirs) <= set(again.package_dirs)  # meshes are found where they were
    again, written = saved(arm, tmp_path / "other" / "task.toml")
    assert list(written) == ["urdf", "tip"][: 1 + (tip is not None)]
    assert_same_arms(again, arm)
    beside, written = saved(arm_of(arm.urdf, tip=tip), tmp_path / "other" / "text.toml")
    assert written["urdf"] == "text.urdf"
    assert_same_arms(beside, arm)


def test_locked_joints_are_found_where_they_are(tmp_path: Path) -> None:
    branch = links("ab") + moving("ja", "l1", "a", more="") + moving("jb", "a", "b", "prismatic")
    text = arm_text(
        [*pairs(2), ("continuous", "1 2 3", LINK, ""), ("prismatic", "0 1 1", LINK), *pairs(1)], extra=branch
    )
    locked = {"j2": 0.3, "j3": 0.0, "j5": -2.75, "j6": 0.125, "ja": -0.4}
    arm = arm_of(text, tip="tip", locked=locked)
    again, written = saved(arm, tmp_path / "task.toml")
    assert written["locked"] == locked
    assert_same_arms(again, arm)


def test_couplings_that_were_given_are_kept(tmp_path: Path) -> None:
    couplings = {"j3": "j1", "j4": ("j2", -0.5), "j5": ("j1", 0.25, 0.1)}
    arm = arm_of(arm_text(pairs(3)), couplings=couplings)
    again, written = saved(arm, tmp_path / "task.toml")
    assert written["couplings"] == {"j3": "j1", "j4": ["j2", -0.5], "j5": ["j1", 0.25, 0.1]}
    assert again.couplings == arm.couplings
    assert_same_arms(again, arm)


def test_a_file_that_the_caller_knows_is_named(tmp_path: Path) -> None:
    (tmp_path / "robots").mkdir()
    file = tmp_path / "robots" / "~arm 1.urdf"
    file.write_text(arm_text(pairs(3)))
    with pytest.warns(PostureWarning, match="2 joints off the chain"):
        arm = pp.Arm.load(file, split=3, locked={"j1": np.pi / 4}, tip="l4")
    table = {"urdf": file, "split": 3, "locked": {"j1": np.pi / 4}, "tip": "l4"}
    again, written = saved(arm, tmp_path / "tasks" / "task.toml")
    assert written == {**table, "urdf": "../robots/~arm 1.urdf"}
    assert_same_arms(again, arm)
    again, written = saved(arm, tmp_path / "robots" / "task.toml")
    assert written["urdf"] == str(file)  # "~arm 1.urdf" would be in the home of a user
    assert_same_arms(again, arm)


def test_a_file_that_is_gone_is_told_and_not_named(tmp_path: Path) -> None:
    file = tmp_path / "snake.urdf"
    file.write_text(arm_text(pairs(3)))
    arm = pp.Arm.load(file, split=3)
    file.unlink()
    with pytest.warns(PostureWarning, match=r"arm was 'snake.urdf', but no such file; it is written out"):
        again, written = saved(arm, tmp_path / "task.toml")
    assert written == {"urdf": "task.urdf", "split": 3}
    assert_same_arms(again, arm)


@pytest.mark.parametrize(
    "make",
    [
        lambda: pp.Arm.from_template("RyRz", 3, (0.1, 0.2)),
        lambda: pp.Arm.from_modules([pp.template("RyRz"), pp.template("Rz")]),
        lambda: pp.Arm.load(arm_text(pairs(3)), split=[2, 4], locked={}),
        lambda: pp.Arm.load(arm_text(pairs(3)), split=["l2", "tip"]),
        lambda: pp.Arm.from_template("Rz", 2).with_characteristic_length(0.3),
    ],
)
def test_an_arm_keeps_what_it_was_made_from(make: Callable[[], pp.Arm]) -> None:
    arm = make()
    assert_same_arms(pp.Arm.from_spec(arm.spec), arm)
    assert pp.Arm.from_spec(arm.spec).spec == arm.spec
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert pickle.loads(pickle.dumps(arm)).spec == arm.spec
    assert pp.Arm.from_dict(json.loads(json.dumps(arm.to_dict()))).spec == arm.spec


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"template": 3}, "template is 3; allowed: text"),
        ({"template": "RyRz", "modules": 0}, "modules is 0"),
        ({"template": "RyRz", "urdf": "a.urdf"}, "'template' does not go with 'urdf'"),
        ({"template": "RyRz", "modules": 2, "tip": "x"}, "'tip' does not go with 'template'"),
        (
            {"template": "RyRz", "modules": 2, "link_lengths": (0.1,)},
            "link_lengths is .*; allowed: 2 lengths",
        ),
        (
            {"template": "RyRz", "modules": 2, "joint_limits": (1, -1)},
            "joint_limits is .*; allowed: lower < upper",
        ),
        ({"template": "RyRz"}, "modules"),
        ({}, "template is not given"),
    ],
)
def test_what_makes_no_arm_is_refused(values: dict[str, Any], message: str) -> None:
    with pytest.raises(InvalidValue, match=message):
        pp.Arm.from_spec(ArmSpec(**values))


def test_a_specification_has_no_other_arguments() -> None:
    with pytest.raises(TypeError, match="ArmSpec: unexpected argument 'module'"):
        ArmSpec(template="RyRz", module=2)  # type: ignore[call-arg]


def test_a_file_that_changed_after_it_was_read_is_not_named(tmp_path: Path) -> None:
    (tmp_path / "snake.urdf").write_text(arm_text(pairs(3)))
    path = tmp_path / "task.toml"
    path.write_text(
        '[arm]\nurdf = "snake.urdf"\n[[keyframes]]\ncurve = "line"\n[[keyframes]]\ntime = 1\ncurve = "line"\n'
    )
    task = pp.Task.load(path)
    (tmp_path / "snake.urdf").write_text(arm_text(pairs(4)))
    with pytest.warns(PostureWarning, match="'snake.urdf'.*changed since"):
        task.save(path)
    assert (tmp_path / "task.urdf").read_text() == task.arm.urdf
    assert_same_arms(pp.Task.load(path).arm, task.arm)


def test_another_urdf_file_is_not_overwritten(tmp_path: Path) -> None:
    arms = [pp.Arm.load(arm_text(pairs(count))) for count in (2, 3)]
    path = task_of(arms[0]).save(tmp_path / "task.toml")
    before = path.read_text()
    with pytest.raises(FileError, match=r"task\.urdf: exists already, and differs from") as caught:
        task_of(arms[1]).save(path)
    assert caught.value.path == tmp_path / "task.urdf"
    assert path.read_text() == before
    assert (tmp_path / "task.urdf").read_text() == arms[0].urdf
    task_of(arms[0], name="again").save(path)  # the same one serves again
    assert pp.Task.load(path).name == "again"


def test_an_arm_without_urdf_is_refused(tmp_path: Path) -> None:
    model = pin.buildModelFromXML(arm_text(pairs(3)))
    arm = pp.Arm.from_model(model, ["l2", "l4", "tip"])
    with pytest.raises(FileError, match=r"task\.toml: arm: no file can describe it: it was made from"):
        task_of(arm).save(tmp_path / "task.toml")
    assert not any(tmp_path.iterdir())


def test_what_a_file_says_of_an_arm_stays(tmp_path: Path) -> None:
    text = (
        '[arm]\ntemplate = "RyRz"\nmodules = 4\nlink_lengths = ["3 cm", 0.02]\n'
        'joint_limits = ["-90 deg", 2]\nfeed = { stroke = "30 cm", speed = "5 cm/s" }\n'
        'placement = { rotation = ["90 deg", 0, "-45 deg"] }\ncharacteristic_length = "3 cm"\n'
        '[[keyframes]]\ncurve = "line"\n[[keyframes]]\ntime = 1\ncurve = "line"\n'
    )
    (tmp_path / "task.toml").write_text(text)
    task = pp.Task.load(tmp_path / "task.toml")
    assert task.arm.characteristic_length == 0.03
    assert task.arm.model.name == "RyRz_4"
    path = task.save(tmp_path / "other" / "task.toml")
    assert tomllib.loads(path.read_text())["arm"] == {
        "template": "RyRz",
        "modules": 4,
        "link_lengths": ["3 cm", 0.02],
        "joint_limits": ["-90 deg", 2],
        "feed": {"stroke": "30 cm", "speed": "5 cm/s"},
        "placement": {"rotation": ["90 deg", 0, "-45 deg"]},
        "characteristic_length": "3 cm",
    }
    task.edited(layout=None).save(path)
    assert tomllib.loads(path.read_text())["arm"] == {
        "template": "RyRz",
        "modules": 4,
        "link_lengths": [0.03, 0.02],
        "joint_limits": [-np.pi / 2, 2],
        "feed": {"stroke": 0.3, "speed": 0.05},
        "placement": {"rotation": [np.pi / 2, 0, -np.pi / 4]},
        "characteristic_length": 0.03,
    }
    assert_same_arms(pp.Task.load(path).arm, task.arm)
