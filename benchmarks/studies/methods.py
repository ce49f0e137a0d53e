"""Comparison of methods: the measurable columns of Table 1.1."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Annotated

import numpy as np
import pinocchio as pin
import typer
from numpy.typing import NDArray

from benchmarks.baselines import named_controllers, register_baselines
from benchmarks.cases.families import built_subject
from benchmarks.harness import Case, Problem, Row, Study, check_study, median, share, summarise
from benchmarks.report import Report, StudyOptions, short, table
from pinposture.arm import Arm, smooth_configuration
from pinposture.cli.inputs import ARM, MOST_RUNS, MOTION, ArmOptions
from pinposture.cli.output import Cell, examples
from pinposture.control import CONTROLLERS, Controller, Limits
from pinposture.motion import track
from pinposture.placement import Target

Array = NDArray[np.float64]

REACHED = 1e-3
"""Mean point error, relative to the arm length, below which a run has reached its target."""

DISTANCES = (1e-1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6)
"""Distances from the straight arm at which steps are measured: largest joint motion [rad or sliding unit]."""


def compare_methods(
    arm: Arm, controllers: Sequence[str | Controller], seeds: Sequence[int], max_steps: int = 200
) -> Study:
    """Run every method from smooth random starts to smooth random targets, and back.

    Starts and targets are configurations with a largest joint position between 0.2 and 1.0, so that every
    target is reachable. All control points have a target; end-effector methods only use the last one.

    Args:
        arm: the arm.
        controllers: controllers or their names.
        seeds: seeds of the cases.
        max_steps: maximum number of steps in each direction.

    Raises:
        InvalidValue: no controller or no seed.
        UnknownName: no controller has that name.
    """
    listed = named_controllers(controllers)
    check_study(seeds=seeds)
    cases = [Case({"seed": seed}, partial(_draw, arm, seed)) for seed in seeds]
    return Study(cases, listed, partial(_measure, max_steps))


def _draw(arm: Arm, seed: int) -> tuple[Problem, int]:
    rng = np.random.default_rng(seed)
    start, goal = (smooth_configuration(arm, rng, rng.uniform(0.2, 1.0)) for _ in range(2))
    return Problem(arm, start, Target.from_configuration(arm, goal)), seed


def _measure(max_steps: int, drawn: tuple[Problem, int], controller: Controller) -> Row:
    """Run a method there and back.

    Returns:
        controller: name of the method.
        posture_error: final posture error, the sum over the control points, per arm length.
        end_effector_error: final distance of the last control point from its target, per arm length.
        mean_error: mean of the final point errors, per arm length.
        returned: largest joint deviation after moving from A to B and back to the posture of A, in
            `Arm.joint_units`. 0 for a repeatable motion.
        peaks: largest joint motion requested in a step without limits, in `Arm.joint_units`, per mean point
            error of one arm length, at each of `DISTANCES` from the straight arm, (6,). Unbounded growth
            means instability near singular postures. 0 if the method never moves.
    """
    (arm, start, there, _), seed = drawn
    back = Target.from_configuration(arm, start)
    run = track(arm, there, start, controller, max_steps=max_steps)
    errors = run.point_errors[-1] / arm.length
    again = track(arm, back, run.q[-1], controller, max_steps=max_steps)
    apart = pin.difference(arm.model, start, again.q[-1]) / arm.joint_units
    return Row(
        controller=controller.name,
        posture_error=float(errors.sum()),
        end_effector_error=float(errors[-1]),
        mean_error=float(errors.mean()),
        returned=float(np.abs(apart).max()),
        peaks=_peaks(arm, controller, there, seed),
    )


def _peaks(arm: Arm, controller: Controller, goal: Target, seed: int) -> tuple[float, ...]:
    """Return the largest requested motion per mean point error at each distance from the straight arm."""
    free = _without_limits(arm)  # otherwise the limits would cut the requested motion
    assert goal.q is not None
    target = Target.from_configuration(free, goal.q)
    straight = arm.positions(arm.straight())
    shape = arm.positions(smooth_configuration(free, np.random.default_rng((seed, 1)), 1.0))
    peaks = []
    for distance in DISTANCES:
        state = free.at(free.configuration(straight + distance * shape))
        step = controller.step(state, target, Limits(step=None))
        error = float(np.linalg.norm(target.points - state.points, axis=1).mean()) / arm.length
        peaks.append(float(np.abs(step.dq / arm.joint_units).max()) / error)
    return tuple(peaks)


def _without_limits(arm: Arm) -> Arm:
    """Return the same arm without joint position limits."""
    model = pin.Model(arm.model)
    model.lowerPositionLimit = np.full(arm.nq, -np.inf)
    model.upperPositionLimit = np.full(arm.nq, np.inf)
    return Arm(model, arm.control_points, arm.base_placement, characteristic_length=arm.characteristic_length)


def by_method(rows: Sequence[Row]) -> list[Row]:
    """Summarise runs by method: medians over the seeds, the share that reached, and the largest peaks."""
    return summarise(
        rows,
        ["controller"],
        runs=len,
        posture_error=median("posture_error"),
        end_effector_error=median("end_effector_error"),
        reached=share(lambda row: row.mean_error < REACHED),
        returned=median("returned"),
        peaks=lambda own: tuple(np.max([row.peaks for row in own], axis=0).tolist()),
    )


_COLUMNS = {
    "method": lambda row: row.controller,
    "posture error": lambda row: short(row.posture_error),
    "tip error": lambda row: short(row.end_effector_error),
    "reached": lambda row: f"{100 * row.reached:.0f} %",
    "returned [rad]": lambda row: short(row.returned),
}


def _peak(place: int) -> Callable[[Row], Cell]:
    return lambda row: short(row.peaks[place])


@examples(
    "make study STUDY=methods -- --seeds 5",
    "make study STUDY=methods -- arm.urdf --controllers switching,lm,dls --jobs 2",
    "make study STUDY=methods -- --seeds 5 --json",
)
def run(
    *,
    urdf: Annotated[
        str | None,
        typer.Argument(metavar="[URDF]", help="URDF file of an arm, or -; default: 20 RyRz modules, 1 m."),
    ] = None,
    arm_options: ArmOptions,
    controllers: Annotated[str | None, ARM("Methods to compare; default: all.", "NAME,...")] = None,
    seeds: Annotated[int, MOTION("Number of cases for each method.", "N", max=MOST_RUNS)] = 20,
    steps: Annotated[int, MOTION("Steps of each way.", "N")] = 200,
    options: StudyOptions,
) -> None:
    """Compare every method on the same arm: errors, peak joint motions, and repeatability.

    Runs go from smooth random starts to smooth random targets and back; values are medians over the cases.
    Errors are relative to the arm length; reached is the share of cases with a final mean point error below
    1e-3 of it. Returned is the largest distance of a joint from its start after the return. The peaks are the
    largest joint motion that a step without limits requests for an error of one arm length, at a distance of
    0.1 to 1e-5 rad from the straight arm: unbounded growth means instability near singular postures.
    """
    check_study(seeds=seeds, steps=steps)
    register_baselines()
    names = list(CONTROLLERS) if controllers is None else [name.strip() for name in controllers.split(",")]
    arm = built_subject("ryrz20").arm if urdf is None else arm_options.read(urdf)
    rows = options.run(compare_methods(arm, names, range(seeds), steps))
    summary = by_method(rows)
    asked = {"arm": arm.model.name, "seeds": seeds, "steps": steps, "distances": list(DISTANCES)}
    peaks = {f"peak at {DISTANCES[k]:g}": _peak(k) for k in range(0, len(DISTANCES), 2)}
    options.write(Report(rows, {**asked, "methods": summary}, [table({**_COLUMNS, **peaks}, summary)]))
