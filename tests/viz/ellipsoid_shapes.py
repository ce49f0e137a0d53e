"""Arms, a run, and the ellipsoids that their velocities make, without singular values."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
from arms import template_arm

import pinposture as pp


def spatial() -> pp.Arm:
    return template_arm("RyRz", 6)


def planar() -> pp.Arm:
    return template_arm("Rz", 5, (0.1,))


def gram(arm: pp.Arm, q: np.ndarray, point: int) -> np.ndarray:
    """J J^T of a control point in the world, (3, 3), from differences of its positions."""
    steps = 1e-6 * np.eye(arm.nv)
    ahead, back = ([arm.at(arm.integrate(q, s * step)).points[point] for step in steps] for s in (1, -1))
    jacobian = (np.array(ahead) - np.array(back)).T / 2e-6
    return jacobian @ jacobian.T


def levels(points: np.ndarray, arm: pp.Arm, q: np.ndarray, point: int, scale: float) -> np.ndarray:
    """(x - c)^T (scale^2 J J^T)^-1 (x - c) of points (n, 3) in the world: 1 on the surface, less inside."""
    along = (points - arm.at(q).points[point]) @ arm.plane.T
    shape = scale**2 * arm.plane @ gram(arm, q, point) @ arm.plane.T
    return np.einsum("ni,ij,nj->n", along, np.linalg.inv(shape), along)


@cache
def some_run(arm: pp.Arm, steps: int = 40) -> pp.Run:
    """A smooth motion from almost straight to strongly bent."""
    goal = np.random.default_rng(4).uniform(-1.2, 1.2, arm.nv)
    run = pp.track(arm, pp.Target.from_configuration(arm, goal), np.zeros(arm.nv), "projection", max_steps=1)
    q = np.linspace(0.02, 1.0, steps + 1)[:, None] * goal
    points = np.array([arm.at(row).points for row in q])
    errors = np.zeros((steps + 1, arm.n_modules))
    return replace(run, q=q, points=points, point_errors=errors, active=np.ones((steps, arm.n_modules), bool))
