"""Work on several processes, with a count of what is finished."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from pinposture.motion.processes import in_order

Progress = Callable[[int, int], object]
"""Called with the number of cases finished so far, and that of all."""


def collect_results(tasks: Sequence[Any], jobs: int, progress: Progress | None = None) -> list[Any]:
    """Make calls of `joblib.delayed` on several processes; return their results in the same order."""
    results = []
    for result in in_order(tasks, jobs):
        results.append(result)
        if progress is not None:
            progress(len(results), len(tasks))
    return results
