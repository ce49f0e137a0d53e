"""MJCF as MuJoCo compiles it, written as URDF.

MuJoCo itself reads the file: includes, attached models, frames, composites, defaults, angles, meshes. The
compiled model has bodies, joints, sites, shapes and constraints, which become links, joints and <mimic>. What
ties joints to each other in a way that a serial chain cannot represent is written beside the joint
(<excluded reason="...">), so that only a chain that contains it is refused.
"""

from __future__ import annotations

import re
import warnings
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from importlib import import_module
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import quote

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from pinposture._validation import LARGEST_NUMBER, entries_beyond
from pinposture.arm.configurations import NO_LIMIT
from pinposture.arm.description import Description, read_description
from pinposture.arm.inertias import RigidBody
from pinposture.arm.urdf import (
    Follows,
    JointDescription,
    ShapeDescription,
    free_name,
    numbers_text,
    quote_names,
    write_inertial,
    write_joint,
    write_shape,
)
from pinposture.errors import FileError, PostureError, URDFError, install
from pinposture.storage import read_xml
from pinposture.units import ROUNDING, length_text

Array = NDArray[np.float64]

SAMPLES = 10
"""Configurations at which the kinematics is compared with MuJoCo's."""

REPORT = "the file is not used; please report it"

_COMMENT = r"<!--(?:(?!-->).)*-->"


class MujocoMissing(PostureError, ImportError):
    """MuJoCo is not installed or cannot be loaded.

    Attributes:
        reason: the message of the failed import.
    """

    def __init__(self, purpose: str, reason: str) -> None:
        self.reason = reason
        super().__init__(f"{purpose} needs MuJoCo ({reason}); install it with: {install('sim')}")


def load_mujoco(purpose: str = "physics") -> Any:
    """Import MuJoCo, an optional dependency.

    Args:
        purpose: what needs it, for the message.

    Raises:
        MujocoMissing: MuJoCo is not installed.
    """
    try:
        return import_module("mujoco")
    except ImportError as error:
        raise MujocoMissing(purpose, str(error)) from None


@contextmanager
def no_log_file(mujoco: Any) -> Iterator[None]:
    """Keep MuJoCo from writing MUJOCO_LOG.TXT to the working directory; faults are reported elsewhere."""
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(lambda _: None)
    try:
        yield
    finally:
        mujoco.set_mju_user_warning(before)


def is_mjcf(text: str) -> bool:
    """Return whether the root element of XML is <mujoco>; URDF may contain such an element, too."""
    root = rf"(?:\s|<\?(?:(?!\?>).)*\?>|{_COMMENT}|<!DOCTYPE[^>]*>)*<mujoco"
    return re.match(root, text.lstrip("\ufeff"), re.DOTALL) is not None


def mjcf_to_urdf(source: str | Path, label: str) -> str:
    """Read MJCF with MuJoCo and write it as URDF.

    Bodies and named sites become links, under their names; the world is the root. Hinges and slides become
    joints with their names, limits, and positions as in MuJoCo, reference positions included; a body with
    several joints becomes as many links. Equalities that are linear in two joints become <mimic>. Shapes that
    collide become <collision>, in their place a box or capsule around them where URDF has no such shape, and
    visible meshes become <visual>; shapes of the world are left out. Also written: masses, damping, dry
    friction, effort and speed limits that follow from actuators. Not written: armature, springs, contacts,
    gravity, keyframes.

    Args:
        source: path of the file, or its text.
        label: name of the source in error messages.

    Returns:
        URDF text. Names of mesh files in or below the folder of the file are relative to it.

    Raises:
        MujocoMissing: MuJoCo is not installed.
        FileError: MuJoCo rejects the source, or there is more than one model in it.
        URDFError: MuJoCo's kinematics or limits differ from those of the URDF.
    """
    mujoco = load_mujoco(f"{label}: MJCF")
    _require_one_model(read_xml(source) if isinstance(source, Path) else source, label)
    with _quiet(mujoco):
        try:
            if isinstance(source, Path):
                model = mujoco.MjModel.from_xml_path(str(source.absolute()))
            else:
                model = mujoco.MjModel.from_xml_string(source.lstrip("\ufeff"))
        except (ValueError, RuntimeError, mujoco.FatalError) as error:
            raise FileError(label, f"was rejected by MuJoCo ({' '.join(str(error).split())})") from None
        try:
            bytes(model.names).decode()
        except UnicodeDecodeError:
            reason = "has names that are not UTF-8, the only encoding that MuJoCo reads; save it as UTF-8"
            raise FileError(label, reason) from None
        compiled = _Compiled(mujoco, model, _read_names(mujoco, model))
        _require_finite_masses(compiled, label)
        text = _write(compiled, _mesh_files(compiled, source))
        description = read_description(text, label)
        _compare_limits(compiled, description)
        _compare_kinematics(compiled, description)
    return text


