"""Manipulability of the sections of a chain, and the best control set."""

from __future__ import annotations

import numpy as np

from pinposture.kernels.arrays import Array1, Array2, Array3, Flags1, Flags2, Ints1, Screws
from pinposture.kernels.compiled import compiled, subkernel
from pinposture.kernels.kinematics import difference

# The Jacobian of point i relative to point s has the columns of the joints between them. Its Gram matrix is
# a sum of outer products over these joints, from i downwards, without cancellation. Its eigenvalues have
# closed forms.

Gram = tuple[float, float, float, float, float, float]


@subkernel
def _with_module(gram: Gram, screws: Screws, plane: Array2, module: int, point: int) -> Gram:
    """Add the joints of a module to the Gram matrix (xx, xy, xz, yy, yz, zz) of the motion of a point."""
    b, ends, points = screws
    xx, xy, xz, yy, yz, zz = gram
    dx, dy, dz = difference(points, point, module)
    for u in range(ends[module] - 1, (ends[module - 1] if module else 0) - 1, -1):
        x = b[u, 0] + b[u, 4] * dz - b[u, 5] * dy
        y = b[u, 1] + b[u, 5] * dx - b[u, 3] * dz
        z = b[u, 2] + b[u, 3] * dy - b[u, 4] * dx
        if len(plane) == 2:
            x, y, z = (
                plane[0, 0] * x + plane[0, 1] * y + plane[0, 2] * z,
                plane[1, 0] * x + plane[1, 1] * y + plane[1, 2] * z,
                0.0,
            )
        xx = xx + x * x
        xy = xy + x * y
        xz = xz + x * z
        yy = yy + y * y
        yz = yz + y * z
        zz = zz + z * z
    return xx, xy, xz, yy, yz, zz


@subkernel
def _determinant(gram: Gram) -> float:
    xx, xy, xz, yy, yz, zz = gram
    return xx * (yy * zz - yz * yz) - xy * (xy * zz - yz * xz) + xz * (xy * yz - yy * xz)


@subkernel
def _index(gram: Gram, dimension: int) -> float:
    """Return the product of the singular values over that power of the largest, (4.3) and (4.4)."""
    xx, xy, xz, yy, yz, zz = gram
    mean = (xx + yy + zz) / dimension
    if mean <= 0.0:
        return 0.0
    if dimension == 2:
        half = 0.5 * (xx - yy)
        largest = mean + np.sqrt(half * half + xy * xy)
        determinant = (xx / largest) * (yy / largest) - (xy / largest) * (xy / largest)
    else:
        dx = xx - mean
        dy = yy - mean
        dz = zz - mean
        spread = np.sqrt((dx * dx + dy * dy + dz * dz + 2.0 * (xy * xy + xz * xz + yz * yz)) / 6.0)
        safe = spread if spread > 0.0 else 1.0
        cosine = 0.5 * _determinant((dx / safe, xy / safe, xz / safe, dy / safe, yz / safe, dz / safe))
        largest = mean + 2.0 * spread * np.cos(np.arccos(min(max(cosine, -1.0), 1.0)) / 3.0)
        determinant = _determinant(
            (xx / largest, xy / largest, xz / largest, yy / largest, yz / largest, zz / largest)
        )
    return min(np.sqrt(max(determinant, 0.0)), 1.0)


@subkernel
def _exceeds(gram: Gram, dimension: int, threshold: float) -> bool:
    """Return whether the index exceeds a threshold, computing the largest eigenvalue only if needed."""
    trace = gram[0] + gram[3] + gram[5]
    if dimension == 3 and trace > 0.0:
        share = _determinant(gram) / (trace * trace * trace)
        rounding = 1e-14  # of the determinant of a Gram matrix of trace 1, at most
        if share > threshold * threshold + rounding:
            return True
        if share < threshold * threshold / 27.0 - rounding:
            return False
    return _index(gram, dimension) > threshold


@subkernel
def _section_index(screws: Screws, plane: Array2, start: int, end: int) -> float:
    """Return the index of point `end` - 1 relative to `start` - 1; 0 is the base."""
    gram = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    for module in range(end - 1, start - 1, -1):
        gram = _with_module(gram, screws, plane, module, end - 1)
    return _index(gram, len(plane))


@compiled
def all_indices(screws: Screws, plane: Array2, filled: Array2) -> None:
    """Compute the indices of all sections.

    Args:
        screws: the screws of the joints, with the points.
        plane: directions in which the points can move, (2, 3), or (3, 3) for any.
        filled: zeros; filled with the index of point i relative to point s < i, (m + 1, m + 1); 0 is the
            base.
    """
    for i in range(len(screws.ends)):
        gram = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
        for s in range(i, -1, -1):
            gram = _with_module(gram, screws, plane, s, i)
            filled[s, i + 1] = _index(gram, len(plane))


