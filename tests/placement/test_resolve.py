"""Algorithm 1: the target lies on the curve, the configuration takes it, and failures say why."""

from __future__ import annotations

import re
import warnings

import numpy as np
import pinocchio as pin
import pytest
from arms import template_arm
from hypothesis import given
from hypothesis import strategies as st
from sampling import examples

import pinposture as pp
from pinposture.curve import HELIX, LINE
from pinposture.errors import (
    CurveBendsTooMuch,
    CurveEndsEarly,
    CurveError,
    CurveLeavesTooSharply,
    InvalidValue,
    TargetError,
    UnknownName,
    UnsupportedModule,
)
from pinposture.placement.module_kinematics import is_compiled

PLACEMENT = pin.SE3(pin.rpy.rpyToMatrix(0.3, -1.1, 2.0), np.array([0.4, -2.0, 0.7]))


@pytest.fixture(scope="session")
def arm() -> pp.Arm:
    return template_arm("RyRz", 20)


@pytest.fixture(scope="session")
def planar_turned() -> pp.Arm:
    return pp.Arm.from_template("Rz", 45, base_placement=PLACEMENT)


def assert_consistent(arm: pp.Arm, target: pp.Target, tolerance: float) -> None:
    """The configuration takes the points, which lie on the curve in order, within the limits."""
    np.testing.assert_allclose(arm.at(target.q).points, target.points, atol=1e-11 * arm.length)
    assert np.all(np.diff(target.parameters) > 0.0)
    distance = target.curve.nearest(target.points)[1]
    assert np.max(distance) < tolerance * arm.length
    assert np.max(target.residual) < tolerance * arm.length
    assert arm.within_limits(target.q)
    assert np.all(target.has_target)


@pytest.mark.parametrize("template", ["RyRz", "RzRy"])
@pytest.mark.parametrize("lengths", [(0.025, 0.025), (0.02, 0.03), (0.01, 0.04), (0.0, 0.05)])
@examples(20)
@given(roll=st.floats(-3.2, 3.2))
def test_the_helix_is_taken_wherever_the_arm_stands(
    template: str, lengths: tuple[float, float], roll: float
) -> None:
    arm = pp.Arm.from_template(template, 20, lengths, base_placement=PLACEMENT)
    target = pp.resolve_targets(arm, HELIX, roll=roll, placement="align")
    assert_consistent(arm, target, 3e-6)
    np.testing.assert_allclose(target.curve.start, arm.chain.base, atol=1e-12)
    np.testing.assert_allclose(target.curve.tangent(0.0), PLACEMENT.rotation[:, 0], atol=1e-9)


def test_the_line_is_the_straight_arm(arm: pp.Arm) -> None:
    target = pp.resolve_targets(arm, LINE)
    np.testing.assert_allclose(target.q, 0.0, atol=1e-9)
    np.testing.assert_allclose(target.parameters, np.linspace(0.05, 1.0, 20), atol=1e-9)


def test_a_line_as_long_as_the_arm_is_long_enough(arm: pp.Arm) -> None:
    target = pp.resolve_targets(arm, pp.Curve.line((0, 0, 0), (1.0, 0, 0)))
    assert np.all(target.has_target)
    with pytest.raises(CurveEndsEarly, match="module 20"):
        pp.resolve_targets(arm, pp.Curve.line((0, 0, 0), (0.999, 0, 0)))


@pytest.mark.long
@pytest.mark.parametrize("template", ["RyRz", "RzRy", "Rz", "RzRzRz", "Continuum"])
@pytest.mark.parametrize("samples", [2000, 200_000])
def test_rounding_does_not_make_a_line_too_short(template: str, samples: int) -> None:
    rng = np.random.default_rng(0)
    for modules in (1, 2, 3, 5, 8, 13) if template == "Continuum" else (1, 2, 3, 5, 8, 13, 21, 40):
        place = pin.SE3(pin.exp3(2.0 * rng.normal(size=3)), 30.0 * rng.normal(size=3))
        arm = pp.Arm.from_template(template, modules, base_placement=place)
        base = arm.chain.base
        tip = arm.at(arm.straight()).points[-1]
        for missing in (0.0, 1e-11, 5e-10):
            line = pp.Curve.line(base, tip + missing * (base - tip))
            for method in ("sequential", "auto", "closest") if modules < 9 else ("sequential", "auto"):
                target = pp.resolve_targets(arm, line, samples, placement="as_is", method=method)
                assert_consistent(arm, target, 1e-8)
                assert target.parameters[-1] <= line.length
        short = pp.Curve.line(base, tip + 1e-8 * (base - tip))
        with pytest.raises(CurveEndsEarly):
            pp.resolve_targets(arm, short, samples, placement="as_is")


