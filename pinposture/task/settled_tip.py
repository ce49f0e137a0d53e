"""The configuration of a keyframe that also does what is asked of its tip."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pinposture.arm import Arm
from pinposture.control.constrained.goal import find_goal
from pinposture.control.constrained.posture import Posture
from pinposture.control.tasks import EndEffector
from pinposture.errors import TaskError
from pinposture.target import Target

Array = NDArray[np.float64]

GOOD = 1e-8
"""Mean distance of the control points from their targets at which all is settled, in arm lengths."""

MET = 1e-4
"""How far a strict task may be from being met, in arm lengths."""


def settled_tip(arm: Arm, target: Target, tip: EndEffector, where: str) -> Array:
    """The joint displacement (nv,) [rad or m] from a target's configuration to one that also serves the tip.

    Args:
        arm: the arm.
        target: the posture, with the configuration `q` that takes it.
        tip: what is asked of the tip.
        where: what to call the keyframe.

    Raises:
        TaskError: a strict task that the arm cannot do.
    """
    assert target.q is not None
    posture = Posture(arm, target, (tip,))
    edges = np.array([arm.limits.lower, arm.limits.upper])
    state = find_goal(posture, arm.at(target.q), edges, None, GOOD * arm.length).state
    left = posture.task_rows(state, strict=True)
    if left is not None and (missed := float(np.linalg.norm(left.errors))) > MET * arm.length:
        advice = (
            "move it nearer, let the posture count for a region only, or give a weight in place of strict"
        )
        raise TaskError(where, f"its strict tip task is missed by {missed:.4g} m at least; {advice}")
    return np.asarray(arm.difference(target.q, state.q))
