"""A task: an arm, the motion that it should make, and the limits of that motion. Usually read from a file."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from pinposture.collision import Scene
from pinposture.collision.pipe import pipe
from pinposture.control import controller_named
from pinposture.errors import FileError, InvalidValue, PostureError
from pinposture.motion import Motion
from pinposture.storage import settled
from pinposture.task.follow_leader import Leader, follow_leader
from pinposture.task.keyframe import usual_placement, with_fitting_joints
from pinposture.task.keyframes import keyframe_reference
from pinposture.task.perform import perform
from pinposture.task.reader import Document, TaskParts, check_task, read_task
from pinposture.task.reference import Outlook, Reference, outlook, require_room
from pinposture.task.specification import RESULT_FORMATS, shown
from pinposture.task.toml import Place, TomlLayout
from pinposture.task.writer import layout_of, write_task

Array = NDArray[np.float64]

_KEYFRAME = re.compile(r"keyframe (\d+)")


@dataclass(frozen=True, eq=False)
class Task(TaskParts):
    """A motion for an arm to make, in time.

        task = pp.Task.load("walk.toml")
        motion = task.perform()
        task.edited(continuity="acceleration").save("smooth.toml")

    A task does not change; `edited` returns another one. Errors of a task that was read from a file name the
    line of that file; a task that was edited belongs to no file, and keeps what was `described`.

    Attributes:
        arm: the arm.
        motion: two or more postures to take at their times, or the path to follow. Curves whose placement is
            left open stay where they are drawn if the scene has obstacles; else they are aligned.
        limits: limits of a control cycle, with `dt`.
        controller: what moves the arm; an instance, or its name.
        scene: what to keep clear of; None if nothing.
        start: the first configuration, (nq,); None: where the motion begins.
        continuity: as for `keyframe_reference`.
        formats: what to keep of the result, of `FORMATS`.
        name: the name of the task.
        scans: files of surfaces and point clouds that an editor shows, absolute; the arm does not keep clear
            of them, and they need not exist.
        described: what `save` may write for a curve, a tip, a scene or an obstacle, by that part itself: its
            description in a task file, in SI units, with a `Path` for each path. For instance
            `{curve: "helix", path: Path("path.csv")}`. A part that is not in it, or that its description no
            longer gives, is written out.
        layout: the TOML file that the task was read from, whose comments and layout `save` keeps; None if
            there is none.

    Raises:
        PostureError: a value that no task file could hold; see `pinposture.task.reader`.
    """

    layout: TomlLayout | None = field(default=None, repr=False)
    # Not among the arguments, so that `replace` drops it.
    _document: Document | None = field(default=None, init=False, repr=False)

    def __post_init__(self) -> None:
        self._set("controller", controller_named(self.controller))
        if not isinstance(self.motion, Leader):
            self._set("motion", _as_tuple("keyframes", self.motion, "two or more of Keyframe(...)"))
        formats = _as_tuple("formats", self.formats, f"some of {', '.join(RESULT_FORMATS)}")
        self._set("formats", formats)
        scans = _as_tuple("scans", self.scans, "paths of files")
        for scan in scans:
            if not isinstance(scan, str | Path) or not str(scan).strip() or "\0" in str(scan):
                raise InvalidValue("scans", self.scans, "paths of files")
        self._set("scans", tuple(map(settled, scans)))
        check_task(self)
        placement: Any = usual_placement(self.scene)
        if not isinstance(self.motion, Leader):
            motion = with_fitting_joints(self.arm, self.motion)
            placed = (each if each.placement else replace(each, placement=placement) for each in motion)
            self._set("motion", tuple(placed))
        elif self.motion.placement is None:
            self._set("motion", self.motion._replace(placement=placement))
        self._set("formats", tuple(each for each in RESULT_FORMATS if each in formats))
        self._set("described", dict(self.described))
        if self.start is not None:
            start = self.arm.checked_start(self.start, "start")
            start.flags.writeable = False
            self._set("start", start)

    def _set(self, name: str, value: object) -> None:
        object.__setattr__(self, name, value)

    @classmethod
    def load(cls, path: str | Path) -> Task:
        """Read a task file, TOML or JSON; docs/tasks.md describes the format.

        Everything is checked that needs no search. Whether the arm can take the postures, and reach them in
        time, is found out by `reference` and `perform`.

        Raises:
            FileError: the file is missing or malformed, or describes no task; names the line, the key, the
                value and what is allowed.
        """
        document = Document.load(Path(path))
        parts = read_task(document)
        try:
            task = cls(**vars(parts))
        except PostureError as error:
            raise document.fault((), str(error)) from error
        task._set("_document", document)
        if document.toml is not None:
            task._set("layout", layout_of(parts, document.path, document.toml))
        return task

    def save(self, path: str | Path) -> Path:
        """Write a task file, from which `load` makes an equal task; whole or not at all. Returns its path.

        Numbers are in SI units. Paths of files are relative to the new one. Parts are written as in
        `described`; a curve that is not in it is written with its points. An arm is written as what it was
        made from (`Arm.spec`): a template, a URDF file that is still the same, or else its URDF in a file
        beside the task file, of the same name. The comments and layout of the TOML file that the task was
        read from stay, and so do units and order wherever values have not changed.

        Args:
            path: .toml or .json.

        Raises:
            FileError: the name ends otherwise, the file cannot be written, another URDF file is in the way,
                or no task file can describe the task: an arm without URDF, a controller with parameters of
                its own.
        """
        return write_task(self, Path(path), self.layout)

    def edited(self, **changes: Any) -> Task:
        """Return the task with other attributes, as by `dataclasses.replace`; it belongs to no file.

        Raises:
            PostureError: as `Task`.
        """
        return replace(self, **changes)

    def reference(self, progress: Callable[[int, int], object] | None = None) -> Reference:
        """Compute the motion that the task asks for, before limits apply.

        Args:
            progress: called with the number of postures found so far, and that of all.

        Raises:
            FileError: the arm cannot make the motion; names the keyframe. A task that was not read from a
                file raises as `keyframe_reference` and `follow_leader`.
        """
        dt = cast(float, self.limits.dt)
        with self._naming():
            if isinstance(self.motion, Leader):
                arguments = self.motion._asdict()
                del arguments["pipe"]
                return follow_leader(self.arm, interval=dt, start=self.start, progress=progress, **arguments)
            return keyframe_reference(self.arm, self.motion, dt, self.continuity, progress)

    def outlook(self, reference: Reference) -> list[Outlook]:
        """Tell how well the arm can take the postures, before it moves; clearances are those of the postures.

        Args:
            reference: what `reference` returned.

        Raises:
            PostureError: as `surroundings`.
        """
        return outlook(reference, self.surroundings(reference))

    def surroundings(self, reference: Reference) -> Scene | None:
        """Return what to keep clear of: the scene, with the pipe around the path if there is one."""
        path = reference.marks[0].target.curve if reference.marks else None
        if not isinstance(self.motion, Leader) or self.motion.pipe is None or path is None:
            return self.scene
        with self._naming("leader", "pipe"):
            walls = pipe(path, self.motion.pipe)
            if self.scene is None:
                return walls
            return replace(self.scene, obstacles={**self.scene.obstacles, **walls.obstacles})

    def perform(
        self,
        reference: Reference | None = None,
        progress: Callable[[float, float], object] | None = None,
    ) -> Motion:
        """Make the motion; see `pinposture.task.perform`.

        Args:
            reference: what `reference` returned, if it was called before.
            progress: as for `pinposture.task.perform`.

        Raises:
            PostureError: as `reference`, and as `pinposture.task.perform`; or the arm would begin inside of
                an obstacle.
        """
        reference = self.reference() if reference is None else reference
        start = None if isinstance(self.motion, Leader) else self.start
        scene = self.surroundings(reference)
        with self._naming():
            require_room(reference, scene)
        return perform(reference, self.controller, self.limits, scene, q0=start, progress=progress)

    @contextmanager
    def _naming(self, *where: str) -> Iterator[None]:
        """Name the file, if there is one, and the line in errors."""
        try:
            yield
        except PostureError as error:
            if self._document is None:
                raise
            raise self._file_error(self._document, error, where) from error

    def _file_error(self, document: Document, error: PostureError, where: Place) -> FileError:
        message = str(error)
        if isinstance(self.motion, Leader):
            key = error.name if isinstance(error, InvalidValue) else ""
            if key == "start":
                return document.fault(where or ("start",), message)
            if key in self.motion._fields and isinstance(error, InvalidValue):
                return document.fault(
                    where or ("leader", key), f"is {shown(error.value)}; allowed: {error.allowed}"
                )
            return document.fault(where or ("leader", "path"), message)
        number = _KEYFRAME.match(message)  # the message begins with its subject
        line = document.line(("keyframes", int(number[1]) - 1) if number else ("keyframes",))
        return FileError(document.path, message if line is None else f"line {line}: {message}")


def _as_tuple(name: str, values: object, allowed: str) -> tuple[Any, ...]:
    """Return a sequence as a tuple; refuse text."""
    if isinstance(values, str) or not isinstance(values, Iterable):
        raise InvalidValue(name, values, allowed)
    return tuple(values)
