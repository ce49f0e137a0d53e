"""Follow the leader: deviation of an arm from the path of its tip, against the path's curvature."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import numpy as np

from benchmarks.harness import Case, Row, Study, grouped
from benchmarks.pictures import new_figure
from benchmarks.report import Report, StudyOptions, split_names
from pinposture._validation import is_number, require_known
from pinposture.arm import Arm, JointSpec, ModuleTemplate, template
from pinposture.cli.inputs import ARM, MOTION, read_numbers
from pinposture.cli.output import examples
from pinposture.curve import Curve
from pinposture.errors import InvalidValue, TargetError
from pinposture.task.follow_leader import PATH_METHODS, Method, follow_leader, path_deviation

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MODULE, MODULES = 0.05, 20
"""Length of a module [m], and number of modules of an arm."""

FEED = ModuleTemplate("Feed", (JointSpec("x", "prismatic", 0.0, 1.2, velocity=0.1),), (MODULE,))

ARMS: Mapping[str, ModuleTemplate] = MappingProxyType(
    {
        "ryrz": template("RyRz"),
        "universal": template("RyRz").with_lengths((0.0, MODULE)),
        "hinge": template("Rz").with_lengths((MODULE,)),
    }
)
"""Modules of the arms: two crossed hinges half a module apart, two coincident ones, a single one (planar)."""

SHAPES = ("arc", "helix")
"""An arc of up to three quarters of a turn; and, for spatial arms, a helix with torsion = curvature / 2."""

BENDINGS = (0.05, 0.1, 0.2, 0.3, 0.5, 0.7, 1.0, 1.4)
"""Curvature times module length, kappa l [rad]: the turn of the path along a module."""

SHARE = 0.9
"""Largest length of a path relative to the arm, so that the first joint stays on the straight entry."""

FEED_STEP = 0.1
"""Feed between successive postures, in module lengths."""


def fed_arm(name: str) -> Arm:
    """Build one of `ARMS`, 1 m long, on a feed; raises UnknownName if there is no such arm."""
    require_known("arm", name, ARMS)
    return Arm.from_modules([FEED, *[ARMS[name]] * MODULES], name=name)


def bent_path(shape: str, curvature: float) -> Curve:
    """Return a path of constant curvature [1/m], nearly as long as the arm; arcs turn by at most 270 degrees.

    Raises:
        UnknownName: there is no such shape.
    """
    require_known("shape", shape, SHAPES)
    torsion = 0.5 * curvature if shape == "helix" else 0.0
    twist = float(np.hypot(curvature, torsion))  # angle about the axis by arc length [rad/m]
    radius, pitch = curvature / twist**2, 2.0 * np.pi * torsion / twist**2
    turns = SHARE * MODULE * MODULES * twist / (2.0 * np.pi)
    if shape == "arc":
        return Curve.helix(radius, 0.0, min(turns, 0.75), axis=(0, 0, 1))
    return Curve.helix(radius, pitch, turns)


def study_leader(
    arms: Sequence[str] = tuple(ARMS),
    bendings: Sequence[float] = BENDINGS,
    methods: Sequence[Method] = PATH_METHODS,
) -> Study:
    """Feed arms along paths of constant curvature and measure their deviation.

    Paths begin to bend at the entry, so that the arm lies on a straight line and an arc at every depth.
    Planar arms have arcs only.

    Args:
        arms: names of arms, some of `ARMS`.
        bendings: curvature times module length, each above 0, at most pi / 2 [rad].
        methods: how modules are placed, see `follow_leader`.

    Raises:
        InvalidValue: a bending out of range.
        UnknownName: no such arm or method.
    """
    for bending in bendings:
        if not (is_number(bending) and 0.0 < bending <= np.pi / 2.0):
            raise InvalidValue("bending", bending, "above 0, at most pi / 2 [rad]")
    for method in methods:
        require_known("method", method, PATH_METHODS)
    cases = [
        Case({"arm": name, "shape": shape, "bending": float(bending)}, partial(Path, name, shape, bending))
        for name in arms
        for shape in (SHAPES if fed_arm(name).dimension == 3 else SHAPES[:1])
        for bending in bendings
    ]
    return Study(cases, methods, measure_path)


class Path(NamedTuple):
    """A path of constant curvature for an arm: names of arm and shape, curvature times module length."""

    arm: str
    shape: str
    bending: float


def measure_path(path: Path, method: Method) -> Row:
    """Feed an arm along a path, and measure its deviation.

    Returns:
        method: how its modules were placed, as in `follow_leader`.
        points: largest distance of a control point from the path [% of the arm length]; None if refused.
        body: largest distance of any part of the arm from the path [% of the arm length]; None if refused.
        sagitta: distance of the midpoint of a straight module from an arc through its ends [% of arm length].
        joints: largest joint position [rad]; None if refused.
        refused: why the path cannot be followed, or empty.
    """
    arm, curve = fed_arm(path.arm), bent_path(path.shape, path.bending / MODULE)
    length, radius = MODULE * MODULES, MODULE / path.bending
    rise = 100.0 * float(radius - np.sqrt(radius**2 - 0.25 * MODULE**2)) / length
    row = Row(method=method, points=None, body=None, sagitta=rise, joints=None, refused="")
    try:
        reference = follow_leader(arm, curve, FEED_STEP * MODULE, 1.0, method=method)
    except TargetError as error:
        return row.but(refused=str(error))
    q = np.array([reference.configuration(number) for number in range(reference.rows)])
    deviation = path_deviation(arm, q, curve)
    joints = float(np.abs(reference.offsets[:, 1:]).max())
    return row.but(points=deviation.percent_points, body=deviation.percent, joints=joints)


@examples(
    "make study STUDY=leader -- --arms ryrz --bendings 0.1,0.2,0.5",
    "make study STUDY=leader -- --json",
    "make study STUDY=leader -- --jobs -1 -o out/leader",
)
def run(
    *,
    arms: Annotated[str | None, ARM("Arms: ryrz, universal, hinge.", "NAME,...")] = None,
    bendings: Annotated[str | None, MOTION("Curvature times module length of the paths.", "RAD,...")] = None,
    options: StudyOptions,
) -> None:
    """Push arms on a feed along paths of constant curvature, and report their distance from the path.

    The arms are 1 m long, with 20 modules: two crossed hinges half a module apart (ryrz), two in one place
    (universal), or a single one (hinge, which stays in its plane). The paths are arcs of up to three quarters
    of a turn, and helices whose torsion is half their curvature; they begin to bend at the entry. Modules
    are placed closest to the path, the whole arm by least squares, or in sequential order as in Algorithm 1.
    Numbers are in percent of the arm length: the largest distance of any part of the arm from the path in any
    posture, then that of the control points. The sagitta is the distance of the middle of a straight module
    from an arc that passes through both its ends.
    """
    names = split_names("--arms", arms, ARMS)
    bent = list(BENDINGS) if bendings is None else read_numbers("--bendings", bendings)
    rows = options.run(study_leader(names, bent), "path")

    def cell(row: Row) -> str:
        return "-" if row.body is None else f"{row.body:.3f}, points {row.points:.3f}"

    lines = grouped(rows, lambda row: (row.arm, row.shape, row.method))
    sagitta = {row.bending: f"{row.sagitta:.3f}" for row in rows}
    cells = [(*line, *map(cell, own)) for line, own in lines.items()]
    cells.append(("", "", "sagitta", *sagitta.values()))
    options.write(
        Report(
            rows,
            {"study": "leader", "arms": names, "bendings": bent, "runs": rows},
            [(("arm", "path", "placed", *(f"{bending:g} rad" for bending in bent)), cells)],
            {"leader": draw_leader},
            warnings=[
                f"{row.arm}, {row.shape}, {row.method}, {row.bending:g} rad: {row.refused}"
                for row in rows
                if row.refused
            ],
        )
    )


LEADER_HEIGHT = 4.6
"""Height of a figure [inch]."""

TICKS = (0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0)
"""Ticks of the axis of deviations [%]."""

MARKERS = {"closest": "o", "sequential": "^"}


def draw_leader(found: Sequence[Row]) -> Figure:
    """Draw the results of `study_leader`.

    A panel for each shape of path: the largest distance of any part of the arm against curvature times module
    length, and the sagitta of a module whose ends are on the path. Refused paths are skipped.

    Raises:
        InvalidValue: no result.
    """
    if not found:
        raise InvalidValue("found", list(found), "at least one result")
    figure = new_figure(LEADER_HEIGHT)
    shapes = [shape for shape in SHAPES if any(each.shape == shape for each in found)]
    panels = figure.subplots(1, len(shapes), sharey=True, squeeze=False)[0]
    for ax, shape in zip(panels, shapes, strict=True):
        _draw(ax, [each for each in found if each.shape == shape], shape)
    panels[0].set_ylabel("farthest part of the arm [% of its length]", fontsize=9)
    return figure


def _draw(ax: Axes, found: Sequence[Row], shape: str) -> None:
    from pinposture.viz import palette
    from pinposture.viz.palette import THEME

    inks = (THEME.start, THEME.final, THEME.controllers["projection"])
    colors = dict(zip(ARMS, inks, strict=True))
    bound = sorted({(each.bending, each.sagitta) for each in found})
    ax.plot(*zip(*bound, strict=True), color=THEME.rest, ls="--", lw=1.0, label="sagitta of a module")
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
    ax.set_title(shape, fontsize=10, color=THEME.ink)
    palette.add_grid(ax)
    ax.legend(fontsize=7, frameon=False, loc="upper left")
