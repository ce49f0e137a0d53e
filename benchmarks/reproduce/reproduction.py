"""Reproduction of the figures and claims of the thesis, as files."""

from __future__ import annotations

import io
import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from joblib import delayed

from benchmarks.baselines import named_controllers
from benchmarks.cases.scenarios import SCENARIOS
from benchmarks.harness import Row
from benchmarks.report import write_json
from benchmarks.reproduce.claims import FIGURES, ThesisFigure
from benchmarks.reproduce.evaluate import (
    BATCHES,
    Evidence,
    JudgedClaim,
    gather,
    judge_claims,
    own_batches,
)
from benchmarks.reproduce.measures import RULES, Finding, Verdict
from benchmarks.reproduce.page import claims_as_markdown, update_page
from benchmarks.reproduce.runs import (
    NUDGE,
    STEP_LIMIT,
    THESIS_STEPS,
    VARIANTS,
    RunSet,
    Variant,
    label,
    run_one,
)
from pinposture._validation import require_known, require_positive, require_whole
from pinposture.control import Controller
from pinposture.errors import InvalidValue
from pinposture.motion import Run
from pinposture.motion.processes import Progress, check_jobs, in_order
from pinposture.storage import check_writable, write_bytes, write_table, write_text

if TYPE_CHECKING:
    from matplotlib.figure import Figure


FORMATS = ("png", "pdf", "svg")
"""Formats of the figures."""


@dataclass(frozen=True)
class FigureSettings:
    """Settings of figures.

    Attributes:
        seed: seed of start and target; None for the seed of each figure.
        step_limit: largest |dq| of a joint in one step [rad].
        methods: controllers to use instead of "selection", "projection" or "switching".
        formats: file formats, of FORMATS.
        width: print width [mm]: smaller type, no title, panels stacked below 120 mm. None: screen, 12 inches.

    Raises:
        InvalidValue: an invalid number, or no format.
        UnknownName: there is no such format or method.
    """

    seed: int | None = None
    step_limit: float = STEP_LIMIT
    methods: Mapping[str, Controller] = field(default_factory=dict)
    formats: tuple[str, ...] = ("png",)
    width: float | None = None

    def __post_init__(self) -> None:
        if self.seed is not None:
            require_whole("seed", self.seed, 0)
        require_positive("step_limit", self.step_limit)
        if self.width is not None:
            require_positive("width", self.width)
        if not self.formats:
            raise InvalidValue("formats", self.formats, f"at least one of {', '.join(FORMATS)}")
        for kind, given, known in (("format", self.formats, FORMATS), ("method", self.methods, METHODS)):
            for name in given:
                require_known(kind, name, known)

    def seed_of(self, figure: ThesisFigure) -> int:
        """Return the seed of start and target of a figure."""
        return figure.seed if self.seed is None else self.seed


METHODS = ("selection", "projection", "switching")
"""Methods of the thesis, by controller name."""


class FigureRuns(NamedTuple):
    """A figure of the thesis, its runs by controller name, and the seed of start and target.

    Of the compared runs only the posture error is drawn.
    """

    about: ThesisFigure
    runs: Mapping[str, Run]
    compared: Mapping[str, Run]
    seed: int

    @property
    def stem(self) -> str:
        """File name without extension; sorted by name, figures are in the order of the thesis."""
        chapter, _, number = self.about.number.partition(".")
        return f"figure-{chapter}.{int(number):02d}"


def run_figures(
    numbers: Iterable[str],
    max_steps: int = THESIS_STEPS,
    jobs: int = 1,
    progress: Callable[[int], object] | None = None,
    settings: FigureSettings | None = None,
    own: Mapping[str, Controller] | None = None,
) -> list[FigureRuns]:
    """Compute the runs of figures, "6.3" to "6.12"; runs shared by several figures are computed once.

    The user's own controllers, by name, are shown as well. `progress` is called with the number of newly
    finished runs, of `count_runs`.

    Raises:
        UnknownName: there is no such figure.
    """
    listed, own, settings = [_figure(number) for number in numbers], own or {}, settings or FigureSettings()
    todo = _todo(listed, own, settings)
    controllers = {**settings.methods, **own}

    def batch(scenario: str, name: str) -> RunSet:
        return RunSet(scenario, name, given=Variant(controllers.get(name, name), settings.step_limit))

    tasks = (delayed(run_one)(batch(scenario, name), seed, max_steps) for scenario, name, seed in todo)
    done = {}
    for key, run in zip(todo, in_order(tasks, jobs), strict=True):
        done[key] = run
        if progress is not None:
            progress(1)

    def show(about: ThesisFigure) -> FigureRuns:
        seed = settings.seed_of(about)
        runs = {name.capitalize(): done[about.scenario, name, seed] for name in about.controllers}
        runs |= {name: done[about.scenario, name, seed] for name in own}
        compared = {name.capitalize(): done[about.scenario, name, seed] for name in about.compared}
        return FigureRuns(about, runs, compared, seed)

    return [show(about) for about in listed]


