"""Work on several processes, its results in order."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

from joblib import Parallel

from pinposture.control.checks import is_whole
from pinposture.errors import InvalidValue


def check_jobs(jobs: int) -> None:
    """Raise InvalidValue unless that can be a number of processes."""
    if not (is_whole(jobs) and (jobs >= 1 or jobs == -1)):
        raise InvalidValue("jobs", jobs, "a whole number of at least 1, or -1 for all there can be")


def in_order(tasks: Iterable[Any], jobs: int) -> Iterator[Any]:
    """The results of delayed calls in the order of the calls, each as soon as those before it are there.

    Args:
        tasks: calls made with `joblib.delayed`.
        jobs: number of processes; joblib's backends apply, so a cluster serves as well.

    Raises:
        InvalidValue: not a number of processes.
    """
    check_jobs(jobs)
    return iter(Parallel(n_jobs=jobs, return_as="generator")(tasks))
