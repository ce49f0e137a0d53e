"""Colours that mean the same thing in every picture.

They are those of Okabe and Ito, which are distinct under every kind of colour blindness. Initial posture,
target curve, Selection and Projection have the hues of the thesis: blue, black, red, green.
"""

from __future__ import annotations

from collections.abc import Iterable

START = "#0072B2"  # initial posture
FINAL = "#D55E00"  # final posture of a controller that has no colour of its own
TARGET = "#000000"  # target curve and target points
REST = "#9A9A9A"  # the target curve beyond the reach of the arm, and other things of no consequence
CONTROLLERS = {  # by the name of the controller
    "selection": "#D55E00",
    "projection": "#009E73",
    "switching": "#CC79A7",
    "geodesic": "#E69F00",
}
SPARE = ("#56B4E9", "#8C510A", "#6A51A3", "#666666")  # runs whose controllers have no colour, or share one

MODULES = ("#4F779F", "#A3B8CC")  # odd and even modules
ALONG = ("#440154", "#46327E", "#365C8D", "#277F8E", "#1FA187", "#4AC16D", "#A0DA39")  # from base to tip
IN_TIME = ("#EDB458", "#DD6E42", "#B23A5B", "#6A2470", "#2A1350")  # from the first posture to the last
TURN = "#B03A6F"  # axis of a revolute joint
SLIDE = "#0B7A5B"  # axis of a prismatic joint
BASE = "#4A5560"  # what the arm stands on
ACTIVE = "#E69F00"  # a control point in the active control set
IDLE = "#FFFFFF"  # a control point that is not active

OBSTACLE = "#94897A"
SEE_THROUGH, SHEER = 0.45, 0.18  # opacity of obstacles: of a few, and of many in front of each other

# Manipulability ellipsoids of index 0, of a quarter of `REGULAR_INDEX`, and of that and more.
SINGULAR, WORSE, REGULAR = "#CC2A1E", "#D6CB2A", "#009E73"
REGULAR_INDEX = 0.4

ESCAPE = "#E4D9F2"  # background of steps in which the posture error may rise
MARK = "#CC0000"  # steps that are pointed out, as on the step axis of Figure 6.12 of the thesis
INK = "#333333"  # text and axes
QUIET = "#707070"  # footnotes
FAINT = "#DDDDDD"  # grid lines


def controller_color(controller: str) -> str:
    """Return the colour of a controller, given by name or by the description that a trajectory records."""
    return CONTROLLERS.get(controller.partition("(")[0].strip().lower(), FINAL)


def distinct_colors(controllers: Iterable[str]) -> list[str]:
    """Return one colour for each of several runs, no two alike while the palette lasts."""
    colors: list[str] = []
    for controller in controllers:
        own = controller_color(controller)
        free = [color for color in (own, *SPARE, *CONTROLLERS.values()) if color not in colors]
        colors.append(free[0] if free else own)
    return colors


def index_color(index: float) -> str:
    """Return the colour of a manipulability ellipsoid with an index in [0, 1], with more contrast near 0.

    It is one of 33 colours, so that small motions of the arm do not change it.
    """
    share = round(32.0 * min(index / REGULAR_INDEX, 1.0) ** 0.5) / 16.0  # 0 to 1 to 2 along three colours
    before, after = SINGULAR, WORSE
    if share > 1.0:
        share, before, after = share - 1.0, WORSE, REGULAR
    return mixed(before, after, share)


def in_time(share: float) -> str:
    """Return the colour of a posture at a share of its motion in [0, 1]."""
    along = share * (len(IN_TIME) - 1)
    before = min(int(along), len(IN_TIME) - 2)
    return mixed(IN_TIME[before], IN_TIME[before + 1], along - before)


def mixed(color: str, other: str, share: float) -> str:
    """Blend a colour "#RRGGBB" with a share in [0, 1] of another."""
    parts = ((1.0 - share) * a + share * b for a, b in zip(rgb(color), rgb(other), strict=True))
    return "#" + "".join(f"{round(255.0 * part):02X}" for part in parts)


def rgb(color: str) -> tuple[float, float, float]:
    """Return red, green and blue of a colour "#RRGGBB", each in [0, 1]."""
    red, green, blue = (int(color[i : i + 2], 16) / 255.0 for i in (1, 3, 5))
    return red, green, blue
