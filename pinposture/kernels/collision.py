"""Distances of the bodies of an arm from obstacles and from each other.

A body is a capsule, or enclosed in one: an axis between two ends, and a radius. Distances of capsules from
spheres, capsules, boxes, half-spaces and cylinders have closed forms; those from scans and meshes are found
by search in trees. If solids overlap, the distance is the negative length of a translation that separates
them: the shortest one, except for cylinders, where only translations along and across their axes are
considered, so the distance is never larger than the true one. Distances from a surface are the same on both
sides; an axis that crosses it is separated along the normal of a triangle, to the nearer side.

Pairs are sorted into groups of a block of bodies and another block, or an obstacle. Bounding spheres of
blocks decide which groups are evaluated.
"""

from __future__ import annotations

import numpy as np

from pinposture.kernels.arrays import (
    BLOCK,
    JOINT,
    SOLID,
    Array1,
    Array2,
    Array3,
    Array4,
    Contacts,
    Ints1,
    Ints2,
    Joints,
    Pairs,
    Three,
)
from pinposture.kernels.bounding_volumes import (
    SEGMENT,
    is_inside,
    nearest_in_tree,
    way_to_segment,
)
from pinposture.kernels.compiled import compiled, inlined, subkernel
from pinposture.kernels.kinematics import (
    BASE,
    carried,
    carried_on,
    load_frame,
    store_frame,
    turn_row,
)

Contact = tuple[float, float, float, float, float, float, float]


@compiled
def place_joints(
    joints: Joints, positions: Array2, others: Array3, rotations: Array4, origins: Array3
) -> None:
    """Compute the forward kinematics of all joints of a model, at several configurations.

    Args:
        joints: the joints.
        positions: joint positions, (s, nv).
        others: placements of the joints that move otherwise in the frames at their places with all joints at
            zero, rotation and translation, (s, number of them, 12).
        rotations: filled with the orientations of the frames, (s, k + 1, 3, 3).
        origins: filled with their origins, (s, k + 1, 3).
    """
    for at in range(len(positions)):
        turns = rotations[at]
        places = origins[at]
        store_frame(BASE, turns[0], places[0])
        number = 0
        for u in range(len(joints.kinds)):
            parent = joints.parents[u]
            frame = load_frame(turns[parent], places[parent])
            kind = joints.kinds[u]
            if kind == JOINT.other:
                o = joints.offsets[u]
                m = others[at, number]
                number += 1
                x, y, z = carried(frame, o[0] + m[9], o[1] + m[10], o[2] + m[11])
                turn = (m[0], m[1], m[2], m[3], m[4], m[5], m[6], m[7], m[8])
                r00, r01, r02 = turn_row(frame[0], frame[1], frame[2], turn)
                r10, r11, r12 = turn_row(frame[3], frame[4], frame[5], turn)
                r20, r21, r22 = turn_row(frame[6], frame[7], frame[8], turn)
                frame = (r00, r01, r02, r10, r11, r12, r20, r21, r22, x, y, z)
            else:
                q = joints.ratios[u] * positions[at, joints.columns[u]]
                cosine = q if kind == JOINT.prismatic else np.cos(q)
                sine = 0.0 if kind == JOINT.prismatic else np.sin(q)
                frame, _ = carried_on(joints, u, cosine, sine, frame)
            store_frame(frame, turns[u + 1], places[u + 1])


@inlined
def frame_axis(joints: Joints, u: int, turn: Array2) -> Three:
    """Return the axis of a joint, world frame, given the orientation of the frame that it carries."""
    x = joints.axes[u, 0]
    y = joints.axes[u, 1]
    z = joints.axes[u, 2]
    return (
        turn[0, 0] * x + turn[0, 1] * y + turn[0, 2] * z,
        turn[1, 0] * x + turn[1, 1] * y + turn[1, 2] * z,
        turn[2, 0] * x + turn[2, 1] * y + turn[2, 2] * z,
    )


