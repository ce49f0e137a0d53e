"""The study that varies settings changes what the source declares, and nothing else."""

from __future__ import annotations

import ast

import pytest

from benchmarks.studies.settings import Setting, all_settings, compare, source_of, with_value

SOURCE = """
class Sizes(NamedTuple):
    least: float = 0.1
    steps: int = 3

class Both(NamedTuple):
    coarse: Sizes = Sizes(least=0.5)
    most: float = 2.0

BOTH = Both(most=4.0)
SIZES = Sizes()
"""


@pytest.mark.parametrize(
    ("place", "value", "before", "after"),
    [
        (("SIZES", "least"), 0.2, "least: float = 0.1", "least: float = 0.2"),
        (("SIZES", "steps"), 6, "steps: int = 3", "steps: int = 6"),
        (("BOTH", "most"), 8.0, "Both(most=4.0)", "Both(most=8.0)"),
        (("BOTH", "coarse", "least"), 1.0, "Sizes(least=0.5)", "Sizes(least=1.0)"),
    ],
)
def test_one_number_changes(place: tuple[str, ...], value: float, before: str, after: str) -> None:
    changed = ast.unparse(with_value(ast.parse(SOURCE), place, value))
    assert changed == ast.unparse(ast.parse(SOURCE)).replace(before, after)


def test_a_setting_that_the_source_does_not_declare_is_named() -> None:
    with pytest.raises(LookupError, match="does not declare length in Both"):
        with_value(ast.parse(SOURCE), ("BOTH", "length"), 1.0)


@pytest.mark.long
def test_all_settings_are_declared_in_their_sources() -> None:
    settings = all_settings()
    names = {each.name for each in settings}
    assert {"PLAN.task_gain", "DESCENTS.coarse.steps", "POSTURE_SEARCH.damping_share"} <= names
    for setting in settings[::10]:
        tree = ast.parse(source_of(setting.module).read_bytes())
        before = ast.unparse(tree)
        changed = ast.unparse(with_value(tree, setting.place, setting.times(2.0)))
        assert (changed != before) == (setting.times(2.0) != setting.value), setting.name


def test_multiples_of_whole_numbers_are_whole() -> None:
    assert Setting("module", ("A", "b"), 3).times(0.5) == 2
    assert Setting("module", ("A", "b"), 1).times(0.5) == 1
    assert Setting("module", ("A", "b"), 0.5).times(0.5) == 0.25


def test_what_moves_fails_and_takes_longer_is_told() -> None:
    before = {
        "run a": [10.0, 1.0],
        "run b": [4.0, 2.0],
        "plan c": [1.0, 1.5, 1.0, 0.1],
        "drives d": [9.0, 1e-3],
    }
    same = compare(before, before)
    assert same.moved == same.failed == 0
    assert same[2:] == pytest.approx([1.0] * 6)
    after = {"run a": [20.0, 1.0], "run b": [], "plan c": [2.0, 1.5, 0.0, 0.3], "drives d": [9.0, 1e-3]}
    other = compare(before, after)
    assert (other.moved, other.failed) == (3, 2)
    assert (other.steps, other.duration, other.length, other.time) == pytest.approx((2.0, 2.0, 1.0, 3.0))
