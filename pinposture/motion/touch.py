"""Notices that something touches the arm: measured torques that its masses and its motion do not explain.

The torque of contact is d = inverse dynamics(q, v, a) - measured torque. Velocity v and acceleration a are
differences of the measured positions, and d is low-pass filtered. A momentum observer (De Luca and Mattone,
2005) does the same in another order: it integrates the torques, and filters the momentum. The filter has two
stages, because differences amplify the noise of positions: at the same delay, one stage lets through 1.7
times as much of it.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from math import exp
from typing import Annotated, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pinposture._validation import (
    LARGEST_NUMBER,
    float_array,
    require_instance,
    require_known,
    require_positive,
)
from pinposture.arm import Arm
from pinposture.arm.weight import load_of
from pinposture.control import Limits
from pinposture.errors import InvalidValue
from pinposture.schema import CheckedBy, Declared, Duration, declared, one_of

Array = NDArray[np.float64]


class TouchSettings(NamedTuple):
    """How touch is detected, and how an arm yields to it."""

    time_constant: float = 0.04
    """Delay of the filter [s]: `benchmarks/studies/touch.py` has latency and false alarms for others."""

    yielding_time: float = 0.2
    """How far ahead of the command an arm that yields aims, in seconds at its speed: it must be able to
    brake."""

    yielding_speed: float = 0.5
    """Largest speed of a joint that yields, in `Arm.joint_units` per second, within its limit."""

    usual_share: float = 0.2
    """The threshold if none is given, in the largest torque by which weight loads a joint of the
    outstretched arm. In `benchmarks/studies/touch.py` it gives no false alarm, with noise of up to 3 % and
    0.3 mrad."""

    limp: float = 0.25
    """Torque of a drive below which it has none, in thresholds. In `benchmarks/studies/failures.py` a drive
    that gives 30 % of what weight needs is told from one that gives nothing."""


TOUCH = TouchSettings()


def _threshold(name: str, value: object) -> float | dict[str, float] | None:
    if value is None:
        return None
    if isinstance(value, Mapping):
        return {str(key): require_positive(f"{name}[{key!r}]", entry) for key, entry in value.items()}
    return require_positive(name, value)  # type: ignore[arg-type]


@declared()
class Touch(Declared):
    """How a `Tracker` notices that something touches the arm, and what it does then.

        tracker = pp.Tracker(arm, limits=limits, touch=pp.Touch(threshold=0.5))
        tracker.step(q_measured, torques=measured_torques)

    Torques of friction in the joints count as contact, unless the drives tell torques behind it: the
    threshold must be above them.

    Attributes:
        threshold: torque or force beyond what masses and motion explain, above which the arm is touched:
            one for all drives, or by the names of their joints; others then feel nothing [N m or N]. None: a
            fifth of the largest torque, and force, by which its weight loads the outstretched arm. Logs of a
            robot tell it better (`Identification.touch`).
        reaction: "stop": the arm brakes and holds. "yield": its joints give way, in the direction of the
            torque, with up to half a joint unit per second at twice the threshold, until it is below the
            threshold; then the arm holds. It goes on after `Tracker.restart`.
        time_constant: delay of the filter of the torques [s].

    Raises:
        InvalidValue: a number that is not positive.
        UnknownName: another reaction.
    """

    threshold: Annotated[float | dict[str, float] | None, CheckedBy(_threshold)] = None
    reaction: Annotated[Literal["stop", "yield"], one_of("reaction", "stop", "yield")] = "stop"
    time_constant: Duration = TOUCH.time_constant


def read_torques(arm: Arm, given: ArrayLike | Mapping[str, float] | None) -> Array | None:
    """Return measured torques of drives as torques along the degrees of freedom, (nv,) [N m or N].

    Args:
        arm: the arm.
        given: in the order of `Arm.drives`, (nv,), or by the names of their joints.

    Returns:
        The torques; None if they are missing or not finite.

    Raises:
        InvalidValue: an array of another shape, or not numbers.
    """
    if isinstance(given, Mapping):
        names = arm.drives.names
        given = [given.get(name, np.nan) for name in names]
    if given is None:
        return None
    torques = float_array("torques", given, (arm.nv,))
    known = bool(np.all(np.abs(torques) <= LARGEST_NUMBER))  # False for NaN
    return arm.drives.joint_torques(torques) if known else None


class Reading(NamedTuple):
    """What the sensors of the joints told in a cycle.

    Attributes:
        positions: joint positions, (nv,) [rad or m].
        torques: torques along the degrees of freedom, (nv,) [N m or N].
        after: time since the reading before [s].
    """

    positions: Array
    torques: Array
    after: float


def _thresholds_of(arm: Arm, given: float | dict[str, float] | None) -> Array:
    """Return the thresholds of `Touch` along the degrees of freedom, (nv,) [N m or N]; infinite for none."""
    if given is None:
        loads = largest_of_kind(arm, arm.outstretched_torques)
        if np.all(np.isinf(loads)):
            allowed = "a torque or force, as weight loads no joint of this arm"
            raise InvalidValue("touch.threshold", None, allowed)
        return TOUCH.usual_share * loads
    of_drives = np.full(arm.nv, np.inf)
    names = arm.drives.names
    if isinstance(given, Mapping):
        for name, value in given.items():
            require_known("joint with a drive", name, names)
            of_drives[names.index(name)] = value
    else:
        of_drives[:] = given
    return of_drives * np.abs(arm.drives.ratios)


def largest_of_kind(arm: Arm, torques: Array) -> Array:
    """Return for each degree of freedom the largest torque of those that turn, or force of those that slide.

    Args:
        arm: the arm.
        torques: torques and forces, (nv,) [N m or N], at least 0.

    Returns:
        The largest of its kind, (nv,); infinite where all are zero.
    """
    largest = np.full(arm.nv, np.inf)
    for kind in (arm.in_metres, ~arm.in_metres):
        most = float(torques[kind].max(initial=0.0))
        if most > 0.0:
            largest[kind] = most
    return largest


class TouchDetector:
    """Tells from measured positions and torques whether something touches the arm.

    Attributes:
        torques: torques of contact along the degrees of freedom, (nv,) [N m or N].
        reason: which joint felt it first, since the arm is watched; empty: none.
    """

    def __init__(self, arm: Arm, touch: Touch) -> None:
        """Prepare for an arm.

        Raises:
            InvalidValue: not a `Touch`.
            WeightUnknown: masses that are not known.
            InvalidValue: no threshold is given, and weight loads no drive.
            UnknownName: a threshold for a joint that no drive moves.
        """
        require_instance("touch", touch, Touch, "a Touch(...), or None")
        arm.require_masses()
        self._arm = arm
        self._touch = touch
        self._thresholds = _thresholds_of(arm, touch.threshold)
        self.restart()

    def restart(self) -> None:
        """Forget what touched the arm."""
        self.reason = ""
        self.torques = np.zeros(self._arm.nv)
        self._filtered = np.zeros(self._arm.nv)
        self._driven = np.zeros(self._arm.nv)  # measured torques, filtered
        self._readings: deque[Reading] = deque(maxlen=3)
        self._waited = 0.0

    @property
    def yields(self) -> bool:
        """Whether the arm gives way now."""
        return bool(self.reason) and self._touch.reaction == "yield" and bool(np.any(self._excess))

    @property
    def _excess(self) -> Array:
        """The torques of contact beyond the threshold, relative to it, (nv,)."""
        over = np.maximum(np.abs(self.torques) - self._thresholds, 0.0) / self._thresholds
        return np.where(np.isfinite(self._thresholds), np.sign(self.torques) * over, 0.0)

    def update(self, positions: Array | None, torques: Array | None, dt: float) -> None:
        """Take the readings of a cycle.

        Args:
            positions: measured joint positions, (nv,) [rad or m]; None if they are missing.
            torques: measured torques along the degrees of freedom, (nv,) [N m or N]; None if missing.
            dt: time since the last cycle [s].
        """
        readings = self._readings
        self._waited += dt
        if positions is None or torques is None:
            readings.clear()
            return
        if readings and all(map(np.array_equal, readings[-1][:2], (positions, torques))):
            return  # the same reading again
        readings.append(Reading(positions, torques, self._waited))
        self._waited = 0.0
        if len(readings) < 3:
            return
        before, now, later = readings
        first = (now.positions - before.positions) / now.after
        second = (later.positions - now.positions) / later.after
        both = now.after + later.after
        velocity = (first * later.after + second * now.after) / both
        acceleration = 2.0 * (second - first) / both
        q = self._arm.configuration(now.positions)
        needed = self._arm.inverse_dynamics(q[None], velocity[None], acceleration[None])[0]
        share = 1.0 - exp(-2.0 * later.after / self._touch.time_constant)
        self._driven = self._driven + share * (now.torques - self._driven)
        self._filtered = self._filtered + share * (needed - now.torques - self._filtered)
        self.torques = self.torques + share * (self._filtered - self.torques)
        joint = int(np.abs(self._excess).argmax())
        if not self.reason and self._excess[joint] != 0.0:
            self.reason = self._describe(joint)

    def fault_of(self, joint: int) -> str:
        """Return what is the matter with a joint that is not where its drive could be, by its torques.

        Args:
            joint: the degree of freedom.

        Returns:
            "limp": its drive has no torque. "weak": it has some, which explains how the joint moves.
            "astray": something touches the arm, or its weight is too small for thresholds to tell.
        """
        threshold = self._thresholds[joint]
        if self.reason or self._arm.outstretched_torques[joint] < threshold:
            return "astray"
        return "limp" if abs(self._driven[joint]) < TOUCH.limp * threshold else "weak"

    def way(self, limits: Limits) -> Array:
        """Return how far ahead of its command an arm that yields aims, (nv,) [rad or m]."""
        bound = limits.for_arm(self._arm)
        fastest = TOUCH.yielding_speed * self._arm.joint_units
        if bound.dt is not None:
            fastest = np.minimum(fastest, bound.bound / bound.dt)
        return np.asarray(TOUCH.yielding_time * fastest * np.clip(self._excess, -1.0, 1.0))

    def _describe(self, joint: int) -> str:
        drive = self._arm.drives[joint]
        felt = load_of(drive, abs(float(self.torques[joint])), float(self._thresholds[joint]))
        beyond = (
            f"{felt.needed:.3g} {felt.unit} beyond its weight and motion, above {felt.limit:.3g} {felt.unit}"
        )
        return f"something touches the arm: joint {drive.joint!r} feels {beyond}; it goes on after `restart`"
