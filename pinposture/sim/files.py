"""Simulations as files: one `.npz` that holds the motion and the arm."""

from __future__ import annotations

from typing import Any

from pinposture._validation import require_positive
from pinposture.arm import Arm
from pinposture.collision import Scene
from pinposture.motion.files import Format, check_shapes, register
from pinposture.sim.servos import Servos
from pinposture.sim.simulation import Simulation

_ADVICE = {
    "pinposture-run": "holds a run, not a simulation of it; simulate it with: pinposture simulate FILE",
    "pinposture-motion": "holds a motion, not a simulation of it; simulate it with: pinposture simulate FILE",
}
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


def _pack(simulation: Simulation) -> tuple[dict[str, Any], dict[str, Any]]:
    named = {name: getattr(simulation, name) for name in _ARRAYS}
    arrays = {name: value for name, value in named.items() if value is not None}
    about = {name: getattr(simulation, name) for name in _WORDS}
    about["dt"] = simulation.dt
    about["arm"] = simulation.arm.to_dict()
    about["servos"] = vars(simulation.servos)
    about["warnings"] = list(simulation.warnings)
    about["scene"] = None if simulation.scene is None else simulation.scene.to_dict()
    return about, arrays


def _unpack(about: dict[str, Any], arrays: dict[str, Any]) -> Simulation:
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
    check_shapes(arrays, {name: shape for name, shape in shapes.items() if name in arrays})
    require_positive("dt", about["dt"])
    return Simulation(
        arm=arm,
        servos=Servos(**about["servos"]),
        dt=about["dt"],
        warnings=tuple(about["warnings"]),
        scene=None if about["scene"] is None else Scene.from_dict(about["scene"]),
        **{name: arrays.get(name) for name in _ARRAYS},  # type: ignore[arg-type]
        **{name: about[name] for name in _WORDS},
    )


register(Format("pinposture-simulation", 2, Simulation, "simulation", _pack, _unpack, _ADVICE))
