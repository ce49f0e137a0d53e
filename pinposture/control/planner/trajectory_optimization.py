"""The path on which the control points travel least, with and without penalties."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.linalg.lapack import dpbsv

from pinposture import kernels
from pinposture.arm import ArmState
from pinposture.control.planner.objective import Linear, Posture
from pinposture.control.planner.path import JointPath

# Symmetric block tridiagonal systems, as chains of waypoints make them.

Array = NDArray[np.float64]


def solve_tridiagonal(diagonal: Array, above: Array, right: Array) -> Array | None:
    """Solve a symmetric positive definite block tridiagonal system by band Cholesky, in O(N n^3).

    It is one call of LAPACK: many small ones, a few for each block, spend a hundred times as long waiting for
    the threads of BLAS where other processes use the cores.

    Args:
        diagonal: diagonal blocks, (N, n, n).
        above: blocks right of the diagonal ones, (N - 1, n, n).
        right: right-hand side, (N, n).

    Returns:
        The solution (N, n), or None if the matrix is not positive definite.
    """
    count, n = right.shape
    band = np.zeros((2 * n, count * n), order="F")  # element (row, column) is kept at (row - column, column)
    first = n * np.arange(count)[:, None]
    row, column = np.tril_indices(n)
    band[row - column, first + column] = diagonal[:, row, column]
    row, column = np.indices((n, n)).reshape(2, -1)
    band[n + column - row, first[:-1] + row] = above[:, row, column]
    _, solution, failed = dpbsv(band, right.ravel(), lower=1, overwrite_ab=1)
    return None if failed else np.reshape(solution, (count, n))


# Waypoints that all move together: the most direct way where penalties have a say.
#
# What `kernels.path` minimises, and squares of penalties at each waypoint between the ends.
# The minimum is found by damped Gauss-Newton steps: each couples neighbours only, a block tridiagonal
# system. Joints at a limit that the descent would push past it are held there.

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


def optimize_with_penalties(
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
        return self._posture.arm.at(
            self._posture.arm.integrate(self._start, self._posture.displacement(x))
        ).compiled

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


# The most direct way through joint space: the one on which the control points travel least.
#
# The configurations between a start and a goal are free. Joint interpolation takes them on a straight line,
# on which control points sweep wide; what a user expects is that the points go straight. A path of waypoints
# x_0 ... x_N with control points P(x_i) minimises
#
# sum over i of |P(x_{i+1}) - P(x_i)|^2 + mu^2 |x_{i+1} - x_i|^2,
#
# the energy of the motion in the metric J^T J + mu^2 I; its minimum is a geodesic, at constant speed. The
# first term makes the points go straight, the second keeps joints from turning far for little; mu is the
# dial between the two. Both ends are fixed, and the search begins with joint interpolation, so that the path
# goes the way round that the goal configuration means. Waypoints stay within the position limits.
#
# The minimum is found by relaxing one waypoint after the other (`kernels.path`), first of few and then
# of more, in time linear in the number of joints. Where squares of further penalties are added, for
# obstacles on the way for instance, all waypoints move together (`control.planner.trajectory_optimization`).

LEVELS, PIECES = (6, 12, 24), (24, 48, 96)
"""Straight pieces of a path: first few and then more, which is quick; many from the beginning where that led
far round, because long turns need them, and few cut them short."""

STRAIGHT, FAR_ROUND, LOST = 1.01, 1.1, 2.0
"""Length of the ways of the points, relative to the shortest: up to the first, joint interpolation is left
as it is; beyond the second, more pieces are tried; beyond the third, few are not made more."""

NEAR = 0.1
"""Joint motion up to which joint interpolation will do, in `Arm.joint_units`: a step is no more direct."""

LOOKS = 48
"""Places at which the length of a path is looked up."""

FINER = 4
"""Into how many pieces each one is divided in the end, on a smooth curve."""

RELAXATION_ROUNDS, RELAXED, ROUGHLY = 60, 3e-5, 3e-4
"""The most passes over all waypoints, and the relative fall of the energy in one at which they end; the last
one where more waypoints follow anyway."""

SWAY, WIDE = 0.05, 0.4
"""How far the first guess is bent to one side, relative to the largest change of a joint, which breaks
symmetries. More where a way that was found before leads through an obstacle."""


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
    arm = posture.arm
    whole = posture.own(arm.difference(start, goal))
    turn = float(np.abs(whole).max(initial=0.0))
    if penalty is None and turn <= NEAR:
        return JointPath(arm, start, np.array([np.zeros(arm.nv), posture.displacement(whole)]))
    ways = _Ways(posture, start, mu, edges)
    found = np.vstack([np.zeros(len(whole)), whole])
    bend = _sway(posture, sway) * turn
    if penalty is not None:
        found = optimize_with_penalties(
            posture, start, mu, ways.within, ways.bent(whole, bend, PIECES[0]), penalty
        )
    else:
        detour = ways.detour(found)
        for other in ways.violated_constraints(whole, bend) if detour > STRAIGHT else ():
            length = ways.detour(other)
            if length < detour:
                found, detour = other, length
            if detour <= FAR_ROUND:
                break
    smooth = ways.finer(found, FINER * (len(found) - 1)) if len(found) > 2 else found
    offsets = np.zeros((len(smooth), arm.nv))
    offsets[:, posture.columns] = smooth * posture.units
    return JointPath(arm, start, offsets)


class _Ways:
    """Waypoints as displacements from the start, (N + 1, n), in `Arm.joint_units`.

    Attributes:
        within: smallest and largest displacement, (2, n).
    """

    def __init__(self, posture: Posture, start: Array, mu: float, edges: Array) -> None:
        arm, chain, self._weight = posture.arm, posture.chain, mu**2
        self._start = arm.positions(start)
        lower, upper = ((edge - self._start)[posture.columns] / posture.units for edge in edges)
        # A start outside its limits: the waypoints come back on the way.
        self.within = np.minimum(lower, 0.0), np.maximum(upper, 0.0)
        constants = arm.kinematics.constants
        ends = np.searchsorted(chain.which, arm.kinematics.ends).astype(np.int64)
        self._relax = (constants, chain.which, ends, chain.units, self._start, *self.within)
        self._look = (constants, chain.which, chain.units, self._start)

    def bent(self, whole: Array, bend: Array, pieces: int) -> Array:
        """Joint interpolation, bent to one side."""
        shares = np.linspace(0.0, 1.0, pieces + 1)[:, None]
        return self._inside(shares * whole + np.sin(np.pi * shares) * bend)

    def finer(self, x: Array, pieces: int) -> Array:
        """More waypoints, on a cubic spline through the given ones, so that joints change speed gradually."""
        if pieces == len(x) - 1:
            return x
        spline = CubicSpline(np.linspace(0.0, 1.0, len(x)), x, bc_type="natural")
        return self._inside(spline(np.linspace(0.0, 1.0, pieces + 1)))

    def violated_constraints(self, whole: Array, bend: Array) -> Iterator[Array]:
        """Waypoints at a minimum, by more and more effort."""
        x = self.bent(whole, bend, LEVELS[0])
        for pieces in LEVELS:
            x = self.finer(x, pieces)
            settled = RELAXED if pieces == LEVELS[-1] else ROUGHLY
            kernels.relax_waypoints(*self._relax, self._weight, RELAXATION_ROUNDS, settled, x)
            if self.detour(x) > LOST:
                break
        else:
            yield x
        x = self.bent(whole, bend, PIECES[0])
        for pieces in PIECES:
            x = self.finer(x, pieces)
            kernels.relax_waypoints(*self._relax, self._weight, RELAXATION_ROUNDS, RELAXED, x)
            yield x

    def detour(self, x: Array) -> float:
        """Length of the ways of the control points, relative to the distances from start to end."""
        path, direct = kernels.measure_path_lengths(*self._look, x, LOOKS)
        return max(path / direct, 1.0) if direct > 1e-12 * path else 1.0

    def _inside(self, x: Array) -> Array:
        return np.ascontiguousarray(np.minimum(np.maximum(x, self.within[0]), self.within[1]))


def _sway(posture: Posture, number: int) -> Array:
    """A bend of the whole arm to one side, (n,); each number means another one."""
    along = (np.arange(len(posture.columns)) + 0.5) / len(posture.columns)
    size, sign, waves = WIDE if number else SWAY, (-1.0) ** number, 1 + number // 2
    return np.asarray(size * sign * np.cos(np.pi * waves * along))
