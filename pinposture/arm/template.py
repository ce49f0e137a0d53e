"""Module templates, which describe one module of an arm, and the URDF of an arm of modules.

At zero joint positions a module extends along +x of its base. Joint i is followed by link i, which lies along
the local x axis; the next joint is at the end of that link. An RyRz module is thus a joint about y, a link
l1, a joint about z and a link l2, whose end is the posture control point of the module (6.1).

In the URDF each link is a solid of uniform density: a sphere at the joint before it and a cylinder along its
local x axis, both with the radius of the module. Visuals, collision geometry and inertia describe this same
solid; the overlap of sphere and cylinder counts twice, as in simulators that sum the mass of geometries.
"""

from __future__ import annotations

import math
import re
import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from pinposture._validation import require_instance, require_known, require_name
from pinposture.arm.configurations import MOST_MOVING
from pinposture.arm.inertias import RigidBody
from pinposture.arm.urdf import (
    CHAIN_JOINTS,
    Follows,
    JointDescription,
    ShapeDescription,
    numbers_text,
    write_inertial,
    write_joint,
    write_shape,
)
from pinposture.errors import InvalidValue

_UNIT_VECTORS = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}

DENSITY = 1000.0
"""Density of every link [kg/m^3]."""


@dataclass(frozen=True)
class JointSpec:
    """One joint of a module.

    Attributes:
        axis: "x", "y" or "z", or any vector (3,) that is not zero; in the frame of the link before the joint.
        type: "revolute", "prismatic" or "continuous" (revolute without limits).
        lower: smallest position [rad], or [m] if prismatic; -inf if continuous.
        upper: largest position [rad], or [m] if prismatic; inf if continuous.
        velocity: largest speed [rad/s], or [m/s] if prismatic; the default is a placeholder.
        effort: largest torque [N m], or force [N] if prismatic; 0 if it is not known.
        follows: index of an earlier joint of the module that this one follows, 0-based; it then has no degree
            of freedom of its own. None if it has one.
        ratio: its motion relative to that of the joint it follows.

    Raises:
        UnknownName: there is no such type.
        InvalidValue: an invalid value, or a prismatic joint without explicit limits.
    """

    axis: str | Sequence[float]
    type: str = "revolute"
    lower: float = -math.pi
    upper: float = math.pi
    velocity: float = 2.0
    effort: float = 0.0
    follows: int | None = None
    ratio: float = 1.0

    def __post_init__(self) -> None:
        require_known("type of joint", self.type, CHAIN_JOINTS)
        if not isinstance(self.axis, str):
            object.__setattr__(self, "axis", _axis_vector(self.axis))
        elif self.axis not in _UNIT_VECTORS:
            raise InvalidValue("joint axis", self.axis, "'x', 'y', 'z' or three numbers")
        self._check_limits()
        velocity = _number("velocity", self.velocity, "a finite number above 0", lowest=math.ulp(0.0))
        object.__setattr__(self, "velocity", velocity)
        effort = _number("effort", self.effort, "a finite number, 0 or more", lowest=0.0)
        object.__setattr__(self, "effort", effort)
        if self.follows is not None and (type(self.follows) is not int or self.follows < 0):
            raise InvalidValue("follows", self.follows, "the index of an earlier joint, or None")
        object.__setattr__(self, "ratio", _number("ratio", self.ratio, "a finite number"))

    def _check_limits(self) -> None:
        limits = (self.lower, self.upper)
        full_turn = (-math.pi, math.pi)
        no_limits = (-math.inf, math.inf)
        if self.type == "continuous":
            if limits not in (full_turn, no_limits):
                raise InvalidValue(
                    "limits of a continuous joint", limits, "none; a revolute joint has limits"
                )
            lower, upper = no_limits
        else:
            if self.type == "prismatic" and limits == full_turn:
                raise InvalidValue("limits of a prismatic joint", None, "lower= and upper= [m], both given")
            lower = _number("lower", self.lower, "a finite number")
            upper = _number("upper", self.upper, "a finite number")
            if lower >= upper:
                raise InvalidValue("joint limits", (lower, upper), "lower < upper")
        object.__setattr__(self, "lower", lower)
        object.__setattr__(self, "upper", upper)

    @property
    def direction(self) -> tuple[float, float, float]:
        """Unit vector along the axis, (3,), in the frame of the link before the joint."""
        if isinstance(self.axis, str):
            return _UNIT_VECTORS[self.axis]
        x, y, z = self.axis
        return x, y, z


