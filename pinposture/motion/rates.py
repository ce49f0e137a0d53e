"""How fast joints move and how hard they accelerate in a motion, relative to what its limits allow.

All of it is read off the configurations that the motion leads through, whatever moved the arm.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from pinposture.motion.trajectory import Trajectory

Array = NDArray[np.float64]

ALLOWED = 1e-9
"""Share of a limit by which it may be exceeded: rounding."""

RESOLUTION = 8.0 * float(np.finfo(np.float64).eps)
"""What a difference of joint positions is off by, relative to them."""


class Shares(NamedTuple):
    """Speeds and accelerations relative to their limits, the largest of all joints; 1 is at the limit.

    Attributes:
        speeds: in each step, (steps,); None if no joint has a limit.
        accelerations: at each row, from and to rest, (steps + 1,); None if no joint has a limit.
    """

    speeds: Array | None
    accelerations: Array | None


class Excess(NamedTuple):
    """How a motion exceeds its limits of speed and acceleration.

    Attributes:
        steps: the steps in which it does, counted from 0. Stopping at the end belongs to the last.
        words: what is exceeded most in each of them, and how many times it is the limit.
        worst: the step in which that is most.
        ratio: how many times the limit it is there.
        text: that in words.
    """

    steps: tuple[int, ...]
    words: tuple[str, ...]
    worst: int
    ratio: float
    text: str


def limit_shares(run: Trajectory) -> Shares:
    """What share of its limits a run uses when."""
    speeds, accelerations = _joint_shares(run)
    bounds = run.limits.for_arm(run.arm)
    limited = bool(np.any(np.isfinite(bounds.bound)))
    return Shares(
        speeds.max(axis=1) if limited else None,
        None if bounds.brake is None else accelerations.max(axis=1),
    )


def find_excess(run: Trajectory) -> Excess | None:
    """Where a run exceeds its limits of speed and acceleration, from and to rest; None if nowhere."""
    if not run.steps:
        return None
    bounds = run.limits.for_arm(run.arm)
    speeds, accelerations = _joint_shares(run)
    accelerations[-2] = np.maximum(accelerations[-2], accelerations[-1])
    brake = np.inf if bounds.brake is None else bounds.brake
    lost = RESOLUTION * (1.0 + np.abs([run.arm.positions(q) for q in run.q[[0, -1]]]).max(axis=0))
    over = np.stack([speeds - lost / bounds.bound, accelerations[:-1] - 2.0 * lost / brake])
    steps = np.flatnonzero(over.max(axis=(0, 2)) > 1.0 + ALLOWED)
    if not len(steps):
        return None
    words, ratios = [], []
    for step in steps:
        kind, joint = np.unravel_index(int(over[:, step].argmax()), over[:, step].shape)
        ratios.append(float((speeds[step], accelerations[step])[kind][joint]))
        limit = f"{('speed', 'acceleration')[kind]} limit of joint {run.arm.joint_names[joint]!r}"
        words.append(f"{limit}: {ratios[-1]:.4g} times as much")
    most = int(np.argmax(ratios))
    number, worst = len(steps), int(steps[most])
    count = f"{number} step" + ("s" if number > 1 else "")
    text = f"limits are exceeded in {count}, most in step {worst + 1} (of {run.steps}): {words[most]}"
    return Excess(tuple(int(step) for step in steps), tuple(words), worst, ratios[most], text)


def _joint_shares(run: Trajectory) -> tuple[Array, Array]:
    """Speeds (steps, nv) and accelerations (steps + 1, nv) of joints, relative to their limits; 0 without."""
    arm, bounds = run.arm, run.limits.for_arm(run.arm)
    moved = [arm.difference(a, b) for a, b in zip(run.q[:-1], run.q[1:], strict=True)]
    steps = np.reshape(moved, (run.steps, arm.nv))
    changes = np.diff(np.pad(steps, ((1, 1), (0, 0))), axis=0)
    brake = np.inf if bounds.brake is None else bounds.brake
    return np.abs(steps) / bounds.bound, np.abs(changes) / brake
