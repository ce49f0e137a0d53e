"""Masses and moments of inertia of links, and what no solid has."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

Array = NDArray[np.float64]


class InertiaSettings(NamedTuple):
    """What stands for masses and moments of inertia that no solid has."""

    ball_mass: float = 1e-3
    """Mass of the solid ball at the joint that replaces a moving link without mass [kg]."""

    ball_radius: float = 1e-2
    """Its radius [m]."""

    least_radius: float = 1e-4
    """Moments of inertia are at least those of a ball of the same mass with this radius [m]."""

    rounding: float = 1e-3
    """Relative violation of physical consistency that is corrected without a warning."""


INERTIA = InertiaSettings()


class RigidBody(NamedTuple):
    """Inertial parameters of a rigid body.

    Attributes:
        mass: mass [kg].
        center: centre of mass in the frame of the body, (3,) [m].
        inertia: inertia tensor about the centre of mass, axes of the body frame, (3, 3) [kg m^2].
    """

    mass: float
    center: Array
    inertia: Array

    @classmethod
    def of(cls, inertia: pin.Inertia) -> RigidBody:
        """Return an inertia of Pinocchio as a rigid body."""
        return cls(float(inertia.mass), np.array(inertia.lever), np.array(inertia.inertia))

    @property
    def spatial(self) -> pin.Inertia:
        """It as an inertia of Pinocchio, unchecked."""
        inertia = pin.Inertia.Zero()  # the constructor would refuse unphysical ones
        inertia.mass = self.mass
        inertia.lever = self.center
        inertia.inertia = self.inertia
        return inertia


def physically_consistent(body: RigidBody) -> tuple[RigidBody, str]:
    """Return the nearest physically consistent inertial parameters, and the corrected fault, or "".

    An inertia tensor I is physically consistent if the second moment of mass, trace(I) / 2 - I, is positive
    semidefinite: then no principal moment exceeds the sum of the other two.
    """
    if body.mass <= 0.0:
        ball = 0.4 * INERTIA.ball_mass * INERTIA.ball_radius**2 * np.eye(3)
        return RigidBody(INERTIA.ball_mass, np.zeros(3), ball), "no mass"
    moments, axes = np.linalg.eigh(np.trace(body.inertia) / 2.0 * np.eye(3) - body.inertia)
    # A moment below 1e-12 of the largest could become negative due to rounding error.
    least = max(body.mass * INERTIA.least_radius**2 / 5.0, 1e-12 * float(moments[2]))
    if moments[0] >= least:
        return body, ""
    second = axes * np.maximum(moments, least) @ axes.T
    rounded = moments[0] >= -INERTIA.rounding * moments[2] and moments[1] > least
    inertia = np.trace(second) * np.eye(3) - second
    return RigidBody(body.mass, body.center, inertia), "" if rounded else "unphysical moments of inertia"
