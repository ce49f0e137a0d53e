"""What a method makes of the cases of the benchmark, as a file of results that `make score` takes.

    python -m benchmarks.peers.answer numpy-lm -o out/numpy_lm.json
    python -m benchmarks.peers.answer geodesic -o out/geodesic.json
    python -m benchmarks.peers.answer --write-cases benchmarks/cases/postures-1.json

"numpy-lm" is the one of `peers`, which knows the spatial arm only and no obstacles; every other name is that
of a controller.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np

import pinposture as pp
from benchmarks import peers
from benchmarks.baselines import register_baselines
from benchmarks.peers.problem import problem
from benchmarks.score import BENCHMARK_VERSION, RESULTS_FORMAT, checksum, write_cases

CASES = Path(__file__).parents[1] / "cases/postures-1.json"
STOPS = 1e-6
"""Mean point error at which a peer stops [m]; pinposture has its own."""


def by_peer(case: dict[str, Any], known: dict[str, Any]) -> list[list[float]] | None:
    """The way of the LM in NumPy; None for the arm that it does not know."""
    if case["arm"] != "ryrz20":
        return None
    method: Any = peers.build("numpy-lm", problem(20, 0))
    target, q = np.array(case["target"]), np.array(case["start"])
    method.begin()
    method.aim(target, q)
    way = [q]
    for _ in range(known["max_steps"]):
        q = q + method.step(q)
        way.append(q)
        at, _ = method.kinematics.at(q)
        if np.linalg.norm(at - target, axis=1).mean() <= STOPS:
            break
    return [each.round(9).tolist() for each in way]


def by_controller(name: str, case: dict[str, Any], known: dict[str, Any]) -> list[list[float]]:
    """The way of a controller of this library."""
    told = known["arms"][case["arm"]]
    arm = pp.Arm.load(told["urdf"], split=told["joints_per_module"])
    target = pp.fit_points(arm, np.array(case["target"]))
    scene = None if case["scene"] is None or name != "geodesic" else pp.Scene.from_dict(case["scene"])
    limits = pp.Limits(step=known["step_limit"])
    start = np.array(case["start"])
    run = pp.track(arm, target, start, name, limits, scene, max_steps=known["max_steps"])
    return [each.round(9).tolist() for each in run.q]


def main() -> None:
    """Read the cases, work them off, write the results."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("method", nargs="?", default="numpy-lm")
    parser.add_argument("-o", "--output", type=Path, default=Path("out/results.json"))
    parser.add_argument("--write-cases", type=Path, metavar="FILE", help="draw the cases, and nothing else")
    arguments = parser.parse_args()
    if arguments.write_cases:
        print(write_cases(arguments.write_cases))
        return
    register_baselines()
    known, runs = json.loads(CASES.read_text()), []
    for case in known["cases"]:
        name = arguments.method
        way = by_peer(case, known) if name == "numpy-lm" else by_controller(name, case, known)
        if way is not None:
            runs.append({"case": case["id"], "q": way})
    results = {"format": RESULTS_FORMAT, "version": BENCHMARK_VERSION, "cases": checksum(CASES)}
    arguments.output.parent.mkdir(parents=True, exist_ok=True)
    arguments.output.write_text(json.dumps({**results, "program": arguments.method, "runs": runs}) + "\n")


if __name__ == "__main__":
    main()
