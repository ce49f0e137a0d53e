from __future__ import annotations

import json
import shlex
import sys
from pathlib import Path

import pytest

from benchmarks import reproduce as package
from benchmarks.reproduce import NAMES
from benchmarks.reproduce.claims import CLAIMS, FIGURES
from benchmarks.reproduce.command import run as reproduce_verb
from pinposture.cli.output import verb_examples
from pinposture.units import length_text


@pytest.fixture(scope="module")
def done(command, tmp_path_factory):
    """One figure of few steps, kept."""
    directory = tmp_path_factory.mktemp("out") / "kept"
    arguments = ("reproduce", "6.8", "--steps", 3, "--jobs", 1, "-o", directory)
    return command(*arguments), directory


@pytest.fixture
def asked(monkeypatch):
    """What the library is asked for, instead of doing it."""
    calls = []

    def take(*arguments, **named):
        calls.append((*arguments[:-1], named))
        return package.Reproduction([], [], {"figures": [], "claims": []}, [])

    monkeypatch.setattr("benchmarks.reproduce.reproduce", take)
    return calls


def test_alone_it_lists_what_there_is_and_runs_nothing(command, asked):
    result = command("reproduce")
    assert (result.code, result.err, asked) == (0, "", [])
    words = [line.split() for line in result.out.splitlines() if line.strip()]
    assert [line[0] for line in words if line[0] in NAMES] == list(NAMES)
    assert all(f"Section {figure.section}" in result.out for figure in FIGURES.values())
    assert f"verdicts on {len(CLAIMS)} claims" in result.out


@pytest.mark.reproduction
def test_a_figure_leaves_its_picture_and_its_numbers(done):
    result, directory = done
    assert result.code == 0
    names = ["figure-6.08.csv", "figure-6.08.png", "results.json"]
    assert sorted(path.name for path in directory.iterdir()) == names
    (figure,) = json.loads((directory / "results.json").read_text())["figures"]
    (run,) = figure["runs"]
    row = next(line for line in result.out.splitlines() if line.strip().startswith("6.8"))
    change = f"{length_text(run['start_error'])} -> {length_text(run['final_error'])}"
    assert row.split("  ")[0].strip() == "6.8"
    assert f"Projection   {change}" in row
    assert row.split(change)[1].split()[0] == str(run["steps"])
    assert result.err.splitlines() == [
        f"wrote {directory / 'figure-6.08.png'}",
        f"wrote {directory / 'figure-6.08.csv'}",
        f"wrote {directory / 'results.json'}",
    ]


@pytest.mark.reproduction
def test_json_is_the_file(command, done, tmp_path):
    _, directory = done
    result = command("reproduce", "6.8", "--steps", 3, "--jobs", 1, "-o", tmp_path, "--json")
    assert json.loads(result.out) == json.loads((directory / "results.json").read_text())


def test_verdicts_are_a_table(command, monkeypatch, tmp_path):
    from benchmarks.reproduce.measures import Finding, Share
    from benchmarks.reproduce.reproduction import describe

    claim = CLAIMS["tracks-singular"]
    finding = Finding({"a": Share(1, 4), "b": Share(4, 4)}, {}, "")
    judged = [package.JudgedClaim(claim, "holds partly", finding, {}, {"mine": ("does not hold", finding)})]
    result = package.Reproduction([], judged, describe([], judged, None, 9), [])
    monkeypatch.setattr("benchmarks.reproduce.reproduce", lambda *_, **__: result)
    out = command("reproduce", "claims", "-o", tmp_path).out
    row = next(line for line in out.splitlines() if claim.text in line).split()
    expected = ["holds", "partly", "25%", "to", "100%", "does", "not", "hold", *claim.text.split()]
    assert row == [*expected, *claim.where.split()]
    assert any("mine" in line.split() for line in out.splitlines())


def test_options_reach_the_library(command, asked):
    command("reproduce", "6.3", "claims", "--seeds", 7, "--steps", 9, "--jobs", 2, "-o", "there")
    command("reproduce", "all", "--controller", "lm", "--controller", "a:B", "--seed", 3, "--page", "p.md")
    options = ("--step-limit", 0.05, "--gain", 0.5, "--null-gain", 0.1, "--index", 0.01, "--kappa", 0.3)
    command("reproduce", "6.4", *options, "--format", "pdf", "--format", "svg", "--width", 88)
    plain = {"controllers": (), "settings": package.FigureSettings(), "page": None}
    seeded = package.FigureSettings(seed=3)
    assert asked[:2] == [
        (["6.3", "claims"], Path("there"), 7, 9, 2, plain),
        (
            ["all"],
            Path("out/reproduce"),
            100,
            200,
            -1,
            {"controllers": ["lm", "a:B"], "settings": seeded, "page": Path("p.md")},
        ),
    ]
    settings = asked[2][-1]["settings"]
    assert (settings.step_limit, settings.formats, settings.width) == (0.05, ("pdf", "svg"), 88.0)
    selection = settings.methods["selection"]
    projection = settings.methods["projection"]
    assert (selection.gain, selection.null_gain) == (projection.gain, projection.null_gain) == (0.5, 0.1)
    assert (selection.absolute, selection.relative, projection.threshold) == (0.01, 0.01, 0.3)
    assert settings.methods["switching"].selection == selection


