"""What is asked of the tip on the command line is done to it, and the summary tells how far off it is."""

from __future__ import annotations

import json

import numpy as np
import pytest

import pinposture as pp
from pinposture.units import length_text

START = ",".join(["0.2,-0.1"] * 6)


def turned(roll, pitch, yaw):
    """Rotation about x, then y, then z, fixed axes."""
    (cr, sr), (cp, sp), (cy, sy) = ((np.cos(angle), np.sin(angle)) for angle in (roll, pitch, yaw))
    about_x = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    about_y = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    about_z = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    return about_z @ about_y @ about_x


@pytest.fixture
def track(command, arm_file, tmp_path, no_pictures):
    def run(*options):
        asked = ("track", arm_file, "--curve", "line", "--start", START, "--steps", 80, "-o", tmp_path)
        result = command(*asked, *options, "--json")
        assert result.code in (0, 1), result.err  # the shape may have to give way to the tip
        return json.loads(result.out)["tip"], pp.load(tmp_path / "run.npz", pp.Run)

    return run


def test_without_a_task_nothing_is_said_of_the_tip(track):
    assert track()[0] is None


def test_the_tip_comes_where_it_is_asked_while_a_region_takes_its_shape(track):
    place = np.array([0.22, 0.08, -0.05])
    tip, run = track("--region", "1-2", "--tip-position", ",".join(map(str, place)))
    assert np.linalg.norm(run.points[-1, -1] - place) == pytest.approx(tip["distance"], abs=1e-12)
    assert tip["distance"] < 1e-4
    assert tip["turn"] is None
    assert run.point_errors[-1].max() < 1e-4


def test_the_tip_takes_the_pose_that_is_asked(track):
    place = np.array([0.2, 0.06, -0.08])
    angles = (0.3, 0.5, 0.4)
    text = ",".join(map(str, (*place, *angles)))
    tip, run = track("--region", "1-1", "--tip-pose", text)
    state = run.arm.at(run.q[-1])
    np.testing.assert_allclose(state.points[-1], place, atol=1e-3)
    np.testing.assert_allclose(state.rotations[-1], turned(*angles), atol=2e-2)
    off = state.rotations[-1].T @ turned(*angles)
    assert np.arccos(min(1.0, (np.trace(off) - 1) / 2)) == pytest.approx(tip["turn"], abs=1e-6)


@pytest.mark.long
@pytest.mark.parametrize(("hold", "keys"), [("position", 1), ("pose", 2)])
def test_a_tip_that_is_held_stays_where_the_start_has_it(track, hold, keys):
    tip, run = track("--hold-tip", hold, "--tip-priority", "--region", "1-2")
    states = [run.arm.at(q) for q in run.q]
    moved = max(np.linalg.norm(state.points[-1] - states[0].points[-1]) for state in states)
    swung = max(np.abs(state.rotations[-1] - states[0].rotations[-1]).max() for state in states)
    assert run.posture_error[-1] < run.posture_error[0]
    assert moved < 1e-3
    assert (swung < 1e-2) == (hold == "pose")
    assert sum(value is not None for value in tip.values()) == keys
    free = track("--region", "1-2")[1].points[:, -1]
    assert np.linalg.norm(free[-1] - free[0]) > 20 * moved


@pytest.mark.long
def test_the_weight_and_the_priority_decide_between_tip_and_shape(track):
    place = ("--tip-position", "0.2,0.1,0.05")
    light, heavy, strict = (
        track(*place, *more)[0]["distance"]
        for more in (("--tip-weight", 0.01), ("--tip-weight", 100), ("--tip-priority",))
    )
    assert light > 3.0 * heavy
    assert strict < 0.05 * heavy


def test_the_table_tells_how_far_off_the_tip_is(command, arm_file):
    asked = ("track", arm_file, "--curve", "line", "--steps", 3, "--tip-pose", "0.2,0,0.1,0,0,0")
    tip = json.loads(command(*asked, "--json").out)["tip"]
    line = f"{length_text(tip['distance'])} off, turned by {tip['turn']:.4g} rad"
    assert line in command(*asked).out


def test_haste_takes_joints_straight_there(command, arm_file, tmp_path, no_pictures):
    excess = []
    for joint_weight in (0.01, 100.0):
        options = ("--start", "random", "--seed", 2, "--joint-weight", joint_weight, "-o", tmp_path, "--json")
        excess.append(
            json.loads(command("track", arm_file, "--curve", "helix", *options).out)["path_length_ratio"]
        )
        q = pp.load(tmp_path / "run.npz", pp.Run).q
    assert excess[0] < excess[1]
    way = q[-1] - q[0]  # of the hasty one: close to a straight line through joint space
    aside = (q - q[0]) - np.outer((q - q[0]) @ way, way) / (way @ way)
    assert np.abs(aside).max() < 0.05 * np.linalg.norm(way)


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (("--tip-position", "1,2"), ("--tip-position is [1.0, 2.0]", "a list of 3")),
        (("--tip-position", "1,2,inf"), ("--tip-position 3 is inf, which is not finite",)),
        (("--tip-position", "here"), ("--tip-position is 'here'", "a list of 3")),
        (("--tip-pose", "1,2,3"), ("--tip-pose is '1,2,3'", "X,Y,Z,ROLL,PITCH,YAW")),
        (("--tip-position", "0.3,0.2,0"), ("361 mm from the base at (0, 0, 0) m", "reaches 300 mm; choose")),
        (("--tip-pose", "0,0,-0.301,0,0,0"), ("301 mm from the base", "reaches 300 mm")),
        (("--tip-position", "220,80,0"), ("reaches 300 mm; is it in millimetres",)),
        (("--hold-tip", "place"), ("'place'", "position, pose")),
        (("--hold-tip", "pose", "--tip-pose", "1,0,0,0,0,0"), ("--hold-tip is 'pose'", "without --tip-pose")),
        (("--tip-weight", 2), ("--tip-weight is 2.0", "together with one of --tip-position")),
        (("--tip-priority",), ("--tip-priority is True", "together with one of --tip-position")),
        (("--hold-tip", "pose", "--tip-weight", 0), ("--tip-weight is 0", "> 0")),
        (("--joint-weight", 0), ("--joint-weight is 0", "> 0")),
        (("--joint-weight", "nan"), ("--joint-weight is nan", "> 0")),
        (
            ("--controller", "lm", "--joint-weight", 1),
            ("--controller is 'lm'", "'geodesic'", "--joint-weight"),
        ),
        (
            ("--controller", "selection", "--hold-tip", "pose", "--tip-priority"),
            ("--hold-tip, --tip-priority",),
        ),
        (("--controller", "lmm", "--joint-weight", 1), ("did you mean 'lm'",)),
    ],
)
def test_what_cannot_be_asked_is_refused_in_one_line(command, arm_file, options, says):
    result = command("track", arm_file, "--curve", "helix", *options)
    assert (result.code, result.out, result.err.count("\n")) == (2, "", 1)
    for text in says:
        assert text in result.err
