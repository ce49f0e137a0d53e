"""What a command leaves: data on stdout, all else on stderr, progress bars, and files."""

from __future__ import annotations

import json
import math
import sys
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from pinposture.errors import FileError, PostureWarning

if TYPE_CHECKING:
    from rich.console import RenderableType

    from pinposture.motion import Motion, Trajectory
    from pinposture.motion.track import Callback
    from pinposture.placement import Target

verb_examples: dict[Callable[..., None], tuple[str, ...]] = {}
"""Command lines that the help of each verb shows."""


def examples(*lines: str) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Register example command lines for the help of a verb."""

    def register(run: Callable[..., None]) -> Callable[..., None]:
        verb_examples[run] = lines
        return run

    return register


UNLIMITED = 10_000
"""Columns of a file or a pipe: enough for any table, none of which must be cut short there."""


def print_json(data: Mapping[str, Any]) -> None:
    """Print one JSON object on stdout; an infinite number, such as an absent limit, becomes null."""
    typer.echo(json.dumps(_finite(data), indent=2, allow_nan=False))


def _finite(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, Sequence) and not isinstance(value, str):
        return [_finite(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def print_result(
    as_json: bool,
    data: Mapping[str, Any],
    words: Mapping[str, str | tuple[str, str]],
    files: Iterable[object] = (),
) -> None:
    """Print what came out on stdout, as one JSON object or in words, and on stderr what files it is in."""
    if as_json:
        print_json(data)
    else:
        print_facts(words)
    for file in files:
        print_note(f"wrote {file}")


def print_facts(facts: Mapping[str, str | tuple[str, str]]) -> None:
    """Print names and what they stand for on stdout, one a line; a pair is a text and its style."""
    from rich.table import Table
    from rich.text import Text

    table = Table.grid(padding=(0, 2))
    table.add_column(style="bold", no_wrap=True)
    table.add_column(overflow="fold")
    for name, text in facts.items():
        table.add_row(name, Text.assemble(text))
    _print(table)


Cell = str | float | None


def print_table(headings: Sequence[str], rows: Sequence[Sequence[Cell]]) -> None:
    """Print a table on stdout; numbers are set to the right, None is a dash."""
    from rich.box import SIMPLE
    from rich.table import Table
    from rich.text import Text

    table = Table(box=SIMPLE, header_style="bold", pad_edge=False)
    for heading, first in zip(headings, rows[0], strict=True):
        table.add_column(
            Text(heading), justify="left" if isinstance(first, str) else "right", overflow="fold"
        )
    for row in rows:
        table.add_row(*(Text(_cell(value)) for value in row))
    _print(table)


def _cell(value: Cell) -> str:
    if isinstance(value, float):
        return f"{value:.4g}" if math.isfinite(value) else "-"
    return "-" if value is None else str(value)


def _print(content: RenderableType) -> None:
    from rich.console import Console

    # Not the console's own idea of a terminal, which colours that are asked for would change.
    width = None if sys.stdout.isatty() else UNLIMITED
    Console(width=width, highlight=False).print(content)


def print_note(text: str) -> None:
    """Print a text on stderr that is not part of the result."""
    _print_line("", "", text)


def print_warning(text: str) -> None:
    """Print a warning on stderr, on one line."""
    _print_line("note: ", "yellow", text)


def print_error(text: str) -> None:
    """Print on stderr, on one line, why there is no result."""
    _print_line("error: ", "bold red", text)


def end_with(faults: Sequence[str]) -> None:
    """Exit with code 1 if there are faults."""
    if faults:
        raise typer.Exit(1)


@contextmanager
def warnings_as_notes() -> Iterator[None]:
    """Print every `PostureWarning` as a note on stderr, regardless of filters; others as Python does."""
    with warnings.catch_warnings():
        warnings.simplefilter("always", PostureWarning)
        show = warnings.showwarning

        def note(message: Warning | str, category: type[Warning], *where: Any, **more: Any) -> None:
            if issubclass(category, PostureWarning):
                print_warning(str(message))
            else:
                show(message, category, *where, **more)

        warnings.showwarning = note
        yield


def _print_line(label: str, style: str, text: str) -> None:
    from rich.console import Console
    from rich.text import Text

    line = " ".join(part.strip() for part in text.splitlines())
    Console(stderr=True).print(Text.assemble((label, style), line), soft_wrap=True)


@contextmanager
def step_progress(target: Target, steps: int) -> Iterator[Callback]:
    """Show a progress bar on stderr while an arm moves; nothing at all if that is not a terminal.

    Args:
        target: where the arm is going.
        steps: number of steps after which it stops.

    Yields:
        What `track` is to call after each step.
    """
    import numpy as np

    # Short enough that the ^C of the terminal fits behind it: on a full line it would spoil the next one.
    text = "step {task.completed} of {task.total}, posture error {task.fields[error]:.4g} m"
    with _progress_bar("tracking", text) as update:

        def show(step: int, state: Any, _: object) -> None:
            distances = np.linalg.norm(target.points - state.points, axis=1)
            update(step, steps, error=float(distances[target.has_target].sum()))

        yield show


@contextmanager
def count_progress(noun: str) -> Iterator[Callable[[int, int], object]]:
    """Show on stderr how much of some work is done; nothing at all if that is not a terminal.

    Args:
        noun: what is counted, for instance "case".

    Yields:
        What is to be called with the number of those that are done, and that of all.
    """
    with _progress_bar("running", f"{noun} {{task.completed}} of {{task.total}}", remaining=True) as update:
        yield update


@contextmanager
def time_progress() -> Iterator[Callable[[float, float], object]]:
    """Show on stderr how far a motion is; nothing at all if that is not a terminal."""
    with _progress_bar("moving", "{task.completed:.1f} s of {task.total:.1f} s") as update:
        yield update


@contextmanager
def _progress_bar(label: str, text: str, remaining: bool = False) -> Iterator[Callable[..., object]]:
    """A bar on stderr that appears with its first update, a function of what is done and of all."""
    if not sys.stderr.isatty():
        yield lambda *_, **__: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    columns = [TextColumn(label), BarColumn(bar_width=20), TextColumn(text)]
    more = [TimeRemainingColumn()] if remaining else []
    with Progress(*columns, *more, console=Console(stderr=True), transient=True) as progress:
        task = progress.add_task("", total=1.0, visible=False, error=math.nan)
        yield lambda done, total, **more: progress.update(
            task, completed=done, total=total, visible=True, **more
        )


def closest_in_words(clearance: Mapping[str, Any], dt: float | None = None) -> str:
    """A smallest distance as a person reads it.

    Args:
        clearance: what `pinposture.motion.trajectory.closest` returned.
        dt: how long a step takes [s]; None to count steps.
    """
    if clearance["pair"] is None:
        return "nothing to keep clear of"
    steps = clearance["after_steps"]
    after = "at the start"
    if steps:
        after = f"after {steps} steps" if dt is None else f"after {steps * dt:.4g} s"
    return (
        f"{clearance['smallest']:.4g} m where it is smallest, {' to '.join(clearance['pair'])}, {after}; "
        f"{clearance['final']:.4g} m at the end; the margin is {clearance['margin']:.4g} m"
    )


def verdict_in_colour(summary: Mapping[str, Any]) -> tuple[str, str]:
    """What to think of a motion, with the colour in which to print it."""
    return str(summary["verdict"]), "yellow" if summary["faults"] else "green"


# The files that are kept of a run, or of a motion in time.

RUN_FILE, PLOT, ANIMATION = "run.npz", "run.png", "run.html"
FILES = {"run": RUN_FILE, "plot": PLOT, "animation": ANIMATION}

BATCH = "batch.npz"
"""File of a directory that holds all runs of a batch."""

MOTION_FILE = "motion.npz"
FORMATS = ("npz", "csv", "json", "png", "html")
"""What a motion can be kept as: all of it, its joints as a table and for ROS, its plot, its animation."""

FOR_ROBOTS = ("csv", "json")
"""Those of them that are handed to a robot."""


def keep(motion: Trajectory, directory: Path) -> None:
    """Write a run, its plot and its animation into a directory."""
    from pinposture.motion import save

    write_plot(motion, directory / PLOT)
    write_animation(motion, directory / ANIMATION)
    save(motion, directory / RUN_FILE)  # last: where it is, its pictures are


def keep_motion(motion: Motion, directory: Path, formats: Sequence[str] = FORMATS) -> dict[str, str]:
    """Write a motion in time into a directory, in some of `FORMATS`.

    What is for robots is left out if the motion has faults; it is said on stderr.

    Returns:
        The path of the file of each format, in the order in which they were written.

    Raises:
        FileError: one of them cannot be written.
    """
    from pinposture.motion import save

    held_back = [kind for kind in formats if motion.faults and kind in FOR_ROBOTS]
    if held_back:
        named = " and ".join(f"motion.{kind}" for kind in held_back)
        advice = f"pinposture export {directory} --force writes one all the same"
        print_warning(f"no {named} for a robot: {'; '.join(motion.faults)}; {advice}")
        formats = [kind for kind in formats if kind not in held_back]
    stem = directory / MOTION_FILE
    files = {kind: stem.with_suffix(f".{kind}") for kind in reversed(FORMATS) if kind in formats}
    for kind, path in files.items():  # that with everything last: where it is, the others are
        if kind == "html":
            write_animation(motion, path)
        elif kind == "png":
            write_plot(motion, path)
        elif kind == "npz":
            save(motion, path)
        else:
            save(motion.joint_trajectory(), path)
    return {kind: str(path) for kind, path in files.items()}


def find_kept(path: Path) -> tuple[Path, str]:
    """The file of a run or a motion: a file itself, or in a directory the newer one.

    Returns:
        The file, and if there were two which one was taken, in words.

    Raises:
        FileError: a directory that holds neither.
    """
    if not path.is_dir():
        return path, ""
    found = [path / name for name in (MOTION_FILE, RUN_FILE) if _is_kept(path / name)]
    if not found:
        for name in (RUN_FILE, BATCH):
            if (path / name).exists():
                return path / name, ""  # whoever reads it says what is wrong with it
        raise FileError(path / RUN_FILE, f"no such file, and no {MOTION_FILE} that holds a motion")
    newest, *others = sorted(found, key=lambda file: file.stat().st_mtime_ns, reverse=True)
    return newest, f"{newest.name}, which is newer than {others[0].name}" if others else ""


def _is_kept(path: Path) -> bool:
    """Whether a file holds a run, or a motion; joints that were exported under that name are neither."""
    from pinposture.motion import Motion, Trajectory
    from pinposture.motion.files import kind_of

    return kind_of(path) in (Trajectory, Motion)


def load_kept(path: Path) -> Trajectory | Motion:
    """Read a run or a motion; raises FileError if the file is missing, or holds neither."""
    from pinposture.motion import Motion, Trajectory, load
    from pinposture.motion.files import kind_of

    return load(path, Motion) if kind_of(path) is Motion else load(path, Trajectory)


def write_plot(motion: Trajectory | Motion, path: Path) -> None:
    """Write the plot of a run or a motion as PNG, whatever the name of the file."""
    from pinposture.storage import write_figure
    from pinposture.viz import plot

    write_figure(path, plot(motion))


def write_animation(motion: Trajectory | Motion, path: Path, ellipsoids: Sequence[int] = ()) -> Path:
    """Write the animation of a run or a motion, and ellipsoids of control points, as one HTML file."""
    from pinposture.viz import save_html

    return save_html(motion.arm, motion, path, ellipsoids=ellipsoids)
