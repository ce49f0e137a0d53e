"""Claims on how the arm moves."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from pinposture.study.reproduce.reading import Reading, median
from pinposture.study.reproduce.runs import MeasuredRun
from pinposture.study.reproduce.tracking import BOTH, NON_SINGULAR, SINGULAR
from pinposture.study.reproduce.verdicts import Finding, Share, share

DIRECT = 1.5
"""Length of the paths of the control points per direct distance up to which a motion counts as direct."""

CALM = 1e-3
"""How far a nudge of 1e-6 rad may lead, per arm length, for a motion to count as predictable."""

VISIBLE = 0.01
"""Rise of the posture error, relative to the first, that a picture shows."""

TWINS = ("helix", "planar-random")
"""Scenarios whose runs have twins."""


def predictable(run: MeasuredRun) -> bool:
    """Whether a run went directly, and would have gone the same way from a start beside its own."""
    return run.sweep <= DIRECT and run.separation is not None and run.separation <= CALM


def _largest_rise(run: MeasuredRun) -> float:
    """The most that the posture error rises in one step, relative to the first."""
    return max(float(np.diff(run.mean_errors).max(initial=0.0)) / max(float(run.mean_errors[0]), 1e-300), 0.0)


def _monotone(method: str, expected: bool) -> Callable[[Reading], Finding]:
    def find(reading: Reading) -> Finding:
        groups = reading.each((*NON_SINGULAR, *SINGULAR), (method,))
        rising = {
            name: median([run.descent.rose / max(run.descent.steps, 1) for run in runs])
            for name, runs in groups.items()
        }
        to_the_eye = {
            name: share(_largest_rise(run) <= VISIBLE for run in runs) for name, runs in groups.items()
        }
        told = "; ".join(f"{name}: {rising[name]:.0%}, {to_the_eye[name].value:.0%}" for name in groups)
        return Finding(
            {
                name: share((run.descent.rose == 0) is expected for run in runs)
                for name, runs in groups.items()
            },
            {f"median share of rising steps: {name}": value for name, value in rising.items()}
            | {f"runs without a visible rise: {name}": each.value for name, each in to_the_eye.items()},
            "Median share of the steps of a run on which the posture error rises, and share of the runs "
            "in which "
            f"it never rises by more than 1 % of what it was at first: {told}.",
        )

    return find


def _null_space(reading: Reading) -> Finding:
    groups = reading.each((*NON_SINGULAR, *SINGULAR), BOTH)
    steps = {name: sum(run.descent.steps for run in runs) for name, runs in groups.items()}
    uphill = {
        name: sum(run.descent.uphill for run in runs) / max(steps[name], 1) for name, runs in groups.items()
    }
    told = "; ".join(f"{name}: {value:.1%}" for name, value in uphill.items())
    return Finding(
        {
            name: Share(steps[name] - sum(run.descent.rose for run in runs), steps[name])
            for name, runs in groups.items()
        },
        {f"steps uphill however short: {name}": value for name, value in uphill.items()},
        "The sum runs over all control points and its sign is that of descent, without which it would not "
        f"lower the posture error at all. Steps that would raise it however short they were made: {told}.",
    )


def _active_points(reading: Reading) -> Finding:
    groups = reading.each((*NON_SINGULAR, *SINGULAR), ("selection",))
    counted = {
        name: tuple(
            sum(getattr(run.descent, field) for run in runs)
            for field in ("active", "active_rose", "active_free", "active_uphill", "steps", "clipped")
        )
        for name, runs in groups.items()
    }
    free = sum(count[2] for count in counted.values())
    uphill = sum(count[3] for count in counted.values())
    return Finding(
        {name: Share(count[0] - count[1], count[0]) for name, count in counted.items()},
        {f"steps with a joint at its limit: {k}": c[5] / max(c[4], 1) for k, c in counted.items()},
        f"Where no joint is stopped at its limit, {uphill} of {free} active control points would move "
        "away from "
        "their targets if the step were short: errors rise because steps are long and joints have limits.",
    )


def _points_rise(reading: Reading) -> Finding:
    groups = reading.each((*NON_SINGULAR, *SINGULAR), ("selection",))
    return Finding(
        {name: share(run.descent.points_rose > 0 for run in runs) for name, runs in groups.items()}, {}, ""
    )


def _predictability(groups: Mapping[str, Sequence[MeasuredRun]]) -> dict[str, float]:
    figures = {}
    for name, runs in groups.items():
        figures[f"median path per direct distance: {name}"] = median([run.sweep for run in runs])
        apart = [run.separation for run in runs if run.separation is not None]
        figures[f"median separation of twins, per arm length: {name}"] = median(apart)
    return figures


def _predictable(method: str, expected: bool) -> Callable[[Reading], Finding]:
    def find(reading: Reading) -> Finding:
        groups = {
            name: [run for run in runs if run.separation is not None]
            for name, runs in reading.each(TWINS, (method,)).items()
        }
        told = "; ".join(
            f"{name}: direct in {share(run.sweep <= DIRECT for run in runs).value:.0%}, insensitive to the "
            f"nudge in {share((run.separation or 0.0) <= CALM for run in runs).value:.0%}"
            for name, runs in groups.items()
        )
        shares = {name: share(predictable(run) is expected for run in runs) for name, runs in groups.items()}
        return Finding(shares, _predictability(groups), f"{told[:1].upper()}{told[1:]}.")

    return find


def _more_predictable(reading: Reading) -> Finding:
    pairs = reading.pairs(TWINS, *BOTH)
    shares = {f"{name}: way": share(a.sweep < b.sweep for a, b in runs) for name, runs in pairs.items()}
    for name, runs in pairs.items():
        both = [(a.separation, b.separation) for a, b in runs]
        shares[f"{name}: nudge"] = share(a < b for a, b in both if a is not None and b is not None)
    figures = _predictability(reading.each(TWINS, BOTH))
    told = "; ".join(f"{name}: {each.value:.0%}" for name, each in shares.items())
    return Finding(shares, figures, f"Seeds on which Selection is the better: {told}.")


MEASURES: Mapping[str, Callable[[Reading], Finding]] = {
    "selection-monotone": _monotone("selection", True),
    "null-space-descends": _null_space,
    "active-points-descend": _active_points,
    "point-errors-not-monotone": _points_rise,
    "projection-not-monotone": _monotone("projection", False),
    "selection-predictable": _predictable("selection", True),
    "projection-unpredictable": _predictable("projection", False),
    "selection-more-predictable": _more_predictable,
}
"""How claims of `pinposture.thesis.claims.MOVING` are measured; others are in `singular.MEASURES`."""
