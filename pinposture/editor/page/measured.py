"""Where the arm is measured to be, beside where it is planned to be."""

from __future__ import annotations

from html import escape

import numpy as np
import viser

from pinposture.arm import Arm
from pinposture.editor.joint_states import JointStates
from pinposture.editor.live import Live
from pinposture.editor.page.arm import ArmDrawing
from pinposture.editor.session import Session
from pinposture.viz import palette

OPACITY = 0.45
"""How opaque the measured arm is."""

OLD = 1.0
"""Age from which on joint states are said to be old [s]."""


class MeasuredArm:
    """A see-through arm where joint states say that it is, and how far that is from the plan.

    Args:
        server: the page; what it says is written where it is at.
        arm: the arm.
        states: the joint states; None if there are none. Nothing is shown then, nor if they are of another
            arm.
    """

    def __init__(self, server: viser.ViserServer, arm: Arm, states: JointStates | None) -> None:
        # Joint states of another arm, that was there before, say nothing of this one.
        self._states, self._count = (states if states is not None and states.arm is arm else None), -1
        if self._states is None:
            return
        self._about = server.gui.add_html("")
        self._text = ""
        self._drawing = ArmDrawing(server, arm, "/measured", OPACITY, palette.FINAL)
        self._drawing.set_visible(False)

    def show(self, session: Session, live: Live) -> None:
        """Bring it up to date."""
        del session
        if self._states is None:
            return
        latest = self._states.latest
        if latest.count != self._count and latest.count > 0:
            self._count = latest.count
            self._drawing.move(latest.q)
            self._drawing.set_visible(True)
        if latest.count == 0:
            lines = ["no joint states yet"]
        else:
            away = live.arm.at(latest.q).points - live.state.points
            distance = float(np.linalg.norm(away, axis=1).mean())
            lines = [f"{1000.0 * distance:.3g} mm from the plan on average"]
            if latest.age > OLD:
                lines.append(f"the last joint state is {latest.age:.0f} s old")
        if latest.complaint:
            lines.append(latest.complaint)
        text = "<br>".join(map(escape, lines))
        if text != self._text:
            self._text = text
            self._about.content = (
                '<div style="font-size:13px;line-height:1.35;padding:2px 10px 4px 10px">'
                f'<div id="measured" style="border-left:4px solid {palette.FINAL};padding-left:8px">'
                f"<b>Measured</b><br>{text}</div></div>"
            )
