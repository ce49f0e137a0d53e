"""Measures of runs, against runs made by hand and formulas that share no code with them."""

from __future__ import annotations

import numpy as np
import pytest
from arms import template_arm
from handmade import made

import pinposture as pp
from benchmarks.reproduce import runs
from benchmarks.reproduce.runs import RunSet, measure, run_one, thesis_arm
from pinposture.control import controller_named


def flat():
    return template_arm("Rz", 3, (0.1,))


def spatial():
    return template_arm("RyRz", 4)


def test_separation_is_the_largest_distance_and_a_run_that_ended_waits():
    run = made(flat(), [[0, 0, 0], [0.1, 0, 0], [0.2, 0, 0]])
    assert runs.separation(run, run) == 0.0
    other = made(flat(), [[0, 0, 0], [0.1, 0, 0]])
    # The tip is 0.3 m from the base, which is the length: a turn by 0.1 rad moves it by a chord.
    assert runs.separation(run, other) == pytest.approx(2 * np.sin(0.05))
    assert runs.separation(other, run) == pytest.approx(2 * np.sin(0.05))


def test_turns_of_steps_that_go_on_turn_square_reverse_and_stop():
    dq = np.array([[1, 0], [1, 0], [0, 1], [0, -1], [0, -0.5], [0, 0], [0, 0]], dtype=float)
    np.testing.assert_allclose(runs.turns(dq), [0, 0, np.sqrt(2), 2, 0.5, 1, 0])
    assert runs.turns(np.zeros((0, 2))).shape == (0,)
    assert runs.turns(dq[:1]).tolist() == [0]


def test_changes_of_the_active_set_are_shares_of_what_either_holds():
    active = np.array(
        [[1, 1, 0, 0], [1, 1, 0, 0], [1, 0, 1, 0], [0, 0, 0, 1], [0, 0, 0, 0], [0, 0, 0, 0]], bool
    )
    np.testing.assert_allclose(runs.set_changes(active), [0, 0, 2 / 3, 1, 1, 0])
    assert runs.set_changes(active[:0]).shape == (0,)


def test_nearness_is_the_smallest_singular_value_and_zero_for_the_straight_arm():
    for arm in (flat(), spatial()):
        assert runs.nearness(arm.at(arm.straight())) == pytest.approx(0.0, abs=1e-9)
        q = np.random.default_rng(2).uniform(-1, 1, arm.nv)
        jacobian = arm.at(q).jacobians[-1][: arm.dimension]
        assert runs.nearness(arm.at(q)) == pytest.approx(
            np.linalg.svd(jacobian, compute_uv=False)[-1] / arm.length, rel=1e-9
        )


def test_nearness_of_two_links_in_closed_form():
    arm = pp.Arm.from_template("Rz", modules=2, link_lengths=(1.0,))
    bend = 0.7
    # J J^T of the tip of two unit links: determinant sin^2, trace 3 + 2 cos.
    trace = 3 + 2 * np.cos(bend)
    least = (trace - np.sqrt(trace**2 - 4 * np.sin(bend) ** 2)) / 2
    assert runs.nearness(arm.at([0.3, bend])) == pytest.approx(np.sqrt(least) / 2)


@pytest.mark.parametrize("make", [flat, spatial])
def test_error_slopes_are_the_derivatives_of_the_errors(make):
    arm, rng = make(), np.random.default_rng(4)
    q, dq = rng.uniform(-1, 1, arm.nv), rng.normal(size=arm.nv)
    goals = rng.normal(size=(arm.n_modules, 3)) * arm.length
    placed = np.arange(arm.n_modules) != 1

    def distances(t):
        return np.linalg.norm(arm.at(q + t * dq).points - goals, axis=1)

    slopes = runs.error_slopes(arm.at(q), goals, placed, dq)
    expected = (distances(1e-6) - distances(-1e-6)) / 2e-6
    np.testing.assert_allclose(slopes[placed], expected[placed], atol=1e-8)
    assert slopes[1] == 0.0
    there = runs.error_slopes(arm.at(q), arm.at(q).points, np.ones(arm.n_modules, bool), dq)
    assert not there.any()


def test_rising_errors_are_counted_and_those_of_active_points_apart():
    errors = [[3.0, 1.0, 1.0], [2.0, 1.5, 1.0], [2.1, 1.7, 1.0], [2.1, 1.6, 0.5]]
    active = [[1, 1, 0], [0, 1, 1], [1, 0, 0]]
    q = np.zeros((4, 3))
    run = made(flat(), q, active=active, point_errors=np.array(errors))
    found = runs.descent(run, runs.states_before_steps(run))
    assert (found.steps, found.rose, found.points_rose) == (3, 1, 3)
    assert (found.active, found.active_rose) == (5, 2)
    assert (found.uphill, found.active_uphill) == (0, 0)  # nothing moved


