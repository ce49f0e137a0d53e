"""Runs of controllers with the settings that all studies share, and measures of them."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from time import perf_counter

import numpy as np

from benchmarks.baselines import named_controllers
from benchmarks.cases.scenarios import Scenario, case, largest_turn
from benchmarks.harness import Case, Problem, Row, Study
from pinposture.arm import Arm
from pinposture.control import Controller, Limits
from pinposture.errors import PostureError
from pinposture.motion import Run, track
from pinposture.motion.processes import Progress

STEP = 0.1
"""Largest |dq| of a step [rad or m]."""
MAX_STEPS = 400
TOLERANCE = 1e-6
"""Mean point error, relative to the arm length, at which a run has arrived."""
NEAR = 1e-3
"""Mean point error, relative to the arm length, that is often considered a success."""
RISE = 1e-9
"""Negligible rise of the posture error in one step, relative to the error at the start."""
WITHIN = 1e-9
"""Excess over a limit that counts as rounding error."""


def measure_controller(problem: Problem, controller: Controller) -> Row:
    """Run a controller on a problem, see `drive`, and return the columns of `measure_run`.

    If the controller rejects the arm or the target, the row is that of an arm that does not move, and its
    status "refused".
    """
    arm, start, target, _ = problem
    began = perf_counter()
    try:
        run = drive(problem, controller)
    except PostureError as error:
        away = np.linalg.norm(arm.at(start).points - target.points, axis=1)[target.has_target]
        return Row(
            controller=controller.name,
            status="refused",
            reason=one_line(str(error)),
            steps=0,
            error=float(away.mean()) / arm.length,
            rising=0.0,
            escaping=0.0,
            peak=1.0,
            path=1.0,
            turn=None if target.q is None else largest_turn(arm, start, target.q),
            seconds=0.0,
            violation=0.0,
            stride=0.0,
        )
    return measure_run(run, controller.name, perf_counter() - began)


def drive(problem: Problem, controller: str | Controller = "geodesic", tolerance: float = TOLERANCE) -> Run:
    """Run a controller: |dq| <= `STEP`, at most `MAX_STEPS` steps.

    It has converged when the mean point error is within the tolerance, relative to the arm length.
    """
    arm, start, target, scene = problem
    return track(
        arm,
        target,
        start,
        controller,
        Limits(step=STEP),
        scene=scene,
        max_steps=MAX_STEPS,
        tolerance=tolerance * arm.length,
    )


def measure_run(run: Run, controller: str, seconds: float = 0.0) -> Row:
    """Measure a run by a controller, given its wall time [s].

    Returns:
        controller: name of the controller.
        status: how the run ended, as `Run.status`.
        reason: explanation of the status on one line.
        steps: number of steps.
        error: mean point error at the end, relative to the arm length.
        rising: share of steps on which the posture error rises by more than `RISE`.
        escaping: share of steps on which it rises with the controller's consent.
        peak: largest posture error relative to that at the start; 1 if that was zero.
        path: path length of all control points relative to straight lines from start to end.
        turn: largest change of heading between start and target [rad], see `largest_turn`; None if no
            configuration of the target is known.
        seconds: wall time per step [s]; 0 if there was none.
        violation: largest violation of position limits, in `Arm.joint_units`.
        stride: largest |dq| of any joint relative to the step limit; 0 if there was no limit.
    """
    errors, steps = run.posture_error, run.steps
    rises = np.diff(errors) > RISE * errors[0]
    bound = run.limits.step
    dq = run.displacements
    return Row(
        controller=controller,
        status=run.status,
        reason=one_line(run.reason),
        steps=steps,
        error=final_error(run),
        rising=float(rises.mean()) if steps else 0.0,
        escaping=float((rises & run.error_increasing).mean()) if steps else 0.0,
        peak=float(errors.max() / errors[0]) if errors[0] > 0.0 else 1.0,
        path=run.path_length_ratio,
        turn=None if run.target.q is None else largest_turn(run.arm, run.q[0], run.target.q),
        seconds=seconds / max(steps, 1),
        violation=_violation(run),
        stride=0.0 if bound is None else float(np.max(np.abs(dq) / bound, initial=0.0)),
    )


def final_error(run: Run) -> float:
    """Return the mean point error at the end of a run, relative to the arm length."""
    return float(run.mean_error[-1]) / run.arm.length


def one_line(text: str) -> str:
    """Replace line breaks and repeated blanks by single blanks."""
    return " ".join(text.split())


def _violation(run: Run) -> float:
    """Return the largest violation of position limits of joints on the chain, in `Arm.joint_units`."""
    arm = run.arm
    own, positions = arm.columns, np.array([arm.positions(q) for q in run.q])
    outside = np.maximum(arm.limits.lower - positions, positions - arm.limits.upper) / arm.joint_units
    return float(max(outside[:, own].max(), 0.0))


# What is true of a row of `measure_run`.


def arrived(row: Row) -> bool:
    """Return whether the final error is within `ROW_PROGRAM.tolerance`."""
    return bool(row.error <= TOLERANCE * (1.0 + RISE))


def near(row: Row) -> bool:
    """Return whether the final error is within `NEAR`."""
    return bool(row.error < NEAR)


def lawful(row: Row) -> bool:
    """Return whether all joints and all steps stayed within their limits, up to rounding error."""
    return bool(row.violation <= WITHIN and row.stride <= 1.0 + WITHIN)


def telling(row: Row) -> bool:
    """Return whether a run moved and came near the target, so that its motion is meaningful."""
    return near(row) and bool(row.steps)


# Runs of the scenarios of the thesis.


def study_scenarios(
    arm: Arm,
    scenarios: Sequence[Scenario],
    controllers: Sequence[str | Controller],
    seeds: Sequence[int],
    max_steps: int = 200,
    jobs: int = 1,
    progress: Progress | None = None,
) -> list[Row]:
    """Run every controller on every seed of every scenario, for the columns of `outcome`.

    Returns:
        The rows, in the order of scenarios, then seeds, then controllers; independent of `jobs`.

    Raises:
        InvalidValue: no controller.
        UnknownName: no controller has that name.
    """
    cases = [
        Case({"scenario": scenario.name, "seed": seed}, partial(_scenario_problem, arm, scenario, seed))
        for scenario in scenarios
        for seed in seeds
    ]
    study = Study(cases, named_controllers(controllers), partial(_outcome_of, max_steps))
    return study.rows(jobs, progress)


def _scenario_problem(arm: Arm, scenario: Scenario, seed: int) -> Problem:
    return Problem(arm, *case(arm, scenario, seed))


def _outcome_of(max_steps: int, problem: Problem, controller: Controller) -> Row:
    run = track(problem.arm, problem.target, problem.start, controller, max_steps=max_steps)
    return outcome(run, controller.name)


def outcome(run: Run, controller: str) -> Row:
    """Summarise a run.

    Returns:
        controller: name of the controller.
        start_error: posture error at the start [m].
        final_error: posture error at the end [m].
        ratio: the latter relative to the former; 0 if that was zero.
        mean_share: mean point error at the end, relative to the arm length.
        steps: number of steps.
        status: how the run ended, as `Run.status`.
        first_points: active control points at the first step; 0 if there was none.
        last_points: active control points at the last step; 0 if there was none.
        rising: share of steps on which the posture error rose.
    """
    points = run.active.sum(axis=1)
    errors = run.posture_error
    first, last = float(errors[0]), float(errors[-1])
    return Row(
        controller=controller,
        start_error=first,
        final_error=last,
        ratio=last / first if first else 0.0,
        mean_share=last / int(run.target.has_target.sum()) / run.arm.length,
        steps=run.steps,
        status=run.status,
        first_points=int(points[0]) if len(points) else 0,
        last_points=int(points[-1]) if len(points) else 0,
        rising=float(np.mean(np.diff(errors) > 0.0)) if run.steps else 0.0,
    )
