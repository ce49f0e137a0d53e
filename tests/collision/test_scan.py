"""Scans as values: what they hold, what they refuse, how they are thinned."""

from __future__ import annotations

import pickle
import warnings

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from nearest import distances_to_nearest
from sampling import examples

from pinposture.collision import Scan
from pinposture.collision.scan import MAX_SCAN_SIZE
from pinposture.errors import InvalidValue, PostureWarning

FACES = np.arange(18).reshape(6, 3)


@pytest.fixture
def cloud():
    return np.random.default_rng(0).normal(size=(20, 3))


def grid(count=40):
    """A wavy surface of so many points along each edge, with colours."""
    x, y = np.meshgrid(np.linspace(0, 1, count), np.linspace(0, 1, count), indexing="ij")
    points = np.stack([x, y, 0.1 * np.sin(6 * x)], axis=-1).reshape(-1, 3)
    at = np.arange(count * count).reshape(count, count)
    lower = np.stack([at[:-1, :-1], at[1:, :-1], at[:-1, 1:]], axis=-1).reshape(-1, 3)
    upper = np.stack([at[1:, 1:], at[:-1, 1:], at[1:, :-1]], axis=-1).reshape(-1, 3)
    colors = np.clip(points * 200, 0, 255).astype(np.uint8)
    return Scan(points, np.concatenate([lower, upper]), colors, "wave")


def test_a_scan_holds_what_it_was_given_and_no_more_than_that(cloud):
    given_points = cloud.copy()
    scan = Scan(given_points, FACES, (cloud > 0) * 255, "room")
    given_points[:] = 0.0
    np.testing.assert_array_equal(scan.points, cloud)
    np.testing.assert_array_equal(scan.faces, FACES)
    np.testing.assert_array_equal(scan.colors, np.where(cloud > 0, 255, 0))
    assert (scan.points.dtype, scan.faces.dtype, scan.colors.dtype) == (np.float64, np.int32, np.uint8)
    assert (scan.name, scan.path, scan.dropped) == ("room", None, 0)
    for array in (scan.points, scan.faces, scan.colors):
        with pytest.raises(ValueError, match="read-only"):
            array[0, 0] = 1
    assert repr(scan) == "Scan('room', 20 points, 6 triangles)"
    assert Scan(cloud).faces is None and Scan(cloud).colors is None


def test_points_that_are_not_finite_are_left_out_with_their_triangles_and_colors(cloud):
    points = cloud.copy()
    points[4, 1] = np.nan
    points[7, 0] = np.inf
    points[19] = -np.inf
    colors = np.arange(60, dtype=np.uint8).reshape(20, 3)
    scan = Scan(points, FACES, colors)
    assert scan.dropped == 3 and len(scan.points) == 17
    kept = [k for k in range(20) if k not in (4, 7, 19)]
    np.testing.assert_array_equal(scan.points, cloud[kept])
    np.testing.assert_array_equal(scan.colors, colors[kept])
    left = [face for face in FACES if not {4, 7, 19} & set(face)]
    np.testing.assert_array_equal(scan.points[scan.faces], cloud[np.array(left)])
    assert "3 dropped" in repr(scan)


@pytest.mark.parametrize(
    ("values", "name"),
    [
        ({"points": np.zeros((0, 3))}, "points"),
        ({"points": np.full((5, 3), np.nan)}, "points"),
        ({"points": np.zeros((5, 2))}, "points"),
        ({"points": np.zeros(3)}, "points"),
        ({"points": [["a", "b", "c"]]}, "points"),
        ({"points": [[1, 2], [3]]}, "points"),
        ({"points": np.full((2, 3), 1e5)}, "largest coordinate"),
        ({"points": np.broadcast_to(0.0, (MAX_SCAN_SIZE + 1, 3))}, "number"),
        ({"faces": [[0, 1, 20]]}, "faces"),
        ({"faces": [[0, -1, 2]]}, "faces"),
        ({"faces": [[0, 1]]}, "faces"),
        ({"faces": [[0.0, 1.0, 2.0]]}, "faces"),
        ({"faces": np.zeros((0, 3), dtype=int)}, "faces"),
        ({"colors": np.zeros((19, 3), dtype=np.uint8)}, "colors"),
        ({"colors": np.full((20, 3), 256)}, "colors"),
        ({"colors": np.full((20, 3), -1)}, "colors"),
        ({"colors": np.full((20, 3), 1.5)}, "colors"),
        ({"colors": np.full((20, 3), np.nan)}, "colors"),
        ({"colors": "red"}, "colors"),
        ({"name": " "}, "name"),
        ({"name": 3}, "name"),
    ],
)
def test_what_is_no_scan_is_refused_by_name(cloud, values, name):
    with pytest.raises(InvalidValue, match=name):
        Scan(**{"points": cloud, **values})


