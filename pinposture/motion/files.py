"""`save` and `load`: files of runs, motions, batches, simulations and joint trajectories."""

from __future__ import annotations

import io
import json
from collections.abc import Callable, Mapping, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple, TypeVar, overload
from zipfile import is_zipfile

import numpy as np
from numpy.typing import NDArray

from pinposture._validation import finite_vector, require_finite, require_known
from pinposture.arm import Arm
from pinposture.collision import Scene
from pinposture.control import Limits
from pinposture.curve import Curve
from pinposture.errors import FileError, InvalidValue
from pinposture.motion.batch import Batch
from pinposture.motion.joint_files import (
    check_format,
    read_ros_message,
    read_table,
    write_ros_message,
    write_table,
)
from pinposture.motion.joint_trajectory import JointTrajectory
from pinposture.motion.run import (
    CONFIGURATION_ARRAYS,
    ENDINGS,
    INFO,
    STEP_ARRAYS,
    Arrays,
    Run,
    info_of,
    run_arrays,
)
from pinposture.motion.trajectory import Trajectory, Waypoint
from pinposture.placement import Target
from pinposture.placement.target import Moved
from pinposture.storage import with_suffix, write_bytes
from pinposture.units import length_text

Result = TypeVar("Result")
About = dict[str, Any]


class Format(NamedTuple):
    """A format of `.npz` archives for results of one class: arrays, and a description in JSON.

    Attributes:
        name: the name of the format, stored in the archive.
        version: the version that is written and read.
        kind: the class.
        noun: name of the content, for messages.
        pack: returns the description and the arrays of a result.
        unpack: restores the result from them; may raise anything if they are damaged.
        advice: messages if another format is found instead, by its name.
    """

    name: str
    version: int
    kind: type
    noun: str
    pack: Callable[[Any], tuple[About, Arrays]]
    unpack: Callable[[About, Arrays], Any]
    advice: Mapping[str, str]


ARCHIVES: dict[str, Format] = {}
"""The formats by name; higher packages add theirs with `register`."""

_REGISTERED_BY = {"pinposture-simulation": "pinposture.sim"}
"""Packages that register formats on import."""

_MESSAGE = (write_ros_message, read_ros_message)
_TEXT_FILES = {".csv": (write_table, read_table), ".json": _MESSAGE, ".yaml": _MESSAGE, ".yml": _MESSAGE}
"""Writers and readers of the text formats of joint trajectories."""

_NOT_READ = {
    ".mcap": "is a bag, which is written and not read; export the motion as .npz, .csv or .json as well",
    ".toml": "is no result; tasks and scenes are read by pp.Task.load and pp.Scene.load",
}
"""Why files with these suffixes are not read, and what to do."""


def register(form: Format) -> None:
    """Add a format to those that `save` writes and `load` reads."""
    ARCHIVES[form.name] = form


def save(result: Any, path: str | Path) -> Path:
    """Write a result to a file atomically.

    A `Run`, `Trajectory`, `Batch` or `Simulation` is written as a `.npz` archive that includes the arm,
    the curves and the scene. The suffix selects the format of a `JointTrajectory`: ".npz" is lossless; ".csv"
    omits the name of the robot; ".json" is a ROS 2 `trajectory_msgs/msg/JointTrajectory`, with times in
    whole nanoseconds, as are ".yaml" and ".yml", with the same text.

    Args:
        result: the result.
        path: the file; ".npz" is added to a name without suffix, except for a `JointTrajectory`.

    Returns:
        The path written.

    Raises:
        FileError: another suffix, or the file cannot be written.
        InvalidValue: not a result, or times out of range for a ROS 2 message.
    """
    form = _format_of(type(result), "result", result)
    if isinstance(result, JointTrajectory):
        path = Path(path)
        suffix = check_format(path)
        if suffix in _TEXT_FILES:
            _TEXT_FILES[suffix][0](result, path)
            return path
    else:
        path = with_suffix(Path(path), ".npz", hint="; for other formats, save its `joint_trajectory()`")
    about, arrays = form.pack(result)
    content = io.BytesIO()
    described = json.dumps({"format": form.name, "version": form.version, **about})
    stored: dict[str, Any] = {"about": np.array(described), **arrays}
    np.savez_compressed(content, **stored)
    write_bytes(path, content.getvalue())
    return path


