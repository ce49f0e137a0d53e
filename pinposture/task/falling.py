"""Joints whose drives cannot hold them: how they are noticed, and where they fall to, if the others stay.

The energy of the weight beyond a hinge is -R cos(a), with the angle a from where it would hang freely. R and
a follow from the torque that holds the joint, R sin(a), and from the change of that torque as the joint
turns, R cos(a). Of a slide the force is the same everywhere.
"""

from __future__ import annotations

from collections.abc import Iterable
from math import asin, atan2, copysign, cos, hypot
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from pinposture.arm import Arm, ArmState
from pinposture.errors import InvalidValue
from pinposture.motion import JointFailure, Tracker

Array = NDArray[np.float64]

LEAST_PULL = 0.1
"""Share of the largest torque by which weight can load a joint, below which weight does not tell where the
joint hangs or falls: friction, a cable or a touch does."""


class FallingSettings(NamedTuple):
    """When a joint that was astray works again, and when an arm stands."""

    followed: float = 0.1
    """Motion of its command after which a joint that was astray works again, if it has moved by half of that
    to one and a half times as much, in `Arm.joint_units`. Joints that do not move are noticed before that."""

    still: float = 0.02
    """Motion of a joint up to which it stands, in `Arm.joint_units`."""

    stands_after: float = 0.5
    """Time within that after which an arm has come to rest [s]."""


FALLING = FallingSettings()


class Fall(NamedTuple):
    """How a joint falls.

    Attributes:
        rest: where it comes to rest, at an end stop if one is in the way [rad or m].
        farthest: how far it swings on the way there if nothing damps it [rad or m].
    """

    rest: float
    farthest: float


def fall_of(state: ArmState, column: int, torque: float) -> Fall | None:
    """Return how a joint falls from rest.

    Args:
        state: the state of the arm.
        column: the degree of freedom of the joint, which no other joint follows.
        torque: the largest torque or force of its drive, which pulls back to where it was [N m or N].

    Returns:
        The fall; without a motion if the drive holds the joint. None if weight does not tell where to.

    Raises:
        WeightUnknown: masses that are not known.
    """
    arm = state.arm
    here = float(state.positions[column])
    pull = -float(state.gravity_torques[column])
    if torque > 0.0 and abs(pull) <= torque:
        return Fall(here, here)
    limits = (float(arm.limits.lower[column]), float(arm.limits.upper[column]))
    least = LEAST_PULL * float(arm.outstretched_torques[column])
    stiffness = 0.0 if arm.slides[column] else float(state.gravity_gradient[column, column])
    if max(stiffness, abs(pull)) <= least:
        return None
    if arm.slides[column]:
        stop = limits[1] if pull > 0.0 else limits[0]
        return Fall(stop, stop)
    size = hypot(pull, stiffness)
    angle = atan2(abs(pull), stiffness)
    hanging = asin(torque / size)
    turning = _turning_point(size, torque, angle, hanging)
    rest, farthest = np.clip(here + copysign(1.0, pull) * (angle - np.array([hanging, turning])), *limits)
    return Fall(float(rest), float(farthest))


def torque_left(state: ArmState, column: int) -> float:
    """Return the torque or force that the drive of a joint still gives which has fallen to where it is.

    It is what holds the joint there, if nothing touches the arm; 0 at an end stop, and where that is less
    than `LEAST_PULL`.

    Args:
        state: the state of the arm.
        column: the degree of freedom of the joint.

    Raises:
        WeightUnknown: masses that are not known.
    """
    arm = state.arm
    here = float(state.positions[column])
    near = 0.02 * float(arm.joint_units[column])  # of an end stop, which gives way a little
    held = abs(float(state.gravity_torques[column]))
    at_stop = min(here - arm.limits.lower[column], arm.limits.upper[column] - here) < near
    return 0.0 if at_stop or held < LEAST_PULL * arm.outstretched_torques[column] else held


def require_falling(arm: Arm, columns: Iterable[int]) -> None:
    """Check that how joints fall is known: their weight, and that they move no other joint.

    Args:
        arm: the arm.
        columns: the degrees of freedom of the joints.

    Raises:
        InvalidValue: a joint that others follow.
        WeightUnknown: masses that are not known.
    """
    arm.require_masses()
    led = {coupling.leader for coupling in arm.couplings}
    for column in columns:
        name = arm.joint_names[column]
        if name in led:
            raise InvalidValue("failed", name, "a joint that no other follows, as it may fall")