def _require_finite_masses(compiled: _Compiled, label: str) -> None:
    model = compiled.model
    numbers = np.column_stack([model.body_mass, model.body_inertia, model.body_ipos])
    for body, _ in entries_beyond(numbers, LARGEST_NUMBER)[:1]:
        reason = f"its mass or inertia is not finite, or above {LARGEST_NUMBER:g}"
        raise URDFError(label, f"body {compiled.names.bodies[body]!r}", reason)


def _require_one_model(text: str, label: str) -> None:
    """Raise FileError if there is content after the first root element, which MuJoCo would ignore."""
    _, _, after = re.sub(_COMMENT, "", text, flags=re.DOTALL).partition("</mujoco>")
    if after.strip():
        reason = f"has content after </mujoco>, which MuJoCo ignores: {after.strip()[:40]!r}"
        raise FileError(label, f"{reason}; keep one model, and <attach> or <include> others")


@contextmanager
def _quiet(mujoco: Any) -> Iterator[None]:
    """Suppress what MuJoCo warns about: contacts, textures and soft bodies, which we do not use."""
    with no_log_file(mujoco), warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        yield


class _Names(NamedTuple):
    """Names of links and joints by index in the compiled model, for those without a name, too."""

    bodies: list[str]
    joints: list[str]
    sites: dict[int, str]  # of those that have a name
    links: set[str]  # names of links in use
    taken: set[str]  # names of joints in use


class _Compiled(NamedTuple):
    """A compiled model."""

    mujoco: Any  # the module
    model: Any  # the `mujoco.MjModel`
    names: _Names

    def disables(self, what: str) -> bool:
        """Return whether the model disables a part of the physics, such as "LIMIT"."""
        bits = self.mujoco.mjtDisableBit
        disabled = getattr(bits, f"mjDSBL_{what}") | bits.mjDSBL_CONSTRAINT
        return bool(self.model.opt.disableflags & disabled)

    def name(self, kind: str, index: int) -> str:
        """Return the name of an object, such as an "EQUALITY", or its number."""
        label = self.mujoco.mj_id2name(self.model, getattr(self.mujoco.mjtObj, f"mjOBJ_{kind}"), index)
        return repr(label) if label else f"number {index + 1}"

    def moves_one_way(self, joint: int) -> bool:
        """Return whether a joint is a hinge or a slide."""
        kinds = self.mujoco.mjtJoint
        return int(self.model.jnt_type[joint]) in (kinds.mjJNT_HINGE, kinds.mjJNT_SLIDE)

    def turns(self, joint: int) -> bool:
        return bool(self.model.jnt_type[joint] == self.mujoco.mjtJoint.mjJNT_HINGE)

    def reference(self, joint: int) -> float:
        """Return the position of a hinge or slide at which its body is where the file places it."""
        return float(self.model.qpos0[self.model.jnt_qposadr[joint]])

    def joints_of(self, body: int) -> range:
        first = int(self.model.body_jntadr[body])
        return range(first, first + int(self.model.body_jntnum[body]))

    def edges(self, joint: int) -> tuple[float, float]:
        """Return the smallest and the largest position of a joint; infinite without limits."""
        if not self.model.jnt_limited[joint] or self.disables("LIMIT"):
            return -np.inf, np.inf
        lower, upper = map(float, self.model.jnt_range[joint])
        return lower, upper


class _Follows(NamedTuple):
    """A linear equality: position = ratio * position of another joint + offset."""

    joint: int
    ratio: float
    offset: float


