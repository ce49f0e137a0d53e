"""The task of joints: to stay near a configuration as far as all else leaves room."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pinposture.arm import Arm, ArmState
from pinposture.control.tasks.task import Described, TaskRows, finite_array, lever
from pinposture.errors import InvalidValue, UnknownName
from pinposture.target import Target

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class JointPosture(Described):
    """Pull joints towards a configuration, for instance the straight one, as far as all else leaves room.

    Continuous joints go the shorter way round. Joints off the chain are left alone.

    Attributes:
        q: the configuration, (nq,) [rad or m].
        weight: weight of the squared error of each joint, where that of a control point has weight 1. Small,
            so that it settles what control points leave open and hardly moves them.
        joints: names of the joints of the chain that it is for, or a single one; all of them if None.
        length: lever by which `Arm.joint_units` count [m]: one radian or one `Arm.sliding_unit`;
            `Arm.sliding_unit` if None, so that slides count as they are.

    Raises:
        InvalidValue: a value other than described.
    """

    q: ArrayLike
    weight: float = 1e-3
    joints: str | Iterable[str] | None = None
    length: float | None = None

    def __post_init__(self) -> None:
        self._settle("q", finite_array("q", self.q, (None,)))
        if self.joints is not None:
            self._settle("joints", _names(self.joints))
        self._settle_scales(self.weight, self.length)

    @property
    def strict(self) -> bool:
        """False: joints give way to what comes before all else."""
        return False

    def rows(self, state: ArmState, target: Target) -> TaskRows:
        """What the task asks of a step, see `Task.rows`: one row for each joint."""
        arm, columns = state.arm, self._columns(state.arm)
        scale = lever(arm, self.length) / arm.joint_units[columns]
        jacobian = np.zeros((len(columns), arm.nv))
        jacobian[np.arange(len(columns)), columns] = scale
        apart = np.asarray(arm.difference(state.q, arm.checked(self.q)))
        return TaskRows(jacobian, scale * apart[columns])

    def _columns(self, arm: Arm) -> NDArray[np.intp]:
        if self.joints is None:
            return arm.columns
        known = arm.chain.joints
        for name in self.joints:
            if name not in known:
                raise UnknownName("joint", name, known)
        return arm.columns[[known.index(name) for name in self.joints]]


def _names(joints: Any) -> tuple[str, ...]:
    listed = [joints] if isinstance(joints, str) or not isinstance(joints, Iterable) else list(joints)
    if not listed or not all(isinstance(name, str) for name in listed) or len(set(listed)) < len(listed):
        raise InvalidValue("joints", joints, "names of joints, each once, at least one")
    return tuple(listed)
