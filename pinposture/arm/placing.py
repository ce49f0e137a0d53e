"""Can a group of joints put its end on a curve? The question that decides where a module ends (Section 4.1).

The end must be able to move in every direction across the line from the base of the group to its end: in two
of them in space, in one in the plane. Whether it can is a matter of the joints, not of the posture that the
file calls zero, so it is asked in several postures; a straight or folded one would give the wrong answer.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from pinposture.arm.skeleton import PARALLEL, Skeleton

Array = NDArray[np.float64]

POSTURES = 16
LEAST_MOTION = 0.05
"""How far one radian must move the end across, relative to its distance from the base of the group."""
LEAST_DISTANCE = 1e-3
"""How far the end must be from the base of the group, relative to the mean distance between joints."""
_SWING = 1.2
"""Largest excursion of a joint from its position nearest zero in the postures that are tried [rad]."""


class _Motion(NamedTuple):
    """How joints move their end across the line from their base to it, for one radian and unit distance.

    Attributes:
        easiest: in the direction in which they move it farthest.
        hardest: in the last of the directions that a curve asks for.
        movers: how many of them move it.
    """

    easiest: float
    hardest: float
    movers: int


class Placing:
    """Answers for one arm, remembered.

    Attributes:
        needed: in how many directions across a curve asks an end to move: two in space, one in the plane.
    """

    def __init__(self, skeleton: Skeleton) -> None:
        self._skeleton = skeleton
        self._pitch = skeleton.length / len(skeleton.names)
        self._known: dict[tuple[int, int], _Motion] = {}
        swing = np.where(skeleton.revolute, _SWING, self._pitch)
        middle = np.clip(0.0, skeleton.lower, skeleton.upper)
        swing[skeleton.roaming] = 0.0
        low, high = np.maximum(skeleton.lower, middle - swing), np.minimum(skeleton.upper, middle + swing)
        self._positions = np.random.default_rng(0).uniform(low, high, (POSTURES, len(middle)))
        self.needed = 2 if skeleton.normal is None else 1
        self._leaving = _leaving(skeleton)

    def __call__(self, first: int, stop: int) -> bool:
        """True if joints first, ..., stop - 1 can place station `stop` on any curve through `first`."""
        return stop > self._leaving[first] and self.motion(first, stop) > LEAST_MOTION

    def motion(self, first: int, stop: int) -> float:
        """How far those joints move station `stop` in the direction across that is hardest for them.

        Returns:
            The motion for one radian, relative to the distance from station `first`: the median over the
            postures, not the least, because any module has singular ones. Zero if the end stays at the base.
        """
        return self._motion(first, stop).hardest

    def moves(self, first: int, stop: int) -> bool:
        """True if those joints move station `stop` in one direction across at least."""
        return self._motion(first, stop).easiest > LEAST_MOTION

    def movers(self, first: int, stop: int) -> int:
        """How many of those joints move station `stop` across."""
        return self._motion(first, stop).movers

    def _motion(self, first: int, stop: int) -> _Motion:
        if (first, stop) not in self._known:
            self._known[first, stop] = self._measured(first, stop)
        return self._known[first, stop]

    def _measured(self, first: int, stop: int) -> _Motion:
        normal = self._skeleton.normal
        ends, jacobians = self._motions(first, stop)
        distance = np.linalg.norm(ends, axis=1)
        apart = distance > LEAST_DISTANCE * self._pitch
        distance = np.where(apart, distance, 1.0)
        along = ends / distance[:, None]
        if normal is None:
            across = jacobians - along[:, :, None] * np.einsum("si,sij->sj", along, jacobians)[:, None]
        else:
            across = np.einsum("si,sij->sj", np.cross(normal, along), jacobians)[:, None]
        across = np.where(apart[:, None, None], across / distance[:, None, None], 0.0)
        sizes = np.zeros((POSTURES, self.needed))
        values = np.linalg.svd(across, compute_uv=False)[:, : self.needed]
        sizes[:, : values.shape[1]] = values
        single = np.median(np.linalg.norm(across, axis=1), axis=0)
        easiest, hardest = np.median(sizes, axis=0)[[0, -1]]
        # Rounded, so that groups that do the same are equal, however it was added up.
        return _Motion(round(float(easiest), 9), round(float(hardest), 9), int(np.sum(single > LEAST_MOTION)))

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
        # A base that drives anywhere stays where it is when the arm takes a shape.
        return place, np.where(arm.roaming[first:stop], 0.0, np.stack(columns, axis=2))


def _leaving(skeleton: Skeleton) -> list[int]:
    """For each joint the end of the longest group from there on with parallel axes and all links across them.

    In a spatial arm such a group moves its end in one direction across: that needs no measuring. In a planar
    arm no group is too short.
    """
    n = len(skeleton.names)
    ends = list(range(1, n + 1)) if skeleton.normal is None else [0] * n
    for u in range(n - 2, -1, -1):
        turn = skeleton.revolute[u] and skeleton.revolute[u + 1]
        across = np.linalg.norm(np.cross(skeleton.axes[u], skeleton.axes[u + 1]))
        beside = np.abs(np.diff(skeleton.stations[u : u + 3], axis=0) @ skeleton.axes[u])
        flat = across < PARALLEL and np.all(beside < PARALLEL * skeleton.length)
        if skeleton.normal is None and turn and flat:
            ends[u] = ends[u + 1]
    return ends
