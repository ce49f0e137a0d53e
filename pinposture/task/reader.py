"""Reads task files."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from difflib import get_close_matches
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, cast

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pinposture.arm import Arm, JointSpec, ModuleTemplate, template
from pinposture.arm.manipulability import chosen_points
from pinposture.collision import Scene
from pinposture.collision.obstacles import KINDS, Obstacle, obstacle_from_dict
from pinposture.collision.scene import obstacles_around
from pinposture.control import CONTROLLERS, ConstrainedQP, Controller, EndEffector, Limits, controller_named
from pinposture.control.limits import cycle_of
from pinposture.curve import Curve
from pinposture.curve.presets import CURVES
from pinposture.errors import InvalidValue, PostureError, TaskError, UnknownName
from pinposture.placement.resolve import METHODS, PLACEMENTS
from pinposture.storage import settled
from pinposture.task.document import Document, Table, shown
from pinposture.task.follow_leader import MOST, Leader, check_leader
from pinposture.task.follow_leader import PATH_METHODS as WINDOWS
from pinposture.task.follow_leader import PATH_PLACEMENTS as ENTRIES
from pinposture.task.keyframe import CONTINUITIES, Keyframe, naming, title, usual_placement
from pinposture.task.perform import CYCLE

if TYPE_CHECKING:
    from pinposture.task.task import Task


# What a task file says of the arm: a URDF file, or modules of a template, and where it stands.

_DESCRIBED = ("urdf", "base", "tip", "split", "locked", "package_dirs")
_TEMPLATED = ("template", "modules", "link_lengths", "joint_limits", "feed")
_FEED = {"length": "length", "stroke": "length", "speed": "speed"}
_PLACEMENT = {"position": "length", "rotation": "angle"}
_ARM_QUANTITIES = {"link_lengths": "length", "joint_limits": "angle", "sliding_unit": "length"}

MOST_MODULES = 1000
"""The longest arm."""


def read_arm(table: Table, load: Callable[..., Arm] = Arm.from_urdf) -> Arm:
    """The arm: from a URDF file, or of modules of a template, perhaps on a feed.

    Args:
        table: what the file says of it.
        load: what makes an arm of a URDF file, called as `Arm.from_urdf`.
    """
    table.only(*_DESCRIBED, *_TEMPLATED, "placement", "sliding_unit")
    kind, other = (_DESCRIBED, _TEMPLATED) if "urdf" in table else (_TEMPLATED, _DESCRIBED)
    for key in other:
        if key in table:
            raise table.fault(key, f"does not go with {kind[0]!r}")
    placement = read_placement(table.table("placement")) if "placement" in table else None
    if "urdf" in table:
        arm = _described(table, placement, load)
    elif "template" in table:
        arm = _templated(table, placement)
    else:
        raise table.fault(None, "needs one of the keys 'urdf', 'template'")
    unit = table.above_zero("sliding_unit", "length", default=None)
    return table.says(arm if unit is None else arm.with_sliding_unit(unit), _in_si(table))


def _templated(table: Table, placement: pin.SE3 | None) -> Arm:
    """The arm of equal modules, called as `Arm.from_template` calls it."""
    name = table.text("template")
    with table.blaming("template"):
        module = template(name)
    if "link_lengths" in table:
        lengths = table.quantities("link_lengths", ["length"] * len(module.joints))
        with table.blaming("link_lengths"):
            module = module.with_lengths(lengths)
    if "joint_limits" in table:
        lower, upper = table.quantities("joint_limits", ["angle"] * 2)
        with table.blaming("joint_limits"):
            module = module.with_limits(lower, upper)
    count = table.whole("modules", 1, MOST_MODULES)
    modules = [module] * count
    if "feed" in table:
        modules.insert(0, _feed(table.table("feed"), module))
    with table.blaming():
        return Arm.from_modules(modules, base_placement=placement, name=f"{name}_{count}")


def _described(table: Table, placement: pin.SE3 | None, load: Callable[..., Arm]) -> Arm:
    """The arm of a URDF file, with what `Arm.from_urdf` takes besides."""
    given: dict[str, Any] = {"base": table.text("base", None), "tip": table.text("tip", None)}
    folders = table.value("package_dirs", None)
    if folders is not None:
        if not isinstance(folders, list) or not all(isinstance(each, str) for each in folders):
            raise table.fault("package_dirs", f"is {shown(folders)}; allowed: a list of folders")
        folders = [table.place("package_dirs", each) for each in folders]
    given |= {"modules": table.value("split", None), "locked": _locked(table), "package_dirs": folders}
    path = table.path("urdf", table.text("urdf"))
    try:
        return load(path, **given, base_placement=placement)
    except PostureError as error:
        key, reason = _named_by(error, table), str(error)
        if key == "split" and isinstance(error, InvalidValue):
            reason = f"is {shown(error.value)}; allowed: {error.allowed}"
        raise table.fault(key, reason) from error


def _locked(table: Table) -> dict[str, float]:
    held = table.table("locked")
    return {name: held.quantity(name, "angle", "length") for name in held.plain()}


def _named_by(error: PostureError, table: Table) -> str:
    """The key that an error of `Arm.from_urdf` is about."""
    if isinstance(error, InvalidValue) and error.name.startswith("modules"):
        return "split"
    if isinstance(error, UnknownName):
        for key in ("base", "tip", "split", "locked"):
            value = table.value(key, None)
            if error.name == value or (isinstance(value, list | dict) and error.name in value):
                return key
    return "urdf"


def _feed(table: Table, module: ModuleTemplate) -> ModuleTemplate:
    """A slide along the axis of the arm, with the link that it pushes."""
    table.only(*_FEED)
    stroke = table.above_zero("stroke", "length")
    length = table.quantity("length", "length", default=module.length)
    speed = table.above_zero("speed", "speed", default=0.1)
    with table.blaming():
        slide = JointSpec("x", "prismatic", 0.0, stroke, velocity=speed)
        return ModuleTemplate("Feed", (slide,), (length,), module.radius)


def read_placement(table: Table) -> pin.SE3:
    """A placement in the world: a position, and roll, pitch and yaw."""
    table.only(*_PLACEMENT)
    position = table.quantities("position", ["length"] * 3, default=[0.0, 0.0, 0.0])
    angles = table.quantities("rotation", ["angle"] * 3, default=[0.0, 0.0, 0.0])
    return pin.SE3(pin.rpy.rpyToMatrix(*angles), np.array(position))


def placement_in_si(table: Table) -> dict[str, Any]:
    """What a table with a placement holds, in SI units."""
    return table.in_si(_PLACEMENT)


def _in_si(table: Table) -> dict[str, Any]:
    """The description as it is, in SI units and with absolute paths."""
    plain = table.in_si(_ARM_QUANTITIES)
    if "placement" in table:
        plain["placement"] = placement_in_si(table.table("placement"))
    if "feed" in table:
        plain["feed"] = table.table("feed").in_si(_FEED)
    if "locked" in table:
        plain["locked"] = _locked(table)
    if "urdf" in table:
        plain["urdf"] = table.place("urdf", table.text("urdf"))
    if "package_dirs" in table:
        plain["package_dirs"] = [table.place("package_dirs", each) for each in table.value("package_dirs")]
    return plain


# What a task file says of the motion: keyframes, or the path that the leader takes.

_KEYFRAME = (
    "name",
    "curve",
    "time",
    "duration",
    "hold",
    "placement",
    "roll",
    "method",
    "trim",
    "region",
    "tip",
    "joints",
)
_TIP = ("position", "rotation", "point", "weight", "strict", "axis_only", "length")
_LEADER = ("path", "speed", "depth", "placement", "method", "and_back", "pipe")
_MOTION_QUANTITIES = {
    **dict.fromkeys(("radius", "pitch", "smoothing", "a", "b", "center"), "length"),
    "phase": "angle",
}


def read_keyframes(tables: list[Table], usual: str, arm: Arm) -> tuple[Keyframe, ...]:
    """The keyframes, each checked by itself; `usual` is how curves are laid where the file does not say."""
    return tuple(_keyframe(table, usual, arm) for table in tables)


def _keyframe(table: Table, usual: str, arm: Arm) -> Keyframe:
    table.only(*_KEYFRAME)
    region = table.value("region", None)
    if region is not None:
        count = isinstance(region, list) and len(region) == 2
        if not (count and all(isinstance(each, int) and not isinstance(each, bool) for each in region)):
            allowed = "two whole numbers: the first and the last control point, counted from 1 at the base"
            raise table.fault("region", f"is {shown(region)}; allowed: {allowed}")
        if not 1 <= region[0] <= region[1]:
            raise table.fault("region", f"is {region}; allowed: 1 or more, the last not before the first")
        region = (region[0] - 1, region[1] - 1)
    values: dict[str, Any] = {
        "name": table.text("name", ""),
        "time": table.quantity("time", "time", default=None),
        "duration": table.quantity("duration", "time", default=None),
        "hold": table.quantity("hold", "time", default=0.0),
        "placement": table.text("placement", usual, PLACEMENTS),
        "roll": table.quantity("roll", "angle", default=0.0),
        "method": table.text("method", "auto", METHODS),
        "trim": table.flag("trim", False),
        "region": region,
        "joints": _read_joints(table, arm),
        "tip": read_tip(table.table("tip")) if "tip" in table else None,
    }
    curve = read_curve(table, "curve")
    with table.blaming():
        return Keyframe(curve, **values)


def _read_joints(table: Table, arm: Arm) -> list[float] | None:
    """Joint positions near which a posture is taken; those of another arm are read, and ignored later."""
    listed = table.value("joints", None)
    if not isinstance(listed, list):
        return None if listed is None else table.quantities("joints", ["angle"] * arm.nv)  # which raises
    own = ["length" if slides else "angle" for slides in arm.slides]
    kinds = own if len(listed) == len(own) else ["angle"] * len(listed)
    positions: list[float] = table.quantities("joints", kinds)
    return positions


def read_tip(table: Table) -> EndEffector:
    """What is asked of the tip, or of another control point."""
    table.only(*_TIP)
    point = table.value("point", -1)
    if not isinstance(point, str):
        if isinstance(point, bool) or not isinstance(point, int) or point == 0:
            allowed = "1 or more, counted from the base; -1 or less, counted from the tip; or a name"
            raise table.fault("point", f"is {shown(point)}; allowed: {allowed}")
        point -= point > 0  # the library counts from 0
    if "position" not in table:
        raise table.fault(None, "the key 'position' is missing; 'rotation' goes with it, if it matters")
    where = read_placement(table.part("position", "rotation"))
    options = {
        "point": point,
        "weight": table.number("weight", 1.0),
        "strict": table.flag("strict", False),
        "axis_only": table.flag("axis_only", False),
        "length": table.above_zero("length", "length", default=None),
    }
    place = {"pose": where} if "rotation" in table else {"position": where.translation}
    with table.blaming():
        tip = EndEffector(**place, **options)
    plain = placement_in_si(table)
    if "length" in table:
        plain["length"] = tip.length
    return table.says(tip, plain)


def check_points(table: Table, keyframe: Keyframe, arm: Arm) -> None:
    """Refuse control points of a keyframe that the arm does not have."""
    m = arm.n_modules
    if keyframe.region is not None and keyframe.region[1] >= m:
        raise table.fault("region", f"is {table.value('region')}; the arm has control points 1 to {m}")
    if keyframe.tip is not None:
        point, tip = keyframe.tip.point, table.table("tip")
        if isinstance(point, str):
            with tip.blaming("point"):
                chosen_points(arm.control_points, point)
        elif not -m <= point < m:
            allowed = f"1 to {m} from the base, -1 to -{m} from the tip, or a name"
            raise tip.fault("point", f"is {tip.value('point')}; allowed: {allowed}")


def read_curve(table: Table, key: str) -> Curve:
    """A curve: a preset, a file, or a description as in `Curve.from_dict`."""
    value = table.value(key)
    if isinstance(value, str):
        if value in CURVES:
            return table.says(CURVES[value], value)
        if not Path(value).suffix:
            close = get_close_matches(value, CURVES, n=1)
            hint = f" (did you mean {close[0]!r}?)" if close else ""
            allowed = f"{', '.join(CURVES)}, a .json, .csv or .txt file, or a table with a type"
            raise table.fault(key, f"is {shown(value)}{hint}; allowed: {allowed}")
        return table.says(table.file(key, Curve.load), table.place(key, value))
    if not isinstance(value, Mapping):
        raise table.fault(key, f"is {shown(value)}; allowed: a name, a file, or a table with a type")
    described = table.table(key)
    plain = described.in_si(_MOTION_QUANTITIES)
    with described.blaming():
        return table.says(Curve.from_dict(plain), plain)


def read_leader(table: Table, usual: str) -> Leader:
    """What the leader does; `usual` is how its path is laid where the file does not say."""
    table.only(*_LEADER)
    return Leader(
        path=read_curve(table, "path"),
        speed=table.above_zero("speed", "speed"),
        depth=table.above_zero("depth", "length", default=None),
        placement=table.text("placement", usual, ENTRIES),
        method=table.text("method", "closest", tuple(WINDOWS)),
        and_back=table.flag("and_back", False),
        pipe=table.above_zero("pipe", "length", default=None),
    )


def check_path(table: Table, leader: Leader, arm: Arm) -> None:
    """Refuse sizes that are beside all reason for the arm, and would take hours to find that out."""
    longest, narrowest = MOST * arm.length, arm.length / MOST
    if leader.path.length > longest:
        reason = f"is {leader.path.length:.4g} m long; allowed: {longest:.4g} m, {MOST} times the arm"
        raise table.fault("path", reason)
    if leader.pipe is not None and leader.pipe < narrowest:
        allowed = f"{narrowest:.4g} m or more, 1/{MOST} of the arm"
        raise table.fault("pipe", f"is {shown(table.value('pipe'))}; allowed: {allowed}")


# What can be seen to be wrong with a task before anything is searched for.

RESULT_FORMATS = ("npz", "csv", "json", "png", "html")
"""What may be kept of the result of a task."""

LONGEST_CYCLE = 60.0
"""The longest control cycle [s]."""

DESCRIBED = (Arm, Curve, EndEffector, Scene, *KINDS.values())
"""The parts of a task that a file may describe in several ways."""


def check_task(task: Task) -> None:
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
        allowed = "a mapping from an arm, curves, tips, a scene or obstacles to what a file says of them"
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


# What a task file says of an arm's limits, its controller, what surrounds it, and where it begins.

Array = NDArray[np.float64]

_SCENE = ("version", "obstacles", "self_collision", "margin", "arm_radius")
_LIMIT_QUANTITIES = dict.fromkeys(
    ("margin", "arm_radius", "radius", "center", "size", "start", "end", "point"), "length"
) | {"rotation": "angle"}

UNLIMITED = "none"
"""What stands in a file for a limit that does not exist."""

_NO_LIMIT = MappingProxyType({UNLIMITED: np.inf})


def read_limits(table: Table, arm: Arm) -> Limits:
    """The limits of each control cycle."""
    table.only("cycle", "step", "velocity", "acceleration", "position_margin")
    cycle = table.above_zero("cycle", "time", default=CYCLE)
    if cycle > LONGEST_CYCLE:
        raise table.fault("cycle", f"is {shown(table.value('cycle'))}; allowed: {LONGEST_CYCLE:g} s at most")
    values: dict[str, Any] = {
        "dt": cycle,
        "step": _for_joints(table, "step", arm, "angle", "length"),
        "position_margin": _for_all(table, "position_margin", arm, "a number, for all") or 0.0,
        "velocity": _for_joints(table, "velocity", arm, "rate of turning", "speed"),
        "acceleration": _for_joints(table, "acceleration", arm, "rate of change of turning", "acceleration"),
    }
    with table.blaming():
        limits = Limits(**values)
        limits.for_arm(arm)
    return limits


def _for_joints(table: Table, key: str, arm: Arm, turning: str, sliding: str) -> float | Array | None:
    """A limit for all joints, for those that turn and those that slide, or one for each."""
    value = table.value(key, None)
    if value == UNLIMITED:
        return np.inf
    if isinstance(value, list):
        kinds = [sliding if slides else turning for slides in arm.slides]
        return np.array(table.quantities(key, kinds, words=_NO_LIMIT))
    if not isinstance(value, dict):
        both = "a table with both, as in {turning = ..., sliding = ...}"
        return _for_all(table, key, arm, both, turning, sliding)
    given = table.table(key).only("turning", "sliding")
    limit = np.full(arm.nv, np.inf)
    for name, kind, joints in (("turning", turning, ~arm.slides), ("sliding", sliding, arm.slides)):
        if name in given:
            limit[joints] = given.above_zero(name, kind)
    if key == "velocity":  # what is not said is as the description has it
        limit = np.where(np.isinf(limit), arm.limits.velocity, limit)
    return limit


def _for_all(
    table: Table, key: str, arm: Arm, allowed: str, turning: str = "angle", sliding: str = "length"
) -> float | None:
    """One number for all joints; with a unit only if all of them turn or all of them slide."""
    value = table.value(key, None)
    if isinstance(value, str) and np.any(arm.slides) and not np.all(arm.slides):
        raise table.fault(key, f"is {shown(value)}, and the arm turns and slides; allowed: {allowed}")
    kind = sliding if np.all(arm.slides) else turning
    return cast("float | None", table.quantity(key, kind, default=None))


def read_controller(table: Table) -> Controller:
    """The controller, by name, with what only the qp knows."""
    table.only("name", "haste", "chord")
    name = table.text("name", "qp", tuple(CONTROLLERS))
    controller = controller_named(name)
    for key in ("haste", "chord"):
        if key in table:
            if not isinstance(controller, ConstrainedQP):
                raise table.fault(key, f"is for the controller 'qp'; it is {name!r}")
            number = table.number(key)
            with table.blaming(key):
                controller = replace(controller, **{key: number})
    return controller


def read_surroundings(table: Table, folder: Path) -> Scene | None:
    """The scene: a file of its own, or what would be in it."""
    if "file" in table:
        table.only("file")
        scene = table.file("file", Scene.load)
        return table.says(scene, {"file": table.place("file", table.text("file"))})
    if not table.plain():
        return None
    table.only("file", *_SCENE)
    listed = table.table("obstacles")
    obstacles = {name: read_obstacle(listed.table(name), folder) for name in listed.plain()}
    plain = table.in_si(_LIMIT_QUANTITIES) | {"obstacles": {}}
    with table.blaming():
        return replace(Scene.from_dict(plain), obstacles=obstacles)


def read_obstacle(table: Table, folder: Path) -> Obstacle:
    """An obstacle of the scene; the path of a mesh begins in the folder."""
    plain = table.in_si(_LIMIT_QUANTITIES)
    with table.blaming():
        obstacle = obstacle_from_dict(plain, str(folder))
    if "path" in plain:
        plain["path"] = settled(folder / plain["path"])
    return table.says(obstacle, plain)


def read_start(table: Table, arm: Arm) -> Array | None:
    """The configuration to start from; None for where the motion begins."""
    table.only("posture", "joints")
    if "joints" in table:
        if "posture" in table:
            raise table.fault("posture", "does not go with 'joints'")
        places = table.quantities("joints", ["length" if slides else "angle" for slides in arm.slides])
        with table.blaming("joints"):
            return arm.configuration(places)
    posture = table.text("posture", None, ("straight", "neutral"))
    if posture is None:
        return None
    return arm.straight() if posture == "straight" else arm.neutral()


# A whole task file: which tables it may have, and the parts of a task that they describe.

VERSION = 1
MOTION_KINDS = ("keyframes", "follow_leader")

_COMMON = ("version", "kind", "name", "arm", "limits", "controller", "scene", "start", "output", "editor")
_OWN = {"keyframes": ("keyframes", "continuity"), "follow_leader": ("leader",)}


def read_task(document: Document, arm: Arm | None = None) -> dict[str, Any]:
    """The parts of a task, by the names that `Task` has for them.

    Args:
        document: the file.
        arm: the arm, if what the file says of it is not to be read.

    Raises:
        FileError: what the file says cannot be; names the line, the key, the value and what is allowed.
    """
    root = document.root
    if "version" in root and (root.value("version") is True or root.value("version") != VERSION):
        raise root.fault("version", f"is {shown(root.value('version'))}; allowed: {VERSION}")
    kind = root.text("kind", "keyframes", MOTION_KINDS)
    for other in MOTION_KINDS:
        for key in _OWN[other]:
            if key in root and kind != other:
                raise root.fault(key, f"goes with kind = {other!r}; the kind is {kind!r}")
    root.only(*_COMMON, *_OWN[kind])
    arm = read_arm(root.table("arm")) if arm is None else arm
    scene = read_surroundings(root.table("scene"), document.path.parent)
    usual, motion = usual_placement(scene), None
    if kind == "follow_leader":
        motion = read_leader(root.table("leader"), usual)
    parts = {
        "arm": arm,
        "motion": read_keyframes(root.tables("keyframes"), usual, arm) if motion is None else motion,
        "limits": read_limits(root.table("limits"), arm),
        "controller": read_controller(root.table("controller")),
        "scene": scene,
        "start": read_start(root.table("start"), arm),
        "continuity": root.text("continuity", "velocity", CONTINUITIES),
        "formats": _formats(root.table("output")),
        "name": root.text("name", document.path.stem),
        "scans": _scans(root.table("editor")),
        "described": document.described,
    }
    _check(root, parts)
    return parts


def _check(root: Table, parts: dict[str, Any]) -> None:
    """Refuse what can be seen to be wrong without a search."""
    arm, motion, scene = parts["arm"], parts["motion"], parts["scene"]
    if isinstance(motion, Leader):
        check_path(root.table("leader"), motion, arm)
    else:
        if len(motion) < 2:
            found = "none" if not motion else "only one"
            reason = f"there is {found}; allowed: two or more, each begun by [[keyframes]]"
            raise root.fault("keyframes", reason)
        for keyframe, table in zip(motion, root.tables("keyframes"), strict=True):
            check_points(table, keyframe, arm)
    for name in around_base(scene, arm):
        raise root.table("scene").table("obstacles").fault(name, where_base_is(arm))


def _formats(table: Table) -> tuple[str, ...]:
    table.only("formats")
    listed = table.value("formats", list(RESULT_FORMATS))
    if not isinstance(listed, list) or not all(each in RESULT_FORMATS for each in listed):
        raise table.fault("formats", f"is {shown(listed)}; allowed: a list of {', '.join(RESULT_FORMATS)}")
    return tuple(each for each in RESULT_FORMATS if each in listed)


def _scans(table: Table) -> tuple[Path, ...]:
    """Files that the editor shows; whether they are there is its business."""
    table.only("scans")
    listed = table.value("scans", [])
    if not isinstance(listed, list):
        raise table.fault("scans", f"is {shown(listed)}; allowed: a list of files")
    for number, name in enumerate(listed):
        if not isinstance(name, str) or not name.strip() or "\0" in name:
            raise table.fault("scans", f"is {shown(name)}; allowed: the name of a file", number)
    return tuple(table.place("scans", name) for name in listed)
