"""The tutorial is the examples: the same code, and what they print."""

from __future__ import annotations

import ast
import re
import runpy
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
EXAMPLES = sorted((ROOT / "examples").glob("[0-9][0-9]_*.py"))
PAGES = sorted((ROOT / "docs/tutorial").glob("[0-9][0-9]_*.md"))
NUMBER = re.compile(r"[-+]?\d+(\.\d+)?(e[-+]?\d+)?")


def body(example: Path) -> str:
    """The code of an example after its docstring."""
    text = example.read_text()
    first = ast.parse(text).body[0]
    assert isinstance(first, ast.Expr) and first.end_lineno is not None
    return "\n".join(text.splitlines()[first.end_lineno :])


def words(text: str) -> list[str]:
    """What is printed but for the numbers, the last digits of which depend on the machine."""
    return [" ".join(NUMBER.sub("#", line).split()) for line in text.strip().splitlines()]


def test_each_example_has_its_step_and_each_step_its_number() -> None:
    assert [page.stem for page in PAGES] == [example.stem for example in EXAMPLES]
    for number, page in enumerate(PAGES, start=1):
        assert page.name.startswith(f"{number:02}_")
        assert page.read_text().startswith(f"# {number}. ")


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda path: path.stem)
def test_the_step_shows_all_code_of_its_example(example: Path) -> None:
    page = (ROOT / "docs/tutorial" / f"{example.stem}.md").read_text()
    shown = "\n".join(re.findall(r"```python\n(.*?)```", page, re.DOTALL))
    assert [line for line in shown.splitlines() if line] == [
        line for line in body(example).splitlines() if line
    ]
    assert f"python examples/{example.name}\n" in page
    assert f"python examples/{example.name}\n" in example.read_text()


@pytest.mark.tutorial
@pytest.mark.parametrize("example", EXAMPLES, ids=lambda path: path.stem)
def test_the_example_runs_and_prints_what_the_step_says(
    example: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
) -> None:
    if example.stem in ("08_physics", "13_tendon_arm", "17_sag", "18_contact", "19_wrap"):
        pytest.importorskip("mujoco")
    if example.stem == "11_edit_a_task":
        pytest.importorskip("viser")
    monkeypatch.chdir(tmp_path)
    runpy.run_path(str(example), run_name="__main__")
    page = (ROOT / "docs/tutorial" / f"{example.stem}.md").read_text()
    (shown,) = re.findall(r"```text\n(.*?)```", page, re.DOTALL)
    assert words(capsys.readouterr().out) == words(shown)
    assert any(path.is_file() for path in (tmp_path / "out").rglob("*"))
