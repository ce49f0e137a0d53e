"""What the user draws: a curve in space, measured by its arc length."""

from pinposture.curve.curve import Curve
from pinposture.curve.geometry import Nearest

__all__ = ["Curve", "Nearest"]
