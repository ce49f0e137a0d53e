"""Least-squares fit of a whole arm to a curve."""

from __future__ import annotations

from copy import copy
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from pinposture.arm import Arm
from pinposture.curve import Curve
from pinposture.descent import Rating, descend
from pinposture.kernels.arrays import SearchSettings
from pinposture.placement.target import fitting_slides
from pinposture.quadratic_program import solve
from pinposture.units import CONVERGED, ROUNDING

# The squared distances of all control points from their points on the curve are minimised over the joint
# positions and the arc lengths of these points. Least squares alone may wind in the wrong direction, so the
# fit starts with the straight arm on a straight curve and bends both into shape in stages.

Array = NDArray[np.float64]


class CurveFitSettings(NamedTuple):
    """Settings of `fit_curve` and `fit_near`.

    `make study STUDY=curve_fits` varies them to half and twice on 400 fits of 25 arms. Where nothing is said,
    about as many end closer to the curve as farther from it.
    """

    turn_per_stage: float = 2.0
    """Largest turn of the tip of the curve between stages of bending [rad]."""

    samples_per_module: int = 12
    """Samples of the curve per module in all stages but the last, which uses the curve itself."""

    stage_steps: int = 6
    """Number of steps in each stage but the last. With twice, 7 fits end closer and 16 farther."""

    rough_steps: int = 9
    """Number of steps at the final curve for a rough fit."""

    restarts: int = 4
    """Number of new starts of a fit that is not exact. With half, 3 fits end farther, in 0.8 of the time;
    with twice, 2 end closer, in 1.8 times the time."""

    straight_restarts: int = 2
    """Number of further new starts from the straight arm. Without them the roots of 400 fits add up to 8.86
    in place of 7.77, and an arm of 21 unlike modules ends 1.19 times as far off as independent fits."""

    restart_noise: float = 0.3
    """Standard deviation of the perturbations of these starts [rad, or arm lengths]."""

    least_spacing: float = 0.05
    """Smallest arc length between neighbouring control points, in module lengths."""

    most_spacing: float = 3.0
    """Largest such arc length, in module lengths."""

    look_ahead: float = 2.0
    """Range along the curve in which the point nearest to a control point is searched, in module lengths."""

    look_ahead_samples: int = 64
    """Number of samples in this range."""

    still: float = 1e-7
    """Step at which a fit ends [rad, or arm lengths]. Without it, plans through keyframes take three times as
    long, and joint positions differ by less than 1e-9."""


CURVE_FIT = CurveFitSettings()


FIT_STEPS = SearchSettings(
    good=0.0,
    largest_step=0.1,
    damping_share=0.0,
    least_damping=1e-11,
    least_stiffness=1e-300,
    decrease=0.1,
    increase=10.0,
    least_factor=1.0,
    most_factor=1e15,
    converged=1e-15,
    idle=1,
    steps=90,
)
"""Steps of `FitProblem.solve`, varied as the settings of `CurveFitSettings`.

The damping is in proportion to `FitProblem.stiffness` alone. With half of the largest step, 19 fits end
closer and 15 farther, in 1.5 times the time, with twice, 10 and 20; with half as many steps, 2 and 11. With a
factor of 1e11 at most, ten of 368 ended before the minimum, by up to 0.16 arm lengths.
"""


class SlidingFitSettings(NamedTuple):
    """Settings of the fit of an arm with slides; weights are against distances of the control points."""

    tip_weight: float = 0.1
    """Weight of the distance of the tip from the end of the curve."""

    link_weight: float = 1e-2
    """Weight of the distance of the links from the curve."""

    slide_weight: float = 4e-3
    """Weight of differences between slides."""

    end_margin: float = 1e-5
    """Arc length left beyond the tip at the end of a curve, in arm lengths."""

    near: float = 1e-3
    """Root mean square distance from the curve below which a fit needs no new start, in arm lengths."""

    closing_weight: float = 1e-6
    """Weight of changes to the fit while its control points move onto the curve."""

    converged: float = 1e-5
    """Relative decrease of the sum of squares at which a fit ends."""

    slide_steps: int = 17
    """Number of postures in the search for slides that fit a length."""