def test_colors_are_whole_numbers_or_shares(cloud):
    shares = np.linspace(0, 1, 60).reshape(20, 3)
    np.testing.assert_array_equal(Scan(cloud, colors=shares).colors, np.round(shares * 255))
    assert Scan(cloud, colors=np.ones((20, 3), dtype=int)).colors.max() == 1


def test_a_scan_that_is_too_wide_is_warned_of_once_and_not_when_it_is_thinned(cloud):
    with pytest.warns(PostureWarning, match=r"wide.*scale=0.001"):
        scan = Scan(cloud * 100)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        scan.thinned(3)
        pickle.loads(pickle.dumps(scan))
        Scan(cloud)


def test_a_scan_pickles(cloud):
    points = cloud.copy()
    points[18] = np.nan
    scan = Scan(points, FACES, colors=np.zeros((20, 3), dtype=np.uint8), name="a")
    assert scan.tree is scan.tree
    again = pickle.loads(pickle.dumps(scan))
    for key in ("points", "faces", "colors"):
        np.testing.assert_array_equal(getattr(again, key), getattr(scan, key))
    assert (again.name, again.dropped) == ("a", 1)
    with pytest.raises(ValueError, match="read-only"):
        again.points[0] = 0.0


@examples(40)
@given(st.integers(1, 3000), st.integers(1, 3000), st.integers(0, 3), st.integers(0, 2**31))
def test_thinning_keeps_no_more_than_asked_and_some_of_the_points(number, count, kind, seed):
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(number, 3)) * [1.0, 1.0 if kind < 2 else 0.0, 1.0 if kind < 1 else 0.0]
    points = points if kind < 3 else np.zeros((number, 3))
    colors = rng.integers(0, 256, (number, 3), dtype=np.uint8)
    thin = Scan(points, colors=colors).thinned(count)
    assert 1 <= len(thin.points) <= max(count, 0) and (number > count or len(thin.points) == number)
    rows = {(*point, *color) for point, color in zip(points.tolist(), colors.tolist(), strict=True)}
    assert all((*p, *c) in rows for p, c in zip(thin.points.tolist(), thin.colors.tolist(), strict=True))


@pytest.mark.long
def test_what_is_left_of_a_surface_lies_as_it_did():
    scan = grid(50)
    for count in (100, 400, 1500):
        thin = Scan(scan.points).thinned(count)
        assert 0.4 * count <= len(thin.points) <= count
        assert distances_to_nearest(scan.points, thin.points).max() < 3.0 / np.sqrt(count)


def test_a_thinned_surface_is_a_surface_without_triangles_that_are_none():
    scan = grid()
    thin = scan.thinned(300)
    assert (thin.name, thin.path) == ("wave", None) and len(thin.points) <= 300
    assert len(np.unique(np.sort(thin.faces, axis=1), axis=0)) == len(thin.faces)
    corners = thin.points[thin.faces]
    assert np.all(thin.faces != np.roll(thin.faces, 1, axis=1))

    def area(corners):
        return np.linalg.norm(
            np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
        ).sum()

    assert area(corners) == pytest.approx(area(scan.points[scan.faces]), rel=0.2)
    assert scan.thinned(1600) is scan
    for wrong in (0, -1, 2.5, True, None):
        with pytest.raises(InvalidValue, match="count"):
            scan.thinned(wrong)
    with pytest.raises(InvalidValue, match="no triangle"):
        scan.thinned(1)
