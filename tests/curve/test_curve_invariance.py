"""What must not depend on where a curve lies, which way it runs, or how much of it is kept."""

import copy
import pickle

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from sampling import examples
from scipy.spatial.transform import Rotation

from pinposture.curve import Curve
from pinposture.errors import CurveError

coordinate = st.integers(-50, 50).map(lambda i: i / 50)
point = st.tuples(coordinate, coordinate, coordinate)


@st.composite
def curves(draw):
    degree = draw(st.integers(1, 5))
    points = draw(st.lists(point, min_size=degree + 1, max_size=9))
    try:
        return Curve.spline(points, degree, through=draw(st.booleans()))
    except CurveError:
        assume(False)


rotations = st.tuples(*[st.floats(-3, 3)] * 3).map(lambda v: Rotation.from_rotvec(v).as_matrix())


@examples(60)
@given(curves(), rotations, point)
def test_motion_moves_the_places_and_keeps_the_shape(curve, rotation, translation):
    moved = curve.moved(rotation, translation)
    s = np.linspace(0.01, 0.99, 37) * curve.length
    stretch = moved.length / curve.length
    assert stretch == pytest.approx(1, abs=1e-11)
    size = max(1.0, np.abs(curve.coefficients).max())
    np.testing.assert_allclose(
        moved.at(s * stretch), curve.at(s) @ rotation.T + translation, atol=1e-9 * size
    )
    assert moved.dimension == curve.dimension
    smooth = curve.curvature(s) < 1e2  # next to a cusp both depend on the last bit of s
    if curve.degree > 1:
        np.testing.assert_allclose(
            moved.curvature(s * stretch)[smooth], curve.curvature(s)[smooth], rtol=1e-5, atol=1e-5
        )


@examples(40)
@given(rotations, point)
def test_motion_keeps_the_torsion(rotation, translation):
    curve = Curve.spline(
        [[0, 0, 0], [0.2, 0.1, 0], [0.3, 0.4, 0.2], [0.1, 0.5, 0.4], [-0.2, 0.3, 0.5], [0, 0, 0.7]]
    )
    s = np.linspace(0.01, 0.99, 37) * curve.length
    moved = curve.moved(rotation, translation)
    np.testing.assert_allclose(moved.torsion(s), curve.torsion(s), rtol=1e-7, atol=1e-7)


@examples(60)
@given(curves())
def test_arc_length_is_at_least_the_chord_and_at_most_the_control_polygon(curve):
    polygon = np.linalg.norm(np.diff(curve.coefficients, axis=0), axis=1).sum()
    fine = np.linalg.norm(np.diff(curve.resample(2001), axis=0), axis=1).sum()
    assert fine <= curve.length * (1 + 1e-12) <= polygon * (1 + 1e-9)
    assert fine >= curve.length * (1 - 1e-2)


@examples(60)
@given(curves())
def test_reversed_runs_back_over_the_same_places(curve):
    back = curve.reversed()
    s = np.linspace(0, 1, 31) * curve.length
    size = max(1.0, np.abs(curve.coefficients).max())
    assert back.length == pytest.approx(curve.length, rel=1e-11)
    np.testing.assert_allclose(
        back.at(np.clip(curve.length - s, 0, back.length)), curve.at(s), atol=1e-9 * size
    )


@examples(60)
@given(curves(), st.floats(0, 1), st.floats(0, 1))
def test_trimmed_is_the_part_between(curve, a, b):
    a, b = sorted((a * curve.length, b * curve.length))
    assume(b - a > 1e-3 * curve.length)
    part = curve.trimmed(a, b)
    s = np.linspace(0, 1, 31) * (b - a)
    size = max(1.0, np.abs(curve.coefficients).max())
    assert part.length == pytest.approx(b - a, abs=1e-9 * curve.length)
    np.testing.assert_allclose(part.at(np.minimum(s, part.length)), curve.at(a + s), atol=1e-9 * size)


def test_trimmed_helix_keeps_its_torsion():
    helix = Curve.helix(0.06, 0.15, 4)
    part = helix.trimmed(0.3, 0.301)
    np.testing.assert_allclose(part.torsion(np.linspace(0, part.length, 9)), helix.torsion(0.3), rtol=1e-6)
    assert helix.trimmed(0, helix.length) == helix


def test_dimension_is_2_in_any_plane():
    flat = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 2, 0]])
    turn = Rotation.from_rotvec([0.3, 0.8, -0.4]).as_matrix()
    curve = Curve.spline(flat).moved(turn, (5, 5, 5))
    assert curve.dimension == 2
    np.testing.assert_array_equal(curve.torsion(np.linspace(0, curve.length, 9)), 0)
    assert Curve.spline(flat[:, :2]) == Curve.spline(flat)
    bent = flat.astype(float)
    bent[2, 2] = 1e-4
    assert Curve.spline(bent).dimension == 3


def test_copies_are_equal_and_immutable():
    curve = Curve.helix(0.1, 0.2, 1)
    for twin in (
        pickle.loads(pickle.dumps(curve)),
        copy.deepcopy(curve),
        Curve(curve.knots, curve.coefficients, 5),
    ):
        assert twin == curve
        assert hash(twin) == hash(curve)
        np.testing.assert_array_equal(twin.resample(50), curve.resample(50))
        with pytest.raises(ValueError, match="read-only"):
            twin.coefficients[0, 0] = 7
    with pytest.raises(AttributeError):
        curve.degree = 2
    assert curve != Curve.helix(0.1, 0.2, 1, phase=1e-9)
    assert curve != "helix"


def test_points_given_can_be_changed_afterwards():
    points = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [2, 1, 0]])
    curve = Curve.spline(points)
    points[:] = 0
    np.testing.assert_array_equal(curve.end, [2, 1, 0])
    knots = curve.knots.copy()
    coefficients = curve.coefficients.copy()
    raw = Curve(knots, coefficients, 3)
    coefficients[:] = 0
    assert raw == curve
    np.testing.assert_array_equal(raw.end, [2, 1, 0])


def test_repr_tells_length_ends_and_degree():
    text = repr(Curve.line((0, 0), (0.25, 0)))
    assert text == "Curve(length 0.25 m, from (0, 0, 0) to (0.25, 0, 0), degree 1, 1 span)"
