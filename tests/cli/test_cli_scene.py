"""Scene files and self-collision on the command line."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import pinposture as pp
from pinposture.collision import CollisionModel, HalfSpace, Scene, Sphere
from pinposture.curve import CURVES
from pinposture.units import length_text

BALL = Sphere((0.2, 0.1, 0.0), 0.04)
FLOOR = HalfSpace((0.0, 0.0, -0.2), (0.0, 0.0, 1.0))
ABOVE = "0,0.9,0,0.3,0,0.1,0,-0.5,0,-0.5,0,-0.5"
"""Joint positions at which the arm passes the ball on the far side; the straight way to the axis hits it."""
MARGIN = 0.006
RADIUS = 0.004
EXAMPLES = Path(__file__).parents[2] / "examples"


@pytest.fixture(scope="module")
def scene_file(tmp_path_factory):
    scene = Scene({"ball": BALL, "floor": FLOOR}, margin=MARGIN, arm_radius=RADIUS)
    return scene.save(tmp_path_factory.mktemp("scene") / "scene.json")


@pytest.fixture
def track(command, arm_file, tmp_path, no_pictures):
    def run(*options):
        asked = ("track", arm_file, "--curve", "line", "--start", ABOVE, "-o", tmp_path)
        result = command(*asked, *options, "--json")
        assert result.code == 0, result.err
        return json.loads(result.out), pp.load(tmp_path / "run.npz", pp.Run)

    return run


@pytest.fixture(scope="module")
def passed(command, arm_file, scene_file, tmp_path_factory):
    """The summary of a run around the ball, and the run."""
    path = tmp_path_factory.mktemp("passed")
    with pytest.MonkeyPatch.context() as patch:
        for name in ("write_plot", "write_animation"):
            patch.setattr(f"pinposture.cli.output.{name}", lambda *_: None)
        asked = ("track", arm_file, "--curve", "line", "--start", ABOVE, "--scene", scene_file)
        result = command(*asked, "-o", path, "--json")
    assert result.code == 0, result.err
    return json.loads(result.out), pp.load(path / "run.npz", pp.Run)


def to_ball(points):
    """Distance of the ball from the surface of each capsule along the links, (..., modules)."""
    ends = np.concatenate([np.zeros_like(points[..., :1, :]), points], axis=-2)
    first = ends[..., :-1, :]
    last = ends[..., 1:, :]
    middles = (first + last) / 2  # where the elbow of a straight arm is; of a bent one nearly
    shares = np.linspace(0.0, 1.0, 50)[:, None]
    places = middles[..., None, :] + (last - first)[..., None, :] * (shares - 0.5)
    return np.linalg.norm(places - np.array(BALL.center), axis=-1).min(axis=-1) - BALL.radius - RADIUS


def test_the_arm_keeps_clear_of_what_it_would_hit(track, scene_file, passed):
    free, through = track("--no-self-collision")
    summary, run = passed
    assert free["clearance"]["pair"] is None and through.scene == Scene(self_collision=False)
    assert to_ball(through.points).min() < -0.01
    assert run.scene == Scene.load(scene_file)
    assert summary["scene"] == str(scene_file)
    assert summary["converged"]
    assert to_ball(run.points).min() > MARGIN - 2e-3
    told = summary["clearance"]
    assert told["smallest"] == pytest.approx(run.clearance.min())
    assert told["smallest"] >= MARGIN
    assert told["final"] == pytest.approx(run.clearance[-1])
    assert told["margin"] == MARGIN
    parts = (told[part]["smallest"] for part in ("to_obstacles", "to_itself"))
    assert told["smallest"] == pytest.approx(min(parts), abs=1e-12)
    for part, scene in {"to_obstacles": run.scene.without_self_collision(), "to_itself": Scene()}.items():
        model = CollisionModel(run.arm, replace(scene, margin=MARGIN, arm_radius=RADIUS))
        least = min((model.minimum(q) for q in run.q), key=lambda each: each.distance)
        assert told[part]["smallest"] == pytest.approx(least.distance, abs=1e-12)
        assert told[part]["pair"] == list(least.pair)
    at = CollisionModel(run.arm, run.scene).minimum(run.q[told["after_steps"]])
    assert (at.distance, list(at.pair)) == (pytest.approx(told["smallest"]), told["pair"])
    assert summary["path_length_ratio"] > free["path_length_ratio"]


@pytest.mark.long
def test_a_scan_beside_the_file_is_kept_clear_of_and_stays_with_the_run(track, command, arm_file, tmp_path):
    rng = np.random.default_rng(0)
    ways = rng.normal(size=(4000, 3))
    points = BALL.center + BALL.radius * ways / np.linalg.norm(ways, axis=1)[:, None]
    np.savetxt(tmp_path / "ball.xyz", 1000.0 * points)
    scene = tmp_path / "scene.toml"
    scene.write_text(
        f"margin = {MARGIN}\narm_radius = {RADIUS}\n[obstacles]\n"
        'seen = { type = "scan", path = "ball.xyz", scale = 0.001 }\n'
    )
    shown = json.loads(command("inspect", arm_file, "--scene", scene, "--json").out)["scene"]
    assert [each["path"] for each in shown["obstacles"]] == [str(tmp_path / "ball.xyz")]
    about, run = track("--scene", scene)
    assert about["status"] == "converged"
    clearances = [to_ball(state).min() for state in run.points]
    assert MARGIN - 2e-3 < min(clearances) < 0.05
    (tmp_path / "ball.xyz").unlink()
    again = pp.load(tmp_path / "run.npz", pp.Run)
    np.testing.assert_allclose(again.scene.obstacles["seen"].points, points, atol=1e-9)


def test_paths_and_escapes_are_those_of_the_run(passed):
    summary, run = passed
    paths = sum(np.linalg.norm(np.diff(run.points[:, k], axis=0), axis=1).sum() for k in range(6))
    direct = sum(np.linalg.norm(run.points[-1, k] - run.points[0, k]) for k in range(6))
    assert summary["path_length_ratio"] == pytest.approx(paths / direct)
    assert summary["escape_share"] == run.error_increasing.sum() / run.steps
    assert summary["violated_constraints"] == []


def test_another_controller_tells_the_distances_and_that_it_does_not_heed_them(command, arm_file, scene_file):
    asked = ("track", arm_file, "--curve", "line", "--start", ABOVE, "--controller", "joint")
    result = command(*asked, "--scene", scene_file, "--json")
    assert json.loads(result.out)["clearance"]["smallest"] < 0.0
    assert result.err.count("\n") == 1
    assert "joint does not avoid obstacles" in result.err


def test_the_table_says_what_the_json_says(command, arm_file, scene_file, passed):
    asked = ("track", arm_file, "--curve", "line", "--start", ABOVE, "--scene", scene_file)
    summary, _ = passed
    words = {line.split("  ", 1)[0]: line for line in command(*asked).out.splitlines()}
    told = summary["clearance"]
    smallest, final = (length_text(told[name]) for name in ("smallest", "final"))
    assert f"{smallest} where it is smallest, {' to '.join(told['pair'])}" in words["clearance"]
    assert f"{final} at the end" in words["clearance"]
    share = f"{100 * summary['escape_share']:.3g} % of the steps"
    assert share in words["rising"] if summary["escape_share"] else "rising" not in words
    assert f"{summary['path_length_ratio']:.3g} times" in words["paths"]
    assert "violated" not in words


def test_what_gave_way_is_told_with_the_step(command, arm_file, tmp_path, no_pictures):
    # Some joints begin outside what the margin leaves, 0.24 rad on either side.
    asked = ("track", arm_file, "--curve", "line", "--start", ABOVE, "--position-margin", 2.9)
    summary = json.loads(command(*asked, "-o", tmp_path, "--json").out)
    run = pp.load(tmp_path / "run.npz", pp.Run)
    assert summary["violated_constraints"][0]["step"] == 0
    assert "position limit: joint 'm01_j2_z'" in summary["violated_constraints"][0]["what"][0]
    assert {each["step"]: each["what"] for each in summary["violated_constraints"]} == {
        k: text.splitlines() for k, text in enumerate(run.violated_constraints) if text
    }
    (line,) = (line for line in command(*asked).out.splitlines() if line.startswith("violated"))
    count = len(summary["violated_constraints"])
    assert f"position limit in {count} steps; first in step 1: position limit: joint" in line
    assert summary["violated_steps"] == {
        "position limit": [k for k, text in enumerate(run.violated_constraints) if text]
    }
    assert line.rstrip().endswith(" ...")
    assert len(line.rstrip()) < 300


def test_self_collision_is_on_unless_the_file_or_the_option_says_no(track, scene_file, tmp_path):
    still = ("--tolerance", 1)  # there to begin with
    assert track(*still)[1].scene == track("--self-collision", *still)[1].scene == Scene()
    assert track("--no-self-collision", *still)[1].scene == Scene(self_collision=False)
    both = track("--scene", scene_file, *still)[1].scene
    assert (both.self_collision, dict(both.obstacles)) == (True, {"ball": BALL, "floor": FLOOR})
    assert both.margin == MARGIN
    off = tmp_path / "off.toml"
    off.write_text("self_collision = false\n")
    assert track("--scene", off, *still)[1].scene == Scene(self_collision=False)
    assert track("--scene", off, "--self-collision", *still)[1].scene == Scene()


def test_inspect_shows_the_scene_and_what_is_nearest(command, arm_file, scene_file):
    asked = ("inspect", arm_file, "--scene", scene_file, "--no-self-collision")
    about = json.loads(command(*asked, "--json").out)["scene"]
    assert (about["margin"], about["self_collision"]) == (MARGIN, False)
    ball, floor = about["obstacles"]
    # Straight along x, capsules of 25 mm: the ball is beside them at 0.2, where two meet.
    assert (ball["name"], ball["type"], ball["radius"]) == ("ball", "sphere", 0.04)
    assert ball["distance"] == pytest.approx(0.1 - 0.04 - RADIUS)
    assert floor["distance"] == pytest.approx(0.2 - RADIUS)
    assert len(about["bodies"]) == 12
    assert about["bodies"][0]["nearest"] == "ball"
    assert about["bodies"][0]["distance"] == pytest.approx(np.hypot(0.175, 0.1) - 0.04 - RADIUS)
    rows = [line.split() for line in command(*asked).out.splitlines()]
    assert ["ball", "sphere", ball["nearest"], f"{ball['distance']:.4g}"] in rows
    for body in about["bodies"]:
        assert [body["name"], body["nearest"], f"{body['distance']:.4g}"] in rows


def test_inspect_shows_the_distances_of_the_arm_from_itself(command, arm_file):
    about = json.loads(command("inspect", arm_file, "--self-collision", "--json").out)["scene"]
    assert (about["self_collision"], about["obstacles"]) == (True, [])
    first = about["bodies"][0]
    assert first["nearest"] in [body["name"] for body in about["bodies"][2:]]
    assert first["distance"] > 0.0
    assert "distances of the arm from itself count" in command("inspect", arm_file, "--self-collision").out
    assert json.loads(command("inspect", arm_file, "--json").out)["scene"] is None


BALL_TABLE = {"type": "sphere", "center": [0.2, 0.1, 0], "radius": 0.04}


@pytest.mark.parametrize("verb", ["track", "inspect"])
@pytest.mark.parametrize(
    ("name", "text", "says"),
    [
        ("none.toml", None, "no such file"),
        ("scene.yaml", "", ".toml, .json"),
        ("broken.toml", "margin =\nobstacles = 1", "line 1"),
        ("broken.json", '{"obstacles":', "line 1"),
        ("key.toml", "obstacle = 1", "obstacle: there is no such key (did you mean 'obstacles'?)"),
        ("type.json", json.dumps({"obstacles": {"a": {"type": "ball"}}}), "'ball'"),
        (
            "radius.json",
            json.dumps({"obstacles": {"a": {**BALL_TABLE, "radius": -1}}}),
            "obstacles.a.radius: is -1",
        ),
        (
            "center.json",
            json.dumps({"obstacles": {"a": {**BALL_TABLE, "center": [0, 1]}}}),
            "obstacles.a.center: is [0, 1]",
        ),
        ("mesh.json", json.dumps({"obstacles": {"a": {"type": "mesh", "path": "x.stl"}}}), "x.stl"),
        ("margin.toml", "margin = -1", "margin: is -1"),
    ],
)
def test_a_bad_scene_is_refused_in_one_line(command, arm_file, tmp_path, verb, name, text, says):
    if text is not None:
        (tmp_path / name).write_text(text)
    curve = ("--curve", "line") if verb == "track" else ()
    result = command(verb, arm_file, *curve, "--scene", tmp_path / name)
    assert (result.code, result.out, result.err.count("\n")) == (2, "", 1)
    assert result.err.startswith("error: ")
    assert name in result.err
    assert says in result.err


@pytest.mark.long
@pytest.mark.parametrize("curve", CURVES)
@pytest.mark.parametrize("verb", ["track", "batch"])
def test_presets_fit_their_own_defaults_among_obstacles(command, tmp_path, curve, verb):
    arm = tmp_path / "arm.urdf"
    command("generate", "RyRz", "--modules", 20, "-o", arm)
    scene = EXAMPLES / "scene.toml"
    numbers = ("--count", 2) if verb == "batch" else ("--steps", 1)
    told = json.loads(command(verb, arm, "--curve", curve, "--scene", scene, *numbers, "--json").out)
    moved = told["moved"] if verb == "track" else told["moved"][0]
    assert (np.linalg.norm(moved["translation"]) > 0.01) == (curve == "helix")
    assert told["control_points"] == 20


@pytest.mark.parametrize("curve", CURVES)
def test_presets_fit_their_own_defaults_in_a_task_with_obstacles(command, tmp_path, curve):
    shutil.copy(EXAMPLES / "scene.toml", tmp_path / "scene.toml")
    shapes = "".join(f'[[keyframes]]\ncurve = "{each}"\ntrim = true\n' for each in ("line", curve))
    text = 'version = 1\n[arm]\ntemplate = "RyRz"\nmodules = 20\n[scene]\nfile = "scene.toml"\n'
    task = tmp_path / "task.toml"
    task.write_text(text + shapes.replace("trim = true\n[", "trim = true\n\n[") + "time = 2\n")
    told = json.loads(command("run", task, "--check", "--json").out)
    assert [each["off_curve"] < 1e-5 for each in told["keyframes"]] == [True, True]
    loaded = pp.Task.load(task)
    assert [each.placement for each in loaded.motion] == ["align", "align"]
    loaded.save(tmp_path / "saved.toml")
    assert "placement" not in (tmp_path / "saved.toml").read_text()
    drawn = pp.Keyframe(pp.Curve.line((0, 0, 0), (1, 0, 0)))
    assert loaded.edited(motion=(drawn, drawn)).motion[0].placement == "as_is"


def test_points_that_look_like_outliers_are_told_with_the_option_that_removes_them(
    command, arm_file, tmp_path
):
    rng = np.random.default_rng(0)
    wall = np.stack([np.full(5000, 0.6), *rng.uniform(-0.5, 0.5, size=(2, 5000))], axis=1)
    np.save(tmp_path / "wall.npy", np.vstack([wall, rng.uniform((0.2, -0.5, -0.5), (0.4, 0.5, 0.5), (7, 3))]))
    file = tmp_path / "scene.toml"
    file.write_text('[obstacles]\nwall = { type = "scan", path = "wall.npy" }\n')
    found = json.loads(command("inspect", arm_file, "--scene", file, "--json").out)["scene"]["outliers"]
    assert (found["wall"]["points"], found["wall"]["of"]) == (7, 5007)
    told = command("inspect", arm_file, "--scene", file, env={"COLUMNS": "200"}).out
    option = f"outlier_distance = {found['wall']['distance']:g}"
    assert f"{option} removes them" in told
    file.write_text(f'[obstacles]\nwall = {{ type = "scan", path = "wall.npy", {option} }}\n')
    assert json.loads(command("inspect", arm_file, "--scene", file, "--json").out)["scene"]["outliers"] == {}
