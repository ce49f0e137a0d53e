"""How the arm moves: limits, the constrained controller, Selection, Projection, both by turns, and others."""

from pinposture.control.candidates import active_set, candidate_sets
from pinposture.control.constrained import ConstrainedQP
from pinposture.control.controller import Controller, Diagnostics, Memory, Step
from pinposture.control.limits import Box, Limits
from pinposture.control.names import CONTROLLERS, controller_named
from pinposture.control.projection import Projection
from pinposture.control.section_index import best_index, section_indices
from pinposture.control.sections import SectionSet, SectionTree
from pinposture.control.selection import Selection
from pinposture.control.switching import Switching
from pinposture.control.tasks import EndEffector, JointPosture, Tangents, Task, TaskRows

__all__ = [
    "CONTROLLERS",
    "Box",
    "ConstrainedQP",
    "Controller",
    "Diagnostics",
    "EndEffector",
    "JointPosture",
    "Limits",
    "Memory",
    "Projection",
    "SectionSet",
    "SectionTree",
    "Selection",
    "Step",
    "Switching",
    "Tangents",
    "Task",
    "TaskRows",
    "active_set",
    "best_index",
    "candidate_sets",
    "controller_named",
    "section_indices",
]
