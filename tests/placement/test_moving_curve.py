"""A target resolved anew while its curve moves changes by as little as the curve."""

from __future__ import annotations

import numpy as np
import pytest
from arms import template_arm

import pinposture as pp
from pinposture.placement.module_kinematics import arm_units


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
    arm, step = template_arm(*described), 1e-4
    for time in np.linspace(0.0, 6.0, 12):
        one, two = (
            pp.resolve_targets(arm, swaying(t, arm.dimension == 2), placement=placement)
            for t in (time, time + step)
        )
        assert one.method == two.method == "sequential"
        assert np.abs(one.points - two.points).max() < step * arm.length
        # A turn of a module may move by more than the curve does, but not by orders of magnitude.
        assert np.abs(one.q - two.q).max() < 20 * step


def test_the_solvers_one_after_the_other_are_the_arm() -> None:
    modules = [pp.template("RyRz").with_lengths((0.03, 0.02)), pp.template("RzRz"), pp.template("RzRy")]
    arm = pp.Arm.from_modules(modules)
    units = arm_units(arm)
    q = 0.3 * np.random.default_rng(0).normal(size=arm.nv)
    turn, point, ends = np.eye(3), arm.chain.base, []
    for unit in units:
        frame = turn @ unit.frame
        position, end = unit.kinematics.forward(q[unit.joints])
        point, turn = point + frame @ position, frame @ end @ unit.frame.T
        ends.append(point)
    last = [max(i for i, unit in enumerate(units) if unit.module == k) for k in range(arm.n_modules)]
    np.testing.assert_allclose(np.array(ends)[last], arm.at(arm.configuration(q)).points, atol=1e-14)
