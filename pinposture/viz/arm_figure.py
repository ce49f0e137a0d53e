"""The arm itself in one picture: its modules, its joint axes, its control points."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal, NamedTuple, cast

import numpy as np
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.patheffects import withStroke
from numpy.typing import ArrayLike, NDArray

from pinposture.arm import Arm, ControlPoints, Ellipsoid
from pinposture.collision import Scene
from pinposture.viz import palette
from pinposture.viz.body import bodies, body_poses
from pinposture.viz.ellipsoids import draw_ellipsoids, ellipsoid_key, scale_in_words, shade_ellipsoids
from pinposture.viz.postures import PosturePanel, box_extent, draw_obstacles, make_room_for

Array = NDArray[np.float64]

WIDTH = 12.0
"""Width of the figure [inch]."""

MARGIN = 1.9
"""Height that title, scales and legend take [inch]."""

HEIGHTS = (3.6, 8.0)
"""Least and largest height of the figure [inch]; an arm that lies stretched needs no more than the least."""

CROWDED = 0.017
"""Distance between two numbers, relative to the size of the arm, below which one of them is left out."""


class ArmParts(NamedTuple):
    """Where the parts of an arm are at a configuration, world frame.

    Attributes:
        modules: of each module, the broken line from its base through its joints to its control point, each
            (p, 3) [m].
        joints: where the joints are, (n, 3) [m].
        axes: unit vectors along their axes, (n, 3).
        points: control points, (m, 3) [m].
    """

    modules: tuple[Array, ...]
    joints: Array
    axes: Array
    points: Array


def arm_parts(arm: Arm, q: ArrayLike) -> ArmParts:
    """Find the parts of an arm at a configuration (nq,).

    Raises:
        InvalidValue: a configuration of the wrong size, or not finite.
    """
    poses = body_poses(arm, q)
    joints = poses[:, :3, 3]
    axes = np.einsum("uij,uj->ui", poses[:, :3, :3], arm.chain.axes)
    ends = [(body, pose) for body, pose in zip(bodies(arm), poses, strict=True) if body.point is not None]
    points = np.array([pose[:3, :3] @ body.point + pose[:3, 3] for body, pose in ends])
    starts = np.vstack([arm.chain.base, points[:-1]])
    own = [joints[joint] for joint in arm.chain.module_slices]
    modules = tuple(np.vstack(line) for line in zip(starts, own, points, strict=True))
    return ArmParts(modules, joints, axes, points)


def plot_arm(
    arm: Arm, q: ArrayLike | None = None, ellipsoids: ControlPoints = (), scene: Scene | None = None
) -> Figure:
    """Show how an arm is built: modules in two shades that take turns, joint axes, numbered control points.

    A joint that turns has a bar along its axis, or in the plane of a planar arm, where its axis is seen from
    its end, a ring; one that slides has a dotted bar. Where control points crowd, some have no number.
    Manipulability ellipsoids (Section 3.3) have the colour of their index; the legend says at what scale.

    Args:
        arm: the arm.
        q: configuration, (nq,) [rad or m]; the neutral one if None.
        ellipsoids: control points to draw the manipulability ellipsoids of, by their indices, 0-based or from
            the tip as -1, or by their names.
        scene: what surrounds the arm; obstacles are shown where they are near.

    Returns:
        A figure, 1200 pixels wide, as `plot` gives it; a planar arm is seen in its plane, others in space.

    Raises:
        InvalidValue: a configuration of the wrong size, or not finite; or no choice of control points.
        UnknownName: a name that no control point has.
    """
    shown = arm.neutral() if q is None else q
    parts, chosen = arm_parts(arm, shown), arm.at(shown).ellipsoids(ellipsoids)
    half = _half_bar(arm)
    planar = arm.dimension == 2
    figure = Figure(figsize=(WIDTH, HEIGHTS[0]))
    # In space, too, the arm lies on top of what may be around it.
    ax = figure.add_subplot(**({} if planar else {"projection": "3d", "computed_zorder": False}))
    panel = PosturePanel(arm, ax)
    draw_ellipsoids(panel, chosen)
    for k, line in enumerate(parts.modules):
        shade = palette.MODULES[k % 2]
        panel.line(line, color=shade, lw=5.0, solid_capstyle="butt", solid_joinstyle="round", zorder=3)
    _draw_axes(panel, arm, parts, half)
    dots = {"ls": "none", "marker": "o", "ms": 4.2, "mfc": "white", "mec": palette.INK, "mew": 0.9}
    panel.line(parts.points[:-1], label="control points", zorder=6, **dots)
    surroundings = make_room_for(panel, scene)
    panel.finish()
    draw_obstacles(panel, surroundings)
    panel.line(parts.points[-1:], ls="none", marker="D", ms=6.0, color=palette.INK, label="tip", zorder=7)
    shade_ellipsoids(panel, chosen)
    _fit(figure, panel)
    _number(panel, parts.points, arm.chain.base, 1.3 * half)
    _add_legends(figure, panel, chosen)
    kind = "planar" if planar else "spatial"
    modules = "1 module" if arm.n_modules == 1 else f"{arm.n_modules} modules"
    where = ", neutral configuration" if q is None else ""
    title = f"{arm.model.name}: {kind}, {modules}, {arm.nv} DOF, {arm.length:.4g} m{where}"
    figure.suptitle(title, fontsize=10, x=0.012, ha="left", color=palette.INK, parse_math=False)
    return figure


def _half_bar(arm: Arm) -> float:
    """Half of the length of the bars [m]: short beside the links, and still to be seen beside the arm."""
    return float(np.clip(0.3 * np.median(arm.chain.module_lengths), 0.012 * arm.length, 0.035 * arm.length))


def _fit(figure: Figure, panel: PosturePanel) -> None:
    """Make the figure as high as the picture of the arm needs if it fills the width, or all there may be."""
    if not panel.spatial:
        wide, high = np.ptp(panel.drawn @ panel.screen.T, axis=0)
        slope = high / max(wide, 1e-9 * panel.arm.length)
        figure.set_figheight(float(np.clip(MARGIN + WIDTH * slope, *HEIGHTS)))
        figure.set_layout_engine(ConstrainedLayoutEngine(w_pad=0.1, h_pad=0.09))
        return
    # Axes in space are square: a picture that is wider than high leaves the figure above and below it.
    high = float(box_extent(panel.ax)[1])
    height = float(np.clip(MARGIN + WIDTH * high, *HEIGHTS))
    side = min(WIDTH, (height - MARGIN) / high)
    figure.set_figheight(height)
    panel.ax.set_position((0.5 - side / WIDTH / 2, 0.5 - side / height / 2, side / WIDTH, side / height))


def _draw_axes(panel: PosturePanel, arm: Arm, parts: ArmParts, half: float) -> None:
    turns = arm.chain.revolute
    facing = (np.linalg.norm(parts.axes @ panel.screen.T, axis=1) < 0.1) & (not panel.spatial)
    rings: dict[str, Any] = {
        "ls": "none",
        "marker": "o",
        "ms": 9.0,
        "mfc": "none",
        "mew": 1.4,
        "mec": palette.TURN,
    }
    bars: dict[str, Any] = {"color": palette.TURN, "lw": 1.8, "solid_capstyle": "round"}
    slides: dict[str, Any] = {"color": palette.SLIDE, "lw": 2.6, "ls": (0, (1, 0.7))}
    turning, sliding = "axis of a joint that turns", "axis of a joint that slides"
    for chosen, label, style in (
        (turns & facing, turning, rings),
        (turns & ~facing, "_" if np.any(turns & facing) else turning, bars),
        (~turns, sliding, slides),
    ):
        joints, axes = parts.joints[chosen], parts.axes[chosen]
        if style is not rings:  # one line with gaps, for one entry in the legend
            gaps = np.full_like(joints, np.nan)
            joints = np.stack([joints - half * axes, joints + half * axes, gaps], axis=1).reshape(-1, 3)
        if len(joints):
            panel.line(joints, label=label, zorder=5, **style)


def _add_legends(figure: Figure, panel: PosturePanel, ellipsoids: Sequence[Ellipsoid]) -> None:
    """Write the legends: below what the arm is made of, at the top on the right what the ellipsoids say."""
    shades = palette.MODULES[: panel.arm.n_modules]
    for name, shade in zip(("odd modules", "even modules"), shades, strict=False):
        panel.ax.plot([], [], color=shade, lw=5.0, label=name)
    lower: Literal["outside lower left", "lower left"] = (
        "lower left" if panel.spatial else "outside lower left"
    )
    upper: Literal["outside upper right", "upper right"] = (
        "upper right" if panel.spatial else "outside upper right"
    )
    handles, labels = panel.ax.get_legend_handles_labels()
    figure.legend(handles, labels, loc=lower, fontsize=9, frameon=False, ncols=8)
    if ellipsoids:
        title = f"manipulability ellipsoids, {scale_in_words(panel.arm, [one.point for one in ellipsoids])}"
        style: dict[str, Any] = {"title": title, "title_fontsize": 9, "alignment": "left"}
        figure.legend(handles=ellipsoid_key(), loc=upper, fontsize=9, frameon=False, ncols=8, **style)


def _number(panel: PosturePanel, points: Array, base: Array, offset: float) -> None:
    """Write the number of each control point beside the arm, the last one first; none upon another."""
    screen, ax = panel.screen, cast(Any, panel.ax)  # text in space has three coordinates
    flat = np.vstack([base, points]) @ screen.T
    size = float(np.ptp(flat, axis=0).max())
    ahead = np.vstack([flat[1:], flat[-1:]]) - np.vstack([flat[:1], flat[:-1]])
    beside = np.column_stack([-ahead[:, 1], ahead[:, 0]])
    lengths = np.linalg.norm(beside, axis=1, keepdims=True)
    beside = np.where(lengths > 1e-9 * size, beside / np.maximum(lengths, 1e-300), (0.0, 1.0))
    beside[beside @ (0.5, 1.0) < 0.0] *= -1.0  # above the arm, or on the right of one that stands
    halo = {"path_effects": [withStroke(linewidth=2.0, foreground="white", alpha=0.7)]}
    written: list[Array] = []
    for k in (len(points), *range(1, len(points))):
        place = flat[k] + offset * beside[k]
        if any(np.linalg.norm(place - other) < CROWDED * size for other in written):
            continue
        written.append(place)
        (where,) = np.transpose(panel.coordinates(points[k - 1 : k] + offset * beside[k] @ screen))
        ax.text(*where, str(k), fontsize=8, ha="center", va="center", color=palette.INK, zorder=8, **halo)
