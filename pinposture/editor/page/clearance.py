"""Where the arm is nearest to what is around it, as a line in the page."""

from __future__ import annotations

import numpy as np
import viser

from pinposture.arm import Arm
from pinposture.editor.clearances import Nearest
from pinposture.editor.live import Live
from pinposture.editor.page.part import color
from pinposture.editor.session import Session
from pinposture.viz import palette
from pinposture.viz.drawing import link_radius

COLORS = {"inside": palette.MARK, "within the margin": palette.ACTIVE, "clear": palette.REGULAR}
"""Colours of the line, by how near it is."""

FAR = 0.5
"""How far something may be that a line leads to, relative to the arm."""


class ClearanceLine:
    """A line from the arm to what it is nearest to.

    Args:
        server: the page.
        arm: the arm.
    """

    def __init__(self, server: viser.ViserServer, arm: Arm) -> None:
        self._far, radius = FAR * arm.length, link_radius(arm)
        self._line = server.scene.add_line_segments(
            "/clearance/line",
            np.zeros((1, 2, 3)),
            color(palette.REGULAR),
            thickness=0.6 * radius,
            visible=False,
        )
        self._ends = [
            server.scene.add_icosphere(
                f"/clearance/end_{k + 1}",
                0.8 * radius,
                color(palette.REGULAR),
                subdivisions=1,
                cast_shadow=False,
                visible=False,
            )
            for k in range(2)
        ]
        self._shown: Nearest | None = None

    def show(self, session: Session, live: Live) -> None:
        """Bring it up to date."""
        del live
        found = session.nearest
        if found is self._shown:
            return
        self._shown = found
        visible = found is not None and found.distance < self._far
        if found is not None and visible:
            places = np.array([found.on_arm, found.on_other])
            self._line.points = places[None].astype(np.float32)
            shade = color(COLORS[found.level])
            self._line.colors = np.array([[shade, shade]], dtype=np.uint8)
            for ball, place in zip(self._ends, places, strict=True):
                ball.position = place
                ball.color = shade
        for node in (self._line, *self._ends):
            if node.visible != visible:
                node.visible = visible


def clearance_text(found: Nearest | None) -> str:
    """A clearance in words."""
    if found is None:
        return "nothing to be near to"
    size = f"{1000.0 * abs(found.distance):.3g} mm"
    if found.distance < 0.0:
        return f"{found.body} is {size} inside {found.other}"
    less = (
        f", less than the margin of {1000.0 * found.margin:.3g} mm" if found.distance < found.margin else ""
    )
    return f"{size} from {found.body} to {found.other}{less}"
