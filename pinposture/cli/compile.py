"""`pinposture compile`: have the kernels compiled now, not when they are first needed."""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable, Iterator
from typing import Annotated

import typer

from pinposture.cli.output import print_facts, print_json, print_warning
from pinposture.cli.progress import count_progress

EXAMPLES = ("pinposture compile", "pinposture compile --json")


def run(
    as_json: Annotated[bool, typer.Option("--json", help="Print the result as JSON.")] = False,
) -> None:
    """Compile all kernels for this machine now, and keep the result beside the library.

    It takes about a minute, once for an installation; where that cannot be written to, once for each user, or
    wherever NUMBA_CACHE_DIR says. Without it, each kernel is compiled when it is first
    needed, and the first runs take longer; a note on stderr says so. Nothing happens to what is compiled
    already.
    """
    begun, before = time.perf_counter(), compiled_kernels()
    actions = list(jobs())
    with count_progress("group of kernels") as progress, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for number, action in enumerate(actions):
            progress(number, len(actions))
            action()
    taken = time.perf_counter() - begun
    missing = sorted(name for name, ready in compiled_kernels().items() if not ready)
    if as_json:
        print_json({"kernels": len(before), "missing": missing, "seconds": taken})
        return
    if missing:
        print_warning(f"not compiled: {', '.join(missing)}")
    facts = {"kernels ready": f"{len(before) - len(missing)} of {len(before)}", "taken": f"{taken:.1f} s"}
    print_facts(facts)


def compiled_kernels() -> dict[str, bool]:
    """Every kernel that the rest of the library calls, and whether there is machine code of it."""
    from pinposture import kernels
    from pinposture.kernels.compiled import is_ready

    return {name: is_ready(getattr(kernels, name)) for name in kernels.NAMES}


def jobs() -> Iterator[Callable[[], object]]:
    """Small runs that use every kernel with arguments of every kind that it gets."""
    import numpy as np

    import pinposture as pp
    from pinposture.control import CONTROLLERS
    from pinposture.target import Target, fit_points
    from pinposture.thesis.arms import PLANAR

    spatial = pp.Arm.from_template("RyRz", 6)
    planar = pp.Arm.from_modules(PLANAR[:9], name="planar")
    rng = np.random.default_rng(0)

    def resolve(arm: pp.Arm) -> Callable[[], object]:
        reach = arm.length
        ways = [(0.3 * k * reach, 0.02 * k**2 * reach, 0.0) for k in range(6)]
        bent = pp.Curve.spline(ways)
        line = pp.Curve.line((0, 0, 0), (2 * reach, 0, 0))

        def action() -> None:
            for curve in (bent, line):
                points = pp.resolve_targets(arm, curve).points
                curve.nearest(points[-1])
                fit_points(arm, points)

        return action

    def track(arm: pp.Arm, name: str, limits: pp.Limits) -> Callable[[], object]:
        start, end = (arm.configuration(0.3 * rng.normal(size=arm.nv)) for _ in range(2))
        target = Target.from_configuration(arm, end)
        if name == "qp":
            target = Target.from_points(arm, target.points)
        return lambda: pp.track(arm, target, start, name, limits, max_steps=60)

    def moving(arm: pp.Arm) -> Callable[[], object]:
        def action() -> None:
            q, memory, controller = arm.neutral(), None, pp.ConstrainedQP()
            for number in range(1, 4):
                target = Target.from_configuration(
                    arm, arm.configuration(np.full(arm.nv, 0.1 + 0.01 * number))
                )
                step = controller.step(arm.at(q), target, pp.Limits(step=0.05), memory)
                q, memory = arm.integrate(q, step.dq), step.memory

        return action

    def pushed(arm: pp.Arm) -> Callable[[], object]:
        def action() -> None:  # on its way and thrown back, so that its limits keep it from going on
            target = Target.from_configuration(arm, arm.configuration(np.full(arm.nv, 0.3)))
            state, limits = arm.at(arm.neutral()), pp.Limits(step=0.02, acceleration=3.0, dt=0.05)
            memory = pp.ConstrainedQP().step(state, target, limits).memory
            pp.ConstrainedQP().step(state, target, limits, memory._replace(dq=-2.0 * memory.dq))

        return action

    def timed(arm: pp.Arm) -> Callable[[], object]:
        line = pp.Curve.line((0, 0, 0), (1.01 * arm.length, 0, 0))
        bent = pp.Curve.helix(0.4 * arm.length, 0.0, 0.45)
        postures = [pp.Keyframe(line), pp.Keyframe(bent, time=0.4, trim=True)]
        return lambda: pp.move_through(arm, postures)

    def near_a_box() -> None:
        box = pp.Box(center=(0.3, 0.3, 0.3), size=(0.1, 0.1, 0.1))
        pp.Scene({"box": box}).around(spatial).minimum(spatial.neutral())

    for arm in (spatial, planar):
        yield resolve(arm)
        yield lambda arm=arm: arm.at(arm.neutral()).manipulability()  # type: ignore[misc]
        for name in CONTROLLERS:
            yield track(arm, name, pp.Limits())
        yield track(arm, "qp", pp.Limits(step=0.02, acceleration=3.0, dt=0.05))
        yield moving(arm)
        yield pushed(arm)
        yield timed(arm)
    yield near_a_box
