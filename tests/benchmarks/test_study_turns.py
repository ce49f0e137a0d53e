"""How far parts of an arm turn: against sums of joint angles, where those are all there is to it."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from arms import template_arm
from hypothesis import given
from hypothesis import strategies as st
from sampling import examples

import pinposture as pp
from benchmarks.cases.scenarios import largest_turn

TILTED = pin.SE3(pin.rpy.rpyToMatrix(0.3, -0.4, 1.1), np.array([0.1, -0.2, 0.5]))

angles = st.lists(st.floats(-1.5, 1.5), min_size=10, max_size=10).map(np.array)


@pytest.fixture(scope="session")
def flat():
    return template_arm("RzRz", 5)


@pytest.fixture(scope="session")
def spatial():
    return template_arm("RyRz", 10)


def in_a_plane(bends: np.ndarray, place: int) -> np.ndarray:
    """The spatial arm with the joints at one place of each module alone: it stays in a plane."""
    q = np.zeros(20)
    q[place::2] = bends
    return q


@examples(40)
@given(angles, angles)
def test_of_a_planar_arm_it_is_the_largest_partial_sum_of_the_joint_changes(flat, start, goal):
    turned, largest = 0.0, 0.0
    for a, b in zip(start, goal, strict=True):
        turned += b - a
        largest = max(largest, abs(turned))
    assert largest_turn(flat, start, goal) == pytest.approx(largest, abs=1e-12)


@examples(40)
@given(angles, angles, st.integers(0, 1))
def test_a_spatial_arm_that_stays_in_a_plane_turns_as_a_planar_one(spatial, start, goal, place):
    found = largest_turn(spatial, in_a_plane(start, place), in_a_plane(goal, place))
    assert found == pytest.approx(np.abs(np.cumsum(goal - start)).max(), abs=1e-9)


def test_full_turns_count(flat, spatial):
    curled = np.full(10, 1.0)
    assert largest_turn(flat, np.zeros(10), curled) == pytest.approx(10.0)
    assert largest_turn(spatial, np.zeros(20), in_a_plane(curled, 1)) == pytest.approx(10.0)


def test_slides_do_not_turn_and_continuous_joints_take_the_short_way():
    joints = (pp.JointSpec("z", type="continuous"), pp.JointSpec("y", type="prismatic", lower=0.0, upper=0.1))
    module = pp.ModuleTemplate("slide", joints, (0.1, 0.1))
    arm = pp.Arm.from_modules([module] * 2, base_placement=TILTED)
    assert arm.dimension == 2
    start, goal = arm.configuration([3.0, 0.0, 0.0, 0.0]), arm.configuration([-3.0, 0.1, 0.5, 0.1])
    assert largest_turn(arm, start, goal) == pytest.approx(2.0 * np.pi - 6.0 + 0.5)


def test_where_the_arm_stands_does_not_matter(spatial):
    rng = np.random.default_rng(3)
    start, goal = rng.uniform(-1.0, 1.0, (2, 20))
    moved = pp.Arm.from_template("RyRz", 10, base_placement=TILTED)
    assert largest_turn(moved, start, goal) == pytest.approx(largest_turn(spatial, start, goal))
    assert largest_turn(spatial, start, start) == pytest.approx(0.0, abs=1e-9)
