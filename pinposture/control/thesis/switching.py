"""Selection with Projection as fallback (Section 4.6.2), for planar and spatial arms."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Literal, NamedTuple, cast, get_args

import numpy as np
from numpy.typing import NDArray

from pinposture._validation import require_instance, require_known, require_positive, require_share
from pinposture.arm import ArmState
from pinposture.control.controller import (
    LazyInfo,
    Memory,
    Step,
    checked_limits,
    step_within,
    task_errors,
)
from pinposture.control.limits import Limits
from pinposture.control.thesis.projection import Projection
from pinposture.control.thesis.selection import Selection
from pinposture.placement import Target
from pinposture.units import ROUNDING

Array = NDArray[np.float64]


class SwitchingPhase(NamedTuple):
    """State of a switching controller between two steps.

    Attributes:
        method: the active method, "selection" or "projection".
        best: posture error relative to which the progress of Selection is measured [m].
        waited: joint travel since its last progress [rad].
        left: remaining joint travel of the stint of Projection [rad].
        failovers: number of failovers so far.
    """

    method: str = "selection"
    best: float = np.inf
    waited: float = 0.0
    left: float = 0.0
    failovers: int = 0


@dataclass(frozen=True, eq=False)
class SwitchingMemory(Memory):
    """The memory of `Switching`, which includes its phase."""

    phase: SwitchingPhase = field(default_factory=SwitchingPhase)


HandBack = Literal["after_stay", "when_possible"]
"""When Selection takes over again; see `Switching`."""


@dataclass(frozen=True)
class Switching:
    """Selection while it has control points and reduces the posture error, else Projection for a stint.

    The first failover is that of Figure 4.8: some steps of Projection towards the target. It frees an arm
    that Selection cannot move, but not one that folds up on the straight path to the target, where Selection
    would lead back to the same posture. From the second failover on, Projection therefore aims at a waypoint:
    the posture a short distance ahead on the straight line in joint space to the configuration of the target,
    if known (`Target.q`; `fit_points` finds it for measured points). Each of these stints is twice as long as
    the previous one, so that the methods cannot alternate forever; if Selection has no control points after
    one, the next begins at once. If Projection cannot move any point either, the joints follow that line
    directly.

    Durations are measured in the joint travel that the limits allow, independent of the cycle time.

    Attributes:
        selection: the primary method.
        projection: the fallback method.
        patience: joint travel that Selection may use without progress [rad].
        progress: share by which the posture error must decrease in that time.
        stay: length of the first stint of Projection [rad].
        reach: distance to a waypoint: largest joint motion [rad or `Arm.characteristic_length`].
        hand_back: when Selection takes over again: "after_stay", at the end of a stint; or "when_possible",
            as soon as it has control points and its step lowers the posture error at the rate of
            `progress` per `patience`, at the latest at the end of the stint.
    """

    selection: Selection = field(default_factory=Selection)
    projection: Projection = field(default_factory=Projection)
    patience: float = 0.5
    progress: float = 0.1
    stay: float = 0.5
    reach: float = 0.1
    name: str = "switching"
    hand_back: HandBack = "after_stay"

    def __post_init__(self) -> None:
        for field_, kind in (("selection", Selection), ("projection", Projection)):
            require_instance(field_, getattr(self, field_), kind, f"a {kind.__name__}(...)")
        require_share("progress", self.progress)
        for field_ in ("patience", "stay", "reach"):
            require_positive(field_, getattr(self, field_))
        require_known("hand_back", self.hand_back, get_args(HandBack))

    @classmethod
    def as_printed(cls, planar: bool = False) -> Switching:
        """Return the method of Section 4.6.2: both methods as printed; Selection takes over when it can."""
        methods = Selection.as_printed(planar), Projection.as_printed(planar)
        return cls(*methods, hand_back="when_possible")

    def step(
        self, state: ArmState, target: Target, limits: Limits | None = None, memory: Memory | None = None
    ) -> Step:
        """Compute one step; see `Controller.step`. Its info names the method, and why it was chosen."""
        limits = checked_limits(state, target, limits, memory)
        error = float(np.linalg.norm(task_errors(state, target), axis=1).sum())
        travel = limits.travel(state)
        phase = memory.phase if isinstance(memory, SwitchingMemory) else SwitchingPhase()
        idle = phase.method == "projection"
        if idle and phase.left > ROUNDING * travel:
            if self.hand_back == "when_possible":
                resumed = self.selection.step(state, target, limits, memory)
                if not resumed.reason and self._promises(resumed, state, target, error, travel):
                    entered = phase._replace(method="selection", best=error, waited=0.0)
                    return _labelled(resumed, entered, "Selection can lower the posture error again")
            return self._project(state, target, limits, memory, phase, travel, "")
        if idle or error < phase.best * (1.0 - self.progress):
            entered = phase._replace(method="selection", best=error, waited=0.0)
        else:
            entered = phase._replace(waited=phase.waited + travel)
        if entered.waited >= self.patience - ROUNDING * travel:
            why = f"the posture error did not fall by {100 * self.progress:g} % in {entered.waited:.3g} rad"
            failed = self._failover(entered, target)
            return self._project(state, target, limits, memory, failed, travel, why)
        step = self.selection.step(state, target, limits, memory)
        if not step.reason:
            over = "the stint of Projection is over, and Selection has control points"
            return _labelled(step, entered, over if idle else "")
        if idle and target.q is None:  # Selection cannot take over yet
            return self._project(state, target, limits, memory, phase, travel, "")
        failed = self._failover(entered, target)
        why = "" if idle else step.reason
        return self._project(state, target, limits, memory, failed, travel, why)

    def _promises(self, step: Step, state: ArmState, target: Target, error: float, travel: float) -> bool:
        """Whether a step lowers the posture error as fast as Selection must to stay active."""
        ahead = state.moved(step.dq)
        left = float(np.linalg.norm(task_errors(ahead, target), axis=1).sum())
        return left < error * (1.0 - self.progress * min(travel / self.patience, 1.0))

    def _failover(self, phase: SwitchingPhase, target: Target) -> SwitchingPhase:
        """Switch to Projection, for twice as long as the last time if the target has a configuration."""
        stint = self.stay * 2.0 ** (min(phase.failovers, 60) if target.q is not None else 0)
        return phase._replace(method="projection", left=stint, failovers=phase.failovers + 1)

    def _project(
        self,
        state: ArmState,
        target: Target,
        limits: Limits,
        memory: Memory | None,
        phase: SwitchingPhase,
        travel: float,
        why: str,
    ) -> Step:
        phase = phase._replace(left=phase.left - travel)
        goal = target.q
        if goal is None or phase.failovers < 2:
            step = self.projection.step(state, target, limits, memory)
            if not step.reason:
                return _labelled(step, phase, why)
            if goal is None:
                return self._last_resort(state, target, limits, memory, phase, step, why)
            phase = phase._replace(failovers=2)
        goal = state.arm.nearest_turns(goal, state.q)
        return _labelled(self._escape(state, target, goal, limits, memory), phase, why)

    def _last_resort(
        self,
        state: ArmState,
        target: Target,
        limits: Limits,
        memory: Memory | None,
        phase: SwitchingPhase,
        held: Step,
        why: str,
    ) -> Step:
        """Use Selection if Projection cannot move and no configuration is known; else hold."""
        step = self.selection.step(state, target, limits, memory)
        if step.reason:
            return _labelled(held, phase, why)
        # With a reason to fail over, Selection was active and stays so: the method does not change.
        changed = "" if why else held.reason
        return _labelled(step, SwitchingPhase(failovers=phase.failovers), changed)

    def _escape(
        self, state: ArmState, target: Target, goal: Array, limits: Limits, memory: Memory | None
    ) -> Step:
        """Return a step of Projection to the posture a short distance ahead on the line in joint space.

        In the null space the joints follow that line too, for instance those before a region.
        """
        arm = state.arm
        way = np.array(arm.difference(state.q, goal)) * arm.moved
        farthest = float(np.max(np.abs(way) / arm.joint_units, initial=0.0))
        ahead = way * min(1.0, self.reach / max(farthest, 1e-300))
        waypoint = replace(target, points=state.moved(ahead).points)
        step = self.projection.step_with(ahead / arm.joint_units, state, waypoint, limits, memory)
        if step.reason:  # no control point can move: follow the line in joint space
            limited = limits.apply(state, ahead, memory.dq if memory is not None else None)
            step = step_within(limited)
        return step._replace(error_increasing=True, following_path=True)


def _labelled(step: Step, phase: SwitchingPhase, switched: str) -> Step:
    info = cast(LazyInfo, step.info) | {"method": phase.method, "switched": switched}
    return step._replace(info=info, memory=SwitchingMemory(step.dq, phase=phase))
