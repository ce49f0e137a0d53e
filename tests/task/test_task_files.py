"""What is read from task files, and that TOML and JSON say the same."""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from task_texts import LEADER, VALID

import pinposture as pp
from pinposture.errors import FileError, PostureError

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib


@pytest.mark.parametrize("ending", ["\n", "\r\n"])
@pytest.mark.parametrize("mark", [b"", b"\xef\xbb\xbf"])
def test_line_ends_and_byte_order_marks_of_windows(tmp_path: Path, ending: str, mark: bytes) -> None:
    file = tmp_path / "task.toml"
    file.write_bytes(mark + VALID.replace("\n", ending).encode())
    assert pp.Task.load(file).name == "bow"
    file.write_bytes(mark + VALID.replace("joint_weight", "hast").replace("\n", ending).encode())
    line = VALID[: VALID.index("joint_weight")].count("\n") + 1
    with pytest.raises(FileError, match=f"task.toml: line {line}: controller.hast: "):
        pp.Task.load(file)


def loaded(folder: Path, text: str, name: str = "task.toml") -> pp.Task:
    file = folder / name
    file.write_text(text if name.endswith("toml") else json.dumps(tomllib.loads(text)))
    return pp.Task.load(file)


@pytest.mark.parametrize("text", [VALID, LEADER])
def test_json_and_toml_say_the_same(tmp_path: Path, text: str) -> None:
    tasks = [loaded(tmp_path, text, name) for name in ("task.toml", "task.json")]
    first, second = (task.reference() for task in tasks)
    assert first.interval == second.interval
    np.testing.assert_array_equal(first.start, second.start)
    np.testing.assert_array_equal(first.offsets, second.offsets)
    np.testing.assert_array_equal(first.weights, second.weights)
    assert [(waypoint.name, waypoint.row) for waypoint in first.waypoints] == [
        (waypoint.name, waypoint.row) for waypoint in second.waypoints
    ]
    one, other = (
        task.surroundings(reference) for task, reference in zip(tasks, (first, second), strict=True)
    )
    assert one == other is not None
    assert tasks[0].limits == tasks[1].limits
    assert tasks[0].formats == tasks[1].formats


@pytest.mark.parametrize(
    ("text", "shown"), [(VALID, "2 keyframes: straight, bowed"), (LEADER, "follow Curve(")]
)
def test_a_task_and_what_belongs_to_it_are_shown_in_a_few_lines(
    tmp_path: Path, text: str, shown: str
) -> None:
    task = loaded(tmp_path, text)
    assert shown in repr(task) and repr(task.arm) in repr(task)
    assert repr(task).count("\n") == 2
    for each in (task, task.reference(), task.arm.spec, pp.Arm.load(task.arm.urdf).spec):
        assert max(map(len, repr(each).splitlines())) < 150


def test_a_keyframe_shows_what_differs_from_its_defaults() -> None:
    bent = pp.Keyframe(joints=(0.1, -0.2), name="bent", time=2.0, hold=0.0, speed=0.5)
    assert repr(bent) == "Keyframe(time=2.0, name='bent', joints=(0.1, -0.2), speed=0.5)"


def test_values_arrive_as_they_were_meant(tmp_path: Path) -> None:
    more = 'placement = "translate"\nroll = "90 deg"\nmethod = "closest"\nregion = [2, 6]\n'
    tip = 'position = ["10 cm", 0, 0.1], rotation = ["90 deg", 0, 0], point = 3, weight = 4'
    tip += ", direction_only = true"
    task = loaded(tmp_path, VALID.replace('placement = "align"\n', f"{more}tip = {{ {tip} }}\n"))
    arm = task.arm
    bowed = task.motion[1]
    np.testing.assert_allclose(arm.chain.module_lengths, 0.05)
    np.testing.assert_allclose(arm.limits.lower, -170 * np.pi / 180)
    np.testing.assert_allclose(arm.limits.upper, 3.0)
    assert task.limits == pp.Limits(step=None, dt=0.02, velocity=np.pi / 2, acceleration=10.0)
    assert task.controller == pp.Geodesic(joint_weight=0.2)
    np.testing.assert_array_equal(task.start, arm.straight())
    assert task.scene == pp.Scene({"ball": pp.Sphere((0, 0, -0.5), 0.1)}, margin=0.005)
    assert (task.formats, task.name, task.continuity) == (("npz", "csv"), "bow", "velocity")
    assert (bowed.name, bowed.time, bowed.duration, bowed.hold, bowed.trim) == ("bowed", 1.0, None, 0.1, True)
    assert (bowed.placement, bowed.method, bowed.region) == ("translate", "closest", (1, 5))
    assert bowed.roll == pytest.approx(np.pi / 2)
    assert bowed.curve == pp.Curve.helix(0.1, 0.0, 0.6)
    assert (bowed.tip.point, bowed.tip.weight, bowed.tip.priority, bowed.tip.direction_only) == (
        2,
        4.0,
        False,
        True,
    )
    np.testing.assert_allclose(bowed.tip.pose[:3, 3], [0.1, 0, 0.1])
    np.testing.assert_allclose(bowed.tip.pose[:3, :3], [[1, 0, 0], [0, 0, -1], [0, 1, 0]], atol=1e-15)