SLIDING_FIT = SlidingFitSettings()


class Samples:
    """A curve given by samples.

    Attributes:
        s: arc lengths, (n,) [m].
        points: points of the curve, (n, 3) [m].
        tangents: unit tangents, (n, 3).
    """

    def __init__(self, s: Array, points: Array, tangents: Array) -> None:
        self.s = s
        self.points = points
        self.tangents = tangents

    @property
    def length(self) -> float:
        """Arc length of the last sample [m]."""
        return float(self.s[-1])

    def at(self, s: Array) -> Array:
        """Return the points (m, 3) [m] at arc lengths s, (m,)."""
        return np.column_stack([np.interp(s, self.s, axis) for axis in self.points.T])

    def tangent(self, s: Array) -> Array:
        """Return the tangents (m, 3) at arc lengths s, (m,)."""
        return np.column_stack([np.interp(s, self.s, axis) for axis in self.tangents.T])


def fit_curve(
    arm: Arm, curve: Curve, start: float, bending: float, rough: bool = False, to_end: bool = True
) -> tuple[Array, Array]:
    """Fit an arm to a curve in the world, starting from the straight arm.

    Args:
        arm: the arm.
        curve: the curve.
        start: arc length of the curve point for the base of the arm [m].
        bending: weight of joint positions relative to the straight arm, against distances, above 0 [m/rad].
        rough: stop after a few steps, once the arm winds in the right direction.
        to_end: extend slides so that the tip gets to the end of the curve.

    Returns:
        Joint positions, (nv,) [rad or m], and the arc length of each control point, (m,) [m], which may
        exceed the curve's length.
    """
    # Slightly more of the curve than the arm can cover.
    problem = _fit_problem(arm, curve, start, bending, to_end)
    end = min(curve.length, start + 1.2 * problem.reach)
    s = np.linspace(start, end, CURVE_FIT.samples_per_module * arm.n_modules + 1)
    tangents = curve.tangent(s)
    turns = transported_turns(tangents)
    stages = int(np.ceil(float(np.linalg.norm(turns, axis=1).sum()) / CURVE_FIT.turn_per_stage))
    unknowns = problem.straight
    for share in np.arange(stages) / max(stages, 1):
        partial = _bent_curve(s, curve.at(float(start)), tangents[0], share * turns)
        unknowns = problem.solve(partial, unknowns, steps=CURVE_FIT.stage_steps)
    best = problem.solve(curve, unknowns, steps=CURVE_FIT.rough_steps if rough else None)
    # If off the curve, this may be a local minimum: restart, with reproducible perturbations.
    rng = np.random.default_rng(0)
    inexact = not rough and problem.distance(curve, best) > problem.exact
    for k in range(CURVE_FIT.restarts + CURVE_FIT.straight_restarts if inexact else 0):
        begin = best if k < CURVE_FIT.restarts else problem.straight
        other = problem.solve(curve, problem.perturb(begin, rng))
        best = min(best, other, key=lambda x: problem.distance(curve, x))
    return problem.split(best if rough else problem.closed(curve, best))


def fit_near(
    arm: Arm,
    curve: Curve,
    start: float,
    bending: float,
    q: Array,
    parameters: Array | None,
    to_end: bool = True,
) -> tuple[Array, Array]:
    """Fit an arm to a curve as `fit_curve` does, starting from a configuration close to the curve.

    Args:
        arm: as in `fit_curve`.
        curve: as in `fit_curve`.
        start: as in `fit_curve`.
        bending: as in `fit_curve`.
        q: the configuration, (nq,).
        parameters: arc lengths of its control points, (m,) [m]; those of the nearest points if None.
        to_end: as in `fit_curve`.
    """
    problem = _fit_problem(arm, curve, start, bending, to_end)
    if parameters is None:
        parameters = _nearest_parameters(arm, curve, start, q)
    guess = problem.joined(arm.positions(q), parameters)
    guess = np.clip(guess, problem.lower, problem.upper)
    fitted = problem.solve(curve, guess)
    return problem.split(problem.closed(curve, fitted))


