"""Common style of all figures: colours with the same meaning in every picture, scales, layout, titles.

The colours are those of Okabe and Ito, which people with any kind of colour blindness can distinguish.
Initial posture, target curve, Selection and Projection have the hues of the thesis: blue, black, red, green.
"""

from __future__ import annotations

import ast
import re
import textwrap
from collections.abc import Iterable, Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import Any, NamedTuple, cast

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LinearSegmentedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.text import Annotation
from matplotlib.ticker import LogFormatterMathtext, MaxNLocator, NullFormatter
from numpy.typing import NDArray

from pinposture.arm import Arm
from pinposture.control import registry
from pinposture.motion import Run, Trajectory
from pinposture.units import BELOW_ROUNDING, length_text


class Theme(NamedTuple):
    """Colours and opacities of all figures, animations and the editor."""

    start: str = "#0072B2"
    """Initial posture."""

    final: str = "#6A51A3"
    """Final posture of a controller without a colour of its own."""

    target: str = "#000000"
    """Target curve and target points."""

    rest: str = "#9A9A9A"
    """The target curve beyond the reach of the arm, and other secondary items."""

    controllers: Mapping[str, str] = MappingProxyType(
        {
            "selection": "#D55E00",
            "projection": "#009E73",
            "switching": "#CC79A7",
            "geodesic": "#E69F00",
        }
    )
    """Final postures, by the name of the controller."""

    spare: tuple[str, ...] = ("#56B4E9", "#8C510A", "#6A51A3", "#666666")
    """Runs whose controllers have no colour or share one."""

    modules: tuple[str, str] = ("#4F779F", "#A3B8CC")
    """Odd and even modules."""

    along: tuple[str, ...] = ("#440154", "#46327E", "#365C8D", "#277F8E", "#1FA187", "#4AC16D", "#A0DA39")
    """Modules from base to tip, where each has its colour."""

    times: tuple[str, ...] = ("#EDB458", "#DD6E42", "#B23A5B", "#6A2470", "#2A1350")
    """Postures from the first to the last."""

    turn: str = "#B03A6F"
    """Axis of a revolute joint."""

    slide: str = "#0B7A5B"
    """Axis of a prismatic joint."""

    base: str = "#4A5560"
    """Base of the arm."""

    active: str = "#E69F00"
    """A control point in the active control set."""

    idle: str = "#FFFFFF"
    """An inactive control point."""

    obstacle: str = "#94897A"
    """Obstacles."""

    see_through: float = 0.45
    """Opacity of a few obstacles."""

    sheer: float = 0.18
    """Opacity of many obstacles behind each other."""

    singular: str = "#CC2A1E"
    """Manipulability ellipsoid of index 0."""

    worse: str = "#D6CB2A"
    """Manipulability ellipsoid of a quarter of `regular_index`."""

    regular: str = "#009E73"
    """Manipulability ellipsoid of `regular_index` or more."""

    regular_index: float = 0.4
    """Manipulability index from which on ellipsoids have one colour."""

    escape: str = "#E4D9F2"
    """Background of steps in which the posture error may rise."""

    mark: str = "#CC0000"
    """Marked steps, as on the step axis of Figure 6.12 of the thesis."""

    ink: str = "#333333"
    """Text and axes."""

    quiet: str = "#707070"
    """Footnotes."""

    faint: str = "#DDDDDD"
    """Grid lines."""

    ellipsoids: float = 0.5
    """Opacity of ellipsoids in animations."""


THEME = Theme()


def controller_color(controller: str) -> str:
    """Return the colour of a controller, given by name or by its description in a run."""
    return THEME.controllers.get(controller.partition("(")[0].strip().lower(), THEME.final)


def distinct_colors(controllers: Iterable[str]) -> list[str]:
    """Return one colour per run, distinct as far as the palette allows."""
    colors: list[str] = []
    for controller in controllers:
        usual = controller_color(controller)
        free = [color for color in (usual, *THEME.spare, *THEME.controllers.values()) if color not in colors]
        colors.append(free[0] if free else usual)
    return colors