@overload
def load(path: str | Path) -> Any: ...


@overload
def load(path: str | Path, kind: type[Result]) -> Result: ...


def load(path: str | Path, kind: type[Any] | None = None) -> Any:
    """Read a result that `save` wrote, or a joint trajectory from another source.

    Missing velocities and accelerations of a joint trajectory are computed from positions;
    `JointTrajectory.matched(arm)` sorts its joints in the order of an arm.

    Args:
        path: the file.
        kind: the expected class: `Run`, `Trajectory`, `Batch`, `Simulation` or `JointTrajectory`; any if
            None.

    Raises:
        FileError: the file is missing, damaged, or contains something else; names line or point of a text
            file.
        InvalidValue: another class.
    """
    path = Path(path)
    wanted = None if kind is None else _format_of(kind, "kind", kind)
    suffix = check_format(path) if kind is JointTrajectory else path.suffix.lower()
    if kind in (None, JointTrajectory) and suffix in _TEXT_FILES:
        return _TEXT_FILES[suffix][1](path)
    if not path.is_file():
        raise FileError(path, "is a directory; name a file in it" if path.is_dir() else "no such file")
    if suffix in _NOT_READ:
        raise FileError(path, _NOT_READ[suffix])
    if wanted is not None and suffix in _TEXT_FILES:
        advice = "`pp.load(path)` reads joint trajectories, `pinposture simulate` performs them"
        raise FileError(path, f"is not a saved {wanted.noun}; {advice}")
    try:
        with np.load(path, allow_pickle=False) as stored:
            arrays = {name: stored[name] for name in stored.files}
        about = json.loads(str(arrays["about"]))
        found = about["format"]
        version = about["version"]
        wanted = _format_named(found) if wanted is None else wanted
        if wanted is None or (found, version) != (wanted.name, wanted.version):
            known = ARCHIVES.values() if wanted is None else (wanted,)
            allowed = ", ".join(f"{form.name!r} version {form.version}" for form in known)
            text = f"format {found!r} version {version}; allowed: {allowed}"
            raise FileError(path, text if wanted is None else wanted.advice.get(found, text))
        return wanted.unpack(about, arrays)
    except FileError:
        raise
    except Exception as error:  # a damaged file can raise anything: zlib, numpy, Pinocchio
        detail = f"{type(error).__name__}: {error}"
        if isinstance(error, ValueError) and "pickle" in str(error):  # numpy advises to allow pickles
            detail = "ValueError" if is_zipfile(path) else "it is no .npz archive"
        noun = "result" if wanted is None else wanted.noun
        raise FileError(path, f"is not a saved {noun} ({detail})") from error


def kind_of(path: Path) -> type | None:
    """Return the class of the result in a file, by its suffix or description; None if unknown."""
    if path.suffix.lower() in _TEXT_FILES:
        return JointTrajectory
    try:
        with np.load(path, allow_pickle=False) as stored:
            form = _format_named(json.loads(str(stored["about"]))["format"])
    except Exception:  # as above; `load` reports the error
        return None
    return None if form is None else form.kind


def _format_named(name: str) -> Format | None:
    """Return the format of a name, importing the package that registers it; None if there is none."""
    if name not in ARCHIVES and name in _REGISTERED_BY:
        import_module(_REGISTERED_BY[name])
    return ARCHIVES.get(name)


def _format_of(kind: type, name: str, value: object) -> Format:
    """Return the format of a class; raise InvalidValue for the argument `name` if there is none."""
    for form in ARCHIVES.values():
        if form.kind is kind:
            return form
    allowed = ", ".join(form.kind.__name__ for form in ARCHIVES.values())
    hint = "; curves, scenes and tasks have their own `save` and `load`"
    raise InvalidValue(name, value, f"{allowed} or Simulation{hint}")


# Parts that several formats share.

_LIMITS_ARRAYS = ("step", "velocity", "acceleration", "jerk")
_TARGET_ARRAYS = ("points", "weights", "q", "parameters", "residual")


