"""Target posture of an arm: module kinematics, placement on a curve, fit to points."""

from pinposture.placement.points import PointFilter, fit_points
from pinposture.placement.resolve import resolve_targets
from pinposture.placement.target import Target

__all__ = ["PointFilter", "Target", "fit_points", "resolve_targets"]
