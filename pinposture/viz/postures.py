"""Postures of an arm, its targets and obstacles in a figure."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator
from mpl_toolkits.mplot3d.art3d import Poly3DCollection
from numpy.typing import NDArray

from pinposture.arm import Arm
from pinposture.collision import Scene
from pinposture.errors import InvalidValue
from pinposture.motion import Trajectory
from pinposture.placement import Target
from pinposture.viz import palette
from pinposture.viz.axes import add_grid
from pinposture.viz.body import backbone
from pinposture.viz.drawing import (
    ShownObstacle,
    frame_points,
    outline,
    shown_corners,
    shown_obstacles,
    view_axes,
)
from pinposture.viz.mesh import convex_outline, facets, is_hidden, section

# Postures and target, in space or in the plane of a planar arm.

Array = NDArray[np.float64]

PLOT_SHARE = 0.78  # of three-dimensional axes; the rest is for the scales


class DrawnLine(NamedTuple):
    """A line in a panel: points (n, 3) [m], world frame, and its style as for `Axes.plot`."""

    points: Array
    style: dict[str, Any]


class PosturePanel:
    """Draws postures and targets into one axes: in space, or for a planar arm in its plane.

    Attributes:
        arm: the arm.
        ax: axes with projection "3d"; for a planar arm also plain ones.
        spatial: whether they are in space.
        lines: what was drawn so far.

    Raises:
        InvalidValue: plain axes for an arm that moves in space.
    """

    def __init__(self, arm: Arm, ax: Axes) -> None:
        self.arm, self.ax = arm, ax
        self.spatial = ax.name == "3d"
        if not self.spatial and arm.dimension == 3:
            allowed = 'axes made with projection="3d", for an arm that moves in space'
            raise InvalidValue("ax (projection)", ax.name, allowed)
        # The plane is seen from the side from which its axes point like those of the world.
        signs = np.sign(arm.plane[np.arange(arm.dimension), np.abs(arm.plane).argmax(axis=1)])
        self._plane: Array = arm.plane * signs[:, None]
        self.lines: list[DrawnLine] = []
        self._obstacle_corners: Array = np.zeros((0, 3))

    def coordinates(self, points: Array) -> tuple[Array, ...]:
        """Return points (n, 3) [m] of the world in the coordinates of the axes, each (n,) [m]."""
        return tuple(points.T) if self.spatial else tuple(self._plane @ points.T)

    @property
    def screen(self) -> Array:
        """Unit vectors to the right and up in the finished picture, (2, 3), world frame."""
        if not self.spatial:
            return self._plane
        view: Any = self.ax
        return view_axes(np.radians(view.azim), np.radians(view.elev))[:2]

    @property
    def eye(self) -> Array:
        """Unit vector towards the viewer of the finished picture, (3,), world frame."""
        return np.asarray(np.cross(*self.screen))

    @property
    def drawn(self) -> Array:
        """The points that the picture has to show, (n, 3) [m], world frame."""
        points = np.vstack([*(line.points for line in self.lines), self._obstacle_corners])
        return points[np.isfinite(points).all(axis=1)]  # a line may have gaps

    def line(self, points: Array, **style: Any) -> None:
        """Draw a line through points (n, 3) [m], world frame."""
        self.lines.append(DrawnLine(points, style))
        self.ax.plot(*self.coordinates(points), **style)

    def posture(self, q: Array, color: str, label: str, width: float) -> None:
        """Draw the arm at a configuration (nq,): its bodies, and its control points as dots."""
        # Thin lines go on top of thick ones, so that postures that coincide are both visible.
        self.line(backbone(self.arm, q), color=color, lw=width, solid_capstyle="round", zorder=6 - width / 4)
        dots: dict[str, Any] = {"marker": "o", "ms": 2.2 + 0.8 * width, "mec": "white", "mew": 0.4}
        self.line(self.arm.at(q).points, color=color, ls="none", zorder=6.01 - width / 4, **dots)
        self.ax.plot([], [], color=color, lw=width, label=label, **dots)

    def target(self, target: Target) -> None:
        """Draw the target curve, or without one the target posture, and the target points.

        Only the line between consecutive target points is bold.
        """
        lines = outline(self.arm, target)
        style: dict[str, Any] = {"color": palette.TARGET, "zorder": 3, "solid_capstyle": "round"}
        known = "posture" if target.curve is None else "curve"
        if lines.covered:
            self.line(_join(lines.covered), lw=1.4, label=f"target {known}", **style)
        if lines.rest:
            label, dashes = f"rest of the {known}", (0, (4, 2))
            self.line(_join(lines.rest), color=palette.REST, lw=0.9, ls=dashes, zorder=2, label=label)
        if not (lines.covered or lines.rest):
            points = np.where(target.has_target[:, None], target.points, np.nan)
            joined = np.vstack([self.arm.chain.base, points])
            self.ax.plot(*self.coordinates(joined), lw=1.0, ls=(0, (1, 1.5)), **style)
        rings = {"ls": "none", "marker": "o", "ms": 4.6, "mfc": "white", "mec": palette.TARGET, "mew": 0.8}
        self.line(target.points[target.has_target], label="target points", zorder=3, **rings)

    def finish(self, *scenes: Scene | None) -> None:
        """Fit view, scales and labels to what was drawn, and draw the obstacles of distinct scenes."""
        base = self.arm.chain.base[None]
        distinct = list(dict.fromkeys(scene for scene in scenes if scene is not None))
        points = np.vstack([self.drawn, base]) if distinct else base
        obstacles = [each for scene in distinct for each in shown_obstacles(scene, points)]
        self._obstacle_corners = shown_corners(obstacles)
        self.line(base, zorder=6, ls="none", marker="s", ms=6.5, color=palette.BASE, label="base")
        if self.spatial:
            _frame_space(self.ax, self.drawn)
        else:
            self._frame_plane()
        _draw_obstacles(self, obstacles)

    def _frame_plane(self) -> None:
        self.ax.set_aspect("equal", adjustable="datalim")
        self.ax.margins(0.06)
        labels = []
        for name, direction in zip(("along", "across"), self._plane, strict=True):
            main = int(np.abs(direction).argmax())
            labels.append(f"{'xyz'[main]} [m]" if direction[main] > 1.0 - 1e-9 else f"{name} the arm [m]")
        self.ax.set_xlabel(labels[0], fontsize=9)
        self.ax.set_ylabel(labels[1], fontsize=9)
        add_grid(self.ax)


def _join(lines: tuple[Array, ...]) -> Array:
    """Join lines to one with gaps, for one entry in the legend."""
    gap = np.full((1, 3), np.nan)
    return np.vstack([part for line in lines for part in (gap, line)][1:])


def _frame_space(ax: Any, points: Array) -> None:
    framing = frame_points(points)
    low, high = points.min(axis=0), points.max(axis=0)
    # An axis without extent still needs some room for its ticks.
    half = np.maximum((high - low) / 2.0, 0.2 * framing.radius) * 1.04
    middle = (low + high) / 2.0
    for name, center, size in zip("xyz", middle, half, strict=True):
        getattr(ax, f"set_{name}lim")(center - size, center + size)
        axis = getattr(ax, f"{name}axis")
        locator = MaxNLocator(max(2, round(7 * size / half.max())), steps=[1, 2, 5, 10])
        places = locator.tick_values(center - size, center + size)
        # Without ticks at the corners, where the scales of two axes meet.
        axis.set_ticks(places[np.abs(places - center) < 0.9 * size])
        axis.pane.set(facecolor="none", edgecolor=palette.FAINT)
        axis._axinfo["grid"].update(color=palette.FAINT, linewidth=0.6)  # there is no public method
        axis.set_label_text(f"{name} [m]", fontsize=9)
        # Labels are shifted by these shares of the other two scales, which may be short.
        slender = float(half.max() / np.delete(half, "xyz".index(name)).max())
        axis.set_tick_params(labelsize=8, pad=3.0 * (slender - 1.0))
        axis.labelpad = 8.0 * (slender - 1.0) if name == "z" else 12.0 * slender
    ax.set_proj_type("ortho")
    ax.view_init(elev=np.degrees(framing.elevation), azim=np.degrees(framing.azimuth))
    ax.set_box_aspect(tuple(half))  # a copy: it scales an array in place
    ax.set_box_aspect(tuple(half), zoom=PLOT_SHARE / box_extent(ax).max())


def box_extent(ax: Any) -> Array:
    """Return the share that the plot takes of the width and height of three-dimensional axes, (2,)."""
    corners = np.array(np.meshgrid(ax.get_xlim(), ax.get_ylim(), ax.get_zlim())).reshape(3, -1).T
    projected = np.hstack([corners, np.ones((8, 1))]) @ ax.get_proj().T
    flat = ax.transLimits.transform(projected[:, :2] / projected[:, 3:])
    return np.asarray(np.ptp(flat, axis=0))


# Obstacles: shaded in space, cut open in the plane.

VEIL_SHARE = 0.6  # share of the colour of an obstacle in that of a line behind it
VEIL_SEGMENTS = 400  # a line is split into pieces of the picture size over this to find its hidden parts
MAX_DOTS = 4000  # points that are drawn of a scan or a hollow mesh
EDGE_COLOR = palette.mixed(palette.OBSTACLE, palette.INK, 0.35)  # colour of outlines


def _draw_obstacles(panel: PosturePanel, shown: Sequence[ShownObstacle]) -> None:
    """Draw obstacles into a panel that is framed, with an entry for the legend.

    In space they are translucent, and lines that they hide are veiled. For a planar arm their sections with
    its plane are drawn; those that do not meet the plane have a dotted outline.
    """
    if not shown:
        return
    near = [each for each in shown if len(each.near)]
    solids = [each.near for each in near if not each.hollow]
    for each in near:
        if each.hollow:
            _draw_dots(panel, each.near)
    if panel.spatial:
        _draw_solids(panel, solids)
        _dim_hidden_lines(panel, solids)
    else:
        _draw_sections(panel, solids)
    label = "obstacle" if len(shown) == 1 else "obstacles"
    label += ", cut off" if any(each.cut for each in near) else ""
    label += f", {len(shown) - len(near)} far off" if len(near) < len(shown) else ""
    square: dict[str, Any] = {"ls": "none", "marker": "s", "ms": 9.0, "mec": EDGE_COLOR, "mew": 0.7}
    panel.ax.plot([], [], mfc=(*palette.rgb(palette.OBSTACLE), palette.SEE_THROUGH), label=label, **square)


def _draw_dots(panel: PosturePanel, points: Array) -> None:
    """Draw points of a scan or a hollow mesh."""
    shown = points[:: 1 + len(points) // MAX_DOTS]
    style: dict[str, Any] = {"ls": "none", "marker": ".", "ms": 2.0, "mew": 0.0, "zorder": 0.55}
    panel.ax.plot(*panel.coordinates(shown), color=palette.OBSTACLE, alpha=palette.SEE_THROUGH, **style)


def _draw_solids(panel: PosturePanel, solids: Sequence[Array]) -> None:
    ax: Any = panel.ax
    ax.computed_zorder = False  # otherwise they cover lines that are in front of them
    right, up = panel.screen
    light = 0.5 * panel.eye + 0.8 * up - 0.4 * right
    light /= np.linalg.norm(light)
    faces: list[Array] = []
    shades: list[tuple[float, ...]] = []
    for solid in solids:
        visible = [(face, normal) for face, normal in facets(solid) if normal @ panel.eye > 0.0]
        faces.extend(face for face, _ in visible)
        shades.extend(_shade(float(normal @ light)) for _, normal in visible)
        rim = convex_outline(solid @ panel.screen.T)
        if len(rim):
            depth = float((solid @ panel.eye).mean())
            line = np.vstack([rim, rim[:1]]) @ panel.screen + depth * panel.eye
            ax.plot(*line.T, color=EDGE_COLOR, lw=0.8, zorder=0.6)
    if shades:
        most = max(map(len, faces))
        faces = [np.vstack([face, *[face[-1:]] * (most - len(face))]) for face in faces]
        style = {"facecolors": shades, "edgecolors": "none", "zorder": 0.5}
        ax.add_collection3d(Poly3DCollection(faces, **style), autolim=False)


def _shade(level: float) -> tuple[float, float, float, float]:
    """Return the colour of a face by the cosine between its normal and the light."""
    other = "#FFFFFF" if level > 0.0 else palette.INK
    return (*palette.rgb(palette.mixed(palette.OBSTACLE, other, 0.55 * abs(level))), palette.SEE_THROUGH)


def _dim_hidden_lines(panel: PosturePanel, solids: Sequence[Array]) -> None:
    """Redraw the parts of lines that solids hide, blended with the colour of obstacles."""
    finest = float(np.ptp(panel.drawn, axis=0).max()) / VEIL_SEGMENTS
    for line in list(panel.lines):
        dots = line.style.get("ls") == "none"
        dashed = not dots and line.style.get("ls", "-") != "-"
        if dashed or "alpha" in line.style:  # too faint already to be veiled
            continue
        points = line.points if dots else _subdivide(line.points, finest)
        behind = np.zeros(len(points), dtype=np.bool_)
        known = np.isfinite(points).all(axis=1)
        for solid in solids:
            behind[known] |= is_hidden(points[known], solid, panel.eye)
        if behind.any():
            style = {**line.style, "label": "_", "zorder": line.style["zorder"] + 0.001}
            for key in ("color", "mfc", "mec"):
                if str(style.get(key, "")).startswith("#"):
                    style[key] = palette.mixed(style[key], palette.OBSTACLE, VEIL_SHARE)
            panel.ax.plot(*panel.coordinates(np.where(behind[:, None], points, np.nan)), **style)


def _subdivide(points: Array, finest: float) -> Array:
    """Insert points into a line until consecutive ones are no farther apart than `finest` [m]."""
    pieces = [points[:1]]
    for a, b in pairwise(points):
        length = float(np.linalg.norm(b - a))
        count = max(1, int(np.ceil(length / finest))) if np.isfinite(length) else 1
        pieces.append(a + np.linspace(0.0, 1.0, count + 1)[1:, None] * (b - a) if count > 1 else b[None])
    return np.vstack(pieces)


def _draw_sections(panel: PosturePanel, solids: Sequence[Array]) -> None:
    ax: Axes = panel.ax
    edge: dict[str, Any] = {"edgecolor": EDGE_COLOR, "lw": 0.8, "zorder": 0.6}
    face = (*palette.rgb(palette.OBSTACLE), palette.SEE_THROUGH)
    for solid in solids:
        cross = section(solid, panel.arm.chain.base, panel.screen)
        rim = convex_outline(solid @ panel.screen.T)
        if len(cross):
            ax.fill(*cross.T, facecolor=face, **edge)
        elif len(rim):
            ax.fill(*rim.T, fill=False, ls=(0, (1, 2)), **edge)


# Runs.


def plot_postures(run: Trajectory, ax: Axes) -> None:
    """Draw the postures at the start and the end of a run, and the target.

    Args:
        run: the run.
        ax: axes with projection "3d"; for a planar arm also plain ones.

    Raises:
        InvalidValue: plain axes for an arm that moves in space.
    """
    draw_runs([(run, "final posture", palette.controller_color(run.controller))], ax)


def draw_runs(runs: Sequence[tuple[Trajectory, str, str]], ax: Axes) -> None:
    """Draw several runs of one arm to one target; each distinct start is drawn once.

    Args:
        runs: run, label and colour of each.
        ax: as for `plot_postures`.
    """
    first, _, first_color = runs[0]
    panel = PosturePanel(first.arm, ax)
    panel.target(first.target)
    starts: list[Array] = []
    for run, _, _ in runs:
        if not any(np.array_equal(run.q[0], start) for start in starts):
            panel.posture(run.q[0], palette.START, "initial posture" if not starts else "_", width=1.2)
            starts.append(run.q[0])
    for i, (run, label, color) in enumerate(runs):
        panel.posture(run.q[-1], color, label, width=2.2 + 1.2 * (len(runs) - 1 - i))
    if len(runs) == 1 and first.scene is not None:
        draw_intermediate_postures(panel, first, first_color, evenly_spaced_rows(first))
    panel.finish(*(run.scene for run, _, _ in runs))
    ax.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), fontsize=9, frameon=False, ncols=3)


def evenly_spaced_rows(run: Trajectory, count: int = 8) -> NDArray[np.intp]:
    """Return inner rows of `run.q` between which the control points move about equally far."""
    moved = np.linalg.norm(np.diff(run.points, axis=0), axis=2).mean(axis=1)
    path = np.concatenate([[0.0], np.cumsum(moved)])
    rows = np.searchsorted(path, np.linspace(0.0, path[-1], count + 2)[1:-1])
    return np.unique(rows[(rows > 0) & (rows < run.steps)])


def draw_intermediate_postures(
    panel: PosturePanel, run: Trajectory, color: str, rows: NDArray[np.intp]
) -> None:
    """Draw the postures at some rows of `run.q` as pale lines."""
    pale: dict[str, Any] = {"color": color, "lw": 0.7, "alpha": 0.35, "zorder": 1}
    for k, row in enumerate(rows):
        panel.line(backbone(run.arm, run.q[row]), label="_" if k else "postures on the way", **pale)
