"""Makes a task of what a task file says."""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple, cast

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from pydantic import BeforeValidator

from pinposture.arm import Arm, ArmSpec, FeedSpec, PlacementSpec
from pinposture.arm.manipulability import chosen_points
from pinposture.collision import Scene
from pinposture.collision.obstacles import KINDS, Obstacle, obstacle_from_dict
from pinposture.collision.scene import obstacles_around
from pinposture.control import Controller, EndEffector, Geodesic, Limits, controller_named
from pinposture.control.limits import cycle_of
from pinposture.curve import Curve
from pinposture.curve.presets import CURVES
from pinposture.errors import InvalidValue, PostureError, TaskError, UnknownName
from pinposture.storage import settled
from pinposture.task.document import Document, shown
from pinposture.task.follow_leader import MOST, Leader, check_leader
from pinposture.task.keyframe import CONTINUITIES, Keyframe, naming, title, usual_placement
from pinposture.task.specification import (
    LONGEST_CYCLE,
    RESULT_FORMATS,
    ArmTable,
    ControllerSpec,
    KeyframeSpec,
    LeaderSpec,
    LimitsSpec,
    SceneSpec,
    StartSpec,
    TaskSpec,
    TipSpec,
)
from pinposture.task.toml import Place

Array = NDArray[np.float64]

# The arm.


def read_arm(document: Document) -> ArmSpec:
    """What the arm is made from: a URDF file, or modules of a template, perhaps on a feed."""
    table: ArmTable = document.read(ArmTable, ("arm",))
    values = table.said()
    if table.urdf is not None:
        values["urdf"] = settled(document.named(("arm", "urdf"), table.urdf))
        folders = (document.named(("arm", "package_dirs"), each) for each in table.package_dirs)
        values["package_dirs"] = tuple(map(settled, folders))
    if table.feed is not None:
        values["feed"] = FeedSpec(**table.feed.said())
    if table.placement is not None:
        values["placement"] = PlacementSpec(**table.placement.said())
    with document.blaming(("arm",)):
        return ArmSpec(**values)


def make_arm(document: Document, spec: ArmSpec) -> Arm:
    """The arm of a task file; `spec` is what `read_arm` made of it."""
    try:
        return Arm.from_spec(spec)
    except PostureError as error:
        table = document.at(("arm",))
        key, reason = _named_by(error, table), str(error)
        if isinstance(error, InvalidValue) and key in table:
            value = error.value if key == "split" else table[key]
            reason = f"is {shown(value)}; allowed: {error.allowed}"
        raise document.fault(("arm", key) if key else ("arm",), reason) from error


def _named_by(error: PostureError, table: Mapping[str, Any]) -> str:
    """The key that an error of `Arm.from_spec` is about; empty if it is about the table."""
    if isinstance(error, InvalidValue):
        key = "split" if error.name.startswith("modules") and "urdf" in table else error.name
        if key in table:
            return key
    if isinstance(error, UnknownName):
        for key in ("base", "tip", "split", "locked"):
            value = table.get(key)
            if error.name == value or (isinstance(value, list | dict) and error.name in value):
                return key
    return "urdf" if "urdf" in table else ""


# The motion.


def make_keyframe(document: Document, where: Place, spec: KeyframeSpec, usual: Any) -> Keyframe:
    """A keyframe; `usual` is how its curve is laid where the file does not say."""
    values = {
        key: getattr(spec, key) for key in ("name", "time", "duration", "hold", "roll", "method", "trim")
    }
    curve = make_curve(document, (*where, "curve"), spec.curve)
    tip = None if spec.tip is None else make_tip(document, (*where, "tip"), spec.tip)
    region = None if spec.region is None else (spec.region[0] - 1, spec.region[1] - 1)
    placement: Any = spec.placement or usual
    with document.blaming(where):
        return Keyframe(curve, **values, placement=placement, region=region, tip=tip, joints=spec.joints)


def make_tip(document: Document, where: Place, spec: TipSpec) -> EndEffector:
    """What is asked of the tip, or of another control point."""
    place = pin.SE3(pin.rpy.rpyToMatrix(*(spec.rotation or (0.0, 0.0, 0.0))), np.array(spec.position))
    point = spec.point - 1 if isinstance(spec.point, int) and spec.point > 0 else spec.point
    given: dict[str, Any] = {"pose": place} if spec.rotation is not None else {"position": place.translation}
    for key in ("weight", "priority", "direction_only", "length"):
        given[key] = getattr(spec, key)
    with document.blaming(where):
        tip = EndEffector(**given, point=point)
    document.described[tip] = spec.said()
    return tip


def make_curve(document: Document, where: Place, spec: str | dict[str, Any]) -> Curve:
    """A curve: a preset, a file, or a description as in `Curve.from_dict`."""
    said: object = spec
    if isinstance(spec, str) and spec in CURVES:
        curve = CURVES[spec]
    elif isinstance(spec, str):
        curve, said = document.file(where, Curve.load), settled(document.named(where, spec))
    else:
        with document.blaming(where):
            curve = Curve.from_dict(spec)
    document.described[curve] = said
    return curve


