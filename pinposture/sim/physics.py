"""The arm as a MuJoCo model: made from its description, checked against it, with servos at its joints."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from pinposture._validation import finite_vector
from pinposture.arm import Arm
from pinposture.arm.chain import frame_ids
from pinposture.errors import PostureWarning, URDFError
from pinposture.sim.description import PhysicalDescription, describe
from pinposture.sim.engine import load_mujoco
from pinposture.sim.held import held_positions
from pinposture.sim.servos import Gains, Servos

Array = NDArray[np.float64]

GRAVITY = (0.0, 0.0, -9.81)
"""What `gravity=True` means, world frame [m/s^2]."""

SAME_PLACE = 1e-9
"""Distance, relative to the arm length or 1 m, by which control points may differ between the two models."""

GIVES = 0.01
"""What friction and damping of a joint move it off its set-point by at most, at speed 1, in joint units."""

POSTURES = 8
"""Random configurations at which forward kinematics are compared and inertias are looked at."""


@dataclass(frozen=True, eq=False)
class Physics:
    """An arm ready to be simulated. Joints of MuJoCo have one entry of position and of speed each.

    Attributes:
        arm: the arm.
        servos: its servos.
        gravity: acceleration of free fall, (3,) [m/s^2], world frame.
        model: the `mujoco.MjModel`; its joints are those of the arm and those that are held.
        columns: index into MuJoCo's joints of each degree of freedom of the arm, (nv,).
        rest: positions of MuJoCo's joints with the arm at zero and the others where they are held, (n,).
        gains: stiffness and damping of the servo of each of MuJoCo's joints, (n,) each.
        torque_limits: largest torque or force of each of them [N m or N], (n,); infinite without a limit.
        sites: index of the site at each control point, (m,).
        joint_names: name of each joint of the description, by its number.
        warnings: what had to be settled in the description, in words.
    """

    arm: Arm
    servos: Servos
    gravity: Array
    model: Any
    columns: NDArray[np.intp]
    rest: Array
    gains: Gains
    torque_limits: Array
    sites: NDArray[np.intp]
    joint_names: tuple[str, ...]
    warnings: tuple[str, ...]

    def positions(self, of_arm: Array) -> Array:
        """Positions of MuJoCo's joints, (n,), for joint positions of the arm, (nv,) [rad or m]."""
        positions: Array = self.rest.copy()
        positions[self.columns] = of_arm
        return positions


def physics_of(arm: Arm, servos: Servos | None = None, gravity: bool | ArrayLike = True) -> Physics:
    """Make the MuJoCo model of an arm.

    Contacts are left out, between links and with obstacles. Joint stops, damping and friction are those of
    the description.

    Args:
        arm: the arm, made from a URDF or from modules.
        servos: its servos; `Servos()` if None.
        gravity: whether there is gravity, or its acceleration (3,) [m/s^2] in the world.

    Raises:
        InvalidValue: an arm from `Arm.from_model`, or a gravity that is none.
        MujocoMissing: MuJoCo is not installed.
        URDFError: MuJoCo refuses the description, or places control points elsewhere.
    """
    mujoco = load_mujoco()
    servos = Servos() if servos is None else servos
    fall = _gravity(gravity)
    told = describe(arm)
    for message in told.warnings:
        warnings.warn(message, PostureWarning, stacklevel=3)
    held = held_positions(arm, told)
    spec = _specification(mujoco, arm, told, servos, fall)
    try:
        model = spec.compile()
    except ValueError as error:
        raise URDFError(told.read.source, "<robot>", f"is refused by MuJoCo: {error}") from None
    order = {number: int(model.joint(f"joint_{number}").dofadr[0]) for number in told.moving}
    columns = np.array([order[told.joint_number[name]] for name in arm.joint_names], dtype=np.intp)
    rest, effort = np.zeros(model.nv), np.zeros(model.nv)
    for number, position in held.items():
        rest[order[number]] = position
    for number, limit in zip(told.moving, told.effort, strict=True):
        effort[order[number]] = limit
    sites = np.array([model.site(f"point_{k}").id for k in range(arm.n_modules)], dtype=np.intp)
    limits = servos.limits(tuple(effort))
    physics = Physics(
        arm,
        servos,
        fall,
        model,
        columns,
        rest,
        Gains(np.zeros(model.nv), np.zeros(model.nv)),
        limits,
        sites,
        tuple(joint.name for joint in told.read.joints),
        told.warnings,
    )
    check_places(physics, told)
    gains = servos.gains([mass_matrix(physics, q) for q in _postures(arm)], _resistance(physics))
    return replace(physics, gains=gains)


def mass_matrix(physics: Physics, positions: Array) -> Array:
    """Mass matrix of MuJoCo's joints, (n, n), for joint positions of the arm, (nv,) [rad or m]."""
    mujoco = load_mujoco()
    data = mujoco.MjData(physics.model)
    data.qpos[:] = physics.positions(positions)
    mujoco.mj_forward(physics.model, data)
    return full_mass_matrix(physics.model, data)


