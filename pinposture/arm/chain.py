"""The arm as a chain of joint axes, all given in one reference posture and in the world frame.

Every joint u is a screw fixed to the body before it; at the reference (neutral) configuration its axis
passes through `origins[u]` along `axes[u]`. Together with the control points in that posture this is
the whole kinematics (product of exponentials), whatever frames the file happened to use.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pinposture.arm.skeleton import JointLines, joint_lines, neutral_placements, plane_normal
from pinposture.errors import InvalidValue, UnknownName

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Chain:
    """Joints and control points of a serial arm at its neutral configuration, world frame.

    Attributes:
        joints: names of the moving joints from base to tip, (n,).
        columns: index of each joint's velocity in the tangent space of the model, (n,).
        revolute: True for a joint that turns, False for one that slides, (n,).
        axes: unit joint axes, (n, 3).
        origins: a point on each axis, (n, 3) [m].
        base: position of control point 0, where the first module begins, (3,) [m].
        points: control points, (m, 3) [m].
        module_starts: index into `joints` of the first joint of each module, (m,).
    """

    joints: tuple[str, ...]
    columns: NDArray[np.intp]
    revolute: NDArray[np.bool_]
    axes: Array
    origins: Array
    base: Array
    points: Array
    module_starts: NDArray[np.intp]

    @cached_property
    def module_slices(self) -> tuple[slice, ...]:
        """Joints of each module as a range into `joints`."""
        ends = [*self.module_starts[1:], len(self.joints)]
        return tuple(slice(int(a), int(b)) for a, b in zip(self.module_starts, ends, strict=True))

    @cached_property
    def module_lengths(self) -> Array:
        """Distance from the base to the end of each module at the neutral configuration, (m,) [m]."""
        return np.asarray(np.linalg.norm(np.diff(np.vstack([self.base, self.points]), axis=0), axis=1))

    @cached_property
    def length(self) -> float:
        """Arc length from the first joint along the joint origins and control points to the tip [m]."""
        stations = [self.base]
        for k, joints in enumerate(self.module_slices):
            stations.extend(self.origins[joints])
            stations.append(self.points[k])
        return float(np.linalg.norm(np.diff(np.array(stations), axis=0), axis=1).sum())

    @cached_property
    def plane(self) -> Array:
        """Orthonormal basis (2, 3) of the plane in which the arm moves, or (3, 3) if it is spatial."""
        lines = JointLines(self.axes, self.origins, self.revolute)
        normal = plane_normal(lines, self.points[-1], self.length)
        if normal is None:
            return np.eye(3)
        reach = self.points[-1] - self.base
        along = reach - normal * (normal @ reach)
        if np.linalg.norm(along) <= 1e-9 * self.length:
            along = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal))])
        along = along / np.linalg.norm(along)
        return np.array([along, np.cross(normal, along)])

    @cached_property
    def plane_bound(self) -> NDArray[np.bool_]:
        """Which modules move their ends in one plane only, in an arm that leaves every plane, (m,).

        Their joints turn about parallel axes; nowhere if the arm itself is planar.
        """
        bound = np.zeros(len(self.points), dtype=np.bool_)
        if len(self.plane) == 2:
            return bound
        for k, joints in enumerate(self.module_slices):
            lines = JointLines(self.axes[joints], self.origins[joints], self.revolute[joints])
            alone = joints.stop - joints.start == 1
            bound[k] = alone or plane_normal(lines, self.points[k], self.length) is not None
        return bound

    @cached_property
    def spans(self) -> Array:
        """Length over which each part of the arm bends either way across a curve, (m,) [m].

        That of its module. Modules in a row that are bound to one plane do so together, with the modules
        before and behind them that turn the plane.
        """
        spans, m = self.module_lengths.copy(), len(self.points)
        edges = np.flatnonzero(np.diff(np.concatenate([[0], self.plane_bound.astype(int), [0]])))
        for start, stop in edges.reshape(-1, 2):
            together = slice(max(int(start) - 1, 0), min(int(stop) + 1, m))
            spans[together] = np.maximum(spans[together], self.module_lengths[together].sum())
        return np.asarray(spans)

    def flattened(self, places: Array) -> Array:
        """Places on the arm as seen in the plane in which it moves, world frame.

        Args:
            places: points that the arm carries, at any of its configurations, (..., 3) [m].

        Returns:
            For a planar arm, the places moved along the normal of its plane into the plane of its base, where
            its joints leave them; for a spatial one, the places as they are.
        """
        if len(self.plane) == 3:
            return places
        normal = np.cross(*self.plane)
        return np.asarray(places - ((places - self.base) @ normal)[..., None] * normal)


def read_chain(model: pin.Model, control_points: tuple[str, ...]) -> Chain:
    """Read the chain that leads to the last control point out of a model.

    Args:
        model: the arm, base placement already applied.
        control_points: frame names in order from base to tip.

    Returns:
        The chain in the neutral configuration.

    Raises:
        InvalidValue: a control point that does not lie farther along the chain than the one before it,
            or a joint with several degrees of freedom.
    """
    frames = [model.frames[index] for index in frame_ids(model, control_points)]
    parents = [frame.parentJoint for frame in frames]
    support = [int(j) for j in model.supports[parents[-1]] if j > 0]
    for j in support:
        if model.joints[j].nv != 1:
            allowed = "joints with one degree of freedom"
            raise InvalidValue(f"joint {model.names[j]!r}", model.joints[j].shortname(), allowed)
    number = {joint: u + 1 for u, joint in enumerate(support)}
    starts, count = [], 0
    for name, parent in zip(control_points, parents, strict=True):
        reached = number.get(parent, 0)
        if reached <= count:
            allowed = "frames with at least one more moving joint of the same chain each, from base to tip"
            raise InvalidValue(f"control point {name!r}", f"moved by {reached} joints of the chain", allowed)
        starts.append(count)
        count = reached
    lines, placements = joint_lines(model, support), neutral_placements(model)
    return Chain(
        joints=tuple(str(model.names[j]) for j in support),
        columns=np.array([model.joints[j].idx_v for j in support], dtype=np.intp),
        revolute=lines.revolute,
        axes=lines.axes,
        origins=lines.origins,
        base=lines.origins[0].copy(),
        points=np.array([(placements[frame.parentJoint] * frame.placement).translation for frame in frames]),
        module_starts=np.array(starts, dtype=np.intp),
    )


def frame_ids(model: pin.Model, names: Sequence[str]) -> list[int]:
    """Indices of frames; where a link and a joint have the same name, that of the link.

    Raises:
        UnknownName: there is no such frame.
    """
    kinds = (pin.FrameType.OP_FRAME, pin.FrameType.BODY)
    found: dict[str, int] = {}
    preferred: set[str] = set()
    for index, frame in enumerate(model.frames):
        found.setdefault(frame.name, index)
        if frame.type in kinds and frame.name not in preferred:
            preferred.add(frame.name)
            found[frame.name] = index
    for name in names:
        if name not in found:
            raise UnknownName("frame", name, list(found)[1:])
    return [found[name] for name in names]
