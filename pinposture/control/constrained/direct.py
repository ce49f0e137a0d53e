"""The most direct way through joint space: the one on which the control points travel least.

The configurations between a start and a goal are free. Joint interpolation takes them on a straight line,
on which control points sweep wide; what a user expects is that the points go straight. A path of waypoints
x_0 ... x_N with control points P(x_i) minimises

    sum over i of |P(x_{i+1}) - P(x_i)|^2 + mu^2 |x_{i+1} - x_i|^2,

the energy of the motion in the metric J^T J + mu^2 I; its minimum is a geodesic, at constant speed. The first
term makes the points go straight, the second keeps joints from turning far for little; mu is the dial
between the two. Both ends are fixed, and the search begins with joint interpolation, so that the path
goes the way round that the goal configuration means. Squares of further penalties may be added, for obstacles
on the way for instance.

The minimum is found by damped Gauss-Newton steps: each couples neighbours only, a block tridiagonal system.
Waypoints stay within the position limits: joints at a limit that the descent would push past it are held
there.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from pinposture.arm import ArmState
from pinposture.control.constrained.path import JointPath
from pinposture.control.constrained.posture import Linear, Posture
from pinposture.control.constrained.tridiagonal import solve_tridiagonal
from pinposture.control.sweep import sweep

Array = NDArray[np.float64]
Penalty = Callable[[ArmState, float], Linear]

PIECES = (24, 48, 96)
"""Straight pieces of a path; more where fewer lead far round, and only where nothing else bends the way."""

STRAIGHT, FAR_ROUND = 1.01, 1.15
"""Length of the ways of the points, relative to the shortest, up to which joint interpolation is left as it
is, and beyond which more pieces are tried: long turns need them."""

LOOKS = 48
"""Places at which the length of a path is looked up."""

FINER = 4
"""Into how many pieces each one is divided in the end, on a smooth curve."""

ROUNDS, SETTLED = 40, 1e-4
"""The most steps of the search, and the relative fall of the sum at which it ends."""

SWAY, WIDE = 0.05, 0.4
"""How far the first guess is bent to one side, relative to the largest change of a joint, which breaks
symmetries. More where a way that was found before leads through an obstacle."""

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


def direct_path(
    posture: Posture,
    start: Array,
    goal: Array,
    mu: float,
    edges: Array,
    penalty: Penalty | None = None,
    sway: int = 0,
) -> JointPath:
    """Find the most direct path between two configurations.

    Args:
        posture: the arm, and which joints it has.
        start: configuration to start from, (nq,).
        goal: configuration to go to, (nq,).
        mu: weight of joint motion against the motion of control points [m per `Arm.joint_units`].
        edges: joint positions to stay between, (2, nv) [rad or m].
        penalty: rows whose squares are added at each waypoint between the ends, for a state and its share of
            the way; their errors should vanish.
        sway: which way the first guess is bent, from 0; other numbers may lead to another path.
    """
    arm, columns, units = posture.arm, posture.columns, posture.units
    way = np.array(arm.difference(start, goal))
    way[np.setdiff1d(np.arange(arm.nv), columns)] = 0.0
    search, whole = _Search(posture, start, mu, edges, penalty), posture.own(way)
    found = np.vstack([np.zeros(len(whole)), whole])
    detour = np.inf if penalty is not None else search.detour(found)
    for pieces in PIECES if detour > STRAIGHT else ():
        shares = np.linspace(0.0, 1.0, pieces + 1)[:, None]
        sway_out = np.sin(np.pi * shares) * _sway(posture, sway) * np.abs(whole).max(initial=0.0)
        relaxed = search.relaxed(shares * whole + sway_out)
        length = search.detour(relaxed)
        if length < detour:
            found, detour = relaxed, length
        if detour <= FAR_ROUND or penalty is not None:
            break
    smooth = search.smoothed(found)
    offsets = np.zeros((len(smooth), arm.nv))
    offsets[:, columns] = smooth * units
    return JointPath(arm, start, offsets)


class _Search:
    """Gauss-Newton steps on the waypoints of one path."""

    def __init__(
        self, posture: Posture, start: Array, mu: float, edges: Array, penalty: Penalty | None
    ) -> None:
        self._posture, self._start, self._weight, self._penalty = posture, start, mu**2, penalty
        here = posture.arm.positions(start)[posture.columns]
        self._lower, self._upper = ((edge[posture.columns] - here) / posture.units for edge in edges)
        # A start outside its limits: the waypoints come back on the way.
        self._lower, self._upper = np.minimum(self._lower, 0.0), np.maximum(self._upper, 0.0)

    def band(self, x: Array) -> _Band:
        posture = self._posture
        columns, plane = posture.columns, posture.arm.plane
        states = [self._state(each) for each in x]
        points = np.array([(state.points @ plane.T).ravel() for state in states])
        rows = points.shape[1]
        jacobians = np.array([state.task_jacobians.reshape(rows, -1)[:, columns] for state in states])
        energy = float((np.diff(points, axis=0) ** 2).sum() + self._weight * (np.diff(x, axis=0) ** 2).sum())
        penalties = []
        if self._penalty is not None:
            penalties = [self._penalty(states[i], i / (len(x) - 1)) for i in range(1, len(x) - 1)]
        energy += sum(float(each.errors @ each.errors) for each in penalties)
        return _Band(x, points, jacobians, penalties, energy)

    def smoothed(self, x: Array) -> Array:
        """More waypoints, on a cubic spline through the given ones, so that joints change speed gradually."""
        if len(x) == 2:
            return x
        numbers = np.arange(len(x))
        fine = CubicSpline(numbers, x, bc_type="natural")(
            np.linspace(0, numbers[-1], FINER * numbers[-1] + 1)
        )
        return np.asarray(np.minimum(np.maximum(fine, self._lower), self._upper))

    def detour(self, x: Array) -> float:
        """Length of the ways of the control points, relative to the distances from start to end."""
        steps = np.linspace(0.0, len(x) - 1.0, LOOKS + 1)
        fine = np.array([np.interp(steps, np.arange(len(x)), each) for each in x.T]).T
        return sweep(np.array([self._state(each).points for each in fine]))

    def _state(self, x: Array) -> ArmState:
        return self._posture.arm.at(self._posture.arm.integrate(self._start, self._posture.displacement(x)))

    def relaxed(self, x: Array) -> Array:
        """Waypoints at a minimum, from a first guess."""
        x = np.minimum(np.maximum(x, self._lower), self._upper)
        band, damping = self.band(x), FIRST
        for _ in range(ROUNDS):
            step = self._step(band, damping)
            if step is not None:
                moved = band.x.copy()
                moved[1:-1] = np.minimum(np.maximum(moved[1:-1] + step, self._lower), self._upper)
                tried = self.band(moved)
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

    def _step(self, band: _Band, damping: float) -> Array | None:
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


def _sway(posture: Posture, number: int) -> Array:
    """A bend of the whole arm to one side, (n,); each number means another one."""
    along = (np.arange(len(posture.columns)) + 0.5) / len(posture.columns)
    size, sign, waves = WIDE if number else SWAY, (-1.0) ** number, 1 + number // 2
    return np.asarray(size * sign * np.cos(np.pi * waves * along))
