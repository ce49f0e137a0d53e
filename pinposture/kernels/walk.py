"""Algorithm 1: modules placed on a curve one after the other, each where it first crosses the curve ahead."""

from __future__ import annotations

import numpy as np

from pinposture.kernels.arclength import parameter_at
from pinposture.kernels.arrays import Array1, Array2, Array3, Ints1, Ints2, Three
from pinposture.kernels.compiled import compiled, subkernel
from pinposture.kernels.modules import circle_crossings, torus_clearance, torus_crossings, torus_faces
from pinposture.kernels.spline import span_at, value
from pinposture.kernels.units import ROUNDING, base_frame, seen, solutions, turned, within


@subkernel
def clearance(dof: int, shape: Array1, a: Three) -> float:
    """A distance from a point of the base frame within which nothing is crossed, nor is it out of reach."""
    away = np.sqrt(a[0] * a[0] + a[1] * a[1] + a[2] * a[2])
    if dof == 1:
        return float(abs(shape[0] - away))
    return float(min(shape[0] + shape[1] - away, torus_clearance(shape[0], shape[1], a[0], a[1], a[2])))


@subkernel
def search_segment(
    dof: int,
    shape: Array1,
    joint: int,
    lower: Array1,
    upper: Array1,
    a: Three,
    b: Three,
    roots: Array1,
    qs: Array2,
    choice: Array1,
) -> tuple[int, int]:
    """Look for a place for the end of a module on a segment.

    Args:
        dof: of the module.
        shape: of the module, see `walk_along`.
        joint: its first joint.
        lower: lower limits of the joints of the chain.
        upper: upper limits.
        a: where the segment begins, base frame.
        b: where it ends.
        roots: space, (4,).
        qs: space, (2, 2).
        choice: where on the segment from 0 to 1, the place (3,) and the joint positions (2,); filled with the
            first place there that faces the module, or else with the first one if it was NaN.

    Returns:
        Crossings regardless of joint limits, and whether the choice faces the module.
    """
    found = 0
    if dof == 1:
        count = circle_crossings(shape[0], a, b, roots)
    else:
        count = torus_crossings(shape[0], shape[1], a, b, roots)
    for i in range(count):
        r = roots[i]
        x, y, z = a[0] + r * (b[0] - a[0]), a[1] + r * (b[1] - a[1]), a[2] + r * (b[2] - a[2])
        n = solutions(dof, shape, x, y, z, qs)
        found += int(n > 0)
        facing = dof == 1 or torus_faces(shape[0], shape[1], x, y, z)
        for j in range(n):
            if within(dof, qs[j], joint, lower, upper):
                if facing or np.isnan(choice[0]):
                    choice[0], choice[1], choice[2], choice[3], choice[4] = r, x, y, z, qs[j, 0]
                    choice[5] = qs[j, 1]
                if facing:
                    return found, 1
                break
    return found, 0