def test_the_residual_falls_with_the_number_of_samples(arm: pp.Arm) -> None:
    coarse, fine = (pp.resolve_targets(arm, HELIX, samples=n).residual.max() for n in (200, 2000))
    assert fine < coarse / 50  # a chord cuts the curve off by the square of its length


def test_a_smooth_posture_of_the_arm_itself_is_found_again(arm: pp.Arm) -> None:
    # The curve through the links of a known posture, tangent to the first link.
    rng = np.random.default_rng(4)
    q = 0.25 * rng.uniform(-1, 1, 40)
    points = np.vstack([np.zeros(3), arm.at(q).points])
    target = pp.resolve_targets(arm, pp.Curve.points(np.vstack([points, 2 * points[-1] - points[-2]])))
    assert_consistent(arm, target, 1e-5)


@examples(50)
@given(st.integers(0, 10**6))
def test_random_gentle_splines_resolve_for_planar_and_spatial_arms(
    arm: pp.Arm, planar_turned: pp.Arm, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    steps = np.column_stack([np.full(9, 0.2), rng.uniform(-0.06, 0.06, (9, 2))])
    points = np.vstack([np.zeros(3), np.cumsum(steps, axis=0)])
    assert_consistent(arm, pp.resolve_targets(arm, pp.Curve.spline(points)), 1e-5)
    flat = pp.Curve.spline(points * [4.5, 4.5, 0.0])
    for planar in (template_arm("Rz", 45), template_arm("RzRz", 22), planar_turned):
        placement = "align" if planar is not planar_turned else "as_is"
        moved = flat if planar is not planar_turned else flat.moved(PLACEMENT.rotation, PLACEMENT.translation)
        assert_consistent(planar, pp.resolve_targets(planar, moved, placement=placement), 1e-5)


def test_mixed_arms_resolve_through_the_same_walk() -> None:
    modules = [
        pp.template(name).with_lengths(lengths)
        for name, lengths in (("RyRz", (0.03, 0.02)), ("RzRy", (0.02, 0.02)), ("RyRz", (0.025, 0.035)))
    ] * 4
    arm = pp.Arm.from_modules(modules)
    curve = pp.Curve.helix(radius=0.1, pitch=0.3, turns=3)
    assert_consistent(arm, pp.resolve_targets(arm, curve, placement="align"), 1e-5)


def test_a_module_longer_before_its_second_hinge_zigzags_and_is_placed_smoothly() -> None:
    # Sequential placement multiplies a misalignment by -l1 / l2 from module to module.
    arm = pp.Arm.from_template("RyRz", 20, (0.03, 0.02))
    with pytest.raises(CurveBendsTooMuch, match="beyond its joint limits"):
        pp.resolve_targets(arm, HELIX, method="sequential")
    target = pp.resolve_targets(arm, HELIX)
    assert target.method == "smooth"
    assert_consistent(arm, target, 1e-3)
    assert np.abs(target.q).max() < 0.9


@pytest.mark.long
def test_placements_mean_what_they_say(arm: pp.Arm) -> None:
    curve = LINE.moved(np.eye(3), [0.0, 0.3, 0.0])
    translated = pp.resolve_targets(arm, curve, placement="translate")
    np.testing.assert_allclose(translated.points[-1], [1.0, 0, 0], atol=1e-9)
    tilted = pp.Curve.line((0, 0, 0), (0.8, 0.0, 0.8))
    kept = pp.resolve_targets(arm, tilted, placement="translate")
    np.testing.assert_allclose(kept.points[-1], np.array([1, 0, 1]) / np.sqrt(2), atol=1e-9)
    turned = pp.resolve_targets(arm, tilted)
    np.testing.assert_allclose(turned.points[-1], [1.0, 0, 0], atol=1e-9)
    backward = pp.resolve_targets(arm, pp.Curve.line((0, 0, 0), (-1.1, 0, 0)))
    np.testing.assert_allclose(backward.points[-1], [1.0, 0, 0], atol=1e-9)
    with pytest.raises(CurveLeavesTooSharply, match=r"passes 300 mm from the base"):
        pp.resolve_targets(arm, curve, placement="as_is")


def test_a_curve_that_passes_near_the_base_is_joined_on_the_way(arm: pp.Arm) -> None:
    curve = pp.Curve.line((-0.5, 0.01, 0.0), (1.2, 0.01, 0.0))
    target = pp.resolve_targets(arm, curve, placement="as_is", method="sequential")
    np.testing.assert_allclose(target.points[:, 1], 0.01, atol=1e-9)
    assert 0.5 < target.parameters[0] < 0.56


@pytest.mark.long
def test_curves_that_do_not_fit_are_named(arm: pp.Arm) -> None:
    with pytest.raises(CurveEndsEarly, match=r"module 7.*lengthen the curve") as early:
        pp.resolve_targets(arm, pp.Curve.line((0, 0, 0), (0.31, 0, 0)))
    assert early.value.module == 7
    assert early.value.parameter == pytest.approx(0.3)
    sideways = pp.Curve.line((0, 0, 0), (0.0, 1.5, 0.0))
    with pytest.raises(CurveLeavesTooSharply, match="90 degrees off its axis"):
        pp.resolve_targets(arm, sideways, placement="as_is", method="sequential")
    limited = pp.Arm.from_modules([pp.template("RyRz").with_limits(-0.3, 0.3)] * 20)
    with pytest.raises(CurveBendsTooMuch, match="joint limits"):
        pp.resolve_targets(limited, HELIX)
    planar = pp.Arm.from_template("Rz", 6)
    with pytest.raises(CurveBendsTooMuch, match="plane"):
        pp.resolve_targets(planar, pp.Curve.helix(radius=0.4, pitch=0.5, turns=3), placement="align")


@pytest.mark.parametrize("mixed", [False, True])
def test_the_joint_that_would_exceed_its_limits_is_named_with_its_angle(mixed: bool) -> None:
    """Two lines meet at 0.5 rad at the base of module 3, in the plane of its first hinge."""
    corner = np.array([0.2, 0.0, 0.0])
    along = np.array([np.cos(0.5), 0.0, -np.sin(0.5)])
    curve = pp.Curve.spline([np.zeros(3), corner, corner + 0.5 * along], degree=1)
    module = pp.ModuleTemplate("RyRz", (pp.JointSpec("y"), pp.JointSpec("z")), (0.0, 0.1))
    module = module.with_limits(-0.3, 0.3)
    odd = pp.ModuleTemplate("odd", tuple(pp.JointSpec(axis) for axis in "yzy"), (0.05, 0.05, 0.05))
    arm = pp.Arm.from_modules([module] * 5 + [odd] * mixed)
    assert is_compiled(arm) != mixed
    with pytest.raises(CurveBendsTooMuch, match=r"its joint limits do not allow it") as caught:
        pp.resolve_targets(arm, curve, placement="as_is", method="sequential")
    assert caught.value.module == 3
    text = rf"joint '{arm.chain.input_names[4]}' would be at ([\d.]+) rad, allowed: -0.3 to 0.3 rad; use"
    angle = re.search(text, str(caught.value))
    assert angle and float(angle[1]) == pytest.approx(0.5, abs=1e-3)


@pytest.mark.parametrize("share", [0.5, 0.7, 0.95, 0.999])
def test_a_straight_curve_that_is_too_short_is_called_short(share: float) -> None:
    hinges = (pp.JointSpec("y", lower=-1.7, upper=1.7), pp.JointSpec("z", lower=-1.7, upper=1.7))
    long, short = (pp.ModuleTemplate(f"own{k}", hinges, (0.1 - 0.04 * k, 0.08 + 0.02 * k)) for k in (0, 1))
    arm = pp.Arm.from_modules([long, short] * 3)
    with pytest.raises(CurveEndsEarly, match=r"ends .* the module is .* long"):
        pp.resolve_targets(arm, pp.Curve.line((0, 0, 0), (share * arm.length, 0, 0)), placement="as_is")


def test_a_partial_target_says_which_points_have_no_place(arm: pp.Arm) -> None:
    target = pp.resolve_targets(arm, pp.Curve.line((0, 0, 0), (0.31, 0, 0)), incomplete="partial")
    assert target.has_target.tolist() == [True] * 6 + [False] * 14
    assert "module 7" in target.incomplete
    assert np.all(np.isfinite(target.points))
    np.testing.assert_allclose(arm.at(target.q).points, target.points, atol=1e-12)
    whole = pp.resolve_targets(arm, LINE, incomplete="partial")
    assert whole.incomplete == ""


def test_every_failure_is_a_target_error_and_never_nan() -> None:
    rng = np.random.default_rng(0)
    failures = 0
    arm = pp.Arm.from_modules([pp.template("RyRz").with_limits(-0.9, 0.9)] * 20)
    for _ in range(60):
        curve = pp.Curve.spline(np.vstack([np.zeros(3), rng.uniform(-0.5, 0.5, (6, 3))]))
        for placement in ("as_is", "align"):
            try:
                target = pp.resolve_targets(arm, curve, placement=placement, method="sequential")
            except TargetError:
                failures += 1
                target = pp.resolve_targets(
                    arm, curve, placement=placement, incomplete="partial", method="sequential"
                )
            assert np.all(np.isfinite(target.points))
            assert np.all(np.isfinite(target.q))
            assert np.all(target.residual[target.has_target] < 1e-4)
    assert 10 < failures < 120


def test_modules_that_cannot_move_their_ends_are_named() -> None:
    roll = pp.ModuleTemplate("Rx", (pp.JointSpec("x"),), (0.05,))
    arm = pp.Arm.from_modules([pp.template("RyRz"), roll])
    with pytest.raises(UnsupportedModule, match=r"module 2 .*none of its joints moves its end"):
        pp.resolve_targets(arm, LINE, method="sequential")
    target = pp.resolve_targets(arm, LINE)
    assert target.method == "closest"
    assert set(target.placed_by) == {"least squares"}
    assert "module 2" in target.fallback


@pytest.mark.parametrize(
    ("arguments", "kind", "message"),
    [
        ({"placement": "centre"}, UnknownName, "'centre'.*as_is"),
        ({"method": "newton"}, UnknownName, "closest"),
        ({"incomplete": "ignore"}, UnknownName, "partial"),
        ({"samples": 1}, InvalidValue, "at least 2"),
        ({"roll": float("nan")}, InvalidValue, "finite angle"),
    ],
)
def test_bad_arguments_are_named(arm: pp.Arm, arguments: dict, kind: type, message: str) -> None:
    with pytest.raises(kind, match=message):
        pp.resolve_targets(arm, LINE, **arguments)


def test_what_is_no_arm_or_no_curve_is_named(arm: pp.Arm) -> None:
    with pytest.raises(InvalidValue, match=r"arm is Curve.*allowed: an Arm"):
        pp.resolve_targets(LINE, arm)
    with pytest.raises(InvalidValue, match="curve is 'line'; allowed: a Curve"):
        pp.resolve_targets(arm, "line")


@pytest.mark.parametrize("placement", [None, "as_is"])
def test_a_curve_in_millimetres_is_refused(arm: pp.Arm, placement: str | None) -> None:
    metres = pp.Curve.points(HELIX.resample(60))
    assert pp.resolve_targets(arm, metres).has_target.all()
    text = r"curve: is 1\d+ m long; allowed: 100 m at most, 100 times the arm; if it is in millimetres, load"
    with pytest.raises(CurveError, match=text):
        pp.resolve_targets(arm, pp.Curve.points(1000.0 * metres.resample(60)), placement=placement)
    assert pp.resolve_targets(arm, pp.Curve.line((0, 0, 0), (99.9, 0, 0))).has_target.all()


def test_targets_from_points_and_configurations(arm: pp.Arm) -> None:
    q = arm.random(np.random.default_rng(1))
    taken = pp.Target.from_configuration(arm, q)
    np.testing.assert_allclose(taken.points, arm.at(q).points, atol=1e-15)
    some = np.zeros(20)
    some[[4, 19]] = 1.0
    assert pp.Target.from_points(arm, taken.points, some).has_target.sum() == 2
    for points, weights, message in (
        (np.zeros((19, 3)), None, r"\(20, 3\)"),
        (np.full((20, 3), np.nan), None, r"points\[0, 0\] is nan"),
        (np.zeros((20, 3)), np.zeros(20), "at least one"),
        (np.zeros((20, 3)), -np.ones(20), ">= 0"),
    ):
        with pytest.raises(InvalidValue, match=message):
            pp.Target.from_points(arm, points, weights)


def test_points_in_millimetres_are_reported(arm: pp.Arm) -> None:
    points = arm.at(arm.random(np.random.default_rng(1))).points + (0.0, 0.0, 0.2)
    text = r"points\[\d+\] is [\d.]+ m from the base of the arm, \d+ times its length; is it in millimetres"
    with pytest.warns(pp.PostureWarning, match=text) as told:
        pp.Target.from_points(arm, 1000.0 * points)
    assert told[0].filename == __file__
    marked = points.copy()
    marked[3] *= 1e6
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        pp.Target.from_points(arm, points)
        pp.Target.from_points(arm, marked, np.arange(20) != 3)  # a free point may be anywhere
        moved = pp.Arm.from_template("RyRz", 20, base_placement=pin.SE3(np.eye(3), np.full(3, 500.0)))
        pp.Target.from_points(moved, points + 500.0)


def test_a_target_is_printed_in_one_line() -> None:
    arm = template_arm("RyRz", 6)
    target = pp.resolve_targets(arm, pp.Curve.line((0, 0, 0), (1, 0, 0)))
    assert repr(target) == "Target(6 points, a configuration, on a curve of 1 m, sequential placement)"
    assert repr(target.region(1, 3)).startswith("Target(3 of 6 points, a configuration")
    assert repr(pp.Target.from_points(arm, target.points)) == "Target(6 points, no configuration)"


def test_modules_in_closed_form_begin_where_slides_of_the_base_carry_them() -> None:
    drives = tuple(pp.JointSpec(axis, "prismatic", -1e6, 1e6) for axis in "xy")
    mobile = pp.ModuleTemplate(
        "base", (*drives, pp.JointSpec("y"), pp.JointSpec("z")), (0.0, 0.0, 0.05, 0.05)
    )
    arm = pp.Arm.from_modules([mobile] + [pp.template("RyRz")] * 7)
    points = np.array([(1, 1, 0), (1.3, 1, 0), (1.6, 1.1, 0), (1.9, 1.2, 0.1), (2.5, 1.2, 0.1)])
    curve = pp.Curve.spline(arm.length * points)
    target = pp.resolve_targets(arm, curve, placement="as_is", method="sequential")
    np.testing.assert_allclose(arm.positions(target.q)[:2], curve.start[:2], atol=1e-12)
    assert curve.nearest(arm.at(target.q).points).distance.max() < 1e-5 * arm.length


def test_modules_that_cannot_be_placed_stay_within_limits_that_exclude_zero() -> None:
    arm = pp.Arm.from_modules([pp.template("RyRz").with_limits(1.7, 3.0)] * 4)
    points = np.array([(0, 0, 0), (0.3, 0, 0), (0.6, 0.1, 0), (0.9, 0.2, 0.1), (1.5, 0.2, 0.1)])
    curve = pp.Curve.spline(arm.length * points)
    found = pp.resolve_targets(arm, curve, placement="align", method="sequential", incomplete="partial")
    assert found.incomplete
    assert arm.within_limits(found.q)


def test_a_target_keeps_its_points_whatever_is_written_to_the_array_behind_them() -> None:
    points = np.zeros((3, 3))
    seen = points.view()
    seen.flags.writeable = False
    target = pp.Target(seen, np.ones(3))
    points[:] = 1.0
    assert not target.points.any()
    assert not target.points.flags.writeable
    assert pp.Target(target.points, target.weights).points is target.points  # nobody can write to these
