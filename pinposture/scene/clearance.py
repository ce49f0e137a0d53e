"""How far an arm is from what surrounds it, and from itself."""

from __future__ import annotations

import warnings
from typing import NamedTuple
from weakref import WeakKeyDictionary

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from pinposture.arm import Arm, ArmState
from pinposture.arm.checks import finite_vector
from pinposture.arm.configurations import ConfigurationSpace
from pinposture.errors import InvalidValue, PostureWarning
from pinposture.scene.bodies import bodies_of
from pinposture.scene.checks import is_count
from pinposture.scene.distances import Distances
from pinposture.scene.escape import escape_direction
from pinposture.scene.narrow import Contact
from pinposture.scene.pairs import ALWAYS_CLOSE, LeftOut, choose_pairs
from pinposture.scene.placements import placements_of
from pinposture.scene.scene import Scene
from pinposture.scene.solids import solid

Array = NDArray[np.float64]
Pair = tuple[str, str]

MENTIONED = 4
"""How many pairs a warning lists."""

IN_PLANE = 1e-3
"""Share of a normal in the plane of a planar arm below which the arm is shown another way out."""


class Closest(NamedTuple):
    """The pair that is nearest to each other, or deepest in each other.

    Attributes:
        distance: between their surfaces, negative where they overlap [m]; infinite if there is no pair.
        pair: names of the body and of the obstacle or the other body; None if there is no pair.
    """

    distance: float
    pair: Pair | None


class Nearness(NamedTuple):
    """The pairs that are near, nearest first, and how their distances change.

    Attributes:
        distances: between their surfaces, negative where they overlap, (k,) [m].
        rows: change of each distance with the joint displacement, (k, nv) [m/rad or m/m]. Where a distance
            has no derivative, or a planar arm could only leave its plane, the direction that leads out.
        pairs: names of the body and of the obstacle or the other body, k of them. A body of several solids
            may have several rows with one name.
        points: point of the body nearest to the other, (k, 3) [m], world frame.
        normals: unit vector in which the body moves straight away, (k, 3), world axes.
        minimum: the smallest of the distances of all pairs, near or not, exactly [m]; infinite without pairs.
        pair: the pair that has it; None if there is no pair.
    """

    distances: Array
    rows: Array
    pairs: tuple[Pair, ...]
    points: Array
    normals: Array
    minimum: float
    pair: Pair | None


