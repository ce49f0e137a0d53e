"""Robot descriptions: the tree of links and joints in a URDF, and the chain in it that is the arm.

The <safety_controller> of a joint gives soft limits: it stops the joint there, inside those of its <limit>.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree.ElementTree import Element

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pinposture._validation import require_known
from pinposture.arm.urdf import (
    CHAIN_JOINTS,
    ONCE,
    URDF_TEXT,
    JointDescription,
    SoftLimits,
    is_urdf_text,
    load_text,
    parse_xml,
    quote_joints,
    quote_names,
    read_joint,
    text_for_pinocchio,
)
from pinposture.errors import URDFError

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Description:
    """A valid robot description: a tree of links."""

    name: str  # name of the robot
    text: str = field(repr=False)  # the URDF, in a form that Pinocchio can read
    source: str  # the file it came from, or what error messages call the text
    links: tuple[str, ...]  # names of the links, in the order of the text
    joints: tuple[JointDescription, ...]  # the joints, in the order of the text
    root: str  # the one link that is not the child of any joint
    doubled: tuple[str, ...] = ()  # warnings on elements that are there more than once, and differ

    @cached_property
    def joint_before(self) -> dict[str, JointDescription]:
        """The parent joint of each link except the root."""
        return {joint.child: joint for joint in self.joints}

    @cached_property
    def joints_after(self) -> dict[str, list[JointDescription]]:
        """The child joints of each link that has any."""
        after = defaultdict[str, list[JointDescription]](list)
        for joint in self.joints:
            after[joint.parent].append(joint)
        return dict(after)

    @cached_property
    def depths(self) -> dict[str, int]:
        """Number of joints between the root and each link."""
        depths = {self.root: 0}
        for start in self.links:
            path = []
            link = start
            while link not in depths:
                path.append(link)
                link = self.joint_before[link].parent
            for number, link_on_path in enumerate(reversed(path), depths[link] + 1):
                depths[link_on_path] = number
        return depths

    def chain(self, base: str, tip: str) -> tuple[JointDescription, ...]:
        """Return the joints from one link to another.

        Args:
            base: first link of the chain.
            tip: last link of the chain.

        Returns:
            All joints between them, fixed ones too, from base to tip; empty if both are the same link.

        Raises:
            UnknownName: there is no such link.
            URDFError: the tip is not below the base.
        """
        for link in (base, tip):
            require_known("link", link, self.links)
        path: list[JointDescription] = []
        link = tip
        while link != base:
            if link == self.root:
                above = quote_names([joint.parent for joint in path]) or "none, it is the root"
                reason = f"is not below link {base!r}; above it: {above}"
                raise URDFError(self.source, f"link {tip!r}", reason)
            path.append(self.joint_before[link])
            link = path[-1].parent
        return tuple(reversed(path))

    def longest_chain(self) -> tuple[str, str]:
        """Find the chain from the root with the most moving joints.

        Only joints that move independently count. Grippers do not: joints coupled by <mimic> across several
        branches open and close a tool and do not extend the arm, so the arm ends before them. Of the end
        links moved by the last counted joint, the farthest from that joint is chosen; if several are equally
        far, the deepest, and of those the first in the text. This excludes sensor frames beside the arm,
        however many fixed joints lead to them.

        Returns:
            The first and the last link of the chain.

        Raises:
            URDFError: several chains have equally many moving joints; names their ends.
        """
        excluded = _gripper_joints(self)
        links = _place_links(self, excluded)
        inner = {joint.parent for joint in self.joints if joint.name not in excluded}
        most = max(link.joints for link in links)
        ends: dict[str | None, list[_PlacedLink]] = {}
        for link in links:
            if link.joints == most and link.name not in inner:
                ends.setdefault(link.joint, []).append(link)
        order = {link: number for number, link in enumerate(self.links)}
        tips = [_farthest(group, order) for group in ends.values()]
        if len(tips) > 1:
            named = quote_names(sorted(tips, key=order.__getitem__))
            reason = f"are the ends of chains with equally many moving joints ({most}); pass tip= to choose"
            wrist = self.wrist(self.root, tips[0], fingers=2)
            if wrist is not None and all(wrist == self.wrist(self.root, tip, fingers=2) for tip in tips):
                reason += f", or tip={wrist!r}, which carries them all"
            raise URDFError(self.source, f"links {named}", reason)
        return self.root, tips[0]

    def wrist(self, base: str, tip: str, fingers: int = 3) -> str | None:
        """Find the link of a chain that carries a hand, if there is one.

        A hand has at least `fingers` moving branches, including the chain's own. The chain has at least as
        many moving joints before the hand as within it.
        """
        named = {joint.name: joint for joint in self.joints}
        path = self.chain(base, tip)
        before = 0
        all_moving = sum(joint.moves for joint in path)

        def moves(branch: JointDescription) -> bool:
            return branch.moves or any(named[name].moves for name in _joints_below(self, branch.child))

        for joint in path:
            branches = self.joints_after[joint.parent]
            if len(branches) >= fingers and 2 * before >= all_moving > before:
                others = sum(branch is not joint and moves(branch) for branch in branches)
                if others >= fingers - 1:
                    return joint.parent
            before += joint.moves
        return None


def read_description(source: str | Path, name: str = URDF_TEXT) -> Description:
    """Read a URDF and check everything that its kinematics depend on.

    Meshes, inertias, transmissions, simulator extensions and unknown elements are ignored. A <limit> without
    lower and upper means no limits; if only one of the two is missing it is 0, as in URDF.

    Args:
        source: path of a file, or the URDF text itself if it begins with "<".
        name: what error messages call text.

    Returns:
        The description.

    Raises:
        FileError: the file is missing, not readable, not text in its encoding, or empty.
        URDFError: unusable description; names the link or joint and the reason.
    """
    text, label = load_text(source)
    label = name if is_urdf_text(source) else label
    robot = parse_xml(text, label)
    if robot.tag != "robot":
        raise URDFError(label, f"<{robot.tag}>", "is the root element; allowed: <robot>")
    name = robot.get("name", "")
    version = robot.get("version", "1.0").strip()
    if not name.strip():
        raise URDFError(label, "<robot>", "has no name")
    if version not in ("1.0", "1.1", "1.2"):
        raise URDFError(label, "<robot>", f"version is {version!r}; allowed: 1.0, 1.1, 1.2")
    links = _read_names(robot.findall("link"), "link", label)
    if not links:
        macros = any(element.tag.startswith("xacro:") for element in robot)
        hint = "; expand its xacro macros first" if macros else ""
        raise URDFError(label, "<robot>", f"has no links{hint}")
    _refuse_doubles([material.get("name", "") for material in robot.findall("material")], "material", label)
    _read_names(robot.findall("joint"), "joint", label)
    joints = tuple(read_joint(element, label) for element in robot.findall("joint"))
    root = _find_root(links, joints, label)
    return Description(name, text_for_pinocchio(text), label, links, joints, root, _doubled_elements(robot))


def _read_names(elements: Iterable[Element], kind: str, source: str) -> tuple[str, ...]:
    names = tuple(element.get("name", "") for element in elements)
    for number, name in enumerate(names, start=1):
        if not name.strip():
            raise URDFError(source, f"{kind} {number} of {len(names)}", "has no name")
    _refuse_doubles(names, kind, source)
    return names


def _refuse_doubles(names: Sequence[str], kind: str, source: str) -> None:
    for name, count in Counter(names).items():
        if count > 1:
            raise URDFError(source, f"{kind} {name!r}", f"is defined {count} times")


def _doubled_elements(robot: Element) -> tuple[str, ...]:
    """Return a warning for each kind of element of which a link or joint has several that differ."""
    doubled = []
    for owner in [*robot.findall("joint"), *robot.findall("link")]:
        for element in owner.iter():
            groups = {f"<{tag}>": element.findall(tag) for tag in ONCE.get(element.tag, ())}
            if element.tag == "geometry":
                groups = {"shapes": list(element)}
            for what, shapes in groups.items():
                if any(_content(shape) != _content(shapes[0]) for shape in shapes[1:]):
                    inside = "" if element is owner else f" in <{element.tag}>"
                    counted = f"has {len(shapes)} different {what}{inside}: the first counts, as in ROS"
                    doubled.append(f"{owner.tag} {owner.get('name')!r} {counted}")
    return tuple(doubled)


def _content(element: Element) -> tuple[str, dict[str, str], list[Any]]:
    return element.tag, element.attrib, [_content(child) for child in element]


def _find_root(links: Sequence[str], joints: Sequence[JointDescription], source: str) -> str:
    """Return the root of the tree of links, or raise if they form no tree."""
    known = set(links)
    before = dict[str, JointDescription]()
    for joint in joints:
        for role, link in (("parent", joint.parent), ("child", joint.child)):
            if link not in known:
                raise URDFError(source, f"joint {joint.name!r}", f"its {role} link {link!r} does not exist")
        other = before.setdefault(joint.child, joint)
        if other is not joint:
            reason = f"is the child of joint {other.name!r} and of joint {joint.name!r}; allowed: one parent"
            raise URDFError(source, f"link {joint.child!r}", reason)
    roots = [link for link in links if link not in before]
    if len(roots) > 1:
        reason = "are not the child of any joint; allowed: one such link, the root"
        raise URDFError(source, f"links {quote_names(roots)}", reason)
    # No link has two parents, so a link that does not lead up to the root is below or on a cycle.
    reached = set(roots)
    for start in links:
        link = start
        path = dict[str, None]()
        while link not in reached:
            if link in path:
                circle = [*list(path)[list(path).index(link) :], link]
                reason = f"closes a cycle, child to parent: {quote_names(circle)}"
                raise URDFError(source, f"joint {before[link].name!r}", reason)
            path[link] = None
            link = before[link].parent
        reached.update(path)
    return roots[0]


class _PlacedLink(NamedTuple):
    """A link and the last moving joint before it, the number of moving joints up to it, and its placement.

    Position (3,) [m] and rotation (3, 3) are in the frame of that joint; the depth counts all joints.
    """

    name: str
    joint: str | None
    joints: int
    position: Array
    rotation: Array
    depth: int

    @property
    def distance(self) -> float:
        """Distance from the last moving joint, or from the root [m]."""
        return float(np.linalg.norm(self.position))


def _place_links(description: Description, excluded: frozenset[str]) -> list[_PlacedLink]:
    origin = np.zeros(3)
    identity = np.eye(3)
    links = [_PlacedLink(description.root, None, 0, origin, identity, 0)]
    for link in links:  # grows while iterating: every link after its parent
        for joint in description.joints_after.get(link.name, []):
            if joint.name in excluded:
                continue
            depth = link.depth + 1
            if joint.moves and joint.follows is None and joint.type in CHAIN_JOINTS:
                links.append(_PlacedLink(joint.child, joint.name, link.joints + 1, origin, identity, depth))
            else:
                position = link.position + link.rotation @ joint.origin
                rotation = link.rotation @ pin.rpy.rpyToMatrix(*joint.rpy)
                links.append(_PlacedLink(joint.child, link.joint, link.joints, position, rotation, depth))
    return links


def _farthest(group: list[_PlacedLink], order: Mapping[str, int]) -> str:
    enough = max(link.distance for link in group) * (1.0 - 1e-6)
    far = [link for link in group if link.distance >= enough]
    return max(far, key=lambda link: (link.depth, -order[link.name])).name


def _gripper_joints(description: Description) -> frozenset[str]:
    """Find joints coupled by <mimic> across branches, with no independently moving joint after them."""
    named = {joint.name: joint for joint in description.joints if joint.moves}
    groups = defaultdict[str, set[str]](set)
    for joint in named.values():
        if joint.follows is not None and joint.follows.joint in named:
            leader = leading_joint(joint, named)
            groups[leader.name] |= {leader.name, joint.name}
    grippers: set[str] = set()
    for group in groups.values():
        if _one_behind_the_other(description, group):
            continue
        after = set().union(*(_joints_below(description, named[name].child) for name in group)) - group
        if all(name not in named or named[name].follows is not None for name in after):
            grippers |= group
    moving = {name for name, joint in named.items() if joint.follows is None}
    return frozenset() if moving <= grippers else frozenset(grippers)


def _one_behind_the_other(description: Description, group: set[str]) -> bool:
    """Return whether joints lie on one chain: going up from the deepest of them meets all others."""
    depth = description.depths
    last = max((joint for joint in description.joints if joint.name in group), key=lambda j: depth[j.child])
    link = last.child
    met = 0
    while link != description.root and met < len(group):
        joint = description.joint_before[link]
        met += joint.name in group
        link = joint.parent
    return met == len(group)


def leading_joint(joint: JointDescription, named: Mapping[str, JointDescription]) -> JointDescription:
    """Follow a series of <mimic> to its last joint, even if it is circular or ends in a missing joint."""
    seen = {joint.name}
    while joint.follows is not None and joint.follows.joint in named and joint.follows.joint not in seen:
        joint = named[joint.follows.joint]
        seen.add(joint.name)
    return joint


def _joints_below(description: Description, link: str) -> set[str]:
    links = [link]
    names = set[str]()
    for at in links:
        for joint in description.joints_after.get(at, []):
            names.add(joint.name)
            links.append(joint.child)
    return names


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
