"""No cycle of a `Tracker` waits for the compiler, or for a module to be imported."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

CYCLES = """
import sys
import numpy as np
from numba.core import event
import pinposture as pp
from pinposture.control import CONTROLLERS
from pinposture.study.scenarios import PLANAR

class Count(event.Listener):
    compiled = 0
    def on_start(self, event):
        Count.compiled += 1
    def on_end(self, event):
        pass

event.register("numba:compile", Count())
compiled, imported = 0, set()
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
            before, modules, q = Count.compiled, set(sys.modules), arm.neutral()
            for cycle in range(24):
                if cycle in targets:
                    tracker.update(targets[cycle])
                dq = tracker.step(None if cycle == 12 else q, 0.004 if cycle % 5 == 4 else None)
                q = arm.integrate(q, dq)
            compiled, imported = compiled + Count.compiled - before, imported | set(sys.modules) - modules
print(Count.compiled, compiled, sorted(imported))
"""


@pytest.mark.process
def test_no_cycle_compiles_where_nothing_is_kept_yet(tmp_path: Path) -> None:
    there = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    line = [sys.executable, "-W", "ignore", "-c", CYCLES]
    ran = subprocess.run(line, capture_output=True, text=True, env=there, check=False)
    assert ran.returncode == 0, ran.stderr
    in_all, in_cycles, imported = ran.stdout.split(maxsplit=2)
    assert int(in_all) > 50  # the first tracker had everything compiled
    assert in_cycles == "0"
    assert imported == "[]\n"
    assert ran.stderr.count("compiling kernels") == 1
