"""What an operator does with an arm: it moves while something is held, else holds, and says why."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from pinposture._validation import require_instance, require_positive
from pinposture.arm import Arm
from pinposture.collision import Scene
from pinposture.control import Limits
from pinposture.control.limits import cycle_of
from pinposture.errors import InvalidValue, PostureError
from pinposture.motion import Report, Tracker
from pinposture.motion.feedback import JointFailure
from pinposture.operate.control import Control, Order
from pinposture.operate.leaders import MovedTip, TipLeader, leader_of
from pinposture.operate.ways import NO_PLAN, CurveAlong, NextStep, Planned, Ways, out_of, towards
from pinposture.placement import Target
from pinposture.placement.target import target_at
from pinposture.task.falling import FailureWatch, take_fallen
from pinposture.task.retreat import WayIn
from pinposture.units import ROUNDING, length_text

Array = NDArray[np.float64]
logger = logging.getLogger(__name__)


class OperationSettings(NamedTuple):
    """How an operator's orders become motion."""

    speed: float = 0.05
    """Full speed of the tip, unless it is given, in arm lengths per second."""

    start: float = 0.01
    """Mean distance of the control points from the start of the leader at which it begins, in arm lengths."""

    behind: float = 0.03
    """Mean distance of the control points from their targets, from which the leader waits, in arm lengths."""

    standing: float = 0.2
    """Time after which a tip that stands tries again [s]: to find that an arm of 41 joints cannot move takes
    half again as long as to move it, and at first five times as long."""

    latest: float = 4.0
    """Largest duration of a cycle that counts when the tip is braked, in nominal ones."""

    drawing: float = 0.2
    """Time between two drawings of the way of the tip [s]."""


OPERATION = OperationSettings()


LOCKING = "a joint that is stuck is being locked"
"""Why the arm holds until it goes on without that joint."""


class Shown(NamedTuple):
    """A cycle, as a page shows it.

    Attributes:
        measured: the measured configuration, (nq,); None if it is not known.
        commanded: the commanded configuration, (nq,); None before something was held.
        scene: what the arm keeps clear of, with what was seen of it.
        mode: "holds", "goes to the start", "runs", "stands" (the tip cannot move) or "waits" (for the
            arm, or for a way around something).
        reason: why it holds, waits or is slower than asked for; empty if all is well.
        report: that of the tracker after the last cycle; None before it.
        line: points of the way of the tip, (n, 3) [m].
        order: what was held; None: nothing.
        led: the configuration to which the arm is led, (nq,); None before it is at its start.
        planned: the way that is planned.
        stuck: what is known of a joint that fails; empty if none does.
        time: when it was [s], by the clock of the operation.
    """

    measured: Array | None
    commanded: Array | None
    scene: Scene
    mode: str
    reason: str
    report: Report | None
    line: Array
    order: Order | None
    led: Array | None
    planned: Planned
    stuck: str
    time: float


