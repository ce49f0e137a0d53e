"""How the modules of a package hang together: what they import, and the names that they define."""

from __future__ import annotations

import ast
import re
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from itertools import combinations
from pathlib import Path
from typing import Any, NamedTuple

CONSTANT = re.compile(r"_?[A-Z][A-Z0-9_]+")


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
    tree: ast.Module


def read_package(folder: Path) -> dict[str, Module]:
    """All modules of a package, by their dotted names."""
    paths = {_dotted(path, folder): path for path in sorted(folder.rglob("*.py"))}
    return {name: _read_module(name, path, paths.keys()) for name, path in paths.items()}


def _dotted(path: Path, folder: Path) -> str:
    parts = path.relative_to(folder.parent).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def _read_module(name: str, path: Path, known: Any) -> Module:
    text = path.read_text(encoding="utf-8")
    tree = ast.parse(text)
    package = path.name == "__init__.py"
    imports = tuple(
        Import(target, node.lineno, late)
        for node, late in _imports(tree.body)
        for target in _targets(node, name if package else name.rpartition(".")[0], known)
        if target != name
    )
    classes = tuple(node.name for node in tree.body if isinstance(node, ast.ClassDef))
    return Module(
        name=name,
        path=path,
        lines=len(text.splitlines()),
        package=package,
        imports=imports,
        classes=classes,
        constants=tuple(_constants(tree.body)),
        tree=tree,
    )


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


def upward(modules: Mapping[str, Module], order: Sequence[Sequence[str]]) -> list[str]:
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
