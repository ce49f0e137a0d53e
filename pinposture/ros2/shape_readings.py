"""The shape of an arm as sensed: encoders of some joints, inertial sensors on links, the pose of the tip."""

from __future__ import annotations

from collections import defaultdict, deque
from math import inf, nan
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pinposture._validation import LARGEST_COORDINATE
from pinposture.arm import Arm
from pinposture.arm.kinematics import frame_ids
from pinposture.errors import InvalidValue, enumerated
from pinposture.motion import ShapeEstimator
from pinposture.motion.ros import NANOSECONDS, stamp_of
from pinposture.motion.shape_estimator import SIDES, SMALLEST_NOISE
from pinposture.ros2.clouds import CloudFrames
from pinposture.ros2.joint_readings import JointMeasurement, JointReading, JointReadings, fault_of_stamp
from pinposture.schema import CheckedBy, Declared, Flag, Length, Text, declared, one_of, quantity
from pinposture.units import length_text

Array = NDArray[np.float64]


TIP = "pose of the tip"
"""The sensor of the tip, beside those of joints and links."""


NO_HEADING = np.full((3, 3), np.nan)
"""The orientation of a sensor that tells only which way is up."""

FAULTS = ("missing sensors", "outliers", "refused messages")
"""What is the matter with sensors, in what diagnostics tell of them."""


class SensingSettings(NamedTuple):
    """How readings of sensors become a shape."""

    begun_deviation: float = 0.3
    """Standard deviation of joints from where they are taken to be at first, in `Arm.joint_units`: those
    without an encoder begin straight, and estimates from farther off may fit another posture."""

    known_share: float = 0.05
    """Root mean square distance of a control point from where it is believed to be above which an arm holds,
    if none is given, in lengths of the arm."""


SENSING = SensingSettings()


def _topics(name: str, value: object) -> tuple[str, ...]:
    names = (value,) if isinstance(value, str) else value
    if not isinstance(names, list | tuple) or not all(isinstance(topic, str) and topic for topic in names):
        raise InvalidValue(name, value, "a name of a topic, or a list of them")
    return tuple(names)


_Deviation = Annotated[float, quantity("angle", least=SMALLEST_NOISE)]


@declared()
class ShapeSensing(Declared):
    """What tells a driver the shape of an arm, beside or in place of encoders at all joints.

    Attributes:
        imus: topics of inertial sensors (`sensor_msgs/msg/Imu`), each in the frame of a link; they may share
            one.
        heading: whether the orientations of inertial sensors tell the heading, as with a compass; if not,
            only which way is up is taken from them.
        tip_pose: topic of the pose of the tip link (`geometry_msgs/msg/PoseStamped`), in the frame of the
            world or of the base; None: there is none.
        encoders: where the encoders of the joint states are: "joint", or "motor", before what gives way.
        encoder_noise: standard deviation of a reading of an encoder [rad or m].
        imu_noise: standard deviation of an orientation about each axis, if messages have no covariance [rad].
        tip_noise: standard deviation of the position of the tip along each axis [m].
        tip_turn_noise: standard deviation of its orientation about each axis [rad].
        give: standard deviation of joints from encoders on motors, besides the deflection that is known from
            masses and stiffness, in `Arm.joint_units` [rad].
        drift: how far joints move in a second otherwise than they are commanded, standard deviation, in
            `Arm.joint_units` [rad].
        max_deviation: root mean square distance of a control point from where it is believed to be above
            which the arm holds [m]; None: 5 % of the length of the arm.

    Raises:
        InvalidValue: a number that is out of range, or names that are none.
        UnknownName: another place of encoders.
    """

    imus: Annotated[tuple[str, ...], CheckedBy(_topics)] = ()
    heading: Flag = True
    tip_pose: Text | None = None
    encoders: Annotated[Literal["joint", "motor"], one_of("side of encoders", *SIDES)] = "joint"
    encoder_noise: Annotated[float, quantity("angle", "length", least=SMALLEST_NOISE)] = 1e-3
    imu_noise: _Deviation = 0.02
    tip_noise: Length = 0.002
    tip_turn_noise: _Deviation = 0.02
    give: Annotated[float, quantity("angle", least=0.0)] = 0.03
    drift: Annotated[float, quantity("angle", least=0.0)] = 0.1
    max_deviation: Length | None = None


