"""Placements and Jacobians of the control points, by Pinocchio and by a compiled pass along the chain.

`FrameReader` reads them from Pinocchio, for `ArmState` and the methods of the thesis. `Kinematics` computes
the same numbers on plain arrays, for kernels and for arms that are too long for `pin.Data`, whose memory
grows with the cube of the number of joints. A test compares the two.
"""

from __future__ import annotations

import threading
from collections.abc import Sequence
from functools import cached_property
from typing import NamedTuple, Protocol

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pinposture import kernels
from pinposture.arm.chain import Chain
from pinposture.arm.couplings import is_coupled, joint_axes, joint_placements
from pinposture.errors import InvalidValue
from pinposture.kernels.arrays import ChainArrays, Screws

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]

MAX_PINOCCHIO_DOF = 100
"""Degrees of freedom up to which an arm is read from Pinocchio; a `pin.Data` then takes 66 MB per thread."""


class Frames(NamedTuple):
    """Control points and joints of an arm at one configuration, by Pinocchio; world frame."""

    points: Array  # positions of the control points, (m, 3) [m]
    rotations: Array  # their orientations, (m, 3, 3), from control-point to world frame
    # how each degree of freedom moves a body at the world origin, (nv, 6): velocity [m/rad], then angular
    # velocity [rad/rad]; the columns of `data.J`, of coupled joints their sum: they all carry the body
    motions: Array


class FrameReader:
    """Reads the frames of the control points from Pinocchio, with one `pin.Data` for each thread."""

    def __init__(self, model: pin.Model, frames: Sequence[int]) -> None:
        """Store the model, base placement applied, and the indices of the control points."""
        self._model, self._frames, self._local = model, tuple(frames), threading.local()
        # The columns of `data.J` are those of all joints, coupled ones too: their degrees of freedom.
        moving = [joint for joint in model.joints[1:] if joint.nvExtended]
        listed = [range(joint.idx_v, joint.idx_v + joint.nvExtended) for joint in moving]
        self._columns = np.array([column for each in listed for column in each])
        self._coupled = len(self._columns) > model.nv

    def read(self, q: Array) -> Frames:
        """Compute the frames at a configuration (nq,); the arrays are copies that stay as they are."""
        try:
            data, positions, orientations = self._local.buffers
        except AttributeError:
            data = self._model.createData()
            placements = [data.oMf[frame] for frame in self._frames]
            positions = [placement.translation for placement in placements]
            orientations = [placement.rotation for placement in placements]
            self._local.buffers = data, positions, orientations
        pin.computeJointJacobians(self._model, data, q)
        pin.updateFramePlacements(self._model, data)
        m = len(positions)
        points, rotations = np.concatenate(positions), np.concatenate(orientations)
        motions = np.array(data.J.reshape(6, -1).T, order="C")
        if self._coupled:
            each, motions = motions, np.zeros((self._model.nv, 6))
            np.add.at(motions, self._columns, each)
        return Frames(points.reshape(m, 3), rotations.reshape(m, 3, 3), motions)


class ForwardKinematics(NamedTuple):
    """Placements of a chain, world frame: arrays for kernels, not to be written to."""

    axes: Array  # unit joint axes, (k, 3): all joints, of coupled ones each
    origins: Array  # origins of the joints, a point on each axis, (k, 3) [m]
    points: Array  # control points, (m, 3) [m]
    rotations: Array  # orientations of the control points, (m, 3, 3), from control-point to world frame
    positions: Array  # the joint positions, (nv,) [rad or m]


class TaskConstants(NamedTuple):
    """What kernels of task rows need and no configuration changes; arrays not to be written to."""

    joints: IntArray  # the degrees of freedom by their numbers along the chain, (n,)
    units: Array  # the motion of each of them that counts as one, (n,) [rad or m]
    plane: Array  # directions in which the arm can move, (2, 3) or (3, 3), world axes
    every: IntArray  # the control points by their numbers, (m,)
    dimensions: IntArray  # number of these directions, once for each control point, (m,)
    frames: Array  # these directions, and the normal of a planar arm, once for each control point, (m, 3, 3)


