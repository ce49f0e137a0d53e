"""Solvers of quadratic programs on those that the controller "geodesic" really asks for.

    python -m benchmarks.studies.qp_solvers                      # print the tables
    python -m benchmarks.studies.qp_solvers --save benchmarks/results/qp_solvers.json

At most 60 programs of two runs, evenly spread and in order, are replayed. A time is that of one call, from
dense arrays to the solution, on this machine. Warm: begun with what the program before ended with. Missed:
how much a bound, or a row of length 1, is violated. Excess: how much the objective is above the lowest that a
solver found within 1e-7, relative to that or to 1e-6 of the largest of the run. Failed: no answer, missed by
over 1e-6, or an excess over 1e-4.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import time
from pathlib import Path
from typing import NamedTuple

import daqp
import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.table import Table

import pinposture as pp
from pinposture import quadratic_program
from pinposture.arm import smooth_configuration
from pinposture.collision import Scene, Sphere
from pinposture.control import Geodesic, JointPosture
from pinposture.control.planner import damped_least_squares

Array = np.ndarray
SITUATIONS = ("free", "joint limits", "acceleration", "obstacles")
RUNS, STEPS, KEPT = 2, 100, 30
COLUMNS = ("p50 [us]", "p95 [us]", "failed", "missed", "excess")


class Program(NamedTuple):
    """Minimise x^T H x / 2 + g^T x with low <= (x, M x) <= high."""

    H: Array
    g: Array
    M: Array
    low: Array
    high: Array


def recorded(modules: int, situation: str) -> list[Program]:
    """Programs of a few runs, evenly spread, but for those whose rows contradict each other."""
    found: list[Program] = []
    count, stride = 0, 1

    def spying(*asked):
        nonlocal count, stride
        solution, count = quadratic_program.solve(*asked), count + 1
        if count % stride == 0 and not solution.softened:
            found.append(arranged(*asked))
            if len(found) > 2 * KEPT:
                found[:], stride = found[::2], 2 * stride
        return solution

    damped_least_squares.solve = spying  # type: ignore[attr-defined]
    for seed in range(RUNS):
        run(modules, situation, np.random.default_rng(seed))
    damped_least_squares.solve = quadratic_program.solve  # type: ignore[attr-defined]
    return found


def arranged(hessian: Array, gradient: Array, lower: Array, upper: Array, rows=None, equal=None) -> Program:
    """The arguments of `program.solve` with rows of length 1; equations do not occur here."""
    matrix, least = (np.zeros((0, len(gradient))), np.zeros(0)) if rows is None else rows
    lengths = np.maximum(np.linalg.norm(matrix, axis=1), 1e-12)
    high = np.r_[upper, np.full(len(least), quadratic_program.ROW_PROGRAM.no_bound)]
    return Program(hessian, gradient, matrix / lengths[:, None], np.r_[lower, least / lengths], high)


def run(modules: int, situation: str, rng: np.random.Generator) -> None:
    """One run of the controller."""
    template, limits, scene = pp.template("RyRz"), pp.Limits(), None
    if situation == "joint limits":
        template = template.with_limits(-0.25, 0.25)
    arm = pp.Arm.from_modules([template] * modules)
    start, goal = (smooth_configuration(arm, rng, 0.6) for _ in range(2))
    start = np.clip(start, arm.limits.lower, arm.limits.upper)
    target = pp.Target.from_points(arm, arm.at(goal).points)
    if situation == "acceleration":
        target = pp.Target.from_points(
            arm, 1.1 * target.points
        )  # out of reach: it ends by pushing against it
        limits = pp.Limits(dt=0.05, velocity=1.5, acceleration=3.0)
    if situation == "obstacles":  # between start and goal, as large as both leave room for
        ends = np.concatenate([arm.at(q).points for q in (start, goal)])
        balls = arm.at((start + goal) / 2.0).points[modules // 4 :: modules // 10]
        radii = np.linalg.norm(balls[:, None] - ends, axis=2).min(axis=1) - 0.025
        scene = Scene(
            {str(i): Sphere(balls[i], radii[i]) for i in np.flatnonzero(radii > 0.005)}, self_collision=False
        )
    # Points and chords alone are solved by sweeps; a task calls for the program.
    tasks = (JointPosture(arm.neutral(), weight=1e-4),)
    pp.track(arm, target, start, Geodesic(tasks=tasks), limits, scene, max_steps=STEPS)


def with_daqp(p: Program, last: Array | None) -> Array | None:
    """As `program.solve` calls it."""
    options = {
        "primal_tol": quadratic_program.ROW_PROGRAM.tolerance,
        "eq_reduction": -1,
        "primal_start": last,
    }
    x, _, flag, _ = daqp.solve(p.H, p.g, p.M, p.high, p.low, None, **options)
    return x if flag in quadratic_program.SOLVED else None


def with_proxqp(p: Program, last: Array | None) -> Array | None:
    """ProxQP, dense, with its box constraints."""
    from proxsuite import proxqp

    n = len(p.g)
    geodesic, guesses = proxqp.dense.QP(n, 0, len(p.M), True), proxqp.InitialGuess
    geodesic.settings.eps_abs, geodesic.settings.max_iter = 1e-9, 1000
    geodesic.settings.initial_guess = guesses.NO_INITIAL_GUESS if last is None else guesses.WARM_START
    geodesic.init(p.H, p.g, None, None, p.M, p.low[n:], p.high[n:], p.low[:n], p.high[:n])
    geodesic.solve(*([] if last is None else [last, None, None]))
    return geodesic.results.x if geodesic.results.info.status == proxqp.QPSolverOutput.PROXQP_SOLVED else None


def with_quadprog(p: Program, last: Array | None) -> Array | None:
    """The dual method of Goldfarb and Idnani."""
    import quadprog

    eye = np.eye(len(p.g))
    rows, sides = np.vstack([eye, p.M, -eye]).T, np.r_[p.low, -p.high[: len(p.g)]]
    try:
        return quadprog.solve_qp(p.H, -p.g, rows, sides)[0]
    except ValueError:
        return None


SOLVERS = {
    "DAQP": ("daqp", with_daqp, False),
    "DAQP, warm": ("daqp", with_daqp, True),
    "ProxQP": ("proxsuite", with_proxqp, False),
    "ProxQP, warm": ("proxsuite", with_proxqp, True),
    "quadprog": ("quadprog", with_quadprog, False),
}
"""Package, function, and whether it begins with the last solution."""


def compare(programs: list[Program]) -> dict[str, dict[str, float]]:
    """What each solver makes of the programs: times [us], and the quality of its solutions."""
    times, marks = {}, {}
    for name, (package, solver, warm) in SOLVERS.items():
        if importlib.util.find_spec(package):
            times[name], marks[name], last = [], [], None
            for p in programs:
                start = last if warm and last is not None and len(last) == len(p.g) else None
                begun = time.perf_counter()
                last = solver(p, start)
                times[name].append(1e6 * (time.perf_counter() - begun))
                marks[name].append(quality(p, last))
    best = np.min([[f if v <= 1e-7 else np.inf for v, f in each] for each in marks.values()], axis=0)
    result = {}
    for name, mark in marks.items():
        missed, objective = np.array(mark).T
        excess = (objective - best) / np.maximum(np.abs(best), 1e-6 * np.abs(best).max())
        failed = np.sum((missed > 1e-6) | ~(excess <= 1e-4))
        values = (*np.percentile(times[name], [50, 95]), failed, missed.max(), np.abs(excess).max())
        result[name] = dict(zip(COLUMNS, map(float, values), strict=True))
    return result


def quality(p: Program, x: Array | None) -> tuple[float, float]:
    """By how much a solution misses its bounds, and its objective."""
    if x is None or not np.all(np.isfinite(x)):
        return np.inf, np.inf
    values = np.concatenate([x, p.M @ x])
    return max(0.0, (p.low - values).max(), (values - p.high).max()), x @ p.H @ x / 2.0 + p.g @ x


def main() -> None:
    """Record, replay, print, save."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--modules", type=int, nargs="+", default=[20, 50, 100])
    parser.add_argument("--save", type=Path, help="write the record here")
    arguments = parser.parse_args()
    absent = {each[0] for each in SOLVERS.values() if not importlib.util.find_spec(each[0])}
    Console().print(f"not installed, left out: {', '.join(sorted(absent)) or 'none'}")
    record = {}
    for modules in arguments.modules:
        for situation in SITUATIONS:
            programs = recorded(modules, situation)
            if not programs:
                Console().print(f"{2 * modules} DOF, {situation}: no program was asked for")
                continue
            found = record[f"{2 * modules} DOF, {situation}"] = compare(programs)
            rows = np.median([len(p.M) for p in programs])
            title = f"{2 * modules} DOF, {situation}: {len(programs)} programs, {rows:.0f} rows (median)"
            table = Table("", *(escape(column) for column in COLUMNS), title=title)
            for name, values in found.items():
                table.add_row(name, *(f"{value:.3g}" for value in values.values()))
            Console().print(table)
    if arguments.save:
        arguments.save.write_text(json.dumps(record, indent=1) + "\n")


if __name__ == "__main__":
    main()
