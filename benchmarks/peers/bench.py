"""Our controllers and the field on the same seeded cases, in one run: `make bench`.

    python -m benchmarks.peers.bench [--quick] [--sizes 40 100] [--methods geodesic placo] [--save FILE]
        [--compare FILE]

Each method on each size runs in a process of its own, one at a time, on one thread. What is measured, and
how each peer is set up: docs/speed.md, and the head of each file in benchmarks/peers. Times depend on the
machine and on who else uses it: compare figures of one run.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from benchmarks.peers import METHODS, environments, plot, report, startup
from benchmarks.peers.problem import problem, save

ROOT = Path(__file__).resolve().parents[2]
OUT = ROOT / "out" / "bench"

SINGLE = {
    name: "1" for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
}
"""One thread for everybody."""

SIZES = (40, 100, 200, 400, 1000, 2000)
QUICK = (40, 100)
STREAMED = 40
"""DOF of the arm that follows a moving target for long."""

BRIEFLY = 100
"""Steps for which those of other sizes do."""

LATE = "not done"
"""How the reason begins if a process was stopped because it took too long."""

WIDTH = 150
"""Of tables that go to a file [characters]."""

CASES = ((40, 30), (100, 10), (200, 6), (400, 4), (1000, 2))
"""Cases of each family up to so many DOF; one beyond."""


def main() -> None:
    """Prepare, measure, print, save, compare, plot."""
    arguments = parsed()
    console = Console()
    console = console if console.is_terminal else Console(width=WIDTH)
    sizes = sorted(set(arguments.sizes or (QUICK if arguments.quick else SIZES)))
    before = json.loads(arguments.compare.read_text()) if arguments.compare else None
    arguments.out.mkdir(parents=True, exist_ok=True)
    names = {METHODS[name].environment for name in arguments.methods} | {"ours"}
    with console.status("environments") as status:
        where = environments.here(names) if arguments.here else environments.prepare(names, status.update)
    if where["ours"].python is not None:
        with console.status("kernels of this library, compiled if they are not yet"):
            ahead = [where["ours"].python, "-m", "pinposture", "compile"]
            subprocess.run(ahead, env=os.environ | SINGLE, capture_output=True, check=False)
    found: dict[str, Any] = {
        "machine": machine(),
        "environments": {name: each.reason for name, each in where.items()},
        "results": [],
        "pieces": {},
        "startup": None,
    }
    before_run = source()
    jobs = [(size, name) for size in sizes for name in arguments.methods]
    repeats = 2 if arguments.quick else 7
    extra = 0 if arguments.steps_only else startup.rounds(repeats) + len(sizes)
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console, transient=True) as progress:
        task = progress.add_task("cases", total=len(jobs) + extra)
        for size in sizes:
            cases = next((count for most, count in CASES if size <= most), 1)
            save(problem_file(arguments.out, size), problem(size // 2, 2 if arguments.quick else cases))
        for size, name in jobs:
            progress.update(task, description=f"{METHODS[name].label}, {size} DOF")
            found["results"].append(one(name, size, where, arguments, found["results"]))
            progress.advance(task)
        if not arguments.steps_only:
            python = where["ours"].python
            for size in sizes:
                progress.update(task, description=f"pieces, {size} DOF")
                found["pieces"][str(size)] = pieces(size, python, arguments)
                progress.advance(task)
            progress.update(task, description="imports")
            found["startup"] = started(python, repeats, lambda: progress.advance(task))
    found["machine"]["source_changed"] = source() != before_run
    found["machine"]["load_after"] = os.getloadavg()[0]
    for path in filter(None, (arguments.out / "latest.json", arguments.save)):
        path.write_text(json.dumps(found, indent=1) + "\n")
    report.show(console, found, before)
    plot.save(found, arguments.out / "steps.png")
    console.print(f"figures: {arguments.out / 'latest.json'}, plot: {arguments.out / 'steps.png'}")


def parsed() -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--sizes", type=even, nargs="+", help="DOF, even numbers")
    listed = f"of {', '.join(METHODS)}"
    parser.add_argument(
        "--methods", nargs="+", choices=list(METHODS), default=list(METHODS), metavar="METHOD", help=listed
    )
    parser.add_argument("--quick", action="store_true", help="two sizes, two cases each, short streams")
    parser.add_argument(
        "--seconds", type=float, help="time for the cases of a method on a size, and for a stream"
    )
    parser.add_argument("--memory", type=float, default=6.0, help="most memory of a process [GB]")
    parser.add_argument("--save", type=Path, help="write all figures here, for --compare")
    parser.add_argument("--compare", type=Path, help="an earlier file of --save; adds the ratio of medians")
    parser.add_argument("--out", type=Path, default=OUT, help="where the plot and the latest figures go")
    parser.add_argument("--steps-only", action="store_true", help="no pieces, no imports")
    parser.add_argument("--here", action="store_true", help="no environments: what this Python can import")
    arguments = parser.parse_args()
    arguments.seconds = arguments.seconds or (2.0 if arguments.quick else 10.0)
    return arguments


def even(text: str) -> int:
    """A number of DOF: two a module."""
    if int(text) < 2 or int(text) % 2:
        raise argparse.ArgumentTypeError(f"{text} is not an even number of at least 2")
    return int(text)


def problem_file(out: Path, size: int) -> Path:
    """Where the cases of a size are."""
    return out.absolute() / f"problem_{size}.npz"


def one(
    name: str,
    size: int,
    where: dict[str, environments.Environment],
    arguments: argparse.Namespace,
    done: list[dict[str, Any]],
) -> dict[str, Any]:
    """One method on one size."""
    entry, environment = METHODS[name], where[METHODS[name].environment]
    found: dict[str, Any] = {"method": name, "dof": size}
    if environment.python is None:
        return found | {"reason": environment.reason}
    if size > entry.largest:
        return found | {"reason": f"not run beyond {entry.largest} DOF"}
    slow = [each["dof"] for each in done if each["method"] == name and each["reason"].startswith(LATE)]
    if slow:
        return found | {"reason": f"not tried: too slow at {slow[0]} DOF"}
    steps = (1000 if arguments.quick else 10_000) if size == STREAMED else BRIEFLY
    options = ["--seconds", arguments.seconds, "--memory", arguments.memory]
    options += ["--stream", steps]
    command = [environment.python, "-m", "benchmarks.peers.measure", name]
    return found | child(command, options, size, arguments.out, 3 * arguments.seconds + 30)


def pieces(size: int, python: str | None, arguments: argparse.Namespace) -> dict[str, Any]:
    """The parts of a cycle of ours on one size."""
    seconds = arguments.seconds / 10
    command = [python or sys.executable, "-m", "benchmarks.peers.pieces"]
    return child(command, ["--seconds", seconds], size, arguments.out, arguments.seconds + 15)


def child(command: list[Any], options: list[Any], size: int, out: Path, seconds: float) -> dict[str, Any]:
    """Run a script that takes a problem and writes JSON; what it wrote, or the reason why it did not."""
    answer = out.absolute() / "answer.json"
    answer.unlink(missing_ok=True)
    words = [str(word) for word in (*command, problem_file(out, size), answer, *options)]
    try:
        ran = subprocess.run(
            words,
            cwd=ROOT,
            env=os.environ | SINGLE,
            capture_output=True,
            text=True,
            timeout=seconds,
            check=False,
        )
    except subprocess.TimeoutExpired:
        late = f"{LATE} after {seconds:.0f} s"
        return json.loads(answer.read_text()) if answer.exists() else {"reason": late}
    if not answer.exists():
        return {"reason": (ran.stderr.strip().splitlines() or [f"ended with {ran.returncode}"])[-1][:200]}
    found: dict[str, Any] = json.loads(answer.read_text())
    answer.unlink()
    return found


def started(python: str | None, repeats: int, told: Callable[[], object]) -> dict[str, Any]:
    """Imports and first steps, or the reason why there are none."""
    try:
        return startup.measure(python or sys.executable, SINGLE, repeats, told)
    except subprocess.SubprocessError as error:
        return {"reason": str(error)[:200]}


def source() -> list[tuple[str, int]]:
    """The files of this library and when they were written: whoever edits them meanwhile spoils a run."""
    files = (ROOT / "pinposture").rglob("*.py")
    return sorted((str(file), file.stat().st_mtime_ns) for file in files)


def machine() -> dict[str, Any]:
    """What it ran on."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.exists() else []
    model = next(
        (line.split(":")[1].strip() for line in lines if line.startswith("model name")), platform.processor()
    )
    return {
        "processor": model,
        "cores": os.cpu_count(),
        "python": platform.python_version(),
        "system": platform.platform(),
        "load_before": os.getloadavg()[0],
        "when": time.strftime("%Y-%m-%d %H:%M"),
    }


if __name__ == "__main__":
    main()
