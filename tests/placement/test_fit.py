"""Least-squares placement against sequential placement and an independent multi-start fit."""

from __future__ import annotations

from contextlib import nullcontext

import numpy as np
import pinocchio as pin
import pytest
from arms import template_arm
from sampling import seeds
from scipy.optimize import least_squares, minimize

import pinposture as pp
from pinposture.arm import smooth_configuration
from pinposture.curve import HELIX
from pinposture.errors import CurveBendsTooMuch, CurveEndsEarly, InvalidValue, PostureWarning
from pinposture.placement.least_squares import FitProblem, fit_curve

PLACEMENT = pin.SE3(pin.rpy.rpyToMatrix(0.3, -1.1, 2.0), np.array([0.4, -2.0, 0.7]))
J = pp.JointSpec
AWKWARD = {
    "tilted axes": pp.ModuleTemplate("tilted", (J((0.2, 1.0, 0.1)), J((-0.1, 0.3, 1.0))), (0.03, 0.03)),
    "roll and bend": pp.ModuleTemplate("roll", (J("x"), J("y")), (0.0, 0.06)),
    "three hinges": pp.ModuleTemplate("three", (J("y"), J("z"), J("y")), (0.02, 0.02, 0.02)),
    "sliding": pp.ModuleTemplate(
        "slide", (J("y"), J("z"), J("x", "prismatic", 0.0, 0.02)), (0.02, 0.02, 0.02)
    ),
    "narrow": pp.ModuleTemplate(
        "narrow", (J("y", lower=-0.25, upper=0.3), J("z", lower=-0.2, upper=0.25)), (0.03, 0.03)
    ),
    "continuous": pp.ModuleTemplate("endless", (J("y", "continuous"), J("z", "continuous")), (0.03, 0.03)),
}


def gentle(arm: pp.Arm) -> pp.Curve:
    points = np.array(
        [(0, 0, 0), (0.25, 0, 0), (0.5, 0.05, 0.04), (0.75, 0.15, 0.05), (1, 0.2, 0), (1.3, 0.2, -0.1)]
    )
    return pp.Curve.spline(arm.length * points)


def independent(arm: pp.Arm, curve: pp.Curve, starts: int = 4) -> float:
    """RMS distance of the best of several bounded fits with free, unordered curve parameters."""
    rng = np.random.default_rng(0)
    n = arm.nv
    m = arm.n_modules
    low = np.where(np.isfinite(arm.limits.lower), arm.limits.lower, -np.pi)
    high = np.where(np.isfinite(arm.limits.upper), arm.limits.upper, np.pi)

    def distances(z: np.ndarray) -> np.ndarray:
        return (arm.at(arm.configuration(z[:n])).points - curve.at(z[n:])).ravel()

    along = np.linspace(0, 1, m + 1)[1:] * min(arm.length, 0.99 * curve.length)
    bounds = (np.r_[low, np.zeros(m)], np.r_[high, np.full(m, curve.length)])
    costs = []
    for k in range(starts):
        q = np.clip(0.2 * (k > 0) * rng.normal(size=n), low + 1e-6, high - 1e-6)
        costs.append(least_squares(distances, np.r_[q, along], bounds=bounds, xtol=1e-12, ftol=1e-12).cost)
    return float(np.sqrt(2 * min(costs) / m))


@pytest.mark.parametrize("kind", AWKWARD)
def test_awkward_modules_come_as_close_as_an_independent_fit(kind: str) -> None:
    arm = pp.Arm.from_modules([AWKWARD[kind]] * 5, base_placement=PLACEMENT)
    target = pp.resolve_targets(arm, gentle(arm), placement="align", method="closest")
    assert set(target.placed_by) == {"least squares"}
    assert target.fallback == ""  # it was asked for
    rms = np.sqrt(np.mean(target.curve.nearest(target.points)[1] ** 2))
    assert rms <= 1.05 * independent(arm, target.curve) + 1e-6 * arm.length
    assert arm.within_limits(target.q)
    assert np.all(np.diff(target.parameters) > 0)
    np.testing.assert_allclose(arm.at(target.q).points, target.points, atol=1e-12)


