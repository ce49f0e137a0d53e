"""Postures of an arm, its targets and obstacles in a figure."""

from __future__ import annotations

from collections.abc import Sequence
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

FILL = 0.78
"""Share of three-dimensional axes that the plot takes; the rest is for its scales."""


class DrawnPosture(NamedTuple):
    """A line in a panel, as it was drawn.

    Attributes:
        points: (n, 3) [m], world frame.
        style: as for `Axes.plot`.
    """

    points: Array
    style: dict[str, Any]


class PosturePanel:
    """Draws postures and targets into one axes: in space, or for a planar arm in its plane.

    Attributes:
        arm: whose postures these are.
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
        # Seen from the other side if that makes the axes of the picture point the way the world's do.
        signs = np.sign(arm.plane[np.arange(arm.dimension), np.abs(arm.plane).argmax(axis=1)])
        self._plane: Array = arm.plane * signs[:, None]
        self.lines: list[DrawnPosture] = []
        self._room: list[Array] = []

    def coordinates(self, points: Array) -> tuple[Array, ...]:
        """Points (n, 3) [m] of the world as the coordinates of the axes, each (n,) [m]."""
        return tuple(points.T) if self.spatial else tuple(self._plane @ points.T)

    @property
    def screen(self) -> Array:
        """Unit vectors to the right and up in the finished picture, (2, 3), world frame."""
        if not self.spatial:
            return self._plane
        view: Any = self.ax
        right, up, _ = view_axes(np.radians(view.azim), np.radians(view.elev))
        return np.array([right, up])

    @property
    def eye(self) -> Array:
        """Unit vector towards whoever looks at the finished picture, (3,), world frame."""
        return np.asarray(np.cross(*self.screen))

    @property
    def drawn(self) -> Array:
        """The points that the picture has to show, (n, 3) [m], world frame."""
        points = np.vstack([*(line.points for line in self.lines), *self._room])
        return points[np.isfinite(points).all(axis=1)]  # a line may have gaps

    def line(self, points: Array, **style: Any) -> None:
        """Draw a line through points (n, 3) [m], world frame."""
        self.lines.append(DrawnPosture(points, style))
        self.ax.plot(*self.coordinates(points), **style)

    def make_room(self, points: Array) -> None:
        """Let the picture show the places (n, 3) [m], world frame, of what is drawn when it is finished."""
        self._room.append(points)

    def posture(self, q: Array, color: str, label: str, width: float) -> None:
        """Draw the arm at a configuration (nq,): its bodies, and its control points as dots."""
        points = self.arm.at(q).points
        # Thin lines go on top of thick ones, so that postures that coincide are both seen.
        self.line(backbone(self.arm, q), color=color, lw=width, solid_capstyle="round", zorder=6 - width / 4)
        dots: dict[str, Any] = {"marker": "o", "ms": 2.2 + 0.8 * width, "mec": "white", "mew": 0.4}
        self.line(points, color=color, ls="none", zorder=6.01 - width / 4, **dots)
        self.ax.plot([], [], color=color, lw=width, label=label, **dots)

    def target(self, target: Target) -> None:
        """Draw the target curve, or without one the target posture, and the target points.

        Only what lies between target points that follow each other is drawn boldly; free points are left out.
        """
        placed = target.has_target
        lines = outline(self.arm, target)
        style: dict[str, Any] = {"color": palette.TARGET, "zorder": 3, "solid_capstyle": "round"}
        known = "posture" if target.curve is None else "curve"
        if lines.covered:
            self.line(_joined(lines.covered), lw=1.4, label=f"target {known}", **style)
        if lines.rest:
            label, dashes = f"rest of the {known}", (0, (4, 2))
            self.line(_joined(lines.rest), color=palette.REST, lw=0.9, ls=dashes, zorder=2, label=label)
        if not (lines.covered or lines.rest):
            joined = np.vstack([self.arm.chain.base, np.where(placed[:, None], target.points, np.nan)])
            self.ax.plot(*self.coordinates(joined), lw=1.0, ls=(0, (1, 1.5)), **style)
        rings = {"ls": "none", "marker": "o", "ms": 4.6, "mfc": "white", "mec": palette.TARGET, "mew": 0.8}
        self.line(target.points[placed], label="target points", zorder=3, **rings)

    def finish(self) -> None:
        """Set the view, the equal scales and the labels to fit what was drawn."""
        base = self.arm.chain.base[None]
        marks = {"ls": "none", "marker": "s", "ms": 6.5, "color": palette.BASE, "label": "base"}
        self.line(base, zorder=6, **marks)
        if self.spatial:
            _frame_space(self.ax, self.drawn)
        else:
            self._frame_plane()

    def _frame_plane(self) -> None:
        self.ax.set_aspect("equal", adjustable="datalim")
        self.ax.margins(0.06)
        names = ("along the arm [m]", "across the arm [m]")
        labels = []
        for name, direction in zip(names, self._plane, strict=True):
            main = int(np.abs(direction).argmax())
            labels.append(f"{'xyz'[main]} [m]" if direction[main] > 1.0 - 1e-9 else name)
        self.ax.set_xlabel(labels[0], fontsize=9)
        self.ax.set_ylabel(labels[1], fontsize=9)
        self.ax.tick_params(labelsize=8)
        self.ax.spines[["top", "right"]].set_visible(False)
        self.ax.grid(color=palette.FAINT, lw=0.6)
        self.ax.set_axisbelow(True)


def _joined(lines: tuple[Array, ...]) -> Array:
    """Several lines as one with gaps, for one entry in the legend."""
    gap = np.full((1, 3), np.nan)
    return np.vstack([part for line in lines for part in (gap, line)][1:])


def _frame_space(ax: Any, points: Array) -> None:
    framing = frame_points(points)
    low, high = points.min(axis=0), points.max(axis=0)
    # An axis along which nothing happens still needs some room for its ticks.
    half = np.maximum((high - low) / 2.0, 0.2 * framing.radius) * 1.04
    middle = (low + high) / 2.0
    for name, center, size in zip("xyz", middle, half, strict=True):
        getattr(ax, f"set_{name}lim")(center - size, center + size)
        axis = getattr(ax, f"{name}axis")
        locator = MaxNLocator(max(2, round(7 * size / half.max())), steps=[1, 2, 5, 10])
        places = locator.tick_values(center - size, center + size)
        # At the corners the scales of two axes would meet.
        axis.set_ticks(places[np.abs(places - center) < 0.9 * size])
        axis.pane.set(facecolor="none", edgecolor=palette.FAINT)
        axis._axinfo["grid"].update(color=palette.FAINT, linewidth=0.6)  # there is no public way
        axis.set_label_text(f"{name} [m]", fontsize=9)
        # Labels are shifted by this many shares of the other two scales, which may be short.
        slender = float(half.max() / np.delete(half, "xyz".index(name)).max())
        axis.set_tick_params(labelsize=8, pad=3.0 * (slender - 1.0))
        axis.labelpad = 8.0 * (slender - 1.0) if name == "z" else 12.0 * slender
    ax.set_proj_type("ortho")
    ax.view_init(elev=np.degrees(framing.elevation), azim=np.degrees(framing.azimuth))
    ax.set_box_aspect(tuple(half))  # a copy: it scales an array in place
    ax.set_box_aspect(tuple(half), zoom=FILL / box_extent(ax).max())


def box_extent(ax: Any) -> Array:
    """Shares of the width and the height of three-dimensional axes that the box of the plot takes, (2,)."""
    corners = np.array(np.meshgrid(ax.get_xlim(), ax.get_ylim(), ax.get_zlim())).reshape(3, -1).T
    projected = np.hstack([corners, np.ones((8, 1))]) @ ax.get_proj().T
    flat = ax.transLimits.transform(projected[:, :2] / projected[:, 3:])
    return np.asarray(np.ptp(flat, axis=0))


# Obstacles: shaded in space, cut open in the plane.

VEIL = 0.6
"""Share of the colour of an obstacle in that of a line behind it."""

FINE = 400
"""Pieces of the size of the picture in which a line is told to be hidden or not."""

EDGE = palette.mixed(palette.OBSTACLE, palette.INK, 0.35)
"""Outlines of obstacles."""


def make_room_for(panel: PosturePanel, *scenes: Scene | None) -> list[ShownObstacle]:
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
    panel.make_room(shown_corners(shown))
    return shown


def draw_obstacles(panel: PosturePanel, shown: Sequence[ShownObstacle]) -> None:
    """Draw obstacles into a panel that is finished, with an entry for the legend.

    In space they are translucent, and lines that they hide are veiled. In the plane of a planar arm they are
    drawn where they meet that plane; what lies before or behind it is a dotted outline.

    Args:
        panel: the panel.
        shown: what `make_room_for` returned.
    """
    near = [each.near for each in shown if len(each.near)]
    if not shown:
        return
    if panel.spatial:
        _draw_solids(panel, near)
        _dim_hidden_lines(panel, near)
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
        outline = convex_outline(solid @ panel.screen.T)
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


def _dim_hidden_lines(panel: PosturePanel, near: Sequence[Array]) -> None:
    """Draw anew, in a colour between theirs and that of obstacles, what these hide of the lines."""
    finest = float(np.ptp(panel.drawn, axis=0).max()) / FINE
    for line in list(panel.lines):
        dashed = line.style.get("ls", "-") not in ("-", "none")
        if dashed or "alpha" in line.style:  # too faint already to be veiled
            continue
        dots = line.style.get("ls") == "none"
        points = line.points if dots else _subdivided(line, finest)
        behind = np.zeros(len(points), dtype=np.bool_)
        known = np.isfinite(points).all(axis=1)
        for solid in near:
            behind[known] |= is_hidden(points[known], solid, panel.eye)
        if behind.any():
            style = {**line.style, "label": "_", "zorder": line.style["zorder"] + 0.001}
            for key in ("color", "mfc", "mec"):
                if str(style.get(key, "")).startswith("#"):
                    style[key] = palette.mixed(style[key], palette.OBSTACLE, VEIL)
            panel.ax.plot(*panel.coordinates(np.where(behind[:, None], points, np.nan)), **style)


def _subdivided(line: DrawnPosture, finest: float) -> Array:
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
        outline = convex_outline(solid @ panel.screen.T)
        if len(outline):
            ax.fill(*outline.T, fill=False, ls=(0, (1, 2)), zorder=0.6, **edge)


# Runs.

BETWEEN = 8
"""How many of the postures on the way are drawn where there is something to get around."""

PALE: dict[str, Any] = {"lw": 0.7, "alpha": 0.35, "zorder": 1}
"""How a posture on the way is drawn."""


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
    """Draw several runs of one arm towards one target; each distinct start is drawn once.

    Args:
        runs: run, label and colour of each.
        ax: as for `plot_postures`.
    """
    first = runs[0][0]
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
        draw_intermediate_postures(panel, first, runs[0][2], evenly_spaced_rows(first, BETWEEN))
    shown = make_room_for(panel, *(run.scene for run, _, _ in runs))
    panel.finish()
    draw_obstacles(panel, shown)
    ax.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), fontsize=9, frameon=False, ncols=3)


def evenly_spaced_rows(run: Trajectory, count: int) -> NDArray[np.intp]:
    """Rows of `run.q` between which the control points move about equally far, without the first and last."""
    moved = np.linalg.norm(np.diff(run.points, axis=0), axis=2).mean(axis=1)
    way = np.concatenate([[0.0], np.cumsum(moved)])
    rows = np.searchsorted(way, np.linspace(0.0, way[-1], count + 2)[1:-1])
    return np.unique(rows[(rows > 0) & (rows < run.steps)])


def draw_intermediate_postures(
    panel: PosturePanel, run: Trajectory, color: str, rows: NDArray[np.intp]
) -> None:
    """Draw some of the postures between the first and the last of a run.

    Args:
        panel: where to draw.
        run: the run.
        color: colour of the lines.
        rows: which rows of `run.q`, (n,).
    """
    for k, row in enumerate(rows):
        label = "_" if k else "postures on the way"
        panel.line(backbone(run.arm, run.q[row]), color=color, label=label, **PALE)
