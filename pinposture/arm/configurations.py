"""Configurations of a Pinocchio model: limits, motion on the manifold, position checks."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from math import atan2
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from pinposture._validation import (
    LARGEST_COORDINATE,
    as_floats,
    finite_vector,
    make_read_only,
    require_finite,
)
from pinposture.errors import InvalidValue, warn_caller
from pinposture.kernels.arrays import FULL_TURN

Array = NDArray[np.float64]

NO_LIMIT = 1e9
"""A limit this large [rad, m, rad/s or m/s] means none: files use 1e16 or the largest float for that."""
MOST_MOVING = 5_000
"""Most moving joints of a description: 4,000 take Pinocchio 18 s and 0.6 GB, 10,000 take 4 min and 3 GB."""
SLACK = 1e-4
"""How far outside its limits a joint may be without a warning [rad or m]: rounding to four digits."""


class DegreesSettings(NamedTuple):
    """When joint positions seem to be in degrees."""

    clearly_outside: float = 0.1
    """Distance outside its limits at which a joint suggests that positions are in degrees [rad]."""

    fraction: float = 0.5
    min_count: int = 3
    """Fraction of all comparable joints, and minimum number of joints, that indicate degrees."""

    wound: float = 4.0 * FULL_TURN
    """Position beyond which a joint without limits suggests that positions are in degrees [rad]."""

    hint: str = "is it in degrees? np.deg2rad converts to radians (--degrees on the command line)"
    """What is said then."""


DEGREES = DegreesSettings()


class JointLimits(NamedTuple):
    """Limits of the joints, one entry per degree of freedom; infinite where there is none.

    Attributes:
        lower: smallest joint position, (nv,) [rad or m].
        upper: largest joint position, (nv,) [rad or m].
        velocity: largest joint speed, (nv,) [rad/s or m/s].
    """

    lower: Array
    upper: Array
    velocity: Array


class ConfigurationSpace:
    """The configurations of a Pinocchio model.

    A configuration `q` has `nq` entries, two for each continuous joint (cosine and sine of its angle), and
    must be changed with `integrate`. Joint positions have `nv` entries, one for each degree of freedom.

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
        """Number of degrees of freedom and of entries of `dq`."""
        return int(self.model.nv)

    @cached_property
    def origin(self) -> Array:
        """The configuration in which every joint is at zero, (nq,), read-only."""
        origin = np.array(pin.neutral(self.model))
        origin.flags.writeable = False
        return origin

    @cached_property
    def _flat(self) -> bool:
        """Whether configurations are plain vectors, which can be added without a slow call of Pinocchio."""
        return self.nq == self.nv

    @cached_property
    def _continuous(self) -> tuple[tuple[int, int], ...]:
        """Index of the cosine in a configuration, and degree of freedom, for each continuous joint."""
        return tuple((j.idx_q, j.idx_v) for j in self.model.joints[1:] if (j.nq, j.nv) == (2, 1))

    @cached_property
    def limits(self) -> JointLimits:
        """Joint limits, one entry per degree of freedom.

        Continuous joints have no position limits; a zero speed limit means none.
        """
        lower = np.full(self.nv, -np.inf)
        upper = np.full(self.nv, np.inf)
        velocity = np.array(self.model.velocityLimit, dtype=np.float64)
        for joint in list(self.model.joints)[1:]:  # not the world, which claims entries of its own
            if joint.nq == joint.nv == 1:  # not continuous
                lower[joint.idx_v] = self.model.lowerPositionLimit[joint.idx_q]
                upper[joint.idx_v] = self.model.upperPositionLimit[joint.idx_q]
        # A model built by hand has the largest floats as limits that were never set.
        lower[lower <= -NO_LIMIT] = -np.inf
        upper[upper >= NO_LIMIT] = np.inf
        velocity[(velocity <= 0.0) | (velocity >= NO_LIMIT)] = np.inf
        make_read_only(lower, upper, velocity)
        return JointLimits(lower, upper, velocity)

    @cached_property
    def joint_names(self) -> tuple[str, ...]:
        """Joint name of each degree of freedom, on the chain or off it, (nv,)."""
        names = [""] * self.nv
        for joint, name in list(zip(self.model.joints, self.model.names, strict=True))[1:]:
            names[joint.idx_v : joint.idx_v + joint.nv] = [str(name)] * joint.nv
        return tuple(names)

    def neutral(self) -> Array:
        """Return the configuration in which every joint is at zero, (nq,)."""
        return np.array(self.origin)

    def configuration(self, positions: ArrayLike) -> Array:
        """Return the configuration of given joint positions.

        Args:
            positions: one number per degree of freedom, (nv,) [rad or m].

        Returns:
            Configuration (nq,).

        Raises:
            InvalidValue: wrong size or not finite.
        """
        return self.integrate(self.origin, finite_vector("positions", positions, self.nv))

    def positions(self, q: ArrayLike) -> Array:
        """Return the joint positions (nv,) [rad or m] of a configuration; continuous joints within +-pi."""
        return self.difference(self.origin, self.checked(q))

    def integrate(self, q: Array, dq: Array) -> Array:
        """Return the configuration (nq,) reached from q by the joint displacement dq, (nv,) [rad or m].

        For displacements (k, nv) it returns configurations (k, nq).
        """
        if self._flat:
            return np.asarray(q + dq)
        if dq.ndim == 2:
            return np.array([pin.integrate(self.model, q, row) for row in dq]).reshape(-1, self.nq)
        return np.array(pin.integrate(self.model, q, dq))

    def difference(self, start: Array, end: Array) -> Array:
        """Return the joint displacement (nv,) [rad or m] from one configuration (nq,) to another.

        Continuous joints take the shorter direction. For configurations (k, nq), at either end or at both, it
        returns displacements (k, nv).
        """
        if self._flat:
            return np.asarray(end - start)
        if start.ndim == 2 or end.ndim == 2:
            pairs = zip(*np.broadcast_arrays(start, end), strict=True)
            return np.array([self.difference(one, other) for one, other in pairs]).reshape(-1, self.nv)
        displacement = np.array(pin.difference(self.model, start, end))
        for at, dof in self._continuous:
            # Pinocchio computes the angle from its cosine, which loses half the digits near pi.
            # Pinocchio's difference of angles is accurate to full precision up to here
            if abs(displacement[dof]) > 3.0:
                a, b = start[at : at + 2]
                c, d = end[at : at + 2]
                displacement[dof] = atan2(a * d - b * c, a * c + b * d)
        return displacement

    def of_right_size(self, q: ArrayLike, name: str = "q") -> Array:
        """Return a configuration as a new float array (nq,), finite or not.

        Raises:
            InvalidValue: not numbers, or of another size, such as one number per joint.
        """
        array = as_floats(name, q, f"numbers of shape ({self.nq},)")
        if array.shape != (self.nq,):
            allowed = f"({self.nq},) for this arm"
            if array.shape == (self.nv,):
                allowed += ": two numbers for each continuous joint; see Arm.configuration"
            raise InvalidValue(f"{name} (shape)", array.shape, allowed)
        return array

    def checked(self, q: ArrayLike, name: str = "q") -> Array:
        """Check a configuration and return it as a new float array.

        Args:
            q: configuration, (nq,).
            name: name of the value in error messages.

        Returns:
            Copy of q, (nq,).

        Raises:
            InvalidValue: wrong size, not finite, or not a rotation where a continuous joint needs one.
        """
        checked = self.of_right_size(q, name)
        require_finite(name, checked, LARGEST_COORDINATE)
        if not self._flat and not pin.isNormalized(self.model, checked, 1e-6):
            allowed = "cosine and sine of one angle for each continuous joint; see Arm.configuration"
            raise InvalidValue(name, q, allowed)
        return checked


