"""Placements in a task file: a position, and roll, pitch and yaw."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

Array = NDArray[np.float64]

ROUNDED = 1e-15
"""How far what three angles say may be from a rotation matrix, entry by entry."""


def write_placement(placement: pin.SE3) -> dict[str, Any]:
    """What stands in a file for a placement; nothing for what is zero."""
    described: dict[str, Any] = {}
    if np.any(placement.translation):
        described["position"] = placement.translation.tolist()
    if not np.array_equal(placement.rotation, np.eye(3)):
        described["rotation"] = roll_pitch_yaw(placement.rotation)
    return described


def roll_pitch_yaw(rotation: Array) -> list[float]:
    """The angles of a rotation matrix (3, 3) [rad], with no more digits than it takes to find it again."""
    angles = np.asarray(pin.rpy.matrixToRpy(rotation))
    for digits in range(3, 17):
        rounded = np.round(angles, digits) + 0.0  # and no zero below zero
        if np.abs(pin.rpy.rpyToMatrix(*rounded) - rotation).max() <= ROUNDED:
            return [float(angle) for angle in rounded]
    return [float(angle) for angle in angles]
