"""A run that is killed, at whatever moment: what it leaves, and what the next one says."""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

import pinposture as pp

pytestmark = pytest.mark.process

linux = pytest.mark.skipif(
    not Path("/proc/self/fd").exists(), reason="names of open files, as Linux has them"
)
pytestmark = [
    pytest.mark.process,
    pytest.mark.skipif(os.name != "posix", reason="signals of POSIX"),
]

TASK = """\
[arm]
template = "RyRz"
modules = 4
[limits]
cycle = "50 ms"
[[keyframes]]
curve = { type = "line", a = [0, 0, 0], b = [0.2, 0, 0] }
[[keyframes]]
time = "1 s"
curve = { type = "helix", radius = "10 cm", pitch = 0, turns = 0.5 }
trim = true
[output]
formats = ["npz", "csv", "json"]
"""
KEPT = ("motion.json", "motion.csv", "motion.npz")
"""In the order in which they are written."""

# Each run is a process of its own, forked from one that has loaded everything, and kills itself at some
# moment of the writing of a file: when half of it is on the disk, before it gets its name, and after.
RUNS = """
import json, os, signal, sys
import pinposture.cli, pinposture.motion, pinposture.task
import pinposture.storage as storage
synchronise, replace = os.fsync, storage.Path.replace
given = json.loads(sys.argv[1])
pinposture.task.Task.load(given[0][0] + "/task.toml").perform()
for folder, wanted, moment, how in given:
    child = os.fork()
    if child == 0:
        def now(where, name):
            if where == moment and wanted in str(name):
                os.kill(os.getpid(), signal.Signals[how])
        def fsync(file):
            name = os.readlink(f"/proc/self/fd/{file}")
            if moment == "half" and wanted in name:
                os.ftruncate(file, os.fstat(file).st_size // 2)
            now("half", name)
            synchronise(file)
        def moved(self, target):
            now("before", target)
            found = replace(self, target)
            now("after", target)
            return found
        os.fsync, storage.Path.replace = fsync, moved
        signal.signal(signal.SIGINT, signal.default_int_handler)
        sys.argv[1:] = ["run", folder + "/task.toml", "-o", folder + "/out"]
        pinposture.cli.main()
    print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), flush=True)
"""
MOMENTS = [(file, moment) for file in ("status.json", *KEPT) for moment in ("half", "before", "after")]
CASES = [(*each, number % 2 == 1) for number, each in enumerate(MOMENTS)]
"""What is being written, when it stops, and whether there are results of another run."""

INTERRUPTED = ("motion.csv", "half", None)


def environment() -> dict[str, str]:
    path = [str(Path(pp.__file__).parents[1]), *filter(None, [os.environ.get("PYTHONPATH")])]
    kept = {name: value for name, value in os.environ.items() if name != "FORCE_COLOR"}
    return {**kept, "PYTHONPATH": os.pathsep.join(path), "OPENBLAS_NUM_THREADS": "1", "TERM": "xterm"}


def make(folder: Path) -> Path:
    folder.mkdir()
    (folder / "task.toml").write_text(TASK)
    return folder


@pytest.fixture(scope="module")
def killed(tmp_path_factory: pytest.TempPathFactory, command) -> dict[tuple[str, str, bool], Path]:
    """Directories with what runs left that were killed, and INTERRUPTED with what one did that was not."""
    above = tmp_path_factory.mktemp("killed")
    whole = make(above / "whole")
    assert command("run", whole / "task.toml", "-o", whole / "out").code == 0
    folders = {case: make(above / f"{number}") for number, case in enumerate((*CASES, INTERRUPTED))}
    for (_, _, before), folder in folders.items():
        if before:
            shutil.copytree(whole / "out", folder / "out")
            for path in (folder / "out").iterdir():
                os.utime(path, (1e9, 1e9))
    signals = {case: "SIGKILL" for case in CASES} | {INTERRUPTED: "SIGINT"}
    given = [(str(folder), *case[:2], signals[case]) for case, folder in folders.items()]
    line = [sys.executable, "-c", RUNS, json.dumps(given)]
    result = subprocess.run(line, env=environment(), capture_output=True, text=True, timeout=60, check=True)
    assert result.stdout.split() == [str(-signal.SIGKILL)] * len(CASES) + ["130"]
    assert "Traceback" not in result.stderr
    return folders


