"""The shortest durations of paths by TOPP-RA; runs in an environment with the `toppra` package.

    python toppra_durations.py paths.npz durations.json

The archive has arrays `path_0`, `path_1`, ... of joint positions at equal distances along a path, (s, n),
and `limits_0`, ... with the limits of speed and acceleration of all joints, (2, n). Where it has `urdf_0`,
..., the text of an arm, the second are limits of torque instead.
"""

from __future__ import annotations

import json
import logging
import sys
from pathlib import Path

import numpy as np
import pinocchio as pin
import toppra
from toppra import constraint
from toppra.algorithm import TOPPRA


def shortest_duration(positions: np.ndarray, limits: np.ndarray, urdf: str = "") -> float:
    """Return the shortest duration from rest to rest of a C2 spline through joint positions [s]."""
    path = toppra.SplineInterpolator(np.linspace(0.0, 1.0, len(positions)), positions)
    speed, most = limits
    bounds = np.column_stack([-most, most])
    constraints = [constraint.JointVelocityConstraint(np.column_stack([-speed, speed]))]
    if urdf:
        model = pin.buildModelFromXML(urdf)
        data = model.createData()
        none = np.zeros(len(most))
        constraints.append(
            constraint.JointTorqueConstraint(lambda *motion: pin.rnea(model, data, *motion), bounds, none)
        )
    else:
        constraints.append(constraint.JointAccelerationConstraint(bounds))
    grid = np.linspace(0.0, 1.0, len(positions))
    found = TOPPRA(constraints, path, gridpoints=grid, parametrizer="ParametrizeConstAccel")
    return float(found.compute_trajectory(0.0, 0.0).duration)


def main() -> None:
    """Read the paths, and write the durations."""
    logging.disable(logging.CRITICAL)
    source, output = map(Path, sys.argv[1:])
    with np.load(source) as stored:
        count = sum(name.startswith("path_") for name in stored.files)
        urdfs = [str(stored[f"urdf_{k}"]) if f"urdf_{k}" in stored.files else "" for k in range(count)]
        found = [
            shortest_duration(stored[f"path_{k}"], stored[f"limits_{k}"], urdf)
            for k, urdf in enumerate(urdfs)
        ]
    output.write_text(json.dumps(found))


if __name__ == "__main__":
    main()