@pytest.mark.parametrize("turns", [1.5, 2.0])
def test_a_fit_to_a_coil_that_the_arm_cannot_follow_ends_in_a_minimum(turns: float) -> None:
    """SciPy goes on from where the fit ends."""
    arm = pp.Arm.from_modules([pp.template("RyRz").with_limits(-0.8, 0.7)] * 6)
    along = np.linspace(0.0, 1.0, 40)
    angle = 2.0 * np.pi * turns * along
    radius = 1.15 * arm.length / (2.0 * np.pi * turns)
    bow = np.column_stack([np.sin(angle), 1.0 - np.cos(angle)])
    coil = pp.Curve.points(np.column_stack([radius * bow, 0.3 * arm.length * along]))
    problem = FitProblem(arm, 0.0, 1e-9)
    fitted = problem.joined(*fit_curve(arm, coil, 0.0, bending=1e-9))
    bounds = (problem.lower, problem.upper)
    inside = np.clip(fitted, problem.lower + 1e-9, problem.upper - 1e-9)
    further = least_squares(
        lambda x: problem.evaluate(coil, x)[0],
        inside,
        jac=lambda x: problem.evaluate(coil, x)[1],
        bounds=bounds,
        xtol=1e-12,
        ftol=1e-12,
    )
    assert problem.distance(coil, further.x) >= 0.999 * problem.distance(coil, fitted)


@pytest.mark.parametrize("template", ["RyRz", "RzRy"])
def test_closest_agrees_with_algorithm_1_where_that_is_exact(template: str) -> None:
    arm = pp.Arm.from_template(template, 20, base_placement=PLACEMENT)
    in_turn = pp.resolve_targets(arm, HELIX, placement="align", roll=0.7, samples=20_000, method="sequential")
    closest = pp.resolve_targets(arm, HELIX, placement="align", roll=0.7, method="closest")
    assert closest.residual.max() < 1e-12
    np.testing.assert_allclose(closest.q, in_turn.q, atol=1e-5)
    np.testing.assert_allclose(closest.parameters, in_turn.parameters, atol=1e-6)


@pytest.mark.long
def test_a_curve_that_leaves_at_an_angle_is_taken_without_zigzag() -> None:
    arm = pp.Arm.from_template("RyRz", 20)
    zigzag = pp.resolve_targets(arm, HELIX, placement="translate", method="sequential")
    smooth = pp.resolve_targets(arm, HELIX, placement="translate")
    assert smooth.method == "smooth"
    # Sequential placement spends the arm on bends; smooth placement bends as the helix does after the start.
    assert np.abs(zigzag.q[10:]).max() > 2.0
    assert np.abs(smooth.q[20:]).max() < 1.2
    assert smooth.parameters[-1] > 1.8 * zigzag.parameters[-1]
    assert smooth.residual.max() < 0.003


@pytest.mark.parametrize("turns", [0.4, 1.4, 2.4])
def test_the_way_round_is_that_of_the_curve_beyond_half_a_turn(turns: float) -> None:
    arm = pp.Arm.from_template("Rz", 30)
    angle = np.linspace(0.0, 2 * np.pi * turns, 400)
    radius = 6.0 / angle[-1] * (1.0 - 0.02 * angle)
    spiral = pp.Curve.points(np.column_stack([radius * np.sin(angle), radius[0] - radius * np.cos(angle)]))
    target = pp.resolve_targets(arm, spiral, method="closest")
    heading = float(np.sum(target.q))
    covered = np.interp(target.parameters[-1], np.linspace(0, spiral.length, 400), angle)
    assert heading == pytest.approx(covered, abs=0.8)
    assert np.abs(target.q).max() < 1.5


def test_noise_on_the_curve_is_met_within_reason() -> None:
    rng = np.random.default_rng(2)
    arm = pp.Arm.from_template("RyRz", 20)
    clean = pp.Curve.spline([(0, 0, 0), (0.3, 0, 0), (0.6, 0.1, 0.1), (0.9, 0.3, 0.1), (1.2, 0.3, 0)])
    noisy = pp.Curve.points(clean.resample(25) + rng.normal(0.0, 0.002, (25, 3)))
    target = pp.resolve_targets(arm, noisy)
    assert np.sqrt(np.mean(target.residual**2)) < 0.002
    assert np.abs(target.q).max() < 1.0


