"""Inverse dynamics of trees of joints: the torques of motions, of gravity, and along a path.

Vectors of a body are in world axes and refer to the origin of its frame, so that a base far from the origin
of the world costs no digits.
"""

from __future__ import annotations

import numpy as np

from pinposture.kernels.arrays import SLIDES, Array1, Array2, Bodies, Joints, Nine, Three, TorqueSamples
from pinposture.kernels.compiled import compiled, inlined, subkernel
from pinposture.kernels.kinematics import rotation_about, turn_row

AXIS = 9
LEVER = 12
CENTER = 15
INERTIA = 18
PLACED_SIZE = 24
"""Where a row of placed bodies has, after the orientation, the axis of the joint, the way to its origin from
that of the frame that carries it, the centre of mass and the moments of inertia; and its length."""

ACCELERATION = 6
FORCE = 9
MOMENT = 12
MOVED_SIZE = 15
"""Where a row of moved bodies has, after angular velocity and acceleration, the acceleration of the origin,
and the force and the moment that it takes; and its length."""


@inlined
def cross(a: Three, b: Three) -> Three:
    """Return the cross product."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@inlined
def dot(a: Three, b: Three) -> float:
    """Return the scalar product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@inlined
def add(a: Three, b: Three) -> Three:
    """Return the sum."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@inlined
def scale(a: Three, factor: float) -> Three:
    """Return a multiple."""
    return factor * a[0], factor * a[1], factor * a[2]


@inlined
def get(row: Array1, at: int) -> Three:
    """Return three numbers of a row."""
    return row[at], row[at + 1], row[at + 2]


@inlined
def put(row: Array1, at: int, a: Three) -> None:
    """Store three numbers in a row."""
    row[at] = a[0]
    row[at + 1] = a[1]
    row[at + 2] = a[2]


@inlined
def turned(row: Array1, x: float, y: float, z: float) -> Three:
    """Return a vector of a frame in world axes; its orientation begins a row."""
    return (
        row[0] * x + row[1] * y + row[2] * z,
        row[3] * x + row[4] * y + row[5] * z,
        row[6] * x + row[7] * y + row[8] * z,
    )


@subkernel
def place_bodies(joints: Joints, bodies: Bodies, positions: Array1, placed: Array2) -> None:
    """Fill in orientations, axes, levers and centres of bodies, (k + 1, PLACED_SIZE), at joint positions."""
    placed[0, :9] = 0.0
    placed[0, 0] = 1.0
    placed[0, 4] = 1.0
    placed[0, 8] = 1.0
    for u in range(len(joints.kinds)):  # for all at once, because the next loop would wait for each
        q = joints.ratios[u] * positions[joints.columns[u]]
        placed[u + 1, AXIS] = q if joints.kinds[u] == SLIDES else np.cos(q)
        placed[u + 1, AXIS + 1] = np.sin(q)
    for u in range(len(joints.kinds)):
        before = placed[joints.parents[u]]
        row = placed[u + 1]
        x = joints.axes[u, 0]
        y = joints.axes[u, 1]
        z = joints.axes[u, 2]
        axis = turned(before, x, y, z)
        lever = turned(before, joints.offsets[u, 0], joints.offsets[u, 1], joints.offsets[u, 2])
        if joints.kinds[u] == SLIDES:
            lever = add(lever, scale(axis, row[AXIS]))
            row[:9] = before[:9]
        else:
            turn = rotation_about(x, y, z, row[AXIS], row[AXIS + 1])
            put(row, 0, turn_row(before[0], before[1], before[2], turn))
            put(row, 3, turn_row(before[3], before[4], before[5], turn))
            put(row, 6, turn_row(before[6], before[7], before[8], turn))
        put(row, AXIS, axis)
        put(row, LEVER, lever)
        put(row, CENTER, turned(row, bodies.centers[u, 0], bodies.centers[u, 1], bodies.centers[u, 2]))


@subkernel
def turn_inertias(bodies: Bodies, placed: Array2) -> None:
    """Fill in the moments of inertia of placed bodies, xx, yy, zz, xy, xz, yz, world axes."""
    for u in range(len(bodies.masses)):
        row = placed[u + 1]
        i = bodies.inertias[u]
        inertia: Nine = (i[0], i[3], i[4], i[3], i[1], i[5], i[4], i[5], i[2])
        first = turn_row(row[0], row[1], row[2], inertia)
        second = turn_row(row[3], row[4], row[5], inertia)
        third = turn_row(row[6], row[7], row[8], inertia)
        row[INERTIA] = dot(first, (row[0], row[1], row[2]))
        row[INERTIA + 1] = dot(second, (row[3], row[4], row[5]))
        row[INERTIA + 2] = dot(third, (row[6], row[7], row[8]))
        row[INERTIA + 3] = dot(first, (row[3], row[4], row[5]))
        row[INERTIA + 4] = dot(first, (row[6], row[7], row[8]))
        row[INERTIA + 5] = dot(second, (row[6], row[7], row[8]))


@inlined
def turned_by(row: Array1, a: Three) -> Three:
    """Return the angular momentum of a placed body that turns about its centre of mass."""
    xx = row[INERTIA]
    yy = row[INERTIA + 1]
    zz = row[INERTIA + 2]
    xy = row[INERTIA + 3]
    xz = row[INERTIA + 4]
    yz = row[INERTIA + 5]
    return (
        xx * a[0] + xy * a[1] + xz * a[2],
        xy * a[0] + yy * a[1] + yz * a[2],
        xz * a[0] + yz * a[1] + zz * a[2],
    )


@subkernel
def move_bodies_by(
    joints: Joints,
    bodies: Bodies,
    velocities: Array1,
    accelerations: Array1,
    upward: Three,
    placed: Array2,
    moved: Array2,
    filled: Array1,
) -> None:
    """Compute the torques of a motion of placed bodies.

    Args:
        joints: the joints.
        bodies: the bodies.
        velocities: joint velocities, (nv,).
        accelerations: joint accelerations, (nv,).
        upward: acceleration of the base; minus that of gravity.
        placed: the placed bodies, (k + 1, PLACED_SIZE).
        moved: a buffer, (k + 1, MOVED_SIZE).
        filled: filled with the torques, without armature, (nv,).
    """
    count = len(joints.kinds)
    moved[0] = 0.0
    put(moved[0], ACCELERATION, upward)
    for u in range(count):
        at = placed[u + 1]
        before = moved[joints.parents[u]]
        row = moved[u + 1]
        column = joints.columns[u]
        ratio = joints.ratios[u]
        axis = get(at, AXIS)
        lever = get(at, LEVER)
        rate = scale(axis, ratio * velocities[column])
        change = scale(axis, ratio * accelerations[column])
        spin = get(before, 0)
        spin_rate = get(before, 3)
        origin = add(get(before, ACCELERATION), cross(spin_rate, lever))
        origin = add(origin, cross(spin, cross(spin, lever)))
        across = cross(spin, rate)
        if joints.kinds[u] == SLIDES:
            origin = add(origin, add(change, scale(across, 2.0)))
        else:
            spin_rate = add(spin_rate, add(change, across))
            spin = add(spin, rate)
        put(row, 0, spin)
        put(row, 3, spin_rate)
        put(row, ACCELERATION, origin)
        center = get(at, CENTER)
        pull = add(origin, add(cross(spin_rate, center), cross(spin, cross(spin, center))))
        force = scale(pull, bodies.masses[u])
        turning = add(turned_by(at, spin_rate), cross(spin, turned_by(at, spin)))
        put(row, FORCE, force)
        put(row, MOMENT, add(cross(center, force), turning))
    _sum_forces(joints, placed, moved, filled)


@subkernel
def lift_bodies(
    joints: Joints, bodies: Bodies, upward: Three, placed: Array2, moved: Array2, filled: Array1
) -> None:
    """Compute the torques of placed bodies at rest; as `move_bodies_by` without motion."""
    moved[0] = 0.0
    for u in range(len(joints.kinds)):
        force = scale(upward, bodies.masses[u])
        put(moved[u + 1], FORCE, force)
        put(moved[u + 1], MOMENT, cross(get(placed[u + 1], CENTER), force))
    _sum_forces(joints, placed, moved, filled)


@subkernel
def _sum_forces(joints: Joints, placed: Array2, moved: Array2, filled: Array1) -> None:
    """Add up forces and moments from the tips to the base, and take their part along each joint."""
    filled[:] = 0.0
    for u in range(len(joints.kinds) - 1, -1, -1):
        row = moved[u + 1]
        at = placed[u + 1]
        parent = moved[joints.parents[u]]
        force = get(row, FORCE)
        moment = get(row, MOMENT)
        along = dot(get(at, AXIS), force if joints.kinds[u] == SLIDES else moment)
        filled[joints.columns[u]] += joints.ratios[u] * along
        put(parent, FORCE, add(get(parent, FORCE), force))
        put(parent, MOMENT, add(get(parent, MOMENT), add(moment, cross(get(at, LEVER), force))))


@compiled
def inverse_dynamics(
    joints: Joints,
    bodies: Bodies,
    positions: Array2,
    velocities: Array2,
    accelerations: Array2,
    filled: Array2,
) -> None:
    """Compute the torques and forces of motions, by the recursive Newton-Euler algorithm.

    Args:
        joints: the joints; none moves otherwise than it turns or slides.
        bodies: what they carry.
        positions: joint positions, (s, nv).
        velocities: joint velocities, (s, nv).
        accelerations: joint accelerations, (s, nv).
        filled: filled with the torques, (s, nv).
    """
    count = len(joints.kinds)
    placed = np.empty((count + 1, PLACED_SIZE))
    moved = np.empty((count + 1, MOVED_SIZE))
    g = bodies.gravity
    upward = (-g[0], -g[1], -g[2])
    for s in range(len(positions)):
        place_bodies(joints, bodies, positions[s], placed)
        turn_inertias(bodies, placed)
        move_bodies_by(joints, bodies, velocities[s], accelerations[s], upward, placed, moved, filled[s])
        for j in range(filled.shape[1]):
            filled[s, j] += bodies.armature[j] * accelerations[s, j]


@compiled
def gravity_torques(joints: Joints, bodies: Bodies, positions: Array2, filled: Array2) -> None:
    """Compute the torques and forces that balance gravity, (s, nv); as `inverse_dynamics` at rest."""
    count = len(joints.kinds)
    placed = np.empty((count + 1, PLACED_SIZE))
    moved = np.empty((count + 1, MOVED_SIZE))
    g = bodies.gravity
    upward = (-g[0], -g[1], -g[2])
    for s in range(len(positions)):
        place_bodies(joints, bodies, positions[s], placed)
        lift_bodies(joints, bodies, upward, placed, moved, filled[s])


@compiled
def path_torques(
    joints: Joints,
    bodies: Bodies,
    offsets: Array2,
    slopes: Array2,
    start: Array1,
    dt: float,
    filled: TorqueSamples,
) -> None:
    """Compute the torques along a path, the cubic curve through its waypoints.

    Args:
        joints: as for `inverse_dynamics`.
        bodies: likewise.
        offsets: displacement of each waypoint from the start, (N + 1, nv), N > 0.
        slopes: change of it per waypoint, (N + 1, nv).
        start: joint positions at the start, (nv,).
        dt: duration of a step; path speeds are in waypoints per step.
        filled: filled with the torques at equidistant places, from the start to the end.
    """
    count = len(joints.kinds)
    nv = len(start)
    pieces = len(offsets) - 1
    placed = np.empty((count + 1, PLACED_SIZE))
    moved = np.empty((count + 1, MOVED_SIZE))
    none = np.zeros(nv)
    positions = np.empty(nv)
    velocities = np.empty(nv)
    accelerations = np.empty(nv)
    changes = np.empty(nv)
    floating = (0.0, 0.0, 0.0)
    g = bodies.gravity
    upward = (-g[0], -g[1], -g[2])
    samples = len(filled.a)
    for sample in range(samples):
        place = sample * pieces / (samples - 1)
        i = min(int(place), pieces - 1)
        t = place - i
        for j in range(nv):
            one = slopes[i, j]
            other = slopes[i + 1, j]
            whole = offsets[i + 1, j] - offsets[i, j]
            square = 3.0 * whole - 2.0 * one - other
            cubic = one + other - 2.0 * whole
            positions[j] = start[j] + offsets[i, j] + t * (one + t * (square + t * cubic))
            velocities[j] = (one + t * (2.0 * square + t * 3.0 * cubic)) / dt
            accelerations[j] = velocities[j] / dt
            changes[j] = (2.0 * square + 6.0 * t * cubic) / dt**2
        place_bodies(joints, bodies, positions, placed)
        turn_inertias(bodies, placed)
        a = filled.a[sample]
        b = filled.b[sample]
        lift_bodies(joints, bodies, upward, placed, moved, filled.c[sample])
        move_bodies_by(joints, bodies, none, accelerations, floating, placed, moved, a)
        move_bodies_by(joints, bodies, velocities, changes, floating, placed, moved, b)
        for j in range(nv):
            a[j] += bodies.armature[j] * accelerations[j]
            b[j] += bodies.armature[j] * changes[j]


@compiled
def gravity_gradient(joints: Joints, bodies: Bodies, positions: Array1, filled: Array2) -> None:
    """Compute the derivatives of the torques that balance gravity by joint positions.

    A joint turns what it carries, and with it the axes of later joints. So the torque -g . (a_i x p_i) of
    joint i, with the sum p_i of masses times levers, changes by -g . (a_j x (a_i x p_i)) per turn of a joint
    j that carries it. The derivatives are symmetric: those of the potential energy.

    Args:
        joints: as for `inverse_dynamics`.
        bodies: likewise.
        positions: joint positions, (nv,).
        filled: filled with the derivatives, (nv, nv).
    """
    count = len(joints.kinds)
    placed = np.empty((count + 1, PLACED_SIZE))
    carried = np.zeros((count + 1, 4))  # sum of masses, and of masses times levers, from the tips to the base
    place_bodies(joints, bodies, positions, placed)
    g = bodies.gravity
    upward = (-g[0], -g[1], -g[2])
    for u in range(count - 1, -1, -1):
        row = carried[u + 1]
        row[0] += bodies.masses[u]
        put(row, 1, add(get(row, 1), scale(get(placed[u + 1], CENTER), bodies.masses[u])))
        parent = carried[joints.parents[u]]
        parent[0] += row[0]
        put(parent, 1, add(get(parent, 1), add(get(row, 1), scale(get(placed[u + 1], LEVER), row[0]))))
    filled[:] = 0.0
    for u in range(count):
        axis = get(placed[u + 1], AXIS)
        lifted = scale(axis, carried[u + 1, 0])  # motion of the masses, per motion of the joint
        if joints.kinds[u] != SLIDES:
            lifted = cross(axis, get(carried[u + 1], 1))
        i = joints.columns[u]
        frame = u + 1
        while frame > 0:
            v = frame - 1
            if joints.kinds[v] != SLIDES:
                j = joints.columns[v]
                slope = (
                    joints.ratios[u] * joints.ratios[v] * dot(upward, cross(get(placed[frame], AXIS), lifted))
                )
                filled[i, j] += slope
                if u != v:
                    filled[j, i] += slope
            frame = joints.parents[v]
