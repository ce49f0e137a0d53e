"""Null-space objectives for Selection and Projection besides the posture error (Section 2.2.1)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pinposture._validation import require_instance, require_positive
from pinposture.arm import ArmState
from pinposture.collision import CollisionModel, Scene
from pinposture.placement import Target

Array = NDArray[np.float64]


@dataclass(frozen=True)
class JointSpeeds:
    """Avoids postures in which control points can move only if joints move fast.

    It descends h = e^T (J J^T + d^2 I)^-1 e / 2, half the squared norm of the damped least-squares step to
    the targets, damping included. The gradient is taken with the errors e held constant.

    Attributes:
        weight: displacement per gradient; with 1 it is about as large as the least-squares step.
        damping: d, relative to the arm length [1/rad]; singular values far below it have little effect.
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
        # Second derivatives of positions are symmetric: the weighted sum over rows of (dJ/dq_u) v is the
        # derivative of J^T times the weights along v.
        step = 1e-5 / largest  # of finite differences, in `Arm.joint_units`
        ahead, back = (
            _stacked(arm.at(arm.integrate(state.q, sign * step * speeds * arm.joint_units)), target)[0]
            for sign in (1.0, -1.0)
        )
        gradient = -((ahead - back).T @ wanted) / (2.0 * step)
        return np.asarray(-self.weight * gradient)


def _stacked(state: ArmState, target: Target) -> tuple[Array, Array]:
    """Return the Jacobian of all control points with a target, (r, nv) per unit, and their errors, (r,)."""
    placed = target.has_target
    arm = state.arm
    jacobian = state.task_jacobians[placed]  # in `Arm.joint_units`
    errors = target.errors(state.points)[placed] @ arm.plane.T
    return jacobian.reshape(-1, arm.nv), errors.ravel()


@dataclass(frozen=True)
class ObstaclePotential:
    """Moves away from obstacles, down an artificial potential.

    Each body and obstacle at a distance d below `within` adds (within / d - 1)^2 / 2. Below a thousandth of
    `within`, and in collision, the slope is constant. A potential does not guarantee a clearance; the default
    controller does.

    Attributes:
        scene: the obstacles; its margin is ignored.
        within: distance below which an obstacle repels [m].
        weight: displacement per gradient.
        largest: largest displacement of a joint in one step, in `Arm.joint_units`.
    """

    scene: Scene
    within: float
    weight: float = 1e-3
    largest: float = 0.1

    def __post_init__(self) -> None:
        require_instance("scene", self.scene, Scene, "a Scene")
        for name in ("within", "weight", "largest"):
            require_positive(name, getattr(self, name))

    def __call__(self, state: ArmState, target: Target) -> Array:
        """Return the joint displacement to follow, (nv,) in `Arm.joint_units`."""
        arm = state.arm
        near = CollisionModel(arm, self.scene).nearest(state, self.within)
        # Nearer than this, the slope of the potential is constant.
        distances = np.maximum(near.distances, 1e-3 * self.within)
        slopes = -(self.within / distances - 1.0) * self.within / distances**2
        motion = -self.weight * (slopes @ near.jacobian) * arm.joint_units * arm.moved
        return np.asarray(motion * min(1.0, self.largest / max(float(np.abs(motion).max()), 1e-300)))
