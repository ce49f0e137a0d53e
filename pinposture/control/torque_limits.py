"""Torque limits of postures, which plans and steps keep beside obstacles and constraints."""

from __future__ import annotations

from functools import cached_property
from typing import NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from pinposture.arm import Arm, ChainState, JointLoad
from pinposture.arm.dynamics import StepLoads
from pinposture.arm.weight import heaviest_load
from pinposture.control.constraint import Inequalities
from pinposture.control.limits import JointBounds, Limits, farthest
from pinposture.errors import InvalidValue
from pinposture.units import CONVERGED, ROUNDING

Array = NDArray[np.float64]


class TorqueLimitSettings(NamedTuple):
    """What paths and stops leave of the torque limits."""

    length: float = 0.2
    """Length as which a torque counts that is as large as its limit, in arm lengths. With 1, paths beside
    postures that cannot be held had a hundredth of each limit left for motion, and 62 of 75 arms, not 67,
    reached a target that moves on (`benchmarks.studies.torque_limits`)."""

    linearised: float = 1e-3
    """Share of a torque limit that is kept for the terms of second order of a step. Without it, the torques
    of 60 runs of `benchmarks.studies.torque_limits` exceeded their limits by up to a ten-thousandth."""

    max_stopping: float = 300.0
    """Largest number of steps of a stop within torque limits."""

    least_mass: float = 1e-4
    """Mass that counts beside that of the arm, relative to the mean of the joints: enough for a matrix that
    is positive definite in spite of rounding."""

    hardest_share: float = 0.98
    """Share of the torques that slow an arm down that its hardest stop takes; the rest is for terms of
    second order."""

    slowing_share: float = 0.8
    """Share of the torques that slow an arm down on which an approach relies; the rest is for other
    postures."""


TORQUE_LIMIT = TorqueLimitSettings()