@compiled
def place_axes(carriers: Ints1, local: Array3, rotations: Array4, origins: Array3, ends: Array4) -> None:
    """Place the axes of bodies.

    Args:
        carriers: the frame that carries each body, (b,).
        local: ends of the axes in these frames, (b, 2, 3).
        rotations: orientations of the frames, (s, k + 1, 3, 3).
        origins: their origins, (s, k + 1, 3).
        ends: filled with the ends, (s, b, 2, 3), world frame.
    """
    for at in range(len(rotations)):
        for body in range(len(carriers)):
            frame = load_frame(rotations[at, carriers[body]], origins[at, carriers[body]])
            for end in range(2):
                x, y, z = carried(frame, local[body, end, 0], local[body, end, 1], local[body, end, 2])
                ends[at, body, end, 0] = x
                ends[at, body, end, 1] = y
                ends[at, body, end, 2] = z


@compiled
def differentiate_distances(
    joints: Joints,
    rotations: Array3,
    origins: Array2,
    first: Ints1,
    second: Ints1,
    points: Array2,
    normals: Array2,
    jacobian: Array2,
) -> None:
    """Compute the derivatives of distances by joint positions: d/dq of n . p for each joint that moves p.

    Args:
        joints: the joints.
        rotations: orientations of the frames, (k + 1, 3, 3).
        origins: their origins, (k + 1, 3).
        first: the frame that carries the first body of each contact, (c,).
        second: that of the second; 0 for an obstacle, (c,).
        points: the contacts, (c, 3).
        normals: unit vectors from the second body to the first, (c, 3).
        jacobian: zeros, filled with the derivatives, (c, nv); columns of joints that move otherwise stay
            zero.
    """
    for k in range(len(first)):
        nx = normals[k, 0]
        ny = normals[k, 1]
        nz = normals[k, 2]
        for side in range(2):
            frame, sign = (first[k], 1.0) if side == 0 else (second[k], -1.0)
            while frame > 0:
                u = frame - 1
                if joints.kinds[u] != JOINT.other:
                    ax, ay, az = frame_axis(joints, u, rotations[frame])
                    if joints.kinds[u] == JOINT.prismatic:
                        moved = nx * ax + ny * ay + nz * az
                    else:
                        x = points[k, 0] - origins[frame, 0]
                        y = points[k, 1] - origins[frame, 1]
                        z = points[k, 2] - origins[frame, 2]
                        moved = nx * (ay * z - az * y) + ny * (az * x - ax * z) + nz * (ax * y - ay * x)
                    jacobian[k, joints.columns[u]] += sign * joints.ratios[u] * moved
                frame = joints.parents[u]


# One pair: distance of the surfaces, point on the axis of the first solid, normal from the second.


@inlined
def pair_contact(ends: Array3, pairs: Pairs, pair: int, below: float) -> Contact:
    """Compute distance, point on the first axis and normal of a pair; the normal is 0 if undefined.

    The distance from a tree may be infinite if it is not smaller than `below`.
    """
    body = pairs.first[pair]
    other = pairs.second[pair] - len(ends)
    line = ends[body]
    kind = pairs.kinds[pair]
    radius = pairs.radii[body] + pairs.radii[pairs.second[pair]]
    if kind == SOLID.segment:
        against = ends[other + len(ends)] if other < 0 else pairs.lines[other]
        distance, px, py, pz, nx, ny, nz = _segment_contact(line, against)
    elif kind == SOLID.box:
        found = _box_contact(line, pairs.centers[other], pairs.frames[other], pairs.halves[other])
        distance, px, py, pz, nx, ny, nz = found
    elif kind == SOLID.plane:
        frame = pairs.frames[other]
        center = pairs.centers[other]
        nx = frame[0, 2]
        ny = frame[1, 2]
        nz = frame[2, 2]
        heights = (
            nx * (line[0, 0] - center[0]) + ny * (line[0, 1] - center[1]) + nz * (line[0, 2] - center[2]),
            nx * (line[1, 0] - center[0]) + ny * (line[1, 1] - center[1]) + nz * (line[1, 2] - center[2]),
        )
        end = 0 if heights[0] <= heights[1] else 1
        distance = heights[end]
        px = line[end, 0]
        py = line[end, 1]
        pz = line[end, 2]
    elif kind in (SOLID.piece, SOLID.inside):
        found = _tree_contact(line, pairs, other, kind == SOLID.inside, below + radius)
        distance, px, py, pz, nx, ny, nz = found
    else:
        found = _cylinder_contact(line, pairs.centers[other], pairs.frames[other], pairs.halves[other])
        distance, px, py, pz, nx, ny, nz = found
    return distance - radius, px, py, pz, nx, ny, nz


