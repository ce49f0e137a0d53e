"""Many starts, targets and controllers: does it get there, how directly, and what does it do on the way."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any

from joblib import delayed

from pinposture._validation import require_whole
from pinposture.control import Controller, controller_named
from pinposture.errors import InvalidValue
from pinposture.motion.processes import in_order
from pinposture.study.families import Family, Subject, draw_case
from pinposture.study.record import Case, Record, run_case

CONTROLLERS = ("qp", "selection", "projection", "switching", "lm", "joint")
"""The controllers that are compared unless others are named."""

CASES = 1000
"""Number of cases for each arm unless told otherwise."""

Progress = Callable[[int, int], object]


def study_postures(
    subjects: Sequence[Subject],
    controllers: Sequence[str | Controller] = CONTROLLERS,
    cases: int = CASES,
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
        jobs: number of processes; joblib's backends apply, so that `joblib.parallel_config` around the call
            takes it to a cluster.
        progress: called with the number of cases finished so far, and that of all.

    Returns:
        The records in the order of arms, then cases, then controllers. But for `seconds` they depend on the
        arguments alone, not on `jobs`.

    Raises:
        InvalidValue: no arm, no controller, or numbers that make no sense.
        UnknownName: no controller has that name.
    """
    require_whole("cases", cases, 1)
    require_whole("first_seed", first_seed, 0)
    listed = named_controllers(controllers)
    if len(subjects) == 0:
        raise InvalidValue("subjects", list(subjects), "at least one arm")
    dealt = [(subject, *deal) for subject in subjects for deal in _deal(subject, cases, first_seed)]
    tasks = (delayed(_one)(*each, listed) for each in dealt)
    return gather_records(tasks, len(dealt), jobs, progress)


def named_controllers(controllers: Sequence[str | Controller]) -> list[Controller]:
    """The controllers of these names; raises InvalidValue if there is none at all."""
    if len(controllers) == 0:
        raise InvalidValue("controllers", list(controllers), "at least one")
    return [controller_named(controller) for controller in controllers]


def gather_records(
    tasks: Iterable[Any], total: int, jobs: int, progress: Progress | None = None
) -> list[Record]:
    """All records of delayed calls that return those of one case each, in the order of the calls.

    Args:
        tasks: calls made with `joblib.delayed`.
        total: number of calls.
        jobs: number of processes.
        progress: called with the number of cases finished so far, and that of all.
    """
    records: list[Record] = []
    for done, found in enumerate(in_order(tasks, jobs), 1):
        records += found
        if progress is not None:
            progress(done, total)
    return records


def _deal(subject: Subject, cases: int, first_seed: int) -> Iterator[tuple[Family, int]]:
    """Family and seed of each case."""
    families = subject.families
    for number in range(cases):
        rounds, place = divmod(number, len(families))
        yield families[place], first_seed + rounds


def _one(subject: Subject, family: Family, seed: int, controllers: list[Controller]) -> list[Record]:
    start, target = draw_case(subject, family, seed)
    return run_case(subject, Case(subject.name, *family, seed), start, target, controllers)
