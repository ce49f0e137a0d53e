"""The bodies of an arm: solids from its collision geometry, or capsules along its links."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple, TypeAlias
from xml.etree.ElementTree import Element, tostring

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pinposture.arm import Arm
from pinposture.arm.kinematics import neutral_placements, without_repeats
from pinposture.arm.urdf import parse_xml, read_shape
from pinposture.arm.weight import find_frame
from pinposture.collision.distances import TreeKinematics
from pinposture.collision.files import find_mesh, read_mesh
from pinposture.collision.obstacles import displaced
from pinposture.collision.scene import Scene
from pinposture.collision.shapes import Box, Capsule, Cylinder, Mesh, Sphere
from pinposture.errors import FileError, InvalidValue, enumerated, warn_caller
from pinposture.units import ROUNDING, length_text

Array = NDArray[np.float64]
Shape: TypeAlias = "Sphere | Capsule | Cylinder | Box | Mesh"
Fault: TypeAlias = tuple[str, int, str]
"""Name of a link with unusable geometry, index of the joint that carries it, and the reason."""

STAND_IN_RADIUS = 0.1  # radius of the stand-in capsules, relative to the mean length of a module


class Body(NamedTuple):
    """A solid that one joint carries.

    Attributes:
        name: name of its link, or of its joint for a stand-in.
        joint: index of the joint in the model; 0 if no joint moves it.
        shape: the solid, in the joint frame [m].
    """

    name: str
    joint: int
    shape: Shape


def carried_bodies(arm: Arm, scene: Scene) -> tuple[Body, ...]:
    """Return the obstacles that an arm carries, named as in the scene.

    Raises:
        UnknownName: the arm has no such frame.
    """
    bodies = []
    for name, carried in scene.carried.items():
        frame = find_frame(arm.model, carried.frame)
        held = displaced(scene.obstacles[name], frame.placement * carried.placement.inverse())
        bodies.append(Body(name, int(frame.parentJoint), held.geometry))
    return tuple(bodies)


def frame_pose(arm: Arm, q: Array, name: str) -> pin.SE3:
    """Return the pose of a link, a control point or a joint at a configuration, (nq,).

    Raises:
        UnknownName: the arm has no such frame.
    """
    return TreeKinematics(arm.model).frame_pose(q, name)  # a `pin.Data` of a long arm takes 30 ms


def scene_at(arm: Arm, q: Array, scene: Scene) -> Scene:
    """Return a scene at a configuration, (nq,): what the arm carries stands where the arm has it.

    Raises:
        UnknownName: the arm has no frame of a name.
    """
    if not scene.carried:
        return scene
    obstacles = dict(scene.obstacles)
    for name, carried in scene.carried.items():
        moved = frame_pose(arm, q, carried.frame) * carried.placement.inverse()
        obstacles[name] = displaced(scene.first.obstacles[name], moved)
    return replace(scene, obstacles=obstacles, carried={})


def bodies_of(arm: Arm, arm_radius: float | None = None) -> tuple[Body, ...]:
    """Return the bodies of an arm, ordered from base to tip.

    Args:
        arm: the arm.
        arm_radius: radius of stand-in capsules for all links [m]; None: use the geometry of the description.

    Returns:
        The bodies. Links with missing meshes or invalid geometry get stand-ins, and one `PostureWarning`
        names them all. If no moving link has geometry in the description, all moving links get stand-ins.
    """
    if arm_radius is not None or arm.urdf is None or "<collision" not in arm.urdf:
        return tuple(body for bodies in _stand_ins(arm, arm_radius).values() for body in bodies)
    described, faults = described_bodies(arm)
    bodies = _merge_capsules(arm.model, described)
    lacking = list(dict.fromkeys(joint for _, joint, _ in faults))
    base_alone = not any(lacking) and not any(body.joint for body in described)
    if lacking or base_alone:
        stand_ins = _stand_ins(arm)
        for joint in stand_ins if base_alone else lacking:
            bodies.extend(stand_ins.get(joint, ()))
    wide = [
        (float(np.ptp(body.shape.vertices, axis=0).max()), body.name)
        for body in described
        if body.joint and isinstance(body.shape, Mesh)
    ]
    if wide and (widest := max(wide))[0] > 10.0 * arm.length:  # probably in millimetres
        size = f"{length_text(widest[0])} wide, {widest[0] / arm.length:.3g} times as long as the arm"
        advice = 'if it is in millimetres, the description needs <mesh scale="0.001 0.001 0.001">'
        warn_caller(f"the collision mesh of link {widest[1]!r} is {size}; {advice}")
    if faults:
        named = enumerated((f"link {link!r}: {why}" for link, _, why in faults), between="; ")
        warn_caller(f"capsules stand in for unusable collision geometry: {named}")
    return tuple(sorted(bodies, key=lambda body: body.joint))


def described_bodies(
    arm: Arm, tag: str = "collision", names: Collection[str] | None = None
) -> tuple[list[Body], list[Fault]]:
    """Read the shapes of an arm's links, in document order.

    Args:
        arm: the arm.
        tag: "collision" or "visual".
        names: the links; None: all.

    Returns:
        The bodies, and what cannot be read.
    """
    links = {frame.name: frame for frame in arm.model.frames if frame.type == pin.FrameType.BODY}
    hulls: dict[str, Array | str] = {}
    known: dict[tuple[bytes, bytes], Shape] = {}  # shapes of links are often alike
    bodies = []
    faults = []
    for link in parse_xml(arm.urdf or "", "URDF text").iterfind("link"):
        name = link.get("name", "")
        if name not in links or (names is not None and name not in names):
            continue
        frame = links[name]
        for element in link.iterfind(tag):
            same = tostring(element), frame.placement.homogeneous.tobytes()
            try:
                if same not in known:
                    known[same] = _read_shape(element, frame.placement, hulls, arm.package_dirs)
                bodies.append(Body(name, int(frame.parentJoint), known[same]))
            except (FileError, InvalidValue) as error:
                faults.append((name, int(frame.parentJoint), str(error)))
    return bodies, list(dict.fromkeys(faults))


def _read_shape(
    collision: Element, frame: pin.SE3, hulls: dict[str, Array | str], package_dirs: tuple[str, ...]
) -> Shape:
    described = read_shape(collision)
    placement = frame * described.placement
    numbers = described.numbers
    center = tuple(placement.translation)
    rotation = placement.rotation
    if described.kind == "sphere":
        return Sphere(center, *numbers["radius"])
    if described.kind in ("cylinder", "capsule"):
        (length,) = numbers["length"]
        half = rotation[:, 2] * length / 2.0
        ends = tuple(placement.translation - half), tuple(placement.translation + half)
        return (Cylinder if described.kind == "cylinder" else Capsule)(*ends, *numbers["radius"])
    if described.kind == "box":
        x, y, z = numbers["size"]
        return Box(center, (x, y, z), rotation)
    return Mesh(_hull(described.file, hulls, package_dirs) * np.array(numbers["scale"]), center, rotation)


def _hull(filename: str, hulls: dict[str, Array | str], package_dirs: tuple[str, ...]) -> Array:
    """Return the vertices of a mesh's hull; `hulls` caches them, or the reason for failure, by file."""
    if filename not in hulls:
        try:
            vertices, _ = read_mesh(find_mesh(filename, package_dirs))
            hulls[filename] = Mesh(vertices).vertices
        except FileError as error:
            hulls[filename] = error.reason
    known = hulls[filename]
    if isinstance(known, str):
        raise FileError(filename, known)
    return known


