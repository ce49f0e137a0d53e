"""Reading of a robot description (URDF), with checks of everything that its kinematics depend on.

Pinocchio only reports *that* a description is invalid, and accepts some that make no sense: an axis of zero
length, limits that exclude every position, links that form a cycle.
"""

from __future__ import annotations

import math
import os
import re
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree.ElementTree import Element, TreeBuilder
from xml.parsers import expat

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pinposture._validation import require_known
from pinposture.errors import FileError, InvalidValue, URDFError
from pinposture.storage import read_xml, without_encoding

Array = NDArray[np.float64]
Vector = tuple[float, float, float]
MakeError = Callable[[str], URDFError]

CHAIN_JOINTS = ("revolute", "continuous", "prismatic")
JOINT_TYPES = (*CHAIN_JOINTS, "fixed", "floating", "planar")

URDF_TEXT = "URDF text"
"""What error messages call a description that is not from a file."""

_BLANK = "\ufeff \t\r\n"
_MAX_DEPTH = 400  # Pinocchio's XML parser fails slightly below 500
_SPLIT_VECTOR = re.compile(
    r"""\b(?:xyz|rpy)\s*=\s*(?:"[^"<\t\r\n]*[\t\r\n][^"<]*"|'[^'<\t\r\n]*[\t\r\n][^'<]*')"""
)
_INFINITE_ATTRIBUTE = re.compile(r"""(\b(?:velocity|effort)\s*=\s*["'])\+?inf(?:inity)?(?=["'])""", re.I)
# What Pinocchio accepts as a number; Python would also accept "1_0" and "inf".
_NUMBER = re.compile(r"[ \t\r\n]*[+-]?([0-9]+(\.[0-9]*)?|\.[0-9]+)([eE][+-]?[0-9]+)?")
_INFINITE = re.compile(r"\+?inf(inity)?", re.IGNORECASE)
# The numeric elements of a joint: required and optional attributes.
_PARTS: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "limit": (("effort", "velocity"), ("lower", "upper")),
    "safety_controller": (("k_velocity",), ("soft_lower_limit", "soft_upper_limit", "k_position")),
    "calibration": ((), ("rising", "falling")),
    "dynamics": ((), ("damping", "friction")),
    "mimic": ((), ("multiplier", "offset")),
}
# The elements of which each of these has one; urdfdom, which ROS and Pinocchio use, reads the first.
_ONCE: dict[str, tuple[str, ...]] = {
    "joint": ("parent", "child", "origin", "axis", *_PARTS),
    "link": ("inertial",),
    "inertial": ("origin", "mass", "inertia"),
    "visual": ("origin", "geometry", "material"),
    "collision": ("origin", "geometry"),
}


class Follows(NamedTuple):
    """The content of <mimic>: position = multiplier * position of another joint + offset."""

    joint: str  # name of the joint that is followed
    multiplier: float  # factor on its position; 1 if not given
    offset: float  # added to it [rad or m]; 0 if not given


class SoftLimits(NamedTuple):
    """The position limits in <safety_controller>; one that is missing is 0, as in URDF."""

    lower: float  # smallest position [rad or m]
    upper: float  # largest position [rad or m]
    one_sided: bool  # whether one of the two is missing


@dataclass(frozen=True)
class JointDescription:
    """A joint of a robot description."""

    name: str  # its name
    type: str  # one of `JOINT_TYPES`
    parent: str  # the link before it
    child: str  # the link after it
    origin: Vector  # position of the joint in the frame of its parent link, (3,) [m]
    rpy: Vector  # orientation of its frame there: roll, pitch, yaw, (3,) [rad]
    axis: Vector  # unit vector, (3,), in the frame of the joint; x by default
    lower: float  # smallest position [rad or m]; -inf without limits, 0 if fixed
    upper: float  # largest position [rad or m]; inf without limits, 0 if fixed
    velocity: float | None  # largest speed [rad/s or m/s], may be infinite; None without <limit>
    follows: Follows | None  # how it follows another joint; None if it moves independently
    excluded: str | None = None  # why it cannot be on a chain, from <excluded reason="...">; None if it can
    soft: SoftLimits | None = None  # where its controller stops it; None if not given, or both 0

    @cached_property
    def mimic(self) -> bool:
        """True if it follows another joint."""
        return self.follows is not None

    @cached_property
    def moves(self) -> bool:
        """False if it is fixed, or if its limits allow a single position."""
        return self.lower < self.upper


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
            for number, each in enumerate(reversed(path), depths[link] + 1):
                depths[each] = number
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
        places = _place_links(self, excluded)
        inner = {joint.parent for joint in self.joints if joint.name not in excluded}
        most = max(place.joints for place in places)
        ends: dict[str | None, list[_Place]] = {}
        for place in places:
            if place.joints == most and place.link not in inner:
                ends.setdefault(place.joint, []).append(place)
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
    joints = tuple(_read_joint(element, label) for element in robot.findall("joint"))
    root = _find_root(links, joints, label)
    return Description(name, text_for_pinocchio(text), label, links, joints, root, _doubled_elements(robot))


