"""Reads a task file: plain data with line numbers, then the parts of a task, with checks."""

from __future__ import annotations

import re
from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar, cast

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from pydantic import BeforeValidator, TypeAdapter, ValidationError

from pinposture._validation import known_keys, require_instance, require_known, require_whole
from pinposture.arm import Arm, ArmSpec
from pinposture.arm.manipulability import chosen_points
from pinposture.collision import Scene
from pinposture.collision.obstacles import OBSTACLE_TYPES, Obstacle, obstacle_from_dict
from pinposture.collision.scene import obstacles_around
from pinposture.control import Controller, EndEffector, Geodesic, Limits, controller_named
from pinposture.control.limits import cycle_of
from pinposture.curve import CURVES, Curve
from pinposture.errors import (
    FileError,
    InvalidValue,
    PostureError,
    TaskError,
    UnknownName,
    numbered,
)
from pinposture.placement.target import length_misfit
from pinposture.storage import parse_json, parse_toml, read_text, require_suffix, settled
from pinposture.task.follow_leader import MAX_SIZE_RATIO, Leader, check_leader
from pinposture.task.keyframe import (
    CONTINUITIES,
    Keyframe,
    as_keyframes,
    check_keyframes,
    joints_misfit,
    naming,
    title,
    usual_placement,
)
from pinposture.task.phases import (
    Phase,
    PhaseMotion,
    TipGoal,
    Withdrawal,
    check_phases,
    is_phased,
    keyed,
)
from pinposture.task.specification import (
    LONGEST_CYCLE,
    RESULT_FORMATS,
    ArmTable,
    ControllerSpec,
    KeyframeSpec,
    LeaderSpec,
    LimitsSpec,
    PhaseSpec,
    SceneSpec,
    StartSpec,
    TaskSpec,
    TipGoalSpec,
    TipSpec,
    place_in_words,
    shown,
    shown_key,
)
from pinposture.task.toml import Place, lines_of_toml
from pinposture.units import length_text

# Text parsed into plain data.

TASK_SUFFIXES = (".toml", ".json")

MAX_NESTING = 20
"""Largest depth of nested tables and lists; three times that of a task."""

MAX_INTEGER_BITS = 64
"""Largest size of a whole number, as in TOML."""

_TOML_ERROR = re.compile(r"(.*) \(at (?:(line \d+, column \d+)|end of document)\)", re.DOTALL)


def _parsed(path: Path, text: str) -> dict[str, Any]:
    try:
        is_toml = path.suffix.lower() == ".toml"
        values = parse_toml(text) if is_toml else parse_json(path, text, object_pairs_hook=_unique_keys)
    except RecursionError:
        raise FileError(
            path, f"tables and lists are nested too deep; allowed: {MAX_NESTING} levels"
        ) from None
    except ValueError as error:
        message = " ".join(str(error).split())
        found = _TOML_ERROR.fullmatch(message)
        # The line comes first, as in all other messages.
        raise FileError(path, f"{found[2] or 'end of the file'}: {found[1]}" if found else message) from error
    if not isinstance(values, dict):
        raise FileError(path, "contains no table; allowed: keys and values, as in version = 1")
    _check_size(path, (), values)
    return values


