"""Coupled joints: one degree of freedom moves several joints, each by its own ratio.

Tendons and gears couple joints; URDF describes this with <mimic>: position = ratio * position of a leader +
offset. In the Pinocchio model of an arm the leader is the first of the coupled joints on the chain, whichever
joint the description names; the others are mimic joints.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pinposture._validation import require_known
from pinposture.arm.configurations import NO_LIMIT
from pinposture.arm.serialization import describe_model, rebuild_model
from pinposture.arm.urdf_reader import CHAIN_JOINTS, Description, Follows, JointDescription
from pinposture.errors import InvalidValue, URDFError

Array = NDArray[np.float64]


class Coupling(NamedTuple):
    """A joint that has no degree of freedom of its own.

    Attributes:
        joint: name of the joint.
        leader: name of the joint that it follows.
        ratio: its motion relative to that of the leader.
        offset: its position when the leader is at zero [rad or m].
    """

    joint: str
    leader: str
    ratio: float
    offset: float


class Drive(NamedTuple):
    """A joint that moves on its own in a description, but that a leader of the arm stands for.

    Attributes:
        joint: name of the joint.
        leader: name of the leader, which follows the joint in the description.
        ratio: motion of the joint relative to that of the leader.
        offset: position of the joint when the leader is at zero [rad or m].
        turns: whether the joint is revolute.
    """

    joint: str
    leader: str
    ratio: float
    offset: float
    turns: bool


class JointRange(NamedTuple):
    """Smallest and largest position [rad or m] and largest speed [rad/s or m/s] of a joint."""

    lower: float
    upper: float
    velocity: float


class CoupledJoints(NamedTuple):
    """The moving joints of a chain and their couplings.

    Attributes:
        moving: the joints that move, from base to tip.
        couplings: those of them that follow others.
        ranges: limits of each leader, by name, within which its followers keep their own limits.
        drives: joints on the chain behind a leader, or off it, that the leader follows in the description.
    """

    moving: list[JointDescription]
    couplings: list[Coupling]
    ranges: dict[str, JointRange]
    drives: list[Drive]


def with_couplings(description: Description, given: Mapping[str, object] | None) -> Description:
    """Add couplings given by the user to a description.

    Args:
        description: the description.
        given: for each following joint, the name of its leader; or the name and a ratio; or the name, a
            ratio, and an offset [rad or m].

    Raises:
        UnknownName: a joint does not exist.
        InvalidValue: not a name and numbers; names the joint.
    """
    joints = {joint.name: joint for joint in description.joints}
    for name, value in (given or {}).items():
        require_known("moving joint", name, [each for each in joints if joints[each].type in CHAIN_JOINTS])
        joints[name] = replace(joints[name], follows=_read_follows(name, value))
    return replace(description, joints=tuple(joints.values()))


def _read_follows(name: str, value: object) -> Follows:
    parts = (value,) if isinstance(value, str) or not isinstance(value, Sequence) else tuple(value)
    try:
        numbers = [float(part) for part in parts[1:]]
        if isinstance(parts[0], str) and len(numbers) <= 2 and all(map(math.isfinite, numbers)):
            return Follows(parts[0], *[*numbers, *(1.0, 0.0)[len(numbers) :]])
    except (IndexError, TypeError, ValueError):
        pass
    allowed = "the name of the joint it follows, then a ratio and an offset [rad or m], if not 1 and 0"
    raise InvalidValue(f"couplings[{name!r}]", value, allowed)


def find_couplings(
    description: Description, chain: Sequence[JointDescription], locked: Iterable[str]
) -> CoupledJoints:
    """Find the moving joints of a chain and their couplings.

    Joints do not move if they follow a locked joint or one whose limits allow a single position, or if their
    ratio is zero. A joint that follows one off the chain moves independently, within the limits of both.

    Args:
        description: the description of the joints.
        chain: joints that are neither fixed nor locked themselves, from base to tip.
        locked: names of joints locked by the user.

    Raises:
        URDFError: a joint follows one that does not exist or has no single degree of freedom; joints follow
            each other in a cycle; or the limits of coupled joints leave no common range.
    """
    named = {joint.name: joint for joint in description.joints}
    still = set(locked)
    groups: dict[str, list[tuple[JointDescription, Follows]]] = {}
    for joint in chain:
        follows = _follow(description, named, joint, still)
        leader = named[follows.joint]
        if follows.joint not in still and (leader is joint or leader.moves) and follows.multiplier != 0.0:
            groups.setdefault(follows.joint, []).append((joint, follows))
    moving = {joint.name for group in groups.values() for joint, _ in group}
    found = CoupledJoints([joint for joint in chain if joint.name in moving], [], {}, [])
    for name, group in groups.items():
        first, own = group[0]
        members = group
        if len(group) == 1 and name == first.name:
            continue
        if name not in moving:  # an actuator off the chain, whose limits apply as well
            members = [*group, (named[name], Follows(name, 1.0, 0.0))]
        lower = -math.inf
        upper = math.inf
        velocity = math.inf
        for joint, follows in members:
            ratio = follows.multiplier / own.multiplier
            offset = follows.offset - ratio * own.offset
            if joint is not first and joint.name in moving:
                found.couplings.append(Coupling(joint.name, first.name, ratio, offset))
            if joint is not first and joint.name == name:
                turns = joint.type != "prismatic"
                found.drives.append(Drive(name, first.name, ratio, offset, turns))
            low, high = sorted(((joint.lower - offset) / ratio, (joint.upper - offset) / ratio))
            lower = max(lower, low)
            upper = min(upper, high)
            if joint.velocity is not None and 0.0 < joint.velocity < NO_LIMIT:
                velocity = min(velocity, joint.velocity / abs(ratio))
        if lower >= upper:
            joints = ", ".join(repr(joint.name) for joint, _ in members[:8])
            reason = "their limits leave no room for a common motion"
            raise URDFError(description.source, f"coupled joints {joints}", reason)
        found.ranges[first.name] = JointRange(lower, upper, velocity)
    return found


def _follow(
    description: Description,
    named: Mapping[str, JointDescription],
    joint: JointDescription,
    still: set[str],
) -> Follows:
    """Return the ultimate leader of a joint, with ratio and offset; itself if it follows none."""
    ratio = 1.0
    offset = 0.0
    at = joint
    seen = {joint.name}
    while at.follows is not None and at.name not in still:
        following = at.follows
        fault = None
        if following.joint not in named:
            fault = "which does not exist"
        elif named[following.joint].type not in CHAIN_JOINTS:
            fault = f"which is {named[following.joint].type}; allowed: {', '.join(CHAIN_JOINTS)}"
        elif following.joint in seen:
            fault = "in a cycle"
        if fault:
            reason = f"mimics joint {following.joint!r}, {fault}"
            raise URDFError(description.source, f"joint {at.name!r}", reason)
        ratio, offset = ratio * following.multiplier, ratio * following.offset + offset
        at = named[following.joint]
        seen.add(at.name)
    return Follows(at.name, ratio, offset)


def couple_joints(model: pin.Model, coupled: CoupledJoints) -> pin.Model:
    """Return a model with coupled joints, in which the limits of the leaders respect those of all followers.

    It is rebuilt as a whole, because `pin.transformJointIntoMimic` copies it for each joint.
    """
    if coupled.couplings:
        following = {each.joint: (each.leader, each.ratio, each.offset) for each in coupled.couplings}
        model = rebuild_model(describe_model(model, following))
    for name, allowed in coupled.ranges.items():
        leader = model.joints[model.getJointId(name)]
        if leader.nq == 1:
            model.lowerPositionLimit[leader.idx_q] = allowed.lower
            model.upperPositionLimit[leader.idx_q] = allowed.upper
        velocity = allowed.velocity if allowed.velocity < NO_LIMIT else 0.0
        model.velocityLimit[leader.idx_v] = velocity
    return model


def limit_leaders(model: pin.Model, described: pin.Model, drives: Iterable[Drive]) -> None:
    """Set the torque limits of leaders that a drive stands behind, by virtual work; writes to the model.

    Args:
        model: the model of the arm.
        described: the model of all joints of the description.
        drives: the drives.
    """
    for drive in drives:
        leader = model.joints[model.getJointId(drive.leader)].idx_v
        limit = described.upperEffortLimit[described.joints[described.getJointId(drive.joint)].idx_v]
        at_leader = limit * abs(drive.ratio) if limit < NO_LIMIT else NO_LIMIT
        model.upperEffortLimit[leader] = at_leader
        model.lowerEffortLimit[leader] = -at_leader


def is_coupled(joint: pin.JointModel) -> bool:
    """Check whether a joint of a model follows another and has no degree of freedom of its own."""
    return bool(joint.shortname() == "JointModelMimic")


def joint_ratios(model: pin.Model, joints: Iterable[int]) -> Array:
    """Return the motion of each joint relative to that of its degree of freedom, (n,); 1 unless coupled."""
    coupled = set(model.mimicking_joints)
    return np.array([model.joints[each].extract().scaling if each in coupled else 1.0 for each in joints])


def joint_axes(model: pin.Model, joints: list[int]) -> tuple[Array, NDArray[np.bool_]]:
    """Return the unit axes of joints, (n, 3), in their own frames, and whether they are revolute, (n,)."""
    screws = np.array([np.ravel(model.joints[joint].createData().S) for joint in joints])
    screws = screws / joint_ratios(model, joints)[:, None]
    revolute = np.asarray(np.linalg.norm(screws[:, 3:], axis=1) > 0.5)
    return np.ascontiguousarray(np.where(revolute[:, None], screws[:, 3:], screws[:, :3])), revolute


def joint_placements(model: pin.Model) -> list[pin.SE3]:
    """Return the placement of each joint in the frame of its parent joint, with all leaders at zero.

    Coupled joints are then at their offsets, which `pin.Model.jointPlacements` does not include.
    """
    placements = list(model.jointPlacements)
    for number in model.mimicking_joints:
        if offset := model.joints[number].extract().offset:
            (axis,), (turns,) = joint_axes(model, [number])
            motion = pin.SE3.Identity()
            if turns:
                motion.rotation = pin.exp3(offset * axis)
            else:
                motion.translation = offset * axis
            placements[number] = placements[number] * motion
    return placements


def read_couplings(model: pin.Model) -> tuple[Coupling, ...]:
    """Return the couplings of a model, in the order of its joints."""
    names = list(model.names)
    joints = list(model.joints)
    leaders = {joint.idx_v: name for name, joint in zip(names[1:], joints[1:], strict=True) if joint.nv}
    couplings = []
    for number in sorted(model.mimicking_joints):
        own = joints[number].extract()
        leader = str(leaders[joints[number].idx_v])
        couplings.append(Coupling(str(names[number]), leader, float(own.scaling), float(own.offset)))
    return tuple(couplings)
