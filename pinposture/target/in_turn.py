"""The configuration that takes given control points exactly, module by module, where there is one."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from pinposture import kernels
from pinposture.arm import Arm
from pinposture.arm.chain import Chain
from pinposture.kernels.arrays import Screwed

Array = NDArray[np.float64]
Whole = NDArray[np.int64]

MOST_TRIED, LEAST_TRIED = 20, 200
"""How many modules are looked at, per module on average and at least, before the search is given up."""

WINDOW = 3
"""How many modules are corrected together where a point cannot be taken by its own joints."""

SAMPLES = 16
"""How many places are tried for joints that a closed form does not find; twice as many for more than one."""

ROUGH, EXACT = 1e-3, 1e-9
"""How far from its point the end of a module may stay while the search goes on, in mean module lengths, and
the distance that is none, in arm lengths."""

ON_AXIS = 1e-9
"""How far from the axis of a joint a point may be that it does not move, relative to the arm length."""


def taken_in_turn(arm: Arm, points: Array, placed: NDArray[np.bool_], near: Array) -> tuple[Array, bool]:
    """Find joint positions that put the control points where they should be.

    The point at the end of a module leaves a few solutions for its joints. A wrong one shows at a later
    module, whose point it puts out of reach: the search then goes back and takes another, those first that
    are nearest. Where points cannot be taken exactly, a little is given up.

    Args:
        arm: the arm.
        points: a position for every control point, (m, 3) [m], world frame.
        placed: which of them count, (m,).
        near: joint positions to prefer, (nv,) [rad or m].

    Returns:
        Joint positions (nv,) [rad or m] within the limits, and whether they take the points, but for a
        little. If not, they take as many as was possible from the base on, and the rest as nearly as each
        module can.
    """
    chain, wanted = _problem(arm, points, placed, near)
    bounded = np.isfinite(chain.lower) & np.isfinite(chain.upper)
    low, high = (np.where(bounded, side, chain.near) for side in (chain.lower, chain.upper))
    centre = 0.5 * low + 0.5 * high
    tries, positions = max(MOST_TRIED * len(wanted), LEAST_TRIED), near.copy()
    exact, rough = EXACT * arm.length, ROUGH * arm.length / len(wanted)
    one, samples = chain.near, _samples(len(centre))
    # What is far from the limits leaves more freedom to the modules that follow.
    for start, good, first in ((one, exact, 0), (centre, exact, SAMPLES), (one, rough, 0)):
        given = np.roll(samples, first, axis=0)
        taken = _search(arm, chain._replace(near=start), wanted, good, WINDOW, tries, given, positions)
        if taken == len(wanted):
            return positions, True
    return positions, False


def taken_exactly(arm: Arm, points: Array, near: Array) -> Array | None:
    """What `taken_in_turn` finds for all points where nothing has to be chosen, in microseconds.

    Args:
        arm: the arm.
        points: a position for every control point, (m, 3) [m], world frame.
        near: joint positions to prefer, (nv,) [rad or m].

    Returns:
        Joint positions (nv,) [rad or m] within the limits; None if there are none, as for points that were
        measured, or if a module has more joints than two.
    """
    chain, wanted = _problem(arm, points, np.ones(arm.n_modules, dtype=np.bool_), near)
    if np.diff(chain.begins).max() > 2:
        return None
    positions = near.copy()
    m, samples = len(wanted), _samples(len(chain.near))
    return (
        positions
        if _search(arm, chain, wanted, EXACT * arm.length, 1, 2 * m, samples, positions) == m
        else None
    )


def _problem(arm: Arm, points: Array, placed: NDArray[np.bool_], near: Array) -> tuple[Screwed, Array]:
    """What kernels want to know: the chain, and the points that count, (p, 3) [m]."""
    chain, columns = arm.chain, arm.columns
    lower, upper = arm.limits.lower[columns], arm.limits.upper[columns]
    own, begins = _own_joints(chain, tuple(np.flatnonzero(placed).tolist()))
    wanted, carried = points[own], chain.points[own]
    if arm.dimension == 2:  # what lies across the plane cannot be had
        wanted = carried + (wanted - carried) @ arm.plane.T @ arm.plane
    preferred = np.clip(near[columns], lower, upper)
    given = ~chain.revolute, chain.axes, chain.origins, carried, begins
    return Screwed(*given, lower, upper, preferred), np.ascontiguousarray(wanted)


def _search(
    arm: Arm,
    chain: Screwed,
    wanted: Array,
    good: float,
    window: int,
    tries: int,
    samples: Array,
    positions: Array,
) -> int:
    """Put the outcome of the search into positions (nv,); how many points it takes."""
    found = chain.near.copy()
    taken = kernels.take_points(chain, wanted, arm.length, good, window, tries, samples, found)
    positions[arm.columns] = found
    return taken


@lru_cache(maxsize=64)
def _own_joints(chain: Chain, placed: tuple[int, ...]) -> tuple[Whole, Whole]:
    """The control points that count, (p,), and the first joint of each, (p + 1,).

    A joint belongs to the first point that it can move. The last joints before a point may all turn about
    axes through it: they belong to the next.
    """
    ends = [*chain.module_starts[1:].tolist(), len(chain.joints)]
    begins = [0]
    for k in placed:
        stop = ends[k]
        while stop > begins[-1] and chain.revolute[stop - 1]:
            arm = chain.points[k] - chain.origins[stop - 1]
            if np.linalg.norm(np.cross(chain.axes[stop - 1], arm)) > ON_AXIS * chain.length:
                break
            stop -= 1
        begins.append(stop)
    return np.array(placed, dtype=np.int64), np.array(begins, dtype=np.int64)


@lru_cache(maxsize=64)
def _samples(n: int) -> Array:
    """Shares of the range of each joint, (2 S, n): both halves evenly spread, in an order for each joint."""
    rng = np.random.default_rng(0)
    sets = [(np.arange(SAMPLES) + middle) / SAMPLES for middle in (0.25, 0.75)]
    columns = [np.concatenate([rng.permutation(shares) for shares in sets]) for _ in range(n)]
    return np.ascontiguousarray(np.column_stack(columns))
