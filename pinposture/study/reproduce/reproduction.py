"""The figures and claims of the thesis once more, as files."""

from __future__ import annotations

import io
import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from joblib import delayed

from pinposture._validation import require_whole
from pinposture.errors import InvalidValue, UnknownName
from pinposture.motion import Trajectory
from pinposture.motion.processes import Progress, check_jobs, in_order
from pinposture.storage import check_writable, write_bytes, write_text
from pinposture.study.claims import FIGURES, ThesisFigure
from pinposture.study.reproduce.evaluate import BATCHES, Evidence, JudgedClaim, gather, judge_claims
from pinposture.study.reproduce.measures import RULES, Finding, Share, Verdict
from pinposture.study.reproduce.runs import (
    DEFAULT,
    NUDGE,
    STEP_LIMIT,
    THESIS_STEPS,
    MeasuredRun,
    RunSet,
    label,
    run_one,
)
from pinposture.study.scenarios import SCENARIOS

if TYPE_CHECKING:
    from matplotlib.figure import Figure


# The runs that Figures 6.3 to 6.12 show, once more: as pictures and as numbers.


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
    max_steps: int = THESIS_STEPS,
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
        "mean_point_error": float(errors[-1]) / int(run.target.has_target.sum()),
        "arm_length": run.arm.length,
        "steps": run.steps,
        "status": run.status,
        "reason": run.reason,
        "posture_error": errors.tolist(),
        "active_points": run.active.sum(axis=1).tolist(),
        "manipulability_index": run.index.tolist(),
        "by_projection": (run.method == "projection").tolist() if run.method.any() else None,
    }


# What was found, for programs (results.json) and for people (claims.md).

FORMAT = "pinposture-reproduction"
VERSION = 1


