"""Files appear whole or not at all."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import reloaded

import pinposture as pp
from pinposture.arm import TEMPLATES
from pinposture.errors import FileError
from pinposture.sim import Simulation, simulate
from pinposture.storage import check_writable, write_bytes, write_text


def test_a_file_is_written_and_replaced(tmp_path: Path) -> None:
    path = tmp_path / "new" / "file"
    write_text(path, "grün")
    write_bytes(path, b"two")
    assert path.read_bytes() == b"two"
    assert [file.name for file in path.parent.iterdir()] == ["file"]
    beside = tmp_path / "plain"
    beside.touch()
    assert path.stat().st_mode == beside.stat().st_mode


@pytest.mark.parametrize("error", [KeyboardInterrupt(), OSError(28, "No space left on device")])
def test_an_interrupted_write_leaves_the_old_file_and_no_other(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: BaseException
) -> None:
    path = tmp_path / "file"
    path.write_bytes(b"old")

    def fail(_: int) -> None:
        raise error

    monkeypatch.setattr(os, "fsync", fail)
    with pytest.raises((KeyboardInterrupt, FileError)):
        write_bytes(path, b"new")
    assert path.read_bytes() == b"old"
    assert [file.name for file in tmp_path.iterdir()] == ["file"]


def test_a_link_stays_a_link(tmp_path: Path) -> None:
    (tmp_path / "link").symlink_to(tmp_path / "real")
    write_bytes(tmp_path / "link", b"x")
    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "real").read_bytes() == b"x"


def test_what_cannot_be_written_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    os.mkfifo(tmp_path / "pipe")
    for path, reason in (
        (tmp_path, "a directory"),
        (tmp_path / "pipe", "a device"),
        (tmp_path / "file" / "below" / "x", "is a file; allowed: a directory"),
    ):
        with pytest.raises(FileError, match=reason):
            write_bytes(path, b"")
    check_writable(tmp_path / "not" / "yet")
    assert not (tmp_path / "not").exists()


@pytest.mark.parametrize("kind", [pp.Run, pp.Trajectory, pp.Batch, Simulation])
@pytest.mark.parametrize("name", ["x.h5", "x.txt", "x.npz.bak", "x.5"])
def test_no_ending_but_its_own_is_taken_or_lengthened(kind: type, name: str, tmp_path: Path) -> None:
    arm = pp.Arm.from_template("RyRz", 1)
    goal = pp.Target.from_configuration(arm, [0.1, 0.1])
    run = pp.track(arm, goal, arm.neutral(), "joint", pp.Limits(dt=0.1))
    made = {
        pp.Run: lambda: run,
        pp.Trajectory: lambda: pp.Trajectory(
            run, run.points, run.point_errors >= 0.0, 0.1 * np.arange(run.steps + 1.0), 0, 0.1 * run.steps
        ),
        pp.Batch: lambda: pp.track_many(arm, goal, arm.neutral(), "joint"),
        Simulation: lambda: simulate(arm, run),
    }[kind]()
    with pytest.raises(FileError, match=rf"the name ends in '\{Path(name).suffix}'; allowed: \.npz, or no"):
        pp.save(made, tmp_path / name)
    with pytest.raises(FileError, match=r"allowed: \.html, \.htm, or no ending"):
        pp.save_html(arm, run, tmp_path / name)
    assert list(tmp_path.iterdir()) == []
    assert pp.save(made, tmp_path / "x") == tmp_path / "x.npz"
    assert pp.save(made, tmp_path / "y.NPZ") == tmp_path / "y.NPZ"


def test_links_in_a_circle_are_refused_and_stay(tmp_path: Path) -> None:
    circle = tmp_path / "circle"
    circle.symlink_to(circle)
    with pytest.raises(FileError, match="circle"):
        write_bytes(circle, b"new")
    assert circle.is_symlink()


@pytest.fixture(scope="module")
def reader() -> Iterator[subprocess.Popen[str]]:
    """Another process, which has made none of the files that it reads."""
    command = [sys.executable, reloaded.__file__]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        yield process


@pytest.mark.process
@pytest.mark.filterwarnings("ignore::pinposture.errors.PostureWarning")
@pytest.mark.parametrize(
    ("name", "coupling"),
    [(name, each) for name in TEMPLATES for each in ("free", "coupled", "driven from behind")][:-2],
)  # a continuum, the last, has couplings of its own
def test_another_process_reads_all_that_was_saved(
    reader: subprocess.Popen[str], name: str, coupling: str, tmp_path: Path
) -> None:
    arm = pp.Arm.from_template(name, modules=4)
    written = reloaded.write_all(reloaded.couple(arm, coupling), tmp_path)
    print(tmp_path, file=reader.stdin, flush=True)
    assert reader.stdout.readline().strip() == str(tmp_path)
    for file, original in written.items():
        expected = reloaded.say(original)
        with np.load(tmp_path / f"{file}.told.npz") as told:
            assert set(told.files) == set(expected)
            for key, value in expected.items():
                if (file, key) == ("joints.json", "time"):  # in whole nanoseconds
                    np.testing.assert_allclose(told[key], value, rtol=0.0, atol=1e-9)
                else:
                    np.testing.assert_array_equal(told[key], value, err_msg=f"{file}: {key}")
