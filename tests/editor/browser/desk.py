"""Editors to be opened in windows, and what there is to wait for."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import pinposture as pp
from pinposture.editor import Editor
from pinposture.editor.edits import keyframes_of

PATIENCE = 60.0
"""How long something that has to happen is waited for [s]: a busy machine draws slowly without a screen."""


def wait_until(true: Callable[[], Any], what: str, patience: float = PATIENCE) -> Any:
    """Wait until something is so, and give it; fail if it takes too long."""
    end = time.monotonic() + patience
    while not (value := true()):
        assert time.monotonic() < end, f"after {patience:g} s not: {what}"
        time.sleep(0.03)
    return value


@contextmanager
def opened(task: pp.Task, path: Path | None = None, selected: int | None = None) -> Iterator[Editor]:
    """An editor of a task, at one of its keyframes."""
    editor = Editor(task, path, port=free_port())
    if selected is not None:
        editor.session.select(selected)
    editor.start()
    try:
        yield editor
    finally:
        editor.close()


def arrived(editor: Editor) -> None:
    """Wait until the arm has taken the shape that is asked of it."""
    session = editor.session
    wait_until(
        lambda: (
            session.proposal is None
            and editor.live.number == session.number
            and editor.live.status == "converged"
        ),
        "the arm takes the shape",
    )


@contextmanager
def served(file: Path, port: int | None = None) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """The editor as from the shell: the process, and where it is; stopped by Ctrl-C if it runs still."""
    command = [sys.executable, "-m", "pinposture", "edit", str(file), "--no-browser"]
    command += ["--port", str(free_port() if port is None else port)]
    process = subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
        env={**os.environ, "PYTHONUNBUFFERED": "1"},
    )
    try:
        assert process.stdout is not None
        url = process.stdout.readline().strip()
        assert url.startswith("http://"), url
        yield process, url
        process.send_signal(signal.SIGINT)
        process.wait(timeout=PATIENCE)
    finally:
        process.kill()
        process.wait()
        with suppress(OSError):
            process.stdout.close()  # type: ignore[union-attr]


def curves(task: pp.Task) -> list[pp.Curve]:
    """The curves of the keyframes."""
    return [each.curve for each in keyframes_of(task)]


def free_port() -> int:
    """A port at which nobody listens."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return int(free.getsockname()[1])


def is_free(port: int) -> bool:
    """Whether nobody listens at a port."""
    with socket.socket() as caller:
        return caller.connect_ex(("127.0.0.1", port)) != 0
