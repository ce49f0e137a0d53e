"""Messages of inertial sensors and of the tip become a configuration; those that cannot be used are named."""

from __future__ import annotations

import re
from types import SimpleNamespace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import pinposture as pp
from pinposture.errors import InvalidValue, UnknownName
from pinposture.ros2.shape_readings import ShapeReadings, ShapeSensing

NOW = 1_800_000_000 * 10**9
MS = 10**6
DT = 0.02
SENSOR = """
  <link name="chip"/>
  <joint name="glue" type="fixed">
    <parent link="m03_l2"/> <child link="chip"/> <origin xyz="0 0 0.01" rpy="0.3 -1.2 2.0"/>
  </joint>
</robot>"""


@pytest.fixture(scope="module")
def arm(tmp_path_factory: pytest.TempPathFactory) -> pp.Arm:
    """An arm of 4 modules whose third link carries a sensor that is mounted askew."""
    urdf = pp.Arm.from_template("RyRz", modules=4).urdf
    path = tmp_path_factory.mktemp("arm") / "arm.urdf"
    path.write_text(urdf.replace("</robot>", SENSOR))
    return pp.Arm.load(path, tip="tip")


@pytest.fixture(scope="module")
def q(arm: pp.Arm) -> np.ndarray:
    return np.array([0.3, -0.2, 0.1, 0.25, -0.3, 0.2, 0.1, -0.15])


def stamped(frame: str, stamp: int) -> Any:
    sec, nanosec = divmod(stamp, 10**9)
    return SimpleNamespace(frame_id=frame, stamp=SimpleNamespace(sec=sec, nanosec=nanosec))


def vector(values: np.ndarray) -> Any:
    return SimpleNamespace(**dict(zip("xyzw", np.asarray(values).tolist(), strict=False)))


def placed(arm: pp.Arm, q: np.ndarray, link: str) -> pin.SE3:
    data = arm.model.createData()
    pin.framesForwardKinematics(arm.model, data, q)
    return data.oMf[arm.model.getFrameId(link, pin.FrameType.BODY)]


def imu(arm: pp.Arm, q: np.ndarray, link: str, stamp: int, turned: bool = True) -> Any:
    """An exact message of an inertial sensor at rest, with an orientation or without."""
    turn = placed(arm, q, link).rotation
    covariance = np.zeros(9)
    if not turned:
        covariance[0] = -1.0
    return SimpleNamespace(
        header=stamped(link, stamp),
        orientation=vector(pin.Quaternion(turn).coeffs() if turned else np.zeros(4)),
        orientation_covariance=covariance,
        linear_acceleration=vector(-turn.T @ arm.model.gravity.linear),
        linear_acceleration_covariance=np.zeros(9),
    )


def tip(arm: pp.Arm, q: np.ndarray, stamp: int, frame: str = "world") -> Any:
    place = placed(arm, q, arm.tip)
    pose = SimpleNamespace(
        position=vector(place.translation), orientation=vector(pin.Quaternion(place.rotation).coeffs())
    )
    return SimpleNamespace(header=stamped(frame, stamp), pose=pose)


def joints(arm: pp.Arm, q: np.ndarray, stamp: int, columns: list[int]) -> Any:
    names = arm.drives.names
    read = arm.drives.positions(arm.positions(q))
    return SimpleNamespace(
        header=stamped("", stamp),
        name=[names[k] for k in columns],
        position=[float(read[k]) for k in columns],
        effort=[],
    )


ALL = list(range(8))


def estimated(arm: pp.Arm, found: Any) -> np.ndarray:
    assert found.positions is not None, found.reason
    return arm.configuration(arm.drives.joint_positions(found.positions))


def watch(arm: pp.Arm, sensing: ShapeSensing, told: Any, cycles: int = 40) -> tuple[ShapeReadings, int]:
    """Give an estimator what `told` gives it in each cycle."""
    shape = ShapeReadings(arm, 0.1, sensing)
    now = NOW
    for _ in range(cycles):
        now += round(DT * 1e9)
        told(shape, now)
        shape.estimate(now, DT, None)
    return shape, now


