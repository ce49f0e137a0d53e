"""URDF: what a link and a joint can say, how it is read with all checks, and how it is written.

What is read and what is written are the same records, whose fields and defaults are declared once. Pinocchio
only reports *that* a description is invalid, and accepts some that make no sense: an axis of zero length, or
limits that exclude every position.
"""

from __future__ import annotations

import math
import os
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple
from xml.etree.ElementTree import Element, SubElement, TreeBuilder
from xml.parsers import expat

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from pinposture.arm.configurations import NO_LIMIT
from pinposture.arm.inertias import RigidBody
from pinposture.errors import FileError, InvalidValue, URDFError
from pinposture.storage import read_xml, without_encoding

Array = NDArray[np.float64]
Vector = tuple[float, float, float]
MakeError = Callable[[str], URDFError]

CHAIN_JOINTS = ("revolute", "continuous", "prismatic")

URDF_TEXT = "URDF text"
"""What error messages call a description that is not from a file."""

_BLANK = "\ufeff \t\r\n"
# The numeric elements of a joint: required and optional attributes.
_PARTS: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "limit": (("effort", "velocity"), ("lower", "upper")),
    "safety_controller": (("k_velocity",), ("soft_lower_limit", "soft_upper_limit", "k_position")),
    "calibration": ((), ("rising", "falling")),
    "dynamics": ((), ("damping", "friction")),
    "mimic": ((), ("multiplier", "offset")),
}
ONCE: dict[str, tuple[str, ...]] = {
    "joint": ("parent", "child", "origin", "axis", *_PARTS),
    "link": ("inertial",),
    "inertial": ("origin", "mass", "inertia"),
    "visual": ("origin", "geometry", "material"),
    "collision": ("origin", "geometry"),
}
"""The elements of which each of these has one; urdfdom, which ROS and Pinocchio use, reads the first."""

MOMENTS = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
"""Attributes of <inertia>: the upper triangle of a symmetric matrix, row by row."""
_SHAPES: Mapping[str, Mapping[str, int]] = MappingProxyType(
    {
        "sphere": {"radius": 1},
        "cylinder": {"radius": 1, "length": 1},
        "capsule": {"radius": 1, "length": 1},
        "box": {"size": 3},
        "mesh": {"scale": 3},
    }
)
"""Shapes of links, and how many numbers each of their attributes has [m]; capsules are those of Drake."""
_ORIGIN: Vector = (0.0, 0.0, 0.0)


class Follows(NamedTuple):
    """The content of <mimic>: position = multiplier * position of another joint + offset."""

    joint: str  # name of the joint that is followed
    multiplier: float = 1.0  # factor on its position
    offset: float = 0.0  # added to it [rad or m]


class SoftLimits(NamedTuple):
    """The position limits in <safety_controller>; one that is missing is 0, as in URDF."""

    lower: float  # smallest position [rad or m]
    upper: float  # largest position [rad or m]
    one_sided: bool  # whether one of the two is missing


