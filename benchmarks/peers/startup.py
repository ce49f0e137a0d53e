"""How long it takes until something happens: imports, and the first step of a process."""

from __future__ import annotations

import os
import statistics
import subprocess
import tempfile
from collections.abc import Callable
from typing import Any

IMPORTS = {"import pinposture": "import pinposture", "peers of it": "import pinocchio, scipy.optimize"}

TIMED = "import time; t = time.perf_counter(); {}; print(time.perf_counter() - t)"

FIRST = """
import time
begun = time.perf_counter()
import pinposture as pp
arm = pp.Arm.from_template("RyRz", modules=20)
target = pp.Target.from_configuration(arm, [0.1] * arm.nq)
controller, limits = pp.Geodesic(), pp.Limits()
loaded = time.perf_counter()
step = controller.step(arm.at(arm.straight()), target, limits)
first = time.perf_counter()
print(loaded - begun, first - loaded)
"""


def measure(
    python: str, environment: dict[str, str], repeats: int, told: Callable[[], object]
) -> dict[str, Any]:
    """Times [s] in fresh interpreters, by turns; `told` is called after each."""
    times: dict[str, list[float]] = {name: [] for name in IMPORTS}
    for number in range(repeats + 1):
        for name, statement in IMPORTS.items():
            spent = _run(python, TIMED.format(statement), environment)[0]
            if number:  # the first reads the files from disk
                times[name].append(spent)
            told()
    imports = {name: {"best": min(each), "median": statistics.median(each)} for name, each in times.items()}
    median, best = (
        imports["import pinposture"][which] / imports["peers of it"][which] for which in ("median", "best")
    )
    _run(python, FIRST, environment)  # fills the cache
    told()
    kept = _run(python, FIRST, environment)
    told()
    with tempfile.TemporaryDirectory() as folder:
        empty = _run(python, FIRST, environment | {"NUMBA_CACHE_DIR": folder})
    told()
    return {
        "imports": imports,
        "ratio": {"best": best, "median": median},
        "first_step": {
            "kernels kept": {"load": kept[0], "step": kept[1]},
            "kernels compiled": {"load": empty[0], "step": empty[1]},
        },
    }


def rounds(repeats: int) -> int:
    """How often `measure` tells."""
    return len(IMPORTS) * (repeats + 1) + 3


def _run(python: str, text: str, environment: dict[str, str]) -> list[float]:
    command = [python, "-W", "ignore", "-c", text]
    ran = subprocess.run(
        command, env=os.environ | environment, capture_output=True, text=True, check=True, timeout=300
    )
    return [float(word) for word in ran.stdout.split()]
