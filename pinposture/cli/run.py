"""`pinposture run`: do what a task file says."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext, suppress
from datetime import datetime, timezone
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from pinposture.cli.inputs import OUTPUT, JsonOption, ViewOption
from pinposture.cli.output import (
    count_progress,
    end_with,
    examples,
    print_facts,
    print_json,
    print_note,
    print_result,
    print_table,
    time_progress,
)
from pinposture.cli.results import keep_motion, motion_in_words, summarize_motion
from pinposture.cli.view import show
from pinposture.errors import PostureError
from pinposture.storage import check_writable, write_text

if TYPE_CHECKING:
    from pinposture.task import Reference, Task


# The directory of a run: what is in it from before, and whether that was finished.

STATUS = "status.json"
"""File that says what a directory holds."""

_RESULT = re.compile(r"motion\.[a-z]+")
"""Names of files that are kept of a motion."""

_DRAFT = re.compile(r"\..+\.[0-9a-f]{32}")
"""Names of files that were being written (`pinposture.storage`)."""


class Folder:
    """A directory that is to hold the results of one run at a time.

    Args:
        path: the directory; need not exist yet.
        task: what is to be run, for whoever looks into the directory later.

    Raises:
        FileError: it cannot be written.
    """

    def __init__(self, path: Path, task: str) -> None:
        check_writable(path)
        self.path, self.task = path, task
        self._begun, self._before = _now(), list[str]()

    def found(self) -> str:
        """What is there from before, in words; empty if nothing is."""
        results, status = self._files(_RESULT), self._status()
        said = f"{self.path} holds "
        if status.get("state") == "finished":
            said += f"the results of {status.get('task')}, finished {status.get('ended')}; they are replaced"
        elif status:
            failed = status.get("state") == "failed"
            ended = f"failed ({status.get('reason')})" if failed else "was not finished"
            said += f"a run of {status.get('task')}, begun {status.get('begun')}, that {ended}"
            since = _age(self.path / STATUS)
            new = [each for each in results if _age(each) >= since]
            said += f"; it left {_listed(new)}"
            if len(new) < len(results):
                said += f", and {_listed([each for each in results if each not in new])} from before it"
        elif results:
            said += f"{_listed(results)}, to be replaced"
        drafts = len(self._files(_DRAFT))
        if drafts:
            said += f"{'; ' if status or results else ''}half-written files, removed now: {drafts}"
        return said if drafts or status or results else ""

    def begin(self) -> None:
        """Clear away what was half-written, and write down what is begun.

        Results from before stay until there are new ones in their place.
        """
        for each in self._files(_DRAFT):
            each.unlink(missing_ok=True)
        status = self._status()
        for key in ("files", "before"):
            listed = status.get(key)
            names = [each for each in listed if isinstance(each, str)] if isinstance(listed, list) else []
            self._before += [name for name in names if _RESULT.fullmatch(name)]
        self._write(state="running", before=self._before)

    def finish(self, files: list[str]) -> None:
        """Write down that these are there, and remove those of the run before that have no successor."""
        for name in set(self._before) - set(files):
            (self.path / name).unlink(missing_ok=True)
        self._write(state="finished", ended=_now(), files=files)

    def fail(self, reason: str) -> None:
        """Write down why there is no result, if that can be written."""
        with suppress(PostureError):
            self._write(state="failed", ended=_now(), reason=reason, before=self._before)

    def _files(self, names: re.Pattern[str]) -> list[Path]:
        try:
            return sorted(
                each for each in self.path.iterdir() if names.fullmatch(each.name) and each.is_file()
            )
        except OSError:
            return []

    def _status(self) -> dict[str, Any]:
        """What the last run wrote down; empty if there was none."""
        try:
            status = json.loads((self.path / STATUS).read_text(encoding="utf-8"))
        except (OSError, ValueError, RecursionError):
            return {}
        return status if isinstance(status, dict) else {}

    def _write(self, **more: Any) -> None:
        status = {"task": self.task, "begun": self._begun, **more}
        write_text(self.path / STATUS, json.dumps(status, indent=1) + "\n")


def _listed(files: list[Path]) -> str:
    return ", ".join(each.name for each in files) or "no result"


def _age(path: Path) -> int:
    """When a file was written last; 0 if it is gone."""
    try:
        return path.stat().st_mtime_ns
    except OSError:
        return 0


def _now() -> str:
    return datetime.now(timezone.utc).astimezone().isoformat(timespec="seconds")


@examples(
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
            help="Keep motion.npz, .csv, .json, .png and .html here, or what the file asks for.",
            rich_help_panel=OUTPUT,
        ),
    ] = None,
    check: Annotated[
        bool,
        typer.Option(
            "--check",
            help="Only see whether the arm can take the postures, and how near it is to the scene in them.",
            rich_help_panel=OUTPUT,
        ),
    ] = False,
    as_json: JsonOption = False,
    view: ViewOption = False,
) -> None:
    """Do what a task file says: take postures at their times, or follow the leader.

    Between postures the curve changes smoothly, and the arm follows it within its limits; where these do not
    admit the times of the file, it takes longer, and the summary says by how much. docs/tasks.md describes
    the file; a mistake in it is named with its line.

    With -o the motion is kept in a directory. Each file appears there whole or not at all, and status.json
    says whether all are there. The exit code is 0 if the arm got there within its limits and was clear of
    everything, 1 if not, 2 if it could not start; what is for a robot (.csv, .json) is kept only if it is 0.
    """
    from pinposture.task import Task

    task = Task.load(file)
    if check:
        with count_progress("posture") as placing:
            reference = task.reference(placing)
        _print_check(file, task, reference, as_json)
        return
    folder = None if output is None else Folder(output, str(file))
    with nullcontext() if folder is None else _kept_in(folder):
        with count_progress("posture") as placing:
            reference = task.reference(placing)
        with time_progress() as moving:
            motion = task.perform(reference, moving)
        files = {} if output is None else keep_motion(motion, output, task.formats)
        if folder is not None:
            folder.finish([Path(each).name for each in files.values()])
    summary = summarize_motion(motion)
    data = {"task": str(file), **summary, "files": files}
    print_result(as_json, data, motion_in_words(summary), files.values())
    if view:
        show(motion, True, print_note)
    end_with(motion.faults)


def _print_check(file: Path, task: Task, reference: Reference, as_json: bool) -> None:
    """Say what is planned, and how well the arm can do it."""
    found = task.outlook(reference)
    places = [
        {**each._asdict(), "moved": None if each.moved is None else each.moved._asdict()} for each in found
    ]
    if as_json:
        print_json({"task": str(file), "keyframes": places, "planned": reference.duration})
    else:
        print_facts({"duration": f"{reference.duration:.4g} s, if nothing slows it"})
        headings = (
            "posture",
            "planned [s]",
            "off its curve [m]",
            "tip off [m]",
            "clearance [m]",
            "its curve is",
        )
        rows = [(*place[:-1], None if place.moved is None else str(place.moved)) for place in found]
        print_table(headings, rows)
    touching = [each for each in found if each.clearance is not None and each.clearance < 0.0]
    for each in touching:
        print_note(f"{each.name}: the arm is {-1e3 * (each.clearance or 0.0):.3g} mm inside something")
    end_with([each.name for each in touching])


@contextmanager
def _kept_in(folder: Folder) -> Iterator[None]:
    """Say what a directory holds from before, and write down in it how the run begins and that it failed."""
    found = folder.found()
    if found:
        print_note(found)
    folder.begin()
    try:
        yield
    except PostureError as error:
        folder.fail(str(error))
        raise
