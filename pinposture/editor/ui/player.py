"""The panel that plays a motion, and its plots."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np
import viser
from numpy.typing import NDArray
from viser import uplot

from pinposture.arm import Arm
from pinposture.control import Limits
from pinposture.editor.edits import times_of
from pinposture.editor.playback import SPEEDS, Playback
from pinposture.editor.session import Session
from pinposture.editor.shape import keyframes_of
from pinposture.editor.solver import Live, limits_per_step
from pinposture.editor.ui.parts import Post, on_change, on_choice, put
from pinposture.motion import Motion
from pinposture.motion.trajectory import limit_shares
from pinposture.task import Task
from pinposture.viz import palette

# What plots show against time: errors of the control points, rates of the joints relative to limits.

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
            bound = limits_per_step(limits).for_arm(live.arm).bound * (live.steps - last.steps)
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


# A plot of the motion that is shown, with a line at the moment of it; without one, of the last seconds.

MILLI = 1e3

SMOOTHLY, NOW_AND_THEN = 0.1, 0.3
"""The least time from one picture to the next, of a motion that is shown, and of the arm itself [s]."""

AT_REST = 3.0
"""The same while nothing changes, for browsers that came since [s]."""

WIDER = 5e-4
"""By how much of its length the time axis changes to and fro."""

HEIGHT = 100
"""Of the plot [pixels]."""

SMALL = 1e-5
"""The smallest error that the plot tells from none, in lengths of the arm."""

NOTHING = 1e-9
"""Error below which there is none to speak of, in lengths of the arm."""

MOST = 1.2
"""Up to which share of limits is shown."""

OUTSIDE = 1e3
"""By how much upright lines are longer than the picture is high, so that their ends are not seen."""

SPEED, ACCELERATION = palette.SPARE[2], palette.SPARE[0]

NONE = np.zeros(0)


class Plots:
    """Errors of the control points, and rates of joints relative to their limits, against time.

    Args:
        server: the page.
        tab: where the plot is to be.
        length: of the arm [m].
    """

    def __init__(self, server: viser.ViserServer, tab: viser.GuiTabHandle, length: float) -> None:
        self._server, self._tab = server, tab
        self._recent, self._length = Recent(), length
        self._known: tuple[Motion, Trace, Array] | None = None
        self._due, self._color, self._wider = 0.0, palette.FINAL, False
        self._shown: tuple[object, object] = None, None
        self._low = float(10.0 ** np.floor(np.log10(SMALL * length * MILLI)))
        self._high = float(10.0 ** np.ceil(np.log10(length * MILLI)))
        with tab:
            self._told = server.gui.add_html("", order=3.0)
        self._plot = self._made()

    def show(self, session: Session, live: Live) -> None:
        """Bring it up to date.

        Args:
            session: what is edited.
            live: the arm as it is seen.
        """
        playback, now = session.playback, time.monotonic()
        if not playback.shown:
            self._recent.add(live, session.task.limits)
        if now < self._due:
            return
        lately = now if self._recent.changing else now // AT_REST
        key = (playback.motion, playback.time) if playback.shown else (None, lately)
        if key == self._shown:
            return
        self._shown, self._due = key, now + (SMOOTHLY if playback.shown else NOW_AND_THEN)
        color = palette.controller_color(session.task.controller.name)
        if color != self._color:
            self._color = color
            self._plot.series = _lines(color)
        trace, marks, at = self._recent.trace, NONE, NONE
        # An axis that a browser drew before it knew its width gets its numbers only when it changes.
        self._wider = not self._wider
        trace.time[0] *= 1.0 + WIDER * self._wider
        if playback.shown:
            trace, marks = self._of(playback)
            at = np.array([playback.time])
        self._plot.data = self._data(trace, marks, at)
        self._tell(trace, playback.time if playback.shown else None)

    def _made(self) -> viser.GuiUplotHandle:
        """The plot, with the lines of the controller."""
        with self._tab:
            return self._server.gui.add_uplot(
                self._data(self._recent.trace, NONE, NONE),
                _lines(self._color),
                scales={
                    "x": {"time": False},
                    "mm": {"distr": 3, "range": (self._low, self._high)},
                    "share": {"range": (0.0, MOST)},
                },
                axes=_axes(),
                legend={"show": False},
                height=HEIGHT,
                padding=(8, 0, 0, 0),
                order=4.0,
            )

    def _of(self, playback: Playback) -> tuple[Trace, Array]:
        """The trace of the motion that is shown, and when it passes its keyframes."""
        motion = playback.motion
        assert motion is not None
        if self._known is None or self._known[0] is not motion:
            rows = sorted({passed.row for passed in motion.waypoints if passed.row is not None})
            self._known = motion, trace_of(motion), motion.time[rows]
        return self._known[1:]

    def _data(self, trace: Trace, marks: Array, at: Array) -> tuple[Array, ...]:
        """The columns of the plot, as its lines are listed."""
        absent = np.full(len(trace.time), -OUTSIDE)  # below the picture
        errors = [np.clip(MILLI * values, self._low, None) for values in (trace.largest, trace.mean)]
        rates = [absent if values is None else values for values in (trace.acceleration, trace.speed)]
        columns = [*errors, *rates, np.ones(len(trace.time))]
        return with_lines(trace.time, columns, (marks, at), -OUTSIDE, OUTSIDE)

    def _tell(self, trace: Trace, moment: float | None) -> None:
        """Say what the lines are, and their values at the moment; None: now."""
        mean, largest, speed, acceleration = trace.at(0.0 if moment is None else moment)
        told = [
            (self._color, f"mean error {self._in_words(mean)}"),
            (_lighter(self._color), f"largest {self._in_words(largest)}"),
        ]
        if speed is not None:
            told.append((SPEED, f"speed {100.0 * speed:.0f} %"))
        if acceleration is not None:
            told.append((ACCELERATION, f"acceleration {100.0 * acceleration:.0f} %"))
        limits = "" if speed is None and acceleration is None else " of limit"
        when = f"now; last {SPAN:g} s" if moment is None else f"at {moment:.2f} s"
        told.append((palette.QUIET, f"{limits} {when}"))
        style = "margin-right:10px;color"
        words = "".join(f'<span style="{style}:{color}">{text}</span>' for color, text in told)
        line = f'<div style="font-size:12px;line-height:1;padding:2px 10px;white-space:nowrap">{words}</div>'
        if self._told.content != line:
            self._told.content = line

    def _in_words(self, error: float) -> str:
        return "0 mm" if error < NOTHING * self._length else f"{MILLI * error:.3g} mm"


def _lines(color: str) -> tuple[uplot.Series, ...]:
    return (
        {"label": "time"},
        _line("largest error", "mm", _lighter(color), 1.2),
        _line("mean error", "mm", color, 2.0),
        _line("acceleration", "share", ACCELERATION, 1.0),
        _line("speed", "share", SPEED, 1.6),
        {**_line("limit", "share", palette.INK, 1.0), "dash": (4, 2)},
        _line("keyframes", "share", palette.REST, 0.8),
        _line("shown", "share", palette.MARK, 1.2),
    )


def _line(label: str, scale: str, color: str, width: float) -> uplot.Series:
    return {"label": label, "scale": scale, "stroke": color, "width": width, "points": {"show": False}}


def _axes() -> tuple[uplot.Axis, ...]:
    """Time below, errors at the left, shares of limits at the right."""
    plain: uplot.Axis = {"font": "10px sans-serif", "stroke": palette.INK, "gap": 3, "ticks": {"show": False}}
    grid: uplot.Axis = {**plain, "grid": {"stroke": palette.FAINT, "width": 0.6}}
    # a logarithmic axis would draw a line at each digit
    bare: uplot.Axis = {**plain, "grid": {"show": False}}
    return (
        {**grid, "size": 18},
        {**bare, "scale": "mm", "size": 46, "label": "mm", "labelSize": 14, "labelFont": "10px sans-serif"},
        {
            **grid,
            "scale": "share",
            "side": 1,
            "size": 30,
            "label": "of limit",
            "labelSize": 14,
            "labelFont": "10px sans-serif",
        },
    )


def _lighter(color: str) -> str:
    return palette.mixed(color, "#FFFFFF", 0.5)


# The panel under the picture: play the motion of the task, stop it, look at any moment of it.

Marks = tuple[tuple[float, str], ...]

WIDTH = 620
"""Width of the panel [pixels]."""

GAP = 15
"""How far it is from the edges of the picture [pixels]."""

STEP = 0.01
"""What the slider moves by [s]."""

HELD, LEFT = 0.5, 2.0
"""How long after a hand moved the slider it is not moved by anything else, and not made anew [s]."""

NUMBERED = 24
"""The most keyframes whose numbers stand at the slider."""

PLAY, PLAYER_PAUSE, LIVE, SLOWER, FASTER = "Play", "Pause", "Back to live", "Slower", "Faster"
LOOP, ONCE = "Loop: off", "Loop: on"


class Player:
    """The player, and the plots below it.

    Args:
        server: the page.
        arm: the arm.
        post: leaves a request for the loop.
    """

    def __init__(self, server: viser.ViserServer, arm: Arm, post: Post) -> None:
        self._server, self._post, self._touched, self._stale = server, post, 0.0, False
        self._lasting = 1.0
        self._marks: Marks = ()
        self._panel = server.gui.add_panel()
        self._tab = self._panel.add_tab("Motion", viser.Icon.PLAYER_PLAY)
        with self._tab:
            self._buttons = server.gui.add_button_group(
                "Motion",
                _labels(Playback()),
                hint="Of the whole task as it stands, in real time at 1x",
                order=0.0,
            )
            self._progress = server.gui.add_progress_bar(0.0, visible=False, order=2.0)
        self._plots = Plots(server, self._tab, arm.length)
        self._time = self._slider(0.0)
        self._panel.float(x=GAP, y=-GAP, width=WIDTH)
        on_choice(self._buttons, self._pressed)

    def show(self, session: Session, live: Live) -> None:
        """Bring it up to date."""
        playback = session.playback
        put(self._buttons, options=_labels(playback))
        alone = time.monotonic() - self._touched
        lasting, marks = _passed(playback) or _planned(session.task)
        self._lasting = lasting
        put(self._time, max=max(_rounded(lasting), STEP))
        if marks != self._marks and alone > LEFT:  # a slider keeps the marks that it was made with
            self._marks = marks
            self._time.remove()
            self._time = self._slider(playback.time)
        if alone > HELD or playback.playing:
            at = _rounded(min(playback.time, self._lasting))
            if self._stale and alone > HELD:
                # Where it was put by us while a hand moved it, the browser has that: it is told anew.
                self._stale = False
                put(self._time, value=at - STEP if at >= STEP else at + STEP)
            put(self._time, value=at)
        rehearsal = playback.rehearsal
        put(self._progress, visible=rehearsal.working)
        if rehearsal.working:
            put(self._progress, value=float(round(100.0 * rehearsal.progress)))
        self._plots.show(session, live)

    def _slider(self, at: float) -> viser.GuiSliderHandle[float]:
        """A slider for the times that there are, numbers at those of the keyframes."""
        lasting = max(_rounded(self._lasting), STEP)
        with self._tab:
            slider = self._server.gui.add_slider(
                "Time [s]",
                0.0,
                lasting,
                STEP,
                _rounded(min(at, lasting)),
                marks=self._marks,
                hint="Which moment is shown; the numbers are those of the keyframes",
                order=1.0,
            )
        on_change(slider, self._sought)
        return slider

    def _pressed(self, label: str) -> None:
        self._post(PRESSED.get(label, at_usual_speed))

    def _sought(self, at: float) -> None:
        self._touched, self._stale = time.monotonic(), True
        self._post(partial(seek, at), "seek")


def play(session: Session) -> None:
    """Show the motion of the task."""
    session.playback.play(session.task)


def pause(session: Session) -> None:
    """Stand still."""
    session.playback.pause()


def stop(session: Session) -> None:
    """Show the arm of the moment."""
    session.playback.stop()


def seek(at: float, session: Session) -> None:
    """Show one moment of the motion of the task [s]."""
    session.playback.seek(session.task, at)


def pace(by: int, session: Session) -> None:
    """Show it faster, or slower, by one of `SPEEDS`."""
    index = SPEEDS.index(session.playback.speed) + by
    session.playback.at_speed(SPEEDS[min(max(index, 0), len(SPEEDS) - 1)])


def at_usual_speed(session: Session) -> None:
    """Show it in real time."""
    session.playback.at_speed(1.0)


def turn_loop(loop: bool, session: Session) -> None:
    """Begin again at the end, or not."""
    session.playback.in_loop(loop)


PRESSED = {
    PLAY: play,
    PLAYER_PAUSE: pause,
    LIVE: stop,
    SLOWER: partial(pace, -1),
    FASTER: partial(pace, 1),
    LOOP: partial(turn_loop, True),
    ONCE: partial(turn_loop, False),
}
"""What the buttons do, by what stands on them; the one in the middle shows the speed."""


def _labels(playback: Playback) -> tuple[str, ...]:
    """What stands on the buttons."""
    first, last = PLAYER_PAUSE if playback.playing else PLAY, ONCE if playback.loop else LOOP
    return first, LIVE, SLOWER, f"{playback.speed:g}x", FASTER, last


def _passed(playback: Playback) -> tuple[float, Marks] | None:
    """How long the motion that is shown takes [s], and when it passes which keyframe; None without one."""
    motion = playback.motion
    if motion is None:
        return None
    rows = [passed.row for passed in motion.waypoints]
    return playback.lasting, _numbered([None if row is None else float(motion.time[row]) for row in rows])


def _planned(task: Task) -> tuple[float, Marks]:
    """The same as it is planned."""
    times = times_of(task)
    return times[-1] + keyframes_of(task)[-1].hold, _numbered(times)


def _numbered(times: list[float] | list[float | None]) -> Marks:
    few = len(times) <= NUMBERED
    return tuple((_rounded(at), str(k + 1) if few else "") for k, at in enumerate(times) if at is not None)


def _rounded(at: float) -> float:
    return round(round(at / STEP) * STEP, 9)
