"""The torques of an arm at rest and in motion, by compiled passes, and where elastic joints come to rest.

Torques need no `pin.Data`, and are computed for many configurations in one call. Tests compare them with
those of Pinocchio.

Elastic joints are springs between their commands and their positions. An arm that is commanded to c rests at
q where K (q - c) + g(q) = 0, with the stiffness K and the torques g that hold the arm at q. Such a rest is a
minimum of the energy of springs and weight. There may be several: a slender arm that stands upright buckles.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve, solve_triangular

from pinposture import kernels
from pinposture.arm.kinematics import neutral_placements, read_joints
from pinposture.kernels.arrays import JOINT

Array = NDArray[np.float64]


class StepLoads(NamedTuple):
    """The largest torques of steps, relative to their limits.

    Attributes:
        moving: in the steps, and in the rest after them.
        held_before: those that hold the arm still before the steps.
        held: those that hold it still before, between or after them.
    """

    moving: float
    held_before: float
    held: float


class Dynamics:
    """The joints of an arm, and the bodies that they carry.

    Attributes:
        dry_friction: dry friction along each degree of freedom, (nv,) [N m or N].
        damping: its viscous friction, (nv,) [N m s/rad or N s/m].
        indices: joints and bodies, as kernels take them, (3 k,); see `kernels.dynamics.unpack`.
        numbers: likewise, (18 k + nv + 3,).
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
        self.whole = bool(np.all(joints.kinds != JOINT.other))
        if not self.whole:
            numbers = [model.getJointId(name) for name in chain]
            joints = read_joints(model, placements, numbers)
        turns = np.array([placements[number].rotation for number in numbers])
        inertias = [model.inertias[number] for number in numbers]
        masses = np.array([inertia.mass for inertia in inertias])
        levers = np.array([inertia.lever for inertia in inertias])
        centers = np.einsum("nij,nj->ni", turns, levers)
        moments = turns @ np.array([inertia.inertia for inertia in inertias]) @ turns.transpose(0, 2, 1)
        spreads = 0.5 * np.trace(moments, axis1=1, axis2=2)[:, None, None] * np.eye(3) - moments
        spreads += np.einsum("n,ni,nj->nij", masses, centers, centers)
        carried = masses.copy()
        for joint in range(len(numbers) - 1, -1, -1):
            if joints.parents[joint] > 0:
                carried[joints.parents[joint] - 1] += carried[joint]
        of_joints = [joints.axes.ravel(), joints.offsets.ravel(), joints.ratios]
        of_bodies = [
            masses,
            (masses[:, None] * centers).ravel(),
            spreads[:, [0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]].ravel(),
            carried,
            np.array(model.armature),
        ]
        self.indices = np.concatenate([joints.parents, joints.kinds, joints.columns])
        self.numbers = np.concatenate([*of_joints, *of_bodies, np.array(model.gravity.linear)])

    def gravity_torques(self, positions: Array, gravity: Array | None = None) -> Array:
        """Compute the torques and forces that balance gravity, (..., nv) [N m or N].

        Args:
            positions: joint positions, (..., nv) [rad or m].
            gravity: gravitational acceleration, world frame, (3,) [m/s^2]; that of the model if None.
        """
        numbers = self.numbers if gravity is None else np.append(self.numbers[:-3], gravity)
        rows = np.array(positions, ndmin=2)
        torques = np.empty(rows.shape)
        kernels.gravity_torques(self.indices, numbers, rows, torques)
        return torques.reshape(positions.shape)

    def gravity_gradient(self, positions: Array) -> Array:
        """Compute the change of these torques per joint motion at positions (nv,), (nv, nv); symmetric."""
        gradient = np.empty((len(positions), len(positions)))
        kernels.gravity_gradient(self.indices, self.numbers, _plain(positions), gradient)
        return gradient

    def inverse_dynamics(self, positions: Array, velocities: Array, accelerations: Array) -> Array:
        """Compute the torques and forces of motions, armature included, all (s, nv)."""
        torques = np.empty(positions.shape)
        kernels.inverse_dynamics(
            self.indices,
            self.numbers,
            _plain(positions),
            _plain(velocities),
            _plain(accelerations),
            torques,
        )
        return torques

    def step_loads(self, start: Array, before: Array, steps: Array, dt: float, effort: Array) -> StepLoads:
        """Compute the largest torques of steps relative to their limits, where they meet.

        Args:
            start: joint positions before the steps, (nv,) [rad or m].
            before: the step that led there, (nv,) [rad or m].
            steps: the steps, (k, nv) [rad or m]; the arm rests after them.
            dt: duration of a step [s].
            effort: the limits of the torques, (nv,) [N m or N].
        """
        shares = kernels.step_loads(
            self.indices,
            self.numbers,
            _plain(start),
            _plain(before),
            _plain(steps),
            dt,
            _plain(effort),
        )
        return StepLoads(*shares)


