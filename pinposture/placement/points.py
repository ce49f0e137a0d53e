"""Fit of the control points to given points, exactly or as closely as possible."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pinposture import kernels
from pinposture._validation import float_array, require_instance, require_positive
from pinposture.arm import Arm
from pinposture.arm.kinematics import Kinematics
from pinposture.curve import Curve
from pinposture.errors import PostureError
from pinposture.kernels.arrays import ModuleSearch, PostureProblem, SearchSettings
from pinposture.placement.least_squares import fit_curve
from pinposture.placement.module_kinematics import after_last_mover
from pinposture.placement.target import Target
from pinposture.units import length_text

Array = NDArray[np.float64]
Whole = NDArray[np.int64]


class PointSearchSettings(NamedTuple):
    """Settings of `place_sequentially`; figures are of `docs/design/branch_search.md`."""

    visits_per_module: int = 20
    """Largest number of visits of modules, per module."""

    visits: int = 200
    """Largest number of visits of modules of short arms. Of 40 random postures, 100 and 400 find as many and
    three more, in 0.9 and 1.4 of the time."""

    window: int = 6
    """Number of modules corrected together if a point cannot be reached by its own joints. Of 90 random
    postures of arms of ten modules of three and four joints, 3 finds 86 and 6 all, in a third of the time
    with four joints. Points that cannot be reached take up to a fifth longer."""

    joint_samples: int = 16
    """Number of samples of a joint without a closed form; twice as many for two or more such joints. Of the
    same postures, 8 find one more in 0.6 of the time, 32 two more in 1.6 of it."""

    rough: float = 1e-3
    """Distance that a rough search accepts, in mean module lengths."""

    exact: float = 1e-9
    """Distance that an exact search accepts, in arm lengths."""


POINT_SEARCH = PointSearchSettings()


class PointFitSettings(NamedTuple):
    """Settings of `fit_points`; distances are in arm lengths."""

    regularisation: float = 1e-8
    """Weight of joint positions against distances [1/rad]; it resolves redundancy."""

    taken: float = 1e-6
    """Distance at which a point counts as reached."""

    no_error: float = 1e-9
    """Distance at which no further start is tried."""

    restarts: int = 8
    """Number of perturbed starts."""

    restart_noise: float = 0.3
    """Standard deviation of their perturbations, in `Arm.joint_units`."""


POINT_FIT = PointFitSettings()


POSTURE_SEARCH = SearchSettings(
    good=0.0,
    largest_step=0.5,
    damping_share=0.5,
    least_damping=1e-10,
    least_stiffness=0.0,
    decrease=0.3,
    increase=4.0,
    least_factor=1e-6,
    most_factor=1e9,
    converged=1e-6,
    idle=3,
    steps=300,
)
"""How least squares search for postures that take points; `good` and `least_stiffness` depend on the arm.

