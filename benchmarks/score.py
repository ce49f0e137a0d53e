"""A benchmark for any program: a file of cases, a file of results, and the score of the results.

The file of cases contains everything that a program needs: arms as URDF, starts, targets, obstacles. The file
of results contains only the joint positions after each step: all figures are computed from these.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from functools import partial
from operator import attrgetter, itemgetter
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.cases.clutter import draw_problem
from benchmarks.cases.scenarios import ARMS, SCENARIOS, case, urdf_files
from benchmarks.cases.situations import situation_arm
from benchmarks.harness import Case, Row, Study, count, median, summarise
from benchmarks.studies.clutter import dense_clearance
from pinposture.arm import Arm
from pinposture.collision import Scene
from pinposture.errors import FileError
from pinposture.motion.run import path_length_ratio
from pinposture.storage import parse_json, read_text, write_text

Array = NDArray[np.float64]

# The cases; the files are in `benchmarks/cases`.

CASES_FORMAT, RESULTS_FORMAT = "pinposture-benchmark-cases", "pinposture-benchmark-results"

BENCHMARK_VERSION = 1
"""Version of both formats."""

BENCHMARK_STEP, BENCHMARK_STEPS = 0.1, 400
"""Largest |dq| of a joint in one step [rad], and largest number of steps."""

BENCHMARK_REACHED = 1e-3
"""Mean point error, per arm length, at which a target is reached."""

BENCHMARK_SEED = 5000
"""First seed of the cases."""

POSTURE_GROUPS = ("helix", "line", "random", "from-straight")
PLANAR_GROUPS = ("planar-random", "planar-near-line", "planar-from-straight")
SCENE_GROUPS = ("balls", "posts", "hole")


def make_cases(each: int = 5) -> dict[str, Any]:
    """Draw `each` cases of each group, as JSON-compatible data."""
    arms = {name: Arm.from_modules(ARMS[name], name=name) for name in ("ryrz20", "planar45")}
    cases = []
    for scenario in (SCENARIOS[name] for name in POSTURE_GROUPS + PLANAR_GROUPS):
        for seed in range(BENCHMARK_SEED, BENCHMARK_SEED + each):
            start, target = case(arms[scenario.arm], scenario, seed)
            cases.append(_case(scenario.name, seed, scenario.arm, start, target.points))
    arm = situation_arm()
    for kind in SCENE_GROUPS:
        for seed in range(BENCHMARK_SEED, BENCHMARK_SEED + each):
            problem = draw_problem(arm, kind, seed)
            assert problem.scene is not None
            described = _case(kind, seed, "ryrz20", problem.start, problem.target.points)
            cases.append(described | {"scene": problem.scene.to_dict()})
    return {
        "format": CASES_FORMAT,
        "version": BENCHMARK_VERSION,
        "step_limit": BENCHMARK_STEP,
        "max_steps": BENCHMARK_STEPS,
        "reached": BENCHMARK_REACHED,
        "arms": {name: _described(name, arm) for name, arm in arms.items()},
        "cases": cases,
    }


def _described(name: str, arm: Arm) -> dict[str, Any]:
    frames = [arm.model.frames[arm.model.getFrameId(point)] for point in arm.control_points]
    return {
        "urdf": urdf_files()[f"{name}.urdf"],
        "length": round(arm.length, 9),
        "joints": list(arm.chain.joints),
        "joints_per_module": len(arm.chain.joints) // arm.n_modules,
        "points": [
            {
                "joint": arm.model.names[frame.parentJoint],
                "offset": frame.placement.translation.round(9).tolist(),
            }
            for frame in frames
        ],
    }


def _case(group: str, seed: int, arm: str, start: Array, points: Array) -> dict[str, Any]:
    described = {"id": f"{group}-{seed}", "group": group, "arm": arm, "scene": None}
    return described | {"start": start.round(9).tolist(), "target": points.round(9).tolist()}


def write_cases(path: Path, each: int = 5) -> str:
    """Write a file of cases and return its SHA-256 checksum."""
    text = json.dumps(make_cases(each), separators=(",", ":"), allow_nan=False).replace('{"id"', '\n{"id"')
    write_text(path, text + "\n")
    return checksum(path)


def checksum(path: Path) -> str:
    """Return the SHA-256 checksum of the text of a file."""
    return hashlib.sha256(read_text(path).encode()).hexdigest()


LIMIT_ROUNDING = 1e-5
"""Tolerance of limits [rad], because solvers satisfy constraints only approximately."""


def score(results: str | Path, cases: str | Path) -> tuple[str, list[Row]]:
    """Score a file of results.

    Args:
        results: {"format", "version", "cases": checksum of the file of cases, "program": its name, "runs":
            [{"case": id, "q": positions before the first and after each step, (steps + 1, n)}, ...]}.
        cases: the file of cases.

    Returns:
        The name of the program, and a row for each group. Missing cases count as not reached.
            group: name of the group.
            cases: number of cases in it.
            tried: number of cases in the results.
            reached: number of cases that end at the target, within all limits, and without collision.
            limits_held: number of cases within the limits of step, position and number of steps.
            clear: number of cases that never touch an obstacle, including those without obstacles.
            error: mean point error at the end per arm length, median of the tried cases.
            steps: number of steps, median of the reached cases.
            path: path length of the control points relative to straight lines, median of the reached cases.
            rising: share of steps on which the posture error rises, median of the reached cases.

    Raises:
        FileError: a file is missing, malformed or of another version; or the results are for other cases,
            name an unknown case or one twice, do not begin at its start, or contain non-finite numbers.
    """
    results, cases = Path(results), Path(cases)
    given = _read(results, RESULTS_FORMAT, ("cases", "program", "runs"))
    known = _read(cases, CASES_FORMAT, ("step_limit", "max_steps", "reached", "arms", "cases"))
    if given["cases"] != checksum(cases):
        raise FileError(
            results, f"contains results for other cases; the checksum of {cases} is {checksum(cases)}"
        )
    arms = {
        name: Arm.load(each["urdf"], split=each["joints_per_module"]) for name, each in known["arms"].items()
    }
    ids = {each["id"] for each in known["cases"]}
    answers: dict[str, Any] = {}
    for run in given["runs"]:
        name = str(run.get("case")) if isinstance(run, Mapping) else ""
        if name not in ids or name in answers:
            raise FileError(results, f"contains a run of case {name!r}; allowed: each case of {cases} once")
        answers[name] = run.get("q")
    listed = [Case({"group": each["group"]}, partial(dict, each)) for each in known["cases"]]
    judge = partial(_judge, results, known, arms)
    rows = Study(listed, [answers], judge).rows()
    tried, reached = attrgetter("tried"), attrgetter("reached")
    scores = summarise(
        rows,
        ["group"],
        cases=len,
        tried=count(tried),
        reached=count(reached),
        limits_held=count(attrgetter("limits_held")),
        clear=count(itemgetter("clear")),
        error=median("error", tried),
        steps=median("steps", reached),
        path=median("path", reached),
        rising=median("rising", reached),
    )
    return str(given["program"]), scores


def _read(path: Path, form: str, keys: Sequence[str]) -> dict[str, Any]:
    content = parse_json(path, read_text(path))
    if not isinstance(content, dict) or content.get("format") != form:
        raise FileError(path, f'is not a file with "format": "{form}"')
    if content.get("version") != BENCHMARK_VERSION:
        raise FileError(path, f"is of version {content.get('version')!r}; allowed: {BENCHMARK_VERSION}")
    missing = [key for key in keys if key not in content]
    if missing:
        raise FileError(path, f"lacks {', '.join(missing)}")
    return content


def _judge(
    path: Path,
    known: Mapping[str, Any],
    arms: Mapping[str, Arm],
    described: Mapping[str, Any],
    answers: Mapping[str, Any],
) -> Row:
    """Judge the answer of a program to a case, if there is one; columns as in `score`."""
    if described["id"] not in answers:
        return Row(tried=False, reached=False, limits_held=False, clear=False)
    arm, start = arms[described["arm"]], np.array(described["start"])
    positions = _positions(answers[described["id"]])
    if positions.ndim != 2 or positions.shape[1] != len(start) or not np.isfinite(positions).all():
        raise FileError(
            path, f"case {described['id']}: q is not an array of (steps + 1, {len(start)}) finite numbers"
        )
    if np.abs(positions[0] - start).max() > LIMIT_ROUNDING:
        raise FileError(path, f"case {described['id']}: q does not begin at the start of the case")
    points = np.array([arm.at(each).points for each in positions])
    errors = np.linalg.norm(points - np.array(described["target"]), axis=2)
    changes, steps = np.abs(np.diff(positions, axis=0)), len(positions) - 1
    lower, upper = arm.limits.lower - LIMIT_ROUNDING, arm.limits.upper + LIMIT_ROUNDING
    held = steps <= known["max_steps"] and changes.max(initial=0.0) <= known["step_limit"] + LIMIT_ROUNDING
    held = bool(held and np.all((positions >= lower) & (positions <= upper)))
    clear = (
        described["scene"] is None
        or dense_clearance(arm, Scene.from_dict(described["scene"]), positions) > 0.0
    )
    error = float(errors[-1].mean()) / arm.length
    return Row(
        tried=True,
        reached=held and clear and error <= known["reached"],
        limits_held=held,
        clear=clear,
        error=error,
        steps=steps,
        path=path_length_ratio(points),
        rising=float(np.mean(np.diff(errors.sum(axis=1)) > 1e-9 * arm.length)) if steps else 0.0,
    )


def _positions(q: object) -> Array:
    """Return joint positions as an array; an empty one if they are none."""
    try:
        return np.array(q, dtype=float)
    except (TypeError, ValueError, OverflowError):
        return np.empty(0)
