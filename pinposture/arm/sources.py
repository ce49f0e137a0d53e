"""Sources of arms: URDF, xacro, MJCF, the package robot_descriptions, or a Pinocchio model."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from importlib import import_module
from pathlib import Path
from typing import NamedTuple

import pinocchio as pin

from pinposture.arm.mjcf import is_mjcf, mjcf_to_urdf
from pinposture.arm.urdf_reader import URDF_TEXT, is_urdf_text
from pinposture.arm.urdf_writer import model_to_urdf
from pinposture.errors import FileError
from pinposture.storage import read_text

EXTRA = "pip install 'pinposture[descriptions]'"
"""How to install support for xacro and for descriptions by name."""

_MACROS = "http://www.ros.org/wiki/xacro"


class Source(NamedTuple):
    """A URDF and the folders of its meshes.

    Attributes:
        urdf: path of a file, or URDF text.
        folders: where viewers look for meshes, besides the folder of the file.
        name: what error messages call text.
    """

    urdf: str | Path
    folders: tuple[str, ...] = ()
    name: str = URDF_TEXT


def find_urdf(source: str | Path | pin.Model) -> Source:
    """Return the URDF of an arm, converted from another format if necessary.

    Args:
        source: URDF, xacro or MJCF, as text or file path; a Pinocchio model; or, if there is no such file,
            the name of a description in robot_descriptions, such as "panda_description".

    Raises:
        FileError: a file cannot be converted, or a description does not exist or cannot be fetched.
        MujocoMissing: the source is MJCF, and MuJoCo is not installed.
        URDFError: a model has a joint that URDF cannot represent.
    """
    if isinstance(source, pin.Model):
        return Source(model_to_urdf(source), name="pin.Model")
    if is_urdf_text(source):
        return _read_text(str(source))
    if not isinstance(source, (str, os.PathLike)) or "\n" in str(source):
        return Source(source)  # rejected by the reader
    path = Path(source)
    xacro = path.suffix.lower() == ".xacro"
    if xacro or (path.is_file() and is_mjcf(read_text(path))):
        text = _expand_file(path) if xacro else mjcf_to_urdf(path, str(path))
        return Source(text, (str(path.absolute().parent),), str(path))
    if str(source).isidentifier() and not path.exists():
        return _find_by_name(str(source))
    return Source(path)


def _read_text(text: str) -> Source:
    """Return URDF text as it is, and that of other formats as URDF."""
    if is_mjcf(text):
        return Source(mjcf_to_urdf(text, "MJCF text"), name="MJCF text")
    return Source(_expand_text(text), name="xacro text") if _MACROS in text else Source(text)


def _find_by_name(name: str) -> Source:
    """Return a description from robot_descriptions, which downloads it if necessary."""
    try:
        import_module("robot_descriptions")
    except ImportError:
        advice = f"to use names from robot_descriptions: {EXTRA}"
        raise FileError(name, f"no such file; {advice}") from None
    try:
        found = import_module(f"robot_descriptions.{name}")
    except ModuleNotFoundError:
        reason = "no such file, and no such name in robot_descriptions (`robot_descriptions list`)"
        raise FileError(name, reason) from None
    except Exception as error:  # from git or the network
        raise FileError(name, f"robot_descriptions cannot fetch it ({_one_line(error)})") from error
    inside = [Path(each) for each in (found.PACKAGE_PATH, found.REPOSITORY_PATH)]
    folders = tuple(dict.fromkeys(str(each) for folder in inside for each in (folder, folder.parent)))
    if hasattr(found, "URDF_PATH"):
        return Source(Path(found.URDF_PATH), folders)
    if hasattr(found, "XACRO_PATH"):
        path = Path(found.XACRO_PATH)
        return Source(_expand_file(path, getattr(found, "XACRO_ARGS", None)), folders, str(path))
    folders = (str(Path(found.MJCF_PATH).absolute().parent), *folders)
    return Source(mjcf_to_urdf(Path(found.MJCF_PATH), found.MJCF_PATH), folders, found.MJCF_PATH)


def _expand_file(path: Path, arguments: Mapping[str, str] | None = None) -> str:
    """Expand the macros of a xacro file; packages that it names are searched for in its parent folders."""
    read_text(path)  # raises a clear error if the file is missing

    def expand() -> str:
        import xacro
        from xacrodoc import packages  # lets xacro find packages without ROS

        packages.walk_up_from(path)
        return str(xacro.process_file(str(path), mappings=dict(arguments or {})).toxml())

    return _expanded(expand, path)


def _expand_text(text: str) -> str:
    """Expand the macros of xacro text."""

    def expand() -> str:
        from xacrodoc import XacroDoc

        return str(XacroDoc.from_string(text, resolve_packages=False).dom.toxml())

    return _expanded(expand, "xacro text")


def _expanded(expand: Callable[[], str], label: str | Path) -> str:
    try:
        return expand()
    except ImportError:
        raise FileError(label, f"cannot be expanded without xacrodoc: {EXTRA}") from None
    except Exception as error:  # from the macros, or from Python code in them
        raise FileError(label, f"cannot be expanded ({_one_line(error)})") from error


def _one_line(error: Exception) -> str:
    return " ".join(f"{type(error).__name__}: {error}".split())
