"""What others would use, in the same protocol."""

from pinposture.control.baselines.augmented import AugmentedJacobian
from pinposture.control.baselines.damped import DampedLeastSquares
from pinposture.control.baselines.extended import ExtendedJacobian
from pinposture.control.baselines.joint import JointInterpolation
from pinposture.control.baselines.levenberg_marquardt import LevenbergMarquardt
from pinposture.control.baselines.objectives import OBJECTIVES, Objective, objective_gradient, objective_value
from pinposture.control.baselines.pseudo_inverse import PseudoInverse
from pinposture.control.baselines.task_constraints import TaskConstraints

__all__ = [
    "OBJECTIVES",
    "AugmentedJacobian",
    "DampedLeastSquares",
    "ExtendedJacobian",
    "JointInterpolation",
    "LevenbergMarquardt",
    "Objective",
    "PseudoInverse",
    "TaskConstraints",
    "objective_gradient",
    "objective_value",
]
