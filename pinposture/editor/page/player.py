"""The panel under the picture: play the motion of the task, stop it, look at any moment of it."""

from __future__ import annotations

import time
from functools import partial

import viser

from pinposture.arm import Arm
from pinposture.editor.edits import keyframes_of, times_of
from pinposture.editor.live import Live
from pinposture.editor.page.part import Post, on_change, on_choice, put
from pinposture.editor.page.plots import Plots
from pinposture.editor.playback import SPEEDS, Playback
from pinposture.editor.session import Session
from pinposture.task import Task

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

PLAY, PAUSE, LIVE, SLOWER, FASTER = "Play", "Pause", "Back to live", "Slower", "Faster"
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
    PAUSE: pause,
    LIVE: stop,
    SLOWER: partial(pace, -1),
    FASTER: partial(pace, 1),
    LOOP: partial(turn_loop, True),
    ONCE: partial(turn_loop, False),
}
"""What the buttons do, by what stands on them; the one in the middle shows the speed."""


def _labels(playback: Playback) -> tuple[str, ...]:
    """What stands on the buttons."""
    first, last = PAUSE if playback.playing else PLAY, ONCE if playback.loop else LOOP
    return first, LIVE, SLOWER, f"{playback.speed:g}x", FASTER, last


def _passed(playback: Playback) -> tuple[float, Marks] | None:
    """How long the motion that is shown takes [s], and when it passes which keyframe; None without one."""
    motion = playback.motion
    if motion is None:
        return None
    rows = [passed.row for passed in motion.passed]
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