def index_color(index: float) -> str:
    """Return the colour of a manipulability ellipsoid by its index in [0, 1], with more contrast near 0.

    There are 33 colours, so that small motions of the arm do not change the colour.
    """
    share = (
        round(32.0 * min(index / THEME.regular_index, 1.0) ** 0.5) / 16.0
    )  # 0 to 1 to 2 along three colours
    before = THEME.singular
    after = THEME.worse
    if share > 1.0:
        share = share - 1.0
        before = THEME.worse
        after = THEME.regular
    return mixed(before, after, share)


def in_time(share: float) -> str:
    """Return the colour of a posture at a fraction of its motion in [0, 1]."""
    along = share * (len(THEME.times) - 1)
    before = min(int(along), len(THEME.times) - 2)
    return mixed(THEME.times[before], THEME.times[before + 1], along - before)


def mixed(color: str, other: str, share: float) -> str:
    """Blend a colour "#RRGGBB" with another, which has a share in [0, 1]."""
    parts = ((1.0 - share) * a + share * b for a, b in zip(rgb(color), rgb(other), strict=True))
    return "#" + "".join(f"{round(255.0 * part):02X}" for part in parts)


def rgb(color: str) -> tuple[float, float, float]:
    """Return red, green and blue, each in [0, 1], of a colour "#RRGGBB"."""
    red, green, blue = (int(color[i : i + 2], 16) / 255.0 for i in (1, 3, 5))
    return red, green, blue


class FigureLayout(NamedTuple):
    """Size of a figure, and scales of its axes."""

    width: float = 12.0
    """Width [inch]; 1200 pixels at the default resolution."""

    height: float = 7.2
    """Height [inch]."""

    log_decades: float = 1.5
    """Decades spanned by the values from which an axis is logarithmic."""

    most_decades: float = 12.0
    """Largest number of decades on such an axis; smaller values are rounding errors."""

    headroom: float = 0.1
    """Share of such an axis above the largest value, where its text stands."""

    edge: float = 0.15
    """Share of an axis at either end, near which a text above a point would leave the axes."""


FIGURE = FigureLayout()


def format_step_axes(ax: Axes, label: str) -> None:
    """Format axes over steps, from 0 to the last step drawn: ticks, grid and labels."""
    steps = _format_axes(ax, "step", label)
    ax.set_xlim(0.0 if steps else -1.0, max(steps, 1.0))
    ax.xaxis.set_major_locator(MaxNLocator(nbins=8, integer=True, min_n_ticks=1))


def format_time_axes(ax: Axes, label: str) -> None:
    """Format axes over time, from 0 to the last time drawn: ticks, grid and labels."""
    end = _format_axes(ax, "time [s]", label)
    ax.set_xlim(0.0 if end else -1.0, end or 1.0)
    ax.xaxis.set_major_locator(MaxNLocator(nbins=8, min_n_ticks=1))


def _format_axes(ax: Axes, xlabel: str, ylabel: str) -> float:
    """Apply the format common to all axes; return the largest x drawn."""
    ax.set_xlabel(xlabel, fontsize=9)
    ax.set_ylabel(ylabel, fontsize=9)
    add_grid(ax)
    return max((float(np.max(line.get_xdata(), initial=0.0)) for line in ax.get_lines()), default=0.0)


def add_grid(ax: Axes) -> None:
    """Draw a grid behind everything else, and remove the frame."""
    ax.tick_params(labelsize=8)
    ax.spines[["top", "right"]].set_visible(False)
    ax.grid(color=THEME.faint, lw=0.6)
    ax.set_axisbelow(True)


def scale_values(ax: Axes, floor: float = 0.0) -> None:
    """Fit the vertical axis to the lines drawn; it is logarithmic for values of several orders of magnitude.

    On a logarithmic axis, a line leaves the picture at the bottom where its value is 0.

    Args:
        ax: the axes.
        floor: smaller values are rounding errors, and count as 0.
    """
    drawn = [np.asarray(line.get_ydata(), dtype=np.float64) for line in ax.get_lines()]
    values = np.concatenate([*drawn, np.zeros(0)])
    positive = values[values > floor]
    top = float(positive.max()) if len(positive) else 1.0
    if not len(positive) or np.log10(top / positive.min()) < FIGURE.log_decades:
        ax.set_yscale("linear")
        ax.set_ylim(-0.03 * top, 1.15 * top)
        return
    ax.set_yscale("log", nonpositive="clip")
    ax.yaxis.set_minor_formatter(NullFormatter())
    least = max(float(positive.min()), top * 10.0**-FIGURE.most_decades)
    ax.set_ylim(least / 1.8, top * max(1.8, (top / least) ** FIGURE.headroom))


