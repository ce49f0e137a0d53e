"""The streaming controller: one step in each control cycle, whatever happens to targets and measurements."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property
from math import isfinite
from typing import Literal, NamedTuple, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pinposture import kernels
from pinposture.arm import Arm, ArmState
from pinposture.arm.checks import finite_vector
from pinposture.control import Controller, Limits, Step, controller_named
from pinposture.control.checks import require_positive
from pinposture.control.controller import Memory
from pinposture.control.limits import cycle_of
from pinposture.errors import InvalidValue, PostureError, UnknownName
from pinposture.motion.consulting import Consultation
from pinposture.motion.feedback import Feedback, Seen
from pinposture.motion.track import in_scene
from pinposture.scene import Scene
from pinposture.target import Target
from pinposture.target.measured import with_configuration

Array = NDArray[np.float64]

INTERFACES = ("position", "velocity")

SHORTEST = 1e-3
"""The shortest cycle that counts as one, relative to the usual one."""

LATE = "the controller is not done yet"

STILL = 1e-9
"""Step that is none, in `Arm.joint_units`: some controllers go on forever by less."""

ARRIVED = 1e-6
"""Mean distance of the control points from their targets at which the arm has arrived, in arm lengths."""


class Report(NamedTuple):
    """What happened in a cycle.

    Attributes:
        status: "moving", "converged" (the posture is taken), "stalled" (the controller has no step that leads
            closer) or "holding" (braking, or at rest, because something is missing or wrong).
        reason: why it is stalled or holding, in words; else empty.
        mean_error: mean distance of the control points from their targets at the beginning of the cycle, by
            the last measurement that could be used [m]; None before there is a target and a measurement.
        disagreement: largest difference between measured and expected joint positions, in `Arm.joint_units`;
            None without a measurement that can be used.
        target_age: how long ago the target was given, as the cycles tell the time [s]; None without a target.
        relaxed: which constraints gave way in the step, as in `Diagnostics`.
        step: what the controller answered, its active control set for instance; None if it was not asked.
    """

    status: str
    reason: str
    mean_error: float | None
    disagreement: float | None
    target_age: float | None
    relaxed: tuple[str, ...] = ()
    step: Step | None = None


class Tracker:
    """Moves an arm towards whatever target it was last given, a step at a time, in closed loop.

        tracker = pp.Tracker(arm, limits=pp.Limits(dt=0.01, acceleration=10.0))
        tracker.update(target)                       # whenever there is a new one
        dq = tracker.step(q_measured)                # in every cycle

    It never extrapolates: without a target, with a target older than `timeout`, without a measurement, or
    with one that cannot be true, it brakes within its limits, stands still, and `report` says why.

    Drives that take positions are sent `command`, which moves by `dq`, so that limits hold on it exactly;
    only where the arm turns out to be elsewhere (`patience`) does it begin anew from there. What the arm does
    otherwise, because it sags or lags, is fed back slowly: the command goes as far beyond the target as the
    arm stays behind. Drives that take velocities are sent dq / dt; each step then begins where the arm was
    measured.

    To make one loads all compiled kernels, so that no cycle has to wait for that: half a second for the first
    one in a process, and about a minute where they are not compiled yet (`pinposture compile`).

    Attributes:
        arm: the arm.
        limits: what a step may not exceed; `dt` is the usual duration of a cycle.
        report: what happened in the last cycle.

    Args:
        arm: the arm.
        controller: as for `track`.
        limits: as above; `dt` is needed.
        scene: as for `track`.
        interface: what the drives take: "position" or "velocity".
        feedback: time in which disagreement between measurement and command is fed back [s]. Several times
            the delay of the drives, or the loop oscillates. Only for positions; infinite: not at all.
        disagreement: largest difference between measured and expected joint positions that is fed back, in
            `Arm.joint_units` (one radian). Where it is larger the arm holds.
        patience: how long such measurements have to agree with each other to be believed [s]. The arm is
            then taken to be there. Infinite: it holds until `restart`.
        timeout: age at which a target counts no more [s]; infinite: never.
        deadline: how long a cycle may wait for the controller [s]. A way round obstacles takes it seconds to
            plan; where it needs longer it goes on in a thread of its own, and the arm holds until it is done.
            Threads of Python share their time: a cycle can take some tens of milliseconds more. Infinite:
            it is always waited for.

    Raises:
        InvalidValue: limits without dt, or numbers that are not positive.
        UnknownName: no such controller, or interface.
    """

    def __init__(
        self,
        arm: Arm,
        controller: str | Controller = "qp",
        limits: Limits | None = None,
        scene: Scene | None = None,
        interface: Literal["position", "velocity"] = "position",
        feedback: float = 0.25,
        disagreement: float = 0.3,
        patience: float = 0.5,
        timeout: float = float("inf"),
        deadline: float = float("inf"),
    ) -> None:
        usual = cycle_of(limits)
        limits = cast(Limits, limits)  # anything else was refused
        if interface not in INTERFACES:
            raise UnknownName("interface", interface, INTERFACES)
        times = {"feedback": feedback, "patience": patience, "timeout": timeout, "deadline": deadline}
        for name, value in {**times, "disagreement": disagreement}.items():
            _positive(name, value)
        self.arm, self.limits = arm, limits
        limits.for_arm(arm)  # says now what does not fit
        self._consultation = Consultation(in_scene(controller_named(controller), scene)[0], deadline)
        self._feedback = Feedback(arm, feedback if interface == "position" else 0.0, disagreement, patience)
        self._timeout, self._usual = timeout, usual
        self._given: Target | None = None
        self._age = 0.0
        self._memory: Memory | None = None
        self._dt = usual
        self.report = Report("holding", "no step was taken yet", None, None, None)
        kernels.load()

    @property
    def command(self) -> Array:
        """The configuration for drives that take positions, (nq,).

        Raises:
            InvalidValue: no measurement has been given yet, so that nothing is known of where the arm is.
        """
        if self._feedback.command is None:
            raise InvalidValue("command", None, "a measurement first, given to `step` or to `restart`")
        return np.array(self._feedback.command)

    @property
    def target(self) -> Target | None:
        """The target that it was last given."""
        return self._given

    def update(self, target: Target) -> None:
        """Give it a target; it counts from the next step on, until there is another.

        Raises:
            InvalidValue: it does not fit the arm; the one before stays.
        """
        if not isinstance(target, Target):
            raise InvalidValue("target", target, "a Target, as `resolve_targets` returns it")
        target.check(self.arm)
        before = self._given.q if self._given is not None else None
        near = self._feedback.command if before is None else before
        self._given, self._age = with_configuration(self.arm, target, near), 0.0

    def restart(self, q_measured: ArrayLike, dq: ArrayLike | None = None) -> None:
        """Begin anew from where the arm is; the target stays.

        Args:
            q_measured: the configuration that was measured, (nq,).
            dq: its displacement in the last cycle, (nv,) [rad or m]; None if it is at rest.

        Raises:
            InvalidValue: not a configuration, or not a displacement.
        """
        moved = None if dq is None else finite_vector("dq", dq, self.arm.nv)
        self._feedback.begin(self.arm.checked_start(q_measured, "q_measured"), moved is not None)
        self._memory, self._dt = None if moved is None else Memory(moved), self._usual

    def step(
        self, q_measured: ArrayLike | None, dt: float | None = None, points: ArrayLike | None = None
    ) -> Array:
        """Take the step of a control cycle.

        Args:
            q_measured: the configuration that was measured, (nq,); None, or not finite, if it is missing.
            dt: time since the cycle before [s]; the usual duration if None. A cycle that was late makes up
                for nothing; one that is short moves less.
            points: measured positions of the control points, (m, 3) [m], world frame, which then count in
                place of those that follow from the joint positions. Rows that are not finite: not seen.

        Returns:
            The joint displacement of this cycle, (nv,) [rad or m], within all limits. Divide by the duration
            of the cycle for a speed.

        Raises:
            InvalidValue: arrays of a wrong shape, or a duration that is not positive: faults of the program,
                not of a sensor.
        """
        passed = self._usual if dt is None else _duration(dt)
        dt = min(max(passed, SHORTEST * self._usual), self._usual)
        limits = self.limits if dt == self._usual else replace(self.limits, dt=dt)
        seen = self._feedback.take(q_measured, points, dt)
        memory = None if self._feedback.anew else self._remembered(dt)
        self._age += passed
        step, reason, aim = None, seen.reason or self._missing(), None
        if seen.state is not None and self._given is not None and not reason:
            aim = self._feedback.shifted(self._given)
            try:
                step, memory = self._consultation.ask(seen.state, aim, limits, memory)
                reason = LATE if step is None else step.diagnostics.reason
            except (PostureError, ArithmeticError, np.linalg.LinAlgError) as error:
                reason = str(error)  # what it cannot work with, as a target that knows no configuration
            if step is not None and not isfinite(step.dq @ step.dq):
                step, reason = None, "the step of the controller is not finite"
        if step is None or reason:
            memory = Memory(np.zeros(self.arm.nv)) if memory is None else memory
            memory = memory.braked(limits, self._anywhere)
            memory = memory if step is None else memory._replace(own=step.memory.own)
        else:
            memory = step.memory
        self._memory, self._dt, dq = memory, dt, memory.dq
        self._feedback.moved(dq)
        self.report = self._reported(seen, step, reason, aim, dq)
        return np.array(dq)

    def _remembered(self, dt: float) -> Memory | None:
        """The memory of the controller, with the speed of the step before if cycles are not equally long."""
        if self._memory is None or dt == self._dt:
            return self._memory
        return self._memory._replace(dq=self._memory.dq * (dt / self._dt), stopping=None)

    def _missing(self) -> str:
        """What is wrong with the target, in words."""
        if self._given is None:
            return "no target was given"
        if self._age > self._timeout:
            return f"the target is {self._age:.3g} s old; after {self._timeout:.3g} s it does not count"
        return ""

    @cached_property
    def _anywhere(self) -> ArmState:
        """Some state of the arm: braking asks only for its limits."""
        return self.arm.at(self.arm.neutral())

    def _reported(self, seen: Seen, step: Step | None, reason: str, aim: Target | None, dq: Array) -> Report:
        status = "moving" if not reason else "stalled" if step is not None else "holding"
        still = bool(np.all(np.abs(dq) <= STILL * self.arm.joint_units))
        if aim is not None and seen.state is not None and still:
            there = _mean_distance(seen.state.points, aim) <= ARRIVED * self.arm.length
            status, reason = ("converged", "") if there else (status, reason)
        given, points = self._given, self._feedback.points
        error = None if given is None or points is None else _mean_distance(points, given)
        age = None if given is None else self._age
        relaxed = () if step is None else step.diagnostics.relaxed
        return Report(status, reason, error, seen.disagreement, age, relaxed, step)


def _mean_distance(points: Array, target: Target) -> float:
    """Mean distance of control points (m, 3) from where they should be [m]."""
    placed = target.placed
    return float(np.linalg.norm((target.points - points)[placed], axis=1).mean())


def _duration(dt: float) -> float:
    require_positive("dt", dt)
    return float(dt)


def _positive(name: str, value: float) -> None:
    """Raise InvalidValue unless a number is positive, or infinite."""
    if value != float("inf"):
        require_positive(name, value)
