"""What the README shows works as shown."""

from __future__ import annotations

import inspect
import re
import runpy
from pathlib import Path

import pytest

import pinposture as pp
from pinposture.cli import app
from pinposture.viz import view

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text()


def test_the_snippet_runs_and_the_arm_gets_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
) -> None:
    (code,) = re.findall(r"```python\n(.*?)```", README, re.DOTALL)
    script = tmp_path / "snippet.py"
    script.write_text(code)
    shown = []
    monkeypatch.setattr(pp, "view", lambda *seen, **how: shown.append((seen, how)), raising=False)
    monkeypatch.chdir(tmp_path)
    run = runpy.run_path(str(script))["run"]
    assert run.converged
    assert capsys.readouterr().out.startswith("converged ")
    assert {path.name for path in tmp_path.iterdir()} >= {"run.png", "run.html", "run.npz"}
    assert len(shown) == 1
    inspect.signature(view).bind(*shown[0][0], **shown[0][1])


def test_the_commands_shown_exist() -> None:
    verbs = {command.name for command in app.registered_commands}
    verbs |= {group.name for group in app.registered_groups}
    shown = set(re.findall(r"^pinposture (\w+)", README, re.MULTILINE))
    assert shown == verbs


def test_every_link_leads_somewhere() -> None:
    for page in (ROOT / "README.md", *(ROOT / "docs").rglob("*.md")):
        for link in re.findall(r"\]\(([^)#]+)(?:#[^)]*)?\)", page.read_text()):
            assert "://" in link or (page.parent / link).exists(), f"{page.name}: {link}"
