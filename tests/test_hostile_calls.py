"""Nothing that is given to a public function ends the process, and what is wrong is a PostureError.

Each call is made in a process that may die of it; another one makes the calls that are left.
"""

from __future__ import annotations

import os
import queue
import random
import subprocess
import sys
import threading
from pathlib import Path

import pytest

PROGRAM = str(Path(__file__).with_name("hostile_calls.py"))
SHARE = 36
"""One of so many cases is made in each run of the test; all take ten minutes of two cores.

Others are made each time, unless hypothesis has a seed.

    python tests/hostile_calls.py list | python tests/hostile_calls.py run | grep '^end' | grep -v 'fine$'
"""
HUGE = ("1e200", "-1e154", "1e308", "nan")
"""Coordinates of points that once ended the process: these cases are made in each run."""
LONGEST = 120.0
"""How long the start of a process and a call may take, on a busy machine [s]; more means that it hangs."""


def make_calls(names: list[str]) -> list[str]:
    """Make calls in processes; return those that ended badly, and how."""
    bad = []
    left = names
    while left:
        done, ended = _calls_of_a_process(left, bad)
        if ended:
            break
        left = left[done + 1 :]
    return bad


def _calls_of_a_process(names: list[str], bad: list[str]) -> tuple[int, bool]:
    """Return how many calls a process has survived, and whether it has made all."""
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}
    command = [sys.executable, PROGRAM, "run"]
    process = subprocess.Popen(
        command, env=environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert process.stdin is not None
    process.stdin.write("\n".join(names))
    process.stdin.close()
    lines: queue.Queue[str] = queue.Queue()
    threading.Thread(target=_pass_on, args=(process, lines), daemon=True).start()
    done = 0
    while True:
        try:
            line = lines.get(timeout=LONGEST)
        except queue.Empty:
            process.kill()
            process.wait()
            bad.append(f"{names[done]}: does not end")
            return done, False
        if not line:
            break
        if line.startswith("end "):
            done += 1
            if not line.endswith("-> fine\n"):
                bad.append(line.removeprefix("end ").strip())
    code = process.wait()
    if done < len(names):
        bad.append(f"{names[done]}: ends the process, exit code {code}")
    return done, done == len(names)


def _pass_on(process: subprocess.Popen[str], lines: queue.Queue[str]) -> None:
    assert process.stdout is not None
    for line in process.stdout:
        lines.put(line)
    lines.put("")


@pytest.mark.process
def test_whatever_the_value_each_call_gives_a_result_or_an_error_of_this_package(
    pytestconfig: pytest.Config, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from hostile_calls import cases

    monkeypatch.chdir(tmp_path)  # some of the examples are files
    every = cases()
    assert len(every) > 10_000
    seeded = pytestconfig.getoption("hypothesis_seed") is not None
    names = every[0 if seeded else random.randrange(SHARE) :: SHARE]
    huge = [f"{call}|target.points.0.0|{number}" for call in ("track", "plan") for number in HUGE]
    assert set(huge) <= set(every)
    assert make_calls([*huge, *names]) == []