class Fallen(NamedTuple):
    """An arm at rest, of which a joint has fallen.

    Attributes:
        joint: name of the joint.
        position: where it rests [rad or m].
        torque: the torque or force that its drive still gives [N m or N].
        q: the commanded configuration, (nq,), with the joint there.
    """

    joint: str
    position: float
    torque: float
    q: Array

    def __str__(self) -> str:
        return f"{self.joint} is {self.kind} at {self.position:.4g}"

    @property
    def kind(self) -> str:
        """How the joint fails: "limp" or "weak"."""
        return "weak" if self.torque > 0.0 else "limp"


def take_fallen(tracker: Tracker, joint: str, measured: Array) -> Fallen:
    """Have a tracker go on from where a joint has come to rest that has fallen; its arm is at rest.

    Args:
        tracker: the tracker, which has sent a command.
        joint: name of the joint.
        measured: the measured configuration, (nq,), of which only this joint counts.

    Returns:
        Where it rests, and what its drive still gives.

    Raises:
        WeightUnknown: masses that are not known.
    """
    arm = tracker.arm
    drives = arm.drives
    command = tracker.command
    column = arm.joint_names.index(joint)
    positions = arm.positions(command)
    positions[column] = arm.positions(measured)[column]
    state = arm.chain_at(arm.configuration(positions))
    torque = torque_left(state, column)
    fall = fall_of(state, column, torque)
    if fall is not None:
        positions[column] = fall.rest
    q = arm.configuration(positions)
    sent = drives.joint_positions(dict(zip(drives.names, tracker.positions.tolist(), strict=True)))
    sent = drives.positions(sent + arm.difference(command, q))
    limp = () if torque > 0.0 else (joint,)
    tracker.restart(dict(zip(drives.names, sent.tolist(), strict=True)), limp=limp)
    return Fallen(joint, float(positions[column]), torque, q)


class FailureWatch:
    """Remembers which joints of an arm were astray, and tells when the arm stands.

    A joint that was astray before it stands has fallen. It counts as one until it follows its command again,
    as one does that was only pushed.

    Attributes:
        astray: what was known of joints when they were last astray, limp or weak, by name, the last one last.

    Args:
        arm: the arm.
    """

    def __init__(self, arm: Arm) -> None:
        self.astray: dict[str, JointFailure] = {}
        self._arm = arm
        self._since: dict[str, tuple[float, float]] = {}
        self._rested: tuple[Array, float] | None = None

    def update(self, failures: Iterable[JointFailure], command: Array, measured: Array) -> None:
        """Take the joints that fail in a cycle.

        Args:
            failures: the joints that fail, as `Report.failures`.
            command: the configuration that was commanded in it, (nq,).
            measured: the configuration that was measured after it, (nq,).
        """
        failing = {failure.joint: failure for failure in failures}
        for name, failure in failing.items():
            if failure.kind != "stuck":
                self.astray.pop(name, None)
                self.astray[name] = failure
        if not self.astray:
            return
        arm = self._arm
        sent = arm.positions(command)
        reached = arm.positions(measured)
        for name in list(self.astray):
            if name in failing:
                self._since.pop(name, None)
                continue
            column = arm.joint_names.index(name)
            here = (float(sent[column]), float(reached[column]))
            began, stood = self._since.setdefault(name, here)
            way = sent[column] - began
            behind = way - (reached[column] - stood)
            if abs(way) >= FALLING.followed * arm.joint_units[column] and abs(behind) <= 0.5 * abs(way):
                self.forget(name)

    def forget(self, joint: str) -> None:
        """Take a joint, by its name, for one that works."""
        self.astray.pop(joint, None)
        self._since.pop(joint, None)

    def stands(self, measured: Array, time: float) -> bool:
        """Return whether the arm has come to rest; to be asked in every cycle meanwhile.

        Args:
            measured: the measured configuration, (nq,).
            time: when [s].
        """
        q, since = self._rested or (measured, time)
        moved = np.abs(self._arm.difference(q, measured)) > FALLING.still * self._arm.joint_units
        if self._rested is None or time < since or np.any(moved):
            self._rested = (measured, time)
            since = time
        return time - since >= FALLING.stands_after


def _turning_point(size: float, torque: float, angle: float, hanging: float) -> float:
    """Return how far a hinge swings to the other side of where it comes to rest [rad].

    Args:
        size: R [N m].
        torque: the torque that pulls it back [N m].
        angle: the angle from which it falls [rad].
        hanging: that at which it comes to rest [rad].
    """

    def gained(a: float) -> float:
        return size * (cos(a) - cos(angle)) - torque * (angle - a)

    if torque == 0.0:
        return -angle
    return brentq(gained, -angle, hanging) if gained(hanging) > 0.0 else hanging