def _merge_capsules(model: pin.Model, bodies: Sequence[Body]) -> list[Body]:
    """Replace each cylinder that has a sphere of equal radius at both ends by a capsule; drop the spheres.

    Snake arms are often described as a sphere at each joint and a tube to the next. Capsules halve the number
    of solids and have closed-form distances. A sphere on the axis of a joint does not move when that joint
    turns, so it can also round the end of the preceding body. The union is the same in every posture.
    """
    if not any(isinstance(body.shape, Cylinder) for body in bodies):
        return list(bodies)
    postures = _two_postures(model)
    balls = [
        (center, joint, body.shape.radius, index)
        for index, body in enumerate(bodies)
        if isinstance(body.shape, Sphere)
        for joint, center in _fixed_centers(model, body.joint, body.shape, postures)
    ]
    merged = list(bodies)
    dropped = set[int]()
    for index, (name, joint, shape) in enumerate(bodies):
        if not isinstance(shape, Cylinder):
            continue
        near = ROUNDING * shape.radius
        ends = [
            [
                ball
                for center, at, radius, ball in balls
                if at == joint and abs(radius - shape.radius) <= near and np.abs(center - end).max() <= near
            ]
            for end in (shape.start, shape.end)
        ]
        if all(ends):
            merged[index] = Body(name, joint, Capsule(shape.start, shape.end, shape.radius))
            dropped.update(ends[0] + ends[1])
    return [body for index, body in enumerate(merged) if index not in dropped]


