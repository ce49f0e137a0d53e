"""Forward kinematics and Jacobians of a serial chain, and products with posture control matrices."""

from __future__ import annotations

import numpy as np

from pinposture.kernels.arrays import (
    FULL,
    LOCAL,
    Array1,
    Array2,
    Array3,
    ChainArrays,
    Ints1,
    Nine,
    Rows,
    Screws,
    Three,
)
from pinposture.kernels.compiled import compiled, inlined, subkernel


@subkernel
def difference(points: Array2, i: int, j: int) -> Three:
    """Return the vector to point i from point j."""
    return points[i, 0] - points[j, 0], points[i, 1] - points[j, 1], points[i, 2] - points[j, 2]


@inlined
def rotation_about(x: float, y: float, z: float, c: float, s: float) -> Nine:
    """Return the rotation about a unit axis by an angle of cosine c and sine s, row by row (Rodrigues)."""
    v = 1.0 - c
    e00 = c + v * x * x
    e01 = v * x * y - s * z
    e02 = v * x * z + s * y
    e10 = v * x * y + s * z
    e11 = c + v * y * y
    e12 = v * y * z - s * x
    e20 = v * x * z - s * y
    e21 = v * y * z + s * x
    e22 = c + v * z * z
    return e00, e01, e02, e10, e11, e12, e20, e21, e22


@inlined
def turn_row(a: float, b: float, c: float, turn: Nine) -> Three:
    """Return a row (3,) times a matrix that is given row by row."""
    return (
        a * turn[0] + b * turn[3] + c * turn[6],
        a * turn[1] + b * turn[4] + c * turn[7],
        a * turn[2] + b * turn[5] + c * turn[8],
    )


@compiled
def placements(
    chain: ChainArrays,
    positions: Array1,
    joint_axes: Array2,
    joint_origins: Array2,
    points: Array2,
    rotations: Array3,
) -> None:
    """Compute the forward kinematics.

    Args:
        chain: the chain.
        positions: joint positions, (nv,).
        joint_axes: filled with the joint axes, world frame, (k, 3).
        joint_origins: filled with the origins of the joints, (k, 3).
        points: filled with the control points, (m, 3).
        rotations: filled with their orientations, (m, 3, 3).
    """
    slides, columns, ratios, fixed, axes, ends, offsets, turns, _, _, _ = chain
    r00 = 1.0
    r01 = 0.0
    r02 = 0.0
    r10 = 0.0
    r11 = 1.0
    r12 = 0.0
    r20 = 0.0
    r21 = 0.0
    r22 = 1.0
    px = 0.0
    py = 0.0
    pz = 0.0
    # Sines and cosines first, because the loop below would wait for each; they are stored in `joint_axes`.
    for u in range(len(slides)):
        q = ratios[u] * positions[columns[u]]
        if slides[u]:
            joint_axes[u, 0] = q
        else:
            joint_axes[u, 0] = np.cos(q)
            joint_axes[u, 1] = np.sin(q)
    k = 0
    for u in range(len(slides)):
        f = fixed[u]
        c = joint_axes[u, 0]
        s = joint_axes[u, 1]
        px = px + r00 * f[9] + r01 * f[10] + r02 * f[11]
        py = py + r10 * f[9] + r11 * f[10] + r12 * f[11]
        pz = pz + r20 * f[9] + r21 * f[10] + r22 * f[11]
        turn = (f[0], f[1], f[2], f[3], f[4], f[5], f[6], f[7], f[8])
        r00, r01, r02 = turn_row(r00, r01, r02, turn)
        r10, r11, r12 = turn_row(r10, r11, r12, turn)
        r20, r21, r22 = turn_row(r20, r21, r22, turn)
        x = axes[u, 0]
        y = axes[u, 1]
        z = axes[u, 2]
        ax = r00 * x + r01 * y + r02 * z
        ay = r10 * x + r11 * y + r12 * z
        az = r20 * x + r21 * y + r22 * z
        joint_axes[u, 0] = ax
        joint_axes[u, 1] = ay
        joint_axes[u, 2] = az
        if slides[u]:
            px = px + c * ax
            py = py + c * ay
            pz = pz + c * az
        else:
            turn = rotation_about(x, y, z, c, s)
            r00, r01, r02 = turn_row(r00, r01, r02, turn)
            r10, r11, r12 = turn_row(r10, r11, r12, turn)
            r20, r21, r22 = turn_row(r20, r21, r22, turn)
        joint_origins[u, 0] = px
        joint_origins[u, 1] = py
        joint_origins[u, 2] = pz
        while k < len(ends) and ends[k] == u + 1:
            o = offsets[k]
            t = turns[k]
            points[k, 0] = px + r00 * o[0] + r01 * o[1] + r02 * o[2]
            points[k, 1] = py + r10 * o[0] + r11 * o[1] + r12 * o[2]
            points[k, 2] = pz + r20 * o[0] + r21 * o[1] + r22 * o[2]
            for j in range(3):
                rotations[k, 0, j] = r00 * t[0, j] + r01 * t[1, j] + r02 * t[2, j]
                rotations[k, 1, j] = r10 * t[0, j] + r11 * t[1, j] + r12 * t[2, j]
                rotations[k, 2, j] = r20 * t[0, j] + r21 * t[1, j] + r22 * t[2, j]
            k += 1


