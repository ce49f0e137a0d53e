"""One method on one arm, in a process of its own; `bench.py` starts it.

    python -m benchmarks.peers.measure geodesic problem.npz found.json --seconds 10 --max-steps 200 --stream 0
    --memory 6

Each step is timed by itself. What is done between steps (errors against the targets, by
`scenarios.points_at`) is not timed. Python's garbage collector runs as it does for users.
"""

from __future__ import annotations

import argparse
import json
import resource
import time
from dataclasses import dataclass, field
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.peers import build
from benchmarks.peers.method import Method, require_limits
from benchmarks.peers.problem import POSITION, Case, Problem, load, points_at, stream

Array = NDArray[np.float64]

COARSE, FINE = 1e-3, 1e-6
"""Mean point errors, as shares of the arm length, at which steps are counted; a run ends at the finer."""

STILL = 1e-9
"""A step shorter than this in every joint moves nothing [rad]."""

SAMPLES = 300
"""Steps to time at least, if time allows; the cases are repeated for it."""

WARM = 1.5
"""Time to warm up [s], once or twice."""


@dataclass
class Times:
    """Times of steps [us], by what kind of step it was.

    Attributes:
        first: the first step towards a new target; whoever plans does so in it.
        way: the others, farther than 1e-3 of the arm length from the target.
        closing: those nearer.
        excess: the most that any joint exceeded its speed or position limit by [rad].
    """

    first: list[float] = field(default_factory=list)
    way: list[float] = field(default_factory=list)
    closing: list[float] = field(default_factory=list)
    excess: float = 0.0


