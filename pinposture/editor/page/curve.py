"""The target curve in the page: what the arm covers of it, what it does not, and what it cannot take."""

from __future__ import annotations

import numpy as np
import viser
from numpy.typing import NDArray

from pinposture.arm import Arm
from pinposture.curve import Curve
from pinposture.editor.live import Live
from pinposture.editor.page.part import color
from pinposture.editor.session import Session
from pinposture.viz import palette
from pinposture.viz.drawing import link_radius

Array = NDArray[np.float64]

PIECES = 240
"""Straight pieces that the curve is drawn with."""


class CurveDrawing:
    """The curve of the keyframe that is edited, as drawn by hand.

    Args:
        server: the page.
        arm: the arm.
    """

    def __init__(self, server: viser.ViserServer, arm: Arm) -> None:
        self._arm = arm
        self._shown: tuple[object, ...] = ()
        self._line = server.scene.add_line_segments(
            "/curve/line",
            np.zeros((PIECES, 2, 3)),
            np.zeros((PIECES, 2, 3), dtype=np.uint8),
            thickness=0.7 * link_radius(arm),
        )

    def show(self, session: Session, live: Live) -> None:
        """Bring it up to date."""
        verdict = live.verdict if live.number == session.number else None
        shape = session.shape
        key = (shape, verdict is not None, None if verdict is None else verdict.target)
        if key == self._shown:
            return
        self._shown = key
        curve = shape.curve
        along = np.linspace(0.0, curve.length, PIECES + 1)
        places = np.asarray(curve.at(along))
        self._line.points = np.stack([places[:-1], places[1:]], axis=1).astype(np.float32)
        if verdict is not None:
            self._line.colors = self._colored(curve, along, live)

    def _colored(self, curve: Curve, along: Array, live: Live) -> NDArray[np.uint8]:
        """Colours of the ends of the pieces, (PIECES, 2, 3)."""
        verdict = live.verdict
        shades = np.empty((PIECES, 2, 3), dtype=np.uint8)
        if verdict.target is None:
            shades[:] = color(palette.MARK)
            return shades
        parameters = verdict.target.parameters
        covered = curve.length if parameters is None else float(parameters[verdict.target.placed].max())
        inside = 0.5 * (along[1:] + along[:-1]) <= covered
        shades[:] = np.where(inside[:, None], color(palette.TARGET), color(palette.REST))[:, None]
        return shades
