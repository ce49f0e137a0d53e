"""Drawing postures of an arm, targets, obstacles and manipulability ellipsoids."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import combinations, pairwise
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator
from mpl_toolkits.mplot3d.art3d import Poly3DCollection
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from pinposture.arm import Arm, Ellipsoid
from pinposture.collision import Scene
from pinposture.errors import InvalidValue
from pinposture.motion import Run
from pinposture.placement import Target
from pinposture.units import length_text
from pinposture.viz import palette
from pinposture.viz.body import backbone, convex_outline, facets, is_hidden, section
from pinposture.viz.drawing import (
    ROOT,
    ShownObstacle,
    Timeline,
    Track,
    frame_points,
    link_radius,
    outline,
    pose_tracks,
    same_signs,
    shown_corners,
    shown_obstacles,
    view_axes,
)
from pinposture.viz.palette import THEME

Array = NDArray[np.float64]


class PostureLook(NamedTuple):
    """How a figure shows postures, obstacles and ellipsoids."""

    plot_share: float = 0.78
    """Share of the plot in the room for 3D axes; the rest is for the scales."""

    most_plot_share: float = 0.98
    """Share of the plot in 3D axes, which clip it."""

    veil_share: float = 0.6
    """Share of the colour of obstacles in that of a line behind one."""

    veil_segments: int = 400
    """Number of segments per size of the picture into which lines are split to find hidden parts."""

    most_dots: int = 4000
    """Number of points drawn of a scan or a hollow mesh, at most about this."""

    edge_color: str = palette.mixed(THEME.obstacle, THEME.ink, 0.35)
    """Colour of outlines."""

    largest_ellipsoid: float = 0.2
    """Largest radius of ellipsoids, about, relative to the arm length."""

    least_ellipsoid: float = 0.3
    """Smallest radius of ellipsoids, relative to `link_radius`; flat ellipsoids become discs or rods."""

    ellipse_sides: int = 48
    """Number of sides of the polygon that approximates an ellipse."""


POSTURES = PostureLook()


class DrawnLine(NamedTuple):
    """A line in a panel: points, (n, 3) [m], world frame, and style arguments of `Axes.plot`."""

    points: Array
    style: dict[str, Any]


class PosturePanel:
    """Draws postures and targets into axes: in space, or in the plane of a planar arm.

    Attributes:
        arm: the arm.
        ax: axes with projection "3d"; for a planar arm, 2D axes are also allowed.
        spatial: whether the axes are 3D.
        lines: the lines drawn so far.

    Raises:
        InvalidValue: 2D axes for a spatial arm.
    """

    def __init__(self, arm: Arm, ax: Axes) -> None:
        self.arm = arm
        self.ax = ax
        self.spatial = ax.name == "3d"
        if not self.spatial and arm.dimension == 3:
            allowed = 'axes made with projection="3d", for an arm that moves in space'
            raise InvalidValue("ax (projection)", ax.name, allowed)
        # The plane is viewed from the side on which its axes have the directions of the world axes.
        signs = np.sign(arm.plane[np.arange(arm.dimension), np.abs(arm.plane).argmax(axis=1)])
        self._plane: Array = arm.plane * signs[:, None]
        self.lines: list[DrawnLine] = []
        self._obstacle_corners: Array = np.zeros((0, 3))

    def coordinates(self, points: Array) -> tuple[Array, ...]:
        """Return points, (n, 3) [m], world frame, in the coordinates of the axes, each (n,) [m]."""
        return tuple(points.T) if self.spatial else tuple(self._plane @ points.T)

    @property
    def screen(self) -> Array:
        """Unit vectors to the right and upwards in the finished picture, (2, 3), world frame."""
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
        """The points that the picture must show, (n, 3) [m], world frame."""
        points = np.vstack([*(line.points for line in self.lines), self._obstacle_corners])
        return points[np.isfinite(points).all(axis=1)]  # lines may have gaps

    def line(self, points: Array, **style: Any) -> None:
        """Draw a line through points, (n, 3) [m], world frame."""
        self.lines.append(DrawnLine(points, style))
        self.ax.plot(*self.coordinates(points), **style)

    def posture(self, q: Array, color: str, label: str, width: float) -> None:
        """Draw the arm at a configuration, (nq,): its bodies, and its control points as dots."""
        # Thin lines are drawn on top of thick ones, so that coinciding postures are all visible.
        self.line(backbone(self.arm, q), color=color, lw=width, solid_capstyle="round", zorder=6 - width / 4)
        dots: dict[str, Any] = {"marker": "o", "ms": 2.2 + 0.8 * width, "mec": "white", "mew": 0.4}
        self.line(self.arm.at(q).points, color=color, ls="none", zorder=6.01 - width / 4, **dots)
        self.ax.plot([], [], color=color, lw=width, label=label, **dots)

    def target(self, target: Target) -> None:
        """Draw the target curve (or, without one, the target posture) and the target points.

        The line is bold only between consecutive target points.
        """
        lines = outline(self.arm, target)
        style: dict[str, Any] = {"color": THEME.target, "zorder": 3, "solid_capstyle": "round"}
        known = "posture" if target.curve is None else "curve"
        if lines.covered:
            self.line(_join(lines.covered), lw=1.4, label=f"target {known}", **style)
        if lines.rest:
            label = f"rest of the {known}"
            dashes = (0, (4, 2))
            self.line(_join(lines.rest), color=THEME.rest, lw=0.9, ls=dashes, zorder=2, label=label)
        if not (lines.covered or lines.rest):
            points = np.where(target.has_target[:, None], target.points, np.nan)
            joined = np.vstack([self.arm.chain.base, points])
            self.ax.plot(*self.coordinates(joined), lw=1.0, ls=(0, (1, 1.5)), **style)
        rings = {"ls": "none", "marker": "o", "ms": 4.6, "mfc": "white", "mec": THEME.target, "mew": 0.8}
        self.line(target.points[target.has_target], label="target points", zorder=3, **rings)

    def finish(self, *scenes: Scene | None) -> None:
        """Fit view, scales and labels to the contents, and draw the obstacles of distinct scenes."""
        base = self.arm.chain.base[None]
        distinct = list(dict.fromkeys(scene for scene in scenes if scene is not None))
        points = np.vstack([self.drawn, base]) if distinct else base
        obstacles = [obstacle for scene in distinct for obstacle in shown_obstacles(scene, points)]
        self._obstacle_corners = shown_corners(obstacles)
        self.line(base, zorder=6, ls="none", marker="s", ms=6.5, color=THEME.base, label="base")
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
        palette.add_grid(self.ax)


def _join(lines: tuple[Array, ...]) -> Array:
    """Join lines into one with gaps, for a single entry in the legend."""
    gap = np.full((1, 3), np.nan)
    return np.vstack([part for line in lines for part in (gap, line)][1:])


def _frame_space(ax: Any, points: Array) -> None:
    framing = frame_points(points)
    low = points.min(axis=0)
    high = points.max(axis=0)
    # An axis without extent still needs room for its ticks.
    half = np.maximum((high - low) / 2.0, 0.2 * framing.radius) * 1.04
    middle = (low + high) / 2.0
    for name, center, size in zip("xyz", middle, half, strict=True):
        getattr(ax, f"set_{name}lim")(center - size, center + size)
        axis = getattr(ax, f"{name}axis")
        locator = MaxNLocator(max(2, round(7 * size / half.max())), steps=[1, 2, 5, 10])
        ticks = locator.tick_values(center - size, center + size)
        # No ticks at the corners, where the scales of two axes meet.
        axis.set_ticks(ticks[np.abs(ticks - center) < 0.9 * size])
        axis.pane.set(facecolor="none", edgecolor=THEME.faint)
        axis._axinfo["grid"].update(color=THEME.faint, linewidth=0.6)  # there is no public method
        axis.set_label_text(f"{name} [m]", fontsize=9)
        # Labels are shifted relative to the other two scales, which may be short.
        slender = float(half.max() / np.delete(half, "xyz".index(name)).max())
        axis.set_tick_params(labelsize=8, pad=3.0 * (slender - 1.0))
        axis.labelpad = 8.0 * (slender - 1.0) if name == "z" else 12.0 * slender
    ax.set_proj_type("ortho")
    ax.view_init(elev=np.degrees(framing.elevation), azim=np.degrees(framing.azimuth))
    ax.set_box_aspect(tuple(half))  # a copy, because it scales arrays in place
    room = ax.get_position(original=True).size * ax.figure.get_size_inches()
    # 3D axes are square: where they have more room to the sides, the scales may use that.
    share = np.minimum(POSTURES.plot_share * room / room.min(), POSTURES.most_plot_share)
    ax.set_box_aspect(tuple(half), zoom=(share / box_extent(ax)).min())


def box_extent(ax: Any) -> Array:
    """Return the shares of the plot in the width and height of 3D axes, (2,)."""
    corners = np.array(np.meshgrid(ax.get_xlim(), ax.get_ylim(), ax.get_zlim())).reshape(3, -1).T
    projected = np.hstack([corners, np.ones((8, 1))]) @ ax.get_proj().T
    flat = ax.transLimits.transform(projected[:, :2] / projected[:, 3:])
    return np.asarray(np.ptp(flat, axis=0))


def _draw_obstacles(panel: PosturePanel, shown: Sequence[ShownObstacle]) -> None:
    """Draw obstacles into a framed panel, with a legend entry.

    In space they are translucent, and lines behind them are veiled. For a planar arm, their sections with the
    plane are drawn; obstacles that do not meet the plane have a dotted outline.
    """
    if not shown:
        return
    near = [obstacle for obstacle in shown if len(obstacle.near)]
    solids = [obstacle.near for obstacle in near if not obstacle.hollow]
    for obstacle in near:
        if obstacle.hollow:
            _draw_dots(panel, obstacle.near)
    if panel.spatial:
        _draw_solids(panel, solids)
        _dim_hidden_lines(panel, solids)
    else:
        _draw_sections(panel, solids)
    label = "obstacle" if len(shown) == 1 else "obstacles"
    label += " (clipped)" if any(obstacle.cut for obstacle in near) else ""
    label += f", {len(shown) - len(near)} far off" if len(near) < len(shown) else ""
    square: dict[str, Any] = {"ls": "none", "marker": "s", "ms": 9.0, "mec": POSTURES.edge_color, "mew": 0.7}
    panel.ax.plot([], [], mfc=(*palette.rgb(THEME.obstacle), THEME.see_through), label=label, **square)


def _draw_dots(panel: PosturePanel, points: Array) -> None:
    """Draw the points of a scan or a hollow mesh."""
    shown = points[:: 1 + len(points) // POSTURES.most_dots]
    style: dict[str, Any] = {"ls": "none", "marker": ".", "ms": 2.0, "mew": 0.0, "zorder": 0.55}
    panel.ax.plot(*panel.coordinates(shown), color=THEME.obstacle, alpha=THEME.see_through, **style)


def _draw_solids(panel: PosturePanel, solids: Sequence[Array]) -> None:
    ax: Any = panel.ax
    ax.computed_zorder = False  # otherwise solids cover lines in front of them
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
            ax.plot(*line.T, color=POSTURES.edge_color, lw=0.8, zorder=0.6)
    if shades:
        most = max(map(len, faces))
        faces = [np.vstack([face, *[face[-1:]] * (most - len(face))]) for face in faces]
        style = {"facecolors": shades, "edgecolors": "none", "zorder": 0.5}
        ax.add_collection3d(Poly3DCollection(faces, **style), autolim=False)


def _shade(level: float) -> tuple[float, float, float, float]:
    """Return the colour of a face from the cosine between its normal and the light."""
    other = "#FFFFFF" if level > 0.0 else THEME.ink
    return (*palette.rgb(palette.mixed(THEME.obstacle, other, 0.55 * abs(level))), THEME.see_through)


def _dim_hidden_lines(panel: PosturePanel, solids: Sequence[Array]) -> None:
    """Redraw the parts of lines that solids hide, blended with the colour of obstacles."""
    finest = float(np.ptp(panel.drawn, axis=0).max()) / POSTURES.veil_segments
    for line in list(panel.lines):
        dots = line.style.get("ls") == "none"
        dashed = not dots and line.style.get("ls", "-") != "-"
        if dashed or "alpha" in line.style:  # already faint
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
                    style[key] = palette.mixed(style[key], THEME.obstacle, POSTURES.veil_share)
            panel.ax.plot(*panel.coordinates(np.where(behind[:, None], points, np.nan)), **style)


def _subdivide(points: Array, finest: float) -> Array:
    """Insert points into a line until the spacing is at most `finest` [m]."""
    pieces = [points[:1]]
    for a, b in pairwise(points):
        length = float(np.linalg.norm(b - a))
        count = max(1, int(np.ceil(length / finest))) if np.isfinite(length) else 1
        pieces.append(a + np.linspace(0.0, 1.0, count + 1)[1:, None] * (b - a) if count > 1 else b[None])
    return np.vstack(pieces)


def _draw_sections(panel: PosturePanel, solids: Sequence[Array]) -> None:
    ax: Axes = panel.ax
    edge: dict[str, Any] = {"edgecolor": POSTURES.edge_color, "lw": 0.8, "zorder": 0.6}
    face = (*palette.rgb(THEME.obstacle), THEME.see_through)
    for solid in solids:
        cross = section(solid, panel.arm.chain.base, panel.screen)
        rim = convex_outline(solid @ panel.screen.T)
        if len(cross):
            ax.fill(*cross.T, facecolor=face, **edge)
        elif len(rim):
            ax.fill(*rim.T, fill=False, ls=(0, (1, 2)), **edge)


def plot_postures(run: Run, ax: Axes) -> None:
    """Draw the postures at the start and end of a run, and the target.

    Args:
        run: the run.
        ax: axes with projection "3d"; for a planar arm, 2D axes are also allowed.

    Raises:
        InvalidValue: 2D axes for a spatial arm.
    """
    draw_runs([(run, "final posture", palette.controller_color(run.controller))], ax)


def draw_runs(runs: Sequence[tuple[Run, str, str]], ax: Axes) -> None:
    """Draw several runs of one arm to one target; each distinct start is drawn once.

    Args:
        runs: (run, label, colour) tuples.
        ax: as in `plot_postures`.
    """
    first, _, first_color = runs[0]
    panel = PosturePanel(first.arm, ax)
    panel.target(first.target)
    starts: list[Array] = []
    for run, _, _ in runs:
        if not any(np.array_equal(run.q[0], start) for start in starts):
            panel.posture(run.q[0], THEME.start, "initial posture" if not starts else "_", width=1.2)
            starts.append(run.q[0])
    for i, (run, label, color) in enumerate(runs):
        panel.posture(run.q[-1], color, label, width=2.2 + 1.2 * (len(runs) - 1 - i))
    if len(runs) == 1 and first.scene is not None:
        draw_intermediate_postures(panel, first, first_color, evenly_spaced_rows(first))
    panel.finish(*(run.final_scene for run, _, _ in runs))
    ax.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), fontsize=9, frameon=False, ncols=3)


def evenly_spaced_rows(run: Run) -> NDArray[np.intp]:
    """Return up to eight inner rows of `run.q` at about equal motions of the control points."""
    moved = np.linalg.norm(np.diff(run.points, axis=0), axis=2).mean(axis=1)
    path = np.concatenate([[0.0], np.cumsum(moved)])
    rows = np.searchsorted(path, np.linspace(0.0, path[-1], 10)[1:-1])
    return np.unique(rows[(rows > 0) & (rows < run.steps)])


def draw_intermediate_postures(panel: PosturePanel, run: Run, color: str, rows: NDArray[np.intp]) -> None:
    """Draw the postures at given rows of `run.q` as pale lines."""
    pale: dict[str, Any] = {"color": color, "lw": 0.7, "alpha": 0.35, "zorder": 1}
    for k, row in enumerate(rows):
        panel.line(backbone(run.arm, run.q[row]), label="_" if k else "intermediate postures", **pale)


INDEX_LABELS = {  # index (4.4) by the colour of an ellipsoid
    THEME.singular: "0, singular",
    THEME.worse: f"{THEME.regular_index / 4:g}",
    THEME.regular: f"{THEME.regular_index:g} and more",
}


def drawn_length(arm: Arm, points: Sequence[int]) -> float:
    """Return the length that represents 1 m/rad [m], the same in every posture.

    It is a round number with which the largest ellipsoid of the control points (0-based indices) is clearly
    visible beside the arm.
    """
    # Per radian, a revolute joint moves a point by at most the arm length between them.
    fastest = max((float(np.linalg.norm(_lever_arms(arm, point))) for point in points), default=0.0)
    # In space, joint motions are distributed over two directions across the arm.
    radius = max(fastest / np.sqrt(arm.dimension - 1.0), 0.01 * arm.length)
    return round_down(POSTURES.largest_ellipsoid * arm.length / radius, (1.0, 1.5, 2.0, 3.0, 5.0, 7.0))


def round_down(length: float, digits: tuple[float, ...] = (1.0, 2.0, 5.0)) -> float:
    """Round down to one of the given leading digits times a power of ten."""
    power = 10.0 ** np.floor(np.log10(length))
    return float(max(digit for digit in digits if digit * power <= length * (1.0 + 1e-9)) * power)


def scale_in_words(arm: Arm, points: Sequence[int]) -> str:
    """Return the scale of ellipsoids for a legend."""
    return f"1 m/rad drawn as {length_text(drawn_length(arm, points))}"


def draw_ellipsoids(panel: PosturePanel, ellipsoids: Sequence[Ellipsoid]) -> None:
    """Draw the ellipses of all pairs of principal axes, below the arm; call before the panel is finished."""
    for color, center, axes in _scaled_axes(panel, ellipsoids):
        for pair in combinations(axes, 2):
            panel.line(center + _circle() @ pair, color=color, lw=0.9, zorder=1.9)


def shade_ellipsoids(panel: PosturePanel, ellipsoids: Sequence[Ellipsoid]) -> None:
    """Shade ellipsoids within their outlines; call after the panel is finished."""
    ax: Any = panel.ax
    for color, center, axes in _scaled_axes(panel, ellipsoids):
        outline = center + silhouette(axes, panel.screen)
        panel.line(outline, color=color, lw=1.3, zorder=1.9)
        style = {"facecolor": (*palette.rgb(color), 0.22), "edgecolor": "none", "zorder": 1.8}
        if panel.spatial:
            ax.add_collection3d(Poly3DCollection([outline], **style))
        else:
            ax.fill(*panel.coordinates(outline), **style)


def silhouette(axes: Array, screen: Array) -> Array:
    """Return the closed line, (n, 3) [m], where rays to a distant eye touch an ellipsoid at the origin.

    Args:
        axes: its semi-axes, (d, 3) [m], world frame.
        screen: unit vectors to the right and upwards, (2, 3), world frame.
    """
    # The line is the image of the great circle of the unit sphere that maps to the outline.
    _, _, rim = np.linalg.svd(screen @ axes.T, full_matrices=False)
    return np.asarray(_circle() @ rim @ axes)


def ellipsoid_key() -> list[Patch]:
    """Return legend entries for the colours of ellipsoids."""
    listed = []
    for color, meaning in INDEX_LABELS.items():
        red, green, blue = palette.rgb(color)
        listed.append(Patch(facecolor=(red, green, blue, 0.3), edgecolor=color, label=f"index {meaning}"))
    return listed


def _scaled_axes(panel: PosturePanel, ellipsoids: Sequence[Ellipsoid]) -> Iterator[tuple[str, Array, Array]]:
    """Yield the colour, centre, (3,) [m], and drawn semi-axes, (d, 3) [m], of each ellipsoid."""
    length = drawn_length(panel.arm, [one.point for one in ellipsoids])
    for one in ellipsoids:
        yield palette.index_color(one.index), one.center, length * one.semi_axes


def _lever_arms(arm: Arm, point: int) -> Array:
    """Return upper bounds of the motion of a control point per unit of joint motion, (n,) [m]."""
    chain = arm.chain
    end = chain.module_slices[point].stop
    legs = np.linalg.norm(np.diff(np.vstack([chain.origins[:end], chain.points[point]]), axis=0), axis=1)
    reach = np.cumsum(legs[::-1])[::-1]
    return np.where(chain.revolute[:end], reach, arm.characteristic_length)


def _circle() -> Array:
    """Return the unit circle as a closed line, (POSTURES.ellipse_sides + 1, 2)."""
    around = np.linspace(0.0, 2.0 * np.pi, POSTURES.ellipse_sides + 1)
    return np.column_stack([np.cos(around), np.sin(around)])


class EllipsoidMotion(NamedTuple):
    """Ellipsoids of p control points at f configurations, as scaled and rotated unit spheres.

    Attributes:
        points: indices of the control points, 0-based, (p,).
        centers: (f, p, 3) [m], world frame.
        frames: principal axes in rows, right-handed, (f, p, 3, 3), world frame, with order and signs chosen
            to change least from one configuration to the next.
        radii: drawn radii along these axes, (f, p, 3) [m].
        indices: manipulability indices, (f, p).
    """

    points: tuple[int, ...]
    centers: Array
    frames: Array
    radii: Array
    indices: Array


def ellipsoid_motion(arm: Arm, points: tuple[int, ...], rows: Array) -> EllipsoidMotion:
    """Return the ellipsoids of control points (0-based) at consecutive configurations, (f, nq)."""
    shape = (len(rows), len(points))
    listed = [one for q in rows for one in arm.at(q).ellipsoids(points)] if points else []
    centers = np.array([one.center for one in listed]).reshape(*shape, 3)
    frames = np.array([principal_frame(one) for one in listed]).reshape(*shape, 3, 3)
    # A planar ellipse has no third radius.
    radii = np.array([np.append(one.radii, 0.0)[:3] for one in listed]).reshape(*shape, 3)
    indices = np.array([one.index for one in listed]).reshape(shape)
    drawn = np.maximum(drawn_length(arm, points) * radii, POSTURES.least_ellipsoid * link_radius(arm))
    return EllipsoidMotion(points, centers, *continue_axes(frames, drawn), indices)


def axis_ends(shown: EllipsoidMotion) -> Array:
    """Return the ends of the principal axes at all configurations, (n, 3) [m], world frame."""
    axes = shown.frames * shown.radii[..., None]
    ends = shown.centers[..., None, :] + np.stack([axes, -axes])
    return ends.reshape(-1, 3)


def ellipsoid_tracks(shown: EllipsoidMotion, playback: Timeline) -> list[Track]:
    """Return the tracks of ellipsoids, which move, stretch and change colour."""
    held = playback.key_rows
    times = playback.key_times
    listed = []
    for p, point in enumerate(shown.points):
        turns = Rotation.from_matrix(shown.frames[:, p].transpose(0, 2, 1)).as_quat()
        colors = np.array([palette.rgb(palette.index_color(index)) for index in shown.indices[:, p]])
        path = ellipsoid_path(point)
        listed += [
            *pose_tracks(path, times, shown.centers[held, p], same_signs(turns)[held]),
            Track(path, "scale", "vector3", times, shown.radii[held, p]),
            Track(f"{path}/<object>", "material.color", "color", times, colors[held]),
        ]
    return listed


def continue_axes(frames: Array, radii: Array) -> tuple[Array, Array]:
    """Reorder and flip the axes of each frame to continue those of the previous one.

    Otherwise they could jump, because order and signs of the principal axes of an ellipsoid are arbitrary.

    Args:
        frames: right-handed frames, axes in rows, (f, p, 3, 3).
        radii: radii along the axes, (f, p, 3).

    Returns:
        Right-handed frames, and radii.
    """
    frames = frames.copy()
    radii = radii.copy()
    permutations = np.rint(Rotation.create_group("O").as_matrix())  # signed, of right-handed axes, (24, 3, 3)
    for before, now, lengths in zip(frames[:-1], frames[1:], radii[1:], strict=True):
        renamed = permutations[:, None] @ now  # (24, p, 3, 3)
        best = np.einsum("gpij,pij->gp", renamed, before).argmax(axis=0)
        now[:] = renamed[best, np.arange(len(best))]
        lengths[:] = np.einsum("pij,pj->pi", np.abs(permutations[best]), lengths)
    return frames, radii


def ellipsoid_path(point: int) -> str:
    """Return the path of the ellipsoid of a control point (0-based)."""
    return f"{ROOT}/ellipsoids/point_{point + 1:03d}"


def principal_frame(one: Ellipsoid) -> Array:
    """Return the right-handed principal axes in rows, (3, 3); for an ellipse, the third is its normal."""
    if len(one.directions) == 3:
        return one.directions
    return np.vstack([one.directions, np.cross(*one.directions)])
