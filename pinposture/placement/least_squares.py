"""The least-squares fit of a whole arm to a curve."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from pinposture.arm import Arm
from pinposture.curve import Curve
from pinposture.placement.target import Target

# Placing all modules at once: the least-squares fit of an arm to a curve.
#
# Unknown are the joint positions and the arc length at which each control point belongs; the distances
# between them are minimised together, within the joint limits, with arc lengths that increase. Least squares
# alone would not know which way round to turn: the fit therefore begins with the straight arm on a straight
# curve, and bends both together into the shape.

Array = NDArray[np.float64]

TURN = 2.0
"""How far the tip of the curve may turn from one stage of bending to the next [rad]."""

RETRIES, NUDGE, EXACT = 4, 0.3, 1e-6
"""How often another optimum is looked for, how far away [rad], and from what distance of the control points
from the curve on (root mean square, in arm lengths)."""

ROUGH = 6
"""Evaluations at the curve itself where a rough fit will do."""

SAMPLES_PER_MODULE = 12
"""How finely the curve is sampled on the way; the last stage uses the curve itself."""

SHORTEST, LONGEST = 0.05, 3.0
"""Bounds of the arc length between neighbouring control points, relative to the module's length."""


class Fit(NamedTuple):
    """An arm fitted to a curve.

    Attributes:
        positions: joint positions, (nv,) [rad or m].
        parameters: arc length of each control point, (m,) [m]; beyond the curve's length where it ends early.
    """

    positions: Array
    parameters: Array


class Samples:
    """A curve as samples, for the stages on the way.

    Attributes:
        s: arc lengths, (n,) [m].
        points: places, (n, 3) [m].
        tangents: unit tangents, (n, 3).
    """

    def __init__(self, s: Array, points: Array, tangents: Array) -> None:
        self.s, self.points, self.tangents = s, points, tangents

    @property
    def length(self) -> float:
        """Where the samples end [m]."""
        return float(self.s[-1])

    def at(self, s: Array) -> Array:
        """Places (m, 3) [m] at the arc lengths s, (m,)."""
        return np.column_stack([np.interp(s, self.s, axis) for axis in self.points.T])

    def tangent(self, s: Array) -> Array:
        """Tangents (m, 3) at the arc lengths s, (m,)."""
        return np.column_stack([np.interp(s, self.s, axis) for axis in self.tangents.T])


def fit_curve(arm: Arm, curve: Curve, start: float, bending: float, rough: bool = False) -> Fit:
    """Fit an arm to a curve in the world.

    Args:
        arm: the arm.
        curve: the curve, placed.
        start: arc length at which the base of the arm belongs [m].
        bending: weight of the joint positions, counted from the straight arm, against the distances, above
            0 [m/rad].
        rough: whether a fit will do that goes the way round but is not the best there is.
    """
    # As much of the curve as the arm can cover, and a little more.
    end = min(curve.length, start + 1.2 * arm.length)
    s = np.linspace(start, end, SAMPLES_PER_MODULE * arm.n_modules + 1)
    tangents = curve.tangent(s)
    turns = carried_turns(tangents)
    stages = int(np.ceil(float(np.linalg.norm(turns, axis=1).sum()) / TURN))
    problem = FitProblem(arm, start, bending, driven_base(arm, curve, start))
    unknowns = problem.first_guess()
    for share in np.arange(stages) / max(stages, 1):
        bent = _bent(s, curve.at(float(start)), tangents[0], share * turns)
        unknowns = problem.solve(bent, unknowns, evaluations=4)
    best = problem.solve(curve, unknowns, evaluations=ROUGH if rough else 60)
    # Off the curve it may be a local optimum: look around, always at the same places.
    rng = np.random.default_rng(0)
    for _ in range(RETRIES if not rough and problem.distance(curve, best) > EXACT else 0):
        other = problem.solve(curve, problem.nudged(best, rng), evaluations=60)
        best = min(best, other, key=lambda x: problem.distance(curve, x))
    return Fit(*problem.split(best))


def free_columns(arm: Arm) -> NDArray[np.intp]:
    """Tangent space indices of the joints of the chain that have room to move, from base to tip."""
    room = arm.limits.upper - arm.limits.lower
    return np.asarray(arm.columns[room[arm.columns] > 0.0])


