"""A Pinocchio model as plain data, and the model that is built from such data.

Pinocchio's own serialization (4.1) loses what mimic joints follow and checks nothing: a model with mimic
joints, or damaged data, ends the process later. Here every index, size and number is checked.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from pinposture._validation import as_count, as_number, finite_array, require_known
from pinposture.errors import InvalidValue

Array = NDArray[np.float64]
Described = Mapping[str, Any]

POSITION_VECTORS = ("lowerPositionLimit", "upperPositionLimit", "positionLimitMargin")
"""Vectors of a model with an entry for each entry of a configuration."""
_BOUNDED = ("Velocity", "Effort", "DryFriction")
MOTION_VECTORS = (
    *(f"{edge}{what}Limit" for edge in ("lower", "upper") for what in _BOUNDED),
    *("damping", "armature", "rotorInertia", "rotorGearRatio"),
)
"""Vectors of a model with an entry for each degree of freedom."""

MIMIC = "Mimic"
COMPOSITE = "Composite"
ENDLESS = "RevoluteUnboundedUnaligned"
_PARAMETERS: dict[str, tuple[str, ...]] = {
    **dict.fromkeys(("RX", "RY", "RZ", "RUBX", "RUBY", "RUBZ", "PX", "PY", "PZ"), ()),
    **dict.fromkeys(("RevoluteUnaligned", ENDLESS, "PrismaticUnaligned"), ("axis",)),
    **dict.fromkeys(("FreeFlyer", "Planar", "Spherical", "SphericalZYX", "Translation"), ()),
    **dict.fromkeys(("HX", "HY", "HZ"), ("pitch",)),
    "HelicalUnaligned": ("axis", "pitch"),
    "Universal": ("axis1", "axis2"),
    "Ellipsoid": ("radius_x", "radius_y", "radius_z"),
}
"""Types of joints as Pinocchio names them, without "JointModel", and the arguments of their constructors."""

_ENDLESS_JOINT = (
    '<robot name="r"><link name="a"/><link name="b"/><joint name="j" type="continuous"><parent link="a"/>'
    '<child link="b"/><axis xyz="{!r} {!r} {!r}"/></joint></robot>'
)
_MOST_BODIES = 1_000_000
_MOST_MULTIPLES = 20_000
"""Multiples of an axis that are tried; of 2,000 random axes the worst took 1,031."""


def describe_model(
    model: pin.Model, following: Mapping[str, tuple[str, float, float]] | None = None
) -> dict[str, Any]:
    """Return a model as JSON-compatible data from which `rebuild_model` builds an equal one.

    Args:
        model: the model.
        following: joints that are to follow others in addition: joint name to the name of an earlier joint, a
            ratio, and an offset [rad or m]. They lose their degrees of freedom.

    Raises:
        InvalidValue: a joint of a type that is not known here.
    """
    names = list(model.names)
    joints = list(model.joints)
    added = dict(following or {})
    leaders = {joint.idx_v: name for name, joint in zip(names[1:], joints[1:], strict=True) if joint.nv}
    described: list[dict[str, Any]] = []
    positions: list[int] = []
    motions: list[int] = []
    for number in range(1, model.njoints):
        name = str(names[number])
        joint = joints[number]
        if _kind(joint) == MIMIC:
            own = joint.extract()
            added[name] = str(leaders[joint.idx_v]), float(own.scaling), float(own.offset)
        elif name not in added:
            positions += range(joint.idx_q, joint.idx_q + joint.nq)
            motions += range(joint.idx_v, joint.idx_v + joint.nv)
        entry: dict[str, Any] = {"name": name, "parent": int(model.parents[number])}
        if name in added:
            entry["follows"] = list(added[name])
        described.append(entry | _describe_joint(name, joint, added[name][1] if name in added else None))
    frames = list(model.frames)[1:]
    vectors = dict.fromkeys(POSITION_VECTORS, positions) | dict.fromkeys(MOTION_VECTORS, motions)
    return {
        "name": str(model.name),
        "gravity": np.asarray(model.gravity.vector).tolist(),
        "bodies": int(model.nbodies),
        "joints": described,
        "joint_placements": [_numbers(each) for each in list(model.jointPlacements)[1:]],
        "inertias": [_describe_inertia(each) for each in model.inertias],
        "frames": [
            [str(each.name), each.type.name, int(each.parentJoint), int(each.parentFrame)] for each in frames
        ],
        "frame_placements": [_numbers(each.placement) for each in frames],
        "frame_inertias": [_describe_inertia(each.inertia) for each in frames],
        "vectors": {name: np.asarray(getattr(model, name))[kept].tolist() for name, kept in vectors.items()},
    }


def rebuild_model(described: Described) -> pin.Model:
    """Build the model from the data of `describe_model`.

    Raises:
        InvalidValue: a number, index or name is not possible.
        KeyError, TypeError, ValueError, RuntimeError: the data are not of that form.
    """
    model = pin.Model()
    model.name = str(described["name"])
    model.gravity = pin.Motion(finite_array("gravity", described["gravity"], (6,)))
    joints = described["joints"]
    frames = described["frames"]
    places = _placements("joint_placements", described["joint_placements"], len(joints))
    for number, (entry, placement) in enumerate(zip(joints, places, strict=True), 1):
        parent = as_count(f"parent of joint {entry['name']!r}", entry["parent"], 0, number - 1)
        joint = _build_joint(entry)
        if "follows" in entry:
            joint = _following(model, joint, *entry["follows"])
        model.addJoint(parent, joint, placement, str(entry["name"]))
    for _ in range(1, as_count("bodies", described["bodies"], 1, _MOST_BODIES)):
        model.appendBodyToJoint(0, pin.Inertia.Zero(), pin.SE3.Identity())  # which counts them
    for number, inertia in enumerate(_inertias("inertias", described["inertias"], len(joints) + 1)):
        model.inertias[number] = inertia
    placed = _placements("frame_placements", described["frame_placements"], len(frames))
    inertias = _inertias("frame_inertias", described["frame_inertias"], len(frames))
    for (name, kind, parent, before), placement, inertia in zip(frames, placed, inertias, strict=True):
        require_known("type of frame", kind, list(pin.FrameType.names))
        joint = as_count(f"joint of frame {name!r}", parent, 0, len(joints))
        previous = as_count(f"frame before frame {name!r}", before, 0, len(frames))
        model.addFrame(
            pin.Frame(str(name), joint, previous, placement, pin.FrameType.names[kind], inertia), False
        )
    for name, size in (
        dict.fromkeys(POSITION_VECTORS, model.nq) | dict.fromkeys(MOTION_VECTORS, model.nv)
    ).items():
        vector = np.array(described["vectors"][name], dtype=np.float64)
        if vector.shape != (size,) or np.isnan(vector).any():
            raise InvalidValue(name, vector, f"{size} numbers")
        setattr(model, name, vector)
    return model


def _kind(joint: Any) -> str:
    return str(joint.shortname()).removeprefix("JointModel")


def _describe_joint(name: str, joint: pin.JointModel, ratio: float | None) -> dict[str, Any]:
    """Return the type of a joint and its parameters; those without its ratio if it follows another."""
    own = joint.extract()
    kind = _kind(joint)
    if kind == COMPOSITE:
        return {
            "type": kind,
            "parts": [_describe_joint(name, part, None) for part in own.joints],
            "placements": [_numbers(placement) for placement in own.jointPlacements],
        }
    follows_already = kind == MIMIC
    if follows_already:  # only its text says what it was
        kind = str(own).partition("Mimicking joint type: JointModel")[2].split("\n")[0]
    known = [each for each in _PARAMETERS if not (follows_already and "pitch" in _PARAMETERS[each])]
    if kind not in known:
        raise InvalidValue(f"type of joint {name!r}", kind, ", ".join(known))
    parameters = {each: getattr(own, each, None) for each in _PARAMETERS[kind]}
    if parameters and (ratio is not None or kind == ENDLESS):
        screw = np.ravel(joint.createData().S)
        if ratio is not None:
            screw = _divided(screw if follows_already else ratio * screw, ratio)
        parameters = {"axis": screw[:3] if kind.startswith("Prismatic") else screw[3:]}
    return {"type": kind, **{each: np.asarray(value).tolist() for each, value in parameters.items()}}


def _divided(products: Array, ratio: float) -> Array:
    """Return numbers near the quotients of which the ratio makes exactly these products, if there are such.

    A mimic joint tells only the product of its axis and its ratio. Equal products give equal quotients here,
    so that a model does not change when it is described and built again.
    """
    quotients = products / ratio
    found = quotients.copy()
    above = quotients
    below = quotients
    for _ in range(2):  # a product and a quotient are rounded by half a unit each
        above = np.nextafter(above, np.inf)
        below = np.nextafter(below, -np.inf)
        for near in (above, below):
            found = np.where((ratio * found != products) & (ratio * near == products), near, found)
    return np.asarray(found)


def _build_joint(entry: Described) -> pin.JointModel:
    kind = entry["type"]
    if kind == COMPOSITE:
        whole = pin.JointModelComposite()
        places = _placements("placements", entry["placements"], len(entry["parts"]))
        for part, placement in zip(entry["parts"], places, strict=True):
            whole.addJoint(_build_joint(part), placement)
        return pin.JointModel(whole)
    require_known("type of joint", kind, _PARAMETERS)
    parameters: list[Any] = []
    for name in _PARAMETERS[kind]:
        vector = name.startswith("axis")
        value = finite_array(name, entry[name], (3,) if vector else ())
        if vector and abs(np.linalg.norm(value) - 1.0) > 1e-6:
            raise InvalidValue(name, entry[name], "a unit vector")
        parameters.append(value if vector else float(value))
    if kind == ENDLESS:
        return _endless_joint(parameters[0])
    return pin.JointModel(getattr(pin, f"JointModel{kind}")(*parameters))


def _endless_joint(axis: Array) -> pin.JointModel:
    """Return a joint without limits about an axis.

    Python can make one (Pinocchio 4.1) from a description only. Its axis is normalized, which can change the
    last digit, but not for every multiple of the axis.
    """
    for multiple in range(1, _MOST_MULTIPLES, 2):
        model = pin.buildModelFromXML(_ENDLESS_JOINT.format(*(multiple * axis).tolist()))
        joint = model.joints[1]
        if np.array_equal(np.ravel(joint.createData().S)[3:], axis):
            break
    return pin.JointModel(joint)


def _following(
    model: pin.Model, joint: pin.JointModel, name: str, ratio: float, offset: float
) -> pin.JointModel:
    """Return a joint that follows one of a model."""
    plain = {
        str(model.names[number]): each
        for number, each in enumerate(model.joints)
        if number and each.nv == 1 and _kind(each) != MIMIC
    }
    require_known("leading joint", name, plain)
    leader = plain[name]
    if (joint.nq, joint.nv) != (leader.nq, leader.nv):
        raise InvalidValue(
            f"numbers of a joint that follows {name!r}", (joint.nq, joint.nv), f"{leader.nq}, 1"
        )
    scaling = as_number("ratio", ratio, "a finite number other than 0", lambda x: x != 0.0)
    shift = as_number("offset", offset, "a finite number", lambda x: True)
    joint.setIndexes(leader.id, leader.idx_q, leader.idx_v, leader.idx_vExtended)
    return pin.JointModelMimic(joint, scaling, shift)


def _numbers(placement: pin.SE3) -> list[float]:
    """Return the first three rows of a homogeneous matrix, twelve numbers."""
    flat: list[float] = np.asarray(placement.homogeneous)[:3].ravel().tolist()
    return flat


def _placements(name: str, rows: ArrayLike, count: int) -> list[pin.SE3]:
    matrices = np.zeros((count, 3, 4))
    if count:
        matrices[:] = finite_array(name, rows, (count, 12)).reshape(count, 3, 4)
    turns = matrices[:, :, :3]
    off = np.abs(np.einsum("nij,nkj->nik", turns, turns) - np.eye(3))
    if np.any(off > 1e-6) or np.any(np.linalg.det(turns) < 0.0):
        raise InvalidValue(name, turns[int(off.max(axis=(1, 2)).argmax())], "rotations")
    return [pin.SE3(each[:, :3], each[:, 3]) for each in matrices]


def _describe_inertia(inertia: pin.Inertia) -> list[float]:
    """Return mass, centre of mass, and the upper triangle of the inertia about it, ten numbers."""
    moments = np.asarray(inertia.inertia)[np.triu_indices(3)]
    return [float(inertia.mass), *np.asarray(inertia.lever).tolist(), *moments.tolist()]


def _inertias(name: str, rows: ArrayLike, count: int) -> list[pin.Inertia]:
    """Return inertias, which descriptions may give as any numbers, and which only simulations use."""
    table = np.array(rows, dtype=np.float64).reshape(-1, 10)
    if len(table) != count:
        raise InvalidValue(f"{name} (shape)", table.shape, f"({count}, 10)")
    inertias = []
    for row in table:
        moments = np.zeros((3, 3))
        moments[np.triu_indices(3)] = row[4:]
        inertia = pin.Inertia.Zero()  # the constructor would refuse unphysical ones
        inertia.mass = float(row[0])
        inertia.lever = row[1:4]
        inertia.inertia = moments + np.triu(moments, 1).T
        inertias.append(inertia)
    return inertias
