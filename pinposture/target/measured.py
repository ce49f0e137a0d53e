"""The configuration that comes closest to measured control points, which no arm can take exactly."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import least_squares

from pinposture.arm import Arm
from pinposture.curve import Curve
from pinposture.errors import PostureError
from pinposture.target.fit import bounds_of, fit_curve, free_columns
from pinposture.target.in_turn import exact_positions
from pinposture.target.target import Target

Array = NDArray[np.float64]

STRAIGHTENING = 1e-8
"""Weight of the joint positions against distances in arm lengths [1/rad]: it settles what they leave open."""


def fit_points(arm: Arm, points: ArrayLike, weights: ArrayLike | None = None) -> Target:
    """Fit the arm to target positions, for instance measured ones, by least squares within its limits.

    Points that the arm can take exactly are taken module by module, where modules have closed forms.
    Otherwise two starts are tried: the fit of the whole arm to a curve through the points, which knows the
    way round, and the straight arm.

    Args:
        arm: the arm.
        points: one position per control point, (m, 3) [m], world frame.
        weights: 1 to control a point, 0 to leave it free, (m,); all 1 if None.

    Returns:
        The target at those points, with the configuration `q` that comes closest to them and the distance of
        its control points from them as `residual`.

    Raises:
        InvalidValue: wrong shape, not finite, negative weights, or no point with a weight.
    """
    target = Target.from_points(arm, points, weights)
    exact = exact_positions(arm, target.points) if np.all(target.placed) else None
    if exact is not None:
        return _fitted(arm, target, arm.configuration(exact))
    columns = free_columns(arm)
    units = arm.joint_units[columns]
    root = np.sqrt(np.repeat(target.weights, 3))
    lower, upper = (bound / units for bound in bounds_of(arm, columns))
    rest = arm.positions(arm.straight())
    straight = np.clip(rest[columns] / units, lower, upper)

    def configuration(amounts: Array) -> Array:
        positions = rest.copy()
        positions[columns] = amounts * units
        return arm.configuration(positions)

    def distances(amounts: Array) -> Array:
        offsets = (arm.at(configuration(amounts)).points - target.points).ravel() / arm.length
        return np.concatenate([root * offsets, STRAIGHTENING * (amounts - straight)])

    def jacobian(amounts: Array) -> Array:
        state = arm.at(configuration(amounts))
        rows = state.jacobians[:, :, columns].reshape(3 * arm.n_modules, len(columns)) * units / arm.length
        return np.vstack([root[:, None] * rows, STRAIGHTENING * np.eye(len(columns))])

    bent = _bent(arm, target, rough=False)
    starts = [straight] if bent is None else [np.clip(bent[columns] / units, lower, upper), straight]
    found = [
        least_squares(
            distances, start, jac=jacobian, bounds=(lower, upper), xtol=1e-12, ftol=1e-15, gtol=1e-15
        )
        for start in starts
    ]
    best = np.clip(min(found, key=lambda fit: fit.cost).x, lower, upper)
    return _fitted(arm, target, configuration(best))


def with_configuration(arm: Arm, target: Target) -> Target:
    """The target with a configuration that takes all of it exactly, if it knows none and there is one."""
    if target.q is not None or not np.all(target.placed):
        return target
    exact = exact_positions(arm, target.points)
    return target if exact is None else replace(target, q=arm.configuration(exact))


def near_configuration(arm: Arm, target: Target) -> Array | None:
    """A configuration from which it is not far to a target, and the right way round.

    Args:
        arm: the arm.
        target: where its control points should be; it fits the arm.

    Returns:
        Configuration (nq,) within the limits; None if the points make no curve.
    """
    positions = exact_positions(arm, target.points) if np.all(target.placed) else None
    if positions is None:
        positions = _bent(arm, target, rough=True)
    return None if positions is None else arm.configuration(positions)


def _bent(arm: Arm, target: Target, rough: bool) -> Array | None:
    """Joint positions (nv,) of an arm fitted to a curve through the points; None if they make no curve."""
    try:
        curve = Curve.points(np.vstack([arm.chain.base, target.points[target.placed]]))
        return fit_curve(arm, curve, 0.0, STRAIGHTENING * arm.length, rough).positions
    except PostureError:  # two in one place, for instance
        return None


def _fitted(arm: Arm, target: Target, q: Array) -> Target:
    """The target with a configuration, and what that leaves."""
    residual = np.linalg.norm(arm.at(q).points - target.points, axis=1)
    return replace(target, q=q, residual=residual, method="closest")
