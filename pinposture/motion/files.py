"""`save` and `load`: files of runs, motions, batches, simulations, grips and joint trajectories."""

from __future__ import annotations

import io
import json
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import fields, is_dataclass
from functools import cache
from importlib import import_module
from pathlib import Path
from types import MappingProxyType, UnionType
from typing import Any, NamedTuple, TypeVar, Union, cast, get_args, get_origin, get_type_hints, overload
from zipfile import is_zipfile

import numpy as np
from numpy.typing import NDArray

from pinposture._validation import require_finite, require_known
from pinposture.arm import Arm
from pinposture.collision import Map, MapContent
from pinposture.curve import Curve
from pinposture.errors import FileError, InvalidValue
from pinposture.motion.batch import Batch
from pinposture.motion.joint_files import check_format, read_table, write_table
from pinposture.motion.joint_trajectory import JointTrajectory
from pinposture.motion.ros import read_ros_message, write_ros_message
from pinposture.motion.run import (
    CONFIGURATION_ARRAYS,
    ENDINGS,
    STEP_ARRAYS,
    Arrays,
    Run,
    info_of,
)
from pinposture.motion.trajectory import Trajectory
from pinposture.placement import Target
from pinposture.schema import Declared, as_plain, read_plain
from pinposture.storage import with_suffix, write_bytes
from pinposture.units import CONVERGED, length_text

Result = TypeVar("Result")
About = dict[str, Any]


# Archives: the arrays of a result by the names of its fields, and everything else in JSON.
#
# A part of a result that has arrays itself, such as its target, is spread: its arrays have its name as a
# prefix, and its other fields are among those of the result. Other parts are described under their names.


def pack(result: Any, prefix: str = "", without: Collection[str] = ()) -> tuple[About, Arrays]:
    """Return the description and the arrays of a result.

    Args:
        result: the result, or a part of it.
        prefix: what the names of its arrays begin with.
        without: fields that are packed otherwise.
    """
    about: About = {}
    arrays: Arrays = {}
    for name, kinds in _fields(cast(type, type(result))).items():
        value = getattr(result, name)
        if name in without:
            continue
        if _is_array(kinds):
            if value is not None:
                arrays[f"{prefix}{name}"] = np.asarray(value)
        elif isinstance(value, Mapping):
            arrays |= {f"{prefix}{name}_{key}": column for key, column in value.items()}
        elif hasattr(value, "to_dict"):
            about[name] = value.to_dict()
        elif isinstance(value, tuple) and any(isinstance(entry, Declared) for entry in value):
            about[name] = [as_plain(entry) for entry in value]
        elif not is_dataclass(value):
            about[name] = value
        elif _has_arrays(type(value)):
            described, own = pack(value, f"{prefix}{name}_")
            about |= described
            arrays |= own
        else:
            about[name] = vars(value)
    return about, arrays


def unpack(
    kind: type, about: About, arrays: Arrays, prefix: str = "", without: Collection[str] = ()
) -> dict[str, Any]:
    """Return the fields of a result of a class from the output of `pack`; those without a value are missing.

    Raises:
        InvalidValue: a value that does not fit its field.
        KeyError: an array or a part that is missing.
    """
    values: dict[str, Any] = {}
    for name, kinds in _fields(kind).items():
        stored = f"{prefix}{name}"
        part = next(
            (option for option in kinds if hasattr(option, "from_dict") or is_dataclass(option)), None
        )
        if name in without:
            continue
        if part is not None and name in about and about[name] is None:
            values[name] = None
        elif _is_array(kinds):
            array = arrays.get(stored) if type(None) in kinds else arrays[stored]
            values[name] = array if array is None or array.ndim else array.item()
        elif get_origin(kinds[0]) is Mapping:
            start = f"{stored}_"
            values[name] = {
                key.removeprefix(start): array for key, array in arrays.items() if key.startswith(start)
            }
        elif part is None:
            if name in about:
                values[name] = read_plain(_hints(kind)[name], about[name], name, folder=".")
        elif hasattr(part, "from_dict"):
            values[name] = part.from_dict(about[name])
        elif _has_arrays(part):
            values[name] = part(**unpack(part, about, arrays, f"{stored}_"))
        else:
            values[name] = part(**about[name])
    return values


_hints = cache(get_type_hints)


@cache
def _fields(kind: type) -> dict[str, tuple[Any, ...]]:
    """Return the types that each field of a class may have."""
    hints = _hints(kind)
    values = {}
    for item in fields(cast(Any, kind)):
        hint = hints[item.name]
        values[item.name] = get_args(hint) if get_origin(hint) in (Union, UnionType) else (hint,)
    return values