def count_runs(
    numbers: Iterable[str], own: Iterable[str] = (), settings: FigureSettings | None = None
) -> int:
    """Return the number of runs for these figures and own controllers; raises as `run_figures`."""
    return len(_todo([_figure(number) for number in numbers], own, settings or FigureSettings()))


def _figure(number: str) -> ThesisFigure:
    require_known("figure", number, FIGURES)
    return FIGURES[number]


def _todo(
    figures: Iterable[ThesisFigure], own: Iterable[str], settings: FigureSettings
) -> list[tuple[str, str, int]]:
    """Return scenario, controller and seed of each run, without duplicates."""
    wanted = (
        (figure.scenario, name, settings.seed_of(figure))
        for figure in figures
        for name in (*figure.controllers, *figure.compared, *own)
    )
    return list(dict.fromkeys(wanted))


def draw_figure(figure: FigureRuns, width: float | None = None) -> Figure:
    """Draw a figure in the layout of the thesis, 1200 pixels wide or with a print width [mm]."""
    from benchmarks.reproduce.figures import draw_errors, draw_final_postures, draw_planar

    about = figure.about
    title = (
        f"Figure {about.number}: {about.title} (Section {about.section}). Start and target from seed "
        f"{figure.seed}, |dq| <= {next(iter(figure.runs.values())).limits.step:g} rad per step."
    )
    if about.layout == "planar":
        return draw_planar(figure.runs, title, figure.compared, width)
    return (draw_final_postures if about.layout == "postures" else draw_errors)(figure.runs, title, width)


def figure_tables(figure: FigureRuns) -> dict[str, list[Sequence[object]]]:
    """Return the rows of tables by file name: errors for each step, and postures."""
    every, found = {**figure.runs, **figure.compared}, {}
    if figure.about.layout != "postures":
        points = next(iter(every.values())).arm.n_modules
        rows: list[Sequence[object]] = [
            ("controller", "step", "posture_error_m", "active_points", "index", "by_projection")
            + tuple(f"point_error_{k + 1}_m" for k in range(points))
        ]
        for name, run in every.items():
            used = run.active.sum(axis=1)
            indices = run.reported("manipulability", 0.0)
            methods = run.reported("method", "")
            for step, errors in enumerate(run.point_errors):
                values: tuple[object, ...] = ("", "", "")  # there is no step before the first
                if step:
                    by_projection = int(methods[step - 1] == "projection")
                    values = (used[step - 1], indices[step - 1], by_projection)
                rows.append((name, step, run.posture_error[step], *values, *errors))
        found[f"{figure.stem}.csv"] = rows
    if figure.about.layout != "errors":
        rows = [("posture", "point", "x_m", "y_m", "z_m")]
        first = next(iter(every.values()))
        postures = {"initial": first.points[0], "target": first.target.points}
        postures |= {f"final, {name}": run.points[-1] for name, run in every.items()}
        for name, posture in postures.items():
            rows += [(name, k + 1, *point) for k, point in enumerate(posture)]
        found[f"{figure.stem}-postures.csv"] = rows
    return found


def describe_figure(figure: FigureRuns) -> dict[str, Any]:
    """Return a figure as JSON-compatible data; lengths in metres, angles in radians."""
    about = figure.about
    return {
        "figure": about.number,
        "title": about.title,
        "section": about.section,
        "file": f"{figure.stem}.png",
        "scenario": about.scenario,
        "arm": SCENARIOS[about.scenario].arm,
        "seed": figure.seed,
        "runs": [_described(name, run) for name, run in figure.runs.items()],
        "compared": [_described(name, run) for name, run in figure.compared.items()],
    }


def _described(name: str, run: Run) -> dict[str, Any]:
    errors = run.posture_error
    methods = run.reported("method", "")
    return {
        "controller": name.lower(),
        "parameters": run.controller,
        "step_limit": run.limits.step,
        "start": run.q[0].tolist(),
        "start_error": float(errors[0]),
        "final_error": float(errors[-1]),
        "lowest_error": float(errors.min()),
        "mean_point_error": float(errors[-1]) / int(run.target.has_target.sum()),
        "arm_length": run.arm.length,
        "steps": run.steps,
        "status": run.status,
        "reason": run.reason,
        "posture_error": errors.tolist(),
        "active_points": run.active.sum(axis=1).tolist(),
        "manipulability_index": run.reported("manipulability", 0.0).tolist(),
        "by_projection": (methods == "projection").tolist() if methods.any() else None,
    }


