"""A task: an arm, what it is to do when, and within what limits. Usually read from a file."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal, cast

import numpy as np
from numpy.typing import NDArray

from pinposture.arm import Arm
from pinposture.control import ConstrainedQP, Controller, Limits
from pinposture.errors import FileError, InvalidValue, PostureError
from pinposture.motion import Motion
from pinposture.scene import Scene
from pinposture.scene.inside import obstacles_around
from pinposture.scene.pipe import pipe
from pinposture.task.follow_leader import follow_leader
from pinposture.task.keyframe import Keyframe
from pinposture.task.keyframes import keyframe_reference
from pinposture.task.outlook import Outlook, outlook, require_room
from pinposture.task.perform import perform
from pinposture.task.reading.document import Document
from pinposture.task.reading.lines import Place
from pinposture.task.reading.motions import Leader, check_leader, check_points, read_keyframes, read_leader
from pinposture.task.reading.robots import (
    read_arm,
    read_controller,
    read_limits,
    read_start,
    read_surroundings,
)
from pinposture.task.reading.showing import shown
from pinposture.task.reference import Reference
from pinposture.task.schedule import CONTINUITIES

Array = NDArray[np.float64]

VERSION = 1
KINDS = ("keyframes", "follow_leader")
FORMATS = ("npz", "csv", "json", "png", "html")
_COMMON = ("version", "kind", "name", "arm", "limits", "controller", "scene", "start", "output")
_OWN = {"keyframes": ("keyframes", "continuity"), "follow_leader": ("leader",)}

_KEYFRAME = re.compile(r"keyframe (\d+)")


@dataclass(frozen=True, eq=False)
class Task:
    """Something for an arm to do, in time.

        task = pp.Task.load("walk.toml")
        motion = task.perform()

    Attributes:
        arm: the arm.
        motion: postures to take at their times, or the path to follow.
        limits: what a control cycle may not exceed, with `dt`.
        controller: what moves the arm.
        scene: what to keep clear of; None if nothing.
        start: where the arm is at first, (nq,); None: where the motion begins.
        continuity: as for `keyframe_reference`.
        formats: what to keep of the result, of `FORMATS`.
        name: what to call it.
    """

    arm: Arm
    motion: tuple[Keyframe, ...] | Leader
    limits: Limits
    controller: Controller = field(default_factory=ConstrainedQP)
    scene: Scene | None = None
    start: Array | None = None
    continuity: Literal["velocity", "acceleration"] = "velocity"
    formats: tuple[str, ...] = FORMATS
    name: str = ""
    _document: Document | None = None

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
        root = document.root
        if "version" in root and (root.value("version") is True or root.value("version") != VERSION):
            raise root.fault("version", f"is {shown(root.value('version'))}; allowed: {VERSION}")
        kind = root.text("kind", "keyframes", KINDS)
        for other in KINDS:
            for key in _OWN[other]:
                if key in root and kind != other:
                    raise root.fault(key, f"goes with kind = {other!r}; the kind is {kind!r}")
        root.only(*_COMMON, *_OWN[kind])
        arm = read_arm(root.table("arm"))
        leader = kind == "follow_leader"
        task = cls(
            arm=arm,
            motion=read_leader(root.table("leader")) if leader else read_keyframes(root.tables("keyframes")),
            limits=read_limits(root.table("limits"), arm),
            controller=read_controller(root.table("controller")),
            scene=read_surroundings(root.table("scene"), document.path.parent),
            start=read_start(root.table("start"), arm),
            continuity=cast(Any, root.text("continuity", "velocity", CONTINUITIES)),
            formats=_formats(document),
            name=root.text("name", document.path.stem),
            _document=document,
        )
        task._check()
        return task

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

    def _check(self) -> None:
        """Refuse what can be seen to be wrong without a search."""
        assert self._document is not None
        root = self._document.root
        if isinstance(self.motion, Leader):
            check_leader(root.table("leader"), self.motion, self.arm)
        else:
            if len(self.motion) < 2:
                found = "none" if not self.motion else "only one"
                reason = f"there is {found}; allowed: two or more, each begun by [[keyframes]]"
                raise root.fault("keyframes", reason)
            for keyframe, table in zip(self.motion, root.tables("keyframes"), strict=True):
                check_points(table, keyframe, self.arm)
        if self.scene is not None:
            named = obstacles_around(self.scene, self.arm.chain.base)
            if named:
                at = ", ".join(f"{value:.4g}" for value in self.arm.chain.base)
                reason = f"it stands where the base of the arm is, at ({at}) m; move it, or leave it out"
                raise root.table("scene").table("obstacles").fault(named[0], reason)

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


def _formats(document: Document) -> tuple[str, ...]:
    table = document.root.table("output").only("formats")
    listed = table.value("formats", list(FORMATS))
    if not isinstance(listed, list) or not all(each in FORMATS for each in listed):
        raise table.fault("formats", f"is {shown(listed)}; allowed: a list of {', '.join(FORMATS)}")
    return tuple(each for each in FORMATS if each in listed)
