"""`pinposture run`: do what a task file says."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer

from pinposture.cli.folder import Folder
from pinposture.cli.inputs import OUTPUT, JsonOption
from pinposture.cli.output import print_facts, print_json, print_note
from pinposture.cli.progress import count_progress
from pinposture.cli.results import keep_motion, motion_in_words, summarize_motion
from pinposture.cli.view import show

EXAMPLES = (
    "pinposture run examples/tasks/keyframes.toml -o out/keyframes",
    "pinposture run examples/tasks/around.toml --json",
    "pinposture run examples/tasks/pipe.toml --check",
    "pinposture run examples/tasks/keyframes.toml -o out/keyframes --view",
)


def run(
    *,
    file: Annotated[Path, typer.Argument(metavar="TASK", help="A task file, .toml or .json.")],
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            metavar="DIR",
            help="Leave motion.npz, .csv, .json, .png and .html here, as the file says; else nothing is kept.",
            rich_help_panel=OUTPUT,
        ),
    ] = None,
    check: Annotated[
        bool,
        typer.Option(
            "--check", help="Only see whether the arm can take the postures.", rich_help_panel=OUTPUT
        ),
    ] = False,
    as_json: JsonOption = False,
    view: Annotated[
        bool, typer.Option("--view", help="Show the motion in the browser at last.", rich_help_panel=OUTPUT)
    ] = False,
    require_convergence: Annotated[
        bool,
        typer.Option(
            "--require-convergence",
            help="Exit with code 1 if the arm does not take the last posture.",
            rich_help_panel=OUTPUT,
        ),
    ] = False,
) -> None:
    """Do what a task file says: take postures at their times, or follow the leader.

    Between postures the curve changes smoothly, and the arm follows it within its limits; where these do not
    admit the times of the file, it takes longer, and the summary says by how much. docs/tasks.md describes
    the file; a mistake in it is named with its line.

    With -o the motion is kept in a directory. Each file appears there whole or not at all, and status.json says
    whether all are there. The exit code is 0 whether or not the arm got there, 2 if it could not start.
    """
    from pinposture.task import Task

    task = Task.load(file)
    folder = None if output is None or check else Folder(output)
    if folder is not None:
        found = folder.found()
        if found:
            print_note(found)
        folder.begin(str(file))
    if check:
        with count_progress("posture") as placing:
            reference = task.reference(placing)
        facts = {"postures": len(reference.marks), "rows": reference.rows, "duration": reference.duration}
        if as_json:
            print_json({"task": str(file), **facts})
        else:
            print_facts({"postures": str(facts["postures"]), "duration": f"{reference.duration:.4g} s"})
        return
    with count_progress("posture") as placing, _time_progress() as moving:
        motion = task.perform(placing, moving)
    files: dict[str, str] = {}
    if output is not None and folder is not None:
        files = keep_motion(motion, output, task.formats)
        folder.finish(str(file), [Path(each).name for each in files.values()])
    summary = summarize_motion(motion)
    if as_json:
        print_json({"task": str(file), **summary, "files": files})
    else:
        print_facts(motion_in_words(summary))
    for each in files.values():
        print_note(f"wrote {each}")
    if view:
        show(motion, True, print_note)
    if require_convergence and not motion.converged:
        raise typer.Exit(1)


@contextmanager
def _time_progress() -> Iterator[Callable[[float, float], object]]:
    """Show on stderr how far a motion is; nothing at all if that is not a terminal."""
    if not sys.stderr.isatty():
        yield lambda *_: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn

    columns = (
        TextColumn("moving"),
        BarColumn(bar_width=20),
        TextColumn("{task.completed:.1f} s of {task.total:.1f} s"),
    )
    with Progress(*columns, console=Console(stderr=True), transient=True) as progress:
        bar = progress.add_task("", total=1.0, visible=False)
        yield lambda done, total: progress.update(bar, completed=done, total=total, visible=True)
