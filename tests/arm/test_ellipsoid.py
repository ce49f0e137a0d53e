"""Ellipsoids are the velocities that unit joint velocities make, and say how near a singularity is."""

from __future__ import annotations

import itertools
import pickle
from functools import cache

import numpy as np
import pinocchio as pin
import pytest
from arms import template_arm
from hypothesis import given
from hypothesis import strategies as st
from sampling import examples

import pinposture as pp
from pinposture.errors import InvalidValue, UnknownName

LENGTHS = (0.4, 0.25)
TILTED = pin.SE3(pin.utils.rpyToMatrix(0.3, -0.8, 1.1), np.array([0.2, -0.1, 0.4]))

SLIDING = """<robot name="r"><link name="a"/><link name="b"/><link name="c"/><link name="d"/>
<joint name="turn" type="revolute"><axis xyz="0 0 1"/><parent link="a"/><child link="b"/>
<limit lower="-3" upper="3" velocity="1" effort="1"/></joint>
<joint name="slide" type="prismatic"><axis xyz="1 0 0"/><parent link="b"/><child link="c"/>
<limit lower="0" upper="1" velocity="1" effort="1"/></joint>
<joint name="end" type="fixed"><origin xyz="0.5 0 0"/><parent link="c"/><child link="d"/></joint></robot>"""


@cache
def two():
    return pp.Arm.from_modules([pp.template("Rz").with_lengths([length]) for length in LENGTHS])


def spatial():
    return template_arm("RyRz", 6)


def planar():
    return template_arm("Rz", 5, (0.1,))


@cache
def placed():
    return pp.Arm.from_template("RyRz", modules=20, base_placement=TILTED)


def long():
    return template_arm("RyRz", 60)


@pytest.fixture
def rng():
    return np.random.default_rng(5)


def finite_differences(arm: pp.Arm, q: np.ndarray, point: int) -> np.ndarray:
    """Jacobian of a control point from differences of its positions, (3, nv)."""
    steps = 1e-6 * np.eye(arm.nv)
    ahead, back = ([arm.at(arm.integrate(q, s * step)).points[point] for step in steps] for s in (1, -1))
    return (np.array(ahead) - np.array(back)).T / 2e-6


def unit_velocities(rng: np.random.Generator, count: int, dimension: int) -> np.ndarray:
    drawn = rng.standard_normal((count, dimension))
    return drawn / np.linalg.norm(drawn, axis=1, keepdims=True)


@given(q1=st.floats(-3.0, 3.0), q2=st.floats(-3.0, 3.0))
@examples(40)
def test_two_links_in_a_plane_have_the_closed_form_of_the_textbooks(q1, q2):
    (tip,) = two().at([q1, q2]).ellipsoids([1])
    l1, l2 = LENGTHS
    # det J = l1 l2 sin q2, and the squares of both radii add up to the sum of the squares of J.
    assert tip.measure == pytest.approx(l1 * l2 * abs(np.sin(q2)), abs=1e-13)
    total = l1**2 + 2.0 * l2**2 + 2.0 * l1 * l2 * np.cos(q2)
    assert (tip.radii**2).sum() == pytest.approx(total, rel=1e-12)
    x = l1 * np.cos(q1) + l2 * np.cos(q1 + q2)
    y = l1 * np.sin(q1) + l2 * np.sin(q1 + q2)
    np.testing.assert_allclose(tip.center, [x, y, 0.0], atol=1e-14)


def test_an_elbow_at_the_angle_of_yoshikawa_is_a_circle():
    arm = pp.Arm.from_modules([pp.template("Rz").with_lengths([x]) for x in (np.sqrt(2.0), 1.0)])
    tip = arm.at([0.7, 0.75 * np.pi]).ellipsoids(-1)[0]  # l1 = sqrt(2) l2: isotropic at 135 degrees
    assert tip.condition == pytest.approx(1.0)
    assert tip.index == pytest.approx(1.0)
    assert tip.smallest == pytest.approx(1.0)
    assert tip.measure == pytest.approx(1.0)


