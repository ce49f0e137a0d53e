"""Manipulability ellipsoids in the page."""

from __future__ import annotations

import numpy as np
import viser
from scipy.spatial.transform import Rotation

from pinposture.arm import Arm, ArmState
from pinposture.editor.page.part import color
from pinposture.viz import palette
from pinposture.viz.drawing import link_radius
from pinposture.viz.ellipsoids import THINNEST, drawn_length, principal_frame
from pinposture.viz.mesh import ball

MOST = 8
"""How many are shown at most."""

OPACITY = 0.4


class Ellipsoids:
    """Ellipsoids of some control points, evenly along the arm.

    Args:
        server: the page.
        arm: the arm.
    """

    def __init__(self, server: viser.ViserServer, arm: Arm) -> None:
        self._arm = arm
        every = -(-arm.n_modules // MOST)
        self.points = tuple(range(arm.n_modules - 1, -1, -every))[::-1]
        count = len(self.points)
        self._length = drawn_length(arm, self.points)
        self._thinnest = THINNEST * link_radius(arm)
        self._steps, self._visible = -1, False
        surface = ball(np.zeros(3), 1.0, 3)
        self._balls = server.scene.add_batched_meshes_simple(
            "/ellipsoids",
            *surface,
            batched_wxyzs=np.tile([1.0, 0.0, 0.0, 0.0], (count, 1)),
            batched_positions=np.zeros((count, 3)),
            batched_scales=np.full((count, 3), 1e-6),
            batched_colors=np.tile(color(palette.REGULAR), (count, 1)),
            opacity=OPACITY,
            cast_shadow=False,
            receive_shadow=False,
            lod="off",
            visible=False,
        )

    def show(self, state: ArmState, steps: int, visible: bool) -> None:
        """Show them at a state of the arm, or not at all.

        Args:
            state: the state.
            steps: a number that is another where the state is.
            visible: whether to show them.
        """
        if visible != self._visible:
            self._visible = visible
            self._balls.visible = visible
        if not visible or steps == self._steps:
            return
        self._steps = steps
        listed = state.ellipsoids(self.points)
        frames = np.array([principal_frame(one) for one in listed])
        radii = np.array([np.append(one.radii, 0.0)[:3] for one in listed]) * self._length
        turns = Rotation.from_matrix(frames.transpose(0, 2, 1)).as_quat()[:, [3, 0, 1, 2]]
        self._balls.batched_positions = np.array([one.center for one in listed], dtype=np.float32)
        self._balls.batched_wxyzs = turns.astype(np.float32)
        self._balls.batched_scales = np.maximum(radii, self._thinnest).astype(np.float32)
        colors = [color(palette.index_color(one.index)) for one in listed]
        self._balls.batched_colors = np.array(colors, dtype=np.uint8)