def main() -> None:
    """Measure, and write what was found, or why nothing was."""
    parser = argparse.ArgumentParser()
    parser.add_argument("method")
    parser.add_argument("problem", type=Path)
    parser.add_argument("found", type=Path)
    parser.add_argument(
        "--seconds", type=float, default=10.0, help="time for the cases, and again for the stream"
    )
    parser.add_argument("--max-steps", type=int, default=200)
    parser.add_argument("--stream", type=int, default=0, help="steps with a target that moves")
    parser.add_argument("--memory", type=float, default=6.0, help="most memory to ask for [GB]")
    arguments = parser.parse_args()
    most = int(arguments.memory * 1e9)
    resource.setrlimit(resource.RLIMIT_AS, (most, most))
    try:
        found = measured(arguments)
    except MemoryError:
        found = {"reason": f"needs more than {arguments.memory:g} GB of memory"}
    except Exception as error:
        found = {"reason": f"{type(error).__name__}: {error}".splitlines()[0][:200]}
    found["memory_mb"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
    arguments.found.write_text(json.dumps(found))


def measured(arguments: argparse.Namespace) -> dict[str, Any]:
    """Everything about one method on one arm."""
    problem = load(arguments.problem)
    begun = time.perf_counter()
    method = build(arguments.method, problem)
    found: dict[str, Any] = {"setup_s": time.perf_counter() - begun, "reason": ""}
    found["versions"] = {name: _version(name) for name in method.packages}
    if method.whole:
        return found | whole_solves(method, problem, time.perf_counter() + arguments.seconds)
    found["first_step_s"] = warmed_up(method, problem, arguments.max_steps)
    times, runs = Times(), []
    stop = time.perf_counter() + arguments.seconds
    for number, case in enumerate(problem.cases):
        ran = run(method, problem, case, arguments.max_steps, stop, times)
        runs += [] if ran["cut"] else [ran | {"case": number}]
        if time.perf_counter() > stop:
            break
    before, count = -1, len(times.way) + len(times.closing)
    while before < count < SAMPLES and time.perf_counter() < stop:
        for case in problem.cases:
            run(method, problem, case, arguments.max_steps, stop, times)
        before, count = count, len(times.way) + len(times.closing)
    found |= {"runs": runs, "cut": len(problem.cases) - len(runs), "excess": times.excess}
    found["times"] = {name: summary(getattr(times, name)) for name in ("first", "way", "closing")}
    found["times"]["step"] = summary(times.way + times.closing)
    found["check_us"] = _check_time(problem)
    if arguments.stream:
        found["stream"] = streamed(method, problem, arguments.stream, arguments.seconds)
    return found


def warmed_up(method: Method, problem: Problem, max_steps: int) -> float | None:
    """Compile or load kernels, fill caches, take branches; time of the first step [s]."""
    times, case = Times(), problem.cases[-1]
    for _ in range(2):  # the second time, nothing is left to compile on the way there
        ran = run(method, problem, case, max_steps, time.perf_counter() + WARM, times)
        if not ran["cut"]:
            break
    return times.first[0] / 1e6 if times.first else None


def run(
    method: Method, problem: Problem, case: Case, max_steps: int, stop: float, times: Times
) -> dict[str, Any]:
    """One run from a start to a target; `stop` is the moment at which it is cut short."""
    q, length, clock = case.start.copy(), problem.length, time.perf_counter_ns
    reached: dict[str, list[float]] = {}
    begun = clock()
    method.begin()
    method.aim(case.points, case.q)
    spent, reason, steps, cut = clock() - begun, "", 0, False
    while True:
        error = float(np.linalg.norm(points_at(q) - case.points, axis=-1).mean()) / length
        for name, bound in (("coarse", COARSE), ("fine", FINE)):
            if error <= bound and name not in reached:
                reached[name] = [steps, spent / 1e3]
        cut = steps > 0 and time.perf_counter() > stop
        if error <= FINE or steps >= max_steps or reason or cut:
            break
        before = clock()
        try:
            dq = method.step(q)
        except Exception as failure:
            reason = f"{type(failure).__name__}: {failure}".splitlines()[0][:120]
            continue
        after = clock()
        q_next = method.integrate(q, dq)
        spent += clock() - before
        kind = times.first if steps == 0 else times.way if error > COARSE else times.closing
        kind.append((after - before) / 1e3)
        largest = float(np.abs(dq).max())
        times.excess = max(times.excess, largest - problem.bound, float(np.abs(q_next).max()) - POSITION)
        reason = "does not move" if largest < STILL else ""
        q, steps = q_next, steps + 1
    finished = bool(reached.get("fine"))
    return {
        "family": case.family, "steps": steps, "error": error, "whole_us": spent / 1e3, "reason": reason,
        "coarse": reached.get("coarse"), "fine": reached.get("fine"), "cut": cut and not finished,
    }  # fmt: skip


def whole_solves(method: Method, problem: Problem, stop: float) -> dict[str, Any]:
    """A method without steps: one call a case."""
    runs, single = [], []
    for number, case in enumerate((problem.cases[0], *problem.cases)):
        if time.perf_counter() > stop:
            break
        begun = time.perf_counter_ns()
        method.begin()
        method.aim(case.points, case.q)
        q, evaluations = method.solve(case.start)
        spent = (time.perf_counter_ns() - begun) / 1e3
        error = float(np.linalg.norm(points_at(q) - case.points, axis=-1).mean()) / problem.length
        coarse, fine = ([evaluations, spent] if error <= bound else None for bound in (COARSE, FINE))
        if number:
            single.append(spent / evaluations)
            runs.append(
                {"family": case.family, "steps": evaluations, "error": error, "whole_us": spent,
                 "reason": "", "coarse": coarse, "fine": fine, "cut": False, "case": number - 1}
            )  # fmt: skip
    return {"runs": runs, "cut": len(problem.cases) - len(runs), "evaluation": summary(single)}


def streamed(method: Method, problem: Problem, steps: int, seconds: float) -> dict[str, Any]:
    """A target that moves a little each cycle; the step and the sum q + dq are timed, the target is not."""
    path = stream(problem.modules, steps)
    points = points_at(path)
    q, spent, errors, interrupted = path[0].copy(), [], [], []
    method.begin()
    stop = time.perf_counter() + seconds
    for goal, at in zip(path, points, strict=True):
        if time.perf_counter() > stop:
            break
        method.aim(at, goal)
        switches = _interruptions()
        before = time.perf_counter_ns()
        q = method.integrate(q, method.step(q))
        spent.append((time.perf_counter_ns() - before) / 1e3)
        interrupted.append(_interruptions() > switches)
        errors.append(float(np.linalg.norm(points_at(q) - at, axis=-1).mean()) / problem.length)
    alone = summary([time for time, other in zip(spent, interrupted, strict=True) if not other])
    return summary(spent) | {
        "error": float(np.median(errors)),
        "worst_error": float(np.max(errors)),
        "interrupted": sum(interrupted),
        "alone": alone,
    }


def summary(times: list[float]) -> dict[str, float]:
    """Percentiles of times [us], and how many there are."""
    if not times:
        return {"count": 0}
    p50, p95, p99 = np.percentile(times, [50, 95, 99])
    return {
        "count": len(times),
        "p50": float(p50),
        "p95": float(p95),
        "p99": float(p99),
        "max": float(max(times)),
    }


def _interruptions() -> int:
    """How often something else took the processor away so far."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_nivcsw


def _check_time(problem: Problem) -> float:
    """What the check of the output costs those who do it in NumPy, median [us]."""
    q, dq, times = np.zeros(2 * problem.modules), np.zeros(2 * problem.modules), []
    for _ in range(200):
        begun = time.perf_counter_ns()
        require_limits(problem, q, dq)
        times.append((time.perf_counter_ns() - begun) / 1e3)
    return float(np.median(times))


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return ""


if __name__ == "__main__":
    main()
