"""The controller protocol: its arguments, the step it returns, and its memory between steps."""

from __future__ import annotations

from collections import UserDict
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from traceback import extract_tb
from typing import Any, NamedTuple, Protocol, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from pinposture._validation import LARGEST_NUMBER, require_instance
from pinposture.arm import ArmState
from pinposture.control.limits import LimitedStep, Limits
from pinposture.errors import ControllerError, InvalidValue, PostureError
from pinposture.placement import Target

Array = NDArray[np.float64]
SomeMemory = TypeVar("SomeMemory", bound="Memory")

OWN = "pinposture."
"""Prefix of the module names of this library."""


Info = bool | int | float | str | NDArray[Any]
"""What a controller may report beside a step: a number, text, or an array of one shape in all steps."""


CONSTRAINTS = ("position limit", "velocity limit", "acceleration limit", "jerk limit", "margin", "constraint")
"""Names of the constraints that a step can violate."""


class LazyInfo(UserDict[str, Any]):
    """Values by name; those that are functions without arguments are called when they are first read.

    Singular values take as long as the step itself, and only a record reads them.
    """

    def __getitem__(self, name: str) -> Info:
        value = self.data[name]
        if callable(value):
            value = value()
            self.data[name] = value
        return cast(Info, value)

    def __reduce__(self) -> tuple[Any, ...]:
        return dict, (dict(self),)


@dataclass(frozen=True, eq=False)
class Memory:
    """State of a controller between steps; derive a class to keep more.

    Attributes:
        dq: the previous step, (nv,) [rad or m].
        stopping: steps that bring the arm to rest from there, within its limits and clear of the known
            obstacles, (k, nv) [rad or m]. If None or used up, `Limits.hold` brakes.
    """

    dq: Array
    stopping: Array | None = None

    def braked(self: SomeMemory, limits: Limits, state: ArmState) -> SomeMemory:
        """Return the memory after a braking step; its `dq` is that step."""
        if self.stopping is None or not len(self.stopping):
            return replace(self, dq=limits.hold(state, self.dq).dq)
        return replace(self, dq=self.stopping[0], stopping=self.stopping[1:])

    def with_motion_of(self: SomeMemory, other: Memory) -> SomeMemory:
        """Return this memory with `dq` and `stopping` of another one."""
        return replace(self, dq=other.dq, stopping=other.stopping)


NO_INFO: Mapping[str, Info] = {}
"""What most controllers report beside their steps."""


class Step(NamedTuple):
    """One control step; `Step(dq)` is one, the other fields are optional.

    Attributes:
        dq: joint displacement within the limits, (nv,) [rad or m].
        active: the active control set: indices of control points, 0-based, increasing.
        clipped: which joints were clipped at a position limit, (nv,); without it, `next_step` adds that none
            were.
        reason: why the arm does not move; empty if it does.
        error_increasing: whether the posture error rises in this step, or may rise because the step leaves a
            local minimum.
        violated_constraints: messages on the constraints that this step violates because not all could be
            met, in the order in which they were relaxed. Each begins with a name of `CONSTRAINTS`.
        near: messages naming the distances to obstacles that limit the step.
        following_path: whether the step makes progress along a path to the target, on which the posture
            error may rise.
        info: what else the controller reports: numbers, texts or arrays by name, which a run records as
            columns, `Run.info`. The methods of the thesis report the smallest "manipulability" index of an
            active point, relative to the base and to the previous active point, in [0, 1] (for Projection,
            that of a section within its manipulability space); "sigma_min" and "sigma_max", the extreme
            singular values of the posture control matrix [m/rad], and its number of "rows"; "scale", the
            factor by which the step was shortened to meet the step limit, in (0, 1]. Selection also reports
            the control points "dropped" because the stacked matrix was too close to singular, (m,); Switching
            its "method", and why it "switched" to that in this step.
        memory: the memory to pass to the next step; without one, `next_step` adds `Memory(dq)`.
    """

    dq: Array
    active: tuple[int, ...] = ()
    clipped: NDArray[np.bool_] = cast("NDArray[np.bool_]", None)  # a run only meets steps that have it
    reason: str = ""
    error_increasing: bool = False
    violated_constraints: tuple[str, ...] = ()
    near: tuple[str, ...] = ()
    following_path: bool = False
    info: Mapping[str, Info] = NO_INFO
    memory: Memory = cast(Memory, None)  # likewise


def step_within(
    limited: LimitedStep,
    active: Iterable[int] = (),
    reason: str = "",
    info: Mapping[str, Info | Callable[[], Info]] = NO_INFO,
) -> Step:
    """Return a step from its limited displacement, of which it reports the scale beside `info`."""
    return Step(
        limited.dq,
        tuple(active),
        limited.clipped,
        reason,
        info=LazyInfo({"scale": limited.scale, **info}),
        memory=Memory(limited.dq),
    )


class Controller(Protocol):
    """Interface of controllers: `step` moves an arm one step towards a target."""

    @property
    def name(self) -> str:
        """Short name, as `track(controller=...)` takes it."""

    def step(
        self, state: ArmState, target: Target, limits: Limits | None = None, memory: Memory | None = None
    ) -> Step:
        """Compute one step.

        Args:
            state: the state of the arm.
            target: the target posture.
            limits: the limits of the step; `Limits()` if None.
            memory: `memory` of the previous step. None: the arm is at rest, and the controller replans or
                starts with its first method.
        """


