"""First stage of the planner: the goal configuration, and the most direct clear path to it."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import cached_property
from math import inf
from time import perf_counter
from typing import NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from pinposture._validation import require_function, require_instance, require_positive
from pinposture.arm import ArmState, ChainState
from pinposture.collision import Closest, Scene
from pinposture.collision.model import describe_distance
from pinposture.control.constraint import Constraint
from pinposture.control.controller import checked_limits
from pinposture.control.limits import JointBounds, Limits
from pinposture.control.planner.avoidance import Avoidance
from pinposture.control.planner.damped_least_squares import (
    DESCENT,
    PlanningProblem,
    minimize,
)
from pinposture.control.planner.goal import PlanNeeded, find_goal, is_held, known_goal
from pinposture.control.planner.objective import OBJECTIVE, LinearRows, Objective, check_objective
from pinposture.control.planner.path import JointPath
from pinposture.control.planner.path_search import TREES, FoundPath, PathSearch
from pinposture.control.planner.trajectory_optimization import (
    Penalties,
    RowsAlongPath,
    direct_path,
    relax_path,
)
from pinposture.control.tasks import ControlTask
from pinposture.errors import InvalidValue, is_interruption
from pinposture.placement import Target
from pinposture.units import ROUNDING

logger = logging.getLogger(__name__)

Array = NDArray[np.float64]


Report = Callable[[str, JointPath | None], None]
"""Called with the next attempt and the shortest clear path so far."""


class PlanSettings(NamedTuple):
    """How many paths a plan compares, and which it prefers."""

    task_root: float = 0.4
    """Root of the weight of tasks on the path, relative to the motion of control points."""

    task_deviation: float = 0.1
    """Deviation of tasks with priority from straight change, relative to that change, above which a path
    misses them. On 40 large motions of an arm of eight modules it was below 0.01 on 35, above 0.34 on 5."""

    task_gain: float = 0.5
    """Ratio of the deviations on a path along the tasks and on one that disregards them, above which the
    tasks cannot be kept on the way. On those 5 motions it was 0.77 to 1.1: the motion of the body turns the
    tip the longer way round to its orientation, and the path along the tasks leaps there."""

    clearance_roots: tuple[float, ...] = (33.0, 10.0)
    """The same of clearances. Attempts alternate between a large and a small weight, which lead to
    different paths."""

    small_change: float = 0.3
    """Mean motion of the points of a target that counts as a small change, in module lengths."""

    noise_factor: float = 2.0
    """Factor by which the error of a goal may exceed the expected one, for noisy targets."""

    most_bend: float = 0.5
    """Largest total displacement of the end of a path, relative to the remaining motion."""

    least_planned_motion: float = 0.1
    """Joint motion up to which no path around obstacles or along tasks is planned, in
    `Arm.joint_units`."""

    most_short_motion: float = 40.0
    """Joint motion times the number of joints up to which the most direct path is found within a cycle,
    in `Arm.joint_units`: in about a millisecond."""

    least_shortened: float = 1.2
    """Length left on a path, relative to that of straight joint motion, above which a shortcut is
    sought."""

    paths: int = 12
    """Largest number of relaxed paths among which a clear one is searched; fewer in later attempts."""

    hopeless_paths: int = 1
    """The same if the search has ended without a path. Of 295 problems of clutter with a way, the search of
    none did; of one with 400 joints that it missed, four relaxations found no path either."""

    most_relaxed_joints: int = 200
    """Number of joints above which no path is relaxed where the tree search found none: beside a closed wall
    that takes 25 s of processor time and more with 400 joints, the whole search 2 s."""

    most_detour: float = 2.0
    """Length of a clear path, relative to the most direct one, above which the search looks for a
    shorter one."""

    searched_root: float = 10.0
    """Root of the weight of clearance on searched paths."""


PLAN = PlanSettings()


def plan(
    state: ArmState,
    target: Target,
    scene: Scene | None = None,
    limits: Limits | None = None,
    *,
    tasks: Sequence[ControlTask] = (),
    joint_weight: float = 0.2,
    relative_position_weight: float = 1.0,
    constraints: Sequence[Constraint] = (),
    budget: float = inf,
    progress: Callable[[str, float, JointPath | None], object] | None = None,
    strict: bool = True,
) -> JointPath:
    """Plan the most direct clear path to a target posture: the first stage of `Geodesic`.

    Among obstacles, Ctrl-C ends the search for a clear path and returns the best one so far.

    Args:
        state: the state of the arm.
        target: the target posture.
        scene: the obstacles and their margin; None: no obstacles.
        limits: the margin to position limits, the acceleration limits, and the torque limits of postures;
            `Limits()` if None.
        tasks: further tasks, as for `Geodesic`.
        joint_weight: as for `Geodesic`.
        relative_position_weight: as for `Geodesic`.
        constraints: constraints that the path keeps, as for `Geodesic`.
        budget: time after which no further path is tried among obstacles [s]. The result then depends on the
            speed of the machine; without a budget it is reproducible.
        progress: called among obstacles with the next attempt, the time so far [s], and the shortest clear
            path so far (None if there is none). The search ends if it returns True.
        strict: whether a start or goal that the motors cannot hold within torque limits of `limits` is
            refused. If not, `blocked_by` says so.

    Returns:
        The path. If no clear path was found, `blocked_by` names what it comes too close to; ends of the
        path that are themselves too close do not count. It also names the constraints and torque limits that
        the start or the goal (the configuration of the target, if known) violates. `found_by` tells how the
        path was found.

    Raises:
        InvalidValue: an argument of the wrong type, one that does not fit the arm, or a start or goal that
            cannot be held.
        WeightUnknown: torque limits, and masses, or all limits of the arm, are not known.
    """
    limits = checked_limits(state, target, limits)
    if not (scene is None or isinstance(scene, Scene)):
        raise InvalidValue("scene", scene, "a Scene(...), or None")
    check_objective(joint_weight, relative_position_weight, tasks, constraints)
    require_function("progress", progress)
    if budget != inf:
        require_positive("budget", budget)
    objective = Objective(
        state.arm, target, tuple(tasks), relative_position_weight, joint_weight, tuple(constraints)
    )
    bounds = limits.for_arm(state.arm)
    require_instance("strict", strict, bool, "True or False")
    known_goal = None if target.q is None else state.arm.chain_at(target.q)
    avoidance = Avoidance.of(scene, objective, bounds)
    torques = avoidance.torques if strict and avoidance is not None else None
    if torques is not None:
        torques.require_held(state.chain_state, "state")
        if known_goal is not None:
            torques.require_held(known_goal, "target.q")
    problem = PlanningProblem(objective, state.chain_state, bounds.position_limits, avoidance)
    began = perf_counter()

    def report(trying: str, best: JointPath | None) -> None:
        if progress is not None and progress(trying, perf_counter() - began, best) is True:
            raise KeyboardInterrupt

    path = find_path(problem, until=began + budget, report=report)
    if avoidance is None or not avoidance.constrained:
        return path
    end = path.configuration(path.end)
    goal = state.arm.chain_at(end) if known_goal is None else known_goal
    if torques is not None and (
        known_goal is None or np.abs(state.arm.difference(known_goal.q, end)).max() > ROUNDING
    ):
        torques.require_held(state.arm.chain_at(end), "the goal")
    words = [path.blocked_by] if path.blocked_by else []
    for name, at in (("start", problem.start), ("goal", goal)):
        words += [f"at the {name}, {reason}" for reason in avoidance.describe_broken(at)]
    return replace(path, blocked_by="; ".join(words))


def find_path(
    problem: PlanningProblem,
    attempt: int = 0,
    until: float = inf,
    report: Report | None = None,
    goal: ChainState | None = None,
) -> JointPath:
    """Find the goal configuration and the most direct clear path to it.

    Args:
        problem: what is planned.
        attempt: number of abandoned paths; each attempt tries other paths.
        until: time of `perf_counter` after which no further path is tried.
        report: progress callback. If given, a `KeyboardInterrupt` ends the search, which then returns the
            best path so far.
        goal: the state at the goal; None: it is searched.
    """
    objective, state, position_limits, avoidance = problem
    good = OBJECTIVE.goal_tolerance * objective.arm.length
    limited = None if avoidance is None or avoidance.torques is None else avoidance
    # The usual goal and path are taken if the motors hold the arm there.
    usual = problem if limited is None else problem._replace(avoidance=limited.without_torques())
    if usual.avoidance is None and goal is None and not objective.tasks:
        goal = known_goal(objective, position_limits, state.q)
    if goal is None:
        goal = find_goal(usual, good).state
    if limited is not None and limited.violation(goal) > 0.0:
        goal = find_goal(problem, good).state

    def clearest(tasks: RowsAlongPath | None) -> JointPath:
        if limited is None or attempt:
            return _clearest_path(problem, goal, tasks, attempt, until, report)
        path = _clearest_path(usual, goal, tasks, attempt, until, report)
        tolerant = limited.tolerating(state, goal)
        if path.blocked_by or tolerant.keeps_constraints(state.q, path.offsets).all():
            return path
        return _clearest_path(problem, goal, tasks, attempt, until, report, path)

    path = clearest(_task_rows(objective, state, goal) if objective.tasks else None)
    ends = _task_errors(objective, state, goal)
    errors: tuple[Array, Array] | None = ends
    if len(ends[0]) and not is_held(objective, state):
        off = _task_deviation(path, ends)
        if off > PLAN.task_deviation * float(np.linalg.norm(ends[1] - ends[0])):
            free = clearest(None)
            if off > PLAN.task_gain * _task_deviation(free, ends) and not free.blocked_by:
                path = free
                errors = None
    scene = None if avoidance is None else avoidance.clearance.scene
    path = replace(path, scene=scene, attempt=attempt, task_errors=errors)
    logger.debug("a path of %d pieces by %s %s", path.end, path.found_by, path.blocked_by)
    return path


def _task_deviation(path: JointPath, ends: tuple[Array, Array]) -> float:
    """Return by how much the errors of tasks with priority leave a straight change between ends, (r,) [m]."""
    first, last = ends
    s = np.linspace(0.0, path.end, 4 * int(path.end) + 1)  # a leap may lie between two waypoints
    states = (path.arm.chain_at(q) for q in path.arm.integrate(path.start, path.offset(s)))
    errors = np.array([path.objective.errors_of_tasks(at, priority=True) for at in states])
    share = (s / path.end)[:, None]
    return float(np.linalg.norm(errors - (1.0 - share) * first - share * last, axis=1).max())


def _task_errors(
    objective: Objective,
    state: ChainState,
    goal: ChainState,
    former: JointPath | None = None,
    s: float = 0.0,
) -> tuple[Array, Array]:
    """Return the errors of the tasks with priority at the ends of a path, as in `JointPath.task_errors`.

    Args:
        objective: the objective.
        state: the state of the arm.
        goal: the state at the end.
        former: the path that is bent from the place of the arm on; None: the path starts at the arm. The
            errors planned for that position change by as much as other tasks change those of the arm.
        s: that position, in waypoints.
    """
    here = objective.errors_of_tasks(state, priority=True)
    if here is None:
        return np.zeros(0), np.zeros(0)
    last = cast(Array, objective.errors_of_tasks(goal, priority=True))
    if former is None:
        return here, last
    share = s / former.end
    before = former.objective.errors_of_tasks(state, priority=True)
    first, end = (here, last) if former.task_errors is None else former.task_errors
    if before is not None and len(first) == len(here) == len(before):
        here = (1.0 - share) * first + share * end + here - before
    return here if share >= 1.0 else (here - share * last) / (1.0 - share), last


def short_path(problem: PlanningProblem, goal: ChainState | None = None) -> JointPath | None:
    """Return the most direct path to a goal if it is short and clear, which is found well within a cycle.

    Args:
        problem: what is planned; its tasks do not shape the path.
        goal: the state at the goal; None: that of the target, if it has one that is clear.
    """
    objective, state, position_limits, avoidance = problem
    if goal is None:
        goal = known_goal(objective, position_limits, state.q)
        if goal is None or not (avoidance is None or avoidance.allows(goal)):
            return None
    motion = objective.largest_motion(objective.arm.difference(state.q, goal.q))
    if motion * len(objective.chain.columns) > PLAN.most_short_motion:
        return None
    path = direct_path(objective, state, goal.q, position_limits)
    path = replace(path, task_errors=_task_errors(objective, state, goal))
    if avoidance is None:
        return path
    if motion > PLAN.least_planned_motion:
        possible = _possible_clearance(avoidance, state, goal)
        if not _is_clear(path, avoidance.tolerating(state, goal), possible):
            return None
    return replace(path, scene=avoidance.clearance.scene)


def shortcut(
    path: JointPath,
    s: float,
    state: ChainState,
    bounds: JointBounds,
    avoidance: Avoidance,
    prompt: bool = False,
) -> JointPath | None:
    """Return the most direct path to the end of a path that is a detour, if the obstacles have left it.

    Args:
        path: the path, planned when the obstacles were elsewhere.
        s: position of the arm on it, in waypoints.
        state: the state of the arm.
        bounds: the limits of the joints.
        avoidance: the obstacles to avoid.
        prompt: whether only a path that is found within a cycle is sought.
    """
    objective = avoidance.objective
    goal = path.configuration(path.end)
    arm = state.arm
    change = objective.normalize(arm.difference(state.q, goal))
    if prompt and np.abs(change).max(initial=0.0) * len(change) > PLAN.most_short_motion:
        return None
    straight = np.stack([np.zeros(arm.nv), objective.displacement(change)])
    left = path.length - np.interp(s, np.arange(len(path.lengths)), path.lengths)
    if left <= PLAN.least_shortened * objective.measure_pieces(state.positions, straight).sum():
        return None
    if np.any(avoidance.near(state).rates < 0.0):  # an obstacle still approaches
        return None
    possible = _possible_clearance(avoidance, state, arm.chain_at(goal))
    if not avoidance.keeps(state.q, straight, possible):  # quicker than finding the path
        return None
    direct = direct_path(objective, state, goal, bounds.position_limits)
    if not _is_clear(direct, avoidance, possible):
        return None
    return replace(direct, scene=avoidance.clearance.scene)


def repair(problem: PlanningProblem, rest: Array, attempt: int = 0) -> JointPath | None:
    """Return the rest of a path, where what is in the way now is bypassed; None if no such path is found.

    It is found in a seventh of the time of `find_path`, and not relaxed, so that it may be twice as long. A
    search disregards tasks, so there is none with tasks. If its end is no longer allowed, another goal is
    searched from there, and the rest is bent to it.

    Args:
        problem: what is planned.
        rest: displacements from its start to the waypoints that are left, (N + 1, nv) [rad or m]; the first
            is zero.
        attempt: number of abandoned paths. The rest itself, if it is clear, is returned to the first only.
    """
    objective, state, _, avoidance = problem
    if avoidance is None or objective.tasks:
        return None
    goal = state.moved(rest[-1])
    is_allowed = avoidance.allows(goal)
    if not is_allowed:
        goal = find_goal(problem, OBJECTIVE.goal_tolerance * objective.arm.length, goal).state
        if not avoidance.allows(goal):
            return None
        change = objective.arm.difference(state.q, goal.q) - rest[-1]
        rest = rest + np.linspace(0.0, 1.0, len(rest))[:, None] * change
    possible = _possible_clearance(avoidance, state, goal)
    search = PathSearch(
        problem._replace(avoidance=avoidance.tolerating(state, goal)), goal, possible, attempt
    )
    if not search.is_clear(rest):
        rejoined = search.rejoin(rest)
    else:
        rejoined = FoundPath(rest, "relaxation") if attempt == 1 or not is_allowed else None
    if rejoined is None:
        return None
    scene = avoidance.clearance.scene
    return replace(
        search.path(rejoined), scene=scene, attempt=attempt, task_errors=_task_errors(objective, state, goal)
    )


# The path.


def _clearest_path(
    problem: PlanningProblem,
    goal: ChainState,
    tasks: RowsAlongPath | None,
    attempt: int,
    until: float,
    report: Report | None,
    guess: JointPath | None = None,
) -> JointPath:
    """Return a direct clear path; if none is found, the one with the largest clearance.

    Among those that are not clear, it is the one with the most pieces within the constraints.

    The candidates are those of `_Candidates`, first from a guess. The first clear one is returned; if it is
    long, the shorter of it and the others.
    """
    objective, state, position_limits, avoidance = problem
    if avoidance is None:
        penalties = None if tasks is None else Penalties(tasks)
        return direct_path(objective, state, goal.q, position_limits, penalties, attempt)
    possible = _possible_clearance(avoidance, state, goal)
    tolerant = problem._replace(avoidance=avoidance.tolerating(state, goal))
    tried = _Candidates(PathSearch(tolerant, goal, possible, attempt, until), tasks, report)
    try:
        for path in tried.find(attempt, guess):
            if tried.judge(path) and (objective.tasks or path.length <= tried.short):
                return path
            if perf_counter() >= until:
                break
    except (KeyboardInterrupt, SystemError) as error:
        if report is None or not is_interruption(error):
            raise
        logger.warning("planning was interrupted; the best path so far is returned")
    return tried.best()


class _Candidates:
    """The paths among which a clear one is sought, and those that were."""

    def __init__(self, search: PathSearch, tasks: RowsAlongPath | None, report: Report | None) -> None:
        self._search = search
        self._tasks = tasks
        self._report = report
        self._clear: list[JointPath] = []
        self._blocked: list[tuple[tuple[float, float], JointPath]] = []
        self._searched = ""
        self._relaxed = 0

    @cached_property
    def most_direct(self) -> JointPath:
        """The most direct path, whatever is in its way."""
        objective, state, position_limits, _ = self._search.problem
        return direct_path(objective, state, self._search.goal.q, position_limits)

    @property
    def short(self) -> float:
        """Length up to which a clear path is good enough."""
        return PLAN.most_detour * self.most_direct.length

    def find(self, attempt: int, guess: JointPath | None = None) -> Iterator[JointPath]:
        """Find candidates, in this order, as long as none is good enough.

        The most direct path; one relaxed among the obstacles; one found by search and then relaxed; while
        none is clear, further relaxed paths. Before the most direct path, which takes longer, a straight
        motion of the joints is told if it is clear, and where it is not, a short tree search is made. The
        first relaxation is left out if the tree search finds none and an end is trapped or the arm has many
        joints. What is found is told at once. With tasks, which a search would disregard, the tree search
        comes after the first relaxation.
        """
        search = self._search
        variant = 2 * attempt
        count = PLAN.paths // (1 + attempt)
        too_many = len(search.problem.objective.chain.columns) > PLAN.most_relaxed_joints
        searched = None
        hopeless = False
        if guess is not None:
            yield from self._relax_found(guess.offsets, guess.found_by)
        if self._tasks is None:
            straight = search.straight() if attempt == 0 else None
            if straight is not None:
                self._clear.append(search.path(straight))
            elif attempt == 0:
                searched = self._keep(search.connect(self._search_tells, TREES.early_turns))
            if attempt == 0:
                self._tell("the most direct path")
                yield self.most_direct
            if searched is None:
                searched = self._keep(search.connect(self._search_tells))
            hopeless = searched is None and (search.is_trapped or too_many)
        if not hopeless:
            yield self._relax(0, variant, count)
        if searched is None:
            searched = self._keep(search.withdraw(self._search_tells))
        if searched is not None:
            self._tell(f"shortening a path found by {searched.found_by}")
            yield from self._relax_found(search.shorten(searched).offsets, searched.found_by)
        else:
            count = 0 if hopeless and too_many else min(count, PLAN.hopeless_paths)
        for k in range(int(not hopeless), count):
            if not self._clear:
                yield self._relax(k, variant, count)

    def _keep(self, searched: FoundPath | None) -> FoundPath | None:
        """Keep a path that was found, so that it is told with the next attempt."""
        if searched is not None:
            self._clear.append(self._search.path(searched))
        return searched

    def judge(self, path: JointPath) -> bool:
        """Keep a path; return whether it is clear."""
        least = self._search.least
        avoidance = self._search.avoidance
        closest = _closest_on(path, avoidance, least)
        kept = avoidance.keeps_constraints(path.start, path.offsets)
        if closest.distance >= least and kept.all():
            self._clear.append(path)
            return True
        rank = min(closest.distance, least), float(kept.mean())
        words = [] if closest.pair is None else [describe_distance(closest.pair, closest.distance)]
        words += avoidance.describe_worst_on(path.start, path.offsets)
        self._blocked.append((rank, replace(path, blocked_by="; ".join(words))))
        return False

    def best(self) -> JointPath:
        """Return the shortest clear path; if there is none, the one with the largest clearance."""
        if self._clear:
            return min(self._clear, key=lambda path: path.length)
        if not self._blocked and self.judge(self.most_direct):
            return self.most_direct
        _, path = max(self._blocked, key=lambda ranked: ranked[0])
        return replace(path, blocked_by=f"{self._describe_attempts()}; on the best one, {path.blocked_by}")

    def _describe_attempts(self) -> str:
        """Say that no clear path was found, and how one was sought."""
        searches = [f"a {self._searched}"] if self._searched else []
        relaxations = [f"{self._relaxed} relaxation{'s' * (self._relaxed > 1)}"] if self._relaxed else []
        attempts = " and ".join(searches + relaxations) or "looking at the most direct one alone"
        return f"no clear path was found by {attempts}, which does not prove that there is none"

    def _search_tells(self, trying: str) -> None:
        self._searched = trying
        self._tell(trying)

    def _tell(self, trying: str) -> None:
        if self._report is not None:
            self._report(trying, min(self._clear, key=lambda path: path.length, default=None))

    def _penalties(self, root: float) -> Penalties:
        search = self._search
        return Penalties(self._tasks, search.avoidance, root, search.least, search.until)

    def _relax(self, k: int, variant: int, count: int) -> JointPath:
        """Return a path relaxed among the obstacles, the k-th of an attempt."""
        self._tell(f"relaxation {k + 1} of {count}")
        self._relaxed += 1
        objective, start, position_limits, _ = self._search.problem
        penalties = self._penalties(PLAN.clearance_roots[(variant + k) % len(PLAN.clearance_roots)])
        return direct_path(objective, start, self._search.goal.q, position_limits, penalties, variant + k)

    def _relax_found(self, offsets: Array, found_by: str) -> Iterator[JointPath]:
        """Yield a path that was found, (N + 1, nv), relaxed, and as it is."""
        search = self._search
        raw = replace(JointPath(search.problem.objective, search.problem.start.q, offsets), found_by=found_by)
        objective, start, position_limits, _ = search.problem
        self._tell(f"relaxation of a path found by {found_by}")
        try:
            relaxed = relax_path(
                objective, start, offsets, position_limits, self._penalties(PLAN.searched_root)
            )
        except (KeyboardInterrupt, SystemError):
            self.judge(raw)
            raise
        yield from (replace(path, found_by=found_by) for path in relaxed)
        yield raw


def _possible_clearance(avoidance: Avoidance, state: ChainState, goal: ChainState) -> float:
    """Return the margin, or the clearance of an end of the path if that is smaller [m]."""
    ends = [avoidance.clearance.minimum_at(at).distance for at in (goal, state)]  # that of the goal is known
    return min(avoidance.margin, *ends) - 1e-9 * state.arm.length


def _task_rows(objective: Objective, state: ChainState, goal: ChainState) -> RowsAlongPath:
    """Return the rows of the tasks along the path."""
    kinds = [(PLAN.task_root, False), (PLAN.task_root * float(np.sqrt(OBJECTIVE.priority_weight)), True)]
    ends = [[objective.errors_of_tasks(at, priority) for at in (state, goal)] for _, priority in kinds]

    def rows(at: ChainState, share: float) -> LinearRows:
        parts = []
        for (root, priority), (first, last) in zip(kinds, ends, strict=True):
            tasks = objective.task_rows(at, priority)
            if tasks is None or first is None or last is None:
                continue
            # Errors should change linearly from the start to the goal.
            left = tasks.errors - (1.0 - share) * first - share * last
            parts.append(LinearRows(root * tasks.matrix, root * left))
        matrices, errors = zip(*parts, strict=True)
        return LinearRows(np.concatenate(matrices), np.concatenate(errors))

    return rows


def _closest_on(path: JointPath, avoidance: Avoidance, below: float) -> Closest:
    """Return the closest pair on a path including its ends; any pair if none is closer than `below`."""
    return avoidance.clearance.minimum_on_motions(path.start, path.offsets, below)


def _is_clear(path: JointPath, avoidance: Avoidance, least: float) -> bool:
    """Whether a path keeps a distance [m], and constraints."""
    close = _closest_on(path, avoidance, least).distance < least
    return not close and bool(avoidance.keeps_constraints(path.start, path.offsets).all())


# Moving targets.


def is_small_change(before: Objective, after: Objective) -> bool:
    """Whether a target posture differs little from the previous one."""
    return before.distance_to(after) <= PLAN.small_change * after.arm.length / after.arm.n_modules


def replan(
    path: JointPath,
    s: float,
    bend: Array | None,
    problem: PlanningProblem,
    prompt: bool = False,
) -> tuple[JointPath, Array | None]:
    """Update a path for a target close to the previous one.

    The search for the goal starts at the previous goal. If the new one is close, compared to the remaining
    path, the end of the path is moved there, so that a moving target does not need a new path in each step.

    Args:
        path: the path to the previous target.
        s: position of the arm on it, in waypoints; infinite: the path cannot be reused.
        bend: displacement of its end so far, (nv,) [rad or m]; None: none.
        problem: what is planned now. A bent path is not checked again, but each step is.
        prompt: whether to raise `PlanNeeded` if more than a search for the goal and a short path is needed.

    Returns:
        The path; and the displacement of its end since it was planned, None for a new path.
    """
    objective, state, position_limits, avoidance = problem
    arm = objective.arm
    before = path.configuration(path.end)
    known = None if objective.tasks else known_goal(objective, position_limits, before)
    if known is not None and (avoidance is None or avoidance.allows(known)):
        goal = known
        clear = True
    else:
        if prompt and not is_small_change(path.objective, objective):
            raise PlanNeeded
        start = arm.chain_at(before)
        good = OBJECTIVE.goal_tolerance * arm.length
        if avoidance is None and not objective.tasks:
            first = start if objective.target.q is None else None
            enough = _achievable_error(path.objective, objective, start)
            result = find_goal(problem, good, first, enough, prompt)
        else:  # a whole search takes long: this one goes on in the next cycle
            allowed = 0.0 if avoidance is None else avoidance.intrusion(state)
            result = minimize(problem, start, good, allowed, DESCENT.quick_steps)
        goal = result.state
        clear = result.intrusion == 0.0
    change = objective.displacement(objective.normalize(arm.difference(before, goal.q)))
    bent = change if bend is None else bend + change
    left = objective.largest_motion(arm.difference(state.q, before))
    too_far = objective.largest_motion(bent) > PLAN.most_bend * left
    if s < np.inf and not too_far:
        ends = None if path.task_errors is None else _task_errors(objective, state, goal, path, s)
        return replace(path.bent(s, change, position_limits), objective=objective, task_errors=ends), bent
    new = None
    motion = objective.largest_motion(arm.difference(state.q, goal.q))
    if not objective.tasks or motion <= PLAN.least_planned_motion:
        new = short_path(problem, goal)
    if new is None and prompt:
        raise PlanNeeded
    if new is None:
        new = find_path(problem, goal=goal if clear else None)
    return new, None


def _achievable_error(before: Objective, after: Objective, goal: ChainState) -> float:
    """Return the mean error that is good enough for a moved target, given that at the previous goal [m].

    It is zero if the target moved so far that a better goal may exist.
    """
    left = before.mean_error(goal)
    moved = before.distance_to(after)
    small = PLAN.small_change * after.arm.length / after.arm.n_modules
    return PLAN.noise_factor * (left + moved) if moved <= max(left, small) else 0.0
