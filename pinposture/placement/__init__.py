"""Where each control point belongs: module kinematics, Algorithm 1, the target posture."""

from pinposture.placement.points import fit_points
from pinposture.placement.resolve import resolve_targets
from pinposture.placement.target import Target

__all__ = ["Target", "fit_points", "resolve_targets"]
