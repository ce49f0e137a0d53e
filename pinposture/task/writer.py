"""Writes task files, and checks that they read back as the same task."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Hashable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pinposture.arm import Arm, ArmSpec
from pinposture.arm.loading import description_text
from pinposture.arm.specification import roll_pitch_yaw
from pinposture.arm.urdf_reader import load_text
from pinposture.collision import Mesh, Scan, Scene
from pinposture.collision.obstacles import Obstacle
from pinposture.control import CONTROLLERS, Controller, EndEffector, Geodesic, Limits
from pinposture.curve import Curve
from pinposture.errors import FileError, PostureError, warn_caller
from pinposture.storage import check_writable, relative, require_suffix, settled, write_text
from pinposture.task.follow_leader import Leader
from pinposture.task.keyframe import Keyframe, usual_placement
from pinposture.task.phases import Phase, TipGoal, Withdrawal, is_phased, keyed
from pinposture.task.reader import (
    TASK_SUFFIXES,
    Document,
    TaskParts,
    make_curve,
    make_obstacle,
    make_scene,
    make_tip,
    read_arm,
    read_task,
)
from pinposture.task.specification import (
    MOST_MODULES,
    RESULT_FORMATS,
    UNLIMITED_WORD,
    VERSION,
    CurveSpec,
    KeyframeSpec,
    LeaderSpec,
    ObstacleSpec,
    SceneSpec,
    TipGoalSpec,
    TipSpec,
    WithdrawalSpec,
    shown,
)
from pinposture.task.toml import TomlLayout, Usual, drop_defaults, toml_text

Array = NDArray[np.float64]

# Descriptions of parts of a task, as far as they are still valid.


class Descriptions:
    """Descriptions of the parts of a task in the file to be written.

    Attributes:
        file: the file.
        folder: its folder, to which paths are relative.
        just_read: whether the descriptions come from this file, and need no test.
    """

    def __init__(self, file: Path, described: Mapping[Hashable, object], just_read: bool = False) -> None:
        self.file = file
        self.folder = file.parent
        self.just_read = just_read
        self._described = described

    def find(self, part: Hashable, key: str, spec: Any, make: Callable[..., object]) -> Any:
        """Return the known description of a part if it still describes that part; otherwise None.

        Args:
            part: the part.
            key: the key of the description.
            spec: the specification of that key.
            make: the function that makes the part from its description.
        """
        if part not in self._described:
            return None
        plain = plain_data(self._described[part], self.folder)

        def gives_part() -> bool:
            document = Document(self.file, {key: plain})
            return bool(make(document, (key,), document.read(spec, (key,))) == part)

        return plain if self.still_holds(key, plain, gives_part) else None

    def still_holds(self, key: str, plain: object, test: Callable[[], bool]) -> bool:
        """Test a description; warn if it is no longer valid."""
        if self.just_read:
            return True
        reason = "which has changed since"
        try:
            if test():
                return True
        except PostureError as error:
            reason = f"but {getattr(error, 'reason', error)}"
        warn_caller(f"{self.file}: {key} was {shown(plain)}, {reason}; it is written out")
        return False


def plain_data(value: Any, folder: Path) -> Any:
    """Return plain data: relative paths, Python numbers, and integers without a decimal point."""
    if isinstance(value, Usual | bool | int | str):
        return value
    if isinstance(value, Path):
        return relative(value, folder)
    if isinstance(value, Mapping):
        return {key: plain_data(each, folder) for key, each in value.items()}
    if isinstance(value, list | tuple | np.ndarray):
        return [plain_data(each, folder) for each in value]
    number = float(value)
    whole = number.is_integer() and abs(number) < 1e15 and (number != 0.0 or math.copysign(1.0, number) > 0.0)
    return int(number) if whole else number


# The arm: its specification, with a URDF file next to the task if necessary.


def write_arm(arm: Arm, descriptions: Descriptions) -> tuple[ArmSpec, Path | None]:
    """Describe an arm by its specification.

    Returns:
        The specification, and the URDF file to write next to the task, if any.

    Raises:
        FileError: the arm was made from a Pinocchio model, or its URDF file would overwrite another.
    """
    spec = arm.spec
    if spec is None or arm.urdf is None or arm.report is None:
        reason = "it was made from a Pinocchio model and has no URDF; load it with Arm.load"
        raise FileError(descriptions.file, f"arm: no file can describe it: {reason}")
    if spec.template is not None and spec.modules is not None and spec.modules > MOST_MODULES:
        spec = ArmSpec(
            urdf=arm.urdf,
            split=arm.report.segmentation.sizes,
            placement=spec.placement,
            characteristic_length=spec.characteristic_length,
        )
    source = spec.urdf
    folders = spec.package_dirs
    arguments = spec.xacro_args
    if source is None:
        return spec, None
    if isinstance(source, Path):
        name = relative(source, descriptions.folder)

        def gives_arm() -> bool:
            return description_text(source, folders, arguments) == arm.urdf

        if descriptions.still_holds("arm", name, gives_arm):
            return spec, None
    file = settled(descriptions.file.with_suffix(".urdf"))
    searched = [Path(each) for each in arm.report.package_dirs if settled(each) != file.parent]
    spec = spec.model_copy(update={"urdf": file, "package_dirs": tuple(searched), "xacro_args": {}})
    if not file.exists():
        return spec, file
    if load_text(file)[0] != arm.urdf:
        reason = "exists already, and differs from the arm of the task"
        raise FileError(file, f"{reason}; save the task under another name")
    return spec, None


# Keyframes, and the path of the leader.


def write_keyframe(keyframe: Keyframe, scene: Scene | None, descriptions: Descriptions) -> dict[str, Any]:
    """Return the table of a keyframe without defaults; that of its placement depends on the scene."""
    curve = keyframe.curve
    tip = keyframe.tip
    values = {key: getattr(keyframe, key) for key in KeyframeSpec.model_fields}
    if curve is not None:
        values["curve"] = descriptions.find(curve, "curve", CurveSpec, make_curve) or write_curve(curve)
        default = usual_placement(scene, curve)
        values["placement"] = Usual(default) if keyframe.placement == default else keyframe.placement
    if keyframe.region is not None:
        values["region"] = [end + 1 for end in keyframe.region]
    if tip is not None:
        values["tip"] = descriptions.find(tip, "tip", TipSpec, make_tip) or write_tip(tip)
    return KeyframeSpec.without_defaults(values)


def write_leader(leader: Leader, scene: Scene | None, descriptions: Descriptions) -> dict[str, Any]:
    """Return the table of the leader without defaults; that of its placement depends on the scene."""
    values = leader._asdict()
    path = leader.path
    default = usual_placement(scene, path)
    values["path"] = descriptions.find(path, "path", CurveSpec, make_curve) or write_curve(path)
    values["placement"] = Usual(default) if leader.placement == default else leader.placement
    return LeaderSpec.without_defaults(values)


def write_phase(phase: Phase, scene: Scene | None, descriptions: Descriptions) -> dict[str, Any]:
    """Return the table of a phase without defaults; those of placements depend on the scene."""
    table: dict[str, Any] = {"name": phase.name} if phase.name else {}
    motion = phase.motion
    if isinstance(motion, Leader):
        table["leader"] = write_leader(motion, scene, descriptions)
    elif isinstance(motion, TipGoal):
        table["reach"] = TipGoalSpec.without_defaults(vars(motion))
    elif isinstance(motion, Withdrawal):
        table["withdraw"] = WithdrawalSpec.without_defaults(vars(motion))
    else:
        table["keyframes"] = [write_keyframe(each, scene, descriptions) for each in motion]
    return table


def write_curve(curve: Curve) -> dict[str, Any]:
    """Describe a curve by its control points, or by its knots and coefficients."""
    if curve.control_points is not None:
        points = curve.control_points.tolist()
        table: dict[str, Any] = {"type": "spline", "control_points": points, "degree": curve.degree}
        if curve.degree == 1 and len(points) == 2:
            table = {"type": "line", "a": points[0], "b": points[1]}
        with suppress(PostureError):  # points may be too close
            if Curve.from_dict(table) == curve:  # knots may be rounded
                if curve.degree == 3:
                    del table["degree"]
                return table
    return curve.to_dict()


def write_tip(tip: EndEffector) -> dict[str, Any]:
    """Describe the task of the tip, or of another control point."""
    values = {key: getattr(tip, key) for key in ("weight", "priority", "direction_only", "length")}
    if tip.pose is None:
        values["position"] = np.asarray(tip.position).tolist()
    else:
        pose = pin.SE3(tip.pose)
        values |= {"position": pose.translation.tolist(), "rotation": roll_pitch_yaw(pose.rotation)}
    counted = isinstance(tip.point, int) and tip.point >= 0
    values["point"] = tip.point + 1 if counted else tip.point  # type: ignore[operator]
    return TipSpec.without_defaults(values)


# Limits, the controller, the scene, and the start.


def write_limits(limits: Limits, arm: Arm) -> dict[str, Any]:
    """Return the table of the limits of each control cycle."""
    table: dict[str, Any] = {"cycle": limits.dt}
    for key in ("step", "velocity", "acceleration", "jerk"):
        value = getattr(limits, key)
        if value is not None:
            table[key] = _limit(key, value, arm)
    if limits.position_margin:
        table["position_margin"] = limits.position_margin
    return table


def _limit(key: str, value: float | Array, arm: Arm) -> Any:
    """Return one number for all joints, one for those that turn and those that slide, or one for each."""
    if not isinstance(value, np.ndarray):
        return value if np.isfinite(value) else UNLIMITED_WORD
    both = {}
    rest = arm.limits.velocity if key == "velocity" else np.full(arm.nv, np.inf)
    for kind, joints in (("turning", ~arm.slides), ("sliding", arm.slides)):
        own = np.unique(value[joints])
        if len(own) == 1 and np.isfinite(own[0]):
            both[kind] = float(own[0])
            rest = np.where(joints, own[0], rest)
    if both and np.array_equal(rest, value):
        return both
    return [each if np.isfinite(each) else UNLIMITED_WORD for each in value.tolist()]


def write_controller(controller: Controller, descriptions: Descriptions) -> dict[str, Any]:
    """Return the table of the controller; an empty one for the default.

    Raises:
        FileError: it has parameters that a file cannot represent.
    """
    if isinstance(controller, Geodesic):
        own = {key: getattr(controller, key) for key in ("joint_weight", "relative_position_weight")}
        if replace(Geodesic(), **own) == controller:
            own = {key: value for key, value in own.items() if value != getattr(Geodesic(), key)}
            return {"name": "geodesic", **own} if own else {}
    for name, make in CONTROLLERS.items():
        if make() == controller:
            return {"name": name}
    allowed = "a name with its usual parameters; joint_weight and relative_position_weight for 'geodesic'"
    raise FileError(
        descriptions.file, f"controller: a file cannot represent {shown(controller)}; allowed: {allowed}"
    )


def write_scene(scene: Scene, descriptions: Descriptions) -> dict[str, Any]:
    """Return the table of the content of a scene."""
    table: dict[str, Any] = {"margin": scene.margin}
    if not scene.self_collision:
        table["self_collision"] = False
    if scene.arm_radius is not None:
        table["arm_radius"] = scene.arm_radius
    if scene.obstacles:
        table["obstacles"] = {
            name: descriptions.find(each, "obstacle", ObstacleSpec, make_obstacle) or write_obstacle(each)
            for name, each in scene.obstacles.items()
        }
    return table


def write_obstacle(obstacle: Obstacle) -> dict[str, Any]:
    """Describe an obstacle, without a rotation, centre or scale that has no effect."""
    table = obstacle.to_dict(embed=False)
    if table.get("rotation") == np.eye(3).tolist():
        del table["rotation"]
    if isinstance(obstacle, Mesh | Scan) and not any(obstacle.center):
        del table["center"]
    if "path" in table:
        table["path"] = Path(table["path"])
        table = {key: value for key, value in table.items() if (key, value) != ("scale", 1.0)}
    return table


def write_start(start: Array, arm: Arm) -> dict[str, Any]:
    """Return the table of the configuration to start from."""
    if np.array_equal(start, arm.straight()):
        return {"posture": "straight"}
    if np.array_equal(start, arm.neutral()):
        return {"posture": "neutral"}
    return {"joints": arm.positions(start)}


# Check that a file reads back as the task that was written.

ROTATION_TOLERANCE = 1e-12
"""Largest difference of rotations, which angles in a file do not preserve to the last bit."""


def _differences(task: TaskParts, parts: TaskParts) -> list[str]:
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
        return spec.model_copy(update={"urdf": file, "package_dirs": folders})

    return resolved(one) == resolved(other)


def _read_back(task: TaskParts, arm: ArmSpec, path: Path, text: str) -> None:
    """Raise FileError if the text reads back as a different task."""
    try:
        text.encode()
    except UnicodeEncodeError as error:
        half = f"{text[error.start]!r} in a text of the task, half of a surrogate pair"
        raise FileError(path, f"{half}, cannot be written") from None
    document = Document.parse(path, text)
    wrong = _differences(task, read_task(document, task.arm))
    if not _same_spec(arm, read_arm(document)):
        wrong.append("arm")
    if wrong:
        raise FileError(path, f"cannot represent the task: {', '.join(wrong)} would change when read")


# A whole task file.


def write_task(task: TaskParts, path: Path, layout: TomlLayout | None = None) -> Path:
    """Write a task file, and a URDF file next to it if necessary; see `Task.save`.

    Args:
        task: the task.
        path: the file.
        layout: the TOML file whose comments and layout are preserved.
    """
    require_suffix(path, *TASK_SUFFIXES)
    with _folder_of(path):  # relative paths in the file start from it
        descriptions = Descriptions(path, task.described)
        arm, urdf = write_arm(task.arm, descriptions)
        text = _text(task, arm, path, _contents(task, arm, descriptions), layout)
        if urdf is not None:
            write_text(urdf, task.arm.urdf or "")
        try:
            write_text(path, text)
        except BaseException:
            if urdf is not None:  # useless without the task
                urdf.unlink(missing_ok=True)
            raise
    return path


@contextmanager
def _folder_of(path: Path) -> Iterator[None]:
    """Create the folder of a file; remove it again if writing fails.

    Raises:
        FileError: the file cannot be created: a name that is too long, a null byte, circular links, ...
    """
    new: list[Path] = []
    try:
        check_writable(path.parent)
        new = [each for each in (path.parent, *path.parents) if not each.exists()]
        path.parent.mkdir(parents=True, exist_ok=True)
        yield
    except BaseException as error:
        for each in new:
            with suppress(OSError):
                each.rmdir()
        if isinstance(error, PostureError) or not isinstance(error, OSError | RuntimeError | ValueError):
            raise
        reason = getattr(error, "strerror", None) or error
        raise FileError(path, f"cannot be written ({reason})") from error


def layout_of(task: TaskParts, path: Path, text: str) -> TomlLayout:
    """Return the layout of the TOML file from which a task was read.

    Args:
        task: the task.
        path: the file.
        text: its content.
    """
    descriptions = Descriptions(path, task.described, just_read=True)
    return TomlLayout(text, _contents(task, write_arm(task.arm, descriptions)[0], descriptions))


def _contents(task: TaskParts, arm: ArmSpec, descriptions: Descriptions) -> dict[str, Any]:
    """Return all tables that are not empty, in the order of the file."""
    contents: dict[str, Any] = {
        "version": VERSION,
        "kind": _kind(task),
        "name": task.name if task.name != descriptions.file.stem else Usual(task.name),
    }
    if task.continuity != "velocity":
        contents["continuity"] = task.continuity
    if task.repeat != 1:
        contents["repeat"] = task.repeat
    contents["arm"] = arm.model_dump(exclude_defaults=True)
    contents["limits"] = write_limits(task.limits, task.arm)
    controller = write_controller(task.controller, descriptions)
    if controller:
        contents["controller"] = controller
    if task.start is not None:
        contents["start"] = write_start(task.start, task.arm)
    if task.scene is not None:
        known = descriptions.find(task.scene, "scene", SceneSpec, make_scene)
        contents["scene"] = known or write_scene(task.scene, descriptions)
    if isinstance(task.motion, Leader):
        contents["leader"] = write_leader(task.motion, task.scene, descriptions)
    elif is_phased(task.motion):
        contents["phases"] = [write_phase(each, task.scene, descriptions) for each in task.motion]
    else:
        keyframes = cast("tuple[Keyframe, ...]", task.motion)
        contents["keyframes"] = [write_keyframe(each, task.scene, descriptions) for each in keyframes]
    if task.formats != RESULT_FORMATS:
        contents["output"] = {"formats": task.formats}
    if task.scans:
        contents["editor"] = {"scans": task.scans}
    plain: dict[str, Any] = plain_data(contents, descriptions.folder)
    return plain


def _kind(task: TaskParts) -> str:
    if isinstance(task.motion, Leader):
        return "follow_leader"
    return "phases" if is_phased(task.motion) else "keyframes"


def _text(
    task: TaskParts, arm: ArmSpec, path: Path, contents: dict[str, Any], layout: TomlLayout | None
) -> str:
    """Return the text of the file, which reads back as the task; with the layout if possible.

    Raises:
        FileError: no text reads back as the task.
    """
    if path.suffix.lower() == ".json":
        text = json.dumps(drop_defaults(contents), indent=2, ensure_ascii=False, allow_nan=False) + "\n"
    else:
        if layout is not None:
            text = toml_text(contents, layout)
            with suppress(FileError):
                _read_back(task, arm, path, text)
                return text
            warn_caller(f"{path}: its comments and layout could not be kept")
        text = toml_text(contents)
    _read_back(task, arm, path, text)
    return text
