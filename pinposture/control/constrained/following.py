"""One step along the way, or what is left of it within limits and around obstacles."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pinposture.arm import ArmState
from pinposture.control.braking import farthest
from pinposture.control.constrained.avoidance import Avoidance
from pinposture.control.constrained.course import Course
from pinposture.control.constrained.getting_on import ARRIVED
from pinposture.control.constrained.path import FARTHEST
from pinposture.control.constrained.posture import Posture
from pinposture.control.constrained.program import Solution
from pinposture.control.constrained.settling import (
    EASIER,
    HARDER,
    LEAST,
    SETTLED,
    Scope,
    corrected,
    first_things_first,
    reducing_step,
    then_the_rest,
)
from pinposture.control.constrained.sweeps import Sweeps
from pinposture.control.limits import Box, Limits
from pinposture.target.measured import TAKEN

Array = NDArray[np.float64]

TRIES = 8
"""How often a step is damped harder when it fails to reduce the errors, before none is taken."""

ROUNDING = 1e-12
"""What is lost in the arithmetic of a step, in `Arm.joint_units`; it is cut at its limits anyway."""

EXACT = 1e-13
"""Error that no step can reduce, in arm lengths: it is rounding."""

BEHIND = 0.5
"""Share of a step that an arm may be behind its place on the way and still count as getting on: it then goes
on by as much as the limits of its slowest joint allow, however little that is of the whole way."""

CORRECTING = 0.25
"""Share of the acceleration limit with which an arm that is behind catches up."""


class Asked(NamedTuple):
    """A step before the last checks.

    Attributes:
        dq: the step, (nv,) [rad or m].
        course: where the arm will be on its course.
        solution: what the program said; None if it need not be asked.
        reason: why the arm does not move; empty if it does.
    """

    dq: Array
    course: Course
    solution: Solution | None = None
    reason: str = ""


def follow(
    course: Course, state: ArmState, box: Box, limits: Limits, mu: float, avoidance: Avoidance | None = None
) -> Asked:
    """The step along the way, if its scope has it; else the one in it that is nearest in what points feel.

    Nearest means: it minimises |A (x - x_way)|^2 + mu^2 |x - x_way|^2, with all rows A of the posture and the
    weight mu of joint motion by which the way was found. Strict tasks come first; the way heeds the others.

    Args:
        course: where the arm is on its way.
        state: where it is.
        box: the steps that the limits allow.
        limits: what they are.
        mu: weight of joint motion [m per `Arm.joint_units`].
        avoidance: what to keep clear of; nothing if None.
    """
    posture, path = course.posture, course.path
    bounds, here = limits.for_arm(state.arm), course.place
    units = posture.chain.units
    if course.pace is None:
        place, left, inside, dq = path.stride(state, here, posture.columns, units, box.sides)
        hindered = True  # unless it gets on
    elif path.end == 1.0 and not course.given and bounds.brake is not None:
        # So short a way need not be straight: each joint comes to its end as fast as it can stop there.
        rest = path.offsets[-1] - path.offset_of(state, here)
        left = float(np.abs(rest[posture.columns] / units).max(initial=0.0))
        dq = np.minimum(np.maximum(farthest(rest, bounds.brake), box.lower), box.upper)
        ahead = float(np.abs((rest - dq)[posture.columns] / units).max(initial=0.0))
        whole = float(np.abs(path.offsets[-1][posture.columns] / units).max(initial=0.0))
        place, inside, hindered = max(here, 1.0 - ahead / max(whole, ARRIVED)), True, True
    else:
        columns, offset = posture.columns, path.offset_of(state, here)
        left = float(np.abs((path.offsets[-1] - offset)[columns] / units).max(initial=0.0))
        paced = min(course.pace.next(here, course.speed), path.end - here)
        onward, lag = path.smooth(here + paced) - path.smooth(here), path.smooth(here) - offset
        share = _share(onward[columns], lag[columns], bounds.bound[columns])
        place, hindered = here + share * paced, share < 1.0 or here >= path.end
        place = path.end if place > path.end - ARRIVED else place
        # What is behind is made good no faster than it can be stopped, or the arm would swing about its way.
        if bounds.brake is not None:
            lag = farthest(lag, CORRECTING * bounds.brake)
        dq = path.smooth(place) - path.smooth(here) + lag
        one = state.arm.joint_units
        within = (dq >= box.lower - ROUNDING * one) & (dq <= box.upper + ROUNDING * one)
        inside = bool(np.all((within & (np.abs(dq) <= FARTHEST * one))[posture.columns]))
    if place >= path.end and left <= ARRIVED:
        course = course._replace(arrived=True, place=path.end)
        return close_in(course, Scope.of(posture, state, box, avoidance))
    if inside and avoidance is None and posture.plain:
        # Whatever is asked would lead to the same; and a step that leads on gets on (`JointPath.stride`).
        return Asked(dq, course.gone_to(place, bounds.travel, hindered and place <= here))
    hindered = _behind(course, state) if course.pace is None and here < place else hindered
    course = course.gone_to(place, bounds.travel, hindered)
    scope, wanted = Scope.of(posture, state, box, avoidance), posture.own(dq)
    if posture.plain and scope.rows is None:
        sweeps = Sweeps(posture, state)
        x = sweeps.step(sweeps.covered(wanted), mu**2, wanted, scope.lower, scope.upper)
        return Asked(posture.displacement(x), course)
    strict = posture.task_rows(state, strict=True)
    if inside and strict is None and _clear(scope, wanted, dq, avoidance):
        return Asked(dq, course)
    matrix = posture.rows(state).matrix
    hessian = matrix.T @ matrix
    hessian[np.diag_indices(len(hessian))] += mu**2
    first = None
    if strict is not None:
        share = place / path.end
        before, after = course.strict_errors
        intended = (1.0 - share) * before + share * after if len(before) == len(strict.errors) else 0.0
        first = first_things_first(posture, scope, strict, strict.errors - intended)
    found = then_the_rest(hessian, -(hessian @ wanted), scope, first)
    x = np.clip(wanted, scope.lower, scope.upper) if found.x is None else corrected(posture, scope, found.x)
    return Asked(posture.displacement(x), course, found)


def _behind(course: Course, state: ArmState) -> bool:
    """Whether a joint is farther behind the place of the arm on its way than `BEHIND` allows."""
    lag = course.path.offset(course.place) - course.path.offset_of(state, course.place)
    return bool(np.any((np.abs(lag) > BEHIND * course.bounds.bound)[course.posture.columns]))


def _share(onward: Array, lag: Array, bound: Array) -> float:
    """The share of the way onward that a joint may go if it makes good at once what it is behind, (n,)."""
    gap = np.where(onward < 0.0, bound + lag, bound - lag)
    share = np.where(np.abs(lag) > bound, 0.0, gap / np.maximum(np.abs(onward), 1e-100))
    return float(min(share.min(initial=1.0), 1.0))


def _clear(scope: Scope, x: Array, dq: Array, avoidance: Avoidance | None) -> bool:
    """Whether the step keeps clear: by the rows of the scope, which are cautious, or by looking."""
    if scope.rows is None or avoidance is None:
        return True
    return bool(np.all(scope.rows.matrix @ x >= scope.rows.least)) or avoidance.stops_clear(scope.state, dq)


def close_in(course: Course, scope: Scope) -> Asked:
    """The step that reduces what errors are left, damped until it does.

    Args:
        course: a course whose way is behind the arm.
        scope: what the step may do.
    """
    posture, damping, found = course.posture, course.damping, None
    merit = posture.merit(scope.state)
    for _ in range(TRIES if merit > (EXACT * posture.arm.length) ** 2 else 0):
        found = reducing_step(posture, scope, damping)
        x = None if found.x is None else corrected(posture, scope, found.x)
        if x is not None and posture.merit(posture.moved(scope.state, x)) < (1.0 - SETTLED) * merit:
            easier = course._replace(damping=max(damping * EASIER, LEAST))
            return Asked(posture.displacement(x), easier, found)
        damping *= HARDER
    rest = np.clip(np.zeros(len(scope.lower)), scope.lower, scope.upper)  # which braking may still forbid
    reason = (
        ""
        if np.any(rest)
        else f"no step within the limits reduces the errors any more{_left(posture, scope)}"
    )
    return Asked(posture.displacement(rest), course, found, reason)


def _left(posture: Posture, scope: Scope) -> str:
    """What tasks are left with, and that bare points were not all found, in words."""
    left = [
        f"{type(task).__name__} by {np.linalg.norm(task.rows(scope.state, posture.target).error):.3g} m"
        for task in posture.tasks
    ]
    words = f"; tasks that are not met: {', '.join(left)}" if left else ""
    target, missed = posture.target, posture.mean_error(scope.state) > TAKEN * posture.arm.length
    if missed and (target.q is None or target.approximate):
        words += (
            "; no posture was found that takes all points, and the closest that was may be a local minimum"
        )
    return words