Damping falls with the sum of squared errors (Sugihara 2011). `docs/design/branch_search.md` says what other
steps and kinds of damping do.
"""


WEAK_MOTION = 0.3
"""Noise-induced joint motion, in `Arm.joint_units`, at which a measurement gets half its weight. Along
directions in which joints hardly move the points, noise would otherwise cause large joint motions."""

MAX_SURPRISE = 0.5
"""Mean distance of points from their prediction, in mean module lengths, at which a filter is reset."""


def place_sequentially(
    arm: Arm, points: Array, has_target: NDArray[np.bool_], near: Array
) -> tuple[Array, bool]:
    """Find joint positions that put the control points at given points, module by module.

    The end point of a module leaves a few solutions for its joints. A wrong choice becomes apparent at a
    later module, whose point is then out of reach: the search backtracks and tries another solution, those
    nearest to `near` first. If points cannot be reached exactly, a small distance is accepted.

    Args:
        arm: the arm.
        points: a position for every control point, (m, 3) [m], world frame.
        has_target: True for points to reach, (m,).
        near: preferred joint positions, (nv,) [rad or m].

    Returns:
        Joint positions (nv,) [rad or m] within the limits, and whether they reach the points. If not, they
        reach as many points as possible from the base on, and the others as closely as each module can.
    """
    chain, goals = _module_search(arm, points, has_target, near)
    bounded = np.isfinite(chain.lower) & np.isfinite(chain.upper)
    low, high = (np.where(bounded, side, chain.near) for side in (chain.lower, chain.upper))
    center = 0.5 * low + 0.5 * high
    visits = max(POINT_SEARCH.visits_per_module * len(goals), POINT_SEARCH.visits)
    positions = near.copy()
    exact = POINT_SEARCH.exact * arm.length
    rough = POINT_SEARCH.rough * arm.length / len(goals)
    samples = _joint_samples(len(center))
    # Positions far from the limits leave more freedom for later modules.
    for start, accepted, first in (
        (chain.near, exact, 0),
        (center, exact, POINT_SEARCH.joint_samples),
        (chain.near, rough, 0),
    ):
        shuffled = np.roll(samples, first, axis=0)
        solution = start.copy()
        nearby = chain._replace(near=start)
        reached = kernels.search_branches(
            nearby, goals, arm.length, accepted, POINT_SEARCH.window, visits, shuffled, solution
        )
        positions[arm.columns] = solution
        if reached == len(goals):
            return positions, True
    return positions, False


def with_configuration(arm: Arm, target: Target, near: Array | None = None) -> Target:
    """Add a configuration that reaches the target exactly, if `taken_exactly` finds one.

    It stays near the configuration `near`, (nq,), or the straight arm if None.
    """
    if target.q is not None or not np.all(target.has_target):
        return target
    exact = taken_exactly(arm, target.points, arm.positions(arm.straight() if near is None else near))
    return target if exact is None else replace(target, q=arm.configuration(exact))


def taken_exactly(arm: Arm, points: Array, near: Array) -> Array | None:
    """Find joint positions that reach all points without backtracking; takes microseconds.

    Args:
        arm: the arm.
        points: a position for every control point, (m, 3) [m], world frame.
        near: preferred joint positions, (nv,) [rad or m].

    Returns:
        Joint positions (nv,) [rad or m] within the limits; None if none are found, as for measured points, or
        if a module has more than two joints.
    """
    every = np.ones(arm.n_modules, dtype=np.bool_)
    if not points_determine_joints(arm, every):
        return None
    chain, goals = _module_search(arm, points, every, near)
    m = len(goals)
    solution = chain.near.copy()
    samples = _joint_samples(len(chain.near))
    exact = POINT_SEARCH.exact * arm.length
    if kernels.search_branches(chain, goals, arm.length, exact, 1, 2 * m, samples, solution) < m:
        return None
    positions = np.array(near)
    positions[arm.columns] = solution
    return positions


def points_determine_joints(arm: Arm, has_target: NDArray[np.bool_]) -> bool:
    """Whether the points with a target, (m,), leave the joints between them only a few solutions.

    At most two joints then move each point relative to the one before.
    """
    modules = _search_modules(arm.kinematics, tuple(np.flatnonzero(has_target).tolist()))
    return bool(np.diff(modules.begins).max() <= 2)


def _module_search(
    arm: Arm, points: Array, has_target: NDArray[np.bool_], near: Array
) -> tuple[ModuleSearch, Array]:
    """Return the modules as kernels take them, and the points to reach, (p, 3) [m]."""
    chain = arm.chain
    columns = arm.columns
    lower = arm.limits.lower[columns]
    upper = arm.limits.upper[columns]
    indices = np.flatnonzero(has_target)
    modules = _search_modules(arm.kinematics, tuple(indices.tolist()))
    goals = points[indices]
    carried = chain.points[indices]
    if arm.dimension == 2:  # errors normal to the plane cannot be reduced
        goals = carried + (goals - carried) @ arm.plane.T @ arm.plane
    preferred = np.clip(near[columns], lower, upper)
    search = modules._replace(lower=lower, upper=upper, near=preferred)
    return search, np.ascontiguousarray(goals)


@lru_cache(maxsize=64)
def _search_modules(kinematics: Kinematics, indices: tuple[int, ...]) -> ModuleSearch:
    """Divide a chain into modules, each of which ends at the next of some control points; without limits.

    A joint belongs to the first point it can move: joints whose axes pass through a point belong to the next,
    unless they are coupled.
    """
    chain = kinematics.chain
    arrays = kinematics.constants
    starts = [0]
    for k in indices:
        starts.append(after_last_mover(chain, k, starts[-1]))
    levers = arrays.levers[list(indices)]
    for number, (k, stop) in enumerate(zip(indices, starts[1:], strict=True)):
        levers[number] += arrays.joints.offsets[stop : arrays.ends[k]].sum(axis=0)
    n = len(arrays.inputs)
    return ModuleSearch(
        joints=arrays.joints._replace(columns=chain.input_numbers.astype(np.int64)),
        levers=levers,
        starts=np.array(starts, dtype=np.int64),
        begins=np.searchsorted(chain.leaders, starts).astype(np.int64),
        sliding=~chain.revolute[chain.leaders],
        lower=np.full(n, -np.inf),
        upper=np.full(n, np.inf),
        near=np.zeros(n),
    )


@lru_cache(maxsize=64)
def _joint_samples(n: int) -> Array:
    """Return fractions of the range of each joint, (2 S, n): two even grids, shuffled for each joint."""
    rng = np.random.default_rng(0)
    count = POINT_SEARCH.joint_samples
    sets = [(np.arange(count) + middle) / count for middle in (0.25, 0.75)]
    columns = [np.concatenate([rng.permutation(shares) for shares in sets]) for _ in range(n)]
    return np.ascontiguousarray(np.column_stack(columns))


def fit_points(arm: Arm, points: ArrayLike, weights: ArrayLike | None = None) -> Target:
    """Find the configuration that reaches given points, or comes closest to them within the limits.

    Reachable points are placed module by module with a backtracking search, which the default controller also
    uses. Other points, such as measured ones, are fitted by least squares, starting from the result of that
    search, from a fit of the whole arm to a curve through the points, which winds in the right direction, and
    from the straight arm. The result may be a local minimum.

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
    best = _closest_positions(arm, target)
    residual = np.linalg.norm(_gaps(arm, target, best), axis=1)
    farthest = int(np.argmax(np.where(target.has_target, residual, -1.0)))
    approximate = ""
    if residual[farthest] > POINT_FIT.taken * arm.length:
        approximate = (
            f"in the closest posture found, control point {farthest} is {length_text(residual[farthest])} "
            "from its point; it may be a local minimum"
        )
    q = arm.nearest_turns(arm.configuration(best))
    return replace(target, q=q, residual=residual, method="closest", approximate=approximate)


