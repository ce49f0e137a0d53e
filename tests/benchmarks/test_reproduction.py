"""Figures and claims in one call: what comes of it, what is kept, and that it can be repeated."""

from __future__ import annotations

import csv
import json
from typing import get_args

import numpy as np
import pytest
from matplotlib.text import Text

from benchmarks.cases.scenarios import SCENARIOS, case
from benchmarks.reproduce import NAMES, FigureSettings, reproduce, run_figures
from benchmarks.reproduce.claims import CLAIMS, FIGURES
from benchmarks.reproduce.measures import Verdict
from benchmarks.reproduce.page import PARTS, update_page, with_tables
from benchmarks.reproduce.reproduction import count_runs, draw_figure
from pinposture.control import CONTROLLERS, Projection
from pinposture.errors import FileError, InvalidValue, UnknownName

VERDICTS = set(get_args(Verdict))


@pytest.fixture(scope="module")
def judged(tmp_path_factory):
    """Claims over one seed of five steps, and what was reported on the way."""
    directory, heard = tmp_path_factory.mktemp("claims") / "deep", []
    done = reproduce(["claims"], directory, seeds=1, max_steps=5, progress=lambda *now: heard.append(now))
    return done, directory, heard


def test_runs_that_several_figures_show_are_made_once():
    errors, postures = run_figures(["6.4", "6.3"], max_steps=3)
    assert (errors.about.number, postures.about.number) == ("6.4", "6.3")
    assert list(errors.runs) == ["Selection", "Projection"]
    assert all(errors.runs[name] is postures.runs[name] for name in errors.runs)
    assert (count_runs(["6.4", "6.3"]), count_runs(["6.10", "6.12"]), count_runs([])) == (2, 3, 0)


def test_initial_postures_are_reused_where_the_thesis_reuses_them():
    first, second = run_figures(["6.3", "6.5"], max_steps=1)
    assert np.array_equal(first.runs["Selection"].q[0], second.runs["Projection"].q[0])
    assert not np.allclose(first.runs["Selection"].target.points, second.runs["Selection"].target.points)


def test_numbers_of_a_figure_are_those_of_its_runs():
    done = reproduce(["6.12", "6.8"], max_steps=4)
    assert not done.files
    figure = done.results["figures"][1]
    assert [each["figure"] for each in done.results["figures"]] == ["6.8", "6.12"]  # as in the thesis
    assert {"scenario": "planar-near-line", "arm": "planar45", "section": "6.2.4"}.items() <= figure.items()
    (run,) = done.figures[1].runs.values()
    (told,) = figure["runs"]
    assert told["posture_error"] == run.posture_error.tolist()
    assert told["start"] == run.q[0].tolist()
    assert told["active_points"] == run.active.sum(axis=1).tolist()
    assert told["by_projection"] == (run.info["method"] == "projection").tolist()
    assert (told["steps"], told["status"], told["start_error"]) == (4, "max_steps", run.posture_error[0])
    assert told["parameters"] == run.controller != told["controller"] == "switching"
    assert [each["controller"] for each in figure["compared"]] == ["selection", "projection"]
    assert done.results["figures"][0]["runs"][0]["by_projection"] is None


@pytest.mark.reproduction
def test_files_are_named_after_the_thesis_and_written_whole(tmp_path):
    done = reproduce(["6.3", "6.11"], tmp_path / "new", max_steps=2)
    names = [
        "figure-6.03.png",
        "figure-6.03-postures.csv",
        "figure-6.11.png",
        "figure-6.11.csv",
        "figure-6.11-postures.csv",
        "results.json",
    ]
    assert [path.name for path in done.files] == names
    assert sorted(names) == sorted(path.name for path in (tmp_path / "new").iterdir())
    for path in done.files:
        assert path.suffix != ".png" or path.read_bytes().startswith(b"\x89PNG")
    assert json.loads(done.files[-1].read_text()) == done.results
    (run,) = done.figures[1].runs.values()
    with done.files[3].open() as file:
        rows = list(csv.DictReader(file))
    assert [float(row["posture_error_m"]) for row in rows] == run.posture_error.tolist()
    assert [float(row["point_error_45_m"]) for row in rows] == run.point_errors[:, -1].tolist()
    assert [row["active_points"] for row in rows] == ["", *map(str, run.active.sum(axis=1))]
    with done.files[4].open() as file:
        rows = [row for row in csv.DictReader(file) if row["posture"] == "final, Projection"]
    np.testing.assert_array_equal(
        [[float(row[f"{axis}_m"]) for axis in "xyz"] for row in rows], run.points[-1]
    )