def _pack_limits(limits: Limits) -> tuple[About, Arrays]:
    given = {name: getattr(limits, name) for name in _LIMITS_ARRAYS}
    arrays = {f"limits_{name}": np.asarray(value) for name, value in given.items() if value is not None}
    return {"dt": limits.dt, "position_margin": limits.position_margin}, arrays


def _unpack_limits(about: About, arrays: Arrays) -> Limits:
    stored = {name: arrays.get(f"limits_{name}") for name in _LIMITS_ARRAYS}
    values: dict[str, Any] = {
        name: value if value is None or value.ndim else float(value) for name, value in stored.items()
    }
    return Limits(**values, dt=about["dt"], position_margin=about["position_margin"])


def _unpack_moved(data: list[list[float]] | None) -> Moved | None:
    """Return how a curve was moved, from JSON data."""
    if data is None:
        return None
    translation, rotation = (finite_vector("moved", each, 3).tolist() for each in data)
    return Moved(tuple(translation), tuple(rotation))


_TEXTS = frozenset({"status", "reason", "closest", "violated_constraints"})
_FLAGS = frozenset({"active", "clipped", "error_increasing", "motion_target_mask"})

COMPARED_ROWS = 500
"""Rows of a loaded run whose control points are compared with its configurations, at most."""

SAME_POINTS = 1e-6
"""Largest difference of control points that counts as rounding, in arm lengths."""


def check_arrays(arrays: Mapping[str, NDArray[Any]], shapes: Mapping[str, tuple[int, ...]]) -> None:
    """Raise InvalidValue unless arrays have the expected shapes and types.

    Args:
        arrays: the arrays, by name.
        shapes: the shapes that some of them must have.
    """
    for name, expected in shapes.items():
        array = arrays[name]
        if array.shape != expected:
            raise InvalidValue(f"{name} (shape)", array.shape, str(expected))
        kinds = "biuf"
        allowed = "numbers"
        if name in _FLAGS:
            kinds = "b"
            allowed = "True or False"
        elif name in _TEXTS:
            kinds = "U"
            allowed = "text"
        if array.dtype.kind not in kinds:
            raise InvalidValue(f"{name} (type)", str(array.dtype), allowed)


def check_postures(
    arm: Arm, arrays: Mapping[str, NDArray[Any]], configurations: str = "q", points: str = "points"
) -> None:
    """Raise InvalidValue unless control points are those of configurations; both are named among arrays."""
    for name in (configurations, points):
        require_finite(name, arrays[name])
    q = arrays[configurations]
    rows = np.unique(np.linspace(0, len(q) - 1, COMPARED_ROWS).round().astype(np.intp))
    for row in rows:
        expected = arm.at(arm.checked(q[row], f"{configurations}[{row}]")).points
        off = float(np.abs(expected - arrays[points][row]).max())
        if off > SAME_POINTS * arm.length:
            allowed = "those of the configuration in this row"
            raise InvalidValue(f"{points}[{row}]", f"{length_text(off)} off", allowed)


# Runs.

_RUN_ARRAYS = (*CONFIGURATION_ARRAYS, "points", "point_errors", *STEP_ARRAYS)


def _pack_run(run: Run) -> tuple[About, Arrays]:
    about, arrays = _pack_limits(run.limits)
    arrays |= run_arrays(run) | {"points": run.points, "point_errors": run.point_errors}
    for name in _TARGET_ARRAYS:
        value = getattr(run.target, name)
        if value is not None:
            arrays[f"target_{name}"] = value
    about |= {
        "arm": run.arm.to_dict(),
        "curve": None if run.target.curve is None else run.target.curve.to_dict(),
        "method": run.target.method,
        "incomplete": run.target.incomplete,
        "moved": run.target.moved,
        "approximate": run.target.approximate,
        "controller": run.controller,
        "scene": None if run.scene is None else run.scene.to_dict(),
        "status": run.status,
        "reason": run.reason,
    }
    return about, arrays


