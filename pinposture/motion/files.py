"""Runs, motions and batches as files."""

from __future__ import annotations

import io
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any, NamedTuple, TypeVar
from zipfile import is_zipfile

import numpy as np
from numpy.typing import NDArray

from pinposture._validation import finite_vector
from pinposture.arm import Arm
from pinposture.collision import Scene
from pinposture.control import Limits
from pinposture.curve import Curve
from pinposture.errors import FileError, InvalidValue
from pinposture.motion.batch import STEP_ARRAYS, TEXT_ARRAYS, Batch, Motions
from pinposture.motion.motion import Motion, Passed
from pinposture.motion.trajectory import ENDINGS, Trajectory
from pinposture.placement import Target
from pinposture.placement.curve_placement import Moved
from pinposture.storage import with_suffix, write_bytes

# What files of runs and of batches have in common: arrays, and a description in JSON, in one `.npz`.

Made = TypeVar("Made")

_LIMITS_ARRAYS = ("step", "velocity", "acceleration")


class ArchiveKind(NamedTuple):
    """A kind of file.

    Attributes:
        format: its name in the file.
        version: the version that is written and read.
        noun: what it holds, in words.
        advice: what to say of a file of another kind, by the name of its format.
    """

    format: str
    version: int
    noun: str
    advice: Mapping[str, str]


def write_archive(
    path: Path, kind: ArchiveKind, limits: Limits, about: dict[str, Any], arrays: dict[str, Any]
) -> Path:
    """Write a file at once or not at all; `.npz` is added to a name without ending. Returns its path.

    Raises:
        FileError: the name has another ending, or the file cannot be written.
    """
    path = with_suffix(path, ".npz")
    told = {name: getattr(limits, name) for name in _LIMITS_ARRAYS}
    packed = {f"limits_{name}": value for name, value in told.items() if value is not None}
    described = {
        "format": kind.format,
        "version": kind.version,
        "dt": limits.dt,
        "position_margin": limits.position_margin,
        **about,
    }
    content = io.BytesIO()
    np.savez_compressed(content, about=np.array(json.dumps(described)), **arrays, **packed)
    write_bytes(path, content.getvalue())
    return path


def read_archive(
    path: Path, kind: ArchiveKind, made: Callable[[dict[str, Any], dict[str, Any], Limits], Made]
) -> Made:
    """Read a file.

    Args:
        path: the file.
        kind: what it should be.
        made: what makes something of its description, its arrays and the limits in it.

    Raises:
        FileError: there is no such file, it is of another kind, or damaged.
    """
    if not path.is_file():
        raise FileError(path, "no such file")
    try:
        with np.load(path, allow_pickle=False) as stored:
            arrays = {name: stored[name] for name in stored.files}
        about = json.loads(str(arrays["about"]))
        if about["format"] != kind.format or about["version"] != kind.version:
            found = f"format {about['format']!r} version {about['version']}"
            allowed = f"{found}; allowed: {kind.format!r} version {kind.version}"
            raise FileError(path, kind.advice.get(about["format"], allowed))
        limits = {
            name: value if value is None or value.ndim else float(value)
            for name, value in ((name, arrays.get(f"limits_{name}")) for name in _LIMITS_ARRAYS)
        }
        return made(about, arrays, Limits(**limits, dt=about["dt"], position_margin=about["position_margin"]))
    except FileError:
        raise
    except Exception as error:  # a damaged file can trip zlib, numpy's reader or Pinocchio's, anything
        detail = f"{type(error).__name__}: {error}"
        if isinstance(error, ValueError) and "pickle" in str(error):  # numpy's advice is not to be followed
            detail = "ValueError" if is_zipfile(path) else "it is no .npz archive"
        raise FileError(path, f"is not a saved {kind.noun} ({detail})") from error


# Runs as files: one `.npz` that holds the motion, the arm and the curve.

_ADVICE = {
    "pinposture-batch": "holds many runs; save one of them: pp.Batch.load(file)[0].save(...)",
    "pinposture-motion": "holds a motion in time; read it by pp.Motion.load(file), its run is .run",
}
RUN_ARCHIVE = ArchiveKind("pinposture-run", 3, "run", _ADVICE)

_RUN_ARRAYS = (
    "q",
    "points",
    "point_errors",
    "active",
    "index",
    "sigma_min",
    "sigma_max",
    "rows",
    "scale",
    "clipped",
    "method",
    "switched",
    "escape",
    "relaxed",
    "clearance",
)
_TARGET_ARRAYS = ("points", "weights", "q", "parameters", "residual")


def save_trajectory(run: Trajectory, path: Path) -> Path:
    """Write a run; see `Trajectory.save`."""
    return write_archive(path, RUN_ARCHIVE, run.limits, *pack_run(run))


