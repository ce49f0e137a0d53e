"""A figure of the arm: its modules, joint axes and control points."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple, cast

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.patheffects import withStroke
from matplotlib.transforms import Bbox
from numpy.typing import ArrayLike, NDArray

from pinposture.arm import Arm, ArmState, ControlPoints, Ellipsoid
from pinposture.collision import Scene
from pinposture.collision.bodies import scene_at
from pinposture.units import ROUNDING, length_text
from pinposture.viz import palette
from pinposture.viz.drawing import require_type
from pinposture.viz.palette import THEME
from pinposture.viz.postures import (
    PosturePanel,
    box_extent,
    draw_ellipsoids,
    ellipsoid_key,
    scale_in_words,
    shade_ellipsoids,
)

Array = NDArray[np.float64]


class ArmFigureLayout(NamedTuple):
    """Sizes of the figure of an arm."""

    text_height: float = 1.9
    """Height of title, scales and legend [inch]."""

    heights: tuple[float, float] = (3.6, 8.0)
    """Smallest and largest height of the figure [inch]; the smallest suffices for a straight arm."""

    side_room: float = 0.015
    """Room beside scales and their labels, relative to the width of the figure."""

    number_distance: float = 0.017
    """Distance of numbers below which they are left out, relative to the size of the arm."""


ARM_FIGURE = ArmFigureLayout()


LOADS = (
    (0.5, THEME.regular, "o", "torque up to 50 % of its limit"),
    (0.8, THEME.worse, "o", "up to 80 %"),
    (1.0 + ROUNDING, THEME.active, "o", "up to 100 %"),
    (np.finfo(np.float64).max, THEME.singular, "X", "beyond its limit"),
    (np.inf, THEME.rest, "s", "limit not known"),
)
"""Colour, marker and meaning of a joint by the largest share of its torque limit."""


def plot_arm(
    arm: Arm,
    q: ArrayLike | None = None,
    ellipsoids: ControlPoints = (),
    scene: Scene | None = None,
    torques: bool = False,
) -> Figure:
    """Draw the structure of an arm: modules in two alternating shades, joint axes, numbered control points.

    A revolute joint is a bar along its axis, or a ring in the plane of a planar arm; a prismatic joint is a
    dotted bar. Where control points are dense, some numbers are left out. Manipulability ellipsoids
    (Section 3.3) are coloured by their index; the legend gives their scale.

    Args:
        arm: the arm.
        q: configuration, (nq,) [rad or m]; None: the neutral one.
        ellipsoids: control points with manipulability ellipsoids, by 0-based or negative index, or by name.
        scene: obstacles; shown where they are near.
        torques: whether joints are coloured by the share of its torque limit that each needs to hold the arm.

    Returns:
        A figure, 1200 pixels wide, as from `plot`; in the plane for a planar arm, otherwise in space.

    Raises:
        InvalidValue: no arm, a configuration of the wrong size or not finite, or an invalid choice of points.
        UnknownName: an unknown control point.
        WeightUnknown: `torques` of an arm without masses or torque limits.
    """
    require_type("arm", arm, Arm)
    shown = arm.neutral() if q is None else q
    state = arm.chain_at(shown)
    chosen = state.ellipsoids(ellipsoids)
    # Half the length of the bars: short compared to the links, but visible compared to the arm.
    half = float(np.clip(0.3 * np.median(arm.chain.module_lengths), 0.012 * arm.length, 0.035 * arm.length))
    planar = arm.dimension == 2
    figure = Figure(figsize=(palette.FIGURE.width, ARM_FIGURE.heights[0]))
    # The arm is drawn on top of its surroundings, also in space.
    ax = figure.add_subplot(**({} if planar else {"projection": "3d", "computed_zorder": False}))
    panel = PosturePanel(arm, ax)
    draw_ellipsoids(panel, chosen)
    start = arm.chain.base
    for k, (joints, point) in enumerate(zip(arm.chain.module_slices, state.points, strict=True)):
        line = np.vstack([start, state.origins[joints], point])
        shade = THEME.modules[k % 2]
        panel.line(line, color=shade, lw=5.0, solid_capstyle="butt", solid_joinstyle="round", zorder=3)
        start = point
    _draw_axes(panel, state.origins, state.placements.axes, half)
    dots = {"ls": "none", "marker": "o", "ms": 4.2, "mfc": "white", "mec": THEME.ink, "mew": 0.9}
    panel.line(state.points[:-1], label="control points", zorder=6.7, **dots)
    panel.finish(None if scene is None else scene_at(arm, state.q, scene))
    if torques:  # after the base, which the first joint would be behind
        _draw_loads(panel, state)
    panel.line(state.points[-1:], ls="none", marker="D", ms=6.0, color=THEME.ink, label="tip", zorder=7)
    shade_ellipsoids(panel, chosen)
    _fit_figure(figure, panel)
    _number_points(panel, state.points, arm.chain.base, 1.3 * half)
    _add_legends(figure, panel, chosen)
    kind = "planar" if planar else "spatial"
    modules = "1 module" if arm.n_modules == 1 else f"{arm.n_modules} modules"
    where = ", neutral configuration" if q is None else ""
    sentence = f"{arm.model.name}: {kind}, {modules}, {arm.nv} DOF, {length_text(arm.length)}{where}"
    palette.add_title(figure, [sentence])
    return figure


def _fit_figure(figure: Figure, panel: PosturePanel) -> None:
    """Set the figure height, within limits, such that the arm fills the width."""
    if not panel.spatial:
        wide, high = np.ptp(panel.drawn @ panel.screen.T, axis=0)
        slope = high / max(wide, 1e-9 * panel.arm.length)
        height = ARM_FIGURE.text_height + palette.FIGURE.width * slope
        figure.set_figheight(float(np.clip(height, *ARM_FIGURE.heights)))
        figure.set_layout_engine(ConstrainedLayoutEngine(w_pad=0.1, h_pad=0.09))
        return
    # 3D axes are square: for a wide picture, they extend beyond the figure at the top and bottom.
    high = float(box_extent(panel.ax)[1])
    height = float(np.clip(ARM_FIGURE.text_height + palette.FIGURE.width * high, *ARM_FIGURE.heights))
    side = min(palette.FIGURE.width, (height - ARM_FIGURE.text_height) / high)
    figure.set_figheight(height)
    width = side / palette.FIGURE.width
    panel.ax.set_position((0.5 - width / 2, 0.5 - side / height / 2, width, side / height))
    # The scales and their labels may be wider than the axes, on one side only.
    figure.draw_without_rendering()
    renderer = cast(Any, FigureCanvasAgg(figure)).get_renderer()
    ax = cast(Any, panel.ax)
    drawn = Bbox.union([axis.get_tightbbox(renderer) for axis in (ax.xaxis, ax.yaxis, ax.zaxis)])
    left = drawn.x0 / figure.bbox.width
    right = drawn.x1 / figure.bbox.width
    scale = min(1.0, (1.0 - 2.0 * ARM_FIGURE.side_room) / (right - left))
    middle = 0.5 - scale * ((left + right) / 2.0 - 0.5)
    width = scale * width
    high = scale * side / height
    panel.ax.set_position((middle - width / 2, 0.5 - high / 2, width, high))


def _draw_axes(panel: PosturePanel, origins: Array, axes: Array, half: float) -> None:
    turns = panel.arm.chain.revolute
    facing = (np.linalg.norm(axes @ panel.screen.T, axis=1) < 0.1) & (not panel.spatial)
    rings: dict[str, Any] = {"ls": "none", "marker": "o", "ms": 9.0, "mfc": "none", "mew": 1.4}
    rings["mec"] = THEME.turn
    bars: dict[str, Any] = {"color": THEME.turn, "lw": 1.8, "solid_capstyle": "round"}
    slides: dict[str, Any] = {"color": THEME.slide, "lw": 2.6, "ls": (0, (1, 0.7))}
    turning = "axis of a joint that turns"
    sliding = "axis of a joint that slides"
    for chosen, label, style in (
        (turns & facing, turning, rings),
        (turns & ~facing, "_" if np.any(turns & facing) else turning, bars),
        (~turns, sliding, slides),
    ):
        points = origins[chosen]
        along = half * axes[chosen]
        if style is not rings:  # one line with gaps, for one entry in the legend
            gaps = np.full_like(points, np.nan)
            points = np.stack([points - along, points + along, gaps], axis=1).reshape(-1, 3)
        if len(points):
            panel.line(points, label=label, zorder=5, **style)


def load_levels(state: ArmState) -> NDArray[np.intp]:
    """Return for each joint of the chain the row of `LOADS` that tells how much torque it needs, (k,).

    Raises:
        WeightUnknown: no torque limit, or not all masses are known.
    """
    arm = state.arm
    arm.require_effort(warns=False)
    shares = np.abs(state.gravity_torques) / arm.effort
    of_joints = np.where(np.isfinite(arm.effort), shares, np.inf)[arm.chain.columns]
    return np.searchsorted([most for most, *_ in LOADS], of_joints)


def _draw_loads(panel: PosturePanel, state: ArmState) -> None:
    """Mark joints by the share of its torque limit that each needs."""
    levels = load_levels(state)
    for level, (_, color, marker, meaning) in enumerate(LOADS):
        chosen = levels == level
        style: dict[str, Any] = {"ls": "none", "marker": marker, "ms": 8.0, "mec": THEME.ink, "mew": 0.5}
        if np.any(chosen):
            panel.line(state.origins[chosen], color=color, label=meaning, zorder=6.6, **style)


def _add_legends(figure: Figure, panel: PosturePanel, ellipsoids: Sequence[Ellipsoid]) -> None:
    """Add the legend of the arm at the bottom and that of the ellipsoids at the top right."""
    shades = THEME.modules[: panel.arm.n_modules]
    for name, shade in zip(("odd modules", "even modules"), shades, strict=False):
        panel.ax.plot([], [], color=shade, lw=5.0, label=name)
    style: dict[str, Any] = {"fontsize": 9, "frameon": False}
    outside = "" if panel.spatial else "outside "
    handles, labels = panel.ax.get_legend_handles_labels()
    for columns in range(len(labels), 0, -1):
        corner = cast(Any, f"{outside}lower left")
        legend = figure.legend(handles, labels, loc=corner, ncols=columns, **style)
        if columns == 1 or legend.get_window_extent().width <= figure.bbox.width:
            break
        legend.remove()
    if ellipsoids:
        text = f"manipulability ellipsoids, {scale_in_words(panel.arm, [one.point for one in ellipsoids])}"
        style |= {"ncols": 8, "title": text, "title_fontsize": 9, "alignment": "left"}
        figure.legend(handles=ellipsoid_key(), loc=cast(Any, f"{outside}upper right"), **style)


def _number_points(panel: PosturePanel, points: Array, base: Array, offset: float) -> None:
    """Write the numbers of control points beside the arm without overlap, starting with the last."""
    screen = panel.screen
    ax = cast(Any, panel.ax)  # text in space has three coordinates
    flat = np.vstack([base, points]) @ screen.T
    size = float(np.ptp(flat, axis=0).max())
    ahead = np.vstack([flat[1:], flat[-1:]]) - np.vstack([flat[:1], flat[:-1]])
    beside = np.column_stack([-ahead[:, 1], ahead[:, 0]])
    lengths = np.linalg.norm(beside, axis=1, keepdims=True)
    beside = np.where(lengths > 1e-9 * size, beside / np.maximum(lengths, 1e-300), (0.0, 1.0))
    beside[beside @ (0.5, 1.0) < 0.0] *= -1.0  # above the arm, or to the right of a vertical arm
    halo = {"path_effects": [withStroke(linewidth=2.0, foreground="white", alpha=0.7)]}
    written: list[Array] = []
    for k in (len(points), *range(1, len(points))):
        position = flat[k] + offset * beside[k]
        if any(np.linalg.norm(position - other) < ARM_FIGURE.number_distance * size for other in written):
            continue
        written.append(position)
        (where,) = np.transpose(panel.coordinates(points[k - 1 : k] + offset * beside[k] @ screen))
        ax.text(*where, str(k), fontsize=8, ha="center", va="center", color=THEME.ink, zorder=8, **halo)
