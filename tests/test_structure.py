"""The script that counts how large the library is and how its parts hang together."""

from __future__ import annotations

import subprocess
import sys
from importlib import import_module
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType

import pytest

SCRIPT = Path(__file__).parents[1] / ".ci" / "structure.py"

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
def structure(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    spec = spec_from_file_location("structure", SCRIPT)
    assert spec is not None
    assert spec.loader is not None
    module = module_from_spec(spec)
    monkeypatch.setitem(sys.modules, "structure", module)
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def made(tmp_path: Path) -> Path:
    """A package with every fault that is counted."""
    for name, text in FILES.items():
        path = tmp_path / "made" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    return tmp_path / "made"


def test_files_and_lines_are_those_of_the_package(structure: ModuleType, made: Path) -> None:
    modules = structure.read_package(made)
    assert sorted(modules) == [
        "made",
        "made.high",
        "made.lone",
        "made.low",
        *(f"made.low.{name}" for name in ("four", "one", "three", "two")),
    ]
    assert {module.path.name: module.lines for module in modules.values()}["two.py"] == 4


def test_cycles_at_run_time_and_with_types(structure: ModuleType, made: Path) -> None:
    modules = structure.read_package(made)
    assert structure.cycles(structure.import_graph(modules, late=False)) == [["made.low.one", "made.low.two"]]
    # With types, one of the modules of `low` imports `high` in turn; three and four only each other.
    assert structure.cycles(structure.import_graph(modules, late=True)) == [
        ["made.high", "made.low", "made.low.one", "made.low.two"],
        ["made.low.four", "made.low.three"],
    ]


def test_imports_that_go_up_and_packages_without_a_place(structure: ModuleType, made: Path) -> None:
    found = structure.upward(structure.read_package(made), ORDER)
    assert found == [
        "made.lone: lone has no place in the order of packages",
        "made.low.one, line 4: imports made.high",
    ]


def test_names_of_classes_and_constants_that_mean_two_things(structure: ModuleType, made: Path) -> None:
    modules = structure.read_package(made)
    assert structure.doubled_classes(modules) == {"Two": ["made.high", "made.low.two"]}
    # One says what it means and two does not; three defines none, and nobody sees the one of `lone`.
    assert structure.doubled_constants(modules) == {"FAR": ["made.low.one", "made.low.two"]}


def test_a_trace_leaves_out_what_is_imported_and_what_comes_after_the_end(
    structure: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
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
    start, step = import_module("walked.start"), import_module("walked.step")
    for until, files in (
        ({}, ["start.py", "step.py", "later.py"]),
        ({"until_return": step.step.__code__}, ["start.py", "step.py"]),
        ({"until_call": step.step.__code__}, ["start.py"]),
    ):
        for name in ("loaded", "used", "later"):
            sys.modules.pop(f"walked.{name}", None)
        trace = structure.Trace(folder, **until)
        with trace:
            start.go()
        assert list(trace.files) == files


@pytest.mark.process
def test_a_step_a_task_and_a_drag_can_be_followed_through_their_files() -> None:
    command = [sys.executable, SCRIPT, "--flows", "--list", "--check"]
    found = subprocess.run(command, capture_output=True, text=True, check=False)
    assert found.returncode == 0, found.stdout + found.stderr
    for file in ("motion/track.py", "cli/app.py", "editor/session.py", "kernels/path_following.py"):
        assert f"\n  {file}\n" in found.stdout
