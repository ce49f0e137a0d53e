"""How far an arm is from its surroundings and from itself, and which pairs of bodies are looked at."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple, TypeAlias

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from pinposture._validation import finite_vector, is_count
from pinposture.arm import Arm, ArmState
from pinposture.arm.configurations import ConfigurationSpace
from pinposture.collision.bodies import Body, bodies_of
from pinposture.collision.distances import Narrow, PairDistances, Placements, TreeKinematics
from pinposture.collision.obstacles import Solid, solid
from pinposture.collision.scene import Scene
from pinposture.errors import InvalidValue, PostureWarning

Array = NDArray[np.float64]

# Which pairs of solids are looked at, and which cannot be told apart by any motion of the arm.
#
# Left out are * bodies on one joint, and bodies on joints that follow each other: they touch where they are
# joined; * bodies of the arm that are nearer to each other than twice the margin where the arm is stretched
# farthest, or at its neutral configuration: links so thick or so short that their neighbours' neighbours
# touch, tubes that slide in one another, meshes that overlap as they were made. Had they to keep clear, the
# arm could not even stand straight; * an obstacle that the arm is mounted on: one within the margin of an
# end of a body that no joint moves; * bodies that no joint moves, against obstacles; * pairs that are within
# the margin in every posture that is tried, the straight one and many arbitrary ones: something beside the
# base, that the first links pass however the arm bends. These are also warned of. If the last body is among
# them, the arm is inside of an obstacle, and nothing is left out.

IndexPair: TypeAlias = tuple[int, int]

POSTURES = 40
"""Arbitrary postures that are tried before a pair counts as one that can never keep the margin."""

STRETCHED = 2.0
"""Bodies nearer than this many margins where the arm is straight are left out."""
ALWAYS_CLOSE = "within the margin however the arm bends"
"""Why a pair is left out that is also warned of."""

_STILL = 1e-9
"""How far a point may move that does not move, relative to the arm."""


class ExcludedPair(NamedTuple):
    """A pair whose distance is not computed, though its bodies are neither on one joint nor joined by one.

    Attributes:
        first: name of the body.
        second: name of the other body, or of the obstacle.
        reason: why.
    """

    first: str
    second: str
    reason: str


def self_pairs(model: pin.Model, bodies: Sequence[Body]) -> Iterator[IndexPair]:
    """The pairs of bodies that can move against each other and are not joined by one joint."""
    for second, other in enumerate(bodies):
        for first, body in enumerate(bodies[:second]):
            joints = (body.joint, other.joint)
            joined = any(a == b or int(model.parents[a]) == b for a, b in (joints, joints[::-1]) if a or b)
            if not joined and joints != (0, 0):
                # The one nearer to the tip comes first: it is the one that moves away.
                yield (second, first) if other.joint >= body.joint else (first, second)


def choose_pairs(
    arm: Arm,
    kinematics: TreeKinematics,
    bodies: Sequence[Body],
    solids: Sequence[Solid],
    obstacles: Mapping[str, Solid],
    scene: Scene,
) -> tuple[list[IndexPair], dict[IndexPair, str]]:
    """The pairs to look at, by the rules above.

    Args:
        arm: the arm.
        kinematics: where its joints are.
        bodies: its bodies.
        solids: the same as solids.
        obstacles: the obstacles.
        scene: what the pairs are for.

    Returns:
        Pairs of a body and another, or of a body and the number of bodies plus that of an obstacle; and those
        left out, with the reason.
    """
    fixed, count = list(obstacles.values()), len(bodies)
    standing = _mounted(arm, kinematics, bodies, solids, fixed, scene.margin)
    excluded = dict.fromkeys(sorted(standing), "the arm is mounted on it")
    moving = [index for index, body in enumerate(bodies) if body.joint]
    against = [(index, count + k) for index in moving for k in range(len(fixed))]
    own = list(self_pairs(arm.model, bodies)) if scene.self_collision else []
    near = PairDistances(solids, [body.joint for body in bodies], [], own)
    touching = set[IndexPair]()
    for q in (arm.straight(), arm.neutral()):
        limit = STRETCHED * scene.margin + _STILL * arm.length
        found = near.near(kinematics.place(q), limit).pairs
        touching |= {(int(near.first[k]), int(near.second[k])) for k in found}
    excluded |= dict.fromkeys(sorted(touching), "near each other where the arm is straight or neutral")
    left = [pair for pair in (*against, *own) if pair not in excluded]
    always = _always_close(arm, kinematics, bodies, solids, fixed, left, scene.margin)
    close = dict.fromkeys(always, ALWAYS_CLOSE)
    return [pair for pair in left if pair not in close], excluded | close


def _always_close(
    arm: Arm,
    kinematics: TreeKinematics,
    bodies: Sequence[Body],
    solids: Sequence[Solid],
    fixed: Sequence[Solid],
    pairs: Sequence[IndexPair],
    margin: float,
) -> list[IndexPair]:
    """Pairs that are nearer than the margin in every posture that is tried."""
    rng, left = np.random.default_rng(0), list(pairs)
    postures = (arm.straight(), arm.neutral(), *(arm.random(rng) for _ in range(POSTURES)))
    for q in postures:
        if not left:
            break
        distances = PairDistances(solids, [body.joint for body in bodies], fixed, left)
        found = np.sort(distances.near(kinematics.place(q), margin).pairs)
        left = [(int(distances.first[k]), int(distances.second[k])) for k in found]
    # What not even the tip comes clear of is no neighbour of the base: the arm is inside of it.
    around_all = {second for first, second in left if second >= len(bodies) and first == len(bodies) - 1}
    return [pair for pair in left if pair[1] not in around_all]


def _mounted(
    arm: Arm,
    kinematics: TreeKinematics,
    bodies: Sequence[Body],
    solids: Sequence[Solid],
    fixed: Sequence[Solid],
    margin: float,
) -> set[IndexPair]:
    """Pairs of a body and an obstacle that some point of the body never moves away from."""
    ends = np.array([[each.start, each.end] for each in solids]).reshape(-1, 2, 3)
    joints, rng, found = [body.joint for body in bodies], np.random.default_rng(0), []
    for q in (arm.neutral(), arm.random(rng), arm.random(rng)):
        at = kinematics.place(q)
        turns, shifts = at.rotations[0, joints], at.origins[0, joints]
        found.append(ends @ turns.swapaxes(1, 2) + shifts[:, None])
    still = np.ptp(found, axis=0).max(axis=2) <= _STILL * arm.length  # (bodies, 2)
    narrow, pairs = Narrow(), set()
    for body, end in np.argwhere(still & (np.array(joints) > 0)[:, None]):
        radius = solids[body].radius if solids[body].round else 1e-3 * _STILL * arm.length
        ball, at = coal.Sphere(radius), coal.Transform3s(np.eye(3), found[0][body, end])
        for k, each in enumerate(fixed):
            there = coal.Transform3s(each.rotation, each.position)
            if narrow.distance((ball, at, each.geometry, there)) <= margin:
                pairs.add((int(body), len(bodies) + k))
    return pairs


# Which way out, where the distance of two solids does not say.
#
# Where the axes of two capsules meet, every direction across both is equally short; and a planar arm that
# crosses something in its plane would be shorter out of the plane, where it cannot go.

_SMALL = 1e-9


def escape_direction(first: Array, second: Array, plane: Array) -> Array:
    """The direction of the shortest translation that takes one line from another, across both if it can be.

    Args:
        first: ends of the line that is to move, (2, 3) [m].
        second: ends of the line that it meets, (2, 3) [m].
        plane: orthonormal directions in which it can move, (2, 3) or (3, 3).

    Returns:
        Unit vector in the span of `plane`, (3,); the same for the same arguments.
    """
    moving, still = first @ plane.T, second @ plane.T
    u, v = moving[1] - moving[0], still[1] - still[0]
    size = max(float(np.linalg.norm(u)), float(np.linalg.norm(v)), 1e-300)
    apart = moving.mean(axis=0) - still.mean(axis=0)
    if len(plane) == 2:
        across = [np.array([-line[1], line[0]]) for line in (u, v)]
        directions = [line / np.linalg.norm(line) for line in across if np.linalg.norm(line) > _SMALL * size]
        if not directions:  # both are points in the plane
            gap = float(np.linalg.norm(apart))
            return np.asarray((apart / gap if gap > 0.0 else np.array([1.0, 0.0])) @ plane)
        return np.asarray(_shortest(moving, still, directions) @ plane)
    normal = np.cross(u, v)
    if np.linalg.norm(normal) <= _SMALL * size * size:  # parallel: across the line, from middle to middle
        line = (u if np.linalg.norm(u) >= np.linalg.norm(v) else v) / size
        normal = apart - line * (line @ apart)
        if np.linalg.norm(normal) <= _SMALL * size:
            normal = np.cross(line, np.eye(3)[np.argmin(np.abs(line))])
            if np.linalg.norm(normal) == 0.0:  # two points in one place
                normal = np.array([0.0, 0.0, 1.0])
    return np.asarray((normal / np.linalg.norm(normal)) @ plane)


def _shortest(moving: Array, still: Array, directions: list[Array]) -> Array:
    """Of several directions and their opposites, the one along which the lines are soonest apart."""
    best, least = directions[0], np.inf
    for direction in directions:
        for sign in (1.0, -1.0):
            way = sign * direction
            needed = float((still @ way).max() - (moving @ way).min())
            if needed < least - 1e-12:
                best, least = way, needed
    return best


# How far an arm is from what surrounds it, and from itself.

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


class Distances(NamedTuple):
    """The pairs that are near, nearest first, and how their distances change.

    Attributes:
        distances: between their surfaces, negative where they overlap, (k,) [m].
        jacobian: derivatives of the distances by the joint displacement, (k, nv) [m/rad or m/m]. Where a
            distance has none, or a planar arm could only leave its plane, the direction that leads out.
        pairs: names of the body and of the obstacle or the other body, k of them. A body of several solids
            may have several rows with one name.
        points: point of the body nearest to the other, (k, 3) [m], world frame.
        normals: unit vector in which the body moves straight away, (k, 3), world axes.
        minimum: the smallest of the distances of all pairs, near or not, exactly [m]; infinite without pairs.
        pair: the pair that has it; None if there is no pair.
    """

    distances: Array
    jacobian: Array
    pairs: tuple[Pair, ...]
    points: Array
    normals: Array
    minimum: float
    pair: Pair | None


MAX_MODELS = 16
"""How many collision models an arm remembers."""


class CollisionModel:
    """The distances of an arm from a scene, and from itself. May be shared between threads.

        model = pp.CollisionModel(arm, scene)
        model.minimum(q).distance

    An arm remembers its models: the same arm and scene have the same model. Meshes of the arm that are
    missing or cannot be used are named in a `PostureWarning`, once for each arm and scene.

    Distances of balls and capsules, from each other and from boxes, half-spaces and cylinders, are compiled
    closed forms; coal computes all others. They are exact, except where the axis of a capsule is inside of a
    cylinder: the depth may be too large then, never too small. Bounds decide which pairs are computed.

    Attributes:
        scene: the scene.
        bodies: names of the bodies of the arm, from base to tip.
        pairs: names of all pairs whose distance is computed.
        excluded_pairs: pairs whose distance is not, because no motion could separate them, or they touch
            where the arm is straight; bodies next to each other are not even listed.
    """

    def __new__(cls, arm: Arm, scene: Scene) -> CollisionModel:
        """Find or make the model of an arm and a scene.

        Args:
            arm: the arm.
            scene: the scene.

        Raises:
            InvalidValue: not an arm or not a scene.
        """
        if not isinstance(arm, Arm):
            raise InvalidValue("arm", arm, "an Arm")
        if not isinstance(scene, Scene):
            raise InvalidValue("scene", scene, "a Scene")
        models: dict[Scene, CollisionModel] = arm.cache.setdefault(cls, {})
        if scene not in models:
            made = super().__new__(cls)
            made._prepare(arm, scene)
            if len(models) >= MAX_MODELS:
                models.clear()
            models[scene] = made
        return models[scene]

    def _prepare(self, arm: Arm, scene: Scene) -> None:
        self.scene = scene
        self._model, self._plane = arm.model, np.array(arm.plane)
        self._space, self._kinematics = ConfigurationSpace(arm.model), TreeKinematics(arm.model)
        bodies = bodies_of(arm, scene.arm_radius)
        self._solids = [solid(body.shape) for body in bodies]
        obstacles = {name: solid(obstacle) for name, obstacle in scene.obstacles.items()}
        self.bodies = tuple(body.name for body in bodies)
        names = (*self.bodies, *obstacles)
        chosen, excluded = choose_pairs(arm, self._kinematics, bodies, self._solids, obstacles, scene)
        self.excluded_pairs = tuple(ExcludedPair(names[a], names[b], why) for (a, b), why in excluded.items())
        close = [
            f"{each.first} to {each.second}" for each in self.excluded_pairs if each.reason == ALWAYS_CLOSE
        ]
        if close:
            named = ", ".join(close[:MENTIONED]) + (
                f" and {len(close) - MENTIONED} more pairs" if close[MENTIONED:] else ""
            )
            text = f"{named}: {ALWAYS_CLOSE}; nothing keeps them apart (margin {scene.margin:g} m)"
            warnings.warn(text, PostureWarning, stacklevel=3)
        joints = [body.joint for body in bodies]
        self._distances = PairDistances(self._solids, joints, list(obstacles.values()), chosen)
        first, second = self._distances.first, self._distances.second
        self.pairs = tuple((names[a], names[b]) for a, b in zip(first, second, strict=True))
        self._carriers = np.array([*joints, *[0] * len(obstacles)], dtype=np.int64)

    def nearest(self, state: ArmState, within: float) -> Distances:
        """The pairs nearer than a distance, and how their distances change with the joints.

        Args:
            state: a state of the arm.
            within: how near [m]; may be infinite.

        Raises:
            InvalidValue: a state of another arm, or not a distance.
        """
        if not isinstance(state, ArmState) or state.arm.model is not self._model:
            raise InvalidValue("state", state, "a state of the arm that the collision model was made for")
        if not (isinstance(within, (int, float, np.floating)) and within >= 0.0):
            raise InvalidValue("within", within, "a distance of at least 0 [m]")
        placements = self._kinematics.place(state.q)
        near = self._distances.near(placements, float(within))
        normals = self._escape_normals(near.pairs, near.distances, near.normals, placements)
        first = self._carriers[self._distances.first[near.pairs]]
        second = self._carriers[self._distances.second[near.pairs]]
        jacobian = self._kinematics.differentiate(placements, first, second, near.points, normals)
        best = self._closest(near.minimum, near.nearest)
        return Distances(
            distances=near.distances,
            jacobian=jacobian,
            pairs=tuple(self.pairs[k] for k in near.pairs),
            points=near.points,
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
        placements = self._kinematics.place(self._space.checked(q))
        return self._closest(*self._distances.minimum(placements))

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
        placements = self._kinematics.place(q0, offsets)
        return self._closest(*self._distances.minimum(placements, below))

    def keeps(self, q0: Array, offsets: Array, least: float) -> bool:
        """Whether all distances are at least so large at several configurations.

        Args:
            q0: a configuration, (nq,) [rad or m], as `Arm.checked` returns it.
            offsets: displacements from it, (s, nv) [rad or m]; those where it may not be come first.
            least: the distance [m].
        """
        return self._distances.minimum(self._kinematics.place(q0, offsets), least, least)[0] >= least

    def _closest(self, distance: float, pair: int) -> Closest:
        return Closest(distance, self.pairs[pair] if pair >= 0 else None)

    def _escape_normals(
        self, pairs: NDArray[np.int64], distances: Array, normals: Array, placements: Placements
    ) -> Array:
        """Return normals along which the arm can leave, where there is none or it leads out of the plane."""
        lost = ~normals.any(axis=1)
        if len(self._plane) == 2:
            across = np.linalg.norm(normals @ self._plane.T, axis=1) < IN_PLANE
            lost |= across & (distances < self.scene.margin)
        for k in np.flatnonzero(lost):
            moving, still = self._distances.axes(int(pairs[k]), placements)
            normals[k] = escape_direction(moving, still, self._plane)
        return normals