class _Ties(NamedTuple):
    """What ties joints to each other, by joint index."""

    follows: dict[int, _Follows]
    held: dict[int, float]  # position at which an equality holds a joint [rad or m]
    reasons: dict[int, str]  # why a joint cannot be on a chain


def _read_names(mujoco: Any, model: Any) -> _Names:
    def name(kind: Any, index: int) -> str:
        return str(mujoco.mj_id2name(model, kind, index) or "")

    objects = mujoco.mjtObj
    bodies = [name(objects.mjOBJ_BODY, index) for index in range(model.nbody)]
    links = set(bodies)
    bodies = [body or free_name(f"body_{index}", links) for index, body in enumerate(bodies)]
    joints = [name(objects.mjOBJ_JOINT, index) for index in range(model.njnt)]
    taken = set(joints)
    owners = [bodies[body] for body in model.jnt_bodyid]
    joints = [
        joint or free_name(f"{owner}_joint", taken) for joint, owner in zip(joints, owners, strict=True)
    ]
    sites = {}
    for index in range(model.nsite):
        label = name(objects.mjOBJ_SITE, index)
        if label:
            sites[index] = free_name(f"{label}_site" if label in links else label, links)
    return _Names(bodies, joints, sites, links, taken)


# Constraints.


def _read_ties(compiled: _Compiled) -> _Ties:
    ties = _Ties({}, {}, {})
    model = compiled.model
    kinds = compiled.mujoco.mjtJoint
    for joint in np.flatnonzero(model.jnt_type == kinds.mjJNT_BALL):
        advice = "put three hinges in its place, or choose base= and tip= on one side of it"
        ties.reasons[int(joint)] = f"is a ball joint, with three degrees of freedom in one; {advice}"
    if not compiled.disables("EQUALITY"):
        for equality in np.flatnonzero(model.eq_active0):
            _read_equality(compiled, int(equality), ties)
    for tendon in range(model.ntendon):
        _read_tendon(compiled, tendon, ties)
    return ties


def _read_equality(compiled: _Compiled, equality: int, ties: _Ties) -> None:
    model = compiled.model
    kinds = compiled.mujoco.mjtEq
    kind = int(model.eq_type[equality])
    name = compiled.name("EQUALITY", equality)
    ends = (int(model.eq_obj1id[equality]), int(model.eq_obj2id[equality]))
    if kind == kinds.mjEQ_JOINT:
        _read_coupling(compiled, equality, ties)
    elif kind in (kinds.mjEQ_CONNECT, kinds.mjEQ_WELD):
        if model.eq_objtype[equality] == compiled.mujoco.mjtObj.mjOBJ_SITE:
            ends = (int(model.site_bodyid[ends[0]]), int(model.site_bodyid[ends[1]]))
        called = "weld" if kind == kinds.mjEQ_WELD else "connect"
        bodies = " and ".join(repr(compiled.names.bodies[body]) for body in ends)
        what = f"is part of a loop that the <{called}> {name} between bodies {bodies} closes"
        _exclude(compiled, _joints_between(compiled, *ends), what, f"the <{called}>", ties)
    elif kind == kinds.mjEQ_TENDON:
        for tendon in ends:
            if tendon >= 0:
                what = f"is coupled by the <equality> {name} of tendon {compiled.name('TENDON', tendon)}"
                _exclude(compiled, _joints_of_tendon(compiled, tendon), what, "the <equality>", ties)


def _read_coupling(compiled: _Compiled, equality: int, ties: _Ties) -> None:
    """Read an equality of joints: q1 - reference = a0 + a1 (q2 - reference) + a2 (...)^2 + ..."""
    model = compiled.model
    joint = int(model.eq_obj1id[equality])
    leader = int(model.eq_obj2id[equality])
    constant, slope, *others = map(float, model.eq_data[equality][:5])
    offset = compiled.reference(joint) + constant
    name = compiled.name("EQUALITY", equality)
    if joint in ties.follows or joint in ties.held:
        what = f"follows more than one joint, by the <equality> {name} and another"
        _exclude(compiled, [joint], what, "one of them", ties)
    elif leader < 0 or (slope == 0.0 and not any(others)):
        ties.held[joint] = offset
    elif any(others):
        what = f"follows joint {compiled.names.joints[leader]!r} by a polynomial, the <equality> {name}"
        _exclude(compiled, [joint], f"{what}; allowed: a ratio and an offset", "the <equality>", ties)
    else:
        ties.follows[joint] = _Follows(leader, slope, offset - slope * compiled.reference(leader))


