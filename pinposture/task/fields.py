"""How task files give curves, scenes, joint positions, the controller, the start, and files."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, cast

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationInfo

from pinposture._validation import finite_vector, known_keys
from pinposture.arm import Arm
from pinposture.collision import Mesh, Scan, Scene
from pinposture.collision.obstacles import Obstacle, obstacle_from_dict
from pinposture.control import CONTROLLERS, Controller, Geodesic, controller_named
from pinposture.curve import CURVES, Curve
from pinposture.errors import FileError, PostureError, did_you_mean
from pinposture.schema import (
    AnyLength,
    InputFile,
    NotAllowed,
    Number,
    OutputFile,
    Refusal,
    WrittenBy,
    in_file,
    in_si,
    is_file_name,
    is_list_of,
    is_table,
    read_by,
    read_keys,
    read_part,
    read_quantities,
    read_within,
    read_word,
    refusing,
    shown,
)
from pinposture.storage import settled

Array = NDArray[np.float64]


# Curves.

_CURVE_UNITS = dict.fromkeys(("radius", "pitch", "smoothing", "a", "b", "center"), "length") | {
    "phase": "angle"
}


def _read_curve(value: object, info: ValidationInfo) -> Curve:
    """Read a curve: a preset, a file, or a description as for `Curve.from_dict`."""
    source = in_file(info)
    if isinstance(value, Curve):
        return value
    if source is None:
        raise NotAllowed(value, "a Curve")
    description: object = value
    if isinstance(value, str) and (value in CURVES or not Path(value).suffix):
        if value not in CURVES:
            allowed = f"{', '.join(CURVES)}, a .json, .csv or .txt file, or a table with a type"
            raise NotAllowed(value, allowed, hint=did_you_mean(value, CURVES))
        curve = CURVES[value]
    elif isinstance(value, str):
        path = source.resolve(value)
        with refusing():
            curve = Curve.load(path)
        description = settled(path)
    elif not isinstance(value, Mapping):
        raise NotAllowed(value, "a name, a file, or a table with a type")
    elif "path" in value:
        curve, description = _read_curve_file(value, source)
    else:
        description = in_si(value, _CURVE_UNITS)
        with refusing(value):
            curve = Curve.from_dict(description)
    source.described[curve] = description
    return curve


def _read_curve_file(value: Mapping[str, Any], source: InputFile) -> tuple[Curve, dict[str, Any]]:
    if not is_file_name(value["path"]):
        raise NotAllowed(value["path"], "the name of a file as path")
    path = read_within("path", source.resolve, value["path"])
    with refusing(value):
        known_keys("a curve file", value, ("path", "scale"))
        curve = Curve.load(path, value.get("scale", 1.0))
    return curve, {**value, "path": settled(path)}


def _write_curve(curve: Curve, file: OutputFile) -> object:
    return file.find(curve, CurveField) or describe_curve(curve)


def describe_curve(curve: Curve) -> dict[str, Any]:
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


CurveField = Annotated[Curve, read_by(_read_curve), WrittenBy(_write_curve)]

# Scenes and obstacles.

_OBSTACLE_UNITS = dict.fromkeys(
    ("radius", "point_radius", "outlier_distance", "center", "size", "start", "end", "point"), "length"
) | {"rotation": "angle"}


def _read_obstacle(value: object, info: ValidationInfo) -> Obstacle:
    """Read an obstacle as `Scene.from_dict` takes it; the path of a mesh or scan is relative to the file."""
    if not isinstance(value, Mapping):
        raise NotAllowed(value, "a table")
    source = cast(InputFile, in_file(info))
    table = in_si(value, _OBSTACLE_UNITS)
    folder = source.resolve("")
    with refusing(value):
        obstacle = obstacle_from_dict(table, str(folder))
    path = {"path": settled(folder / table["path"])} if "path" in table else {}
    source.described[obstacle] = table | path
    return obstacle


def _write_obstacle(obstacle: Obstacle, file: OutputFile) -> dict[str, Any]:
    """Describe an obstacle, without a rotation, centre or scale that has no effect."""
    known: dict[str, Any] | None = file.find(obstacle, ObstacleField)
    if known is not None:
        return known
    table = obstacle.to_dict(embed=False)
    if table.get("rotation") == np.eye(3).tolist():
        del table["rotation"]
    if isinstance(obstacle, Mesh | Scan) and not any(obstacle.center):
        del table["center"]
    if "path" in table:
        table["path"] = Path(table["path"])
        table = {key: value for key, value in table.items() if (key, value) != ("scale", 1.0)}
    return table


ObstacleField = Annotated[Any, read_by(_read_obstacle)]

_OF_A_SCENE = ("file", "version", "obstacles", "self_collision", "margin", "arm_radius")


def _read_scene(value: object, info: ValidationInfo) -> Scene | None:
    """Read a scene: a file, or the content of one; None for an empty table."""
    source = in_file(info)
    if value is None or isinstance(value, Scene):
        return value
    if source is None:
        raise NotAllowed(value, "a Scene, or None")
    if isinstance(value, Mapping) and "file" in value:
        return _read_scene_file(value, source)
    table = read_keys(value, _OF_A_SCENE)
    if not table:
        return None
    listed = table.get("obstacles", {})
    if not is_table(listed):
        raise NotAllowed(listed, "a table", "obstacles")
    obstacles = read_part("obstacles", dict[str, ObstacleField], listed, source)
    lengths = {
        key: read_part(key, AnyLength, table[key], source) for key in ("margin", "arm_radius") if key in table
    }
    with refusing(table):
        return replace(Scene.from_dict({**table, **lengths, "obstacles": {}}), obstacles=obstacles)


def _read_scene_file(table: Mapping[str, Any], source: InputFile) -> Scene:
    for key in table:
        if key != "file":
            raise Refusal("there is no such key; allowed: file", key)
    name = table["file"]
    if not isinstance(name, str):
        raise NotAllowed(name, "text", "file")
    path = read_within("file", source.resolve, name)
    with refusing(key="file"):
        scene = Scene.load(path)
    source.described[scene] = {"file": settled(path)}
    return scene


def write_scene(scene: Scene, file: OutputFile) -> dict[str, Any]:
    """Return the table of a scene: its file, or its content."""
    known: dict[str, Any] | None = file.find(scene, SceneField)
    if known is not None:
        return known
    table: dict[str, Any] = {"margin": scene.margin}
    if not scene.self_collision:
        table["self_collision"] = False
    if scene.arm_radius is not None:
        table["arm_radius"] = scene.arm_radius
    if scene.obstacles:
        table["obstacles"] = {name: _write_obstacle(each, file) for name, each in scene.obstacles.items()}
    return table


SceneField = Annotated[Any, read_by(_read_scene)]

# Joint positions and the start.


def joint_count_misfit(arm: Arm, count: int) -> str:
    """Return the message on a wrong number of joint positions."""
    unit = "rad, m for joints that slide" if np.any(arm.slides) else "rad"
    return f"has {count} value{'s' * (count != 1)}; needed: {arm.nv}, one for each joint [{unit}]"


def read_joints(value: object, arm: Arm) -> tuple[float, ...]:
    """Read the positions of the joints of an arm."""
    if isinstance(value, list) and len(value) != arm.nv:
        raise Refusal(joint_count_misfit(arm, len(value)))
    return read_quantities(value, ["length" if slides else "angle" for slides in arm.slides])


def _read_joints_of_any_arm(value: Any, info: ValidationInfo) -> tuple[float, ...]:
    """Read joint positions; with a curve they may be those of another arm, and are then ignored later."""
    source = in_file(info)
    if source is None:
        with refusing():
            return tuple(finite_vector("joints", value, np.size(value)).tolist())
    arm = source.arm
    if info.data.get("curve") is None or not isinstance(value, list) or len(value) in (0, arm.nv):
        return read_joints(value, arm)
    return read_quantities(value, ["angle"] * len(value))


Joints = Annotated[tuple[float, ...], read_by(_read_joints_of_any_arm)]


def read_start(value: object, info: ValidationInfo) -> Array | None:
    """Read the configuration to start from, (nq,)."""
    table = read_keys(value, ("posture", "joints"))
    if "joints" in table and "posture" in table:
        raise Refusal("does not go with 'joints'", "posture")
    arm: Arm = cast(InputFile, in_file(info)).arm
    if "joints" in table:
        positions = read_within("joints", read_joints, table["joints"], arm)
        with refusing(key="joints"):
            found: Array = arm.checked_start(arm.configuration(positions), "start")
            return found
    if "posture" not in table:
        return None
    posture = read_within("posture", read_word, table["posture"], ("straight", "neutral"))
    return arm.straight() if posture == "straight" else arm.neutral()


def write_start(start: Array, arm: Arm) -> dict[str, Any]:
    """Return the table of the configuration to start from."""
    if np.array_equal(start, arm.straight()):
        return {"posture": "straight"}
    if np.array_equal(start, arm.neutral()):
        return {"posture": "neutral"}
    return {"joints": arm.positions(start)}


# The controller, by name, with the parameters of "geodesic".

_WEIGHTS = ("joint_weight", "relative_position_weight")


def read_controller(value: object, info: ValidationInfo) -> Controller:
    """Read the controller."""
    table = read_keys(value, ("name", *_WEIGHTS))
    name = read_within("name", read_word, table.get("name", "geodesic"), CONTROLLERS)
    controller = controller_named(name)
    for key in _WEIGHTS:
        if key not in table:
            continue
        number = read_part(key, Number, table[key], cast(InputFile, in_file(info)))
        if not isinstance(controller, Geodesic):
            raise Refusal(f"is for the controller 'geodesic'; it is {name!r}", key)
        with refusing(table, key):
            controller = replace(controller, **{key: number})
    return controller


def write_controller(controller: Controller, file: Path) -> dict[str, Any]:
    """Return the table of the controller; an empty one for the default.

    Raises:
        FileError: it has parameters that a file cannot represent.
    """
    if isinstance(controller, Geodesic):
        own = {key: getattr(controller, key) for key in _WEIGHTS}
        if replace(Geodesic(), **own) == controller:
            own = {key: value for key, value in own.items() if value != getattr(Geodesic(), key)}
            return {"name": "geodesic", **own} if own else {}
    for name, make in CONTROLLERS.items():
        if make() == controller:
            return {"name": name}
    allowed = "a name with its usual parameters; joint_weight and relative_position_weight for 'geodesic'"
    raise FileError(file, f"controller: a file cannot represent {shown(controller)}; allowed: {allowed}")


# Files.

RESULT_FORMATS = ("npz", "csv", "json", "png", "html")
"""Formats in which the result of a task can be saved."""


def read_formats(value: object, _: ValidationInfo) -> tuple[str, ...]:
    """Read the formats in which to save the result."""
    given = read_keys(value, ("formats",)).get("formats", RESULT_FORMATS)
    if not is_list_of(lambda each: each in RESULT_FORMATS)(given):
        raise NotAllowed(given, f"a list of {', '.join(RESULT_FORMATS)}", "formats")
    return tuple(each for each in RESULT_FORMATS if each in given)


def read_scans(value: object, info: ValidationInfo) -> tuple[Path, ...]:
    """Read the files that the editor shows; they need not exist."""
    given = read_keys(value, ("scans",)).get("scans", [])
    if not isinstance(given, list):
        raise NotAllowed(given, "a list of files", "scans")
    for index, name in enumerate(given):
        if not is_file_name(name):
            raise NotAllowed(name, "the name of a file", "scans", index)
    source = cast(InputFile, in_file(info))
    return tuple(settled(read_within("scans", source.resolve, name)) for name in given)
