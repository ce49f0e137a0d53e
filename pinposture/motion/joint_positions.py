"""Configurations as numbers that a robot's drives take: one position for each joint that moves."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pinposture.arm import Arm
from pinposture.arm.skeleton import joint_screws
from pinposture.errors import InvalidValue

Array = NDArray[np.float64]

TURN, SLIDE = "rad", "m"
"""Units of the position of a joint that turns, and of one that slides."""


def joint_units(arm: Arm) -> tuple[str, ...]:
    """The unit of each joint position of an arm, (nv,), on the chain or off it.

    Raises:
        InvalidValue: a joint off the chain has several degrees of freedom, so that its name stands for more
            than one number.
    """
    for joint, name in list(zip(arm.model.joints, arm.model.names, strict=True))[1:]:
        if joint.nv > 1:
            raise InvalidValue(f"joint {str(name)!r}", joint.shortname(), "joints with one degree of freedom")
    moving = [number for number in range(1, arm.model.njoints) if arm.model.joints[number].nv == 1]
    turns = np.any(joint_screws(arm.model, moving)[:, 3:] != 0.0, axis=1)
    return tuple(TURN if turn else SLIDE for turn in turns)


def unwound(arm: Arm, q: ArrayLike) -> Array:
    """Joint positions of configurations one after the other.

    A continuous joint begins within +-pi, goes the shorter way from row to row and so has no jumps: after two
    turns it is at 4 pi.

    Args:
        arm: the arm.
        q: configurations, (N, nq).

    Returns:
        (N, nv) [rad or m]; for joints that are not continuous the very numbers of q.

    Raises:
        InvalidValue: another shape, or a row that is no configuration; names the row.
    """
    try:
        rows = np.asarray(q, dtype=np.float64)
    except (TypeError, ValueError):
        raise InvalidValue("q", q, f"configurations, (N, {arm.nq})") from None
    if rows.ndim != 2 or rows.shape[1] != arm.nq or len(rows) == 0:
        raise InvalidValue("q (shape)", rows.shape, f"(N, {arm.nq}) with at least one row")
    positions = np.array([arm.positions(arm.checked(row, f"q[{k}]")) for k, row in enumerate(rows)])
    for joint in list(arm.model.joints)[1:]:
        if joint.nv == 1 and joint.nq > 1:
            positions[:, joint.idx_v] = np.unwrap(positions[:, joint.idx_v])
    return positions
