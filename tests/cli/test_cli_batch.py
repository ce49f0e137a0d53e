"""`pinposture batch`: the runs that track makes, all in one file."""

from __future__ import annotations

import json
import re
from importlib import import_module

import numpy as np
import pytest

import pinposture as pp
from pinposture.curve import CURVES

SHORT = ("--controller", "projection", "--steps", 6)  # the quickest that moves


def many(command, arm_file, *options, curve="helix"):
    result = command("batch", arm_file, "--curve", curve, "--json", *SHORT, *options)
    found = json.loads(result.out)
    assert result.code == (0 if set(found["statuses"]) == {"converged"} else 1), result.err
    return found


def test_each_run_is_the_one_of_track_with_the_next_seed(command, arm_file):
    found = many(command, arm_file, "--count", 3, "--seed", 4)
    assert (found["count"], found["file"], len(found["runs"])) == (3, None, 3)
    for k, run in enumerate(found["runs"]):
        result = command("track", arm_file, "--curve", "helix", "--json", *SHORT, "--seed", 4 + k)
        alone = json.loads(result.out)
        for name in ("status", "reason", "steps", "start_error", "final_error", "path_length_ratio"):
            assert run[name] == alone[name]
        assert run["mean_error"] == pytest.approx(alone["mean_error"], rel=1e-12)
    assert len(many(command, arm_file)["runs"]) == 10


def test_the_file_holds_what_was_said(command, arm_file, tmp_path):
    path = tmp_path / "deep" / "batch" / "batch.npz"
    found = many(command, arm_file, "--count", 2, "-o", path.parent)
    batch = pp.load(path, pp.Batch)
    assert found["file"] == str(path)
    assert [run["final_error"] for run in found["runs"]] == batch.final_error.tolist()
    for verb in (("view",), ("export", "-o", tmp_path / "joints.csv")):
        refused = command(verb[0], path.parent, *verb[1:])
        assert (refused.code, "contains many runs; save one of them" in refused.err) == (2, True)
    assert [len(run.q) - 1 for run in batch] == [run["steps"] for run in found["runs"]]
    many(command, arm_file, "--count", 2, "-o", path.parent, "--ends-only")
    ends = pp.load(path, pp.Batch)
    assert ends.motions is None
    np.testing.assert_array_equal(ends.q_final, batch.q_final)


def test_words_on_stdout_and_the_file_on_stderr(command, arm_file, tmp_path):
    asked = ("batch", arm_file, "--curve", "helix", "--count", 2, "-o", tmp_path)
    result = command(*asked, "--steps", 2)
    batch = pp.load(tmp_path / "batch.npz", pp.Batch)
    assert result.err.splitlines() == [f"wrote {tmp_path / 'batch.npz'}"]
    lines = [line.split("  ", 1) for line in result.out.splitlines()]
    said = {name.strip(): text.strip().replace("--steps", "max_steps") for name, text in lines}
    assert said == {**batch.in_words(), "starts": "smooth, seeds 0 to 1"}
    (needed,) = re.findall(r"raise --steps to (\d+), which is enough for 2 of them", result.out)
    again = command(*asked, "--steps", needed)
    assert (again.code, again.out.splitlines()[0].split("  ")[-1].strip()) == (
        0,
        "reached the target in all 2 runs",
    )


def test_starts_in_collision_are_told_of_with_advice(command, arm_file, tmp_path):
    """The straight arm is 0.3 m long along x; bent at a right angle at its base, it is not near the ball."""
    (tmp_path / "scene.toml").write_text(
        'obstacles.ball = {type = "sphere", center = [0.25, 0, 0], radius = 0.02}'
    )
    (tmp_path / "starts.csv").write_text("0,1.57" + ",0" * 10 + "\n" + "0" + ",0" * 11)
    asked = ("batch", arm_file, "--curve", "line", "--scene", tmp_path / "scene.toml", "--steps", 1)
    result = command(*asked, "--starts", tmp_path / "starts.csv")
    assert "in collision in 1 of 2 runs, run 1 first; choose others by --starts or --seed" in result.out
    found = json.loads(command(*asked, "--starts", tmp_path / "starts.csv", "--json").out)
    assert found["starts_in_collision"] == [1]


