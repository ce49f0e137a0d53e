"""ROS 2 output of joint trajectories: goals of the action FollowJointTrajectory, and bags."""

from __future__ import annotations

import json
import shutil
import tempfile
from collections.abc import Iterator
from itertools import chain, count
from pathlib import Path
from typing import Any, Final

import numpy as np
import pinocchio as pin

from pinposture._validation import require_positive
from pinposture.arm import Arm
from pinposture.arm.urdf_reader import read_description
from pinposture.errors import FileError, InvalidValue
from pinposture.motion.joint_files import NANOSECONDS, to_message
from pinposture.motion.joint_trajectory import JointTrajectory
from pinposture.storage import check_writable, require_suffix, write_text

WORLDS = ("world", "map")
"""Names of the frame in which the base of the arm stands, the first that is not the name of a link."""

MAX_DOF = 200
"""Degrees of freedom up to which link frames are written; a `pin.Data` then takes 370 MB."""

BAG_VERSION: Final = 8
"""Version of the metadata of a bag, readable by all distributions since Humble."""


def world_frame(arm: Arm) -> str:
    """Return the name of the world frame in transforms; no link or moving joint of the arm has it."""
    bodies = (str(frame.name) for frame in arm.model.frames if frame.type == pin.FrameType.BODY)
    taken = {*bodies, *map(str, arm.model.names)}
    names = chain(WORLDS, (f"{WORLDS[-1]}_{number}" for number in count(2)))
    return next(name for name in names if name not in taken)


def write_goal(trajectory: JointTrajectory, path: str | Path, goal_time_tolerance: float = 0.0) -> Path:
    """Write a goal of control_msgs/action/FollowJointTrajectory as JSON, which is also YAML.

        ros2 action send_goal --stdin CONTROLLER/follow_joint_trajectory \
            control_msgs/action/FollowJointTrajectory < goal.json

    `pp.load` reads the file like a message.

    Args:
        trajectory: the motion.
        path: the file, with the suffix .json, .yaml or .yml.
        goal_time_tolerance: how late the arm may reach the last point [s]; with 0 the controller decides.

    Returns:
        The path.

    Raises:
        FileError: another suffix, or the file cannot be written.
        InvalidValue: times out of range for a ROS 2 message, or a negative tolerance.
    """
    path = Path(path)
    require_suffix(path, ".json", ".yaml", ".yml")
    require_positive("goal_time_tolerance", goal_time_tolerance, zero=True)
    seconds, nanoseconds = divmod(round(goal_time_tolerance * NANOSECONDS), NANOSECONDS)
    goal = {
        "trajectory": to_message(trajectory),
        "goal_time_tolerance": {"sec": seconds, "nanosec": nanoseconds},
    }
    write_text(path, json.dumps(goal, allow_nan=False) + "\n")
    return path


def write_bag(
    trajectory: JointTrajectory, path: str | Path, arm: Arm | None = None, start: float = 1.0
) -> Path:
    """Write a ROS 2 bag in MCAP format, for `ros2 bag play`, RViz, Foxglove, PlotJuggler or Rerun.

    Topics are /joint_states (sensor_msgs/JointState) and /joint_trajectory (trajectory_msgs/JointTrajectory,
    one message at the start). With an arm also /tf (tf2_msgs/TFMessage), with each link in the frame of its
    parent link and the base in the frame "world", or "map" if a link is called "world"; and, for an arm
    loaded from a URDF, /robot_description
    (std_msgs/String). Needs the extra `ros`.

    Args:
        trajectory: the motion.
        path: a file with the suffix .mcap; any other name is a new folder, as `ros2 bag record` makes it.
        arm: the arm; None omits links and description.
        start: time stamp of the start of the trajectory [s]; to tf, zero would mean the latest transform.

    Returns:
        The path.

    Raises:
        FileError: the extra is missing, the folder exists, or cannot be written to.
        InvalidValue: times out of range for a message, joints of another arm, or an arm with more than 200
            degrees of freedom, for which `pin.Data` needs too much memory.
    """
    path = Path(path)
    try:
        from rosbags.rosbag2 import StoragePlugin, Writer
        from rosbags.typesys import Stores, get_typestore
    except ImportError:
        raise FileError(path, "bags need another package; pip install 'pinposture[ros]'") from None
    require_positive("start", start)
    alone = path.suffix.lower() == ".mcap"
    if path.exists() and not (alone and path.is_file()):
        raise FileError(path, "exists already; allowed: the name of a new folder, or of a .mcap file")
    check_writable(path.parent)
    types = get_typestore(Stores.ROS2_HUMBLE)
    topics = {}
    connections = {}
    messages = list(_messages(types.types, trajectory, arm, start))
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=f".{path.stem}-", dir=path.parent) as draft:
            bag = Path(draft) / path.stem
            with Writer(bag, version=BAG_VERSION, storage_plugin=StoragePlugin.MCAP) as writer:
                for topic, _, message in messages:
                    topics[topic] = message.__msgtype__
                for topic, kind in topics.items():
                    profile = _latched() if topic == "/robot_description" else ()
                    connections[topic] = writer.add_connection(
                        topic, kind, typestore=types, offered_qos_profiles=profile
                    )
                for topic, stamp, message in messages:
                    data = types.serialize_cdr(message, topics[topic])
                    writer.write(connections[topic], stamp, data)
            if alone:
                (bag / f"{bag.name}.mcap").replace(path)
            else:
                shutil.move(bag, path)
    except OSError as error:
        raise FileError(path, f"cannot be written ({error.strerror or error})") from error
    return path


