"""Goals and bags of ROS 2, read by another library, and the examples, run on stand-ins for rclpy."""

from __future__ import annotations

import importlib.util
import json
import sys
from pathlib import Path
from time import monotonic, sleep
from types import ModuleType, SimpleNamespace
from typing import Any, ClassVar

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

ROS = Path(__file__).parents[2] / "examples" / "ros"


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


# The examples, with stand-ins for rclpy. Messages have the fields of the definitions that rosbags brings.

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


def message_class(kind: str) -> type:
    """Return a class of messages that takes the fields of a definition and no others."""
    definitions = rosbags.get_typestore(rosbags.Stores.ROS2_HUMBLE).fielddefs
    fields = [name for name, _ in definitions[kind][1]]

    class Message(SimpleNamespace):
        def __init__(self, **given: Any) -> None:
            assert set(given) <= set(fields), f"{kind} has {fields}"
            super().__init__(**given)

        def __setattr__(self, name: str, value: Any) -> None:
            assert name in fields, f"{kind} has {fields}"
            super().__setattr__(name, value)

    return Message


class FollowJointTrajectory:
    """A stand-in for the action."""

    class Goal(SimpleNamespace):
        pass

    class Result:
        SUCCESSFUL = 0


class Future(SimpleNamespace):
    def result(self) -> Any:
        return self.value


class ActionClient:
    """A stand-in for the client, whose server answers at once."""

    sent: ClassVar[list[Any]] = []
    accepts = True
    code = 0

    def __init__(self, node: Any, action: type, name: str) -> None:
        self.name = name

    def wait_for_server(self) -> None:
        pass

    def send_goal_async(self, goal: Any) -> Future:
        self.sent.append((self.name, goal))
        result = SimpleNamespace(error_code=self.code, error_string="the path is too long")
        ended = Future(value=SimpleNamespace(result=result))
        return Future(value=SimpleNamespace(accepted=self.accepts, get_result_async=lambda: ended))


class Node:
    """A stand-in for a node, which keeps what it is given."""

    def __init__(self, name: str) -> None:
        self.published: list[Any] = []
        self.said: list[str] = []
        self.topics: dict[str, Any] = {}

    def create_publisher(self, kind: type, topic: str, depth: int) -> Any:
        return SimpleNamespace(publish=self.published.append)

    def create_subscription(self, kind: type, topic: str, callback: Any, depth: int) -> None:
        self.topics[topic] = callback

    def create_timer(self, period: float, callback: Any) -> None:
        self.cycle = callback

    def get_logger(self) -> Any:
        def keep(text: str, **_: Any) -> None:
            self.said.append(text)

        return SimpleNamespace(error=keep, warning=keep)


def set_message_fields(message: Any, values: dict[str, Any]) -> None:
    assert values.keys() <= set(GOAL_FIELDS)
    vars(message).update(values)


@pytest.fixture
def ros(monkeypatch: pytest.MonkeyPatch) -> None:
    """Stand-ins for the modules of ROS 2 that the examples import."""

    def module(name: str, **content: Any) -> ModuleType:
        made = ModuleType(name)
        vars(made).update(content)
        monkeypatch.setitem(sys.modules, name, made)
        return made

    names = {"sensor_msgs": ["JointState"], "std_msgs": ["Float64MultiArray", "String"]}
    for package, kinds in names.items():
        module(package)
        module(f"{package}.msg", **{kind: message_class(f"{package}/msg/{kind}") for kind in kinds})
    module("control_msgs")
    module("control_msgs.action", FollowJointTrajectory=FollowJointTrajectory)
    module("rosidl_runtime_py", set_message_fields=set_message_fields)
    module(
        "rclpy",
        init=lambda: None,
        create_node=Node,
        spin=lambda node: None,
        spin_until_future_complete=lambda node, future: None,
    )
    module("rclpy.action", ActionClient=ActionClient)
    module("rclpy.node", Node=Node)
    ActionClient.sent.clear()


def example(name: str) -> Any:
    spec = importlib.util.spec_from_file_location(name, ROS / f"{name}.py")
    assert spec is not None and spec.loader is not None
    loaded = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(loaded)
    return loaded


@pytest.mark.usefixtures("ros")
def test_the_sender_sends_the_goal_and_says_how_it_ended(
    motion: JointTrajectory, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = str(write_goal(motion, tmp_path / "goal.json"))
    sender = example("send_motion")
    assert sender.main(file, "/controller") == ""
    [(name, goal)] = ActionClient.sent
    assert name == "/controller/follow_joint_trajectory"
    assert goal.trajectory["joint_names"] == list(motion.joint_names)
    monkeypatch.setattr(ActionClient, "code", -4)
    assert sender.main(file, "/controller") == "error -4: the path is too long"
    monkeypatch.setattr(ActionClient, "accepts", False)
    assert "refused" in sender.main(file, "/controller")


@pytest.mark.long
@pytest.mark.usefixtures("ros")
def test_the_tracker_node_drives_the_arm_to_the_curve_and_to_another(tmp_path: Path) -> None:
    arm = pp.Arm.from_template("RyRz", modules=6)
    curves = {"bow": pp.Curve.helix(0.3, 0.0, 0.5), "line": pp.Curve.line((0, 0, 0), (1, 0, 0))}
    for name, curve in curves.items():
        curve.save(tmp_path / f"{name}.json")
    node_module = example("tracker_node")
    node = node_module.TrackerNode(arm, curves["bow"])
    node.cycle()
    assert not node.published  # nothing is known of where the arm is
    assert "no measurement" in node.said[-1] or "measure" in node.said[-1]
    names = [*reversed(arm.joint_names), "gripper"]  # by name, in any order, with others
    joint_state = sys.modules["sensor_msgs.msg"].JointState
    text = sys.modules["std_msgs.msg"].String
    positions = np.zeros(arm.nv)

    def run() -> None:
        nonlocal positions
        # the process that plans has to start
        end = monotonic() + 60.0
        converged = 0
        while converged < 50 and monotonic() < end:
            converged += node.tracker.report.status == "converged"
            sleep(0.001 if node.tracker.report.status == "holding" else 0.0)
            node.topics["/joint_states"](joint_state(name=names, position=[*positions[::-1], 0.01]))
            node.cycle()
            positions = np.array(node.published[-1].data)

    for name, curve in curves.items():
        node.topics["/curve"](text(data=str(tmp_path / f"{name}.json")))
        node.cycle()
        run()
        target = pp.resolve_targets(arm, curve, placement="align")
        np.testing.assert_allclose(arm.at(arm.configuration(positions)).points, target.points, atol=1e-6)
    node.topics["/curve"](text(data=str(tmp_path / "missing.json")))
    assert "no such file" in node.said[-1]
    for _ in range(node_module.MAX_AGE + 2):  # the bus is down
        node.cycle()
    assert "measure" in node.said[-1]
    held = node.published[-1].data
    for _ in range(10):
        node.cycle()
    np.testing.assert_allclose(node.published[-1].data, held, atol=1e-12)


@pytest.mark.parametrize("suffix", [".json", ".yaml", ".yml", ".YAML"])
def test_goals_are_read_back(motion: JointTrajectory, tmp_path: Path, suffix: str) -> None:
    again = pp.load(write_goal(motion, tmp_path / f"goal{suffix}", goal_time_tolerance=0.5))
    assert again.joint_names == motion.joint_names
    for name in ("time", "positions", "velocities", "accelerations"):
        np.testing.assert_array_equal(getattr(again, name), getattr(motion, name))
