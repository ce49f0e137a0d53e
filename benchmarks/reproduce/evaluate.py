"""Measurement of claims about postures, and verdicts on all claims."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from functools import partial
from itertools import product
from typing import NamedTuple

import numpy as np
from joblib import delayed
from numpy.typing import NDArray

from benchmarks.cases.scenarios import arbitrary_configuration
from benchmarks.harness import Row
from benchmarks.reproduce import measures
from benchmarks.reproduce.claims import CLAIMS, Claim
from benchmarks.reproduce.measures import RULES, Finding, Share, Verdict, judge, share
from benchmarks.reproduce.runs import (
    ANY_STEP,
    ARM_NAMES,
    DEFAULT,
    READINGS,
    SWITCHING_READINGS,
    THESIS_STEPS,
    Pool,
    Reading,
    RunSet,
    Variant,
    has_full_rank,
    make_pool,
    stacked,
    thesis_arm,
)
from pinposture.arm import Arm
from pinposture.control import Controller
from pinposture.motion.processes import in_order

Array = NDArray[np.float64]

KINDS = ("smooth", "any")
"""Postures like the arbitrary ones of the runs, and with every joint anywhere within its limits."""

THRESHOLDS = (1e-3, 1e-2, 1e-1)
"""Thresholds tried for both conditions; the thesis gives none, Selection uses the first."""

CONDITIONING = 1e-4
"""Smallest singular value, per arm length, of a matrix that counts as far from singular [1/rad]."""

DRAWS = 3
"""Number of postures of each kind per seed."""


def count_postures(seeds: int, jobs: int = 1, first: int = 0) -> list[Row]:
    """Count over random postures of both arms; the result only depends on the seeds."""
    cases = product(ARM_NAMES, range(first, first + seeds))
    tasks = (delayed(_count)(name, seed) for name, seed in cases)
    return [each for listed in in_order(tasks, jobs) for each in listed]


def _count(name: str, seed: int) -> list[Row]:
    arm, counted = thesis_arm(name), list[Row]()
    rng = np.random.default_rng((seed, 2))
    for kind in KINDS:
        for _ in range(DRAWS):
            q = arbitrary_configuration(arm, rng) if kind == "smooth" else arm.random(rng)
            counted.extend(count_posture(arm, name, kind, q, rng))
    return counted


def count_posture(arm: Arm, name: str, kind: str, q: Array, rng: np.random.Generator) -> list[Row]:
    """Count at one posture for each of THRESHOLDS; the generator draws sets and a section.

    Returns:
        arm: name of the arm.
        kind: kind of posture.
        threshold: value that indices must exceed to meet a condition.
        carried: whether no control point fails the absolute condition after an earlier one met it.
        drawn: whether a candidate control set could be drawn.
        pairs_clear: whether all pairs in it meet the relative condition.
        full_rank: whether its posture control matrix has full row rank.
        sigma_min: smallest singular value of that matrix, per arm length [1/rad]; 0 if there is none.
        section_deficient: whether two control points with a singular section between them stack to a matrix
            of less than full row rank.
    """
    state, counted = arm.at(q), list[Row]()
    indices = state.manipulability()
    deficient = _section_is_deficient(arm, q, rng)
    for threshold in THRESHOLDS:
        chosen = random_set(indices, threshold, rng)
        inside = indices[np.ix_(chosen, chosen)][np.triu_indices(len(chosen), 1)]
        matrix = stacked(state, [k - 1 for k in chosen])
        sigma = np.linalg.svd(matrix, compute_uv=False)
        counted.append(
            Row(
                arm=name,
                kind=kind,
                threshold=threshold,
                carried=carries_over(indices[0, 1:], threshold),
                drawn=len(chosen) > 0,
                pairs_clear=bool(np.all(inside > threshold)),
                full_rank=has_full_rank(matrix),
                sigma_min=float(sigma[-1]) / arm.length if len(sigma) else 0.0,
                section_deficient=deficient,
            )
        )
    return counted


def carries_over(indices: Array, threshold: float) -> bool:
    """Return whether no entry falls to the threshold after an earlier one exceeded it."""
    clears = indices > threshold
    return bool(np.all(clears[int(np.argmax(clears)) :])) if clears.any() else True


def random_set(indices: Array, threshold: float, rng: np.random.Generator) -> list[int]:
    """Draw a random candidate control set, as rows of the index matrix (1 is the first control point).

    Each next point is drawn from the nearest few admissible ones, so that sets have many points.
    """
    clears = indices[0] > threshold
    chosen: list[int] = []
    may = np.flatnonzero(clears)
    while len(may):
        chosen.append(int(rng.choice(may[:3])))
        may = np.flatnonzero(clears & (indices[chosen[-1]] > threshold))
    return chosen


def _section_is_deficient(arm: Arm, q: Array, rng: np.random.Generator) -> bool:
    """Return whether two control points with a singular section between them lack full row rank.

    The section is one module of the spatial arm, which has two joints for three directions, or two modules of
    the planar arm, of which the second is stretched.
    """
    positions, apart = arm.positions(q).copy(), 1 if arm.dimension == 3 else 2
    first = int(rng.integers(arm.n_modules // 4, arm.n_modules - apart))
    if apart == 2:
        positions[arm.columns[arm.module_starts[first + 2]]] = 0.0
    state = arm.at(arm.configuration(positions))
    return not has_full_rank(stacked(state, [first, first + apart]))


def _groups(counted: Iterable[Row], by_threshold: bool = True) -> dict[str, list[Row]]:
    groups: dict[str, list[Row]] = {}
    for each in counted:
        name = f"{ARM_NAMES[each.arm]}, {each.kind} postures"
        if by_threshold:
            name += f", threshold {each.threshold:g}"
        elif each.threshold != THRESHOLDS[0]:
            continue
        groups.setdefault(name, []).append(each)
    return groups


def _of_sets(groups: Mapping[str, list[Row]], true: Callable[[Row], bool]) -> dict[str, Share]:
    return {name: share(true(each) for each in listed if each.drawn) for name, listed in groups.items()}


def _carries(reading: Reading) -> Finding:
    shares = {
        name: share(each.carried for each in listed) for name, listed in _groups(reading.counted).items()
    }
    total = Share(sum(each.true for each in shares.values()), sum(each.cases for each in shares.values()))
    text = f"It fails in {total.cases - total.true} of {total.cases} cases: every point must be tested."
    return Finding(shares, {}, text)


def _pairs(reading: Reading) -> Finding:
    shares = _of_sets(_groups(reading.counted), lambda each: each.pairs_clear)
    failing = sum(each.cases - each.true for each in shares.values())
    text = f"In {failing} of {sum(each.cases for each in shares.values())} sets some pair does not clear it. "
    return Finding(shares, {}, text + "None needs to: neighbours suffice for full rank.")


def _full_rank_share(reading: Reading) -> Finding:
    return Finding(_of_sets(_groups(reading.counted), lambda each: each.full_rank), {}, "")


def _away(reading: Reading) -> Finding:
    groups = _groups(reading.counted)
    lowest = {
        name: min((each.sigma_min for each in listed if each.drawn), default=0.0)
        for name, listed in groups.items()
    }
    return Finding(
        _of_sets(groups, lambda each: each.sigma_min > CONDITIONING),
        {f"smallest of all, per arm length [1/rad]: {name}": value for name, value in lowest.items()},
        "Full rank is not yet good conditioning: the smallest singular value of all sets is "
        f"{min(lowest.values(), default=0.0):.1g} of the arm length per rad. Selection here drops points "
        "until the matrix itself is far enough from singular.",
    )


def _section(arm: str, text: str, reading: Reading) -> Finding:
    groups = _groups((each for each in reading.counted if each.arm == arm), by_threshold=False)
    shares = {name: share(each.section_deficient for each in listed) for name, listed in groups.items()}
    return Finding(shares, {}, text)


MEASURES: Mapping[str, Callable[[Reading], Finding]] = {
    **measures.MEASURES,
    "absolute-carries-over": _carries,
    "neighbours-suffice": _pairs,
    "conditions-give-full-rank": _full_rank_share,
    "conditions-keep-away": _away,
    "singular-section-planar": partial(_section, "planar45", ""),
    "singular-section-spatial": partial(
        _section,
        "ryrz20",
        "In space a section of one module has an index of 0, and its ends can be moved independently all the "
        "same: the condition is sufficient, not necessary. The proof is for planar arms.",
    ),
}
"""Measures of all claims by id, those of runs and those of postures."""


_PROJECTIONS = ("projection", "projection, full", "projection, local", "projection, kappa 0.6")
_SCORES = ("selection, (4.8)", "selection, (4.8) relative")
_TRIED = ("selection", *_PROJECTIONS, "switching, Figure 4.8", "switching")
_SCENARIOS = (*measures.NON_SINGULAR, *measures.SINGULAR)

BATCHES: tuple[RunSet, ...] = (
    *(RunSet(s, v, twins=s in measures.TWINS) for s in _SCENARIOS for v in _TRIED),
    *(
        RunSet(s, f"switching, {name}", s in measures.TWINS)
        for s in _SCENARIOS
        for name in SWITCHING_READINGS
    ),
    *(RunSet(s, v) for s in measures.FROM_STRAIGHT for v in ("selection", *_PROJECTIONS)),
    *(RunSet(s, v) for s in measures.ACROSS for v in ("selection", *_PROJECTIONS)),
    *(RunSet(s, "selection") for s in measures.FROM_NEAR_STRAIGHT),
    *(
        RunSet(s, v, twins=s in measures.TWINS)
        for s in ("planar-random", "planar-near-line")
        for v in _SCORES
    ),
    *(RunSet(s, f"{method}, free joints") for s in ("helix", "line") for method in measures.BOTH),
    *(RunSet(s, f"{v}, {ANY_STEP}") for s in measures.SINGULAR for v in ("selection", *_PROJECTIONS)),
    *(RunSet("planar-near-line", f"{v}, {ANY_STEP}") for v in _SCORES),
    *(RunSet("line", f"{method}, free joints, {ANY_STEP}") for method in measures.BOTH),
)
"""The runs by which the claims are judged."""


def own_batches(controllers: Mapping[str, Controller]) -> list[RunSet]:
    """Return the runs by which the general claims are judged for controllers, given by name."""
    return [
        batch
        for name, controller in controllers.items()
        for batch in (
            *(RunSet(s, name, s in measures.TWINS, Variant(controller)) for s in _SCENARIOS),
            *(RunSet(s, name, given=Variant(controller)) for s in measures.FROM_STRAIGHT),
            *(RunSet(s, name, given=Variant(controller)) for s in measures.ACROSS),
            *(RunSet(s, f"{name}, {ANY_STEP}", given=Variant(controller, None)) for s in measures.SINGULAR),
        )
    ]


class JudgedClaim(NamedTuple):
    """A claim with its verdict and measurements.

    Likewise for other readings of the thesis, and for the user's own controllers, by name.
    """

    claim: Claim
    verdict: Verdict
    finding: Finding
    readings: Mapping[str, tuple[Verdict, Finding]]
    own: Mapping[str, tuple[Verdict, Finding]] = {}


class Evidence(NamedTuple):
    """The runs and the counts at postures by which claims are judged, also for the user's own controllers."""

    pool: Pool
    counted: list[Row]
    seeds: int
    max_steps: int
    first: int = 0
    own: tuple[str, ...] = ()


