"""Joint interpolation: a straight line in joint space to the target configuration."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pinposture.arm import ArmState
from pinposture.control.controller import Memory, Step, step_within
from pinposture.control.limits import Limits, require_limits
from pinposture.errors import InvalidValue
from pinposture.placement import Target


@dataclass(frozen=True)
class JointInterpolation:
    """Moves all joints along a straight line in joint space to the configuration of the target.

    It arrives exactly, in few steps and without a Jacobian, but ignores the motion of the control points:
    they sweep wide, and the posture error can grow before it falls.
    """

    name: str = "joint"

    def step(
        self, state: ArmState, target: Target, limits: Limits | None = None, memory: Memory | None = None
    ) -> Step:
        """Compute one step; see `Controller.step`.

        Raises:
            InvalidValue: the target has no known configuration.
        """
        if target.q is None:
            allowed = "a target with a known configuration, as `resolve_targets` returns it"
            raise InvalidValue("target.q", None, allowed)
        limits = require_limits(limits)
        target.check(state.arm)
        way = state.arm.difference(state.q, state.arm.nearest_turns(target.q, state.q))
        previous = memory.dq if memory is not None else None
        # Joints off the chain stay.
        limited = limits.apply(state, way * state.arm.moved, previous)
        return step_within(limited, np.flatnonzero(target.has_target).tolist())
