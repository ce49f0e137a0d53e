"""Runs, trajectories, batches, the streaming controller, and their files."""

from pinposture.motion.actuators import Actuators, Tendon
from pinposture.motion.batch import Batch
from pinposture.motion.files import load, save
from pinposture.motion.joint_trajectory import JointTrajectory
from pinposture.motion.ros import write_bag, write_goal
from pinposture.motion.run import Run
from pinposture.motion.track import track
from pinposture.motion.track_many import track_many
from pinposture.motion.tracker import Report, Tracker
from pinposture.motion.trajectory import Trajectory

__all__ = [
    "Actuators",
    "Batch",
    "JointTrajectory",
    "Report",
    "Run",
    "Tendon",
    "Tracker",
    "Trajectory",
    "load",
    "save",
    "track",
    "track_many",
    "write_bag",
    "write_goal",
]
