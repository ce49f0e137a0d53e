"""How joints turn control points, against finite differences of their orientation."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

import pinposture as pp

PLACEMENT = pin.SE3(pin.rpy.rpyToMatrix(0.3, -1.1, 2.0), np.array([0.4, -2.0, 0.7]))
MIXED = pp.ModuleTemplate(
    "mixed",
    (
        pp.JointSpec((1.0, 1.0, 0.3)),
        pp.JointSpec("z", type="continuous"),
        pp.JointSpec("x", type="prismatic", lower=0.0, upper=0.05),
    ),
    (0.02, 0.03, 0.04),
)
ARMS = {
    "spatial": lambda: pp.Arm.from_template("RyRz", 5, base_placement=PLACEMENT),
    "planar": lambda: pp.Arm.from_template("Rz", 7, base_placement=PLACEMENT),
    "mixed": lambda: pp.Arm.from_modules([MIXED] * 3, base_placement=PLACEMENT),
    "one joint": lambda: pp.Arm.from_template("Rz", 1),
    "off the chain": lambda: pp.Arm.from_model(
        pin.buildSampleModelManipulator(), ["elbow_body", "wrist1_body"]
    ),
}


def turns(arm: pp.Arm, q: np.ndarray, h: float = 1e-6) -> np.ndarray:
    """Rotation vectors of the control points per unit of joint motion, (m, 3, nv)."""
    found = np.zeros((arm.n_modules, 3, arm.nv))
    for u, step in enumerate(h * np.eye(arm.nv)):
        ahead, behind = (arm.at(arm.integrate(q, sign * step)).rotations for sign in (1.0, -1.0))
        change = ahead @ behind.transpose(0, 2, 1)
        skew = (change - change.transpose(0, 2, 1)) / (4.0 * h)
        found[:, :, u] = np.stack([skew[:, 2, 1], skew[:, 0, 2], skew[:, 1, 0]], axis=1)
    return found


@pytest.mark.parametrize("name", ARMS)
def test_angular_jacobians_equal_finite_differences(name: str) -> None:
    arm = ARMS[name]()
    configurations = [arm.neutral(), *(arm.random(np.random.default_rng(seed)) for seed in range(4))]
    for q in configurations:
        state = arm.at(q)
        assert state.angular_jacobians.shape == state.jacobians.shape
        np.testing.assert_allclose(state.angular_jacobians, turns(arm, q), atol=1e-8)


@pytest.mark.parametrize("name", ARMS)
def test_axes_are_those_of_the_joints(name: str) -> None:
    arm = ARMS[name]()
    state = arm.at(arm.neutral())
    expected = np.where(arm.chain.revolute[:, None], arm.chain.axes, 0.0).T
    np.testing.assert_allclose(state.axes[:, arm.columns], expected, atol=1e-12)


def test_they_are_kept_when_the_arm_moves_on_and_cannot_be_changed() -> None:
    arm = ARMS["spatial"]()
    rng = np.random.default_rng(0)
    state = arm.at(arm.random(rng))
    axes = state.axes.copy()
    other = arm.at(arm.random(rng))
    assert not np.allclose(other.axes, axes)
    np.testing.assert_array_equal(state.axes, axes)
    np.testing.assert_array_equal(state.angular_jacobians[-1], axes)
    for array in (state.axes, state.angular_jacobians):
        with pytest.raises(ValueError, match="read-only"):
            array[...] = 0.0
