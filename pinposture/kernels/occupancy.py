"""Occupancy of the cells of a grid, from rays that end on surfaces.

A cell in which a ray ends gains evidence, once per picture and up to a limit; evidence decays with a time
constant. A cell that rays pass through, and in which none ends in that picture, loses as much, and is free as
soon as less than `OCCUPANCY.occupied` is left. So the state of a cell after a picture in which a ray ended
there is always occupied. Evidence is stored times a scale that grows with time, so that decay needs no pass
through the grid: the threshold grows instead.

Cells are stored block by block, so that neighbours in space are near each other in memory, and memory of
blocks that no ray has reached is never touched. Many rays pass through the same cell, nine on average if they
end on a wall. Each sets its bit, and the bits of a block are one line of a cache; evidence is taken once,
afterwards.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pinposture.kernels.arrays import Array1, Array2, Array3, Ints1, OccupancyGrid, Singles1, Three, Words1
from pinposture.kernels.compiled import compiled, inlined, subkernel


class OccupancySettings(NamedTuple):
    """What a grid consists of, and the evidence in its cells; 0 if nothing is known."""

    edge: int = 8
    """Cells along the edge of a block."""

    cells: int = 512
    """Cells in a block."""

    full: float = 4.0
    """Most evidence for a cell: pictures in which something has been seen there. As many that see through it
    make it free: 0.4 s at 10 pictures a second."""

    occupied: float = 0.5
    """Evidence up to which a cell does not count as occupied: half of that of one picture."""

    free: float = -1.0
    """Evidence of a free cell."""


OCCUPANCY = OccupancySettings()


class RayMarks(NamedTuple):
    """Marks of a cell, on top of `kinds` times the number of the picture."""

    ended: int = 0
    """A ray that met no surface ends there."""

    hit: int = 1
    """One ends on a surface."""

    kinds: int = 2


MARKS = RayMarks()


@compiled
def place_pixels(
    depth: Array2,
    focal: Array1,
    center: Array1,
    rotation: Array2,
    position: Array1,
    far: float,
    points: Array2,
) -> None:
    """Compute the points that the pixels of a depth image show, world frame.

    Args:
        depth: depths along the optical axis, (h, w); not finite or not positive where there is none, but
            infinite beyond the range.
        focal: focal lengths along columns and rows [pixels], (2,).
        center: column and row of the optical axis [pixels], (2,).
        rotation: from the axes of the image (columns, rows, depth) to the world axes, (3, 3).
        position: the centre of projection, (3,).
        far: depth that an infinite one stands for.
        points: filled with the points, row by row, (h * w, 3); NaN where there is none.
    """
    height, width = depth.shape
    for row in range(height):
        v = (row - center[1]) / focal[1]
        for column in range(width):
            u = (column - center[0]) / focal[0]
            z = depth[row, column]
            z = far if z == np.inf else z
            at = row * width + column
            if not z > 0.0:
                points[at, 0] = np.nan
                continue
            for i in range(3):
                way = rotation[i, 0] * u + rotation[i, 1] * v + rotation[i, 2]
                points[at, i] = position[i] + z * way


@inlined
def _cell_index(blocks: int, x: int, y: int, z: int) -> int:
    """Return the index of a cell from its coordinates, or -1 if it is outside the grid."""
    size = OCCUPANCY.edge * blocks
    if x < 0 or y < 0 or z < 0 or x >= size or y >= size or z >= size:
        return -1
    block = ((x >> 3) * blocks + (y >> 3)) * blocks + (z >> 3)
    return block * OCCUPANCY.cells + ((x & 7) << 6) + ((y & 7) << 3) + (z & 7)


@subkernel
def _clip(start: Three, way: Three, size: float) -> tuple[float, float]:
    """Return the shares of a line within a cube from 0 to `size`; the second is smaller if there is none."""
    first = 0.0
    last = 1.0
    for axis in range(3):
        if way[axis] == 0.0:
            if start[axis] < 0.0 or start[axis] >= size:
                return 1.0, 0.0
            continue
        one = -start[axis] / way[axis]
        other = (size - start[axis]) / way[axis]
        first = max(first, min(one, other))
        last = min(last, max(one, other))
    return first, last


@subkernel
def _axis_distance(lines: Array3, body: int, x: float, y: float, z: float) -> float:
    """Return the distance of a point from the axis of a capsule."""
    ux = lines[body, 1, 0] - lines[body, 0, 0]
    uy = lines[body, 1, 1] - lines[body, 0, 1]
    uz = lines[body, 1, 2] - lines[body, 0, 2]
    x = x - lines[body, 0, 0]
    y = y - lines[body, 0, 1]
    z = z - lines[body, 0, 2]
    t = min(max((x * ux + y * uy + z * uz) / max(ux * ux + uy * uy + uz * uz, 1e-300), 0.0), 1.0)
    return np.sqrt((x - t * ux) ** 2 + (y - t * uy) ** 2 + (z - t * uz) ** 2)


@subkernel
def _bodies_near(grid: OccupancyGrid, block: int, lines: Array3, radii: Array1) -> int:
    """Return a bit for each capsule that may reach into a block; bodies share bits from the 63rd on."""
    n = grid.blocks
    edge = OCCUPANCY.edge * grid.resolution
    x = grid.corner[0] + (block // (n * n) + 0.5) * edge
    y = grid.corner[1] + (block // n % n + 0.5) * edge
    z = grid.corner[2] + (block % n + 0.5) * edge
    found = 0
    for body in range(len(lines)):
        if _axis_distance(lines, body, x, y, z) <= radii[body] + 0.8661 * edge:
            found |= 1 << (body % 62)
    return found


@compiled
def cast_rays(
    grid: OccupancyGrid,
    picture: int,
    scale: float,
    origin: Array1,
    points: Array2,
    reach: Array1,
    passes: bool,
    lines: Array3,
    radii: Array1,
) -> int:
    """Take the rays of a picture: cells in which they end are occupied, those that they pass are not.

    One ray is followed for each cell in which rays end: the first of them. Rays that end beyond the range, or
    outside the grid, only pass.

    Args:
        grid: the grid.
        picture: number of the picture, larger than those before.
        scale: the scale of evidence at its time.
        origin: where the rays begin, (3,).
        points: where they end, (m, 3); those with NaN or infinity count as missing.
        reach: smallest and largest distance from the origin at which an end counts, (2,).
        passes: whether rays make cells free; if not, only their ends count.
        lines: axes of the arm's own bodies, (b, 2, 3); ends within them are left out.
        radii: distances from these axes that count as within, (b,).

    Returns:
        Number of points left out as the arm's own.
    """
    n = grid.blocks
    size = float(OCCUPANCY.edge * n)
    inverse = 1.0 / grid.resolution
    begin = (
        (origin[0] - grid.corner[0]) * inverse,
        (origin[1] - grid.corner[1]) * inverse,
        (origin[2] - grid.corner[2]) * inverse,
    )
    base = MARKS.kinds * picture
    near = np.full(n * n * n, -1, dtype=np.int64)
    rays = np.empty((len(points), 4))
    count = 0
    own = 0
    for k in range(len(points)):
        x = points[k, 0] - origin[0]
        y = points[k, 1] - origin[1]
        z = points[k, 2] - origin[2]
        far = np.sqrt(x * x + y * y + z * z)
        if not reach[0] <= far < np.inf:
            continue
        share = 1.0 if far <= reach[1] else reach[1] / far
        way = (x * inverse * share, y * inverse * share, z * inverse * share)
        ends = far <= reach[1]
        first, last = _clip(begin, way, size)
        if first > min(last, 1.0):
            continue
        if last < 1.0:
            ends = False
            way = (way[0] * last, way[1] * last, way[2] * last)
        at = _cell_index(
            n,
            min(max(int(np.floor(begin[0] + way[0])), 0), OCCUPANCY.edge * n - 1),
            min(max(int(np.floor(begin[1] + way[1])), 0), OCCUPANCY.edge * n - 1),
            min(max(int(np.floor(begin[2] + way[2])), 0), OCCUPANCY.edge * n - 1),
        )
        mark = grid.marks[at]
        if mark == base + MARKS.hit or (mark == base + MARKS.ended and not ends):
            continue
        if ends and len(lines) > 0:
            block = at // OCCUPANCY.cells
            if near[block] < 0:
                near[block] = _bodies_near(grid, block, lines, radii)
            bits = near[block]
            within = False
            if bits != 0:
                for body in range(len(lines)):
                    if bits >> (body % 62) & 1:
                        away = _axis_distance(lines, body, points[k, 0], points[k, 1], points[k, 2])
                        if away <= radii[body]:
                            within = True
                            break
            if within:
                own += 1
                continue
        if ends:
            evidence = grid.evidence[at] / scale
            evidence = evidence if evidence > OCCUPANCY.occupied else 0.0
            grid.evidence[at] = min(evidence + 1.0, OCCUPANCY.full) * scale
            grid.used[at // OCCUPANCY.cells] = 1
            grid.marks[at] = base + MARKS.hit
        else:
            grid.marks[at] = base + MARKS.ended
        rays[count, 0] = way[0]
        rays[count, 1] = way[1]
        rays[count, 2] = way[2]
        rays[count, 3] = 1.0 if ends else 0.0
        count += 1
    for k in range(count if passes else 0):
        _follow(grid, begin, (rays[k, 0], rays[k, 1], rays[k, 2]), rays[k, 3] > 0.0)
    if passes:
        _take_passed(grid, base + MARKS.hit, scale)
    return own


@inlined
def _index_part(blocks: int, axis: int, coordinate: int) -> int:
    """Return what a coordinate of a cell adds to its index; see `_cell_index`."""
    stride = blocks * blocks if axis == 0 else (blocks if axis == 1 else 1)
    return (coordinate >> 3) * stride * OCCUPANCY.cells + ((coordinate & 7) << (6 - 3 * axis))


@inlined
def _set_bit(bits: Words1, at: int) -> None:
    """Set the bit of a cell."""
    bits[at >> 6] |= np.uint64(1) << np.uint64(at & 63)


@subkernel
def _follow(grid: OccupancyGrid, begin: Three, way: Three, ends: bool) -> None:
    """Set the bits of the cells of a ray, but for the one in which it ends on a surface."""
    n = grid.blocks
    size = OCCUPANCY.edge * n
    first, _ = _clip(begin, way, float(size))
    first = first * (1.0 + 1e-12)
    x = min(max(int(np.floor(begin[0] + first * way[0])), 0), size - 1)
    y = min(max(int(np.floor(begin[1] + first * way[1])), 0), size - 1)
    z = min(max(int(np.floor(begin[2] + first * way[2])), 0), size - 1)
    sx = 1 if way[0] > 0.0 else -1
    sy = 1 if way[1] > 0.0 else -1
    sz = 1 if way[2] > 0.0 else -1
    dx = abs(1.0 / way[0]) if way[0] != 0.0 else np.inf
    dy = abs(1.0 / way[1]) if way[1] != 0.0 else np.inf
    dz = abs(1.0 / way[2]) if way[2] != 0.0 else np.inf
    tx = (x + (1 if sx > 0 else 0) - begin[0]) / way[0] if way[0] != 0.0 else np.inf
    ty = (y + (1 if sy > 0 else 0) - begin[1]) / way[1] if way[1] != 0.0 else np.inf
    tz = (z + (1 if sz > 0 else 0) - begin[2]) / way[2] if way[2] != 0.0 else np.inf
    part_x = _index_part(n, 0, x)
    part_y = _index_part(n, 1, y)
    part_z = _index_part(n, 2, z)
    while min(tx, ty, tz) < 1.0:
        _set_bit(grid.bits, part_x + part_y + part_z)
        if tx <= ty and tx <= tz:
            x += sx
            tx += dx
            if x < 0 or x >= size:
                return
            part_x = _index_part(n, 0, x)
        elif ty <= tz:
            y += sy
            ty += dy
            if y < 0 or y >= size:
                return
            part_y = _index_part(n, 1, y)
        else:
            z += sz
            tz += dz
            if z < 0 or z >= size:
                return
            part_z = _index_part(n, 2, z)
    if not ends:
        _set_bit(grid.bits, part_x + part_y + part_z)


@subkernel
def _take_passed(grid: OccupancyGrid, hit: int, scale: float) -> None:
    """Take from cells whose bits are set the evidence of one picture, if no ray ended there; clear the bits.

    Args:
        grid: the grid.
        hit: mark of cells in which a ray ended on a surface.
        scale: the scale of evidence.
    """
    for word in range(len(grid.bits)):
        bits = grid.bits[word]
        if bits == 0:
            continue
        grid.bits[word] = 0
        grid.used[word // (OCCUPANCY.cells // 64)] = 1
        for inner in range(64):
            at = 64 * word + inner
            if (bits >> np.uint64(inner)) & np.uint64(1) and grid.marks[at] != hit:
                left = grid.evidence[at] / scale - 1.0
                grid.evidence[at] = left * scale if left > OCCUPANCY.occupied else OCCUPANCY.free


@compiled
def clear_capsules(grid: OccupancyGrid, lines: Array3, radii: Array1) -> None:
    """Make the cells free whose centres are within capsules.

    Args:
        grid: the grid.
        lines: axes of the capsules, (b, 2, 3).
        radii: their radii, (b,).
    """
    inverse = 1.0 / grid.resolution
    size = OCCUPANCY.edge * grid.blocks
    low = np.empty(3, dtype=np.int64)
    high = np.empty(3, dtype=np.int64)
    for body in range(len(lines)):
        for i in range(3):
            least = min(lines[body, 0, i], lines[body, 1, i]) - radii[body] - grid.corner[i]
            most = max(lines[body, 0, i], lines[body, 1, i]) + radii[body] - grid.corner[i]
            low[i] = max(int(np.floor(max(least * inverse, -1.0))), 0)
            high[i] = min(int(np.floor(min(most * inverse, size + 1.0))), size - 1)
        for x in range(low[0], high[0] + 1):
            for y in range(low[1], high[1] + 1):
                for z in range(low[2], high[2] + 1):
                    px = grid.corner[0] + (x + 0.5) * grid.resolution
                    py = grid.corner[1] + (y + 0.5) * grid.resolution
                    pz = grid.corner[2] + (z + 0.5) * grid.resolution
                    if _axis_distance(lines, body, px, py, pz) <= radii[body]:
                        at = _cell_index(grid.blocks, x, y, z)
                        grid.evidence[at] = OCCUPANCY.free
                        grid.used[at // OCCUPANCY.cells] = 1


@compiled
def forget_cells(grid: OccupancyGrid, scale: float) -> None:
    """Divide evidence by a scale, which is 1 from now on; cells that are no longer occupied are unknown.

    Args:
        grid: the grid.
        scale: the scale of evidence now.
    """
    for block in range(len(grid.used)):
        if grid.used[block]:
            for at in range(block * OCCUPANCY.cells, (block + 1) * OCCUPANCY.cells):
                if grid.evidence[at] > 0.0:
                    left = grid.evidence[at] / scale
                    grid.evidence[at] = left if left > OCCUPANCY.occupied else 0.0


@compiled
def read_cells(grid: OccupancyGrid, scale: float, points: Array2, states: Ints1) -> None:
    """Look up the states of the cells that contain points.

    Args:
        grid: the grid.
        scale: the scale of evidence now.
        points: the points, (m, 3).
        states: filled with 1 for occupied, -1 for free, 0 for unknown and outside the grid, (m,).
    """
    inverse = 1.0 / grid.resolution
    size = float(OCCUPANCY.edge * grid.blocks)
    for k in range(len(points)):
        x = min(max((points[k, 0] - grid.corner[0]) * inverse, -1.0), size)
        y = min(max((points[k, 1] - grid.corner[1]) * inverse, -1.0), size)
        z = min(max((points[k, 2] - grid.corner[2]) * inverse, -1.0), size)
        at = _cell_index(grid.blocks, int(np.floor(x)), int(np.floor(y)), int(np.floor(z)))
        states[k] = 0
        if at >= 0:
            evidence = grid.evidence[at]
            states[k] = 1 if evidence > OCCUPANCY.occupied * scale else (-1 if evidence < 0.0 else 0)


@inlined
def _word(grid: OccupancyGrid, block: tuple[int, int, int], x: int) -> np.uint64:
    """Return the bits of the layer x of a block, given by its coordinates; 0 outside the grid."""
    n = grid.blocks
    i, j, k = block
    if i < 0 or j < 0 or k < 0 or i >= n or j >= n or k >= n:
        return np.uint64(0)
    return grid.bits[((i * n + j) * n + k) * OCCUPANCY.edge + x]


@subkernel
def _bare(grid: OccupancyGrid, block: tuple[int, int, int], x: int) -> np.uint64:
    """Return which cells of the layer x of a block have bits, and a neighbour without one.

    The bit of a cell at y and z is that of 8 y + z.
    """
    i, j, k = block
    bits = _word(grid, block, x)
    last = OCCUPANCY.edge - 1
    around = _word(grid, block, x - 1) if x > 0 else _word(grid, (i - 1, j, k), last)
    around &= _word(grid, block, x + 1) if x < last else _word(grid, (i + 1, j, k), 0)
    around &= (bits << np.uint64(8)) | (_word(grid, (i, j - 1, k), x) >> np.uint64(56))
    around &= (bits >> np.uint64(8)) | (_word(grid, (i, j + 1, k), x) << np.uint64(56))
    lowest = np.uint64(0x0101010101010101)  # the bits of the cells at z = 0
    low = (_word(grid, (i, j, k - 1), x) >> np.uint64(7)) & lowest
    around &= ((bits << np.uint64(1)) & ~lowest) | low
    highest = np.uint64(0x8080808080808080)  # those at z = 7
    high = (_word(grid, (i, j, k + 1), x) << np.uint64(7)) & highest
    around &= ((bits >> np.uint64(1)) & ~highest) | high
    return bits & ~around


@subkernel
def _bits_above(evidence: Singles1, begin: int, sign: float, least: float) -> np.uint64:
    """Return which of 64 cells, from an index on, have more evidence than the least, times a sign."""
    bits = np.uint64(0)
    for inner in range(64):
        bits |= np.uint64(sign * evidence[begin + inner] > least) << np.uint64(inner)
    return bits


@inlined
def _keep_center(grid: OccupancyGrid, x: int, y: int, z: int, found: int, centers: Array2) -> int:
    """Store the centre of a cell, if there is room, and return how many were found with it."""
    if found < len(centers):
        centers[found, 0] = grid.corner[0] + (x + 0.5) * grid.resolution
        centers[found, 1] = grid.corner[1] + (y + 0.5) * grid.resolution
        centers[found, 2] = grid.corner[2] + (z + 0.5) * grid.resolution
    return found + 1


@compiled
def find_surface(grid: OccupancyGrid, picture: int, scale: float, forbidden: bool, centers: Array2) -> int:
    """Find the cells to keep clear of that have a neighbour across a face that need not be kept clear of.

    Args:
        grid: the grid.
        picture: number of a picture, larger than those before; marks are overwritten.
        scale: the scale of evidence now.
        forbidden: whether unknown cells, and all outside the grid, are to be kept clear of as occupied ones.
        centers: filled with the centres of these cells, (k, 3).

    Returns:
        Their number; those beyond k are not stored.
    """
    n = grid.blocks
    found = 0
    sign = -1.0 if forbidden else 1.0
    least = 0.0 if forbidden else OCCUPANCY.occupied * scale
    base = MARKS.kinds * picture
    for block in range(len(grid.used)):
        for word in range(OCCUPANCY.edge * block, OCCUPANCY.edge * (block + 1) if grid.used[block] else 0):
            grid.bits[word] = _bits_above(grid.evidence, 64 * word, sign, least)
    for block in range(len(grid.used)):
        if not grid.used[block]:
            continue
        place = (block // (n * n), block // n % n, block % n)
        for layer in range(OCCUPANCY.edge):
            bare = _bare(grid, place, layer)
            x = OCCUPANCY.edge * place[0] + layer
            for inner in range(64 if bare else 0):
                if not (bare >> np.uint64(inner)) & np.uint64(1):
                    continue
                y = OCCUPANCY.edge * place[1] + (inner >> 3)
                z = OCCUPANCY.edge * place[2] + (inner & 7)
                if not forbidden:
                    found = _keep_center(grid, x, y, z, found, centers)
                    continue
                for side in range(6):
                    step = 1 if side & 1 else -1
                    i = x + (step if side >> 1 == 0 else 0)
                    j = y + (step if side >> 1 == 1 else 0)
                    k = z + (step if side >> 1 == 2 else 0)
                    beside = _cell_index(n, i, j, k)
                    if beside >= 0:
                        if grid.evidence[beside] < 0.0 or grid.marks[beside] >= base:
                            continue
                        grid.marks[beside] = base
                    found = _keep_center(grid, i, j, k, found, centers)
    for block in range(len(grid.used)):
        if grid.used[block]:
            grid.bits[OCCUPANCY.edge * block : OCCUPANCY.edge * (block + 1)] = 0
    return found
