"""Inverse dynamics of trees of joints: the torques of motions, of gravity, and along a path.

Vectors of a body are in world axes and refer to the origin of its frame, so that a base far from the origin
of the world costs no digits.

Passes along the joints treat several postures at once, one in each lane, so that the processor can compute
them together: a row of a body has the number k of all lanes from `k * lanes` on. Kernels are compiled for
`LANES` of them, and for one.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pinposture.kernels.arrays import (
    SLIDES,
    Array1,
    Array2,
    Bodies,
    Ints1,
    Joints,
    Nine,
    Three,
    TorqueSamples,
)
from pinposture.kernels.compiled import compiled, inlined
from pinposture.kernels.kinematics import rotation_about, turn_row

LANES = 8
"""Number of postures that are computed together. With 4 a path of 40 joints took 9 % longer."""


class RowLayout(NamedTuple):
    """Where the row of a body has what, after the orientation of its frame.

    A loop over lanes that reads and writes one row alone needs no check whether two overlap.
    """

    axis: int = 9
    """The axis of the joint."""

    lever: int = 12
    """The way to its origin from that of the frame that carries it."""

    center: int = 15
    """The centre of mass."""

    inertia: int = 18
    """The moments of inertia."""

    spin: int = 24
    """The angular velocity."""

    spin_rate: int = 27
    """The angular acceleration."""

    acceleration: int = 30
    """The acceleration of the origin."""

    force: int = 33
    """The force that the body takes."""

    moment: int = 36
    """The moment that the body takes."""

    speed: int = 39
    """The velocity of the joint."""

    change: int = 40
    """Its acceleration."""

    torque: int = 41
    """Its torque."""

    other: int = 42
    """Numbers of the frame that carries it."""

    size: int = 51
    """The length of the row."""


ROW = RowLayout()

QUARTER_TURN = tuple(map(float.fromhex, ("0x1.921fb544p0", "0x1.0b4611a6p-34", "0x1.3198a2e037073p-69")))
"""Three parts of a quarter turn [rad]: 33 bits, the next 33, and what is left."""


@inlined
def unpack(indices: Ints1, numbers: Array1) -> tuple[Joints, Bodies]:
    """Return joints and bodies as views of two arrays.

    A call from Python takes 0.2 us for each array that it passes, and 0.9 us for a tuple.

    Args:
        indices: parents, kinds and columns of the joints, one after the other, (3 k,).
        numbers: their axes, offsets and ratios; masses, centers and inertias of the bodies; armature of the
            drives, and gravity, (17 k + nv + 3,).
    """
    k = len(indices) // 3
    joints = Joints(
        parents=indices[:k],
        kinds=indices[k : 2 * k],
        axes=numbers[: 3 * k].reshape((k, 3)),
        offsets=numbers[3 * k : 6 * k].reshape((k, 3)),
        columns=indices[2 * k :],
        ratios=numbers[6 * k : 7 * k],
    )
    bodies = Bodies(
        masses=numbers[7 * k : 8 * k],
        centers=numbers[8 * k : 11 * k].reshape((k, 3)),
        inertias=numbers[11 * k : 17 * k].reshape((k, 6)),
        armature=numbers[17 * k : len(numbers) - 3],
        gravity=numbers[len(numbers) - 3 :],
    )
    return joints, bodies


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
def cosine_and_sine(angle: float) -> tuple[float, float]:
    """Return cosine and sine of an angle [rad], in operations that processors apply to several at once.

    They are the power series of what is left beside the nearest quarter turn, up to where further terms are
    less than rounding. Up to 1e5 rad they are within 3e-16 of the exact ones.
    """
    turns = np.floor(angle * (2.0 / np.pi) + 0.5)
    x = ((angle - turns * QUARTER_TURN[0]) - turns * QUARTER_TURN[1]) - turns * QUARTER_TURN[2]
    y = -x * x
    c = 1.0 + y * (1.0 / 182.0) * (1.0 + y * (1.0 / 240.0))
    c = 1.0 + y * (1.0 / 56.0) * (1.0 + y * (1.0 / 90.0) * (1.0 + y * (1.0 / 132.0) * c))
    c = 1.0 + y * (1.0 / 2.0) * (1.0 + y * (1.0 / 12.0) * (1.0 + y * (1.0 / 30.0) * c))
    s = 1.0 + y * (1.0 / 156.0) * (1.0 + y * (1.0 / 210.0) * (1.0 + y * (1.0 / 272.0)))
    s = 1.0 + y * (1.0 / 42.0) * (1.0 + y * (1.0 / 72.0) * (1.0 + y * (1.0 / 110.0) * s))
    s = x * (1.0 + y * (1.0 / 6.0) * (1.0 + y * (1.0 / 20.0) * s))
    quarter = turns - 4.0 * np.floor(0.25 * turns)
    swaps = abs(quarter - 2.0) == 1.0
    cosine = s if swaps else c
    sine = c if swaps else s
    return (-cosine if abs(quarter - 1.5) == 0.5 else cosine), (-sine if quarter >= 2.0 else sine)


@inlined
def get(row: Array1, at: int, lanes: int, w: int) -> Three:
    """Return three numbers of a lane."""
    return row[at * lanes + w], row[(at + 1) * lanes + w], row[(at + 2) * lanes + w]


@inlined
def put(row: Array1, at: int, lanes: int, w: int, a: Three) -> None:
    """Store three numbers in a lane."""
    row[at * lanes + w] = a[0]
    row[(at + 1) * lanes + w] = a[1]
    row[(at + 2) * lanes + w] = a[2]


@inlined
def copy_lanes(source: Array1, first: int, size: int, lanes: int, filled: Array1) -> None:
    """Copy numbers of another row, in all lanes."""
    for k in range(size * lanes):
        filled[ROW.other * lanes + k] = source[first * lanes + k]


@inlined
def load_lanes(joints: Joints, values: Array2, first: int, at: int, lanes: int, rows: Array2) -> None:
    """Store values of joints (s, nv) in all lanes, from those of one posture on; the last fills the rest."""
    last = len(values) - 1
    for u in range(len(joints.kinds)):
        row = rows[u + 1]
        ratio = joints.ratios[u]
        column = joints.columns[u]
        for w in range(lanes):
            row[at * lanes + w] = ratio * values[min(first + w, last), column]


@inlined
def unload_lanes(joints: Joints, first: int, lanes: int, rows: Array2, filled: Array2) -> None:
    """Fill in the torques (s, nv) of all lanes, from one posture on."""
    some = min(lanes, len(filled) - first)
    filled[first : first + some] = 0.0
    for u in range(len(joints.kinds)):
        row = rows[u + 1]
        ratio = joints.ratios[u]
        column = joints.columns[u]
        for w in range(some):
            filled[first + w, column] += ratio * row[ROW.torque * lanes + w]


@inlined
def place_bodies(joints: Joints, bodies: Bodies, lanes: int, rows: Array2) -> None:
    """Fill in orientations, axes, levers and centres of bodies, (k + 1, ROW.size lanes).

    The positions of the joints are where their axes will be.
    """
    rows[0, : 9 * lanes] = 0.0
    for w in range(lanes):
        rows[0, w] = 1.0
        rows[0, 4 * lanes + w] = 1.0
        rows[0, 8 * lanes + w] = 1.0
    for u in range(len(joints.kinds)):  # for all at once, because the next loop would wait for each
        if joints.kinds[u] != SLIDES:
            row = rows[u + 1]
            for w in range(lanes):
                cosine, sine = cosine_and_sine(row[ROW.axis * lanes + w])
                row[ROW.axis * lanes + w] = cosine
                row[(ROW.axis + 1) * lanes + w] = sine
    for u in range(len(joints.kinds)):
        row = rows[u + 1]
        copy_lanes(rows[joints.parents[u]], 0, 9, lanes, row)
        x = joints.axes[u, 0]
        y = joints.axes[u, 1]
        z = joints.axes[u, 2]
        offset = (joints.offsets[u, 0], joints.offsets[u, 1], joints.offsets[u, 2])
        center = (bodies.centers[u, 0], bodies.centers[u, 1], bodies.centers[u, 2])
        slides = joints.kinds[u] == SLIDES
        for w in range(lanes):
            first = get(row, ROW.other, lanes, w)
            second = get(row, ROW.other + 3, lanes, w)
            third = get(row, ROW.other + 6, lanes, w)
            axis = (dot(first, (x, y, z)), dot(second, (x, y, z)), dot(third, (x, y, z)))
            lever = (dot(first, offset), dot(second, offset), dot(third, offset))
            if slides:
                lever = add(lever, scale(axis, row[ROW.axis * lanes + w]))
            else:
                turn = rotation_about(x, y, z, row[ROW.axis * lanes + w], row[(ROW.axis + 1) * lanes + w])
                first = turn_row(first[0], first[1], first[2], turn)
                second = turn_row(second[0], second[1], second[2], turn)
                third = turn_row(third[0], third[1], third[2], turn)
            put(row, 0, lanes, w, first)
            put(row, 3, lanes, w, second)
            put(row, 6, lanes, w, third)
            put(row, ROW.axis, lanes, w, axis)
            put(row, ROW.lever, lanes, w, lever)
            put(row, ROW.center, lanes, w, (dot(first, center), dot(second, center), dot(third, center)))


@inlined
def turn_inertias(bodies: Bodies, lanes: int, rows: Array2) -> None:
    """Fill in the moments of inertia of placed bodies, xx, yy, zz, xy, xz, yz, world axes."""
    for u in range(len(bodies.masses)):
        row = rows[u + 1]
        xx = bodies.inertias[u, 0]
        yy = bodies.inertias[u, 1]
        zz = bodies.inertias[u, 2]
        xy = bodies.inertias[u, 3]
        xz = bodies.inertias[u, 4]
        yz = bodies.inertias[u, 5]
        inertia: Nine = (xx, xy, xz, xy, yy, yz, xz, yz, zz)
        for w in range(lanes):
            a = get(row, 0, lanes, w)
            b = get(row, 3, lanes, w)
            c = get(row, 6, lanes, w)
            first = turn_row(a[0], a[1], a[2], inertia)
            second = turn_row(b[0], b[1], b[2], inertia)
            third = turn_row(c[0], c[1], c[2], inertia)
            put(row, ROW.inertia, lanes, w, (dot(first, a), dot(second, b), dot(third, c)))
            put(row, ROW.inertia + 3, lanes, w, (dot(first, b), dot(first, c), dot(second, c)))


@inlined
def turned_by(row: Array1, lanes: int, w: int, a: Three) -> Three:
    """Return the angular momentum of a placed body that turns about its centre of mass."""
    xx, yy, zz = get(row, ROW.inertia, lanes, w)
    xy, xz, yz = get(row, ROW.inertia + 3, lanes, w)
    return (
        xx * a[0] + xy * a[1] + xz * a[2],
        xy * a[0] + yy * a[1] + yz * a[2],
        xz * a[0] + yz * a[1] + zz * a[2],
    )


@inlined
def move_bodies_by(joints: Joints, bodies: Bodies, upward: Three, lanes: int, rows: Array2) -> None:
    """Compute the torques of a motion of placed bodies, without armature.

    Args:
        joints: the joints.
        bodies: the bodies.
        upward: acceleration of the base; minus that of gravity.
        lanes: number of postures.
        rows: the placed bodies, with velocities and accelerations of their joints.
    """
    rows[0, ROW.spin * lanes : ROW.speed * lanes] = 0.0
    for w in range(lanes):
        put(rows[0], ROW.acceleration, lanes, w, upward)
    for u in range(len(joints.kinds)):
        row = rows[u + 1]
        copy_lanes(rows[joints.parents[u]], ROW.spin, 9, lanes, row)
        mass = bodies.masses[u]
        slides = joints.kinds[u] == SLIDES
        for w in range(lanes):
            axis = get(row, ROW.axis, lanes, w)
            lever = get(row, ROW.lever, lanes, w)
            rate = scale(axis, row[ROW.speed * lanes + w])
            change = scale(axis, row[ROW.change * lanes + w])
            spin = get(row, ROW.other, lanes, w)
            spin_rate = get(row, ROW.other + 3, lanes, w)
            origin = add(get(row, ROW.other + 6, lanes, w), cross(spin_rate, lever))
            origin = add(origin, cross(spin, cross(spin, lever)))
            across = cross(spin, rate)
            if slides:
                origin = add(origin, add(change, scale(across, 2.0)))
            else:
                spin_rate = add(spin_rate, add(change, across))
                spin = add(spin, rate)
            center = get(row, ROW.center, lanes, w)
            pull = add(origin, add(cross(spin_rate, center), cross(spin, cross(spin, center))))
            force = scale(pull, mass)
            turning = turned_by(row, lanes, w, spin_rate)
            turning = add(turning, cross(spin, turned_by(row, lanes, w, spin)))
            put(row, ROW.spin, lanes, w, spin)
            put(row, ROW.spin_rate, lanes, w, spin_rate)
            put(row, ROW.acceleration, lanes, w, origin)
            put(row, ROW.force, lanes, w, force)
            put(row, ROW.moment, lanes, w, add(cross(center, force), turning))
    sum_forces(joints, lanes, rows)


@inlined
def push_bodies(joints: Joints, bodies: Bodies, lanes: int, rows: Array2) -> None:
    """Compute the torques that accelerate placed bodies from rest; as `move_bodies_by` without speeds."""
    rows[0, ROW.spin_rate * lanes : ROW.force * lanes] = 0.0
    for u in range(len(joints.kinds)):
        row = rows[u + 1]
        copy_lanes(rows[joints.parents[u]], ROW.spin_rate, 6, lanes, row)
        mass = bodies.masses[u]
        slides = joints.kinds[u] == SLIDES
        for w in range(lanes):
            change = scale(get(row, ROW.axis, lanes, w), row[ROW.change * lanes + w])
            spin_rate = get(row, ROW.other, lanes, w)
            origin = add(get(row, ROW.other + 3, lanes, w), cross(spin_rate, get(row, ROW.lever, lanes, w)))
            if slides:
                origin = add(origin, change)
            else:
                spin_rate = add(spin_rate, change)
            center = get(row, ROW.center, lanes, w)
            force = scale(add(origin, cross(spin_rate, center)), mass)
            put(row, ROW.spin_rate, lanes, w, spin_rate)
            put(row, ROW.acceleration, lanes, w, origin)
            put(row, ROW.force, lanes, w, force)
            put(row, ROW.moment, lanes, w, add(cross(center, force), turned_by(row, lanes, w, spin_rate)))
    sum_forces(joints, lanes, rows)


@inlined
def lift_bodies(joints: Joints, bodies: Bodies, upward: Three, lanes: int, rows: Array2) -> None:
    """Compute the torques of placed bodies at rest; as `move_bodies_by` without motion."""
    for u in range(len(joints.kinds)):
        row = rows[u + 1]
        force = scale(upward, bodies.masses[u])
        for w in range(lanes):
            put(row, ROW.force, lanes, w, force)
            put(row, ROW.moment, lanes, w, cross(get(row, ROW.center, lanes, w), force))
    sum_forces(joints, lanes, rows)


@inlined
def sum_forces(joints: Joints, lanes: int, rows: Array2) -> None:
    """Add up forces and moments from the tips to the base, and take their part along each joint."""
    for u in range(len(joints.kinds) - 1, -1, -1):
        row = rows[u + 1]
        slides = joints.kinds[u] == SLIDES
        for w in range(lanes):
            axis = get(row, ROW.axis, lanes, w)
            force = get(row, ROW.force, lanes, w)
            moment = get(row, ROW.moment, lanes, w)
            row[ROW.torque * lanes + w] = dot(axis, force if slides else moment)
            put(row, ROW.other, lanes, w, force)
            put(row, ROW.other + 3, lanes, w, add(moment, cross(get(row, ROW.lever, lanes, w), force)))
        parent = rows[joints.parents[u]]
        for k in range(6 * lanes):
            parent[ROW.force * lanes + k] += row[ROW.other * lanes + k]


@inlined
def move_some(
    indices: Ints1,
    numbers: Array1,
    positions: Array2,
    velocities: Array2,
    accelerations: Array2,
    lanes: int,
    filled: Array2,
) -> None:
    """Compute `inverse_dynamics`, some motions at a time."""
    joints, bodies = unpack(indices, numbers)
    rows = np.empty((len(joints.kinds) + 1, ROW.size * lanes))
    g = bodies.gravity
    upward = (-g[0], -g[1], -g[2])
    for first in range(0, len(positions), lanes):
        load_lanes(joints, positions, first, ROW.axis, lanes, rows)
        load_lanes(joints, velocities, first, ROW.speed, lanes, rows)
        load_lanes(joints, accelerations, first, ROW.change, lanes, rows)
        place_bodies(joints, bodies, lanes, rows)
        turn_inertias(bodies, lanes, rows)
        move_bodies_by(joints, bodies, upward, lanes, rows)
        unload_lanes(joints, first, lanes, rows, filled)
    for s in range(len(filled)):
        for j in range(filled.shape[1]):
            filled[s, j] += bodies.armature[j] * accelerations[s, j]


@compiled
def inverse_dynamics(
    indices: Ints1,
    numbers: Array1,
    positions: Array2,
    velocities: Array2,
    accelerations: Array2,
    filled: Array2,
) -> None:
    """Compute the torques and forces of motions, by the recursive Newton-Euler algorithm.

    Args:
        indices: the joints, none of which moves otherwise than it turns or slides; see `unpack`.
        numbers: those of joints and of what they carry; see `unpack`.
        positions: joint positions, (s, nv).
        velocities: joint velocities, (s, nv).
        accelerations: joint accelerations, (s, nv).
        filled: filled with the torques, (s, nv).
    """
    if len(positions) == 1:
        move_some(indices, numbers, positions, velocities, accelerations, 1, filled)
    else:
        move_some(indices, numbers, positions, velocities, accelerations, LANES, filled)


@inlined
def lift_some(indices: Ints1, numbers: Array1, positions: Array2, lanes: int, filled: Array2) -> None:
    """Compute `gravity_torques`, some postures at a time."""
    joints, bodies = unpack(indices, numbers)
    rows = np.empty((len(joints.kinds) + 1, ROW.size * lanes))
    g = bodies.gravity
    upward = (-g[0], -g[1], -g[2])
    for first in range(0, len(positions), lanes):
        load_lanes(joints, positions, first, ROW.axis, lanes, rows)
        place_bodies(joints, bodies, lanes, rows)
        lift_bodies(joints, bodies, upward, lanes, rows)
        unload_lanes(joints, first, lanes, rows, filled)


@compiled
def gravity_torques(indices: Ints1, numbers: Array1, positions: Array2, filled: Array2) -> None:
    """Compute the torques and forces that balance gravity, (s, nv); as `inverse_dynamics` at rest."""
    if len(positions) == 1:
        lift_some(indices, numbers, positions, 1, filled)
    else:
        lift_some(indices, numbers, positions, LANES, filled)


@inlined
def largest_shares(torques: Array2, effort: Array1, some: int, first: int, filled: Array1) -> None:
    """Fill in the largest torque of each posture relative to its limit, from one posture on."""
    for w in range(some):
        largest = 0.0
        for j in range(len(effort)):
            largest = max(largest, abs(torques[w, j]) / effort[j])
        filled[first + w] = largest


@compiled
def step_loads(
    indices: Ints1,
    numbers: Array1,
    start: Array1,
    moves: Array2,
    dt: float,
    effort: Array1,
    moving: Array1,
    held: Array1,
) -> None:
    """Compute the largest torque of steps relative to its limit, where they meet, in motion and at rest.

    Those of a motion have the mean velocity of the two steps, and the acceleration from one to the other.

    Args:
        indices: as for `inverse_dynamics`.
        numbers: likewise.
        start: joint positions between the first two steps, (nv,).
        moves: the steps, (s + 1, nv).
        dt: duration of a step.
        effort: the limits of the torques, (nv,).
        moving: filled with the largest share of a limit in the motion, (s,).
        held: filled with that which holds the arm still there, (s,).
    """
    joints, bodies = unpack(indices, numbers)
    nv = len(start)
    rows = np.empty((len(joints.kinds) + 1, ROW.size * LANES))
    positions = np.empty((LANES, nv))
    velocities = np.empty((LANES, nv))
    accelerations = np.empty((LANES, nv))
    torques = np.empty((LANES, nv))
    reached = start.copy()
    g = bodies.gravity
    upward = (-g[0], -g[1], -g[2])
    for first in range(0, len(moving), LANES):
        some = min(LANES, len(moving) - first)
        for w in range(LANES):
            s = min(first + w, len(moving) - 1)
            for j in range(nv):
                if 0 < s == first + w:
                    reached[j] += moves[s, j]
                positions[w, j] = reached[j]
                velocities[w, j] = (moves[s, j] + moves[s + 1, j]) / (2.0 * dt)
                accelerations[w, j] = (moves[s + 1, j] - moves[s, j]) / dt**2
        load_lanes(joints, positions, 0, ROW.axis, LANES, rows)
        load_lanes(joints, velocities, 0, ROW.speed, LANES, rows)
        load_lanes(joints, accelerations, 0, ROW.change, LANES, rows)
        place_bodies(joints, bodies, LANES, rows)
        turn_inertias(bodies, LANES, rows)
        lift_bodies(joints, bodies, upward, LANES, rows)
        unload_lanes(joints, 0, LANES, rows, torques)
        largest_shares(torques, effort, some, first, held)
        move_bodies_by(joints, bodies, upward, LANES, rows)
        unload_lanes(joints, 0, LANES, rows, torques)
        for w in range(LANES):
            for j in range(nv):
                torques[w, j] += bodies.armature[j] * accelerations[w, j]
        largest_shares(torques, effort, some, first, moving)


@compiled
def path_torques(
    indices: Ints1,
    numbers: Array1,
    offsets: Array2,
    slopes: Array2,
    start: Array1,
    dt: float,
    filled: TorqueSamples,
) -> None:
    """Compute the torques along a path, the cubic curve through its waypoints.

    Args:
        indices: as for `inverse_dynamics`.
        numbers: likewise.
        offsets: displacement of each waypoint from the start, (N + 1, nv), N > 0.
        slopes: change of it per waypoint, (N + 1, nv).
        start: joint positions at the start, (nv,).
        dt: duration of a step; path speeds are in waypoints per step.
        filled: filled with the torques at equidistant places, from the start to the end.
    """
    joints, bodies = unpack(indices, numbers)
    nv = len(start)
    pieces = len(offsets) - 1
    samples = len(filled.a)
    rows = np.empty((len(joints.kinds) + 1, ROW.size * LANES))
    positions = np.empty((LANES, nv))
    velocities = np.empty((LANES, nv))
    accelerations = np.empty((LANES, nv))
    changes = np.empty((LANES, nv))
    floating = (0.0, 0.0, 0.0)
    g = bodies.gravity
    upward = (-g[0], -g[1], -g[2])
    for first in range(0, samples, LANES):
        for w in range(LANES):
            place = min(first + w, samples - 1) * pieces / (samples - 1)
            i = min(int(place), pieces - 1)
            t = place - i
            for j in range(nv):
                one = slopes[i, j]
                other = slopes[i + 1, j]
                whole = offsets[i + 1, j] - offsets[i, j]
                square = 3.0 * whole - 2.0 * one - other
                cubic = one + other - 2.0 * whole
                positions[w, j] = start[j] + offsets[i, j] + t * (one + t * (square + t * cubic))
                velocities[w, j] = (one + t * (2.0 * square + t * 3.0 * cubic)) / dt
                accelerations[w, j] = velocities[w, j] / dt
                changes[w, j] = (2.0 * square + 6.0 * t * cubic) / dt**2
        load_lanes(joints, positions, 0, ROW.axis, LANES, rows)
        place_bodies(joints, bodies, LANES, rows)
        turn_inertias(bodies, LANES, rows)
        lift_bodies(joints, bodies, upward, LANES, rows)
        unload_lanes(joints, first, LANES, rows, filled.c)
        load_lanes(joints, accelerations, 0, ROW.change, LANES, rows)
        push_bodies(joints, bodies, LANES, rows)
        unload_lanes(joints, first, LANES, rows, filled.a)
        load_lanes(joints, velocities, 0, ROW.speed, LANES, rows)
        load_lanes(joints, changes, 0, ROW.change, LANES, rows)
        move_bodies_by(joints, bodies, floating, LANES, rows)
        unload_lanes(joints, first, LANES, rows, filled.b)
        for w in range(min(LANES, samples - first)):
            for j in range(nv):
                filled.a[first + w, j] += bodies.armature[j] * accelerations[w, j]
                filled.b[first + w, j] += bodies.armature[j] * changes[w, j]


@compiled
def gravity_gradient(indices: Ints1, numbers: Array1, positions: Array1, filled: Array2) -> None:
    """Compute the derivatives of the torques that balance gravity by joint positions.

    A joint turns what it carries, and with it the axes of later joints. So the torque -g . (a_i x p_i) of
    joint i, with the sum p_i of masses times levers, changes by -g . (a_j x (a_i x p_i)) per turn of a joint
    j that carries it. The derivatives are symmetric: those of the potential energy.

    Args:
        indices: as for `inverse_dynamics`.
        numbers: likewise.
        positions: joint positions, (nv,).
        filled: filled with the derivatives, (nv, nv).
    """
    joints, bodies = unpack(indices, numbers)
    count = len(joints.kinds)
    placed = np.empty((count + 1, ROW.size))
    carried = np.zeros((count + 1, 4))  # sum of masses, and of masses times levers, from the tips to the base
    load_lanes(joints, positions.reshape((1, -1)), 0, ROW.axis, 1, placed)
    place_bodies(joints, bodies, 1, placed)
    g = bodies.gravity
    upward = (-g[0], -g[1], -g[2])
    for u in range(count - 1, -1, -1):
        row = carried[u + 1]
        row[0] += bodies.masses[u]
        put(
            row,
            1,
            1,
            0,
            add(get(row, 1, 1, 0), scale(get(placed[u + 1], ROW.center, 1, 0), bodies.masses[u])),
        )
        parent = carried[joints.parents[u]]
        parent[0] += row[0]
        passed = add(get(row, 1, 1, 0), scale(get(placed[u + 1], ROW.lever, 1, 0), row[0]))
        put(parent, 1, 1, 0, add(get(parent, 1, 1, 0), passed))
    filled[:] = 0.0
    for u in range(count):
        axis = get(placed[u + 1], ROW.axis, 1, 0)
        lifted = scale(axis, carried[u + 1, 0])  # motion of the masses, per motion of the joint
        if joints.kinds[u] != SLIDES:
            lifted = cross(axis, get(carried[u + 1], 1, 1, 0))
        i = joints.columns[u]
        frame = u + 1
        while frame > 0:
            v = frame - 1
            if joints.kinds[v] != SLIDES:
                j = joints.columns[v]
                turn = get(placed[frame], ROW.axis, 1, 0)
                slope = joints.ratios[u] * joints.ratios[v] * dot(upward, cross(turn, lifted))
                filled[i, j] += slope
                if u != v:
                    filled[j, i] += slope
            frame = joints.parents[v]
