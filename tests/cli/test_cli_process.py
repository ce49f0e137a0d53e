"""The command in a process of its own: streams, signals, terminals."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
import warnings
from pathlib import Path

import pytest

import pinposture
from pinposture.cli import app
from pinposture.cli.output import count_progress, warnings_as_notes

COMMAND = [sys.executable, "-m", "pinposture"]
posix = pytest.mark.skipif(os.name != "posix", reason="signals and pseudo-terminals of POSIX")


def environment(**more: str) -> dict[str, str]:
    """This environment without what would change colours and widths, and with this package to import."""
    kept = {name: value for name, value in os.environ.items() if name not in ("FORCE_COLOR", "COLUMNS")}
    path = [str(Path(pinposture.__file__).parents[1]), *filter(None, [os.environ.get("PYTHONPATH")])]
    return {**kept, "PYTHONPATH": os.pathsep.join(path), **more}


def process(*arguments: object, **options: object) -> subprocess.CompletedProcess[str]:
    line = [*COMMAND, *map(str, arguments)]
    options = {"env": environment(), "capture_output": True, "text": True, "timeout": 60, **options}
    return subprocess.run(line, check=False, **options)


@pytest.mark.process
def test_stdout_holds_one_json_object_and_nothing_else(arm_file, tmp_path):
    result = process("track", arm_file, "--curve", "helix", "--steps", 5, "--json", "-o", tmp_path)
    assert result.returncode == 1  # it is too short to get there
    assert json.loads(result.stdout)["steps"] == 5
    assert result.stderr.splitlines() == [
        f"wrote {tmp_path / name}" for name in ("run.png", "run.html", "run.npz")
    ]


STARTED = ("track", "inspect", "generate", "view", "edit")
"""Verbs that other tests start in processes of their own."""


# Packages of others, which take longest to import, are there; each child imports this one for itself.
HELP_OF_ALL = """
import os, sys
import joblib, numba, pinocchio, rich.markdown, tomlkit, typer.rich_utils
import scipy.interpolate, scipy.spatial.transform
from pydantic import TypeAdapter
numba.njit("f8(f8)")(lambda x: x)  # what numba imports when it first compiles
for verb in sys.argv[1:]:
    child = os.fork()
    if child == 0:
        assert not any(name.startswith("pinposture") for name in sys.modules)
        sys.argv = ["pinposture", verb, "--help"]
        from pinposture.cli import main
        main()
    assert os.waitpid(child, 0)[1] == 0, verb
"""


@pytest.mark.process
@posix
def test_every_verb_starts_in_a_process_of_its_own():
    verbs = [verb.name for verb in app.registered_commands if verb.name not in STARTED]
    line = [sys.executable, "-c", HELP_OF_ALL, *verbs]
    result = subprocess.run(
        line, env=environment(COLUMNS="80"), capture_output=True, text=True, timeout=120, check=False
    )
    assert (result.returncode, result.stderr) == (0, "")
    assert re.findall(r"Usage: pinposture (\w+) ", result.stdout) == verbs


@pytest.mark.long
def test_an_error_is_one_line_on_stderr_with_code_2(tmp_path):
    file = tmp_path / "broken.urdf"
    file.write_text("<robot name='r'><link/></robot>")
    result = process("inspect", file)
    assert (result.returncode, result.stdout) == (2, "")
    assert result.stderr.startswith(f"error: {file}: ")
    assert result.stderr.count("\n") == 1
    assert "Traceback" not in result.stderr


@pytest.mark.process
@pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no full device")
def test_output_that_cannot_be_written_is_an_error_in_one_line(arm_file):
    for options in ((), ("--json",)):
        with Path("/dev/full").open("w") as full:
            line = [*COMMAND, "inspect", str(arm_file), *options]
            result = subprocess.run(
                line, env=environment(), stdout=full, stderr=subprocess.PIPE, text=True, check=False
            )
        assert result.stderr == "error: the output cannot be written (No space left on device)\n"
        assert result.returncode == 2


@pytest.mark.process
def test_notes_come_whatever_the_filters_say_and_leave_other_warnings_alone(arm_file, tmp_path):
    file = tmp_path / "limitless.urdf"
    file.write_text(re.sub(r'lower="\S+" upper="\S+"', "", arm_file.read_text()))
    for filters in ("ignore", "error"):
        result = process("inspect", file, "--json", env=environment(PYTHONWARNINGS=filters))
        assert result.returncode == 0
        assert json.loads(result.stdout)["dof"] == 12
        assert [line[:26] for line in result.stderr.splitlines()] == ["note: no limits are given "]
    with pytest.warns(UserWarning, match="another"), warnings_as_notes():
        warnings.warn("another", UserWarning, stacklevel=1)


@pytest.mark.process
def test_a_bug_shows_its_traceback_without_dumping_variables(arm_file):
    code = (
        "import pinposture.motion, pinposture.cli\n"
        "def broken(*_, **__): raise ZeroDivisionError('a bug')\n"
        "pinposture.motion.track = broken\n"
        f"pinposture.cli.app(['track', {str(arm_file)!r}, '--curve', 'helix'])\n"
    )
    result = subprocess.run(
        [sys.executable, "-c", code], env=environment(), capture_output=True, text=True, check=False
    )
    assert result.returncode == 1
    assert result.stderr.startswith("Traceback")
    assert result.stderr.endswith("ZeroDivisionError: a bug\n")
    assert "locals" not in result.stderr


def heed_interrupts() -> None:
    """For a child: processes started in the background of a script inherit that Ctrl-C is ignored."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


