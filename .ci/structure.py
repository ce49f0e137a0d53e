"""How large the library is, how its parts hang together, and through how many files a reader follows it.

    python .ci/structure.py                  # what is counted from the source
    python .ci/structure.py --flows          # and the files that three usual tasks run through
    python .ci/structure.py --check          # exit code 1 if a ceiling is exceeded; `make lint` does this
    python .ci/structure.py --list           # every cycle, name and file that was counted

Counted are files and lines; cycles of imports, at run time and with those that only types and functions need;
imports that go up in the order of packages; names that two classes have; names of constants that mean two
things where both are in sight. With `--flows` also the files in which a function runs: from `pp.track` to the
first step of the default controller; while `pinposture run` performs a task file; and from a drag in the
editor to the step of the controller, those of `control` not counted.
"""

from __future__ import annotations

import argparse
import ast
import contextlib
import io
import re
import sys
import tempfile
import threading
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import combinations
from pathlib import Path
from statistics import median
from typing import Any, NamedTuple

ROOT = Path(__file__).resolve().parents[1]

CEILINGS = {
    # What there is today, to be lowered whenever it falls; behind it, what it is to come to.
    "files": 200,  # 180
    "import cycles at run time": 0,  # 0
    "import cycles with types": 0,  # 0
    "imports that go up": 0,  # 0
    "class names defined twice": 0,  # 0
    "constants of two meanings in sight": 0,  # 0
    "files of a step": 22,  # 12
    "files of a task": 72,  # 40
    "files of a drag": 40,  # 15
}
"""The most that there may be of each.

Lines are printed and not limited: under a ceiling on lines, statements came to share one.
"""

ORDER = (
    ("errors",),
    ("storage",),
    ("_validation",),
    ("units",),
    ("specification",),
    ("kernels",),
    ("curve",),
    ("arm",),
    ("placement",),
    ("collision",),
    ("control",),
    ("motion",),
    ("task",),
    ("sim",),
    ("viz",),
    ("editor",),
    ("study",),
    ("notebook",),
    ("cli",),
    ("__main__",),
)
"""The packages from the lowest to the highest; one imports from those below it, and from itself."""

CONSTANT = re.compile(r"_?[A-Z][A-Z0-9_]+")


# What the source says.


class Import(NamedTuple):
    """A module that a module imports.

    Attributes:
        module: its dotted name.
        line: where.
        late: whether only types or a function need it, so that it is not imported with the module.
    """

    module: str
    line: int
    late: bool


class Constant(NamedTuple):
    """A constant of a module: what it is called, its value as source, and what is said of it."""

    name: str
    value: str
    meaning: str


class Module(NamedTuple):
    """A file of the package."""

    name: str
    path: Path
    lines: int
    package: bool
    imports: tuple[Import, ...]
    classes: tuple[str, ...]
    constants: tuple[Constant, ...]


def read_package(folder: Path) -> dict[str, Module]:
    """All modules of a package, by their dotted names."""
    paths = {_dotted(path, folder): path for path in sorted(folder.rglob("*.py"))}
    return {name: _read_module(name, path, paths.keys()) for name, path in paths.items()}


def _dotted(path: Path, folder: Path) -> str:
    parts = path.relative_to(folder.parent).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def _read_module(name: str, path: Path, known: Any) -> Module:
    text = path.read_text(encoding="utf-8")
    tree, package = ast.parse(text), path.name == "__init__.py"
    imports = tuple(
        Import(target, node.lineno, late)
        for node, late in _imports(tree.body)
        for target in _targets(node, name if package else name.rpartition(".")[0], known)
        if target != name
    )
    classes = tuple(node.name for node in tree.body if isinstance(node, ast.ClassDef))
    return Module(name, path, len(text.splitlines()), package, imports, classes, tuple(_constants(tree.body)))


def _imports(
    body: Sequence[ast.AST], late: bool = False
) -> Iterator[tuple[ast.Import | ast.ImportFrom, bool]]:
    """The imports in a piece of source, and whether they wait until a function runs, or never happen."""
    for node in body:
        if isinstance(node, ast.Import | ast.ImportFrom):
            yield node, late
        elif isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
            yield from _imports(node.body, True)
            yield from _imports(node.orelse, late)
        else:
            inside = late or isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda)
            yield from _imports(list(ast.iter_child_nodes(node)), inside)


def _targets(node: ast.Import | ast.ImportFrom, package: str, known: Any) -> Iterator[str]:
    """The modules that are named in an import and belong to the package."""
    if isinstance(node, ast.Import):
        yield from (alias.name for alias in node.names if alias.name in known)
        return
    above = package.split(".")[: len(package.split(".")) - node.level + 1] if node.level else []
    base = ".".join([*above, *([node.module] if node.module else [])])
    for alias in node.names:
        if f"{base}.{alias.name}" in known:
            yield f"{base}.{alias.name}"
        elif base in known:
            yield base