@subkernel
def _segment_contact(line: Array2, other: Array2) -> Contact:
    ux = line[1, 0] - line[0, 0]
    uy = line[1, 1] - line[0, 1]
    uz = line[1, 2] - line[0, 2]
    vx = other[1, 0] - other[0, 0]
    vy = other[1, 1] - other[0, 1]
    vz = other[1, 2] - other[0, 2]
    rx = line[0, 0] - other[0, 0]
    ry = line[0, 1] - other[0, 1]
    rz = line[0, 2] - other[0, 2]
    s, gx, gy, gz = way_to_segment(rx, ry, rz, ux, uy, uz, vx, vy, vz)
    px = line[0, 0] + s * ux
    py = line[0, 1] + s * uy
    pz = line[0, 2] + s * uz
    size = np.sqrt(gx * gx + gy * gy + gz * gz)
    if size * size <= SEGMENT.meeting_squared * (rx * rx + ry * ry + rz * rz + ux * ux + uy * uy + uz * uz):
        return 0.0, px, py, pz, 0.0, 0.0, 0.0
    return size, px, py, pz, gx / size, gy / size, gz / size


@subkernel
def _contact_at(
    line: Array2, t: float, frame: Array2, distance: float, nx: float, ny: float, nz: float
) -> Contact:
    """Return the contact at a place on a line, from 0 to 1, with a normal given in a frame."""
    return (
        distance,
        line[0, 0] + t * (line[1, 0] - line[0, 0]),
        line[0, 1] + t * (line[1, 1] - line[0, 1]),
        line[0, 2] + t * (line[1, 2] - line[0, 2]),
        frame[0, 0] * nx + frame[0, 1] * ny + frame[0, 2] * nz,
        frame[1, 0] * nx + frame[1, 1] * ny + frame[1, 2] * nz,
        frame[2, 0] * nx + frame[2, 1] * ny + frame[2, 2] * nz,
    )


@subkernel
def _to_frame(line: Array2, center: Array1, frame: Array2, start: Array1, way: Array1) -> None:
    """Fill in the start of a line and the vector to its end, in a frame."""
    for axis in range(3):
        start[axis] = 0.0
        way[axis] = 0.0
        for i in range(3):
            start[axis] += frame[i, axis] * (line[0, i] - center[i])
            way[axis] += frame[i, axis] * (line[1, i] - line[0, i])


@subkernel
def _box_slope(start: Array1, way: Array1, half: Array1, t: float) -> float:
    """Return half the derivative of the squared distance from a box along a line; it never decreases."""
    slope = 0.0
    rounding = 0.0
    for axis in range(3):
        at = start[axis] + t * way[axis]
        rounding += (abs(start[axis]) + half[axis]) * abs(way[axis])
        if at > half[axis]:
            slope += (at - half[axis]) * way[axis]
        elif at < -half[axis]:
            slope += (at + half[axis]) * way[axis]
    return slope if abs(slope) > 1e-13 * rounding else 0.0  # less is rounding


@subkernel
def _nearest_to_box(start: Array1, way: Array1, half: Array1) -> float:
    """Return the place in [0, 1] on a line nearest to a box; the middle of the range if not unique.

    Between places where a coordinate enters or leaves the box, the slope is linear.
    """
    places = np.empty(8)
    count = 2
    places[0] = 0.0
    places[1] = 1.0
    for axis in range(3):
        if way[axis] != 0.0:
            for side in (-1.0, 1.0):
                t = (side * half[axis] - start[axis]) / way[axis]
                if 0.0 < t < 1.0:
                    places[count] = t
                    count += 1
    places = np.sort(places[:count])
    left = 0.0
    before = _box_slope(start, way, half, 0.0)
    first = -1.0
    if before > 0.0:
        return 0.0
    for k in range(1, count):
        right = places[k]
        after = _box_slope(start, way, half, right)
        if before == 0.0:
            first = left if first < 0.0 else first
            if after > 0.0:
                return 0.5 * (first + left)
        elif after > 0.0:
            return left + (right - left) * (before / (before - after))
        left = right
        before = after
    return 0.5 * (first + 1.0) if before == 0.0 and first >= 0.0 else 1.0


