"""How the arm moves: limits, candidate control sets, the Selection and Projection methods."""

from pinposture.control.candidates import active_set, candidate_sets
from pinposture.control.controller import Controller, Diagnostics, Memory, Step
from pinposture.control.limits import Limits
from pinposture.control.names import CONTROLLERS, controller_named
from pinposture.control.projection import Projection
from pinposture.control.selection import Selection

__all__ = [
    "CONTROLLERS",
    "Controller",
    "Diagnostics",
    "Limits",
    "Memory",
    "Projection",
    "Selection",
    "Step",
    "active_set",
    "candidate_sets",
    "controller_named",
]
