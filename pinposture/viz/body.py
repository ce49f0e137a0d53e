"""The bodies of an arm as they are drawn: lines along its links, and the visual meshes of its description."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from pinposture.arm import Arm
from pinposture.arm.kinematics import neutral_placements, without_repeats
from pinposture.arm.urdf_reader import parse_xml
from pinposture.collision.files import find_mesh, read_mesh
from pinposture.collision.scan import between_cubes, representatives
from pinposture.errors import FileError, PostureWarning
from pinposture.viz.mesh import TriangleMesh, merge

# Shape and pose of each body.

Array = NDArray[np.float64]


class DrawnBody(NamedTuple):
    """What one joint of the chain moves, as a polyline.

    The body frame has its origin at the joint and, at the neutral configuration, the axes of the world.

    Attributes:
        joint: name of the joint.
        module: index of its module, 0-based.
        nodes: the joint, the control point on the body if there is one, and the next joint, (p, 3) [m], body
            frame.
        point: the control point on the body, (3,) [m], body frame; None if there is none.
        slide: how far back a prismatic joint reaches along its axis, (3,) [m], body frame; else zero.
    """

    joint: str
    module: int
    nodes: Array
    point: Array | None
    slide: Array


def bodies(arm: Arm) -> tuple[DrawnBody, ...]:
    """Return the moving bodies of an arm, from base to tip, one for each joint of the chain."""
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
        reach = chain.ratios[u] * arm.limits.upper[chain.columns[u]]
        # Some models have the largest floating-point number where there is no limit.
        slides = not chain.revolute[u] and 0.0 < reach < 10.0 * arm.length
        slide = -reach * chain.axes[u] if slides else np.zeros(3)
        distinct = without_repeats(np.array(nodes), 1e-9 * arm.length)
        listed.append(DrawnBody(chain.joints[u], int(modules[u]), distinct, point, slide))
    return tuple(listed)


def body_poses(arm: Arm, q: ArrayLike) -> Array:
    """Return the poses of the bodies, by the product of exponentials of the joint screws.

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
    # (f, n, 3, 3), all at once: one call per joint takes longer than everything else here.
    amounts = positions[:, chain.columns] * chain.ratios
    vectors = (amounts[:, :, None] * chain.axes).reshape(-1, 3)
    turns = Rotation.from_rotvec(vectors).as_matrix().reshape(len(positions), -1, 3, 3)
    turn = np.broadcast_to(np.eye(3), (len(positions), 3, 3))
    shift = np.zeros((len(positions), 3))
    for u, (axis, origin) in enumerate(zip(chain.axes, chain.origins, strict=True)):
        # The bodies before the joint carry it from its neutral position: p = R origin + shift.
        place = turn @ origin + shift
        if chain.revolute[u]:
            turn = turn @ turns[:, u]
        else:
            place = place + np.einsum("fij,fj->fi", turn, amounts[:, u, None] * axis)
        shift = place - turn @ origin
        poses[:, u, :3, :3], poses[:, u, :3, 3] = turn, place
    return poses if several else poses[0]


def backbone(arm: Arm, q: ArrayLike) -> Array:
    """Return the line from base through joints and control points to the tip, (p, 3) [m], world frame.

    Raises:
        InvalidValue: a configuration of the wrong size, or not finite.
    """
    stations = [arm.chain.base[None]]
    for body, pose in zip(bodies(arm), body_poses(arm, q), strict=True):
        stations.append(body.nodes @ pose[:3, :3].T + pose[:3, 3])
    return np.vstack(stations)


# Visual meshes. Only drawing reads them: a body whose mesh is missing or cannot be read is drawn as bars.

MAX_TRIANGLES = 200_000  # of all meshes together, so that a browser turns them smoothly
_MAX_LISTED = 12  # files that a warning names


class BodyMeshes(NamedTuple):
    """The meshes of the base, world frame, and of each body from base to tip, body frame; None if missing."""

    base: TriangleMesh | None
    bodies: tuple[TriangleMesh | None, ...]


