"""Fit of the control points to given points, exactly or as closely as possible."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pinposture import kernels
from pinposture.arm import Arm
from pinposture.arm.kinematics import Kinematics
from pinposture.curve import Curve
from pinposture.errors import PostureError
from pinposture.kernels.arrays import ModuleSearch
from pinposture.placement.least_squares import fit_curve
from pinposture.placement.module_kinematics import after_last_mover
from pinposture.placement.target import Target
from pinposture.units import ROUNDING

Array = NDArray[np.float64]
Whole = NDArray[np.int64]


class PointSearchSettings(NamedTuple):
    """Settings of `place_sequentially`; figures are of `docs/design/branch_search.md`."""

    visits_per_module: int = 20
    """Largest number of visits of modules, per module."""

    visits: int = 200
    """Largest number of visits of modules of short arms. Of 40 random postures, 100 and 400 find as many and
    three more, in 0.9 and 1.4 of the time."""

    window: int = 6
    """Number of modules corrected together if a point cannot be reached by its own joints. Of 90 random
    postures of arms of ten modules of three and four joints, 3 finds 86 and 6 all, in a third of the time
    with four joints. Points that cannot be reached take up to a fifth longer."""

    joint_samples: int = 16
    """Number of samples of a joint without a closed form; twice as many for two or more such joints. Of the
    same postures, 8 find one more in 0.6 of the time, 32 two more in 1.6 of it."""

    rough: float = 1e-3
    """Distance that a rough search accepts, in mean module lengths."""


POINT_SEARCH = PointSearchSettings()


def place_sequentially(
    arm: Arm, points: Array, has_target: NDArray[np.bool_], near: Array
) -> tuple[Array, bool]:
    """Find joint positions that put the control points at given points, module by module.

    The end point of a module leaves a few solutions for its joints. A wrong choice becomes apparent at a
    later module, whose point is then out of reach: the search backtracks and tries another solution, those
    nearest to `near` first. If points cannot be reached exactly, a small distance is accepted.

    Args:
        arm: the arm.
        points: a position for every control point, (m, 3) [m], world frame.
        has_target: True for points to reach, (m,).
        near: preferred joint positions, (nv,) [rad or m].

    Returns:
        Joint positions (nv,) [rad or m] within the limits, and whether they reach the points. If not, they
        reach as many points as possible from the base on, and the others as closely as each module can.
    """
    chain, goals = _module_search(arm, points, has_target, near)
    bounded = np.isfinite(chain.lower) & np.isfinite(chain.upper)
    low, high = (np.where(bounded, side, chain.near) for side in (chain.lower, chain.upper))
    center = 0.5 * low + 0.5 * high
    visits = max(POINT_SEARCH.visits_per_module * len(goals), POINT_SEARCH.visits)
    positions = near.copy()
    exact = ROUNDING * arm.length
    rough = POINT_SEARCH.rough * arm.length / len(goals)
    samples = _joint_samples(len(center))
    # Positions far from the limits leave more freedom for later modules.
    for start, accepted, first in (
        (chain.near, exact, 0),
        (center, exact, POINT_SEARCH.joint_samples),
        (chain.near, rough, 0),
    ):
        shuffled = np.roll(samples, first, axis=0)
        solution = start.copy()
        nearby = chain._replace(near=start)
        reached = kernels.search_branches(
            nearby, goals, arm.length, accepted, POINT_SEARCH.window, visits, shuffled, solution
        )
        positions[arm.columns] = solution
        if reached == len(goals):
            return positions, True
    return positions, False


def with_configuration(arm: Arm, target: Target, near: Array | None = None) -> Target:
    """Add a configuration that reaches the target exactly, if `taken_exactly` finds one.

    It stays near the configuration `near`, (nq,), or the straight arm if None.
    """
    if target.q is not None or not np.all(target.has_target):
        return target
    exact = taken_exactly(arm, target.points, arm.positions(arm.straight() if near is None else near))
    return target if exact is None else replace(target, q=arm.configuration(exact))


def taken_exactly(arm: Arm, points: Array, near: Array) -> Array | None:
    """Find joint positions that reach all points without backtracking; takes microseconds.

    Args:
        arm: the arm.
        points: a position for every control point, (m, 3) [m], world frame.
        near: preferred joint positions, (nv,) [rad or m].

    Returns:
        Joint positions (nv,) [rad or m] within the limits; None if none are found, as for measured points, or
        if a module has more than two joints.
    """
    every = np.ones(arm.n_modules, dtype=np.bool_)
    if not points_determine_joints(arm, every):
        return None
    chain, goals = _module_search(arm, points, every, near)
    m = len(goals)
    solution = chain.near.copy()
    samples = _joint_samples(len(chain.near))
    exact = ROUNDING * arm.length
    if kernels.search_branches(chain, goals, arm.length, exact, 1, 2 * m, samples, solution) < m:
        return None
    positions = np.array(near)
    positions[arm.columns] = solution
    return positions


def points_determine_joints(arm: Arm, has_target: NDArray[np.bool_]) -> bool:
    """Whether the points with a target, (m,), leave the joints between them only a few solutions.

    At most two joints then move each point relative to the one before.
    """
    modules = _search_modules(arm.kinematics, tuple(np.flatnonzero(has_target).tolist()))
    return bool(np.diff(modules.begins).max() <= 2)


def _module_search(
    arm: Arm, points: Array, has_target: NDArray[np.bool_], near: Array
) -> tuple[ModuleSearch, Array]:
    """Return the modules as kernels take them, and the points to reach, (p, 3) [m]."""
    chain = arm.chain
    columns = arm.columns
    lower = arm.limits.lower[columns]
    upper = arm.limits.upper[columns]
    indices = np.flatnonzero(has_target)
    modules = _search_modules(arm.kinematics, tuple(indices.tolist()))
    goals = points[indices]
    carried = chain.points[indices]
    if arm.dimension == 2:  # errors normal to the plane cannot be reduced
        goals = carried + (goals - carried) @ arm.plane.T @ arm.plane
    preferred = np.clip(near[columns], lower, upper)
    search = modules._replace(lower=lower, upper=upper, near=preferred)
    return search, np.ascontiguousarray(goals)


@lru_cache(maxsize=64)
def _search_modules(kinematics: Kinematics, indices: tuple[int, ...]) -> ModuleSearch:
    """Divide a chain into modules, each of which ends at the next of some control points; without limits.

    A joint belongs to the first point it can move: joints whose axes pass through a point belong to the next,
    unless they are coupled.
    """
    chain = kinematics.chain
    arrays = kinematics.constants
    starts = [0]
    for k in indices:
        starts.append(after_last_mover(chain, k, starts[-1]))
    levers = arrays.levers[list(indices)]
    for number, (k, stop) in enumerate(zip(indices, starts[1:], strict=True)):
        levers[number] += arrays.joints.offsets[stop : arrays.ends[k]].sum(axis=0)
    n = len(arrays.inputs)
    return ModuleSearch(
        joints=arrays.joints._replace(columns=chain.input_numbers.astype(np.int64)),
        levers=levers,
        starts=np.array(starts, dtype=np.int64),
        begins=np.searchsorted(chain.leaders, starts).astype(np.int64),
        sliding=~chain.revolute[chain.leaders],
        lower=np.full(n, -np.inf),
        upper=np.full(n, np.inf),
        near=np.zeros(n),
    )


@lru_cache(maxsize=64)
def _joint_samples(n: int) -> Array:
    """Return fractions of the range of each joint, (2 S, n): two even grids, shuffled for each joint."""
    rng = np.random.default_rng(0)
    count = POINT_SEARCH.joint_samples
    sets = [(np.arange(count) + middle) / count for middle in (0.25, 0.75)]
    columns = [np.concatenate([rng.permutation(shares) for shares in sets]) for _ in range(n)]
    return np.ascontiguousarray(np.column_stack(columns))


def initial_guesses(arm: Arm, target: Target, near: Array) -> Iterator[Array]:
    """Yield joint positions from which to search for the configuration closest to a target.

    Args:
        arm: the arm.
        target: positions of its control points; must fit the arm.
        near: preferred joint positions, (nv,) [rad or m].

    Yields:
        Joint positions (nv,) [rad or m] within the limits, best first; only one if it reaches all points.
    """
    positions, complete = place_sequentially(arm, target.points, target.has_target, near)
    yield positions
    left = target.distances(arm.kinematics.forward(positions).points)[target.has_target]
    if complete and left.max() <= ROUNDING * arm.length:
        return
    try:
        curve = Curve.points(np.vstack([arm.chain.base, target.points[target.has_target]]))
        bending = 1e-8 * arm.length  # for joints that move no control point
        yield fit_curve(arm, curve, 0.0, bending, rough=True)[0]
    except PostureError:  # the points form no curve, for instance because two coincide
        return