class Stop(NamedTuple):
    """Steps that stop an arm.

    Attributes:
        steps: the steps, (k, nv) [rad or m]; k = 0 if it stops at once.
        loads: the largest torques in them and in the steps before; None if they are not known.
    """

    steps: Array
    loads: StepLoads | None = None

    @property
    def share(self) -> float:
        """Largest torque in motion, relative to its limit; 0 if it is not known."""
        return 0.0 if self.loads is None else self.loads.moving


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

    Torques count in metres, as distances do: a torque as large as its limit is `TORQUE_LIMIT.length` arm
    lengths. So a path keeps a twentieth of each limit in reserve where it can, as it keeps a hundredth of
    the length of the arm away from obstacles.

    Args:
        arm: the arm, whose masses are known.
        effort: the limits, (nv,) [N m or N]; infinite where there is none.
    """

    def __init__(self, arm: Arm, effort: Array) -> None:
        self._arm = arm
        self._limits = effort
        self._length = TORQUE_LIMIT.length * arm.length

    @cached_property
    def _effort(self) -> Array:
        """The limits without what counts as no excess, which is kept, too."""
        return np.asarray((1.0 - CONVERGED) * self._limits)

    @cached_property
    def _limited(self) -> NDArray[np.intp]:
        """The degrees of freedom that have a limit."""
        return np.flatnonzero(np.isfinite(self._limits))

    @cached_property
    def _names(self) -> tuple[str, ...]:
        return tuple(f"torque of joint {self._arm.drives[joint].joint!r}" for joint in self._limited)

    def inequalities(self, state: ChainState) -> Inequalities:
        """Return both bounds of each torque at a state."""
        shares, gradient = self.shares(state)
        torques = self._length * shares
        gradient = self._length * gradient
        room = self._length - np.concatenate([torques, -torques])
        return Inequalities(np.concatenate([-gradient, gradient]), room, self._names + self._names)

    def shares(self, state: ChainState) -> tuple[Array, Array]:
        """Return each limited torque at a state, relative to its limit, (r,), and its gradient, (r, nv)."""
        effort = self._effort[self._limited]
        torques = state.gravity_torques[self._limited] / effort
        return torques, state.gravity_gradient[self._limited] / effort[:, None]

    def least_room(self, positions: Array) -> Array:
        """Return the smallest distance of a torque from its limit at joint positions (s, nv), (s,) [m]."""
        return self._length * (1.0 - self._largest_shares(self._arm.dynamics.gravity_torques(positions)))

    def violations(self, positions: Array) -> Array:
        """Return the largest excess over a limit at joint positions (s, nv), (s,) [m]; 0 if all are kept."""
        shares = self._largest_shares(self._arm.dynamics.gravity_torques(positions))
        return np.asarray(self._length * np.maximum(shares - 1.0, 0.0))

    def violation(self, state: ChainState) -> float:
        """Return the largest excess over a limit at a state [m]; 0 if all are kept."""
        return self._length * max(float(self._largest_shares(state.gravity_torques)) - 1.0, 0.0)

    def _largest_shares(self, torques: Array) -> Array:
        """Return the largest of torques (..., nv), relative to its limit, (...)."""
        return np.asarray((np.abs(torques) / self._effort).max(axis=-1))

    def excess_of(self, share: float) -> float:
        """Return the excess over a limit of a torque that is a share of it [m]."""
        return self._length * max(share / (1.0 - CONVERGED) - 1.0, 0.0)

    def heaviest(self, state: ChainState) -> JointLoad:
        """Return the joint that needs most of its limit at a state."""
        return heaviest_load(self._arm.drives, state.gravity_torques, self._limits)

    def describe(self, state: ChainState) -> tuple[str, ...]:
        """Return a message if a limit is exceeded at a state."""
        load = self.heaviest(state)
        return (f"torque limit: {load} to hold the arm",) if load.exceeded else ()

    def overload(self, state: ChainState) -> Overload | None:
        """Return what the motors lack to hold the arm at a state; None if they can."""
        load = self.heaviest(state)
        return Overload(load, self.excess_payload(state)) if load.exceeded else None

    def require_held(self, state: ChainState, name: str) -> None:
        """Raise InvalidValue if the motors cannot hold the arm at a state; see `require_held`."""
        overload = self.overload(state)
        if overload is not None:
            remedy = f"{overload.remedy}; or strict=False, to run it anyway"
            raise InvalidValue(name, str(overload.load), f"a posture that the motors can hold{remedy}")

    def excess_payload(self, state: ChainState) -> float | None:
        """Return the smallest mass at the tip without which the motors could hold the arm [kg].

        None if they could not without any.
        """
        arm = self._arm
        torques = state.gravity_torques[self._limited]
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
    """The torques of the next steps of an arm, by inverse dynamics.

    They are those of the mean speed of two steps and of the acceleration from one to the other, where the
    steps meet.

    Args:
        arm: the arm.
        bounds: the limits of its joints, with torque limits and a cycle time.
        positions: joint positions, (nv,) [rad or m].
        previous: the last step, (nv,) [rad or m]; None: the arm was at rest.
    """

    def __init__(self, arm: Arm, bounds: JointBounds, positions: Array, previous: Array | None) -> None:
        self._arm = arm
        self._bounds = bounds
        self._effort = cast(Array, bounds.effort)
        self._dt = cast(float, bounds.dt)
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

    def judged(self, steps: Array, first: int = 0) -> Stop:
        """Return steps (k, nv) that stop the arm with their torques; so many of them come before the stop."""
        dynamics = self._arm.dynamics
        loads = dynamics.step_loads(self._positions, self._previous, steps, self._dt, self._effort)
        return Stop(steps[first:], loads)

    def stop(self, dq: Array | None = None) -> Stop:
        """Find the steps that stop the arm on a straight line, if possible within torque limits.

        Of three stops it takes the first within all limits: the shortest within limits of acceleration, one
        in which all joints slow down evenly, but for those that come to a position limit before, and
        one in which they slow down as fast as torques allow at each posture.

        Args:
            dq: a step before, (nv,) [rad or m]; None: the arm brakes at once.
        """
        first = np.zeros((0, self._arm.nv)) if dq is None else dq[None]
        moving = self._previous if dq is None else dq
        start = self._positions if dq is None else self._positions + dq
        best: Stop | None = None
        for stop in (self._shortest_stop, self._even_stop, self._hardest_stop):
            steps = stop(start, moving)
            if steps is None or (best is not None and self._leaves_limits(start, moving, steps)):
                continue
            judged = self.judged(np.concatenate([first, steps]), len(first))
            if judged.share <= 1.0:
                return judged
            if best is None or judged.share < best.share:
                best = judged
        return cast(Stop, best)

    def _shortest_stop(self, start: Array, moving: Array) -> Array | None:
        """Return the steps of the shortest stop within limits of acceleration; None without these."""
        bounds = self._bounds
        if bounds.brake is None:
            return None
        return bounds.stopping_steps(start, moving)

    def _even_stop(self, start: Array, moving: Array) -> Array:
        """Return the steps of an even stop within the torque limits of its first posture."""
        count = np.ceil(1.0 / self._slowing(start, moving))
        low, high = self._bounds.position_limits - start
        room = np.where(moving > 0.0, high, -low)
        with np.errstate(divide="ignore", invalid="ignore"):
            most = np.floor(1.0 + 2.0 * room / np.abs(moving))
        most = np.where((moving != 0.0) & (room >= 0.0), most, np.inf)
        ramp = np.arange(1.0, count)[:, None] / np.minimum(most, count)
        return np.asarray(moving * np.maximum(1.0 - ramp, 0.0))

    def _hardest_stop(self, start: Array, moving: Array) -> Array:
        """Return the steps of a stop that takes all torque at each posture."""
        steps = np.zeros((0, len(moving)))
        while len(steps) < TORQUE_LIMIT.max_stopping and (share := self._slowing(start, moving)) < 1.0:
            moving = (1.0 - TORQUE_LIMIT.hardest_share * share) * moving
            start = start + moving
            steps = np.vstack([steps, moving])
        return steps

    def _leaves_limits(self, start: Array, moving: Array, steps: Array) -> bool:
        """Whether the steps of a stop exceed limits of acceleration, or lead out of those of positions."""
        low, high = self._bounds.position_limits - start
        away = steps.sum(axis=0)
        outside = np.any((away < np.minimum(low, 0.0) - ROUNDING) | (away > np.maximum(high, 0.0) + ROUNDING))
        brake = self._bounds.brake
        if brake is None:
            return bool(outside)
        changes = np.diff(np.vstack([moving, steps, np.zeros(len(moving))]), axis=0)
        return bool(outside or np.any(np.abs(changes) > brake + ROUNDING))

    def _slowing(self, positions: Array, moving: Array) -> float:
        """Return the share of its speed that an arm can lose in a step, one in `max_stopping` at least."""
        share = self.slowing(positions, moving, moving)
        if self._bounds.brake is not None and np.any(moving):
            share = min(share, 1.0 / float(np.max(np.abs(moving) / self._bounds.brake)))
        return max(share, 1.0 / TORQUE_LIMIT.max_stopping)

    def slowing(self, positions: Array, way: Array, moving: Array | None = None) -> float:
        """Return by how much an arm that moves along a way can slow down in a step, relative to the way.

        Args:
            positions: joint positions, (nv,) [rad or m].
            way: the way, (nv,) [rad or m].
            moving: its last step, (nv,) [rad or m]; None: it is slow.
        """
        speed = np.zeros(len(way)) if moving is None else moving / self._dt
        changes = np.array([np.zeros(len(way)), way / self._dt**2])
        same = np.ones((2, 1))
        held, driven = self._arm.dynamics.inverse_dynamics(same * positions, same * speed, changes)
        needed = driven - held
        room = self._effort + np.where(needed > 0.0, held, -held)
        with np.errstate(divide="ignore", invalid="ignore"):
            shares = np.where(needed != 0.0, room / np.abs(needed), np.inf)
        return max(float(shares.min()), 0.0)

    def approach(self, way: Array) -> Array:
        """Return the largest step along a way, (nv,), from which the arm can still stop at its end.

        The torques at its beginning count; `TORQUE_LIMIT.slowing_share` of them.
        """
        if not np.any(way):
            return way
        slowing = TORQUE_LIMIT.slowing_share * self.slowing(self._positions, way)
        slowing += 1.0 / TORQUE_LIMIT.max_stopping
        return np.asarray(farthest(np.ones(1), np.array([slowing])) * way)

    @cached_property
    def masses(self) -> Array:
        """The mass matrix, with armature, (nv, nv)."""
        nv = self._arm.nv
        at = np.repeat(self._positions[None], nv + 1, axis=0)
        accelerations = np.vstack([np.zeros(nv), np.eye(nv)])
        torques = self._arm.dynamics.inverse_dynamics(at, np.zeros((nv + 1, nv)), accelerations)
        masses = torques[1:] - torques[0]
        return np.asarray(0.5 * (masses + masses.T))

    @cached_property
    def inertia(self) -> Array:
        """The same, made positive definite in spite of rounding, (nv, nv)."""
        masses = self.masses
        return masses + TORQUE_LIMIT.least_mass * float(np.trace(masses)) / len(masses) * np.eye(len(masses))

    def rows(self, dq: Array) -> tuple[Array, Array]:
        """Return the limits of the torques of steps near dq (nv,), as shares of the limits.

        Returns:
            matrix: (2 r, nv).
            least: smallest value of each row times the step, (2 r,).
        """
        limited = np.isfinite(self._effort)
        effort = (1.0 - TORQUE_LIMIT.linearised) * self._effort[limited]
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
    effort = limits.for_arm(arm).effort
    if effort is not None:
        TorqueLimits(arm, effort).require_held(arm.chain_at(q), name)
