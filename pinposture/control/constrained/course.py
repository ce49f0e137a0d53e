"""Where a controller is on its way."""

from __future__ import annotations

from math import inf, isfinite
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pinposture import kernels
from pinposture.arm import ArmState
from pinposture.control.constrained.pace import Pace
from pinposture.control.constrained.path import JointPath
from pinposture.control.constrained.posture import Posture
from pinposture.control.joint_bounds import JointBounds

Array = NDArray[np.float64]

DISTURBED = 0.05
"""Joint motion by which a measured configuration may differ from the expected one without a new way being
planned, in `Arm.joint_units`."""

PROGRESS = 0.005
"""Share of a path that counts as getting on, for an arm that is hindered."""


class Course(NamedTuple):
    """A way to a goal, and how far the arm has come on it.

    Attributes:
        posture: what is asked of the arm.
        path: the way to the configuration that does it best.
        place: where the arm is on it, in waypoints.
        bounds: the limits that the pace keeps.
        pace: how fast it may go along the path; None where neither acceleration nor time says so.
        speed: how fast it last did, in waypoints per step.
        passed: the place that the arm last passed in good time.
        waited: joint travel that the limits have allowed since then [rad].
        tries: how many ways were tried before this one.
        arrived: whether the path is behind the arm; what errors are left are then reduced directly.
        damping: factor of the damping with which they are.
        hindrance: what the best way that was found comes too close to, in words; empty if it is clear.
        expected: joint positions that the arm should have by now, (nv,) [rad or m]; None before the first
            step.
        bent: by how much the path was bent to end elsewhere since it was planned, (nv,) [rad or m]; None if
            not at all.
        most: the most waypoints to go in one step, on a way that was given together with its time; infinite
            on ways of the controller's own.
        strict_errors: errors of strict tasks at the start and at the goal, 2 x (r,) [m]; between, they are
            to change in proportion to the place.
    """

    posture: Posture
    path: JointPath
    bounds: JointBounds
    place: float = 0.0
    pace: Pace | None = None
    speed: float = 0.0
    passed: float = 0.0
    waited: float = 0.0
    tries: int = 0
    arrived: bool = False
    damping: float = 1.0
    hindrance: str = ""
    expected: Array | None = None
    bent: Array | None = None
    most: float = inf
    strict_errors: tuple[Array, Array] = (np.zeros(0), np.zeros(0))

    @property
    def given(self) -> bool:
        """Whether the way was given, with its time: then it stays while the target moves along it."""
        return isfinite(self.most)

    def gone_to(self, place: float, travel: float, hindered: bool, expected: Array | None = None) -> Course:
        """The course after a step.

        Args:
            place: where the step leads.
            travel: joint travel that the limits allow in it [rad].
            hindered: whether it leads less far than limits, or the pace, would have it; what they allow is
                getting on, however little of the way it is.
            expected: joint positions that the arm should have then, (nv,) [rad or m]; None if unknown.
        """
        waits = hindered and place < self.passed + PROGRESS * self.path.end
        return self._replace(
            place=place,
            speed=place - self.place,
            passed=self.passed if waits else place,
            waited=self.waited + travel if waits else 0.0,
            expected=expected,
        )

    def leads_on(self, state: ArmState) -> bool:
        """Whether the arm is where the course has it, or nearly: else the way begins anew where it is."""
        arm = self.posture.arm
        if arm is not state.arm or self.expected is None:
            return arm is state.arm
        chain = arm.kinematics
        given = self.expected, state.placed.positions, chain.endless, chain.columns, self.bounds.units
        return kernels.joint_distance(*given) <= DISTURBED

    def under_way(self, previous: Array | None) -> Course:
        """The course of an arm that already moves along its way, as far as the step before, (nv,), did."""
        if self.pace is None or previous is None or self.place > 0.0:
            return self
        ahead = self.path.offsets[1] - self.path.offsets[0]
        squares = float(ahead @ ahead)
        speed = max(float(ahead @ previous), 0.0) / squares if squares > 0.0 else 0.0
        speed, bounds = min(speed, self.path.end), self.bounds
        pace = Pace(self.path, bounds.bound, bounds.brake, self.most, speed)
        return self._replace(speed=speed, pace=pace)

    def within(self, bounds: JointBounds) -> Course:
        """The same course with the pace that other limits allow."""
        pace = None
        if bounds.brake is not None or self.given:
            pace = Pace(self.path, bounds.bound, bounds.brake, self.most)
        return self._replace(bounds=bounds, pace=pace)
