"""What an operator does with an arm: it moves while something is held, else holds, and says why."""

from __future__ import annotations

import time
from collections.abc import Callable
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
from pinposture.errors import InvalidValue
from pinposture.motion import Report, Tracker
from pinposture.operate.control import Control, Order
from pinposture.operate.leaders import TipLeader, leader_of
from pinposture.placement.target import target_at
from pinposture.units import ROUNDING, length_text

Array = NDArray[np.float64]


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
    five times as long as to move it."""

    latest: float = 4.0
    """Largest duration of a cycle that counts when the tip is braked, in nominal ones."""

    drawing: float = 0.2
    """Time between two drawings of the way of the tip [s]."""


OPERATION = OperationSettings()


class Shown(NamedTuple):
    """A cycle, as a page shows it.

    Attributes:
        measured: the measured configuration, (nq,); None if it is not known.
        commanded: the commanded configuration, (nq,); None before something was held.
        scene: what the arm keeps clear of, with what was seen of it.
        mode: "holds", "goes to the start", "runs", "stands" (the tip cannot move) or "waits" (for the arm).
        reason: why it holds, waits or is slower than asked for; empty if all is well.
        report: that of the tracker after the last cycle; None before it.
        line: points of the way of the tip, (n, 3) [m].
        time: when it was [s], by the clock of the operation.
    """

    measured: Array | None
    commanded: Array | None
    scene: Scene
    mode: str
    reason: str
    report: Report | None
    line: Array
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
        shown: the last cycle; may be read from any thread.

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
        self._speed = OPERATION.speed * arm.length if speed is None else require_positive("speed", speed)
        self._limits = limits
        self._clock = clock
        self._leader: TipLeader | None = None
        self._begun = False
        self._velocity = np.zeros(3)
        self._stood: Order | None = None
        self._stood_at = -np.inf
        self._slowed: Limits | None = None
        self._slowed_by = 1.0
        self._full: Limits | None = None
        self._drawn = -np.inf
        self._mode = "holds"
        self._reason = "no cycle yet"
        self.shown = Shown(None, None, Scene(), self._mode, self._reason, None, np.zeros((0, 3)), clock())

    def lead(self, tracker: Tracker, measured: Array | None, scene: Scene, dt: float, held: str = "") -> str:
        """Set the target of a tracker for a cycle.

        Args:
            tracker: the tracker.
            measured: the measured configuration, (nq,); None if it is not known.
            scene: what the arm keeps clear of.
            dt: duration of the cycle [s].
            held: why the arm brakes and holds whatever is held; empty if it does not.

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
        else:
            hold = self._decide(tracker, measured, scene, order, dt)
        if hold:
            self._mode = "holds"
            self._reason = hold
        self._set_limits(tracker, order)
        commanded = None
        with suppress(InvalidValue):  # nothing was held yet
            commanded = tracker.command
        report = tracker.report
        line = self.shown.line
        if self._leader is not None and now - self._drawn > OPERATION.drawing:
            line = self._leader.line
            self._drawn = now
        self.shown = Shown(measured, commanded, scene, self._mode, self._reason, report, line, now)
        return hold

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
        wanted = np.zeros(3) if order is None else self._speed * order.override * order.direction
        waits = self._reason_to_wait(tracker.report)
        if order is not None and waits:
            wanted = np.zeros(3)
        if order is not None and not waits and self._still_stands(order):
            return ""
        self._ease(wanted, dt)
        if order is None and not np.any(self._velocity):
            return released
        before = self._leader.q
        tracker.update(self._leader.move(self._velocity, scene))
        self._mode = "waits" if waits else "runs"
        self._reason = waits or self._leader.reason or "; ".join(tracker.report.violated_constraints)
        if self._leader.q is before and not waits:
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

    def _still_stands(self, order: Order) -> bool:
        """Return whether the tip could not move a moment ago as it is asked again."""
        stood = self._stood
        if stood is None or self._clock() - self._stood_at > OPERATION.standing:
            return False
        return bool(np.array_equal(stood.direction, order.direction))

    def _reason_to_wait(self, report: Report) -> str:
        """Return why the tip is not led on: the arm does not follow; empty if it does."""
        if report.status in ("holding", "evading") and report.reason:
            return report.reason if self._mode != "holds" else ""  # what it held for is over
        behind = report.mean_error or 0.0
        if behind <= OPERATION.behind * self.arm.length:
            return ""
        why = f": {report.reason}" if report.reason else ""
        return f"the arm is {length_text(behind)} behind{why}"

    def _ease(self, wanted: Array, dt: float) -> None:
        """Bring the velocity of the tip, (3,) [m/s], towards what is wanted, in a cycle of a duration [s]."""
        change = wanted - self._velocity
        size = float(np.linalg.norm(change))
        late = (self._clock() - self.shown.time) / dt
        most = min(max(late, 1.0), OPERATION.latest) * dt * cast(TipLeader, self._leader).acceleration
        self._velocity = wanted if size <= most * (1.0 + ROUNDING) else self._velocity + most / size * change

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
