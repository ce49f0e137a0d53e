"""The search for a configuration that takes a posture: damped least squares along the chain."""

from __future__ import annotations

import numpy as np

from pinposture.kernels.arrays import Array1, PointObjective, PostureProblem, SearchSettings
from pinposture.kernels.chain_solver import find_screws, measure_point_errors, minimise_in_box, stiffness
from pinposture.kernels.compiled import compiled
from pinposture.kernels.kinematics import placements


@compiled
def minimise_posture_errors(
    problem: PostureProblem, settings: SearchSettings, positions: Array1
) -> tuple[float, float]:
    """Search for a minimum of the squared errors of points and chords, step by step.

    Args:
        problem: where the control points should be.
        settings: settings of the search.
        positions: joint positions to begin with, (nv,); filled with those at the end.

    Returns:
        The sum of squares and the mean error there.
    """
    chain, joints, units, edges, indices, ends, targets, weights, chords, normal = problem
    n, p, m, columns = len(joints), len(indices), len(chain.ends), chain.inputs
    axes, origins = np.empty((len(chain.slides), 3)), np.empty((len(chain.slides), 3))
    every, rotations = np.empty((m, 3)), np.empty((m, 3, 3))
    points, errors, screws = np.empty((p, 3)), np.empty((p, 3)), np.empty((n, 6))
    tried, x, centre, damping = positions.copy(), np.empty(n), np.zeros(n), np.empty(n)
    lower, upper, sides = np.empty(n), np.empty(n), np.zeros(n, dtype=np.int8)
    factor, idle, squares, mean = 1.0, 0, np.inf, np.inf
    for step in range(settings.steps + 1):
        placements(chain, tried, axes, origins, every, rotations)
        for k in range(p):
            points[k] = every[indices[k]]
        found = measure_point_errors(points, targets, weights, chords, normal, errors)
        if found < squares:
            idle = idle + 1 if found > (1.0 - settings.converged) * squares else 0
            factor = max(factor * settings.decrease, settings.least_factor) if step else factor
            squares, mean, largest = found, 0.0, 0.0
            positions[:] = tried
            for k in range(p):
                size = np.sqrt(errors[k, 0] ** 2 + errors[k, 1] ** 2 + errors[k, 2] ** 2)
                mean += size / p
                largest = max(largest, size)
            if mean <= settings.good:
                break
            scale = min(1.0, settings.largest_error / max(largest, 1e-300))
            find_screws(chain, joints, units, axes, origins, ends, points, screws)
            objective = PointObjective(screws, ends, points.copy(), weights, chords)
            wanted = scale * errors
            least = settings.least_damping * max(stiffness(objective), settings.least_stiffness)
            for u in range(n):
                here = positions[columns[joints[u]]]
                lower[u] = min(max((edges[0, u] - here) / units[u], -settings.largest_step), 0.0)
                upper[u] = max(min((edges[1, u] - here) / units[u], settings.largest_step), 0.0)
        else:
            factor *= settings.increase
            idle += factor > settings.most_factor
        if idle >= settings.idle or step == settings.steps:
            break
        damping[:] = factor * settings.damping_share * scale**2 * squares + least
        sides[:] = 0
        minimise_in_box(objective, wanted, damping, centre, lower, upper, sides, x)
        for u in range(n):
            j = columns[joints[u]]
            tried[j] = positions[j] + x[u] * units[u]
    return squares, mean
