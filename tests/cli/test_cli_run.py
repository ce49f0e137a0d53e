"""`pinposture run`: what it prints, keeps and refuses."""

from __future__ import annotations

import json
import os
import re
from pathlib import Path
from unittest.mock import ANY

import numpy as np
import pinocchio as pin
import pytest

import pinposture as pp
from pinposture.storage import write_text

TASK = """\
name = "bow"
[arm]
template = "RyRz"
modules = 4
[limits]
cycle = "50 ms"
[[keyframes]]
name = "straight"
curve = { type = "line", a = [0, 0, 0], b = [0.2, 0, 0] }
[[keyframes]]
name = "bowed"
time = "1 s"
curve = { type = "helix", radius = "10 cm", pitch = 0, turns = 0.5 }
trim = true
[output]
formats = ["npz", "csv", "json"]
"""
KINDS = ("csv", "json", "npz")
KEPT = [f"motion.{kind}" for kind in KINDS]
FINITE = (int, float, str, bool, type(None))


@pytest.fixture
def task(tmp_path: Path) -> Path:
    file = tmp_path / "bow.toml"
    file.write_text(TASK)
    return file


def leaves(value: object) -> list[object]:
    items = value.values() if isinstance(value, dict) else value if isinstance(value, list) else None
    return [value] if items is None else [leaf for item in items for leaf in leaves(item)]


def test_a_person_reads_what_became_of_it(command, task):
    result = command("run", task)
    assert (result.code, result.err) == (0, "")
    words = {line.split("  ")[0].strip(): line for line in result.out.splitlines()}
    assert "reached the target (converged): " in words["verdict"]
    assert "as planned" in words["duration"]
    assert "straight" in words["keyframes"]
    assert {"speed", "point errors"} <= set(words) and "jerk" not in words
    assert [path.name for path in task.parent.iterdir()] == ["bow.toml"]


def test_a_program_reads_one_json_object_of_finite_numbers(command, task, tmp_path):
    result = command("run", task, "--json", "-o", tmp_path / "out")
    data = json.loads(result.out)
    assert (data["task"], data["status"], data["converged"]) == (str(task), "converged", True)
    assert [place["name"] for place in data["keyframes"]] == ["straight", "bowed"]
    assert data["planned"] == pytest.approx(1.0)
    assert data["time_scale"] == pytest.approx(1.0)
    assert all(isinstance(leaf, FINITE) for leaf in leaves(data))
    assert all(np.isfinite(leaf) for leaf in leaves(data) if isinstance(leaf, int | float))
    assert data["files"] == {
        kind: str(tmp_path / "out" / f"motion.{kind}") for kind in ("npz", "csv", "json")
    }


def test_what_is_kept_is_what_the_file_asks_for_and_loads(command, task, tmp_path):
    out = tmp_path / "out"
    result = command("run", task, "-o", out)
    assert sorted(path.name for path in out.iterdir()) == [
        "motion.csv",
        "motion.json",
        "motion.npz",
        "status.json",
    ]
    assert sorted(result.err.splitlines()) == [
        f"wrote {out / f'motion.{kind}'}" for kind in ("csv", "json", "npz")
    ]
    motion = pp.load(out / "motion.npz", pp.Trajectory)
    expected = pp.Task.load(task).perform()
    np.testing.assert_array_equal(motion.q, expected.q)
    np.testing.assert_array_equal(motion.plan_time, expected.plan_time)
    for kind in ("csv", "json"):
        rows = (
            pp.load(out / f"motion.{kind}", pp.JointTrajectory).matched(motion.arm).configurations(motion.arm)
        )
        np.testing.assert_allclose(rows[1:-1], motion.q, atol=1e-12)
    status = json.loads((out / "status.json").read_text())
    assert (status["state"], sorted(status["files"])) == (
        "finished",
        ["motion.csv", "motion.json", "motion.npz"],
    )


@pytest.mark.usefixtures("no_pictures")
def test_without_a_list_every_format_is_kept(command, task, tmp_path):
    task.write_text(TASK[: TASK.index("[output]")])
    command("run", task, "-o", tmp_path / "out")
    kinds = {path.suffix for path in (tmp_path / "out").iterdir() if path.name != "status.json"}
    assert kinds == {".npz", ".csv", ".json", ".png", ".html"}


