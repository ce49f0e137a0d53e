"""Planning: the configuration to go to, and the path that leads there."""

from __future__ import annotations

import logging
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from pinposture import kernels
from pinposture.arm import ArmState
from pinposture.collision import Closest
from pinposture.control.limits import JointBounds
from pinposture.control.planner.avoidance import Avoidance
from pinposture.control.planner.follow import LeastSquaresResult, settle
from pinposture.control.planner.objective import STRICT, Linear, Posture
from pinposture.control.planner.path import JointPath, PathProgress
from pinposture.control.planner.trajectory_optimization import Penalty, direct_path
from pinposture.placement.points import initial_guesses

# The configuration to go to: found before the arm moves.

Array = NDArray[np.float64]

NUDGES, NUDGE = 6, 0.5
"""How many other starts are tried where no configuration is known, and how far away, in `Arm.joint_units`."""

AGREE, ALIKE = 3, 1e-3
"""How many searches in a row have to end alike for the rest to be spared, and relative to what merit."""

MUCH_BETTER = 0.5
"""Share of the merit of an earlier find that a later one may leave to be preferred, where the arm is held."""


def find_goal(
    posture: Posture,
    state: ArmState,
    edges: Array,
    avoidance: Avoidance | None,
    good: float,
    before: ArmState | None = None,
    enough: float = 0.0,
) -> LeastSquaresResult:
    """Find the configuration that does best what is asked of the arm.

    A configuration that the target knows is taken, and improved where it does not do all that is asked.
    Otherwise the search begins where the arm is; then with the configuration that takes the points, module by
    module (`placement.points`), or where that search ended; then with the fit of the whole arm to the points,
    which knows the way round; then at other places, always the same ones, which are also tried where the
    known configuration is in the way of something or of a strict task. It ends with the first that is good
    enough, or when several in a row have found the same, and takes the best.

    Args:
        posture: what is asked of the arm.
        state: where it is.
        edges: joint positions to stay between, (2, nv) [rad or m].
        avoidance: what to keep clear of; nothing if None.
        good: mean distance of the control points from their targets that is good enough [m].
        before: where to begin, if the target does not say: the goal of a target that was much like it.
        enough: mean distance with which the search ends, if no more was found for that target [m].
    """
    known, strict = posture.target.q is not None, any(task.priority for task in posture.tasks)
    # Where a strict task holds the arm, what lies near can be reached, and what lies far perhaps not.
    held = _held(posture, state)
    better = MUCH_BETTER if held else 1.0
    # Where the arm is too close to begin with, it may stay as close as it is.
    borne = 0.0 if avoidance is None else avoidance.intrusion(state)
    starts = _starts(posture, state, edges, held, before)
    best = found = settle(posture, next(starts), edges, avoidance, good, borne)
    wanted, agree = max(good, enough), 1
    while agree < AGREE and not (
        found.intrusion == 0.0 and (_is_good_enough(posture, found, wanted) or (known and not strict))
    ):
        start = next(starts, None)  # asked for only now: to find one can take long
        if start is None:
            break
        found = settle(posture, start, edges, avoidance, good, borne)
        alike = found.intrusion == best.intrusion == 0.0 and not posture.tasks
        agree = agree + 1 if alike and abs(found.merit - best.merit) <= ALIKE * best.merit else 1
        if (found.intrusion, found.merit) < (best.intrusion, better * best.merit):
            best = found
    return best


def _is_good_enough(posture: Posture, found: LeastSquaresResult, good: float) -> bool:
    """Whether that takes the target posture, and does what comes before it."""
    strict = posture.task_rows(found.state, strict=True)
    kept = strict is None or float(np.linalg.norm(strict.errors)) <= good
    return kept and found.mean_error <= good


def _held(posture: Posture, state: ArmState) -> bool:
    """Whether strict tasks are to stay nearly as they are: within a module length."""
    strict = posture.task_rows(state, strict=True)
    typical = posture.arm.length / posture.arm.n_modules
    return strict is not None and float(np.linalg.norm(strict.errors)) <= typical


def _starts(
    posture: Posture, state: ArmState, edges: Array, held: bool, before: ArmState | None
) -> Iterator[ArmState]:
    arm, target = posture.arm, posture.target
    if before is not None and target.q is None:
        yield before
    if held:
        yield state
    if target.q is not None:
        yield _towards(posture, state, target.q, edges)
    if not held:
        yield state
    if target.q is None:
        for positions in initial_guesses(arm, target, arm.positions(state.q)):
            yield _towards(posture, state, arm.configuration(positions), edges)
    rng = np.random.default_rng(0)
    for number in range(NUDGES):
        from_ = arm.straight() if number % 2 else state.q
        nudge = posture.displacement(NUDGE * rng.normal(size=len(posture.columns)))
        yield _towards(posture, state, arm.integrate(from_, nudge), edges)


