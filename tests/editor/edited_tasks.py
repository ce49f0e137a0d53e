"""Tasks that the tests of the editor share."""

from __future__ import annotations

import numpy as np

import pinposture as pp
from pinposture.task import Keyframe, Task

ARM = pp.Arm.from_template("RyRz", modules=6)
L = ARM.length

STRAIGHT = pp.Curve.line((0, 0, 0), (L, 0, 0))
BENT = pp.Curve.spline(
    L * np.array([(0, 0, 0), (0.4, 0, 0), (0.7, 0.1, 0.1), (1.0, 0.2, 0.1), (1.4, 0.2, 0)])
)
COIL = pp.Curve.helix(0.2 * L, 0.3 * L, 2)


def task(*keyframes: Keyframe, arm: pp.Arm = ARM, **values: object) -> Task:
    """A task of keyframes, by default four: of times, of a duration, one of them held."""
    given = keyframes or (
        Keyframe(STRAIGHT, name="straight"),
        Keyframe(BENT, time=1.0, hold=0.5, trim=True),
        Keyframe(COIL, duration=2.0, name="coil", trim=True),
        Keyframe(STRAIGHT, time=5.0),
    )
    values.setdefault("limits", pp.Limits(dt=0.02, velocity=3.0))
    return Task(arm=arm, motion=tuple(given), **values)  # type: ignore[arg-type]
