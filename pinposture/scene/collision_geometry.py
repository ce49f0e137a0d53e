"""The collision geometry that a robot description gives its links, as solids in the frames of joints."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple
from xml.etree.ElementTree import Element

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pinposture.arm import Arm
from pinposture.arm.urdf_source import parse_xml
from pinposture.errors import FileError, InvalidValue
from pinposture.scene.mesh import Mesh
from pinposture.scene.mesh_files import find_mesh, read_mesh
from pinposture.scene.obstacles import Box, Capsule, Cylinder, Sphere

if TYPE_CHECKING:
    from pinposture.scene.bodies import Shape

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
