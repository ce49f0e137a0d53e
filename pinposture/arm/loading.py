"""From a robot description to a model that holds one chain and its control points."""

from __future__ import annotations

import operator
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import pinocchio as pin

from pinposture.arm.description import Description, JointDescription, read_description
from pinposture.arm.holding import checked_locks, hold, holding_warnings
from pinposture.arm.report import LoadReport
from pinposture.arm.segmentation import Segmentation, equal_modules, given_modules, segment
from pinposture.arm.skeleton import Skeleton, joint_lines, neutral_placements
from pinposture.arm.stations import end_frames, modules_to_links
from pinposture.arm.urdf_joint import CHAIN_JOINTS
from pinposture.errors import InvalidValue, URDFError

Modules: TypeAlias = "int | Sequence[int] | Sequence[str] | None"
"""How to cut the chain: joints per module, one number for all or one for each, or links where modules end."""

LENGTHS = (1e-9, 1e9)
"""Shortest and longest chain that is accepted [m]; the squares of others leave the range of numbers."""


class LoadedModel(NamedTuple):
    """A model reduced to one chain.

    Attributes:
        model: the chain, base placement applied, with a frame at the end of each module.
        control_points: names of those frames, from base to tip.
        text: the URDF that was read.
        report: what was decided on the way.
    """

    model: pin.Model
    control_points: tuple[str, ...]
    text: str
    report: LoadReport


def load_model(
    source: str | Path,
    base: str | None,
    tip: str | None,
    modules: Modules,
    locked: Mapping[str, float],
    base_placement: pin.SE3,
    package_dirs: Sequence[str | Path] | None = None,
) -> LoadedModel:
    """Load, check, reduce to the chain from base to tip, cut into modules. See `Arm.from_urdf`."""
    description = read_description(source)
    links, sizes = _read_modules(modules)
    if tip is None and links:
        tip = links[-1]
    if base is None and tip is None:
        base, tip = description.longest_chain()
    elif tip is None:
        message = "base= alone does not say which chain; pass tip= as well"
        raise InvalidValue("tip", None, f"the link at which the arm ends ({message})")
    base = description.root if base is None else base
    locks = checked_locks(description, locked)
    moving = _moving_joints(description, base, tip, locks)
    names = [joint.name for joint in moving]
    try:
        model = pin.buildModelFromXML(description.text)
    except (ValueError, RuntimeError) as error:
        raise URDFError(description.source, "<robot>", f"is refused by Pinocchio: {error}") from None
    model = hold(model, description, names, locks)
    _set_limits(model, moving)
    place_base(model, base_placement)
    skeleton = _skeleton(model, moving, tip)
    if not LENGTHS[0] <= skeleton.length <= LENGTHS[1]:
        reason = f"is {skeleton.length:.3g} m long; allowed: {LENGTHS[0]:g} to {LENGTHS[1]:g} m"
        if skeleton.length == 0.0:
            reason = "has no length: all its joints and its tip are in one place"
        raise URDFError(description.source, f"chain from {base!r} to {tip!r}", reason)
    segmentation = modules_to_links(model, skeleton, links) if links else _segmentation(skeleton, sizes)
    points = end_frames(model, names, tip, segmentation.sizes, links)
    warnings = holding_warnings(description, base, tip, names, locks)
    if segmentation.adequate is False:
        warnings.append(segmentation.reason)
    folders = _package_dirs(source, package_dirs)
    report = LoadReport(base, tip, folders, tuple(warnings), segmentation)
    return LoadedModel(model, points, description.text, report)


def place_base(model: pin.Model, placement: pin.SE3) -> None:
    """Move everything that is fixed to the world, in a model that belongs to us."""
    for joint in range(1, model.njoints):
        if model.parents[joint] == 0:
            model.jointPlacements[joint] = placement * model.jointPlacements[joint]
    for index in range(1, model.nframes):  # not a slice: that would be a copy
        frame = model.frames[index]
        if frame.parentJoint == 0:
            frame.placement = placement * frame.placement