def _read_tendon(compiled: _Compiled, tendon: int, ties: _Ties) -> None:
    model = compiled.model
    transmissions = compiled.mujoco.mjtTrn
    joints = _joints_of_tendon(compiled, tendon)
    name = compiled.name("TENDON", tendon)
    if model.tendon_limited[tendon] and not compiled.disables("LIMIT"):
        lower, upper = map(float, model.tendon_range[tendon])
        what = f"is limited by the range ({lower:g} to {upper:g}) of tendon {name}, not only by its own"
        _exclude(compiled, joints, what, "that range", ties)
    pulls = (model.actuator_trntype == transmissions.mjTRN_TENDON) & (model.actuator_trnid[:, 0] == tendon)
    if not pulls.any() or len({_leader(joint, ties.follows) for joint in joints}) < 2:
        return
    direct = np.isin(model.actuator_trntype, [transmissions.mjTRN_JOINT, transmissions.mjTRN_JOINTINPARENT])
    driven = set(model.actuator_trnid[direct, 0].tolist())
    shared = [joint for joint in joints if _leader(joint, ties.follows) not in driven]
    listed = quote_names([compiled.names.joints[joint] for joint in joints])
    what = f"has no actuator of its own, but is driven by tendon {name}, which moves {listed}"
    _exclude(compiled, [joint for joint in shared if joint not in driven], what, "the tendon", ties)


def _leader(joint: int, follows: Mapping[int, _Follows]) -> int:
    """Return the joint at the end of a series of couplings; any joint of a circle."""
    seen = {joint}
    while joint in follows and follows[joint].joint not in seen:
        joint = follows[joint].joint
        seen.add(joint)
    return joint


def _joints_of_tendon(compiled: _Compiled, tendon: int) -> list[int]:
    """Return the joints that change the length of a tendon, in the order of the model."""
    model = compiled.model
    kinds = compiled.mujoco.mjtWrap
    first = int(model.tendon_adr[tendon])
    bodies: list[int] = []
    joints: set[int] = set()
    for wrap in range(first, first + int(model.tendon_num[tendon])):
        kind = int(model.wrap_type[wrap])
        index = int(model.wrap_objid[wrap])
        if kind == kinds.mjWRAP_JOINT:
            joints.add(index)
        elif kind == kinds.mjWRAP_SITE:
            bodies.append(int(model.site_bodyid[index]))
        elif kind in (kinds.mjWRAP_SPHERE, kinds.mjWRAP_CYLINDER):
            bodies.append(int(model.geom_bodyid[index]))
    for one, other in pairwise(bodies):
        joints.update(_joints_between(compiled, one, other))
    return sorted(joints)


def _joints_between(compiled: _Compiled, one: int, other: int) -> list[int]:
    """Return the joints that move two bodies relative to each other; free joints are no part of an arm."""
    apart = set(_bodies_above(compiled, one)) ^ set(_bodies_above(compiled, other))
    joints = [joint for body in sorted(apart) for joint in compiled.joints_of(body)]
    return [joint for joint in joints if compiled.moves_one_way(joint)]


def _bodies_above(compiled: _Compiled, body: int) -> Iterator[int]:
    """Yield a body and those that carry it."""
    while body > 0:
        yield body
        body = int(compiled.model.body_parentid[body])


def _exclude(compiled: _Compiled, joints: Iterable[int], what: str, cause: str, ties: _Ties) -> None:
    for joint in joints:
        name = compiled.names.joints[joint]
        lock = f"lock it (locked={{{name!r}: 0.0}})"
        advice = f"{lock}, leave it off the chain (base=, tip=), or take {cause} out of the file"
        ties.reasons.setdefault(joint, f"{what}; {advice}")


# Links and joints.


