"""Both commands, called in this process, and an arm for them to work on."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from calls import Command, Result, calls

from benchmarks.__main__ import app as evidence
from pinposture.cli import app


@pytest.fixture(scope="session")
def command() -> Iterator[Command]:
    """Calls the command that has the verb: `command("study", "arms")`, `command("generate", "RyRz")`."""
    verbs = {verb.name for verb in app.registered_commands}
    with calls(app) as library, calls(evidence) as benchmarks:

        def call(*arguments: object, **options: object) -> Result:
            return (library if str(arguments[0]) in verbs else benchmarks)(*arguments, **options)

        yield call


@pytest.fixture(scope="session")
def arm_file(command: Command, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An arm of six modules, 0.3 m long, 12 DOF."""
    path = tmp_path_factory.mktemp("arm") / "arm.urdf"
    assert command("generate", "RyRz", "--modules", 6, "-o", path).code == 0
    return path