def _towards(posture: Posture, state: ArmState, q: Array, edges: Array) -> ArmState:
    """The state at a configuration, as far as its joints matter and their limits allow.

    Of the turns at which the posture is the same, joints take the nearest.
    """
    arm = posture.arm
    way = np.array(arm.difference(state.q, arm.nearest_turns(q, state.q, edges)))
    here = arm.positions(state.q)
    if not posture.tasks:  # joints beyond the last control point that has a target need not move
        last = int(np.flatnonzero(posture.target.has_target)[-1])
        way = way * arm.support[last]
    moved = np.zeros(arm.nv)
    columns = posture.columns
    moved[columns] = np.clip(here + way, edges[0], edges[1])[columns] - here[columns]
    return arm.at(arm.integrate(state.q, moved)).compiled


# Where to go and on what way: what the controller settles before it moves.

logger = logging.getLogger(__name__)

GOOD = 1e-8
"""Mean distance of the control points from their targets at which a configuration takes the posture, in arm
lengths: a run converges at 1e-6 unless told otherwise."""

HEEDED, CLEAR = 0.4, (100.0, 30.0)
"""Roots of the weights of tasks and of clearances on the way, against the motion of control points. Ways are
looked for with a large and a small one by turns: the one pushes out, the other leads round."""

LITTLE = 0.3
"""How far points of a target may move for it to be much like the one before, in module lengths."""

LITTLE_MOVED = 2.0
"""How much worse than expected a goal may be to count as no worse than the one before: noise does as much."""

BENT = 0.5
"""By how much a way may be bent in all, to end elsewhere, relative to what is left of it."""

SHORT = 0.1
"""Joint motion over which a way round something is not looked for, in `Arm.joint_units`."""

WAYS = 12
"""How many ways are looked for until one leads clear of all obstacles; fewer when it is planned again."""

SAMPLES = 2
"""Places on each straight piece of a way at which its distance is looked up."""


def plan(
    posture: Posture,
    state: ArmState,
    bounds: JointBounds,
    avoidance: Avoidance | None,
    mu: float,
    tries: int = 0,
) -> PathProgress:
    """Find where to go, and the most direct way there that is clear.

    Args:
        posture: what is asked of the arm.
        state: where it is.
        bounds: what the limits mean for its joints.
        avoidance: what to keep clear of; nothing if None.
        mu: weight of joint motion against the motion of control points [m per `Arm.joint_units`].
        tries: how many ways were tried before; each try looks for another.
    """
    goal = find_goal(posture, state, bounds.edges, avoidance, GOOD * posture.arm.length).state
    path, hindrance = _way(posture, state, goal, bounds, avoidance, mu, tries)
    progress = PathProgress(posture, path, bounds, tries=tries, hindrance=hindrance).within(bounds)
    first, last = (posture.task_rows(at, strict=True) for at in (state, goal))
    if first is not None and last is not None:
        progress = progress._replace(strict_errors=(first.errors, last.errors))
    logger.debug("a way of %d pieces%s", path.end, f", hindered: {hindrance}" if hindrance else "")
    return progress


def moved_little(progress: PathProgress, posture: Posture) -> bool:
    """Whether a target is much like the one that a progress leads to."""
    return progress.posture.distance_to(posture) <= LITTLE * posture.arm.length / posture.arm.n_modules


def plan_on(
    progress: PathProgress,
    posture: Posture,
    state: ArmState,
    bounds: JointBounds,
    mu: float,
    avoidance: Avoidance | None = None,
) -> PathProgress:
    """What `plan` finds, for a target that is not far from the one before, from what was found for that.

    The search for a goal begins at the goal before. Where the new one is near, compared to what is left of
    the way, the way is bent to end there: a target that moves on in every step needs no new way in each.

    Args:
        progress: the progress to the target before, which the arm is on.
        posture: what is asked of the arm now.
        state: where it is.
        bounds: what the limits mean for its joints.
        mu: weight of joint motion against the motion of control points [m per `Arm.joint_units`].
        avoidance: what to keep clear of; nothing if None. A way that is bent a little is not looked along
            again: each step on it is.
    """
    arm, path = posture.arm, progress.path
    before = path.configuration(path.end)
    goal = _known(posture, bounds, before)
    if goal is not None and avoidance is not None and avoidance.intrusion(arm.at(goal).compiled) > 0.0:
        goal = None
    if goal is None:
        start = arm.at(before).compiled
        first = start if posture.target.q is None else None
        enough = _as_good(progress, posture, start)
        found = find_goal(posture, state, bounds.edges, avoidance, GOOD * arm.length, first, enough)
        goal = found.state.q
    change = posture.displacement(posture.own(arm.difference(before, goal)))
    bent = change if progress.bent is None else progress.bent + change
    if (
        progress.arrived
        or progress.tries
        or _size(posture, bent) > BENT * _size(posture, arm.difference(state.q, before))
    ):
        if avoidance is not None and _size(posture, arm.difference(state.q, goal)) > SHORT:
            return plan(posture, state, bounds, avoidance, mu)
        path = direct_path(posture, state.q, goal, mu, bounds.edges)
        return PathProgress(posture, path, bounds).within(bounds)
    path = path.bent(progress.place, change, bounds.edges)
    return progress._replace(posture=posture, path=path, bent=bent).within(bounds)