def _fit_problem(arm: Arm, curve: Curve, start: float, bending: float, to_end: bool) -> FitProblem:
    if not np.any(fitting_slides(arm)):
        return FitProblem(arm, start, bending, base_positions(arm, curve, start))
    return SlidingFit(arm, start, bending, base_positions(arm, curve, start), curve.length, to_end)


def slid_positions(arm: Arm, length: float) -> Array:
    """Return the joint positions (nv,) of the straight arm whose slides fit it to a length [m].

    All slides retract by the same share of their range. Without slides it is the straight arm.
    """
    extended = arm.positions(arm.straight())
    low, high = arm.usual_positions
    retracted = np.where(fitting_slides(arm), np.clip(low + high - extended, low, high), extended)
    shares = np.linspace(0.0, 1.0, SLIDING_FIT.slide_steps)[:, None]
    postures = (1.0 - shares) * extended + shares * retracted
    ends = [arm.kinematics.forward(posture).points[-1] for posture in postures]
    reaches = np.linalg.norm(arm.chain.flattened(np.array(ends)) - arm.chain.base, axis=1)
    reaches += SLIDING_FIT.end_margin * arm.length
    k = int(np.argmax(reaches <= length))
    if k == 0:
        return np.asarray(postures[0 if reaches[0] <= length else int(np.argmin(reaches))])
    share = (reaches[k - 1] - length) / (reaches[k - 1] - reaches[k])
    return np.asarray((1.0 - share) * postures[k - 1] + share * postures[k])


def _module_lengths(arm: Arm, positions: Array) -> Array:
    """Return the distance of each control point from the previous one at joint positions (nv,), (m,) [m]."""
    points = arm.chain.flattened(arm.kinematics.forward(positions).points)
    return np.asarray(np.linalg.norm(np.diff(points, axis=0, prepend=arm.chain.base[None]), axis=1))


def transported_turns(tangents: Array) -> Array:
    """Return the rotation vectors (n - 1, 3) from each unit tangent (n, 3) to the next [rad].

    They are expressed in a frame that equals the world frame at the first tangent and is
    parallel-transported, so that it does not twist about the curve.
    """
    normals = np.cross(tangents[:-1], tangents[1:])
    sine = np.linalg.norm(normals, axis=1)
    angle = np.arctan2(sine, np.einsum("ij,ij->i", tangents[:-1], tangents[1:]))
    turns = normals * (angle / np.maximum(sine, 1e-300))[:, None]
    frame = np.eye(3)
    transported = np.empty(turns.shape)
    for i, matrix in enumerate(Rotation.from_rotvec(turns).as_matrix()):
        transported[i] = turns[i] @ frame
        frame = matrix @ frame
    return transported


def _bent_curve(s: Array, origin: Array, tangent: Array, turns: Array) -> Samples:
    """Integrate a curve from its origin, first tangent and the turns between samples."""
    tangents = np.empty((len(s), 3))
    tangents[0] = tangent
    frame = np.eye(3)
    for i, matrix in enumerate(Rotation.from_rotvec(turns).as_matrix(), start=1):
        frame = frame @ matrix
        tangents[i] = frame @ tangent
    steps = np.diff(s)[:, None] * (tangents[:-1] + tangents[1:]) / 2.0
    return Samples(s, origin + np.vstack([np.zeros(3), np.cumsum(steps, axis=0)]), tangents)


def base_positions(arm: Arm, curve: Curve, start: float) -> Array:
    """Return the positions of the `Arm.base_slides` that carry the base to its point on the curve, (nv,).

    All other entries are zero.
    """
    positions = np.zeros(arm.nv)
    on_chain = arm.base_slides[arm.columns]
    if np.any(on_chain):
        gap = curve.at(start) - arm.chain.base
        axes = arm.chain.axes[arm.chain.leaders[on_chain]]
        positions[arm.columns[on_chain]] = np.linalg.lstsq(axes.T, gap, rcond=None)[0]
    return np.asarray(np.clip(positions, arm.limits.lower, arm.limits.upper))


