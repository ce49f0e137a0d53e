"""Measured joint positions from messages of JointState, which may come in parts, late, or not at all."""

from __future__ import annotations

from collections.abc import Mapping
from math import isfinite, nan
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from pinposture._validation import LARGEST_COORDINATE
from pinposture.arm import Arm
from pinposture.control import Limits
from pinposture.errors import PostureError, did_you_mean, enumerated
from pinposture.motion.ros import NANOSECONDS, stamp_of


class RobotDrives(Protocol):
    """Drives that are measured and commanded in place of `Arm.drives`: `CarriedDrives` or `Actuators`."""

    @property
    def names(self) -> tuple[str, ...]:
        """Their names."""

    def commands(self, positions: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return their positions for those of `Arm.drives`, both in their order."""

    def measured(self, positions: Mapping[str, float]) -> dict[str, float]:
        """Return the positions of `Arm.drives` for theirs, by name; raise a `PostureError` if none fit."""

    def limits(self, limits: Limits) -> Limits:
        """Return limits of the arm within which they keep theirs."""


class JointReading(NamedTuple):
    """What was measured of a joint.

    Attributes:
        position: its position [rad or m].
        effort: the torque or force of its drive [N m or N]; NaN if it is not measured.
        stamp: time of the measurement [ns].
    """

    position: float
    effort: float
    stamp: int


class JointMeasurement(NamedTuple):
    """What is known of the joints in a cycle.

    Attributes:
        positions: positions by the names of joints [rad or m]; None if they cannot be used.
        torques: torques or forces by the names of joints [N m or N]; None if some are not measured.
        age: age of the oldest position [s]; NaN if there is none.
        stamp: its time [ns]; 0 if there is none.
        reason: why they cannot be used; empty if they can.
    """

    positions: dict[str, float] | None
    torques: dict[str, float] | None
    age: float
    stamp: int
    reason: str


def fault_of_stamp(kind: str, stamp: int, last: int, now: int, max_age: float) -> str:
    """Return why a message cannot be used by its time stamp; empty if it can.

    Args:
        kind: the messages, in the plural.
        stamp: the stamp [ns].
        last: that of the message before, or the same if there was none [ns].
        now: the time [ns].
        max_age: how far stamps may be in the future [s].
    """
    if stamp == 0:
        return f"{kind} have no time stamp"
    ahead = (stamp - now) / NANOSECONDS
    if ahead > max_age:
        return f"{kind} are stamped {ahead:.3g} s in the future: do the clocks agree?"
    if stamp < last:
        return f"{kind} jump back in time by {(last - stamp) / NANOSECONDS:.3g} s"
    return ""


class JointReadings:
    """Collects the messages of JointState of an arm.

    A message may have the joints in any order, others as well, or only some: several messages then make up a
    measurement. One that is malformed, not stamped, stamped in the future, or stamped before a measurement
    that it would replace, is refused whole.

    Attributes:
        refused: number of messages that were refused.

    Args:
        arm: the arm; joints are those that its drives move (`Arm.drives`).
        max_age: age above which a position does not count [s]; also how far stamps may be in the future.
        drives: what is measured in place of these joints; efforts are then not known. None: they are.
    """

    def __init__(self, arm: Arm, max_age: float, drives: RobotDrives | None = None) -> None:
        self.max_age = max_age
        self.refused = 0
        self._arm = arm
        self._drives = drives
        self._names = arm.drives.names if drives is None else drives.names
        self._unknown: set[str] = set()
        self.forget()

    def forget(self) -> None:
        """Forget all measurements, as after a jump of the clock."""
        self._readings: dict[str, JointReading] = {}
        self._fault = ""

    def take(self, message: Any, now: int) -> str:
        """Take a message.

        Args:
            message: a `sensor_msgs/msg/JointState`.
            now: the time [ns].

        Returns:
            Why it is refused; empty if it is not.
        """
        self._fault = self._fault_of(message, now)
        if self._fault:
            self.refused += 1
            return self._fault
        stamp = stamp_of(message)
        efforts = message.effort if len(message.effort) == len(message.name) else [nan] * len(message.name)
        for name, position, effort in zip(message.name, message.position, efforts, strict=True):
            if name in self._names:
                self._readings[name] = JointReading(float(position), float(effort), stamp)
            else:
                self._unknown.add(name)
        return ""

    def _fault_of(self, message: Any, now: int) -> str:
        names = list(message.name)
        if len(names) != len(message.position):
            return f"joint states have {len(names)} names and {len(message.position)} positions"
        if len(set(names)) < len(names):
            twice = next(name for name in names if names.count(name) > 1)
            return f"joint states have {twice!r} twice"
        stamp = stamp_of(message)
        last = max((self._readings[name].stamp for name in names if name in self._readings), default=stamp)
        return fault_of_stamp("joint states", stamp, last, now, self.max_age)

    def recent(self, now: int) -> dict[str, JointReading]:
        """Return the readings that can be used at a time [ns], by the names of joints; others are missing."""
        oldest = now - self.max_age * NANOSECONDS
        return {
            name: reading
            for name, reading in self._readings.items()
            if reading.stamp >= oldest and _is_possible(reading.position)
        }

    def measurement(self, now: int) -> JointMeasurement:
        """Return what is known of the joints at a time [ns]."""
        missing = [name for name in self._names if name not in self._readings]
        if missing:
            return JointMeasurement(None, None, nan, 0, self._describe_missing(missing))
        oldest = min(self._names, key=lambda name: self._readings[name].stamp)
        stamp = self._readings[oldest].stamp
        age = (now - stamp) / NANOSECONDS
        positions = {name: self._readings[name].position for name in self._names}
        broken = [name for name, position in positions.items() if not _is_possible(position)]
        reason = ""
        if age > self.max_age:
            old = f"{age:.3g} s ago; at most max_age, {self.max_age:.3g} s, is used"
            reason = f"joint {oldest!r} was measured {old}"
            reason += f"; {self._fault}" if self._fault else ""
        elif broken:
            reason = f"the position of joint {broken[0]!r} is measured as {positions[broken[0]]}"
        if reason:
            return JointMeasurement(None, None, age, stamp, reason)
        if self._drives is not None:
            try:
                return JointMeasurement(self._drives.measured(positions), None, age, stamp, "")
            except PostureError as error:
                return JointMeasurement(None, None, age, stamp, str(error))
        torques = {name: self._readings[name].effort for name in self._names}
        known = all(isfinite(effort) for effort in torques.values())
        return JointMeasurement(positions, torques if known else None, age, stamp, "")

    def _describe_missing(self, missing: list[str]) -> str:
        if self._fault:
            return self._fault
        if not (self._readings or self._unknown):
            return "no joint states yet"
        hints = [f"{name!r}{did_you_mean(name, sorted(self._unknown))}" for name in missing]
        return f"joint states lack {enumerated(hints)}"


def _is_possible(position: float) -> bool:
    """Whether a joint can be at a position, which is not NaN and not huge."""
    return abs(position) <= LARGEST_COORDINATE
