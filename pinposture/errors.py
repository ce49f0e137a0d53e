"""Errors and warnings. Each message names the thing at fault, its value and what is allowed."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from copy import copy
from difflib import get_close_matches
from pathlib import Path
from typing import Any

from pinposture.units import length_text


def _rebuild(cls: type[PostureError], args: tuple[Any, ...], data: dict[str, Any]) -> PostureError:
    error = cls.__new__(cls, *args)
    error.args = args
    error.__dict__.update(data)
    return error


class PostureError(Exception):
    """Base class of the errors of this package.

    Attributes:
        reasons: all reasons of a refusal that has several, which its message lists; else empty.
    """

    reasons: tuple[PostureError, ...] = ()

    def __reduce__(self) -> tuple[Any, ...]:
        # Errors cross process borders in studies; the default would call __init__ with the message.
        return _rebuild, (type(self), self.args, self.__dict__)

    def __str__(self) -> str:  # KeyError and OSError would format the message in their own ways
        text = str(self.args[0]) if self.args else ""
        longest = 4000  # names of files may have any length
        half = longest // 2
        return text if len(text) <= longest else f"{text[:half]} ... {text[-half:]}"


def gather(*checks: Callable[[], object]) -> list[PostureError]:
    """Make independent checks; return the errors that they raise, in order."""
    faults = []
    for check in checks:
        try:
            check()
        except PostureError as error:
            faults.append(error)
    return faults


def raise_together(errors: Sequence[PostureError]) -> None:
    """Raise the only error, or one like the first whose message lists all; do nothing without errors."""
    listed = [reason for error in errors for reason in (error.reasons or (error,))]
    if len(listed) == 1:
        raise listed[0]
    if listed:
        combined = copy(listed[0])
        combined.args = (numbered([str(reason) for reason in listed]),)
        combined.reasons = tuple(listed)
        raise combined from listed[0]


def numbered(reasons: Sequence[str]) -> str:
    """Return one reason as it is, several with their number and counted."""
    if len(reasons) == 1:
        return reasons[0]
    return " ".join(
        [f"{len(reasons)} reasons:", *(f"({k}) {reason}" for k, reason in enumerate(reasons, start=1))]
    )


class PostureWarning(UserWarning):
    """An input was interpreted or corrected in a way that the user may not expect."""


def is_interruption(error: BaseException | None) -> bool:
    """Return whether an error is a KeyboardInterrupt, or what compiled code makes of one: a SystemError."""
    if isinstance(error, SystemError):
        return is_interruption(error.__cause__)
    return isinstance(error, KeyboardInterrupt)


def warn_caller(message: str) -> None:
    """Issue a PostureWarning that points to the line outside of this package from which it was called."""
    between = {"pinposture", "functools", "contextlib", "pydantic"}  # and what calls it from within itself
    level = 2
    frame = sys._getframe(1)
    while frame.f_back is not None and frame.f_globals.get("__name__", "").split(".")[0] in between:
        level = level + 1
        frame = frame.f_back
    shown: dict[object, object] = frame.f_globals.get("__warningregistry__", {})
    if len(shown) > 1000:  # Python remembers warnings, not to repeat them; a loop may give millions
        shown.clear()
    warnings.warn(message, PostureWarning, stacklevel=level)


@contextmanager
def no_warnings() -> Iterator[None]:
    """Suppress PostureWarnings, for instance those that have been given before."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", PostureWarning)
        yield


def did_you_mean(name: object, known: Iterable[str]) -> str:
    """Return a question about the most similar of the known names, with a leading blank, or ""."""
    close = get_close_matches(name, tuple(known), n=1) if isinstance(name, str) else ()
    return f" (did you mean {close[0]!r}?)" if close else ""


def install(extra: str) -> str:
    """Return the command that installs what an optional part of the library needs."""
    return f"pip install 'pinposture[{extra}]'"


def enumerated(items: Iterable[str], most: int = 6, between: str = ", ") -> str:
    """Return the first items of a list for a message, and the number of the others."""
    listed = list(items)
    more = f" and {len(listed) - most} more" if len(listed) > most else ""
    return between.join(listed[:most]) + more