@subkernel
def _box_contact(line: Array2, center: Array1, frame: Array2, half: Array1) -> Contact:
    start = np.empty(3)
    way = np.empty(3)
    normal = np.zeros(3)
    _to_frame(line, center, frame, start, way)
    t = _nearest_to_box(start, way, half)
    squares = 0.0
    for axis in range(3):
        at = start[axis] + t * way[axis]
        normal[axis] = at - min(max(at, -half[axis]), half[axis])
        squares += normal[axis] * normal[axis]
    size = max(half[0], half[1], half[2])
    if squares > (1e-14 * size) ** 2:
        distance = np.sqrt(squares)
        for axis in range(3):
            normal[axis] /= distance
    else:
        distance, t = _leave_box(start, way, half, t, normal)
    return _contact_at(line, t, frame, distance, normal[0], normal[1], normal[2])


@subkernel
def _leave_box(
    start: Array1, way: Array1, half: Array1, inside: float, normal: Array1
) -> tuple[float, float]:
    """Find the shortest translation of a line out of a box: its negative length, and the deepest place.

    The Minkowski sum of line and box is a polytope, whose face normals are normals of the box, or
    perpendicular to an edge of the box and the line. Fills in the normal.
    """
    deepest = -np.inf
    place = inside
    for axis in range(3):
        a = start[axis]
        b = start[axis] + way[axis]
        for side in (1.0, -1.0):
            lowest = min(side * a, side * b)
            if lowest - half[axis] > deepest:
                deepest = lowest - half[axis]
                place = inside if way[axis] == 0.0 else (0.0 if side * a < side * b else 1.0)
                normal[:] = 0.0
                normal[axis] = side
    length = np.sqrt(way[0] * way[0] + way[1] * way[1] + way[2] * way[2])
    for axis in range(3):
        j = (axis + 1) % 3
        k = (axis + 2) % 3
        size = np.sqrt(way[j] * way[j] + way[k] * way[k])
        if size <= 1e-9 * length or length == 0.0:
            continue
        nj = -way[k] / size
        nk = way[j] / size
        height = nj * start[j] + nk * start[k]
        if height < 0.0:
            nj = -nj
            nk = -nk
            height = -height
        depth = height - half[j] * abs(nj) - half[k] * abs(nk)
        if depth > deepest:
            deepest = depth
            place = inside
            normal[axis] = 0.0
            normal[j] = nj
            normal[k] = nk
    return deepest, place


@inlined
def _tree_contact(line: Array2, pairs: Pairs, obstacle: int, inside: bool, below: float) -> Contact:
    """Compute the contact of a line with a piece of a tree, or with a closed surface that contains it."""
    frame = pairs.frames[obstacle]
    center = pairs.centers[obstacle]
    trees = pairs.trees
    piece = trees.boxes[trees.pieces[obstacle, 0] + trees.pieces[obstacle, 1]]
    x = line[0, 0] - center[0]
    y = line[0, 1] - center[1]
    z = line[0, 2] - center[2]
    ax = frame[0, 0] * x + frame[1, 0] * y + frame[2, 0] * z + 0.5 * (piece[0, 0] + piece[1, 0])
    ay = frame[0, 1] * x + frame[1, 1] * y + frame[2, 1] * z + 0.5 * (piece[0, 1] + piece[1, 1])
    az = frame[0, 2] * x + frame[1, 2] * y + frame[2, 2] * z + 0.5 * (piece[0, 2] + piece[1, 2])
    x = line[1, 0] - line[0, 0]
    y = line[1, 1] - line[0, 1]
    z = line[1, 2] - line[0, 2]
    bx = ax + frame[0, 0] * x + frame[1, 0] * y + frame[2, 0] * z
    by = ay + frame[0, 1] * x + frame[1, 1] * y + frame[2, 1] * z
    bz = az + frame[0, 2] * x + frame[1, 2] * y + frame[2, 2] * z
    if inside:
        if not is_inside(ax, ay, az, trees, obstacle):
            return np.inf, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        distance, t, nx, ny, nz = nearest_in_tree((ax, ay, az), (bx, by, bz), trees, obstacle, np.inf)
        if distance <= 0.0:  # it crosses the surface, so pieces of the surface report the contact
            return np.inf, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        distance = -distance
        nx = -nx
        ny = -ny
        nz = -nz
    else:
        distance, t, nx, ny, nz = nearest_in_tree((ax, ay, az), (bx, by, bz), trees, obstacle, below)
    return _contact_at(line, t, frame, distance, nx, ny, nz)


