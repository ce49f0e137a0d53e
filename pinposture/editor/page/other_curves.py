"""The curves of the keyframes that are not edited, faintly in the page: pale to dark as time goes on."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import viser
from numpy.typing import NDArray

from pinposture.arm import Arm
from pinposture.editor.edits import keyframes_of
from pinposture.editor.live import Live
from pinposture.editor.page.part import color
from pinposture.editor.session import Session
from pinposture.editor.shape import enough
from pinposture.placement.curve_placement import lay
from pinposture.task import Keyframe
from pinposture.viz import palette
from pinposture.viz.drawing import link_radius

Array = NDArray[np.float64]

PIECES = 64
"""Straight pieces that a curve is drawn with."""

PALE = 0.1
"""Share of white in their colours."""


class OtherCurves:
    """The curves of the keyframes that are not edited.

    Args:
        server: the page.
        arm: the arm.
        wanted: whether they are to be seen.
    """

    def __init__(self, server: viser.ViserServer, arm: Arm, wanted: Callable[[], bool]) -> None:
        self._arm, self._wanted = arm, wanted
        self._drawn: dict[int, tuple[Keyframe, Array]] = {}
        self._shown: tuple[Keyframe, ...] = ()
        self._selected = -1
        self._lines = server.scene.add_line_segments(
            "/curve/others",
            np.zeros((1, 2, 3)),
            np.zeros((1, 2, 3), dtype=np.uint8),
            thickness=0.45 * link_radius(arm),
            visible=False,
        )

    def show(self, session: Session, live: Live) -> None:
        """Bring them up to date."""
        del live
        keyframes = keyframes_of(session.task)
        visible = self._wanted()
        if visible and (keyframes is not self._shown or session.selected != self._selected):
            self._shown, self._selected = keyframes, session.selected
            self._draw(keyframes, session.selected)
        if self._lines.visible != visible:
            self._lines.visible = visible

    def _draw(self, keyframes: tuple[Keyframe, ...], selected: int) -> None:
        before, self._drawn = self._drawn, {}
        for each in keyframes:  # kept with its line, so that its id stays its own
            self._drawn[id(each)] = before.get(id(each)) or (each, _line(self._arm, each))
        others = [index for index in range(len(keyframes)) if index != selected]
        lines = np.stack([self._drawn[id(keyframes[index])][1] for index in others])
        shades = [palette.mixed(palette.in_time(k / (len(keyframes) - 1)), "#FFFFFF", PALE) for k in others]
        colors = np.array([color(shade) for shade in shades], dtype=np.uint8)
        ends = np.stack([lines[:, :-1], lines[:, 1:]], axis=2).reshape(-1, 2, 3)
        self._lines.points = ends.astype(np.float32)
        self._lines.colors = np.repeat(np.repeat(colors, PIECES, axis=0)[:, None], 2, axis=1)


def _line(arm: Arm, keyframe: Keyframe) -> Array:
    """Places along the curve of a keyframe, as far as the arm needs it, (PIECES + 1, 3) [m]."""
    laid = lay(arm, keyframe.curve, keyframe.placement, keyframe.roll)
    return np.asarray(laid.at(np.linspace(0.0, min(laid.length, enough(arm)), PIECES + 1)))
