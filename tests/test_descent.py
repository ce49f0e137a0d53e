"""The loop of damped least squares: what it finds, and how it damps its steps."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import least_squares

from pinposture.control.planner.damped_least_squares import POSTURE_SEARCH
from pinposture.descent import Rating, descend


class Valley:
    """The valley of Rosenbrock, x_1 = x_0^2, that falls towards (1, 1)."""

    def residual(self, x: np.ndarray) -> np.ndarray:
        return np.array([10.0 * (x[1] - x[0] ** 2), 1.0 - x[0]])

    def rate(self, x: np.ndarray) -> Rating:
        return Rating(0.0, 0.5 * float(self.residual(x) @ self.residual(x)))

    def is_solved(self, x: np.ndarray, rating: Rating) -> bool:
        return rating.cost < 1e-20

    def step(self, x: np.ndarray, damping: float) -> np.ndarray:
        slopes = np.array([[-20.0 * x[0], 10.0], [-1.0, 0.0]])
        return x - np.linalg.solve(
            slopes.T @ slopes + 1e-3 * damping * np.eye(2), slopes.T @ self.residual(x)
        )


@pytest.mark.parametrize("start", [(-1.2, 1.0), (2.0, -3.0)])
def test_the_minimum_is_found(start: tuple[float, float]) -> None:
    valley = Valley()
    found, rating = descend(valley, np.array(start), 200, POSTURE_SEARCH)
    np.testing.assert_allclose(found, least_squares(valley.residual, start, xtol=1e-15).x, atol=1e-8)
    assert rating == valley.rate(found)


class Told:
    """Ratings that are told in advance; a state is the number of the step that led to it."""

    def __init__(self, *costs: float | None) -> None:
        self.costs = costs
        self.dampings: list[float] = []

    def rate(self, state: int) -> Rating:
        cost = self.costs[state]
        assert cost is not None
        return Rating(0.0, cost)

    def is_solved(self, state: int, rating: Rating) -> bool:
        return len(self.dampings) == len(self.costs) - 1

    def step(self, state: int, damping: float) -> int | None:
        self.dampings.append(damping)
        number = len(self.dampings)
        return None if self.costs[number] is None else number


def test_worse_steps_are_undone_and_damped_more() -> None:
    told = Told(8.0, 9.0, None, 5.0, 7.0, 4.0)
    assert descend(told, 0, 99, POSTURE_SEARCH) == (5, Rating(0.0, 4.0))
    up = POSTURE_SEARCH.increase
    down = POSTURE_SEARCH.decrease
    np.testing.assert_allclose(told.dampings, [1.0, up, up**2, up**2 * down, up**3 * down])


def test_steps_that_keep_the_rating_end_the_search() -> None:
    told = Told(*[3.0] * 20)
    descend(told, 0, 99, POSTURE_SEARCH)
    assert len(told.dampings) == POSTURE_SEARCH.idle
