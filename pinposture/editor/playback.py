"""The motion of a task: computed beside the editor's loop, and played by the clock."""

from __future__ import annotations

import math
import operator
import time
from collections.abc import Callable
from threading import Event
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pinposture.arm import ArmState
from pinposture.editor.solver import Live, at_limit, errors_of
from pinposture.errors import InvalidValue
from pinposture.motion import Trajectory
from pinposture.motion.held import obstacle_motions
from pinposture.motion.latest import EXPECTED_ERRORS, Latest, Outdated
from pinposture.placement import Target
from pinposture.task import Task

Array = NDArray[np.float64]


class PreviewResult(NamedTuple):
    """What came of a task."""

    motion: Trajectory | None  # its motion; None if there is none
    reason: str = ""  # why there is none; empty if there is one


class Preview:
    """Computes motions of tasks, and keeps the last one.

    Only the last task counts; the motion of another task is abandoned at its next cycle.
    """

    def __init__(self) -> None:
        self._motions: Latest[Task, Trajectory] = Latest(
            self._perform, "pinposture-preview", same=operator.is_
        )
        self._progress = 0.0

    @property
    def working(self) -> bool:
        """Whether a motion is being computed."""
        return self._motions.working

    @property
    def progress(self) -> float:
        """Progress of the motion being computed, in [0, 1]."""
        return self._progress if self.working else 0.0

    def of(self, task: Task) -> PreviewResult | None:
        """Return the motion of a task; None if it is not known, or no longer."""
        done = self._motions.done
        if done is None or done.request is not task:
            return None
        if done.error is None:
            return PreviewResult(done.answer)
        reason = " ".join(str(done.error).split())
        expected = isinstance(done.error, EXPECTED_ERRORS)
        return PreviewResult(None, reason if expected else f"the motion could not be computed ({reason})")

    def ask(self, task: Task) -> None:
        """Have the motion of a task computed, unless it was asked for last."""
        self._motions.ask(task)

    def cancel(self) -> None:
        """Abandon the motion being computed."""
        self._motions.cancel()

    def close(self) -> None:
        """Abandon the motion, and wait until that is done."""
        self._motions.close()

    def _perform(self, task: Task, outdated: Event) -> Trajectory:
        def report(progress: float) -> None:
            if outdated.is_set():
                raise Outdated
            self._progress = progress
            time.sleep(0.0005)  # for the other threads

        def found(done: int, count: int) -> None:
            report(0.5 * done / max(count, 1))  # the first half of the progress is for finding the postures

        def moved(seconds: float, duration: float) -> None:
            report(0.5 + 0.5 * min(seconds / duration, 1.0))

        report(0.0)
        edited = task.edited()  # of no file, whose lines may have changed
        motion = edited.perform(edited.reference(found), moved)
        _ = motion.slowdown  # found here, not in the editor's loop: it may look at a scan
        return motion


class MotionSample(NamedTuple):
    """A motion at some time, perhaps between two of its cycles."""

    state: ArmState  # where the arm is
    target: Target  # where its control points should be
    row: int  # the last cycle before or at that time