@subkernel
def _cylinder_slope(start: Array1, way: Array1, half: Array1, t: float) -> float:
    """Return half the derivative of the squared distance from a cylinder along z, along a line."""
    x = start[0] + t * way[0]
    y = start[1] + t * way[1]
    z = start[2] + t * way[2]
    slope = 0.0
    across = np.sqrt(x * x + y * y)
    if across > half[0]:
        slope += (across - half[0]) * (x * way[0] + y * way[1]) / across
    if abs(z) > half[2]:
        slope += (abs(z) - half[2]) * way[2] * (1.0 if z > 0.0 else -1.0)
    return slope


@subkernel
def _cylinder_contact(line: Array2, center: Array1, frame: Array2, half: Array1) -> Contact:
    start = np.empty(3)
    way = np.empty(3)
    _to_frame(line, center, frame, start, way)
    left = 0.0
    right = 1.0
    low = _cylinder_slope(start, way, half, 0.0)
    high = _cylinder_slope(start, way, half, 1.0)
    t = 0.0
    if low < 0.0 and high <= 0.0:
        t = 1.0
    elif low < 0.0:
        # False position with halved weights (Illinois), and bisection every third time.
        for number in range(60):  # at most
            t = 0.5 * (left + right) if number % 3 == 2 else (left * high - right * low) / (high - low)
            slope = _cylinder_slope(start, way, half, t)
            if slope < 0.0:
                left = t
                low = slope
                high = 0.5 * high
            elif slope > 0.0:
                right = t
                high = slope
                low = 0.5 * low
            else:
                break
            if right - left <= 1e-15:
                break
    x = start[0] + t * way[0]
    y = start[1] + t * way[1]
    z = start[2] + t * way[2]
    across = np.sqrt(x * x + y * y)
    out = max(across - half[0], 0.0)
    above = max(abs(z) - half[2], 0.0)
    distance = np.sqrt(out * out + above * above)
    if distance > 1e-14 * max(half[0], half[2]):
        nx = out * x / max(across, SEGMENT.tiny) / distance
        ny = out * y / max(across, SEGMENT.tiny) / distance
        nz = above / distance * (1.0 if z > 0.0 else -1.0)
    else:
        distance, t, nx, ny, nz = _leave_cylinder(start, way, half, t)
    return _contact_at(line, t, frame, distance, nx, ny, nz)


@subkernel
def _leave_cylinder(
    start: Array1, way: Array1, half: Array1, inside: float
) -> tuple[float, float, float, float, float]:
    """Find the shortest translation of a line out of a cylinder along or across its axis.

    Returns:
        Negative length, the deepest place, and the direction.
    """
    a = start[2]
    b = start[2] + way[2]
    up = min(a, b) - half[2]
    down = -max(a, b) - half[2]
    depth = max(up, down)
    nz = 1.0 if up >= down else -1.0
    place = inside if a == b else (0.0 if (a < b) == (nz > 0.0) else 1.0)
    nx = 0.0
    ny = 0.0
    # Across: the direction of the point of the line nearest to the axis.
    squares = way[0] * way[0] + way[1] * way[1]
    t = 0.5
    if squares > 0.0:
        t = min(max(-(start[0] * way[0] + start[1] * way[1]) / squares, 0.0), 1.0)
    x = start[0] + t * way[0]
    y = start[1] + t * way[1]
    across = np.sqrt(x * x + y * y)
    if across - half[0] > depth - 1e-9 * half[0]:  # if equal, prefer the one that a stretched arm can do
        depth = across - half[0]
        place = t
        nz = 0.0
        if across > 1e-12 * half[0]:
            nx = x / across
            ny = y / across
        elif squares > 0.0:
            nx = -way[1] / np.sqrt(squares)
            ny = way[0] / np.sqrt(squares)
        else:
            nx = 1.0
    return depth, place, nx, ny, nz


