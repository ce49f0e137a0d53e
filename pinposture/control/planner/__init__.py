"""The constrained controller: where to go, the most direct way there, a quadratic program for each step."""

from pinposture.control.planner.geodesic import Geodesic

__all__ = ["Geodesic"]
