"""How the arm moves: limits, the constrained controller, Selection, Projection, both by turns, and others."""

from pinposture.control.controller import Controller, Diagnostics, Memory, Step
from pinposture.control.joint_interpolation import JointInterpolation
from pinposture.control.limits import Limits, StepBox
from pinposture.control.planner import Geodesic
from pinposture.control.registry import CONTROLLERS, controller_named
from pinposture.control.tasks import ControlTask, EndEffector, JointPosture, Tangents, TaskRows
from pinposture.control.thesis.projection import Projection
from pinposture.control.thesis.sections import SectionSet, SectionTree, best_index, section_indices
from pinposture.control.thesis.selection import Selection, active_set, candidate_sets
from pinposture.control.thesis.switching import Switching

__all__ = [
    "CONTROLLERS",
    "ControlTask",
    "Controller",
    "Diagnostics",
    "EndEffector",
    "Geodesic",
    "JointInterpolation",
    "JointPosture",
    "Limits",
    "Memory",
    "Projection",
    "SectionSet",
    "SectionTree",
    "Selection",
    "Step",
    "StepBox",
    "Switching",
    "Tangents",
    "TaskRows",
    "active_set",
    "best_index",
    "candidate_sets",
    "controller_named",
    "section_indices",
]