FORMAT = "pinposture-reproduction"
VERSION = 2


def describe(
    figures: Sequence[FigureRuns], judged: Sequence[JudgedClaim], evidence: Evidence | None, max_steps: int
) -> dict[str, Any]:
    """Return all results as JSON-compatible data; without evidence there are no judged claims."""
    return {
        "format": FORMAT,
        "version": VERSION,
        "parameters": {
            "seeds": evidence.seeds if evidence else 0,
            "first_seed": evidence.first if evidence else 0,
            "max_steps": max_steps,
            "step_limit": STEP_LIMIT,
            "nudge": NUDGE,
            "rules": {name: rule._asdict() for name, rule in RULES.items()},
        },
        "figures": [describe_figure(figure) for figure in figures],
        "claims": [_claim(each) for each in judged],
        "runs": [_batch(*key, runs) for key, runs in evidence.pool.items()] if evidence else [],
    }


def _claim(judged: JudgedClaim) -> dict[str, Any]:
    claim = judged.claim
    return {
        "id": claim.id,
        "where": claim.where,
        "claim": claim.text,
        "measured": claim.measured,
        "rule": claim.rule,
        "construction": claim.construction,
        **_finding(judged.verdict, judged.finding),
        "readings": {name: _finding(*found) for name, found in judged.readings.items()},
        "own": {name: _finding(*found) for name, found in judged.own.items()},
    }


def _finding(verdict: Verdict, finding: Finding) -> dict[str, Any]:
    return {
        "verdict": verdict,
        "shares": {
            name: {"true": each.true, "cases": each.cases, "share": each.value}
            for name, each in finding.shares.items()
            if each.cases
        },
        "figures": dict(finding.figures),
        "by_nearness": [
            each._asdict() | {"high": each.high if np.isfinite(each.high) else None}
            for each in finding.by_nearness
        ],
        "instead": "" if verdict == "holds" else finding.instead,
    }


def _batch(scenario: str, variant: str, runs: Sequence[Row]) -> dict[str, Any]:
    """Return the runs of one scenario by one variant in numbers, with errors per arm length."""
    final = np.array([run.mean_errors[-1] for run in runs])
    endings = [run.outcome.status for run in runs]
    return {
        "scenario": scenario,
        "arm": SCENARIOS[scenario].arm,
        "title": label(scenario),
        "variant": variant,
        "runs": len(runs),
        "steps": float(np.median([run.outcome.steps for run in runs])),
        "ratio": float(np.median([run.outcome.ratio for run in runs])),
        "final_error": float(np.median(final)),
        "final_error_90": float(np.percentile(final, 90)),
        "rising": float(np.median([run.outcome.rising for run in runs])),
        "path_length_ratio": float(np.median([run.path_length_ratio for run in runs])),
        "endings": {status: endings.count(status) for status in sorted(set(endings))},
    }


NAMES = (*FIGURES, "claims", "all")
"""Names of what can be reproduced."""

RESULTS, CLAIMS_TABLE = "results.json", "claims.md"


class Reproduction(NamedTuple):
    """Figures, judged claims, all results as JSON-compatible data, and the files that were written."""

    figures: Sequence[FigureRuns]
    judged: Sequence[JudgedClaim]
    results: dict[str, Any]
    files: Sequence[Path]


