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
    from pinposture.kernels.bounded import minimise_in_box as minimise_in_box
    from pinposture.kernels.boxes import above_boxes as above_boxes
    from pinposture.kernels.braking import shorten_step as shorten_step
    from pinposture.kernels.braking import step_box as step_box
    from pinposture.kernels.braking import stoppable_steps as stoppable_steps
    from pinposture.kernels.branches import best_branch as best_branch
    from pinposture.kernels.course import advance as advance
    from pinposture.kernels.course import joint_distance as joint_distance
    from pinposture.kernels.course import look_ahead as look_ahead
    from pinposture.kernels.course import position_excess as position_excess
    from pinposture.kernels.course import step_along as step_along
    from pinposture.kernels.course import sum_distances as sum_distances
    from pinposture.kernels.elimination import eliminated as eliminated
    from pinposture.kernels.elimination import least_change as least_change
    from pinposture.kernels.in_turn import take_points as take_points
    from pinposture.kernels.kinematics import jacobians as jacobians
    from pinposture.kernels.kinematics import placements as placements
    from pinposture.kernels.modules import circle_crossings as circle_crossings
    from pinposture.kernels.modules import circle_forward as circle_forward
    from pinposture.kernels.modules import circle_inverse as circle_inverse
    from pinposture.kernels.modules import torus_crossings as torus_crossings
    from pinposture.kernels.modules import torus_faces as torus_faces
    from pinposture.kernels.modules import torus_forward as torus_forward
    from pinposture.kernels.modules import torus_inverse as torus_inverse
    from pinposture.kernels.nearest import nearest_places as nearest_places
    from pinposture.kernels.pace import find_pace as find_pace
    from pinposture.kernels.pace import next_pace as next_pace
    from pinposture.kernels.pairs import all_indices as all_indices
    from pinposture.kernels.pairs import base_indices as base_indices
    from pinposture.kernels.pairs import best_path as best_path
    from pinposture.kernels.pairs import stride_indices as stride_indices
    from pinposture.kernels.pairs import weakest_index as weakest_index
    from pinposture.kernels.relaxation import measure_ways as measure_ways
    from pinposture.kernels.relaxation import relax_waypoints as relax_waypoints
    from pinposture.kernels.rows import joints_along as joints_along
    from pinposture.kernels.rows import motions_along as motions_along
    from pinposture.kernels.spaces import module_spaces as module_spaces
    from pinposture.kernels.spectrum import extreme_value as extreme_value
    from pinposture.kernels.spectrum import inverse_norm as inverse_norm
    from pinposture.kernels.spline import spline_coefficients as spline_coefficients
    from pinposture.kernels.spline import spline_values as spline_values
    from pinposture.kernels.springs import find_screws as find_screws
    from pinposture.kernels.springs import measure_misses as measure_misses
    from pinposture.kernels.springs import move_points as move_points
    from pinposture.kernels.springs import stiffness as stiffness
    from pinposture.kernels.standstill import find_standstill as find_standstill
    from pinposture.kernels.walk import neighbours as neighbours
    from pinposture.kernels.walk import walk_along as walk_along

_HOMES = {
    "expand_spans": "arclength",
    "measure_length": "arclength",
    "parameters_at": "arclength",
    "minimise_in_box": "bounded",
    "above_boxes": "boxes",
    "step_box": "braking",
    "stoppable_steps": "braking",
    "shorten_step": "braking",
    "best_branch": "branches",
    "advance": "course",
    "step_along": "course",
    "joint_distance": "course",
    "sum_distances": "course",
    "look_ahead": "course",
    "position_excess": "course",
    "eliminated": "elimination",
    "least_change": "elimination",
    "take_points": "in_turn",
    "jacobians": "kinematics",
    "placements": "kinematics",
    "measure_misses": "springs",
    "move_points": "springs",
    "find_screws": "springs",
    "stiffness": "springs",
    "circle_crossings": "modules",
    "circle_forward": "modules",
    "circle_inverse": "modules",
    "torus_crossings": "modules",
    "torus_faces": "modules",
    "torus_forward": "modules",
    "torus_inverse": "modules",
    "nearest_places": "nearest",
    "find_pace": "pace",
    "next_pace": "pace",
    "all_indices": "pairs",
    "base_indices": "pairs",
    "best_path": "pairs",
    "stride_indices": "pairs",
    "weakest_index": "pairs",
    "relax_waypoints": "relaxation",
    "measure_ways": "relaxation",
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


def load() -> None:
    """Compile all kernels, or load them where they are kept, so that no later call has to wait.

    It takes half a second if they are compiled, else about a minute.
    """
    from pinposture.kernels.compiled import load as load_kernel

    for name in NAMES:
        load_kernel(globals().get(name) or __getattr__(name))
