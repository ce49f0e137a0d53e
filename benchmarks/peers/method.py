"""What a method has to offer to be timed."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from benchmarks.peers.problem import POSITION, Problem

Array = NDArray[np.float64]

ROUNDING = 1e-5
"""What a solver may exceed a limit by [rad]: DAQP keeps constraints to 1e-6. More is an error."""


class Method:
    """One method, set up once for an arm.

    `aim` says where the points shall be, and `step` is one control step: from measured joint positions to a
    displacement within the limits of speed and position. `begin` comes before the first `aim` of a run.
    """

    whole: ClassVar[bool] = False
    """Whether it solves for the posture in one go (`solve`) and has no steps."""

    packages: ClassVar[tuple[str, ...]] = ()
    """Distributions whose versions are reported."""

    def __init__(self, problem: Problem, option: str) -> None:
        raise NotImplementedError

    def begin(self) -> None:
        """Forget what was; a new run starts."""

    def aim(self, points: Array, q: Array) -> None:
        """Take a target: the points (m, 3) [m], and for who can use it a configuration that reaches them."""
        raise NotImplementedError

    def step(self, q: Array) -> Array:
        """One control step, timed: joint displacement (nv,) [rad] at measured positions q (nv,)."""
        raise NotImplementedError

    def integrate(self, q: Array, dq: Array) -> Array:
        """The configuration after a step, (nv,): all joints turn, so this is a sum."""
        return q + dq

    def solve(self, q: Array) -> tuple[Array, int]:
        """The whole way at once, for a method that does so: configuration and number of evaluations."""
        raise NotImplementedError


def require_limits(problem: Problem, q: Array, dq: Array) -> Array:
    """The check of what goes out to the drives, as whoever drives an arm makes it; NaN fails it too."""
    step, position = np.abs(dq).max(), np.abs(q + dq).max()
    if not (step <= problem.bound + ROUNDING and position <= POSITION + ROUNDING):
        raise ArithmeticError(f"a step of {step} rad, to positions up to {position} rad")
    return dq
