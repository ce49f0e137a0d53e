"""What the pages on motions in time show works as shown."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pinposture as pp
from pinposture import scene, task

DOCS = Path(__file__).parents[1] / "docs"


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
        "tasks.md": [1, 2, 0, 0],
        "trajectories.md": [1, 0, 1, 1],
        "follow_leader.md": [0, 0, 0, 0],
        "physics.md": [1, 0, 0, 0],
    }


def test_keyframes_in_python(capsys: pytest.CaptureFixture) -> None:
    (code,) = snippets("tasks.md", "python")
    motion = run(code)["motion"]
    assert motion.converged
    assert capsys.readouterr().out == f"{motion!r}\n"
    for name in ("q", "time", "mean_error", "passed", "slowing"):  # as the page goes on to say
        assert f"`motion.{name}`" in (DOCS / "tasks.md").read_text()
        assert getattr(motion, name) is not None


def test_the_task_file_is_one_and_its_comments_are_true(in_a_folder: Path) -> None:
    (text, _) = snippets("tasks.md", "toml")
    file = in_a_folder / "task.toml"
    file.write_text(text)
    loaded = pp.Task.load(file)
    reference = loaded.reference()
    assert [mark.name for mark in reference.marks] == ["straight", "coil"]
    assert reference.duration == pytest.approx(3.5)
    # What is commented out can be put in, with limits for both kinds of joints.
    (feed,) = re.findall(r"^# (feed = \{.*\})", text, re.MULTILINE)
    (placement,) = re.findall(r"^# (placement = \{[^#]*\})", text, re.MULTILINE)
    (both,) = re.findall(r"or (\{ turning = .*\})", text)
    fed = text.replace(f"# {feed}", feed).replace(f"# {placement}", placement)
    for old, new in (('"90 deg/s"', "2"), ('"360 deg/s^2"', both), ('"2 deg"', "0")):
        fed = fed.replace(old, new)
    file.write_text(fed)
    arm = pp.Task.load(file).arm
    assert arm.nv == 41
    np.testing.assert_allclose(arm.chain.base, (0, 0, 0.5))
    (in_a_folder / "snake.urdf").write_text(loaded.arm.urdf)
    file.write_text(re.sub(r"\[arm\].*?\n\n", '[arm]\nurdf = "snake.urdf"\n\n', text, flags=re.DOTALL))
    assert pp.Task.load(file).arm.nv == 40


def test_the_leader_is_one(in_a_folder: Path) -> None:
    (_, leader) = snippets("tasks.md", "toml")
    np.savetxt(in_a_folder / "path.csv", [[0, 0, 0], [0.3, 0, 0], [0.6, 0, 0], [1.2, 0.1, 0]], delimiter=",")
    arm = 'kind = "follow_leader"\n[arm]\ntemplate = "RyRz"\nmodules = 20\nfeed = { stroke = "1.2 m" }\n'
    (in_a_folder / "task.toml").write_text(f'{arm}[limits]\ncycle = "1 s"\n{leader}')
    loaded = pp.Task.load(in_a_folder / "task.toml")
    reference = loaded.reference()
    assert [mark.name for mark in reference.marks] == ["inside", "outside"]
    deepest = reference.configuration(reference.marks[0].row)[0] - reference.start[0]
    assert deepest == pytest.approx(0.8)
    assert len(loaded.surroundings(reference).obstacles) > 30


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
    changes = (("velocity", "velocty"), ("time = 1", 'time = "3 m"'), ("", ""))
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


def test_follow_the_leader_in_python() -> None:
    path = pp.Curve.spline([(0, 0, 0), (0.1, 0, 0), (0.2, 0, 0), (0.3, 0.1, 0)])
    code = indented("follow_leader.md", "feed = ")
    for long, short in (("* 20", "* 6"), ("interval=0.1", "interval=0.4"), ("dt=0.1", "dt=0.4")):
        code = code.replace(long, short)
    *most, last = code.replace("speed=0.05", "speed=0.05, depth=0.1").strip().splitlines()
    most.insert(3, "laid = reference.marks[0].target.curve")
    functions = (scene.pipe, task.follow_leader, task.path_deviation, task.perform)
    names = run("\n".join(most), pp=pp, path=path, **{each.__name__: each for each in functions})
    assert names["motion"].converged
    assert np.all(np.isfinite(eval(last, names)))


def test_physics_in_python() -> None:
    pytest.importorskip("mujoco")
    (code,) = snippets("physics.md", "python")
    arm = pp.Arm.from_template("RyRz", modules=4)
    target = pp.Target.from_configuration(arm, arm.random(np.random.default_rng(0)) * 0.1)
    limits = pp.Limits(step=None, dt=0.02, acceleration=10.0)
    q0 = arm.straight()
    motion = pp.track(arm, target, q0, limits=limits)
    tracker = pp.Tracker(arm, limits=limits)
    known = {"arm": arm, "run": motion, "tracker": tracker, "target": target, "q0": q0}
    ended = run(code.replace("duration=4.0", "duration=0.4"), **known)["ended"]
    assert ended.status == "finished"