def test_several_curves_from_one_start(command, arm_file, tmp_path):
    many(command, arm_file, "--curve", "line", "--count", 1, "-o", tmp_path)
    batch = pp.load(tmp_path / "batch.npz", pp.Batch)
    arm = pp.Arm.load(arm_file)
    for target, name in zip(batch.targets, ("helix", "line"), strict=True):
        np.testing.assert_allclose(
            target.points, pp.resolve_targets(arm, CURVES[name], placement="align").points, atol=1e-12
        )
    np.testing.assert_array_equal(batch.q_start[0], batch.q_start[1])


@pytest.mark.parametrize("suffix", [".csv", ".npy"])
def test_starts_are_the_rows_of_a_file(command, arm_file, tmp_path, suffix):
    rows = np.random.default_rng(0).uniform(-0.5, 0.5, (3, 12)).round(3)
    if suffix == ".csv":
        np.savetxt(tmp_path / "starts.csv", rows, delimiter=",")
    else:
        np.save(tmp_path / "starts.npy", rows)
    many(command, arm_file, "--starts", tmp_path / f"starts{suffix}", "-o", tmp_path)
    np.testing.assert_array_equal(pp.load(tmp_path / "batch.npz", pp.Batch).q_start, rows)


def test_the_exit_code_tells_whether_all_got_there(command, arm_file):
    asked = ("batch", arm_file, "--curve", "helix", "--count", 2, *SHORT)
    assert command(*asked).code == 1
    assert command(*asked, "--tolerance", 1).code == 0


def test_failed_runs_are_told_of(command, arm_file, monkeypatch):
    module = import_module("pinposture.motion.batch")
    original = module.track
    begun = []

    def track(*given, **named):
        begun.append(given)
        if len(begun) == 2:
            raise pp.PostureError("no way")
        return original(*given, **named)

    monkeypatch.setattr(module, "track", track)
    result = command("batch", arm_file, "--curve", "helix", "--count", 3, *SHORT, "--json")
    assert [run["status"] == "failed" for run in json.loads(result.out)["runs"]] == [False, True, False]
    assert (result.code, result.err) == (1, "note: 1 of 3 runs failed; run 1: PostureError: no way\n")


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (("--count", 0), "--count"),
        (("--count", 10**9), "--count is 1000000000; allowed: a whole number from 1 to 1000000"),
        (("--starts", "missing.csv"), "missing.csv"),
        (("--starts", "nowhere"), "'nowhere'"),
        (("--starts", "TABLE", "--count", 2), "--count"),
        (("--starts", "TABLE"), "start 1"),
        (("--starts", "TEXT"), "table of numbers"),
        (("--starts", "EMPTY"), "empty"),
        (("--jobs", 0), "jobs"),
        (("--ends-only",), "--ends-only is True; allowed: only with --output"),
        (("--curve", "line", "--count", 3), r"(2, 3)"),
        (("-o", "TEXT/many"), "is a file"),
        (("-o", "many.npz"), "a directory, in which files are saved"),
        (("--controller", "lm", "--joint-weight", 1), "--joint-weight"),
    ],
)
def test_what_cannot_be_used_is_named_in_one_line(command, arm_file, tmp_path, monkeypatch, options, says):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "table.csv").write_text(",".join(["0.1"] * 12) + "\n" + ",".join(["0.1"] * 11))
    (tmp_path / "text.csv").write_text("a,b\n")
    (tmp_path / "empty.csv").write_text("\n")
    named = {
        "TABLE": "table.csv",
        "TEXT": "text.csv",
        "EMPTY": "empty.csv",
        "TEXT/many": "text.csv/many",
    }
    result = command("batch", arm_file, "--curve", "helix", *(named.get(each, each) for each in options))
    assert (result.code, result.out) == (2, "")
    assert says in result.err
    assert len(result.err.splitlines()) == 1


def test_the_help_has_examples(command):
    out = command("batch", "--help", env={"COLUMNS": "80"}).out
    shown = [line for line in out.splitlines() if line.strip().startswith("$ ")]
    assert len(shown) >= 3
    assert all("pinposture batch " in line for line in shown)
    assert max(map(len, out.splitlines())) <= 80
