"""Logs: tables of others, bags, clocks, and what is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from motion.joint_motions import written

import pinposture as pp
from pinposture.errors import FileError, InvalidValue
from pinposture.motion.joint_trajectory import JointTrajectory
from pinposture.motion.log import Log
from pinposture.motion.ros import write_bag

TIMES = np.array([0.0, 0.1, 0.2, 0.3])
SENT = np.array([[0.0, 1.0], [0.1, 1.1], [0.2, 1.2], [0.3, 1.3]])
MEASURED = SENT - 0.05


def rows(*columns: np.ndarray) -> str:
    return "".join(",".join(map(repr, row)) + "\n" for row in np.column_stack(columns).tolist())


# Tables.


def test_one_table_has_both(tmp_path: Path) -> None:
    head = "time [s],a command [rad],b command [rad],a position [rad],b position [rad],a effort [N m]\n"
    text = head + rows(TIMES, SENT, MEASURED, TIMES)
    log = Log.read(written(tmp_path, "log.csv", text), gravity=(0.0, 0.0, -9.81), payload=0.2)
    assert log.joint_names == ("a", "b")
    np.testing.assert_array_equal(log.commands, SENT)
    np.testing.assert_array_equal(log.positions, MEASURED)
    np.testing.assert_array_equal(log.effort[:, 0], TIMES)
    assert np.all(np.isnan(log.effort[:, 1]))
    np.testing.assert_array_equal(log.time, TIMES)
    assert log.payload == 0.2
    assert repr(log) == "Log(2 joints, 4 commands, 4 measurements, 0.3 s)"


@pytest.mark.parametrize(
    ("head", "times"),
    [
        ("time,", 1.7e9 + TIMES),
        ("timestamp [ms],", 1e3 * TIMES),
        ("t [ns],", 1e9 * TIMES),
        ("sec,nanosec,", np.column_stack([np.full(4, 1_700_000_000), 1e9 * TIMES])),
        ("header.stamp.sec,header.stamp.nanosec,", np.column_stack([np.zeros(4), 1e9 * TIMES])),
        ("dt,", np.full(4, 0.1)),
    ],
)
def test_times_may_be_told_in_many_ways(tmp_path: Path, head: str, times: np.ndarray) -> None:
    text = f"{head}b,a,frame_id\n" + "".join(line + ",base\n" for line in rows(times, MEASURED).splitlines())
    measured = written(tmp_path, "states.csv", text)
    sent = written(tmp_path, "commands.csv", f"{head}a,b\n" + rows(times, SENT[:, ::-1]))
    log = Log.read(measured, sent)
    assert log.joint_names == ("b", "a")
    np.testing.assert_array_equal(log.positions, MEASURED)
    np.testing.assert_array_equal(log.commands, SENT)
    np.testing.assert_allclose(log.time - log.command_time[0], TIMES, atol=3e-7)


@pytest.mark.parametrize("first", [True, False])
def test_tables_without_headings_have_the_time_first_or_last(tmp_path: Path, first: bool) -> None:
    turned = np.array([[0.1, 1.0], [0.3, 2.0], [0.2, 1.0], [0.4, 2.0]])
    columns = (TIMES, turned) if first else (turned, TIMES)
    path = written(tmp_path, "states.csv", rows(*columns))
    log = Log.read(path, path, joint_names=["x", "y"])
    np.testing.assert_array_equal(log.positions, turned)
    assert log.joint_names == ("x", "y")
    assert Log.read(path, path).joint_names == ()


def test_an_exported_motion_is_a_table_of_commands(tmp_path: Path) -> None:
    motion = JointTrajectory.from_positions(["a", "b"], SENT, TIMES, ["rad", "rad"])
    sent = pp.save(motion, tmp_path / "motion.csv")
    measured = written(tmp_path, "states.csv", "time [s],b [rad],a [rad]\n" + rows(TIMES, MEASURED))
    log = Log.read(measured, sent)
    assert log.joint_names == ("b", "a")
    np.testing.assert_array_equal(log.commands, SENT[:, ::-1])


def test_missing_numbers_and_degrees(tmp_path: Path) -> None:
    text = "time,a command [deg],a position [deg]\n0,10,\n0.1,20,nan\n0.2,-,5\n"
    log = Log.read(written(tmp_path, "log.csv", text))
    assert log.degrees
    assert np.isnan(log.positions[:2]).all() and np.isnan(log.commands[2, 0])


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("", "is empty"),
        ("time,a command,a position\n", "no rows"),
        ("time,a command,a position\n0,1\n", "line 2: 2 columns"),
        ("time,a command,a position\n0,1,2\n1,x,2\n", r"line 3, column 2 \(a command\): 'x'"),
        ("a command,a position\n0,1\n", "no column for the time"),
        ("time [h],a command,a position\n0,1,2\n", "unit 'h'; allowed: s, ms, us, ns"),
        ("time,a command [deg],a position [rad]\n0,1,2\n", "in degrees and in radians"),
        ("time,a command,a position [inch]\n0,1,2\n", "unit 'inch'"),
        ("time,a command,a position,a position\n0,1,2,3\n", "allowed: once"),
        ("time,a position\n0,1\n1,2\n", "has no commands of joints"),
        ("time,a command\n0,1\n1,2\n", "has no positions of joints"),
        ("0,1\n1,2\n2,3\n", "both increase"),
        ("2,1\n1,2\n2,1\n", "neither increases"),
    ],
)
def test_other_tables_are_refused(tmp_path: Path, text: str, reason: str) -> None:
    with pytest.raises(FileError, match=reason):
        Log.read(written(tmp_path, "log.csv", text))


def test_missing_files_are_named(tmp_path: Path) -> None:
    for name in ("none.csv", "none.mcap"):
        with pytest.raises(FileError, match=name):
            Log.read(tmp_path / name)


# Bags.


def test_a_bag_is_read(tmp_path: Path) -> None:
    pytest.importorskip("rosbags.typesys")
    arm = pp.Arm.from_template("RyRz", modules=1)
    motion = JointTrajectory.from_positions(arm.joint_names, MEASURED, TIMES)
    path = write_bag(motion, tmp_path / "log.mcap")
    log = Log.read(path, "/joint_trajectory")
    assert log.joint_names == arm.joint_names
    np.testing.assert_array_equal(log.positions, MEASURED)
    np.testing.assert_array_equal(log.commands, MEASURED)
    np.testing.assert_allclose(np.diff(log.time), 0.1)
    assert log.effort is None
    with pytest.raises(FileError, match="name the topic of the commands; it has /joint_"):
        Log.read(path)
    with pytest.raises(FileError, match="has no topic '/commands'"):
        Log.read(path, "/commands")
    damaged = tmp_path / "damaged.mcap"
    damaged.write_bytes(path.read_bytes()[:200])
    with pytest.raises(FileError, match="not a bag that can be read"):
        Log.read(damaged, "/joint_trajectory")


# Arrays.


def test_clocks_are_exact_since_any_epoch() -> None:
    stamps = np.column_stack([np.full(4, 1.7e9), 1e9 * TIMES + 7.0])
    log = Log(stamps, SENT, stamps + [0.0, 1.0], MEASURED)
    np.testing.assert_allclose(log.time - log.command_time, 1e-9, rtol=1e-6)
    interval = Log(0.1, SENT, 0.05, MEASURED)
    np.testing.assert_allclose(interval.time, 0.05 * np.arange(4))


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"commands": SENT[:, 0]}, r"commands \(shape\)"),
        ({"positions": MEASURED[:, :1]}, r"positions \(shape\)"),
        ({"positions": np.full((4, 2), np.nan)}, "some finite numbers"),
        ({"positions": MEASURED * 1e12}, r"positions\[0, 0\]"),
        ({"command_time": TIMES[:2]}, r"command_time \(shape\)"),
        ({"time": TIMES[::-1]}, r"time\[1\].*sort the rows"),
        ({"time": TIMES + 100.0}, "at the same time, on one clock"),
        ({"time": TIMES - 100.0}, "at the same time, on one clock"),
        ({"time": 1.7e18 + TIMES}, "time"),
        ({"time": True}, "time"),
        ({"time": np.full(4, np.nan)}, "finite times"),
        ({"joint_names": ("a",)}, "2 names"),
        ({"joint_names": ("a", "a")}, "unique"),
        ({"effort": SENT[:2]}, r"effort \(shape\)"),
        ({"gravity": (0.0, 1.0)}, r"gravity \(shape\)"),
        ({"payload": -1.0}, "payload"),
        ({"in_contact": 1}, "in_contact"),
        ({"degrees": "yes"}, "degrees"),
    ],
)
def test_what_does_not_fit_is_refused(changes: dict, reason: str) -> None:
    given = {"command_time": TIMES, "commands": SENT, "time": TIMES, "positions": MEASURED}
    with pytest.raises(InvalidValue, match=reason):
        Log(**given | changes)


def test_a_name_is_no_list_of_names(tmp_path: Path) -> None:
    file = tmp_path / "log.csv"
    file.write_text("0.0,0.1\n0.1,0.2\n")
    with pytest.raises(InvalidValue, match="a list of names"):
        Log.read(file, joint_names="j")