def test_steps_uphill_are_told_by_their_first_direction_alone():
    # The tip swings from 40 degrees by 80 past its target at 45 degrees: first towards it, in the end away.
    arm = pp.Arm.from_template("Rz", modules=2, link_lengths=(1.0,))
    start, end, goal = (np.radians(angle) for angle in (40.0, 120.0, 45.0))
    target = arm.at([goal, 0.0]).points
    over = made(arm, [[start, 0], [end, 0]], target)
    found = runs.descent(over, runs.states_before_steps(over))
    assert (found.rose, found.uphill, found.active_rose, found.active_uphill) == (1, 0, 2, 0)
    away = made(arm, [[start, 0], [start - 0.1, 0]], target)
    found = runs.descent(away, runs.states_before_steps(away))
    assert (found.rose, found.uphill, found.active_rose, found.active_uphill) == (1, 1, 2, 2)
    stopped = made(arm, [[start, 0], [start - 0.1, 0]], target, clipped=np.array([[True, False]]))
    found = runs.descent(stopped, runs.states_before_steps(stopped))
    assert (found.clipped, found.active_free, found.active_uphill, found.uphill) == (1, 0, 0, 1)


def test_matrices_of_less_than_full_rank_are_counted_and_empty_ones_are_not():
    q = np.zeros((4, 3))
    run = made(flat(), q, info={"sigma_min": np.array([0.0, 0.0, 1e-3]), "rows": np.array([4, 0, 4])})
    states = runs.states_before_steps(run)
    assert runs.deficient_steps(run, states, [(), (), ()]) == (1, 0)


def test_points_that_were_dropped_count_for_the_rank():
    # Neighbours of one-joint modules conflict in every posture (Appendix A); points two joints apart do not
    # unless the section between them is straight.
    arm = flat()
    q = np.array([[0.3, 0.4, 0.5]] * 3)
    active = [[0, 0, 1], [0, 0, 1]]
    run = made(arm, q, active=active, info={"rows": np.array([2, 2])})
    states = runs.states_before_steps(run)
    assert runs.deficient_steps(run, states, [(1,), ()]) == (1, 1)
    run = made(template_arm("Rz", 4, (0.1,)), np.full((2, 4), 0.4), active=[[0, 0, 0, 1]])
    states = runs.states_before_steps(run)
    assert runs.deficient_steps(run, states, [(1,)]) == (0, 1)


@pytest.mark.parametrize("controller", ["selection", "projection"])
def test_what_was_asked_is_what_would_be_done_without_a_limit(controller):
    arm, rng = spatial(), np.random.default_rng(5)
    q = rng.uniform(-0.3, 0.3, arm.nv)
    target = pp.Target.from_configuration(arm, q + rng.uniform(-0.05, 0.05, arm.nv))
    run = pp.track(arm, target, q, controller, pp.Limits(step=1e-3), max_steps=4)
    steps = runs.per_step(run, runs.states_before_steps(run))
    for k in range(run.steps):
        free = controller_named(controller).step(arm.at(run.q[k]), target, pp.Limits(step=None))
        assert not free.clipped.any()
        assert steps.asked[k] == pytest.approx(np.abs(free.dq).max(), rel=1e-6)


def test_a_measurement_tells_of_its_run():
    batch = RunSet("helix", "selection", twins=True)
    found, run = measure(batch, 0, max_steps=6), run_one(batch, 0, max_steps=6)
    twin = run_one(batch, 0, max_steps=6, nudged=True)
    assert 0.0 < np.abs(twin.q[0] - run.q[0]).max() <= 1e-6
    assert found.separation == runs.separation(run, twin) > 0.0
    np.testing.assert_allclose(found.mean_errors, run.point_errors.mean(axis=1), rtol=1e-12)  # it is 1 m long
    np.testing.assert_array_equal(found.points, run.active.sum(axis=1))
    assert (found.modules, found.outcome.steps) == (20, 6)
    assert all(len(values) == 6 for values in found.steps)
    assert found.off_curve == pytest.approx(run.target.residual.max())


def test_joints_without_limits_go_beyond_half_a_turn():
    assert thesis_arm("ryrz20").limits.upper.max() == pytest.approx(np.pi)
    assert thesis_arm("ryrz20", free=True).limits.upper.min() > 100.0
    start = run_one(RunSet("helix", "selection"), 1, max_steps=1).q[0]
    free = run_one(RunSet("helix", "selection, free joints"), 1, max_steps=1).q[0]
    np.testing.assert_array_equal(start, free)
