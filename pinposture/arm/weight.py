"""What an arm weighs and carries: payloads, cables, torque limits, and the direction of gravity.

A model is made of a description, which gives the masses of links, and of a `Weight`, which adds to them:
`weighted_model`. Torques of a posture are those of that model, and so is the simulation.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Annotated, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from pydantic import BeforeValidator, ValidationInfo, model_validator
from typing_extensions import Self

from pinposture._validation import LARGEST_NUMBER, SMALLEST_NUMBER, as_floats, is_whole, require_known
from pinposture.arm.configurations import NO_LIMIT
from pinposture.arm.couplings import Drive, is_coupled
from pinposture.arm.inertias import RigidBody, physically_consistent
from pinposture.arm.kinematics import ON_AXIS, Chain, frame_ids, neutral_placements
from pinposture.arm.manipulability import chosen_points
from pinposture.arm.serialization import ModelData
from pinposture.arm.urdf import load_text, parse_xml, read_inertials
from pinposture.errors import InvalidValue, enumerated
from pinposture.schema import (
    Declared,
    NotAllowed,
    Position,
    PositiveNumber,
    Text,
    check,
    declared,
    is_table,
    quantities,
    quantity,
    read_bounded,
    read_by,
    read_within,
    refusing,
)
from pinposture.units import ROUNDING, length_text, number_text

Array = NDArray[np.float64]


class Remedies(NamedTuple):
    """What to do where something is not known."""

    masses: str = "give masses with pp.weigh(arm, density=...), or in the <inertial> of the description"
    effort: str = "give torque limits with arm.with_effort(...), or in the description"
    stiffness: str = "give it with arm.with_stiffness(...)"


REMEDY = Remedies()


def _read_list(value: object) -> object:
    if not isinstance(value, list | tuple):
        raise NotAllowed(value, "a list")
    return value


def _is_point(value: object) -> bool:
    return isinstance(value, str) or is_whole(value)


Listed = BeforeValidator(_read_list)
ControlPoint = Annotated[str | int, check(_is_point, "the name or the index of a control point")]
Mass = Annotated[float, quantity("mass", least=0.0)]
_Moments = Annotated[tuple[float, ...], quantities("moment of inertia", 6)]
_Effort = ("torque", "force")
_Stiffness = ("stiffness of turning", "stiffness")


@declared()
class Load(Declared):
    """A rigid mass that is fixed to the arm.

    Attributes:
        mass: its mass [kg].
        com: its centre of mass in the frame that carries it, x, y, z [m].
        frame: the link, control point or joint that carries it, by name; the tip of the arm if None.
        inertia: moments about the centre of mass, axes of the frame, xx, yy, zz, xy, xz, yz [kg m^2]; zeros
            for a point.

    Raises:
        InvalidValue: a mass that is negative, or moments that no solid of this mass has.
    """

    mass: Mass
    com: Position = (0.0, 0.0, 0.0)
    frame: Text | None = None
    inertia: _Moments = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)

    @model_validator(mode="after")
    def _solid(self) -> Self:
        moments = self.body().inertia
        if not np.any(moments):
            return self
        least = float(np.linalg.eigvalsh(np.trace(moments) / 2.0 * np.eye(3) - moments)[0])
        if self.mass == 0.0 or least < -1e-9 * float(np.abs(moments).max()):
            allowed = "moments of a solid of this mass: none above the sum of the other two"
            raise InvalidValue("inertia", self.inertia, allowed)
        return self

    def body(self) -> RigidBody:
        """Return it as a rigid body."""
        xx, yy, zz, xy, xz, yz = self.inertia
        moments = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        return RigidBody(self.mass, np.array(self.com), moments)


@declared()
class Cable(Declared):
    """A mass that is distributed evenly along the arm: a cable, a hose, a sleeve.

    It follows the straight lines between joints, and is cut where modules end.

    Attributes:
        mass_per_length: its mass per length of arm [kg/m].
        start: the control point from which it runs, by name or index, 0-based; the first joint if None.
        end: the control point at which it ends.
    """

    mass_per_length: Annotated[float, quantity("mass per length", least=0.0)]
    start: ControlPoint | None = None
    end: ControlPoint = -1


def _of_drives(value: object, kinds: Sequence[str], what: str) -> float | dict[str, float]:
    """Read a positive quantity of every drive: one number, or numbers by name of the joint."""
    if not is_table(value):
        return read_bounded(value, kinds, above=0.0)
    if not all(isinstance(name, str) for name in value):  # type: ignore[attr-defined]
        raise NotAllowed(value, f"names of joints and their {what}")
    listed: Mapping[str, object] = value  # type: ignore[assignment]
    return {name: read_within(name, read_bounded, number, kinds, 0.0) for name, number in listed.items()}


def _read_effort(value: object, _: ValidationInfo) -> float | dict[str, float]:
    return _of_drives(value, _Effort, "limits")


Matrix = tuple[tuple[float, ...], ...]
"""Rows of a matrix."""


def _read_stiffness(value: object, _: ValidationInfo) -> float | dict[str, float] | Matrix:
    if not isinstance(value, list | tuple | np.ndarray):
        return _of_drives(value, _Stiffness, "stiffness")
    allowed = "one number, numbers by name of the joint, or a symmetric and positive definite matrix"
    with refusing():
        matrix = as_floats("stiffness", value, allowed)
    if matrix.ndim != 2 or not matrix.size or len(matrix) != len(matrix.T):
        raise NotAllowed(value, allowed)
    if not np.all(np.abs(matrix) <= LARGEST_NUMBER):
        raise NotAllowed(value, "finite numbers")
    if np.abs(matrix - matrix.T).max() > ROUNDING * np.abs(matrix).max():
        raise NotAllowed(value, "a symmetric matrix")
    diagonal = np.diagonal(matrix)
    if diagonal.min() < SMALLEST_NUMBER or not is_definite(scaled(matrix, 1.0 / np.sqrt(diagonal))):
        raise NotAllowed(value, "a positive definite matrix, in which a stiffness holds every motion")
    return tuple(tuple(row) for row in ((matrix + matrix.T) / 2.0).tolist())


def scaled(matrix: Array, units: Array) -> Array:
    """Return a matrix of pairs of joints, (n, n), with their motions in other units, (n,)."""
    return np.asarray(units[:, None] * matrix * units)


def is_definite(matrix: Array) -> bool:
    """Check whether a symmetric matrix, (n, n), is positive definite by more than rounding."""
    return bool(np.linalg.eigvalsh(matrix)[0] > ROUNDING)


@declared()
class Weight(Declared):
    """What is known of the weight of an arm beyond its description.

    Attributes:
        masses: masses of links to which the description gives none.
        payloads: what the arm carries.
        cables: masses that are distributed along the arm.
        density: density of the shapes from which `masses` were computed [kg/m^3]; None: from none.
        effort: largest torque or force of each drive [N m or N], one number, or numbers by name of the joint;
            that of the description if None.
        stiffness: torque or force per displacement of each drive from its command [N m/rad or N/m]: one
            number, or numbers by name of the joint; or that of all degrees of freedom, (nv, nv), where
            tendons hold several joints. Unknown if None.
        gravity: gravitational acceleration, world frame, (3,) [m/s^2]; that of the model if None, usually
            9.81 along -z.
    """

    masses: Annotated[tuple[Load, ...], Listed] = ()
    payloads: Annotated[tuple[Load, ...], Listed] = ()
    cables: Annotated[tuple[Cable, ...], Listed] = ()
    density: PositiveNumber | None = None
    effort: Annotated[float | dict[str, float], read_by(_read_effort)] | None = None
    stiffness: Annotated[float | dict[str, float] | Matrix, read_by(_read_stiffness)] | None = None
    gravity: Annotated[tuple[float, ...], quantities("acceleration", 3)] | None = None


NOTHING = Weight()
"""Nothing is known beyond the description."""


class Added(NamedTuple):
    """A mass fixed to a link, or where no link is named to the body that a joint moves."""

    link: str | None
    joint: str
    placement: pin.SE3  # in the frame of the joint, of the frame to which the inertia refers
    inertia: pin.Inertia


def added_masses(
    weight: Weight, model: pin.Model, chain: Chain, control_points: Sequence[str], tip: str
) -> tuple[Added, ...]:
    """Return the masses that a weight adds to a model.

    Args:
        weight: the weight.
        model: the model of the arm.
        chain: its chain.
        control_points: names of its control points.
        tip: name of the frame of loads that name none.

    Raises:
        UnknownName: a frame or a control point does not exist.
        InvalidValue: a frame that no joint moves, or a cable without length.
    """
    added = []
    for load in (*weight.masses, *weight.payloads):
        name = tip if load.frame is None else load.frame
        frame = find_frame(model, name)
        if frame.parentJoint == 0:
            raise InvalidValue("frame", name, "a frame that a joint of the arm moves")
        link = name if frame.type == pin.FrameType.BODY else None
        joint = str(model.names[frame.parentJoint])
        added.append(Added(link, joint, frame.placement, load.body().spatial))
    for cable in weight.cables:
        added.extend(_along_chain(cable, model, chain, control_points))
    return tuple(added)


def find_frame(model: pin.Model, name: str) -> pin.Frame:
    """Return a frame of a model by name; of a joint, even if the model lists no frames of joints.

    Raises:
        UnknownName: there is no such frame.
    """
    if not model.existFrame(name) and model.existJointName(name):
        return pin.Frame(name, model.getJointId(name), pin.SE3.Identity(), pin.FrameType.JOINT)
    return model.frames[frame_ids(model, [name])[0]]


def _along_chain(cable: Cable, model: pin.Model, chain: Chain, control_points: Sequence[str]) -> list[Added]:
    """Return the rods of a cable: from each joint to the next, by the control point where a module ends."""
    (last,) = chosen_points(control_points, [cable.end])
    stop = chain.module_slices[last].stop
    start = 0
    if cable.start is not None:
        (first,) = chosen_points(control_points, [cable.start])
        start = chain.module_slices[first].stop - 1
        if last <= first:
            raise InvalidValue("cable", cable, "an end farther along the arm than its start")
    ends = {part.stop - 1: k for k, part in enumerate(chain.module_slices)}
    placements = neutral_placements(model)
    added = []
    for u in range(start, stop):
        nodes = [] if u == start and cable.start is not None else [chain.origins[u]]
        if u in ends:
            nodes.append(chain.points[ends[u]])
        if u + 1 < stop:
            nodes.append(chain.origins[u + 1])
        joint = model.getJointId(chain.joints[u])
        for one, other in pairwise(placements[joint].actInv(node) for node in nodes):
            rod = rod_body(cable.mass_per_length, one, other).spatial
            added.append(Added(None, chain.joints[u], pin.SE3.Identity(), rod))
    return added


def rod_body(mass_per_length: float, start: Array, end: Array) -> RigidBody:
    """Return a thin rod between two points, (3,) [m], of a mass per length [kg/m]."""
    along = end - start
    length = float(np.linalg.norm(along))
    mass = mass_per_length * length
    moments = mass / 12.0 * (length**2 * np.eye(3) - np.outer(along, along))
    return RigidBody(mass, (start + end) / 2.0, moments)


def weighted_model(model: pin.Model, weight: Weight, added: Sequence[Added]) -> pin.Model:
    """Return a model with a weight; the same model if it adds nothing."""
    if not added and weight.gravity is None:
        return model
    made = ModelData.of(model).build()
    add_masses(made, added)
    if weight.gravity is not None:
        made.gravity = pin.Motion(np.array(weight.gravity), np.zeros(3))
    return made


def add_masses(model: pin.Model, added: Sequence[Added]) -> None:
    """Add masses to a model of the same arm, whichever of its joints are locked; writes to the model."""
    links = {frame.name: frame for frame in model.frames if frame.type == pin.FrameType.BODY}
    for load in added:
        joint = model.getJointId(load.joint)
        placement = load.placement
        if load.link in links:
            joint = links[load.link].parentJoint
            placement = links[load.link].placement
        model.inertias[joint] = model.inertias[joint] + placement.act(load.inertia)


# Torque limits.


def effort_limits(model: pin.Model, weight: Weight, drives: Sequence[Drive]) -> Array:
    """Return the largest torque or force along each degree of freedom, (nv,) [N m or N]; infinite if unknown.

    Where a drive moves coupled joints, its limit is that of the leader of the arm, by virtual work.

    Raises:
        UnknownName: a joint does not exist.
    """
    limits = np.minimum(np.asarray(model.upperEffortLimit), -np.asarray(model.lowerEffortLimit))
    limits = np.where((limits > 0.0) & (limits < NO_LIMIT), limits, np.inf)
    if weight.effort is not None:
        for column, limit in _along_leaders(weight.effort, model, drives, 1).items():
            limits[column] = limit
    return limits


def _along_leaders(
    per_drive: float | dict[str, float], model: pin.Model, drives: Sequence[Drive], power: int
) -> dict[int, float]:
    """Return values of drives as those of degrees of freedom, by index.

    Args:
        per_drive: one value of all drives, or values by name of the joint.
        model: the model of the arm.
        drives: its drives of coupled joints.
        power: of the ratio of a drive in the value along the leader: 1 of a torque, 2 of a stiffness.

    Raises:
        UnknownName: a joint does not exist.
    """
    names = [str(name) for name in list(model.names)[1:]]
    columns = {
        name: model.joints[k].idx_v for k, name in enumerate(names, 1) if not is_coupled(model.joints[k])
    }
    shares = {name: (column, 1.0) for name, column in columns.items()}
    driven = {drive.joint: (columns[drive.leader], abs(drive.ratio) ** power) for drive in drives}
    if not isinstance(per_drive, dict):
        return {column: per_drive * share for column, share in [*shares.values(), *driven.values()]}
    values = {}
    for name, value in per_drive.items():
        require_known("moving joint", name, shares | driven)
        column, share = (shares | driven)[name]
        values[column] = value * share
    return values


# Stiffness.


def stiffness_matrix(
    model: pin.Model,
    given: float | dict[str, float] | Matrix,
    drives: Sequence[Drive],
    in_metres: NDArray[np.bool_],
) -> Array:
    """Return the torque or force per displacement of the degrees of freedom, (nv, nv) [N m/rad or N/m].

    Where a drive moves coupled joints, its stiffness is that along the leader of the arm, by virtual work.

    Args:
        model: the model of the arm.
        given: as in `Weight`.
        drives: its drives of coupled joints.
        in_metres: which degrees of freedom slide, (nv,).

    Returns:
        The matrix; zero on the diagonal where it is not known.

    Raises:
        UnknownName: a joint does not exist.
        InvalidValue: a matrix of another size, or one number for joints that turn and joints that slide.
    """
    if isinstance(given, tuple):
        if len(given) != model.nv:
            shape = len(given), len(given)
            raise InvalidValue("stiffness (shape)", shape, f"({model.nv}, {model.nv}), of the arm")
        return np.array(given)
    if isinstance(given, float) and np.any(in_metres) and not np.all(in_metres):
        allowed = "numbers by name of the joint, as some joints turn [N m/rad] and others slide [N/m]"
        raise InvalidValue("stiffness", given, allowed)
    stiffness = np.zeros((model.nv, model.nv))
    for column, value in _along_leaders(given, model, drives, 2).items():
        stiffness[column, column] = value
    return stiffness


# What is not known, and what is impossible.


def links_without_mass(
    model: pin.Model, urdf: str | None, weight: Weight, chain: Chain, control_points: Sequence[str]
) -> list[str]:
    """Return the links that joints move and whose masses are not known; joints where links have no names.

    A link without mass is a mere frame if it has no shape, and is fixed to one with mass or between joints at
    one place.

    Args:
        model: the model of the description alone.
        urdf: the description; None if there is only the model.
        weight: what is known beyond it.
        chain: the chain of the arm.
        control_points: names of its control points.

    Raises:
        URDFError: an impossible number in the description; names the link.
    """
    known = {load.frame for load in weight.masses}
    carried = carried_links(model)
    lacking: list[str] = []
    if urdf is not None:
        text, source = load_text(urdf)
        massive = {name for name, body in read_inertials(text, source).items() if body.mass > 0.0}
        moved = {link for links in carried.values() for link in links}
        lacking = [name for name in shaped_links(text) if name in moved - massive - known]
    for joint in _extended(model, chain, control_points):
        names = carried.get(joint, []) or [str(model.names[joint])]
        if model.inertias[joint].mass <= 0.0 and not known & {*names} and not {*lacking} & {*names}:
            lacking.append(names[0])
    return lacking


def parts_without_mass(model: pin.Model, weight: Weight, lacking: Sequence[str]) -> list[str]:
    """Return which of the links without mass are fixed to links with mass: stickers, covers, flanges.

    Descriptions often count such a part with the link that carries it.

    Args:
        model: the model of the description alone.
        weight: what is known beyond it.
        lacking: what `links_without_mass` returns.
    """
    known = {load.frame for load in weight.masses if load.mass > 0.0}
    massive: set[str] = set()
    for joint, names in carried_links(model).items():
        if model.inertias[joint].mass > 0.0 or known & {*names}:
            massive |= {*names}
    return [name for name in lacking if name in massive]


def carried_links(model: pin.Model) -> dict[int, list[str]]:
    """Return the names of the links that each joint carries, by its index."""
    carried: dict[int, list[str]] = {}
    for frame in model.frames:
        if frame.type == pin.FrameType.BODY and frame.parentJoint:
            carried.setdefault(int(frame.parentJoint), []).append(str(frame.name))
    return carried


def check_masses(model: pin.Model, urdf: str | None, length: float) -> list[str]:
    """Return warnings about moments of inertia that no solid has, and centres of mass that are far away.

    Args:
        model: the model of the description alone.
        urdf: the description; None if there is only the model.
        length: length of the arm [m].

    Raises:
        URDFError: an impossible number in the description; names the link.
        InvalidValue: an impossible mass in a model; names the joint.
    """
    if urdf is not None:
        moved = {link for links in carried_links(model).values() for link in links}
        bodies = {name: body for name, body in read_inertials(*load_text(urdf)).items() if name in moved}
    else:
        bodies = {}
        for name, inertia in zip(list(model.names)[1:], list(model.inertias)[1:], strict=True):
            body = RigidBody.of(inertia)
            if not 0.0 <= body.mass < np.inf or not np.all(np.isfinite(body.center)):
                stated = body.mass, *body.center.tolist()
                allowed = "a finite mass, 0 or more [kg], and a finite centre of mass"
                raise InvalidValue(f"inertia of joint {str(name)!r}", stated, allowed)
            bodies[str(name)] = body
    warnings = []
    solid = {name: physically_consistent(body)[1] for name, body in bodies.items() if body.mass > 0.0}
    unphysical = [repr(name) for name, fault in solid.items() if fault]
    if unphysical:
        no = f"no solid has the moments of inertia of {enumerated(unphysical)}"
        warnings.append(f"{no}; torques at rest do not depend on them")
    for name, body in bodies.items():
        away = float(np.linalg.norm(body.center))
        if body.mass > 0.0 and away > 2.0 * length:  # may be a mistake
            where = f"{length_text(away)} from its frame, {away / length:.3g} times the length of the arm"
            warnings.append(f"the centre of mass of {name!r} is {where}; is it in millimetres, not metres?")
    return warnings


def shaped_links(text: str) -> list[str]:
    """Return the names of the links of a URDF that have shapes."""
    links = parse_xml(text, "URDF text").iterfind("link")
    return [
        link.get("name", "")
        for link in links
        if link.find("visual") is not None or link.find("collision") is not None
    ]


def _extended(model: pin.Model, chain: Chain, control_points: Sequence[str]) -> list[int]:
    """Return the joints that carry bodies with an extent: to another joint, or to a control point."""
    ends = [(model.parents[joint], model.jointPlacements[joint]) for joint in range(1, model.njoints)]
    for index in frame_ids(model, control_points):
        frame = model.frames[index]
        ends.append((frame.parentJoint, frame.placement))
    least = ON_AXIS * chain.length
    return sorted({int(joint) for joint, end in ends if joint and np.linalg.norm(end.translation) > least})


# Torques beyond their limits.


class JointLoad(NamedTuple):
    """The torque, or force, that a joint needs to hold the arm, and its limit.

    Attributes:
        joint: its name; of coupled joints, that of the one that is driven.
        needed: the torque that holds the arm [N m or N].
        limit: the largest that its drive has [N m or N].
        slides: whether it slides.
    """

    joint: str
    needed: float
    limit: float
    slides: bool

    @property
    def share(self) -> float:
        """The torque in relation to its limit."""
        return self.needed / self.limit

    @property
    def exceeded(self) -> bool:
        """Whether the drive has not enough."""
        return self.share > 1.0 + ROUNDING

    @property
    def unit(self) -> str:
        """Unit of both."""
        return "N" if self.slides else "N m"

    def as_data(self) -> dict[str, str | float]:
        """Return it as data for JSON."""
        return {name: getattr(self, name) for name in ("joint", "needed", "limit", "unit", "share")}

    def __str__(self) -> str:
        needed = number_text(self.needed)
        return f"joint {self.joint!r} needs {needed} of {number_text(self.limit)} {self.unit}"


def load_of(drive: Drive, torque: float, limit: float) -> JointLoad:
    """Return the load of the drive behind a degree of freedom.

    Args:
        drive: the drive.
        torque: size of the torque or force along the degree of freedom [N m or N].
        limit: the largest one [N m or N].
    """
    ratio = abs(drive.ratio)
    return JointLoad(drive.joint, torque / ratio, limit / ratio, not drive.turns)


def heaviest_load(drives: Sequence[Drive], torques: Array, limits: Array) -> JointLoad:
    """Return the load of the drive that needs most of its limit.

    Args:
        drives: the drive behind each degree of freedom.
        torques: the torques or forces along them, (nv,) [N m or N].
        limits: the largest ones, (nv,) [N m or N].
    """
    needed = np.abs(torques)
    worst = int((needed / limits).argmax())
    return load_of(drives[worst], float(needed[worst]), float(limits[worst]))


class HeldOut(NamedTuple):
    """How far an arm can be held straight out, with gravity from whichever direction is worst for a joint.

    Attributes:
        length: length of the part towards the tip that its joints hold [m].
        load: the joint that gives up first: the nearest to the tip that has not enough, or if all have, the
            one that is loaded most.
        payload: mass that can be added at the tip until a joint gives up [kg]; 0 if one does without it.
    """

    length: float
    load: JointLoad
    payload: float


def largest_payload(held: Array, lever: Array, effort: Array) -> float:
    """Return the mass that joints can carry in addition, with gravity from the worst direction [kg].

    Args:
        held: torque per unit of gravity along x, y, z, (n, 3) [kg m or kg].
        lever: the same per unit of added mass, (n, 3) [m, or 1 where a joint slides].
        effort: largest torque per size of gravity, (n,) [kg m or kg].
    """
    # The largest torque of joint u is |held_u + m lever_u|, and reaches its limit at the larger root.
    a = np.sum(lever**2, axis=1)
    b = np.sum(held * lever, axis=1)
    c = np.sum(held**2, axis=1) - effort**2
    if np.any(c > 0.0):
        return 0.0
    carries = a > 0.0
    roots = (np.sqrt(b**2 - a * c) - b)[carries] / a[carries]
    return float(roots.min(initial=np.inf))
