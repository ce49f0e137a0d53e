"""Goals and bags of ROS 2, read by another library."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from motion.joint_motions import POSITIONS

import pinposture as pp
from pinposture.errors import FileError, InvalidValue
from pinposture.motion.joint_trajectory import JointTrajectory
from pinposture.motion.ros import write_bag, write_goal

rosbags = pytest.importorskip("rosbags.typesys")
reader = pytest.importorskip("mcap_ros2.reader")

GOAL_FIELDS = (
    "trajectory",
    "multi_dof_trajectory",
    "path_tolerance",
    "component_path_tolerance",
    "goal_tolerance",
    "component_goal_tolerance",
    "goal_time_tolerance",
)
"""Fields of the goal of control_msgs/action/FollowJointTrajectory."""


@pytest.fixture(scope="module")
def arm() -> pp.Arm:
    placement = pin.SE3(pin.rpy.rpyToMatrix(0.1, -0.2, 0.3), np.array([0.4, 0.5, 0.6]))
    return pp.Arm.from_template("RyRz", modules=3, base_placement=placement)


@pytest.fixture(scope="module")
def motion(arm: pp.Arm) -> JointTrajectory:
    rng = np.random.default_rng(0)
    return JointTrajectory.from_configurations(arm, rng.normal(size=(5, arm.nq)), 0.02)


def read(path: Path) -> list[tuple[str, int, Any]]:
    return [(each.channel.topic, each.log_time_ns, each.ros_msg) for each in reader.read_ros2_messages(path)]


def test_joint_states_are_the_rows_of_the_motion(
    arm: pp.Arm, motion: JointTrajectory, tmp_path: Path
) -> None:
    path = write_bag(motion, tmp_path / "motion.mcap", arm, start=2.5)
    states = [(time, each) for topic, time, each in read(path) if topic == "/joint_states"]
    assert len(states) == len(motion.time)
    for k, (time, state) in enumerate(states):
        assert state.name == list(motion.joint_names)
        np.testing.assert_array_equal(state.position, motion.positions[k])
        np.testing.assert_array_equal(state.velocity, motion.velocities[k])
        assert abs(time - 1e9 * (2.5 + motion.time[k])) <= 1.0
        assert state.header.stamp.sec * 10**9 + state.header.stamp.nanosec == time


def test_the_command_and_the_description_are_in_the_bag_once(
    arm: pp.Arm, motion: JointTrajectory, tmp_path: Path
) -> None:
    messages = read(write_bag(motion, tmp_path / "motion.mcap", arm))
    [command] = [each for topic, _, each in messages if topic == "/joint_trajectory"]
    assert (command.header.stamp.sec, command.header.stamp.nanosec) == (0, 0)  # start at once
    for point, row in zip(command.points, motion.positions, strict=True):
        np.testing.assert_array_equal(point.positions, row)
    [description] = [each for topic, _, each in messages if topic == "/robot_description"]
    assert description.data == arm.urdf
    times = [time for _, time, _ in messages]
    assert times == sorted(times)


def matrix(transform: Any) -> np.ndarray:
    """Return the homogeneous matrix of a transform by the formula of a quaternion."""
    x, y, z, w = (getattr(transform.rotation, name) for name in "xyzw")
    placed = np.eye(4)
    placed[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    placed[:3, 3] = [getattr(transform.translation, name) for name in "xyz"]
    return placed


def test_links_are_where_another_library_places_them(
    arm: pp.Arm, motion: JointTrajectory, tmp_path: Path
) -> None:
    yourdfpy = pytest.importorskip("yourdfpy")
    file = tmp_path / "arm.urdf"
    file.write_text(arm.urdf)
    robot = yourdfpy.URDF.load(file, load_meshes=False, build_scene_graph=True)
    frames = [each for topic, _, each in read(write_bag(motion, tmp_path / "m.mcap", arm)) if topic == "/tf"]
    assert len(frames) == len(motion.time)
    for message, row in zip(frames, motion.positions, strict=True):
        robot.update_cfg(dict(zip(motion.joint_names, row, strict=True)))
        placed = {"world": np.eye(4)}
        for each in message.transforms:  # the carrier always comes before what it carries
            placed[each.child_frame_id] = placed[each.header.frame_id] @ matrix(each.transform)
        assert placed.keys() == {"world", *robot.link_map}
        for link in robot.link_map:
            expected = arm.base_placement.homogeneous @ robot.get_transform(link)
            np.testing.assert_allclose(placed[link], expected, atol=1e-12)


@pytest.mark.parametrize(
    ("renamed", "world"),
    [
        ({"base": "world"}, "map"),
        ({"m02_l1": "world"}, "map"),
        ({"tip": "world"}, "map"),
        ({"base": "world", "m01_l1": "map"}, "map_2"),
        ({"base": "map"}, "world"),
    ],
)
def test_no_link_is_its_own_parent_and_the_base_placement_is_kept(
    arm: pp.Arm, tmp_path: Path, renamed: dict[str, str], world: str
) -> None:
    text = arm.urdf
    names = {"base": arm.report.base, "tip": arm.report.tip}
    for name, new in renamed.items():
        text = text.replace(f'"{names.get(name, name)}"', f'"{new}"')
    other = pp.Arm.load(text, base_placement=arm.base_placement)
    q = other.random(np.random.default_rng(1))
    motion = JointTrajectory.from_configurations(other, [q, q], 0.1)
    message = next(
        each for topic, _, each in read(write_bag(motion, tmp_path / "m.mcap", other)) if topic == "/tf"
    )
    parents = {each.child_frame_id: each.header.frame_id for each in message.transforms}
    assert all(child != parent for child, parent in parents.items())
    assert [child for child, parent in parents.items() if parent not in parents] == [other.report.base]
    placed = {world: np.eye(4)}
    for each in message.transforms:
        placed[each.child_frame_id] = placed[each.header.frame_id] @ matrix(each.transform)
    np.testing.assert_allclose(placed[other.report.base], arm.base_placement.homogeneous, atol=1e-12)
    np.testing.assert_allclose(placed[other.report.tip][:3, 3], other.at(q).points[-1], atol=1e-12)


def test_links_beside_the_chain_are_placed_too(tmp_path: Path) -> None:
    robots = Path(pin.__file__).parents[4] / "share" / "example-robot-data" / "robots"
    file = robots / "panda_description" / "urdf" / "panda.urdf"
    if not file.exists():
        pytest.skip("example-robot-data is not installed")
    with pytest.warns(pp.PostureWarning):
        arm = pp.Arm.load(file)
    motion = JointTrajectory.from_configurations(arm, [arm.straight(), arm.random(0)], 1.0)
    message = next(
        each for topic, _, each in read(write_bag(motion, tmp_path / "m.mcap", arm)) if topic == "/tf"
    )
    carriers = {each.child_frame_id: each.header.frame_id for each in message.transforms}
    assert carriers["panda_link0"] == "world"
    assert carriers["panda_leftfinger"] == "panda_hand"
    assert carriers["panda_link5"] == "panda_link4"


def test_a_folder_is_a_bag_that_is_never_overwritten(motion: JointTrajectory, tmp_path: Path) -> None:
    from rosbags.rosbag2 import Reader

    path = write_bag(motion, tmp_path / "bag")
    with Reader(path) as bag:
        kinds = {each.topic: each.msgtype for each in bag.connections}
        assert bag.message_count == len(motion.time) + 1
    assert kinds == {
        "/joint_trajectory": "trajectory_msgs/msg/JointTrajectory",
        "/joint_states": "sensor_msgs/msg/JointState",
    }
    with pytest.raises(FileError, match="exists already; allowed: the name of a new folder"):
        write_bag(motion, tmp_path / "bag")
    single = tmp_path / "one.mcap"
    write_bag(motion, single)
    before = single.read_bytes()
    assert write_bag(motion, single).read_bytes() == before
    assert {each.name for each in tmp_path.iterdir()} == {"bag", "one.mcap"}  # no draft is left


def test_bags_refuse_what_they_cannot_hold(
    arm: pp.Arm, motion: JointTrajectory, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    other = JointTrajectory.from_positions(["a", "b"], POSITIONS, 1.0)
    with pytest.raises(InvalidValue, match="the 6 joints of the arm"):
        write_bag(other, tmp_path / "other.mcap", arm)
    with pytest.raises(InvalidValue, match="start is 0"):
        write_bag(motion, tmp_path / "zero.mcap", start=0)
    (tmp_path / "file").write_text("")
    with pytest.raises(FileError, match="is a file; allowed: a directory"):
        write_bag(motion, tmp_path / "file" / "bag")
    monkeypatch.setitem(sys.modules, "rosbags.rosbag2", None)
    with pytest.raises(FileError, match=r"pip install 'pinposture\[ros\]'"):
        write_bag(motion, tmp_path / "missing.mcap")
    assert [each.name for each in tmp_path.iterdir()] == ["file"]


def test_a_goal_has_the_fields_of_the_action(motion: JointTrajectory, tmp_path: Path) -> None:
    path = write_goal(motion, tmp_path / "goal.json", goal_time_tolerance=1.25)
    goal = json.loads(path.read_text())
    assert goal.keys() <= set(GOAL_FIELDS)
    assert goal["goal_time_tolerance"] == {"sec": 1, "nanosec": 250_000_000}
    again = pp.load(path, JointTrajectory)
    np.testing.assert_array_equal(again.positions, motion.positions)
    with pytest.raises(FileError, match=r"ends in '.csv'; allowed: .json"):
        write_goal(motion, tmp_path / "goal.csv")
    with pytest.raises(InvalidValue, match="goal_time_tolerance is -1"):
        write_goal(motion, tmp_path / "goal.json", goal_time_tolerance=-1)


@pytest.mark.parametrize("suffix", [".json", ".yaml", ".yml", ".YAML"])
def test_goals_are_read_back(motion: JointTrajectory, tmp_path: Path, suffix: str) -> None:
    again = pp.load(write_goal(motion, tmp_path / f"goal{suffix}", goal_time_tolerance=0.5))
    assert again.joint_names == motion.joint_names
    for name in ("time", "positions", "velocities", "accelerations"):
        np.testing.assert_array_equal(getattr(again, name), getattr(motion, name))