def gather(
    seeds: int = 100,
    max_steps: int = THESIS_STEPS,
    jobs: int = 1,
    progress: Callable[[int], object] | None = None,
    first: int = 0,
    own: Mapping[str, Controller] | None = None,
) -> Evidence:
    """Collect the runs and postures by which claims are judged; they do not depend on `jobs`.

    Own controllers, by name, are judged as well. `progress` is called with the number of new finished runs,
    of `seeds` per set of BATCHES and `own_batches`.
    """
    counted = count_postures(seeds, jobs, first)
    batches = (*BATCHES, *own_batches(own or {}))
    pool = make_pool(batches, seeds, max_steps, jobs, progress, first)
    return Evidence(pool, counted, seeds, max_steps, first, tuple(own or ()))


def judge_claims(evidence: Evidence) -> list[JudgedClaim]:
    """Measure and judge all claims, in the order of CLAIMS."""
    return [_judged(claim, evidence) for claim in CLAIMS.values()]


def _judged(claim: Claim, evidence: Evidence) -> JudgedClaim:
    rule = RULES[claim.rule]

    def found(readings: Iterable[tuple[str, Reading]]) -> dict[str, tuple[Verdict, Finding]]:
        measured = {name: MEASURES[claim.id](reading) for name, reading in readings}
        return {name: (judge(finding.shares, rule), finding) for name, finding in measured.items()}

    pool, counted = evidence.pool, evidence.counted
    read = {name: Reading(pool, variants, counted=counted) for name, variants in READINGS.items()}
    tried = found((name, each) for name, each in read.items() if each.concerns(claim.methods))
    verdict, finding = tried.pop(DEFAULT)
    if claim.construction and verdict == "holds":
        verdict = "holds by construction"
    own = ((name, Reading(pool, READINGS[DEFAULT], name)) for name in evidence.own)
    return JudgedClaim(
        claim,
        verdict,
        finding,
        {name: other for name, other in tried.items() if other[0] != "not seen"},
        found(own) if claim.general else {},
    )