class _Turn(NamedTuple):
    """What an inertial sensor has told, in the frame of its control point.

    Attributes:
        point: the control point.
        rotation: its orientation, world frame, (3, 3); NaN where the heading is not known.
        up: the direction upwards in its frame, (3,).
        noise: standard deviation [rad].
    """

    point: int
    rotation: Array
    up: Array
    noise: float


class ShapeReadings:
    """Estimates the configuration of an arm from the messages of all its sensors.

    It stands in place of `JointReadings` where some joints have no encoder, or give way behind it. Call
    `estimate` once in each cycle; every message counts once, moved on by what was commanded since its stamp.
    What it is told last, of the latest age, is what `measurement` returns.

    Attributes:
        sensing: what the sensors are.
        refused: number of messages of joint states that were refused.

    Args:
        arm: the arm.
        max_age: age above which readings do not count [s]; also how far stamps may be in the future.
        sensing: what the sensors are.
    """

    def __init__(self, arm: Arm, max_age: float, sensing: ShapeSensing) -> None:
        self.sensing = sensing
        self._arm = arm
        self._joints = JointReadings(arm, max_age)
        self._frames = CloudFrames(arm)
        self._carriers = _carriers(arm)
        self._most = sensing.max_deviation or SENSING.known_share * arm.length
        self.forget()

    @property
    def max_age(self) -> float:
        """Age above which readings do not count [s]."""
        return self._joints.max_age

    @max_age.setter
    def max_age(self, age: float) -> None:
        self._joints.max_age = age

    @property
    def refused(self) -> int:
        """Number of messages of joint states that were refused."""
        return self._joints.refused

    def forget(self) -> None:
        """Forget all that was measured, as after a jump of the clock."""
        self._joints.forget()
        self._estimator: ShapeEstimator | None = None
        self._stamps: dict[str, int] = {}  # of the last reading that was taken, by sensor [ns]
        self._turns: dict[str, _Turn] = {}  # that wait for the next cycle, by link
        self._tip: pin.SE3 | None = None
        self._faults: dict[str, str] = {}  # why the last message is refused, by sensor
        self._outliers: dict[str, int] = {}  # when a reading was last left out as an outlier, by sensor [ns]
        self._commands: deque[tuple[int, Array]] = deque()  # when drives were to be where, [ns] and (nv,)
        self._begun = 0  # when the first reading came [ns]
        self._used = 0  # the stamp of the latest reading that was used [ns]
        self._deviations = np.full(self._arm.n_modules, inf)

    # Messages.

    def take(self, message: Any, now: int) -> str:
        """Take a message of joint states; see `JointReadings.take`."""
        return self._joints.take(message, now)

    def take_imu(self, message: Any, now: int) -> str:
        """Take a message of an inertial sensor.

        Its orientation is used, or only what it tells of the vertical without `heading`; where it has none,
        as the first number of its covariance says, its acceleration tells which way is up.

        Args:
            message: a `sensor_msgs/msg/Imu`, in the frame of a link that moves with a control point.
            now: the time [ns].

        Returns:
            Why it is refused; empty if it is not.
        """
        link = message.header.frame_id
        sensor = f"imu {link!r}"
        if link not in self._carriers:
            allowed = enumerated(map(repr, self._carriers))
            return self._note(sensor, f"it moves with no control point; allowed: the frames {allowed}")
        fault = self._fault_of_stamp(sensor, stamp_of(message), now)
        turn = self._read_turn(message, *self._carriers[link])
        if turn is None and not fault:
            fault = "it tells no orientation, and no acceleration near that of gravity"
        if turn is not None and not fault:
            self._turns[link] = turn
            self._stamps[sensor] = stamp_of(message)
        return self._note(sensor, fault)

    def take_tip(self, message: Any, now: int) -> str:
        """Take a message with the pose of the tip link.

        Args:
            message: a `geometry_msgs/msg/PoseStamped`, in the frame of the world or of the base.
            now: the time [ns].

        Returns:
            Why it is refused; empty if it is not.
        """
        frame = message.header.frame_id
        base = self._frames.fixed(frame) if frame in self._frames.names else None
        point = message.pose.position
        position = np.array([point.x, point.y, point.z])
        rotation = _rotation(message.pose.orientation)
        fault = self._fault_of_stamp(TIP, stamp_of(message), now)
        if base is None:
            fault = f"its frame is {frame!r}; allowed: the world or the base"
        elif rotation is None or not np.all(np.abs(position) <= LARGEST_COORDINATE):
            fault = "its position is not finite, or its orientation no unit quaternion"
        elif not fault:
            self._tip = base * pin.SE3(rotation, position)
            self._stamps[TIP] = stamp_of(message)
        return self._note(TIP, fault)

    def _note(self, sensor: str, fault: str) -> str:
        """Note why the last message of a sensor is refused, or that it is not; return it."""
        self._faults.pop(sensor, None)
        if fault:
            self._faults[sensor] = fault
        return fault

    def _fault_of_stamp(self, sensor: str, stamp: int, now: int) -> str:
        last = self._stamps.get(sensor, stamp)
        return fault_of_stamp("its messages", stamp, last, now, self.max_age)

    def _read_turn(self, message: Any, point: int, mounting: Array) -> _Turn | None:
        """Return what an inertial sensor tells, given its mounting on a control point; None: nothing."""
        rotation = _rotation(message.orientation)
        known = message.orientation_covariance[0] >= 0.0  # -1: the sensor has no orientation
        if known and rotation is not None:
            variance = float(np.mean(np.diagonal(np.reshape(message.orientation_covariance, (3, 3)))))
            noise = np.sqrt(variance) if variance > 0.0 else self.sensing.imu_noise
            turned = rotation @ mounting.T
            heading = turned if self.sensing.heading else NO_HEADING
            return _Turn(point, heading, turned[2], float(np.clip(noise, SMALLEST_NOISE, np.pi)))
        felt = message.linear_acceleration
        up = mounting @ np.array([felt.x, felt.y, felt.z])
        gravity = float(np.linalg.norm(self._arm.model.gravity.linear))
        strength = float(np.linalg.norm(up))
        if not 0.5 * gravity < strength < 2.0 * gravity or message.linear_acceleration_covariance[0] < 0.0:
            return None
        return _Turn(point, NO_HEADING, up, float(np.hypot(self.sensing.imu_noise, strength / gravity - 1.0)))

    # The shape.

    def estimate(self, now: int, dt: float, commanded: Array | None) -> None:
        """Take the readings that have come since the last cycle.

        The first of them may wait for others for `max_age`: joints come in several messages, and what is
        known of them is where the estimate begins.

        Args:
            now: the time [ns].
            dt: the time since the last cycle [s].
            commanded: where the drives are to be now, in the order of `Arm.drives`, (nv,) [rad or m]; None:
                nothing was sent.
        """
        joints = self._joints.recent(now)
        if self._estimator is None:
            self._begin(now, {name: reading.position for name, reading in joints.items()})
            return
        estimator = self._estimator
        estimator.predict(dt, self._command(now, commanded))
        fresh = {
            name: reading
            for name, reading in joints.items()
            if reading.stamp > self._stamps.get(_encoder(name), 0)
        }
        self._stamps |= {_encoder(name): reading.stamp for name, reading in fresh.items()}
        if fresh:
            self._add_encoders(estimator, self._moved_on(fresh), now)
        self._add_turns(estimator, now)
        if self._tip is not None:
            sensing = self.sensing
            turn, shift = self._motion_since(self._stamps[TIP], estimator.q)
            tip = self._tip * pin.SE3(turn[-1], shift[-1])
            used = estimator.add_placement(tip, sensing.tip_noise, sensing.tip_turn_noise)
            self._judge({TIP: bool(used.all())}, now)
            self._tip = None
        self._deviations = estimator.point_deviations

    def _command(self, now: int, commanded: Array | None) -> Array | None:
        """Note where drives are to be at a time [ns]; return how far joints were to move since the last."""
        commands = self._commands
        if commanded is None:
            commands.clear()
            return None
        commands.append((now, commanded.copy()))
        while len(commands) > 2 and commands[1][0] < now - self.max_age * NANOSECONDS:
            commands.popleft()
        if len(commands) < 2:
            return None
        return np.asarray(self._arm.drives.joint_velocities(commanded - commands[-2][1]))

    def _commanded_since(self, stamp: int) -> Array:
        """Return how far drives were to move from a time on [ns] until now, (nv,) [rad or m]."""
        commands = self._commands
        if not commands or stamp >= commands[-1][0]:
            return np.zeros(self._arm.nv)
        later = next(k for k, (at, _) in enumerate(commands) if at > stamp)
        if later == 0:
            return commands[-1][1] - commands[0][1]
        (before, start), (after, end) = commands[later - 1], commands[later]
        then = start + (stamp - before) / (after - before) * (end - start)
        return np.asarray(commands[-1][1] - then)

    def _moved_on(self, readings: dict[str, JointReading]) -> dict[str, float]:
        """Return where encoders would be read now, by the names of the joints."""
        columns = {name: column for column, name in enumerate(self._arm.drives.names)}
        moved = {stamp: self._commanded_since(stamp) for stamp in {each.stamp for each in readings.values()}}
        return {
            name: reading.position + float(moved[reading.stamp][columns[name]])
            for name, reading in readings.items()
        }

    def _motion_since(self, stamp: int, q: Array) -> tuple[Array, Array]:
        """Return how control points were to move from a time on [ns] to a configuration now, (nq,).

        Returns:
            Their turns, (m, 3, 3), and shifts, (m, 3) [m], in their frames at that time.
        """
        arm = self._arm
        now = arm.chain_at(q)
        then = now.moved(-arm.drives.joint_velocities(self._commanded_since(stamp)))
        back = np.swapaxes(then.rotations, 1, 2)
        return back @ now.rotations, (back @ (now.points - then.points)[..., None])[..., 0]

    def _begin(self, now: int, positions: dict[str, float]) -> None:
        """Begin with the joints whose positions are known, by name, after some time for their messages."""
        if not (positions or self._turns or self._tip):
            return
        self._begun = self._begun or now
        if len(positions) < self._arm.nv and now < self._begun + self.max_age * NANOSECONDS:
            return
        arm = self._arm
        begun = arm.positions(arm.straight())
        for column, position in arm.drives.find(positions).items():
            begun[column] = position
        sensing = self.sensing
        self._estimator = ShapeEstimator(
            arm,
            arm.configuration(begun),
            deviation=SENSING.begun_deviation,
            drift=sensing.drift,
            give=sensing.give if sensing.encoders == "motor" else 0.0,
        )

    def _add_encoders(self, estimator: ShapeEstimator, positions: dict[str, float], now: int) -> None:
        sensing = self.sensing
        used = estimator.add_encoders(positions, sensing.encoder_noise, sensing.encoders)
        names = self._arm.drives.names
        read = self._arm.drives.find(positions)
        self._judge({_encoder(names[column]): bool(used[column]) for column in read}, now)

    def _add_turns(self, estimator: ShapeEstimator, now: int) -> None:
        """Take what inertial sensors have told, those of equal noise together."""
        alike: dict[tuple[bool, float], list[str]] = defaultdict(list)
        for link, turn in self._turns.items():
            alike[turn.rotation is NO_HEADING, turn.noise].append(link)
        for (level, noise), links in alike.items():
            turns = [self._turns[link] for link in links]
            points = [turn.point for turn in turns]
            stamps = [self._stamps[f"imu {link!r}"] for link in links]
            since = {stamp: self._motion_since(stamp, estimator.q)[0] for stamp in set(stamps)}
            moved = [since[stamp][point] for stamp, point in zip(stamps, points, strict=True)]
            if level:
                ups = [turned.T @ turn.up for turned, turn in zip(moved, turns, strict=True)]
                used = estimator.add_tilts(ups, noise, points)
            else:
                rotations = [turn.rotation @ turned for turned, turn in zip(moved, turns, strict=True)]
                used = estimator.add_orientations(rotations, noise, points)
            self._judge({f"imu {link!r}": bool(well) for link, well in zip(links, used, strict=True)}, now)
        self._turns = {}

    def _judge(self, used: dict[str, bool], now: int) -> None:
        """Note which readings were used, by sensor, and which were outliers."""
        for sensor, well in used.items():
            if well:
                self._used = max(self._used, self._stamps[sensor])
            else:
                self._outliers[sensor] = now

    def measurement(self, now: int) -> JointMeasurement:
        """Return what is known of the joints at a time [ns]."""
        if self._estimator is None or not self._used:
            reason = self._joints.measurement(now).reason or "the shape is not estimated yet"
            return JointMeasurement(None, None, nan, 0, reason)
        age = (now - self._used) / NANOSECONDS
        worst = int(self._deviations.argmax())
        reason = ""
        if age > self.max_age:
            old = f"{age:.3g} s ago; at most max_age, {self.max_age:.3g} s, is used"
            reason = f"the last reading of any sensor that could be used is of {old}"
        elif self._deviations[worst] > self._most:
            known = length_text(self._deviations[worst])
            where = f"control point {self._arm.control_points[worst]!r} is known to {known}"
            missing = self.told(now)["missing sensors"] or "none"
            reason = f"{where}; at most {length_text(self._most)} is allowed (missing sensors: {missing})"
        if reason:
            return JointMeasurement(None, None, age, self._used, reason)
        arm = self._arm
        positions = arm.drives.named(arm.drives.positions(arm.positions(self._estimator.q)))
        return JointMeasurement(positions, self._joints.measurement(now).torques, age, self._used, "")

    def told(self, now: int) -> dict[str, str]:
        """Return what diagnostics tell of the sensors at a time [ns], by what it is; empty: all is well."""
        recent = self._joints.recent(now)
        oldest = now - self.max_age * NANOSECONDS
        silent = [_encoder(name) for name in self._arm.drives.names if name not in recent]
        silent += [name for name, stamp in self._stamps.items() if stamp < oldest and name not in silent]
        outliers = [name for name, last in self._outliers.items() if last >= oldest]
        faults = (
            enumerated(silent),
            enumerated(outliers),
            "; ".join(f"{name}: {fault}" for name, fault in self._faults.items()),
        )
        told = dict(zip(FAULTS, faults, strict=True))
        return told | {"uncertainty of the shape": length_text(float(self._deviations.max()))}


def _encoder(joint: str) -> str:
    return f"encoder {joint!r}"


def _carriers(arm: Arm) -> dict[str, tuple[int, Array]]:
    """Return the control point with which each link moves, and the rotation from its frame to that one's."""
    model = arm.model
    points = [model.frames[frame] for frame in frame_ids(model, arm.control_points)]
    carriers: dict[str, tuple[int, Array]] = {}
    kinds = (pin.FrameType.OP_FRAME, pin.FrameType.BODY)
    for link in model.frames:
        for number, point in enumerate(points):
            if link.type in kinds and link.parentJoint == point.parentJoint:
                turned = point.placement.rotation.T @ link.placement.rotation
                carriers[str(link.name)] = (number, turned)
    return carriers


def _rotation(quaternion: Any) -> Array | None:
    """Return the matrix of a `geometry_msgs/msg/Quaternion`; None if it is none of unit length."""
    parts = np.array([quaternion.x, quaternion.y, quaternion.z, quaternion.w])
    length = float(np.linalg.norm(parts))
    if not abs(length - 1.0) < 1e-3:
        return None
    return np.asarray(pin.Quaternion(parts / length).matrix())
