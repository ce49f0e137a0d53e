"""Planning among obstacles: this library, OMPL and roboplan on the problems of the study `clutter`.

    python -m benchmarks.peers.clutter                # nine kinds, 5 problems of each, 10 s for the peers
    python -m benchmarks.peers.clutter --kinds hole,shelf --seeds 50 --json
    python -m benchmarks.peers.clutter --joints 400 --planners ours

All solve a problem one after the other in one process, with one thread, each for itself first on a problem
that does not count. Times are processor times, medians (90th percentiles): until a first path is known, and
until it is shortened (relaxed, with this library). Models, scenes and trees of obstacles are there before.
Ratios are path lengths of the control points, relative to straight lines. Problems that a planner does not
solve count with their time, and without a ratio. Paths are checked every 0.01 rad with distances of this
library: how many keep the margin to a millimetre, and how much of it the worst one misses.

Before it is timed, the scene of roboplan is compared at 100 configurations a problem.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
from collections.abc import Iterator
from importlib import import_module
from itertools import chain, pairwise
from math import ceil
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.cases.clutter import KINDS_WITH_A_WAY, draw_problem, with_joints
from benchmarks.cases.situations import situation_arm
from benchmarks.harness import Problem
from benchmarks.peers import environments
from benchmarks.peers.bench import SINGLE
from benchmarks.peers.planner import RESOLUTION, Found
from benchmarks.studies.clutter import dense_clearance
from pinposture.arm import Arm
from pinposture.kernels import load
from pinposture.motion.run import path_length_ratio

Array = NDArray[np.float64]

PLANNERS = {"ours": "planner", "ompl": "ompl", "roboplan": "roboplan"}
"""Modules of this package by the names of environments, each with a class `Planner`."""

NEARLY = 1e-3
"""What a path may miss of the margin and count as keeping it [m]."""

WARM_UP = 100_000
"""Seed of the problem that does not count; those of the others are below."""

MOST_DRAWS = 10
"""Most draws for each problem."""

VERDICTS = 100
"""Configurations at which the scene of roboplan is compared."""


def along(q: Array, turn: float = RESOLUTION) -> Array:
    """Return configurations a joint motion apart on the way between waypoints (k, n), (s, n) [rad]."""
    counts = [max(ceil(float(np.abs(change).max()) / turn), 1) for change in np.diff(q, axis=0)]
    parts = [
        np.linspace(one, other, count, endpoint=False)
        for (one, other), count in zip(pairwise(q), counts, strict=True)
    ]
    return np.concatenate([*parts, q[-1:]])


def ratio_of(arm: Arm, q: Array | None) -> float | None:
    """Return the path length ratio of the control points for waypoints (k, n)."""
    return (
        None if q is None else path_length_ratio(np.array([arm.chain_at(each).points for each in along(q)]))
    )


def drawn(kind: str, first: int, count: int, joints: int) -> Iterator[tuple[int, Problem]]:
    """Draw a number of problems of an arm of a number of joints, with their seeds."""
    arm = situation_arm()
    for seed in range(first, first + MOST_DRAWS * count):
        problem = with_joints(draw_problem(arm, kind, seed), joints)
        if problem is not None:
            yield seed, problem
            count -= 1
        if not count:
            return


def judged(problem: Problem, found: Found) -> dict[str, Any]:
    """Return times, ratios and what is missed of the margin."""
    arm, _, _, scene = problem
    missed = None
    if found.path is not None:
        missed = max(scene.margin - dense_clearance(arm, scene, found.path), 0.0)
    return {
        "first_time": found.first_time,
        "first_ratio": ratio_of(arm, found.first_path),
        "time": found.time,
        "ratio": ratio_of(arm, found.path),
        "missed": missed,
    }


def summary(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Return the figures of one planner on one kind."""
    solved = [row for row in rows if row["missed"] is not None]
    figures: dict[str, Any] = {"problems": len(rows), "solved": len(solved)}
    figures["kept_margin"] = sum(row["missed"] <= NEARLY for row in solved)
    figures["missed"] = max((row["missed"] for row in solved), default=None)
    for name in ("first_time", "time"):
        figures[name] = [float(np.percentile([row[name] for row in rows], each)) for each in (50, 90)]
    for name in ("first_ratio", "ratio"):
        figures[name] = float(np.median([row[name] for row in solved])) if solved else None
    return figures