def _write(compiled: _Compiled, meshes: Mapping[int, str]) -> str:
    model = compiled.model
    names = compiled.names
    ties = _read_ties(compiled)
    title = bytes(model.names).split(b"\0", 1)[0].decode()
    robot = ET.Element("robot", name=title.strip() or "robot")
    ET.SubElement(robot, "link", name=names.bodies[0])
    for body in range(1, model.nbody):
        _write_body(robot, compiled, body, ties, meshes)
    for site, name in names.sites.items():
        parent = names.bodies[model.site_bodyid[site]]
        ET.SubElement(robot, "link", name=name)
        placement = _placement(model.site_pos[site], model.site_quat[site])
        _fix(robot, names, parent, name, placement)
    ET.indent(robot)
    return ET.tostring(robot, encoding="unicode") + "\n"


def _write_body(
    robot: ET.Element, compiled: _Compiled, body: int, ties: _Ties, meshes: Mapping[int, str]
) -> None:
    """Add the joints of a body, and its link.

    A joint acts about or along an axis through its anchor in the frame of the body, after those before it.
    Each joint frame is at its anchor, so that the last one may not be the frame of the body.
    """
    model = compiled.model
    names = compiled.names
    name = names.bodies[body]
    parent = names.bodies[model.body_parentid[body]]
    at = _placement(model.body_pos[body], model.body_quat[body])
    joints = compiled.joints_of(body)
    for joint in joints:
        anchor = _anchor(compiled, joint)
        last = joint == joints[-1] and not np.any(anchor)
        child = name if last else free_name(f"{names.joints[joint]}_link", names.links)
        if not last:
            ET.SubElement(robot, "link", name=child)
        at = at * pin.SE3(np.eye(3), anchor)
        _write_joint(robot, compiled, joint, (parent, child), at, ties)
        parent = child
        at = pin.SE3(np.eye(3), -anchor)
    link = ET.SubElement(robot, "link", name=name)
    _write_inertia(link, model, body)
    _write_shapes(link, compiled, body, meshes)
    if parent != name:
        reason = None
        if model.body_mocapid[body] >= 0:
            what = f"body {name!r} is a mocap body, which is moved from outside"
            advice = f'start at it (base={name!r}, tip=...), or remove mocap="true"'
            reason = f"cannot be on the chain: {what}; {advice}"
        _fix(robot, names, parent, name, at, reason)


def _write_joint(
    robot: ET.Element,
    compiled: _Compiled,
    joint: int,
    links: tuple[str, str],
    placement: pin.SE3,
    ties: _Ties,
) -> None:
    """Add a joint between two links; ball joints, which URDF has not, as floating joints."""
    model = compiled.model
    name = compiled.names.joints[joint]
    described = JointDescription.placed(name, "floating", *links, placement)
    if compiled.moves_one_way(joint):
        axis = np.array(model.jnt_axis[joint])
        turns = compiled.turns(joint)
        back = -compiled.reference(joint) * axis
        at_zero = pin.SE3(pin.exp3(back), np.zeros(3)) if turns else pin.SE3(np.eye(3), back)
        edges = compiled.edges(joint)
        if joint in ties.held:
            edges = (ties.held[joint], ties.held[joint])
        dof = int(model.jnt_dofadr[joint])
        described = replace(
            JointDescription.placed(name, "", *links, placement * at_zero).driven(
                axis, turns, edges, *_drive_limits(compiled, joint)
            ),
            damping=float(model.dof_damping[dof]),
            friction=float(model.dof_frictionloss[dof]),
        )
    if joint in ties.follows:
        leader, ratio, offset = ties.follows[joint]
        described = replace(described, follows=Follows(compiled.names.joints[leader], ratio, offset))
    write_joint(robot, replace(described, excluded=ties.reasons.get(joint)))


def _fix(
    robot: ET.Element,
    names: _Names,
    parent: str,
    child: str,
    placement: pin.SE3,
    excluded: str | None = None,
) -> None:
    name = free_name(f"{child}_fixed", names.taken)
    fixed = JointDescription.placed(name, "fixed", parent, child, placement)
    write_joint(robot, replace(fixed, excluded=excluded))


def _placement(position: Array, quaternion: Array) -> pin.SE3:
    w, x, y, z = map(float, quaternion)
    return pin.SE3(pin.Quaternion(w, x, y, z).normalized().matrix(), np.array(position))


