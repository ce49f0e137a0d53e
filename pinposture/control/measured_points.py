"""Measured points: the posture that comes closest to them, and a filter of their noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pinposture._validation import float_array, require_instance, require_positive
from pinposture.arm import Arm, ChainState
from pinposture.control.planner.damped_least_squares import PlanningProblem
from pinposture.control.planner.goal import find_goal
from pinposture.control.planner.objective import Objective
from pinposture.placement import Target
from pinposture.units import CONVERGED, ROUNDING, length_text

Array = NDArray[np.float64]


def fit_points(arm: Arm, points: ArrayLike, weights: ArrayLike | None = None) -> Target:
    """Find the configuration that reaches given points, or comes closest to them within the limits.

    The search is that for the goal of the default controller, without its weights and obstacles: points are
    placed module by module, with backtracking; what that leaves is fitted by least squares, also from the
    straight arm, from a fit of the whole arm to a curve through the points, and from random postures. The
    result may be a local minimum.

    Args:
        arm: the arm.
        points: one position per control point, (m, 3) [m], world frame.
        weights: 1 to control a point, 0 to leave it free, (m,); all 1 if None.

    Returns:
        The target at those points, with the closest configuration `q` and the distances of its control points
        as `residual`. `approximate` reports points that are not reached.

    Raises:
        InvalidValue: wrong shape, not finite, negative weights, or no point with a weight.
    """
    target = Target.from_points(arm, points, weights)
    goal = _closest_state(arm, target)
    residual = np.linalg.norm(target.points - goal.points, axis=1)
    farthest = int(np.argmax(target.distances(goal.points)))
    approximate = ""
    if residual[farthest] > CONVERGED * arm.length:
        approximate = (
            f"in the closest posture found, control point {farthest} is {length_text(residual[farthest])} "
            "from its point; it may be a local minimum"
        )
    q = arm.nearest_turns(goal.q)
    return replace(target, q=q, residual=residual, method="closest", approximate=approximate)


def _closest_state(arm: Arm, target: Target) -> ChainState:
    """Return the state in which the control points come closest to a target, within the limits."""
    objective = Objective(arm, target, relative_position_weight=0.0)
    limits = np.array([arm.limits.lower, arm.limits.upper])
    problem = PlanningProblem(objective, arm.chain_at(arm.straight()), limits)
    exact = ROUNDING * arm.length
    # A search goes on below the error at which no other is made, as it then takes few more steps.
    return find_goal(problem, 1e-3 * exact, enough=exact).state


class PointFilter:
    """Filter that turns noisy measured points, one set per cycle, into targets that the arm follows smoothly.

        smooth = pp.PointFilter(arm, dt=0.01, noise=1e-3)
        tracker.update(smooth.update(points))  # in every cycle

    Noise of the points causes joint motions, which are larger the less the joints move the points: 0.08 rad
    for 1 mm on links of 25 mm. The filter therefore estimates joint positions and velocities: it predicts
    them from the last cycle and corrects them with the measurement. Along each right singular vector of the
    points' Jacobian, the gains are those of the stationary Kalman filter for random acceleration and the
    noise of the joint motion in that direction (Kalata's alpha-beta filter). Motion at constant joint speed
    is followed without lag.

    Args:
        arm: the arm.
        dt: duration of a cycle [s].
        noise: standard deviation of a coordinate of a point [m].
        acceleration: standard deviation of the joint acceleration, in `Arm.joint_units` per s^2. Lower values
            give smoother motion, higher values a faster response.

    Raises:
        InvalidValue: a number is not positive.
    """

    def __init__(self, arm: Arm, dt: float, noise: float, acceleration: float = 3.0) -> None:
        require_instance("arm", arm, Arm, "an Arm")
        for name, value in (("dt", dt), ("noise", noise), ("acceleration", acceleration)):
            require_positive(name, value)
        self.arm = arm
        self.dt = float(dt)
        self.noise = float(noise)
        self.acceleration = float(acceleration)
        self.restart()

    def restart(self) -> None:
        """Discard all measurements."""
        self._positions: Array | None = None
        self._velocity = np.zeros(self.arm.nv)

    def update(self, points: ArrayLike) -> Target:
        """Return the target of a cycle.

        Points that jump are fitted from scratch (`fit_points`), which can take longer than a cycle.

        Args:
            points: measured positions of the control points, (m, 3) [m], world frame; rows that are not
                finite mark points not seen. A point not seen in the first measurement is free in that fit.

        Returns:
            The target at the estimated posture, with its configuration and velocity; at rest at the previous
            posture if no point was seen.

        Raises:
            InvalidValue: wrong shape, or no point has been seen yet.
        """
        arm = self.arm
        measured = float_array("points", points, (arm.n_modules, 3))
        seen = np.asarray(np.isfinite(measured).all(axis=1))
        measured = np.where(seen[:, None], measured, 0.0)
        if self._positions is None or not self._correct(self._positions, measured, seen):
            target = Target.from_points(arm, measured, seen.astype(np.float64))
            self._positions = _closest_state(arm, target).raw_positions
            self._velocity = np.zeros(arm.nv)
        target = Target.from_configuration(arm, arm.configuration(self._positions))
        return replace(target, velocity=self._velocity)

    def _correct(self, positions: Array, measured: Array, seen: NDArray[np.bool_]) -> bool:
        """Advance by a cycle; return whether the points are close to their prediction."""
        arm = self.arm
        columns = self.arm.columns
        units = self.arm.joint_units[self.arm.columns]
        lower = arm.limits.lower
        upper = arm.limits.upper
        if not seen.any():
            self._velocity = np.zeros(arm.nv)
            return True
        foreseen = np.clip(positions + self.dt * self._velocity, lower, upper)
        state = arm.at(arm.configuration(foreseen))
        errors = (measured - state.points)[seen] @ arm.plane.T
        if np.linalg.norm(errors, axis=1).mean() > 0.5 * arm.length / arm.n_modules:
            return False  # a surprise of half a module
        jacobian = state.task_jacobians[seen].reshape(-1, arm.nv)[:, columns] * units
        squares, directions = np.linalg.eigh(jacobian.T @ jacobian)
        motions = directions.T @ (jacobian.T @ errors.ravel())
        # Along directions in which joints hardly move the points, noise would cause large joint motions: from
        # one of 0.3 units on, a measurement has less than half its weight.
        motions /= np.maximum(squares, 0.0) + (self.noise / 0.3) ** 2
        # Noise of the joint motion along a direction is that of the points divided by its singular value.
        ratios = self.acceleration * self.dt**2 / self.noise * np.sqrt(np.maximum(squares, 0.0))
        alpha, beta = stationary_gains(ratios)
        corrected = foreseen.copy()
        self._velocity = self._velocity.copy()
        corrected[columns] += units * (directions @ (alpha * motions))
        self._velocity[columns] += units * (directions @ (beta * motions)) / self.dt
        self._positions = np.clip(corrected, lower, upper)
        self._velocity[self._positions != corrected] = 0.0
        return True


def stationary_gains(ratio: Array) -> tuple[Array, Array]:
    """Return the gains for position, and for velocity times the cycle, of a stationary Kalman filter.

    Args:
        ratio: change of position in a cycle due to random acceleration, a dt^2, relative to the noise of the
            measured position (the tracking index of Kalata, 1984).
    """
    root = (4.0 + ratio - np.sqrt(ratio * (8.0 + ratio))) / 4.0
    alpha = 1.0 - root**2
    return alpha, 2.0 * (2.0 - alpha) - 4.0 * np.sqrt(1.0 - alpha)
