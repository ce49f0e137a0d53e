"""Best indices of sections, against searches over all postures."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from analytic import enumeration, planar
from hypothesis import given
from hypothesis import strategies as st
from sampling import examples, seeds
from scipy.optimize import differential_evolution

import pinposture as pp
from pinposture.control import best_index, section_indices

length = st.floats(0.05, 1.0)


def index(lengths: tuple[float, ...], inner: np.ndarray) -> float:
    """Index of a section by the singular values of its Jacobian."""
    return enumeration.index(planar.jacobian(len(lengths), [0.0, *inner], lengths))


@given(st.tuples(length, length))
@examples(25)
def test_two_links_have_the_best_of_all_their_elbows(lengths: tuple[float, float]) -> None:
    elbows = np.linspace(0.0, np.pi, 721)
    highest = max(index(lengths, np.array([elbow])) for elbow in elbows)
    assert highest <= best_index(lengths) + 1e-12
    assert highest == pytest.approx(best_index(lengths), rel=1e-2)


TRIPLES = [(1.0, 0.0625, 0.5), (0.875, 0.5, 0.0625), (0.3, 0.2, 0.25), (0.4, 0.5, 0.9)]


@pytest.mark.parametrize("lengths", TRIPLES)
def test_no_search_finds_a_better_posture_of_three_links(lengths: tuple[float, float, float]) -> None:
    bounds = [(-np.pi, np.pi)] * 2
    found = differential_evolution(lambda inner: -index(lengths, inner), bounds, rng=0, tol=1e-9, maxiter=60)
    assert best_index(lengths) == pytest.approx(-found.fun, abs=1e-6)


def test_known_best_postures() -> None:
    assert best_index((0.15, 0.15)) == pytest.approx((np.sqrt(5) - 1) / 2)
    assert best_index((np.sqrt(2), 1.0)) == pytest.approx(1.0)  # the isotropic arm of two links
    # Three equal links: the last two folded upon each other, the first across them.
    assert index((1.0, 1.0, 1.0), np.array([np.pi / 2, np.pi])) == pytest.approx(1.0)
    assert best_index((1.0, 1.0, 1.0)) == pytest.approx(1.0)
    assert best_index((0.2, 0.3, 0.0)) == pytest.approx(best_index((0.2, 0.3)), abs=1e-9)
    assert best_index((0.2, 0.3, 0.1)) == pytest.approx(best_index((2.0, 3.0, 1.0)), abs=1e-9)
    assert best_index((1.0, 0.0)) == best_index((0.0, 0.0)) == best_index((1.0,)) == 0.0
    assert best_index((1.0, 0.0, 0.0)) < 1e-6
    assert best_index((0.1,) * 5) == 1.0


def test_sections_of_an_arm_are_compared_with_their_own_links() -> None:
    lengths = np.array([0.1, 0.2, 0.15, 0.3, 0.1, 0.25])
    modules = [pp.template("Rz").with_lengths((link,)) for link in lengths]
    turned = pin.SE3(pin.rpy.rpyToMatrix(0.3, -1.1, 2.0), np.array([0.4, -2.0, 0.7]))
    for arm in (pp.Arm.from_modules(modules), pp.Arm.from_modules(modules, base_placement=turned)):
        q = arm.random(np.random.default_rng(0))
        raw = arm.at(q).manipulability()
        found = section_indices(arm.at(q), (2, 3))
        for size in range(1, 7):
            for start in range(7 - size):
                best = best_index(tuple(lengths[start : start + size])) if size in (2, 3) else 1.0
                end = start + size
                assert found[start, end] == pytest.approx(raw[start, end] / best, rel=1e-9)


def test_the_best_posture_has_index_one_and_none_has_more() -> None:
    arm = pp.Arm.from_template("Rz", 6)
    elbow = np.arccos(-2.0 / 3.0)  # of two equal links
    found = section_indices(arm.at([0.4, elbow, 0.1, elbow, -2.0, -elbow]), (2,))
    np.testing.assert_allclose([found[0, 2], found[2, 4], found[4, 6]], 1.0, atol=1e-7)
    for seed in seeds(20):
        assert section_indices(arm.at(arm.random(np.random.default_rng(seed))), (2, 3)).max() <= 1.0


def test_joints_of_one_module_count_as_links_and_others_stay_as_they_are() -> None:
    rng = np.random.default_rng(3)
    doubled = pp.Arm.from_template("RzRz", 4)
    state = doubled.at(doubled.random(rng))
    found = section_indices(state, (1, 2))
    raw = state.manipulability()
    np.testing.assert_allclose(np.diag(found, 1), np.diag(raw, 1) / best_index((1.0, 1.0)), rtol=1e-9)
    np.testing.assert_array_equal(np.diag(found, 2), np.diag(raw, 2))  # sections of four joints
    slide = pp.JointSpec("x", type="prismatic", lower=0.0, upper=0.1)
    sliding = pp.ModuleTemplate("RzPx", (pp.JointSpec("z"), slide), (0.0, 0.1))
    for arm in (pp.Arm.from_modules([sliding] * 4), pp.Arm.from_template("RyRz", 6)):
        state = arm.at(arm.random(rng))
        np.testing.assert_array_equal(section_indices(state, (1, 2, 3)), state.manipulability())


def test_a_section_that_is_always_singular_does_not_become_a_good_one() -> None:
    stub = pp.ModuleTemplate("stub", (pp.JointSpec("z"), pp.JointSpec("z")), (0.1, 1e-9))
    arm = pp.Arm.from_modules([stub] * 3)
    found = section_indices(arm.at(arm.random(np.random.default_rng(0))), (1,))
    assert np.diag(found, 1).max() < 1e-6
