"""The site builds without a warning, and every link in it leads somewhere."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest
from docs.links import dead_links

from pinposture.viz.palette import THEME

pytestmark = pytest.mark.site

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
BEHIND = {"editor": ("Session", "Shape", "Live")}
"""What else a page shows: what the attributes of public classes are, where a program needs to know."""


def test_the_site_builds_and_every_link_in_it_leads_somewhere(tmp_path: Path) -> None:
    reason = "the packages of the extra [docs] are not installed"
    for package in ("mkdocs", "material", "mkdocstrings_handlers"):
        pytest.importorskip(package, reason=reason)
    build = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(tmp_path / "site")]
    quiet = {**os.environ, "NO_MKDOCS_2_WARNING": "1"}  # an announcement of the theme's
    built = subprocess.run(build, cwd=ROOT, env=quiet, capture_output=True, text=True, check=False)
    assert built.returncode == 0, built.stderr
    assert not re.search("^(WARNING|ERROR)", built.stderr, re.MULTILINE), built.stderr
    assert dead_links(tmp_path / "site") == []
    for page in DOCS.rglob("*.md"):
        assert (tmp_path / "site" / page.relative_to(DOCS)).with_suffix(".html").exists()
    for page in DOCS.glob("api/*.md"):  # what is asked for is there
        shown = (tmp_path / "site/api" / f"{page.stem}.html").read_text()
        for name in api(page.stem):
            assert re.search(rf'<h2 id="pinposture\.[\w.]*\b{name}" class="doc', shown), name


def test_the_colours_are_those_of_the_pictures() -> None:
    known = {value.lower() for value in THEME if isinstance(value, str)}
    known |= {color.lower() for color in THEME.modules + THEME.spare}
    known |= {color.lower() for color in THEME.controllers.values()}
    used = re.findall(r"#[0-9a-f]{6}", (DOCS / "style.css").read_text())
    assert len(used) > 5
    assert set(used) <= known


def api(part: str) -> list[str]:
    """The names that the page of a part of the library shows."""
    shown = re.findall(r"^::: (pinposture\.\S+)$", (DOCS / "api" / f"{part}.md").read_text(), re.MULTILINE)
    assert all(name.startswith(f"pinposture.{part}.") for name in shown)
    return [name.rpartition(".")[2] for name in shown]


def test_every_part_of_the_library_has_a_page_of_its_api() -> None:
    inner = {"cli", "kernels", "thesis"}  # a command, a part for developers, data
    rooms = {path.parent.name for path in (ROOT / "pinposture").glob("*/__init__.py")} - inner
    assert {page.stem for page in DOCS.glob("api/*.md")} == rooms | {"errors", "index"}


@pytest.mark.parametrize("part", sorted(page.stem for page in DOCS.glob("api/*.md") if page.stem != "index"))
def test_the_page_of_a_part_shows_all_public_names(part: str) -> None:
    module = import_module(f"pinposture.{part}")
    kinds = [name for name, kind in vars(module).items() if isinstance(kind, type) and name[0] != "_"]
    own = [name for name in kinds if vars(module)[name].__module__ == module.__name__]
    public = {*getattr(module, "__all__", own), *BEHIND.get(part, ())}
    assert sorted(api(part)) == sorted(public)
