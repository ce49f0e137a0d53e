"""How the arm moves: limits, the planner and its controller, the methods of the thesis, and tasks."""

from pinposture.control.constraint import Constraint
from pinposture.control.controller import Controller, JointInterpolation, Memory, Step
from pinposture.control.hold import Hold, Support, assess_hold, assess_support
from pinposture.control.limits import Limits, StepBounds
from pinposture.control.measured_points import PointFilter, fit_points
from pinposture.control.planner.follow import GeodesicMemory, PathProgress, follow
from pinposture.control.planner.geodesic import Geodesic
from pinposture.control.planner.objective import Objective
from pinposture.control.planner.path import JointPath, TimedPath, retime
from pinposture.control.planner.plan import plan
from pinposture.control.reach import ReachedPosture, reach
from pinposture.control.registry import CONTROLLERS, controller_named
from pinposture.control.tasks import ControlTask, EndEffector, JointPosture, Tangents, TaskRows
from pinposture.control.thesis.null_space import JointSpeeds, ObstaclePotential
from pinposture.control.thesis.projection import Projection
from pinposture.control.thesis.sections import SectionSet, SectionTree, best_index, section_indices
from pinposture.control.thesis.selection import Selection, active_set, candidate_sets
from pinposture.control.thesis.switching import Switching

__all__ = [
    "CONTROLLERS",
    "Constraint",
    "ControlTask",
    "Controller",
    "EndEffector",
    "Geodesic",
    "GeodesicMemory",
    "Hold",
    "JointInterpolation",
    "JointPath",
    "JointPosture",
    "JointSpeeds",
    "Limits",
    "Memory",
    "Objective",
    "ObstaclePotential",
    "PathProgress",
    "PointFilter",
    "Projection",
    "ReachedPosture",
    "SectionSet",
    "SectionTree",
    "Selection",
    "Step",
    "StepBounds",
    "Support",
    "Switching",
    "Tangents",
    "TaskRows",
    "TimedPath",
    "active_set",
    "assess_hold",
    "assess_support",
    "best_index",
    "candidate_sets",
    "controller_named",
    "fit_points",
    "follow",
    "plan",
    "reach",
    "retime",
    "section_indices",
]
