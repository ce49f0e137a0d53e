"""Functions that are compiled for the machine they run on: when, where the result is kept, how it is told.

Numba compiles a kernel when it is first called with arguments of its kind, and keeps the machine code beside
the source, or in the user's cache where it may not write there, or in NUMBA_CACHE_DIR. That happens once for
an installation and user; to have it done ahead: `pinposture compile`.
"""

from __future__ import annotations

import hashlib
import logging
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, TypeVar, cast

import numba
from numba.core import event

Function = TypeVar("Function", bound=Callable[..., object])

logger = logging.getLogger(__name__)

_NEWS = "compiling, once for an installation and user: a minute in all; `pinposture compile` does it now"


def compiled(function: Function) -> Function:
    """Compile a function that works on arrays and numbers alone; it runs without holding the GIL.

    Divisions by zero give inf or NaN, as in NumPy. Arrays have to be C-contiguous and of the same kind each
    time: read-only ones are another kind to the compiler, which would have to work again.
    """
    made: Any = numba.njit(nogil=True, error_model="numpy")(function)
    try:
        made.enable_caching()
    except RuntimeError:
        _say_that_nothing_is_kept()
    if (kept := _kept(made)) is not None:
        # Machine code contains the kernels that it calls, and numba looks at the file of the caller alone.
        kept._source_stamp = _stamp()
    return cast(Function, made)


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
def _stamp() -> str:
    """Changes when any of the kernels does."""
    files = sorted(Path(__file__).parent.glob("*.py"))
    seen = [(file.name, file.stat().st_mtime_ns, file.stat().st_size) for file in files]
    return hashlib.sha256(repr(seen).encode()).hexdigest()


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
