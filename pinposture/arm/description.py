"""Reading a robot description and saying what is wrong with it.

Pinocchio tells only *that* a description is not valid, and takes some that nobody can mean: an axis of no
length, limits that shut out every position, links that hang on each other in a circle.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from xml.etree.ElementTree import Element

from pinposture.arm.default_tip import default_tip
from pinposture.arm.urdf_joint import JointDescription, read_joint
from pinposture.arm.urdf_source import load_text, parse_xml, text_for_pinocchio
from pinposture.errors import UnknownName, URDFError

__all__ = ["Description", "JointDescription", "read_description"]


@dataclass(frozen=True)
class Description:
    """A robot description without faults: a tree of links.

    Attributes:
        name: name of the robot.
        text: the URDF, fit for Pinocchio: vectors broken over several lines are joined.
        source: the file it came from, or "URDF text".
        links: names of the links, in the order of the text.
        joints: the joints, in the order of the text.
        root: the one link that no joint leads to.
    """

    name: str
    text: str = field(repr=False)
    source: str
    links: tuple[str, ...]
    joints: tuple[JointDescription, ...]
    root: str

    @cached_property
    def _joint_before(self) -> dict[str, JointDescription]:
        return {joint.child: joint for joint in self.joints}

    def chain(self, base: str, tip: str) -> tuple[JointDescription, ...]:
        """The joints from one link to another.

        Args:
            base: link at which the chain starts.
            tip: link at which it ends.

        Returns:
            Every joint between them, fixed ones too, from base to tip; none if both are the same link.

        Raises:
            UnknownName: there is no such link.
            URDFError: the tip is not below the base.
        """
        for link in (base, tip):
            if not isinstance(link, str) or (link != self.root and link not in self._joint_before):
                raise UnknownName("link", link, self.links)
        path: list[JointDescription] = []
        link = tip
        while link != base:
            if link == self.root:
                above = _listed([joint.parent for joint in path]) or "none, it is the root"
                raise URDFError(
                    self.source, f"link {tip!r}", f"is not below link {base!r}; above it: {above}"
                )
            path.append(self._joint_before[link])
            link = path[-1].parent
        return tuple(reversed(path))

    def longest_chain(self, base: str | None = None) -> tuple[str, str]:
        """Where the chain with most moving joints begins and ends; see `default_tip`.

        Args:
            base: link at which it begins; the root if None.

        Returns:
            That link and the one at the end.

        Raises:
            UnknownName: there is no such link.
            URDFError: several chains with different joints have equally many; names their ends.
        """
        base = self.root if base is None else base
        self.chain(base, base)
        return base, default_tip(self, base)


def read_description(source: str | Path) -> Description:
    """Read a URDF and check everything that its kinematics depend on.

    Meshes, inertias, transmissions, simulator extensions and elements that URDF does not know are left alone.
    A <limit> without lower and upper means no limits; where one of the two is missing it is 0, as in URDF.

    Args:
        source: path of a file, or the URDF text itself if it begins with "<".

    Returns:
        The description.

    Raises:
        FileError: the file is missing, not readable, not UTF-8 text, or empty.
        URDFError: the description cannot be used; names the link or joint and the reason.
    """
    text, label = load_text(source)
    robot = parse_xml(text, label)
    if robot.tag != "robot":
        raise URDFError(label, f"<{robot.tag}>", "is the root element; allowed: <robot>")
    name, version = robot.get("name", ""), robot.get("version", "1.0").strip()
    if not name.strip():
        raise URDFError(label, "<robot>", "has no name")
    if version not in ("1.0", "1.1", "1.2"):
        raise URDFError(label, "<robot>", f"version is {version!r}; allowed: 1.0, 1.1, 1.2")
    links = _names(robot.findall("link"), "link", label)
    if not links:
        macros = any(element.tag.startswith("xacro:") for element in robot)
        raise URDFError(
            label, "<robot>", "has no links" + ("; expand its xacro macros first" if macros else "")
        )
    _refuse_doubles([material.get("name", "") for material in robot.findall("material")], "material", label)
    _names(robot.findall("joint"), "joint", label)
    joints = tuple(read_joint(element, label) for element in robot.findall("joint"))
    root = _root(links, joints, label)
    return Description(name, text_for_pinocchio(text), label, links, joints, root)


def _names(elements: Iterable[Element], kind: str, source: str) -> tuple[str, ...]:
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


def _root(links: Sequence[str], joints: Sequence[JointDescription], source: str) -> str:
    """The root of the tree, if it is one."""
    known, before = set(links), dict[str, JointDescription]()
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
        raise URDFError(source, f"links {_listed(roots)}", reason)
    # No link has two parents, so whatever does not lead up to the root goes round in a circle.
    reached = set(roots)
    for start in links:
        link, path = start, dict[str, None]()
        while link not in reached:
            if link in path:
                circle = [*list(path)[list(path).index(link) :], link]
                reason = f"closes a circle, child to parent: {_listed(circle)}"
                raise URDFError(source, f"joint {before[link].name!r}", reason)
            path[link] = None
            link = before[link].parent
        reached.update(path)
    return roots[0]


def _listed(names: Sequence[str]) -> str:
    return ", ".join(map(repr, names[:8])) + (", ..." if len(names) > 8 else "")
