"""A task: an arm, its motion, and the limits of that motion; usually read from a file."""

from __future__ import annotations

import logging
import re
import textwrap
from collections import deque
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from copy import copy
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from math import ceil
from pathlib import Path
from typing import Annotated, Any, Literal, cast

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray
from pydantic import PlainValidator, ValidationInfo

from pinposture._validation import require_instance, require_known, require_positive, require_whole
from pinposture.arm import Arm, ArmSpec
from pinposture.arm.configurations import SLACK
from pinposture.arm.manipulability import chosen_points
from pinposture.collision import Scene
from pinposture.collision.model import effective_scene
from pinposture.collision.obstacles import OBSTACLE_TYPES
from pinposture.collision.scene import obstacles_around
from pinposture.control import Controller, EndEffector, Geodesic, Limits, Step, controller_named
from pinposture.control.limits import DEFAULT_CYCLE, LONGEST_CYCLE, JerkFilter, cycle_of
from pinposture.control.planner.follow import GeodesicMemory
from pinposture.control.planner.objective import Objective
from pinposture.control.planner.path import SPEED_SHARE, JointPath, SpeedProfile, TimedPath, retime
from pinposture.curve import Curve
from pinposture.errors import FileError, InvalidValue, PostureError, TaskError
from pinposture.motion.run import Run
from pinposture.motion.track import PROGRESS_SHARE, STALL_TRAVEL, ControlLoop, in_scene
from pinposture.motion.trajectory import Trajectory, Waypoint
from pinposture.placement import Target
from pinposture.schema import (
    Count,
    NotAllowed,
    Place,
    Refusal,
    Text,
    in_file,
    is_list_of,
    is_table,
    one_of,
    read_as,
    read_by,
    read_keys,
    read_within,
    read_word,
    shown,
    write_parts,
)
from pinposture.storage import require_suffix, settled, write_text
from pinposture.task.document import (
    TASK_SUFFIXES,
    Descriptions,
    Document,
    document_text,
    folder_of,
    plain_data,
    read_arm,
    write_arm,
)
from pinposture.task.fields import (
    RESULT_FORMATS,
    SceneField,
    read_controller,
    read_formats,
    read_scans,
    read_start,
    write_controller,
    write_scene,
    write_start,
)
from pinposture.task.follow_leader import Leader, check_leader, follow_leader
from pinposture.task.keyframe import (
    CONTINUITIES,
    Keyframe,
    as_keyframes,
    check_keyframes,
    naming,
    placed,
    title,
    usual_placement,
    with_fitting_joints,
)
from pinposture.task.keyframes import keyframe_reference
from pinposture.task.passage import require_passage
from pinposture.task.phases import (
    Phase,
    check_phases,
    is_phased,
    keyed,
    phased_reference,
    surrounded,
    with_pipe,
    with_placements,
)
from pinposture.task.reference import (
    Mark,
    Outlook,
    Reference,
    Way,
    off_curve,
    outlook,
    require_room,
    tip_off,
)
from pinposture.task.toml import TomlLayout, Usual
from pinposture.units import length_text

Array = NDArray[np.float64]

_KEYFRAME = re.compile(r"keyframe (\d+)")
_PHASE = re.compile(r"phase (\d+)")


