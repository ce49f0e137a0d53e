"""The streaming controller: one step per control cycle, with feedback and a deadline."""

from __future__ import annotations

import logging
from collections.abc import Collection, Mapping
from dataclasses import replace
from math import inf, isfinite
from time import perf_counter
from typing import Literal, NamedTuple, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pinposture import kernels
from pinposture._validation import (
    finite_vector,
    is_number,
    is_usable,
    require_instance,
    require_known,
    require_positive,
)
from pinposture.arm import Arm
from pinposture.collision import Closest, CollisionModel, Scene
from pinposture.collision.model import describe_distance
from pinposture.control import Controller, Geodesic, GeodesicMemory, Limits, Step
from pinposture.control.controller import Memory
from pinposture.control.limits import cycle_of
from pinposture.control.planner.avoidance import BRAKING_HARDER, describe_lost_margin
from pinposture.control.smooth_steps import RateCheck, SmoothSteps
from pinposture.control.tasks import Displaced
from pinposture.control.torque_limits import find_overload
from pinposture.errors import ControllerError, InvalidValue, PostureError
from pinposture.motion.arrival import ARRIVAL, STALL, Arrival, Blockage
from pinposture.motion.deadline import NOT_DONE, DirectStep, PlannedStep, build_models
from pinposture.motion.drive_response import DriveModel
from pinposture.motion.feedback import FEEDBACK, Feedback, FeedbackState, JointFailure, read_start
from pinposture.motion.loop import Loop, describe_binding_limits, in_scene
from pinposture.motion.obstacle_velocities import ObstacleVelocities
from pinposture.motion.sag_compensation import RESERVED, SagCompensation, shared
from pinposture.motion.touch import Touch, TouchDetector, read_torques
from pinposture.placement import Target
from pinposture.placement.points import with_configuration
from pinposture.units import CONVERGED, ROUNDING, length_text

Array = NDArray[np.float64]

logger = logging.getLogger(__name__)


MIN_CYCLE = 1e-4
"""Shortest duration of a cycle, relative to the nominal one."""


class Report(NamedTuple):
    """The result of a cycle.

    Attributes:
        status: "moving", "converged" (the measured arm has the target posture, as far as the noise of the
            measurements tells), "stalled" (no step reduces the error, or a joint stays short of its target),
            "holding" (braking or at rest, as an input is missing or invalid, a path is not planned yet, or
            something touched the arm, to which it may give way) or
            "evading" (the same, but it moves to keep clear of obstacles that approach, or to which the
            measured arm has lost the margin).
        reason: why it is stalled, holding or evading; else empty.
        mean_error: mean distance of the control points from their targets at the start of the cycle, from the
            last usable measurement [m]; None before the first target and measurement.
        tracking_error: largest distance of a measured joint position from where drives with a lag of up to
            half a second would be, in `Arm.joint_units`; None without a usable measurement.
        target_age: sum of cycle times since the target was set [s]; None without a target.
        violated_constraints: constraints that the step violates, as in `Step`, the margin to obstacles if
            the measured arm has lost it, and the torque limit if the motors cannot hold it at the target.
        step: the step that was sent, and what the controller says of it; None if it computed none. With a
            limit of jerk, `dq` and `error_increasing` are those after the filter, as in runs.
        time: how long `Tracker.step` took [s].
        overran: whether that is longer than the nominal cycle time.
        failures: joints that do not do what they are commanded, while the arm holds because of them.
    """

    status: str
    reason: str
    mean_error: float | None
    tracking_error: float | None
    target_age: float | None
    violated_constraints: tuple[str, ...] = ()
    step: Step | None = None
    time: float = 0.0
    overran: bool = False
    failures: tuple[JointFailure, ...] = ()

    def __repr__(self) -> str:
        why = f": {self.reason}" if self.reason else ""
        error = "" if self.mean_error is None else f", mean error {length_text(self.mean_error)}"
        violated = f", violates {'; '.join(self.violated_constraints)}" if self.violated_constraints else ""
        return f"Report({self.status}{why}{error}{violated})"


class Decision(NamedTuple):
    """What to do in a cycle.

    Attributes:
        step: the step of the controller; None if it computed none.
        dq: the step to take, (nv,) [rad or m]: that of the controller, or one that brakes.
        reason: why the arm holds, stalls or evades; else empty.
        compensated: the target for the command; None if the controller was not asked.
        evading: whether the arm evades obstacles while it holds.
    """

    step: Step | None
    dq: Array
    reason: str
    compensated: Target | None
    evading: bool


