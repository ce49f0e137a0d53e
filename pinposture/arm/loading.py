"""From a robot description to a model that holds one chain and its control points."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from pinposture.arm.description import Description, JointDescription, read_description
from pinposture.arm.segmentation import module_sizes
from pinposture.errors import InvalidValue, UnknownName, URDFError

CHAIN_JOINTS = ("revolute", "prismatic", "continuous")


class LoadedModel(NamedTuple):
    """A model reduced to one chain.

    Attributes:
        model: the chain, base placement applied, with a frame at the end of each module.
        control_points: names of those frames, from base to tip.
        text: the URDF that was read.
    """

    model: pin.Model
    control_points: tuple[str, ...]
    text: str


def load_model(
    source: str | Path,
    base: str | None,
    tip: str | None,
    modules: int | Sequence[int] | None,
    locked: Mapping[str, float],
    base_placement: pin.SE3,
) -> LoadedModel:
    """Load, check, reduce to the chain from base to tip, cut into modules. See `Arm.from_urdf`."""
    description = read_description(source)
    if base is None and tip is None:
        base, tip = description.longest_chain()
    elif tip is None:
        message = "base= alone does not say which chain; pass tip= as well"
        raise InvalidValue("tip", None, f"the link at which the arm ends ({message})")
    base = description.root if base is None else base
    moving = _moving_joints(description, base, tip, locked)
    model = pin.buildModelFromXML(description.text)
    _open_absent_limits(model, description)
    model = _hold_the_rest(model, [joint.name for joint in moving], locked)
    place_base(model, base_placement)
    names = _add_control_points(model, [joint.name for joint in moving], tip, modules)
    return LoadedModel(model, names, description.text)


def place_base(model: pin.Model, placement: pin.SE3) -> None:
    """Move everything that is fixed to the world, in a model that belongs to us."""
    for joint in range(1, model.njoints):
        if model.parents[joint] == 0:
            model.jointPlacements[joint] = placement * model.jointPlacements[joint]
    for frame in model.frames[1:]:
        if frame.parentJoint == 0:
            frame.placement = placement * frame.placement


def _moving_joints(
    description: Description, base: str, tip: str, locked: Mapping[str, float]
) -> list[JointDescription]:
    known = [joint.name for joint in description.joints if joint.type != "fixed"]
    for name, value in locked.items():
        if name not in known:
            raise UnknownName("moving joint", name, known)
        if not np.isfinite(value):
            raise InvalidValue(f"locked[{name!r}]", value, "a finite joint position")
    moving = []
    for joint in description.chain(base, tip):
        element = f"joint {joint.name!r}"
        if joint.type == "fixed" or joint.name in locked or joint.lower == joint.upper:
            continue
        if joint.type not in CHAIN_JOINTS:
            reason = (
                f"type {joint.type!r} cannot be part of the chain; allowed: {', '.join(CHAIN_JOINTS)}, fixed"
            )
            raise URDFError(description.source, element, reason)
        if joint.mimic:
            reason = "mimics another joint, which a chain cannot follow; pass it in locked= or remove <mimic>"
            raise URDFError(description.source, element, reason)
        moving.append(joint)
    if not moving:
        raise URDFError(description.source, f"chain from {base!r} to {tip!r}", "has no moving joint")
    return moving


def _open_absent_limits(model: pin.Model, description: Description) -> None:
    """Pinocchio reads a limit without lower and upper as (0, 0); it means that there is none."""
    for joint in description.joints:
        if joint.type in ("revolute", "prismatic") and np.isinf(joint.lower):
            at = model.joints[model.getJointId(joint.name)].idx_q
            model.lowerPositionLimit[at] = joint.lower
            model.upperPositionLimit[at] = joint.upper


def _hold_the_rest(model: pin.Model, moving: Sequence[str], locked: Mapping[str, float]) -> pin.Model:
    """Lock every joint that is not listed, at its given position or the one nearest zero."""
    reference = pin.neutral(model)
    held = []
    for index in range(1, model.njoints):
        name, joint = model.names[index], model.joints[index]
        if name in moving:
            continue
        held.append(index)
        if joint.nq == 1:
            lower, upper = model.lowerPositionLimit[joint.idx_q], model.upperPositionLimit[joint.idx_q]
            reference[joint.idx_q] = locked.get(name, min(max(0.0, lower), upper))
        elif joint.nv == 1:
            angle = locked.get(name, 0.0)
            reference[joint.idx_q : joint.idx_q + 2] = np.cos(angle), np.sin(angle)
    return pin.buildReducedModel(model, held, reference) if held else model


def _add_control_points(
    model: pin.Model, moving: Sequence[str], tip: str, modules: int | Sequence[int] | None
) -> tuple[str, ...]:
    """Add a frame where each module ends: where the next one's first joint sits, or at the tip."""
    data = model.createData()
    pin.computeJointJacobians(model, data, pin.neutral(model))
    ids = [model.getJointId(name) for name in moving]
    columns = [model.joints[index].idx_v for index in ids]
    angular, linear = data.J[3:, columns].T, data.J[:3, columns].T
    revolute = np.linalg.norm(angular, axis=1) > 0.5
    axes = np.where(revolute[:, None], angular, linear)
    ends = np.cumsum(module_sizes(axes, revolute, modules))
    names = tuple(f"module_{k:02d}" for k in range(1, len(ends) + 1))
    for name, end in zip(names, ends, strict=True):
        if model.existFrame(name):
            taken = [frame.name for frame in model.frames]
            raise InvalidValue(
                "link or joint name", name, f"any but the control points' own; taken: {taken[:5]}"
            )
        if end < len(ids):
            parent, placement = model.parents[ids[end]], model.jointPlacements[ids[end]]
        else:
            frame = model.frames[model.getFrameId(tip, pin.FrameType.BODY)]
            parent, placement = frame.parentJoint, frame.placement
        model.addFrame(pin.Frame(name, parent, placement, pin.FrameType.OP_FRAME))
    return names
