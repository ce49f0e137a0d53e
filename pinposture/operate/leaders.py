"""How few inputs move a whole arm: its tip is steered along a path that it lays, or moved straight."""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from pinposture.arm import Arm
from pinposture.collision import CollisionModel, Scene
from pinposture.control import Limits
from pinposture.control.limits import cycle_of
from pinposture.control.reach import reach_from
from pinposture.errors import PostureError
from pinposture.placement.target import Target, arm_axis
from pinposture.task import Steering
from pinposture.task.steering import STEERING, describe_contact, entry_frame, moving_target
from pinposture.units import CONVERGED

Array = NDArray[np.float64]


class LeaderSettings(NamedTuple):
    """How far a tip is led in a cycle."""

    bend: float = 0.3
    """Bend of the longest module at full deflection [rad]. An arm that cannot bend so much bends less. With
    twice of it, 20 modules of 5 cm turn within 8 cm, less than an operator can aim at; with half of it, they
    need 33 cm."""

    attempts: int = 4
    """Halvings of a motion of the tip until joints are within their velocity limits. With 2 to 6, straight
    arms of 6 and of 20 modules came back equally fast."""

    easing: float = 0.1
    """Shortest time from rest to full speed [s]."""

    nudge: float = 0.01
    """Bend of each joint, in `Arm.joint_units`, from which a posture is sought where there is none from the
    present one: a straight arm cannot tell to which side it is to bend."""

    room: float = 0.002
    """Distance beyond the margin that a tip keeps which is moved along straight lines, in arm lengths: where
    it turns aside at once, the arm cannot. One of 6 modules came 0.0015 closer than what led it."""


LEADERS = LeaderSettings()


class TipLeader(Protocol):
    """What turns the motion of a tip into postures of the arm, cycle by cycle.

    Attributes:
        acceleration: how fast the speed of the tip may change [m/s^2].
        withdraws: whether it leads back along the path by which it came, by itself.
    """

    acceleration: float

    @property
    def q(self) -> Array:
        """The configuration of the last step, (nq,)."""

    @property
    def reason(self) -> str:
        """Why the last step was not as asked for; empty if it was."""

    @property
    def line(self) -> Array:
        """Points of the way that the tip was led, (n, 3) [m], world frame; none before it moves."""

    withdraws: bool

    def rejoin(self, q: Array) -> str:
        """Go on from a configuration, (nq,), to which something else has led; return why it cannot."""

    def move(self, velocity: Array, scene: Scene) -> Target:
        """Move the tip for a cycle.

        Args:
            velocity: its velocity ahead, to the left and up, (3,) [m/s].
            scene: what the arm has to keep clear of.

        Returns:
            The target of this cycle, with its velocity.
        """


class SteeredTip:
    """Leads an arm on a feed by a `Steering`: ahead and back along the path, left and up bend it.

    Attributes:
        acceleration: how fast the speed may change, so that the feed follows [m/s^2].

    Args:
        arm: the arm.
        limits: limits of the joints, with the duration of a cycle.
        start: where the arm is, (nq,): the path begins where it would be straight, with that position of the
            feed.
        speed: the full speed [m/s], at which left and up bend the path as much as they can.

    Raises:
        InvalidValue: not an arm on a feed, or a start that is not straight.
    """

    withdraws = True

    def __init__(self, arm: Arm, limits: Limits, start: Array, speed: float) -> None:
        column = int(arm.chain.columns[0])
        positions = arm.positions(arm.straight())
        positions[column] = np.clip(
            arm.positions(start)[column], arm.limits.lower[column], arm.limits.upper[column]
        )
        self._steering = Steering(arm, limits, start=arm.configuration(positions))
        self._idle = ""
        self.acceleration = min(speed / LEADERS.easing, self._steering.acceleration)
        self._curvature = LEADERS.bend / float(arm.chain.module_lengths.max()) / speed

    @property
    def q(self) -> Array:
        """The configuration of the last step, (nq,)."""
        return self._steering.q

    @property
    def reason(self) -> str:
        """Why the last step was not as asked for; empty if it was."""
        return self._steering.reason or self._idle

    @property
    def line(self) -> Array:
        """Points of the path of the tip, (n, 3) [m], world frame; none before it moves."""
        if self._steering.depth <= 0.0:
            return np.zeros((0, 3))
        path = self._steering.path
        return np.asarray(path.at(np.linspace(0.0, path.length, 100)))

    def rejoin(self, q: Array) -> str:
        """Return why it cannot go on from a configuration, (nq,): it is off the path of the tip."""
        away = np.abs(self._steering.arm.difference(self.q, q)) / self._steering.arm.joint_units
        if away.max() <= CONVERGED:
            return ""
        return "the arm is off the path of its tip: drive the way back first"

    def move(self, velocity: Array, scene: Scene) -> Target:
        """Move the tip for a cycle; see `TipLeader.move`."""
        self._steering.scene = scene
        bend = self._curvature * velocity[1:]
        self._idle = "" if velocity[0] or not np.any(bend) else "it steers while it moves: hold ahead as well"
        return self._steering.step(float(velocity[0]), bend if np.any(bend) else None)


