"""Task files that are written: they give the task back, are pleasant to read, and are whole or not there."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from arms import template_arm
from task.same_tasks import assert_same
from task_texts import LEADER, VALID

import pinposture as pp
from pinposture import toml
from pinposture.errors import FileError, PostureWarning
from pinposture.task import document
from pinposture.task.follow_leader import Leader

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

EXAMPLES = Path(__file__).parents[2] / "examples" / "tasks"


def six_modules() -> pp.Arm:
    return template_arm("RyRz", 6)


@cache
def line() -> pp.Curve:
    return pp.Curve.line((0, 0, 0), (0.3, 0, 0))


@cache
def bow() -> pp.Curve:
    return pp.Curve.spline([(0, 0, 0), (0.1, 0, 0), (0.2, 0.05, 0), (0.3, 0.1, 0.1)])


def task_of(*more: pp.Keyframe, **options: Any) -> pp.Task:
    keyframes = (pp.Keyframe(line()), *(more or (pp.Keyframe(line(), time=1.0),)))
    given = {"arm": six_modules(), "motion": keyframes, "limits": pp.Limits(step=None, dt=0.02)}
    return pp.Task(**{**given, **options})


def written(task: pp.Task, path: Path) -> dict[str, Any]:
    """What a file says of a task, which it gives back."""
    assert task.save(path) == path
    assert_same(pp.Task.load(path), task)
    return tomllib.loads(path.read_text())


@pytest.mark.parametrize("suffix", [".toml", ".json"])
@pytest.mark.parametrize("example", sorted(EXAMPLES.glob("*.toml")), ids=lambda path: path.stem)
def test_the_examples_come_back(tmp_path: Path, example: Path, suffix: str) -> None:
    task = pp.Task.load(example)
    path = task.save(tmp_path / f"{example.stem}{suffix}")
    again = pp.Task.load(path)
    assert_same(again, task)
    before = path.read_text()
    again.save(path)
    assert path.read_text() == before
    if suffix == ".toml":  # the same keys, but for those that are as usual
        said = tomllib.loads(before)
        asked = tomllib.loads(example.read_text())
        assert said.keys() == asked.keys()
        assert [each.keys() for each in said.get("keyframes", [])] == [
            each.keys() for each in asked.get("keyframes", [])
        ]


SAVED = """\
version = 1
kind = "keyframes"
name = "bow"

[arm]
template = "RyRz"
modules = 6
link_lengths = [0.025, 0.025]
joint_limits = [-2.9670597283903604, 3]

[limits]
cycle = 0.02
velocity = 1.5707963267948966
acceleration = 10

[start]
posture = "straight"

[scene]
margin = 0.005

[scene.obstacles.ball]
type = "sphere"
center = [0, 0, -0.5]
radius = 0.1

[[keyframes]]
name = "straight"
curve = {type = "line", a = [0, 0, 0], b = [0.3, 0, 0]}

[[keyframes]]
name = "bowed"
time = 1
hold = 0.1
curve = {type = "helix", radius = 0.1, pitch = 0, turns = 0.6}
placement = "align"
trim = true