def bounds_of(arm: Arm, columns: NDArray[np.intp]) -> tuple[Array, Array]:
    """Smallest and largest positions of joints, (n,) each [rad or m], infinite where limits are no real ones.

    Solvers scale by the distance to bounds that are finite, and see nothing of a metre in a million.
    """
    unlimited = arm.unlimited[columns]
    lower, upper = arm.limits.lower[columns], arm.limits.upper[columns]
    return np.where(unlimited, -np.inf, lower), np.where(unlimited, np.inf, upper)


def driven_base(arm: Arm, curve: Curve, start: float) -> Array:
    """Where the slides on which the base stands take it nearest to its place on a curve, (nv,) [m].

    Those without real limits (`Arm.roaming`) do; other entries are zero. So is all of it where the curve has
    been laid at the base: it stays where it is unless it has to go.

    Args:
        arm: the arm.
        curve: the curve, placed.
        start: arc length at which the base belongs [m].
    """
    positions, on_chain = np.zeros(arm.nv), arm.roaming[arm.columns]
    if np.any(on_chain):
        gap = curve.at(start) - arm.chain.base
        positions[arm.columns[on_chain]] = np.linalg.lstsq(arm.chain.axes[on_chain].T, gap, rcond=None)[0]
    return np.asarray(np.clip(positions, arm.limits.lower, arm.limits.upper))


def carried_turns(tangents: Array) -> Array:
    """Rotation vectors (n - 1, 3) from each tangent to the next, in a frame carried along the curve.

    The frame does not twist about the curve (parallel transport); it is the world's at the first tangent.

    Args:
        tangents: unit tangents, (n, 3).
    """
    across = np.cross(tangents[:-1], tangents[1:])
    sine = np.linalg.norm(across, axis=1)
    angle = np.arctan2(sine, np.einsum("ij,ij->i", tangents[:-1], tangents[1:]))
    turns = across * (angle / np.maximum(sine, 1e-300))[:, None]
    frame, carried = np.eye(3), np.empty(turns.shape)
    for i, matrix in enumerate(Rotation.from_rotvec(turns).as_matrix()):
        carried[i] = turns[i] @ frame
        frame = matrix @ frame
    return carried


def _bent(s: Array, origin: Array, tangent: Array, turns: Array) -> Samples:
    """The curve from `origin` that sets out along `tangent` and turns by `turns` from sample to sample."""
    tangents = np.empty((len(s), 3))
    tangents[0], frame = tangent, np.eye(3)
    for i, matrix in enumerate(Rotation.from_rotvec(turns).as_matrix(), start=1):
        frame = frame @ matrix
        tangents[i] = frame @ tangent
    steps = np.diff(s)[:, None] * (tangents[:-1] + tangents[1:]) / 2.0
    return Samples(s, origin + np.vstack([np.zeros(3), np.cumsum(steps, axis=0)]), tangents)


