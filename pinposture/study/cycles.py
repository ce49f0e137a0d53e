"""Repetitive motion: whether an arm that goes round a closed cycle of postures comes back as it began."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from pinposture.arm import Arm
from pinposture.control import Controller
from pinposture.errors import UnknownName
from pinposture.motion.processes import Progress
from pinposture.placement import Target
from pinposture.study.arms import Subject
from pinposture.study.baselines import named_controllers
from pinposture.study.record import check_study, drive, final_error, run_all
from pinposture.study.scenarios import arbitrary_configuration

Array = NDArray[np.float64]

CORNERS, ROUNDS_OF_A_CYCLE, CYCLES = 4, 5, 10
"""Postures of a cycle; rounds and number of cycles for each arm unless told otherwise."""

CLOSE = 1e-9
"""Mean point error, relative to the arm length, at which a posture of the cycle is taken."""

CYCLE_KNOWLEDGE = ("configuration", "points")


class Rounds(NamedTuple):
    """A closed cycle of postures, gone round several times.

    Attributes:
        drift: farthest that any joint is from where it began, after each round, (rounds,), in
            `Arm.joint_units` [rad].
        error: largest mean point error at the end of the way to any posture, relative to the arm length.
        steps: number of steps of all rounds.
    """

    drift: tuple[float, ...]
    error: float
    steps: int


class PostureCycle(NamedTuple):
    """The same, with what it was about.

    Attributes:
        arm: name of the arm.
        target: what is known of the postures: their "configuration", or the "points" only.
        seed: seed of the cycle.
        drift: see `Rounds`.
        error: see `Rounds`.
        steps: see `Rounds`.
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
    """Go round a closed cycle of postures, and see how far the joints drift.

    |dq| <= 0.1 rad per step, at most 400 steps to each posture, of which a mean point error of `CLOSE` is
    asked; what comes after a posture that is not reached begins where the arm got to.

    Args:
        arm: the arm.
        targets: the postures, in turn.
        q0: where the first round begins, (nq,): a configuration that takes the last of them.
        rounds: how often to go round.
        controller: a controller, or the name of one.

    Raises:
        InvalidValue: no posture, a configuration that does not fit, or less than one round.
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
    """Go round closed cycles of four arbitrary smooth postures with each of several arms.

    Args:
        subjects: the arms; see `built_subject`.
        knowledge: what is known of the postures, some of `CYCLE_KNOWLEDGE`.
        controller: a controller, or the name of one.
        cycles: number of cycles for each arm and kind of knowledge.
        rounds: how often to go round each.
        first_seed: seed of the first cycle.
        jobs: number of processes; joblib's backends apply.
        progress: called with the number of cycles finished so far, and that of all.

    Returns:
        The cycles in the order of arms, then knowledge, then seeds; they do not depend on `jobs`.

    Raises:
        InvalidValue: no arm, no knowledge, or numbers that make no sense.
        UnknownName: no such knowledge or controller.
    """
    check_study(first_seed, cycles=cycles, rounds=rounds, subjects=subjects, knowledge=knowledge)
    for known in knowledge:
        if known not in CYCLE_KNOWLEDGE:
            raise UnknownName("knowledge of the target", known, CYCLE_KNOWLEDGE)
    chosen = named_controllers([controller])[0]
    seeds = range(first_seed, first_seed + cycles)
    cases = (
        (subject, known, seed, rounds, chosen)
        for subject in subjects
        for known in knowledge
        for seed in seeds
    )
    return run_all(_one, cases, jobs, progress)


def _one(subject: Subject, known: str, seed: int, rounds: int, controller: Controller) -> PostureCycle:
    arm, rng = subject.arm, np.random.default_rng(seed)
    corners = [arbitrary_configuration(arm, rng) for _ in range(CORNERS)]
    targets = [Target.from_configuration(arm, q) for q in corners]
    if known == "points":
        targets = [Target.from_points(arm, target.points) for target in targets]
    went = cycle_drift(arm, targets, corners[-1], rounds, controller)
    return PostureCycle(subject.name, known, seed, *went)
