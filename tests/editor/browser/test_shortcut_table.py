"""The table of keys in docs/editor.md has all of them, and says what each does. No browser."""

from __future__ import annotations

import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

pytest.importorskip("viser", reason="viser is not installed")

from pinposture.editor.ui.page import shortcuts

pytestmark = pytest.mark.browser

PAGE = Path(__file__).parents[3] / "docs" / "editor.md"
NAMES = {
    "cmd/ctrl": "Ctrl",
    "arrowright": "→",
    "arrowleft": "←",
    "arrowup": "↑",
    "arrowdown": "↓",
    "escape": "Esc",
}


def written(key: str, modifier: str | None) -> str:
    """A key as the table has it: `Ctrl` `Shift` `Z`."""
    held = modifier.split("+") if modifier else []
    return " ".join(f"`{NAMES.get(part, part.capitalize())}`" for part in (*held, key))


def test_the_table_has_every_key() -> None:
    section = PAGE.read_text().split("## Keyboard\n")[1].split("\n## ")[0]
    rows = re.findall(r"^\| (`[^|]*`) +\| ([^|]+?) +\|$", section, re.MULTILINE)
    files = cast(Any, SimpleNamespace(save=None))
    assert rows == [(written(each.key, each.modifier), each.label) for each in shortcuts(files, files.save)]
