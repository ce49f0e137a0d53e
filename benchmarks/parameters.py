"""The search behind the default parameters of Selection, Projection and Switching.

    python benchmarks/parameters.py --save benchmarks/results/parameters.json
    python benchmarks/parameters.py switching          # one of them

Each parameter in turn takes the value that gives the lowest objective, the others held, until a round
changes nothing. The objective is the mean over all cases of log10(final / start posture error), floored
at 1e-6; for Switching, which nearly always arrives, the mean share of the steps that it took is added. The
seeds (1000 to 1019) are not those on which the results are reported.

The index thresholds of Selection end at 0.001 on purpose. On the helix they make no difference; towards
the straight line the remaining error is proportional to them, and so is the largest step that the
posture control matrix can ask for before it is shortened to the limit. The threshold of Projection leaves
out 0.5, the smaller singular value of a straight module with equal links: there it would flicker. The
planar search finds the score "error" a little ahead of "geometric", which "auto" takes for planar arms
all the same: there the posture error rises on 4 to 6 % of the steps against 26 %, and arcs and harsh starts
end closer. The search may find "relative" to be the best coupling of Projection, and does; the default
remains "full", which is the method of the thesis put right, with the threshold that suits it (0.4); for
"relative", 0.2 is better by 0.5, and within Switching the two make no difference. The patience of Switching
begins at 0.3, three steps of the usual length: below that Selection would hardly have a say.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import pinposture as pp
from pinposture.study import study
from pinposture.study.scenarios import PLANAR_SCENARIOS, SCENARIOS, SPATIAL_SCENARIOS, Scenario
from pinposture.study.thesis_arms import ARMS

SEEDS = range(1000, 1020)
FLOOR = 1e-6
NOISE = 0.005
"""Differences in the objective below this are rounding, amplified by chaotic runs."""


class Search(NamedTuple):
    """Where a search begins, what it may change, and what it is judged by."""

    start: Any
    grid: Mapping[str, Sequence[Any]]
    scenarios: Sequence[Scenario]
    max_steps: int = 200
    weigh_steps: bool = False


_MOVABLE = [scenario for scenario in SPATIAL_SCENARIOS if scenario.start != "straight"]
_MOVABLE_PLANAR = [scenario for scenario in PLANAR_SCENARIOS if scenario.start != "straight"]
# Selection cannot leave the straight arm, whatever its parameters.

SEARCHES = {
    "selection": Search(
        pp.Selection(),
        {
            "absolute": (0.001, 0.002, 0.005, 0.01, 0.02, 0.05),
            "relative": (0.001, 0.002, 0.005, 0.01, 0.02, 0.05),
            "conditioning": (1e-4, 5e-4, 2e-3, 1e-2),
            "gain": (0.25, 0.5, 1.0),
            "null_gain": (0.0, 0.25, 0.5, 1.0),
        },
        _MOVABLE,
    ),
    "planar-selection": Search(
        pp.Selection(),
        {
            "score": ("auto", "error", "thesis"),
            "absolute": (0.001, 0.005, 0.02),
            "relative": (0.001, 0.01, 0.05, 0.2),
        },
        _MOVABLE_PLANAR,
    ),
    "projection": Search(
        pp.Projection(),
        {
            "threshold": (0.02, 0.05, 0.1, 0.2, 0.3, 0.4, 0.6),
            "coupling": ("full", "local", "relative"),
            "gain": (0.25, 0.5, 1.0),
            "null_gain": (0.0, 0.25, 0.5, 1.0),
        },
        SPATIAL_SCENARIOS,
    ),
    "switching": Search(
        pp.Switching(),
        {
            "patience": (0.3, 0.5, 1.0),
            "progress": (0.02, 0.05, 0.1, 0.2),
            "stay": (0.5, 1.0, 2.0),
            "reach": (0.1, 0.15, 0.2, 0.3, 0.5),
        },
        (*SPATIAL_SCENARIOS, SCENARIOS["random"], *PLANAR_SCENARIOS),
        max_steps=400,
        weigh_steps=True,
    ),
}


def objective(search: Search, controller: Any, jobs: int) -> float:
    """What a search wants to be low."""
    costs = []
    for scenario in search.scenarios:
        arm = pp.Arm.from_modules(ARMS[scenario.arm])
        outcomes = study(arm, [scenario], [controller], SEEDS, max_steps=search.max_steps, jobs=jobs)
        cost = np.log10([max(outcome.ratio, FLOOR) for outcome in outcomes])
        if search.weigh_steps:
            cost += np.array([outcome.steps for outcome in outcomes]) / search.max_steps
        costs.append(cost)
    return float(np.mean(costs))


def run(search: Search, jobs: int) -> dict[str, object]:
    """Coordinate search; returns the best parameters and everything tried."""
    best = search.start
    lowest = objective(search, best, jobs)
    tried = [{"parameters": repr(best), "objective": lowest}]
    print(f"{lowest:8.4f}  {best}", flush=True)
    changed = True
    while changed:
        changed = False
        for parameter, values in search.grid.items():
            for value in values:
                candidate = replace(best, **{parameter: value})
                if any(entry["parameters"] == repr(candidate) for entry in tried):
                    continue
                found = objective(search, candidate, jobs)
                tried.append({"parameters": repr(candidate), "objective": found})
                print(f"{found:8.4f}  {candidate}", flush=True)
                if found < lowest - NOISE:
                    best, lowest, changed = candidate, found, True
    print(f"best: {lowest:.4f}  {best}")
    return {"best": repr(best), "objective": lowest, "tried": tried}


def main() -> None:
    """Search what is asked for; write what was found beside what was known of the others."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"of {', '.join(SEARCHES)}; all if none")
    parser.add_argument("--save", type=Path, help="write the record here")
    parser.add_argument("--jobs", type=int, default=2)
    arguments = parser.parse_args()
    unknown = set(arguments.names) - set(SEARCHES)
    if unknown:
        parser.error(f"no search is called {sorted(unknown)[0]!r}; choose from {', '.join(SEARCHES)}")
    known = arguments.save and arguments.save.is_file()
    record = json.loads(arguments.save.read_text()) if known else {}
    record |= {name: run(SEARCHES[name], arguments.jobs) for name in arguments.names or SEARCHES}
    if arguments.save:
        arguments.save.parent.mkdir(parents=True, exist_ok=True)
        arguments.save.write_text(json.dumps(record, indent=1) + "\n")


if __name__ == "__main__":
    main()
