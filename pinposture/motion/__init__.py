"""The loop, and what comes out of it."""

from pinposture.motion.batch import Batch
from pinposture.motion.track import track
from pinposture.motion.track_many import track_many
from pinposture.motion.trajectory import Trajectory

__all__ = ["Batch", "Trajectory", "track", "track_many"]