@compiled
def base_indices(screws: Screws, plane: Array2, threshold: float, filled: Array1) -> None:
    """Compute the indices of all points relative to the base, in one pass, into `filled` (m,).

    The Gram matrix of linear and angular velocity is updated from point to point. An index is recomputed if
    rounding errors could decide whether it exceeds the threshold. Other arguments are as in `all_indices`.
    """
    b, ends, points = screws
    vv = np.zeros((3, 3))
    vw = np.zeros((3, 3))
    ww = np.zeros((3, 3))
    X = np.zeros((3, 3))
    P = plane
    d = len(plane)
    for i in range(len(ends)):
        if i:  # v + w x r, as a matrix times w
            r0, r1, r2 = difference(points, i, i - 1)
            X[0, 1] = r2
            X[0, 2] = -r1
            X[1, 0] = -r2
            X[1, 2] = r0
            X[2, 0] = r1
            X[2, 1] = -r0
            for j in range(3):
                for k in range(3):
                    vv[j, k] += X[j, 0] * vw[k, 0] + X[j, 1] * vw[k, 1] + X[j, 2] * vw[k, 2]
            for j in range(3):
                for k in range(3):
                    vw[j, k] += X[j, 0] * ww[0, k] + X[j, 1] * ww[1, k] + X[j, 2] * ww[2, k]
            for j in range(3):
                for k in range(3):
                    vv[j, k] += vw[j, 0] * X[k, 0] + vw[j, 1] * X[k, 1] + vw[j, 2] * X[k, 2]
        for u in range(ends[i - 1] if i else 0, ends[i]):
            for j in range(3):
                for k in range(3):
                    vv[j, k] += b[u, j] * b[u, k]
                    vw[j, k] += b[u, j] * b[u, 3 + k]
                    ww[j, k] += b[u, 3 + j] * b[u, 3 + k]
        if d == 3:
            gram = (vv[0, 0], vv[0, 1], vv[0, 2], vv[1, 1], vv[1, 2], vv[2, 2])
        else:
            xx = 0.0
            xy = 0.0
            yy = 0.0
            for j in range(3):
                for k in range(3):
                    xx += P[0, j] * vv[j, k] * P[0, k]
                    xy += P[0, j] * vv[j, k] * P[1, k]
                    yy += P[1, j] * vv[j, k] * P[1, k]
            gram = (xx, xy, 0.0, yy, 0.0, 0.0)
        filled[i] = _index(gram, d)
        if abs(filled[i] * filled[i] - threshold * threshold) < 1e-7:  # then rounding decides
            filled[i] = _section_index(screws, plane, 0, i + 1)


@compiled
def section_indices_by_size(screws: Screws, plane: Array2, sizes: Ints1, filled: Array2) -> None:
    """Compute the indices of the sections with given numbers of modules, `sizes` (S,).

    `filled` (S, m + 1), initially zeros, is filled with the index of the section that ends at each node; node
    k + 1 is point k. Other arguments are as in `all_indices`.
    """
    for j in range(len(sizes)):
        for end in range(sizes[j], len(screws.ends) + 1):
            filled[j, end] = _section_index(screws, plane, end - sizes[j], end)


@compiled
def best_path(
    screws: Screws,
    plane: Array2,
    usable: Flags1,
    errors: Array1,
    relative: float,
    path: Ints1,
) -> int:
    """Find the control set with the largest sum of errors: the longest path whose edges meet a condition.

    The best path to a point goes through the best of its possible predecessors. These are tried in descending
    order, so the first whose section meets the condition is optimal; it is usually near, so few sections are
    evaluated. Of equally good ones the first along the chain is chosen.

    `usable` (m,) marks the points that may be in the set, `errors` (m,) is the nonnegative contribution of
    each, `relative` is the threshold of the index of each point relative to the previous one in the set.
    `path` (m,) is filled with the points of the set. Other arguments are as in `all_indices`.

    Returns:
        Number of points in the set.
    """
    m = len(screws.ends)
    d = len(plane)
    known = 0
    score = np.zeros(m)
    before = np.full(m, -1)
    order = np.empty(m, np.int64)  # points so far, from the worst to the best
    grams = np.empty((m, 6))  # of the sections from each point to this one
    for i in range(m):
        if not usable[i]:
            continue
        score[i] = errors[i]
        gram = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
        reached = i
        for at in range(known - 1, -1, -1):
            s = order[at]
            if score[s] <= 0.0:
                break
            while reached > s:
                gram = _with_module(gram, screws, plane, reached, i)
                reached -= 1
                g = grams[reached]
                g[0], g[1], g[2], g[3], g[4], g[5] = gram
            g = grams[s]
            if _exceeds((g[0], g[1], g[2], g[3], g[4], g[5]), d, relative):
                score[i] += score[s]
                before[i] = s
                break
        at = known
        while at > 0 and score[order[at - 1]] >= score[i]:
            order[at] = order[at - 1]
            at -= 1
        order[at] = i
        known += 1
    count = 0
    point = order[known - 1] if known else -1
    while point >= 0:
        path[count] = point
        count += 1
        point = before[point]
    path[:count] = path[:count][::-1].copy()
    return count


