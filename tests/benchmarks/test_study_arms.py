"""What the survey of foreign arms says of the runs, measured again from their configurations."""

from __future__ import annotations

from functools import cache
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pinocchio as pin
import pytest
from nearest import distances_to_nearest

import pinposture as pp
from benchmarks.cases.families import gentle_curve
from benchmarks.harness import Row
from benchmarks.studies.arms import awkward_arms, survey_arms

BEND = 0.5
HINGES = (pp.JointSpec("z", lower=-BEND, upper=BEND), pp.JointSpec("y", lower=-BEND, upper=BEND))
SEED = 4


@pytest.fixture
def directory(tmp_path: Path) -> Path:
    arm = pp.Arm.from_modules([pp.ModuleTemplate("m", joints=HINGES, link_lengths=(0.04, 0.05))] * 5)
    (tmp_path / "arm.urdf").write_text(arm.urdf)
    return tmp_path


def survey(directory: Path) -> Row:
    (found,) = survey_arms(directory, seed=SEED).rows()
    return found


def test_the_run_of_qp_is_that_of_the_default_controller(directory: Path) -> None:
    arm = pp.Arm.load(directory / "arm.urdf")
    target = pp.resolve_targets(arm, gentle_curve(arm))
    run = pp.track(arm, target, arm.random(np.random.default_rng(SEED)))
    found = survey(directory)

    points = np.array([arm.at(q).points for q in run.q])
    error = np.mean([np.hypot.reduce(off) for off in points[-1] - target.points])
    paths = sum(np.hypot.reduce(after[k] - before[k]) for before, after in pairwise(points) for k in range(5))
    straight = sum(np.hypot.reduce(points[-1, k] - points[0, k]) for k in range(5))
    assert found.geodesic == pytest.approx(error / arm.length, abs=1e-12)
    assert found.path_length_ratio == pytest.approx(paths / straight, rel=1e-9)
    assert (found.geodesic_steps, found.qp_status) == (run.steps, "converged")
    assert np.all(np.abs(run.q) <= BEND + 1e-12)
    assert found.qp_within_limits
    assert found.within_limits


@pytest.mark.parametrize("astray", ["joint", "switching", "geodesic"])
def test_a_run_outside_the_limits_is_told_of(
    astray: str, directory: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def one_step(arm: pp.Arm, target: object, start: np.ndarray, name: str, **_: object) -> SimpleNamespace:
        q = np.tile(start, (2, 1))
        q[1, 3] = 1.2 * BEND if name == astray else 0.0
        points = np.array([arm.at(row).points for row in q])
        found = {"q": q, "points": points, "point_errors": np.ones((2, 5)), "path_length_ratio": 1.0}
        return SimpleNamespace(**found, steps=1, status="max_steps")

    monkeypatch.setattr("benchmarks.studies.arms.track", one_step)
    found = survey(directory)
    assert not found.within_limits
    assert found.qp_within_limits == (astray != "geodesic")
    assert found.qp_status == "max_steps"


def test_the_farthest_of_the_whole_arm_is_that_of_samples_along_its_links(directory: Path) -> None:
    arm = pp.Arm.load(directory / "arm.urdf")
    target = pp.resolve_targets(arm, gentle_curve(arm))
    data = arm.model.createData()
    pin.framesForwardKinematics(arm.model, data, target.q)
    places = [data.oMi[k].translation.copy() for k in range(1, arm.model.njoints)]
    places.append(data.oMf[arm.model.getFrameId("tip")].translation.copy())
    dense = target.curve.at(np.linspace(0.0, target.curve.length, 20001))
    links = [a + t * (b - a) for a, b in pairwise(places) for t in np.linspace(0.0, 1.0, 40)]
    farthest = distances_to_nearest(links, dense).max()
    assert survey(directory).farthest == pytest.approx(farthest / arm.length, rel=0.01)


@pytest.mark.long
@pytest.mark.parametrize("name", sorted(awkward_arms()))
def test_arms_of_awkward_shapes_are_cut_short_and_placed(name: str) -> None:
    (found,) = [one for one in awkward() if one.file == name]
    assert not found.refused
    assert max(found.modules) <= (4 if name == "huge_slides10" else 2)
    assert ":" not in found.method
    assert found.residual <= 1.05 * found.reference + 1e-6
    assert found.farthest < 0.03
    assert max(found.reached, found.geodesic) < 1e-6
    assert found.within_limits


@cache
def awkward() -> list[Row]:
    return survey_arms(None, seed=SEED).rows()


def test_a_file_that_is_refused_has_no_run(directory: Path) -> None:
    (directory / "arm.urdf").write_text('<robot name="r">\n')
    found = survey(directory)
    assert found.refused
    assert found.geodesic is found.path_length_ratio is found.switching is found.reached is None
    assert (found.geodesic_steps, found.qp_status) == (0, "")
