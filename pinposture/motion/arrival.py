"""When an arm has arrived, rests, or makes no progress.

Whether a measured arm is at its target, as far as noise allows to tell, and whether it gets closer.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pinposture.arm import Arm
from pinposture.placement import Target
from pinposture.units import CONVERGED


class ArrivalTolerances(NamedTuple):
    """When an arm has arrived at its target, by one measurement or the average of many, or stands."""

    averaged_time: float = 0.25
    averaged_readings: int = 8
    """Least duration [s] and least number of different readings that are averaged."""

    longest_time: float = 1.0
    """Longest duration of an average [s], whatever the number of readings."""

    deviations: float = 3.0
    """Distance from a target that noise explains, in standard deviations of the average."""

    leaving: float = 2.0
    """Ratio of the distances at which an arm leaves its target and arrives, against a status that
    flickers."""

    drift: float = 4.0
    """Ratio of the motion during an average that noise explains to that distance: a fitted slope over n
    readings varies by sqrt(12 / n), their mean by sqrt(1 / n)."""

    approach: float = 0.5
    """Ratio of the distances of two successive averages below which the arm still approaches its target."""

    aimed: float = 1e-3
    """Mean distance of the control points of the command from where it aims, in arm lengths, below which
    only the feedback moves it."""

    standing_drift: float = 0.02
    """Motion of the control points during an average that counts as standing, as a share of their distances
    from the targets: an arm that comes closer faster than that is there within some seconds."""

    standing_time: float = 1.0
    """Time for which an arm that is not at its target stands before it counts as stalled [s]."""


ARRIVAL = ArrivalTolerances()


class StallTolerances(NamedTuple):
    """When an arm makes no progress, and when it tries again."""

    travel: float = 6.0
    """Joint travel without progress after which a run is stalled [rad]: 60 usual steps."""

    progress_share: float = 1e-3
    """Relative decrease of the posture error that counts as progress."""

    gain: float = 1e-3
    """Decrease of a distance that counts as coming closer, in arm lengths: half the clearance that steps
    keep beyond the margin."""

    patience: float = 2.0
    averages: float = 4.0
    """Time after which an arm that comes no closer gives up [s], and time constants of the averaged
    measurements to add: after four, less than 2 % of a change is still to come."""

    rounding: float = 1e-12
    """Increase of the posture error that is attributed to rounding, in arm lengths."""

    steady: float = 1e-4
    """Change of the displacement of an arm that is none, in `Arm.joint_units`, unless noise makes more."""

    two_averages: float = 2.0
    """Ratio of the difference of two averages that noise explains to the deviation of one that it
    explains."""

    other_displacement: float = 5e-3
    """Change of the displacement of an arm at rest that makes another attempt worthwhile, in
    `Arm.joint_units`: more than the noise and the backlash of most drives."""


STALL = StallTolerances()


Array = NDArray[np.float64]


class Arrival:
    """Compares averages of measured control points with a target.

    The readings of a quarter of a second, and of 8 different ones at least, are averaged. Their noise s is
    estimated from the differences of successive readings, less those of the commands, so that a slow motion
    does not count as noise. The arm has arrived if the average is within 1e-6 of the arm length plus
    3 s / sqrt(n) of the target, and leaves it beyond twice that.

    Attributes:
        arrived: whether the arm is at the target.
        standing: time for which the arm has not moved measurably [s]; 0 if it moves.
        positions: average joint positions, (nv,) [rad or m]; None before the first average.

    Args:
        length: length of the arm [m].
    """

    def __init__(self, length: float) -> None:
        self._tolerance = CONVERGED * length
        self._last: tuple[Array, Array] | None = None
        self.restart()

    def restart(self) -> None:
        """Begin anew, for another target."""
        self.arrived = False
        self.standing = 0.0
        self.positions: Array | None = None
        self._variance: float | None = None
        self._off = float("inf")
        self._begin()

    def arrive(self) -> None:
        """Take the arm to be at the target."""
        self.arrived = True

    def _begin(self) -> None:
        self._points: Array | float = 0.0
        self._weighted: Array | float = 0.0
        self._joints: Array | float = 0.0
        self._changes = 0.0
        self._time = 0.0
        self._count = 0
        self._different = 0

    def update(self, points: Array, deviation: Array, positions: Array, target: Target, dt: float) -> None:
        """Add the measurement of a cycle.

        Args:
            points: measured control points, (m, 3) [m].
            deviation: their distances from those of the command, (m, 3) [m].
            positions: measured joint positions, (nv,) [rad or m].
            target: the target of the arm.
            dt: duration of the cycle [s].
        """
        if self._last is None or np.any(points != self._last[0]):
            if self._last is not None:
                change = (deviation - self._last[1]).ravel()
                self._changes += float(change @ change)
                self._different += 1
            self._last = points, deviation
        self._points = self._points + points
        self._weighted = self._weighted + self._count * points
        self._joints = self._joints + positions
        self._count += 1
        self._time += dt
        enough = (
            self._different >= ARRIVAL.averaged_readings
            or not self._different
            or self._time >= ARRIVAL.longest_time
        )
        if enough and self._time >= ARRIVAL.averaged_time and self._count >= ARRIVAL.averaged_readings:
            self._judge(target)
            self._begin()

    def _judge(self, target: Target) -> None:
        """Compare the average with the target."""
        n = self._count
        mean = np.asarray(self._points / n)
        self.positions = np.asarray(self._joints / n)
        slope = 12.0 * (self._weighted - 0.5 * (n - 1) * self._points) / (n * (n**2 - 1.0))
        drift = float(np.linalg.norm(n * slope, axis=1).mean())
        variance = 0.0
        if self._different:
            variance = self._changes / (2.0 * self._different**2 * len(mean))  # of the average
        kept = self._variance if self.arrived and self._variance is not None else variance
        self._variance = 0.5 * (kept + variance)
        noise = ARRIVAL.deviations * float(np.sqrt(self._variance))
        within = self._tolerance + noise
        off = target.mean_distance(mean)
        if self.arrived:
            self.arrived = off <= ARRIVAL.leaving * within
        else:
            approaches = off < ARRIVAL.approach * self._off
            self.arrived = off <= within and drift <= ARRIVAL.drift * within and not approaches
        self._off = off
        most = ARRIVAL.drift * noise + ARRIVAL.standing_drift * off
        still = drift <= (ARRIVAL.leaving * most if self.standing else most)
        self.standing = self.standing + self._time if still else 0.0


# Arms that obstacles hinder.


class Blockage:
    """Watches whether an arm comes closer to where it should be, as long as obstacles hinder it.

    With drives that lag or sag, an arm between obstacles can move to and fro for ever. Each distance has to
    fall below its least value before, so that the number of gains is finite.

    Attributes:
        lasting: whether the arm has come no closer for too long; until a restart, or until the arm is
            displaced in another way.
        patience: that time [s].

    Args:
        arm: the arm.
        time_constant: time constant with which measurements are averaged [s].
    """

    def __init__(self, arm: Arm, time_constant: float) -> None:
        self._arm = arm
        self._settling_time = STALL.averages * time_constant
        self.patience = STALL.patience + self._settling_time
        self.restart()

    def restart(self) -> None:
        """Begin anew, for another target or other obstacles."""
        self.lasting = False
        self._least: dict[str, float] = {}
        self._time = 0.0
        self._rested = 0.0
        self._displacement: Array | None = None

    def move(self, distances: dict[str, float] | None, dt: float) -> None:
        """Add a cycle in which the command moves.

        Args:
            distances: distances that the arm should reduce, by name [m]; None if nothing hinders it.
            dt: duration of the cycle [s].
        """
        self._rested = 0.0
        if distances is None:
            return
        gain = STALL.gain * self._arm.length
        closer = {name: at for name, at in distances.items() if at < self._least.get(name, np.inf) - gain}
        self._least.update(closer)
        self._time = 0.0 if closer else self._time + dt
        self.lasting = self.lasting or self._time > self.patience

    def rest(self, displacement: Array | None, dt: float) -> None:
        """Add a cycle in which the command rests; begin anew if the arm is displaced in another way.

        Args:
            displacement: average displacement of the arm from the command, (nv,) [rad or m]; None: zero.
            dt: duration of the cycle [s].
        """
        self._rested += dt
        if self._rested < self._settling_time:
            return
        offset = np.zeros(self._arm.nv) if displacement is None else displacement
        if self._displacement is None:
            self._displacement = offset
        if np.any(np.abs(offset - self._displacement) > STALL.other_displacement * self._arm.joint_units):
            self.restart()
