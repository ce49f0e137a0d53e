"""Lines, circles and helices against their closed forms."""

import numpy as np
import pytest

from pinposture.curve import Curve


def thesis_curve(t):
    """Equation (6.17), in metres."""
    return np.stack([0.6 * t, 0.06 * np.sin(8 * np.pi * t), 0.06 * np.cos(8 * np.pi * t)], axis=-1)


def test_the_helix_call_in_the_docstring_is_curve_6_17():
    curve = Curve.helix(0.06, 0.15, 4, handedness="left")
    length = np.hypot(0.6, 0.06 * 8 * np.pi)
    assert curve.length == pytest.approx(length, rel=1e-12)
    s = np.linspace(0, curve.length, 2003)
    np.testing.assert_allclose(curve.at(s), thesis_curve(s / length), atol=6e-12)  # 1e-10 of the radius


@pytest.mark.parametrize(
    ("radius", "pitch", "turns"),
    [(0.06, 0.15, 4), (0.2, 0.01, 1.37), (1.0, 5.0, 0.3), (0.05, 0.3, 40), (3, 1, 0.004)],
)
@pytest.mark.parametrize(("handedness", "sign"), [("right", 1), ("left", -1)])
def test_helix_has_the_curvature_torsion_and_length_of_a_helix(radius, pitch, turns, handedness, sign):
    curve = Curve.helix(radius, pitch, turns, axis=(0, 1, 1), center=(0.1, 0.2, -0.3), handedness=handedness)
    rise = pitch / (2 * np.pi)
    square = radius**2 + rise**2
    s = np.linspace(0, curve.length, 4001)
    assert curve.length == pytest.approx(2 * np.pi * turns * np.sqrt(square), rel=1e-12)
    np.testing.assert_allclose(curve.curvature(s), radius / square, rtol=1e-6)
    np.testing.assert_allclose(curve.torsion(s), sign * rise / square, rtol=1e-6)
    assert curve.dimension == 3


@pytest.mark.parametrize("axis", [(1, 0, 0), (0, 0, 1), (0, 0, -2), (1, 2, 3)])
def test_helix_turns_about_its_axis_from_the_documented_phase(axis):
    center = np.array([0.3, -0.1, 0.2])
    turns = 1.5
    along = np.array(axis) / np.linalg.norm(axis)
    towards = np.array([1.0, 0, 0]) if along[0] == along[1] == 0 else np.array([0, 0, 1.0])
    zero = towards - (towards @ along) * along
    zero /= np.linalg.norm(zero)
    for handedness, sign in (("right", 1), ("left", -1)):
        curve = Curve.helix(0.2, 0.4, turns, axis, center=center, phase=0.7, handedness=handedness)
        angle = 0.7 + 2 * np.pi * turns * np.linspace(0, 1, 50)[:, None]
        quarter = sign * np.cross(along, zero)
        expected = center + 0.2 * (np.cos(angle) * zero + np.sin(angle) * quarter)
        expected += 0.4 * (angle - 0.7) / (2 * np.pi) * along
        np.testing.assert_allclose(curve.resample(50), expected, atol=2e-11)


def test_helix_of_no_pitch_is_a_circle():
    circle = Curve.helix(0.5, 0, 1, axis=(0, 0, 1))
    assert circle.length == pytest.approx(np.pi, rel=1e-12)
    np.testing.assert_allclose(circle.curvature(circle._arc.lengths), 2, rtol=1e-6)
    assert circle.dimension == 2
    assert circle.torsion(1.0) == 0
    np.testing.assert_allclose(circle.start, [0.5, 0, 0], atol=1e-11)
    np.testing.assert_allclose(circle.at(np.pi / 4), [0, 0.5, 0], atol=1e-11)
    np.testing.assert_allclose(circle.end, circle.start, atol=1e-11)


def test_line_is_straight_and_measured():
    line = Curve.line((1, 2), (4, 6, 12))
    assert line.length == pytest.approx(13, rel=1e-15)
    np.testing.assert_allclose(line.at([0, 6.5, 13]), [[1, 2, 0], [2.5, 4, 6], [4, 6, 12]], atol=1e-14)
    np.testing.assert_allclose(line.tangent(5), np.array([3, 4, 12]) / 13, atol=1e-15)
    assert line.curvature(3) == 0
    assert line.torsion(3) == 0
    assert line.dimension == 2


def test_straight_spline_has_neither_curvature_nor_torsion():
    along = np.array([0, 0.1, 0.5, 0.55, 0.9, 1.3])[:, None]
    curve = Curve.spline(along * [0.3, -0.7, 0.2] + [1, 1, 1])
    s = np.linspace(0, curve.length, 100)
    np.testing.assert_allclose(curve.curvature(s), 0, atol=1e-9)
    np.testing.assert_array_equal(curve.torsion(s), 0)


def test_torsion_is_that_of_the_helix_until_it_is_all_but_straight():
    for radius, pitch in ((1e-3, 1), (1e-5, 1), (1e-6, 2)):
        curve = Curve.helix(radius, pitch, 1)
        assert curve.torsion(curve.length / 2) == pytest.approx(2 * np.pi / pitch, rel=1e-3)
    straight = Curve.helix(1e-6, 100, 1)  # curvature 4e-9 / m on 100 m
    assert straight.dimension == 3
    np.testing.assert_array_equal(straight.torsion(np.linspace(0, straight.length, 99)), 0)


def test_torsion_is_finite_where_the_curvature_vanishes_in_space():
    # x = t, y = t^3, z = t^4 has an inflection at t = 0, as the Bernstein form of degree 4 on [-1, 1].
    t = np.linspace(-1, 1, 5)
    bernstein = [[1, 1, 1, 1, 1], [-1, -0.5, 0, 0.5, 1], [-1, 0.5, 0, -0.5, 1], [1, -1, 1, -1, 1]]
    curve = Curve.spline(np.transpose(bernstein[1:]), degree=4)
    np.testing.assert_allclose(curve.nearest(np.stack([t, t**3, t**4], axis=1)).distance, 0, atol=1e-12)
    inflection = curve.nearest([0, 0, 0]).parameter
    assert curve.curvature(inflection) == pytest.approx(0, abs=1e-6)
    assert np.isfinite(curve.torsion(np.linspace(0, curve.length, 10_001))).all()
    assert curve.torsion(inflection) == 0
    # Torsion at t = 0.5 from the derivatives by hand.
    d1 = np.array([1, 0.75, 0.5])
    d2 = np.array([0, 3, 3])
    d3 = np.array([0, 6, 12])
    cross = np.cross(d1, d2)
    s = curve.nearest([0.5, 0.125, 0.0625]).parameter
    assert curve.torsion(s) == pytest.approx(cross @ d3 / (cross @ cross), rel=1e-6)
    assert curve.curvature(s) == pytest.approx(np.linalg.norm(cross) / np.linalg.norm(d1) ** 3, rel=1e-6)
