"""Configurations of an arm: joint limits, random and straight ones, and motion on the manifold."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from functools import cached_property
from math import atan2
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import minimize

from pinposture._validation import finite_vector
from pinposture.errors import InvalidValue, PostureWarning

if TYPE_CHECKING:
    from pinposture.arm.arm import Arm


# How far and how fast the joints of an arm may move.

Array = NDArray[np.float64]

UNLIMITED = 1e9
"""A limit this large [rad, m, rad/s or m/s] is none: files write 1e16 or the largest float for it."""

UNREAL = 100.0
"""Room with which position limits are none [arm lengths, or rad]: files write +-1e6 where they mean that."""


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


def joint_limits(model: pin.Model) -> JointLimits:
    """Read the limits of a model; continuous joints have none, a speed limit of zero means none.

    So do limits of `UNLIMITED` or more.
    """
    lower, upper = np.full(model.nv, -np.inf), np.full(model.nv, np.inf)
    velocity = np.array(model.velocityLimit, dtype=np.float64)
    for joint in list(model.joints)[1:]:  # the first one is the world, which claims entries of its own
        if joint.nq == joint.nv == 1:
            lower[joint.idx_v] = model.lowerPositionLimit[joint.idx_q]
            upper[joint.idx_v] = model.upperPositionLimit[joint.idx_q]
    # A model built by hand has the largest floats for limits it was never given.
    lower[lower <= -UNLIMITED], upper[upper >= UNLIMITED] = -np.inf, np.inf
    velocity[(velocity <= 0.0) | (velocity >= UNLIMITED)] = np.inf
    for array in (lower, upper, velocity):
        array.flags.writeable = False
    return JointLimits(lower, upper, velocity)


def without_limits(lower: Array, upper: Array, slides: NDArray[np.bool_], length: float) -> NDArray[np.bool_]:
    """Which joints have no real limits of their positions: none, or limits so wide that they mean none.

    Args:
        lower: smallest positions, (n,) [rad or m].
        upper: largest positions, (n,) [rad or m].
        slides: True for a joint that slides, (n,).
        length: of the arm, with its slides at zero [m].

    Returns:
        True where there is more than 100 arm lengths to slide, or more than 100 rad to turn, (n,).
    """
    return np.asarray(upper - lower > UNREAL * np.where(slides, length, 1.0))


def carry_base(without: NDArray[np.bool_], revolute: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Which joints are slides without real limits on which the base stands, as of a mobile robot, (n,).

    They come before the first joint that turns; there are none where no joint does.

    Args:
        without: True for a joint without real limits, from base to tip, (n,).
        revolute: True for a joint that turns, (n,).
    """
    return np.asarray(without & ~np.logical_or.accumulate(revolute) & np.any(revolute))


# Configurations of a model: where its joints are, and how they move on the manifold.

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


# The posture in which an arm reaches farthest.


def full_reach(arm: Arm) -> Array:
    """Joint positions (nv,) [rad or m] that maximise the distance from base to tip, within the limits.

    They are zero if the arm is straight there and cannot slide; otherwise the maximum is searched from
    there, and is a local one for arms that can stretch in several ways. A slide without real limits goes as
    far as the arm is long, or stays where it is if the base stands on it.
    """
    start_point, length, units = arm.chain.base, arm.length, arm.joint_units
    straight = np.linalg.norm(arm.chain.points[-1] - start_point) > (1.0 - 1e-9) * length
    if straight and np.all(arm.chain.revolute) and arm.within_limits(arm.neutral()):
        return np.zeros(arm.nv)

    def shortness(amounts: Array) -> tuple[float, Array]:
        state = arm.at(arm.configuration(amounts * units)).compiled
        reach = (state.points[-1] - start_point) / length
        distance = max(float(np.linalg.norm(reach)), 1e-12)
        return -distance, -(reach / distance) @ state.jacobians[-1] * units / length

    low, high = np.array(arm.usual_positions) / units
    # A hinge has no need to be told how far: it comes round.
    low[~arm.slides], high[~arm.slides] = (np.array(arm.limits[:2]) / units)[:, ~arm.slides]
    stays = np.clip(0.0, arm.limits.lower, arm.limits.upper) / units
    low, high = np.where(arm.roaming, stays, low), np.where(arm.roaming, stays, high)
    # Zero itself can be a stationary point, for instance of an arm that is folded there.
    start = np.clip(np.full(arm.nv, 1e-3), low, high)
    bounds = list(zip(low, high, strict=True))
    found = minimize(shortness, start, jac=True, bounds=bounds, method="L-BFGS-B").x
    return np.asarray(np.clip(found, low, high) * units)


