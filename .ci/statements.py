"""What a reader meets inside the files: definitions, parameters, statements that share a line."""

from __future__ import annotations

import ast
from collections.abc import Iterator, Mapping

from imports import Module

Function = ast.FunctionDef | ast.AsyncFunctionDef

MOST_PARAMETERS = 7
"""The most parameters of a function, `self` not counted.

Not counted either are the options of a public function that can only be passed by name, because each call
says what they are.
"""

MOST_PARAMETERS_OF_A_KERNEL = 12
"""The most of a kernel, which takes arrays and no objects."""


def definitions(modules: Mapping[str, Module]) -> list[str]:
    """Functions and classes, methods and inner ones included."""
    kinds = (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)
    return [f"{where}: {node.name}" for where, node in _nodes(modules) if isinstance(node, kinds)]


def constants(modules: Mapping[str, Module]) -> list[str]:
    """Constants of modules, by their names in capitals."""
    return [f"{module.name}: {each.name}" for module in modules.values() for each in module.constants]


def long_parameter_lists(modules: Mapping[str, Module]) -> list[str]:
    """Functions that take more than their kind may."""
    public = _public_functions(modules)
    found = []
    for where, node in _nodes(modules):
        if not isinstance(node, Function):
            continue
        kernel = ".kernels." in where
        most = MOST_PARAMETERS_OF_A_KERNEL if kernel else MOST_PARAMETERS
        given = node.args.posonlyargs + node.args.args
        if node not in public:
            given = given + node.args.kwonlyargs
        count = sum(each.arg not in ("self", "cls") for each in given)
        if count > most:
            found.append(f"{where}: {node.name} takes {count}")
    return found


def _public_functions(modules: Mapping[str, Module]) -> set[ast.AST]:
    """Functions that a package lists in `__all__`, and the methods of the classes there."""
    names = set()
    for module in modules.values():
        for node in module.tree.body if module.package else ():
            if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "__all__":
                names |= set(ast.literal_eval(node.value))
    found: set[ast.AST] = set()
    for module in modules.values():
        for node in module.tree.body:
            if isinstance(node, Function) and node.name in names:
                found.add(node)
            elif isinstance(node, ast.ClassDef) and node.name in names:
                found |= {each for each in node.body if isinstance(each, Function)}
    return found


def spread_calls(modules: Mapping[str, Module]) -> list[str]:
    """Calls of kernels whose arguments come out of a tuple, so that no reader sees which is which."""
    kernels = {
        node.name for where, node in _nodes(modules) if ".kernels." in where and isinstance(node, Function)
    }
    found = []
    for where, node in _nodes(modules):
        if isinstance(node, ast.Call) and any(isinstance(each, ast.Starred) for each in node.args):
            of, _, name = ast.unparse(node.func).rpartition(".")
            if name in kernels and of == ("" if ".kernels." in where else "kernels"):
                found.append(f"{where}: {ast.unparse(node)}")
    return found


def shared_lines(modules: Mapping[str, Module]) -> list[str]:
    """Assignments of two or more values side by side, but for exchanges, in which one needs the other."""
    found = []
    for where, node in _nodes(modules):
        if isinstance(node, ast.Assign) and isinstance(node.value, ast.Tuple):
            side_by_side = [each for each in node.targets if isinstance(each, ast.Tuple)]
            if any(_independent(each.elts, node.value.elts) for each in side_by_side):
                found.append(f"{where}: {ast.unparse(node)}")
    return found


def subtractions_from_targets(modules: Mapping[str, Module]) -> list[str]:
    """Places that subtract points from those of a target by themselves."""
    found = []
    for where, node in _nodes(modules):
        if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Sub):
            sides = [ast.unparse(side) for side in (node.left, node.right)]
            if any(side.split("[")[0].endswith(("target.points", "goal.points")) for side in sides):
                found.append(f"{where}: {ast.unparse(node)}")
    return found


def _nodes(modules: Mapping[str, Module]) -> Iterator[tuple[str, ast.AST]]:
    """All nodes of all modules, and where they are."""
    for module in modules.values():
        for node in ast.walk(module.tree):
            yield f"{module.name}, line {getattr(node, 'lineno', 0)}", node


def _independent(targets: list[ast.expr], values: list[ast.expr]) -> bool:
    """Whether no value needs what a target before it had."""
    if len(targets) != len(values):
        return False
    for number, target in enumerate(targets):
        own = ast.unparse(target)
        base = own.split("[")[0]
        later = [ast.unparse(part) for value in values[number + 1 :] for part in ast.walk(value)]
        if base in later:
            return False
    return True
