"""Ways through joint space against fine sampling of the same polyline."""

from __future__ import annotations

import numpy as np
import pytest
from arms import template_arm
from control.task_arms import ARMS, arm_called
from hypothesis import given
from hypothesis import strategies as st
from sampling import examples, seeds

import pinposture as pp
from pinposture.control.planner.objective import Objective
from pinposture.control.planner.path import JointPath, PathStep

SEEDS = st.integers(0, 2**32 - 1)
FINE = 4000


def planar() -> pp.Arm:
    return template_arm("Rz", 4)


def objective_of(arm: pp.Arm) -> Objective:
    return Objective(arm, pp.Target.from_configuration(arm, arm.neutral()))


def drawn(rng: np.random.Generator, arm: pp.Arm | None = None, size: float = 1.0) -> JointPath:
    """A polyline with long and short pieces, some of which do not move, and some joints that do not."""
    arm = planar() if arm is None else arm
    pieces = size * rng.normal(size=(int(rng.integers(1, 7)), arm.nv))
    pieces *= 10.0 ** rng.uniform(-1.0, 0.0, (len(pieces), 1)) * (rng.random((len(pieces), arm.nv)) > 0.2)
    offsets = np.vstack([np.zeros(arm.nv), pieces.cumsum(axis=0)])
    start = arm.random(rng) if arm is not planar() else rng.uniform(-1.0, 1.0, arm.nv)
    return JointPath(objective_of(arm), start, offsets)


def sampled(path: JointPath, place: np.ndarray) -> np.ndarray:
    """Offsets at places, by interpolation of each joint."""
    along = np.arange(len(path.offsets))
    return np.column_stack([np.interp(place, along, joint) for joint in path.offsets.T])


def ahead_of(path: JointPath, offset: np.ndarray, place: float, bound: np.ndarray) -> PathStep:
    """The step from somewhere near the path, with the same limit to either side."""
    arm = path.arm
    state = arm.at(arm.integrate(path.start, offset))
    sides = np.array([-bound, bound])
    return path.step_along(state, place, sides)


@given(seed=SEEDS)
@examples(40)
def test_ahead_is_the_farthest_place_without_a_gap(seed: int) -> None:
    rng = np.random.default_rng(seed)
    path = drawn(rng)
    place = float(rng.uniform(0.0, path.end))
    bound = 10.0 ** rng.uniform(-2.0, 0.5, planar().nv)
    offset = sampled(path, np.array([place]))[0] + rng.uniform(-0.9, 0.9, planar().nv) * bound * (seed % 2)
    ahead = ahead_of(path, offset, place, bound)
    places = np.linspace(place, path.end, FINE)
    within = np.all(np.abs(sampled(path, places) - offset) <= bound * (1.0 + 1e-9), axis=1)
    first_out = int(np.argmin(within)) if not within.all() else FINE
    expected = places[max(first_out - 1, 0)]
    gap = path.end / FINE
    assert expected - 1e-9 <= ahead.s <= expected + gap + 1e-9
    np.testing.assert_allclose(ahead.dq, sampled(path, np.array([ahead.s]))[0] - offset, atol=1e-12)
    assert np.all(np.abs(ahead.dq) <= bound * (1.0 + 1e-9))


@pytest.mark.parametrize(
    "side",
    [
        1.0,
        -1.0,
    ],
)
def test_an_arm_that_is_off_the_path_waits_at_its_place(side: float) -> None:
    """On either side: joint 0 is out of reach of the path, on which only joint 1 moves."""
    path = JointPath(
        objective_of(planar()), np.zeros(4), np.array([[0.0, 0, 0, 0], [0.0, 0.05, 0, 0], [0.0, 0.1, 0, 0]])
    )
    ahead = ahead_of(path, np.array([0.5 * side, 0.0, 0.0, 0.0]), 0.2, np.full(4, 0.1))
    assert ahead.s == 0.2 and not ahead.inside
    np.testing.assert_allclose(ahead.dq, [-0.5 * side, 0.01, 0.0, 0.0], atol=1e-12)


def test_stepping_ahead_again_and_again_ends_at_the_end() -> None:
    for seed in seeds(20):
        path = drawn(np.random.default_rng(seed))
        bound = np.full(planar().nv, 0.07)
        pieces = np.abs(np.diff(path.offsets, axis=0)).max(axis=1).sum() / 0.07
        place = 0.0
        offset = np.zeros(planar().nv)
        steps = 0
        while place < path.end:
            ahead = ahead_of(path, offset, place, bound)
            assert ahead.inside and ahead.left == pytest.approx(np.abs(path.offsets[-1] - offset).max())
            place = ahead.s
            offset = offset + ahead.dq
            steps = steps + 1
            # Each step but the last covers a chord of one bound, so at least as much of the path.
            assert steps <= np.ceil(pieces)
        np.testing.assert_allclose(offset, path.offsets[-1], atol=1e-12)


def test_places_and_configurations_belong_together_on_every_arm() -> None:
    for name in ARMS:
        arm = arm_called(name)
        rng = np.random.default_rng(len(name))
        path = drawn(rng, arm, 0.05)
        before = None
        for place in np.linspace(0.0, path.end, 23):
            q = path.configuration(place)
            np.testing.assert_allclose(
                path.offset_of(arm.at(q), place), sampled(path, np.array([place]))[0], atol=1e-10
            )
            if before is not None:  # no jump at a waypoint
                apart = np.linalg.norm(arm.at(q).points - before, axis=1).max()
                most = np.abs(np.diff(path.offsets, axis=0)).sum(axis=1).max() * path.end / 22.0
                assert apart <= 2.0 * most * max(1.0, arm.length) + 1e-12
            before = arm.at(q).points
