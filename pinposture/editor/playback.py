"""A motion as it passes before the eyes: which moment of it is shown, by the clock."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pinposture.arm import ArmState
from pinposture.editor.live import Live, at_limit, errors_of
from pinposture.editor.rehearsal import Rehearsal
from pinposture.errors import InvalidValue
from pinposture.motion import Motion
from pinposture.placement import Target
from pinposture.task import Task

if TYPE_CHECKING:
    from pinposture.editor.session import Session

Array = NDArray[np.float64]

SPEEDS = (0.25, 0.5, 1.0, 2.0, 4.0)
"""How many times as fast as in reality a motion can be shown."""

SLOWED = 1.005
"""How many times as long as planned a motion takes before that is told."""


class Moment(NamedTuple):
    """A motion at some time, between two of its cycles perhaps.

    Attributes:
        state: where the arm is.
        target: where its control points should be.
        row: the cycle before, or this very one.
    """

    state: ArmState
    target: Target
    row: int


class Playback:
    """What is shown of the motion of a task. It belongs to the editor's loop, as the session does.

    Attributes:
        rehearsal: what works motions out.
        motion: the motion that is shown; None while the arm of the moment is.
        loop: whether it begins again at its end.

    Args:
        clock: tells the time [s].
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self.rehearsal = Rehearsal()
        self.motion: Motion | None = None
        self.loop = False
        self._clock = clock
        self._task: Task | None = None  # whose motion is shown or waited for
        self._playing, self._waiting = False, False
        self._from, self._since, self._speed = (
            0.0,
            0.0,
            1.0,
        )  # the time of the motion when the clock was at that
        self._seen: tuple[float, Moment] | None = None
        self._told: Task | None = None

    @property
    def playing(self) -> bool:
        """Whether time goes on, or will as soon as there is a motion."""
        return self._playing

    @property
    def waiting(self) -> bool:
        """Whether somebody wants to see a motion that is not there yet."""
        return self._waiting

    @property
    def shown(self) -> bool:
        """Whether a motion is seen, and not the arm of the moment."""
        return self.motion is not None

    @property
    def speed(self) -> float:
        """How many times as fast as in reality it is shown."""
        return self._speed

    @property
    def lasting(self) -> float:
        """How long the motion takes, the way to its first posture included [s]; 0 without one."""
        return 0.0 if self.motion is None else float(self.motion.time[-1])

    @property
    def time(self) -> float:
        """Which moment of the motion is shown [s]; what is asked for, while there is no motion yet."""
        if self.motion is None:
            return self._from
        if not self._playing:
            return min(self._from, self.lasting)
        at = self._from + self._speed * (self._clock() - self._since)
        if self.loop and self.lasting > 0.0:
            return at % self.lasting
        return min(at, self.lasting)

    @property
    def q(self) -> Array | None:
        """The configuration at that moment, (nq,); None while the arm of the moment is to be seen."""
        moment = self.moment
        return None if moment is None else moment.state.q

    @property
    def moment(self) -> Moment | None:
        """The motion at that moment; None if there is none."""
        if self.motion is None:
            return None
        at = self.time
        if self._seen is None or self._seen[0] != at:
            self._seen = at, moment_of(self.motion, at)
        return self._seen[1]

    def play(self, task: Task) -> None:
        """Show the motion of a task from where it stands; from its beginning, if it is over.

        It is worked out first if need be.
        """
        self._want(task)
        at = self.time
        over = self.motion is not None and at >= self.lasting
        self._put(0.0 if over else at)
        self._playing = True

    def rehearse(self, task: Task) -> None:
        """Have the motion of a task worked out, and say what came of it, but show nothing."""
        known = self.rehearsal.of(task)
        if known is None or known.motion is None:
            self._told = None
        self.rehearsal.ask(task)

    def pause(self) -> None:
        """Stand still at the moment that is shown."""
        self._put(self.time)
        self._playing = False

    def seek(self, task: Task, at: float) -> None:
        """Stand still at another moment.

        Args:
            task: whose motion.
            at: which moment [s]; the nearest that there is counts.

        Raises:
            InvalidValue: no moment.
        """
        if not math.isfinite(at):
            raise InvalidValue("time", at, "a finite number of seconds")
        self._want(task)
        self._playing = False
        self._put(max(at, 0.0) if self.motion is None else min(max(at, 0.0), self.lasting))

    def stop(self) -> None:
        """Go back to the arm of the moment, and to the beginning; what is being worked out is given up."""
        if self._waiting:
            self.rehearsal.cancel()
        self.motion, self._task, self._seen = None, None, None
        self._playing, self._waiting, self._from = False, False, 0.0

    def at_speed(self, speed: float) -> None:
        """Show it this many times as fast as in reality, from here on."""
        self._put(self.time)
        self._speed = speed

    def in_loop(self, loop: bool) -> None:
        """Begin again at the end, or not."""
        self._put(self.time)
        self.loop = loop

    def follow(self, session: Session) -> None:
        """Keep to what is edited: called by the loop again and again.

        Whoever edits wants to see the arm of the moment. What came of a rehearsal is told once.
        """
        task = session.task
        if self._task is not None and (self._task is not task or session.proposal is not None):
            self.stop()
        done = self.rehearsal.of(task)
        if done is not None and self._told is not task:
            self._told = task
            _tell(session, done.motion, done.reason)
        if self._waiting and done is not None:
            if done.motion is None:
                self.stop()
                return
            self._waiting, self.motion = False, done.motion
            self._put(min(self._from, self.lasting))
        elif self._playing and self.motion is not None and not self.loop and self.time >= self.lasting:
            self.pause()

    def seen(self, live: Live) -> Live:
        """The arm as it is to be seen: at the moment of the motion, if there is one, else as it is.

        What the arm makes of the shape that is edited, stays as it is.
        """
        moment, motion = self.moment, self.motion
        if moment is None or motion is None or motion.arm is not live.arm:
            return live
        state, target, row = moment
        step, cycle = np.zeros(motion.arm.nv), max(motion.steps - 1, 0)
        if motion.steps and self.time < self.lasting:
            step = motion.velocities[min(row, cycle)] * motion.dt
        active = (
            motion.run.active[min(row, cycle)]
            if motion.steps
            else np.zeros(len(state.points), dtype=np.bool_)
        )
        return live._replace(
            state=state,
            target=target,
            errors=errors_of(state, target),
            active=active,
            at_limit=at_limit(state, step, motion.run.limits.for_arm(motion.arm).bound),
            status="moving" if self.time < self.lasting else "converged",
            reason="",
            steps=-1 - round(1e6 * self.time),  # another number for each moment, and none of the arm's own
        )

    def close(self) -> None:
        """End."""
        self.rehearsal.close()

    def _want(self, task: Task) -> None:
        """Have the motion of a task here as soon as can be."""
        if self._task is task and (self._waiting or self.motion is not None):
            return
        at = self.time
        self.motion, self._task, self._seen, self._waiting = None, task, None, True
        self._put(at)
        self.rehearse(task)

    def _put(self, at: float) -> None:
        self._from, self._since = at, self._clock()


