"""Posture control matrices as a chain has them: motions of points along directions, never written out.

A matrix asks of some points, the stations, how they move along some directions. How it multiplies a vector
is a pass along the chain: the state is the motion v of a point and the turning w of its body, and each joint
adds its screw. Between stations they are taken to the next point, v + w x r: velocities at a common origin
far away would cancel. What rows know of the joints before their section, those up to the station before,
depends on the coupling:

* FULL: everything. Rows are those of the position Jacobians.
* RELATIVE: the motion of the point relative to the station before.
* LOCAL: nothing.
"""

from __future__ import annotations

from pinposture.kernels.arrays import FULL, LOCAL, Array1, Array2, Rows, Screws
from pinposture.kernels.compiled import compiled


@compiled
def motions_along(
    screws: Screws,
    rows: Rows,
    x: Array1,
    values: Array2,
) -> None:
    """The matrix times a vector: how the joints move the stations along the directions.

    Args:
        screws: how joints move the points.
        rows: which motions the matrix consists of.
        x: motions of the joints, (n,).
        values: filled with one value for each direction that has a row, (p, 3).
    """
    b, ends, points = screws
    stations, ranks, directions, coupling = rows
    v0, v1, v2, w0, w1, w2 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    u, at = 0, 0
    for k in range(len(stations)):
        if coupling != FULL:
            v0, v1, v2 = 0.0, 0.0, 0.0
        if coupling == LOCAL:
            w0, w1, w2 = 0.0, 0.0, 0.0
        for point in range(stations[k - 1] + 1 if k else 0, stations[k] + 1):
            r0 = points[point, 0] - points[at, 0]
            r1 = points[point, 1] - points[at, 1]
            r2 = points[point, 2] - points[at, 2]
            v0, v1, v2 = v0 + w1 * r2 - w2 * r1, v1 + w2 * r0 - w0 * r2, v2 + w0 * r1 - w1 * r0
            at = point
            while u < ends[point]:
                xu = x[u]
                v0, v1, v2 = v0 + xu * b[u, 0], v1 + xu * b[u, 1], v2 + xu * b[u, 2]
                w0, w1, w2 = w0 + xu * b[u, 3], w1 + xu * b[u, 4], w2 + xu * b[u, 5]
                u += 1
        for j in range(ranks[k]):
            e = directions[k, j]
            values[k, j] = e[0] * v0 + e[1] * v1 + e[2] * v2


@compiled
def joints_along(
    screws: Screws,
    rows: Rows,
    values: Array2,
    x: Array1,
) -> None:
    """The transposed matrix times a vector: what forces along the directions do to the joints.

    Args:
        screws: how joints move the points.
        rows: which motions the matrix consists of.
        values: one value for each direction that has a row, (p, 3).
        x: filled with one value for each joint, (n,).
    """
    b, ends, points = screws
    stations, ranks, directions, coupling = rows
    f0, f1, f2, t0, t1, t2 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0  # force, and moment about the point
    at = stations[-1]
    for u in range(ends[at], len(x)):
        x[u] = 0.0
    for k in range(len(stations) - 1, -1, -1):
        first = stations[k - 1] + 1 if k else 0
        if coupling != FULL:
            f0, f1, f2 = 0.0, 0.0, 0.0
        if coupling == LOCAL:
            t0, t1, t2 = 0.0, 0.0, 0.0
        for j in range(ranks[k]):
            e, value = directions[k, j], values[k, j]
            f0, f1, f2 = f0 + value * e[0], f1 + value * e[1], f2 + value * e[2]
        for point in range(stations[k], first - 1, -1):
            for u in range(ends[point] - 1, (ends[point - 1] if point else 0) - 1, -1):
                x[u] = b[u, 0] * f0 + b[u, 1] * f1 + b[u, 2] * f2 + b[u, 3] * t0 + b[u, 4] * t1 + b[u, 5] * t2
            if point:
                r0 = points[point, 0] - points[point - 1, 0]
                r1 = points[point, 1] - points[point - 1, 1]
                r2 = points[point, 2] - points[point - 1, 2]
                t0, t1, t2 = t0 + r1 * f2 - r2 * f1, t1 + r2 * f0 - r0 * f2, t2 + r0 * f1 - r1 * f0