@compiled
def weakest_index(screws: Screws, plane: Array2, active: Ints1, base: Array1) -> float:
    """Return the smallest index of the points of a control set, relative to the base or the previous point.

    `active` holds the points of the set, increasing, `base` (m,) the indices of all points relative to the
    base. Other arguments are as in `all_indices`.
    """
    last = active[0]
    for i in active:
        if base[i] < base[last]:
            last = i
    weakest = _section_index(screws, plane, 0, last + 1)
    for k in range(1, len(active)):
        weakest = min(weakest, _section_index(screws, plane, active[k - 1] + 1, active[k] + 1))
    return weakest


@compiled
def module_spaces(
    screws: Screws,
    plane: Array2,
    stations: Ints1,
    thresholds: Array1,
    directions: Array3,
    ranks: Ints1,
) -> float:
    """Compute the left singular vectors above a threshold of each section's Jacobian for its own joints.

    Uses one-sided Jacobi rotations (Hestenes) on the shorter side of the Jacobian: small singular values are
    as accurate as large ones, and two joints take a single rotation.

    Args:
        screws: as in `all_indices`.
        plane: as in `all_indices`.
        stations: the points at which the sections end, (p,); increasing.
        thresholds: threshold of the singular values of each section, (p,).
        directions: filled with orthonormal directions, the retained singular vectors first, (p, 3, 3).
        ranks: filled with the number of retained ones, (p,).

    Returns:
        The smallest ratio of a retained singular value to the largest of its section; 1 if there is none.
    """
    b, ends, points = screws
    widest = 0
    u = 0
    for station in stations:
        widest = max(widest, ends[station] - u)
        u = ends[station]
    d = len(plane)
    length = max(widest, len(plane))
    vectors = np.empty((3, length))
    turns = np.empty((3, 3))
    sigma = np.empty(3)
    columns = np.empty((widest, 3))
    smallest = 1.0
    u = 0
    point = 0
    for k in range(len(stations)):
        end = points[stations[k]]
        count = 0
        rank = 0
        largest = 0.0
        while point <= stations[k]:
            r0 = end[0] - points[point, 0]
            r1 = end[1] - points[point, 1]
            r2 = end[2] - points[point, 2]
            while u < ends[point]:
                x = b[u, 0] + b[u, 4] * r2 - b[u, 5] * r1
                y = b[u, 1] + b[u, 5] * r0 - b[u, 3] * r2
                z = b[u, 2] + b[u, 3] * r1 - b[u, 4] * r0
                for i in range(d):
                    columns[count, i] = plane[i, 0] * x + plane[i, 1] * y + plane[i, 2] * z
                count += 1
                u += 1
            point += 1
        narrow = count < d
        size, length = (count, d) if narrow else (d, count)
        for i in range(size):
            for j in range(length):
                vectors[i, j] = columns[i, j] if narrow else columns[j, i]
        _orthogonalise(vectors, turns, size, length)
        for i in range(size):
            sigma[i] = np.sqrt(_product(vectors, i, i, length))
            largest = max(largest, sigma[i])
        for _ in range(size):
            i = int(np.argmax(sigma[:size]))
            if not sigma[i] > thresholds[k]:
                break
            smallest = min(smallest, sigma[i] / largest)
            for j in range(3):
                directions[k, rank, j] = 0.0
                for a in range(d):
                    share = vectors[i, a] / sigma[i] if narrow else turns[i, a]
                    directions[k, rank, j] += plane[a, j] * share
            sigma[i] = -1.0
            rank += 1
        ranks[k] = rank
        _complete_basis(directions[k], rank)
    return smallest


@subkernel
def _product(vectors: Array2, i: int, j: int, length: int) -> float:
    total = 0.0
    for c in range(length):
        total += vectors[i, c] * vectors[j, c]
    return total


