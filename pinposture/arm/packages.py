"""Finding of ROS packages and Gazebo models by name, in folders and in those that the environment names."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

from pinposture.arm.urdf import parse_xml
from pinposture.errors import PostureError
from pinposture.storage import read_xml

_MANIFEST = "package.xml"


def package_folders(folders: Iterable[str | Path]) -> list[Path]:
    """Return the folders in which to search for packages: those given, then those of the environment."""
    shared = [folder / "share" for folder in _listed("AMENT_PREFIX_PATH")]
    return [*(Path(folder) for folder in folders), *shared, *_listed("ROS_PACKAGE_PATH")]


def model_folders(folders: Iterable[str | Path]) -> list[Path]:
    """Return the folders in which to search for models of Gazebo: those of packages, then its own."""
    variables = ("GZ_SIM_RESOURCE_PATH", "IGN_GAZEBO_RESOURCE_PATH", "GAZEBO_MODEL_PATH")
    of_gazebo = [folder for variable in variables for folder in _listed(variable)]
    return [*package_folders(folders), *of_gazebo]


def _listed(variable: str) -> list[Path]:
    return [Path(entry) for entry in os.environ.get(variable, "").split(os.pathsep) if entry]


def find_packages(name: str, folders: Sequence[Path], reading: Sequence[Path] = ()) -> Iterator[Path]:
    """Yield the folders that may be a package, the most likely first.

    Each folder may be the package, lie inside or beside it, or contain it, two levels below or less. The
    name of a package is that in its package.xml, or that of its folder. Earlier folders go first.

    Args:
        name: name of the package.
        folders: where to search.
        reading: folders of the files being read, which are searched as well, except what is in them.
    """
    if not name.strip(".") or set(name) & set("/\\\0"):
        return
    for folder in dict.fromkeys((*folders, *reading)):
        at = folder.absolute()
        above = (at, *at.parents)
        yield from (parent for parent in above if package_name(parent) == name)
        yield from (parent / name for parent in above if package_name(parent / name) == name)
        if folder in folders and at.parent != at:  # not a whole disk
            yield from (below for below in _packages_below(at) if package_name(below) == name)
    for folder in dict.fromkeys((*folders, *reading)):
        yield folder / name
        yield from (parent for parent in (folder, *folder.parents) if parent.name == name)


def package_name(folder: Path) -> str:
    """Return the name in the package.xml of a folder; empty if there is no readable one."""
    file = folder / _MANIFEST
    if not is_file(file):
        return ""
    try:
        name = parse_xml(read_xml(file), str(file)).findtext("name")
    except PostureError:
        return ""
    return (name or "").strip()


def _packages_below(top: Path) -> Iterator[Path]:
    """Yield the folders below one that have a package.xml, sorted; there are no packages inside of them."""
    depth = 2  # as in src/package; each level costs ten times the last
    try:
        for current, inside, files in os.walk(top):
            here = Path(current)
            if _MANIFEST in files:
                yield here
            ends = _MANIFEST in files and here != top
            ignored = not {"CATKIN_IGNORE", "COLCON_IGNORE", "AMENT_IGNORE"}.isdisjoint(files)
            if ends or ignored or len(here.parts) - len(top.parts) >= depth:
                inside.clear()
            inside[:] = sorted(entry for entry in inside if not entry.startswith("."))
    except (OSError, ValueError):
        return


def is_file(path: Path) -> bool:
    """Return whether there is such a file; also if the name is too long or empty."""
    try:
        return path.is_file()
    except (OSError, ValueError):
        return False
