"""A planar chain of revolute joints and the rank statements of Appendix A.

Joints 0..n-1 turn about z; link i, of length links[i], follows joint i. Control point k = 1..n is the end of
link k - 1, where joint k stands. The base is at the origin, and q = 0 is the straight arm along x.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


def span(u: int, v: int, q: ArrayLike, links: ArrayLike) -> Array:
    """The vector (C, S) from joint u to the end of link v, (2,), (A.2)."""
    heading = np.cumsum(q)[u : v + 1]
    lengths = np.asarray(links)[u : v + 1]
    return np.array([np.sum(lengths * np.cos(heading)), np.sum(lengths * np.sin(heading))])


def points(q: ArrayLike, links: ArrayLike) -> Array:
    """Positions of control points 1..n, (n, 2)."""
    return np.array([span(0, k - 1, q, links) for k in range(1, np.size(q) + 1)])


def jacobian(k: int, q: ArrayLike, links: ArrayLike) -> Array:
    """Jacobian of control point k, (2, n), zero from joint k on: column u is (-S, C) of the span from u."""
    J = np.zeros((2, np.size(q)))
    for u in range(k):
        C, S = span(u, k - 1, q, links)
        J[:, u] = -S, C
    return J


def stacked(ks: Sequence[int], q: ArrayLike, links: ArrayLike) -> Array:
    """Posture control matrix of the control points ks, (2 len(ks), n), (4.6)."""
    return np.vstack([jacobian(k, q, links) for k in ks])


def rank(matrix: Array, tolerance: float = 1e-9) -> int:
    """Number of singular values above `tolerance` times the largest."""
    sigma = np.linalg.svd(matrix, compute_uv=False)
    return int(np.sum(sigma > tolerance * sigma[0]))


def ratios(k: int, dof: int, q: ArrayLike, links: ArrayLike, tolerance: float = 1e-9) -> Array | None:
    """Ratios of (A.5) and (A.6) for the section of `dof` joints after control point k, or None if none exist.

    Joint by joint along the section but for the last one, the factor between the span from that joint and the
    last link: (alpha,) for 2 joints, (alpha, beta) for 3. They exist exactly when all those spans lie on the
    line of the last link, that is, when the section is singular.
    """
    end = k + dof - 1
    last = span(end, end, q, links)
    spans = [span(u, end, q, links) for u in range(k, end)]
    for C, S in spans:
        if abs(C * last[1] - S * last[0]) > tolerance * np.sum(links) * np.hypot(*last):
            return None
    return np.array([v @ last / (last @ last) for v in spans])


def section_is_singular(inner: ArrayLike, tolerance: float = 1e-9) -> bool:
    """Whether a section is singular, from its joints but for the first: all are 0 or +-pi (Tables A.1, A.2).

    A single joint (no inner ones) has one column for two directions, and so is always singular.
    """
    return bool(np.all(np.abs(np.sin(inner)) <= tolerance))