# All pairs: bounding spheres of blocks first.


@subkernel
def bound_blocks(ends: Array3, pairs: Pairs, blocks: Array2) -> None:
    """Fill in centre and radius of a sphere around each block of bodies, (blocks, 4)."""
    low = np.empty(3)
    high = np.empty(3)
    for block in range(len(blocks)):
        begin = block * BLOCK
        stop = min(block * BLOCK + BLOCK, len(ends))
        low[:] = np.inf
        high[:] = -np.inf
        for body in range(begin, stop):
            for end in range(2):
                for i in range(3):
                    low[i] = min(low[i], ends[body, end, i])
                    high[i] = max(high[i], ends[body, end, i])
        for i in range(3):
            blocks[block, i] = 0.5 * (low[i] + high[i])
        radius = 0.0
        for body in range(begin, stop):
            for end in range(2):
                squares = 0.0
                for i in range(3):
                    squares += (ends[body, end, i] - blocks[block, i]) ** 2
                radius = max(radius, np.sqrt(squares) + pairs.radii[body])
        blocks[block, 3] = radius


@inlined
def _axis_bound(pairs: Pairs, obstacle: int, middle: Three, way: Three) -> float:
    """Return a lower bound of the distance of an axis, given its middle and half of the way along it."""
    # Numbers are read one by one here and below: slicing an array would take as long as everything else.
    kind = pairs.shapes[obstacle]
    x, y, z = middle
    wx, wy, wz = way
    length = np.sqrt(wx * wx + wy * wy + wz * wz)
    if kind == SOLID.segment:
        lines = pairs.lines
        ux = lines[obstacle, 1, 0] - lines[obstacle, 0, 0]
        uy = lines[obstacle, 1, 1] - lines[obstacle, 0, 1]
        uz = lines[obstacle, 1, 2] - lines[obstacle, 0, 2]
        gx = x - lines[obstacle, 0, 0]
        gy = y - lines[obstacle, 0, 1]
        gz = z - lines[obstacle, 0, 2]
        t = (gx * ux + gy * uy + gz * uz) / max(ux * ux + uy * uy + uz * uz, SEGMENT.tiny)
        t = min(max(t, 0.0), 1.0)
        gx = gx - t * ux
        gy = gy - t * uy
        gz = gz - t * uz
        radius = pairs.radii[len(pairs.radii) - len(pairs.shapes) + obstacle]
        return np.sqrt(gx * gx + gy * gy + gz * gz) - radius - length
    frames = pairs.frames
    centers = pairs.centers
    x = x - centers[obstacle, 0]
    y = y - centers[obstacle, 1]
    z = z - centers[obstacle, 2]
    if kind == SOLID.plane:
        height = frames[obstacle, 0, 2] * x + frames[obstacle, 1, 2] * y + frames[obstacle, 2, 2] * z
        return height - length
    squares = 0.0
    apart = -np.inf
    inside = -np.inf
    for axis in range(3):
        a0 = frames[obstacle, 0, axis]
        a1 = frames[obstacle, 1, axis]
        a2 = frames[obstacle, 2, axis]
        beyond = abs(a0 * x + a1 * y + a2 * z) - pairs.halves[obstacle, axis]
        inside = max(inside, beyond)
        beyond = beyond - abs(a0 * wx + a1 * wy + a2 * wz)
        apart = max(apart, beyond)
        squares += max(beyond, 0.0) ** 2
    return np.sqrt(squares) if apart > 0.0 else min(inside, 0.0) - length


