"""Coupled joints: one degree of freedom moves several joints, each by its own ratio.

Tendons and gears couple joints; URDF describes this with <mimic>: position = ratio * position of a leader +
offset. In the Pinocchio model of an arm the leader is the first of the coupled joints on the chain, whichever
joint the description names; the others are mimic joints.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from pinposture._validation import (
    LARGEST_COORDINATE,
    finite_array,
    finite_vector,
    is_number,
    make_read_only,
    require_instance,
    require_known,
)
from pinposture.arm.configurations import NO_LIMIT
from pinposture.arm.description import Description
from pinposture.arm.serialization import ModelData
from pinposture.arm.urdf import CHAIN_JOINTS, Follows, JointDescription
from pinposture.errors import InvalidValue, URDFError, enumerated

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
    """A joint that a drive moves: it moves on its own in the description.

    Attributes:
        joint: name of the joint.
        leader: the joint of the arm that moves with it: itself, or a joint that follows it in the description
            and leads in the arm, because it is the first of the coupled joints on the chain.
        ratio: motion of the joint relative to that of the leader.
        offset: position of the joint when the leader is at zero [rad or m].
        turns: whether the joint is revolute.
    """

    joint: str
    leader: str
    ratio: float
    offset: float
    turns: bool


class DrivenJoints(tuple[Drive, ...]):
    """The joints that the drives of an arm move, one for each degree of freedom, in the order of these.

    A configuration, a step `dq` and all that is computed from them speak of the degrees of freedom,
    `Arm.joint_names`. What is exchanged with a robot, by name or in the order of `names`, speaks of the
    joints that its drives move. The two differ only for coupled joints: there a driven joint is at its ratio
    times the position of the degree of freedom, plus its offset.

        positions = dict(zip(message.name, message.position))  # of a JointState
        q = arm.configuration(arm.drives.joint_positions(positions))
        arm.drives.positions(arm.positions(q))  # in the order of arm.drives.names
    """

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the joints, (nv,)."""
        return tuple(joint.joint for joint in self)

    @cached_property
    def ratios(self) -> Array:
        """Motion of each joint per motion of its degree of freedom, (nv,), read-only."""
        ratios = np.array([joint.ratio for joint in self])
        make_read_only(ratios)
        return ratios

    @cached_property
    def offsets(self) -> Array:
        """Position of each joint when its degree of freedom is at zero, (nv,) [rad or m], read-only."""
        offsets = np.array([joint.offset for joint in self])
        make_read_only(offsets)
        return offsets

    def positions(self, joint_positions: ArrayLike) -> Array:
        """Return the positions of the driven joints, (..., nv) [rad or m].

        Args:
            joint_positions: those of the degrees of freedom, (..., nv) [rad or m], as `Arm.positions` returns
                them. Full turns are kept.

        Raises:
            InvalidValue: another shape, or not finite numbers.
        """
        return np.asarray(self._rows("joint_positions", joint_positions) * self.ratios + self.offsets)

    def velocities(self, joint_velocities: ArrayLike) -> Array:
        """Return the velocities of the driven joints, (..., nv); also for displacements and accelerations.

        Args:
            joint_velocities: those of the degrees of freedom, (..., nv), such as the step of a `Tracker`.

        Raises:
            InvalidValue: another shape, or not finite numbers.
        """
        return np.asarray(self._rows("joint_velocities", joint_velocities) * self.ratios)

    def torques(self, joint_torques: ArrayLike) -> Array:
        """Return the torques or forces of the drives, (..., nv) [N m or N], by virtual work.

        Args:
            joint_torques: those along the degrees of freedom, (..., nv) [N m or N].

        Raises:
            InvalidValue: another shape, or not finite numbers.
        """
        return np.asarray(self._rows("joint_torques", joint_torques) / self.ratios)

    def joint_positions(self, positions: ArrayLike | Mapping[str, float]) -> Array:
        """Return the positions of the degrees of freedom, (..., nv) [rad or m]; the inverse of `positions`.

        Args:
            positions: those of the driven joints, (..., nv) [rad or m]; or by name, as a JointState has them.
                By name, other joints are ignored, and a joint of the arm can stand for the driven one.

        Raises:
            InvalidValue: another shape, a joint is missing, or not finite numbers.
        """
        if not isinstance(positions, Mapping):
            return np.asarray((self._rows("positions", positions) - self.offsets) / self.ratios)
        known = self.find(positions)
        missing = [drive.joint for column, drive in enumerate(self) if column not in known]
        if missing:
            lacking = enumerated(map(repr, missing))
            allowed = f"positions of all {len(self)} joints that drives move (missing: {lacking})"
            raise InvalidValue("positions", list(positions), allowed)
        return np.array([known[column] for column in range(len(self))])

    def joint_velocities(self, velocities: ArrayLike) -> Array:
        """Return the velocities along the degrees of freedom, (..., nv); the inverse of `velocities`."""
        return np.asarray(self._rows("velocities", velocities) / self.ratios)

    def joint_torques(self, torques: ArrayLike) -> Array:
        """Return the torques along the degrees of freedom, (..., nv) [N m or N]; the inverse of `torques`."""
        return np.asarray(self._rows("torques", torques) * self.ratios)

    def find(self, positions: Mapping[str, float]) -> dict[int, float]:
        """Return the positions of those degrees of freedom that are given by name.

        Args:
            positions: joint positions by name [rad or m]. Other joints are ignored. A joint of the arm can
                stand for the driven one, which counts if both are given.

        Returns:
            Position of each degree of freedom [rad or m] by its index.

        Raises:
            InvalidValue: not a finite number.
        """
        require_instance("positions", positions, Mapping, "joint positions by the names of joints")
        known: dict[int, float] = {}
        for name, (column, ratio, offset) in self._by_name.items():
            if name in positions:
                position = positions[name]
                if not (is_number(position) and abs(position) <= LARGEST_COORDINATE):
                    allowed = f"a finite number of at most {LARGEST_COORDINATE:g} in size [rad or m]"
                    raise InvalidValue(f"position of joint {name!r}", position, allowed)
                known[column] = (float(position) - offset) / ratio
        return known

    def named(self, values: ArrayLike) -> dict[str, float]:
        """Return values of the driven joints, (nv,), such as `Tracker.positions`, by the names of these.

        Raises:
            InvalidValue: another shape, or not finite numbers.
        """
        return dict(zip(self.names, finite_vector("values", values, len(self)).tolist(), strict=True))

    @cached_property
    def _by_name(self) -> dict[str, tuple[int, float, float]]:
        """Degree of freedom, ratio and offset of each joint of the arm, then of each driven one, by name.

        Joints with several degrees of freedom, off the chain of a model, are left out.
        """
        count = Counter(self.names)
        single = [(column, drive) for column, drive in enumerate(self) if count[drive.joint] == 1]
        joints = {drive.leader: (column, 1.0, 0.0) for column, drive in single}
        return joints | {drive.joint: (column, drive.ratio, drive.offset) for column, drive in single}

    def _rows(self, name: str, values: ArrayLike) -> Array:
        rows = finite_array(name, values)
        if rows.shape[-1:] != (len(self),):
            raise InvalidValue(f"{name} (shape)", rows.shape, f"(..., {len(self)}), one for each drive")
        return rows


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
        drives: joints on the chain behind a leader, or off it, that the leader follows in the description;
            none for leaders that move on their own.
    """

    moving: list[JointDescription]
    couplings: list[Coupling]
    ranges: dict[str, JointRange]
    drives: list[Drive]


def with_couplings(
    description: Description, couplings: Mapping[str, str | tuple[str, float] | tuple[str, float, float]]
) -> Description:
    """Add couplings given by the user to a description.

    Args:
        description: the description.
        couplings: for each following joint, the name of its leader; or the name and a ratio; or the name, a
            ratio, and an offset [rad or m].

    Raises:
        UnknownName: a joint does not exist.
    """
    joints = {joint.name: joint for joint in description.joints}
    for name, leader in couplings.items():
        require_known("moving joint", name, [joint for joint in joints if joints[joint].type in CHAIN_JOINTS])
        joints[name] = replace(
            joints[name], follows=Follows(leader) if isinstance(leader, str) else Follows(*leader)
        )
    return replace(description, joints=tuple(joints.values()))


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
    coupled = CoupledJoints([joint for joint in chain if joint.name in moving], [], {}, [])
    for name, group in groups.items():
        first, coupling = group[0]
        members = group
        if len(group) == 1 and name == first.name:
            continue
        if name not in moving:  # an actuator off the chain, whose limits apply as well
            members = [*group, (named[name], Follows(name, 1.0, 0.0))]
        lower = -math.inf
        upper = math.inf
        velocity = math.inf
        for joint, follows in members:
            ratio = follows.multiplier / coupling.multiplier
            offset = follows.offset - ratio * coupling.offset
            if joint is not first and joint.name in moving:
                coupled.couplings.append(Coupling(joint.name, first.name, ratio, offset))
            if joint is not first and joint.name == name:
                turns = joint.type != "prismatic"
                coupled.drives.append(Drive(name, first.name, ratio, offset, turns))
            low, high = sorted(((joint.lower - offset) / ratio, (joint.upper - offset) / ratio))
            lower = max(lower, low)
            upper = min(upper, high)
            if joint.velocity is not None and 0.0 < joint.velocity < NO_LIMIT:
                velocity = min(velocity, joint.velocity / abs(ratio))
        if lower >= upper:
            joints = ", ".join(repr(joint.name) for joint, _ in members[:8])
            reason = "their limits leave no room for a common motion"
            raise URDFError(description.source, f"coupled joints {joints}", reason)
        coupled.ranges[first.name] = JointRange(lower, upper, velocity)
    return coupled


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


def coupled_turns(coupled: CoupledJoints) -> set[str]:
    """Return the names of continuous joints that are coupled, or that a joint off the chain drives.

    They count turns, because a ratio of positions has no meaning for angles modulo a turn.
    """
    names = {coupling.joint for coupling in coupled.couplings} | {
        coupling.leader for coupling in coupled.couplings
    }
    names |= {drive.leader for drive in coupled.drives}
    return {joint.name for joint in coupled.moving if joint.type == "continuous"} & names


def couple_joints(model: pin.Model, coupled: CoupledJoints) -> pin.Model:
    """Return a model with coupled joints, in which the limits of the leaders respect those of all followers.

    It is rebuilt as a whole, because `pin.transformJointIntoMimic` copies it for each joint.
    """
    if coupled.couplings:
        following = {
            coupling.joint: (coupling.leader, coupling.ratio, coupling.offset)
            for coupling in coupled.couplings
        }
        model = ModelData.of(model, following).build()
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
    return np.array([model.joints[joint].extract().scaling if joint in coupled else 1.0 for joint in joints])


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
        mimic = joints[number].extract()
        leader = str(leaders[joints[number].idx_v])
        couplings.append(Coupling(str(names[number]), leader, float(mimic.scaling), float(mimic.offset)))
    return tuple(couplings)
