"""Many starts and targets at once: what a controller does over a hundred seeds, not in one picture."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from joblib import Parallel, delayed
from numpy.typing import NDArray

from pinposture.arm import Arm
from pinposture.control import Controller, Limits, controller_named
from pinposture.errors import InvalidValue
from pinposture.motion import Trajectory, track
from pinposture.target import Target, resolve_targets
from pinposture.thesis.scenarios import Scenario

Array = NDArray[np.float64]


class Outcome(NamedTuple):
    """What came of one run.

    Attributes:
        scenario: name of the scenario.
        controller: name of the controller.
        seed: seed of the case.
        start_error: posture error at the start [m].
        final_error: posture error at the end [m].
        lowest_error: lowest posture error on the way [m].
        mean_share: mean point error at the end, relative to the arm length.
        steps: number of steps.
        status: how the run ended, as `Trajectory.status`.
        first_points: active control points at the first step; 0 if there was none.
        last_points: active control points at the last step; 0 if there was none.
        rising: share of steps on which the posture error rose.
    """

    scenario: str
    controller: str
    seed: int
    start_error: float
    final_error: float
    lowest_error: float
    mean_share: float
    steps: int
    status: str
    first_points: int
    last_points: int
    rising: float

    @property
    def ratio(self) -> float:
        """Final posture error relative to the one at the start."""
        return self.final_error / self.start_error


def smooth_configuration(arm: Arm, rng: np.random.Generator, amplitude: float) -> Array:
    """A random configuration that varies smoothly along the arm, as a relaxed arm would lie.

    The joints at the same place in their modules follow a sum of three sine waves along the arm with
    random phases; the largest angle is the amplitude.

    Args:
        arm: the arm.
        rng: source of randomness.
        amplitude: largest joint position [rad or m].

    Returns:
        Configuration within the limits of the arm, (nq,).
    """
    if not (np.isfinite(amplitude) and amplitude >= 0.0):
        raise InvalidValue("amplitude", amplitude, "a finite number >= 0 [rad or m]")
    along = np.linspace(0.0, 1.0, arm.n_modules)
    places = max(len(joints) for joints in arm.module_joints)
    waves = np.zeros((arm.n_modules, places))
    for place in range(places):
        for number in (1, 2, 3):
            waves[:, place] += (
                rng.normal() / number * np.sin(np.pi * number * along + rng.uniform(0, 2 * np.pi))
            )
    positions = np.zeros(arm.nv)
    for wave, joints in zip(waves, arm.chain.module_slices, strict=True):
        columns = arm.columns[joints]
        positions[columns] = wave[: len(columns)]
    positions *= amplitude / max(float(np.abs(positions).max()), 1e-300)
    return arm.configuration(np.clip(positions, arm.limits.lower, arm.limits.upper))


def case(arm: Arm, scenario: Scenario, seed: int) -> tuple[Array, Target]:
    """Start configuration and target of one seed.

    The seed draws the start (amplitude 0.2 to 1.0 rad) and how far the curve is rolled about the arm.
    """
    rng = np.random.default_rng(seed)
    roll = rng.uniform(-np.pi, np.pi)
    start = arm.straight()
    if scenario.start == "smooth":
        start = smooth_configuration(arm, rng, rng.uniform(0.2, 1.0))
    return start, resolve_targets(arm, scenario.curve, roll=roll)


def outcome(run: Trajectory, scenario: str, controller: str, seed: int) -> Outcome:
    """Summarise a run."""
    points = run.active.sum(axis=1)
    errors = run.posture_error
    return Outcome(
        scenario=scenario,
        controller=controller,
        seed=seed,
        start_error=float(errors[0]),
        final_error=float(errors[-1]),
        lowest_error=float(errors.min()),
        mean_share=float(errors[-1]) / int(run.target.placed.sum()) / run.arm.length,
        steps=run.steps,
        status=run.status,
        first_points=int(points[0]) if len(points) else 0,
        last_points=int(points[-1]) if len(points) else 0,
        rising=float(np.mean(np.diff(errors) > 0.0)) if run.steps else 0.0,
    )


def study(
    arm: Arm,
    scenarios: Sequence[Scenario],
    controllers: Sequence[str | Controller],
    seeds: Sequence[int],
    limits: Limits | None = None,
    max_steps: int = 200,
    jobs: int = 1,
    progress: Callable[[Outcome], object] | None = None,
) -> list[Outcome]:
    """Run every controller on every seed of every scenario.

    Args:
        arm: the arm.
        scenarios: where it starts and what it should become.
        controllers: controllers, or their names.
        seeds: seeds of the cases.
        limits: limits of each step; `Limits()` if None.
        max_steps: steps per run.
        jobs: number of processes; joblib's backends apply, so a cluster serves as well.
        progress: called with each outcome as it arrives.

    Returns:
        The outcomes, in the order of scenarios, then controllers, then seeds. They depend on the
        arguments alone, not on `jobs`.
    """
    listed = [controller_named(controller) for controller in controllers]
    todo = [(scenario, controller, seed) for scenario in scenarios for controller in listed for seed in seeds]
    outcomes = []
    tasks = (delayed(_one)(arm, *item, limits, max_steps) for item in todo)
    for result in Parallel(n_jobs=jobs, return_as="generator")(tasks):
        outcomes.append(result)
        if progress is not None:
            progress(result)
    return outcomes


def _one(
    arm: Arm, scenario: Scenario, controller: Controller, seed: int, limits: Limits | None, max_steps: int
) -> Outcome:
    start, target = case(arm, scenario, seed)
    run = track(arm, target, start, controller, limits, max_steps=max_steps)
    return outcome(run, scenario.name, controller.name, seed)
