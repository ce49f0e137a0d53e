"""Closed-form module kinematics against the analytic reference and a brute-force scan of the torus."""

from __future__ import annotations

import numpy as np
import pytest
from analytic import ryrz, torus
from hypothesis import given
from hypothesis import strategies as st
from sampling import examples

from pinposture.placement.module_kinematics import Circle, Torus

LENGTHS = [(0.025, 0.025), (0.04, 0.01), (0.01, 0.04), (1.0, 0.999)]
UNIVERSAL = (0.0, 0.05)
angles = st.floats(-np.pi, np.pi)


@given(angles, angles, st.sampled_from([*LENGTHS, UNIVERSAL]))
def test_fk_is_that_of_the_thesis(q0: float, q1: float, lengths: tuple[float, float]) -> None:
    position, turn = Torus(*lengths).forward(np.array([q0, q1]))
    np.testing.assert_allclose(position, ryrz.fk([q0, q1], *lengths), atol=1e-14)
    np.testing.assert_allclose(turn, ryrz.ry(q0) @ ryrz.rz(q1), atol=1e-14)


@given(angles, angles, st.sampled_from([*LENGTHS, UNIVERSAL]), st.sampled_from([1.0, -1.0]))
def test_ik_finds_what_fk_was_given(q0: float, q1: float, lengths: tuple[float, float], sense: float) -> None:
    module = Torus(*lengths, sense=sense)
    end = module.forward(np.array([q0, q1]))[0]
    solutions = module.inverse(end)
    assert solutions
    for q in solutions:
        np.testing.assert_allclose(module.forward(q)[0], end, atol=1e-7 * module.reach)
    # Every solution of the reference is among them, unless the point lies on the hinge axis (q0 is free).
    if np.hypot(end[0], end[2]) > 1e-6 * module.reach:
        for expected in ryrz.ik(end, *lengths):
            turned = np.array([expected[0], sense * expected[1]])
            gaps = [np.abs(np.exp(1j * q) - np.exp(1j * turned)).max() for q in solutions]
            assert min(gaps) < 1e-5


def test_points_off_the_torus_have_no_ik() -> None:
    assert Torus(0.025, 0.025).inverse(np.array([0.0, 0.04, 0.0])) == []
    assert Torus(0.025, 0.025).inverse(np.array([0.06, 0.0, 0.0])) == []
    assert Circle(0.1).inverse(np.array([0.06, 0.02, 0.0])) == []


@pytest.mark.long
@examples(30)
@given(
    st.lists(st.floats(-1.0, 1.0), min_size=6, max_size=6),
    st.sampled_from(LENGTHS),
)
def test_crossings_are_those_of_a_brute_force_scan(ends: list[float], lengths: tuple[float, float]) -> None:
    module = Torus(*lengths)
    a = module.reach * np.array(ends[:3])
    b = module.reach * np.array(ends[3:])
    expected = [t for t in torus.intersections(a, b, *lengths) if t > 1e-6]
    ends_on = [a + t * (b - a) for t in expected]
    # Touching points, where two roots meet, may be found once, twice or not at all.
    slopes = [
        abs(
            float(torus.implicit(p + 1e-5 * (b - a), *lengths) - torus.implicit(p - 1e-5 * (b - a), *lengths))
        )
        for p in ends_on
    ]
    scale = module.reach**4
    clear = [t for t, slope in zip(expected, slopes, strict=True) if abs(slope) > 1e-7 * scale]
    found = [t for _, t in module.crossings(np.array([a, b]))]
    for t in clear:
        assert min((abs(t - other) for other in found), default=1.0) < 1e-6
    for t in found:
        assert abs(float(torus.implicit(a + t * (b - a), *lengths))) < 1e-9 * scale


@given(st.lists(st.floats(-1.5, 1.5), min_size=6, max_size=6))
def test_a_universal_joint_crosses_where_the_distance_is_that_of_its_link(ends: list[float]) -> None:
    module = Torus(*UNIVERSAL)
    link = UNIVERSAL[1]
    a = link * np.array(ends[:3])
    b = link * np.array(ends[3:])
    t = np.linspace(0.0, 1.0, 2001)
    beyond = np.linalg.norm(a + t[:, None] * (b - a), axis=1) > link
    changes = t[1:][beyond[1:] != beyond[:-1]]
    found = np.array([t for _, t in module.crossings(np.array([a, b]))])
    for change in changes:
        assert np.abs(found - change).min(initial=1.0) < 1e-3
    assert np.abs(np.linalg.norm(a + found[:, None] * (b - a), axis=1) - link).max(initial=0.0) < 1e-12
    for each in found:
        end = a + each * (b - a)
        assert module.faces(end)
        np.testing.assert_allclose(module.forward(module.inverse(end)[0])[0], end, atol=1e-12)


def test_crossings_come_in_order_along_a_polyline_and_skip_the_base() -> None:
    module = Torus(0.025, 0.025)
    path = np.linspace([0.0, 0.0, 0.0], [0.08, 0.0, 0.0], 9)
    found = [(i, t) for i, t in module.crossings(path)]
    assert len(found) == 1  # the base itself is a double root of (6.13) and no crossing
    i, t = found[0]
    assert (path[i] + t * (path[i + 1] - path[i]))[0] == pytest.approx(0.05, abs=1e-12)
    ring = Torus(0.04, 0.01)
    xs = [(path[i] + t * (path[i + 1] - path[i]))[0] for i, t in ring.crossings(path)]
    assert xs == pytest.approx([0.03, 0.05], abs=1e-12)
    assert [ring.faces(np.array([x, 0.0, 0.0])) for x in xs] == [False, True]


def test_circle_crossings_are_at_one_link_length() -> None:
    module = Circle(0.15)
    path = np.array([[0.0, 0, 0], [0.1, 0, -0.02], [0.3, 0, -0.1], [0.1, 0, 0.0]])
    found = [path[i] + t * (path[i + 1] - path[i]) for i, t in module.crossings(path)]
    assert len(found) == 2
    assert [np.linalg.norm(p) for p in found] == pytest.approx([0.15, 0.15], abs=1e-12)
    for p in found:
        q = module.inverse(p)[0]
        np.testing.assert_allclose(module.forward(q)[0], p, atol=1e-12)
