"""Sensors on the links of a simulated arm: inertial ones, and a tracking system that sees the tip."""

from __future__ import annotations

from collections import deque
from typing import Annotated, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pinposture.arm import Arm
from pinposture.arm.kinematics import frame_ids
from pinposture.schema import Declared, Flag, PositiveNumber, WholeNumber, declared, quantity

Array = NDArray[np.float64]


@declared()
class LinkSensing(Declared):
    """Sensors on the links of an arm: none by default.

    Attributes:
        imus: the distance of control points that carry inertial sensors: 1 is all, 2 every second one, the
            tip among them; 0: none.
        imu_noise: standard deviation of an orientation about each axis [rad], and of an acceleration along
            each axis, in that of gravity.
        tip_pose: whether the pose of the tip is measured.
        tip_noise: standard deviation of its position along each axis [m].
        tip_turn_noise: standard deviation of its orientation about each axis [rad].
        rate: number of readings per second [Hz].
        seed: random seed of the noise.

    Raises:
        InvalidValue: a number that is out of range.
    """

    imus: WholeNumber = 0
    imu_noise: Annotated[float, quantity("angle", least=0.0)] = 0.01
    tip_pose: Flag = False
    tip_noise: Annotated[float, quantity("length", least=0.0)] = 0.001
    tip_turn_noise: Annotated[float, quantity("angle", least=0.0)] = 0.01
    rate: PositiveNumber = 50.0
    seed: WholeNumber = 0


class InertialReading(NamedTuple):
    """What an inertial sensor measures.

    Attributes:
        link: the link that carries it, in whose frame it measures, at its origin.
        rotation: its orientation, world frame, (3, 3).
        velocity: its angular velocity, (3,) [rad/s].
        acceleration: its acceleration but for that of free fall, (3,) [m/s^2].
    """

    link: str
    rotation: Array
    velocity: Array
    acceleration: Array


class LinkSensors:
    """The sensors on the links of an arm during a simulation.

    Attributes:
        links: the links that carry inertial sensors.

    Args:
        arm: the arm.
        sensing: the sensors.
        dt: time between two calls of `move` [s].
    """

    def __init__(self, arm: Arm, sensing: LinkSensing, dt: float) -> None:
        self.sensing = sensing
        self._dt = dt
        self._model = arm.model
        self._data = arm.model.createData()
        self._rng = np.random.default_rng(sensing.seed)
        self._passed: deque[tuple[Array, Array]] = deque(maxlen=3)
        points = frame_ids(arm.model, arm.control_points)
        carriers = points[:: -sensing.imus][::-1] if sensing.imus else []
        links = [self._link_of(point) for point in carriers]
        self.links = tuple(str(arm.model.frames[link].name) for link in links)
        self._frames = [*links, points[-1]]

    def move(self, q: Array) -> None:
        """Tell where the arm is, (nq,), one cycle after the last time."""
        pin.framesForwardKinematics(self._model, self._data, q)
        placements = [self._data.oMf[frame] for frame in self._frames]
        points = np.array([placement.translation for placement in placements])
        self._passed.append((points, np.array([placement.rotation for placement in placements])))

    def _link_of(self, point: int) -> int:
        """Return the frame of the last link that moves with a control point, or its own."""
        frames = self._model.frames
        joint = frames[point].parentJoint
        links = [
            k
            for k, frame in enumerate(frames)
            if frame.type == pin.FrameType.BODY and frame.parentJoint == joint
        ]
        return max(links, default=point)

    def read_inertial(self) -> list[InertialReading]:
        """Return what the inertial sensors measure: velocity and acceleration by differences of cycles."""
        points, rotations = zip(*self._passed, strict=True)
        before = rotations[-2] if len(rotations) > 1 else rotations[-1]
        moving = np.zeros_like(points[-1])
        if len(points) == 3:
            moving = (points[2] - 2.0 * points[1] + points[0]) / self._dt**2
        gravity = self._model.gravity.linear
        noise = self.sensing.imu_noise
        strength = float(np.linalg.norm(gravity))
        readings = []
        for k, link in enumerate(self.links):
            turn = rotations[-1][k]
            felt = turn.T @ (moving[k] - gravity) + noise * strength * self._rng.standard_normal(3)
            turned = turn @ pin.exp3(noise * self._rng.standard_normal(3))
            velocity = pin.log3(before[k].T @ turn) / self._dt
            readings.append(InertialReading(link, turned, velocity, felt))
        return readings

    def read_tip(self) -> pin.SE3 | None:
        """Return the measured placement of the tip, world frame; None if it is not measured."""
        if not self.sensing.tip_pose:
            return None
        points, rotations = self._passed[-1]
        turn = pin.exp3(self.sensing.tip_turn_noise * self._rng.standard_normal(3))
        return pin.SE3(
            rotations[-1] @ turn, points[-1] + self.sensing.tip_noise * self._rng.standard_normal(3)
        )
