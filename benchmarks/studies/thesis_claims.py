"""What the thesis reports about its spatial arm (Sections 6.1.2 to 6.1.4), over 100 seeds.

    python -m benchmarks.studies.thesis_claims                      # print the table
    python -m benchmarks.studies.thesis_claims --save benchmarks/results/thesis_claims.json

The 20-module RyRz arm, |dq| <= 0.1 rad per step, at most 200 steps; the seed draws the start and the roll
of the helix about the arm. The tests repeat 60 of these cases and compare them with the saved record.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import track as progress_bar
from rich.table import Table

import pinposture as pp
from benchmarks.cases.scenarios import SPATIAL_SCENARIOS
from benchmarks.harness import Row
from benchmarks.studies.runs import study_scenarios

STEPS = 200
SUBSET = 10
"""Seeds from 0 that the tests repeat, per scenario and controller."""
CONTROLLERS = ("selection", "projection")


def summary(outcomes: list[Row]) -> dict[str, float]:
    """Fractions and medians over the seeds of one scenario and controller."""
    ratio = np.array([outcome.ratio for outcome in outcomes])
    return {
        "cases": len(outcomes),
        "median_ratio": float(np.median(ratio)),
        "p90_ratio": float(np.percentile(ratio, 90)),
        "mean_log10_ratio": float(np.mean(np.log10(np.maximum(ratio, 1e-6)))),
        "halved": float(np.mean(ratio <= 0.5)),
        "below_tenth": float(np.mean(ratio <= 0.1)),
        "below_1e-3_of_length": float(np.mean([outcome.mean_share < 1e-3 for outcome in outcomes])),
        "no_control_points": float(np.mean([outcome.status == "no_control_points" for outcome in outcomes])),
        "median_first_points": float(np.median([outcome.first_points for outcome in outcomes])),
        "median_last_points": float(np.median([outcome.last_points for outcome in outcomes])),
        "median_rising": float(np.median([outcome.rising for outcome in outcomes])),
    }


def main() -> None:
    """Run all cases, print the table, write the record."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", type=int, default=100, help="number of seeds, from 0")
    parser.add_argument("--save", type=Path, help="write the record here")
    parser.add_argument("--jobs", type=int, default=2)
    arguments = parser.parse_args()
    arm = pp.Arm.from_template("RyRz", 20)
    pairs = [(scenario, name) for scenario in SPATIAL_SCENARIOS for name in CONTROLLERS]
    table = Table(
        "scenario", "controller", "median", "p90", "halved", "< 1/10", "< 1e-3 L", "no points", "rising"
    )
    record = []
    for scenario, name in progress_bar(pairs, "running", console=Console(stderr=True)):
        outcomes = study_scenarios(
            arm, [scenario], [name], range(arguments.seeds), max_steps=STEPS, jobs=arguments.jobs
        )
        found = summary(outcomes)
        shares = ("halved", "below_tenth", "below_1e-3_of_length", "no_control_points", "median_rising")
        table.add_row(
            scenario.title,
            name,
            f"{found['median_ratio']:.2g}",
            f"{found['p90_ratio']:.2g}",
            *(f"{found[share]:.0%}" for share in shares),
        )
        first = summary(outcomes[:SUBSET])
        record.append({"scenario": scenario.name, "controller": name, "all": found, "subset": first})
    Console(width=140).print(
        table, "median, p90: final / start posture error; L: arm length; rising: steps on which it rose"
    )
    if arguments.save:
        arguments.save.write_text(json.dumps({"steps": STEPS, "results": record}, indent=1) + "\n")


if __name__ == "__main__":
    main()
