"""Placements and Jacobians of control points: by Pinocchio, and by a compiled pass along the chain.

`FrameReader` reads them from Pinocchio: what `ArmState` shows and what the methods of the thesis stand on.
`Kinematics` computes the same numbers on plain arrays, for kernels and for arms that are too long for
`pin.Data`, whose memory grows with the cube of the number of joints. A test holds both equal.
"""

from __future__ import annotations

import threading
from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple
from weakref import WeakKeyDictionary

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pinposture import kernels
from pinposture.arm.chain import joint_axes
from pinposture.errors import InvalidValue
from pinposture.kernels.arrays import ChainArrays, Screws

if TYPE_CHECKING:
    from pinposture.arm.arm import Arm
    from pinposture.arm.state import ArmState


Array = NDArray[np.float64]
Whole = NDArray[np.int64]

MOST_IN_DATA = 100
"""Degrees of freedom up to which an arm is read from Pinocchio; a `pin.Data` then takes 66 MB a thread."""


class Frames(NamedTuple):
    """Control points and joints of an arm at one configuration, as Pinocchio has them; world frame.

    Attributes:
        points: positions of the control points, (m, 3) [m].
        rotations: their orientations, (m, 3, 3), from control-point to world frame.
        motions: how each degree of freedom moves a body at the world origin, (nv, 6): velocity [m/rad], then
            angular velocity [rad/rad]; the columns of `data.J`.
    """

    points: Array
    rotations: Array
    motions: Array


class FrameReader:
    """Reads the frames of the control points from Pinocchio, with one `pin.Data` for each thread."""

    def __init__(self, model: pin.Model, frames: Sequence[int]) -> None:
        """Keep what to read.

        Args:
            model: the arm, base placement applied.
            frames: the control points.
        """
        self._model, self._frames, self._kept = model, tuple(frames), threading.local()

    def read(self, q: Array) -> Frames:
        """The frames at a configuration (nq,), copied: Pinocchio fills the same memory the next time."""
        try:
            data, positions, orientations = self._kept.read
        except AttributeError:
            data = self._model.createData()
            placements = [data.oMf[frame] for frame in self._frames]
            positions = [placement.translation for placement in placements]
            orientations = [placement.rotation for placement in placements]
            self._kept.read = data, positions, orientations
        pin.computeJointJacobians(self._model, data, q)
        pin.updateFramePlacements(self._model, data)
        m = len(positions)
        points, rotations = np.concatenate(positions), np.concatenate(orientations)
        return Frames(
            points.reshape(m, 3), rotations.reshape(m, 3, 3), np.array(data.J.reshape(6, -1).T, order="C")
        )


class ForwardKinematics(NamedTuple):
    """Where a chain is, world frame: arrays for kernels, not to be written to.

    Attributes:
        axes: unit joint axes, (n, 3).
        origins: origins of the joints, a point on each axis, (n, 3) [m].
        points: control points, (m, 3) [m].
        rotations: orientations of the control points, (m, 3, 3), from control-point to world frame.
        positions: the joint positions that put it there, (nv,) [rad or m].
    """

    axes: Array
    origins: Array
    points: Array
    rotations: Array
    positions: Array


