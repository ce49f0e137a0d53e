"""What runs when a user does something: the files that a reader follows it through, and the calls.

The names of the library that this needs are here.
"""

from __future__ import annotations

import contextlib
import io
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

TASK = Path(__file__).resolve().parents[1] / "examples" / "tasks" / "keyframes.toml"
"""The task that is read, performed, run and edited."""

COMPREHENSIONS = ("<listcomp>", "<setcomp>", "<dictcomp>", "<genexpr>")
"""Names of code that newer Pythons run without a call, or call once an item."""


class Trace:
    """Files of the package in which a function runs, until another is called, or returns for the n-th time.

    Only the calling thread counts: how far others come meanwhile varies. What runs while a module is imported
    does not count. Of kernels, which no tracing sees, those count that Python calls, and those that they can
    call in turn. Comprehensions are no calls: newer Pythons have none.

    Attributes:
        files: the files, in the order in which they are come to.
        calls: how many functions of the package were called.
        switches: how many of these calls led into another file than that of the caller.
        cycles: how many control cycles the function took, if it tells.
        tree: the calls, each with the number of those of the package that it is within.
    """

    def __init__(
        self, folder: Path, until_return: Any = None, until_call: Any = None, returns: int = 1
    ) -> None:
        self.files: dict[str, None] = {}
        self.calls = 0
        self.switches = 0
        self.cycles = 0
        self.tree: list[tuple[int, str]] = []
        self._folder = str(folder) + "/"
        self._importing = 0
        self._over = True
        self._thread = 0
        self._until_return = until_return
        self._until_call = until_call
        self._returns = returns

    def __enter__(self) -> Trace:
        self._over = False
        self._thread = threading.get_ident()
        sys.setprofile(self._see)
        return self

    def __exit__(self, *_: object) -> None:
        sys.setprofile(None)
        self._over = True

    def _see(self, frame: Any, event: str, _: Any) -> None:
        code = frame.f_code
        if code.co_name == "<module>" and event in ("call", "return"):
            self._importing += 1 if event == "call" else -1
        elif event == "call" and code is self._until_call:
            self._over = True
        elif event == "call":
            self._count(frame, sys._getframe(1))
            self.note(code)
        elif event == "return" and code is self._until_return:
            self._returns -= 1
            self._over = self._over or self._returns == 0

    def _count(self, frame: Any, now: Any) -> None:
        """Count a call, given the frame that runs: for a kernel, which has none, that of its caller."""
        own = frame.f_code.co_filename
        if not self._counts(own) or frame.f_code.co_name in COMPREHENSIONS:
            return
        self.calls += 1
        compiled = now is not frame
        callers = list(self._callers(now if compiled else frame.f_back))
        self.switches += not compiled and bool(callers) and callers[0] != own
        name = getattr(frame.f_code, "co_qualname", frame.f_code.co_name)  # Python 3.10 has none
        file = own[len(self._folder) :]
        self.tree.append((len(callers), f"{name} ({file}{', compiled' if compiled else ''})"))

    def _callers(self, caller: Any) -> Iterator[str]:
        """The files of the functions of the package that a function is called within, from the last one."""
        while caller is not None:
            if caller.f_code.co_filename.startswith(self._folder):
                yield caller.f_code.co_filename
            caller = caller.f_back

    def _counts(self, file: str) -> bool:
        own = threading.get_ident() == self._thread  # kernels tell of calls in any thread
        return own and file.startswith(self._folder) and not self._importing and not self._over

    def note(self, code: Any) -> None:
        """A function has been come to."""
        file = code.co_filename
        if self._counts(file):
            self.files.setdefault(file[len(self._folder) :])


class Noted:
    """A kernel that tells a trace when it is called; as a kernel else."""

    trace: Trace | None = None

    def __init__(self, kernel: Any) -> None:
        self._kernel = kernel
        self._codes = list(_codes_of(kernel, {}))

    def __call__(self, *args: Any) -> Any:
        """Tell the trace, and run the kernel."""
        if Noted.trace is not None:
            for code in self._codes:
                Noted.trace.note(code)
        return self._kernel(*args)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._kernel, name)


def _codes_of(kernel: Any, seen: dict[int, None]) -> Iterator[Any]:
    """The code of a kernel, and of all kernels that its own names."""
    if id(kernel) not in seen:
        seen[id(kernel)] = None
        function = kernel.py_func
        yield function.__code__
        for name in function.__code__.co_names:
            if _is_kernel(other := function.__globals__.get(name)):
                yield from _codes_of(other, seen)


def _is_kernel(value: Any) -> bool:
    return hasattr(type(value), "py_func") or type(value).__name__ == "CPUDispatcher"


def note_kernels(package: str) -> None:
    """Have kernels tell when Python calls them, wherever modules that define none keep them."""
    for name, module in list(sys.modules.items()):
        if name == package or name.startswith(f"{package}."):
            kernels = {key: value for key, value in vars(module).items() if _is_kernel(value)}
            if not any(value.py_func.__module__ == name for value in kernels.values()):
                vars(module).update({key: Noted(value) for key, value in kernels.items()})