def moment_of(motion: Motion, at: float) -> Moment:
    """A motion at any time: between two cycles, joints move evenly.

    Args:
        motion: the motion.
        at: when, counted from its first row [s]; before and after it, the arm stands still.
    """
    arm, cycles = motion.arm, min(max(at / motion.dt, 0.0), float(motion.steps))
    row = min(int(cycles + 1e-9), motion.steps)
    share = cycles - row
    q, off = motion.q[row], motion.targets[row] - motion.run.points[row]
    if share > 1e-9:
        q = arm.integrate(q, share * arm.difference(q, motion.q[row + 1]))
        # Not the targets themselves: straight lines between them would be errors that the motion has not.
        off = (1.0 - share) * off + share * (motion.targets[row + 1] - motion.run.points[row + 1])
    state = arm.at(q)
    return Moment(state, Target(state.points + off, motion.asked[row].astype(np.float64)), row)


def _tell(session: Session, motion: Motion | None, reason: str) -> None:
    """Say what came of a rehearsal."""
    if motion is None:
        session.say(f"no motion: {reason}", "error")
    elif not motion.converged:
        session.say(f"the motion does not end as it should: {motion.run.reason}", "warning")
    elif motion.detours:
        session.say(f"a motion of {motion.time[-1]:.4g} s; {motion.detours[0]}", "warning")
    else:
        slower = f", {motion.slowing:.3g} times as long as planned" if motion.slowing > SLOWED else ""
        session.say(f"a motion of {motion.time[-1]:.4g} s{slower}")
