"""Trees of boxes around points and triangles, and the distance of a line from those in a part of a tree.

A "line" is a segment. A tree is complete: node 1 is the root, and node i has the children 2 i and 2 i + 1.
Its n points or triangles are sorted so that node 2**level + k holds those from k n >> level up to (k + 1) n
>> level. A search needs no stack: bits mark the ancestors whose other child is still to be visited.

The distance of a line from a triangle that it crosses is the negative length of the shorter translation along
the normal of the triangle that separates them.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pinposture.kernels.arrays import Array1, Array2, Array3, Ints1, Three, Trees
from pinposture.kernels.compiled import compiled, inlined, subkernel


class SegmentTolerances(NamedTuple):
    """What counts as zero in distances of lines, and which of them are long."""

    tiny: float = 1e-300
    """Replaces divisors that are zero."""

    parallel_squared: float = 1e-14
    """Square of the sine of the angle below which lines count as parallel, and a triangle as a line."""

    meeting_squared: float = 1e-28
    """Square of the gap, relative to length and distance of a line, below which its direction is rounding."""

    on_edge: float = 1e-12
    """Distance beyond an edge at which a point still counts as inside, relative to the height of a
    triangle."""

    long: float = 64.0
    """Squared length above which the bounding box of a line is too loose, in squared half diagonals of a
    box."""


SEGMENT = SegmentTolerances()

Nearest = tuple[float, float, float, float, float]
"""Distance of a line, nearest place on it, from 0 to 1, and unit vector to that; 0 if undefined."""


@compiled
def build_tree(corners: Array3, order: Ints1, boxes: Array3) -> None:
    """Sort points or triangles into a tree, splitting each node along its longest side.

    Args:
        corners: corners of the triangles, or the points, (n, 3 or 1, 3).
        order: the indices from 0 to n - 1, sorted in place, (n,).
        boxes: filled with the lowest and the highest corner of the box around each node,
            (2**levels, 2, 3), with at most n nodes in the last level; the first entry is unused.
    """
    n = len(corners)
    points = corners.shape[1] == 1
    middles = np.zeros((n, 3))  # sorted with the order, so that neighbours are read one after the other
    for k in range(n):
        for corner in range(corners.shape[1]):
            for i in range(3):
                middles[k, i] += corners[k, corner, i] / corners.shape[1]
    level = 0
    first = 1
    for node in range(1, len(boxes)):
        if node == 2 * first:
            level = level + 1
            first = node
        begin = (node - first) * n >> level
        end = (node - first + 1) * n >> level
        low = boxes[node, 0]
        high = boxes[node, 1]
        for i in range(3):
            least = np.inf
            most = -np.inf
            for at in range(begin, end):
                for corner in range(corners.shape[1]):
                    value = middles[at, i] if points else corners[order[at], corner, i]
                    least = min(least, value)
                    most = max(most, value)
            low[i] = least
            high[i] = most
        if 2 * node < len(boxes):
            axis = int(np.argmax(high - low))
            _split(order, middles, axis, begin, (2 * (node - first) + 1) * n >> (level + 1), end)


@subkernel
def _split(order: Ints1, middles: Array2, axis: int, begin: int, middle: int, end: int) -> None:
    """Partition a part of the order, and of middles, so that those from `middle` on are not below others."""
    end -= 1
    while begin < end:
        pivot = middles[(begin + end) // 2, axis]
        left = begin
        right = end
        while left <= right:
            while middles[left, axis] < pivot:
                left += 1
            while middles[right, axis] > pivot:
                right -= 1
            if left <= right:
                order[left], order[right] = order[right], order[left]
                for i in range(3):
                    middles[left, i], middles[right, i] = middles[right, i], middles[left, i]
                left = left + 1
                right = right - 1
        if middle <= right:
            end = right
        elif middle >= left:
            begin = left
        else:
            return


@subkernel
def nearest_in_tree(a: Three, b: Three, trees: Trees, obstacle: int, below: float) -> Nearest:
    """Find the item of a piece of a tree nearest to a line from a to b, in the frame of the tree.

    If the line crosses triangles, the deepest crossing counts. The distance is infinite unless smaller than
    `below`.
    """
    boxes, root, levels, items, count = _piece(trees, obstacle)
    is_cloud = trees.pieces[obstacle, 5] == 1
    ax, ay, az = a
    bx, by, bz = b
    ux = bx - ax
    uy = by - ay
    uz = bz - az
    squares = ux * ux + uy * uy + uz * uz
    line = (ax, ay, az, ux, uy, uz, squares)
    best = below
    place = 0.0
    nx = 0.0
    ny = 0.0
    nz = 0.0
    found = False
    node = root
    depth = 0
    top = 0
    while root >> (top + 1) > 0:
        top += 1
    pending = 0
    while True:
        if top + depth < levels - 1:
            one = _box_bound(line, trees.boxes, boxes + 2 * node, best)
            other = _box_bound(line, trees.boxes, boxes + 2 * node + 1, best)
            if min(one, other) < best:
                node = 2 * node + (1 if other < one else 0)
                pending = 2 * pending + (1 if max(one, other) < best else 0)
                depth += 1
                continue
        else:
            level = top + depth
            begin = (node - (1 << level)) * count >> level
            end = (node - (1 << level) + 1) * count >> level
            for at in range(items + begin, items + end):
                if is_cloud:
                    near = _point_contact(line, trees.points, at, best)
                else:
                    near = _triangle_contact(line, trees.triangles, at, best)
                if near[0] < best:
                    best, place, nx, ny, nz = near
                    found = True
        advanced = False
        while pending > 0 and not advanced:
            while pending & 1 == 0:
                node = node >> 1
                pending = pending >> 1
                depth = depth - 1
            node = node ^ 1
            pending = pending ^ 1
            advanced = _box_bound(line, trees.boxes, boxes + node, best) < best
        if not advanced:
            break
    return best if found else np.inf, place, nx, ny, nz


@inlined
def _piece(trees: Trees, obstacle: int) -> tuple[int, int, int, int, int]:
    """Return the first box of a piece's tree, its node, number of levels, first item and number of items."""
    piece = trees.pieces[obstacle]
    return piece[0], piece[1], piece[2], piece[3], piece[4]


