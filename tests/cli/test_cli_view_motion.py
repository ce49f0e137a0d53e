"""Motions in time on the command line: looked at, kept, and summed up."""

from __future__ import annotations

import json
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from viz.motions import five_modules, some_motion

import pinposture as pp
from pinposture.cli.output import find_kept, load_kept, motion_files, write_files
from pinposture.errors import FileError
from pinposture.motion.trajectory import Trajectory, WaypointResult
from pinposture.motion.words import in_words
from pinposture.storage import RESULT_FORMATS


def around_a_ball() -> pp.Scene:
    return pp.Scene({"ball": pp.Sphere((0.1, 0.3, 0.2), 0.05)}, margin=0.01)


@pytest.fixture(scope="module")
def both(tmp_path_factory) -> Path:
    """A directory with a motion, and a run that is newer."""
    path = tmp_path_factory.mktemp("both")
    motion = some_motion()
    pp.save(motion, path / "motion.npz")
    pp.save(motion.run, path / "run.npz")
    touch(path / "motion.npz", 1000)
    touch(path / "run.npz", 2000)
    return path


def touch(path: Path, when: int) -> None:
    os.utime(path, (when, when))


@pytest.mark.parametrize("newer", ["motion.npz", "run.npz"])
def test_of_a_directory_with_both_the_newer_one_is_taken_and_named(both, newer):
    touch(both / newer, 3000)
    touch(both / ("run.npz" if newer == "motion.npz" else "motion.npz"), 2000)
    file, chosen = find_kept(both)
    assert file == both / newer
    assert chosen.startswith(newer)
    assert isinstance(load_kept(file), Trajectory if newer == "motion.npz" else pp.Run)


def test_one_file_alone_needs_no_words(tmp_path):
    pp.save(some_motion(), tmp_path / "motion.npz")
    assert find_kept(tmp_path) == (tmp_path / "motion.npz", "")
    assert find_kept(tmp_path / "motion.npz") == (tmp_path / "motion.npz", "")


def test_joints_that_were_exported_as_motion_npz_are_no_motion(tmp_path):
    motion = some_motion()
    pp.save(motion.joint_trajectory(), tmp_path / "motion.npz")
    with pytest.raises(FileError, match=r"no such file, and no motion\.npz"):
        find_kept(tmp_path)
    pp.save(motion.run, tmp_path / "run.npz")
    assert find_kept(tmp_path) == (tmp_path / "run.npz", "")


@pytest.mark.long
def test_the_command_writes_pictures_of_a_motion(command, both, tmp_path):
    touch(both / "motion.npz", 4000)
    html = tmp_path / "a.html"
    png = tmp_path / "a.png"
    chosen = "taken: motion.npz, which is newer than run.npz\n"
    assert command("view", both, "-o", html, "--ellipsoids", "2,5") == (0, "", f"{chosen}wrote {html}\n")
    assert command("view", both, "-o", png) == (0, "", f"{chosen}wrote {png}\n")
    page = html.read_text(encoding="utf-8")
    assert "shown in real time" in page
    assert "ellipsoids, 1 m/rad" in page
    assert png.read_bytes().startswith(b"\x89PNG\r\n")


def test_the_command_plays_a_motion_until_ctrl_c(command, both, monkeypatch):
    shown = []

    class Viewer:
        url = "http://127.0.0.1:7000/static/"

        def play(self):
            shown.append("play")

        def close(self):
            shown.append("close")

    def view(arm, motion, **options):
        shown.append((type(motion), options["open_browser"], options["ellipsoids"]))
        return Viewer()

    def wait():
        raise KeyboardInterrupt

    monkeypatch.setattr("pinposture.viz.view", view)
    monkeypatch.setattr("pinposture.cli.view.wait", wait)
    result = command("view", both / "motion.npz", "--no-browser", "--ellipsoids", "5")
    assert (result.code, result.out) == (0, f"{Viewer.url}\n")
    assert shown == [(Trajectory, False, (4,)), "play", "close"]


@pytest.mark.long
def test_a_motion_is_kept_in_every_format_that_is_asked_for(tmp_path):
    motion = some_motion()
    files, failure = write_files(motion_files(motion, tmp_path / "out"))
    assert failure is None
    assert set(files) == set(RESULT_FORMATS)
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == sorted(
        f"motion.{kind}" for kind in RESULT_FORMATS
    )
    assert list(files)[-1] == "npz"
    np.testing.assert_array_equal(pp.load(files["npz"], Trajectory).q, motion.q)
    message = json.loads(Path(files["json"]).read_text(encoding="utf-8"))
    # It stands still for a cycle before and after.
    assert len(message["points"]) == motion.steps + 3
    assert message["joint_names"] == list(five_modules().joint_names)
    assert "<html" in Path(files["html"]).read_text(encoding="utf-8").lower()
    assert Path(files["png"]).read_bytes().startswith(b"\x89PNG\r\n")
    table = pp.load(files["csv"], pp.JointTrajectory)
    np.testing.assert_allclose(table.positions[1:-1], motion.q, atol=1e-9)


