"""ROS 2 messages of joint trajectories as JSON or YAML, goals of FollowJointTrajectory, and bags."""

from __future__ import annotations

import json
import shutil
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import suppress
from itertools import chain, count, pairwise
from math import floor, nan
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pinposture._validation import is_number, require_positive
from pinposture.arm import Arm
from pinposture.arm.description import read_description
from pinposture.errors import FileError, InvalidValue, did_you_mean, install
from pinposture.motion.joint_files import Columns, with_computed_rates
from pinposture.motion.joint_trajectory import JointTrajectory, check_names
from pinposture.storage import check_writable, parse_json, read_text, require_suffix, write_text


def world_frame(arm: Arm) -> str:
    """Return the name of the world frame in transforms; no link or moving joint of the arm has it."""
    bodies = (str(frame.name) for frame in arm.model.frames if frame.type == pin.FrameType.BODY)
    taken = {*bodies, *map(str, arm.model.names)}
    names = chain(("world", "map"), (f"map_{number}" for number in count(2)))
    return next(name for name in names if name not in taken)


# The ROS 2 message trajectory_msgs/msg/JointTrajectory in JSON.
#
# Fields and types are those of the message definition, of `std_msgs/msg/Header` and of
# `builtin_interfaces/msg/Duration`: int32 seconds, uint32 nanoseconds, float64 numbers. The stamp is zero, so
# that a controller starts on receipt. Missing fields have the default of their type, as on the ROS command
# line: zero or empty.

NANOSECONDS = 10**9
"""Nanoseconds per second."""

MAX_SECONDS = 2**31 - 1
"""Largest int32 [s]."""

POINT_ARRAYS = ("positions", "velocities", "accelerations", "effort")


