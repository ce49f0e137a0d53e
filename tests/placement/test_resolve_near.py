"""Targets found from others that are near: as good as those that are searched for from the beginning."""

from __future__ import annotations

import numpy as np
import pytest
from arms import template_arm

import pinposture as pp
from pinposture.errors import InvalidValue, TargetError
from pinposture.placement.resolve import STIFFNESS

SHAPE = np.array([[0, 0, 0], [0.2, 0, 0.05], [0.4, 0.1, 0.1], [0.7, 0.2, 0.1], [1.2, 0.1, 0.0]])


def arm() -> pp.Arm:
    return template_arm("RyRz", 12)


def turned(k: int) -> pp.Curve:
    """The curve with its first handle on a circle, so that it leaves the base at an angle."""
    points = arm().length * SHAPE
    points[1] += 0.08 * arm().length * np.array([0.0, np.sin(k / 10), 1.0 - np.cos(k / 10)])
    return pp.Curve.spline(points)


def cost(target: pp.Target, q: np.ndarray, parameters: np.ndarray, method: str) -> float:
    """What least squares minimise, written down anew: squared distances, and a little for bending."""
    away = arm().at(q).points - target.curve.at(parameters)
    weight = STIFFNESS[method] * float(np.median(arm().chain.module_lengths))
    return float((away**2).sum() + weight**2 * (arm().positions(q) ** 2).sum()) / arm().length ** 2


def resolved(curve: pp.Curve, **given) -> pp.Target:
    return pp.resolve_targets(arm(), curve, placement="as_is", method="smooth", **given)


@pytest.mark.long
def test_following_a_curve_is_as_good_as_beginning_anew():
    near = resolved(turned(0))
    for k in range(1, 30):
        near = resolved(turned(k), near=near)
        anew = resolved(turned(k))
        costs = [cost(each, each.q, each.parameters, "smooth") for each in (near, anew)]
        assert costs[0] <= costs[1] * (1.0 + 1e-3) + 1e-12
        assert near.method == "smooth"
        assert np.all(near.residual < 0.1 * arm().length / arm().n_modules)


def test_a_posture_on_a_curve_that_ends_at_its_tip_is_found_again():
    before = resolved(turned(0))
    ends = float(before.parameters[-1]) + 1e-3 * arm().length
    posture = pp.Target.from_configuration(arm(), before.q)
    again = resolved(turned(0).trimmed(0.0, ends), near=posture)
    assert np.abs(arm().at(again.q).points - posture.points).max() < 1e-3 * arm().length


def test_it_is_an_optimum_within_the_limits():
    near = resolved(turned(7), near=resolved(turned(5)))
    best = cost(near, near.q, near.parameters, "smooth")
    rng = np.random.default_rng(0)
    for size in (1e-2, 1e-3, 1e-4):
        for _ in range(200):
            dq = size * rng.normal(size=arm().nv)
            ds = size * arm().length * rng.normal(size=arm().n_modules)
            parameters = np.clip(near.parameters + ds, 0.0, near.curve.length)
            assert cost(near, arm().integrate(near.q, dq), parameters, "smooth") >= best * (1.0 - 1e-6)
    assert np.all(arm().positions(near.q) >= arm().limits.lower)
    assert np.all(arm().positions(near.q) <= arm().limits.upper)


def test_algorithm_1_goes_first_and_needs_nothing_near():
    curve = pp.Curve.helix(0.3 * arm().length, 0.2 * arm().length, 1)
    alone = pp.resolve_targets(arm(), curve, placement="align")
    assert alone.method == "sequential"
    near = pp.resolve_targets(arm(), curve, placement="align", near=resolved(turned(3)))
    assert np.array_equal(near.q, alone.q)


def test_what_is_too_far_is_refused_and_not_looked_for():
    tight = pp.Arm.from_modules([pp.template("RyRz").with_limits(-0.3, 0.3)] * 12)
    points = tight.length * np.array([[0, 0, 0], [0.5, 0, 0], [0.5, 0.3, 0], [0.0, 0.3, 0.0], [-0.6, 0.3, 0]])
    near = pp.resolve_targets(tight, pp.Curve.line((0, 0, 0), (1.2 * tight.length, 0, 0)))
    with pytest.raises(TargetError):
        pp.resolve_targets(tight, pp.Curve.spline(points), placement="as_is", near=near)


def test_a_target_that_cannot_be_begun_from_is_refused():
    bare = pp.Target.from_points(arm(), arm().at(arm().straight()).points)
    with pytest.raises(InvalidValue, match="near"):
        resolved(turned(0), near=bare)
    other = pp.Arm.from_template("RyRz", 3)
    with pytest.raises(InvalidValue, match=r"target\.points"):
        resolved(turned(0), near=pp.resolve_targets(other, pp.Curve.line((0, 0, 0), (1, 0, 0))))


def swaying(time: float, planar: bool = False) -> pp.Curve:
    points = np.array(
        [(0, 0, 0), (0.25, 0, 0), (0.5, 0.05, 0.04), (0.75, 0.15, 0.05), (1, 0.2, 0), (1.4, 0.2, 0)]
    )
    points[2:, 1] += 0.04 * np.sin(time)
    points[2:, 2] += 0.04 * np.cos(time)
    return pp.Curve.spline(points * ([1, 1, 0] if planar else [1, 1, 1]))


@pytest.mark.parametrize(
    "described", [("RyRz", 20), ("RyRz", 16, (0.02, 0.035)), ("Rz", 20, (0.05,))], ids=repr
)
@pytest.mark.parametrize("placement", ["as_is", "align"])
def test_the_target_follows_without_jumps(described: tuple, placement: str) -> None:
    arm = template_arm(*described)
    step = 1e-4
    for time in np.linspace(0.0, 6.0, 12):
        one, two = (
            pp.resolve_targets(arm, swaying(t, arm.dimension == 2), placement=placement)
            for t in (time, time + step)
        )
        assert one.method == two.method == "sequential"
        assert np.abs(one.points - two.points).max() < step * arm.length
        # A turn of a module may move by more than the curve does, but not by orders of magnitude.
        assert np.abs(one.q - two.q).max() < 20 * step
