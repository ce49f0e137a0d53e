"""Studies of arbitrary postures, and of the change of heading."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import chain
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from benchmarks.baselines import named_controllers
from benchmarks.cases.scenarios import curve_along
from benchmarks.studies.arms import Family, Subject, draw_case
from benchmarks.studies.record import Case, Record, Spread, check_study, grouped, run_all, run_case, spread
from pinposture._validation import require_known
from pinposture.arm import Arm, bent_configuration, smooth_configuration
from pinposture.control import Controller
from pinposture.motion.processes import Progress
from pinposture.placement import Target, resolve_targets

COMPARED = ("geodesic", "selection", "projection", "switching", "lm", "joint")
"""Controllers compared by default."""

CASES_OF_A_KIND = 1000
"""Default number of cases for each arm."""


def study_postures(
    subjects: Sequence[Subject],
    controllers: Sequence[str | Controller] = COMPARED,
    cases: int = CASES_OF_A_KIND,
    first_seed: int = 0,
    jobs: int = 1,
    progress: Progress | None = None,
) -> list[Record]:
    """Run all controllers from every kind of start to every kind of target.

    Cases cycle through the families of an arm with increasing seeds, so that a longer study begins with the
    cases of a shorter one, and the numbers of cases per family differ by at most one. A case depends only on
    arm, family and seed, so all controllers get the same ones.

    Args:
        subjects: the arms; see `built_subject` and `loaded_subject`.
        controllers: controllers or their names.
        cases: number of cases for each arm.
        first_seed: seed of the first case of each family.
        jobs: number of processes; joblib's backends apply.
        progress: called with the numbers of finished and of all cases.

    Returns:
        The records, ordered by arm, case, controller; apart from `seconds`, independent of `jobs`.

    Raises:
        InvalidValue: no arm, no controller, or invalid numbers.
        UnknownName: no controller has that name.
    """
    check_study(first_seed, cases=cases, subjects=subjects)
    listed = named_controllers(controllers)
    dealt = ((subject, *deal, listed) for subject in subjects for deal in _deal(subject, cases, first_seed))
    return list(chain.from_iterable(run_all(_run_one, dealt, jobs, progress)))


def _deal(subject: Subject, cases: int, first_seed: int) -> Iterator[tuple[Family, int]]:
    """Yield family and seed of each case."""
    families = subject.families
    for number in range(cases):
        rounds, place = divmod(number, len(families))
        yield families[place], first_seed + rounds


def _run_one(subject: Subject, family: Family, seed: int, controllers: list[Controller]) -> list[Record]:
    start, target = draw_case(subject, family, seed)
    return run_case(subject, Case(subject.name, *family, seed), start, target, controllers)


Array = NDArray[np.float64]

KNOWLEDGE = ("configuration", "curve")

PAIRS = 300
"""Default number of pairs for each arm."""

HEADING = 4.2
"""Upper bound of the largest heading of a link in a posture of a planar arm [rad]."""
BENDING = 0.6
"""Upper bound of the largest joint position in a posture of a spatial arm [rad or m]."""

EDGES = (0.0, 2.0, np.pi, 4.0, 6.0, np.inf)
BINS = ("< 2", "2 - pi", "pi - 4", "4 - 6", "> 6")
"""Bins of the largest change of heading [rad], from each of `EDGES` up to but excluding the next."""


class Bin(NamedTuple):
    """Results of one controller for the pairs with a change of heading in one bin.

    Attributes:
        arm: name of the arm.
        bin: one of `BINS` [rad].
        controller: name of the controller.
        runs: number of runs.
        reached: number of runs that ended below 1e-3 of the arm length and never left the limits.
        steps: number of steps of the runs that moved and came near; None if none did.
        path: path length of their control points relative to straight lines.
    """

    arm: str
    bin: str
    controller: str
    runs: int
    reached: int
    steps: Spread | None
    path: Spread | None


def draw_pair(arm: Arm, seed: int) -> tuple[Array, Array]:
    """Draw two smooth configurations (nq,), each bent by a random amount so that all bins are populated.

    The largest heading of a link of a planar arm is uniform up to `HEADING`, the largest joint position of a
    spatial arm up to `BENDING`.
    """
    rng = np.random.default_rng(seed)
    if arm.dimension == 2:
        start, goal = (bent_configuration(arm, rng, rng.uniform(0.0, HEADING)) for _ in range(2))
    else:
        start, goal = (smooth_configuration(arm, rng, rng.uniform(0.0, BENDING)) for _ in range(2))
    return start, goal


def study_headings(
    subjects: Sequence[Subject],
    controllers: Sequence[str | Controller] = COMPARED,
    pairs: int = PAIRS,
    first_seed: int = 0,
    knowledge: str = "configuration",
    jobs: int = 1,
    progress: Progress | None = None,
) -> list[Record]:
    """Run controllers between random pairs of smooth postures with any change of heading.

    Args:
        subjects: the arms; see `built_subject`.
        controllers: controllers or their names.
        pairs: number of pairs for each arm.
        first_seed: seed of the first pair.
        knowledge: what is known of the target: its "configuration", or only the "curve" through the base and
            its control points, on which `resolve_targets` places the arm.
        jobs: number of processes; joblib's backends apply.
        progress: called with the numbers of finished and of all pairs.

    Returns:
        The records in the order of arms, then pairs, then controllers; `Record.target` is the knowledge.

    Raises:
        InvalidValue: no arm, no controller, or invalid numbers.
        UnknownName: no such controller or knowledge.
        TargetError: some control point cannot be placed on a curve.
    """
    check_study(first_seed, pairs=pairs, subjects=subjects)
    require_known("knowledge of the target", knowledge, KNOWLEDGE)
    listed = named_controllers(controllers)
    seeds = range(first_seed, first_seed + pairs)
    pairs_drawn = ((subject, seed, knowledge, listed) for subject in subjects for seed in seeds)
    return list(chain.from_iterable(run_all(_run_pair, pairs_drawn, jobs, progress)))


def _run_pair(subject: Subject, seed: int, knowledge: str, controllers: list[Controller]) -> list[Record]:
    arm = subject.arm
    start, goal = draw_pair(arm, seed)
    if knowledge == "configuration":
        target = Target.from_configuration(arm, goal)
    else:
        target = resolve_targets(arm, curve_along(arm, goal), placement="as_is")
    return run_case(subject, Case(subject.name, "bent", knowledge, seed), start, target, controllers)


def bin_of(turn: float) -> str:
    """Return the bin of a change of heading [rad]."""
    return BINS[int(np.searchsorted(EDGES, turn, side="right")) - 1]


def by_heading(records: Sequence[Record]) -> list[Bin]:
    """Count runs with known `turn` by their change of heading.

    Returns:
        One entry for each arm, controller and bin, in order of first appearance of arms and controllers;
        empty bins are included.
    """
    found = []
    for (arm, controller), own in grouped(records, lambda run: (run.arm, run.controller)).items():
        for name in BINS:
            runs = [run for run in own if run.turn is not None and bin_of(run.turn) == name]
            reached = sum(run.near and run.lawful for run in runs)
            steps, path = spread(runs, lambda run: run.steps), spread(runs, lambda run: run.path)
            found.append(Bin(arm, name, controller, len(runs), reached, steps, path))
    return found
