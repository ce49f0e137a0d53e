"""Figures and claims in one call, and the files that are left."""

from __future__ import annotations

import io
import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from pinposture._validation import require_whole
from pinposture.errors import InvalidValue, UnknownName
from pinposture.motion.processes import check_jobs
from pinposture.storage import check_writable, write_bytes, write_text
from pinposture.study.reproduce.evaluate import BATCHES, Evidence, JudgedClaim, gather, judge_claims
from pinposture.study.reproduce.figures import FigureRuns, count_runs, draw_figure, run_figures
from pinposture.study.reproduce.report import FORMAT, VERSION, claims_as_markdown, describe
from pinposture.study.reproduce.runs import MAX_STEPS
from pinposture.thesis.figures import FIGURES

NAMES = (*FIGURES, "claims", "all")
"""What can be reproduced, by name."""

RESULTS, CLAIMS_TABLE = "results.json", "claims.md"

Progress = Callable[[int, int], object]


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
    max_steps: int = MAX_STEPS,
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
    numbers, with_claims = _asked(names)
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


def _asked(names: Sequence[str]) -> tuple[list[str], bool]:
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
