"""Compiled kernels: passes along a chain, on plain arrays.

Whatever runs in every control cycle and cannot be put into a few NumPy calls. Kernels know arrays only, no
arm and no target; the rooms above say what the numbers mean. They are compiled by numba, see
`kernels.compiled`, and imported when first used: numba takes a while to start.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pinposture.kernels.arclength import expand_spans as expand_spans
    from pinposture.kernels.arclength import measure_length as measure_length
    from pinposture.kernels.arclength import parameters_at as parameters_at
    from pinposture.kernels.bounded import boxed as boxed
    from pinposture.kernels.braking import box as box
    from pinposture.kernels.braking import farthest as farthest
    from pinposture.kernels.braking import shortened as shortened
    from pinposture.kernels.branches import best_branch as best_branch
    from pinposture.kernels.course import advance as advance
    from pinposture.kernels.course import along as along
    from pinposture.kernels.course import apart as apart
    from pinposture.kernels.course import distance as distance
    from pinposture.kernels.course import outcome as outcome
    from pinposture.kernels.course import outside as outside
    from pinposture.kernels.elimination import eliminated as eliminated
    from pinposture.kernels.elimination import least_change as least_change
    from pinposture.kernels.in_turn import take_points as take_points
    from pinposture.kernels.kinematics import jacobians as jacobians
    from pinposture.kernels.kinematics import placements as placements
    from pinposture.kernels.least_squares import misses as misses
    from pinposture.kernels.least_squares import motions as motions
    from pinposture.kernels.least_squares import screws as screws
    from pinposture.kernels.least_squares import stiffness as stiffness
    from pinposture.kernels.modules import circle_crossings as circle_crossings
    from pinposture.kernels.modules import circle_forward as circle_forward
    from pinposture.kernels.modules import circle_inverse as circle_inverse
    from pinposture.kernels.modules import torus_crossings as torus_crossings
    from pinposture.kernels.modules import torus_faces as torus_faces
    from pinposture.kernels.modules import torus_forward as torus_forward
    from pinposture.kernels.modules import torus_inverse as torus_inverse
    from pinposture.kernels.nearest import nearest_places as nearest_places
    from pinposture.kernels.pairs import all_indices as all_indices
    from pinposture.kernels.pairs import base_indices as base_indices
    from pinposture.kernels.pairs import best_path as best_path
    from pinposture.kernels.pairs import stride_indices as stride_indices
    from pinposture.kernels.pairs import weakest_index as weakest_index
    from pinposture.kernels.relaxation import relaxed as relaxed
    from pinposture.kernels.relaxation import travelled as travelled
    from pinposture.kernels.rows import joints_along as joints_along
    from pinposture.kernels.rows import motions_along as motions_along
    from pinposture.kernels.spaces import module_spaces as module_spaces
    from pinposture.kernels.spectrum import extreme_value as extreme_value
    from pinposture.kernels.spectrum import inverse_norm as inverse_norm
    from pinposture.kernels.spline import spline_coefficients as spline_coefficients
    from pinposture.kernels.spline import spline_values as spline_values
    from pinposture.kernels.standstill import find_standstill as find_standstill
    from pinposture.kernels.walk import neighbours as neighbours
    from pinposture.kernels.walk import walk_along as walk_along

_HOMES = {
    "expand_spans": "arclength",
    "measure_length": "arclength",
    "parameters_at": "arclength",
    "boxed": "bounded",
    "box": "braking",
    "farthest": "braking",
    "shortened": "braking",
    "best_branch": "branches",
    "advance": "course",
    "along": "course",
    "apart": "course",
    "distance": "course",
    "outcome": "course",
    "outside": "course",
    "eliminated": "elimination",
    "least_change": "elimination",
    "take_points": "in_turn",
    "jacobians": "kinematics",
    "placements": "kinematics",
    "misses": "least_squares",
    "motions": "least_squares",
    "screws": "least_squares",
    "stiffness": "least_squares",
    "circle_crossings": "modules",
    "circle_forward": "modules",
    "circle_inverse": "modules",
    "torus_crossings": "modules",
    "torus_faces": "modules",
    "torus_forward": "modules",
    "torus_inverse": "modules",
    "nearest_places": "nearest",
    "all_indices": "pairs",
    "base_indices": "pairs",
    "best_path": "pairs",
    "stride_indices": "pairs",
    "weakest_index": "pairs",
    "relaxed": "relaxation",
    "travelled": "relaxation",
    "joints_along": "rows",
    "motions_along": "rows",
    "module_spaces": "spaces",
    "extreme_value": "spectrum",
    "inverse_norm": "spectrum",
    "spline_coefficients": "spline",
    "spline_values": "spline",
    "find_standstill": "standstill",
    "neighbours": "walk",
    "walk_along": "walk",
}

NAMES = tuple(_HOMES)
"""The kernels that other rooms call."""


def __getattr__(name: str) -> object:
    """Import a kernel when it is first asked for."""
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    kernel = getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
    globals()[name] = kernel
    return kernel
