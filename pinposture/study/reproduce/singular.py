"""Claims on how the arm moves near singular postures."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from pinposture.study.reproduce.reading import Reading, label, median
from pinposture.study.reproduce.runs import MeasuredRun
from pinposture.study.reproduce.tracking import BOTH, SINGULAR, arrived, errors_of
from pinposture.study.reproduce.verdicts import Class, Finding, share

NEAR = 0.03
"""Smallest singular value of the tip's Jacobian, per arm length, up to which a posture is nearly singular."""

BINS = (0.0, 0.003, 0.01, 0.03, 0.1, np.inf)
"""Limits of the classes of nearness for which figures are given."""

HALF_TURN = float(np.pi)
"""The most that a joint may be asked for in one step [rad]; beyond that it might turn the other way."""

ABRUPT = 0.5
"""Change of the joint displacement, per size, above which a motion is not smooth."""


def _near(
    runs: Sequence[MeasuredRun], name: str, low: float = 0.0, high: float = NEAR
) -> NDArray[np.float64]:
    """Something about the steps of runs that are that near a singular posture."""
    parts = [
        getattr(run.steps, name)[(run.steps.nearness >= low) & (run.steps.nearness < high)] for run in runs
    ]
    return np.concatenate([np.zeros(0), *parts])


def _by_nearness(groups: Mapping[str, Sequence[MeasuredRun]], name: str, quantity: str) -> list[Class]:
    """Medians and largest values of something about the steps, by nearness."""
    classes = []
    for group, runs in groups.items():
        for low, high in pairwise(BINS):
            values = _near(runs, name, low, high)
            if len(values):
                largest = float(values.max())
                classes.append(Class(quantity, group, low, high, len(values), median(values), largest))
    return classes


def _asked(reading: Reading) -> Finding:
    groups = reading.each(SINGULAR, BOTH)
    largest = {name: float(_near(runs, "asked").max(initial=0.0)) for name, runs in groups.items()}
    told = "; ".join(f"{name}: {value:.3g} rad" for name, value in largest.items())
    return Finding(
        {name: share(_near(runs, "asked") <= HALF_TURN) for name, runs in groups.items()},
        {
            f"largest |dq| asked for near a singular posture [rad]: {name}": most
            for name, most in largest.items()
        },
        f"The most that was asked of a joint in one step near a singular posture: {told}. "
        "A step limit takes care of it.",
        _by_nearness(groups, "asked", "largest motion of a joint asked for [rad]"),
    )


def _no_blow_up(reading: Reading) -> Finding:
    groups = reading.each(SINGULAR, BOTH)

    def worst(run: MeasuredRun) -> float | None:
        near = np.flatnonzero(run.steps.nearness <= NEAR)
        if not len(near):
            return None
        after = run.mean_errors[near[0] :]
        return float(after.max() / max(float(after[0]), 1e-300))

    growth = {
        name: [value for run in runs if (value := worst(run)) is not None] for name, runs in groups.items()
    }
    return Finding(
        {name: share(value <= 2.0 for value in values) for name, values in growth.items()},
        {f"largest growth: {name}": max(values, default=1.0) for name, values in growth.items()}
        | {f"runs that come near: {name}": float(len(values)) for name, values in growth.items()},
        f"Runs that come near a singular posture at all: "
        f"{'; '.join(f'{name}: {len(values)}' for name, values in growth.items())}.",
    )


def _smooth(reading: Reading) -> Finding:
    groups = reading.each(SINGULAR, BOTH)
    far = {name: median(_near(runs, "turn", NEAR, np.inf)) for name, runs in groups.items()}
    near = {name: median(_near(runs, "turn")) for name, runs in groups.items()}
    told = "; ".join(f"{name}: {near[name]:.2f} near, {far[name]:.2f} elsewhere" for name in groups)
    return Finding(
        {name: share(_near(runs, "turn") <= ABRUPT) for name, runs in groups.items()},
        {f"median change of dq per size, near: {name}": change for name, change in near.items()},
        f"Median change of the joint displacement from step to step, per size: {told}.",
        _by_nearness(groups, "turn", "change of dq from step to step, per size")
        + _by_nearness(groups, "change", "share of the active set exchanged from step to step"),
    )


def _any_step(reading: Reading) -> Finding:
    # A variant of its own: the default runs have a step limit.
    groups = {
        label(scenario, f"{method}, any step"): runs
        for scenario in SINGULAR
        for method in BOTH
        if (runs := reading.pool.get((scenario, f"{method}, any step"), ()))
    }
    shares = {name: share(arrived(run) for run in runs) for name, runs in groups.items()}
    told = "; ".join(f"{name}: {each.value:.0%}" for name, each in shares.items())
    return Finding(shares, errors_of(groups), f"Of runs without a step limit these arrive: {told}.")


MEASURES: Mapping[str, Callable[[Reading], Finding]] = {
    "stable-near-singular": _asked,
    "no-blow-up": _no_blow_up,
    "smooth-near-singular": _smooth,
    "stable-without-step-limit": _any_step,
}
"""How claims of `pinposture.thesis.claims.MOVING` are measured where they are on singular postures."""
