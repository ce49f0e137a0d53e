"""`pinposture edit`: what is edited, and how it begins and ends."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
from contextlib import contextmanager
from pathlib import Path
from urllib.request import urlopen

import numpy as np
import pytest
from editor.browser.desk import free_port

import pinposture as pp
from pinposture.cli.edit import MODULES, read_task
from pinposture.cli.inputs import ArmOptions
from pinposture.editor.files import autosave_path
from pinposture.editor.solver import judge
from pinposture.errors import FileError, InvalidValue, UnknownName


@pytest.fixture(autouse=True)
def in_a_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def begin(source, split=None, tip=None, modules=None, save_as=None, folder=None):
    return read_task(source, ArmOptions(tip=tip, split=split), save_as, folder, modules)


def test_a_template_begins_with_two_shapes_that_the_arm_can_take(tmp_path):
    task, path = begin("RyRz", None, None, None, None)
    assert (task.arm.n_modules, path) == (MODULES, tmp_path / "ryrz20.toml")
    assert not path.exists()
    for keyframe in task.motion:
        assert judge(task.arm, keyframe, None).target is not None
    assert np.linalg.norm(task.motion[1].curve.start - task.arm.chain.base) < 1e-12


@pytest.mark.parametrize("name", ["RyRz", "RzRy", "Rz", "RzRz", "RzRzRz"])
@pytest.mark.parametrize("count", [1, 2, 7])
@pytest.mark.filterwarnings("ignore:the arm does not follow the curve")
def test_every_template_can_be_begun_with(name, count):
    task, _ = begin(name, None, None, count, None)
    assert task.arm.n_modules == count
    verdicts = [judge(task.arm, keyframe, None) for keyframe in task.motion]
    assert all(verdict.target is not None for verdict in verdicts)


def test_an_urdf_file_is_named_in_the_task_file(tmp_path):
    arm = pp.Arm.from_template("RyRz", 6)
    (tmp_path / "snake.urdf").write_text(arm.urdf)
    task, path = begin("snake.urdf", "2")
    assert path == tmp_path / "snake.toml"
    task.save(path)
    assert 'urdf = "snake.urdf"' in path.read_text()
    again = pp.Task.load(path)
    assert again.arm.control_points == task.arm.control_points
    assert [each.curve for each in again.motion] == [each.curve for each in task.motion]


def test_a_task_file_is_edited_as_it_is(tmp_path):
    task, path = begin("RyRz", None, None, 4, tmp_path / "own.toml")
    task.save(path)
    again, same = begin("own.toml", None, None, None, None)
    assert same == path
    assert again.arm.n_modules == 4


def test_what_was_never_saved_goes_on_from_what_was_kept(tmp_path):
    task, path = begin("RyRz", None, None, 4, None)
    task.edited(name="kept").save(autosave_path(path))
    again, same = begin("ryrz4.toml", None, None, None, None)
    assert (again.name, same) == ("kept", path)
    assert not path.exists()


@pytest.mark.parametrize(
    ("arguments", "kind", "words"),
    [
        (("nothing.toml", None, None, None, None), FileError, "no such file"),
        (("nothing.urdf", None, None, None, None), FileError, "nothing.urdf"),
        (("RyRx", None, None, None, None), UnknownName, "did you mean 'RyRz'"),
        (("RyRz", None, None, 1001, None), InvalidValue, "--modules is 1001; allowed: at most 1000"),
        (("n" * 300 + ".toml", None, None, None, None), FileError, "cannot be read"),
        (("there.toml", "3", None, None, None), InvalidValue, "the task file defines it"),
        (("RyRz", None, "hand", None, None), InvalidValue, "--tip"),
        (("there.toml", None, None, 3, None), InvalidValue, "the task file defines it"),
        (("RyRz", None, None, None, "there.toml"), FileError, "exists already"),
        (("RyRz", None, None, None, "new.csv"), FileError, "the name ends in '.csv'; allowed: .toml, .json"),
    ],
)
def test_what_cannot_be_edited_is_refused_by_name(arguments, kind, words, tmp_path):
    begin("RyRz", None, None, 3, None)[0].save(tmp_path / "there.toml")
    *others, save_as = arguments
    with pytest.raises(kind, match=re.escape(words)):
        begin(*others, None if save_as is None else tmp_path / save_as)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--port", "65536"), "port is 65536; allowed: a whole number from 1 to 65535"),
        (("--port", "0"), "port is 0; allowed"),
        (("--host", "192.0.2.1"), "cannot serve at '192.0.2.1'"),  # of nobody, RFC 5737
        (("--host", "no host"), "cannot serve at 'no host'"),
    ],
)
def test_an_address_that_is_not_to_be_had_is_told_at_once(command, options, words):
    pytest.importorskip("viser", reason="viser is not installed")
    ended = command("edit", "--no-browser", *options)
    assert (ended.code, ended.out, ended.err.count("\n")) == (2, "", 1)
    assert words in ended.err


@pytest.mark.process
@pytest.mark.parametrize("end", [signal.SIGTERM, signal.SIGHUP])  # SIGINT: `edited`, below
def test_it_serves_a_page_until_it_is_ended_and_leaves_nothing_behind(end, tmp_path):
    pytest.importorskip("viser", reason="viser is not installed")
    command = [sys.executable, "-m", "pinposture", "edit", "--no-browser", "--port", str(free_port())]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    process = subprocess.Popen(command, **pipes, cwd=tmp_path)
    url = process.stdout.readline().strip()
    assert "Ctrl-C" in process.stderr.readline()  # and no warning before it: this machine alone is let in
    with urlopen(url, timeout=20) as page:
        assert page.status == 200
    process.send_signal(end)
    out, err = process.communicate(timeout=30)
    assert (process.returncode, out, err.strip()) == (0, "", "")
    assert list(tmp_path.iterdir()) == []
    assert not autosave_path(tmp_path / "ryrz20.toml").exists()


COUNT_THREADS = """
import os, sys
import pinposture.editor
from pinposture.cli import main
def count(*_):
    import numpy.linalg, scipy.linalg
    print(len(os.listdir("/proc/self/task")))
    sys.exit()
