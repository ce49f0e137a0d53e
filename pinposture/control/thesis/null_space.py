"""Objectives for the null space of Selection and Projection (Section 2.2.1), besides the posture error."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pinposture._validation import require_positive
from pinposture.arm import ArmState
from pinposture.collision import CollisionModel, Scene
from pinposture.errors import InvalidValue
from pinposture.placement import Target

Array = NDArray[np.float64]

FINITE_STEP = 1e-5
"""Largest motion of a joint by which Jacobians are differentiated, in `Arm.joint_units`."""

NEAREST = 1e-3
"""Distance from an obstacle below which its potential does not become steeper, as a share of the reach."""


@dataclass(frozen=True)
class JointSpeeds:
    """Away from postures in which the control points can move only if the joints move fast.

    It descends h(q), half the squared norm of the joint displacement that brings all control points to their
    targets, as damped least squares has it, with its damping counted: h = e^T (J J^T + d^2 I)^-1 e / 2. The
    gradient is that by the joints, with the errors e as they are.

    Attributes:
        weight: displacement per gradient; 1 is about as large as the displacement itself.
        damping: d, relative to the length of the arm [1/rad]; singular values far below count little.
    """

    weight: float = 1.0
    damping: float = 0.01

    def __post_init__(self) -> None:
        require_positive("weight", self.weight)
        require_positive("damping", self.damping)

    def __call__(self, state: ArmState, target: Target) -> Array:
        """Return the joint displacement to follow, (nv,) in `Arm.joint_units`."""
        arm = state.arm
        jacobian, errors = _stacked(state, target)
        damped = jacobian @ jacobian.T + (self.damping * arm.length) ** 2 * np.eye(len(errors))
        wanted = np.linalg.solve(damped, errors)
        speeds = jacobian.T @ wanted
        largest = float(np.abs(speeds).max(initial=0.0))
        if largest == 0.0:
            return np.zeros(arm.nv)
        # Second derivatives of positions are symmetric: (dJ/dq_u) v summed over the rows by weights is the
        # derivative of J^T times the weights along v.
        step = FINITE_STEP / largest
        ahead, back = (
            _stacked(arm.at(arm.integrate(state.q, sign * step * speeds * arm.joint_units)), target)[0]
            for sign in (1.0, -1.0)
        )
        gradient = -((ahead - back).T @ wanted) / (2.0 * step)
        return np.asarray(-self.weight * gradient)


def _stacked(state: ArmState, target: Target) -> tuple[Array, Array]:
    """Return the Jacobian of all control points with a target, (r, nv) per unit, and their errors, (r,)."""
    placed, arm = target.has_target, state.arm
    jacobian = state.task_jacobians[placed]  # in `Arm.joint_units`
    errors = (target.points - state.points)[placed] @ arm.plane.T
    return jacobian.reshape(-1, arm.nv), errors.ravel()


@dataclass(frozen=True)
class ObstaclePotential:
    """Away from obstacles, down an artificial potential.

    Each pair of a body and an obstacle that is nearer than `within` adds (within / d - 1)^2 / 2. Below a
    thousandth of `within`, and where they overlap, the slope stays as it is there. A potential does not keep
    a distance: only the default controller does.

    Attributes:
        scene: the obstacles; its margin does not count.
        within: distance at which an obstacle begins to be felt [m].
        weight: displacement per gradient.
        largest: largest displacement of a joint in one step, in `Arm.joint_units`.
    """

    scene: Scene
    within: float
    weight: float = 1e-3
    largest: float = 0.1

    def __post_init__(self) -> None:
        if not isinstance(self.scene, Scene):
            raise InvalidValue("scene", self.scene, "a Scene")
        for name in ("within", "weight", "largest"):
            require_positive(name, getattr(self, name))

    def __call__(self, state: ArmState, target: Target) -> Array:
        """Return the joint displacement to follow, (nv,) in `Arm.joint_units`."""
        arm = state.arm
        near = CollisionModel(arm, self.scene).nearest(state, self.within)
        distances = np.maximum(near.distances, NEAREST * self.within)
        slopes = -(self.within / distances - 1.0) * self.within / distances**2
        motion = -self.weight * (slopes @ near.jacobian) * arm.joint_units * arm.moved
        return np.asarray(motion * min(1.0, self.largest / max(float(np.abs(motion).max()), 1e-300)))