@pytest.mark.parametrize("make", [spatial, planar, placed, two])
def test_unit_joint_velocities_fill_the_ellipsoid_and_touch_it(make, rng):
    arm = make()
    q = arm.random(rng)
    point = arm.n_modules - 1
    (tip,) = arm.at(q).ellipsoids(point)
    jacobian = finite_differences(arm, q, point)
    reached = unit_velocities(rng, 4000, arm.nv) @ jacobian.T @ tip.directions.T  # along the axes, (4000, d)
    inside = np.sum((reached / tip.radii) ** 2, axis=1)
    assert inside.max() <= 1.0 + 1e-7
    # Of all unit joint velocities those in the row space of the Jacobian go as far as there is.
    outward = unit_velocities(rng, 500, arm.dimension) @ tip.directions
    most = np.linalg.lstsq(jacobian, outward.T, rcond=None)[0]
    touching = (most / np.linalg.norm(most, axis=0)).T @ jacobian.T @ tip.directions.T
    np.testing.assert_allclose(np.sum((touching / tip.radii) ** 2, axis=1), 1.0, rtol=1e-6)


@pytest.mark.parametrize("make", [spatial, placed])
def test_measures_agree_with_numpy_and_with_the_manipulability_indices(make, rng):
    arm = make()
    q = arm.random(rng)
    state = arm.at(q)
    for relative_to in ("base", "previous"):
        for one in state.ellipsoids([2, 5], relative_to):
            jacobian = finite_differences(arm, q, one.point)[:, 2 * one.base :]
            assert one.condition == pytest.approx(np.linalg.cond(jacobian), rel=1e-6)
            assert one.measure == pytest.approx(np.sqrt(np.linalg.det(jacobian @ jacobian.T)), rel=1e-6)
            assert one.smallest == pytest.approx(np.linalg.norm(jacobian, -2), rel=1e-6)
            assert one.index == pytest.approx(state.manipulability()[one.base, one.point + 1], abs=1e-7)


def test_a_section_is_that_from_the_chosen_control_point_before(rng):
    q = spatial().random(rng)
    state = spatial().at(q)
    assert [one.base for one in state.ellipsoids([4, 1, 3], "previous")] == [4, 0, 2]
    assert [one.base for one in state.ellipsoids(None, "previous")] == list(range(6))
    assert [one.base for one in state.ellipsoids([4, 1, 3])] == [0, 0, 0]
    # Joints of modules 1 and 2 held still: as an arm of the other modules that stands there.
    (_, held) = state.ellipsoids([1, 4], "previous")
    rest = pp.Arm.from_template(
        "RyRz", modules=3, base_placement=pin.SE3(state.rotations[1], state.points[1])
    )
    (alone,) = rest.at(q[4:10]).ellipsoids(2)
    np.testing.assert_allclose(held.radii, alone.radii, atol=1e-14)
    np.testing.assert_allclose(held.center, alone.center, atol=1e-14)
    np.testing.assert_allclose(np.abs(np.sum(held.directions * alone.directions, axis=1)), 1.0)


@pytest.mark.parametrize("make", [spatial, placed, long])
def test_a_straight_arm_is_singular_along_itself(make):
    arm = make()
    along = arm.chain.points[-1] - arm.chain.base
    along /= np.linalg.norm(along)
    for one in arm.at(arm.neutral()).ellipsoids():
        assert (one.measure, one.condition, one.smallest, one.index) == (0.0, np.inf, 0.0, 0.0)
        assert abs(one.directions[2] @ along) == pytest.approx(1.0)
        assert one.radii[1] > 0.0