Line = tuple[float, float, float, float, float, float, float]
"""Start of a line, vector to its end, and its squared length."""


@inlined
def _box_bound(line: Line, boxes: Array3, box: int, below: float) -> float:
    """Return a lower bound of the distance of a line from the contents of a box, at most `below`."""
    ax, ay, az, ux, uy, uz, squares = line
    # Numbers are read one by one: slicing an array would take as long as everything else.
    low_x = boxes[box, 0, 0]
    low_y = boxes[box, 0, 1]
    low_z = boxes[box, 0, 2]
    high_x = boxes[box, 1, 0]
    high_y = boxes[box, 1, 1]
    high_z = boxes[box, 1, 2]
    gx = max(low_x - max(ax, ax + ux), min(ax, ax + ux) - high_x, 0.0)
    gy = max(low_y - max(ay, ay + uy), min(ay, ay + uy) - high_y, 0.0)
    gz = max(low_z - max(az, az + uz), min(az, az + uz) - high_z, 0.0)
    gap = gx * gx + gy * gy + gz * gz
    if below > 0.0 and gap >= below * below:
        return below
    bound = np.sqrt(gap)
    hx = 0.5 * (high_x - low_x)
    hy = 0.5 * (high_y - low_y)
    hz = 0.5 * (high_z - low_z)
    half = hx * hx + hy * hy + hz * hz
    if squares > SEGMENT.long * half:
        # The line may be slanted: distance of the box centre from it, less half the diagonal.
        x = low_x + hx - ax
        y = low_y + hy - ay
        z = low_z + hz - az
        t = min(max((x * ux + y * uy + z * uz) / squares, 0.0), 1.0)
        x = x - t * ux
        y = y - t * uy
        z = z - t * uz
        bound = max(bound, np.sqrt(x * x + y * y + z * z) - np.sqrt(half))
    return bound if bound > 0.0 else -np.sqrt(squares)