def _unpack_run(about: About, arrays: Arrays) -> Run:
    target: dict[str, Any] = {name: arrays.get(f"target_{name}") for name in _TARGET_ARRAYS}
    arm = Arm.from_dict(about["arm"])
    steps = len(arrays["active"])
    m = arm.n_modules
    shapes = {
        "q": (steps + 1, arm.nq),
        "points": (steps + 1, m, 3),
        "point_errors": (steps + 1, m),
        "clearance": (steps + 1,),
        "active": (steps, m),
        "clipped": (steps, arm.nv),
    }
    check_arrays(arrays, {name: shapes.get(name, (steps,)) for name in _RUN_ARRAYS})
    _check_info(arrays, steps)
    check_arrays(arrays, {"target_points": (m, 3), "target_weights": (m,)})
    check_postures(arm, arrays)
    require_finite("point_errors", arrays["point_errors"])
    require_known("status", about["status"], ENDINGS)
    return Run(
        arm=arm,
        target=Target(
            **target,
            curve=None if about["curve"] is None else Curve.from_dict(about["curve"]),
            method=about["method"],
            incomplete=about["incomplete"],
            moved=_unpack_moved(about.get("moved")),
            approximate=about.get("approximate", ""),  # missing in files of older versions
        ),
        limits=_unpack_limits(about, arrays),
        scene=None if about["scene"] is None else Scene.from_dict(about["scene"]),
        controller=about["controller"],
        status=about["status"],
        reason=about["reason"],
        info=info_of(arrays),
        **{name: arrays[name] for name in _RUN_ARRAYS},
    )


def _check_info(arrays: Mapping[str, NDArray[Any]], steps: int) -> None:
    """Raise InvalidValue unless each array of `Run.info` has a row of numbers or texts per step."""
    for name, column in arrays.items():
        if name.startswith(INFO) and (column.shape[:1] != (steps,) or column.dtype.kind not in "biufU"):
            found = f"{column.dtype} {column.shape}"
            raise InvalidValue(name, found, f"{steps} rows of numbers or texts")


# Motions.

_TIMED_ARRAYS = ("targets", "target_mask", "plan_time")


def _pack_motion(motion: Trajectory) -> tuple[About, Arrays]:
    about, arrays = _pack_run(motion.run)
    about["motion"] = {
        "start_index": motion.start_index,
        "planned": motion.planned,
        "waypoints": [list(place) for place in motion.waypoints],
        "deviations": list(motion.deviations),
    }
    return about, arrays | {f"motion_{name}": getattr(motion, name) for name in _TIMED_ARRAYS}


def _unpack_motion(about: About, arrays: Arrays) -> Trajectory:
    run = _unpack_run(about, arrays)
    timed = about["motion"]
    if run.limits.dt is None:
        raise InvalidValue("dt", None, "the duration of a cycle")
    rows = run.steps + 1
    m = run.arm.n_modules
    check_arrays(
        arrays, {"motion_targets": (rows, m, 3), "motion_target_mask": (rows, m), "motion_plan_time": (rows,)}
    )
    return Trajectory(
        run=run,
        **{name: arrays[f"motion_{name}"] for name in _TIMED_ARRAYS},
        start_index=timed["start_index"],
        planned=timed["planned"],
        waypoints=tuple(
            Waypoint(*place)._replace(moved=_unpack_moved(place[7] if len(place) > 7 else None))
            for place in timed["waypoints"]
        ),
        deviations=tuple(timed["deviations"]),
    )


# Batches.

_BATCH_ARRAYS = (
    "status",
    "reason",
    "steps",
    "start_error",
    "final_error",
    "mean_error",
    "path_length_ratio",
    "clearance",
    "closest",
    "q_start",
    "q_final",
)


def _pack_batch(batch: Batch) -> tuple[About, Arrays]:
    about, arrays = _pack_limits(batch.limits)
    arrays |= {name: getattr(batch, name) for name in _BATCH_ARRAYS}
    target_arrays, about_targets = _pack_targets(batch.targets)
    arrays |= target_arrays
    if batch.motions is not None:
        arrays |= _pack_motions(batch.motions)
    about |= {
        "arm": batch.arm.to_dict(),
        "targets": about_targets,
        "controller": batch.controller,
        "scene": None if batch.scene is None else batch.scene.to_dict(),
        "max_steps": batch.max_steps,
        "tolerance": batch.tolerance,
        "motions": batch.motions is not None,
    }
    return about, arrays