def _nearest_parameters(arm: Arm, curve: Curve, start: float, q: Array) -> Array:
    """Return the arc lengths of the points of a curve nearest to the control points at q, (m,) [m].

    Each is searched for only within reach of the previous one, because the curve may pass a second time.
    """
    points = arm.chain.flattened(arm.chain_at(q).points)
    lengths = arm.chain.module_lengths
    reach = CURVE_FIT.look_ahead * np.maximum(lengths, lengths.mean())
    steps = np.arange(1, CURVE_FIT.look_ahead_samples + 1) / CURVE_FIT.look_ahead_samples
    parameters = np.empty(len(points))
    for k, point in enumerate(points):
        ahead = np.minimum(start + reach[k] * steps, curve.length)
        parameters[k] = start = ahead[np.argmin(np.linalg.norm(curve.at(ahead) - point, axis=1))]
    return parameters


class FitProblem:
    """Distances of the control points from their points on a curve, as a function of the unknowns.

    The unknowns are the joint positions (n,) and the arc lengths between neighbouring control points (m,).
    All lengths are in arm lengths. A planar arm is projected onto the plane of its base. Unlimited slides
    that carry the base are fixed.

    Attributes:
        lower: smallest unknowns, (n + m,).
        upper: largest unknowns, (n + m,).
        straight: those of the straight arm on a straight curve, (n + m,).
        columns: tangent space indices of the joints, (n,).
        reach: length of the arm with its slides extended [m].
        exact: distance below which the fit needs no restart, in arm lengths.
        converged: relative decrease of the sum of squares at which the fit ends.
    """

    exact = CONVERGED
    converged = FIT_STEPS.converged

    def __init__(self, arm: Arm, start: float, bending: float, base: Array | None = None) -> None:
        self.reach = arm.length
        self._arm = arm
        self._start = start
        self._bending = bending / arm.length
        movable = arm.limits.upper[arm.columns] - arm.limits.lower[arm.columns] > 0.0
        columns = self.columns = arm.columns[movable & ~arm.base_slides[arm.columns]]
        self._joints = len(columns)
        self._rest = arm.positions(arm.straight())
        if base is not None:
            self._rest = np.where(arm.base_slides, base, self._rest)
        sliding = np.where(arm.slides[columns], arm.length, 1.0)
        self._units = np.concatenate([sliding, np.full(arm.n_modules, arm.length)])
        lengths = arm.chain.module_lengths
        # A module may have zero length, or get longer by sliding.
        longest = CURVE_FIT.most_spacing * np.maximum(lengths, lengths.mean())
        # Solvers scale by the distance to finite bounds and lose accuracy if it is huge.
        unlimited = arm.unlimited[columns]
        lower = np.where(unlimited, -np.inf, arm.limits.lower[columns])
        upper = np.where(unlimited, np.inf, arm.limits.upper[columns])
        self.lower = np.concatenate([lower, CURVE_FIT.least_spacing * lengths]) / self._units
        self.upper = np.concatenate([upper, longest]) / self._units
        straight = np.concatenate([self._rest[columns], lengths]) / self._units
        self.straight = np.clip(straight, self.lower, self.upper)

    @property
    def points(self) -> int:
        """Number of control points, m."""
        return self._arm.n_modules

    def perturb(self, unknowns: Array, rng: np.random.Generator) -> Array:
        """Add normally distributed noise to the joint positions."""
        moved = unknowns.copy()
        moved[: self._joints] += CURVE_FIT.restart_noise * rng.normal(size=self._joints)
        return np.asarray(np.clip(moved, self.lower, self.upper))

    def distance(self, curve: Samples | Curve, unknowns: Array) -> float:
        """Return the root mean square of distances and weighted bending, in arm lengths."""
        residual, _ = self.evaluate(curve, unknowns)
        return float(np.sqrt(residual @ residual / self._arm.n_modules))

    def closed(self, curve: Samples | Curve, unknowns: Array) -> Array:
        """Move the control points of a fit onto the curve, if other residuals hold them off it."""
        return unknowns

    def split(self, unknowns: Array) -> tuple[Array, Array]:
        """Return joint positions (nv,) [rad or m] and arc lengths of the control points (m,) [m]."""
        values = unknowns * self._units
        positions = self._rest.copy()
        positions[self.columns] = values[: self._joints]
        return positions, self._start + np.cumsum(values[self._joints :])

    def joined(self, positions: Array, parameters: Array) -> Array:
        """Return the unknowns of joint positions (nv,) and arc lengths (m,); the inverse of `split`."""
        gaps = np.diff(parameters, prepend=self._start)
        return np.asarray(np.concatenate([positions[self.columns], gaps]) / self._units)

    def with_slides(self, positions: Array) -> FitProblem:
        """Return the same problem with the slides at given positions, those of (nv,) [m]."""
        arm = self._arm
        n = self._joints
        if not np.any(arm.slides):
            return self
        held = copy(self)
        fixed = np.flatnonzero(arm.slides[self.columns])
        held._rest = np.where(arm.slides, positions, self._rest)
        lengths = _module_lengths(arm, np.where(arm.base_slides, 0.0, held._rest)) / arm.length
        held.lower = self.lower.copy()
        held.upper = self.upper.copy()
        held.lower[fixed] = held.upper[fixed] = positions[self.columns[fixed]] / self._units[fixed]
        held.lower[n:] = np.minimum(self.lower[n:], CURVE_FIT.least_spacing * lengths)
        longest = CURVE_FIT.most_spacing * np.maximum(lengths, lengths.mean())
        held.upper[n:] = np.maximum(self.upper[n:], longest)
        return held

    def solve(
        self,
        curve: Samples | Curve,
        guess: Array,
        steps: int | None = None,
        *,
        before: Array | None = None,
        weight: float = 0.0,
        reach: float = np.inf,
    ) -> Array:
        """Find the minimum near an initial guess, by Levenberg-Marquardt steps within the bounds.

        Args:
            curve: the curve.
            guess: initial unknowns, (n + m,).
            steps: largest number of steps; `FIT_STEPS.steps` if None.
            before: unknowns to stay near, (n + m,); the guess if None.
            weight: weight of the squared distance from `before`.
            reach: largest deviation of joints from `before` [rad, or arm lengths].
        """
        anchor = guess if before is None else before
        margin = np.full(len(guess), np.inf)
        margin[: self._joints] = reach
        lower = np.maximum(self.lower, anchor - margin)
        upper = np.minimum(self.upper, anchor + margin)
        near = _FitNear(self, curve, anchor, weight, lower, upper)
        settings = FIT_STEPS._replace(converged=self.converged)
        most = FIT_STEPS.steps if steps is None else steps
        return descend(near, near.evaluated(np.clip(guess, lower, upper)), most, settings)[0].unknowns

    def stiffness(self, hessian: Array) -> float:
        """Return the mean of the diagonal entries of J^T J, (n + m, n + m), that belong to joints."""
        return max(float(np.diag(hessian)[: self._joints].mean()), FIT_STEPS.least_stiffness)

    def evaluate(self, curve: Samples | Curve, unknowns: Array) -> tuple[Array, Array]:
        """Return the residuals (3 m + n,) and their Jacobian (3 m + n, n + m)."""
        arm = self._arm
        n = self._joints
        m = self._arm.n_modules
        positions, s = self.split(unknowns)
        state = arm.chain_at(arm.configuration(positions))
        inside = np.clip(s, 0.0, curve.length)
        tangents = curve.tangent(inside)
        goals = curve.at(inside) + (s - inside)[:, None] * tangents  # continue straight beyond the end
        jacobian = np.zeros((3 * m + n, n + m))
        rows = jacobian[: 3 * m].reshape(m, 3, n + m)
        rows[:, :, :n] = state.jacobians[:, :, self.columns]
        rows[:, :, n:] = -np.tril(np.ones((m, m)))[:, None, :] * tangents[:, :, None]
        jacobian[: 3 * m] *= self._units / arm.length
        jacobian[3 * m :, :n] = self._bending * np.eye(n)
        distances = (arm.chain.flattened(state.points) - goals).ravel() / arm.length
        bends = self._bending * (unknowns[:n] - self.straight[:n])
        return np.concatenate([distances, bends]), jacobian


