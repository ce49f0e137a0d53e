"""The runs that Figures 6.3 to 6.12 show, once more: as pictures and as numbers."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

from joblib import delayed

from pinposture.errors import UnknownName
from pinposture.motion import Trajectory
from pinposture.motion.processes import in_order
from pinposture.study.reproduce.runs import MAX_STEPS, RunSet, run_one
from pinposture.thesis.figures import FIGURES, ThesisFigure
from pinposture.thesis.scenarios import SCENARIOS

if TYPE_CHECKING:
    from matplotlib.figure import Figure


class FigureRuns(NamedTuple):
    """A figure and the runs that it shows.

    Attributes:
        about: which figure it is.
        runs: its runs by the names of their controllers.
        compared: runs of which only the posture error is drawn, likewise.
    """

    about: ThesisFigure
    runs: Mapping[str, Trajectory]
    compared: Mapping[str, Trajectory]

    @property
    def file(self) -> str:
        """Name of the picture; by name, pictures are in the order of the thesis."""
        chapter, _, number = self.about.number.partition(".")
        return f"figure-{chapter}.{int(number):02d}.png"


def run_figures(
    numbers: Iterable[str],
    max_steps: int = MAX_STEPS,
    jobs: int = 1,
    progress: Callable[[int], object] | None = None,
) -> list[FigureRuns]:
    """Make the runs of figures; those that several of them show are made once.

    Args:
        numbers: numbers of the figures in the thesis, "6.3" to "6.12".
        max_steps: steps after which a run ends.
        jobs: number of processes.
        progress: called with the number of runs that have just been finished, of `count_runs(numbers)`.

    Raises:
        UnknownName: there is no such figure.
    """
    listed = [_figure(number) for number in numbers]
    todo = _todo(listed)
    tasks = (delayed(run_one)(RunSet(scenario, name), seed, max_steps) for scenario, name, seed in todo)
    done = {}
    for key, run in zip(todo, in_order(tasks, jobs), strict=True):
        done[key] = run
        if progress is not None:
            progress(1)
    return [
        FigureRuns(
            about,
            {name.capitalize(): done[about.scenario, name, about.seed] for name in about.controllers},
            {name.capitalize(): done[about.scenario, name, about.seed] for name in about.compared},
        )
        for about in listed
    ]


def count_runs(numbers: Iterable[str]) -> int:
    """How many runs these figures take.

    Raises:
        UnknownName: there is no such figure.
    """
    return len(_todo([_figure(number) for number in numbers]))


def _figure(number: str) -> ThesisFigure:
    if number not in FIGURES:
        raise UnknownName("figure", number, FIGURES)
    return FIGURES[number]


def _todo(figures: Iterable[ThesisFigure]) -> list[tuple[str, str, int]]:
    """Scenario, controller and seed of each run, without repetition."""
    wanted = (
        (figure.scenario, name, figure.seed)
        for figure in figures
        for name in (*figure.controllers, *figure.compared)
    )
    return list(dict.fromkeys(wanted))


def draw_figure(figure: FigureRuns) -> Figure:
    """Draw a figure as the thesis lays it out, 1200 pixels wide."""
    from pinposture.study.thesis_figures import draw_errors, draw_final_postures, draw_planar

    about = figure.about
    title = (
        f"Figure {about.number}: {about.title} (Section {about.section}). Start and target from seed "
        f"{about.seed}, |dq| <= {next(iter(figure.runs.values())).limits.step:g} rad per step."
    )
    if about.layout == "planar":
        return draw_planar(figure.runs, title, figure.compared)
    return (draw_final_postures if about.layout == "postures" else draw_errors)(figure.runs, title)


def describe_figure(figure: FigureRuns) -> dict[str, Any]:
    """A figure in numbers that JSON can hold; lengths in metres, angles in radians."""
    about = figure.about
    return {
        "figure": about.number,
        "title": about.title,
        "section": about.section,
        "file": figure.file,
        "scenario": about.scenario,
        "arm": SCENARIOS[about.scenario].arm,
        "seed": about.seed,
        "runs": [_described(name, run) for name, run in figure.runs.items()],
        "compared": [_described(name, run) for name, run in figure.compared.items()],
    }


def _described(name: str, run: Trajectory) -> dict[str, Any]:
    errors = run.posture_error
    return {
        "controller": name.lower(),
        "parameters": run.controller,
        "step_limit": run.limits.step,
        "start": run.q[0].tolist(),
        "start_error": float(errors[0]),
        "final_error": float(errors[-1]),
        "lowest_error": float(errors.min()),
        "mean_point_error": float(errors[-1]) / int(run.target.placed.sum()),
        "arm_length": run.arm.length,
        "steps": run.steps,
        "status": run.status,
        "reason": run.reason,
        "posture_error": errors.tolist(),
        "active_points": run.active.sum(axis=1).tolist(),
        "manipulability_index": run.index.tolist(),
        "by_projection": (run.method == "projection").tolist() if run.method.any() else None,
    }