@compiled
def gravity_torques(
    chain: ChainArrays,
    joint_axes: Array2,
    joint_origins: Array2,
    centers: Array2,
    masses: Array1,
    gravity: Array1,
    filled: Array1,
) -> None:
    """Compute the torques and forces of the degrees of freedom that balance gravity.

    Args:
        chain: the chain.
        joint_axes: joint axes, world frame, (k, 3).
        joint_origins: origins of the joints, (k, 3).
        centers: centre of mass of the body after each joint, (k, 3).
        masses: mass of each body, (k,).
        gravity: gravitational acceleration, (3,).
        filled: zeros, filled with the torques, (nv,).
    """
    mass = 0.0
    x = 0.0  # sum of mass times vector from the joint, exact far from the origin too
    y = 0.0
    z = 0.0
    last = len(masses) - 1
    for u in range(last, -1, -1):
        o = joint_origins[u]
        if u < last:
            x += mass * (joint_origins[u + 1, 0] - o[0])
            y += mass * (joint_origins[u + 1, 1] - o[1])
            z += mass * (joint_origins[u + 1, 2] - o[2])
        mass += masses[u]
        x += masses[u] * (centers[u, 0] - o[0])
        y += masses[u] * (centers[u, 1] - o[1])
        z += masses[u] * (centers[u, 2] - o[2])
        a = joint_axes[u]
        if chain.slides[u]:
            along = mass * (a[0] * gravity[0] + a[1] * gravity[1] + a[2] * gravity[2])
        else:
            along = (
                a[0] * (y * gravity[2] - z * gravity[1])
                + a[1] * (z * gravity[0] - x * gravity[2])
                + a[2] * (x * gravity[1] - y * gravity[0])
            )
        filled[chain.columns[u]] -= chain.ratios[u] * along


@compiled
def trace_points(chain: ChainArrays, positions: Array2, points: Array3) -> None:
    """Compute the control points at several configurations.

    Args:
        chain: the chain.
        positions: joint positions, (s, nv).
        points: filled with the control points, (s, m, 3).
    """
    n = len(chain.slides)
    m = len(chain.ends)
    axes = np.empty((n, 3))
    origins = np.empty((n, 3))
    rotations = np.empty((m, 3, 3))
    for i in range(len(positions)):
        placements(chain, positions[i], axes, origins, points[i], rotations)


@compiled
def jacobians(
    chain: ChainArrays, joint_axes: Array2, joint_origins: Array2, points: Array2, filled: Array3
) -> None:
    """Compute the position Jacobians of all control points: a_u x (p_k - o_u), or a_u for a prismatic joint.

    Args:
        chain: the chain.
        joint_axes: joint axes, world frame, (k, 3).
        joint_origins: origins of the joints, (k, 3).
        points: control points, (m, 3).
        filled: zeros, filled with the Jacobians, (m, 3, nv).
    """
    slides = chain.slides
    columns = chain.columns
    ends = chain.ends
    ratios = chain.ratios
    for k in range(len(ends)):
        for u in range(ends[k]):
            a = joint_axes[u]
            j = columns[u]
            ratio = ratios[u]
            if slides[u]:
                for i in range(3):
                    filled[k, i, j] += ratio * a[i]
            else:
                x = points[k, 0] - joint_origins[u, 0]
                y = points[k, 1] - joint_origins[u, 1]
                z = points[k, 2] - joint_origins[u, 2]
                filled[k, 0, j] += ratio * (a[1] * z - a[2] * y)
                filled[k, 1, j] += ratio * (a[2] * x - a[0] * z)
                filled[k, 2, j] += ratio * (a[0] * y - a[1] * x)