def check_joint_positions(
    name: str, positions: Array, limits: JointLimits, slides: NDArray[np.bool_], joints: Sequence[str]
) -> None:
    """Check joint positions (nv,) [rad or m] given as a start or a goal against the limits.

    A `PostureWarning` reports joints outside their limits, and many unlimited joints wound by several turns.

    Raises:
        InvalidValue: a revolute joint is outside its limits by more than a turn, or many joints are clearly
            outside: the positions may be in degrees.
    """
    excess = np.maximum(limits.lower - positions, positions - limits.upper)
    revolute_excess = np.where(slides, -np.inf, excess)
    limited = ~slides & np.isfinite(np.minimum(-limits.lower, limits.upper))
    clearly = limited & (excess > DEGREES.clearly_outside)
    in_degrees = revolute_excess.max() > FULL_TURN or _suggest_degrees(clearly, limited)
    worst = int(np.argmax(revolute_excess if in_degrees else excess))
    outside = np.count_nonzero(excess > SLACK)
    if outside:
        unit = "m" if slides[worst] else "rad"
        allowed = f"{limits.lower[worst]:.4g} to {limits.upper[worst]:.4g} {unit}"
        which = f"joint {joints[worst]!r}"
        if in_degrees:
            more = f", and {outside - 1} more joints are outside theirs" if outside > 1 else ""
            reason = f"{allowed}, the limits of {which}{more}; {DEGREES.hint}"
            raise InvalidValue(f"{name}[{worst}]", float(positions[worst]), reason)
        count = f"{outside} joints" if outside > 1 else "a joint"
        at = f"{which} is at {positions[worst]:.4g}, allowed {allowed}"
        warn_caller(f"{name}: {count} outside the limits; {at}")
    free = ~slides & ~limited
    wound = free & (np.abs(positions) > DEGREES.wound)
    if _suggest_degrees(wound, free):
        worst = int(np.argmax(np.where(free, np.abs(positions), 0.0)))
        count = f"{np.count_nonzero(wound)} joints without limits"
        turns = f"{count} are wound by more than {DEGREES.wound / FULL_TURN:g} turns"
        warn_caller(f"{name}: {turns}, {joints[worst]!r} at {positions[worst]:.4g} rad; {DEGREES.hint}")


def plausible_positions(limits: JointLimits, slides: NDArray[np.bool_]) -> tuple[Array, Array]:
    """Return the range of positions, (nv,) each, within which `check_joint_positions` finds no fault."""
    free = ~slides & ~np.isfinite(np.minimum(-limits.lower, limits.upper))
    widest = np.where(free, DEGREES.wound, np.inf)
    slack = 0.9 * SLACK  # allows for rounding
    return np.maximum(limits.lower - slack, -widest), np.minimum(limits.upper + slack, widest)


def _suggest_degrees(suspicious: NDArray[np.bool_], comparable: NDArray[np.bool_]) -> bool:
    least = max(DEGREES.min_count, DEGREES.fraction * np.count_nonzero(comparable))
    return bool(np.count_nonzero(suspicious) >= least)
