"""The commands `study scenes` and `study cycles` print what the library finds."""

from __future__ import annotations

import csv
import json

import pytest

from benchmarks.cases.families import built_subject
from benchmarks.cases.situations import SITUATIONS
from benchmarks.harness import Case, Study
from benchmarks.studies.cycles import study_cycles
from benchmarks.studies.scenes import by_scene, study_scenes

SCENES = ("inside", "post")


@pytest.fixture(scope="module")
def runs():
    return study_scenes(SCENES, 1).rows()


@pytest.fixture
def found(runs, monkeypatch):
    """Lets the verb find these runs; returns what it was asked for."""
    asked = []

    def study(names, seeds, seed0):
        asked.append((list(names), seeds, seed0))
        return Study([Case({}, lambda: None)], runs, lambda _, row: row)

    monkeypatch.setattr("benchmarks.studies.scenes.study_scenes", study)
    return asked


@pytest.mark.studies
def test_json_is_what_the_library_found(command, runs):
    done = command("study", "scenes", "--scenes", "inside,post", "--seeds", 1, "--json")
    assert (done.code, done.err) == (0, "")
    found = json.loads(done.out)
    assert {name: found[name] for name in ("study", "scenes", "seeds", "seed0")} == {
        "study": "scenes",
        "scenes": ["inside", "post"],
        "seeds": 1,
        "seed0": 0,
    }
    for row, expected in zip(found["rows"], by_scene(runs), strict=True):
        assert row.pop("seconds")["median"] > 0.0
        whole = json.loads(json.dumps(expected))
        whole.pop("seconds")
        assert row == whole


@pytest.mark.studies
def test_the_table_and_the_files_say_what_the_runs_say(command, runs, found, tmp_path):
    out = tmp_path / "new"
    done = command("study", "scenes", "--seeds", 1, "--seed0", 7, "-o", out)
    assert found == [(list(SITUATIONS), 1, 7)]
    inside, post = ([line for line in done.out.splitlines() if line.split()[:1] == [n]] for n in SCENES)
    for (line,), row, counts in ((inside, by_scene(runs)[0], "0 of 0"), (post, by_scene(runs)[1], "1 of 1")):
        words = line.split()
        assert words[1:9] == ["1", *counts.split(), "1", "of", "1", f"{1e3 * row.room:.2f}"]
        assert words[9:13] == [f"{row.steps.median:.0f}", f"({row.steps.high:.0f})"] + [
            f"{row.path.median:.2f}",
            f"({row.path.high:.2f})",
        ]
    assert done.err.splitlines() == [f"wrote {out / name}" for name in ("cases.csv", "summary.json")]
    with (out / "cases.csv").open(newline="") as file:
        lines = list(csv.DictReader(file))
    assert [line["scene"] for line in lines] == list(SCENES)
    assert list(lines[0]) == list(runs[0])
    assert json.loads((out / "summary.json").read_text())["seed0"] == 7


@pytest.mark.studies
def test_runs_that_did_not_do_as_they_should_are_named(command, runs, found):
    inside, post = runs
    runs[:] = [
        inside.but(refused=3),
        inside.but(seed=1, error=0.0),
        inside.but(seed=2, loss=0.002),
        inside.but(seed=3, end=0.004),
        post.but(error=0.1, status="max_steps", reason="slow", refused=1),
    ]
    done = command("study", "scenes")
    runs[:] = [inside, post]
    assert found
    assert done.err.splitlines() == [
        "starts and targets drawn and rejected: inside 3, post 1",
        "note: inside, seed 1: reached its target (stalled)",
        "note: inside, seed 2: came 2 mm closer than it may",
        "note: inside, seed 3: ended 4 mm apart, within the margin",
        "note: post, seed 0: did not reach its target (max_steps); names nothing that was in the way (slow)",
    ]


def test_the_help_names_every_scene(command):
    out = " ".join(command("study", "scenes", "--help", env={"COLUMNS": "200"}).out.split())
    assert f"Some of: {', '.join(SITUATIONS)}; else all." in out


@pytest.mark.studies
def test_cycles_print_what_the_library_found(command):
    asked = ("study", "cycles", "--arms", "ryrz20", "--cycles", 1, "--rounds", 2)
    found = study_cycles([built_subject("ryrz20")], cycles=1, rounds=2).rows()
    shown = json.loads(command(*asked, "--json").out)
    assert (shown["controller"], shown["cycles"], shown["rounds"], shown["seed0"]) == ("geodesic", 1, 2, 0)
    assert shown["runs"] == [json.loads(json.dumps(each)) for each in found]
    lines = [line.split() for line in command(*asked).out.splitlines() if line.split()[:1] == ["ryrz20"]]
    assert len(lines) == 2
    for line, each in zip(lines, found, strict=True):
        assert line[:3] == ["ryrz20", each.target, "1"]
        assert line[-2:] == [f"{drift:.2g}" for drift in each.drift]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("scenes --scenes slto", "did you mean 'slot'"),
        ("scenes --scenes post,,wall", "--scenes is 'post,,wall'"),
        ("scenes --scenes post --seeds 0", "seeds is 0"),
        ("scenes --seed0 -1", "--seed0 is -1"),
        ("scenes --jobs 0", "jobs is 0"),
        ("scenes -o FILE", "is a file"),
        ("cycles --arms ryrz21", "did you mean 'ryrz20'"),
        ("cycles --controller simplex", "'simplex'"),
        ("cycles --cycles 0", "cycles is 0"),
        ("cycles --rounds 0", "rounds is 0"),
        ("cycles --seed0 -1", "--seed0 is -1"),
    ],
)
def test_wrong_usage_is_one_line_and_costs_no_run(command, arm_file, arguments, message, monkeypatch):
    def never(*_, **__):
        raise AssertionError("tracked first")

    monkeypatch.setattr("benchmarks.studies.runs.track", never)
    done = command("study", *arguments.replace("FILE", str(arm_file)).split())
    assert (done.code, done.out) == (2, "")
    assert message in done.err
    assert done.err.startswith("error: ")
    assert done.err.count("\n") == 1
