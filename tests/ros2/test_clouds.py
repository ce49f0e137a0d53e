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
from pinposture.ros2.clouds import Cloud, CloudObstacles, read_points

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
def obstacles(arm: pp.Arm) -> CloudObstacles:
    return CloudObstacles(arm, pp.Scene(margin=0.005), RESOLUTION)


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
def test_a_point_is_placed_by_the_link_that_it_is_given_in(
    arm: pp.Arm, obstacles: CloudObstacles, tmp_path: Path
) -> None:
    yourdfpy = pytest.importorskip("yourdfpy")
    file = tmp_path / "arm.urdf"
    file.write_text(arm.urdf)
    robot = yourdfpy.URDF.load(file, load_meshes=False, build_scene_graph=True)
    rng = np.random.default_rng(1)
    q = arm.random(rng)
    robot.update_cfg(dict(zip(arm.joint_names, q, strict=True)))
    points = rng.normal(size=(5, 3))
    for link in robot.link_map:
        placed = arm.base_placement.homogeneous @ robot.get_transform(link)
        expected = points @ placed[:3, :3].T + placed[:3, 3]
        np.testing.assert_allclose(obstacles.to_world(points, link, q), expected, atol=1e-9)
    assert {"tip", "base"} <= set(robot.link_map)
    np.testing.assert_array_equal(obstacles.to_world(points, "world", q), points)
    assert obstacles.is_fixed("world") and obstacles.is_fixed("base") and not obstacles.is_fixed("tip")


def test_the_obstacle_contains_every_point_and_reaches_no_farther_than_a_cube(
    arm: pp.Arm, obstacles: CloudObstacles
) -> None:
    rng = np.random.default_rng(2)
    points = np.array([0.4, 0.5, 0.6]) + 0.03 * rng.normal(size=(300, 3)) + (0.0, 0.2, 0.0)
    scan = obstacles.obstacle(Cloud(points, "world", arm.straight()))
    assert scan is not None
    apart = np.linalg.norm(points[:, None] - scan.points[None], axis=2)
    assert apart.min(axis=1).max() <= scan.point_radius  # each point is inside
    assert apart.min(axis=0).max() <= scan.point_radius  # each cube has a point
    assert scan.point_radius == pytest.approx(RESOLUTION * 3**0.5 / 2)
    shaken = points + 1e-9
    assert obstacles.obstacle(Cloud(shaken, "world", arm.straight())) == scan


def test_points_on_the_arm_itself_are_left_out_and_those_beside_it_are_not(
    arm: pp.Arm, obstacles: CloudObstacles
) -> None:
    q = arm.random(np.random.default_rng(3))
    model = pp.CollisionModel(arm, pp.Scene(margin=0.005, self_collision=False))
    data = arm.model.createData()
    pin.forwardKinematics(arm.model, data, q)
    on, beside = [], []
    for joint, solid in model.solids:
        if not solid.round:
            continue
        middle = data.oMi[joint].act((solid.start + solid.end) / 2.0)
        aside = data.oMi[joint].rotation @ pin.SE3.Random().rotation[:, 0]
        on.append(middle)
        beside.append(middle + 0.15 * aside)
    assert on
    assert obstacles.obstacle(Cloud(np.array(on), "world", q)) is None
    kept = obstacles.obstacle(Cloud(np.array([*on, *beside]), "world", q))
    assert kept is not None and len(kept.points) == len(beside)


@pytest.mark.long
def test_a_point_a_margin_beside_the_arm_is_where_the_line_is_drawn(
    arm: pp.Arm, obstacles: CloudObstacles
) -> None:
    """The distance of a point from the arm is that of a tiny sphere, as the collision model has it."""
    q = arm.straight()
    rng = np.random.default_rng(4)
    begin, end = arm.base_placement.translation, arm.at(q).points[-1]
    kept = {}
    for _ in range(60):
        point = begin + rng.uniform(0.1, 0.9) * (end - begin) + rng.uniform(-0.03, 0.03, 3)
        scene = pp.Scene({"point": pp.Sphere(tuple(point), 1e-6)}, self_collision=False)
        distance = pp.CollisionModel(arm, scene).minimum(q).distance
        kept[distance] = obstacles.obstacle(Cloud(point[None], "world", q)) is not None
    assert any(kept.values()) and not all(kept.values())
    for distance, is_kept in kept.items():
        if abs(distance - 0.005) > 1e-4:
            assert is_kept == (distance > 0.005)


def test_what_cannot_be_used_is_refused(arm: pp.Arm, obstacles: CloudObstacles) -> None:
    q = arm.straight()
    with pytest.raises(UnknownName, match="no frame of the arm is called 'camera_link'"):
        obstacles.obstacle(Cloud(np.zeros((3, 3)), "camera_link", q))
    with pytest.raises(InvalidValue, match="points is '4, none of them finite'"):
        obstacles.obstacle(Cloud(np.full((4, 3), np.nan), "tip", q))
    many = np.random.default_rng(0).uniform(-0.3, 0.3, (60_000, 3)) + arm.base_placement.translation
    fine = CloudObstacles(arm, pp.Scene(), 0.005)
    with pytest.raises(InvalidValue, match=r"occupied cubes is .*a larger cloud_resolution than 0.005 m"):
        fine.obstacle(Cloud(many, "world", q))


def test_points_beyond_reach_and_an_empty_cloud_leave_no_obstacle(
    arm: pp.Arm, obstacles: CloudObstacles
) -> None:
    q = arm.straight()
    far = np.array([[100.0, 0.0, 0.0], [np.nan, 0.0, 0.0]])
    assert obstacles.obstacle(Cloud(far, "world", q)) is None
    assert obstacles.obstacle(Cloud(np.zeros((0, 3)), "tip", q)) is None
