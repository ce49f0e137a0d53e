"""Target posture of an arm: module kinematics, placement on a curve, fit to points."""

from pinposture.arm.module_kinematics import (
    ModuleJoints,
    ModuleKinematics,
    register_module_kinematics,
    unregister_module_kinematics,
)
from pinposture.placement.module_kinematics import (
    Circle,
    ConstantCurvature,
    NumericModule,
    RollPitch,
    Torus,
    curve_crossings,
)
from pinposture.placement.resolve import resolve_targets
from pinposture.placement.target import Target

__all__ = [
    "Circle",
    "ConstantCurvature",
    "ModuleJoints",
    "ModuleKinematics",
    "NumericModule",
    "RollPitch",
    "Target",
    "Torus",
    "curve_crossings",
    "register_module_kinematics",
    "resolve_targets",
    "unregister_module_kinematics",
]
