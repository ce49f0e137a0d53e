"""The configuration that takes given control points, or comes closest to them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pinposture import kernels
from pinposture.arm import Arm
from pinposture.arm.chain import Chain
from pinposture.curve import Curve
from pinposture.errors import PostureError
from pinposture.kernels.arrays import PointObjective, Screwed
from pinposture.placement.least_squares import fit_curve
from pinposture.placement.target import Target

# The configuration that takes given control points exactly, module by module, where there is one.

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


def place_sequentially(arm: Arm, points: Array, placed: NDArray[np.bool_], near: Array) -> tuple[Array, bool]:
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
    """What `place_sequentially` finds for all points where nothing has to be chosen, in microseconds.

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
    taken = kernels.search_branches(chain, wanted, arm.length, good, window, tries, samples, found)
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


# The configuration that takes given control points, or comes closest to them where none can.

STRAIGHTENING = 1e-8
"""Weight of the joint positions against distances in arm lengths [1/rad]: it settles what they leave open."""

TAKEN, ENOUGH = 1e-6, 1e-9
"""How far a control point may be from its point that counts as taken, and from where on nothing closer is
looked for, in arm lengths."""

RETRIES, NUDGE = 8, 0.3
"""How often a closer posture is looked for around the closest, and how far away, in `Arm.joint_units`."""

ROUNDS, STRIDE, SETTLED, PATIENCE = 300, 0.5, 1e-9, 3
"""The most steps of a fit, the largest of them in `Arm.joint_units`, and the relative fall of the squares
that is none, so many times in a row."""

LEAST, EASIER, HARDER, MOST = 1e-12, 0.2, 5.0, 1e6
"""Smallest and largest damping of a fit, relative to its mean stiffness, and how it changes."""


def fit_points(arm: Arm, points: ArrayLike, weights: ArrayLike | None = None) -> Target:
    """Find the configuration that takes given points, or comes closest to them within the limits.

    Points that the arm can take are taken module by module, with a search back where a choice was wrong: it
    is the search of the default controller. Points that it cannot take, such as measured ones, are fitted by
    least squares, from where that search ended, from the fit of the whole arm to a curve through the points,
    which knows the way round, and from the straight arm. What that finds may be a local minimum.

    Args:
        arm: the arm.
        points: one position per control point, (m, 3) [m], world frame.
        weights: 1 to control a point, 0 to leave it free, (m,); all 1 if None.

    Returns:
        The target at those points, with the configuration `q` that comes closest to them and the distance of
        its control points from them as `residual`. Where one of them is not taken, `approximate` says so.

    Raises:
        InvalidValue: wrong shape, not finite, negative weights, or no point with a weight.
    """
    target = Target.from_points(arm, points, weights)
    straight = arm.positions(arm.straight())
    rng, nudge = np.random.default_rng(0), np.where(arm.moved > 0.0, NUDGE * arm.joint_units, 0.0)
    best, least = straight, np.inf
    for start in (*initial_guesses(arm, target, straight), straight, *[None] * RETRIES):
        begin = best + nudge * rng.normal(size=arm.nv) if start is None else start
        found = _closest(arm, target, begin)
        gaps = _gaps(arm, target, found)
        squares = float(target.weights @ np.einsum("ij,ij->i", gaps, gaps))
        if squares < least:
            best, least = found, squares
        if least <= (ENOUGH * arm.length) ** 2:
            break
    residual = np.linalg.norm(_gaps(arm, target, best), axis=1)
    farthest = int(np.argmax(np.where(target.has_target, residual, -1.0)))
    approximate = ""
    if residual[farthest] > TAKEN * arm.length:
        approximate = (
            f"the closest posture that was found leaves control point {farthest} {residual[farthest]:.3g} m "
            "from its point; it may be a local minimum"
        )
    q = arm.nearest_turns(arm.configuration(best))
    return replace(target, q=q, residual=residual, method="closest", approximate=approximate)


