"""Tasks that the tests of the editor share."""

from __future__ import annotations

from functools import cache

import numpy as np
from arms import template_arm

import pinposture as pp
from pinposture.task import Keyframe, Task

L = 0.3
"""Length of the arm of six modules [m]."""


def six_modules() -> pp.Arm:
    """The arm of the tasks."""
    return template_arm("RyRz", 6)


@cache
def straight_line() -> pp.Curve:
    return pp.Curve.line((0, 0, 0), (L, 0, 0))


@cache
def bent_spline() -> pp.Curve:
    return pp.Curve.spline(
        L * np.array([(0, 0, 0), (0.4, 0, 0), (0.7, 0.1, 0.1), (1.0, 0.2, 0.1), (1.4, 0.2, 0)])
    )


@cache
def coil() -> pp.Curve:
    return pp.Curve.helix(0.2 * L, 0.3 * L, 2)


def task(*keyframes: Keyframe, arm: pp.Arm | None = None, **values: object) -> Task:
    """A task of keyframes, by default four: of times, of a duration, one of them held."""
    given = keyframes or (
        Keyframe(straight_line(), name="straight"),
        Keyframe(bent_spline(), time=1.0, hold=0.5, trim=True),
        Keyframe(coil(), duration=2.0, name="coil", trim=True),
        Keyframe(straight_line(), time=5.0),
    )
    values.setdefault("limits", pp.Limits(dt=0.02, velocity=2.0))
    return Task(arm=arm or six_modules(), motion=tuple(given), **values)  # type: ignore[arg-type]