@pytest.mark.long
def test_a_controller_of_the_users_own_is_a_row_of_the_figure(command, tmp_path, monkeypatch):
    lines = (
        "from pinposture.control import Projection",
        "",
        "",
        "def make():",
        '    return Projection(name="own")',
    )
    (tmp_path / "made_for_a_test.py").write_text("\n".join(lines) + "\n")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.path", list(sys.path))
    arguments = ("reproduce", "6.8", "--steps", 3, "--jobs", 1, "--controller", "made_for_a_test:make")
    result = command(*arguments)
    assert result.code == 0
    rows = [line.split() for line in result.out.splitlines() if line.strip().startswith("6.8")]
    assert [row[1] for row in rows] == ["Projection", "own"]
    assert rows[0][2:] == rows[1][2:]  # it is the same method
    text = (tmp_path / "out/reproduce/figure-6.08.csv").read_text().splitlines()
    assert [line.split(",")[0] for line in text] == ["controller", *["Projection"] * 4, *["own"] * 4]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("6.2",), ("no figure is called '6.2'", "6.3, 6.4", "claims, all")),
        (("claim",), ("did you mean 'claims'?",)),
        (("6.3", "--seeds", "0"), ("seeds is 0",)),
        (("6.3", "--steps", "0"), ("--steps is 0",)),
        (("6.3", "--jobs", "0"), ("jobs is 0",)),
        (("6.3", "--seeds", "few"), ("--seeds",)),
        (("6.3", "--format", "gif"), ("no format is called 'gif'", "png, pdf, svg")),
        (("6.3", "--step-limit", "0"), ("--step-limit is 0.0",)),
        (("6.3", "--width", "-1"), ("--width", "20")),
        (("6.3", "--page", "page.md"), ("page is 'page.md'", '"claims"')),
        (("6.3", "--kappa", "2"), ("--kappa is 2.0",)),
        (("claims", "--kappa", "0.1"), ("settings", "default methods")),
        (("6.3", "--controller", "selektion"), ("did you mean 'selection'?",)),
        (("6.3", "--controller", "projection"), ("controllers (names)", "names that differ")),
    ],
)
def test_what_cannot_be_done_is_one_line_and_leaves_nothing(command, tmp_path, monkeypatch, arguments, words):
    monkeypatch.chdir(tmp_path)
    result = command("reproduce", *arguments)
    assert (result.code, result.out) == (2, "")
    (line,) = result.err.splitlines()
    assert line.startswith("error: ")
    assert all(word in line for word in words)
    assert not list(tmp_path.iterdir())


def test_a_directory_that_is_a_file_is_refused_before_anything_runs(command, tmp_path):
    (tmp_path / "file").write_text("")
    result = command("reproduce", "6.3", "-o", tmp_path / "file")
    assert (result.code, result.out) == (2, "")
    assert "file" in result.err


def test_the_examples_are_what_can_be_asked_for(command, asked, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for example in verb_examples[reproduce_verb]:
        program, verb, *arguments = shlex.split(example)
        assert (program, verb) == ("make", "reproduce")
        arguments = [verb, *arguments[1:]]
        assert command(*arguments).code == 0
    assert [names for names, *_ in asked] == [["6.3", "6.4"], ["6.4"], ["6.4"], ["claims"], ["all"]]
    assert all(name in NAMES for names, *_ in asked for name in names)


def test_the_help_says_what_figures_there_are(command):
    out = command("reproduce", "--help", env={"COLUMNS": "80"}).out
    for word in ("6.3 to 6.12", "claims", "all", "results.json", "claims.md", "--seeds", "--jobs"):
        assert word in out
    assert max(map(len, out.splitlines())) <= 80


def test_a_score_names_the_file_that_is_missing_first_that_of_the_results(command, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # where there are no cases either
    assert command("score", "nothing.json").err == "error: nothing.json: no such file\n"
    Path("results.json").write_text("{}")
    asked = command("score", "results.json")
    assert asked.code == 2 and "--cases is 'benchmarks/cases/postures-1.json'; allowed: " in asked.err