def to_message(trajectory: JointTrajectory) -> dict[str, Any]:
    """Return the message as plain data.

    Raises:
        InvalidValue: rows less than a nanosecond apart, or times out of the range of int32 seconds.
    """
    times = [_nanoseconds(float(seconds)) for seconds in trajectory.time]
    for k, (before, after) in enumerate(pairwise(times), start=1):
        if before == after:
            allowed = f"at least a nanosecond after time[{k - 1}] in a ROS 2 message"
            raise InvalidValue(f"time[{k}]", float(trajectory.time[k]), allowed)
    if times[-1] // NANOSECONDS > MAX_SECONDS:
        allowed = f"at most {MAX_SECONDS} s in a ROS 2 message"
        raise InvalidValue(f"time[{len(times) - 1}]", float(trajectory.time[-1]), allowed)
    rows = zip(
        times,
        trajectory.positions.tolist(),
        trajectory.velocities.tolist(),
        trajectory.accelerations.tolist(),
        strict=True,
    )
    return {
        "header": {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": ""},
        "joint_names": list(trajectory.joint_names),
        "points": [
            {
                "positions": positions,
                "velocities": velocities,
                "accelerations": accelerations,
                "effort": [],
                "time_from_start": {"sec": time // NANOSECONDS, "nanosec": time % NANOSECONDS},
            }
            for time, positions, velocities, accelerations in rows
        ],
    }


def write_ros_message(trajectory: JointTrajectory, path: Path) -> None:
    """Write the message in JSON, which is also YAML.

    Raises:
        FileError: the file cannot be written.
        InvalidValue: as `to_message`.
    """
    write_text(path, json.dumps(to_message(trajectory), allow_nan=False) + "\n")


def read_ros_message(path: Path) -> JointTrajectory:
    """Read a message, or a goal of the action FollowJointTrajectory with one as its `trajectory`.

    Missing rates are computed from positions; efforts are dropped.

    Raises:
        FileError: the file is missing or contains something else; names the point, 0-based.
    """
    text = read_text(path)
    content = parse_json(path, text) if path.suffix.lower() == ".json" else _parse_yaml(path, text)
    if isinstance(content, dict) and "trajectory" in content:
        content = content["trajectory"]
    _check_fields(path, "the message", content, ("header", "joint_names", "points"))
    joints = content.get("joint_names", [])
    if not isinstance(joints, list):
        raise FileError(path, f"joint_names is {joints!r}; allowed: a list of names")
    try:
        check_names(joints)
    except InvalidValue as error:
        raise FileError(path, str(error)) from error
    points = content.get("points", [])
    if not (isinstance(points, list) and points):
        raise FileError(path, f"points is {points!r}; allowed: a list of at least one point")
    times: list[int] = []
    tables: dict[str, list[list[float]]] = {name: [] for name in POINT_ARRAYS}
    for k, point in enumerate(points):
        _check_fields(path, f"points[{k}]", point, (*POINT_ARRAYS, "time_from_start"))
        times.append(_time(path, k, point.get("time_from_start", {}), times[-1] if times else -1))
        for name in POINT_ARRAYS:
            tables[name].append(_numbers(path, k, name, point.get(name, []), len(joints)))
    values = [np.array(tables[name]) for name in POINT_ARRAYS[:3]]
    return with_computed_rates(path, joints, np.array([time / NANOSECONDS for time in times]), values)


def _parse_yaml(path: Path, text: str) -> Any:
    """Return the content of a YAML text with one document, as `ros2 topic echo --once` prints it.

    Raises:
        FileError: it is malformed; names the line. It is not JSON as well, and PyYAML is not installed.
    """
    with suppress(ValueError, RecursionError):
        return json.loads(text)
    try:
        import yaml
    except ImportError:
        raise FileError(
            path, "is YAML and not JSON, which needs another package; pip install pyyaml"
        ) from None
    try:
        documents = [document for document in yaml.safe_load_all(text) if document is not None]
    except yaml.YAMLError as error:
        position = getattr(error, "problem_mark", None)
        line = "" if position is None else f"line {position.line + 1}: "
        raise FileError(path, f"{line}{getattr(error, 'problem', None) or 'is not YAML'}") from error
    except (ValueError, RecursionError) as error:
        raise FileError(path, f"cannot be read as YAML ({error})") from error
    if len(documents) != 1:
        raise FileError(path, f"has {len(documents)} documents; allowed: one message")
    return documents[0]


def _check_fields(path: Path, what: str, value: Any, fields: tuple[str, ...]) -> None:
    """Raise FileError unless a value is an object with some of these fields; others may be misspelt."""
    if not isinstance(value, dict):
        raise FileError(path, f"{what} is {_shown(value)}; allowed: an object with {', '.join(fields)}")
    for name in value:
        if name not in fields:
            hint = did_you_mean(name, fields)
            raise FileError(path, f"{what} has a field {name!r}{hint}; allowed: {', '.join(fields)}")


def _time(path: Path, number: int, value: Any, before: int) -> int:
    """Return the time of a point [ns], which must be after the previous one."""
    what = f"points[{number}].time_from_start"
    largest = {"sec": MAX_SECONDS, "nanosec": NANOSECONDS - 1}
    _check_fields(path, what, value, tuple(largest))
    for name, most in largest.items():
        part = value.get(name, 0)
        if type(part) is not int or not 0 <= part <= most:
            raise FileError(path, f"{what}.{name} is {_shown(part)}; allowed: whole numbers from 0 to {most}")
    time: int = value.get("sec", 0) * NANOSECONDS + value.get("nanosec", 0)
    if time <= before:
        allowed = f"more than {before / NANOSECONDS} s of points[{number - 1}]"
        raise FileError(path, f"{what} is {time / NANOSECONDS} s; allowed: {allowed}")
    return time


def _numbers(path: Path, number: int, name: str, value: Any, count: int) -> list[float]:
    """Return the numbers of a point, one for each joint; NaN if optional ones are missing."""
    what = f"points[{number}].{name}"
    optional = name != "positions"
    if value == [] and optional:
        return [nan] * count
    if not (isinstance(value, list) and len(value) == count):
        shown = f"of length {len(value)}" if isinstance(value, list) else _shown(value)
        allowed = f"{count}, one for each joint" + (", or none" if optional else "")
        raise FileError(path, f"{what} is {shown}; allowed: {allowed}")
    for k, part in enumerate(value):
        if not (is_number(part) and abs(part) <= sys.float_info.max):
            raise FileError(path, f"{what}[{k}] is {_shown(part)}; allowed: finite numbers")
    return list(map(float, value))


def _shown(value: Any) -> str:
    """Return a value as JSON has it, truncated."""
    text = json.dumps(value, default=str)
    return text if len(text) < 60 else text[:57] + "..."


def _nanoseconds(time: float) -> int:
    """Return a time rounded to whole nanoseconds; seconds are split off, as their product would round."""
    whole = floor(time)
    return whole * NANOSECONDS + round((time - whole) * NANOSECONDS)


# Goals and bags.


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
        raise FileError(path, f"bags need another package; {install('ros')}") from None
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
            # readable by all distributions since Humble
            with Writer(bag, version=8, storage_plugin=StoragePlugin.MCAP) as writer:
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
    packages = {
        "builtin_interfaces": ("Time", "Duration"),
        "std_msgs": ("Header", "String"),
        "sensor_msgs": ("JointState",),
        "trajectory_msgs": ("JointTrajectory", "JointTrajectoryPoint"),
        "geometry_msgs": ("Vector3", "Quaternion", "Transform", "TransformStamped"),
        "tf2_msgs": ("TFMessage",),
    }
    make = {name: types[f"{package}/msg/{name}"] for package, names in packages.items() for name in names}

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


class _LinkTree:
    """Link placements relative to the parent links in the URDF of an arm, or to the world without a URDF.

    Raises:
        InvalidValue: the trajectory is of another arm, or the arm has too many joints or no links.
    """

    def __init__(self, arm: Arm, trajectory: JointTrajectory) -> None:
        most = 200  # a `pin.Data` then takes 370 MB
        if arm.nv > most:
            raise InvalidValue("degrees of freedom", arm.nv, f"at most {most}; or arm=None, without links")
        self._model = arm.model
        self._data = arm.model.createData()
        self._configurations = trajectory.configurations(arm)
        frames = enumerate(arm.model.frames)
        links = {str(frame.name): k for k, frame in frames if k and frame.type == pin.FrameType.BODY}
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


# Logs in bags.


def is_bag(path: Path) -> bool:
    """Return whether a path is that of a ROS 2 bag, by its name or the metadata in a folder."""
    return path.suffix.lower() in (".mcap", ".db3") or (path / "metadata.yaml").is_file()


STATES = "/joint_states"
"""Topic of measured joint positions."""


def read_bag(path: Path, commands: str | None, joint_names: Sequence[str] = ()) -> tuple[Columns, Columns]:
    """Return measurements and commands of a bag; see `Log.read`.

    Times are the stamps of headers, or of reception where there are none.

    Args:
        path: the bag.
        commands: topic of the commands.
        joint_names: names of the joints of commands that have no names.

    Raises:
        FileError: the extra is missing, it cannot be read, or has not these topics.
    """
    try:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    except ImportError:
        raise FileError(path, f"bags need another package; {install('ros')}") from None
    if not path.exists():
        raise FileError(path, "no such bag")
    rows: dict[str, list[_Row]] = {STATES: []} if commands is None else {STATES: [], commands: []}
    try:
        with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
            kinds = {connection.topic: str(connection.msgtype) for connection in reader.connections}
            for topic in rows:
                if topic not in kinds:
                    raise FileError(path, f"has no topic {topic!r}; allowed: {', '.join(kinds)}")
                if kinds[topic] not in _LOGGED:
                    allowed = ", ".join(_LOGGED)
                    raise FileError(path, f"{topic!r} is of the type {kinds[topic]}; allowed: {allowed}")
            read = [connection for connection in reader.connections if connection.topic in rows]
            for connection, received, content in reader.messages(connections=read):
                message = reader.deserialize(content, connection.msgtype)
                rows[connection.topic] += _LOGGED[str(connection.msgtype)](message, received, joint_names)
    except FileError:
        raise
    except Exception as error:  # a damaged bag can raise anything
        raise FileError(path, f"is not a bag that can be read ({type(error).__name__}: {error})") from error
    if commands is None:
        raise FileError(path, f"name the topic of the commands; it has {', '.join(kinds)}")
    return _as_columns(path, STATES, rows[STATES], "position"), _as_columns(
        path, commands, rows[commands], "command"
    )


class _Row(NamedTuple):
    """A message of a log: its time [ns], joints, positions and efforts."""

    time: int
    names: tuple[str, ...]
    positions: NDArray[np.float64]
    effort: NDArray[np.float64]


def stamp_of(message: Any) -> int:
    """Return the time stamp of a message with a header [ns]."""
    stamp = message.header.stamp
    return int(stamp.sec) * NANOSECONDS + int(stamp.nanosec)


def _joint_state(message: Any, received: int, _: Sequence[str]) -> list[_Row]:
    return [_Row(stamp_of(message) or received, tuple(message.name), message.position, message.effort)]


def _joint_trajectory(message: Any, received: int, _: Sequence[str]) -> list[_Row]:
    begin = stamp_of(message) or received
    names = tuple(message.joint_names)
    rows = []
    for point in message.points:
        after = int(point.time_from_start.sec) * NANOSECONDS + int(point.time_from_start.nanosec)
        rows.append(_Row(begin + after, names, point.positions, np.zeros(0)))
    return rows


def _numbers_alone(message: Any, received: int, names: Sequence[str]) -> list[_Row]:
    labels = tuple(names) or tuple(str(k) for k in range(len(message.data)))
    return [_Row(received, labels, message.data, np.zeros(0))]


_LOGGED = {
    "sensor_msgs/msg/JointState": _joint_state,
    "trajectory_msgs/msg/JointTrajectory": _joint_trajectory,
    "std_msgs/msg/Float64MultiArray": _numbers_alone,
}
"""Messages that a log is made of."""


def _as_columns(path: Path, topic: str, rows: Sequence[_Row], kind: str) -> Columns:
    """Return the rows of a topic, in the order of their times, as columns."""
    known = [row for row in rows if len(row.names) and len(row.positions) == len(row.names)]
    if not known:
        raise FileError(path, f"has no positions on the topic {topic!r}")
    ordered = sorted(known, key=lambda row: row.time)
    names = tuple(dict.fromkeys(name for row in ordered for name in row.names))
    tables: dict[tuple[str, str], NDArray[np.float64]] = {}
    for number, row in enumerate(ordered):
        for name, position in zip(row.names, row.positions, strict=True):
            tables.setdefault((kind, name), np.full(len(ordered), nan))[number] = position
        for name, effort in zip(row.names, row.effort, strict=False):
            tables.setdefault(("effort", name), np.full(len(ordered), nan))[number] = effort
    times = np.array([divmod(row.time, NANOSECONDS) for row in ordered], dtype=np.float64)
    return Columns(times, names, tables)
