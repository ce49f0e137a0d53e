"""The benchmark of scans measures the same surroundings three times."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parents[2] / "benchmarks" / "scan_obstacles.py"


@pytest.mark.studies
def test_boxes_and_scans_of_them_are_equally_far() -> None:
    command = [sys.executable, str(SCRIPT), "--boxes", "5", "--items", "4000", "--json"]
    done = subprocess.run(command, check=True, capture_output=True, text=True, timeout=300)
    boxes, points, triangles = json.loads(done.stdout).values()
    assert set(boxes) == set(points) == set(triangles)
    assert triangles["clearance"] == pytest.approx(boxes["clearance"], abs=0.5)
    assert -0.5 < points["clearance"] - boxes["clearance"] < 5.0  # there is nothing between the points
