"""The loop, and what comes out of it."""

from pinposture.motion.track import track
from pinposture.motion.trajectory import Trajectory

__all__ = ["Trajectory", "track"]