def make_leader(document: Document, spec: LeaderSpec, usual: Any, arm: Arm) -> Leader:
    """What the leader does; `usual` is how its path is laid where the file does not say.

    Sizes that are beside all reason for the arm would take hours to find that out, and are refused.
    """
    path = make_curve(document, ("leader", "path"), spec.path)
    rest = {key: getattr(spec, key) for key in ("speed", "depth", "method", "and_back", "pipe")}
    leader = Leader(path, **rest, placement=spec.placement or usual)
    longest, narrowest = MOST * arm.length, arm.length / MOST
    if path.length > longest:
        reason = f"is {path.length:.4g} m long; allowed: {longest:.4g} m, {MOST} times the arm"
        raise document.fault(("leader", "path"), reason)
    if leader.pipe is not None and leader.pipe < narrowest:
        allowed = f"{narrowest:.4g} m or more, 1/{MOST} of the arm"
        said = shown(document.at(("leader", "pipe")))
        raise document.fault(("leader", "pipe"), f"is {said}; allowed: {allowed}")
    return leader


def _check_points(document: Document, where: Place, keyframe: Keyframe, arm: Arm) -> None:
    """Refuse control points of a keyframe that the arm does not have."""
    m = arm.n_modules
    if keyframe.region is not None and keyframe.region[1] >= m:
        said = document.at((*where, "region"))
        raise document.fault((*where, "region"), f"is {said}; the arm has control points 1 to {m}")
    if keyframe.tip is not None:
        point, where = keyframe.tip.point, (*where, "tip")
        if isinstance(point, str):
            with document.blaming(where, "point"):
                chosen_points(arm.control_points, point)
        elif not -m <= point < m:
            allowed = f"1 to {m} from the base, -1 to -{m} from the tip, or a name"
            said = document.at((*where, "point"))
            raise document.fault((*where, "point"), f"is {said}; allowed: {allowed}")


# What a task consists of, and what can be seen to be wrong with it before anything is searched for.


class TaskParts(NamedTuple):
    """What stands in a task file, as `pinposture.task.Task` has it under the same names."""

    arm: Arm
    motion: tuple[Keyframe, ...] | Leader
    limits: Limits
    controller: Controller
    scene: Scene | None
    start: Array | None
    continuity: Literal["velocity", "acceleration"]
    formats: tuple[str, ...]
    name: str
    scans: tuple[Path, ...]
    described: Mapping[Hashable, object]


DESCRIBED = (Curve, EndEffector, Scene, *KINDS.values())
"""The parts of a task that a file may describe in several ways."""


def check_task(task: TaskParts) -> None:
    """Refuse a task that no file could hold.

    Raises:
        InvalidValue: an attribute of the wrong kind, or one that does not fit the arm.
        UnknownName: a `continuity`, a format or a control point that does not exist.
        TaskError: a keyframe or an obstacle that does not go with the arm; names it.
    """
    if not isinstance(task.arm, Arm):
        raise InvalidValue("arm", task.arm, "an Arm")
    cycle = cycle_of(task.limits)
    if cycle > LONGEST_CYCLE:
        raise InvalidValue("dt", cycle, f"{LONGEST_CYCLE:g} s at most")
    task.limits.for_arm(task.arm)
    if task.continuity not in CONTINUITIES:
        raise UnknownName("continuity", task.continuity, CONTINUITIES)
    for each in task.formats:
        if each not in RESULT_FORMATS:
            raise UnknownName("format", each, RESULT_FORMATS)
    if not isinstance(task.name, str):
        raise InvalidValue("name", task.name, "text")
    described = task.described
    if not isinstance(described, Mapping) or not all(isinstance(each, DESCRIBED) for each in described):
        allowed = "a mapping from curves, tips, a scene or obstacles to what a file says of them"
        raise InvalidValue("described", described, allowed)
    if isinstance(task.motion, Leader):
        check_leader(task.motion, task.arm)
        if task.continuity != CONTINUITIES[0]:
            raise InvalidValue("continuity", task.continuity, f"{CONTINUITIES[0]!r}, of a leader")
    else:
        _check_keyframes(task.motion, task.arm)
    if task.scene is not None and not isinstance(task.scene, Scene):
        raise InvalidValue("scene", task.scene, "a Scene, or None")
    for name in around_base(task.scene, task.arm):
        raise TaskError(f"obstacle {name!r}", where_base_is(task.arm))


def around_base(scene: Scene | None, arm: Arm) -> tuple[str, ...]:
    """Names of the obstacles that the base of the arm is in."""
    return () if scene is None else obstacles_around(scene, arm.chain.base)


def where_base_is(arm: Arm) -> str:
    """What to say of such an obstacle."""
    at = ", ".join(f"{value:.4g}" for value in arm.chain.base)
    return f"it stands where the base of the arm is, at ({at}) m; move it, or leave it out"