def label_lengths(panels: Sequence[Axes], name: str) -> None:
    """Label vertical axes of lengths [m]: in millimetres below one metre, in metres from there on.

    Args:
        panels: axes that share a scale.
        name: the name of the lengths.
    """
    drawn = [np.asarray(line.get_ydata(), dtype=np.float64) for ax in panels for line in ax.get_lines()]
    largest = max(
        (float(np.abs(errors[np.isfinite(errors)]).max(initial=0.0)) for errors in drawn), default=0.0
    )
    small = round(largest, 3) < 1.0
    powers = LogFormatterMathtext()
    for ax in panels:
        ax.set_ylabel(f"{name} [{'mm' if small else 'm'}]", fontsize=9)
        if small and ax.get_yscale() == "log":
            ax.yaxis.set_major_formatter(lambda value, _: powers(1e3 * value))
        elif small:
            ax.yaxis.set_major_formatter(lambda value, _: f"{1e3 * value:.6g}")


def scale_counts(ax: Axes, largest: int) -> None:
    """Fit the vertical axis to whole numbers from 0 to `largest`."""
    ax.set_ylim(-0.04 * largest, 1.06 * largest)
    ax.yaxis.set_major_locator(MaxNLocator(nbins=5, integer=True, min_n_ticks=1))


VALUE = "value"
"""Group of the dots and texts that `mark_value` draws."""


def mark_value(ax: Axes, x: float, value: float, color: str, where: str, floor: float = 0.0) -> None:
    """Annotate the value [m] at the "start" or "end" of a line, or its "least" value.

    The last value is in the right margin (above the axis if below its range), the least above its point.
    `add_title` moves values apart that overlap, because only then everything has its place.
    """
    low, high = ax.get_ylim()
    below = value <= low  # a logarithmic axis cannot show 0
    at = (x, 0.0 if below else value)
    scale = ax.get_xaxis_transform() if below else ax.transData
    ax.plot(*at, marker="o", ms=4, color=color, clip_on=False, zorder=5, transform=scale, gid=VALUE)
    ax.set_ylim(low, high)
    styles = {"start": (7, 4, "left", "bottom"), "least": _beside(ax, at)}
    styles["end"] = (6, 4, "left", "bottom") if below else (6, 0, "left", "center")
    right, up, ha, va = styles[where]
    ax.annotate(
        BELOW_ROUNDING if abs(value) < floor else length_text(value),
        at,
        xycoords=scale,
        xytext=(right, up),
        textcoords="offset points",
        ha=ha,
        va=va,
        fontsize=8,
        color=color,
        bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 1.0},
        annotation_clip=False,
        gid=VALUE,
    )


def _beside(ax: Axes, at: tuple[float, float]) -> tuple[int, int, str, str]:
    """Return offset [pt] and alignment of a text above a point, or where it stays inside the axes."""
    along, high = ax.transAxes.inverted().transform(ax.transData.transform(at))
    up, va = (-8, "top") if high > 1.0 - FIGURE.edge else (8, "bottom")
    if along < FIGURE.edge:
        return 4, up, "left", va
    if along > 1.0 - FIGURE.edge:
        return -4, up, "right", va
    return 0, up, "center", va


def colors_along(count: int) -> tuple[LinearSegmentedColormap, Normalize]:
    """Return the colours of items numbered from base to tip, 1 to `count`."""
    return LinearSegmentedColormap.from_list("along the arm", THEME.along), Normalize(1, max(count, 2))


def add_colorbar(panels: Sequence[Axes], count: int, label: str, **options: Any) -> None:
    """Add a colour bar for `colors_along` beside panels."""
    colors, norm = colors_along(count)
    figure: Any = panels[0].figure
    bar = figure.colorbar(ScalarMappable(norm, colors), ax=panels, **options)
    bar.set_ticks(MaxNLocator(nbins=8, integer=True, min_n_ticks=1) if count > 1 else [1])
    bar.set_label(label, fontsize=9)
    bar.ax.tick_params(labelsize=8)
    bar.outline.set_visible(False)