@dataclass(frozen=True)
class ModuleTemplate:
    """Description of one module.

        ModuleTemplate(
            "RxRyP",
            joints=(JointSpec("x"), JointSpec("y"), JointSpec("x", type="prismatic", lower=0.0, upper=0.05)),
            link_lengths=(0.0, 0.02, 0.03),
        )

    Attributes:
        name: name of the template: letters, digits, "_", "-" and ".", beginning with a letter or "_".
        joints: the joints from base to end, (n,).
        link_lengths: length of the link after each joint, (n,) [m]; 0 makes two joints coincide.
        radius: radius of the links and of the joints between them [m].
        lead: length of the link between the end of the previous module and the first joint [m].

    Raises:
        InvalidValue: no joints, not one length for each joint, or another invalid value.
    """

    name: str
    joints: Sequence[JointSpec]
    link_lengths: Sequence[float]
    radius: float = 0.01
    lead: float = 0.0

    def __post_init__(self) -> None:
        if not isinstance(self.name, str) or not re.fullmatch(r"[A-Za-z_][A-Za-z0-9_.-]*", self.name):
            raise InvalidValue("template name", self.name, "letters, digits, _ - . and a letter or _ first")
        joints = _items(self.joints, "joints", "a sequence of JointSpec")
        if not joints or not all(isinstance(joint, JointSpec) for joint in joints):
            raise InvalidValue("joints", self.joints, "at least one JointSpec, and nothing else")
        allowed = f"{len(joints)} lengths [m], one for each joint"
        lengths = _items(self.link_lengths, "link_lengths", allowed)
        if len(lengths) != len(joints):
            raise InvalidValue("link_lengths", self.link_lengths, allowed)
        # Outside these bounds the inertia of a link would under- or overflow.
        checked = tuple(
            _number(f"link_lengths[{i}]", length, "0 to 1e6 m", lowest=0.0, highest=1e6)
            for i, length in enumerate(lengths)
        )
        for i, joint in enumerate(joints):
            at = joint.follows
            if at is not None and (at >= i or joints[at].follows is not None):
                allowed = "the index of an earlier joint that follows no other"
                raise InvalidValue(f"joints[{i}].follows", at, allowed)
        radius = _number("radius", self.radius, "1e-6 to 1e6 m", lowest=1e-6, highest=1e6)
        lead = _number("lead", self.lead, "0 to 1e6 m", lowest=0.0, highest=1e6)
        object.__setattr__(self, "lead", lead)
        object.__setattr__(self, "joints", joints)
        object.__setattr__(self, "link_lengths", checked)
        object.__setattr__(self, "radius", radius)

    @property
    def length(self) -> float:
        """Length of the straight module with its slides at zero [m]."""
        return math.fsum((self.lead, *self.link_lengths))

    @property
    def dof(self) -> int:
        """Number of degrees of freedom: joints that follow no other."""
        return sum(joint.follows is None for joint in self.joints)

    def with_lengths(self, link_lengths: Sequence[float]) -> ModuleTemplate:
        """Return the same module with other link lengths.

        Args:
            link_lengths: length of the link after each joint, (n,) [m].

        Raises:
            InvalidValue: not one length of 0 to 1e6 m for each joint.
        """
        return replace(self, link_lengths=link_lengths)

    def with_limits(self, lower: float, upper: float) -> ModuleTemplate:
        """Return the same module with other limits for its revolute joints; other joints keep theirs.

        Args:
            lower: smallest position [rad].
            upper: largest position [rad].

        Raises:
            InvalidValue: not finite, or not lower < upper.
        """
        joints = (replace(j, lower=lower, upper=upper) if j.type == "revolute" else j for j in self.joints)
        return replace(self, joints=tuple(joints))


