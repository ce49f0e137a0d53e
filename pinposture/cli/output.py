"""Output of the commands: data on stdout, everything else on stderr, progress bars, and files."""

from __future__ import annotations

import json
import math
import sys
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import typer

from pinposture.errors import FileError, InvalidValue, PostureWarning
from pinposture.storage import RESULT_FORMATS, check_writable
from pinposture.units import length_text

if TYPE_CHECKING:
    from rich.console import RenderableType

    from pinposture.motion import Run, Trajectory
    from pinposture.motion.loop import Callback
    from pinposture.placement import Target

verb_examples: dict[Callable[..., None], tuple[str, ...]] = {}
"""Example command lines in the help of each verb."""


def examples(*lines: str) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Register example command lines for the help of a verb."""

    def register(run: Callable[..., None]) -> Callable[..., None]:
        verb_examples[run] = lines
        return run

    return register


def print_json(data: Mapping[str, Any]) -> None:
    """Print one JSON object on stdout: null for infinite numbers, such as missing limits; paths as text."""
    typer.echo(json.dumps(_finite(data), indent=2, allow_nan=False, default=str))


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
    failure: FileError | None = None,
) -> None:
    """Print a result on stdout, in words or JSON, and its files on stderr; then raise `failure`, if given."""
    if as_json:
        print_json(data)
    else:
        print_facts(words)
    for file in files:
        print_note(f"wrote {file}")
    if failure is not None:
        raise failure


def check_directory(output: Path | None) -> None:
    """Raise an error for a directory that is not writable, or a new one with the suffix of a file."""
    if output is not None:
        if output.suffix.lower()[1:] in RESULT_FORMATS and not output.exists():
            raise InvalidValue("--output", str(output), "a directory, in which files are saved")
        check_writable(output)


File = tuple[str, Path, Callable[[Path], object]]
"""A kind of file, its path, and the function that writes it."""


def write_files(files: Sequence[File]) -> tuple[dict[str, str], FileError | None]:
    """Write the files of a result in order, up to the first that cannot be written.

    Returns:
        The path of each file written, by kind; and the error, if any, with the names of the other files that
        were not written, for `print_result` to raise: the result must not be lost with its files.
    """
    written: dict[str, str] = {}
    for kind, path, write in files:
        try:
            write(path)
        except FileError as error:
            others = ", ".join(other.name for _, other, _ in files[len(written) + 1 :])
            reason = f"{error.reason}; not written either: {others}" if others else error.reason
            return written, FileError(path, reason)
        written[kind] = str(path)
    return written, None


def print_facts(facts: Mapping[str, str | tuple[str, str]]) -> None:
    """Print names and values on stdout, one per line; a pair is a text and its style."""
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
    """Print a table on stdout; numbers are right-aligned, None is a dash."""
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

    # Not the console's own terminal detection, which forced colours would change.
    width = None if sys.stdout.isatty() else 10_000  # enough for any table, so that none is truncated
    console = Console(width=width, highlight=False)
    with console.capture() as printed:
        console.print(content)
    typer.echo("\n".join(line.rstrip() for line in printed.get().splitlines()), color=True)


def print_note(text: str) -> None:
    """Print text that is not part of the result on stderr."""
    _print_line("", "", text)


def print_warning(text: str) -> None:
    """Print a warning on stderr, on one line."""
    _print_line("note: ", "yellow", text)


def print_error(text: str) -> None:
    """Print an error on stderr, on one line."""
    _print_line("error: ", "bold red", text)


def end_with(faults: Sequence[str]) -> None:
    """Exit with code 1 if there are faults."""
    if faults:
        raise typer.Exit(1)


@contextmanager
def warnings_as_notes() -> Iterator[None]:
    """Print each `PostureWarning` as a note on stderr, regardless of filters; others as Python does."""
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
    line = "".join(character if character.isprintable() else ascii(character)[1:-1] for character in line)
    longest = 1000  # files of anything else than expected may be quoted
    line = line if len(line) <= longest else f"{line[:longest]} ..."
    Console(stderr=True).print(Text.assemble((label, style), line), soft_wrap=True)


@contextmanager
def step_progress(target: Target, steps: int) -> Iterator[Callback]:
    """Show a progress bar on stderr while an arm moves; nothing if that is not a terminal.

    Args:
        target: the target of the arm.
        steps: maximum number of steps.

    Yields:
        The callback for `track`.
    """
    # Short enough to leave room for the ^C of the terminal: on a full line it would spoil the next line.
    text = "step {} of {}, mean point error {}"
    with progress_bar("tracking", text, first="planning") as update:

        def show(step: int, state: Any, _: object) -> None:
            update(step, steps, length_text(target.mean_distance(state.points)))

        yield show


@contextmanager
def count_progress(noun: str) -> Iterator[Callable[[int, int], object]]:
    """Show the progress of some work on stderr; nothing if that is not a terminal.

    Args:
        noun: name of the counted items, such as "case".

    Yields:
        A function to call with the number of finished items and the total number.
    """
    with progress_bar("running", f"{noun} {{}} of {{}}", first=f"first {noun}", remaining=True) as update:
        yield update


@contextmanager
def progress_bar(
    label: str, text: str, *, first: str, remaining: bool = False
) -> Iterator[Callable[..., object]]:
    """Show a bar on stderr, with the time taken so far; nothing if that is not a terminal.

    Args:
        label: what is being done.
        text: format of the values with which the yielded function is called: progress, total and others.
        first: the text before the first call.
        remaining: whether to estimate the remaining time.
    """
    if not sys.stderr.isatty():
        yield lambda *_: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    words = TextColumn("{task.description}, {task.elapsed:.0f} s", markup=False)
    columns = [TextColumn(label), BarColumn(bar_width=12), words]
    more = [TimeRemainingColumn(), TextColumn("left")] if remaining else []
    with Progress(*columns, *more, console=Console(stderr=True), transient=True) as progress:
        task = progress.add_task(first, total=None)
        yield lambda done, total, *values: progress.update(
            task, completed=done, total=total, description=text.format(done, total, *values)
        )


def words_of(summary: Mapping[str, Any]) -> dict[str, str | tuple[str, str]]:
    """Return a summary in words that names options; the verdict comes with the colour to print it in."""
    from pinposture.motion.words import in_words

    options = {
        "raise max_steps": "raise --steps",
        "choose another one": "choose another one by --start or --seed",
        "placement as_is": "--placement as_is",
    }
    words: dict[str, str | tuple[str, str]] = {}
    for topic, said in in_words(summary).items():
        text = said
        for argument, option in options.items():
            text = text.replace(argument, option)
        words[topic] = text
    if "verdict" in words:
        words["verdict"] = str(words["verdict"]), "yellow" if summary["faults"] else "green"
    return words


class FileNames(NamedTuple):
    """Names of the files of results in a directory."""

    run: str = "run.npz"
    """A run."""

    plot: str = "run.png"
    """Its figure."""

    animation: str = "run.html"
    """Its animation."""

    batch: str = "batch.npz"
    """All runs of a batch."""

    motion: str = "motion.npz"
    """The motion of a task."""

    status: str = "status.json"
    """The state of the last `pinposture run`."""

    postures: str = "postures.png"
    """The figure of the postures that `pinposture reach` finds."""

    simulation: str = "simulation.npz"
    """A simulation."""

    simulated: str = "simulation.png"
    """Its figure."""


FILES = FileNames()


def run_files(motion: Run, directory: Path) -> list[File]:
    """Return the files of a run in a directory."""
    from pinposture.motion import save

    return [
        ("plot", directory / FILES.plot, partial(write_plot, motion)),
        ("animation", directory / FILES.animation, partial(write_animation, motion)),
        ("run", directory / FILES.run, partial(save, motion)),  # last: if it exists, its pictures do, too
    ]


def motion_files(motion: Trajectory, directory: Path, formats: Sequence[str] = RESULT_FORMATS) -> list[File]:
    """Return the files of a motion in time in a directory, in some of `RESULT_FORMATS`.

    If the motion has faults, formats for robots are omitted, with a note on stderr.
    """
    from pinposture.motion import save

    held_back = [kind for kind in formats if motion.faults and kind in ("csv", "json")]
    if held_back:
        named = " and ".join(f"motion.{kind}" for kind in held_back)
        advice = f"pinposture export {directory} --force writes one anyway"
        print_warning(f"no {named} for a robot: {'; '.join(motion.faults)}; {advice}")
    writers: dict[str, Callable[[Path], object]] = {
        "html": partial(write_animation, motion),
        "png": partial(write_plot, motion),
        "json": lambda path: save(motion.joint_trajectory(), path),
        "csv": lambda path: save(motion.joint_trajectory(), path),
        "npz": partial(save, motion),  # last: if it exists, the others do, too
    }
    stem = directory / FILES.motion
    return [
        (kind, stem.with_suffix(f".{kind}"), write)
        for kind, write in writers.items()
        if kind in formats and kind not in held_back
    ]


def find_kept(path: Path) -> tuple[Path, str]:
    """Find the file of a run or motion: the path itself, or the newer one in a directory.

    Returns:
        The file, and a note on which one was chosen if there were two.

    Raises:
        FileError: a directory with neither, or with none written after a failed run.
    """
    from pinposture.motion import Run, Trajectory
    from pinposture.motion.files import kind_of

    if not path.is_dir():
        return path, ""
    named = [path / name for name in (FILES.motion, FILES.run)]
    results = [file for file in named if kind_of(file) in (Run, Trajectory)]  # not a joint trajectory
    status = read_status(path)
    if status.get("state") == "failed":
        ended = modification_time(path / FILES.status)
        older = [file for file in results if modification_time(file) <= ended]
        if older == results:
            why = f"the run of {status.get('task')} failed: {status.get('reason')}"
            also = f", or name {older[0]}, of an earlier run" if older else ""
            raise FileError(path, f"{why}; correct it and run it again{also}")
        results = [file for file in results if file not in older]
    if not results:
        for name in (FILES.run, FILES.batch):
            if (path / name).exists():
                return path / name, ""  # the reader will report what is wrong with it
        raise FileError(path / FILES.run, f"no such file, and no {FILES.motion} that contains a motion")
    newest, *others = sorted(results, key=lambda file: file.stat().st_mtime_ns, reverse=True)
    return newest, f"{newest.name}, which is newer than {others[0].name}" if others else ""


def read_status(directory: Path) -> dict[str, Any]:
    """Return the contents of the status file of a directory; empty if it has none that can be read."""
    try:
        status = json.loads((directory / FILES.status).read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return {}
    return status if isinstance(status, dict) else {}


def modification_time(path: Path) -> int:
    """Return the modification time of a file [ns]; 0 if it is gone."""
    try:
        return path.stat().st_mtime_ns
    except OSError:
        return 0


def load_kept(path: Path) -> Run | Trajectory:
    """Read a run or motion; raise FileError if the file is missing or contains neither."""
    from pinposture.motion import Run, Trajectory, load
    from pinposture.motion.files import kind_of

    return load(path, Trajectory) if kind_of(path) is Trajectory else load(path, Run)


def write_plot(motion: Run | Trajectory, path: Path) -> None:
    """Write the plot of a run or motion as PNG, regardless of the file name."""
    from pinposture.storage import write_figure
    from pinposture.viz import plot

    write_figure(path, plot(motion))


def write_animation(motion: Run | Trajectory, path: Path, ellipsoids: Sequence[int] = ()) -> None:
    """Write the animation of a run or motion, with ellipsoids of control points, as one HTML file."""
    from pinposture.viz import save_html

    save_html(motion.arm, motion, path, ellipsoids=ellipsoids)
