"""The panel that plays a motion, with plots of its errors and of the use of its limits."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial
from html import escape
from itertools import zip_longest
from typing import NamedTuple

import numpy as np
import viser
from numpy.typing import NDArray
from viser import uplot

from pinposture.arm import Arm
from pinposture.control import Limits
from pinposture.editor import edits
from pinposture.editor.edits import TIMES, Pass, keyframes_of, passes_of, times_of
from pinposture.editor.phases import EditedPhase
from pinposture.editor.playback import Playback
from pinposture.editor.session import Session
from pinposture.editor.solver import Live, limits_per_step
from pinposture.editor.ui.keyframes import MARK_COLORS, row_label
from pinposture.editor.ui.parts import Post, on_change, on_choice, put, round_number
from pinposture.motion import Trajectory
from pinposture.motion.run import limit_shares
from pinposture.motion.trajectory import WaypointResult
from pinposture.task import Task
from pinposture.units import length_text
from pinposture.viz import palette
from pinposture.viz.palette import THEME

Array = NDArray[np.float64]


class TraceSettings(NamedTuple):
    """What the plots of the panel show, and how often they are sent."""

    live_span: float = 10.0
    """Span of the trace of the live arm [s]."""

    largest_gap: float = 1.0
    """Gap in the trace of the live arm after which it starts anew [s]."""

    most_rows: int = 600
    """Most rows of a trace; of more, the largest of neighbours stand for them."""

    motion_period: float = 0.1
    """Time between two plots of a motion [s]."""

    live_period: float = 0.3
    """Time between two plots of the live arm [s]."""

    settling_period: float = 3.0
    """Time until a plot is sent again after a browser connects [s]; then twice that, and so on."""

    settling_plots: int = 4
    """Number of these: a slow browser knows the width of its plots late, and leaves them empty."""

    axis_jitter: float = 5e-4
    """Relative change of the time axis from plot to plot."""

    height: int = 90
    """Height of a plot [pixels]."""

    legend_height: int = 30
    """Height of its legend of two lines [pixels]."""

    least_error: float = 1e-5
    """Smallest error that is shown, in arm lengths."""

    most_share: float = 1.2
    """Largest share of limits that is shown."""

    outside: float = 1e3
    """Value of lines outside of the picture."""

    speed_color: str = THEME.spare[2]
    """Colour of speeds."""

    acceleration_color: str = THEME.spare[0]
    """Colour of accelerations."""


TRACE = TraceSettings()


class TimelineLayout(NamedTuple):
    """Sizes of the panel and of its timeline."""

    width: int = 440
    """Width of the panel [pixels]."""

    height: int = 274
    """Height of the panel [pixels]."""

    gap: int = 8
    """Distance of the panel from the edges of the picture [pixels]."""

    low_page: int = 700
    """Height of the page up to which the panel has no plot [pixels]."""

    low_height: int = 150
    """Height of the panel without a plot [pixels]."""

    room_behind: float = 0.15
    """Room behind the end of the motion, relative to its duration."""

    least_length: float = 1.0
    """Smallest length of the timeline [s]."""

    ticks: int = 7
    """About how many times are written."""

    drag_steps: int = 100
    """About how many times can be dragged to."""

    most_numbered: int = 24
    """Most keyframes that have numbers."""

    most_drawn: int = 300
    """Most keyframes that are drawn, of all laps."""

    later_opacity: float = 0.6
    """Opacity of keyframes in laps after the first."""


TIMELINE = TimelineLayout()


class Trace(NamedTuple):
    """Values to plot."""

    time: Array  # (n,) [s]
    mean: Array  # mean distance of the control points from their targets, (n,) [m]
    largest: Array  # the largest, (n,) [m]
    speed: Array | None  # the largest joint speed relative to its limit, (n,); None if there is no limit
    acceleration: Array | None  # the same of accelerations, (n,); None if there is no limit

    def at(self, moment: float) -> tuple[float, float, float | None, float | None]:
        """Return mean and largest error, speed and acceleration at a moment [s]."""

        def of(values: Array | None) -> float | None:
            return None if values is None else float(np.interp(moment, self.time, values))

        return (
            float(np.interp(moment, self.time, self.mean)),
            float(np.interp(moment, self.time, self.largest)),
            of(self.speed),
            of(self.acceleration),
        )


def trace_of(motion: Trajectory) -> Trace:
    """Return the trace of a motion."""
    speeds, accelerations = limit_shares(motion.run)
    times = motion.time
    if speeds is not None:
        # A speed is that between two rows.
        speeds = (
            np.interp(times, times[1:] - 0.5 * motion.dt, speeds) if len(speeds) else np.zeros(len(times))
        )
    largest = np.asarray(motion.run.point_errors.max(axis=1))
    return _thinned(Trace(times, motion.mean_error, largest, speeds, accelerations))


class Recent:
    """The trace of the live arm over the last seconds."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._rows: deque[tuple[float, float, float, float]] = deque()
        self._last: Live | None = None

    def add(self, live: Live, limits: Limits) -> None:
        """Add the arm at this moment, and its speed relative to the limits."""
        now = self._clock()
        last = self._last
        if self._rows and self._rows[-1][0] < now - TRACE.largest_gap:
            self._rows.clear()
        while len(self._rows) > 1 and self._rows[1][0] < now - TRACE.live_span:
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
        """The trace; times are relative to now, when the values are the last ones."""
        now = self._clock()
        rows = np.array(self._rows or [(now, 0.0, 0.0, 0.0)])
        rows = np.concatenate([rows[:1], rows, rows[-1:]])
        times = np.clip(rows[:, 0] - now, -TRACE.live_span, 0.0)
        # to the last bit: the axis stays as it is
        times[0] = -TRACE.live_span
        times[-1] = 0.0
        return _thinned(Trace(times, rows[:, 1], rows[:, 2], rows[:, 3], None))


