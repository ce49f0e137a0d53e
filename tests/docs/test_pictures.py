"""The pictures of the documentation: made by one script, small, all of them used."""

from __future__ import annotations

import re
import runpy
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

DOCS = Path(__file__).parents[2] / "docs"
CONCEPTS = (
    *("modules", "target", "ellipsoids", "active", "direct", "limits", "scene", "wrapped"),
    *("clutter", "between", "helix", "keyframes"),
)


@pytest.fixture(scope="module")
def script() -> dict[str, Any]:
    return runpy.run_path(str(DOCS / "pictures.py"))


def test_each_picture_is_made_by_the_script_small_and_shown_somewhere(script: dict[str, Any]) -> None:
    files = sorted((DOCS / "pictures").glob("*.png"))
    assert tuple(script["CONCEPTS"]) == CONCEPTS
    assert {path.stem for path in files} == {*CONCEPTS, *script["EXAMPLES"], *script["ANIMATIONS"]}
    pages = "".join(path.read_text() for path in (DOCS.parent / "README.md", *DOCS.rglob("*.md")))
    for path in files:
        assert path.stat().st_size < 120_000
        assert f"pictures/{path.name})" in pages


def test_every_other_picture_is_shown_and_has_a_command_that_draws_it(script: dict[str, Any]) -> None:
    beside = {path.name for kind in ("png", "gif", "svg", "jpg") for path in DOCS.glob(f"*.{kind}")}
    assert beside == {*script["MEASURED"], "dragging.gif", "wrapping.gif", "operating.gif"}
    pages = "".join(path.read_text() for path in (DOCS.parent / "README.md", *DOCS.rglob("*.md")))
    for name in beside:
        assert re.search(rf"[(/]{re.escape(name)}\)", pages)
    for command in script["MEASURED"].values():
        program, what, *_ = command.split()
        assert program == "make" and what in ("bench", "study", "reproduce")
    folders = {path.parent.name for path in DOCS.rglob("*.png")}
    assert folders == {"docs", "pictures", "screenshots"}  # the last by the tests of the editor


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


def test_the_film_of_the_wrap_is_whole() -> None:
    with Image.open(DOCS / "wrapping.gif") as kept:
        assert kept.n_frames > 60


@pytest.mark.pictures
def test_a_frame_of_an_animation_can_be_taken(script: dict[str, Any], tmp_path: Path) -> None:
    pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    if shutil.which("chromium") is None:
        pytest.skip("no Chromium on this machine")
    drawn = np.asarray(Image.open(script["draw"]("first_posture", tmp_path)).convert("L"), dtype=float)
    kept = np.asarray(Image.open(DOCS / "pictures" / "first_posture.png").convert("L"), dtype=float)
    assert np.abs(drawn - kept).mean() < 5.0


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
