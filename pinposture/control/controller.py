"""The controller protocol: arguments, the step returned, the memory between steps; and the simplest one."""

from __future__ import annotations

from collections import UserDict
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from traceback import extract_tb
from typing import Any, NamedTuple, Protocol, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from pinposture._validation import LARGEST_COORDINATE, is_whole
from pinposture.arm import ArmState
from pinposture.control.limits import LimitedStep, Limits, require_limits
from pinposture.errors import ControllerError, InvalidValue, PostureError, is_interruption
from pinposture.placement import Target
from pinposture.placement.target import check_numbers

Array = NDArray[np.float64]
SomeMemory = TypeVar("SomeMemory", bound="Memory")

OWN = "pinposture."
"""Prefix of the module names of this library."""


Info = bool | int | float | str | NDArray[Any]
"""What a controller may report beside a step: a number, text, or an array of one shape in all steps."""


CONSTRAINTS = (
    "position limit",
    "velocity limit",
    "acceleration limit",
    "jerk limit",
    "torque limit",
    "margin",
    "constraint",
)
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


def checked_limits(state: ArmState, target: Target, limits: Limits | None, memory: object = None) -> Limits:
    """Return the limits of a step, `Limits()` for None; the arguments are those of `Controller.step`.

    Raises:
        InvalidValue: an argument has the wrong type, or the target or the memory does not fit the arm.
    """
    if not isinstance(state, ArmState):
        raise InvalidValue("state", state, "an ArmState, as `arm.at(q)` returns it")
    if not isinstance(target, Target):
        raise InvalidValue("target", target, "a Target, as `resolve_targets` returns it")
    check_numbers(target, state.arm)
    if memory is not None:
        if not isinstance(memory, Memory):
            raise InvalidValue("memory", memory, "`step.memory` of the previous step, or None")
        if not _is_displacement(memory.dq, state.arm.nv):
            allowed = f"the previous step, an array of {state.arm.nv} finite numbers"
            raise InvalidValue("memory.dq", memory.dq, allowed)
    return require_limits(limits)


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
    name = type(controller).__name__
    step = call_own(name, "step(...)", controller.step, state, target, limits, memory)
    if not isinstance(step, Step):
        allowed = "a Step, for instance Step(limited.dq, clipped=limited.clipped)"
        raise InvalidValue(f"{name}.step(...) (returned)", step, allowed)
    if not type(controller).__module__.startswith(OWN):  # ours are tested for this; checks cost time
        info = call_own(name, "step(...).info", _read_info, step.info)  # values may be computed now
        step = step._replace(info=info)
        _require_valid(name, state, step)
    if step.clipped is None:
        step = step._replace(clipped=np.zeros(state.arm.nv, dtype=np.bool_))
    return step if step.memory is not None else step._replace(memory=Memory(step.dq))


def call_own(owner: str, call: str, function: Callable[..., Any], *arguments: object) -> Any:
    """Return the result of code of the user that runs in control loops, which then can hold and say why.

    Args:
        owner: the class of the object that is called, or the name of a function.
        call: its method and arguments, for messages; empty for a function.
        function: what is called.
        arguments: its arguments.

    Raises:
        ControllerError: it raised an exception that is no `PostureError`; its cause is the exception.
        KeyboardInterrupt: it was interrupted, also in compiled code.
    """
    try:
        return function(*arguments)
    except PostureError:
        raise
    except Exception as error:
        if is_interruption(error):
            raise KeyboardInterrupt from error
        raise ControllerError(owner, describe_exception(error), call) from error


def describe_exception(error: Exception) -> str:
    """Return an exception in words, with the last line in the file of the called function that led to it."""
    words = " ".join(f"{type(error).__name__}: {error}".split())
    frames = extract_tb(error.__traceback__)[1:]  # without that of the caller
    if not frames:  # the call itself failed
        return words
    file = frames[0].filename
    line = [frame.lineno for frame in frames if frame.filename == file][-1]
    return f"{words} ({Path(file).name}, line {line})"


def _read_info(info: Mapping[str, Info]) -> Mapping[str, Info]:
    return dict(info) if isinstance(info, Mapping) else info