@dataclass(frozen=True, eq=False)
class Task:
    """A motion of an arm over time.

        task = pp.Task.load("walk.toml")
        motion = task.perform()
        task.edited(continuity="acceleration").save("smooth.toml")

    A task is immutable; `edited` returns a changed copy. Errors of a task read from a file name the line. An
    edited task belongs to no file, but keeps what was `described`.

    Attributes:
        arm: the arm.
        motion: two or more keyframes, the path to follow, or one or more of `Phase`. By default, curves stay
            as drawn if the scene has obstacles, and are aligned otherwise.
        limits: limits of a control cycle, with `dt`.
        controller: the controller, or its name.
        scene: the obstacles to avoid; None without any, when the arm keeps clear of itself alone.
        start: the initial configuration, (nq,); None: that of the first posture.
        continuity: as for `keyframe_reference`.
        formats: formats in which to save the result, of `RESULT_FORMATS`.
        name: its name.
        scans: absolute paths of surfaces and point clouds that an editor shows. The arm does not avoid them,
            and they need not exist.
        described: the description that `save` writes for a curve, tip, scene or obstacle, by that object: in
            SI units, with a `Path` for each path, as in `{curve: "helix", path: Path("path.csv")}`. Objects
            without one, or whose description has become outdated, are written in full.
        repeat: as for `keyframe_reference`.
        layout: the TOML file from which the task was read, whose comments and layout `save` preserves; or
            None.

    Raises:
        PostureError: a value that a task file cannot represent; see `Task.save`.
    """

    arm: Arm
    motion: tuple[Keyframe, ...] | tuple[Phase, ...] | Leader
    limits: Limits
    controller: Controller = field(default_factory=Geodesic)
    scene: Scene | None = None
    start: Array | None = None
    continuity: Literal["velocity", "acceleration"] = "velocity"
    formats: tuple[str, ...] = RESULT_FORMATS
    name: str = ""
    scans: tuple[Path, ...] = ()
    described: Mapping[Hashable, object] = field(default_factory=dict, repr=False)
    repeat: int = 1
    layout: TomlLayout | None = field(default=None, repr=False)
    # Not among the arguments, so that `replace` drops it.
    _document: Document | None = field(default=None, init=False, repr=False)

    def __post_init__(self) -> None:
        self._set("controller", controller_named(self.controller))
        if not isinstance(self.motion, Leader):
            allowed = "two or more of Keyframe(...), or one or more of Phase(...)"
            self._set("motion", _as_tuple("keyframes", self.motion, allowed))
        formats = _as_tuple("formats", self.formats, f"some of {', '.join(RESULT_FORMATS)}")
        self._set("formats", formats)
        scans = _as_tuple("scans", self.scans, "paths of files")
        for scan in scans:
            if not isinstance(scan, str | Path) or not str(scan).strip() or "\0" in str(scan):
                raise InvalidValue("scans", self.scans, "paths of files")
        self._set("scans", tuple(map(settled, scans)))
        _check(self)
        if is_phased(self.motion):
            self._set("motion", with_placements(self.motion, self.arm, self.scene))
        elif not isinstance(self.motion, Leader):
            keyframes = cast("tuple[Keyframe, ...]", self.motion)
            self._set("motion", placed(with_fitting_joints(self.arm, keyframes), self.scene))
        elif self.motion.placement is None:
            placement = usual_placement(self.scene, self.motion.path)
            self._set("motion", replace(self.motion, placement=placement))
        self._set("formats", tuple(each for each in RESULT_FORMATS if each in formats))
        self._set("described", dict(self.described))
        if self.start is not None:
            start = self.arm.checked_start(self.start, "start")
            start.flags.writeable = False
            self._set("start", start)

    def __repr__(self) -> str:
        motion = self.motion
        if isinstance(motion, Leader):
            does = f"follow {motion.path}"
        elif is_phased(motion):
            names = ", ".join(each.name or str(number) for number, each in enumerate(motion, 1))
            does = f"{len(motion)} phases: {textwrap.shorten(names, 70, placeholder=' ...')}"
        else:
            keyframes = cast("tuple[Keyframe, ...]", motion)
            names = ", ".join(each.name or str(number) for number, each in enumerate(keyframes, 1))
            does = f"{len(motion)} keyframes: {textwrap.shorten(names, 70, placeholder=' ...')}"
        laps = f", {self.repeat} times" if self.repeat > 1 else ""
        around = f"{self.scene}, " if self.scene else ""
        cycle = f"{self.controller.name}, cycle {cycle_of(self.limits):g} s"
        return f"Task({self.name!r}, {does}{laps},\n     {self.arm},\n     {around}{cycle})"

    def _set(self, name: str, value: object) -> None:
        object.__setattr__(self, name, value)

    @classmethod
    def load(cls, path: str | Path, changes: Mapping[str, object] | None = None) -> Task:
        """Read a task file, TOML or JSON; docs/tasks.md describes the format.

        This checks the file, but not whether the arm can reach the postures; see `reference` and `perform`.

        Args:
            path: the file.
            changes: values that replace those of the file, by key, as in {"limits.velocity": "90 deg/s",
                "keyframes.2.time": 3}; list items count from 1.

        Raises:
            FileError: the file is missing, malformed, or not a task; names the line, the key, the value and
                what is allowed.
        """
        document = Document.load(Path(path))
        require_instance("changes", changes, Mapping | None, "a mapping from keys to values, or None")
        for key, value in (changes or {}).items():
            document.change(key, value)
        task = cls._read(document)
        task._set("_document", document)
        if document.toml is not None and not changes:
            task._set("layout", TomlLayout(document.toml, partial(_as_read, copy(task), document.path)))
        return task

    @classmethod
    def _read(cls, document: Document, arm: Arm | None = None) -> Task:
        """Return the task of a document, with this arm, or that of the document."""
        try:
            return cls(**read_task(document, arm))
        except PostureError as error:
            if isinstance(error, FileError) and error.path == document.path:
                raise
            raise document.fault((), str(error)) from error

    def save(self, path: str | Path) -> Path:
        """Write a task file atomically, from which `load` makes an equal task; return its path.

        Numbers are in SI units, paths relative to the new file. Curves, tips, scenes and obstacles are
        written as `described`, or in full. The arm is written as its specification (`Arm.spec`): a template,
        the name of an unchanged URDF file, or else its URDF in a file of the same name next to the task file.
        Comments, layout, and the units of unchanged values of the original TOML file are preserved.

        Args:
            path: .toml or .json.

        Raises:
            FileError: another suffix, the file cannot be written, it would overwrite a different URDF file,
                or a task file cannot represent the task: an arm without URDF, a controller with custom
                parameters.
        """
        file = Path(path)
        require_suffix(file, *TASK_SUFFIXES)
        with folder_of(file):  # relative paths in the file start from it
            descriptions = Descriptions(file, self)
            spec, urdf = write_arm(self.arm, descriptions)
            contents = _contents(self, spec, descriptions)
            text = document_text(file, contents, self.layout, partial(self._require_same, spec, file))
            if urdf is not None:
                write_text(urdf, self.arm.urdf or "")
            try:
                write_text(file, text)
            except BaseException:
                if urdf is not None:  # useless without the task
                    urdf.unlink(missing_ok=True)
                raise
        return file

    def _require_same(self, spec: ArmSpec, path: Path, text: str) -> None:
        """Raise FileError if the text of a file reads back as a different task."""
        try:
            text.encode()
        except UnicodeEncodeError as error:
            half = f"{text[error.start]!r} in a text of the task, half of a surrogate pair"
            raise FileError(path, f"{half}, cannot be written") from None
        document = Document.parse(path, text)
        wrong = _differences(self, Task._read(document, self.arm))
        if not _same_spec(spec, document.read(ArmSpec, ("arm",))):
            wrong.append("arm")
        if wrong:
            raise FileError(path, f"cannot represent the task: {', '.join(wrong)} would change when read")

    def edited(self, **changes: Any) -> Task:
        """Return a copy with changed attributes, as `dataclasses.replace`; it belongs to no file.

        Raises:
            PostureError: as `Task`.
        """
        return replace(self, **changes)

    def reference(self, progress: Callable[[int, int], object] | None = None) -> Reference:
        """Compute the planned motion, to which limits are not yet applied.

        Args:
            progress: called with the number of postures found so far, and the total number.

        Raises:
            FileError: the arm cannot perform the motion; names the keyframe. A task that was not read from a
                file raises as `keyframe_reference` and `follow_leader`.
        """
        dt = cast(float, self.limits.dt)
        with self._naming():
            if isinstance(self.motion, Leader):
                arguments = self.motion.arguments()
                return follow_leader(self.arm, interval=dt, start=self.start, progress=progress, **arguments)
            if is_phased(self.motion):
                return phased_reference(
                    self.arm,
                    self.motion,
                    self.limits,
                    self.effective_scene,
                    self.start,
                    self.continuity,
                    progress,
                )
            keyframes = cast("tuple[Keyframe, ...]", self.motion)
            return keyframe_reference(self.arm, keyframes, dt, self.continuity, progress, self.repeat)

    def outlook(self, reference: Reference) -> list[Outlook]:
        """Predict how well the arm can reach the postures; clearances are those at the postures.

        Args:
            reference: what `reference` returned.

        Raises:
            PostureError: as `surroundings`, or a gap on the way of a leader is too narrow.
        """
        scene = self.surroundings(reference)
        with self._naming():
            require_passage(reference, scene, MAX_MEAN_LAG * self.arm.length / self.arm.n_modules)
        return outlook(reference, scene)

    @cached_property
    def effective_scene(self) -> Scene:
        """What the arm keeps clear of: the scene, or that of the arm alone."""
        return effective_scene(self.arm, self.scene)

    def surroundings(self, reference: Reference) -> Scene:
        """Return the obstacles to avoid: the scene, and the pipe around the path if there is one.

        Raises:
            PostureError: the pipe bends too much, or is too narrow for the arm and the margin.
        """
        if is_phased(self.motion):
            with self._naming():
                return surrounded(self.motion, reference, self.effective_scene)
        path = reference.marks[0].target.curve if reference.marks else None
        if not isinstance(self.motion, Leader) or self.motion.pipe is None or path is None:
            return self.effective_scene
        with self._naming("leader", "pipe"):
            return with_pipe(self.scene, path, self.motion.pipe, reference)

    def perform(
        self,
        reference: Reference | None = None,
        progress: Callable[[float, float], object] | None = None,
    ) -> Trajectory:
        """Perform the motion; see `perform`.

        Args:
            reference: the result of `reference`, if it was called before.
            progress: as for `perform`.

        Raises:
            PostureError: as `reference` and `perform`, or the arm would start inside an obstacle.
        """
        reference = self.reference() if reference is None else reference
        start = None if isinstance(self.motion, Leader) or is_phased(self.motion) else self.start
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
        """Return an error with the line of each of its reasons."""
        if not error.reasons:
            return self._located(document, error, where)
        return document.together([self._located(document, each, where) for each in error.reasons])

    def _located(self, document: Document, error: PostureError, where: Place) -> FileError:
        message = str(error)
        if isinstance(self.motion, Leader):
            key = error.name if isinstance(error, InvalidValue) else ""
            if key == "start":
                return document.fault(where or ("start",), message)
            if hasattr(self.motion, key) and isinstance(error, InvalidValue):
                return document.fault(
                    where or ("leader", key), f"is {shown(error.value)}; allowed: {error.allowed}"
                )
            return document.fault(where or ("leader", "path"), message)
        if is_phased(self.motion):
            found = _PHASE.match(message)
            place: Place = ("phases", int(found[1]) - 1) if found else ("phases",)
            line = document.line(place)
            return FileError(document.path, message if line is None else f"line {line}: {message}")
        if isinstance(error, InvalidValue) and error.name == "repeat":
            return document.fault(("repeat",), f"is {shown(error.value)}; allowed: {error.allowed}")
        number = _KEYFRAME.match(message)  # the message begins with its subject
        line = document.line(("keyframes", int(number[1]) - 1) if number else ("keyframes",))
        return FileError(document.path, message if line is None else f"line {line}: {message}")


