"""Constraints of your own, which plans and steps of `Geodesic` keep beside limits and obstacles."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pinposture._validation import as_floats, finite_array
from pinposture.arm import ArmState
from pinposture.control.controller import call_own
from pinposture.errors import InvalidValue
from pinposture.units import CONVERGED, length_text

Array = NDArray[np.float64]


class Constraint(Protocol):
    """Interface of constraints: quantities of the arm that stay between bounds.

    A constraint has r rows. Each is a function of the configuration, and the constraint is kept where all are
    between their bounds. `rows` linearises them at a state:

        lower <= matrix @ dq <= upper

    should hold for a small joint displacement dq. So lower and upper are how far each function may still fall
    and rise; a row with lower > 0 or upper < 0 is violated, by that much. Bounds may be infinite.

    All rows are in metres, like the distances from obstacles, so that they can be compared: multiply an angle
    by the length of what it turns.

    A class attribute or field `name` is used in messages; without one, the name of the class. Plans and stops
    are checked at many states. A second method, `violations(start, offsets)`, may tell sooner than `rows` by
    how much the constraint is violated at states that are displaced from one, (s, nv) [rad or m]: (s,) [m].
    """

    def rows(self, state: ArmState) -> tuple[ArrayLike, ArrayLike, ArrayLike]:
        """Return the constraint at a state; at least one row.

        Args:
            state: the state of the arm.

        Returns:
            matrix: derivatives with respect to joint displacement, (r, nv) [m/rad or m/m].
            lower: smallest change, (r,) [m].
            upper: largest change, (r,) [m].
        """


class Inequalities(NamedTuple):
    """Constraints at a state, one finite bound after the other: matrix @ dq >= -room.

    Attributes:
        matrix: (s, nv) [m/rad or m/m].
        room: distance from the bound, negative where it is violated, (s,) [m].
        names: name of the constraint of each, (s,).
    """

    matrix: Array
    room: Array
    names: tuple[str, ...]

    def joined(self, other: Inequalities) -> Inequalities:
        """Return both together."""
        return Inequalities(
            np.concatenate([self.matrix, other.matrix]),
            np.concatenate([self.room, other.room]),
            self.names + other.names,
        )

    @property
    def violation(self) -> float:
        """Distance of the worst row beyond its bound [m]; 0 if all are kept."""
        return max(0.0, -float(self.room.min(initial=0.0)))


def inequalities_of(constraints: Sequence[Constraint], state: ArmState) -> Inequalities:
    """Evaluate constraints at a state.

    Raises:
        InvalidValue: a constraint does not return what `Constraint.rows` should.
        ControllerError: it raised an exception that is no `PostureError`.
    """
    matrices = [np.zeros((0, state.arm.nv))]
    rooms = [np.zeros(0)]
    names: list[str] = []
    for constraint in constraints:
        name = _name_of(constraint)
        matrix, lower, upper = _rows(constraint, name, state)
        for sign, bound in ((1.0, -lower), (-1.0, upper)):
            finite = np.isfinite(bound)
            matrices.append(sign * matrix[finite])
            rooms.append(bound[finite])
            names += [name] * int(finite.sum())
    return Inequalities(np.concatenate(matrices), np.concatenate(rooms), tuple(names))


def violations_along(constraints: Sequence[Constraint], start: ArmState, offsets: Array) -> Array:
    """Return the largest violation of constraints at states displaced from one, (s, nv), (s,) [m].

    Raises:
        InvalidValue: a constraint does not return what it should.
        ControllerError: it raised an exception that is no `PostureError`.
    """
    violations = np.zeros(len(offsets))
    slow: list[Constraint] = []
    for constraint in constraints:
        fast = getattr(constraint, "violations", None)
        if fast is None:
            slow.append(constraint)
            continue
        name = _name_of(constraint)
        told = call_own(name, "violations(start, offsets)", fast, start, offsets)
        told = finite_array(f"{name}.violations(start, offsets)", told, (len(offsets),))
        violations = np.maximum(violations, told)
    if slow:
        others = [inequalities_of(slow, start.moved(offset)).violation for offset in offsets]
        violations = np.maximum(violations, others)
    return violations


def _name_of(constraint: Constraint) -> str:
    return str(getattr(constraint, "name", type(constraint).__name__))


def describe_violated(inequalities: Inequalities, length: float) -> tuple[str, ...]:
    """Return a message for each constraint of an arm of a length [m] that is violated."""
    worst: dict[str, float] = {}
    for name, room in zip(inequalities.names, inequalities.room.tolist(), strict=True):
        if -room > CONVERGED * length:
            worst[name] = max(worst.get(name, 0.0), -room)
    return tuple(f"constraint: {name} is violated by {length_text(by)}" for name, by in worst.items())


def _rows(constraint: Constraint, name: str, state: ArmState) -> tuple[Array, Array, Array]:
    what = f"{name}.rows(state)"
    allowed = "three arrays: a matrix (r, nv) of finite numbers, and the bounds lower <= upper, (r,) each"
    sides = call_own(name, "rows(state)", constraint.rows, state)
    if not isinstance(sides, tuple) or len(sides) != 3:
        raise InvalidValue(what, sides, allowed)
    matrix = finite_array(f"{what}, matrix", sides[0], (None, state.arm.nv))
    lower = as_floats(f"{what}, lower", sides[1], allowed)
    upper = as_floats(f"{what}, upper", sides[2], allowed)
    shape = (len(matrix),)
    if lower.shape != shape or upper.shape != shape:
        raise InvalidValue(f"{what}, bounds (shape)", (lower.shape, upper.shape), f"{shape} each")
    if not np.all((lower <= upper) & (lower < np.inf) & (upper > -np.inf)):  # false for NaN
        allowed = "lower <= upper, not NaN, lower not inf, upper not -inf"
        raise InvalidValue(f"{what}, bounds", (lower.tolist(), upper.tolist()), allowed)
    return matrix, lower, upper
