"""The task of one control point: a position, a pose, or a position and the direction of its link."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from pinposture.arm import ArmState
from pinposture.arm.checks import rigid_placement
from pinposture.arm.ellipsoid import chosen_points
from pinposture.control.checks import is_whole
from pinposture.control.tasks.bearing import bearing
from pinposture.control.tasks.orientation import direction_rows, orientation_rows
from pinposture.control.tasks.task import Described, TaskRows, finite_array, lever
from pinposture.errors import InvalidValue, UnknownName
from pinposture.target import Target

Array = NDArray[np.float64]

HOLDS = ("position", "pose")
"""What `EndEffector.held` can hold."""


@dataclass(frozen=True, eq=False)
class EndEffector(Described):
    """Bring one control point, usually the tip, to a position or a pose, or hold it there.

    A task does not change and remembers nothing. To hold what the tip has when a run begins, make the task
    from that state with `EndEffector.held`. To track something that moves, make a new one for each step, for
    instance with `dataclasses.replace(task, pose=...)`, and a controller that has it.

    What no joint can change is left out: of a planar arm, positions across its plane and turns about other
    axes than that of its joints.

    Attributes:
        position: where the point should be, (3,) [m], world frame; or None if a pose is given.
        pose: where its frame should be, as a `pin.SE3` or a rigid transform (4, 4) from that frame to the
            world, kept as the latter; or None if a position is given.
        point: the control point, by its index, 0-based or from the tip as -1, or by its name.
        weight: weight of the squared error of each row, where that of a control point has weight 1.
        strict: True to come before all else; the rest has the freedom that it leaves.
        axis_only: True to ask of a pose only where the point is and where the link points that ends there
            (`bearing` says which), but not how it is turned about that link.
        length: lever by which turns count [m/rad]; `Arm.sliding_unit` if None.

    Raises:
        InvalidValue: a value other than described.
    """

    position: ArrayLike | None = None
    pose: Any = None
    point: int | str = -1
    weight: float = 1.0
    strict: bool = False
    axis_only: bool = False
    length: float | None = None

    def __post_init__(self) -> None:
        if (self.position is None) == (self.pose is None):
            given = {"position": self.position, "pose": self.pose}
            raise InvalidValue("position and pose", given, "one of them, and None for the other")
        if self.position is not None:
            self._settle("position", finite_array("position", self.position, (3,)))
        else:
            matrix = np.array(rigid_placement("pose", self.pose).homogeneous)
            left, _, right = np.linalg.svd(matrix[:3, :3])
            matrix[:3, :3] = left @ right  # orthonormal to the last digit, however few were given
            self._settle("pose", matrix)
        if not isinstance(self.point, str):
            if not is_whole(self.point):
                raise InvalidValue("point", self.point, "the index or the name of one control point")
            self._settle("point", int(self.point))
        for name in ("strict", "axis_only"):
            if not isinstance(getattr(self, name), bool | np.bool_):
                raise InvalidValue(name, getattr(self, name), "True or False")
            self._settle(name, bool(getattr(self, name)))
        if self.axis_only and self.pose is None:
            raise InvalidValue("axis_only", self.axis_only, "False, or a pose in place of the position")
        self._settle_scales(self.weight, self.length)

    @classmethod
    def held(cls, state: ArmState, hold: str = "pose", point: int | str = -1, **options: Any) -> EndEffector:
        """The task of keeping a control point where it is.

        Args:
            state: the state in which it is where it should stay.
            hold: "position" or "pose".
            point: the control point.
            options: `weight`, `strict`, `axis_only`, `length`.

        Raises:
            UnknownName: something else to hold, or a control point that the arm does not have.
            InvalidValue: as `EndEffector`, or an index that no control point has.
        """
        if not isinstance(state, ArmState):
            raise InvalidValue("state", state, "an ArmState, as `arm.at(q)` returns it")
        if hold not in HOLDS:
            raise UnknownName("thing to hold", hold, HOLDS)
        k = _index(state, point)
        if hold == "position":
            return cls(position=state.points[k], point=point, **options)
        return cls(pose=pin.SE3(state.rotations[k], state.points[k]), point=point, **options)

    def rows(self, state: ArmState, target: Target) -> TaskRows:
        """What the task asks of a step, see `Task.rows`: rows of the position, then those of turns."""
        arm, k = state.arm, _index(state, self.point)
        place = self.position if self.pose is None else self.pose[:3, 3]
        jacobian, apart = arm.plane @ state.jacobians[k], arm.plane @ (place - state.points[k])
        if self.pose is None:
            return TaskRows(jacobian, apart)
        wanted = self.pose[:3, :3]
        if self.axis_only:
            link = wanted @ bearing(arm).links[k]
            turns, angles = direction_rows(state, np.array([k]), link[None])
        else:
            turns, angles = orientation_rows(state, k, wanted)
        arc = lever(arm, self.length)
        return TaskRows(np.vstack([jacobian, arc * turns]), np.concatenate([apart, arc * angles]))


def _index(state: ArmState, point: int | str) -> int:
    try:
        return chosen_points(state.arm.control_points, point)[0]
    except InvalidValue as error:  # there it is called "points"
        raise InvalidValue("point", error.value, error.allowed) from None
