"""Obstacles in figures: shaded in space, cut open in the plane of a planar arm."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from mpl_toolkits.mplot3d.art3d import Poly3DCollection
from numpy.typing import NDArray

from pinposture.scene import Scene
from pinposture.view import palette
from pinposture.view.convex import facets, hidden, rim, section
from pinposture.view.obstacles import Shown, near_corners, shown_obstacles
from pinposture.view.postures import Drawn, PosturePanel

Array = NDArray[np.float64]

VEIL = 0.6
"""Share of the colour of an obstacle in that of a line behind it."""

FINE = 400
"""Pieces of the size of the picture in which a line is told to be hidden or not."""

EDGE = palette.mixed(palette.OBSTACLE, palette.INK, 0.35)
"""Outlines of obstacles."""


def surround(panel: PosturePanel, *scenes: Scene | None) -> list[Shown]:
    """Make room in a panel for the obstacles near what was drawn; call it before the panel is finished.

    Args:
        panel: the panel, with all postures and targets in it.
        scenes: scenes whose obstacles to show; None for none, the same one only counts once.

    Returns:
        The obstacles, for `draw_obstacles`.
    """
    distinct = list(dict.fromkeys(scene for scene in scenes if scene is not None))
    points = np.vstack([panel.drawn, panel.arm.chain.base])
    shown = [each for scene in distinct for each in shown_obstacles(scene, points)]
    panel.make_room(near_corners(shown))
    return shown


def draw_obstacles(panel: PosturePanel, shown: Sequence[Shown]) -> None:
    """Draw obstacles into a panel that is finished, with an entry for the legend.

    In space they are translucent, and lines that they hide are veiled. In the plane of a planar arm they are
    drawn where they meet that plane; what lies before or behind it is a dotted outline.

    Args:
        panel: the panel.
        shown: what `surround` returned.
    """
    near = [each.near for each in shown if len(each.near)]
    if not shown:
        return
    if panel.spatial:
        _draw_solids(panel, near)
        _veil(panel, near)
    else:
        _draw_sections(panel, near)
    away = len(shown) - len(near)
    label = "obstacle" if len(shown) == 1 else "obstacles"
    label += ", cut off" if any(each.cut for each in shown if len(each.near)) else ""
    label += f", {away} far off" if away else ""
    square: dict[str, Any] = {"ls": "none", "marker": "s", "ms": 9.0, "mec": EDGE, "mew": 0.7}
    panel.ax.plot([], [], mfc=(*palette.rgb(palette.OBSTACLE), palette.SEE_THROUGH), label=label, **square)


def _draw_solids(panel: PosturePanel, near: Sequence[Array]) -> None:
    ax: Any = panel.ax
    ax.computed_zorder = False  # or they would cover lines that are in front of them
    right, up = panel.screen
    light = 0.5 * panel.eye + 0.8 * up - 0.4 * right
    light /= np.linalg.norm(light)
    faces: list[Array] = []
    shades: list[tuple[float, ...]] = []
    for solid in near:
        seen = [(face, normal) for face, normal in facets(solid) if normal @ panel.eye > 0.0]
        faces.extend(face for face, _ in seen)
        shades.extend(_shade(float(normal @ light)) for _, normal in seen)
        outline = rim(solid @ panel.screen.T)
        if len(outline):
            depth = float((solid @ panel.eye).mean())
            line = np.vstack([outline, outline[:1]]) @ panel.screen + depth * panel.eye
            ax.plot(*line.T, color=EDGE, lw=0.8, zorder=0.6)
    if shades:
        most = max(map(len, faces))
        faces = [np.vstack([face, *[face[-1:]] * (most - len(face))]) for face in faces]
        style = {"facecolors": shades, "edgecolors": "none", "zorder": 0.5}
        ax.add_collection3d(Poly3DCollection(faces, **style), autolim=False)


def _shade(level: float) -> tuple[float, float, float, float]:
    """Colour of a face whose normal has that cosine to the light."""
    other = "#FFFFFF" if level > 0.0 else palette.INK
    return (*palette.rgb(palette.mixed(palette.OBSTACLE, other, 0.55 * abs(level))), palette.SEE_THROUGH)


def _veil(panel: PosturePanel, near: Sequence[Array]) -> None:
    """Draw anew, in a colour between theirs and that of obstacles, what these hide of the lines."""
    finest = float(np.ptp(panel.drawn, axis=0).max()) / FINE
    for line in list(panel.lines):
        dashed = line.style.get("ls", "-") not in ("-", "none")
        if dashed or "alpha" in line.style:  # too faint already to be veiled
            continue
        dots = line.style.get("ls") == "none"
        points = line.points if dots else _finer(line, finest)
        behind = np.zeros(len(points), dtype=np.bool_)
        known = np.isfinite(points).all(axis=1)
        for solid in near:
            behind[known] |= hidden(points[known], solid, panel.eye)
        if behind.any():
            style = {**line.style, "label": "_", "zorder": line.style["zorder"] + 0.001}
            for key in ("color", "mfc", "mec"):
                if str(style.get(key, "")).startswith("#"):
                    style[key] = palette.mixed(style[key], palette.OBSTACLE, VEIL)
            panel.ax.plot(*panel.coordinates(np.where(behind[:, None], points, np.nan)), **style)


def _finer(line: Drawn, finest: float) -> Array:
    """Points along a line no farther from each other than that [m], its own among them."""
    pieces = [line.points[:1]]
    for a, b in zip(line.points[:-1], line.points[1:], strict=True):
        length = float(np.linalg.norm(b - a))
        count = max(1, int(np.ceil(length / finest))) if np.isfinite(length) else 1
        pieces.append(a + np.linspace(0.0, 1.0, count + 1)[1:, None] * (b - a) if count > 1 else b[None])
    return np.vstack(pieces)


def _draw_sections(panel: PosturePanel, near: Sequence[Array]) -> None:
    ax: Axes = panel.ax
    edge: dict[str, Any] = {"edgecolor": EDGE, "lw": 0.8}
    face = (*palette.rgb(palette.OBSTACLE), palette.SEE_THROUGH)
    for solid in near:
        cross = section(solid, panel.arm.chain.base, panel.screen)
        if len(cross):
            ax.fill(*cross.T, facecolor=face, zorder=0.6, **edge)
            continue
        outline = rim(solid @ panel.screen.T)
        if len(outline):
            ax.fill(*outline.T, fill=False, ls=(0, (1, 2)), zorder=0.6, **edge)
