"""`pinposture identify`: numbers of drives from a table, and what it cannot tell."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from pinposture.sim import DriveModel, Drives


@pytest.fixture(scope="module")
def arm_of_two(command, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("arm") / "arm.urdf"
    assert command("generate", "RyRz", "--modules", 1, "-o", path).code == 0
    return path


@pytest.fixture(scope="module")
def log_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A log of both joints, twelve seconds long."""
    path = tmp_path_factory.mktemp("log") / "log.csv"
    times = 0.01 * np.arange(1200)
    sent = 0.6 * np.sin(2.0 * times[:, None] * [1.0, 1.5])
    drives = Drives(DriveModel(lag=0.2, friction=0.05, delay=0.03), sent[0], 0.01)
    measured = np.array([sent[0], *(drives.advance(row) for row in sent[:-1])])
    head = ",".join(f"m01_{joint} {kind}" for kind in ("command", "position") for joint in ("j1_y", "j2_z"))
    np.savetxt(
        path, np.column_stack([times, sent, measured]), delimiter=",", header=f"time,{head}", comments=""
    )
    return path


def test_drives_are_told_with_intervals_and_what_is_not(command, arm_of_two, log_file, tmp_path):
    picture = tmp_path / "fit.png"
    result = command("identify", arm_of_two, log_file, "--plot", picture)
    assert result.code == 0
    assert "lag" in result.out and "0.2 s (0.2 to 0.2)" in result.out
    assert "m01_j2_z" in result.out
    assert "not identified: stiffness: the attitude of the arm is not known" in result.err
    assert result.err.splitlines()[-1] == f"wrote {picture}"
    assert picture.read_bytes().startswith(b"\x89PNG\r\n")


def test_json_has_every_number(command, arm_of_two, log_file):
    result = command(
        "identify", arm_of_two, log_file, "--gravity", "0,0,-9.81", "--carried", "100 g", "--json"
    )
    told = json.loads(result.out)
    assert told["drives"]["delay"]["value"] == pytest.approx(0.03, abs=1e-3)
    assert told["joints"]["m01_j1_y"]["friction"]["value"] == pytest.approx(0.05, abs=1e-3)
    assert told["not_identified"]["stiffness"].startswith("the sag by weight is not told")
    assert told["plot"] is None


def test_a_table_without_commands_is_refused_in_a_line(command, arm_of_two, log_file, tmp_path):
    path = tmp_path / "states.csv"
    path.write_text("time,m01_j1_y\n0,0\n0.1,0.2\n")
    result = command("identify", arm_of_two, path)
    assert result.code == 2
    assert len(result.err.splitlines()) == 1
    assert "has no commands of joints" in result.err
