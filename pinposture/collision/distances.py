"""Distances between bodies and obstacles: compiled closed forms, and coal for the rest."""

from __future__ import annotations

import math
import threading
from collections.abc import Mapping, Sequence
from copy import copy
from typing import NamedTuple

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pinposture import kernels
from pinposture.arm.configurations import ConfigurationSpace
from pinposture.arm.kinematics import neutral_placements, read_joints
from pinposture.arm.weight import find_frame
from pinposture.collision.solids import Piece, Solid, join_trees
from pinposture.kernels.arrays import (
    BLOCK,
    JOINT,
    SOLID,
    Contacts,
    MotionSearch,
    Pairs,
    SearchTrees,
    TreeSettings,
)

Array = NDArray[np.float64]
Indices = NDArray[np.int64]


class JointFrames(NamedTuple):
    """Placements of the joints of a model at s configurations, world frame.

    The frames are at the joints, and parallel to the world at the neutral configuration.

    Attributes:
        rotations: orientations of the frames, (s, njoints, 3, 3).
        origins: origins of the frames, (s, njoints, 3) [m].
    """

    rotations: Array
    origins: Array


class TreeKinematics:
    """Forward kinematics of all joints of a model, on and off the chain.

    Attributes:
        joints: the joints as the kernels take them.
        turns: orientations of the joint frames of the model at the neutral configuration, (njoints, 3, 3).
    """

    def __init__(self, model: pin.Model) -> None:
        """Extract the joints of a model."""
        self._model = model
        self._space = ConfigurationSpace(model)
        placements = neutral_placements(model)
        self.joints = read_joints(model, placements)
        self.turns = np.array([placement.rotation for placement in placements])
        self._others = (np.flatnonzero(self.joints.kinds == JOINT.other) + 1).tolist()

    def place(self, q: Array, offsets: Array | None = None) -> JointFrames:
        """Compute the joint placements at one or several configurations.

        Args:
            q: a configuration, (nq,), as `ConfigurationSpace.checked` returns it.
            offsets: displacements from q, (s, nv) [rad or m]; None: q itself.
        """
        positions, others = self.positions(q, offsets)
        count = len(positions)
        joints = self._model.njoints
        placements = JointFrames(np.empty((count, joints, 3, 3)), np.empty((count, joints, 3)))
        kernels.place_joints(self.joints, positions, others, placements.rotations, placements.origins)
        return placements

    def frame_pose(self, q: Array, name: str) -> pin.SE3:
        """Return the pose of a link, a control point or a joint at a configuration, (nq,), world frame.

        Raises:
            UnknownName: the model has no such frame.
        """
        frame = find_frame(self._model, name)
        placements = self.place(q)
        joint = int(frame.parentJoint)
        turn = placements.rotations[0, joint] @ self.turns[joint]
        return pin.SE3(turn, placements.origins[0, joint]) * frame.placement

    def positions(self, q: Array, offsets: Array | None) -> tuple[Array, Array]:
        """Return joint positions, (s, nv), and the placements of other joints; see `place`."""
        offsets = np.zeros((1, self._model.nv)) if offsets is None else offsets
        others = np.empty((len(offsets), len(self._others), 12))
        for at in range(len(offsets) if self._others else 0):
            moved = pin.integrate(self._model, q, np.array(offsets[at]))
            for number, joint in enumerate(self._others):
                data = self._model.joints[joint].createData()
                self._model.joints[joint].calc(data, moved)
                turn = self.turns[joint]
                rotation = turn @ data.M.rotation @ turn.T
                others[at, number] = [*rotation.ravel(), *(turn @ data.M.translation)]
        plain = self._space.nq == self._space.nv  # then configurations are positions
        return (q if plain else self._space.difference(self._space.origin, q)) + offsets, others

    def differentiate(
        self, placements: JointFrames, first: Indices, second: Indices, points: Array, normals: Array
    ) -> Array:
        """Return the derivatives of distances with respect to joint displacement, (k, nv) [m/rad or m/m].

        Args:
            placements: joint placements at one configuration.
            first: the joint that carries the first body of each contact, (k,).
            second: the joint that carries the second; 0 for an obstacle, (k,).
            points: the contacts, (k, 3) [m].
            normals: unit vectors from the second body to the first, (k, 3).
        """
        jacobian = np.zeros((len(first), self._model.nv))
        kernels.differentiate_distances(
            self.joints,
            placements.rotations[0],
            placements.origins[0],
            first,
            second,
            points,
            normals,
            jacobian,
        )
        for joint in self._others:
            self._add_others(joint, placements, (first, second), points, normals, jacobian)
        return jacobian

    def _add_others(
        self,
        joint: int,
        placements: JointFrames,
        sides: tuple[Indices, Indices],
        points: Array,
        normals: Array,
        jacobian: Array,
    ) -> None:
        """Fill the columns of a joint that is neither revolute nor prismatic."""
        model = self._model.joints[joint]
        data = model.createData()
        model.calc(data, pin.neutral(self._model))
        turn = placements.rotations[0, joint] @ self.turns[joint]
        origin = placements.origins[0, joint]
        motions = np.array(data.S).reshape(6, -1)
        linear = turn @ motions[:3]
        angular = turn @ motions[3:]
        for k in range(len(points)):
            carried = [joint in self._model.supports[int(side[k])] for side in sides]
            velocity = linear + np.cross(angular.T, points[k] - origin).T
            columns = slice(model.idx_v, model.idx_v + model.nv)
            jacobian[k, columns] = (carried[0] - carried[1]) * (normals[k] @ velocity)


