"""What `can_follow` promises against what the resolver can do, which shares no code with it."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import pinposture as pp
from pinposture.errors import TargetError


def limited_arm(bend: float) -> pp.Arm:
    return pp.Arm.from_modules([pp.template("RyRz").with_limits(-bend, bend)] * 12)


def circle(curvature: float) -> pp.Curve:
    return pp.Curve.helix(radius=1.0 / curvature, pitch=0.0, turns=max(1.0, 0.7 * curvature / (2 * np.pi)))


def follows(arm: pp.Arm, curve: pp.Curve, roll: float) -> bool:
    try:
        pp.resolve_targets(arm, curve, placement="align", roll=roll, method="sequential")
    except TargetError:
        return False
    return True


@pytest.mark.parametrize("bend", [0.2, 0.4, 0.8])
def test_circles_below_the_limit_are_followed_and_above_it_are_not(bend: float) -> None:
    arm = limited_arm(bend)
    limit = arm.can_follow(circle(1.0)).max_curvature
    # The weaker hinge carries a bend alone at a roll of 0 or a quarter turn.
    alone = (0.0, np.pi / 2)
    assert all(follows(arm, circle(0.98 * limit), roll) for roll in alone)
    assert not all(follows(arm, circle(1.02 * limit), roll) for roll in alone)


def test_the_closed_form_of_the_limit() -> None:
    arm = limited_arm(0.4)
    bend = 0.4
    # First hinge: chords of one module length turn by q0. Second hinge: (6.1a) on a circle through the base.
    first = 2.0 * np.sin(bend / 2.0) / 0.05
    second = 2.0 * 0.025 * np.sin(bend) / (2 * 0.025**2 * (1 + np.cos(bend)))
    assert arm.can_follow(circle(1.0)).max_curvature == pytest.approx(min(first, second), rel=1e-3)


def test_where_and_by_how_much_a_curve_is_too_much() -> None:
    arm = limited_arm(0.3)
    bend = [(0, 0, 0), (0.2, 0, 0), (0.25, 0, 0), (0.25, 0.05, 0), (0.25, 0.1, 0), (0.25, 0.5, 0)]
    result = arm.can_follow(pp.Curve.spline(bend))
    assert not result
    assert result.curvature > result.max_curvature
    excess = result.excesses[0]
    assert excess.quantity == "curvature"
    assert 0.1 < excess.start < excess.end < 0.4
    assert excess.worst == pytest.approx(result.curvature, rel=1e-3)
    assert "times the" in str(excess)
    gentle = arm.can_follow(pp.Curve.line((0, 0, 0), (1, 0, 0)))
    assert gentle
    assert gentle.excesses == ()


def test_too_much_torsion_is_found_too() -> None:
    arm = limited_arm(3.0)
    tight = pp.Curve.helix(radius=0.005, pitch=0.1, turns=8)  # torsion 57 /m, curvature 18 /m
    result = arm.can_follow(tight)
    assert {excess.quantity for excess in result.excesses} == {"torsion"}
    assert result.torsion > result.max_torsion


def test_a_peak_of_torsion_where_the_curve_hardly_bends_is_none() -> None:
    """An S whose bend runs over from one side to the other, past a place where it bends a little upwards.

    Bending (a (s - 0.3), b) in a frame that does not twist has torsion a / b where it is least.
    """
    a = 48.0
    b = 1.2
    step = 1e-3
    frame = np.eye(3)
    place = np.zeros(3)
    points = [np.zeros(3)]
    for s in np.arange(0.0, 0.62, step):
        bending = frame @ (0.0, a * (s + step / 2 - 0.3), b)
        turn = Rotation.from_rotvec(step * np.cross(frame[:, 0], bending)).as_matrix()
        place = place + step * (frame[:, 0] + turn @ frame[:, 0]) / 2
        frame = turn @ frame
        points.append(place)
    curve = pp.Curve.points(points)
    arm = limited_arm(1.0)
    near = np.linspace(0.295, 0.305, 21)
    peak = np.abs(curve.torsion(near)).max()
    assert peak == pytest.approx(a / b, rel=0.1)
    assert peak > 1.2 * arm.can_follow(curve).max_torsion
    assert 0.05 * curve.curvature(near).min() > 0.05  # more than once counted as none
    result = arm.can_follow(curve)
    assert result, [str(excess) for excess in result.excesses]
