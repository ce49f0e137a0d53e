"""docs/thesis.md: what it refers to exists, nothing of the thesis is missing, and its corrections hold."""

from __future__ import annotations

import re
from pathlib import Path
from pkgutil import resolve_name

import pytest

TESTS = Path(__file__).resolve().parents[1]
PAGE = (TESTS.parent / "docs/thesis.md").read_text()
MAP = PAGE.split("\n## Map\n")[1].split("\n## ")[0]
ROWS = [[cell.strip() for cell in line.strip("|").split("|")] for line in MAP.splitlines() if line[:1] == "|"]
ROWS = [row for row in ROWS if len(row) == 5 and row[0] != "thesis" and not row[0].startswith("---")]
QUOTED = re.findall(r"`([^`]+)`", PAGE)
ROOMS = ["arm", "curve", "placement", "control", "motion", "viz", "benchmarks", "thesis", "cli", "editor"]
LENGTHS = {"2": 16, "3": 4, "4": 8, "5": 10, "6": 17, "A": 6}


def numbers(key: str) -> list[str]:
    """What the first cell of a row is about; "(6.3) to (6.6)" is about four equations."""
    found: list[str] = []
    for kind, chapter, number, end in re.findall(
        r"(Table |Figure |Algorithm |\()([1-6A])(?:\.(\d+))?\)?(?: to \D*\d\.(\d+))?", key
    ):
        last = int(end or number or 0)
        found += [f"{kind}{chapter}.{i}" for i in range(int(number or 0), last + 1)]
    return found


def test_everything_that_has_a_number_is_in_the_map_once() -> None:
    expected = [f"({chapter}.{i + 1}" for chapter, count in LENGTHS.items() for i in range(count)]
    expected += ["Algorithm 1.0", "Algorithm 2.0", "Table 1.1", "Table A.1", "Table A.2"]
    expected += ["Figure 1.3", "Figure 5.1"]
    expected += [f"Figure {c}.{i}" for c, count in ((4, 8), (6, 12)) for i in range(1, count + 1)]
    assert sorted(each for row in ROWS for each in numbers(row[0])) == sorted(expected)


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row[0])
def test_every_row_says_where_it_is_and_what_checks_it(row: list[str]) -> None:
    key, what, where, test, against = row
    assert key and what
    if where.startswith("not "):
        assert (test, against) == ("", "")
    else:
        assert all(name.split(".")[0] in ROOMS for name in re.findall(r"`([^`]+)`", where))
        assert re.fullmatch(r"`[\w.]+`(, `[\w.]+`)*", where)
        assert re.fullmatch(r"`test_\w+\.py(::\w+)?`(, `test_\w+\.py(::\w+)?`)*", test)
        assert against


@pytest.mark.parametrize(
    "name", sorted({q for q in QUOTED if re.fullmatch(rf"({'|'.join(ROOMS)})\.[\w.]+", q)})
)
def test_every_name_exists(name: str) -> None:
    assert resolve_name(name if name.startswith("benchmarks.") else f"pinposture.{name}") is not None


@pytest.mark.parametrize("name", sorted({q for q in QUOTED if q.startswith("test_")}))
def test_every_test_exists(name: str) -> None:
    file, _, function = name.partition("::")
    (path,) = TESTS.rglob(file)
    wanted = rf"{function}\(" if function else "test_"
    assert re.search(rf"^def {wanted}", path.read_text(), re.MULTILINE)


@pytest.mark.parametrize(
    "topic",
    ["Adequacy", "kinds of singularity", "Denavit-Hartenberg", "Section 7.1", "Orientation Jacobians"],
)
def test_topics_without_a_number_are_in_the_map(topic: str) -> None:
    assert topic in MAP
