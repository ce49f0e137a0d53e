"""Obstacles whose extent is known by hand."""

from __future__ import annotations

import numpy as np

import pinposture as pp

TETRAHEDRON = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.0, 0.2, 0.0], [0.0, 0.0, 0.3]])
QUARTER = ((0.0, -1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0))  # a quarter turn about z

# Name: obstacle, lower and upper ends of the box around it, its volume [m^3].
SOLIDS = {
    "sphere": (
        pp.Sphere((0.3, 0.2, 0.1), 0.08),
        (0.22, 0.12, 0.02),
        (0.38, 0.28, 0.18),
        4 / 3 * np.pi * 0.08**3,
    ),
    "capsule": (
        pp.Capsule((0.2, -0.2, 0.0), (0.2, -0.2, 0.25), 0.05),
        (0.15, -0.25, -0.05),
        (0.25, -0.15, 0.30),
        np.pi * 0.05**2 * 0.25 + 4 / 3 * np.pi * 0.05**3,
    ),
    "cylinder": (
        pp.Cylinder((0.1, 0.3, 0.1), (0.4, 0.3, 0.1), 0.06),
        (0.1, 0.24, 0.04),
        (0.4, 0.36, 0.16),
        np.pi * 0.06**2 * 0.3,
    ),
    "box": (
        pp.Box((0.5, 0.0, -0.2), (0.1, 0.3, 0.2), QUARTER),
        (0.35, -0.05, -0.3),
        (0.65, 0.05, -0.1),
        0.1 * 0.3 * 0.2,
    ),
    "mesh": (
        pp.Mesh(TETRAHEDRON, (0.4, 0.3, 0.1), QUARTER),
        (0.2, 0.3, 0.1),
        (0.4, 0.4, 0.4),
        0.1 * 0.2 * 0.3 / 6,
    ),
}
