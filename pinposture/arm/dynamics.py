"""The torques of an arm at rest and in motion, by compiled passes along its joints.

They need no `pin.Data`, and are computed for many configurations in one call. Tests compare them with
those of Pinocchio.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pinposture import kernels
from pinposture.arm.kinematics import neutral_placements, read_joints
from pinposture.kernels.arrays import OTHERWISE, TorqueSamples

Array = NDArray[np.float64]


class Dynamics:
    """The joints of an arm, and the bodies that they carry.

    Attributes:
        dry_friction: dry friction along each degree of freedom, (nv,) [N m or N].
        damping: its viscous friction, (nv,) [N m s/rad or N s/m].
        whole: whether all joints of the model are counted. Where one off the chain moves otherwise than it
            turns or slides, only the chain is.
    """

    def __init__(self, model: pin.Model, chain: tuple[str, ...]) -> None:
        """Read them from a model, base placement applied, with the names of the joints of its chain."""
        self.damping = np.array(model.damping)
        self.dry_friction: Array = np.maximum(
            model.upperDryFrictionLimit, -np.asarray(model.lowerDryFrictionLimit)
        )
        placements = neutral_placements(model)
        numbers = list(range(1, model.njoints))
        joints = read_joints(model, placements)
        self.whole = bool(np.all(joints.kinds != OTHERWISE))
        if not self.whole:
            numbers = [model.getJointId(name) for name in chain]
            joints = read_joints(model, placements, numbers)
        turns = np.array([placements[number].rotation for number in numbers])
        inertias = list(model.inertias)
        moments = np.array([inertias[number].inertia for number in numbers])
        moments = turns @ moments @ turns.transpose(0, 2, 1)
        levers = np.array([inertias[number].lever for number in numbers])
        masses = np.array([inertias[number].mass for number in numbers])
        centers = np.einsum("nij,nj->ni", turns, levers)
        moments = moments[:, [0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
        of_joints = [joints.axes.ravel(), joints.offsets.ravel(), joints.ratios]
        of_bodies = [masses, centers.ravel(), moments.ravel(), np.array(model.armature)]
        self._indices = np.concatenate([joints.parents, joints.kinds, joints.columns])
        self._numbers = np.concatenate([*of_joints, *of_bodies, np.array(model.gravity.linear)])

    def gravity_torques(self, positions: Array, gravity: Array | None = None) -> Array:
        """Compute the torques and forces that balance gravity, (..., nv) [N m or N].

        Args:
            positions: joint positions, (..., nv) [rad or m].
            gravity: gravitational acceleration, world frame, (3,) [m/s^2]; that of the model if None.
        """
        numbers = self._numbers if gravity is None else np.append(self._numbers[:-3], gravity)
        rows = np.array(positions, ndmin=2)
        torques = np.empty(rows.shape)
        kernels.gravity_torques(self._indices, numbers, rows, torques)
        return torques.reshape(positions.shape)

    def gravity_gradient(self, positions: Array) -> Array:
        """Compute the change of these torques per joint motion at positions (nv,), (nv, nv); symmetric."""
        gradient = np.empty((len(positions), len(positions)))
        kernels.gravity_gradient(self._indices, self._numbers, _plain(positions), gradient)
        return gradient

    def inverse_dynamics(self, positions: Array, velocities: Array, accelerations: Array) -> Array:
        """Compute the torques and forces of motions, armature included, all (s, nv)."""
        torques = np.empty(positions.shape)
        kernels.inverse_dynamics(
            self._indices,
            self._numbers,
            _plain(positions),
            _plain(velocities),
            _plain(accelerations),
            torques,
        )
        return torques

    def step_loads(self, start: Array, moves: Array, dt: float, effort: Array) -> tuple[Array, Array]:
        """Compute the largest torque of steps relative to its limit where they meet, in motion and at rest.

        Args:
            start: joint positions between the first two steps, (nv,) [rad or m].
            moves: the steps, (s + 1, nv) [rad or m].
            dt: duration of a step [s].
            effort: the limits of the torques, (nv,) [N m or N].

        Returns:
            The shares in motion and at rest, (s,) each.
        """
        moving = np.empty(len(moves) - 1)
        held = np.empty(len(moves) - 1)
        kernels.step_loads(
            self._indices,
            self._numbers,
            _plain(start),
            _plain(moves),
            dt,
            _plain(effort),
            moving,
            held,
        )
        return moving, held

    def path_torques(
        self, start: Array, offsets: Array, slopes: Array, samples: int, dt: float
    ) -> TorqueSamples:
        """Compute the torques along a path, the cubic curve through its waypoints, at equidistant samples.

        Args:
            start: joint positions at its start, (nv,) [rad or m].
            offsets: displacement of each waypoint from there, (N + 1, nv) [rad or m].
            slopes: change of it per waypoint, (N + 1, nv).
            samples: number of samples, from the start to the end.
            dt: duration of a step [s]; path speeds are in waypoints per step.
        """
        shape = (samples, len(start))
        filled = TorqueSamples(np.empty(shape), np.empty(shape), np.empty(shape))
        kernels.path_torques(
            self._indices, self._numbers, _plain(offsets), _plain(slopes), _plain(start), dt, filled
        )
        return filled


def _plain(values: Array) -> Array:
    """Return an array as kernels take it; itself if it is like that, because a copy takes 0.3 us."""
    return values if values.flags.carray else np.array(values, dtype=np.float64)