class Operation:
    """Leads an arm by what operators hold, cycle by cycle.

        operation = Operation(arm, limits, control)
        hold = operation.lead(tracker, q_measured, scene, dt)  # sets the target of the tracker
        tracker.step(None if hold else q_measured, dt, scene=scene)

    At first the arm goes to where its leader begins: an arm on a feed becomes straight, another one stays.
    Nothing moves unless it is held, this included. After a release the tip is braked along its way, as
    its leader allows, and then the arm holds.

    Attributes:
        arm: the arm.
        control: what is held.
        kind: how the arm is led, in words; empty before it was measured.
        ways: the way that is planned, to be driven while it is held.
        steps: what the operator asks for one by one, postures that were kept included.
        goes_on: whether the arm is exchanged for one without a joint that is stuck, once there is a way out;
            else it holds as long as the tracker does. A joint that was astray before is taken as fallen.
        shown: the last cycle; may be read from any thread.
        watch: called with each cycle, such as `Recorder.add`; it has to return at once.

    Args:
        arm: the arm.
        limits: limits of the joints; `dt` is required.
        control: what is held.
        speed: full speed of the tip [m/s]; None: 5 % of the length of the arm per second.
        clock: returns the time [s].

    Raises:
        InvalidValue: limits without dt, or a speed that is not positive.
    """

    def __init__(
        self,
        arm: Arm,
        limits: Limits,
        control: Control,
        speed: float | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        require_instance("arm", arm, Arm, "an Arm")
        self._dt = cycle_of(limits)
        self.arm = arm
        self.control = control
        self.kind = ""
        self.ways = Ways(limits)
        self.steps: list[NextStep] = []
        self.goes_on = False
        self.watch: Callable[[Shown], object] | None = None
        self._speed = OPERATION.speed * arm.length if speed is None else require_positive("speed", speed)
        self._limits = limits
        self._clock = clock
        self._leader: TipLeader | None = None
        self._begun = False
        self._velocity = np.zeros(3)
        self._moved = np.zeros(3)
        self._stood: Order | None = None
        self._stood_at = -np.inf
        self._slowed: Limits | None = None
        self._slowed_by = 1.0
        self._full: Limits | None = None
        self._drawn = -np.inf
        self._mode = "holds"
        self._reason = "no cycle yet"
        self._led: Array | None = None
        self._way_in = WayIn(arm)
        self._next = 0
        self._stuck: JointFailure | None = None
        self._watched = FailureWatch(arm)
        self._fallen = ""  # name of a joint
        self._to_look = False
        nothing = np.zeros((0, 3))
        self.shown = Shown(
            measured=None,
            commanded=None,
            scene=Scene(),
            mode=self._mode,
            reason=self._reason,
            report=None,
            line=nothing,
            order=None,
            led=None,
            planned=self.ways.planned,
            stuck="",
            time=clock(),
        )

    def lead(
        self,
        tracker: Tracker,
        measured: Array | None,
        scene: Scene,
        dt: float,
        held: str = "",
        speed: float = 1.0,
    ) -> str:
        """Set the target of a tracker for a cycle.

        Args:
            tracker: the tracker.
            measured: the measured configuration, (nq,); None if it is not known.
            scene: what the arm keeps clear of.
            dt: duration of the cycle [s].
            held: why the arm brakes and holds whatever is held; empty if it does not.
            speed: share of the speed that is allowed beside that of the operator, from 0 to 1.

        Returns:
            Why the arm has to brake and hold; empty if it may move.
        """
        now = self._clock()
        order = self.control.order(now)
        if measured is None:
            held = held or "the joints are not measured"
        if held or measured is None:
            self._velocity = np.zeros(3)
            hold = held
        elif tracker.arm is not self.arm:
            hold = LOCKING
        else:
            slowed = None if order is None else order._replace(override=speed * order.override)
            hold = self._decide(tracker, measured, scene, slowed, dt)
        if hold:
            self._mode = "holds"
            self._reason = hold
        elif speed < 1.0 and not self._reason:
            self._reason = f"{100.0 * speed:.0f} % of the speed is allowed"
        self._set_limits(tracker, order)
        commanded = None
        with suppress(InvalidValue):  # nothing was held yet
            commanded = tracker.command
        report = tracker.report
        line = self.shown.line
        if self._leader is not None and now - self._drawn > OPERATION.drawing:
            line = self._leader.line
            self._drawn = now
        self.shown = Shown(
            measured=measured,
            commanded=commanded,
            scene=scene,
            mode=self._mode,
            reason=self._reason,
            report=report,
            line=line,
            order=order,
            led=self._led,
            planned=self.ways.planned,
            stuck=self._describe_failing(report.failures),
            time=now,
        )
        if self.watch is not None:
            self.watch(self.shown)
        return hold

    def _describe_fallen(self) -> str:
        """Return why the tip is not led."""
        return f"{self._fallen} has fallen, as limp or weak: only the way that is planned can be driven"

    def _describe_failing(self, failures: Sequence[JointFailure]) -> str:
        """Return what is known of a joint that fails, with those of the last cycle; empty if none does."""
        if self._stuck is not None:
            return str(self._stuck)
        if self._fallen:
            return self._describe_fallen()
        astray = self._astray
        if astray is None:
            return ""
        fails = str(astray)
        if astray.joint not in {failure.joint for failure in failures}:
            fails = f"{astray.joint} was {astray.kind}, and has not followed its command since"
        return f"{fails}; if it has fallen, look for the way out"

    @property
    def _astray(self) -> JointFailure | None:
        """The joint that was astray last, and has not followed its command since; None if there is none."""
        return next(reversed(self._watched.astray.values()), None)

    def reshape(self, curve: CurveAlong) -> None:
        """Have a way planned to the shape of a curve along the arm. May be called from any thread."""
        shown = self.shown
        if shown.led is not None:
            try:
                find = towards(self.arm, curve.target(self.arm), self._limits, "the curve")
            except PostureError as error:
                logger.info("a curve that the arm cannot take: %s", error)
                return
            self.ways.ask("the curve", shown.led, shown.scene, find)

    def close(self) -> None:
        """End the thread in which ways are planned."""
        self.ways.close()

    def _decide(self, tracker: Tracker, measured: Array, scene: Scene, order: Order | None, dt: float) -> str:
        """Set the target, mode and reason; return why the arm has to hold."""
        if self._leader is None:
            self._leader, self.kind = leader_of(self.arm, self._limits, measured, self._speed)
        if order is not None and order.override == 0.0:
            order = None
            released = "the override is at 0 %"
        else:
            released = self.control.reason
        if not self._begun:
            return self._go_to_start(tracker, measured, order, released)
        hold = self._attend(tracker, measured, scene)
        if hold:
            return hold
        if self.ways.moving or (order is not None and order.along and not np.any(self._velocity)):
            return self._drive(tracker, order, released, scene)
        return self._jog(tracker, order, released, scene, dt)

    def _attend(self, tracker: Tracker, measured: Array, scene: Scene) -> str:
        """Attend to joints that fail, to wishes and to plans; return why the arm has to hold."""
        self._watch_joints(tracker, measured, scene)
        for wish in self.control.wishes():
            self._prepare(wish, scene)
        if self._watched.stands(measured, self._clock()) and self._to_look:
            self._to_look = False
            self._look_out_fallen(tracker, measured, scene)
        way = self.ways.poll(cast(Array, self._led))
        if way is not None and way.arm is not self.arm:
            self._go_on_without_joint(way.arm)
            return LOCKING
        return "" if self._stuck is None else f"{self._stuck}; {self.ways.planned.text}"

    def _jog(self, tracker: Tracker, order: Order | None, released: str, scene: Scene, dt: float) -> str:
        """Lead the tip; return why the arm has to hold."""
        leader = cast(TipLeader, self._leader)
        if self._fallen:
            return self._describe_fallen()
        if order is not None and np.any(order.direction):
            away = leader.rejoin(cast(Array, self._led))
            if away:
                return away
        velocity = np.zeros(3) if order is None else self._speed * order.override * order.direction
        waits = self._reason_to_wait(tracker.report, bool(velocity @ self._moved < 0.0))
        if order is not None and waits:
            velocity = np.zeros(3)
        if order is not None and not waits and self._still_stands(order):
            return ""
        self._ease(velocity, dt)
        if order is None and not np.any(self._velocity):
            return released
        before = leader.q
        tracker.update(leader.move(self._velocity, scene))
        if leader.q is not before:
            self._led = leader.q
            self._moved = self._velocity
            self.ways.lead(self.arm, before, self._led, not leader.withdraws)
            self._way_in.add(self._led)
        self._mode = "waits" if waits else "runs"
        self._reason = waits or leader.reason or "; ".join(tracker.report.violated_constraints)
        if leader.q is before and not waits:
            self._mode = "stands"
            self._reason = self._reason.removeprefix("stands: ")
            self._velocity = np.zeros(3)
            self._stood = order
            self._stood_at = self._clock()
        return ""

    def _go_to_start(self, tracker: Tracker, measured: Array, order: Order | None, released: str) -> str:
        """Set the target where the leader begins; return why the arm has to hold."""
        leader = cast(TipLeader, self._leader)
        start = target_at(self.arm.chain_at(leader.q), np.ones(self.arm.n_modules))
        away = start.mean_distance(self.arm.chain_at(measured).points)
        self._begun = away <= OPERATION.start * self.arm.length
        if self._begun:
            self._led = leader.q
            self._way_in.add(leader.q)
        if order is None:
            go = (
                ""
                if self._begun
                else f"; the start is {length_text(away)} away, and the arm goes there first"
            )
            return f"{released}{go}"
        tracker.update(start)
        self._mode = "goes to the start"
        self._reason = tracker.report.reason
        return ""

    def _drive(self, tracker: Tracker, order: Order | None, released: str, scene: Scene) -> str:
        """Drive the way that is planned, or back; return why the arm has to hold."""
        rate = 0.0 if order is None else order.along * order.override
        if order is not None and rate > 0.0 and order.way != self.ways.planned.number:
            rate = 0.0
            released = "another way is planned by now: release, look, and hold again"
        waits = self._reason_to_wait(tracker.report, rate * self.ways.driven < 0.0)
        if rate > 0.0:
            waits = waits or self.ways.go_around(scene)
        target = self.ways.drive(0.0 if waits else rate, scene)
        way = self.ways.way
        if target is None or way is None:
            return self._end_of_way(rate, waits or released)
        tracker.update(target)
        self._led = way.q
        self._way_in.add(way.q)
        self._mode = "waits" if waits else "stands" if way.reason and not way.rate else "runs"
        self._reason = waits or way.reason or "; ".join(tracker.report.violated_constraints)
        return "" if rate or way.rate else released

    def _end_of_way(self, rate: float, otherwise: str) -> str:
        """Stand at the end of a way as long as it is held; return why the arm has to hold."""
        way = self.ways.way
        if rate == 0.0 or way is None:
            return otherwise if rate == 0.0 else "nothing can be driven back" if rate < 0.0 else NO_PLAN
        self._mode = "stands"  # and takes the last target exactly
        self._reason = "the arm is at the end of the way" if rate > 0.0 else "nothing more can be driven back"
        return ""

    def _prepare(self, wish: str, scene: Scene) -> None:
        """Do what was asked for, one of `WISHES`."""
        led = cast(Array, self._led)
        if wish == "keep":
            name = f"posture {len(self.steps) + 1}"
            self.steps.append(NextStep(name, Target.from_configuration(self.arm, led)))
            self.ways.say(f"{name} is kept")
        elif wish == "next" and self.steps:
            number = self._next % len(self.steps)
            self._next = number + 1
            name, target = self.steps[number]
            words = f"step {number + 1} of {len(self.steps)}, {name}"
            self.ways.ask(words, led, scene, towards(self.arm, target, self._limits, name))
        elif wish == "next":
            self.ways.say("there is no step: keep a posture, or give a task")
        elif self._stuck is not None:
            self._look_out(f"out, with {self._stuck.joint} locked", self._stuck.joint, scene)
        elif self._fallen:
            self._take_as_fallen(self._fallen)
        elif self._astray is not None:
            self._take_as_fallen(self._astray.joint)
        else:
            self.ways.say("no joint fails")

    def _look_out(self, name: str, joint: str, scene: Scene, torque: float | None = None) -> None:
        """Have the way out planned with a joint that sticks, or gives a torque [N m or N]."""
        self.ways.say("whether the arm can come out is being looked for")
        find = out_of(self.arm, self._way_in, joint, self._limits, torque)
        self.ways.ask(name, cast(Array, self._led), scene, find)

    def _take_as_fallen(self, joint: str) -> None:
        """Take a joint that was astray for one that is limp or weak."""
        self._fallen = joint
        self._to_look = True
        self._velocity = np.zeros(3)
        self.ways.say(f"where {joint} comes to rest is waited for")

    def _look_out_fallen(self, tracker: Tracker, measured: Array, scene: Scene) -> None:
        """Look for the way out with a joint that has fallen, with the torque that its drive still gives."""
        try:
            fallen = take_fallen(tracker, self._fallen, measured)
        except PostureError as unknown:
            self.ways.say(str(unknown))
            return
        self._led = fallen.q
        self.ways.forget()
        self._look_out(f"out, with {fallen.joint} {fallen.kind}", fallen.joint, scene, fallen.torque)

    def _watch_joints(self, tracker: Tracker, measured: Array, scene: Scene) -> None:
        """Notice joints that fail; if one is stuck, look for the way out."""
        if not self.goes_on or self._stuck is not None or self._fallen:
            return
        failures = tracker.report.failures
        if failures or self._watched.astray:
            self._watched.update(failures, tracker.command, measured)
        stuck = next((failure for failure in failures if failure.kind == "stuck"), None)
        if stuck is None:
            return
        # What is held means another motion now.
        self._velocity = np.zeros(3)
        if stuck.joint in self._watched.astray:
            self.control.lose("a joint has fallen; release, and hold again")
            self._take_as_fallen(stuck.joint)
            return
        self.control.lose("a joint is stuck; release, and hold again")
        self._stuck = stuck
        self._led = measured
        self.ways.forget()
        self._prepare("out", scene)

    def _go_on_without_joint(self, arm: Arm) -> None:
        """Go on with an arm in which a joint is locked."""
        self.arm = arm
        self._stuck = None
        self._leader = MovedTip(arm, self._limits, cast(Array, self._led), self._speed)
        self.kind = "the tip is moved along straight lines, without the joint that is stuck"

    def _still_stands(self, order: Order) -> bool:
        """Return whether the tip could not move a moment ago as it is asked again."""
        stood = self._stood
        if stood is None or self._clock() - self._stood_at > OPERATION.standing:
            return False
        return bool(np.array_equal(stood.direction, order.direction))

    def _reason_to_wait(self, report: Report, returns: bool) -> str:
        """Return why the tip is not led on: the arm does not follow; empty if it does, or the tip returns."""
        if report.status in ("holding", "evading") and report.reason:
            return report.reason if self._mode != "holds" else ""  # what it held for is over
        if returns:
            return ""
        if report.step is not None and report.step.reason:
            return report.step.reason
        behind = report.mean_error or 0.0
        if behind <= OPERATION.behind * self.arm.length:
            return ""
        why = f": {report.reason}" if report.reason else ""
        return f"the arm is {length_text(behind)} behind{why}"

    def _ease(self, velocity: Array, dt: float) -> None:
        """Bring the velocity of the tip, (3,) [m/s], towards what is wanted, in a cycle of a duration [s]."""
        change = velocity - self._velocity
        size = float(np.linalg.norm(change))
        late = (self._clock() - self.shown.time) / dt
        most = min(max(late, 1.0), OPERATION.latest) * dt * cast(TipLeader, self._leader).acceleration
        self._velocity = (
            velocity if size <= most * (1.0 + ROUNDING) else self._velocity + most / size * change
        )

    def _set_limits(self, tracker: Tracker, order: Order | None) -> None:
        """Slow the tracker down by the override on its way to the start; the leader slows the tip later."""
        if tracker.limits is not self._slowed:
            self._full = tracker.limits  # also if they were replaced meanwhile
            self._slowed = None
        full = cast(Limits, self._full)
        if self._begun or order is None:
            self._slowed = None
        elif self._slowed is None or self._slowed_by != order.override:
            self._slowed_by = order.override
            velocity = order.override * full.for_arm(self.arm).bound / self._dt
            self._slowed = replace(full, velocity=velocity)
        limits = self._slowed or full
        if tracker.limits is not limits:
            tracker.limits = limits
