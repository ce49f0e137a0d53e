"""Compiled kernels: functions of plain arrays that run in every control cycle.

They are independent of arms and targets. Numba compiles them (`kernels.compiled`); each is imported on first
use, because numba is slow to import.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pinposture.kernels.bounding_volumes import build_tree as build_tree
    from pinposture.kernels.branch_search import minimise_posture_errors as minimise_posture_errors
    from pinposture.kernels.branch_search import search_branches as search_branches
    from pinposture.kernels.chain_solver import find_screws as find_screws
    from pinposture.kernels.chain_solver import measure_point_errors as measure_point_errors
    from pinposture.kernels.chain_solver import minimise_in_box as minimise_in_box
    from pinposture.kernels.chain_solver import minimise_points as minimise_points
    from pinposture.kernels.chain_solver import move_points as move_points
    from pinposture.kernels.chain_solver import stiffness as stiffness
    from pinposture.kernels.collision import contacts_along as contacts_along
    from pinposture.kernels.collision import differentiate_distances as differentiate_distances
    from pinposture.kernels.collision import near_pairs as near_pairs
    from pinposture.kernels.collision import place_axes as place_axes
    from pinposture.kernels.collision import place_joints as place_joints
    from pinposture.kernels.collision import smallest_distance as smallest_distance
    from pinposture.kernels.constrained_step import minimise_with_rows as minimise_with_rows
    from pinposture.kernels.continuous_collision import (
        smallest_distance_on_motions as smallest_distance_on_motions,
    )
    from pinposture.kernels.kinematics import carry_screws as carry_screws
    from pinposture.kernels.kinematics import jacobians as jacobians
    from pinposture.kernels.kinematics import joints_along as joints_along
    from pinposture.kernels.kinematics import motions_along as motions_along
    from pinposture.kernels.kinematics import placements as placements
    from pinposture.kernels.kinematics import trace_points as trace_points
    from pinposture.kernels.manipulability import all_indices as all_indices
    from pinposture.kernels.manipulability import base_indices as base_indices
    from pinposture.kernels.manipulability import best_branch as best_branch
    from pinposture.kernels.manipulability import best_path as best_path
    from pinposture.kernels.manipulability import module_spaces as module_spaces
    from pinposture.kernels.manipulability import stride_indices as stride_indices
    from pinposture.kernels.manipulability import weakest_index as weakest_index
    from pinposture.kernels.modules import circle_crossings as circle_crossings
    from pinposture.kernels.modules import circle_forward as circle_forward
    from pinposture.kernels.modules import circle_inverse as circle_inverse
    from pinposture.kernels.modules import neighbours as neighbours
    from pinposture.kernels.modules import place_modules as place_modules
    from pinposture.kernels.modules import roll_pitch_crossings as roll_pitch_crossings
    from pinposture.kernels.modules import roll_pitch_forward as roll_pitch_forward
    from pinposture.kernels.modules import roll_pitch_inverse as roll_pitch_inverse
    from pinposture.kernels.modules import torus_crossings as torus_crossings
    from pinposture.kernels.modules import torus_faces as torus_faces
    from pinposture.kernels.modules import torus_forward as torus_forward
    from pinposture.kernels.modules import torus_inverse as torus_inverse
    from pinposture.kernels.path_following import advance as advance
    from pinposture.kernels.path_following import find_speed_profile as find_speed_profile
    from pinposture.kernels.path_following import joint_distance as joint_distance
    from pinposture.kernels.path_following import look_ahead as look_ahead
    from pinposture.kernels.path_following import next_path_speed as next_path_speed
    from pinposture.kernels.path_following import position_excess as position_excess
    from pinposture.kernels.path_following import shorten_step as shorten_step
    from pinposture.kernels.path_following import spline_slopes as spline_slopes
    from pinposture.kernels.path_following import step_along as step_along
    from pinposture.kernels.path_following import step_box as step_box
    from pinposture.kernels.path_following import step_to as step_to
    from pinposture.kernels.path_following import stoppable_steps as stoppable_steps
    from pinposture.kernels.path_following import sum_point_errors as sum_point_errors
    from pinposture.kernels.path_relaxation import find_direct_waypoints as find_direct_waypoints
    from pinposture.kernels.path_relaxation import refine_waypoints as refine_waypoints
    from pinposture.kernels.path_relaxation import step_waypoints as step_waypoints
    from pinposture.kernels.posture_matrix import eliminated as eliminated
    from pinposture.kernels.posture_matrix import extreme_value as extreme_value
    from pinposture.kernels.posture_matrix import least_change as least_change
    from pinposture.kernels.posture_matrix import well_conditioned as well_conditioned
    from pinposture.kernels.spline import expand_spans as expand_spans
    from pinposture.kernels.spline import find_stationary_point as find_stationary_point
    from pinposture.kernels.spline import measure_length as measure_length
    from pinposture.kernels.spline import nearest_places as nearest_places
    from pinposture.kernels.spline import parameters_at as parameters_at
    from pinposture.kernels.spline import spline_coefficients as spline_coefficients
    from pinposture.kernels.spline import spline_values as spline_values
    from pinposture.kernels.target_point import module_ends as module_ends
    from pinposture.kernels.target_point import move_frame as move_frame
    from pinposture.kernels.target_point import next_target_point as next_target_point

_KERNELS = {
    "bounding_volumes": "build_tree",
    "branch_search": "minimise_posture_errors search_branches",
    "chain_solver": "find_screws measure_point_errors minimise_in_box minimise_points move_points stiffness",
    "collision": (
        "contacts_along differentiate_distances near_pairs place_axes place_joints smallest_distance"
    ),
    "constrained_step": "minimise_with_rows",
    "continuous_collision": "smallest_distance_on_motions",
    "kinematics": "carry_screws jacobians joints_along motions_along placements trace_points",
    "manipulability": (
        "all_indices base_indices best_branch best_path module_spaces stride_indices weakest_index"
    ),
    "modules": (
        "circle_crossings circle_forward circle_inverse neighbours place_modules roll_pitch_crossings "
        "roll_pitch_forward roll_pitch_inverse torus_crossings torus_faces torus_forward torus_inverse"
    ),
    "path_following": (
        "advance find_speed_profile joint_distance look_ahead next_path_speed position_excess shorten_step "
        "spline_slopes step_along step_box step_to stoppable_steps sum_point_errors"
    ),
    "path_relaxation": "find_direct_waypoints refine_waypoints step_waypoints",
    "posture_matrix": "eliminated extreme_value least_change well_conditioned",
    "spline": (
        "expand_spans find_stationary_point measure_length nearest_places parameters_at "
        "spline_coefficients spline_values"
    ),
    "target_point": "module_ends move_frame next_target_point",
}
"""The kernels called by other packages, by module."""

_HOMES = {name: module for module, names in _KERNELS.items() for name in names.split()}
NAMES = tuple(_HOMES)


def __getattr__(name: str) -> object:
    """Import a kernel on first access."""
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    kernel = getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
    globals()[name] = kernel
    return kernel


def load() -> None:
    """Compile all kernels, or load them from the cache, so that no later call has to wait.

    This takes half a second if they are cached, else about a minute.
    """
    from pinposture.kernels.compiled import load as load_kernel

    for name in NAMES:
        load_kernel(globals().get(name) or __getattr__(name))