@dataclass(frozen=True)
class JointDescription:
    """A joint of a robot description."""

    name: str  # its name
    type: str  # one of `CHAIN_JOINTS`, fixed, floating or planar
    parent: str  # the link before it
    child: str  # the link after it
    origin: Vector = _ORIGIN  # position of the joint in the frame of its parent link, (3,) [m]
    rpy: Vector = _ORIGIN  # orientation of its frame there: roll, pitch, yaw, (3,) [rad]
    axis: Vector = (1.0, 0.0, 0.0)  # unit vector, (3,), in the frame of the joint
    lower: float = -math.inf  # smallest position [rad or m]; -inf without limits, 0 if fixed
    upper: float = math.inf  # largest position [rad or m]; inf without limits, 0 if fixed
    velocity: float | None = None  # largest speed [rad/s or m/s], may be infinite; None without <limit>
    effort: float = math.inf  # largest torque or force [N m or N]; 0 or infinite if unknown
    damping: float = 0.0  # torque or force per speed [N m s/rad or N s/m]
    friction: float = 0.0  # torque or force of dry friction [N m or N]
    follows: Follows | None = None  # how it follows another joint; None if it moves independently
    excluded: str | None = None  # why it cannot be on a chain, from <excluded reason="...">; None if it can
    soft: SoftLimits | None = None  # where its controller stops it; None if not given, or both 0

    @classmethod
    def placed(cls, name: str, kind: str, parent: str, child: str, placement: pin.SE3) -> JointDescription:
        """Describe a joint of a type between two links, at its placement in the frame of the first."""
        origin, rpy = _origin_of(placement)
        return cls(name, kind, parent, child, origin, rpy)

    def driven(
        self, axis: ArrayLike, turns: bool, edges: tuple[float, float], effort: float, velocity: float
    ) -> JointDescription:
        """Return the joint with an axis and limits; those from `NO_LIMIT` on are none.

        Args:
            axis: unit vector in the frame of the joint, (3,).
            turns: whether it turns about the axis; otherwise it slides along it.
            edges: smallest and largest position [rad or m]; infinite without a limit.
            effort: largest torque or force [N m or N]; 0 or infinite if unknown.
            velocity: largest speed [rad/s or m/s]; infinite if unknown.
        """
        lower, upper = np.clip(edges, -NO_LIMIT, NO_LIMIT).tolist()
        limited = lower > -NO_LIMIT or upper < NO_LIMIT
        kind = "revolute" if turns else "prismatic"
        return replace(
            self,
            type=kind if limited or not turns else "continuous",
            axis=_vector(axis),
            lower=lower if limited else -math.inf,
            upper=upper if limited else math.inf,
            effort=effort if 0.0 < effort < NO_LIMIT else math.inf,
            velocity=velocity if 0.0 <= velocity < NO_LIMIT else math.inf,
        )

    @cached_property
    def moves(self) -> bool:
        """False if it is fixed, or if its limits allow a single position."""
        return self.lower < self.upper


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
    most = 400  # Pinocchio's XML parser fails slightly below 500
    level = [root]
    for _ in range(most):
        level = [child for element in level for child in element]
    if level:
        raise URDFError(source, f"<{level[0].tag}>", f"is nested too deep; allowed: {most} levels")
    return root


def text_for_pinocchio(text: str) -> str:
    """Return the same XML in a form that Pinocchio can read.

    Each vector is put on one line, because Pinocchio splits vectors only at blanks; an infinite speed or
    effort becomes a huge number, because Pinocchio reads only digits.
    """
    broken = r"""\b(?:xyz|rpy)\s*=\s*(?:"[^"<\t\r\n]*[\t\r\n][^"<]*"|'[^'<\t\r\n]*[\t\r\n][^'<]*')"""
    text = re.sub(broken, lambda match: re.sub(r"[\t\r\n]", " ", match[0]), text.lstrip(_BLANK))
    infinite = r"""(\b(?:velocity|effort)\s*=\s*["'])\+?inf(?:inity)?(?=["'])"""
    return re.sub(infinite, r"\g<1>1e300", text, flags=re.IGNORECASE)


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


def read_joint(element: Element, source: str) -> JointDescription:
    """Read and check a <joint> that has a name."""
    name = element.get("name", "")
    kind = element.get("type")
    fault = partial(URDFError, source, f"joint {name!r}")
    joint_types = (*CHAIN_JOINTS, "fixed", "floating", "planar")
    if kind not in joint_types:
        written = "not given" if kind is None else repr(kind)
        raise fault(f"type is {written}; allowed: {', '.join(joint_types)}")
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
    origin = _read_vector(element, "origin", "xyz", _ORIGIN, fault)
    rpy = _read_vector(element, "origin", "rpy", _ORIGIN, fault)
    axis: Vector = (1.0, 0.0, 0.0)
    if kind not in ("fixed", "floating"):
        axis = _unit(_read_vector(element, "axis", "xyz", axis, fault), fault)
    parts = {tag: element.find(tag) for tag in _PARTS}
    numbers = {tag: None if part is None else _read_part(part, fault) for tag, part in parts.items()}
    lower, upper = _read_limits(kind, numbers["limit"], fault)
    limit = numbers["limit"] or {}
    mimic = parts["mimic"]
    follows = None if mimic is None else Follows(mimic.attrib["joint"], **(numbers["mimic"] or {}))
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
        **{key: limit[key] for key in ("velocity", "effort") if key in limit},
        **(numbers["dynamics"] or {}),
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
    # Python would also accept "1_0" and "inf".
    number = re.compile(r"[ \t\r\n]*[+-]?([0-9]+(\.[0-9]*)?|\.[0-9]+)([eE][+-]?[0-9]+)?")
    numbers = list(map(float, words)) if all(map(number.fullmatch, words)) else [math.nan]
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
    attributes = [attribute for attribute in required + optional if attribute in part.attrib]
    if tag == "dynamics" and not attributes:
        raise fault("<dynamics> has neither damping nor friction")
    unlimited = [
        name
        for name in attributes
        if name in ("effort", "velocity") and re.fullmatch(r"\+?inf(inity)?", part.attrib[name], re.I)
    ]
    finite = [name for name in attributes if name not in unlimited]
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