def is_urdf_text(source: object) -> bool:
    """Return whether a source is URDF text rather than the path of a file."""
    return isinstance(source, str) and source.lstrip(_BLANK).startswith("<")


def load_text(source: str | Path) -> tuple[str, str]:
    """Read a description without interpreting it.

    Args:
        source: path of a file, or the text itself if it begins with "<".

    Returns:
        The text, and its name in error messages: the path or "URDF text".

    Raises:
        InvalidValue: neither a path nor text.
        FileError: the file is missing, not readable, not text in its encoding, or empty.
        URDFError: multi-line text (so not a path) that does not begin with "<".
    """
    if not isinstance(source, (str, os.PathLike)):
        raise InvalidValue("source", source, "path of a URDF file, URDF text, or a pin.Model")
    if is_urdf_text(source):
        return without_encoding(str(source)), URDF_TEXT
    if isinstance(source, str) and "\n" in (text := source.lstrip(_BLANK)):
        raise URDFError(URDF_TEXT, "line 1", f"begins with {text[:20]!r}; allowed: '<'")
    path = Path(source)
    text = read_xml(path)
    if not text.strip(_BLANK):
        raise FileError(path, "is empty")
    return text, str(path)


def parse_xml(text: str, source: str) -> Element:
    """Parse XML, rejecting content that could fetch files or exhaust memory.

    Args:
        text: the XML; blanks may precede it.
        source: its name in error messages.

    Returns:
        The root element. Names keep their namespace prefixes, because URDF extensions use undeclared ones.

    Raises:
        URDFError: the XML is malformed (names the line), has a document type, or is nested too deep.
    """
    body = text.lstrip(_BLANK)
    if _declares_document_type(body):
        raise URDFError(source, "<!DOCTYPE>", "is not allowed, because it can define entities; remove it")
    builder = TreeBuilder()
    parser = expat.ParserCreate("utf-8")
    parser.StartElementHandler = builder.start
    parser.EndElementHandler = builder.end
    parser.CharacterDataHandler = builder.data
    try:
        parser.Parse(body, True)
    except expat.ExpatError as error:
        line = error.lineno + text[: len(text) - len(body)].count("\n")
        reason = f"is not well-formed XML: {expat.ErrorString(error.code)}"
        raise URDFError(source, f"line {line}", reason) from None
    except UnicodeEncodeError as error:
        raise URDFError(source, f"character {error.start}", "is half of a surrogate pair") from None
    root = builder.close()
    level = [root]
    for _ in range(_MAX_DEPTH):
        level = [child for element in level for child in element]
    if level:
        raise URDFError(source, f"<{level[0].tag}>", f"is nested too deep; allowed: {_MAX_DEPTH} levels")
    return root


def text_for_pinocchio(text: str) -> str:
    """Return the same XML in a form that Pinocchio can read.

    Each vector is put on one line, because Pinocchio splits vectors only at blanks; an infinite speed or
    effort becomes a huge number, because Pinocchio reads only digits.
    """
    text = _SPLIT_VECTOR.sub(lambda match: re.sub(r"[\t\r\n]", " ", match[0]), text.lstrip(_BLANK))
    return _INFINITE_ATTRIBUTE.sub(r"\g<1>1e300", text)


def _declares_document_type(text: str) -> bool:
    # Not left to the parser, which expands entities even after a handler has raised an error.
    at = text.find("<")
    while at >= 0:
        if text.startswith("<!--", at):
            at = text.find("-->", at + 4)
        elif text.startswith("<?", at):
            at = text.find("?>", at + 2)
        else:
            return text.startswith("<!DOCTYPE", at)
        at = text.find("<", at) if at >= 0 else at
    return False


def quote_names(names: Sequence[str], most: int = 8) -> str:
    """Return the first few names in quotes, with dots for the rest."""
    return ", ".join(map(repr, names[:most])) + (", ..." if len(names) > most else "")


def quote_joints(names: Sequence[str]) -> str:
    """Name joints in messages."""
    return ("joint " if len(names) == 1 else "joints ") + quote_names(names)


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
            groups = {f"<{tag}>": element.findall(tag) for tag in _ONCE.get(element.tag, ())}
            if element.tag == "geometry":
                groups = {"shapes": list(element)}
            for what, found in groups.items():
                if any(_content(each) != _content(found[0]) for each in found[1:]):
                    inside = "" if element is owner else f" in <{element.tag}>"
                    counted = f"has {len(found)} different {what}{inside}: the first counts, as in ROS"
                    doubled.append(f"{owner.tag} {owner.get('name')!r} {counted}")
    return tuple(doubled)


