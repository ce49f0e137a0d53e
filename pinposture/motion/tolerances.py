"""The tolerances of control loops: when an arm has arrived, rests, and makes no progress."""

from typing import NamedTuple


class ArrivalTolerances(NamedTuple):
    """When an arm has arrived at its target, by one measurement or by an average of many."""

    distance: float = 1e-6
    """Mean distance of the control points from their targets at which the arm has converged, in arm
    lengths. `track` and `perform` take another one, too."""

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

    same_target: float = 1e-9
    """Difference of targets that count as the same, in radians and in arm lengths."""


ARRIVAL = ArrivalTolerances()


class RestTolerances(NamedTuple):
    """When an arm rests, or stands although it is not at its target."""

    step: float = 1e-9
    """Largest step of an arm that counts as at rest, in `Arm.joint_units`."""

    settling: float = 1e-6
    """Largest step of an arm that still settles where it is, in `Arm.joint_units`."""

    standing_drift: float = 0.02
    """Motion of the control points during an average that counts as standing, as a share of their distances
    from the targets: an arm that comes closer faster than that is there within some seconds."""

    standing_time: float = 1.0
    """Time for which an arm that is not at its target stands before it counts as stalled [s]."""


REST = RestTolerances()


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

    steady: float = 1e-4
    """Change of the displacement of an arm that is none, in `Arm.joint_units`, unless noise makes more."""

    two_averages: float = 2.0
    """Ratio of the difference of two averages that noise explains to the deviation of one that it
    explains."""

    other_displacement: float = 5e-3
    """Change of the displacement of an arm at rest that makes another attempt worthwhile, in
    `Arm.joint_units`: more than the noise and the backlash of most drives."""


STALL = StallTolerances()


ERROR_ROUNDING = 1e-12
"""Increase of the posture error that is attributed to rounding, in arm lengths."""

STEP_ROUNDING = 1e-9
"""Relative rounding error of a sum of steps."""

FULL = 1.0 - 1e-6
"""Share of a limit that counts as reached."""

MARGIN_ROUNDING = 1e-3
"""Share of the margin to obstacles whose loss is not reported."""