def _as_tuple(name: str, values: object, allowed: str) -> tuple[Any, ...]:
    """Return a sequence as a tuple; refuse text."""
    if isinstance(values, str) or not isinstance(values, Iterable):
        raise InvalidValue(name, values, allowed)
    return tuple(values)


def _check(task: Task) -> None:
    """Refuse a task that a file cannot represent.

    Raises:
        InvalidValue: an attribute of the wrong type, or one that does not fit the arm.
        UnknownName: a `continuity`, a format or a control point that does not exist.
        TaskError: a keyframe or an obstacle that does not fit the arm; names it.
    """
    require_instance("arm", task.arm, Arm, "an Arm")
    cycle = cycle_of(task.limits)
    if cycle > LONGEST_CYCLE:
        raise InvalidValue("dt", cycle, f"{LONGEST_CYCLE:g} s at most")
    task.limits.for_arm(task.arm)
    require_known("continuity", task.continuity, CONTINUITIES)
    require_whole("repeat", task.repeat, 1)
    for each in task.formats:
        require_known("format", each, RESULT_FORMATS)
    require_instance("name", task.name, str, "text")
    described = task.described
    kinds = (Curve, EndEffector, Scene, *OBSTACLE_TYPES.values())
    if not isinstance(described, Mapping) or not all(isinstance(each, kinds) for each in described):
        allowed = "a mapping from curves, tips, a scene or obstacles to their descriptions"
        raise InvalidValue("described", described, allowed)
    if isinstance(task.motion, Leader):
        check_leader(task.motion, task.arm, task.scene)
        for key, only in (("continuity", CONTINUITIES[0]), ("repeat", 1)):
            if getattr(task, key) != only:
                raise InvalidValue(key, getattr(task, key), f"{only!r}, of a leader")
    elif is_phased(task.motion):
        phases = task.motion
        check_phases(phases, task.arm, task.scene)
        for phase in phases:
            _check_points(keyed(phase), task.arm)
        if task.repeat != 1:
            raise InvalidValue("repeat", task.repeat, "1, of phases")
    else:
        keyframes = as_keyframes(cast("tuple[Keyframe, ...]", task.motion))
        check_keyframes(keyframes, task.arm)
        _check_points(keyframes, task.arm)
    if task.scene is not None and not isinstance(task.scene, Scene):
        raise InvalidValue("scene", task.scene, "a Scene, or None")
    for name, reason in _around_base(task.scene, task.arm):
        raise TaskError(f"obstacle {name!r}", reason)


def _check_points(keyframes: tuple[Keyframe, ...], arm: Arm) -> None:
    for index, keyframe in enumerate(keyframes):
        if keyframe.tip is not None:
            with naming(title(keyframes, index)):
                try:
                    chosen_points(arm.control_points, keyframe.tip.point)
                except InvalidValue as error:  # which calls it "points"
                    raise InvalidValue("point", error.value, error.allowed) from None


def _around_base(scene: Scene | None, arm: Arm) -> list[tuple[str, str]]:
    """Return the obstacles that contain the base of the arm: the name of each, and a message."""
    at = ", ".join(f"{value:.4g}" for value in arm.chain.base)
    reason = f"it stands where the base of the arm is, at ({at}) m; move it, or leave it out"
    names = () if scene is None else obstacles_around(scene, arm.chain.base)
    return [(name, reason) for name in names]


# Tasks as files: `read_task` reads what `_contents` writes.

VERSION = 1

_KEYS_OF_KIND = {
    "keyframes": ("keyframes", "continuity", "repeat"),
    "follow_leader": ("leader",),
    "phases": ("phases", "continuity"),
}

_TASK_KEYS = (
    *("version", "kind", "name", "continuity", "repeat", "arm", "scene", "keyframes", "leader", "phases"),
    *("limits", "controller", "start", "output", "editor"),
)


def _check_keys(values: Mapping[str, Any], _: object) -> Mapping[str, Any]:
    """Refuse another version, unknown keys, and keys of another kind of motion."""
    version = values.get("version", VERSION)
    if version is True or version != VERSION:
        raise Refusal(f"is {shown(version)}; allowed: {VERSION}", "version")
    kind = read_within("kind", read_word, values.get("kind", "keyframes"), _KEYS_OF_KIND)
    own = _KEYS_OF_KIND[kind]
    others = {key: other for other, keys in _KEYS_OF_KIND.items() for key in keys if key not in own}
    for key, other in others.items():
        if key in values:
            raise Refusal(f"goes with kind = {other!r}; the kind is {kind!r}", key)
    return read_keys(values, [key for key in _TASK_KEYS if key not in others])


