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
    "geodesic": "#E69F00",
}
"""Colour of each controller, by its name."""

SHORT = {"constrainedqp": "geodesic"}
"""Short names of controllers whose parameters in words begin with another, in small letters."""

SPARE = ("#56B4E9", "#8C510A", "#6A51A3", "#666666")
"""Colours of runs whose controllers have none, or share one."""

MODULES = ("#4F779F", "#A3B8CC")
"""The two shades that take turns along the arm, so that modules can be told apart."""

ALONG = ("#440154", "#46327E", "#365C8D", "#277F8E", "#1FA187", "#4AC16D", "#A0DA39")
"""From base to tip: dark to light, without the yellows that white paper swallows."""

IN_TIME = ("#EDB458", "#DD6E42", "#B23A5B", "#6A2470", "#2A1350")
"""From the first posture of a motion to the last: pale to dark."""

TURN = "#B03A6F"
"""Axis of a joint that turns."""

SLIDE = "#0B7A5B"
"""Axis of a joint that slides."""

BASE = "#4A5560"
"""What the arm stands on."""

OBSTACLE = "#94897A"
"""What the arm must keep clear of."""

SEE_THROUGH, SHEER = 0.45, 0.18
"""How opaque obstacles are, and how opaque they are where many stand in front of each other."""

ESCAPE = "#E4D9F2"
"""Steps that lead out of a place where the posture error cannot fall, behind what is drawn."""

ACTIVE = "#E69F00"
"""A control point in the active control set."""

IDLE = "#FFFFFF"
"""A control point that is not active."""

SINGULAR, WORSE, REGULAR = "#CC2A1E", "#D6CB2A", "#009E73"
"""A manipulability ellipsoid of index 0, of a quarter of `REGULAR_INDEX`, of that and more."""

REGULAR_INDEX = 0.4
"""Manipulability index from which on an ellipsoid has the colour of a posture far from singular."""

MARK = "#CC0000"
"""Steps that are pointed out, as on the step axis of Figure 6.12 of the thesis."""

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
    return CONTROLLERS.get(SHORT.get(name, name), FINAL)


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


def index_color(index: float) -> str:
    """Colour of a manipulability ellipsoid by its index in [0, 1]: small ones differ more than large ones.

    One of 33, so that an arm that moves a little need not be coloured anew.
    """
    share = round(32.0 * min(index / REGULAR_INDEX, 1.0) ** 0.5) / 16.0  # 0 to 1 to 2 along three colours
    before, after = SINGULAR, WORSE
    if share > 1.0:
        share, before, after = share - 1.0, WORSE, REGULAR
    return mixed(before, after, share)


def in_time(share: float) -> str:
    """Colour of a posture of a motion, by how far along it is, in [0, 1]."""
    along = share * (len(IN_TIME) - 1)
    before = min(int(along), len(IN_TIME) - 2)
    return mixed(IN_TIME[before], IN_TIME[before + 1], along - before)


def mixed(color: str, other: str, share: float) -> str:
    """A colour with a share of another in it.

    Args:
        color: a colour "#RRGGBB".
        other: what to mix in.
        share: of the other, in [0, 1].
    """
    parts = ((1.0 - share) * a + share * b for a, b in zip(rgb(color), rgb(other), strict=True))
    return "#" + "".join(f"{round(255.0 * part):02X}" for part in parts)


def rgb(color: str) -> tuple[float, float, float]:
    """Red, green and blue of a colour "#RRGGBB", each in [0, 1]."""
    red, green, blue = (int(color[i : i + 2], 16) / 255.0 for i in (1, 3, 5))
    return red, green, blue
