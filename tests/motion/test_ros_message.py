"""Joint motions as messages of ROS 2, against the definitions of these and the checks of controllers."""

from __future__ import annotations

import json
from fractions import Fraction
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from motion.joint_motions import FILES, MOMENTS, POSITIONS, TABLES, assert_same, motions, of_arm, written
from scipy.interpolate import BPoly

import pinposture as pp
from pinposture.errors import FileError, InvalidValue
from pinposture.motion.joint_trajectory import JointTrajectory

# What the definitions of the messages say, written down independently of what writes them.
INT32 = (-(2**31), 2**31 - 1)
UINT32 = (0, 2**32 - 1)
FLOAT64 = "float64"
DURATION = {"sec": INT32, "nanosec": UINT32}
DEFINITION = {
    "header": {"stamp": DURATION, "frame_id": str},
    "joint_names": [str],
    "points": [
        {
            "positions": [FLOAT64],
            "velocities": [FLOAT64],
            "accelerations": [FLOAT64],
            "effort": [FLOAT64],
            "time_from_start": DURATION,
        }
    ],
}

BARE = {
    "joint_names": ["a", "b"],
    "points": [
        {"positions": row.tolist(), "time_from_start": {"sec": k, "nanosec": 500_000_000}}
        for k, row in enumerate(POSITIONS)
    ],
}


@FILES
@given(motions(least_step=1e-6))
def test_messages_come_back_exactly_but_for_times_to_the_nanosecond(
    tmp_path: Path, motion: JointTrajectory
) -> None:
    again = pp.load(pp.save(motion, tmp_path / "motion.json"), JointTrajectory)
    assert again.joint_names == motion.joint_names
    for name in TABLES[1:]:
        np.testing.assert_array_equal(getattr(again, name), getattr(motion, name))
    for here, there in zip(again.time, motion.time, strict=True):
        assert abs(Fraction(here) - Fraction(there)) <= Fraction(501, 10**12)
    # What was rounded once is not rounded again.
    np.testing.assert_array_equal(
        pp.load(pp.save(again, tmp_path / "b.json"), JointTrajectory).time, again.time
    )


def check_type(value: object, kind: object, where: str) -> None:
    if isinstance(kind, dict):
        assert type(value) is dict, where
        assert list(value) == list(kind), where
        for name, inner in kind.items():
            check_type(value[name], inner, f"{where}.{name}")
    elif isinstance(kind, list):
        assert type(value) is list, where
        for k, item in enumerate(value):
            check_type(item, kind[0], f"{where}[{k}]")
    elif kind == FLOAT64:
        assert type(value) is float, where
        assert np.isfinite(value), where
    elif isinstance(kind, tuple):
        assert type(value) is int, where
        assert kind[0] <= value <= kind[1], where
    else:
        assert type(value) is kind, where


def strict_json(text: str) -> object:
    def refuse(name: str) -> None:
        raise AssertionError(f"{name} is not JSON")

    return json.loads(text, parse_constant=refuse)