def _read_modules(modules: Modules) -> tuple[tuple[str, ...], int | tuple[int, ...] | None]:
    """Links at which modules end, if any are given, and sizes of modules, if any are given."""
    if modules is None:
        return (), None
    if isinstance(modules, str):
        return (modules,), None
    try:
        listed = list(modules) if isinstance(modules, (Sequence, np.ndarray)) else None
        if listed and all(isinstance(entry, str) for entry in listed):
            return tuple(map(str, listed)), None
        numbers: list[Any] = [modules] if listed is None else listed
        if any(isinstance(number, (bool, np.bool_)) for number in numbers):
            raise TypeError
        whole = tuple(operator.index(number) for number in numbers)
    except TypeError:
        allowed = "a whole number, whole numbers, or names of links"
        raise InvalidValue("modules", modules, allowed) from None
    return (), whole[0] if listed is None else whole


def _moving_joints(
    description: Description, base: str, tip: str, locked: Mapping[str, float]
) -> list[JointDescription]:
    moving: list[JointDescription] = []
    chain = description.chain(base, tip)
    for joint in chain:
        element = f"joint {joint.name!r}"
        if joint.name in locked or not joint.moves:
            continue
        if joint.type not in CHAIN_JOINTS:
            if not moving:  # a base that floats: it stays where it is
                continue
            allowed = ", ".join(CHAIN_JOINTS)
            reason = f"type {joint.type!r} cannot be part of the chain; allowed: {allowed}, fixed"
            raise URDFError(description.source, element, reason)
        if joint.follows is not None:
            reason = (
                f"mimics joint {joint.follows.joint!r}, which a chain cannot follow; pass it in locked= "
                "(--locked) or remove <mimic>"
            )
            raise URDFError(description.source, element, reason)
        moving.append(joint)
    if not moving:
        raise URDFError(description.source, f"chain from {base!r} to {tip!r}", _why_still(chain, locked))
    return moving


def _why_still(chain: Sequence[JointDescription], locked: Mapping[str, float]) -> str:
    """Why no joint of a chain moves, in words."""
    other = [joint.name for joint in chain if joint.type in ("floating", "planar")]
    held = {
        "limits leave one position to": [j.name for j in chain if j.type != "fixed" and not j.moves],
        "locked= holds": [joint.name for joint in chain if joint.name in locked],
        f"floating and planar joints are none of them ({', '.join(CHAIN_JOINTS)})": other,
    }
    said = [
        f"; {why}: {', '.join(map(repr, names[:8]))}{', ...' * (len(names) > 8)}"
        for why, names in held.items()
        if names
    ]
    return f"has no {'joint that can move an arm' if other else 'moving joint'}{''.join(said)}"


def _set_limits(model: pin.Model, moving: Sequence[JointDescription]) -> None:
    """Pinocchio reads a limit without lower and upper as (0, 0); it means that there is none."""
    for joint in moving:
        index = model.joints[model.getJointId(joint.name)]
        if index.nq == 1:
            model.lowerPositionLimit[index.idx_q] = joint.lower
            model.upperPositionLimit[index.idx_q] = joint.upper


def _skeleton(model: pin.Model, moving: Sequence[JointDescription], tip: str) -> Skeleton:
    lines = joint_lines(model, [model.getJointId(joint.name) for joint in moving])
    frame = model.frames[model.getFrameId(tip, pin.FrameType.BODY)]
    place = (neutral_placements(model)[frame.parentJoint] * frame.placement).translation
    lower = np.array([joint.lower for joint in moving])
    upper = np.array([joint.upper for joint in moving])
    return Skeleton(tuple(joint.name for joint in moving), lines, place, lower, upper)


def _segmentation(skeleton: Skeleton, sizes: int | tuple[int, ...] | None) -> Segmentation:
    if sizes is None:
        return segment(skeleton)
    if isinstance(sizes, int):
        return equal_modules(len(skeleton.names), sizes)
    return given_modules(len(skeleton.names), sizes)


def _package_dirs(source: str | Path, given: Sequence[str | Path] | None) -> tuple[str, ...]:
    """Folders to look for meshes in: those given, then the one of the file."""
    if isinstance(given, (str, os.PathLike)):
        given = [given]
    try:
        folders = [Path(folder).absolute() for folder in given or ()]
    except TypeError:
        raise InvalidValue("package_dirs", given, "paths of folders") from None
    if not (isinstance(source, str) and source.lstrip("\ufeff \t\r\n").startswith("<")):
        folders.append(Path(source).absolute().parent)
    return tuple(dict.fromkeys(map(str, folders)))
