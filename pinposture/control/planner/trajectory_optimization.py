"""The path on which the control points travel least: geodesics through joint space.

The configurations between a start and a goal are free. Joint interpolation takes a straight line through
joint space, on which the control points sweep wide. A path of waypoints x_0 ... x_N with control points
P(x_i) instead minimises

    sum over i of |P(x_{i+1}) - P(x_i)|^2 + mu^2 |x_{i+1} - x_i|^2,

the energy of the motion in the metric J^T J + mu^2 I. Its minimum is a geodesic, at constant speed. The first
term makes the points go straight, the second keeps joints from turning far for little; mu balances the two.
Both ends are fixed. The search begins with joint interpolation, so that joints turn the way that the goal
configuration means. Waypoints stay within the position limits.

Without penalties one waypoint after the other is relaxed (`kernels.path`), first few and then more, in time
linear in the number of joints. With penalties, for obstacles or tasks, all waypoints move together: damped
Gauss-Newton steps that couple neighbours only, as block tridiagonal systems.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from pinposture import kernels
from pinposture.arm import ArmState
from pinposture.control.planner.objective import LinearRows, Objective
from pinposture.control.planner.path import JointPath

Array = NDArray[np.float64]

Penalty = Callable[[ArmState, float], LinearRows]
"""Rows whose squares are added to the energy, for a state and its place on the path as a share."""

COARSE_TO_FINE, MANY_PIECES = (6, 12, 24), (24, 48, 96)
"""Numbers of straight pieces of a path: first few and then more, which is quick; many from the beginning
where that made a long detour, because long turns need them."""

KEPT_RATIO, GOOD_RATIO, MAX_RATIO = 1.01, 1.1, 2.0
"""Path length ratios of the control points: up to the first, joint interpolation is kept; above the second,
more pieces are tried; above the third, a path of few pieces is not refined."""

SHORT_MOTION = 0.1
"""Joint motion up to which joint interpolation will do, in `Arm.joint_units`: one step is no more direct."""

LENGTH_SAMPLES = 48
"""Number of places at which the length of a path is sampled."""

REFINEMENT = 4
"""Number of pieces into which each one is divided at the end, on a smooth curve."""

MAX_PASSES, RELAXED, NEARLY_RELAXED = 60, 3e-5, 3e-4
"""Largest number of passes over all waypoints, and the relative fall of the energy in one at which they end;
the last one where more waypoints follow anyway."""

SMALL_BEND, LARGE_BEND = 0.05, 0.4
"""How far the first guess is bent to one side, relative to the largest change of a joint, which breaks
symmetries; more for the variants."""

MAX_PATH_ITERATIONS, NEWTON_CONVERGED = 40, 1e-4
"""Largest number of Gauss-Newton steps, and the relative fall of the energy at which they end."""

FIRST_DAMPING, MIN_DAMPING, MAX_DAMPING = 1e-3, 1e-9, 1e6
"""Damping of Gauss-Newton steps at first, at least, and where the search gives up, relative to the mean
diagonal of J^T J."""


def direct_path(
    objective: Objective,
    start: Array,
    goal: Array,
    edges: Array,
    penalty: Penalty | None = None,
    variant: int = 0,
) -> JointPath:
    """Find the most direct path between two configurations.

    Args:
        objective: the arm, its joints, and their weight.
        start: configuration to start from, (nq,).
        goal: configuration to go to, (nq,).
        edges: joint positions to stay between, (2, nv) [rad or m].
        penalty: rows whose errors should vanish at each waypoint between the ends; None: there are none.
        variant: how the first guess is bent, from 0; other numbers may lead to another path.
    """
    arm = objective.arm
    change = objective.normalize(arm.difference(start, goal))
    largest = float(np.abs(change).max(initial=0.0))
    if penalty is None and largest <= SHORT_MOTION:
        return JointPath(objective, start, np.array([np.zeros(arm.nv), objective.displacement(change)]))
    waypoints = _Waypoints(objective, start, edges)
    found = np.vstack([np.zeros(len(change)), change])
    bend = _bend(objective, variant) * largest
    if penalty is not None:
        guess = waypoints.interpolate(change, bend, MANY_PIECES[0])
        found = optimize_with_penalties(objective, start, waypoints.within, guess, penalty)
    else:
        shortest = waypoints.length_ratio(found)
        for other in waypoints.relax(change, bend) if shortest > KEPT_RATIO else ():
            length = waypoints.length_ratio(other)
            if length < shortest:
                found, shortest = other, length
            if shortest <= GOOD_RATIO:
                break
    smooth = waypoints.refine(found, REFINEMENT * (len(found) - 1)) if len(found) > 2 else found
    return JointPath(objective, start, objective.displacement(smooth))


def relax_path(
    objective: Objective, start: Array, offsets: Array, edges: Array, penalty: Penalty, pieces: int
) -> JointPath:
    """Find the most direct path near a given one.

    Args:
        objective: the arm, its joints, and their weight.
        start: configuration to start from, (nq,).
        offsets: waypoints of the given path as displacements from there, (N + 1, nv) [rad or m].
        edges: joint positions to stay between, (2, nv) [rad or m].
        penalty: rows whose errors should vanish at each waypoint between the ends.
        pieces: number of pieces of the path, before it is refined.
    """
    waypoints = _Waypoints(objective, start, edges)
    x = waypoints.space(offsets, pieces)
    found = optimize_with_penalties(objective, start, waypoints.within, x, penalty)
    smooth = waypoints.refine(found, REFINEMENT * pieces)
    return JointPath(objective, start, objective.displacement(smooth))


class _Waypoints:
    """Operations on waypoints as displacements from the start, (N + 1, n), in `Arm.joint_units`.

    Attributes:
        within: smallest and largest displacement, 2 x (n,).
    """

    def __init__(self, objective: Objective, start: Array, edges: Array) -> None:
        arm, chain, self._weight = objective.arm, objective.chain, objective.mu**2
        self._objective = objective
        self._start = arm.positions(start)
        lower, upper = ((edge - self._start)[objective.columns] / objective.units for edge in edges)
        # From a start outside its limits, the waypoints come back along the path.
        self.within = np.minimum(lower, 0.0), np.maximum(upper, 0.0)
        constants = arm.kinematics.constants
        ends = np.searchsorted(chain.joints, arm.kinematics.ends).astype(np.int64)
        self._relax_given = (constants, chain.joints, ends, chain.units, self._start, *self.within)
        self._length_given = (constants, chain.joints, chain.units, self._start)

    def interpolate(self, change: Array, bend: Array, pieces: int) -> Array:
        """Return joint interpolation, bent to one side."""
        shares = np.linspace(0.0, 1.0, pieces + 1)[:, None]
        return self._clip(shares * change + np.sin(np.pi * shares) * bend)

    def refine(self, x: Array, pieces: int) -> Array:
        """Return more waypoints, on a cubic spline, so that joints change speed gradually."""
        if pieces == len(x) - 1:
            return x
        spline = CubicSpline(np.linspace(0.0, 1.0, len(x)), x, bc_type="natural")
        return self._clip(spline(np.linspace(0.0, 1.0, pieces + 1)))

    def space(self, offsets: Array, pieces: int) -> Array:
        """Return waypoints on a path, (N + 1, nv), at equal distances in the metric that is minimised."""
        objective = self._objective
        places = np.concatenate([[0.0], np.cumsum(objective.measure_pieces(self._start, offsets))])
        wanted, x = np.linspace(0.0, places[-1], pieces + 1), offsets[:, objective.columns] / objective.units
        return self._clip(np.column_stack([np.interp(wanted, places, joint) for joint in x.T]))

    def relax(self, change: Array, bend: Array) -> Iterator[Array]:
        """Yield waypoints at a minimum, found with increasing effort."""
        x = self.interpolate(change, bend, COARSE_TO_FINE[0])
        for pieces in COARSE_TO_FINE:
            x = self.refine(x, pieces)
            fall = RELAXED if pieces == COARSE_TO_FINE[-1] else NEARLY_RELAXED
            kernels.relax_waypoints(*self._relax_given, self._weight, MAX_PASSES, fall, x)
            if self.length_ratio(x) > MAX_RATIO:
                break
        else:
            yield x
        x = self.interpolate(change, bend, MANY_PIECES[0])
        for pieces in MANY_PIECES:
            x = self.refine(x, pieces)
            kernels.relax_waypoints(*self._relax_given, self._weight, MAX_PASSES, RELAXED, x)
            yield x

    def length_ratio(self, x: Array) -> float:
        """Return the path length of the control points, relative to straight lines from start to end."""
        path, direct = kernels.measure_path_lengths(*self._length_given, x, LENGTH_SAMPLES)
        return max(path / direct, 1.0) if direct > 1e-12 * path else 1.0

    def _clip(self, x: Array) -> Array:
        return np.ascontiguousarray(np.minimum(np.maximum(x, self.within[0]), self.within[1]))


def _bend(objective: Objective, variant: int) -> Array:
    """Return a bend of the whole arm to one side, (n,); each variant is another one."""
    along = (np.arange(len(objective.columns)) + 0.5) / len(objective.columns)
    size, sign, waves = LARGE_BEND if variant else SMALL_BEND, (-1.0) ** variant, 1 + variant // 2
    return np.asarray(size * sign * np.cos(np.pi * waves * along))


# With penalties: all waypoints move together.


class _Iterate(NamedTuple):
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
    penalties: list[LinearRows]
    energy: float


def optimize_with_penalties(
    objective: Objective, start: Array, within: tuple[Array, Array], x: Array, penalty: Penalty
) -> Array:
    """Return waypoints at a minimum of the energy and the penalties, (N + 1, n), in `Arm.joint_units`.

    Joints at a limit that the descent would push past it are held there.

    Args:
        objective: the arm, its joints, and their weight.
        start: configuration that waypoints are displacements from, (nq,).
        within: smallest and largest displacement, 2 x (n,).
        x: a first guess, (N + 1, n), within them.
        penalty: rows of the penalties.
    """
    search = _GaussNewton(objective, start, within, penalty)
    now, damping = search.evaluate(x), FIRST_DAMPING
    for _ in range(MAX_PATH_ITERATIONS):
        step = search.step(now, damping)
        if step is not None:
            moved = now.x.copy()
            moved[1:-1] = np.minimum(np.maximum(moved[1:-1] + step, within[0]), within[1])
            tried = search.evaluate(moved)
            if tried.energy < now.energy:
                converged = tried.energy > (1.0 - NEWTON_CONVERGED) * now.energy
                now, damping = tried, max(damping / 5.0, MIN_DAMPING)
                if converged:
                    break
                continue
        damping *= 8.0
        if damping > MAX_DAMPING:
            break
    return now.x


class _GaussNewton:
    """Gauss-Newton steps on the waypoints of one path."""

    def __init__(
        self, objective: Objective, start: Array, within: tuple[Array, Array], penalty: Penalty
    ) -> None:
        self._objective, self._start, self._weight, self._penalty = objective, start, objective.mu**2, penalty
        self._lower, self._upper = within

    def evaluate(self, x: Array) -> _Iterate:
        objective = self._objective
        columns, plane = objective.columns, objective.arm.plane
        states = [self._state(each) for each in x]
        points = np.array([(state.points @ plane.T).ravel() for state in states])
        rows = points.shape[1]
        jacobians = np.array([state.task_jacobians.reshape(rows, -1)[:, columns] for state in states])
        energy = float((np.diff(points, axis=0) ** 2).sum() + self._weight * (np.diff(x, axis=0) ** 2).sum())
        penalties = [self._penalty(states[i], i / (len(x) - 1)) for i in range(1, len(x) - 1)]
        energy += sum(float(each.errors @ each.errors) for each in penalties)
        return _Iterate(x, points, jacobians, penalties, energy)

    def _state(self, x: Array) -> ArmState:
        objective = self._objective
        return objective.arm.at(objective.arm.integrate(self._start, objective.displacement(x))).compiled

    def step(self, now: _Iterate, damping: float) -> Array | None:
        """Return the damped step of all waypoints between the ends, (N - 1, n); None if it fails."""
        x, inner = now.x, now.jacobians[1:-1]
        n, transposed = x.shape[1], inner.transpose(0, 2, 1)
        point_changes, joint_changes = np.diff(now.points, axis=0), np.diff(x, axis=0)
        pull = point_changes[:-1] - point_changes[1:]
        gradient = (transposed @ pull[:, :, None])[:, :, 0]
        gradient = gradient + self._weight * (joint_changes[:-1] - joint_changes[1:])
        own = transposed @ inner
        typical = float(np.trace(own.sum(axis=0))) / (n * len(own))
        diagonal = 2.0 * own + (2.0 * self._weight + damping * typical) * np.eye(n)
        above = -(transposed[:-1] @ inner[1:]) - self._weight * np.eye(n)
        for i, rows in enumerate(now.penalties):
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
        found = np.empty_like(gradient)
        return found if kernels.solve_tridiagonal(diagonal, above, -gradient, found) else None
