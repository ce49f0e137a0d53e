"""Where the joints and control points of a serial chain are."""

from __future__ import annotations

import numpy as np

from pinposture.kernels.arrays import Array1, Array2, Array3, Chain
from pinposture.kernels.compiled import compiled


@compiled
def placements(
    chain: Chain,
    positions: Array1,
    joint_axes: Array2,
    joint_origins: Array2,
    points: Array2,
    rotations: Array3,
) -> None:
    """Forward kinematics, one joint after the other.

    Args:
        chain: the chain.
        positions: joint positions, (nv,).
        joint_axes: filled with the joint axes, world frame, (n, 3).
        joint_origins: filled with the origins of the joints, (n, 3).
        points: filled with the control points, (m, 3).
        rotations: filled with their orientations, (m, 3, 3).
    """
    slides, columns, fixed, axes, ends, offsets, turns = chain
    r00, r01, r02 = 1.0, 0.0, 0.0
    r10, r11, r12 = 0.0, 1.0, 0.0
    r20, r21, r22 = 0.0, 0.0, 1.0
    px, py, pz = 0.0, 0.0, 0.0
    k = 0
    for u in range(len(slides)):
        f = fixed[u]
        px, py, pz = (
            px + r00 * f[9] + r01 * f[10] + r02 * f[11],
            py + r10 * f[9] + r11 * f[10] + r12 * f[11],
            pz + r20 * f[9] + r21 * f[10] + r22 * f[11],
        )
        r00, r01, r02 = (
            r00 * f[0] + r01 * f[3] + r02 * f[6],
            r00 * f[1] + r01 * f[4] + r02 * f[7],
            r00 * f[2] + r01 * f[5] + r02 * f[8],
        )
        r10, r11, r12 = (
            r10 * f[0] + r11 * f[3] + r12 * f[6],
            r10 * f[1] + r11 * f[4] + r12 * f[7],
            r10 * f[2] + r11 * f[5] + r12 * f[8],
        )
        r20, r21, r22 = (
            r20 * f[0] + r21 * f[3] + r22 * f[6],
            r20 * f[1] + r21 * f[4] + r22 * f[7],
            r20 * f[2] + r21 * f[5] + r22 * f[8],
        )
        x, y, z = axes[u, 0], axes[u, 1], axes[u, 2]
        ax, ay, az = r00 * x + r01 * y + r02 * z, r10 * x + r11 * y + r12 * z, r20 * x + r21 * y + r22 * z
        joint_axes[u, 0], joint_axes[u, 1], joint_axes[u, 2] = ax, ay, az
        at = positions[columns[u]]
        if slides[u]:
            px, py, pz = px + at * ax, py + at * ay, pz + at * az
        else:
            c, s = np.cos(at), np.sin(at)
            # Rodrigues' formula, in the frame of the joint.
            v = 1.0 - c
            e00, e01, e02 = c + v * x * x, v * x * y - s * z, v * x * z + s * y
            e10, e11, e12 = v * x * y + s * z, c + v * y * y, v * y * z - s * x
            e20, e21, e22 = v * x * z - s * y, v * y * z + s * x, c + v * z * z
            r00, r01, r02 = (
                r00 * e00 + r01 * e10 + r02 * e20,
                r00 * e01 + r01 * e11 + r02 * e21,
                r00 * e02 + r01 * e12 + r02 * e22,
            )
            r10, r11, r12 = (
                r10 * e00 + r11 * e10 + r12 * e20,
                r10 * e01 + r11 * e11 + r12 * e21,
                r10 * e02 + r11 * e12 + r12 * e22,
            )
            r20, r21, r22 = (
                r20 * e00 + r21 * e10 + r22 * e20,
                r20 * e01 + r21 * e11 + r22 * e21,
                r20 * e02 + r21 * e12 + r22 * e22,
            )
        joint_origins[u, 0], joint_origins[u, 1], joint_origins[u, 2] = px, py, pz
        while k < len(ends) and ends[k] == u + 1:
            o, t = offsets[k], turns[k]
            points[k, 0] = px + r00 * o[0] + r01 * o[1] + r02 * o[2]
            points[k, 1] = py + r10 * o[0] + r11 * o[1] + r12 * o[2]
            points[k, 2] = pz + r20 * o[0] + r21 * o[1] + r22 * o[2]
            for j in range(3):
                rotations[k, 0, j] = r00 * t[0, j] + r01 * t[1, j] + r02 * t[2, j]
                rotations[k, 1, j] = r10 * t[0, j] + r11 * t[1, j] + r12 * t[2, j]
                rotations[k, 2, j] = r20 * t[0, j] + r21 * t[1, j] + r22 * t[2, j]
            k += 1


@compiled
def jacobians(
    chain: Chain, joint_axes: Array2, joint_origins: Array2, points: Array2, filled: Array3
) -> None:
    """Position Jacobians of all control points: d p_k / d q_u = a_u x (p_k - o_u), or a_u where it slides.

    Args:
        chain: the chain.
        joint_axes: joint axes, world frame, (n, 3).
        joint_origins: origins of the joints, (n, 3).
        points: control points, (m, 3).
        filled: zeros, filled with the Jacobians, (m, 3, nv).
    """
    slides, columns, ends = chain.slides, chain.columns, chain.ends
    for k in range(len(ends)):
        for u in range(ends[k]):
            a, j = joint_axes[u], columns[u]
            if slides[u]:
                filled[k, 0, j], filled[k, 1, j], filled[k, 2, j] = a[0], a[1], a[2]
            else:
                x = points[k, 0] - joint_origins[u, 0]
                y = points[k, 1] - joint_origins[u, 1]
                z = points[k, 2] - joint_origins[u, 2]
                filled[k, 0, j] = a[1] * z - a[2] * y
                filled[k, 1, j] = a[2] * x - a[0] * z
                filled[k, 2, j] = a[0] * y - a[1] * x