def check(out: Path) -> list[str]:
    """See that every file under its own name is whole; returns their names."""
    names = sorted(path.name for path in out.iterdir() if not path.name.startswith("."))
    for name in names:
        if name == "status.json":
            json.loads((out / name).read_text())
        elif name == "motion.npz":
            assert pp.load(out / name, pp.Trajectory).converged
        else:
            rows = pp.load(out / name, pp.JointTrajectory).positions
            assert len(rows) > 20
            assert np.all(np.isfinite(rows))
    return names


@linux
@pytest.mark.parametrize(("file", "moment", "before"), CASES)
def test_what_a_killed_run_leaves_and_the_next_one_says(
    killed: dict[tuple[str, str, bool], Path], command, file: str, moment: str, before: bool
) -> None:
    folder = killed[file, moment, before]
    out = folder / "out"
    begun = (file, moment == "after") != ("status.json", False)
    names = check(out)
    drafts = [path.name for path in out.iterdir() if path.name.startswith(".")]
    assert len(drafts) == (moment != "after")
    assert all(re.fullmatch(rf"\.{file}\.[0-9a-f]{{32}}", name) for name in drafts)
    new = {*KEPT[: KEPT.index(file)], *([file] * (moment == "after"))} if file in KEPT else set()
    old = set(KEPT) - new if before else set()
    assert set(names) == new | old | ({"status.json"} if begun or before else set())
    if begun:
        assert json.loads((out / "status.json").read_text())["state"] == "running"
    result = command("run", folder / "task.toml", "-o", out)
    said = result.err.splitlines()[0]
    if begun:
        assert f"a run of {folder / 'task.toml'}, begun 2" in said
        told = said[said.index("that was not finished; it left ") :]
        left, _, rest = told.partition(", and ")
        assert {name for name in KEPT if name in left} == new
        assert {name for name in KEPT if name in rest.partition(" from before it")[0]} == old
    elif before:
        assert "holds the results of" in said
    assert ("half-written files, removed now: 1" in said) == (moment != "after")
    assert check(out) == sorted([*KEPT, "status.json"])
    assert not any(path.name.startswith(".") for path in out.iterdir())
    assert json.loads((out / "status.json").read_text())["state"] == "finished"


@linux
def test_an_interrupted_run_clears_up_after_itself(killed: dict[tuple[str, str, bool], Path]) -> None:
    out = killed[INTERRUPTED] / "out"
    assert check(out) == ["motion.json", "status.json"]
    assert not any(path.name.startswith(".") for path in out.iterdir())
    assert json.loads((out / "status.json").read_text())["state"] == "running"


@pytest.mark.parametrize("later", [0.0, 0.2])
def test_killed_at_no_special_moment(tmp_path: Path, later: float) -> None:
    folder = make(tmp_path / "task")
    line = [sys.executable, "-m", "pinposture", "run", str(folder / "task.toml"), "-o", str(folder / "out")]
    with subprocess.Popen(line, env=environment(), stdout=subprocess.PIPE, stderr=subprocess.PIPE) as child:
        while not (folder / "out" / "status.json").exists() and child.poll() is None:
            time.sleep(0.002)
        time.sleep(later)
        child.kill()
    assert "status.json" in check(folder / "out")


def test_progress_shows_on_a_terminal_and_ctrl_c_ends_it_quietly(tmp_path: Path) -> None:
    import pty

    folder = make(tmp_path / "task")
    text = TASK
    for old, new in (("modules = 4", "modules = 30"), ("0.2", "1.5"), ("50 ms", "1 ms"), ("1 s", "400 s")):
        text = text.replace(old, new, 1)
    (folder / "task.toml").write_text(text.replace("10 cm", "50 cm"))
    ours, theirs = pty.openpty()
    child = subprocess.Popen(
        [sys.executable, "-m", "pinposture", "run", str(folder / "task.toml")],
        env={**environment(), "COLUMNS": "80"},
        stdout=subprocess.PIPE,
        stderr=theirs,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )
    os.close(theirs)
    shown = b""
    while b"posture" not in shown:
        shown += os.read(ours, 1000)
    child.send_signal(signal.SIGINT)
    while True:
        try:
            more = os.read(ours, 1000)
        except OSError:  # how Linux ends a pseudo-terminal
            break
        shown += more
        if not more:
            break
    assert child.wait(60) == 130
    assert child.stdout.read() == b""
    assert b"running" in shown
    assert b"Traceback" not in shown
