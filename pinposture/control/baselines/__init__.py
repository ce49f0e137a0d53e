"""What others would use, in the same protocol."""

from pinposture.control.baselines.joint import JointInterpolation

__all__ = ["JointInterpolation"]
