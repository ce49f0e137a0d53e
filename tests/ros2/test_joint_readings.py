"""Joint states that come in parts, late, twice, or wrong: what is used of them, and what is said."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import pinposture as pp
from pinposture.ros2.joint_readings import JointReadings

typesys = pytest.importorskip("rosbags.typesys")

NOW = 1_800_000_000 * 10**9
MS = 10**6
NAMES = ("m01_j1_y", "m01_j2_z", "m02_j1_y", "m02_j2_z")


@pytest.fixture(scope="module")
def types() -> Any:
    return typesys.get_typestore(typesys.Stores.ROS2_JAZZY).types


@pytest.fixture(scope="module")
def arm() -> pp.Arm:
    arm = pp.Arm.from_template("RyRz", modules=2)
    assert arm.drives.names == NAMES
    return arm


@pytest.fixture
def message(types: Any) -> Any:
    def made(positions: dict[str, float], stamp: int, effort: list[float] | None = None) -> Any:
        time = types["builtin_interfaces/msg/Time"](*divmod(stamp, 10**9))
        return types["sensor_msgs/msg/JointState"](
            types["std_msgs/msg/Header"](time, ""),
            list(positions),
            np.array(list(positions.values())),
            np.zeros(0),
            np.array(effort or []),
        )

    return made


def all_at(value: float) -> dict[str, float]:
    return dict.fromkeys(NAMES, value)


def test_joints_are_found_by_name_among_others_in_any_order(arm: pp.Arm, message: Any) -> None:
    states = JointReadings(arm, 0.1)
    given = {"gripper": 9.0, NAMES[2]: 0.3, NAMES[0]: 0.1, "wheel": np.nan, NAMES[3]: 0.4, NAMES[1]: 0.2}
    assert states.take(message(given, NOW - 20 * MS, list(range(6))), NOW) == ""
    found = states.measurement(NOW)
    assert found.positions == dict(zip(NAMES, (0.1, 0.2, 0.3, 0.4), strict=True))
    assert found.torques == dict(zip(NAMES, (2.0, 5.0, 1.0, 4.0), strict=True))
    assert found.age == pytest.approx(0.02)
    assert found.stamp == NOW - 20 * MS
    assert found.reason == ""


def test_messages_with_some_of_the_joints_make_up_a_measurement(arm: pp.Arm, message: Any) -> None:
    states = JointReadings(arm, 0.1)
    states.take(message(dict.fromkeys(NAMES[:2], 0.1), NOW - 30 * MS), NOW)
    assert states.measurement(NOW).positions is None
    assert states.measurement(NOW).reason == f"joint states lack {NAMES[2]!r}, {NAMES[3]!r}"
    states.take(message(dict.fromkeys(NAMES[2:], 0.2), NOW - 10 * MS), NOW)
    found = states.measurement(NOW)
    assert found.positions == dict(zip(NAMES, (0.1, 0.1, 0.2, 0.2), strict=True))
    assert found.age == pytest.approx(0.03)  # of the older part
    assert found.torques is None  # efforts are not measured
    for late in (80, 160):
        states.take(message(dict.fromkeys(NAMES[2:], 0.2), NOW + late * MS), NOW + late * MS)
    found = states.measurement(NOW + 160 * MS)
    assert found.reason == f"joint {NAMES[0]!r} was measured 0.19 s ago; at most max_age, 0.1 s, is used"


def test_a_name_that_is_written_otherwise_is_named(arm: pp.Arm, message: Any) -> None:
    states = JointReadings(arm, 0.1)
    assert states.measurement(NOW).reason == "no joint states yet"
    given = {name.replace("m02_j2_z", "m02_j2_Z"): 0.0 for name in NAMES}
    states.take(message(given, NOW), NOW)
    assert states.measurement(NOW).reason == "joint states lack 'm02_j2_z' (did you mean 'm02_j2_Z'?)"


@pytest.mark.parametrize(
    ("stamp", "change", "fault"),
    [
        (-NOW, {}, "joint states have no time stamp"),
        (2000 * MS, {}, "joint states are stamped 2 s in the future: do the clocks agree?"),
        (-30 * MS, {}, "joint states jump back in time by 0.02 s"),
        (0, {"name": ["a", "b", "a", "c"]}, "joint states have 'a' twice"),
        (0, {"position": np.zeros(3)}, "joint states have 4 names and 3 positions"),
    ],
)
def test_a_message_that_is_wrong_is_refused_whole(
    arm: pp.Arm, message: Any, stamp: int, change: dict[str, Any], fault: str
) -> None:
    states = JointReadings(arm, 0.1)
    states.take(message(all_at(0.1), NOW - 10 * MS), NOW)
    wrong = message(all_at(5.0), NOW + stamp)
    for name, value in change.items():
        setattr(wrong, name, value)
    assert states.take(wrong, NOW) == fault
    assert states.refused == 1
    assert states.measurement(NOW).positions == all_at(0.1)  # for as long as it is young
    later = NOW + 200 * MS
    assert fault in states.measurement(later).reason
    states.take(message(all_at(0.2), later), later)
    assert states.measurement(later).positions == all_at(0.2)


@pytest.mark.parametrize("value", [np.nan, np.inf, -1e300])
def test_a_position_that_is_not_finite_is_not_used_and_heals(arm: pp.Arm, message: Any, value: float) -> None:
    states = JointReadings(arm, 0.1)
    states.take(message(all_at(0.1) | {NAMES[1]: value}, NOW), NOW)
    found = states.measurement(NOW)
    assert found.positions is None
    assert found.reason == f"the position of joint {NAMES[1]!r} is measured as {value}"
    states.take(message(all_at(0.1), NOW + MS), NOW + MS)
    assert states.measurement(NOW + MS).reason == ""
