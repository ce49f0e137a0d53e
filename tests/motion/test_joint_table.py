"""Joint motions as tables: what spreadsheets and others make of them, and what is refused by line."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from motion.joint_motions import FILES, MOMENTS, POSITIONS, TABLES, assert_same, motions, written

import pinposture as pp
from pinposture.errors import FileError
from pinposture.motion.joint_trajectory import JointTrajectory

HEAD = "time [s],a position [rad],a velocity [rad/s]\n"


@FILES
@given(motions())
def test_tables_come_back_to_the_last_bit(tmp_path: Path, motion: JointTrajectory) -> None:
    assert_same(pp.load(pp.save(motion, tmp_path / "motion.CSV"), JointTrajectory), motion)


def test_a_table_has_headings_with_units_that_a_spreadsheet_reads(tmp_path: Path) -> None:
    motion = JointTrajectory.from_positions(
        ["a, b", "c"], [[0.0, 1.0], [0.5, 3.0], [2.0, 3.0]], 0.5, ["rad", "m"]
    )
    with pp.save(motion, tmp_path / "a.csv").open(newline="", encoding="utf-8") as file:
        rows = list(csv.reader(file))
    assert rows[0] == [
        "time [s]",
        "a, b position [rad]",
        "a, b velocity [rad/s]",
        "a, b acceleration [rad/s^2]",
        "c position [m]",
        "c velocity [m/s]",
        "c acceleration [m/s^2]",
    ]
    assert [list(map(float, row)) for row in rows[1:]] == [
        [0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0],
        [0.5, 0.5, 2.0, 4.0, 3.0, 2.0, -8.0],
        [1.0, 2.0, 0.0, 0.0, 3.0, 0.0, 0.0],
    ]


@pytest.mark.parametrize(
    "text",
    [
        "time [s],a position [rad],b position [m]\n0.5,0,1\n1.5,0.1,1\n2.5,0.4,0.5\n3.5,0.5,0.5\n",
        "\ufefftime [s], a position [rad], b position [m]\r\n# by hand\r\n0.5, 0, 1\r\n\r\n1.5,1e-1,1\r\n"
        "2.5,.4,.5\r\n3.5,0.5,0.5",
        '"time [s]", "b position [m]", "a position [rad]"\n0.5,1,0\n1.5,1,0.1\n2.5,0.5,0.4\n3.5,0.5,0.5\n',
    ],
)
def test_tables_of_others_with_positions_alone_are_read(tmp_path: Path, text: str) -> None:
    found = pp.load(written(tmp_path, "a.csv", text), JointTrajectory)
    order = [found.joint_names.index(name) for name in "ab"]
    expected = JointTrajectory.from_positions(["a", "b"], POSITIONS, MOMENTS)
    for name in TABLES[1:]:
        np.testing.assert_array_equal(getattr(found, name)[:, order], getattr(expected, name))
    np.testing.assert_array_equal(found.time, expected.time)
    assert [found.units[k] for k in order] == ["rad", "m"]


def test_rates_in_a_table_are_kept_as_they_are(tmp_path: Path) -> None:
    text = "time [s],a velocity,a position\n0,7,0\n1,8,5\n2,9,6\n"
    found = pp.load(written(tmp_path, "a.csv", text), JointTrajectory)
    assert found.velocities[:, 0].tolist() == [7.0, 8.0, 9.0]
    assert found.accelerations[:, 0].tolist() == [0.0, -4.0, 0.0]
    assert found.units == ("",)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("", "is empty"),
        ("\n# nothing\n", "is empty"),
        (HEAD, "contains headings but no rows"),
        ("0,1,2\n", "line 1, column 1: '0'; allowed: 'time [s]'"),
        ("time [s]\n0\n", "line 1: no joints"),
        ("# x\ntime [ms],a position\n0,1\n", "line 2, column 1: 'time [ms]'"),
        (
            "time [s],a angle [rad]\n",
            "line 1, column 2: 'a angle [rad]'; allowed: name of a joint, one of position",
        ),
        ("time [s],a position [deg]\n", "column 2: 'a position [deg]': unit 'deg'; allowed: rad, m"),
        ("time [s],a position [rad/s]\n", "unit 'rad/s'; allowed: rad, m"),
        (
            "time [s],a position [rad],a velocity [m/s]\n",
            "column 3: 'a velocity [m/s]': other columns of this joint are in 'rad'",
        ),
        ("time [s],a position [rad],a velocity\n", "other columns of this joint are in 'rad'"),
        ("time [s],a position,a velocity [m/s]\n", "other columns of this joint are in 'no unit'"),
        ("time [s],a position [m],a position [m]\n", "column 3: 'a position [m]' is also column 2"),
        ("time [s],a velocity [m/s]\n", "joint 'a' has no column for its position"),
        (
            "time [s],a position,b position,b velocity\n",
            "joint 'a' has no column for its velocity, as others",
        ),
        (HEAD + "0,1,2\n1,x,2\n", "line 3, column 2 (a position [rad]): 'x'; allowed: finite numbers"),
        (HEAD + "0,1,2\n1,,2\n", "line 3, column 2 (a position [rad]): ''"),
        (HEAD + "0,1,nan\n", "line 2, column 3 (a velocity [rad/s]): 'nan'"),
        (HEAD + "inf,1,2\n", "line 2, column 1 (time [s]): 'inf'"),
        (HEAD + "0,1,2\n\n1,1\n", "line 4: 2 columns; allowed: 3, as there are headings"),
        (HEAD + "0,1,2\n# note\n0,1,2\n", "line 4: time is 0.0 s; allowed: more than 0.0 s of line 2"),
        (HEAD + "-1,1,2\n", "line 2: time is -1.0 s; allowed: 0 or later"),
        ("time [s],a\x07 position\n0,1\n", "joint_names[0]"),
    ],
)
def test_tables_that_hold_no_motion_are_refused_by_line(tmp_path: Path, text: str, reason: str) -> None:
    path = written(tmp_path, "a.csv", text)
    with pytest.raises(FileError) as caught:
        pp.load(path, JointTrajectory)
    assert caught.value.path == path
    assert reason in caught.value.reason
