"""The configuration that takes given control points, or comes closest to them where none can."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pinposture import kernels
from pinposture.arm import Arm
from pinposture.curve import Curve
from pinposture.errors import PostureError
from pinposture.kernels.arrays import Springs
from pinposture.target.fit import fit_curve
from pinposture.target.in_turn import taken_exactly, taken_in_turn
from pinposture.target.target import Target

Array = NDArray[np.float64]

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
    for start in (*goal_starts(arm, target, straight), straight, *[None] * RETRIES):
        begin = best + nudge * rng.normal(size=arm.nv) if start is None else start
        found = _closest(arm, target, begin)
        gaps = _gaps(arm, target, found)
        squares = float(target.weights @ np.einsum("ij,ij->i", gaps, gaps))
        if squares < least:
            best, least = found, squares
        if least <= (ENOUGH * arm.length) ** 2:
            break
    residual = np.linalg.norm(_gaps(arm, target, best), axis=1)
    farthest = int(np.argmax(np.where(target.placed, residual, -1.0)))
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
    if target.q is not None or not np.all(target.placed):
        return target
    exact = taken_exactly(arm, target.points, arm.positions(arm.straight() if near is None else near))
    return target if exact is None else replace(target, q=arm.configuration(exact))


def goal_starts(arm: Arm, target: Target, near: Array) -> Iterator[Array]:
    """Where to look for the configuration that does best for a target: one that takes it, if one is found.

    Args:
        arm: the arm.
        target: where its control points should be; it fits the arm.
        near: joint positions to be near where there is a choice, (nv,) [rad or m].

    Yields:
        Joint positions (nv,) [rad or m] within the limits, the most promising first; only one if it takes all
        points.
    """
    positions, complete = taken_in_turn(arm, target.points, target.placed, near)
    yield positions
    if complete and np.abs(_gaps(arm, target, positions)).max() <= ENOUGH * arm.length:
        return
    try:
        curve = Curve.points(np.vstack([arm.chain.base, target.points[target.placed]]))
        yield fit_curve(arm, curve, 0.0, STRAIGHTENING * arm.length, rough=True).positions
    except PostureError:  # two in one place, for instance: they make no curve
        return


def _gaps(arm: Arm, target: Target, positions: Array) -> Array:
    """From the control points to where they should be, (m, 3) [m]."""
    return np.asarray(target.points - arm.kinematics.placed(positions).points)


def _closest(arm: Arm, target: Target, start: Array) -> Array:
    """Joint positions (nv,) at the least squares near a start: Levenberg and Marquardt's method, by sweeps.

    Args:
        arm: the arm.
        target: where its control points should be.
        start: joint positions to begin with, (nv,) [rad or m].
    """
    columns, placed, slides = arm.columns, np.flatnonzero(target.placed), arm.kinematics.slides
    ends, weights, chords = arm.kinematics.ends[placed], target.weights[placed], np.zeros(len(placed))
    n, units, wanted = len(columns), arm.joint_units[columns], target.points[placed]
    lower, upper = arm.limits.lower[columns], arm.limits.upper[columns]
    sides, x, screws = np.zeros(n, dtype=np.int8), np.zeros(n), np.empty((n, 6))

    def looked_at(tried: Array) -> tuple[float, Array, Springs]:
        at = arm.kinematics.placed(tried)
        reached = np.ascontiguousarray(at.points[placed])
        gaps = wanted - reached
        kernels.find_screws(np.arange(n), slides, units, at.axes, at.origins, ends, reached, screws)
        springs = Springs(screws.copy(), ends, reached, weights, chords)
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
