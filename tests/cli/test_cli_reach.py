"""The verb `reach`: what it prints, what it leaves behind, and how it ends."""

from __future__ import annotations

import json

import numpy as np
import pinocchio as pin
import pytest

import pinposture as pp

GOAL = (0.15, 0.05, 0.12)
ASKED = ("--to", "0.15,0.05,0.12", "--budget", 20)


def tip(arm_file, q):
    model = pin.buildModelFromUrdf(str(arm_file))
    data = model.createData()
    pin.framesForwardKinematics(model, data, np.array(q))
    return data.oMf[model.getFrameId("tip")]


@pytest.fixture
def scene_file(tmp_path):
    path = tmp_path / "scene.toml"
    ball = 'obstacles.ball = {type = "sphere", center = [0.1, 0.0, 0.1], radius = 0.03}'
    path.write_text(f"margin = 0.01\n{ball}\n")
    return path


def test_the_json_has_postures_whose_tip_is_there(command, arm_file, scene_file):
    result = command("reach", arm_file, *ASKED, "--scene", scene_file, "--count", 3, "--json")
    assert (result.code, result.err) == (0, "")
    told = json.loads(result.out)
    assert told["to"] == list(GOAL)
    assert len(told["postures"]) == 3
    for each in told["postures"]:
        np.testing.assert_allclose(tip(arm_file, each["q"]).translation, GOAL, atol=1e-6)
        assert each["clearance"] >= 0.01
        assert each["path"] is None
    scores = [each["score"] for each in told["postures"]]
    assert scores == sorted(scores, reverse=True)


def test_the_direction_is_that_of_the_tip(command, arm_file):
    told = json.loads(command("reach", arm_file, *ASKED, "--direction", "0,0,2", "--json").out)
    (posture,) = told["postures"]
    np.testing.assert_allclose(tip(arm_file, posture["q"]).rotation[:, 0], (0, 0, 1), atol=1e-4)
    assert (
        posture["clearance"]
        == pp.CollisionModel(pp.Arm.load(arm_file), pp.Scene()).minimum(posture["q"]).distance
    )
    free = command("reach", arm_file, *ASKED, "--no-self-collision", "--json")
    assert json.loads(free.out)["postures"][0]["clearance"] is None


@pytest.mark.long
def test_with_a_start_it_keeps_pictures_postures_and_the_run(command, arm_file, scene_file, tmp_path):
    out = tmp_path / "out"
    given = ("--scene", scene_file, "--start", "straight", "--count", 2, "-o", out)
    result = command("reach", arm_file, *ASKED, *given)
    assert result.code == 0
    assert "clear" in result.out
    kept = {each.name for each in out.iterdir()}
    assert kept == {"postures.png", "posture_1.json", "posture_2.json", "run.npz", "run.png", "run.html"}
    assert all(f"wrote {out / name}" in result.err for name in kept)
    run = pp.load(out / "run.npz")
    best = json.loads((out / "posture_1.json").read_text())
    np.testing.assert_allclose(tip(arm_file, best).translation, GOAL, atol=1e-6)
    np.testing.assert_allclose(tip(arm_file, run.q[-1]).translation, GOAL, atol=1e-5)
    again = command("reach", arm_file, "--to", "0.1,0.05,0.2", "--start", out / "posture_1.json", "--json")
    path = np.array(json.loads(again.out)["postures"][0]["path"])
    np.testing.assert_allclose(path[0], best)
    np.testing.assert_allclose(tip(arm_file, path[-1]).translation, (0.1, 0.05, 0.2), atol=1e-6)


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (("--to", "1,0,0"), "the arm reaches 300 mm"),
        (("--to", "0.1,0,0,0"), "--to is [0.1, 0.0, 0.0, 0.0]; allowed: a list of 3"),
        (("--to", "a,b,c"), "--to"),
        (("--to", "0.1,0,0.1", "--direction", "0,0,0"), "direction"),
        (("--to", "0.1,0,0.1", "--count", "0"), "count"),
        (("--to", "0.1,0,0.1", "--degrees"), "--start"),
        ((), "--to"),
    ],
)
def test_what_cannot_be_is_refused_in_one_line(command, arm_file, arguments, told):
    result = command("reach", arm_file, *arguments)
    assert (result.code, result.out) == (2, "")
    assert told in result.err
    assert len(result.err.splitlines()) == 1


def test_a_posture_without_a_clear_path_ends_with_1(command, tmp_path):
    arm = tmp_path / "arm.urdf"
    assert command("generate", "Rz", "--modules", 2, "-o", arm).code == 0
    scene = tmp_path / "scene.toml"
    wall = 'obstacles.wall = {type = "box", center = [0.2, 0, 0], size = [0.36, 0.002, 1]}\n'
    scene.write_text(f"margin = 0.001\narm_radius = 0.004\n{wall}")
    given = ("--scene", scene, "--start", "1.2,0.3", "--budget", 2)
    result = command("reach", arm, "--to", "0.15,-0.15,0", *given)
    assert result.code == 1
    assert "wall" in result.out