@inlined
def group_bound(blocks: Array2, pairs: Pairs, group: int) -> float:
    """Return a lower bound of the distances in a group."""
    block = pairs.groups[group, 0]
    other = pairs.groups[group, 1] - len(blocks)
    x = blocks[block, 0]
    y = blocks[block, 1]
    z = blocks[block, 2]
    if other >= 0:
        return _axis_bound(pairs, other, (x, y, z), (0.0, 0.0, 0.0)) - blocks[block, 3]
    other += len(blocks)
    x = x - blocks[other, 0]
    y = y - blocks[other, 1]
    z = z - blocks[other, 2]
    return np.sqrt(x * x + y * y + z * z) - blocks[block, 3] - blocks[other, 3]


@inlined
def _halves_of_axis(ends: Array3, body: int) -> tuple[Three, Three]:
    """Return the middle of the axis of a body, and half of the way along it."""
    ux = 0.5 * (ends[body, 1, 0] - ends[body, 0, 0])
    uy = 0.5 * (ends[body, 1, 1] - ends[body, 0, 1])
    uz = 0.5 * (ends[body, 1, 2] - ends[body, 0, 2])
    middle = (ends[body, 0, 0] + ux, ends[body, 0, 1] + uy, ends[body, 0, 2] + uz)
    return middle, (ux, uy, uz)


@inlined
def pair_bound(ends: Array3, pairs: Pairs, pair: int) -> float:
    """Return a lower bound of a distance: of axes from boxes, and of spheres around bodies from the rest."""
    body = pairs.first[pair]
    other = pairs.second[pair] - len(ends)
    middle, way = _halves_of_axis(ends, body)
    if other >= 0:
        return _axis_bound(pairs, other, middle, way) - pairs.radii[body]
    x, y, z = middle
    wx, wy, wz = way
    further, on = _halves_of_axis(ends, other + len(ends))
    gx, gy, gz = further
    ux, uy, uz = on
    reach = np.sqrt(wx * wx + wy * wy + wz * wz) + np.sqrt(ux * ux + uy * uy + uz * uz)
    reach += pairs.radii[body] + pairs.radii[other + len(ends)]
    return np.sqrt((gx - x) ** 2 + (gy - y) ** 2 + (gz - z) ** 2) - reach


