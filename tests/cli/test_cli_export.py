"""`pinposture export`: a run in time, in the format of the file's name; one line for what cannot be."""

from __future__ import annotations

import csv
import dataclasses
import json
import shutil
from pathlib import Path

import numpy as np
import pytest

import pinposture as pp
from pinposture.motion.joint_trajectory import JointTrajectory
from pinposture.motion.trajectory import Trajectory

STEPS = 11


@pytest.fixture(scope="module")
def timed_run(run_directory: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of `STEPS` steps of 0.02 s, with a limit of speed, that gets there."""
    arm = pp.load(run_directory / "run.npz", pp.Run).arm
    target = pp.Target.from_configuration(arm, np.full(arm.nv, 0.17))
    limits = pp.Limits(step=None, velocity=1.5, dt=0.02)
    run = pp.track(arm, target, arm.neutral(), limits=limits)
    assert (run.status, run.steps) == ("converged", STEPS)
    return pp.save(run, tmp_path_factory.mktemp("timed") / "run.npz")


@pytest.mark.parametrize("suffix", ["npz", "csv", "json"])
@pytest.mark.parametrize("name", [".", "run.npz"])
def test_a_run_is_written_in_the_format_of_the_name(command, run_directory, tmp_path, name, suffix) -> None:
    file = tmp_path / "new" / f"motion.{suffix}"
    result = command("export", run_directory / name, "--dt", 0.05, "--force", "-o", file)
    assert result.code == 0
    assert result.err.splitlines()[2:] == [f"wrote {file}"]
    assert "12 joints, 21 points, 1 s" in result.out
    run = pp.load(run_directory / "run.npz", pp.Run)
    found = pp.load(file, JointTrajectory).matched(run.arm)
    np.testing.assert_array_equal(found.configurations(run.arm), run.q)
    np.testing.assert_allclose(found.time, 0.05 * np.arange(21), atol=1e-9)


def test_the_duration_of_the_limits_needs_no_telling(command, timed_run, tmp_path) -> None:
    file = tmp_path / "motion.csv"
    assert command("export", timed_run, "-o", file).code == 0
    assert command("export", timed_run, "--dt", 0.02, "-o", tmp_path / "same.csv").code == 0
    assert file.read_bytes() == (tmp_path / "same.csv").read_bytes()
    with file.open(newline="") as lines:
        times = [row["time [s]"] for row in csv.DictReader(lines)]
    assert [float(time) for time in times] == [0.02 * k for k in range(STEPS + 1)]


def test_the_summary_tells_what_the_motion_asks_of_the_joints(command, timed_run, tmp_path) -> None:
    file = tmp_path / "motion.json"
    result = command("export", timed_run, "-o", file, "--json")
    summary = json.loads(result.out)
    run = pp.load(timed_run, pp.Run)
    steps = np.diff(run.q, axis=0)
    changes = np.diff(np.pad(steps, ((1, 1), (0, 0))), axis=0)
    assert summary.pop("largest_speed") == {"rad/s": pytest.approx(np.abs(steps).max() / 0.02)}
    assert summary.pop("largest_acceleration") == {"rad/s^2": pytest.approx(np.abs(changes).max() / 0.02**2)}
    assert summary.pop("duration") == pytest.approx(0.02 * STEPS)
    assert summary.pop("verdict").startswith("reached the target (converged): ")
    assert summary == {
        "run": str(timed_run),
        "kind": "joint trajectory",
        "faults": [],
        "robot": "RyRz_6",
        "joints": list(run.arm.joint_names),
        "units": ["rad"] * 12,
        "points": STEPS + 1,
        "file": str(file),
    }
    warning, written = result.err.splitlines()
    assert written == f"wrote {file}"
    reached = np.abs(changes).max() / 0.02**2
    assert f"no acceleration limit: joints accelerate by at most {reached:.4g} rad/s²; plan again" in warning
    assert "--dt 0.02 --acceleration A" in warning


def test_a_run_with_an_acceleration_limit_is_written_without_a_warning(command, timed_run, tmp_path) -> None:
    run = pp.load(timed_run, pp.Run)
    limits = pp.Limits(step=None, velocity=1.5, dt=0.02, acceleration=80.0)
    pp.save(dataclasses.replace(run, limits=limits), tmp_path / "run.npz")
    assert command("export", tmp_path, "-o", tmp_path / "a.csv").err == f"wrote {tmp_path / 'a.csv'}\n"


def test_of_a_motion_and_a_run_in_one_directory_the_motion_is_taken(
    command, timed_run, run_directory, tmp_path
) -> None:
    run = pp.load(timed_run, pp.Run)
    rows, m = run.point_errors.shape
    there = np.tile(run.target.points, (rows, 1, 1))
    motion = Trajectory(run, there, np.ones((rows, m), dtype=bool), 0.02 * np.arange(rows), 0, 0.22)
    shutil.copy(run_directory / "run.npz", tmp_path)
    # A file of that name that holds something else does not count.
    pp.save(run.joint_trajectory(), tmp_path / "motion.npz")
    asked = ("export", tmp_path, "--dt", 0.02, "-o", tmp_path / "a.csv", "--json", "--force")
    assert json.loads(command(*asked).out)["points"] == 21
    pp.save(motion, tmp_path / "motion.npz")
    assert json.loads(command(*asked).out)["points"] == STEPS + 3  # it stands still before and after
    assert command("export", tmp_path / "motion.npz", "-o", tmp_path / "b.csv").code == 0
    assert (tmp_path / "a.csv").read_bytes() == (tmp_path / "b.csv").read_bytes()
    refused = command("export", tmp_path, "--dt", 0.05, "-o", tmp_path / "c.csv")
    assert (refused.code, "dt is 0.05; allowed: 0.02 s" in refused.err) == (2, True)


def test_a_run_that_exceeds_a_limit_is_written_only_by_force(command, timed_run, tmp_path) -> None:
    run = pp.load(timed_run, pp.Run)
    limits = pp.Limits(dt=0.02, acceleration=1.0)  # tighter than what it was made with
    pp.save(dataclasses.replace(run, limits=limits), tmp_path / "run.npz")
    asked = ("export", tmp_path, "-o", tmp_path / "a.csv")
    refused = command(*asked)
    assert (refused.code, (tmp_path / "a.csv").exists()) == (2, False)
    assert "the motion should not be sent to a robot: limits are exceeded in " in refused.err
    forced = command(*asked, "--force")
    assert forced.code == 0 and "exported despite a fault: limits are exceeded in " in forced.err
    assert (tmp_path / "a.csv").exists()


def test_an_old_file_is_replaced(command, timed_run, tmp_path) -> None:
    file = tmp_path / "motion.json"
    file.write_text("old")
    assert command("export", timed_run, "-o", file).code == 0
    assert len(json.loads(file.read_text())["points"]) == STEPS + 1


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("-o", "motion.json"), "dt is not given; allowed: the duration of a step"),
        (("-o", "motion.json", "--dt", "0"), "dt is 0.0"),
        (("-o", "motion.json", "--dt", "nan"), "dt is nan"),
        (
            ("-o", "motion.json", "--dt", "x"),
            "--dt is 'x'; allowed: a number in SI units",
        ),
        (("-o", "motion.txt", "--dt", "0.1"), "allowed: .npz, .csv, .json, .yaml, .yml, .mcap"),
        (("-o", "motion", "--dt", "0.1"), "allowed: .npz, .csv, .json, .yaml, .yml, .mcap"),
        (("-o", "motion.json", "--dt", "1e9", "--force"), "in a ROS 2 message"),
        (("-o", "motion.json", "--dt", "0.1"), "should not be sent to a robot: it ran out of steps: "),
        (("--dt", "0.1"), "-o"),
    ],
)
def test_what_cannot_be_written_is_said_in_one_line(
    command, run_directory, tmp_path, monkeypatch, options, words
) -> None:
    monkeypatch.chdir(tmp_path)
    result = command("export", run_directory, *options)
    assert (result.code, result.out) == (2, "")
    assert result.err.startswith("error: ")
    assert result.err.count("\n") == 1
    assert words in result.err
    assert list(tmp_path.iterdir()) == []


def test_a_duration_that_contradicts_the_run_is_refused(command, timed_run, tmp_path) -> None:
    result = command("export", timed_run, "--dt", 0.03, "-o", tmp_path / "a.csv")
    assert (result.code, list(tmp_path.iterdir())) == (2, [])
    assert "dt is 0.03; allowed: 0.02 s, from the limits of this run, or None" in result.err


@pytest.mark.parametrize("content", [None, b"", b"not a run", b"PK\x03\x04"])
def test_what_is_no_run_is_refused(command, tmp_path, content) -> None:
    source = tmp_path / "run.npz"
    if content is not None:
        source.write_bytes(content)
    result = command("export", tmp_path, "--dt", 0.1, "-o", tmp_path / "new" / "a.csv")
    assert result.code == 2
    assert result.err.startswith(f"error: {source}: ")
    assert not (tmp_path / "new").exists()


def test_a_run_is_not_overwritten_with_its_own_export(command, run_directory, tmp_path) -> None:
    source = Path(shutil.copy(run_directory / "run.npz", tmp_path / "run.npz"))
    before = source.read_bytes()
    result = command("export", tmp_path, "--dt", 0.1, "-o", source)
    assert (result.code, source.read_bytes() == before) == (2, True)
    assert "is the input" in result.err


@pytest.mark.long
def test_goals_and_bags_are_written_by_their_format(command, timed_run, tmp_path) -> None:
    pytest.importorskip("rosbags")
    goal = tmp_path / "goal.json"
    bag = tmp_path / "motion.mcap"
    folder = tmp_path / "bag"
    form = ("--format", "follow-joint-trajectory")
    assert command("export", timed_run, *form, "-o", goal).code == 0
    assert json.loads(goal.read_text()).keys() == {"trajectory", "goal_time_tolerance"}
    assert command("export", timed_run, "-o", bag).code == 0
    assert bag.read_bytes().startswith(b"\x89MCAP0")
    assert command("export", timed_run, "--format", "rosbag", "-o", folder).code == 0
    assert {each.name for each in folder.iterdir()} == {"bag.mcap", "metadata.yaml"}
    for refused, words in (
        (("--format", "rosbags", "-o", tmp_path / "b"), "did you mean 'rosbag'?"),
        ((*form, "-o", tmp_path / "goal.csv"), "the name ends in '.csv'; allowed: .json"),
        (("--format", "rosbag", "-o", folder), "exists already"),
    ):
        result = command("export", timed_run, *refused)
        assert result.code == 2
        assert words in result.err


def test_a_motion_starts_at_the_turns_at_which_the_robot_stands(command, tmp_path) -> None:
    arm = pp.Arm.load(pp.Arm.from_template("RyRz", 2).urdf.replace('"revolute"', '"continuous"'))
    q = [arm.configuration([3.0 + 0.1 * k, 0.0, 0.1 * k, 0.0]) for k in range(4)]
    limits = pp.Limits(step=None, dt=0.1, velocity=2.0)
    run = pp.track(arm, pp.Target.from_configuration(arm, q[-1]), q[0], limits=limits)
    file = pp.save(run, tmp_path / "run.npz")
    assert command("export", file, "-o", tmp_path / "plain.csv").code == 0
    plain = pp.load(tmp_path / "plain.csv")
    robot = plain.positions[0] + 2.0 * np.pi * np.array([1.0, 0.0, -2.0, 0.0]) + 0.01
    given = ",".join(map(str, robot))
    assert command("export", file, "-o", tmp_path / "turned.csv", f"--start={given}").code == 0
    turned = pp.load(tmp_path / "turned.csv")
    expected = plain.positions + 2.0 * np.pi * np.array([1.0, 0.0, -2.0, 0.0])
    np.testing.assert_allclose(turned.positions, expected, atol=1e-9)
    np.testing.assert_array_equal(turned.velocities, plain.velocities)
    for wrong, words in (("3,0,3,0", "move there first"), ("1,2", "shape"), ("a", "--start")):
        result = command("export", file, "-o", tmp_path / "wrong.csv", f"--start={wrong}")
        assert result.code == 2
        assert words in result.err


def test_commands_against_sag_are_written_for_an_arm_with_a_stiffness(command, timed_run, tmp_path) -> None:
    run = pp.load(timed_run, pp.Run)
    arm = run.arm.with_stiffness(60.0)
    limits = pp.Limits(step=None, velocity=1.0, acceleration=5.0, dt=0.02)
    elastic = pp.track(
        arm, pp.Target.from_configuration(arm, np.full(arm.nv, 0.17)), arm.neutral(), limits=limits
    )
    saved = pp.save(elastic, tmp_path / "run.npz")
    file = tmp_path / "joints.npz"
    assert command("export", saved, "--compensate", "--force", "-o", file).code == 0
    sent = pp.load(file, JointTrajectory)
    np.testing.assert_allclose(arm.sag(sent.positions), elastic.q, atol=1e-9)
    refused = command("export", timed_run, "--compensate", "-o", file)
    assert refused.code == 2
    assert "the stiffnesses of joints" in refused.err
