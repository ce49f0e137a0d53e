"""Studies of arbitrary postures, and of targets by the change of heading."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import chain
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pinposture.arm import Arm, smooth_configuration
from pinposture.control import Controller
from pinposture.errors import UnknownName
from pinposture.motion.processes import Progress
from pinposture.placement import Target, resolve_targets
from pinposture.study.arms import Family, Subject, draw_case
from pinposture.study.baselines import named_controllers
from pinposture.study.record import Case, Record, Spread, check_study, grouped, run_all, run_case, spread
from pinposture.study.scenarios import bent_configuration, curve_along

# Many starts, targets and controllers: does it get there, how directly, and what does it do on the way.

COMPARED = ("geodesic", "selection", "projection", "switching", "lm", "joint")
"""The controllers that are compared unless others are named."""

CASES_OF_A_KIND = 1000
"""Number of cases for each arm unless told otherwise."""


def study_postures(
    subjects: Sequence[Subject],
    controllers: Sequence[str | Controller] = COMPARED,
    cases: int = CASES_OF_A_KIND,
    first_seed: int = 0,
    jobs: int = 1,
    progress: Progress | None = None,
) -> list[Record]:
    """Drive arms from every kind of start to every kind of target, with every controller.

    Cases are dealt to the families of an arm in turn, each with the next seed, so that a longer study begins
    with the cases of a shorter one, and all families get as many, or one more. A case depends on arm, family
    and seed alone, so that all controllers have the same ones.

    Args:
        subjects: the arms; see `built_subject` and `loaded_subject`.
        controllers: controllers, or their names.
        cases: number of cases for each arm.
        first_seed: seed of the first case of each family.
        jobs: number of processes; joblib's backends apply.
        progress: called with the number of cases finished so far, and that of all.

    Returns:
        The records in the order of arms, then cases, then controllers. But for `seconds` they depend on the
        arguments alone, not on `jobs`.

    Raises:
        InvalidValue: no arm, no controller, or numbers that make no sense.
        UnknownName: no controller has that name.
    """
    check_study(first_seed, cases=cases, subjects=subjects)
    listed = named_controllers(controllers)
    dealt = ((subject, *deal, listed) for subject in subjects for deal in _deal(subject, cases, first_seed))
    return list(chain.from_iterable(run_all(_run_one, dealt, jobs, progress)))


def _deal(subject: Subject, cases: int, first_seed: int) -> Iterator[tuple[Family, int]]:
    """Family and seed of each case."""
    families = subject.families
    for number in range(cases):
        rounds, place = divmod(number, len(families))
        yield families[place], first_seed + rounds


def _run_one(subject: Subject, family: Family, seed: int, controllers: list[Controller]) -> list[Record]:
    start, target = draw_case(subject, family, seed)
    return run_case(subject, Case(subject.name, *family, seed), start, target, controllers)


# The hardest axis: how far some part of the arm must turn between start and target.

Array = NDArray[np.float64]

KNOWLEDGE = ("configuration", "curve")

PAIRS = 300
"""Number of pairs for each arm unless told otherwise."""

HEADING = 4.2
"""Largest heading of a link in either posture of a planar arm, at most [rad]."""
BENDING = 0.6
"""Largest joint position in either posture of a spatial arm, at most [rad or m]."""

EDGES = (0.0, 2.0, np.pi, 4.0, 6.0, np.inf)
BINS = ("< 2", "2 - pi", "pi - 4", "4 - 6", "> 6")
"""The bins of the largest change of heading [rad], from each of `EDGES` up to, not including, the next."""


class Bin(NamedTuple):
    """What one controller made of the pairs whose change of heading is in one bin.

    Attributes:
        arm: name of the arm.
        bin: one of `BINS` [rad].
        controller: name of the controller.
        runs: number of runs.
        reached: how many of them ended below 1e-3 of the arm length and never left the limits.
        steps: number of steps of the runs that moved and came near; None if none did.
        path: length of the paths of their control points, relative to the direct distances.
    """

    arm: str
    bin: str
    controller: str
    runs: int
    reached: int
    steps: Spread | None
    path: Spread | None


def draw_pair(arm: Arm, seed: int) -> tuple[Array, Array]:
    """Two smooth configurations (nq,), each bent by a random amount so that all bins are populated.

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
    """Drive arms between random pairs of smooth postures, whatever the turn between them.

    Args:
        subjects: the arms; see `built_subject`.
        controllers: controllers, or their names.
        pairs: number of pairs for each arm.
        first_seed: seed of the first pair.
        knowledge: what is known of the target: its "configuration", or only the "curve" through the base and
            its control points, on which `resolve_targets` finds places and a configuration.
        jobs: number of processes; joblib's backends apply.
        progress: called with the number of pairs finished so far, and that of all.

    Returns:
        The records in the order of arms, then pairs, then controllers; `Record.target` is the knowledge.

    Raises:
        InvalidValue: no arm, no controller, or numbers that make no sense.
        UnknownName: no such controller or knowledge.
        TargetError: a curve on which some control point has no place.
    """
    check_study(first_seed, pairs=pairs, subjects=subjects)
    if knowledge not in KNOWLEDGE:
        raise UnknownName("knowledge of the target", knowledge, KNOWLEDGE)
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
    """The bin of a change of heading [rad]."""
    return BINS[int(np.searchsorted(EDGES, turn, side="right")) - 1]


def by_heading(records: Sequence[Record]) -> list[Bin]:
    """Count runs by their change of heading.

    Args:
        records: runs whose `turn` is known.

    Returns:
        One entry for each arm, controller and bin, in the order in which arms and controllers first appear;
        bins without runs included.
    """
    found = []
    for arm, own in grouped(records, lambda record: record.arm).items():
        for controller, those in grouped(own, lambda record: record.controller).items():
            for name in BINS:
                runs = [run for run in those if run.turn is not None and bin_of(run.turn) == name]
                reached = sum(run.near and run.lawful for run in runs)
                steps, path = spread(runs, lambda run: run.steps), spread(runs, lambda run: run.path)
                found.append(Bin(arm, name, controller, len(runs), reached, steps, path))
    return found