class FitProblem:
    """Distances of the control points from their places, as a function of joint positions and arc lengths.

    The unknowns are the positions of the joints (n,) and the arc lengths between neighbouring control points
    (m,). Inside, every length is in arm lengths, so that arms of any size are alike. A planar arm is seen in
    the plane of its base, in which a curve can be, wherever beside it its links and its tip lie. Slides
    without real limits on which the base stands are held where they are.

    Attributes:
        lower: smallest unknowns, (n + m,).
        upper: largest unknowns, (n + m,).
        columns: tangent space indices of the joints, (n,).
    """

    def __init__(self, arm: Arm, start: float, bending: float, base: Array | None = None) -> None:
        self._arm, self._start, self._bending = arm, start, bending / arm.length
        columns = free_columns(arm)
        self.columns = columns[~arm.roaming[columns]]
        self._joints = len(self.columns)
        self._rest = arm.positions(arm.straight())
        if base is not None:
            self._rest = np.where(arm.roaming, base, self._rest)
        sliding = np.where(arm.slides[self.columns], arm.length, 1.0)
        self._units = np.concatenate([sliding, np.full(arm.n_modules, arm.length)])
        lengths = arm.chain.module_lengths
        # A module may have no length of its own, or gain some by sliding.
        longest = LONGEST * np.maximum(lengths, lengths.mean())
        lower, upper = bounds_of(arm, self.columns)
        self.lower = np.concatenate([lower, SHORTEST * lengths]) / self._units
        self.upper = np.concatenate([upper, longest]) / self._units
        straight = np.concatenate([self._rest[self.columns], lengths]) / self._units
        self._straight = np.clip(straight, self.lower, self.upper)

    @property
    def points(self) -> int:
        """Number of control points, m."""
        return self._arm.n_modules

    def first_guess(self) -> Array:
        """The straight arm on a straight curve, in units of our own."""
        return np.asarray(self._straight)

    def nudged(self, unknowns: Array, rng: np.random.Generator) -> Array:
        """The same, with the joints moved a little at random."""
        moved = unknowns.copy()
        moved[: self._joints] += NUDGE * rng.normal(size=self._joints)
        return np.asarray(np.clip(moved, self.lower, self.upper))

    def distance(self, curve: Samples | Curve, unknowns: Array) -> float:
        """Root mean square distance from the places on the curve, bending counted in, in arm lengths."""
        residual, _ = self.evaluate(curve, unknowns)
        return float(np.sqrt(residual @ residual / self._arm.n_modules))

    def split(self, unknowns: Array) -> tuple[Array, Array]:
        """Joint positions (nv,) [rad or m] and arc lengths of the control points (m,) [m]."""
        values = unknowns * self._units
        positions = self._rest.copy()
        positions[self.columns] = values[: self._joints]
        return positions, self._start + np.cumsum(values[self._joints :])

    def joined(self, positions: Array, parameters: Array) -> Array:
        """The unknowns of joint positions (nv,) and arc lengths of control points (m,); undoes `split`."""
        gaps = np.diff(parameters, prepend=self._start)
        return np.asarray(np.concatenate([positions[self.columns], gaps]) / self._units)

    def solve(self, curve: Samples | Curve, guess: Array, evaluations: int) -> Array:
        """Minimise from a guess, at most so many evaluations."""
        last: dict[bytes, tuple[Array, Array]] = {}

        def once(unknowns: Array) -> tuple[Array, Array]:
            # The solver asks for the residual and the Jacobian of the same place one after the other.
            key = unknowns.tobytes()
            if key not in last:
                last.clear()
                last[key] = self.evaluate(curve, unknowns)
            return last[key]

        solution = least_squares(
            lambda x: once(x)[0],
            guess,
            jac=lambda x: once(x)[1],
            bounds=(self.lower, self.upper),
            ftol=1e-15,
            xtol=1e-12,
            gtol=1e-15,
            max_nfev=evaluations,
        )
        return np.asarray(np.clip(solution.x, self.lower, self.upper))

    def evaluate(self, curve: Samples | Curve, unknowns: Array) -> tuple[Array, Array]:
        """Residuals (3 m + n,) and their Jacobian (3 m + n, n + m)."""
        arm, n, m = self._arm, self._joints, self._arm.n_modules
        positions, s = self.split(unknowns)
        state = arm.at(arm.configuration(positions)).compiled
        inside = np.clip(s, 0.0, curve.length)
        tangents = curve.tangent(inside)
        places = curve.at(inside) + (s - inside)[:, None] * tangents  # straight on beyond the end
        jacobian = np.zeros((3 * m + n, n + m))
        rows = jacobian[: 3 * m].reshape(m, 3, n + m)
        rows[:, :, :n] = state.jacobians[:, :, self.columns]
        rows[:, :, n:] = -np.tril(np.ones((m, m)))[:, None, :] * tangents[:, :, None]
        jacobian[: 3 * m] *= self._units / arm.length
        jacobian[3 * m :, :n] = self._bending * np.eye(n)
        distances = (arm.chain.flattened(state.points) - places).ravel() / arm.length
        bends = self._bending * (unknowns[:n] - self._straight[:n])
        return np.concatenate([distances, bends]), jacobian


# Least squares of the whole arm on a curve from a guess that is near: quick, and true to it.

ROUNDS, CONVERGED, ROUNDING = 12, 1e-7, 1e-24
"""The most steps of a fit, the step after which the next would not matter [rad], and squares that are 0."""

LEAST, EASIER, HARDER = 1e-11, 0.1, 10.0
"""Smallest damping of a fit, relative to the mean diagonal of its matrix, and how it changes."""

