"""Colours that mean the same thing in every picture.

They are those of Okabe and Ito, which people with any kind of colour blindness tell apart. Initial posture,
target curve, Selection and Projection have the hues that the thesis gives them: blue, black, red, green.
"""

from __future__ import annotations

from collections.abc import Iterable

START = "#0072B2"
"""Initial posture."""

FINAL = "#D55E00"
"""Final posture of a controller that has no colour of its own."""

TARGET = "#000000"
"""Target curve and target points."""

REST = "#9A9A9A"
"""The part of the target curve beyond the reach of the arm, and other things of no consequence."""

CONTROLLERS = {
    "selection": "#D55E00",
    "projection": "#009E73",
    "switching": "#CC79A7",
    "qp": "#E69F00",
}
"""Colour of each controller, by its name."""

SPARE = ("#56B4E9", "#8C510A", "#6A51A3", "#666666")
"""Colours of runs whose controllers have none, or share one."""

MODULES = ("#4F779F", "#A3B8CC")
"""The two shades that take turns along the arm, so that modules can be told apart."""

ALONG = ("#440154", "#46327E", "#365C8D", "#277F8E", "#1FA187", "#4AC16D", "#A0DA39")
"""From base to tip: dark to light, without the yellows that white paper swallows."""

TURN = "#B03A6F"
"""Axis of a joint that turns."""

SLIDE = "#0B7A5B"
"""Axis of a joint that slides."""

BASE = "#4A5560"
"""What the arm stands on."""

ACTIVE = "#E69F00"
"""A control point in the active control set."""

IDLE = "#FFFFFF"
"""A control point that is not active."""

INK = "#333333"
"""Text and axes."""

QUIET = "#707070"
"""Text that few will read."""

FAINT = "#DDDDDD"
"""Grid lines."""


def controller_color(controller: str) -> str:
    """Colour of a controller.

    Args:
        controller: its name, or its parameters in words as a trajectory records them.
    """
    name = controller.partition("(")[0].strip().lower()
    return CONTROLLERS.get(name, FINAL)


def distinct_colors(controllers: Iterable[str]) -> list[str]:
    """One colour for each of several runs, no two alike while the palette lasts.

    Args:
        controllers: the controllers of the runs, as for `controller_color`.
    """
    colors: list[str] = []
    for controller in controllers:
        own = controller_color(controller)
        free = [color for color in (own, *SPARE, *CONTROLLERS.values()) if color not in colors]
        colors.append(free[0] if free else own)
    return colors


def rgb(color: str) -> tuple[float, float, float]:
    """Red, green and blue of a colour "#RRGGBB", each in [0, 1]."""
    red, green, blue = (int(color[i : i + 2], 16) / 255.0 for i in (1, 3, 5))
    return red, green, blue
