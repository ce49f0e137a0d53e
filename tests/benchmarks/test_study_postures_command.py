"""The commands `study postures` and `study headings` print what the library finds."""

from __future__ import annotations

import csv
import json

import pytest

import pinposture as pp
from benchmarks.cases.families import built_subject, loaded_subject
from benchmarks.studies.headings import by_heading, study_headings
from benchmarks.studies.postures import by_group, study_postures

QUICK = ("study", "postures", "--controllers", "joint,lm")
TURNS = ("study", "headings", "--controllers", "joint,lm", "--pairs", 4)


def timeless(rows):
    return [{name: value for name, value in row.items() if name != "seconds"} for row in rows]


def as_json(row):
    return json.loads(json.dumps(row))


@pytest.fixture(scope="module")
def expected(arm_file):
    return study_postures([loaded_subject(pp.Arm.load(arm_file))], ("joint", "lm"), 10).rows()


def test_json_is_what_the_library_found(command, arm_file, expected):
    found = json.loads(command(*QUICK, "--urdf", arm_file, "--cases", 10, "--json").out)
    assert (found["cases"], found["seed0"], found["controllers"]) == (10, 0, ["joint", "lm"])
    assert timeless(found["rows"]) == timeless([as_json(row) for row in by_group(expected)])


def test_the_table_names_each_group_once_and_says_what_the_json_says(command, arm_file, expected):
    out = command(*QUICK, "--urdf", arm_file, "--cases", 10).out
    lines = [line.split() for line in out.splitlines() if line.split()]
    assert [line[0] for line in lines].count("smooth") == 1
    joint = [line for line in lines if "joint" in line]
    rows = [row for row in by_group(expected) if row.controller == "joint"]
    assert len(joint) == len(rows) == 3
    for line, row in zip(joint, rows, strict=True):
        assert line[-1] == "yes"
        assert line[line.index("joint") - 1] == str(row.runs)
        after = line[line.index("joint") + 1 :]
        assert after[:4] == ["100", "%", "100", "%"]
        assert after[4:6] == [f"{row.steps.median:.0f}", f"({row.steps.high:.0f})"]
        assert after[-3:-1] == [f"{row.path.median:.2f}", f"({row.path.high:.2f})"]
    families = command(*QUICK, "--urdf", arm_file, "--cases", 10, "--families").out
    assert families.count(" -> ") == 10


@pytest.mark.studies
def test_without_a_file_both_arms_that_are_built_in_are_studied(command):
    found = json.loads(command("study", "postures", "--controllers", "joint", "--cases", 2, "--json").out)
    expected = study_postures([built_subject("ryrz20"), built_subject("planar45")], ["joint"], 2).rows()
    assert timeless(found["rows"]) == timeless([as_json(row) for row in by_group(expected)])
    assert {row["arm"] for row in found["rows"]} == {"ryrz20", "planar45"}


