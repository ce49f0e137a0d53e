"""No cycle of a `Tracker` waits for the compiler, or for a module to be imported."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

FRESH = ("joint_distance", "spline_values")
"""Kernels that are not kept yet; to compile all takes minutes."""

CYCLES = """
import shutil, sys
from pathlib import Path
import numpy as np
from numba.core.dispatcher import Dispatcher
asked = []
compile_kernel = Dispatcher.compile
Dispatcher.compile = lambda self, *arguments: (asked.append(self), compile_kernel(self, *arguments))[1]
import pinposture as pp
from pinposture import kernels
there = Path(kernels.spline_values._cache.cache_path)
there.mkdir(parents=True, exist_ok=True)
for file in (Path(kernels.__file__).parent / "__pycache__").glob("*.nb?"):
    if file.name.split("-")[0].split(".")[-1] not in sys.argv[1:]:
        shutil.copy(file, there)
from pinposture.control import CONTROLLERS
from benchmarks.cases.scenarios import PLANAR

late, imported = set(), set()
box = pp.Scene({"box": pp.Box(center=(0.1, 0.15, 0.1), size=(0.05, 0.05, 0.05))}, self_collision=False)
for arm in (pp.Arm.from_template("RyRz", 6), pp.Arm.from_modules(PLANAR[:9])):
    rng = np.random.default_rng(0)
    goals = [arm.configuration(0.3 * rng.normal(size=arm.nv)) for _ in range(2)]
    targets = {
        1: pp.Target.from_configuration(arm, goals[0]),
        8: pp.Target.from_points(arm, arm.at(goals[1]).points),
        16: pp.resolve_targets(arm, pp.Curve.line((0, 0, 0), (2 * arm.length, 0, 0)), placement="as_is"),
    }
    for name in CONTROLLERS:
        for scene in (None, box):
            tracker = pp.Tracker(arm, name, pp.Limits(dt=0.01, acceleration=10.0), scene)
            before, modules, q = len(asked), set(sys.modules), arm.neutral()
            for cycle in range(24):
                if cycle in targets:
                    tracker.update(targets[cycle])
                dq = tracker.step(None if cycle == 12 else q, 0.004 if cycle % 5 == 4 else None)
                q = arm.integrate(q, dq)
            late |= {kernel.__name__ for kernel in asked[before:]}
            imported |= set(sys.modules) - modules
print(len(set(asked)), late, imported)
"""


@pytest.mark.process
def test_no_cycle_compiles_or_loads_anything(tmp_path: Path) -> None:
    there = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    line = [sys.executable, "-W", "ignore", "-c", CYCLES, *FRESH]
    ran = subprocess.run(line, capture_output=True, text=True, env=there, check=False)
    assert ran.returncode == 0, ran.stderr
    in_all, late, imported = ran.stdout.split(maxsplit=2)
    assert int(in_all) > 50  # the first tracker asked for all kernels
    assert (late, imported) == ("set()", "set()\n")
    assert ran.stderr.count("compiling kernels") == 1
