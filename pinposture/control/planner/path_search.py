"""Search for clear paths that relaxation does not find: withdrawal along the arm, and a tree search.

An arm that reaches through a hole can withdraw: its points move backwards along the curve of the arm, while
the part near the base takes up the slack. The arm is then compact in front of the hole. The same is done for
the goal posture. Between two compact postures a bidirectional tree search (RRT-Connect, Kuffner and LaValle
2000) finds a path quickly. Shortcuts and relaxation then make it direct.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from math import inf
from time import perf_counter
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pinposture.arm import ChainState, smooth_configuration
from pinposture.control.planner.damped_least_squares import PlanningProblem, minimize
from pinposture.control.planner.objective import Objective
from pinposture.placement import Target

Array = NDArray[np.float64]

WITHDRAWAL_STEP = 0.01
NEAR_SHARE = 0.3
"""Length of a withdrawal step, and of the part of the arm that takes up the slack, in arm lengths. Half
or twice the step hardly matters; with twice the part, 2 of 20 problems of clutter had no solution."""

WITHDRAWAL_ERROR = 0.002
"""Mean distance from the curve at which a withdrawal step is accepted, in arm lengths."""

MAX_FAILURES = 3
"""Number of consecutive failed steps that ends a withdrawal."""

JOIN_EVERY = 0.2
"""Depth of withdrawal between attempts to join the ends, in arm lengths."""

JOIN_NODES = 150
SEARCH_NODES = 2000
"""Largest number of tree nodes of an attempt to join the ends, and of the last one."""

TREE_STEP = 0.3
PIECE_TURN = 0.1
"""Largest joint motion of an edge of the trees, and of a piece of the path when it is shortened, in
`Arm.joint_units`."""

UNIFORM_SHARE = 0.5
MAX_AMPLITUDE = 1.5
NOISE = 0.3
"""Samples of the tree search: the share that is uniform within limits; for the others, the largest amplitude
of smooth random configurations, and the noise about the line between both ends."""

MAX_TURN = np.pi
"""Largest motion of a joint from the start in a sample, in `Arm.joint_units`."""

FEW_JOINTS = 40
"""Number of joints up to which the joint motions above apply; with more, they decrease in proportion, so that
the whole arm bends equally far."""

SHORTCUTS = 60
"""Number of attempted shortcuts."""


class FoundPath(NamedTuple):
    """A clear path.

    Attributes:
        offsets: displacement of each waypoint from the start, (N + 1, nv) [rad or m].
        found_by: "withdrawal" or "tree search".
    """

    offsets: Array
    found_by: str


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
        objective, self._start, edges, self._avoidance = problem
        self._goal = goal
        self._rng = np.random.default_rng(seed)
        self._share = min(1.0, FEW_JOINTS / len(objective.columns))
        self._units = self._share * self.arm.joint_units
        self._positions = self.arm.positions(self._start.q)
        lowest, highest = edges - self._positions
        farthest = MAX_TURN * self._units * self.arm.moved
        self._sides = (
            np.maximum(np.minimum(lowest, 0.0), -farthest),
            np.minimum(np.maximum(highest, 0.0), farthest),
        )

    def find(self, tell: Callable[[str], None] = lambda _: None) -> FoundPath | None:
        """Return a clear path, shortened; None if none was found. `tell` is called with each attempt."""
        tell("tree search")
        end = np.asarray(self.arm.difference(self._start.q, self._goal.q))
        joined = self._connect(np.zeros(self.arm.nv), end, JOIN_NODES)
        found_by = "tree search"
        if joined is None:
            joined = self._join_withdrawn(end, tell)
            found_by = "withdrawal"
        return None if joined is None else FoundPath(self._shorten(joined), found_by)

    def is_clear(self, path: Array) -> bool:
        """Whether straight motions between offsets, (N + 1, nv), are clear, given that the first one is."""
        return self._avoidance is None or self._avoidance.keeps(self._start.q, path, self.least)

    # Withdrawal.

    def _join_withdrawn(self, end: Array, tell: Callable[[str], None]) -> Array | None:
        """Withdraw both ends until they can be joined; return the path, None if that fails."""
        ends = [_Withdrawal(self, np.zeros(self.arm.nv)), _Withdrawal(self, end)]
        nodes = JOIN_NODES
        while perf_counter() < self.until:
            if not any([each.go_on(JOIN_EVERY) for each in ends]):
                if nodes == SEARCH_NODES:
                    break
                nodes = SEARCH_NODES  # neither end can withdraw further: search longer
            depths = " and ".join(f"{100.0 * each.depth:.0f} %" for each in ends)
            tell(f"tree search after withdrawing start and goal by {depths} of the arm length")
            joined = self._connect(ends[0].offsets[-1], ends[1].offsets[-1], nodes)
            if joined is not None:
                return np.concatenate([ends[0].offsets, joined[1:-1], ends[1].offsets[::-1]])
        return None

    # Tree search.

    def _connect(self, one: Array, other: Array, nodes: int) -> Array | None:
        """Return offsets from one to the other, (N + 1, nv), by RRT-Connect; None if none were found."""
        trees = _Tree(one), _Tree(other)
        for turn in range(nodes):
            if perf_counter() >= self.until:
                break
            from_, to = trees if turn % 2 == 0 else trees[::-1]
            wanted = other if turn == 0 else self._sample(one, other)
            at = self._extend(from_, wanted, self._units)
            if at is None:
                continue
            there = from_.offsets[at]
            reached = None
            while True:  # as far as possible
                reached = self._extend(to, there, self._units)
                if reached is None or np.array_equal(to.offsets[reached], there):
                    break
            if reached is not None:
                parts = [from_.branch(at), to.branch(reached)]
                first, second = parts if turn % 2 == 0 else parts[::-1]
                return np.concatenate([first, second[::-1][1:]])
            if trees[0].count + trees[1].count > nodes:
                break
        return None

    def _extend(self, tree: _Tree, wanted: Array, units: Array) -> int | None:
        """Add a node one step towards an offset; return its index, or None if the step is not clear."""
        near = tree.nearest(wanted, units)
        change = wanted - tree.offsets[near]
        size = float(np.abs(change / units).max())
        if size == 0.0:
            return near
        reached = wanted if size <= TREE_STEP else tree.offsets[near] + change * (TREE_STEP / size)
        return tree.add(reached, near) if self.is_clear(np.array([tree.offsets[near], reached])) else None

    def _sample(self, one: Array, other: Array) -> Array:
        """Return a random offset: uniform, of a smooth posture, or near the line between two offsets."""
        arm = self.arm
        rng = self._rng
        kind = rng.random()
        if kind < UNIFORM_SHARE:
            return np.asarray(rng.uniform(*self._sides))
        if kind < 0.5 * (1.0 + UNIFORM_SHARE):
            q = smooth_configuration(arm, rng, self._share * float(rng.uniform(0.1, MAX_AMPLITUDE)))
            offset = np.asarray(arm.difference(self._start.q, q))
        else:
            offset = one + rng.uniform(-0.2, 1.2) * (other - one)
            offset = offset + self._share * NOISE * rng.normal(size=arm.nv) * arm.joint_units * arm.moved
        return np.asarray(np.clip(offset, *self._sides))

    # Shortcuts.

    def _shorten(self, offsets: Array) -> Array:
        """Straighten parts of a path where that is clear and shorter, for all or some consecutive joints."""
        path = divide(offsets, self._units)
        columns = self.problem.objective.columns
        for number in range(SHORTCUTS):
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
            if self._length(straight) < 0.999 * self._length(before) and self.is_clear(straight):
                path = np.concatenate([path[:i], divide(straight, self._units), path[j + 1 :]])
        return path

    def _length(self, path: Array) -> float:
        return float(self.problem.objective.measure_pieces(self._positions, path).sum())


def divide(path: Array, units: Array) -> Array:
    """Return a path, (N + 1, nv), with pieces longer than `PIECE_TURN` in units of motion (nv,) divided."""
    parts = [path[:1]]
    for start, end in pairwise(path):
        size = float(np.abs((end - start) / units).max())
        count = max(int(np.ceil(size / PIECE_TURN)), 1)
        parts.append(start + (np.arange(1, count + 1)[:, None] / count) * (end - start))
    return np.concatenate(parts)


class _Tree:
    """Nodes of a tree of offsets, and their parents.

    Attributes:
        offsets: the nodes, the first `count` rows, (capacity, nv).
        count: number of nodes.
    """

    def __init__(self, root: Array) -> None:
        self.offsets = np.array([root] * 64)
        self._parents = [-1]
        self.count = 1

    def nearest(self, offset: Array, units: Array) -> int:
        apart = (self.offsets[: self.count] - offset) / units
        return int(np.einsum("ij,ij->i", apart, apart).argmin())

    def add(self, offset: Array, parent: int) -> int:
        if self.count == len(self.offsets):
            self.offsets = np.concatenate([self.offsets, np.empty_like(self.offsets)])
        self.offsets[self.count] = offset
        self._parents.append(parent)
        self.count += 1
        return self.count - 1

    def branch(self, node: int) -> Array:
        """Return the offsets from the root to a node."""
        path = []
        while node >= 0:
            path.append(self.offsets[node])
            node = self._parents[node]
        return np.array(path[::-1])


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
        self._places = np.concatenate([[0.0], np.cumsum(lengths)])
        self._near = NEAR_SHARE * self._places[-1]
        self._depth = 0.0
        self._over = False

    @property
    def depth(self) -> float:
        """Distance withdrawn so far, in arm lengths."""
        return float(self._depth / self._places[-1])

    def go_on(self, distance: float) -> bool:
        """Withdraw by up to a distance in arm lengths; return whether the arm moved."""
        failures = 0
        begun = len(self.offsets)
        goal = self._depth + distance * self._places[-1]
        step = WITHDRAWAL_STEP * self._places[-1]
        while not self._over and self._depth < goal:
            if self._withdraw_to(self._depth + step):
                self._depth = self._depth + step
                failures = 0
                step = WITHDRAWAL_STEP * self._places[-1]
            else:
                failures = failures + 1
                step = 0.5 * step
                self._over = failures >= MAX_FAILURES
        return len(self.offsets) > begun

    def _withdraw_to(self, depth: float) -> bool:
        """Move the distal part along the curve to a depth, if that is clear; return whether it was."""
        search = self._search
        arm = self._search.arm
        places = self._places[1:] - depth
        weights = (places >= self._near).astype(np.float64)
        if not weights.any():
            self._over = True
            return False
        points = np.column_stack([np.interp(places, self._places, axis) for axis in self._curve.T])
        problem = search.problem
        objective = Objective(
            arm, Target.from_points(arm, points, weights), constraints=problem.objective.constraints
        )
        avoidance = problem.avoidance
        if avoidance is not None:
            avoidance = avoidance.for_objective(objective)
        good = WITHDRAWAL_ERROR * arm.length
        found = minimize(problem._replace(objective=objective, avoidance=avoidance), self._state, good)
        if found.mean_error > good:
            return False
        change = np.asarray(arm.difference(self._state.q, found.state.q))
        offset = self.offsets[-1] + change
        if not search.is_clear(np.array([self.offsets[-1], offset])):
            return False
        self.offsets.append(offset)
        self._state = found.state
        return True
