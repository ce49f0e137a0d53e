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
from pathlib import Path
from typing import NamedTuple, get_args

import numpy as np
from joblib import Parallel, delayed
from rich.console import Console
from rich.progress import track as progress_bar
from rich.table import Table

import pinposture as pp
from benchmarks.cases.scenarios import ARMS, Scenario, StartKind, case
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


class End(NamedTuple):
    """How one run ended: mean point error over arm length, steps, path over distance, switches."""

    error: float
    steps: int
    path: float
    switches: int


def ends(scenario: Scenario, seed: int, harsh: bool, hand_back: HandBack = "after_stay") -> list[End]:
    """Run the three controllers on one case."""
    switching = pp.Switching(hand_back=hand_back)
    arm = pp.Arm.from_modules(ARMS[scenario.arm])
    start, target = case(arm, scenario, seed)
    if harsh:
        start = np.random.default_rng(seed).uniform(-1.0, 1.0, arm.nq) * HARSH[scenario.arm]
    found = []
    for name in CONTROLLERS:
        run = pp.track(arm, target, start, switching if name == "switching" else name, max_steps=STEPS)
        path = np.linalg.norm(np.diff(run.points, axis=0), axis=2).sum()
        direct = np.linalg.norm(run.points[-1] - run.points[0], axis=1).sum()
        share = float(run.point_errors[-1].mean()) / arm.length
        found.append(End(share, run.steps, float(path / direct) if direct else 1.0, len(run.switches)))
    return found


def summary(cases: list[list[End]]) -> dict[str, object]:
    """Shares and medians over the cases of one family."""
    table = np.array(cases, dtype=float)  # (cases, controllers, 4)
    errors = table[:, :, 0]
    excess = (errors[:, 2] - errors[:, :2].min(axis=1)) / ARRIVED
    return {
        "cases": len(cases),
        "arrived": dict(zip(CONTROLLERS, np.mean(errors < ARRIVED, axis=0).tolist(), strict=True)),
        "median_steps": dict(zip(CONTROLLERS, np.median(table[:, :, 1], axis=0).tolist(), strict=True)),
        "median_path": dict(zip(CONTROLLERS, np.median(table[:, :, 2], axis=0).tolist(), strict=True)),
        "median_switches": float(np.median(table[:, 2, 3])),
        "most_switches": int(table[:, 2, 3].max()),
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
        cases = list(
            Parallel(n_jobs=arguments.jobs)(
                delayed(ends)(scenario, seed, harsh, arguments.hand_back) for seed in range(arguments.seeds)
            )
        )
        found = summary(cases)
        title = scenario.title.replace("smooth", "harsh") if harsh else scenario.title
        name = scenario.name.replace("smooth", "harsh") if harsh else scenario.name
        record[name] = {"all": found, "subset": summary(cases[:SUBSET])}
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
