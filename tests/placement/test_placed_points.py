"""Points that an arm can take, against the postures that they were read from and against enumeration."""

from __future__ import annotations

from functools import cache
from itertools import product

import numpy as np
import pinocchio as pin
import pytest
from sampling import seeds
from scipy.optimize import least_squares

import pinposture as pp
from pinposture.placement.points import place_sequentially, taken_exactly
from pinposture.units import length_text


def hinges(*axes, low=-2.5, high=2.5):
    return tuple(pp.JointSpec(axis, lower=low, upper=high) for axis in axes)


OBLIQUE = ((1.0, 0.3, -0.2), (0.1, 1.0, 0.4), (-0.3, 0.2, 1.0), (0.5, 1.0, -0.6))
SLIDE = pp.JointSpec("x", type="prismatic", lower=0.0, upper=0.04)
ENDLESS = tuple(pp.JointSpec(axis, type="continuous") for axis in ("y", (1.0, 1.0, 1.0)))
MODULES = {
    "torus, equal links": (hinges("y", "z", low=-np.pi, high=np.pi), (0.05, 0.05), 12),
    "torus, longer first": (hinges("y", "z", low=-np.pi, high=np.pi), (0.06, 0.03), 12),
    "torus, longer last": (hinges("z", "y", low=-np.pi, high=np.pi), (0.03, 0.06), 12),
    "planar": (hinges("z", low=-np.pi, high=np.pi), (0.1,), 15),
    "planar, three hinges": (hinges("z", "z", "z", low=-2.0, high=2.0), (0.05, 0.04, 0.05), 6),
    "point on the last axis": (hinges("y", "x"), (0.03, 0.02), 10),
    "oblique pair": (hinges(*OBLIQUE[:2]), (0.02, 0.03), 20),
    "oblique three": (hinges(*OBLIQUE[:3]), (0.02, 0.02, 0.03), 8),
    "roll, pitch, yaw": (hinges("x", "y", "z"), (0.0, 0.02, 0.03), 8),
    "four hinges": (hinges(*OBLIQUE), (0.02, 0.02, 0.03, 0.02), 6),
    "sliding": ((*hinges("y", "z"), SLIDE), (0.02, 0.02, 0.03), 5),
    "without limits": (ENDLESS, (0.03, 0.03), 8),
}


@cache
def arm_of(name: str) -> pp.Arm:
    joints, lengths, modules = MODULES[name]
    return pp.Arm.from_modules([pp.ModuleTemplate("a", joints, lengths)] * modules)


def points_by_pinocchio(arm: pp.Arm, q: np.ndarray) -> np.ndarray:
    data = arm.model.createData()
    pin.framesForwardKinematics(arm.model, data, q)
    return np.array([data.oMf[arm.model.getFrameId(name)].translation for name in arm.control_points])


@pytest.mark.parametrize("name", MODULES)
@pytest.mark.parametrize("seed", seeds(10))
def test_points_of_any_posture_are_taken_again(name: str, seed: int) -> None:
    arm = arm_of(name)
    points = points_by_pinocchio(arm, arm.random(np.random.default_rng(seed)))
    target = pp.fit_points(arm, points)
    assert arm.within_limits(target.q)
    assert np.abs(points_by_pinocchio(arm, target.q) - points).max() <= 1e-7 * arm.length
    assert target.approximate == ""
    assert pp.track(arm, pp.Target.from_points(arm, points), arm.straight(), max_steps=800).converged


def elbows(link: float, base: np.ndarray, heading: float, point: np.ndarray) -> list[tuple[float, float]]:
    """Both pairs of angles of two equal links in the plane that reach from a base to a point."""
    way = point - base
    distance = float(np.hypot(*way))
    if distance > 2.0 * link:
        return []
    half = np.arccos(distance / (2.0 * link))
    link_axes = np.arctan2(way[1], way[0]) - heading
    pairs = [(link_axes + sign * half, -2.0 * sign * half) for sign in (1.0, -1.0)]
    return [(float(np.angle(np.exp(1j * a))), b) for a, b in pairs]


def reachable_by_enumeration(link: float, points: np.ndarray, limit: float) -> bool:
    """Whether a planar arm of pairs of equal links takes all points with some of its 2^m elbows."""
    for branch in product((0, 1), repeat=len(points)):
        base = np.zeros(2)
        heading = 0.0
        for choice, point in zip(branch, points, strict=True):
            pairs = elbows(link, base, heading, point)
            if not pairs or max(map(abs, pairs[choice])) > limit:
                break
            base = point
            heading = heading + sum(pairs[choice])
        else:
            return True
    return False


