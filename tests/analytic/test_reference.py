"""The analytic reference, checked by means that it does not use itself."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from analytic import enumeration, planar, ryrz, torus
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

LINKS = [(0.025, 0.025), (0.3, 0.2), (0.2, 0.3)]  # horn, ring and spindle torus
PI = np.pi
angle = st.floats(-PI, PI)


@pytest.fixture
def rng():
    return np.random.default_rng(7)


def random_base(rng):
    return rng.normal(size=3), Rotation.random(random_state=rng).as_matrix()


# --- RyRz arm


def test_points_and_rotations_follow_homogeneous_transforms(rng):
    q, (p0, E0) = rng.uniform(-PI, PI, 10), random_base(rng)
    T = np.eye(4)
    T[:3, :3] = E0
    T[:3, 3] = p0
    for k in range(5):
        for axis, a, length in (("y", q[2 * k], 0.3), ("z", q[2 * k + 1], 0.2)):
            step = np.eye(4)
            step[:3, :3] = Rotation.from_euler(axis, a).as_matrix()
            step[:3, 3] = step[:3, 0] * length
            T = T @ step
        assert np.allclose(ryrz.points(q, 0.3, 0.2, p0, E0)[k], T[:3, 3], atol=1e-14)
        assert np.allclose(ryrz.rotations(q, 0.3, 0.2, p0, E0)[k], T[:3, :3], atol=1e-14)


@pytest.mark.parametrize("l1, l2", LINKS)
def test_position_jacobian_is_the_complex_step_derivative(rng, l1, l2):
    q, (p0, E0), h = rng.uniform(-PI, PI, 8), random_base(rng), 1e-30
    steps = [ryrz.points(q + 1j * h * np.eye(8)[u], l1, l2, p0, E0).imag / h for u in range(8)]
    for k in range(1, 5):
        expected = np.array([step[k - 1] for step in steps]).T
        assert np.allclose(ryrz.jacobian(k, q, l1, l2, p0, E0), expected, rtol=0, atol=1e-14)


def test_angular_jacobian_columns_are_joint_axes_in_the_world(rng):
    q, (p0, E0) = rng.uniform(-PI, PI, 8), random_base(rng)
    bases = [E0, *ryrz.rotations(q, 0.3, 0.2, p0, E0)]
    axes = []
    for k in range(4):
        axes += [bases[k] @ [0, 1, 0], bases[k] @ ryrz.ry(q[2 * k]) @ [0, 0, 1]]
    for k in range(1, 5):
        expected = np.array([a if u < 2 * k else np.zeros(3) for u, a in enumerate(axes)]).T
        assert np.allclose(ryrz.angular_jacobian(k, q, 0.3, 0.2, p0, E0), expected, atol=1e-14)


def test_section_jacobian_is_the_relative_motion_of_two_points(rng):
    q = rng.uniform(-PI, PI, 10)
    h = 1e-6

    def relative(q):  # control point 4 seen from control point 1
        p = ryrz.points(q, 0.3, 0.2)
        E = ryrz.rotations(q, 0.3, 0.2)
        return E[0].T @ (p[3] - p[0])

    expected = np.array([(relative(q + h * d) - relative(q - h * d)) / (2 * h) for d in np.eye(10)]).T
    assert np.allclose(ryrz.section_jacobian(4, 1, q, 0.3, 0.2), expected[:, 2:8], atol=1e-9)
    assert np.allclose(expected[:, [0, 1, 8, 9]], 0, atol=1e-9)


@given(st.tuples(angle, angle), st.sampled_from(LINKS))
def test_singular_values_of_one_module_have_a_closed_form(q, links):
    # The columns are orthogonal: |r| about y with r = l1 + l2 cos q1, and l2 about z.
    expected = sorted([abs(links[0] + links[1] * np.cos(q[1])), links[1], 0.0], reverse=True)
    assert np.allclose(ryrz.singular_values(1, 0, q, *links), expected, atol=1e-12)


@given(st.tuples(angle, angle), st.sampled_from(LINKS))
def test_ik_inverts_fk(q, links):
    r = links[0] + links[1] * np.cos(q[1])
    assume(abs(r) > 1e-3 * links[0])
    solutions = ryrz.ik(ryrz.fk(q, *links), *links)
    assert len(solutions) == 1  # a torus meets itself on the y axis only
    assert np.allclose(np.exp(1j * solutions[0]), np.exp(1j * np.array(q)), atol=1e-9)


def test_ik_finds_the_inner_half_and_the_crossed_branch():
    assert np.allclose(ryrz.ik(ryrz.fk((0.4, 2.5), 0.3, 0.2), 0.3, 0.2), [(0.4, 2.5)])
    assert 0.2 + 0.3 * np.cos(2.5) < 0  # here the end crosses the y axis: rho = -r
    assert np.allclose(ryrz.ik(ryrz.fk((0.4, 2.5), 0.2, 0.3), 0.2, 0.3), [(0.4, 2.5)])


def test_ik_gives_both_branches_on_the_axis_and_none_off_the_torus():
    p = (0.0, np.sqrt(0.3**2 - 0.2**2), 0.0)
    solutions = ryrz.ik(p, 0.2, 0.3)
    assert len(solutions) == 2
    for q in solutions:
        assert np.allclose(ryrz.fk(q, 0.2, 0.3), p, atol=1e-15)
    assert ryrz.ik((0.1, 0.3, 0.2), 0.3, 0.2).shape == (0, 2)


# --- torus


@pytest.mark.parametrize("l1, l2", LINKS)
def test_implicit_surface_is_what_a_module_reaches(rng, l1, l2):
    grid = torus.reachable(l1, l2, 400)
    scale = (l1 + l2) ** 4
    assert np.max(np.abs(torus.implicit(grid, l1, l2))) < 1e-14 * scale
    q = rng.uniform(-PI, PI, (20, 2))
    tree = cKDTree(grid)
    nearest, _ = tree.query([ryrz.fk(qi, l1, l2) for qi in q])
    spacing = 2 * PI / 400 * (l1 + l2)
    assert np.all(nearest < spacing)
    for _ in range(20):  # and no zero of F lies off the grid
        a, b = rng.normal(size=(2, 3)) * (l1 + l2)
        for t in torus.intersections(a, b, l1, l2):
            assert tree.query(a + (b - a) * t)[0] < spacing


@pytest.mark.parametrize("l1, l2", LINKS)
def test_scan_finds_the_real_roots_of_the_quartic(rng, l1, l2):
    # The coefficients by interpolation, so that no hand-expanded formula enters.
    seen = set()
    for _ in range(100):
        a, b = rng.uniform(-1.2, 1.2, (2, 3)) * (l1 + l2)
        nodes = np.linspace(0, 1, 5)
        F = torus.implicit(a + np.outer(nodes, b - a), l1, l2) / (l1 + l2) ** 4
        roots = np.roots(np.linalg.solve(np.vander(nodes), F))
        real = np.sort(roots.real[(abs(roots.imag) < 1e-9) & (roots.real > 0) & (roots.real < 1)])
        found = torus.intersections(a, b, l1, l2)
        assert len(found) == len(real)
        assert np.allclose(found, real, atol=1e-8)
        seen.add(len(real))
    assert {0, 1, 2} <= seen


def test_scan_finds_all_four_crossings_of_a_diameter():
    # Along x the ring torus is met at +-(l1 - l2) and +-(l1 + l2).
    t = torus.intersections((-1, 0, 0), (1, 0, 0), 0.3, 0.2)
    assert np.allclose(2 * t - 1, [-0.5, -0.1, 0.1, 0.5], atol=1e-12)


def test_scan_counts_a_tangency_once_and_separates_near_ones():
    def along_y(x):  # past the outer equator of the ring torus, at x = 0.5; the tangency lies between samples
        return torus.intersections((x, -1.0, 0.0), (x, 1.3003, 0.0), 0.3, 0.2)

    assert np.allclose(along_y(0.5), [1 / 2.3003], rtol=0, atol=1e-7)
    assert len(along_y(0.5 + 1e-9)) == 0
    close = along_y(0.5 - 1e-9)  # the chord is far shorter than the distance between samples
    half = np.sqrt(0.2**2 - (0.2 - 1e-9) ** 2)
    assert np.allclose(close * 2.3003 - 1, [-half, half], rtol=0, atol=1e-9)


def test_scan_sees_a_tangency_from_within():
    # Along z past the inner equator, at x = 0.1, the line is in the tube on both sides until rho = 0.5.
    t = torus.intersections((0.1, 0.0, -1.0), (0.1, 0.0, 1.3003), 0.3, 0.2)
    assert np.allclose(t * 2.3003 - 1, [-np.sqrt(0.24), 0, np.sqrt(0.24)], rtol=0, atol=1e-7)


def test_scan_finds_the_flat_touch_of_the_top_circle():
    t = torus.intersections((0.3, 0.2, -1.0), (0.3, 0.2, 1.3003), 0.3, 0.2)
    assert np.allclose(t, [1 / 2.3003], rtol=0, atol=1e-3)
    assert len(t) == 1


def test_scan_counts_ends_on_the_torus_and_the_base_of_a_horn_torus_once():
    assert np.allclose(torus.intersections((0.5, 0, 0), (0.1, 0, 0), 0.3, 0.2), [0, 1], atol=1e-12)
    t = torus.intersections((0, 0, 0), (1, 0.2, 0.1), 0.3, 0.3)
    assert len(t) == 2
    assert t[0] == 0
    # A short segment that leaves a base known to rounding only: the double root there is still one.
    t = torus.intersections((1e-17, -1e-17, 2e-17), (5e-4, 0, 0), 0.025, 0.025)
    assert np.array_equal(t, [0])


# --- planar chain


def test_planar_jacobian_is_the_finite_difference_of_the_points(rng):
    q = rng.uniform(-PI, PI, 6)
    links = rng.uniform(0.1, 0.5, 6)
    h = 1e-6

    def positions(q):  # complex numbers, link by link
        return np.cumsum(links * np.exp(1j * np.cumsum(q)))

    assert np.allclose(planar.points(q, links) @ [1, 1j], positions(q), atol=1e-14)
    expected = np.array([(positions(q + h * d) - positions(q - h * d)) / (2 * h) for d in np.eye(6)]).T
    for k in range(1, 7):
        J = planar.jacobian(k, q, links)
        assert np.allclose(J[0] + 1j * J[1], expected[k - 1], atol=1e-9)


def bent_start(k):
    """Joints 0..k-1, of which one in the middle makes J_k full rank."""
    return st.tuples(st.lists(angle, min_size=k, max_size=k), st.floats(0.3, 2.8)).map(
        lambda pair: [pair[0][0], pair[1], *pair[0][2:]]
    )


def assume_full_rank(k, q, links):
    assume(planar.rank(planar.jacobian(k, q, links), 1e-2) == 2)


lengths = st.lists(st.floats(0.2, 1.0), min_size=7, max_size=7)


@given(bent_start(4), angle, lengths)
def test_adjacent_points_of_one_joint_modules_always_conflict(start, joint, links):
    q = [*start, joint]
    assume_full_rank(4, q, links[:5])
    assert planar.rank(planar.stacked([4, 5], q, links[:5])) == 3
    assert planar.section_is_singular([])


@given(bent_start(4), angle, angle, st.sampled_from([0.0, PI, -PI, None]), lengths)
def test_two_joint_modules_conflict_exactly_when_the_inner_joint_is_straight(
    start, first, inner, exact, links
):
    inner = inner if exact is None else exact
    assume(exact is not None or abs(np.sin(inner)) > 1e-2)
    q = [*start, first, inner]
    links = links[:6]
    assume_full_rank(4, q, links)
    singular = exact is not None
    assert planar.section_is_singular([inner]) == singular
    assert (planar.ratios(4, 2, q, links) is not None) == singular
    assert planar.rank(planar.stacked([4, 6], q, links)) == (3 if singular else 4)


joint = st.tuples(angle, st.sampled_from([0.0, PI, -PI, None]))


@given(bent_start(4), angle, joint, joint, lengths)
def test_three_joint_modules_conflict_exactly_when_both_inner_joints_are_straight(start, first, a, b, links):
    inner = [free if exact is None else exact for free, exact in (a, b)]
    assume(all(exact is not None or abs(np.sin(free)) > 1e-2 for free, exact in (a, b)))
    q = [*start, first, *inner]
    assume_full_rank(4, q, links)
    singular = a[1] is not None and b[1] is not None
    assert planar.section_is_singular(inner) == singular
    assert (planar.ratios(4, 3, q, links) is not None) == singular
    assert planar.rank(planar.stacked([4, 7], q, links)) == (3 if singular else 4)


@pytest.mark.parametrize(
    "inner, expected",
    [
        ((0,), (2,)),  # Table A.1
        ((PI,), (0,)),
        ((-PI,), (0,)),
        ((0, 0), (3, 2)),  # Table A.2
        ((0, PI), (-1, 0)),
        ((PI, -PI), (1, 0)),
        ((PI, 0), (1, 2)),
    ],
)
def test_tables_of_appendix_a_hold_for_equal_links(rng, inner, expected):
    q = [*rng.uniform(0.3, 1.0, 5), *inner]
    assert np.allclose(planar.ratios(4, len(inner) + 1, q, np.ones(len(q))), expected, atol=1e-12)


def test_singular_points_conflict_however_the_rest_of_the_arm_bends():
    q = [0.5, 0.0, 0.0, 0.4, 0.9]  # J_3 has rank 1: the first three links are straight
    assert planar.rank(planar.jacobian(3, q, np.ones(5))) == 1
    assert not planar.section_is_singular([0.9])
    assert planar.rank(planar.stacked([3, 5], q, np.ones(5))) == 3


# --- candidate control sets


@given(st.integers(1, 7), st.integers(0, 2**32 - 1), st.floats(0, 1), st.floats(0, 1))
def test_both_enumerations_agree(m, seed, absolute, relative):
    w = np.random.default_rng(seed).choice(np.linspace(0, 1, 11), (m + 1, m + 1))
    w[0, 1] = absolute  # equality must fail
    sets = enumeration.candidate_sets(w, absolute, relative)
    assert sets == enumeration.candidate_sets_by_subsets(w, absolute, relative)
    assert (1,) not in sets


def test_three_modules_have_the_seven_sets_of_figure_4_5():
    sets = enumeration.candidate_sets(np.ones((4, 4)), 0.5, 0.5)
    assert sets == [(1,), (1, 2), (1, 2, 3), (1, 3), (2,), (2, 3), (3,)]


@pytest.mark.parametrize("m", [1, 2, 5, 9])
def test_numbers_of_sets_are_those_of_counting(m):
    s, i = np.indices((m + 1, m + 1))
    fibonacci = [1, 1]
    while len(fibonacci) < m + 2:
        fibonacci.append(fibonacci[-1] + fibonacci[-2])

    def count(cleared):
        return len(enumeration.candidate_sets(np.where(cleared, 1.0, 0.0), 0.5, 0.5))

    assert count(s < i) == 2**m - 1
    assert count(s == 0) == m
    assert count(s > 0) == 0
    # Neighbours may not go together: subsets without consecutive integers.
    assert count((s == 0) | (i - s > 1)) == fibonacci[m + 1] - 1


def test_best_set_has_the_largest_sum_of_errors_not_the_most_points():
    sets = [(1,), (1, 2), (3,), (2, 4)]
    assert enumeration.best_by_score(sets, [1.0, 2.0, 3.5, 0.5]) == (3,)
    assert enumeration.best_by_score(sets, [1.0, 2.0, 3.0, 0.5]) == (1, 2)  # tied with (3,): the first
    assert enumeration.best_by_score(sets, [1.0, 2.0, 3.0, 1.5]) == (2, 4)
    assert enumeration.best_by_score([], [1.0]) == ()


# --- manipulability index


@given(angle, st.floats(0.1, 10.0), st.floats(0.1, 1.0))
def test_index_of_a_two_link_arm_has_a_closed_form(elbow, scale, ratio):
    l1 = scale
    l2 = scale * ratio
    det = l1 * l2 * abs(np.sin(elbow))
    trace = l1**2 + 2 * l1 * l2 * np.cos(elbow) + 2 * l2**2  # of J J^T
    largest = (trace + np.sqrt(max(trace**2 - 4 * det**2, 0.0))) / 2
    J = planar.jacobian(2, [0.7, elbow], [l1, l2])
    assert enumeration.index(J) == pytest.approx(det / largest, abs=1e-9)


def test_index_is_one_for_a_sphere_and_zero_without_enough_columns():
    assert enumeration.index(3 * np.eye(3)) == pytest.approx(1)
    assert enumeration.index(np.eye(3)[:, :2]) == 0
    assert enumeration.index(np.zeros((3, 4))) == 0


def test_index_matrix_follows_from_gram_determinants(rng):
    q = rng.uniform(-1, 1, 8)
    w = enumeration.index_matrix(lambda s, i: ryrz.section_jacobian(i, s, q, 0.3, 0.2), 4)
    assert np.all(w[np.tril_indices(5)] == 0)
    for s in range(4):
        for i in range(s + 1, 5):
            # Rows as in the world: turning the frame of a section changes no singular value.
            p = ryrz.points(q, 0.3, 0.2)
            base = ryrz.rotations(q, 0.3, 0.2)[s - 1] if s else np.eye(3)
            J = ryrz.jacobian(i - s, q[2 * s : 2 * i], 0.3, 0.2, p[s - 1], base)
            gram = J @ J.T
            expected = np.sqrt(max(np.linalg.det(gram), 0)) / np.linalg.norm(gram, 2) ** 1.5
            assert w[s, i] == pytest.approx(expected, abs=1e-7)
    assert np.all(np.diag(w, 1) == 0)  # one module has two joints for three directions
    assert np.all(w[np.triu_indices(5, 2)] > 0)


def test_a_later_point_can_fail_the_absolute_condition_that_an_earlier_one_clears(rng):
    falls = 0
    for _ in range(20):
        q = rng.uniform(-1.5, 1.5, 12)
        w = [enumeration.index(ryrz.jacobian(k, q, 0.025, 0.025)) for k in range(2, 7)]
        falls += any(later < earlier for earlier, later in pairwise(w))
    assert falls > 0


def test_in_space_the_relative_condition_is_sufficient_but_not_necessary(rng):
    for _ in range(20):
        q = rng.uniform(-1.5, 1.5, 10)
        J = [ryrz.jacobian(k, q, 0.025, 0.025) for k in range(1, 6)]
        for s, i in ((3, 5), (2, 4)):  # sections of two modules, w > 0
            assert enumeration.index(ryrz.section_jacobian(i, s, q, 0.025, 0.025)) > 0
            assert planar.rank(np.vstack([J[s - 1], J[i - 1]])) == 6
        assert enumeration.index(ryrz.section_jacobian(5, 4, q, 0.025, 0.025)) == 0
        assert planar.rank(np.vstack([J[3], J[4]])) == 6  # and yet the neighbours do not conflict