@compiled
def carry_screws(
    motions: Array2, columns: Ints1, units: Array1, ends: Ints1, points: Array2, filled: Array2
) -> None:
    """Compute the linear and angular velocity of the first point that each joint carries, v + w x p and w.

    Args:
        motions: velocity v at the world origin and angular velocity w of each degree of freedom, (nv, 6).
        columns: the degree of freedom of each joint of the chain, (n,).
        units: unit of motion of each joint, (n,).
        ends: number of the joints that carry each point, (m,); increasing.
        points: the points, (m, 3).
        filled: filled with v + w x p and w, (n, 6).
    """
    k = 0
    for i in range(len(columns)):
        while k < len(ends) - 1 and ends[k] <= i:
            k += 1
        x = points[k, 0]
        y = points[k, 1]
        z = points[k, 2]
        j = columns[i]
        v0 = motions[j, 0]
        v1 = motions[j, 1]
        v2 = motions[j, 2]
        w0 = motions[j, 3]
        w1 = motions[j, 4]
        w2 = motions[j, 5]
        filled[i, 0] = units[i] * (v0 + w1 * z - w2 * y)
        filled[i, 1] = units[i] * (v1 + w2 * x - w0 * z)
        filled[i, 2] = units[i] * (v2 + w0 * y - w1 * x)
        filled[i, 3] = units[i] * w0
        filled[i, 4] = units[i] * w1
        filled[i, 5] = units[i] * w2


# The rows of a posture control matrix are motions of some points, the stations, along some directions. The
# matrix is never formed: its product with a vector is a pass along the chain, whose state is the velocity v
# of a point and the angular velocity w of its body, to which each joint adds its screw. From point to point v
# becomes v + w x r: velocities at a distant common origin would suffer cancellation. The coupling defines how
# rows depend on the joints before their section, those up to the previous station:
#
# * FULL: completely. Rows are those of the position Jacobians.
# * RELATIVE: by the motion of the point relative to the previous station.
# * LOCAL: not at all.


@compiled
def motions_along(screws: Screws, rows: Rows, x: Array1, values: Array2) -> None:
    """Multiply a posture control matrix by a vector.

    Args:
        screws: the screws of the joints.
        rows: the rows of the matrix.
        x: motions of the joints, (n,).
        values: filled with one value per row, (p, 3).
    """
    b, ends, points = screws
    stations, ranks, directions, coupling = rows
    v0 = 0.0
    v1 = 0.0
    v2 = 0.0
    w0 = 0.0
    w1 = 0.0
    w2 = 0.0
    u = 0
    at = 0
    for k in range(len(stations)):
        if coupling != FULL:
            v0 = 0.0
            v1 = 0.0
            v2 = 0.0
        if coupling == LOCAL:
            w0 = 0.0
            w1 = 0.0
            w2 = 0.0
        for point in range(stations[k - 1] + 1 if k else 0, stations[k] + 1):
            r0, r1, r2 = difference(points, point, at)
            v0 = v0 + w1 * r2 - w2 * r1
            v1 = v1 + w2 * r0 - w0 * r2
            v2 = v2 + w0 * r1 - w1 * r0
            at = point
            while u < ends[point]:
                xu = x[u]
                v0 = v0 + xu * b[u, 0]
                v1 = v1 + xu * b[u, 1]
                v2 = v2 + xu * b[u, 2]
                w0 = w0 + xu * b[u, 3]
                w1 = w1 + xu * b[u, 4]
                w2 = w2 + xu * b[u, 5]
                u += 1
        for j in range(ranks[k]):
            e = directions[k, j]
            values[k, j] = e[0] * v0 + e[1] * v1 + e[2] * v2


@compiled
def joints_along(screws: Screws, rows: Rows, values: Array2, x: Array1) -> None:
    """Multiply a transposed posture control matrix by a vector.

    Args:
        screws: the screws of the joints.
        rows: the rows of the matrix.
        values: one value per row, (p, 3).
        x: filled with one value for each joint, (n,).
    """
    b, ends, points = screws
    stations, ranks, directions, coupling = rows
    # force, and moment about the point
    f0 = 0.0
    f1 = 0.0
    f2 = 0.0
    t0 = 0.0
    t1 = 0.0
    t2 = 0.0
    at = stations[-1]
    for u in range(ends[at], len(x)):
        x[u] = 0.0
    for k in range(len(stations) - 1, -1, -1):
        first = stations[k - 1] + 1 if k else 0
        if coupling != FULL:
            f0 = 0.0
            f1 = 0.0
            f2 = 0.0
        if coupling == LOCAL:
            t0 = 0.0
            t1 = 0.0
            t2 = 0.0
        for j in range(ranks[k]):
            e = directions[k, j]
            value = values[k, j]
            f0 = f0 + value * e[0]
            f1 = f1 + value * e[1]
            f2 = f2 + value * e[2]
        for point in range(stations[k], first - 1, -1):
            for u in range(ends[point] - 1, (ends[point - 1] if point else 0) - 1, -1):
                x[u] = b[u, 0] * f0 + b[u, 1] * f1 + b[u, 2] * f2 + b[u, 3] * t0 + b[u, 4] * t1 + b[u, 5] * t2
            if point:
                r0, r1, r2 = difference(points, point, point - 1)
                t0 = t0 + r1 * f2 - r2 * f1
                t1 = t1 + r2 * f0 - r0 * f2
                t2 = t2 + r0 * f1 - r1 * f0
