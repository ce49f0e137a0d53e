"""The path along which the control points travel least: a geodesic in joint space.

On a straight line in joint space the control points sweep wide. A path of waypoints x_0 ... x_N with control
points P(x_i) instead minimises

    sum over i of |P(x_{i+1}) - P(x_i)|^2 + mu^2 |x_{i+1} - x_i|^2,

the energy of the motion in the metric J^T J + mu^2 I. The minimum is a geodesic at constant speed. The first
term straightens the paths of the points, the second limits joint motion; mu balances the two. Both ends are
fixed. The initial guess is joint interpolation, so that joints turn in the direction that the goal
configuration implies. Waypoints stay within the position limits.

Without penalties, waypoints are relaxed one by one, from coarse to fine. With penalties, for obstacles or
tasks, all waypoints move together in damped Gauss-Newton steps. Both take time linear in the number of joints
(`kernels.path_relaxation`). A clear path stays clear, also between waypoints.
"""

from __future__ import annotations

from collections.abc import Callable
from math import inf
from time import perf_counter
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pinposture import kernels
from pinposture.arm import ChainState
from pinposture.collision.model import MOTION_TOLERANCE
from pinposture.control.planner.avoidance import Avoidance
from pinposture.control.planner.objective import LinearRows, Objective
from pinposture.control.planner.path import PATH, JointPath
from pinposture.kernels.arrays import Contacts, PathContacts, PathProblem, PathRows

Array = NDArray[np.float64]

RowsAlongPath = Callable[[ChainState, float], LinearRows]
"""Returns rows whose squares are added to the energy, for a state and its position on the path in [0, 1]."""


class Penalties(NamedTuple):
    """Terms that are added to the energy of a path.

    Attributes:
        tasks: rows of tasks, whose errors should vanish at each waypoint; None: none.
        avoidance: the obstacles to avoid; None: none.
        clearance_root: root of the weight of missing clearance, relative to the motion of points; of given
            paths in 64 pieces, and in proportion to the length of a piece.
        least: the distance that a clear path keeps [m].
        until: time of `perf_counter` at which the relaxation ends.
    """

    tasks: RowsAlongPath | None = None
    avoidance: Avoidance | None = None
    clearance_root: float = 0.0
    least: float = 0.0
    until: float = inf

    def for_pieces(self, pieces: int) -> Penalties:
        """Return the terms of a given path in so many pieces: motion costs more in longer ones."""
        return self._replace(clearance_root=self.clearance_root * AMONG_OBSTACLES.pieces_of_given[1] / pieces)


class Stage(NamedTuple):
    """A stage of the relaxation of a path.

    Attributes:
        pieces: number of straight pieces, as a multiple of the initial number.
        joint_share: smallest weight of joint motion, relative to the mean stiffness of the straight arm.
        passes: largest number of passes over all waypoints.
        good_ratio: path length ratio of the control points at which the relaxation ends; 0: not measured.
        again: whether to restart from the initial guess.
    """

    pieces: int
    joint_share: float
    passes: int
    good_ratio: float
    again: bool = False


STAGES = (
    Stage(1, 5e-2, 3, 0.0),
    Stage(1, 2e-3, 7, 0.0),
    Stage(2, 3e-4, 6, 1.045),
    Stage(2, 3e-5, 5, 1.05),
    Stage(4, 2e-4, 6, 1.05),
    Stage(4, 3e-5, 5, 1.05),
    Stage(4, 0.0, 5, 1.1),
    Stage(4, 0.0, 60, 1.1, again=True),
    Stage(8, 0.0, 40, 1.1),
    Stage(16, 0.0, 20, 1.0),
)
"""From few pieces and a large weight of joint motion, which converge quickly, to many pieces and a small
weight. A small weight with few pieces would allow long joint motions between waypoints. If the path is still
long, as for arms that fold onto themselves, the relaxation restarts with many pieces and the small weight."""


