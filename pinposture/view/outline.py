"""The line that a target posture lies on."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pinposture.arm import Arm
from pinposture.target import Target
from pinposture.view.body import backbone

Array = NDArray[np.float64]

SAMPLES = 400
BEYOND = 0.6
"""How much of a curve is shown beyond the last target point, relative to the length of the arm."""


class Outline(NamedTuple):
    """A target as lines.

    Attributes:
        covered: what the arm should lie on: the curve up to the last target point, or without a curve the
            target posture if it is known, (n, 3) [m], world frame; empty if neither is.
        rest: what comes of the curve after that, (k, 3) [m], world frame; may be empty.
    """

    covered: Array
    rest: Array


def outline(arm: Arm, target: Target) -> Outline:
    """The line that a target posture lies on, as far as it is known."""
    nothing = np.zeros((0, 3))
    if target.curve is None:
        return Outline(nothing if target.q is None else backbone(arm, target.q), nothing)
    length = target.curve.length
    if target.parameters is None:
        return Outline(target.curve.at(np.linspace(0.0, length, SAMPLES)), nothing)
    end = float(np.clip(np.max(target.parameters[target.placed], initial=0.0), 0.0, length))
    shown = min(length, end + BEYOND * arm.length)
    # Less than this of a line cannot be seen, and may not have a direction.
    parts = [(0.0, end), (end, shown)]
    lines = [
        target.curve.at(np.linspace(*part, SAMPLES)) if np.ptp(part) > 1e-6 * length else nothing
        for part in parts
    ]
    return Outline(*lines)
