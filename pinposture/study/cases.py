"""Many starts and targets at once: what a controller does over a hundred seeds, not in one picture."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from joblib import delayed
from numpy.typing import NDArray

from pinposture.arm import Arm
from pinposture.control import Controller, Limits, controller_named
from pinposture.curve import Curve
from pinposture.errors import InvalidValue
from pinposture.motion import Trajectory, track
from pinposture.motion.processes import in_order
from pinposture.placement import Target, resolve_targets
from pinposture.study.turns import link_headings
from pinposture.thesis.curves import TARGET_CURVES
from pinposture.thesis.scenarios import Scenario

Array = NDArray[np.float64]

AMPLITUDES = (0.2, 1.0)
"""Range of the largest joint position of an arbitrary posture of a spatial arm [rad or m]."""

HEADINGS = (0.5, 1.5)
"""Range of the largest heading of a link in an arbitrary posture of a planar arm [rad]."""

SLIGHT_HEADINGS = (0.02, 0.06)
"""The same for a target curve that is almost straight [rad]."""

NEARLY = 1e-3
"""Largest joint position of a start that is almost straight [rad or m]."""


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
        """Final posture error relative to the one at the start; 0 if there was none."""
        return self.final_error / self.start_error if self.start_error else 0.0


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


def bent_configuration(arm: Arm, rng: np.random.Generator, heading: float) -> Array:
    """A smooth random configuration of a planar arm, told by how far its links turn from the base axis.

    A long arm that bends a little at each of its many joints rolls up. The heading of its links says how
    arbitrary its posture looks, whatever their number.

    Args:
        arm: a planar arm whose joints turn.
        rng: source of randomness.
        heading: largest angle between a link and the same link of the straight arm [rad].

    Returns:
        Configuration within the limits of the arm, (nq,).

    Raises:
        InvalidValue: a heading that is no finite number >= 0, or an arm that is not planar.
    """
    if not (np.isfinite(heading) and heading >= 0.0):
        raise InvalidValue("heading", heading, "a finite number >= 0 [rad]")
    if arm.dimension != 2:
        raise InvalidValue("arm", arm, "a planar arm")
    positions = arm.positions(smooth_configuration(arm, rng, 1.0))
    largest = float(np.abs(link_headings(arm, positions)).max())
    positions = positions * (heading / max(largest, 1e-300))
    return arm.configuration(np.clip(positions, arm.limits.lower, arm.limits.upper))


def case(arm: Arm, scenario: Scenario, seed: int) -> tuple[Array, Target]:
    """Start configuration and target of one seed.

    The seed draws how far a curve is rolled about a spatial arm, the start if it is not straight, and the
    target if it is not a fixed curve, in this order. Arbitrary postures of a spatial arm have their largest
    joint angle between 0.2 and 1.0 rad, those of a planar arm the largest heading between 0.5 and 1.5 rad.
    """
    rng = np.random.default_rng(seed)
    roll = rng.uniform(-np.pi, np.pi)
    if scenario.start == "straight":
        start = arm.straight()
    elif scenario.start == "near-straight":
        start = smooth_configuration(arm, rng, NEARLY)
    else:
        start = arbitrary_configuration(arm, rng)
    return start, _target(arm, scenario, start, roll, rng)


def arbitrary_configuration(arm: Arm, rng: np.random.Generator) -> Array:
    """An arbitrary non-singular configuration, as the starts of scenarios are drawn; see `case`."""
    if arm.dimension == 2:
        return bent_configuration(arm, rng, rng.uniform(*HEADINGS))
    return smooth_configuration(arm, rng, rng.uniform(*AMPLITUDES))


def _target(arm: Arm, scenario: Scenario, start: Array, roll: float, rng: np.random.Generator) -> Target:
    if scenario.target == "opposite":
        return Target.from_configuration(arm, arm.configuration(-arm.positions(start)))
    if scenario.target in ("random", "near-line"):
        if scenario.target == "random":
            goal = arbitrary_configuration(arm, rng)
        elif arm.dimension == 2:
            goal = bent_configuration(arm, rng, rng.uniform(*SLIGHT_HEADINGS))
        else:
            goal = smooth_configuration(arm, rng, NEARLY)
        if arm.dimension == 3:  # a curve that leaves the base at an angle makes two-joint modules zigzag
            return Target.from_configuration(arm, goal)
        return resolve_targets(arm, curve_along(arm, goal), placement="as_is")
    curve = TARGET_CURVES[scenario.arm, scenario.target]
    return resolve_targets(arm, curve, placement="align", roll=roll if arm.dimension == 3 else 0.0)


def curve_along(arm: Arm, q: Array) -> Curve:
    """The curve through the control points at a configuration, continued straight by two modules."""
    points = np.vstack([arm.chain.base, arm.at(q).points])
    on = points[-1] + np.outer((1.0, 2.0), points[-1] - points[-2])
    return Curve.points(np.vstack([points, on]))


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
    for result in in_order(tasks, jobs):
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
