"""How drives respond to their commands: a model, which lead moves a joint, and which joints do not follow."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pinposture import kernels
from pinposture.arm import Arm
from pinposture.kernels.arrays import JointHistory
from pinposture.kernels.joint_response import JOINT_RESPONSE
from pinposture.schema import Declared, Duration, JointDistance, Time, declared

Array = NDArray[np.float64]


class DriveResponseSettings(NamedTuple):
    """When a drive counts as stopped, started, or too coarse."""

    follow_time: float = 0.2
    """Time for which a command moves on before a joint that stands counts as stopped [s]. Delays of drives
    and readings together are shorter: 0.14 s and 0.05 s in logs of robots. A joint that starts later than
    that costs a short hold."""

    lead_factor: float = 2.0
    lead_margin: float = 0.05
    """The command moves a joint for certain by twice the largest lead at which joints began to move before,
    as friction holds on either side, and this much more, in `Arm.joint_units`."""

    retry_time: float = 2.0
    """Time after which a stopped joint is tried again if no lead tells when it runs [s]."""

    overshoots: int = 3
    """How often a joint may come to rest beyond its target before its drive counts as too coarse."""

    noticed: float = 1.5
    """Motion by which the start of a stopped joint is noticed, relative to the smallest that counts as
    motion."""

    noise: float = 5e-4
    """Noise of measurements that is assumed at first, in `Arm.joint_units`; 3e-4 rad in logs of a robot."""

    errors: float = 4.0
    """Deviation from a model of drives that is usual, in its `DriveModel.error`: slow disturbances are no
    white noise, so that three standard deviations would not do. tests/motion/test_drive_response.py bounds
    it."""


DRIVE_RESPONSE = DriveResponseSettings()


@declared()
class DriveModel(Declared):
    """How the position drives of joints follow a command c: lag * dq/dt = e - friction * sign(e).

    Here e = c + sag - q, with the command of `delay` ago. A joint at rest stays there while |e| is at most
    friction + stiction; one that moves comes to rest where |e| falls to the friction.

    The defaults fit logs of a snake of 16 joints at rest and in motion: one set for all joints explains 87 to
    92 % of the variance of a log that was left out.

    Attributes:
        lag: time constant of the drives [s].
        friction: Coulomb friction, as an angle of the command [rad or m].
        stiction: static friction beyond that [rad or m].
        delay: age of the commands that reach the drives [s].
        error: root mean square of what this model does not explain of the positions [rad or m].
    """

    lag: Duration = 0.32
    friction: JointDistance = 0.11
    stiction: JointDistance = 0.0
    delay: Time = 0.008
    error: JointDistance = 0.065

    @property
    def starting_lead(self) -> float:
        """How far ahead a command must be to start a joint [rad or m]."""
        return self.friction + self.stiction

    @property
    def tracking_error(self) -> float:
        """How far a joint may be from where the model has it while nothing is wrong [rad or m]."""
        return self.starting_lead + DRIVE_RESPONSE.errors * self.error

    def lead(self, velocities: Array, slow: Array) -> Array:
        """Return how far ahead of their positions joints have to be commanded to move, (n,) [rad or m].

        Args:
            velocities: velocities of the joints, (n,) [rad/s or m/s].
            slow: velocities below which the lead against friction fades, (n,) [rad/s or m/s].
        """
        return np.asarray(self.lag * velocities + self.friction * np.clip(velocities / slow, -1.0, 1.0))


class DriveResponse:
    """Watches measured positions beside commanded ones, for all joints.

    A joint at rest is stopped by its drive, or its encoder is frozen, if the command moves on by more than
    any joint has needed to start, and nothing moves for `DRIVE_RESPONSE.follow_time`. The lead that friction
    needs is learned from each start; all joints count together, as the drives of an arm are mostly alike.

    Attributes:
        stopped: which joints do not follow, (nv,).
        held: positions at which they are held, (nv,) [rad or m].
        history: what is known of each joint.
        followed: whether a joint has ever been seen to follow its command, from rest or in motion.

    Args:
        arm: the arm.
        usual_lead: lead that may be needed to start a joint that has not moved yet, in `Arm.joint_units`.
        positions_sent: whether the drives are sent positions, so that a stopped one starts at a lead.
    """

    def __init__(self, arm: Arm, usual_lead: float, positions_sent: bool) -> None:
        self.arm = arm
        self._positions_sent = positions_sent
        self._units = np.array(arm.joint_units)  # writable, as kernels take arrays
        self._unknown = usual_lead
        self._blocked = np.zeros(arm.nv, dtype=np.bool_)
        self._leads = np.full(arm.nv, -1.0)
        self.followed = False
        self.restart(np.zeros(arm.nv))

    def restart(self, positions: Array) -> None:
        """Start from joint positions (nv,) at rest; leads that are known stay."""
        nv = self.arm.nv
        self._leads = self._leads.copy()
        self.history = JointHistory(
            anchors=positions.copy(),
            starts=positions.copy(),
            standing=np.full(nv, 1e9),
            waiting=np.zeros(nv),
            leads=self._leads,
            readings=np.array([positions, positions]),
            variances=(DRIVE_RESPONSE.noise * self.arm.joint_units) ** 2,
            errors=np.zeros(nv),
            commands=positions.copy(),
            overshoots=np.zeros(nv),
            steps=np.zeros(nv),
        )
        self._blocked[:] = False
        self.stopped = np.zeros(nv, dtype=np.bool_)
        self.held = self._found = self._direction = positions
        self._stopped_for = 0.0

    def forget_overshoots(self) -> None:
        """Start again to count overshoots, for a new target."""
        self.history.errors[:] = 0.0
        self.history.overshoots[:] = 0.0

    @property
    def band(self) -> float:
        """Motion of the command that moves a joint for certain, in `Arm.joint_units`."""
        largest = float((self._leads / self.arm.joint_units).max())
        if largest < 0.0:
            return self._unknown
        return DRIVE_RESPONSE.lead_factor * largest + DRIVE_RESPONSE.lead_margin

    @property
    def moved(self) -> bool:
        """Whether a joint has ever been seen to start, so that leads are known."""
        return bool(self._leads.max() >= 0.0)

    def update(self, measured: Array, sent: Array, expected: Array, dt: float) -> None:
        """Process the positions of a cycle; each (nv,) [rad or m].

        Args:
            measured: measured joint positions.
            sent: commanded joint positions.
            expected: joint positions at which the command aims.
            dt: duration of the cycle [s].
        """
        units = self._units
        sent_before = self.history.starts.copy()
        moved_before = self.history.anchors.copy()
        kernels.watch_joints(measured, sent, expected, units, dt, self.band, self.history, self._blocked)
        if not self.followed:
            travel = self.history.starts - sent_before
            motion = self.history.anchors - moved_before
            # A lag makes less than half of the travel; a joint that falls or is pushed differs by more.
            self.followed = self.moved or bool(np.any(np.abs(motion - travel) < 0.5 * np.abs(travel)))
        if self.stopped.any():
            self._watch_stopped(dt)
        elif self._blocked.any():
            stopped = self._blocked & (self.history.waiting > DRIVE_RESPONSE.follow_time)
            if stopped.any():
                self._hold(stopped, measured, sent)

    def retry(self) -> None:
        """Take all joints to follow until they stand again."""
        self.history.waiting[:] = 0.0
        self.stopped = np.zeros(self.arm.nv, dtype=np.bool_)
        self._stopped_for = 0.0

    def hold_standing(self, measured: Array, sent: Array) -> None:
        """Take all joints that stand at a lead to be stopped, as one of them is.

        Args:
            measured: measured joint positions, (nv,) [rad or m].
            sent: commanded joint positions, (nv,) [rad or m].
        """
        lead = sent - measured
        travel = np.where((sent - self.history.starts) * lead > 0.0, sent - self.history.starts, 0.0)
        ahead = np.abs(travel) > self._starting_lead()
        standing = ahead & (self.history.standing > DRIVE_RESPONSE.follow_time)
        if standing.any():
            self._hold(self.stopped | standing, measured, sent)

    def _hold(self, stopped: NDArray[np.bool_], measured: Array, sent: Array) -> None:
        """Take joints to be stopped: their commands wait where the joints start if they can."""
        self.stopped = stopped
        self._stopped_for = 0.0
        self._found = self.history.anchors.copy()
        self._direction = np.sign(sent - measured)
        self.held = measured + self._direction * self._starting_lead()

    def _starting_lead(self) -> Array:
        """Return the lead at which each joint would start noticeably, (nv,) [rad or m]."""
        units = self.arm.joint_units
        noise = np.sqrt(self.history.variances) / units
        response = JOINT_RESPONSE
        moved = np.clip(response.moved_deviations * noise, response.moved, response.most_moved)
        known = max(float((self._leads / units).max()), 0.0)
        return np.asarray((known + DRIVE_RESPONSE.noticed * moved) * units)

    def _watch_stopped(self, dt: float) -> None:
        """Release the joints that follow again."""
        self._stopped_for += dt
        least = 0.5 * JOINT_RESPONSE.moved * self.arm.joint_units
        moved = (self.history.anchors - self._found) * self._direction
        self.stopped = self.stopped & (moved < least)
        if not self.stopped.any() or (
            not (self._positions_sent and self.moved) and self._stopped_for > DRIVE_RESPONSE.retry_time
        ):
            self.retry()

    @property
    def compensable(self) -> NDArray[np.bool_]:
        """Joints whose commands may go farther against their errors, (nv,)."""
        history = self.history
        coarse = (history.overshoots >= DRIVE_RESPONSE.overshoots) & (np.abs(history.errors) <= history.steps)
        return ~(self._blocked | self.stopped | coarse)