pinposture.editor.Editor = count
sys.argv[1:] = ["edit", "--no-browser"]
main()
"""


@pytest.mark.process
@pytest.mark.skipif(not Path("/proc/self/task").is_dir(), reason="threads are counted as Linux lists them")
@pytest.mark.skipif((os.cpu_count() or 1) < 2, reason="there is one core, and so one thread in any case")
def test_it_starts_no_threads_of_linear_algebra():
    pytest.importorskip("viser", reason="viser is not installed")
    own = {name: value for name, value in os.environ.items() if not name.endswith("_NUM_THREADS")}
    without, asked_for = (
        subprocess.run(
            [sys.executable, "-c", COUNT_THREADS], env=env, capture_output=True, text=True, check=True
        )
        for env in (own, own | {"OPENBLAS_NUM_THREADS": "2"})
    )
    # Who asks for more, gets them: one more each for numpy and scipy.
    assert int(asked_for.stdout) >= int(without.stdout) + 2


@pytest.mark.process
def test_it_warns_where_other_machines_are_let_in(tmp_path):
    pytest.importorskip("viser", reason="viser is not installed")
    (tmp_path / "tasks").mkdir()
    with edited(tmp_path, "--host", "0.0.0.0", "--folder", "tasks") as (_, url, notes):
        assert url.startswith("http://127.0.0.1:")
        assert len(url.rsplit("/", 1)[1]) >= 40
        with urlopen(url, timeout=20) as page:
            assert page.status == 200
    assert "anyone who has the address can edit" in notes
    assert f"save files in {tmp_path / 'tasks'}" in notes


@contextmanager
def edited(folder, *options):
    """The command at work in a folder, the address that it printed, what it said besides; ended at last."""
    command = [sys.executable, "-m", "pinposture", "edit", "--no-browser", "--port", str(free_port())]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    process = subprocess.Popen([*command, *options], **pipes, cwd=folder)
    try:
        url = process.stdout.readline().strip()
        notes = ""
        while "Ctrl-C" not in notes:
            notes += process.stderr.readline()
        yield process, url, notes
    finally:
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=30)
    assert (process.returncode, out, err.strip()) == (0, "", "")


def test_a_new_task_is_in_the_folder_that_is_given(tmp_path):
    assert begin("RyRz", None, None, 4, None, Path("sub"))[1] == tmp_path / "sub" / "ryrz4.toml"