def body_meshes(arm: Arm, max_triangles: int = MAX_TRIANGLES) -> BodyMeshes:
    """Read the visual meshes of an arm, merged to one surface for each body.

    If there are too many triangles in all, the bodies with most of them are simplified. One `PostureWarning`
    names their files, and those that are missing or cannot be read.
    """
    joints = arm.chain.joints
    # Index of each body by the joint of the model that moves it; the base is last.
    owners = {arm.model.getJointId(name): u for u, name in enumerate(joints)} | {0: len(joints)}
    origins = np.vstack([arm.chain.origins, np.zeros(3)])
    parts: dict[int, list[TriangleMesh]] = {}
    files: dict[int, list[str]] = {}
    surfaces: dict[str, TriangleMesh] = {}
    faults: dict[str, str] = {}
    for name, joint, placement, scale in _visual_meshes(arm):
        if joint not in owners:
            continue
        owner = owners[joint]
        try:
            if name not in faults and name not in surfaces:
                surfaces[name] = TriangleMesh(*read_mesh(find_mesh(name, arm.package_dirs)))
            if name in surfaces:
                placed = _place_mesh(name, surfaces[name], placement, scale, origins[owner])
                parts.setdefault(owner, []).append(placed)
                files.setdefault(owner, []).append(name)
        except FileError as error:
            faults[name] = error.reason
    merged = {owner: merge(listed) for owner, listed in parts.items()}
    total = sum(len(mesh.faces) for mesh in merged.values())
    limit = _triangles_per_body([len(mesh.faces) for mesh in merged.values()], max_triangles)
    many = f"all meshes together having {total} triangles, more than {max_triangles}"
    for owner in [owner for owner, mesh in merged.items() if len(mesh.faces) > limit]:
        coarse = _simplify(merged.pop(owner), limit)
        if coarse is not None:
            merged[owner] = coarse
        how = "is left out" if coarse is None else f"is drawn with {len(coarse.faces)} triangles"
        faults.update(dict.fromkeys(files[owner], f"{how}, {many}"))
    if faults:
        listed = [f"{name} {reason}" for name, reason in list(faults.items())[:_MAX_LISTED]]
        listed += [f"and {len(faults) - _MAX_LISTED} more"] if len(faults) > _MAX_LISTED else []
        text = f"links are not drawn as their meshes have them: {'; '.join(listed)}"
        warnings.warn(text, PostureWarning, stacklevel=2)
    return BodyMeshes(merged.get(len(joints)), tuple(merged.get(u) for u in range(len(joints))))


def _visual_meshes(arm: Arm) -> Iterator[tuple[str, int, pin.SE3, Array]]:
    """Yield the file, joint, neutral placement in the world and scale of each mesh in the description."""
    if arm.urdf is None or "<mesh" not in arm.urdf:
        return
    links = [frame for frame in arm.model.frames if frame.type == pin.FrameType.BODY]
    places = neutral_placements(arm.model)
    # Fixed links are placed relative to the root link, the first, which is at the base placement.
    places[0] = arm.base_placement * links[0].placement.inverse()
    frames = {frame.name: frame for frame in links}
    for link in parse_xml(arm.urdf, "URDF text").iterfind("link"):
        frame = frames.get(link.get("name", ""))
        for visual in link.iterfind("visual"):
            mesh, origin = visual.find("geometry/mesh"), visual.find("origin")
            if mesh is None or frame is None:
                continue
            place = {} if origin is None else origin.attrib
            turn = pin.rpy.rpyToMatrix(_three_numbers(place.get("rpy", "0 0 0")))
            placement = pin.SE3(turn, _three_numbers(place.get("xyz", "0 0 0")))
            scale, joint = _three_numbers(mesh.get("scale", "1 1 1")), int(frame.parentJoint)
            yield mesh.get("filename", ""), joint, places[joint] * frame.placement * placement, scale


def _place_mesh(name: str, mesh: TriangleMesh, pose: pin.SE3, scale: Array, origin: Array) -> TriangleMesh:
    """Scale a mesh and move it to its neutral pose in the world, relative to the origin of its body."""
    with np.errstate(all="ignore"):  # refused below
        vertices = (mesh.vertices * scale) @ pose.rotation.T + (pose.translation - origin)
    if not np.all(np.isfinite(vertices)):
        raise FileError(name, "has vertices, a scale or an origin that are no finite numbers")
    # A mirrored triangle has its front on the other side.
    return TriangleMesh(vertices, mesh.faces[:, ::-1] if np.prod(scale) < 0.0 else mesh.faces)


def _triangles_per_body(counts: Sequence[int], max_triangles: int) -> int:
    """Return the largest number of triangles of a body with which all together have few enough."""
    left, bodies = max_triangles, len(counts)
    for count in sorted(counts):
        if count * bodies > left:
            return left // bodies
        left, bodies = left - count, bodies - 1
    return max_triangles


def _simplify(mesh: TriangleMesh, limit: int) -> TriangleMesh | None:
    """Merge vertices until at most `limit` triangles are left; None if none would be left."""
    points = min(limit, len(mesh.vertices) - 1)
    while points > 2:
        kept, cubes = representatives(mesh.vertices, points)
        faces = between_cubes(mesh.faces, cubes)
        if 0 < len(faces) <= limit:
            return TriangleMesh(mesh.vertices[kept], faces)
        points //= 2
    return None


def _three_numbers(text: str) -> Array:
    """Parse three numbers; NaN, which is refused later, if the text is something else."""
    try:
        numbers = np.array([float(word) for word in text.split()])
    except ValueError:
        numbers = np.empty(0)
    return numbers if numbers.shape == (3,) else np.full(3, np.nan)