class StageSettings(NamedTuple):
    """The pieces of a path, and the stages in which it is relaxed in free space."""

    first_pieces: int = 5
    """Initial number of pieces."""

    first_pieces_of_long: int = 6
    """That for a long arm."""

    long_arm: int = 30
    """Number of modules from which an arm is long."""

    least_decrease: float = 1e-4
    """Relative decrease of the energy in one pass at which a stage ends."""

    kept_ratio: float = 1.01
    """Path length ratio up to which joint interpolation is kept."""

    refinement: int = 4
    """Number of pieces into which each is divided at the end, on a spline."""

    least_pieces: int = 96
    """Smallest number of pieces after that."""

    small_bend: float = 0.05
    """Sideways bend of the initial guess, relative to the largest joint motion, which breaks
    symmetries."""

    large_bend: float = 0.4
    """That bend of the variants."""


STAGING = StageSettings()


class ObstacleRelaxationSettings(NamedTuple):
    """How a path is relaxed where clearances or tasks count."""

    pieces: int = 48
    """Number of pieces of a path with penalties, from a guess or relaxed in fewer."""

    pieces_of_given: tuple[int, ...] = (32, 64, 128, 256)
    """Number of pieces of a path that is given, the first with which it is still clear."""

    iterations: int = 30
    """Number of Gauss-Newton steps after which a path that is not clear is abandoned."""

    patient_iterations: int = 6
    """Number of steps after which it is abandoned if the energy exceeds a share of the initial one."""

    slow_share: float = 0.4
    """That share."""

    first_reach: float = 0.3
    """Largest joint motion of a waypoint in the first Gauss-Newton step, in `Arm.joint_units`.

    `docs/design/relaxation.md` says how this and the next two were found; the study `clutter` guards them.
    """

    most_reach: float = 1.2
    """The same in any later step."""

    growth: float = 1.5
    """Factor of that reach after a step that it shortened and that lowered the energy at once."""

    halvings: int = 2
    """How often a step that does not lower the energy is halved before another one is computed."""

    least_damping: float = 1e-9
    """Smallest damping of Gauss-Newton steps, relative to the mean diagonal of J^T J."""

    most_damping: float = 1e6
    """Damping at which the search ends, relative to the mean diagonal of J^T J."""

    damping_decrease: float = 1.0 / 3.0
    """Damping factor after a whole step that lowered the energy at once."""

    least_share: float = 0.5
    """Share of a step below which the next is damped more, as much as it would take to make it longer."""

    most_increase: float = 10.0
    """Largest damping factor then."""

    damping_increase: float = 30.0
    """Damping factor after a step that did not lower it, halved or not."""

    held_back: int = 8
    """How often waypoints of a step are held back to keep a clear path clear, before the step is
    rejected."""


AMONG_OBSTACLES = ObstacleRelaxationSettings()


class Descent(NamedTuple):
    """How the Gauss-Newton steps of a path go; `docs/design/relaxation.md` measures given paths with others.

    Attributes:
        steps: largest number of steps.
        damping: initial damping, relative to the mean diagonal of J^T J.
        converged: they end when a whole step would lower the energy by less than this share of it, judged by
            one that was shortened, but not halved.
    """

    steps: int
    damping: float
    converged: float


class Descents(NamedTuple):
    """The steps of each kind of path."""

    from_guess: Descent = Descent(steps=60, damping=1e-3, converged=1e-2)
    """From a guess, without tasks."""

    with_tasks: Descent = Descent(steps=60, damping=1e-3, converged=1e-3)
    """With tasks: on a path that misses a task with priority the arm waits."""

    coarse: Descent = Descent(steps=12, damping=1e-6, converged=5e-2)
    """From a given path, in few pieces."""

    fine: Descent = Descent(steps=50, damping=1e-6, converged=3e-2)
    """Then in more."""

    whole: Descent = Descent(steps=50, damping=1e-6, converged=1e-2)
    """From a given path, at once in as many as it takes."""


DESCENTS = Descents()


