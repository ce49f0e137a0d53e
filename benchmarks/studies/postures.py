"""Arbitrary postures: who arrives from every kind of start at every kind of target, and on which path."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Annotated

import numpy as np

from benchmarks.baselines import named_controllers
from benchmarks.cases.families import (
    BUILT,
    UNIFORM,
    Family,
    Subject,
    built_subject,
    draw_case,
    loaded_subject,
)
from benchmarks.harness import (
    Case,
    Problem,
    Row,
    Study,
    check_study,
    count,
    distinct,
    grouped,
    largest,
    share,
    spread,
    summarise,
)
from benchmarks.pictures import PATH, draw_paths, dress, new_figure, present
from benchmarks.report import (
    ArmsOption,
    ControllersOption,
    Report,
    SeedOption,
    StudyOptions,
    Table,
    percent,
    split_names,
    spread_cell,
    table,
)
from benchmarks.studies.runs import arrived, lawful, measure_controller, near, telling
from pinposture.cli.inputs import ARM, MOST_RUNS, MOTION, OUTPUT, ArmOptions
from pinposture.cli.output import examples
from pinposture.control import Controller
from pinposture.errors import InvalidValue

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COMPARED = ("geodesic", "selection", "projection", "switching", "lm", "joint")
"""Controllers compared by default."""

CASES_OF_A_KIND = 1000
"""Default number of cases for each arm."""


def study_postures(
    subjects: Sequence[Subject],
    controllers: Sequence[str | Controller] = COMPARED,
    cases: int = CASES_OF_A_KIND,
    first_seed: int = 0,
) -> Study:
    """Run all controllers from every kind of start to every kind of target.

    Cases cycle through the families of an arm with increasing seeds, so that a longer study begins with the
    cases of a shorter one, and the numbers of cases per family differ by at most one. A case depends only on
    arm, family and seed, so all controllers get the same ones.

    Args:
        subjects: the arms; see `built_subject` and `loaded_subject`.
        controllers: controllers or their names.
        cases: number of cases for each arm.
        first_seed: seed of the first case of each family.

    Raises:
        InvalidValue: no arm, no controller, or invalid numbers.
        UnknownName: no controller has that name.
    """
    check_study(first_seed, cases=cases, subjects=subjects)
    dealt = [
        _case(subject, subject.families[place], first_seed + rounds)
        for subject in subjects
        for rounds, place in (divmod(number, len(subject.families)) for number in range(cases))
    ]
    return Study(dealt, named_controllers(controllers), measure_controller)


def _case(subject: Subject, family: Family, seed: int) -> Case:
    labels = {"arm": subject.name, "start": family.start, "target": family.target, "seed": seed}
    return Case(labels, partial(_draw, subject, family, seed))


def _draw(subject: Subject, family: Family, seed: int) -> Problem:
    return Problem(subject.arm, *draw_case(subject, family, seed))


GROUPS = ("smooth", "harsh", "straight and noise", "folds")


def group_of(row: Row) -> str:
    """Return the group of a run: "folds" if the target is folded, else by its start."""
    if row.target == "folded":
        return "folds"
    if row.start == "smooth":
        return "smooth"
    return "harsh" if row.start in UNIFORM else "straight and noise"


def family_of(row: Row) -> str:
    """Return the family of a run, in words."""
    return f"{row.start} -> {row.target}"


def by_group(rows: Sequence[Row], families: bool = False) -> list[Row]:
    """Summarise runs by arm, group and controller, or by family instead of `GROUPS`.

    Returns:
        One row for each controller in each group of each arm; arms, controllers and families in order of
        first appearance, groups in the order of `GROUPS`. It has the number of runs; the shares that arrived
        and came near; the number that the controller refused; the spreads of `measure_run` over the runs
        that moved and came near, None if there are none; the largest violation and stride; and whether all
        runs stayed within their limits.
    """
    named = [row.but(group=family_of(row) if families else group_of(row)) for row in rows]
    arms = distinct(row.arm for row in named)
    groups = distinct(row.group for row in named) if families else GROUPS
    named.sort(key=lambda row: (arms.index(row.arm), groups.index(row.group)))
    spreads = ("steps", "rising", "escaping", "peak", "path", "seconds")
    return summarise(
        named,
        ["arm", "group", "controller"],
        runs=len,
        arrived=share(arrived),
        near=share(near),
        refused=count(lambda row: row.status == "refused"),
        **{name: spread(name, telling) for name in spreads},
        violation=largest("violation"),
        stride=largest("stride"),
    )


_COLUMNS = {
    "runs": lambda row: row.runs,
    "controller": lambda row: row.controller,
    "< 1e-6": percent("arrived"),
    "< 1e-3": percent("near"),
    "steps": spread_cell("steps", ".0f"),
    "rising": spread_cell("rising", ".1%"),
    "escaping": spread_cell("escaping", ".1%"),
    "peak": spread_cell("peak", ".2f"),
    "path": spread_cell("path", ".2f"),
    "limits held": lambda row: "yes" if lawful(row) else "no",
}


@examples(
    "make study STUDY=postures -- --cases 38 --arms ryrz20",
    "make study STUDY=postures -- --controllers switching,lm --families --jobs 2",
    "make study STUDY=postures -- --urdf arm.urdf --cases 20 --json",
    "make study STUDY=postures -- --jobs -1 -o out/postures",
)
def run(
    *,
    arms: ArmsOption = None,
    urdf: Annotated[str | None, ARM("URDF file of another arm, or -.", "FILE")] = None,
    arm_options: ArmOptions,
    controllers: ControllersOption = None,
    cases: Annotated[int, MOTION("Number of cases for each arm.", "N", max=MOST_RUNS)] = 1000,
    seed0: SeedOption = 0,
    families: Annotated[bool, OUTPUT("A row for each family.", flags="--families")] = False,
    options: StudyOptions,
) -> None:
    """Drive arms from every kind of start to every kind of target, and compare how controllers reach them.

    The arms are 20 RyRz modules, 1 m, and 45 joints in a plane with a control point at every second. Starts
    are smooth, harsh (each joint independently within 0.6 or 1.5 rad), straight, or 1e-3 off straight;
    targets are the helix and the line of the thesis, the straight arm folded back on itself, and random
    postures. Loaded arms go to a gentle curve and random postures. At most 400 steps of 0.1 rad per joint.

    The first two columns are the shares of runs with a final mean point error below 1e-6 and 1e-3 of the arm
    length. The others cover the runs that moved and came below 1e-3: median (90th percentile) of the number
    of steps, the share of steps in which the posture error rises, the share in which the controller allows
    it to rise, the highest posture error relative to the first, and the path length of the control points
    relative to straight lines. 1000 cases with six controllers take five minutes per arm on two processes.
    """
    if urdf is None:
        arm_options.refuse("only together with --urdf")
        subjects = [built_subject(name) for name in split_names("--arms", arms, BUILT)]
    elif arms is not None:
        raise InvalidValue("--arms", arms, "nothing if --urdf is given")
    else:
        subjects = [loaded_subject(arm_options.read(urdf))]
    names = split_names("--controllers", controllers, COMPARED)
    rows = options.run(study_postures(subjects, names, cases, seed0))
    summary = by_group(rows, families)
    asked = {"study": "postures", "cases": cases, "seed0": seed0, "controllers": names}
    options.write(
        Report(
            rows,
            {**asked, "rows": summary},
            [_table(arm, own) for arm, own in grouped(summary, lambda row: row.arm).items()],
            {"postures": draw_postures},
            warnings=refusals(rows),
        )
    )


def _table(arm: str, rows: Sequence[Row]) -> Table:
    """Return the table of an arm, in which each group is named once."""
    headings, lines = table(_COLUMNS, rows)
    before = ["", *(row.group for row in rows)]
    named = ["" if row.group == last else row.group for row, last in zip(rows, before, strict=False)]
    return (arm, *headings), [(name, *line) for name, line in zip(named, lines, strict=True)]


def refusals(rows: Sequence[Row]) -> list[str]:
    """Name controllers that refused to start, with the count and the first reason."""
    refused = (row for row in rows if row.status == "refused")
    return [
        f"{controller} refused {len(own)} of its runs: {own[0].reason}"
        for controller, own in grouped(refused, lambda row: row.controller).items()
    ]


def draw_postures(rows: Sequence[Row]) -> Figure:
    """Draw the results of `study_postures`.

    A row for each arm: on the left the share of runs of each family that end within 1e-6 of the arm length,
    on the right the path lengths of the control points in runs that moved and came near. Boxes reach from the
    first to the third quartile, whiskers from the 10th to the 90th percentile.

    Raises:
        InvalidValue: no run.
    """
    arms, controllers = present(rows)
    summary = by_group(rows, families=True)
    families = [len({row.group for row in summary if row.arm == arm}) for arm in arms]
    figure = new_figure(1.0 + sum(0.26 * count + 1.3 for count in families), rows)
    grid = figure.add_gridspec(len(arms), 2, width_ratios=(1.0, 1.3), height_ratios=[n + 4 for n in families])
    for i, arm in enumerate(arms):
        shares = {(row.group, row.controller): row.arrived for row in summary if row.arm == arm}
        _draw_shares(figure.add_subplot(grid[i, 0]), shares, controllers, f"{arm}: share that arrives")
        ax = figure.add_subplot(grid[i, 1])
        draw_paths(ax, [row for row in rows if row.arm == arm], GROUPS, group_of, controllers)
        dress(ax, f"{arm}: directness, runs that came near", PATH)
    return figure


def _draw_shares(
    ax: Axes, shares: Mapping[tuple[str, str], float], controllers: Sequence[str], title: str
) -> None:
    """Draw a cell for each family and controller, with the share in percent."""
    from pinposture.viz.palette import THEME

    families = distinct(family for family, _ in shares)
    values = np.array([[shares.get((name, each), np.nan) for each in controllers] for name in families])
    ax.imshow(np.ma.masked_invalid(values), cmap="Blues", vmin=0.0, vmax=1.0, aspect="auto")
    for (row, column), value in np.ndenumerate(values):
        if np.isfinite(value):
            ink = "white" if value > 0.6 else THEME.ink
            # Rounded down, so that 100 means all.
            ax.text(
                column, row, f"{int(100.0 * value + 1e-9)}", ha="center", va="center", fontsize=7, color=ink
            )
    ax.set_xticks(range(len(controllers)), controllers)
    ax.set_yticks(range(len(families)), families)
    ax.tick_params(labelsize=7, length=0)
    ax.spines[:].set_visible(False)
    ax.set_title(f"{title} [%]", fontsize=9, color=THEME.ink)
