"""Where the joints stand that an arm does not move, and that servos hold in the simulation."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from pinposture.arm import Arm
from pinposture.arm.urdf_reader import CHAIN_JOINTS
from pinposture.errors import URDFError
from pinposture.sim.description import PhysicalDescription, joint_placement


def held_positions(arm: Arm, description: PhysicalDescription) -> dict[int, float]:
    """Position of each joint that moves in the description and not in the arm, by its number [rad or m].

    They are read off the arm itself, in which the links before and after such a joint are fixed to each
    other: that holds for joints off the chain, for those that the user locked, and for mimics.

    Raises:
        URDFError: the arm has no link of that name.
    """
    places = {
        str(frame.name): (int(frame.parentJoint), frame.placement)
        for frame in arm.model.frames
        if frame.type == pin.FrameType.BODY
    }
    positions: dict[int, float] = {}
    for number in description.moving:
        joint = description.read.joints[number]
        if joint.name in arm.joint_names:
            continue
        if joint.parent not in places or joint.child not in places:
            raise URDFError(
                description.read.source, f"joint {joint.name!r}", "is not in the model of the arm"
            )
        (before, parent), (after, child) = places[joint.parent], places[joint.child]
        assert before == after  # what does not move is one body
        moved = joint_placement(joint).actInv(parent.actInv(child))
        assert joint.type in CHAIN_JOINTS
        along = moved.translation if joint.type == "prismatic" else pin.log3(moved.rotation)
        positions[number] = float(np.array(joint.axis) @ along)
    return positions
