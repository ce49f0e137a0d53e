"""Torque limits of postures, which plans and steps keep beside obstacles and constraints."""

from __future__ import annotations

from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pinposture.arm import Arm, ChainState, JointLoad
from pinposture.arm.weight import heaviest_load
from pinposture.control.constraint import VIOLATION_ROUNDING, Sides
from pinposture.control.limits import Limits
from pinposture.errors import InvalidValue

Array = NDArray[np.float64]


LINEARISED = 1e-3
"""Share of a torque limit that is kept for the terms of second order of a step. Without it, the torques of 60
runs of `benchmarks.studies.torque_limits` exceeded their limits by up to a ten-thousandth."""


class Overload(NamedTuple):
    """What the motors lack to hold an arm still.

    Attributes:
        load: the joint that needs most of its limit.
        excess: mass at the tip without which they could hold it [kg]; None if they could not without any.
    """

    load: JointLoad
    excess: float | None

    def __str__(self) -> str:
        return f"{self.load} to hold the arm{self.remedy}"

    def as_data(self) -> dict[str, str | float | None]:
        """Return it as data for JSON."""
        return {**self.load.as_data(), "excess": self.excess}

    @property
    def remedy(self) -> str:
        """What would be little enough, in words; empty if that is not known."""
        return "" if self.excess is None else f" (they could with {self.excess:.3g} kg less at the tip)"


class TorqueLimits:
    """The torques that hold an arm still, within limits.

    Torques count in metres, as distances do: a torque as large as its limit is the length of the arm. So a
    path keeps a hundredth of each limit in reserve where it can, as it keeps that share of the length away
    from obstacles.

    Args:
        arm: the arm, whose masses are known.
        effort: the limits, (nv,) [N m or N]; infinite where there is none.
    """

    def __init__(self, arm: Arm, effort: Array) -> None:
        self._arm = arm
        self._limits = effort
        self._effort = (1.0 - VIOLATION_ROUNDING) * effort  # what counts as none is kept, too
        self._limited = np.flatnonzero(np.isfinite(effort))
        self._scale = arm.length / self._effort[self._limited]

    @cached_property
    def _names(self) -> tuple[str, ...]:
        return tuple(f"torque of joint {self._arm.drives[joint].joint!r}" for joint in self._limited)

    def sides(self, state: ChainState) -> Sides:
        """Return both bounds of each torque at a state."""
        dynamics = self._arm.dynamics
        positions = state.raw_positions
        torques = self._scale * dynamics.gravity_torques(positions)[self._limited]
        gradient = self._scale[:, None] * dynamics.gravity_gradient(positions)[self._limited]
        room = self._arm.length - np.concatenate([torques, -torques])
        return Sides(np.concatenate([-gradient, gradient]), room, self._names + self._names)

    def violations(self, positions: Array) -> Array:
        """Return the largest excess over a limit at joint positions (s, nv), (s,) [m]; 0 if all are kept."""
        torques = np.abs(self._arm.dynamics.gravity_torques(positions)[:, self._limited])
        over = torques / self._effort[self._limited] - 1.0
        return np.asarray(self._arm.length * over.max(axis=1, initial=0.0))

    def heaviest(self, positions: Array) -> JointLoad:
        """Return the joint that needs most of its limit at joint positions (nv,)."""
        torques = self._arm.dynamics.gravity_torques(positions)
        return heaviest_load(self._arm.drives, torques, self._limits)

    def describe(self, positions: Array) -> tuple[str, ...]:
        """Return a message if a limit is exceeded at joint positions (nv,)."""
        load = self.heaviest(positions)
        return (f"torque limit: {load} to hold the arm",) if load.exceeded else ()

    def overload(self, state: ChainState) -> Overload | None:
        """Return what the motors lack to hold the arm at a state; None if they can."""
        load = self.heaviest(state.raw_positions)
        return Overload(load, self.excess_payload(state)) if load.exceeded else None

    def excess_payload(self, state: ChainState) -> float | None:
        """Return the smallest mass at the tip without which the motors could hold the arm [kg].

        None if they could not without any.
        """
        arm = self._arm
        torques = arm.dynamics.gravity_torques(state.raw_positions)[self._limited]
        lift = -state.jacobians[-1].T @ np.asarray(arm.model.gravity.linear)
        lift = lift[self._limited]  # torques per mass at the tip
        limits = self._effort[self._limited]
        over = np.abs(torques) > limits
        with np.errstate(divide="ignore", invalid="ignore"):
            least = np.where(lift != 0.0, (torques - np.copysign(limits, lift)) / lift, 0.0)
            most = np.where(lift != 0.0, (torques + np.copysign(limits, lift)) / lift, np.inf)
        helpless = bool(np.any(over & (lift == 0.0)))
        mass = max(0.0, float(least.max(initial=0.0)))
        return None if helpless or mass > float(most.min(initial=np.inf)) else mass