def full_mass_matrix(model: Any, data: Any) -> Array:
    """The mass matrix that MuJoCo worked out last, (n, n).

    Column by column, for the function that gives it whole takes other arguments from version to version.
    """
    mujoco = load_mujoco()
    matrix = np.zeros((model.nv, model.nv))
    for row, unit in zip(matrix, np.eye(model.nv), strict=True):
        mujoco.mj_mulM(model, data, row, unit)
    return matrix


def check_places(physics: Physics, told: PhysicalDescription) -> None:
    """Raise URDFError unless MuJoCo places the control points where the arm does."""
    mujoco = load_mujoco()
    arm, data = physics.arm, mujoco.MjData(physics.model)
    for positions in _postures(arm):
        data.qpos[:] = physics.positions(positions)
        mujoco.mj_kinematics(physics.model, data)
        off = np.linalg.norm(
            data.site_xpos[physics.sites] - arm.at(arm.configuration(positions)).points, axis=1
        )
        worst = int(off.argmax())
        if not off[worst] <= SAME_PLACE * max(1.0, arm.length):
            reason = f"is {off[worst]:.3g} m elsewhere for MuJoCo than for Pinocchio; nothing is simulated"
            raise URDFError(told.read.source, f"control point {arm.control_points[worst]!r}", reason)


def _gravity(gravity: bool | ArrayLike) -> Array:
    if isinstance(gravity, (bool, np.bool_)):
        return np.array(GRAVITY) if gravity else np.zeros(3)
    return finite_vector("gravity", gravity, 3)


def _postures(arm: Arm) -> list[Array]:
    """Joint positions (nv,) at which the arm is looked at: straight, nearly straight, and random ones."""
    rng = np.random.default_rng(0)
    straight = arm.positions(arm.straight())
    return [
        straight,
        straight + rng.uniform(-0.1, 0.1, arm.nv) * arm.joint_units,
        *(arm.positions(arm.random(rng)) for _ in range(POSTURES)),
    ]


def _specification(mujoco: Any, arm: Arm, told: PhysicalDescription, servos: Servos, gravity: Array) -> Any:
    try:
        spec = mujoco.MjSpec.from_string(told.text)
    except ValueError as error:
        raise URDFError(told.read.source, "<robot>", f"is refused by MuJoCo: {error}") from None
    # Masses and moments are settled and told already: the compiler is to change nothing.
    spec.compiler.fusestatic = False
    spec.compiler.balanceinertia = False
    spec.compiler.boundmass = spec.compiler.boundinertia = 0.0
    spec.option.gravity = gravity
    spec.option.timestep = servos.timestep
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.disableflags = mujoco.mjtDisableBit.mjDSBL_AUTORESET | mujoco.mjtDisableBit.mjDSBL_CONTACT
    base = spec.body(f"link_{told.link_number[told.read.root]}")
    base.pos = arm.base_placement.translation
    base.quat = np.roll(pin.Quaternion(arm.base_placement.rotation).coeffs(), 1)  # MuJoCo has w first
    limits = dict(zip(arm.joint_names, np.transpose([arm.limits.lower, arm.limits.upper]), strict=True))
    for number in told.moving:
        joint = spec.joint(f"joint_{number}")
        joint.armature = servos.armature
        stops = limits.get(told.read.joints[number].name, (-np.inf, np.inf))
        if np.all(np.isfinite(stops)):
            joint.limited, joint.range = mujoco.mjtLimited.mjLIMITED_TRUE, stops
        body = spec.body(f"link_{told.link_number[told.read.joints[number].child]}")
        body.gravcomp = float(servos.gravity_compensation)
        servo = spec.add_actuator(name=f"servo_{number}", target=joint.name)
        servo.trntype = mujoco.mjtTrn.mjTRN_JOINT
        servo.gaintype, servo.biastype = mujoco.mjtGain.mjGAIN_FIXED, mujoco.mjtBias.mjBIAS_AFFINE
    for k, frame in enumerate(arm.model.frames[i] for i in frame_ids(arm.model, arm.control_points)):
        moved_by = told.read.joints[told.joint_number[str(arm.model.names[frame.parentJoint])]]
        body = spec.body(f"link_{told.link_number[moved_by.child]}")
        body.add_site(name=f"point_{k}", pos=frame.placement.translation)
    return spec


def _resistance(physics: Physics) -> Array:
    """What friction and damping of each joint cost per unit of deviation that they may cause, (n,)."""
    model = physics.model
    slides = model.jnt_type == load_mujoco().mjtJoint.mjJNT_SLIDE
    units = np.where(slides, physics.arm.sliding_unit, 1.0)
    return np.asarray((model.dof_frictionloss + model.dof_damping * units) / (GIVES * units))
