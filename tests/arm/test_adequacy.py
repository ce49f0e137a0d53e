"""What adequacy promises against what the resolver can do, which shares no code with it."""

from __future__ import annotations

import numpy as np
import pytest

import pinposture as pp
from pinposture.errors import TargetError

ROLLS = np.linspace(0.0, np.pi, 7)


def limited_arm(bend: float) -> pp.Arm:
    return pp.Arm.from_modules([pp.template("RyRz").with_limits(-bend, bend)] * 12)


def circle(curvature: float) -> pp.Curve:
    return pp.Curve.helix(radius=1.0 / curvature, pitch=0.0, turns=max(1.0, 0.7 * curvature / (2 * np.pi)))


def follows(arm: pp.Arm, curve: pp.Curve, roll: float) -> bool:
    try:
        pp.resolve_targets(arm, curve, roll=roll, method="sequential")
    except TargetError:
        return False
    return True


@pytest.mark.parametrize("bend", [0.2, 0.4, 0.8])
def test_circles_below_the_limit_are_followed_and_above_it_are_not(bend: float) -> None:
    arm = limited_arm(bend)
    limit = arm.adequate(circle(1.0)).max_curvature
    # The weaker hinge carries a bend alone at a roll of 0 or a quarter turn.
    alone = (0.0, np.pi / 2)
    assert all(follows(arm, circle(0.98 * limit), roll) for roll in alone)
    assert not all(follows(arm, circle(1.02 * limit), roll) for roll in alone)


def test_the_closed_form_of_the_limit() -> None:
    arm, bend = limited_arm(0.4), 0.4
    # First hinge: chords of one module length turn by q0. Second hinge: (6.1a) on a circle through the base.
    first = 2.0 * np.sin(bend / 2.0) / 0.05
    second = 2.0 * 0.025 * np.sin(bend) / (2 * 0.025**2 * (1 + np.cos(bend)))
    assert arm.adequate(circle(1.0)).max_curvature == pytest.approx(min(first, second), rel=1e-3)


def test_where_and_by_how_much_a_curve_is_too_much() -> None:
    arm = limited_arm(0.3)
    bend = [(0, 0, 0), (0.2, 0, 0), (0.25, 0, 0), (0.25, 0.05, 0), (0.25, 0.1, 0), (0.25, 0.5, 0)]
    result = arm.adequate(pp.Curve.spline(bend))
    assert not result
    assert result.curvature > result.max_curvature
    excess = result.excesses[0]
    assert excess.quantity == "curvature"
    assert 0.1 < excess.start < excess.end < 0.4
    assert excess.worst == pytest.approx(result.curvature, rel=1e-3)
    assert "times the" in str(excess)
    gentle = arm.adequate(pp.Curve.line((0, 0, 0), (1, 0, 0)))
    assert gentle
    assert gentle.excesses == ()


def test_too_much_torsion_is_found_too() -> None:
    arm = limited_arm(3.0)
    tight = pp.Curve.helix(radius=0.005, pitch=0.1, turns=8)  # torsion 57 /m, curvature 18 /m
    result = arm.adequate(tight)
    assert {excess.quantity for excess in result.excesses} == {"torsion"}
    assert result.torsion > result.max_torsion
