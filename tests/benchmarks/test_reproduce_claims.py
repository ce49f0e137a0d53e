"""Verdicts on claims: the rule, the counting, and that every claim has its measure."""

from __future__ import annotations

import re

import numpy as np
import pytest
from handmade import one
from hypothesis import given
from hypothesis import strategies as st
from sampling import examples

import pinposture as pp
from benchmarks.reproduce import evaluate
from benchmarks.reproduce.claims import CLAIMS
from benchmarks.reproduce.measures import RULES, Share, judge, share
from benchmarks.reproduce.runs import DEFAULT, READINGS, VARIANTS, Descent, Reading, thesis_arm

USUALLY = RULES["usually"]


@pytest.mark.parametrize(
    ("shares", "verdict"),
    [
        ([(9, 10), (10, 10)], "holds"),
        ([(9, 10), (8, 10)], "holds partly"),
        ([(9, 10), (0, 10)], "holds partly"),
        ([(5, 10)], "holds partly"),
        ([(4, 10), (0, 10)], "does not hold"),
        ([(10, 10), (0, 0)], "holds"),
        ([(0, 0)], "not seen"),
        ([], "not seen"),
    ],
)
def test_a_claim_is_judged_by_its_shares(shares, verdict):
    assert judge({str(i): Share(*each) for i, each in enumerate(shares)}, USUALLY) == verdict


def test_a_single_exception_refutes_what_is_said_of_every_case():
    assert judge({"": Share(999, 1000)}, RULES["always"]) == "does not hold as stated"
    assert judge({"": Share(1000, 1000)}, RULES["always"]) == "holds"
    assert judge({"": Share(0, 1000), "other": Share(0, 0)}, RULES["always"]) == "does not hold"


@given(truths=st.lists(st.booleans()))
@examples(30)
def test_shares_count(truths):
    found = share(truths)
    assert (found.true, found.cases) == (truths.count(True), len(truths))
    assert found.value * max(len(truths), 1) == pytest.approx(truths.count(True))


def test_every_claim_has_one_measure_a_rule_and_the_runs_it_needs():
    assert set(evaluate.MEASURES) == set(CLAIMS)
    for claim in CLAIMS.values():
        assert claim.rule in RULES
        assert re.search(r"\d|Abstract|Appendix", claim.where)
        assert set(claim.methods) <= {"selection", "projection", "switching"}
        assert claim.text.endswith(".") and not claim.measured.endswith(".")
    assert len({(batch.scenario, batch.variant) for batch in evaluate.BATCHES}) == len(evaluate.BATCHES)
    used = {batch.variant for batch in evaluate.BATCHES}
    assert used == set(VARIANTS) >= {name for names in READINGS.values() for name in names.values()}


def judged(claim, pool):
    """The shares of a claim on runs by scenario and variant."""
    finding = evaluate.MEASURES[claim](Reading(pool, READINGS[DEFAULT]))
    return {name: (each.true, each.cases) for name, each in finding.shares.items()}


def test_runs_that_end_close_enough_count_as_arrived():
    pool = {("helix", "selection"): [one((1, 0.01)), one((1, 0.0101)), one((0.2, 0.005))]}
    assert judged("tracks-arbitrary", pool) == {"spatial, random -> helix, selection": (2, 3)}


def test_methods_are_compared_seed_by_seed():
    pool = {
        ("line", "selection"): [one((1, 0.1)), one((1, 0.1)), one((1, 1e-7)), one((1, 0.1))],
        ("line", "projection"): [one((1, 0.05)), one((1, 0.2)), one((1, 5e-7)), one((1, 0.1))],
    }
    # Lower, higher, both converged, equal.
    assert judged("projection-lower-singular", pool) == {"spatial, random -> line": (2, 4)}
    helix = {("helix", variant): runs for (_, variant), runs in pool.items()}
    # Within a factor of 2, at it, both close, equal.
    assert judged("similar-performance", helix) == {"spatial, random -> helix": (4, 4)}


def test_switching_must_beat_both_parts():
    scenario = "planar-near-line"
    pool = {
        (scenario, "selection"): [one((1, 0.1))] * 3,
        (scenario, "projection"): [one((1, 0.01))] * 3,
        (scenario, "switching, Figure 4.8"): [one((1, 0.005)), one((1, 0.05)), one((1, 0.2))],
    }
    assert judged("switching-lower", pool) == {"planar, random -> near line": (1, 3)}


def test_a_few_steps_are_counted_to_where_a_run_comes_close():
    early = one([1.0] * 50 + [0.005, 0.004])
    late = one([1.0] * 51 + [0.005])
    lost = one([1.0, 0.005, 0.5])
    pool = {("planar-random", "selection"): [early, late, lost]}
    assert list(judged("selection-few-steps", pool).values()) == [(1, 3)]