def _anchor(compiled: _Compiled, joint: int) -> Array:
    """Return the position of a joint in the frame of its body, (3,) [m]; a slide or free joint needs none."""
    kinds = compiled.mujoco.mjtJoint
    if int(compiled.model.jnt_type[joint]) in (kinds.mjJNT_SLIDE, kinds.mjJNT_FREE):
        return np.zeros(3)
    return np.array(compiled.model.jnt_pos[joint])


def _drive_limits(compiled: _Compiled, joint: int) -> tuple[float, float]:
    """Return the largest torque or force and speed of a joint that follow from its actuators, or infinity."""
    model = compiled.model
    transmissions = compiled.mujoco.mjtTrn
    of_joints = np.isin(
        model.actuator_trntype, [transmissions.mjTRN_JOINT, transmissions.mjTRN_JOINTINPARENT]
    )
    drives = [
        _drive(compiled, int(actuator))
        for actuator in np.flatnonzero(of_joints & (model.actuator_trnid[:, 0] == joint))
    ]
    effort = sum(drive.effort for drive in drives) if drives else np.inf
    if model.jnt_actfrclimited[joint]:
        effort = min(effort, _largest(model.jnt_actfrcrange[joint]))
    return effort, min((drive.velocity for drive in drives), default=np.inf)


class _Drive(NamedTuple):
    """Largest torque or force and speed of an actuator, at its joint; infinite if unknown."""

    effort: float
    velocity: float


def _drive(compiled: _Compiled, actuator: int) -> _Drive:
    """Read the ranges of an actuator: of its force, or of its control where that is a force or a speed."""
    model = compiled.model
    mujoco = compiled.mujoco
    gear = abs(float(model.actuator_gear[actuator, 0]))
    if gear == 0.0:
        return _Drive(0.0, np.inf)
    effort = np.inf
    velocity = np.inf
    if model.actuator_forcelimited[actuator]:
        effort = _largest(model.actuator_forcerange[actuator])
    # From MuJoCo 4 on, actuators may have several inputs.
    entry = int(model.actuator_ctrladr[actuator]) if hasattr(model, "actuator_ctrladr") else actuator
    fixed = model.actuator_gaintype[actuator] == mujoco.mjtGain.mjGAIN_FIXED
    if fixed and model.actuator_ctrllimited[entry]:
        command = _largest(model.actuator_ctrlrange[entry])
        gain = float(model.actuator_gainprm[actuator, 0])
        bias = model.actuator_biasprm[actuator, :3].tolist()
        integrates = model.actuator_dyntype[actuator] == mujoco.mjtDyn.mjDYN_INTEGRATOR
        if model.actuator_biastype[actuator] != mujoco.mjtBias.mjBIAS_NONE:
            to_speed = bias[:2] == [0.0, -gain] if integrates else bias == [0.0, 0.0, -gain]
            velocity = command / gear if to_speed else np.inf
        elif not integrates:
            effort = min(effort, abs(gain) * command)
    return _Drive(effort * gear, velocity)


def _largest(interval: Array) -> float:
    return float(np.abs(interval).max())


def _write_inertia(link: ET.Element, model: Any, body: int) -> None:
    placement = _placement(model.body_ipos[body], model.body_iquat[body])
    moments = placement.rotation @ np.diag(model.body_inertia[body]) @ placement.rotation.T
    symmetric = (moments + moments.T) / 2.0
    write_inertial(link, RigidBody(float(model.body_mass[body]), placement.translation, symmetric))


# Shapes.


def _mesh_files(compiled: _Compiled, source: str | Path) -> dict[int, str]:
    """Return the file of each mesh that we can read and that is used as it is in the file, by index.

    Early versions of MuJoCo do not tell the folder of a file; then there are none.
    """
    model = compiled.model
    mujoco = compiled.mujoco
    if isinstance(source, str) or model.nmesh == 0:
        return {}
    folder = source.absolute().parent
    paths = bytes(model.paths)
    straight = _straight_meshes(mujoco, source)
    files: dict[int, str] = {}
    for mesh, start in enumerate(model.mesh_pathadr.tolist()):
        path = Path(paths[start:].split(b"\0", 1)[0].decode(errors="replace")) if start >= 0 else Path()
        # what both MuJoCo and we read
        if not path.is_absolute() or path.suffix.lower() not in (".stl", ".obj") or not path.is_file():
            continue
        if mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_MESH, mesh) not in straight:
            continue
        inside = path.is_relative_to(folder)
        files[mesh] = path.relative_to(folder).as_posix() if inside else f"file://{quote(str(path))}"
    return files


