"""Smallest distances on straight joint motions, between configurations as well as at them.

A motion is evaluated at its midpoint: the distance of a pair there, minus the motion of both solids until
either end, bounds the distance on the whole motion. If that is not decisive, both halves are examined for the
remaining pairs (conservative advancement by bisection). So does half the sum of the distances at both ends,
minus the motion until either: a pair that was measured there, or halfway of a longer motion, often needs no
further measurement.

A convex obstacle lies behind the plane through its nearest point, across the shortest way from it: a body
is no nearer to it than to that plane. Only motion towards the plane counts, and a body that slides along a
wall or through a hole needs few halvings.

A body moves by at most its speed at the midpoint times half the duration, plus half the square of that times
a bound of its acceleration. Speeds and accelerations are propagated from joint to joint: the link after joint
j turns at w = sum of a_i dq_i, whose rate of change is at most the sum of |w_{i-1}| |dq_i|, and the far end
of a link of length r that turns at w accelerates by at most r (|w'| + |w|^2).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pinposture.kernels.arrays import (
    BLOCK,
    JOINT,
    SOLID,
    Array1,
    Array2,
    Array3,
    Contacts,
    Flags1,
    Ints1,
    Joints,
    MotionSearch,
    Pairs,
    Three,
)
from pinposture.kernels.collision import (
    Contact,
    bound_blocks,
    frame_axis,
    group_bound,
    pair_bound,
    pair_contact,
    place_axes,
    place_joints,
)
from pinposture.kernels.compiled import compiled, inlined, subkernel


class MotionHalving(NamedTuple):
    """How motions are halved to find the smallest distance on them."""

    max_depth: int = 60
    """Largest number of halvings of a motion."""

    many_pairs: int = 100
    """Number of remaining pairs above which both halves of a motion are examined anew, by groups."""

    measured_share: float = 0.5
    """Room of a pair by bounding shapes, relative to its motion, from which on the pair is measured. Those
    with less wait for the halves of the motion. Half or twice of both numbers hardly matters
    (`distances.md`)."""


HALVING = MotionHalving()

Arm = tuple[Joints, Ints1, Array3]
"""The joints, the frame that carries each body, and the ends of the axes of the bodies in it."""

Placed = tuple[Array3, Array2, Array3]
"""Orientations and origins of the frames, and ends of the axes of bodies, world frame."""

Sample = tuple[int, float, float, int, float, float]
"""A row of `open_samples` of `smallest_distance_on_motions`."""


@compiled
def smallest_distance_on_motions(
    joints: Joints,
    carriers: Ints1,
    local: Array3,
    pairs: Pairs,
    positions: Array2,
    others: Array2,
    drifts: Array2,
    search: MotionSearch,
    at_ends: Array2,
    open_samples: Array2,
) -> tuple[float, int, int]:
    """Find the smallest distance on straight motions from each configuration to the next.

    Args:
        joints: the joints.
        carriers: the frame that carries each body, (b,).
        local: ends of the axes of the bodies in these frames, (b, 2, 3).
        pairs: the pairs.
        positions: joint positions at the ends of the motions, (N + 1, nv).
        others: placements of the joints that move otherwise, but not on this motion, as in `place_joints`.
        drifts: additional translation of the arm, (N + 1, 3).
        search: settings of the search.
        at_ends: lower bounds of the distances of all pairs at both ends of a single motion, none of which is
            below, (2, n); or empty, (2, 0).
        open_samples: filled with the open places: index of the motion, fraction along it, half the open range
            around that, the pair, its motion there, and a lower bound of its distance there, (k, 6).

    Returns:
        The smallest distance found for exact pairs, and its pair: inf and -1 if there is none below; and the
        number of open samples, of which those beyond k were not stored.
    """
    count = len(joints.kinds) + 1
    bodies = len(carriers)
    arm = (joints, carriers, local)
    ends = np.empty(local.shape)
    blocks = np.empty((-(-bodies // BLOCK), 4))
    placed = np.empty((count, 3, 3)), np.empty((count, 3)), ends
    move = np.empty(positions.shape[1])
    at = np.empty(positions.shape[1])
    drift = np.empty(3)
    here = np.empty(3)
    bounds = np.empty((count, 9)), np.empty(bodies), np.empty(len(blocks))
    below, enough, tolerance, open_motion = search
    known = at_ends.shape[1] > 0
    stack = np.empty(1024, dtype=np.int64)
    rooms = np.empty((1024, 3))  # lower bounds of distances at the begin, the middle and the end
    begins = np.zeros(HALVING.max_depth + 2, dtype=np.int64)
    right = np.zeros(HALVING.max_depth + 1, dtype=np.bool_)
    crowded = np.zeros(HALVING.max_depth + 1, dtype=np.bool_)
    best = np.inf
    best_pair = -1
    opened = 0
    pieces = len(positions) - 1
    stride = _spread(pieces)
    for turn in range(pieces):
        piece = turn * stride % pieces
        for u in range(len(move)):
            move[u] = positions[piece + 1, u] - positions[piece, u]
        for i in range(3):
            drift[i] = drifts[piece + 1, i] - drifts[piece, i]
        depth = 0
        low = 0.0
        width = 1.0
        while True:
            middle = low + 0.5 * width
            half = 0.5 * width
            for u in range(len(at)):
                at[u] = positions[piece, u] + middle * move[u]
            for i in range(3):
                here[i] = drifts[piece, i] + middle * drift[i]
            _place_bodies(arm, at, others, here, placed)
            _bound_motions(arm, placed, move, drift, half, bounds)
            anew = depth == 0 or crowded[depth - 1]
            if anew:
                bound_blocks(ends, pairs, blocks)
                _bound_block_motions(bounds[1], bounds[2])
            first = begins[depth]
            last = begins[depth]
            groups = len(pairs.groups) if anew else 1
            for group in range(groups):
                if anew and last - first > HALVING.many_pairs:  # most of them soon drop out again, by groups
                    break
                if anew:
                    begin = pairs.starts[group]
                    stop = pairs.starts[group + 1]
                    reach = bounds[2][pairs.groups[group, 0]]
                    if pairs.groups[group, 1] < len(blocks):
                        reach += bounds[2][pairs.groups[group, 1]]
                    if group_bound(blocks, pairs, group) - reach >= min(below, best):
                        continue
                else:
                    begin = begins[depth - 1]
                    stop = begins[depth]
                for entry in range(begin, stop):
                    pair = entry if anew else stack[entry]
                    # The ends of a motion must be exact: remaining pairs are measured there.
                    aim = min(below, best) - (tolerance if depth > 0 else 0.0)
                    moved = bounds[1][pairs.first[pair]]
                    other = pairs.second[pair]
                    room = -np.inf, -np.inf
                    if not anew:
                        side = 1 if right[depth] else 0
                        room = rooms[entry, side], rooms[entry, side + 1]
                    elif depth == 0 and known:
                        room = at_ends[0, pair], at_ends[1, pair]
                    between = 0.5 * (room[0] + room[1])
                    if other < bodies:
                        moved += bounds[1][other]
                    if between - moved >= aim:
                        continue
                    lower = pair_bound(ends, pairs, pair)
                    if other < bodies and lower - moved < aim:
                        near = pairs.first[pair]
                        far = other
                        if carriers[near] > carriers[far]:
                            near, far = far, near
                        apart = _relative_motion(arm, placed, move, half, far, near)
                        moved = min(moved, apart)
                    if max(lower, between) - moved >= aim:
                        continue
                    waits = lower >= min(below, best) and lower - aim < HALVING.measured_share * moved
                    if waits and pairs.exact[pair]:
                        stack, rooms, last = _push(stack, rooms, last, pair, (room[0], lower, room[1]))
                        continue
                    contact = pair_contact(ends, pairs, pair, aim + moved)
                    distance = contact[0]
                    if pairs.exact[pair]:
                        if distance < min(below, best):
                            best = distance
                            best_pair = pair
                            if best < enough:
                                return best, best_pair, opened
                            aim = best - (tolerance if depth > 0 else 0.0)
                    elif distance < min(below, best) and moved <= open_motion:
                        bound = distance - moved
                        sample = piece, middle, half, pair, moved, bound
                        opened = _leave_open(open_samples, opened, sample)
                        if depth == 0:
                            opened = _leave_open(open_samples, opened, (piece, 1.0, 0.0, pair, 0.0, bound))
                        continue
                    if distance - moved < aim and moved > 0.0:
                        if _stays_behind(arm, placed, bounds[0], half, pairs, pair, contact, aim):
                            continue
                        stack, rooms, last = _push(stack, rooms, last, pair, (room[0], distance, room[1]))
            crowded[depth] = anew and last - first > HALVING.many_pairs
            if depth == 0 and last > 0 and not known:
                end = positions[piece + 1], drifts[piece + 1]
                _place_bodies(arm, end[0], others, end[1], placed)
                for entry in range(len(pairs.first) if crowded[0] else last):
                    pair = entry if crowded[0] else stack[entry]
                    distance = pair_bound(ends, pairs, pair)
                    if distance < min(below, best):
                        distance = pair_contact(ends, pairs, pair, min(below, best))[0]
                    if not crowded[0]:
                        rooms[entry, 2] = min(distance, below, best)  # it may not be exact beyond
                    if distance >= min(below, best):
                        continue
                    if pairs.exact[pair]:
                        best = distance
                        best_pair = pair
                        if best < enough:
                            return best, best_pair, opened
                    else:
                        opened = _leave_open(open_samples, opened, (piece, 1.0, 0.0, pair, 0.0, distance))
            if last > first and depth < HALVING.max_depth:  # the first half, for the remaining pairs
                if crowded[depth]:
                    last = first
                depth += 1
                begins[depth] = last
                right[depth] = False
                width = half
                continue
            while depth > 0 and right[depth]:  # both halves are done
                depth -= 1
                low = low - width
                width = 2.0 * width
            if depth == 0:
                break
            right[depth] = True
            low = low + width
    return best, best_pair, opened


@compiled
def check_motions(
    joints: Joints,
    carriers: Ints1,
    local: Array3,
    pairs: Pairs,
    positions: Array2,
    others: Array2,
    search: MotionSearch,
    contacts: Contacts,
    clear: Flags1,
    opened: Flags1,
) -> None:
    """Find out which straight motions keep a distance, each by itself; see `smallest_distance_on_motions`.

    Args:
        joints: the joints.
        carriers: as there.
        local: as there.
        pairs: the pairs.
        positions: joint positions at the ends of the motions, (N + 1, nv).
        others: as there.
        search: settings of the search; `below` is the distance.
        contacts: of the ends of the motions, as from `contacts_along`.
        clear: whether a motion is to be checked; filled with whether exact pairs keep the distance, (N,).
        opened: filled with whether inexact pairs are left open, (N,).
    """
    still = np.zeros((2, 3))
    nothing = np.empty((0, 6))
    begins = np.searchsorted(contacts.samples, np.arange(len(clear) + 2))
    at_ends = np.full((2, len(pairs.first)), contacts.within)
    for piece in range(len(clear)):
        opened[piece] = False
        for end in range(2):
            for row in range(begins[piece + end], begins[piece + end + 1]):
                at_ends[end, contacts.pairs[row]] = contacts.distances[row]
                if contacts.distances[row] < search.below and pairs.exact[contacts.pairs[row]]:
                    clear[piece] = False
        if clear[piece]:
            distance, _, count = smallest_distance_on_motions(
                joints,
                carriers,
                local,
                pairs,
                positions[piece : piece + 2],
                others,
                still,
                search,
                at_ends,
                nothing,
            )
            clear[piece] = distance >= search.below
            opened[piece] = clear[piece] and count > 0
        for end in range(2):
            for row in range(begins[piece + end], begins[piece + end + 1]):
                at_ends[end, contacts.pairs[row]] = contacts.within


@inlined
def _push(stack: Ints1, rooms: Array2, count: int, pair: int, room: Three) -> tuple[Ints1, Array2, int]:
    """Store a pair and its room, in longer arrays if need be; return the arrays and the number of pairs."""
    if count == len(stack):
        longer = np.empty(2 * count, dtype=np.int64)
        longer[:count] = stack
        stack = longer
        more = np.empty((2 * count, 3))
        more[:count] = rooms
        rooms = more
    stack[count] = pair
    rooms[count, 0], rooms[count, 1], rooms[count, 2] = room
    return stack, rooms, count + 1


@subkernel
def _leave_open(samples: Array2, count: int, sample: Sample) -> int:
    """Store a sample if there is room for it; return the number of samples."""
    if count < len(samples):
        own = samples[count]
        own[0], own[1], own[2], own[3], own[4], own[5] = sample
    return count + 1


@subkernel
def _place_bodies(arm: Arm, positions: Array1, others: Array2, drift: Array1, placed: Placed) -> None:
    """Place joints and bodies at a configuration of an arm with an additional translation."""
    joints, carriers, local = arm
    rotations, origins, ends = placed
    count = len(origins)
    turns = rotations.reshape((1, count, 3, 3))
    places = origins.reshape((1, count, 3))
    here = positions.reshape((1, len(positions)))
    place_joints(joints, here, others.reshape((1, len(others), 12)), turns, places)
    for frame in range(len(origins)):
        for i in range(3):
            origins[frame, i] += drift[i]
    place_axes(carriers, local, turns, places, ends.reshape((1, len(carriers), 2, 3)))


@subkernel
def _spread(count: int) -> int:
    """Return a stride that visits all of `count` places, far apart at first."""
    stride = max(int(0.618 * count), 1)
    while True:
        a = count
        b = stride
        while b:
            a, b = b, a % b
        if a == 1:
            return stride
        stride += 1


Motions = tuple[Array2, Array1, Array1]
"""Motion of frames: velocity of the origin, angular velocity, bounds of the acceleration of the origin and of
angular speed and acceleration; and bounds of the motion of bodies and of blocks."""


@subkernel
def _bound_motions(
    arm: Arm, placed: Placed, move: Array1, drift: Array1, half: float, bounds: Motions
) -> None:
    """Fill in the motion of frames, and bounds of how far bodies move until either end."""
    joints, carriers, _ = arm
    rotations, origins, ends = placed
    frames = bounds[0]
    turned = np.empty(len(frames))  # sums of |dq|
    for i in range(9):
        frames[0, i] = drift[i] if i < 3 else 0.0
    turned[0] = 0.0
    for frame in range(1, len(frames)):
        u = frame - 1
        p = joints.parents[u]
        own = frames[frame]
        v = frames[p]
        origin = origins[frame]
        before = origins[p]
        x, y, z = _difference(origin, before)
        own[0] = v[0] + v[4] * z - v[5] * y
        own[1] = v[1] + v[5] * x - v[3] * z
        own[2] = v[2] + v[3] * y - v[4] * x
        own[3] = v[3]
        own[4] = v[4]
        own[5] = v[5]
        length = np.sqrt(x * x + y * y + z * z)
        spin = v[7]  # bound of the angular speed
        speed_up = v[8]  # bound of the angular acceleration
        size = 0.0
        slides = joints.kinds[u] == JOINT.prismatic
        if joints.kinds[u] != JOINT.other:
            dq = joints.ratios[u] * move[joints.columns[u]]
            ax, ay, az = frame_axis(joints, u, rotations[frame])
            size = abs(dq)
            at = 0 if slides else 3
            own[at] += ax * dq
            own[at + 1] += ay * dq
            own[at + 2] += az * dq
        own[6] = v[6]
        if slides:
            own[6] += (length + half * size) * (speed_up + spin * spin) + 2.0 * spin * size
            size = 0.0
        else:
            own[6] += length * (speed_up + spin * spin)
        turned[frame] = turned[p] + size
        own[8] = speed_up + spin * size
        now = np.sqrt(own[3] ** 2 + own[4] ** 2 + own[5] ** 2)
        own[7] = min(turned[frame], now + half * min(own[8], 0.5 * turned[frame] ** 2))
    for body in range(len(carriers)):
        frame = carriers[body]
        most = 0.0
        own = frames[frame]
        origin = origins[frame]
        for end in range(2):
            x, y, z = _difference(ends[body, end], origin)
            vx = own[0] + own[4] * z - own[5] * y
            vy = own[1] + own[5] * x - own[3] * z
            vz = own[2] + own[3] * y - own[4] * x
            acceleration = own[6] + np.sqrt(x * x + y * y + z * z) * (own[8] + own[7] * own[7])
            speed = np.sqrt(vx * vx + vy * vy + vz * vz)
            most = max(most, half * speed + 0.5 * half * half * acceleration)
        bounds[1][body] = most


@subkernel
def _stays_behind(
    arm: Arm,
    placed: Placed,
    frames: Array2,
    half: float,
    pairs: Pairs,
    pair: int,
    contact: Contact,
    aim: float,
) -> bool:
    """Return whether a convex obstacle stays behind a plane at a distance from a body until either end."""
    _, carriers, _ = arm
    _, origins, ends = placed
    distance, px, py, pz, nx, ny, nz = contact
    body = pairs.first[pair]
    if pairs.second[pair] < len(carriers) or pairs.kinds[pair] in (SOLID.piece, SOLID.inside):
        return False
    # Depths of overlap may be those along other directions.
    if aim + pairs.radii[body] + pairs.radii[pairs.second[pair]] <= 0.0 or nx == ny == nz == 0.0:
        return False
    own = frames[carriers[body]]
    origin = origins[carriers[body]]
    for end in range(2):
        x, y, z = _difference(ends[body, end], origin)
        speed = nx * (own[0] + own[4] * z - own[5] * y)
        speed += ny * (own[1] + own[5] * x - own[3] * z)
        speed += nz * (own[2] + own[3] * y - own[4] * x)
        acceleration = own[6] + np.sqrt(x * x + y * y + z * z) * (own[8] + own[7] * own[7])
        beyond = nx * (ends[body, end, 0] - px) + ny * (ends[body, end, 1] - py)
        beyond += nz * (ends[body, end, 2] - pz)
        if distance + beyond - half * (abs(speed) + 0.5 * half * acceleration) < aim:
            return False
    return True


@subkernel
def _bound_block_motions(bodies: Array1, blocks: Array1) -> None:
    """Fill in the largest motion bound of the bodies of each block."""
    for block in range(len(blocks)):
        blocks[block] = 0.0
        for body in range(block * BLOCK, min(block * BLOCK + BLOCK, len(bodies))):
            blocks[block] = max(blocks[block], bodies[body])


@subkernel
def _relative_motion(arm: Arm, placed: Placed, move: Array1, half: float, one: int, other: int) -> float:
    """Bound the motion of a body relative to another one nearer to the base until either end of a motion.

    Infinite if the other does not carry it, or if joints slide between them.
    """
    joints, carriers, _ = arm
    rotations, origins, ends = placed
    base = carriers[other]
    frame = carriers[one]
    far = origins[frame]
    velocity = np.zeros((2, 3))
    turned = 0.0
    length = 0.0
    while frame > base:
        u = frame - 1
        origin = origins[frame]
        length += np.sqrt((far[0] - origin[0]) ** 2 + (far[1] - origin[1]) ** 2 + (far[2] - origin[2]) ** 2)
        far = origin
        if joints.kinds[u] != JOINT.other:
            dq = joints.ratios[u] * move[joints.columns[u]]
            if joints.kinds[u] == JOINT.prismatic and dq != 0.0:
                return np.inf
            turned += abs(dq)
            ax, ay, az = frame_axis(joints, u, rotations[frame])
            wx = dq * ax
            wy = dq * ay
            wz = dq * az
            for end in range(2):
                x, y, z = _difference(ends[one, end], origin)
                velocity[end, 0] += wy * z - wz * y
                velocity[end, 1] += wz * x - wx * z
                velocity[end, 2] += wx * y - wy * x
        frame = joints.parents[u]
    if frame != base:
        return np.inf
    most = 0.0
    origin = origins[carriers[one]]
    for end in range(2):
        x, y, z = _difference(ends[one, end], origin)
        acceleration = 1.5 * turned * turned * (length + np.sqrt(x * x + y * y + z * z))
        speed = np.sqrt(velocity[end, 0] ** 2 + velocity[end, 1] ** 2 + velocity[end, 2] ** 2)
        most = max(most, half * speed + 0.5 * half * half * acceleration)
    return most


@inlined
def _difference(one: Array1, other: Array1) -> tuple[float, float, float]:
    return one[0] - other[0], one[1] - other[1], one[2] - other[2]
