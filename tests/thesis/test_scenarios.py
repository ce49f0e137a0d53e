"""Scenarios: what their seeds draw, and that what was recorded stays."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sampling import examples, seeds

import pinposture as pp
from benchmarks.cases.scenarios import (
    HEADINGS,
    NEARLY,
    SCENARIOS,
    SLIGHT_HEADINGS,
    SPATIAL_SCENARIOS,
    bent_configuration,
    case,
)
from benchmarks.reproduce.runs import thesis_arm
from pinposture.arm import smooth_configuration
from pinposture.errors import InvalidValue


def planar():
    return thesis_arm("planar45")


def headings(q):
    """Angle of each link from the base axis, from where its ends are."""
    points = np.vstack([np.zeros(3), planar().at(q).points])
    links = np.diff(points, axis=0)
    return np.unwrap(np.arctan2(links[:, 1], links[:, 0]))


@pytest.mark.parametrize("scenario", SCENARIOS.values(), ids=lambda each: each.name)
def test_every_scenario_has_a_case_that_its_seed_settles(scenario):
    arm = thesis_arm(scenario.arm)
    start, target = case(arm, scenario, 3)
    again, same = case(arm, scenario, 3)
    other, another = case(arm, scenario, 4)
    np.testing.assert_array_equal(start, again)
    np.testing.assert_array_equal(target.points, same.points)
    assert arm.within_limits(start) and target.has_target.all()
    # The case differs from seed to seed, unless the start is straight and the target the one straight line.
    assert not (np.array_equal(start, other) and np.array_equal(target.points, another.points))
    if scenario.start == "straight":
        np.testing.assert_array_equal(start, arm.straight())
    if scenario.start == "near-straight":
        assert np.abs(start).max() == pytest.approx(NEARLY)


@given(seed=st.integers(0, 10_000), heading=st.floats(0.01, 3.0))
@examples(30)
def test_bent_configurations_turn_their_links_as_far_as_was_said(seed, heading):
    q = bent_configuration(planar(), np.random.default_rng(seed), heading)
    assert np.abs(headings(q)).max() == pytest.approx(heading, rel=1e-6)
    smooth = smooth_configuration(planar(), np.random.default_rng(seed), 1.0)
    np.testing.assert_allclose(q / np.abs(q).max(), smooth / np.abs(smooth).max(), atol=1e-12)


def test_only_planar_arms_are_bent_and_only_by_a_number():
    with pytest.raises(InvalidValue, match="planar"):
        bent_configuration(thesis_arm("ryrz20"), np.random.default_rng(0), 1.0)
    for heading in (-0.1, np.nan):
        with pytest.raises(InvalidValue, match="heading"):
            bent_configuration(planar(), np.random.default_rng(0), heading)
    assert not bent_configuration(planar(), np.random.default_rng(0), 0.0).any()


@pytest.mark.parametrize("seed", seeds(4))
def test_planar_targets_are_curves_as_bent_as_was_said(seed):
    for name, (low, high) in (("planar-random", HEADINGS), ("planar-near-line", SLIGHT_HEADINGS)):
        start, target = case(planar(), SCENARIOS[name], seed)
        assert HEADINGS[0] <= np.abs(headings(start)).max() <= HEADINGS[1]
        assert 0.999 * low <= np.abs(headings(target.q)).max() <= 1.001 * high
        assert target.residual.max() < 1e-6 * planar().length
        np.testing.assert_allclose(target.curve.start, 0.0, atol=1e-12)
        assert target.curve.length > planar().length


@pytest.mark.parametrize("name", ["opposite", "planar-opposite"])
def test_the_opposite_posture_lies_on_the_other_side_of_the_axis(name):
    arm = thesis_arm(SCENARIOS[name].arm)
    start, target = case(arm, SCENARIOS[name], 0)
    np.testing.assert_allclose(target.points, arm.at(start).points * (1, -1, -1), atol=1e-12)


def test_the_starts_of_the_first_scenarios_are_those_on_record():
    # Drawn as ever: first the roll, then the amplitude, then the waves.
    for seed in (0, 17):
        rng = np.random.default_rng(seed)
        roll = rng.uniform(-np.pi, np.pi)
        arm = thesis_arm("ryrz20")
        expected = smooth_configuration(arm, rng, rng.uniform(0.2, 1.0))
        for scenario in SPATIAL_SCENARIOS[:2]:
            start, target = case(arm, scenario, seed)
            np.testing.assert_array_equal(start, expected)
            curve = pp.Curve.helix(0.06, 0.15, 4, handedness="left")
            if scenario.target == "helix":
                same = pp.resolve_targets(arm, curve, roll=roll)
                np.testing.assert_array_equal(target.points, same.points)


def test_joints_that_turn_the_other_way_bend_the_arm_as_far():
    parts = pp.Arm.from_template("Rz", 9).urdf.split('<axis xyz="0 0 1"')
    text = parts[0]
    for k, part in enumerate(parts[1:]):
        text += ('<axis xyz="0 0 -1"' if k % 2 else '<axis xyz="0 0 1"') + part
    arm = pp.Arm.load(text, split=1)
    q = bent_configuration(arm, np.random.default_rng(1), 0.8)
    points = np.vstack([np.zeros(3), arm.at(q).points])
    links = np.diff(points, axis=0)
    assert np.abs(np.unwrap(np.arctan2(links[:, 1], links[:, 0]))).max() == pytest.approx(0.8)
