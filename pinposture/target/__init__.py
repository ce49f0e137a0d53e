"""Where each control point belongs: module kinematics, Algorithm 1, the target posture."""

from pinposture.target.resolve import resolve_targets
from pinposture.target.target import Target

__all__ = ["Target", "resolve_targets"]
