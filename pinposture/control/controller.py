"""What every controller takes and returns."""

from __future__ import annotations

from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from pinposture.arm import ArmState
from pinposture.control.limits import Limits
from pinposture.placement import Target

Array = NDArray[np.float64]


class Spectrum(Protocol):
    """Singular values that are computed when they are asked for."""

    @property
    def smallest(self) -> float:
        """The smallest."""

    @property
    def largest(self) -> float:
        """The largest."""


class _Fields(NamedTuple):
    """What `Diagnostics` are made of: singular values, or what knows them."""

    manipulability: float
    sigma_min: float | Spectrum
    sigma_max: float | Spectrum
    rows: int
    dropped: tuple[int, ...]
    scale: float
    clipped: NDArray[np.bool_]
    reason: str
    method: str = ""
    switched: str = ""
    error_increasing: bool = False
    violated_constraints: tuple[str, ...] = ()
    near: tuple[str, ...] = ()
    following_path: bool = False


class Diagnostics(_Fields):
    """How a step came about.

    Singular values take longer than a step: those of Selection and Projection are computed when they are
    read.

    Attributes:
        manipulability: smallest manipulability index of an active point, relative to the base and to the
            active point before, in [0, 1]; of Projection, of a section within its manipulability space. 0 if
            no control point is active.
        sigma_min: smallest singular value of the posture control matrix [m/rad]; 0 if it is empty.
        sigma_max: largest singular value of the posture control matrix [m/rad]; 0 if it is empty.
        rows: number of rows of the posture control matrix.
        dropped: control points that cleared their conditions and were dropped because the stacked matrix
            was too close to singular, 0-based.
        scale: factor by which the step was shortened to meet the step limit, in (0, 1]; to keep clear of
            something, in [0, 1].
        clipped: which joints were cut short at a position limit, (nv,).
        reason: why the controller does not move; empty if it does.
        method: which of its methods a controller used that has several, by name; empty if it has one.
        switched: why it changed to that method in this step; empty if it did not.
        escape: True if the step leads out of a place where the posture error cannot fall, or round something,
            so that it may rise; of geodesic, where it does.
        violated_constraints: which constraints gave way in this step because not all could hold, in words,
            in the order in which they did.
        near: what distances to obstacles hold the step back, in words.
        following_path: True if the step gets on along a way that ends where the controller wants to be,
            whatever the posture error does on it.
    """

    __slots__ = ()

    @property
    def sigma_min(self) -> float:
        """Smallest singular value of the posture control matrix [m/rad]."""
        value = super().sigma_min
        return value if isinstance(value, float | int) else value.smallest

    @property
    def sigma_max(self) -> float:
        """Largest singular value of the posture control matrix [m/rad]."""
        value = super().sigma_max
        return value if isinstance(value, float | int) else value.largest

    def __getitem__(self, key: Any) -> Any:
        """Fields by their numbers; singular values as numbers here, too."""
        places = range(len(self._fields))[key]
        if isinstance(places, int):
            return getattr(self, self._fields[places])
        return tuple(getattr(self, self._fields[place]) for place in places)


class Memory(NamedTuple):
    """What a controller wants to know again at the next step.

    Attributes:
        dq: the previous step, (nv,) [rad or m].
        own: whatever else the controller keeps, for its own eyes.
        stopping: steps that bring the arm to rest from there, within its limits and clear of what the
            controller knows, (k, nv) [rad or m]; None, or where they end: `Limits.hold` does.
    """

    dq: Array
    own: object = None
    stopping: Array | None = None

    def braked(self, limits: Limits, state: ArmState) -> Memory:
        """What is remembered after a step that brings the arm closer to rest; it is `dq` of that."""
        if self.stopping is None or not len(self.stopping):
            return self._replace(dq=limits.hold(state, self.dq).dq)
        return self._replace(dq=self.stopping[0], stopping=self.stopping[1:])


class Step(NamedTuple):
    """One control step.

    Attributes:
        dq: joint displacement within the limits, (nv,) [rad or m].
        active: the active control set, indices of control points, 0-based and increasing.
        diagnostics: how it came about.
        memory: to be passed to the next step.
    """

    dq: Array
    active: tuple[int, ...]
    diagnostics: Diagnostics
    memory: Memory


class Controller(Protocol):
    """Anything that moves an arm one step towards a target."""

    @property
    def name(self) -> str:
        """Short name, as `track(controller=...)` takes it."""

    def step(
        self, state: ArmState, target: Target, limits: Limits | None = None, memory: Memory | None = None
    ) -> Step:
        """Compute one step.

        Args:
            state: where the arm is.
            target: where its control points should be.
            limits: what the step may not exceed; `Limits()` if None.
            memory: `memory` of the previous step; None at the first. Without it a controller that plans plans
                anew, one that takes turns forgets whose it is, and the arm is taken to be at rest.
        """


def task_errors(state: ArmState, target: Target) -> Array:
    """Errors c_k - p_k of all control points, zero for those without a target.

    Returns:
        Array (m, d) [m]: in world axes, or along the plane of a planar arm.
    """
    errors = (target.points - state.points) * target.has_target[:, None]
    return errors if state.arm.dimension == 3 else errors @ state.arm.plane.T


def stack_rows(jacobians: Array) -> Array:
    """Stack Jacobians (N, d, n) into one matrix (N d, n)."""
    return jacobians.reshape(-1, jacobians.shape[-1])


def next_step(
    controller: Controller, state: ArmState, target: Target, limits: Limits | None, memory: Memory | None
) -> Step:
    """The step of a controller; of one that remembers nothing, the displacement is remembered for it."""
    step = controller.step(state, target, limits, memory)
    return step if step.memory is not None else step._replace(memory=Memory(step.dq))