def _check_keyframes(keyframes: tuple[Keyframe, ...], arm: Arm) -> None:
    if len(keyframes) < 2 or not all(isinstance(each, Keyframe) for each in keyframes):
        raise InvalidValue("keyframes", keyframes, "two or more of Keyframe(...)")
    for index, keyframe in enumerate(keyframes):
        if keyframe.region is not None and keyframe.region[1] >= arm.n_modules:
            reason = f"its region is {keyframe.region}; the arm has control points 0 to {arm.n_modules - 1}"
            raise TaskError(title(keyframes, index), reason)
        if keyframe.tip is not None:
            with naming(title(keyframes, index)):
                _check_point(arm, keyframe.tip.point)


def _check_point(arm: Arm, point: int | str) -> None:
    try:
        chosen_points(arm.control_points, point)
    except InvalidValue as error:  # there it is called "points"
        raise InvalidValue("point", error.value, error.allowed) from None


# Limits, the controller, what surrounds the arm, and where it begins.


def make_limits(document: Document, spec: LimitsSpec, arm: Arm) -> Limits:
    """The limits of each control cycle."""
    given = {key: getattr(spec, key) for key in ("step", "velocity", "acceleration", "position_margin")}
    with document.blaming(("limits",)):
        limits = Limits(**given, dt=spec.cycle)
        limits.for_arm(arm)
    return limits


def make_controller(document: Document, spec: ControllerSpec) -> Controller:
    """The controller, by name, with what only geodesic knows."""
    controller = controller_named(spec.name)
    for key in ("joint_weight", "relative_position_weight"):
        number = getattr(spec, key)
        if number is not None:
            if not isinstance(controller, Geodesic):
                reason = f"is for the controller 'geodesic'; it is {spec.name!r}"
                raise document.fault(("controller", key), reason)
            with document.blaming(("controller",), key):
                controller = replace(controller, **{key: number})
    return controller


def make_scene(document: Document, where: Place, spec: SceneSpec) -> Scene | None:
    """The scene: a file of its own, or what would be in it; None if nothing is said."""
    if spec.file is not None:
        scene = document.file((*where, "file"), Scene.load)
        document.described[scene] = {"file": settled(document.named((*where, "file"), spec.file))}
        return scene
    plain = spec.said()
    if not plain:
        return None
    obstacles = {
        name: make_obstacle(document, (*where, "obstacles", name), each)
        for name, each in spec.obstacles.items()
    }
    with document.blaming(where):
        return replace(Scene.from_dict(plain | {"obstacles": {}}), obstacles=obstacles)


def make_obstacle(document: Document, where: Place, spec: dict[str, Any]) -> Obstacle:
    """An obstacle of the scene; the path of a mesh begins where the file lies."""
    with document.blaming(where):
        obstacle = obstacle_from_dict(spec, str(document.path.parent))
    path = {"path": settled(document.path.parent / spec["path"])} if "path" in spec else {}
    document.described[obstacle] = spec | path
    return obstacle


def make_start(document: Document, spec: StartSpec, arm: Arm) -> Array | None:
    """The configuration to start from; None for where the motion begins."""
    if spec.joints is not None:
        with document.blaming(("start",), "joints"):
            return arm.configuration(spec.joints)
    if spec.posture is None:
        return None
    return arm.straight() if spec.posture == "straight" else arm.neutral()


# A whole task file.


def read_task(document: Document, arm: Arm | None = None) -> TaskParts:
    """The parts of a task.

    Args:
        document: the file.
        arm: the arm, if it is there already: it is not made of what the file says.

    Raises:
        FileError: what the file says cannot be; names the line, the key, the value and what is allowed.
    """
    document.read(
        Annotated[dict[str, Any], BeforeValidator(TaskSpec.check)], ()
    )  # what is in it needs the arm
    arm = make_arm(document, read_arm(document)) if arm is None else arm
    spec: TaskSpec = document.read(TaskSpec, (), {"arm": arm})
    scene = make_scene(document, ("scene",), spec.scene)
    usual = usual_placement(scene)
    motion: tuple[Keyframe, ...] | Leader
    if spec.kind == "follow_leader":
        leads = document.read(LeaderSpec, ("leader",)) if spec.leader is None else spec.leader
        motion = make_leader(document, leads, usual, arm)
    else:
        places: list[Place] = [("keyframes", number) for number in range(len(spec.keyframes))]
        listed = zip(places, spec.keyframes, strict=True)
        motion = tuple(make_keyframe(document, where, each, usual) for where, each in listed)
        if len(motion) < 2:
            found = "none" if not motion else "only one"
            reason = f"there is {found}; allowed: two or more, each begun by [[keyframes]]"
            raise document.fault(("keyframes",), reason)
        for where, keyframe in zip(places, motion, strict=True):
            _check_points(document, where, keyframe, arm)
    for name in around_base(scene, arm):
        raise document.fault(("scene", "obstacles", name), where_base_is(arm))
    return TaskParts(
        arm=arm,
        motion=motion,
        limits=make_limits(document, spec.limits, arm),
        controller=make_controller(document, spec.controller),
        scene=scene,
        start=make_start(document, spec.start, arm),
        continuity=cast(Literal["velocity", "acceleration"], spec.continuity),
        formats=spec.output.formats,
        name=document.path.stem if spec.name is None else spec.name,
        scans=tuple(settled(document.named(("editor", "scans"), name)) for name in spec.editor.scans),
        described=document.described,
    )