def _read_list(kind: type[Keyframe | Phase], key: str, least: int) -> PlainValidator:
    """Read a list of `least` or more tables."""

    def read(value: Any, info: ValidationInfo) -> Any:
        listed = value or []
        if not is_list_of(is_table)(listed):
            raise NotAllowed(value, f"a list of tables, each begun by [[{key}]]")
        if len(listed) < least:
            found = "only one" if listed else "none"
            words = {1: "one", 2: "two"}[least]
            raise Refusal(f"there is {found}; allowed: {words} or more, each begun by [[{key}]]")
        return read_as(tuple[kind, ...], listed, in_file(info))  # type: ignore[valid-type]

    return read_by(read)


_READ_AS: Mapping[str, Any] = {
    "scene": SceneField,
    "keyframes": Annotated[Any, _read_list(Keyframe, "keyframes", 2)],
    "leader": Leader,
    "phases": Annotated[Any, _read_list(Phase, "phases", 1)],
    "limits": Limits,
    "controller": Annotated[Any, read_by(read_controller)],
    "start": Annotated[Any, read_by(read_start)],
    "continuity": Annotated[str, one_of("continuity", *CONTINUITIES)],
    "repeat": Count,
    "name": Text,
    "output": Annotated[Any, read_by(read_formats)],
    "editor": Annotated[Any, read_by(read_scans)],
}
"""What the value of each key is read as; after the arm, on which many of them depend."""

_OTHER_NAMES = {
    "keyframes": "motion",
    "leader": "motion",
    "phases": "motion",
    "output": "formats",
    "editor": "scans",
}
"""Arguments of `Task` with other names than their keys."""


def read_task(document: Document, arm: Arm | None = None) -> dict[str, Any]:
    """Return the arguments of `Task`.

    Args:
        document: the file.
        arm: the arm, if it exists already; otherwise it is made from the file.

    Raises:
        FileError: the file is not a valid task; names the line, the key, the value and what is allowed.
    """
    values = document.values
    document.read(Annotated[Any, read_by(_check_keys)], ())
    document.arm = read_arm(document) if arm is None else arm
    motion = _KEYS_OF_KIND[values.get("kind", "keyframes")][0]
    needed = ("scene", motion, "limits", "controller")
    found = document.read_all({key: kind for key, kind in _READ_AS.items() if key in values or key in needed})
    scene = found["scene"]
    _check_surroundings(document, found.get(motion), scene)
    arguments = {_OTHER_NAMES.get(key, key): value for key, value in found.items()}
    return {
        "arm": document.arm,
        "name": document.path.stem,
        "described": document.described,
        **arguments,
    }


def _check_surroundings(document: Document, motion: Any, scene: Scene | None) -> None:
    """Refuse pipes that are too narrow, and obstacles where the base of the arm is."""
    errors: list[PostureError] = []
    arm = document.arm
    if isinstance(motion, Leader):
        leaders: dict[Place, Any] = {("leader",): motion}
    else:
        leaders = {
            ("phases", index, "leader"): getattr(each, "motion", None) for index, each in enumerate(motion)
        }
    for where, leader in leaders.items():
        if not isinstance(leader, Leader):
            continue
        try:
            with document.blaming(where):
                check_leader(leader, arm, scene)
        except FileError as error:
            errors.append(error)
    errors += [
        document.fault(("scene", "obstacles", name), reason) for name, reason in _around_base(scene, arm)
    ]
    if errors:
        raise document.together(errors)


def _contents(task: Task, arm: ArmSpec, file: Descriptions) -> dict[str, Any]:
    """Return all tables that are not empty, in the order of the file."""
    contents: dict[str, Any] = {
        "version": VERSION,
        "kind": _kind(task),
        "name": task.name if task.name != file.file.stem else Usual(task.name),
    }
    if task.continuity != "velocity":
        contents["continuity"] = task.continuity
    if task.repeat != 1:
        contents["repeat"] = task.repeat
    contents["arm"] = arm.to_table(file)
    contents["limits"] = task.limits.to_table(file)
    controller = write_controller(task.controller, file.file)
    if controller:
        contents["controller"] = controller
    if task.start is not None:
        contents["start"] = write_start(task.start, task.arm)
    if task.scene is not None:
        contents["scene"] = write_scene(task.scene, file)
    if isinstance(task.motion, Leader):
        contents["leader"] = task.motion.to_table(file)
    elif is_phased(task.motion):
        contents["phases"] = write_parts(task.motion, file)
    else:
        contents["keyframes"] = write_parts(task.motion, file)
    if task.formats != RESULT_FORMATS:
        contents["output"] = {"formats": task.formats}
    if task.scans:
        contents["editor"] = {"scans": task.scans}
    plain: dict[str, Any] = plain_data(contents, file.folder)
    return plain


def _as_read(task: Task, path: Path) -> dict[str, Any]:
    """Return the contents of the file from which a task was read."""
    descriptions = Descriptions(path, task, just_read=True)
    return _contents(task, write_arm(task.arm, descriptions)[0], descriptions)


def _kind(task: Task) -> str:
    if isinstance(task.motion, Leader):
        return "follow_leader"
    return "phases" if is_phased(task.motion) else "keyframes"


ROTATION_TOLERANCE = 1e-12
"""Largest difference of rotations, which angles in a file do not preserve to the last bit."""


def _differences(task: Task, parts: Task) -> list[str]:
    """Return the names of the attributes that differ, arm and descriptions aside."""
    plain = ("limits", "controller", "scene", "continuity", "repeat", "formats", "name", "scans")
    same = {key: getattr(task, key) == getattr(parts, key) for key in plain}
    same["start"] = _close(task.start, parts.start)
    if isinstance(task.motion, Leader) or isinstance(parts.motion, Leader):
        same["motion"] = task.motion == parts.motion
    else:
        count = len(task.motion) == len(parts.motion)
        same["motion"] = count and all(map(_same_part, task.motion, parts.motion))
    return [key for key, equal in same.items() if not equal]


def _same_part(one: Keyframe | Phase, other: Keyframe | Phase) -> bool:
    """Whether two keyframes or two phases are the same, as far as a file can tell."""
    if isinstance(one, Keyframe) and isinstance(other, Keyframe):
        return _same_keyframe(one, other)
    if not isinstance(one, Phase) or not isinstance(other, Phase):
        return False
    mine = keyed(one)
    its = keyed(other)
    if not mine or not its:
        return one == other
    return one.name == other.name and len(mine) == len(its) and all(map(_same_keyframe, mine, its))