def _constants(body: Sequence[ast.stmt]) -> Iterator[Constant]:
    for number, node in enumerate(body):
        if not isinstance(node, ast.Assign | ast.AnnAssign) or node.value is None:
            continue
        after = body[number + 1] if number + 1 < len(body) else None
        said = isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant)
        meaning = str(after.value.value) if said else ""  # type: ignore[union-attr]
        for target in node.targets if isinstance(node, ast.Assign) else [node.target]:
            for each in target.elts if isinstance(target, ast.Tuple) else [target]:
                if isinstance(each, ast.Name) and CONSTANT.fullmatch(each.id):
                    yield Constant(each.id, ast.unparse(node.value), " ".join(meaning.split()))


# What follows from it.


def import_graph(modules: Mapping[str, Module], late: bool) -> dict[str, set[str]]:
    """What each module imports; with `late`, also for types and in functions.

    To import a module runs the packages that it lies in first: they count as imported, too, but for those in
    which the importer lies itself.
    """
    graph: dict[str, set[str]] = {name: set() for name in modules}
    for name, module in modules.items():
        for each in module.imports:
            if late or not each.late:
                graph[name].add(each.module)
                parts = each.module.split(".")
                above = (".".join(parts[:count]) for count in range(1, len(parts)))
                graph[name] |= {up for up in above if not f"{name}.".startswith(f"{up}.")}
    return graph


def cycles(graph: Mapping[str, set[str]]) -> list[list[str]]:
    """Sets of modules that import each other, directly or not; each in order of names."""
    reached = {name: _reached(graph, name) for name in graph}
    found = {
        tuple(sorted(other for other in reached[name] if name in reached[other]))
        for name in graph
        if name in reached[name]
    }
    return [list(cycle) for cycle in sorted(found)]


def _reached(graph: Mapping[str, set[str]], start: str) -> set[str]:
    seen: set[str] = set()
    todo = list(graph[start])
    while todo:
        name = todo.pop()
        if name not in seen:
            seen.add(name)
            todo += graph.get(name, ())
    return seen


def upward(modules: Mapping[str, Module], order: Sequence[Sequence[str]] = ORDER) -> list[str]:
    """Imports from a package that is not below, and packages that have no place in the order."""
    level = {name: number for number, names in enumerate(order) for name in names}
    found = []
    for name, module in sorted(modules.items()):
        own = _part(name)
        if own and own not in level:
            found.append(f"{name}: {own} has no place in the order of packages")
        for each in module.imports:
            other = _part(each.module)
            if own and other and own != other and level.get(other, -1) >= level.get(own, len(order)):
                found.append(f"{name}, line {each.line}: imports {each.module}")
    return found


def _part(name: str) -> str:
    """The package or module right below the whole in which a module lies; empty for the whole itself."""
    return name.split(".")[1] if "." in name else ""


def doubled_classes(modules: Mapping[str, Module]) -> dict[str, list[str]]:
    """Names that classes of several modules have, and the modules."""
    homes: dict[str, list[str]] = defaultdict(list)
    for module in modules.values():
        for name in module.classes:
            homes[name].append(module.name)
    return {name: found for name, found in sorted(homes.items()) if len(found) > 1}


def doubled_constants(modules: Mapping[str, Module]) -> dict[str, list[str]]:
    """Names of constants that mean different things in two modules one of which sees the other.

    They mean different things if they have another value, or if what is said of them differs. A module sees
    another one that it imports, or whose package it imports, anywhere in its text.
    """
    homes: dict[str, list[tuple[Module, Constant]]] = defaultdict(list)
    for module in modules.values():
        for constant in module.constants:
            homes[constant.name].append((module, constant))
    found: dict[str, set[str]] = defaultdict(set)
    for name, places in homes.items():
        for (one, first), (two, second) in combinations(places, 2):
            same = first.value == second.value and first.meaning == second.meaning
            if one.name != two.name and not same and (_sees(one, two) or _sees(two, one)):
                found[name] |= {one.name, two.name}
    return {name: sorted(each) for name, each in sorted(found.items())}


def _sees(one: Module, two: Module) -> bool:
    """Whether a module imports another, or the package in which that lies."""
    names = {each.module for each in one.imports}
    return two.name in names or two.name.rpartition(".")[0] in names


# What runs. The names of the library that this needs are here.


class Trace:
    """Files of the package in which a function runs, until a given function is called or returns.

    What runs while a module is imported does not count. Of kernels, which no tracing sees, those count that
    Python calls, and those that they can call in turn.

    Attributes:
        files: the files, in the order in which they are come to.
    """

    def __init__(self, folder: Path, until_return: Any = None, until_call: Any = None) -> None:
        self.files: dict[str, None] = {}
        self._folder, self._importing, self._over = str(folder) + "/", 0, True
        self._until_return, self._until_call = until_return, until_call

    def __enter__(self) -> Trace:
        self._over = False
        threading.setprofile(self._see)
        sys.setprofile(self._see)
        return self

    def __exit__(self, *_: object) -> None:
        sys.setprofile(None)
        threading.setprofile(None)
        self._over = True

    def _see(self, frame: Any, event: str, _: Any) -> None:
        code = frame.f_code
        if code.co_name == "<module>" and event in ("call", "return"):
            self._importing += 1 if event == "call" else -1
        elif event == "call" and code is self._until_call:
            self._over = True
        elif event == "call":
            self.note(code)
        elif event == "return" and code is self._until_return:
            self._over = True

    def note(self, code: Any) -> None:
        """A function has been come to."""
        file = code.co_filename
        if file.startswith(self._folder) and not self._importing and not self._over:
            self.files.setdefault(file[len(self._folder) :])


