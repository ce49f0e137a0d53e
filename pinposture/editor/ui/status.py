"""What the page says at its top: how the arm is doing, and what was last to say."""

from __future__ import annotations

import time
from html import escape

import viser

from pinposture.editor.session import Session
from pinposture.editor.solver import Live
from pinposture.editor.ui.scene import clearance_text
from pinposture.viz import palette

COLORS = {
    "good": palette.REGULAR,
    "info": palette.REGULAR,
    "warning": palette.ACTIVE,
    "error": palette.MARK,
}
"""Green, amber and red."""

OFF_CURVE, OFF_TIP, OFF_POINTS = 0.02, 0.01, 0.01
"""How far the whole arm may be from the curve, the tip from its task and control points from their targets
on average, in arm lengths, before the status is amber."""

CLEAR = "geodesic"
"""The controller that keeps clear of a scene."""

PATIENCE = 0.4
"""How long after something was asked it is said that it takes time [s]."""

ROUNDING = 1e-6
"""Errors that are none [mm]."""


class Status:
    """A few lines, always in sight.

    Args:
        server: the page.
    """

    def __init__(self, server: viser.ViserServer) -> None:
        self._html = server.gui.add_html("")
        self._said = ""

    def show(self, session: Session, live: Live) -> None:
        """Bring it up to date."""
        text = _lines(session, live)
        if text != self._said:
            self._said = text
            self._html.content = text


def _lines(session: Session, live: Live) -> str:
    kind, head, more = told(session, live)
    notice = session.notice
    said = ""
    if notice.text:
        said = (
            f'<div id="notice" data-kind="{notice.kind}" style="color:{COLORS[notice.kind]};margin-top:4px">'
            f"{escape(notice.text)}</div>"
        )
    return (
        '<div style="font-size:13px;line-height:1.35;padding:2px 10px 4px 10px">'
        f'<div id="status" style="border-left:4px solid {COLORS[kind]};padding-left:8px">'
        f"<b>{escape(head)}</b><br><span>{escape(more) or '&nbsp;'}</span></div>{said}</div>"
    )


def told(session: Session, live: Live) -> tuple[str, str, str]:
    """What the status says of the arm: "good", "warning" or "error", a heading, and more."""
    verdict, found = live.verdict, session.nearest
    if live.number < session.number and time.monotonic() - session.asked > PATIENCE:
        return "warning", "Looking whether the arm can take this shape ...", ""
    if verdict.reason:
        return "error", "The arm cannot take this shape", verdict.reason
    head = _doing(session, live) + _tip(live) + _whole_arm(session, live) + _room(session)
    if found is not None and found.distance < 0.0:
        return "error", "The arm is in collision", f"{clearance_text(found)}; {head[0].lower()}{head[1:]}"
    if verdict.collision:
        return "warning", "The curve leads the arm into something", verdict.notes[0]
    more = "; ".join(_notes(session, live))
    if live.reason and live.status != "converged":
        return "warning", head, live.reason
    return "warning" if _is_off(session, live) else "good", head, more


def _is_off(session: Session, live: Live) -> bool:
    """Whether the arm takes the shape worse than it looks."""
    length, found = live.arm.length, session.nearest
    if found is not None and found.distance < found.margin:
        return True
    if session.playback.q is not None or live.status == "moving":
        return False
    away, tip = live.verdict.distance_from_curve or 0.0, live.tip_error or 0.0
    return away > OFF_CURVE * length or tip > OFF_TIP * length or live.mean_error > OFF_POINTS * length


def _doing(session: Session, live: Live) -> str:
    words = {"converged": "Taken", "moving": "On the way"}
    doing = "Motion" if session.playback.q is not None else words.get(live.status, "Holding")
    millimetres = 1000.0 * live.mean_error
    return f"{doing}: mean error {millimetres if millimetres > ROUNDING else 0.0:.3g} mm"


def _tip(live: Live) -> str:
    return "" if live.tip_error is None else f", tip {1000.0 * live.tip_error:.3g} mm off"


def _whole_arm(session: Session, live: Live) -> str:
    """How far the whole arm is from the curve where it takes it, in a few words."""
    away = live.verdict.distance_from_curve
    if away is None or session.playback.q is not None:
        return ""
    return f", whole arm within {1000.0 * away:.3g} mm of the curve"


def _notes(session: Session, live: Live) -> list[str]:
    """What is to be known though the arm can take the shape."""
    notes = list(live.verdict.notes)
    controller = session.task.controller.name
    if session.task.scene is not None and controller != CLEAR:
        notes.append(f"{controller} keeps clear of nothing, {CLEAR} does")
    return notes


def _room(session: Session) -> str:
    """The clearance in a few words."""
    found = session.nearest
    if found is None:
        return ""
    return f", {1000.0 * abs(found.distance):.3g} mm {'inside' if found.distance < 0.0 else 'clear'}"