def _same_keyframe(one: Keyframe, other: Keyframe) -> bool:
    mine = one.tip
    its = other.tip
    if mine is None or its is None or mine.pose is None or its.pose is None:
        return one == other
    still = pin.SE3.Identity()
    same = replace(one, tip=replace(mine, pose=still)) == replace(other, tip=replace(its, pose=still))
    return same and _close(mine.pose, its.pose)


def _close(one: Array | None, other: Array | None) -> bool:
    if one is None or other is None:
        return one is other
    tolerance = ROTATION_TOLERANCE
    return one.shape == other.shape and bool(np.allclose(one, other, rtol=tolerance, atol=tolerance))


def _same_spec(one: ArmSpec, other: ArmSpec) -> bool:
    """Whether two specifications are the same; files may be named through links."""

    def resolved(spec: ArmSpec) -> ArmSpec:
        folders = tuple(each.resolve() for each in spec.package_dirs)
        file = None if spec.urdf is None else Path(spec.urdf).resolve()
        return replace(spec, urdf=file, package_dirs=folders)

    return resolved(one) == resolved(other)


# Performing a motion: the arm follows a reference, and the plan waits where necessary.

Progress = Callable[[float, float], object]

logger = logging.getLogger(__name__)

MAX_MEAN_LAG = 0.1
"""Mean distance of the control points from their targets, in module lengths, beyond which the plan waits for
a controller that does not look ahead, and beyond which a named posture is missed."""

ROW_TOLERANCE = 1e-9
"""Distance before a row at which it counts as reached, in rows."""

STOPPED = "stopped by the callback"

MAX_PERFORMED_CYCLES = 1e6
"""Largest number of cycles of a motion."""

STEP_BUDGET_RATIO = 10.0
STEP_BUDGET_EXTRA = 3000
"""Number of steps after which a motion is given up: a multiple of the expected number, plus an extra."""


MARK_SHARE = 0.6
"""Share of `MAX_MEAN_LAG` by which a jerk limit may lead the arm past a mark."""

MAX_SLOWDOWNS = 10
SLOWDOWN_MARGIN = 1.02
"""Number of attempts to pass all marks closely enough, and the factor by which each slows down more than the
error requires."""

HELD_ROUNDING = 1e-12
"""Motion from one row to the next that counts as none [rad or m]."""