LINKS = ("m01_l2", "m02_l2", "chip", "m04_l2")


def test_links_tell_what_joints_without_encoders_do_wherever_the_sensor_sits(
    arm: pp.Arm, q: np.ndarray
) -> None:
    known = [0, 1, 3, 5, 6]

    def told(shape: ShapeReadings, now: int) -> None:
        assert shape.take(joints(arm, q, now, known), now) == ""
        for link in LINKS:
            assert shape.take_imu(imu(arm, q, link, now), now) == ""

    shape, now = watch(arm, ShapeSensing(imus=("imu",)), told)
    np.testing.assert_allclose(estimated(arm, shape.measurement(now)), q, atol=2e-3)
    words = shape.told(now)
    assert words["missing sensors"] == "encoder 'm02_j1_y', encoder 'm03_j1_y', encoder 'm04_j2_z'"
    assert words["outliers"] == words["refused messages"] == ""


@pytest.mark.parametrize(("heading", "turned"), [(False, True), (True, False)])
def test_the_vertical_alone_tells_joints_that_it_turns_with(
    arm: pp.Arm, q: np.ndarray, heading: bool, turned: bool
) -> None:
    """Without a heading, or an orientation, the same is known as from accelerometers: pitch and roll."""
    known = [1, 3, 5, 7]  # those that turn about z

    def told(shape: ShapeReadings, now: int) -> None:
        shape.take(joints(arm, q, now, known), now)
        for link in LINKS:
            assert shape.take_imu(imu(arm, q, link, now, turned), now) == ""

    shape, now = watch(arm, ShapeSensing(imus=("imu",), heading=heading), told, 100)
    np.testing.assert_allclose(estimated(arm, shape.measurement(now)), q, atol=5e-3)


def test_encoders_on_motors_are_put_right_by_the_tip_and_the_links(arm: pp.Arm, q: np.ndarray) -> None:
    given_way = q - 0.03

    def told(shape: ShapeReadings, now: int) -> None:
        shape.take(joints(arm, given_way, now, ALL), now)
        shape.take_imu(imu(arm, q, "m02_l2", now), now)
        assert shape.take_tip(tip(arm, q, now, arm.base), now) == ""

    shape, now = watch(arm, ShapeSensing(imus=("imu",), tip_pose="tip", encoders="motor"), told, 60)
    true = arm.at(q).points[-1]
    found = arm.at(estimated(arm, shape.measurement(now))).points[-1]
    believed = arm.at(given_way).points[-1]
    assert np.linalg.norm(found - true) < 0.05 * np.linalg.norm(believed - true)


def test_what_is_not_known_well_enough_is_not_told(arm: pp.Arm, q: np.ndarray) -> None:
    shape, now = watch(
        arm, ShapeSensing(), lambda shape, now: shape.take(joints(arm, q, now, [0, 1, 2, 3]), now)
    )
    found = shape.measurement(now)
    assert found.positions is None
    words = (
        r"control point 'module_04' is known to [\d.]+ mm; at most 10 mm is allowed \(missing sensors: enc"
    )
    assert re.match(words, found.reason), found.reason


def test_all_sensors_silent_is_told_with_their_age(arm: pp.Arm, q: np.ndarray) -> None:
    shape, now = watch(
        arm, ShapeSensing(max_deviation=0.2), lambda shape, now: shape.take(joints(arm, q, now, ALL), now)
    )
    assert shape.measurement(now).reason == ""
    later = now + 200 * MS
    shape.estimate(later, 0.2, None)
    words = (
        "the last reading of any sensor that could be used is of 0.2 s ago; at most max_age, 0.1 s, is used"
    )
    assert shape.measurement(later).reason == words
    shape.forget()
    assert "no joint states yet" in shape.measurement(later).reason