class Noted:
    """A kernel that tells a trace when it is called; as a kernel else."""

    trace: Trace | None = None

    def __init__(self, kernel: Any) -> None:
        self._kernel, self._codes = kernel, list(_codes_of(kernel, {}))

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


def traced(flow: Callable[[Trace], object], **until: Any) -> list[str]:
    """The files that a flow runs through."""
    import pinposture

    trace = Noted.trace = Trace(Path(pinposture.__file__).parent, **until)
    try:
        flow(trace)
    finally:
        Noted.trace = None
    return list(trace.files)


def run_flows() -> dict[str, list[str]]:
    """The files of a step, of a task and of a drag; each is done once before, so that all is imported."""
    from pinposture import kernels
    from pinposture.control import CONTROLLERS

    step = type(CONTROLLERS["geodesic"]()).step.__code__
    flows: dict[str, tuple[Callable[[Any], object], dict[str, Any]]] = {
        "files of a step": (take_a_step, {"until_return": step}),
        "files of a task": (run_a_task, {}),
        "files of a drag": (drag_a_point, {"until_call": step}),
    }
    for flow, _ in flows.values():
        flow(contextlib.nullcontext())
    kernels.load()
    note_kernels("pinposture")
    return {name: traced(flow, **until) for name, (flow, until) in flows.items()}


def take_a_step(trace: Any) -> None:
    """From `track` to the first step of the default controller, which plans, on an arm with no past."""
    import pinposture as pp

    arm = pp.Arm.from_template("RyRz", modules=6)
    target = pp.Target.from_configuration(arm, arm.configuration([0.3, -0.2] * 6))
    start, track = arm.straight(), pp.track
    with trace:
        track(arm, target, start, max_steps=1)


def run_a_task(trace: Any) -> None:
    """The command line runs a task file."""
    from pinposture.cli import main

    task = ROOT / "examples" / "tasks" / "keyframes.toml"
    before = sys.argv
    with tempfile.TemporaryDirectory() as folder, contextlib.redirect_stdout(io.StringIO()):
        sys.argv = ["pinposture", "run", str(task), "-o", folder]
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
    editor = Editor(Task.load(ROOT / "examples" / "tasks" / "keyframes.toml"), port=port)
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
            asyncio.run(handles._on_drag(1, drag))
            editor._take_requests()
            editor._ask()
            solver._take(session.problem)
            solver._step()
    finally:
        editor.close()


# What is told.


def main() -> int:
    """Count, print, and check."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--check", action="store_true", help="exit code 1 if a ceiling is exceeded")
    parser.add_argument("--flows", action="store_true", help="run a step, a task and a drag as well")
    parser.add_argument("--list", action="store_true", help="list everything that is counted, in full")
    given = parser.parse_args()
    modules = read_package(ROOT / "pinposture")
    lines = [module.lines for module in modules.values()]
    doubled = {f"class {name}": where for name, where in doubled_classes(modules).items()}
    constants = doubled_constants(modules)
    listed: dict[str, list[str]] = {
        "import cycles at run time": [_cycle(each) for each in cycles(import_graph(modules, False))],
        "import cycles with types": [_cycle(each) for each in cycles(import_graph(modules, True))],
        "imports that go up": upward(modules),
        "class names defined twice": [f"{name}: {', '.join(where)}" for name, where in doubled.items()],
        "constants of two meanings in sight": [f"{name}: {', '.join(at)}" for name, at in constants.items()],
    }
    if given.flows:
        sys.path.insert(0, str(ROOT))
        listed |= run_flows()
        inner = [file for file in listed["files of a drag"] if file.startswith("control/")]
        listed["files of a drag"] = [file for file in listed["files of a drag"] if file not in inner]
    counted = {"files": len(lines)}
    counted |= {name: len(each) for name, each in listed.items()}
    print(f"{'':36} {'now':>6} {'ceiling':>8}")
    print(f"{'lines':36} {sum(lines):6}")
    print(f"{'lines of a file, median':36} {median(lines):6g}")
    for name, count in counted.items():
        over = "  exceeded" if count > CEILINGS[name] else ""
        print(f"{name:36} {count:6} {CEILINGS[name]:8}{over}")
    for name, each in listed.items():
        if name.startswith("files of"):
            parts = Counter(file.partition("/")[0] for file in each)
            print(f"\n{name}: {', '.join(f'{part} {count}' for part, count in parts.items())}")
        if given.list or counted[name] > CEILINGS[name]:
            print(f"\n{name}:", *each, sep="\n  ")
    exceeded = [name for name, count in counted.items() if count > CEILINGS[name]]
    return 1 if given.check and exceeded else 0


def _cycle(names: list[str]) -> str:
    return f"{len(names)} modules: {', '.join(names)}"


if __name__ == "__main__":
    sys.exit(main())
