"""Velocities of obstacles, from the poses that they have in successive scenes."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pinposture import kernels
from pinposture._validation import LARGEST_LENGTH
from pinposture.collision import Scene
from pinposture.collision.obstacles import Obstacle
from pinposture.collision.scene import Twist
from pinposture.kernels.rate_of_change import RATE_FIT

Array = NDArray[np.float64]


class ObstacleVelocitySettings(NamedTuple):
    """How the velocity of an obstacle is found from its poses."""

    poses: int = 50
    """Largest number of poses that a velocity is fitted to: half a second of a loop at 100 Hz, in which
    noise of 1 mm leaves an error of 1 cm/s."""

    exact_pose: float = 1e-7
    """Noise that exact poses count with: of positions, in arm lengths, and of axes."""

    pictures: float = 2.0
    """Time in which the next pose is expected, in longest times between the last poses."""

    first_picture: float = 0.2
    """The same before these times are known [s]: cameras deliver 5 pictures a second or more."""


OBSTACLE_VELOCITY = ObstacleVelocitySettings()


class PoseHistory:
    """The last poses of an obstacle, and the velocity that they tell.

    A pose that is exactly the one before is no news: a camera may be slower than the loop. An obstacle
    stands if no other pose comes for `OBSTACLE_VELOCITY.pictures` times as long as they took before.

    Args:
        length: length of the arm [m].
    """

    def __init__(self, length: float) -> None:
        self._least_noise = OBSTACLE_VELOCITY.exact_pose * length
        self._times = np.zeros(0)
        self._positions = np.zeros((0, 3))
        self._axes = np.zeros((0, 9))
        self._velocity = np.zeros(6)
        self._uncertain = 0

    def add(self, time: float, obstacle: Obstacle) -> None:
        """Add the obstacle at a time [s], later than those before."""
        pose = obstacle.pose(np.zeros(3))
        position = pose.translation
        axes = pose.rotation.ravel()
        known = len(self._times) > 0
        if known and np.array_equal(position, self._positions[-1]) and np.array_equal(axes, self._axes[-1]):
            if len(self._times) == 1 or self._is_overdue(time):
                self._times = np.array([time])
                self._positions = self._positions[-1:]
                self._axes = self._axes[-1:]
                self._velocity = np.zeros(6)
            return
        self._times = np.append(self._times[1 - OBSTACLE_VELOCITY.poses :], time)
        self._positions = np.vstack([self._positions[1 - OBSTACLE_VELOCITY.poses :], position])
        self._axes = np.vstack([self._axes[1 - OBSTACLE_VELOCITY.poses :], axes])
        if len(self._times) >= RATE_FIT.fewest:
            self._estimate(pose.rotation)

    def velocity(self, time: float) -> Twist | None:
        """Return the velocity at a time [s], as in a `Scene`; None: it stands, or none is known."""
        fastest = float(np.abs(self._velocity).max())
        if self._is_overdue(time) or not 0.0 < fastest <= LARGEST_LENGTH:
            return None
        return tuple(self._velocity[: 6 if self._velocity[3:].any() else 3].tolist())

    def _is_overdue(self, time: float) -> bool:
        """Whether another pose would have come by now if the obstacle still moved."""
        patience = OBSTACLE_VELOCITY.first_picture
        if len(self._times) >= RATE_FIT.fewest:
            patience = OBSTACLE_VELOCITY.pictures * float(np.diff(self._times[-RATE_FIT.fewest - 1 :]).max())
        return bool(time - self._times[-1] > patience)

    def _estimate(self, rotation: Array) -> None:
        """Estimate the velocity; the former one stays while the last poses jump or turn off."""
        linear = np.zeros(3)
        moves = kernels.fit_rate(self._times, self._positions, self._least_noise, linear)
        turn = np.zeros(9)
        turns = kernels.fit_rate(self._times, self._axes, OBSTACLE_VELOCITY.exact_pose, turn)
        self._uncertain = 0 if moves and turns else self._uncertain + 1
        if 0 < self._uncertain < RATE_FIT.fewest:
            return
        spin = turn.reshape(3, 3) @ rotation.T
        angular = 0.5 * np.array([spin[2, 1] - spin[1, 2], spin[0, 2] - spin[2, 0], spin[1, 0] - spin[0, 1]])
        self._velocity = np.concatenate([linear, angular])


class ObstacleVelocities:
    """Takes the scenes of a control loop, and adds the velocities that they do not tell.

    The velocity of an obstacle that a scene tells always counts, zero too.

    Args:
        scene: the scene at the start; None: no scene.
        length: length of the arm [m].
    """

    def __init__(self, scene: Scene | None, length: float) -> None:
        self._scene = scene
        self._length = length
        self._now = 0.0
        self._age = 0.0
        self._histories: dict[str, PoseHistory] = {}

    def advance(self, scene: Scene | None, passed: float) -> Scene | None:
        """Return the scene of the next cycle, with all velocities.

        Args:
            scene: the obstacles; None: those of the last scene, moved on by their velocities.
            passed: time since the last cycle [s].
        """
        self._now += passed
        self._age += passed
        if scene is not None:
            self._take(scene)
        if self._scene is None:
            return None
        fitted = {name: history.velocity(self._now) for name, history in self._histories.items()}
        velocities = {name: velocity for name, velocity in fitted.items() if velocity is not None}
        scene_now = self._scene
        if velocities:
            scene_now = scene_now.moved({}, {**velocities, **scene_now.velocities})
        return scene_now.after(self._age) if self._age > 0.0 and scene_now.velocities else scene_now

    def _take(self, scene: Scene) -> None:
        """Take the scene of this moment."""
        if self._scene is None or scene.first != self._scene.first:
            self._histories = {}
        self._scene = scene
        self._age = 0.0
        untold = scene.moving - set(scene.velocities)
        self._histories = {name: self._histories.get(name) or PoseHistory(self._length) for name in untold}
        for name, history in self._histories.items():
            history.add(self._now, scene.obstacles[name])
