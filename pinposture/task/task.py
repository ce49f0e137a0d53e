"""A task: an arm, its motion, and the limits of that motion; usually read from a file."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from copy import copy
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Annotated, Any, Literal, cast

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from pydantic import PlainValidator, ValidationInfo

from pinposture._validation import require_instance, require_known, require_whole
from pinposture.arm import Arm, ArmSpec
from pinposture.arm.manipulability import chosen_points
from pinposture.collision import Scene
from pinposture.collision.model import effective_scene
from pinposture.collision.obstacles import OBSTACLE_TYPES
from pinposture.collision.scene import SceneField, obstacles_around
from pinposture.control import Controller, EndEffector, Geodesic, Limits, controller_named
from pinposture.control.limits import CYCLES, cycle_of
from pinposture.control.torque_limits import require_held
from pinposture.curve import Curve
from pinposture.document import SUFFIXES, Document, plain_data
from pinposture.errors import FileError, InvalidValue, PostureError, TaskError
from pinposture.motion.trajectory import Trajectory
from pinposture.schema import (
    Count,
    KeyPath,
    NotAllowed,
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
from pinposture.storage import RESULT_FORMATS, require_suffix, settled, write_text
from pinposture.task.document import (
    Descriptions,
    document_text,
    folder_of,
    read_arm,
    read_controller,
    read_formats,
    read_scans,
    read_start,
    write_arm,
    write_controller,
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
from pinposture.task.perform import PERFORM, perform
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
    PostureFeasibility,
    Reference,
    posture_feasibility,
    require_held_postures,
    require_passage,
    require_room,
)
from pinposture.toml import TomlLayout, Usual

Array = NDArray[np.float64]

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
        self._set("formats", tuple(name for name in RESULT_FORMATS if name in formats))
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
            names = ", ".join(part.name or str(number) for number, part in enumerate(motion, 1))
            does = f"{len(motion)} phases: {textwrap.shorten(names, 70, placeholder=' ...')}"
        else:
            keyframes = cast("tuple[Keyframe, ...]", motion)
            names = ", ".join(keyframe.name or str(number) for number, keyframe in enumerate(keyframes, 1))
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
            reasons = error.reasons or (error,)
            if _PHASE.match(str(reasons[0])):
                raise document.together([_at_phase(document, reason) for reason in reasons]) from error
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
        require_suffix(file, *SUFFIXES)
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
            return keyframe_reference(
                self.arm, keyframes, dt, self.continuity, progress, self.repeat, self.limits
            )

    def feasibility(self, reference: Reference) -> list[PostureFeasibility]:
        """Predict how well the arm can reach and hold the postures; clearances are those at the postures.

        Args:
            reference: what `reference` returned.

        Raises:
            PostureError: as `surroundings`, or a gap on the way of a leader is too narrow.
        """
        scene = self.surroundings(reference)
        with self._naming():
            require_passage(reference, scene, PERFORM.max_mean_lag * self.arm.length / self.arm.n_modules)
        return posture_feasibility(reference, scene, self.limits)

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
        path = reference.waypoints[0].target.curve if reference.waypoints else None
        if not isinstance(self.motion, Leader) or self.motion.pipe is None or path is None:
            return self.effective_scene
        with self._naming("leader", "pipe"):
            return with_pipe(self.scene, path, self.motion.pipe, reference)

    def perform(
        self,
        reference: Reference | None = None,
        progress: Callable[[float, float], object] | None = None,
        *,
        strict: bool = True,
    ) -> Trajectory:
        """Perform the motion; see `perform`.

        Args:
            reference: the result of `reference`, if it was called before.
            progress: as for `perform`.
            strict: likewise.

        Raises:
            PostureError: as `reference` and `perform`, or the arm would start inside an obstacle.
        """
        reference = self.reference() if reference is None else reference
        start = None if isinstance(self.motion, Leader) or is_phased(self.motion) else self.start
        scene = self.surroundings(reference)
        with self._naming():
            require_room(reference, scene)
            require_instance("strict", strict, bool, "True or False")
            if strict and self.limits.effort is not None:
                if start is not None:
                    require_held(self.arm, start, self.limits, "start")
                require_held_postures(reference, self.limits)
        return perform(
            reference, self.controller, self.limits, scene, q0=start, progress=progress, strict=False
        )

    @contextmanager
    def _naming(self, *where: str) -> Iterator[None]:
        """Name the file, if there is one, and the line in errors."""
        try:
            yield
        except PostureError as error:
            if self._document is None:
                raise
            raise self._file_error(self._document, error, where) from error

    def _file_error(self, document: Document, error: PostureError, where: KeyPath) -> FileError:
        """Return an error with the line of each of its reasons."""
        if not error.reasons:
            return self._located(document, error, where)
        return document.together([self._located(document, reason, where) for reason in error.reasons])

    def _located(self, document: Document, error: PostureError, where: KeyPath) -> FileError:
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
            return _at_phase(document, error)
        if isinstance(error, InvalidValue) and error.name in ("repeat", "start"):
            return document.fault((error.name,), f"is {shown(error.value)}; allowed: {error.allowed}")
        number = re.match(r"keyframe ([0-9]+)", message)  # the message begins with its subject
        line = document.line(("keyframes", int(number[1]) - 1) if number else ("keyframes",))
        return FileError(document.path, message if line is None else f"line {line}: {message}")


def _at_phase(document: Document, error: PostureError) -> FileError:
    """Return the error of a phase, with its line."""
    message = str(error)
    match = _PHASE.match(message)
    line = document.line(("phases", int(match[1]) - 1) if match else ("phases",))
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
    if cycle > CYCLES.longest:
        raise InvalidValue("dt", cycle, f"{CYCLES.longest:g} s at most")
    task.limits.for_arm(task.arm)
    require_known("continuity", task.continuity, CONTINUITIES)
    require_whole("repeat", task.repeat, 1)
    for format_name in task.formats:
        require_known("format", format_name, RESULT_FORMATS)
    require_instance("name", task.name, str, "text")
    described = task.described
    kinds = (Curve, EndEffector, Scene, *OBSTACLE_TYPES.values())
    if not isinstance(described, Mapping) or not all(isinstance(part, kinds) for part in described):
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


def _check_keys(values: Mapping[str, Any], _: object) -> Mapping[str, Any]:
    """Refuse another version, unknown keys, and keys of another kind of motion."""
    version = values.get("version", VERSION)
    if version is True or version != VERSION:
        raise Refusal(f"is {shown(version)}; allowed: {VERSION}", "version")
    kind = read_within("kind", read_word, values.get("kind", "keyframes"), _KEYS_OF_KIND)
    kind_keys = _KEYS_OF_KIND[kind]
    others = {key: other for other, keys in _KEYS_OF_KIND.items() for key in keys if key not in kind_keys}
    for key, other in others.items():
        if key in values:
            raise Refusal(f"goes with kind = {other!r}; the kind is {kind!r}", key)
    keys = (
        *("version", "kind", "name", "continuity", "repeat", "arm", "scene", "keyframes", "leader", "phases"),
        *("limits", "controller", "start", "output", "editor"),
    )
    return read_keys(values, [key for key in keys if key not in others])


def _read_list(kind: type[Keyframe | Phase], key: str, least: int) -> PlainValidator:
    """Read a list of `least` or more tables."""

    def read(value: Any, info: ValidationInfo) -> Any:
        listed = value or []
        if not is_list_of(is_table)(listed):
            raise NotAllowed(value, f"a list of tables, each begun by [[{key}]]")
        if len(listed) < least:
            number = "only one" if listed else "none"
            words = {1: "one", 2: "two"}[least]
            raise Refusal(f"there is {number}; allowed: {words} or more, each begun by [[{key}]]")
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
    parts = document.read_all({key: kind for key, kind in _READ_AS.items() if key in values or key in needed})
    scene = parts["scene"]
    _check_surroundings(document, parts.get(motion), scene)
    names = dict.fromkeys(("keyframes", "leader", "phases"), "motion") | {
        "output": "formats",
        "editor": "scans",
    }
    arguments = {names.get(key, key): value for key, value in parts.items()}
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
        leaders: dict[KeyPath, Any] = {("leader",): motion}
    else:
        leaders = {
            ("phases", index, "leader"): getattr(phase, "motion", None) for index, phase in enumerate(motion)
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
        contents["scene"] = task.scene.to_table(file)
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
    tolerance = 1e-12  # angles in a file do not preserve rotations to the last bit
    return one.shape == other.shape and bool(np.allclose(one, other, rtol=tolerance, atol=tolerance))


def _same_spec(one: ArmSpec, other: ArmSpec) -> bool:
    """Whether two specifications are the same; files may be named through links."""

    def resolved(spec: ArmSpec) -> ArmSpec:
        folders = tuple(folder.resolve() for folder in spec.package_dirs)
        file = None if spec.urdf is None else Path(spec.urdf).resolve()
        return replace(spec, urdf=file, package_dirs=folders)

    return resolved(one) == resolved(other)
