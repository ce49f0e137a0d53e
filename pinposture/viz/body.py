"""The drawn bodies of an arm: lines along its links, and the visual meshes of its description."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cache
from itertools import product
from typing import NamedTuple
from xml.etree.ElementTree import Element

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from pinposture.arm import Arm
from pinposture.arm.kinematics import neutral_placements, without_repeats
from pinposture.arm.urdf import parse_xml, read_shape
from pinposture.collision import Mesh, Obstacle, Scan
from pinposture.collision.files import find_mesh, read_mesh
from pinposture.collision.scan import between_cubes, representatives
from pinposture.errors import FileError, InvalidValue, enumerated, warn_caller
from pinposture.kernels.arrays import SOLID

Array = NDArray[np.float64]


class DrawnBody(NamedTuple):
    """The body moved by one joint of the chain, as a polyline.

    The body frame has its origin at the joint and is aligned with the world at the neutral configuration.

    Attributes:
        joint: name of the joint.
        module: index of its module, 0-based.
        nodes: the joint, the control point on the body (if any), and the next joint, (p, 3) [m], body frame.
        point: the control point on the body, (3,) [m], body frame, or None.
        slide: vector back along the axis of a prismatic joint, (3,) [m], body frame; otherwise zero.
    """

    joint: str
    module: int
    nodes: Array
    point: Array | None
    slide: Array


def bodies(arm: Arm) -> tuple[DrawnBody, ...]:
    """Return the moving bodies of an arm from base to tip, one per joint of the chain."""
    chain = arm.chain
    ends = {joints.stop - 1: k for k, joints in enumerate(chain.module_slices)}
    modules = np.repeat(np.arange(arm.n_modules), [len(joints) for joints in arm.module_joints])
    listed = []
    for u, origin in enumerate(chain.origins):
        nodes = [np.zeros(3)]
        point = None
        if u in ends:
            point = chain.points[ends[u]] - origin
            nodes.append(point)
        if u + 1 < len(chain.origins):
            nodes.append(chain.origins[u + 1] - origin)
        reach = chain.ratios[u] * arm.limits.upper[chain.columns[u]]
        # Some models represent a missing limit by the largest floating-point number.
        slides = not chain.revolute[u] and 0.0 < reach < 10.0 * arm.length
        slide = -reach * chain.axes[u] if slides else np.zeros(3)
        distinct = without_repeats(np.array(nodes), 1e-9 * arm.length)
        listed.append(DrawnBody(chain.joints[u], int(modules[u]), distinct, point, slide))
    return tuple(listed)


def body_poses(arm: Arm, q: ArrayLike) -> Array:
    """Return the poses of the bodies, as products of exponentials of the joint screws.

    Args:
        arm: the arm.
        q: one configuration, (nq,), or several, (f, nq) [rad or m].

    Returns:
        Homogeneous transforms from body to world frame, (n, 4, 4) or (f, n, 4, 4) [m].

    Raises:
        InvalidValue: a configuration of the wrong size or not finite.
    """
    several = np.ndim(q) > 1
    rows = q if several else [q]
    positions = np.array([arm.positions(row) for row in np.asarray(rows, dtype=np.float64)])  # (f, nv)
    chain = arm.chain
    poses = np.zeros((len(positions), len(chain.joints), 4, 4))
    poses[..., 3, 3] = 1.0
    # (f, n, 3, 3), vectorized: one call per joint would dominate the run time.
    amounts = positions[:, chain.columns] * chain.ratios
    vectors = (amounts[:, :, None] * chain.axes).reshape(-1, 3)
    turns = Rotation.from_rotvec(vectors).as_matrix().reshape(len(positions), -1, 3, 3)
    turn = np.broadcast_to(np.eye(3), (len(positions), 3, 3))
    shift = np.zeros((len(positions), 3))
    for u, (axis, origin) in enumerate(zip(chain.axes, chain.origins, strict=True)):
        # The preceding joints move this one from its neutral position: p = R origin + shift.
        origins = turn @ origin + shift
        if chain.revolute[u]:
            turn = turn @ turns[:, u]
        else:
            origins = origins + np.einsum("fij,fj->fi", turn, amounts[:, u, None] * axis)
        shift = origins - turn @ origin
        poses[:, u, :3, :3] = turn
        poses[:, u, :3, 3] = origins
    return poses if several else poses[0]


def backbone(arm: Arm, q: ArrayLike) -> Array:
    """Return the line from base through joints and control points to the tip, (p, 3) [m], world frame.

    Raises:
        InvalidValue: a configuration of the wrong size or not finite.
    """
    stations = [arm.chain.base[None]]
    for body, pose in zip(bodies(arm), body_poses(arm, q), strict=True):
        stations.append(body.nodes @ pose[:3, :3].T + pose[:3, 3])
    return np.vstack(stations)


# Visual meshes. A body whose mesh is missing or unreadable is drawn as bars.


class MeshFineness(NamedTuple):
    """How finely bodies and obstacles are drawn."""

    sides: int = 16
    """Number of sides of the polygon that approximates the section of a tube or disc."""

    obstacle_sides: int = 48
    """Number of sides of the polygon that approximates the section of an obstacle."""

    triangles: int = 200_000
    """Most triangles of all meshes together, so that a browser renders them smoothly."""

    points: int = 20_000
    """Most points drawn of a mesh or scan."""

    dot_size: float = 2e-3
    """Smallest radius of a point of a cloud, relative to the width of the cloud."""

    flat: float = 1e-7
    """Relative thickness below which a solid counts as flat."""


FINENESS = MeshFineness()


class BodyMeshes(NamedTuple):
    """The meshes of the base, world frame, and of each body from base to tip, body frame; None if missing."""

    base: TriangleMesh | None
    bodies: tuple[TriangleMesh | None, ...]


def body_meshes(arm: Arm, max_triangles: int = FINENESS.triangles) -> BodyMeshes:
    """Read the visual meshes of an arm, merged into one surface per body.

    If there are too many triangles in total, the bodies with the most triangles are simplified. One
    `PostureWarning` names their files and those that are missing or unreadable.
    """
    joints = arm.chain.joints
    # Index of each body by the model joint that moves it; the base is last.
    owners = {arm.model.getJointId(name): u for u, name in enumerate(joints)} | {0: len(joints)}
    origins = np.vstack([arm.chain.origins, np.zeros(3)])
    parts: dict[int, list[TriangleMesh]] = {}
    files: dict[int, list[str]] = {}
    surfaces: dict[str, TriangleMesh] = {}
    faults: dict[str, str] = {}
    for name, joint, pose, visual in _visual_meshes(arm):
        if joint not in owners:
            continue
        owner = owners[joint]
        try:
            shape = read_shape(visual)
            scale = np.array(shape.numbers["scale"])
            if name not in faults and name not in surfaces:
                surfaces[name] = TriangleMesh(*read_mesh(find_mesh(name, arm.package_dirs)))
            if name in surfaces:
                placed = _place_mesh(name, surfaces[name], pose * shape.placement, scale, origins[owner])
                parts.setdefault(owner, []).append(placed)
                files.setdefault(owner, []).append(name)
        except (FileError, InvalidValue) as error:
            faults[name] = error.reason if isinstance(error, FileError) else str(error)
    merged = {owner: merge(listed) for owner, listed in parts.items()}
    total = sum(len(mesh.faces) for mesh in merged.values())
    limit = _triangles_per_body([len(mesh.faces) for mesh in merged.values()], max_triangles)
    many = f"because all meshes together have {total} triangles, more than {max_triangles}"
    for owner in [owner for owner, mesh in merged.items() if len(mesh.faces) > limit]:
        coarse = _simplify(merged.pop(owner), limit)
        if coarse is not None:
            merged[owner] = coarse
        how = "is left out" if coarse is None else f"is drawn with {len(coarse.faces)} triangles"
        faults.update(dict.fromkeys(files[owner], f"{how}, {many}"))
    if faults:
        listed = enumerated((f"{name} {reason}" for name, reason in faults.items()), between="; ")
        warn_caller(f"links are not drawn with their original meshes: {listed}")
    return BodyMeshes(merged.get(len(joints)), tuple(merged.get(u) for u in range(len(joints))))


def _visual_meshes(arm: Arm) -> Iterator[tuple[str, int, pin.SE3, Element]]:
    """Yield the file, joint, neutral pose of the link in the world, and <visual> of each mesh described."""
    if arm.urdf is None or "<mesh" not in arm.urdf:
        return
    links = [frame for frame in arm.model.frames if frame.type == pin.FrameType.BODY]
    placements = neutral_placements(arm.model)
    # Fixed links are placed relative to the root link, the first, which is at the base placement.
    placements[0] = arm.base_placement * links[0].placement.inverse()
    frames = {frame.name: frame for frame in links}
    for link in parse_xml(arm.urdf, "URDF text").iterfind("link"):
        frame = frames.get(link.get("name", ""))
        for visual in link.iterfind("visual"):
            mesh = visual.find("geometry/*")
            if mesh is None or mesh.tag != "mesh" or frame is None:
                continue
            joint = int(frame.parentJoint)
            yield mesh.get("filename", ""), joint, placements[joint] * frame.placement, visual


def _place_mesh(name: str, mesh: TriangleMesh, pose: pin.SE3, scale: Array, origin: Array) -> TriangleMesh:
    """Scale a mesh and move it to its neutral pose, world axes, relative to the origin of its body."""
    with np.errstate(all="ignore"):  # rejected below
        vertices = (mesh.vertices * scale) @ pose.rotation.T + (pose.translation - origin)
    if not np.all(np.isfinite(vertices)):
        raise FileError(name, "has vertices, a scale or an origin that are not finite")
    # Mirroring reverses the orientation of triangles.
    return TriangleMesh(vertices, mesh.faces[:, ::-1] if np.prod(scale) < 0.0 else mesh.faces)


def _triangles_per_body(counts: Sequence[int], max_triangles: int) -> int:
    """Return the limit of triangles per body that keeps the total within the maximum."""
    left = max_triangles
    bodies = len(counts)
    for count in sorted(counts):
        if count * bodies > left:
            return left // bodies
        left = left - count
        bodies = bodies - 1
    return max_triangles


def _simplify(mesh: TriangleMesh, limit: int) -> TriangleMesh | None:
    """Merge vertices until at most `limit` triangles remain; return None if none would remain."""
    points = min(limit, len(mesh.vertices) - 1)
    while points > 2:
        kept, cubes = representatives(mesh.vertices, points)
        faces = between_cubes(mesh.faces, cubes)
        if 0 < len(faces) <= limit:
            return TriangleMesh(mesh.vertices[kept], faces)
        points //= 2
    return None


class TriangleMesh(NamedTuple):
    """A triangulated surface.

    Attributes:
        vertices: (n, 3) [m].
        faces: vertex indices of each triangle, counterclockwise from outside, (k, 3).
    """

    vertices: Array
    faces: NDArray[np.intp]


def merge(meshes: Sequence[TriangleMesh]) -> TriangleMesh:
    """Merge surfaces into one, so that one transform moves them all."""
    shifts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    faces = [mesh.faces + shift for mesh, shift in zip(meshes, shifts, strict=False)]
    return TriangleMesh(np.vstack([mesh.vertices for mesh in meshes]), np.vstack(faces))


@cache
def _unit_ball(subdivisions: int) -> TriangleMesh:
    from trimesh.creation import icosphere  # imported here, because most figures do not need it

    sphere = icosphere(subdivisions=subdivisions)
    return TriangleMesh(np.asarray(sphere.vertices), np.asarray(sphere.faces, dtype=np.intp))


def ball(center: Array, radius: float, subdivisions: int = 2) -> TriangleMesh:
    """Return a sphere around a centre, (3,) [m], with 20 * 4^subdivisions triangles."""
    unit = _unit_ball(subdivisions)
    return TriangleMesh(np.asarray(center) + radius * unit.vertices, unit.faces)


def tube(path: Array, radius: float) -> TriangleMesh:
    """Return an open tube along a path, (n, 3) [m], n >= 2, without repeated points."""
    legs = np.diff(path, axis=0)
    legs /= np.linalg.norm(legs, axis=1, keepdims=True)
    inner = legs[:-1] + legs[1:]
    lengths = np.linalg.norm(inner, axis=1, keepdims=True)
    inner = np.where(lengths > 1e-9, inner / np.maximum(lengths, 1e-9), legs[:-1])
    tangents = np.vstack([legs[:1], inner, legs[-1:]])
    side = _perpendicular(tangents[0])
    sides = FINENESS.sides
    around = 2.0 * np.pi * np.arange(sides) / sides
    rings = []
    for point, tangent in zip(path, tangents, strict=True):
        # Parallel transport along the path, so that the tube does not twist.
        side = side - tangent * (tangent @ side)
        length = np.linalg.norm(side)
        side = side / length if length > 1e-6 else _perpendicular(tangent)
        other = np.cross(tangent, side)
        rings.append(point + radius * (np.outer(np.cos(around), side) + np.outer(np.sin(around), other)))
    ring, corner = np.meshgrid(np.arange(len(path) - 1), np.arange(sides), indexing="ij")
    a = (ring * sides + corner).ravel()
    b = (ring * sides + (corner + 1) % sides).ravel()
    faces = np.vstack([np.stack([b, a + sides, a], 1), np.stack([b + sides, a + sides, b], 1)])
    return TriangleMesh(np.vstack(rings), faces)


def disc(center: Array, axis: Array, radius: float, thickness: float) -> TriangleMesh:
    """Return a round plate with a given centre, (3,) [m], and unit axis, (3,)."""
    from trimesh.creation import cylinder

    half = axis * thickness / 2.0
    plate = cylinder(radius, segment=[center - half, center + half], sections=FINENESS.sides)
    return TriangleMesh(np.asarray(plate.vertices), np.asarray(plate.faces, dtype=np.intp))


def _perpendicular(direction: Array) -> Array:
    across = np.cross(direction, np.eye(3)[np.abs(direction).argmin()])
    return np.asarray(across / np.linalg.norm(across))


def box_corners(low: Array, high: Array) -> Array:
    """Return the corners of an axis-aligned box, (8, 3) [m]."""
    return np.array(list(product(*zip(low, high, strict=True))))


def cut_by_plane(corners: Array, normal: Array, offset: float) -> Array:
    """Return the part of a solid where normal . x <= offset [m].

    Args:
        corners: points whose convex hull is the solid, (n, 3) [m].
        normal: unit normal of the plane, (3,).
        offset: distance of the plane from the origin along the normal [m].

    Returns:
        Corners of the part, (k, 3) [m]: `corners` itself if nothing is cut off, empty if nothing remains.
    """
    heights = corners @ normal - offset
    if not np.any(heights > 0.0):
        return corners
    hull = ConvexHull(corners)
    edges = np.sort(hull.simplices[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    a, b = np.unique(edges, axis=0).T
    crossing = (heights[a] > 0.0) != (heights[b] > 0.0)
    a = a[crossing]
    b = b[crossing]
    share = (heights[a] / (heights[a] - heights[b]))[:, None]
    below = hull.vertices[heights[hull.vertices] <= 0.0]
    left = np.vstack([corners[below], corners[a] + share * (corners[b] - corners[a])])
    return np.zeros((0, 3)) if _is_flat(left) else left


def clip_to_box(corners: Array, low: Array, high: Array) -> Array:
    """Return the part of a solid inside an axis-aligned box, as corners, (k, 3) [m]."""
    for axis in range(3):
        for sign, side in ((1.0, high), (-1.0, low)):
            if len(corners):
                corners = cut_by_plane(corners, sign * np.eye(3)[axis], sign * float(side[axis]))
    return corners


def hull_surface(corners: Array) -> TriangleMesh:
    """Return the surface of a solid; triangles do not share vertices, for flat shading."""
    from trimesh.convex import convex_hull

    triangles = np.asarray(convex_hull(corners).triangles)
    return TriangleMesh(triangles.reshape(-1, 3), np.arange(3 * len(triangles)).reshape(-1, 3))


def facets(corners: Array) -> list[tuple[Array, Array]]:
    """Return the faces of a solid: corners, (k, 3), counterclockwise from outside, and unit normal, (3,)."""
    hull = ConvexHull(corners)
    planes, which = np.unique(hull.equations.round(9), axis=0, return_inverse=True)
    listed = []
    for k, normal in enumerate(planes[:, :3]):
        face = corners[np.unique(hull.simplices[which.ravel() == k])]
        out = face - face.mean(axis=0)
        first = out[0] / np.linalg.norm(out[0])
        angles = np.arctan2(out @ np.cross(normal, first), out @ first)
        listed.append((face[np.argsort(angles)], normal))
    return listed


def section(corners: Array, origin: Array, plane: Array) -> Array:
    """Return the section of a solid, (n, 3) [m], with a plane through a point with orthonormal axes (2, 3).

    Returns:
        Corners of the section in order, (k, 2) [m], along the axes of the plane from the world origin; empty
        if the solid does not meet the plane.
    """
    normal = np.cross(*plane)
    offset = float(normal @ origin)
    size = float(np.ptp(corners, axis=0).max())
    low = (corners @ normal - offset).min()
    high = (corners @ normal - offset).max()
    if not low < -FINENESS.flat * size < FINENESS.flat * size < high:
        return np.zeros((0, 2))
    lower = cut_by_plane(corners, normal, offset)
    face = lower[np.abs(lower @ normal - offset) <= FINENESS.flat * size]
    return convex_outline(face @ plane.T)


def convex_outline(flat: Array) -> Array:
    """Return the corners of the convex hull of points, (n, 2), in order; empty if they are collinear."""
    return np.zeros((0, 2)) if _is_flat(flat) else np.asarray(flat[ConvexHull(flat).vertices])


def is_hidden(points: Array, corners: Array, eye: Array) -> NDArray[np.bool_]:
    """Return which points, (n, 3) [m], a solid contains or hides from a distant eye in a direction, (3,)."""
    sides = ConvexHull(corners).equations
    # The ray from a point to the eye crosses the plane of each face once, inwards or outwards.
    above = points @ sides[:, :3].T + sides[:, 3]
    rising = sides[:, :3] @ eye
    along = np.abs(rising) < 1e-12
    passed = -above / np.where(along, 1.0, rising)
    enter = np.where(rising < 0.0, passed, -np.inf)
    leave = np.where(rising > 0.0, passed, np.inf)
    enter[:, along] = -np.inf
    leave[:, along] = np.inf
    aside = np.any(above[:, along] > 0.0, axis=1)
    return np.asarray(~aside & (np.maximum(enter.max(axis=1), 0.0) < leave.min(axis=1)))


def _is_flat(points: Array) -> bool:
    """Return whether points, (n, d), lie in an affine subspace of fewer than d dimensions."""
    if len(points) <= points.shape[1]:
        return True
    spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return bool(spread[-1] <= FINENESS.flat * spread[0])


def surface(obstacle: Obstacle) -> TriangleMesh:
    """Return the surface of an obstacle other than a half-space, which is unbounded, world frame [m].

    Large scans and meshes are thinned; the points of a cloud become octahedra.
    """
    geometry = obstacle.geometry
    if not geometry.convex:
        outline = _thinned(geometry)
        return TriangleMesh(outline.vertices @ np.array(geometry.rotation).T + geometry.center, outline.faces)
    solid = geometry.solid()
    if solid.kind == SOLID.box:
        corners = box_corners(-solid.half, solid.half) if solid.exact else geometry.content[0]
        return hull_surface(corners @ solid.rotation.T + solid.position)
    way = solid.end - solid.start
    length = float(np.linalg.norm(way))
    if length == 0.0:
        return _revolved(solid.start, np.array([0.0, 0.0, 1.0]), _arc(solid.radius, -1.0, 1.0))
    if solid.kind == SOLID.segment:
        profile = np.vstack([_arc(solid.radius, -1.0, 0.0), _arc(solid.radius, 0.0, 1.0) + (0.0, length)])
    else:  # rims twice: an edge shared by two faces would be shaded smoothly
        rims = [[solid.radius, 0.0], [solid.radius, length]]
        profile = np.array([[0.0, 0.0], rims[0], *rims, rims[1], [0.0, length]])
    return _revolved(solid.start, way / length, profile)


def _thinned(obstacle: Mesh | Scan) -> TriangleMesh:
    """Return the surface of a mesh or scan in its own frame, with at most `FINENESS.points` points."""
    points: Array = obstacle.content[0]
    faces: NDArray[np.integer] | None = obstacle.content[1]
    if len(points) > FINENESS.points:
        kept, cubes = representatives(points, FINENESS.points)
        points = points[kept]
        faces = None if faces is None else between_cubes(faces, cubes)
    if faces is not None:
        return TriangleMesh(points, np.asarray(faces, dtype=np.intp))
    radius = FINENESS.dot_size * float(np.ptp(obstacle.bounds, axis=0).max())
    radius = max(radius, obstacle.point_radius) if isinstance(obstacle, Scan) else radius
    dot = hull_surface(radius * np.vstack([np.eye(3), -np.eye(3)]))
    corners = points[:, None] + dot.vertices
    return TriangleMesh(corners.reshape(-1, 3), np.arange(corners.size // 3).reshape(-1, 3))


def _arc(radius: float, first: float, last: float) -> Array:
    """Return distances from the axis and heights, (n, 2), between two latitudes [quarter turns]."""
    count = 1 + round(FINENESS.obstacle_sides / 4 * (last - first))
    latitude = np.pi / 2.0 * np.linspace(first, last, count)
    return radius * np.column_stack([np.cos(latitude), np.sin(latitude)])


def _revolved(origin: Array, axis: Array, profile: Array) -> TriangleMesh:
    """Return the surface of revolution of a profile, (n, 2) [m]: distances from the axis, and heights."""
    from trimesh.creation import revolve
    from trimesh.geometry import align_vectors

    placement: Array = align_vectors([0.0, 0.0, 1.0], axis)  # type: ignore[no-untyped-call]
    placement[:3, 3] = origin
    turned = revolve(profile, sections=FINENESS.obstacle_sides, transform=placement, process=False)
    return TriangleMesh(np.asarray(turned.vertices), np.asarray(turned.faces, dtype=np.intp))
