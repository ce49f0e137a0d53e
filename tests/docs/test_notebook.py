"""The notebook of the documentation: what is kept is what its script says, and it runs."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from types import ModuleType

import pytest

nbformat = pytest.importorskip("nbformat")
pytest.importorskip("nbclient")
pytest.importorskip("ipykernel")

DOCS = Path(__file__).parents[2] / "docs"


@pytest.fixture(scope="module")
def script() -> ModuleType:
    spec = importlib.util.spec_from_file_location("docs_notebook", DOCS / "notebook.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def sources(notebook: object) -> list[tuple[str, str]]:
    return [(cell.cell_type, cell.source) for cell in notebook.cells]


def shown(notebook: object) -> list[list[str]]:
    return [
        sorted(kind for output in cell.outputs for kind in output.get("data", {}))
        for cell in notebook.cells
        if cell.cell_type == "code"
    ]


def test_the_kept_notebook_is_that_of_the_script(script: ModuleType) -> None:
    kept = nbformat.read(script.PATH, 4)
    assert sources(kept) == sources(script.make())
    assert shown(kept) == [["text/html", "text/plain"]] * 5
    assert script.PATH.stat().st_size < 1_000_000


@pytest.mark.tutorial
def test_the_notebook_runs_and_shows_a_table_and_a_picture_in_each_cell(
    script: ModuleType, tmp_path: Path
) -> None:
    notebook = script.execute(tmp_path)
    assert shown(notebook) == [["text/html", "text/plain"]] * 5
    assert (tmp_path / "motion.json").exists()
