"""Sources of arms: URDF, xacro, MJCF, the package robot_descriptions, or a Pinocchio model."""

from __future__ import annotations

import os
import xml.etree.ElementTree as ET
from collections.abc import Callable, Mapping
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from pinposture.arm.configurations import NO_LIMIT
from pinposture.arm.couplings import Coupling, joint_axes, read_couplings
from pinposture.arm.specification import roll_pitch_yaw
from pinposture.arm.urdf_reader import URDF_TEXT, is_urdf_text
from pinposture.errors import FileError, URDFError
from pinposture.storage import read_text

EXTRA = "pip install 'pinposture[descriptions]'"
"""How to install support for xacro and for descriptions by name."""

_MACROS = "http://www.ros.org/wiki/xacro"
_SHAPES = {"FreeFlyer": "floating", "Planar": "planar"}


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
        source: URDF or xacro, as text or file path; path of an MJCF file; a Pinocchio model; or, if there is
            no such file, the name of a description in robot_descriptions, such as "panda_description".

    Raises:
        FileError: a file cannot be converted, or a description does not exist or cannot be fetched.
        URDFError: a model or MJCF file has a joint that URDF cannot represent.
    """
    if isinstance(source, pin.Model):
        return Source(model_to_urdf(source), name="pin.Model")
    if is_urdf_text(source):
        expand = _MACROS in str(source)
        return Source(_expand_text(str(source)), name="xacro text") if expand else Source(source)
    if not isinstance(source, (str, os.PathLike)) or "\n" in str(source):
        return Source(source)  # rejected by the reader
    path = Path(source)
    xacro = path.suffix.lower() == ".xacro"
    if xacro or (path.suffix.lower() in (".xml", ".mjcf") and "<mujoco" in read_text(path)):
        text = _expand_file(path) if xacro else _convert_mjcf(path)
        return Source(text, (str(path.absolute().parent),), str(path))
    if str(source).isidentifier() and not path.exists():
        return _find_by_name(str(source))
    return Source(path)


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
    return Source(_convert_mjcf(Path(found.MJCF_PATH)), folders, found.MJCF_PATH)


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


def _convert_mjcf(path: Path) -> str:
    try:
        model = pin.buildModelFromMJCF(str(path))
    except (ValueError, RuntimeError) as error:
        raise FileError(path, f"was rejected by Pinocchio ({_one_line(error)})") from error
    return model_to_urdf(model, path)


def model_to_urdf(model: pin.Model, label: str | Path = "pin.Model") -> str:
    """Write a Pinocchio model as URDF: links, joints with their limits, and inertias, but no shapes.

    Links take the names of the body frames of the model; other operational frames become links, too. Revolute
    joints without position limits become continuous. A composite joint becomes one joint for each of its
    parts, with "_1", "_2" appended to its name.

    Args:
        model: the model.
        label: name of the model in error messages.

    Returns:
        URDF text. Floats are preserved exactly, rotations to 1e-15.

    Raises:
        URDFError: a joint that URDF cannot represent.
    """
    robot = ET.Element("robot", name=model.name.strip() or "robot")
    bodies = [frame for frame in model.frames if frame.type == pin.FrameType.BODY]
    named: dict[int, str] = {}
    for frame in bodies:
        if frame.parentJoint not in named and frame.placement.isIdentity(1e-12):
            named[frame.parentJoint] = frame.name
    taken = {frame.name for frame in model.frames}
    for joint in range(model.njoints):
        named.setdefault(joint, _free_name(f"{model.names[joint]}_link" if joint else "world", taken))
    ET.SubElement(robot, "link", name=named[0])
    followers = {each.joint: each for each in read_couplings(model)}
    for joint in range(1, model.njoints):
        if model.names[joint] in followers:
            _write_follower(robot, model, joint, named, followers[model.names[joint]])
        else:
            _write_joint(robot, model, joint, named, taken, label)
    done = set(named.values())
    for frame in model.frames:
        if frame.type in (pin.FrameType.BODY, pin.FrameType.OP_FRAME) and frame.name not in done:
            done.add(frame.name)
            ET.SubElement(robot, "link", name=frame.name)
            parent = named[frame.parentJoint]
            _add_joint(robot, f"{frame.name}_fixed", "fixed", parent, frame.name, frame.placement)
    ET.indent(robot)
    return ET.tostring(robot, encoding="unicode") + "\n"


def _write_joint(
    robot: ET.Element, model: pin.Model, joint: int, named: Mapping[int, str], taken: set[str], label: object
) -> None:
    """Add a joint of a model and the link it carries."""
    name, whole = model.names[joint], model.joints[joint]
    parts, placements = [whole], [pin.SE3.Identity()]
    composite = whole.shortname() == "JointModelComposite"
    if composite:
        inner = whole.extract()
        parts, placements = list(inner.joints), list(inner.jointPlacements)
    parent, q, v = named[model.parents[joint]], whole.idx_q, whole.idx_v
    for number, (part, placement) in enumerate(zip(parts, placements, strict=True), 1):
        kind = part.shortname().removeprefix("JointModel")
        shape = _SHAPES.get(kind)
        if shape is None and part.nv != 1:
            allowed = "joints that turn about an axis or slide along one, free-flyers and planar joints"
            raise URDFError(str(label), f"joint {name!r}", f"is of type {kind}; allowed: {allowed}")
        last = number == len(parts)
        child = named[joint] if last else _free_name(f"{named[joint]}_{number}", taken)
        link = ET.SubElement(robot, "link", name=child)
        if last:
            _add_inertia(link, model.inertias[joint])
        before = model.jointPlacements[joint] * placement if number == 1 else placement
        called = f"{name}_{number}" if composite else name
        element = _add_joint(robot, called, shape or "continuous", parent, child, before)
        if shape is None:
            _add_motion(element, model, part, q, v)
        parent, q, v = child, q + part.nq, v + part.nv


def _write_follower(
    robot: ET.Element, model: pin.Model, joint: int, named: Mapping[int, str], coupling: Coupling
) -> None:
    """Add a joint that follows another and the link it carries; the limits are those of the leader."""
    link = ET.SubElement(robot, "link", name=named[joint])
    _add_inertia(link, model.inertias[joint])
    (axis,), (turns,) = joint_axes(model, [joint])
    ends = named[model.parents[joint]], named[joint], model.jointPlacements[joint]
    element = _add_joint(robot, coupling.joint, "revolute" if turns else "prismatic", *ends)
    ET.SubElement(element, "axis", xyz=_text(axis))
    none = {"effort": repr(NO_LIMIT), "velocity": repr(NO_LIMIT)}
    ET.SubElement(element, "limit", none, lower=repr(-NO_LIMIT), upper=repr(NO_LIMIT))
    follows = {"multiplier": repr(coupling.ratio), "offset": repr(coupling.offset)}
    ET.SubElement(element, "mimic", follows, joint=coupling.leader)


def _add_motion(element: ET.Element, model: pin.Model, part: pin.JointModel, q: int, v: int) -> None:
    """Add the axis and the limits of a revolute or prismatic joint."""
    alone = pin.Model()
    alone.addJoint(0, part, pin.SE3.Identity(), "joint")
    axes, revolute = joint_axes(alone, [1])
    ET.SubElement(element, "axis", xyz=_text(axes[0]))
    edges = np.clip([model.lowerPositionLimit[q], model.upperPositionLimit[q]], -NO_LIMIT, NO_LIMIT)
    limited = part.nq == 1 and bool(np.any(np.abs(edges) < NO_LIMIT))
    limits = {"lower": _text(edges[:1]), "upper": _text(edges[1:])} if limited else {}
    if limited or not revolute[0]:
        element.set("type", "revolute" if revolute[0] else "prismatic")
    effort, velocity = float(model.effortLimit[v]), float(model.velocityLimit[v])
    limits["effort"] = repr(effort if 0.0 < effort < NO_LIMIT else NO_LIMIT)
    limits["velocity"] = repr(velocity if 0.0 <= velocity < NO_LIMIT else NO_LIMIT)
    ET.SubElement(element, "limit", limits)


def _add_joint(
    robot: ET.Element, name: str, kind: str, parent: str, child: str, placement: pin.SE3
) -> ET.Element:
    element = ET.SubElement(robot, "joint", name=name, type=kind)
    ET.SubElement(element, "parent", link=parent)
    ET.SubElement(element, "child", link=child)
    angles = roll_pitch_yaw(placement.rotation)
    ET.SubElement(element, "origin", xyz=_text(placement.translation), rpy=_text(angles))
    return element


def _add_inertia(link: ET.Element, inertia: pin.Inertia) -> None:
    if inertia.mass <= 0.0:
        return
    element = ET.SubElement(link, "inertial")
    ET.SubElement(element, "origin", xyz=_text(inertia.lever))
    ET.SubElement(element, "mass", value=repr(float(inertia.mass)))
    moments = np.asarray(inertia.inertia)
    named = {f"i{'xyz'[i]}{'xyz'[j]}": repr(float(moments[i, j])) for i in range(3) for j in range(i, 3)}
    ET.SubElement(element, "inertia", named)


def _one_line(error: Exception) -> str:
    return " ".join(f"{type(error).__name__}: {error}".split())


def _free_name(name: str, taken: set[str]) -> str:
    while name in taken:
        name += "_"
    taken.add(name)
    return name


def _text(values: Any) -> str:
    return " ".join(repr(float(value)) for value in values)