@pytest.mark.long
def test_planar_pairs_take_what_enumeration_of_all_elbows_takes() -> None:
    link = 0.1
    limit = 1.9
    module = pp.ModuleTemplate("a", hinges("z", "z", low=-limit, high=limit), (link, link))
    arm = pp.Arm.from_modules([module] * 3)
    wide = pp.Arm.from_template("RzRz", 3, (link, link))
    verdicts = []
    for seed in range(100):
        q = np.random.default_rng(seed).uniform(-2.4, 2.4, 6)
        points = wide.at(q).points
        taken = pp.fit_points(arm, points).residual.max() < 1e-8
        verdicts.append((taken, reachable_by_enumeration(link, points[:, :2], limit)))
    assert {expected for _, expected in verdicts} == {True, False}
    assert [s for s, (found, expected) in enumerate(verdicts) if found != expected] == []


@pytest.mark.long
@pytest.mark.parametrize("seed", seeds(6))
def test_three_hinges_take_what_many_starts_take(seed: int) -> None:
    """Two modules of three oblique hinges within narrow limits, some points out of their reach."""
    axes = OBLIQUE[:3]
    lengths = (0.02, 0.02, 0.03)
    arm, wide = (
        pp.Arm.from_modules([pp.ModuleTemplate("a", hinges(*axes, low=-limit, high=limit), lengths)] * 2)
        for limit in (1.0, 1.2)
    )
    rng = np.random.default_rng(seed)
    points = points_by_pinocchio(wide, wide.random(rng))

    def left(q: np.ndarray) -> np.ndarray:
        return (points_by_pinocchio(arm, q) - points).ravel() / arm.length

    best = np.inf
    for _ in range(60):
        found = least_squares(left, rng.uniform(-1.0, 1.0, 6), bounds=(-1.0, 1.0), xtol=1e-14, ftol=1e-14)
        best = min(best, float(np.abs(found.fun).max()))
        if best < 1e-8:
            break
    target = pp.fit_points(arm, points)
    assert arm.within_limits(target.q)
    assert (target.residual.max() < 1e-6 * arm.length) == (best < 1e-6)


@pytest.mark.parametrize("moved", [0, 5, 11])
def test_points_that_the_arm_cannot_take_are_not(moved: int) -> None:
    arm = pp.Arm.from_template("RyRz", 12)
    points = arm.at(arm.random(np.random.default_rng(1))).points.copy()
    points[moved] += 1e-3
    target = pp.fit_points(arm, points)
    assert 1e-4 < target.residual.max() < 0.05  # the fit comes close all the same
    assert "local minimum" in target.approximate
    assert length_text(target.residual.max()) in target.approximate
    run = pp.track(arm, pp.Target.from_points(arm, points), arm.straight(), max_steps=800)
    assert run.status == "stalled"
    assert "local minimum" in run.reason


def test_points_out_of_the_limits_are_not_found() -> None:
    narrow = pp.Arm.from_modules([pp.template("RyRz").with_limits(-0.5, 0.5)] * 4)
    wide = pp.Arm.from_template("RyRz", 4)
    every = np.ones(4, dtype=bool)
    bent = wide.at(wide.configuration(np.full(8, 0.8))).points
    assert place_sequentially(wide, bent, every, np.zeros(8))[1]
    assert not place_sequentially(narrow, bent, every, np.zeros(8))[1]
    assert taken_exactly(wide, bent, np.zeros(8)) is not None
    assert taken_exactly(narrow, bent, np.zeros(8)) is None


@pytest.mark.parametrize("seed", seeds(6))
def test_free_points_are_free(seed: int) -> None:
    arm = arm_of("oblique pair")
    free = [11, 12, 13]
    points = arm.at(arm.random(np.random.default_rng(seed))).points.copy()
    points[free] += 0.2
    weights = np.ones(arm.n_modules)
    weights[free] = 0.0
    target = pp.fit_points(arm, points, weights)
    assert target.residual[weights > 0.0].max() <= 1e-7 * arm.length
    assert target.residual[free].min() > 0.0
    assert target.approximate == ""


def test_of_two_elbows_the_nearer_is_taken() -> None:
    arm = pp.Arm.from_template("RzRz", 3)
    for seed in range(20):
        q = np.random.default_rng(seed).uniform(-1.5, 1.5, 6)
        positions, taken = place_sequentially(arm, arm.at(q).points, np.ones(3, dtype=bool), q + 1e-3)
        assert taken
        np.testing.assert_allclose(positions, q, atol=1e-7)