@pytest.mark.reproduction
@pytest.mark.parametrize(("form", "begins"), [("pdf", b"%PDF"), ("svg", b"<?xml")])
def test_figures_for_print_are_as_wide_as_asked_for_in_small_type(tmp_path, form, begins):
    settings = FigureSettings(formats=(form,), width=88.0)
    done = reproduce(["6.4"], tmp_path, max_steps=2, settings=settings)
    assert done.files[0].read_bytes().startswith(begins)
    drawn = draw_figure(done.figures[0], 88.0)
    assert drawn.get_size_inches()[0] == pytest.approx(88.0 / 25.4)
    assert drawn.get_suptitle() == ""
    sizes = [text.get_fontsize() for ax in drawn.axes for text in ax.findobj(Text) if text.get_text()]
    assert sizes and max(sizes) <= 7.0
    places = [place for ax in drawn.axes if (place := ax.get_subplotspec()) is not None]
    assert {place.get_gridspec().ncols for place in places} == {1}  # stacked


def test_a_figure_takes_a_seed_a_step_limit_methods_and_a_controller_of_ones_own():
    gentle = Projection(gain=0.01, null_gain=0.0)
    settings = FigureSettings(seed=5, step_limit=0.02, methods={"projection": gentle})
    (figure,) = run_figures(["6.4"], 2, settings=settings, own={"mine": Projection(name="mine")})
    assert (figure.seed, list(figure.runs)) == (5, ["Selection", "Projection", "mine"])
    start, _ = case(figure.runs["mine"].arm, SCENARIOS["helix"], 5)
    for run in figure.runs.values():
        np.testing.assert_array_equal(run.q[0], start)
        assert np.abs(np.diff(run.q, axis=0)).max() <= 0.02 * (1 + 1e-12)
    assert "gain=0.01" in figure.runs["Projection"].controller
    assert "gain=1.0" in figure.runs["mine"].controller
    for fault in ({"methods": {"lm": gentle}}, {"formats": ("gif",)}):
        with pytest.raises(UnknownName):
            FigureSettings(**fault)


@pytest.mark.reproduction
def test_the_page_is_written_between_its_markers_from_what_is_left_beside_it(tmp_path):
    page = tmp_path / "page.md"
    page.write_text("Before.\n" + "".join(f"<!-- {n}: begin -->old<!-- {n}: end -->\nKept.\n" for n in PARTS))
    done = reproduce(["claims"], None, seeds=1, max_steps=2, controllers=["dls"], page=page)
    assert [path.name for path in done.files] == ["page.md", "page.json"]
    kept = json.loads((tmp_path / "page.json").read_text())
    assert kept["claims"] == done.results["claims"]
    text = page.read_text()
    assert text.startswith("Before.\n") and text.count("Kept.") == len(PARTS) and "old<" not in text
    assert with_tables(text, kept, page) == text
    assert "| read otherwise | dls |" in text
    own = [claim["id"] for claim in kept["claims"] if claim["own"]]
    assert own == [claim.id for claim in CLAIMS.values() if claim.general]
    page.write_text("No markers.")
    with pytest.raises(FileError, match="begin"):
        update_page(page, kept)


