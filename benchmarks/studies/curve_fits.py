"""Fits of whole arms to curves: how close they come, with half and twice of each setting, and with SciPy.

    python -m benchmarks.studies.curve_fits                  # 400 fits, 25 arms
    python -m benchmarks.studies.curve_fits --arms panda ur5 --settings largest_step restarts
    python -m benchmarks.studies.curve_fits --settings       # SciPy alone

A fit counts as closer or farther if the root of its mean squared distance differs by more than a thousandth
from that of the library as it is. The curves are splines through five points, curves through postures, and
helices; the arms can follow about half of them. "scipy" is `scipy.optimize.least_squares` in place
of the steps of the library, "from the minimum" the same that starts where the library ended: it comes closer
only where that was no minimum.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Iterator
from functools import lru_cache, partial
from time import process_time
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import least_squares as scipy_least_squares

import pinposture as pp
from benchmarks.same_results import ARMS, arm_named, curve_for, smooth
from pinposture.placement import least_squares
from pinposture.placement.resolve import STIFFNESS

Array = np.ndarray

DIFFERENCE = 1e-3
"""Relative difference of the root of the mean squared distance from which a fit is closer or farther."""

ROUNDING = 1e-8
"""The same in arm lengths, for exact fits."""

SETTINGS = (
    "turn_per_stage",
    "samples_per_module",
    "stage_steps",
    "restarts",
    "straight_restarts",
    "restart_noise",
    "steps",
    "largest_step",
    "decrease",
    "increase",
)
"""Settings of `CURVE_FIT` and `FIT_STEPS` that are varied."""

SCIPY_EVALUATIONS = 60
"""Largest number of evaluations by SciPy at the final curve."""

library_steps = least_squares.FitProblem.solve


class Case(NamedTuple):
    """A fit: the arm, the curve at its base, and the weight of bending [m/rad]."""

    arm: pp.Arm
    curve: pp.Curve
    bending: float


class Fit(NamedTuple):
    """What came of it: the root of the mean squared distance, in arm lengths, and the time [s]."""

    distance: float
    time: float
    problem: least_squares.FitProblem
    unknowns: Array


def draw_cases(names: list[str]) -> Iterator[Case]:
    """Eight curves for each arm, which it should follow closely and smoothly."""
    for name in names:
        arm = arm_named(name)
        flat = arm.dimension == 2
        curves = [curve_for(arm, bend, name, "curve fits") for bend in (0.3, 0.8, 1.4)]
        for amplitude in (0.4, 1.0):
            posture = arm.at(smooth(arm, amplitude, name, "curve fits", amplitude)).points
            curves.append(pp.Curve.points(np.vstack([arm.chain.base, posture])))
        for turns in (0.7, 1.5, 2.5):
            along = np.linspace(0.0, 1.0, 40)
            angle = 2.0 * np.pi * turns * along
            radius = 1.15 * arm.length / (2.0 * np.pi * turns)
            rise = np.zeros(len(along)) if flat else 0.3 * arm.length * along
            coil = np.column_stack([radius * np.sin(angle), radius * (1.0 - np.cos(angle)), rise])
            curves.append(pp.Curve.points(arm.chain.base + coil))
        lengths = np.maximum(arm.chain.module_lengths, arm.chain.module_lengths.mean())
        for curve in curves:
            for method in ("smooth", "closest"):
                yield Case(arm, curve, STIFFNESS[method] * float(np.median(lengths)))


def fit(case: Case) -> Fit:
    """Fit an arm from its straight posture."""
    began = process_time()
    positions, parameters = least_squares.fit_curve(case.arm, case.curve, 0.0, case.bending)
    time = process_time() - began
    problem = least_squares._fit_problem(case.arm, case.curve, 0.0, case.bending, True)
    unknowns = problem.joined(positions, parameters)
    return Fit(problem.distance(case.curve, unknowns), time, problem, unknowns)


def scipy_steps(problem: Any, curve: Any, guess: Array, steps: int | None = None, **near: Any) -> Array:
    """What `FitProblem.solve` does, by SciPy; fits with a weight or a reach stay those of the library."""
    if near:
        return library_steps(problem, curve, guess, steps, **near)

    @lru_cache(maxsize=1)  # the residual and the Jacobian are requested in turn
    def evaluate(unknowns: bytes) -> tuple[Array, Array]:
        residual, jacobian = problem.evaluate(curve, np.frombuffer(unknowns))
        return residual, jacobian

    solution = scipy_least_squares(
        lambda x: evaluate(x.tobytes())[0],
        np.clip(guess, problem.lower, problem.upper),
        jac=lambda x: evaluate(x.tobytes())[1],
        bounds=(problem.lower, problem.upper),
        ftol=problem.converged,
        xtol=1e-12,
        gtol=1e-15,
        max_nfev=SCIPY_EVALUATIONS if steps is None else steps,
    )
    return np.asarray(np.clip(solution.x, problem.lower, problem.upper))


def with_setting(name: str, factor: float, cases: list[Case]) -> list[Fit]:
    """Fit with a multiple of a setting."""
    owner = "CURVE_FIT" if name in least_squares.CURVE_FIT._fields else "FIT_STEPS"
    usual = getattr(least_squares, owner)
    value = getattr(usual, name)
    changed = max(round(factor * value), 1) if isinstance(value, int) else factor * value
    setattr(least_squares, owner, usual._replace(**{name: changed}))
    try:
        return [fit(case) for case in cases]
    finally:
        setattr(least_squares, owner, usual)


def by_scipy(cases: list[Case]) -> list[Fit]:
    """Fit with SciPy's steps."""
    least_squares.FitProblem.solve = scipy_steps  # type: ignore[method-assign, assignment]
    try:
        return [fit(case) for case in cases]
    finally:
        least_squares.FitProblem.solve = library_steps  # type: ignore[method-assign]


