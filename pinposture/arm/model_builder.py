"""Pinocchio models: built from a URDF, out of the parts that they are made of, and written as one.

Shapes, materials and extensions are left out: the reader in Pinocchio prints a message for each that it does
not know, as <capsule>, although the library reads them itself.
"""

from __future__ import annotations

import threading
from collections.abc import Collection, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from xml.etree.ElementTree import Element, SubElement, indent, tostring

import numpy as np
import pinocchio as pin

from pinposture.arm.configurations import MOST_MOVING, NO_LIMIT
from pinposture.arm.couplings import Coupling, joint_axes, read_couplings
from pinposture.arm.inertias import RigidBody
from pinposture.arm.urdf import (
    MOMENTS,
    Follows,
    JointDescription,
    finite_numbers,
    free_name,
    parse_xml,
    write_inertial,
    write_joint,
)
from pinposture.errors import URDFError

_STACK_SIZE = threading.Lock()  # the size is that of all threads that are started


def build_model(text: str, source: str, unlimited: Collection[str] = ()) -> pin.Model:
    """Build the model of all links and joints of a description, with independent mimic joints.

    Links whose <inertial> Pinocchio cannot read have no mass.

    Args:
        text: the URDF, as `text_for_pinocchio` makes it.
        source: its name in error messages.
        unlimited: names of continuous joints to make revolute without limits.

    Raises:
        URDFError: Pinocchio rejects the description, or would take too long for it.
    """
    robot = parse_xml(text, source)
    links = len(robot.findall("link"))
    moving = sum(joint.get("type") != "fixed" for joint in robot.findall("joint"))
    # 10,000 joints in a row, all but one fixed, take Pinocchio 15 s.
    for count, what, most in ((links, "links", 10_001), (moving, "moving joints", MOST_MOVING)):
        if count > most:
            raise URDFError(source, "<robot>", f"has {count} {what}; allowed: {most} at most")
    needed = Element("robot", robot.attrib)
    for link in robot.findall("link"):
        made = SubElement(needed, "link", name=link.get("name", ""))
        made.extend(element for element in link.findall("inertial") if _is_readable(element))
    for joint in robot.findall("joint"):
        made = SubElement(needed, "joint", joint.attrib)
        parts = ("parent", "child", "origin", "axis", "limit", "dynamics")
        made.extend(element for element in joint if element.tag in parts)
        if joint.get("name") in unlimited:
            _remove_limits(made)
    try:
        stack = (16 << 20) + (8 << 10) * len(needed)  # a link and a joint need 2.3 kB together [bytes]
        return _parse(tostring(needed, encoding="unicode"), stack)
    except (ValueError, RuntimeError) as error:
        raise URDFError(source, "<robot>", f"was rejected by Pinocchio: {error}") from None


def _parse(text: str, stack: int) -> pin.Model:
    """Let Pinocchio read a description in a thread with a stack of its own [bytes].

    It follows the tree by recursion, and would overflow the stack of the caller at 4,000 joints.
    """
    with ThreadPoolExecutor(1) as reader:
        with _STACK_SIZE:
            before = threading.stack_size(stack)
            try:
                model = reader.submit(pin.buildModelFromXML, text)
            finally:
                threading.stack_size(before)
        return model.result()


def _remove_limits(joint: Element) -> None:
    """Make a continuous joint revolute; its position is then a number that counts turns."""
    joint.set("type", "revolute")
    if joint.find("limit") is None:
        SubElement(joint, "limit", effort="0", velocity="0")
    for limit in joint.findall("limit"):
        limit.attrib.update(lower=repr(-NO_LIMIT), upper=repr(NO_LIMIT))


def _is_readable(inertial: Element) -> bool:
    """Return whether an <inertial> has all numbers that it must have."""
    origin = inertial.find("origin")
    mass = inertial.find("mass")
    inertia = inertial.find("inertia")
    if mass is None or inertia is None:
        return False
    numbers = [mass.get("value", ""), *(inertia.get(name, "") for name in MOMENTS)]
    vectors = [] if origin is None else [origin.get(name, "0 0 0") for name in ("xyz", "rpy")]
    words = [*numbers, *(word for vector in vectors for word in vector.split())]
    return finite_numbers(words) is not None and all(len(vector.split()) == 3 for vector in vectors)


# Models written as URDF.


