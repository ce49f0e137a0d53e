"""Inverse dynamics of trees of joints: the torques of motions, of gravity, and along a path.

Vectors of a body are in the axes of its frame and refer to its origin, where its masses are constant. Their
second moments are S, the sum of m r r^T, and their first moments h, the sum of m r. With the acceleration a
of the origin, the angular velocity w and the angular acceleration b, a point r accelerates by a + A r, where
A r = b x r + w x (w x r). So a body of mass m takes the force m a + A h, and the moment h x a + v, where v is
the axial vector of A S: that whose cross product with any vector is the difference of A S and its transpose.

Weight needs no sum of forces: all that a joint carries weighs as much as its masses in their common centre.

Passes along the joints treat several postures at once, one in each lane, so that the processor can compute
them together: a row of a body has the number k of all lanes from `k * lanes` on. Each step of a pass waits
for the one before; so the torques of weight and of a motion are computed in the same passes, and its momenta.
Kernels are compiled for `TORQUE_LANES` of them, and for one.

The momenta of joints, the mass matrix times the velocities, are the torques that bring these about within a
unit of time, from rest. A body of mass m whose origin moves with v has the momentum m v + w x h, and the
angular momentum h x v + I w, with the inertia I = trace(S) - S.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pinposture.kernels.arrays import (
    JOINT,
    TORQUE_LANES,
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
from pinposture.kernels.kinematics import rotation_about

Inertia = tuple[float, Three, tuple[float, float, float, float, float, float]]
"""Mass, first moments, and second moments as those of `Bodies`."""


class RowLayout(NamedTuple):
    """Where the row of a body has what.

    A loop over lanes that reads and writes one row alone needs no check whether two overlap. So a row takes
    over from that of the frame that carries it, and hands on to it, in loops of their own, over the lanes of
    one number after the other: with one loop over them all, torques along a path took a fifth longer.
    """

    turn: int = 0
    """The orientation of its frame in the one that carries it, row by row."""

    position: int = 9
    """The position of the joint; after `place_bodies` that of a slide, and 0 of a joint that turns."""

    speed: int = 10
    """The velocity of the joint."""

    change: int = 11
    """Its acceleration."""

    up: int = 12
    """Minus the acceleration of gravity."""

    spin: int = 15
    """The angular velocity."""

    spin_rate: int = 18
    """The angular acceleration."""

    acceleration: int = 21
    """The acceleration of the origin."""

    velocity: int = 24
    """The velocity of the origin."""

    first_moments: int = 27
    """The first moments of all that the joint carries."""

    force: int = 30
    """The force that this takes."""

    moment: int = 33
    """The moment that this takes."""

    momentum: int = 36
    """Its momentum."""

    angular_momentum: int = 39
    """Its angular momentum."""

    weight: int = 42
    """The torque of the joint that balances gravity."""

    torque: int = 43
    """That of the motion."""

    joint_momentum: int = 44
    """The momentum of the joint."""

    size: int = 45
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
        numbers: their axes, offsets and ratios; masses, first and second moments of the bodies, and the
            masses that the joints carry; armature of the drives, and gravity, (18 k + nv + 3,).
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
        first_moments=numbers[8 * k : 11 * k].reshape((k, 3)),
        second_moments=numbers[11 * k : 17 * k].reshape((k, 6)),
        carried=numbers[17 * k : 18 * k],
        armature=numbers[18 * k : len(numbers) - 3],
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
def three_of(values: Array2, u: int) -> Three:
    """Return a row of three numbers."""
    return values[u, 0], values[u, 1], values[u, 2]


@inlined
def inertia_of(bodies: Bodies, u: int) -> Inertia:
    """Return mass, first and second moments of a body."""
    s = bodies.second_moments[u]
    return bodies.masses[u], three_of(bodies.first_moments, u), (s[0], s[1], s[2], s[3], s[4], s[5])


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
def turned(row: Array1, lanes: int, w: int, a: Three) -> Three:
    """Return a vector of a body in the axes of the frame that carries its joint."""
    first = get(row, ROW.turn, lanes, w)
    second = get(row, ROW.turn + 3, lanes, w)
    third = get(row, ROW.turn + 6, lanes, w)
    return dot(first, a), dot(second, a), dot(third, a)


@inlined
def turned_back(row: Array1, lanes: int, w: int, a: Three) -> Three:
    """Return a vector in the axes of the frame that carries a joint in those of the body it carries."""
    first = get(row, ROW.turn, lanes, w)
    second = get(row, ROW.turn + 3, lanes, w)
    third = get(row, ROW.turn + 6, lanes, w)
    return (
        first[0] * a[0] + second[0] * a[1] + third[0] * a[2],
        first[1] * a[0] + second[1] * a[1] + third[1] * a[2],
        first[2] * a[0] + second[2] * a[1] + third[2] * a[2],
    )


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
def unload_lanes(joints: Joints, at: int, first: int, lanes: int, rows: Array2, filled: Array2) -> None:
    """Add torques of all lanes to those of some postures (s, nv), from one on."""
    some = min(lanes, len(filled) - first)
    for u in range(len(joints.kinds)):
        row = rows[u + 1]
        ratio = joints.ratios[u]
        column = joints.columns[u]
        for w in range(some):
            filled[first + w, column] += ratio * row[at * lanes + w]


@inlined
def place_bodies(joints: Joints, lanes: int, rows: Array2) -> None:
    """Fill in the orientation of each body in the frame that carries it, for the positions of the joints."""
    for u in range(len(joints.kinds)):
        row = rows[u + 1]
        x, y, z = three_of(joints.axes, u)
        if joints.kinds[u] == JOINT.prismatic:
            for w in range(lanes):
                put(row, ROW.turn, lanes, w, (1.0, 0.0, 0.0))
                put(row, ROW.turn + 3, lanes, w, (0.0, 1.0, 0.0))
                put(row, ROW.turn + 6, lanes, w, (0.0, 0.0, 1.0))
        else:
            for w in range(lanes):
                cosine, sine = cosine_and_sine(row[ROW.position * lanes + w])
                turn = rotation_about(x, y, z, cosine, sine)
                put(row, ROW.turn, lanes, w, (turn[0], turn[1], turn[2]))
                put(row, ROW.turn + 3, lanes, w, (turn[3], turn[4], turn[5]))
                put(row, ROW.turn + 6, lanes, w, (turn[6], turn[7], turn[8]))
            row[ROW.position * lanes : ROW.speed * lanes] = 0.0


@inlined
def acceleration_field(spin: Three, spin_rate: Three) -> Nine:
    """Return A, row by row: a point r of a body accelerates by A r more than its origin."""
    xx = spin[0] * spin[0]
    yy = spin[1] * spin[1]
    zz = spin[2] * spin[2]
    xy = spin[0] * spin[1]
    xz = spin[0] * spin[2]
    yz = spin[1] * spin[2]
    x, y, z = spin_rate
    return -yy - zz, xy - z, xz + y, xy + z, -xx - zz, yz - x, xz - y, yz + x, -xx - yy


@inlined
def applied(field: Nine, a: Three) -> Three:
    """Return a matrix times a vector."""
    return dot(field[:3], a), dot(field[3:6], a), dot(field[6:], a)


@inlined
def put_inertial(row: Array1, lanes: int, w: int, inertia: Inertia, origin: Three, field: Nine) -> None:
    """Store the force and the moment that accelerate a body.

    Args:
        row: the row of the body.
        lanes: number of lanes.
        w: the lane.
        inertia: of the body.
        origin: acceleration of its origin.
        field: from `acceleration_field`.
    """
    mass, first, (xx, yy, zz, xy, xz, yz) = inertia
    along_x = (xx, xy, xz)
    along_y = (xy, yy, yz)
    along_z = (xz, yz, zz)
    turning = (
        dot(field[6:], along_y) - dot(field[3:6], along_z),
        dot(field[:3], along_z) - dot(field[6:], along_x),
        dot(field[3:6], along_x) - dot(field[:3], along_y),
    )
    put(row, ROW.force, lanes, w, add(scale(origin, mass), applied(field, first)))
    put(row, ROW.moment, lanes, w, add(cross(first, origin), turning))


@inlined
def put_momenta(row: Array1, lanes: int, w: int, inertia: Inertia, spin: Three, velocity: Three) -> None:
    """Store momentum and angular momentum of a body that turns, and whose origin moves with a velocity."""
    mass, first, (xx, yy, zz, xy, xz, yz) = inertia
    x, y, z = spin
    turning = (
        (yy + zz) * x - xy * y - xz * z,
        (xx + zz) * y - xy * x - yz * z,
        (xx + yy) * z - xz * x - yz * y,
    )
    put(row, ROW.momentum, lanes, w, add(scale(velocity, mass), cross(spin, first)))
    put(row, ROW.angular_momentum, lanes, w, add(cross(first, velocity), turning))


@inlined
def spread_motion(
    joints: Joints, bodies: Bodies, moves: bool, momenta: bool, lanes: int, rows: Array2
) -> None:
    """Fill in gravity and motion of placed bodies, and what they take for it, from the base to the tips.

    Args:
        joints: the joints.
        bodies: the bodies.
        moves: whether there is a motion.
        momenta: whether its momenta are filled in, too.
        lanes: number of lanes.
        rows: the placed bodies, with velocities and accelerations of their joints.
    """
    end = ROW.first_moments if momenta else (ROW.velocity if moves else ROW.spin)
    rows[0] = 0.0
    for w in range(lanes):
        put(rows[0], ROW.up, lanes, w, (-bodies.gravity[0], -bodies.gravity[1], -bodies.gravity[2]))
    for u in range(len(joints.kinds)):
        row = rows[u + 1]
        carrier = rows[joints.parents[u]]
        for k in range(ROW.up, end):
            for w in range(lanes):
                row[k * lanes + w] = carrier[k * lanes + w]
        slides = joints.kinds[u] == JOINT.prismatic
        unit = three_of(joints.axes, u)
        offset = three_of(joints.offsets, u)
        inertia = inertia_of(bodies, u)
        for w in range(lanes):
            lever = add(offset, scale(unit, row[ROW.position * lanes + w]))
            put(row, ROW.up, lanes, w, turned_back(row, lanes, w, get(row, ROW.up, lanes, w)))
            put(row, ROW.first_moments, lanes, w, inertia[1])
            if moves:
                spin = get(row, ROW.spin, lanes, w)
                spin_rate = get(row, ROW.spin_rate, lanes, w)
                origin = get(row, ROW.acceleration, lanes, w)
                origin = add(origin, applied(acceleration_field(spin, spin_rate), lever))
                rate = scale(unit, row[ROW.speed * lanes + w])
                change = scale(unit, row[ROW.change * lanes + w])
                if momenta:
                    velocity = add(get(row, ROW.velocity, lanes, w), cross(spin, lever))
                    velocity = turned_back(row, lanes, w, velocity)
                    put(row, ROW.velocity, lanes, w, add(velocity, rate) if slides else velocity)
                spin = turned_back(row, lanes, w, spin)
                spin_rate = turned_back(row, lanes, w, spin_rate)
                origin = turned_back(row, lanes, w, origin)
                across = cross(spin, rate)
                if slides:
                    origin = add(origin, add(change, scale(across, 2.0)))
                else:
                    spin_rate = add(spin_rate, add(change, across))
                    spin = add(spin, rate)
                put(row, ROW.spin, lanes, w, spin)
                put(row, ROW.spin_rate, lanes, w, spin_rate)
                put(row, ROW.acceleration, lanes, w, origin)
                put_inertial(row, lanes, w, inertia, origin, acceleration_field(spin, spin_rate))
                if momenta:
                    put_momenta(row, lanes, w, inertia, spin, get(row, ROW.velocity, lanes, w))


@inlined
def hand_on(row: Array1, at: int, lanes: int, w: int, unit: Three, lever: Three, slides: bool) -> float:
    """Convert force and moment on what a joint carries, or its momenta, to the frame that carries the joint.

    Args:
        row: the row of the body that the joint carries.
        at: where it has the force or momentum; the moment or angular momentum comes after it.
        lanes: number of lanes.
        w: the lane.
        unit: the axis of the joint.
        lever: the way to its origin.
        slides: whether it slides.

    Returns:
        Their part along the joint.
    """
    force = get(row, at, lanes, w)
    moment = get(row, at + 3, lanes, w)
    torque = dot(unit, force if slides else moment)
    force = turned(row, lanes, w, force)
    put(row, at, lanes, w, force)
    put(row, at + 3, lanes, w, add(turned(row, lanes, w, moment), cross(lever, force)))
    return torque


@inlined
def gather_torques(
    joints: Joints, bodies: Bodies, moves: bool, momenta: bool, lanes: int, rows: Array2
) -> None:
    """Add up first moments, forces, moments and momenta from the tips to the base, and fill in the torques.

    Args:
        joints: the joints.
        bodies: the bodies.
        moves: as for `spread_motion`.
        momenta: likewise.
        lanes: number of lanes.
        rows: what `spread_motion` has filled in.
    """
    end = ROW.weight if momenta else (ROW.momentum if moves else ROW.force)
    for u in range(len(joints.kinds) - 1, -1, -1):
        row = rows[u + 1]
        slides = joints.kinds[u] == JOINT.prismatic
        unit = three_of(joints.axes, u)
        offset = three_of(joints.offsets, u)
        mass = bodies.carried[u]
        for w in range(lanes):
            lever = add(offset, scale(unit, row[ROW.position * lanes + w]))
            first = get(row, ROW.first_moments, lanes, w)
            lifted = scale(unit, mass) if slides else cross(unit, first)
            row[ROW.weight * lanes + w] = dot(get(row, ROW.up, lanes, w), lifted)
            put(row, ROW.first_moments, lanes, w, add(turned(row, lanes, w, first), scale(lever, mass)))
            if moves:
                row[ROW.torque * lanes + w] = hand_on(row, ROW.force, lanes, w, unit, lever, slides)
            if momenta:
                momentum = hand_on(row, ROW.momentum, lanes, w, unit, lever, slides)
                row[ROW.joint_momentum * lanes + w] = momentum
        carrier = rows[joints.parents[u]]
        for k in range(ROW.first_moments, end):
            for w in range(lanes):
                carrier[k * lanes + w] += row[k * lanes + w]


@inlined
def find_torques(
    joints: Joints, bodies: Bodies, moves: bool, momenta: bool, lanes: int, rows: Array2
) -> None:
    """Fill in the torques of gravity and of motions, without armature; arguments as for `spread_motion`."""
    place_bodies(joints, lanes, rows)
    spread_motion(joints, bodies, moves, momenta, lanes, rows)
    gather_torques(joints, bodies, moves, momenta, lanes, rows)


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
    for s in range(len(filled)):
        for j in range(filled.shape[1]):
            filled[s, j] = bodies.armature[j] * accelerations[s, j]
    for first in range(0, len(positions), lanes):
        load_lanes(joints, positions, first, ROW.position, lanes, rows)
        load_lanes(joints, velocities, first, ROW.speed, lanes, rows)
        load_lanes(joints, accelerations, first, ROW.change, lanes, rows)
        find_torques(joints, bodies, True, False, lanes, rows)
        unload_lanes(joints, ROW.weight, first, lanes, rows, filled)
        unload_lanes(joints, ROW.torque, first, lanes, rows, filled)


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
        move_some(indices, numbers, positions, velocities, accelerations, TORQUE_LANES, filled)


@inlined
def lift_some(indices: Ints1, numbers: Array1, positions: Array2, lanes: int, filled: Array2) -> None:
    """Compute `gravity_torques`, some postures at a time."""
    joints, bodies = unpack(indices, numbers)
    rows = np.empty((len(joints.kinds) + 1, ROW.size * lanes))
    filled[:] = 0.0
    for first in range(0, len(positions), lanes):
        load_lanes(joints, positions, first, ROW.position, lanes, rows)
        find_torques(joints, bodies, False, False, lanes, rows)
        unload_lanes(joints, ROW.weight, first, lanes, rows, filled)


@compiled
def gravity_torques(indices: Ints1, numbers: Array1, positions: Array2, filled: Array2) -> None:
    """Compute the torques and forces that balance gravity, (s, nv); as `inverse_dynamics` at rest."""
    if len(positions) == 1:
        lift_some(indices, numbers, positions, 1, filled)
    else:
        lift_some(indices, numbers, positions, TORQUE_LANES, filled)


@inlined
def largest_shares(torques: Array2, effort: Array1, some: int, first: int, filled: Array1) -> None:
    """Fill in the largest torque of some postures relative to its limit, from one posture on."""
    largest = np.zeros(TORQUE_LANES)
    for j in range(len(effort)):
        per_torque = 1.0 / effort[j]
        for w in range(TORQUE_LANES):
            share = per_torque * abs(torques[w, j])
            largest[w] = share if share > largest[w] else largest[w]
    for w in range(some):
        filled[first + w] = largest[w]


@compiled
def step_loads(
    indices: Ints1,
    numbers: Array1,
    start: Array1,
    before: Array1,
    steps: Array2,
    dt: float,
    effort: Array1,
) -> Three:
    """Compute the largest torque of steps relative to its limit, where they meet, in motion and at rest.

    Those of a motion have the mean velocity of the two steps, and the acceleration from one to the other.

    Args:
        indices: as for `inverse_dynamics`.
        numbers: likewise.
        start: joint positions before the steps, (nv,).
        before: the step that led there, (nv,).
        steps: the steps, (k, nv); the arm rests after them.
        dt: duration of a step.
        effort: the limits of the torques, (nv,).

    Returns:
        The largest share of a limit in the motion and in the rest after it, that which holds the arm still
        at the start, and the largest that holds it anywhere.
    """
    joints, bodies = unpack(indices, numbers)
    nv = len(start)
    rows = np.empty((len(joints.kinds) + 1, ROW.size * TORQUE_LANES))
    positions = np.empty((TORQUE_LANES, nv))
    velocities = np.empty((TORQUE_LANES, nv))
    accelerations = np.empty((TORQUE_LANES, nv))
    torques = np.empty((TORQUE_LANES, nv))
    reached = start.copy()
    last = len(steps)
    moves = np.zeros((last + 2, nv))
    moves[0] = before
    moves[1 : last + 1] = steps
    moving = np.empty(last + 1)
    held = np.empty(last + 1)
    for first in range(0, last + 1, TORQUE_LANES):
        some = min(TORQUE_LANES, last + 1 - first)
        for w in range(TORQUE_LANES):
            s = min(first + w, last)
            for j in range(nv):
                if 0 < s == first + w:
                    reached[j] += moves[s, j]
                positions[w, j] = reached[j]
                velocities[w, j] = (moves[s, j] + moves[s + 1, j]) / (2.0 * dt)
                accelerations[w, j] = (moves[s + 1, j] - moves[s, j]) / dt**2
        load_lanes(joints, positions, 0, ROW.position, TORQUE_LANES, rows)
        load_lanes(joints, velocities, 0, ROW.speed, TORQUE_LANES, rows)
        load_lanes(joints, accelerations, 0, ROW.change, TORQUE_LANES, rows)
        find_torques(joints, bodies, True, False, TORQUE_LANES, rows)
        torques[:] = 0.0
        unload_lanes(joints, ROW.weight, 0, TORQUE_LANES, rows, torques)
        largest_shares(torques, effort, some, first, held)
        for w in range(TORQUE_LANES):
            for j in range(nv):
                torques[w, j] += bodies.armature[j] * accelerations[w, j]
        unload_lanes(joints, ROW.torque, 0, TORQUE_LANES, rows, torques)
        largest_shares(torques, effort, some, first, moving)
    return max(moving.max(), held[last]), held[0], held.max()


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
    rows = np.empty((len(joints.kinds) + 1, ROW.size * TORQUE_LANES))
    positions = np.empty((TORQUE_LANES, nv))
    velocities = np.empty((TORQUE_LANES, nv))
    changes = np.empty((TORQUE_LANES, nv))
    filled.a[:] = 0.0
    filled.b[:] = 0.0
    filled.c[:] = 0.0
    rate = 1.0 / dt
    for first in range(0, samples, TORQUE_LANES):
        for w in range(TORQUE_LANES):
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
                velocities[w, j] = (one + t * (2.0 * square + t * 3.0 * cubic)) * rate
                changes[w, j] = (2.0 * square + 6.0 * t * cubic) * (rate * rate)
        load_lanes(joints, positions, 0, ROW.position, TORQUE_LANES, rows)
        load_lanes(joints, velocities, 0, ROW.speed, TORQUE_LANES, rows)
        load_lanes(joints, changes, 0, ROW.change, TORQUE_LANES, rows)
        find_torques(joints, bodies, True, True, TORQUE_LANES, rows)
        unload_lanes(joints, ROW.joint_momentum, first, TORQUE_LANES, rows, filled.a)
        unload_lanes(joints, ROW.torque, first, TORQUE_LANES, rows, filled.b)
        unload_lanes(joints, ROW.weight, first, TORQUE_LANES, rows, filled.c)
        for w in range(min(TORQUE_LANES, samples - first)):
            for j in range(nv):
                momentum = filled.a[first + w, j] + bodies.armature[j] * velocities[w, j]
                filled.a[first + w, j] = momentum * rate  # torques are their change in a step
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
    rows = np.empty((count + 1, ROW.size))
    load_lanes(joints, positions.reshape((1, -1)), 0, ROW.position, 1, rows)
    find_torques(joints, bodies, False, False, 1, rows)
    axes = np.empty((count, 3))
    frames = np.zeros((count + 1, 9))  # their axes, in those of the base
    frames[0, 0] = 1.0
    frames[0, 4] = 1.0
    frames[0, 8] = 1.0
    upward = get(rows[0], ROW.up, 1, 0)
    filled[:] = 0.0
    for u in range(count):
        row = rows[u + 1]
        carrier = frames[joints.parents[u]]
        unit = three_of(joints.axes, u)
        lifted = scale(unit, bodies.carried[u])  # motion of the masses, per motion of the joint
        if joints.kinds[u] != JOINT.prismatic:
            offset = three_of(joints.offsets, u)
            first = get(row, ROW.first_moments, 1, 0)  # about the origin of the frame that carries it
            lifted = cross(unit, add(first, scale(offset, -bodies.carried[u])))
        lifted = turned(carrier, 1, 0, lifted)
        put(axes[u], 0, 1, 0, turned(carrier, 1, 0, unit))
        for k in range(0, 9, 3):
            put(frames[u + 1], k, 1, 0, turned_back(row, 1, 0, get(carrier, k, 1, 0)))
        i = joints.columns[u]
        frame = u + 1
        while frame > 0:
            v = frame - 1
            if joints.kinds[v] != JOINT.prismatic:
                j = joints.columns[v]
                turn = get(axes[v], 0, 1, 0)
                slope = joints.ratios[u] * joints.ratios[v] * dot(upward, cross(turn, lifted))
                filled[i, j] += slope
                if u != v:
                    filled[j, i] += slope
            frame = joints.parents[v]
