"""Many runs in two processes: how much of the cores they use, and the memory over time.

    python -m benchmarks.studies.many_runs                       # 3,000 runs, in portions of 500
    python -m benchmarks.studies.many_runs --runs 3000 --portion 3000 --json

Targets are drawn as they are needed, and each portion is a call of `track_many` that keeps the ends. From
the scheduler of Linux: the time that the processes computed, that they waited for a core which other programs
had, and that they had nothing to do. Cores used are those on a machine with nothing else to do: the number of
processes, times the share of the time in which each computed or waited for a core. What `track_many` itself
computes in the calling process is told as well: on as many cores as processes it takes that from them.
Starting processes, and drawing targets, is not counted there.
"""

from __future__ import annotations

import argparse
import json
import os
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from time import perf_counter, process_time
from typing import Any, NamedTuple

import numpy as np

import pinposture as pp
from pinposture.arm import smooth_configuration

NANO, PAGE = 1e-9, os.sysconf("SC_PAGE_SIZE") / 1e6


class Usage(NamedTuple):
    """What processes have used so far.

    Attributes:
        when: time of a clock [s].
        computed: time on cores of the children [s].
        waited: time for which they waited for cores [s].
        children: number of them.
        own: time on cores of this process [s].
        memory: of this process, not of its libraries' files [MB].
        largest: most memory of a child [MB].
    """

    when: float
    computed: float
    waited: float
    children: int
    own: float
    memory: float
    largest: float


def read_usage() -> Usage:
    """Return what this process and its children have used so far."""
    tasks = Path("/proc/self/task").glob("*/children")
    pids = [pid for task in tasks for pid in task.read_text().split() if _works(pid)]
    spent = [_scheduled(pid) for pid in pids]
    return Usage(
        when=perf_counter(),
        computed=sum(each[0] for each in spent),
        waited=sum(each[1] for each in spent),
        children=len(pids),
        own=process_time(),
        memory=_memory("self"),
        largest=max(map(_memory, pids), default=0.0),
    )


def _works(pid: str) -> bool:
    """Whether a child makes calls: joblib's tracker of resources does not."""
    return b"tracker" not in Path(f"/proc/{pid}/cmdline").read_bytes()


def _scheduled(pid: str) -> tuple[float, float]:
    """Return the time on cores, and that of waiting for them, of all threads of a process [s]."""
    threads = [file.read_text().split() for file in Path(f"/proc/{pid}/task").glob("*/schedstat")]
    return NANO * sum(int(each[0]) for each in threads), NANO * sum(int(each[1]) for each in threads)


def _memory(pid: str) -> float:
    """Memory of a process that no file holds [MB]."""
    pages = Path(f"/proc/{pid}/statm").read_text().split()
    return PAGE * (int(pages[1]) - int(pages[2]))


def draw_targets(arm: pp.Arm) -> Iterator[pp.Target]:
    """Smooth random postures, without end."""
    rng = np.random.default_rng(0)
    while True:
        yield pp.Target.from_configuration(arm, smooth_configuration(arm, rng, rng.uniform(0.3, 1.0)))


def measure(runs: int, portion: int, jobs: int, modules: int) -> dict[str, Any]:
    """Return cores used, and the memory after each portion."""
    arm = pp.Arm.from_template("RyRz", modules)
    start = arm.straight()
    targets = draw_targets(arm)
    pp.track_many(arm, list(islice(targets, 20 * jobs)), start, jobs=jobs, keep="ends")  # processes start
    before = read_usage()
    usages = [before]
    reached = 0
    drawing = 0.0
    for begun in range(0, runs, portion):
        began = process_time()
        part = list(islice(targets, min(portion, runs - begun)))
        drawing += process_time() - began
        reached += int(pp.track_many(arm, part, start, jobs=jobs, keep="ends").converged.sum())
        usages.append(read_usage())
    after = usages[-1]
    wall = after.when - before.when
    computed = after.computed - before.computed
    busy = computed + after.waited - before.waited
    own = after.own - before.own - drawing
    return {
        "runs": runs,
        "reached": reached,
        "processes": after.children,
        "seconds": wall,
        "computed": computed,
        "cores_used": busy / wall,
        "own": own,
        "own_share": own / (own + computed),
        "memory": [round(usage.memory, 1) for usage in usages],
        "child_memory": [round(usage.largest, 1) for usage in usages],
    }


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--runs", type=int, default=3000)
    parser.add_argument("--portion", type=int, default=500, help="runs of a call")
    parser.add_argument("--jobs", type=int, default=2, help="number of processes")
    parser.add_argument("--modules", type=int, default=20)
    parser.add_argument("--json", action="store_true")
    asked = parser.parse_args()
    found = measure(asked.runs, asked.portion, asked.jobs, asked.modules)
    if asked.json:
        print(json.dumps(found, indent=1))
        return
    print(
        "{runs} runs, {reached} reached, {processes} processes, {seconds:.1f} s: {cores_used:.2f} cores "
        "used, {computed:.1f} s computed there and {own:.2f} s here ({own_share:.1%} of all)".format(**found)
    )
    for where in ("memory", "child_memory"):
        print(where.replace("_", " "), "[MB]:", ", ".join(f"{each:.1f}" for each in found[where]))


if __name__ == "__main__":
    main()