def require_step_arguments(state: ArmState, target: Target, memory: object = None) -> None:
    """Raise InvalidValue if an argument of a step has the wrong type, or the target does not fit the arm."""
    require_instance("state", state, ArmState, "an ArmState, as `arm.at(q)` returns it")
    require_instance("target", target, Target, "a Target, as `resolve_targets` returns it")
    if not (memory is None or isinstance(memory, Memory)):
        raise InvalidValue("memory", memory, "`step.memory` of the previous step, or None")
    target.check_numbers(state.arm)


def task_errors(state: ArmState, target: Target) -> Array:
    """Return the errors c_k - p_k of all control points, zero for those without a target.

    Returns:
        Array (m, d) [m]: in world axes, or in the plane of a planar arm.
    """
    errors = target.errors(state.points)
    return errors if state.arm.dimension == 3 else errors @ state.arm.plane.T


def stack_rows(jacobians: Array) -> Array:
    """Stack Jacobians (N, d, n) into one matrix (N d, n)."""
    return jacobians.reshape(-1, jacobians.shape[-1])


def next_step(
    controller: Controller, state: ArmState, target: Target, limits: Limits | None, memory: Memory | None
) -> Step:
    """Return the step of a controller; if it has no memory, add one with its displacement.

    Raises:
        InvalidValue: the controller returned something other than a valid `Step` for this arm.
        ControllerError: it raised an exception that is no `PostureError`.
    """
    try:
        step = controller.step(state, target, limits, memory)
    except PostureError:
        raise
    except Exception as error:
        raise ControllerError(type(controller).__qualname__, describe_exception(error)) from error
    if not isinstance(step, Step):
        allowed = "a Step, for instance Step(limited.dq, clipped=limited.clipped)"
        raise InvalidValue(f"{type(controller).__name__}.step(...) (returned)", step, allowed)
    if not type(controller).__module__.startswith(OWN):  # ours are tested for this; checks cost time
        _require_valid(controller, state, step)
    if step.clipped is None:
        step = step._replace(clipped=np.zeros(state.arm.nv, dtype=np.bool_))
    return step if step.memory is not None else step._replace(memory=Memory(step.dq))


def describe_exception(error: Exception) -> str:
    """Return an exception in words, with the last line in the file of the called function that led to it."""
    words = " ".join(f"{type(error).__name__}: {error}".split())
    frames = extract_tb(error.__traceback__)[1:]  # without that of the caller
    if not frames:  # the call itself failed
        return words
    file = frames[0].filename
    line = [frame.lineno for frame in frames if frame.filename == file][-1]
    return f"{words} ({Path(file).name}, line {line})"


def _require_valid(controller: Controller, state: ArmState, step: Step) -> None:
    """Raise InvalidValue unless the fields of a step have the right types and fit the arm."""
    dq = step.dq
    active = step.active
    nv = state.arm.nv
    if not (isinstance(dq, np.ndarray) and dq.shape == (nv,) and np.all(np.abs(dq) <= LARGEST_NUMBER)):
        allowed = f"an array of {nv} finite numbers, as `limits.apply(state, dq).dq`"
        raise _invalid(controller, "dq", dq, allowed)
    if not isinstance(active, tuple) or (
        active and not 0 <= min(active) <= max(active) < state.arm.n_modules
    ):
        allowed = f"a tuple of control points from 0 to {state.arm.n_modules - 1}; () if none are active"
        raise _invalid(controller, "active", active, allowed)
    if step.clipped is not None and np.shape(step.clipped) != (nv,):
        allowed = f"{nv} times True or False, as `limits.apply(state, dq).clipped`; None if no joint was"
        raise _invalid(controller, "clipped", step.clipped, allowed)
    if not isinstance(step.reason, str):
        raise _invalid(controller, "reason", step.reason, "text; empty if the arm moves")
    for field in ("violated_constraints", "near"):
        texts = getattr(step, field)
        if not (isinstance(texts, tuple) and all(isinstance(text, str) for text in texts)):
            raise _invalid(controller, field, texts, "a tuple of texts; () if there are none")
    if not isinstance(step.info, Mapping):
        raise _invalid(controller, "info", step.info, 'a mapping, as {"sigma_min": 0.1}')
    for name, value in step.info.items():
        if not (isinstance(name, str) and name.isidentifier()):
            raise _invalid(controller, "info (name)", name, "a name of letters, digits and underscores")
        if np.asarray(value).dtype.kind not in "biufU":
            raise _invalid(controller, f"info[{name!r}]", value, "a number, text, or an array of them")
    if not (step.memory is None or isinstance(step.memory, Memory)):
        raise _invalid(controller, "memory", step.memory, "a Memory(dq), or a class derived from it; or None")


def _invalid(controller: Controller, field: str, value: object, allowed: str) -> InvalidValue:
    return InvalidValue(f"{type(controller).__name__}.step(...).{field}", value, allowed)
