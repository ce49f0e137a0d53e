"""Repeatability: joint drift of an arm that repeats a closed cycle of postures."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Annotated, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from benchmarks.baselines import named_controllers
from benchmarks.cases.families import BUILT, Subject, built_subject
from benchmarks.cases.scenarios import arbitrary_configuration
from benchmarks.harness import Case, Problem, Row, Study, check_study, grouped
from benchmarks.report import ArmsOption, Report, SeedOption, StudyOptions, short, split_names
from benchmarks.studies.runs import drive, final_error
from pinposture._validation import require_known
from pinposture.arm import Arm
from pinposture.cli.inputs import MOST_RUNS, MOTION, ControllerOption
from pinposture.cli.output import examples
from pinposture.control import Controller
from pinposture.placement import Target

Array = NDArray[np.float64]

CORNERS, ROUNDS_OF_A_CYCLE, CYCLES = 4, 5, 10
"""Number of postures of a cycle; default number of rounds, and of cycles for each arm."""

CLOSE = 1e-9
"""Mean point error, relative to the arm length, at which a posture of the cycle counts as reached."""

CYCLE_KNOWLEDGE = ("configuration", "points")


class Cycle(NamedTuple):
    """A closed cycle of postures, and a configuration of the last of them, (nq,), where it starts."""

    arm: Arm
    targets: Sequence[Target]
    start: Array


def study_cycles(
    subjects: Sequence[Subject],
    knowledge: Sequence[str] = CYCLE_KNOWLEDGE,
    controller: str | Controller = "geodesic",
    cycles: int = CYCLES,
    rounds: int = ROUNDS_OF_A_CYCLE,
    first_seed: int = 0,
) -> Study:
    """Repeat closed cycles of four arbitrary smooth postures with several arms.

    Args:
        subjects: the arms; see `built_subject`.
        knowledge: what is known of the postures, some of `CYCLE_KNOWLEDGE`; the column "target".
        controller: a controller or its name.
        cycles: number of cycles for each arm and kind of knowledge.
        rounds: number of rounds of each cycle.
        first_seed: seed of the first cycle.

    Raises:
        InvalidValue: no arm, no knowledge, or invalid numbers.
        UnknownName: no such knowledge or controller.
    """
    check_study(first_seed, cycles=cycles, rounds=rounds, subjects=subjects, knowledge=knowledge)
    for known in knowledge:
        require_known("knowledge of the target", known, CYCLE_KNOWLEDGE)
    cases = [
        Case({"arm": subject.name, "target": known, "seed": seed}, partial(_draw, subject.arm, known, seed))
        for subject in subjects
        for known in knowledge
        for seed in range(first_seed, first_seed + cycles)
    ]
    return Study(cases, named_controllers([controller]), partial(_measure, rounds))


def _draw(arm: Arm, known: str, seed: int) -> Cycle:
    rng = np.random.default_rng(seed)
    corners = [arbitrary_configuration(arm, rng) for _ in range(CORNERS)]
    targets = [Target.from_configuration(arm, q) for q in corners]
    if known == "points":
        targets = [Target.from_points(arm, target.points) for target in targets]
    return Cycle(arm, targets, corners[-1])


def _measure(rounds: int, cycle: Cycle, controller: Controller) -> Row:
    return cycle_drift(*cycle, rounds=rounds, controller=controller)


def cycle_drift(
    arm: Arm,
    targets: Sequence[Target],
    q0: ArrayLike,
    rounds: int = ROUNDS_OF_A_CYCLE,
    controller: str | Controller = "geodesic",
) -> Row:
    """Repeat a closed cycle of postures and measure the joint drift.

    |dq| <= 0.1 rad per step, at most 400 steps to each posture, tolerance `CLOSE`. If a posture is not
    reached, the next run starts where the arm ended.

    Args:
        arm: the arm.
        targets: the postures in order.
        q0: start of the first round, (nq,): a configuration of the last posture.
        rounds: number of rounds.
        controller: a controller or its name.

    Returns:
        drift: largest deviation of any joint from its initial position after each round, (rounds,), in
            `Arm.joint_units` [rad].
        error: largest final mean point error at any posture, relative to the arm length.
        steps: number of steps of all rounds.

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
            run = drive(Problem(arm, q, target), chosen, CLOSE)
            q, steps = run.q[-1], steps + run.steps
            errors.append(final_error(run))
        apart = np.abs(pin.difference(arm.model, first, q)) / arm.joint_units
        drift.append(float(apart.max()))
    return Row(drift=tuple(drift), error=max(errors), steps=steps)


@examples(
    "make study STUDY=cycles -- --arms ryrz20 --cycles 3",
    "make study STUDY=cycles -- --rounds 10 --jobs 2",
    "make study STUDY=cycles -- --cycles 2 --json",
)
def run(
    *,
    arms: ArmsOption = None,
    controller: ControllerOption = "geodesic",
    cycles: Annotated[int, MOTION("Number of cycles for each arm and knowledge.", "N", max=MOST_RUNS)] = 10,
    rounds: Annotated[int, MOTION("Rounds of each cycle.", "N", max=MOST_RUNS)] = 5,
    seed0: SeedOption = 0,
    options: StudyOptions,
) -> None:
    """Repeat closed cycles of four random smooth postures, and report the drift of the joints.

    The first round begins in the last posture. Drift is the largest distance of a joint from its start after
    each round [rad], in the worst cycle. Postures are defined by their configurations, or only by their
    control points. At most 0.1 rad per step and joint, and 400 steps from one posture to the next, until the
    mean point error is below 1e-9 of the arm length.
    """
    subjects = [built_subject(name) for name in split_names("--arms", arms, BUILT)]
    rows = options.run(study_cycles(subjects, CYCLE_KNOWLEDGE, controller, cycles, rounds, seed0), "cycle")
    lines = []
    for (arm, known), own in grouped(rows, lambda row: (row.arm, row.target)).items():
        taken = f"all in {sum(row.error <= CLOSE for row in own)} of {len(own)}"
        worst = [max(drifts) for drifts in zip(*(row.drift for row in own), strict=True)]
        lines.append((arm, known, len(own), taken, *map(short, worst)))
    headings = [f"round {number + 1}" for number in range(rounds)]
    asked = {"study": "cycles", "controller": controller, "cycles": cycles, "rounds": rounds, "seed0": seed0}
    heads = ("arm", "known", "cycles", "postures taken", *headings)
    options.write(Report(rows, {**asked, "runs": rows}, [(heads, lines)]))
