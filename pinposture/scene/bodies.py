"""The bodies of an arm: the solids that its joints carry, each in the frame of its joint.

They are the collision geometry of the description that an arm was loaded from. Where it gives none, they are
capsules along the links, from joint to joint and to the tip.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from itertools import pairwise
from typing import NamedTuple, TypeAlias

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pinposture.arm import Arm
from pinposture.errors import PostureWarning
from pinposture.scene.collision_geometry import collision_shapes
from pinposture.scene.mesh import Mesh
from pinposture.scene.obstacles import Box, Capsule, Cylinder, Sphere
from pinposture.scene.rounding import rounded

Array = NDArray[np.float64]
Shape: TypeAlias = "Sphere | Capsule | Cylinder | Box | Mesh"

THICKNESS = 0.1
"""Radius of the stand-in capsules, relative to the mean length of a module."""
_LISTED = 12  # faults that a warning names before it only counts them


class Body(NamedTuple):
    """A solid that one joint carries.

    Attributes:
        name: name of its link, or of its joint if it is a stand-in.
        joint: index of the joint in the model; 0 if no joint moves it.
        shape: the solid, frame of the joint [m].
    """

    name: str
    joint: int
    shape: Shape


def bodies_of(arm: Arm, arm_radius: float | None = None) -> tuple[Body, ...]:
    """The bodies of an arm.

    Args:
        arm: the arm.
        arm_radius: radius of capsules that stand in for whatever the description says [m]; if None, that.

    Returns:
        The bodies, from base to tip. Links whose meshes are missing, or whose geometry makes no solid, have
        stand-ins, and one `PostureWarning` names them all. If the description gives geometry to none of the
        links that move, all of these have stand-ins.
    """
    radius = THICKNESS * float(arm.chain.module_lengths.mean()) if arm_radius is None else arm_radius
    standing_in = stand_ins(arm, radius)
    if arm_radius is not None or arm.urdf is None or "<collision" not in arm.urdf:
        return tuple(body for listed in standing_in.values() for body in listed)
    shapes, faults = collision_shapes(arm)
    listed = [Body(link, joint, shape) for link, joint, shape in rounded(arm.model, shapes)]
    lacking = list(dict.fromkeys(joint for _, joint, _ in faults))
    if not any(lacking) and not any(joint for _, joint, _ in shapes):  # geometry of the base alone
        lacking = list(standing_in)
    for joint in lacking:
        listed.extend(standing_in.get(joint, ()))
    if faults:
        named = [f"link {link!r}: {reason}" for link, _, reason in faults[:_LISTED]]
        if len(faults) > _LISTED:
            named.append(f"and {len(faults) - _LISTED} more")
        message = f"capsules stand in for collision geometry that is not to be had: {'; '.join(named)}"
        warnings.warn(message, PostureWarning, stacklevel=2)
    return tuple(sorted(listed, key=lambda body: body.joint))


def stand_ins(arm: Arm, radius: float) -> Mapping[int, tuple[Body, ...]]:
    """Capsules from each joint by way of its control point, if it carries one, to the next, or to the tip.

    A joint that slides has its capsule reach back as far as it can slide out, so that no gap opens.

    Args:
        arm: the arm.
        radius: radius of the capsules [m].

    Returns:
        The capsules by the index of the joint that carries them, from base to tip.
    """
    model, chain = arm.model, arm.chain
    places = _neutral_placements(model)
    ends = {joints.stop - 1: k for k, joints in enumerate(chain.module_slices)}
    listed: dict[int, tuple[Body, ...]] = {}
    for u, origin in enumerate(chain.origins):
        nodes = [origin]
        reach = arm.limits.upper[chain.columns[u]]
        if not chain.revolute[u] and 0.0 < reach < 10.0 * arm.length:
            nodes.insert(0, origin - reach * chain.axes[u])
        if u in ends:
            nodes.append(chain.points[ends[u]])
        if u + 1 < len(chain.origins):
            nodes.append(chain.origins[u + 1])
        joint = model.getJointId(chain.joints[u])
        here = places[joint].inverse()
        local = [here.act(node) for node in _distinct(nodes, 1e-6 * arm.length)]
        listed[joint] = tuple(
            Body(chain.joints[u], joint, Capsule(tuple(a), tuple(b), radius)) for a, b in pairwise(local)
        )
    return listed


def _neutral_placements(model: pin.Model) -> list[pin.SE3]:
    """Where the joints are in the world at the neutral configuration, where each of them is the identity."""
    places = [pin.SE3.Identity()]
    for joint in range(1, model.njoints):
        places.append(places[model.parents[joint]] * model.jointPlacements[joint])
    return places


def _distinct(nodes: list[Array], apart: float) -> list[Array]:
    """The nodes without those that repeat the one before."""
    kept = [nodes[0]]
    for node in nodes[1:]:
        if np.linalg.norm(node - kept[-1]) > apart:
            kept.append(node)
    return kept