def test_an_outlier_is_left_out_and_told(arm: pp.Arm, q: np.ndarray) -> None:
    wrong = q.copy()
    wrong[3] += 0.8

    def told(shape: ShapeReadings, now: int) -> None:
        shape.take(joints(arm, q, now, ALL), now)
        shape.take_imu(imu(arm, q, "m02_l2", now), now)
        shape.take_imu(imu(arm, wrong if now > NOW + 500 * MS else q, "m04_l2", now), now)

    shape, now = watch(arm, ShapeSensing(imus=("imu",)), told)
    np.testing.assert_allclose(estimated(arm, shape.measurement(now)), q, atol=3e-3)
    assert shape.told(now)["outliers"] == "imu 'm04_l2'"


def test_the_first_message_waits_for_the_other_joints(arm: pp.Arm, q: np.ndarray) -> None:
    shape = ShapeReadings(arm, 0.1, ShapeSensing())
    bent = q + 1.5  # farther than a reading may be from what is expected
    shape.take(joints(arm, bent, NOW, [0, 1]), NOW)
    shape.estimate(NOW, DT, None)
    assert shape.measurement(NOW).positions is None
    later = NOW + 20 * MS
    shape.take(joints(arm, bent, later, ALL), later)
    for k in range(2):
        shape.estimate(later + k * 10 * MS, DT, None)
    np.testing.assert_allclose(estimated(arm, shape.measurement(later)), bent, atol=1e-3)


def test_what_was_commanded_is_expected_of_joints_that_nobody_measures(arm: pp.Arm, q: np.ndarray) -> None:
    shape = ShapeReadings(arm, 0.1, ShapeSensing(max_deviation=1.0))
    sent = arm.drives.positions(arm.positions(0.0 * q))
    now = NOW
    for _ in range(30):
        now += round(DT * 1e9)
        shape.take(joints(arm, 0.0 * q, now, [0]), now)
        shape.estimate(now, DT, sent)
        sent = sent + 0.01 * (np.arange(8) == 7)
    moved = estimated(arm, shape.measurement(now))
    assert moved[7] == pytest.approx(0.01 * 23, abs=0.011)  # the estimate begins after max_age
    np.testing.assert_allclose(moved[:7], 0.0, atol=1e-9)


@pytest.mark.parametrize("sensors", ["encoders", "links", "verticals", "tip"])
@pytest.mark.parametrize("late", [0, 33 * MS])
def test_readings_that_come_late_are_moved_on_by_what_was_commanded_since(
    arm: pp.Arm, q: np.ndarray, sensors: str, late: int
) -> None:
    sensing = {
        "encoders": ShapeSensing(max_deviation=1.0),
        "links": ShapeSensing(imus=("imu",), max_deviation=1.0),
        "verticals": ShapeSensing(imus=("imu",), heading=False, max_deviation=1.0),
        "tip": ShapeSensing(tip_pose="tip", max_deviation=1.0),
    }
    shape = ShapeReadings(arm, 0.1, sensing[sensors])
    speed = np.linspace(-0.8, 0.8, 8)
    known = ALL if sensors == "encoders" else [0, 2, 4, 5, 7]

    def at(time: int) -> np.ndarray:
        return np.asarray(arm.integrate(q, 1e-9 * (time - NOW) * speed))

    for cycle in range(40):
        now = NOW + round(cycle * DT * 1e9)
        then = now - late
        assert shape.take(joints(arm, at(then), then, known), now) == ""
        for link in LINKS if sensors in ("links", "verticals") else ():
            assert shape.take_imu(imu(arm, at(then), link, then), now) == ""
        if sensors == "tip":
            assert shape.take_tip(tip(arm, at(then), then), now) == ""
        shape.estimate(now, DT, arm.drives.positions(arm.positions(at(now))))
    found = estimated(arm, shape.measurement(now))
    away = arm.at(found).points - arm.at(at(now)).points
    # In 33 ms the tip moves by 5.5 mm. What the verticals do not tell is as it was taken to be at first.
    if sensors != "verticals":
        assert np.linalg.norm(away, axis=1).max() < 3e-4
    np.testing.assert_allclose(found[known], at(now)[known], atol=1e-3)


