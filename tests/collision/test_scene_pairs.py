"""Pairs that no motion can keep apart."""

from __future__ import annotations

import numpy as np
import pytest

import pinposture as pp


def test_what_is_beside_the_base_is_left_out_with_a_warning_and_does_not_stop_the_arm():
    arm = pp.Arm.from_template("RyRz", 6)
    mount = pp.Scene({"mount": pp.HalfSpace([0, 0, 0], [1, 0, 0])}, margin=0.02)
    with pytest.warns(pp.PostureWarning, match="m01_l2 to mount: within the margin however the arm bends"):
        clearance = pp.CollisionModel(arm, mount)
    assert ("m01_l2", "mount") in {(each.first, each.second) for each in clearance.excluded_pairs}
    assert ("m02_l1", "mount") in clearance.pairs  # which can keep the margin
    start = np.full(12, 0.1)
    run = pp.track(arm, pp.Target.from_configuration(arm, arm.neutral()), start, scene=mount)
    assert run.converged


def test_an_arm_inside_of_an_obstacle_is_told_so_for_all_of_its_bodies():
    arm = pp.Arm.from_template("RyRz", 6)
    clearance = pp.CollisionModel(arm, pp.Scene({"block": pp.Box([0, 0, 0], [9, 9, 9])}))
    assert not clearance.excluded_pairs or all(each.first == "m01_l1" for each in clearance.excluded_pairs)
    assert clearance.minimum(arm.neutral()).distance < -1.0
