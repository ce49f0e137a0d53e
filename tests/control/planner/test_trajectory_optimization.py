"""The most direct way, against closed forms of the planar arm, a boundary value problem and optimisation."""

from __future__ import annotations

import numpy as np
import pytest
from arms import template_arm
from hypothesis import given
from hypothesis import strategies as st
from sampling import examples
from scipy.integrate import solve_bvp
from scipy.optimize import minimize

import pinposture as pp
from pinposture import kernels
from pinposture.control.planner.avoidance import Avoidance
from pinposture.control.planner.objective import Objective
from pinposture.control.planner.path import JointPath
from pinposture.control.planner.trajectory_optimization import (
    DESCENTS,
    STAGING,
    Penalties,
    direct_path,
    relax_path,
)

LINKS = np.array([0.6, 0.4])
MU = 0.1
ENDS = [((-0.9, 1.4), (1.0, -0.8)), ((0.0, 0.2), (2.5, -0.4)), ((1.2, -1.0), (-1.9, 2.2))]


@pytest.fixture(scope="session")
def two() -> pp.Arm:
    return pp.Arm.from_modules([pp.ModuleTemplate("Rz", (pp.JointSpec("z"),), (length,)) for length in LINKS])


NEARLY = 0.003
"""By how much the energy of a path may be above the minimum: it ends where it is direct enough."""


def objective_of(arm: pp.Arm, goal: np.ndarray, mu: float = MU) -> Objective:
    target = pp.Target.from_configuration(arm, goal)
    return Objective(arm, target, joint_weight=mu * np.sqrt(arm.n_modules) / arm.length)


def way(arm: pp.Arm, start: np.ndarray, goal: np.ndarray, mu: float = MU, **options: object) -> JointPath:
    position_limits = np.array([arm.limits.lower, arm.limits.upper])
    return direct_path(objective_of(arm, goal, mu), arm.chain_at(start), goal, position_limits, **options)


def energy(arm: pp.Arm, start: np.ndarray, offsets: np.ndarray, mu: float) -> float:
    points = np.array([arm.at(arm.integrate(start, offset)).points for offset in offsets])
    turned = offsets / arm.joint_units
    return float((np.diff(points, axis=0) ** 2).sum() + mu**2 * (np.diff(turned, axis=0) ** 2).sum())


def straight(arm: pp.Arm, path: JointPath) -> np.ndarray:
    return np.linspace(0.0, 1.0, len(path.offsets))[:, None] * path.offsets[-1]


def swept(arm: pp.Arm, path: JointPath) -> float:
    """Length of the paths of control points over their distance from start to end, finely sampled."""
    configurations = [path.configuration(place) for place in np.linspace(0.0, path.end, 400)]
    points = np.array([arm.at(q).points for q in configurations])
    travel = np.linalg.norm(np.diff(points, axis=0), axis=2).sum()
    return float(travel / np.linalg.norm(points[-1] - points[0], axis=1).sum())


def two_link_energy(inner: np.ndarray, start: np.ndarray, goal: np.ndarray) -> float:
    q = np.vstack([start, inner.reshape(-1, 2), goal])
    elbow = LINKS[0] * np.exp(1j * q[:, 0])
    tip = elbow + LINKS[1] * np.exp(1j * q.sum(axis=1))
    points = float((np.abs(np.diff([elbow, tip])) ** 2).sum())
    return points + MU**2 * float((np.diff(q, axis=0) ** 2).sum())


@pytest.mark.long
@pytest.mark.parametrize("ends", ENDS[:2])
def test_two_links_no_waypoint_can_be_moved_for_the_better(two: pp.Arm, ends: tuple) -> None:
    start, goal = map(np.array, ends)
    path = way(two, start, goal)
    pieces = len(path.offsets) - 1
    assert pieces >= 24
    found = (start + path.offsets)[1:-1].ravel()
    least = two_link_energy(found, start, goal)
    rng = np.random.default_rng(0)
    for size in (1e-3, 1e-2, 1e-1, 0.5):
        for _ in range(20):
            assert two_link_energy(found + size * rng.normal(size=found.size), start, goal) > least
    for _ in range(50):  # and smooth ones, which change the way and not its smoothness
        waves = rng.normal(size=(4, 1, 2)) * 10.0 ** rng.uniform(-2.0, -0.3)
        shares = np.pi * np.arange(1, pieces)[:, None] / pieces
        bend = sum(wave * np.sin((k + 1) * shares) for k, wave in enumerate(waves))
        assert two_link_energy(found + bend.ravel(), start, goal) > (1.0 - NEARLY) * least
    polished = minimize(two_link_energy, found, (start, goal), method="BFGS", options={"maxiter": 60})
    assert least <= (1.0 + NEARLY) * polished.fun
    h = 1e-6
    gradient = [
        (two_link_energy(found + h * d, start, goal) - two_link_energy(found - h * d, start, goal)) / (2 * h)
        for d in np.eye(found.size)
    ]
    assert np.abs(gradient).max() < 0.02 * least  # a straight guess has 0.2 and more