class Kinematics:
    """The constants of a chain, in the order of its joints from base to tip.

    Attributes:
        slides: True for a joint that slides, (n,); others turn.
        columns: column of each joint in the tangent space, (n,).
        ends: number of joints that carry each control point, (m,).
        endless: which joint positions come round to where they were, (nv,).
        constants: what `kernels.placements` wants to know of the chain.
    """

    def __init__(self, model: pin.Model, names: Sequence[str], frames: Sequence[int]) -> None:
        """Read a chain out of a model.

        Args:
            model: the arm, base placement applied.
            names: the joints of the chain from base to tip, each the parent of the next.
            frames: the control points.

        Raises:
            InvalidValue: a joint that neither turns about one axis nor slides along one.
        """
        joints = [model.getJointId(name) for name in names]
        self.slides = np.array([_slides(model, joint) for joint in joints], dtype=np.bool_)
        self.endless = np.zeros(model.nv, dtype=np.bool_)
        for joint in joints:
            self.endless[model.joints[joint].idx_v] = model.joints[joint].nq == 2
        self.columns = np.array([model.joints[joint].idx_v for joint in joints], dtype=np.int64)
        placements = [model.jointPlacements[joint] for joint in joints]
        fixed = np.array([[*each.rotation.ravel(), *each.translation] for each in placements])
        axes = joint_axes(model, joints)
        number = {joint: u + 1 for u, joint in enumerate(joints)}
        points = [model.frames[frame] for frame in frames]
        self.ends = np.array([number[point.parentJoint] for point in points], dtype=np.int64)
        offsets = np.array([point.placement.translation for point in points])
        turns = np.array([point.placement.rotation for point in points])
        self.constants = ChainArrays(self.slides, self.columns, fixed, axes, self.ends, offsets, turns)

    def forward(self, positions: Array) -> ForwardKinematics:
        """Where everything is with the joints at positions (nv,) [rad or m]."""
        n, m = len(self.columns), len(self.ends)
        filled = np.empty((n, 3)), np.empty((n, 3)), np.empty((m, 3)), np.empty((m, 3, 3))
        kernels.placements(self.constants, positions, *filled)
        return ForwardKinematics(*filled, positions)

    def jacobians(self, forward: ForwardKinematics) -> Array:
        """Position Jacobians of the control points, (m, 3, nv) [m/rad], world axes."""
        jacobians = np.zeros((len(self.ends), 3, len(self.endless)))
        kernels.jacobians(self.constants, forward.axes, forward.origins, forward.points, jacobians)
        return jacobians


def _slides(model: pin.Model, joint: int) -> bool:
    kind = model.joints[joint].shortname().removeprefix("JointModel")
    if kind[0] not in "PR":
        allowed = "a joint that turns about one axis, or slides along one"
        raise InvalidValue(f"joint {model.names[joint]!r}", kind, allowed)
    return bool(kind[0] == "P")


# How the joints of an arm move its control points, as kernels see it: one screw for each joint.


class Constants(NamedTuple):
    """What does not change with the configuration; arrays for kernels, not to be written to.

    Attributes:
        joints: the joints by their numbers along the chain, (n,).
        units: the motion of each joint of the chain that counts as one, (n,) [rad or m].
        plane: directions in which the arm can move, (2, 3) or (3, 3), world axes.
        every: the control points by their numbers, (m,).
        dimensions: number of these directions, once for each control point, (m,).
        frames: these directions, and the normal of a planar arm, once for each control point, (m, 3, 3).
    """

    joints: Whole
    units: Array
    plane: Array
    every: Whole
    dimensions: Whole
    frames: Array


_KNOWN: WeakKeyDictionary[Arm, Constants] = WeakKeyDictionary()


def constants_of(arm: Arm) -> Constants:
    """What kernels want to know of an arm; remembered as long as it lives."""
    known = _KNOWN.get(arm)
    if known is None:
        m, plane = arm.n_modules, np.array(arm.plane)
        frame = plane if len(plane) == 3 else np.vstack([plane, np.cross(plane[0], plane[1])])
        known = _KNOWN[arm] = Constants(
            joints=np.arange(len(arm.columns), dtype=np.int64),
            units=np.array(arm.joint_units[arm.columns]),
            plane=plane,
            every=np.arange(m, dtype=np.int64),
            dimensions=np.full(m, len(plane), dtype=np.int64),
            frames=np.repeat(frame[None], m, axis=0),
        )
    return known


def screws_of(state: ArmState) -> Screws:
    """The screws of the joints of an arm where it is."""
    chain, known, frames = state.arm.kinematics, constants_of(state.arm), state.frames
    points = state.forward.points if frames is None else frames.points
    found = Screws(np.empty((len(known.joints), 6)), chain.ends, points)
    if frames is not None:
        kernels.carry_screws(frames.motions, chain.columns, known.units, chain.ends, points, found.screws)
    else:
        lines = state.forward.axes, state.forward.origins
        kernels.find_screws(known.joints, chain.slides, known.units, *lines, chain.ends, points, found.screws)
    return found
