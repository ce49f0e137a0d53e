"""Damped steps that improve a state until it is good enough: the loop of least squares outside kernels."""

from __future__ import annotations

from typing import NamedTuple, Protocol, TypeVar

from pinposture.kernels.arrays import SearchSettings

State = TypeVar("State")


class Rating(NamedTuple):
    """How far a state is from a solution. Of two states, that with the smaller violation is better.

    Attributes:
        violation: violation of constraints [m].
        cost: half the sum of squared errors [m^2], which decides between equal violations.
    """

    violation: float
    cost: float


class LeastSquaresProblem(Protocol[State]):
    """A problem that `descend` solves."""

    def rate(self, state: State) -> Rating:
        """Rate a state."""

    def is_solved(self, state: State, rating: Rating) -> bool:
        """Whether a state is good enough to end the search."""

    def step(self, state: State, damping: float) -> State | None:
        """Return the state after a step that reduces the errors; None if there is none.

        Args:
            state: the state.
            damping: factor of the damping, 1 at first.
        """


def descend(
    problem: LeastSquaresProblem[State], state: State, steps: int, settings: SearchSettings
) -> tuple[State, Rating]:
    """Improve a state by damped steps, until it is good enough or steps no longer improve it.

    The damping falls after a step that improves the state or keeps its rating. Any other is undone, and the
    damping rises.

    Args:
        problem: what is solved.
        state: the initial state.
        steps: largest number of steps.
        settings: how the damping changes, and when steps no longer improve a state.
    """
    rating = problem.rate(state)
    damping = 1.0
    idle = 0
    for _ in range(steps):
        if problem.is_solved(state, rating):
            break
        tried = problem.step(state, damping)
        tried_rating = None if tried is None else problem.rate(tried)
        if tried is not None and tried_rating is not None and tried_rating <= rating:
            closer = tried_rating.violation < rating.violation
            cheaper = tried_rating.cost < (1.0 - settings.converged) * rating.cost
            idle = 0 if closer or cheaper else idle + 1
            state = tried
            rating = tried_rating
            damping = max(damping * settings.decrease, settings.least_factor)
        else:
            damping *= settings.increase
            idle += damping > settings.most_factor
        if idle >= settings.idle:
            break
    return state, rating
