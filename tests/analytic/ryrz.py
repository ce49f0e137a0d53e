"""An arm of RyRz modules written straight from the equations: rotation matrices and the product rule.

A module turns about y by q0, goes l1 along x, turns about z by q1, and goes l2 along x. A joint vector lists
q0, q1 module by module. Positions work on complex q as well, for derivatives by complex steps.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

EX = np.array([1.0, 0.0, 0.0])
ORIGIN = np.zeros(3)
IDENTITY = np.eye(3)


def ry(a: float) -> Array:
    c = np.cos(a)
    s = np.sin(a)
    return np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])


def rz(a: float) -> Array:
    c = np.cos(a)
    s = np.sin(a)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])


def dry(a: float) -> Array:
    """Derivative of Ry element by element, which is I_y Ry(a + pi/2) of (6.10)."""
    c = np.cos(a)
    s = np.sin(a)
    return np.array([[-s, 0, c], [0, 0, 0], [-c, 0, -s]])


def drz(a: float) -> Array:
    """Derivative of Rz element by element, which is I_z Rz(a + pi/2)."""
    c = np.cos(a)
    s = np.sin(a)
    return np.array([[-s, -c, 0], [c, -s, 0], [0, 0, 0]])


def points(q: ArrayLike, l1: float, l2: float, p0: ArrayLike = ORIGIN, E0: ArrayLike = IDENTITY) -> Array:
    """Positions of control points 1..m by (4.1) and (6.1a), (m, 3), in the frame of p0 and E0."""
    p = np.asarray(p0)
    E = np.asarray(E0)
    out = []
    for q0, q1 in np.reshape(q, (-1, 2)):
        p = p + E @ ry(q0) @ (l1 * IDENTITY + l2 * rz(q1)) @ EX
        E = E @ ry(q0) @ rz(q1)
        out.append(p)
    return np.array(out)


def rotations(q: ArrayLike, l1: float, l2: float, p0: ArrayLike = ORIGIN, E0: ArrayLike = IDENTITY) -> Array:
    """Orientations of control points 1..m, (m, 3, 3): (6.1b) with the sign of q0 put right."""
    E = np.asarray(E0)
    out = []
    for q0, q1 in np.reshape(q, (-1, 2)):
        E = E @ ry(q0) @ rz(q1)
        out.append(E)
    return np.array(out)


def derivative(
    k: int, u: int, q: ArrayLike, l1: float, l2: float, E0: ArrayLike = IDENTITY
) -> tuple[Array, Array]:
    """Derivatives of p_k (3,) and E_k (3, 3) by joint u: the product rule down the chain, (6.7)."""
    E = np.asarray(E0)
    dE = np.zeros((3, 3))
    dp = np.zeros(3)
    for i, (q0, q1) in enumerate(np.reshape(q, (-1, 2))[:k]):
        Y = ry(q0)
        dY = (u == 2 * i) * dry(q0)
        Z = rz(q1)
        dZ = (u == 2 * i + 1) * drz(q1)
        reach = (l1 * IDENTITY + l2 * Z) @ EX
        dreach = l2 * dZ @ EX
        dp = dp + dE @ Y @ reach + E @ dY @ reach + E @ Y @ dreach
        dE = dE @ Y @ Z + E @ dY @ Z + E @ Y @ dZ
        E = E @ Y @ Z
    return dp, dE


def jacobian(
    k: int, q: ArrayLike, l1: float, l2: float, p0: ArrayLike = ORIGIN, E0: ArrayLike = IDENTITY
) -> Array:
    """Position Jacobian of control point k = 1..m, (3, 2m); p0 plays no part in it."""
    return np.column_stack([derivative(k, u, q, l1, l2, E0)[0] for u in range(np.size(q))])


def angular_jacobian(
    k: int, q: ArrayLike, l1: float, l2: float, p0: ArrayLike = ORIGIN, E0: ArrayLike = IDENTITY
) -> Array:
    """Angular velocity of control point k = 1..m per joint velocity, (3, 2m), read off dE_k E_k^T = [w]x."""
    E = rotations(q, l1, l2, p0, E0)[k - 1]
    spins = [derivative(k, u, q, l1, l2, E0)[1] @ E.T for u in range(np.size(q))]
    return np.column_stack([[W[2, 1], W[0, 2], W[1, 0]] for W in spins])


def section_jacobian(k: int, s: int, q: ArrayLike, l1: float, l2: float) -> Array:
    """Position Jacobian of control point k relative to control point s < k (0 = base), (3, 2(k - s))."""
    return jacobian(k - s, np.asarray(q)[2 * s : 2 * k], l1, l2)


def singular_values(k: int, s: int, q: ArrayLike, l1: float, l2: float) -> Array:
    """The three singular values of the section (s, k], descending; one module has 2 columns, hence a 0."""
    sigma = np.linalg.svd(section_jacobian(k, s, q, l1, l2), compute_uv=False)
    return np.append(sigma, np.zeros(3 - len(sigma)))


def fk(q: ArrayLike, l1: float, l2: float) -> Array:
    """End of one module in the frame of its base, (3,), (6.1a)."""
    end: Array = points(q, l1, l2)[0]
    return end


def ik(p: ArrayLike, l1: float, l2: float, tolerance: float = 1e-9) -> Array:
    """All (q0, q1) in [-pi, pi] that put the end of a module at p, (n, 2); n = 0 off the torus.

    With r = l1 + l2 cos q1, p = (r cos q0, l2 sin q1, -r sin q0), so r is rho = sqrt(x^2 + z^2) or -rho. Both
    hold only on the y axis, where q0 is free: the two solutions given there stand for all. `tolerance` is on
    the distance from the torus, as a share of l1 + l2.
    """
    x, y, z = np.asarray(p, dtype=float)
    rho = np.hypot(x, z)
    solutions = []
    for r, q0 in ((rho, np.arctan2(-z, x)), (-rho, np.arctan2(z, -x))):
        if abs(np.hypot(r - l1, y) - l2) <= tolerance * (l1 + l2):
            solutions.append((q0, np.arctan2(y, r - l1)))
    return np.reshape(solutions, (-1, 2))
