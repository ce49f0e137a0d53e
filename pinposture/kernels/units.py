"""One module among others: its joint limits, its base in the world, and what it hands on to the next."""

from __future__ import annotations

from pinposture.kernels.arrays import Array1, Array2, Three
from pinposture.kernels.compiled import subkernel
from pinposture.kernels.modules import circle_forward, circle_inverse, torus_forward, torus_inverse

ROUNDING = 1e-9
"""Slack for positions, relative to the reach of a module, and for joint limits [rad]."""


@subkernel
def solutions(dof: int, shape: Array1, x: float, y: float, z: float, out: Array2) -> int:
    """Joint positions that put the end of a module at a point of its frame, into out (2, 2); how many."""
    if dof == 1:
        return circle_inverse(shape[0], x, y, z, out)
    return torus_inverse(shape[0], shape[1], shape[2], x, y, z, out)


@subkernel
def within(dof: int, q: Array1, first: int, lower: Array1, upper: Array1) -> bool:
    """True if joint positions q are within the limits, but for rounding; they are put right."""
    for j in range(dof):
        if not lower[first + j] - ROUNDING <= q[j] <= upper[first + j] + ROUNDING:
            return False
    for j in range(dof):
        q[j] = min(max(q[j], lower[first + j]), upper[first + j])
    return True


@subkernel
def turned(dof: int, shape: Array1, q: Array1, frame: Array2, next_turn: Array2) -> None:
    """How the module after this one is turned, world frame, into next_turn (3, 3).

    Args:
        dof: 1 for a circle, 2 for a torus.
        shape: of the module, see `walk.walk_along`.
        q: its joint positions.
        frame: axes of its base in the world, turned, (3, 3).
        next_turn: filled.
    """
    if dof == 1:
        e = circle_forward(shape[0], q[0])
    else:
        e = torus_forward(shape[0], shape[1], shape[2], q[0], q[1])
    for i in range(3):
        f0, f1, f2 = frame[i, 0], frame[i, 1], frame[i, 2]
        a = f0 * e[3] + f1 * e[6] + f2 * e[9]
        b = f0 * e[4] + f1 * e[7] + f2 * e[10]
        c = f0 * e[5] + f1 * e[8] + f2 * e[11]
        for j in range(3):
            next_turn[i, j] = a * shape[3 + 3 * j] + b * shape[4 + 3 * j] + c * shape[5 + 3 * j]


@subkernel
def base_frame(turn: Array2, shape: Array1, frame: Array2) -> None:
    """Axes of the base of a module in the world, into frame (3, 3)."""
    for i in range(3):
        for j in range(3):
            frame[i, j] = turn[i, 0] * shape[3 + j] + turn[i, 1] * shape[6 + j] + turn[i, 2] * shape[9 + j]


@subkernel
def seen(frame: Array2, x: float, y: float, z: float) -> Three:
    """A vector of the world in a frame (3, 3)."""
    return (
        frame[0, 0] * x + frame[1, 0] * y + frame[2, 0] * z,
        frame[0, 1] * x + frame[1, 1] * y + frame[2, 1] * z,
        frame[0, 2] * x + frame[1, 2] * y + frame[2, 2] * z,
    )
