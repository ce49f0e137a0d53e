"""Manipulability ellipsoids of sections of an arm (Section 3.3)."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pinposture._validation import make_read_only, require_known
from pinposture.errors import InvalidValue

Array = NDArray[np.float64]

ControlPoints = int | str | Sequence[int | str]
"""One or several control points, by index, 0-based or negative from the tip, or by name."""


@dataclass(frozen=True, eq=False)
class Ellipsoid:
    """The velocities of a control point for joint velocities in the unit ball, |dq/dt| <= 1.

    An ellipse for a planar arm. In a singular posture it is flat: its last radii are 0.

    Attributes:
        point: index of the control point, 0-based.
        base: start of the moving section: 0 for the base of the arm, k for control point k - 1. The index of
            the section is `ArmState.manipulability()[base, point + 1]`.
        center: position of the control point, (3,) [m], world frame.
        directions: unit vectors along the principal axes, one per row, (d, 3), world frame; d = 3, or d = 2
            for a planar arm. Right-handed; in the plane, about the normal of `Arm.plane`.
        radii: singular values of the Jacobian, largest first, (d,) [m per unit of joint motion, see
            `Arm.joint_units`; m/rad if all joints turn].
    """

    point: int
    base: int
    center: Array
    directions: Array
    radii: Array

    @property
    def semi_axes(self) -> Array:
        """The principal axes, from the centre to the surface, (d, 3) [as `radii`], world frame."""
        return self.directions * self.radii[:, None]

    @property
    def measure(self) -> float:
        """Manipulability measure, the product of the radii (3.3); 0 in a singular posture."""
        return float(np.prod(self.radii))

    @property
    def condition(self) -> float:
        """Condition number, the ratio of the largest to the smallest radius (3.4); infinite if singular."""
        largest = float(self.radii[0])
        smallest = float(self.radii[-1])
        return largest / smallest if smallest > 0.0 else np.inf

    @property
    def smallest(self) -> float:
        """Minimum singular value (Section 3.3.3) [as `radii`]; 0 in a singular posture."""
        return float(self.radii[-1])

    @property
    def index(self) -> float:
        """Manipulability index, the measure with the largest radius set to 1 (4.4), in [0, 1]."""
        return float(np.prod(self.radii / self.radii[0])) if self.radii[0] > 0.0 else 0.0


def section_ellipsoid(jacobian: Array, plane: Array, point: int, base: int, center: Array) -> Ellipsoid:
    """Compute an ellipsoid from the position Jacobian of a section along `plane`, (d, n), n >= 1."""
    dimension, columns = jacobian.shape
    # Zero columns do not change the ellipsoid, but give it as many axes as dimensions.
    filled = np.hstack([jacobian, np.zeros((dimension, max(dimension - columns, 0)))])
    axes, radii, _ = np.linalg.svd(filled, full_matrices=False)
    if np.linalg.det(axes) < 0.0:
        axes[:, -1] *= -1.0
    radii = np.where(radii > 1e-14 * radii[0], radii, 0.0)  # smaller shares are rounding
    directions = axes.T @ plane
    center = center.copy()
    make_read_only(center, directions, radii)
    return Ellipsoid(point, base, center, directions, radii)


def chosen_points(names: Sequence[str], points: ControlPoints) -> tuple[int, ...]:
    """Return the indices of chosen control points, 0-based, in the order of the choice.

    Args:
        names: names of all control points, (m,).
        points: the choice.

    Raises:
        UnknownName: no such control point.
        InvalidValue: an index out of range, another type, or a control point chosen twice.
    """
    listed: list[object] = [points]
    if isinstance(points, Iterable) and not isinstance(points, str):
        listed = list(points)
    chosen = tuple(_point_index(names, point) for point in listed)
    if len(set(chosen)) < len(chosen):
        raise InvalidValue("points", listed, "each control point once")
    return chosen


def section_bases(chosen: Sequence[int], relative_to: str) -> tuple[int, ...]:
    """Return the start of the section of each chosen control point; see `Ellipsoid.base`."""
    require_known("start of a section", relative_to, ("base", "previous"))
    if relative_to == "base":
        return (0,) * len(chosen)
    return tuple(max((other + 1 for other in chosen if other < point), default=0) for point in chosen)


def _point_index(names: Sequence[str], point: object) -> int:
    if isinstance(point, str):
        require_known("control point", point, names)
        return list(names).index(point)
    count = len(names)
    if isinstance(point, int | np.integer) and not isinstance(point, bool) and -count <= point < count:
        return int(point) % count
    allowed = f"whole numbers from 0 to {count - 1}, or from -{count} to -1, or names of control points"
    raise InvalidValue("points", point, allowed)