LINE = (
    "{kind:10} {planner:9} {solved:>6} {first:>18} {first_ratio:>6}"
    " {done:>18} {ratio:>6} {kept:>6} {missed:>5}"
)


def line(row: dict[str, Any]) -> str:
    """Return the line of a table."""
    spread = {name: "{:.1f} ({:.1f})".format(*(1e3 * np.array(row[name]))) for name in ("first_time", "time")}
    ratios = {name: "" if row[name] is None else f"{row[name]:.2f}" for name in ("first_ratio", "ratio")}
    return LINE.format(
        kind=row["kind"],
        planner=row["planner"],
        solved=f"{row['solved']}/{row['problems']}",
        first=spread["first_time"],
        done=spread["time"],
        kept=f"{row['kept_margin']}/{row['solved']}",
        missed="" if row["missed"] is None else f"{1e3 * row['missed']:.1f}",
        **ratios,
    )


def compare(kind: str, asked: argparse.Namespace) -> list[dict[str, Any]]:
    """Return the summaries of all planners on one kind of problems."""
    homes = {name: import_module(f"benchmarks.peers.{PLANNERS[name]}") for name in asked.planners}
    rows: dict[str, list[dict[str, Any]]] = {name: [] for name in homes}
    verdicts = np.zeros(4, int)
    warm_up = drawn(kind, WARM_UP, 1, asked.joints)
    for number, problem in chain(warm_up, drawn(kind, asked.seed0, asked.seeds, asked.joints)):
        for name, home in homes.items():
            planner = home.Planner(problem)
            if name == "roboplan":
                verdicts += planner.count_verdicts(VERDICTS, number)
            found = planner.solve(asked.budget, number)
            if number < WARM_UP:
                rows[name].append(judged(problem, found))
    summaries = [{"kind": kind, "planner": name, **summary(each)} for name, each in rows.items() if each]
    for each in summaries:
        if each["planner"] == "roboplan":
            each["verdicts"] = dict(
                zip(("collisions", "rim", "different", "count"), verdicts.tolist(), strict=True)
            )
    return summaries


def parsed() -> argparse.Namespace:
    """The command line."""
    form = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=form)
    parser.add_argument("--kinds", default=",".join(KINDS_WITH_A_WAY))
    parser.add_argument("--seeds", type=int, default=5, help="problems of each kind")
    parser.add_argument("--seed0", type=int, default=0, help="the first one")
    parser.add_argument("--joints", type=int, default=40, help="of an arm of the same length; an even number")
    parser.add_argument("--planners", nargs="+", choices=list(PLANNERS), default=list(PLANNERS))
    parser.add_argument("--budget", type=float, default=10.0, help="for each peer [s]")
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--here", action="store_true", help="no environments: what this Python can import")
    return parser.parse_args()


def main() -> int:
    """Compare, in the environment of the peers, and print a line for each kind and planner."""
    asked = parsed()
    names = {"ours", *asked.planners}
    where = environments.here(names) if asked.here else environments.prepare(names)
    for name in [each for each in asked.planners if where[each].python is None]:
        print(f"{name} is left out: {where[name].reason}", file=sys.stderr)
        asked.planners.remove(name)
    if not asked.here:
        options = [*sys.argv[1:], "--here"]
        command = [where["ours"].python or sys.executable, "-m", "benchmarks.peers.clutter", *options]
        return subprocess.run(command, cwd=environments.ROOT, env=os.environ | SINGLE, check=False).returncode
    load()
    rows = []
    if not asked.json:
        heads = {
            "kind": "kind",
            "planner": "planner",
            "solved": "solved",
            "first": "first [ms]",
            "done": "shortened [ms]",
        }
        print(LINE.format(**heads, first_ratio="ratio", ratio="ratio", kept="kept", missed="mm"))
    for kind in asked.kinds.split(","):
        own = compare(kind, asked)
        rows += own
        if not asked.json:
            print("\n".join(line(row) for row in own), flush=True)
    told = [row for row in rows if "verdicts" in row]
    if asked.json:
        json.dump(rows, sys.stdout, indent=1)
    elif told:
        total = {name: sum(row["verdicts"][name] for row in told) for name in told[0]["verdicts"]}
        words = (
            "roboplan judged {count} configurations, {collisions} of them too close, as this library does, "
            "but for {rim} that it refuses at the rim of the end, and {different} others"
        )
        print(words.format(**total))
    return 0


if __name__ == "__main__":
    sys.exit(main())
