"""What the pages on motions in time show works as shown."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pinposture as pp

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"


def snippets(page: str, language: str) -> list[str]:
    """The fenced snippets of a page in a language."""
    return re.findall(rf"```{language}\n(.*?)```", (DOCS / page).read_text(), re.DOTALL)


def indented(page: str, begin: str) -> str:
    """An indented snippet of a page, by its first words."""
    line = r"(?:^    .*\n)*"
    text = (DOCS / page).read_text()
    block = re.search(rf"{line}^    {re.escape(begin)}.*\n{line}", text, re.MULTILINE)
    assert block is not None
    return re.sub(r"^    ", "", block[0], flags=re.MULTILINE)


def run(code: str, /, **known: Any) -> dict[str, Any]:
    names = dict(known)
    exec(compile(code, "snippet", "exec"), names)
    return names


@pytest.fixture(autouse=True)
def in_a_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_every_snippet_in_python_or_toml_is_known_here() -> None:
    pages = ("tasks.md", "trajectories.md", "follow_leader.md", "physics.md")
    languages = ("python", "toml", "csv", "json")
    counts = {page: [len(snippets(page, name)) for name in languages] for page in pages}
    assert counts == {
        "tasks.md": [4, 4, 0, 0],
        "trajectories.md": [1, 0, 1, 1],
        "follow_leader.md": [4, 1, 0, 0],
        "physics.md": [2, 0, 0, 0],
    }


def test_keyframes_in_python(capsys: pytest.CaptureFixture) -> None:
    motion = run(snippets("tasks.md", "python")[0])["motion"]
    assert motion.converged
    assert capsys.readouterr().out == f"{motion!r}\n"
    for name in ("q", "time", "mean_error", "waypoints", "time_scale"):  # as the page goes on to say
        assert f"`motion.{name}`" in (DOCS / "tasks.md").read_text()
        assert getattr(motion, name) is not None


def test_tasks_are_saved_as_shown(in_a_folder: Path) -> None:
    _, _, edited, described = snippets("tasks.md", "python")
    (in_a_folder / "examples").symlink_to(DOCS.parent / "examples")
    higher = run(edited)["task"]
    before = pp.Task.load("examples/tasks/keyframes.toml")
    again = pp.Task.load("higher.toml")
    assert (again.continuity, before.continuity) == ("acceleration", "velocity")
    risen = again.motion[-1].curve.at(0.1) - before.motion[-1].curve.at(0.1)
    np.testing.assert_allclose(risen, (0, 0, 0.05), atol=1e-9)
    assert [each.curve for each in again.motion] == [each.curve for each in higher.motion]
    run(described)
    text = (in_a_folder / "coil.toml").read_text()
    assert 'urdf = "snake.urdf"\nsplit = 2\n' in text
    assert 'curve = {type = "helix", radius = 0.05, pitch = 0.05, turns = 1.2}' in text
    assert pp.Task.load("coil.toml").arm.nv == 12


@pytest.mark.filterwarnings("ignore:velocity .* is above")
def test_the_task_file_is_one_and_its_comments_are_true(in_a_folder: Path) -> None:
    text = snippets("tasks.md", "toml")[0]
    file = in_a_folder / "task.toml"
    file.write_text(text)
    loaded = pp.Task.load(file)
    reference = loaded.reference()
    assert [waypoint.name for waypoint in reference.waypoints] == ["straight", "coil"]
    assert reference.duration == pytest.approx(3.5)
    # What is commented out can be put in, with limits for both kinds of joints.
    (feed,) = re.findall(r"^# (feed = \{.*\})", text, re.MULTILINE)
    (placement,) = re.findall(r"^# (placement = \{[^#]*\})", text, re.MULTILINE)
    (both,) = re.findall(r"or (\{ turning = .*\})", text)
    fed = text.replace(f"# {feed}", feed).replace(f"# {placement}", placement)
    loads = '{ turning = "3 N m", sliding = "30 N" }'
    jerks = both.replace("^2", "^3")
    per_kind = (('"360 deg/s^2"', both), ('"3600 deg/s^3"', jerks), ('"3 N m"', loads))
    for old, new in (('"90 deg/s"', "2"), *per_kind, ('"2 deg"', "0")):
        fed = fed.replace(old, new)
    file.write_text(fed)
    arm = pp.Task.load(file).arm
    assert arm.nv == 41
    np.testing.assert_allclose(arm.chain.base, (0, 0, 0.5))
    (in_a_folder / "snake.urdf").write_text(loaded.arm.urdf)
    file.write_text(re.sub(r"\[arm\].*?\n\n", '[arm]\nurdf = "snake.urdf"\n\n', text, flags=re.DOTALL))
    assert pp.Task.load(file).arm.nv == 40


def test_the_phases_of_a_hand_on_the_page_are_read() -> None:
    example = (ROOT / "examples" / "tasks" / "wrap.toml").read_text().split("[[phases]]")[0]
    shown = snippets("tasks.md", "toml")[3]
    assert "wrap = {" in shown
    file = Path("shown.toml")
    file.write_text(example + shown)
    phases = pp.Task.load(file).motion
    assert [each.name for each in phases] == ["grasp", "lift", "down", "let go"]
    assert phases[2].motion.turn[2] == pytest.approx(np.pi / 2.0)


@pytest.mark.long
def test_the_leader_is_one(in_a_folder: Path) -> None:
    leader = snippets("tasks.md", "toml")[1]
    np.savetxt(in_a_folder / "path.csv", [[0, 0, 0], [0.3, 0, 0], [0.6, 0, 0], [1.2, 0.1, 0]], delimiter=",")
    arm = 'kind = "follow_leader"\n[arm]\ntemplate = "RyRz"\nmodules = 20\nfeed = { stroke = "1.2 m" }\n'
    (in_a_folder / "task.toml").write_text(f'{arm}[limits]\ncycle = "1 s"\n{leader}')
    loaded = pp.Task.load(in_a_folder / "task.toml")
    reference = loaded.reference()
    assert [waypoint.name for waypoint in reference.waypoints] == ["inside", "outside"]
    deepest = reference.configuration(reference.waypoints[0].row)[0] - reference.start[0]
    assert deepest == pytest.approx(0.8)
    assert len(loaded.surroundings(reference).obstacles) > 30


def test_a_feed_in_a_file_is_read_as_shown(in_a_folder: Path) -> None:
    carrier, drum = snippets("follow_leader.md", "toml")[0].split("# or\n")
    joints = [pp.JointSpec(axis, lower=-3.0, upper=3.0, velocity=1.5) for axis in "zyyxyx"]
    robot = pp.ModuleTemplate("Robot", joints, [0.3, 0.4, 0.4, 0.1, 0.1, 0.1])  # as in Python above
    (in_a_folder / "robot.urdf").write_text(pp.Arm.from_modules([robot]).urdf)
    (in_a_folder / "feed.toml").write_text(carrier)
    (in_a_folder / "drum.toml").write_text(drum.replace("# ", "", 3))
    slide = pp.JointSpec("x", type="prismatic", lower=0.0, upper=0.3)
    arm = pp.Arm.from_modules([pp.ModuleTemplate("Feed", (slide,), (0.05,)), pp.template("RyRz")])
    feed = pp.task.load_feed("feed.toml", arm)
    assert feed.stroke == 0.3
    np.testing.assert_allclose(feed.base_placement.homogeneous, np.eye(4), atol=1e-12)
    turned = pp.task.load_feed("drum.toml", arm)
    assert turned.names[0] == "drum" and turned.matrix[0, 0] == pytest.approx(1.0 / 0.08)


MISTAKEN = """\
[arm]
template = "RyRz"
modules = 20

