"""How motions end, in one vocabulary, and whether one may be handed to a robot.

Whatever moves an arm ends with one of these: a run of `track`, a motion in time, a run of a batch, a
simulation. The streaming controller reports "converged" and "stalled" in the same sense, from cycle to cycle.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from pinposture.arm import Arm
from pinposture.errors import MotionError
from pinposture.motion.rates import Excess
from pinposture.scene import Scene

Array = NDArray[np.float64]

ENDINGS: Mapping[str, str] = MappingProxyType(
    {
        "converged": "converged",
        "stalled": "stalled",
        "no_control_points": "found no control point to move",
        "max_steps": "ran out of steps",
        "stopped": "was stopped",
        "missed": "came to its end elsewhere",
        "unstable": "ran away",
        "failed": "failed",
    }
)
"""How a motion can end, with what is said of it.

"converged": the arm is where it was to be. "stalled": no step leads closer. "no_control_points": the
controller found none that it may move. "max_steps": it ran out of steps, or cycles. "stopped": by the user.
"missed": the time of a simulation is over, and the arm is elsewhere. "unstable": the simulated arm ran away.
"failed": an error ended the run.
"""


ROUNDING = 1e-6
"""How deep bodies may be inside each other and still only touch, in arm lengths: distances are rounded."""


class Ended(Protocol):
    """What a motion is judged by; a `Trajectory` and a `Simulation` have it."""

    @property
    def arm(self) -> Arm:
        """The arm."""

    @property
    def status(self) -> str:
        """How it ended, one of `ENDINGS`."""

    @property
    def reason(self) -> str:
        """Why, in words."""

    @property
    def q(self) -> Array:
        """Configurations, (N, nq)."""

    @property
    def scene(self) -> Scene | None:
        """What the arm was to keep clear of."""

    @property
    def clearance(self) -> Array:
        """Smallest distance in each of them, (N,) [m]; negative in penetration, infinite without a scene."""

    @property
    def excess(self) -> Excess | None:
        """How they exceed limits of speed and acceleration; None if they do not, or had none to keep."""


def faults(motion: Ended) -> tuple[str, ...]:
    """Why a motion should not be handed to a robot, in words; empty if nothing speaks against it.

    It did not end where it was to, it exceeds its limits, or it is not clear on the way. This is the one
    place that decides.
    """
    ended = () if motion.status == "converged" else (f"it {ENDINGS[motion.status]}: {motion.reason}",)
    return *ended, *(what for what in _on_the_way(motion) if not (ended and what in motion.reason))


def _on_the_way(motion: Ended) -> tuple[str, ...]:
    """What is wrong with a motion before its end, each as a clause."""
    found = [] if motion.excess is None else [motion.excess.text]
    if motion.scene is not None and motion.clearance.min() < -ROUNDING * motion.arm.length:
        row = int(motion.clearance.argmin())
        pair = " and ".join(motion.scene.around(motion.arm).minimum(motion.q[row]).pair or ())
        when = f"after {row} steps" if row else "at the start"
        found.append(f"{pair} are {-1e3 * motion.clearance[row]:.3g} mm inside each other {when}")
    return tuple(found)


def verdict(motion: Ended) -> str:
    """What to think of a motion, in one line."""
    there = "got there" if motion.status == "converged" else "did not get there"
    but = "".join(f", but {what}" for what in _on_the_way(motion) if what not in motion.reason)
    return f"{there} ({motion.status}){but}: {motion.reason}"


def require_sound(motion: Ended, force: bool) -> None:
    """Refuse to hand on a motion that has `faults`, unless told to.

    Raises:
        MotionError: it has some.
    """
    found = () if force else faults(motion)
    if found:
        raise MotionError(found)


def closest(motion: Ended) -> dict[str, Any] | None:
    """The smallest distance of a motion from what is around it, as data that JSON can hold.

    Returns:
        None without a scene; else "smallest" and "final" [m], the names of the "pair" that comes closest
        (None if there are no two), "after_steps" and the "margin" that was to be kept [m].
    """
    if motion.scene is None:
        return None
    after = int(motion.clearance.argmin())
    least = motion.scene.around(motion.arm).minimum(motion.q[after])
    return {
        "smallest": least.distance,
        "final": float(motion.clearance[-1]),
        "pair": None if least.pair is None else list(least.pair),
        "after_steps": after,
        "margin": motion.scene.margin,
    }
