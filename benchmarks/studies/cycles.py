"""Repeatability: joint drift of an arm that repeats a closed cycle of postures."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from benchmarks.baselines import named_controllers
from benchmarks.cases.scenarios import arbitrary_configuration
from benchmarks.studies.arms import Subject
from benchmarks.studies.record import check_study, drive, final_error, run_all
from pinposture._validation import require_known
from pinposture.arm import Arm
from pinposture.control import Controller
from pinposture.motion.processes import Progress
from pinposture.placement import Target

Array = NDArray[np.float64]

CORNERS, ROUNDS_OF_A_CYCLE, CYCLES = 4, 5, 10
"""Number of postures of a cycle; default number of rounds, and of cycles for each arm."""

CLOSE = 1e-9
"""Mean point error, relative to the arm length, at which a posture of the cycle counts as reached."""

CYCLE_KNOWLEDGE = ("configuration", "points")


class Rounds(NamedTuple):
    """Result of several rounds of a closed cycle of postures.

    Attributes:
        drift: largest deviation of any joint from its initial position after each round, (rounds,), in
            `Arm.joint_units` [rad].
        error: largest final mean point error at any posture, relative to the arm length.
        steps: number of steps of all rounds.
    """

    drift: tuple[float, ...]
    error: float
    steps: int


class PostureCycle(NamedTuple):
    """`Rounds` with a description of the case.

    Attributes:
        arm: name of the arm.
        target: what is known of the postures: their "configuration", or only their "points".
        seed: seed of the cycle.
        drift, error, steps: see `Rounds`.
    """

    arm: str
    target: str
    seed: int
    drift: tuple[float, ...]
    error: float
    steps: int


def cycle_drift(
    arm: Arm,
    targets: Sequence[Target],
    q0: ArrayLike,
    rounds: int = ROUNDS_OF_A_CYCLE,
    controller: str | Controller = "geodesic",
) -> Rounds:
    """Repeat a closed cycle of postures and measure the joint drift.

    |dq| <= 0.1 rad per step, at most 400 steps to each posture, tolerance `CLOSE`. If a posture is not
    reached, the next run starts where the arm ended.

    Args:
        arm: the arm.
        targets: the postures in order.
        q0: start of the first round, (nq,): a configuration of the last posture.
        rounds: number of rounds.
        controller: a controller or its name.

    Raises:
        InvalidValue: no posture, an invalid configuration, or less than one round.
        UnknownName: no controller has that name.
    """
    check_study(rounds=rounds, targets=targets)
    chosen = named_controllers([controller])[0]
    first = q = arm.checked(q0, "q0")
    drift, errors, steps = [], [], 0
    for _ in range(rounds):
        for target in targets:
            run = drive(arm, target, q, chosen, tolerance=CLOSE)
            q, steps = run.q[-1], steps + run.steps
            errors.append(final_error(run))
        apart = np.abs(pin.difference(arm.model, first, q)) / arm.joint_units
        drift.append(float(apart.max()))
    return Rounds(tuple(drift), max(errors), steps)


def study_cycles(
    subjects: Sequence[Subject],
    knowledge: Sequence[str] = CYCLE_KNOWLEDGE,
    controller: str | Controller = "geodesic",
    cycles: int = CYCLES,
    rounds: int = ROUNDS_OF_A_CYCLE,
    first_seed: int = 0,
    jobs: int = 1,
    progress: Progress | None = None,
) -> list[PostureCycle]:
    """Repeat closed cycles of four arbitrary smooth postures with several arms.

    Args:
        subjects: the arms; see `built_subject`.
        knowledge: what is known of the postures, some of `CYCLE_KNOWLEDGE`.
        controller: a controller or its name.
        cycles: number of cycles for each arm and kind of knowledge.
        rounds: number of rounds of each cycle.
        first_seed: seed of the first cycle.
        jobs: number of processes; joblib's backends apply.
        progress: called with the numbers of finished and of all cycles.

    Returns:
        The cycles in the order of arms, then knowledge, then seeds; they do not depend on `jobs`.

    Raises:
        InvalidValue: no arm, no knowledge, or invalid numbers.
        UnknownName: no such knowledge or controller.
    """
    check_study(first_seed, cycles=cycles, rounds=rounds, subjects=subjects, knowledge=knowledge)
    for known in knowledge:
        require_known("knowledge of the target", known, CYCLE_KNOWLEDGE)
    seeds = range(first_seed, first_seed + cycles)
    cases = product(subjects, knowledge, seeds, [rounds], named_controllers([controller]))
    return run_all(_one, cases, jobs, progress)


def _one(subject: Subject, known: str, seed: int, rounds: int, controller: Controller) -> PostureCycle:
    arm, rng = subject.arm, np.random.default_rng(seed)
    corners = [arbitrary_configuration(arm, rng) for _ in range(CORNERS)]
    targets = [Target.from_configuration(arm, q) for q in corners]
    if known == "points":
        targets = [Target.from_points(arm, target.points) for target in targets]
    went = cycle_drift(arm, targets, corners[-1], rounds, controller)
    return PostureCycle(subject.name, known, seed, *went)
