"""Forward kinematics and Jacobians of a serial chain, and products with posture control matrices."""

from __future__ import annotations

import numpy as np

from pinposture.kernels.arrays import (
    COUPLING,
    JOINT,
    ArmArrays,
    Array1,
    Array2,
    Array3,
    Ints1,
    Joints,
    Nine,
    Rows,
    Screws,
    Three,
)
from pinposture.kernels.compiled import compiled, inlined, subkernel

Frame = tuple[float, float, float, float, float, float, float, float, float, float, float, float]
"""A frame: its rotation row by row, and its origin."""

BASE: Frame = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)
"""The frame of the base."""


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


@inlined
def load_frame(turn: Array2, place: Array1) -> Frame:
    """Return a frame, turn (3, 3) and place (3,), row by row and then its origin."""
    r00 = turn[0, 0]
    r01 = turn[0, 1]
    r02 = turn[0, 2]
    r10 = turn[1, 0]
    r11 = turn[1, 1]
    r12 = turn[1, 2]
    r20 = turn[2, 0]
    r21 = turn[2, 1]
    r22 = turn[2, 2]
    return r00, r01, r02, r10, r11, r12, r20, r21, r22, place[0], place[1], place[2]


@inlined
def store_frame(frame: Frame, turn: Array2, place: Array1) -> None:
    """Fill turn (3, 3) and place (3,) with a frame."""
    turn[0, 0], turn[0, 1], turn[0, 2], turn[1, 0], turn[1, 1], turn[1, 2] = frame[:6]
    turn[2, 0], turn[2, 1], turn[2, 2], place[0], place[1], place[2] = frame[6:]


@inlined
def carried(frame: Frame, x: float, y: float, z: float) -> Three:
    """Return the position of a point of a frame."""
    return (
        frame[9] + frame[0] * x + frame[1] * y + frame[2] * z,
        frame[10] + frame[3] * x + frame[4] * y + frame[5] * z,
        frame[11] + frame[6] * x + frame[7] * y + frame[8] * z,
    )


@inlined
def carried_on(joints: Joints, u: int, cosine: float, sine: float, frame: Frame) -> tuple[Frame, Three]:
    """Return the frame and the axis of a joint that turns or slides, from the frame that carries it.

    Args:
        joints: the joints.
        u: the joint.
        cosine: of its position; of one that slides, its position.
        sine: of its position.
        frame: the frame that carries it.
    """
    r00, r01, r02, r10, r11, r12, r20, r21, r22, _, _, _ = frame
    px, py, pz = carried(frame, joints.offsets[u, 0], joints.offsets[u, 1], joints.offsets[u, 2])
    x = joints.axes[u, 0]
    y = joints.axes[u, 1]
    z = joints.axes[u, 2]
    ax = r00 * x + r01 * y + r02 * z
    ay = r10 * x + r11 * y + r12 * z
    az = r20 * x + r21 * y + r22 * z
    if joints.kinds[u] == JOINT.prismatic:
        px = px + cosine * ax
        py = py + cosine * ay
        pz = pz + cosine * az
    else:
        turn = rotation_about(x, y, z, cosine, sine)
        r00, r01, r02 = turn_row(r00, r01, r02, turn)
        r10, r11, r12 = turn_row(r10, r11, r12, turn)
        r20, r21, r22 = turn_row(r20, r21, r22, turn)
    return (r00, r01, r02, r10, r11, r12, r20, r21, r22, px, py, pz), (ax, ay, az)


@inlined
def find_sines(joints: Joints, first: int, stop: int, positions: Array1, axes: Array2) -> None:
    """Store in axes, (k, 3), the cosines and sines of joints first to stop - 1; of slides the positions.

    Before `place_chain` and for all joints at once, because its loop would wait for each.
    """
    for u in range(first, stop):
        q = joints.ratios[u] * positions[joints.columns[u]]
        if joints.kinds[u] == JOINT.prismatic:
            axes[u, 0] = q
        else:
            axes[u, 0] = np.cos(q)
            axes[u, 1] = np.sin(q)


@inlined
def place_chain(joints: Joints, first: int, stop: int, frame: Frame, axes: Array2, origins: Array2) -> Frame:
    """Compute the forward kinematics of joints first to stop - 1 of a chain.

    Args:
        joints: the joints of the chain.
        first: the first of them to place.
        stop: the one after the last.
        frame: the frame that carries the first.
        axes: what `find_sines` has stored; filled with their axes, (k, 3).
        origins: filled with their origins, (k, 3).

    Returns:
        The frame that the last one carries.
    """
    for u in range(first, stop):
        frame, axis = carried_on(joints, u, axes[u, 0], axes[u, 1], frame)
        axes[u, 0] = axis[0]
        axes[u, 1] = axis[1]
        axes[u, 2] = axis[2]
        origins[u, 0] = frame[9]
        origins[u, 1] = frame[10]
        origins[u, 2] = frame[11]
    return frame