def new_figure(arm: Arm, rows: int) -> tuple[Figure, Axes, list[Axes]]:
    """Return a figure, its axes for postures of an arm, and the panels beside them, from top to bottom."""
    size = FIGURE.width, FIGURE.height + max(0, rows - 3)
    figure = Figure(figsize=size, layout=ConstrainedLayoutEngine(w_pad=0.1, h_pad=0.09, wspace=0.04))
    room: dict[str, Any] = {"left": 0.01, "right": 0.97, "bottom": 0.08, "top": 0.88}  # before it is laid out
    grid = figure.add_gridspec(rows, 2, width_ratios=(1.75, 1.0), **room)
    postures = figure.add_subplot(grid[:, 0], projection="3d" if arm.dimension == 3 else None)
    return figure, postures, [figure.add_subplot(grid[row, 1]) for row in range(rows)]


def share_axis(panels: Sequence[Axes]) -> None:
    """Label only the horizontal axis of the last of several stacked panels."""
    for panel in panels[:-1]:
        panel.set_xlabel("")
        panel.tick_params(labelbottom=False)


def add_title(figure: Figure, sentences: Sequence[str]) -> None:
    """Write sentences above the panels, each on its own line, wrapped if long, and move values apart."""
    text = "\n".join(textwrap.fill(sentence, 145) for sentence in sentences)
    figure.suptitle(text, fontsize=10, x=0.012, ha="left", color=THEME.ink, parse_math=False)
    figure.draw_without_rendering()  # lays it out
    for ax in figure.axes:
        _move_values_apart(ax)


def _move_values_apart(ax: Axes) -> None:
    """Move each value up until it overlaps neither a dot nor a value before it."""
    taken = [dot.get_window_extent() for dot in ax.lines if dot.get_gid() == VALUE]
    for text in ax.texts:
        if text.get_gid() != VALUE:
            continue
        written = cast(Annotation, text)
        while written.get_window_extent().count_overlaps(taken):
            right, up = written.xyann
            written.xyann = right, up + 4
        taken.append(written.get_window_extent().padded(2.0))


def add_footnote(figure: Figure, *details: str) -> None:
    """Write details below the panels; empty ones are left out."""
    text = textwrap.fill(textwrap.shorten("; ".join(filter(None, details)), 500), 190)
    figure.supxlabel(text, fontsize=8, x=0.012, ha="left", color=THEME.quiet, parse_math=False)


def placement_text(run: Run | Trajectory) -> str:
    """Describe how curves were moved from their original placement; empty if none was moved."""
    if isinstance(run, Trajectory):
        placed = [waypoint for waypoint in run.waypoints if waypoint.moved]
        laps = ", lap [0-9]+$"
        moved = dict.fromkeys(f"{re.sub(laps, '', waypoint.name)} {waypoint.moved}" for waypoint in placed)
        return f"curves: {', '.join(moved)}" if moved else ""
    return f"curve {run.target.moved} to the base of the arm" if run.target.moved else ""


def controller_name(run: Run) -> str:
    """Return the name of the controller of a run, without its parameters."""
    named = re.match(r"<?(?:[\w<>]+\.)*(\w+)", run.controller)  # a repr, perhaps that of any object
    return named[1] if named else "The run"


def controller_text(run: Run) -> str:
    """Return the name of the controller of a run, and the parameters that are not at their defaults."""
    parameters = _parameters(run.controller)
    usual = registry.CONTROLLERS.get(parameters.get("name", "").strip("'"))
    changed = list(_differences(parameters, {} if usual is None else _parameters(repr(usual()))))
    defaults = "" if usual is None else " with default parameters"
    return controller_name(run) + (f" with {', '.join(changed)}" if changed else defaults)


def _parameters(text: str) -> dict[str, str]:
    """Return the fields in the repr of a dataclass, with functions as names; none of another repr."""
    text = re.sub(r"\bscene=Scene\(.*(?=, name=)", "scene=None", text)  # obstacles may have any name
    text = text.replace("<locals>.", "")
    named = re.sub(r"<(?:\w+ )?([\w.]+) [^<>]*>", r"\1", text)
    try:
        made = ast.parse(named, mode="eval").body
    except SyntaxError:
        return {}
    return {str(keyword.arg): ast.unparse(keyword.value) for keyword in getattr(made, "keywords", ())}


