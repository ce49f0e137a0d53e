"""Can a group of joints put its end on a curve? The question that decides where a module ends (Section 4.1).

The end must be able to move in every direction across the line from the base of the group to its end: in two
of them in space, in one in the plane. Whether it can is a matter of the joints, not of the posture that the
file calls zero, so it is asked in several postures; a straight or folded one would give the wrong answer.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from pinposture.arm.skeleton import Skeleton

Array = NDArray[np.float64]

POSTURES = 16
LEAST_MOTION = 0.05
"""How far one radian must move the end across, relative to its distance from the base of the group."""
LEAST_DISTANCE = 1e-3
"""How far the end must be from the base of the group, relative to the mean distance between joints."""
_SWING = 1.2
"""Largest excursion of a joint from its position nearest zero in the postures that are tried [rad]."""


class Placing:
    """Answers for one arm, remembered."""

    def __init__(self, skeleton: Skeleton) -> None:
        self._skeleton = skeleton
        self._pitch = skeleton.length / len(skeleton.names)
        self._known: dict[tuple[int, int], float] = {}
        swing = np.where(skeleton.revolute, _SWING, self._pitch)
        middle = np.clip(0.0, skeleton.lower, skeleton.upper)
        low, high = np.maximum(skeleton.lower, middle - swing), np.minimum(skeleton.upper, middle + swing)
        self._positions = np.random.default_rng(0).uniform(low, high, (POSTURES, len(middle)))

    def __call__(self, first: int, stop: int) -> bool:
        """True if joints first, ..., stop - 1 can place station `stop` on any curve through `first`."""
        return self.motion(first, stop) > LEAST_MOTION

    def motion(self, first: int, stop: int) -> float:
        """How far those joints move station `stop` in the direction across that is hardest for them.

        Returns:
            The motion for one radian, relative to the distance from station `first`: the median over the
            postures, not the least, because any module has singular ones. Zero if the end stays at the base.
        """
        if (first, stop) not in self._known:
            self._known[first, stop] = self._measured(first, stop)
        return self._known[first, stop]

    def _measured(self, first: int, stop: int) -> float:
        normal = self._skeleton.normal
        if stop - first < (2 if normal is None else 1):
            return 0.0
        ends, jacobians = self._motions(first, stop)
        distance = np.linalg.norm(ends, axis=1)
        apart = distance > LEAST_DISTANCE * self._pitch
        along = ends / np.where(apart, distance, 1.0)[:, None]
        if normal is None:
            across = jacobians - along[:, :, None] * np.einsum("si,sij->sj", along, jacobians)[:, None]
            motion = np.linalg.svd(across, compute_uv=False)[:, 1]
        else:
            motion = np.linalg.norm(np.einsum("si,sij->sj", np.cross(normal, along), jacobians), axis=1)
        return float(np.median(np.where(apart, motion / np.where(apart, distance, 1.0), 0.0)))

    def _motions(self, first: int, stop: int) -> tuple[Array, Array]:
        """End relative to the base (s, 3) [m] and its Jacobian (s, 3, k) [m/rad] in every posture tried."""
        arm = self._skeleton
        place, turn = np.zeros((POSTURES, 3)), np.broadcast_to(np.eye(3), (POSTURES, 3, 3))
        axes, origins = [], []
        for u in range(first, stop):
            amount = self._positions[:, u, None] * arm.axes[u]
            axes.append(turn @ arm.axes[u])
            origins.append(place)
            if arm.revolute[u]:
                turn = turn @ Rotation.from_rotvec(amount).as_matrix()
            else:
                place = place + np.einsum("sij,sj->si", turn, amount)
            place = place + turn @ (arm.stations[u + 1] - arm.stations[u])
        columns = [
            np.cross(axis, place - origin) if turns else axis * self._pitch
            for axis, origin, turns in zip(axes, origins, arm.revolute[first:stop], strict=True)
        ]
        return place, np.stack(columns, axis=2)
