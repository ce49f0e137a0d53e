"""The loop, and what comes out of it."""

from pinposture.motion.batch import Batch
from pinposture.motion.files import load, save
from pinposture.motion.joint_trajectory import JointTrajectory
from pinposture.motion.track import track
from pinposture.motion.track_many import track_many
from pinposture.motion.tracker import Report, Tracker
from pinposture.motion.trajectory import Motion, Trajectory

__all__ = [
    "Batch",
    "JointTrajectory",
    "Motion",
    "Report",
    "Tracker",
    "Trajectory",
    "load",
    "save",
    "track",
    "track_many",
]
