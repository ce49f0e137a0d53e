"""The arms of the thesis and a mixed one; `python -m pinposture.study urdf` writes them."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType

from pinposture.arm.template import ModuleTemplate, modules_to_urdf, template
from pinposture.errors import PostureError
from pinposture.storage import write_text

SPATIAL: tuple[ModuleTemplate, ...] = (template("RyRz").with_lengths((0.025, 0.025)),) * 20
"""The spatial arm of Section 6.1: 20 RyRz modules, 40 DOF, 1 m."""

PLANAR: tuple[ModuleTemplate, ...] = (template("Rz").with_lengths((0.15,)),) * 45
"""The planar arm of Section 6.2: 45 DOF, links of 15 cm, 6.75 m."""

MIXED: tuple[ModuleTemplate, ...] = (
    template("RyRz").with_lengths((0.03, 0.04)),
    template("RzRy").with_lengths((0.02, 0.035)),
) * 6
"""Two kinds of modules in turn, each with links of two lengths: 12 modules, 24 DOF, 0.75 m."""

ARMS: Mapping[str, tuple[ModuleTemplate, ...]] = MappingProxyType(
    {"ryrz20": SPATIAL, "planar45": PLANAR, "mixed12": MIXED}
)
"""The arms by name; the name is that of the robot and, with ".urdf", of its file."""


def urdf_files() -> dict[str, str]:
    """The generated robot descriptions: file name -> URDF text."""
    command = "python -m pinposture.study"
    return {f"{name}.urdf": modules_to_urdf(modules, name, command) for name, modules in ARMS.items()}


def write_urdf_files(directory: str | Path) -> list[Path]:
    """Write the robot descriptions; each file is either the old one or the new one, never half of it.

    Args:
        directory: where to; made if it does not exist.

    Returns:
        Paths of the files.

    Raises:
        FileError: the directory or a file in it cannot be written.
    """
    paths = []
    for name, text in urdf_files().items():
        paths.append(Path(directory) / name)
        write_text(paths[-1], text)
    return paths


def main(arguments: Sequence[str]) -> int:
    """Write the files into the directory given, and say so. Returns the exit status."""
    if len(arguments) != 1 or arguments[0].startswith("-"):
        sys.stderr.write("usage: python -m pinposture.study DIRECTORY\n")
        return 2
    try:
        paths = write_urdf_files(arguments[0])
    except PostureError as error:
        sys.stderr.write(f"{error}\n")
        return 1
    sys.stdout.write(f"wrote {', '.join(map(str, paths))}\n")
    return 0