def direct_path(
    objective: Objective,
    start: ChainState,
    goal: Array,
    position_limits: Array,
    penalties: Penalties | None = None,
    variant: int = 0,
) -> JointPath:
    """Find the most direct path between two configurations.

    Args:
        objective: the objective of the path.
        start: the state at the start.
        goal: configuration at the end, (nq,).
        position_limits: smallest and largest joint positions, (2, nv) [rad or m].
        penalties: further terms; None: none.
        variant: number of the initial guess; others may lead to another path.
    """
    arm = objective.arm
    change = objective.normalize(arm.difference(start.q, goal))
    largest = float(np.abs(change).max(initial=0.0))
    if penalties is None and largest <= PATH.short_motion:
        return JointPath(objective, start.q, np.array([np.zeros(arm.nv), objective.displacement(change)]))
    waypoints = _Waypoints(objective, start, position_limits)
    if penalties is None:
        relaxed = waypoints.relax(change, variant)
    else:
        guess = waypoints.guess(change, variant, AMONG_OBSTACLES.pieces)
        descent = DESCENTS.from_guess if penalties.tasks is None else DESCENTS.with_tasks
        relaxed = _PathRelaxation(waypoints, penalties).run(guess, descent)
    pieces = len(relaxed) - 1
    finer = max(STAGING.refinement, STAGING.least_pieces // pieces) * pieces
    smooth = waypoints.refine(relaxed, finer) if pieces > 1 else relaxed
    return JointPath(objective, start.q, objective.displacement(smooth))


def relax_path(
    objective: Objective, start: ChainState, offsets: Array, position_limits: Array, penalties: Penalties
) -> tuple[JointPath, JointPath]:
    """Find the most direct path near a given one.

    Args:
        objective: the objective of the path.
        start: the state at the start.
        offsets: waypoints of the given path as displacements from there, (N + 1, nv) [rad or m].
        position_limits: smallest and largest joint positions, (2, nv) [rad or m].
        penalties: further terms.

    Returns:
        The path on a spline through its waypoints, and with straight lines between them.
    """
    waypoints = _Waypoints(objective, start, position_limits)
    # Distances between waypoints, where pieces are divided, are known to the tolerance.
    spare = penalties.least + MOTION_TOLERANCE * objective.arm.length
    few = AMONG_OBSTACLES.pieces_of_given[0]
    coarse = _PathRelaxation(waypoints, penalties.for_pieces(few)._replace(least=spare))
    fine = _PathRelaxation(waypoints, penalties)
    x = waypoints.space(offsets, few)
    descent = DESCENTS.fine
    if coarse.is_clear(x):
        relaxed = coarse.run(x, DESCENTS.coarse)
        x = waypoints.space(objective.displacement(relaxed), AMONG_OBSTACLES.pieces)
        if not fine.is_clear(x):
            x = waypoints.divide(relaxed)
    else:
        descent = DESCENTS.whole
        for pieces in AMONG_OBSTACLES.pieces_of_given[1:]:
            x = waypoints.space(offsets, pieces)
            if fine.is_clear(x):
                break
    relaxed = _PathRelaxation(waypoints, penalties.for_pieces(len(x) - 1)).run(x, descent)
    # Where x is clear, but bounding capsules may be too close, it is not kept so.
    if descent is DESCENTS.fine and not fine.is_clear(relaxed):
        relaxed = x
    smooth = waypoints.refine(relaxed, STAGING.refinement * (len(relaxed) - 1))
    first, second = (JointPath(objective, start.q, objective.displacement(x)) for x in (smooth, relaxed))
    return first, second


class _Waypoints:
    """Operations on waypoints as displacements from the start, (N + 1, n), in `Arm.joint_units`.

    Attributes:
        objective: the objective of the path.
        start: the state at the start.
        positions: joint positions there, (nv,) [rad or m].
        weight: mu^2 [m^2].
        within: smallest and largest displacement, 2 x (n,).
    """

    def __init__(self, objective: Objective, start: ChainState, position_limits: Array) -> None:
        arm = objective.arm
        chain = objective.chain
        self.weight = objective.mu**2
        self.objective = objective
        self.start = start
        self.positions = start.raw_positions
        lower, upper = objective.normalize(position_limits - self.positions)
        # From a start outside its limits, the waypoints come back along the path.
        self.within = np.minimum(lower, 0.0), np.maximum(upper, 0.0)
        constants = arm.kinematics.constants
        ends = np.searchsorted(chain.joints, arm.kinematics.ends).astype(np.int64)
        given = constants, chain.joints, ends, chain.units, self.positions, *self.within, self.weight
        self._problem = PathProblem(*given)

    def guess(self, change: Array, variant: int, pieces: int) -> Array:
        """Return joint interpolation, with the whole arm bent to one side, another for each variant."""
        joints = len(change)
        along = (np.arange(joints) + 0.5) / joints
        size = STAGING.large_bend if variant else STAGING.small_bend
        sign = (-1.0) ** variant
        waves = 1 + variant // 2
        bend = size * sign * np.cos(np.pi * waves * along) * np.abs(change).max(initial=0.0)
        shares = np.arange(pieces + 1)[:, None] / pieces
        return self._clip(shares * change + np.sin(np.pi * shares) * bend)

    def refine(self, x: Array, pieces: int) -> Array:
        """Return waypoints on a cubic spline through x, with a multiple of its number of pieces."""
        finer = np.empty((pieces + 1, x.shape[1]))
        kernels.refine_waypoints(x, finer)
        return self._clip(finer)

    def divide(self, x: Array) -> Array:
        """Return the same path with each piece divided in two."""
        return np.insert(x, np.arange(1, len(x)), 0.5 * (x[:-1] + x[1:]), axis=0)

    def space(self, offsets: Array, pieces: int) -> Array:
        """Return waypoints on a path, (N + 1, nv), equidistant in the metric of the planner."""
        objective = self.objective
        s = np.concatenate([[0.0], np.cumsum(objective.measure_pieces(self.positions, offsets))])
        even_s = np.linspace(0.0, s[-1], pieces + 1)
        x = objective.normalize(offsets)
        return self._clip(np.column_stack([np.interp(even_s, s, joint) for joint in x.T]))

    def relax(self, change: Array, variant: int) -> Array:
        """Return the waypoints of the most direct path found, with as many pieces as it needs."""
        arm = self.objective.arm
        pieces = STAGING.first_pieces if arm.n_modules < STAGING.long_arm else STAGING.first_pieces_of_long
        stiffness = arm.n_modules * arm.length**2 / 12.0  # mean of the diagonal of J^T J
        return kernels.find_direct_waypoints(
            self._problem,
            self.guess(change, variant, pieces),
            np.array(STAGES),
            stiffness,
            STAGING.least_decrease,
            STAGING.kept_ratio,
        )

    def step(self, x: Array, damping: float, rows: PathRows, contacts: PathContacts) -> Array | None:
        """Return a damped Gauss-Newton step of all waypoints, (N + 1, n); None if it is not finite."""
        steps = np.empty_like(x)
        status = kernels.step_waypoints(self._problem, damping, x, rows, contacts, steps)
        return steps if status >= 0 else None

    def _clip(self, x: Array) -> Array:
        return np.ascontiguousarray(np.minimum(np.maximum(x, self.within[0]), self.within[1]))


# Relaxation with penalties.


class _Iterate(NamedTuple):
    """Waypoints and derived quantities.

    Attributes:
        x: displacements from the start, (N + 1, n), in `Arm.joint_units`.
        points: control points, (N + 1, m, 3) [m].
        rows: rows of the tasks.
        contacts: pairs of bodies that are near.
        clear: which pieces keep the smallest distance at both ends or, once checked, throughout, (N,).
        energy: the sum that is minimised [m^2].
        scale: the energy to which a decrease is compared [m^2]. With tasks it is that without contacts: some
            bodies miss clearance in every configuration, which hides what tasks still miss.
        near: the same pairs, at all waypoints; None without obstacles.
        lowest: smallest distance at both ends of each piece, or any larger number if it is large, (N,) [m].
    """

    x: Array
    points: Array
    rows: PathRows
    contacts: PathContacts
    clear: NDArray[np.bool_]
    energy: float
    scale: float
    near: Contacts | None
    lowest: Array


class _PathRelaxation:
    """Minimises the energy of a path with penalties by damped Gauss-Newton steps, within the limits.

    Unlike those of `descent.descend`, steps are shortened, grow, and are halved before another is computed
    with more damping: most would move a joint by several radians (`docs/design/relaxation.md`).
    """

    def __init__(self, waypoints: _Waypoints, penalties: Penalties) -> None:
        self._waypoints = waypoints
        self._penalties = penalties
        self._objective = waypoints.objective
        self._start = waypoints.start.q
        self._positions = waypoints.positions
        self._weight = waypoints.weight
        self._lower, self._upper = waypoints.within

    def is_clear(self, x: Array) -> bool:
        """Return whether straight motions between waypoints, (N + 1, n), keep the smallest distance."""
        avoidance = self._penalties.avoidance
        path = self._objective.displacement(x)
        return avoidance is None or avoidance.keeps(self._start, path, self._penalties.least)

    def run(self, x: Array, descent: Descent) -> Array:
        """Return waypoints at a minimum, (N + 1, n), from an initial guess within the limits."""
        now = self._checked(self._evaluate(x))
        damping = descent.damping
        reach = AMONG_OBSTACLES.first_reach
        first = now.energy
        for number in range(descent.steps):
            slow = (
                number >= AMONG_OBSTACLES.patient_iterations
                and now.energy > AMONG_OBSTACLES.slow_share * first
            )
            hopeless = (slow or number >= AMONG_OBSTACLES.iterations) and not now.clear.all()
            if hopeless or damping > AMONG_OBSTACLES.most_damping or perf_counter() >= self._penalties.until:
                break
            step = self._step(now, damping)
            size = inf if step is None else float(np.abs(step).max())
            share = min(1.0, reach / max(size, 1e-300))
            tried = None
            halvings = 0
            while step is not None and tried is None and halvings <= AMONG_OBSTACLES.halvings:
                tried = self._move(now, 0.5**halvings * share * step)
                halvings += 1
            if tried is None:
                damping *= AMONG_OBSTACLES.damping_increase
                continue
            # On a parabola, a part s of the step to the minimum gains s (2 - s) of what the whole one does.
            whole_fall = (now.energy - tried.energy) / (share * (2.0 - share))
            converged = halvings == 1 and whole_fall < descent.converged * now.scale
            now = tried
            if halvings > 1:
                reach = 0.5 ** (halvings - 1) * share * size
            elif share < 1.0:
                reach = min(AMONG_OBSTACLES.growth * reach, AMONG_OBSTACLES.most_reach)
            if share < AMONG_OBSTACLES.least_share:
                damping *= min(AMONG_OBSTACLES.least_share / share, AMONG_OBSTACLES.most_increase)
            elif halvings == 1 and share == 1.0:
                damping = max(damping * AMONG_OBSTACLES.damping_decrease, AMONG_OBSTACLES.least_damping)
            if converged:
                break
        return now.x

    def _move(self, now: _Iterate, step: Array) -> _Iterate | None:
        """Return the path after a step of the inner waypoints, (N - 1, n); None if the energy does not fall.

        On a clear path, waypoints beside a piece that would no longer be clear stay; None if that fails, too.
        """
        moved = now.x.copy()
        moved[1:-1] = np.minimum(np.maximum(moved[1:-1] + step, self._lower), self._upper)
        for _ in range(AMONG_OBSTACLES.held_back):
            tried = self._evaluate(moved)
            if tried.energy >= now.energy:
                return None
            tried = self._checked(tried, now)
            if tried.clear.all() or not now.clear.all():
                return tried
            beside = np.zeros(len(moved), dtype=np.bool_)
            beside[:-1] |= ~tried.clear
            beside[1:] |= ~tried.clear
            moved[beside] = now.x[beside]
        return None

    def _evaluate(self, x: Array) -> _Iterate:
        """Return waypoints with what is derived from them, before pieces between them are checked."""
        objective = self._objective
        arm = objective.arm
        offsets = objective.displacement(x)
        points = arm.kinematics.points(self._positions + offsets)
        moved = np.diff(points @ arm.plane.T, axis=0)
        energy = float((moved**2).sum() + self._weight * (np.diff(x, axis=0) ** 2).sum())
        rows = self._rows(offsets)
        contacts, near, lowest = self._contacts(offsets)
        energy += float((rows.errors**2).sum())
        missing = float((contacts.errors[contacts.errors > 0.0] ** 2).sum())
        scale = energy if len(rows.errors) else energy + missing
        clear = lowest >= self._penalties.least
        return _Iterate(x, points, rows, contacts, clear, energy + missing, scale, near, lowest)

    def _checked(self, now: _Iterate, before: _Iterate | None = None) -> _Iterate:
        """Return waypoints with the pieces that are clear; those of a clear path before need no check."""
        avoidance = self._penalties.avoidance
        if avoidance is None:
            return now
        least = self._penalties.least
        offsets = self._objective.displacement(now.x)
        clear = now.clear & avoidance.keeps_constraints(self._start, offsets)
        if not clear.all() or now.near is None:
            return now._replace(clear=clear)
        known = np.zeros(len(clear), dtype=np.bool_)
        if before is not None and before.clear.all():
            still = (now.x == before.x).all(axis=1)
            known = still[:-1] & still[1:]
        # A piece is clear if its ends are much nearer to each other than to obstacles.
        moved = np.sqrt((np.diff(now.points, axis=0) ** 2).sum(axis=2).max(axis=1))
        doubtful = (now.lowest - least < 2.0 * moved) & ~known
        kept = avoidance.clearance.keep_distance(self._start, offsets, least, doubtful, now.near)
        return now._replace(clear=~doubtful | kept)

    def _rows(self, offsets: Array) -> PathRows:
        """Return the rows of tasks and of constraints at the inner waypoints."""
        arm = self._objective.arm
        tasks = self._penalties.tasks
        avoidance = self._penalties.avoidance
        last = len(offsets) - 1
        constrained = np.zeros(len(offsets), dtype=np.bool_)
        if avoidance is not None and avoidance.constrained:
            constrained = avoidance.lacks_room(self._start, offsets)
        rows: list[LinearRows] = []
        waypoints: list[int] = []
        for i in range(1, last):
            if tasks is None and not constrained[i]:
                continue
            state = arm.chain_at(arm.integrate(self._start, offsets[i]))
            if tasks is not None:
                rows.append(tasks(state, i / last))
                waypoints.append(i)
            if avoidance is not None and constrained[i]:
                rows.append(avoidance.missing_room(state, self._penalties.clearance_root))
                waypoints.append(i)
        if not rows:
            n = len(self._objective.chain.columns)
            return PathRows(np.zeros((0, n)), np.zeros(0), np.zeros(0, dtype=np.int64))
        return PathRows(
            matrix=np.ascontiguousarray(np.concatenate([part.matrix for part in rows])),
            errors=np.concatenate([part.errors for part in rows]),
            waypoints=np.repeat(np.array(waypoints), [len(part.errors) for part in rows]),
        )

    def _contacts(self, offsets: Array) -> tuple[PathContacts, Contacts | None, Array]:
        """Return the contacts at the inner waypoints, the near pairs, and lowest distances beside pieces."""
        avoidance = self._penalties.avoidance
        root = self._penalties.clearance_root
        if avoidance is None:
            begins = np.zeros(len(offsets) + 1, dtype=np.int64)
            nothing = np.zeros((0, 2), dtype=np.int64)
            contacts = PathContacts(np.zeros(0), begins, nothing, np.zeros((0, 3)), np.zeros((0, 3)))
            return contacts, None, np.full(len(offsets) - 1, inf)
        clearance = avoidance.measure_clearance(self._start, offsets)
        begins = np.searchsorted(clearance.samples, np.arange(len(offsets) + 1))
        inner = slice(begins[1], begins[-2])
        contacts = PathContacts(
            errors=root * clearance.errors[inner],
            begins=np.clip(begins - begins[1], 0, begins[-2] - begins[1]),
            carried=clearance.carried[inner],
            points=clearance.points[inner],
            normals=root * clearance.normals[inner],
        )
        minima = np.concatenate([[inf], clearance.minima[1:-1], [inf]])
        return contacts, clearance.contacts, np.minimum(minima[:-1], minima[1:])

    def _step(self, now: _Iterate, damping: float) -> Array | None:
        """Return the damped step of the inner waypoints, (N - 1, n); None if it fails."""
        steps = self._waypoints.step(now.x, damping, now.rows, now.contacts)
        return None if steps is None else steps[1:-1]
