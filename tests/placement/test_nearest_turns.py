"""Joints that can turn on and on: goals are the turn that is nearest."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sampling import examples

import pinposture as pp

pytestmark = pytest.mark.filterwarnings("ignore:limits of joint.* are they in degrees")

WIDE = 50.0
ROLLING = ("x", "y"), (0.02, 0.03), 8
OBLIQUE = ((1.0, 0.3, -0.2), (0.1, 1.0, 0.4), (-0.3, 0.2, 1.0)), (0.02, 0.02, 0.03), 6
TORUS = ("y", "z"), (0.025, 0.025), 8


@cache
def arm_of(axes, lengths, modules, low=-WIDE, high=WIDE) -> pp.Arm:
    joints = tuple(pp.JointSpec(axis, lower=low, upper=high) for axis in axes)
    return pp.Arm.from_modules([pp.ModuleTemplate("a", joints, lengths)] * modules)


@examples(60)
@given(st.integers(0, 10**6))
def test_the_nearest_turn_is_that_of_enumeration(seed: int) -> None:
    rng = np.random.default_rng(seed)
    low = -rng.uniform(0.0, 12.0)
    high = rng.uniform(0.1, 12.0)
    arm = arm_of(("y", "z"), (0.05, 0.05), 1, low, high)
    q = rng.uniform(low, high, 2)
    near = rng.uniform(-20.0, 20.0, 2)
    expected = []
    for at, wanted in zip(q, near, strict=True):
        turns = at + 2.0 * np.pi * np.arange(-5, 6)
        inside = turns[(turns >= low) & (turns <= high)]
        expected.append(inside[np.argmin(np.abs(inside - wanted))])
    found = arm.nearest_turns(q, near)
    np.testing.assert_allclose(found, expected, atol=1e-9)
    np.testing.assert_allclose(arm.at(found).points, arm.at(q).points, atol=1e-12)


@pytest.mark.parametrize("kind", [ROLLING, OBLIQUE, TORUS])
@pytest.mark.parametrize("method", ["auto", "closest", "smooth"])
def test_targets_on_curves_do_not_wind_up(kind, method) -> None:
    arm = arm_of(*kind)
    for radius, pitch in ((0.12, 0.1), (0.2, 0.4), (0.08, 0.2)):
        curve = pp.Curve.helix(radius=radius * arm.length, pitch=pitch * arm.length, turns=3)
        target = pp.resolve_targets(arm, curve, placement="align", method=method, incomplete="partial")
        away = arm.positions(target.q) - arm.positions(arm.straight())
        assert np.abs(away).max() <= np.pi + 1e-6
        np.testing.assert_allclose(arm.at(target.q).points, target.points, atol=1e-12)


@pytest.mark.parametrize("method", ["sequential", "smooth"])
def test_targets_stay_near_the_one_before(method) -> None:
    arm = arm_of(*TORUS)
    curve = pp.Curve.helix(radius=0.2 * arm.length, pitch=0.5 * arm.length, turns=3)
    first = pp.resolve_targets(arm, curve, placement="align", method=method)
    wound = 2.0 * np.pi * np.random.default_rng(0).integers(-4, 5, arm.nv)
    near = pp.Target(
        first.points, first.weights, first.q + wound, first.curve, first.parameters, first.residual, method
    )
    again = pp.resolve_targets(arm, curve, placement="align", method=method, near=near)
    assert np.abs(again.q - near.q).max() <= np.pi + 1e-6
    np.testing.assert_allclose(arm.at(again.q).points, again.points, atol=1e-9 * arm.length)


@pytest.mark.parametrize("known, controller", [(True, "geodesic"), (False, "geodesic"), (True, "joint")])
def test_runs_end_within_half_a_turn_of_their_start(known: bool, controller: str) -> None:
    arm = arm_of(*OBLIQUE)
    rng = np.random.default_rng(3)
    start, goal = rng.uniform(-1.0, 1.0, (2, arm.nv)) + 2.0 * np.pi * rng.integers(-4, 5, (2, arm.nv))
    points = arm.at(goal).points
    target = pp.Target.from_configuration(arm, goal) if known else pp.Target.from_points(arm, points)
    run = pp.track(arm, target, start, controller, max_steps=400)
    assert run.converged
    assert np.abs(run.q[-1] - start).max() <= np.pi + 1e-6
    np.testing.assert_allclose(arm.at(run.q[-1]).points, points, atol=1e-5 * arm.length)


def test_fitted_points_do_not_wind_up_and_continuous_joints_stay_as_they_are() -> None:
    arm = arm_of(*OBLIQUE)
    rng = np.random.default_rng(5)
    target = pp.fit_points(arm, arm.at(rng.uniform(-40.0, 40.0, arm.nv)).points)
    assert np.abs(target.q).max() <= np.pi + 1e-6
    joints = tuple(pp.JointSpec(axis, type="continuous") for axis in "yz")
    endless = pp.Arm.from_modules([pp.ModuleTemplate("a", joints, (0.03, 0.03))] * 3)
    q = endless.configuration(rng.uniform(-9.0, 9.0, endless.nv))
    assert endless.nq == 2 * endless.nv
    np.testing.assert_array_equal(endless.nearest_turns(q, endless.neutral()), q)