def geodesic(start: np.ndarray, goal: np.ndarray, guess: np.ndarray) -> np.ndarray | None:
    """The geodesic of the metric as a boundary value problem: M q'' = (q' grad M q') / 2 - M' q'.

    M = J1^T J1 + J2^T J2 + mu^2 I is ((2 a^2 + b^2 + 2 a b c, b^2 + a b c), (..., b^2)) + mu^2 I with the
    lengths a, b of the links and the cosine c of the second joint.
    """
    a, b = LINKS

    def slope(_: np.ndarray, state: np.ndarray) -> np.ndarray:
        _, elbow, u, v = state
        c = a * b * np.cos(elbow)
        s = a * b * np.sin(elbow)
        m00 = 2 * a**2 + b**2 + 2 * c + MU**2
        m01 = b**2 + c
        m11 = b**2 + MU**2
        # The change of M along the way is v (-2 s, -s; -s, 0); its gradient is along the second joint.
        f0 = v * (2 * s * u + s * v)
        f1 = v * s * u - s * u * u - s * u * v
        det = m00 * m11 - m01**2
        return np.array([u, v, (m11 * f0 - m01 * f1) / det, (m00 * f1 - m01 * f0) / det])

    def ends(first: np.ndarray, last: np.ndarray) -> np.ndarray:
        return np.concatenate([first[:2] - start, last[:2] - goal])

    shares = np.linspace(0.0, 1.0, len(guess))
    trial = np.vstack([guess.T, np.gradient(guess, shares, axis=0).T])
    solved = solve_bvp(slope, ends, shares, trial, tol=1e-6)
    return solved.sol(shares)[:2].T if solved.success else None


@pytest.mark.parametrize("ends", ENDS)
def test_two_links_follow_the_geodesic_of_their_metric(two: pp.Arm, ends: tuple) -> None:
    start, goal = map(np.array, ends)
    found = start + way(two, start, goal).offsets
    exact = geodesic(start, goal, found)
    assert exact is not None
    from_line = start + np.linspace(0.0, 1.0, len(found))[:, None] * (goal - start)
    bend = np.linalg.norm(exact - from_line, axis=1).max()
    assert bend > 0.05
    assert np.linalg.norm(found - exact, axis=1).max() < 0.25 * bend  # of 12 pieces, where that is direct
    lengths = [two_link_energy(q[1:-1].ravel(), start, goal) for q in (found, exact)]
    assert lengths[0] == pytest.approx(lengths[1], rel=5e-3)


@given(seed=st.integers(0, 2**32 - 1), name=st.sampled_from(["Rz", "RyRz"]))
@examples(15)
def test_it_is_never_longer_than_joint_interpolation_and_stays_within_limits(seed: int, name: str) -> None:
    rng = np.random.default_rng(seed)
    arm = pp.Arm.from_modules([pp.template(name).with_limits(-1.0, 0.7)] * 5)
    start, goal = rng.uniform(-1.0, 0.7, (2, arm.nv))
    start[rng.random(arm.nv) < 0.3] = 0.7  # on a limit
    mu = 0.2 * arm.length / np.sqrt(arm.n_modules)
    path = way(arm, start, goal, mu)
    np.testing.assert_array_equal(path.offsets[0], 0.0)
    np.testing.assert_allclose(start + path.offsets[-1], goal, atol=1e-12)
    assert np.all(start + path.offsets >= -1.0 - 1e-12)
    assert np.all(start + path.offsets <= 0.7 + 1e-12)
    if len(path.offsets) > 2:
        assert energy(arm, start, path.offsets, mu) < energy(arm, start, straight(arm, path), mu)


def test_joint_interpolation_stays_where_it_is_direct() -> None:
    arm = pp.Arm.from_template("RyRz", 4)
    start = np.full(8, 0.1)
    path = way(arm, start, start + 0.01)
    assert len(path.offsets) == 2
    assert swept(arm, path) <= STAGING.kept_ratio


