"""Search for clear paths that relaxation does not find: withdrawal along the arm, and a tree search.

An arm that reaches through a hole can withdraw: its points move backwards along the curve of the arm, while
the part near the base takes up the slack. The arm is then compact in front of the hole. The same is done for
the goal posture. Between two compact postures a bidirectional tree search (RRT-Connect, Kuffner and LaValle
2000) finds a path quickly. Shortcuts and relaxation then make it direct.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from math import inf
from time import perf_counter
from typing import Literal, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from pinposture import kernels
from pinposture.arm import ChainState
from pinposture.arm.arm import smooth_positions
from pinposture.collision.model import MOTION_TOLERANCE, OPEN_MOTION
from pinposture.control.planner.avoidance import Avoidance
from pinposture.control.planner.damped_least_squares import PlanningProblem, minimize
from pinposture.control.planner.objective import Objective
from pinposture.control.planner.path import JointPath
from pinposture.kernels.arrays import OUTCOME, STATE, SearchTrees, TreeSettings
from pinposture.placement import Target

Array = NDArray[np.float64]


class WithdrawalSettings(NamedTuple):
    """How an arm is drawn back out of an opening along itself."""

    step: float = 0.04
    """Length of a withdrawal step, in arm lengths. With half of it, or 1.5 times as much, a first path takes
    longer (`docs/design/path_search.md`; `make study STUDY=clutter` guards it)."""

    near_share: float = 0.3
    """Length of the part of the arm that takes up the slack, in arm lengths. With twice as much, 2 of
    20 problems of clutter had no solution."""

    most_error: float = 0.002
    """Mean distance from the curve at which a withdrawal step is accepted, in arm lengths."""

    fit_steps: int = 12
    """Largest number of iterations of the fit of a withdrawal step, which begins where the last one
    ended."""

    failures: int = 3
    """Number of consecutive failed steps that ends a withdrawal."""

    join_every: float = 0.3
    """Depth of withdrawal between attempts to join the ends, in arm lengths; as `step`."""


WITHDRAWING = WithdrawalSettings()


class TreeSearchSettings(NamedTuple):
    """How trees grow from both ends of a path until they meet."""

    join_nodes: int = 150
    """Largest number of tree nodes of an attempt to join the ends of a withdrawal."""

    nodes: int = 2000
    """Largest number of tree nodes of the last attempt."""

    early_turns: int = 32
    """Number of turns before the most direct path is computed. Most ways that are found within 150 are found
    within these; among posts they take 4 ms, and 150 take 13 ms (`make study STUDY=clutter`)."""

    sampled: int = 16
    """Number of samples that are drawn at once."""

    trapped_share: float = 0.125
    """Share of its turns in which a tree grows, below which its root counts as trapped, which ends an
    attempt to join with `join_nodes`. With a like rule for the last attempt, one of ten pipes had no
    solution."""

    patient_turns: int = 16
    """Number of turns of both trees before a root counts as trapped."""

    step: float = 0.3
    """Largest joint motion of an edge of the trees, in `Arm.joint_units`."""

    uniform_share: float = 0.5
    """Share of the samples that is uniform within limits."""

    most_amplitude: float = 1.5
    """Largest amplitude of the smooth random configurations among the other samples."""

    noise: float = 0.3
    """Noise of the others about the line between both ends."""

    most_turn: float = np.pi
    """Largest motion of a joint from the start in a sample, in `Arm.joint_units`."""

    few_joints: int = 40
    """Number of joints up to which the joint motions above apply; with more, they decrease in
    proportion, so that the whole arm bends equally far."""


TREES = TreeSearchSettings()


class ShorteningSettings(NamedTuple):
    """How a path that was searched is made shorter and round."""

    piece: float = 0.1
    """Largest joint motion of a piece of a path when it is shortened, in `Arm.joint_units`."""

    shortcuts: int = 60
    """Number of attempted shortcuts of a path that is relaxed afterwards."""

    rejoined_shortcuts: int = 20
    """The same of a rejoined path, after waypoints are left out. With 10 and 0, such paths are 1.06 and 1.12
    times as long (`make study STUDY=repair`); 60 without leaving out waypoints take longer."""

    even_piece: float = 0.04
    """Joint motion of a piece of a rejoined or straight path, in `Arm.joint_units`."""

    even_pieces: tuple[int, int] = (64, 384)
    """Least and largest number of these pieces."""

    roundings: int = 12
    """How often each waypoint of a rejoined path is moved towards the middle of its neighbours."""

    rounding_halvings: int = 4
    """How often that is halved where the curve is not clear."""

    rounded_around: int = 4
    """For how many waypoints on each side it is halved. `make study STUDY=repair` tells whether the
    curve is clear, and how long the paths are."""

    rejoining_nodes: int = 600
    """Largest number of tree nodes of the last attempt to rejoin a path. Of ten paths into machines that a
    ball cut (`make study STUDY=repair`), seven are repaired with 600 and with 2,000, five with 150; with 600
    the others fail in a third of the time."""

    rejoined_from: tuple[float, ...] = (0.0, 0.05)
    """How far before and behind what is in the way of a path a tree search joins it again, in shares of
    the path. Of 24 paths that a ball cut, the search joined eight with the first, four more with the
    second, and none more with 0.15 and 0.4; the others needed a withdrawal
    (`benchmarks.studies.repair`)."""


SHORTENING = ShorteningSettings()


class FoundPath(NamedTuple):
    """A clear path.

    Attributes:
        offsets: displacement of each waypoint from the start, (N + 1, nv) [rad or m].
        found_by: how it was found.
    """

    offsets: Array
    found_by: Literal["relaxation", "tree search", "withdrawal"]


class PathSearch:
    """Deterministic search for a clear path between two configurations.

    Args:
        problem: what is planned, with obstacles to avoid.
        goal: end of the path.
        least: the distance to keep along the path [m].
        seed: seed of the random numbers.
        until: time of `perf_counter` at which the search ends.
    """

    def __init__(
        self,
        problem: PlanningProblem,
        goal: ChainState,
        least: float,
        seed: int = 0,
        until: float = inf,
    ) -> None:
        self.problem = problem
        self.arm = problem.objective.arm
        self.least = least
        self.until = until
        objective, self._start, position_limits, avoidance = problem
        self.avoidance = cast(Avoidance, avoidance)
        self.goal = goal
        self._end = np.asarray(self.arm.difference(self._start.q, goal.q))
        self._rng = np.random.default_rng(seed)
        size = self.arm.length
        self._settings = TreeSettings(
            TREES.step, least, MOTION_TOLERANCE * size, OPEN_MOTION * size, self.avoidance.constrained
        )
        self._trapped = np.zeros(2, dtype=np.bool_)
        self._between_ends = _Growth(np.zeros(self.arm.nv), self._end, TREES.join_nodes)
        self._share = min(1.0, TREES.few_joints / len(objective.chain.columns))
        self._units = self._share * self.arm.joint_units
        self._positions = self.arm.positions(self._start.q)
        lowest, highest = position_limits - self._positions
        farthest = TREES.most_turn * self._units * self.arm.moved
        self._sides = (
            np.maximum(np.minimum(lowest, 0.0), -farthest),
            np.minimum(np.maximum(highest, 0.0), farthest),
        )

    def straight(self) -> FoundPath | None:
        """Return the straight motion of the joints, in even pieces; None if it is not clear."""
        if not self.is_clear(np.array([np.zeros(self.arm.nv), self._end])):
            return None
        pieces = _even_pieces(float(np.abs(self._end / self._units).max()))
        return FoundPath(np.linspace(0.0, 1.0, pieces + 1)[:, None] * self._end, "relaxation")

    def connect(
        self, tell: Callable[[str], None] = lambda _: None, most: int = TREES.join_nodes
    ) -> FoundPath | None:
        """Return a path that a short tree search between the ends finds, as found; None if there is none.

        Args:
            tell: called with what is done.
            most: number of turns after which the search pauses, at least; the next call goes on.
        """
        growth = self._between_ends
        if growth.over:
            return None
        tell("tree search")
        joined = self._grow(growth, most)
        return None if joined is None else FoundPath(joined, "tree search")

    def path(self, found_path: FoundPath) -> JointPath:
        """Return a path that was found, for the objective of the problem."""
        path = JointPath(self.problem.objective, self._start.q, found_path.offsets)
        return replace(path, found_by=found_path.found_by)

    def is_clear(self, path: Array) -> bool:
        """Whether straight motions between offsets, (N + 1, nv), are clear, given that the first one is."""
        return self.avoidance.keeps(self._start.q, path, self.least)

    @property
    def is_trapped(self) -> bool:
        """Whether the last tree search has found an end trapped."""
        return bool(self._trapped.any())

    def rejoin(self, path: Array) -> FoundPath | None:
        """Return a path of which the part that is not clear is replaced and shortened; None if that fails.

        A tree search joins the clear ends of that part; where these are so close to what is in the way that
        it fails, others a little farther away; then the ends of the path, if need be withdrawn.

        Args:
            path: offsets from the start to the goal, (N + 1, nv), not all clear.
        """
        path, _ = divide(path, self._units)
        last = len(path) - 1
        begin = self._clear_pieces(path)
        end = last - self._clear_pieces(path[::-1])
        parts = [
            (max(begin - int(share * last), 0), min(end + int(share * last), last))
            for share in SHORTENING.rejoined_from
        ]
        for first, second in dict.fromkeys(parts):
            if (first, second) == (0, last):  # as below
                break
            joined = self._connect(path[first], path[second], TREES.join_nodes)
            if joined is not None:
                part = self._shortened(self._pruned(joined), SHORTENING.rejoined_shortcuts)
                whole = np.concatenate([path[:first], part, path[second + 1 :]])
                return FoundPath(self._smoothed(whole), "tree search")
        raw = self.connect() or self.withdraw(most=SHORTENING.rejoining_nodes)
        if raw is None:
            return None
        short = self._shortened(self._pruned(raw.offsets), SHORTENING.rejoined_shortcuts)
        return FoundPath(self._smoothed(short), raw.found_by)

    def _smoothed(self, path: Array) -> Array:
        """Return a path of even pieces, (M + 1, nv), whose corners are rounded as far as the curve is clear.

        The arm follows the curve through the waypoints, which swings out at the corners of a path as found:
        by up to 17 mm of an arm of 1 m. The shorter the pieces, the less it does.
        """
        lengths = np.abs(np.diff(path, axis=0) / self._units).max(axis=1)
        s = np.append(0.0, np.cumsum(lengths))
        count = _even_pieces(s[-1])
        for finer in (1, 2, 4):
            even_s = np.linspace(0.0, s[-1], finer * count + 1)
            even = np.column_stack([np.interp(even_s, s, joint) for joint in path.T])
            rounded = self._rounded(even)
            if rounded is not None:
                return rounded
        return path

    def _rounded(self, even: Array) -> Array | None:
        """Return a path of even pieces with rounded corners; None if it or the curve is not clear."""
        smooth = even.copy()
        for _ in range(SHORTENING.roundings):
            smooth[1:-1] = 0.25 * smooth[:-2] + 0.5 * smooth[1:-1] + 0.25 * smooth[2:]
        s = np.arange(0.0, len(even) - 0.5, 0.5)
        share = np.ones((len(even), 1))
        for _ in range(SHORTENING.rounding_halvings):
            path = even + share * (smooth - even)
            curve = JointPath(self.problem.objective, self._start.q, path)
            close = self._close_pieces(curve.smooth_offset(s))
            if not close:
                return path if self.is_clear(path) else None
            for piece in close:
                waypoint = piece // 2
                share[
                    max(waypoint - SHORTENING.rounded_around, 0) : waypoint + SHORTENING.rounded_around + 2
                ] *= 0.5
        return None

    def _close_pieces(self, path: Array, begin: int = 0) -> list[int]:
        """Return the numbers of the straight motions between offsets, (N + 1, nv), that are not clear."""
        size = len(path) - 1
        if self.is_clear(path):
            return []
        if size == 1:
            return [begin]
        half = size // 2
        return self._close_pieces(path[: half + 1], begin) + self._close_pieces(path[half:], begin + half)

    def _clear_pieces(self, path: Array) -> int:
        """Return how many straight motions between offsets, (N + 1, nv), are clear before one is not."""
        begin = 0
        size = len(path) - 1
        while size > 1:  # the first that is not clear is among so many
            half = size // 2
            if self.is_clear(path[begin : begin + half + 1]):
                begin = begin + half
                size = size - half
            else:
                size = half
        return begin

    # Withdrawal.

    def withdraw(
        self, tell: Callable[[str], None] = lambda _: None, most: int = TREES.nodes
    ) -> FoundPath | None:
        """Return a path between ends that are withdrawn until they can be joined; None if that fails.

        Args:
            tell: called with what is done.
            most: largest number of nodes of the attempt to join ends that can withdraw no further.
        """
        ends = [_Withdrawal(self, np.zeros(self.arm.nv)), _Withdrawal(self, self._end)]
        nodes = TREES.join_nodes
        while perf_counter() < self.until:
            trapped = [end for end, is_trapped in zip(ends, self._trapped, strict=True) if is_trapped]
            moved = any([end.go_on(WITHDRAWING.join_every) for end in trapped])
            if not moved and not any([end.go_on(WITHDRAWING.join_every) for end in ends]):
                if nodes == most:
                    break
                nodes = most  # neither end can withdraw further: search longer
            depths = " and ".join(f"{100.0 * end.depth:.0f} %" for end in ends)
            tell(f"tree search after withdrawing start and goal by {depths} of the arm length")
            joined = self._connect(ends[0].offsets[-1], ends[1].offsets[-1], nodes)
            if joined is not None:
                whole = np.concatenate([ends[0].offsets, joined[1:-1], ends[1].offsets[::-1]])
                return FoundPath(whole, "withdrawal")
        return None

    # Tree search.

    def _connect(self, one: Array, other: Array, nodes: int) -> Array | None:
        """Return offsets from one to the other, (N + 1, nv), by RRT-Connect; None if none were found."""
        return self._grow(_Growth(one, other, nodes), nodes)

    def _grow(self, growth: _Growth, most: int) -> Array | None:
        """Let trees take turns, about so many in all; return offsets between the roots if they meet."""
        trees = growth.trees
        model = self.avoidance.clearance
        refused = False
        while perf_counter() < self.until:
            outcome, used = model.grow_trees(
                self._start.q, self._units, trees, growth.samples, self._settings, refused
            )
            growth.turns += used
            growth.samples = growth.samples[used:]
            if outcome == OUTCOME.ended:
                self._trapped = trees.counts - 1 < TREES.trapped_share * 0.5 * growth.turns
                patient = growth.nodes > TREES.join_nodes or growth.turns < TREES.patient_turns
                growth.over = (self.is_trapped and not patient) or bool(len(growth.samples))
                if growth.over or growth.turns >= min(most, growth.nodes):
                    return None
                count = min(TREES.sampled, growth.nodes - growth.turns)
                growth.samples = self._samples(growth.one, growth.other, count)
            refused = outcome == OUTCOME.open and not self.is_clear(_last_edge(trees))
            if outcome == OUTCOME.joined:
                return _joined(trees)
        return None

    def _samples(self, one: Array, other: Array, count: int) -> Array:
        """Return random offsets, (count, nv): uniform, of smooth postures, or near the line between two."""
        arm = self.arm
        rng = self._rng
        kinds = rng.random(count)
        samples = rng.uniform(*self._sides, size=(count, arm.nv))
        is_smooth = (kinds >= TREES.uniform_share) & (kinds < 0.5 * (1.0 + TREES.uniform_share))
        smooth = int(is_smooth.sum())
        most_joints = max(len(joints) for joints in arm.module_joints)
        sizes = rng.normal(size=(smooth, most_joints, 3))
        phases = rng.uniform(0.0, 2.0 * np.pi, sizes.shape)
        amplitudes = self._share * rng.uniform(0.1, TREES.most_amplitude, smooth)
        samples[is_smooth] = smooth_positions(arm, sizes, phases, amplitudes) - self._positions
        is_near = kinds >= 0.5 * (1.0 + TREES.uniform_share)
        near = int(is_near.sum())
        places_between = rng.uniform(-0.2, 1.2, (near, 1))
        noise = self._share * TREES.noise * rng.normal(size=(near, arm.nv)) * arm.joint_units * arm.moved
        samples[is_near] = one + places_between * (other - one) + noise
        return np.asarray(np.clip(samples, *self._sides))

    # Shortcuts.

    def shorten(self, raw: FoundPath) -> FoundPath:
        """Straighten parts of a path where that is clear and shorter, for all or some consecutive joints."""
        return FoundPath(self._shortened(raw.offsets, SHORTENING.shortcuts), raw.found_by)

    def _shortened(self, raw: Array, shortcuts: int) -> Array:
        """Return a path, (M + 1, nv), after a number of attempted shortcuts."""
        path, _ = divide(raw, self._units)
        lengths = self._measure(path)
        columns = self.problem.objective.chain.columns
        for number in range(shortcuts):
            i, j = np.sort(self._rng.choice(len(path), 2, replace=False))
            if j - i < 2:
                continue
            before = path[i : j + 1]
            shares = np.linspace(0.0, 1.0, len(before))[:, None]
            straight = before[0] + shares * (before[-1] - before[0])
            if number % 2:  # some joints only
                first, last = np.sort(self._rng.choice(len(columns) + 1, 2, replace=False))
                some = columns[first:last]
                whole = straight
                straight = before.copy()
                straight[:, some] = whole[:, some]
            shorter = self._measure(straight).sum() < 0.999 * lengths[i:j].sum()
            if shorter and self.is_clear(straight):
                divided, _ = divide(straight, self._units)
                path = np.concatenate([path[:i], divided, path[j + 1 :]])
                lengths = np.concatenate([lengths[:i], self._measure(divided), lengths[j:]])
        return path

    def _pruned(self, path: Array) -> Array:
        """Return a path without the waypoints that straight motions can leave out, (M + 1, nv).

        From each waypoint, motions to the last one, to the one halfway there, and so on are tried.
        """
        # Measured in small pieces, as motions are: chords of long pieces fall short.
        divided, ends = divide(path, self._units)
        distances = np.append(0.0, np.cumsum(self._measure(divided)))
        travelled = distances[ends]
        last = len(path) - 1
        kept = [0]
        while kept[-1] < last:
            here = kept[-1]
            there = last
            while there > here + 1:
                motion = path[[here, there]]
                length = self._measure(divide(motion, self._units)[0]).sum()
                if length < travelled[there] - travelled[here] and self.is_clear(motion):
                    break
                there = (here + there) // 2
            kept.append(there)
        return path[kept]

    def _measure(self, path: Array) -> Array:
        """Return the lengths of the pieces of a path, (N,) [m]."""
        return self.problem.objective.measure_pieces(self._positions, path)


def divide(path: Array, units: Array) -> tuple[Array, NDArray[np.int64]]:
    """Divide the pieces of a path (N + 1, nv) that are longer than `SHORTENING.piece` in units (nv,).

    Returns:
        The path, (M + 1, nv), and the index of each former waypoint on it, (N + 1,).
    """
    return kernels.divide_path(path, SHORTENING.piece * units)


class _Growth:
    """Trees of two roots, offsets (nv,), that grow in turns.

    Attributes:
        one: the first root.
        other: the second root.
        nodes: the largest number of nodes in all, and of turns.
        trees: the trees.
        samples: offsets towards which they grow next, (s, nv); at first from the first root to the second.
        turns: number of turns so far.
        over: whether no more turns are worth while.
    """

    def __init__(self, one: Array, other: Array, nodes: int) -> None:
        self.one = one
        self.other = other
        self.nodes = nodes
        self.trees = SearchTrees(
            nodes=np.empty((2, nodes + 2, len(one))),
            parents=np.full((2, nodes + 2), -1, dtype=np.int64),
            counts=np.ones(2, dtype=np.int64),
            state=np.array([0, -1, -1, 0], dtype=np.int64),
        )
        self.trees.nodes[:, 0] = one, other
        self.samples = other[None]
        self.turns = 0
        self.over = False


def _last_edge(trees: SearchTrees) -> Array:
    """Return the offsets at the ends of the last edge, (2, nv)."""
    tree = trees.state[STATE.last]
    node = trees.counts[tree] - 1
    return np.asarray(trees.nodes[tree, [trees.parents[tree, node], node]])


def _joined(trees: SearchTrees) -> Array:
    """Return the offsets from the first root to the second, (N + 1, nv), of trees that have met."""
    turn = trees.state[STATE.turn]
    first, second = trees.state[[STATE.at, STATE.met] if turn == 0 else [STATE.met, STATE.at]]
    return np.concatenate([_branch(trees, 0, first)[::-1], _branch(trees, 1, second)[1:]])


def _branch(trees: SearchTrees, tree: int, node: int) -> Array:
    """Return the offsets from a node to the root."""
    path = []
    while node >= 0:
        path.append(trees.nodes[tree, node])
        node = int(trees.parents[tree, node])
    return np.array(path)


class _Withdrawal:
    """The withdrawal of an arm from a posture along its own curve.

    Attributes:
        offsets: the configurations so far, as displacements from the start of the search, (nv,) each.
    """

    def __init__(self, search: PathSearch, offset: Array) -> None:
        self._search = search
        self.offsets = [offset]
        self._state = search.problem.start.moved(offset)
        self._curve = np.vstack([search.arm.chain.base, self._state.placements.points])
        lengths = np.linalg.norm(np.diff(self._curve, axis=0), axis=1)
        self._lengths = np.concatenate([[0.0], np.cumsum(lengths)])
        self._near = WITHDRAWING.near_share * self._lengths[-1]
        self._depth = 0.0
        self._over = False

    @property
    def depth(self) -> float:
        """Distance withdrawn so far, in arm lengths."""
        return float(self._depth / self._lengths[-1])

    def go_on(self, distance: float) -> bool:
        """Withdraw by up to a distance in arm lengths; return whether the arm moved."""
        failures = 0
        begun = len(self.offsets)
        goal = self._depth + distance * self._lengths[-1]
        step = WITHDRAWING.step * self._lengths[-1]
        while not self._over and self._depth < goal:
            if self._withdraw_to(self._depth + step):
                self._depth = self._depth + step
                failures = 0
                step = WITHDRAWING.step * self._lengths[-1]
            else:
                failures = failures + 1
                step = 0.5 * step
                self._over = failures >= WITHDRAWING.failures
        return len(self.offsets) > begun

    def _withdraw_to(self, depth: float) -> bool:
        """Move the distal part along the curve to a depth, if that is clear; return whether it was.

        The fit disregards obstacles. Another one among them, where that is not clear, would take 0.3 s with
        400 joints, and has not led to a path.
        """
        search = self._search
        arm = search.arm
        s = self._lengths[1:] - depth
        weights = (s >= self._near).astype(np.float64)
        if not weights.any():
            self._over = True
            return False
        points = np.column_stack([np.interp(s, self._lengths, axis) for axis in self._curve.T])
        objective = Objective(arm, Target(points, weights), constraints=search.problem.objective.constraints)
        good = WITHDRAWING.most_error * arm.length
        problem = search.problem._replace(objective=objective, avoidance=None)
        fit = minimize(problem, self._state, good, steps=WITHDRAWING.fit_steps)
        if fit.mean_error > good:
            return False
        offset = self.offsets[-1] + arm.difference(self._state.q, fit.state.q)
        if not search.is_clear(np.array([self.offsets[-1], offset])):
            return False
        self.offsets.append(offset)
        self._state = fit.state
        return True


def _even_pieces(length: float) -> int:
    """Return the number of even pieces of a path of a length, in `Arm.joint_units`."""
    return int(np.clip(np.ceil(length / SHORTENING.even_piece), *SHORTENING.even_pieces))
