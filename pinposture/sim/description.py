"""The description of an arm as it is handed to MuJoCo: its links, joints and inertias, and nothing else.

Meshes, visuals, collision shapes, mimics and simulator extensions are left out. Joints that `Arm` does not
move keep moving here, and are held by servos; floating and planar ones stay where they are. Names are
replaced by numbers, for MuJoCo keeps some names to itself ("world").
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pinocchio as pin

from pinposture.arm import Arm
from pinposture.arm.configurations import UNLIMITED
from pinposture.arm.urdf_reader import (
    CHAIN_JOINTS,
    Description,
    JointDescription,
    parse_xml,
    read_description,
)
from pinposture.errors import InvalidValue
from pinposture.sim.inertias import (
    STAND_IN_MASS,
    STAND_IN_RADIUS,
    Body,
    read_inertia,
    settled,
    together,
)

MENTIONED = 6
"""How many links with the same fault are listed."""


@dataclass(frozen=True, eq=False)
class PhysicalDescription:
    """What MuJoCo is told of an arm.

    Attributes:
        text: the URDF. Link k is called "link_k" and joint k "joint_k", counted as in `read`.
        read: the description of the arm.
        moving: numbers of the joints that move, those of the arm and those that are held.
        effort: the largest torque or force of each joint of `moving` [N m or N]; infinite without a limit.
        warnings: what had to be settled, in words.
    """

    text: str
    read: Description
    moving: tuple[int, ...]
    effort: tuple[float, ...]
    warnings: tuple[str, ...]

    @cached_property
    def joint_number(self) -> Mapping[str, int]:
        """Number of each joint by its name."""
        return {joint.name: number for number, joint in enumerate(self.read.joints)}

    @cached_property
    def link_number(self) -> Mapping[str, int]:
        """Number of each link by its name."""
        return {link: number for number, link in enumerate(self.read.links)}


def describe(arm: Arm) -> PhysicalDescription:
    """Make the description for MuJoCo.

    Raises:
        InvalidValue: the arm was made from a Pinocchio model and has no description.
        URDFError: an inertia in the description is not a number.
    """
    if arm.urdf is None:
        allowed = "an arm from a URDF or from modules; one from Arm.from_model has no description to simulate"
        raise InvalidValue("arm", arm, allowed)
    read = read_description(arm.urdf)
    source = parse_xml(arm.urdf, read.source)
    links = {link.get("name", ""): link for link in source.findall("link")}
    elements = {joint.get("name", ""): joint for joint in source.findall("joint")}
    inertias = {name: read_inertia(element, read.source) for name, element in links.items()}
    bodies, warnings = _settled_bodies(read, inertias)
    numbers = {link: number for number, link in enumerate(read.links)}
    robot = ET.Element("robot", name="arm")
    for link, number in numbers.items():
        _add_link(robot, number, bodies.get(link))
    for number, joint in enumerate(read.joints):
        _add_joint(robot, number, joint, numbers, elements[joint.name])
    moving = tuple(number for number, joint in enumerate(read.joints) if joint.type in CHAIN_JOINTS)
    effort = tuple(_effort(elements[read.joints[number].name]) for number in moving)
    return PhysicalDescription(ET.tostring(robot, encoding="unicode"), read, moving, effort, warnings)


def joint_placement(joint: JointDescription) -> pin.SE3:
    """Where the frame of a joint is in the frame of the link before it, at position 0."""
    return pin.SE3(pin.rpy.rpyToMatrix(*joint.rpy), np.array(joint.origin))


def _settled_bodies(
    read: Description, inertias: Mapping[str, Body]
) -> tuple[dict[str, Body], tuple[str, ...]]:
    """The body that each moving link carries, with all that is fixed to it, and what had to be settled."""
    after: dict[str, list[JointDescription]] = {}
    for joint in read.joints:
        after.setdefault(joint.parent, []).append(joint)
    bodies: dict[str, Body] = {}
    faults: dict[str, list[str]] = {}
    for joint in read.joints:
        if joint.type not in CHAIN_JOINTS:
            continue
        parts, open_links = [], [(joint.child, pin.SE3.Identity())]
        while open_links:
            link, where = open_links.pop()
            parts.append((where, inertias[link]))
            fixed = [next_one for next_one in after.get(link, []) if next_one.type not in CHAIN_JOINTS]
            open_links += [(next_one.child, where * joint_placement(next_one)) for next_one in fixed]
        bodies[joint.child], fault = settled(together(parts))
        if fault:
            faults.setdefault(fault, []).append(joint.child)
    ball = f"a ball of {1e3 * STAND_IN_MASS:g} g with a radius of {1e2 * STAND_IN_RADIUS:g} cm"
    advice = {
        "no mass": f"taken as {ball}",
        "moments of no solid": "moments raised to the nearest that a solid can have",
    }
    return bodies, tuple(f"{_listed(names)}: {fault}; {advice[fault]}" for fault, names in faults.items())


def _listed(names: list[str]) -> str:
    more = f" and {len(names) - MENTIONED} more" if len(names) > MENTIONED else ""
    return f"moving link{'s' * (len(names) > 1)} {', '.join(map(repr, names[:MENTIONED]))}{more}"


def _effort(joint: ET.Element) -> float:
    """The largest torque or force; a limit of 0 in a description means that nobody knew it."""
    limit = joint.find("limit")
    effort = float(limit.get("effort", "inf")) if limit is not None else math.inf
    return effort if 0.0 < effort < UNLIMITED else math.inf


def _add_link(robot: ET.Element, number: int, body: Body | None) -> None:
    link = ET.SubElement(robot, "link", name=f"link_{number}")
    if body is None:
        return
    inertial = ET.SubElement(link, "inertial")
    ET.SubElement(inertial, "origin", xyz=_numbers(*body.center), rpy="0 0 0")
    ET.SubElement(inertial, "mass", value=_numbers(body.mass))
    names = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
    moments = body.inertia[np.triu_indices(3)]
    ET.SubElement(
        inertial, "inertia", {name: _numbers(value) for name, value in zip(names, moments, strict=True)}
    )


def _add_joint(
    robot: ET.Element, number: int, joint: JointDescription, numbers: Mapping[str, int], source: ET.Element
) -> None:
    kind = joint.type if joint.type == "prismatic" else "continuous"  # stops are set on the model
    kind = kind if joint.type in CHAIN_JOINTS else "fixed"
    element = ET.SubElement(robot, "joint", name=f"joint_{number}", type=kind)
    ET.SubElement(element, "parent", link=f"link_{numbers[joint.parent]}")
    ET.SubElement(element, "child", link=f"link_{numbers[joint.child]}")
    ET.SubElement(element, "origin", xyz=_numbers(*joint.origin), rpy=_numbers(*joint.rpy))
    if kind != "fixed":
        ET.SubElement(element, "axis", xyz=_numbers(*joint.axis))
        dynamics = source.find("dynamics")
        if dynamics is not None:
            ET.SubElement(
                element, "dynamics", {name: dynamics.get(name, "0") for name in ("damping", "friction")}
            )


def _numbers(*values: float) -> str:
    return " ".join(repr(float(value)) for value in values)