@pytest.mark.long
def test_a_check_tells_that_the_arm_comes_out_whichever_joint_sticks(command, task):
    data = json.loads(command("run", task, "--check", "--retreat", "1", "--json").out)
    assert data["retreat"] == {"failure": "stuck", "examined": 1, "first_blocked": None}


def test_a_check_names_the_first_posture_from_which_the_arm_cannot_come_out(command, task, monkeypatch):
    torques = []

    def blocked(arm, q, scene, failed, *, torque, postures, **_):
        torques.append(torque)
        assert failed == list(arm.joint_names) and postures == [len(q) // 2, len(q) - 1]
        free = pp.Retreat(postures[1], "a", 0.1, "a way", "")
        return pp.Retreats(
            (free, pp.Retreat(postures[1], "b", 0.25, None, "link to wall: overlapping by 1 mm"))
        )

    monkeypatch.setattr("pinposture.task.can_retreat", blocked)
    told = command("run", task, "--check", "--retreat", "2").out
    words = "not at 1 s if one of these is stuck: b at 0.25; link to wall: overlapping by 1 mm"
    assert f"comes out  {words}" in told
    told = command("run", task, "--check", "--retreat", "2", "--failure", "limp").out
    assert "not at 1 s if one of these is limp: b at 0.25; " in told
    told = command("run", task, "--check", "--retreat", "2", "--failure", "weak").out
    assert "not at 1 s if one of these is weak: b at 0.25; " in told
    arm = pp.Task.load(task).arm
    loads = dict(zip(arm.joint_names, arm.outstretched_torques, strict=True))
    assert torques == [
        None,
        dict.fromkeys(arm.joint_names, 0.0),
        {name: 0.3 * load for name, load in loads.items()},
    ]
    found = json.loads(command("run", task, "--check", "--retreat", "2", "--json").out)["retreat"]
    assert found["first_blocked"]["joints"] == {"b": 0.25}
    for flags in (("--retreat", "1"), ("--check", "--retreat", "0"), ("--check", "--failure", "limp")):
        refused = command("run", task, *flags)
        assert refused.code == 2 and "--retreat" in refused.err
    refused = command("run", task, "--check", "--retreat", "1", "--failure", "hot")
    assert refused.code == 2 and "no kind of failure is called 'hot'" in refused.err


def test_the_next_run_says_what_is_there(command, task, tmp_path):
    out = tmp_path / "out"
    command("run", task, "-o", out)
    task.write_text(TASK.replace('"csv", "json"', '"csv"'))
    said = command("run", task, "-o", out).err.splitlines()[0]
    assert said.startswith(f"{out} holds the results of {task}, finished ")
    assert sorted(path.name for path in out.iterdir()) == ["motion.csv", "motion.npz", "status.json"]


def test_postures_that_cannot_be_held_are_named_by_a_check_and_refused(command, task):
    task.write_text(TASK.replace('cycle = "50 ms"', 'cycle = "50 ms"\neffort = "0.05 N m"'))
    result = command("run", task, "--check")
    assert result.code == 1
    model = pp.Arm.from_template("RyRz", modules=4).model
    needed = abs(pin.computeGeneralizedGravity(model, model.createData(), pin.neutral(model))[0])
    assert f"straight: joint 'm01_j1_y' needs {needed:.4g} of 0.05 N m to hold the arm" in result.err
    held = json.loads(command("run", task, "--check", "--json").out)["keyframes"][0]["overload"]
    assert held["joint"] == "m01_j1_y" and held["share"] == pytest.approx(held["needed"] / 0.05)
    refused = command("run", task)
    assert refused.code == 2 and "line 8: keyframe 1 'straight' is" in refused.err


def test_a_check_moves_and_writes_nothing(command, task, tmp_path, monkeypatch):
    monkeypatch.setattr("pinposture.task.task.perform", None)
    result = command("run", task, "--check", "-o", tmp_path / "out")
    assert (result.code, result.err) == (0, "")
    assert re.search(r"^ straight .*\n bowed ", result.out, re.MULTILINE)
    assert "1 s" in result.out
    data = json.loads(command("run", task, "--check", "--json").out)
    assert data == {
        "task": str(task),
        "keyframes": [
            {
                "name": name,
                "planned": when,
                "off_curve": ANY,
                "tip_off": None,
                "clearance": pytest.approx(room, abs=2e-3),
                "pair": ANY,
                "moved": {"translation": pytest.approx(way), "rotation": ANY},
                "overload": None,
            }
            # A helix begins beside its axis, this one at (0, 0, 0.1); it is taken from the base.
            # Every other link is 25 mm away, of a radius of 5 mm, at an angle where the arm is bent.
            for name, when, way, room in (
                ("straight", 0.0, [0.0, 0.0, 0.0], 0.015),
                ("bowed", pytest.approx(1.0), [0.0, 0.0, -0.1], 0.013),
            )
        ],
        "planned": pytest.approx(1.0),
    }
    assert [path.name for path in tmp_path.iterdir()] == ["bow.toml"]


@pytest.mark.parametrize("flags", [(), ("--check",), ("--json",)])
def test_what_the_arm_cannot_do_is_one_line_with_code_2(command, task, tmp_path, flags):
    task.write_text(TASK.replace("turns = 0.5", "turns = 0.2"))
    result = command("run", task, "-o", tmp_path / "out", *flags)
    line = TASK[: TASK.index('[[keyframes]]\nname = "bowed"')].count("\n") + 1
    assert (result.code, result.out) == (2, "")
    assert result.err.startswith(f"error: {task}: line {line}: keyframe 2 'bowed': module ")
    assert result.err.count("\n") == 1


def test_a_curve_longer_than_the_arm_is_noted_unless_it_may_be_trimmed(command, task):
    task.write_text(TASK.replace("trim = true\n", ""))
    said = command("run", task)
    assert (said.code, said.err.count("\n")) == (0, 1)
    assert said.err.startswith("note: keyframe 2 'bowed': the arm takes the first 202 mm")
    left = float(re.search(r"largest distance from its curve (\S+) mm, curve moved", said.out)[1])
    assert 1e-3 * left == pytest.approx(
        0.2 * np.sin((np.pi - 2.0) / 2.0), rel=0.05
    )  # chord to the end of the arc
    task.write_text(TASK)
    trimmed = command("run", task)
    assert (trimmed.code, trimmed.err) == (0, "")
    assert re.search(
        "largest distance from its curve (below rounding|below 0.0001 mm), curve moved", trimmed.out
    )


def test_a_task_that_failed_is_written_down(command, task, tmp_path):
    task.write_text(TASK.replace("turns = 0.5", "turns = 0.2"))
    command("run", task, "-o", tmp_path / "out")
    status = json.loads((tmp_path / "out" / "status.json").read_text())
    assert status["state"] == "failed"
    assert "keyframe 2 'bowed'" in status["reason"]
    task.write_text(TASK)
    said = command("run", task, "-o", tmp_path / "out").err.splitlines()[0]
    assert "that failed (" in said
    assert "it left no result" in said


@pytest.mark.parametrize("earlier", [False, True])
def test_after_a_failed_run_no_command_uses_the_directory(command, task, tmp_path, earlier):
    out = tmp_path / "out"
    if earlier:
        assert command("run", task, "-o", out).code == 0
    task.write_text(TASK.replace("turns = 0.5", "turns = 0.2"))
    assert command("run", task, "-o", out).code == 2
    for verb in (
        ("export", out, "-o", tmp_path / "joints.csv"),
        ("simulate", out),
        ("view", out, "-o", tmp_path / "motion.png"),
    ):
        code, printed, said = command(*verb)
        assert (code, printed) == (2, "")
        assert f"{out}: the run of {task} failed: " in said
        assert "keyframe 2 'bowed'" in said and "run it again" in said
        assert (f"or name {out / 'motion.npz'}, of an earlier run" in said) == earlier
    assert not (tmp_path / "joints.csv").exists()
    if earlier:  # by its own name the earlier motion is asked for, not mistaken for the new one
        assert command("export", out / "motion.npz", "-o", tmp_path / "joints.csv").code == 0
        (out / "motion.npz").touch()  # as if written since the failure
        assert command("export", out, "-o", tmp_path / "joints.csv").code == 0


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (("modules", "module"), ("line 4: arm.module: there is no such key (did you mean 'modules'?)",)),
        (('"50 ms"', '"50 mm"'), ("line 6: limits.cycle: is '50 mm', of the kind length",)),
        (("[arm]", "[arm"), ("line 2, column ",)),
        ((TASK, ""), ("arm: needs one of the keys",)),
    ],
)
def test_a_mistake_in_the_file_is_one_line_with_code_2(command, task, tmp_path, change, says):
    task.write_text(TASK.replace(*change))
    result = command("run", task, "-o", tmp_path / "out")
    assert (result.code, result.out) == (2, "")
    assert result.err.startswith(f"error: {task}: ")
    assert result.err.count("\n") == 1
    assert all(words in result.err for words in says)
    assert not (tmp_path / "out").exists()