def _require_valid(name: str, state: ArmState, step: Step) -> None:
    """Raise InvalidValue unless the fields of a step have the right types and fit the arm."""
    active = step.active
    nv = state.arm.nv
    if not _is_displacement(step.dq, nv):
        allowed = f"an array of {nv} finite numbers, as `limits.apply(state, dq).dq`"
        raise _invalid(name, "dq", step.dq, allowed)
    points = range(state.arm.n_modules)
    if not (isinstance(active, tuple) and all(is_whole(point) and point in points for point in active)):
        allowed = f"a tuple of control points from 0 to {len(points) - 1}; () if none are active"
        raise _invalid(name, "active", active, allowed)
    if step.clipped is not None and not _is_mask(step.clipped, nv):
        allowed = f"{nv} times True or False, as `limits.apply(state, dq).clipped`; None if no joint was"
        raise _invalid(name, "clipped", step.clipped, allowed)
    if not isinstance(step.reason, str):
        raise _invalid(name, "reason", step.reason, "text; empty if the arm moves")
    for field in ("error_increasing", "following_path"):
        if not isinstance(getattr(step, field), bool | np.bool_):
            raise _invalid(name, field, getattr(step, field), "True or False")
    for field in ("violated_constraints", "near"):
        texts = getattr(step, field)
        if not (isinstance(texts, tuple) and all(isinstance(text, str) for text in texts)):
            raise _invalid(name, field, texts, "a tuple of texts; () if there are none")
    if not isinstance(step.info, Mapping):
        raise _invalid(name, "info", step.info, 'a mapping, as {"sigma_min": 0.1}')
    for key, value in step.info.items():
        if not (isinstance(key, str) and key.isidentifier()):
            raise _invalid(name, "info (name)", key, "a name of letters, digits and underscores")
        _require_info(name, key, value)
    _require_memory(name, step.memory, nv)


def _require_info(name: str, key: str, value: Info) -> None:
    """Raise InvalidValue unless a value is a number, text, or an array of them, none of them NaN."""
    allowed = "a number, text, or an array of them, not NaN"
    try:
        array = np.asarray(value)
    except ValueError:  # lists of unequal lengths
        raise _invalid(name, f"info[{key!r}]", value, allowed) from None
    if array.dtype.kind not in "biufU" or (array.dtype.kind == "f" and np.isnan(array).any()):
        raise _invalid(name, f"info[{key!r}]", value, allowed)


def _require_memory(name: str, memory: object, nv: int) -> None:
    """Raise InvalidValue unless it is a memory whose motion is that of an arm, or None."""
    if memory is None:
        return
    if not isinstance(memory, Memory):
        raise _invalid(name, "memory", memory, "a Memory(dq), or a class derived from it; or None")
    names = vars(type(memory))
    if "__init__" in names and "__dataclass_fields__" not in names:
        raise _invalid(name, "memory", memory, "a Memory(dq), or a dataclass derived from it")
    if not _is_displacement(memory.dq, nv):
        raise _invalid(name, "memory.dq", memory.dq, f"the step, an array of {nv} finite numbers")
    stopping = memory.stopping
    if stopping is not None and not (
        isinstance(stopping, np.ndarray)
        and stopping.ndim == 2
        and all(_is_displacement(row, nv) for row in stopping)
    ):
        raise _invalid(name, "memory.stopping", stopping, f"an array of steps, (k, {nv}), or None")


def _is_displacement(value: object, nv: int) -> bool:
    """Return whether a value is an array of finite numbers, (nv,)."""
    if not (isinstance(value, np.ndarray) and value.shape == (nv,) and value.dtype.kind in "iuf"):
        return False
    if value.dtype.kind == "f" and np.vdot(value, value) <= LARGEST_COORDINATE**2:  # as in nearly every call
        return True
    return bool(np.all(np.abs(value) <= LARGEST_COORDINATE))


def _is_mask(value: object, nv: int) -> bool:
    """Return whether a value is nv truth values."""
    try:
        mask = np.asarray(value)
    except ValueError:
        return False
    return mask.shape == (nv,) and mask.dtype.kind == "b"


def _invalid(name: str, field: str, value: object, allowed: str) -> InvalidValue:
    return InvalidValue(f"{name}.step(...).{field}", value, allowed)


@dataclass(frozen=True)
class JointInterpolation:
    """Moves all joints along a straight line in joint space to the configuration of the target.

    It arrives exactly, in few steps and without a Jacobian, but ignores the motion of the control points:
    they sweep wide, and the posture error can grow before it falls.
    """

    name: str = "joint"

    def step(
        self, state: ArmState, target: Target, limits: Limits | None = None, memory: Memory | None = None
    ) -> Step:
        """Compute one step; see `Controller.step`.

        Raises:
            InvalidValue: the target has no known configuration.
        """
        if target.q is None:
            allowed = "a target with a known configuration, as `resolve_targets` returns it"
            raise InvalidValue("target.q", None, allowed)
        limits = require_limits(limits)
        target.check(state.arm)
        way = state.arm.difference(state.q, state.arm.nearest_turns(target.q, state.q))
        previous = memory.dq if memory is not None else None
        # Joints off the chain stay.
        limited = limits.apply(state, way * state.arm.moved, previous)
        return step_within(limited, np.flatnonzero(target.has_target).tolist())
