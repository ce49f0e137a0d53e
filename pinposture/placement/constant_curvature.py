"""The kinematics of a section that bends in an arc of constant curvature, in closed form."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pinposture._validation import require_positive
from pinposture.curve import Curve
from pinposture.errors import InvalidValue
from pinposture.placement.module_kinematics import AHEAD, curve_crossings, first_facing

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ConstantCurvature:
    """FK, IK and TP of an arc, in the frame at its base (x along the straight section).

    Joint positions are the bending about y and about z [rad] and, if the section can stretch, its elongation
    [m]. The end turns by the rotation vector (0, q0, q1). The IK is limited to bends below a full turn.

    Attributes:
        length: length of the section [m].
        stretch: largest change of length in either direction [m]; 0 if it cannot stretch.

    Raises:
        InvalidValue: the length is not positive, or the stretch is negative or not below the length.
    """

    length: float
    stretch: float = 0.0

    def __post_init__(self) -> None:
        require_positive("length", self.length)
        require_positive("stretch", self.stretch, zero=True)
        if not self.stretch < self.length:
            raise InvalidValue("stretch", self.stretch, f"less than the length of {self.length:g} m")

    @property
    def dof(self) -> int:
        """Number of degrees of freedom: 2, or 3 if it can stretch."""
        return 3 if self.stretch else 2

    @property
    def reach(self) -> float:
        """Largest distance of the end from the base [m]."""
        return self.length + self.stretch

    def forward(self, q: Array) -> tuple[Array, Array]:
        """FK: position (3,) [m] and orientation (3, 3) of the end at q, (2,) or (3,), base frame."""
        bend_y = float(q[0])
        bend_z = float(q[1])
        length = self.length + (float(q[2]) if self.stretch else 0.0)
        bend = np.hypot(bend_y, bend_z)
        along = np.sinc(bend / np.pi)  # sin(bend) / bend
        across = 0.5 * np.sinc(0.5 * bend / np.pi) ** 2  # (1 - cos(bend)) / bend^2
        end = length * np.array([along, across * bend_z, -across * bend_y])
        return end, np.asarray(pin.exp3(np.array([0.0, bend_y, bend_z])))

    def inverse(self, p: Array) -> list[Array]:
        """IK: the positions that put the end at p, (3,) [m], base frame; empty if there are none.

        The angle between the chord and x is half the bending angle.
        """
        x, y, z = map(float, p)
        across = np.hypot(y, z)
        half = float(np.arctan2(np.hypot(y, z), x))
        length = float(self._lengths(np.array([[x, y, z]]))[0])
        slack = max(self.stretch, 0.0) + 1e-7 * self.length  # so far off the surface that the end reaches
        if not abs(length - self.length) <= slack or half >= np.pi:
            return []
        direction = np.array([-z, y]) / across if across > 0.0 else np.zeros(2)
        bends = 2.0 * half * direction
        if not self.stretch:
            return [bends]
        return [np.append(bends, np.clip(length - self.length, -self.stretch, self.stretch))]

    def target_point(self, base: pin.SE3, curve: Curve, start: float) -> float | None:
        """TP, as `ModuleKinematics.target_point`, with the least stretch; prefers bends up to half a turn."""
        crossings = curve_crossings(curve, base, start, self._level, self.reach)
        first = first_facing(crossings, lambda p: bool(p[0] >= 0.0))
        if first is not None or not self.stretch:
            return first
        ahead = np.linspace(start + AHEAD * self.reach, start + self.reach * np.pi, 400)
        ahead = ahead[ahead < curve.length] if start < curve.length else ahead[:0]
        ahead = np.append(ahead, curve.length) if start < curve.length else ahead
        points = (np.asarray(curve.at(ahead)).reshape(-1, 3) - base.translation) @ base.rotation
        needed = np.abs(self._lengths(points) - self.length)
        if not len(ahead) or not needed.min() <= self.stretch:
            return None
        return float(ahead[np.argmin(needed)])

    def _lengths(self, p: Array) -> Array:
        """Return the lengths of the arcs that leave the base along x and end at points (n, 3), (n,) [m]."""
        half = np.arctan2(np.hypot(p[:, 1], p[:, 2]), p[:, 0])
        return np.asarray(np.linalg.norm(p, axis=1) / np.maximum(np.sinc(half / np.pi), 1e-300))

    def _level(self, p: Array) -> Array:
        half = np.arctan2(np.hypot(p[:, 1], p[:, 2]), p[:, 0])
        return np.asarray(np.linalg.norm(p, axis=1) - self.length * np.sinc(half / np.pi))
