"""The room of kernels: what it offers, what it needs, and where the results are kept."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from pinposture import kernels
from pinposture.kernels import compiled

ROOM = Path(kernels.__file__).parent


def test_every_kernel_is_offered_to_people_and_to_type_checkers_alike() -> None:
    tree = ast.parse((ROOM / "__init__.py").read_text())
    shown = {
        (alias.name, node.module.rpartition(".")[2])
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("pinposture.kernels.")
        for alias in node.names
    }
    assert shown == set(kernels._HOMES.items())
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


def test_machine_code_is_kept_until_any_kernel_changes() -> None:
    kept = kernels.sum_distances._cache._cache_file
    assert kept._source_stamp == compiled._stamp()
    assert compiled.is_ready(kernels.sum_distances) or not kernels.sum_distances.signatures


NOWHERE = """
import numpy as np
from numba.core.dispatcher import Dispatcher

def refused(self):
    raise RuntimeError("cannot cache function: no locator available")

Dispatcher.enable_caching = refused  # as numba does where it finds no folder
from pinposture import kernels
print(kernels.sum_distances(np.zeros((2, 3)), np.ones((2, 3)), np.ones(2, dtype=bool)))
"""


def test_where_nothing_can_be_kept_it_works_and_says_so() -> None:
    ran = subprocess.run([sys.executable, "-c", NOWHERE], capture_output=True, text=True, check=True)
    assert float(ran.stdout) == pytest.approx(2.0 * np.sqrt(3.0))
    assert ran.stderr.count("no folder to keep compiled kernels in") == 1
