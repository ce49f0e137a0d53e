"""Algorithm 1 as it reads, sample after sample in NumPy, with the roots of the quartic as eigenvalues.

It shares nothing with the compiled walk: curves are SciPy's B-splines, all samples are looked at, and the
closed forms are written out again.
"""

from __future__ import annotations

from itertools import pairwise
from math import atan2, cos, hypot, pi, sin
from typing import NamedTuple

import numpy as np
from numpy.polynomial import polynomial
from numpy.typing import NDArray
from scipy.interpolate import BSpline

import pinposture as pp
from pinposture import kernels

Array = NDArray[np.float64]
ROUNDING = 1e-9
# From the coefficients of a quartic in powers of t to its Bernstein coefficients on [0, 1].
BERNSTEIN = np.array(
    [[1, 0, 0, 0, 0], [1, 1 / 4, 0, 0, 0], [1, 1 / 2, 1 / 6, 0, 0], [1, 3 / 4, 1 / 2, 1 / 4, 0], [1] * 5]
)


class ForwardKinematics(NamedTuple):
    """Joint positions of the chain, arc length of each unit's end, and the unit that has no place, or -1."""

    positions: Array
    parameters: Array
    stopped: int
    found: int
    beyond: bool


def forward(sizes: Array, q: Array) -> tuple[Array, Array]:
    c0 = cos(q[0])
    s0 = sin(q[0])
    turn = np.array([[c0, 0, s0], [0, 1.0, 0], [-s0, 0, c0]])
    if len(q) == 1:
        return turn @ [sizes[0], 0, 0], turn
    c1 = cos(sizes[2] * q[1])
    s1 = sin(sizes[2] * q[1])
    bend = np.array([[c1, -s1, 0], [s1, c1, 0], [0, 0, 1.0]])
    return turn @ ([sizes[0], 0, 0] + bend @ [sizes[1], 0, 0]), turn @ bend


def inverse(dof: int, sizes: Array, p: Array) -> list[Array]:
    l1, l2, sense = sizes
    if dof == 1:
        q = np.array([atan2(-p[2], p[0])])
        return [q] if np.abs(forward(sizes, q)[0] - p).max() < 1e-6 * l1 else []
    radius = hypot(p[0], p[2])
    q0 = atan2(-p[2], p[0]) if radius > 1e-12 * (l1 + l2) else 0.0
    both = [
        np.array([q0, sense * atan2(p[1], radius - l1)]),
        np.array([q0 - pi if q0 > 0 else q0 + pi, sense * atan2(p[1], -radius - l1)]),
    ]
    return [q for q in both if np.abs(forward(sizes, q)[0] - p).max() < 1e-7 * (l1 + l2)]


def crossings(dof: int, sizes: Array, points: Array) -> list[tuple[int, float]]:
    l1, l2 = sizes[:2]
    found = []
    for i, (a, b) in enumerate(pairwise(points)):
        d = b - a
        aa = a @ a
        ad = a @ d
        dd = d @ d
        if dof == 1:
            powers = np.array([aa - l1**2, 2 * ad, dd])
        else:
            off = aa - (l1**2 + l2**2)
            hinge = 4 * l1**2
            powers = np.array(
                [
                    off**2 - hinge * (l2**2 - a[1] ** 2),
                    4 * ad * off + 2 * hinge * a[1] * d[1],
                    2 * off * dd + 4 * ad**2 + hinge * d[1] ** 2,
                    4 * ad * dd,
                    dd**2,
                ]
            )
            bounds = BERNSTEIN @ powers
            slack = 1e-12 * np.abs(powers).max()
            if bounds.min() > slack or bounds.max() < -slack:
                continue  # of one sign, so that there is no root
        if not np.any(powers):
            continue
        roots = polynomial.polyroots(np.trim_zeros(powers, "b"))
        for t in sorted(float(root.real) for root in roots if abs(root.imag) < 1e-7):
            end = a + min(t, 1.0) * d
            if 1e-9 < t <= 1.0 + 1e-9 and end @ end > (1e-6 * (l1 + l2)) ** 2:
                found.append((i, min(t, 1.0)))
    return found


def curve_samples(curve: pp.Curve, n: int) -> tuple[Array, Array]:
    """Arc lengths, and SciPy's places of the parameters there."""
    s = np.linspace(0.0, curve.length, n)
    return s, BSpline(curve.knots, curve.coefficients, curve.degree)(
        kernels.parameters_at(curve.measured[1], s)
    )


def walk(
    arm: pp.Arm,
    units: NDArray[np.int64],
    shapes: Array,
    curve: pp.Curve,
    n: int,
    parameter: float,
    start: Array,
) -> ForwardKinematics:
    """Place units one after the other, from `start`, which lies at the arc length `parameter`."""
    s, samples = curve_samples(curve, n)
    lower = arm.limits.lower[arm.columns]
    upper = arm.limits.upper[arm.columns]
    point = arm.chain.base
    turn = np.eye(3)
    positions = np.zeros(len(lower))
    parameters = np.zeros(len(units))
    for k, ((dof, joint, _), shape) in enumerate(zip(units, shapes, strict=True)):
        sizes = shape[:3]
        neutral = shape[3:].reshape(3, 3)
        reach = sizes[0] + sizes[1]
        frame = turn @ neutral
        first = int(np.searchsorted(s, parameter, side="right"))
        ahead = np.vstack([start, samples[first:]])
        arcs = np.append(parameter, s[first:])
        out = np.flatnonzero(np.linalg.norm(ahead[1:] - point, axis=1) > reach * (1 + ROUNDING))
        last = out[0] + 2 if len(out) else len(ahead)
        local = (ahead[:last] - point) @ frame
        chosen = None
        found = 0
        for i, t in crossings(dof, sizes, local):
            p = local[i] + t * (local[i + 1] - local[i])
            solutions = inverse(dof, sizes, p)
            found += bool(solutions)
            low = lower[joint : joint + dof]
            high = upper[joint : joint + dof]
            for q in solutions:
                if np.all((q >= low - ROUNDING) & (q <= high + ROUNDING)):
                    faces = dof == 1 or p @ p > (sizes[0] ** 2 + sizes[1] ** 2) * (1 - 1e-12)
                    if faces or chosen is None:
                        chosen = (i, t, p, np.clip(q, low, high), faces)
                    break
            if chosen and chosen[4]:
                break
        if chosen is None:
            return ForwardKinematics(positions, parameters, k, found, len(out) > 0)
        i, t, p, q, _ = chosen
        positions[joint : joint + dof] = q
        parameters[k] = parameter = arcs[i] + (arcs[i + 1] - arcs[i]) * t
        turn = frame @ forward(sizes, q)[1] @ neutral.T
        point = start = point + frame @ p
    return ForwardKinematics(positions, parameters, -1, 0, False)
