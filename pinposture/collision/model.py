"""Distances between an arm, obstacles and itself, and the choice of the pairs to check."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from functools import cached_property, partial
from itertools import product
from typing import NamedTuple, TypeAlias

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from pinposture._validation import SMALLEST_LENGTH, finite_vector, require_instance
from pinposture.arm import Arm, ArmState
from pinposture.arm.arm import kept
from pinposture.arm.configurations import ConfigurationSpace
from pinposture.collision.bodies import STAND_IN_RADIUS, Body, bodies_of, carried_bodies
from pinposture.collision.distances import (
    JointFrames,
    NearPairs,
    PairDistances,
    TreeKinematics,
)
from pinposture.collision.obstacles import Obstacle
from pinposture.collision.scene import USUAL_MARGIN, Scene, split_velocity
from pinposture.collision.shapes import Sphere
from pinposture.collision.solids import Solid
from pinposture.errors import InvalidValue, enumerated, warn_caller
from pinposture.kernels.arrays import (
    JOINT,
    Contacts,
    MotionSearch,
    SearchTrees,
    TreeSettings,
)
from pinposture.units import ROUNDING, length_text

Array = NDArray[np.float64]
Pair = tuple[str, str]
IndexPair: TypeAlias = tuple[int, int]


class PairSelection(NamedTuple):
    """Which pairs of bodies a collision model leaves out."""

    margins_apart: float = 2.0
    """Pairs of bodies nearer than this many margins in the straight or neutral posture are left out."""

    random_postures: int = 40
    """Number of random postures tried before a pair counts as never able to keep the margin."""

    listed: int = 4
    """Largest number of pairs that a warning lists."""

    close: str = "within the margin however the arm bends"
    """Why a pair is left out, which is said in a warning."""

    overlapping: str = "overlapping in every posture"
    """The same of a pair whose bodies intersect."""


PAIRS = PairSelection()


MOTION_TOLERANCE = 1e-4
OPEN_MOTION = 5e-3
"""Error allowed in the smallest distance on a motion, and initial motion between samples of pairs that need
coal, both in arm lengths."""


class CollisionObjects(NamedTuple):
    """An arm among obstacles.

    Attributes:
        arm: the arm.
        kinematics: the kinematics of its model.
        joints: index of the joint that carries each body.
        solids: the bodies, each in the frame of its joint, as in `JointFrames`; the obstacles that the arm
            carries come last.
        fixed: the other obstacles, world frame.
        depths: how far beneath its surface the distance from each obstacle counts, as in `PairDistances` [m].
        own: number of bodies that are not obstacles.
    """

    arm: Arm
    kinematics: TreeKinematics
    joints: Sequence[int]
    solids: Sequence[Solid]
    fixed: Sequence[Solid]
    depths: Sequence[float]
    own: int

    def distances(self, pairs: Sequence[IndexPair]) -> PairDistances:
        """Return the distances of pairs of bodies, or of bodies and obstacles; see `PairDistances`."""
        return PairDistances(self.solids, self.joints, self.fixed, pairs, self.depths)


def arm_alone(arm: Arm) -> Scene:
    """Return the scene of an arm without obstacles, which has only itself to keep clear of.

    Motions without a scene are judged in it, and the commands, task files and the editor plan in it.

    Args:
        arm: the arm. Its stand-in capsules are no thicker than the margin, so that a short arm is not asked
            for a clearance that is large for it.
    """
    return Scene(margin=min(USUAL_MARGIN, STAND_IN_RADIUS * float(arm.chain.module_lengths.mean())))


def effective_scene(arm: Arm, scene: Scene | None) -> Scene:
    """Return what an arm must keep clear of: a scene, or if that is None, itself."""
    return arm_alone(arm) if scene is None else scene


def stationary_ends(objects: CollisionObjects) -> list[tuple[int, Array]]:
    """Return the axis ends of moving bodies that no joint motion moves.

    Each is a body index and a world position, (3,) [m].
    """
    ends = np.array([[solid.start, solid.end] for solid in objects.solids]).reshape(-1, 2, 3)
    arm = objects.arm
    joints = np.array(objects.joints, dtype=int)
    rng = np.random.default_rng(0)
    axes = []
    for q in (arm.neutral(), arm.random(rng), arm.random(rng)):
        rotations, positions = (array[0, joints] for array in objects.kinematics.place(q))
        axes.append(ends @ rotations.swapaxes(1, 2) + positions[:, None])
    still = np.ptp(axes, axis=0).max(axis=2) <= ROUNDING * arm.length  # (bodies, 2)
    return [(int(body), axes[0][body, end]) for body, end in np.argwhere(still & (joints > 0)[:, None])]


class ExcludedPair(NamedTuple):
    """A pair whose distance is not computed, although its bodies are not on the same or adjacent joints.

    Attributes:
        first: name of the body.
        second: name of the other body or the obstacle; for a scan or mesh, possibly only a part is excluded.
        reason: why the pair is excluded.
    """

    first: str
    second: str
    reason: str


def _self_pairs(model: pin.Model, carriers: Sequence[int]) -> list[IndexPair]:
    """Return the pairs of bodies that can move relative to each other and are not on adjacent joints."""
    pairs = []
    for second, other in enumerate(carriers):
        for first, joint in enumerate(carriers[:second]):
            joints = (joint, other)
            joined = any(a == b or int(model.parents[a]) == b for a, b in (joints, joints[::-1]) if a or b)
            if not joined and joints != (0, 0):
                # The body nearer to the tip comes first: it is the one that moves away.
                pairs.append((second, first) if other >= joint else (first, second))
    return pairs


def _carried_pairs(objects: CollisionObjects) -> Iterator[IndexPair]:
    """Yield the pairs of a body that the arm carries and of a body that does not hold it.

    Those on adjacent joints hold it, and those beyond the joint that carries it.
    """
    model = objects.arm.model
    for carried, own in product(range(objects.own, len(objects.joints)), range(objects.own)):
        joint = objects.joints[carried]
        other = objects.joints[own]
        if joint not in model.supports[other] and other != int(model.parents[joint]):
            yield carried, own


def _choose_pairs(
    objects: CollisionObjects, scene: Scene, beside: Collection[IndexPair]
) -> tuple[list[IndexPair], dict[IndexPair, str]]:
    """Return the pairs that could be checked, and those of them, and others, that are excluded with a reason.

    A pair is the indices of two bodies, or of a body and a solid (or piece of a scan or mesh) among the
    obstacles, counted after the bodies. Excluded without a reason are pairs of bodies on the same or adjacent
    joints, and pairs of obstacles with bodies that no joint moves. Excluded with a reason, unless the
    obstacle moves, are

    * obstacles that the arm is mounted on: within the margin of a stationary end of a body;
    * bodies nearer to each other than twice the margin in the straight or neutral posture, such as thick or
      short links, telescoping tubes, and overlapping meshes: the arm could not even be straight;
    * pairs within the margin in every posture tried, such as an obstacle beside the base. If the last body is
      among them, the arm is inside the obstacle, and these pairs are kept.

    What the arm carries is a body that keeps clear of obstacles but those beside it, and of the arm but of
    what holds it.
    """
    arm = objects.arm
    count = len(objects.joints)
    mounted = _mounted_pairs(objects, scene.margin)
    excluded = dict.fromkeys(sorted(mounted), "the arm is mounted on it")
    moving = [index for index, joint in enumerate(objects.joints) if joint]
    against = [(index, count + k) for index in moving for k in range(len(objects.fixed))]
    against = [pair for pair in against if pair not in beside]
    internal = _self_pairs(arm.model, objects.joints[: objects.own]) if scene.self_collision else []
    internal += _carried_pairs(objects)
    near = objects.distances(internal)
    touching = set[IndexPair]()
    for q in (arm.straight(), arm.neutral()):
        limit = PAIRS.margins_apart * scene.margin + ROUNDING * arm.length
        numbers = near.near(objects.kinematics.place(q), limit).pairs
        touching |= {(int(near.first[k]), int(near.second[k])) for k in numbers}
    excluded |= dict.fromkeys(sorted(touching), "near each other where the arm is straight or neutral")
    candidates = [*against, *internal]
    left = [pair for pair in candidates if pair not in excluded]
    close = _always_close(objects, left, scene.margin)
    overlapping = _always_close(objects, close, 0.0)
    excluded |= dict.fromkeys(close, PAIRS.close) | dict.fromkeys(overlapping, PAIRS.overlapping)
    return candidates, excluded


def _always_close(objects: CollisionObjects, pairs: Sequence[IndexPair], margin: float) -> list[IndexPair]:
    """Return the pairs that are closer than the margin in all sampled postures."""
    arm = objects.arm
    rng = np.random.default_rng(0)
    left = list(pairs)
    distances = objects.distances(left)
    count = len(objects.joints)
    for q in (arm.straight(), arm.neutral(), *(arm.random(rng) for _ in range(PAIRS.random_postures))):
        if not left:
            break
        numbers = np.sort(distances.near(objects.kinematics.place(q), margin).pairs)
        left = [(int(distances.first[k]), int(distances.second[k])) for k in numbers]
        distances = distances.among(left)
    # If even the last body never clears an obstacle, the arm is inside that obstacle.
    around_all = {second for first, second in left if second >= count and first == objects.own - 1}
    return [pair for pair in left if pair[1] not in around_all]


def _mounted_pairs(objects: CollisionObjects, margin: float) -> set[IndexPair]:
    """Return the pairs of a body and an obstacle near a stationary end of the body."""
    still = stationary_ends(objects)
    solids = objects.solids
    fixed = objects.fixed
    balls = []
    for body, position in still:
        radius = solids[body].radius if solids[body].round else SMALLEST_LENGTH
        balls.append(Sphere(tuple(position), radius).solid())
    pairs = [(ball, len(balls) + k) for ball in range(len(balls)) for k in range(len(fixed))]
    distances = PairDistances(balls, [0] * len(balls), fixed, pairs, objects.depths)
    near = distances.near(objects.kinematics.place(objects.arm.neutral()), np.nextafter(margin, np.inf)).pairs
    first = distances.first[near]
    second = distances.second[near] - len(balls)
    return {(still[ball][0], len(solids) + int(k)) for ball, k in zip(first, second, strict=True)}


def escape_direction(first: Array, second: Array, plane: Array) -> Array:
    """Return the direction of the shortest translation that separates two segments.

    It replaces a normal that is undefined because the axes of two capsules meet, or that points out of the
    plane of a planar arm. It is normal to both segments if possible.

    Args:
        first: ends of the segment to move, (2, 3) [m].
        second: ends of the other segment, (2, 3) [m].
        plane: orthonormal directions in which the first can move, (2, 3) or (3, 3).

    Returns:
        Unit vector in the span of `plane`, (3,).
    """
    moving = first @ plane.T
    still = second @ plane.T
    u = moving[1] - moving[0]
    v = still[1] - still[0]
    size = max(float(np.linalg.norm(u)), float(np.linalg.norm(v)), 1e-300)
    offset = moving.mean(axis=0) - still.mean(axis=0)
    if len(plane) == 2:
        normals = [np.array([-line[1], line[0]]) for line in (u, v)]
        directions = [n / np.linalg.norm(n) for n in normals if np.linalg.norm(n) > ROUNDING * size]
        if not directions:  # both are points in the plane
            gap = float(np.linalg.norm(offset))
            return np.asarray((offset / gap if gap > 0.0 else np.array([1.0, 0.0])) @ plane)
        return np.asarray(_shortest(moving, still, directions) @ plane)
    normal = np.cross(u, v)
    if np.linalg.norm(normal) <= ROUNDING * size * size:  # parallel: from middle to middle, normal to both
        line = (u if np.linalg.norm(u) >= np.linalg.norm(v) else v) / size
        normal = offset - line * (line @ offset)
        if np.linalg.norm(normal) <= ROUNDING * size:
            normal = np.cross(line, np.eye(3)[np.argmin(np.abs(line))])
            if np.linalg.norm(normal) == 0.0:  # coincident points
                normal = np.array([0.0, 0.0, 1.0])
    return np.asarray((normal / np.linalg.norm(normal)) @ plane)


def _shortest(moving: Array, still: Array, directions: list[Array]) -> Array:
    """Return the direction, of those given and their opposites, along which the segments separate soonest."""
    best = directions[0]
    least = np.inf
    for direction in (sign * axis for axis in directions for sign in (1.0, -1.0)):
        needed = float((still @ direction).max() - (moving @ direction).min())
        if needed < least - 1e-12:
            best = direction
            least = needed
    return best


class Closest(NamedTuple):
    """The nearest pair, or the one with the deepest overlap.

    Attributes:
        distance: between the surfaces, negative for overlap [m]; infinite if there is no pair.
        pair: names of the body and of the obstacle or the other body; None if there is no pair.
    """

    distance: float
    pair: Pair | None


def describe_distance(pair: Sequence[str], distance: float) -> str:
    """Return the distance of a pair [m] in words."""
    size = length_text(abs(distance))
    words = f"{size} apart" if distance >= 0.0 else f"overlapping by {size}"
    return f"{' to '.join(pair)}: {words}"


class Distances(NamedTuple):
    """The near pairs, nearest first, and the derivatives of their distances.

    Attributes:
        distances: between the surfaces, negative for overlap, (k,) [m].
        jacobian: derivatives of the distances with respect to joint displacement, (k, nv) [m/rad or m/m].
            Where undefined, or where only motion out of a planar arm's plane increases the distance, the
            derivatives along another normal that separates the pair.
        pairs: k pairs of names: body, and obstacle or other body; repeated for bodies of several solids.
        numbers: indices of these pairs in `CollisionModel.pairs`, (k,).
        points: point of the body nearest to the other, (k, 3) [m], world frame.
        normals: unit vector along which the body moves straight away, (k, 3), world axes.
        rates: rates of change of the distances due to the motion of obstacles, (k,) [m/s].
        minimum: exact smallest distance of all pairs, near or not [m]; infinite without pairs.
        pair: the pair with this distance; None if there is no pair.
    """

    distances: Array
    jacobian: Array
    pairs: tuple[Pair, ...]
    numbers: NDArray[np.int64]
    points: Array
    normals: Array
    rates: Array
    minimum: float
    pair: Pair | None


class _ArmBodies(NamedTuple):
    """The bodies of an arm, which its models in all scenes have in common.

    Attributes:
        bodies: the bodies.
        kinematics: the kinematics of its model.
        solids: the bodies as solids, each in the frame of its joint.
    """

    bodies: tuple[Body, ...]
    kinematics: TreeKinematics
    solids: list[Solid]

    @classmethod
    def known(cls, arm: Arm, arm_radius: float | None) -> _ArmBodies:
        """Return the bodies of an arm with stand-ins of a radius [m], made on first use; see `bodies_of`."""
        return kept(arm, cls, arm_radius, partial(cls.of, arm, arm_radius))

    @classmethod
    def of(cls, arm: Arm, arm_radius: float | None) -> _ArmBodies:
        """Return the bodies of an arm; it takes long, as its description is read."""
        kinematics = TreeKinematics(arm.model)
        bodies = bodies_of(arm, arm_radius)
        return cls(bodies, kinematics, _solids_of(bodies, kinematics))


def _solids_of(bodies: Sequence[Body], kinematics: TreeKinematics) -> list[Solid]:
    return [body.shape.solid().turned(kinematics.turns[body.joint]) for body in bodies]


class _Choice(NamedTuple):
    """What the models of an arm and a scene have in common, whatever obstacles move.

    Attributes:
        objects: the arm among the obstacles.
        bodies: names of the bodies of the arm.
        names: names of the bodies, and of the obstacle of each solid.
        candidates: as `_choose_pairs` returns them.
        excluded: as `_choose_pairs` returns them.
        distances: the distances, of no pair.
    """

    objects: CollisionObjects
    bodies: tuple[str, ...]
    names: tuple[str, ...]
    candidates: NDArray[np.int64]
    excluded: dict[IndexPair, str]
    distances: PairDistances

    @classmethod
    def known(cls, arm: Arm, scene: Scene) -> _Choice:
        """Return the choice for an arm and a scene, made on first use."""
        return kept(arm, cls, scene, partial(cls.of, arm, scene))

    @classmethod
    def of(cls, arm: Arm, scene: Scene) -> _Choice:
        """Return the choice for an arm and a scene whose obstacles have not moved yet; it takes long."""
        alone = _ArmBodies.known(arm, scene.arm_radius)
        carried = carried_bodies(arm, scene)
        bodies = (*alone.bodies, *carried)
        named = [
            (name, solid) for name, obstacle in scene.standing.items() for solid in obstacle.geometry.solids()
        ]
        objects = CollisionObjects(
            arm,
            kinematics=alone.kinematics,
            joints=[body.joint for body in bodies],
            solids=[*alone.solids, *_solids_of(carried, alone.kinematics)],
            fixed=[solid for _, solid in named],
            depths=[scene.depth(name) for name, _ in named],
            own=len(alone.bodies),
        )
        moving = tuple(body.name for body in bodies)
        names = (*moving, *(name for name, _ in named))
        beside = {
            (len(alone.bodies) + k, len(bodies) + number)
            for k, held in enumerate(scene.carried.values())
            for number, (name, _) in enumerate(named)
            if name in held.beside
        }
        candidates, excluded = _choose_pairs(objects, scene, beside)
        listed = np.array(candidates, dtype=np.int64).reshape(-1, 2)
        return cls(objects, moving, names, listed, excluded, objects.distances(()))


class CollisionModel:
    """Distances of an arm from a scene and from itself. May be shared between threads.

        model = pp.CollisionModel(arm, scene)
        model.minimum(q).distance

    Models are cached per arm: the same arm and scene give the same model. A `PostureWarning` names the meshes
    of the arm that are missing or unusable, once per arm.

    Distances of spheres and capsules, from each other and from boxes, half-spaces and cylinders, are compiled
    closed forms; those from scans and meshes are compiled searches; coal computes all others. They are exact,
    unless the axis of a capsule is inside a cylinder or mesh, or crosses a triangle: then the depth may
    differ from the shortest way out. Bounds decide which pairs are computed.

    A scan or a non-convex mesh is split into pieces. Each body forms a pair with each piece, under one name.
    The distance from a touchable obstacle counts from two margins beneath its surface; see `Scene`.

    Attributes:
        scene: the scene.
        bodies: names of the bodies of the arm, from base to tip, and of the obstacles that it carries.
        pairs: names of all pairs whose distance is computed.
        excluded_pairs: pairs whose distance is not computed, because no motion could separate them or because
            they touch in the straight arm; adjacent bodies are not listed.
    """

    _distances: PairDistances
    _moment: CollisionModel | None  # the model of the last scene with moved obstacles
    _seen: tuple[ArmState, Closest] | None  # the smallest distance at the last state
    _numbers: dict[str, list[int]]  # indices of the solids of each obstacle
    _velocities: Array  # of the middle of the obstacle of each solid, (o, 3) [m/s]
    _turning: Array  # angular velocities, (o, 3) [rad/s]
    _middles: Array  # (o, 3) [m]

    def __new__(cls, arm: Arm, scene: Scene) -> CollisionModel:
        """Return the model of an arm and a scene, created on first use.

        Args:
            arm: the arm.
            scene: the scene.

        Raises:
            InvalidValue: not an arm or not a scene.
        """
        if isinstance(arm, Arm):
            latest: CollisionModel | None = arm.cache.get(cls._in_moment)
            if latest is not None and latest.scene is scene:  # as in nearly every cycle of a control loop
                return latest
        require_instance("arm", arm, Arm, "an Arm")
        require_instance("scene", scene, Scene, "a Scene")
        model = kept(arm, cls, (scene.first, scene.moving), partial(cls._made, arm, scene))
        arm.cache[cls._in_moment] = latest = model._in_moment(scene)
        return latest

    @classmethod
    def _made(cls, arm: Arm, scene: Scene) -> CollisionModel:
        """Return the model of an arm and a scene before anything has moved."""
        model = super().__new__(cls)
        model._prepare(_Choice.known(arm, scene.first), scene.first, scene.moving)
        return model

    @staticmethod
    def prepare(arm: Arm, scene: Scene) -> None:
        """Make what a model of an arm and a scene takes long to make, so that a control loop need not.

        This is the choice of pairs, the trees of scans and meshes, and, for bodies without a closed form, the
        geometries of their pieces, nearest to the base of the arm first, for at most 500,000 points or
        triangles. It warns of nothing, as the obstacles may be moved before the first cycle.
        """
        require_instance("arm", arm, Arm, "an Arm")
        require_instance("scene", scene, Scene, "a Scene")
        choice = _Choice.known(arm, scene.first)
        left = 500_000  # 200,000 take 0.4 s and 110 MB
        base = np.array(arm.base_placement.translation)
        for tree, node in choice.distances.among(choice.candidates).open_pieces(base):
            tree.geometry(node)
            left -= len(tree.corners) // len(tree.pieces)
            if left < 0:
                return

    def __repr__(self) -> str:
        return f"CollisionModel({len(self.bodies)} bodies, {len(self.pairs)} pairs, {self.scene})"

    @property
    def solids(self) -> list[tuple[int, Solid]]:
        """The bodies of the arm: the joint that carries each, and the solid in the frame of that joint."""
        turns = self._kinematics.turns
        return [(int(joint), solid.turned(turns[joint].T)) for joint, solid in self._solids]

    @property
    def index_pairs(self) -> list[IndexPair]:
        """`pairs` by their numbers: those of bodies, and behind them those of the solids of obstacles."""
        first = self._distances.first.tolist()
        return list(zip(first, self._distances.second.tolist(), strict=True))

    def _in_moment(self, scene: Scene) -> CollisionModel:
        """Return the model of the same scene with obstacles moved; the last one is cached."""
        if scene == self.scene:
            return self
        moved = self._moment  # another thread may change it
        if moved is None or moved.scene is not scene:
            if self.scene.maps:
                _ = self._of_maps
            moved = self._copy()
            moved.scene = scene
            standing = scene.standing
            moved._distances = self._elsewhere({name: standing[name] for name in scene.moving & {*standing}})
            moved._take_velocities(scene)
            self._moment = moved
        return moved

    def _copy(self) -> CollisionModel:
        other = object.__new__(CollisionModel)
        other.__dict__.update(self.__dict__)
        other.__dict__.pop("_by_velocity", None)
        other._moment = None  # or each moment would keep all those before it
        other._seen = None
        return other

    def _elsewhere(self, moved: Mapping[str, Obstacle]) -> PairDistances:
        """Return the distances with some obstacles moved."""
        changes = {
            number: solid
            for name, obstacle in moved.items()
            for number, solid in zip(self._numbers[name], obstacle.geometry.solids(), strict=True)
        }
        return self._distances.with_obstacles(changes)

    def _take_velocities(self, scene: Scene) -> None:
        """Take the velocities of all obstacle solids, with a last row of zeros for bodies of the arm."""
        count = 1 + sum(map(len, self._numbers.values()))
        self._velocities = np.zeros((count, 3))
        self._turning = np.zeros((count, 3))
        self._middles = np.zeros((count, 3))
        for name, velocity in scene.velocities.items():
            if name not in self._numbers:  # it moves with the arm
                continue
            solids = self._numbers[name]
            self._velocities[solids], self._turning[solids] = split_velocity(velocity)
            self._middles[solids] = scene.obstacles[name].pose(np.zeros(3)).translation

    def _prepare(self, choice: _Choice, scene: Scene, moving: frozenset[str]) -> None:
        arm = choice.objects.arm
        names = choice.names
        self.scene = scene
        self.bodies = choice.bodies
        self._moment = None
        self._seen = None
        self._model = arm.model
        self._plane = np.array(arm.plane)
        self._space = ConfigurationSpace(arm.model)
        self._solids = list(zip(choice.objects.joints, choice.objects.solids, strict=True))
        self._kinematics = choice.objects.kinematics
        self._arm_length = arm.length
        self._numbers = {name: [] for name in scene.standing}
        for number, name in enumerate(names[len(choice.bodies) :]):
            self._numbers[name].append(number)
        self._take_velocities(scene)
        excluded = {pair: why for pair, why in choice.excluded.items() if names[pair[1]] not in moving}
        left_out = (ExcludedPair(names[a], names[b], why) for (a, b), why in excluded.items())
        self.excluded_pairs = tuple(dict.fromkeys(left_out))
        self._warn_of_excluded_pairs()
        chosen = choice.candidates
        if excluded:
            kept = [pair not in excluded for pair in map(tuple, chosen.tolist())]
            chosen = chosen[np.array(kept, dtype=np.bool_)]
        self._distances = choice.distances.among(chosen)
        first = self._distances.first
        second = self._distances.second
        self.pairs = tuple((names[a], names[b]) for a, b in zip(first, second, strict=True))
        self._named = np.empty(len(self.pairs), dtype=object)  # for access to many at once
        self._named[:] = self.pairs
        joints = choice.objects.joints
        fixed = choice.objects.fixed
        self._carriers = np.array([*joints, *[0] * len(fixed)], dtype=np.int64)

    def _warn_of_excluded_pairs(self) -> None:
        apart = f"nothing keeps them apart (margin {length_text(self.scene.margin)})"
        for reason, so in ((PAIRS.close, apart), (PAIRS.overlapping, "these collisions are ignored")):
            pairs = [
                f"{pair.first} to {pair.second}" for pair in self.excluded_pairs if pair.reason == reason
            ]
            if pairs:
                warn_caller(f"{enumerated(pairs, PAIRS.listed)}: {reason}; {so}")

    def nearest(self, state: ArmState, within: float) -> Distances:
        """Return the pairs nearer than a distance, and the derivatives of their distances.

        Args:
            state: a state of the arm.
            within: the distance [m]; may be infinite.

        Raises:
            InvalidValue: a state of another arm, or not a distance.
        """
        self._require_own(state)
        if not (isinstance(within, (int, float, np.floating)) and within >= 0.0):
            raise InvalidValue("within", within, "a distance of at least 0 [m]")
        placements = self._kinematics.place(state.q)
        near = self._distances.near(placements, float(within))
        normals = self._escape_normals(near, placements)
        first = self._carriers[self._distances.first[near.pairs]]
        second = self._carriers[self._distances.second[near.pairs]]
        jacobian = self._kinematics.differentiate(placements, first, second, near.points, normals)
        best = self._closest(near.minimum, near.nearest)
        obstacles = self._distances.second[near.pairs] - len(self.bodies)
        there = near.points - near.distances[:, None] * near.normals  # on the obstacle
        solids = np.maximum(obstacles, -1)
        moved = self._velocities[solids] + np.cross(self._turning[solids], there - self._middles[solids])
        return Distances(
            distances=near.distances,
            jacobian=jacobian,
            pairs=tuple(self._named[near.pairs].tolist()),
            numbers=near.pairs,
            points=near.points,
            normals=normals,
            rates=-np.einsum("ij,ij->i", normals, moved),
            minimum=best.distance,
            pair=best.pair,
        )

    def _require_own(self, state: ArmState) -> None:
        if not isinstance(state, ArmState) or state.arm.model is not self._model:
            raise InvalidValue("state", state, "a state of the arm of the collision model")

    def contacts_along(self, q0: Array, offsets: Array, within: float) -> Contacts:
        """Return the pairs nearer than a distance at several configurations.

        Solids without a closed form are replaced by simple shapes around them, so distances may be too small.

        Args:
            q0: a configuration, (nq,) [rad or m], as `Arm.checked` returns it.
            offsets: displacements from it, (s, nv) [rad or m].
            within: the distance [m].
        """
        return self._distances.contacts(self._kinematics, q0, offsets, within)

    def count_movers(self, columns: NDArray[np.intp]) -> NDArray[np.int64]:
        """Return how many of the given joints move the bodies of each joint of the model, (njoints,).

        Args:
            columns: the Jacobian columns of the given joints.
        """
        joints = self._kinematics.joints
        movable = np.flatnonzero(np.isin(joints.columns, columns) & (joints.kinds != JOINT.other))
        # Of coupled joints, only the middle one counts: bodies beyond it move about as much as the last one.
        order = movable[np.argsort(joints.columns[movable], kind="stable")]
        begins = np.flatnonzero(np.diff(joints.columns[order], prepend=-1))
        middle = order[(begins + np.append(begins[1:], len(order)) - 1) // 2]
        counts = np.zeros(len(joints.kinds) + 1, dtype=np.int64)
        counts[middle + 1] = 1
        for u, parent in enumerate(joints.parents):
            counts[u + 1] += counts[parent]
        return counts

    def minimum(self, q: ArrayLike) -> Closest:
        """Return the smallest distance of all pairs at a configuration.

        Args:
            q: configuration, (nq,) [rad or m].

        Raises:
            InvalidValue: q has the wrong size or is not finite.
        """
        placements = self._kinematics.place(self._space.checked(q))
        return self._closest(*self._distances.minimum(placements))

    def minimum_at(self, state: ArmState) -> Closest:
        """Return the smallest distance of all pairs at a state; that of the last state is known.

        Args:
            state: a state of the arm.

        Raises:
            InvalidValue: a state of another arm.
        """
        seen = self._seen  # another thread may change it
        if seen is None or seen[0] is not state:
            self._require_own(state)
            seen = state, self._closest(*self._distances.minimum(self._kinematics.place(state.q)))
            self._seen = seen
        return seen[1]

    def minimum_between(self, q0: ArrayLike, dq: ArrayLike) -> Closest:
        """Return the smallest distance on the straight motion along a displacement.

        It is accurate to `MOTION_TOLERANCE`; see `minimum_on_motions`.

        Args:
            q0: start of the motion, (nq,) [rad or m].
            dq: the displacement, (nv,) [rad or m].

        Raises:
            InvalidValue: a vector has the wrong size or is not finite.
        """
        start = self._space.checked(q0, "q0")
        displacement = finite_vector("dq", dq, self._model.nv)
        return self.minimum_on_motions(start, np.stack([np.zeros_like(displacement), displacement]))

    def minimum_along(self, q0: Array, offsets: Array, below: float = np.inf) -> Closest:
        """Return the smallest distance at several configurations, not between them.

        Args:
            q0: a configuration, (nq,) [rad or m], as `Arm.checked` returns it.
            offsets: displacements from it, (s, nv) [rad or m], s > 0.
            below: if no distance is smaller than this [m], any larger one, or none, is returned faster.
        """
        return self._closest(*self._distances.minimum(self._kinematics.place(q0, offsets), below))

    def minimum_on_motions(
        self,
        q0: Array,
        offsets: Array,
        below: float = np.inf,
        enough: float = -np.inf,
        times: Array | None = None,
    ) -> Closest:
        """Return the smallest distance on straight joint motions, also between their ends.

        Motion bounds guide the search (conservative advancement); errors are at most `MOTION_TOLERANCE`.

        Args:
            q0: a configuration, (nq,) [rad or m], as `Arm.checked` returns it.
            offsets: displacements from q0 at the ends of the motions, (N + 1, nv) [rad or m].
            below: as in `minimum_along`.
            enough: the search ends at the first distance below this [m].
            times: time from now at each displacement, (N + 1,) [s]; obstacles move with the velocities of
                their middles, and do not turn. None: they stand still.
        """
        size = self._arm_length
        search = MotionSearch(below, enough, MOTION_TOLERANCE * size, OPEN_MOTION * size)
        if times is None:
            still = np.zeros((len(offsets), 3))
            return self._closest(
                *self._distances.minimum_on_motions(self._kinematics, q0, offsets, still, search)
            )
        lowest = np.inf
        for velocity, distances in self._by_velocity:
            # Moving an obstacle changes its distance as moving the arm in the opposite direction would.
            drifts = -times[:, None] * velocity
            closer = search._replace(below=min(below, lowest))
            closest = distances.minimum_on_motions(self._kinematics, q0, offsets, drifts, closer)[0]
            lowest = min(lowest, closest)
        return Closest(lowest, None)

    def keep_distance(
        self, q0: Array, offsets: Array, least: float, asked: NDArray[np.bool_], contacts: Contacts
    ) -> NDArray[np.bool_]:
        """Return which straight joint motions keep a distance, (N,).

        Args:
            q0: as for `minimum_on_motions`.
            offsets: as for `minimum_on_motions`.
            least: the distance [m].
            asked: which motions to check, (N,); the answer is False for all others.
            contacts: of the ends of the motions, from `contacts_along`, within that distance or more.
        """
        size = self._arm_length
        search = MotionSearch(least, least, MOTION_TOLERANCE * size, OPEN_MOTION * size)
        return self._distances.keep_distance(self._kinematics, q0, offsets, asked, contacts, search)

    def grow_trees(
        self,
        q0: Array,
        units: Array,
        trees: SearchTrees,
        samples: Array,
        settings: TreeSettings,
        refused: bool,
    ) -> tuple[int, int]:
        """Grow two trees of clear motions in turns until they meet.

        Args:
            q0: a configuration, (nq,) [rad or m], as `Arm.checked` returns it.
            units: joint motion that counts as one, (nv,) [rad or m].
            trees: both trees of displacements from q0, updated.
            samples: displacements towards which they grow, (s, nv) [rad or m].
            settings: the settings.
            refused: whether the last edge, which was open, is not clear.

        Returns:
            The outcome, of `kernels.arrays.OUTCOME`, and the number of samples that are used.
        """
        return self._distances.grow_trees(
            self._kinematics, q0, units, trees, samples, settings, refused=refused
        )

    def clear_of_maps(self, q0: Array, offsets: Array, least: float) -> bool:
        """Return whether straight joint motions keep a distance from the maps of the scene.

        Args:
            q0: as for `minimum_on_motions`.
            offsets: as for `minimum_on_motions`.
            least: the distance [m].
        """
        size = self._arm_length
        search = MotionSearch(least, least, MOTION_TOLERANCE * size, OPEN_MOTION * size)
        still = np.zeros((len(offsets), 3))
        distances = self._of_maps.as_in(self._distances)
        return distances.minimum_on_motions(self._kinematics, q0, offsets, still, search)[0] >= least

    @cached_property
    def _of_maps(self) -> PairDistances:
        """The distances from the maps of the first scene, which models of its moments share."""
        solids = np.concatenate([np.arange(0), *(self._numbers[name] for name in self.scene.maps)])
        chosen = np.isin(self._distances.second, len(self.bodies) + solids)
        return self._distances.among(np.column_stack([self._distances.first, self._distances.second])[chosen])

    @cached_property
    def _by_velocity(self) -> list[tuple[Array, PairDistances]]:
        """The distances, grouped by the velocity of the second body or obstacle."""
        first = self._distances.first
        second = self._distances.second
        numbers = np.maximum(second - len(self.bodies), -1)
        velocities, groups = np.unique(self._velocities[numbers], axis=0, return_inverse=True)
        pairs = np.column_stack([first, second])
        groups = groups.ravel()
        return [
            (np.ascontiguousarray(velocity), self._distances.among(pairs[groups == k]))
            for k, velocity in enumerate(velocities)
        ]

    def _closest(self, distance: float, pair: int) -> Closest:
        return Closest(distance, self.pairs[pair] if pair >= 0 else None)

    def _escape_normals(self, near: NearPairs, placements: JointFrames) -> Array:
        """Return the normals, with an escape direction where one is undefined or points out of the plane."""
        normals = near.normals.copy()
        lost = ~normals.any(axis=1)
        if len(self._plane) == 2:
            across = np.linalg.norm(normals @ self._plane.T, axis=1) < 1e-3  # the share in the plane
            lost |= across & (near.distances < self.scene.margin)
        for k in np.flatnonzero(lost):
            point = near.points[k] - near.distances[k] * near.normals[k]
            moving, still = self._distances.axes(int(near.pairs[k]), placements, point)
            normals[k] = escape_direction(moving, still, self._plane)
        return np.asarray(normals)
