"""What an arm can still do with a joint that fails, and the way out: found in another process."""

from __future__ import annotations

import time
from collections.abc import Mapping
from threading import Event
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pinposture.arm import Arm
from pinposture.collision import Scene
from pinposture.control import Limits, plan, retime
from pinposture.control.limits import cycle_of
from pinposture.errors import PostureError
from pinposture.motion import JointTrajectory
from pinposture.motion.latest import Outdated
from pinposture.motion.processes import BackgroundProcess, Interrupted
from pinposture.placement import Target
from pinposture.task import can_retreat
from pinposture.task.falling import Fallen
from pinposture.units import length_text

Array = NDArray[np.float64]

POLLING = 0.05
"""Time between two looks whether an answer is there, or outdated [s]."""


class Locked(NamedTuple):
    """An arm with joints that do not move, and what it is to do.

    Attributes:
        whole: the arm whose joints all move.
        arm: the arm with its locked joints.
        positions: positions of the joints that do not, by name [rad or m].
        q: the configuration, (nq,).
        target: its target; None if it has none.
        scene: what it keeps clear of.
        limits: its limits.
        way_in: configurations by which it came, from outside, (n, nq).
        leave: whether it is to come out.
        fallen: a joint that has fallen; None if none has.
    """

    whole: Arm
    arm: Arm
    positions: Mapping[str, float]
    q: Array
    target: Target | None
    scene: Scene
    limits: Limits
    way_in: Array
    leave: bool
    fallen: Fallen | None = None


class Fallback(NamedTuple):
    """What an arm with joints that fail can still do.

    Attributes:
        error: mean distance of its control points from the target where it comes closest [m]; None without a
            target, or if it is to come out.
        way_out: the motion to where it came from; None if there is none.
        reason: why there is none; empty if there is.
    """

    error: float | None
    way_out: JointTrajectory | None
    reason: str

    def __str__(self) -> str:
        reached = "" if self.error is None else f"the target is reached to {length_text(self.error)}; "
        if self.way_out is None:
            return f"{reached}no way out was found: {self.reason}"
        return f"{reached}a way out of {self.way_out.time[-1]:.3g} s"


def as_possible(arm: Arm, target: Target) -> Target:
    """Return a target that an arm with locked joints takes as nearly as it can: its points alone."""
    return Target.from_points(arm, target.points, target.weights)


def find_fallback(locked: Locked) -> Fallback:
    """Find what an arm with joints that fail can still do; takes seconds."""
    error = None
    arm = locked.arm
    fallen = locked.fallen
    if locked.target is not None and not locked.leave and fallen is None:
        target = as_possible(arm, locked.target)
        # Where the target is out of reach, all of this time is taken.
        path = plan(arm.at(locked.q), target, locked.scene, locked.limits, budget=5.0)
        error = target.mean_distance(arm.chain_at(path.configuration(path.end)).points)
    before = arm
    torque = None
    if fallen is None:
        *others, joint = locked.positions
        held = {name: locked.positions[name] for name in others}
        before = locked.whole.with_locked(held) if others else locked.whole
    else:
        joint = fallen.joint
        torque = fallen.torque
    rows = np.vstack([locked.way_in, locked.q])
    try:
        (way,) = can_retreat(
            before,
            rows,
            locked.scene,
            joint,
            torque=torque,
            postures=[len(rows) - 1],
            limits=locked.limits,
            # In 50 draws of `benchmarks/studies/retreat.py` ways that were found took 17 s at most.
            budget=30.0,
        ).ways
    except PostureError as refused:
        return Fallback(error, None, str(refused))
    if way.path is None:
        return Fallback(error, None, way.reason)
    timed = retime(way.path, locked.limits)
    # A joint that hangs swings if the arm is fast; one that is weak has little torque left for accelerations.
    slower = 1.0 if fallen is None else 4.0
    dt = slower * cycle_of(locked.limits)
    return Fallback(error, JointTrajectory.from_configurations(arm, timed.configurations, dt), "")


class FallbackSearch:
    """Finds fallbacks in another process, which starts with the first one and takes seconds to."""

    def __init__(self) -> None:
        self._process: BackgroundProcess | None = None

    def find(self, locked: Locked, outdated: Event) -> Fallback:
        """Return a fallback.

        Args:
            locked: the arm.
            outdated: set if it is not wanted any more.

        Raises:
            Outdated: it is not wanted any more.
            PostureError: as `plan`, or the process was ended from outside.
        """
        if self._process is None:
            self._process = BackgroundProcess()
        process = self._process
        process.submit(find_fallback, locked)
        while not process.done():
            if outdated.is_set():
                process.interrupt()
            time.sleep(POLLING)
        try:
            fallback: Fallback = process.result()
        except Interrupted as ended:
            raise Outdated from ended
        except EOFError as ended:
            raise PostureError("the process that looked for it was ended from outside") from ended
        return fallback
