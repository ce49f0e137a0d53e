"""Appendix A through the package: Jacobians of planar arms, and when two control points conflict.

The appendix numbers joints and links from 0; control point k is the end of link k - 1, where joint k stands.
Its tables hold for links of equal length. It shows that a singular section between two points makes their
stacked matrix singular; that no other section does, which Section 4.3 needs, is the last test.
"""

from __future__ import annotations

from itertools import combinations, pairwise, product

import numpy as np
import pinocchio as pin
import pytest
from analytic import planar
from hypothesis import given
from hypothesis import strategies as st
from sampling import examples

import pinposture as pp

PI = np.pi
STRAIGHT = (0.0, PI, -PI)
ZERO = 1e-7
"""Indices are resolved to about 1e-8."""
TURNED = pin.SE3(pin.rpy.rpyToMatrix(0.3, -1.1, 2.0), np.array([0.4, -2.0, 0.7]))


def arm_of(links: list[list[float]], axis: str = "z", base: pin.SE3 | None = None) -> pp.Arm:
    """A planar arm with one module for each list of link lengths."""
    modules = [
        pp.ModuleTemplate(f"R{axis}" * len(lengths), (pp.JointSpec(axis),) * len(lengths), lengths)
        for lengths in links
    ]
    return pp.Arm.from_modules(modules, base_placement=base)


def single(links: np.ndarray) -> pp.Arm:
    return arm_of([[float(length)] for length in links])


def in_plane(state: pp.ArmState) -> np.ndarray:
    """Jacobians (m, 2, n) along x and y of an arm about z that stands at the origin."""
    return state.jacobians[:, :2]


def rank(matrix: np.ndarray) -> int:
    return int(np.linalg.matrix_rank(matrix, tol=1e-9 * np.linalg.norm(matrix)))


ARMS = [
    [[0.15]] * 7,
    [[0.1], [0.3], [0.2], [0.05], [0.4]],
    [[0.2, 0.1], [0.3, 0.3], [0.1, 0.25]],
    [[0.2, 0.1, 0.15], [0.3, 0.3], [0.1], [0.2, 0.05, 0.3]],
]


@pytest.mark.parametrize("links", ARMS)
@pytest.mark.parametrize("axis", ["y", "z"])
@pytest.mark.parametrize("base", [None, TURNED], ids=["origin", "turned"])
def test_jacobians_of_planar_arms_are_those_of_the_closed_form(
    links: list[list[float]], axis: str, base: pin.SE3 | None
) -> None:
    arm = arm_of(links, axis, base)
    placement = pin.SE3.Identity() if base is None else base
    normal = np.eye(3)["xyz".index(axis)]
    # Rows: along the straight arm, and where the first joint turns it to.
    directions = np.array([[1.0, 0.0, 0.0], np.cross(normal, [1.0, 0.0, 0.0])]) @ placement.rotation.T
    ends = np.cumsum([len(lengths) for lengths in links])
    flat = np.concatenate(links)
    assert arm.dimension == 2
    for seed in range(3):
        q = arm.random(np.random.default_rng(seed))
        state = arm.at(q)
        expected = np.array([planar.jacobian(k, q, flat) for k in ends])
        points = planar.points(q, flat)[ends - 1] @ directions + placement.translation
        np.testing.assert_allclose(state.points, points, atol=1e-12)
        np.testing.assert_allclose(state.jacobians, directions.T @ expected, atol=1e-12)
        onto_plane = arm.plane @ directions.T
        np.testing.assert_allclose(onto_plane @ onto_plane.T, np.eye(2), atol=1e-12)
        np.testing.assert_allclose(state.task_jacobians, onto_plane @ expected, atol=1e-12)


@given(st.integers(0, 10**6), st.integers(1, 4))
@examples(25)
def test_rows_of_a_later_point_differ_by_the_section_between(seed: int, dof: int) -> None:
    # (A.1) for one joint, (A.4) for two, and so on: one column for all joints up to k, then one for each.
    rng = np.random.default_rng(seed)
    arm = single(rng.uniform(0.1, 0.5, 8))
    state = arm.at(arm.random(rng))
    J = in_plane(state)
    joints = np.vstack([[0.0, 0.0], state.points[:, :2]])
    k = int(rng.integers(1, 9 - dof))
    spans = joints[k + dof] - joints[[k] * k + list(range(k, k + dof))]
    difference = (J[k + dof - 1] - J[k - 1])[:, : k + dof]
    np.testing.assert_allclose(difference, [-spans[:, 1], spans[:, 0]], atol=1e-13)
    assert not J[k + dof - 1][:, k + dof :].any()


@given(st.integers(0, 10**6), st.sampled_from([0.05, 3.0]))
@examples(25)
def test_neighbours_of_one_joint_modules_conflict_in_every_posture(seed: int, amplitude: float) -> None:
    rng = np.random.default_rng(seed)
    arm = single(rng.uniform(0.1, 0.5, 7))
    state = arm.at(amplitude * rng.uniform(-1, 1, 7))
    J = in_plane(state)
    joints = np.vstack([[0.0, 0.0], state.points[:, :2]])
    assert np.diag(state.manipulability(), 1).max() < ZERO
    for k in range(1, 7):
        C, S = joints[k + 1] - joints[k]
        # (A.3) with c = C, d = S, and a, b their negatives: the rows are dependent, whatever J_k is.
        dependence = np.array([-C, -S, C, S]) @ np.vstack([J[k - 1], J[k]])
        np.testing.assert_allclose(dependence, 0.0, atol=1e-13)


