"""How far the whole arm is from a curve, and what is said of arms that do not follow one."""

from __future__ import annotations

import warnings
from functools import partial
from itertools import combinations, pairwise

import numpy as np
import pinocchio as pin
import pytest
from arm.describing import HERE, LINK, X, Y, Z, arm_text, limit, pairs
from nearest import distances_to_nearest
from sampling import seeds

import pinposture as pp
from benchmarks.studies.arms import awkward_arms
from pinposture.errors import (
    CurveBendsTooMuch,
    CurveEndsEarly,
    CurveLeavesTooSharply,
    CurveOutOfReach,
    PostureWarning,
)
from pinposture.placement.least_squares import FitProblem

WIDE = limit(-1e6, 1e6)


def load(text, **more):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", PostureWarning)
        return pp.Arm.load(text, **more)


def brute_force(arm, q, curve, normal=(0, 0, 0), per_link=60):
    """The farthest of dense samples of the links, by Pinocchio, from dense samples of the curve [m]."""
    data = arm.model.createData()
    pin.framesForwardKinematics(arm.model, data, q)
    places = [arm.chain.base, *(data.oMi[k].translation.copy() for k in range(1, arm.model.njoints))]
    places.append(data.oMf[arm.model.getFrameId("tip")].translation.copy())
    places = np.array(places) - np.outer((np.array(places) - arm.chain.base) @ normal, normal)
    dense = curve.at(np.linspace(0.0, curve.length, 4001))
    links = np.concatenate([a + np.linspace(0, 1, per_link)[:, None] * (b - a) for a, b in pairwise(places)])
    return distances_to_nearest(links, dense).max()


@pytest.mark.parametrize("seed", seeds(4))
def test_the_distance_is_that_of_dense_samples_of_links_and_curve(seed):
    arm = load(arm_text(pairs(3)))
    rng = np.random.default_rng(seed)
    curve = pp.Curve.spline(rng.uniform(-0.3, 0.3, (6, 3)))
    q = arm.random(rng)
    away = pp.Target(arm.at(q).points, np.ones(3), q, curve).distance_from_curve(arm)
    assert away == pytest.approx(brute_force(arm, q, curve), rel=2e-3)


@pytest.mark.parametrize("seed", [14, 74, 174])
def test_the_higher_of_two_peaks_is_found(seed):
    """The refinement of the farthest sample alone is up to 5 % short here."""
    rng = np.random.default_rng(seed)
    arm = load(arm_text(pairs(int(rng.integers(1, 4)))))
    radius = rng.uniform(0.05, 0.2) * arm.length
    pitch = rng.uniform(0.1, 0.4) * arm.length
    curve = pp.Curve.helix(radius=radius, pitch=pitch, turns=rng.uniform(2, 6))
    q = arm.configuration(rng.uniform(-1, 1, arm.nv))
    away = pp.Target(arm.at(q).points, np.ones(arm.n_modules), q, curve).distance_from_curve(arm)
    assert away == pytest.approx(brute_force(arm, q, curve, per_link=600), rel=2e-3)


def test_a_link_across_a_circle_is_as_far_from_it_as_its_chord():
    radius = 1.0
    relative_position_weight = 0.8
    arm = load(arm_text([("revolute", Z, HERE)], tip=f"{relative_position_weight} 0 0"))
    half = np.arcsin(relative_position_weight / 2 / radius)
    turn = np.linspace(np.pi / 2 + half, np.pi / 2 - half, 200)
    circle = pp.Curve.points(radius * np.column_stack([np.cos(turn), np.sin(turn), 0 * turn]))
    laid = circle.moved(np.eye(3), -circle.start)
    target = pp.Target(arm.at(arm.neutral()).points, np.ones(1), arm.neutral(), laid)
    assert target.distance_from_curve(arm) == pytest.approx(radius * (1 - np.cos(half)), rel=1e-5)


def test_without_a_curve_or_a_configuration_there_is_no_distance():
    arm = load(arm_text(pairs(2)))
    assert pp.Target.from_configuration(arm, arm.neutral()).distance_from_curve(arm) is None
    assert pp.Target.from_points(arm, arm.chain.points).distance_from_curve(arm) is None


