"""Manipulability spaces of modules: the directions in which a module moves its end well."""

from __future__ import annotations

import numpy as np

from pinposture.kernels.arrays import Array1, Array2, Array3, Ints1
from pinposture.kernels.compiled import compiled, subkernel

SWEEPS = 40
"""The most rounds of rotations; three vectors take about five."""

ANGLE = 1e-15
"""Cosine of the angle between two vectors at which they count as at right angles."""


@compiled
def module_spaces(
    b: Array2,
    ends: Ints1,
    points: Array2,
    plane: Array2,
    stations: Ints1,
    thresholds: Array1,
    directions: Array3,
    ranks: Ints1,
) -> float:
    """Left singular vectors, above a threshold, of the Jacobian of each section by its own joints alone.

    One-sided rotations (Jacobi, Hestenes) on the shorter side of the Jacobian: small singular values are as
    accurate as large ones, and two joints take a single rotation.

    Args:
        b: motion and turning of the first point that each joint carries, (n, 6), from `find_screws`.
        ends: number of joints that carry each point, (m,); increasing.
        points: the points, (m, 3).
        plane: directions in which the points can move, (2, 3), or (3, 3) for any.
        stations: the points at which the sections end, (p,); increasing.
        thresholds: what the singular values of each of them have to exceed, (p,).
        directions: filled with orthonormal directions, the singular vectors that are kept first, (p, 3, 3).
        ranks: filled with their number, (p,).

    Returns:
        The smallest ratio of a singular value that is kept to the largest of its section; 1 if none is kept.
    """
    widest, u = 0, 0
    for station in stations:
        widest, u = max(widest, ends[station] - u), ends[station]
    d, length = len(plane), max(widest, len(plane))
    vectors, turns, sigma = np.empty((3, length)), np.empty((3, 3)), np.empty(3)
    columns = np.empty((widest, 3))
    smallest, u, point = 1.0, 0, 0
    for k in range(len(stations)):
        end, count, rank, largest = points[stations[k]], 0, 0, 0.0
        while point <= stations[k]:
            r0, r1, r2 = end[0] - points[point, 0], end[1] - points[point, 1], end[2] - points[point, 2]
            while u < ends[point]:
                x = b[u, 0] + b[u, 4] * r2 - b[u, 5] * r1
                y = b[u, 1] + b[u, 5] * r0 - b[u, 3] * r2
                z = b[u, 2] + b[u, 3] * r1 - b[u, 4] * r0
                for i in range(d):
                    columns[count, i] = plane[i, 0] * x + plane[i, 1] * y + plane[i, 2] * z
                count += 1
                u += 1
            point += 1
        narrow = count < d
        size, length = (count, d) if narrow else (d, count)
        for i in range(size):
            for j in range(length):
                vectors[i, j] = columns[i, j] if narrow else columns[j, i]
        _orthogonalise(vectors, turns, size, length)
        for i in range(size):
            sigma[i] = np.sqrt(_product(vectors, i, i, length))
            largest = max(largest, sigma[i])
        for _ in range(size):
            i = int(np.argmax(sigma[:size]))
            if not sigma[i] > thresholds[k]:
                break
            smallest = min(smallest, sigma[i] / largest)
            for j in range(3):
                directions[k, rank, j] = 0.0
                for a in range(d):
                    share = vectors[i, a] / sigma[i] if narrow else turns[i, a]
                    directions[k, rank, j] += plane[a, j] * share
            sigma[i] = -1.0
            rank += 1
        ranks[k] = rank
        _complete(directions[k], rank)
    return smallest


@subkernel
def _product(vectors: Array2, i: int, j: int, length: int) -> float:
    total = 0.0
    for c in range(length):
        total += vectors[i, c] * vectors[j, c]
    return total


@subkernel
def _orthogonalise(vectors: Array2, turns: Array2, size: int, length: int) -> None:
    """Turn up to three vectors among themselves until they are at right angles; the turns are kept."""
    for i in range(size):
        for j in range(size):
            turns[i, j] = 1.0 if i == j else 0.0
    for _ in range(SWEEPS):
        turned = False
        for i in range(size - 1):
            for j in range(i + 1, size):
                ii, jj = _product(vectors, i, i, length), _product(vectors, j, j, length)
                ij = _product(vectors, i, j, length)
                if abs(ij) <= ANGLE * np.sqrt(ii * jj):
                    continue
                turned = True
                zeta = (jj - ii) / (2.0 * ij)
                t = 1.0 / (abs(zeta) + np.sqrt(1.0 + zeta * zeta))
                t = t if zeta > 0.0 else -t
                c = 1.0 / np.sqrt(1.0 + t * t)
                s = c * t
                for e in range(length):
                    one, other = vectors[i, e], vectors[j, e]
                    vectors[i, e], vectors[j, e] = c * one - s * other, s * one + c * other
                for e in range(size):
                    one, other = turns[i, e], turns[j, e]
                    turns[i, e], turns[j, e] = c * one - s * other, s * one + c * other
        if not turned:
            return


@subkernel
def _complete(directions: Array2, rank: int) -> None:
    """Straighten the first directions by what rounding left, and add others at right angles to them."""
    for i in range(3):
        e = directions[i]
        for attempt in range(1 if i < rank else 3):
            if i >= rank:
                e[0], e[1], e[2] = 0.0, 0.0, 0.0
                e[attempt] = 1.0
            for _ in range(2):
                for j in range(i):
                    o = directions[j]
                    share = e[0] * o[0] + e[1] * o[1] + e[2] * o[2]
                    e[0], e[1], e[2] = e[0] - share * o[0], e[1] - share * o[1], e[2] - share * o[2]
            norm = np.sqrt(e[0] * e[0] + e[1] * e[1] + e[2] * e[2])
            if norm > 0.5:
                e[0], e[1], e[2] = e[0] / norm, e[1] / norm, e[2] / norm
                break