def _in_words(value: object) -> str:
    """Return the representation of a value on one line, truncated."""
    try:
        text = "not given" if value is None else " ".join(repr(value).split())  # arrays break over lines
    except ValueError:
        return "a number of thousands of digits"
    return text if len(text) < 120 else text[:117] + "..."


class InvalidValue(PostureError, ValueError):
    """A value of the wrong type, shape, size or sign, or one that is not finite.

    Attributes:
        name: name of the value.
        value: the value.
        allowed: which values are allowed.
    """

    def __init__(self, name: str, value: object, allowed: str) -> None:
        self.name = name
        self.value = value
        self.allowed = allowed
        super().__init__(f"{name} is {_in_words(value)}; allowed: {allowed}")


class UnknownName(PostureError, KeyError):
    """A name (template, controller, frame, joint, preset) that does not exist.

    Attributes:
        kind: kind of thing, e.g. "controller".
        name: the unknown name.
        allowed: the names that exist.
    """

    def __init__(self, kind: str, name: object, allowed: Iterable[str]) -> None:
        self.kind = kind
        self.name = name
        self.allowed = tuple(allowed)
        listed = ", ".join(self.allowed[:12]) + (", ..." if len(self.allowed) > 12 else "")
        hint = did_you_mean(name, self.allowed)
        words = repr(name) if isinstance(name, str | None) else _in_words(name)
        super().__init__(f"no {kind} is called {words}{hint}; there are: {listed or 'none'}")


class FileError(PostureError, OSError):
    """A file that is missing, unreadable, or of the wrong content.

    Attributes:
        path: the file.
        reason: what is wrong with it.
    """

    def __init__(self, path: str | Path, reason: str) -> None:
        self.path = Path(path)
        self.reason = reason
        super().__init__(f"{path}: {reason}")


class URDFError(PostureError, ValueError):
    """A robot description that cannot be used.

    Attributes:
        source: the file, or "URDF text".
        element: the link or joint at fault, e.g. "joint 'elbow'".
        reason: what is wrong with it and what was allowed.
    """

    def __init__(self, source: str, element: str, reason: str) -> None:
        self.source = source
        self.element = element
        self.reason = reason
        super().__init__(f"{source}: {element}: {reason}")


class WeightUnknown(PostureError, ValueError):
    """Torques or sag that cannot be computed or judged: masses, torque limits or stiffness are not known.

    Attributes:
        what: what is not known, "mass", "torque limit" or "stiffness".
        names: the links or joints of which it is not known.
    """

    def __init__(self, what: str, names: Iterable[str], remedy: str) -> None:
        self.what = what
        self.names = tuple(names)
        self.remedy = remedy
        owner = "link" if what == "mass" else "joint"
        one = len(self.names) == 1
        listed = enumerated(map(repr, self.names))
        subject = (
            f"the {what} of {owner} {listed} is" if one else f"the {_plural(what)} of {owner}s {listed} are"
        )
        super().__init__(f"{subject} not known; {remedy}")


class NoEquilibrium(PostureError, ValueError):
    """A posture in which elastic joints do not hold the arm: it buckles, or falls to another one.

    Attributes:
        name: name of the value that describes the posture.
        joint: the joint that gives way.
        share: the share of the load up to which the joints hold it; None if that is not known.
    """

    def __init__(self, name: str, joint: str, share: float | None = None) -> None:
        self.name = name
        self.joint = joint
        self.share = share
        most = "" if share is None else f" beyond {100.0 * share:.2g} % of the load"
        advice = "allowed: a posture with less load on it, a lighter load, or stiffer joints"
        super().__init__(f"{name}: the arm has no stable rest, joint {joint!r} gives way{most}; {advice}")


def _plural(word: str) -> str:
    return f"{word}es" if word.endswith("s") else f"{word}s"


class CurveError(PostureError, ValueError):
    """Points or parameters that do not describe a curve, or a curve far too long for the arm.

    Attributes:
        what: the part of the input at fault, e.g. "point 3".
        reason: what is wrong with it and what was allowed.
    """

    def __init__(self, what: str, reason: str) -> None:
        self.what = what
        self.reason = reason
        super().__init__(f"{what}: {reason}")


