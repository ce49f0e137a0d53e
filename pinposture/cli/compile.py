"""`pinposture compile`: compile the kernels in advance, rather than on first use."""

from __future__ import annotations

import gc
import logging
import os
import time
from collections.abc import Callable
from typing import Any

import typer

from pinposture.cli.inputs import JsonOption
from pinposture.cli.output import count_progress, examples, print_facts, print_json, print_warning


@examples("pinposture compile", "pinposture compile --json")
def run(
    as_json: JsonOption = False,
) -> None:
    """Compile all kernels for this machine now, and cache the result beside the library.

    This takes one to one and a half minutes on two cores, once per installation; if that is not writable,
    once per user, or in the folder NUMBA_CACHE_DIR. All cores share the work. Otherwise, each kernel is
    compiled on first use, and the first runs take longer; a note on stderr says so. Kernels that are already
    compiled are kept. The exit code is 1 if something could not be compiled.
    """
    begun = time.perf_counter()
    total = len(all_kernels())
    missing = compile_missing()
    taken = time.perf_counter() - begun
    if as_json:
        print_json({"kernels": total, "missing": missing, "seconds": taken})
    else:
        facts = {"kernels ready": f"{total - len(missing)} of {total}", "taken": f"{taken:.1f} s"}
        print_facts(facts)
    if missing:
        raise typer.Exit(1)


def compile_missing() -> list[str]:
    """Compile the missing kernels, with a progress bar; warn of failures and return their names."""
    waiting = missing_kernels()
    total = len(all_kernels())
    if not waiting:
        return []
    with count_progress("kernel") as progress:
        ready = total - len(waiting)
        faults = compile_kernels(waiting, lambda done: progress(ready + done, total))
    for name, fault in sorted(faults.items()):
        print_warning(f"{name} was not compiled: {fault}")
    return sorted(faults)


def compile_kernels(names: list[str], progress: Callable[[int], object]) -> dict[str, str]:
    """Compile kernels in as many processes as there are cores.

    Args:
        names: names of the kernels, largest first, so that none remains alone at the end.
        progress: called with the number of finished kernels.

    Returns:
        Error messages by kernel name.
    """
    import multiprocessing
    from concurrent.futures import ProcessPoolExecutor, as_completed

    faults = {}
    spawn = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(min(os.cpu_count() or 1, 8), spawn) as pool:
        waiting = {pool.submit(compile_kernel, name): name for name in names}
        for done, future in enumerate(as_completed(waiting), 1):
            if error := future.exception():
                faults[waiting[future]] = f"{type(error).__name__}: {error}"
            progress(done)
    return faults


def compile_kernel(name: str) -> None:
    """Compile a kernel in a separate process."""
    from pinposture import kernels
    from pinposture.kernels.compiled import load

    logging.getLogger("pinposture.kernels").setLevel(logging.ERROR)  # no notes: the user requested it
    gc.collect()
    gc.disable()  # compilers allocate many long-lived objects: collection would take 15 % of the time
    load(getattr(kernels, name))


def all_kernels() -> dict[str, Any]:
    """Return the kernels that the library calls, by name."""
    from pinposture import kernels

    return {name: getattr(kernels, name) for name in kernels.NAMES}


def missing_kernels() -> list[str]:
    """Return the names of kernels without machine code, largest first."""
    from pinposture.kernels.compiled import is_ready

    missing = {name: kernel for name, kernel in all_kernels().items() if not is_ready(kernel)}
    return sorted(missing, key=lambda name: -len(missing[name].py_func.__code__.co_code))
