"""Does the quick test set catch what the full set catches? Seeded faults in the library tell.

Each fault changes one operator, comparison, condition or number in a copy of the project. With each of them
alone the quick tests of its package run. The whole quick set then runs once with all that these missed, and
each of them alone with the tests that failed; after that the full set, without the browser, in the same way.
What both miss is listed: a fault that makes no difference, or a test that is missing.

    make mutation                                  # 10 faults in each of six packages, about half an hour
    python tests/mutation.py --package curve --count 5 --seed 3
"""

from __future__ import annotations

import argparse
import ast
import json
import os
import re
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from random import Random

from rich.console import Console
from rich.progress import Progress
from rich.table import Table

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("kernels", "arm", "curve", "placement", "control", "motion")
NOT_COPIED = (".git", ".venv", "build", "dist", "out")
FIRST = {"kernels": ("kernels", "control", "placement"), "placement": ("placement", "kernels")}
"""Folders of tests that see a fault in a package soonest; else the folder of its name."""

MEMORY = 8 << 30
"""Address space of each test process: an endless loop that fills a list ends, too [bytes]."""

FAILED = re.compile("(FAILED|ERROR) ")
NO_BROWSER = "--ignore=tests/editor/browser"

SWAPS: dict[type[ast.AST], type[ast.AST]] = {
    ast.Lt: ast.LtE,
    ast.LtE: ast.Lt,
    ast.Gt: ast.GtE,
    ast.GtE: ast.Gt,
    ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot,
    ast.IsNot: ast.Is,
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.And: ast.Or,
    ast.Or: ast.And,
}
CALLS = {"min": "max", "max": "min", "any": "all", "all": "any", "sin": "cos", "cos": "sin"}
UNSEEN = (ast.Raise, ast.JoinedStr, ast.Import, ast.ImportFrom, ast.arg)
"""What no fault is made in: messages, imports, annotations."""


@dataclass(frozen=True)
class Fault:
    """One change of one expression.

    Attributes:
        path: the file, relative to the project.
        line: where the expression begins, from 1.
        before: the expression.
        after: what takes its place.
        span: its first and last character in the file.
    """

    path: str
    line: int
    before: str
    after: str
    span: tuple[int, int]


@dataclass(frozen=True)
class Outcome:
    """What became of a fault.

    Attributes:
        package: where it was.
        fault: what it was.
        caught_by: "quick", "full" or "" for neither.
        test: the first test that failed, or "timeout".
    """

    package: str
    fault: Fault
    caught_by: str
    test: str


def mutations(node: ast.AST) -> Iterator[ast.expr]:
    """Expressions that may take the place of one, each wrong in one way."""
    if isinstance(node, ast.Compare) and len(node.ops) == 1 and type(node.ops[0]) in SWAPS:
        yield ast.Compare(node.left, [SWAPS[type(node.ops[0])]()], node.comparators)  # type: ignore[list-item]
    elif isinstance(node, ast.BinOp) and type(node.op) in SWAPS:
        yield ast.BinOp(node.left, SWAPS[type(node.op)](), node.right)  # type: ignore[arg-type]
    elif isinstance(node, ast.BoolOp):
        yield ast.BoolOp(SWAPS[type(node.op)](), node.values)  # type: ignore[arg-type]
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, (ast.Not, ast.USub)):
        yield node.operand
    elif isinstance(node, ast.IfExp):
        yield ast.IfExp(node.test, node.orelse, node.body)
    elif isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr in CALLS:
        yield ast.Call(ast.Attribute(node.func.value, CALLS[node.func.attr]), node.args, node.keywords)
    elif isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in CALLS:
        yield ast.Call(ast.Name(CALLS[node.func.id]), node.args, node.keywords)
    elif isinstance(node, ast.Constant) and type(node.value) in (int, float):
        yield ast.Constant(node.value + 1 if isinstance(node.value, int) else 2.0 * node.value or 1.0)


def faults_in(path: Path) -> list[Fault]:
    """Every fault that can be made in the functions of a file."""
    text = path.read_text(encoding="utf-8")
    starts = [0]
    for line in text.splitlines(keepends=True):
        starts.append(starts[-1] + len(line.encode()))
    code = text.encode()
    found = []

    def visit(node: ast.AST) -> None:
        for child in ast.iter_child_nodes(node):
            if isinstance(child, UNSEEN):
                continue
            for changed in mutations(child):
                span = (
                    starts[child.lineno - 1] + child.col_offset,
                    starts[child.end_lineno - 1] + child.end_col_offset,
                )
                before = code[slice(*span)].decode()
                after = f"({ast.unparse(ast.fix_missing_locations(changed))})"
                found.append(Fault(str(path.relative_to(ROOT)), child.lineno, before, after, span))
            visit(child)

    for function in ast.walk(ast.parse(text)):
        if isinstance(function, ast.FunctionDef):
            for statement in function.body:
                visit(statement)
    return sorted(set(found), key=lambda fault: fault.span)


def draw_faults(package: str, count: int, seed: int) -> list[Fault]:
    """Faults in a package, no two within ten lines of each other."""
    every = [
        fault for path in sorted((ROOT / "pinposture" / package).rglob("*.py")) for fault in faults_in(path)
    ]
    Random(f"{package} {seed}").shuffle(every)
    drawn: list[Fault] = []
    for fault in every:
        if all(fault.path != other.path or abs(fault.line - other.line) > 10 for other in drawn):
            drawn.append(fault)
        if len(drawn) == count:
            break
    return drawn