@given(seed=st.integers(0, 10**6), spread=st.sampled_from([0.0, 1e-9, 1e-3, 0.5, 3.0]))
@examples(40)
def test_ellipsoids_are_finite_sorted_orthonormal_and_right_handed(seed, spread):
    rng = np.random.default_rng(seed)
    for arm in (spatial(), placed(), planar(), two()):
        state = arm.at(spread * rng.uniform(-1.0, 1.0, arm.nq))
        normal = np.cross(*arm.plane[:2])
        for one in itertools.chain(state.ellipsoids(), state.ellipsoids(None, "previous")):
            d = arm.dimension
            assert one.directions.shape == (d, 3)
            assert np.all(np.isfinite(one.radii))
            assert np.all(np.diff(one.radii) <= 0.0)
            assert one.radii[-1] >= 0.0
            np.testing.assert_allclose(one.directions @ one.directions.T, np.eye(d), atol=1e-12)
            third = one.directions[2] if d == 3 else normal
            np.testing.assert_allclose(np.cross(*one.directions[:2]), third, atol=1e-12)
            measures = np.array([one.measure, one.smallest, one.index, one.condition])
            assert not np.any(np.isnan(measures))
            assert 0.0 <= one.index <= 1.0
            assert one.condition >= 1.0
            # The ellipsoid is the Jacobian but for a rotation of joint space: A^T A = J J^T.
            jacobian = state.jacobians[one.point][:, arm.module_starts[one.base] :]
            gram = one.semi_axes.T @ one.semi_axes
            np.testing.assert_allclose(gram, jacobian @ jacobian.T, atol=1e-12)


def test_a_module_with_fewer_joints_than_dimensions_is_flat_and_one_that_moves_nothing_is_a_point():
    (first,) = planar().at(np.zeros(5)).ellipsoids(0)
    np.testing.assert_allclose(first.radii, [0.1, 0.0])
    np.testing.assert_allclose(np.abs(first.directions[0]), [0.0, 1.0, 0.0], atol=1e-15)
    text = planar().urdf
    arm = pp.Arm.from_model(pin.buildModelFromXML(text), ["m01_j1_z", "m05_l1"])
    (still, tip) = arm.at(arm.neutral()).ellipsoids()  # the frame of a joint lies on its axis
    assert (still.measure, still.condition, still.smallest, still.index) == (0.0, np.inf, 0.0, 0.0)
    np.testing.assert_array_equal(still.radii, [0.0, 0.0])
    assert tip.radii[0] > 0.1


def test_a_slide_counts_in_the_units_of_the_arm():
    arm = pp.Arm.load(SLIDING, split=2)
    for unit in (0.1, 2.0):
        (tip,) = arm.with_characteristic_length(unit).at([0.4, 0.3]).ellipsoids(0)
        assert tip.measure == pytest.approx(0.8 * unit)  # the turn moves it by 0.8 m/rad, across the slide
        np.testing.assert_allclose(tip.radii, sorted([0.8, unit], reverse=True))


def test_points_are_chosen_by_index_by_name_or_all(rng):
    state = spatial().at(spatial().random(rng))
    assert [one.point for one in state.ellipsoids()] == [0, 1, 2, 3, 4, 5]
    assert [one.point for one in state.ellipsoids(["module_05", 0, -1, np.int64(2)])] == [4, 0, 5, 2]
    assert [one.point for one in state.ellipsoids("module_02")] == [1]
    assert [one.point for one in state.ellipsoids(np.array([3, 1]))] == [3, 1]
    assert state.ellipsoids([]) == ()
    for one in state.ellipsoids():
        np.testing.assert_array_equal(one.center, state.points[one.point])


@pytest.mark.parametrize("points", [6, [-7], [1.0], True, [None], 2.5, [[1]], [1, 1], ["module_06", -1]])
def test_what_is_no_choice_of_points_is_refused(points):
    with pytest.raises(InvalidValue, match="points"):
        spatial().at(spatial().neutral()).ellipsoids(points)


def test_unknown_names_are_refused_with_those_there_are():
    state = spatial().at(spatial().neutral())
    with pytest.raises(UnknownName, match="module_06"):
        state.ellipsoids(["module_6"])
    with pytest.raises(UnknownName, match="previous"):
        state.ellipsoids([1], relative_to="next")


def test_an_ellipsoid_cannot_be_written_to_and_pickles(rng):
    one = spatial().at(spatial().random(rng)).ellipsoids(3)[0]
    for array in (one.center, one.directions, one.radii):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0.0
    again = pickle.loads(pickle.dumps(one))
    np.testing.assert_array_equal(again.semi_axes, one.semi_axes)
    assert again.condition == one.condition
