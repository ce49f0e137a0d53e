"""The library does not depend on its evidence, and a wheel does not contain it."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest

import pinposture

ROOT = Path(pinposture.__file__).parent
LIBRARY = sorted(ROOT.rglob("*.py"))


@pytest.mark.long
def test_no_module_of_the_library_imports_studies():
    assert len(LIBRARY) > 100
    for path in LIBRARY:
        for node in ast.walk(ast.parse(path.read_text())):
            names = [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            names += [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            assert not any(name.partition(".")[0] == "benchmarks" for name in names), path


def test_a_wheel_holds_the_library_alone():
    text = (ROOT.parent / "pyproject.toml").read_text()
    wheel = text[text.index("[tool.hatch.build.targets.wheel]") :]
    assert wheel.splitlines()[1] == 'packages = ["pinposture"]'


@pytest.mark.process
def test_baselines_have_names_once_they_are_registered():
    code = (
        "import pinposture\n"
        "from pinposture.control import CONTROLLERS\n"
        "before = set(CONTROLLERS)\n"
        "from benchmarks.baselines import BASELINES, register_baselines\n"
        "assert before == {'geodesic', 'selection', 'projection', 'switching', 'joint'}, before\n"
        "assert set(CONTROLLERS) == before\n"
        "for _ in range(2):\n"
        "    register_baselines()\n"
        "    assert set(CONTROLLERS) == before | set(BASELINES)\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


@pytest.mark.process
def test_methods_are_compared_with_all_baselines_unless_others_are_named():
    code = (
        "from benchmarks.baselines import BASELINES\n"
        "from benchmarks.studies import methods\n"
        "from benchmarks.harness import Study\n"
        "from benchmarks.report import StudyOptions\n"
        "from pinposture.cli.inputs import ArmOptions\n"
        "compared = []\n"
        "methods.compare_methods = lambda _, names, *others: compared.extend(names) or Study([], [], dict)\n"
        "methods.run(arm_options=ArmOptions(), options=StudyOptions(as_json=True))\n"
        "assert set(BASELINES) < set(compared), compared\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