def _fixed_centers(
    model: pin.Model, joint: int, ball: Sphere, postures: Sequence[list[pin.SE3]]
) -> list[tuple[int, Array]]:
    """Return the centre of a sphere in its joint frame and in the ancestor frames in which it is fixed."""
    center = np.array(ball.center)
    centers = [(joint, center)]
    while joint > 0:
        one, other = (posture[joint].act(center) for posture in postures)
        if np.abs(one - other).max() > ROUNDING * ball.radius:
            break
        joint = int(model.parents[joint])
        center = one
        centers.append((joint, center))
    return centers


def _two_postures(model: pin.Model) -> list[list[pin.SE3]]:
    """Return the placements of the joints in their parent frames, with all positions 0 and with all 1."""
    neutral = pin.neutral(model)
    postures = []
    for q in (neutral, pin.integrate(model, neutral, np.ones(model.nv))):
        placements = [pin.SE3.Identity()]
        for joint in range(1, model.njoints):  # joint by joint: pin.Data is huge for long arms
            data = model.joints[joint].createData()
            model.joints[joint].calc(data, q)
            placements.append(model.jointPlacements[joint] * data.M)
        postures.append(placements)
    return postures


def _stand_ins(arm: Arm, radius: float | None = None) -> Mapping[int, tuple[Body, ...]]:
    """Return stand-in capsules by joint index, each past its control point to the next joint or the tip.

    The capsule of a prismatic joint reaches back by the joint's upper limit, so that no gap opens.

    Args:
        arm: the arm.
        radius: their radius [m]; None: `STAND_IN_RADIUS`.
    """
    if radius is None:
        radius = STAND_IN_RADIUS * float(arm.chain.module_lengths.mean())
    model = arm.model
    chain = arm.chain
    frames = neutral_placements(arm.model)
    ends = {joints.stop - 1: k for k, joints in enumerate(chain.module_slices)}
    capsules: dict[int, tuple[Body, ...]] = {}
    for u, origin in enumerate(chain.origins):
        nodes = [origin]
        reach = chain.ratios[u] * arm.limits.upper[chain.columns[u]]
        if not chain.revolute[u] and 0.0 < reach < 10.0 * arm.length:
            nodes.insert(0, origin - reach * chain.axes[u])
        if u in ends:
            nodes.append(chain.points[ends[u]])
        if u + 1 < len(chain.origins):
            nodes.append(chain.origins[u + 1])
        name = chain.joints[u]
        joint = model.getJointId(chain.joints[u])
        to_joint = frames[joint].inverse()
        local = [to_joint.act(node) for node in without_repeats(np.array(nodes), 1e-6 * arm.length)]
        capsules[joint] = tuple(
            Body(name, joint, Capsule(tuple(a), tuple(b), radius)) for a, b in pairwise(local)
        )
    return capsules
