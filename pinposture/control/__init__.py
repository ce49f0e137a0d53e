"""How the arm moves: limits, candidate control sets, the Selection and Projection methods, both by turns."""

from pinposture.control.candidates import active_set, candidate_sets
from pinposture.control.controller import Controller, Diagnostics, Memory, Step
from pinposture.control.limits import Limits
from pinposture.control.names import CONTROLLERS, controller_named
from pinposture.control.projection import Projection
from pinposture.control.section_index import best_index, section_indices
from pinposture.control.sections import SectionSet, SectionTree
from pinposture.control.selection import Selection
from pinposture.control.switching import Switching

__all__ = [
    "CONTROLLERS",
    "Controller",
    "Diagnostics",
    "Limits",
    "Memory",
    "Projection",
    "SectionSet",
    "SectionTree",
    "Selection",
    "Step",
    "Switching",
    "active_set",
    "best_index",
    "candidate_sets",
    "controller_named",
    "section_indices",
]
