"""Time of one control step and of one target resolution.

    python benchmarks/step_time.py [--modules 20 50] [--save FILE] [--compare FILE]

Times depend on the machine: compare figures of one run with each other, or two runs on the same machine.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pinocchio as pin
from rich.console import Console
from rich.table import Table

import pinposture as pp
from pinposture.study import smooth_configuration


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


def measure(modules: int, repeats: int) -> dict[str, list[float]]:
    """Times of what one cycle of a controller is made of, for an arm of so many RyRz modules."""
    arm = pp.Arm.from_template("RyRz", modules)
    rng = np.random.default_rng(0)
    q = smooth_configuration(arm, rng, 0.6)
    curve = pp.Curve.helix(radius=0.06, pitch=0.15, turns=0.2 * modules)
    target = pp.resolve_targets(arm, curve)
    data = arm.model.createData()

    def cycle(controller: pp.Controller) -> Callable[[], object]:
        return lambda: controller.step(arm.at(q), target)

    return {
        "Pinocchio: all joint Jacobians": percentiles(
            lambda: pin.computeJointJacobians(arm.model, data, q), repeats
        ),
        "Arm.at": percentiles(lambda: arm.at(q), repeats),
        "Arm.at + all-pairs manipulability": percentiles(lambda: arm.at(q).manipulability(), repeats),
        "Arm.at + Selection step": percentiles(cycle(pp.Selection()), repeats),
        "Arm.at + Projection step": percentiles(cycle(pp.Projection()), repeats),
        "resolve_targets, 2000 samples": percentiles(lambda: pp.resolve_targets(arm, curve), repeats // 10),
    }


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
    for modules in arguments.modules:
        found[str(modules)] = measure(modules, arguments.repeats)
        table = Table(
            "", r"p50 \[us]", r"p95 \[us]", r"p99 \[us]", "p50 / before", title=f"{2 * modules} DOF"
        )
        for name, times in found[str(modules)].items():
            old = before.get(str(modules), {}).get(name)
            ratio = f"{times[0] / old[0]:.2f}" if old else "-"
            table.add_row(name, *(f"{value:.0f}" for value in times), ratio)
        Console().print(table)
    if arguments.save:
        arguments.save.write_text(json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    main()
