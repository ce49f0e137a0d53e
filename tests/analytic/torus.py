"""Where a segment meets the surface that a RyRz module reaches, by scanning it finely and bisecting.

It is a torus about the y axis with radii l1 (major) and l2 (minor), in the frame of the module's base.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
GOLDEN = (np.sqrt(5.0) - 1.0) / 2.0


def implicit(p: ArrayLike, l1: float, l2: float) -> Array:
    """F of (6.13) put right, at points (..., 3): zero on the torus, negative within its tube."""
    p = np.asarray(p, dtype=float)
    square = np.sum(p * p, axis=-1)
    y = p[..., 1]
    return np.asarray((square - (l1**2 + l2**2)) ** 2 - 4 * l1**2 * (l2**2 - y**2))


def reachable(l1: float, l2: float, steps: int) -> Array:
    """Points that the module reaches, (steps^2, 3): all pairs from a grid of joint angles."""
    angles = np.linspace(-np.pi, np.pi, steps, endpoint=False)
    q0, q1 = (a.ravel() for a in np.meshgrid(angles, angles))
    r = l1 + l2 * np.cos(q1)
    return np.column_stack([r * np.cos(q0), l2 * np.sin(q1), -r * np.sin(q0)])


def intersections(
    a: ArrayLike, b: ArrayLike, l1: float, l2: float, samples: int = 4001, tolerance: float = 1e-13
) -> Array:
    """Every t in [0, 1] at which a + (b - a) t lies on the torus, ascending.

    A tangency counts once, when F there is within `tolerance` of zero relative to its largest terms; an end
    of the segment on the torus counts, too. Neighbouring roots are one if F half-way is zero by that measure.
    On the circles y = +-l2, where F can vanish to fourth order, the place is known to about 1e-3 only.
    """
    a = np.asarray(a, dtype=float)
    b = np.asarray(b, dtype=float)
    noise = tolerance * (max(a @ a, b @ b) + l1**2 + l2**2) ** 2

    def f(t: ArrayLike) -> Array:
        return implicit(a + np.multiply.outer(t, b - a), l1, l2)

    t = np.linspace(0.0, 1.0, samples)
    F = f(t)
    roots = [end for end, value in ((0.0, F[0]), (1.0, F[-1])) if abs(value) <= noise]
    inside = F < 0
    for i in np.flatnonzero(inside[1:] != inside[:-1]):
        roots.append(bisect(f, t[i], t[i + 1]))

    size = np.abs(F)
    dips = 1 + np.flatnonzero((size[1:-1] <= size[:-2]) & (size[1:-1] <= size[2:]))
    for i in dips:
        if inside[i - 1] == inside[i] == inside[i + 1]:
            near = golden_section(f, t[i - 1], t[i + 1], maximum=bool(inside[i]))
            if abs(f(near)) <= noise:
                roots.append(near)
            elif (f(near) < 0) != inside[i]:  # two roots between samples
                roots += [bisect(f, t[i - 1], near), bisect(f, near, t[i + 1])]

    distinct: list[float] = []
    for root in sorted(roots):
        if not distinct or abs(f((distinct[-1] + root) / 2)) > noise:
            distinct.append(float(root))
    return np.array(distinct)


def bisect(f: Callable[[float], Array], low: float, high: float) -> float:
    """Root of f between two places where its sign differs."""
    inside = f(low) < 0
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (middle, high) if (f(middle) < 0) == inside else (low, middle)
    return (low + high) / 2


def golden_section(f: Callable[[float], Array], low: float, high: float, maximum: bool) -> float:
    """Place of the minimum (or maximum) of f, which has one between low and high."""
    for _ in range(60):
        width = GOLDEN * (high - low)
        left = (f(high - width) < f(low + width)) != maximum
        low, high = (low, low + width) if left else (high - width, high)
    return (low + high) / 2
