"""How many random cases a test draws: a few in the quick set, all of them with `pytest --full`."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, TypeVar

from hypothesis import settings

Case = TypeVar("Case")

settings.register_profile("quick", deadline=None, derandomize=True, max_examples=8)
settings.register_profile("full", deadline=None, print_blob=True, max_examples=100)

_full = False


def draw_fully(full: bool) -> None:
    """Choose the set, before any test is imported.

    The quick set draws the same cases in every run, so that its verdict is that of the change under test.
    The full set draws new ones each time; a failure prints what repeats it.
    """
    global _full  # noqa: PLW0603
    _full = full
    settings.load_profile("full" if full else "quick")


def examples(count: int, **others: Any) -> settings:
    """Decorate a property test that draws `count` examples in the full set, a sixth in the quick one.

    At least three in the quick one, and no more than its profile says. `others` go to `hypothesis.settings`.
    """
    quick = min(count, max(3, count // 6), settings.get_profile("quick").max_examples)
    return settings(max_examples=count if _full else quick, **others)


def seeds(count: int) -> range:
    """Seeds for a loop or for `parametrize`: `count` in the full set, the first three in the quick one."""
    return range(count if _full else min(count, 3))


def cases(every: Iterable[Case], quick: int) -> list[Case]:
    """Cases of a parametrized test: all of them in the full set, the first few in the quick one."""
    listed = list(every)
    return listed if _full else listed[:quick]
