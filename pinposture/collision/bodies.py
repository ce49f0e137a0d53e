"""The bodies of an arm: solids from its collision geometry, or capsules along its links; and their masses."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any, NamedTuple, TypeAlias
from xml.etree.ElementTree import Element, tostring

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pinposture._validation import as_number, require_instance, require_known, require_positive
from pinposture.arm import Arm
from pinposture.arm.inertias import RigidBody
from pinposture.arm.kinematics import frame_ids, neutral_placements, without_repeats
from pinposture.arm.urdf import parse_xml, read_shape
from pinposture.arm.weight import Load, find_frame, rod_body
from pinposture.collision.distances import TreeKinematics
from pinposture.collision.files import find_mesh, read_mesh
from pinposture.collision.obstacles import displaced
from pinposture.collision.scene import Scene
from pinposture.collision.shapes import Box, Capsule, Cylinder, Mesh, Sphere
from pinposture.collision.solids import Solid
from pinposture.errors import FileError, InvalidValue, WeightUnknown, enumerated, warn_caller
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


_TRIANGLE = ((0, 1, 2, 0, 0, 1), (0, 1, 2, 1, 2, 2))
"""Rows and columns of the moments of a `Load`: xx, yy, zz, xy, xz, yz."""


def weigh(arm: Arm, density: float | None = None, masses: Mapping[str, float] | None = None) -> Arm:
    """Return an arm with masses for the links to which its description gives none.

    The masses that the description gives stay as they are. Parts that are fixed to a link with mass may go
    without. Shapes are those of <collision>, or of <visual> for a link without these; a mesh counts as its
    convex hull, and what two shapes share counts twice.

        arm = pp.weigh(pp.Arm.load("snake.urdf"), density=1200.0)
        arm = pp.weigh(pp.Arm.load("snake.urdf"), density=1200.0, masses={"camera": 0.08, "marker": 0.0})

    Args:
        arm: the arm.
        density: density of the shapes of links without mass [kg/m^3]; None: `masses` names all of them.
        masses: masses of some of these links [kg]; 0 for one that weighs nothing. A mass is spread over the
            shapes of its link, or without any along the line from the link to the next joint.

    Returns:
        The arm. `arm.weight.masses` lists what was found, `arm.weight.density` tells from which density.

    Raises:
        UnknownName: a link has a mass, or no joint moves it, or it does not exist.
        InvalidValue: a density that is not positive, or a negative mass.
        WeightUnknown: links without a mass and without shapes that can be read; names them.
    """
    require_instance("arm", arm, Arm, "an Arm")
    if density is not None:
        density = require_positive("density", density)
    if not isinstance(masses, Mapping | None):
        raise InvalidValue("masses", masses, "a mapping from names of links to masses [kg], or None")
    lacking = arm.links_without_mass
    known: dict[str, float] = {}
    for name, value in (masses or {}).items():
        require_known("link without a mass", name, lacking)
        known[name] = as_number(f"masses[{name!r}]", value, "a finite number >= 0 [kg]", lambda x: x >= 0.0)
    solids, faults = _solids(arm, lacking)
    added = []
    unknown: list[str] = []
    for name in lacking:
        mass = known.get(name)
        solid = solids.get(name)
        if mass is None and density is not None and solid is not None:
            added.append(_load(name, solid, density))
        elif mass is None:
            unknown.append(name)
        elif mass == 0.0:
            added.append(Load(0.0, frame=name))
        elif solid is not None:
            added.append(_load(name, solid, mass / solid.mass))
        else:
            added.append(_rod(arm, name, mass))
    weight = replace(arm.weight, masses=(*arm.weight.masses, *added), density=density)
    weighed = arm.with_weight(weight)
    unknown = [name for name in unknown if name not in weighed.parts_without_mass]
    if unknown:
        reasons = "; ".join(faults[name] for name in unknown if name in faults)
        remedy = "give a density, or their masses" if density is None else "they have no shapes: give masses"
        raise WeightUnknown("mass", unknown, f"{remedy}{f' ({reasons})' if reasons else ''}")
    return weighed


def _solids(arm: Arm, links: tuple[str, ...]) -> tuple[dict[str, pin.Inertia], dict[str, str]]:
    """Return the inertias of links of density 1, in their own frames, and why shapes cannot be read."""
    inertias: dict[str, pin.Inertia] = {}
    faults: dict[str, str] = {}
    if not links or arm.urdf is None:
        return inertias, faults
    for tag in ("collision", "visual"):
        bodies, unread = described_bodies(arm, tag, [name for name in links if name not in inertias])
        here: dict[str, pin.Inertia] = {}
        for body in bodies:
            solid = find_frame(arm.model, body.name).placement.actInv(solid_inertia(body.shape.solid()))
            here[body.name] = here[body.name] + solid if body.name in here else solid
        broken = {name: f"link {name!r}: {reason}" for name, _, reason in unread}
        faults |= broken
        inertias |= {name: solid for name, solid in here.items() if solid.mass > 0.0 and name not in broken}
    return inertias, faults


def solid_inertia(solid: Solid) -> pin.Inertia:
    """Return the inertia of a convex solid of density 1, in the frame of its coordinates."""
    geometry: Any = solid.shape
    body = RigidBody(
        float(geometry.computeVolume()),
        np.ravel(geometry.computeCOM()),
        np.array(geometry.computeMomentofInertiaRelatedToCOM()),
    )
    return pin.SE3(solid.rotation, solid.position).act(body.spatial)


def _load(name: str, solid: pin.Inertia, density: float) -> Load:
    moments = density * np.asarray(solid.inertia)[_TRIANGLE]
    return Load(density * solid.mass, tuple(solid.lever), name, tuple(moments))


def _rod(arm: Arm, name: str, mass: float) -> Load:
    """Return a mass along the line from a link without shapes to what follows it."""
    start = find_frame(arm.model, name)
    ends = [
        arm.model.jointPlacements[joint].translation
        for joint in range(1, arm.model.njoints)
        if arm.model.parents[joint] == start.parentJoint
    ]
    points = (arm.model.frames[index] for index in frame_ids(arm.model, arm.control_points))
    ends += [point.placement.translation for point in points if point.parentJoint == start.parentJoint]
    local = [start.placement.actInv(np.array(end)) for end in ends]
    far = max(local, key=lambda end: float(np.linalg.norm(end)), default=np.zeros(3))
    length = float(np.linalg.norm(far))
    body = rod_body(mass / length, np.zeros(3), far) if length > 0.0 else None
    if body is None:
        return Load(mass, frame=name)
    return Load(mass, tuple(body.center), name, tuple(body.inertia[_TRIANGLE]))