def test_what_is_not_said_has_the_usual_value(tmp_path: Path) -> None:
    curve = 'curve = { type = "line", a = [0, 0, 0], b = [0.3, 0, 0] }\n'
    text = (
        f'[arm]\ntemplate = "RyRz"\nmodules = 6\n[[keyframes]]\n{curve}[[keyframes]]\nduration = 1\n{curve}'
    )
    task = loaded(tmp_path, text, "nothing said.toml")
    assert task.motion == (
        pp.Keyframe(pp.Curve.line((0, 0, 0), (0.3, 0, 0)), placement="align"),
        pp.Keyframe(pp.Curve.line((0, 0, 0), (0.3, 0, 0)), duration=1.0, placement="align"),
    )
    assert task.limits == pp.Limits(step=None, dt=0.02)
    assert task.controller == pp.Geodesic()
    assert (task.scene, task.start, task.name) == (None, None, "nothing said")
    assert task.formats == ("npz", "csv", "json", "png", "html")


@pytest.mark.filterwarnings("ignore:velocity .* is above")
def test_an_arm_on_a_feed_and_limits_for_both_kinds_of_joints(tmp_path: Path) -> None:
    limits = 'velocity = { turning = "1 turns/s" }\nstep = { turning = 0.1 }\n'
    limits += 'acceleration = { sliding = "50 cm/s^2" }\njerk = { sliding = "5 m/s^3" }\n'
    task = loaded(tmp_path, LEADER.replace('cycle = "200 ms"\n', limits))
    arm = task.arm
    np.testing.assert_array_equal(arm.slides, [True] + 8 * [False])
    assert (arm.limits.lower[0], arm.limits.upper[0]) == (0.0, 0.3)
    np.testing.assert_allclose(task.limits.velocity, [0.1] + 8 * [2 * np.pi])
    np.testing.assert_allclose(task.limits.acceleration, [0.5] + 8 * [np.inf])
    np.testing.assert_allclose(task.limits.jerk, [5.0] + 8 * [np.inf])
    np.testing.assert_allclose(task.limits.step, [np.inf] + 8 * [0.1])
    listed = LEADER.replace('cycle = "200 ms"\n', f"velocity = ['1 cm/s', {', '.join(8 * ['1'])}]\n")
    np.testing.assert_allclose(loaded(tmp_path, listed).limits.velocity, [0.01] + 8 * [1.0])
    start = loaded(tmp_path, LEADER + f"[start]\njoints = ['5 cm', {', '.join(8 * ['0'])}]\n").start
    np.testing.assert_allclose(start, [0.05] + 8 * [0.0])
    assert (task.motion.speed, task.motion.depth, task.motion.pipe) == (0.05, 0.1, 0.045)
    assert (task.motion.and_back, task.motion.method, task.motion.placement) == (False, "closest", "align")


