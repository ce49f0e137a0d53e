"""Motions in time whose every number is known, because nothing was performed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from arms import template_arm

import pinposture as pp
from pinposture.motion.trajectory import Trajectory, WaypointResult

LIMITS = pp.Limits(step=None, dt=0.05, velocity=2.0, acceleration=30.0)


def five_modules() -> pp.Arm:
    """The arm of the motions."""
    return template_arm("RyRz", 5)


def around_a_ball() -> pp.Scene:
    """A scene for it."""
    return pp.Scene({"ball": pp.Sphere((0.1, 0.3, 0.2), 0.05)})


def some_motion(
    steps: int = 60,
    arm: pp.Arm | None = None,
    limits: pp.Limits = LIMITS,
    scene: pp.Scene | None = None,
    planned: float | None = None,
    start_index: int = 0,
    names: tuple[str, ...] = ("straight", "S", "coil"),
    off: float = 1e-3,
) -> Trajectory:
    """A motion from one posture to another and on to a third.

    Its targets are `off` [m] beside the control points in every row. Its clock runs evenly, so that it takes
    `planned`; named places are at equal distances.
    """
    arm = arm or five_modules()
    dt = limits.dt
    rng = np.random.default_rng(0)
    begin, over, end = (rng.uniform(-0.4, 0.4, arm.nv) for _ in range(3))
    t = np.linspace(0.0, 1.0, steps + 1)[:, None]
    smooth = t * t * (3.0 - 2.0 * t)
    positions = begin + smooth * (end - begin) + np.sin(np.pi * smooth) ** 2 * over
    q = np.array([arm.configuration(row) for row in positions])
    points = np.array([arm.at(row).points for row in q])
    target = pp.Target.from_points(arm, points[-1])
    known = pp.track(arm, target, q[0], max_steps=1)
    clearance = np.full(steps + 1, np.inf)
    if scene is not None:
        clearance = np.array([pp.CollisionModel(arm, scene).minimum(row).distance for row in q])
    run = replace(
        known,
        status="converged",
        reason="it is there",
        limits=limits,
        scene=scene,
        q=q,
        points=points,
        point_errors=np.full((steps + 1, arm.n_modules), off),
        active=np.ones((steps, arm.n_modules), dtype=bool),
        clearance=clearance,
        clipped=np.zeros((steps, arm.nv), dtype=bool),
        error_increasing=np.zeros(steps, dtype=bool),
        violated_constraints=np.full(steps, ""),
    )
    taken = (steps - start_index) * dt
    planned = taken if planned is None else planned
    clock = np.concatenate([np.zeros(start_index), np.linspace(0.0, planned, steps - start_index + 1)])
    clock[-1] = planned
    rows = np.linspace(start_index, steps, len(names)).round().astype(int)
    passed = [
        WaypointResult(name, float(clock[row]), (int(row) - start_index) * dt, int(row), off)
        for name, row in zip(names, rows, strict=True)
    ]
    aside = points + off * np.array([0.0, 0.0, 1.0])
    asked = np.ones((steps + 1, arm.n_modules), dtype=bool)
    return Trajectory(run, aside, asked, clock, start_index, planned, tuple(passed))
