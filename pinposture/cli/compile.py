"""`pinposture compile`: have the kernels compiled now, not when they are first needed."""

from __future__ import annotations

import gc
import logging
import os
import time
import warnings
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Annotated

import typer

from pinposture.cli.output import print_facts, print_json, print_warning
from pinposture.cli.progress import count_progress

if TYPE_CHECKING:
    from pinposture.arm import Arm

EXAMPLES = ("pinposture compile", "pinposture compile --json")

POLL = 0.2
"""How often it is looked how many kernels are ready [s]."""


def run(
    as_json: Annotated[bool, typer.Option("--json", help="Print the result as JSON.")] = False,
) -> None:
    """Compile all kernels for this machine now, and keep the result beside the library.

    It takes half a minute on two cores, once for an installation; where that cannot be written to, once
    for each user, or wherever NUMBA_CACHE_DIR says. All cores share the work. Without it, each kernel is
    compiled when it is first needed, and the first runs take longer; a note on stderr says so. What is
    compiled already stays. The exit code is 1 if something could not be compiled.
    """
    begun, ready = time.perf_counter(), compiled_kernels()
    faults: list[str] = []
    if not all(ready.values()):
        with count_progress("kernel") as progress:
            faults = compile_kernels(lambda: progress(sum(compiled_kernels().values()), len(ready)))
    taken = time.perf_counter() - begun
    missing = sorted(name for name, is_there in compiled_kernels().items() if not is_there)
    for fault in faults:
        print_warning(fault)
    if as_json:
        print_json({"kernels": len(ready), "missing": missing, "seconds": taken})
    else:
        if missing:
            print_warning(f"not compiled: {', '.join(missing)}")
        facts = {"kernels ready": f"{len(ready) - len(missing)} of {len(ready)}", "taken": f"{taken:.1f} s"}
        print_facts(facts)
    if missing or faults:
        raise typer.Exit(1)


def compile_kernels(look: Callable[[], object] = lambda: None) -> list[str]:
    """Compile what is not compiled yet, in as many processes as there are cores.

    Args:
        look: called every now and then.

    Returns:
        What went wrong, a line for each job that failed.
    """
    import multiprocessing
    from concurrent.futures import ProcessPoolExecutor, wait

    faults = []
    spawn = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(min(os.cpu_count() or 1, 8), spawn) as pool:
        waiting = {pool.submit(run_job, number) for number in range(len(jobs()))}
        while waiting:
            done, waiting = wait(waiting, POLL)
            faults += [f"{type(error).__name__}: {error}" for each in done if (error := each.exception())]
            look()
    return faults


def run_job(number: int) -> None:
    """Run one of the jobs, which compiles what it uses; in a process that does nothing else."""
    logging.getLogger("pinposture.kernels").setLevel(logging.ERROR)  # it has been asked for, it is no news
    gc.collect()
    gc.disable()  # a compiler makes much that stays: looking through it again and again is 15 % of the time
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        jobs()[number]()


def compiled_kernels() -> dict[str, bool]:
    """Every kernel that the rest of the library calls, and whether there is machine code of it."""
    from pinposture import kernels
    from pinposture.kernels.compiled import is_ready

    return {name: is_ready(getattr(kernels, name)) for name in kernels.NAMES}


def jobs() -> list[Callable[[], object]]:
    """Small runs that use every kernel with arguments of every kind that it gets, the longest first."""
    from pinposture.control import CONTROLLERS

    arms = (_spatial, _planar)
    return [
        partial(_track, _spatial, "qp", {}),
        partial(_resolve, _spatial),
        *(partial(_track, _spatial, name, {}) for name in CONTROLLERS if name != "qp"),
        *(partial(job, arm) for arm in arms for job in (_move_in_time, _brake, _track_moving_target, _look)),
        *(partial(_track, arm, "qp", {"step": 0.02, "acceleration": 3.0, "dt": 0.05}) for arm in arms),
        partial(_resolve, _planar),
        *(partial(_track, _planar, name, {}) for name in CONTROLLERS),
        _measure_clearance,
    ]


def _spatial() -> Arm:
    from pinposture.arm import Arm

    return Arm.from_template("RyRz", 6)


def _planar() -> Arm:
    from pinposture.arm import Arm
    from pinposture.thesis.arms import PLANAR

    return Arm.from_modules(PLANAR[:9], name="planar")


def _resolve(make: Callable[[], Arm]) -> None:
    import pinposture as pp

    arm = make()
    reach = arm.length
    bent = pp.Curve.spline([(0.3 * k * reach, 0.02 * k**2 * reach, 0.0) for k in range(6)])
    for curve in (bent, pp.Curve.line((0, 0, 0), (2 * reach, 0, 0))):
        points = pp.resolve_targets(arm, curve).points
        curve.nearest(points[-1])
        pp.fit_points(arm, points)


def _track(make: Callable[[], Arm], name: str, limits: dict[str, float]) -> None:
    import numpy as np

    import pinposture as pp

    arm, rng = make(), np.random.default_rng(0)
    start, end = (arm.configuration(0.3 * rng.normal(size=arm.nv)) for _ in range(2))
    target = pp.Target.from_configuration(arm, end)
    if name == "qp":
        target = pp.Target.from_points(arm, target.points)
    pp.track(arm, target, start, name, pp.Limits(**limits), max_steps=60)


def _track_moving_target(make: Callable[[], Arm]) -> None:
    import numpy as np

    import pinposture as pp

    arm = make()
    q, memory, controller = arm.neutral(), None, pp.ConstrainedQP()
    for number in range(1, 4):
        goal = arm.configuration(np.full(arm.nv, 0.1 + 0.01 * number))
        target = pp.Target.from_configuration(arm, goal)
        step = controller.step(arm.at(q), target, pp.Limits(step=0.05), memory)
        q, memory = arm.integrate(q, step.dq), step.memory


def _brake(make: Callable[[], Arm]) -> None:
    """On its way and thrown back, so that its limits keep it from going on."""
    import numpy as np

    import pinposture as pp

    arm = make()
    target = pp.Target.from_configuration(arm, arm.configuration(np.full(arm.nv, 0.3)))
    state, limits = arm.at(arm.neutral()), pp.Limits(step=0.02, acceleration=3.0, dt=0.05)
    memory = pp.ConstrainedQP().step(state, target, limits).memory
    pp.ConstrainedQP().step(state, target, limits, memory._replace(dq=-2.0 * memory.dq))


def _move_in_time(make: Callable[[], Arm]) -> None:
    import pinposture as pp

    arm = make()
    line = pp.Curve.line((0, 0, 0), (1.01 * arm.length, 0, 0))
    bent = pp.Curve.helix(0.4 * arm.length, 0.0, 0.45)
    pp.move_through(arm, [pp.Keyframe(line), pp.Keyframe(bent, time=0.4, trim=True)])


def _look(make: Callable[[], Arm]) -> None:
    arm = make()
    arm.at(arm.neutral()).manipulability()


def _measure_clearance() -> None:
    import pinposture as pp

    box = pp.Box(center=(0.3, 0.3, 0.3), size=(0.1, 0.1, 0.1))
    arm = _spatial()
    pp.Scene({"box": box}).around(arm).minimum(arm.neutral())