@inlined
def _point_contact(line: Line, points: Array2, at: int, below: float) -> Nearest:
    ax, ay, az, ux, uy, uz, squares = line
    x = ax - points[at, 0]
    y = ay - points[at, 1]
    z = az - points[at, 2]
    t = min(max(-(x * ux + y * uy + z * uz) / max(squares, SEGMENT.tiny), 0.0), 1.0)
    meeting = SEGMENT.meeting_squared * (x * x + y * y + z * z + squares)
    x = x + t * ux
    y = y + t * uy
    z = z + t * uz
    apart = x * x + y * y + z * z
    if below <= 0.0 or apart >= below * below:
        return np.inf, 0.0, 0.0, 0.0, 0.0
    size = np.sqrt(apart)
    if apart <= meeting:
        return 0.0, t, 0.0, 0.0, 0.0
    return size, t, x / size, y / size, z / size


@subkernel
def _triangle_contact(line: Line, triangles: Array3, at: int, below: float) -> Nearest:
    ax, ay, az, ux, uy, uz, squares = line
    px = triangles[at, 0, 0]
    py = triangles[at, 0, 1]
    pz = triangles[at, 0, 2]
    ex = triangles[at, 1, 0] - px
    ey = triangles[at, 1, 1] - py
    ez = triangles[at, 1, 2] - pz
    fx = triangles[at, 2, 0] - px
    fy = triangles[at, 2, 1] - py
    fz = triangles[at, 2, 2] - pz
    x = ax - px
    y = ay - py
    z = az - pz
    nx = ey * fz - ez * fy
    ny = ez * fx - ex * fz
    nz = ex * fy - ey * fx
    ee = ex * ex + ey * ey + ez * ez
    ff = fx * fx + fy * fy + fz * fz
    ef = ex * fx + ey * fy + ez * fz
    area = nx * nx + ny * ny + nz * nz
    meeting = SEGMENT.meeting_squared * (x * x + y * y + z * z + squares)
    best = below
    place = 0.0
    sx = 0.0
    sy = 0.0
    sz = 0.0
    found = False
    flat = area <= SEGMENT.parallel_squared * ee * ff
    if not flat:
        start = nx * x + ny * y + nz * z
        rise = nx * ux + ny * uy + nz * uz
        end = start + rise
        if start * end > 0.0 and below > 0.0 and min(start * start, end * end) >= below * below * area:
            return np.inf, 0.0, 0.0, 0.0, 0.0
        size = np.sqrt(area)
        nx = nx / size
        ny = ny / size
        nz = nz / size
        start = start / size
        rise = rise / size
        end = end / size
        first = 0.0 if abs(start) <= abs(end) else 1.0
        # A point of the line over the triangle: where it crosses the plane, its nearer end, or the other.
        for number in range(3):
            t = first if number == 1 else 1.0 - first
            if number == 0:
                if rise == 0.0 or min(start, end) > 0.0 or max(start, end) < 0.0:
                    continue
                t = min(max(-start / rise, 0.0), 1.0)
            px = x + t * ux
            py = y + t * uy
            pz = z + t * uz
            pe = px * ex + py * ey + pz * ez
            pf = px * fx + py * fy + pz * fz
            v = ff * pe - ef * pf
            w = ee * pf - ef * pe
            if min(v, w) < -SEGMENT.on_edge * area or v + w > (1.0 + SEGMENT.on_edge) * area:
                continue
            if number == 0:
                # Move up, until its lower end is in the plane, or down.
                up = -min(start, end)
                down = max(start, end)
                sign = 1.0 if up <= down else -1.0
                deepest = start < end if sign > 0.0 else start > end
                return -min(up, down), 0.0 if deepest else 1.0, sign * nx, sign * ny, sign * nz
            height = start if t == 0.0 else end
            sign = 1.0 if height >= 0.0 else -1.0
            if number == 1 and start * end > 0.0:  # no point of the line is nearer to the plane
                return abs(height), t, sign * nx, sign * ny, sign * nz
            if abs(height) < best:
                best = abs(height)
                place = t
                sx = sign * nx
                sy = sign * ny
                sz = sign * nz
                found = True
    for edge in range(3):
        if edge == 0:
            t, gx, gy, gz = way_to_segment(x, y, z, ux, uy, uz, ex, ey, ez)
        elif edge == 1:
            t, gx, gy, gz = way_to_segment(x, y, z, ux, uy, uz, fx, fy, fz)
        else:
            t, gx, gy, gz = way_to_segment(x - ex, y - ey, z - ez, ux, uy, uz, fx - ex, fy - ey, fz - ez)
        apart = gx * gx + gy * gy + gz * gz
        if best > 0.0 and apart < best * best:
            best = np.sqrt(apart)
            place = t
            found = True
            if apart > meeting:
                sx = gx / best
                sy = gy / best
                sz = gz / best
            elif flat:
                sx = 0.0
                sy = 0.0
                sz = 0.0
            else:
                sx = nx
                sy = ny
                sz = nz
    return best if found else np.inf, place, sx, sy, sz


