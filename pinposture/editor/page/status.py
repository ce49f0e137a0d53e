"""What the page says at its top: how the arm is doing, and what was last to say."""

from __future__ import annotations

import time
from html import escape

import viser

from pinposture.editor.live import Live
from pinposture.editor.session import Session
from pinposture.viz import palette

COLORS = {"info": palette.REGULAR, "warning": palette.ACTIVE, "error": palette.MARK}

CLEAR = "qp"
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
    verdict = live.verdict
    if live.number < session.number and time.monotonic() - session.asked > PATIENCE:
        kind, head, more = "warning", "Looking whether the arm can take this shape ...", ""
    elif verdict.reason:
        kind, head, more = "error", "The arm cannot take this shape", verdict.reason
    elif verdict.collision:
        kind, head, more = "warning", "In the way", verdict.notes[0]
    else:
        head = _doing(session, live) + _whole_arm(session, live) + _room(session)
        kind, more = "info", "; ".join(_notes(session, live))
    if live.reason and live.status != "converged" and kind == "info":
        kind, more = "warning", live.reason
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


def _doing(session: Session, live: Live) -> str:
    words = {"converged": "Taken", "moving": "On the way"}
    doing = "Motion" if session.playback.q is not None else words.get(live.status, "Holding")
    millimetres = 1000.0 * live.mean_error
    return f"{doing}: mean error {millimetres if millimetres > ROUNDING else 0.0:.3g} mm"


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
