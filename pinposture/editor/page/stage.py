"""Light, floor and camera."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import viser
from numpy.typing import NDArray

from pinposture.arm import Arm
from pinposture.editor.page.part import color
from pinposture.viz import palette
from pinposture.viz.drawing import link_radius

Array = NDArray[np.float64]

FIELD_OF_VIEW = 40.0
"""Vertical opening of the camera [deg]."""

DISTANCE = 1.75
"""How far from the arm the camera is, in arm lengths."""

FROM = np.array([0.25, -0.85, 0.46])
"""Where it looks from, seen from the middle of the arm."""

LOWER = 0.13
"""How much lower than the arm the middle of the picture is: the plots cover the bottom; in arm lengths."""

CELLS = 10
"""Squares of the floor along the arm."""


class Outlook(NamedTuple):
    """Where the camera is at first.

    Attributes:
        position: (3,) [m], world frame.
        look_at: the place in the middle of the picture, (3,) [m], world frame.
        opening: angle from the bottom of the picture to its top [rad].
    """

    position: Array
    look_at: Array
    opening: float


def outlook(arm: Arm) -> Outlook:
    """Where the camera has to be to see the whole of an arm."""
    middle = 0.5 * (arm.chain.base + arm.at(arm.straight()).points[-1])
    away = DISTANCE * arm.length * FROM / np.linalg.norm(FROM)
    middle[2] -= LOWER * arm.length
    return Outlook(middle + away, middle, float(np.radians(FIELD_OF_VIEW)))


def set_stage(server: viser.ViserServer, arm: Arm) -> None:
    """Make a floor under an arm, and look at the whole of it."""
    base, length = arm.chain.base, arm.length
    tip, view = arm.at(arm.straight()).points[-1], outlook(arm)
    middle = view.look_at
    server.scene.set_up_direction("+z")
    server.scene.world_axes.visible = False
    server.scene.configure_environment_map("city", environment_intensity=0.55)
    camera = server.initial_camera
    camera.position, camera.look_at, camera.fov = view
    camera.near, camera.far = 0.01 * length, 100.0 * length
    cell = _round(length / CELLS)
    floor = float(min(base[2], tip[2])) - 0.3 * length - 3.0 * link_radius(arm)
    server.scene.add_grid(
        "/floor",
        width=24.0 * cell,
        height=24.0 * cell,
        cell_size=cell,
        section_size=5.0 * cell,
        cell_color=color(palette.FAINT),
        section_color=color(palette.mixed(palette.FAINT, palette.REST, 0.5)),
        position=(*np.round(middle[:2] / cell) * cell, floor),
        fade_distance=40.0 * cell,
        shadow_opacity=0.12,
    )
    server.scene.add_frame(
        "/axes",
        axes_length=0.08 * length,
        axes_radius=0.15 * link_radius(arm),
        position=(*base[:2], floor),
    )


def _round(value: float) -> float:
    """The nearest of 1, 2, 5 times a power of ten."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(min((1.0, 2.0, 5.0, 10.0), key=lambda step: abs(step * power - value)) * power)
