"""The task of directions: where the links that end at control points should point."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pinposture.arm import ArmState, ControlPoints
from pinposture.arm.ellipsoid import chosen_points
from pinposture.control.checks import is_whole
from pinposture.control.tasks.orientation import direction_rows
from pinposture.control.tasks.task import Described, TaskRows, finite_array, lever
from pinposture.errors import InvalidValue
from pinposture.target import Target

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Tangents(Described):
    """Point the links that end at some control points into given directions.

    In arms made of templates that link lies along the x axis of the control point's frame; `bearing` says
    which it is in others. What no joint can change is left out: of a planar arm, the part of a direction that
    leaves its plane. A link that points the opposite way turns along a way that depends on it alone.

    Attributes:
        directions: one vector for each control point, (k, 3), or (3,) for one, world frame, of any length but
            0; kept as unit vectors (k, 3).
        points: the control points, by their indices or names, or a single one; all of them if None.
        weight: weight of the squared error of each row, where that of a control point has weight 1.
        length: lever by which turns count [m/rad]; `Arm.sliding_unit` if None.

    Raises:
        InvalidValue: a value other than described.
    """

    directions: ArrayLike
    points: ControlPoints | None = None
    weight: float = 1.0
    length: float | None = None

    def __post_init__(self) -> None:
        given: Any = self.directions
        vectors = finite_array("directions", given, (3,) if _is_vector(given) else (None, 3)).reshape(-1, 3)
        largest = np.abs(vectors).max(axis=1, keepdims=True)
        for k in np.flatnonzero(largest == 0.0)[:1]:
            raise InvalidValue(f"directions[{k}]", vectors[k].tolist(), "a vector other than 0")
        vectors = vectors / largest  # first, lest squares are out of range
        self._settle("directions", vectors / np.linalg.norm(vectors, axis=1, keepdims=True))
        if self.points is not None:
            listed = _listed(self.points)
            if len(listed) != len(vectors):
                raise InvalidValue("points", self.points, f"as many as there are directions, {len(vectors)}")
            self._settle("points", listed)
        self._settle_scales(self.weight, self.length)

    @classmethod
    def of_curve(
        cls,
        target: Target,
        points: int | Iterable[int] | None = None,
        weight: float = 1.0,
        length: float | None = None,
    ) -> Tangents:
        """Ask links to point along the curve of a target, each as it runs at the place of its control point.

        A link that ends on a curve is a chord of it: half its length before the place of the point it points
        along the tangent. The tangent at the place itself differs from that by about half the length times
        the curvature, so that it competes with the position of the points before.

        Args:
            target: a target that was found on a curve.
            points: indices of control points, 0-based or from the tip as -1; all that have a target if None.
            weight: see `Tangents`.
            length: see `Tangents`.

        Raises:
            InvalidValue: a target without a curve, or an index that it does not have.
        """
        if not isinstance(target, Target):
            raise InvalidValue("target", target, "a Target on a curve, as resolve_targets finds it")
        if target.curve is None or target.parameters is None:
            raise InvalidValue("target.curve", None, "a target on a curve, as resolve_targets finds it")
        m = len(target.parameters)
        listed = _listed(np.flatnonzero(target.placed) if points is None else points)
        for k in listed:
            if isinstance(k, str) or not -m <= k < m:
                raise InvalidValue("points", k, f"whole numbers from {-m} to {m - 1}")
        places = np.array([k % m for k in listed if not isinstance(k, str)], dtype=np.intp)
        return cls(target.curve.tangent(target.parameters[places]), places.tolist(), weight, length)

    @property
    def strict(self) -> bool:
        """False: directions give way to what comes before all else."""
        return False

    def rows(self, state: ArmState, target: Target) -> TaskRows:
        """What the task asks of a step, see `Task.rows`: two rows for each point; one in a plane."""
        arm, directions = state.arm, np.asarray(self.directions)
        points = chosen_points(
            arm.control_points, range(arm.n_modules) if self.points is None else self.points
        )
        if len(points) != len(directions):
            allowed = f"one direction for each of {len(points)} control points, unless points= chooses some"
            raise InvalidValue("directions (shape)", directions.shape, allowed)
        turns, angles = direction_rows(state, np.array(points), directions)
        arc = lever(arm, self.length)
        return TaskRows(arc * turns, arc * angles)


def _listed(points: Any) -> tuple[int | str, ...]:
    """Control points as they were given, each an index or a name, whether the arm has it or not."""
    alone = isinstance(points, str) or not isinstance(points, Iterable)
    listed = [points] if alone else list(points)
    for point in listed:
        if not (isinstance(point, str) or is_whole(point)):
            raise InvalidValue("points", point, "indices or names of control points")
    return tuple(point if isinstance(point, str) else int(point) for point in listed)


def _is_vector(values: Any) -> bool:
    try:
        return bool(np.shape(values) == (3,))
    except ValueError:  # rows of different lengths
        return False
