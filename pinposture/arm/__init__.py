"""What the robot is: module templates, URDF, loading, the arm and its state."""

from pinposture.arm.adequacy import Adequacy, Excess
from pinposture.arm.arm import Arm
from pinposture.arm.ellipsoid import ControlPoints, Ellipsoid
from pinposture.arm.limits import JointLimits
from pinposture.arm.state import ArmState
from pinposture.arm.template import TEMPLATES, JointSpec, ModuleTemplate, template

__all__ = [
    "TEMPLATES",
    "Adequacy",
    "Arm",
    "ArmState",
    "ControlPoints",
    "Ellipsoid",
    "Excess",
    "JointLimits",
    "JointSpec",
    "ModuleTemplate",
    "template",
]