class Copy:
    """A copy of the project, to make faults in.

    Args:
        folder: where it is made; empty.
        timeout: how long one run of tests may take [s].
    """

    def __init__(self, folder: Path, timeout: float) -> None:
        self._folder = folder
        self._timeout = timeout
        shutil.copytree(ROOT, folder, ignore=shutil.ignore_patterns(*NOT_COPIED), dirs_exist_ok=True)

    def failing(self, faults: Sequence[Fault], *arguments: str) -> list[str]:
        """Tests that fail with some faults; "timeout" alone if they do not end.

        Args:
            faults: what is changed, no two at the same place.
            arguments: of pytest.
        """
        whole = {fault.path: (self._folder / fault.path).read_bytes() for fault in faults}
        for fault in sorted(faults, key=lambda each: -each.span[0]):
            path = self._folder / fault.path
            text = path.read_bytes()
            path.write_bytes(text[: fault.span[0]] + fault.after.encode() + text[fault.span[1] :])
        try:
            return self._run(arguments)
        finally:
            for name, text in whole.items():
                (self._folder / name).write_bytes(text)

    def _run(self, arguments: Sequence[str]) -> list[str]:
        command = [
            sys.executable,
            "-m",
            "pytest",
            "-q",
            "-rfE",
            "--no-header",
            "--tb=no",
            "-p",
            "no:cacheprovider",
        ]
        command += ["-n", "auto", "--maxprocesses", "6", "--dist", "worksteal", *arguments]
        seen = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
        seen |= {"PYTHONPATH": str(self._folder), "OPENBLAS_NUM_THREADS": "1", "MPLBACKEND": "Agg"}
        pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True}
        child = subprocess.Popen(
            command,
            cwd=self._folder,
            env=seen,
            start_new_session=True,
            preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY)),
            **pipes,
        )
        try:
            out, _ = child.communicate(timeout=self._timeout)
        except subprocess.TimeoutExpired:
            os.killpg(child.pid, signal.SIGKILL)
            child.communicate()
            return ["timeout"]
        if child.returncode in (0, 5):  # all passed, or there was none
            return []
        failed = [
            line.split(" - ")[0].split(maxsplit=1)[1] for line in out.splitlines() if FAILED.match(line)
        ]
        return failed or [out.strip().splitlines()[-1]]


def judge(
    copy: Copy, faults: list[tuple[str, Fault]], done: Callable[[list[Outcome]], object]
) -> list[Outcome]:
    """Run the sets.

    Args:
        copy: the project.
        faults: each with its package.
        done: told of the outcomes after each run.
    """
    outcomes = [Outcome(package, fault, "", "") for package, fault in faults]

    def run(k: int, name: str, *arguments: str) -> None:
        if failed := copy.failing([outcomes[k].fault], *arguments):
            outcomes[k] = replace(outcomes[k], caught_by=name, test=failed[0])
        done(outcomes)

    for k, (package, _) in enumerate(faults):
        run(k, "quick", "-x", *(f"tests/{name}" for name in FIRST.get(package, (package,))))
    for name, arguments in (("quick", ()), ("full", ("--full", NO_BROWSER))):
        missed = [k for k, each in enumerate(outcomes) if not each.caught_by]
        failing = copy.failing([outcomes[k].fault for k in missed], *arguments)
        endless = failing == ["timeout"]  # the fault that causes it hides what the others do
        if failing and not endless:
            known = copy.failing([], *arguments, *failing)
            failing = [test for test in failing if test not in known]
        for k in missed if failing else []:
            run(k, name, *arguments, *(() if endless else failing))
    return outcomes


def tell(console: Console, outcomes: list[Outcome]) -> None:
    """A row for each package, and each fault that the quick set missed."""
    table = Table("package", "faults", "caught by the quick set", "by the full set", "quick / full")
    for package in (*PACKAGES, "all"):
        own = [each for each in outcomes if package in (each.package, "all")]
        if own:
            quick = sum(each.caught_by == "quick" for each in own)
            full = sum(each.caught_by != "" for each in own)
            share = f"{quick / full:.0%}" if full else "-"
            table.add_row(package, str(len(own)), str(quick), str(full), share)
    console.print(table)
    for each in outcomes:
        if each.caught_by != "quick":
            by = f"caught by {each.test}" if each.caught_by else "not caught"
            where = f"{each.fault.path}:{each.fault.line}"
            console.print(
                f"{where}: {each.fault.before} -> {each.fault.after}: {by}", markup=False, highlight=False
            )


def main() -> None:
    """Run, tabulate, keep."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--package", choices=PACKAGES, action="append", help="of these alone")
    parser.add_argument("--count", type=int, default=10, help="faults in each package (10)")
    parser.add_argument("--seed", type=int, default=0, help="which faults (0)")
    parser.add_argument("--timeout", type=float, default=600.0, help="seconds for one run of tests (600)")
    parser.add_argument(
        "--save", type=Path, default=ROOT / "out" / "mutation.json", help="where to keep them"
    )
    given = parser.parse_args()
    console = Console(width=None if sys.stdout.isatty() else 150)
    faults = [
        (package, fault)
        for package in given.package or PACKAGES
        for fault in draw_faults(package, given.count, given.seed)
    ]
    given.save.parent.mkdir(parents=True, exist_ok=True)
    with (
        tempfile.TemporaryDirectory() as folder,
        Progress(console=Console(stderr=True), transient=True) as progress,
    ):
        task = progress.add_task("faults", total=len(faults))

        def keep(outcomes: list[Outcome]) -> None:
            given.save.write_text(json.dumps([asdict(each) for each in outcomes], indent=1))
            progress.update(task, completed=sum(each.caught_by != "" for each in outcomes))

        copy = Copy(Path(folder), given.timeout)
        if failed := copy.failing([]):
            sys.exit(f"without a fault, {failed[0]} fails")
        outcomes = judge(copy, faults, keep)
    tell(console, outcomes)


if __name__ == "__main__":
    main()