[output]
formats = ["npz", "csv"]
"""


def test_a_file_looks_as_a_person_would_write_it(tmp_path: Path) -> None:
    (tmp_path / "task.toml").write_text(VALID)
    task = pp.Task.load(tmp_path / "task.toml")
    assert task.edited(layout=None).save(tmp_path / "again.toml").read_text() == SAVED


def test_a_leader_comes_back(tmp_path: Path) -> None:
    (tmp_path / "task.toml").write_text(LEADER.replace('"5 cm/s"', '"5 cm/s"\nand_back = true'))
    task = pp.Task.load(tmp_path / "task.toml")
    said = written(task.edited(layout=None), tmp_path / "again.toml")
    points = [[0, 0, 0], [0.1, 0, 0], [0.2, 0, 0], [0.3, 0.1, 0]]
    path = {"type": "spline", "control_points": points}
    assert said["leader"] == {"path": path, "speed": 0.05, "depth": 0.1, "and_back": True, "pipe": 0.045}
    assert said["arm"] == {"template": "RyRz", "modules": 4, "feed": {"stroke": 0.3}}
    made = pp.Task(task.arm, Leader(bow(), 0.1, method="sequential", placement="as_is"), task.limits)
    said = written(made, tmp_path / "made.toml")
    assert said["leader"]["method"] == "sequential"
    assert "continuity" not in said


def test_curves_are_written_as_what_they_are(tmp_path: Path) -> None:
    many = pp.Curve.helix(0.1, 0.08, 1.0)
    bent = pp.Curve([0, 0, 0, 0, 0.3, 1, 1, 1, 1], [*bow().coefficients, (0.4, 0.2, 0.2)], 3)
    close = pp.Curve(bow().knots, [(0, 0, 0), (0.1, 0, 0), (0.1, 0, 0), (0.3, 0, 0)], 3)
    flat = pp.Curve.spline([(0, 0, 0), (0.1, 0, 0), (0.2, 0.1, 0)], degree=1)
    known = {many: {"type": "helix", "radius": 0.1, "pitch": 0.08, "turns": 1}}
    curves = (line(), bow(), flat, bent, close, many, pp.Curve.helix(0.06, 0.15, 0.5))
    frames = [pp.Keyframe(curve, duration=1.0) for curve in curves]
    said = written(task_of(*frames, described=known), tmp_path / "task.toml")["keyframes"][1:]
    assert [each["curve"]["type"] for each in said] == [
        "line",
        "spline",
        "spline",
        "bspline",
        "bspline",
        "helix",
        "bspline",
    ]
    assert said[1]["curve"] == {"type": "spline", "control_points": bow().coefficients.tolist()}
    assert said[2]["curve"]["degree"] == 1
    assert len(said[6]["curve"]["coefficients"]) > 100


def test_described_curves_stay_what_they_were_and_their_copies_too(tmp_path: Path) -> None:
    np.savetxt(tmp_path / "way.csv", [[0, 0, 0], [0.1, 0, 0], [0.3, 0.05, 0]], delimiter=",")
    np.savetxt(tmp_path / "mm.csv", [[0, 0, 0], [100, 0, 0], [300, 50, 0]], delimiter=",")
    text = VALID.replace('{ type = "line", a = [0, 0, 0], b = [0.3, 0, 0] }', '"way.csv"')
    text += '[[keyframes]]\nduration = 1\ncurve = "helix"\n'
    text += '[[keyframes]]\nduration = 1\ncurve = { path = "mm.csv", scale = 0.001 }\n'
    (tmp_path / "task.toml").write_text(text)
    task = pp.Task.load(tmp_path / "task.toml")
    first, second, third, scaled = task.motion
    assert scaled.curve.length == pytest.approx(first.curve.length)
    copy = pp.Keyframe(pp.Curve(third.curve.knots, third.curve.coefficients, 5), duration=2.0)
    changed = pp.Keyframe(second.curve.moved(np.eye(3), (0, 0, 1)), duration=1.0)
    edited = task.edited(motion=(second, third, first, copy, scaled, changed), layout=None)
    said = written(edited, tmp_path / "parts" / "task.toml")["keyframes"]
    assert [each["curve"] for each in said[:5]] == [
        {"type": "helix", "radius": 0.1, "pitch": 0, "turns": 0.6},
        "helix",
        "../way.csv",
        "helix",
        {"path": "../mm.csv", "scale": 0.001},
    ]
    assert said[5]["curve"]["type"] == "bspline"
    (tmp_path / "way.csv").write_text("0,0,0\n1,0,0\n")
    with pytest.warns(PostureWarning, match="curve was '../way.csv', which has changed since"):
        said = written(edited, tmp_path / "parts" / "task.toml")["keyframes"]
    assert said[2]["curve"]["type"] == "spline"  # a parabola through three points is one


def test_tips_in_all_their_ways(tmp_path: Path) -> None:
    turn = pin.rpy.rpyToMatrix(0.5, -0.25, 1.0)
    pose = pin.SE3(turn, np.array([0.1, 0.0, 0.2]))
    tips = [
        pp.EndEffector((0.1, 0, 0.2)),
        pp.EndEffector(pose=pose, point=0, weight=10, direction_only=True),
        pp.EndEffector(pose=pin.SE3(np.eye(3), pose.translation), point=-2, priority=True, length=0.05),
        pp.EndEffector((0.1, 0, 0.2), point="module_03"),
    ]
    frames = [pp.Keyframe(bow(), duration=1.0, tip=tip, region=(1, 4)) for tip in tips]
    said = written(task_of(*frames), tmp_path / "task.toml")["keyframes"][1:]
    assert [each["region"] for each in said] == 4 * [[2, 5]]
    place = [0.1, 0, 0.2]
    assert [each["tip"] for each in said] == [
        {"position": place},
        {"position": place, "rotation": [0.5, -0.25, 1], "point": 1, "weight": 10, "direction_only": True},
        {"position": place, "rotation": [0, 0, 0], "point": -2, "priority": True, "length": 0.05},
        {"position": place, "point": "module_03"},
    ]


def test_limits_of_each_joint_or_each_kind(tmp_path: Path) -> None:
    feed = pp.ModuleTemplate("Feed", (pp.JointSpec("x", "prismatic", 0.0, 0.3, velocity=0.1),), (0.05,))
    arm = pp.Arm.from_modules([feed, *[pp.template("RyRz")] * 2])
    inf = np.inf
    speeds = np.array([0.05, 2, 2, 2, 2])
    cases: list[tuple[dict[str, Any], dict[str, Any]]] = [
        ({"step": 0.1, "position_margin": 0.01}, {"step": 0.1, "position_margin": 0.01}),
        ({"step": inf, "velocity": inf}, {"step": "none", "velocity": "none"}),
        ({"velocity": speeds}, {"velocity": {"turning": 2, "sliding": 0.05}}),
        ({"velocity": [0.1, 1, 1, 1, 1]}, {"velocity": {"turning": 1, "sliding": 0.1}}),
        ({"velocity": [inf, 1, 1, 1, 1]}, {"velocity": ["none", 1, 1, 1, 1]}),
        ({"acceleration": [0.5, inf, inf, inf, inf]}, {"acceleration": {"sliding": 0.5}}),
        ({"acceleration": [0.5, 3, 3, inf, 4]}, {"acceleration": [0.5, 3, 3, "none", 4]}),
        ({"acceleration": [inf] * 5}, {"acceleration": ["none"] * 5}),
        (
            {"acceleration": 2, "jerk": [1, 9, 9, 9, 9]},
            {"acceleration": 2, "jerk": {"turning": 9, "sliding": 1}},
        ),
    ]
    for number, (given, said) in enumerate(cases):
        arrays = {key: np.array(value) if isinstance(value, list) else value for key, value in given.items()}
        task = task_of(arm=arm, limits=pp.Limits(**{"step": None, "dt": 0.05, **arrays}))
        assert written(task, tmp_path / "task.toml")["limits"] == {"cycle": 0.05, **said}, number


@pytest.mark.filterwarnings("ignore:.* contains no obstacles")
def test_scenes_by_file_and_by_obstacle(tmp_path: Path) -> None:
    import trimesh

    (tmp_path / "parts").mkdir()
    trimesh.creation.box((0.1, 0.2, 0.3)).export(tmp_path / "parts" / "rock.stl")
    (tmp_path / "parts" / "scene.toml").write_text(
        'margin = 0.02\n[obstacles.post]\ntype = "capsule"\n'
        "start = [1, 0, 0]\nend = [1, 0, 1]\nradius = 0.1\n"
    )
    rock = '[scene.obstacles.rock]\ntype = "mesh"\npath = "parts/rock.stl"\ncenter = [1, 0, "10 cm"]\n'
    rock += 'rotation = ["90 deg", 0, 0]\nscale = 2\n\n'
    (tmp_path / "rock.toml").write_text(VALID.replace("[[keyframes]]", rock + "[[keyframes]]", 1))
    task = pp.Task.load(tmp_path / "rock.toml")
    np.savetxt(tmp_path / "parts" / "cloud.xyz", np.arange(12).reshape(4, 3))
    cloud = pp.Scan.load(tmp_path / "parts" / "cloud.xyz", 0.5, point_radius=0.01)
    boxed = {**task.scene.obstacles, "a box": pp.Box((1, 1, 1), (0.1, 0.1, 0.1)), "cloud": cloud}
    edited = task.edited(scene=pp.Scene(boxed, self_collision=False), layout=None)
    said = written(edited, tmp_path / "other" / "task.toml")["scene"]
    assert said["self_collision"] is False
    assert said["obstacles"] == {
        "ball": {"type": "sphere", "center": [0, 0, -0.5], "radius": 0.1},
        "rock": {
            "type": "mesh",
            "path": "../parts/rock.stl",
            "center": [1, 0, 0.1],
            "rotation": [np.pi / 2, 0, 0],
            "scale": 2,
        },
        "a box": {"type": "box", "center": [1, 1, 1], "size": [0.1, 0.1, 0.1]},
        "cloud": {"type": "scan", "path": "../parts/cloud.xyz", "scale": 0.5, "point_radius": 0.01},
    }
    assert pp.Task.load(tmp_path / "other" / "task.toml").scene == edited.scene
    begin = VALID.index("[scene]")
    end = VALID.index("[[keyframes]]")
    (tmp_path / "file.toml").write_text(f'{VALID[:begin]}[scene]\nfile = "parts/scene.toml"\n{VALID[end:]}')
    task = pp.Task.load(tmp_path / "file.toml")
    path = tmp_path / "other" / "task.toml"
    assert written(task, path)["scene"] == {"file": "../parts/scene.toml"}
    # What is in it is written out as soon as it is another scene, and when the file is.
    more = written(task.edited(scene=pp.Scene(task.scene.obstacles)), path)["scene"]
    assert list(more) == ["margin", "obstacles"]
    (tmp_path / "parts" / "scene.toml").write_text("margin = 0.03\n")
    with pytest.warns(PostureWarning, match="scene was"):
        assert written(task, path)["scene"]["margin"] == 0.02
    made = task_of(scene=pp.Scene())
    assert written(made, path)["scene"] == {"margin": 0.005}


def test_starts_and_controllers(tmp_path: Path) -> None:
    path = tmp_path / "task.toml"
    q = six_modules().random(np.random.default_rng(1))
    assert written(task_of(start=q), path)["start"] == {"joints": q.tolist()}
    assert written(task_of(start=six_modules().straight()), path)["start"] == {"posture": "straight"}
    planar = pp.Arm.load(pp.Arm.from_template("Rz", 3).urdf.replace('rpy="0.0 0.0 0.0"', 'rpy="0 0 0.5"'))
    task = task_of(arm=planar, start=planar.neutral())
    assert written(task, tmp_path / "planar.toml")["start"] == {"posture": "neutral"}
    assert "start" not in written(task_of(), path)
    assert "controller" not in written(task_of(), path)
    assert written(task_of(controller="switching"), path)["controller"] == {"name": "switching"}
    quick = pp.Geodesic(joint_weight=1.5)
    assert written(task_of(controller=quick), path)["controller"] == {"name": "geodesic", "joint_weight": 1.5}


def test_scans_are_named_relative_to_the_file(tmp_path: Path) -> None:
    scans = (tmp_path / "room" / "scan.ply", "/somewhere/else/scan.pcd")
    task = task_of(scans=scans)
    assert task.scans == (scans[0], Path(scans[1]))
    path = tmp_path / "task.toml"
    elsewhere = os.path.relpath("/somewhere/else/scan.pcd", os.path.realpath(tmp_path))
    assert written(task, path)["editor"] == {"scans": ["room/scan.ply", elsewhere]}
    # A folder that is moved takes its scans along.
    (tmp_path / "moved").mkdir()
    shutil.move(path, tmp_path / "moved")
    assert pp.Task.load(tmp_path / "moved" / "task.toml").scans[0] == tmp_path / "moved" / "room" / "scan.ply"
    # By way of a link as well: ".." leads where the system goes.
    (tmp_path / "room").mkdir()
    (tmp_path / "link").symlink_to(tmp_path / "room", target_is_directory=True)
    linked = tmp_path / "link" / "linked.toml"
    assert written(task, linked)["editor"]["scans"][0] == "scan.ply"


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("task", None),
        ("", ""),
        ('say "hi" \\ c:\\new', 'say "hi" \\ c:\\new'),
        ("two\nlines\r\n", "two\nlines\r\n"),
        ("größe 腕 𝔸 \x7f\x00", "größe 腕 𝔸 \x7f\x00"),
    ],
)
def test_names(tmp_path: Path, name: str, said: str | None) -> None:
    task = task_of(pp.Keyframe(bow(), time=1.0, name=name), name=name)
    assert written(task, tmp_path / "task.toml").get("name") == said
    assert_same(pp.Task.load(task.save(tmp_path / "task.json")), task)


REFUSED: list[tuple[dict[str, Any], str, str]] = [
    ({}, "task.yaml", "the name ends in '.yaml'; allowed: .toml, .json"),
    ({}, "task", "the name ends in ''"),
    ({"name": "\ud800"}, "task.toml", "half of a surrogate pair"),
    ({"name": "\ud800"}, "task.json", "half of a surrogate pair"),
    (
        {"controller": pp.Geodesic(tasks=(pp.EndEffector((0, 0, 1)),))},
        "task.toml",
        "controller: a file cannot represent Geodesic",
    ),
    ({"controller": pp.Selection(gain=0.5)}, "task.toml", "controller: a file cannot represent Selection"),
]


@pytest.mark.parametrize(("changes", "name", "message"), REFUSED)
def test_what_no_file_can_hold_is_refused_and_leaves_nothing(
    tmp_path: Path, changes: dict[str, Any], name: str, message: str
) -> None:
    for folder in (tmp_path, tmp_path / "new" / "folder"):
        with pytest.raises(FileError, match=message) as caught:
            task_of(**changes).save(folder / name)
        assert str(caught.value).startswith(str(folder / name))
        str(caught.value).encode(errors="backslashreplace")
    assert not any(tmp_path.iterdir())


@pytest.mark.parametrize("failing", [1, 2])
def test_a_write_that_fails_leaves_the_old_file_whole(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, failing: int
) -> None:
    arm = pp.Arm.from_modules([pp.template("RyRz")] * 2)  # with a URDF file beside
    path = tmp_path / "task.toml"
    path.write_text(VALID)
    count = 0

    def fail(_: int) -> None:
        nonlocal count
        count += 1
        if count == failing:
            raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", fail)
    with pytest.raises(FileError, match=r"\.(urdf|toml): cannot be written \(No space left on device\)"):
        task_of(arm=arm).save(path)
    assert path.read_text() == VALID
    assert [file.name for file in tmp_path.iterdir()] == ["task.toml"]
    count = 2
    task_of(arm=arm).save(path)
    assert sorted(file.name for file in tmp_path.iterdir()) == ["task.toml", "task.urdf"]


KILLED = """
import os, signal, sys, pathlib
import pinposture as pp
task = pp.Task.load(sys.argv[1])
write = os.fsync
def die(file):
    write(file)
    os.kill(os.getpid(), signal.SIGKILL)
os.fsync = die
task.edited(name="changed").save(sys.argv[1])
"""


@pytest.mark.process
def test_a_process_that_is_killed_leaves_the_old_file_whole(tmp_path: Path) -> None:
    path = tmp_path / "task.toml"
    path.write_text(VALID)
    ended = subprocess.run([sys.executable, "-c", KILLED, str(path)], check=False, capture_output=True)
    assert ended.returncode == -9, ended.stderr
    assert path.read_text() == VALID
    assert pp.Task.load(path).name == "bow"


def test_what_would_be_read_as_something_else_is_not_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def careless(values: dict[str, Any]) -> str:
        return toml.toml_text(values).replace("time = 1\n", "time = 1.0000000000000002\n")

    path = tmp_path / "task.toml"
    path.write_text(VALID)
    monkeypatch.setattr(document, "toml_text", careless)
    with pytest.raises(FileError, match=r"cannot represent the task: motion would change"):
        task_of().save(path)
    assert path.read_text() == VALID
