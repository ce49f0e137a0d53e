"""The moving joints of a serial arm before it is cut into modules."""

from __future__ import annotations

from functools import cached_property
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pinposture.arm.limits import carry_base, without_limits

Array = NDArray[np.float64]

PARALLEL = 1e-3
"""Largest angle between parallel axes [rad]; files round a quarter turn to 1.571 or even 1.57."""
ON_AXIS = 1e-6
"""How far from a joint axis a point may be to count as not moved by it, relative to the arm."""


class JointLines(NamedTuple):
    """Axes of joints at the neutral configuration, world frame.

    Attributes:
        axes: unit joint axes, (n, 3).
        origins: a point on each axis, the origin of the joint's frame, (n, 3) [m].
        revolute: True for a joint that turns, False for one that slides, (n,).
    """

    axes: Array
    origins: Array
    revolute: NDArray[np.bool_]


def neutral_placements(model: pin.Model) -> list[pin.SE3]:
    """Placements of all joints at the neutral configuration, world frame, where every joint is the identity.

    A `pin.Data` would know them as well; that of an arm of 1,000 joints fits in no memory.
    """
    placements = [pin.SE3.Identity()]
    for joint in range(1, model.njoints):
        placements.append(placements[model.parents[joint]] * model.jointPlacements[joint])
    return placements


def joint_screws(model: pin.Model, joints: list[int]) -> Array:
    """How joints with one degree of freedom move, (n, 6): velocity and turning, in their own frames."""
    return np.array([np.ravel(model.joints[joint].createData().S) for joint in joints])


def joint_axes(model: pin.Model, joints: list[int]) -> Array:
    """Unit axes of joints that turn or slide, (n, 3), in their own frames."""
    screws = joint_screws(model, joints)
    return np.ascontiguousarray(np.where(_turn(screws)[:, None], screws[:, 3:], screws[:, :3]))


def joint_lines(model: pin.Model, joints: list[int]) -> JointLines:
    """Read the axes of joints that turn or slide."""
    placements = neutral_placements(model)
    turns = np.array([placements[joint].rotation for joint in joints])
    origins = np.array([placements[joint].translation for joint in joints])
    axes = np.einsum("nij,nj->ni", turns, joint_axes(model, joints))
    return JointLines(axes, origins, _turn(joint_screws(model, joints)))


def _turn(screws: Array) -> NDArray[np.bool_]:
    return np.asarray(np.linalg.norm(screws[:, 3:], axis=1) > 0.5)


def plane_normal(lines: JointLines, tip: Array, length: float) -> Array | None:
    """Normal of the plane in which joints move an arm, (3,), or None if they leave every plane.

    Joints that turn do so about the normal, joints that slide do so across it. Joints at the end that turn
    about axes through the tip move nothing, so they may have any axis.

    Args:
        lines: the joints from base to tip.
        tip: the tip, (3,) [m].
        length: length of the arm [m].
    """
    n = len(lines.axes)
    while n > 1 and lines.revolute[n - 1]:
        if np.linalg.norm(np.cross(lines.axes[n - 1], tip - lines.origins[n - 1])) > ON_AXIS * length:
            break
        n -= 1
    axes, revolute = lines.axes[:n], lines.revolute[:n]
    turns, slides = axes[revolute], axes[~revolute]
    if len(turns):
        signs = np.where(turns @ turns[0] < 0.0, -1.0, 1.0)
        normal = signs @ turns
    else:
        crosses = np.cross(slides, slides[0])
        normal = crosses[np.argmax(np.linalg.norm(crosses, axis=1))]
    size = np.linalg.norm(normal)
    if size < PARALLEL:  # slides along one line
        return None
    normal = normal / size
    parallel = np.all(np.linalg.norm(np.cross(turns, normal), axis=1) < PARALLEL)
    return normal if parallel and np.all(np.abs(slides @ normal) < PARALLEL) else None


class Skeleton:
    """Joints of a serial arm from base to tip at its neutral configuration, world frame.

    Attributes:
        names: names of the joints, (n,).
        axes: unit joint axes, (n, 3).
        revolute: True for a joint that turns, (n,).
        stations: where each joint sits, and the tip after them, (n + 1, 3) [m].
        lower: smallest joint positions, (n,) [rad or m].
        upper: largest joint positions, (n,) [rad or m].
    """

    def __init__(
        self, names: tuple[str, ...], lines: JointLines, tip: Array, lower: Array, upper: Array
    ) -> None:
        self.names, self._lines = names, lines
        self.axes, self.revolute = lines.axes, lines.revolute
        self.stations = np.vstack([lines.origins, tip])
        self.lower, self.upper = lower, upper

    @cached_property
    def length(self) -> float:
        """Arc length from the first joint by way of the others to the tip [m]; inf or NaN if out of range."""
        with np.errstate(over="ignore", invalid="ignore"):
            return float(np.linalg.norm(np.diff(self.stations, axis=0), axis=1).sum())

    @cached_property
    def normal(self) -> Array | None:
        """Normal of the plane in which the arm moves, (3,), or None if it is spatial."""
        return plane_normal(self._lines, self.stations[-1], self.length)

    @cached_property
    def roaming(self) -> NDArray[np.bool_]:
        """Which joints are slides without real limits on which the base stands, (n,)."""
        without = without_limits(self.lower, self.upper, ~self.revolute, self.length)
        return carry_base(without, self.revolute)
