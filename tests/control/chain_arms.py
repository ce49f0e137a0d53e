"""Arms of all kinds, for tests of the passes along a chain."""

from __future__ import annotations

from functools import cache

import numpy as np
import pinocchio as pin

import pinposture as pp

SLIDE = pp.JointSpec("x", type="prismatic", lower=0.0, upper=0.1)
SLIDING = pp.ModuleTemplate("RyRzPx", (pp.JointSpec("y"), pp.JointSpec("z"), SLIDE), (0.05, 0.0, 0.1))
LONG = pp.ModuleTemplate("RxRzRyRz", tuple(map(pp.JointSpec, "xzyz")), (0.05, 0.04, 0.06, 0.05))
ONE, OTHER = (pp.ModuleTemplate(f"R{axis}", (pp.JointSpec(axis),), (0.1,)) for axis in "yz")
PLACEMENT = pin.SE3(pin.rpy.rpyToMatrix(0.3, -1.1, 2.0), np.array([0.4, -2.0, 0.7]))

ARMS = {
    "two joints": lambda: pp.Arm.from_template("RyRz", 12),
    "planar": lambda: pp.Arm.from_template("Rz", 14, base_placement=PLACEMENT),
    "planar, two joints": lambda: pp.Arm.from_template("RzRz", 6),
    "slides": lambda: pp.Arm.from_modules([SLIDING, pp.template("RyRz")] * 4),
    "planar slides": lambda: pp.Arm.from_modules(
        [pp.ModuleTemplate("RzPx", (pp.JointSpec("z"), SLIDE), (0.0, 0.1))] * 5
    ),
    "one joint in space": lambda: pp.Arm.from_modules([ONE, OTHER] * 6),
    "mixed": lambda: pp.Arm.from_modules(
        [LONG, pp.template("RyRz"), ONE, LONG, OTHER], base_placement=PLACEMENT
    ),
}


@cache
def arm_called(name: str) -> pp.Arm:
    return ARMS[name]()


def branched() -> pp.Arm:
    """An arm with a joint off the chain, the first in the tangent space."""
    arm = pp.Arm.from_template("RyRz", 4)
    model = pin.Model()
    side = model.addJoint(0, pin.JointModelRZ(), pin.SE3.Identity(), "a side joint")
    model.appendBodyToJoint(side, pin.Inertia.Random(), pin.SE3.Identity())
    joined = pin.appendModel(model, arm.model, 0, pin.SE3.Identity())
    joined = joined[0] if isinstance(joined, tuple) else joined
    return pp.Arm.from_model(joined, list(arm.control_points))


def state_of(arm: pp.Arm, seed: int, amplitude: float) -> pp.ArmState:
    drawn = amplitude * np.random.default_rng(seed).uniform(-1, 1, arm.nv)
    low = np.maximum(arm.limits.lower, -9.0)
    high = np.minimum(arm.limits.upper, 9.0)
    return arm.at(arm.configuration(np.clip(drawn, low, high)))