class Clearance:
    """The distances between a scene and an arm; make one with `Scene.around`. May be shared between threads.

    Distances are exact: closed forms for balls and capsules among themselves and against half-spaces, coal
    for everything else. Bounds of all pairs decide which of them need be asked for.

    Attributes:
        scene: the scene.
        bodies: names of the bodies of the arm, from base to tip.
        pairs: names of all pairs that are looked at.
        left_out: pairs that are not, because no motion could tell them apart, or they touch where the arm
            is straight; bodies next to each other are not even listed.
    """

    def __init__(self, scene: Scene, arm: Arm) -> None:
        # Not the arm itself: it would never be forgotten by what remembers clearances by arm.
        self.scene = scene
        self._model, self._plane = arm.model, np.array(arm.plane)
        self._space, self._places = ConfigurationSpace(arm.model), placements_of(arm)
        bodies = bodies_of(arm, scene.arm_radius)
        self._solids = [solid(body.shape) for body in bodies]
        obstacles = {name: solid(obstacle) for name, obstacle in scene.obstacles.items()}
        self.bodies = tuple(body.name for body in bodies)
        names = (*self.bodies, *obstacles)
        chosen, left_out = choose_pairs(arm, self._places, bodies, self._solids, obstacles, scene)
        self.left_out = tuple(LeftOut(names[a], names[b], why) for (a, b), why in left_out.items())
        close = [f"{each.first} to {each.second}" for each in self.left_out if each.reason == ALWAYS_CLOSE]
        if close:
            named = ", ".join(close[:MENTIONED]) + (
                f" and {len(close) - MENTIONED} more pairs" if close[MENTIONED:] else ""
            )
            text = f"{named}: {ALWAYS_CLOSE}; nothing keeps them apart (margin {scene.margin:g} m)"
            warnings.warn(text, PostureWarning, stacklevel=4)
        joints = [body.joint for body in bodies]
        self._distances = Distances(self._solids, joints, list(obstacles.values()), chosen)
        first, second = self._distances.first, self._distances.second
        self.pairs = tuple((names[a], names[b]) for a, b in zip(first, second, strict=True))
        moved = np.vstack([_moved(arm.model)[joints], np.zeros((len(obstacles), arm.nv))])
        # A joint that carries both bodies of a pair moves neither of them against the other.
        self._effect = moved[first] - moved[second]  # (n, nv)

    def nearest(self, state: ArmState, within: float) -> Nearness:
        """The pairs nearer than a distance, and how their distances change with the joints.

        Args:
            state: a state of the arm.
            within: how near [m]; may be infinite.

        Raises:
            InvalidValue: a state of another arm, or not a distance.
        """
        if not isinstance(state, ArmState) or state.arm.model is not self._model:
            raise InvalidValue("state", state, "a state of the arm that the scene was put around")
        if not (isinstance(within, (int, float, np.floating)) and within >= 0.0):
            raise InvalidValue("within", within, "a distance of at least 0 [m]")
        spatial = np.reshape(pin.computeJointJacobians(self._model, self._places.data, state.q), (6, -1))
        turns, shifts = self._places.rotations, self._places.positions
        near, nearest = self._distances.near(turns, shifts, float(within))
        near = [(k, self._with_normal(k, contact, turns, shifts)) for k, contact in near]
        chosen = [k for k, _ in near]
        normals = np.array([contact.normal for _, contact in near]).reshape(-1, 3)
        points = np.array([contact.point for _, contact in near]).reshape(-1, 3)
        # d/dt of n . p for a point p of a body that the columns (v, w) of the spatial Jacobian move.
        rows = (normals @ spatial[:3] + np.cross(points, normals) @ spatial[3:]) * self._effect[chosen]
        best = self._closest(*nearest)
        return Nearness(
            distances=np.array([contact.distance for _, contact in near]),
            rows=rows,
            pairs=tuple(self.pairs[k] for k in chosen),
            points=points,
            normals=normals,
            minimum=best.distance,
            pair=best.pair,
        )

    def minimum(self, q: ArrayLike) -> Closest:
        """The smallest of the distances of all pairs at a configuration.

        Args:
            q: configuration, (nq,) [rad or m].

        Raises:
            InvalidValue: q has the wrong size or is not finite.
        """
        pin.forwardKinematics(self._model, self._places.data, self._space.checked(q))
        places = self._places
        return self._closest(*self._distances.minimum(places.rotations[None], places.positions[None]))

    def minimum_between(self, q0: ArrayLike, dq: ArrayLike, samples: int = 10) -> Closest:
        """The smallest distance on the way from a configuration along a joint displacement.

        Args:
            q0: where the way begins, (nq,) [rad or m].
            dq: the displacement, (nv,) [rad or m].
            samples: at how many configurations: equally spaced, the end among them, the beginning not.

        Raises:
            InvalidValue: a vector of the wrong size or not finite, or no samples.
        """
        if not is_count(samples):
            raise InvalidValue("samples", samples, "a whole number of at least 1")
        start, way = self._space.checked(q0, "q0"), finite_vector("dq", dq, self._model.nv)
        return self.minimum_along(start, way * (np.arange(1, samples + 1)[:, None] / samples))

    def minimum_along(self, q0: Array, offsets: Array, below: float = np.inf) -> Closest:
        """The smallest distance at several configurations.

        Args:
            q0: a configuration, (nq,) [rad or m], as `Arm.checked` returns it.
            offsets: displacements from it, (s, nv) [rad or m], s > 0.
            below: distances that matter [m]: if none is smaller, some larger one is returned, or none, which
                takes less time.
        """
        places, samples = self._places, len(offsets)
        turns = np.empty((samples, *places.rotations.shape))
        shifts = np.empty((samples, *places.positions.shape))
        for i, offset in enumerate(offsets):
            pin.forwardKinematics(self._model, places.data, self._space.integrate(q0, offset))
            turns[i], shifts[i] = places.rotations, places.positions
        return self._closest(*self._distances.minimum(turns, shifts, below))

    def _closest(self, distance: float, pair: int) -> Closest:
        return Closest(distance, self.pairs[pair] if pair >= 0 else None)

    def _with_normal(self, pair: int, contact: Contact, turns: Array, shifts: Array) -> Contact:
        """The contact with a normal along which the arm can leave."""
        lost = not contact.normal.any()
        if not lost and len(self._plane) == 2 and contact.distance < self.scene.margin:
            lost = float(np.linalg.norm(self._plane @ contact.normal)) < IN_PLANE
        if not lost:
            return contact
        moving, still = self._distances.axes(pair, turns, shifts)
        return contact._replace(normal=escape_direction(moving, still, self._plane))


_KNOWN: WeakKeyDictionary[Arm, dict[Scene, Clearance]] = WeakKeyDictionary()
_MOST = 16  # scenes around one arm that are remembered


def clearance_of(scene: Scene, arm: Arm) -> Clearance:
    """The clearance of a scene and an arm; remembered as long as the arm lives. See `Scene.around`."""
    if not isinstance(arm, Arm):
        raise InvalidValue("arm", arm, "an Arm")
    known = _KNOWN.setdefault(arm, {})
    if scene not in known:
        if len(known) >= _MOST:
            known.clear()
        known[scene] = Clearance(scene, arm)
    return known[scene]


def _moved(model: pin.Model) -> Array:
    """1 where a degree of freedom moves a joint's frame, else 0, (njoints, nv)."""
    moved = np.zeros((model.njoints, model.nv))
    for joint in range(1, model.njoints):
        for above in list(model.supports[joint])[1:]:  # the first is the world
            start = model.joints[above].idx_v
            moved[joint, start : start + model.joints[above].nv] = 1.0
    return moved
