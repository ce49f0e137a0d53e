"""Where the speed of a B-spline vanishes."""

from __future__ import annotations

import numpy as np

from pinposture.kernels.arclength import CLOSE, NEWTON, speed
from pinposture.kernels.arrays import Array1, Array2, Array3
from pinposture.kernels.compiled import compiled, subkernel

SAMPLES = 9  # places in a span where the speed is looked at
STILL = 1e-6  # of the largest speed in its span: a speed that vanishes


@subkernel
def half_square_slope(taylor: Array2, degree: int, x: float) -> tuple[float, float]:
    """First derivative by x of half the squared speed of an expanded velocity, and the second one."""
    value, slope = 0.0, 0.0
    for axis in range(3):
        v, dv, ddv = taylor[degree - 1, axis], 0.0, 0.0
        for p in range(degree - 2, -1, -1):
            ddv = ddv * x + 2.0 * dv
            dv = dv * x + v
            v = v * x + taylor[p, axis]
        value += v * dv
        slope += dv * dv + v * ddv
    return value, slope


@subkernel
def slowest(taylor: Array2, degree: int, low: float, high: float) -> float:
    """The x between two others where an expanded velocity is least, if its slope says so there; else NaN."""
    falls, rises = half_square_slope(taylor, degree, low)[0], half_square_slope(taylor, degree, high)[0]
    if not (falls < 0.0 and rises > 0.0):
        return np.nan
    x, width = 0.5 * (low + high), high - low
    for _ in range(NEWTON):
        value, slope = half_square_slope(taylor, degree, x)
        low, high = x if value <= 0.0 else low, x if value >= 0.0 else high
        trial = x - value / slope
        if not (slope > 0.0 and low <= trial <= high):
            trial = 0.5 * (low + high)
        step = abs(trial - x)
        x = trial
        if step <= CLOSE * width:
            break
    return x


@compiled
def find_standstill(taylors: Array3, breaks: Array1) -> float:
    """Find a parameter at which the curve stands still.

    Args:
        taylors: of `arclength.expand_spans`, (k, degree, 3).
        breaks: ends of the knot spans, increasing, (k + 1,).

    Returns:
        The parameter; NaN if it moves on everywhere.
    """
    spans, degree, last = len(taylors), taylors.shape[1], SAMPLES - 1
    v, fastest, overall = np.empty((spans, SAMPLES)), np.zeros(spans), 0.0
    for i in range(spans):
        for j in range(SAMPLES):
            v[i, j] = speed(taylors[i], degree, 2.0 * j / last - 1.0)
            fastest[i] = max(fastest[i], v[i, j])
        overall = max(overall, fastest[i])
    for i in range(spans):
        if fastest[i] <= 1e-9 * overall:
            return float(breaks[i])
    # The least speed lies beside a sample that is slower than its neighbours. Next to a cusp one is far
    # slower than the fastest; on a circle they are equal but for rounding, and not worth a search.
    for i in range(spans):
        for j in range(SAMPLES):
            before, after = max(j - 1, 0), min(j + 1, last)
            if v[i, j] <= min(v[i, before], v[i, after]) and v[i, j] < 0.9 * fastest[i]:
                x = slowest(taylors[i], degree, 2.0 * before / last - 1.0, 2.0 * after / last - 1.0)
                if speed(taylors[i], degree, x) <= STILL * fastest[i]:  # not so if NaN
                    return float(0.5 * ((1.0 - x) * breaks[i] + (1.0 + x) * breaks[i + 1]))
    for i in range(spans):
        if v[i, 0] <= STILL * fastest[i]:
            return float(breaks[i])
    for i in range(spans):
        if v[i, last] <= STILL * fastest[i]:
            return float(np.nextafter(breaks[i + 1], breaks[i]))
    return np.nan
