"""The posture control points in the page: coloured by their errors, active ones ringed."""

from __future__ import annotations

import numpy as np
import viser
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from pinposture.arm import Arm
from pinposture.editor.live import Live
from pinposture.editor.page.part import color
from pinposture.editor.session import Session
from pinposture.viz import palette
from pinposture.viz.drawing import link_radius
from pinposture.viz.mesh import ball, tube

Array = NDArray[np.float64]

SMALL, LARGE = 1e-3, 0.3
"""Errors, relative to a module length, below which a point is green, and above which it is red."""

IN_THE_WAY = 1e-2
"""Error, relative to a module length, from which on a line leads to the target."""


def error_colors(errors: Array, unit: float) -> NDArray[np.uint8]:
    """Colours of points by their errors: green, yellow, red, evenly by orders of magnitude.

    Args:
        errors: (m,) [m].
        unit: length of a module [m].
    """
    sizes = np.clip(errors / unit, SMALL, LARGE)
    shares = 1.0 - np.log(sizes / SMALL) / np.log(LARGE / SMALL)
    # `index_color` goes by the square root of the index
    return np.array(
        [color(palette.index_color(palette.REGULAR_INDEX * s * s)) for s in shares], dtype=np.uint8
    )


class Points:
    """The posture control points of an arm.

    Args:
        server: the page.
        arm: the arm.
    """

    def __init__(self, server: viser.ViserServer, arm: Arm) -> None:
        self._arm, self._steps = arm, -1
        self._unit = float(arm.chain.module_lengths.mean())
        radius, m = link_radius(arm), arm.n_modules
        dot, ring = ball(np.zeros(3), 1.55 * radius), _ring(1.85 * radius, 0.3 * radius)
        still = np.tile([1.0, 0.0, 0.0, 0.0], (m, 1)), np.zeros((m, 3))
        self._dots = server.scene.add_batched_meshes_simple("/points/dots", *dot, *still, lod="off")
        self._rings = server.scene.add_batched_meshes_simple(
            "/points/rings", *ring, *still, batched_colors=color(palette.ACTIVE), lod="off"
        )
        self._ways = server.scene.add_line_segments(
            "/points/ways", np.zeros((m, 2, 3)), np.zeros((m, 2, 3), dtype=np.uint8), thickness=0.5 * radius
        )
        self._colors: NDArray[np.uint8] = np.zeros((m, 3), dtype=np.uint8)
        self._ringed: NDArray[np.bool_] = np.zeros(m, dtype=np.bool_)

    def show(self, session: Session, live: Live) -> None:
        """Bring them up to date."""
        del session
        if live.steps == self._steps:
            return
        self._steps = live.steps
        points = live.state.points
        self._dots.batched_positions = points.astype(np.float32)
        colors = error_colors(live.errors, self._unit)
        if not np.array_equal(colors, self._colors):
            self._colors = colors
            self._dots.batched_colors = colors
        self._rings.batched_positions = points.astype(np.float32)
        turns = Rotation.from_matrix(live.state.rotations).as_quat()[:, [3, 0, 1, 2]]
        self._rings.batched_wxyzs = turns.astype(np.float32)
        if not np.array_equal(live.active, self._ringed):
            self._ringed = live.active.copy()
            self._rings.batched_scales = np.where(live.active, 1.0, 1e-6).astype(np.float32)
        self._lead(live, colors)

    def _lead(self, live: Live, colors: NDArray[np.uint8]) -> None:
        """Draw a line from each point to where it should be, if that is elsewhere."""
        points = live.state.points
        ends = points if live.target is None else live.target.points
        off = (live.errors > IN_THE_WAY * self._unit)[:, None]
        self._ways.points = np.stack([points, np.where(off, ends, points)], axis=1).astype(np.float32)
        self._ways.colors = np.repeat(colors[:, None], 2, axis=1)


def _ring(radius: float, thickness: float) -> tuple[Array, NDArray[np.intp]]:
    """A ring about the x axis."""
    around = np.linspace(0.0, 2.0 * np.pi, 13)
    circle = radius * np.column_stack([np.zeros_like(around), np.cos(around), np.sin(around)])
    return tube(circle, thickness)