AHEAD, LOOKED_AT = 2.0, 64
"""How far ahead of one control point the next is looked for on a curve, in module lengths, and in how many
places."""

STRIDE = 0.2
"""The largest step of a fit [rad, or arm lengths]: it is to stay with the optimum that it followed."""


def fit_near(arm: Arm, curve: Curve, start: float, bending: float, near: Target) -> Fit:
    """Fit an arm to a curve as `fit_curve` does, from a target on a curve that differs a little.

    Args:
        arm: the arm.
        curve: the curve, placed.
        start: arc length at which the base of the arm belongs [m].
        bending: as for `fit_curve`.
        near: the target, with its configuration; where it has no arc lengths of its control points, they are
            looked for on the curve.
    """
    assert near.q is not None  # the caller has seen to it
    problem = FitProblem(arm, start, bending, driven_base(arm, curve, start))
    parameters = _along(arm, curve, start, near.q) if near.parameters is None else near.parameters
    guess = problem.joined(arm.positions(near.q), parameters)
    return Fit(*problem.split(refined(problem, curve, np.clip(guess, problem.lower, problem.upper))))


def _along(arm: Arm, curve: Curve, start: float, q: Array) -> Array:
    """Arc lengths of the places on a curve nearest to the control points at q, in order, (m,) [m].

    Each is looked for as far from the one before as a module reaches: a curve may come by a second time.
    """
    points, lengths = arm.chain.flattened(arm.at(q).compiled.points), arm.chain.module_lengths
    reach = AHEAD * np.maximum(lengths, lengths.mean())
    steps = np.arange(1, LOOKED_AT + 1) / LOOKED_AT
    found = np.empty(len(points))
    for k, point in enumerate(points):
        ahead = start + reach[k] * steps
        found[k] = start = ahead[np.argmin(np.linalg.norm(curve.at(ahead) - point, axis=1))]
    return found


def refined(
    problem: FitProblem,
    curve: Samples | Curve,
    guess: Array,
    before: Array | None = None,
    weight: float = 0.0,
    reach: float = np.inf,
) -> Array:
    """The unknowns at the optimum near a guess: Levenberg and Marquardt's method within the limits.

    Args:
        problem: what to minimise.
        curve: the curve.
        guess: where to begin, (n + m,).
        before: unknowns to stay near, (n + m,).
        weight: what squared distances from those cost.
        reach: how far from them joints may be at most [rad, or arm lengths].
    """
    anchor, far = guess if before is None else before, np.full(len(guess), np.inf)
    far[: len(problem.columns)] = reach
    lower = np.maximum(problem.lower, anchor - far)
    upper = np.minimum(problem.upper, anchor + far)
    x = np.clip(guess, lower, upper)
    damping, largest = LEAST, STRIDE
    residual, jacobian = problem.evaluate(curve, x)
    cost = float(residual @ residual + weight * ((x - anchor) @ (x - anchor)))
    for _ in range(ROUNDS):
        gradient = jacobian.T @ residual + weight * (x - anchor)
        hessian = jacobian.T @ jacobian
        hessian[np.diag_indices(len(x))] += weight + damping * stiffness(problem, hessian)
        free = ~(((x <= lower) & (gradient > 0.0)) | ((x >= upper) & (gradient < 0.0)))
        which = np.flatnonzero(free)
        step = np.zeros(len(x))
        step[which] = np.linalg.solve(hessian[np.ix_(which, which)], -gradient[which])
        step *= min(1.0, STRIDE / max(float(np.abs(step).max()), 1e-300))
        tried = np.clip(x + step, lower, upper)
        there = problem.evaluate(curve, tried)
        found = float(there[0] @ there[0] + weight * ((tried - anchor) @ (tried - anchor)))
        if found <= cost:
            largest = float(np.abs(tried - x).max())
            x, cost, (residual, jacobian) = tried, found, there
            damping = max(damping * EASIER, LEAST)
        else:
            damping *= HARDER
            largest = STRIDE if damping < 1.0 else 0.0
        if largest <= CONVERGED or cost <= ROUNDING:
            break
    return np.asarray(x)


def stiffness(problem: FitProblem, hessian: Array) -> float:
    """Mean diagonal of a matrix (n + m, n + m) of squares that belongs to the joints."""
    return max(float(np.diag(hessian)[: len(problem.columns)].mean()), 1e-300)
