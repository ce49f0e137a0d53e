"""The command, called in this process, and an arm for it to work on."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import NamedTuple

import pytest
from typer.main import get_command
from typer.testing import CliRunner

from pinposture.cli import app
from pinposture.storage import write_text


class Result(NamedTuple):
    code: int
    out: str
    err: str


Command = Callable[..., Result]


@pytest.fixture(scope="session")
def command() -> Iterator[Command]:
    """Calls the command: `command("inspect", "arm.urdf", input="")` -> exit code, stdout, stderr."""
    # Older Clicks mix the two streams unless told otherwise, newer ones cannot be told.
    separate = "mix_stderr" in inspect.signature(CliRunner).parameters
    runner = CliRunner(**({"mix_stderr": False} if separate else {}))

    def call(*arguments: object, **options: object) -> Result:
        result = runner.invoke(app, [str(argument) for argument in arguments], **options)
        if result.exception is not None and not isinstance(result.exception, SystemExit):
            raise result.exception
        return Result(result.exit_code, result.stdout, result.stderr)

    with pytest.MonkeyPatch.context() as patch:  # the runner would build all verbs anew for each call
        patch.setattr("typer.testing._get_command", cache(get_command), raising=False)
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