class ReferencePath:
    """A reference as a path that can be followed at any speed. Places are row numbers, not only whole ones.

    Args:
        reference: the reference.
        limits: the limits of a step, with dt.

    Attributes:
        reference: the reference.
        times: planned time of each of its rows, (N + 1,) [s].
        path: its configurations as a path through joint space, within the position limits.
        timed: the path at the largest speed that limits and marks allow, up to that of the plan, and slower
            where a jerk limit would lead the arm past a mark.

    Raises:
        InvalidValue: limits so tight that it would take too many cycles.
    """

    def __init__(self, reference: Reference, limits: Limits) -> None:
        arm = reference.arm
        bounds = limits.for_arm(reference.arm)
        self.reference = reference
        self.times = reference.times
        self._rows = np.arange(reference.rows, dtype=np.float64)
        self._dt = cycle_of(limits)
        self._lower, self._upper = bounds.edges - arm.positions(reference.start)
        offsets = np.minimum(np.maximum(reference.offsets, self._lower), self._upper)
        # Joints that do not move the arm stay where they are.
        offsets = np.ascontiguousarray(offsets * (arm.moved > 0.0))
        q = arm.integrate(reference.start, offsets[0])
        first = Target(arm.at(q).compiled.points, reference.weights[0], q)
        self.path = JointPath(Objective(arm, first), reference.start, offsets).within(bounds.edges)
        self._limits = limits
        durations = reference.interval if reference.durations is None else reference.durations
        self._rates = np.full(reference.rows - 1, self._dt / durations)
        self._retime()
        cycles = JerkFilter(arm, limits).cycles
        if any(mark.speed < 1.0 for mark in reference.marks):
            self._limit_speeds(0)
            self._limit_speeds(1 + cycles // 2)  # averaged steps lie on both sides of a mark
        self._slow_down_at_marks(cycles)

    @property
    def _profile(self) -> SpeedProfile:
        return cast(SpeedProfile, self.timed.profile)  # there is one for a finite rate

    def _retime(self) -> None:
        self.timed = retime(self.path, self._limits, self._rates)
        if self.steps > MAX_PERFORMED_CYCLES:
            most = f"{MAX_PERFORMED_CYCLES:g}"
            allowed = f"limits under which it takes at most {most} cycles, or a plan that asks for less"
            raise InvalidValue("cycles of the motion", round(self.steps), allowed)

    def _limit_speeds(self, beside: int) -> None:
        """Lower the rates to the speeds of the marks, for so many cycles also before and after."""
        before = self.path.slopes[:-1]
        after = self.path.slopes[1:]
        middle = 3.0 * np.diff(self.path.offsets, axis=0) - before - after
        slopes = np.abs([before, middle, after]).max(axis=0)  # the slope in between is in their hull
        bound = SPEED_SHARE * self.timed.bounds.bound
        full = np.maximum((slopes / bound).max(axis=1), ROW_TOLERANCE)  # cycles per row at full speed
        begin = 0
        places = self.timed.places
        for mark in self.reference.marks:
            if mark.speed < 1.0:
                cycles = np.searchsorted(places, (begin, mark.row)) + (-beside, beside)
                first, last = places[np.clip(cycles, 0, len(places) - 1)]
                piece = slice(min(int(first), begin), max(ceil(last), mark.row))
                self._rates[piece] = np.minimum(self._rates[piece], mark.speed / full[piece])
            begin = mark.row
        self._retime()

    def _slow_down_at_marks(self, cycles: int) -> None:
        """Lower the rates at marks that the arm would miss if its steps are averaged over so many cycles.

        The arm is then at the mean of the configurations at as many places. Its distance from the path is
        proportional to the square of the rate.
        """
        offsets = self.path.offsets
        module = self.path.arm.length / self.path.arm.n_modules
        moving = np.flatnonzero(np.any(np.abs(np.diff(offsets, axis=0)) > HELD_ROUNDING, axis=1))
        for _ in range(MAX_SLOWDOWNS if cycles > 1 else 0):
            places = np.pad(self.timed.places, (cycles - 1, cycles), mode="edge")
            slower = False
            passed = np.cumsum(np.append(0.0, places))
            means = (passed[cycles:] - passed[:-cycles]) / cycles
            for mark in self.reference.marks:
                left = moving[np.searchsorted(moving, mark.row) :]
                middle = 0.5 * (mark.row + left[0]) if len(left) else self.end  # of the time it is held
                after = int(np.searchsorted(means, middle))
                if not 0 < after < len(means):
                    continue
                share = (middle - means[after - 1]) / (means[after] - means[after - 1])
                averaged = places[after - 1 : after + cycles]
                averaged = (1.0 - share) * averaged[:-1] + share * averaged[1:]
                excess = self._distance(averaged, middle) / (MARK_SHARE * MAX_MEAN_LAG * module)
                if excess > 1.0:
                    ratio = SLOWDOWN_MARGIN * np.sqrt(excess)
                    slower = True
                    first, last = middle + (averaged[[0, -1]] - middle) / ratio
                    piece = slice(int(first), ceil(last))
                    rate = (averaged[-1] - averaged[0]) / (cycles - 1) / ratio
                    self._rates[piece] = np.minimum(self._rates[piece], rate)
            if not slower:
                break
            self._retime()

    def _distance(self, averaged: Array, place: float) -> float:
        """Return the mean distance of the control points, at a mean of configurations, from a place [m]."""
        arm = self.path.arm
        target = self.target(place)
        q = arm.integrate(self.path.start, self.path.smooth_offset(averaged).mean(axis=0))
        return target.mean_distance(arm.at(q).compiled.points)

    @property
    def end(self) -> float:
        """The last place."""
        return self.path.end

    @property
    def steps(self) -> float:
        """Smallest possible number of cycles."""
        return self._profile.steps

    def is_within_limits(self, row: int) -> bool:
        """Whether the path goes through a row of the reference, which the position limits may prevent."""
        offset = self.reference.offsets[row] * (self.reference.arm.moved > 0.0)
        return bool(np.abs(offset - self.path.offsets[row]).max() <= SLACK)

    def time(self, place: float | Array) -> Array:
        """Return the planned time at places [s]."""
        return np.asarray(np.interp(place, self._rows, self.times))

    def cycles(self, place: float, row: int) -> int:
        """Return the planned number of cycles from a place to a row."""
        return ceil((float(self.times[row]) - float(self.time(place))) / self._dt - ROW_TOLERANCE)

    def next(self, place: float, speed: float) -> float:
        """Return the place after the next cycle; the previous one advanced by `speed`."""
        return min(place + self._profile.next(place, speed), self.end)

    def target(self, place: float) -> Target:
        """Return the target posture at a place."""
        arm = self.reference.arm
        row = min(int(np.ceil(place)), self.reference.rows - 1)
        offset = np.minimum(np.maximum(self.path.smooth_offset(place), self._lower), self._upper)
        q = arm.integrate(self.reference.start, offset)
        return Target(arm.at(q).compiled.points, self.reference.weights[row], q)

    def remaining(self, place: float, controller: Geodesic) -> TimedPath:
        """Return the rest of the path from a place, which is a whole row."""
        row = int(place)
        path = self.path
        objective = controller.objective(path.arm, self.target(place))
        if row == 0:
            return retime(path.revised(objective=objective), self.timed.limits, self._rates)
        offsets = path.offsets[row:] - path.offsets[row]
        rest = JointPath(objective, path.configuration(row), offsets, controller.scene)
        return retime(rest, self.timed.limits, self._rates[row:])

    def next_mark(self, place: float) -> Mark:
        """Return the next named place; the last row if there is none."""
        last = self.reference.rows - 1
        ahead = [mark for mark in self.reference.marks if mark.row > place]
        return ahead[0] if ahead else Mark("the end", last, self.target(float(last)))


def perform(
    reference: Reference,
    controller: str | Controller = "geodesic",
    limits: Limits | None = None,
    scene: Scene | None = None,
    q0: ArrayLike | None = None,
    tolerance: float | None = None,
    progress: Progress | None = None,
) -> Trajectory:
    """Move an arm along a reference, within its limits.

    The arm first moves to the start of the reference, unless it is there. Then the plan advances in real
    time where the limits allow it, and more slowly elsewhere. "geodesic" looks ahead: it slows down early
    enough and follows the path of the reference; where an obstacle blocks it, it plans its own path to the
    next named place. Other controllers get a moving target, which waits for them when they fall behind.

    Args:
        reference: the planned motion.
        controller: as for `track`.
        limits: limits of a step, with `dt`, the duration of a control cycle; cycles of 20 ms and the velocity
            limits of the arm if None.
        scene: as for `track`.
        q0: initial configuration, (nq,); that of the reference if None.
        tolerance: as for `track`, for the first and the last posture.
        progress: called in each cycle with the time and the duration of the plan [s]; the motion stops if it
            returns True.

    Returns:
        The motion. `run.status` is "converged" if the arm took all named postures, "missed" if it passed one
        of them at a mean distance of more than a tenth of a module and half a cycle's motion, else as for
        `track`; `time_scale` is its duration relative to the plan.

    Raises:
        InvalidValue: limits without dt, or so tight that it would never end; an invalid q0 or tolerance.
        UnknownName: no controller of that name.
    """
    require_instance("reference", reference, Reference, "a Reference, as `keyframe_reference` returns it")
    arm = reference.arm
    controller, scene = in_scene(controller_named(controller), scene)
    limits = Limits(step=None, dt=DEFAULT_CYCLE) if limits is None else limits
    dt = cycle_of(limits)
    tolerance = 1e-6 * arm.length if tolerance is None else tolerance
    require_positive("tolerance", tolerance)
    start = reference.start if q0 is None else arm.checked_start(q0, "q0")
    require_passage(reference, scene, MAX_MEAN_LAG * arm.length / arm.n_modules)
    guide = ReferencePath(reference, limits)
    loop = ControlLoop(arm, start, guide.target(0.0), controller, limits, scene)
    performance = _Performance(guide, loop, tolerance, progress)
    motion = performance.trajectory(*performance.run())
    status = motion.run.status
    reason = motion.run.reason
    logger.info("%s: %s after %.4g s: %s", controller.name, status, dt * motion.steps, reason)
    return motion


def move_through(
    arm: Arm,
    keyframes: Sequence[Keyframe],
    controller: str | Controller = "geodesic",
    limits: Limits | None = None,
    scene: Scene | None = None,
    q0: ArrayLike | None = None,
    continuity: Literal["velocity", "acceleration"] = "velocity",
    repeat: int = 1,
) -> Trajectory:
    """Move through keyframes at their times: `keyframe_reference` and `perform` in one call.

    Args:
        arm: the arm.
        keyframes: the keyframes, in order. By default, curves stay as drawn if the scene has obstacles.
        controller: as for `track`.
        limits: as for `perform`.
        scene: as for `track`.
        q0: initial configuration, (nq,); that of the first keyframe if None.
        continuity: as for `keyframe_reference`.
        repeat: likewise.

    Returns:
        The motion.

    Raises:
        PostureError: as those two.
    """
    limits = Limits(step=None, dt=DEFAULT_CYCLE) if limits is None else limits
    require_instance("scene", scene, Scene | None, "a Scene(...), or None")
    keyframes = placed(as_keyframes(keyframes), scene)
    reference = keyframe_reference(arm, keyframes, cycle_of(limits), continuity, repeat=repeat)
    return perform(reference, controller, limits, scene, q0)


class _Performance:
    """A motion in progress: the place on the reference and the target after each step."""

    def __init__(
        self, guide: ReferencePath, loop: ControlLoop, tolerance: float, progress: Progress | None
    ) -> None:
        self.guide = guide
        self.loop = loop
        self.tolerance = tolerance
        self.progress = progress
        self._max_steps = STEP_BUDGET_EXTRA + int(STEP_BUDGET_RATIO * guide.steps)
        self._max_lag = MAX_MEAN_LAG * loop.arm.length / loop.arm.n_modules
        self._latest: deque[float] = deque(maxlen=loop.filter.cycles)
        self._set_place(0.0)
        self._places = [0.0]
        self._targets = [guide.target(0.0)]
        self._start_index: int | None = None  # None until the first posture is reached
        self._notes: list[str] = []

    def _set_place(self, place: float) -> None:
        """Set the place of an arm at rest."""
        self._place = place
        self._latest.extend([place] * self.loop.filter.cycles)

    def _advance(self, place: float) -> float:
        """Set the place of the arm ahead; return that of the arm itself, which a jerk limit delays."""
        self._place = place
        self._latest.append(place)
        return place if len(self._latest) == 1 else sum(self._latest) / len(self._latest)

    def run(self) -> tuple[str, str]:
        """Move to the first posture, along the reference, and to rest; return status and reason."""
        status, reason = self._go_to(0.0)
        if status != "converged":
            return status, f"on the way to the first posture: {reason}"
        self._start_index = len(self._places) - 1
        controller = self.loop.controller
        ended = self._look_ahead(controller) if isinstance(controller, Geodesic) else self._lead()
        return self._go_to(self.guide.end) if ended is None else ended

    def trajectory(self, status: str, reason: str) -> Trajectory:
        """Return everything so far as a result; "missed" if only the last of its postures was reached."""
        reference = self.guide.reference
        loop = self.loop
        places = np.array(self._places)
        run = loop.record.run(loop.arm, loop.controller, loop.limits, status, reason)
        nexts = [*(mark.row for mark in reference.marks[1:]), np.inf]
        waypoints = tuple(
            self._waypoint(mark, until, places, run)
            for mark, until in zip(reference.marks, nexts, strict=False)
        )
        if status == "converged" and any(waypoint.missed for waypoint in waypoints):
            reason = f"{self._describe_missed(waypoints)}; at the end, {run.reason}"
            run = replace(run, status="missed", reason=reason)
        return Trajectory(
            run=run,
            targets=np.array([target.points for target in self._targets]),
            target_mask=np.array([target.has_target for target in self._targets]),
            plan_time=self.guide.time(places),
            start_index=len(places) - 1 if self._start_index is None else self._start_index,
            planned=float(self.guide.times[-1]),
            waypoints=waypoints,
            deviations=tuple(self._notes),
        )

    def _waypoint(self, mark: Mark, until: float, places: Array, run: Run) -> Waypoint:
        """Return how a named place was passed, before the next one, which is at `until`.

        That is at the first step at which the arm is near it; at the step nearest in time if it never is.
        """
        reference = self.guide.reference
        begun = self._start_index
        moved = mark.target.moved
        planned = float(self.guide.times[mark.row])
        off = off_curve(mark)
        there = np.flatnonzero(places[begun:] >= mark.row - ROW_TOLERANCE)
        if begun is None or not len(there):
            return Waypoint(mark.name, planned, None, None, None, off, moved=moved, speed=mark.speed)
        row = begun + int(there[0])
        if row > begun and mark.row - places[row - 1] < places[row] - mark.row:
            row -= 1
        end = max(row + 1, begun + int(np.searchsorted(places[begun:], until - ROW_TOLERANCE)))
        chosen = mark.target.has_target
        first = max(row - 1, 0)
        points = run.points[first : end + 1]
        errors = mark.target.distances(points)[:, chosen].mean(axis=1)
        steps = np.linalg.norm(np.diff(points[:, chosen], axis=0), axis=2).mean(axis=1)
        allowed = self._max_lag + 0.5 * np.maximum(np.append(0.0, steps), np.append(steps, 0.0))
        near = (errors <= allowed)[row - first : end - first]
        row = row + int(np.argmax(near))
        missed = not np.any(near)
        reached = (row - begun) * cycle_of(run.limits)
        error = float(errors[row - first])
        tip = tip_off(mark.tip, mark.target, reference.arm.at(run.q[row]))
        if mark.way is not None:
            since = max([other.row for other in reference.marks if other.row < mark.row], default=0)
            first = begun + int(np.searchsorted(places[begun : row + 1], since))
            off = mark.way.distance(run.q[min(first, row) : row + 1])
            missed = missed or off > self._max_distance(mark.way)
        return Waypoint(mark.name, planned, reached, row, error, off, tip, moved, mark.speed, missed)

    def _max_distance(self, way: Way) -> float:
        """Return the largest accepted distance of the arm from its path [m]."""
        return way.planned + self._max_lag

    def _describe_missed(self, waypoints: tuple[Waypoint, ...]) -> str:
        """Say which named postures the arm passed at a distance, and why if that is known."""
        for mark, waypoint in zip(self.guide.reference.marks, waypoints, strict=True):
            off = waypoint.off_curve or 0.0
            if mark.way is not None and waypoint.missed and off > self._max_distance(mark.way):
                most = length_text(self._max_distance(mark.way))
                allowed = f"planned: {length_text(mark.way.planned)}, allowed: {most}"
                return f"the arm left its path by {length_text(off)} on the way to {mark.name} ({allowed})"
        missed = [waypoint for waypoint in waypoints if waypoint.missed]
        worst = max(missed, key=lambda waypoint: waypoint.mean_error or 0.0)
        one = len(missed) == 1
        number = f"{len(missed)} of {len(waypoints)} postures"
        text = f"{number} {'is' if one else 'are'} missed, {'' if one else 'most '}{worst.name}, by "
        text += f"{length_text(worst.mean_error or 0.0)} on average (allowed: {length_text(self._max_lag)})"
        row = self.guide.reference.marks[waypoints.index(worst)].row
        if not self.guide.is_within_limits(row):
            text += "; it is outside the joint limits, or within their position margin"
        return text

    def _go_to(self, place: float, due: int = 0) -> tuple[str, str]:
        """Come to rest at a place, by any path, not before step `due`; return status and reason."""
        target = self.guide.target(place)
        loop = self.loop
        record = loop.record
        begun = record.steps
        record.set_target(target)
        most = begun + STEP_BUDGET_EXTRA + int(STEP_BUDGET_RATIO * self._cycles_to(target))
        ended = loop.run(target, self.tolerance, most, lambda *_: self._report())
        loop.brake_to_rest()
        while ended[0] == "converged" and record.steps < due:
            loop.brake()
            if self._report():
                ended = "stopped", STOPPED
        if ended[0] == "converged":
            self._set_place(place)
        self._fill(self._place, target)
        self._max_steps += record.steps - begun
        return ended

    def _cycles_to(self, target: Target) -> float:
        """Estimate the number of cycles of a straight path to a target in joint space."""
        loop = self.loop
        bounds = loop.limits.for_arm(loop.arm)
        q = loop.state.q
        distance = np.abs(loop.arm.difference(q, q if target.q is None else target.q))
        braking = 0.0 if bounds.brake is None else 2.0 * np.sqrt(distance / bounds.brake)
        return float((distance / bounds.bound + braking).max())

    def _report(self) -> bool:
        """Report progress; return whether to stop."""
        if self.progress is None:
            return False
        guide = self.guide
        return self.progress(float(guide.time(self._place)), guide.reference.duration) is True

    def _record(self, place: float, target: Target) -> tuple[str, str] | None:
        """Record the place after a step; return status and reason if the motion ends there."""
        self._places.append(place)
        self._targets.append(target)
        ended = None
        if self._report():
            ended = "stopped", STOPPED
        elif self.loop.record.steps > self._max_steps:
            seconds = float(self.guide.time(place))
            ended = "max_steps", f"still at {seconds:.4g} s of the plan after {self._max_steps} cycles"
        if ended is not None:
            self.loop.brake_to_rest()
            self._fill(place, target)
        return ended

    def _fill(self, place: float, target: Target) -> None:
        """Record the steps towards a target during which the plan did not advance."""
        missing = self.loop.record.steps + 1 - len(self._places)
        self._places += [self._places[-1]] * missing
        self._targets += [target] * missing
        self._places[-1] = place

    def _note(self, place: float, text: str) -> None:
        """Record a deviation from the plan."""
        self._notes.append(f"at {float(self.guide.time(place)):.4g} s of the plan {text}")

    def _look_ahead(self, controller: Geodesic) -> tuple[str, str] | None:
        """Follow the path with a controller that knows it; return None at its end, else status and reason."""
        loop = self.loop
        guide = self.guide
        while self._place < guide.end:
            begun = self._place
            progress = None
            remaining = guide.remaining(begun, controller)
            mark = guide.next_mark(begun)
            loop.memory = controller.start(remaining, loop.ahead.compiled, loop.memory)
            while self._place < guide.end:
                foreseen = guide.next(self._place, 0.0 if progress is None else progress.speed)
                target = guide.target(foreseen)
                step = loop.compute_step(target)
                ahead = step.memory.progress if isinstance(step.memory, GeodesicMemory) else None
                if ahead is None or not ahead.timed.scheduled:
                    break
                if step.reason and not ahead.arrived:
                    break
                if begun + ahead.place >= mark.row:
                    if self._leaves_path(step, begun + ahead.place):
                        break
                    mark = guide.next_mark(begun + ahead.place)
                progress = ahead
                place = self._advance(begun + ahead.place)
                target = target if place == foreseen else guide.target(place)
                loop.take_step(step, target)
                ended = self._record(place, target)
                if ended is not None:
                    return ended
            else:
                return self._catch_up()
            mark = guide.next_mark(self._place)
            left = self._place
            # A shorter path does not advance the plan faster.
            due = loop.record.steps + guide.cycles(self._place, mark.row)
            status, reason = self._go_to(float(mark.row), due)
            if status != "converged":
                self._note(left, f"the arm left the path, and did not reach {mark.name} by another")
                return status, f"on the way to {mark.name}: {reason}"
            self._note(left, f"the arm left the path, and reached {mark.name} by another")
        return None

    def _leaves_path(self, step: Step, place: float) -> bool:
        """Whether the arm is off the path after a step to a place, so that it would miss a mark there."""
        target = self.guide.target(place)
        points = self.loop.ahead.moved(step.dq).compiled.points
        apart = target.mean_distance(points)
        return bool(apart > self._max_lag * (1.0 - MARK_SHARE if self.loop.filter.cycles > 1 else 1.0))

    def _catch_up(self) -> tuple[str, str] | None:
        """Let an arm that a jerk limit delays come to the end of the path; as `_look_ahead`."""
        ended = None
        while ended is None and self.loop.filter.moving:
            place = self._advance(self._place)
            target = self.guide.target(place)
            self.loop.record.set_target(target)
            self.loop.brake()
            ended = self._record(place, target)
        return ended

    def _lead(self) -> tuple[str, str] | None:
        """Move the target of a controller that does not look ahead; the plan waits if it falls behind."""
        loop = self.loop
        guide = self.guide
        speed = 0.0
        patient = True
        target = guide.target(self._place)
        while self._place < guide.end:
            place = self._place
            behind = loop.record.mean_error > self._max_lag
            if behind and patient and loop.record.travel_without_progress(PROGRESS_SHARE) >= STALL_TRAVEL:
                error = loop.record.mean_error
                self._note(place, f"the arm was {length_text(error)} behind on average, and did not catch up")
                patient = False
            if behind and patient:
                speed = 0.0
            else:
                patient = patient or not behind
                place = guide.next(place, speed)
                speed = place - self._place
                target = guide.target(place)
            place = self._advance(place)
            shown = target if place == self._place else guide.target(place)
            if not (behind and patient):
                loop.record.set_target(shown)
            step = loop.compute_step(target)
            if step.reason:
                loop.brake()
            else:
                loop.take_step(step)
            ended = self._record(place, shown)
            if ended is not None:
                return ended
        return None