@FILES
@given(motions(least_step=1e-6))
def test_messages_have_the_fields_and_types_of_their_definition(
    tmp_path: Path, motion: JointTrajectory
) -> None:
    path = pp.save(motion, tmp_path / "motion.json")
    message = strict_json(path.read_text(encoding="utf-8"))
    check_type(message, DEFINITION, "message")
    assert message["header"] == {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": ""}
    assert len(message["points"]) == len(motion.time)
    for point in message["points"]:
        assert point["time_from_start"]["nanosec"] < 10**9
        assert point["effort"] == []


def test_a_message_is_one_that_the_controller_of_ros2_control_takes(tmp_path: Path) -> None:
    """Its checks: names without repetition, sizes, times that increase strictly, and rest at the end."""
    message = json.loads(pp.save(of_arm(5, rows=30), tmp_path / "a.json").read_text())
    joints = message["joint_names"]
    points = message["points"]
    assert joints == ["j1", "j2", "j3", "j4"]
    times = [
        point["time_from_start"]["sec"] * 10**9 + point["time_from_start"]["nanosec"] for point in points
    ]
    assert times == [k * 10**8 for k in range(30)]
    for point in points:
        assert {len(point[name]) for name in TABLES[1:]} == {4}
    epsilon = float(np.finfo(np.float32).eps)
    assert all(abs(velocity) <= epsilon for velocity in points[-1]["velocities"])


@pytest.mark.parametrize(("repeated", "fast", "hard"), [(False, 0.65, 4.66), (True, 0.375, 2.53)])
def test_what_that_controller_draws_between_points_exceeds_limits_as_the_page_says(
    repeated: bool, fast: float, hard: float
) -> None:
    """It joins points by polynomials of fifth degree; here for all courses of accelerations -1, 0, 1."""
    speeds = []
    accelerations = []
    share = np.linspace(0.0, 1.0, 201)
    for signs in product((-1.0, 0.0, 1.0), repeat=5):
        steps = np.cumsum(signs)
        if abs(steps[-1]) > 1.0:  # it could not stop after that
            continue
        course = np.cumsum([0.0, *steps])
        course = np.concatenate([course[:1], course, course[-1:]]) if repeated else course
        motion = JointTrajectory.from_positions(["a"], course[:, None], 1.0)
        told = np.stack([getattr(motion, name)[:, 0] for name in TABLES[1:]], axis=1)
        drawn = BPoly.from_derivatives(motion.time, told)
        moments = np.unique(np.add.outer(motion.time[:-1], share))
        speeds.append(np.abs(drawn(moments, 1)).max() - np.abs(steps).max())
        accelerations.append(np.abs(drawn(moments, 2)).max())
    assert max(speeds) == pytest.approx(fast, abs=0.005)
    assert max(accelerations) == pytest.approx(hard, abs=0.005)


@pytest.mark.parametrize(
    ("time", "sec", "nanosec"),
    [
        (0.1, 0, 100_000_000),
        (1.9999999999, 2, 0),
        (1e6 + 1e-9, 10**6, 1),
        (2147483647.0, 2147483647, 0),
        (0.07, 0, 7 * 10**7),
    ],
)
def test_times_are_rounded_to_the_nearest_nanosecond(
    tmp_path: Path, time: float, sec: int, nanosec: int
) -> None:
    motion = JointTrajectory.from_positions(["a"], [[0.0]], [time])
    message = json.loads(pp.save(motion, tmp_path / "a.json").read_text())
    assert message["points"][0]["time_from_start"] == {"sec": sec, "nanosec": nanosec}


@pytest.mark.parametrize(
    ("time", "named"), [([0.0, 1e-10], r"time\[1\] is 1e-10"), ([0.0, 2147483648.0], r"time\[1\]")]
)
def test_times_that_a_message_cannot_hold_are_refused(tmp_path: Path, time: list[float], named: str) -> None:
    motion = JointTrajectory.from_positions(["a"], [[0.0], [1.0]], time)
    with pytest.raises(InvalidValue, match=named):
        pp.save(motion, tmp_path / "a.json")
    assert list(tmp_path.iterdir()) == []


def bare(**changes: object) -> dict:
    return json.loads(json.dumps(BARE)) | changes


def with_point(number: int, **changes: object) -> dict:
    message = bare()
    message["points"][number].update(changes)
    return message


def test_messages_of_others_with_positions_alone_are_read(tmp_path: Path) -> None:
    found = pp.load(written(tmp_path, "a.json", bare()), JointTrajectory)
    expected = JointTrajectory.from_positions(["a", "b"], POSITIONS, MOMENTS)
    assert_same(found, expected)
    assert found.units == ("", "")


def test_rates_that_some_points_have_are_kept_and_others_worked_out(tmp_path: Path) -> None:
    message = with_point(3, velocities=[0.25, -1], effort=[1.0, 2.0])
    found = pp.load(written(tmp_path, "a.json", message), JointTrajectory)
    expected = JointTrajectory.from_positions(["a", "b"], POSITIONS, MOMENTS)
    np.testing.assert_array_equal(found.velocities[:3], expected.velocities[:3])
    np.testing.assert_array_equal(found.velocities[3], [0.25, -1.0])
    np.testing.assert_array_equal(found.accelerations, expected.accelerations)


def test_goals_of_an_action_and_messages_with_whole_seconds_are_read(tmp_path: Path) -> None:
    message = with_point(0, time_from_start={})
    message["points"][1]["time_from_start"] = {"sec": 1}
    goal = {"trajectory": message, "goal_time_tolerance": {"sec": 1, "nanosec": 0}}
    found = pp.load(written(tmp_path, "goal.json", goal), JointTrajectory)
    np.testing.assert_array_equal(found.time, [0.0, 1.0, 2.5, 3.5])


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        ("", "line 1, column 1"),
        ("[1, 2", "line 1, column 6"),
        ("[" * 100_000, "nested too deep"),
        ([], "the message is []; allowed: an object with header, joint_names, points"),
        ({"trajectory": 3}, "the message is 3"),
        ({}, "allowed: a list of at least one name"),
        (bare(joint_names="ab"), "joint_names is 'ab'; allowed: a list of names"),
        (bare(joint_names=["a", "a"]), "joint_names[1] is 'a'; allowed: a unique name"),
        (bare(joint_names=["a", 1]), "joint_names[1] is 1"),
        (bare(points=[]), "points is []"),
        (bare(points={}), "points is {}"),
        (bare(point=[]), "the message has a field 'point' (did you mean 'points'?)"),
        (bare(points=[3]), "points[0] is 3; allowed: an object"),
        (with_point(2, velocites=[0, 0]), "points[2] has a field 'velocites' (did you mean 'velocities'?)"),
        (with_point(2, positions=[]), "points[2].positions is of length 0; allowed: 2, one for each joint"),
        (with_point(2, positions=[1]), "points[2].positions is of length 1; allowed: 2, one for each joint"),
        (with_point(1, positions=None), "points[1].positions is null"),
        (
            with_point(1, velocities=[1, 2, 3]),
            "points[1].velocities is of length 3; allowed: 2, one for each joint, or",
        ),
        (with_point(1, effort=[1]), "points[1].effort is of length 1"),
        (
            with_point(3, positions=[0, float("nan")]),
            "points[3].positions[1] is NaN; allowed: finite numbers",
        ),
        (with_point(3, accelerations=[float("-inf"), 0]), "points[3].accelerations[0] is -Infinity"),
        (with_point(3, positions=[0, True]), "points[3].positions[1] is true"),
        (with_point(3, positions=[0, "1"]), 'points[3].positions[1] is "1"'),
        (with_point(3, positions=[10**400, 1]), "points[3].positions[0] is 1000"),
        (
            with_point(2, time_from_start={"sec": 1, "nanosec": 500_000_000}),
            "points[2].time_from_start is 1.5 s; allowed: more than 1.5 s of points[1]",
        ),
        (with_point(2, time_from_start={}), "points[2].time_from_start is 0.0 s"),
        (
            with_point(2, time_from_start=2.5),
            "points[2].time_from_start is 2.5; allowed: an object with sec, nanosec",
        ),
        (with_point(2, time_from_start={"secs": 2}), "has a field 'secs' (did you mean 'sec'?)"),
        (
            with_point(0, time_from_start={"sec": -1}),
            "points[0].time_from_start.sec is -1; allowed: whole numbers from 0 to 2147483647",
        ),
        (with_point(0, time_from_start={"sec": 0.5}), "sec is 0.5"),
        (with_point(0, time_from_start={"sec": True}), "sec is true"),
        (
            with_point(0, time_from_start={"nanosec": 10**9}),
            "nanosec is 1000000000; allowed: whole numbers from 0 to 999999999",
        ),
    ],
)
def test_messages_that_no_controller_would_take_are_refused_by_name(
    tmp_path: Path, content: object, reason: str
) -> None:
    path = written(tmp_path, "a.json", content)
    with pytest.raises(FileError) as caught:
        pp.load(path, JointTrajectory)
    assert caught.value.path == path
    assert reason in caught.value.reason
    assert "\n" not in str(caught.value)


def test_a_message_with_all_its_rates_needs_none_worked_out(tmp_path: Path) -> None:
    """Differences of these positions have no finite value."""
    zeros = np.zeros((4, 1))
    time = np.array([0.0, 1.0, 2.0, 2.000001])
    motion = JointTrajectory(("a",), time, np.array([[0.0], [0.0], [0.0], [2e29]]), zeros, zeros)
    again = pp.load(pp.save(motion, tmp_path / "motion.json"), JointTrajectory)
    np.testing.assert_array_equal(again.positions, motion.positions)
    np.testing.assert_array_equal(again.velocities, zeros)