def _differences(parameters: Mapping[str, str], usual: Mapping[str, str]) -> Iterator[str]:
    for name, value in parameters.items():
        kind = value.partition("(")[0]
        default = usual.get(name, "")
        if name in ("name", "scene") or value == default:
            continue
        words = name.replace("_", " ")
        if kind and default.startswith(f"{kind}("):
            yield from (
                f"{words} {difference}"
                for difference in _differences(_parameters(value), _parameters(default))
            )
        else:
            classes = re.findall(r"(?:^\(?|\), )([A-Za-z_]\w*)\(", value)
            plain = value.strip("'")
            yield f"{words} {', '.join(classes) or plain}"


def limits_text(run: Run) -> str:
    """Return the limits of the steps of a run in words."""
    limits = run.limits
    slides = run.arm.slides[run.arm.columns]
    units = ["m"] * bool(slides.any()) + ["rad"] * (not slides.all())

    def most(value: float | NDArray[np.float64], per: str) -> str:
        low = float(np.min(value))
        high = float(np.max(value))
        text = f"{low:.3g}" if low == high else f"{low:.3g} to {high:.3g}"
        return f"{text} {' or '.join(unit + per for unit in units)}"

    parts = [] if limits.step is None else [f"{most(limits.step, '')} per step"]
    if limits.dt is not None:
        parts.append("speeds of the arm" if limits.velocity is None else most(limits.velocity, "/s"))
        rates = ((limits.acceleration, "/s²"), (limits.jerk, "/s³"))
        parts += [most(value, per) for value, per in rates if value is not None]
        parts.append(f"steps of {limits.dt:.3g} s")
    if limits.position_margin:
        parts.append(f"{most(limits.position_margin, '')} from the ends of the joints")
    return f"limits: {', '.join(parts) or 'joint positions only'}"


class WaypointMarkSettings(NamedTuple):
    """Which waypoints of a motion a figure names."""

    most: int = 8
    """Largest number of waypoints in a figure."""

    longest_name: int = 22
    """Length of the name of a waypoint, at most [characters]."""

    same_posture: float = 1e-4
    """Distance of control points below which postures look the same, in arm lengths."""


WAYPOINT_MARKS = WaypointMarkSettings()


class WaypointMark(NamedTuple):
    """A waypoint that a motion reached.

    Attributes:
        name: its name, shortened.
        row: row of the motion at which the arm reached it.
        color: pale for an early waypoint, dark for a late one.
    """

    name: str
    row: int
    color: str


def shown_waypoints(motion: Trajectory) -> list[WaypointMark]:
    """Return the waypoints that a motion reached, in order; at most `WAYPOINT_MARKS.most`, evenly spaced."""
    reached = [(waypoint.name, waypoint.row) for waypoint in motion.waypoints if waypoint.row is not None]
    if len(reached) > WAYPOINT_MARKS.most:
        shown = np.round(np.linspace(0, len(reached) - 1, WAYPOINT_MARKS.most)).astype(int)
        reached = [reached[k] for k in shown]
    shares = np.linspace(1.0, 0.0, len(reached))[::-1]  # a single waypoint counts as the last one
    colors = [in_time(float(share)) for share in shares]
    return [
        WaypointMark(_shorten(name), row, color) for (name, row), color in zip(reached, colors, strict=True)
    ]


def group_alike(motion: Trajectory, waypoints: Sequence[WaypointMark]) -> list[list[WaypointMark]]:
    """Group waypoints with the same posture, ordered by the first waypoint of each group."""
    points = motion.run.points
    tolerance = WAYPOINT_MARKS.same_posture * motion.arm.length
    groups: list[list[WaypointMark]] = []
    for waypoint in waypoints:
        for group in groups:
            if np.linalg.norm(points[waypoint.row] - points[group[0].row], axis=1).max() < tolerance:
                group.append(waypoint)
                break
        else:
            groups.append([waypoint])
    return groups


def _shorten(name: str) -> str:
    """Remove the middle of a long name: names may differ at either end."""
    name = " ".join(name.split())
    if len(name) <= WAYPOINT_MARKS.longest_name:
        return name
    return f"{name[: WAYPOINT_MARKS.longest_name - 11].rstrip()}...{name[-8:].lstrip()}"
