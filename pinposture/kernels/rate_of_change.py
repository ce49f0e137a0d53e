"""The rate at which measured vectors change, for as long as it has been constant."""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple

import numpy as np

from pinposture.kernels.arrays import Array1, Array2
from pinposture.kernels.compiled import compiled


class RateFitSettings(NamedTuple):
    """When vectors count as changing at a constant rate, beside the noise of three coordinates."""

    fewest: int = 3
    """Fewest vectors that tell a rate: two are as well those of something that is put elsewhere."""

    largest_deviation: float = 1.5
    """Largest ratio of the deviation of vectors from a constant rate to their noise. With 50 vectors it
    varies by a tenth, so that noise alone hardly shortens a fit."""

    last_off: float = 4.0
    """Distance of the last vector from a constant rate that noise explains, in standard deviations."""

    significant: float = 6.0
    """Rate that noise explains, in standard deviations, and by `few_vectors` larger with few vectors. With
    both, none of 20 obstacles that jitter had a velocity in 3,000 cycles each."""

    few_vectors: float = 4.0
    """Share by which it is larger with three vectors; half of it with four, and so on."""

    median: float = 1.884
    """Median distance of a vector from the middle of its neighbours, in standard deviations: sqrt(1.5) times
    the median of a chi distribution of three degrees of freedom."""


RATE_FIT = RateFitSettings()


@compiled
def fit_rate(times: Array1, values: Array2, least_noise: float, rate: Array1) -> bool:
    """Fit a rate to as many of the last vectors as have changed at a constant one, within their noise.

    The noise is estimated from how far vectors are from the line through those before and after them. A
    median makes it independent of single jumps. While vectors accelerate, that counts as noise too, and the
    fit uses few of them.

    Args:
        times: times, increasing, (n,) [s], n >= 3.
        values: vectors of three degrees of freedom, (n, d).
        least_noise: noise that is assumed at least.
        rate: the rate of change is written here, (d,); zero if noise explains it, or if there is none.

    Returns:
        Whether at least the last three vectors have changed at a constant rate.
    """
    count, size = values.shape
    deviations = np.zeros(count - 2)
    for i in range(1, count - 1):
        share = (times[i] - times[i - 1]) / (times[i + 1] - times[i - 1])
        for j in range(size):
            between = (1.0 - share) * values[i - 1, j] + share * values[i + 1, j]
            deviations[i - 1] += (values[i, j] - between) ** 2
    typical = sqrt(np.sort(deviations)[(count - 3) // 2])
    noise = max(typical / RATE_FIT.median, least_noise)
    # Sums over the last n vectors, relative to the last one.
    sums = np.zeros(size)
    products = np.zeros(size)
    slope = np.zeros(size)
    rate[:] = 0.0
    sum_t = 0.0
    sum_tt = 0.0
    squares = 0.0
    straight = False
    for n in range(1, count + 1):
        t = times[count - n] - times[count - 1]
        sum_t += t
        sum_tt += t * t
        for j in range(size):
            x = values[count - n, j] - values[count - 1, j]
            sums[j] += x
            products[j] += t * x
            squares += x * x
        if n < RATE_FIT.fewest:
            continue
        spread = sum_tt - sum_t * sum_t / n
        rest = squares
        last_off = 0.0
        speed = 0.0
        for j in range(size):
            slope[j] = (products[j] - sum_t * sums[j] / n) / spread
            rest -= sums[j] * sums[j] / n + spread * slope[j] * slope[j]
            last_off += ((sums[j] - slope[j] * sum_t) / n) ** 2
            speed += slope[j] * slope[j]
        error = sqrt(max(rest, 0.0) / (3.0 * (n - 2)))
        least = RATE_FIT.significant * (1.0 + RATE_FIT.few_vectors / (n - 2)) * max(noise, error)
        significant = sqrt(speed * spread) > least
        constant = error <= RATE_FIT.largest_deviation * noise and sqrt(last_off) <= RATE_FIT.last_off * noise
        if constant or (n == RATE_FIT.fewest and significant):  # it may accelerate more than before
            straight = True
            for j in range(size):
                rate[j] = slope[j] if significant else 0.0
    return straight
