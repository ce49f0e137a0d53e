"""What can be measured on a run: how it went, how it moved, how it stood to singularities."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pinposture.arm import ArmState
from pinposture.motion import Trajectory

Array = NDArray[np.float64]

STEADY = 1e-9
"""Change of an error, relative to the arm length, that counts as none."""


class Steps(NamedTuple):
    """What a run was like in each of its steps; all arrays (steps,).

    Attributes:
        nearness: smallest singular value of the tip's Jacobian before the step, relative to the arm length
            [1/rad]; 0 at a singular posture.
        asked: largest |dq| that was asked for before any limit [rad].
        turn: how far dq is from the dq before it, relative to the larger of the two, in [0, 2]; 0 at the
            first step, and where neither moves.
        change: share of the control points in the active set of this step or the one before that are in one
            of them only; 0 at the first step.
    """

    nearness: Array
    asked: Array
    turn: Array
    change: Array


class Descent(NamedTuple):
    """In how many steps errors rose. "Uphill" is what would raise an error however short the step were made.

    Attributes:
        steps: number of steps.
        rose: steps on which the posture error rose.
        uphill: steps that were uphill for the posture error.
        clipped: steps on which a joint was cut short at its position limit.
        active: control points of the active sets, summed over the steps.
        active_rose: those of them whose own error rose.
        active_free: those of them in steps on which no joint was cut short.
        active_uphill: those of `active_free` that were uphill for themselves.
        points_rose: control points, active or not, whose error rose, summed over the steps.
    """

    steps: int
    rose: int
    uphill: int
    clipped: int
    active: int
    active_rose: int
    active_free: int
    active_uphill: int
    points_rose: int


def separation(run: Trajectory, twin: Trajectory) -> float:
    """Largest distance between the same control point of two runs at the same step, per arm length.

    A run that has ended stays where it is.
    """
    steps = np.arange(max(len(run.points), len(twin.points)))
    ours, theirs = (each.points[np.minimum(steps, each.steps)] for each in (run, twin))
    return float(np.linalg.norm(ours - theirs, axis=2).max()) / run.arm.length


def displacements(run: Trajectory) -> Array:
    """The joint displacement of each step, (steps, nv) [rad or m]."""
    model = run.arm.model
    return np.array([pin.difference(model, a, b) for a, b in pairwise(run.q)]).reshape(-1, run.arm.nv)


def states_before_steps(run: Trajectory) -> list[ArmState]:
    """The arm before each step."""
    return [run.arm.at(q) for q in run.q[:-1]]


def per_step(run: Trajectory, states: Sequence[ArmState]) -> Steps:
    """What a run was like in each of its steps, given the states before them."""
    dq = displacements(run)
    return Steps(
        nearness=np.array([nearness(state) for state in states]),
        asked=asked_steps(run, dq),
        turn=turns(dq),
        change=set_changes(run.active),
    )


def asked_steps(run: Trajectory, dq: Array) -> Array:
    """Largest |dq| that each step asked for before it was shortened to one step limit for all joints.

    A step that was not shortened but cut at position limits counts as what was left of it.

    Args:
        run: the run.
        dq: its displacements, (steps, nv) [rad or m].

    Returns:
        Array (steps,) [rad or m].
    """
    done = np.abs(dq).max(axis=1, initial=0.0)
    # The longest joint motion of a shortened step is the limit, even if that joint was then cut further.
    limit = 0.0 if run.limits.step is None else float(np.max(run.limits.step))
    return np.asarray(np.where(run.scale < 1.0, np.maximum(done, limit), done) / run.scale)


def nearness(state: ArmState) -> float:
    """Smallest singular value of the Jacobian of the tip, relative to the arm length [1/rad]."""
    jacobian = state.task_jacobians[-1]
    least = float(np.linalg.eigvalsh(jacobian @ jacobian.T)[0])
    return float(np.sqrt(max(least, 0.0))) / state.arm.length


def turns(dq: Array) -> Array:
    """How far each step is from the one before it, (steps,) in [0, 2]; see `Steps.turn`."""
    sizes = np.linalg.norm(dq, axis=1)
    turned = np.zeros(len(dq))
    if len(dq) > 1:
        larger = np.maximum(sizes[1:], sizes[:-1])
        apart = np.linalg.norm(np.diff(dq, axis=0), axis=1)
        turned[1:] = np.divide(apart, larger, out=np.zeros(len(larger)), where=larger > 0.0)
    return turned


def set_changes(active: NDArray[np.bool_]) -> Array:
    """How far each active set differs from the one before it, (steps,) in [0, 1]; see `Steps.change`."""
    changed = np.zeros(len(active))
    if len(active) > 1:
        either = (active[1:] | active[:-1]).sum(axis=1)
        differ = (active[1:] ^ active[:-1]).sum(axis=1)
        changed[1:] = differ / np.maximum(either, 1)
    return changed


def descent(run: Trajectory, states: Sequence[ArmState]) -> Descent:
    """In how many steps errors rose, and in how many even a short step would have raised them.

    Args:
        run: the run.
        states: the arm before each of its steps.
    """
    slack = STEADY * run.arm.length
    rises = np.greater(np.diff(run.point_errors, axis=0), slack / run.arm.n_modules)  # (steps, m)
    uphill = np.zeros((run.steps, run.arm.n_modules), dtype=bool)
    downhill = np.ones(run.steps, dtype=bool)
    for i, (state, dq) in enumerate(zip(states, displacements(run), strict=True)):
        slopes = error_slopes(state, run.target.points, run.target.placed, dq)
        size = float(np.abs(dq).max(initial=0.0)) * run.arm.length
        uphill[i] = slopes > STEADY * size
        downhill[i] = float(slopes.sum()) <= STEADY * size
    clipped = np.any(run.clipped, axis=1)
    free = run.active & ~np.any(run.clipped, axis=1, keepdims=True)
    return Descent(
        steps=run.steps,
        rose=int(np.count_nonzero(np.diff(run.posture_error) > slack)),
        uphill=int(np.count_nonzero(~downhill)),
        clipped=int(np.count_nonzero(clipped)),
        active=int(np.count_nonzero(run.active)),
        active_rose=int(np.count_nonzero(rises & run.active)),
        active_free=int(np.count_nonzero(free)),
        active_uphill=int(np.count_nonzero(uphill & free)),
        points_rose=int(np.count_nonzero(rises)),
    )


def error_slopes(state: ArmState, goals: Array, placed: NDArray[np.bool_], dq: Array) -> Array:
    """How fast the error of each control point changes along dq, (m,) [m per unit of the step].

    Args:
        state: where the arm is.
        goals: target positions, (m, 3) [m].
        placed: which control points have a target, (m,).
        dq: direction of motion, (nv,) [rad or m].
    """
    towards = goals - state.points
    distances = np.linalg.norm(towards, axis=1)
    moving = state.jacobians @ dq  # (m, 3)
    along = np.einsum("ki,ki->k", towards, moving)
    away = distances > 1e-12 * state.arm.length
    return np.where(placed & away, -along / np.where(away, distances, 1.0), 0.0)


def deficient_steps(run: Trajectory) -> int:
    """Steps whose posture control matrix is not of full row rank, as far as numbers can tell."""
    size = np.maximum(run.rows, run.arm.nv)
    full = run.sigma_min > size * np.finfo(float).eps * run.sigma_max
    return int(np.count_nonzero((run.rows > 0) & ~full))