def with_lines(
    times: Array, columns: Sequence[Array], marks: Sequence[Array], low: float, high: float
) -> tuple[Array, ...]:
    """Return times (n,) [s] and columns (n,) with further columns that draw vertical lines.

    Each further column has its lines at increasing moments (k,) [s]. A line is a step from a low value, below
    the picture, to a high one above it, or back: only its flank is seen.
    """
    ends = [np.concatenate([moments, np.nextafter(moments, np.inf)]) for moments in marks]
    x = np.sort(np.concatenate([times, *ends]))
    drawn = [np.interp(x, times, column) for column in columns]
    lines = [np.where(np.searchsorted(moments, x) % 2, high, low) for moments in marks]
    return (x, *drawn, *lines)


def _thinned(trace: Trace) -> Trace:
    count = len(trace.time)
    if count <= TRACE.most_rows:
        return trace
    edges = np.unique(np.linspace(0, count, TRACE.most_rows, endpoint=False).astype(np.intp))
    times = np.array(trace.time[edges])
    times[-1] = trace.time[-1]
    mean = np.maximum.reduceat(trace.mean, edges)
    largest = np.maximum.reduceat(trace.largest, edges)
    speed, acceleration = (
        None if values is None else np.asarray(np.maximum.reduceat(values, edges)) for values in trace[3:]
    )
    return Trace(times, mean, largest, speed, acceleration)


