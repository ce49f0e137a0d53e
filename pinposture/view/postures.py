"""The posture panel: postures of an arm and its target, in space or in the plane of the arm."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from pinposture.arm import Arm
from pinposture.errors import InvalidValue
from pinposture.target import Target
from pinposture.view import palette
from pinposture.view.body import backbone
from pinposture.view.framing import frame_points, look
from pinposture.view.outline import outline

Array = NDArray[np.float64]

FILL = 0.78
"""Share of three-dimensional axes that the plot takes; the rest is for its scales."""


class Drawn(NamedTuple):
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
        self.lines: list[Drawn] = []
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
        right, up, _ = look(np.radians(view.azim), np.radians(view.elev))
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
        self.lines.append(Drawn(points, style))
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
        placed = target.placed
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
