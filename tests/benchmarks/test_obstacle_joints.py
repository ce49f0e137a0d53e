"""The benchmark of scenes with many joints finds a clear path for each of its problems."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest
from PIL import Image

SCRIPT = Path(__file__).parents[2] / "benchmarks" / "obstacle_joints.py"


@pytest.mark.studies
def test_every_problem_is_solved_and_drawn(tmp_path: Path) -> None:
    plot = tmp_path / "joints.png"
    options = ["--joints", "20,40", "--draws", "2", "--json", "-o", str(plot)]
    command = [sys.executable, str(SCRIPT), *options]
    done = subprocess.run(command, check=True, capture_output=True, text=True, timeout=300)
    rows = json.loads(done.stdout)
    assert [(row["joints"], row["boxes"]) for row in rows] == [(20, 30), (40, 30), (20, 150), (40, 150)]
    assert all(row["found"] == row["of"] == 2 for row in rows)
    assert all(0.0 < row["cycle_ms"] <= row["cycle_p99_ms"] for row in rows)
    assert min(Image.open(plot).size) > 200