def _latched() -> tuple[Any]:
    """Return the quality of service with which late subscribers still receive the message."""
    from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime

    forever = QosTime(sec=2**31 - 1, nsec=NANOSECONDS - 1)
    profile = Qos(
        history=QosHistory.KEEP_LAST,
        depth=1,
        reliability=QosReliability.RELIABLE,
        durability=QosDurability.TRANSIENT_LOCAL,
        deadline=forever,
        lifespan=forever,
        liveliness=QosLiveliness.AUTOMATIC,
        liveliness_lease_duration=forever,
        avoid_ros_namespace_conventions=False,
    )
    return (profile,)


def _messages(
    types: Any, trajectory: JointTrajectory, arm: Arm | None, start: float
) -> Iterator[tuple[str, int, Any]]:
    """Yield the topic, the time stamp [ns] and the content of each message, in chronological order."""
    described = to_message(trajectory)
    offset = round(start * NANOSECONDS)
    make = {name: types[f"{package}/msg/{name}"] for package, name in _TYPES}

    def header(stamp: int, frame: str = "") -> Any:
        seconds, nanoseconds = divmod(stamp, NANOSECONDS)
        return make["Header"](make["Time"](seconds, nanoseconds), frame)

    if arm is not None and arm.urdf is not None:
        yield "/robot_description", offset, make["String"](arm.urdf)
    points = [
        make["JointTrajectoryPoint"](
            *(np.array(point[name]) for name in ("positions", "velocities", "accelerations", "effort")),
            make["Duration"](**point["time_from_start"]),
        )
        for point in described["points"]
    ]
    command = make["JointTrajectory"](header(0), described["joint_names"], points)
    yield "/joint_trajectory", offset, command
    tree = None if arm is None else _LinkTree(arm, trajectory)
    for row, point in enumerate(described["points"]):
        time = point["time_from_start"]
        stamp = offset + time["sec"] * NANOSECONDS + time["nanosec"]
        yield (
            "/joint_states",
            stamp,
            make["JointState"](
                header(stamp),
                list(described["joint_names"]),
                trajectory.positions[row],
                trajectory.velocities[row],
                np.zeros(0),
            ),
        )
        if tree is not None:
            transforms = [
                make["TransformStamped"](
                    header(stamp, parent),
                    child,
                    make["Transform"](
                        make["Vector3"](*map(float, placement.translation)),
                        make["Quaternion"](*map(float, pin.Quaternion(placement.rotation).coeffs())),
                    ),
                )
                for parent, child, placement in tree.placements(row)
            ]
            yield "/tf", stamp, make["TFMessage"](transforms)


_TYPES = (
    ("builtin_interfaces", "Time"),
    ("builtin_interfaces", "Duration"),
    ("std_msgs", "Header"),
    ("std_msgs", "String"),
    ("sensor_msgs", "JointState"),
    ("trajectory_msgs", "JointTrajectory"),
    ("trajectory_msgs", "JointTrajectoryPoint"),
    ("geometry_msgs", "Vector3"),
    ("geometry_msgs", "Quaternion"),
    ("geometry_msgs", "Transform"),
    ("geometry_msgs", "TransformStamped"),
    ("tf2_msgs", "TFMessage"),
)
"""Message types by package and name."""


class _LinkTree:
    """Link placements relative to the parent links in the URDF of an arm, or to the world without a URDF.

    Raises:
        InvalidValue: the trajectory is of another arm, or the arm has too many joints or no links.
    """

    def __init__(self, arm: Arm, trajectory: JointTrajectory) -> None:
        if arm.nv > MAX_DOF:
            raise InvalidValue("degrees of freedom", arm.nv, f"at most {MAX_DOF}; or arm=None, without links")
        self._model = arm.model
        self._data = arm.model.createData()
        self._configurations = trajectory.configurations(arm)
        frames = enumerate(arm.model.frames)
        links = {str(each.name): k for k, each in frames if k and each.type == pin.FrameType.BODY}
        if not links:
            raise InvalidValue("arm", arm.name, "an arm with links, as loaded from a URDF")
        self._world = world_frame(arm)
        # `Frame.parentFrame` is that of the unreduced robot, and wrong if joints are locked.
        joints = () if arm.urdf is None else read_description(arm.urdf).joints
        carriers = {joint.child: joint.parent for joint in joints if joint.parent in links}
        self._links = {name: (carriers.get(name, self._world), frame) for name, frame in links.items()}

    def placements(self, row: int) -> Iterator[tuple[str, str, pin.SE3]]:
        """Yield the parent, the link, and the placement of the link in the frame of its parent."""
        pin.framesForwardKinematics(self._model, self._data, self._configurations[row])
        for name, (carrier, frame) in self._links.items():
            placement = self._data.oMf[frame]
            if carrier == self._world:
                yield carrier, name, placement
            else:
                yield carrier, name, self._data.oMf[self._links[carrier][1]].actInv(placement)