def _unpack_batch(about: About, arrays: Arrays) -> Batch:
    columns: dict[str, Any] = {name: arrays[name] for name in _BATCH_ARRAYS}
    batch = Batch(
        arm=Arm.from_dict(about["arm"]),
        targets=_unpack_targets(arrays, about["targets"]),
        controller=about["controller"],
        limits=_unpack_limits(about, arrays),
        scene=None if about["scene"] is None else Scene.from_dict(about["scene"]),
        max_steps=about["max_steps"],
        tolerance=about["tolerance"],
        motions=_unpack_motions(arrays) if about["motions"] else None,
        **columns,
    )
    _check_batch(batch)
    return batch


def _pack_motions(motions: Sequence[Arrays]) -> Arrays:
    """Return the arrays of runs end to end, and which runs have each; texts once, and their numbers."""
    sizes = [len(run["q"]) for run in motions]
    arrays: Arrays = {"motion_offsets": np.concatenate([[0], np.cumsum(sizes)]).astype(np.intp)}
    for name in dict.fromkeys(name for run in motions for name in run):
        parts = [run[name] for run in motions if name in run]
        if any(part.dtype.kind == "U" for part in parts):
            # An array of texts would be as wide as the longest; nearly all are empty or repeated.
            numbers: dict[str, int] = {}
            parts = [
                np.array(
                    [numbers.setdefault(str(text), len(numbers)) for text in part.flat], dtype=np.intp
                ).reshape(part.shape)
                for part in parts
            ]
            arrays[f"texts_{name}"] = np.array(list(numbers), dtype=np.str_)
        arrays[f"motion_{name}"] = np.concatenate(parts)
        arrays[f"motion_has_{name}"] = np.array([name in run for run in motions])
    return arrays


def _unpack_motions(arrays: Arrays) -> tuple[Arrays, ...]:
    """Return the arrays of each run from the result of `_pack_motions`."""
    offsets = arrays["motion_offsets"]
    sizes = np.diff(offsets)
    motions: tuple[Arrays, ...] = tuple({} for _ in sizes)
    for key in arrays:
        if not key.startswith("motion_has_"):
            continue
        name = key.removeprefix("motion_has_")
        has = arrays[key]
        values = arrays[f"motion_{name}"]
        texts = arrays.get(f"texts_{name}")
        if has.shape != sizes.shape:
            raise InvalidValue(key, has.shape, f"True or False for each of {len(sizes)} runs")
        rows = np.where(has, sizes - (name not in CONFIGURATION_ARRAYS), 0)
        if rows.min(initial=0) < 0 or len(values) != rows.sum():
            raise InvalidValue("offsets", offsets, f"those of runs with {len(values)} rows of {name}")
        if texts is not None:
            if np.any((values < 0) | (values >= len(texts))):
                raise InvalidValue(name, values, f"numbers of texts from 0 to {len(texts) - 1}")
            values = texts[values]
        ends = np.cumsum(rows)
        for run, has_it, end, count in zip(motions, has, ends, rows, strict=True):
            if has_it:
                run[name] = values[end - count : end]
    return motions


def _pack_targets(targets: Sequence[Target]) -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
    """Return targets as arrays, with a row for each value that is not None, and other data for JSON."""
    arrays: dict[str, NDArray[Any]] = {}
    for name in _TARGET_ARRAYS:
        values = [getattr(target, name) for target in targets]
        arrays[f"has_{name}"] = np.array([value is not None for value in values])
        known = [value for value in values if value is not None]
        if known:
            arrays[f"target_{name}"] = np.array(known)
    curves: dict[str, int] = {}
    places = []
    for target in targets:
        text = json.dumps(None if target.curve is None else target.curve.to_dict())
        places.append(curves.setdefault(text, len(curves)))
    about = {
        "curves": [json.loads(text) for text in curves],
        "curve": places,
        "method": [target.method for target in targets],
        "incomplete": [target.incomplete for target in targets],
        "moved": [target.moved for target in targets],
        "approximate": [target.approximate for target in targets],
    }
    return arrays, about


