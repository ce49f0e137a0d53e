"""The MuJoCo model of an arm: bodies, joints, inertias and servos, built from its Pinocchio model.

The model of the arm contains only the joints of its chain. The simulation also needs the joints that servos
hold in place, so Pinocchio reads the whole description again. Each joint of that model becomes a MuJoCo body
with one hinge or slide. Shapes are added only where contact is simulated (`pinposture.sim.contact`). Servos
control positions with velocity feedback; their gains follow from the inertias, and actuators saturate.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import eigh

from pinposture._validation import finite_vector, require_positive
from pinposture.arm import Arm, Coupling
from pinposture.arm.inertias import INERTIA, RigidBody, physically_consistent
from pinposture.arm.kinematics import frame_ids
from pinposture.arm.mjcf import load_mujoco
from pinposture.arm.model_builder import build_model
from pinposture.arm.urdf import load_text, read_inertials, text_for_pinocchio
from pinposture.arm.weight import NOTHING, REMEDY, add_masses, effort_limits, scaled
from pinposture.collision import Scene
from pinposture.collision.model import effective_scene
from pinposture.errors import InvalidValue, URDFError, enumerated, warn_caller
from pinposture.quadratic_program import ROW_PROGRAM, solve
from pinposture.schema import CheckedBy, Declared, Flag, checked_number, declared, quantity
from pinposture.sim.contact import ContactModel, add_contact
from pinposture.units import ROUNDING, length_text

Array = NDArray[np.float64]

LARGEST_SETTING = 1e5  # of servos, other than torques; no gain overflows


class ServoDesign(NamedTuple):
    """How servos are chosen for an arm, unless they are given."""

    frequency: float = 10.0
    """Of servos of an arm whose stiffness is not known [Hz]."""

    max_deflection: float = 0.01
    """Of a servo due to joint friction and damping at speed 1, in joint units."""

    friction_holds: float = 0.9999
    """Impedance of dry friction (`solimp` of MuJoCo). With MuJoCo's 0.9, a joint that friction holds creeps
    to its set point within seconds; tests/sim/test_sim_servos.py bounds it."""


DESIGN = ServoDesign()


class Gains(NamedTuple):
    """Gains of the servos.

    Attributes:
        stiffness: torque per unit of position error, (n,) [N m/rad or N/m]; or (n, n), of tendons.
        damping: torque per unit of velocity, (n,) [N m s/rad or N s/m].
    """

    stiffness: Array
    damping: Array

    def springs(self, errors: Array) -> Array:
        """Return the torques for position errors, (n,) each."""
        return np.asarray(self.stiffness @ errors if self.stiffness.ndim == 2 else self.stiffness * errors)


def _torque_limits(name: str, value: Any) -> bool | float:
    return value if isinstance(value, bool) else require_positive(name, value)


_Setting = Annotated[
    float,
    checked_number(f"a number above 0, at most {LARGEST_SETTING:g}", lambda x: 0.0 < x <= LARGEST_SETTING),
]
_FromZero = Annotated[
    float, checked_number(f"a number from 0 to {LARGEST_SETTING:g}", lambda x: 0.0 <= x <= LARGEST_SETTING)
]


@declared()
class Servos(Declared):
    """Position servos: torque = stiffness (set point - position) - damping (velocity - its reference).

    They are at the joints that drives move (`Arm.drives`).

    Stiffnesses are proportional to the inertias at the joints, and so large that no vibration mode of the
    whole arm is slower than `frequency`. If each joint were tuned to that frequency on its own, a long arm
    would be compliant: joints are springs in series, and the slowest mode of 40 joints has a quarter of that
    frequency, that of 200 joints a ninth.

    Attributes:
        frequency: natural frequency of the slowest vibration mode of the arm [Hz]. Under gravity, the tip of
            any arm sags by about 9.81 / (2 pi frequency)^2 [m]: 2.5 mm at 10 Hz. None: that which follows
            from `Arm.stiffness`, then the stiffness of the servos; 10 Hz if the arm has none.
        damping: damping ratio of that mode; 1 is critical. Faster modes are damped more.
        torque_limits: True for the effort limits of the arm, False for none, or one limit for all servos
            [N m or N]. The limits of arms from templates are unknown, and infinite here.
        gravity_compensation: whether to add the torques that balance gravity, from the model of the arm.
        speed_reference: whether damping acts on the velocity relative to that of the set point, as in drives
            that receive positions and velocities; otherwise it acts on the velocity itself, and the arm lags.
        armature: reflected rotor inertia, added to each joint that a servo moves [kg m^2 or kg].
        friction: dry friction of each servo, beyond that of the joints in the description [N m or N], such as
            the `friction_torque` of an identification. Servos are not stiffened against it: they rest up to
            friction / stiffness from their set points.
        timestep: maximum physics step [s].

    Raises:
        InvalidValue: a value is not positive (armature, friction: negative), or one but a torque limit is
            above 1e5.
    """

    frequency: _Setting | None = None
    damping: _Setting = 1.0
    torque_limits: Annotated[bool | float, CheckedBy(_torque_limits)] = True
    gravity_compensation: Flag = False
    speed_reference: Flag = True
    armature: _FromZero = 0.0
    friction: _FromZero = 0.0
    timestep: Annotated[float, quantity("time", above=0.0, most=LARGEST_SETTING)] = 1e-3

    def limits(self, effort: Array) -> Array:
        """Return the torque limit of each servo, (n,) [N m or N]; infinite without a limit.

        Args:
            effort: effort limits of the description, (n,) [N m or N].
        """
        if self.torque_limits is True:
            return np.array(effort)
        limit = np.inf if self.torque_limits is False else float(self.torque_limits)
        return np.full(len(effort), limit)

    def gains(self, mass_matrices: Sequence[ArrayLike], least: ArrayLike = 0.0) -> Gains:
        """Return the gains for an arm.

        Args:
            mass_matrices: its mass matrices in several configurations, including armature, (n, n) each.
            least: minimum stiffness of each joint, (n,) [N m/rad or N/m].
        """
        matrices = np.array([np.asarray(matrix, dtype=np.float64) for matrix in mass_matrices])
        carried = np.diagonal(matrices, axis1=1, axis2=2).max(axis=0)
        scale = 1.0 / np.sqrt(carried)
        # The squared frequencies of M x'' = -c diag(carried) x are c over the eigenvalues of `relative`.
        relative = matrices * scale[:, None] * scale[None, :]
        slowest = float(np.linalg.eigvalsh(relative)[:, -1].max())
        turning = 2.0 * np.pi * (DESIGN.frequency if self.frequency is None else self.frequency)
        stiffness = np.maximum(turning**2 * slowest * carried, least)
        return Gains(stiffness, 2.0 * self.damping / turning * stiffness)

    def stiffness(self, arm: Arm) -> Array:
        """Return the stiffness that these servos give an arm, for `Arm.with_stiffness`.

        It depends on all masses of the arm, its payload included.

        Returns:
            Torque or force per displacement, (nv,) [N m/rad or N/m]; (nv, nv) if that of the arm is used, and
            tendons couple its joints.

        Raises:
            PostureError: as `build_plant_model`.
        """
        plant = build_plant_model(arm, self)
        ratios = arm.drives.ratios
        if plant.gains.stiffness.ndim == 2:
            return scaled(plant.gains.stiffness[np.ix_(plant.columns, plant.columns)], ratios)
        return np.asarray(plant.gains.stiffness[plant.columns] * ratios**2)


def torques_within_limits(
    mobility: Array, unmoved: Array, spring: Array, damping: Array, lower: Array, upper: Array
) -> Array:
    """Return the saturated torques of the servos over a physics step, (n,) [N m or N].

    Torques u give the joint velocities v = v0 + W u at the end of the step. Servos request u = s - D v and
    saturate at their limits: u minimises u^T (1/D + W) u / 2 - (s / D - v0)^T u within the limits. The
    problem is strictly convex, so the solution is unique.

    Args:
        mobility: W, final velocity per unit of torque, (n, n), symmetric.
        unmoved: v0, final velocities without torques, (n,) [rad/s or m/s].
        spring: s, torques requested at velocity 0, (n,) [N m or N].
        damping: D, damping of the servos, (n,) [N m s/rad or N s/m], positive.
        lower: lower torque limits, (n,); -inf without a limit.
        upper: upper torque limits, (n,); inf without a limit.
    """
    hessian = mobility + np.diag(1.0 / damping)
    scale = 1.0 / np.sqrt(np.diag(hessian))
    solution = solve(
        hessian * np.outer(scale, scale),
        -(spring / damping - unmoved) * scale,
        np.maximum(lower / scale, -ROW_PROGRAM.no_bound),
        np.minimum(upper / scale, ROW_PROGRAM.no_bound),
    )
    torques = solution.x if solution.x is not None else np.zeros(len(spring))
    return np.clip(torques * scale, lower, upper)


@dataclass(frozen=True, eq=False)
class PlantModel:
    """The MuJoCo model of an arm with its servos; each joint has one position and one velocity.

    Attributes:
        arm: the arm.
        servos: its servos.
        gravity: gravitational acceleration, (3,) [m/s^2], world frame.
        model: the `mujoco.MjModel`, with the n joints of the arm and those held by servos, named as in the
            description.
        columns: index of each driven joint (`Arm.drives`) among the n joints, (nv,).
        coupling: maps the motion of the i independent joints to that of all joints, (n, i).
        of_arm: columns of `coupling` that belong to the arm, (n, nv).
        rest: joint positions with driven joints at zero and the other joints as held, (n,) [rad or m].
        gains: stiffness and damping of the servos, (n,) each.
        torque_limits: torque or force limit of each servo, (n,) [N m or N]; infinite without a limit.
        warnings: messages about what was corrected or left out.
        contact: how things touch; None: there is no contact. Behind the n joints, `model` then has those of
            free obstacles.
        touchable: names of the obstacles that the arm may touch.
    """

    arm: Arm
    servos: Servos
    gravity: Array
    model: Any
    columns: NDArray[np.intp]
    coupling: Array
    of_arm: Array
    rest: Array
    gains: Gains
    torque_limits: Array
    warnings: tuple[str, ...]
    contact: ContactModel | None = None
    touchable: tuple[str, ...] = ()

    def positions(self, driven: Array) -> Array:
        """Return the positions of all joints, (n,), for those of the driven joints, (nv,) [rad or m]."""
        return np.asarray(self.rest + self.of_arm @ driven)


def build_plant_model(
    arm: Arm,
    servos: Servos | None = None,
    gravity: bool | ArrayLike = True,
    *,
    scene: Scene | None = None,
    contact: ContactModel | None = None,
) -> PlantModel:
    """Build the MuJoCo model of an arm.

    Joint limits, damping and friction are those of the description.

    Args:
        arm: the arm, created from a URDF or from modules.
        servos: its servos; None: `Servos()`.
        gravity: whether there is gravity, that of the arm, or its acceleration, (3,) [m/s^2], world frame.
        scene: what the arm can touch, if there is contact; None: itself.
        contact: how things touch; None: there is no contact.

    Raises:
        InvalidValue: an arm from `Arm.from_model`, or invalid gravity; with contact also an obstacle that is
            not convex, or an arm with coupled joints, which MuJoCo's contacts do not move.
        UnknownName: a mass of something that does not exist.
        MujocoMissing: MuJoCo is not installed.
        URDFError: an inertia in the description is not a number, MuJoCo rejects the model, or its control
            points differ from those of the arm.
    """
    mujoco = load_mujoco()
    servos = Servos() if servos is None else servos
    acceleration = _acceleration(arm, gravity)
    complete, source = _complete_model(arm)
    add_masses(complete, arm.added)
    bodies, corrections = _rigid_bodies(complete)
    drives = arm.drives
    followers = _followers(arm)
    if followers and contact is not None:
        raise InvalidValue("contact", contact, "None for an arm with coupled joints")
    if followers and (servos.friction or np.any(complete.upperDryFrictionLimit > 0.0)):
        corrections = (*corrections, "dry friction of joints is ignored, because joints are coupled")
    for message in corrections:
        warn_caller(message)
    spec = _specification(mujoco, arm, complete, bodies, servos, acceleration)
    try:
        model = spec.compile()
    except ValueError as error:
        raise URDFError(source, "<robot>", f"was rejected by MuJoCo: {error}") from None
    dofs = {name: int(model.joint(name).dofadr[0]) for name in list(complete.names)[1:]}
    rest = np.zeros(model.nv)
    effort = np.zeros(model.nv)
    described = effort_limits(complete, NOTHING, ())
    for name, position in _held_positions(arm, complete, source).items():
        rest[dofs[name]] = position
    for joint in list(complete.joints)[1:]:
        dof = dofs[complete.names[joint.id]]
        effort[dof] = described[joint.idx_v]
        # Set here, because the type of these fields of MjSpec depends on the version of MuJoCo.
        model.dof_damping[dof] = complete.damping[joint.idx_v]
        model.dof_frictionloss[dof] = complete.upperDryFrictionLimit[joint.idx_v]
    columns = np.array([dofs[name] for name in drives.names], dtype=np.intp)
    effort[columns] = arm.effort / np.abs(drives.ratios)
    for follower in followers:
        rest[dofs[follower.joint]] = follower.offset
    leading, coupling = _independent(followers, dofs)
    effort[~leading] = math.inf
    sites = np.array([model.site(f"point_{k}").id for k in range(arm.n_modules)], dtype=np.intp)
    data = mujoco.MjData(model)
    matrices = []
    of_chain = np.searchsorted(np.flatnonzero(leading), columns)
    of_arm = coupling[:, of_chain]
    for positions in _sample_positions(arm):
        data.qpos[:] = rest + of_arm @ drives.positions(positions)
        mujoco.mj_forward(model, data)
        _check_control_points(arm, positions, data.site_xpos[sites], source)
        matrices.append(coupling.T @ full_mass_matrix(model, data) @ coupling)
    units = np.where(model.jnt_type == mujoco.mjtJoint.mjJNT_SLIDE, arm.characteristic_length, 1.0)
    least = (model.dof_frictionloss + model.dof_damping * units) / (DESIGN.max_deflection * units)
    servos, gains = _tuned(servos, arm, matrices, np.abs(coupling).T @ least, of_chain)
    model.dof_frictionloss[columns] += servos.friction
    model.dof_solimp[:, :2] = DESIGN.friction_holds
    if contact is not None:
        add_contact(spec, arm, effective_scene(arm, scene), contact)
        model = _compiled_again(spec, model)
    return PlantModel(
        arm=arm,
        servos=servos,
        gravity=acceleration,
        model=model,
        columns=columns,
        coupling=coupling,
        of_arm=of_arm,
        rest=rest,
        gains=Gains(*(_spread(values, leading) for values in gains)),
        torque_limits=servos.limits(effort),
        warnings=corrections,
        contact=contact,
        touchable=() if scene is None else tuple(scene.touchable),
    )


def _independent(followers: list[Coupling], dofs: dict[str, int]) -> tuple[NDArray[np.bool_], Array]:
    """Return which joints follow no other, (n,), and the motion of all per motion of these, (n, i)."""
    leading = np.ones(len(dofs), dtype=np.bool_)
    coupling = np.eye(len(dofs))
    for follower in followers:
        leading[dofs[follower.joint]] = False
        coupling[dofs[follower.joint], dofs[follower.leader]] = follower.ratio
    return leading, coupling[:, leading]


def _compiled_again(spec: Any, before: Any) -> Any:
    """Return the `mujoco.MjModel` of a specification to which shapes were added, with the same joints."""
    model = spec.compile()
    model.dof_damping[: before.nv] = before.dof_damping
    model.dof_frictionloss[: before.nv] = before.dof_frictionloss
    model.dof_solimp[: before.nv] = before.dof_solimp
    return model


def _acceleration(arm: Arm, gravity: bool | ArrayLike) -> Array:
    """Return the gravitational acceleration, (3,) [m/s^2], as `build_plant_model` takes it."""
    if isinstance(gravity, (bool, np.bool_)):
        return np.array(arm.model.gravity.linear) if gravity else np.zeros(3)
    return finite_vector("gravity", gravity, 3)


def _tuned(
    servos: Servos, arm: Arm, matrices: list[Array], least: Array, of_chain: NDArray[np.intp]
) -> tuple[Servos, Gains]:
    """Return servos with their frequency, and their gains at the i independent joints.

    Args:
        servos: the servos.
        arm: the arm.
        matrices: mass matrices, (i, i) each.
        least: minimum stiffness of each joint if it follows from the frequency, (i,) [N m/rad or N/m].
        of_chain: the joints that drives of the arm move among the independent ones, (nv,).
    """
    if servos.frequency is not None or arm.weight.stiffness is None:
        tuned = servos if servos.frequency is not None else replace(servos, frequency=DESIGN.frequency)
        return tuned, tuned.gains(matrices, least)
    springs = scaled(arm.stiffness, 1.0 / arm.drives.ratios)
    slowest = min(
        float(eigh(springs, matrix[np.ix_(of_chain, of_chain)], eigvals_only=True)[0]) for matrix in matrices
    )
    tuned = replace(servos, frequency=math.sqrt(slowest) / (2.0 * math.pi))
    others = tuned.gains(matrices, least)  # of joints that the arm does not move
    stiffness = np.diag(others.stiffness)
    stiffness[np.ix_(of_chain, of_chain)] = springs
    damping = others.damping
    damping[of_chain] = 2.0 * servos.damping / math.sqrt(slowest) * np.diagonal(springs)
    diagonal = np.diagonal(stiffness)
    return tuned, Gains(
        diagonal.copy() if np.array_equal(np.diag(diagonal), stiffness) else stiffness, damping
    )


def mass_matrix(plant: PlantModel, positions: Array) -> Array:
    """Return the mass matrix of all joints, (n, n), for joint positions of the arm, (nv,) [rad or m]."""
    mujoco = load_mujoco()
    data = mujoco.MjData(plant.model)
    count = len(plant.rest)
    data.qpos[:count] = plant.positions(plant.arm.drives.positions(positions))
    mujoco.mj_forward(plant.model, data)
    return full_mass_matrix(plant.model, data)[:count, :count]


def full_mass_matrix(model: Any, data: Any) -> Array:
    """Return the most recent mass matrix of MuJoCo, (n, n).

    It is read column by column, because the signature of `mj_fullM` depends on the version of MuJoCo.
    """
    mujoco = load_mujoco()
    matrix = np.zeros((model.nv, model.nv))
    for row, unit in zip(matrix, np.eye(model.nv), strict=True):
        mujoco.mj_mulM(model, data, row, unit)
    return matrix


def _followers(arm: Arm) -> list[Coupling]:
    """Return the joints of an arm that no drive moves, as they follow the joints that drives move."""
    columns = {name: column for column, name in enumerate(arm.joint_names)}
    led = [*(Coupling(name, name, 1.0, 0.0) for name in columns), *arm.couplings]
    followers = []
    for coupling in led:
        drive = arm.drives[columns[coupling.leader]]
        if coupling.joint != drive.joint:
            ratio = coupling.ratio / drive.ratio
            followers.append(
                Coupling(coupling.joint, drive.joint, ratio, coupling.offset - ratio * drive.offset)
            )
    return followers


def _complete_model(arm: Arm) -> tuple[pin.Model, str]:
    """Read all joints of the description of an arm; floating and planar joints are fixed at zero.

    Returns:
        The model, with the base link at the origin and independent mimic joints, and the name of the
        description for messages.
    """
    if arm.urdf is None:
        allowed = "an arm from a URDF or from modules; Arm.from_model provides no description to simulate"
        raise InvalidValue("arm", arm, allowed)
    text, source = load_text(arm.urdf)
    read_inertials(text, source)
    model = build_model(text_for_pinocchio(text), source)
    fixed = [joint.id for joint in list(model.joints)[1:] if joint.nv != 1]
    if fixed:
        model = pin.buildReducedModel(model, fixed, pin.neutral(model))
    for name in arm.joint_names:
        if not model.existJointName(name):
            raise URDFError(source, f"joint {name!r}", "is not a moving joint of the robot description")
    return model, source


def _rigid_bodies(model: pin.Model) -> tuple[list[RigidBody], tuple[str, ...]]:
    """Return the rigid body moved by each joint, and a warning for each kind of corrected fault."""
    links_after = _links_after(model)
    bodies: list[RigidBody] = []
    faults: dict[str, list[str]] = {}
    for name, inertia in zip(list(model.names)[1:], list(model.inertias)[1:], strict=True):
        body, fault = physically_consistent(RigidBody.of(inertia))
        bodies.append(body)
        if fault:
            faults.setdefault(fault, []).append(links_after[name].name)
    ball = f"a ball of {1e3 * INERTIA.ball_mass:g} g with a radius of {1e2 * INERTIA.ball_radius:g} cm"
    correction = {
        "no mass": f"taken as {ball}; {REMEDY.masses}",
        "unphysical moments of inertia": "moments raised to the nearest physical ones",
    }
    messages = []
    for fault, names in faults.items():
        links = f"moving link{'s' * (len(names) > 1)} {enumerated(map(repr, names))}"
        messages.append(f"{links}: {fault}; {correction[fault]}")
    return bodies, tuple(messages)


def _links_after(model: pin.Model) -> dict[str, pin.Frame]:
    """Return the frame of the link after each joint, by joint name."""
    frames = list(model.frames)
    return {frames[frame.parentFrame].name: frame for frame in frames if frame.type == pin.FrameType.BODY}


def _specification(
    mujoco: Any,
    arm: Arm,
    model: pin.Model,
    bodies: list[RigidBody],
    servos: Servos,
    gravity: Array,
) -> Any:
    """Build the `mujoco.MjSpec`: a body and a servo for each joint, and a site at each control point."""
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    spec.option.gravity = gravity
    spec.option.timestep = servos.timestep
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.disableflags = mujoco.mjtDisableBit.mjDSBL_AUTORESET | mujoco.mjtDisableBit.mjDSBL_CONTACT
    added = [spec.worldbody.add_body(name=str(model.names[0]), **_placement(arm.base_placement))]
    followers = {follower.joint for follower in _followers(arm)}
    edges = np.sort([arm.drives.ratios * limit + arm.drives.offsets for limit in arm.limits[:2]], axis=0)
    limits = dict(zip(arm.drives.names, edges.T, strict=True))
    for number, (joint, rigid) in enumerate(zip(list(model.joints)[1:], bodies, strict=True), start=1):
        xx, xy, yy, xz, yz, zz = rigid.inertia[np.tril_indices(3)]
        body = added[model.parents[number]].add_body(
            name=str(model.names[number]),
            **_placement(model.jointPlacements[number]),
            explicitinertial=True,
            mass=rigid.mass,
            ipos=rigid.center,
            fullinertia=[xx, yy, zz, xy, xz, yz],
            gravcomp=float(servos.gravity_compensation),
        )
        added.append(body)
        motion = np.ravel(joint.createData().S)
        name = str(model.names[number])
        slides = bool(np.any(motion[:3]))
        kind = mujoco.mjtJoint.mjJNT_SLIDE if slides else mujoco.mjtJoint.mjJNT_HINGE
        axis = motion[:3] if slides else motion[3:]
        moved = body.add_joint(name=name, type=kind, axis=axis)
        interval = limits.get(name, (-np.inf, np.inf))
        if np.all(np.isfinite(interval)):
            moved.limited = mujoco.mjtLimited.mjLIMITED_TRUE
            moved.range = interval
        if name in followers:  # `Plant` moves it
            continue
        moved.armature = servos.armature
        servo = spec.add_actuator(name=name, target=name)
        servo.trntype = mujoco.mjtTrn.mjTRN_JOINT
        servo.gaintype = mujoco.mjtGain.mjGAIN_FIXED
        servo.biastype = mujoco.mjtBias.mjBIAS_AFFINE
    for k, frame in enumerate(arm.model.frames[i] for i in frame_ids(arm.model, arm.control_points)):
        body = added[model.getJointId(str(arm.model.names[frame.parentJoint]))]
        body.add_site(name=f"point_{k}", pos=frame.placement.translation)
    return spec


def _spread(values: Array, where: NDArray[np.bool_]) -> Array:
    """Return values, (i,) or (i, i), at the i joints where the mask is True, and zeros elsewhere."""
    spread = np.zeros((len(where),) * values.ndim)
    spread[np.ix_(*(where,) * values.ndim)] = values
    return spread


def _placement(placement: pin.SE3) -> dict[str, Array]:
    """Return a placement as MuJoCo arguments, with w first in the quaternion."""
    quaternion = np.roll(pin.Quaternion(placement.rotation).coeffs(), 1)
    return {"pos": np.array(placement.translation), "quat": quaternion}


def _held_positions(arm: Arm, model: pin.Model, source: str) -> dict[str, float]:
    """Return the positions of joints that the arm does not move, by joint name [rad or m].

    These are joints off the chain and locked joints. In the model of the arm, the links before and after such
    a joint are fixed to each other, which determines its position.
    """
    frames = list(model.frames)
    children = _links_after(model)
    links = {frame.name: frame for frame in arm.model.frames if frame.type == pin.FrameType.BODY}
    positions: dict[str, float] = {}
    moving = {*arm.drives.names, *arm.joint_names, *(coupling.joint for coupling in arm.couplings)}
    for frame in frames:
        if frame.type != pin.FrameType.JOINT or frame.name in moving:
            continue
        parent = frames[frame.parentFrame]
        child = children[frame.name]
        before = links.get(parent.name)
        after = links.get(child.name)
        if before is None or after is None or before.parentJoint != after.parentJoint:
            raise URDFError(source, f"joint {frame.name!r}", "is not in the model of the arm")
        origin = parent.placement.actInv(model.jointPlacements[frame.parentJoint])
        moved = origin.actInv(before.placement.actInv(after.placement))
        motion = np.ravel(model.joints[frame.parentJoint].createData().S)
        positions[frame.name] = float(motion @ np.append(moved.translation, pin.log3(moved.rotation)))
    return positions


def _sample_positions(arm: Arm) -> list[Array]:
    """Return joint positions, (nv,), to evaluate the model at: straight, nearly so, and 8 random ones."""
    rng = np.random.default_rng(0)
    straight = arm.positions(arm.straight())
    return [
        straight,
        straight + rng.uniform(-0.1, 0.1, arm.nv) * arm.joint_units,
        *(arm.positions(arm.random(rng)) for _ in range(8)),
    ]


def _check_control_points(arm: Arm, positions: Array, points: Array, source: str) -> None:
    """Raise URDFError if the control points in MuJoCo, (m, 3) [m], differ from those of the arm."""
    off = np.linalg.norm(points - arm.at(arm.configuration(positions)).points, axis=1)
    worst = int(off.argmax())
    if not off[worst] <= ROUNDING * max(1.0, arm.length):
        reason = (
            f"differs by {length_text(off[worst])} between MuJoCo and Pinocchio; the arm is not simulated"
        )
        raise URDFError(source, f"control point {arm.control_points[worst]!r}", reason)