def test_files_that_are_none(command, tmp_path):
    for name in ("none.toml", "none.json", "none.yaml", "."):
        result = command("run", tmp_path / name)
        assert (result.code, result.out, result.err.count("\n")) == (2, "", 1)
    assert "TASK" in command("run").err


@pytest.mark.parametrize("where", ["file", "file/below", "status"])
def test_an_output_that_cannot_be_is_refused_before_any_work(command, task, tmp_path, monkeypatch, where):
    (tmp_path / "file").touch()
    (tmp_path / "status" / "status.json").mkdir(parents=True)
    monkeypatch.setattr("pinposture.task.Task.reference", None)
    result = command("run", task, "-o", tmp_path / where)
    assert result.code == 2
    assert ("a directory" in result.err) and result.err.count("\n") == 1


def test_a_directory_that_may_not_be_written_is_refused_before_any_work(command, task, tmp_path, monkeypatch):
    monkeypatch.setattr("pinposture.task.Task.reference", None)
    monkeypatch.setattr("os.access", lambda path, mode: mode != os.W_OK)
    result = command("run", task, "-o", tmp_path / "out")
    assert result.code == 2
    assert "permission denied" in result.err


def test_a_motion_that_does_not_get_there_ends_with_code_1_and_is_kept_for_no_robot(command, task, tmp_path):
    out = tmp_path / "out"
    assert command("run", task, "-o", out).code == 0
    assert all((out / name).exists() for name in KEPT)
    # The straight arm is singular, and this controller has no way out of that.
    task.write_text(TASK.replace("[limits]", '[controller]\nname = "selection"\n[limits]'))
    result = command("run", task, "--json", "-o", out)
    data = json.loads(result.out)
    assert (result.code, data["converged"]) == (1, False)
    assert data["verdict"] == f"did not reach the target ({data['status']}): {data['reason']}"
    # What the run before left for a robot is gone, too.
    assert sorted(path.name for path in out.iterdir()) == ["motion.npz", "status.json"]
    assert "note: no motion.csv and motion.json for a robot: it " in result.err
    assert f"pinposture export {out} --force" in result.err
    assert command("export", out, "-o", tmp_path / "joints.csv").code == 2
    assert command("export", out, "--force", "-o", tmp_path / "joints.csv").code == 0


