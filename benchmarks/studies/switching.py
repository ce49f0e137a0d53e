"""Switching against its two parts, in every family of cases: how often they arrive, and how close.

    python -m benchmarks.studies.switching                      # print the table
    python -m benchmarks.studies.switching --save benchmarks/results/switching.json

A family is an arm with a kind of start and a kind of target; the
seed draws what the family leaves open. Harsh starts, every joint uniform within 1.5 rad (spatial arm) or
0.5 rad (planar arm), are added to the smooth ones. |dq| <= 0.1 rad per step, at most 400 steps. An arm has
arrived if its mean point error is below 1e-3 of its length. Worse than the better one: by how much the mean
point error of Switching at the end exceeds that of the better of its parts alone, in units of 1e-3 of the
arm length, at most over all cases. Path: length of the paths of the control points over their distance from
start to end, median.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any, get_args

import numpy as np
from rich.console import Console
from rich.progress import track as progress_bar
from rich.table import Table

import pinposture as pp
from benchmarks.baselines import named_controllers
from benchmarks.cases.scenarios import ARMS, Scenario, StartKind, case
from benchmarks.harness import Case, Problem, Row, Study, grouped, median
from pinposture.control import Controller
from pinposture.control.thesis.switching import HandBack

STARTS: tuple[StartKind, ...] = get_args(StartKind)
FAMILIES = tuple(
    Scenario(f"{arm}: {start} -> {target}", f"{start} -> {target}", "", start, target, arm)
    for arm, targets in (("ryrz20", ("helix", "line", "random")), ("planar45", ("line", "random")))
    for start in STARTS
    for target in targets
    if (start, target) != ("straight", "line")  # nothing to do
)
"""Every kind of start with every kind of target that the arm can take; a planar arm cannot take a helix."""

CONTROLLERS = ("selection", "projection", "switching")
STEPS = 400
ARRIVED = 1e-3
SUBSET = 5
"""Seeds from 0 that the tests repeat."""
HARSH = {"ryrz20": 1.5, "planar45": 0.5}
"""Largest joint position of a harsh start [rad]."""


def study_family(
    scenario: Scenario, seeds: int, harsh: bool = False, hand_back: HandBack = "after_stay"
) -> Study:
    """The three controllers on the cases of a family."""
    arm = pp.Arm.from_modules(ARMS[scenario.arm])
    cases = [Case({"seed": seed}, partial(_draw, arm, scenario, seed, harsh)) for seed in range(seeds)]
    methods = named_controllers([*CONTROLLERS[:2], pp.Switching(hand_back=hand_back)])
    return Study(cases, methods, _measure)


def _draw(arm: pp.Arm, scenario: Scenario, seed: int, harsh: bool) -> Problem:
    start, target = case(arm, scenario, seed)
    if harsh:
        start = np.random.default_rng(seed).uniform(-1.0, 1.0, arm.nq) * HARSH[scenario.arm]
    return Problem(arm, start, target)


def _measure(problem: Problem, controller: Controller) -> Row:
    """How one run ended: mean point error over arm length, steps, path over distance, switches."""
    run = pp.track(problem.arm, problem.target, problem.start, controller, max_steps=STEPS)
    path = np.linalg.norm(np.diff(run.points, axis=0), axis=2).sum()
    direct = np.linalg.norm(run.points[-1] - run.points[0], axis=1).sum()
    return Row(
        controller=controller.name,
        error=float(run.point_errors[-1].mean()) / problem.arm.length,
        steps=run.steps,
        path=float(path / direct) if direct else 1.0,
        switches=len(run.switches),
    )


def summary(rows: Sequence[Row]) -> dict[str, Any]:
    """Shares and medians over the cases of one family."""
    by_name = grouped(rows, lambda row: row.controller)
    errors = np.array([[row.error for row in by_name[name]] for name in CONTROLLERS])
    excess = (errors[2] - errors[:2].min(axis=0)) / ARRIVED
    switches = [row.switches for row in by_name["switching"]]
    return {
        "cases": len(switches),
        "arrived": dict(zip(CONTROLLERS, np.mean(errors < ARRIVED, axis=1).tolist(), strict=True)),
        "median_steps": {name: median("steps")(by_name[name]) for name in CONTROLLERS},
        "median_path": {name: median("path")(by_name[name]) for name in CONTROLLERS},
        "median_switches": float(np.median(switches)),
        "most_switches": max(switches),
        "worst_excess": float(max(excess.max(), 0.0)),
    }


def main() -> None:
    """Run all families, print the table, write the record."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", type=int, default=200, help="number of seeds, from 0")
    parser.add_argument("--save", type=Path, help="write the record here")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--hand-back", choices=get_args(HandBack), default="after_stay", help="of Switching")
    arguments = parser.parse_args()
    families = [(scenario, False) for scenario in FAMILIES]
    families += [(scenario, True) for scenario in FAMILIES if scenario.start == "smooth"]
    table = Table("arm", "case", *CONTROLLERS, "worse than the better one", "steps", "path", "switches")
    record = {}
    for scenario, harsh in progress_bar(families, "running", console=Console(stderr=True)):
        study = study_family(scenario, arguments.seeds, harsh, arguments.hand_back)
        rows = study.rows(arguments.jobs)
        found = summary(rows)
        title = scenario.title.replace("smooth", "harsh") if harsh else scenario.title
        name = scenario.name.replace("smooth", "harsh") if harsh else scenario.name
        record[name] = {"all": found, "subset": summary(rows[: SUBSET * len(CONTROLLERS)])}
        table.add_row(
            scenario.arm,
            title,
            *(f"{100 * found['arrived'][name]:.1f} %" for name in CONTROLLERS),
            f"{found['worst_excess']:.2g}",
            f"{found['median_steps']['switching']:.0f}",
            f"{found['median_path']['switching']:.2f}",
            f"{found['median_switches']:.0f} ({found['most_switches']})",
        )
    Console(width=160).print(table)
    if arguments.save:
        arguments.save.write_text(
            json.dumps({"steps": STEPS, "arrived": ARRIVED, "families": record}, indent=1) + "\n"
        )


if __name__ == "__main__":
    main()