# Checks of numbers that come from outside.

TURN = 2.0 * np.pi
SLACK = 1e-4
"""How far outside of its limits a joint may be without a word [rad or m]: rounding to four digits."""

CLEARLY, SHARE, LEAST = 0.1, 0.5, 3
"""How far outside a joint counts among many [rad], which share of all these are, and how many at least."""

WOUND = 4.0 * TURN
"""From where on a joint without limits is taken to be given in degrees, if `SHARE` of them are [rad]."""

_ADVICE = "is it in degrees? np.deg2rad makes radians of them (--degrees on the command line)"


def check_joint_positions(
    name: str,
    positions: NDArray[np.float64],
    limits: JointLimits,
    slides: NDArray[np.bool_],
    joints: Sequence[str],
) -> None:
    """Look whether joint positions that somebody gave, as a start or a goal, can be meant.

    A `PostureWarning` tells of joints outside of their limits, and of many joints without limits that are
    wound by several turns.

    Args:
        name: what the positions are called.
        positions: one for each degree of freedom, (nv,) [rad or m].
        limits: those of the joints.
        slides: which of them slide, (nv,).
        joints: their names, (nv,).

    Raises:
        InvalidValue: a joint that turns is outside of its limits by more than a turn, or many are: degrees.
    """
    beyond = np.maximum(limits.lower - positions, positions - limits.upper)
    turning = np.where(slides, -np.inf, beyond)
    limited = ~slides & np.isfinite(np.minimum(-limits.lower, limits.upper))
    clearly = int(np.count_nonzero(limited & (beyond > CLEARLY)))
    in_degrees = turning.max() > TURN or clearly >= max(LEAST, SHARE * np.count_nonzero(limited))
    worst = int(np.argmax(turning if in_degrees else beyond))
    outside = np.flatnonzero(beyond > SLACK)
    if len(outside):
        unit = "m" if slides[worst] else "rad"
        allowed = f"{limits.lower[worst]:.4g} to {limits.upper[worst]:.4g} {unit}"
        which = f"joint {joints[worst]!r}"
        if in_degrees:
            more = f", and {len(outside) - 1} more joints are outside of theirs" if len(outside) > 1 else ""
            reason = f"{allowed}, the limits of {which}{more}; {_ADVICE}"
            raise InvalidValue(f"{name}[{worst}]", float(positions[worst]), reason)
        count = f"{len(outside)} joints" if len(outside) > 1 else "a joint"
        at = f"{which} is at {positions[worst]:.4g}, allowed {allowed}"
        warnings.warn(f"{name}: {count} outside of the limits; {at}", PostureWarning, stacklevel=4)
    free = ~slides & ~limited
    wound = int(np.count_nonzero(free & (np.abs(positions) > WOUND)))
    if wound >= max(LEAST, SHARE * np.count_nonzero(free)):
        most = int(np.argmax(np.where(free, np.abs(positions), 0.0)))
        turns = f"{wound} joints without limits are wound by more than {WOUND / TURN:g} turns"
        text = f"{name}: {turns}, {joints[most]!r} at {positions[most]:.4g} rad; {_ADVICE}"
        warnings.warn(text, PostureWarning, stacklevel=4)


def smooth_configuration(arm: Arm, rng: np.random.Generator, amplitude: float) -> Array:
    """A random configuration that varies smoothly along the arm, as a relaxed arm would lie.

    The joints at the same place in their modules follow a sum of three sine waves along the arm with
    random phases; the largest angle is the amplitude.

    Args:
        arm: the arm.
        rng: source of randomness.
        amplitude: largest joint position [rad or m].

    Returns:
        Configuration within the limits of the arm, (nq,).

    Raises:
        InvalidValue: an amplitude that is no finite number >= 0.
    """
    if not (np.isfinite(amplitude) and amplitude >= 0.0):
        raise InvalidValue("amplitude", amplitude, "a finite number >= 0 [rad or m]")
    along = np.linspace(0.0, 1.0, arm.n_modules)
    places = max(len(joints) for joints in arm.module_joints)
    waves = np.zeros((arm.n_modules, places))
    for place in range(places):
        for number in (1, 2, 3):
            waves[:, place] += (
                rng.normal() / number * np.sin(np.pi * number * along + rng.uniform(0, 2 * np.pi))
            )
    positions = np.zeros(arm.nv)
    for wave, joints in zip(waves, arm.chain.module_slices, strict=True):
        columns = arm.columns[joints]
        positions[columns] = wave[: len(columns)]
    positions *= amplitude / max(float(np.abs(positions).max()), 1e-300)
    return arm.configuration(np.clip(positions, arm.limits.lower, arm.limits.upper))