@pytest.mark.process
@posix
@pytest.mark.parametrize("arguments", [("inspect", "ARM"), ("generate", "RyRz", "-n", 300)])
def test_a_reader_that_goes_away_is_no_news(arm_file, arguments):
    line = [*COMMAND, *(str(arm_file) if word == "ARM" else str(word) for word in arguments)]
    child = subprocess.Popen(line, env=environment(), stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    child.stdout.close()
    assert child.stderr.read() == b""
    assert child.wait(60) != 0


@pytest.mark.process
@posix
def test_progress_shows_on_a_terminal_and_ctrl_c_ends_it_quietly(tmp_path, command):
    import pty

    arm = tmp_path / "arm.urdf"
    command("generate", "RyRz", "--modules", 60, "--link-lengths", "0.008,0.008", "-o", arm)
    ours, theirs = pty.openpty()
    line = [*COMMAND, "track", str(arm), "--curve", "helix", "--step-limit", "1e-5", "--steps", "100000"]
    child = subprocess.Popen(
        [*line, "-o", str(tmp_path / "out"), "--json"],
        env=environment(TERM="xterm", COLUMNS="80"),
        stdout=subprocess.PIPE,
        stderr=theirs,
        preexec_fn=heed_interrupts,
    )
    os.close(theirs)
    shown = b""
    while b"point error" not in shown:
        shown += os.read(ours, 1000)
    child.send_signal(signal.SIGINT)
    assert child.stdout.read() == b""
    assert child.wait(60) == 130
    while True:
        try:
            more = os.read(ours, 1000)
        except OSError:  # how Linux ends a pseudo-terminal
            break
        if not more:
            break
        shown += more
    assert b"of 100000" in shown
    assert b"Traceback" not in shown
    assert b"Abort" not in shown
    assert sorted(path.name for path in tmp_path.iterdir()) == ["arm.urdf"]


def in_own_session(line, **options):
    """A process whose children can be told by its session."""
    pipe = subprocess.PIPE
    shared = {"env": environment(), "text": True, "start_new_session": True}
    return subprocess.Popen(line, stdout=pipe, stderr=pipe, **shared, **options)


@pytest.mark.process
@posix
def test_ctrl_c_closes_the_viewer_and_leaves_no_process_behind(run_directory):
    line = [*COMMAND, "view", str(run_directory), "--no-browser"]
    child = in_own_session(line, preexec_fn=heed_interrupts)
    address = child.stdout.readline()
    assert address.startswith("http://")
    assert "Ctrl-C" in child.stderr.readline()
    child.send_signal(signal.SIGINT)
    _, errors = child.communicate(timeout=60)
    assert child.returncode == 0
    assert errors.strip() == ""
    with pytest.raises(ProcessLookupError):
        os.killpg(child.pid, 0)


def test_the_command_line_itself_loads_nothing_heavy():
    # The package is replaced by an empty one, so that only what the command line asks for is loaded.
    code = (
        "import sys, types\n"
        "package = types.ModuleType('pinposture')\n"
        f"package.__path__ = [{str(Path(pinposture.__file__).parent)!r}]\n"
        "sys.modules['pinposture'] = package\n"
        "import pinposture.cli\n"
        "heavy = {'numpy', 'scipy', 'pinocchio', 'matplotlib', 'meshcat', 'joblib'}\n"
        "print(sorted(heavy & set(sys.modules)))\n"
    )
    result = subprocess.run(
        [sys.executable, "-c", code], env=environment(), capture_output=True, text=True, check=True
    )
    assert result.stdout == "[]\n"


@pytest.mark.process
def test_what_is_done_is_logged_if_asked_for(arm_file):
    told = process("--verbose", "track", arm_file, "--curve", "helix", "--steps", 3, "--json")
    assert json.loads(told.stdout)["steps"] == 3
    assert "pinposture.control.planner.plan: " in told.stderr


@pytest.mark.process
def test_there_are_completion_scripts():
    named = environment(_TYPER_COMPLETE_TEST_DISABLE_SHELL_DETECTION="1")  # there may be no shell above
    assert "_pinposture_completion" in process("--show-completion", "bash", env=named).stdout


def test_a_terminal_sees_how_much_is_done(monkeypatch, capsys):
    with count_progress("run") as tell:
        tell(1, 4)
    assert capsys.readouterr().err == ""
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setattr("sys.stderr.isatty", lambda: True)
    with count_progress("run") as tell:
        assert "first run, 0 s" in capsys.readouterr().err
        tell(3, 4)
    assert "run 3 of 4" in capsys.readouterr().err


def in_session(leader: int) -> list[int]:
    """The processes of a session, as Linux lists them; without those that have ended."""
    found = []
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            state, _, _, session = (folder / "stat").read_text().rpartition(")")[2].split()[:4]
        except (FileNotFoundError, ProcessLookupError):
            continue
        if int(session) == leader and state != "Z":
            found.append(int(folder.name))
    return found


@pytest.mark.long
@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="/proc lists the processes")
@pytest.mark.parametrize("everybody", [True, False])
def test_a_batch_that_is_interrupted_ends_with_all_its_processes(arm_file, everybody):
    options = ["--curve", "helix", "--partial", "--count", "5000", "--jobs", "2"]
    line = [*COMMAND, "batch", str(arm_file), *options]
    running = in_own_session(line)
    try:
        while len(in_session(running.pid)) < 3 and running.poll() is None:
            time.sleep(0.1)
        (os.killpg if everybody else os.kill)(running.pid, signal.SIGINT)
        _, told = running.communicate(timeout=60)  # starting processes may say that they were ended
        assert running.returncode == 130, told
        for _ in range(100):
            if not in_session(running.pid):
                return
            time.sleep(0.1)
        raise AssertionError(f"still there: {in_session(running.pid)}")
    finally:
        for left in in_session(running.pid):
            os.kill(left, signal.SIGKILL)
