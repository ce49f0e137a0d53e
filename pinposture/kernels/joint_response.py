"""How joints respond to their commands: whether they stand, at which lead they move, and where to."""

from __future__ import annotations

from math import copysign, exp, sqrt
from typing import NamedTuple

from pinposture.kernels.arrays import Array1, Flags1, JointHistory
from pinposture.kernels.compiled import compiled


class JointResponseSettings(NamedTuple):
    """What counts as motion and as rest of a measured joint."""

    moved: float = 1e-3
    """Displacement above which a joint counts as moving, in units of motion of the joint."""

    most_moved: float = 7e-3
    """Largest such displacement, however noisy the readings are."""

    moved_deviations: float = 8.0
    """Displacement, in standard deviations of the readings, that counts as moving. Of readings that are
    repeated some times, the deviation is underestimated by a factor of up to 2."""

    rest_time: float = 0.3
    """Time after which a joint that does not move is at rest [s]; delays and repeated
    readings are shorter."""

    settling_time: float = 0.1
    """Time over which the position of a joint that comes to rest is averaged [s]."""

    noise_time: float = 0.5
    """Time over which noise is averaged [s]."""

    outlier: float = 16.0
    """Largest squared deviation that counts, relative to the variance: a sudden stop is no noise."""

    least_noise: float = 1e-6
    """Smallest standard deviation of readings, in units of motion of the joint."""

    forgetting: float = 0.5
    """Weight of a smaller lead beside those seen before; a larger one counts at once."""


JOINT_RESPONSE = JointResponseSettings()


@compiled
def watch_joints(
    measured: Array1,
    sent: Array1,
    expected: Array1,
    units: Array1,
    dt: float,
    band: float,
    history: JointHistory,
    blocked: Flags1,
) -> None:
    """Update what is known of the response of each joint, in a cycle.

    Args:
        measured: measured joint positions, (n,) [rad or m].
        sent: commanded joint positions, (n,) [rad or m].
        expected: joint positions at which the command aims, (n,) [rad or m].
        units: unit of motion of each joint, (n,) [rad or m].
        dt: duration of the cycle [s].
        band: motion of the command that moves a joint for certain, in these units.
        history: updated.
        blocked: set where the command has moved farther than that without moving the joint, (n,).
    """
    anchors, starts, standing, waiting, leads, readings, variances, errors, commands, overshoots, steps = (
        history
    )
    share = dt / (dt + JOINT_RESPONSE.noise_time)
    for j in range(len(measured)):
        position = measured[j]
        if position != readings[0, j]:  # a new reading
            bend = position - 2.0 * readings[0, j] + readings[1, j]
            noise = max(variances[j], (JOINT_RESPONSE.least_noise * units[j]) ** 2)
            variances[j] += share * (min(bend * bend / 6.0, JOINT_RESPONSE.outlier * noise) - variances[j])
            readings[1, j] = readings[0, j]
            readings[0, j] = position
        least = max(
            JOINT_RESPONSE.moved * units[j],
            min(JOINT_RESPONSE.moved_deviations * sqrt(variances[j]), JOINT_RESPONSE.most_moved * units[j]),
        )
        lead = sent[j] - position
        moved = position - anchors[j]
        if abs(moved) > least:
            if standing[j] >= JOINT_RESPONSE.rest_time and moved * lead >= 0.0:
                lead = abs(lead)
                leads[j] += (lead - leads[j]) * (1.0 if lead > leads[j] else JOINT_RESPONSE.forgetting)
            anchors[j] = position
            starts[j] = sent[j]
            standing[j] = 0.0
        elif (
            standing[j] < JOINT_RESPONSE.rest_time
        ):  # the anchor of a joint that comes to rest is where it rests
            anchors[j] += dt / (dt + JOINT_RESPONSE.settling_time) * moved
        standing[j] += dt
        travel = sent[j] - starts[j]
        away = abs(travel) if travel * lead > 0.0 else 0.0
        waiting[j] = waiting[j] + dt if away > band * units[j] else 0.0
        blocked[j] = away > band * units[j]
        if standing[j] >= JOINT_RESPONSE.rest_time > standing[j] - dt:
            error = position - expected[j]
            jump = abs(error - errors[j])
            # On a longer way the offset changes with the lag of the drive: that is no fault of the drive.
            creeps = abs(sent[j] - commands[j]) <= band * units[j] + jump
            if error * errors[j] < 0.0 and jump > 2.0 * least and creeps:
                overshoots[j] += 1.0
                steps[j] = jump
            errors[j] = error
            commands[j] = sent[j]


@compiled
def follow_commands(
    sent_at: Array1,
    sent: Array1,
    times: Array1,
    shift: Array1,
    drive: Array1,
    positions: Array1,
) -> None:
    """Compute where a drive moves a joint: lag * dq/dt = e - friction * sign(e), with e = c + shift - q.

    Commands c are held until the next one arrives. In between, positions are exact.

    Args:
        sent_at: when commands were sent, not decreasing, (k,) [s], k >= 1.
        sent: the commands, (k,) [rad or m].
        times: times of the positions, not decreasing, (m,) [s].
        shift: displacement by loads, (m,) [rad or m]; each holds from its time to the next.
        drive: lag [s], delay [s], friction [rad or m].
        positions: written, (m,) [rad or m]; the first one is the start.
    """
    lag = drive[0]
    delay = drive[1]
    friction = drive[2]
    last = len(sent) - 1
    arrived = 0
    position = positions[0]
    for i in range(1, len(times)):
        now = times[i - 1]
        while now < times[i]:
            while arrived < last and sent_at[arrived + 1] + delay <= now:
                arrived += 1
            until = times[i]
            if arrived < last:
                until = min(until, sent_at[arrived + 1] + delay)
            error = sent[arrived] + shift[i - 1] - position
            if abs(error) > friction:
                away = error - copysign(friction, error)
                position += away * (1.0 - exp(-(until - now) / lag))
            now = until
        positions[i] = position
