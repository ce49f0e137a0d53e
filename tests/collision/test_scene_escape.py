"""The way out where two solids lie in each other and the distance gives no direction."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sampling import examples

from pinposture.collision.model import escape_direction

SPACE, PLANE = np.eye(3), np.eye(3)[:2]


@pytest.mark.parametrize(
    ("first", "second", "expected"),
    [
        ([(0, 0, 0), (1, 0, 0)], [(0.5, -1, 0), (0.5, 1, 0)], [(0, 0, 1), (0, 0, -1)]),  # they cross
        ([(0, 0, 0), (1, 0, 0)], [(0.5, 0.2, 0), (2, 0.2, 0)], [(0, -1, 0)]),  # side by side
        ([(0, 0, 0), (0, 0, 0)], [(0, 0, 0), (0, 0, 0)], [(0, 0, 1)]),  # two points in one place
    ],
)
def test_in_space_it_is_across_both(first, second, expected):
    found = escape_direction(np.array(first, float), np.array(second, float), SPACE)
    assert any(np.allclose(found, each) for each in expected)


def test_in_space_one_line_on_another_goes_across_it():
    line = np.array([(0, 0, 0), (1.0, 2, 3)])
    found = escape_direction(line, 2 * line, SPACE)
    assert found @ line[1] == pytest.approx(0.0, abs=1e-12) and np.linalg.norm(found) == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("first", "second", "expected"),
    [
        ([(0, 0, 0), (1, 0, 0)], [(0.9, -1, 0), (0.9, 1, 0)], (-1, 0, 0)),  # only its end is across
        ([(0, 0, 0), (1, 0, 0)], [(0.5, -0.1, 0), (0.5, 1, 0)], (0, -1, 0)),  # the other's end is nearer
        ([(0, 0, 0), (1, 0, 0)], [(0.5, -0.1, -1), (0.5, -0.1, 1)], (0, 1, 0)),  # an upright post beside
        ([(0, 0, 0), (0, 0, 1)], [(0.2, 0, 0), (0.2, 0, 1)], (-1, 0, 0)),  # two upright posts
        ([(0, 0, 0), (0, 0, 1)], [(0, 0, 0), (0, 0, 1)], (1, 0, 0)),  # in one place
    ],
)
def test_in_a_plane_it_is_the_shortest_way_out_within_it(first, second, expected):
    found = escape_direction(np.array(first, float), np.array(second, float), PLANE)
    np.testing.assert_allclose(found, expected, atol=1e-12)


places = st.lists(st.sampled_from([-1.0, 0.0, 1e-9, 0.3, 2.0]), min_size=6, max_size=6)


@examples(40)
@given(places, places, st.booleans())
def test_there_is_always_one(first, second, planar):
    plane = PLANE if planar else SPACE
    found = escape_direction(np.reshape(first, (2, 3)), np.reshape(second, (2, 3)), plane)
    assert np.linalg.norm(found) == pytest.approx(1.0)
    assert not planar or found[2] == 0.0
