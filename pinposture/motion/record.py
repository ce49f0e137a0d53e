"""What is written down while an arm moves."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pinposture.arm import Arm, ArmState
from pinposture.control import Controller, Diagnostics, Limits, Step
from pinposture.motion.trajectory import Trajectory
from pinposture.scene import Scene
from pinposture.target import Target

Array = NDArray[np.float64]


MENTIONED = 8
"""How many constraints that gave way are written down of each step."""

ROUNDING = 1e-12
"""Rise of the posture error that is none, in arm lengths."""


class Recorder:
    """Collects states and steps, and turns them into a trajectory.

    Args:
        target: where the control points should be, until a step comes with another target.
        start: where the arm begins.
        scene: what its distances are recorded from; none if None.
    """

    def __init__(self, target: Target, start: ArmState, scene: Scene | None = None) -> None:
        self._target, self._scene = target, scene
        self._clearance = None if scene is None else scene.around(start.arm)
        self._distances = [self._distance(start)]
        self._steps: list[Step] = []
        self._last = start
        self._q, self._points, self._errors = [start.q], [start.points], [self._point_errors(start)]
        self.aim(target)

    def aim(self, target: Target) -> None:
        """Turn to another target: progress is measured against it from now on."""
        self._target = target
        self._now = self._point_errors(self._last)
        self._best, self._idle = self.posture_error, 0.0

    def rises(self, state: ArmState) -> bool:
        """Whether the posture error is larger at a state than now, by more than rounding."""
        return float(self._point_errors(state).sum()) > self.posture_error + ROUNDING * state.arm.length

    def _point_errors(self, state: ArmState) -> Array:
        return np.asarray(np.linalg.norm(self._target.points - state.points, axis=1) * self._target.placed)

    def _distance(self, state: ArmState) -> float:
        return np.inf if self._clearance is None else self._clearance.minimum(state.q).distance

    @property
    def steps(self) -> int:
        """Number of steps so far."""
        return len(self._steps)

    @property
    def posture_error(self) -> float:
        """Sum of the distances of the control points from their targets, now [m]."""
        return float(self._now.sum())

    @property
    def mean_error(self) -> float:
        """Mean distance of the control points that have a target from it, now [m]."""
        return self.posture_error / int(np.count_nonzero(self._target.placed))

    def add(self, state: ArmState, step: Step, travel: float, target: Target | None = None) -> None:
        """Write down one step and the state it led to.

        Args:
            state: the state.
            step: the step.
            travel: joint travel that the limits allowed in it [rad].
            target: where the control points should be now, if that has changed.
        """
        self._target = self._target if target is None else target
        self._steps.append(step._replace(diagnostics=_settled(step.diagnostics)))
        if not step.diagnostics.on_way:  # else the arm is not stuck
            self._idle += travel
        self._q.append(state.q)
        self._distances.append(self._distance(state))
        self._points.append(state.points)
        self._last, self._now = state, self._point_errors(state)
        self._errors.append(self._now)

    def travel_without_progress(self, share: float) -> float:
        """Joint travel since the posture error last fell by this share below its lowest before [rad].

        It is the travel that the limits allowed, escapes apart, so that it means the same at any rate.
        """
        if self.posture_error < self._best * (1.0 - share):
            self._best, self._idle = self.posture_error, 0.0
        return self._idle

    def trajectory(
        self, arm: Arm, controller: Controller, limits: Limits, status: str, reason: str
    ) -> Trajectory:
        """Everything so far, as a result; steps that exceed limits are named by what came of them."""
        steps = self._steps
        active = np.zeros((len(steps), arm.n_modules), dtype=bool)
        for row, step in zip(active, steps, strict=True):
            row[list(step.active)] = True
        notes = [step.diagnostics for step in steps]
        run = Trajectory(
            arm=arm,
            target=self._target,
            controller=repr(controller),
            limits=limits,
            status=status,
            reason=reason,
            q=np.array(self._q),
            points=np.array(self._points),
            point_errors=np.array(self._errors),
            active=active,
            index=np.array([note.manipulability for note in notes]),
            sigma_min=np.array([note.sigma_min for note in notes]),
            sigma_max=np.array([note.sigma_max for note in notes]),
            rows=np.array([note.rows for note in notes], dtype=np.intp),
            scale=np.array([note.scale for note in notes]),
            clipped=np.array([note.clipped for note in notes], dtype=bool).reshape(len(steps), arm.nv),
            method=np.array([note.method for note in notes], dtype=np.str_),
            switched=np.array([note.switched for note in notes], dtype=np.str_),
            escape=np.array([note.escape for note in notes], dtype=bool),
            relaxed=np.array(["\n".join(note.relaxed[:MENTIONED]) for note in notes], dtype=np.str_),
            clearance=np.array(self._distances),
            scene=self._scene,
        )
        if run.excess is None:
            return run
        relaxed = [str(words) for words in run.relaxed]
        for number, words in zip(run.excess.steps, run.excess.words, strict=True):
            relaxed[number] = f"{relaxed[number]}\n{words}".strip()
        return replace(run, reason=f"{reason}; {run.excess.text}", relaxed=np.array(relaxed, dtype=np.str_))


def _settled(note: Diagnostics) -> Diagnostics:
    """The same with its singular values as numbers, which need no state to be kept."""
    return note._replace(sigma_min=note.sigma_min, sigma_max=note.sigma_max)
