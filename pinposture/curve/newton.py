"""Newton's method that cannot leave its bracket, on many scalar equations at once."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Values = NDArray[np.float64]


def crossings(
    function: Callable[[Values], tuple[Values, Values]], low: Values, high: Values, guess: Values
) -> Values:
    """Find where each function crosses zero from below inside its bracket.

    Args:
        function: maps x (n,) to the values (n,) and the slopes (n,) of n functions, one at each x.
        low: lower ends, shape (n,), where the functions are <= 0.
        high: upper ends, shape (n,), where they are >= 0.
        guess: where to begin, shape (n,).

    Returns:
        The crossings, shape (n,): to 1e-10 of the brackets, and better where Newton's method converged.
    """
    x, width = guess, high - low
    for _ in range(60):
        value, slope = function(x)
        low, high = np.where(value <= 0, x, low), np.where(value >= 0, x, high)
        # A flat slope gives a step out of every bracket, and so a bisection.
        trial = x - value / np.where(slope > 0, slope, np.finfo(float).tiny ** 0.5)
        trial = np.where((trial >= low) & (trial <= high), trial, 0.5 * (low + high))
        step, x = np.abs(trial - x), trial
        if (step <= 1e-10 * width).all():
            break
    return x
