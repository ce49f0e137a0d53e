"""The names that `import pinposture as pp` offers."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest

import pinposture as pp

SOURCE = Path(pp.__file__)


def test_every_name_is_there_and_known_to_type_checkers() -> None:
    block, _ = (node for node in ast.parse(SOURCE.read_text()).body if isinstance(node, ast.If))
    homes = {alias.name: node.module for node in block.body for alias in node.names}
    assert set(homes) == set(pp.__all__)
    assert list(pp.__all__) == sorted(pp.__all__)
    for name, module in homes.items():
        assert module.split(".")[1] == pp._PACKAGE_OF[name]
        assert callable(getattr(pp, name))
    assert dir(pp) == sorted([*pp.__all__, "__version__"])
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        _ = pp.nothing


def test_packages_are_there_without_an_import_of_their_own() -> None:
    code = (
        "import pinposture as pp; print(pp.placement.__name__, pp.sim.__name__, pp.curve.Curve is pp.Curve)"
    )
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout.split() == ["pinposture.placement", "pinposture.sim", "True"]


def test_nothing_is_imported_before_it_is_used() -> None:
    code = "import sys, pinposture; print(*sys.modules)"
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    loaded = {name.partition(".")[0] for name in found.stdout.split()}
    assert not loaded & {"pinocchio", "numpy", "scipy", "matplotlib", "meshcat", "numba"}
    assert [name for name in found.stdout.split() if name.startswith("pinposture.")] == []
