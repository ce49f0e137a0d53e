"""Soft limits: the <safety_controller> of a joint stops it there, inside the limits of its <limit>."""

from __future__ import annotations

from dataclasses import replace

from pinposture.arm.description import Description
from pinposture.arm.urdf import JointDescription, SoftLimits, quote_joints
from pinposture.errors import URDFError

ADVICE = "hard_limits=True (--hard-limits) ignores soft limits"
"""How to ignore soft limits."""


def with_soft_limits(description: Description) -> Description:
    """Return a description in which soft limits narrow the position limits of joints.

    Continuous and fixed joints keep theirs.

    Raises:
        URDFError: soft limits leave a joint no range, or are crossed.
    """
    joints = []
    for joint in description.joints:
        limited = joint.type in ("revolute", "prismatic") and joint.moves
        narrowed = None if joint.soft is None or not limited else _narrowed(joint, joint.soft, description)
        joints.append(narrowed or joint)
    return replace(description, joints=tuple(joints))


def _narrowed(joint: JointDescription, soft: SoftLimits, description: Description) -> JointDescription:
    lower = max(joint.lower, soft.lower)
    upper = min(joint.upper, soft.upper)
    if lower < upper:
        return replace(joint, lower=lower, upper=upper)
    words = f"{soft.lower:g} to {soft.upper:g}"
    if soft.lower > soft.upper:
        reason = f"<safety_controller> soft limits are {words}; allowed: lower <= upper (0 if not given)"
    else:
        hard = f"{joint.lower:g} to {joint.upper:g}"
        reason = f"<safety_controller> soft limits are {words}, and leave no range within {hard}"
    raise URDFError(description.source, f"joint {joint.name!r}", f"{reason}; {ADVICE}")


def soft_limited(narrowed: Description, read: Description, names: list[str]) -> tuple[str, ...]:
    """Return those of some joints whose limits are narrower than they were read."""
    before = {joint.name: (joint.lower, joint.upper) for joint in read.joints}
    chosen = set(names)
    return tuple(
        joint.name
        for joint in narrowed.joints
        if joint.name in chosen and (joint.lower, joint.upper) != before[joint.name]
    )


def soft_limit_warnings(read: Description, names: list[str]) -> list[str]:
    """Describe soft limits of some joints that are not what they seem.

    Args:
        read: the description as it was read, with hard limits.
        names: names of the joints.
    """
    chosen = set(names)
    soft = {joint.name: joint.soft for joint in read.joints if joint.soft and joint.name in chosen}
    by_name = {joint.name: joint for joint in read.joints}
    messages = []
    endless = [name for name in soft if by_name[name].type == "continuous"]
    if endless:
        messages.append(
            f"soft limits of {quote_joints(endless)} are not used, as continuous joints have no limits"
        )
    limited = {name: limits for name, limits in soft.items() if name not in endless}
    halves = [name for name, limits in limited.items() if limits.one_sided]
    if halves:
        messages.append(
            f"<safety_controller> of {quote_joints(halves)} gives one of two soft limits; the other is 0, "
            f"as in URDF ({ADVICE})"
        )
    beyond = [
        name
        for name, limits in limited.items()
        if limits.lower < by_name[name].lower or limits.upper > by_name[name].upper
    ]
    if beyond:
        messages.append(
            f"soft limits of {quote_joints(beyond)} are beyond the limits of <limit>, which apply where "
            "they are"
        )
    return messages
