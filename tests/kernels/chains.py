"""Random chains as kernels see them, and their dense matrices by another way."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pinposture import kernels
from pinposture.kernels.arrays import JOINT, ArmArrays, Joints, PointObjective

Array = NDArray[np.float64]


class Problem(NamedTuple):
    """A least-squares problem along a chain, and the same as dense rows |A x - r|^2 + sum D (x - z)^2."""

    springs: PointObjective
    errors: Array
    damping: Array
    centre: Array
    rows: Array
    right: Array

    def dense(self) -> tuple[Array, Array]:
        """Hessian and gradient at zero, halved: x^T H x / 2 + g^T x."""
        hessian = self.rows.T @ self.rows + np.diag(self.damping)
        return hessian, -(self.rows.T @ self.right) - self.damping * self.centre


def problem(rng: np.random.Generator, modules: int, damping: float, straight: bool = False) -> Problem:
    """A chain of modules of one to three joints that turn or slide, with points that weigh differently.

    Its Jacobians come from the positions of axes and points alone: d p / d x = a x (p - o), joint by joint.
    """
    sizes = rng.integers(1, 4, modules)
    ends = np.cumsum(sizes)
    n = int(ends[-1]) + int(rng.integers(0, 3))  # some joints after the last point
    steps = rng.normal(size=(n + modules, 3)) * 0.03
    if straight:
        steps = np.tile([0.05, 0.0, 0.0], (n + modules, 1))
    stations = np.cumsum(steps, axis=0)
    axes = rng.normal(size=(n, 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    slides = rng.random(n) < 0.15
    units = np.where(slides, rng.uniform(0.02, 0.2), 1.0)
    module = np.searchsorted(ends, np.arange(n), side="right")
    origins = stations[np.arange(n) + module]
    points = stations[ends + np.arange(modules)]
    jacobians = np.zeros((modules, 3, n))
    for k in range(modules):
        for u in range(ends[k]):
            turned = axes[u] if slides[u] else np.cross(axes[u], points[k] - origins[u])
            jacobians[k, :, u] = units[u] * turned
    weights = rng.uniform(0.2, 3.0, modules)
    chords = rng.uniform(0.0, 2.0, modules) * (rng.random(modules) > 0.2)
    errors = rng.normal(size=(modules, 3)) * 0.1
    relative = np.diff(jacobians, axis=0, prepend=0.0)
    apart = np.diff(errors, axis=0, prepend=0.0)
    rows = np.concatenate(
        [np.sqrt(weights)[:, None, None] * jacobians, np.sqrt(chords)[:, None, None] * relative]
    )
    right = np.concatenate([np.sqrt(weights)[:, None] * errors, np.sqrt(chords)[:, None] * apart])
    screws = np.empty((n, 6))
    ends = ends.astype(np.int64)
    kernels.find_screws(chain_of(slides), np.arange(n), units, axes, origins, ends, points, screws)
    return Problem(
        PointObjective(screws, ends, points, weights, chords),
        errors,
        damping * rng.uniform(0.5, 2.0, n),
        rng.normal(size=n) * 0.05,
        rows.reshape(-1, n),
        right.ravel(),
    )


def chain_of(slides: np.ndarray) -> ArmArrays:
    """A chain of which only the kinds of the joints are asked for."""
    n = len(slides)
    none = np.zeros((0, 3))
    each = np.arange(n, dtype=np.int64)
    ends = np.zeros(0, dtype=np.int64)
    kinds = np.where(slides, JOINT.prismatic, JOINT.revolute)
    joints = Joints(each, kinds, np.zeros((n, 3)), np.zeros((n, 3)), each, np.ones(n))
    starts = np.arange(n + 1, dtype=np.int64)
    return ArmArrays(joints, ends, none, np.zeros((0, 3, 3)), each, each, starts)
