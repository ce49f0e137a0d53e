"""The room of kernels: what it offers, what it needs, and where the results are kept."""

from __future__ import annotations

import ast
import os
import pickle
import subprocess
import sys
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace
from typing import Annotated, Any, TypeVar
from unittest.mock import Mock

import numba
import numpy as np
import pytest
from llvmlite import binding
from numba import types
from typing_extensions import TypeAliasType

from pinposture import kernels
from pinposture.kernels import compiled
from pinposture.kernels.arrays import Array2
from pinposture.kernels.compiled import arguments_of

ROOM = Path(kernels.__file__).parent


def test_every_kernel_can_be_called() -> None:
    for name in kernels.NAMES:
        assert callable(getattr(kernels, name))
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        _ = kernels.nothing


def test_kernels_know_of_nothing_above_them() -> None:
    for path in ROOM.glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("pinposture"):
                assert node.module.startswith("pinposture.kernels."), path.name


def test_importing_the_package_starts_no_compiler() -> None:
    code = "import sys, pinposture; print('numba' in sys.modules)"
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout == "False\n"


def test_machine_code_is_kept_until_its_sources_change() -> None:
    kept = kernels.sum_point_errors._cache._cache_file
    assert kept._source_stamp == compiled.source_stamp(ROOM / "path_following.py")
    assert compiled.is_ready(kernels.sum_point_errors) or not kernels.sum_point_errors.signatures


def test_a_stamp_is_that_of_a_file_and_of_what_it_imports(tmp_path: Path) -> None:
    for path in ROOM.glob("*.py"):
        (tmp_path / path.name).write_bytes(path.read_bytes())
    changed = {}
    before = stamps(tmp_path)
    for name in ("spline", "collision"):
        text = (tmp_path / f"{name}.py").read_text()
        (tmp_path / f"{name}.py").write_text(text + "# changed\n")
        changed[name] = {file for file, stamp in stamps(tmp_path).items() if stamp != before[file]}
        (tmp_path / f"{name}.py").write_text(text)
    assert changed["collision"] == {"collision", "continuous_collision", "tree_search"}
    assert changed["spline"] >= {"spline", "modules"}
    assert not changed["spline"] & {"collision", "kinematics", "chain_solver"}
    assert stamps(tmp_path) == before == stamps(ROOM)  # contents count, not times or places


def stamps(folder: Path) -> dict[str, str]:
    """The stamp of every file of a folder, read anew."""
    compiled.source_stamp.cache_clear()
    compiled._sources.cache_clear()
    return {path.stem: compiled.source_stamp(path) for path in folder.glob("*.py")}


COMPILED_HERE = """
import sys
import numpy as np
from numba.core import event

class Count(event.Listener):
    names = []
    def on_start(self, event):
        self.names.append(event.data["dispatcher"].py_func.__name__)
    def on_end(self, event):
        pass

event.register("numba:compile", Count())
from pinposture import kernels
sys.stdin.read()
kernels.sum_point_errors(np.zeros((2, 3)), np.ones((2, 3)), np.ones(2, dtype=bool))
print(Count.names.count("sum_point_errors"))
"""


@pytest.mark.process
def test_processes_that_want_a_kernel_at_the_same_time_compile_it_once(tmp_path: Path) -> None:
    line = [sys.executable, "-c", COMPILED_HERE]
    there = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True, "env": there}
    started = [subprocess.Popen(line, **pipes) for _ in range(3)]
    for each in started:
        each.stdin.close()
    counts = [int(each.stdout.read()) for each in started]
    assert [each.wait(60) for each in started] == [0, 0, 0]
    assert sorted(counts) == [0, 0, 1]


TWICE = """
import pinposture.kernels.compiled as making

@making.compiled
def twice(x: float) -> float:
    return 2.0 * x
"""
FOUR_TIMES = """
from kernel_twice import twice
import pinposture.kernels.compiled as making

@making.compiled
def four_times(x: float) -> float:
    return twice(twice(x))
"""


@pytest.mark.long
def test_what_links_a_cached_kernel_is_read_only_where_another_is_compiled(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "kernel_twice.py").write_text(TWICE)
    (tmp_path / "kernel_four_times.py").write_text(FOUR_TIMES)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr("llvmlite.binding.parse_bitcode", noted := Mock(wraps=binding.parse_bitcode))

    def call(name: str, x: float) -> tuple[float, int]:
        """The value of a kernel that is imported anew, and how many linked kernels were read for it."""
        for module in ("kernel_twice", "kernel_four_times"):
            sys.modules.pop(module, None)
        noted.reset_mock()
        value = getattr(import_module(f"kernel_{name}"), name)(x)
        return value, sum(b"twice" in each.args[0] for each in noted.call_args_list)

    assert call("twice", 1.0) == (2.0, 0)  # compiled
    assert call("twice", 3.0) == (6.0, 0)  # as all below from the cache
    assert call("four_times", 1.0) == (4.0, 1)  # compiled
    assert call("four_times", 3.0) == (12.0, 0)


NOWHERE = """
import numpy as np
from numba.core.dispatcher import Dispatcher

def refused(self):
    raise RuntimeError("cannot cache function: no locator available")

Dispatcher.enable_caching = refused  # as numba does where it finds no folder
from pinposture import kernels
print(kernels.sum_point_errors(np.zeros((2, 3)), np.ones((2, 3)), np.ones(2, dtype=bool)))
"""


@pytest.mark.long
def test_where_nothing_can_be_kept_it_works_and_says_so() -> None:
    ran = subprocess.run([sys.executable, "-c", NOWHERE], capture_output=True, text=True, check=True)
    assert float(ran.stdout) == pytest.approx(2.0 * np.sqrt(3.0))
    assert ran.stderr.count("no folder to store compiled kernels") == 1


def test_an_index_of_another_version_counts_as_none(monkeypatch: pytest.MonkeyPatch) -> None:
    kept = kernels.sum_point_errors._cache._cache_file

    path = Path(kept._index_path)
    before = path.read_bytes() if path.exists() else None
    try:
        path.write_bytes(pickle.dumps(numba.__version__) + b"cpinposture.kernels.arrays\nNoSuchClass\n.")
        assert kept._load_index() == {}
        assert compiled.is_ready(kernels.sum_point_errors) == bool(kernels.sum_point_errors.signatures)
    finally:
        path.unlink() if before is None else path.write_bytes(before)


def test_arguments_are_known_whether_or_not_numpy_names_its_arrays_by_an_alias() -> None:
    """NumPy 2.5 does, where Python can."""
    element = TypeVar("element", bound=np.generic)
    alias = TypeAliasType("alias", np.ndarray[Any, np.dtype[element]], type_params=(element,))

    def kernel(named, plain):
        return None

    kernel.__annotations__ = {"named": Annotated[alias[np.float64], 2], "plain": Array2}
    named, plain = arguments_of(SimpleNamespace(py_func=kernel))
    assert named == plain == types.Array(types.float64, 2, "C")