@compiled
def walk_along(
    t: Array1,
    table: Array3,
    degree: int,
    edges: Array1,
    lengths: Array1,
    series: Array2,
    samples: int,
    units: Ints2,
    shapes: Array2,
    lower: Array1,
    upper: Array1,
    state: Array1,
    positions: Array1,
    parameters: Array1,
) -> int:
    """Place modules until one has no place.

    The curve is a polyline of samples at equal arc length. From a sample at a distance d from all that the
    end of a module can reach, the samples less than d ahead along the curve need no look.

    Args:
        t: knots of the curve.
        table: of `spline.spline_coefficients`.
        degree: of the spline.
        edges: of `arclength.measure_length`.
        lengths: likewise.
        series: likewise.
        samples: how many, 2 at least.
        units: of what is placed at once: its number of joints (1: a circle, 2: a torus), its first joint,
            its module, (n, 3).
        shapes: its l1, l2 and sense (a circle has its link for l1), and the axes of its base frame in the
            neutral posture, row by row, (n, 12).
        lower: lower limits of the joints of the chain.
        upper: upper limits.
        state: arc length at which the base is, where it is (3,), and the place on the curve there (3,), (7,);
            on return, of the unit that has no place: where its base is on the curve; then, in its base frame,
            the place of the curve there (3,) and the last one looked at (3,); whether that is out of reach;
            how many crossings there were regardless of joint limits, (9,).
        positions: filled with the positions of the joints of the chain.
        parameters: filled with the arc length of each module's end, (m,).

    Returns:
        Index of the unit that has no place; -1 if all have one.
    """
    total = lengths[-1]
    step = total / (samples - 1)
    work, roots, qs, choice = np.empty((6, 3)), np.empty(4), np.empty((2, 2)), np.empty(6)
    turn, frame = np.zeros((3, 3)), np.empty((3, 3))
    turn[0, 0] = turn[1, 1] = turn[2, 2] = 1.0
    parameter = state[0]
    px, py, pz = state[1], state[2], state[3]
    sx, sy, sz = state[4], state[5], state[6]
    for k in range(len(units)):
        dof, joint, shape = units[k, 0], units[k, 1], shapes[k]
        reach = shape[0] + shape[1]
        base_frame(turn, shape, frame)
        a, s, at = seen(frame, sx - px, sy - py, sz - pz), parameter, parameter
        state[0] = parameter
        state[1], state[2], state[3] = a
        # The first sample ahead.
        following = max(int(parameter / step) - 1, 0)
        while following < samples and (following * step if following < samples - 1 else total) <= parameter:
            following += 1
        found, beyond, facing = 0, False, 0
        choice[0] = np.nan
        while following < samples and not beyond and not facing:
            # Jump to the last sample that is too near for a crossing or for being out of reach, if any. The
            # thousandth of a step is for what samples are beside their places.
            clear = clearance(dof, shape, a) - ROUNDING * reach
            ahead = int(min((s + clear) / step - 1e-3, samples - 1.0))
            jump = ahead >= following
            following = max(ahead, following)
            s_next = following * step if following < samples - 1 else total
            u = parameter_at(edges, lengths, series, s_next)
            x, y, z = value(t, table, degree, 0, span_at(t, degree, u), u, work)
            b = seen(frame, x - px, y - py, z - pz)
            if not jump:
                beyond = np.sqrt(b[0] * b[0] + b[1] * b[1] + b[2] * b[2]) > reach * (1.0 + ROUNDING)
                before = choice[0]
                crossed, facing = search_segment(dof, shape, joint, lower, upper, a, b, roots, qs, choice)
                found += crossed
                if facing or (np.isnan(before) and not np.isnan(choice[0])):
                    at = s + (s_next - s) * choice[0]
            a, s = b, s_next
            following += 1
        if np.isnan(choice[0]):
            state[4], state[5], state[6] = a
            state[7], state[8] = beyond, found
            return k
        for j in range(dof):
            positions[joint + j] = choice[4 + j]
        turned(dof, shape, choice[4:], frame, turn)
        px += frame[0, 0] * choice[1] + frame[0, 1] * choice[2] + frame[0, 2] * choice[3]
        py += frame[1, 0] * choice[1] + frame[1, 1] * choice[2] + frame[1, 2] * choice[3]
        pz += frame[2, 0] * choice[1] + frame[2, 1] * choice[2] + frame[2, 2] * choice[3]
        sx, sy, sz, parameter = px, py, pz, at
        parameters[units[k, 2]] = parameter
    return -1


@compiled
def neighbours(q: Array1, starts: Ints1) -> tuple[float, float]:
    """How far each module bends as the one before it does, where both have as many joints.

    Args:
        q: positions of the joints of the chain, (n,).
        starts: first joint of each module, and n, (m + 1,).

    Returns:
        Sums over the pairs: of the scalar products of their joint positions, and of the products of the
        norms.
    """
    products, norms, before = 0.0, 0.0, 0.0
    for k in range(len(starts) - 1):
        first, size = starts[k], starts[k + 1] - starts[k]
        square = 0.0
        for j in range(first, first + size):
            square += q[j] * q[j]
        if k > 0 and size == first - starts[k - 1]:
            for j in range(first, first + size):
                products += q[j] * q[j - size]
            norms += np.sqrt(square * before)
        before = square
    return products, norms
