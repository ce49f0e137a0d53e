"""The bodies of an arm: the solids that its links carry, from its collision geometry or along its links."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import NamedTuple, TypeAlias
from xml.etree.ElementTree import Element

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pinposture.arm import Arm
from pinposture.arm.urdf_reader import parse_xml
from pinposture.collision.obstacles import Box, Capsule, Cylinder, Mesh, Sphere, find_mesh, read_mesh
from pinposture.errors import FileError, InvalidValue, PostureWarning

# The collision geometry that a robot description gives its links, as solids in the frames of joints.

Array = NDArray[np.float64]


class LinkShape(NamedTuple):
    """A solid of a link.

    Attributes:
        link: name of the link.
        joint: index of the joint that carries it; 0 if none moves it.
        shape: the solid, frame of the joint [m].
    """

    link: str
    joint: int
    shape: Shape


class Fault(NamedTuple):
    """Collision geometry that cannot be had.

    Attributes:
        link: name of the link.
        joint: index of the joint that carries it.
        reason: what is wrong.
    """

    link: str
    joint: int
    reason: str


def collision_shapes(arm: Arm) -> tuple[list[LinkShape], list[Fault]]:
    """Read the <collision> elements of all links that the arm has; meshes become their convex hulls.

    Args:
        arm: an arm that was loaded from a description.

    Returns:
        The solids in the order of the text, and what is wrong with the others.
    """
    model = arm.model
    links = {frame.name: frame for frame in model.frames if frame.type == pin.FrameType.BODY}
    hulls: dict[str, Array | str] = {}
    shapes, faults = [], []
    for link in parse_xml(arm.urdf or "", "URDF text").iterfind("link"):
        name = link.get("name", "")
        if name not in links:
            continue
        frame = links[name]
        for collision in link.iterfind("collision"):
            try:
                shape = _shape(collision, frame.placement, hulls, arm.package_dirs)
                shapes.append(LinkShape(name, int(frame.parentJoint), shape))
            except (FileError, InvalidValue) as error:
                faults.append(Fault(name, int(frame.parentJoint), str(error)))
    return shapes, list(dict.fromkeys(faults))


def _shape(
    collision: Element, frame: pin.SE3, hulls: dict[str, Array | str], package_dirs: tuple[str, ...]
) -> Shape:
    origin = collision.find("origin")
    place = {} if origin is None else origin.attrib
    turn = pin.rpy.rpyToMatrix(*_numbers("origin rpy", place.get("rpy", "0 0 0"), 3))
    placement = frame * pin.SE3(turn, np.array(_numbers("origin xyz", place.get("xyz", "0 0 0"), 3)))
    center, turned = tuple(placement.translation), placement.rotation
    geometry = collision.find("geometry")
    kind = next(iter(geometry), None) if geometry is not None else None
    tag = "no geometry" if kind is None else kind.tag
    if kind is not None and tag == "sphere":
        return Sphere(center, *_numbers("radius", kind.get("radius", ""), 1))
    if kind is not None and tag in ("cylinder", "capsule"):
        (radius,), (length,) = (_numbers(key, kind.get(key, ""), 1) for key in ("radius", "length"))
        half = turned[:, 2] * length / 2.0
        ends = tuple(placement.translation - half), tuple(placement.translation + half)
        return Cylinder(*ends, radius) if tag == "cylinder" else Capsule(*ends, radius)
    if kind is not None and tag == "box":
        x, y, z = _numbers("size", kind.get("size", ""), 3)
        return Box(center, (x, y, z), turned)
    if kind is not None and tag == "mesh":
        scale = np.array(_numbers("scale", kind.get("scale", "1 1 1"), 3))
        vertices = _vertices(kind.get("filename", ""), hulls, package_dirs)
        return Mesh(vertices * scale, center, turned)
    raise InvalidValue("collision geometry", tag, "sphere, cylinder, capsule, box, mesh")


def _vertices(filename: str, hulls: dict[str, Array | str], package_dirs: tuple[str, ...]) -> Array:
    """Corners of a mesh; each file is looked for once, whether it is there or not."""
    if filename not in hulls:
        try:
            vertices, _ = read_mesh(find_mesh(filename, package_dirs))
            hulls[filename] = np.array(Mesh(vertices).vertices)  # type: ignore[arg-type]
        except FileError as error:
            hulls[filename] = error.reason
    known = hulls[filename]
    if isinstance(known, str):
        raise FileError(filename, known)
    return known


def _numbers(name: str, text: str, count: int) -> list[float]:
    try:
        numbers = [float(word) for word in text.split()]
    except ValueError:
        numbers = []
    if len(numbers) != count or not np.all(np.isfinite(numbers)):
        raise InvalidValue(name, text, "a finite number" if count == 1 else f"{count} finite numbers")
    return numbers


# Cylinders whose two ends are rounded by balls of the same radius are capsules, and their balls are spare.
#
# Snake arms are commonly described as a ball at each joint and a tube from there to the next. Together they
# are exactly a chain of capsules, which have half as many solids, and distances in closed form.

_SAME = 1e-9
"""How far apart the same point, or how different the same radius, may be, relative to the radius."""


def rounded(model: pin.Model, shapes: Sequence[LinkShape]) -> list[LinkShape]:
    """The same solid arm with capsules in place of cylinders whose ends are round, without the spare balls.

    A ball on the axis of its joint stands still when that joint turns, so it rounds the body before as well.

    Args:
        model: the arm.
        shapes: its solids.

    Returns:
        Solids with the same union at every configuration, in the same order.
    """
    if not any(isinstance(shape, Cylinder) for _, _, shape in shapes):
        return list(shapes)
    postures = _two_postures(model)
    balls = [
        (place, joint, shape.radius, index)
        for index, (_, at, shape) in enumerate(shapes)
        if isinstance(shape, Sphere)
        for joint, place in _resting_places(model, at, shape, postures)
    ]
    merged, spare = list(shapes), set[int]()
    for index, (link, joint, shape) in enumerate(shapes):
        if not isinstance(shape, Cylinder):
            continue
        near = _SAME * shape.radius
        ends = [
            [
                ball
                for place, at, radius, ball in balls
                if at == joint and abs(radius - shape.radius) <= near and np.abs(place - end).max() <= near
            ]
            for end in (shape.start, shape.end)
        ]
        if all(ends):
            merged[index] = LinkShape(link, joint, Capsule(shape.start, shape.end, shape.radius))
            spare.update(ends[0] + ends[1])
    return [shape for index, shape in enumerate(merged) if index not in spare]


def _resting_places(
    model: pin.Model, joint: int, ball: Sphere, postures: Sequence[list[pin.SE3]]
) -> list[tuple[int, Array]]:
    """Where a ball is in the frame of its joint, and of those before in whose frames it never moves."""
    place = np.array(ball.center)
    places = [(joint, place)]
    while joint > 0:
        one, other = (posture[joint].act(place) for posture in postures)
        if np.abs(one - other).max() > _SAME * ball.radius:
            break
        joint, place = int(model.parents[joint]), one
        places.append((joint, place))
    return places


def _two_postures(model: pin.Model) -> list[list[pin.SE3]]:
    """Placement of each joint in the frame of the one before, with all joints at zero, and all at one."""
    at = pin.neutral(model)
    postures = []
    for q in (at, pin.integrate(model, at, np.ones(model.nv))):
        placements = [pin.SE3.Identity()]
        for joint in range(1, model.njoints):  # one by one: a pin.Data is huge for long arms
            moved = model.joints[joint].createData()
            model.joints[joint].calc(moved, q)
            placements.append(model.jointPlacements[joint] * moved.M)
        postures.append(placements)
    return postures


# The bodies of an arm: the solids that its joints carry, each in the frame of its joint.
#
# They are the collision geometry of the description that an arm was loaded from. Where it gives none, they
# are capsules along the links, from joint to joint and to the tip.

Shape: TypeAlias = "Sphere | Capsule | Cylinder | Box | Mesh"

THICKNESS = 0.1
"""Radius of the stand-in capsules, relative to the mean length of a module."""
_LISTED = 12  # faults that a warning names before it only counts them


class Body(NamedTuple):
    """A solid that one joint carries.

    Attributes:
        name: name of its link, or of its joint if it is a stand-in.
        joint: index of the joint in the model; 0 if no joint moves it.
        shape: the solid, frame of the joint [m].
    """

    name: str
    joint: int
    shape: Shape


def bodies_of(arm: Arm, arm_radius: float | None = None) -> tuple[Body, ...]:
    """The bodies of an arm.

    Args:
        arm: the arm.
        arm_radius: radius of capsules that stand in for whatever the description says [m]; if None, that.

    Returns:
        The bodies, from base to tip. Links whose meshes are missing, or whose geometry makes no solid, have
        stand-ins, and one `PostureWarning` names them all. If the description gives geometry to none of the
        links that move, all of these have stand-ins.
    """
    radius = THICKNESS * float(arm.chain.module_lengths.mean()) if arm_radius is None else arm_radius
    standing_in = stand_ins(arm, radius)
    if arm_radius is not None or arm.urdf is None or "<collision" not in arm.urdf:
        return tuple(body for listed in standing_in.values() for body in listed)
    shapes, faults = collision_shapes(arm)
    listed = [Body(link, joint, shape) for link, joint, shape in rounded(arm.model, shapes)]
    lacking = list(dict.fromkeys(joint for _, joint, _ in faults))
    if not any(lacking) and not any(joint for _, joint, _ in shapes):  # geometry of the base alone
        lacking = list(standing_in)
    for joint in lacking:
        listed.extend(standing_in.get(joint, ()))
    if faults:
        named = [f"link {link!r}: {reason}" for link, _, reason in faults[:_LISTED]]
        if len(faults) > _LISTED:
            named.append(f"and {len(faults) - _LISTED} more")
        message = f"capsules stand in for collision geometry that is not to be had: {'; '.join(named)}"
        warnings.warn(message, PostureWarning, stacklevel=2)
    return tuple(sorted(listed, key=lambda body: body.joint))


def stand_ins(arm: Arm, radius: float) -> Mapping[int, tuple[Body, ...]]:
    """Capsules from each joint by way of its control point, if it carries one, to the next, or to the tip.

    A joint that slides has its capsule reach back as far as it can slide out, so that no gap opens.

    Args:
        arm: the arm.
        radius: radius of the capsules [m].

    Returns:
        The capsules by the index of the joint that carries them, from base to tip.
    """
    model, chain = arm.model, arm.chain
    places = _neutral_placements(model)
    ends = {joints.stop - 1: k for k, joints in enumerate(chain.module_slices)}
    listed: dict[int, tuple[Body, ...]] = {}
    for u, origin in enumerate(chain.origins):
        nodes = [origin]
        reach = arm.limits.upper[chain.columns[u]]
        if not chain.revolute[u] and 0.0 < reach < 10.0 * arm.length:
            nodes.insert(0, origin - reach * chain.axes[u])
        if u in ends:
            nodes.append(chain.points[ends[u]])
        if u + 1 < len(chain.origins):
            nodes.append(chain.origins[u + 1])
        joint = model.getJointId(chain.joints[u])
        here = places[joint].inverse()
        local = [here.act(node) for node in _distinct(nodes, 1e-6 * arm.length)]
        listed[joint] = tuple(
            Body(chain.joints[u], joint, Capsule(tuple(a), tuple(b), radius)) for a, b in pairwise(local)
        )
    return listed


def _neutral_placements(model: pin.Model) -> list[pin.SE3]:
    """Where the joints are in the world at the neutral configuration, where each of them is the identity."""
    places = [pin.SE3.Identity()]
    for joint in range(1, model.njoints):
        places.append(places[model.parents[joint]] * model.jointPlacements[joint])
    return places


def _distinct(nodes: list[Array], apart: float) -> list[Array]:
    """The nodes without those that repeat the one before."""
    kept = [nodes[0]]
    for node in nodes[1:]:
        if np.linalg.norm(node - kept[-1]) > apart:
            kept.append(node)
    return kept