@pytest.mark.parametrize("name", ["unrepeating21", "long_module7", "long_modules36", "bucket4"])
def test_an_arm_with_rows_of_parallel_axes_follows_a_curve_in_their_plane_with_all_its_links(name):
    arm = load(awkward_arms()[name])
    bend = [(0, 0, 0), (0.3, 0, 0), (0.6, 0, 0.1), (0.9, 0, 0.3), (1.0, 0, 0.7)]
    target = pp.resolve_targets(arm, pp.Curve.spline(arm.length * np.array(bend)))
    assert brute_force(arm, target.q, target.curve) < 0.021 * arm.length


@pytest.mark.long
def test_rows_of_parallel_axes_that_turn_each_other_come_near_a_helix_and_say_how_near():
    arm = load(awkward_arms()["long_modules36"])
    helix = pp.Curve.helix(radius=0.05 * arm.length, pitch=0.3 * arm.length, turns=3)
    target = pp.resolve_targets(arm, helix)
    away = brute_force(arm, target.q, target.curve)
    assert target.distance_from_curve(arm) == pytest.approx(away, rel=5e-3)
    assert away < 0.05 * arm.length


@pytest.mark.long
@pytest.mark.parametrize("name", ["unrepeating21", "long_module7"])
def test_such_an_arm_is_not_said_to_follow_a_helix(name):
    arm = load(awkward_arms()[name])
    helix = pp.Curve.helix(radius=0.06 * arm.length, pitch=0.15 * arm.length, turns=4)
    with pytest.raises(CurveBendsTooMuch):
        pp.resolve_targets(arm, helix)


def test_control_points_on_the_curve_do_not_hide_links_beside_it():
    arm = load(awkward_arms()["long_module7"], split=7)  # one control point, at the tip
    helix = pp.Curve.helix(radius=0.06 * arm.length, pitch=0.15 * arm.length, turns=4)
    with pytest.warns(PostureWarning, match="does not follow the curve: its links are up to"):
        target = pp.resolve_targets(arm, helix)
    assert target.residual.max() < 1e-6
    assert target.distance_from_curve(arm) > 0.1 * arm.length
    run = pp.track(arm, target, arm.straight(), max_steps=200)
    assert run.converged
    assert run.distance_from_curve == pytest.approx(brute_force(arm, run.q[-1], target.curve), rel=5e-3)


def test_an_arm_that_follows_is_not_warned_of():
    arm = pp.Arm.from_template("RyRz", 8)
    with warnings.catch_warnings():
        warnings.simplefilter("error", PostureWarning)
        pp.resolve_targets(arm, pp.Curve.helix(radius=0.2, pitch=0.3, turns=0.4), placement="align")


@pytest.mark.parametrize("curve", ["line", "bend"])
@pytest.mark.parametrize("beside", [0.05, -0.3])
def test_a_tip_beside_the_plane_of_the_arm_is_measured_in_the_plane(curve, beside):
    text = arm_text([("revolute", Z, LINK)] * 8, tip=f"0.1 0 {beside}")
    arm = load(text)
    level = load(arm_text([("revolute", Z, LINK)] * 8))
    asked = {
        "line": pp.Curve.line((0, 0, 0), (1, 0, 0)),
        "bend": pp.Curve.spline([(0, 0, 0), (0.3, 0, 0), (0.6, 0.1, 0), (0.9, 0.3, 0)]),
    }[curve]
    target = pp.resolve_targets(arm, asked, placement="align")
    assert target.residual.max() < 1e-6
    assert target.points[-1][2] == pytest.approx(beside, abs=1e-9)
    places = level.at(target.q).points
    np.testing.assert_allclose(target.points[:, :2], places[:, :2], atol=1e-9)
    away = brute_force(arm, target.q, target.curve, normal=(0, 0, 1))
    assert target.distance_from_curve(arm) == pytest.approx(away, rel=0.01, abs=2e-4)
    assert pp.track(arm, target, arm.random(np.random.default_rng(0))).converged


def test_a_slide_that_ends_before_the_curve_is_named():
    joints = [("prismatic", X, HERE, limit(0, 0.2)), *pairs(3)]
    arm = load(arm_text(joints))
    far = pp.Curve.line((1.5, 0, 0), (2.5, 0, 0))
    with pytest.raises(CurveOutOfReach, match="prismatic joints are at their limits") as caught:
        pp.resolve_targets(arm, far, placement="as_is")
    assert "gentler" not in str(caught.value)