@pytest.mark.parametrize(
    ("change", "fault"),
    [
        ({"header": stamped("elbow", NOW)}, "it moves with no control point; allowed: the frames 'm01_l2'"),
        ({"header": stamped("m02_l2", 0)}, "its messages have no time stamp"),
        ({"header": stamped("m02_l2", NOW + 2000 * MS)}, "its messages are stamped 2 s in the future"),
        ({"header": stamped("m02_l2", NOW - 90 * MS)}, "its messages jump back in time by 0.04 s"),
        ({"orientation": vector(np.zeros(4)), "linear_acceleration": vector(np.zeros(3))}, "no orientation"),
        (
            {"orientation": vector(np.full(4, np.nan)), "linear_acceleration": vector(np.full(3, np.nan))},
            "no orientation",
        ),
    ],
)
def test_messages_of_links_that_cannot_be_used_are_refused(
    arm: pp.Arm, q: np.ndarray, change: dict[str, Any], fault: str
) -> None:
    shape = ShapeReadings(arm, 0.1, ShapeSensing(imus=("imu",)))
    assert shape.take_imu(imu(arm, q, "m02_l2", NOW - 50 * MS), NOW) == ""
    wrong = imu(arm, q, "m02_l2", NOW)
    for name, value in change.items():
        setattr(wrong, name, value)
    assert fault in shape.take_imu(wrong, NOW)
    assert fault in shape.told(NOW)["refused messages"]


@pytest.mark.parametrize(
    ("change", "fault"),
    [
        ({"header": stamped("m02_l2", NOW)}, "its frame is 'm02_l2'; allowed: the world or the base"),
        ({"header": stamped("odom", NOW)}, "its frame is 'odom'"),
        ({"header": stamped("world", 0)}, "have no time stamp"),
        (
            {
                "pose": SimpleNamespace(
                    position=vector(np.full(3, np.nan)), orientation=vector([0, 0, 0, 1.0])
                )
            },
            "its position is not finite",
        ),
        (
            {"pose": SimpleNamespace(position=vector(np.zeros(3)), orientation=vector(np.zeros(4)))},
            "its orientation no unit quaternion",
        ),
    ],
)
def test_poses_of_the_tip_that_cannot_be_used_are_refused(
    arm: pp.Arm, q: np.ndarray, change: dict[str, Any], fault: str
) -> None:
    shape = ShapeReadings(arm, 0.1, ShapeSensing(tip_pose="tip"))
    wrong = tip(arm, q, NOW)
    for name, value in change.items():
        setattr(wrong, name, value)
    assert fault in shape.take_tip(wrong, NOW)
    assert shape.told(NOW)["refused messages"].startswith("pose of the tip: ")
    assert shape.take_tip(tip(arm, q, NOW), NOW) == ""
    assert shape.told(NOW)["refused messages"] == ""


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"imus": ("",)}, "imus is"),
        ({"imus": 3}, "a name of a topic"),
        ({"encoder_noise": 0.0}, "encoder_noise is"),
        ({"imu_noise": -0.1}, "imu_noise is"),
        ({"tip_noise": 0.0}, "tip_noise is"),
        ({"give": -1.0}, "give is"),
        ({"heading": "yes"}, "heading is"),
        ({"max_deviation": 0.0}, "max_deviation is"),
    ],
)
def test_settings_that_cannot_be_are_refused(given: dict[str, Any], words: str) -> None:
    with pytest.raises(InvalidValue, match=words):
        ShapeSensing(**given)
    with pytest.raises(UnknownName, match="'elbow'"):
        ShapeSensing(encoders="elbow")