class _EvaluatedFit(NamedTuple):
    """Unknowns (n + m,), what `FitProblem.evaluate` returns for them, and how far the last step went."""

    unknowns: Array
    residual: Array
    jacobian: Array
    change: float = np.inf


class _FitNear(NamedTuple):
    """The problem that `FitProblem.solve` hands to `descend`: a fit that stays near some unknowns."""

    fit: FitProblem
    curve: Samples | Curve
    anchor: Array
    weight: float
    lower: Array
    upper: Array

    def evaluated(self, unknowns: Array) -> _EvaluatedFit:
        return _EvaluatedFit(unknowns, *self.fit.evaluate(self.curve, unknowns))

    def rate(self, state: _EvaluatedFit) -> Rating:
        off = state.unknowns - self.anchor
        return Rating(0.0, 0.5 * float(state.residual @ state.residual + self.weight * (off @ off)))

    def is_solved(self, state: _EvaluatedFit, rating: Rating) -> bool:
        return state.change <= CURVE_FIT.still

    def step(self, state: _EvaluatedFit, damping: float) -> _EvaluatedFit | None:
        x, residual, jacobian, _ = state
        gradient = jacobian.T @ residual + self.weight * (x - self.anchor)
        hessian = jacobian.T @ jacobian
        least = FIT_STEPS.least_damping * self.fit.stiffness(hessian)
        hessian[np.diag_indices(len(x))] += self.weight + damping * least
        lower = np.maximum(self.lower - x, -FIT_STEPS.largest_step)
        upper = np.minimum(self.upper - x, FIT_STEPS.largest_step)
        step = solve(hessian, gradient, lower, upper).x
        if step is None:
            return None
        trial = np.clip(x + step, self.lower, self.upper)
        return self.evaluated(trial)._replace(change=float(np.abs(trial - x).max()))