def with_configuration(arm: Arm, target: Target, near: Array | None = None) -> Target:
    """The target with a configuration that takes all of it, if it knows none and a quick look finds one.

    Args:
        arm: the arm.
        target: where its control points should be; it fits the arm.
        near: a configuration to be near, (nq,); the straight one if None.
    """
    if target.q is not None or not np.all(target.has_target):
        return target
    exact = taken_exactly(arm, target.points, arm.positions(arm.straight() if near is None else near))
    return target if exact is None else replace(target, q=arm.configuration(exact))


def initial_guesses(arm: Arm, target: Target, near: Array) -> Iterator[Array]:
    """Where to look for the configuration that does best for a target: one that takes it, if one is found.

    Args:
        arm: the arm.
        target: where its control points should be; it fits the arm.
        near: joint positions to be near where there is a choice, (nv,) [rad or m].

    Yields:
        Joint positions (nv,) [rad or m] within the limits, the most promising first; only one if it takes all
        points.
    """
    positions, complete = place_sequentially(arm, target.points, target.has_target, near)
    yield positions
    if complete and np.abs(_gaps(arm, target, positions)).max() <= ENOUGH * arm.length:
        return
    try:
        curve = Curve.points(np.vstack([arm.chain.base, target.points[target.has_target]]))
        yield fit_curve(arm, curve, 0.0, STRAIGHTENING * arm.length, rough=True).positions
    except PostureError:  # two in one place, for instance: they make no curve
        return


def _gaps(arm: Arm, target: Target, positions: Array) -> Array:
    """From the control points to where they should be, (m, 3) [m]."""
    return np.asarray(target.points - arm.kinematics.forward(positions).points)


def _closest(arm: Arm, target: Target, start: Array) -> Array:
    """Joint positions (nv,) at the least squares near a start: Levenberg and Marquardt's method, by sweeps.

    Args:
        arm: the arm.
        target: where its control points should be.
        start: joint positions to begin with, (nv,) [rad or m].
    """
    columns, placed, slides = arm.columns, np.flatnonzero(target.has_target), arm.kinematics.slides
    ends, weights, chords = arm.kinematics.ends[placed], target.weights[placed], np.zeros(len(placed))
    n, units, wanted = len(columns), arm.joint_units[columns], target.points[placed]
    lower, upper = arm.limits.lower[columns], arm.limits.upper[columns]
    sides, x, screws = np.zeros(n, dtype=np.int8), np.zeros(n), np.empty((n, 6))

    def looked_at(tried: Array) -> tuple[float, Array, PointObjective]:
        at = arm.kinematics.forward(tried)
        reached = np.ascontiguousarray(at.points[placed])
        gaps = wanted - reached
        kernels.find_screws(np.arange(n), slides, units, at.axes, at.origins, ends, reached, screws)
        springs = PointObjective(screws.copy(), ends, reached, weights, chords)
        return float(weights @ np.einsum("ij,ij->i", gaps, gaps)), gaps, springs

    positions = start.copy()
    positions[columns] = np.clip(start[columns], lower, upper)
    squares, misses, springs = looked_at(positions)
    damping, idle = 1e-3, 0
    for _ in range(ROUNDS):
        if idle >= PATIENCE or damping > MOST or squares <= (1e-3 * ENOUGH * arm.length) ** 2:
            break
        here = positions[columns]
        low = np.maximum((lower - here) / units, -STRIDE)
        high = np.minimum((upper - here) / units, STRIDE)
        weight = damping * max(kernels.stiffness(springs), 1e-12 * arm.length**2)
        sides[:] = 0
        kernels.minimise_in_box(springs, misses, np.full(n, weight), np.zeros(n), low, high, sides, x)
        tried = positions.copy()
        tried[columns] = np.clip(here + units * x, lower, upper)
        found, gaps, after = looked_at(tried)
        if found < squares:
            idle = idle + 1 if found > (1.0 - SETTLED) * squares else 0
            positions, squares, misses, springs = tried, found, gaps, after
            damping = max(damping * EASIER, LEAST)
        else:
            damping *= HARDER
    return np.asarray(positions)
