"""Arms of every kind that tasks meet, and derivatives that share no code with them."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np
import pinocchio as pin

import pinposture as pp

PLACEMENT = pin.SE3(pin.rpy.rpyToMatrix(0.3, -1.1, 2.0), np.array([0.4, -2.0, 0.7]))


def _module(name: str, joints: list[tuple[object, str]], lengths: tuple[float, ...]) -> pp.ModuleTemplate:
    limits = {"prismatic": {"lower": -0.1, "upper": 0.1}}
    return pp.ModuleTemplate(
        name, tuple(pp.JointSpec(axis, type=kind, **limits.get(kind, {})) for axis, kind in joints), lengths
    )


_MIXED = _module(
    "mixed",
    [((1.0, 1.0, 0.3), "revolute"), ("z", "continuous"), ("x", "prismatic")],
    (0.02, 0.03, 0.04),
)
_SCARA = _module("scara", [("z", "revolute"), ("z", "continuous"), ("z", "prismatic")], (0.1, 0.2, 0.05))
_WRIST = _module("wrist", [("z", "revolute"), ("y", "revolute"), ("x", "revolute")], (0.1, 0.0, 0.0))
_TILTED = _module("tilted", [((0.5, 0, 1), "revolute"), ((-0.5, 0, -1), "continuous")], (0.1, 0.1))
_GANTRY = _module("gantry", [("x", "prismatic"), ("y", "prismatic"), ("z", "prismatic")], (0.1, 0.1, 0.1))

ARMS = {
    "spatial": lambda: pp.Arm.from_template("RyRz", 4, (0.03, 0.02), base_placement=PLACEMENT),
    "planar": lambda: pp.Arm.from_template("Rz", 6, base_placement=PLACEMENT),
    "mixed": lambda: pp.Arm.from_modules([_MIXED] * 3, base_placement=PLACEMENT),
    "scara": lambda: pp.Arm.from_modules([_SCARA], base_placement=PLACEMENT),
    "wrist": lambda: pp.Arm.from_modules([pp.template("Rz")] * 3 + [_WRIST], base_placement=PLACEMENT),
    "tilted": lambda: pp.Arm.from_modules([_TILTED] * 3, base_placement=PLACEMENT),
    "gantry": lambda: pp.Arm.from_modules([_GANTRY], base_placement=PLACEMENT),
}
"""The wrist turns its tip in all ways without leaving the plane; the scara leaves it, and turns one way.

The links of the tilted arm do not lie across its axes, which point both ways.
"""

STATES = [(name, seed) for name in ARMS for seed in (None, 0, 1)]
"""Arms, and seeds of configurations; None for the neutral one, which is singular."""


@cache
def arm_called(name: str) -> pp.Arm:
    return ARMS[name]()


def state_of(name: str, seed: int | None) -> pp.ArmState:
    arm = arm_called(name)
    return arm.at(arm.neutral() if seed is None else arm.random(np.random.default_rng(seed)))


def target_of(arm: pp.Arm) -> pp.Target:
    return pp.Target.from_configuration(arm, arm.neutral())


def derivative(
    state: pp.ArmState, function: Callable[[pp.ArmState], np.ndarray], h: float = 1e-6
) -> np.ndarray:
    """Derivative of a function of the state along the manifold, (..., nv), by central differences."""
    arm = state.arm
    ahead, behind = (
        np.array([function(arm.at(arm.integrate(state.q, sign * h * d))) for d in np.eye(arm.nv)])
        for sign in (1.0, -1.0)
    )
    return np.moveaxis((ahead - behind) / (2.0 * h), 0, -1)


def random_rotation(rng: np.random.Generator, angle: float) -> np.ndarray:
    axis = rng.normal(size=3)
    return np.asarray(pin.exp3(angle * axis / np.linalg.norm(axis)))


def gauss_newton(task: object, state: pp.ArmState, steps: int) -> tuple[pp.ArmState, list[float]]:
    """Plain Gauss-Newton on one task: where it ends, and the size of the error on the way."""
    arm = state.arm
    target = target_of(state.arm)
    sizes = []
    for _ in range(steps):
        jacobian, error = task.rows(state, target)
        sizes.append(float(np.linalg.norm(error)))
        step = np.linalg.lstsq(jacobian * arm.joint_units, error, rcond=1e-10)[0] * arm.joint_units
        state = arm.at(arm.integrate(state.q, step))
    return state, [*sizes, float(np.linalg.norm(task.rows(state, target).error))]