@compiled
def near_pairs(
    ends: Array3,
    pairs: Pairs,
    within: float,
    near: Ints1,
    distances: Array1,
    points: Array2,
    normals: Array2,
    open_pairs: Ints1,
    bounds: Array1,
) -> tuple[int, int, float, int]:
    """Find the pairs nearer than a distance, and the nearest of all.

    Args:
        ends: ends of the axes of the bodies, (b, 2, 3).
        pairs: the pairs, n.
        within: the distance.
        near: filled with the near pairs, (n,).
        distances: filled with their distances, (n,).
        points: filled with the nearest points on the axes of their first bodies, (n, 3).
        normals: filled with unit vectors from their second solids; 0 if undefined, (n, 3).
        open_pairs: filled with inexact pairs that may be near or nearest, (n,).
        bounds: filled with lower bounds of their distances, (n,).

    Returns:
        Number of near pairs, number of open pairs, and the smallest distance of the exact pairs with its
        pair: inf and -1 if there is none.
    """
    blocks = np.empty(((len(ends) + BLOCK - 1) // BLOCK, 4))
    bound_blocks(ends, pairs, blocks)
    groups = len(pairs.groups)
    lower = np.empty(groups)
    nearest = 0
    for group in range(groups):
        lower[group] = group_bound(blocks, pairs, group)
        if lower[group] < lower[nearest]:
            nearest = group
    count = 0
    opened = 0
    best = np.inf
    best_pair = -1
    for turn in range(groups):
        # The nearest group comes first, so that most of the others can be skipped.
        group = nearest if turn == 0 else (0 if turn == nearest else turn)
        if lower[group] >= max(within, best):
            continue
        for pair in range(pairs.starts[group], pairs.starts[group + 1]):
            if pair_bound(ends, pairs, pair) >= max(within, best):
                continue
            distance, px, py, pz, nx, ny, nz = pair_contact(ends, pairs, pair, max(within, best))
            if not pairs.exact[pair]:
                if distance < max(within, best):
                    open_pairs[opened] = pair
                    bounds[opened] = distance
                    opened += 1
                continue
            if distance < best:
                best = distance
                best_pair = pair
            if distance < within:
                near[count] = pair
                distances[count] = distance
                points[count, 0] = px
                points[count, 1] = py
                points[count, 2] = pz
                normals[count, 0] = nx
                normals[count, 1] = ny
                normals[count, 2] = nz
                count += 1
    return count, opened, best, best_pair


@compiled
def contacts_along(
    joints: Joints,
    carriers: Ints1,
    local: Array3,
    pairs: Pairs,
    positions: Array2,
    others: Array3,
    contacts: Contacts,
) -> int:
    """Find the pairs nearer than a distance at several configurations.

    Inexact pairs are measured by their enclosing shapes.

    Args:
        joints: the joints.
        carriers: the frame that carries each body, (b,).
        local: ends of the axes of the bodies in these frames, (b, 2, 3).
        pairs: the pairs.
        positions: joint positions, (s, nv).
        others: as in `place_joints`.
        contacts: filled, but for the distance.

    Returns:
        Number of contacts; those beyond k were not stored.
    """
    count = len(joints.kinds) + 1
    bodies = len(carriers)
    room = len(contacts.samples)
    within = contacts.within
    rotations = np.empty((1, count, 3, 3))
    origins = np.empty((1, count, 3))
    axes = np.empty((1, bodies, 2, 3))
    ends = axes[0]
    blocks = np.empty(((bodies + BLOCK - 1) // BLOCK, 4))
    found = 0
    for at in range(len(positions)):
        contacts.minima[at] = within
        place_joints(joints, positions[at : at + 1], others[at : at + 1], rotations, origins)
        place_axes(carriers, local, rotations, origins, axes)
        bound_blocks(ends, pairs, blocks)
        for group in range(len(pairs.groups)):
            if group_bound(blocks, pairs, group) >= within:
                continue
            for pair in range(pairs.starts[group], pairs.starts[group + 1]):
                if pair_bound(ends, pairs, pair) >= within:
                    continue
                contact = pair_contact(ends, pairs, pair, within)
                if contact[0] >= within:
                    continue
                contacts.minima[at] = min(contacts.minima[at], contact[0])
                if found < room:
                    contacts.samples[found] = at
                    contacts.pairs[found] = pair
                    contacts.distances[found] = contact[0]
                    other = pairs.second[pair]
                    contacts.carrying[found, 0] = carriers[pairs.first[pair]]
                    contacts.carrying[found, 1] = carriers[other] if other < bodies else 0
                    for i in range(3):
                        contacts.points[found, i] = contact[1 + i]
                        contacts.normals[found, i] = contact[4 + i]
                found += 1
    return found


@compiled
def smallest_distance(
    ends: Array4, pairs: Pairs, below: float, open_pairs: Ints2, bounds: Array1
) -> tuple[float, int, int]:
    """Find the smallest distance at any of several configurations.

    Args:
        ends: ends of the axes of the bodies, (s, b, 2, 3).
        pairs: the pairs.
        below: bound of relevant distances; pairs that are not nearer may be skipped.
        open_pairs: filled with configuration and pair of inexact pairs that may be nearer, (s times the
            number of inexact pairs, 2).
        bounds: filled with lower bounds of their distances.

    Returns:
        The smallest distance of exact pairs and its pair, inf and -1 if none; and the number of open pairs.
    """
    blocks = np.empty(((ends.shape[1] + BLOCK - 1) // BLOCK, 4))
    best = np.inf
    best_pair = -1
    opened = 0
    for at in range(len(ends)):
        bound_blocks(ends[at], pairs, blocks)
        for group in range(len(pairs.groups)):
            if group_bound(blocks, pairs, group) >= min(below, best):
                continue
            for pair in range(pairs.starts[group], pairs.starts[group + 1]):
                if pair_bound(ends[at], pairs, pair) >= min(below, best):
                    continue
                distance = pair_contact(ends[at], pairs, pair, min(below, best))[0]
                if not pairs.exact[pair]:
                    if distance < min(below, best):
                        open_pairs[opened, 0] = at
                        open_pairs[opened, 1] = pair
                        bounds[opened] = distance
                        opened += 1
                elif distance < best:
                    best = distance
                    best_pair = pair
    return best, best_pair, opened
