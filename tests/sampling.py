"""How many random cases a test draws: a few in the quick set, all of them with `pytest --full`."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from types import CodeType
from typing import Any, TypeVar

import pytest
from hypothesis import HealthCheck, settings
from hypothesis.internal.conjecture import providers

Case = TypeVar("Case")

_slow = [HealthCheck.too_slow]
# The default profile by name: where the environment says CI, another is loaded, which ignores seeds.
_plain = settings(settings.get_profile("default"), deadline=None, suppress_health_check=_slow)
settings.register_profile("quick", _plain, derandomize=True, database=None, max_examples=8)
settings.register_profile("full", _plain, print_blob=True, max_examples=100)
settings.register_profile("seeded", settings.get_profile("full"), database=None, max_examples=33)

_full = False
_seeded = False


def draw_fully(full: bool, repeatable: bool) -> None:
    """Choose the set, before any test is imported.

    The quick set draws the same cases in every run, so that its verdict is that of the change under test.
    The full set draws new ones each time; a failure prints what repeats it. With a seed, where a run has no
    news for the next, it draws a third as many.
    """
    global _full, _seeded  # noqa: PLW0603
    _full = full
    _seeded = full and repeatable
    settings.load_profile("quick" if not full else "seeded" if repeatable else "full")
    if repeatable and hasattr(providers, "_get_local_constants"):
        # Hypothesis also draws constants from the source of loaded modules, even with a seed. Cases would
        # depend on the text of the library, and on which tests ran before. It has no setting for this.
        none = providers.Constants()
        providers._get_local_constants = lambda: none


def examples(count: int, **others: Any) -> settings:
    """Decorate a property test that draws `count` examples in the full set, a sixth in the quick one.

    A third of them in the full set with a seed. At least three in any, and no more in the quick one than its
    profile says. `others` go to `hypothesis.settings`.
    """
    if _full and not _seeded:
        return settings(max_examples=count, **others)
    drawn = min(count, max(3, count // (3 if _full else 6)))
    if not _full:
        drawn = min(drawn, settings.get_profile("quick").max_examples)
    return settings(max_examples=drawn, **others)


class Cases(list[Case]):
    """Cases of a test; `quick` is how many of them the quick set has, from the first."""

    quick: int


def cases(every: Iterable[Case], quick: int) -> Cases[Case]:
    """Cases of a test, for `parametrize`: all of them in the full set, the first few in the quick one."""
    listed = list(every)
    chosen = Cases(listed if _full else listed[:quick])
    chosen.quick = quick
    return chosen


def seeds(count: int) -> Cases[int]:
    """Seeds for `parametrize`, or for a loop in a test: `count` in the full set, three in the quick one."""
    return cases(range(count), 3)


def draws_more(test: pytest.Item) -> bool:
    """Whether the full set runs more of a test than the quick set: other cases, or more of them."""
    if not isinstance(test, pytest.Function):
        return False
    if getattr(test.function, "is_hypothesis_test", False) or "seeds" in names_in(test.function.__code__):
        return True
    for mark in test.iter_markers("parametrize"):
        names, values = mark.args
        names = [name.strip() for name in names.split(",")] if isinstance(names, str) else names
        if isinstance(values, Cases) and not any(
            _is_case(test.callspec.params, names, case) for case in values[: values.quick]
        ):
            return True
    return False


def _is_case(parameters: Mapping[str, Any], names: Sequence[str], case: Any) -> bool:
    """Whether parameters are those of a case; their indices count the cases of all decorators together."""
    if isinstance(case, type(pytest.param())):
        case = case.values
    elif len(names) == 1:
        case = (case,)
    return all(parameters[name] is value for name, value in zip(names, case, strict=True))


def names_in(code: CodeType) -> set[str]:
    """Names that a function uses, also in comprehensions."""
    inner = (names_in(each) for each in code.co_consts if isinstance(each, CodeType))
    return set(code.co_names).union(*inner)
