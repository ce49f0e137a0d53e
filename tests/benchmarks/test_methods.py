"""Methods side by side: the numbers mean what they say, and depend on the arguments alone."""

from __future__ import annotations

import numpy as np
import pytest
from arms import template_arm

import pinposture as pp
from benchmarks.baselines import LevenbergMarquardt, PseudoInverse
from benchmarks.harness import Row
from benchmarks.studies.methods import DISTANCES, by_method, compare_methods
from pinposture.arm import smooth_configuration
from pinposture.errors import InvalidValue, UnknownName

NAMES = ("joint", "pinv", "lm", "selection", "extended")


@pytest.fixture(scope="session")
def arm() -> pp.Arm:
    return template_arm("RyRz", 6)


@pytest.fixture(scope="module")
def results(arm: pp.Arm) -> dict[str, Row]:
    found = by_method(compare_methods(arm, NAMES, range(3), max_steps=60).rows())
    assert [result.controller for result in found] == list(NAMES)
    return {result.controller: result for result in found}


@pytest.mark.process
def test_results_do_not_depend_on_the_number_of_processes(arm: pp.Arm, results: dict[str, Row]) -> None:
    again = by_method(compare_methods(arm, ["lm", PseudoInverse()], (0, 1, 2), max_steps=60).rows(jobs=2))
    assert again == [results["lm"], results["pinv"]]


def test_errors_are_those_of_runs_made_by_hand(arm: pp.Arm, results: dict[str, Row]) -> None:
    posture, tip, reached, apart = [], [], [], []
    for seed in range(3):
        rng = np.random.default_rng(seed)
        start = smooth_configuration(arm, rng, rng.uniform(0.2, 1.0))
        goal = smooth_configuration(arm, rng, rng.uniform(0.2, 1.0))
        there, home = (pp.Target.from_configuration(arm, q) for q in (goal, start))
        run = pp.track(arm, there, start, LevenbergMarquardt(), max_steps=60)
        distance = np.linalg.norm(arm.at(run.q[-1]).points - arm.at(goal).points, axis=1) / 0.3
        posture.append(distance.sum())
        tip.append(distance[-1])
        reached.append(distance.mean() < 1e-3)
        back = pp.track(arm, home, run.q[-1], "lm", max_steps=60)
        apart.append(np.abs(back.q[-1] - start).max())
    result = results["lm"]
    assert result.runs == 3
    assert result.posture_error == pytest.approx(np.median(posture), rel=1e-9)
    assert result.end_effector_error == pytest.approx(np.median(tip), rel=1e-9)
    assert result.reached == pytest.approx(np.mean(reached))
    assert result.returned == pytest.approx(np.median(apart), rel=1e-9)


def test_what_each_method_is_known_for(results: dict[str, Row]) -> None:
    joint, pinv, selection = results["joint"], results["pinv"], results["selection"]
    assert joint.reached == 1.0
    assert joint.returned < 1e-12
    assert pinv.end_effector_error < 1e-6 < 1e-2 < pinv.posture_error
    assert pinv.returned > 1e-3
    # Tenfold nearer to the singular posture, the pseudo-inverse asks for ten times as much, beyond +-pi too.
    growth = np.array(pinv.peaks[2:]) / pinv.peaks[1:-1]
    np.testing.assert_allclose(growth, 10.0, rtol=0.05)
    assert pinv.peaks[-1] > 1e4
    assert max(joint.peaks) < 20.0
    assert max(results["lm"].peaks) < 20.0
    assert selection.peaks[-1] == 0.0
    for result in results.values():
        assert len(result.peaks) == len(DISTANCES)
        assert np.all(np.isfinite([*list(result.values())[1:6], *result.peaks]))


def test_peaks_are_per_arm_length_of_mean_point_error(arm: pp.Arm) -> None:
    rng = np.random.default_rng(5)
    smooth_configuration(arm, rng, rng.uniform(0.2, 1.0))  # the start is drawn first
    goal = smooth_configuration(arm, rng, rng.uniform(0.2, 1.0))
    lines = np.linalg.norm(arm.at(goal).points - arm.at(arm.straight()).points, axis=1)
    (result,) = by_method(compare_methods(arm, ["joint"], [5], max_steps=1).rows())
    assert result.peaks[-1] == pytest.approx(np.abs(goal).max() / (lines.mean() / 0.3), rel=1e-4)


def test_an_arm_with_slides_and_a_planar_one() -> None:
    slide = pp.JointSpec("x", type="prismatic", lower=0.0, upper=0.05)
    joints = (pp.JointSpec("y"), slide, pp.JointSpec("z", type="continuous"))
    module = pp.ModuleTemplate("slides", joints, (0.03,) * 3)
    for arm in (pp.Arm.from_modules([module] * 3), pp.Arm.from_template("Rz", 6)):
        for result in by_method(compare_methods(arm, ["joint", "dls"], [0], max_steps=30).rows()):
            assert np.all(np.isfinite([*list(result.values())[1:6], *result.peaks]))
            assert all(peak > 0.0 for peak in result.peaks)


def test_bad_input_is_named(arm: pp.Arm) -> None:
    with pytest.raises(InvalidValue, match="seeds"):
        compare_methods(arm, ["lm"], [])
    with pytest.raises(InvalidValue, match="controllers"):
        compare_methods(arm, [], [0])
    with pytest.raises(UnknownName, match="augmented"):
        compare_methods(arm, ["augmentd"], [0])