def test_a_study_is_saved_even_if_nobody_reads_what_is_printed(command, tmp_path, monkeypatch):
    def gone(*_: object) -> None:
        raise BrokenPipeError

    monkeypatch.setattr("benchmarks.report.print_table", gone)
    command(*QUICK, "--arms", "ryrz20", "--cases", 1, "-o", tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {"cases.csv", "postures.png", "summary.json"}


@pytest.mark.studies
def test_a_loaded_arm_and_the_files_that_are_left(command, arm_file, tmp_path):
    out = tmp_path / "new"
    done = command(*QUICK, "--urdf", arm_file, "--split", 2, "--cases", 10, "--seed0", 4, "-o", out)
    assert done.code == 0
    assert sorted(path.name for path in out.iterdir()) == ["cases.csv", "postures.png", "summary.json"]
    assert done.err.splitlines() == [f"wrote {out / name}" for name in ("cases.csv", "postures.png")] + [
        f"wrote {out / 'summary.json'}"
    ]
    again = study_postures(
        [loaded_subject(pp.Arm.load(arm_file, split=2))], ("joint", "lm"), 10, first_seed=4
    ).rows()
    with (out / "cases.csv").open(newline="") as file:
        lines = [line | {"seconds": ""} for line in csv.DictReader(file)]
    assert lines == [
        {name: "" if value is None else str(value) for name, value in row.but(seconds="").items()}
        for row in again
    ]
    summary = json.loads((out / "summary.json").read_text())
    assert summary["seed0"] == 4
    assert [row["group"] for row in summary["rows"][::2]] == ["smooth", "harsh", "straight and noise"]
    assert (out / "postures.png").read_bytes().startswith(b"\x89PNG")


def test_a_controller_that_refuses_is_named(command, arm_file, monkeypatch):
    from pinposture.control import CONTROLLERS
    from pinposture.errors import InvalidValue

    class Unwilling:
        name = "lm"

        def step(self, *_):
            raise InvalidValue("arm", 3, "an arm of another kind")

    monkeypatch.setitem(CONTROLLERS, "lm", Unwilling)
    done = command(*QUICK, "--urdf", arm_file, "--cases", 3)
    assert done.code == 0
    assert done.err == "note: lm refused 3 of its runs: arm is 3; allowed: an arm of another kind\n"


@pytest.mark.studies
def test_headings_print_what_the_library_found(command, tmp_path):
    records = study_headings([built_subject("planar45")], ("joint", "lm"), 4, knowledge="curve").rows()
    asked = (*TURNS, "--arms", "planar45", "--target", "curve")
    found = json.loads(command(*asked, "--json").out)
    assert (found["pairs"], found["target"]) == (4, "curve")
    assert found["bins"] == [as_json(each) for each in by_heading(records)]
    done = command(*asked, "-o", tmp_path / "out")
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == [
        "cases.csv",
        "headings.png",
        "summary.json",
    ]
    (line,) = [line for line in done.out.splitlines() if line.split()[:1] == ["joint"]]
    counts = [word.strip(",") for word in line.split() if "/" in word]
    assert counts == [f"{each.reached}/{each.runs}" for each in by_heading(records)[:5]]
    for name in ("< 2 rad", "2 - pi rad", "pi - 4 rad", "4 - 6 rad", "> 6 rad"):
        assert name in done.out


@pytest.mark.parametrize("verb", ["postures", "headings"])
def test_help_has_paragraphs_and_examples(command, verb):
    done = command("study", verb, "--help", env={"COLUMNS": "80"})
    examples = [line.strip() for line in done.out.splitlines() if line.strip().startswith("$ ")]
    assert len(examples) >= 3
    assert all(example.startswith(f"$ make study STUDY={verb}") for example in examples)
    assert max(map(len, done.out.splitlines())) <= 80
    assert f" {verb} " in command("study").out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("postures --arms ryrz21", "did you mean 'ryrz20'"),
        ("postures --arms ryrz20,", "--arms is 'ryrz20,'"),
        ("postures --arms ryrz20,ryrz20", "each once"),
        ("postures --arms ryrz20 --urdf ARM", "--arms is 'ryrz20'"),
        ("postures --split 2", "only together with --urdf"),
        ("postures --urdf ARM/none.urdf", "none.urdf"),
        ("postures --controllers simplex", "'simplex'"),
        ("postures --controllers joint,,lm", "--controllers"),
        ("postures --controllers joint --cases 0", "cases is 0"),
        ("postures --controllers joint --seed0 -1", "--seed0 is -1"),
        ("postures --controllers joint --jobs 0", "jobs is 0"),
        ("postures -o ARM", "is a file"),
        ("headings --arms mixed12", "'mixed12'"),
        ("headings --controllers joint --target points", "configuration, curve"),
        ("headings --controllers joint --pairs 0", "pairs is 0"),
        ("headings --controllers joint --seed0 -1", "--seed0 is -1"),
        ("headings -o ARM", "is a file"),
    ],
)
def test_wrong_usage_is_one_line_and_costs_no_run(command, arm_file, arguments, message, monkeypatch):
    def never(*_, **__):
        raise AssertionError("tracked first")

    monkeypatch.setattr("benchmarks.studies.runs.track", never)
    done = command("study", *arguments.replace("ARM", str(arm_file)).split())
    assert (done.code, done.out) == (2, "")
    assert message in done.err
    assert done.err.startswith("error: ")
    assert done.err.count("\n") == 1
