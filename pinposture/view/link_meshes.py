"""The meshes that a robot description gives its links, put on the bodies that carry them.

Only drawing asks for them: where a mesh is missing or cannot be read, a body keeps its stand-in shape.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pinposture.arm import Arm
from pinposture.arm.urdf_source import parse_xml
from pinposture.errors import FileError, PostureWarning
from pinposture.scene.mesh_files import find_mesh, read_mesh
from pinposture.view.mesh import Mesh, merge

Array = NDArray[np.float64]

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

    base: Mesh | None
    bodies: tuple[Mesh | None, ...]


def body_meshes(arm: Arm, most_triangles: int = MOST_TRIANGLES) -> BodyMeshes:
    """Read the visual meshes of an arm, merged to one surface for each body.

    A `PostureWarning`, one for all, names the files that are missing or cannot be read, and those that are
    left out because there are too many triangles: whole bodies, those with most triangles first.

    Args:
        arm: the arm; one that was not loaded from a description has no meshes.
        most_triangles: triangles of all meshes together that are accepted.
    """
    joints = arm.chain.joints
    # Place of a body's joint in the chain by the number that the model gives it; the base is last.
    owners = {arm.model.getJointId(name): u for u, name in enumerate(joints)} | {0: len(joints)}
    origins = np.vstack([arm.chain.origins, np.zeros(3)])
    parts: dict[int, list[Mesh]] = {}
    files: dict[int, list[str]] = {}
    surfaces: dict[str, Mesh] = {}
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
                surfaces[name] = Mesh(*read_mesh(find_mesh(name, arm.package_dirs)))
            if name in surfaces:
                placed = _placed(surfaces[name], visual, link, origins[owner])
                parts.setdefault(owner, []).append(placed)
                files.setdefault(owner, []).append(name)
        except FileError as error:
            faults[name] = error.reason
    for owner in _largest(parts, most_triangles):
        del parts[owner]
        reason = f"is left out, all meshes together having more than {most_triangles} triangles"
        faults.update(dict.fromkeys(files[owner], reason))
    if faults:
        warnings.warn(_described(faults), PostureWarning, stacklevel=2)
    merged = {owner: merge(listed) for owner, listed in parts.items()}
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
            turn = pin.rpy.rpyToMatrix(_three(place.get("rpy", "0 0 0")))
            placement = pin.SE3(turn, _three(place.get("xyz", "0 0 0")))
            scale = _three(mesh.get("scale", "1 1 1"))
            listed.append(VisualMesh(link.get("name", ""), mesh.get("filename", ""), scale, placement))
    return listed


def _placed(mesh: Mesh, visual: VisualMesh, link: pin.SE3, origin: Array) -> Mesh:
    """A mesh in the frame of its body, given the link in the world at the neutral configuration."""
    pose = link * visual.placement
    with np.errstate(all="ignore"):  # what is not finite is refused below
        vertices = (mesh.vertices * visual.scale) @ pose.rotation.T + (pose.translation - origin)
    if not np.all(np.isfinite(vertices)):
        raise FileError(visual.filename, "has vertices, a scale or an origin that are no finite numbers")
    # A mirrored triangle would show its back.
    return Mesh(vertices, mesh.faces[:, ::-1] if np.prod(visual.scale) < 0.0 else mesh.faces)


def _links(arm: Arm) -> dict[str, tuple[int, pin.SE3]]:
    """The joint that moves each link, and where the link is in the world at the neutral configuration."""
    model = arm.model
    # Every joint of a chain is the identity there, so this needs no pin.Data, which is huge for long arms.
    places = [pin.SE3.Identity()]
    for joint in range(1, model.njoints):
        places.append(places[model.parents[joint]] * model.jointPlacements[joint])
    frames = [frame for frame in model.frames if frame.type == pin.FrameType.BODY]
    # Links that never move are placed relative to the root link, the first, which stands where the base is.
    places[0] = arm.base_placement * frames[0].placement.inverse()
    return {
        frame.name: (int(frame.parentJoint), places[frame.parentJoint] * frame.placement) for frame in frames
    }


def _largest(parts: Mapping[int, Sequence[Mesh]], most_triangles: int) -> Iterator[int]:
    """The bodies to leave out, largest first, until the others have few enough triangles."""
    counts = {owner: sum(len(mesh.faces) for mesh in listed) for owner, listed in parts.items()}
    total = sum(counts.values())
    for owner in sorted(counts, key=lambda owner: -counts[owner]):
        if total <= most_triangles:
            return
        total -= counts[owner]
        yield owner


def _described(faults: Mapping[str, str]) -> str:
    named = [f"{name} {reason}" for name, reason in list(faults.items())[:_LISTED]]
    if len(faults) > _LISTED:
        named.append(f"and {len(faults) - _LISTED} more")
    return f"links are drawn without meshes that are not to be had: {'; '.join(named)}"


def _three(text: str) -> Array:
    """Three numbers; not a number, which is noticed later, if the text is something else."""
    try:
        numbers = np.array([float(word) for word in text.split()])
    except ValueError:
        numbers = np.empty(0)
    return numbers if numbers.shape == (3,) else np.full(3, np.nan)
