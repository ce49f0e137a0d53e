"""Writes task files, and checks that they read back as the same task."""

from __future__ import annotations

import json
import math
import warnings
from collections.abc import Callable, Hashable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pinposture.arm import Arm, ArmSpec
from pinposture.arm.specification import roll_pitch_yaw
from pinposture.arm.urdf_reader import load_text
from pinposture.collision import Mesh, Scene
from pinposture.collision.obstacles import Obstacle
from pinposture.control import CONTROLLERS, Controller, EndEffector, Geodesic, Limits
from pinposture.curve import Curve
from pinposture.errors import FileError, PostureError, PostureWarning
from pinposture.storage import check_writable, relative, settled, write_text
from pinposture.task.document import Content, Document, check_format, content_of, shown
from pinposture.task.follow_leader import Leader
from pinposture.task.keyframe import Keyframe, usual_placement
from pinposture.task.reader import (
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
    UNLIMITED,
    VERSION,
    CurveSpec,
    ObstacleSpec,
    SceneSpec,
    TipSpec,
)
from pinposture.task.toml import TomlLayout, Usual, toml_text

Array = NDArray[np.float64]

# Whether what was read back from a file is what was written.

CLOSE = 1e-12
"""How far what angles say in a file may be apart: rotations do not survive them to the last bit."""


def differences(task: TaskParts, parts: TaskParts) -> list[str]:
    """Names of the attributes in which a task differs from what was read, arm and descriptions aside."""
    tests = {
        "motion": _same_motion(task.motion, parts.motion),
        "start": _same_start(task.start, parts.start),
    }
    plain = ("limits", "controller", "scene", "continuity", "formats", "name", "scans")
    tests |= {key: getattr(task, key) == getattr(parts, key) for key in plain}
    return [key for key, same in tests.items() if not same]


def _same_spec(one: ArmSpec, other: ArmSpec) -> bool:
    """Whether two arms are made from the same; files may be named by way of links."""

    def named(spec: ArmSpec) -> ArmSpec:
        folders = tuple(each.resolve() for each in spec.package_dirs)
        file = None if spec.urdf is None else Path(spec.urdf).resolve()
        return spec.model_copy(update={"urdf": file, "package_dirs": folders})

    return named(one) == named(other)


def _same_motion(one: tuple[Keyframe, ...] | Leader, other: tuple[Keyframe, ...] | Leader) -> bool:
    if isinstance(one, Leader) or isinstance(other, Leader):
        return one == other
    return len(one) == len(other) and all(map(_same_keyframe, one, other))


def _same_keyframe(one: Keyframe, other: Keyframe) -> bool:
    mine, its = one.tip, other.tip
    if mine is None or its is None or mine.pose is None or its.pose is None:
        return one == other
    still = pin.SE3.Identity()
    given = replace(mine, pose=still) == replace(its, pose=still)
    return given and _close(mine.pose, its.pose) and replace(one, tip=None) == replace(other, tip=None)


def _same_start(one: Array | None, other: Array | None) -> bool:
    if one is None or other is None:
        return one is other
    return _close(one, other)


def _close(one: Array, other: Array) -> bool:
    return one.shape == other.shape and bool(np.allclose(one, other, rtol=CLOSE, atol=CLOSE))


# What was said of parts of a task, where that still holds, in the words of a new file.

Part = TypeVar("Part", bound=Hashable)


class Wording:
    """Descriptions of parts of a task, to be written into a file.

    Attributes:
        file: the file that is to be written.
        read: whether the descriptions were read just now, and need not be tried again.
    """

    def __init__(self, file: Path, described: Mapping[Hashable, object], read: bool = False) -> None:
        """Prepare for a file.

        Args:
            file: the file that is to be written.
            described: as in `Task`.
            read: whether the descriptions were read just now, and need not be tried again.
        """
        self.file, self._described, self.read = file, described, read

    @property
    def folder(self) -> Path:
        """Where paths in the file begin."""
        return self.file.parent

    def told(
        self,
        part: Part,
        key: str,
        read: Callable[[Document], object],
    ) -> Any:
        """What is to stand in the file for a part, if that was said and is still true; else None.

        Args:
            part: the part.
            key: what it stands under.
            read: what makes the part of a file that holds nothing but that key.
        """
        if part not in self._described:
            return None
        plain = plain_in(self._described[part], self.folder)
        if self.read:
            return plain
        why = "which gives another one now"
        try:
            if read(Document(self.file, Content({key: plain}, None))) == part:
                return plain
        except PostureError as error:
            why = f"but {getattr(error, 'reason', error)}"
        message = f"{self.file}: {key} was {shown(plain)}, {why}; it is written out"
        warnings.warn(message, PostureWarning, stacklevel=5)
        return None


