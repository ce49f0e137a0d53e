"""The bodies of an arm: how each runs from its joint to the next, and where each is at a configuration."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from pinposture.arm import Arm

Array = NDArray[np.float64]


class Body(NamedTuple):
    """What one joint of the chain moves, as a broken line.

    The frame of a body has its origin at the joint and, at the neutral configuration, the axes of the world.

    Attributes:
        joint: name of the joint.
        module: index of the module that it belongs to, 0-based.
        nodes: from the joint by way of the control point, if one is fixed to the body, to the next joint,
            (p, 3) [m], body frame.
        point: the control point fixed to the body, (3,) [m], body frame; None if there is none.
        slide: how far back the joint may reach along its axis, (3,) [m], body frame; zero if it turns.
    """

    joint: str
    module: int
    nodes: Array
    point: Array | None
    slide: Array


def bodies(arm: Arm) -> tuple[Body, ...]:
    """The moving bodies of an arm, from base to tip, one for each joint of the chain."""
    chain = arm.chain
    ends = {joints.stop - 1: k for k, joints in enumerate(chain.module_slices)}
    modules = np.repeat(np.arange(arm.n_modules), [len(joints) for joints in arm.module_joints])
    listed = []
    for u, origin in enumerate(chain.origins):
        nodes, point = [np.zeros(3)], None
        if u in ends:
            point = chain.points[ends[u]] - origin
            nodes.append(point)
        if u + 1 < len(chain.origins):
            nodes.append(chain.origins[u + 1] - origin)
        reach = arm.limits.upper[chain.columns[u]]
        # Models made by hand have the largest number there is for a limit where there is none.
        slides = not chain.revolute[u] and 0.0 < reach < 10.0 * arm.length
        slide = -reach * chain.axes[u] if slides else np.zeros(3)
        listed.append(Body(chain.joints[u], int(modules[u]), _distinct(nodes, arm.length), point, slide))
    return tuple(listed)


def body_poses(arm: Arm, q: ArrayLike) -> Array:
    """Where the bodies are, by the product of exponentials of the joint screws.

    Args:
        arm: the arm.
        q: a configuration (nq,), or several (f, nq) [rad or m].

    Returns:
        Homogeneous transforms from body to world frame, (n, 4, 4), or (f, n, 4, 4) [m].

    Raises:
        InvalidValue: a configuration of the wrong size, or not finite.
    """
    several = np.ndim(q) > 1
    rows = q if several else [q]
    positions = np.array([arm.positions(row) for row in np.asarray(rows, dtype=np.float64)])  # (f, nv)
    chain = arm.chain
    poses = np.zeros((len(positions), len(chain.joints), 4, 4))
    poses[..., 3, 3] = 1.0
    # (f, n, 3, 3), all at once: one by one they take longer than everything else here
    vectors = (positions[:, chain.columns, None] * chain.axes).reshape(-1, 3)
    turns = Rotation.from_rotvec(vectors).as_matrix().reshape(len(positions), -1, 3, 3)
    turn = np.broadcast_to(np.eye(3), (len(positions), 3, 3))
    shift = np.zeros((len(positions), 3))
    for u, (axis, origin) in enumerate(zip(chain.axes, chain.origins, strict=True)):
        # The joint stands where the bodies before it carry its neutral place: p = R origin + shift.
        place = turn @ origin + shift
        if chain.revolute[u]:
            turn = turn @ turns[:, u]
        else:
            amount = positions[:, chain.columns[u], None] * axis  # (f, 3)
            place = place + np.einsum("fij,fj->fi", turn, amount)
        shift = place - turn @ origin
        poses[:, u, :3, :3], poses[:, u, :3, 3] = turn, place
    return poses if several else poses[0]


def backbone(arm: Arm, q: ArrayLike) -> Array:
    """The broken line from the base through joints and control points to the tip at a configuration.

    Args:
        arm: the arm.
        q: configuration, (nq,) [rad or m].

    Returns:
        Array (p, 3) [m], world frame.

    Raises:
        InvalidValue: a configuration of the wrong size, or not finite.
    """
    stations = [arm.chain.base[None]]
    for body, pose in zip(bodies(arm), body_poses(arm, q), strict=True):
        stations.append(body.nodes @ pose[:3, :3].T + pose[:3, 3])
    return np.vstack(stations)


def _distinct(nodes: list[Array], length: float) -> Array:
    """The nodes without those that repeat the one before."""
    kept = [nodes[0]]
    for node in nodes[1:]:
        if np.linalg.norm(node - kept[-1]) > 1e-9 * length:
            kept.append(node)
    return np.array(kept)
