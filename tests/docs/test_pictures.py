"""The pictures of the documentation: made by one script, small, all of them used."""

from __future__ import annotations

import re
import runpy
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

DOCS = Path(__file__).parents[2] / "docs"
CONCEPTS = (
    *("modules", "target", "ellipsoids", "active", "direct", "limits", "scene", "clutter", "between"),
)


@pytest.fixture(scope="module")
def script() -> dict[str, Any]:
    return runpy.run_path(str(DOCS / "pictures.py"))


def test_each_picture_is_made_by_the_script_small_and_shown_somewhere(script: dict[str, Any]) -> None:
    files = sorted((DOCS / "pictures").glob("*.png"))
    assert tuple(script["CONCEPTS"]) == CONCEPTS
    assert {path.stem for path in files} == {*CONCEPTS, *script["EXAMPLES"]}
    pages = "".join(path.read_text() for path in DOCS.rglob("*.md"))
    for path in files:
        assert path.stat().st_size < 120_000
        assert f"pictures/{path.name})" in pages


def test_every_picture_has_words_for_those_who_cannot_see_it() -> None:
    for page in DOCS.rglob("*.md"):
        assert all(len(words) > 10 for words in re.findall(r"!\[([^\]]*)\]", page.read_text())), page.name


@pytest.mark.pictures
def test_the_drag_can_be_drawn_and_is_what_is_kept(script: dict[str, Any]) -> None:
    drawn = script["dragging"](5)
    with Image.open(DOCS / "dragging.gif") as kept:
        assert kept.n_frames == script["FRAMES"]
        for k, frame in enumerate(drawn):
            kept.seek(k)
            difference = np.asarray(frame.convert("L"), float) - np.asarray(kept.convert("L"), float)
            assert np.abs(difference).mean() < 3.0


@pytest.mark.pictures
@pytest.mark.parametrize("name", CONCEPTS)
def test_a_concept_can_be_drawn_and_is_what_is_kept(
    script: dict[str, Any], name: str, tmp_path: Path
) -> None:
    drawn, kept = (
        np.asarray(Image.open(path).convert("L").resize((99, 40)), dtype=float)
        for path in (script["draw"](name, tmp_path), DOCS / "pictures" / f"{name}.png")
    )
    # Fonts differ from version to version, shapes do not.
    assert drawn.std() > 5.0
    assert np.abs(drawn - kept).mean() < 5.0