class SlidingFit(FitProblem):
    """The fit of an arm with slides. The lower rows count only as far as the upper ones leave a choice.

    1. Distances of the control points, as in `FitProblem`.
    2. Distance of the tip from the end of the curve, or from where the extended arm would end on it.
    3. Distances of the links from the curve, at joints and midpoints.
    4. Differences of the slides from those of the straight arm that is as long as the curve.
    """

    exact = SLIDING_FIT.near
    converged = SLIDING_FIT.converged

    def __init__(
        self, arm: Arm, start: float, bending: float, base: Array, length: float, to_end: bool
    ) -> None:
        super().__init__(arm, start, bending, base)
        chain = arm.chain
        n = self._joints
        extended = arm.positions(arm.straight())
        slid = slid_positions(arm, to_end * (length - start))
        longest = _module_lengths(arm, extended)
        lengths = _module_lengths(arm, slid)
        self.reach = float(longest.sum())
        longest = CURVE_FIT.most_spacing * np.maximum(longest, longest.mean()) / arm.length
        self.upper[n:] = np.maximum(self.upper[n:], longest)
        self.lower[n:] = np.minimum(self.lower[n:], CURVE_FIT.least_spacing * lengths / arm.length)
        self.straight = np.clip(self.joined(slid, start + np.cumsum(lengths)), self.lower, self.upper)
        self._only_points = False
        self._tip_weight = SLIDING_FIT.tip_weight * to_end
        self._end = min(length - SLIDING_FIT.end_margin * arm.length, start + self.reach)
        self._sliding = np.flatnonzero(arm.slides[self.columns])
        # Stations are the base, the joints and the control points along the arm; each is moved by the joints
        # before it.
        ends = np.array([joints.stop for joints in chain.module_slices])
        joints = np.arange(len(chain.columns))
        self._points = ends + np.arange(1, len(ends) + 1)
        self._origins = joints + 1 + np.searchsorted(ends, joints, side="right")
        before = np.empty(len(joints) + len(ends) + 1, dtype=np.int64)
        before[0] = 0
        before[self._points] = ends
        before[self._origins] = joints
        self._carried = joints < before[:, None]
        self._ratios = (chain.columns[:, None] == self.columns) * chain.ratios[:, None]
        links = np.linalg.norm(np.diff(self._stations(extended)[0], axis=0), axis=1)
        long = links > ROUNDING * arm.length
        count = int(arm.base_slides.sum())  # links begin after them, see `ArmState.links`
        self._first = count + bool(count)
        long[: self._first] = False
        self._sampled = np.concatenate([long, long])
        self._sampled[len(long) + self._points - 1] = False  # they are in the rows of `FitProblem`

    def distance(self, curve: Samples | Curve, unknowns: Array) -> float:
        """Return the root mean square distance of the control points from the curve, in arm lengths."""
        residual = self.evaluate(curve, unknowns)[0][: 3 * self.points]
        return float(np.sqrt(residual @ residual / self.points))

    def closed(self, curve: Samples | Curve, unknowns: Array) -> Array:
        """Move the control points of a fit onto the curve, if other residuals hold them off it."""
        tip = self.split(unknowns)[1][-1]
        length = self._arm.length
        if self._bending > CONVERGED or tip > curve.length + SLIDING_FIT.near * length:  # it cannot
            return unknowns
        points = copy(self)
        points._only_points = True
        points._tip_weight = 1.0
        points._end = min(tip, curve.length - SLIDING_FIT.end_margin * length)
        return points.solve(curve, unknowns, weight=SLIDING_FIT.closing_weight)

    def evaluate(self, curve: Samples | Curve, unknowns: Array) -> tuple[Array, Array]:
        """Return the residuals and their Jacobian as `FitProblem.evaluate`, and the additional rows."""
        residual, jacobian = super().evaluate(curve, unknowns)
        n = self._joints
        m = self.points
        sliding = self._sliding
        residual[3 * m + sliding] = 0.0
        jacobian[3 * m + sliding] = 0.0
        tip = self._tip_weight * (self.split(unknowns)[1][-1:] - self._end) / self._arm.length
        row = self._tip_weight * np.repeat([0.0, 1.0], [n, m])
        if self._only_points:
            return np.append(residual, tip), np.vstack([jacobian, row])
        gaps, rows = self._link_rows(curve, unknowns)
        weight = SLIDING_FIT.link_weight * np.sqrt(3 * m / len(rows)) / self._arm.length
        links = np.zeros((len(rows), n + m))
        slides = SLIDING_FIT.slide_weight * np.eye(n + m)[sliding]
        links[:, :n] = weight * self._units[:n] * rows
        shifts = slides @ (unknowns - self.straight)
        residual = np.concatenate([residual, tip, weight * gaps, shifts])
        return residual, np.vstack([jacobian, row, links, slides])

    def _stations(self, positions: Array) -> tuple[Array, Array]:
        """Return the base, joints and control points along the arm, (k, 3) [m], and their Jacobians."""
        chain = self._arm.chain
        forward = self._arm.kinematics.forward(positions)
        stations = np.empty((len(self._carried), 3))
        stations[0] = chain.base
        stations[self._points] = forward.points
        stations[self._origins] = forward.origins
        levers = np.cross(forward.axes, stations[:, None] - forward.origins)
        moved = np.where(chain.revolute[:, None], levers, forward.axes) * self._carried[:, :, None]
        return chain.flattened(stations), moved.transpose(0, 2, 1) @ self._ratios

    def _link_rows(self, curve: Samples | Curve, unknowns: Array) -> tuple[Array, Array]:
        """Return the vectors from the curve to points of the links (3 k,) [m] and their Jacobian (3 k, n)."""
        positions, s = self.split(unknowns)
        stations, jacobians = self._stations(positions)
        steps = np.linalg.norm(np.diff(stations, axis=0), axis=1)
        steps[: self._first] = 0.0
        along = np.append(0.0, np.cumsum(steps))
        points, jacobians, at = (
            np.concatenate([(part[1:] + part[:-1]) / 2.0, part[1:]])[self._sampled]
            for part in (stations, jacobians, along)
        )
        parameters = np.interp(at, np.append(0.0, along[self._points]), np.append(self._start, s))
        parameters = np.clip(parameters, 0.0, curve.length)
        ahead = np.einsum("ij,ij->i", points - curve.at(parameters), curve.tangent(parameters))
        parameters = np.clip(parameters + ahead, 0.0, curve.length)
        gaps = points - curve.at(parameters)
        tangents = curve.tangent(parameters)
        across = np.eye(3) - tangents[:, :, None] * tangents[:, None, :]
        return np.einsum("pij,pj->pi", across, gaps).ravel(), (across @ jacobians).reshape(-1, self._joints)
