"""The harness of `make bench` runs without peers, and judges everybody by kinematics that are right."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

import pinposture as pp

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"


@pytest.fixture
def scenarios(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    import scenarios

    return scenarios


@pytest.mark.parametrize("modules", [1, 2, 7, 20])
def test_the_judge_the_arm_and_the_urdf_of_the_peers_agree(scenarios, modules: int) -> None:
    q = np.random.default_rng(modules).uniform(-np.pi, np.pi, 2 * modules)
    judged = scenarios.points_at(q)
    arm = pp.Arm.from_template("RyRz", modules, (scenarios.LINK, scenarios.LINK))
    np.testing.assert_allclose(judged, arm.at(q).points, atol=1e-12)
    model = pin.buildModelFromXML(scenarios.urdf_text(modules))
    data = model.createData()
    pin.framesForwardKinematics(model, data, q)
    for k, point in enumerate(judged):
        frame = model.getFrameId(scenarios.point_name(k))
        np.testing.assert_allclose(data.oMf[frame].translation, point, atol=1e-12)
    given = scenarios.problem(modules, 1)
    assert model.velocityLimit == pytest.approx(given.speed)
    assert model.upperPositionLimit == pytest.approx(np.pi)


def test_cases_are_reachable_and_the_same_for_everybody(scenarios, tmp_path: Path) -> None:
    given = scenarios.problem(30, 2, seed=3)
    scenarios.save(tmp_path / "problem.npz", given)
    read = scenarios.load(tmp_path / "problem.npz")
    assert [case.family for case in read.cases] == ["near", "random", "near", "random"]
    for case, before in zip(read.cases, given.cases, strict=True):
        np.testing.assert_array_equal(case.start, before.start)
        np.testing.assert_array_equal(case.points, scenarios.points_at(case.q))
        assert np.abs(case.q).max() < np.pi
        if case.family == "near":
            assert np.abs(case.q - case.start).max() <= scenarios.NEAR
    again = scenarios.problem(30, 2, seed=3)
    np.testing.assert_array_equal(again.cases[-1].q, given.cases[-1].q)
    assert np.abs(np.diff(scenarios.stream(30, 50), axis=0)).max() < given.bound


@pytest.mark.studies
def test_a_tiny_run_without_peers(tmp_path: Path) -> None:
    command = [sys.executable, str(BENCHMARKS / "bench.py"), "--here", "--steps-only", "--sizes", "8"]
    command += ["--seconds", "0.5", "--methods", "joint", "numpy-lm", "placo", "--out", str(tmp_path)]
    saved = tmp_path / "saved.json"
    subprocess.run([*command, "--save", str(saved)], check=True, capture_output=True, timeout=120)
    found = json.loads(saved.read_text())
    results = {(each["method"], each["dof"]): each for each in found["results"]}
    assert len(results) == 3
    for (method, dof), each in results.items():
        if method == "placo":
            assert each["reason"]  # whatever is not installed is named, and the rest goes on
            continue
        assert each["reason"] == ""
        assert each["excess"] <= 1e-9
        assert each["times"]["step"]["p50"] <= each["times"]["step"]["p99"]
        assert [run["family"] for run in each["runs"]].count("near") == len(each["runs"]) / 2 == 30
        near = [run for run in each["runs"] if run["family"] == "near"]
        assert all(run["fine"] and run["fine"][0] >= run["coarse"][0] for run in near), (method, dof)
    assert (tmp_path / "steps.png").stat().st_size > 1000
    command[command.index("joint") : command.index("placo") + 1] = ["numpy-lm"]
    ran = subprocess.run(
        [*command, "--compare", str(saved)], check=True, capture_output=True, text=True, timeout=120
    )
    assert "before" in ran.stdout