def reproduce(
    names: Sequence[str],
    directory: str | Path | None = None,
    seeds: int = 100,
    max_steps: int = THESIS_STEPS,
    jobs: int = 1,
    progress: Progress | None = None,
    *,
    controllers: Sequence[str | Controller] = (),
    settings: FigureSettings | None = None,
    page: str | Path | None = None,
) -> Reproduction:
    """Reproduce figures of the thesis and judge its claims.

    Args:
        names: numbers of figures, "6.3" to "6.12"; "claims"; or "all".
        directory: output directory for each figure as picture and CSV, results.json, and claims.md if claims
            are judged; created if necessary. Results of earlier calls for other figures, or for claims, are
            kept. None writes no files.
        seeds: number of seeds for judging claims, starting at the seed of the settings, or at 0.
        max_steps: maximum number of steps of a run.
        jobs: number of processes; the results do not depend on it.
        progress: called with the numbers of finished and of all runs.
        controllers: your own controllers, or names, to show in the figures as well, and to judge by the
            claims that apply to any controller.
        settings: settings of the figures; `FigureSettings()` if None. Claims only use its seed.
        page: a Markdown page with markers into which the tables of the claims are written (see
            `page.update_page`); their data is written to a JSON file beside it.

    Raises:
        UnknownName: there is no such figure or controller.
        InvalidValue: nothing to reproduce; an invalid number of seeds, steps or processes; two controllers
            with the same name; a page without claims; or claims with custom methods or step limit.
        FileError: a file cannot be written.
    """
    numbers, with_claims = _select_experiments(names)
    settings = settings or FigureSettings()
    for name, value in (("seeds", seeds), ("max_steps", max_steps)):
        require_whole(name, value, 1)
    check_jobs(jobs)
    own = _own(controllers)
    if page is not None and not with_claims:
        raise InvalidValue("page", str(page), 'None, unless names have "claims" or "all"')
    if with_claims and (settings.methods or settings.step_limit != STEP_LIMIT):
        allowed = f"the default methods and step limit where names have claims: {list(names)}"
        raise InvalidValue("settings", settings, allowed)
    for path in (directory, None if page is None else Path(page).parent):
        if path is not None:
            check_writable(Path(path))  # early, before the long computation
    total = count_runs(numbers, own, settings)
    total += with_claims * seeds * (len(BATCHES) + len(own_batches(own)))
    done = 0

    def advance(runs: int) -> None:
        nonlocal done
        done += runs
        if progress is not None:
            progress(done, total)

    figures = run_figures(numbers, max_steps, jobs, advance, settings, own)
    first = settings.seed or 0
    evidence = gather(seeds, max_steps, jobs, advance, first, own) if with_claims else None
    judged = judge_claims(evidence) if evidence else []
    results = describe(figures, judged, evidence, max_steps)
    files = [] if directory is None else _write(Path(directory), figures, settings, results)
    if page is not None:
        kept = {name: results[name] for name in ("format", "version", "parameters", "claims")}
        files += [Path(page), Path(page).with_suffix(".json")]
        update_page(files[-2], kept)
        write_json(files[-1], kept)
    return Reproduction(figures, judged, results, files)


def _own(controllers: Sequence[str | Controller]) -> dict[str, Controller]:
    """Return the user's own controllers by name."""
    listed = named_controllers(controllers) if controllers else []
    own = {controller.name: controller for controller in listed}
    taken = [*VARIANTS, *(name.capitalize() for name in METHODS)]
    if len(own) < len(listed) or any(name in taken for name in own):
        allowed = f"names that differ, and none of {', '.join(METHODS)}"
        raise InvalidValue("controllers (names)", [each.name for each in listed], allowed)
    return own


def _select_experiments(names: Sequence[str]) -> tuple[list[str], bool]:
    """Return the numbers of the requested figures, and whether claims are requested."""
    if not names:
        raise InvalidValue("names", list(names), f"at least one of {', '.join(NAMES)}")
    for name in names:
        require_known("figure", name, NAMES)
    if "all" in names:
        return list(FIGURES), True
    return [number for number in FIGURES if number in names], "claims" in names


def _write(
    directory: Path, figures: Sequence[FigureRuns], settings: FigureSettings, results: dict[str, Any]
) -> list[Path]:
    files = []
    for figure in figures:
        drawn = draw_figure(figure, settings.width)
        for form in settings.formats:
            picture = io.BytesIO()
            drawn.savefig(picture, format=form, dpi=100 if settings.width is None else 300)
            files.append(directory / f"{figure.stem}.{form}")
            write_bytes(files[-1], picture.getvalue())
        for name, rows in figure_tables(figure).items():
            files.append(directory / name)
            write_table(files[-1], rows)
    if results["claims"]:
        files.append(directory / CLAIMS_TABLE)
        write_text(files[-1], claims_as_markdown(results))
    files.append(directory / RESULTS)
    kept = _with_earlier(results, files[-1], bool(results["claims"]))
    write_json(files[-1], kept)
    return files


def _with_earlier(results: dict[str, Any], path: Path, with_claims: bool) -> dict[str, Any]:
    """Return these results, merged with those of an earlier call that they do not replace."""
    try:
        earlier = json.loads(path.read_text())
        if (earlier["format"], earlier["version"]) != (FORMAT, VERSION):
            return results
        figures = {each["figure"]: each for each in (*earlier["figures"], *results["figures"])}
        claims = results if with_claims else earlier
        return results | {
            "figures": [figures[number] for number in FIGURES if number in figures],
            **{name: claims[name] for name in ("parameters", "claims", "runs")},
        }
    except (OSError, ValueError, KeyError, TypeError):
        return results
