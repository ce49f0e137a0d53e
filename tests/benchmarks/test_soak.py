"""A short run of the control loop in which everything goes wrong."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.soak

SOAK = Path(__file__).parents[2] / "benchmarks" / "soak.py"


def soaked(*options: str) -> dict[str, object]:
    command = [sys.executable, str(SOAK), "--steps", "400", "--modules", "4", "--json", *options]
    done = subprocess.run(command, check=True, capture_output=True, text=True, timeout=300)
    return dict(json.loads(done.stdout))


@pytest.mark.parametrize("options", [(), ("--free", "--seed", "3")])
def test_limits_hold_whatever_goes_wrong(options: tuple[str, ...]) -> None:
    found = soaked(*options)
    assert found["steps"] == 400 and len(found["memory [MB], ten times on the way"]) == 10
    assert found["largest speed, of its limit"] <= 1.0 + 1e-9
    hardest = found["largest acceleration, of its limit"]
    assert hardest is None if "--free" in options else 0.5 < hardest <= 1.0 + 1e-9
    assert found["farthest beyond a position limit [rad]"] <= 1e-9
    cycles = {name: count for name, count in found.items() if name.startswith("cycles ")}
    assert sum(cycles.values()) == 400 and cycles["cycles moving"] > 20 and cycles["cycles holding"] > 2