def test_hinges_that_cannot_bend_as_far_as_the_curve_are_named_beside_a_slide_at_its_limit():
    stiff = [("revolute", axis, LINK, limit(-0.3, 0.3)) for axis in (Y, Z) * 3]
    arm = load(arm_text([("prismatic", X, HERE, limit(0, 0.4)), *stiff]))
    bend = pp.Curve.helix(radius=0.3, pitch=0.1, turns=0.99)
    with pytest.raises(CurveBendsTooMuch, match=r"joints are at their limits: .*'j2'; .*gentler"):
        pp.resolve_targets(arm, bend, placement="align")


@pytest.mark.parametrize("method", ["auto", "sequential", "smooth", "closest"])
@pytest.mark.parametrize("least", [0.0, 0.03])
def test_a_slide_retracts_if_the_curve_is_too_short_for_the_extended_arm(method, least):
    arm = load(arm_text([("prismatic", X, HERE, limit(least, 0.2)), *pairs(3)]))
    q = np.array([least, *[0.1, -0.2] * 3])
    nodes = np.vstack([arm.chain.base, arm.at(q).points])
    nodes = np.vstack([nodes, 1.1 * nodes[-1] - 0.1 * nodes[-2]])  # 2 cm longer than the arm
    straight = pp.Curve.line(arm.chain.base, arm.chain.base + [1.001 * (arm.length + least), 0, 0])
    for curve in (straight, pp.Curve.spline(nodes, through=True)):
        target = pp.resolve_targets(arm, curve, placement="as_is", method=method)
        assert least <= target.q[0] < 0.1
        assert curve.nearest(arm.at(target.q).points)[1].max() < (1e-3 if method == "smooth" else 1e-5)
    short = pp.Curve.line(arm.chain.base, arm.chain.base + [0.98 * (arm.length + least), 0, 0])
    with pytest.raises(CurveEndsEarly):
        pp.resolve_targets(arm, short, placement="as_is", method=method)


Slide = partial(pp.JointSpec, "x", "prismatic")
HINGED = (pp.JointSpec("y"), pp.JointSpec("z"))
TELESCOPE = pp.ModuleTemplate("RzP", (pp.JointSpec("z"), Slide(0.0, 0.1)), (0.05, 0.05))
SLIDING = pp.ModuleTemplate("RyRzP", (*HINGED, Slide(0.0, 0.05)), (0.03, 0.05, 0.03))
HINGES = pp.ModuleTemplate("RyRz", HINGED, (0.03, 0.05))
LONG = pp.ModuleTemplate("RyRzP", (*HINGED, Slide(0.0, 0.3)), (0.03, 0.02, 0.03))


def shaped(kind, length):
    """A curve from the origin along x: half a circle, an S, or a turn of a helix."""
    along = np.linspace(0.0, 1.0, 400)
    angle = {"C": np.pi * along, "S": 1.5 * np.sin(2 * np.pi * along), "helix": 2 * np.pi * along}[kind]
    rise = 0.5 * np.clip(8 * along, 0, 1) * (kind == "helix")
    steps = np.column_stack([np.cos(angle), np.sin(angle), rise]) / np.hypot(1.0, rise)[:, None]
    points = np.vstack([np.zeros(3), np.cumsum(steps, axis=0) / 400])
    return pp.Curve.spline(length * points[::8], through=True)


def link_distances(arm, target):
    """Root mean square and largest distance of dense samples of the links from the curve [m]."""
    ends = arm.at(target.q).links
    samples = np.vstack([a + np.linspace(0, 1, 50)[:, None] * (b - a) for a, b in pairwise(ends)])
    distances = target.curve.nearest(samples)[1]
    return np.sqrt(np.mean(distances**2)), distances.max()