class Playback:
    """The player of the motion of a task. It belongs to the editor's loop, as the session does.

    Attributes:
        preview: computes the motions.
        motion: the motion that is shown; None while the live arm is.
        playing: whether the motion is running, or will be as soon as there is one.
        waiting: whether a motion is to be shown that is not computed yet.
        speed: of the playback, relative to real time.
        loop: whether it starts again at its end.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self.preview = Preview()
        self.motion: Trajectory | None = None
        self.playing = False
        self.waiting = False
        self.loop = False
        self.speed = 1.0
        self._clock = clock
        self._task: Task | None = None  # whose motion is shown or waited for
        # The motion was at time `_from` when the clock was at `_since`.
        self._from = 0.0
        self._since = 0.0
        self._last_sample: tuple[float, MotionSample] | None = None
        self._reported: Task | None = None

    @property
    def shown(self) -> bool:
        """Whether a motion is shown, and not the live arm."""
        return self.motion is not None

    @property
    def lasting(self) -> float:
        """How long the motion takes, including the path to its first posture [s]; 0 without one."""
        return 0.0 if self.motion is None else float(self.motion.time[-1])

    @property
    def time(self) -> float:
        """Which moment of the motion is shown [s]; the one asked for, while there is no motion yet."""
        if self.motion is None:
            return self._from
        if not self.playing:
            return min(self._from, self.lasting)
        at = self._from + self.speed * (self._clock() - self._since)
        if self.loop and self.lasting > 0.0:
            return at % self.lasting
        return min(at, self.lasting)

    @property
    def q(self) -> Array | None:
        """The configuration at that moment, (nq,); None while the live arm is shown."""
        sample = self.sample
        return None if sample is None else sample.state.q

    @property
    def sample(self) -> MotionSample | None:
        """The motion at that moment; None if there is none."""
        if self.motion is None:
            return None
        at = self.time
        if self._last_sample is None or self._last_sample[0] != at:
            self._last_sample = at, sample_at(self.motion, at)
        return self._last_sample[1]

    @property
    def carried(self) -> dict[str, pin.SE3]:
        """Poses of the obstacles that the arm has held by then, by name, world frame."""
        sample = self.sample
        run = None if self.motion is None else self.motion.run
        if sample is None or run is None or run.scene is None or not run.held:
            return {}
        moved = obstacle_motions(run.arm, run.q, run.held, run.scene, [sample.row])
        obstacles = run.scene.obstacles
        return {name: motion * obstacles[name].pose(np.zeros(3)) for name, (motion,) in moved.items()}

    def play(self, task: Task) -> None:
        """Play the motion of a task from where it is, or from its beginning if it has ended.

        It is computed first if need be.
        """
        self._request(task)
        at = self.time
        ended = self.motion is not None and at >= self.lasting
        self._set_time(0.0 if ended else at)
        self.playing = True

    def compute_preview(self, task: Task) -> None:
        """Have the motion of a task computed and the result reported, but show nothing."""
        known = self.preview.of(task)
        if known is None or known.motion is None:
            self._reported = None
        self.preview.ask(task)

    def pause(self) -> None:
        """Stop at the moment that is shown."""
        self._set_time(self.time)
        self.playing = False

    def seek(self, task: Task, at: float) -> None:
        """Stop at another moment.

        Args:
            task: whose motion.
            at: which moment [s]; clipped to the motion.

        Raises:
            InvalidValue: not a finite number.
        """
        if not math.isfinite(at):
            raise InvalidValue("time", at, "a finite number of seconds")
        self._request(task)
        self.playing = False
        self._set_time(max(at, 0.0) if self.motion is None else min(max(at, 0.0), self.lasting))

    def stop(self) -> None:
        """Return to the live arm and to the beginning; a motion being computed for this is abandoned."""
        if self.waiting:
            self.preview.cancel()
        self.motion = None
        self._task = None
        self._last_sample = None
        self.playing = False
        self.waiting = False
        self._from = 0.0

    def at_speed(self, speed: float) -> None:
        """Play at another speed, relative to real time."""
        self._set_time(self.time)
        self.speed = speed

    def in_loop(self, loop: bool) -> None:
        """Start again at the end, or not."""
        self._set_time(self.time)
        self.loop = loop

    def follow(self, task: Task, proposing: bool) -> tuple[str, str] | None:
        """Keep up with what is edited; called by the loop. A change of the task ends the playback.

        Args:
            task: the task that is edited.
            proposing: whether there is a proposal to change it.

        Returns:
            A message and its kind when a motion has been computed; None otherwise.
        """
        if self._task is not None and (self._task is not task or proposing):
            self.stop()
        done = self.preview.of(task)
        message = None
        if done is not None and self._reported is not task:
            self._reported = task
            message = _report(done.motion, done.reason)
        if self.waiting and done is not None:
            if done.motion is None:
                self.stop()
                return message
            self.waiting = False
            self.motion = done.motion
            self._set_time(min(self._from, self.lasting))
        elif self.playing and self.motion is not None and not self.loop and self.time >= self.lasting:
            self.pause()
        return message

    def seen(self, live: Live) -> Live:
        """Return the arm as it is shown: at a moment of the motion, or live if there is none.

        The verdict on the shape that is edited stays.
        """
        sample = self.sample
        motion = self.motion
        if sample is None or motion is None or motion.arm is not live.arm:
            return live
        state, target, row = sample
        step = np.zeros(motion.arm.nv)
        cycle = min(row, max(motion.steps - 1, 0))
        if motion.steps and self.time < self.lasting:
            step = motion.velocities[cycle] * motion.dt
        return live._replace(
            state=state,
            target=target,
            errors=errors_of(state, target),
            active=motion.run.active[cycle] if motion.steps else np.zeros(len(state.points), dtype=np.bool_),
            at_limit=at_limit(state, step, motion.run.limits.for_arm(motion.arm).bound),
            status="moving" if self.time < self.lasting else "converged",
            reason="",
            steps=-1 - round(1e6 * self.time),  # differs for each moment, and from all of the live arm
        )

    def close(self) -> None:
        """End the thread."""
        self.preview.close()

    def _request(self, task: Task) -> None:
        """Show the motion of a task as soon as it is there."""
        if self._task is task and (self.waiting or self.motion is not None):
            return
        at = self.time
        self.motion = None
        self._task = task
        self._last_sample = None
        self.waiting = True
        self._set_time(at)
        self.compute_preview(task)

    def _set_time(self, at: float) -> None:
        self._from = at
        self._since = self._clock()


def sample_at(motion: Trajectory, at: float) -> MotionSample:
    """Return a motion at any time; between two cycles, joints move at constant speed.

    Args:
        motion: the motion.
        at: when, counted from its first row [s]; before and after it, the arm stands still.
    """
    arm = motion.arm
    cycles = min(max(at / motion.dt, 0.0), float(motion.steps))
    row = min(int(cycles + 1e-9), motion.steps)
    share = cycles - row
    q = motion.q[row]
    off = motion.targets[row] - motion.run.points[row]
    if share > 1e-9:
        q = arm.integrate(q, share * arm.difference(q, motion.q[row + 1]))
        # Not the targets themselves: straight lines between them would add errors that the motion has not.
        off = (1.0 - share) * off + share * (motion.targets[row + 1] - motion.run.points[row + 1])
    state = arm.at(q)
    return MotionSample(state, Target(state.points + off, motion.target_mask[row].astype(np.float64)), row)


def _report(motion: Trajectory | None, reason: str) -> tuple[str, str]:
    """Return the message on a motion, and its kind."""
    if motion is None:
        return f"no motion: {reason}", "error"
    if not motion.converged:
        return f"the motion does not arrive at its last posture: {motion.run.reason}", "warning"
    if motion.deviations:
        return f"a motion of {motion.time[-1]:.4g} s; {motion.deviations[0]}", "warning"
    heaviest = motion.run.heaviest
    if heaviest is not None and heaviest.load.exceeded:
        return f"a motion of {motion.time[-1]:.4g} s; {heaviest}", "warning"
    if motion.run.sag_faults:
        return f"a motion of {motion.time[-1]:.4g} s; {motion.run.sag_faults[0]}", "warning"
    slower = f", {motion.slowdown}" if motion.slowdown else ""
    return f"a motion of {motion.time[-1]:.4g} s{slower}", "info"
