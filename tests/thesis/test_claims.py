"""What the thesis reports comes out, and no change makes it worse than what was recorded."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from arms import template_arm

import pinposture as pp
from benchmarks.cases.scenarios import SPATIAL_SCENARIOS, case
from benchmarks.harness import Row
from benchmarks.studies.runs import study_scenarios
from pinposture.arm import smooth_configuration

pytestmark = pytest.mark.reproduction

RECORD = json.loads((Path(__file__).parents[2] / "benchmarks/results/thesis_claims.json").read_text())
SCENARIOS = {scenario.name: scenario for scenario in SPATIAL_SCENARIOS}
PAIRS = [(entry["scenario"], entry["controller"]) for entry in RECORD["results"]]


@pytest.fixture(scope="session")
def arm() -> pp.Arm:
    return template_arm("RyRz", 20)


@pytest.fixture(scope="module", params=PAIRS, ids="-".join)
def repeated(arm: pp.Arm, request: pytest.FixtureRequest) -> tuple[dict, list[Row]]:
    """The recorded figures of one scenario and controller, and the same ten seeds run again."""
    name, controller = request.param
    entry = RECORD["results"][PAIRS.index(request.param)]
    outcomes = study_scenarios(arm, [SCENARIOS[name]], [controller], range(10), max_steps=RECORD["steps"])
    return entry, outcomes


def test_the_recorded_figures_are_reached_again(repeated: tuple[dict, list[Row]]) -> None:
    # Projection is chaotic: rounding differs between processors, so figures may differ a little.
    entry, outcomes = repeated
    ratio = np.array([outcome.ratio for outcome in outcomes])
    assert np.mean(np.log10(np.maximum(ratio, 1e-6))) <= entry["subset"]["mean_log10_ratio"] + 0.25
    assert np.mean(ratio <= 0.5) >= entry["subset"]["halved"] - 0.2
    assert np.all(ratio <= 1.5)


def test_selection_runs_out_of_control_points_near_the_line_and_says_so(arm: pp.Arm) -> None:
    start, target = case(arm, SCENARIOS["line"], 0)
    run = pp.track(arm, target, start, "selection", max_steps=RECORD["steps"])
    assert run.status == "no_control_points"
    assert "singular" in run.reason
    counts = run.active.sum(axis=1)
    assert counts[-1] < counts[0]
    assert run.posture_error[-1] < 0.1 * run.posture_error[0]


def test_the_record_covers_a_hundred_seeds_and_what_the_thesis_says() -> None:
    figures = {(entry["scenario"], entry["controller"]): entry["all"] for entry in RECORD["results"]}
    assert all(found["cases"] == 100 for found in figures.values())
    assert figures["from-straight", "selection"]["no_control_points"] == 1.0
    assert figures["from-straight", "projection"]["halved"] >= 0.9
    line = figures["line", "selection"]
    assert line["no_control_points"] >= 0.7
    assert line["median_last_points"] < line["median_first_points"]
    assert figures["helix", "selection"]["halved"] >= 0.9
    assert figures["helix", "projection"]["halved"] >= 0.9


def test_outcomes_do_not_depend_on_the_number_of_processes(arm: pp.Arm) -> None:
    arguments = (arm, [SCENARIOS["helix"]], ["selection"], range(3))
    seen: list[tuple[int, int]] = []
    found = study_scenarios(*arguments, max_steps=20, jobs=2, progress=lambda *numbers: seen.append(numbers))
    assert found == study_scenarios(*arguments, max_steps=20)
    assert seen == [(1, 3), (2, 3), (3, 3)]


def test_smooth_configurations_have_their_amplitude_and_stay_within_limits(arm: pp.Arm) -> None:
    for amplitude in (0.2, 1.0):
        q = smooth_configuration(arm, np.random.default_rng(1), amplitude)
        assert np.abs(q).max() == pytest.approx(amplitude)
    narrow = pp.Arm.from_modules([pp.template("RyRz").with_limits(-0.3, 0.3)] * 5)
    assert narrow.within_limits(smooth_configuration(narrow, np.random.default_rng(1), 2.0))
