"""Claims on where the arm gets to."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from pinposture.study.reproduce.reading import Reading, label, median
from pinposture.study.reproduce.runs import MeasuredRun
from pinposture.study.reproduce.verdicts import Finding, Share, share

THERE = 1e-2
"""Mean point error per arm length at which an arm has the target posture to the eye."""

CLOSE = 1e-3
"""The same at which little is left."""

EXACT = 1e-6
"""The same at which a run has converged and stops."""

ON_CURVE = 1e-5
"""Distance from a curve per arm length that sampling accounts for."""

FEW = 50
"""Steps that count as a few, at 0.1 rad per step."""

NON_SINGULAR = ("helix", "random", "planar-random")
SINGULAR = ("line", "planar-near-line")
FROM_STRAIGHT = ("from-straight", "planar-from-straight")
FROM_NEAR_STRAIGHT = ("near-straight", "planar-near-straight")
ACROSS = ("opposite", "planar-opposite")
BOTH = ("selection", "projection")


def final(run: MeasuredRun) -> float:
    """Mean point error at the end, per arm length."""
    return float(run.mean_errors[-1])


def arrived(run: MeasuredRun, within: float = THERE) -> bool:
    """Whether a run ends with a mean point error of at most that, per arm length."""
    return final(run) <= within


def lower(run: MeasuredRun, others: Sequence[MeasuredRun]) -> bool:
    """Whether a run ends with a lower error than others, or all of them have converged."""
    return all(final(run) < final(other) or max(final(run), final(other)) <= EXACT for other in others)


def errors_of(groups: Mapping[str, Sequence[MeasuredRun]]) -> dict[str, float]:
    """Median final errors, by what was tried."""
    return {
        f"median final error per arm length: {k}": median([final(r) for r in v]) for k, v in groups.items()
    }


def _shares(
    groups: Mapping[str, Sequence[MeasuredRun]], true: Callable[[MeasuredRun], bool]
) -> dict[str, Share]:
    return {name: share(true(run) for run in runs) for name, runs in groups.items()}


def _in_words(shares: Mapping[str, Share]) -> str:
    return "; ".join(f"{name}: {each.value:.0%}" for name, each in shares.items())


def _arrives(scenarios: Sequence[str], methods: Sequence[str]) -> Callable[[Reading], Finding]:
    def find(reading: Reading) -> Finding:
        groups = reading.each(scenarios, methods)
        close = _shares(groups, lambda run: arrived(run, CLOSE))
        halved = _shares(groups, lambda run: run.outcome.ratio <= 0.5)
        figures = errors_of(groups) | {f"within 0.1 %: {name}": each.value for name, each in close.items()}
        return Finding(
            _shares(groups, arrived), figures, f"The posture error is at least halved in {_in_words(halved)}."
        )

    return find


def _similar(reading: Reading) -> Finding:
    def alike(one: MeasuredRun, other: MeasuredRun) -> bool:
        low, high = sorted((final(one), final(other)))
        return high <= max(2.0 * low, CLOSE)

    pairs = reading.pairs(NON_SINGULAR, *BOTH)
    factors = {
        name: median([np.log10(max(final(b), EXACT) / max(final(a), EXACT)) for a, b in runs])
        for name, runs in pairs.items()
    }
    told = "; ".join(f"{name}: {10.0**value:.2g}" for name, value in factors.items())
    return Finding(
        {name: share(alike(a, b) for a, b in runs) for name, runs in pairs.items()},
        {f"median of log10(Projection / Selection): {name}": value for name, value in factors.items()},
        f"Final error of Projection relative to that of Selection, the median: {told}.",
    )


def _projection_lower(scenarios: Sequence[str]) -> Callable[[Reading], Finding]:
    def find(reading: Reading) -> Finding:
        pairs = reading.pairs(scenarios, *BOTH)
        shares = {name: share(lower(b, [a]) for a, b in runs) for name, runs in pairs.items()}
        figures = errors_of(reading.each(scenarios, BOTH))
        parts = [
            f"{name}: {median([final(a) for a, _ in runs]):.2g} by Selection, "
            f"{median([final(b) for _, b in runs]):.2g} by Projection"
            for name, runs in pairs.items()
        ]
        return Finding(shares, figures, f"Median final errors per arm length: {'; '.join(parts)}.")

    return find


def _converges(reading: Reading) -> Finding:
    groups = reading.each((*NON_SINGULAR, *SINGULAR), ("projection",))
    there = _shares(groups, arrived)
    return Finding(
        _shares(groups, lambda run: arrived(run, CLOSE)),
        errors_of(groups),
        f"A mean point error of at most 1 % of the arm length is reached in {_in_words(there)}.",
    )


def _few_steps(reading: Reading) -> Finding:
    groups = reading.each(("planar-random",), ("selection",))

    def steps(run: MeasuredRun) -> float:
        below = np.flatnonzero(run.mean_errors <= THERE)
        return float(below[0]) if len(below) else np.inf

    needed = [steps(run) for runs in groups.values() for run in runs]
    reached = [count for count in needed if np.isfinite(count)]
    return Finding(
        _shares(groups, lambda run: steps(run) <= FEW and arrived(run)),
        {"median steps to 1 %, of runs that come there": median(reached)} | errors_of(groups),
        f"{len(reached)} of {len(needed)} runs come within 1 %, in {median(reached):.0f} steps (median).",
    )


def _cannot_start(scenarios: Sequence[str]) -> Callable[[Reading], Finding]:
    def find(reading: Reading) -> Finding:
        groups = reading.each(scenarios, ("selection",))
        there = _shares(groups, arrived)
        figures = {f"end within 1 %: {name}": each.value for name, each in there.items()}
        text = f"Of all runs, these end within 1 % of the arm length: {_in_words(there)}."
        return Finding(_shares(groups, lambda run: run.outcome.steps == 0), figures, text)

    return find


def _departs(reading: Reading) -> Finding:
    groups = reading.each(FROM_STRAIGHT, ("projection",))
    ratios = {name: median([run.outcome.ratio for run in runs]) for name, runs in groups.items()}
    told = "; ".join(f"{name}: {value:.2g}" for name, value in ratios.items())
    return Finding(
        _shares(groups, lambda run: run.outcome.ratio <= 0.5),
        {f"median ratio of final to first posture error: {name}": value for name, value in ratios.items()},
        f"Median ratio of the final posture error to the first: {told}.",
    )


def _cannot_pass(reading: Reading) -> Finding:
    groups = reading.each(ACROSS, ("selection",))
    there = _shares(groups, arrived)
    nearest = {
        name: median([run.steps.nearness.min(initial=1.0) for run in runs]) for name, runs in groups.items()
    }
    stranded = _shares(groups, lambda run: run.outcome.status == "no_control_points")
    figures = {f"median of the smallest nearness on the way [1/rad]: {k}": v for k, v in nearest.items()}
    figures |= {f"out of control points: {name}": each.value for name, each in stranded.items()}
    return Finding(
        _shares(groups, lambda run: not arrived(run)),
        figures,
        f"It gets there in {_in_words(there)}, and ends for want of control points in {_in_words(stranded)}.",
    )


def _on_curve(reading: Reading) -> Finding:
    groups = {
        label(scenario): reading.runs(scenario, "selection")
        for scenario in ("helix", "line", "planar-random", "planar-near-line")
    }
    off = {
        name: [run.off_curve for run in runs if run.off_curve is not None] for name, runs in groups.items()
    }
    farthest = {name: max(values, default=0.0) for name, values in off.items()}
    told = "; ".join(f"{name}: {value:.2g}" for name, value in farthest.items())
    return Finding(
        {name: share(value <= ON_CURVE for value in values) for name, values in off.items()},
        {f"farthest off, per arm length: {name}": value for name, value in farthest.items()},
        f"The farthest that a target is off the curve, per arm length: {told}.",
    )


MEASURES: Mapping[str, Callable[[Reading], Finding]] = {
    "tracks-arbitrary": _arrives(NON_SINGULAR, BOTH),
    "tracks-singular": _arrives(SINGULAR, BOTH),
    "similar-performance": _similar,
    "projection-lower-non-singular": _projection_lower(NON_SINGULAR),
    "projection-lower-singular": _projection_lower(SINGULAR),
    "projection-converges": _converges,
    "selection-few-steps": _few_steps,
    "selection-cannot-start": _cannot_start(FROM_STRAIGHT),
    "selection-cannot-start-near": _cannot_start(FROM_NEAR_STRAIGHT),
    "projection-departs": _departs,
    "projection-converges-from-singular": _arrives(FROM_STRAIGHT, ("projection",)),
    "selection-cannot-pass": _cannot_pass,
    "projection-passes": _arrives(ACROSS, ("projection",)),
    "targets-on-curve": _on_curve,
}
"""How each claim of `pinposture.thesis.claims.TRACKING` is measured."""