class StepTorques:
    """The torques of an arm where its next step meets the last one, by inverse dynamics.

    They are those of the mean speed of both steps and of the acceleration from one to the other.

    Args:
        arm: the arm.
        effort: its torque limits, (nv,) [N m or N].
        dt: duration of a step [s].
        positions: joint positions, (nv,) [rad or m].
        previous: the last step, (nv,) [rad or m]; None: the arm was at rest.
    """

    def __init__(self, arm: Arm, effort: Array, dt: float, positions: Array, previous: Array | None) -> None:
        self._arm = arm
        self._effort = effort
        self._dt = dt
        self._positions = positions
        self._previous = np.zeros(arm.nv) if previous is None else previous

    def of(self, dq: Array) -> Array:
        """Return the torques of a step dq (nv,), (nv,) [N m or N]."""
        speed = (self._previous + dq) / (2.0 * self._dt)
        change = (dq - self._previous) / self._dt**2
        torques = self._arm.dynamics.inverse_dynamics(self._positions[None], speed[None], change[None])
        return np.asarray(torques[0])

    def keep_limits(self, dq: Array) -> bool:
        """Check whether the torques of a step dq (nv,) are within their limits."""
        return bool((np.abs(self.of(dq)) <= self._effort).all())

    @cached_property
    def masses(self) -> Array:
        """The mass matrix, with armature, (nv, nv)."""
        nv = self._arm.nv
        at = np.repeat(self._positions[None], nv + 1, axis=0)
        accelerations = np.vstack([np.zeros(nv), np.eye(nv)])
        found = self._arm.dynamics.inverse_dynamics(at, np.zeros((nv + 1, nv)), accelerations)
        masses = found[1:] - found[0]
        return np.asarray(0.5 * (masses + masses.T))

    def rows(self, dq: Array) -> tuple[Array, Array]:
        """Return the limits of the torques of steps near dq (nv,), as shares of the limits.

        Returns:
            matrix: (2 r, nv).
            least: smallest value of each row times the step, (2 r,).
        """
        limited = np.isfinite(self._effort)
        effort = (1.0 - LINEARISED) * self._effort[limited]
        masses = self.masses[limited] / (effort[:, None] * self._dt**2)
        rest = self.of(dq)[limited] / effort - masses @ dq
        return np.vstack([masses, -masses]), np.concatenate([-1.0 - rest, rest - 1.0])


def find_overload(arm: Arm, q: Array, limits: Limits) -> Overload | None:
    """Return what the motors lack to hold an arm at a configuration (nq,), within torque limits of `limits`.

    None if they can, or if there are no torque limits.
    """
    effort = limits.for_arm(arm).effort
    return None if effort is None else TorqueLimits(arm, effort).overload(arm.chain_at(q))


def require_held(arm: Arm, q: Array, limits: Limits, name: str) -> None:
    """Check that the motors hold an arm at a configuration (nq,), within torque limits of `limits`.

    Raises:
        InvalidValue: a motor has not enough torque; names the joint that needs most, and the mass that is too
            much.
    """
    overload = find_overload(arm, q, limits)
    if overload is not None:
        allowed = f"a posture that the motors can hold{overload.remedy}; or strict=False, to run it anyway"
        raise InvalidValue(name, str(overload.load), allowed)