def go_on(case: Case, usual: Fit) -> Fit:
    """Start SciPy where the library ended."""
    began = process_time()
    unknowns = scipy_steps(usual.problem, case.curve, usual.unknowns, 200)
    distance = min(usual.problem.distance(case.curve, unknowns), usual.distance)
    return Fit(distance, process_time() - began, usual.problem, unknowns)


def compare(usual: list[Fit], other: list[Fit]) -> dict[str, float]:
    """Count what is closer and farther, and relate times and sums."""
    a = np.array([fit.distance for fit in usual])
    b = np.array([fit.distance for fit in other])
    return {
        "closer": int(np.count_nonzero(b < a * (1.0 - DIFFERENCE) - ROUNDING)),
        "farther": int(np.count_nonzero(b > a * (1.0 + DIFFERENCE) + ROUNDING)),
        "sum": float(b.sum()),
        "time_ratio": sum(fit.time for fit in other) / sum(fit.time for fit in usual),
    }


def main() -> int:
    """Print a row for the library, each setting, and SciPy."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--arms", nargs="+", choices=list(ARMS), default=list(ARMS), metavar="ARM")
    parser.add_argument("--settings", nargs="*", choices=SETTINGS, default=list(SETTINGS), metavar="NAME")
    parser.add_argument("--json", action="store_true")
    asked = parser.parse_args()
    cases = list(draw_cases(asked.arms))
    fit(cases[0])  # what is compiled is loaded
    usual = [fit(case) for case in cases]
    rows: dict[str, Callable[[], list[Fit]]] = {"the library": lambda: usual}
    for name in asked.settings:
        for word, factor in (("half", 0.5), ("twice", 2.0)):
            rows[f"{word} {name}"] = partial(with_setting, name, factor, cases)
    rows["scipy"] = partial(by_scipy, cases)
    modular = [k for k, found in enumerate(usual) if not isinstance(found.problem, least_squares.SlidingFit)]
    rows["from the minimum"] = lambda: [go_on(cases[k], usual[k]) for k in modular]
    told = {}
    if not asked.json:
        print(f"{len(cases)} fits{'':21} closer  farther  sum of roots  time")
    for name, run in rows.items():
        fits = run()
        base = usual if len(fits) == len(usual) else [usual[k] for k in modular]
        told[name] = compare(base, fits)
        row = told[name]
        if not asked.json:
            print(
                f"{name:30}{row['closer']:6}{row['farther']:9}{row['sum']:14.4f}{row['time_ratio']:6.2f}",
                flush=True,
            )
    if asked.json:
        json.dump(told, sys.stdout, indent=1)
    return 0


if __name__ == "__main__":
    sys.exit(main())
