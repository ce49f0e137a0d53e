"""Virtual environments for the peers, under build/bench: made when first needed, kept until `make clean`.

This library, pink, mink, OMPL and roboplan share one, so that they run on the same NumPy, Pinocchio and
DAQP. Placo pins another Pinocchio and has its own. What cannot be installed is left out, with the reason.
"""

from __future__ import annotations

import hashlib
import subprocess
import sys
import venv
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[2]
FOLDER = ROOT / "build" / "bench"


class Recipe(NamedTuple):
    """How an environment comes about.

    Attributes:
        folder: name of the virtual environment.
        packages: what pip installs.
        module: what has to be importable then.
    """

    folder: str
    packages: tuple[str, ...]
    module: str


ENVIRONMENTS = {
    "ours": Recipe("peers", ("--editable", str(ROOT)), "pinposture"),
    "pink": Recipe("peers", ("pin-pink", "qpsolvers", "daqp"), "pink"),
    "mink": Recipe("peers", ("mink", "mujoco", "qpsolvers", "daqp"), "mink"),
    "ompl": Recipe("peers", ("ompl",), "ompl"),
    "roboplan": Recipe("peers", ("roboplan",), "roboplan.rrt"),
    "placo": Recipe("placo", ("placo",), "placo"),
    "toppra": Recipe("toppra", ("toppra", "pin"), "toppra"),
    "ruckig": Recipe("ruckig", ("ruckig",), "ruckig"),
}
"""Recipes by the names that `peers.Entry.environment` uses; those of a folder are installed in this order."""


class Environment(NamedTuple):
    """Where a method runs.

    Attributes:
        python: the interpreter, or None if there is none.
        reason: why there is none, or what is odd about it; else empty.
    """

    python: str | None
    reason: str = ""


def prepare(names: set[str], told: Callable[[str], object] = lambda text: None) -> dict[str, Environment]:
    """Make the environments of these names; `told` hears what is being done."""
    made: dict[str, Environment] = {}
    for name, recipe in ENVIRONMENTS.items():
        if name in names:
            told(f"environment of {name}: {' '.join(recipe.packages)}")
            made[name] = _prepared(name, recipe)
    ours = made.get("ours")
    if ours is not None and (ours.python is None or not _imports(ours.python, "pinposture")):
        # The peers changed a package under it, or it cannot live beside them: it runs where this script runs.
        why = ours.reason or "the packages of a peer do not go with it"
        made["ours"] = Environment(sys.executable, f"not in the environment of the peers: {why}")
    return made


def here(names: set[str]) -> dict[str, Environment]:
    """The interpreter that runs this, for everything that it can import."""
    made = {}
    for name in names:
        module = ENVIRONMENTS[name].module
        found = _imports(sys.executable, module)
        made[name] = Environment(sys.executable) if found else Environment(None, f"no {module} here")
    return made


def _prepared(name: str, recipe: Recipe) -> Environment:
    folder = FOLDER / recipe.folder
    python = folder / "bin" / "python"
    stamp = folder / f"{name}.stamp"
    wanted = _wanted(name, recipe)
    if stamp.exists() and stamp.read_text() == wanted:
        return Environment(str(python))
    try:
        if not python.exists():
            venv.create(folder, with_pip=True)
        command = [str(python), "-m", "pip", "install", "--quiet", *recipe.packages]
        subprocess.run(command, check=True, capture_output=True, text=True, timeout=900)
    except subprocess.CalledProcessError as error:
        lines = [line for line in (error.stderr or "").splitlines() if "ERROR" in line]
        return Environment(None, (lines or ["pip failed"])[-1][:160])
    except (OSError, subprocess.TimeoutExpired) as error:
        return Environment(None, f"{type(error).__name__}: {error}"[:160])
    if not _imports(str(python), recipe.module):
        return Environment(None, f"installed, but `import {recipe.module}` fails")
    stamp.write_text(wanted)
    return Environment(str(python))


def _wanted(name: str, recipe: Recipe) -> str:
    """Changes when the environment has to be installed again."""
    text = " ".join([*recipe.packages, sys.version])
    if name == "ours":
        text += (ROOT / "pyproject.toml").read_text()
    return hashlib.sha256(text.encode()).hexdigest()


def _imports(python: str, module: str) -> bool:
    return (
        subprocess.run([python, "-c", f"import {module}"], capture_output=True, check=False).returncode == 0
    )
