"""What an arm no longer says of how it was loaded: locked joints, and the links at which modules end."""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin

from pinposture.arm import Arm
from pinposture.arm.description import Description, JointDescription
from pinposture.arm.holding import held_positions
from pinposture.arm.skeleton import joint_axes, neutral_placements
from pinposture.arm.urdf_joint import CHAIN_JOINTS

ROUNDED = 1e-12
"""How far places and joint positions may be apart that are the same [rad or m]."""


def locked_joints(arm: Arm, description: Description, base: str, tip: str) -> dict[str, float]:
    """Positions of the joints that have to be locked for the arm to come out as it is [rad or m].

    Those are the joints on the chain that could move and do not, and others that are elsewhere than they
    would be by themselves.

    Args:
        arm: the arm.
        description: what it was made of.
        base: link at which it begins.
        tip: link at which it ends.
    """
    whole = pin.buildModelFromXML(description.text)
    moving, chain = set(arm.joint_names), {joint.name for joint in description.chain(base, tip)}
    held = {
        joint.name: _position(arm.model, whole, joint)
        for joint in description.joints
        if joint.type in CHAIN_JOINTS and joint.name not in moving
    }
    needed = {joint.name for joint in description.joints if joint.moves} & chain
    locked = {name: at for name, at in held.items() if name in needed}
    usual = held_positions(description, locked)
    return locked | {name: at for name, at in held.items() if abs(at - usual[name]) > ROUNDED}


def _position(model: pin.Model, whole: pin.Model, joint: JointDescription) -> float:
    """Where a joint is that a model holds still [rad or m].

    Args:
        model: the model, the base of which may have been moved.
        whole: the same robot, all of its joints free, in its neutral configuration.
        joint: the joint.
    """

    def between(frames: pin.Model) -> tuple[pin.SE3, pin.SE3]:
        ids = (frames.getFrameId(link, pin.FrameType.BODY) for link in (joint.parent, joint.child))
        parent, child = (frames.frames[index].placement for index in ids)
        return parent, child

    index = whole.getJointId(joint.name)
    parent, child = between(whole)
    begin, end = between(model)
    moved = whole.jointPlacements[index].actInv(parent * begin.actInv(end)) * child.inverse()
    axis = joint_axes(whole, [index])[0]
    if joint.type == "prismatic":
        return _short(float(axis @ moved.translation))
    turn = moved.rotation
    sine = 0.5 * float(axis @ (turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]))
    return _short(math.atan2(sine, 0.5 * (float(np.trace(turn)) - 1.0)))


def _short(number: float) -> float:
    """The same number but for rounding, with as many digits as a person would have given it."""
    return next((r for digits in range(3, 13) if abs((r := round(number, digits)) - number) < 1e-14), number)


def links_of_modules(arm: Arm) -> list[str] | None:
    """Links at whose origins modules end; None if there is no such link for each."""
    model, placements = arm.model, neutral_placements(arm.model)
    places = {
        str(frame.name): (placements[frame.parentJoint] * frame.placement).translation
        for frame in model.frames
        if frame.type == pin.FrameType.BODY
    }
    found = []
    for point in arm.chain.points:
        near = [link for link, at in places.items() if np.abs(at - point).max() <= ROUNDED * arm.length]
        if not near:
            return None
        found.append(near[-1])
    return found
