"""How far control points travel, against figures known beforehand."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sampling import examples
from scipy.spatial.transform import Rotation

from pinposture.motion.trajectory import path_length_ratio


def straight_motion(steps=7, m=3):
    ends = np.random.default_rng(0).normal(size=(2, m, 3))
    shares = np.sort(np.r_[0.0, np.random.default_rng(1).uniform(size=steps - 1), 1.0])
    return ends[0] + shares[:, None, None] * (ends[1] - ends[0])


def test_the_sweep_of_a_straight_motion_is_one_and_of_a_corner_its_two_sides():
    assert path_length_ratio(straight_motion()) == pytest.approx(1.0, abs=1e-12)
    corner = np.array([[[0, 0, 0]], [[3, 0, 0]], [[3, 4, 0]]], dtype=float)
    assert path_length_ratio(corner) == pytest.approx(7 / 5)
    # Long ways count for more than short ones: (7 + 1) / (5 + 1).
    straight = np.array([[[0, 0, 0]], [[0.5, 0, 0]], [[1, 0, 0]]], dtype=float)
    assert path_length_ratio(np.concatenate([corner, straight], axis=1)) == pytest.approx(8 / 6)


def test_the_sweep_of_nothing_and_of_a_way_back_is_one():
    assert path_length_ratio(np.zeros((4, 2, 3))) == 1.0
    assert path_length_ratio(np.zeros((1, 2, 3))) == 1.0
    assert path_length_ratio(np.array([[[0, 0, 0]], [[1, 0, 0]], [[0, 0, 0]]], dtype=float)) == 1.0


@given(seed=st.integers(0, 10_000), scale=st.floats(1e-3, 1e3))
@examples(30)
def test_the_sweep_does_not_depend_on_where_things_are_nor_on_the_unit(seed, scale):
    rng = np.random.default_rng(seed)
    points = np.cumsum(rng.normal(size=(6, 4, 3)), axis=0)
    moved = scale * points @ Rotation.random(random_state=seed).as_matrix().T + rng.normal(size=3)
    assert path_length_ratio(points) >= 1.0
    assert path_length_ratio(moved) == pytest.approx(path_length_ratio(points), rel=1e-9)