class Flow(NamedTuple):
    """What one thing that a user does runs through.

    Attributes:
        files: the files, in the order in which they are come to.
        calls: how many functions of the package were called.
        switches: how many of these calls led into another file.
        cycles: how many control cycles it took, if it tells.
        tree: the calls, as in `Trace`.
    """

    files: list[str]
    calls: int
    switches: int
    cycles: int
    tree: list[tuple[int, str]]


def follow(flow: Callable[[Any], object], **until: Any) -> Flow:
    """Run something and see what it runs through."""
    import pinposture

    trace = Noted.trace = Trace(Path(pinposture.__file__).parent, **until)
    try:
        flow(trace)
    finally:
        Noted.trace = None
    return Flow(list(trace.files), trace.calls, trace.switches, trace.cycles, trace.tree)


def follow_all() -> tuple[dict[str, Flow], dict[str, int]]:
    """What each flow runs through, and the calls of one step, of reading a task and of a cycle.

    Each is done once before, so that all is imported; only the command is not, which takes as long as all
    others together: of it only the files count, and its imports do not.
    """
    from pinposture import kernels
    from pinposture.control import CONTROLLERS

    step = type(CONTROLLERS["geodesic"]()).step.__code__
    for flow in (take_steps, take_steps_in_a_scene, load_a_task, perform_a_task, drag_a_point):
        flow(Trace(Path(), until_call=None))
    kernels.load()
    note_kernels("pinposture")
    first = follow(take_steps, until_return=step)
    second = follow(take_steps, until_return=step, returns=2)
    first_in_a_scene = follow(take_steps_in_a_scene, until_return=step)
    second_in_a_scene = follow(take_steps_in_a_scene, until_return=step, returns=2)
    performed = follow(perform_a_task)
    drag = follow(drag_a_point, until_call=step)
    inner = [file for file in drag.files if file.startswith("control/")]
    flows = {
        "step": first,
        "task": follow(run_a_task),
        "drag": drag._replace(files=[file for file in drag.files if file not in inner]),
    }
    calls = {
        "calls of the first step": first.calls,
        "switches between files of the first step": first.switches,
        "calls of the second step": second.calls - first.calls,
        "calls of the second step in a scene": second_in_a_scene.calls - first_in_a_scene.calls,
        "calls of Task.load": follow(load_a_task).calls,
        "calls of a cycle of perform": round(performed.calls / performed.cycles),
    }
    return flows, calls


def take_steps(trace: Any) -> None:
    """`track` with the limits of the README, in free space, on an arm with no past."""
    _take_steps(trace, obstacles={})


def take_steps_in_a_scene(trace: Any) -> None:
    """The same beside a ball."""
    import pinposture as pp

    _take_steps(trace, obstacles={"ball": pp.Sphere((0.1, 0.6, 0.3), 0.1)})


def _take_steps(trace: Any, obstacles: Any) -> None:
    import pinposture as pp

    arm = pp.Arm.from_template("RyRz", modules=6)
    target = pp.Target.from_configuration(arm, arm.configuration([0.3, -0.2] * 6))
    limits = pp.Limits(step=None, dt=0.02, velocity=1.0, acceleration=4.0)
    scene = pp.Scene(obstacles) if obstacles else None
    start = arm.straight()
    track = pp.track
    with trace:
        track(arm, target, start, limits=limits, scene=scene, max_steps=2)


def load_a_task(trace: Any) -> None:
    """The example of a task file is read."""
    from pinposture.task import Task

    load = Task.load
    with trace:
        load(TASK)


def perform_a_task(trace: Any) -> None:
    """The example is performed, once its motion is planned."""
    task, reference = planned_task()
    with trace:
        trace.cycles = len(task.perform(reference).run.q)


@cache
def planned_task() -> Any:
    """The example and its motion, which takes longer to plan than to perform."""
    from pinposture.task import Task

    task = Task.load(TASK)
    return task, task.reference()


def run_a_task(trace: Any) -> None:
    """The command line runs a task file."""
    from pinposture.cli import main

    before = sys.argv
    with tempfile.TemporaryDirectory() as folder, contextlib.redirect_stdout(io.StringIO()):
        sys.argv = ["pinposture", "run", str(TASK), "-o", folder]
        try:
            with contextlib.redirect_stderr(io.StringIO()), trace:
                main()
        except SystemExit as end:
            assert not end.code, f"the task did not run: {end.code}"
        finally:
            sys.argv = before


def drag_a_point(trace: Any) -> None:
    """From a drag in the page, without a browser, to the controller's step, loop and solver by hand."""
    import asyncio
    import socket
    from types import SimpleNamespace

    from pinposture.editor.editor import Editor
    from pinposture.editor.ui.curve import Handles
    from pinposture.task import Task

    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    editor = Editor(Task.load(TASK), port=port)
    try:
        session, solver = editor.session, editor._solver
        session.select(1)
        editor._ask()
        for _ in range(2):  # it judges the posture, and moves there
            solver._take(session.problem)
            solver._step()
            session.settle(solver.live)
        editor.page.show(session, solver.live)
        handles = next(part for part in editor.page._parts if isinstance(part, Handles))
        begin = session.shape.points[1]
        drag = SimpleNamespace(phase="move", start_position=begin, end_position=begin + 0.02)
        with trace:
            asyncio.run(handles._drags[1].by_mouse(drag))
            editor._take_requests()
            editor._ask()
            solver._take(session.problem)
            solver._step()
    finally:
        editor.close()
