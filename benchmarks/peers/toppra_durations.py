"""The shortest durations of paths by TOPP-RA; runs in an environment with the `toppra` package.

    python toppra_durations.py paths.npz durations.json

The archive has arrays `path_0`, `path_1`, ... of joint positions at equal distances along a path, (s, n), and
`limits_0`, ... with the limits of speed and acceleration of all joints, (2, n).
"""

from __future__ import annotations

import json
import logging
import sys
from pathlib import Path

import numpy as np
import toppra
from toppra import constraint
from toppra.algorithm import TOPPRA


def shortest_duration(positions: np.ndarray, limits: np.ndarray) -> float:
    """Return the shortest duration from rest to rest of a C2 spline through joint positions [s]."""
    path = toppra.SplineInterpolator(np.linspace(0.0, 1.0, len(positions)), positions)
    speed, acceleration = limits
    constraints = [
        constraint.JointVelocityConstraint(np.column_stack([-speed, speed])),
        constraint.JointAccelerationConstraint(np.column_stack([-acceleration, acceleration])),
    ]
    grid = np.linspace(0.0, 1.0, len(positions))
    found = TOPPRA(constraints, path, gridpoints=grid, parametrizer="ParametrizeConstAccel")
    return float(found.compute_trajectory(0.0, 0.0).duration)


def main() -> None:
    """Read the paths, and write the durations."""
    logging.disable(logging.CRITICAL)
    source, output = map(Path, sys.argv[1:])
    with np.load(source) as stored:
        count = len(stored.files) // 2
        found = [shortest_duration(stored[f"path_{k}"], stored[f"limits_{k}"]) for k in range(count)]
    output.write_text(json.dumps(found))


if __name__ == "__main__":
    main()