def _as_good(progress: PathProgress, posture: Posture, goal: ArmState) -> float:
    """Mean distance from its points that is as good as at the goal before, for a target that moved [m].

    Zero, which is to search on, where it moved so far that what could not be had before may be possible now.
    """
    left, moved = progress.posture.mean_error(goal), progress.posture.distance_to(posture)
    little = LITTLE * posture.arm.length / posture.arm.n_modules
    return LITTLE_MOVED * (left + moved) if moved <= max(left, little) else 0.0


def _known(posture: Posture, bounds: JointBounds, before: Array) -> Array | None:
    """The configuration that a target knows, (nq,), if it is within the limits and takes the posture.

    Joints are within half a turn of those at the goal before.
    """
    arm, q = posture.arm, posture.target.q
    if q is None or len(posture.active) < arm.n_modules:
        return None
    goal = arm.at(arm.nearest_turns(q, before, bounds.edges)).compiled
    inside = kernels.position_excess(goal.forward.positions, bounds.edges, arm.kinematics.columns) == 0.0
    return goal.q if inside and posture.mean_error(goal) <= GOOD * arm.length else None


def _size(posture: Posture, way: Array) -> float:
    """The largest joint motion of a displacement (nv,), in `Arm.joint_units`."""
    return float(np.abs(posture.own(way)).max(initial=0.0))


def _way(
    posture: Posture,
    state: ArmState,
    goal: ArmState,
    bounds: JointBounds,
    avoidance: Avoidance | None,
    mu: float,
    tries: int,
) -> tuple[JointPath, str]:
    """The most direct way, or the first of several that is clear, and what the best comes too close to."""

    def found(number: int) -> JointPath:
        penalty = _penalty(posture, state, goal, avoidance, CLEAR[number % len(CLEAR)])
        return direct_path(posture, state.q, goal.q, mu, bounds.edges, penalty, number)

    if avoidance is None:
        return found(tries), ""
    # A way cannot be clearer than its ends.
    ends = (avoidance.clearance.minimum(at.q).distance for at in (state, goal))
    possible = min(avoidance.margin, *ends) - 1e-9 * posture.arm.length
    looked_at = []
    for number in range(tries, tries + WAYS // (1 + tries)):
        path = found(number)
        room = _room(path, avoidance)
        if room.distance >= possible:
            return path, ""
        looked_at.append((room, path))
    closest, best = max(looked_at, key=lambda each: each[0].distance)
    pair = " to ".join(closest.pair or ())
    return best, f"no clear way was found, the best has {pair}: {1e3 * closest.distance:.3g} mm apart"


def _penalty(
    posture: Posture, state: ArmState, goal: ArmState, avoidance: Avoidance | None, clear: float
) -> Penalty | None:
    """What else matters on the way: tasks, and to keep clear; None if nothing does."""
    if not posture.tasks and avoidance is None:
        return None
    kinds = [(HEEDED, False), (HEEDED * float(np.sqrt(STRICT)), True)]
    ends = [[posture.task_rows(at, strict) for at in (state, goal)] for _, strict in kinds]

    def penalty(at: ArmState, share: float) -> Linear:
        parts = []
        for (root, strict), (first, last) in zip(kinds, ends, strict=True):
            asked = posture.task_rows(at, strict)
            if asked is None or first is None or last is None:
                continue
            # The errors are to change steadily from what they are to what they will be.
            left = asked.errors - (1.0 - share) * first.errors - share * last.errors
            parts.append(Linear(root * asked.matrix, root * left))
        if avoidance is not None:
            near = avoidance.intrusions(at)
            parts.append(Linear(clear * near.matrix, clear * near.errors))
        return Linear(np.concatenate([p.matrix for p in parts]), np.concatenate([p.errors for p in parts]))

    return penalty


def _room(path: JointPath, avoidance: Avoidance) -> Closest:
    """The pair that comes closest on a path, its ends included."""
    ways = zip(path.offsets[:-1], np.diff(path.offsets, axis=0), strict=True)
    found = [
        avoidance.clearance.minimum_between(path.arm.integrate(path.start, offset), way, SAMPLES)
        for offset, way in ways
    ]
    return min([avoidance.clearance.minimum(path.start), *found], key=lambda each: each.distance)