class Plots:
    """Errors of the control points, and joint rates relative to their limits, against time.

    Of the motion that is shown, with a line at its moment; without one, of the last seconds.
    """

    def __init__(self, server: viser.ViserServer, tab: viser.GuiTabHandle, length: float) -> None:
        self._recent = Recent()
        self._length = length
        self._known: tuple[Trajectory, Trace, Array] | None = None
        self._due = 0.0
        self._color = THEME.final
        self._jitter = False
        self._server = server
        self._clients: tuple[int, ...] = ()
        self._connected = 0.0  # when a browser came or left last
        self._shown: tuple[object, object] = None, None
        self._low = float(10.0 ** np.floor(np.log10(TRACE.least_error * length * 1e3)))
        high = float(10.0 ** np.ceil(np.log10(length * 1e3)))
        with tab:
            self._legend = server.gui.add_html("", order=3.0)
            self._plot = server.gui.add_uplot(
                self._data(self._recent.trace, np.zeros(0), np.zeros(0)),
                _lines(self._color),
                scales={
                    "x": {"time": False},
                    "mm": {"distr": 3, "range": (self._low, high)},
                    "share": {"range": (0.0, TRACE.most_share)},
                },
                axes=_axes(),
                legend={"show": False},
                height=TRACE.height,
                padding=(8, 0, 0, 0),
                order=4.0,
            )

    def show(self, session: Session, live: Live) -> None:
        """Bring it up to date."""
        playback = session.playback
        motion = session.playback.motion
        now = time.monotonic()
        if motion is None:
            self._recent.add(live, session.task.limits)
        if now < self._due:
            return
        clients = tuple(self._server.get_clients())
        if clients != self._clients:
            self._clients = clients
            self._connected = now
        since = now - self._connected
        settled = (
            self._connected,
            min(int(np.log2(1.0 + since / TRACE.settling_period)), TRACE.settling_plots),
        )
        lately = now if self._recent.changing else settled
        key = (None, lately) if motion is None else (motion, playback.time)
        if key == self._shown:
            return
        self._shown = key
        self._due = now + (TRACE.live_period if motion is None else TRACE.motion_period)
        color = palette.controller_color(session.task.controller.name)
        if color != self._color:
            self._color = color
            self._plot.series = _lines(color)
        trace = self._recent.trace
        marks = np.zeros(0)
        at = marks
        # An axis that a browser drew before it knew its width gets its numbers only when it changes.
        self._jitter = not self._jitter
        trace.time[0] *= 1.0 + TRACE.axis_jitter * self._jitter
        if motion is not None:
            if self._known is None or self._known[0] is not motion:
                rows = sorted({passed.row for passed in motion.waypoints if passed.row is not None})
                self._known = motion, trace_of(motion), motion.time[rows]
            trace, marks = self._known[1:]
            at = np.array([playback.time])
        self._plot.data = self._data(trace, marks, at)
        self._show_legend(trace, None if motion is None else playback.time)

    def _data(self, trace: Trace, marks: Array, at: Array) -> tuple[Array, ...]:
        """Return the columns of the plot, in the order of its lines."""
        absent = np.full(len(trace.time), -TRACE.outside)
        errors = [np.clip(1e3 * values, self._low, None) for values in (trace.largest, trace.mean)]
        rates = [absent if values is None else values for values in (trace.acceleration, trace.speed)]
        columns = [*errors, *rates, np.ones(len(trace.time))]
        return with_lines(trace.time, columns, (marks, at), -TRACE.outside, TRACE.outside)

    def _show_legend(self, trace: Trace, moment: float | None) -> None:
        """Show what the lines are, and their values at a moment [s]; None: now."""
        mean, largest, speed, acceleration = trace.at(0.0 if moment is None else moment)
        when = f"last {TRACE.live_span:g} s" if moment is None else f"{moment:.2f} s"
        entries = [
            (self._color, f"mean error {length_text(mean, self._length)}"),
            (self._plot.series[1]["stroke"], f"largest {length_text(largest, self._length)}"),
        ]
        if speed is not None:
            entries.append((TRACE.speed_color, f"speed {100.0 * speed:.0f} %"))
        if acceleration is not None:
            entries.append((TRACE.acceleration_color, f"acceleration {100.0 * acceleration:.0f} %"))
        apart = 'style="margin-right:9px"'
        words = f"<span {apart}>{when}</span>"
        for color, text in entries:
            words += f'<span {apart}><span style="{STYLES["swatch"]};background:{color}"></span>{text}</span>'
        style = f"font-size:11px;line-height:1.2;padding:2px 10px;height:{TRACE.legend_height}px"
        style += ";display:flex;flex-wrap:wrap;align-content:flex-start"
        put(self._legend, content=f'<div id="legend" style="{style}">{words}</div>')


