"""Functions that are compiled for the machine they run on: when, where the result is kept, how it is told.

Numba compiles a kernel when it is first called with arguments of its kind, and keeps the machine code beside
the source, or in the user's cache where it may not write there, or in NUMBA_CACHE_DIR. That happens once for
an installation and user; to have it done ahead: `pinposture compile`. Processes that want the same kernel at
the same time compile it once: one does, the others wait and load the result.
"""

from __future__ import annotations

import hashlib
import logging
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import Any, TypeVar, cast

import numba
from numba.core import event
from numba.core.compiler_lock import global_compiler_lock

try:
    import fcntl
except ImportError:  # not a POSIX system: processes may compile the same kernel, which costs time only
    fcntl = None  # type: ignore[assignment]

Function = TypeVar("Function", bound=Callable[..., object])

logger = logging.getLogger(__name__)

OPTIONS: Any = {"nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True}
"""What numba is told: kernels are called from Python and by each other, never from C."""

_NEWS = "compiling, once for an installation and user: a minute in all; `pinposture compile` does it now"

_IMPORT = re.compile(r"^from pinposture\.kernels\.(\w+) import", re.MULTILINE)


def compiled(function: Function) -> Function:
    """Compile a function that works on arrays and numbers alone; it runs without holding the GIL.

    Divisions by zero give inf or NaN, as in NumPy. Arrays have to be C-contiguous and of the same kind each
    time: read-only ones are another kind to the compiler, which would have to work again.
    """
    made: Any = numba.njit(**OPTIONS)(function)
    try:
        made.enable_caching()
    except RuntimeError:
        _say_that_nothing_is_kept()
    if (kept := _kept(made)) is not None:
        # Machine code contains the kernels that it calls, and numba looks at the file of the caller alone.
        kept._source_stamp = source_stamp(Path(function.__code__.co_filename))
        made.compile = _one_at_a_time(
            made.compile, Path(made._cache.cache_path) / f"{function.__name__}.lock"
        )
    return cast(Function, made)


def _one_at_a_time(compile_kernel: Callable[..., Any], lock: Path) -> Callable[..., Any]:
    """Let one process compile a kernel; the others wait, and find it where it is kept.

    A kernel that another one calls is locked after its caller, so nobody waits in a circle. Numba's own lock
    comes first, so that threads of one process do not either.
    """

    def compile_once(signature: Any) -> Any:
        with global_compiler_lock, _locked(lock):
            return compile_kernel(signature)

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
    """Says once that there is something to wait for."""

    def __init__(self) -> None:
        self._told = False

    def on_start(self, event: event.Event) -> None:
        """A kernel is about to be compiled; it was not found where they are kept."""
        dispatcher = (event.data or {}).get("dispatcher")
        ours = getattr(getattr(dispatcher, "py_func", None), "__module__", "").startswith("pinposture.")
        if ours and not self._told:
            self._told = True
            logger.warning(_NEWS)

    def on_end(self, event: event.Event) -> None:
        """It is compiled."""


event.register("numba:compile", _Announcement())  # type: ignore[no-untyped-call]
