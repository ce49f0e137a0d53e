"""What a tracker sends in addition to its command, so that the loaded arm is at the command."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pinposture.arm import Arm, ArmState
from pinposture.control.limits import Limits, cycle_of, farthest
from pinposture.control.smooth_steps import SmoothSteps

Array = NDArray[np.float64]

RESERVED = 0.1
"""Share of each limit that is kept for compensation; the command moves within the rest. In 21 fast motions of
seven arms of 1 m, which sag by up to 40 mm, compensation is late by at most 5 mrad; with half of the share by
13 mrad, with twice of it by 3 mrad, and motions take 8 % longer."""


def shared(limits: Limits, arm: Arm, share: float) -> Limits:
    """Return a share of limits of step, velocity, acceleration and jerk."""
    velocity = arm.limits.velocity if limits.velocity is None else limits.velocity

    def part(limit: float | Array | None) -> float | Array | None:
        return None if limit is None else share * limit

    return replace(
        limits,
        step=part(limits.step),
        velocity=part(velocity),
        acceleration=part(limits.acceleration),
        jerk=part(limits.jerk),
    )


class SagCompensation:
    """The displacement K^-1 g(q) of drives beyond a command q, followed within a share of the limits.

    Command and compensation share the limits of each joint, so what is sent keeps them. At a position limit
    the compensation ends.

    Attributes:
        offset: displacement of what is sent from the command, (nv,) [rad or m].
        cut: what position limits took from the latest compensation, (nv,) [rad or m].

    Args:
        arm: the arm.
        limits: limits of what is sent, with `dt`.

    Raises:
        WeightUnknown: masses or a stiffness that are not known.
    """

    def __init__(self, arm: Arm, limits: Limits) -> None:
        arm.require_masses()
        self.arm = arm
        self._compliance = np.linalg.inv(arm.stiffness)
        self.offset = np.zeros(arm.nv)
        self.cut = np.zeros(arm.nv)
        self.take(limits)
        self.smooth()

    def take(self, limits: Limits) -> None:
        """Take other limits with the same smoothing; another one takes effect with `smooth`."""
        self._limits = shared(limits, self.arm, RESERVED)
        self._period = cycle_of(limits)

    def smooth(self) -> None:
        """Smooth steps as the limits need it from now on, at rest."""
        self._smoothing = SmoothSteps(self.arm, self._limits)
        self._stop(self.offset)

    def _stop(self, offset: Array) -> None:
        self.offset = offset
        self._aimed = offset
        self._step = np.zeros(self.arm.nv)
        self._dt = self._period
        self._smoothing.restart()

    @property
    def moving(self) -> bool:
        """Whether the compensation still moves, or has to."""
        return self._smoothing.moving or bool(np.any(self._step))

    def restart(self, state: ArmState, positions: Array) -> None:
        """Begin at rest with the compensation of a state; see `advance`."""
        self._stop(self._wanted(state, positions))

    def advance(self, state: ArmState, positions: Array, dt: float) -> Array:
        """Return the motion of the compensation in a cycle, (nv,) [rad or m].

        Args:
            state: the command at the end of the cycle.
            positions: its joint positions with full turns, (nv,) [rad or m].
            dt: duration of the cycle, at most the nominal one [s].
        """
        before = self.offset
        limits = self._limits
        if not self._smoothing.active and dt != self._dt:
            self._step = self._step * (dt / self._dt)
            self._dt = dt
        if not self._smoothing.active and dt != self._period:
            limits = replace(limits, dt=dt)
        command = self._wanted(state, positions)
        step = None
        if self._smoothing.needs_step(dt / self._period):
            room = command - self._aimed
            bounds = limits.for_arm(self.arm)
            step = room
            if bounds.brake is not None:
                step = farthest(room, bounds.brake)
                step = np.minimum(np.maximum(step, self._step - bounds.brake), self._step + bounds.brake)
            step = np.minimum(np.maximum(step, -bounds.bound), bounds.bound)
            self._aimed = self._aimed + step
            self._step = step
        moved = self._smoothing.advance(dt / self._period, step)
        self.offset = self._within(self.offset + moved, positions)
        return np.asarray(self.offset - before)

    def _wanted(self, state: ArmState, positions: Array) -> Array:
        """Return the compensation within the position limits."""
        needed = self._compliance @ state.gravity_torques
        command = self._within(needed, positions)
        self.cut = needed - command
        return command

    def _within(self, offset: Array, positions: Array) -> Array:
        """Return a compensation such that joints within their limits, at these positions, stay there."""
        lower = np.minimum(self.arm.limits.lower - positions, 0.0)
        upper = np.maximum(self.arm.limits.upper - positions, 0.0)
        return np.asarray(np.minimum(np.maximum(offset, lower), upper))