@subkernel
def _orthogonalise(vectors: Array2, turns: Array2, size: int, length: int) -> None:
    """Rotate up to three vectors into each other until orthogonal; fill `turns` with the rotation."""
    for i in range(size):
        for j in range(size):
            turns[i, j] = 1.0 if i == j else 0.0
    for _ in range(40):  # sweeps; three vectors take about five
        turned = False
        for i in range(size - 1):
            for j in range(i + 1, size):
                ii = _product(vectors, i, i, length)
                jj = _product(vectors, j, j, length)
                ij = _product(vectors, i, j, length)
                if abs(ij) <= 1e-15 * np.sqrt(ii * jj):
                    continue
                turned = True
                zeta = (jj - ii) / (2.0 * ij)
                t = 1.0 / (abs(zeta) + np.sqrt(1.0 + zeta * zeta))
                t = t if zeta > 0.0 else -t
                c = 1.0 / np.sqrt(1.0 + t * t)
                s = c * t
                for e in range(length):
                    one = vectors[i, e]
                    other = vectors[j, e]
                    vectors[i, e] = c * one - s * other
                    vectors[j, e] = s * one + c * other
                for e in range(size):
                    one = turns[i, e]
                    other = turns[j, e]
                    turns[i, e] = c * one - s * other
                    turns[j, e] = s * one + c * other
        if not turned:
            return


@subkernel
def _complete_basis(directions: Array2, rank: int) -> None:
    """Orthonormalise the first directions and complete them to a basis."""
    for i in range(3):
        e = directions[i]
        for attempt in range(1 if i < rank else 3):
            if i >= rank:
                e[0] = 0.0
                e[1] = 0.0
                e[2] = 0.0
                e[attempt] = 1.0
            for _ in range(2):
                for j in range(i):
                    o = directions[j]
                    share = e[0] * o[0] + e[1] * o[1] + e[2] * o[2]
                    e[0] = e[0] - share * o[0]
                    e[1] = e[1] - share * o[1]
                    e[2] = e[2] - share * o[2]
            norm = np.sqrt(e[0] * e[0] + e[1] * e[1] + e[2] * e[2])
            if norm > 0.5:
                e[0] = e[0] / norm
                e[1] = e[1] / norm
                e[2] = e[2] / norm
                break


@compiled
def best_branch(
    root: int, leaf: int, sizes: Ints1, stable: Flags2, logs: Array2, bonus: Array1, mean: bool, path: Ints1
) -> tuple[int, float]:
    """Find the branch of a tree of sections with the largest score, from its stable edges and their indices.

    Of all paths to a node with equally many stable edges, only the one with the largest product of indices
    can be part of it. Of equally good ones the first by end, edges and sizes is chosen.

    Args:
        root: the node at which all branches begin.
        leaf: the last node.
        sizes: numbers of modules that an edge may have, (S,); increasing.
        stable: which edges are stable, by size and by the node they lead to, (S, N).
        logs: logarithms of their indices, (S, N).
        bonus: added to the logarithm of the score for each number of stable edges, (C,); minus infinity for
            numbers that are not allowed.
        mean: True for the geometric mean of the indices, False for their product.
        path: filled with the end nodes of the stable edges, from last to first, (N,).

    Returns:
        Number of stable edges, and the logarithm of the score; minus infinity if there is no branch.
    """
    counts = len(bonus)
    product = np.full((leaf + 1, counts), -np.inf)  # its logarithm, by node and edges left
    before = np.zeros((leaf + 1, counts), np.int16)  # the size of the last edge
    product[root, 0] = 0.0
    for node in range(root + sizes[0], leaf + 1):
        most = min(counts, (node - root) // sizes[0] + 1)
        for j in range(len(sizes)):
            start = node - sizes[j]
            if start < root:
                break
            gained = 1 if stable[j, node] else 0
            log = logs[j, node] if gained else 0.0
            for left in range(gained, most):
                reached = product[start, left - gained] + log
                if reached > product[node, left]:
                    product[node, left] = reached
                    before[node, left] = j
    node = root
    left = 0
    best = -np.inf
    for end in range(max(root, leaf - sizes[0] + 1), leaf + 1):
        for edges in range(counts):
            score = bonus[edges] + (product[end, edges] / max(edges, 1) if mean else product[end, edges])
            if score > best:
                node = end
                left = edges
                best = score
    count = 0
    while node != root:
        j = before[node, left]
        if stable[j, node]:
            path[count] = node
            count += 1
            left -= 1
        node -= sizes[j]
    return count, best
