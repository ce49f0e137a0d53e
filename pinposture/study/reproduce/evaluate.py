"""Every claim of the thesis, measured and judged."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import NamedTuple

from pinposture.study.reproduce import choosing, moving, postures, singular, tracking
from pinposture.study.reproduce.postures import Counted, count_postures
from pinposture.study.reproduce.reading import DEFAULT, READINGS, Reading
from pinposture.study.reproduce.runs import MAX_STEPS, Pool, RunSet, make_pool
from pinposture.study.reproduce.verdicts import RULES, Finding, Verdict, judge
from pinposture.thesis.claims import CLAIMS, Claim

MEASURES: Mapping[str, Callable[[Reading], Finding]] = (
    dict(tracking.MEASURES) | dict(moving.MEASURES) | dict(singular.MEASURES) | dict(choosing.MEASURES)
)
"""How each claim is measured on runs; those on postures are in `postures.MEASURES`."""

_FOUR = ("selection", "projection", "projection, local", "switching")
_FREE = ("selection, free joints", "projection, free joints")

BATCHES: tuple[RunSet, ...] = (
    *(RunSet(s, v, twins=True) for s in moving.TWINS for v in _FOUR),
    *(RunSet(s, v) for s in ("random", "line", "planar-near-line") for v in _FOUR),
    *(RunSet(s, "switching, no waypoints", twins=s in moving.TWINS) for s in choosing.SWITCHED),
    *(RunSet(s, v) for s in tracking.FROM_STRAIGHT for v in _FOUR[:3]),
    *(RunSet(s, v) for s in tracking.ACROSS for v in tracking.BOTH),
    *(RunSet(s, "selection") for s in tracking.FROM_NEAR_STRAIGHT),
    *(RunSet(s, "selection, (4.8)") for s in ("planar-random", "planar-near-line")),
    *(RunSet(s, v) for s in ("helix", "line") for v in _FREE),
    *(RunSet(s, f"{method}, any step") for s in tracking.SINGULAR for method in tracking.BOTH),
)
"""The runs that the claims are judged by."""


class JudgedClaim(NamedTuple):
    """A claim and what came of it.

    Attributes:
        claim: the claim.
        verdict: whether it holds.
        finding: what was measured.
        readings: what was measured, and whether it holds, where the thesis is read differently.
    """

    claim: Claim
    verdict: Verdict
    finding: Finding
    readings: Mapping[str, tuple[Verdict, Finding]]


class Evidence(NamedTuple):
    """What claims are judged by.

    Attributes:
        pool: the runs.
        counted: the postures.
        seeds: number of seeds of either.
        max_steps: steps after which a run ended.
    """

    pool: Pool
    counted: list[Counted]
    seeds: int
    max_steps: int


def gather(
    seeds: int = 100,
    max_steps: int = MAX_STEPS,
    jobs: int = 1,
    progress: Callable[[int], object] | None = None,
) -> Evidence:
    """Make the runs and look at the postures that claims are judged by.

    Args:
        seeds: number of seeds, from 0.
        max_steps: steps after which a run ends.
        jobs: number of processes; the result does not depend on it.
        progress: called with the number of runs that have just been finished, of `seeds * len(BATCHES)`.
    """
    counted = count_postures(seeds, jobs)
    return Evidence(make_pool(BATCHES, seeds, max_steps, jobs, progress), counted, seeds, max_steps)


def judge_claims(evidence: Evidence) -> list[JudgedClaim]:
    """Measure and judge every claim, in the order of CLAIMS."""
    return [_judged(claim, evidence) for claim in CLAIMS.values()]


def _judged(claim: Claim, evidence: Evidence) -> JudgedClaim:
    rule = RULES[claim.rule]
    if claim.id in postures.MEASURES:
        finding = postures.MEASURES[claim.id](evidence.counted)
        return JudgedClaim(claim, judge(finding.shares, rule), finding, {})
    found: dict[str, tuple[Verdict, Finding]] = {}
    for name, variants in READINGS.items():
        reading = Reading(evidence.pool, variants)
        if reading.concerns(claim.methods):
            finding = MEASURES[claim.id](reading)
            found[name] = (judge(finding.shares, rule), finding)
    verdict, finding = found.pop(DEFAULT)
    tried = {name: other for name, other in found.items() if other[0] != "not seen"}
    return JudgedClaim(claim, verdict, finding, tried)
