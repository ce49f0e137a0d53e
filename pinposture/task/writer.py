"""Writes task files, and checks that they read back as the same task."""

from __future__ import annotations

import json
import math
import re
import warnings
from collections.abc import Callable, Hashable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import replace
from operator import eq
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pinposture.arm import Arm
from pinposture.arm.chain import joint_axes, neutral_placements
from pinposture.arm.loading import LoadReport, held_positions, load_model
from pinposture.arm.template import TEMPLATES, modules_to_urdf
from pinposture.arm.urdf_reader import CHAIN_JOINTS, Description, JointDescription, read_description
from pinposture.collision import Mesh, Scene
from pinposture.collision.obstacles import Obstacle
from pinposture.control import CONTROLLERS, ConstrainedQP, Controller, EndEffector, Limits
from pinposture.curve import Curve
from pinposture.errors import FileError, PostureError, PostureWarning
from pinposture.storage import check_writable, read_text, relative, settled, write_text
from pinposture.task.document import Content, Document, Table, check_format, content_of, shown
from pinposture.task.follow_leader import Leader
from pinposture.task.keyframe import Keyframe, usual_placement
from pinposture.task.reader import (
    MOST_MODULES,
    RESULT_FORMATS,
    UNLIMITED,
    VERSION,
    read_arm,
    read_curve,
    read_obstacle,
    read_surroundings,
    read_task,
    read_tip,
)
from pinposture.task.toml import Layout, Usual, toml_text

if TYPE_CHECKING:
    from pinposture.task.task import Task


# What an arm no longer says of how it was loaded: locked joints, and the links at which modules end.

ROUNDED = 1e-12
"""How far places and joint positions may be apart that are the same [rad or m]."""


def locked_joints(arm: Arm, description: Description, base: str, tip: str) -> dict[str, float]:
    """Positions of the joints that have to be locked for the arm to come out as it is [rad or m].

    Those are the joints on the chain that could move and do not, and others that are elsewhere than they
    would be by themselves.

    Args:
        arm: the arm.
        description: what it was made of.
        base: link at which it begins.
        tip: link at which it ends.
    """
    whole = pin.buildModelFromXML(description.text)
    moving, chain = set(arm.joint_names), {joint.name for joint in description.chain(base, tip)}
    held = {
        joint.name: _position(arm.model, whole, joint)
        for joint in description.joints
        if joint.type in CHAIN_JOINTS and joint.name not in moving
    }
    needed = {joint.name for joint in description.joints if joint.moves} & chain
    locked = {name: at for name, at in held.items() if name in needed}
    usual = held_positions(description, locked)
    return locked | {name: at for name, at in held.items() if abs(at - usual[name]) > ROUNDED}


def _position(model: pin.Model, whole: pin.Model, joint: JointDescription) -> float:
    """Where a joint is that a model holds still [rad or m].

    Args:
        model: the model, the base of which may have been moved.
        whole: the same robot, all of its joints free, in its neutral configuration.
        joint: the joint.
    """

    def between(frames: pin.Model) -> tuple[pin.SE3, pin.SE3]:
        ids = (frames.getFrameId(link, pin.FrameType.BODY) for link in (joint.parent, joint.child))
        parent, child = (frames.frames[index].placement for index in ids)
        return parent, child

    index = whole.getJointId(joint.name)
    parent, child = between(whole)
    begin, end = between(model)
    moved = whole.jointPlacements[index].actInv(parent * begin.actInv(end)) * child.inverse()
    axis = joint_axes(whole, [index])[0]
    if joint.type == "prismatic":
        return _short(float(axis @ moved.translation))
    turn = moved.rotation
    sine = 0.5 * float(axis @ (turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]))
    return _short(math.atan2(sine, 0.5 * (float(np.trace(turn)) - 1.0)))


def _short(number: float) -> float:
    """The same number but for rounding, with as many digits as a person would have given it."""
    return next((r for digits in range(3, 13) if abs((r := round(number, digits)) - number) < 1e-14), number)


def links_of_modules(arm: Arm) -> list[str] | None:
    """Links at whose origins modules end; None if there is no such link for each."""
    model, placements = arm.model, neutral_placements(arm.model)
    places = {
        str(frame.name): (placements[frame.parentJoint] * frame.placement).translation
        for frame in model.frames
        if frame.type == pin.FrameType.BODY
    }
    found = []
    for point in arm.chain.points:
        near = [link for link, at in places.items() if np.abs(at - point).max() <= ROUNDED * arm.length]
        if not near:
            return None
        found.append(near[-1])
    return found


# Placements in a task file: a position, and roll, pitch and yaw.

Array = NDArray[np.float64]

