"""The recipe for conda-forge agrees with pyproject.toml."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

try:
    import tomllib
except ImportError:  # Python 3.10
    import tomli as tomllib

yaml = pytest.importorskip("yaml")

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
CONDA = {"pin": "pinocchio", "matplotlib": "matplotlib-base", "meshcat": "meshcat-python"}
"""Names on conda-forge of packages that are called otherwise on PyPI."""


@pytest.fixture(scope="module")
def recipe() -> dict[str, Any]:
    text = (ROOT / "recipe" / "recipe.yaml").read_text()
    for name, value in yaml.safe_load(text)["context"].items():
        text = text.replace(f"${{{{ {name} }}}}", value)
    return yaml.safe_load(text)


def conda(requirement: str) -> str:
    """Write a requirement of pip as conda does, without its marker."""
    packed = requirement.partition(";")[0].strip()
    name = packed[: min((packed.find(sign) for sign in "<>=" if sign in packed), default=len(packed))]
    return f"{CONDA.get(name, name)} {packed[len(name) :]}".strip()


def test_version_and_requirements_are_those_of_the_project(recipe: dict[str, Any]) -> None:
    project = PROJECT["project"]
    assert recipe["package"] == {"name": project["name"], "version": project["version"]}
    python = project["requires-python"]
    assert recipe["requirements"] == {
        "host": [
            f"python {python.removeprefix('>=')}.*",
            "pip",
            *map(conda, PROJECT["build-system"]["requires"]),
        ],
        "run": [f"python {python}", *map(conda, project["dependencies"])],
    }


def test_commands_and_licence_are_those_of_the_project(recipe: dict[str, Any]) -> None:
    project = PROJECT["project"]
    scripts = [f"{name} = {place}" for name, place in project["scripts"].items()]
    assert recipe["build"]["python"]["entry_points"] == scripts
    about = recipe["about"]
    assert (about["summary"], about["license"]) == (project["description"], project["license"])
    assert (ROOT / about["license_file"]).is_file()


def test_the_source_archive_has_what_is_read_here_and_in_the_tests() -> None:
    kept = PROJECT["tool"]["hatch"]["build"]["targets"]["sdist"]["include"]
    for name in (
        "README.md",
        "CHANGELOG.md",
        "Makefile",
        "recipe",
        "tests",
        "docs",
        "examples",
        "urdf",
        ".ci",
    ):
        assert f"/{name}" in kept
        assert (ROOT / name).exists()
