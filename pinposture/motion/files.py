"""Runs as files: one `.npz` that holds the motion, the arm and the curve."""

from __future__ import annotations

import io
import json
from pathlib import Path
from typing import Any

import numpy as np

from pinposture.arm import Arm
from pinposture.control import Limits
from pinposture.curve import Curve
from pinposture.errors import FileError, InvalidValue
from pinposture.motion.trajectory import Trajectory
from pinposture.scene import Scene
from pinposture.storage import write_bytes
from pinposture.target import Target

FORMAT = "pinposture-run"
VERSION = 3

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
_LIMITS_ARRAYS = ("step", "velocity", "acceleration")
_TARGET_ARRAYS = ("points", "weights", "q", "parameters", "residual")


def save_trajectory(run: Trajectory, path: Path) -> Path:
    """Write a run; see `Trajectory.save`."""
    path = path if path.suffix == ".npz" else path.with_name(path.name + ".npz")
    arrays: dict[str, Any] = {name: getattr(run, name) for name in _RUN_ARRAYS}
    for name in _TARGET_ARRAYS:
        value = getattr(run.target, name)
        if value is not None:
            arrays[f"target_{name}"] = value
    for name in _LIMITS_ARRAYS:
        value = getattr(run.limits, name)
        if value is not None:
            arrays[f"limits_{name}"] = value
    about = {
        "format": FORMAT,
        "version": VERSION,
        "arm": run.arm.to_dict(),
        "curve": None if run.target.curve is None else run.target.curve.to_dict(),
        "method": run.target.method,
        "incomplete": run.target.incomplete,
        "controller": run.controller,
        "dt": run.limits.dt,
        "position_margin": run.limits.position_margin,
        "scene": None if run.scene is None else run.scene.to_dict(),
        "status": run.status,
        "reason": run.reason,
    }
    content = io.BytesIO()
    np.savez_compressed(content, about=np.array(json.dumps(about)), **arrays)
    write_bytes(path, content.getvalue())
    return path


def load_trajectory(path: Path) -> Trajectory:
    """Read a run; see `Trajectory.load`."""
    if not path.is_file():
        raise FileError(path, "no such file")
    try:
        with np.load(path, allow_pickle=False) as stored:
            arrays = {name: stored[name] for name in stored.files}
        about = json.loads(str(arrays["about"]))
        if about["format"] != FORMAT or about["version"] != VERSION:
            found = f"format {about['format']!r} version {about['version']}"
            text = f"{found}; allowed: {FORMAT!r} version {VERSION}"
            if about["format"] == "pinposture-batch":
                text = "holds many runs; save one of them: pp.Batch.load(file)[0].save(...)"
            raise FileError(path, text)
        curve = None if about["curve"] is None else Curve.from_dict(about["curve"])
        target: dict[str, Any] = {name: arrays.get(f"target_{name}") for name in _TARGET_ARRAYS}
        limits = {
            name: value if value is None or value.ndim else float(value)
            for name, value in ((name, arrays.get(f"limits_{name}")) for name in _LIMITS_ARRAYS)
        }
        arm = Arm.from_dict(about["arm"])
        _check_shapes(arm, arrays)
        return Trajectory(
            arm=arm,
            target=Target(**target, curve=curve, method=about["method"], incomplete=about["incomplete"]),
            limits=Limits(**limits, dt=about["dt"], position_margin=about["position_margin"]),
            scene=None if about["scene"] is None else Scene.from_dict(about["scene"]),
            controller=about["controller"],
            status=about["status"],
            reason=about["reason"],
            **{name: arrays[name] for name in _RUN_ARRAYS},
        )
    except FileError:
        raise
    except Exception as error:  # a damaged file can trip zlib, numpy's reader or Pinocchio's, anything
        detail = "" if isinstance(error, ValueError) and "pickle" in str(error) else f": {error}"
        raise FileError(path, f"is not a saved run ({type(error).__name__}{detail})") from error


def _check_shapes(arm: Arm, arrays: dict[str, Any]) -> None:
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
    for name in _RUN_ARRAYS:
        expected = shapes.get(name, (steps,))
        if arrays[name].shape != expected:
            raise InvalidValue(f"{name} (shape)", arrays[name].shape, str(expected))