def write_joint(robot: Element, joint: JointDescription) -> Element:
    """Add a joint to a robot, without soft limits; `read_joint` reads it back exactly.

    Where readers of URDF need a number and there is no limit, it is `NO_LIMIT`.
    """
    element = SubElement(robot, "joint", name=joint.name, type=joint.type)
    SubElement(element, "parent", link=joint.parent)
    SubElement(element, "child", link=joint.child)
    _write_origin(element, joint.origin, joint.rpy)
    if joint.type in CHAIN_JOINTS:
        SubElement(element, "axis", xyz=numbers_text(joint.axis))
    if joint.velocity is not None:
        bounded = ("lower", "upper") if joint.lower > -math.inf or joint.upper < math.inf else ()
        limits = {name: getattr(joint, name) for name in (*bounded, *_PARTS["limit"][0])}
        edge = {-math.inf: -NO_LIMIT, math.inf: NO_LIMIT}
        SubElement(element, "limit", {name: repr(edge.get(value, value)) for name, value in limits.items()})
    dynamics = {name: repr(getattr(joint, name)) for name in _PARTS["dynamics"][1]}
    if joint.damping or joint.friction:
        SubElement(element, "dynamics", dynamics)
    if joint.follows is not None:
        leader, *numbers = joint.follows
        attributes = dict(zip(_PARTS["mimic"][1], map(repr, numbers), strict=True))
        SubElement(element, "mimic", {"joint": leader, **attributes})
    if joint.excluded is not None:
        SubElement(element, "excluded", reason=joint.excluded)
    return element


# What links have: masses, and shapes.


def read_inertials(text: str, source: str) -> dict[str, RigidBody]:
    """Return what a description gives as <inertial> of its links, by the name of the link.

    Args:
        text: the URDF.
        source: its name in error messages.

    Raises:
        URDFError: an invalid number, such as NaN or a negative mass, which Pinocchio accepts; names the link.
    """
    # Attributes of the elements of <inertial>: number of values, their minimum, and a description.
    inertial_parts = {
        "mass": (("value",), 1, 0.0, "a finite number, 0 or more [kg]"),
        "inertia": (MOMENTS, 1, -np.finfo(np.float64).max, "a finite number"),
        "origin": (("xyz", "rpy"), 3, -np.finfo(np.float64).max, "three finite numbers"),
    }
    bodies = {}
    for link in parse_xml(text, source).findall("link"):
        inertial = link.find("inertial")
        if inertial is None:
            continue
        name = link.get("name", "")
        read: dict[str, list[float]] = {}
        for tag, (attributes, size, least, allowed) in inertial_parts.items():
            part = inertial.find(tag)
            if part is None and tag != "origin":
                raise URDFError(source, f"link {name!r}", f"<inertial> has no <{tag}>")
            for attribute in attributes:
                value = None if part is None else part.get(attribute)
                if value is None and tag == "origin":
                    value = "0 0 0"
                try:
                    numbers = [float(piece) for piece in (value or "").split()]
                except ValueError:
                    numbers = []
                if len(numbers) != size or not all(least <= number < np.inf for number in numbers):
                    reason = f"<{tag}> {attribute} is {value!r}; allowed: {allowed}"
                    raise URDFError(source, f"link {name!r}", reason)
                read[attribute] = numbers
        moments = np.zeros((3, 3))
        moments[np.triu_indices(3)] = [read[key][0] for key in MOMENTS]
        turn = pin.rpy.rpyToMatrix(*read["rpy"])
        moments = turn @ (moments + np.triu(moments, 1).T) @ turn.T
        bodies[name] = RigidBody(read["value"][0], np.array(read["xyz"]), moments)
    return bodies


def write_inertial(link: Element, body: RigidBody) -> None:
    """Add the mass, its centre and the moments of inertia of a link, if it has a mass."""
    if body.mass <= 0.0:
        return
    element = SubElement(link, "inertial")
    _write_origin(element, _vector(body.center), _ORIGIN)
    SubElement(element, "mass", value=repr(float(body.mass)))
    moments = np.asarray(body.inertia)[np.triu_indices(3)].tolist()
    SubElement(element, "inertia", dict(zip(MOMENTS, map(repr, moments), strict=True)))