def _straight_meshes(mujoco: Any, source: Path) -> set[str]:
    """Return the names of the meshes that no reference position or orientation moves.

    The compiled model does not tell. Empty if the name of the file does not end in ".xml", as this needs.
    """
    try:
        spec = mujoco.MjSpec.from_file(str(source.absolute()))
    except ValueError:
        return set()
    return {mesh.name for mesh in spec.meshes if not np.any(mesh.refpos) and not np.any(mesh.refquat[1:])}


def _write_shapes(link: ET.Element, compiled: _Compiled, body: int, meshes: Mapping[int, str]) -> None:
    """Add the shapes of a body: those that collide, and the visible meshes."""
    model = compiled.model
    kinds = compiled.mujoco.mjtGeom
    paired = {*model.pair_geom1.tolist(), *model.pair_geom2.tolist()}
    first = int(model.body_geomadr[body])
    for shape in range(first, first + int(model.body_geomnum[body])):
        mesh = int(model.geom_dataid[shape])
        file = meshes.get(mesh) if model.geom_type[shape] == kinds.mjGEOM_MESH else None
        if model.geom_contype[shape] or model.geom_conaffinity[shape] or shape in paired:
            if file is None:
                _write_solid(link, compiled, shape)
            else:
                _write_mesh(link, "collision", model, shape, file)
        if file is not None and model.geom_group[shape] < 3:  # MuJoCo shows those, unless told otherwise
            _write_mesh(link, "visual", model, shape, file)


def _write_mesh(link: ET.Element, kind: str, model: Any, shape: int, file: str) -> None:
    """Add a mesh file; MuJoCo moves the frame of a mesh to its centre and principal axes."""
    mesh = int(model.geom_dataid[shape])
    placement = _placement(model.geom_pos[shape], model.geom_quat[shape])
    moved = _placement(model.mesh_pos[mesh], model.mesh_quat[mesh])
    of_file = placement * moved.inverse()
    scale = {"scale": model.mesh_scale[mesh]}
    write_shape(link, kind, ShapeDescription.placed("mesh", scale, of_file, file))


def _write_solid(link: ET.Element, compiled: _Compiled, shape: int) -> None:
    """Add a shape that collides; where URDF has no such shape, one around it."""
    model = compiled.model
    kinds = compiled.mujoco.mjtGeom
    placement = _placement(model.geom_pos[shape], model.geom_quat[shape])
    kind = int(model.geom_type[shape])
    size = np.array(model.geom_size[shape], dtype=np.float64)
    if kind == kinds.mjGEOM_PLANE:  # only fixed bodies have planes
        return
    if kind == kinds.mjGEOM_SPHERE:
        _add_solid(link, "sphere", placement, radius=float(size[0]))
    elif kind == kinds.mjGEOM_CYLINDER:
        _add_solid(link, "cylinder", placement, radius=float(size[0]), length=2.0 * float(size[1]))
    elif kind == kinds.mjGEOM_CAPSULE:
        _add_capsule(link, placement, float(size[0]), float(size[1]))
    elif kind == kinds.mjGEOM_ELLIPSOID:
        across, along = np.sort(size)[1:]
        turn = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), np.eye(3)[int(size.argmax())])
        lengthwise = placement * pin.SE3(turn.matrix(), np.zeros(3))
        _add_capsule(link, lengthwise, float(across), float(along - across))
    elif kind == kinds.mjGEOM_BOX:
        _add_solid(link, "box", placement, size=2.0 * size)
    else:
        bounds = np.array(model.geom_aabb[shape], dtype=np.float64)
        around = placement * pin.SE3(np.eye(3), bounds[:3])
        _add_solid(link, "box", around, size=2.0 * bounds[3:])