def describe(
    figures: Sequence[FigureRuns], judged: Sequence[JudgedClaim], evidence: Evidence | None, max_steps: int
) -> dict[str, Any]:
    """Everything that was found, as data that JSON can hold.

    Args:
        figures: the figures that were reproduced.
        judged: the claims that were judged.
        evidence: what they were judged by; None if none were.
        max_steps: steps after which a run ended.
    """
    return {
        "format": FORMAT,
        "version": VERSION,
        "parameters": {
            "seeds": evidence.seeds if evidence else 0,
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
        **_finding(judged.verdict, judged.finding),
        "readings": {name: _finding(*found) for name, found in judged.readings.items()},
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


def _batch(scenario: str, variant: str, runs: Sequence[MeasuredRun]) -> dict[str, Any]:
    """The runs of one scenario by one variant in numbers, errors per arm length."""
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


def claims_as_markdown(judged: Sequence[JudgedClaim], seeds: int, max_steps: int) -> str:
    """The claims as a Markdown document: a table, then what was measured for each of them."""
    rows = [
        f"| {each.claim.text} | {each.claim.where} | {each.verdict} | {span(each.finding.shares)} "
        f"| {_otherwise(each)} |"
        for each in judged
    ]
    rules = [
        f"* {name}: {rule.words}. Holds from {rule.holds:.0%}, partly from {rule.partly:.0%}."
        for name, rule in RULES.items()
    ]
    parts = [
        "# The claims of the thesis, measured",
        f"Over {seeds} seed{'s' * (seeds != 1)}, at most {max_steps} steps a run. A claim holds if the share "
        "of cases in which it is true reaches the first threshold of its rule in everything that was tried, "
        "does not hold if the share stays below the second in all of it, and else holds partly. The rules "
        "are for claims that are",
        "\n".join(rules),
        "\n".join(["| claim | where | verdict | true in | read otherwise |", "|---|---|---|---|---|", *rows]),
        *(_section(each) for each in judged),
    ]
    return "\n\n".join(parts) + "\n"


def _otherwise(judged: JudgedClaim) -> str:
    """Verdicts of other readings where they differ, in words."""
    differ = {name: found[0] for name, found in judged.readings.items() if found[0] != judged.verdict}
    return "; ".join(f"{name}: {verdict}" for name, verdict in differ.items())


def _section(judged: JudgedClaim) -> str:
    claim = judged.claim
    lines = [
        f"## {claim.id}",
        f"{claim.text} ({claim.where})",
        f"Verdict: **{judged.verdict}**. Measured: {claim.measured}. Rule: {claim.rule}.",
        _table({DEFAULT: (judged.verdict, judged.finding), **judged.readings}),
    ]
    if judged.verdict != "holds" and judged.finding.instead:
        lines.append(f"What holds: {judged.finding.instead}")
    lines += _nearness_tables(judged.finding)
    return "\n\n".join(lines)


def _table(findings: Mapping[str, tuple[Verdict, Finding]]) -> str:
    rows = ["| read | tried | true in | share |", "|---|---|---|---|"]
    for reading, (verdict, finding) in findings.items():
        rows += [
            f"| {reading} ({verdict}) | {name} | {each.true} of {each.cases} | {each.value:.1%} |"
            for name, each in finding.shares.items()
            if each.cases
        ]
    return "\n".join(rows)


def _nearness_tables(finding: Finding) -> list[str]:
    """Medians and largest values by nearness, a table for each quantity."""
    tables = []
    for quantity in dict.fromkeys(each.quantity for each in finding.by_nearness):
        own = [each for each in finding.by_nearness if each.quantity == quantity]
        classes = sorted({(each.low, each.high) for each in own})
        heads = " | ".join(
            f"{low:g} to {high:g}" if np.isfinite(high) else f"above {low:g}" for low, high in classes
        )
        rows = [f"| {quantity}: median (largest), by nearness | {heads} |", "|---" * (len(classes) + 1) + "|"]
        for group in dict.fromkeys(each.group for each in own):
            cells = {
                (each.low, each.high): f"{each.median:.2g} ({each.largest:.2g})"
                for each in own
                if each.group == group
            }
            rows.append(f"| {group} | {' | '.join(cells.get(bounds, '') for bounds in classes)} |")
        tables.append("\n".join(rows))
    return tables


def span(shares: Mapping[str, Share]) -> str:
    """The smallest and the largest share, in words."""
    values = [each.value for each in shares.values() if each.cases]
    if not values:
        return "no case"
    low, high = f"{min(values):.0%}", f"{max(values):.0%}"
    return low if low == high else f"{low} to {high}"


# Figures and claims in one call, and the files that are left.

NAMES = (*FIGURES, "claims", "all")
"""What can be reproduced, by name."""

RESULTS, CLAIMS_TABLE = "results.json", "claims.md"


class Reproduction(NamedTuple):
    """What came of it.

    Attributes:
        figures: the figures and their runs.
        judged: the claims and their verdicts.
        results: all of it as data that JSON can hold.
        files: the files that were written.
    """

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
) -> Reproduction:
    """Reproduce figures of the thesis, and judge its claims.

    Args:
        names: numbers of figures, "6.3" to "6.12"; "claims"; or "all".
        directory: where to leave each figure as PNG, results.json, and claims.md if claims were judged; made
            if it does not exist. What an earlier call left there of other figures, or of claims, stays.
            None: nothing is kept.
        seeds: number of seeds that claims are judged over.
        max_steps: steps after which a run ends.
        jobs: number of processes; the results do not depend on it.
        progress: called with the number of runs finished so far, and that of all.

    Raises:
        UnknownName: there is no such figure.
        InvalidValue: nothing to reproduce, or a number of seeds, steps or processes that makes no sense.
        FileError: a file cannot be written.
    """
    numbers, with_claims = _select_experiments(names)
    for name, value in (("seeds", seeds), ("max_steps", max_steps)):
        require_whole(name, value, 1)
    check_jobs(jobs)
    if directory is not None:
        check_writable(Path(directory))  # now, so that nobody waits for results that cannot be kept
    total = count_runs(numbers) + with_claims * seeds * len(BATCHES)
    done = 0

    def advance(runs: int) -> None:
        nonlocal done
        done += runs
        if progress is not None:
            progress(done, total)

    figures = run_figures(numbers, max_steps, jobs, advance)
    evidence = gather(seeds, max_steps, jobs, advance) if with_claims else None
    judged = judge_claims(evidence) if evidence else []
    results = describe(figures, judged, evidence, max_steps)
    files = [] if directory is None else _write(Path(directory), figures, judged, evidence, results)
    return Reproduction(figures, judged, results, files)


def _select_experiments(names: Sequence[str]) -> tuple[list[str], bool]:
    """Numbers of the figures asked for, and whether claims are."""
    if not names:
        raise InvalidValue("names", list(names), f"at least one of {', '.join(NAMES)}")
    for name in names:
        if name not in NAMES:
            raise UnknownName("figure", name, NAMES)
    if "all" in names:
        return list(FIGURES), True
    return [number for number in FIGURES if number in names], "claims" in names


def _write(
    directory: Path,
    figures: Sequence[FigureRuns],
    judged: Sequence[JudgedClaim],
    evidence: Evidence | None,
    results: dict[str, Any],
) -> list[Path]:
    files = []
    for figure in figures:
        picture = io.BytesIO()
        draw_figure(figure).savefig(picture, format="png")
        files.append(directory / figure.file)
        write_bytes(files[-1], picture.getvalue())
    if evidence is not None:
        files.append(directory / CLAIMS_TABLE)
        write_text(files[-1], claims_as_markdown(judged, evidence.seeds, results["parameters"]["max_steps"]))
    files.append(directory / RESULTS)
    kept = _with_earlier(results, files[-1], evidence is not None)
    write_text(files[-1], json.dumps(kept, indent=1, allow_nan=False) + "\n")
    return files


def _with_earlier(results: dict[str, Any], path: Path, with_claims: bool) -> dict[str, Any]:
    """These results, and those of an earlier call that they do not replace."""
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