ANGLE_ROUNDING = 1e-15
"""How far what three angles say may be from a rotation matrix, entry by entry."""


def write_placement(placement: pin.SE3) -> dict[str, Any]:
    """What stands in a file for a placement; nothing for what is zero."""
    described: dict[str, Any] = {}
    if np.any(placement.translation):
        described["position"] = placement.translation.tolist()
    if not np.array_equal(placement.rotation, np.eye(3)):
        described["rotation"] = roll_pitch_yaw(placement.rotation)
    return described


def roll_pitch_yaw(rotation: Array) -> list[float]:
    """The angles of a rotation matrix (3, 3) [rad], with no more digits than it takes to find it again."""
    angles = np.asarray(pin.rpy.matrixToRpy(rotation))
    for digits in range(3, 17):
        rounded = np.round(angles, digits) + 0.0  # and no zero below zero
        if np.abs(pin.rpy.rpyToMatrix(*rounded) - rotation).max() <= ANGLE_ROUNDING:
            return [float(angle) for angle in rounded]
    return [float(angle) for angle in angles]


# Whether what was read back from a file is what was written.

CLOSE = 1e-12
"""How far what angles say in a file may be apart: rotations do not survive them to the last bit."""


def same_arm(one: Arm, other: Arm) -> bool:
    """Whether two arms have the same joints, limits, inertias and control points, and stand in one place."""
    a, b = one.model, other.model
    names = [(arm.model.name, arm.nq, arm.joint_names, arm.control_points) for arm in (one, other)]
    if names[0] != names[1]:
        return False
    limits = zip((*one.limits, a.effortLimit), (*other.limits, b.effortLimit), strict=True)
    if not all(map(np.array_equal, *zip(*limits, strict=True))):
        return False
    numbers = zip(_numbers(one), _numbers(other), strict=True)
    return all(_close(x, y) for x, y in numbers)


def _numbers(arm: Arm) -> tuple[Array, ...]:
    model = arm.model
    frames = [model.frames[model.getFrameId(name)] for name in arm.control_points]
    placements = [
        *list(model.jointPlacements)[1:],
        *(frame.placement for frame in frames),
        arm.base_placement,
    ]
    return (
        np.array([placement.homogeneous for placement in placements]),
        np.array([frame.parentJoint for frame in frames]),
        np.array([inertia.toDynamicParameters() for inertia in model.inertias]),
        arm.chain.axes,
        np.array([arm.sliding_unit]),
    )