def _is_array(kinds: tuple[Any, ...]) -> bool:
    return any(get_origin(option) is np.ndarray for option in kinds)


def _has_arrays(kind: type) -> bool:
    return any(map(_is_array, _fields(kind).values()))


class Format(NamedTuple):
    """A format of `.npz` archives for results of one class: arrays, and a description in JSON.

    Attributes:
        name: the name of the format, stored in the archive.
        version: the version that is written and read.
        kind: the class.
        noun: name of the content, for messages.
        check: raises an error unless the parts of a restored result fit each other.
        advice: messages if another format is found instead, by its name.
        pack: returns the description and the arrays of a result.
        unpack: returns the fields from them; may raise anything if they are damaged.
    """

    name: str
    version: int
    kind: type
    noun: str
    check: Callable[[Any], None]
    advice: Mapping[str, str] = MappingProxyType({})
    pack: Callable[[Any], tuple[About, Arrays]] = pack
    unpack: Callable[[type, About, Arrays], dict[str, Any]] = unpack


ARCHIVES: dict[str, Format] = {}
"""The formats by name; higher packages add theirs with `register`."""

_TEXT_FILES = {".csv": (write_table, read_table)} | dict.fromkeys(
    (".json", ".yaml", ".yml"), (write_ros_message, read_ros_message)
)
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

    A `Run`, `Trajectory`, `Batch`, `Simulation`, `Grip` or `Map` is written as a `.npz` archive that includes
    the arm, the curves and the scene. The suffix selects the format of a `JointTrajectory`: ".npz" is
    lossless; ".csv" omits the name of the robot; ".json" is a ROS 2 `trajectory_msgs/msg/JointTrajectory`,
    with times in whole nanoseconds, as are ".yaml" and ".yml", with the same text.

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
        kind: the expected class: `Run`, `Trajectory`, `Batch`, `Simulation`, `Grip`, `JointTrajectory` or
            `Map`; any if None.

    Raises:
        FileError: the file is missing, damaged, or contains something else; names line or point of a text
            file.
        InvalidValue: another class.
    """
    path = Path(path)
    expected = None if kind is None else _format_of(kind, "kind", kind)
    suffix = check_format(path) if kind is JointTrajectory else path.suffix.lower()
    if kind in (None, JointTrajectory) and suffix in _TEXT_FILES:
        return _TEXT_FILES[suffix][1](path)
    if not path.is_file():
        raise FileError(path, "is a directory; name a file in it" if path.is_dir() else "no such file")
    if suffix in _NOT_READ:
        raise FileError(path, _NOT_READ[suffix])
    if expected is not None and suffix in _TEXT_FILES:
        advice = "`pp.load(path)` reads joint trajectories, `pinposture simulate` performs them"
        raise FileError(path, f"is not a saved {expected.noun}; {advice}")
    try:
        with np.load(path, allow_pickle=False) as stored:
            arrays = {name: stored[name] for name in stored.files}
        about = json.loads(str(arrays["about"]))
        format_name = about["format"]
        version = about["version"]
        expected = _format_named(format_name) if expected is None else expected
        if expected is None or (format_name, version) != (expected.name, expected.version):
            known = ARCHIVES.values() if expected is None else (expected,)
            allowed = ", ".join(f"{form.name!r} version {form.version}" for form in known)
            text = f"format {format_name!r} version {version}; allowed: {allowed}"
            raise FileError(path, text if expected is None else expected.advice.get(format_name, text))
        result = expected.kind(**expected.unpack(expected.kind, about, arrays))
        expected.check(result)
        return result
    except FileError:
        raise
    except Exception as error:  # a damaged file can raise anything: zlib, numpy, Pinocchio
        detail = f"{type(error).__name__}: {error}"
        if isinstance(error, ValueError) and "pickle" in str(error):  # numpy advises to allow pickles
            detail = "ValueError" if is_zipfile(path) else "it is no .npz archive"
        noun = "result" if expected is None else expected.noun
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
    homes = {"pinposture-simulation": "pinposture.sim", "pinposture-grip": "pinposture.task"}
    if name not in ARCHIVES and name in homes:
        import_module(homes[name])
    return ARCHIVES.get(name)


def _format_of(kind: type, name: str, value: object) -> Format:
    """Return the format of a class; raise InvalidValue for the argument `name` if there is none."""
    for form in ARCHIVES.values():
        if form.kind is kind:
            return form
    names = [form.kind.__name__ for form in ARCHIVES.values()]
    names += [name for name in ("Simulation", "Grip") if name not in names]
    hint = "; curves, scenes and tasks have their own `save` and `load`"
    raise InvalidValue(name, value, f"{', '.join(names[:-1])} or {names[-1]}{hint}")


# What the parts of a result must be, for all formats.


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
        if name in {"active", "clipped", "error_increasing", "target_mask"}:
            kinds = "b"
            allowed = "True or False"
        elif name in {"status", "reason", "closest", "violated_constraints"}:
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
    rows = np.unique(np.linspace(0, len(q) - 1, 500).round().astype(np.intp))
    for row in rows:
        expected = arm.at(arm.checked(q[row], f"{configurations}[{row}]")).points
        off = float(np.abs(expected - arrays[points][row]).max())
        if off > CONVERGED * arm.length:
            allowed = "those of the configuration in this row"
            raise InvalidValue(f"{points}[{row}]", f"{length_text(off)} off", allowed)


# Runs.


def _check_run(run: Run) -> None:
    arm = run.arm
    m = arm.n_modules
    shapes = {
        "q": (run.steps + 1, arm.nq),
        "points": (run.steps + 1, m, 3),
        "point_errors": (run.steps + 1, m),
        "clearance": (run.steps + 1,),
        "active": (run.steps, m),
        "clipped": (run.steps, arm.nv),
        "error_increasing": (run.steps,),
        "violated_constraints": (run.steps,),
    }
    check_arrays(vars(run), shapes)
    _check_info(run.info, run.steps)
    check_arrays(vars(run.target), {"points": (m, 3), "weights": (m,)})
    check_postures(arm, vars(run))
    require_finite("point_errors", run.point_errors)
    for part in run.held:
        if not part.begin < part.end <= len(run.q):
            raise InvalidValue("held", part, f"rows up to {len(run.q)}, in order")
    require_known("status", run.status, ENDINGS)


def _check_info(info: Mapping[str, NDArray[Any]], steps: int) -> None:
    """Raise InvalidValue unless each array of `Run.info` has a row of numbers or texts per step."""
    for name, column in info.items():
        if column.shape[:1] != (steps,) or column.dtype.kind not in "biufU":
            shape = f"{column.dtype} {column.shape}"
            raise InvalidValue(f"info_{name}", shape, f"{steps} rows of numbers or texts")


# Motions.

_OF_A_MOTION = "motion_"
"""What the names of arrays begin with that a motion has beside those of its run."""


def _pack_motion(motion: Trajectory) -> tuple[About, Arrays]:
    about, arrays = pack(motion.run)
    about["motion"], own = pack(motion, _OF_A_MOTION, without=("run",))
    return about, arrays | own


def _unpack_motion(kind: type, about: About, arrays: Arrays) -> dict[str, Any]:
    values = unpack(kind, about["motion"], arrays, _OF_A_MOTION, without=("run",))
    return {**values, "run": Run(**unpack(Run, about, arrays))}


def _check_motion(motion: Trajectory) -> None:
    run = motion.run
    _check_run(run)
    if run.limits.dt is None:
        raise InvalidValue("dt", None, "the duration of a cycle")
    rows = run.steps + 1
    m = run.arm.n_modules
    check_arrays(vars(motion), {"targets": (rows, m, 3), "target_mask": (rows, m), "plan_time": (rows,)})


# Batches.


def _pack_batch(batch: Batch) -> tuple[About, Arrays]:
    about, arrays = pack(batch, without=("targets", "motions"))
    about["targets"], of_targets = _pack_targets(batch.targets)
    about["motions"] = batch.motions is not None
    of_motions = {} if batch.motions is None else _pack_motions(batch.motions)
    return about, arrays | of_targets | of_motions


def _unpack_batch(kind: type, about: About, arrays: Arrays) -> dict[str, Any]:
    values = unpack(kind, about, arrays, without=("targets", "motions"))
    values["targets"] = _unpack_targets(about["targets"], arrays)
    values["motions"] = _unpack_motions(arrays) if about["motions"] else None
    return values


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


_TARGET = "target_"
"""What the names of the arrays of targets begin with."""


def _pack_targets(targets: Sequence[Target]) -> tuple[About, Arrays]:
    """Return targets as arrays, with a row for each value that is not None, and other data for JSON."""
    packed = [pack(target) for target in targets]
    arrays: Arrays = {}
    for name, kinds in _fields(Target).items():
        if _is_array(kinds):
            arrays[f"has_{name}"] = np.array([name in own for _, own in packed])
            known = [own[name] for _, own in packed if name in own]
            if known:
                arrays[f"{_TARGET}{name}"] = np.array(known)
    about: About = {name: [described[name] for described, _ in packed] for name in packed[0][0]}
    texts = [json.dumps(described) for described in about["curve"]]
    numbers = {text: number for number, text in enumerate(dict.fromkeys(texts))}
    about["curve"] = [numbers[text] for text in texts]
    about["curves"] = [json.loads(text) for text in numbers]
    return about, arrays


def _unpack_targets(about: About, arrays: Arrays) -> tuple[Target, ...]:
    """Return the targets from the result of `_pack_targets`."""
    curves = [None if described is None else Curve.from_dict(described) for described in about["curves"]]
    others = {name: values for name, values in about.items() if name not in ("curve", "curves")}
    names = [name for name in _fields(Target) if f"has_{name}" in arrays]
    rows = {name: iter(arrays.get(f"{_TARGET}{name}", ())) for name in names}
    targets = []
    for k, curve in enumerate(about["curve"]):
        own: Arrays = {name: next(rows[name]) for name in names if arrays[f"has_{name}"][k]}
        described = {name: values[k] for name, values in others.items()}
        values = unpack(Target, described, own, without=("curve",))
        targets.append(Target(curve=curves[curve], **values))
    return tuple(targets)


def _check_batch(batch: Batch) -> None:
    """Raise InvalidValue unless the arrays of a batch are consistent with each other and the arm."""
    arm = batch.arm
    count = len(batch.status)
    if count == 0 or len(batch.targets) not in (1, count):
        numbers = (len(batch.targets), count)
        raise InvalidValue("numbers of targets and runs", numbers, "as many, or one target")
    for target in batch.targets:
        target.check(arm)
    names = [name for name, kinds in _fields(Batch).items() if _is_array(kinds)]
    ends = {"q_start": (count, arm.nq), "q_final": (count, arm.nq)}
    check_arrays(vars(batch), {name: ends.get(name, (count,)) for name in names})
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
        _check_info(info_of(arrays), steps)


# Joint trajectories as arrays, exact to the last bit.

_OF_JOINTS = ("joint_names", "units")


def _pack_joints(trajectory: JointTrajectory) -> tuple[About, Arrays]:
    about, arrays = pack(trajectory)
    return about, arrays | {name: np.array(about.pop(name), dtype=np.str_) for name in _OF_JOINTS}


def _unpack_joints(kind: type, about: About, arrays: Arrays) -> dict[str, Any]:
    return unpack(kind, about | {name: arrays[name].tolist() for name in _OF_JOINTS}, arrays)


# Maps. What a map knows is packed as a part of it; which configurations were measured is not kept.

_OF_A_MAP = ("resolution", "center", "reach", "own_margin", "forget", "unknown", "sensor_range")


def _pack_map(mapped: Map) -> tuple[About, Arrays]:
    about: About = {name: getattr(mapped, name) for name in _OF_A_MAP}
    about["arm"] = None if mapped.arm is None else mapped.arm.to_dict()
    content = mapped.content
    about["time"] = content.time
    return about, {"cells": content.cells, "evidence": content.evidence}


def _unpack_map(kind: type, about: About, arrays: Arrays) -> dict[str, Any]:
    values = {name: about[name] for name in _OF_A_MAP}
    values["arm"] = None if about["arm"] is None else Arm.from_dict(about["arm"])
    values["content"] = MapContent(arrays["cells"], arrays["evidence"], about["time"])
    return values


register(
    Format(
        "pinposture-run",
        6,
        Run,
        "run",
        _check_run,
        {
            "pinposture-batch": "contains many runs; save one of them: pp.save(pp.load(file)[0], ...)",
            "pinposture-motion": "contains a motion in time; its run is pp.load(file).run",
        },
    )
)
register(
    Format(
        "pinposture-motion",
        4,
        Trajectory,
        "motion",
        _check_motion,
        {
            "pinposture-run": "contains a run without times; pp.load(file) returns it as a Run",
            "pinposture-batch": "contains many runs; pp.load(file) returns them as a Batch",
        },
        _pack_motion,
        _unpack_motion,
    )
)
register(Format("pinposture-batch", 5, Batch, "batch", _check_batch, {}, _pack_batch, _unpack_batch))
register(
    Format(
        "pinposture-joint-trajectory",
        1,
        JointTrajectory,
        "joint trajectory",
        lambda _: None,
        {},
        _pack_joints,
        _unpack_joints,
    )
)
register(Format("pinposture-map", 1, Map, "map", lambda _: None, {}, _pack_map, _unpack_map))
