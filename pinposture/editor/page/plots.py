"""A plot of the motion that is shown, with a line at the moment of it; without one, of the last seconds."""

from __future__ import annotations

import time

import numpy as np
import viser
from numpy.typing import NDArray
from viser import uplot

from pinposture.editor.live import Live
from pinposture.editor.playback import Playback
from pinposture.editor.session import Session
from pinposture.editor.traces import SPAN, Recent, Trace, trace_of, with_lines
from pinposture.motion import Motion
from pinposture.viz import palette

Array = NDArray[np.float64]

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
            rows = sorted({passed.row for passed in motion.passed if passed.row is not None})
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
