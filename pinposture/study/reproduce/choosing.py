"""Claims on which control points are used, and on switching between the methods."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from pinposture.study.reproduce.moving import CALM, TWINS
from pinposture.study.reproduce.reading import Reading, label, median
from pinposture.study.reproduce.runs import MeasuredRun
from pinposture.study.reproduce.tracking import (
    BOTH,
    FROM_STRAIGHT,
    NON_SINGULAR,
    SINGULAR,
    errors_of,
    final,
    lower,
)
from pinposture.study.reproduce.verdicts import Finding, Share, share

MANY = 0.25
"""Share of all control points that counts as a lot."""

SWITCHED = ("planar-near-line", "line", "planar-random", "helix", "random")
"""Scenarios on which switching is compared with its parts; the thesis shows the first."""


def _steps_with(runs: Sequence[MeasuredRun], part: float) -> Share:
    """Steps in which at least a part of all control points is active."""
    counts = np.concatenate([np.zeros(0), *(run.points / run.modules for run in runs)])
    return share(counts >= part)


def _mean_points(groups: Mapping[str, Sequence[MeasuredRun]]) -> dict[str, float]:
    return {
        f"median of the mean number of active points: {name}": median(
            [float(run.points.mean()) for run in runs if len(run.points)]
        )
        for name, runs in groups.items()
    }


def _many(reading: Reading) -> Finding:
    groups = reading.each(("planar-random",), BOTH)
    fewest = {
        name: min((int(run.points.min()) for run in runs if len(run.points)), default=0)
        for name, runs in groups.items()
    }
    told = "; ".join(f"{name}: {count}" for name, count in fewest.items())
    return Finding(
        {name: _steps_with(runs, MANY) for name, runs in groups.items()},
        _mean_points(groups),
        f"The fewest points in any step: {told}.",
    )


def _runs_out(reading: Reading) -> Finding:
    groups = reading.each(SINGULAR, ("selection",))
    figures = {}
    for name, runs in groups.items():
        figures[f"median points at first: {name}"] = median([run.outcome.first_points for run in runs])
        figures[f"median points at last: {name}"] = median([run.outcome.last_points for run in runs])
    told = "; ".join(f"{name}: {value:g}" for name, value in figures.items())
    return Finding(
        {
            name: share(
                run.outcome.status == "no_control_points"
                or run.outcome.last_points <= run.outcome.first_points / 2
                for run in runs
            )
            for name, runs in groups.items()
        },
        figures,
        f"{told[:1].upper()}{told[1:]}.",
    )


def _stranded(reading: Reading) -> Finding:
    groups = reading.each(SINGULAR, ("selection",))
    return Finding(
        {
            name: share(run.outcome.status == "no_control_points" for run in runs)
            for name, runs in groups.items()
        },
        errors_of(groups),
        "Median final errors per arm length: "
        + "; ".join(f"{name}: {median([final(run) for run in runs]):.2g}" for name, runs in groups.items())
        + ".",
    )


def _keeps(reading: Reading) -> Finding:
    groups = reading.each(SINGULAR, ("projection",))
    return Finding(
        {
            name: share(run.points.min(initial=run.modules) >= 0.5 * run.modules for run in runs)
            for name, runs in groups.items()
        },
        _mean_points(groups),
        "",
    )


def _all(reading: Reading) -> Finding:
    groups = reading.each((*NON_SINGULAR, *SINGULAR, *FROM_STRAIGHT), ("projection",))
    return Finding({name: _steps_with(runs, 1.0) for name, runs in groups.items()}, _mean_points(groups), "")


def _more(reading: Reading) -> Finding:
    pairs = reading.pairs((*NON_SINGULAR, *SINGULAR), *BOTH)
    return Finding(
        {
            name: share(b.points.mean() > a.points.mean() for a, b in runs if len(a.points) and len(b.points))
            for name, runs in pairs.items()
        },
        _mean_points(reading.each((*NON_SINGULAR, *SINGULAR), BOTH)),
        "",
    )


def _full_rank(method: str) -> Callable[[Reading], Finding]:
    def find(reading: Reading) -> Finding:
        groups = reading.each((*NON_SINGULAR, *SINGULAR, *FROM_STRAIGHT), (method,))
        steps = {name: sum(run.descent.steps for run in runs) for name, runs in groups.items()}
        shares = {
            name: Share(steps[name] - sum(run.deficient for run in runs), steps[name])
            for name, runs in groups.items()
        }
        missing = sum(each.cases - each.true for each in shares.values())
        return Finding(shares, {"steps of less than full rank": float(missing)}, "")

    return find


def _switching_lower(reading: Reading) -> Finding:
    shares = {}
    for scenario in SWITCHED:
        runs = [reading.runs(scenario, method) for method in ("switching", *BOTH)]
        if all(runs):
            shares[label(scenario)] = share(lower(ours, parts) for ours, *parts in zip(*runs, strict=True))
    groups = reading.each(SWITCHED, (*BOTH, "switching"))
    told = "; ".join(f"{name}: {median([final(run) for run in runs]):.2g}" for name, runs in groups.items())
    return Finding(shares, errors_of(groups), f"Median final errors per arm length: {told}.")


def _switching_predictable(reading: Reading) -> Finding:
    pairs = reading.pairs(TWINS, "switching", "selection")
    shares = {
        f"{name}: way": share(a.sweep <= 1.2 * b.sweep for a, b in runs) for name, runs in pairs.items()
    }
    for name, runs in pairs.items():
        both = [(a.separation, b.separation) for a, b in runs]
        shares[f"{name}: nudge"] = share(
            a <= max(10.0 * b, CALM) for a, b in both if a is not None and b is not None
        )
    told = "; ".join(
        f"{name}: {median([a.sweep for a, _ in runs]):.2f} against {median([b.sweep for _, b in runs]):.2f}"
        for name, runs in pairs.items()
    )
    return Finding(
        shares, {}, f"Path per direct distance by switching against Selection, the medians: {told}."
    )


def _mostly_selection(reading: Reading) -> Finding:
    groups = reading.each(SWITCHED, ("switching",))
    parts = {name: median([run.by_projection for run in runs]) for name, runs in groups.items()}
    told = "; ".join(f"{name}: {value:.0%}" for name, value in parts.items())
    return Finding(
        {name: share(run.by_projection <= 0.5 for run in runs) for name, runs in groups.items()},
        {f"median share of steps by Projection: {name}": value for name, value in parts.items()},
        f"Steps that Projection makes, the median: {told}.",
    )


MEASURES: Mapping[str, Callable[[Reading], Finding]] = {
    "many-points": _many,
    "selection-runs-out": _runs_out,
    "selection-stranded": _stranded,
    "projection-keeps-points": _keeps,
    "projection-uses-all": _all,
    "projection-more-points": _more,
    "selection-full-rank": _full_rank("selection"),
    "projection-full-rank": _full_rank("projection"),
    "switching-lower": _switching_lower,
    "switching-predictable": _switching_predictable,
    "switching-mostly-selection": _mostly_selection,
}
"""How each claim of `pinposture.thesis.claims.CHOOSING` is measured."""