@inlined
def point_velocity(
    joints: Joints, u: int, axes: Array2, origins: Array2, x: float, y: float, z: float
) -> Three:
    """Return the velocity of a point per motion of the degree of freedom of a joint that carries it.

    It is a x (p - o), or a for a prismatic joint, times its ratio.
    """
    ratio = joints.ratios[u]
    a0 = ratio * axes[u, 0]
    a1 = ratio * axes[u, 1]
    a2 = ratio * axes[u, 2]
    if joints.kinds[u] == JOINT.prismatic:
        return a0, a1, a2
    x = x - origins[u, 0]
    y = y - origins[u, 1]
    z = z - origins[u, 2]
    return a1 * z - a2 * y, a2 * x - a0 * z, a0 * y - a1 * x


@compiled
def placements(
    chain: ArmArrays,
    positions: Array1,
    joint_axes: Array2,
    joint_origins: Array2,
    points: Array2,
    rotations: Array3,
) -> None:
    """Compute the forward kinematics of an arm.

    Args:
        chain: the chain.
        positions: joint positions, (nv,).
        joint_axes: filled with the joint axes, world frame, (k, 3).
        joint_origins: filled with the origins of the joints, (k, 3).
        points: filled with the control points, (m, 3).
        rotations: filled with their orientations, (m, 3, 3).
    """
    joints = chain.joints
    ends = chain.ends
    levers = chain.levers
    turns = chain.turns
    n = len(joints.kinds)
    m = len(ends)
    find_sines(joints, 0, n, positions, joint_axes)
    frame = BASE
    first = 0
    for k in range(m + 1):
        stop = ends[k] if k < m else n
        frame = place_chain(joints, first, stop, frame, joint_axes, joint_origins)
        first = stop
        if k == m:
            break
        points[k, 0], points[k, 1], points[k, 2] = carried(frame, levers[k, 0], levers[k, 1], levers[k, 2])
        t = turns[k]
        turned = rotations[k]
        turn = (t[0, 0], t[0, 1], t[0, 2], t[1, 0], t[1, 1], t[1, 2], t[2, 0], t[2, 1], t[2, 2])
        turned[0, 0], turned[0, 1], turned[0, 2] = turn_row(frame[0], frame[1], frame[2], turn)
        turned[1, 0], turned[1, 1], turned[1, 2] = turn_row(frame[3], frame[4], frame[5], turn)
        turned[2, 0], turned[2, 1], turned[2, 2] = turn_row(frame[6], frame[7], frame[8], turn)


@compiled
def trace_points(chain: ArmArrays, positions: Array2, points: Array3) -> None:
    """Compute the control points at several configurations.

    Args:
        chain: the chain.
        positions: joint positions, (s, nv).
        points: filled with the control points, (s, m, 3).
    """
    n = len(chain.joints.kinds)
    m = len(chain.ends)
    axes = np.empty((n, 3))
    origins = np.empty((n, 3))
    rotations = np.empty((m, 3, 3))
    for i in range(len(positions)):
        placements(chain, positions[i], axes, origins, points[i], rotations)


@compiled
def move_frame(joints: Joints, first: int, stop: int, positions: Array1, turn: Array2, place: Array1) -> None:
    """Move a frame, turn (3, 3) and place (3,), from before joint `first` of a chain to after `stop - 1`.

    Args:
        joints: the joints of the chain.
        first: the first joint.
        stop: the one after the last.
        positions: joint positions, (nv,).
        turn: axes of the frame that carries the first; filled with those of the frame that the last carries.
        place: its origin; filled in the same way.
    """
    axes = np.empty((len(joints.kinds), 3))
    origins = np.empty((len(joints.kinds), 3))
    find_sines(joints, first, stop, positions, axes)
    frame = place_chain(joints, first, stop, load_frame(turn, place), axes, origins)
    store_frame(frame, turn, place)


@compiled
def jacobians(
    joints: Joints, ends: Ints1, joint_axes: Array2, joint_origins: Array2, points: Array2, filled: Array3
) -> None:
    """Compute the position Jacobians of all control points.

    Args:
        joints: the joints of the chain.
        ends: number of joints that carry each control point, (m,); increasing.
        joint_axes: joint axes, world frame, (k, 3).
        joint_origins: origins of the joints, (k, 3).
        points: control points, (m, 3).
        filled: zeros, filled with the Jacobians, (m, 3, nv).
    """
    for k in range(len(ends)):
        x = points[k, 0]
        y = points[k, 1]
        z = points[k, 2]
        for u in range(ends[k]):
            vx, vy, vz = point_velocity(joints, u, joint_axes, joint_origins, x, y, z)
            j = joints.columns[u]
            filled[k, 0, j] += vx
            filled[k, 1, j] += vy
            filled[k, 2, j] += vz


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
# * full: completely. Rows are those of the position Jacobians.
# * relative: by the motion of the point relative to the previous station.
# * local: not at all.


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
        if coupling != COUPLING.full:
            v0 = 0.0
            v1 = 0.0
            v2 = 0.0
        if coupling == COUPLING.local:
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
        if coupling != COUPLING.full:
            f0 = 0.0
            f1 = 0.0
            f2 = 0.0
        if coupling == COUPLING.local:
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