def pack_run(run: Trajectory) -> tuple[dict[str, Any], dict[str, Any]]:
    """A run without its limits as a description that JSON can hold, and arrays."""
    arrays: dict[str, Any] = {name: getattr(run, name) for name in _RUN_ARRAYS}
    for name in _TARGET_ARRAYS:
        value = getattr(run.target, name)
        if value is not None:
            arrays[f"target_{name}"] = value
    about = {
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


def load_trajectory(path: Path) -> Trajectory:
    """Read a run; see `Trajectory.load`."""
    return read_archive(path, RUN_ARCHIVE, unpack_run)


def unpack_run(about: dict[str, Any], arrays: dict[str, Any], limits: Limits) -> Trajectory:
    """The run that `pack_run` packed.

    Raises:
        InvalidValue: arrays that do not fit each other.
    """
    curve = None if about["curve"] is None else Curve.from_dict(about["curve"])
    target: dict[str, Any] = {name: arrays.get(f"target_{name}") for name in _TARGET_ARRAYS}
    arm = Arm.from_dict(about["arm"])
    _check_run(arm, arrays)
    if about["status"] not in ENDINGS:
        raise InvalidValue("status", about["status"], ", ".join(ENDINGS))
    return Trajectory(
        arm=arm,
        target=Target(
            **target,
            curve=curve,
            method=about["method"],
            incomplete=about["incomplete"],
            moved=unpack_moved(about.get("moved")),
            approximate=about.get("approximate", ""),  # files of older versions do not say
        ),
        limits=limits,
        scene=None if about["scene"] is None else Scene.from_dict(about["scene"]),
        controller=about["controller"],
        status=about["status"],
        reason=about["reason"],
        **{name: arrays[name] for name in _RUN_ARRAYS},
    )


def unpack_moved(told: list[list[float]] | None) -> Moved | None:
    """How a curve was moved, as JSON has it."""
    if told is None:
        return None
    translation, rotation = (finite_vector("moved", each, 3).tolist() for each in told)
    return Moved(tuple(translation), tuple(rotation))


def _check_run(arm: Arm, arrays: dict[str, Any]) -> None:
    """Raise InvalidValue unless the arrays of a run fit each other and the arm."""
    steps, m = len(arrays["active"]), arm.n_modules
    shapes = {
        "q": (steps + 1, arm.nq),
        "points": (steps + 1, m, 3),
        "point_errors": (steps + 1, m),
        "clearance": (steps + 1,),
        "active": (steps, m),
        "clipped": (steps, arm.nv),
    }
    check_shapes(arrays, {name: shapes.get(name, (steps,)) for name in _RUN_ARRAYS})


def check_shapes(arrays: dict[str, Any], shapes: dict[str, tuple[int, ...]]) -> None:
    """Raise InvalidValue unless arrays have the shapes that they should."""
    for name, expected in shapes.items():
        if arrays[name].shape != expected:
            raise InvalidValue(f"{name} (shape)", arrays[name].shape, str(expected))


# Motions as files: one `.npz` that holds the run, and what it should have done when.

_MOTION_ADVICE = {
    "pinposture-run": "holds a run that knows of no time; read it by pp.Trajectory.load(file)",
    "pinposture-batch": "holds many runs; read them by pp.Batch.load(file)",
}
MOTION_ARCHIVE = ArchiveKind("pinposture-motion", 1, "motion", _MOTION_ADVICE)

_ARRAYS = ("targets", "asked", "clock")


def save_motion(motion: Motion, path: Path) -> Path:
    """Write a motion; see `Motion.save`."""
    about, arrays = pack_run(motion.run)
    about["motion"] = {
        "set_out": motion.set_out,
        "planned": motion.planned,
        "passed": [list(place) for place in motion.passed],
        "detours": list(motion.detours),
    }
    arrays |= {f"motion_{name}": getattr(motion, name) for name in _ARRAYS}
    return write_archive(path, MOTION_ARCHIVE, motion.run.limits, about, arrays)


def load_motion(path: Path) -> Motion:
    """Read a motion; see `Motion.load`."""
    return read_archive(path, MOTION_ARCHIVE, _unpacked_motion)


def _unpacked_motion(about: dict[str, Any], arrays: dict[str, Any], limits: Limits) -> Motion:
    run, timed = unpack_run(about, arrays, limits), about["motion"]
    if limits.dt is None:
        raise InvalidValue("dt", None, "the duration of a cycle")
    rows, m = run.steps + 1, run.arm.n_modules
    check_shapes(arrays, {"motion_targets": (rows, m, 3), "motion_asked": (rows, m), "motion_clock": (rows,)})
    return Motion(
        run=run,
        **{name: arrays[f"motion_{name}"] for name in _ARRAYS},
        set_out=timed["set_out"],
        planned=timed["planned"],
        passed=tuple(
            Passed(*place[:7])._replace(moved=unpack_moved(place[7] if len(place) > 7 else None))
            for place in timed["passed"]
        ),
        detours=tuple(timed["detours"]),
    )


# Batches as files: one `.npz` that holds every run, the arm and the curves.

BATCH_ARCHIVE = ArchiveKind("pinposture-batch", 1, "batch", {})

_BATCH_RUN_ARRAYS = (
    "status",
    "reason",
    "steps",
    "start_error",
    "final_error",
    "mean_error",
    "sweep",
    "clearance",
    "q_start",
    "q_final",
)
_MOTION_ARRAYS = tuple(field.name for field in fields(Motions) if field.name != "texts")


def save_batch(batch: Batch, path: Path) -> Path:
    """Write a batch; see `Batch.save`."""
    arrays: dict[str, Any] = {name: getattr(batch, name) for name in _BATCH_RUN_ARRAYS}
    target_arrays, about_targets = _pack_targets(batch.targets)
    arrays |= target_arrays
    motions = batch.motions
    if motions is not None:
        arrays |= {f"motion_{name}": getattr(motions, name) for name in _MOTION_ARRAYS}
    about = {
        "arm": batch.arm.to_dict(),
        "targets": about_targets,
        "controller": batch.controller,
        "scene": None if batch.scene is None else batch.scene.to_dict(),
        "max_steps": batch.max_steps,
        "tolerance": batch.tolerance,
        "texts": None if motions is None else list(motions.texts),
    }
    return write_archive(path, BATCH_ARCHIVE, batch.limits, about, arrays)


def load_batch(path: Path) -> Batch:
    """Read a batch; see `Batch.load`."""
    return read_archive(path, BATCH_ARCHIVE, _unpacked_batch)


def _unpacked_batch(about: dict[str, Any], arrays: dict[str, Any], limits: Limits) -> Batch:
    motions = None
    if about["texts"] is not None:
        kept = {name: arrays[f"motion_{name}"] for name in _MOTION_ARRAYS}
        motions = Motions(**kept, texts=tuple(about["texts"]))
    batch = Batch(
        arm=Arm.from_dict(about["arm"]),
        targets=_unpack_targets(arrays, about["targets"]),
        controller=about["controller"],
        limits=limits,
        scene=None if about["scene"] is None else Scene.from_dict(about["scene"]),
        max_steps=about["max_steps"],
        tolerance=about["tolerance"],
        motions=motions,
        **{name: arrays[name] for name in _BATCH_RUN_ARRAYS},
    )
    _check_shapes(batch)
    return batch


def _pack_targets(targets: Sequence[Target]) -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
    """Targets as arrays, with a row for each that has such a thing, and the rest as JSON can hold it."""
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
    """The targets that `_pack_targets` took apart."""
    curves = [None if described is None else Curve.from_dict(described) for described in about["curves"]]
    columns: dict[str, list[Any]] = {}
    for name in _TARGET_ARRAYS:
        rows = iter(arrays.get(f"target_{name}", ()))
        columns[name] = [next(rows) if known else None for known in arrays[f"has_{name}"]]
    older = len(
        about["curve"]
    )  # files of older versions do not say how curves were moved, or how close fits are
    moved, close = (
        map(unpack_moved, about.get("moved", [None] * older)),
        about.get("approximate", [""] * older),
    )
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


def _check_shapes(batch: Batch) -> None:
    """Raise InvalidValue unless the arrays of a batch fit each other and the arm."""
    arm, count = batch.arm, len(batch.status)
    if count == 0 or len(batch.targets) not in (1, count):
        numbers = (len(batch.targets), count)
        raise InvalidValue("numbers of targets and runs", numbers, "as many, or one target")
    for target in batch.targets:
        target.check(arm)
    for name in _BATCH_RUN_ARRAYS:
        _require(name, getattr(batch, name), (count, arm.nq) if name.startswith("q_") else (count,))
    motions = batch.motions
    if motions is None:
        return
    _require("offsets", motions.offsets, (count + 1,))
    if motions.offsets[0] != 0 or np.any(np.diff(motions.offsets) != batch.steps + 1):
        raise InvalidValue("offsets", motions.offsets, "those of runs of so many steps")
    whole, n_texts = int(motions.offsets[-1]), len(motions.texts)
    _require("q", motions.q, (whole, arm.nq))
    _require("clearance", motions.clearance, (whole,))
    wide = {"active": (whole - count, arm.n_modules), "clipped": (whole - count, arm.nv)}
    for name in STEP_ARRAYS + TEXT_ARRAYS:
        _require(name, getattr(motions, name), wide.get(name, (whole - count,)))
    for name in TEXT_ARRAYS:
        numbers = getattr(motions, name)
        if np.any((numbers < 0) | (numbers >= n_texts)):
            raise InvalidValue(name, numbers, f"numbers of texts from 0 to {n_texts - 1}")


def _require(name: str, array: NDArray[Any], shape: tuple[int, ...]) -> None:
    if array.shape != shape:
        raise InvalidValue(f"{name} (shape)", array.shape, str(shape))
