"""Noisy points end at the least-squares optimum."""

from __future__ import annotations

import numpy as np
import pytest
from arms import template_arm
from sampling import seeds
from scipy.optimize import minimize

import pinposture as pp
from pinposture.arm import smooth_configuration
from pinposture.errors import InvalidValue


@pytest.fixture(scope="session")
def arm() -> pp.Arm:
    return template_arm("RyRz", 20)


@pytest.mark.parametrize("seed", seeds(6))
def test_noise_of_two_millimetres_ends_at_the_optimum(arm: pp.Arm, seed: int) -> None:
    rng = np.random.default_rng(seed)
    truth = smooth_configuration(arm, rng, 0.6)
    points = arm.at(truth).points + rng.normal(0.0, 0.002, (20, 3))
    target = pp.fit_points(arm, points)

    def cost(q: np.ndarray) -> tuple[float, np.ndarray]:
        state = arm.at(q)
        offsets = state.points - points
        return 1e6 * float(np.sum(offsets**2)), 2e6 * np.einsum("kd,kdu->u", offsets, state.jacobians)

    # Another method, started from the truth that the fit does not know.
    reference = minimize(cost, truth, jac=True, method="BFGS", options={"gtol": 1e-6}).fun
    assert cost(target.q)[0] <= 1.05 * reference
    np.testing.assert_allclose(target.residual, np.linalg.norm(arm.at(target.q).points - points, axis=1))
    run = pp.track(arm, target, truth, "joint")
    assert 1e6 * np.sum(run.point_errors[-1] ** 2) <= 1.05 * reference


def test_exact_points_are_met_and_free_points_are_free(arm: pp.Arm) -> None:
    rng = np.random.default_rng(9)
    truth = smooth_configuration(arm, rng, 0.5)
    assert pp.fit_points(arm, arm.at(truth).points).residual.max() < 1e-7
    weights = np.ones(20)
    weights[[3, 11]] = 0.0
    moved = arm.at(truth).points.copy()
    moved[[3, 11]] += 0.3
    target = pp.fit_points(arm, moved, weights)
    assert target.residual[weights > 0].max() < 1e-7
    assert target.residual[3] > 0.1


def test_limits_hold_and_coinciding_points_do_no_harm() -> None:
    arm = pp.Arm.from_modules([pp.template("RyRz").with_limits(-0.2, 0.2)] * 6)
    target = pp.fit_points(arm, np.tile([0.1, 0.05, 0.0], (6, 1)))
    assert arm.within_limits(target.q)
    assert np.all(np.isfinite(target.residual))
    with pytest.raises(InvalidValue, match=r"points\[0, 0\]"):
        pp.fit_points(arm, np.full((6, 3), np.nan))
