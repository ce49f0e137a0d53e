"""What a control cycle of ours is made of, in a process of its own; `bench.py` starts it.

python -m benchmarks.peers.pieces problem.npz found.json --seconds 5
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, cast

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

import pinposture as pp
from benchmarks.peers.measure import summary
from benchmarks.peers.problem import Problem, load
from pinposture.control import Controller, Memory, Step, controller_named
from pinposture.control.planner.follow import GeodesicMemory

Array = NDArray[np.float64]

REPEATS = 500

CURVE_MODULES = 20
"""Modules of the arm that is laid on a curve."""

PINOCCHIO = 200
"""Most joints for which Pinocchio's data are made: they take memory with the third power."""

BRAKED = pp.Limits(acceleration=10.0, dt=0.02)
"""A change of dq by 0.004 rad from step to step."""


def main() -> None:
    """Measure and write."""
    parser = argparse.ArgumentParser()
    parser.add_argument("problem", type=Path)
    parser.add_argument("found", type=Path)
    parser.add_argument("--seconds", type=float, default=5.0, help="time for each piece")
    arguments = parser.parse_args()
    found: dict[str, object] = {}
    for name, action in pieces(load(arguments.problem)):
        try:
            found[name] = timed(action, arguments.seconds)
        except Exception as error:
            found[name] = {"reason": f"{type(error).__name__}: {error}".splitlines()[0][:120]}
        arguments.found.write_text(json.dumps(found))  # each time: whoever waits may lose patience


def pieces(problem: Problem) -> list[tuple[str, Callable[[], object]]]:
    """What to time, by name."""
    arm = pp.Arm.from_template("RyRz", modules=problem.modules)
    case = problem.cases[-1]
    target = pp.Target.from_configuration(arm, case.q)
    geodesic = controller_named("geodesic")
    actions: list[tuple[str, Callable[[], object]]] = [
        ("arm.at", lambda: arm.at(case.start)),
        ("arm.at, points", lambda: arm.at(case.start).points),
        ("arm.at, all-pairs manipulability", lambda: arm.at(case.start).manipulability()),
        ("geodesic, first step with its plan", partial(_step, arm, case.start, geodesic, target, None)),
        ("geodesic, limits of acceleration bind", _bound_step(arm, case.start, geodesic, target)),
    ]
    if arm.nv <= PINOCCHIO:
        model = pin.buildModelFromXML(problem.urdf)
        data = model.createData()
        actions.insert(
            0, ("Pinocchio: all joint Jacobians", lambda: pin.computeJointJacobians(model, data, case.start))
        )
    if problem.modules == CURVE_MODULES:
        curve = pp.Curve.helix(radius=0.06, pitch=0.15, turns=4 * arm.length)
        actions.append(
            ("resolve_targets, 2,000 samples", lambda: pp.resolve_targets(arm, curve, samples=2000))
        )
    return actions


def _bound_step(arm: pp.Arm, q: Array, geodesic: Controller, target: pp.Target) -> Callable[[], object]:
    """A step for which the program has to be solved: the arm is too fast to go its way, and has to brake."""
    made: list[Memory] = []

    def action() -> object:
        if not made:
            way = cast(GeodesicMemory, _step(arm, q, geodesic, target, None).memory).progress
            made.append(GeodesicMemory(np.full(arm.nv, 5.0 * 0.004), None, way))
        return _step(arm, q, geodesic, target, made[0])

    return action


def _step(arm: pp.Arm, q: Array, geodesic: Controller, target: pp.Target, memory: Memory | None) -> Step:
    return geodesic.step(arm.at(q), target, BRAKED, memory)


def timed(action: Callable[[], object], seconds: float) -> dict[str, Any]:
    """Percentiles of the time of one call [us]; in about `seconds`, and if one fits into them."""
    stop, times = time.perf_counter() + seconds, []
    action()
    if time.perf_counter() > stop:
        return {"reason": f"longer than {seconds:g} s"}
    while not times or (len(times) < REPEATS and time.perf_counter() < stop):
        begun = time.perf_counter_ns()
        action()
        times.append((time.perf_counter_ns() - begun) / 1e3)
    return summary(times)


if __name__ == "__main__":
    main()