def test_a_keyframe_that_is_missed_is_a_fault(command, task, tmp_path):
    limits = '[limits]\nacceleration = "6 rad/s^2"\njerk = "50 rad/s^3"\nposition_margin = "3 rad"'
    back = '[[keyframes]]\ntime = "2 s"\njoints = [0, 0, 0, 0, 0, 0, 0, 0]\n[output]'
    task.write_text(TASK.replace("[limits]", limits).replace("[output]", back))
    result = command("run", task, "-o", tmp_path / "out")
    words = {line.split("  ")[0].strip(): line for line in result.out.splitlines()}
    assert result.code == 1
    assert "did not reach the target (missed): 1 of 3 postures is missed, bowed, by" in words["verdict"]
    assert re.search(r"bowed +planned +1 s, missed +[0-9.]+ s, mean error", result.out)
    assert re.search(r"keyframe 3 +planned +2 s, passed", result.out)
    assert "no motion.csv and motion.json for a robot: it missed a target: 1 of 3" in result.err
    data = json.loads(command("run", task, "--json").out)
    assert (data["status"], data["converged"], len(data["faults"])) == ("missed", False, 1)
    assert [place["missed"] for place in data["keyframes"]] == [False, True, False]
    # The largest jerk, from the configurations alone.
    q = np.concatenate([np.zeros((3, 8)), pp.load(tmp_path / "out" / "motion.npz").q, np.zeros((3, 8))])
    assert data["largest_jerk"] == pytest.approx(np.abs(np.diff(q, 3, axis=0)).max() / 0.05**3 / 50.0)
    assert f"at most {100 * data['largest_jerk']:.4g} % of the limit" in words["jerk"]


