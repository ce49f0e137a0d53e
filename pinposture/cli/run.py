"""`pinposture run`: perform a task file."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import dataclass
from datetime import datetime, timezone
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from pinposture.cli.inputs import MOTION, OUTPUT, JsonOption, ViewOption, read_changes, refuse_given
from pinposture.cli.output import (
    FILES,
    check_directory,
    count_progress,
    end_with,
    examples,
    modification_time,
    motion_files,
    print_facts,
    print_json,
    print_note,
    print_result,
    print_table,
    progress_bar,
    read_status,
    words_of,
    write_files,
)
from pinposture.cli.view import show
from pinposture.errors import InvalidValue, PostureError, enumerated
from pinposture.storage import write_text

if TYPE_CHECKING:
    from pinposture.task import Reference, Task

_RESULT = re.compile(r"motion\.[a-z]+")
"""Names of the files of a motion."""

_DRAFT = re.compile(r"\..+\.[0-9a-f]{32}")
"""Names of partially written files (`pinposture.storage`)."""


class Folder:
    """A directory for the results of one run at a time.

    Args:
        path: the directory; may not exist yet.
        task: the task to run, recorded in the status file.

    Raises:
        FileError: the directory cannot be written.
    """

    def __init__(self, path: Path, task: str) -> None:
        check_directory(path)
        self.path = path
        self.task = task
        self._begun = _now()
        self._before = list[str]()

    def found(self) -> str:
        """Describe existing contents; empty if there are none."""
        results = self._files(_RESULT)
        status = read_status(self.path)
        said = f"{self.path} holds "
        replaced = "replaced when this run finishes"
        if status.get("state") == "finished":
            said += f"the results of {status.get('task')}, finished {status.get('ended')}; {replaced}"
        elif status:
            failed = status.get("state") == "failed"
            ended = f"failed ({status.get('reason')})" if failed else "was not finished"
            said += f"a run of {status.get('task')}, begun {status.get('begun')}, that {ended}"
            since = modification_time(self.path / FILES.status)
            new = [file for file in results if modification_time(file) >= since]
            said += f"; it left {_listed(new)}"
            if len(new) < len(results):
                said += f", and {_listed([file for file in results if file not in new])} from before it"
        elif results:
            said += f"{_listed(results)}; {replaced}"
        drafts = len(self._files(_DRAFT))
        if drafts:
            said += f"{'; ' if status or results else ''}half-written files, removed now: {drafts}"
        return said if drafts or status or results else ""

    def begin(self) -> None:
        """Remove partially written files and record the start of the run.

        Previous results remain until new ones replace them.
        """
        for draft in self._files(_DRAFT):
            draft.unlink(missing_ok=True)
        status = read_status(self.path)
        for key in ("files", "before"):
            listed = status.get(key)
            names = [item for item in listed if isinstance(item, str)] if isinstance(listed, list) else []
            self._before += [name for name in names if _RESULT.fullmatch(name)]
        self._write(state="running", before=self._before)

    def finish(self, files: list[str]) -> None:
        """Record the files of the finished run, and remove previous results that were not replaced."""
        for name in set(self._before) - set(files):
            (self.path / name).unlink(missing_ok=True)
        self._write(state="finished", ended=_now(), files=files)

    def fail(self, reason: str) -> None:
        """Record why there is no result, if possible."""
        with suppress(PostureError):
            self._write(state="failed", ended=_now(), reason=reason, before=self._before)

    def _files(self, names: re.Pattern[str]) -> list[Path]:
        try:
            return sorted(
                file for file in self.path.iterdir() if names.fullmatch(file.name) and file.is_file()
            )
        except OSError:
            return []

    def _write(self, **more: Any) -> None:
        status = {"task": self.task, "begun": self._begun, **more}
        write_text(self.path / FILES.status, json.dumps(status, indent=1) + "\n")


def _listed(files: list[Path]) -> str:
    return ", ".join(file.name for file in files) or "no result"


def _now() -> str:
    return datetime.now(timezone.utc).astimezone().isoformat(timespec="seconds")


@dataclass(frozen=True)
class RetreatOptions:
    """Whether it is examined that the arm can come out again."""

    retreat: Annotated[
        int | None,
        OUTPUT(
            "With --check: from which of this many postures, evenly spaced, the arm could not come out again "
            "if any one of its hinges failed there. It takes seconds to minutes for each.",
            "N",
        ),
    ] = None
    failure: Annotated[
        str | None,
        OUTPUT(
            "With --retreat, how the hinge fails: stuck (the default), limp, or weak, which is a drive with "
            "30 % of the torque by which weight loads it in the outstretched arm.",
            "KIND",
        ),
    ] = None

    def read(self, check: bool) -> tuple[int, str] | None:
        """Return from how many postures it is to come out, and how a hinge fails; None: it is not asked.

        Raises:
            InvalidValue: a number below 1, or not with what it belongs to.
            UnknownName: another kind of failure.
        """
        from pinposture._validation import require_known
        from pinposture.sim.plant import FAILURES

        count = self.retreat
        if count is not None and (not check or count < 1):
            raise InvalidValue("--retreat", count, "a number of 1 or more, with --check")
        if count is None:
            refuse_given({"--failure": self.failure}, "nothing without --retreat")
            return None
        kind = FAILURES[0] if self.failure is None else self.failure
        require_known("kind of failure", kind, FAILURES)
        return count, kind


@examples(
    "pinposture run examples/tasks/keyframes.toml -o out/keyframes",
    "pinposture run examples/tasks/around.toml --json",
    "pinposture run examples/tasks/pipe.toml --check",
    "pinposture run examples/tasks/pipe.toml --check --retreat 5",
    "pinposture run examples/tasks/pipe.toml --check --retreat 5 --failure limp",
    "pinposture run examples/tasks/inspection.toml -o out/inspection",
    "pinposture run examples/tasks/keyframes.toml --set limits.velocity=1",
    "pinposture run examples/tasks/keyframes.toml -o out/keyframes --view",
)
def run(
    *,
    file: Annotated[Path, typer.Argument(metavar="TASK", help="A task file, .toml or .json.")],
    output: Annotated[
        Path | None,
        OUTPUT(
            "Save motion.npz, .csv, .json, .png and .html here, or the formats in the file.",
            "DIR",
            flags="--output -o",
        ),
    ] = None,
    changes: Annotated[
        list[str] | None,
        MOTION(
            "Another value of a key of the file, with a unit or without; repeatable.",
            "KEY=VALUE",
            flags="--set",
        ),
    ] = None,
    check: Annotated[
        bool,
        OUTPUT(
            "Only check whether the arm can take and hold the postures, and their clearance from the scene.",
            flags="--check",
        ),
    ] = False,
    retreat_options: RetreatOptions,
    as_json: JsonOption = False,
    view: ViewOption = False,
) -> None:
    """Perform a task file: take postures at their times, follow the leader, or do both in phases.

    Between postures the curve changes smoothly, and the arm follows it within its limits; if these do not
    allow the times of the file, it takes longer, and the summary says by how much. docs/tasks.md describes
    the file; errors in it are reported with their line.

    With -o the motion is saved in a directory. Each file is written atomically, and status.json says whether
    all are complete. The exit code is 0 if the arm converged within its limits without penetration, 1 if not,
    2 if it could not start or be saved; files for a robot (.csv, .json) are written only if it is 0.
    """
    from pinposture.task import Task
    from pinposture.task.reference import find_crowded

    asked = retreat_options.read(check)
    task = Task.load(file, read_changes(changes))
    if check:
        with count_progress("posture") as placing:
            reference = task.reference(placing)
        out = None if asked is None else _find_retreats(task, reference, *asked)
        _print_check(file, task, reference, out, as_json)
        return
    folder = None if output is None else Folder(output, str(file))
    with nullcontext() if folder is None else _kept_in(folder):
        with count_progress("posture") as placing:
            reference = task.reference(placing)
        scene = task.surroundings(reference)
        for where, keyframe in find_crowded(reference, scene).items():
            if not keyframe.crowding(0.0):  # of the others, `perform` warns
                print_note(f"{where}: {keyframe.crowding(scene.margin)}")
        with progress_bar("moving", "{:.1f} s of {:.1f} s", first="planning") as moving:
            motion = task.perform(reference, moving)
        files, failure = write_files([] if output is None else motion_files(motion, output, task.formats))
        if folder is not None and failure is None:
            folder.finish([Path(file).name for file in files.values()])
        summary = motion.summary()
        data = {"task": str(file), **summary, "files": files}
        print_result(as_json, data, words_of(summary), files.values(), failure)
    if view:
        show(motion, True, print_note)
    end_with(motion.faults)


def _find_retreats(task: Task, reference: Reference, count: int, kind: str) -> dict[str, Any]:
    """Return from which of evenly spaced postures the arm cannot come out first, as JSON-compatible data.

    A slide, such as the feed, does not count: no arm comes out if that sticks.

    Raises:
        InvalidValue: the arm holds something on its way.
        WeightUnknown: a limp or weak hinge of an arm whose masses are not known.
    """
    import numpy as np

    from pinposture.sim.plant import PLANT
    from pinposture.task import can_retreat

    if reference.held:
        raise InvalidValue("--retreat", count, "only for a task in which the arm holds nothing")
    arm = task.arm
    hinges = [arm.joint_names[u] for u in arm.columns if not arm.slides[u]]
    share = {"stuck": None, "limp": 0.0, "weak": PLANT.weak}[kind]
    torques = None
    if share is not None:
        loads = dict(zip(arm.joint_names, arm.outstretched_torques.tolist(), strict=True))
        torques = {name: share * loads[name] for name in hinges}
    rows = np.array([reference.configuration(row) for row in range(reference.rows)])
    postures = np.unique(np.linspace(0, reference.rows - 1, count + 1).round().astype(int))[1:].tolist()
    with count_progress("posture") as examining:
        retreats = can_retreat(
            arm,
            rows,
            task.surroundings(reference),
            hinges or None,
            torque=torques,
            postures=postures,
            limits=task.limits,
            budget=10.0,  # for one joint [s]
            until_blocked=True,
            progress=examining,
        )
    first = retreats.first
    examined = len({way.posture for way in retreats.ways})
    blocked = None
    if first is not None:
        blocked = {
            "planned": float(reference.times[first.posture]),
            "joints": {way.joint: way.position for way in retreats.blocked},
            "reason": first.reason,
        }
    return {"failure": kind, "examined": examined, "first_blocked": blocked}


def _retreats_in_words(retreats: Mapping[str, Any]) -> str:
    blocked = retreats["first_blocked"]
    kind = retreats["failure"]
    if blocked is None:
        return f"from all postures examined ({retreats['examined']}), whichever hinge is {kind} there"
    joints = enumerated([f"{name} at {at:.4g}" for name, at in blocked["joints"].items()], 4)
    return f"not at {blocked['planned']:.4g} s if one of these is {kind}: {joints}; {blocked['reason']}"


def _print_check(
    file: Path, task: Task, reference: Reference, out: Mapping[str, Any] | None, as_json: bool
) -> None:
    """Print the plan, how well the arm can perform it, and from where it could not come out again."""
    keyframes = task.feasibility(reference)
    described = [
        {
            **keyframe._asdict(),
            "moved": None if keyframe.moved is None else keyframe.moved._asdict(),
            "overload": None if keyframe.overload is None else keyframe.overload.as_data(),
        }
        for keyframe in keyframes
    ]
    if as_json:
        told = {} if out is None else {"retreat": out}
        print_json({"task": str(file), "keyframes": described, "planned": reference.duration, **told})
    else:
        retreat = {} if out is None else {"comes out": _retreats_in_words(out)}
        print_facts({"duration": f"{reference.duration:.4g} s, if nothing slows it", **retreat})
        headings = (
            "posture",
            "planned [s]",
            "off its curve [m]",
            "tip off [m]",
            "clearance [m]",
            "between",
            "its curve is",
        )
        pairs = [" to ".join(keyframe.pair) if keyframe.pair else None for keyframe in keyframes]
        ways = [None if keyframe.moved is None else str(keyframe.moved) for keyframe in keyframes]
        rows = [(*keyframe[:5], *words) for keyframe, *words in zip(keyframes, pairs, ways, strict=True)]
        print_table(headings, rows)
    scene = task.surroundings(reference)
    for keyframe in keyframes:
        if crowded := keyframe.crowding(scene.margin):
            print_note(f"{keyframe.name}: {crowded}")
        if keyframe.overload is not None:
            print_note(f"{keyframe.name}: {keyframe.overload}")
    end_with(
        [keyframe.name for keyframe in keyframes if keyframe.crowding(0.0) or keyframe.overload is not None]
    )


@contextmanager
def _kept_in(folder: Folder) -> Iterator[None]:
    """Print a note on existing contents of a directory, and record the start and any failure of the run."""
    contents = folder.found()
    if contents:
        print_note(contents)
    folder.begin()
    try:
        yield
    except PostureError as error:
        folder.fail(str(error))
        raise
