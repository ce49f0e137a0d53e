"""A Pinocchio model as declared data, and the model that is built from such data.

Pinocchio's own serialization (4.1) loses what mimic joints follow and checks nothing: a model with mimic
joints, or damaged data, ends the process later. Here every index, size and number is checked.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Annotated, Any, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from pinposture._validation import as_count, as_floats, as_number, finite_array, require_finite, require_known
from pinposture.arm.inertias import RigidBody
from pinposture.errors import InvalidValue
from pinposture.schema import CheckedBy, Declared, Number, Text, WholeNumber, declared, one_of

Array = NDArray[np.float64]

POSITION_VECTORS = ("lowerPositionLimit", "upperPositionLimit", "positionLimitMargin")
"""Vectors of a model with an entry for each entry of a configuration."""
MOTION_VECTORS = (
    *(f"{edge}{what}Limit" for edge in ("lower", "upper") for what in ("Velocity", "Effort", "DryFriction")),
    *("damping", "armature", "rotorInertia", "rotorGearRatio"),
)
"""Vectors of a model with an entry for each degree of freedom."""


class JointTypes(NamedTuple):
    """Types of joints with a part of their own in a description."""

    mimic: str = "Mimic"
    composite: str = "Composite"
    endless: str = "RevoluteUnboundedUnaligned"


TYPE = JointTypes()

_PARAMETERS: dict[str, tuple[str, ...]] = {
    **dict.fromkeys(("RX", "RY", "RZ", "RUBX", "RUBY", "RUBZ", "PX", "PY", "PZ"), ()),
    **dict.fromkeys(("RevoluteUnaligned", TYPE.endless, "PrismaticUnaligned"), ("axis",)),
    **dict.fromkeys(("FreeFlyer", "Planar", "Spherical", "SphericalZYX", "Translation"), ()),
    **dict.fromkeys(("HX", "HY", "HZ"), ("pitch",)),
    "HelicalUnaligned": ("axis", "pitch"),
    "Universal": ("axis1", "axis2"),
    "Ellipsoid": ("radius_x", "radius_y", "radius_z"),
}
"""Types of joints as Pinocchio names them, without "JointModel", and the arguments of their constructors."""


def _unit_vector(name: str, value: ArrayLike) -> tuple[float, ...]:
    vector = finite_array(name, value, (3,))
    if abs(np.linalg.norm(vector) - 1.0) > 1e-6:
        raise InvalidValue(name, value, "a unit vector")
    return tuple(vector.tolist())


def _rows(name: str, rows: ArrayLike, columns: int) -> Array:
    table = as_floats(name, rows, f"rows of {columns} numbers")
    if not table.size:
        return np.zeros((0, columns))
    if table.ndim != 2 or table.shape[1] != columns:
        raise InvalidValue(f"{name} (shape)", table.shape, f"(n, {columns})")
    return table


def _placements(name: str, rows: ArrayLike) -> Array:
    table = _rows(name, rows, 12)
    require_finite(name, table)
    turns = table.reshape(-1, 3, 4)[:, :, :3]
    off = np.abs(np.einsum("nij,nkj->nik", turns, turns) - np.eye(3))
    if np.any(off > 1e-6) or np.any(np.linalg.det(turns) < 0.0):
        raise InvalidValue(name, turns[int(off.max(axis=(1, 2)).argmax())], "rotations")
    return table


def _vectors(name: str, value: object) -> dict[str, Array]:
    """Read the vectors of a model, which may be infinite."""
    names = (*POSITION_VECTORS, *MOTION_VECTORS)
    if not isinstance(value, Mapping) or set(value) != set(names):
        raise InvalidValue(name, value, f"vectors named {', '.join(names)}")
    read = {key: as_floats(key, value[key], "numbers") for key in names}
    for key, vector in read.items():
        if vector.ndim != 1 or np.isnan(vector).any():
            raise InvalidValue(key, vector, "a vector of numbers")
    return read


_Axis = Annotated[tuple[float, ...], CheckedBy(_unit_vector)]
_Placements = Annotated[Array, CheckedBy(_placements)]
_Inertias = Annotated[Array, CheckedBy(partial(_rows, columns=10))]


@declared(eq=False)
class JointData(Declared):
    """A joint of a model, or a part of a composite one.

    Attributes:
        type: its type as Pinocchio names it, without "JointModel"; that which it has alone if it follows.
        name: its name; empty for a part.
        parent: the joint that carries it, by number; 0 for the world.
        follows: the earlier joint that it follows, a ratio, and an offset [rad or m].
        axis: unit vector of its axis, (3,), where the type does not say it; likewise the following.
        axis1: its first axis, (3,).
        axis2: its second axis, (3,).
        pitch: of a screw [m/rad].
        radius_x: half axis of an ellipsoid [m].
        radius_y: likewise.
        radius_z: likewise.
        parts: the joints of a composite one.
        placements: of these, each in the frame before, (n, 12): the first three rows of a matrix.
    """

    type: Annotated[str, one_of("type of joint", *_PARAMETERS, TYPE.composite)]
    name: Text = ""
    parent: WholeNumber = 0
    follows: tuple[str, float, float] | None = None
    axis: _Axis | None = None
    axis1: _Axis | None = None
    axis2: _Axis | None = None
    pitch: Number | None = None
    radius_x: Number | None = None
    radius_y: Number | None = None
    radius_z: Number | None = None
    parts: tuple[JointData, ...] = ()
    placements: _Placements | None = None

    @classmethod
    def of(cls, joint: pin.JointModel, ratio: float | None = None, **about: Any) -> JointData:
        """Describe a joint; by itself alone if it follows another at a ratio.

        Args:
            joint: the joint.
            ratio: its motion relative to that of the joint that it follows; None if it follows none.
            about: name, parent and follows.

        Raises:
            InvalidValue: a joint of a type that is not known here.
        """
        model = joint.extract()
        kind = _kind(joint)
        if kind == TYPE.composite:
            parts = tuple(cls.of(part) for part in model.joints)
            placements = _describe_placements(model.jointPlacements)
            return cls(type=kind, parts=parts, placements=placements, **about)
        follows_already = kind == TYPE.mimic
        if follows_already:  # only its text says what it was
            kind = str(model).partition("Mimicking joint type: JointModel")[2].split("\n")[0]
        known = [
            candidate
            for candidate in _PARAMETERS
            if not (follows_already and "pitch" in _PARAMETERS[candidate])
        ]
        if kind not in known:
            raise InvalidValue(f"type of joint {about['name']!r}", kind, ", ".join(known))
        parameters: dict[str, Any] = {
            parameter: getattr(model, parameter, None) for parameter in _PARAMETERS[kind]
        }
        if parameters and (ratio is not None or kind == TYPE.endless):
            screw = np.ravel(joint.createData().S)
            if ratio is not None:
                screw = _divided(screw if follows_already else ratio * screw, ratio)
            parameters = {"axis": screw[:3] if kind.startswith("Prismatic") else screw[3:]}
        return cls(type=kind, **parameters, **about)

    def build(self) -> pin.JointModel:
        """Build the joint, by itself alone.

        Raises:
            InvalidValue: a parameter that its type needs is missing.
        """
        if self.type == TYPE.composite:
            whole = pin.JointModelComposite()
            for part, placement in zip(self.parts, _poses(self.placements), strict=True):
                whole.addJoint(part.build(), placement)
            return pin.JointModel(whole)
        parameters = {name: getattr(self, name) for name in _PARAMETERS[self.type]}
        for name, value in parameters.items():
            if value is None:
                raise InvalidValue(f"{name} of joint {self.name!r}", None, f"that of a joint {self.type}")
        if self.type == TYPE.endless:
            return _endless_joint(np.array(self.axis))
        given = [
            np.array(parameter) if isinstance(parameter, tuple) else parameter
            for parameter in parameters.values()
        ]
        return pin.JointModel(getattr(pin, f"JointModel{self.type}")(*given))


@declared(eq=False)
class ModelData(Declared):
    """A Pinocchio model as declared data: `ModelData.of(model).build()` is an equal model.

    Attributes:
        name: its name.
        gravity: linear and angular acceleration, (6,) [m/s^2, rad/s^2].
        bodies: number of bodies, with the world.
        joints: its joints, without the world.
        joint_placements: of each joint in the frame of its parent, (n, 12): the first three rows of a matrix.
        inertias: of the world and each joint, (n + 1, 10): mass, centre of mass, and the upper triangle of
            the moments about it [kg, m, kg m^2]. Any numbers, as only simulations use them.
        frames: its frames without the first: name, type, joint, and the frame before, by number.
        frame_placements: of each frame in that of its joint, (f, 12).
        frame_inertias: of each frame, (f, 10).
        vectors: its vectors by name, `POSITION_VECTORS` and `MOTION_VECTORS`.
    """

    name: Text
    gravity: Annotated[Array, CheckedBy(partial(finite_array, shape=(6,)))]
    bodies: Annotated[int, CheckedBy(partial(as_count, low=1, high=1_000_000))]
    joints: tuple[JointData, ...]
    joint_placements: _Placements
    inertias: _Inertias
    frames: tuple[tuple[str, str, int, int], ...]
    frame_placements: _Placements
    frame_inertias: _Inertias
    vectors: Annotated[Mapping[str, Array], CheckedBy(_vectors)]

    @classmethod
    def of(
        cls, model: pin.Model, following: Mapping[str, tuple[str, float, float]] | None = None
    ) -> ModelData:
        """Describe a model.

        Args:
            model: the model.
            following: joints that are to follow others in addition: joint name to the name of an earlier
                joint, a ratio, and an offset [rad or m]. They lose their degrees of freedom.

        Raises:
            InvalidValue: a joint of a type that is not known here.
        """
        names = [str(name) for name in model.names]
        joints = list(model.joints)
        added = dict(following or {})
        leaders = {joint.idx_v: name for name, joint in zip(names[1:], joints[1:], strict=True) if joint.nv}
        described: list[JointData] = []
        positions: list[int] = []
        motions: list[int] = []
        for number in range(1, model.njoints):
            name = names[number]
            joint = joints[number]
            if _kind(joint) == TYPE.mimic:
                mimic = joint.extract()
                added[name] = leaders[joint.idx_v], float(mimic.scaling), float(mimic.offset)
            elif name not in added:
                positions += range(joint.idx_q, joint.idx_q + joint.nq)
                motions += range(joint.idx_v, joint.idx_v + joint.nv)
            follows = added.get(name)
            about = {"name": name, "parent": int(model.parents[number]), "follows": follows}
            described.append(JointData.of(joint, None if follows is None else follows[1], **about))
        frames = list(model.frames)[1:]
        vectors = dict.fromkeys(POSITION_VECTORS, positions) | dict.fromkeys(MOTION_VECTORS, motions)
        return cls(
            name=str(model.name),
            gravity=model.gravity.vector,
            bodies=int(model.nbodies),
            joints=tuple(described),
            joint_placements=_describe_placements(list(model.jointPlacements)[1:]),
            inertias=_describe_inertias(list(model.inertias)),
            frames=tuple(
                (str(frame.name), frame.type.name, int(frame.parentJoint), int(frame.parentFrame))
                for frame in frames
            ),
            frame_placements=_describe_placements([frame.placement for frame in frames]),
            frame_inertias=_describe_inertias([frame.inertia for frame in frames]),
            vectors={name: np.asarray(getattr(model, name))[kept] for name, kept in vectors.items()},
        )

    def build(self) -> pin.Model:
        """Build the model.

        Raises:
            InvalidValue: a number, index or name is not possible.
        """
        count = len(self.joints)
        rows = {"joint_placements": count, "inertias": count + 1}
        rows |= dict.fromkeys(("frame_placements", "frame_inertias"), len(self.frames))
        for name, needed in rows.items():
            table = getattr(self, name)
            if len(table) != needed:
                raise InvalidValue(f"{name} (shape)", table.shape, f"({needed}, {table.shape[1]})")
        model = pin.Model()
        model.name = self.name
        model.gravity = pin.Motion(self.gravity)
        for number, (entry, placement) in enumerate(
            zip(self.joints, _poses(self.joint_placements), strict=True), 1
        ):
            parent = as_count(f"parent of joint {entry.name!r}", entry.parent, 0, number - 1)
            joint = entry.build()
            if entry.follows is not None:
                joint = _following(model, joint, *entry.follows)
            model.addJoint(parent, joint, placement, entry.name)
        for _ in range(1, self.bodies):
            model.appendBodyToJoint(0, pin.Inertia.Zero(), pin.SE3.Identity())  # which counts them
        for number, row in enumerate(self.inertias):
            model.inertias[number] = _inertia(row)
        frames = zip(self.frames, _poses(self.frame_placements), self.frame_inertias, strict=True)
        for (name, kind, parent, before), placement, row in frames:
            require_known("type of frame", kind, list(pin.FrameType.names))
            joint = as_count(f"joint of frame {name!r}", parent, 0, count)
            previous = as_count(f"frame before frame {name!r}", before, 0, len(self.frames))
            frame = pin.Frame(name, joint, previous, placement, pin.FrameType.names[kind], _inertia(row))
            model.addFrame(frame, False)
        sizes = dict.fromkeys(POSITION_VECTORS, model.nq) | dict.fromkeys(MOTION_VECTORS, model.nv)
        for name, vector in self.vectors.items():
            if vector.shape != (sizes[name],):
                raise InvalidValue(name, vector, f"{sizes[name]} numbers")
            setattr(model, name, vector)
        return model


def _kind(joint: Any) -> str:
    return str(joint.shortname()).removeprefix("JointModel")


def _divided(products: Array, ratio: float) -> Array:
    """Return numbers near the quotients of which the ratio makes exactly these products, if there are such.

    A mimic joint tells only the product of its axis and its ratio. Equal products give equal quotients here,
    so that a model does not change when it is described and built again.
    """
    quotients = products / ratio
    rounded = quotients.copy()
    above = quotients
    below = quotients
    for _ in range(2):  # a product and a quotient are rounded by half a unit each
        above = np.nextafter(above, np.inf)
        below = np.nextafter(below, -np.inf)
        for near in (above, below):
            rounded = np.where((ratio * rounded != products) & (ratio * near == products), near, rounded)
    return np.asarray(rounded)


def _endless_joint(axis: Array) -> pin.JointModel:
    """Return a joint without limits about an axis.

    Python can make one (Pinocchio 4.1) from a description only. Its axis is normalized, which can change the
    last digit, but not for every multiple of the axis.
    """
    described = (
        '<robot name="r"><link name="a"/><link name="b"/><joint name="j" type="continuous"><parent link="a"/>'
        '<child link="b"/><axis xyz="{!r} {!r} {!r}"/></joint></robot>'
    )
    for multiple in range(1, 20_000, 2):  # of 2,000 random axes the worst took 1,031
        model = pin.buildModelFromXML(described.format(*(multiple * axis).tolist()))
        joint = model.joints[1]
        if np.array_equal(np.ravel(joint.createData().S)[3:], axis):
            break
    return pin.JointModel(joint)


def _following(
    model: pin.Model, joint: pin.JointModel, name: str, ratio: float, offset: float
) -> pin.JointModel:
    """Return a joint that follows one of a model."""
    plain = {
        str(model.names[number]): joint
        for number, joint in enumerate(model.joints)
        if number and joint.nv == 1 and _kind(joint) != TYPE.mimic
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


def _describe_placements(placements: Sequence[pin.SE3]) -> Array:
    """Return the first three rows of the homogeneous matrix of each, (n, 12)."""
    matrices = [np.asarray(placement.homogeneous)[:3].ravel() for placement in placements]
    return np.array(matrices).reshape(-1, 12)


def _poses(rows: Array | None) -> list[pin.SE3]:
    return [] if rows is None else [pin.SE3(row[:, :3], row[:, 3]) for row in rows.reshape(-1, 3, 4)]


def _describe_inertias(inertias: Sequence[pin.Inertia]) -> Array:
    """Return mass, centre of mass, and the upper triangle of the moments about it of each, (n, 10)."""
    bodies = [RigidBody.of(inertia) for inertia in inertias]
    upper = np.triu_indices(3)
    return np.array([[body.mass, *body.center, *body.inertia[upper]] for body in bodies]).reshape(-1, 10)


def _inertia(row: Array) -> pin.Inertia:
    moments = np.zeros((3, 3))
    moments[np.triu_indices(3)] = row[4:]
    return RigidBody(float(row[0]), row[1:4], moments + np.triu(moments, 1).T).spatial