def _content(element: Element) -> tuple[str, dict[str, str], list[Any]]:
    return element.tag, element.attrib, [_content(each) for each in element]


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


def _read_joint(element: Element, source: str) -> JointDescription:
    """Read and check a <joint> that has a name."""
    name = element.get("name", "")
    kind = element.get("type")
    fault = partial(URDFError, source, f"joint {name!r}")
    if kind not in JOINT_TYPES:
        found = "not given" if kind is None else repr(kind)
        raise fault(f"type is {found}; allowed: {', '.join(JOINT_TYPES)}")
    if name == "universe" and kind != "fixed":
        raise fault("has the name that Pinocchio uses for the world; rename it")
    parent = _read_link(element, "parent", fault)
    child = _read_link(element, "child", fault)
    if parent == child:
        raise fault(f"has link {parent!r} as both parent and child")
    turned = element.find("origin[@quat_xyzw]")
    if turned is not None:
        raise fault(
            f"<origin> quat_xyzw is {turned.get('quat_xyzw')!r}; allowed: rpy=, roll, pitch, yaw [rad]"
        )
    origin = _read_vector(element, "origin", "xyz", (0.0, 0.0, 0.0), fault)
    rpy = _read_vector(element, "origin", "rpy", (0.0, 0.0, 0.0), fault)
    axis: Vector = (1.0, 0.0, 0.0)
    if kind not in ("fixed", "floating"):
        axis = _unit(_read_vector(element, "axis", "xyz", axis, fault), fault)
    parts = {tag: element.find(tag) for tag in _PARTS}
    numbers = {tag: None if part is None else _read_part(part, fault) for tag, part in parts.items()}
    lower, upper = _read_limits(kind, numbers["limit"], fault)
    velocity = (numbers["limit"] or {}).get("velocity")
    follows = None
    mimic = parts["mimic"]
    if mimic is not None:
        given = {"multiplier": 1.0, "offset": 0.0, **(numbers["mimic"] or {})}
        follows = Follows(mimic.attrib["joint"], **given)
    excluded = element.find("excluded")
    soft = numbers["safety_controller"]
    return JointDescription(
        name=name,
        type=kind,
        parent=parent,
        child=child,
        origin=origin,
        rpy=rpy,
        axis=axis,
        lower=lower,
        upper=upper,
        velocity=velocity,
        follows=follows,
        excluded=None if excluded is None else excluded.get("reason", ""),
        soft=None if soft is None else _read_soft_limits(soft),
    )


def _read_link(element: Element, role: str, fault: MakeError) -> str:
    end = element.find(role)
    link = "" if end is None else end.get("link", "")
    if not link:
        raise fault(f'names no {role} link; allowed: <{role} link="..."/>')
    return link


def finite_numbers(words: Sequence[str]) -> list[float] | None:
    """Return the numbers that Pinocchio reads from words; None unless each is finite."""
    numbers = list(map(float, words)) if all(map(_NUMBER.fullmatch, words)) else [math.nan]
    return numbers if all(map(math.isfinite, numbers)) else None


def _no_number(words: Sequence[str], names: Sequence[str], fault: MakeError) -> URDFError:
    """Return the error about the first of some words that is no finite number."""
    at = next(k for k, word in enumerate(words) if finite_numbers([word]) is None)
    return fault(f"{names[at]} is {words[at][:40]!r}; allowed: a finite number, no blank after it")


def _read_vector(element: Element, tag: str, attribute: str, default: Vector, fault: MakeError) -> Vector:
    part = element.find(tag)
    text = None if part is None else part.get(attribute)
    if text is None:
        return default
    what = f"<{tag}> {attribute}"
    words = list(filter(None, text.split(" ")))
    numbers = finite_numbers(words)
    if numbers is None:
        raise _no_number(words, [what] * len(words), fault)
    if len(numbers) != 3:
        raise fault(f"{what} is {text[:40]!r}; allowed: three numbers with blanks between them")
    if max(map(abs, numbers)) > 1e100:
        raise fault(f"{what} is {text[:40]!r}; allowed: numbers that can be squared")
    x, y, z = numbers
    return x, y, z


def _unit(vector: Vector, fault: MakeError) -> Vector:
    norm = math.hypot(*vector)
    if norm < 1e-100:
        raise fault(f"<axis> xyz is {vector}; allowed: a vector that is not zero")
    x, y, z = vector
    return x / norm, y / norm, z / norm


