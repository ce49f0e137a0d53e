"""How far the parts of an arm have to turn on the way from one posture to another.

Where a link ends up is no question of angles modulo a full turn: it hangs on the links before it, and they on
the base, so that turns add up along the arm. A link that has to turn by more than pi cannot go the short way
round. This is what defeats least squares on the control points.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from pinposture.arm import Arm

Array = NDArray[np.float64]


def link_headings(arm: Arm, positions: Array) -> Array:
    """How far each link of a planar arm is turned about the normal of its plane, counted from the base.

    Args:
        arm: a planar arm.
        positions: joint positions, or a displacement of the joints, (nv,) [rad or m].

    Returns:
        Sum of the joint angles up to each joint of the chain, full turns included, (n,) [rad].
    """
    senses = np.sign(arm.chain.axes @ np.cross(*arm.plane)) * arm.chain.revolute
    return np.asarray(np.cumsum(senses * positions[arm.columns]))


def largest_turn(arm: Arm, start: Array, goal: Array) -> float:
    """The largest change of heading of any part of the arm between two configurations [rad].

    Of a planar arm, the largest change of the heading of any link, full turns included. Of a spatial arm, the
    same for its modules: from each module to the next, the change of orientation differs by a small rotation,
    and the rotation vectors of these, added up along the arm from the base, tell how far a module has turned.
    For a planar arm that is the change of heading at the module ends, as long as no single module bends by
    more than pi.

    Args:
        arm: the arm.
        start: configuration, (nq,).
        goal: configuration, (nq,).
    """
    if arm.dimension == 2:
        turns = link_headings(arm, np.asarray(pin.difference(arm.model, start, goal)))
        return float(np.abs(turns).max())
    return float(np.linalg.norm(_module_turns(arm, start, goal), axis=1).max())


def _module_turns(arm: Arm, start: Array, goal: Array) -> Array:
    """Rotation vectors of the modules between two configurations, added up along the arm, (m, 3) [rad]."""
    changes = arm.at(goal).rotations @ arm.at(start).rotations.transpose(0, 2, 1)
    before = np.concatenate([np.eye(3)[None], changes[:-1]])
    own = Rotation.from_matrix(changes @ before.transpose(0, 2, 1)).as_rotvec()
    return np.asarray(np.cumsum(own, axis=0))
