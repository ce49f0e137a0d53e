"""The status at the top of the page: how the arm is doing, and the last message."""

from __future__ import annotations

import time
from html import escape

import viser

from pinposture.editor.session import Session
from pinposture.editor.solver import Live
from pinposture.editor.ui.parts import framed_html, put
from pinposture.editor.ui.scene import clearance_text
from pinposture.motion.tracker import NOT_DONE
from pinposture.viz import palette

STATUS_COLORS = {
    "good": palette.REGULAR,
    "info": palette.REGULAR,
    "warning": palette.ACTIVE,
    "error": palette.MARK,
}

# Distances from which on the status is a warning, in arm lengths: of the whole arm from the curve, of the tip
# from its task, and the mean one of control points from their targets.
MAX_CURVE_DISTANCE, MAX_TIP_ERROR, MAX_MEAN_ERROR = 0.02, 0.01, 0.01

AVOIDING_CONTROLLER = "geodesic"
JUDGING_TIME = 0.4  # of a problem before the status mentions it [s]
SMALLEST_ERROR = 1e-6  # smaller ones are shown as 0 [mm]


class Status:
    """A few lines, always in sight."""

    def __init__(self, server: viser.ViserServer) -> None:
        self._html = server.gui.add_html("")

    def show(self, session: Session, live: Live) -> None:
        """Bring it up to date."""
        kind, head, more = status_of(session, live)
        notice, message = session.notice, ""
        if notice.text:
            style = f"color:{STATUS_COLORS[notice.kind]};margin-top:4px"
            message = (
                f'<div id="notice" data-kind="{notice.kind}" style="{style}">{escape(notice.text)}</div>'
            )
        text = f"<span>{escape(more) or '&nbsp;'}</span>"
        put(self._html, content=framed_html("status", STATUS_COLORS[kind], escape(head), text, message))


def status_of(session: Session, live: Live) -> tuple[str, str, str]:
    """Return the status of the arm: "good", "warning" or "error", a heading, and more."""
    verdict, found = live.verdict, session.nearest
    if live.number < session.number and time.monotonic() - session.asked > JUDGING_TIME:
        return "warning", "Looking whether the arm can take this shape ...", ""
    if verdict.reason:
        return "error", "The arm cannot take this shape", verdict.reason
    head = _heading(session, live)
    if found is not None and found.distance < 0.0:
        return "error", "The arm is in collision", f"{clearance_text(found)}; {head[0].lower()}{head[1:]}"
    if verdict.collision:
        return "warning", "The curve leads the arm into something", verdict.notes[0]
    if live.reason and live.reason != NOT_DONE and live.status != "converged":
        return "warning", head, live.reason
    notes, controller = list(verdict.notes), session.task.controller.name
    if session.task.scene is not None and controller != AVOIDING_CONTROLLER:
        notes.append(f"{controller} keeps clear of nothing, {AVOIDING_CONTROLLER} does")
    return "warning" if _is_off(session, live) else "good", head, "; ".join(notes)


def _is_off(session: Session, live: Live) -> bool:
    """Return whether the arm takes the shape badly, or is within the margin of something."""
    length, found = live.arm.length, session.nearest
    if found is not None and found.distance < found.margin:
        return True
    if session.playback.q is not None or live.status == "moving":
        return False
    return (
        (live.verdict.distance_from_curve or 0.0) > MAX_CURVE_DISTANCE * length
        or (live.tip_error or 0.0) > MAX_TIP_ERROR * length
        or live.mean_error > MAX_MEAN_ERROR * length
    )


def _heading(session: Session, live: Live) -> str:
    playing, distance = session.playback.q is not None, live.verdict.distance_from_curve
    doing = {"converged": "Taken", "moving": "On the way"}.get(live.status, "Holding")
    doing = "Planning" if live.reason == NOT_DONE else doing
    error = 1000.0 * live.mean_error
    head = f"{'Motion' if playing else doing}: mean error {error if error > SMALLEST_ERROR else 0.0:.3g} mm"
    if live.tip_error is not None:
        head += f", tip {1000.0 * live.tip_error:.3g} mm off"
    if distance is not None and not playing:
        head += f", whole arm within {1000.0 * distance:.3g} mm of the curve"
    if session.nearest is not None:
        clearance = session.nearest.distance
        head += f", {1000.0 * abs(clearance):.3g} mm {'inside' if clearance < 0.0 else 'clear'}"
    return head
