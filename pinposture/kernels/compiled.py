"""Compilation of kernels by numba, and its cache.

A kernel is compiled once per installation and user, for the argument types in its annotations: on the first
call, or in advance by `load` or `pinposture compile`. Numba stores the machine code beside the source, or in
the user's cache if that is not writable, or in NUMBA_CACHE_DIR. If several processes need a kernel at the
same time, one compiles it while the others wait and load the result.
"""

from __future__ import annotations

import hashlib
import logging
import pickle
import re
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import cache, partial
from inspect import signature
from pathlib import Path
from types import SimpleNamespace
from typing import Annotated, Any, TypeVar, cast, get_args, get_origin, get_type_hints

import numba
import numpy as np
from llvmlite import binding
from numba.core import event, types
from numba.core.compiler_lock import global_compiler_lock
from numba.core.sigutils import normalize_signature

try:
    import fcntl
except ImportError:  # not a POSIX system: processes may compile the same kernel, which only costs time
    fcntl = None  # type: ignore[assignment]

Function = TypeVar("Function", bound=Callable[..., object])

logger = logging.getLogger(__name__)

_IMPORT = re.compile(r"^from pinposture\.kernels\.(\w+) import", re.MULTILINE)


def compiled(function: Function) -> Function:
    """Compile a function of arrays and numbers; it runs without holding the GIL.

    Divisions by zero give inf or NaN, as in NumPy. Arrays must be C-contiguous and writable, with the type
    and number of dimensions of the annotations: any other type triggers another compilation.
    """
    return _compile(function, {})


def subkernel(function: Function) -> Function:
    """Compile a function that is only called by other kernels."""
    return _compile(function, {"no_cpython_wrapper": True})


def inlined(function: Function) -> Function:
    """Inline a short function into the kernels that call it, because passing many arrays would be slow."""
    return _compile(function, {"no_cpython_wrapper": True, "forceinline": True})


