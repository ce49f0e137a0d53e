"""Physically consistent inertias, against clouds of points."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from sampling import examples

from pinposture.arm.inertias import INERTIA, RigidBody, physically_consistent

SEEDS = st.integers(0, 10_000)


def cloud(rng: np.random.Generator, points: int = 6) -> RigidBody:
    """The inertia of some points with mass, which is that of a solid."""
    masses = rng.uniform(0.1, 1.0, points)
    places = rng.normal(size=(points, 3))
    center = masses @ places / masses.sum()
    offs = places - center
    moments = sum(m * (d @ d * np.eye(3) - np.outer(d, d)) for m, d in zip(masses, offs, strict=True))
    return RigidBody(float(masses.sum()), center, moments)


def is_solid(body: RigidBody) -> bool:
    x, y, z = np.linalg.eigvalsh(body.inertia)
    return bool(x > 0.0 and x + y >= z * (1.0 - 1e-9))


@examples(30)
@given(SEEDS)
def test_a_solid_stays_as_it_is(seed):
    body = cloud(np.random.default_rng(seed))
    kept, changed = physically_consistent(body)
    assert changed == ""
    assert kept is body


@examples(40)
@given(SEEDS)
def test_whatever_the_numbers_what_comes_out_is_a_solid(seed):
    rng = np.random.default_rng(seed)
    numbers = rng.normal(size=(3, 3)) * 10.0 ** rng.uniform(-8, 3)
    body = RigidBody(10.0 ** rng.uniform(-6, 3), rng.normal(size=3), numbers + numbers.T)
    repaired, changed = physically_consistent(body)
    assert is_solid(repaired)
    assert repaired.mass == body.mass
    # What is changed without a word is rounding, or less than what a ball of the smallest radius has.
    allowed = 2.0 * (
        body.mass * INERTIA.least_radius**2 / 5.0 + INERTIA.rounding * np.abs(body.inertia).sum()
    )
    assert changed or np.abs(repaired.inertia - body.inertia).max() <= allowed


def test_points_and_nothing_at_all_get_a_size():
    point, changed = physically_consistent(RigidBody(2.0, np.ones(3), np.zeros((3, 3))))
    assert changed == "unphysical moments of inertia"
    np.testing.assert_allclose(point.inertia, 0.4 * 2.0 * 1e-8 * np.eye(3), rtol=1e-9)
    nothing, changed = physically_consistent(RigidBody(0.0, np.zeros(3), np.zeros((3, 3))))
    assert (nothing.mass, changed) == (INERTIA.ball_mass, "no mass")
    assert is_solid(nothing)


def test_a_thin_rod_of_rounded_numbers_is_let_through_without_a_word():
    rod = RigidBody(1.0, np.zeros(3), np.diag([1e-5, 0.0833, 0.0834]))
    repaired, changed = physically_consistent(rod)
    assert changed == ""
    np.testing.assert_allclose(repaired.inertia, rod.inertia, atol=1e-4)
    assert is_solid(repaired)
