"""The change of heading: who gets there, by how far the parts of the arm must turn."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING, Annotated

import numpy as np
from numpy.typing import NDArray

from benchmarks.baselines import named_controllers
from benchmarks.cases.families import BUILT, Subject, built_subject
from benchmarks.cases.scenarios import curve_along
from benchmarks.harness import Case, Problem, Row, Study, check_study, grouped, spread
from benchmarks.pictures import PATH, draw_paths, dress, new_figure, present, side_by_side
from benchmarks.report import ArmsOption, ControllersOption, Report, SeedOption, StudyOptions, split_names
from benchmarks.studies.postures import COMPARED, refusals
from benchmarks.studies.runs import lawful, measure_controller, near, telling
from pinposture._validation import require_known
from pinposture.arm import Arm, bent_configuration, smooth_configuration
from pinposture.cli.inputs import MOST_RUNS, MOTION
from pinposture.cli.output import examples
from pinposture.control import Controller
from pinposture.placement import Target, resolve_targets

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

KNOWLEDGE = ("configuration", "curve")

PAIRS = 300
"""Default number of pairs for each arm."""

HEADING = 4.2
"""Upper bound of the largest heading of a link in a posture of a planar arm [rad]."""
BENDING = 0.6
"""Upper bound of the largest joint position in a posture of a spatial arm [rad or m]."""

EDGES = (0.0, 2.0, np.pi, 4.0, 6.0, np.inf)
BINS = ("< 2", "2 - pi", "pi - 4", "4 - 6", "> 6")
"""Bins of the largest change of heading [rad], from each of `EDGES` up to but excluding the next."""


def study_headings(
    subjects: Sequence[Subject],
    controllers: Sequence[str | Controller] = COMPARED,
    pairs: int = PAIRS,
    first_seed: int = 0,
    knowledge: str = "configuration",
) -> Study:
    """Run controllers between random pairs of smooth postures with any change of heading.

    Args:
        subjects: the arms; see `built_subject`.
        controllers: controllers or their names.
        pairs: number of pairs for each arm.
        first_seed: seed of the first pair.
        knowledge: what is known of the target, the column "target": its "configuration", or only the "curve"
            through the base and its control points, on which `resolve_targets` places the arm.

    Raises:
        InvalidValue: no arm, no controller, or invalid numbers.
        UnknownName: no such controller or knowledge.
    """
    check_study(first_seed, pairs=pairs, subjects=subjects)
    require_known("knowledge of the target", knowledge, KNOWLEDGE)
    cases = [
        Case(
            {"arm": subject.name, "start": "bent", "target": knowledge, "seed": seed},
            partial(_draw, subject.arm, seed, knowledge),
        )
        for subject in subjects
        for seed in range(first_seed, first_seed + pairs)
    ]
    return Study(cases, named_controllers(controllers), measure_controller)


def _draw(arm: Arm, seed: int, knowledge: str) -> Problem:
    start, goal = draw_pair(arm, seed)
    if knowledge == "configuration":
        return Problem(arm, start, Target.from_configuration(arm, goal))
    return Problem(arm, start, resolve_targets(arm, curve_along(arm, goal), placement="as_is"))


def draw_pair(arm: Arm, seed: int) -> tuple[Array, Array]:
    """Draw two smooth configurations (nq,), each bent by a random amount so that all bins are populated.

    The largest heading of a link of a planar arm is uniform up to `HEADING`, the largest joint position of a
    spatial arm up to `BENDING`.
    """
    rng = np.random.default_rng(seed)
    if arm.dimension == 2:
        start, goal = (bent_configuration(arm, rng, rng.uniform(0.0, HEADING)) for _ in range(2))
    else:
        start, goal = (smooth_configuration(arm, rng, rng.uniform(0.0, BENDING)) for _ in range(2))
    return start, goal


def bin_of(turn: float) -> str:
    """Return the bin of a change of heading [rad]."""
    return BINS[int(np.searchsorted(EDGES, turn, side="right")) - 1]


def by_heading(rows: Sequence[Row]) -> list[Row]:
    """Count runs with known `turn` by their change of heading.

    Returns:
        One row for each arm, controller and bin, in order of first appearance of arms and controllers; empty
        bins are included. It has the number of runs; the number that reached the target, ending below 1e-3
        of the arm length, and never left the limits; and the spreads of steps and path over the runs that
        moved and came near, None if none did.
    """
    found = []
    for (arm, controller), own in grouped(rows, lambda row: (row.arm, row.controller)).items():
        for name in BINS:
            runs = [row for row in own if row.turn is not None and bin_of(row.turn) == name]
            found.append(
                Row(
                    arm=arm,
                    bin=name,
                    controller=controller,
                    runs=len(runs),
                    reached=sum(near(row) and lawful(row) for row in runs),
                    steps=spread("steps", telling)(runs),
                    path=spread("path", telling)(runs),
                )
            )
    return found


@examples(
    "make study STUDY=headings -- --pairs 50 --arms planar45",
    "make study STUDY=headings -- --controllers switching,lm --target curve",
    "make study STUDY=headings -- --pairs 20 --json",
    "make study STUDY=headings -- --jobs -1 -o out/headings",
)
def run(
    *,
    arms: ArmsOption = None,
    controllers: ControllersOption = None,
    target: Annotated[
        str,
        MOTION("Definition of the target: its configuration, or the curve through its points.", "KIND"),
    ] = "configuration",
    pairs: Annotated[int, MOTION("Number of pairs for each arm.", "N", max=MOST_RUNS)] = 300,
    seed0: SeedOption = 0,
    options: StudyOptions,
) -> None:
    """Drive arms between random smooth postures, and count successes by how far the arm must turn.

    The change of heading of a link accumulates from the base along the arm, including full turns; for a
    module of a spatial arm likewise, from the rotations between the changes of neighbours. Bins are of its
    largest value along the arm: beyond pi, a controller that knows only the control points turns the short
    way round, and kinks the arm. Counted, out of all, are the runs with a final mean point error below 1e-3
    of the arm length that never left the limits; then follows the median path length of the control points
    relative to straight lines, of the runs that moved and came near. At most 400 steps of 0.1 rad per joint.
    """
    subjects = [built_subject(name) for name in split_names("--arms", arms, BUILT)]
    names = split_names("--controllers", controllers, COMPARED)
    rows = options.run(study_headings(subjects, names, pairs, seed0, target), "pair")
    bins = by_heading(rows)
    asked = {"study": "headings", "target": target, "pairs": pairs, "seed0": seed0, "controllers": names}

    def cell(each: Row) -> str:
        counted = f"{each.reached}/{each.runs}"
        return counted if each.path is None else f"{counted}, path {each.path.median:.2f}"

    tables = []
    for arm, own in grouped(bins, lambda each: each.arm).items():
        lines = grouped(own, lambda each: each.controller).items()
        heads = (arm, *(f"{name} rad" for name in BINS))
        tables.append((heads, [(controller, *map(cell, those)) for controller, those in lines]))
    pictures = {"headings": draw_headings}
    options.write(Report(rows, {**asked, "bins": bins}, tables, pictures, warnings=refusals(rows)))


def draw_headings(rows: Sequence[Row]) -> Figure:
    """Draw the results of `study_headings`.

    A row for each arm, both panels against the largest change of heading: the share of runs that end near the
    target within the limits, and the path lengths of the control points, as in `draw_postures`. Runs with
    unknown `turn` are skipped.

    Raises:
        InvalidValue: no run.
    """
    known = [row for row in rows if row.turn is not None]
    arms, controllers = present(known)
    bins = {(each.arm, each.bin, each.controller): each for each in by_heading(known)}
    figure = new_figure(0.8 + 3.6 * len(arms), known)
    grid = figure.add_gridspec(len(arms), 2)
    for i, arm in enumerate(arms):
        ax = figure.add_subplot(grid[i, 0])
        for controller, color, offset, width in side_by_side(controllers):
            found = [bins[arm, name, controller] for name in BINS if (arm, name, controller) in bins]
            places = np.arange(len(found)) + offset
            # A share of zero would be invisible.
            shares = [max(each.reached / each.runs, 0.008) if each.runs else 0.0 for each in found]
            ax.bar(places, shares, 0.9 * width, color=color, label=controller)
        ax.set_xticks(range(len(BINS)), BINS)
        ax.set_ylim(0.0, 1.2)  # room for the legend
        ax.set_yticks([0.0, 0.2, 0.4, 0.6, 0.8, 1.0])
        ax.set_xlabel("largest change of heading [rad]", fontsize=9)
        dress(ax, f"{arm}: near the target, within the limits", "share of runs")
        ax = figure.add_subplot(grid[i, 1])
        own = [run for run in known if run.arm == arm]
        draw_paths(ax, own, BINS, lambda run: bin_of(run.turn or 0.0), controllers)
        ax.set_xlabel("largest change of heading [rad]", fontsize=9)
        dress(ax, f"{arm}: directness, runs that came near", PATH)
    return figure