def test_a_view_comes_last(command, task, monkeypatch):
    shown = []
    monkeypatch.setattr("pinposture.cli.run.show", lambda motion, *_: shown.append(motion))
    assert command("run", task, "--view").code == 0
    assert [type(motion) for motion in shown] == [pp.Trajectory]


def test_notes_on_the_arm_are_told(command, task, tmp_path):
    arm = pp.Arm.from_template("RyRz", modules=6)
    write_text(tmp_path / "arm.urdf", arm.urdf)
    text = TASK.replace('template = "RyRz"\nmodules = 4', 'urdf = "arm.urdf"\nbase = "m02_l2"\ntip = "tip"')
    task.write_text(text)
    result = command("run", task, "--check")
    assert result.code == 0
    assert "note: 4 joints off the chain" in result.err


def test_a_check_of_a_posture_inside_something_ends_with_code_1(command, task):
    arc = 'curve = { type = "helix", radius = "10 cm", pitch = 0, turns = 0.5 }\ntrim = true'
    text = TASK.replace(arc, 'curve = { type = "line", a = [0, 0, 0], b = [0, 0, 0.2] }')
    text += '[scene.obstacles.ball]\ntype = "sphere"\ncenter = [0.1, 0, 0]\nradius = 0.03\n'
    task.write_text(text)
    result = command("run", task, "--check")
    assert result.code == 1
    assert re.search(r"straight: m0\d_\w+ and ball would penetrate by [\d.]+ mm", result.err)


def test_a_check_names_postures_closer_than_the_margin(command, task):
    """The straight arm, of a radius of 5 mm, is 25 mm from the ball."""
    ball = '[scene.obstacles.ball]\ntype = "sphere"\ncenter = [0.1, 0, 0.05]\nradius = 0.02\n'
    for margin, said in ((0.001, False), (0.05, True)):
        text = TASK.replace("trim = true", 'trim = true\nplacement = "align"')
        task.write_text(f"{text}[scene]\nmargin = {margin}\n{ball}")
        result = command("run", task, "--check")
        assert result.code == 0
        assert re.search(r"straight .* m0\d_\w+ to ball +where it was drawn", result.out)
        assert ("and ball would be" in result.err and "the margin is 50 mm" in result.err) == said
    result = command("run", task)
    assert re.search(r"keyframe \d 'straight': m0\d_\w+ and ball would be [\d.]+ mm apart", result.err)


def test_values_of_the_file_are_set_from_the_command_line(command, task):
    plain = json.loads(command("run", task, "--json").out)
    held = json.loads(command("run", task, "--json", "--set", "keyframes.2.hold=500 ms").out)
    assert held["duration"] == pytest.approx(plain["duration"] + 0.5, abs=0.051)
    slow = json.loads(command("run", task, "--json", "--set", "limits.cycle=0.1", "--set", 'name="b"').out)
    assert slow["steps"] < plain["steps"]
    assert task.read_text() == TASK


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ("limits.velocity=-1", "limits.velocity: is -1; allowed: a positive number"),
        ("limits.velocty=1", "limits.velocty: there is no such key (did you mean 'velocity'?)"),
        ("keyframes.9.hold=1", "there is no 'keyframes.9.hold' to change"),
        ("limits.cycle.x=1", "there is no 'limits.cycle.x' to change"),
        ("limits.cycle=", "--set is 'limits.cycle='; allowed: KEY=VALUE"),
        ("limits", "--set is 'limits'; allowed: KEY=VALUE"),
        ("..=1", "there is no '..' to change"),
        (f"limits.cycle={'9' * 5000}", "limits.cycle: is"),
    ],
)
def test_a_value_that_cannot_be_set_is_one_line_with_code_2(command, task, given, says):
    result = command("run", task, "--set", given)
    assert (result.code, result.out) == (2, "")
    assert says in result.err
    assert result.err.count("\n") == 1
    assert "line " not in result.err
