"""Batches as files: one `.npz` that holds every run, the arm and the curves."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pinposture.arm import Arm
from pinposture.control import Limits
from pinposture.curve import Curve
from pinposture.errors import InvalidValue
from pinposture.motion.archive import Kind, read_archive, write_archive
from pinposture.motion.batch import Batch
from pinposture.motion.batch_motions import STEP_ARRAYS, TEXT_ARRAYS, Motions
from pinposture.motion.files import unpack_moved
from pinposture.scene import Scene
from pinposture.target import Target

KIND = Kind("pinposture-batch", 1, "batch", {})

_TARGET_ARRAYS = ("points", "weights", "q", "parameters", "residual")
_RUN_ARRAYS = (
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
    arrays: dict[str, Any] = {name: getattr(batch, name) for name in _RUN_ARRAYS}
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
    return write_archive(path, KIND, batch.limits, about, arrays)


def load_batch(path: Path) -> Batch:
    """Read a batch; see `Batch.load`."""
    return read_archive(path, KIND, _unpacked)


def _unpacked(about: dict[str, Any], arrays: dict[str, Any], limits: Limits) -> Batch:
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
        **{name: arrays[name] for name in _RUN_ARRAYS},
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
    for name in _RUN_ARRAYS:
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