def _closest_positions(arm: Arm, target: Target) -> Array:
    """Return the joint positions (nv,) that come closest to a target, from several starts."""
    straight = arm.positions(arm.straight())
    rng = np.random.default_rng(0)
    noise = np.where(arm.moved > 0.0, POINT_FIT.restart_noise * arm.joint_units, 0.0)
    best = straight
    least = np.inf
    for guess in (*initial_guesses(arm, target, straight), straight, *[None] * POINT_FIT.restarts):
        fitted = _fit(arm, target, best + noise * rng.normal(size=arm.nv) if guess is None else guess)
        gaps = _gaps(arm, target, fitted)
        cost = float(target.weights @ np.einsum("ij,ij->i", gaps, gaps))
        if cost < least:
            best = fitted
            least = cost
        if least <= (POINT_FIT.no_error * arm.length) ** 2:
            break
    return best


def initial_guesses(arm: Arm, target: Target, near: Array) -> Iterator[Array]:
    """Yield joint positions from which to search for the configuration closest to a target.

    Args:
        arm: the arm.
        target: positions of its control points; must fit the arm.
        near: preferred joint positions, (nv,) [rad or m].

    Yields:
        Joint positions (nv,) [rad or m] within the limits, best first; only one if it reaches all points.
    """
    positions, complete = place_sequentially(arm, target.points, target.has_target, near)
    yield positions
    if complete and np.abs(_gaps(arm, target, positions)).max() <= POINT_FIT.no_error * arm.length:
        return
    try:
        curve = Curve.points(np.vstack([arm.chain.base, target.points[target.has_target]]))
        yield fit_curve(arm, curve, 0.0, POINT_FIT.regularisation * arm.length, rough=True)[0]
    except PostureError:  # the points form no curve, for instance because two coincide
        return


def _gaps(arm: Arm, target: Target, positions: Array) -> Array:
    """Return the vectors from the control points to their targets, (m, 3) [m]."""
    return np.asarray(target.points - arm.kinematics.forward(positions).points)


def _fit(arm: Arm, target: Target, start: Array) -> Array:
    """Minimise the squared distances from a start, (nv,), by damped least squares within the limits."""
    columns = arm.columns
    indices = np.flatnonzero(target.has_target)
    lower = arm.limits.lower[columns]
    upper = arm.limits.upper[columns]
    problem = PostureProblem(
        chain=arm.kinematics.constants,
        joints=np.arange(len(columns)),
        units=arm.joint_units[columns],
        position_limits=np.array([lower, upper]),
        indices=indices,
        ends=arm.kinematics.ends[indices],
        targets=target.points[indices],
        weights=target.weights[indices],
        chords=np.zeros(len(indices)),
        normal=np.zeros(3),
    )
    positions = np.array(start)
    positions[columns] = np.clip(start[columns], lower, upper)
    good = 1e-3 * POINT_FIT.no_error * arm.length / len(indices)
    minimise_posture_errors(arm, problem, positions, good)
    positions[columns] = np.clip(positions[columns], lower, upper)
    return positions


def minimise_posture_errors(
    arm: Arm, problem: PostureProblem, positions: Array, good: float, steps: int = POSTURE_SEARCH.steps
) -> tuple[float, float]:
    """Minimise the squared errors of points and chords by damped least squares within limits.

    Args:
        arm: the arm.
        problem: points, chords and limits.
        positions: joint positions to start at, (nv,) [rad or m]; filled with the final ones.
        good: mean error at which the search ends [m].
        steps: largest number of steps.

    Returns:
        The sum of squares [m^2] and the mean error [m] at the end.
    """
    least_stiffness = 1e-12 * arm.length**2
    settings = POSTURE_SEARCH._replace(good=good, least_stiffness=least_stiffness, steps=steps)
    return kernels.minimise_posture_errors(problem, settings, positions)


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
            self._positions = _closest_positions(arm, target)
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
        if np.linalg.norm(errors, axis=1).mean() > MAX_SURPRISE * arm.length / arm.n_modules:
            return False
        jacobian = state.task_jacobians[seen].reshape(-1, arm.nv)[:, columns] * units
        squares, directions = np.linalg.eigh(jacobian.T @ jacobian)
        motions = directions.T @ (jacobian.T @ errors.ravel())
        motions /= np.maximum(squares, 0.0) + (self.noise / WEAK_MOTION) ** 2
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
