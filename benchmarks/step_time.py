"""Time of one step of every controller, and of one target resolution.

    python benchmarks/step_time.py [--modules 20 50] [--save FILE] [--compare FILE]

Times depend on the machine: compare figures of one run with each other, or two runs on the same machine.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

import pinposture as pp
from pinposture.control import CONTROLLERS, Controller, Memory, Step, controller_named
from pinposture.study import smooth_configuration
from pinposture.target import Target
from pinposture.thesis.arms import PLANAR

Array = NDArray[np.float64]


def percentiles(action: Callable[[], object], repeats: int) -> list[float]:
    """Median, 95th and 99th percentile of the time of one call [us]."""
    for _ in range(10):
        action()
    times = []
    for _ in range(repeats):
        begun = time.perf_counter()
        action()
        times.append(time.perf_counter() - begun)
    return [float(x) * 1e6 for x in np.percentile(times, [50, 95, 99])]


def measure(arm: pp.Arm, repeats: int) -> dict[str, list[float]]:
    """Times of what one cycle of a controller is made of."""
    curve = pp.Curve.line((0, 0, 0), (1.1 * arm.length, 0, 0))
    amplitude = 0.05
    if arm.dimension == 3:
        curve, amplitude = pp.Curve.helix(radius=0.06, pitch=0.15, turns=4 * arm.length), 0.6
    q = smooth_configuration(arm, np.random.default_rng(0), amplitude)
    target = pp.resolve_targets(arm, curve)
    data = arm.model.createData()
    actions: dict[str, Callable[[], object]] = {
        "Pinocchio: all joint Jacobians": lambda: pin.computeJointJacobians(arm.model, data, q),
        "Arm.at": lambda: arm.at(q),
        "Arm.at + all-pairs manipulability": lambda: arm.at(q).manipulability(),
    }
    for name in CONTROLLERS:
        controller = controller_named(name)
        first = controller.step(arm.at(q), target)  # that of qp plans the whole way
        after = arm.integrate(q, first.dq)
        actions[f"Arm.at + step of {name}"] = partial(
            step, arm, after, controller, target, None, first.memory
        )
    qp, bound = controller_named("qp"), pp.Limits(acceleration=10.0, dt=0.02)
    way = qp.step(arm.at(q), target, bound).memory.own
    fast = Memory(np.full(arm.nv, 0.02), way)  # too fast to go the way: the program has to be solved
    actions["Arm.at + step of qp, limits bind"] = partial(step, arm, q, qp, target, bound, fast)
    found = {name: percentiles(action, repeats) for name, action in actions.items()}
    rare: dict[str, Callable[[], object]] = {
        "Arm.at + first step of qp, with its plan": partial(step, arm, q, qp, target, None, None),
        "resolve_targets, 2000 samples": lambda: pp.resolve_targets(arm, curve),
    }
    return found | {name: percentiles(action, repeats // 20) for name, action in rare.items()}


def step(arm: pp.Arm, q: Array, controller: Controller, target: Target, limits: Any, memory: Any) -> Step:
    """One cycle: the state of the arm, and a step."""
    return controller.step(arm.at(q), target, limits, memory)


def main() -> None:
    """Measure, print, save, compare."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--modules", type=int, nargs="+", default=[20, 50])
    parser.add_argument("--repeats", type=int, default=500)
    parser.add_argument("--save", type=Path)
    parser.add_argument("--compare", type=Path, help="a file written by --save; adds the ratio of medians")
    arguments = parser.parse_args()
    before = json.loads(arguments.compare.read_text()) if arguments.compare else {}
    found = {}
    arms = [pp.Arm.from_template("RyRz", modules) for modules in arguments.modules]
    for arm in (*arms, pp.Arm.from_modules(PLANAR, name="planar45")):
        found[arm.model.name] = measure(arm, arguments.repeats)
        title = f"{arm.model.name}, {arm.nv} DOF"
        table = Table("", r"p50 \[us]", r"p95 \[us]", r"p99 \[us]", "p50 / before", title=title)
        for name, times in found[arm.model.name].items():
            old = before.get(arm.model.name, {}).get(name)
            ratio = f"{times[0] / old[0]:.2f}" if old else "-"
            table.add_row(name, *(f"{value:.0f}" for value in times), ratio)
        Console().print(table)
    if arguments.save:
        arguments.save.write_text(json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    main()
