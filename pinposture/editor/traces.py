"""What plots show against time: errors of the control points, rates of the joints relative to limits."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pinposture.control import Limits
from pinposture.editor.live import Live
from pinposture.editor.solver import in_cycles
from pinposture.motion import Motion
from pinposture.motion.trajectory import limit_shares

Array = NDArray[np.float64]

SPAN = 10.0
"""How far back the trace of the arm of the moment goes [s]."""

PAUSE = 1.0
"""After how long without a look at the arm its trace begins anew [s]."""

ROWS = 600
"""The most rows of a trace; of more, the largest of neighbours stand for them."""


class Trace(NamedTuple):
    """What there is to plot.

    Attributes:
        time: when, (n,) [s].
        mean: mean distance of the control points from their targets, (n,) [m].
        largest: the largest, (n,) [m].
        speed: the largest joint speed relative to its limit, (n,); None if there is no limit.
        acceleration: the same of accelerations, (n,); None if there is no limit.
    """

    time: Array
    mean: Array
    largest: Array
    speed: Array | None
    acceleration: Array | None

    def at(self, moment: float) -> tuple[float, float, float | None, float | None]:
        """Mean and largest error, speed and acceleration at a moment [s]."""

        def of(values: Array | None) -> float | None:
            return None if values is None else float(np.interp(moment, self.time, values))

        return (
            float(np.interp(moment, self.time, self.mean)),
            float(np.interp(moment, self.time, self.largest)),
            of(self.speed),
            of(self.acceleration),
        )


def trace_of(motion: Motion) -> Trace:
    """The trace of a motion."""
    speeds, accelerations = limit_shares(motion.run)
    times = motion.time
    if speeds is not None:
        # a speed is that between two rows
        speeds = (
            np.interp(times, times[1:] - 0.5 * motion.dt, speeds) if len(speeds) else np.zeros(len(times))
        )
    largest = np.asarray(motion.run.point_errors.max(axis=1))
    return _thinned(Trace(times, motion.mean_error, largest, speeds, accelerations))


class Recent:
    """The trace of the arm of the moment, over the last seconds.

    Args:
        clock: tells the time [s].
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._rows: deque[tuple[float, float, float, float]] = deque()
        self._last: Live | None = None

    def add(self, live: Live, limits: Limits) -> None:
        """Take note of where the arm is.

        Args:
            live: the arm.
            limits: within what it moves.
        """
        now, last = self._clock(), self._last
        if self._rows and self._rows[-1][0] < now - PAUSE:
            self._rows.clear()
        while len(self._rows) > 1 and self._rows[1][0] < now - SPAN:
            self._rows.popleft()
        if last is not None and live.steps == last.steps:
            return
        speed = 0.0
        if last is not None and live.arm is last.arm and live.steps > last.steps:
            bound = in_cycles(limits).for_arm(live.arm).bound * (live.steps - last.steps)
            limited = np.isfinite(bound) & (bound > 0.0)
            moved = np.abs(live.arm.difference(last.state.q, live.state.q))
            speed = float((moved[limited] / bound[limited]).max(initial=0.0))
        self._last = live
        self._rows.append((now, live.mean_error, float(live.errors.max(initial=0.0)), speed))

    @property
    def changing(self) -> bool:
        """Whether anything moved in the last seconds."""
        rows = list(self._rows)
        return bool(rows) and any(row[1:] != rows[-1][1:] for row in rows)

    @property
    def trace(self) -> Trace:
        """The trace; times are counted back from now, and the arm is as it was last."""
        now = self._clock()
        rows = np.array(self._rows or [(now, 0.0, 0.0, 0.0)])
        rows = np.concatenate([rows[:1], rows, rows[-1:]])
        times = np.clip(rows[:, 0] - now, -SPAN, 0.0)
        times[0], times[-1] = -SPAN, 0.0  # to the last bit: the axis stays as it is
        return _thinned(Trace(times, rows[:, 1], rows[:, 2], rows[:, 3], None))


def with_lines(
    times: Array, columns: Sequence[Array], marks: Sequence[Array], low: float, high: float
) -> tuple[Array, ...]:
    """Columns against time, and columns that draw upright lines at some moments.

    A line is a step from below the picture to above it, or back: only its flank is seen.

    Args:
        times: of the columns, (n,) [s].
        columns: each (n,).
        marks: the moments of the lines of each further column, each (k,) [s], increasing.
        low: a value below the picture.
        high: a value above it.

    Returns:
        Times, columns and further columns, all of one length.
    """
    ends = [np.concatenate([moments, np.nextafter(moments, np.inf)]) for moments in marks]
    x = np.sort(np.concatenate([times, *ends]))
    given = [np.interp(x, times, column) for column in columns]
    lines = [np.where(np.searchsorted(moments, x) % 2, high, low) for moments in marks]
    return (x, *given, *lines)


def _thinned(trace: Trace) -> Trace:
    count = len(trace.time)
    if count <= ROWS:
        return trace
    edges = np.unique(np.linspace(0, count, ROWS, endpoint=False).astype(np.intp))

    def most(values: Array | None) -> Array | None:
        return None if values is None else np.asarray(np.maximum.reduceat(values, edges))

    times = np.array(trace.time[edges])
    times[-1] = trace.time[-1]
    mean, largest = np.maximum.reduceat(trace.mean, edges), np.maximum.reduceat(trace.largest, edges)
    return Trace(times, mean, largest, most(trace.speed), most(trace.acceleration))
