"""The motion of a task: worked out in a thread, and played by the clock."""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Callable
from threading import Event, Lock, Thread
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pinposture.arm import ArmState
from pinposture.editor.solver import Live, at_limit, errors_of
from pinposture.errors import InvalidValue, PostureError
from pinposture.motion import Motion
from pinposture.placement import Target
from pinposture.task import Task

if TYPE_CHECKING:
    from pinposture.editor.session import Session


# The motion of a task, worked out beside everything else: when somebody asks, and again when it changed.

logger = logging.getLogger(__name__)

LOOKING = 0.5
"""How much of the work is to find the postures, as far as the progress tells; the rest is the motion."""

BREATH = 0.0005
"""How long it stands back after each cycle [s]: threads take turns, and the arm of the moment has to move."""


class Rehearsed(NamedTuple):
    """What came of a task.

    Attributes:
        task: the task.
        motion: its motion; None if there is none.
        reason: why there is none, in words; empty if there is one.
    """

    task: Task
    motion: Motion | None
    reason: str = ""


class _Cancelled(Exception):
    """Nobody wants to know any more."""


class Rehearsal:
    """Works out motions in threads of its own, and leaves the last one to be looked up.

    Only what was asked for last counts; what is under way for another task is given up at its next cycle.
    """

    def __init__(self) -> None:
        self._lock = Lock()
        self._asked: Task | None = None  # what is under way
        self._over = Event()
        self._share = 0.0
        self._last: Rehearsed | None = None
        self._thread: Thread | None = None

    @property
    def working(self) -> bool:
        """Whether something is under way."""
        with self._lock:
            return self._asked is not None

    @property
    def progress(self) -> float:
        """How far what is under way has come, in [0, 1]."""
        with self._lock:
            return self._share

    def of(self, task: Task) -> Rehearsed | None:
        """What came of a task; None if that is not known, or no longer."""
        with self._lock:
            return self._last if self._last is not None and self._last.task is task else None

    def ask(self, task: Task) -> None:
        """Have the motion of a task worked out, unless it is known, or under way."""
        with self._lock:
            if self._asked is task or (self._last is not None and self._last.task is task):
                return
            self._over.set()  # the one before
            self._over, self._asked, self._share = Event(), task, 0.0
            over, before = self._over, self._thread
            self._thread = Thread(
                target=self._run, args=(task, over, before), name="pinposture-rehearsal", daemon=True
            )
            self._thread.start()

    def cancel(self) -> None:
        """Give up what is under way."""
        with self._lock:
            self._over.set()
            self._asked, self._share = None, 0.0

    def close(self) -> None:
        """End."""
        self.cancel()
        if self._thread is not None:
            self._thread.join(timeout=5.0)

    def _run(self, task: Task, over: Event, before: Thread | None) -> None:
        if before is not None:
            before.join()  # two at a time would only be in each other's way
        try:
            done = self._rehearsed(task, over)
        except _Cancelled:
            return
        with self._lock:
            if over.is_set():
                return
            self._last, self._asked, self._share = done, None, 0.0

    def _rehearsed(self, task: Task, over: Event) -> Rehearsed:
        def tell(share: float) -> None:
            if over.is_set():
                raise _Cancelled
            with self._lock:
                if not over.is_set():
                    self._share = share
            time.sleep(BREATH)

        def found(done: int, count: int) -> None:
            tell(LOOKING * done / max(count, 1))

        def moved(seconds: float, lasting: float) -> None:
            tell(LOOKING + (1.0 - LOOKING) * min(seconds / lasting, 1.0))

        try:
            tell(0.0)
            reference = task.reference(found)
            return Rehearsed(task, task.perform(reference, moved))
        except (PostureError, ArithmeticError, np.linalg.LinAlgError) as error:
            return Rehearsed(task, None, " ".join(str(error).split()))
        except _Cancelled:
            raise
        except Exception as error:  # a fault of ours; whoever waits for it has to be told
            logger.exception("a motion could not be worked out")
            return Rehearsed(task, None, f"the motion could not be worked out ({error})")


# A motion as it passes before the eyes: which moment of it is shown, by the clock.

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
    return Moment(state, Target(state.points + off, motion.target_mask[row].astype(np.float64)), row)


def _tell(session: Session, motion: Motion | None, reason: str) -> None:
    """Say what came of a rehearsal."""
    if motion is None:
        session.say(f"no motion: {reason}", "error")
    elif not motion.converged:
        session.say(f"the motion does not end as it should: {motion.run.reason}", "warning")
    elif motion.deviations:
        session.say(f"a motion of {motion.time[-1]:.4g} s; {motion.deviations[0]}", "warning")
    else:
        slower = f", {motion.time_scale:.3g} times as long as planned" if motion.time_scale > SLOWED else ""
        session.say(f"a motion of {motion.time[-1]:.4g} s{slower}")
