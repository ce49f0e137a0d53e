"""What the tests themselves must keep to."""

from __future__ import annotations

import re
from pathlib import Path

from sampling import examples, seeds

TESTS = Path(__file__).parent


def test_nothing_is_built_while_tests_are_collected(built_early: list[str]) -> None:
    assert built_early == []


def test_the_quick_set_draws_a_few_cases_of_each(pytestconfig) -> None:
    full = pytestconfig.getoption("full")
    assert [examples(count).max_examples for count in (3, 40, 700)] == ([3, 40, 700] if full else [3, 6, 8])
    assert [len(seeds(count)) for count in (2, 40)] == ([2, 40] if full else [2, 3])


def test_numbers_of_examples_are_left_to_the_sets() -> None:
    for path in TESTS.rglob("test_*.py"):
        assert not re.search(r"max_examples ?=", path.read_text(encoding="utf-8")), path.name
