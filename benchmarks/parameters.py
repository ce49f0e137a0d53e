"""The search behind the default parameters of Selection and Projection.

    python benchmarks/parameters.py --save benchmarks/results/parameters.json

Each parameter in turn takes the value that gives the lowest objective, the others held, until a round
changes nothing. The objective is the mean over all cases of log10(final / start posture error), floored
at 1e-6. The seeds (1000 to 1019) are not those on which the results are reported.

The index thresholds of Selection end at 0.001 on purpose. On the helix they make no difference; towards
the straight line the remaining error is proportional to them, and so is the largest step that the
posture control matrix can ask for before it is shortened to the limit. The threshold of Projection leaves
out 0.5, the smaller singular value of a straight module with equal links: there it would flicker.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import replace
from pathlib import Path

import numpy as np

import pinposture as pp
from pinposture.study import study
from pinposture.thesis.scenarios import SPATIAL_SCENARIOS

SEEDS = range(1000, 1020)
FLOOR = 1e-6
NOISE = 0.005
"""Differences in the objective below this are rounding, amplified by chaotic runs."""
SEARCHED = {
    "selection": (
        pp.Selection(),
        {
            "absolute": (0.001, 0.002, 0.005, 0.01, 0.02, 0.05),
            "relative": (0.001, 0.002, 0.005, 0.01, 0.02, 0.05),
            "conditioning": (1e-4, 5e-4, 2e-3, 1e-2),
            "gain": (0.25, 0.5, 1.0),
            "null_gain": (0.0, 0.25, 0.5, 1.0),
        },
    ),
    "projection": (
        pp.Projection(),
        {
            "threshold": (0.05, 0.1, 0.2, 0.3, 0.4, 0.6),
            "coupling": ("full", "local"),
            "gain": (0.25, 0.5, 1.0),
            "null_gain": (0.0, 0.25, 0.5, 1.0),
        },
    ),
}


def objective(arm: pp.Arm, controller: pp.Selection | pp.Projection, jobs: int) -> float:
    """Mean log10 of the share of the posture error that is left."""
    # Selection cannot leave the straight arm, whatever its parameters.
    able = [s for s in SPATIAL_SCENARIOS if s.start != "straight" or isinstance(controller, pp.Projection)]
    outcomes = study(arm, able, [controller], SEEDS, jobs=jobs)
    return float(np.mean(np.log10([max(outcome.ratio, FLOOR) for outcome in outcomes])))


def search(name: str, jobs: int) -> dict[str, object]:
    """Coordinate search; returns the best parameters and everything tried."""
    arm = pp.Arm.from_template("RyRz", 20)
    best, grid = SEARCHED[name]
    lowest = objective(arm, best, jobs)
    tried = [{"parameters": repr(best), "objective": lowest}]
    changed = True
    while changed:
        changed = False
        for parameter, values in grid.items():
            for value in values:
                candidate = replace(best, **{parameter: value})
                if any(entry["parameters"] == repr(candidate) for entry in tried):
                    continue
                found = objective(arm, candidate, jobs)
                tried.append({"parameters": repr(candidate), "objective": found})
                print(f"{found:8.4f}  {candidate}", flush=True)
                if found < lowest - NOISE:
                    best, lowest, changed = candidate, found, True
    print(f"best of {name}: {lowest:.4f}  {best}")
    return {"best": repr(best), "objective": lowest, "tried": tried}


def main() -> None:
    """Search both controllers; write what was found."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--save", type=Path, help="write the record here")
    parser.add_argument("--jobs", type=int, default=2)
    arguments = parser.parse_args()
    record = {name: search(name, arguments.jobs) for name in SEARCHED}
    if arguments.save:
        arguments.save.parent.mkdir(parents=True, exist_ok=True)
        arguments.save.write_text(json.dumps(record, indent=1) + "\n")


if __name__ == "__main__":
    main()
