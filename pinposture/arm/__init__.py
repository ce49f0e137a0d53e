"""What the robot is: module templates, URDF, loading, the arm and its state."""

from pinposture.arm.arm import Arm, ArmState, ChainState, bent_configuration, smooth_configuration
from pinposture.arm.configurations import JointLimits
from pinposture.arm.couplings import Coupling, Drive, DrivenJoints
from pinposture.arm.feasibility import Feasibility, Violation
from pinposture.arm.manipulability import ControlPoints, Ellipsoid
from pinposture.arm.specification import ArmSpec, FeedSpec, PoseSpec
from pinposture.arm.template import TEMPLATES, JointSpec, ModuleTemplate, continuum_section, template
from pinposture.arm.weight import Cable, HeldOut, JointLoad, Load, Weight

__all__ = [
    "TEMPLATES",
    "Arm",
    "ArmSpec",
    "ArmState",
    "Cable",
    "ChainState",
    "ControlPoints",
    "Coupling",
    "Drive",
    "DrivenJoints",
    "Ellipsoid",
    "Feasibility",
    "FeedSpec",
    "HeldOut",
    "JointLimits",
    "JointLoad",
    "JointSpec",
    "Load",
    "ModuleTemplate",
    "PoseSpec",
    "Violation",
    "Weight",
    "bent_configuration",
    "continuum_section",
    "smooth_configuration",
    "template",
]