@pytest.mark.long
@pytest.mark.parametrize("kind", ["C", "S"])
@pytest.mark.parametrize("length", [0.5, 0.62, 0.75])
def test_slides_lay_the_links_as_near_to_the_curve_as_an_exhaustive_search(kind, length):
    """Each of four modules is a chord of the curve that is 0.1 m to 0.2 m long, and the last ends with it."""
    arm = pp.Arm.from_modules([TELESCOPE] * 4)
    curve = shaped(kind, length)
    target = pp.resolve_targets(arm, curve, placement="as_is")
    assert arm.within_limits(target.q)
    assert target.residual.max() < 1e-7
    assert target.parameters[-1] == pytest.approx(curve.length, abs=3e-4 * arm.length)

    share = np.linspace(0.0, 1.0, 21)[:, None]

    def cost(a, b, nearby):
        gaps = (a + share * (b - a))[:, None] - nearby
        return (gaps**2).sum(axis=2).min(axis=1).mean() * np.linalg.norm(b - a)

    dense = curve.resample(1001)
    count = 101
    costs = np.full((count, count), np.inf)
    for i, j in combinations(range(count), 2):
        a = dense[10 * i]
        b = dense[10 * j]
        if 0.0999 <= np.linalg.norm(b - a) <= 0.2001:
            costs[i, j] = cost(a, b, dense[10 * i : 10 * j + 1])
    least = costs[0]
    for _ in range(3):
        least = (least[:, None] + costs).min(axis=0)
    ends = np.vstack([curve.start, arm.at(target.q).points])
    found = sum(cost(a, b, dense) for a, b in pairwise(ends))
    assert np.sqrt(found) < 1.1 * np.sqrt(least[-1])


@pytest.mark.parametrize("kind", ["C", "S", "helix"])
@pytest.mark.parametrize("place", [0, 4, 7])
def test_a_slide_among_17_joints_extends_as_far_as_the_curve_is_long(kind, place):
    """With its slide extended, the arm lay 10 times as far from the curve, its last module folded."""
    arm = pp.Arm.from_modules([*[HINGES] * place, LONG, *[HINGES] * (7 - place)])
    for method in ("auto", "smooth", "closest"):
        target = pp.resolve_targets(arm, shaped(kind, 0.7), placement="as_is", method=method)
        assert target.parameters[-1] == pytest.approx(0.7, abs=0.02)
        assert arm.positions(target.q)[arm.slides][0] < 0.1
        assert np.abs(arm.positions(target.q)[~arm.slides]).max() < 1.5
        assert link_distances(arm, target)[1] < 0.04


@pytest.mark.parametrize("method", ["auto", "smooth", "closest"])
@pytest.mark.parametrize("share", [0.0, 0.3, 0.9, 1.0, 1.2])
def test_slides_end_a_straight_arm_where_a_line_ends(method, share):
    arm = pp.Arm.from_modules([SLIDING] * 4)
    length = arm.length + share * 0.2 + 1e-4
    target = pp.resolve_targets(arm, pp.Curve.line((0, 0, 0), (length, 0, 0)), method=method)
    extended = arm.positions(target.q)[arm.slides]
    np.testing.assert_allclose(extended, 0.05 * min(share, 1.0), atol=1e-4)
    np.testing.assert_allclose(arm.positions(target.q)[~arm.slides], 0.0, atol=1e-6)


@pytest.mark.long
def test_slides_follow_a_curve_that_is_dragged_without_jumps():
    arm = pp.Arm.from_modules([SLIDING] * 6)
    near = None
    for share in np.linspace(0.05, 1.2, 8):
        sways = [shaped("S", arm.length + (share + change) * 0.3) for change in (0.0, 1e-4)]
        near = pp.resolve_targets(arm, sways[0], placement="as_is", near=near)
        for start in (None, near):
            one, two = (pp.resolve_targets(arm, curve, placement="as_is", near=start) for curve in sways)
            assert np.abs(one.q - two.q).max() < 2e-3
        assert near.q[arm.slides].mean() == pytest.approx(0.05 * min(share, 1.0), abs=0.01)


def test_slides_stop_where_control_points_would_leave_the_curve():
    """A module with a slide and no hinge is straight, and no part of an S as long as the slide is."""
    straight = pp.ModuleTemplate("P", (Slide(0.0, 0.3),), (0.05,))
    arm = pp.Arm.from_modules([*[HINGES] * 4, straight, *[HINGES] * 4])
    target = pp.resolve_targets(arm, shaped("S", 0.975), placement="as_is")
    assert link_distances(arm, target)[1] < 0.02
    assert target.parameters[-1] < 0.8


