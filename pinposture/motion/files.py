"""Runs as files: one `.npz` that holds the motion, the arm and the curve."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from pinposture.arm import Arm
from pinposture.arm.checks import finite_vector
from pinposture.control import Limits
from pinposture.curve import Curve
from pinposture.errors import InvalidValue
from pinposture.motion.archive import Kind, read_archive, write_archive
from pinposture.motion.ending import ENDINGS
from pinposture.motion.trajectory import Trajectory
from pinposture.scene import Scene
from pinposture.target import Target
from pinposture.target.placement import Moved

_ADVICE = {
    "pinposture-batch": "holds many runs; save one of them: pp.Batch.load(file)[0].save(...)",
    "pinposture-motion": "holds a motion in time; read it by pp.Motion.load(file), its run is .run",
}
KIND = Kind("pinposture-run", 3, "run", _ADVICE)

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
    return write_archive(path, KIND, run.limits, *pack_run(run))


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
    return read_archive(path, KIND, unpack_run)


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