class ShapeDescription(NamedTuple):
    """A shape of a link: its <collision>, or one that is seen."""

    kind: str  # one of "sphere", "cylinder", "capsule", "box", "mesh"
    numbers: Mapping[str, tuple[float, ...]]  # its attributes [m]: a radius, a length, sizes or a scale
    origin: Vector = _ORIGIN  # position of its middle in the frame of the link, (3,) [m]
    rpy: Vector = _ORIGIN  # its orientation there: roll, pitch, yaw, (3,) [rad]
    file: str = ""  # of a mesh

    @classmethod
    def placed(
        cls, kind: str, numbers: Mapping[str, ArrayLike], placement: pin.SE3, file: str = ""
    ) -> ShapeDescription:
        """Describe a shape at its placement in the frame of the link."""
        listed = {name: tuple(np.atleast_1d(value).tolist()) for name, value in numbers.items()}
        return cls(kind, listed, *_origin_of(placement), file)

    @property
    def placement(self) -> pin.SE3:
        """Its placement in the frame of the link."""
        return pin.SE3(pin.rpy.rpyToMatrix(*self.rpy), np.array(self.origin))


def read_shape(element: Element) -> ShapeDescription:
    """Read a <collision> or <visual>.

    Raises:
        InvalidValue: no such shape, or an attribute that is not as many finite numbers as it must be.
    """
    origin = element.find("origin")
    pose = {} if origin is None else origin.attrib
    rpy = _finite("origin rpy", pose.get("rpy", "0 0 0"), 3)
    xyz = _finite("origin xyz", pose.get("xyz", "0 0 0"), 3)
    geometry = element.find("geometry")
    kind = next(iter(geometry), None) if geometry is not None else None
    tag = "no geometry" if kind is None else kind.tag
    if kind is None or tag not in _SHAPES:
        raise InvalidValue(f"{element.tag} geometry", tag, "sphere, cylinder, capsule, box, mesh")
    usual = {"scale": "1 1 1"}
    numbers = {
        name: _finite(name, kind.get(name, usual.get(name, "")), count)
        for name, count in _SHAPES[tag].items()
    }
    return ShapeDescription(tag, numbers, _vector(xyz), _vector(rpy), kind.get("filename", ""))


def write_shape(link: Element, tag: str, shape: ShapeDescription) -> Element:
    """Add a shape to a link; `tag` is "collision" or "visual"."""
    element = SubElement(link, tag)
    _write_origin(element, shape.origin, shape.rpy)
    attributes = {name: numbers_text(shape.numbers[name]) for name in _SHAPES[shape.kind]}
    named = {"filename": shape.file} if shape.file else {}
    SubElement(SubElement(element, "geometry"), shape.kind, named | attributes)
    return element


# Numbers, placements and names.


def _finite(name: str, text: str, count: int) -> tuple[float, ...]:
    try:
        numbers = [float(word) for word in text.split()]
    except ValueError:
        numbers = []
    if len(numbers) != count or not np.all(np.isfinite(numbers)):
        raise InvalidValue(name, text, "a finite number" if count == 1 else f"{count} finite numbers")
    return tuple(numbers)


def numbers_text(values: Any) -> str:
    """Return numbers in a form that preserves them exactly."""
    return " ".join(repr(float(value)) for value in values)


def _vector(values: ArrayLike) -> Vector:
    x, y, z = np.asarray(values).tolist()
    return x, y, z


def _origin_of(placement: pin.SE3) -> tuple[Vector, Vector]:
    """Return the position and the angles of a placement, as <origin> has them."""
    return _vector(placement.translation), roll_pitch_yaw(placement.rotation)


def _write_origin(element: Element, origin: Vector, rpy: Vector) -> None:
    SubElement(element, "origin", xyz=numbers_text(origin), rpy=numbers_text(rpy))


def roll_pitch_yaw(rotation: Array) -> Vector:
    """Return the angles of a rotation matrix (3, 3) [rad], with as few digits as needed to reproduce it."""
    angles = np.asarray(pin.rpy.matrixToRpy(rotation))
    for digits in range(3, 17):
        rounded = np.round(angles, digits) + 0.0  # no negative zero
        if np.abs(pin.rpy.rpyToMatrix(*rounded) - rotation).max() <= 1e-15:  # the rounding of three angles
            angles = rounded
            break
    return _vector(angles)


def free_name(name: str, taken: set[str]) -> str:
    """Return a name that is not taken, with underscores if it is, and take it."""
    while name in taken:
        name += "_"
    taken.add(name)
    return name