@pytest.mark.parametrize(("template", "modules"), [("Rz", 12), ("RyRz", 10)])
def test_an_exact_fold_is_not_turned_over_like_a_stick(template: str, modules: int) -> None:
    arm = template_arm(template, modules)
    goal = np.zeros(arm.nv)
    goal[arm.nv // arm.n_modules - 1] = np.pi  # the first joint about z
    mu = 0.2 * arm.length / np.sqrt(arm.n_modules)
    path = way(arm, arm.straight(), goal, mu)
    rigid = JointPath(path.objective, arm.straight(), straight(arm, path))
    assert swept(arm, rigid) > 1.5
    assert swept(arm, path) < 1.2


def test_a_turn_of_more_than_half_a_circle_is_taken_the_way_that_the_goal_means(two: pp.Arm) -> None:
    """From three quarters one way to three quarters the other: back all the way, not through pi."""
    start = np.array([-2.4, 0.1])
    goal = np.array([2.4, -0.1])
    path = way(two, start, goal)
    np.testing.assert_allclose(path.offsets[-1], goal - start, atol=1e-12)
    assert np.all(np.abs(start + path.offsets) <= np.pi + 1e-12)


def test_penalties_bend_the_path_around_an_obstacle(two: pp.Arm) -> None:
    start = np.array([-0.8, 0.3])
    goal = np.array([0.8, -0.3])
    free = way(two, start, goal)
    middle = two.at(start + free.offsets[len(free.offsets) // 2]).points[1] * 1.05
    radius = 0.12
    thin = 1e-3
    margin = 0.005
    post = pp.Cylinder((*middle[:2], -1.0), (*middle[:2], 1.0), radius)
    scene = pp.Scene({"post": post}, self_collision=False, margin=margin, arm_radius=thin)
    avoidance = Avoidance.of(scene, free.objective, pp.Limits().for_arm(two))
    path = way(two, start, goal, penalties=Penalties(None, avoidance, 100.0, margin), variant=2)

    def nearest(offsets: np.ndarray) -> float:
        points = np.array([two.at(start + offset).points for offset in offsets[1:-1]])
        return float(np.linalg.norm((points - middle)[:, :, :2], axis=2).min())

    assert nearest(free.offsets) < 0.7 * radius
    assert nearest(path.offsets) > radius + thin + margin - 1e-3


def test_joints_that_cannot_move_and_slides_take_part_as_they_should() -> None:
    slide = pp.JointSpec("x", type="prismatic", lower=-0.02, upper=0.03)
    sliding = pp.ModuleTemplate("sliding", (pp.JointSpec("y"), slide, pp.JointSpec("z")), (0.03,) * 3)
    arm = pp.Arm.from_modules([sliding] * 3)
    rng = np.random.default_rng(2)
    start, goal = (np.where(arm.slides, rng.uniform(-0.02, 0.03, 9), rng.uniform(-2, 2, 9)) for _ in "ab")
    mu = 0.2 * arm.length / np.sqrt(3)
    path = way(arm, start, goal, mu)
    slides = (start + path.offsets)[:, arm.slides]
    assert slides.min() >= -0.02 - 1e-12
    assert slides.max() <= 0.03 + 1e-12
    assert energy(arm, start, path.offsets, mu) < energy(arm, start, straight(arm, path), mu)


def test_a_given_path_is_relaxed_in_few_pieces_and_then_in_more(
    two: pp.Arm, monkeypatch: pytest.MonkeyPatch
) -> None:
    start, goal = (two.configuration(q) for q in ENDS[0])
    position_limits = np.array([two.limits.lower, two.limits.upper])
    detour = np.array([np.zeros(2), [1.5, 1.5], two.difference(start, goal)])
    counts: list[int] = []
    step = kernels.step_waypoints

    def counted(problem: object, damping: float, x: np.ndarray, *others: object) -> int:
        counts.append(len(x) - 1)
        return step(problem, damping, x, *others)

    monkeypatch.setattr(kernels, "step_waypoints", counted)
    objective = objective_of(two, goal)
    smooth, found = relax_path(objective, two.chain_at(start), detour, position_limits, Penalties())
    assert counts == sorted(counts)
    assert 0 < counts.count(32) <= DESCENTS.coarse.steps
    assert 0 < counts.count(48) <= DESCENTS.fine.steps
    assert found.end == 48
    shortest = energy(two, start, way(two, start, goal).offsets, MU) * way(two, start, goal).end
    for path in (smooth, found):
        assert energy(two, start, path.offsets, MU) * path.end <= (1.0 + 2.0 * NEARLY) * shortest


def test_clearance_costs_the_same_in_few_pieces_of_a_given_path_as_in_many() -> None:
    """N pieces of the same path have 1 / N of its energy of motion, and N times as many clearances."""
    penalties = Penalties(clearance_root=7.0)
    relative = [(pieces * penalties.for_pieces(pieces).clearance_root) ** 2 for pieces in (32, 64, 256)]
    assert relative == pytest.approx([(64 * 7.0) ** 2] * 3)
