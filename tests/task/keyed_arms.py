"""Arms and motions that the tests of keyframes share."""

from __future__ import annotations

import numpy as np

import pinposture as pp
from pinposture.task.keyframes import Keyframe
from pinposture.task.reference import Reference

S_CURVE = np.array([(0, 0, 0), (0.4, 0, 0), (0.6, 0.3, 0.1), (0.9, 0.3, 0.3), (1.3, 0.2, 0.3)])


def positions(reference: Reference) -> np.ndarray:
    """Joint positions of all rows, (N + 1, nv)."""
    return reference.offsets + reference.arm.positions(reference.start)


def straight(length: float) -> pp.Curve:
    return pp.Curve.line((0, 0, 0), (length, 0, 0))


def coil(length: float) -> pp.Curve:
    """A coil that the arm runs round more than twice, beside itself."""
    return pp.Curve.helix(0.06 * length, 0.06 * length, 3)


def five_postures(length: float = 1.0) -> list[Keyframe]:
    """Straight, S, helix, tight coil with a hold, straight."""
    return [
        Keyframe(straight(length), name="straight"),
        Keyframe(pp.Curve.spline(length * S_CURVE), duration=1.5, name="S", trim=True),
        Keyframe(pp.Curve.helix(0.06 * length, 0.15 * length, 4, handedness="left"), duration=1.0, trim=True),
        Keyframe(coil(length), duration=2.0, hold=0.5, name="coil", trim=True),
        Keyframe(straight(length), duration=2.0),
    ]


def snake(*joints: pp.JointSpec, modules: int = 10) -> pp.Arm:
    """An arm of equal modules with these joints, each followed by a link of 25 mm."""
    template = pp.ModuleTemplate("snake", joints, (0.025,) * len(joints))
    return pp.Arm.from_modules([template] * modules)
