"""Figures of the studies."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from benchmarks.studies.leader import ARMS, SHAPES, Following
from benchmarks.studies.postures import BINS, bin_of, by_heading
from benchmarks.studies.record import GROUPS, MAX_STEPS, STEP, Record, distinct, group_of, summarise, telling
from pinposture.errors import InvalidValue

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from pinposture.motion import Trajectory


WIDTH = 12.0
"""Width of a figure [inch]; 1200 pixels at the default resolution."""
PATH = "path of the control points / direct distance"


def draw_postures(records: Sequence[Record]) -> Figure:
    """Draw the results of `study_postures`.

    A row for each arm: on the left the share of runs of each family that end within 1e-6 of the arm length,
    on the right the path lengths of the control points in runs that moved and came near. Boxes reach from the
    first to the third quartile, whiskers from the 10th to the 90th percentile.

    Raises:
        InvalidValue: no run.
    """
    arms, controllers = _present(records)
    rows = summarise(records, families=True)
    families = [len({row.group for row in rows if row.arm == arm}) for arm in arms]
    figure = _figure(1.0 + sum(0.26 * count + 1.3 for count in families), records)
    grid = figure.add_gridspec(len(arms), 2, width_ratios=(1.0, 1.3), height_ratios=[n + 4 for n in families])
    for i, arm in enumerate(arms):
        shares = {(row.group, row.controller): row.arrived for row in rows if row.arm == arm}
        _draw_shares(figure.add_subplot(grid[i, 0]), shares, controllers, f"{arm}: share that arrives")
        ax = figure.add_subplot(grid[i, 1])
        _draw_paths(ax, [each for each in records if each.arm == arm], GROUPS, group_of, controllers)
        _dress(ax, f"{arm}: directness, runs that came near", PATH)
    return figure


def draw_headings(records: Sequence[Record]) -> Figure:
    """Draw the results of `study_headings`.

    A row for each arm, both panels against the largest change of heading: the share of runs that end near the
    target within the limits, and the path lengths of the control points, as in `draw_postures`. Runs with
    unknown `turn` are skipped.

    Raises:
        InvalidValue: no run.
    """
    known = [record for record in records if record.turn is not None]
    arms, controllers = _present(known)
    bins = {(each.arm, each.bin, each.controller): each for each in by_heading(known)}
    figure = _figure(0.8 + 3.6 * len(arms), known)
    grid = figure.add_gridspec(len(arms), 2)
    for i, arm in enumerate(arms):
        ax = figure.add_subplot(grid[i, 0])
        for controller, color, offset, width in _side_by_side(controllers):
            found = [bins[arm, name, controller] for name in BINS if (arm, name, controller) in bins]
            places = np.arange(len(found)) + offset
            # A share of zero would be invisible.
            shares = [max(each.reached / each.runs, 0.008) if each.runs else 0.0 for each in found]
            ax.bar(places, shares, 0.9 * width, color=color, label=controller)
        ax.set_xticks(range(len(BINS)), BINS)
        ax.set_ylim(0.0, 1.2)  # room for the legend
        ax.set_yticks([0.0, 0.2, 0.4, 0.6, 0.8, 1.0])
        ax.set_xlabel("largest change of heading [rad]", fontsize=9)
        _dress(ax, f"{arm}: near the target, within the limits", "share of runs")
        ax = figure.add_subplot(grid[i, 1])
        own = [run for run in known if run.arm == arm]
        _draw_paths(ax, own, BINS, lambda run: bin_of(run.turn or 0.0), controllers)
        ax.set_xlabel("largest change of heading [rad]", fontsize=9)
        _dress(ax, f"{arm}: directness, runs that came near", PATH)
    return figure


def _present(records: Sequence[Record]) -> tuple[list[str], list[str]]:
    """Return the names of the arms and of the controllers."""
    if not records:
        raise InvalidValue("records", list(records), "at least one run")
    return distinct(each.arm for each in records), distinct(each.controller for each in records)


def _figure(height: float, runs: Sequence[Record] = ()) -> Figure:
    """Create a figure of a height [inch], with the number of runs as its title."""
    # Imported here because matplotlib is slow to import.
    from matplotlib.figure import Figure
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    from pinposture.viz.palette import add_title

    figure = Figure(figsize=(WIDTH, height), layout=ConstrainedLayoutEngine(w_pad=0.1, h_pad=0.09))
    if runs:
        add_title(figure, [f"{len(runs)} runs, |dq| <= {STEP:g} rad per step, at most {MAX_STEPS} steps"])
    return figure


def _side_by_side(controllers: Sequence[str]) -> list[tuple[str, str, float, float]]:
    """Return each controller with its colour, its horizontal offset and its width."""
    from pinposture.viz.palette import distinct_colors

    width = 0.8 / len(controllers)
    places = (np.arange(len(controllers)) - (len(controllers) - 1) / 2.0) * width
    return [
        (name, color, float(place), width)
        for name, color, place in zip(controllers, distinct_colors(controllers), places, strict=True)
    ]


def _draw_shares(
    ax: Axes, shares: Mapping[tuple[str, str], float], controllers: Sequence[str], title: str
) -> None:
    """Draw a cell for each family and controller, with the share in percent."""
    from pinposture.viz import palette

    families = distinct(family for family, _ in shares)
    values = np.array([[shares.get((name, each), np.nan) for each in controllers] for name in families])
    ax.imshow(np.ma.masked_invalid(values), cmap="Blues", vmin=0.0, vmax=1.0, aspect="auto")
    for (row, column), value in np.ndenumerate(values):
        if np.isfinite(value):
            ink = "white" if value > 0.6 else palette.INK
            # Rounded down, so that 100 means all.
            ax.text(
                column, row, f"{int(100.0 * value + 1e-9)}", ha="center", va="center", fontsize=7, color=ink
            )
    ax.set_xticks(range(len(controllers)), controllers)
    ax.set_yticks(range(len(families)), families)
    ax.tick_params(labelsize=7, length=0)
    ax.spines[:].set_visible(False)
    ax.set_title(f"{title} [%]", fontsize=9, color=palette.INK)


def _draw_paths(
    ax: Axes,
    records: Sequence[Record],
    groups: Sequence[str],
    name: Callable[[Record], str],
    controllers: Sequence[str],
) -> None:
    """Draw boxes of the path length ratios of each controller, side by side in each group."""
    for controller, color, offset, width in _side_by_side(controllers):
        drawn: dict[int, list[float]] = {}
        for record in telling(each for each in records if each.controller == controller):
            drawn.setdefault(groups.index(name(record)), []).append(record.path)
        style: dict[str, Any] = {"color": color, "linewidth": 1.2}
        if drawn:
            ax.boxplot(
                list(drawn.values()),
                positions=[place + offset for place in drawn],
                widths=0.75 * width,
                whis=(10, 90),
                showfliers=False,
                patch_artist=True,
                boxprops={"facecolor": "white", "edgecolor": color, "linewidth": 1.2},
                medianprops={"color": color, "linewidth": 2.2},
                whiskerprops=style,
                capprops=style,
                manage_ticks=False,
            )
        ax.plot([], [], color=color, lw=4, label=controller)
    ax.set_xticks(range(len(groups)), groups)
    ax.set_xlim(-0.5, len(groups) - 0.5)
    ax.set_yscale("log")
    _plain_numbers(ax)


def _plain_numbers(ax: Axes) -> None:
    """Set plain-number ticks on a short logarithmic axis that begins at 1."""
    from matplotlib.ticker import FixedLocator, FormatStrFormatter, NullFormatter, NullLocator

    top = max(1.5, 1.05 * ax.get_ylim()[1])
    ax.set_ylim(0.97, top)
    ax.yaxis.set_major_locator(FixedLocator([t for t in (1, 1.2, 1.5, 2, 3, 5, 10, 20, 50, 100) if t <= top]))
    ax.yaxis.set_major_formatter(FormatStrFormatter("%g"))
    ax.yaxis.set_minor_locator(NullLocator())
    ax.yaxis.set_minor_formatter(NullFormatter())


def _dress(ax: Axes, title: str, label: str) -> None:
    from pinposture.viz import palette

    ax.set_title(title, fontsize=9, color=palette.INK)
    ax.set_ylabel(label, fontsize=9)
    palette.add_grid(ax)
    ax.grid(visible=False, axis="x")
    ax.legend(fontsize=7, frameon=False, ncols=3, loc="upper left")


LEADER_HEIGHT = 4.6
"""Height of a figure [inch]."""

TICKS = (0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0)
"""Ticks of the axis of deviations [%]."""

MARKERS = {"closest": "o", "sequential": "^"}


def draw_leader(found: Sequence[Following]) -> Figure:
    """Draw the results of `study_leader`.

    A panel for each shape of path: the largest distance of any part of the arm against curvature times module
    length, and the sagitta of a module whose ends are on the path. Refused paths are skipped.

    Raises:
        InvalidValue: no result.
    """
    if not found:
        raise InvalidValue("found", list(found), "at least one result")
    figure = _figure(LEADER_HEIGHT)
    shapes = [shape for shape in SHAPES if any(each.shape == shape for each in found)]
    panels = figure.subplots(1, len(shapes), sharey=True, squeeze=False)[0]
    for ax, shape in zip(panels, shapes, strict=True):
        _draw(ax, [each for each in found if each.shape == shape], shape)
    panels[0].set_ylabel("farthest part of the arm [% of its length]", fontsize=9)
    return figure


def _draw(ax: Axes, found: Sequence[Following], shape: str) -> None:
    from pinposture.viz import palette

    inks = (palette.START, palette.FINAL, palette.CONTROLLER_COLORS["projection"])
    colors = dict(zip(ARMS, inks, strict=True))
    bound = sorted({(each.bending, each.sagitta) for each in found})
    ax.plot(*zip(*bound, strict=True), color=palette.REST, ls="--", lw=1.0, label="sagitta of a module")
    for arm, method in dict.fromkeys((each.arm, each.method) for each in found):
        own = [each for each in found if (each.arm, each.method) == (arm, method)]
        values = [(each.bending, each.body) for each in own if each.body is not None]
        if values:
            line = "-" if method == "closest" else ":"
            style: dict[str, Any] = {"color": colors[arm], "ls": line, "marker": MARKERS[method]}
            ax.plot(*zip(*values, strict=True), ms=4.0, lw=1.3, label=f"{arm}, {method}", **style)
    ax.set_xscale("log")
    ax.set_yscale("log")
    ticks = sorted({each.bending for each in found})
    ax.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
    ax.set_yticks(TICKS, [f"{tick:g}" for tick in TICKS])
    ax.minorticks_off()
    ax.set_xlabel("curvature times module length [rad]", fontsize=9)
    ax.set_title(shape, fontsize=10, color=palette.INK)
    palette.add_grid(ax)
    ax.legend(fontsize=7, frameon=False, loc="upper left")


def draw_clutter(runs: Mapping[str, Trajectory]) -> Figure:
    """Draw a run for each kind of clutter: start, goal and postures between them."""
    from matplotlib.figure import Figure

    from pinposture.viz.postures import plot_postures

    columns = min(3, len(runs))
    rows = -(-len(runs) // columns)
    height = 2.7 * rows + 0.7
    figure = Figure(figsize=(2.9 * columns, height))
    figure.subplots_adjust(0.0, 0.7 / height, 1.0, 0.97, 0.0, 0.05)
    entries: dict[str, Any] = {}
    for number, (kind, run) in enumerate(runs.items()):
        ax = figure.add_subplot(rows, columns, number + 1, projection="3d")
        plot_postures(run, ax)
        labelled = zip(*ax.get_legend_handles_labels(), strict=True)
        entries |= {label: each for each, label in labelled if not label.startswith("obstacle")}
        ax.get_legend().remove()
        ax.set_axis_off()
        ax.set_title(kind, y=0.95)
    figure.legend(entries.values(), entries.keys(), loc="lower center", ncols=3, frameon=False)
    return figure