def plain_in(value: Any, folder: Path) -> Any:
    """Plain data with paths in the words of a file in this folder."""
    if isinstance(value, Path):
        return relative(value, folder)
    if isinstance(value, Mapping):
        return {key: plain_in(each, folder) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [plain_in(each, folder) for each in value]
    return value


# What stands in a task file for the arm: what it was made from, with a URDF file beside it if need be.


class WrittenArm(NamedTuple):
    """What stands in a task file for an arm, and what has to stand beside it.

    Attributes:
        spec: what it is made from, in a file.
        file: the URDF file beside it, if there has to be a new one.
        text: what that file holds.
    """

    spec: ArmSpec
    file: Path | None = None
    text: str = ""


def write_arm(arm: Arm, wording: Wording) -> WrittenArm:
    """Describe an arm by what it was made from.

    Raises:
        FileError: it was made of a Pinocchio model, or its URDF file would take the place of another.
    """
    spec = arm.spec
    if spec is None or arm.urdf is None or arm.report is None:
        reason = "it was made of a Pinocchio model and has no URDF; load it by Arm.from_urdf"
        raise FileError(wording.file, f"arm: no file can describe it: {reason}")
    if spec.template is not None and spec.modules is not None and spec.modules > MOST_MODULES:
        place, unit = spec.placement, spec.characteristic_length
        spec = ArmSpec(
            urdf=arm.urdf, split=arm.report.segmentation.sizes, placement=place, characteristic_length=unit
        )
    file = spec.urdf
    if file is None or (isinstance(file, Path) and (wording.read or _still(file, arm.urdf, wording))):
        return WrittenArm(spec)
    file = settled(wording.file.with_suffix(".urdf"))
    folders = [Path(each) for each in arm.report.package_dirs if settled(each) != file.parent]
    spec = spec.model_copy(update={"urdf": file, "package_dirs": tuple(folders)})
    if not file.exists():
        return WrittenArm(spec, file, arm.urdf)
    if load_text(file)[0] != arm.urdf:
        reason = "is there already, and holds something else than the arm of the task"
        raise FileError(file, f"{reason}; allowed: a name for the task beside which there is room")
    return WrittenArm(spec)


def _still(file: Path, text: str, wording: Wording) -> bool:
    """Whether a URDF file still holds what an arm was made from; a warning says why not."""
    why = "which gives another one now"
    try:
        if load_text(file)[0] == text:
            return True
    except PostureError as error:
        why = f"but {getattr(error, 'reason', error)}"
    message = f"{wording.file}: arm was {shown(relative(file, wording.folder))}, {why}; it is written out"
    warnings.warn(message, PostureWarning, stacklevel=5)
    return False


# What stands in a task file for keyframes, or for the path that the leader takes.

_USUAL: dict[str, Any] = {"trim": False, "roll": 0.0, "method": "auto"}
_OF_A_LEADER: dict[str, Any] = {
    "depth": None,
    "method": "closest",
    "and_back": False,
    "pipe": None,
}
_OF_A_TIP: dict[str, Any] = {"weight": 1.0, "priority": False, "direction_only": False, "length": None}


def write_keyframe(keyframe: Keyframe, usual: str, wording: Wording) -> dict[str, Any]:
    """A table for a keyframe, without what is as usual; `usual` is how its curve would be laid."""
    described: dict[str, Any] = {}
    if keyframe.name:
        described["name"] = keyframe.name
    for key in ("time", "duration"):
        if getattr(keyframe, key) is not None:
            described[key] = getattr(keyframe, key)
    if keyframe.hold:
        described["hold"] = keyframe.hold
    described["curve"] = write_curve(keyframe.curve, "curve", wording)
    described |= _placement(keyframe, usual) | _unusual(keyframe, _USUAL)
    if keyframe.region is not None:
        described["region"] = [end + 1 for end in keyframe.region]
    if keyframe.joints is not None:
        described["joints"] = list(keyframe.joints)
    if keyframe.tip is not None:
        described["tip"] = _write_tip(keyframe.tip, wording)
    return described


def write_leader(leader: Leader, usual: str, wording: Wording) -> dict[str, Any]:
    """A table for what the leader does, without what is as usual; `usual` is how its path would be laid."""
    described: dict[str, Any] = {"path": write_curve(leader.path, "path", wording), "speed": leader.speed}
    return described | _placement(leader, usual) | _unusual(leader, _OF_A_LEADER)


def _placement(motion: Keyframe | Leader, usual: str) -> dict[str, Any]:
    """How a curve is laid, which need not be said if it is as usual."""
    return {"placement": Usual(usual) if motion.placement == usual else motion.placement}


def write_curve(curve: Curve, key: str, wording: Wording) -> Any:
    """A curve as it was described, or by its control points, or by its knots and coefficients."""
    told = wording.told(curve, key, lambda file: make_curve(file, (key,), file.read(CurveSpec, (key,))))
    if told is not None:
        return told
    points = curve.control_points
    if points is not None:
        listed = points.tolist()
        described: dict[str, Any] = {"type": "spline", "control_points": listed, "degree": curve.degree}
        if curve.degree == 1 and len(listed) == 2:
            described = {"type": "line", "a": listed[0], "b": listed[1]}
        if _gives_curve(described, curve):
            if curve.degree == 3:
                del described["degree"]
            return described
    return curve.to_dict()


def _gives_curve(described: dict[str, Any], curve: Curve) -> bool:
    """Whether a description gives a curve back to the last bit; points may be too close, knots rounded."""
    try:
        return Curve.from_dict(described) == curve
    except PostureError:
        return False


def _write_tip(tip: EndEffector, wording: Wording) -> Any:
    told = wording.told(tip, "tip", lambda file: make_tip(file, ("tip",), file.read(TipSpec, ("tip",))))
    if told is not None:
        return told
    described: dict[str, Any] = {}
    if tip.pose is None:
        described["position"] = tip.position
    else:
        pose = pin.SE3(tip.pose)
        described |= {"position": pose.translation, "rotation": roll_pitch_yaw(pose.rotation)}
    if tip.point != -1:
        counted = isinstance(tip.point, int) and tip.point >= 0
        described["point"] = tip.point + 1 if counted else tip.point  # type: ignore[operator]
    return described | _unusual(tip, _OF_A_TIP)


def _unusual(whole: object, usual: dict[str, Any]) -> dict[str, Any]:
    """Attributes that are not as usual."""
    values = {key: getattr(whole, key) for key in usual}
    return {key: value for key, value in values.items() if value != usual[key]}


# What stands in a task file for limits, the controller, what surrounds the arm, and where it begins.


def write_limits(limits: Limits, arm: Arm) -> dict[str, Any]:
    """A table for the limits of each control cycle."""
    described: dict[str, Any] = {"cycle": limits.dt}
    for key in ("step", "velocity", "acceleration"):
        value = getattr(limits, key)
        if value is not None:
            described[key] = _limit(key, value, arm)
    if limits.position_margin:
        described["position_margin"] = limits.position_margin
    return described


def _limit(key: str, value: float | Array, arm: Arm) -> Any:
    """One number for all joints, one for those that turn and one for those that slide, or one for each."""
    if not isinstance(value, np.ndarray):
        return _bounded(value)
    both, rest = {}, arm.limits.velocity if key == "velocity" else np.full(arm.nv, np.inf)
    for kind, joints in (("turning", ~arm.slides), ("sliding", arm.slides)):
        own = np.unique(value[joints])
        if len(own) == 1 and np.isfinite(own[0]):
            both[kind] = float(own[0])
            rest = np.where(joints, own[0], rest)
    return both if both and np.array_equal(rest, value) else [_bounded(each) for each in value.tolist()]


def _bounded(value: float) -> float | str:
    return value if np.isfinite(value) else UNLIMITED


def write_controller(controller: Controller, wording: Wording) -> dict[str, Any]:
    """A table for the controller; an empty one for that which is taken if there is none.

    Raises:
        FileError: one whose parameters no file can say.
    """
    usual = Geodesic()
    if isinstance(controller, Geodesic):
        if (
            replace(
                usual,
                joint_weight=controller.joint_weight,
                relative_position_weight=controller.relative_position_weight,
            )
            == controller
        ):
            own = {key: getattr(controller, key) for key in ("joint_weight", "relative_position_weight")}
            own = {key: value for key, value in own.items() if value != getattr(usual, key)}
            return {"name": "geodesic", **own} if own else {}
    else:
        for name, make in CONTROLLERS.items():
            if make() == controller:
                return {"name": name}
    allowed = "a name with its usual parameters; joint_weight and relative_position_weight for 'geodesic'"
    raise FileError(
        wording.file, f"controller: no file can say all of {shown(controller)}; allowed: {allowed}"
    )


def write_scene(scene: Scene, wording: Wording) -> Any:
    """A table for the scene: the file that it came from, or what is in it."""
    told = wording.told(
        scene, "scene", lambda file: make_scene(file, ("scene",), file.read(SceneSpec, ("scene",)))
    )
    if told is not None:
        return told
    described: dict[str, Any] = {"margin": scene.margin}
    if scene.self_collision:
        described["self_collision"] = True
    if scene.arm_radius is not None:
        described["arm_radius"] = scene.arm_radius
    if scene.obstacles:
        described["obstacles"] = {name: _obstacle(each, wording) for name, each in scene.obstacles.items()}
    return described


def _obstacle(obstacle: Obstacle, wording: Wording) -> Any:
    told = wording.told(
        obstacle,
        "obstacle",
        lambda file: make_obstacle(file, ("obstacle",), file.read(ObstacleSpec, ("obstacle",))),
    )
    if told is not None:
        return told
    described = obstacle.to_dict()
    if described.get("rotation") == np.eye(3).tolist():
        del described["rotation"]
    if isinstance(obstacle, Mesh) and not any(obstacle.center):
        del described["center"]
    return described


def write_start(start: Array, arm: Arm) -> dict[str, Any]:
    """A table for the configuration to start from."""
    if np.array_equal(start, arm.straight()):
        return {"posture": "straight"}
    if np.array_equal(start, arm.neutral()):
        return {"posture": "neutral"}
    return {"joints": arm.positions(start)}


# A whole task file: what stands in it, and that it gives the task back before it is put in its place.


def write_task(task: TaskParts, path: Path, layout: TomlLayout | None = None) -> Path:
    """Write a task file, and a URDF file beside it if it takes one; see `Task.save`.

    Args:
        task: what to write.
        path: the file.
        layout: the TOML file whose comments and layout are to stay.
    """
    check_format(path)
    with _naming(path), _folder(path.parent):  # ways to other files lead through it
        wording = Wording(path, task.described)
        arm = write_arm(task.arm, wording)
        text = _text(task, arm.spec, path, _contents(task, arm.spec, wording), layout)
        if arm.file is not None:
            write_text(arm.file, arm.text)
        try:
            write_text(path, text)
        except BaseException:
            if arm.file is not None:  # which nobody needs without the task
                arm.file.unlink(missing_ok=True)
            raise
    return path


@contextmanager
def _naming(path: Path) -> Iterator[None]:
    """Refuse a name that no file can have: too long, with a null byte, or links that lead in a circle."""
    try:
        yield
    except PostureError:
        raise
    except (OSError, RuntimeError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise FileError(path, f"cannot be written ({reason})") from error


@contextmanager
def _folder(folder: Path) -> Iterator[None]:
    """Make a folder if there is none; it goes again if nothing comes into it."""
    check_writable(folder)
    new = [each for each in (folder, *folder.parents) if not each.exists()]
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise FileError(folder, f"cannot be made ({error.strerror or error})") from error
    try:
        yield
    except BaseException:
        for each in new:
            with suppress(OSError):
                each.rmdir()
        raise


def layout_of(task: TaskParts, path: Path, text: str) -> TomlLayout:
    """What to keep of the TOML file that a task was just read from.

    Args:
        task: the task.
        path: the file.
        text: what it holds.
    """
    wording = Wording(path, task.described, read=True)
    return TomlLayout(text, _contents(task, write_arm(task.arm, wording).spec, wording))


def _contents(task: TaskParts, arm: ArmSpec, wording: Wording) -> dict[str, Any]:
    """All tables, in the order in which they stand in the file; without those that say what is as usual."""
    leader = isinstance(task.motion, Leader)
    contents: dict[str, Any] = {"version": VERSION, "kind": "follow_leader" if leader else "keyframes"}
    contents["name"] = task.name if task.name != wording.file.stem else Usual(task.name)
    if task.continuity != "velocity":
        contents["continuity"] = task.continuity
    contents["arm"] = plain_in(arm.said(), wording.folder)
    contents["limits"] = write_limits(task.limits, task.arm)
    controller = write_controller(task.controller, wording)
    if controller:
        contents["controller"] = controller
    if task.start is not None:
        contents["start"] = write_start(task.start, task.arm)
    if task.scene is not None:
        contents["scene"] = write_scene(task.scene, wording)
    usual = usual_placement(task.scene)
    if isinstance(task.motion, Leader):
        contents["leader"] = write_leader(task.motion, usual, wording)
    else:
        contents["keyframes"] = [write_keyframe(each, usual, wording) for each in task.motion]
    if task.formats != RESULT_FORMATS:
        contents["output"] = {"formats": list(task.formats)}
    if task.scans:
        contents["editor"] = {"scans": [relative(scan, wording.folder) for scan in task.scans]}
    plain: dict[str, Any] = _plain(contents)
    return plain


def _plain(value: Any) -> Any:
    """The same without what numpy has put in; whole numbers without a point, unless they are vast."""
    if isinstance(value, Usual):
        return value
    if isinstance(value, dict):
        return {key: _plain(each) for key, each in value.items()}
    if isinstance(value, list | tuple | np.ndarray):
        return [_plain(each) for each in value]
    if isinstance(value, bool | int | str):
        return value
    number = float(value)
    whole = number.is_integer() and abs(number) < 1e15 and (number != 0.0 or math.copysign(1.0, number) > 0.0)
    return int(number) if whole else number


def _text(
    task: TaskParts, arm: ArmSpec, path: Path, contents: dict[str, Any], layout: TomlLayout | None
) -> str:
    """The text of the file, which reads back as the task; with the layout of the file it was read from.

    Raises:
        FileError: no text does.
    """
    if path.suffix.lower() == ".json":
        text = json.dumps(_said(contents), indent=2, ensure_ascii=False, allow_nan=False) + "\n"
    else:
        if layout is not None:
            text = toml_text(contents, layout)
            with suppress(FileError):
                _read_back(task, arm, path, text)
                return text
            warnings.warn(f"{path}: its comments and layout could not be kept", PostureWarning, stacklevel=4)
        text = toml_text(contents)
    _read_back(task, arm, path, text)
    return text


def _said(value: Any) -> Any:
    """The same without what need not be said."""
    if isinstance(value, dict):
        return {key: _said(each) for key, each in value.items() if not isinstance(each, Usual)}
    return [_said(each) for each in value] if isinstance(value, list) else value


def _read_back(task: TaskParts, arm: ArmSpec, path: Path, text: str) -> None:
    """Refuse to write what would be read as something else.

    Raises:
        FileError: it would.
    """
    try:
        text.encode()
    except UnicodeEncodeError as error:
        half = f"{text[error.start]!r} in a text of the task, half of a surrogate pair"
        raise FileError(path, f"{half}, is nothing for a file") from None
    document = Document(path, content_of(path, text))
    parts = read_task(document, task.arm)
    wrong = differences(task, parts)
    if not _same_spec(arm, read_arm(document)):
        wrong.append("arm")
    if wrong:
        raise FileError(path, f"cannot hold the task: {', '.join(wrong)} would be read as something else")