def test_formats_that_are_not_asked_for_are_not_written(tmp_path):
    files, _ = write_files(motion_files(some_motion(), tmp_path, ("npz", "csv")))
    assert list(files) == ["csv", "npz"]
    assert {path.name for path in tmp_path.iterdir()} == {"motion.csv", "motion.npz"}
    assert motion_files(some_motion(), tmp_path / "none", ()) == []


def test_a_summary_holds_the_numbers_of_the_motion_from_setting_out_on():
    motion = some_motion(planned=1.25, start_index=10, scene=around_a_ball())
    run = motion.run
    errors = run.point_errors.copy()
    errors[3] = 9.0  # on the way to the first posture, which is not the plan
    errors[40] = 0.01
    motion = replace(motion, run=replace(run, point_errors=errors), deviations=("at 1 s it went round",))
    summary = motion.summary()
    json.dumps(summary, allow_nan=False)
    assert (summary["status"], summary["converged"], summary["steps"]) == ("converged", True, 60)
    assert [
        summary[name] for name in ("time", "start_index", "planned", "duration", "time_scale")
    ] == pytest.approx([3.0, 0.5, 1.25, 2.5, 2.0])
    rates = np.diff(motion.q, axis=0) / 0.05
    changes = np.diff(np.vstack([0 * rates[:1], rates, 0 * rates[:1]]), axis=0) / 0.05
    assert summary["largest_speed"] == pytest.approx(np.abs(rates).max() / 2.0)
    assert summary["largest_acceleration"] == pytest.approx(np.abs(changes).max() / 30.0)
    assert (summary["worst_posture_error"], summary["worst_at"]) == pytest.approx((0.05, 2.0))
    assert summary["mean_posture_error"] == pytest.approx((50 * 0.005 + 0.05) / 51)
    assert summary["worst_mean_error"] == pytest.approx(0.01)
    assert summary["mean_error"] == pytest.approx((50 * 0.001 + 0.01) / 51)
    assert [place["name"] for place in summary["keyframes"]] == ["straight", "S", "coil"]
    assert summary["keyframes"][2] == {
        "name": "coil",
        "planned": 1.25,
        "reached": pytest.approx(2.5),
        "mean_error": 1e-3,
        "off_curve": None,
        "tip_off": None,
        "moved": None,
        "speed": 1.0,
        "missed": False,
        "too_heavy": None,
    }
    closest = pp.CollisionModel(five_modules(), around_a_ball()).minimum(motion.q[run.clearance.argmin()])
    assert summary["clearance"]["smallest"] == pytest.approx(closest.distance)
    assert summary["deviations"] == ["at 1 s it went round"]


def test_a_summary_in_words_tells_what_a_person_asks_for():
    motion = some_motion(planned=1.25, start_index=10, scene=around_a_ball())
    passed = (*motion.waypoints, WaypointResult("late", 1.25, None, None, None))
    motion = replace(motion, waypoints=passed, deviations=("at 1 s it went round", "and again"))
    words = in_words(motion.summary())
    assert words["verdict"] == f"reached the target (converged): {motion.run.reason}"
    slow, _, before = words["duration"].partition("; ")
    assert slow.startswith("2.5 s, 2 times as long as the 1.25 s planned: ")
    assert before == "before that 0.5 s to come to the first posture"
    assert words["speed"].endswith("% of the limit")
    lines = words["keyframes"].splitlines()
    assert [line.split()[0] for line in lines] == ["straight", "S", "coil", "late"]
    assert lines[2].split(maxsplit=1)[1] == "planned     1.25 s, passed      2.5 s, mean error 1 mm"
    assert lines[3].endswith("not reached")
    assert "margin is 10 mm" in words["clearance"]
    assert " steps" not in words["clearance"]
    assert words["not as planned"] == "at 1 s it went round\nand again"


def test_what_is_not_there_is_not_told():
    free = some_motion(limits=pp.Limits(step=None, dt=0.05, velocity=np.inf), names=())
    summary = free.summary()
    assert summary["largest_speed"] is None
    assert summary["largest_acceleration"] is None
    words = in_words(summary)
    assert words["duration"] == "3 s, as planned"
    assert not {"speed", "acceleration", "keyframes", "clearance", "deviations"} & set(words)


def test_a_motion_that_did_not_get_to_its_end_says_how_far_it_came():
    motion = some_motion()
    motion = replace(motion, plan_time=0.5 * motion.plan_time, run=replace(motion.run, status="stalled"))
    words = in_words(motion.summary())
    assert words["verdict"] == f"did not reach the target (stalled): {motion.run.reason}"
    assert words["duration"] == "3 s, for 1.5 of the 3 s of the plan"


def test_a_limit_that_is_reached_is_named():
    motion = some_motion()
    fastest = float(np.abs(motion.velocities).max())
    limits = pp.Limits(step=None, dt=0.05, velocity=fastest)
    words = in_words(some_motion(limits=limits).summary())
    assert words["speed"] == "at most 100 % of the limit, which is reached"
