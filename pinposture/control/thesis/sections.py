"""Control sets as chains of short sections: the tree of Section 4.6.1 and its best branch."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import pairwise
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from pinposture import kernels
from pinposture.arm import Arm, ArmState
from pinposture.arm.kinematics import Chain
from pinposture.errors import InvalidValue
from pinposture.kernels.arrays import Screws

# If modules have one joint, neighbouring control points always conflict (Appendix A). Points two or three
# joints apart conflict only if the section between them is singular, so a control set is a chain of such
# sections. All chains over a region of the arm form a tree (Figure 4.7): nodes are control points, edges are
# sections. Algorithm 2 removes the points at the ends of unstable edges.
#
# The remaining points have a posture control matrix of full row rank. For neighbours r < s among them, the
# matrix is block lower triangular with the Jacobian of s relative to r on its diagonal. The edge (v, s] of
# the branch has v >= r and a positive index, so the Jacobian of s relative to v has full row rank; that
# relative to r has additional columns, so its smallest singular value is no smaller. The first point meets
# the absolute condition, and so must every other: a later point may fail it although an earlier one does not.

Array = NDArray[np.float64]
SectionScore = Literal["thesis", "geometric"]


class SectionSet(NamedTuple):
    """A branch pruned by Algorithm 2.

    Attributes:
        points: remaining control points, 0-based and increasing.
        edges: number of remaining edges (eta).
        score: natural logarithm of the score, because a product of many indices underflows; minus infinity
            without points.
    """

    points: tuple[int, ...] = ()
    edges: int = 0
    score: float = -np.inf


class SectionEdges(NamedTuple):
    """Sections as edges of the tree, by their number of modules and by the node at which they end.

    Attributes:
        section_sizes: numbers of modules that a section may have, (S,); increasing.
        stable: edges that Algorithm 2 keeps, (S, m + 1).
        logs: logarithms of their indices, (S, m + 1).
        usable: which control points may be active, (m,).
    """

    section_sizes: NDArray[np.int64]
    stable: NDArray[np.bool_]
    logs: Array
    usable: NDArray[np.bool_]

    @classmethod
    def of(
        cls, indices: Array, usable: NDArray[np.bool_], threshold: float, section_sizes: tuple[int, ...]
    ) -> SectionEdges:
        """Return the edges; those that are unstable or end at points that are not usable are not kept.

        Args:
            indices: index of each section, (S, m + 1); zero where there is none.
            usable: which control points may be active, (m,).
            threshold: an edge is unstable unless its index exceeds this.
            section_sizes: numbers of modules that a section may have; increasing.
        """
        stable = (indices > threshold) & np.append(False, usable)
        return cls(
            np.array(section_sizes, dtype=np.int64), stable, np.log(np.where(stable, indices, 1.0)), usable
        )


@dataclass(frozen=True, eq=False)
class SectionTree:
    """The tree of sections over a region of the arm, which is never built.

    Nodes are numbered as in the matrix of indices: 0 is the base, k + 1 is control point k.

    Attributes:
        indices: manipulability index of each section, (m + 1, m + 1), from `section_indices`.
        usable: which control points have a target and meet the absolute condition, (m,).
        threshold: an edge is unstable unless its index exceeds this.
        first: first control point of the region, 0-based.
        last: last control point of the region, 0-based.
        section_sizes: numbers of modules that a section may have.
    """

    indices: Array
    usable: NDArray[np.bool_]
    threshold: float
    first: int
    last: int
    section_sizes: tuple[int, ...] = (2, 3)

    def __post_init__(self) -> None:
        m = len(self.usable)
        if self.indices.shape != (m + 1, m + 1):
            raise InvalidValue("indices (shape)", self.indices.shape, f"({m + 1}, {m + 1})")
        if not 0 <= self.first <= self.last < m:
            raise InvalidValue("region", (self.first, self.last), f"0 <= first <= last <= {m - 1}")
        if not self.threshold >= 0.0:
            raise InvalidValue("threshold", self.threshold, "a number >= 0")
        object.__setattr__(self, "section_sizes", checked_section_sizes(self.section_sizes))

    @property
    def root(self) -> int:
        """First node of every branch: the first control point of the region; the base if that is point 0."""
        return _root(self.first)

    @property
    def leaf(self) -> int:
        """Last node of the region."""
        return self.last + 1

    def branches(self) -> Iterator[tuple[int, ...]]:
        """Enumerate all branches, depth first.

        Yields:
            Nodes from the root to where no further section fits into the region. The number of branches grows
            exponentially with the region.
        """
        begun: list[tuple[int, ...]] = [(self.root,)]
        while begun:
            branch = begun.pop()
            ends = [branch[-1] + size for size in self.section_sizes if branch[-1] + size <= self.leaf]
            if not ends:
                yield branch
            begun.extend((*branch, end) for end in reversed(ends))

    def pruned(self, branch: Sequence[int], score: SectionScore) -> SectionSet:
        """Remove the nodes at the ends of unstable edges and those that are not usable (Algorithm 2).

        Args:
            branch: nodes, as from `branches`.
            score: "thesis" for (4.8), (eta + 1) times the product of the remaining indices; or "geometric",
                with the geometric mean instead of the product.
        """
        kept = [edge for edge in pairwise(branch) if self._stable[edge]]
        points = tuple(end - 1 for _, end in kept)
        if self._root_counts:
            points = (self.root - 1, *points)
        if not points:
            return SectionSet()
        logs = np.array([[self._logs[edge] for edge in kept]]).sum(axis=1)
        return SectionSet(points, len(kept), float(_scores(np.array([len(kept)]), logs, score)[0]))

    def best(self, score: SectionScore) -> SectionSet:
        """Return the set with the largest score over all branches; see `best_branch`."""
        indices = np.zeros((len(self.section_sizes), len(self.indices)))
        for row, size in zip(indices, self.section_sizes, strict=True):
            row[size:] = np.diagonal(self.indices, size)
        edges = SectionEdges.of(indices, self.usable, self.threshold, self.section_sizes)
        return best_branch(edges, self.first, self.last, score)

    @cached_property
    def _stable(self) -> NDArray[np.bool_]:
        """Edges that are kept, (m + 1, m + 1)."""
        return np.asarray((self.indices > self.threshold) & np.append(False, self.usable))

    @cached_property
    def _logs(self) -> Array:
        """Logarithms of the indices of the edges that are kept, (m + 1, m + 1)."""
        return np.log(np.where(self._stable, self.indices, 1.0))

    @property
    def _root_counts(self) -> bool:
        return self.root > 0 and bool(self.usable[self.root - 1])


def best_branch(edges: SectionEdges, first: int, last: int, score: SectionScore) -> SectionSet:
    """Return the set with the largest score over all branches over a region, without enumerating them.

    The score depends on the number of remaining edges and the product of their indices. Among partial
    branches to a node with equally many edges, only the one with the largest product can be part of the best
    branch: O(m^2) of them for m points.

    Args:
        edges: the sections.
        first: first control point of the region, 0-based.
        last: last control point of the region, 0-based.
        score: see `SectionTree.pruned`.

    Returns:
        The best set; empty if Algorithm 2 removes all points from every branch.
    """
    root = _root(first)
    leaf = last + 1
    path = np.empty(last + 2, dtype=np.int64)
    root_counts = root > 0 and bool(edges.usable[root - 1])
    bonus = np.log(np.arange((leaf - root) // int(edges.section_sizes[0]) + 2) + 1.0)
    if not root_counts:
        bonus[0] = -np.inf
    mean = score == "geometric"
    left, found = kernels.best_branch(
        root, leaf, edges.section_sizes, edges.stable, edges.logs, bonus, mean, path
    )
    if found == -np.inf:
        return SectionSet()
    points = [root - 1] * root_counts + (path[:left][::-1] - 1).tolist()
    return SectionSet(tuple(points), left, found)


def best_chain(
    arm: Arm, screws: Screws, eligible: NDArray[np.bool_], section_sizes: tuple[int, ...]
) -> NDArray[np.bool_]:
    """Choose the ends of the chain of sections with the best geometric mean of indices, without pruning.

    Args:
        arm: the arm.
        screws: the screws of its joints.
        eligible: which control points have a target, (m,).
        section_sizes: numbers of modules that a section may have; increasing.

    Returns:
        Which control points are ends of sections, (m,); the last eligible one if no section fits.
    """
    chosen = np.zeros(len(eligible), dtype=np.bool_)
    region = np.flatnonzero(eligible)
    if not len(region):
        return chosen
    least = 1e-6  # index of sections that are singular, which are allowed
    edges = section_edges(arm, screws, eligible, least, section_sizes)
    fits = np.arange(len(eligible) + 1) >= np.array(section_sizes)[:, None]
    logs = np.where(edges.stable, edges.logs, np.log(least))
    edges = edges._replace(stable=fits & np.append(False, eligible), logs=logs)
    points = best_branch(edges, int(region[0]), int(region[-1]), "geometric").points
    chosen[list(points) or region[-1:]] = True
    return chosen


def _root(first: int) -> int:
    return 0 if first == 0 else first + 1


def checked_section_sizes(section_sizes: Sequence[int]) -> tuple[int, ...]:
    """Return the sizes sorted; raise InvalidValue unless they are one or more whole numbers of at least 1."""
    allowed = "one or more whole numbers of at least 1"
    try:
        listed = tuple(section_sizes)
    except TypeError:
        raise InvalidValue("section_sizes", section_sizes, allowed) from None
    whole = all(isinstance(size, int | np.integer) and not isinstance(size, bool) for size in listed)
    if not listed or not whole or min(listed) < 1:
        raise InvalidValue("section_sizes", section_sizes, allowed)
    return tuple(sorted({int(size) for size in listed}))


def _scores(edges: NDArray[np.intp], logs: Array, score: SectionScore) -> Array:
    """Return the logarithm of the score for numbers of edges and logarithms of the products of indices."""
    mean = logs / np.maximum(edges, 1) if score == "geometric" else logs
    return np.asarray(np.log(edges + 1.0) + mean)


# Indices of sections, relative to the best that links of those lengths can have.
#
# The index of (4.4) is 1 only if the end moves equally well in every direction. Two links of equal length
# have at best (sqrt(5) - 1) / 2. A score that multiplies indices, such as (4.8), would penalise every such
# section even in its best posture; indices relative to the best avoid this.


def best_index(lengths: tuple[float, ...]) -> float:
    """Return the largest manipulability index of a planar chain of revolute joints over all postures.

    Args:
        lengths: distances from each joint to the next and from the last one to the end, (n,) [m].

    Returns:
        An index in [0, 1]: exact for two links, to about 1e-9 for three, the upper bound 1 for more; 0 for
        fewer, or if all but one have no length.
    """
    if len(lengths) < 2 or max(lengths) <= 0.0:
        return 0.0
    shares = tuple(float(length) / max(lengths) for length in lengths)
    if len(shares) == 2:
        # The elbow at cos q = -2 l1 l2 / (l1^2 + 2 l2^2) has the largest determinant for its trace.
        first, second = shares
        ratio = first * second / np.hypot(first**2, 2.0 * second**2)
        return float(2.0 * ratio / (1.0 + np.sqrt(max(1.0 - 4.0 * ratio**2, 0.0))))
    return _best_of_three(shares) if len(shares) == 3 else 1.0


@lru_cache(maxsize=1024)
def _best_of_three(lengths: tuple[float, float, float]) -> float:
    """Return the best index of three links: a grid over the two inner joints, then a search from its peaks.

    Peaks with index 1 are sharp and can be low on the grid, so several are tried. Mirrored postures have the
    same index, so half of the grid suffices.
    """
    angles = np.linspace(-np.pi, np.pi, 180, endpoint=False)
    index = _planar_index(lengths, angles[:, None], angles)
    around = [np.roll(index, (i, j), (0, 1)) for i in (-1, 0, 1) for j in (-1, 0, 1)]
    peaks = np.argwhere((index >= np.max(around, axis=0)) & (angles[:, None] >= 0.0))
    highest = peaks[np.argsort(-index[tuple(peaks.T)], kind="stable")][:6]
    found = [
        minimize(
            lambda inner: -float(_planar_index(lengths, *inner)),
            angles[peak],
            method="Nelder-Mead",
            options={"xatol": 1e-9, "fatol": 1e-12},
        )
        for peak in highest
    ]
    return -float(min(result.fun for result in found))


def _planar_index(lengths: tuple[float, float, float], middle: Array, last: Array) -> Array:
    """Return the index of three links at given inner joint positions.

    With z_u the vector from joint u to the end as a complex number, the eigenvalues of J J^T have the sum
    sum |z_u|^2 and the difference |sum z_u^2|.
    """
    third = lengths[2] + 0j
    second = third + lengths[1] * np.exp(-1j * last)
    first = second + lengths[0] * np.exp(-1j * (last + middle))
    trace = np.abs(first) ** 2 + np.abs(second) ** 2 + abs(third) ** 2
    spread = np.abs(first**2 + second**2 + third**2)
    return np.asarray(np.sqrt(np.maximum(trace - spread, 0.0) / np.maximum(trace + spread, 1e-300)))


def section_indices(state: ArmState, section_sizes: tuple[int, ...]) -> Array:
    """Return the manipulability indices of sections, relative to the best that each can have.

    The best is known for planar sections of two or three revolute joints. Indices of longer sections, of
    sections with a prismatic joint and of spatial arms are not normalised.

    Args:
        state: the state of the arm.
        section_sizes: numbers of modules that a section may have.

    Returns:
        Array (m + 1, m + 1) like that of `ArmState.manipulability`, in [0, 1], with the entries for these
        numbers of modules normalised.
    """
    indices = np.array(state.manipulability())
    for size, best in zip(section_sizes, _best_indices(state.arm.chain, section_sizes), strict=True):
        starts = np.arange(len(indices) - size)
        indices[starts, starts + size] /= best[size:]
    return np.minimum(indices, 1.0)


def section_edges(
    arm: Arm, screws: Screws, usable: NDArray[np.bool_], threshold: float, section_sizes: tuple[int, ...]
) -> SectionEdges:
    """Return the edges of the tree of sections, with indices as in `section_indices`.

    Args:
        arm: the arm.
        screws: the screws of its joints.
        usable: which control points may be active, (m,).
        threshold: an edge is unstable unless its index exceeds this.
        section_sizes: numbers of modules that a section may have; increasing.
    """
    indices = np.zeros((len(section_sizes), arm.n_modules + 1))
    sizes = np.array(section_sizes, dtype=np.int64)
    kernels.section_indices_by_size(screws, arm.kinematics.task_constants.plane, sizes, indices)
    return SectionEdges.of(
        np.minimum(indices / _best_indices(arm.chain, section_sizes), 1.0), usable, threshold, section_sizes
    )


@lru_cache(maxsize=64)
def _best_indices(chain: Chain, section_sizes: tuple[int, ...]) -> Array:
    """Return the best index of the section of each number of modules that ends at each node, (S, m + 1)."""
    m = len(chain.points)
    best = np.ones((len(section_sizes), m + 1))
    if len(chain.plane) == 2:
        for row, size in zip(best, section_sizes, strict=True):
            for start in range(m + 1 - size):
                lengths = _section_lengths(chain, start, start + size)
                if 2 <= len(lengths) <= 3:
                    found = best_index(lengths)
                    # below, the section counts as always singular
                    row[start + size] = found if found > 1e-3 else 1.0
    return best


def _section_lengths(chain: Chain, start: int, end: int) -> tuple[float, ...]:
    """Return the link lengths of a section of revolute joints; () if it has a prismatic joint.

    They are rounded to twelve digits, so that sections of equal links share cached results.
    """
    joints = slice(chain.module_slices[start].start, chain.module_slices[end - 1].stop)
    if not np.all(chain.revolute[joints]):
        return ()
    stations = np.vstack([chain.origins[joints], chain.points[end - 1]]) @ chain.plane.T
    return tuple(float(f"{length:.12g}") for length in np.linalg.norm(np.diff(stations, axis=0), axis=1))