def _read_part(part: Element, fault: MakeError) -> dict[str, float]:
    """Return the numbers of an element of a joint by attribute."""
    tag = part.tag
    required, optional = _PARTS[tag]
    for attribute in required:
        if attribute not in part.attrib:
            raise fault(f"<{tag}> has no {attribute}; it must have {' and '.join(required)}")
    if tag == "mimic" and "joint" not in part.attrib:
        raise fault("<mimic> names no joint")
    given = [attribute for attribute in required + optional if attribute in part.attrib]
    if tag == "dynamics" and not given:
        raise fault("<dynamics> has neither damping nor friction")
    unlimited = [
        name for name in given if name in ("effort", "velocity") and _INFINITE.fullmatch(part.attrib[name])
    ]
    finite = [name for name in given if name not in unlimited]
    words = [part.attrib[name] for name in finite]
    numbers = finite_numbers(words)
    if numbers is None:
        raise _no_number(words, [f"<{tag}> {name}" for name in finite], fault)
    return dict.fromkeys(unlimited, math.inf) | dict(zip(finite, numbers, strict=True))


def _read_limits(kind: str, limit: dict[str, float] | None, fault: MakeError) -> tuple[float, float]:
    if kind == "fixed":
        return 0.0, 0.0
    for attribute in ("effort", "velocity"):
        if limit and limit[attribute] < 0.0:
            raise fault(f"<limit> {attribute} is {limit[attribute]}; allowed: 0 or more")
    if kind not in ("revolute", "prismatic"):
        return -math.inf, math.inf
    if limit is None:
        free = "; use type continuous for unlimited rotation" if kind == "revolute" else ""
        raise fault(f"is {kind} and has no <limit>{free}")
    if "lower" not in limit and "upper" not in limit:
        return -math.inf, math.inf
    lower = limit.get("lower", 0.0)
    upper = limit.get("upper", 0.0)
    if lower > upper:
        raise fault(f"<limit> lower is {lower} and upper {upper}; allowed: lower <= upper (0 if not given)")
    return lower, upper


def _read_soft_limits(safety: dict[str, float]) -> SoftLimits | None:
    """Return soft limits; none if both are 0, which is their value in URDF if they are not given."""
    lower, upper = (safety.get(f"soft_{end}_limit") for end in ("lower", "upper"))
    if not lower and not upper:
        return None
    return SoftLimits(lower or 0.0, upper or 0.0, lower is None or upper is None)


class _Place(NamedTuple):
    """A link and the last moving joint before it, the number of moving joints up to it, and its placement.

    Position (3,) [m] and rotation (3, 3) are in the frame of that joint; the depth counts all joints.
    """

    link: str
    joint: str | None
    joints: int
    position: Array
    rotation: Array
    depth: int

    @property
    def distance(self) -> float:
        """Distance from the last moving joint, or from the root [m]."""
        return float(np.linalg.norm(self.position))


def _place_links(description: Description, excluded: frozenset[str]) -> list[_Place]:
    origin = np.zeros(3)
    identity = np.eye(3)
    places = [_Place(description.root, None, 0, origin, identity, 0)]
    for place in places:  # grows while iterating: every link after its parent
        for joint in description.joints_after.get(place.link, []):
            if joint.name in excluded:
                continue
            depth = place.depth + 1
            if joint.moves and not joint.mimic and joint.type in CHAIN_JOINTS:
                places.append(_Place(joint.child, joint.name, place.joints + 1, origin, identity, depth))
            else:
                position = place.position + place.rotation @ joint.origin
                rotation = place.rotation @ pin.rpy.rpyToMatrix(*joint.rpy)
                places.append(_Place(joint.child, place.joint, place.joints, position, rotation, depth))
    return places


def _farthest(group: list[_Place], order: Mapping[str, int]) -> str:
    enough = max(place.distance for place in group) * (1.0 - 1e-6)
    far = [place for place in group if place.distance >= enough]
    return max(far, key=lambda place: (place.depth, -order[place.link])).link


def _gripper_joints(description: Description) -> frozenset[str]:
    """Find joints coupled by <mimic> across branches, with no independently moving joint after them."""
    named = {joint.name: joint for joint in description.joints if joint.moves}
    groups = defaultdict[str, set[str]](set)
    for joint in named.values():
        if joint.follows is not None and joint.follows.joint in named:
            leader = leading_joint(joint, named)
            groups[leader.name] |= {leader.name, joint.name}
    found: set[str] = set()
    for group in groups.values():
        if _one_behind_the_other(description, group):
            continue
        after = set().union(*(_joints_below(description, named[name].child) for name in group)) - group
        if all(name not in named or named[name].mimic for name in after):
            found |= group
    moving = {name for name, joint in named.items() if not joint.mimic}
    return frozenset() if moving <= found else frozenset(found)


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
