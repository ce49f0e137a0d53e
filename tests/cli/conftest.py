"""The command, called in this process, and an arm for it to work on."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from calls import Command, calls

from pinposture.cli import app
from pinposture.storage import write_text


@pytest.fixture(scope="session")
def command() -> Iterator[Command]:
    """Calls the command: `command("inspect", "arm.urdf", input="")` -> exit code, stdout, stderr."""
    with calls(app) as call:
        yield call


@pytest.fixture(scope="session")
def arm_file(command: Command, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An arm of six modules, 0.3 m long, 12 DOF."""
    path = tmp_path_factory.mktemp("arm") / "arm.urdf"
    assert command("generate", "RyRz", "--modules", 6, "-o", path).code == 0
    return path


@pytest.fixture(scope="session")
def run_directory(command: Command, arm_file: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of 20 steps, kept."""
    path = tmp_path_factory.mktemp("run") / "out"
    asked = ("track", arm_file, "--curve", "helix", "--step-limit", 0.02, "--steps", 20)
    assert command(*asked, "-o", path).code == 1  # it is too short to get there
    return path


@pytest.fixture
def no_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Spares a test the plot and the animation, which take most of the time of a short run."""
    for name in ("write_plot", "write_animation"):
        monkeypatch.setattr(f"pinposture.cli.output.{name}", lambda _, path: write_text(path, ""))