class Kinematics:
    """The constants of a chain, in the order of its joints from base to tip.

    Attributes:
        columns: the degrees of freedom from base to tip, by their columns in the tangent space, (n,).
        ends: number of them that carry each control point, (m,).
        endless: which joint positions are periodic, (nv,).
        constants: the arguments of `kernels.placements` that no configuration changes.
    """

    def __init__(self, model: pin.Model, chain: Chain, frames: Sequence[int], joint_units: Array) -> None:
        """Read the constants of a chain from a model, base placement applied.

        Args:
            model: the arm.
            chain: its chain.
            frames: indices of the control points.
            joint_units: the motion of each degree of freedom that counts as one, (nv,) [rad or m].

        Raises:
            InvalidValue: a joint that neither turns about one axis nor slides along one.
        """
        joints = [model.getJointId(name) for name in chain.joints]
        for joint in joints:
            _require_simple(model, joint)
        self.endless = np.zeros(model.nv, dtype=np.bool_)
        for joint in joints:
            self.endless[model.joints[joint].idx_v] |= model.joints[joint].nq == 2
        self.columns, self.ends = chain.inputs.astype(np.int64), chain.input_ends.astype(np.int64)
        every = joint_placements(model)
        placements = [every[joint] for joint in joints]
        fixed = np.array([[*each.rotation.ravel(), *each.translation] for each in placements])
        axes, _ = joint_axes(model, joints)
        points = [model.frames[frame] for frame in frames]
        offsets = np.array([point.placement.translation for point in points])
        rotations = np.array([point.placement.rotation for point in points])
        columns = chain.columns.astype(np.int64)
        numbers = chain.input_numbers
        self.constants = ChainArrays(
            slides=~chain.revolute,
            columns=columns,
            ratios=np.array(chain.ratios),
            fixed=fixed,
            axes=axes,
            ends=np.array([part.stop for part in chain.module_slices], dtype=np.int64),
            offsets=offsets,
            turns=rotations,
            inputs=self.columns,
            driven=np.argsort(numbers, kind="stable").astype(np.int64),
            starts=np.searchsorted(np.sort(numbers), np.arange(len(self.columns) + 1)).astype(np.int64),
        )
        self._chain, self._units = chain, joint_units

    def forward(self, positions: Array) -> ForwardKinematics:
        """Compute all placements with the joints at positions (nv,) [rad or m]."""
        k, m = len(self.constants.slides), len(self.ends)
        arrays = np.empty((k, 3)), np.empty((k, 3)), np.empty((m, 3)), np.empty((m, 3, 3))
        kernels.placements(self.constants, positions, *arrays)
        return ForwardKinematics(*arrays, positions)

    def points(self, positions: Array) -> Array:
        """Compute the control points, (s, m, 3) [m], at several joint positions, (s, nv) [rad or m]."""
        points = np.empty((len(positions), len(self.ends), 3))
        kernels.trace_points(self.constants, positions, points)
        return points

    def jacobians(self, forward: ForwardKinematics) -> Array:
        """Compute the position Jacobians of the control points, (m, 3, nv) [m/rad], world axes."""
        jacobians = np.zeros((len(self.ends), 3, len(self.endless)))
        kernels.jacobians(self.constants, forward.axes, forward.origins, forward.points, jacobians)
        return jacobians

    @cached_property
    def task_constants(self) -> TaskConstants:
        """The constants of `screws_of` and of task rows."""
        n, m, plane = len(self.columns), len(self.ends), np.array(self._chain.plane)
        frame = plane if len(plane) == 3 else np.vstack([plane, np.cross(plane[0], plane[1])])
        return TaskConstants(
            joints=np.arange(n, dtype=np.int64),
            units=np.array(self._units[self.columns]),
            plane=plane,
            every=np.arange(m, dtype=np.int64),
            dimensions=np.full(m, len(plane), dtype=np.int64),
            frames=np.repeat(frame[None], m, axis=0),
        )


def _require_simple(model: pin.Model, joint: int) -> None:
    kind = model.joints[joint].shortname().removeprefix("JointModel")
    if kind[0] not in "PR" and not is_coupled(model.joints[joint]):
        allowed = "a joint that turns about one axis, or slides along one"
        raise InvalidValue(f"joint {model.names[joint]!r}", kind, allowed)


class HasKinematics(Protocol):
    """An arm, as far as this module uses it."""

    kinematics: Kinematics


class HasPlacements(Protocol):
    """A state of an arm, as far as this module uses it."""

    @property
    def arm(self) -> HasKinematics:
        """The arm."""

    @property
    def forward(self) -> ForwardKinematics:
        """The result of the compiled pass along the chain."""

    @property
    def frames(self) -> Frames | None:
        """The control points by Pinocchio, if it computes them."""


def constants_of(arm: HasKinematics) -> TaskConstants:
    """Return what kernels of task rows need of an arm."""
    return arm.kinematics.task_constants


def screws_of(state: HasPlacements) -> Screws:
    """Compute the screws of the joints of an arm at one configuration."""
    chain, constants, frames = state.arm.kinematics, constants_of(state.arm), state.frames
    points = state.forward.points if frames is None else frames.points
    found = Screws(np.empty((len(constants.joints), 6)), chain.ends, points)
    if frames is not None:
        motions, units = frames.motions, constants.units
        kernels.carry_screws(motions, chain.columns, units, chain.ends, points, found.screws)
    else:
        joints = chain.constants, constants.joints, constants.units
        lines = state.forward.axes, state.forward.origins
        kernels.find_screws(*joints, *lines, chain.ends, points, found.screws)
    return found
