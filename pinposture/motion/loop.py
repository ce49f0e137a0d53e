"""The control loop: what is kept of an arm from one cycle to the next, and the record of a run."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pinposture.arm import Arm, ArmState
from pinposture.arm.arm import state_at
from pinposture.collision import CollisionModel, Scene
from pinposture.control import Controller, Geodesic, Limits, Step, controller_named
from pinposture.control.constraint import describe_violated, inequalities_of
from pinposture.control.controller import Info, Memory, next_step
from pinposture.control.limits import JerkFilter
from pinposture.control.smooth_steps import SmoothSteps
from pinposture.errors import InvalidValue, enumerated, warn_caller
from pinposture.motion.arrival import STALL
from pinposture.motion.run import Run
from pinposture.placement import Target
from pinposture.units import ROUNDING, length_text

Array = NDArray[np.float64]


class Loop:
    """An arm that a controller moves, cycle by cycle.

    `RecordedLoop` records the cycles, for `track`; `perform` moves its target on a schedule; `Tracker` starts
    each cycle where measurements put the arm. In a cycle, the controller computes a step from `ahead` and
    `memory`; then the arm takes the step, and its memory, or refuses it and brakes.

    Attributes:
        arm: the arm.
        state: the state of the arm.
        ahead: the state from which the controller steps: with the motion that a limit of jerk still delays.
        limits: the limits of the step.
        filter: limits the jerk.
        memory: memory of the controller; None before the first step.

    Args:
        state: the state from which the arm starts.
        limits: as above.
        jerk_filter: likewise.
    """

    def __init__(
        self,
        state: ArmState,
        limits: Limits,
        jerk_filter: JerkFilter | SmoothSteps,
    ) -> None:
        self.arm = state.arm
        self.limits = limits
        self.filter = jerk_filter
        self.memory: Memory | None = None
        self.start_at(state)

    def start_at(self, state: ArmState) -> None:
        """Set the state of the arm at the start of a cycle."""
        self.state = state
        self.ahead = state.moved(self.filter.ahead) if self.filter.active else state

    def refuse(self, step: Step) -> None:
        """Keep what a step has planned, but not its motion, as the arm brakes instead of taking it."""
        self.memory = step.memory.with_motion_of(self.motion)

    def braked(self) -> Memory:
        """Return the memory after a step that decelerates all joints as much as the limits allow."""
        return self.motion.braked(self.limits, self.ahead)

    @property
    def motion(self) -> Memory:
        """The memory, or that of an arm at rest before the first step."""
        return Memory(np.zeros(self.arm.nv)) if self.memory is None else self.memory


class RunRecord:
    """The states and steps of a run so far.

    Attributes:
        steps: number of steps.
        posture_error: current sum of the distances of the control points from their targets [m].
        mean_error: current mean of these distances [m].

    Args:
        target: the initial target posture.
        start: the first state.
        scene: the scene whose distances are recorded; None: none.
    """

    def __init__(self, target: Target, start: ArmState, scene: Scene | None = None) -> None:
        self._target = target
        self._scene = scene
        self.measure_in(start.arm, scene)
        self._reported: dict[str, tuple[tuple[int, ...], str]] = {}
        self._steps: list[Step] = []
        self._q: list[Array] = []
        self._points: list[Array] = []
        self._errors: list[Array] = []
        self._distances: list[float] = []
        self.steps = 0
        self._add(start)
        self._best = self.posture_error
        self._idle = 0.0

    def measure_in(self, arm: Arm, scene: Scene | None) -> None:
        """Measure distances in a scene; None: none."""
        self._model = None if scene is None or scene.empty else CollisionModel(arm, scene)

    def set_target(self, target: Target) -> None:
        """Replace the target, and restart measuring progress."""
        self._target = target
        self._measure()
        self._best = self.posture_error
        self._idle = 0.0

    def _measure(self) -> Array:
        """Measure the current errors, and return the distances of the control points, (m,) [m]."""
        errors = self._target.distances(self._points[-1])
        self.posture_error = float(errors.sum())
        self.mean_error = self.posture_error / int(np.count_nonzero(self._target.weights > 0.0))
        return errors

    def _add(self, state: ArmState) -> None:
        """Add a state."""
        self._last = state
        chain_state = state.chain_state
        self._q.append(chain_state.q)
        self._points.append(chain_state.points)
        self._errors.append(self._measure())
        model = self._model
        self._distances.append(np.inf if model is None else model.minimum_at(chain_state).distance)

    def error_rises_at(self, state: ArmState) -> bool:
        """Whether the posture error at a state exceeds the current one, by more than rounding."""
        rounding = STALL.rounding * state.arm.length
        error = float(self._target.distances(state.chain_state.points).sum())
        return error > self.posture_error + rounding

    def append(self, state: ArmState, step: Step, travel: float, target: Target | None = None) -> None:
        """Append a step.

        Args:
            state: the state after the step.
            step: the step.
            travel: joint travel that the limits allowed in this step [rad].
            target: the new target, if it has changed.
        """
        self._target = self._target if target is None else target
        self._steps.append(step._replace(info=self._checked_info(step.info)) if step.info else step)
        self.steps += 1
        if not step.following_path:
            self._idle += travel
        self._add(state)

    def _checked_info(self, info: Mapping[str, Info]) -> dict[str, Info]:
        """Return what a controller reports, read now; each value must be like those of the steps before."""
        values = dict(info)  # computed now, to keep no state in memory
        for name, value in values.items():
            array = np.asarray(value)
            like = (array.shape, "text" if array.dtype.kind == "U" else "numbers")
            known = self._reported.setdefault(name, like)
            if like != known:
                raise InvalidValue(f"info[{name!r}]", value, f"{known[1]} of shape {known[0]}, as before")
        return values

    def travel_without_progress(self) -> float:
        """Return the joint travel since the posture error last fell noticeably below its minimum [rad].

        It is the travel that the limits allowed, without steps along a path, and hence independent of dt.
        """
        if self.posture_error < self._best * (1.0 - STALL.progress_share):
            self._best = self.posture_error
            self._idle = 0.0
        return self._idle

    def run(self, arm: Arm, controller: Controller, limits: Limits, status: str, reason: str) -> Run:
        """Return the run so far, with messages on steps that exceed limits and on constraints at its end."""
        steps = self._steps
        if isinstance(controller, Geodesic) and controller.constraints:
            broken = describe_violated(inequalities_of(controller.constraints, self._last), arm.length)
            reason = "; ".join([reason, *broken])
        active = np.zeros((len(steps), arm.n_modules), dtype=bool)
        for row, step in zip(active, steps, strict=True):
            row[list(step.active)] = True
        run = Run(
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
            clipped=np.array([step.clipped for step in steps], dtype=bool).reshape(len(steps), arm.nv),
            error_increasing=np.array([step.error_increasing for step in steps], dtype=bool),
            violated_constraints=np.array(
                ["\n".join(step.violated_constraints[:8]) for step in steps],  # the first are enough to know
                dtype=np.str_,
            ),
            clearance=np.array(self._distances),
            info=_as_columns([step.info for step in steps]),
            scene=self._scene,
        )
        if run.excess is None:
            return run
        relaxed = [str(words) for words in run.violated_constraints]
        for number, words in zip(run.excess.steps, run.excess.words, strict=True):
            relaxed[number] = f"{relaxed[number]}\n{words}".strip()
        return replace(
            run, reason=f"{reason}; {run.excess.text}", violated_constraints=np.array(relaxed, dtype=np.str_)
        )


def _as_columns(reports: Sequence[Mapping[str, Info]]) -> dict[str, NDArray[Any]]:
    """Return what steps report as columns by name: 0, False or "" for a step that does not report it."""
    absent = {name: np.zeros_like(value) for report in reports for name, value in report.items()}
    return {name: np.array([report.get(name, none) for report in reports]) for name, none in absent.items()}


Callback = Callable[[int, ArmState, Step], object]


class RecordedLoop(Loop):
    """A control loop in equal cycles, with the record of its run.

    Attributes:
        controller: the controller; it may be replaced between cycles.
        record: the run so far.
        last_step: the last step that was computed; None before the first.

    Args:
        arm: the arm.
        q0: the initial configuration, (nq,), as `Arm.checked_start` returns it.
        target: the initial target.
        controller: the controller.
        limits: the limits of each step.
        scene: the scene whose distances are recorded; None: none.
    """

    filter: JerkFilter

    def __init__(
        self,
        arm: Arm,
        q0: Array,
        target: Target,
        controller: Controller,
        limits: Limits,
        scene: Scene | None = None,
    ) -> None:
        super().__init__(state_at(arm, q0), limits, JerkFilter(arm, limits))
        self.controller = controller
        self.last_step: Step | None = None
        self.record = RunRecord(target, self.state, scene)
        self._bounds = self.filter.bounds

    def compute(self, target: Target) -> Step:
        """Return the next step towards a target, without taking it."""
        self.last_step = next_step(self.controller, self.ahead, target, self.limits, self.memory)
        return self.last_step

    def take(self, step: Step, target: Target | None = None) -> None:
        """Take a step and record it.

        Args:
            step: the step.
            target: the target after the step, if it has changed.
        """
        dq = self.filter.apply(step.dq) if self.filter.active else step.dq
        self.memory = step.memory
        self.start_at(self.state.moved(dq))
        if self.filter.active:
            step = step._replace(dq=dq, error_increasing=self.record.error_rises_at(self.state))
        try:
            self.record.append(self.state, step, self._bounds.travel, target)
        except InvalidValue as error:  # what the controller reports is not as before
            name = f"{type(self.controller).__name__}.step(...).{error.name}"
            raise InvalidValue(name, error.value, error.allowed) from None

    def enter(self, scene: Scene) -> None:
        """Go on in another scene, in which the arm has to keep clear, and its distances are recorded."""
        if isinstance(self.controller, Geodesic):
            self.controller = self.controller.with_scene(None if scene.empty else scene)
        self.record.measure_in(self.arm, scene)

    def run(
        self, target: Target, tolerance: float, max_steps: int, callback: Callback | None = None
    ) -> tuple[str, str]:
        """Take steps until the arm converges, stalls, or runs out of steps.

        Args:
            target: the target posture.
            tolerance: mean point error at which the run has converged [m].
            max_steps: number of steps of the record after which to stop.
            callback: as for `track`.

        Returns:
            Status and reason; see `track`.
        """
        while True:
            status, reason = self._check_end(target, tolerance, max_steps)
            if status:
                break
            step = self.compute(target)
            if step.reason:
                self.refuse(step)
                if self.filter.moving:
                    self.brake()  # let the jerk filter settle first
                    continue
                # With active points but no step, the controller is stuck.
                status = "stalled" if step.active else "no_control_points"
                reason = step.reason
                break
            self.take(step)
            number = self.record.steps
            if callback is not None and callback(number, self.state, step) is True:
                return "stopped", f"stopped by the callback after {number} steps"
        if status in ("stalled", "max_steps") and self.last_step is not None:
            reason += describe_binding_limits(self.arm, self.last_step)
        return status, reason

    def brake_to_rest(self) -> None:
        """Brake until no joint moves; without acceleration limits that takes no step."""
        while self.memory is not None and (self.filter.moving or np.any(self.braked().dq)):
            self.brake()

    def brake(self) -> None:
        """Take a step that decelerates all joints as much as the limits allow."""
        memory = self.braked()
        rises = self.record.error_rises_at(self.ahead.moved(memory.dq))
        still = np.zeros(self.arm.nv, dtype=np.bool_)
        self.take(Step(memory.dq, (), still, error_increasing=rises, memory=memory))

    def _check_end(self, target: Target, tolerance: float, max_steps: int) -> tuple[str, str]:
        """Return status and reason if the run is over, else empty strings."""
        mean = self.record.mean_error
        if self.filter.moving:
            mean = max(mean, target.mean_distance(self.ahead.chain_state.points))
        if mean <= tolerance:
            brake = self._bounds.brake
            if brake is None or self.memory is None or np.all(np.abs(self.memory.dq) <= brake):  # it can stop
                return "converged", describe_arrival(self.arm, mean, tolerance)
        if self.record.steps >= max_steps:
            allowed = length_text(tolerance, smallest=0.0)
            return "max_steps", f"mean point error {length_text(mean)}, above the tolerance of {allowed}"
        idle = self.record.travel_without_progress()
        if idle >= STALL.travel * (1.0 - ROUNDING):
            error = f"mean point error {length_text(mean)}"
            return "stalled", f"{error}, no progress in the last {idle:.3g} rad of joint travel"
        return "", ""


def describe_arrival(arm: Arm, mean: float, tolerance: float) -> str:
    """Say how close to its target an arm is that has converged; both [m]."""
    error = length_text(mean, arm.length)
    return f"mean point error {error}, within the tolerance of {length_text(tolerance, smallest=0.0)}"


def describe_binding_limits(arm: Arm, step: Step) -> str:
    """Return a clause naming the joint limits and distances that limited a step."""
    held = [f"{arm.joint_names[j]} at its limit" for j in np.flatnonzero(step.clipped)]
    held += step.near
    return f"; held by {enumerated(held)}" if held else ""


def in_scene(controller: str | Controller, scene: Scene | None) -> tuple[Controller, Scene | None]:
    """Return the controller with the scene, and the scene; warn if it does not avoid the obstacles.

    Args:
        controller: as for `track`.
        scene: likewise.
    """
    controller = controller_named(controller)
    if not (scene is None or isinstance(scene, Scene)):
        raise InvalidValue("scene", scene, "a Scene(...), or None")
    if isinstance(controller, Geodesic):
        if scene is None:
            return controller, controller.scene
        return controller.with_scene(None if scene.empty else scene), scene
    if scene is not None and scene.obstacles:
        text = f'{controller.name} does not avoid obstacles, only records distances; "geodesic" avoids them'
        warn_caller(text)
    return controller, scene