class Poses(NamedTuple):
    """Poses of k solids, world frame.

    Attributes:
        rotations: from the axes of each solid, (k, 3, 3).
        positions: their origins, (k, 3) [m].
    """

    rotations: Array
    positions: Array


class Contact(NamedTuple):
    """Distance, normal and nearest point of two solids.

    Attributes:
        distance: between the surfaces, negative for overlap [m].
        normal: unit vector from the second solid to the first, (3,); zero where coal has none.
        point: point of the first solid nearest to the second, or deepest in it, (3,) [m].
    """

    distance: float
    normal: Array
    point: Array


class Narrow(threading.local):
    """What queries to coal need; each thread has its own.

    Attributes:
        transforms: two placements for reuse, as creating one takes longer than a query.
        requests: the requests, to be made in this order until one succeeds.
        result: the result of the last one.
    """

    def __init__(self) -> None:
        self.transforms = coal.Transform3s(), coal.Transform3s()
        # By default distances are off by up to a micrometre per metre, which shows in derivatives. The search
        # in penetration cannot be more precise: it then fails and returns a distance of 1.8e308.
        self.requests = coal.DistanceRequest(), coal.DistanceRequest()
        self.requests[0].gjk_tolerance = 1e-9
        self.requests[1].epa_tolerance = 1e-4
        self.result = coal.DistanceResult()


_MOVING = ("lines", "centers", "frames", "halves")
"""What tells in `Pairs` where obstacles are."""


class DistanceBuffers(NamedTuple):
    """Initial sizes of buffers, and how finely motions are divided at once."""

    contacts: int = 32
    """Near pairs per configuration; twice as many as were found once that was too few."""

    open_samples: int = 1000
    """Samples of pairs without a closed form."""

    parts: int = 8
    """Largest number of parts into which a motion is divided at once."""


BUFFERS = DistanceBuffers()


class NearPairs(NamedTuple):
    """The pairs nearer than a given distance, nearest first, and the nearest pair of all.

    Attributes:
        pairs: their indices, (k,).
        distances: between the surfaces, negative for overlap, (k,) [m].
        points: point of the first body nearest to the second, or deepest in it, (k, 3) [m], world frame.
        normals: unit vector from the second to the first, (k, 3); zero where undefined.
        minimum: smallest distance of all pairs, near or not [m]; infinite without pairs.
        nearest: index of that pair; -1 without pairs.
    """

    pairs: Indices
    distances: Array
    points: Array
    normals: Array
    minimum: float
    nearest: int


