"""The interface of module kinematics, FK, IK and TP (Section 4.1), and a registry for custom ones."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol, TypeAlias, TypeVar, runtime_checkable

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pinposture import kernels
from pinposture._validation import finite_array, is_number, is_whole, require_positive
from pinposture.arm.kinematics import chain_arrays
from pinposture.curve import Curve
from pinposture.errors import InvalidValue
from pinposture.kernels.arrays import JOINT, ArmArrays, Joints
from pinposture.units import CONVERGED

Array = NDArray[np.float64]
Chosen = TypeVar("Chosen", bound=Callable[..., object])


@runtime_checkable
class ModuleKinematics(Protocol):
    """The kinematics of a module, as used by Algorithm 1.

    Everything is in the base frame of the module: its origin is the base of the module (the previous control
    point), x points to the end of the module at its neutral configuration, and y is the component
    perpendicular to x of the first joint axis that is not along x. Lengths are in metres, angles in radians.
    Joint positions q are those of the module's degrees of freedom from base to end, zero when neutral.

    Kinematics that only approximate the joints declare this with an attribute `tolerance`: the largest error
    of their FK, in reaches of the module or radians; 1e-6 by default.

    Attributes:
        dof: number of degrees of freedom, k.
        reach: largest distance of the end from the base [m].
    """

    @property
    def dof(self) -> int:
        """Number of degrees of freedom, k."""

    @property
    def reach(self) -> float:
        """Largest distance of the end from the base [m]."""

    def forward(self, q: Array) -> tuple[Array, Array]:
        """FK: position (3,) [m] and orientation (3, 3) of the end at joint positions q, (k,)."""

    def inverse(self, p: Array) -> Sequence[Array]:
        """IK: joint positions (k,) that put the end at p, (3,) [m]; best first, empty if out of reach."""

    def target_point(self, base: pin.SE3, curve: Curve, start: float) -> float | None:
        """TP: the next point of a curve that the end of the module can reach.

        Args:
            base: placement of the base frame in the frame of the curve.
            curve: the curve.
            start: arc length of the base on the curve [m].

        Returns:
            Arc length of the point, above `start` [m]; None if there is none. The library checks joint
            limits; if they rule out every posture there, it calls this again from that point.
        """


@dataclass(frozen=True, eq=False)
class ModuleJoints:
    """The joints of a module at its neutral configuration, in its base frame (`ModuleKinematics`).

    Attributes:
        names: names of the joints from base to end, (n,).
        revolute: True for a joint that turns, False for one that slides, (n,).
        axes: unit joint axes, (n, 3).
        origins: a point on each axis, (n, 3) [m].
        end: the end of the module, (3,) [m].
        inputs: index of the degree of freedom that moves each joint, (n,); 0, 1, ... from the base.
        ratios: motion of each joint relative to its degree of freedom, (n,); 1 unless coupled.
        lower: smallest positions of the degrees of freedom, (k,) [rad or m].
        upper: largest ones, (k,).
        base: the base of the module in the world, (3,) [m].
        frame: axes of the base frame as columns, (3, 3), world frame.
    """

    names: tuple[str, ...]
    revolute: NDArray[np.bool_]
    axes: Array
    origins: Array
    end: Array
    inputs: NDArray[np.int64]
    ratios: Array
    lower: Array
    upper: Array
    base: Array
    frame: Array

    @property
    def dof(self) -> int:
        """Number of degrees of freedom, k."""
        return len(self.lower)

    @cached_property
    def chain(self) -> ArmArrays:
        """The joints as kernels take them, with the end as a control point; do not write to the arrays."""
        n = len(self.names)
        joints = Joints(
            parents=np.arange(n, dtype=np.int64),
            kinds=np.where(self.revolute, JOINT.revolute, JOINT.prismatic),
            axes=self.axes,
            offsets=np.diff(self.origins, axis=0, prepend=0.0),
            columns=self.inputs,
            ratios=self.ratios,
        )
        return chain_arrays(joints, np.array([n]), (self.end - self.origins[-1])[None], np.eye(3)[None])

    def forward(self, q: Array) -> tuple[Array, Array]:
        """FK: position (3,) [m] and orientation (3, 3) of the end at joint positions q, (k,)."""
        axes = np.empty((len(self.names), 3))
        end = np.empty((1, 3))
        turn = np.empty((1, 3, 3))
        kernels.placements(self.chain, np.array(q, dtype=float), axes, np.empty_like(axes), end, turn)
        return end[0], turn[0]


def joints_in_base_frame(
    names: Iterable[str],
    revolute: NDArray[np.bool_],
    axes: Array,
    stations: Array,
    columns: NDArray[np.intp],
    ratios: Array,
    limits: Array,
) -> ModuleJoints:
    """Describe consecutive joints as a module.

    Args:
        names: names of the joints, (n,).
        revolute: True for revolute joints, (n,).
        axes: unit axes, (n, 3), world frame.
        stations: the base of the module, a point on each axis, and its end, (n + 2, 3) [m], world frame.
        columns: degree of freedom of each joint, (n,).
        ratios: motion relative to its degree of freedom, (n,).
        limits: smallest and largest positions of these degrees of freedom in the order of the joints, (2, k).
    """
    base = stations[0]
    end = stations[-1]
    frame = _base_frame(end - base, axes)
    numbers = {column: number for number, column in enumerate(dict.fromkeys(columns.tolist()))}
    return ModuleJoints(
        names=tuple(names),
        revolute=np.ascontiguousarray(revolute),
        axes=np.ascontiguousarray(axes @ frame),
        origins=np.ascontiguousarray((stations[1:-1] - base) @ frame),
        end=(end - base) @ frame,
        inputs=np.array([numbers[column] for column in columns.tolist()], dtype=np.int64),
        ratios=np.ascontiguousarray(ratios, dtype=float),
        lower=np.array(limits[0], dtype=float),
        upper=np.array(limits[1], dtype=float),
        base=np.array(base),
        frame=frame,
    )


def _base_frame(span: Array, axes: Array) -> Array:
    """Return the axes of the base frame of a module as columns, (3, 3), in the frame of the arguments."""
    length = float(np.linalg.norm(span))
    x = span / length if length > 0.0 else axes[0]
    across = axes - np.outer(axes @ x, x)
    sizes = np.linalg.norm(across, axis=1)
    least = 1e-3  # sine of the angle between the axis of a joint and of the module at which it bends that
    first = int(np.argmax(sizes > least))
    y = across[first] if sizes[first] > least else np.cross(x, np.eye(3)[np.argmin(np.abs(x))])
    y = y / np.linalg.norm(y)
    return np.column_stack([x, y, np.cross(x, y)])


Recogniser: TypeAlias = Callable[[ModuleJoints], ModuleKinematics | None]
"""Returns the kinematics of a module with these joints; None if it is another kind of module."""


class _Registry:
    """Functions that recognise modules, latest first, and the number of changes to them."""

    functions: tuple[Recogniser, ...] = ()
    changes: int = 0

    def set(self, functions: Iterable[Recogniser]) -> None:
        self.functions = tuple(functions)
        self.changes = self.changes + 1


_registry = _Registry()


def register_module_kinematics(recognise: Chosen) -> Chosen:
    """Register custom kinematics for modules that a function recognises.

    Arms loaded afterwards are split into such modules where they fit (`Arm.load` with `modules=None`), and
    Algorithm 1 uses these kinematics to place such modules in every arm. The latest registration takes
    precedence, and all of them precede the library's own. Other processes, such as the workers of a batch,
    must register them too.

        @register_module_kinematics
        def recognise(joints: ModuleJoints) -> ModuleKinematics | None: ...

    Args:
        recognise: takes `ModuleJoints` and returns the `ModuleKinematics`, or None.

    Returns:
        The function, so that this can be used as a decorator.

    Raises:
        InvalidValue: not a function.
    """
    if not callable(recognise):
        raise InvalidValue("recognise", recognise, "a function of ModuleJoints")
    _registry.set((recognise, *_registry.functions))  # type: ignore[arg-type]
    return recognise


def unregister_module_kinematics(recognise: Recogniser) -> None:
    """Remove a function given to `register_module_kinematics`.

    Raises:
        InvalidValue: it is not registered.
    """
    if recognise not in _registry.functions:
        raise InvalidValue("recognise", recognise, "a function that was registered")
    _registry.set(function for function in _registry.functions if function is not recognise)


def registry_state() -> int:
    """Return a number that changes with every registration; 0 before the first."""
    return _registry.changes


def is_registry_empty() -> bool:
    """Return whether no custom kinematics are registered."""
    return not _registry.functions


def registered_kinematics(joints: ModuleJoints) -> ModuleKinematics | None:
    """Return the registered kinematics of a module, or None.

    Raises:
        InvalidValue: a function returns another type, or kinematics that contradict the joints.
    """
    for recognise in _registry.functions:
        kinematics = recognise(joints)
        if kinematics is not None:
            _check(recognise, kinematics, joints)
            return kinematics
    return None


def end_of(kinematics: ModuleKinematics, q: Array) -> tuple[Array, Array]:
    """Return the position (3,) [m] and the orientation (3, 3) of the end of a module, as its FK says.

    Raises:
        InvalidValue: it returns something else; names its class.
    """
    what = f"{type(kinematics).__name__}.forward(q)"
    end = kinematics.forward(q)
    if not (isinstance(end, tuple | list) and len(end) == 2):
        raise InvalidValue(what, end, "two arrays: a position, (3,) [m], and an orientation, (3, 3)")
    position = finite_array(f"{what}, position", end[0], (3,))
    return position, finite_array(f"{what}, orientation", end[1], (3, 3))


def positions_for(kinematics: ModuleKinematics, p: Array) -> Iterator[Array]:
    """Yield the joint positions, (k,) each, that put the end of a module at p, (3,) [m], as its IK says.

    Raises:
        InvalidValue: it returns something else; names its class.
    """
    what = f"{type(kinematics).__name__}.inverse(p)"
    solutions = kinematics.inverse(p)
    if not isinstance(solutions, Iterable) or isinstance(solutions, str):
        raise InvalidValue(what, solutions, "a list of joint positions; empty if the point is out of reach")
    for number, solution in enumerate(solutions):
        yield finite_array(f"{what}[{number}]", solution, (kinematics.dof,))


def point_after(kinematics: ModuleKinematics, base: pin.SE3, curve: Curve, start: float) -> float | None:
    """Return the next point of a curve that the end of a module can reach, as its TP says; None without one.

    Raises:
        InvalidValue: it returns something else; names its class.
    """
    crossing = kinematics.target_point(base, curve, start)
    if crossing is None:
        return None
    if not (is_number(crossing) and start < crossing <= curve.length * (1.0 + 1e-12)):
        allowed = f"an arc length above {start:.6g} m, at most {curve.length:.6g} m, or None"
        raise InvalidValue(f"{type(kinematics).__name__}.target_point(...)", crossing, allowed)
    return float(crossing)


def _check(recognise: Recogniser, kinematics: object, joints: ModuleJoints) -> None:
    """Compare kinematics with the joints, within their own `tolerance` if they have one."""
    name = f"module kinematics of {getattr(recognise, '__qualname__', recognise)!s}"
    if not isinstance(kinematics, ModuleKinematics):
        raise InvalidValue(
            name, kinematics, "ModuleKinematics: dof, reach, forward, inverse and target_point"
        )
    listed = ", ".join(joints.names)
    if not (is_whole(kinematics.dof) and kinematics.dof == joints.dof):
        raise InvalidValue(f"{name}: dof", kinematics.dof, f"{joints.dof}, as joints {listed} have")
    length = max(require_positive(f"{name}: reach", kinematics.reach), float(np.linalg.norm(joints.end)))
    most = (
        require_positive(f"{name}: tolerance", getattr(kinematics, "tolerance", 0.0), zero=True) or CONVERGED
    )
    low = np.maximum(joints.lower, -np.pi)
    high = np.minimum(joints.upper, np.pi)
    low, high = np.minimum(low, high), np.maximum(low, high)
    for q in np.random.default_rng(0).uniform(low, high, (8, joints.dof)):
        position, turn = joints.forward(q)
        at, facing = end_of(kinematics, q)
        apart = float(np.linalg.norm(at - position)) / length
        turned = float(np.linalg.norm(facing - turn))
        if not max(apart, turned) <= most:
            values = ", ".join(f"{value:.4g}" for value in q)
            allowed = (
                f"the placement to which joints {listed} move the end, to {most:g}: "
                f"{apart:.3g} reaches and {turned:.3g} rad off"
            )
            raise InvalidValue(f"{name}: forward([{values}])", at.tolist(), allowed)