def test_files_are_looked_for_beside_the_one_that_names_them(tmp_path: Path, monkeypatch: Any) -> None:
    folder = tmp_path / "tasks" / "parts"
    folder.mkdir(parents=True)
    placed = pp.Arm.from_template("RyRz", modules=6)
    (folder / "arm.urdf").write_text(placed.urdf)
    np.savetxt(folder / "line.csv", [[0, 0, 0], [0.1, 0, 0], [0.3, 0, 0]], delimiter=",")
    scene = pp.Scene({"post": pp.Sphere((0, 0, -1), 0.1)})
    scene.save(folder / "scene.json")
    text = (
        '[arm]\nurdf = "parts/arm.urdf"\nbase = "m01_l2"\nsplit = 1\nlocked = { m06_j2_z = "45 deg" }\n'
        'tip = "tip"\npackage_dirs = ["meshes"]\nplacement = { position = [0, 0, "1 m"] }\n'
        '[scene]\nfile = "parts/scene.json"\n'
        '[[keyframes]]\ncurve = "parts/line.csv"\n[[keyframes]]\ntime = 1\ncurve = "line"\n'
    )
    monkeypatch.chdir(tmp_path)
    with pytest.warns(pp.errors.PostureWarning, match="2 joints off the chain"):
        task = loaded(tmp_path / "tasks", text)
    joints = [f"m{i:02}_j{k}" for i in range(2, 7) for k in ("1_y", "2_z")]
    assert list(task.arm.joint_names) == joints[:-1]
    assert task.arm.package_dirs[0] == str(tmp_path / "tasks" / "meshes")
    assert task.scene == scene
    assert task.motion[0].curve == pp.Curve.load(folder / "line.csv")
    with pytest.warns(pp.errors.PostureWarning):
        wanted = pp.Arm.load(
            folder / "arm.urdf",
            "m01_l2",
            "tip",
            1,
            locked={"m06_j2_z": np.pi / 4},
            base_placement=pin.SE3(np.eye(3), np.array([0, 0, 1.0])),
        )
    q = wanted.random(np.random.default_rng(0))
    np.testing.assert_allclose(task.arm.at(q).points, wanted.at(q).points, atol=1e-15)


def test_a_task_in_python_needs_no_file() -> None:
    arm = pp.Arm.from_template("RyRz", modules=6)
    keyframes = (
        pp.Keyframe(pp.Curve.line((0, 0, 0), (0.3, 0, 0))),
        pp.Keyframe(pp.Curve.line((0, 0, 0), (0.2, 0, 0)), time=1.0),
    )
    task = pp.Task(arm, keyframes, pp.Limits(step=None, dt=0.02))
    with pytest.raises(pp.errors.CurveEndsEarly, match=r"^keyframe 2: module 5"):
        task.reference()


def test_a_task_holds_what_a_file_says_in_si_units(tmp_path: Path) -> None:
    path = tmp_path / "task.toml"
    path.write_text(VALID)
    task = pp.Task.load(path)
    spec = task.arm.spec
    assert (spec.template, spec.modules, spec.link_lengths) == ("RyRz", 6, (0.025, 0.025))
    assert spec.joint_limits == (pytest.approx(-170 * np.pi / 180), 3.0)
    assert task.limits == pp.Limits(step=None, dt=0.02, velocity=np.pi / 2, acceleration=10.0)
    assert task.controller == pp.Geodesic(joint_weight=0.2)
    assert task.scene == pp.Scene({"ball": pp.Sphere((0.0, 0.0, -0.5), 0.1)}, margin=0.005)
    first, second = task.motion
    assert (first.name, first.curve) == ("straight", pp.Curve.line((0, 0, 0), (0.3, 0, 0)))
    assert (second.time, second.hold, second.placement, second.trim) == (1.0, 0.1, "align", True)
    assert second.curve == pp.Curve.helix(radius=0.1, pitch=0, turns=0.6)


def test_values_of_a_file_are_replaced_by_their_keys(tmp_path: Path) -> None:
    path = tmp_path / "task.toml"
    path.write_text(VALID)
    task = pp.Task.load(path, {"limits.velocity": 1.0, "keyframes.2.hold": "500 ms", "name": "other"})
    assert (task.limits.velocity, task.motion[1].hold, task.name) == (1.0, 0.5, "other")
    assert pp.Task.load(task.save(tmp_path / "saved.toml")).limits == task.limits
    assert pp.Task.load(path).limits.velocity == pytest.approx(np.pi / 2)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (3, "changes is 3; allowed: a mapping from keys to values, or None"),
        ({3: 1}, 'key to change is 3; allowed: text such as "limits.velocity"'),
        ({"keyframes.0.hold": 1}, "there is no 'keyframes.0.hold' to change"),
        ({"": 1}, "there is no '' to change"),
        ({"limits.velocity": np.nan}, "limits.velocity: is nan"),
        ({"arm": None}, "arm: "),
    ],
)
def test_a_value_that_cannot_be_replaced_is_named(tmp_path: Path, changes: Any, message: str) -> None:
    path = tmp_path / "task.toml"
    path.write_text(VALID)
    with pytest.raises(PostureError, match=re.escape(message)):
        pp.Task.load(path, changes)
