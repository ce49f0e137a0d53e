"""Simulations as files: one `.npz` that holds the motion and the arm."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from pinposture.arm import Arm
from pinposture.collision import Scene
from pinposture.control import Limits
from pinposture.errors import InvalidValue
from pinposture.motion.files import ArchiveKind, read_archive, write_archive
from pinposture.sim.servos import Servos
from pinposture.sim.simulation import Simulation

_ADVICE = {
    "pinposture-run": "holds a run, not a simulation of it; simulate it with: pinposture simulate FILE",
    "pinposture-motion": "holds a motion, not a simulation of it; simulate it with: pinposture simulate FILE",
}
KIND = ArchiveKind("pinposture-simulation", 2, "simulation", _ADVICE)

_ARRAYS = (
    "gravity",
    "commanded",
    "q",
    "commanded_points",
    "points",
    "torques",
    "torque_limits",
    "saturated",
    "clearance",
    "targets",
    "weights",
)
_WORDS = ("loop", "timestep", "status", "reason", "measured")


def save_simulation(simulation: Simulation, path: Path) -> Path:
    """Write a simulation; see `Simulation.save`."""
    named = {name: getattr(simulation, name) for name in _ARRAYS}
    arrays = {name: value for name, value in named.items() if value is not None}
    about = {name: getattr(simulation, name) for name in _WORDS}
    about["arm"] = simulation.arm.to_dict()
    about["servos"] = vars(simulation.servos)
    about["warnings"] = list(simulation.warnings)
    about["scene"] = None if simulation.scene is None else simulation.scene.to_dict()
    return write_archive(path, KIND, Limits(step=None, dt=simulation.dt), about, arrays)


def load_simulation(path: Path) -> Simulation:
    """Read a simulation; see `Simulation.load`."""
    return read_archive(path, KIND, _unpacked)


def _unpacked(about: dict[str, Any], arrays: dict[str, Any], limits: Limits) -> Simulation:
    arm = Arm.from_dict(about["arm"])
    rows, m = len(arrays["q"]), arm.n_modules
    shapes = {
        "gravity": (3,),
        "commanded": (rows, arm.nq),
        "q": (rows, arm.nq),
        "commanded_points": (rows, m, 3),
        "points": (rows, m, 3),
        "torques": (rows, arm.nv),
        "torque_limits": (arm.nv,),
        "saturated": (arm.nv,),
        "clearance": (rows,),
        "targets": (rows, m, 3),
        "weights": (rows, m),
    }
    for name, expected in shapes.items():
        if name in arrays and arrays[name].shape != expected:
            raise InvalidValue(f"{name} (shape)", arrays[name].shape, str(expected))
    assert limits.dt is not None  # it was written with one
    return Simulation(
        arm=arm,
        servos=Servos(**about["servos"]),
        dt=limits.dt,
        warnings=tuple(about["warnings"]),
        scene=None if about["scene"] is None else Scene.from_dict(about["scene"]),
        **{name: arrays.get(name) for name in _ARRAYS},  # type: ignore[arg-type]
        **{name: about[name] for name in _WORDS},
    )
