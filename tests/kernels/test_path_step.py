"""Steps of all waypoints of a path against dense normal equations, with Jacobians from Pinocchio."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sampling import examples

import pinposture as pp
from pinposture import kernels
from pinposture.kernels.arrays import PathProblem, PathRows

WEIGHT, DAMPING = 3e-4, 1e-3


class Problem:
    """A rough path of an arm, with contacts of its control points and a few dense rows."""

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
        rows, normals, places, carried, owners = [], [], [], [], []
        for owner in rng.integers(1, pieces, contacts * pieces):
            k, normal = int(rng.integers(modules)), stiff * rng.normal(size=3)
            rows.append(normal @ self.states[owner].task_jacobians[k])
            normals.append(normal)
            places.append(self.states[owner].points[k])
            carried.append([arm.kinematics.ends[k], 0])
            owners.append(owner)
        for owner in rng.integers(1, pieces, 3):  # rows of tasks, which the preconditioner does not know
            rows.append(rng.normal(size=arm.nv))
            normals.append(np.zeros(3))
            places.append(np.zeros(3))
            carried.append([0, 0])
            owners.append(owner)
        self.rows = PathRows(
            matrix=np.array(rows),
            errors=0.01 * stiff * rng.normal(size=len(rows)),
            waypoints=np.array(owners, dtype=np.int64),
            one_sided=np.zeros(len(rows), dtype=np.bool_),
            carried=np.array(carried, dtype=np.int64),
            points=np.array(places),
            directions=np.array(normals),
        )

    def step(self) -> np.ndarray:
        """What the kernel finds, (N + 1, n)."""
        constants, steps = self.arm.kinematics.constants, np.full_like(self.x, np.nan)
        ends = np.array(self.arm.kinematics.ends, dtype=np.int64)
        given = constants, np.arange(self.n), ends, np.ones(self.n), self.arm.positions(self.start)
        path = PathProblem(*given, *self.bounds, WEIGHT)
        assert kernels.step_waypoints(path, DAMPING, self.x, self.rows, steps) > 0
        assert not steps[0].any()
        assert not steps[-1].any()
        return steps

    def equations(self, active: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Matrix H and right-hand side of the rows that are active, for the waypoints between the ends."""
        n, count = self.n, self.last - 1
        matrix, right = np.zeros((count * n, count * n)), np.zeros(count * n)
        for i in range(self.last):  # the energy of one piece: |J_1 x_1 - J_0 x_0 + gap|^2, and of the joints
            both = np.zeros((len(self.points[0]) + n, (self.last + 1) * n))
            one, other = slice(i * n, (i + 1) * n), slice((i + 1) * n, (i + 2) * n)
            both[:-n, one], both[:-n, other] = -self.jacobians[i], self.jacobians[i + 1]
            both[-n:, one], both[-n:, other] = -np.sqrt(WEIGHT) * np.eye(n), np.sqrt(WEIGHT) * np.eye(n)
            gap = self.points[i + 1] - self.points[i]
            gap = np.concatenate([gap, np.sqrt(WEIGHT) * (self.x[i + 1] - self.x[i])])
            both = both[:, n:-n]
            matrix += both.T @ both
            right -= both.T @ gap
        typical = np.mean([np.trace(each.T @ each) for each in self.jacobians[1:-1]]) / n
        matrix += DAMPING * typical * np.eye(count * n)
        for row in np.flatnonzero(active):
            own = slice((self.rows.waypoints[row] - 1) * n, self.rows.waypoints[row] * n)
            matrix[own, own] += np.outer(self.rows.matrix[row], self.rows.matrix[row])
            right[own] += self.rows.errors[row] * self.rows.matrix[row]
        return matrix, right


def decrease(matrix: np.ndarray, right: np.ndarray, step: np.ndarray) -> float:
    """By how much a step lowers the quadratic model."""
    return float(right @ step - 0.5 * step @ matrix @ step)


@given(
    seed=st.integers(0, 2**32 - 1),
    modules=st.integers(1, 8),
    pieces=st.integers(2, 20),
    stiff=st.sampled_from([0.0, 1.0, 30.0]),
)
@examples(40)
def test_a_step_lowers_the_model_as_far_as_the_exact_one(
    seed: int, modules: int, pieces: int, stiff: float
) -> None:
    problem = Problem(seed, modules, pieces, stiff)
    matrix, right = problem.equations(np.ones(len(problem.rows.errors), dtype=np.bool_))
    best = decrease(matrix, right, np.linalg.solve(matrix, right))
    assert decrease(matrix, right, problem.step()[1:-1].ravel()) >= 0.999 * best


@pytest.mark.parametrize("seed", range(5))
def test_joints_at_a_limit_are_held_and_the_others_are_optimal(seed: int) -> None:
    problem = Problem(seed, 6, 12, 10.0)
    matrix, right = problem.equations(np.ones(len(problem.rows.errors), dtype=np.bool_))
    downhill = right.reshape(-1, problem.n)
    upper = problem.x[1:-1].max(axis=0)  # each joint is at its limit at one waypoint
    problem.bounds = np.full(problem.n, -3.0), upper
    stuck = ((problem.x[1:-1] >= upper) & (downhill > 0.0)).ravel()
    assert stuck.any()
    step = problem.step()[1:-1].ravel()
    assert not step[stuck].any()
    free = np.flatnonzero(~stuck)
    matrix, right = matrix[np.ix_(free, free)], right[free]
    best = decrease(matrix, right, np.linalg.solve(matrix, right))
    assert decrease(matrix, right, step[free]) >= 0.999 * best


@pytest.mark.parametrize("seed", range(5))
def test_rows_on_one_side_count_where_the_step_misses_them(seed: int) -> None:
    problem = Problem(seed, 6, 12, 1.0, contacts=1)
    every: Any = np.ones_like(problem.rows.one_sided)
    problem.rows = problem.rows._replace(one_sided=every)
    step = problem.step()
    moved = np.einsum("ij,ij->i", problem.rows.matrix, step[problem.rows.waypoints])
    missed = problem.rows.errors > moved
    assert 0 < missed.sum() < len(missed)
    matrix, right = problem.equations(missed)
    best = decrease(matrix, right, np.linalg.solve(matrix, right))
    assert decrease(matrix, right, step[1:-1].ravel()) >= 0.95 * best  # the set is corrected a few times only