def model_to_urdf(model: pin.Model, label: str | Path = "pin.Model") -> str:
    """Write a Pinocchio model as URDF: links, joints with their limits, and inertias, but no shapes.

    Links take the names of the body frames of the model; other operational frames become links, too. Revolute
    joints without position limits become continuous. A composite joint becomes one joint for each of its
    parts, with "_1", "_2" appended to its name.

    Args:
        model: the model.
        label: name of the model in error messages.

    Returns:
        URDF text. Floats are preserved exactly, rotations to 1e-15.

    Raises:
        URDFError: a joint that URDF cannot represent.
    """
    robot = Element("robot", name=model.name.strip() or "robot")
    bodies = [frame for frame in model.frames if frame.type == pin.FrameType.BODY]
    named: dict[int, str] = {}
    for frame in bodies:
        if frame.parentJoint not in named and frame.placement.isIdentity(1e-12):
            named[frame.parentJoint] = frame.name
    taken = {frame.name for frame in model.frames}
    for joint in range(model.njoints):
        named.setdefault(joint, free_name(f"{model.names[joint]}_link" if joint else "world", taken))
    SubElement(robot, "link", name=named[0])
    followers = {coupling.joint: coupling for coupling in read_couplings(model)}
    for joint in range(1, model.njoints):
        if model.names[joint] in followers:
            _write_follower(robot, model, joint, named, followers[model.names[joint]])
        else:
            _write_joint(robot, model, joint, named, taken, label)
    done = set(named.values())
    for frame in model.frames:
        if frame.type in (pin.FrameType.BODY, pin.FrameType.OP_FRAME) and frame.name not in done:
            done.add(frame.name)
            SubElement(robot, "link", name=frame.name)
            parent = named[frame.parentJoint]
            fixed = f"{frame.name}_fixed"
            write_joint(robot, JointDescription.placed(fixed, "fixed", parent, frame.name, frame.placement))
    indent(robot)
    return tostring(robot, encoding="unicode") + "\n"


def _write_joint(
    robot: Element, model: pin.Model, joint: int, named: Mapping[int, str], taken: set[str], label: object
) -> None:
    """Add a joint of a model and the link it carries."""
    name = model.names[joint]
    whole = model.joints[joint]
    parts = [whole]
    placements = [pin.SE3.Identity()]
    composite = whole.shortname() == "JointModelComposite"
    if composite:
        inner = whole.extract()
        parts = list(inner.joints)
        placements = list(inner.jointPlacements)
    parent = named[model.parents[joint]]
    q = whole.idx_q
    v = whole.idx_v
    for number, (part, placement) in enumerate(zip(parts, placements, strict=True), 1):
        kind = part.shortname().removeprefix("JointModel")
        shape = {"FreeFlyer": "floating", "Planar": "planar"}.get(kind)
        if shape is None and (part.nv != 1 or kind.startswith("H")):  # helical
            allowed = "joints that turn about an axis or slide along one, free-flyers and planar joints"
            raise URDFError(str(label), f"joint {name!r}", f"is of type {kind}; allowed: {allowed}")
        last = number == len(parts)
        child = named[joint] if last else free_name(f"{named[joint]}_{number}", taken)
        link = SubElement(robot, "link", name=child)
        if last:
            write_inertial(link, RigidBody.of(model.inertias[joint]))
        before = model.jointPlacements[joint] * placement if number == 1 else placement
        called = f"{name}_{number}" if composite else name
        described = JointDescription.placed(called, shape or "", parent, child, before)
        write_joint(robot, described if shape else _driven(described, model, part, q, v))
        parent = child
        q = q + part.nq
        v = v + part.nv


def _write_follower(
    robot: Element, model: pin.Model, joint: int, named: Mapping[int, str], coupling: Coupling
) -> None:
    """Add a joint that follows another and the link it carries; the limits are those of the leader."""
    link = SubElement(robot, "link", name=named[joint])
    write_inertial(link, RigidBody.of(model.inertias[joint]))
    (axis,), (turns,) = joint_axes(model, [joint])
    ends = named[model.parents[joint]], named[joint]
    placed = JointDescription.placed(coupling.joint, "", *ends, model.jointPlacements[joint])
    free = placed.driven(axis, bool(turns), (-NO_LIMIT, NO_LIMIT), np.inf, np.inf)
    follows = Follows(coupling.leader, coupling.ratio, coupling.offset)
    kind = "revolute" if turns else "prismatic"
    write_joint(robot, replace(free, type=kind, lower=-NO_LIMIT, upper=NO_LIMIT, follows=follows))


def _driven(
    described: JointDescription, model: pin.Model, part: pin.JointModel, q: int, v: int
) -> JointDescription:
    """Return a joint with the axis and the limits of a revolute or prismatic one of a model."""
    alone = pin.Model()
    alone.addJoint(0, part, pin.SE3.Identity(), "joint")
    (axis,), (turns,) = joint_axes(alone, [1])
    edges = (-np.inf, np.inf)
    if part.nq == 1:
        edges = (float(model.lowerPositionLimit[q]), float(model.upperPositionLimit[q]))
    effort = float(model.effortLimit[v])
    return described.driven(axis, bool(turns), edges, effort, float(model.velocityLimit[v]))
