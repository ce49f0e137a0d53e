"""Points and chords along a chain: how joints move them, how far they are off, how much they resist."""

from __future__ import annotations

import numpy as np

from pinposture.kernels.arrays import Array1, Array2, Flags1, Ints1, Springs
from pinposture.kernels.compiled import compiled


@compiled
def find_screws(
    which: Ints1,
    slides: Flags1,
    units: Array1,
    axes: Array2,
    origins: Array2,
    ends: Ints1,
    points: Array2,
    filled: Array2,
) -> None:
    """How each joint moves the first point that it carries, and turns it.

    Args:
        which: the joints, by their numbers along the chain, (n,); increasing.
        slides: True for a joint of the chain that slides; others turn.
        units: the motion of each joint that counts as one, (n,).
        axes: axes of the joints of the chain.
        origins: their origins.
        ends: how many of the joints carry each point, (m,); increasing.
        points: the points, (m, 3).
        filled: filled with motion and turning, (n, 6).
    """
    k = 0
    for i in range(len(which)):
        while k < len(ends) and ends[k] <= i:
            k += 1
        u, unit = which[i], units[i]
        a0, a1, a2 = unit * axes[u, 0], unit * axes[u, 1], unit * axes[u, 2]
        if slides[u]:
            filled[i, 0], filled[i, 1], filled[i, 2] = a0, a1, a2
            filled[i, 3], filled[i, 4], filled[i, 5] = 0.0, 0.0, 0.0
        else:
            at = k if k < len(ends) else len(ends) - 1
            x = points[at, 0] - origins[u, 0]
            y = points[at, 1] - origins[u, 1]
            z = points[at, 2] - origins[u, 2]
            filled[i, 0] = a1 * z - a2 * y
            filled[i, 1] = a2 * x - a0 * z
            filled[i, 2] = a0 * y - a1 * x
            filled[i, 3], filled[i, 4], filled[i, 5] = a0, a1, a2


@compiled
def move_points(b: Array2, ends: Ints1, points: Array2, x: Array1, filled: Array2) -> None:
    """How motions x of the joints move the points: fills v, (m, 3)."""
    v0, v1, v2, w0, w1, w2 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(len(ends)):
        if k:
            r0 = points[k, 0] - points[k - 1, 0]
            r1 = points[k, 1] - points[k - 1, 1]
            r2 = points[k, 2] - points[k - 1, 2]
            v0, v1, v2 = v0 + w1 * r2 - w2 * r1, v1 + w2 * r0 - w0 * r2, v2 + w0 * r1 - w1 * r0
        for u in range(ends[k - 1] if k else 0, ends[k]):
            v0, v1, v2 = v0 + b[u, 0] * x[u], v1 + b[u, 1] * x[u], v2 + b[u, 2] * x[u]
            w0, w1, w2 = w0 + b[u, 3] * x[u], w1 + b[u, 4] * x[u], w2 + b[u, 5] * x[u]
        filled[k, 0], filled[k, 1], filled[k, 2] = v0, v1, v2


@compiled
def measure_misses(
    points: Array2, targets: Array2, weights: Array1, chords: Array1, normal: Array1, errors: Array2
) -> float:
    """Errors of points, and the weighted sum of their squares and of those of their chords.

    Args:
        points: the points, (m, 3).
        targets: where they should be, (m, 3).
        weights: W, (m,).
        chords: C, (m,).
        normal: a direction in which nothing can move and errors do not count, (3,); zero if there is none.
        errors: filled with e, (m, 3).
    """
    total = 0.0
    for k in range(len(points)):
        across = 0.0
        for j in range(3):
            errors[k, j] = targets[k, j] - points[k, j]
            across += errors[k, j] * normal[j]
        for j in range(3):
            errors[k, j] -= across * normal[j]
            before = errors[k - 1, j] if k else 0.0
            total += weights[k] * errors[k, j] ** 2 + chords[k] * (errors[k, j] - before) ** 2
    return total


@compiled
def stiffness(springs: Springs) -> float:
    """Mean over the joints of what one unit of their motion, alone, adds to the sum by points and chords."""
    b, ends, points, weights, chords = springs
    m = len(ends)
    total, whole = 0.0, 0.0
    first_moment, second, of_chords = np.zeros(3), np.zeros((3, 3)), np.zeros((3, 3))
    r = np.zeros(3)
    for k in range(m - 1, -1, -1):
        whole += weights[k]
        for u in range(ends[k - 1] if k else 0, ends[k]):
            v, a = b[u, :3], b[u, 3:]
            squared = v[0] ** 2 + v[1] ** 2 + v[2] ** 2
            total += (whole + chords[k]) * squared
            total += 2.0 * (
                v[0] * (a[1] * first_moment[2] - a[2] * first_moment[1])
                + v[1] * (a[2] * first_moment[0] - a[0] * first_moment[2])
                + v[2] * (a[0] * first_moment[1] - a[1] * first_moment[0])
            )
            for i in range(3):
                for j in range(3):
                    total += a[i] * (second[i, j] + of_chords[i, j]) * a[j]
        if k:  # moments about the point before
            inner, along = 0.0, 0.0
            for i in range(3):
                r[i] = points[k, i] - points[k - 1, i]
                inner += r[i] * r[i]
                along += r[i] * first_moment[i]
            for i in range(3):
                for j in range(3):
                    outer = r[i] * r[j]
                    own = inner if i == j else 0.0
                    mixed = 2.0 * along if i == j else 0.0
                    mixed -= r[i] * first_moment[j] + first_moment[i] * r[j]
                    second[i, j] += mixed + whole * (own - outer)
                    of_chords[i, j] += chords[k] * (own - outer)
            for i in range(3):
                first_moment[i] += whole * r[i]
    return total / max(len(b), 1)