def continuum_section(
    disks: int = 10,
    length: float = 0.2,
    bend: float = math.pi,
    stretch: float = 0.0,
    radius: float = 0.01,
    name: str = "Continuum",
) -> ModuleTemplate:
    """Create a module that bends in an arc of constant curvature, like a tendon-driven flexible backbone.

    The backbone is modelled by disks with universal joints. All of them turn by the same two angles, which
    are the degrees of freedom: the bending about y and about z, each divided by the number of disks. The
    joints are at the centres of equal pieces of the arc, and the order of their axes alternates from disk to
    disk, so the error of the end position relative to the length falls with the square of the number of
    disks.

    Args:
        disks: number of disks, at least 1.
        length: length of the backbone [m].
        bend: largest bending in each direction [rad].
        stretch: largest change of length in either direction [m]; above 0 it adds a third degree of freedom.
        radius: radius of the backbone [m].
        name: name of the template.

    Raises:
        InvalidValue: a value out of range.
    """
    if type(disks) is not int or disks < 1:
        raise InvalidValue("disks", disks, "a whole number of at least 1")
    most = _number("bend", bend, "0 to 100 rad", lowest=1e-9, highest=100.0) / disks
    piece = _number("length", length, "1e-6 to 1e6 m", lowest=1e-6, highest=1e6) / disks
    slack = _number("stretch", stretch, "0 to less than the length", 0.0, 0.999 * length) / disks
    joints: list[JointSpec] = []
    leaders: dict[str, int] = {}
    for disk in range(disks):
        for axis in ("yz", "zy")[disk % 2] + ("x" if slack else ""):
            follows = leaders.get(axis)
            leaders.setdefault(axis, len(joints))
            edge, kind = (slack, "prismatic") if axis == "x" else (most, "revolute")
            joints.append(JointSpec(axis, kind, -edge, edge, follows=follows))
    lengths = [0.0] * len(joints)
    for last in range(len(joints) // disks - 1, len(joints), len(joints) // disks):
        lengths[last] = piece
    lengths[-1] = piece / 2.0
    return ModuleTemplate(name, joints, lengths, radius, lead=piece / 2.0)


def _number(
    name: str, value: Any, allowed: str, lowest: float = -math.inf, highest: float = math.inf
) -> float:
    """Return a finite number within bounds as a plain float, never -0.0."""
    try:
        number = math.nan if isinstance(value, (bool, str, bytes)) else float(value) + 0.0
    except (TypeError, ValueError, OverflowError):
        number = math.nan
    if not math.isfinite(number) or not lowest <= number <= highest:
        raise InvalidValue(name, value, allowed)
    return number


def _items(values: Any, name: str, allowed: str) -> tuple[Any, ...]:
    if isinstance(values, (str, bytes)):
        raise InvalidValue(name, values, allowed)
    try:
        return tuple(values)
    except TypeError:
        raise InvalidValue(name, values, allowed) from None


def _axis_vector(axis: Any) -> tuple[float, float, float]:
    allowed = "'x', 'y', 'z' or three finite numbers, not all 0"
    vector = [_number("joint axis", value, allowed) for value in _items(axis, "joint axis", allowed)]
    largest = max(map(abs, vector), default=0.0)
    if len(vector) != 3 or largest == 0.0:
        raise InvalidValue("joint axis", axis, allowed)
    x, y, z = (value / largest for value in vector)  # so that no square over- or underflows
    norm = math.hypot(x, y, z)
    return x / norm, y / norm, z / norm


def _planar(name: str) -> ModuleTemplate:
    joints = name.count("R")
    return ModuleTemplate(name, (JointSpec("z"),) * joints, (0.15,) * joints, radius=0.02)


TEMPLATES: Mapping[str, ModuleTemplate] = MappingProxyType(
    {
        "RyRz": ModuleTemplate("RyRz", (JointSpec("y"), JointSpec("z")), (0.025, 0.025)),
        "RzRy": ModuleTemplate("RzRy", (JointSpec("z"), JointSpec("y")), (0.025, 0.025)),
        "Rz": _planar("Rz"),
        "RzRz": _planar("RzRz"),
        "RzRzRz": _planar("RzRzRz"),
        "Continuum": continuum_section(),
    }
)
"""The shipped templates by name. Those with only "Rz" joints make planar arms, the others spatial ones."""


def template(name: str) -> ModuleTemplate:
    """Look up a shipped template.

    Args:
        name: for instance "RyRz".

    Raises:
        UnknownName: there is no such template.
    """
    require_known("template", name, TEMPLATES)
    return TEMPLATES[name]


def modules_to_urdf(
    modules: Sequence[ModuleTemplate], name: str, command: str = "pinposture.arm.template.modules_to_urdf"
) -> str:
    """Chain modules from base to tip and write the arm as URDF.

    The first link is "base". Joint j of module m is "m01_j1_y" (with the letter of its axis, if it has one),
    the link after it "m01_l1"; numbers are zero-padded so that names sort in order. The chain ends in the
    link "tip", fixed to the end of the last link. At zero joint positions the arm lies along +x of its base.

    Args:
        modules: the modules in order; they may differ.
        name: name of the robot.
        command: generator named in the first comment.

    Returns:
        URDF text; the same for the same arguments. Floats are preserved exactly.

    Raises:
        InvalidValue: no modules, an entry of another type, or a name or command not representable in XML.
    """
    if isinstance(modules, ModuleTemplate):
        raise InvalidValue("modules", modules, "a sequence of ModuleTemplate")
    listed = list(modules)
    for index, module in enumerate(listed):
        require_instance(f"modules[{index}]", module, ModuleTemplate, "a ModuleTemplate")
    if not listed:
        raise InvalidValue("modules", modules, "at least one ModuleTemplate")
    joints = sum(len(module.joints) for module in listed)
    if joints > MOST_MOVING:
        raise InvalidValue("joints of all modules", joints, f"at most {MOST_MOVING}")
    require_name("name", name)
    if not isinstance(command, str) or "--" in command or not command.isprintable():
        raise InvalidValue("command", command, "printable text without '--', which would end the comment")
    robot = ET.Element("robot", name=name)
    colours = {"joint": (0.25, 0.27, 0.3, 1.0), "odd": (0.93, 0.55, 0.14, 1.0), "even": (0.9, 0.9, 0.88, 1.0)}
    for colour, shade in colours.items():
        material = ET.SubElement(robot, "material", name=colour)
        ET.SubElement(material, "color", rgba=numbers_text(shade))
    _write_chain(robot, listed)
    ET.indent(robot)
    head = f'<?xml version="1.0" encoding="utf-8"?>\n<!-- Generated by {command}; do not edit. -->\n'
    return head + ET.tostring(robot, encoding="unicode") + "\n"


def _write_chain(robot: ET.Element, modules: Sequence[ModuleTemplate]) -> None:
    """Add the links and joints of the arm."""
    module_digits = max(2, len(str(len(modules))))
    joint_digits = len(str(max(len(module.joints) for module in modules)))
    ET.SubElement(robot, "link", name="base")
    parent = "base"
    distance = 0.0
    contents: dict[tuple[float, float, str], list[ET.Element]] = {}  # of links, which are often alike
    for m, module in enumerate(modules, start=1):
        names: list[str] = []
        distance += module.lead
        for j, (spec, length) in enumerate(zip(module.joints, module.link_lengths, strict=True), start=1):
            prefix = f"m{m:0{module_digits}d}"
            number = f"{j:0{joint_digits}d}"
            letter = f"_{spec.axis}" if isinstance(spec.axis, str) else ""
            child = f"{prefix}_l{number}"
            names.append(f"{prefix}_j{number}{letter}")
            joint = JointDescription(
                names[-1],
                spec.type,
                parent,
                child,
                origin=(distance, 0.0, 0.0),
                axis=spec.direction,
                lower=spec.lower,
                upper=spec.upper,
                velocity=spec.velocity,
                effort=spec.effort,
                follows=None if spec.follows is None else Follows(names[spec.follows], spec.ratio),
            )
            write_joint(robot, joint)
            look = (length, module.radius, "odd" if m % 2 else "even")
            if look not in contents:
                contents[look] = _link_content(*look)
            ET.SubElement(robot, "link", name=child).extend(contents[look])
            parent = child
            distance = length
    write_joint(robot, JointDescription("tip_joint", "fixed", parent, "tip", (distance, 0.0, 0.0)))
    ET.SubElement(robot, "link", name="tip")


def _link_content(length: float, radius: float, colour: str) -> list[ET.Element]:
    """Return the mass and the shapes of a link: a ball at its joint, and a tube along x."""
    link = ET.Element("link")
    mass, center, along, across = link_inertia(length, radius)
    write_inertial(link, RigidBody(mass, np.array([center, 0.0, 0.0]), np.diag([along, across, across])))
    for tag in ("visual", "collision"):
        _write_solid(link, tag, "joint", 0.0, ShapeDescription("sphere", {"radius": (radius,)}))
        if length > 0.0:
            tube = {"radius": (radius,), "length": (length,)}
            _write_solid(link, tag, colour, length / 2.0, ShapeDescription("cylinder", tube))
    return list(link)


def _write_solid(link: ET.Element, tag: str, colour: str, center: float, shape: ShapeDescription) -> None:
    """Add a shape along x, turned there from z, with a colour if it is seen."""
    placed = shape._replace(origin=(center, 0.0, 0.0), rpy=(0.0, math.pi / 2.0, 0.0))
    element = write_shape(link, tag, placed)
    if tag == "visual":
        ET.SubElement(element, "material", name=colour)


class LinkInertia(NamedTuple):
    """Inertia of a link about its centre of mass, axes parallel to the link frame."""

    mass: float  # mass [kg]
    center: float  # x coordinate of the centre of mass in the link frame [m]
    along: float  # moment of inertia about x [kg m^2]
    across: float  # moment of inertia about y, and about z [kg m^2]


def link_inertia(length: float, radius: float) -> LinkInertia:
    """Compute the inertia of a ball at the joint and a cylinder from there along x, with density `DENSITY`.

    Args:
        length: length of the cylinder [m]; 0 for the ball alone.
        radius: radius of both [m].
    """
    ball = DENSITY * math.pi * radius**3 * 4.0 / 3.0
    tube = DENSITY * math.pi * radius**2 * length
    mass = ball + tube
    center = tube * length / 2.0 / mass
    along = ball * radius**2 * 2.0 / 5.0 + tube * radius**2 / 2.0
    across = ball * (radius**2 * 2.0 / 5.0 + center**2)
    across += tube * ((3.0 * radius**2 + length**2) / 12.0 + (length / 2.0 - center) ** 2)
    return LinkInertia(mass, center, along, across)