@pytest.mark.reproduction
def test_every_claim_gets_a_verdict_and_a_place_in_the_file(judged):
    done, directory, _ = judged
    results = json.loads((directory / "results.json").read_text())
    assert results == done.results
    assert set(results) == {"format", "version", "parameters", "figures", "claims", "runs"}
    assert (results["format"], results["version"]) == ("pinposture-reproduction", 2)
    parameters = results["parameters"]
    assert (parameters["seeds"], parameters["max_steps"], parameters["step_limit"]) == (1, 5, 0.1)
    assert parameters["rules"]["always"] == {
        "words": "guaranteed, or said of every case",
        "holds": 1.0,
        "partly": None,
    }
    assert [claim["id"] for claim in results["claims"]] == list(CLAIMS)
    for claim in results["claims"]:
        keys = {
            "id",
            "where",
            "claim",
            "measured",
            "rule",
            "verdict",
            "shares",
            "figures",
            "by_nearness",
            "instead",
            "readings",
            "construction",
            "own",
        }
        assert set(claim) == keys
        assert claim["verdict"] in VERDICTS
        for found in (claim, *claim["readings"].values()):
            assert set(found) >= {"verdict", "shares", "figures", "instead"}
            for each in found["shares"].values():
                assert 0 <= each["true"] <= each["cases"] and each["cases"] > 0
                assert each["share"] == each["true"] / each["cases"]
            assert all(np.isfinite(list(found["figures"].values())))
    runs = {(each["scenario"], each["variant"]): each for each in results["runs"]}
    assert runs["helix", "selection"]["endings"] == {"max_steps": 1}
    assert runs["from-straight", "selection"]["endings"] == {"no_control_points": 1}


@pytest.mark.reproduction
def test_the_table_of_claims_tells_the_same(judged):
    done, directory, _ = judged
    text = (directory / "claims.md").read_text()
    for each in done.judged:
        told = f"| [{each.claim.text}](#{each.claim.id}) | {each.claim.where} | {each.verdict} |"
        assert told in text
        assert f"### {each.claim.id}\n" in text
    lines = [line for line in text.splitlines() if line.startswith("|")]
    assert all(line.endswith("|") for line in lines)


@pytest.mark.reproduction
def test_a_later_call_for_figures_leaves_the_claims_where_they_are(tmp_path):
    reproduce(["6.7", "claims"], tmp_path, seeds=1, max_steps=3)
    before = json.loads((tmp_path / "results.json").read_text())
    reproduce(["6.3"], tmp_path, max_steps=3)
    after = json.loads((tmp_path / "results.json").read_text())
    assert [each["figure"] for each in after["figures"]] == ["6.3", "6.7"]
    for name in ("parameters", "claims", "runs"):
        assert after[name] == before[name]
    (tmp_path / "results.json").write_text("of somebody else")
    reproduce(["6.3"], tmp_path, max_steps=3)
    assert [each["figure"] for each in json.loads((tmp_path / "results.json").read_text())["figures"]] == [
        "6.3"
    ]


@pytest.mark.reproduction
def test_progress_counts_every_run_once(judged):
    _, _, heard = judged
    assert [done for done, _ in heard] == sorted(done for done, _ in heard)
    assert heard[-1][0] == heard[-1][1] == {total for _, total in heard}.pop()


@pytest.mark.reproduction
def test_results_do_not_depend_on_the_number_of_processes(judged):
    again = reproduce(["claims"], None, seeds=1, max_steps=5, jobs=2)
    assert again.results == judged[0].results


def test_what_does_not_exist_or_makes_no_sense_is_refused(tmp_path):
    with pytest.raises(UnknownName) as caught:
        reproduce(["6.3", "6.2"], tmp_path)
    assert caught.value.allowed == NAMES == (*FIGURES, "claims", "all")
    for arguments in ({"seeds": 0}, {"max_steps": 0}, {"jobs": 0}, {"jobs": -2}, {"seeds": True}):
        with pytest.raises(InvalidValue, match=next(iter(arguments))):
            reproduce(["6.3"], tmp_path, **arguments)
    with pytest.raises(InvalidValue, match="names"):
        reproduce([], tmp_path)
    (tmp_path / "file").write_text("")
    with pytest.raises(FileError):
        reproduce(["6.3"], tmp_path / "file")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["file"]


def test_figures_name_scenarios_and_controllers_that_exist():
    assert list(FIGURES) == [f"6.{number}" for number in range(3, 13)]
    for number, figure in FIGURES.items():
        assert figure.number == number
        assert {*figure.controllers, *figure.compared} <= set(CONTROLLERS)
        assert SCENARIOS[figure.scenario].section in (figure.section, "6.2.2")
        assert (SCENARIOS[figure.scenario].arm == "planar45") is (figure.layout == "planar")