def differences(task: Task, parts: Mapping[str, Any]) -> list[str]:
    """Names of the attributes in which a task differs from what was read, arm and descriptions aside."""
    tests = {
        "motion": _same_motion(task.motion, parts["motion"]),
        "start": _same_start(task.start, parts["start"]),
    }
    plain = ("limits", "controller", "scene", "continuity", "formats", "name", "scans")
    tests |= {key: getattr(task, key) == parts[key] for key in plain}
    return [key for key, same in tests.items() if not same]


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
    """

    def __init__(self, file: Path, described: Mapping[Hashable, object], read: bool = False) -> None:
        """Prepare for a file.

        Args:
            file: the file that is to be written.
            described: as in `Task`.
            read: whether the descriptions were read just now, and need not be tried again.
        """
        self.file, self._described, self._read = file, described, read

    @property
    def folder(self) -> Path:
        """Where paths in the file begin."""
        return self.file.parent

    def told(
        self,
        part: Part,
        key: str,
        read: Callable[[Table], object],
        same: Callable[[Any, Part], bool] = eq,
    ) -> Any:
        """What is to stand in the file for a part, if that was said and is still true; else None.

        Args:
            part: the part.
            key: what it stands under.
            read: what makes the part of a table with that key.
            same: whether two parts are equal.
        """
        if part not in self._described:
            return None
        plain = plain_in(self._described[part], self.folder)
        if self._read:
            return plain
        why = "which gives another one now"
        try:
            if same(read(self.table(key, plain)), part):
                return plain
        except PostureError as error:
            why = f"but {getattr(error, 'reason', error)}"
        message = f"{self.file}: {key} was {shown(plain)}, {why}; it is written out"
        warnings.warn(message, PostureWarning, stacklevel=5)
        return None

    def table(self, key: str, plain: object) -> Table:
        """A table of the file that holds nothing but this."""
        return Document(self.file, Content({key: plain}, None)).root


def plain_in(value: Any, folder: Path) -> Any:
    """Plain data with paths in the words of a file in this folder."""
    if isinstance(value, Path):
        return relative(value, folder)
    if isinstance(value, Mapping):
        return {key: plain_in(each, folder) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [plain_in(each, folder) for each in value]
    return value


# What stands in a task file for the arm: as it was described, a template, or a URDF file beside it.

_TEMPLATED = re.compile(r"(.+)_(\d{1,4})")


class WrittenArm(NamedTuple):
    """What stands in a task file for an arm, and what has to stand beside it.

    Attributes:
        table: its table.
        file: the URDF file beside it, if there has to be a new one.
        text: what that file holds.
    """

    table: dict[str, Any]
    file: Path | None = None
    text: str = ""


def write_arm(arm: Arm, wording: Wording) -> WrittenArm:
    """Describe an arm.

    Raises:
        FileError: it has no description, none that a file could hold, or its URDF file would take the place
            of another.
    """
    told = wording.told(arm, "arm", lambda table: read_arm(table.table("arm"), _load), same_arm)
    if told is not None:
        return WrittenArm(told)
    more: dict[str, Any] = {}
    placement = write_placement(arm.base_placement)
    if placement:
        more["placement"] = placement
    if arm.sliding_unit != float(arm.chain.module_lengths.mean()):
        more["sliding_unit"] = arm.sliding_unit
    template = _template(arm)
    if template is not None and _gives_arm(template | more, arm, wording):
        return WrittenArm(template | more)
    return _beside(arm, more, wording)


def _template(arm: Arm) -> dict[str, Any] | None:
    """The template that an arm is made of, if it is one of `Arm.from_template`, with the lengths of links."""
    named = _TEMPLATED.fullmatch(str(arm.model.name))
    if named is None or named[1] not in TEMPLATES or not 1 <= int(named[2]) <= MOST_MODULES:
        return None
    module, count = TEMPLATES[named[1]], int(named[2])
    joints = len(module.joints)
    if arm.model.njoints != joints * count + 1:
        return None
    ends = [arm.model.jointPlacements[joint].translation[0] for joint in range(2, arm.model.njoints)]
    ends.append(arm.model.frames[arm.model.getFrameId(arm.control_points[-1])].placement.translation[0])
    lengths = [float(length) for length in ends[:joints]]
    try:
        module = module.with_lengths(lengths)
    except PostureError:
        return None
    if modules_to_urdf([module] * count, str(arm.model.name)) != arm.urdf:
        return None
    own = {} if module == TEMPLATES[named[1]] else {"link_lengths": lengths}
    return {"template": named[1], "modules": count, **own}


def _beside(arm: Arm, more: dict[str, Any], wording: Wording) -> WrittenArm:
    """The arm as a URDF file beside the task."""
    if arm.urdf is None or arm.report is None:
        reason = "it was made of a Pinocchio model and has no URDF; load it by Arm.from_urdf"
        raise FileError(wording.file, f"arm: no file can describe it: {reason}")
    file = wording.file.with_suffix(".urdf")
    for described in _described(arm, arm.report, file):
        table = plain_in(described | more, wording.folder)
        if _gives_arm(table, arm, wording, arm.urdf):
            there = file.exists()
            if there and read_text(file) != arm.urdf:
                reason = "is there already, and holds something else than the arm of the task"
                raise FileError(file, f"{reason}; allowed: a name for the task beside which there is room")
            return WrittenArm(table) if there else WrittenArm(table, file, arm.urdf)
    reason = "its URDF does not lead to the same control points again; say how by `described`"
    raise FileError(wording.file, f"arm: no file can describe it: {reason}")


def _described(arm: Arm, report: LoadReport, file: Path) -> Iterator[dict[str, Any]]:
    """Descriptions that may give the arm again: modules by their joints, or by the links where they end."""
    assert arm.urdf is not None
    description = read_description(arm.urdf)
    described: dict[str, Any] = {"urdf": file}
    if report.base != description.root:
        described["base"] = report.base
    described["tip"] = report.tip
    sizes = list(report.segmentation.sizes)
    split = sizes[0] if len(set(sizes)) == 1 else sizes
    locked = locked_joints(arm, description, report.base, report.tip)
    rest: dict[str, Any] = {"locked": locked} if locked else {}
    folders = [Path(each) for each in report.package_dirs if settled(each) != settled(file.parent)]
    if folders:
        rest["package_dirs"] = folders
    yield described | {"split": split} | rest
    links = links_of_modules(arm)
    if links is not None:
        yield described | {"split": links} | rest


def _gives_arm(table: dict[str, Any], arm: Arm, wording: Wording, text: str | None = None) -> bool:
    """Whether a description gives an arm back."""

    def load(path: Path, **given: Any) -> Arm:
        return _load(path if text is None else text, **given)

    try:
        return same_arm(read_arm(wording.table("arm", table).table("arm"), load), arm)
    except PostureError:
        return False


def _load(source: str | Path, **given: Any) -> Arm:
    """As `Arm.from_urdf`, without the warnings: they were told when the arm was made."""
    locked, placement = given.pop("locked") or {}, given.pop("base_placement") or pin.SE3.Identity()
    loaded = load_model(source, **given, locked=locked, base_placement=placement)
    return Arm(loaded.model, loaded.control_points, placement, loaded.text, loaded.report)


# What stands in a task file for keyframes, or for the path that the leader takes.

_USUAL: dict[str, Any] = {"trim": False, "roll": 0.0, "method": "auto"}
_OF_A_LEADER: dict[str, Any] = {
    "depth": None,
    "method": "closest",
    "and_back": False,
    "pipe": None,
}
_OF_A_TIP: dict[str, Any] = {"weight": 1.0, "strict": False, "axis_only": False, "length": None}


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
    told = wording.told(curve, key, lambda table: read_curve(table, key))
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
    told = wording.told(tip, "tip", lambda table: read_tip(table.table("tip")))
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
    usual = ConstrainedQP()
    if isinstance(controller, ConstrainedQP):
        if replace(usual, haste=controller.haste, chord=controller.chord) == controller:
            own = {key: getattr(controller, key) for key in ("haste", "chord")}
            own = {key: value for key, value in own.items() if value != getattr(usual, key)}
            return {"name": "qp", **own} if own else {}
    else:
        for name, make in CONTROLLERS.items():
            if make() == controller:
                return {"name": name}
    reason = (
        f"no file can say all of {shown(controller)}; allowed: a name with its usual parameters, and haste"
    )
    raise FileError(wording.file, f"controller: {reason} and chord for 'qp'")


def write_scene(scene: Scene, wording: Wording) -> Any:
    """A table for the scene: the file that it came from, or what is in it."""
    told = wording.told(scene, "scene", lambda table: read_surroundings(table.table("scene"), wording.folder))
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
        obstacle, "obstacle", lambda table: read_obstacle(table.table("obstacle"), wording.folder)
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


def write_task(task: Task, path: Path) -> Path:
    """Write a task file, and a URDF file beside it if it takes one; see `Task.save`."""
    check_format(path)
    with _naming(path), _folder(path.parent):  # ways to other files lead through it
        wording = Wording(path, task.described)
        arm = write_arm(task.arm, wording)
        text = _text(task, path, _contents(task, arm.table, wording))
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


def layout_of(task: Task, path: Path, text: str) -> Layout:
    """What to keep of the TOML file that a task was just read from.

    Args:
        task: the task.
        path: the file.
        text: what it holds.
    """
    wording = Wording(path, task.described, read=True)
    return Layout(text, _contents(task, write_arm(task.arm, wording).table, wording))


def _contents(task: Task, arm: dict[str, Any], wording: Wording) -> dict[str, Any]:
    """All tables, in the order in which they stand in the file; without those that say what is as usual."""
    leader = isinstance(task.motion, Leader)
    contents: dict[str, Any] = {"version": VERSION, "kind": "follow_leader" if leader else "keyframes"}
    contents["name"] = task.name if task.name != wording.file.stem else Usual(task.name)
    if task.continuity != "velocity":
        contents["continuity"] = task.continuity
    contents["arm"] = arm
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


def _text(task: Task, path: Path, contents: dict[str, Any]) -> str:
    """The text of the file, which reads back as the task; with the layout of the file it was read from.

    Raises:
        FileError: no text does.
    """
    if path.suffix.lower() == ".json":
        text = json.dumps(_said(contents), indent=2, ensure_ascii=False, allow_nan=False) + "\n"
    else:
        if task.layout is not None:
            text = toml_text(contents, task.layout)
            with suppress(FileError):
                _read_back(task, path, text)
                return text
            warnings.warn(f"{path}: its comments and layout could not be kept", PostureWarning, stacklevel=4)
        text = toml_text(contents)
    _read_back(task, path, text)
    return text


def _said(value: Any) -> Any:
    """The same without what need not be said."""
    if isinstance(value, dict):
        return {key: _said(each) for key, each in value.items() if not isinstance(each, Usual)}
    return [_said(each) for each in value] if isinstance(value, list) else value


def _read_back(task: Task, path: Path, text: str) -> None:
    """Refuse to write what would be read as something else.

    Raises:
        FileError: it would.
    """
    try:
        text.encode()
    except UnicodeEncodeError as error:
        half = f"{text[error.start]!r} in a text of the task, half of a surrogate pair"
        raise FileError(path, f"{half}, is nothing for a file") from None
    parts = read_task(Document(path, content_of(path, text)), task.arm)
    wrong = differences(task, parts)
    if wrong:
        raise FileError(path, f"cannot hold the task: {', '.join(wrong)} would be read as something else")