def _lines(color: str) -> tuple[uplot.Series, ...]:
    def line(label: str, scale: str, color: str, width: float) -> uplot.Series:
        return {"label": label, "scale": scale, "stroke": color, "width": width, "points": {"show": False}}

    return (
        {"label": "time"},
        line("largest error", "mm", palette.mixed(color, THEME.target, 0.4), 1.2),
        line("mean error", "mm", color, 2.0),
        line("acceleration", "share", TRACE.acceleration_color, 1.0),
        line("speed", "share", TRACE.speed_color, 1.6),
        {**line("limit", "share", THEME.ink, 1.0), "dash": (4, 2)},
        line("keyframes", "share", THEME.rest, 0.8),
        line("shown", "share", THEME.mark, 1.2),
    )


def _axes() -> tuple[uplot.Axis, ...]:
    """Return the axes: time below, errors at the left, shares of limits at the right."""
    font = "10px sans-serif"
    plain: uplot.Axis = {"font": font, "stroke": THEME.ink, "gap": 3, "ticks": {"show": False}}
    titled: uplot.Axis = {**plain, "labelSize": 14, "labelFont": font}
    grid: uplot.Axis = {"grid": {"stroke": THEME.faint, "width": 0.6}}
    return (
        {**plain, **grid, "size": 18},
        # A logarithmic axis would draw a line at each digit.
        {**titled, "grid": {"show": False}, "scale": "mm", "size": 46, "label": "mm"},
        {**titled, **grid, "scale": "share", "side": 1, "size": 30, "label": "of limit"},
    )


ON_PRESS = """
const strip = document.getElementById('timeline'), box = strip.getBoundingClientRect();
const field = strip.parentElement.nextElementSibling.querySelector('input');
const keyframe = event.target.closest('[data-keyframe]'), index = keyframe ? keyframe.dataset.keyframe : -1;
const share = (e) => Math.min(Math.max((e.clientX - box.left) / box.width, 0), 1);
const tell = (what, e) => {
  const text = [what, index, share(e), Date.now()].join(' ');
  Object.getOwnPropertyDescriptor(HTMLInputElement.prototype, 'value').set.call(field, text);
  field.dispatchEvent(new Event('input', {bubbles: true}));
};
const begin = event.clientX;
let dragged = false;
const move = (e) => {
  dragged ||= Math.abs(e.clientX - begin) > 3;
  if (!keyframe) return tell('seek', e);
  const drawn = document.querySelector('#timeline [data-keyframe="' + index + '"]');
  if (drawn && dragged) drawn.style.left = 100 * share(e) + '%';
};
const end = (e) => {
  window.removeEventListener('pointermove', move);
  for (const kind of ['pointerup', 'pointercancel']) window.removeEventListener(kind, end);
  if (keyframe) tell(e.type == 'pointercancel' ? 'cancel' : dragged ? 'move' : 'select', e);
};
window.addEventListener('pointermove', move);
for (const kind of ['pointerup', 'pointercancel']) window.addEventListener(kind, end);
event.preventDefault();
if (!keyframe) tell('seek', event);
"""
"""What a press on the timeline does: it writes the request into a hidden field.

The text is what to do, the keyframe, the share of the timeline, and the time, so that no two are the same.
The timeline may be drawn anew at any time, even between the press and this script: what is pressed is then in
the page no more.
"""

HIDDEN = f"""<style>
div:has(> #timeline) + div {{display: none}}
@media (max-height: {TIMELINE.low_page}px) {{
  div:has(> #legend), div:has(> #legend) + div {{display: none}}
}}
</style>"""
"""Hides the field that requests are written into, and the plot in a low page."""

