"""Point clouds: read from messages, placed by the measured arm, freed of the arm itself, made an obstacle."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import pinposture as pp
from pinposture.errors import InvalidValue, UnknownName
from pinposture.ros2.clouds import CloudFrames, read_points

typesys = pytest.importorskip("rosbags.typesys")

RESOLUTION = 0.02


@pytest.fixture(scope="module")
def types() -> Any:
    return typesys.get_typestore(typesys.Stores.ROS2_JAZZY).types


@pytest.fixture(scope="module")
def arm() -> pp.Arm:
    placement = pin.SE3(pin.rpy.rpyToMatrix(0.1, -0.2, 0.3), np.array([0.4, 0.5, 0.6]))
    return pp.Arm.from_template("RyRz", modules=4, base_placement=placement)


@pytest.fixture
def frames(arm: pp.Arm) -> CloudFrames:
    return CloudFrames(arm)


def packed(types: Any, rows: int, columns: int, number: str, big: bool) -> tuple[Any, np.ndarray]:
    """A message with other fields between x, y and z, padded rows, packed by `struct`; and its points."""
    rng = np.random.default_rng(0)
    points = rng.normal(size=(rows, columns, 3)).astype(np.float32 if number == "f" else np.float64)
    order = ">" if big else "<"
    size = struct.calcsize(number)
    data = b""
    for row in points:
        for x, y, z in row:
            data += struct.pack(f"{order}H{number}", 7, z) + struct.pack(f"{order}{number}{number}B", x, y, 9)
        data += b"padding"
    offsets = {"z": 2, "x": 2 + size, "y": 2 + 2 * size}
    step = 3 + 3 * size
    field = types["sensor_msgs/msg/PointField"]
    fields = [field("ring", 0, 4, 1)]
    fields += [field(name, offset, 7 if number == "f" else 8, 1) for name, offset in offsets.items()]
    header = types["std_msgs/msg/Header"](types["builtin_interfaces/msg/Time"](1, 0), "tip")
    message = types["sensor_msgs/msg/PointCloud2"](
        header, rows, columns, fields, big, step, step * columns + 7, np.frombuffer(data, np.uint8), True
    )
    return message, points.reshape(-1, 3)


@pytest.mark.parametrize("big", [False, True])
@pytest.mark.parametrize("number", ["f", "d"])
def test_points_are_read_as_they_were_packed(types: Any, number: str, big: bool) -> None:
    message, points = packed(types, 3, 5, number, big)
    np.testing.assert_array_equal(read_points(message), points)


def test_a_message_without_points_of_three_coordinates_is_refused(types: Any) -> None:
    message, _ = packed(types, 2, 3, "f", False)
    message.data = message.data[:-20]
    with pytest.raises(InvalidValue, match=r"data \(bytes\) is 84; allowed: as the fields say"):
        read_points(message)
    message, _ = packed(types, 2, 3, "f", False)
    message.fields[1].datatype = 2
    with pytest.raises(InvalidValue, match="allowed: x, y and z of the type FLOAT32 or FLOAT64"):
        read_points(message)
    message.fields = message.fields[:1]
    with pytest.raises(InvalidValue, match=r"fields is \['ring'\]"):
        read_points(message)


@pytest.mark.long
@pytest.mark.parametrize("link", ["world", "base", "module_02", "tip"])
def test_points_are_where_the_link_that_they_are_given_in_was(
    arm: pp.Arm, frames: CloudFrames, tmp_path: Path, link: str
) -> None:
    yourdfpy = pytest.importorskip("yourdfpy")
    file = tmp_path / "arm.urdf"
    file.write_text(arm.urdf)
    robot = yourdfpy.URDF.load(file, load_meshes=False, build_scene_graph=True)
    link = link if link in ("world", *robot.link_map) else list(robot.link_map)[3]
    q, later = 0.3 * np.ones(arm.nq), np.zeros(arm.nq)
    robot.update_cfg(dict(zip(arm.joint_names, q, strict=True)))
    placed = np.eye(4)
    if link != "world":
        placed = arm.base_placement.homogeneous @ robot.get_transform(link)
    mapped = pp.Map(RESOLUTION, arm)
    mapped.measure(q, 1.0)
    mapped.measure(later, 2.0)
    rng = np.random.default_rng(1)
    there = np.array([0.4, 0.62, 0.62]) + rng.uniform(-0.01, 0.01, (50, 3))
    points = (there - placed[:3, 3]) @ placed[:3, :3]
    frames.add(mapped, points, link, 1.0)
    seen = mapped.cells.points
    apart = np.linalg.norm(there[:, None] - seen[None], axis=2)
    assert apart.min(axis=1).max() <= RESOLUTION * 3**0.5 / 2  # each point is in a cell
    assert apart.min(axis=0).max() <= RESOLUTION * 3**0.5 / 2  # and each cell has a point
    assert (frames.fixed(link) is None) == (link not in ("world", "base"))


@pytest.mark.long
def test_only_a_sensor_on_a_link_sees_that_space_is_free(arm: pp.Arm, frames: CloudFrames) -> None:
    q = np.zeros(arm.nq)
    mapped = pp.Map(RESOLUTION, arm, reach=0.6)
    mapped.measure(q, 1.0)
    mapped.measure(q, 9.0)
    data = arm.model.createData()
    pin.framesForwardKinematics(arm.model, data, q)
    tip = data.oMf[arm.model.getFrameId(arm.tip)]
    near, far = (np.array(tip.act(np.array([ahead, 0.0, 0.0])))[None] for ahead in (0.1, 0.2))
    frames.add(mapped, near, "world", 1.0)
    assert len(mapped.cells.points) == 1
    for moment in (2.0, 3.0, 4.0, 5.0):
        frames.add(mapped, far, "world", moment)
    assert len(mapped.cells.points) == 2  # from where it is seen is not known
    for moment in (6.0, 7.0, 8.0, 8.5):
        frames.add(mapped, np.array([[0.2, 0.0, 0.0]]), arm.tip, moment)
    np.testing.assert_allclose(mapped.cells.points, far, atol=RESOLUTION)


def test_what_cannot_be_used_is_refused(arm: pp.Arm, frames: CloudFrames) -> None:
    mapped = pp.Map(RESOLUTION, arm)
    mapped.measure(arm.straight(), 1.0)
    with pytest.raises(UnknownName, match="no frame of the arm is called 'camera_link'"):
        frames.add(mapped, np.zeros((3, 3)), "camera_link", 1.0)
    with pytest.raises(InvalidValue, match="points is '4, none of them finite'"):
        frames.add(mapped, np.full((4, 3), np.nan), "tip", 1.0)
    for frame in ("tip", "world"):
        with pytest.raises(InvalidValue, match="a time at which the arm is measured"):
            frames.add(mapped, np.ones((4, 3)), frame, 1.5)
    frames.add(mapped, np.zeros((0, 3)), "tip", 1.0)
    assert len(mapped.cells.points) == 0