def test_monotone_runs_have_no_rising_step():
    pool = {("helix", "selection"): [one((3, 2, 1)), one((3, 1, 2))]}
    assert list(judged("selection-monotone", pool).values()) == [(1, 2)]
    assert list(judged("null-space-descends", pool).values()) == [(3, 4)]
    turned = {("helix", "projection"): pool["helix", "selection"]}
    assert list(judged("projection-not-monotone", turned).values()) == [(1, 2)]


def test_active_points_that_rise_are_exceptions():
    pool = {("helix", "selection"): [one(descent=Descent(2, 0, 0, 1, 20, 3, 10, 0, 5)), one()]}
    assert list(judged("active-points-descend", pool).values()) == [(17 + 10, 30)]
    assert list(judged("point-errors-not-monotone", pool).values()) == [(1, 2)]


def test_stranded_runs_have_run_out_of_points_however_many_they_had_last():
    runs = [
        one(points=[10], status="no_control_points"),
        one(points=[10, 5], errors=(3, 2, 1)),
        one(points=[10]),
    ]
    pool = {("line", "selection"): runs}
    assert list(judged("selection-runs-out", pool).values()) == [(2, 3)]
    assert list(judged("selection-stranded", pool).values()) == [(1, 3)]


def test_runs_without_a_step_did_not_start():
    pool = {("from-straight", "selection"): [one([1.0]), one()]}
    assert list(judged("selection-cannot-start", pool).values()) == [(1, 2)]


def test_predictable_runs_are_direct_and_insensitive():
    runs = [
        one(path_length_ratio=1.5, separation=1e-3),
        one(path_length_ratio=1.6, separation=0.0),
        one(path_length_ratio=1.0, separation=0.01),
    ]
    assert list(judged("selection-predictable", {("helix", "selection"): runs}).values()) == [(1, 3)]
    assert list(judged("projection-unpredictable", {("helix", "projection"): runs}).values()) == [(2, 3)]
    without = {("helix", "selection"): [one()], ("helix", "projection"): [one()]}  # twins
    assert list(judged("selection-predictable", without).values()) == [(0, 0)]
    assert list(judged("projection-unpredictable", without).values()) == [(0, 0)]


def test_only_steps_near_a_singular_posture_are_judged_there():
    run = one((4, 3, 2, 1), [9] * 3, nearness=[0.2, 0.01, 0.029], asked=[9.0, 3.2, 3.0], turn=[2, 0.4, 0.6])
    pool = {("line", "selection"): [run]}
    assert list(judged("stable-near-singular", pool).values()) == [(1, 2)]
    assert list(judged("smooth-near-singular", pool).values()) == [(1, 2)]


def test_steps_are_told_apart_by_their_nearness_to_a_singular_posture():
    run = one((4, 3, 2, 1), [9] * 3, nearness=[0.2, 0.01, 0.029], asked=[9.0, 3.2, 3.0], turn=[2, 0.4, 0.6])
    reading = Reading({("line", "selection"): [run]}, READINGS[DEFAULT])
    (asked,) = {each.quantity for each in evaluate.MEASURES["stable-near-singular"](reading).by_nearness}
    found = evaluate.MEASURES["stable-near-singular"](reading).by_nearness
    assert [(each.low, each.high, each.steps, each.median, each.largest) for each in found] == [
        (0.01, 0.03, 2, pytest.approx(3.1), 3.2),
        (0.1, float("inf"), 1, 9.0, 9.0),
    ]
    assert "[rad]" in asked


def test_a_blow_up_is_an_error_that_doubles_after_coming_near():
    calm = one((9, 3, 1, 1.9), [9] * 3, nearness=[0.2, 0.2, 0.01])
    wild = one((9, 1, 0.4, 2.1), [9] * 3, nearness=[0.2, 0.01, 0.2])
    far = one((1, 9, 9), nearness=[0.2, 0.2])
    pool = {("line", "selection"): [calm, wild, far], ("line", "selection, any step"): [wild]}
    assert judged("no-blow-up", pool) == {
        "spatial, random -> line, selection": (1, 2),
        "spatial, random -> line, selection, any step": (0, 1),
    }


def test_passing_is_to_come_near_a_singular_posture_and_to_leave_it():
    errors, points = (4, 3, 2, 1), [9] * 3
    passed = one(errors, points, nearness=[0.2, 0.02, 0.07])
    stuck = one(errors, points, nearness=[0.2, 0.02, 0.05])
    away = one(errors, points, nearness=[0.2, 0.04, 0.2])
    departed = one(errors, points, nearness=[0.02, 0.04, 0.2])
    bound = one(errors, points, nearness=[0.2, 0.02, 0.02], goal_nearness=0.02)
    pool = {("opposite", "projection"): [passed, passed, stuck, away, departed, bound]}
    assert list(judged("projection-passes", pool).values()) == [(2, 3)]
    pool = {("opposite", "selection"): [passed, passed, stuck, away, departed, bound]}
    assert list(judged("selection-cannot-pass", pool).values()) == [(1, 3)]
    # Where fewer than a tenth come near, nothing was seen.
    pool = {("opposite", "selection"): [passed] + [away] * 10}
    assert list(judged("selection-cannot-pass", pool).values()) == [(0, 0)]


