"""`pinposture compile`: have the kernels compiled now, not when they are first needed."""

from __future__ import annotations

import gc
import logging
import os
import time
from collections.abc import Callable
from typing import Annotated, Any

import typer

from pinposture.cli.output import count_progress, examples, print_facts, print_json, print_warning


@examples("pinposture compile", "pinposture compile --json")
def run(
    as_json: Annotated[bool, typer.Option("--json", help="Print the result as JSON.")] = False,
) -> None:
    """Compile all kernels for this machine now, and keep the result beside the library.

    It takes half a minute on two cores, once for an installation; where that cannot be written to, once
    for each user, or wherever NUMBA_CACHE_DIR says. All cores share the work. Without it, each kernel is
    compiled when it is first needed, and the first runs take longer; a note on stderr says so. What is
    compiled already stays. The exit code is 1 if something could not be compiled.
    """
    begun, total = time.perf_counter(), len(all_kernels())
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
    """Compile the kernels that are not ready, with a progress bar. Warn of failures, and return them."""
    waiting, total = missing_kernels(), len(all_kernels())
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
        names: of the kernels; the largest first, so that none is left alone at the end.
        progress: called with the number of those that are done.

    Returns:
        What went wrong, by the name of the kernel.
    """
    import multiprocessing
    from concurrent.futures import ProcessPoolExecutor, as_completed

    faults = {}
    spawn = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(min(os.cpu_count() or 1, 8), spawn) as pool:
        waiting = {pool.submit(compile_kernel, name): name for name in names}
        for done, each in enumerate(as_completed(waiting), 1):
            if error := each.exception():
                faults[waiting[each]] = f"{type(error).__name__}: {error}"
            progress(done)
    return faults


def compile_kernel(name: str) -> None:
    """Compile a kernel, in a process that does nothing else."""
    from pinposture import kernels
    from pinposture.kernels.compiled import load

    logging.getLogger("pinposture.kernels").setLevel(logging.ERROR)  # it has been asked for, it is no news
    gc.collect()
    gc.disable()  # a compiler makes much that stays: looking through it again and again is 15 % of the time
    load(getattr(kernels, name))


def all_kernels() -> dict[str, Any]:
    """The kernels that the library calls, by name."""
    from pinposture import kernels

    return {name: getattr(kernels, name) for name in kernels.NAMES}


def missing_kernels() -> list[str]:
    """Names of the kernels of which there is no machine code yet, the largest first."""
    from pinposture.kernels.compiled import is_ready

    missing = {name: kernel for name, kernel in all_kernels().items() if not is_ready(kernel)}
    return sorted(missing, key=lambda name: -len(missing[name].py_func.__code__.co_code))