def _compile(function: Function, options: dict[str, Any]) -> Function:
    # Kernels are called from Python and by each other, never from C.
    every: Any = {"nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True, **options}
    kernel: Any = numba.njit(**every)(function)
    try:
        kernel.enable_caching()
    except RuntimeError:
        _warn_without_cache()
    if (cached := _cache_file(kernel)) is not None:
        # Machine code includes the called kernels, but numba only checks the file of the caller.
        cached._source_stamp = source_stamp(Path(function.__code__.co_filename))
        cached._load_index = _empty_if_unreadable(cached._load_index)
        kernel._cache._impl.rebuild = _without_bitcode(
            kernel._cache._impl.rebuild, wrapped="no_cpython_wrapper" not in options
        )
        lock = Path(kernel._cache.cache_path) / f"{function.__name__}.lock"
        kernel.compile = _one_at_a_time(kernel.compile, lock)
    return cast(Function, kernel)


def load(kernel: Any) -> None:
    """Compile a kernel for its annotated argument types, or load it from the cache."""
    if not kernel.signatures:
        kernel.compile(arguments_of(kernel))


def arguments_of(kernel: Any) -> tuple[types.Type, ...]:
    """Return numba's types of the annotated arguments of a kernel."""
    hints = get_type_hints(kernel.py_func, include_extras=True)
    return tuple(_type_of(hints[name]) for name in signature(kernel.py_func).parameters)


def _type_of(hint: Any) -> types.Type:
    """Return the numba type of an annotation."""
    scalars = {float: types.float64, int: types.int64, bool: types.boolean}
    if hint in scalars:
        return scalars[hint]
    if get_origin(hint) is Annotated:  # an array of `kernels.arrays`
        array, dimensions = get_args(hint)
        entries = get_args(array)[-1]  # dtype[...], or the type itself, depending on the version of numpy
        element = (get_args(entries) or (entries,))[0]
        return types.Array(numba.from_dtype(np.dtype(element)), dimensions, "C")
    named = hint if hasattr(hint, "_fields") else None
    fields = get_type_hints(hint, include_extras=True).values() if named else get_args(hint)
    return types.BaseTuple.from_types([_type_of(each) for each in fields], named)  # type: ignore[no-untyped-call]


def _one_at_a_time(compile_kernel: Callable[..., Any], lock: Path) -> Callable[..., Any]:
    """Let one process compile a kernel while the others wait and then load it from the cache.

    A kernel is locked after its caller, and numba's own lock first, so no process or thread can deadlock.
    """

    def compile_once(signature: Any) -> Any:
        arguments, _ = normalize_signature(signature)  # type: ignore[no-untyped-call]
        # A literal argument must not become a separate type.
        arguments = tuple(types.unliteral(each) for each in arguments)  # type: ignore[no-untyped-call]
        with global_compiler_lock, _locked(lock):
            return compile_kernel(arguments)

    return compile_once


@contextmanager
def _locked(path: Path) -> Iterator[None]:
    """Hold a lock on a file, if files can be locked; it is released when the process ends."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        file = path.open("w")
    except OSError:  # a read-only folder
        yield
        return
    with file:
        if fcntl is not None:
            with suppress(OSError):  # a file system without locks
                fcntl.flock(file, fcntl.LOCK_EX)
        yield


def _empty_if_unreadable(load_index: Callable[[], Any]) -> Callable[[], Any]:
    """Treat an unreadable index as empty; it may refer to classes of another version of the library."""

    def load_or_empty() -> Any:
        try:
            return load_index()
        except (AttributeError, ImportError, EOFError, pickle.UnpicklingError):
            return {}

    return load_or_empty


def _without_bitcode(rebuild: Callable[..., Any], wrapped: bool) -> Callable[..., Any]:
    """Read bitcode, by which other kernels link a cached one, only if one of them is compiled.

    A kernel runs without it, and to read it takes three quarters of the time of loading a kernel.

    Args:
        rebuild: makes a kernel from what is cached.
        wrapped: whether it can be called from Python.
    """

    def rebuild_without(context: Any, cached: Any) -> Any:
        try:
            (name, kind, (machine_code, bitcode)), descriptor, *others = cached
            symbols = {descriptor.llvm_func_name}
            if wrapped:
                symbols.add(descriptor.llvm_cpython_wrapper_name)
            context.codegen()._engine._defined_symbols.update(symbols)
        except (AttributeError, TypeError, ValueError):  # numba's internals have changed
            return rebuild(context, cached)
        nothing = binding.parse_assembly("").as_bitcode()
        kernel = rebuild(context, ((name, kind, (machine_code, nothing)), descriptor, *others))
        kernel.library._shared_module = SimpleNamespace(clone=partial(binding.parse_bitcode, bitcode))
        return kernel

    return rebuild_without


def is_ready(kernel: Any) -> bool:
    """Return whether a kernel is compiled, in this process or in the cache."""
    cached = _cache_file(kernel)
    return bool(kernel.signatures) or (cached is not None and bool(cached._load_index()))


def _cache_file(kernel: Any) -> Any:
    """Return numba's index of a kernel's cache; None without one, or if numba's internals have changed."""
    cache = getattr(kernel, "_cache", None)
    cached = getattr(cache, "_cache_file", None)
    known = hasattr(cached, "_source_stamp") and hasattr(cached, "_load_index") and hasattr(cache, "_impl")
    return cached if known else None


@cache
def _warn_without_cache() -> None:
    logger.warning(
        "no folder to store compiled kernels, so every process compiles its own; "
        "set NUMBA_CACHE_DIR to a writable folder"
    )


@cache
def source_stamp(file: Path) -> str:
    """Return a hash of a file of kernels and of all kernel files it imports, directly or not."""
    digest = hashlib.sha256()
    for path in sorted(_sources(file)):
        digest.update(path.read_bytes())
    return digest.hexdigest()


@cache
def _sources(file: Path) -> frozenset[Path]:
    """Return a file of kernels and all kernel files it imports, directly or not."""
    found = {file}
    for name in _IMPORT.findall(file.read_text(encoding="utf-8")):
        found |= _sources(file.with_name(f"{name}.py"))
    return frozenset(found)


class _Notice(event.Listener):
    """Log that kernels are being compiled, once for all waiting processes of a user."""

    def __init__(self) -> None:
        self._given = False

    def on_start(self, event: event.Event) -> None:
        """Log the notice when a kernel was not found in the cache and is about to be compiled."""
        dispatcher: Any = (event.data or {}).get("dispatcher")
        ours = getattr(getattr(dispatcher, "py_func", None), "__module__", "").startswith("pinposture.")
        if ours and not self._given:
            self._given = True
            if _cache_file(dispatcher) is None or _is_due(Path(dispatcher._cache.cache_path)):
                logger.warning(
                    "compiling kernels, once per installation and user; "
                    "`pinposture compile` compiles all of them now"
                )

    def on_end(self, event: event.Event) -> None:
        """Ignore the end of a compilation."""


def _is_due(folder: Path) -> bool:
    """Return whether no process has logged the notice for two minutes; touches a file beside the kernels."""
    note = folder / "compiling.note"
    with suppress(OSError):  # there is none yet
        if time.time() - note.stat().st_mtime < 120.0:
            return False
    with suppress(OSError):
        note.touch()
    return True


event.register("numba:compile", _Notice())  # type: ignore[no-untyped-call]