STYLES = {
    "swatch": "display:inline-block;width:9px;height:7px;border-radius:2px;margin-right:3px",
    "strip": "position:relative;height:42px;margin:2px 20px 4px 20px;touch-action:none;user-select:none",
    "line": f"position:absolute;top:11px;height:5px;width:100%;border-radius:3px;background:{THEME.faint}",
    "tick": "position:absolute;top:28px;font-size:10px;line-height:12px;transform:translateX(-50%);"
    "white-space:nowrap",
    "hold": "position:absolute;top:8px;height:11px;opacity:0.4",
    "keyframe": "position:absolute;top:3px;width:18px;height:21px;line-height:21px;border-radius:4px;"
    "transform:translateX(-50%);text-align:center;font-size:12px;font-weight:bold;color:white;cursor:grab",
    "not reached": f"background:white;color:{THEME.mark};outline:2px dashed {THEME.mark};outline-offset:-2px",
    "playhead": "position:absolute;top:0;height:29px;width:2px;transform:translateX(-50%);"
    f"background:{THEME.mark}",
}
"""Styles of the timeline and of what is in it, and of colours in the legend of the plot."""


class TimeAxis:
    """The axis of time, with keyframes to be chosen and dragged, and the moment that is shown.

    While a motion is computed, the progress is shown along it.
    """

    def __init__(self, server: viser.ViserServer, post: Post) -> None:
        self._post = post
        self._length = 1.0  # of the axis [s]
        self._passes: list[DrawnPass] = []
        self._known: tuple[Task, Trajectory | None] | None = None
        self._gestures = 0  # each is answered by a new drawing, with the keyframes where they are
        self._moving, self._strip = (server.gui.add_html("", order=1.0) for _ in range(2))
        on_change(server.gui.add_text("", "", order=1.0), self._take)

    def show(self, session: Session, _: Live) -> None:
        """Bring it up to date."""
        task = session.task
        playback = session.playback
        keyframes = keyframes_of(session.task)
        if self._known is None or self._known[0] is not task or self._known[1] is not playback.motion:
            self._known = task, playback.motion
            duration, self._passes = _schedule(task, playback)
            self._length = max((1.0 + TIMELINE.room_behind) * duration, TIMELINE.least_length)
        planned = times_of(task)
        step = round_number(self._length / TIMELINE.ticks)
        drawn = [self._at("line", 0.0, "")]
        drawn += [self._at("tick", at, f"{at:g} s") for at in np.arange(0.0, self._length, step)]
        for number, ((index, lap, at), reached) in enumerate(self._passes):
            mark = session.marks[index] if len(session.marks) == len(keyframes) else ""
            selected = index == session.selected
            shade = f"background:{THEME.start if selected else MARK_COLORS.get(mark, THEME.quiet)}"
            width = f"width:{100.0 * keyframes[index].hold / self._length:.3f}%"
            drawn.append(self._at("hold", at, "", f"{width};{shade}"))
            words = f"lap {lap + 1}:  " * (task.repeat > 1) + row_label(keyframes, planned, index, mark)
            words += "" if reached else "  ·  not reached"
            about = f'data-keyframe="{number}" title="{escape(words)}"'
            label = str(index + 1) if len(self._passes) <= TIMELINE.most_numbered else "&nbsp;"
            shade += f";z-index:{1 + selected};opacity:{TIMELINE.later_opacity if lap else 1}"
            if not reached:
                shade += f";{STYLES['not reached']}"
            drawn.append(self._at("keyframe", at, label, shade, about))
        about = f'id="timeline" data-gestures="{self._gestures}" onpointerdown="{escape(ON_PRESS)}"'
        put(self._strip, content=f'{HIDDEN}<div {about} style="{STYLES["strip"]}">{"".join(drawn)}</div>')
        moving = ""
        if playback.preview.working:
            width = f"width:{100.0 * playback.preview.progress:.0f}%"
            moving += self._at("line", 0.0, "", f"{width};background:{THEME.regular}", 'id="progress"')
        if playback.shown:
            moving += self._at("playhead", min(playback.time, self._length), "", "", 'id="playhead"')
        over = f"{STYLES['strip']};height:0;z-index:3;pointer-events:none"
        put(self._moving, content=f'<div style="{over}">{moving}</div>')

    def _at(self, kind: str, time: float, text: str, style: str = "", about: str = "") -> str:
        """Return an element at a time [s], as HTML."""
        left = f"left:{100.0 * time / self._length:.3f}%"
        return f'<div {about} style="{STYLES[kind]};{left};{style}">{text}</div>'

    def _take(self, text: str) -> None:
        with suppress(ValueError):  # that no page of ours says
            what, index, share, _ = text.split()
            self._post(partial(self._act, what, int(index), float(share)), "seek" if what == "seek" else "")

    def _act(self, what: str, index: int, share: float, session: Session) -> None:
        self._gestures += 1
        at = share * self._length
        step = round_number(self._length / TIMELINE.drag_steps)
        if what == "seek":
            seek(at, session)
        elif 0 <= index < len(self._passes):
            keyframe, _, before = self._passes[index].at
            if what == "select":
                session.select(keyframe)
            elif what == "move" and keyframe < len(keyframes_of(session.task)):
                drag_keyframe(keyframe, at - before, step, session)