@pytest.mark.long
def test_harsh_curves_within_narrow_limits_give_a_target_or_a_reason() -> None:
    rng = np.random.default_rng(0)
    arm = pp.Arm.from_modules([pp.template("RyRz").with_limits(-0.9, 0.9)] * 10)
    outcomes = set()
    for _ in range(8):
        curve = pp.Curve.spline(np.vstack([np.zeros(3), rng.uniform(-0.3, 0.3, (6, 3))]))
        target = pp.resolve_targets(arm, curve, incomplete="partial")
        outcomes.add((target.method, target.incomplete == ""))
        assert np.all(np.isfinite(target.points)) and np.all(np.isfinite(target.q))
        assert np.all(target.residual[target.has_target] < 0.1 * 0.05)
        assert bool(target.incomplete) == (not target.has_target.all())
    assert len(outcomes) > 1


def test_a_joint_without_room_and_a_base_behind_the_curve_are_no_accident() -> None:
    model = pp.Arm.from_template("RyRz", 6).model.copy()
    model.lowerPositionLimit[4] = model.upperPositionLimit[4] = 0.1
    arm = pp.Arm.from_model(model, [f"module_{k:02d}" for k in range(1, 7)])
    curve = gentle(arm)
    for target in (
        pp.resolve_targets(arm, curve, method="closest", incomplete="partial"),
        pp.fit_points(arm, curve.resample(7)[1:]),
        pp.resolve_targets(
            arm,
            pp.Curve.line((-2, 0, 0), (-1, 0, 0)),
            placement="as_is",
            method="smooth",
            incomplete="partial",
        ),
    ):
        assert arm.within_limits(target.q)
        assert arm.positions(target.q)[4] == pytest.approx(0.1, abs=1e-9)
        assert np.all(np.isfinite(target.points))
        assert np.all(np.isfinite(target.residual))


@pytest.mark.long
def test_failures_are_named() -> None:
    arm = pp.Arm.from_modules([AWKWARD["three hinges"]] * 5)
    with pytest.raises(CurveEndsEarly, match=r"module 4.*lengthen"):
        pp.resolve_targets(arm, pp.Curve.line((0, 0, 0), (0.2, 0, 0)))
    tight = pp.Arm.from_modules([AWKWARD["narrow"]] * 5)
    with pytest.raises(CurveBendsTooMuch, match="its end stays at least"):
        pp.resolve_targets(tight, HELIX, placement="align", method="closest")
    partial = pp.resolve_targets(arm, pp.Curve.line((0, 0, 0), (0.2, 0, 0)), incomplete="partial")
    assert partial.has_target.tolist() == [True, True, True, False, False]
    assert np.all(np.isfinite(partial.points))


def test_large_and_small_arms_resolve_alike() -> None:
    results = []
    for scale in (1e-3, 1.0, 1e3):
        modules = [
            pp.ModuleTemplate("s", (J("y"), J("x"), J("z")), (0.02 * scale,) * 3, radius=0.005 * scale)
        ] * 5
        with pytest.warns(PostureWarning, match="millimetres") if scale > 1.0 else nullcontext():
            arm = pp.Arm.from_modules(modules)
        target = pp.resolve_targets(arm, gentle(arm))
        results.append((target.q, target.parameters / scale))
    for q, parameters in results[1:]:
        np.testing.assert_allclose(q, results[0][0], atol=1e-5)
        np.testing.assert_allclose(parameters, results[0][1], atol=1e-6)


def test_a_plane_curve_is_rolled_into_the_plane_of_a_planar_arm() -> None:
    arm = pp.Arm.from_template("Rz", 20)
    flat = np.array([(0, 0), (1, 0), (2, 0.5), (3, 0.5), (4, 0)])
    for axes in ((0, 1), (0, 2), (1, 2)):
        points = np.zeros((5, 3))
        points[:, axes] = flat
        target = pp.resolve_targets(arm, pp.Curve.spline(points))
        assert np.abs(target.points[:, 2]).max() < 1e-9
        assert target.residual.max() < 1e-5


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
