"""Points that an arm can take exactly, against the postures that they were read from."""

from __future__ import annotations

import numpy as np
import pytest
from sampling import seeds

import pinposture as pp
from pinposture.target.in_turn import exact_positions

ARMS = {
    "equal links": ("RyRz", 12, (0.05, 0.05)),
    "longer first": ("RyRz", 12, (0.06, 0.03)),
    "longer last": ("RyRz", 12, (0.03, 0.06)),
    "planar": ("Rz", 15, (0.1,)),
}


@pytest.mark.parametrize("name", ARMS)
@pytest.mark.parametrize("seed", seeds(5))
def test_points_of_any_posture_are_taken_again(name: str, seed: int) -> None:
    """Joints anywhere within +-pi: on the inner half of the torus as well, where branches differ."""
    template, modules, lengths = ARMS[name]
    arm = pp.Arm.from_template(template, modules, lengths)
    points = arm.at(arm.random(np.random.default_rng(seed))).points
    positions = exact_positions(arm, points)
    assert positions is not None
    assert arm.within_limits(arm.configuration(positions))
    np.testing.assert_allclose(arm.at(arm.configuration(positions)).points, points, atol=1e-9 * arm.length)


@pytest.mark.parametrize("moved", [0, 5, 11])
def test_points_that_the_arm_cannot_take_are_not(moved: int) -> None:
    arm = pp.Arm.from_template("RyRz", 12)
    points = arm.at(arm.random(np.random.default_rng(1))).points.copy()
    points[moved] += 1e-3
    assert exact_positions(arm, points) is None
    assert pp.fit_points(arm, points).residual.max() < 0.05  # the fit comes close all the same


def test_a_posture_outside_the_limits_is_not_found() -> None:
    narrow = pp.Arm.from_modules([pp.template("RyRz").with_limits(-0.5, 0.5)] * 4)
    wide = pp.Arm.from_template("RyRz", 4)
    bent = wide.at(wide.configuration(np.full(8, 0.8))).points
    assert exact_positions(wide, bent) is not None
    assert exact_positions(narrow, bent) is None


def test_modules_that_no_closed_form_places_by_their_end_are_left_to_the_fit() -> None:
    arm = pp.Arm.from_urdf(pp.Arm.from_template("Rz", 6).urdf, modules=2)  # two parallel hinges each
    assert exact_positions(arm, arm.at(arm.neutral()).points) is None