def _divide_samples(samples: Array, room: Array, tolerance: float, spread: float) -> Array:
    """Divide the motions around samples and return samples of the parts.

    The bound of each part is its share of twice the bound of the whole motion: that is half the duration
    times the speed in the middle, plus at least half of the possible increase of the speed.

    Args:
        samples: as returned by `smallest_distance_on_motions`, (k, 6).
        room: excess of each distance over the smallest that matters, (k,) [m].
        tolerance: motion that need not be divided [m].
        spread: 2, or 1 if the bounds have already been doubled.
    """
    moved = spread * samples[:, 4]
    counts = np.clip(np.ceil(moved / np.maximum(room, tolerance)), 2, BUFFERS.parts).astype(np.int64)
    parts = np.repeat(samples, counts, axis=0)
    numbers = np.concatenate([np.arange(0), *(np.arange(k) for k in counts)])
    divided = np.repeat(counts, counts)
    half = parts[:, 2] / divided
    parts[:, 1] += (2.0 * numbers + 1.0 - divided) * half
    parts[:, 2] = half
    parts[:, 4] = np.repeat(moved, counts) / divided
    return parts


class PairDistances:
    """Distances between pairs of bodies, and between bodies and obstacles.

    Attributes:
        first: index of the body of each pair, (n,).
        second: index of the other body, or the number of bodies plus the index of the obstacle, (n,).
    """

    def __init__(
        self,
        bodies: Sequence[Solid],
        joints: Sequence[int],
        fixed: Sequence[Solid],
        pairs: Sequence[tuple[int, int]],
        depths: Sequence[float] | None = None,
    ) -> None:
        """Prepare the solids and sort the pairs into groups.

        Args:
            bodies: the bodies, each in the frame of its joint, as in `JointFrames`.
            joints: the joints that carry them.
            fixed: the obstacles, world frame.
            pairs: indices as in `first` and `second`.
            depths: how far beneath its surface the distance from each obstacle counts, (o,) [m]; None: 0.
        """
        self._narrow = Narrow()
        self._near = BUFFERS.contacts
        self._solids = [*bodies, *fixed]
        self._joints = list(joints)
        self._fixed = [coal.Transform3s(solid.rotation, solid.position) for solid in fixed]
        self._carriers = np.array(joints, dtype=np.int64)
        self._local = np.array([[solid.start, solid.end] for solid in bodies]).reshape(-1, 2, 3)
        self._turns = np.array([solid.rotation for solid in bodies]).reshape(-1, 3, 3)
        self._shifts = np.array([solid.position for solid in bodies]).reshape(-1, 3, 1)
        kinds = np.array([SOLID.segment] * len(bodies) + [solid.kind for solid in fixed], dtype=np.int64)
        exact = [solid.round for solid in bodies] + [solid.exact for solid in fixed]
        self._kinds = kinds
        self._exact = np.array(exact, dtype=np.bool_)
        self._coarse = np.array([False] * len(bodies) + [solid.coarse for solid in fixed], dtype=np.bool_)
        deep = np.zeros(len(fixed)) if depths is None else np.asarray(depths, dtype=np.float64)
        self._depths = np.concatenate([np.zeros(len(bodies)), deep])
        round_radii = [
            solid.radius if solid.kind in (SOLID.segment, SOLID.piece, SOLID.inside) else 0.0
            for solid in fixed
        ]
        nothing = np.zeros(0, dtype=np.int64)
        self._arrays = Pairs(
            first=nothing,
            second=nothing,
            kinds=nothing,
            exact=np.zeros(0, dtype=np.bool_),
            radii=np.array([*(solid.radius for solid in bodies), *round_radii]) - self._depths,
            lines=np.array([[solid.start, solid.end] for solid in fixed]).reshape(-1, 2, 3),
            centers=np.array([solid.center for solid in fixed]).reshape(-1, 3),
            frames=np.array([solid.rotation for solid in fixed]).reshape(-1, 3, 3),
            halves=np.array([solid.half for solid in fixed]).reshape(-1, 3),
            trees=join_trees([solid.shape if isinstance(solid.shape, tuple) else None for solid in fixed]),
            shapes=np.ascontiguousarray(kinds[len(bodies) :]),
            groups=np.zeros((0, 2), dtype=np.int64),
            starts=np.zeros(1, dtype=np.int64),
        )
        self._choose(pairs)

    def among(self, pairs: Sequence[tuple[int, int]] | Indices) -> PairDistances:
        """Return the distances for other pairs of the same bodies and obstacles."""
        other = copy(self)
        other._choose(pairs)
        return other

    def _choose(self, pairs: Sequence[tuple[int, int]] | Indices) -> None:
        """Sort the pairs into groups."""
        count = len(self._joints)
        blocks = (len(self._joints) + BLOCK - 1) // BLOCK
        listed = np.array(pairs, dtype=np.int64).reshape(-1, 2)
        groups = np.where(listed < count, listed // BLOCK, blocks + listed - count)
        order = np.lexsort((groups[:, 1], groups[:, 0]))
        listed = listed[order]
        groups = groups[order]
        begins = np.flatnonzero(np.any(np.diff(groups, axis=0, prepend=-1), axis=1))
        self.first, self.second = (np.ascontiguousarray(side) for side in listed.T)
        kinds = self._kinds[self.second]
        # For a closed surface, the inside test is exact for the whole capsule.
        exact = self._exact[self.first] & self._exact[self.second]
        exact |= (kinds == SOLID.inside) | self._coarse[self.second]
        self._arrays = self._arrays._replace(
            first=self.first,
            second=self.second,
            kinds=kinds,
            exact=np.asarray(exact),
            groups=np.ascontiguousarray(groups[begins]),
            starts=np.append(begins, len(listed)).astype(np.int64),
        )
        self._open = int(np.count_nonzero(~exact))
        self._sides = np.column_stack([self.first, self.second])
        # Coal ignores the radius of the points of a cloud, and depths.
        self._left_out = np.where(
            kinds == SOLID.piece, self._arrays.radii[self.second], -self._depths[self.second]
        )

    def with_obstacles(self, changes: Mapping[int, Solid]) -> PairDistances:
        """Return the distances with some obstacles, by index, replaced by others of the same kind.

        Pieces of a tree may be replaced by those of another one with points of the same radius.
        """
        if not changes:
            return self
        other = copy(self)
        bodies = len(self._joints)
        other._solids = list(self._solids)
        other._fixed = list(self._fixed)
        arrays = self._arrays._replace(**{name: getattr(self._arrays, name).copy() for name in _MOVING})
        for k, solid in changes.items():
            other._solids[bodies + k] = solid
            other._fixed[k] = coal.Transform3s(solid.rotation, solid.position)
        numbers = list(changes)
        solids = changes.values()
        arrays.lines[numbers, 0] = [solid.start for solid in solids]
        arrays.lines[numbers, 1] = [solid.end for solid in solids]
        arrays.centers[numbers] = [solid.center for solid in solids]
        arrays.frames[numbers] = [solid.rotation for solid in solids]
        arrays.halves[numbers] = [solid.half for solid in solids]
        before = self._solids[bodies:]
        if any(
            isinstance(solid.shape, tuple) and solid.shape != before[k].shape for k, solid in changes.items()
        ):
            shapes = [solid.shape for solid in other._solids[bodies:]]
            trees = join_trees([shape if isinstance(shape, tuple) else None for shape in shapes])
            arrays = arrays._replace(trees=trees)
        other._arrays = arrays
        return other

    def as_in(self, moment: PairDistances) -> PairDistances:
        """Return the distances of these pairs where `with_obstacles` has put the obstacles of others."""
        other = copy(self)
        other._solids = moment._solids
        other._fixed = moment._fixed
        there = moment._arrays
        moved = {name: getattr(there, name) for name in _MOVING}
        other._arrays = self._arrays._replace(**moved, trees=there.trees)
        return other

    def open_pieces(self, center: Array) -> list[Piece]:
        """Return the pieces of surfaces without a closed form, those nearest to a point, (3,) [m], first."""
        ranked = []
        for number in np.unique(self.second[~self._arrays.exact]):
            solid = self._solids[number]
            if isinstance(solid.shape, tuple):
                offset = np.abs(solid.rotation.T @ (center - solid.center)) - solid.half
                ranked.append((float(np.linalg.norm(np.maximum(offset, 0.0))), int(number)))
        pieces = [self._solids[number].shape for _, number in sorted(ranked)]
        return [piece for piece in pieces if isinstance(piece, tuple)]

    def near(self, placements: JointFrames, within: float) -> NearPairs:
        """Find the pairs nearer than a distance, and the nearest pair of all.

        Args:
            placements: joint placements at one configuration.
            within: the distance [m].
        """
        n = len(self.first)
        ends = self._ends(placements)
        whole = np.empty((2, n), dtype=np.int64)
        numbers = np.empty((2, n))
        vectors = np.empty((2, n, 3))
        open_pairs = whole[1]
        bounds = numbers[1]
        count, opened, best, pair = kernels.near_pairs(
            ends[0],
            self._arrays,
            within,
            whole[0],
            numbers[0],
            vectors[0],
            vectors[1],
            open_pairs,
            bounds,
        )
        near = whole[0, :count]
        distances = numbers[0, :count]
        normals = vectors[1, :count]
        points = vectors[0, :count] - normals * self._arrays.radii[self.first[near], None]
        contacts: list[tuple[int, Contact]] = []
        poses = self._pose_bodies(placements, 0) if opened else None
        for at in np.argsort(bounds[:opened], kind="stable"):
            k = int(open_pairs[at])
            bound = float(bounds[at])
            if bound >= max(within, best) or poses is None:
                break
            contact = self._contact(k, poses, bound)
            if contact.distance < best:
                best = contact.distance
                pair = k
            if contact.distance < within:
                contacts.append((k, contact))
        if contacts:
            near = np.concatenate([near, [k for k, _ in contacts]])
            distances = np.concatenate([distances, [contact.distance for _, contact in contacts]])
            points = np.concatenate([points, [contact.point for _, contact in contacts]])
            normals = np.concatenate([normals, [contact.normal for _, contact in contacts]])
        order = np.argsort(distances, kind="stable")
        return NearPairs(near[order], distances[order], points[order], normals[order], best, pair)

    def minimum(self, placements: JointFrames, below: float = np.inf) -> tuple[float, int]:
        """Return distance and index of the nearest pair over several configurations.

        Args:
            placements: the joint placements.
            below: only distances below this matter [m]; if there are none, any larger one, or none, is found.

        Returns:
            Infinity and -1 if no pair is found.
        """
        ends = self._ends(placements)
        candidates = len(ends) * self._open
        open_pairs = np.empty((candidates, 2), dtype=np.int64)
        bounds = np.empty(candidates)
        best, pair, opened = kernels.smallest_distance(ends, self._arrays, below, open_pairs, bounds)
        poses: dict[int, Poses] = {}
        for at in np.argsort(bounds[:opened], kind="stable"):
            if bounds[at] >= min(best, below):
                break
            sample = int(open_pairs[at, 0])
            candidate = open_pairs[at, 1:]
            if sample not in poses:
                poses[sample] = self._pose_bodies(placements, sample)
            distance = float(self._measure(candidate, poses[sample], self._sides[candidate])[0])
            if math.isnan(distance):
                distance = float(bounds[at])  # on the safe side
            if distance < best:
                best = distance
                pair = int(candidate[0])
        return best, pair

    def minimum_on_motions(
        self, kinematics: TreeKinematics, q: Array, offsets: Array, drifts: Array, search: MotionSearch
    ) -> tuple[float, int]:
        """Return distance and index of the pair that comes nearest on straight joint motions.

        Args:
            kinematics: kinematics of the model that carries the bodies.
            q: as in `TreeKinematics.place`.
            offsets: displacements from q at the ends of the motions, (N + 1, nv) [rad or m].
            drifts: additional translation of the arm at each, (N + 1, 3) [m].
            search: settings of the search.

        Returns:
            Infinity and -1 if no pair comes nearer than `search.below`.
        """
        positions, others = kinematics.positions(q, offsets)
        room = BUFFERS.open_samples * bool(self._open)
        unknown = np.empty((2, 0))
        while True:
            samples = np.empty((room, 6))
            best, pair, count = kernels.smallest_distance_on_motions(
                kinematics.joints,
                self._carriers,
                self._local,
                self._arrays,
                positions,
                others[0],
                drifts,
                search,
                unknown,
                samples,
            )
            if count <= room:
                break
            room = count
        samples = samples[:count]
        spread = 2.0
        while len(samples) and best >= search.enough:
            distances = self._open_distances(kinematics, q, offsets, drifts, samples)
            at = int(distances.argmin())
            if distances[at] < min(best, search.below):
                best = float(distances[at])
                pair = int(samples[at, 3])
            aim = min(best, search.below) - search.tolerance
            left = (distances - samples[:, 4] < aim) & (samples[:, 4] > search.tolerance)
            samples = _divide_samples(samples[left], distances[left] - aim, search.tolerance, spread)
            spread = 1.0
        return best, pair

    def keep_distance(
        self,
        kinematics: TreeKinematics,
        q: Array,
        offsets: Array,
        asked: NDArray[np.bool_],
        contacts: Contacts,
        search: MotionSearch,
    ) -> NDArray[np.bool_]:
        """Return which of the straight joint motions that are asked for keep `search.below`, (N,).

        Args:
            kinematics: as for `minimum_on_motions`.
            q: as for `minimum_on_motions`.
            offsets: as for `minimum_on_motions`.
            asked: which motions to check, (N,); the answer is False for all others.
            contacts: of the ends of the motions.
            search: settings of the search.
        """
        positions, others = kinematics.positions(q, offsets)
        clear = asked.copy()
        opened = np.empty(len(asked), dtype=np.bool_)
        kernels.check_motions(
            kinematics.joints,
            self._carriers,
            self._local,
            self._arrays,
            positions,
            others[0],
            search,
            contacts,
            clear,
            opened,
        )
        still = np.zeros((2, 3))
        for piece in np.flatnonzero(opened):
            ends = offsets[piece : piece + 2]
            clear[piece] = self.minimum_on_motions(kinematics, q, ends, still, search)[0] >= search.below
        return np.asarray(clear)

    def grow_trees(
        self,
        kinematics: TreeKinematics,
        q: Array,
        units: Array,
        trees: SearchTrees,
        samples: Array,
        settings: TreeSettings,
        *,
        refused: bool,
    ) -> tuple[int, int]:
        """Grow the trees of a search; see `CollisionModel.grow_trees`.

        Args:
            kinematics: kinematics of the model that carries the bodies.
            q: as in `TreeKinematics.place`.
            units: joint motion that counts as one, (nv,) [rad or m].
            trees: both trees.
            samples: displacements from q, (s, nv) [rad or m].
            settings: the settings.
            refused: whether the last edge is not clear.
        """
        positions, others = kinematics.positions(q, None)
        return kernels.grow_trees(
            kinematics.joints,
            self._carriers,
            self._local,
            self._arrays,
            others[0],
            positions[0],
            units,
            trees,
            samples,
            settings,
            refused,
        )

    def _open_distances(
        self, kinematics: TreeKinematics, q: Array, offsets: Array, drifts: Array, samples: Array
    ) -> Array:
        """Compute the distances at samples of `smallest_distance_on_motions` with coal, (k,) [m]."""
        pieces = samples[:, 0].astype(np.int64)
        shares = samples[:, 1, None]
        pairs = samples[:, 3].astype(int)
        placements = kinematics.place(q, (1.0 - shares) * offsets[pieces] + shares * offsets[pieces + 1])
        drifted = (1.0 - shares) * drifts[pieces] + shares * drifts[pieces + 1]
        placements = placements._replace(origins=placements.origins + drifted[:, None])
        numbers = np.arange(len(samples))
        bodies = np.append(self.first[pairs], np.minimum(self.second[pairs], len(self._joints) - 1))
        poses = self._pose_bodies(placements, np.tile(numbers, 2), bodies)
        measured = self._measure(pairs, poses, np.column_stack([numbers, numbers + len(samples)]))
        return np.where(np.isnan(measured), samples[:, 5], measured)  # the bounds are on the safe side

    def contacts(self, kinematics: TreeKinematics, q: Array, offsets: Array, within: float) -> Contacts:
        """Find the pairs nearer than a distance at several configurations; for gradients, not for checks.

        Solids without a closed form are replaced by their bounding capsules, spheres and boxes.

        Args:
            kinematics: kinematics of the model that carries the bodies.
            q: as in `TreeKinematics.place`.
            offsets: as in `TreeKinematics.place`.
            within: the distance [m].
        """
        positions, others = kinematics.positions(q, offsets)
        minima = np.empty(len(positions))
        while True:
            room = self._near * len(positions)
            contacts = Contacts(
                samples=np.empty(room, dtype=np.int64),
                pairs=np.empty(room, dtype=np.int64),
                distances=np.empty(room),
                carrying=np.empty((room, 2), dtype=np.int64),
                points=np.empty((room, 3)),
                normals=np.empty((room, 3)),
                minima=minima,
                within=within,
            )
            count = kernels.contacts_along(
                kinematics.joints,
                self._carriers,
                self._local,
                self._arrays,
                positions,
                others,
                contacts,
            )
            if count <= room:
                return Contacts._make([*(column[:count] for column in contacts[:-2]), minima, within])
            self._near = 2 * count // len(positions) + 1

    def axes(self, pair: int, placements: JointFrames, point: Array) -> tuple[Array, Array]:
        """Return the axis ends of the bounding capsules of both solids of a pair, (2, 3) each [m].

        For a piece of a surface, both ends are `point`, that nearest to the body, (3,).
        """
        ends = np.concatenate([self._ends(placements)[0], self._arrays.lines])
        moving = ends[self.first[pair]]
        still = ends[self.second[pair]]
        return moving, np.stack([point, point]) if self._arrays.kinds[pair] in (
            SOLID.piece,
            SOLID.inside,
        ) else still

    def _ends(self, placements: JointFrames) -> Array:
        """Return the axis ends of all bodies, (s, bodies, 2, 3) [m], world frame."""
        ends = np.empty((len(placements.origins), *self._local.shape))
        kernels.place_axes(self._carriers, self._local, placements.rotations, placements.origins, ends)
        return ends

    def _pose_bodies(
        self, placements: JointFrames, samples: int | Indices, bodies: slice | Indices = slice(None)
    ) -> Poses:
        """Return the poses of bodies, k of them, each at a sample of the placements."""
        joints = self._carriers[bodies]
        turns = placements.rotations[samples, joints]
        shifts = (turns @ self._shifts[bodies])[..., 0] + placements.origins[samples, joints]
        return Poses(turns @ self._turns[bodies], shifts)

    def _measure(self, pairs: Indices, poses: Poses, sides: Indices) -> Array:
        """Return the distances of k pairs from coal, negative for overlap, (k,) [m]; NaN where it fails.

        Args:
            pairs: their indices, (k,).
            poses: poses of bodies.
            sides: which of these are those of both bodies of each pair, (k, 2); ignored for an obstacle.
        """
        narrow = self._narrow
        result = narrow.result
        here, there = narrow.transforms
        bodies = len(self._joints)
        distances = np.full(len(pairs), np.nan)
        for k, pair in enumerate(pairs.tolist()):
            one = self._solids[self.first[pair]].shape
            other = self._solids[self.second[pair]].shape
            if isinstance(other, tuple):  # a piece of an obstacle; bodies are in one piece
                tree, node = other
                other = tree.geometry(node)
            first, second = sides[k]
            here.setRotation(poses.rotations[first])
            here.setTranslation(poses.positions[first])
            pose = there
            if self.second[pair] >= bodies:
                pose = self._fixed[self.second[pair] - bodies]
            else:
                there.setRotation(poses.rotations[second])
                there.setTranslation(poses.positions[second])
            for request in narrow.requests:
                result.clear()
                distance = coal.distance(one, here, other, pose, request, result)
                if abs(distance) < 1e100:  # larger ones are failures of coal
                    distances[k] = distance - self._left_out[pair]
                    break
        return distances

    def _contact(self, pair: int, poses: Poses, bound: float) -> Contact:
        """Return the contact of a pair, given poses of all bodies; at the bound if coal fails."""
        sides = self._sides[pair]
        distance = float(self._measure(np.array([pair]), poses, sides[None])[0])
        if math.isnan(distance):
            return Contact(bound, np.zeros(3), np.array(poses.positions[sides[0]]))
        result = self._narrow.result
        away = -np.array(result.normal)  # coal's normal points from the first to the second
        size = float(np.linalg.norm(away))
        normal = away / size if abs(size - 1.0) < 1e-3 else np.zeros(3)
        return Contact(distance, normal, np.array(result.getNearestPoint1()))