TABLES = [
    ((0,), (2,)),  # Table A.1: joint k + 1; alpha
    ((1,), (0,)),
    ((0, 0), (3, 2)),  # Table A.2: joints k + 1 and k + 2; alpha, beta
    ((0, 1), (-1, 0)),
    ((1, 1), (1, 0)),
    ((1, 0), (1, 2)),
]


@pytest.mark.parametrize(("half_turns", "factors"), TABLES)
def test_the_tables_hold_for_modules_of_equal_links(
    half_turns: tuple[int, ...], factors: tuple[int, ...]
) -> None:
    dof = len(half_turns) + 1
    arm = pp.Arm.from_template("Rz" * dof, 4, (0.15,) * dof)
    rng = np.random.default_rng(0)
    for signs in product((1, -1), repeat=dof - 1):
        for first in (0.0, 0.7, -3.0):  # "arbitrary value"
            q = rng.uniform(0.3, 1.0, 4 * dof)
            q[2 * dof : 3 * dof] = [
                first,
                *(PI * turn * s for turn, s in zip(half_turns, signs, strict=True)),
            ]
            state = arm.at(q)
            columns = in_plane(state)[2][:, 2 * dof : 3 * dof]
            for column, factor in zip(columns.T, factors, strict=False):
                np.testing.assert_allclose(column, factor * columns[:, -1], atol=1e-14)
            assert state.manipulability()[2, 3] < ZERO
            assert rank(state.task_jacobians[[1, 2]].reshape(4, -1)) == 3


@given(st.integers(0, 10**6), st.integers(2, 3), st.data())
@examples(40)
def test_sections_are_singular_exactly_when_their_inner_joints_are_straight(
    seed: int, dof: int, data: st.DataObject
) -> None:
    rng = np.random.default_rng(seed)
    links = rng.uniform(0.1, 0.5, 4 + dof)
    bend = st.floats(0.02, PI - 0.02).flatmap(lambda a: st.sampled_from([a, -a]))
    inner = [data.draw(st.one_of(st.sampled_from(STRAIGHT), bend)) for _ in range(dof - 1)]
    q = np.array([*rng.uniform(0.4, 1.0, 4), data.draw(st.floats(-PI, PI)), *inner])
    singular = all(joint in STRAIGHT for joint in inner)
    state = single(links).at(q)
    index = state.manipulability()[4, 4 + dof]
    assert index < ZERO if singular else index > 1e-4
    assert rank(state.task_jacobians[[3, 3 + dof]].reshape(4, -1)) == (3 if singular else 4)
    if singular:
        # (A.5), (A.6): where links differ, the factors are sums of links along the last one, not the tables'.
        columns = in_plane(state)[3 + dof][:, 4 : 4 + dof]
        along = np.cos(np.cumsum(inner[::-1]))[::-1]  # of links k, k + 1, ... against the last one
        factors = 1.0 + np.cumsum((links[4:-1] * along)[::-1])[::-1] / links[-1]
        np.testing.assert_allclose(columns[:, :-1], np.outer(columns[:, -1], factors), atol=1e-13)


@given(st.integers(0, 10**6), st.integers(2, 6))
@examples(25)
def test_a_straight_or_folded_section_of_any_length_makes_its_ends_conflict(seed: int, dof: int) -> None:
    rng = np.random.default_rng(seed)
    links = rng.uniform(0.1, 0.5, 4 + dof)
    q = np.array([*rng.uniform(-PI, PI, 5), *rng.choice(STRAIGHT, dof - 1)])
    state = single(links).at(q)
    J = in_plane(state)
    heading = q.sum()  # of the last link
    C = np.cos(heading)
    S = np.sin(heading)
    assert state.manipulability()[4, 4 + dof] < ZERO
    np.testing.assert_allclose([-C, -S, C, S] @ np.vstack([J[3], J[3 + dof]]), 0.0, atol=1e-13)


@given(st.integers(0, 10**6))
@examples(25)
def test_points_conflict_only_if_one_of_them_or_a_section_between_is_singular(seed: int) -> None:
    rng = np.random.default_rng(seed)
    arm = single(rng.uniform(0.1, 0.5, 9))
    bends = rng.uniform(0.3, 1.0, 9) * rng.choice([-1, 1], 9)
    state = arm.at(np.where(rng.random(9) < 0.4, rng.choice(STRAIGHT, 9), bends))
    w = state.manipulability()
    seen = {True: 0, False: 0}
    for points in (set_ for size in (1, 2, 3, 4) for set_ in combinations(range(1, 10), size)):
        stacked = state.task_jacobians[[k - 1 for k in points]].reshape(2 * len(points), -1)
        clear = w[0, points[0]] > ZERO and all(w[s, i] > ZERO for s, i in pairwise(points))
        assert (rank(stacked) == 2 * len(points)) == clear
        seen[bool(clear)] += 1
    assert seen[False] > 8  # neighbours at least
