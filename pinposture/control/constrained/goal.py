"""The configuration to go to: found before the arm moves."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from pinposture.arm import ArmState
from pinposture.control.constrained.avoidance import Avoidance
from pinposture.control.constrained.posture import Posture
from pinposture.control.constrained.settling import Settled, settle
from pinposture.target.measured import goal_starts

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
) -> Settled:
    """Find the configuration that does best what is asked of the arm.

    A configuration that the target knows is taken, and improved where it does not do all that is asked.
    Otherwise the search begins where the arm is; then with the configuration that takes the points, module by
    module (`target.in_turn`), or where that search ended; then with the fit of the whole arm to the points,
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
    known, strict = posture.target.q is not None, any(task.strict for task in posture.tasks)
    # Where a strict task holds the arm, what lies near can be reached, and what lies far perhaps not.
    held = _held(posture, state)
    better = MUCH_BETTER if held else 1.0
    # Where the arm is too close to begin with, it may stay as close as it is.
    borne = 0.0 if avoidance is None else avoidance.intrusion(state)
    starts = _starts(posture, state, edges, held, before)
    best = found = settle(posture, next(starts), edges, avoidance, good, borne)
    wanted, agree = max(good, enough), 1
    while agree < AGREE and not (
        found.intrusion == 0.0 and (_does_it(posture, found, wanted) or (known and not strict))
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


def _does_it(posture: Posture, found: Settled, good: float) -> bool:
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
        for positions in goal_starts(arm, target, arm.positions(state.q)):
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
        last = int(np.flatnonzero(posture.target.placed)[-1])
        way = way * arm.support[last]
    moved = np.zeros(arm.nv)
    columns = posture.columns
    moved[columns] = np.clip(here + way, edges[0], edges[1])[columns] - here[columns]
    return arm.at(arm.integrate(state.q, moved))