@inlined
def way_to_segment(
    rx: float, ry: float, rz: float, ux: float, uy: float, uz: float, vx: float, vy: float, vz: float
) -> tuple[float, float, float, float]:
    """Return the place on a line, from 0 to 1, nearest to another line, and the vector from that line to it.

    r is the vector from the start of the other line to that of the first; u and v lead to their ends.
    """
    uu = ux * ux + uy * uy + uz * uz
    vv = vx * vx + vy * vy + vz * vz
    uv = ux * vx + uy * vy + uz * vz
    ur = ux * rx + uy * ry + uz * rz
    vr = vx * rx + vy * ry + vz * rz
    across = uu * vv - uv * uv
    # Nearest place on the first line, then on the other within its ends, then again on the first.
    # This is exact: the admissible pairs of places form a rectangle, on which the distance is convex.
    s = 0.0
    if across > SEGMENT.parallel_squared * uu * vv:
        s = min(max((uv * vr - vv * ur) / across, 0.0), 1.0)
    t = min(max((uv * s + vr) / max(vv, SEGMENT.tiny), 0.0), 1.0)
    s = min(max((uv * t - ur) / max(uu, SEGMENT.tiny), 0.0), 1.0)
    return s, rx + s * ux - t * vx, ry + s * uy - t * vy, rz + s * uz - t * vz


@subkernel
def is_inside(x: float, y: float, z: float, trees: Trees, obstacle: int) -> bool:
    """Return whether a point is inside a closed surface, with an odd number of triangles above it along z."""
    boxes, _, levels, items, count = _piece(trees, obstacle)
    inside = False
    node = 1
    level = 0
    pending = 1
    while pending > 0:
        low = trees.boxes[boxes + node, 0]
        high = trees.boxes[boxes + node, 1]
        if low[0] <= x <= high[0] and low[1] <= y <= high[1] and z <= high[2]:
            if level < levels - 1:
                node = 2 * node
                level = level + 1
                pending = 2 * pending + 1
                continue
            begin = (node - (1 << level)) * count >> level
            end = (node - (1 << level) + 1) * count >> level
            for at in range(items + begin, items + end):
                inside ^= _is_below(x, y, z, trees.triangles[at])
        # Bits of `pending` mark other children still to be visited, below a top bit for the root.
        while pending & 1 == 0:
            node = node >> 1
            level = level - 1
            pending = pending >> 1
        node = node ^ 1
        pending = pending ^ 1
    return inside


@subkernel
def _is_below(x: float, y: float, z: float, corners: Array2) -> bool:
    """Return whether a triangle is above a point; of triangles that share an edge, only one is."""
    a = corners[0]
    b = corners[1]
    c = corners[2]
    left = _is_left(a, b, x, y)
    if _is_left(b, c, x, y) != left or _is_left(c, a, x, y) != left:
        return False
    ex = b[0] - a[0]
    ey = b[1] - a[1]
    ez = b[2] - a[2]
    fx = c[0] - a[0]
    fy = c[1] - a[1]
    fz = c[2] - a[2]
    area = ex * fy - ey * fx
    if area == 0.0:
        return False
    u = ((x - a[0]) * fy - (y - a[1]) * fx) / area
    v = (ex * (y - a[1]) - ey * (x - a[0])) / area
    return a[2] + u * ez + v * fz > z


@subkernel
def _is_left(start: Array1, end: Array1, x: float, y: float) -> bool:
    """Return whether a point is left of a line seen from above, consistently for the reversed line.

    A point on a line counts as left of the direction in which x, or else y, grows.
    """
    if start[0] < end[0] or (start[0] == end[0] and start[1] < end[1]):
        return (end[0] - start[0]) * (y - start[1]) >= (end[1] - start[1]) * (x - start[0])
    return (start[0] - end[0]) * (y - end[1]) < (start[1] - end[1]) * (x - end[0])
