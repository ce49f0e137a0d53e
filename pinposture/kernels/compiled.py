"""Functions that are compiled for the machine they run on: when, where the result is kept, how it is told.

A kernel is compiled once for an installation and user, for the arguments that its annotations name. Numba
keeps the machine code beside the source, or in the user's cache where it may not write there, or in
NUMBA_CACHE_DIR. It happens when a kernel is first called, or ahead of that by `load` and by
`pinposture compile`. Processes that want the same kernel at the same time compile it once: one does, the
others wait and load the result.
"""

from __future__ import annotations

import hashlib
import logging
import pickle
import re
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import cache
from inspect import signature
from pathlib import Path
from typing import Annotated, Any, TypeVar, cast, get_args, get_origin, get_type_hints

import numba
import numpy as np
from numba.core import event, types
from numba.core.compiler_lock import global_compiler_lock
from numba.core.sigutils import normalize_signature

try:
    import fcntl
except ImportError:  # not a POSIX system: processes may compile the same kernel, which costs time only
    fcntl = None  # type: ignore[assignment]

Function = TypeVar("Function", bound=Callable[..., object])

logger = logging.getLogger(__name__)

OPTIONS: Any = {"nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True}
"""What numba is told: kernels are called from Python and by each other, never from C."""

_NEWS = "compiling kernels, once for an installation and user; `pinposture compile` does all of it now"

_RECENT = 3600.0
"""How long other processes keep quiet after one has told the news [s]."""

_IMPORT = re.compile(r"^from pinposture\.kernels\.(\w+) import", re.MULTILINE)


def compiled(function: Function) -> Function:
    """Compile a function that works on arrays and numbers alone; it runs without holding the GIL.

    Divisions by zero give inf or NaN, as in NumPy. Arrays have to be C-contiguous, may be written to, and
    have the type and the number of dimensions that the annotations name: any other kind would be compiled for
    anew.
    """
    return _made(function, {})


def subkernel(function: Function) -> Function:
    """Compile a function that other kernels call, and Python never."""
    return _made(function, {"no_cpython_wrapper": True})


def _made(function: Function, options: dict[str, Any]) -> Function:
    made: Any = numba.njit(**OPTIONS, **options)(function)
    try:
        made.enable_caching()
    except RuntimeError:
        _say_that_nothing_is_kept()
    if (kept := _kept(made)) is not None:
        # Machine code contains the kernels that it calls, and numba looks at the file of the caller alone.
        kept._source_stamp = source_stamp(Path(function.__code__.co_filename))
        kept._load_index = _nothing_if_unreadable(kept._load_index)
        made.compile = _one_at_a_time(
            made.compile, Path(made._cache.cache_path) / f"{function.__name__}.lock"
        )
    return cast(Function, made)


def load(kernel: Any) -> None:
    """Compile a kernel for the arguments that it is annotated with, or load it from where it is kept."""
    if not kernel.signatures:
        kernel.compile(arguments_of(kernel))


def arguments_of(kernel: Any) -> tuple[types.Type, ...]:
    """What numba calls the arguments that a kernel is annotated with."""
    hints = get_type_hints(kernel.py_func, include_extras=True)
    return tuple(_type_of(hints[name]) for name in signature(kernel.py_func).parameters)


def _type_of(hint: Any) -> types.Type:
    """What numba calls the arguments that an annotation stands for."""
    if hint in _SCALARS:
        return _SCALARS[hint]
    if get_origin(hint) is Annotated:  # an array of `kernels.arrays`
        array, dimensions = get_args(hint)
        ((element,),) = (get_args(each) for each in get_args(array)[1:])
        return types.Array(numba.from_dtype(np.dtype(element)), dimensions, "C")
    named = hint if hasattr(hint, "_fields") else None
    fields = get_type_hints(hint, include_extras=True).values() if named else get_args(hint)
    return types.BaseTuple.from_types([_type_of(each) for each in fields], named)  # type: ignore[no-untyped-call]


_SCALARS = {float: types.float64, int: types.int64, bool: types.boolean}


def _one_at_a_time(compile_kernel: Callable[..., Any], lock: Path) -> Callable[..., Any]:
    """Let one process compile a kernel; the others wait, and find it where it is kept.

    A kernel that another one calls is locked after its caller, so nobody waits in a circle. Numba's own lock
    comes first, so that threads of one process do not either.
    """

    def compile_once(signature: Any) -> Any:
        arguments, _ = normalize_signature(signature)  # type: ignore[no-untyped-call]
        # A constant is a number like others, not a type of its own.
        arguments = tuple(types.unliteral(each) for each in arguments)  # type: ignore[no-untyped-call]
        with global_compiler_lock, _locked(lock):
            return compile_kernel(arguments)

    return compile_once


@contextmanager
def _locked(path: Path) -> Iterator[None]:
    """Hold a lock on a file; without one where files cannot be locked. It ends with the process."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        file = path.open("w")
    except OSError:  # a folder that can only be read
        yield
        return
    with file:
        if fcntl is not None:
            with suppress(OSError):  # a file system without locks
                fcntl.flock(file, fcntl.LOCK_EX)
        yield


def _nothing_if_unreadable(load_index: Callable[[], Any]) -> Callable[[], Any]:
    """Take an index for empty that cannot be read: it may name classes of another version of the library."""

    def load_or_start_anew() -> Any:
        try:
            return load_index()
        except (AttributeError, ImportError, EOFError, pickle.UnpicklingError):
            return {}

    return load_or_start_anew


def is_ready(kernel: Any) -> bool:
    """Whether a kernel is compiled, in this process or where the results are kept."""
    kept = _kept(kernel)
    return bool(kernel.signatures) or (kept is not None and bool(kept._load_index()))


def _kept(kernel: Any) -> Any:
    """Numba's index of what is kept of a kernel; None if nothing is, or if it is not where it used to be."""
    kept = getattr(getattr(kernel, "_cache", None), "_cache_file", None)
    return kept if hasattr(kept, "_source_stamp") and hasattr(kept, "_load_index") else None


@cache
def _say_that_nothing_is_kept() -> None:
    logger.warning(
        "there is no folder to keep compiled kernels in, so that every process compiles its own; "
        "set NUMBA_CACHE_DIR to one that can be written to"
    )


@cache
def source_stamp(file: Path) -> str:
    """Changes when a file of kernels does, or one of those that it imports from, directly or not."""
    digest = hashlib.sha256()
    for path in sorted(_sources(file)):
        digest.update(path.read_bytes())
    return digest.hexdigest()


@cache
def _sources(file: Path) -> frozenset[Path]:
    """A file of kernels, and all of this package that it imports from, directly or not."""
    found = {file}
    for name in _IMPORT.findall(file.read_text(encoding="utf-8")):
        found |= _sources(file.with_name(f"{name}.py"))
    return frozenset(found)


class _Announcement(event.Listener):
    """Says that there is something to wait for: once, however many processes of a user wait for it."""

    def __init__(self) -> None:
        self._told = False

    def on_start(self, event: event.Event) -> None:
        """A kernel is about to be compiled; it was not found where they are kept."""
        dispatcher: Any = (event.data or {}).get("dispatcher")
        ours = getattr(getattr(dispatcher, "py_func", None), "__module__", "").startswith("pinposture.")
        if ours and not self._told:
            self._told = True
            if _kept(dispatcher) is None or _is_news(Path(dispatcher._cache.cache_path)):
                logger.warning(_NEWS)

    def on_end(self, event: event.Event) -> None:
        """It is compiled."""


def _is_news(folder: Path) -> bool:
    """Whether no process has told it lately, by a file beside the kernels; this one counts from now on."""
    note = folder / "compiling.note"
    try:
        if time.time() - note.stat().st_mtime < _RECENT:
            return False
    except OSError:
        pass  # there is none yet
    with suppress(OSError):
        note.touch()
    return True


event.register("numba:compile", _Announcement())  # type: ignore[no-untyped-call]
