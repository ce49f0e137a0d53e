"""The bodies of an arm as they are drawn: along its links, or the meshes of its description."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from pinposture.arm import Arm
from pinposture.arm.urdf_reader import parse_xml
from pinposture.collision.obstacles import find_mesh, read_mesh
from pinposture.collision.scan import between_cubes, representatives
from pinposture.errors import FileError, PostureWarning
from pinposture.viz.mesh import TriangleMesh, merge

# Shape and pose of each body.

Array = NDArray[np.float64]


class DrawnBody(NamedTuple):
    """What one joint of the chain moves, as a broken line.

    The frame of a body has its origin at the joint and, at the neutral configuration, the axes of the world.

    Attributes:
        joint: name of the joint.
        module: index of the module that it belongs to, 0-based.
        nodes: from the joint by way of the control point, if one is fixed to the body, to the next joint,
            (p, 3) [m], body frame.
        point: the control point fixed to the body, (3,) [m], body frame; None if there is none.
        slide: how far back the joint may reach along its axis, (3,) [m], body frame; zero if it turns.
    """

    joint: str
    module: int
    nodes: Array
    point: Array | None
    slide: Array


def bodies(arm: Arm) -> tuple[DrawnBody, ...]:
    """The moving bodies of an arm, from base to tip, one for each joint of the chain."""
    chain = arm.chain
    ends = {joints.stop - 1: k for k, joints in enumerate(chain.module_slices)}
    modules = np.repeat(np.arange(arm.n_modules), [len(joints) for joints in arm.module_joints])
    listed = []
    for u, origin in enumerate(chain.origins):
        nodes, point = [np.zeros(3)], None
        if u in ends:
            point = chain.points[ends[u]] - origin
            nodes.append(point)
        if u + 1 < len(chain.origins):
            nodes.append(chain.origins[u + 1] - origin)
        reach = arm.limits.upper[chain.columns[u]]
        # Models made by hand have the largest number there is for a limit where there is none.
        slides = not chain.revolute[u] and 0.0 < reach < 10.0 * arm.length
        slide = -reach * chain.axes[u] if slides else np.zeros(3)
        listed.append(DrawnBody(chain.joints[u], int(modules[u]), _distinct(nodes, arm.length), point, slide))
    return tuple(listed)


def body_poses(arm: Arm, q: ArrayLike) -> Array:
    """Where the bodies are, by the product of exponentials of the joint screws.

    Args:
        arm: the arm.
        q: a configuration (nq,), or several (f, nq) [rad or m].

    Returns:
        Homogeneous transforms from body to world frame, (n, 4, 4), or (f, n, 4, 4) [m].

    Raises:
        InvalidValue: a configuration of the wrong size, or not finite.
    """
    several = np.ndim(q) > 1
    rows = q if several else [q]
    positions = np.array([arm.positions(row) for row in np.asarray(rows, dtype=np.float64)])  # (f, nv)
    chain = arm.chain
    poses = np.zeros((len(positions), len(chain.joints), 4, 4))
    poses[..., 3, 3] = 1.0
    # (f, n, 3, 3), all at once: one by one they take longer than everything else here
    vectors = (positions[:, chain.columns, None] * chain.axes).reshape(-1, 3)
    turns = Rotation.from_rotvec(vectors).as_matrix().reshape(len(positions), -1, 3, 3)
    turn = np.broadcast_to(np.eye(3), (len(positions), 3, 3))
    shift = np.zeros((len(positions), 3))
    for u, (axis, origin) in enumerate(zip(chain.axes, chain.origins, strict=True)):
        # The joint stands where the bodies before it carry its neutral place: p = R origin + shift.
        place = turn @ origin + shift
        if chain.revolute[u]:
            turn = turn @ turns[:, u]
        else:
            amount = positions[:, chain.columns[u], None] * axis  # (f, 3)
            place = place + np.einsum("fij,fj->fi", turn, amount)
        shift = place - turn @ origin
        poses[:, u, :3, :3], poses[:, u, :3, 3] = turn, place
    return poses if several else poses[0]


def backbone(arm: Arm, q: ArrayLike) -> Array:
    """The broken line from the base through joints and control points to the tip at a configuration.

    Args:
        arm: the arm.
        q: configuration, (nq,) [rad or m].

    Returns:
        Array (p, 3) [m], world frame.

    Raises:
        InvalidValue: a configuration of the wrong size, or not finite.
    """
    stations = [arm.chain.base[None]]
    for body, pose in zip(bodies(arm), body_poses(arm, q), strict=True):
        stations.append(body.nodes @ pose[:3, :3].T + pose[:3, 3])
    return np.vstack(stations)


def _distinct(nodes: list[Array], length: float) -> Array:
    """The nodes without those that repeat the one before."""
    kept = [nodes[0]]
    for node in nodes[1:]:
        if np.linalg.norm(node - kept[-1]) > 1e-9 * length:
            kept.append(node)
    return np.array(kept)


# Visual meshes. Only drawing reads them: a body whose mesh is missing or cannot be read is drawn as bars.

MOST_TRIANGLES = 200_000
"""Triangles of all meshes together that are drawn at most, for a browser to turn them smoothly."""

_LISTED = 12  # files that a warning names before it only counts them


class VisualMesh(NamedTuple):
    """A mesh as a description mentions it.

    Attributes:
        link: name of the link.
        filename: as written: "package://name/rest", "file:///...", or a path.
        scale: factors along the axes of the mesh, (3,).
        placement: from the frame of the mesh to that of the link [m].
    """

    link: str
    filename: str
    scale: Array
    placement: pin.SE3


class BodyMeshes(NamedTuple):
    """What to draw in place of the stand-in shapes; None where those stay.

    Attributes:
        base: the links that never move, world frame [m].
        bodies: one entry for each joint of the chain, from base to tip, body frame [m]: the origin is at the
            joint and, at the neutral configuration, the axes are those of the world.
    """

    base: TriangleMesh | None
    bodies: tuple[TriangleMesh | None, ...]


def body_meshes(arm: Arm, most_triangles: int = MOST_TRIANGLES) -> BodyMeshes:
    """Read the visual meshes of an arm, merged to one surface for each body.

    Bodies with most triangles are drawn coarser where there are too many in all for a browser to turn them
    smoothly. A `PostureWarning`, one for all, names their files, and those that are missing or cannot be
    read.

    Args:
        arm: the arm; one that was not loaded from a description has no meshes.
        most_triangles: triangles of all meshes together that are accepted.
    """
    joints = arm.chain.joints
    # Place of a body's joint in the chain by the number that the model gives it; the base is last.
    owners = {arm.model.getJointId(name): u for u, name in enumerate(joints)} | {0: len(joints)}
    origins = np.vstack([arm.chain.origins, np.zeros(3)])
    parts: dict[int, list[TriangleMesh]] = {}
    files: dict[int, list[str]] = {}
    surfaces: dict[str, TriangleMesh] = {}
    faults: dict[str, str] = {}
    mentioned = visual_meshes(arm)
    links = _links(arm) if mentioned else {}
    for visual in mentioned:
        joint, link = links.get(visual.link, (-1, pin.SE3.Identity()))
        if joint not in owners:
            continue
        owner, name = owners[joint], visual.filename
        try:
            if name not in faults and name not in surfaces:
                surfaces[name] = TriangleMesh(*read_mesh(find_mesh(name, arm.package_dirs)))
            if name in surfaces:
                placed = _placed(surfaces[name], visual, link, origins[owner])
                parts.setdefault(owner, []).append(placed)
                files.setdefault(owner, []).append(name)
        except FileError as error:
            faults[name] = error.reason
    merged = {owner: merge(listed) for owner, listed in parts.items()}
    total = sum(len(mesh.faces) for mesh in merged.values())
    most = _most_of_a_body([len(mesh.faces) for mesh in merged.values()], most_triangles)
    many = f"all meshes together having {total} triangles, more than {most_triangles}"
    for owner in [owner for owner, mesh in merged.items() if len(mesh.faces) > most]:
        thinned = _decimated(merged.pop(owner), most)
        if thinned is not None:
            merged[owner] = thinned
        how = "is left out" if thinned is None else f"is drawn with {len(thinned.faces)} triangles"
        faults.update(dict.fromkeys(files[owner], f"{how}, {many}"))
    if faults:
        warnings.warn(_warning_text(faults), PostureWarning, stacklevel=2)
    return BodyMeshes(merged.get(len(joints)), tuple(merged.get(u) for u in range(len(joints))))


def visual_meshes(arm: Arm) -> list[VisualMesh]:
    """The meshes that the description of an arm mentions, in the order of the text; nothing is read."""
    if arm.urdf is None or "<mesh" not in arm.urdf:
        return []
    listed = []
    for link in parse_xml(arm.urdf, "URDF text").iterfind("link"):
        for visual in link.iterfind("visual"):
            mesh, origin = visual.find("geometry/mesh"), visual.find("origin")
            if mesh is None:
                continue
            place = {} if origin is None else origin.attrib
            turn = pin.rpy.rpyToMatrix(_three_numbers(place.get("rpy", "0 0 0")))
            placement = pin.SE3(turn, _three_numbers(place.get("xyz", "0 0 0")))
            scale = _three_numbers(mesh.get("scale", "1 1 1"))
            listed.append(VisualMesh(link.get("name", ""), mesh.get("filename", ""), scale, placement))
    return listed


def _placed(mesh: TriangleMesh, visual: VisualMesh, link: pin.SE3, origin: Array) -> TriangleMesh:
    """A mesh in the frame of its body, given the link in the world at the neutral configuration."""
    pose = link * visual.placement
    with np.errstate(all="ignore"):  # what is not finite is refused below
        vertices = (mesh.vertices * visual.scale) @ pose.rotation.T + (pose.translation - origin)
    if not np.all(np.isfinite(vertices)):
        raise FileError(visual.filename, "has vertices, a scale or an origin that are no finite numbers")
    # A mirrored triangle would show its back.
    return TriangleMesh(vertices, mesh.faces[:, ::-1] if np.prod(visual.scale) < 0.0 else mesh.faces)


def joint_placements(arm: Arm) -> list[pin.SE3]:
    """Where the joints of the model are in the world at the neutral configuration, the universe first."""
    # Every joint of a chain is the identity there, so this needs no pin.Data, which is huge for long arms.
    model, places = arm.model, [pin.SE3.Identity()]
    for joint in range(1, model.njoints):
        places.append(places[model.parents[joint]] * model.jointPlacements[joint])
    return places


def _links(arm: Arm) -> dict[str, tuple[int, pin.SE3]]:
    """The joint that moves each link, and where the link is in the world at the neutral configuration."""
    places = joint_placements(arm)
    frames = [frame for frame in arm.model.frames if frame.type == pin.FrameType.BODY]
    # Links that never move are placed relative to the root link, the first, which stands where the base is.
    places[0] = arm.base_placement * frames[0].placement.inverse()
    return {
        frame.name: (int(frame.parentJoint), places[frame.parentJoint] * frame.placement) for frame in frames
    }


def _most_of_a_body(counts: Sequence[int], most_triangles: int) -> int:
    """How many triangles a body may have, so that all together have few enough."""
    left, bodies = most_triangles, len(counts)
    for count in sorted(counts):
        if count * bodies > left:
            return left // bodies
        left, bodies = left - count, bodies - 1
    return most_triangles


def _decimated(mesh: TriangleMesh, most: int) -> TriangleMesh | None:
    """The mesh with at most so many triangles, close corners made one; None if no triangle would be left."""
    points = min(most, len(mesh.vertices) - 1)
    while points > 2:
        kept, cubes = representatives(mesh.vertices, points)
        faces = between_cubes(mesh.faces, cubes)
        if 0 < len(faces) <= most:
            return TriangleMesh(mesh.vertices[kept], faces)
        points //= 2
    return None


def _warning_text(faults: Mapping[str, str]) -> str:
    named = [f"{name} {reason}" for name, reason in list(faults.items())[:_LISTED]]
    if len(faults) > _LISTED:
        named.append(f"and {len(faults) - _LISTED} more")
    return f"links are not drawn as their meshes have them: {'; '.join(named)}"


def _three_numbers(text: str) -> Array:
    """Three numbers; not a number, which is noticed later, if the text is something else."""
    try:
        numbers = np.array([float(word) for word in text.split()])
    except ValueError:
        numbers = np.empty(0)
    return numbers if numbers.shape == (3,) else np.full(3, np.nan)
