"""Configurations of a model: where its joints are, and how they move on the manifold."""

from __future__ import annotations

from functools import cached_property
from math import atan2

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from pinposture.arm.checks import finite_vector
from pinposture.arm.limits import JointLimits, joint_limits
from pinposture.errors import InvalidValue

Array = NDArray[np.float64]

NEARLY_HALF = 3.0
"""Angle up to which Pinocchio's difference of two angles is good to all digits [rad]."""


class ConfigurationSpace:
    """The configurations of a Pinocchio model.

    A configuration `q` has `nq` entries and moves only by `integrate`, because a continuous joint takes two
    of them: the cosine and the sine of its angle. Joint positions have `nv` entries, one for each degree of
    freedom.

    Attributes:
        model: the model.
    """

    def __init__(self, model: pin.Model) -> None:
        self.model = model

    @cached_property
    def nq(self) -> int:
        """Number of entries of a configuration."""
        return int(self.model.nq)

    @cached_property
    def nv(self) -> int:
        """Number of degrees of freedom: entries of `dq`."""
        return int(self.model.nv)

    @cached_property
    def origin(self) -> Array:
        """The configuration in which every joint is at zero, (nq,), read-only."""
        origin = np.array(pin.neutral(self.model))
        origin.flags.writeable = False
        return origin

    @cached_property
    def _flat(self) -> bool:
        """Whether configurations are added up number by number: no joint takes more of them than it can move.

        Pinocchio does the same then, and takes ten times as long to be asked.
        """
        return self.nq == self.nv

    @cached_property
    def _turning(self) -> tuple[tuple[int, int], ...]:
        """Of each continuous joint: where its cosine is in a configuration, and its degree of freedom."""
        return tuple((j.idx_q, j.idx_v) for j in self.model.joints[1:] if (j.nq, j.nv) == (2, 1))

    @cached_property
    def limits(self) -> JointLimits:
        """Joint limits, one entry per degree of freedom."""
        return joint_limits(self.model)

    @cached_property
    def joint_names(self) -> tuple[str, ...]:
        """Name of the joint that each degree of freedom belongs to, (nv,), on the chain or off it."""
        names = [""] * self.nv
        for joint, name in list(zip(self.model.joints, self.model.names, strict=True))[1:]:
            names[joint.idx_v : joint.idx_v + joint.nv] = [str(name)] * joint.nv
        return tuple(names)

    def neutral(self) -> Array:
        """The configuration in which every joint is at zero, (nq,)."""
        return np.array(self.origin)

    def configuration(self, positions: ArrayLike) -> Array:
        """Configuration from joint positions.

        Args:
            positions: one number per degree of freedom, (nv,) [rad or m].

        Returns:
            Configuration (nq,).

        Raises:
            InvalidValue: wrong size or not finite.
        """
        return self.integrate(self.origin, finite_vector("positions", positions, self.nv))

    def positions(self, q: ArrayLike) -> Array:
        """Joint positions (nv,) [rad or m] of a configuration; continuous joints within +-pi."""
        return self.difference(self.origin, self.checked(q))

    def integrate(self, q: Array, dq: Array) -> Array:
        """The configuration (nq,) reached from q by the joint displacement dq, (nv,) [rad or m]."""
        if self._flat:
            return np.asarray(q + dq)
        return np.array(pin.integrate(self.model, q, dq))

    def difference(self, start: Array, end: Array) -> Array:
        """The joint displacement (nv,) [rad or m] that leads from one configuration (nq,) to another.

        Continuous joints take the shorter way round.
        """
        if self._flat:
            way: Array = end - start
            return way
        way = np.array(pin.difference(self.model, start, end))
        for at, turning in self._turning:
            # Pinocchio asks the cosine for the angle, which loses half the digits towards half a turn.
            if abs(way[turning]) > NEARLY_HALF:
                (a, b), (c, d) = start[at : at + 2], end[at : at + 2]
                way[turning] = atan2(a * d - b * c, a * c + b * d)
        return way

    def checked(self, q: ArrayLike, name: str = "q") -> Array:
        """A configuration as a fresh float array, or an error that says what is wrong with it.

        Args:
            q: configuration, (nq,).
            name: what to call it in the error.

        Returns:
            Copy of q, (nq,).

        Raises:
            InvalidValue: wrong size, not finite, or not a rotation where a continuous joint needs one.
        """
        checked = finite_vector(name, q, self.nq)
        if not self._flat and not pin.isNormalized(self.model, checked, 1e-6):
            allowed = "cosine and sine of one angle for each continuous joint; see Arm.configuration"
            raise InvalidValue(name, q, allowed)
        return checked