def _unpack_targets(arrays: dict[str, NDArray[Any]], about: dict[str, Any]) -> tuple[Target, ...]:
    """Return the targets from the result of `_pack_targets`."""
    curves = [None if described is None else Curve.from_dict(described) for described in about["curves"]]
    columns: dict[str, list[Any]] = {}
    for name in _TARGET_ARRAYS:
        rows = iter(arrays.get(f"target_{name}", ()))
        columns[name] = [next(rows) if known else None for known in arrays[f"has_{name}"]]
    count = len(about["curve"])  # `moved` and `approximate` are missing in files of older versions
    moved = map(_unpack_moved, about.get("moved", [None] * count))
    close = about.get("approximate", [""] * count)
    others = zip(about["curve"], about["method"], about["incomplete"], moved, close, strict=True)
    return tuple(
        Target(
            **dict(zip(columns, values, strict=True)),
            curve=curves[curve],
            method=method,
            incomplete=incomplete,
            moved=way,
            approximate=approximate,
        )
        for values, (curve, method, incomplete, way, approximate) in zip(
            zip(*columns.values(), strict=True), others, strict=True
        )
    )


def _check_batch(batch: Batch) -> None:
    """Raise InvalidValue unless the arrays of a batch are consistent with each other and the arm."""
    arm = batch.arm
    count = len(batch.status)
    if count == 0 or len(batch.targets) not in (1, count):
        numbers = (len(batch.targets), count)
        raise InvalidValue("numbers of targets and runs", numbers, "as many, or one target")
    for target in batch.targets:
        target.check(arm)
    ends = {"q_start": (count, arm.nq), "q_final": (count, arm.nq)}
    check_arrays(vars(batch), {name: ends.get(name, (count,)) for name in _BATCH_ARRAYS})
    for name in ("start_error", "final_error", "mean_error", "path_length_ratio", "q_start", "q_final"):
        require_finite(name, getattr(batch, name))
    motions = batch.motions
    if motions is None:
        return
    if len(motions) != count:
        raise InvalidValue("numbers of motions and runs", (len(motions), count), "as many")
    for arrays, steps in zip(motions, batch.steps.tolist(), strict=True):
        shapes: dict[str, tuple[int, ...]] = {name: (steps,) for name in STEP_ARRAYS}
        shapes |= {"q": (steps + 1, arm.nq), "clearance": (steps + 1,)}
        shapes |= {"active": (steps, arm.n_modules), "clipped": (steps, arm.nv)}
        check_arrays(arrays, shapes)
        require_finite("q", arrays["q"])
        _check_info(arrays, steps)


# Joint trajectories as arrays, exact to the last bit.

_JOINT_ARRAYS = ("time", "positions", "velocities", "accelerations")


def _pack_joints(trajectory: JointTrajectory) -> tuple[About, Arrays]:
    names = (*_JOINT_ARRAYS, "joint_names", "units")
    return {"name": trajectory.name}, {name: np.asarray(getattr(trajectory, name)) for name in names}


def _unpack_joints(about: About, arrays: Arrays) -> JointTrajectory:
    values: dict[str, Any] = {name: arrays[name] for name in _JOINT_ARRAYS}
    values |= {name: tuple(arrays[name].tolist()) for name in ("joint_names", "units")}
    return JointTrajectory(**values, name=about["name"])


_NO_RUN = {
    "pinposture-batch": "contains many runs; save one of them: pp.save(pp.load(file)[0], ...)",
    "pinposture-motion": "contains a motion in time; its run is pp.load(file).run",
}
_NO_MOTION = {
    "pinposture-run": "contains a run without times; pp.load(file) returns it as a Run",
    "pinposture-batch": "contains many runs; pp.load(file) returns them as a Batch",
}
_JOINTS = "pinposture-joint-trajectory"
register(Format("pinposture-run", 6, Run, "run", _pack_run, _unpack_run, _NO_RUN))
register(Format("pinposture-motion", 4, Trajectory, "motion", _pack_motion, _unpack_motion, _NO_MOTION))
register(Format("pinposture-batch", 5, Batch, "batch", _pack_batch, _unpack_batch, {}))
register(Format(_JOINTS, 1, JointTrajectory, "joint trajectory", _pack_joints, _unpack_joints, {}))
