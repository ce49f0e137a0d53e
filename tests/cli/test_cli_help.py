from __future__ import annotations

import shlex
import shutil
from pathlib import Path

import numpy as np
import pytest

import pinposture
from pinposture.arm import TEMPLATES
from pinposture.collision import Cylinder, Scene
from pinposture.collision.obstacles import OBSTACLE_TYPES
from pinposture.control import CONTROLLERS
from pinposture.curve import CURVES
from pinposture.editor.session import Session
from pinposture.placement.resolve import METHODS, PLACEMENTS

QUICK = (
    "generate",
    "inspect",
    "track",
    "reach",
    "batch",
    "run",
    "edit",
    "view",
    "export",
    "compile",
)
VERBS = QUICK


def examples(command, verb):
    """The examples as the help shows them on a terminal of 80 columns."""
    lines = command(*verb.split(), "--help", env={"COLUMNS": "80"}).out.splitlines()
    return [line.strip()[2:] for line in lines if line.strip().startswith("$ ")]


@pytest.mark.parametrize("arguments", [(), ("--help",), ("-h",)])
def test_the_command_alone_tells_of_every_verb(command, arguments):
    result = command(*arguments)
    assert result.code == 0
    for verb in VERBS:
        assert f" {verb.split()[0]} " in result.out


def test_the_version_is_that_of_the_package(command):
    result = command("--version")
    assert (result.code, result.out) == (0, f"pinposture {pinposture.__version__}\n")


@pytest.mark.parametrize("verb", VERBS)
def test_every_help_has_a_paragraph_and_examples_of_one_line_each(command, verb):
    out = command(*verb.split(), "--help", env={"COLUMNS": "80"}).out
    wide = command(*verb.split(), "--help", env={"COLUMNS": "500"}).out
    assert max(len(line.split()) for line in wide.split("╭")[0].splitlines()) > 30
    shown = examples(command, verb)
    assert len(shown) >= (2 if verb == "compile" else 3)  # there is not much to say to it
    assert all(example.startswith("pinposture ") for example in shown)
    assert any(example.startswith(f"pinposture {verb} ") for example in shown)
    assert max(map(len, out.splitlines())) <= 80


def test_the_help_of_track_names_everything_that_can_be_named(command):
    out = command("track", "--help", env={"COLUMNS": "200"}).out
    for name in (*CONTROLLERS, *CURVES, *PLACEMENTS, *METHODS, "straight", "smooth", "random"):
        assert name in out
    for heading in ("The limits", "The surroundings", "The tip"):
        assert f" {heading} " in out


def words_of_help(command, verb):
    """The words of a help, without the frames around its options."""
    out = command(verb, "--help", env={"COLUMNS": "200"}).out
    return " ".join(out.replace("│", " ").split())


def test_the_help_names_what_is_registered_and_nothing_else(command, monkeypatch):
    for registry in (CONTROLLERS, CURVES):
        monkeypatch.setitem(registry, "new", next(iter(registry.values())))
    help_of_track = words_of_help(command, "track")
    assert f"Controller: {', '.join(CONTROLLERS)}, or package.module:Class." in help_of_track
    assert f"scaled to the arm: {', '.join(CURVES)}." in help_of_track
    assert f"a file, or one of {', '.join(CURVES)}." in words_of_help(command, "inspect")
    assert f"Kind of module: {', '.join(TEMPLATES)};" in words_of_help(command, "generate")
    assert f"a module template: {', '.join(TEMPLATES)}." in words_of_help(command, "edit")


def scene_in_the_help(command):
    """The line of a scene file that the help of track shows, as one writes it down."""
    out = " ".join(command("track", "--help", env={"COLUMNS": "80"}).out.split())
    begin = out.index("obstacles.post")
    return out[begin : out.index("}", begin) + 1]


def test_the_scene_in_the_help_is_one_and_names_every_kind_of_obstacle(command, tmp_path, monkeypatch):
    monkeypatch.setitem(OBSTACLE_TYPES, "new", Cylinder)
    (tmp_path / "scene.toml").write_text(scene_in_the_help(command))
    scene = Scene.load(tmp_path / "scene.toml")
    assert scene == Scene({"post": Cylinder((0.3, 0.1, -1), (0.3, 0.1, 1), 0.02)})
    out = " ".join(command("track", "--help", env={"COLUMNS": "80"}).out.split())
    for name, kind in OBSTACLE_TYPES.items():
        assert f"{name} ({', '.join(kind.check_keys()[1:])})" in out
    for key in ("margin", "arm_radius", "self_collision", f"default {scene.margin:g})"):
        assert key in out


@pytest.mark.tutorial
@pytest.mark.usefixtures("no_pictures")
def test_the_examples_run_one_after_the_other(command, tmp_path, monkeypatch):
    class Viewer:
        url = "address"

        def play(self):
            pass

        def close(self):
            pass

    def interrupted():
        raise KeyboardInterrupt

    class Served:
        url = "address"

        def __init__(self, task, path, *_):
            self.session = Session(task, path)
            if not path.exists():
                task.save(path)

        def start(self):
            pass

        def wait(self):
            raise KeyboardInterrupt

        def close(self):
            pass

    monkeypatch.setattr("pinposture.viz.view", lambda *_, **__: Viewer())
    monkeypatch.setattr("pinposture.editor.Editor", Served, raising=False)
    monkeypatch.setattr("webbrowser.open", lambda _: None)
    monkeypatch.setattr("pinposture.cli.view.wait", interrupted)
    monkeypatch.chdir(tmp_path)
    t = np.linspace(0, 1.2, 50)
    np.savetxt("curve.csv", np.column_stack([t, 0.1 * np.sin(3 * t)]), delimiter=",")
    (tmp_path / "scene.toml").write_text(scene_in_the_help(command))
    shutil.copytree(Path(__file__).parents[2] / "examples" / "tasks", tmp_path / "examples" / "tasks")
    (tmp_path / "urdf").mkdir()
    command("generate", "Rz", "--modules", 8, "-o", tmp_path / "urdf" / "flat.urdf")
    for verb in QUICK:
        for example in examples(command, verb):
            if "--retreat" in example:  # takes minutes; `test_cli_run.py` runs it with a small arm
                continue
            output = ""
            for stage in example.split("|"):
                program, *arguments = shlex.split(stage)
                assert program == "pinposture"
                result = command(*arguments, input=output)
                # Where a tip is asked for as well, the arm weighs both, and does not take all of the shape.
                assert result.code == (1 if "--tip-position" in example else 0), (example, result.err)
                output = result.out
    made = {path.name for path in tmp_path.iterdir()}
    assert made == {
        "curve.csv",
        "examples",
        "scene.toml",
        "urdf",
        "arm.urdf",
        "arm.png",
        "long.urdf",
        "fed.urdf",
        "out",
        "motion.html",
        "ryrz20.toml",
        "snake.toml",
        "dance.toml",
        "motion.png",
        "g.json",
    }
