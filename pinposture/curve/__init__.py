"""Curves in space, parameterized by arc length."""

from pinposture.curve.curve import CURVES, HELIX, LINE, PLANAR_LINE, Curve
from pinposture.curve.geometry import Nearest

__all__ = ["CURVES", "HELIX", "LINE", "PLANAR_LINE", "Curve", "Nearest"]