class MovedTip:
    """Leads an arm by its tip, along straight lines; the joints move as little as they can.

    It stands where an obstacle would come too close to any part of the arm, and does not give way to it.

    Ahead is the direction in which the straight arm points, up is opposite to gravity.

    Attributes:
        q: the configuration of the last step, (nq,).
        reason: why the last step was not as asked for; empty if it was.
        acceleration: how fast the speed may change [m/s^2].

    Args:
        arm: the arm.
        limits: limits of the joints, with the duration of a cycle.
        start: where the arm is, (nq,).
        speed: the full speed [m/s].
    """

    withdraws = False

    def __init__(self, arm: Arm, limits: Limits, start: Array, speed: float) -> None:
        self.acceleration = speed / LEADERS.easing
        self.q = arm.checked(start, "start")
        self.reason = ""
        self._arm = arm
        self._limits = limits
        self._dt = cycle_of(limits)
        self._frame = entry_frame(arm_axis(arm), np.asarray(arm.model.gravity.linear))
        self._line: list[Array] = []

    @property
    def line(self) -> Array:
        """Points of the way of the tip, (n, 3) [m], world frame; none before it moves."""
        return np.array(self._line).reshape(-1, 3)

    def rejoin(self, q: Array) -> str:
        """Go on from a configuration, (nq,); it always can."""
        self.q = q
        return ""

    def move(self, velocity: Array, scene: Scene) -> Target:
        """Move the tip for a cycle; see `TipLeader.move`.

        Where it cannot go, it goes as far as it can in one of the directions that are asked for.
        """
        before = self.q
        self.reason = ""
        parts = [velocity]
        if np.count_nonzero(velocity) > 1:
            parts += [part for part in np.diag(velocity) if np.any(part)]
        failed = ""
        for part in parts if np.any(velocity) else []:
            nearer = self._found(part, scene)
            if not isinstance(nearer, str):
                self.q = nearer
                self.reason = failed and f"moves in one direction only: {failed}"
                break
            failed = failed or nearer
            self.reason = f"stands: {failed}"
        return moving_target(self._arm, before, self.q, self._dt)

    def _bent(self) -> Array:
        """Return the present posture, bent a little more, (nq,)."""
        arm = self._arm
        bends = np.where(arm.slides, 0.0, LEADERS.nudge * arm.joint_units)
        positions = np.clip(arm.positions(self.q) + bends, arm.limits.lower, arm.limits.upper)
        return arm.configuration(positions)

    def _found(self, velocity: Array, scene: Scene) -> Array | str:
        """Return the configuration after the tip has moved, (nq,), or why there is none."""
        arm = self._arm
        tip = arm.chain_at(self.q).points[-1]
        bounds = STEERING.speed_share * self._limits.for_arm(arm).bound
        margin = scene.margin + LEADERS.room * arm.length
        shift = self._dt * (self._frame @ velocity)
        for _ in range(LEADERS.attempts):
            try:  # without obstacles: to push the arm clear of them can take several cycles
                state = reach_from(arm, tip + shift, self.q, limits=self._limits)
                state = state or reach_from(arm, tip + shift, self._bent(), limits=self._limits)
            except PostureError as error:
                return str(error)
            if state is None:
                return "no posture is found with the tip there"
            if np.all(np.abs(arm.difference(self.q, state.q)) <= bounds):
                return describe_contact(CollisionModel(arm, scene), self.q, state.q, margin) or state.q
            shift = 0.5 * shift
        return "joints would have to be faster than their velocity limits"


def leader_of(arm: Arm, limits: Limits, start: Array, speed: float) -> tuple[TipLeader, str]:
    """Return what leads an arm from a configuration (nq,) at a full speed [m/s], and how it is led."""
    try:
        return SteeredTip(arm, limits, start, speed), "steered: the body follows the path of the tip"
    except PostureError:
        return MovedTip(arm, limits, start, speed), "the tip is moved along straight lines"
