"""Closed-form kinematics of modules (Section 6.1.1), and which of them applies to which joints of an arm."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from pinposture import kernels
from pinposture.arm.kinematics import Chain
from pinposture.errors import UnsupportedModule

# The RyRz module of the thesis turns by q0 about its y axis, goes l1 along x, turns by q1 about its z axis
# and goes l2 along x. Its end lies on a torus around the y axis with radii l1 and l2. RzRy, and any other
# pair of perpendicular hinges across the arm, is the same module in another frame. If l1 = 0 it is a
# universal joint, and the torus a sphere.

Array = NDArray[np.float64]

SHAPE_TOLERANCE = 1e-9
"""Largest deviation from a module with a closed form, relative to its length or to one radian."""


@dataclass(frozen=True)
class Torus:
    """FK, IK and TP of a RyRz module, in the frame at its base (x along the module, y the first hinge).

    Attributes:
        l1: distance between the hinges [m]; 0 for a universal joint.
        l2: distance from the second hinge to the end [m].
        sense: +1 if the second hinge turns about +z, -1 if about -z.
    """

    l1: float
    l2: float
    sense: float = 1.0
    dof: int = 2

    @property
    def reach(self) -> float:
        """Largest distance of the end from the base [m]."""
        return self.l1 + self.l2

    def forward(self, q: Array) -> tuple[Array, Array]:
        """FK, (6.1) with the sign of (6.1b) corrected.

        Args:
            q: hinge angles (2,) [rad].

        Returns:
            Position of the end (3,) [m] and its orientation (3, 3), both in the base frame.
        """
        end = kernels.torus_forward(self.l1, self.l2, self.sense, float(q[0]), float(q[1]))
        return np.array(end[:3]), np.array(end[3:]).reshape(3, 3)

    def inverse(self, p: Array) -> list[Array]:
        """IK, (6.2) for the whole torus: every pair of angles that puts the end at p.

        Args:
            p: a point of the torus, (3,) [m], base frame.

        Returns:
            Hinge angles (2,) [rad], the branch that faces p first. Empty if p is not on the torus.
        """
        out = np.empty((2, 2))
        x, y, z = map(float, p)
        return list(out[: kernels.torus_inverse(self.l1, self.l2, self.sense, x, y, z, out)])

    def faces(self, p: Array) -> bool:
        """Return whether p is on the outer part of the torus, where the second hinge bends < 90 degrees."""
        x, y, z = map(float, p)
        return bool(kernels.torus_faces(self.l1, self.l2, x, y, z))

    def crossings(self, points: Array) -> Iterator[tuple[int, float]]:
        """TP, (6.13)-(6.15) corrected: where a polyline crosses the torus.

        Args:
            points: vertices (n + 1, 3) [m], base frame.

        Yields:
            Segment index i and t in (0, 1] of each crossing points[i] + t (points[i + 1] - points[i]),
            in order along the polyline. The base itself, where the torus touches itself if l1 = l2, is
            not a crossing.
        """
        out = np.empty(4)
        for i, (a, b) in enumerate(pairwise(np.asarray(points, dtype=float).tolist())):
            for t in out[: kernels.torus_crossings(self.l1, self.l2, tuple(a), tuple(b), out)]:
                yield i, float(t)


@dataclass(frozen=True)
class Circle:
    """FK, IK and TP of a module with one hinge (Section 4.6), in the frame at its base (y is the hinge).

    Attributes:
        link: distance from the hinge to the end [m].
    """

    link: float
    dof: int = 1

    @property
    def reach(self) -> float:
        """Distance of the end from the base [m]."""
        return self.link

    def forward(self, q: Array) -> tuple[Array, Array]:
        """FK: position (3,) [m] and orientation (3, 3) of the end at the hinge angle q, (1,) [rad]."""
        end = kernels.circle_forward(self.link, float(q[0]))
        return np.array(end[:3]), np.array(end[3:]).reshape(3, 3)

    def inverse(self, p: Array) -> list[Array]:
        """IK: the hinge angle (1,) [rad] that puts the end at p, (3,) [m]; empty if p is off the circle."""
        out = np.empty((2, 2))
        x, y, z = map(float, p)
        return list(out[: kernels.circle_inverse(self.link, x, y, z, out), :1])

    def crossings(self, points: Array) -> Iterator[tuple[int, float]]:
        """TP: where a polyline (n + 1, 3) [m] crosses the sphere around the base, as `Torus.crossings`.

        The crossing is on the circle if the polyline lies in the plane of the module; `inverse` tells.
        """
        out = np.empty(4)
        for i, (a, b) in enumerate(pairwise(np.asarray(points, dtype=float).tolist())):
            for t in out[: kernels.circle_crossings(self.link, tuple(a), tuple(b), out)]:
                yield i, float(t)


@dataclass(frozen=True)
class Unit:
    """Consecutive joints of a module that one closed form places.

    Attributes:
        module: index of the module, 0-based.
        joints: indices into the chain.
        frame: axes of its base frame as columns, in the neutral posture, (3, 3), world frame.
        kinematics: its closed form.
    """

    module: int
    joints: slice
    frame: Array
    kinematics: Torus | Circle


@lru_cache(maxsize=64)
def arm_units(chain: Chain) -> tuple[Unit, ...]:
    """Return the closed forms that place the modules of an arm, from base to tip.

    A module with two perpendicular hinges is a `Torus`; parallel hinges are placed one by one as `Circle`s.

    Raises:
        UnsupportedModule: a module that is neither.
    """
    units: list[Unit] = []
    start = chain.base
    for module, (joints, end) in enumerate(zip(chain.module_slices, chain.points, strict=True)):
        units.extend(_module_units(chain, module, joints, start, end))
        start = end
    return tuple(units)


@lru_cache(maxsize=64)
def unit_arrays(chain: Chain) -> tuple[NDArray[np.int64], Array]:
    """Return the units of an arm as `kernels.place_modules` takes them, `units` (n, 3) and `shapes` (n, 12).

    Raises:
        UnsupportedModule: as `arm_units`.
    """
    numbers, shapes = [], []
    for unit in arm_units(chain):
        form = unit.kinematics
        numbers.append((form.dof, int(chain.input_numbers[unit.joints.start]), unit.module))
        lengths = (form.l1, form.l2, form.sense) if isinstance(form, Torus) else (form.link, 0.0, 1.0)
        shapes.append([*lengths, *unit.frame.ravel()])
    return np.array(numbers, dtype=np.int64), np.array(shapes)


def _module_units(chain: Chain, module: int, joints: slice, start: Array, end: Array) -> list[Unit]:
    axes, origins = chain.axes[joints], chain.origins[joints]
    stations = np.vstack([start, origins[1:], end])
    links = np.diff(stations, axis=0)
    lengths = np.linalg.norm(links, axis=1)
    names = chain.joints[joints]

    def refuse(reason: str) -> UnsupportedModule:
        supported = "closed-form solvers exist for two perpendicular hinges and for parallel hinges"
        return UnsupportedModule(module + 1, names, f"{reason}; {supported}, across a straight module")

    if len(set(chain.columns[joints].tolist())) < len(axes):
        raise refuse("has coupled joints")
    if not np.all(chain.revolute[joints]):
        raise refuse("has a sliding joint")
    none = lengths <= SHAPE_TOLERANCE * lengths.max()
    universal = len(axes) == 2 and none[0] and not none[1]
    if np.any(none) and not universal:
        raise refuse("has a link without length")
    along = links[-1] / lengths[-1]
    if np.abs(links[~none] / lengths[~none, None] - along).max() > SHAPE_TOLERANCE:
        raise refuse("is not straight at its neutral configuration")
    if np.linalg.norm(np.cross(origins[0] - start, axes[0])) > SHAPE_TOLERANCE * lengths.sum():
        raise refuse("its first joint does not sit at its base")
    if np.abs(axes @ along).max() > SHAPE_TOLERANCE:
        raise refuse("has a joint axis that is not across the module")

    parallel = np.linalg.norm(np.cross(axes, axes[0]), axis=1) < SHAPE_TOLERANCE
    first = joints.start
    if np.all(parallel) and not universal:
        return [
            Unit(module, slice(first + i, first + i + 1), _frame(along, axes[i]), Circle(float(lengths[i])))
            for i in range(len(axes))
        ]
    if len(axes) == 2 and abs(axes[0] @ axes[1]) < SHAPE_TOLERANCE:
        frame = _frame(along, axes[0])
        first_link = 0.0 if universal else float(lengths[0])
        torus = Torus(first_link, float(lengths[1]), sense=float(np.sign(frame[:, 2] @ axes[1])))
        return [Unit(module, joints, frame, torus)]
    raise refuse("its joint axes are neither parallel nor a perpendicular pair")


def _frame(x: Array, y: Array) -> Array:
    return np.column_stack([x, y, np.cross(x, y)])