def _add_capsule(link: ET.Element, placement: pin.SE3, radius: float, half: float) -> None:
    """Add a capsule along z, as a cylinder with a sphere at each end; readers of URDF know no capsules."""
    if half > 0.0:
        _add_solid(link, "cylinder", placement, radius=radius, length=2.0 * half)
    for end in sorted({-half, half}):
        at_end = placement * pin.SE3(np.eye(3), np.array([0.0, 0.0, end]))
        _add_solid(link, "sphere", at_end, radius=radius)


def _add_solid(link: ET.Element, kind: str, placement: pin.SE3, **numbers: ArrayLike) -> None:
    write_shape(link, "collision", ShapeDescription.placed(kind, numbers, placement))


# Comparison with MuJoCo.


def _compare_limits(compiled: _Compiled, description: Description) -> None:
    """Raise URDFError if the limits of a joint differ from MuJoCo's, unless an equality holds it."""
    joints = {joint.name: joint for joint in description.joints}
    for joint in filter(compiled.moves_one_way, range(compiled.model.njnt)):
        written = joints[compiled.names.joints[joint]]
        edges = np.clip(compiled.edges(joint), -NO_LIMIT, NO_LIMIT)
        limits = np.clip((written.lower, written.upper), -NO_LIMIT, NO_LIMIT)
        if written.moves and np.any(limits != edges):
            reason = f"would have limits {numbers_text(limits)}, in MuJoCo {numbers_text(edges)}"
            raise URDFError(description.source, f"joint {written.name!r}", f"{reason}; {REPORT}")


def _compare_kinematics(compiled: _Compiled, description: Description) -> None:
    """Raise URDFError if a link is not where MuJoCo places it, in random configurations."""
    mujoco, model, names = compiled
    rng = np.random.default_rng(0)
    configurations = np.tile(model.qpos0, (SAMPLES, 1))
    positions: dict[str, Array] = {}
    for joint in filter(compiled.moves_one_way, range(model.njnt)):
        edges = compiled.edges(joint)
        lower, upper = edges if np.all(np.isfinite(edges)) else (-np.pi, np.pi)
        positions[names.joints[joint]] = rng.uniform(lower, upper, SAMPLES)
        configurations[:, model.jnt_qposadr[joint]] = positions[names.joints[joint]]
    placed = _place_links(description, positions)
    rows = [placed[name] for name in (*names.bodies, *names.sites.values())]
    written = np.stack(rows, axis=1)  # (f, links, 4, 4)
    sites = list(names.sites)
    data = mujoco.MjData(model)
    for configuration, poses in zip(configurations, written, strict=True):
        data.qpos[:] = configuration
        mujoco.mj_kinematics(model, data)
        points = np.concatenate([data.xpos, data.site_xpos[sites]])
        turns = np.concatenate([data.xmat, data.site_xmat[sites]]).reshape(-1, 3, 3)
        shifted = np.linalg.norm(poses[:, :3, 3] - points, axis=1)
        turned = np.abs(poses[:, :3, :3] - turns).max(axis=(1, 2))
        off = np.maximum(shifted / max(1.0, float(np.abs(points).max())), turned)
        worst = int(off.argmax())
        if not off[worst] <= ROUNDING:
            name = [*names.bodies, *names.sites.values()][worst]
            amount = f"{length_text(shifted[worst])} and {turned[worst]:.3g} rad"
            reason = f"would be {amount} from where MuJoCo places it; {REPORT}"
            raise URDFError(description.source, f"link {name!r}", reason)


def _place_links(description: Description, positions: Mapping[str, Array]) -> dict[str, Array]:
    """Return the placements of all links in several configurations, (f, 4, 4) each."""
    placed = {description.root: np.tile(np.eye(4), (SAMPLES, 1, 1))}
    for joint in description.joints:  # written after the one before it
        origin = np.eye(4)
        origin[:3, :3] = pin.rpy.rpyToMatrix(*joint.rpy)
        origin[:3, 3] = joint.origin
        placed[joint.child] = placed[joint.parent] @ origin
        if joint.name in positions:
            moved = positions[joint.name][:, None] * np.array(joint.axis)
            motion = np.tile(np.eye(4), (SAMPLES, 1, 1))
            if joint.type == "prismatic":
                motion[:, :3, 3] = moved
            else:
                motion[:, :3, :3] = Rotation.from_rotvec(moved).as_matrix()
            placed[joint.child] = placed[joint.child] @ motion
    return placed
