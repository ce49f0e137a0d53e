"""Which closed-form solver serves which joints of an arm."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from pinposture.arm.chain import Chain
from pinposture.errors import UnsupportedModule
from pinposture.target.circle import Circle
from pinposture.target.torus import Torus

Array = NDArray[np.float64]

STRAIGHT = 1e-9
"""How far from exact a module may be to count as one of ours, relative to its length or to one radian."""


class ModuleKinematics(Protocol):
    """The three solvers that a module must supply (Section 4.1), in the frame at its base.

    They are compiled, in `pinposture.kernels.modules`; whole arms are placed there too, by `kernels.walk`.
    """

    @property
    def dof(self) -> int:
        """Number of joints."""

    @property
    def reach(self) -> float:
        """Largest distance of the end from the base [m]."""

    def forward(self, q: Array) -> tuple[Array, Array]:
        """FK: position (3,) [m] and orientation (3, 3) of the end."""

    def inverse(self, p: Array) -> list[Array]:
        """IK: all joint positions that put the end at p, (3,) [m]."""

    def faces(self, p: Array) -> bool:
        """True if p lies on the part of the reachable set to prefer."""

    def crossings(self, points: Array) -> Iterator[tuple[int, float]]:
        """TP: where the polyline (n + 1, 3) [m] crosses the reachable set, in order."""


@dataclass(frozen=True)
class Unit:
    """A stretch of the arm that one solver places.

    Attributes:
        module: index of the module it belongs to, 0-based.
        joints: indices into the chain.
        frame: axes of its base frame as columns, in the neutral posture, (3, 3), world frame.
        kinematics: its solver.
    """

    module: int
    joints: slice
    frame: Array
    kinematics: Torus | Circle


@lru_cache(maxsize=64)
def arm_units(chain: Chain) -> tuple[Unit, ...]:
    """Find a solver for every module of an arm; remembered, because targets are resolved again and again.

    A module with two perpendicular hinges is a `Torus`; hinges that are all parallel are placed one by
    one as `Circle`s.

    Raises:
        UnsupportedModule: a module that is neither.
    """
    units: list[Unit] = []
    start = chain.base
    for module, joints in enumerate(chain.module_slices):
        end = chain.points[module]
        units.extend(_module_units(chain, module, joints, start, end))
        start = end
    return tuple(units)


class Layout(NamedTuple):
    """The units of an arm as kernels want them, see `kernels.walk.walk_along`.

    Attributes:
        units: degrees of freedom, first joint and module of each, (n, 3).
        shapes: lengths, sense and base frame of each, (n, 12).
    """

    units: NDArray[np.int64]
    shapes: Array


@lru_cache(maxsize=64)
def layout(chain: Chain) -> Layout:
    """Lay the solvers of an arm out; remembered likewise.

    Raises:
        UnsupportedModule: as `arm_units`.
    """
    units = arm_units(chain)
    numbers, shapes = np.zeros((len(units), 3), dtype=np.int64), np.zeros((len(units), 12))
    for number, shape, unit in zip(numbers, shapes, units, strict=True):
        solver = unit.kinematics
        number[:] = solver.dof, unit.joints.start, unit.module
        shape[:3] = (
            (solver.l1, solver.l2, solver.sense) if isinstance(solver, Torus) else (solver.link, 0.0, 1.0)
        )
        shape[3:] = unit.frame.ravel()
    return Layout(numbers, shapes)


def _module_units(chain: Chain, module: int, joints: slice, start: Array, end: Array) -> list[Unit]:
    axes, origins = chain.axes[joints], chain.origins[joints]
    stations = np.vstack([start, origins[1:], end])
    links = np.diff(stations, axis=0)
    lengths = np.linalg.norm(links, axis=1)
    names = chain.joints[joints]

    def refuse(reason: str) -> UnsupportedModule:
        supported = "closed-form solvers exist for two perpendicular hinges and for parallel hinges"
        return UnsupportedModule(module + 1, names, f"{reason}; {supported}, across a straight module")

    if not np.all(chain.revolute[joints]):
        raise refuse("has a sliding joint")
    if np.any(lengths <= STRAIGHT * lengths.max()):
        raise refuse("has a link without length")
    along = links[0] / lengths[0]
    if np.abs(links / lengths[:, None] - along).max() > STRAIGHT:
        raise refuse("is not straight at its neutral configuration")
    if np.linalg.norm(np.cross(origins[0] - start, axes[0])) > STRAIGHT * lengths.sum():
        raise refuse("its first joint does not sit at its base")
    if np.abs(axes @ along).max() > STRAIGHT:
        raise refuse("has a joint axis that is not across the module")

    parallel = np.linalg.norm(np.cross(axes, axes[0]), axis=1) < STRAIGHT
    first = joints.start
    if np.all(parallel):
        return [
            Unit(module, slice(first + i, first + i + 1), _frame(along, axes[i]), Circle(float(lengths[i])))
            for i in range(len(axes))
        ]
    if len(axes) == 2 and abs(axes[0] @ axes[1]) < STRAIGHT:
        frame = _frame(along, axes[0])
        torus = Torus(float(lengths[0]), float(lengths[1]), sense=float(np.sign(frame[:, 2] @ axes[1])))
        return [Unit(module, joints, frame, torus)]
    raise refuse("its joint axes are neither parallel nor a perpendicular pair")


def _frame(x: Array, y: Array) -> Array:
    return np.column_stack([x, y, np.cross(x, y)])