def _unique_keys(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """Return a JSON table; refuse duplicate keys, of which JSON would use the last."""
    table = dict(pairs)
    if len(table) < len(pairs):
        keys = [key for key, _ in pairs]
        twice = next(key for key in keys if keys.count(key) > 1)
        raise ValueError(f"the key {shown_key(twice)!r} appears twice in a table")
    return table


def _check_size(path: Path, place: Place, value: Any) -> None:
    """Refuse deep nesting and huge integers, which would be too expensive later."""
    if len(place) > MAX_NESTING:
        reason = f"is nested too deep; allowed: {MAX_NESTING} levels of tables and lists"
        raise FileError(path, f"{place_in_words(place)}: {reason}")
    if isinstance(value, int) and value.bit_length() > MAX_INTEGER_BITS:
        reason = f"is a whole number of more than {MAX_INTEGER_BITS} bits"
        raise FileError(path, f"{place_in_words(place)}: {reason}")
    if isinstance(value, Mapping | list):
        items = value.items() if isinstance(value, Mapping) else enumerate(value)
        for key, each in items:
            _check_size(path, (*place, key), each)


# A file, and the places of mistakes in it.

Spec = TypeVar("Spec")
Made = TypeVar("Made")
Key = TypeVar("Key", bound=Hashable)


def _mistakes(found: Mapping[str, Any]) -> list[tuple[Place, str]]:
    """Return place and reason of each mistake that a validator found."""
    inside = found["loc"]
    cause = found.get("ctx", {}).get("error")
    if found["type"] == "missing":
        return [(inside[:-1], f"the key {inside[-1]!r} is missing")]
    if cause is None:
        return [(inside, f"is {shown(found['input'])}; allowed: {found['msg']}")]
    causes = getattr(cause, "all", (cause,))
    return [((*inside, *getattr(each, "within", ())), str(each)) for each in causes]


class Document:
    """A file; mistakes in it are reported as a FileError with the line, key and value.

    Attributes:
        path: the file.
        values: its contents.
        toml: the text if the file is TOML; None if it is JSON.
        described: the description of each part of the task: plain data in SI units, with an absolute `Path`
            for each path.
    """

    def __init__(self, path: Path, values: dict[str, Any], toml: str | None = None) -> None:
        self.path = path
        self.values = values
        self.toml = toml
        self.described: dict[Hashable, object] = {}

    @classmethod
    def load(cls, path: Path) -> Document:
        """Read a file.

        Raises:
            FileError: it is missing, unreadable, of another format, or as for `parse`.
        """
        require_suffix(path, *TASK_SUFFIXES)
        return cls.parse(path, read_text(path))

    @classmethod
    def parse(cls, path: Path, text: str) -> Document:
        """Return the document of a file with this text.

        Raises:
            FileError: the text is malformed, or contains no table; names the line.
        """
        return cls(path, _parsed(path, text), text if path.suffix.lower() == ".toml" else None)

    def at(self, where: Place) -> Any:
        """Return the value at a place; None if there is none."""
        value: Any = self.values
        for key in where:
            there = key in value if isinstance(value, Mapping) else isinstance(key, int) and key < len(value)
            if not there:
                return None
            value = value[key]
        return value

    def read(self, kind: type[Spec] | Any, where: Place, context: Mapping[str, Any] | None = None) -> Spec:
        """Return the value at a place, checked and in SI units; a missing table counts as empty.

        Args:
            kind: its specification.
            where: the place.
            context: the context of the validators.
        """
        value = self.at(where)
        try:
            spec: Spec = TypeAdapter(kind).validate_python({} if value is None else value, context=context)
        except ValidationError as error:
            mistakes = [each for found in error.errors(include_url=False) for each in _mistakes(found)]
            raise self.together(
                [self.fault((*where, *inside), reason) for inside, reason in mistakes]
            ) from None
        return spec

    def make_all(self, parts: Mapping[Key, Callable[[], Any]]) -> dict[Key, Any]:
        """Make independent parts; raise one error with the mistakes in all of them."""
        made: dict[Key, Any] = {}
        errors: list[PostureError] = []
        for key, make in parts.items():
            try:
                made[key] = make()
            except PostureError as error:
                errors.append(error)
        if errors:
            raise self.together(errors)
        return made

    def together(self, errors: Sequence[PostureError]) -> FileError:
        """Return one error with all reasons of several."""
        listed = [each for error in errors for each in (error.reasons or (error,))]
        error = FileError(self.path, numbered([getattr(each, "reason", str(each)) for each in listed]))
        error.reasons = tuple(listed) if len(listed) > 1 else ()
        return error

    @contextmanager
    def blaming(self, where: Place, key: str | None = None) -> Iterator[None]:
        """Report an error of the library at the key of the table that it names, or at this key."""
        table = self.at(where)
        named = where if key is None else (*where, key)
        try:
            yield
        except PostureError as error:
            if isinstance(error, InvalidValue) and isinstance(table, Mapping) and error.name in table:
                reason = f"is {shown(table[error.name])}; allowed: {error.allowed}"
                raise self.fault((*where, error.name), reason) from error
            raise self.fault(named, str(error)) from error

    def named(self, where: Place, name: str) -> Path:
        """Return a path named in the file, relative to its folder."""
        try:
            return self.path.parent / Path(name).expanduser()
        except RuntimeError as error:  # the home of an unknown user
            raise self.fault(where, f"is {shown(name)}, which cannot be found ({error})") from None

    def file(self, where: Place, read: Callable[[Path], Made]) -> Made:
        """Read the file named at a place."""
        path = self.named(where, self.at(where))
        with self.blaming(where):
            return read(path)

    def line(self, where: Place) -> int | None:
        """Return the line of a place, or of its parent; None if unknown, as in JSON."""
        for end in range(len(where), 0, -1):
            if where[:end] in self._lines:
                return self._lines[where[:end]]
        return None

    def fault(self, where: Place, reason: str) -> FileError:
        """Return an error about a place."""
        line = self.line(where)
        text = " ".join(reason.split())
        before = "" if line is None else f"line {line}: "
        return FileError(self.path, f"{before}{place_in_words(where)}: {text}")

    @cached_property
    def _lines(self) -> dict[Place, int]:
        return {} if self.toml is None else lines_of_toml(self.toml.replace("\r\n", "\n"))


Array = NDArray[np.float64]

# The arm.


def read_arm(document: Document) -> ArmSpec:
    """Read the specification of the arm: a URDF file, or modules of a template, possibly on a feed."""
    table: ArmTable = document.read(ArmTable, ("arm",))
    values = table.given()
    if table.urdf is not None:
        values["urdf"] = settled(document.named(("arm", "urdf"), table.urdf))
        folders = (document.named(("arm", "package_dirs"), each) for each in table.package_dirs)
        values["package_dirs"] = tuple(map(settled, folders))
    with document.blaming(("arm",)):
        return ArmSpec(**values)


def make_arm(document: Document, spec: ArmSpec) -> Arm:
    """Make the arm of a task file from the result of `read_arm`."""
    try:
        return Arm.from_spec(spec)
    except PostureError as error:
        table = document.at(("arm",))
        key = _key_of(error, table)
        reason = str(error)
        if isinstance(error, InvalidValue) and key in table:
            value = error.value if key == "split" else table[key]
            reason = f"is {shown(value)}; allowed: {error.allowed}"
        raise document.fault(("arm", key) if key else ("arm",), reason) from error


def _key_of(error: PostureError, table: Mapping[str, Any]) -> str:
    """Return the key to which an error of `Arm.from_spec` refers; empty for the whole table."""
    if isinstance(error, InvalidValue):
        key = "split" if error.name.startswith("modules") and "urdf" in table else error.name
        if key in table:
            return key
    if isinstance(error, UnknownName):
        for key in ("base", "tip", "split", "locked", "couplings", "xacro_args"):
            value = table.get(key)
            if error.name == value or (isinstance(value, list | dict) and error.name in value):
                return key
    return "urdf" if "urdf" in table else ""


# The motion.


def _make_keyframe(
    document: Document, where: Place, spec: KeyframeSpec, scene: Scene | None, arm: Arm
) -> Keyframe:
    """Make a keyframe."""
    values = {key: getattr(spec, key) for key in KeyframeSpec.model_fields}
    if spec.curve is not None:
        curve = make_curve(document, (*where, "curve"), spec.curve)
        values["curve"] = curve
        values["placement"] = spec.placement or usual_placement(scene, curve)
    if spec.tip is not None:
        values["tip"] = make_tip(document, (*where, "tip"), spec.tip)
    if spec.region is not None:
        values["region"] = (spec.region[0] - 1, spec.region[1] - 1)
        if spec.region[1] > arm.n_modules:
            reason = f"is {list(spec.region)}; the arm has control points 1 to {arm.n_modules}"
            raise document.fault((*where, "region"), reason)
    with document.blaming(where):
        keyframe = Keyframe(**values)
    if keyframe.curve is None:
        key = "joints"
        misfit = joints_misfit(arm, keyframe)
    else:
        key = "curve"
        misfit = length_misfit(arm, keyframe.curve)
    if misfit:
        raise document.fault((*where, key), misfit)
    if keyframe.tip is not None:
        _check_point(document, (*where, "tip"), keyframe.tip.point, arm)
    return keyframe


def _check_point(document: Document, where: Place, point: int | str, arm: Arm) -> None:
    """Refuse a control point of a tip that the arm does not have."""
    m = arm.n_modules
    if isinstance(point, str):
        with document.blaming(where, "point"):
            chosen_points(arm.control_points, point)
    elif not -m <= point < m:
        allowed = f"1 to {m} from the base, -1 to -{m} from the tip, or a name"
        raise document.fault((*where, "point"), f"is {document.at((*where, 'point'))}; allowed: {allowed}")


def make_tip(document: Document, where: Place, spec: TipSpec) -> EndEffector:
    """Make the task of the tip, or of another control point."""
    pose = pin.SE3(pin.rpy.rpyToMatrix(*(spec.rotation or (0.0, 0.0, 0.0))), np.array(spec.position))
    point = spec.point - 1 if isinstance(spec.point, int) and spec.point > 0 else spec.point
    values: dict[str, Any] = {"pose": pose} if spec.rotation is not None else {"position": pose.translation}
    for key in ("weight", "priority", "direction_only", "length"):
        values[key] = getattr(spec, key)
    with document.blaming(where):
        tip = EndEffector(**values, point=point)
    document.described[tip] = spec.given()
    return tip


def make_curve(document: Document, where: Place, spec: str | dict[str, Any]) -> Curve:
    """Make a curve from a preset, a file, or a description as for `Curve.from_dict`."""
    description: object = spec
    if isinstance(spec, str) and spec in CURVES:
        curve = CURVES[spec]
    elif isinstance(spec, str):
        curve = document.file(where, Curve.load)
        description = settled(document.named(where, spec))
    elif "path" in spec:
        with document.blaming(where):
            known_keys("a curve file", spec, ("path", "scale"))
            path = document.named((*where, "path"), spec["path"])
            curve = Curve.load(path, spec.get("scale", 1.0))
            description = {**spec, "path": settled(path)}
    else:
        with document.blaming(where):
            curve = Curve.from_dict(spec)
    document.described[curve] = description
    return curve


def _make_leader(document: Document, where: Place, spec: LeaderSpec, scene: Scene | None, arm: Arm) -> Leader:
    """Make the leader; the scene decides on the default of its placement."""
    values = {key: getattr(spec, key) for key in LeaderSpec.model_fields}
    values["path"] = path = make_curve(document, (*where, "path"), spec.path)
    leader = Leader(**{**values, "placement": spec.placement or usual_placement(scene, path)})
    longest = MAX_SIZE_RATIO * arm.length
    if path.length > longest:
        allowed = f"{length_text(longest)}, {MAX_SIZE_RATIO} times the arm"
        reason = f"is {length_text(path.length)} long; allowed: {allowed}"
        raise document.fault((*where, "path"), reason)
    with document.blaming(where):
        check_leader(leader, arm, scene)
    return leader


# Limits, the controller, the scene, and the start.


def _make_limits(document: Document, spec: LimitsSpec, arm: Arm) -> Limits:
    values = spec.model_dump(exclude={"cycle"})
    with document.blaming(("limits",)):
        limits = Limits(**values, dt=spec.cycle)
        limits.for_arm(arm)
    return limits


def _make_controller(document: Document, spec: ControllerSpec) -> Controller:
    controller = controller_named(spec.name)
    for key in ("joint_weight", "relative_position_weight"):
        number = getattr(spec, key)
        if number is None:
            continue
        if not isinstance(controller, Geodesic):
            reason = f"is for the controller 'geodesic'; it is {spec.name!r}"
            raise document.fault(("controller", key), reason)
        with document.blaming(("controller",), key):
            controller = replace(controller, **{key: number})
    return controller


def make_scene(document: Document, where: Place, spec: SceneSpec) -> Scene | None:
    """Make the scene of a separate file, or from the content of one; None for an empty table."""
    if spec.file is not None:
        scene = document.file((*where, "file"), Scene.load)
        document.described[scene] = {"file": settled(document.named((*where, "file"), spec.file))}
        return scene
    values = spec.given()
    if not values:
        return None
    obstacles = {
        name: make_obstacle(document, (*where, "obstacles", name), each)
        for name, each in spec.obstacles.items()
    }
    with document.blaming(where):
        return replace(Scene.from_dict(values | {"obstacles": {}}), obstacles=obstacles)


def make_obstacle(document: Document, where: Place, spec: dict[str, Any]) -> Obstacle:
    """Make an obstacle; the path of a mesh or scan is relative to the file."""
    folder = document.path.parent
    with document.blaming(where):
        obstacle = obstacle_from_dict(spec, str(folder))
    path = {"path": settled(folder / spec["path"])} if "path" in spec else {}
    document.described[obstacle] = spec | path
    return obstacle


def _make_start(document: Document, spec: StartSpec, arm: Arm) -> Array | None:
    if spec.joints is not None:
        with document.blaming(("start",), "joints"):
            return arm.configuration(spec.joints)
    if spec.posture is None:
        return None
    return arm.straight() if spec.posture == "straight" else arm.neutral()


# The parts of a task, and checks without a search.


@dataclass(frozen=True, eq=False)
class TaskParts:
    """The content of a task file; for the attributes see `pinposture.task.Task`."""

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


def check_task(task: TaskParts) -> None:
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


def read_task(document: Document, arm: Arm | None = None) -> TaskParts:
    """Read the parts of a task.

    Args:
        document: the file.
        arm: the arm, if it exists already; otherwise it is made from the file.

    Raises:
        FileError: the file is not a valid task; names the line, the key, the value and what is allowed.
    """
    # The keys are checked before the arm is made, the values after it, because they depend on the arm.
    document.read(Annotated[dict[str, Any], BeforeValidator(TaskSpec.check)], ())
    arm = make_arm(document, read_arm(document)) if arm is None else arm
    spec: TaskSpec = document.read(TaskSpec, (), {"arm": arm})
    scene = make_scene(document, ("scene",), spec.scene)
    parts: dict[str, Callable[[], Any]] = {
        "motion": lambda: _make_motion(document, spec, scene, arm),
        "limits": lambda: _make_limits(document, spec.limits, arm),
        "controller": lambda: _make_controller(document, spec.controller),
        "start": lambda: _make_start(document, spec.start, arm),
        "base": lambda: _check_base(document, scene, arm),
    }
    made = document.make_all(parts)
    return TaskParts(
        arm=arm,
        motion=made["motion"],
        limits=made["limits"],
        controller=made["controller"],
        scene=scene,
        start=made["start"],
        continuity=cast(Literal["velocity", "acceleration"], spec.continuity),
        formats=tuple(each for each in RESULT_FORMATS if each in spec.output.formats),
        name=document.path.stem if spec.name is None else spec.name,
        scans=tuple(settled(document.named(("editor", "scans"), name)) for name in spec.editor.scans),
        described=document.described,
        repeat=spec.repeat,
    )


def _make_motion(
    document: Document, spec: TaskSpec, scene: Scene | None, arm: Arm
) -> tuple[Keyframe, ...] | tuple[Phase, ...] | Leader:
    if spec.kind == "follow_leader":
        leads = document.read(LeaderSpec, ("leader",)) if spec.leader is None else spec.leader
        return _make_leader(document, ("leader",), leads, scene, arm)
    if spec.kind == "phases":
        return _make_phases(document, spec.phases, scene, arm)
    if len(spec.keyframes) < 2:
        found = "none" if not spec.keyframes else "only one"
        reason = f"there is {found}; allowed: two or more, each begun by [[keyframes]]"
        raise document.fault(("keyframes",), reason)
    return _make_keyframes(document, (), spec.keyframes, scene, arm)


def _make_keyframes(
    document: Document, where: Place, specs: tuple[KeyframeSpec, ...], scene: Scene | None, arm: Arm
) -> tuple[Keyframe, ...]:
    makers = {
        number: partial(_make_keyframe, document, (*where, "keyframes", number), each, scene, arm)
        for number, each in enumerate(specs)
    }
    return tuple(document.make_all(makers).values())


def _make_phases(
    document: Document, specs: tuple[PhaseSpec, ...], scene: Scene | None, arm: Arm
) -> tuple[Phase, ...]:
    if not specs:
        raise document.fault(("phases",), "there is none; allowed: one or more, each begun by [[phases]]")
    makers = {
        number: partial(_make_phase, document, ("phases", number), each, scene, arm)
        for number, each in enumerate(specs)
    }
    return tuple(document.make_all(makers).values())


def _make_phase(document: Document, where: Place, spec: PhaseSpec, scene: Scene | None, arm: Arm) -> Phase:
    motion: PhaseMotion
    if spec.leader is not None:
        motion = _make_leader(document, (*where, "leader"), spec.leader, scene, arm)
    elif spec.reach is not None:
        with document.blaming((*where, "reach")):
            motion = TipGoal(**{key: getattr(spec.reach, key) for key in TipGoalSpec.model_fields})
    elif spec.withdraw is not None:
        motion = Withdrawal(spec.withdraw.speed)
    else:
        motion = _make_keyframes(document, where, spec.keyframes, scene, arm)
    with document.blaming(where):
        return Phase(motion, spec.name)


def _check_base(document: Document, scene: Scene | None, arm: Arm) -> None:
    """Refuse obstacles where the base of the arm is."""
    around = _around_base(scene, arm)
    if around:
        raise document.together(
            [document.fault(("scene", "obstacles", name), reason) for name, reason in around]
        )
