"""Steps of all waypoints of a path against dense normal equations, with Jacobians from Pinocchio."""

from __future__ import annotations

import numpy as np
import pytest
from sampling import seeds
from scipy.interpolate import CubicSpline

import pinposture as pp
from pinposture import kernels
from pinposture.kernels.arrays import PathContacts, PathProblem, PathRows

WEIGHT = 3e-4
DAMPING = 1e-3


class Problem:
    """A rough path of an arm, with contacts of its modules and a few dense rows."""

    def __init__(self, seed: int, modules: int, pieces: int, stiff: float, contacts: int = 6) -> None:
        rng = np.random.default_rng(seed)
        self.arm = arm = pp.Arm.from_template("RyRz", modules, (0.5 / modules, 0.5 / modules))
        self.n, self.last, self.start = arm.nv, pieces, arm.straight()
        walk = np.cumsum(rng.normal(size=(pieces + 1, arm.nv)), axis=0)
        self.x = np.ascontiguousarray((walk - walk[0]) * 0.5 / np.abs(walk).max())
        self.bounds = np.full(arm.nv, -3.0), np.full(arm.nv, 3.0)
        self.states = [arm.at(arm.integrate(self.start, each)) for each in self.x]
        self.jacobians = [each.task_jacobians.reshape(-1, arm.nv) for each in self.states]
        self.points = np.array([each.points.ravel() for each in self.states])
        owners = np.sort(rng.integers(1, pieces, contacts * pieces))
        bodies = rng.integers(-1, modules, (len(owners), 2))  # of modules, at their ends; -1 stands still
        bodies[:, 0] = np.maximum(bodies[:, 0], 0)
        if stiff > 1.0:  # of two bodies in stiff contact the preconditioner knows less
            bodies[:, 1] = -1
        normals = stiff * rng.normal(size=(len(owners), 3))
        places = np.array([self.states[i].points[k] for i, k in zip(owners, bodies[:, 0], strict=True)])
        # Contacts as rows, by other means: the point moves with both bodies.
        self.matrix = np.zeros((len(owners), arm.nv))
        for row, (owner, both) in enumerate(zip(owners, bodies, strict=True)):
            for k, sign in zip(both, (1.0, -1.0), strict=True):
                if k >= 0:
                    state = self.states[owner]
                    apart = places[row] - state.points[k]
                    moved = state.jacobians[k] + np.cross(state.angular_jacobians[k].T, apart).T
                    self.matrix[row] += sign * normals[row] @ moved
        self.owners = owners
        self.contacts = PathContacts(
            errors=0.01 * stiff * np.abs(rng.normal(size=len(owners))),
            begins=np.searchsorted(owners, np.arange(pieces + 2)).astype(np.int64),
            carried=np.where(bodies < 0, 0, arm.kinematics.ends[bodies]).astype(np.int64),
            points=places.reshape(-1, 3),
            normals=normals,
        )
        self.rows = PathRows(  # of tasks, which the preconditioner does not know
            matrix=rng.normal(size=(3, arm.nv)),
            errors=0.01 * rng.normal(size=3),
            waypoints=rng.integers(1, pieces, 3),
        )

    def step(self) -> np.ndarray:
        """What the kernel finds, (N + 1, n)."""
        constants = self.arm.kinematics.constants
        steps = np.full_like(self.x, np.nan)
        ends = np.array(self.arm.kinematics.ends, dtype=np.int64)
        given = constants, np.arange(self.n), ends, np.ones(self.n), self.arm.positions(self.start)
        path = PathProblem(*given, *self.bounds, WEIGHT)
        assert kernels.step_waypoints(path, DAMPING, self.x, self.rows, self.contacts, steps) > 0
        assert not steps[0].any()
        assert not steps[-1].any()
        return steps

    def equations(self, active: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Matrix H and right-hand side, with the contacts that count, for the waypoints between the ends."""
        n = self.n
        count = self.last - 1
        matrix = np.zeros((count * n, count * n))
        right = np.zeros(count * n)
        for i in range(self.last):  # the energy of one piece: |J_1 x_1 - J_0 x_0 + gap|^2, and of the joints
            both = np.zeros((len(self.points[0]) + n, (self.last + 1) * n))
            one = slice(i * n, (i + 1) * n)
            other = slice((i + 1) * n, (i + 2) * n)
            both[:-n, one] = -self.jacobians[i]
            both[:-n, other] = self.jacobians[i + 1]
            both[-n:, one] = -np.sqrt(WEIGHT) * np.eye(n)
            both[-n:, other] = np.sqrt(WEIGHT) * np.eye(n)
            gap = self.points[i + 1] - self.points[i]
            gap = np.concatenate([gap, np.sqrt(WEIGHT) * (self.x[i + 1] - self.x[i])])
            both = both[:, n:-n]
            matrix += both.T @ both
            right -= both.T @ gap
        typical = np.mean([np.trace(each.T @ each) for each in self.jacobians[1:-1]]) / n
        matrix += DAMPING * typical * np.eye(count * n)
        tasks = zip(self.rows.waypoints, self.rows.matrix, self.rows.errors, strict=True)
        parts = zip(self.owners, self.matrix, self.contacts.errors, strict=True)
        for owner, row, error in [
            *tasks,
            *(each for each, is_on in zip(parts, active, strict=True) if is_on),
        ]:
            own = slice((owner - 1) * n, owner * n)
            matrix[own, own] += np.outer(row, row)
            right[own] += error * row
        return matrix, right


def decrease(matrix: np.ndarray, right: np.ndarray, step: np.ndarray) -> float:
    """By how much a step lowers the quadratic model."""
    return float(right @ step - 0.5 * step @ matrix @ step)


def share_of_decrease(problem: Problem, active: np.ndarray, step: np.ndarray) -> float:
    """By how much a step lowers the model, relative to the best step."""
    matrix, right = problem.equations(active)
    best = decrease(matrix, right, np.linalg.solve(matrix, right))
    return decrease(matrix, right, step[1:-1].ravel()) / best


def settled(problem: Problem) -> tuple[np.ndarray, np.ndarray]:
    """A step, and which contacts are too close before it, or after it, if the step is as good as linear."""
    step = problem.step()
    moved = np.einsum("ij,ij->i", problem.matrix, step[problem.owners])
    return step, problem.contacts.errors > moved


@pytest.mark.parametrize(("stiff", "least"), [(0.0, 0.99), (1.0, 0.94), (30.0, 0.99)])
@pytest.mark.parametrize("seed", seeds(20))
def test_a_step_lowers_the_model_as_far_as_the_exact_one(seed: int, stiff: float, least: float) -> None:
    """The preconditioner knows too little of pairs of bodies (`stiff` of 1) to tell how much is left."""
    rng = np.random.default_rng(seed)
    judged = 0
    for _ in range(100):
        pieces = rng.choice([2, 3, 5, 10, 15, 16, 17, 20, 34])  # up to three for each lane
        problem = Problem(int(rng.integers(2**32)), int(rng.integers(1, 9)), int(pieces), stiff, contacts=2)
        problem.contacts = problem.contacts._replace(errors=problem.contacts.errors + 100.0 * stiff)
        step, active = settled(problem)
        if np.all(active == (stiff > 0.0)):  # else the set is corrected a few times only
            assert share_of_decrease(problem, active, step) >= least
            judged += 1
        if judged == 8:
            break
    assert judged >= 1


@pytest.mark.parametrize("weight", [10.0, 100.0])
@pytest.mark.parametrize("seed", seeds(20))
def test_a_step_fulfils_tasks_of_large_weight(seed: int, weight: float) -> None:
    """The preconditioner does not know their rows, and would take a step that hardly begins for the last."""
    rng = np.random.default_rng(seed)
    for _ in range(10):
        problem = Problem(int(rng.integers(2**32)), int(rng.integers(1, 9)), int(rng.integers(2, 20)), 0.0)
        rows = problem.rows
        problem.rows = rows._replace(matrix=weight * rows.matrix, errors=weight * rows.errors)
        step, active = settled(problem)
        assert share_of_decrease(problem, active, step) >= 0.99


@pytest.mark.parametrize("seed", range(5))
def test_joints_at_a_limit_are_held_and_the_others_are_optimal(seed: int) -> None:
    problem = Problem(seed, 6, 12, 0.0)
    matrix, right = problem.equations(np.zeros(len(problem.owners), dtype=np.bool_))
    downhill = right.reshape(-1, problem.n)
    upper = problem.x[1:-1].max(axis=0)  # each joint is at its limit at one waypoint
    problem.bounds = np.full(problem.n, -3.0), upper
    stuck = ((problem.x[1:-1] >= upper) & (downhill > 0.0)).ravel()
    assert stuck.any()
    step = problem.step()[1:-1].ravel()
    assert not step[stuck].any()
    free = np.flatnonzero(~stuck)
    matrix = matrix[np.ix_(free, free)]
    right = right[free]
    best = decrease(matrix, right, np.linalg.solve(matrix, right))
    assert decrease(matrix, right, step[free]) >= 0.99 * best


@pytest.mark.parametrize("seed", range(5))
def test_contacts_count_where_the_step_leaves_them_too_close(seed: int) -> None:
    problem = Problem(seed, 6, 12, 1.0, contacts=1)
    step, active = settled(problem)
    assert 0 < active.sum() < len(active)
    assert share_of_decrease(problem, active, step) >= 0.95  # the set is corrected a few times only


@pytest.mark.parametrize(("pieces", "factor"), [(1, 2), (2, 4), (6, 2), (24, 4), (5, 1)])
def test_refined_waypoints_are_on_the_natural_spline(pieces: int, factor: int) -> None:
    x = np.random.default_rng(pieces).normal(size=(pieces + 1, 7))
    finer = np.empty((factor * pieces + 1, 7))
    kernels.refine_waypoints(x, finer)
    places = np.linspace(0.0, pieces, factor * pieces + 1)
    spline = CubicSpline(np.arange(pieces + 1.0), x, bc_type="natural" if pieces > 1 else "not-a-knot")
    np.testing.assert_allclose(finer, spline(places), atol=1e-13)
    slopes = np.empty_like(x)
    kernels.spline_slopes(x, slopes)
    np.testing.assert_allclose(slopes, spline(np.arange(pieces + 1.0), 1), atol=1e-12)


@pytest.mark.parametrize("seed", range(5))
def test_a_divided_path_has_short_and_equal_parts(seed: int) -> None:
    rng = np.random.default_rng(seed)
    path = rng.normal(size=(seed + 1, 7)) * rng.uniform(0.0, 2.0, (seed + 1, 1))
    path = np.concatenate([path, path[-1:]])  # a piece without motion
    longest = rng.uniform(0.1, 1.0, 7)
    finer, ends = kernels.divide_path(path, longest)
    np.testing.assert_array_equal(finer[ends], path)
    sizes = np.abs(np.diff(path, axis=0) / longest).max(axis=1)
    counts = np.diff(ends)
    np.testing.assert_array_equal(
        counts, np.maximum(np.ceil(sizes), 1.0)
    )  # short enough, and no more than that
    places = np.interp(np.arange(len(finer)), ends, np.arange(len(path)))
    expected = np.column_stack([np.interp(places, np.arange(len(path)), joint) for joint in path.T])
    np.testing.assert_allclose(finer, expected, atol=1e-14)


@pytest.mark.parametrize("seed", range(12))
def test_a_step_finds_which_contacts_count_after_it(seed: int) -> None:
    """The model is piecewise quadratic; its minimum by Newton steps that are halved until they lower it."""
    problem = Problem(seed, 6, 20, 10.0, contacts=3)
    errors = problem.contacts.errors * np.random.default_rng(seed).choice([1.0, -1.0], len(problem.owners))
    problem.contacts = problem.contacts._replace(errors=np.ascontiguousarray(errors))
    nothing = np.zeros(len(errors), dtype=np.bool_)
    matrix, right = problem.equations(nothing)

    def left(step: np.ndarray) -> np.ndarray:
        moved = np.einsum("ij,ij->i", problem.matrix, step.reshape(-1, problem.n)[problem.owners - 1])
        return np.maximum(errors - moved, 0.0)

    def model(step: np.ndarray) -> float:
        return 0.5 * float((left(step) ** 2).sum()) - decrease(matrix, right, step)

    best = np.zeros(len(right))
    for _ in range(50):
        whole = np.linalg.solve(*problem.equations(left(best) > 0.0)) - best
        best = min((best + 0.5**k * whole for k in range(20)), key=model)
    found = model(problem.step()[1:-1].ravel())
    start = model(np.zeros(len(right)))
    assert start - found >= 0.97 * (start - model(best))
