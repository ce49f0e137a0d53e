"""Which link of a robot description an arm ends at, when nobody says."""

from __future__ import annotations

from collections import defaultdict
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pinposture.arm.urdf_joint import CHAIN_JOINTS, JointDescription
from pinposture.errors import URDFError

if TYPE_CHECKING:
    from pinposture.arm.description import Description


Array = NDArray[np.float64]


class _Place(NamedTuple):
    """A link, as seen from the base: behind which joint, how many moving joints, where, how deep.

    Its place (3,) [m] and the axes of its frame (3, 3) are those in the frame of the last moving joint.
    """

    link: str
    joint: str | None
    joints: int
    place: Array
    turn: Array
    depth: int

    @property
    def distance(self) -> float:
        """Distance from the last moving joint, or from the base [m]."""
        return float(np.linalg.norm(self.place))


def default_tip(description: Description, base: str) -> str:
    """The end of the longest moving chain below a link.

    A joint counts if it moves by itself. A gripper does not count: joints that <mimic> couples across several
    branches open and close a tool, they do not carry the arm any farther, so the arm ends before them. Of the
    ends that the last counted joint moves, the one farthest from that joint is taken; of those equally far
    the deepest, and of those the first in the text. Frames of sensors beside the arm thus stay out of it,
    however many fixed joints lead to them.

    Args:
        description: the description.
        base: link at which the arm begins.

    Returns:
        Name of the link.

    Raises:
        URDFError: several chains have equally many moving joints; names their ends.
    """
    below = defaultdict[str, list[JointDescription]](list)
    for joint in description.joints:
        below[joint.parent].append(joint)
    left_out = _gripper_joints(description, below, base)
    places = _places(below, base, left_out)
    inner = {joint.parent for joint in description.joints if joint.name not in left_out}
    most = max(place.joints for place in places)
    ends: dict[str | None, list[_Place]] = {}
    for place in places:
        if place.joints == most and place.link not in inner:
            ends.setdefault(place.joint, []).append(place)
    order = {link: number for number, link in enumerate(description.links)}
    tips = [_farthest(group, order) for group in ends.values()]
    if len(tips) > 1:
        named = ", ".join(map(repr, sorted(tips, key=order.__getitem__)))
        reason = f"are reached by different joints, {most} moving ones each; pass tip= to choose"
        raise URDFError(description.source, f"links {named}", reason)
    return tips[0]


def _places(below: dict[str, list[JointDescription]], base: str, left_out: frozenset[str]) -> list[_Place]:
    here, straight = np.zeros(3), np.eye(3)
    places = [_Place(base, None, 0, here, straight, 0)]
    for place in places:  # grows as we go: every link after the one before it
        for joint in below.get(place.link, []):
            if joint.name in left_out:
                continue
            depth = place.depth + 1
            if joint.moves and not joint.mimic and joint.type in CHAIN_JOINTS:
                places.append(_Place(joint.child, joint.name, place.joints + 1, here, straight, depth))
            else:
                at = place.place + place.turn @ joint.origin
                turn = place.turn @ pin.rpy.rpyToMatrix(*joint.rpy)
                places.append(_Place(joint.child, place.joint, place.joints, at, turn, depth))
    return places


def _farthest(group: list[_Place], order: dict[str, int]) -> str:
    enough = max(place.distance for place in group) * (1.0 - 1e-6)
    far = [place for place in group if place.distance >= enough]
    return max(far, key=lambda place: (place.depth, -order[place.link])).link


def _gripper_joints(
    description: Description, below: dict[str, list[JointDescription]], base: str
) -> frozenset[str]:
    """Joints coupled by <mimic> across branches, with nothing behind them that moves by itself."""
    named = {joint.name: joint for joint in description.joints if joint.moves}
    groups = defaultdict[str, list[JointDescription]](list)
    for joint in named.values():
        if joint.follows is not None and joint.follows.joint in named:
            leader = leading_joint(joint, named)
            groups[leader.name].append(joint)
    found: set[str] = set()
    for leader_name, followers in groups.items():
        group = {leader_name, *(joint.name for joint in followers)}
        behind = {name: _joints_below(below, named[name].child) for name in group}
        apart = any(a not in behind[b] and b not in behind[a] for a in group for b in group if a != b)
        free = any(
            named[name].follows is None and name not in group
            for names in behind.values()
            for name in names
            if name in named
        )
        if apart and not free:
            found |= group
    path = {joint.name for joint in description.chain(description.root, base)}
    moving = {name for name, joint in named.items() if not joint.mimic}
    return frozenset() if moving <= found | path else frozenset(found)


def leading_joint(joint: JointDescription, named: dict[str, JointDescription]) -> JointDescription:
    """The joint at the end of a line of <mimic>; where the line goes round or breaks off, its last joint."""
    seen = {joint.name}
    while joint.follows is not None and joint.follows.joint in named and joint.follows.joint not in seen:
        joint = named[joint.follows.joint]
        seen.add(joint.name)
    return joint


def _joints_below(below: dict[str, list[JointDescription]], link: str) -> set[str]:
    links, names = [link], set[str]()
    for at in links:
        for joint in below.get(at, []):
            names.add(joint.name)
            links.append(joint.child)
    return names