class Tracker:
    """Moves an arm towards its latest target, one step per cycle, in closed loop.

        tracker = pp.Tracker(arm, limits=pp.Limits(dt=0.01, acceleration=10.0))
        tracker.update(target)                       # whenever there is a new one
        dq = tracker.step(q_measured)                # in every cycle

    It never extrapolates the target: without one, with one older than `timeout`, without a measurement, or
    with an implausible one, it brakes within its limits and holds, and `report` gives the reason. If it has a
    measurement, it evades meanwhile obstacles that approach, or to which the measured arm lost the margin.

    If a controller, constraint or task of yours raises an exception, or returns what it should not, the arm
    brakes and holds as well; `report` names it, and the log has the traceback.

    The output keeps all limits, with two exceptions, which `report.violated_constraints` names. Where
    braking within the limits of acceleration and jerk would cause contact with an obstacle, the arm brakes
    harder. Where the arm starts beyond its torque limits, or too fast to brake within them, it exceeds them
    as little as possible.

    Send `positions` to position-controlled drives. They move by `dq`, and restart from the measured
    configuration only if the arm stays elsewhere (`resync_time`). Smaller errors, for instance because the
    arm sags or lags, are fed back slowly: the command overshoots the target by as much as the arm falls
    short; with tasks of the controller, each time that the command has come to rest. If the measured arm
    loses the margin to an obstacle, the command moves such that it regains it.
    Send `arm.drives.velocities(dq) / dt` to velocity-controlled drives; each step then starts at the
    measurement, within its noise.

    The constructor makes what cycles need, so that none waits for it. It loads all compiled kernels: half a
    second for the first tracker in a process, and about a minute if they are not compiled yet (`pinposture
    compile`). It prepares the scene: 20 ms for 30 boxes, 0.8 s for a scan of 200,000 points. With a deadline
    it starts the process that plans, which takes 3 to 6 s, and waits for it; if that process is ended from
    outside, another one starts in the background, while the arm holds if it needs a plan. A scene with other
    obstacles, not from `Scene.moved`, that is passed to `step` is prepared in that cycle: call
    `CollisionModel.prepare(arm, scene)` before, in another thread.

    Attributes:
        arm: the arm.
        report: the result of the last cycle.
        scene: the latest obstacles, with their velocities.
        overruns: number of calls of `step` that took longer than the nominal cycle time.

    Args:
        arm: the arm.
        controller: as for `track`.
        limits: as above; `dt` is required.
        scene: as for `track`.
        interface: command type of the drives: "position" or "velocity".
        feedback_time_constant: time constant of the feedback of the tracking error [s]. It must be several
            times the delay of the drives, or the loop oscillates. Infinite: no feedback.
        max_tracking_error: distance of a measured joint position from where its drive could be, above which
            the arm holds without feedback, in `Arm.joint_units`; also the largest compensation. None: what
            `drives` explain (`DriveModel.tracking_error`), at least 0.05; if they are unknown, 0.3 from
            where a drive with a lag of up to half a second could be. The compensation is then at most 0.3.
        resync_time: how long larger differences must agree with each other before the tracker restarts from
            the measurement [s]. Infinite: the arm holds until `restart`.
        timeout: age at which a target expires [s]; infinite: never.
        deadline: how long a cycle may wait for the controller [s]. Planning a path around obstacles takes
            seconds; past the deadline it continues in the background, and the arm brakes and holds until it
            is done. Infinite: every cycle waits.
        planning: where "geodesic" plans if there is a deadline. "process": all plans are made in another
            process, which takes some seconds to start, and no cycle waits for them. "thread": in a thread, as
            with other controllers. Threads share the interpreter, so a cycle can then exceed the deadline by
            some tens of milliseconds.
        compensate: whether `command` and `positions` also compensate the sag of the loaded arm, from its
            masses and `Arm.stiffness` (`Arm.compensate`). The feedback then only corrects the rest. A tenth
            of each limit is kept for it. Only for the position interface.
        drives: how the drives follow (`Identification.model`): `command` and `positions` then lead the motion
            by lag * velocity + friction * its sign, so that the arm is where the motion is, and feedback only
            corrects the rest. The motion of the arm keeps the limits; what is sent can exceed those of
            velocity and acceleration where the motion turns. Only for the position interface.
        touch: how the tracker notices from measured torques that something touches the arm, and whether the
            arm then stops or gives way; None: it does not.

    Raises:
        InvalidValue: limits without dt, a number that is not positive, or `compensate` or `drives`
            with velocities.
        WeightUnknown: `compensate` without masses or stiffness, `touch` without masses.
        UnknownName: no such controller, interface or place of planning, or joint with a threshold of touch.
    """

    _overload: tuple[Target, Limits, tuple[str, ...]] | None = None  # the last answer of `_lost_hold`

    def __init__(
        self,
        arm: Arm,
        controller: str | Controller = "geodesic",
        limits: Limits | None = None,
        scene: Scene | None = None,
        *,
        interface: Literal["position", "velocity"] = "position",
        feedback_time_constant: float = 0.25,
        max_tracking_error: float | None = None,
        resync_time: float = 0.5,
        timeout: float = float("inf"),
        deadline: float = float("inf"),
        planning: Literal["process", "thread"] = "process",
        compensate: bool = False,
        drives: DriveModel | None = None,
        touch: Touch | None = None,
    ) -> None:
        require_instance("arm", arm, Arm, "an Arm")
        period = cycle_of(limits)
        limits = cast(Limits, limits)  # checked by `cycle_of`
        require_known("interface", interface, ("position", "velocity"))
        require_known("planning", planning, ("process", "thread"))
        require_instance("compensate", compensate, bool, "True or False")
        if compensate and interface == "velocity":
            raise InvalidValue("compensate", True, "False for drives that are sent velocities")
        require_instance("drives", drives, DriveModel | None, "a DriveModel, or None")
        if drives is not None and interface == "velocity":
            raise InvalidValue("drives", drives, "None for drives that are sent velocities")
        for name, value in (
            ("feedback_time_constant", feedback_time_constant),
            ("resync_time", resync_time),
            ("timeout", timeout),
            ("deadline", deadline),
            (
                "max_tracking_error",
                FEEDBACK.tracking_error if max_tracking_error is None else max_tracking_error,
            ),
        ):
            if not (is_number(value) and value > 0.0 and (value == inf or is_usable(value))):
                raise InvalidValue(name, value, "a number > 0, or inf")
        self.arm = arm
        self._limits = limits
        self._period = period
        self._rates = RateCheck(arm, period)
        self._former: Limits | None = None
        self._sag = SagCompensation(arm, limits) if compensate else None
        self._shared: tuple[Limits, Limits] | None = None
        self._drives = drives
        self._touch = None if touch is None else TouchDetector(arm, touch)
        controller, self.scene = in_scene(controller, scene)
        self._steps: DirectStep | PlannedStep
        if planning == "process" and deadline < inf and type(controller) is Geodesic:
            self._steps = PlannedStep(arm, controller)
        else:
            self._steps = DirectStep(controller, deadline)
        self._obstacles = ObstacleVelocities(self.scene, arm.length)
        inner = self._of_command(limits)
        self._loop = Loop(arm.at(arm.neutral()), inner, SmoothSteps(arm, inner))
        self._tasks = controller.tasks if isinstance(controller, Geodesic) else ()
        self._feedback = Feedback(
            arm,
            feedback_time_constant,
            max_tracking_error,
            resync_time,
            drives,
            velocities=interface == "velocity",
            with_tasks=bool(self._tasks),
        )
        self._arrival = Arrival(arm.length)
        self._pursuit = Blockage(arm, self._feedback.averaging_time)
        self._evasion = Blockage(arm, self._feedback.averaging_time)
        self._tried: Scene | None = None
        self._clearance: tuple[Scene, Array, Closest] | None = None
        self._timeout = timeout
        self._target: Target | None = None
        self._age = 0.0
        self._decision: Decision | None = None
        self._dt = period
        self._displaced = self._feedback.rest_offset
        self.overruns = 0
        self.report = Report("holding", "no step yet", None, None, None)
        kernels.load()
        build_models(arm, self.scene)

    def __repr__(self) -> str:
        return f"Tracker({self.arm.name!r}, {self._steps.controller.name!r}, {self.report})"

    @property
    def limits(self) -> Limits:
        """The limits of each step; `dt` is the nominal cycle time. They may be replaced between steps.

        A limit of jerk that is added, removed or replaced by one that needs another smoothing, and a cycle
        time that changes with one, take effect once the arm is at rest: it brakes within the former limits,
        and `report.violated_constraints` names steps beyond the new ones. All others take effect at once.

        Raises:
            InvalidValue: on assignment, limits without dt, or of another arm; the former ones stay.
        """
        return self._limits

    @limits.setter
    def limits(self, limits: Limits) -> None:
        period = cycle_of(limits)
        smooth = SmoothSteps(self.arm, self._of_command(limits))
        former = self._limits if self._former is None else self._former
        same = smooth.like(self._smoothing) and (period == cycle_of(former) or not smooth.active)
        self._limits = limits
        self._former = None if same else former
        if same:
            self._period = period
            if self._sag is not None:
                self._sag.take(limits)

    def _of_command(self, limits: Limits) -> Limits:
        """Return the limits within which the command moves: without what is kept for compensation."""
        if self._sag is None:
            return limits
        if self._shared is None or self._shared[0] is not limits:
            self._shared = limits, shared(limits, self.arm, 1.0 - RESERVED)
        return self._shared[1]

    @property
    def compensates(self) -> bool:
        """Whether what is sent compensates the sag of the loaded arm."""
        return self._sag is not None

    @property
    def command(self) -> Array:
        """The commanded configuration, (nq,); `positions` are what to send to its drives.

        Raises:
            InvalidValue: before the first measurement.
        """
        if self._feedback.state is None:
            raise InvalidValue("command", None, "a command after the first measurement (see `step`)")
        offset = self._sent_positions(np.zeros(self.arm.nv))
        return self.arm.integrate(self._feedback.command, offset)

    @property
    def positions(self) -> Array:
        """The positions to send to drives, in the order of `Arm.drives`, (nv,) [rad or m].

        They are those of `command`, but continuous joints count full turns, so that no position jumps by a
        turn. They start at the measured turns if positions are measured, and within +-pi if configurations
        are.

        Raises:
            InvalidValue: before the first measurement.
        """
        if self._feedback.positions is None:
            raise InvalidValue("positions", None, "positions after the first measurement (see `step`)")
        return self.arm.drives.positions(self._sent_positions(self._feedback.positions))

    def _sent_positions(self, positions: Array) -> Array:
        """Return joint positions of the command, (nv,), with what compensates sag, lag and friction."""
        offset = self._feedback.lead if self._sag is None else self._feedback.lead + self._sag.offset
        return positions + offset

    @property
    def target(self) -> Target | None:
        """The latest target; None before the first."""
        return self._target

    def update(self, target: Target, velocity: ArrayLike | None = None) -> None:
        """Set the target for the next steps.

        A target that the motors cannot hold within torque limits is not refused, so that a loop goes on: the
        arm moves to a posture near it that they can hold, and `report.violated_constraints` names the joint.

        Args:
            target: the target. Update a moving target in each cycle, with its posture at the end of that
                cycle.
            velocity: joint velocities of the target, (nv,) [rad/s or m/s]. None: `Target.velocity`; if that
                is None too, "geodesic" uses the motion since the last cycle.

        Raises:
            InvalidValue: the target does not fit the arm (the previous one stays), or a velocity is given for
                a target without a configuration.
        """
        require_instance("target", target, Target, "a Target, as `resolve_targets` returns it")
        if velocity is not None:
            target = replace(target, velocity=finite_vector("velocity", velocity, self.arm.nv))
        target.check_arm(self.arm)
        before = self._target.q if self._target is not None else None
        near = before
        if near is None and self._feedback.state is not None:
            near = self._feedback.command
        given = with_configuration(self.arm, target, near)
        if velocity is not None and given.q is None:
            raise InvalidValue("velocity", velocity, "None for a target without a configuration")
        if self._target is None or not self._is_same(given):
            self._arrival.restart()
            self._feedback.settled = False
            self._feedback.aim()
            self._try_again()
        self._target = given
        self._age = 0.0

    def _is_same(self, target: Target) -> bool:
        """Return whether a target is the present one to rounding."""
        before = cast(Target, self._target)
        if target is before:
            return True
        if (target.q is None) != (before.q is None) or np.any(target.has_target != before.has_target):
            return False
        apart = np.abs(target.errors(before.points)).max() / self.arm.length
        if target.q is not None and before.q is not None:
            apart = max(apart, np.abs(target.q - before.q).max())
        return bool(apart <= ROUNDING)

    def restart(
        self,
        q_measured: ArrayLike | Mapping[str, float],
        dq: ArrayLike | None = None,
        *,
        limp: str | Collection[str] = (),
    ) -> None:
        """Restart from the measured configuration, keeping the target.

        Args:
            q_measured: the measured configuration, (nq,), or positions as in `step`.
            dq: its displacement in the last cycle, (nv,) [rad or m]; None if the arm is at rest.
            limp: a joint or joints without torque, by name in `Arm.joint_names`: from now on, they need not
                follow their command, as long as it is near where they hang (`can_retreat`).

        Raises:
            InvalidValue: q_measured is not a configuration, dq not a displacement, or limp no names.
            UnknownName: a limp joint that the arm does not have.
        """
        require_instance("limp", limp, Collection, "names of joints")
        limp = (limp,) if isinstance(limp, str) else limp
        for name in limp:
            require_known("joint", name, self.arm.joint_names)
        moved = None if dq is None else finite_vector("dq", dq, self.arm.nv)
        self._feedback.restart(read_start(self.arm, q_measured), moved is not None)
        self._feedback.limp = np.isin(self.arm.joint_names, list(limp))
        if self._touch is not None:
            self._touch.restart()
        self._loop.memory = None if moved is None else Memory(moved)
        self._dt = self._period
        self._smoothing.restart(moved)
        self._rates.restart(moved)
        self._restart_compensation()
        self._arrival.restart()
        self._feedback.settled = False
        self._try_again()

    def step(
        self,
        q_measured: ArrayLike | Mapping[str, float] | None,
        dt: float | None = None,
        points: ArrayLike | None = None,
        scene: Scene | None = None,
        torques: ArrayLike | Mapping[str, float] | None = None,
    ) -> Array:
        """Compute the step of a control cycle.

        Args:
            q_measured: the measured positions of the joints that drives move (`Arm.drives`) by name, as in a
                JointState; other joints are ignored, and continuous ones count full turns. Or the
                configuration, (nq,), or its joint positions with full turns, (nv,) [rad or m]. None or not
                finite if it is missing.
            dt: time since the previous cycle [s]; the nominal cycle time if None. A late cycle does not move
                farther; a short one moves less.
            points: measured positions of the control points, (m, 3) [m], world frame, which replace those
                computed from the joint positions. Rows that are not finite are missing points.
            scene: the current obstacles, from `Scene.moved`; None: those of the previous cycle, moved on by
                their velocities. Velocities that a scene does not tell are those of the last scenes: from the
                third pose on, and as far as their noise allows.
            torques: the measured torques of the drives at `q_measured`, by joint name as the efforts of a
                JointState, or in the order of `Arm.drives`, (nv,) [N m or N]; for `touch`. None or not finite
                if they are missing.

        Returns:
            The joint displacement of this cycle, (nv,) [rad or m], within all limits. Divide it by the cycle
            time for the velocity. Drives of coupled joints move by `Arm.drives.velocities` of it.

        Raises:
            InvalidValue: an array of the wrong shape, a dt that is not positive, or a scene of the wrong
                type. Sensor faults do not raise.
        """
        begun = perf_counter()
        if dt is not None:
            require_positive("dt", dt)
        passed = self._period if dt is None else float(dt)
        if not (scene is None or isinstance(scene, Scene)):
            raise InvalidValue("scene", scene, "a Scene(...), or None")
        scene = self._obstacles.advance(scene, passed)
        if scene is not None and scene is not self.scene:
            controller, self.scene = in_scene(self._steps.controller, scene)
            if self._smoothing.active and scene.velocities:  # obstacles where the filtered steps meet them
                controller, _ = in_scene(controller, scene.after(self._smoothing.delay * self._period))
            self._steps.controller = controller
            if self._has_other_obstacles(scene):
                self._try_again()
        if self._former is not None and self.at_rest:
            self._take_limits()
        dt = min(max(passed, MIN_CYCLE * self._period), self._period)
        feedback = self._feedback.update(q_measured, points, dt)
        if self._feedback.restarted or self._loop.memory is None:
            self._loop.memory = None
            self._smoothing.restart()
            self._rates.restart()
            self._restart_compensation()
        self._age += passed
        self._feel(feedback, torques, passed)
        self._judge_arrival(feedback, dt)
        self._watch_clearance()
        self._displace_tasks()
        share = dt / self._period
        needed = self._smoothing.needs_step(share) or self._decision is None
        decision = self._decide(feedback, dt) if needed or self._decision is None else self._decision
        dq = self._smoothing.advance(share, decision.dq if needed else None)
        self._decision = decision
        self._feedback.apply_step(dq)
        sent = dq + self._compensate(dt)
        self._lead_drives(dq / dt)
        decision = decision._replace(step=self._describe_sent(feedback, decision, dq))
        report = self._make_report(feedback, decision, dq, sent, passed)
        self._watch_blockages(decision, dq, report.mean_error, dt)
        taken = perf_counter() - begun
        self.report = report._replace(time=taken, overran=taken > self._period)
        self.overruns += self.report.overran
        return np.array(sent)

    def _feel(
        self, feedback: FeedbackState, torques: ArrayLike | Mapping[str, float] | None, dt: float
    ) -> None:
        """Watch the measured torques of a cycle for contact."""
        felt = read_torques(self.arm, torques)
        if self._touch is None:
            return
        usable = feedback.tracking_error is not None and not feedback.reason
        self._touch.update(self._feedback.measured if usable else None, felt, dt)

    def _lead_drives(self, velocities: Array) -> None:
        """Lead the drives to joint velocities (nv,) [rad/s or m/s], within the limits of positions."""
        positions = self._feedback.positions
        if self._drives is None or positions is None:
            return
        if self._sag is not None:
            positions = positions + self._sag.offset
        # From this velocity on, the lead counts friction in full. With 0.02, eight joints with a friction of
        # 0.11 rad stalled 0.8 mrad short of their target; with 0.001 they reached it to 0.2 mrad.
        slow = 0.001 * self.arm.joint_units
        lead = self._drives.lead(velocities, slow)
        lowest = np.minimum(self.arm.limits.lower - positions, 0.0)
        highest = np.maximum(self.arm.limits.upper - positions, 0.0)
        self._feedback.lead = np.clip(lead, lowest, highest)

    def _restart_compensation(self) -> None:
        """Begin anew to compensate sag, at the command."""
        state = self._feedback.state
        positions = self._feedback.positions
        if self._sag is not None and state is not None and positions is not None:
            self._sag.restart(state, positions)

    def _compensate(self, dt: float) -> Array:
        """Return by how much the compensation of sag moves in a cycle, (nv,) [rad or m]."""
        state = self._feedback.state
        positions = self._feedback.positions
        if self._sag is None or state is None or positions is None:
            return np.zeros(self.arm.nv)
        return self._sag.advance(state, positions, dt)

    def _decide(self, feedback: FeedbackState, dt: float) -> Decision:
        """Return the step of the controller for a cycle of a duration [s], or one that brakes.

        With a limit of jerk it is a step of a nominal cycle, and only some shorter cycles need one.
        """
        loop = self._loop
        self._begin_cycle(dt)
        step = None
        touch = self._touch
        stopped = feedback.reason or ("" if touch is None else touch.reason)
        reason = stopped or self._target_problem()
        compensated = None
        if not reason and self._former is not None:
            reason = "other limits of jerk take effect at rest; the arm brakes within the former ones"
        if not reason and self._pursuit.lasting:
            reason = self._describe_blockage("it has come no closer to its target", self._pursuit)
        rest = feedback.held
        if touch is not None and touch.yields and not feedback.reason:
            there = self.arm.integrate(self._feedback.command, touch.way(loop.limits))
            rest = Target.from_configuration(self.arm, there)
        aim = rest
        if self._target is not None and not reason and not self._rests:
            aim = compensated = self._feedback.compensate(self._target)
        if feedback.state is not None:
            loop.start_at(feedback.state)
            if aim is not None:
                step, computed = self._compute(aim)
                reason = stopped or computed
        if step is not None and (not reason or aim is rest):
            loop.memory = step.memory
            return Decision(step, step.dq, reason, compensated, False)
        if step is not None:
            loop.refuse(step)
        held, evading = self._hold(feedback.state is not None and not feedback.reason)
        loop.memory = held
        if self._evasion.lasting and not self._pursuit.lasting:
            reason += f"; {self._describe_blockage('it has gained no clearance', self._evasion)}"
        return Decision(step, held.dq, reason, compensated, evading)

    def _begin_cycle(self, dt: float) -> None:
        """Set the limits and the last step to those of a cycle of a duration [s]."""
        loop = self._loop
        loop.limits = self._of_command(self._limits if self._former is None else self._former)
        if self._smoothing.active:
            return
        if dt != self._period:
            loop.limits = replace(loop.limits, dt=dt)
        if loop.memory is not None and dt != self._dt:
            loop.memory = replace(loop.memory, dq=loop.memory.dq * (dt / self._dt), stopping=None)
        self._dt = dt

    def _compute(self, aim: Target) -> tuple[Step | None, str]:
        """Return the step of the controller, if there is one, and why the arm cannot take it."""
        loop = self._loop
        try:
            step, memory = self._steps.compute(loop.ahead, aim, loop.limits, loop.memory)
        except (PostureError, ArithmeticError, np.linalg.LinAlgError) as error:
            reason = str(error)  # unusable input, such as a target without a configuration
            if isinstance(error, ControllerError) and not self.report.reason.startswith(reason):
                logger.warning("the arm holds: %s", reason, exc_info=error)
            return None, reason
        if step is not None and not isfinite(step.dq @ step.dq):
            return None, "the step of the controller is not finite"
        loop.memory = memory
        if step is None:
            return None, NOT_DONE
        if not step.reason:
            return step, ""
        return step, step.reason + describe_binding_limits(self.arm, step)

    def _watch_clearance(self) -> None:
        """Let the controller keep the measured arm clear, too, where drives lag or sag."""
        controller = self._steps.controller
        displacement = self._feedback.displacement
        if not isinstance(controller, Geodesic) or controller.offset is displacement:
            return
        if controller.scene is not None:
            self._steps.controller = controller.with_offset(displacement)

    def _displace_tasks(self) -> None:
        """Have the measured arm take the tasks of the controller, once its command has come to rest.

        In motion the displacement changes with the lag of the drives, and other tasks need another path.
        """
        controller = self._steps.controller
        if not self._tasks or not isinstance(controller, Geodesic) or not self._feedback.compensates:
            return
        offset = self._feedback.rest_offset
        if offset is not self._displaced:
            self._displaced = offset
            tasks = tuple(Displaced(task, offset) for task in self._tasks)
            self._steps.controller = replace(controller, tasks=tasks)

    def _watch_blockages(self, decision: Decision, dq: Array, error: float | None, dt: float) -> None:
        """Watch whether obstacles keep the measured arm from its target [m], or from its margin, for long."""
        displacement = self._feedback.displacement
        if not np.any(np.abs(dq) > CONVERGED * self.arm.joint_units):
            self._pursuit.rest(displacement, dt)
            self._evasion.rest(displacement, dt)
            return
        step = decision.step
        limited = step is not None and bool(step.near) and not step.following_path
        known = displacement is not None and self.scene is not None
        distances = None
        if known and self.scene is not None and not self.scene.velocities:
            distance = self.scene.margin
            if self._clearance is not None and self._clearance[1] is self._feedback.measured:
                distance = self._clearance[2].distance
            distances = {"missing clearance": max(0.0, self.scene.margin - distance)}
        self._evasion.move(distances if decision.evading else None, dt)
        pursues = limited and decision.compensated is not None and error is not None
        if distances is not None and error is not None:
            distances = {"mean error": error, **distances}
        self._pursuit.move(distances if pursues else None, dt)

    def _has_other_obstacles(self, scene: Scene) -> bool:
        """Whether obstacles have moved, by more than noise within the margin, since the arm tried anew."""
        noise = 2.0 * scene.margin + STALL.gain * self.arm.length
        return self._tried is None or scene.displacement(self._tried, self.arm.length) > noise

    def _try_again(self) -> None:
        """Begin anew to pursue the target and to evade obstacles."""
        self._tried = self.scene
        self._pursuit.restart()
        self._evasion.restart()

    def _describe_blockage(self, missed: str, blockage: Blockage) -> str:
        """Say what the arm has missed, for how long, and what the measured arm was closest to."""
        text = f"obstacles hinder the arm: {missed} for {blockage.patience:.3g} s"
        if self._clearance is None:
            return text
        closest = self._clearance[2]
        return f"{text}; {describe_distance(closest.pair or (), closest.distance)}"

    @property
    def at_rest(self) -> bool:
        """Whether what is sent does not move, and no step that is still to come moves it."""
        memory = self._loop.memory
        compensating = self._sag is not None and self._sag.moving
        return memory is None or not (self._smoothing.moving or bool(np.any(memory.dq)) or compensating)

    def _take_limits(self) -> None:
        """Let the latest limits take effect, at rest."""
        self._former = None
        self._period = self._dt = cycle_of(self._limits)
        self._loop.filter = SmoothSteps(self.arm, self._of_command(self._limits))
        if self._sag is not None:
            self._sag.take(self._limits)
            self._sag.smooth()

    def _judge_arrival(self, feedback: FeedbackState, dt: float) -> None:
        """Judge from the measurements so far whether the arm is at its target, and settle there."""
        points = self._feedback.points
        positions = self._feedback.measured
        target = self._target
        if feedback.tracking_error is None or feedback.reason:
            return
        if points is not None and positions is not None and target is not None:
            self._arrival.update(points, self._feedback.deviation, positions, target, dt)
            self._feedback.settled = self._arrival.arrived

    @property
    def _rests(self) -> bool:
        """Whether the arm is to rest where it is, as it would only follow the noise of its measurements."""
        return self._arrival.arrived and not self._feedback.compensates

    @property
    def _smoothing(self) -> SmoothSteps:
        return cast(SmoothSteps, self._loop.filter)

    def _hold(self, measured: bool) -> tuple[Memory, bool]:
        """Brake and hold, or evade obstacles that approach or are too close, which needs a measured state.

        Returns:
            The memory after that step, and whether the arm evades.
        """
        loop = self._loop
        braked = loop.braked()
        controller = self._steps.controller
        if not measured or not isinstance(controller, Geodesic) or controller.scene is None:
            return braked, False
        may_evade = bool(controller.scene.moving) or controller.offset is not None
        if not may_evade or (self._evasion.lasting and not controller.scene.velocities):
            return braked, False
        state = loop.ahead
        target = self._target or Target.from_configuration(self.arm, state.q)
        kept = controller.keep_clear(state, target, loop.limits, loop.motion)
        return kept, bool(np.any(np.abs(kept.dq - braked.dq) > ROUNDING * self.arm.joint_units))

    def _target_problem(self) -> str:
        """Return why the target cannot be used; empty if it can."""
        if self._target is None:
            return "no target"
        if self._age > self._timeout:
            return f"the target is {self._age:.3g} s old; it expired after {self._timeout:.3g} s"
        return ""

    def _make_report(
        self, feedback: FeedbackState, decision: Decision, dq: Array, sent: Array, passed: float
    ) -> Report:
        """Describe a cycle of a duration [s], with the steps of the command and of what was sent, (nv,)."""
        step = decision.step
        target = self._target
        points = self._feedback.points
        error = None if target is None or points is None else target.mean_distance(points)
        status, reason = self._judge_status(feedback, decision, dq, error)
        age = None if target is None else self._age
        relaxed = () if step is None else step.violated_constraints
        relaxed += self._lost_limits(relaxed) + self._lost_clearance() + self._lost_compensation()
        relaxed += self._lost_hold()
        period = cycle_of(self._limits)
        duration = min(max(passed, MIN_CYCLE * period), period)
        bounds = self._limits.for_arm(self.arm)
        reached = self._feedback.positions
        begins = None if reached is None or self._torques_kept(sent) else reached - dq
        for exceeded in self._rates.exceeded(sent, duration, bounds, begins):
            # Also while the jerk filter spreads such a step over later cycles, or the arm waits for a path.
            harder = self.scene is not None and exceeded.startswith("acceleration")
            text = BRAKING_HARDER if harder else exceeded
            relaxed += (text,) * (text not in relaxed)
        failures = tuple(self._told_apart(failure) for failure in feedback.failures)
        return Report(status, reason, error, feedback.tracking_error, age, relaxed, step, failures=failures)

    def _torques_kept(self, sent: Array) -> bool:
        """Whether the controller has computed the torques of a step that was sent, (nv,), ahead."""
        memory = self._loop.memory
        if self._smoothing.active or not isinstance(memory, GeodesicMemory) or memory.progress is None:
            return False
        ahead = memory.progress.ahead
        return ahead is not None and ahead.stopping is not None and np.array_equal(sent, memory.dq)

    def _told_apart(self, failure: JointFailure) -> JointFailure:
        """Return a failure of a joint, with its kind as torques tell it."""
        if self._touch is None or failure.kind != "astray":
            return failure
        return failure._replace(kind=self._touch.fault_of(self.arm.joint_names.index(failure.joint)))

    def _describe_sent(self, feedback: FeedbackState, decision: Decision, dq: Array) -> Step | None:
        """Return the step dq that was sent, as the controller described it; None if it computed none."""
        step = decision.step
        aim = decision.compensated or self._target
        sent = self._feedback.state
        before = feedback.state
        if step is None or aim is None or sent is None or before is None or np.array_equal(step.dq, dq):
            return step
        after = sent.chain_state
        most = STALL.rounding * self.arm.length
        rises = aim.mean_distance(after.points) > aim.mean_distance(before.chain_state.points) + most
        return step._replace(dq=np.array(dq), error_increasing=rises)

    def _judge_status(
        self, feedback: FeedbackState, decision: Decision, dq: Array, error: float | None
    ) -> tuple[str, str]:
        """Return status and reason of a cycle with a step dq and a measured mean error [m]."""
        reason = feedback.reason or decision.reason
        compensated = decision.compensated
        if decision.step is not None and self._smoothing.moving and not feedback.reason:
            reason = ""  # the jerk filter has not settled yet
        touched = self._touch is not None and bool(self._touch.reason)
        stalled = (decision.step is not None or self._pursuit.lasting) and not (feedback.reason or touched)
        stopped = "evading" if decision.evading else "stalled" if stalled else "holding"
        status = stopped if reason else "moving"
        aimed = compensated is not None or (self._rests and not self._target_problem())
        if feedback.reason or decision.evading or not aimed or error is None or feedback.state is None:
            return status, reason
        moved = float((np.abs(dq) / self.arm.joint_units).max())
        if moved <= ROUNDING and error <= CONVERGED * self.arm.length:
            self._arrival.arrive()
        if moved <= CONVERGED and self._arrival.arrived:
            return "converged", ""
        if compensated is not None:
            distance = compensated.mean_distance(feedback.state.chain_state.points)
            self._feedback.falls_short = distance > CONVERGED * self.arm.length
            if distance <= ARRIVAL.aimed * self.arm.length:
                return self._await_arrival(reason)
        return status, reason

    def _await_arrival(self, reason: str) -> tuple[str, str]:
        """Return status and reason of an arm whose command is near where it aims, but which is not there yet.

        A `reason` why the controller does not move it is known if the command cannot be there either.
        """
        positions = self._arrival.positions
        if self._arrival.standing < ARRIVAL.standing_time or self._target is None or positions is None:
            return "moving", ""
        if reason and self._feedback.falls_short:
            return "stalled", reason
        return "stalled", self._feedback.describe_shortfall(self._target, positions)

    def _lost_limits(self, known: tuple[str, ...]) -> tuple[str, ...]:
        """Return a message if a joint of the command is outside its limits, unless it is known."""
        positions = self._feedback.positions
        limits = self.arm.limits
        if positions is not None:
            positions = self._sent_positions(positions)
        if positions is None or any(text.startswith("position limit") for text in known):
            return ()
        outside = np.maximum(limits.lower - positions, positions - limits.upper) / self.arm.joint_units
        joint = int(outside.argmax())
        if outside[joint] <= CONVERGED:
            return ()
        unit = "m" if self.arm.slides[joint] else "rad"
        allowed = f"{limits.lower[joint]:.4g} to {limits.upper[joint]:.4g} {unit}"
        name = self.arm.joint_names[joint]
        return (f"position limit: joint {name!r} is at {positions[joint]:.4g}, outside {allowed}",)

    def _lost_hold(self) -> tuple[str, ...]:
        """Return a message if the motors cannot hold the arm at the target."""
        target = self._target
        limits = self._limits
        if target is None or target.q is None or limits.effort is None:
            return ()
        known = self._overload
        if known is None or known[0] is not target or known[1] is not limits:
            overload = find_overload(self.arm, target.q, limits)
            words = () if overload is None else (f"torque limit at the target: {overload}",)
            self._overload = known = target, limits, words
        return known[2]

    def _lost_compensation(self) -> tuple[str, ...]:
        """Return a message if a joint cannot compensate sag within its position limits."""
        if self._sag is None:
            return ()
        cut = np.abs(self._sag.cut) / self.arm.joint_units
        joint = int(cut.argmax())
        if cut[joint] <= CONVERGED:
            return ()
        unit = "m" if self.arm.slides[joint] else "rad"
        lacking = f"{cut[joint] * self.arm.joint_units[joint]:.3g} {unit}"
        name = self.arm.joint_names[joint]
        return (f"position limit: joint {name!r} lacks {lacking} to compensate sag",)

    def _lost_clearance(self) -> tuple[str, ...]:
        """Return a message if the measured arm or the command is too close to something.

        The command is as the jerk filter can cut a corner, the measured arm as it can lag or sag.
        """
        sent = self._feedback.state
        measured = self._feedback.measured
        if self.scene is None or sent is None:
            return ()
        words: list[str] = []
        if self._smoothing.active:
            words += self._describe_clearance(CollisionModel(self.arm, self.scene).minimum(sent.q))
        if measured is not None and self._may_be_close(measured):
            model = CollisionModel(self.arm, self.scene)
            closest = model.minimum(self.arm.configuration(measured))
            self._clearance = (self.scene, measured, closest)
            words += self._describe_clearance(closest)
        return tuple(dict.fromkeys(words))

    def _may_be_close(self, positions: Array) -> bool:
        """Return whether the arm may be too close at joint positions (nv,), given the last distance."""
        if self._clearance is None or self._clearance[0] is not self.scene or self.scene is None:
            return True
        _, before, closest = self._clearance
        # shapes may extend beyond the control points
        arms = np.where(self.arm.slides, 1.0, 2.0 * self.arm.length)
        return bool(closest.distance - np.abs(positions - before) @ arms < self.scene.margin)

    def _describe_clearance(self, closest: Closest) -> tuple[str, ...]:
        margin = 0.0 if self.scene is None else self.scene.margin
        if closest.distance >= 0.999 * margin:  # the loss of less is not worth a word
            return ()
        return (describe_lost_margin(closest.pair or (), closest.distance, margin),)