def covered_height(picture: float) -> float:
    """Return how much of a picture the panel covers at its bottom, by the height of the picture [pixels]."""
    return TIMELINE.gap + (TIMELINE.low_height if picture <= TIMELINE.low_page else TIMELINE.height)


class Player:
    """The panel below the picture: the buttons of the player, the timeline, and the plots."""

    def __init__(self, server: viser.ViserServer, arm: Arm, post: Post) -> None:
        panel = server.gui.add_panel()
        tab = panel.add_tab("Motion", viser.Icon.PLAYER_PLAY)
        with tab:
            hint = "Motion of the whole task; 1x is real time"
            self._buttons = server.gui.add_button_group("Motion", _labels(Playback()), hint=hint, order=0.0)
            self._timeline = TimeAxis(server, post)
        self._plots = Plots(server, tab, arm.length)
        panel.float(x=TIMELINE.gap, y=-TIMELINE.gap, width=TIMELINE.width)
        # The button in the middle shows the speed.
        on_choice(self._buttons, lambda label: post(BUTTONS.get(label, at_usual_speed)))

    def show(self, session: Session, live: Live) -> None:
        """Bring it up to date."""
        put(self._buttons, options=_labels(session.playback))
        self._timeline.show(session, live)
        self._plots.show(session, live)


def play(session: Session) -> None:
    """Play the motion of the task."""
    session.playback.play(session.whole)


def play_or_pause(session: Session) -> None:
    """Play the motion of the task, or pause it."""
    session.playback.pause() if session.playback.playing else play(session)


def stop(session: Session) -> None:
    """Return to the live arm."""
    session.playback.stop()


def seek(at: float, session: Session) -> None:
    """Show a moment of the motion of the task [s]."""
    session.playback.seek(session.whole, at)


def drag_keyframe(index: int, by: float, step: float, session: Session) -> None:
    """Move a keyframe along the axis of time, and select it.

    Args:
        index: of the keyframe, 0-based.
        by: how far [s].
        step: of the time to which it is moved [s].
        session: the session.
    """
    time = round(step * round((times_of(session.task)[index] + by) / step), TIMES.digits)
    to = edits.place_at(session.task, index, time)
    if session.edit(edits.dragged(index, time), f"moved keyframe {index + 1} in time", select=to):
        session.say(f"keyframe {to + 1} is now at {times_of(session.task)[to]:g} s")


def change_speed(by: int, session: Session) -> None:
    """Play faster or slower, by a number of halvings or doublings of real time, of which there are two."""
    speed = session.playback.speed * 2.0**by
    session.playback.at_speed(min(max(speed, 0.25), 4.0))


