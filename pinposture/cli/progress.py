"""A bar for work whose length is known."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager


@contextmanager
def count_progress(noun: str) -> Iterator[Callable[[int, int], object]]:
    """Show on stderr how much of some work is done; nothing at all if that is not a terminal.

    Args:
        noun: what is counted, for instance "case".

    Yields:
        What is to be called with the number of those that are done, and that of all.
    """
    if not sys.stderr.isatty():
        yield lambda *_: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (
        TextColumn("running"),
        BarColumn(bar_width=20),
        TextColumn(f"{noun} {{task.completed}} of {{task.total}}"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=Console(stderr=True), transient=True) as progress:
        task = progress.add_task("", total=None, visible=False)
        yield lambda done, total: progress.update(task, completed=done, total=total, visible=True)
