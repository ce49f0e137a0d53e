"""Writing of URDF: a Pinocchio model, and the elements that descriptions in other formats become."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from pinposture.arm.configurations import NO_LIMIT
from pinposture.arm.couplings import Coupling, joint_axes, read_couplings
from pinposture.arm.specification import roll_pitch_yaw
from pinposture.errors import URDFError

_SHAPES = {"FreeFlyer": "floating", "Planar": "planar"}


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
    robot = ET.Element("robot", name=model.name.strip() or "robot")
    bodies = [frame for frame in model.frames if frame.type == pin.FrameType.BODY]
    named: dict[int, str] = {}
    for frame in bodies:
        if frame.parentJoint not in named and frame.placement.isIdentity(1e-12):
            named[frame.parentJoint] = frame.name
    taken = {frame.name for frame in model.frames}
    for joint in range(model.njoints):
        named.setdefault(joint, free_name(f"{model.names[joint]}_link" if joint else "world", taken))
    ET.SubElement(robot, "link", name=named[0])
    followers = {each.joint: each for each in read_couplings(model)}
    for joint in range(1, model.njoints):
        if model.names[joint] in followers:
            _write_follower(robot, model, joint, named, followers[model.names[joint]])
        else:
            _write_joint(robot, model, joint, named, taken, label)
    done = set(named.values())
    for frame in model.frames:
        if frame.type in (pin.FrameType.BODY, pin.FrameType.OP_FRAME) and frame.name not in done:
            done.add(frame.name)
            ET.SubElement(robot, "link", name=frame.name)
            parent = named[frame.parentJoint]
            add_joint(robot, f"{frame.name}_fixed", "fixed", parent, frame.name, frame.placement)
    ET.indent(robot)
    return ET.tostring(robot, encoding="unicode") + "\n"


def _write_joint(
    robot: ET.Element, model: pin.Model, joint: int, named: Mapping[int, str], taken: set[str], label: object
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
        shape = _SHAPES.get(kind)
        if shape is None and (part.nv != 1 or kind.startswith("H")):  # helical
            allowed = "joints that turn about an axis or slide along one, free-flyers and planar joints"
            raise URDFError(str(label), f"joint {name!r}", f"is of type {kind}; allowed: {allowed}")
        last = number == len(parts)
        child = named[joint] if last else free_name(f"{named[joint]}_{number}", taken)
        link = ET.SubElement(robot, "link", name=child)
        if last:
            add_inertia(link, model.inertias[joint])
        before = model.jointPlacements[joint] * placement if number == 1 else placement
        called = f"{name}_{number}" if composite else name
        element = add_joint(robot, called, shape or "continuous", parent, child, before)
        if shape is None:
            _add_motion(element, model, part, q, v)
        parent = child
        q = q + part.nq
        v = v + part.nv


def _write_follower(
    robot: ET.Element, model: pin.Model, joint: int, named: Mapping[int, str], coupling: Coupling
) -> None:
    """Add a joint that follows another and the link it carries; the limits are those of the leader."""
    link = ET.SubElement(robot, "link", name=named[joint])
    add_inertia(link, model.inertias[joint])
    (axis,), (turns,) = joint_axes(model, [joint])
    ends = named[model.parents[joint]], named[joint], model.jointPlacements[joint]
    element = add_joint(robot, coupling.joint, "revolute" if turns else "prismatic", *ends)
    ET.SubElement(element, "axis", xyz=numbers_text(axis))
    none = {"effort": repr(NO_LIMIT), "velocity": repr(NO_LIMIT)}
    ET.SubElement(element, "limit", none, lower=repr(-NO_LIMIT), upper=repr(NO_LIMIT))
    follows = {"multiplier": repr(coupling.ratio), "offset": repr(coupling.offset)}
    ET.SubElement(element, "mimic", follows, joint=coupling.leader)


def _add_motion(element: ET.Element, model: pin.Model, part: pin.JointModel, q: int, v: int) -> None:
    """Add the axis and the limits of a revolute or prismatic joint of a model."""
    alone = pin.Model()
    alone.addJoint(0, part, pin.SE3.Identity(), "joint")
    axes, revolute = joint_axes(alone, [1])
    edges = (-math.inf, math.inf)
    if part.nq == 1:
        edges = (float(model.lowerPositionLimit[q]), float(model.upperPositionLimit[q]))
    add_motion(
        element,
        axis=axes[0],
        turns=bool(revolute[0]),
        edges=edges,
        effort=float(model.effortLimit[v]),
        velocity=float(model.velocityLimit[v]),
    )


def add_motion(
    element: ET.Element,
    axis: ArrayLike,
    turns: bool,
    edges: tuple[float, float],
    effort: float,
    velocity: float,
) -> None:
    """Add the axis and the limits of a joint, and set its type.

    Args:
        element: the <joint>.
        axis: unit vector in the frame of the joint, (3,).
        turns: whether it turns about the axis; otherwise it slides along it.
        edges: smallest and largest position [rad or m]; infinite without a limit.
        effort: largest torque or force [N m or N]; 0 or infinite if unknown.
        velocity: largest speed [rad/s or m/s]; infinite if unknown.
    """
    ET.SubElement(element, "axis", xyz=numbers_text(axis))
    lower, upper = np.clip(edges, -NO_LIMIT, NO_LIMIT)
    limited = lower > -NO_LIMIT or upper < NO_LIMIT
    kind = "revolute" if turns else "prismatic"
    element.set("type", kind if limited or not turns else "continuous")
    limits = {"lower": numbers_text([lower]), "upper": numbers_text([upper])} if limited else {}
    limits["effort"] = repr(effort if 0.0 < effort < NO_LIMIT else NO_LIMIT)
    limits["velocity"] = repr(velocity if 0.0 <= velocity < NO_LIMIT else NO_LIMIT)
    ET.SubElement(element, "limit", limits)


def add_joint(
    robot: ET.Element, name: str, kind: str, parent: str, child: str, placement: pin.SE3
) -> ET.Element:
    """Add a joint between two links, at its placement in the frame of the first."""
    element = ET.SubElement(robot, "joint", name=name, type=kind)
    ET.SubElement(element, "parent", link=parent)
    ET.SubElement(element, "child", link=child)
    add_origin(element, placement)
    return element


def add_origin(element: ET.Element, placement: pin.SE3) -> None:
    """Add the placement of a joint or a shape."""
    angles = roll_pitch_yaw(placement.rotation)
    ET.SubElement(element, "origin", xyz=numbers_text(placement.translation), rpy=numbers_text(angles))


def add_inertia(link: ET.Element, inertia: pin.Inertia) -> None:
    """Add the mass, its centre and the moments of inertia of a link, if it has a mass."""
    if inertia.mass <= 0.0:
        return
    element = ET.SubElement(link, "inertial")
    ET.SubElement(element, "origin", xyz=numbers_text(inertia.lever))
    ET.SubElement(element, "mass", value=repr(float(inertia.mass)))
    moments = np.asarray(inertia.inertia)
    named = {f"i{'xyz'[i]}{'xyz'[j]}": repr(float(moments[i, j])) for i in range(3) for j in range(i, 3)}
    ET.SubElement(element, "inertia", named)


def free_name(name: str, taken: set[str]) -> str:
    """Return a name that is not taken, with underscores if it is, and take it."""
    while name in taken:
        name += "_"
    taken.add(name)
    return name


def numbers_text(values: Any) -> str:
    """Return numbers in a form that preserves them exactly."""
    return " ".join(repr(float(value)) for value in values)