def test_a_curve_beside_the_base_is_said_to_be():
    arm = load(arm_text([("revolute", "0 1 0.2", LINK), ("revolute", "0 0.2 1", LINK)] * 3))
    far = pp.Curve.line((0.1, 2, 0), (1, 2, 0))
    with pytest.raises(CurveLeavesTooSharply, match="passes 2 m from the base"):
        pp.resolve_targets(arm, far, placement="as_is")


def driving(bound=WIDE):
    """A mobile base of two slides that carries three modules of two hinges."""
    return load(arm_text([("prismatic", X, HERE, bound), ("prismatic", Y, HERE, bound), *pairs(3)]))


def test_a_base_that_drives_stays_where_a_curve_is_laid_at_it():
    arm = driving()
    target = pp.resolve_targets(
        arm, pp.Curve.spline([(0, 0, 0), (0.3, 0, 0), (0.5, 0.1, 0.1), (0.9, 0.3, 0.1)])
    )
    np.testing.assert_allclose(arm.positions(target.q)[:2], 0.0, atol=1e-12)
    assert target.residual.max() < 1e-6
    assert target.distance_from_curve(arm) < 0.05 * arm.length


def test_a_base_that_drives_goes_to_a_curve_that_is_used_as_it_is():
    arm = driving()
    curve = pp.Curve.spline([(0, 0, 0), (0.3, 0, 0), (0.5, 0.1, 0.1), (0.9, 0.3, 0.1)])
    at_base = pp.resolve_targets(arm, curve, placement="translate")
    shift = np.array([250.0, -31.0, 0.0])
    start = arm.chain.base + shift - curve.start
    there = pp.resolve_targets(arm, curve.moved(np.eye(3), start), placement="as_is")
    np.testing.assert_allclose(arm.positions(there.q)[:2], shift[:2], atol=1e-9)
    np.testing.assert_allclose(there.points - shift, at_base.points, atol=1e-6)
    assert there.distance_from_curve(arm) == pytest.approx(at_base.distance_from_curve(arm), abs=1e-6)


def test_slides_on_a_base_that_drives_fit_the_arm_to_the_curve_wherever_it_is():
    telescope = [*pairs(1), ("prismatic", X, LINK, limit(0, 0.1))]
    arm = load(arm_text([("prismatic", X, HERE, WIDE), ("prismatic", Y, HERE, WIDE), *telescope * 4]))
    curve = pp.Curve.spline([(0, 0, 0), (0.3, 0, 0), (0.6, 0.1, 0.05), (0.9, 0.4, 0.1), (0.9, 0.9, 0.1)])
    shift = np.array([250.0, -31.0, 0.0])
    here, there = (
        pp.resolve_targets(arm, curve.moved(np.eye(3), arm.chain.base + by), placement="as_is")
        for by in (np.zeros(3), shift)
    )
    np.testing.assert_allclose(arm.positions(there.q)[2:], arm.positions(here.q)[2:], atol=1e-5)
    for target in (here, there):
        assert target.parameters[-1] == pytest.approx(curve.length, abs=1e-3)
        assert target.distance_from_curve(arm) < 0.03 * arm.length
    with pytest.raises(CurveEndsEarly):
        pp.resolve_targets(arm, curve.trimmed(0.0, 0.8 * arm.length), placement="translate")


def test_points_that_a_base_has_to_drive_to_are_fitted():
    arm = driving()
    q = arm.configuration([40.0, -7.0, *np.linspace(-0.4, 0.5, 6)])
    found = pp.fit_points(arm, arm.at(q).points)
    assert found.residual.max() < 1e-6


@pytest.mark.parametrize("template", ["Rz", "RyRz"])
def test_a_fit_ends_at_a_step_that_changes_nothing(template: str, monkeypatch: pytest.MonkeyPatch) -> None:
    arm = pp.Arm.from_template(template, modules=8)
    curve = pp.Curve.spline(arm.length * np.array([[0, 0, 0], [0.3, 0.1, 0], [0.7, 0.1, 0], [1.2, 0, 0]]))
    evaluate = FitProblem.evaluate
    evaluations = []

    def counted(problem: FitProblem, *arguments: object) -> object:
        evaluations.append(problem)
        return evaluate(problem, *arguments)

    monkeypatch.setattr(FitProblem, "evaluate", counted)
    target = pp.resolve_targets(arm, curve, method="closest")
    assert target.residual.max() < 1e-12
    assert len(evaluations) <= 16