def _plain(values: Array) -> Array:
    """Return an array as kernels take it; itself if it is like that, because a copy takes 0.3 us."""
    return values if values.flags.carray else np.array(values, dtype=np.float64)


Loads = Callable[[Array], tuple[Array, Array]]
"""Returns the torques that hold an arm, (nv,), and their gradient, (nv, nv), at a displacement, (nv,)."""


class SagSettings(NamedTuple):
    """How the rest of an arm under load is found, and when it counts as about to buckle."""

    farthest_move: float = 0.2
    """Largest motion of a joint in a Newton step, in joint units: beyond it the load grows in smaller
    steps. Half and twice of it lead to the same rest."""

    contraction: float = 0.5
    """Largest length of a Newton step relative to the one before; near a rest it is far less."""

    settled: float = 1e-10
    """Length of a Newton step that is the last, in joint units; the next one would be its square."""

    smallest_share: float = 0.01
    """Smallest part of the load that is added at once to an arm that is about to buckle: how exactly the
    load is known at which it does."""

    about_to_buckle: float = 0.1
    """Curvature of the energy, relative to that of the springs alone, below which an arm is about to
    buckle."""

    least_share: float = 1e-12
    """Smallest part of the load that is added at once: that of a limp arm, which moves far until it
    hangs."""


SAG = SagSettings()


class Settled(NamedTuple):
    """Where springs came to rest.

    Attributes:
        displacement: of the joints, (nv,) [rad or m].
        share: the share of the load up to which there was a stable rest; 1 if there is one under all of it.
        weakest: the degree of freedom that gives way beyond it.
    """

    displacement: Array
    share: float
    weakest: int


def spring_root(stiffness: Array) -> Array:
    """Return a matrix A with A A^T = K^-1, (nv, nv): displacements x = A y have the energy |y|^2 / 2."""
    scale = 1.0 / np.sqrt(np.diagonal(stiffness))
    lower = np.linalg.cholesky(scale[:, None] * stiffness * scale)
    unscaled = solve_triangular(lower, np.eye(len(scale)), lower=True)
    return np.asarray(scale[:, None] * unscaled.T)


def curvature(gradient: Array, root: Array, share: float = 1.0) -> Array:
    """Return the second derivative of the energy of springs and a share of the load, along y, (nv, nv).

    The rest of an arm is stable if it is positive definite.
    """
    return np.asarray(np.eye(len(root.T)) + share * (root.T @ gradient @ root))


def weakest_joint(bent: Array, root: Array, units: Array) -> int:
    """Return the degree of freedom that moves most in the direction of the smallest curvature, (nv, nv)."""
    direction = root @ np.linalg.eigh(bent)[1][:, 0]
    return int(np.abs(direction / units).argmax())


def settle(loads: Loads, root: Array, units: Array) -> Settled:
    """Find where springs rest when the load grows slowly from nothing.

    Newton's method finds the rest under all of the load if its steps contract and the energy stays convex.
    Otherwise a half of the load comes first, and so on.

    Args:
        loads: the loads.
        root: the springs, from `spring_root`, (nv, nv).
        units: unit motion of each degree of freedom, (nv,) [rad or m].
    """
    rest = np.zeros(len(units))
    share = 0.0
    step = 1.0
    while share < 1.0:
        trial = min(share + step, 1.0)
        next_rest = _rest_from(rest, trial, loads, root, units)
        if next_rest is not None:
            rest = next_rest
            share = trial
            step = 2.0 * step
            continue
        step = step / 2.0
        if step < SAG.smallest_share:
            bent = curvature(loads(root @ rest)[1], root, trial)
            if step < SAG.least_share or np.linalg.eigvalsh(bent)[0] < SAG.about_to_buckle:
                return Settled(root @ rest, share, weakest_joint(bent, root, units))
    return Settled(root @ rest, share, 0)


def _rest_from(start: Array, share: float, loads: Loads, root: Array, units: Array) -> Array | None:
    """Return the rest y under a share of the load, by Newton's method; None if it does not contract."""
    rest = start
    before = np.inf
    while True:
        torques, gradient = loads(root @ rest)
        try:
            factor = cho_factor(curvature(gradient, root, share), lower=True)
        except (np.linalg.LinAlgError, ValueError):  # not convex, or not finite
            return None
        move = -cho_solve(factor, rest + share * (root.T @ torques))
        size = float(np.abs(root @ move / units).max())
        if not size <= min(SAG.farthest_move, SAG.contraction * before):
            return None
        rest = rest + move
        if size <= SAG.settled:
            return np.asarray(rest)
        before = size
