"""The script that counts how large the library is and how its parts hang together."""

from __future__ import annotations

import ast
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parents[1] / ".ci" / "structure.py"
sys.path.insert(0, str(SCRIPT.parent))

import flows  # noqa: E402
import imports  # noqa: E402
import statements  # noqa: E402

FILES = {
    "__init__.py": "",
    "low/__init__.py": "from made.low.one import One\n",
    "low/one.py": (
        "from typing import TYPE_CHECKING\n"
        "import made.low.two\n"
        "if TYPE_CHECKING:\n    from made.high import Other\n"
        'FAR = 0.1\n"""How far is far [m]."""\nNEAR = 1.0\n\n'
        "class One: ...\n"
    ),
    "low/two.py": "from . import one\nFAR = 0.1\nNEAR = 1.0\nclass Two: ...\n",
    "low/three.py": "def late():\n    from made.low.four import FAR\n    return FAR\nclass Three: ...\n",
    "low/four.py": "import made.low.three\nimport os\nFAR: float = 2.0\nclass Four: ...\n",
    "high.py": "from made.low import One\nfrom made.low.four import Four\nclass Two: ...\nclass Other: ...\n",
    "lone.py": 'FAR = "far"\n',
}
ORDER = (("low",), ("high",))


@pytest.fixture
def made(tmp_path: Path) -> Path:
    """A package with every fault that is counted."""
    for name, text in FILES.items():
        path = tmp_path / "made" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    return tmp_path / "made"


def test_files_and_lines_are_those_of_the_package(made: Path) -> None:
    modules = imports.read_package(made)
    assert sorted(modules) == [
        "made",
        "made.high",
        "made.lone",
        "made.low",
        *(f"made.low.{name}" for name in ("four", "one", "three", "two")),
    ]
    assert {module.path.name: module.lines for module in modules.values()}["two.py"] == 4


def test_cycles_at_run_time_and_with_types(made: Path) -> None:
    modules = imports.read_package(made)
    assert imports.cycles(imports.import_graph(modules, late=False)) == [["made.low.one", "made.low.two"]]
    # With types, one of the modules of `low` imports `high` in turn; three and four only each other.
    assert imports.cycles(imports.import_graph(modules, late=True)) == [
        ["made.high", "made.low", "made.low.one", "made.low.two"],
        ["made.low.four", "made.low.three"],
    ]


def test_imports_that_go_up_and_packages_without_a_place(made: Path) -> None:
    found = imports.upward(imports.read_package(made), ORDER)
    assert found == [
        "made.lone: lone has no place in the order of packages",
        "made.low.one, line 4: imports made.high",
    ]


def test_names_of_classes_and_constants_that_mean_two_things(made: Path) -> None:
    modules = imports.read_package(made)
    assert imports.doubled_classes(modules) == {"Two": ["made.high", "made.low.two"]}
    # One says what it means and two does not; three defines none, and nobody sees the one of `lone`.
    assert imports.doubled_constants(modules) == {"FAR": ["made.low.one", "made.low.two"]}


def test_a_trace_leaves_out_what_is_imported_and_what_comes_after_the_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "walked"
    folder.mkdir()
    texts = {
        "__init__": "",
        "start": "def go():\n    import walked.loaded\n    return first() + after()\n"
        "def first():\n    from walked.step import step\n    return step()\n"
        "def after():\n    from walked.later import later\n    return later()\n",
        "loaded": "from walked.used import used\nused()\n",
        "used": "def used(): return 1\n",
        "step": "def step(): return 1\n",
        "later": "def later(): return 1\n",
    }
    for name, text in texts.items():
        (folder / f"{name}.py").write_text(text)
    monkeypatch.syspath_prepend(str(tmp_path))
    start = import_module("walked.start")
    step = import_module("walked.step")
    for until, files, counts in (
        ({}, ["start.py", "step.py", "later.py"], (5, 2)),  # go, first, step, after, later
        ({"until_return": step.step.__code__}, ["start.py", "step.py"], (3, 1)),
        ({"until_call": step.step.__code__}, ["start.py"], (2, 0)),
    ):
        for name in ("loaded", "used", "later"):
            sys.modules.pop(f"walked.{name}", None)
        trace = flows.Trace(folder, **until)
        with trace:
            start.go()
        assert list(trace.files) == files
        assert (trace.calls, trace.switches) == counts


def read(tmp_path: Path, text: str, name: str = "made/one.py") -> dict[str, imports.Module]:
    """A package with one module of this text."""
    path = tmp_path / name
    path.parent.mkdir(parents=True)
    path.write_text(text)
    return imports.read_package(tmp_path / "made")


@pytest.mark.parametrize(
    ("text", "counted"),
    [
        ("a, b = f(), g()", True),
        ("a, b = 1, 2", True),
        ("self.a, (b, c) = x, f()", True),
        ("a, b = b, a", False),
        ("x[i], x[j] = x[j], x[i]", False),
        ("a, b = f(x)", False),
        ("a = f(), g()", False),
        ("for a, b in f(x): pass", False),
    ],
)
def test_assignments_share_a_line_unless_one_needs_the_other(
    tmp_path: Path, text: str, counted: bool
) -> None:
    found = statements.shared_lines(read(tmp_path, text))
    assert found == ([f"made.one, line 1: {ast.unparse(ast.parse(text))}"] if counted else [])


def test_functions_of_too_many_parameters_are_named_kernels_may_take_more(tmp_path: Path) -> None:
    def function(count: int) -> str:
        return f"def f({', '.join(f'a{number}' for number in range(count))}): ..."

    method = "class C:\n    def f(self, a, b, c, d, e, f, *, g): ..."
    for number, (text, name, count) in enumerate(
        [
            (function(7), "one", 0),
            (function(8), "one", 8),
            (method, "one", 0),
            (method.replace("g)", "g, h)"), "one", 8),
            (function(12), "kernels/one", 0),
            (function(13), "kernels/one", 13),
        ]
    ):
        found = statements.long_parameter_lists(read(tmp_path / str(number), text, f"made/{name}.py"))
        assert [each.rpartition(" ")[2] for each in found] == ([str(count)] if count else [])


def test_calls_of_kernels_that_are_spread_are_found(tmp_path: Path) -> None:
    (tmp_path / "made" / "kernels").mkdir(parents=True)
    (tmp_path / "made" / "kernels" / "one.py").write_text("def turn(a, b, c): ...")
    (tmp_path / "made" / "two.py").write_text("kernels.turn(*pair, c)\nkernels.turn(a, b, c)\nother(*pair)")
    found = statements.spread_calls(imports.read_package(tmp_path / "made"))
    assert found == ["made.two, line 1: kernels.turn(*pair, c)"]


def test_subtractions_from_the_points_of_a_target_are_found(tmp_path: Path) -> None:
    text = "target.points - x\nx - self._target.points[k]\ncurve.points - x\ntarget.points + x"
    found = statements.subtractions_from_targets(read(tmp_path, text))
    assert [each.partition(": ")[2] for each in found] == ["target.points - x", "x - self._target.points[k]"]


@pytest.mark.process
def test_a_step_a_task_and_a_drag_can_be_followed_through_their_files() -> None:
    command = [sys.executable, SCRIPT, "--flows", "--list", "--check"]
    found = subprocess.run(command, capture_output=True, text=True, check=False)
    assert found.returncode == 0, found.stdout + found.stderr
    for file in ("motion/track.py", "cli/app.py", "editor/session.py", "kernels/path_following.py"):
        assert f"\n  {file}\n" in found.stdout
