"""What the README shows works as shown."""

from __future__ import annotations

import re
import runpy
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import pinposture as pp
from pinposture.cli import app

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text()


def test_the_snippets_run_and_the_arm_gets_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
) -> None:
    script = tmp_path / "snippet.py"
    script.write_text("".join(re.findall(r"```python\n(.*?)```", README, re.DOTALL)))
    (tmp_path / "arm.urdf").write_text(pp.Arm.from_template("RyRz", modules=20).urdf)
    monkeypatch.chdir(tmp_path)
    run = runpy.run_path(str(script))["run"]
    assert run.converged
    assert not run.faults
    assert capsys.readouterr().out.startswith("reached the target")
    assert {path.name for path in tmp_path.iterdir()} >= {"run.html", "motion.json"}
    assert pp.load("motion.json").joint_names == pp.Arm.load("arm.urdf").joint_names


def test_the_moving_picture_comes_first_and_is_small() -> None:
    (picture, *_) = re.findall(r"!\[[^\]]{10,}\]\(([^)]*)\)", README)
    path = ROOT / picture
    assert path.stat().st_size < 1_500_000
    with Image.open(path) as frames:
        assert frames.n_frames > 50
        assert frames.info["loop"] == 0
        first = np.asarray(frames.convert("L"), dtype=float)
        frames.seek(frames.n_frames // 3)
        assert np.abs(np.asarray(frames.convert("L"), dtype=float) - first).mean() > 1.0


def test_the_commands_shown_exist() -> None:
    verbs = {command.name for command in app.registered_commands}
    verbs |= {group.name for group in app.registered_groups}
    shown = set(re.findall(r"^pinposture (\w+)", README, re.MULTILINE))
    assert shown == verbs


def test_the_page_on_pypi_renders_without_links_to_files() -> None:
    markdown = pytest.importorskip("readme_renderer.markdown")
    pytest.importorskip("hatch_fancy_pypi_readme")
    command = [sys.executable, "-m", "hatch_fancy_pypi_readme"]
    shown = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout
    page = markdown.render(shown)
    assert page is not None
    for place in re.findall(r'(?:href|src)="([^"]*)"', page):
        assert place.startswith(("https://", "#")), place
    assert page.count("<table") == markdown.render(README).count("<table") == 2
    assert "Choosing a controller" in page
    code, kept = (re.findall(r"```.*?```", text, re.DOTALL) for text in (README, shown))
    assert kept == code


def test_every_link_leads_somewhere() -> None:
    for page in (ROOT / "README.md", *(ROOT / "docs").rglob("*.md")):
        for link in re.findall(r"\]\(([^)#]+)(?:#[^)]*)?\)", page.read_text()):
            assert "://" in link or (page.parent / link).exists(), f"{page.name}: {link}"
