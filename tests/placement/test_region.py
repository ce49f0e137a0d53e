"""Posture control on a region: only its points are used, counted and followed, whatever the controller."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from arms import template_arm

import pinposture as pp
from pinposture.control import CONTROLLERS, Controller
from pinposture.errors import InvalidValue

THESIS = [
    pp.Selection(score="error"),
    pp.Selection(score="geometric"),
    pp.Selection(score="thesis"),
    pp.Projection(),
    pp.Projection(coupling="local"),
]


@pytest.fixture(scope="session")
def spatial() -> pp.Arm:
    return template_arm("RyRz", 10)


@pytest.fixture(scope="session")
def planar() -> pp.Arm:
    return template_arm("Rz", 24)


def bent(arm: pp.Arm, seed: int) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-0.4, 0.4, arm.nv)


def regions(arm: pp.Arm) -> list[tuple[int, int]]:
    m = arm.n_modules
    return [(0, m // 2), (2, m - 3), (m // 2, m - 1), (m - 1, m - 1)]


def test_a_region_is_a_copy_with_weight_only_inside(planar: pp.Arm) -> None:
    weights = np.tile([2.0, 0.0, 1.0], 8)
    whole = replace(pp.Target.from_configuration(planar, bent(planar, 0)), weights=weights)
    part = whole.region(3, np.int64(9))
    np.testing.assert_array_equal(part.weights[3:10], weights[3:10])
    assert not part.weights[:3].any()
    assert not part.weights[10:].any()
    np.testing.assert_array_equal(whole.weights, weights)
    np.testing.assert_array_equal(part.q, whole.q)
    np.testing.assert_array_equal(part.points, whole.points)
    assert np.flatnonzero(part.region(5, 20).has_target).tolist() == [5, 6, 8, 9]
    np.testing.assert_array_equal(whole.region(0, 23).weights, weights)


def test_a_region_of_a_partial_target_has_the_points_with_a_place(spatial: pp.Arm) -> None:
    curve = pp.Curve.line((0, 0, 0), (0.31, 0, 0))
    partial = pp.resolve_targets(spatial, curve, incomplete="partial")
    assert np.flatnonzero(partial.has_target).tolist() == [0, 1, 2, 3, 4, 5]
    part = partial.region(4, 8)
    assert np.flatnonzero(part.has_target).tolist() == [4, 5]
    assert part.incomplete == partial.incomplete
    assert part.curve is partial.curve
    with pytest.raises(InvalidValue, match=r"region is \(6, 9\).*: 0, 1, 2, 3, 4, 5$"):
        partial.region(6, 9)


@pytest.mark.parametrize(
    ("first", "last", "message"),
    [
        (-1, 3, "first is -1; allowed: a whole number from 0 to 23"),
        (4, 3, "last is 3; allowed: a whole number from 4 to 23"),
        (0, 24, "last is 24; allowed: a whole number from 0 to 23"),
        (0.0, 3, "first is 0.0"),
        (True, 3, "first is True"),
        (0, "tip", "last is 'tip'"),
    ],
)
def test_what_is_no_region_is_named(planar: pp.Arm, first: int, last: int, message: str) -> None:
    with pytest.raises(InvalidValue, match=message):
        pp.Target.from_configuration(planar, bent(planar, 0)).region(first, last)


@pytest.mark.parametrize("name", ["spatial", "planar"])
@pytest.mark.parametrize("controller", THESIS, ids=str)
def test_a_run_uses_and_counts_the_region_only(
    request: pytest.FixtureRequest, name: str, controller: Controller
) -> None:
    arm = request.getfixturevalue(name)
    start = bent(arm, 1)
    whole = pp.Target.from_configuration(arm, bent(arm, 2))
    for first, last in regions(arm):
        target = whole.region(first, last)
        run = pp.track(arm, target, start, controller, max_steps=25)
        outside = np.delete(np.arange(arm.n_modules), np.arange(first, last + 1))
        assert run.active.any()
        assert not run.active[:, outside].any()
        distances = np.linalg.norm(run.points - whole.points, axis=2)[:, first : last + 1]
        np.testing.assert_allclose(run.posture_error, distances.sum(axis=1), atol=1e-12)
        # Where the other points should have gone makes no difference at all.
        elsewhere = whole.points.copy()
        elsewhere[outside] += 10.0
        again = pp.track(arm, replace(target, points=elsewhere), start, controller, max_steps=25)
        np.testing.assert_array_equal(again.q, run.q)
        # Joints beyond the region move none of its points, so they stay where they are.
        beyond = arm.moved > arm.support[last]
        np.testing.assert_allclose(run.q[:, beyond], np.tile(start[beyond], (len(run.q), 1)), atol=1e-12)


@pytest.mark.parametrize(("first", "last"), [(1, 20), (5, 14), (10, 23), (7, 7)])
def test_the_tree_of_sections_begins_where_the_region_does(planar: pp.Arm, first: int, last: int) -> None:
    target = pp.Target.from_configuration(planar, bent(planar, 2)).region(first, last)
    for score in ("thesis", "geometric", "auto"):
        active = pp.Selection(score=score).step(planar.at(bent(planar, 1)), target).active
        assert active[0] == first
        assert last - 1 <= active[-1] <= last
        assert set(np.diff(active)) <= {2, 3}
    from_base = pp.Target.from_configuration(planar, bent(planar, 2)).region(0, last)
    assert pp.Selection().step(planar.at(bent(planar, 1)), from_base).active[0] in (1, 2)


def test_a_region_that_is_reached_counts_as_converged_while_the_rest_is_elsewhere(planar: pp.Arm) -> None:
    start = bent(planar, 1)
    there = start.copy()
    there[20:] += 0.5  # the same posture up to control point 19
    run = pp.track(planar, pp.Target.from_configuration(planar, there).region(4, 19), start)
    assert run.converged
    assert run.steps == 0
    assert not pp.track(planar, pp.Target.from_configuration(planar, there), start, max_steps=1).converged


@pytest.mark.parametrize("name", CONTROLLERS)
def test_no_controller_looks_at_the_targets_of_free_points(
    planar: pp.Arm, spatial: pp.Arm, name: str
) -> None:
    for arm in (spatial, planar):
        whole = pp.Target.from_configuration(arm, bent(arm, 2))
        elsewhere = whole.points.copy()
        elsewhere[[0, 1, -2, -1]] += 10.0
        runs = [
            pp.track(arm, target.region(2, arm.n_modules - 3), bent(arm, 1), name, max_steps=10)
            for target in (whole, replace(whole, points=elsewhere))
        ]
        np.testing.assert_array_equal(runs[0].q, runs[1].q)
        np.testing.assert_array_equal(runs[0].posture_error, runs[1].posture_error)
        assert not runs[0].active[:, [0, 1, -2, -1]].any()
