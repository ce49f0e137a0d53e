"""Sources of arms: URDF, xacro, MJCF, the package robot_descriptions, or a Pinocchio model."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from importlib import import_module
from pathlib import Path
from typing import NamedTuple

import pinocchio as pin

from pinposture.arm.macros import MACROS, expand_macros, one_line, read_arguments
from pinposture.arm.mjcf import is_mjcf, mjcf_to_urdf
from pinposture.arm.model_builder import model_to_urdf
from pinposture.arm.packages import is_file
from pinposture.arm.urdf import URDF_TEXT, is_urdf_text
from pinposture.errors import FileError, InvalidValue, install
from pinposture.storage import read_xml


class Source(NamedTuple):
    """A URDF and the folders of its meshes.

    Attributes:
        urdf: path of a file, or URDF text.
        folders: where viewers look for meshes, besides the folder of the file.
        name: what error messages call text.
        macros: whether it was expanded from xacro.
    """

    urdf: str | Path
    folders: tuple[str, ...] = ()
    name: str = URDF_TEXT
    macros: bool = False


def find_urdf(
    source: str | Path | pin.Model,
    folders: Sequence[Path] = (),
    xacro_args: Mapping[str, str] | None = None,
) -> Source:
    """Return the URDF of an arm, converted from another format if necessary.

    Args:
        source: URDF, xacro or MJCF, as text or file path; a Pinocchio model; or, if there is no such file,
            the name of a description in robot_descriptions, such as "panda_description".
        folders: where to search for packages that xacro names, before the folders above the file.
        xacro_args: values of xacro arguments.

    Raises:
        FileError: a file cannot be converted, or a description does not exist or cannot be fetched.
        MujocoMissing: the source is MJCF, and MuJoCo is not installed.
        URDFError: a model has a joint that URDF cannot represent, or xacro has no links.
        UnknownName: xacro does not ask for an argument.
        InvalidValue: there are arguments, and the source is no xacro.
    """
    arguments = xacro_args or {}
    if isinstance(source, pin.Model):
        read = Source(model_to_urdf(source), name="pin.Model")
    else:
        read = _find(source, folders, arguments)
    if arguments and not read.macros:
        allowed = "none: the source is not xacro, i.e. a file that ends in .xacro, or text with its namespace"
        raise InvalidValue("xacro_args", dict(arguments), allowed)
    return read


def _find(source: str | Path, folders: Sequence[Path], arguments: Mapping[str, str]) -> Source:
    if _has_macros(source):
        text = expand_macros(source, arguments, folders)
        is_text = is_urdf_text(source)
        beside = () if is_text else (_folder(Path(source)),)
        return Source(text, beside, "xacro text" if is_text else str(source), macros=True)
    if is_urdf_text(source) and is_mjcf(str(source)):
        return Source(mjcf_to_urdf(str(source), "MJCF text"), name="MJCF text")
    if is_urdf_text(source) or not isinstance(source, (str, os.PathLike)) or "\n" in str(source):
        return Source(source)  # if it is no text, it is rejected by the reader
    path = Path(source)
    if is_file(path) and is_mjcf(read_xml(path)):
        return Source(mjcf_to_urdf(path, str(path)), (_folder(path),), str(path))
    if str(source).isidentifier() and not path.exists():
        return _find_by_name(str(source), folders, arguments)
    return Source(path)


def _has_macros(source: object) -> bool:
    """Return whether a source is xacro: text with its namespace, or the path of such a file by its suffix."""
    if is_urdf_text(source):
        return MACROS in str(source)
    return isinstance(source, (str, os.PathLike)) and Path(source).suffix.lower() == ".xacro"


def _folder(path: Path) -> str:
    return str(path.absolute().parent)


def _find_by_name(name: str, searched: Sequence[Path], arguments: Mapping[str, str]) -> Source:
    """Return a description from robot_descriptions, which downloads it if necessary."""
    try:
        import_module("robot_descriptions")
    except ImportError:
        advice = f"to use names from robot_descriptions: {install('descriptions')}"
        raise FileError(name, f"no such file; {advice}") from None
    try:
        module = import_module(f"robot_descriptions.{name}")
    except ModuleNotFoundError:
        reason = "no such file, and no such name in robot_descriptions (`robot_descriptions list`)"
        raise FileError(name, reason) from None
    except Exception as error:  # from git or the network
        raise FileError(name, f"robot_descriptions cannot fetch it ({one_line(error)})") from error
    inside = [Path(path) for path in (module.PACKAGE_PATH, module.REPOSITORY_PATH)]
    folders = tuple(dict.fromkeys(str(path) for folder in inside for path in (folder, folder.parent)))
    if hasattr(module, "URDF_PATH"):
        return Source(Path(module.URDF_PATH), folders)
    if hasattr(module, "XACRO_PATH"):
        path = Path(module.XACRO_PATH)
        defaults = read_arguments(getattr(module, "XACRO_ARGS", None))
        return Source(expand_macros(path, arguments, searched, defaults), folders, str(path), macros=True)
    folders = (str(Path(module.MJCF_PATH).absolute().parent), *folders)
    return Source(mjcf_to_urdf(Path(module.MJCF_PATH), module.MJCF_PATH), folders, module.MJCF_PATH)
