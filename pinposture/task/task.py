"""A task: an arm, what it is to do when, and within what limits. Usually read from a file."""

from __future__ import annotations

import re
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal, cast

import numpy as np
from numpy.typing import NDArray

from pinposture.arm import Arm
from pinposture.collision import Scene
from pinposture.collision.pipe import pipe
from pinposture.control import Controller, Geodesic, Limits, controller_named
from pinposture.errors import FileError, InvalidValue, PostureError
from pinposture.motion import Motion
from pinposture.storage import settled
from pinposture.task.document import Document, shown
from pinposture.task.follow_leader import Leader, follow_leader
from pinposture.task.keyframe import Keyframe, usual_placement
from pinposture.task.keyframes import keyframe_reference
from pinposture.task.perform import perform
from pinposture.task.reader import TaskParts, check_task, read_task
from pinposture.task.reference import Outlook, Reference, outlook, require_room
from pinposture.task.resolving import with_fitting_joints
from pinposture.task.specification import RESULT_FORMATS
from pinposture.task.toml import Place, TomlLayout
from pinposture.task.writer import layout_of, write_task

Array = NDArray[np.float64]

_KEYFRAME = re.compile(r"keyframe (\d+)")


@dataclass(frozen=True, eq=False)
class Task:
    """Something for an arm to do, in time.

        task = pp.Task.load("walk.toml")
        motion = task.perform()
        task.edited(continuity="acceleration").save("smooth.toml")

    A task does not change; `edited` gives another one. What goes wrong with a task that was read from a file
    is told with the line of that file; one that was edited is of no file, and keeps what was `described`.

    Attributes:
        arm: the arm.
        motion: postures to take at their times, two or more, or the path to follow. Where it leaves open how
            curves are laid, they stay where they are drawn if the scene has obstacles; else they are aligned.
        limits: what a control cycle may not exceed, with `dt`.
        controller: what moves the arm; an instance, or its name.
        scene: what to keep clear of; None if nothing.
        start: where the arm is at first, (nq,); None: where the motion begins.
        continuity: as for `keyframe_reference`.
        formats: what to keep of the result, of `FORMATS`.
        name: what to call it.
        scans: files of surfaces and point clouds that an editor shows, absolute; nobody keeps clear of them,
            and they need not be there.
        described: what `save` may write of a curve, a tip, a scene or an obstacle, by that part itself: what
            stands for it in a task file, in SI units, a `Path` for each path. For instance
            `{curve: "helix", path: Path("path.csv")}`. What is not in it, or no longer gives the part, is
            written out.
        layout: the TOML file that the task was read from, the comments and layout of which `save` keeps; None
            if there is none.

    Raises:
        PostureError: a value that no task file could hold; see `pinposture.task.reader`.
    """

    arm: Arm
    motion: tuple[Keyframe, ...] | Leader
    limits: Limits
    controller: Controller = field(default_factory=Geodesic)
    scene: Scene | None = None
    start: Array | None = None
    continuity: Literal["velocity", "acceleration"] = "velocity"
    formats: tuple[str, ...] = RESULT_FORMATS
    name: str = ""
    scans: tuple[Path, ...] = ()
    described: Mapping[Hashable, object] = field(default_factory=dict, repr=False)
    layout: TomlLayout | None = field(default=None, repr=False)
    # Not among the arguments, so that `replace` leaves it behind.
    _document: Document | None = field(default=None, init=False, repr=False)

    def __post_init__(self) -> None:
        self._settle("controller", controller_named(self.controller))
        if not isinstance(self.motion, Leader):
            self._settle("motion", _listed("keyframes", self.motion, "two or more of Keyframe(...)"))
        formats = _listed("formats", self.formats, f"some of {', '.join(RESULT_FORMATS)}")
        self._settle("formats", formats)
        scans = _listed("scans", self.scans, "paths of files")
        for scan in scans:
            if not isinstance(scan, str | Path) or not str(scan).strip() or "\0" in str(scan):
                raise InvalidValue("scans", self.scans, "paths of files")
        self._settle("scans", tuple(map(settled, scans)))
        check_task(self._parts())
        self._settle("motion", _placed(self.arm, self.motion, usual_placement(self.scene)))
        self._settle("formats", tuple(each for each in RESULT_FORMATS if each in formats))
        self._settle("described", dict(self.described))
        if self.start is not None:
            start = self.arm.checked_start(self.start, "start")
            start.flags.writeable = False
            self._settle("start", start)

    def _settle(self, name: str, value: object) -> None:
        object.__setattr__(self, name, value)

    def _parts(self) -> TaskParts:
        return TaskParts(*(getattr(self, name) for name in TaskParts._fields))

    @classmethod
    def load(cls, path: str | Path) -> Task:
        """Read a task file, TOML or JSON; docs/tasks.md says what it may hold.

        All of it is checked but for what takes a search: whether the arm can take the postures, and be there
        in time, is found out by `reference` and `perform`.

        Raises:
            FileError: the file is missing or malformed, or says what cannot be; names the line, the key, the
                value and what is allowed.
        """
        document = Document(Path(path))
        parts = read_task(document)
        try:
            task = cls(**parts._asdict())
        except PostureError as error:
            raise document.fault((), str(error)) from error
        task._settle("_document", document)
        if document.toml is not None:
            task._settle("layout", layout_of(parts, document.path, document.toml))
        return task

    def save(self, path: str | Path) -> Path:
        """Write a task file, from which `load` makes an equal task; whole or not at all. Returns its path.

        Numbers are in SI units. Files that the task names are named relative to the new one. Parts are
        described as `described` says; a curve that is not in it is written with its points. An arm is
        written as what it was made from (`Arm.spec`): a template, a URDF file that still is the same, or else
        its URDF in a file beside the task file, of the same name. Comments
        and layout of the TOML file that the task was read from stay, and so do units and order wherever what
        is said there has not changed.

        Args:
            path: .toml or .json.

        Raises:
            FileError: the name ends otherwise, the file cannot be written, the URDF file is there and is
                another one, or something that no task file can say: an arm without URDF, a controller with
                parameters of its own.
        """
        return write_task(self._parts(), Path(path), self.layout)

    def edited(self, **changes: Any) -> Task:
        """The task with other attributes, as by `dataclasses.replace`; it belongs to no file.

        Raises:
            PostureError: as `Task`.
        """
        return replace(self, **changes)

    def reference(self, progress: Callable[[int, int], object] | None = None) -> Reference:
        """What the arm should do when, before limits have a say.

        Args:
            progress: called with the number of postures found so far, and that of all.

        Raises:
            FileError: the arm cannot do that; names the keyframe. A task that was not read from a file raises
                as `keyframe_reference` and `follow_leader`.
        """
        dt = cast(float, self.limits.dt)
        with self._naming():
            if isinstance(self.motion, Leader):
                asked = self.motion._asdict()
                asked.pop("pipe")
                return follow_leader(self.arm, interval=dt, start=self.start, progress=progress, **asked)
            return keyframe_reference(self.arm, self.motion, dt, self.continuity, progress)

    def outlook(self, reference: Reference) -> list[Outlook]:
        """How well the arm can take the postures, before anything moves; the scene is looked at in them only.

        Args:
            reference: what `reference` gave.

        Raises:
            PostureError: as `surroundings`.
        """
        return outlook(reference, self.surroundings(reference))

    def surroundings(self, reference: Reference) -> Scene | None:
        """What to keep clear of: the scene, with the pipe around the path if there is one."""
        if not isinstance(self.motion, Leader) or self.motion.pipe is None:
            return self.scene
        laid = reference.marks[0].target.curve
        assert laid is not None  # whoever follows a leader has a path
        with self._naming("leader", "pipe"):
            walls = pipe(laid, self.motion.pipe)
            if self.scene is None:
                return walls
            return replace(self.scene, obstacles={**self.scene.obstacles, **walls.obstacles})

    def perform(
        self,
        reference: Reference | None = None,
        progress: Callable[[float, float], object] | None = None,
    ) -> Motion:
        """Do it; see `pinposture.task.perform`.

        Args:
            reference: what `reference` gave, if it was asked for before.
            progress: as for `pinposture.task.perform`.

        Raises:
            PostureError: as `reference`, and as `pinposture.task.perform`; or the arm would begin inside of
                something.
        """
        reference = self.reference() if reference is None else reference
        start = None if isinstance(self.motion, Leader) else self.start
        scene = self.surroundings(reference)
        with self._naming():
            require_room(reference, scene)
        return perform(reference, self.controller, self.limits, scene, q0=start, progress=progress)

    @contextmanager
    def _naming(self, *where: str) -> Iterator[None]:
        """Say of an error in which file, and where, its cause is."""
        try:
            yield
        except PostureError as error:
            if self._document is None:
                raise
            raise self._told(error, where) from error

    def _told(self, error: PostureError, where: Place) -> FileError:
        """An error of the search as one of the file."""
        assert self._document is not None
        if isinstance(self.motion, Leader):
            reason, key = str(error), error.name if isinstance(error, InvalidValue) else ""
            if key in self.motion._fields and isinstance(error, InvalidValue):
                reason = f"is {shown(error.value)}; allowed: {error.allowed}"
            own = ("leader", key if key in self.motion._fields else "path")
            return self._document.fault(where or (("start",) if key == "start" else own), reason)
        number = _KEYFRAME.match(str(error))  # the message begins with what it is about
        line = self._document.line(("keyframes", int(number[1]) - 1) if number else ("keyframes",))
        text = str(error)
        return FileError(self._document.path, f"{'' if line is None else f'line {line}: '}{text}")


def _placed(arm: Arm, motion: tuple[Keyframe, ...] | Leader, usual: Any) -> tuple[Keyframe, ...] | Leader:
    """The motion with all that it leaves open of where its curves are laid, and joints that fit the arm."""
    if isinstance(motion, Leader):
        return motion._replace(placement=usual) if motion.placement is None else motion
    motion = with_fitting_joints(arm, motion)
    return tuple(each if each.placement else replace(each, placement=usual) for each in motion)


def _listed(name: str, values: object, allowed: str) -> tuple[Any, ...]:
    """A sequence as a tuple; text is none."""
    if isinstance(values, str) or not isinstance(values, Iterable):
        raise InvalidValue(name, values, allowed)
    return tuple(values)