def test_what_cannot_fail_is_said_to_hold_by_construction():
    pool = {
        ("helix", "projection"): [one((2, 1), [20])],
        ("helix", "projection, kappa 0.6"): [one((2, 1), [20])],
    }
    found = evaluate._judged(CLAIMS["projection-uses-all"], evaluate.Evidence(pool, [], 1, 2))
    assert found.verdict == "holds by construction"
    assert {name: verdict for name, (verdict, _) in found.readings.items()} == {"kappa 0.6": "holds"}


def test_kappa_below_a_half_leaves_no_point_out_and_above_it_does():
    # Closed form: the module of equal links has singular values |cos(q1 / 2)|^2 and 1/2, per length.
    arm = thesis_arm("ryrz20")
    q = np.tile([0.0, 1.9], 20)  # bent by more than a right angle: (1 + cos 1.9) / 2 = 0.34
    everything = np.ones(20, dtype=bool)
    for threshold, count in ((0.2, 20), (0.49, 20), (0.51, 0)):
        controller = pp.Projection(threshold=threshold)
        _, _, active, _ = controller.posture_control_matrix(arm.at(q), np.zeros((20, 3)), everything)
        assert len(active) == count


def test_a_controller_of_the_users_own_is_judged_by_the_general_claims():
    pool = {
        ("helix", "selection"): [one((1, 0.5))],
        ("helix", "mine"): [one((1, 0.001)), one((1, 0.5))],
        ("line", "mine, any step"): [one((1, 0.001))],
    }
    evidence = evaluate.Evidence(pool, [], 1, 2, own=("mine",))
    found = evaluate._judged(CLAIMS["tracks-arbitrary"], evidence)
    assert found.verdict == "does not hold"
    verdict, finding = found.own["mine"]
    assert (verdict, finding.shares) == ("holds partly", {"spatial, random -> helix, mine": Share(1, 2)})
    _, finding = evaluate._judged(CLAIMS["stable-without-step-limit"], evidence).own["mine"]
    assert finding.shares == {"spatial, random -> line, mine, any step": Share(1, 1)}
    assert not evaluate._judged(CLAIMS["selection-cannot-pass"], evidence).own


def test_general_claims_have_runs_of_the_users_controller():
    batches = evaluate.own_batches({"mine": pp.Projection()})
    assert all(batch.given is not None for batch in batches)
    assert {batch.scenario for batch in batches if batch.twins} == set(evaluate.measures.TWINS)
    pool = {(batch.scenario, batch.variant): [one()] for batch in batches}
    evidence = evaluate.Evidence(pool, [], 1, 2, own=("mine",))
    for claim in CLAIMS.values():
        assert bool(evaluate._judged(claim, evidence).own) is claim.general


def test_points_are_counted_by_the_step():
    pool = {
        ("planar-random", "selection"): [one((2, 1), [4]), one((3, 2, 1), [5, 20])],
        ("planar-random", "projection"): [one((2, 1), [20]), one((3, 2, 1), [20, 20])],
    }
    assert list(judged("many-points", pool).values()) == [(2, 3), (3, 3)]
    assert list(judged("projection-uses-all", pool).values()) == [(3, 3)]
    assert list(judged("projection-more-points", pool).values()) == [(2, 2)]


def test_ranks_are_counted_by_the_step():
    pool = {("helix", "projection"): [one((3, 2, 1), deficient=1), one()]}
    assert list(judged("projection-full-rank", pool).values()) == [(2, 3)]


def test_other_readings_are_judged_apart_and_only_where_they_differ():
    pool = {
        ("helix", "selection"): [one((1, 0.001))],
        ("helix", "projection"): [one((1, 0.001))],
        ("helix", "projection, local"): [one((1, 0.5))],
    }
    evidence = evaluate.Evidence(pool, [], 1, 2)
    found = evaluate._judged(CLAIMS["tracks-arbitrary"], evidence)
    assert found.verdict == "holds"
    assert {name: verdict for name, (verdict, _) in found.readings.items()} == {
        "(5.9) as printed": "does not hold"
    }
    ((_, finding),) = found.readings.values()
    assert list(finding.shares) == ["spatial, random -> helix, projection"]
    assert not evaluate._judged(CLAIMS["selection-monotone"], evidence).readings
