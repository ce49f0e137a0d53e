"""Compiled kernels: functions of plain arrays that run in every control cycle.

They are independent of arms and targets. Numba compiles them (`kernels.compiled`); each is imported on first
use, because numba is slow to import.
"""

# ruff: noqa: F403

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:  # for checkers and editors
    from pinposture.kernels.bounding_volumes import *
    from pinposture.kernels.branch_search import *
    from pinposture.kernels.chain_solver import *
    from pinposture.kernels.collision import *
    from pinposture.kernels.constrained_step import *
    from pinposture.kernels.continuous_collision import *
    from pinposture.kernels.dynamics import *
    from pinposture.kernels.joint_response import *
    from pinposture.kernels.kinematics import *
    from pinposture.kernels.manipulability import *
    from pinposture.kernels.modules import *
    from pinposture.kernels.occupancy import *
    from pinposture.kernels.path_following import *
    from pinposture.kernels.path_relaxation import *
    from pinposture.kernels.posture_matrix import *
    from pinposture.kernels.rate_of_change import *
    from pinposture.kernels.spline import *
    from pinposture.kernels.target_point import *
    from pinposture.kernels.tree_search import *

_KERNELS = {
    "bounding_volumes": "build_tree",
    "branch_search": "minimise_posture_errors search_branches",
    "chain_solver": "find_screws measure_point_errors minimise_in_box minimise_points move_points stiffness",
    "collision": (
        "contacts_along differentiate_distances near_pairs place_axes place_joints smallest_distance"
    ),
    "constrained_step": "minimise_with_rows",
    "continuous_collision": "check_motions smallest_distance_on_motions",
    "dynamics": "gravity_gradient gravity_torques inverse_dynamics path_torques step_loads",
    "joint_response": "follow_commands watch_joints",
    "kinematics": ("carry_screws jacobians joints_along motions_along move_frame placements trace_points"),
    "manipulability": (
        "all_indices base_indices best_branch best_path module_spaces section_indices_by_size weakest_index"
    ),
    "modules": "module_crossings module_faces module_forward module_inverse neighbours place_modules",
    "occupancy": "cast_rays clear_capsules find_surface forget_cells place_pixels read_cells",
    "path_following": (
        "fill_torque_rows find_speed_profile find_stop joint_distance look_ahead next_path_speed path_offset "
        "position_excess shorten_step smooth_offsets spline_slopes step_along step_box step_on_profile "
        "step_to stoppable_steps stopping_steps sum_point_errors take_steps"
    ),
    "path_relaxation": "divide_path find_direct_waypoints refine_waypoints step_waypoints",
    "posture_matrix": "eliminated extreme_value least_change well_conditioned",
    "rate_of_change": "fit_rate",
    "spline": (
        "expand_spans find_stationary_point measure_length nearest_parameters parameters_at "
        "spline_coefficients spline_values"
    ),
    "target_point": "next_target_point",
    "tree_search": "grow_trees",
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

    This takes a quarter of a second if they are cached, else about a minute.
    """
    from pinposture.kernels.compiled import load as load_kernel

    for name in NAMES:
        load_kernel(globals().get(name) or __getattr__(name))
