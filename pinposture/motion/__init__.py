"""Runs, trajectories, batches, the streaming controller, and their files."""

from pinposture.motion.actuators import Actuators, Tendon
from pinposture.motion.batch import Batch, track_many
from pinposture.motion.drive_response import DriveModel
from pinposture.motion.feedback import JointFailure
from pinposture.motion.files import load, save
from pinposture.motion.identification import (
    DriveEstimate,
    Estimate,
    Identification,
    Prediction,
    Timing,
    identify,
)
from pinposture.motion.joint_trajectory import JointTrajectory
from pinposture.motion.log import Log
from pinposture.motion.ros import write_bag, write_goal
from pinposture.motion.run import Run
from pinposture.motion.shape_estimator import ShapeEstimator
from pinposture.motion.touch import Touch
from pinposture.motion.track import track
from pinposture.motion.tracker import Report, Tracker
from pinposture.motion.trajectory import Trajectory

__all__ = [
    "Actuators",
    "Batch",
    "DriveEstimate",
    "DriveModel",
    "Estimate",
    "Identification",
    "JointFailure",
    "JointTrajectory",
    "Log",
    "Prediction",
    "Report",
    "Run",
    "ShapeEstimator",
    "Tendon",
    "Timing",
    "Touch",
    "Tracker",
    "Trajectory",
    "identify",
    "load",
    "save",
    "track",
    "track_many",
    "write_bag",
    "write_goal",
]