[limits]
velocity = 1
[[keyframes]]
curve = { type = "line", a = [0, 0, 0], b = [1, 0, 0] }
[[keyframes]]
name = "coil"
time = 1
curve = { type = "helix", radius = "10 cm", pitch = "8 cm", turns = 2 }
"""


def test_the_mistakes_shown_are_told_so(in_a_folder: Path) -> None:
    page = (DOCS / "tasks.md").read_text()
    shown = re.findall(r"^    error: (task\.toml: line \d+: .*) \.\.\.$", page, re.MULTILINE)
    changes = (("velocity", "velocty"), ("time = 1", 'time = "3 m"'), ("turns = 2", "turns = 1"))
    for words, (old, new) in zip(shown, changes, strict=True):
        (in_a_folder / "task.toml").write_text(MISTAKEN.replace(old, new))
        with pytest.raises(pp.errors.FileError) as caught:
            pp.Task.load("task.toml").reference()
        assert str(caught.value).startswith(words)


def test_a_motion_in_three_formats(in_a_folder: Path) -> None:
    (code,) = snippets("trajectories.md", "python")
    names = run(code)
    assert names["again"].configurations(names["arm"]).shape == (4, 2)
    (table,) = snippets("trajectories.md", "csv")
    assert (in_a_folder / "motion.csv").read_text().split() == table.split()
    (message,) = snippets("trajectories.md", "json")
    written = json.loads((in_a_folder / "motion.json").read_text())
    assert json.loads(message) == {**written, "points": written["points"][:2]}
    line = indented("trajectories.md", "pp.JointTrajectory.from_configurations")
    known = {
        "pp": pp,
        "np": np,
        "arm": names["arm"],
        "run": type("Run", (), {"q": np.zeros((3, 2))}),
        "dt": 0.1,
    }
    run(line, **known)


def test_follow_the_leader_in_python(capsys: pytest.CaptureFixture) -> None:
    code, steered, carried, drum = snippets("follow_leader.md", "python")
    for long, short in (
        ("] * 20", "] * 6"),
        ("interval=0.1, speed=0.05", "interval=0.4, speed=0.05, depth=0.1"),
    ):
        assert long in code
        code = code.replace(long, short)
    known = run(code.replace("dt=0.1", "dt=0.4"))
    assert known["motion"].converged
    assert np.isfinite(float(capsys.readouterr().out))
    assert run(steered, **known)["steering"].depth > 0.1
    capsys.readouterr()
    both = run(carried.replace("] * 10", "] * 4").replace("depth=0.3", "depth=0.1"), **known)["both"]
    assert len(both.joint_names) == 6 + 8
    turned = run(drum.replace("speed=0.03", "speed=0.03, depth=0.1"), **known)["turned"]
    assert turned.positions[-1, 0] == pytest.approx(0.1 / 0.08)
    assert np.abs(turned.velocities[:, 0]).max() < 0.5 + 1e-6


@pytest.mark.long
def test_physics_in_python() -> None:
    pytest.importorskip("mujoco")
    code, touching = snippets("physics.md", "python")
    arm = pp.Arm.from_template("RyRz", modules=4)
    target = pp.Target.from_configuration(arm, arm.random(np.random.default_rng(0)) * 0.1)
    limits = pp.Limits(step=None, dt=0.02, acceleration=10.0)
    q0 = arm.straight()
    motion = pp.track(arm, target, q0, limits=limits)
    tracker = pp.Tracker(arm, limits=limits)
    known = {"arm": arm, "run": motion, "tracker": tracker, "target": target, "q0": q0}
    ended = run(code.replace("duration=4.0", "duration=1.0"), **known)["ended"]
    assert ended.status == "converged"
    ended = run(f"import pinposture as pp\n{touching}", arm=arm, run=motion)["ended"]
    assert ended.contacts.pairs == (("floor", "can"),)
