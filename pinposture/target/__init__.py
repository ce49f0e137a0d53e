"""Where each control point belongs: module kinematics, Algorithm 1, the target posture."""

from pinposture.target.measured import fit_points
from pinposture.target.resolve import resolve_targets
from pinposture.target.target import Target

__all__ = ["Target", "fit_points", "resolve_targets"]