def at_usual_speed(session: Session) -> None:
    """Play in real time."""
    session.playback.at_speed(1.0)


class PlayerLabels(NamedTuple):
    """Labels of the buttons, which show the state."""

    play: str = "Play"
    pause: str = "Pause"
    live: str = "Live"
    slower: str = "Slower"
    faster: str = "Faster"
    loop_off: str = "Loop: off"
    loop_on: str = "Loop: on"


LABEL = PlayerLabels()

BUTTONS: dict[str, Callable[[Session], None]] = {
    LABEL.play: play,
    LABEL.pause: lambda session: session.playback.pause(),
    LABEL.live: stop,
    LABEL.slower: partial(change_speed, -1),
    LABEL.faster: partial(change_speed, 1),
    LABEL.loop_off: lambda session: session.playback.in_loop(True),
    LABEL.loop_on: lambda session: session.playback.in_loop(False),
}
"""What the buttons do, by their labels."""


def _labels(playback: Playback) -> tuple[str, ...]:
    first = LABEL.pause if playback.playing else LABEL.play
    last = LABEL.loop_on if playback.loop else LABEL.loop_off
    return first, LABEL.live, LABEL.slower, f"{playback.speed:g}x", LABEL.faster, last


class DrawnPass(NamedTuple):
    """A keyframe on the timeline."""

    at: Pass
    reached: bool  # false if the motion that is shown does not reach it, or misses it


def _schedule(task: Task, playback: Playback) -> tuple[float, list[DrawnPass]]:
    """Return duration [s] and keyframes of the motion that is shown, or else as planned.

    Keyframes after the first `TIMELINE.most_drawn` are left out.
    """
    motion = playback.motion
    passes = passes_of(task)
    if motion is None:
        duration = passes[-1].time + keyframes_of(task)[-1].hold
        return duration, [DrawnPass(one, True) for one in passes[: TIMELINE.most_drawn]]
    waypoints = list(motion.waypoints)
    begins = 0.0
    if isinstance(task, EditedPhase):
        waypoints = _waypoints_of_phase(task, motion)
        begins = task.begins
    drawn = [
        _where_reached(motion, each, waypoint, begins)
        for each, waypoint in zip_longest(passes, waypoints[: len(passes)])
    ]
    return max(playback.lasting, *(one.at.time for one in drawn)), drawn[: TIMELINE.most_drawn]


def _where_reached(
    motion: Trajectory, each: Pass, waypoint: WaypointResult | None, begins: float
) -> DrawnPass:
    """Place a keyframe where the motion reaches it, or behind the end of a motion that ends before it.

    Args:
        motion: the motion.
        each: the keyframe.
        waypoint: its waypoint in the motion; None if the motion has none.
        begins: planned time at which the times of keyframes begin [s].
    """
    if waypoint is not None and waypoint.row is not None:
        return DrawnPass(each._replace(time=float(motion.time[waypoint.row])), not waypoint.missed)
    planned = begins + each.time if waypoint is None else waypoint.planned
    left = max(planned - float(motion.plan_time[-1]), 0.0)
    return DrawnPass(each._replace(time=float(motion.time[-1]) + left), False)


def _waypoints_of_phase(task: EditedPhase, motion: Trajectory) -> list[WaypointResult]:
    """Return the waypoints of the keyframes of a phase in the motion of all phases."""
    least = task.begins + TIMES.tolerance * (-1.0 if task.begin is None else 1.0)
    waypoints = [waypoint for waypoint in motion.waypoints if waypoint.planned > least]
    if task.end is not None:  # its last posture: of several on its way, the last one
        waypoints = [waypoint for waypoint in waypoints if waypoint.planned <= task.ends + TIMES.tolerance][
            -1:
        ]
    if task.begin is not None:
        row = int(np.searchsorted(motion.plan_time, task.begins))
        begin = WaypointResult("", task.begins, None, row if row <= motion.steps else None, None)
        waypoints.insert(0, begin)
    return waypoints
