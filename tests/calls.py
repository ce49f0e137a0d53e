"""A command line, called in this process."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from typing import NamedTuple

import pytest
import typer
from typer.main import get_command
from typer.testing import CliRunner


class Result(NamedTuple):
    code: int
    out: str
    err: str


Command = Callable[..., Result]


@contextmanager
def calls(app: typer.Typer) -> Iterator[Command]:
    """Yields a function: `command("inspect", "arm.urdf")` -> exit code, stdout, stderr."""
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
