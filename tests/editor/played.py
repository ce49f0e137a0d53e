"""What the tests of preview, playback and export share: a motion, a clock that is set by hand."""

from __future__ import annotations

import time
from functools import cache

import numpy as np
from arms import template_arm

import pinposture as pp
from pinposture.editor.playback import Preview, PreviewResult
from pinposture.editor.session import Session
from pinposture.editor.solver import Live, Solver
from pinposture.motion import Run, Trajectory
from pinposture.task import Keyframe, Task

L = 0.2
"""Length of the arm of four modules [m]."""

LIMITS = pp.Limits(dt=0.02, velocity=2.0, acceleration=20.0)


def four_modules() -> pp.Arm:
    """The arm of the motions."""
    return template_arm("RyRz", 4)


@cache
def straight_line() -> pp.Curve:
    return pp.Curve.line((0.0, 0.0, 0.0), (L, 0.0, 0.0))


@cache
def bent_spline() -> pp.Curve:
    return pp.Curve.spline(
        L * np.array([(0, 0, 0), (0.4, 0, 0), (0.7, 0.1, 0.1), (1.0, 0.2, 0.1), (1.4, 0.2, 0)])
    )


@cache
def half_line() -> pp.Curve:
    """A line that is too short for the arm."""
    return pp.Curve.line((0.0, 0.0, 0.0), (0.5 * L, 0.0, 0.0))


class Clock:
    """A clock that only goes when it is told to."""

    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now


def short(**values: object) -> Task:
    """A task of two keyframes."""
    frames = (Keyframe(straight_line()), Keyframe(bent_spline(), time=1.0, trim=True))
    given = {"arm": four_modules(), "motion": frames, "limits": LIMITS, "name": "short"} | values
    return Task(**given)  # type: ignore[arg-type]


@cache
def moved() -> Trajectory:
    """The motion of such a task."""
    return short().perform()


def done(preview: Preview, task: Task, patience: float = 60.0) -> PreviewResult:
    """What came of a task, waited for."""
    end = time.monotonic() + patience
    while (found := preview.of(task)) is None:
        assert time.monotonic() < end, "nothing came of the task"
        time.sleep(0.005)
    return found


def live_of(session: Session) -> Live:
    """The arm of a session before anything moved."""
    return Solver(session.problem, session.arm.straight()).live


def by_hand(arm: pp.Arm, q: np.ndarray, off: np.ndarray, dt: float = 0.1) -> Trajectory:
    """A motion through configurations (N, nq), whose points miss their targets by `off`, (N, m, 3)."""
    rows = len(q)
    m = arm.n_modules
    points = np.array([arm.at(row).points for row in q])
    target = pp.Target(points[-1], np.ones(m))
    steps = rows - 1
    run = Run(
        arm=arm,
        target=target,
        controller="geodesic",
        limits=pp.Limits(step=None, dt=dt, velocity=2.0),
        status="converged",
        reason="",
        q=q,
        points=points,
        point_errors=np.linalg.norm(off, axis=2),
        active=np.ones((steps, m), dtype=np.bool_),
        clipped=np.zeros((steps, arm.nv), dtype=np.bool_),
        error_increasing=np.zeros(steps, dtype=np.bool_),
        violated_constraints=np.full(steps, ""),
        clearance=np.full(rows, np.inf),
    )
    asked = np.ones((rows, m), dtype=np.bool_)
    return Trajectory(run, points + off, asked, dt * np.arange(rows), 0, dt * steps)
