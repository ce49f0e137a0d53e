"""The benchmark of files: what the cases say is so, and no result is believed."""

from __future__ import annotations

import copy
import hashlib
import json
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from pinposture.errors import FileError
from pinposture.study import benchmark
from pinposture.study.benchmark import checksum, make_cases, score

CASES = Path(__file__).parents[2] / "benchmarks/cases/postures-1.json"


@pytest.fixture(scope="module")
def known():
    return json.loads(CASES.read_text())


def still(known):
    """Results of a program that never moves."""
    runs = [{"case": each["id"], "q": [each["start"]]} for each in known["cases"]]
    return {
        "format": benchmark.RESULTS_FORMAT,
        "version": 1,
        "cases": checksum(CASES),
        "program": "still",
        "runs": runs,
    }


def scored(results, tmp_path):
    (tmp_path / "results.json").write_text(json.dumps(results))
    return score(tmp_path / "results.json", CASES)


def test_the_file_is_the_one_whose_checksum_was_published():
    digest, name = (CASES.parent / "SHA256SUMS").read_text().split()
    assert name == CASES.name
    assert hashlib.sha256(CASES.read_bytes()).hexdigest() == checksum(CASES) == digest


def test_the_cases_are_those_that_are_drawn(known):
    drawn = make_cases(1)
    named = {each["id"]: each for each in known["cases"]}
    for case in drawn["cases"]:
        kept = named[case["id"]]
        assert {**case, "start": 0, "target": 0} == {**kept, "start": 0, "target": 0}
        np.testing.assert_allclose(case["start"], kept["start"], atol=1e-6)
        np.testing.assert_allclose(case["target"], kept["target"], atol=1e-6)
    assert drawn["arms"] == known["arms"]


def test_joints_and_points_are_found_in_the_urdf_without_this_library(known):
    from pinposture.study.reproduce.runs import thesis_arm

    for name, told in known["arms"].items():
        model = pin.buildModelFromXML(told["urdf"])
        data, q = model.createData(), np.random.default_rng(1).uniform(-0.5, 0.5, model.nq)
        assert list(model.names[1:]) == told["joints"]
        pin.forwardKinematics(model, data, q)
        placements = [data.oMi[model.getJointId(point["joint"])] for point in told["points"]]
        points = [at.act(np.array(p["offset"])) for at, p in zip(placements, told["points"], strict=True)]
        np.testing.assert_allclose(points, thesis_arm(name).at(q).points, atol=1e-9)


def test_a_program_that_does_not_move_reaches_nothing_and_breaks_nothing(known, tmp_path):
    program, scores = scored(still(known), tmp_path)
    assert program == "still"
    assert sum(each.cases for each in scores) == len(known["cases"])
    for each in scores:
        assert (each.tried, each.limits_held, each.clear) == (each.cases,) * 3
        assert each.reached == 0 and each.steps is None and each.error > benchmark.BENCHMARK_REACHED


def test_what_breaks_a_limit_or_is_left_out_is_not_reached(known, tmp_path):
    results = still(known)
    case = next(each for each in known["cases"] if each["group"] == "helix")
    leap = copy.deepcopy(results)
    run = next(each for each in leap["runs"] if each["case"] == case["id"])
    run["q"] = [case["start"], (np.array(case["start"]) + 0.11).tolist()]
    found = {each.group: each for each in scored(leap, tmp_path)[1]}
    assert found["helix"].limits_held == found["helix"].tried - 1
    results["runs"] = results["runs"][1:]
    found = {each.group: each for each in scored(results, tmp_path)[1]}
    assert (found["helix"].tried, found["helix"].cases) == (4, 5)


def test_an_arm_on_its_way_is_scored_by_hand(known, tmp_path):
    from pinposture.study.reproduce.runs import thesis_arm

    case = next(each for each in known["cases"] if each["group"] == "planar-random")
    arm, start = thesis_arm("planar45"), np.array(case["start"])
    way = start + np.linspace(0.0, 0.09, 4)[:, None] * np.ones(45)
    results = still(known)
    results["runs"] = [{"case": case["id"], "q": way.tolist()}]
    found = {each.group: each for each in scored(results, tmp_path)[1]}["planar-random"]
    errors = np.linalg.norm(arm.at(way[-1]).points - np.array(case["target"]), axis=1)
    assert found.error == pytest.approx(errors.mean() / arm.length, rel=1e-9)
    assert (found.tried, found.limits_held) == (1, 1)


def test_an_arm_that_goes_through_a_wall_is_not_clear(known, tmp_path):
    case = next(each for each in known["cases"] if each["group"] == "hole")
    results = still(known)
    straight = np.zeros(40)  # the straight arm of 1 m sticks in or beside the hole of the wall at 0.45 m
    straight[0] = 0.6
    steps = int(np.ceil(np.abs(straight - case["start"]).max() / 0.09)) + 1
    way = np.linspace(case["start"], straight, steps)
    results["runs"] = [{"case": case["id"], "q": way.tolist()}]
    found = {each.group: each for each in scored(results, tmp_path)[1]}["hole"]
    assert (found.tried, found.limits_held, found.clear) == (1, 1, 0)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"cases": "0" * 64}, "other cases"),
        ({"version": 2}, "version 2"),
        ({"format": "else"}, "format"),
        ({"runs": [{"case": "nothing", "q": []}]}, "'nothing'"),
        ({"runs": [{"case": "helix-5000", "q": [[0.0] * 40]}]}, "begin at the start"),
        ({"runs": [{"case": "helix-5000", "q": [[0.0] * 39]}]}, "40"),
        ({"runs": [{"case": "helix-5000", "q": [[float("nan")] * 40]}]}, "finite"),
        ({"runs": [{"case": "helix-5000", "q": "fast"}]}, "finite"),
        ({"runs": ["helix-5000"]}, "''"),
    ],
)
def test_a_file_that_is_no_result_is_an_error(known, tmp_path, change, words):
    with pytest.raises(FileError, match=words):
        scored(still(known) | change, tmp_path)


def test_a_case_twice_and_a_file_that_is_not_json_are_errors(known, tmp_path):
    results = still(known)
    with pytest.raises(FileError, match="once"):
        scored(results | {"runs": results["runs"][:1] * 2}, tmp_path)
    (tmp_path / "broken.json").write_text("{")
    with pytest.raises(FileError, match="line 1"):
        score(tmp_path / "broken.json", CASES)
