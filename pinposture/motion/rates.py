"""How fast joints move and how hard they accelerate in a motion, relative to what its limits allow."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pinposture.motion.motion import Motion

Array = NDArray[np.float64]


class Shares(NamedTuple):
    """Speeds and accelerations relative to their limits, the largest of all joints; 1 is at the limit.

    Attributes:
        speeds: in each cycle, (steps,); None if no joint has a limit.
        accelerations: at each row, from and to rest, (steps + 1,); None if no joint has a limit.
    """

    speeds: Array | None
    accelerations: Array | None


def limit_shares(motion: Motion) -> Shares:
    """What share of its limits a motion uses when."""
    limits = motion.run.limits
    bounds = limits.for_arm(motion.arm)
    speeds = _share(motion.velocities, bounds.bound / motion.dt)
    if limits.acceleration is None:
        return Shares(speeds, None)
    most = np.broadcast_to(np.asarray(limits.acceleration, dtype=np.float64), motion.arm.nv)
    return Shares(speeds, _share(motion.accelerations, most))


def _share(values: Array, limits: Array) -> Array | None:
    """The largest share in each row of what joints that have a limit may do, (n,); None if none has."""
    limited = np.isfinite(limits) & (limits > 0.0)
    if not limited.any():
        return None
    return np.asarray((np.abs(values[:, limited]) / limits[limited]).max(axis=1))
