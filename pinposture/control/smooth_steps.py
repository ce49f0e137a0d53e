"""Steps in control cycles of any duration: within a jerk limit, and what they exceed."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pinposture.arm import Arm
from pinposture.arm.weight import heaviest_load
from pinposture.control.limits import JerkFilter, JointBounds, Limits
from pinposture.errors import InvalidValue

Array = NDArray[np.float64]


class SmoothStepTolerances(NamedTuple):
    """What of steps under a jerk limit is due to rounding."""

    share: float = 1e-9
    """Share of a nominal cycle that is attributed to rounding."""

    rate: float = 1e-6
    """Relative excess over a limit that is not reported."""

    displacement: float = 1e-15
    """Rounding of a step [rad or m], which short cycles amplify."""


SMOOTHING = SmoothStepTolerances()


class SmoothSteps:
    """Turns the steps of a controller into steps of cycles of any duration, within the limit of jerk.

    The controller steps in nominal cycles, whatever the durations of cycles are. Its steps pass a
    `JerkFilter`; the configurations after it are control points, one nominal cycle apart, of a uniform cubic
    B-spline in time, which the arm follows. The position, speed, acceleration and jerk of such a spline are
    means of the positions and finite differences of its control points, so it keeps their limits at all
    times, and thus at the ends of cycles of any duration. It follows the control points by one cycle.

    Args:
        arm: the arm.
        limits: the limits of each nominal cycle.

    Attributes:
        active: whether there is a limit of jerk; without one, steps are not changed and each cycle needs one.
    """

    def __init__(self, arm: Arm, limits: Limits) -> None:
        self._filter = JerkFilter(arm, limits)
        self.active = limits.for_arm(arm).jerk is not None
        self._steps = np.zeros((3, arm.nv))
        self._s = 1.0  # on the current piece of the spline, in nominal cycles

    def like(self, other: SmoothSteps) -> bool:
        """Whether the motion under other limits is smoothed in the same way."""
        return self.active == other.active and self._filter.cycles == other._filter.cycles

    @property
    def ahead(self) -> Array:
        """Motion still to come from the steps of the controller so far, (nv,) [rad or m]."""
        return np.asarray(self._filter.ahead + self._owed() @ self._steps)

    @property
    def delay(self) -> float:
        """Number of nominal cycles by which the arm follows the steps of the controller late."""
        return self._filter.delay + 1.0 if self.active else 0.0

    @property
    def moving(self) -> bool:
        """Whether the arm still moves if all further steps of the controller are zero."""
        return self.active and (self._filter.moving or bool(np.any(self._steps)))

    def needs_step(self, share: float) -> bool:
        """Whether a cycle, of a share of the nominal one, needs a step of the controller."""
        return not self.active or self._s + share > 1.0 + SMOOTHING.share

    def advance(self, share: float, dq: Array | None) -> Array:
        """Return the step of the arm in a cycle, (nv,) [rad or m].

        Args:
            share: duration of the cycle, at most 1, in nominal cycles.
            dq: the step of the controller, (nv,) [rad or m]; None if the cycle `needs_step` of none.
        """
        if not self.active:
            if dq is None:
                raise InvalidValue("dq", dq, "the step of the controller, in a cycle that needs one")
            return dq
        before = self._owed() @ self._steps
        new = np.zeros(self._steps.shape[1])
        self._s += share
        if dq is not None:
            new = self._filter.apply(dq)
            self._s -= 1.0
            self._steps[:-1] = self._steps[1:]
            self._steps[-1] = new
        return np.asarray(before + new - self._owed() @ self._steps)

    def restart(self, dq: Array | None = None) -> None:
        """Restart from rest, or from the speed of a step dq of a nominal cycle, (nv,)."""
        self._filter.restart(dq)
        self._steps[:] = 0.0 if dq is None else dq
        self._s = 1.0

    def _owed(self) -> Array:
        """Return the shares of the last three filtered steps that the arm has not taken yet, (3,)."""
        u = self._s
        # Basis functions of the control points before these steps: the first, and the first two and three.
        first = (1.0 - u) ** 3 / 6.0
        second = first + ((3.0 * u - 6.0) * u * u + 4.0) / 6.0
        return np.array([first, second, 1.0 - u**3 / 6.0])


class RateCheck:
    """Finite differences of the steps that an arm takes, and the limits that they exceed.

    The acceleration is the change of the mean speed between two cycles, divided by the longer of their
    durations; the jerk is six times the third divided difference of the positions. So no motion within the
    limits is reported, whatever the durations. The torque is that of the mean speed and acceleration of two
    steps where they meet, by inverse dynamics.

    Args:
        arm: the arm.
        dt: the nominal cycle time [s].
    """

    def __init__(self, arm: Arm, dt: float) -> None:
        self._arm = arm
        self._dt = dt
        self.restart()

    def restart(self, dq: Array | None = None) -> None:
        """Begin at rest, or with the speed of a step dq of a nominal cycle, (nv,)."""
        self._speed = np.zeros(self._arm.nv) if dq is None else dq / self._dt
        self._acceleration = np.zeros(self._arm.nv)
        self._durations = self._dt, self._dt

    def exceeded(
        self, dq: Array, duration: float, bounds: JointBounds, positions: Array | None = None
    ) -> tuple[str, ...]:
        """Add a step, and return messages on the limits that it exceeds, of velocity first and torque last.

        Args:
            dq: the step, (nv,) [rad or m].
            duration: that of the cycle [s].
            bounds: the limits of a nominal cycle.
            positions: joint positions from which the step begins, (nv,) [rad or m]; None: torques are not
                compared.
        """
        earlier, before = self._durations
        speed = dq / duration
        mean_speed = 0.5 * (speed + self._speed)
        change = speed - self._speed
        gentlest = change / max(before, duration)
        acceleration = change / (0.5 * (duration + before))
        jerk = (acceleration - self._acceleration) / ((earlier + before + duration) / 3.0)
        self._speed = speed
        self._acceleration = acceleration
        self._durations = (before, duration)
        if bounds.dt is None:
            return ()
        shortest = min(earlier, before, duration)
        words = self._compare("velocity", speed, bounds.bound / bounds.dt, SMOOTHING.displacement / shortest)
        if bounds.acceleration is not None:
            most = bounds.acceleration / bounds.dt**2
            words += self._compare("acceleration", gentlest, most, SMOOTHING.displacement / shortest**2)
            if bounds.jerk is not None:
                most = bounds.jerk / bounds.dt**3
                words += self._compare("jerk", jerk, most, SMOOTHING.displacement / shortest**3)
        if bounds.effort is not None and positions is not None:
            moving = self._arm.dynamics.inverse_dynamics(positions[None], mean_speed[None], gentlest[None])
            torques = moving[0]
            if (np.abs(torques) > (1.0 + SMOOTHING.rate) * bounds.effort).any():
                load = heaviest_load(self._arm.drives, torques, bounds.effort)
                words += (f"torque limit: {load} for this step",)
        return words

    def _compare(self, kind: str, rate: Array, most: Array, rounding: float) -> tuple[str, ...]:
        over = np.abs(rate) - (1.0 + SMOOTHING.rate) * most
        joint = int(over.argmax())
        if not over[joint] > rounding:
            return ()
        name = self._arm.joint_names[joint]
        ratio = abs(rate[joint]) / most[joint]
        return (f"{kind} limit: joint {name!r} exceeds it by a factor of {ratio:.4g}",)
