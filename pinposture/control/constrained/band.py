"""Waypoints that all move together: the most direct way where penalties have a say.

What `control.constrained.direct` minimises, and squares of penalties at each waypoint between the ends. The
minimum is found by damped Gauss-Newton steps: each couples neighbours only, a block tridiagonal system.
Joints at a limit that the descent would push past it are held there.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pinposture.arm import ArmState
from pinposture.control.constrained.posture import Linear, Posture
from pinposture.control.constrained.tridiagonal import solve_tridiagonal

Array = NDArray[np.float64]
Penalty = Callable[[ArmState, float], Linear]

ROUNDS, SETTLED = 40, 1e-4
"""The most steps of the search, and the relative fall of the sum at which it ends."""

FIRST, SMALLEST, LARGEST = 1e-3, 1e-9, 1e6
"""Damping of the search at first, at least, and where it gives up, relative to the mean diagonal of J^T J."""


class _Band(NamedTuple):
    """Waypoints with all that belongs to them.

    Attributes:
        x: displacements from the start, (N + 1, n), in `Arm.joint_units`.
        points: control points, (N + 1, r) [m].
        jacobians: of the points, (N + 1, r, n).
        penalties: rows of the penalties of the waypoints between the ends.
        energy: the sum that is minimised [m^2].
    """

    x: Array
    points: Array
    jacobians: Array
    penalties: list[Linear]
    energy: float


def relaxed_band(
    posture: Posture, start: Array, mu: float, within: tuple[Array, Array], x: Array, penalty: Penalty
) -> Array:
    """Waypoints at a minimum, (N + 1, n), in `Arm.joint_units`.

    Args:
        posture: the arm, and which joints it has.
        start: configuration that waypoints are displacements from, (nq,).
        mu: weight of joint motion against the motion of control points [m per `Arm.joint_units`].
        within: smallest and largest displacement, 2 x (n,).
        x: a first guess, (N + 1, n), within them.
        penalty: rows whose squares are added, for a state and its share of the way.
    """
    search = _Search(posture, start, mu, within, penalty)
    band, damping = search.band(x), FIRST
    for _ in range(ROUNDS):
        step = search.step(band, damping)
        if step is not None:
            moved = band.x.copy()
            moved[1:-1] = np.minimum(np.maximum(moved[1:-1] + step, within[0]), within[1])
            tried = search.band(moved)
            if tried.energy < band.energy:
                settled = tried.energy > (1.0 - SETTLED) * band.energy
                band, damping = tried, max(damping / 5.0, SMALLEST)
                if settled:
                    break
                continue
        damping *= 8.0
        if damping > LARGEST:
            break
    return band.x


class _Search:
    """Gauss-Newton steps on the waypoints of one path."""

    def __init__(
        self, posture: Posture, start: Array, mu: float, within: tuple[Array, Array], penalty: Penalty
    ) -> None:
        self._posture, self._start, self._weight, self._penalty = posture, start, mu**2, penalty
        self._lower, self._upper = within

    def band(self, x: Array) -> _Band:
        posture = self._posture
        columns, plane = posture.columns, posture.arm.plane
        states = [self._state(each) for each in x]
        points = np.array([(state.points @ plane.T).ravel() for state in states])
        rows = points.shape[1]
        jacobians = np.array([state.task_jacobians.reshape(rows, -1)[:, columns] for state in states])
        energy = float((np.diff(points, axis=0) ** 2).sum() + self._weight * (np.diff(x, axis=0) ** 2).sum())
        penalties = [self._penalty(states[i], i / (len(x) - 1)) for i in range(1, len(x) - 1)]
        energy += sum(float(each.errors @ each.errors) for each in penalties)
        return _Band(x, points, jacobians, penalties, energy)

    def _state(self, x: Array) -> ArmState:
        return self._posture.arm.at(self._posture.arm.integrate(self._start, self._posture.displacement(x)))

    def step(self, band: _Band, damping: float) -> Array | None:
        """The damped Gauss-Newton step of all waypoints between the ends, (N - 1, n)."""
        x, inner = band.x, band.jacobians[1:-1]
        n, turned = x.shape[1], inner.transpose(0, 2, 1)
        stretch, turn = np.diff(band.points, axis=0), np.diff(x, axis=0)
        pull = stretch[:-1] - stretch[1:]
        gradient = (turned @ pull[:, :, None])[:, :, 0] + self._weight * (turn[:-1] - turn[1:])
        own = turned @ inner
        typical = float(np.trace(own.sum(axis=0))) / (n * len(own))
        diagonal = 2.0 * own + (2.0 * self._weight + damping * typical) * np.eye(n)
        above = -(turned[:-1] @ inner[1:]) - self._weight * np.eye(n)
        for i, rows in enumerate(band.penalties):
            diagonal[i] += rows.matrix.T @ rows.matrix
            gradient[i] -= rows.matrix.T @ rows.errors
        free = ~(
            ((x[1:-1] >= self._upper) & (gradient < 0.0)) | ((x[1:-1] <= self._lower) & (gradient > 0.0))
        )
        if not free.all():
            diagonal *= free[:, :, None] & free[:, None, :]
            diagonal[:, np.arange(n), np.arange(n)] += ~free
            above *= free[:-1, :, None] & free[1:, None, :]
            gradient = gradient * free
        return solve_tridiagonal(diagonal, above, -gradient)