class UnsupportedModule(PostureError):
    """A module without a kinematics solver (FK, IK, TP).

    Attributes:
        module: index of the module, 1-based as in the thesis.
        joints: names of its joints.
        reason: why none of the solvers applies.
    """

    def __init__(self, module: int, joints: Iterable[str], reason: str) -> None:
        self.module = module
        self.joints = tuple(joints)
        self.reason = reason
        listed = ", ".join(self.joints[:4]) + (", ..." if len(self.joints) > 4 else "")
        super().__init__(f"module {module} (joints {listed}): {reason}")


class TargetError(PostureError):
    """A curve on which a module cannot be placed (Section 4.2).

    Attributes:
        module: index of the first module that could not be placed, 1-based.
        parameter: arc length of its base along the curve [m].
        reason: why, and how to correct it.
    """

    def __init__(self, module: int, parameter: float, reason: str) -> None:
        self.module = module
        self.parameter = parameter
        self.reason = reason
        super().__init__(f"module {module} (its base at {length_text(parameter)} along the curve): {reason}")


class CurveEndsEarly(TargetError):
    """The curve ends before the last module is placed."""


class CurveLeavesTooSharply(TargetError):
    """The curve leaves the base in a direction that the first module cannot follow."""


class CurveBendsTooMuch(TargetError):
    """The curve bends more than a module can within its joint limits, or leaves the plane of the module."""


class CurveOutOfReach(TargetError):
    """The curve is beyond the range of the prismatic joints."""


class ControllerError(PostureError):
    """An exception in a controller, constraint, task or null objective of yours, which is its cause.

    Attributes:
        controller: the class of the controller or task, or the name of the constraint or function.
        reason: the exception, in words.
        call: the method that raised it, with its arguments; empty for a function.
    """

    def __init__(self, controller: str, reason: str, call: str = "step(...)") -> None:
        self.controller = controller
        self.reason = reason
        self.call = call
        super().__init__(f"{controller}{'.' if call else ''}{call} raised {reason}")


class ReachError(PostureError):
    """A goal of the tip, or of control points, for which no clear posture was found.

    Attributes:
        position: the goal, three coordinates [m], world frame; of several, the last.
        reason: why, and how close the search came.
    """

    def __init__(self, position: Iterable[float], reason: str, who: str = "the tip") -> None:
        self.position = tuple(float(number) for number in position)
        self.reason = reason
        listed = ", ".join(f"{number:.4g}" for number in self.position)
        super().__init__(f"{who} cannot reach ({listed}) m: {reason}")


class OutOfReach(ReachError):
    """A goal that is farther away than the arm reaches, or off the plane of a planar arm."""


class TaskError(PostureError, ValueError):
    """A task that is inconsistent, or that the arm cannot perform.

    Attributes:
        where: the part of the task at fault, e.g. "keyframe 3 'coil'".
        reason: what is wrong with it, and how to correct it.
    """

    def __init__(self, where: str, reason: str) -> None:
        self.where = where
        self.reason = reason
        super().__init__(f"{where}: {reason}")


class MotionError(PostureError, ValueError):
    """A motion that should not be sent to a robot.

    Attributes:
        faults: its faults, in words.
    """

    def __init__(self, faults: Iterable[str]) -> None:
        self.faults = tuple(faults)
        advice = "force=True (--force) overrides this"
        super().__init__(f"the motion should not be sent to a robot: {'; '.join(self.faults)}; {advice}")


class ProcessError(PostureError, RuntimeError):
    """Processes that were ended from outside, for instance because memory was short.

    Attributes:
        done: number of calls whose results were returned before.
        left: number of the others.
    """

    def __init__(self, done: int, left: int) -> None:
        self.done = done
        self.left = left
        reason = "processes were ended again and again, perhaps because memory is short"
        super().__init__(f"{left} of {done + left} calls were not made: {reason}; start fewer (jobs=1)")


class ViewerError(PostureError, ConnectionError):
    """A viewer that cannot be started or reached.

    Attributes:
        viewer: the viewer.
        reason: why it cannot be.
    """

    def __init__(self, viewer: str, reason: str) -> None:
        self.viewer = viewer
        self.reason = reason
        super().__init__(f"{viewer}: {reason}")
