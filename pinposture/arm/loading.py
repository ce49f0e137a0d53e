"""Loading of a robot description as a Pinocchio model of one chain with a frame at each control point."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from pinposture._validation import require_known, rigid_placement
from pinposture.arm.configurations import NO_LIMIT, ConfigurationSpace
from pinposture.arm.couplings import (
    CoupledJoints,
    Drive,
    couple_joints,
    coupled_turns,
    find_couplings,
    limit_leaders,
    with_couplings,
)
from pinposture.arm.description import (
    Description,
    leading_joint,
    read_description,
    soft_limit_warnings,
    soft_limited,
    with_soft_limits,
)
from pinposture.arm.kinematics import ON_AXIS, Skeleton, frame_position, neutral_placements, read_skeleton
from pinposture.arm.model_builder import build_model
from pinposture.arm.segmentation import Segmentation, count_joints, equal_modules, given_modules, segment
from pinposture.arm.sources import Source, find_urdf
from pinposture.arm.specification import ArmSpec, Split
from pinposture.arm.urdf import CHAIN_JOINTS, JointDescription, is_urdf_text, quote_joints, quote_names
from pinposture.errors import InvalidValue, URDFError, enumerated
from pinposture.units import length_text


class SuspectDescription(NamedTuple):
    """Which lengths and limits of a description seem to be in another unit."""

    length: float = 100.0
    """Length of a chain above which it may be in millimetres [m]."""

    limits: tuple[float, float] = (4.0 * np.pi, 360.0)
    """Position limits of revolute joints that may be in degrees: above the first, up to the second
    [rad]."""


SUSPECT = SuspectDescription()

MULTI_DOF_JOINTS = ("floating", "planar")
"""Types of joints with several degrees of freedom."""


@dataclass(frozen=True)
class LoadReport:
    """Decisions made while loading an arm.

    Attributes:
        base: first link of the arm.
        tip: last link of the arm.
        package_dirs: folders in which viewers look for meshes, the file's own last.
        warnings: decisions that the user may not expect.
        segmentation: how the joints were grouped into modules.
        soft_limited: joints whose position limits are narrowed by those of <safety_controller>.
        drives: see `Arm.drives`.
    """

    base: str
    tip: str
    package_dirs: tuple[str, ...]
    warnings: tuple[str, ...]
    segmentation: Segmentation
    soft_limited: tuple[str, ...] = ()
    drives: tuple[Drive, ...] = ()


class LoadedModel(NamedTuple):
    """A model reduced to one chain."""

    model: pin.Model  # the chain, base placement applied, with a frame at the end of each module
    control_points: tuple[str, ...]  # names of those frames, from base to tip
    base_placement: pin.SE3 | None  # placement of the root link in the world; None if not given
    text: str  # the URDF text
    report: LoadReport  # decisions made


def load_model(
    source: str | Path | pin.Model,
    spec: ArmSpec,
    split: Split | None = None,
    base_placement: pin.SE3 | None = None,
) -> LoadedModel:
    """Load and check a description, reduce it to the chain and split that into modules. See `Arm.load`.

    Args:
        source: the description.
        spec: the chain in it.
        split: its modules; that of the specification is not read.
        base_placement: placement of the root link in the world; the origin if None.
    """
    base = spec.base
    tip = spec.tip
    placement = None if base_placement is None else rigid_placement("base_placement", base_placement)
    file = find_urdf(source, spec.package_dirs, spec.xacro_args)
    read = with_couplings(read_description(file.urdf, file.name), spec.couplings)
    description = read if spec.hard_limits else with_soft_limits(read)
    links = _link_names(split)
    if tip is None and links:
        tip = links[-1]
    wrist = None
    if base is None and tip is None:
        base, tip = description.longest_chain()
        wrist = description.wrist(base, tip)
    elif tip is None:
        message = "base= alone does not determine the chain; pass tip= as well"
        raise InvalidValue("tip", None, f"the link at which the arm ends ({message})")
    base = description.root if base is None else base
    locks = spec.locked
    _check_locks(description, locks)
    coupled = _moving_joints(description, base, tip, locks)
    names = [joint.name for joint in coupled.moving]
    model = _chain_model(description, coupled, locks)
    if placement is not None:
        place_base(model, placement)
    skeleton = read_skeleton(model, names, tip, *ConfigurationSpace(model).limits[:2])
    _check_length(skeleton.length, description.source, f"chain from {base!r} to {tip!r}")
    segmentation = _modules_to_links(model, skeleton, links) if links else _segmentation(skeleton, split)
    points = _add_end_frames(model, names, tip, segmentation.sizes, links)
    warnings = [*description.doubled]
    warnings += _lock_warnings(description, base, tip, names, locks)
    if not spec.hard_limits:
        warnings.extend(soft_limit_warnings(read, names))
    if skeleton.length > SUSPECT.length:
        warnings.append(f"the arm is {skeleton.length:.4g} m long; is it in millimetres, not metres?")
    if segmentation.can_follow is False:
        warnings.append(segmentation.reason)
    if wrist is not None:
        warnings.append(f"the arm ends in a finger, at link {tip!r}; tip={wrist!r} ends it before the hand")
    folders = _mesh_folders(file, spec.package_dirs)
    narrowed = soft_limited(description, read, names)
    decided = (folders, tuple(warnings), segmentation, narrowed, tuple(coupled.drives))
    report = LoadReport(base, tip, *decided)
    return LoadedModel(model, points, placement, description.text, report)


def _chain_model(description: Description, coupled: CoupledJoints, locks: Mapping[str, float]) -> pin.Model:
    """Return the model of the moving joints of a chain, coupled and limited as described."""
    whole = build_model(description.text, description.source, coupled_turns(coupled))
    model = _lock_others(whole, description, [joint.name for joint in coupled.moving], locks)
    _set_limits(model, coupled.moving)
    model = couple_joints(model, coupled)
    limit_leaders(model, whole, coupled.drives)
    return model


def description_text(
    source: str | Path, package_dirs: Sequence[Path] = (), xacro_args: Mapping[str, str] | None = None
) -> str:
    """Return the URDF text that `Arm.urdf` would be if an arm were loaded from a source."""
    file = find_urdf(source, package_dirs, xacro_args)
    return read_description(file.urdf, file.name).text


def _check_length(length: float, source: str, chain: str) -> None:
    """Raise URDFError unless the length of a chain [m] is allowed."""
    if length == 0.0:
        raise URDFError(source, chain, "has zero length: all its joints and its tip coincide")
    least = 1e-9  # beyond these, squared lengths could under- or overflow
    most = 1e9
    if not least <= length <= most:
        allowed = f"{least:g} to {most:g} m"
        raise URDFError(source, chain, f"is {length_text(length)} long; allowed: {allowed}")


def _segmentation(skeleton: Skeleton, split: Split | None) -> Segmentation:
    if split is None:
        return segment(skeleton)
    if isinstance(split, int):
        return equal_modules(len(skeleton.names), split)
    return given_modules(len(skeleton.names), [size for size in split if isinstance(size, int)])


def place_base(model: pin.Model, placement: pin.SE3) -> None:
    """Move everything in a model that is fixed to the world; writes to the model."""
    for joint in range(1, model.njoints):
        if model.parents[joint] == 0:
            model.jointPlacements[joint] = placement * model.jointPlacements[joint]
    for index in range(1, model.nframes):  # not a slice: that would be a copy
        frame = model.frames[index]
        if frame.parentJoint == 0:
            frame.placement = placement * frame.placement


def _link_names(split: Split | None) -> tuple[str, ...]:
    """Return the links at which modules end, if they are given by these."""
    return tuple(name for name in split if isinstance(name, str)) if isinstance(split, tuple) else ()


def _mesh_folders(file: Source, searched: Sequence[Path]) -> tuple[str, ...]:
    """Return the folders to search for meshes: those given, those of the source, that of the file."""
    folders = [*map(str, searched), *file.folders]
    if not is_urdf_text(file.urdf):
        folders.append(str(Path(file.urdf).absolute().parent))
    return tuple(dict.fromkeys(folders))


def _moving_joints(
    description: Description, base: str, tip: str, locked: Mapping[str, float]
) -> CoupledJoints:
    """Return the moving joints of the chain and their couplings, or raise if they form no arm."""
    moving: list[JointDescription] = []
    chain = description.chain(base, tip)
    for joint in chain:
        element = f"joint {joint.name!r}"
        if joint.name in locked:
            continue
        if joint.excluded is not None:
            before = f"; tip={joint.parent!r} ends the arm before it" if moving else ""
            raise URDFError(description.source, element, joint.excluded + before)
        if not joint.moves:
            continue
        if joint.type not in CHAIN_JOINTS:
            if not moving:  # a floating base, treated as fixed
                continue
            allowed = ", ".join(CHAIN_JOINTS)
            reason = f"type {joint.type!r} cannot be part of the chain; allowed: {allowed}, fixed"
            raise URDFError(description.source, element, reason)
        moving.append(joint)
    coupled = find_couplings(description, moving, locked)
    if not coupled.moving:
        raise URDFError(description.source, f"chain from {base!r} to {tip!r}", _why_still(chain, locked))
    return coupled


def _why_still(chain: Sequence[JointDescription], locked: Mapping[str, float]) -> str:
    """Explain why no joint of a chain moves."""
    other = [joint.name for joint in chain if joint.type in MULTI_DOF_JOINTS]
    still = {
        "limits allow a single position of": [j.name for j in chain if j.type != "fixed" and not j.moves],
        "locked= locks": [joint.name for joint in chain if joint.name in locked],
        f"floating and planar joints do not count (only {', '.join(CHAIN_JOINTS)})": other,
    }
    reasons = [f"; {why}: {quote_names(names)}" for why, names in still.items() if names]
    return f"has no {'joint that can move an arm' if other else 'moving joint'}{''.join(reasons)}"


def _check_locks(description: Description, locked: Mapping[str, float]) -> None:
    """Raise unless the joints that the user locks exist, at one number each."""
    known = {joint.name: joint for joint in description.joints if joint.type != "fixed"}
    for name, value in locked.items():
        require_known("moving joint", name, known)
        if known[name].type in MULTI_DOF_JOINTS:
            allowed = f"nothing: the joint is {known[name].type}, its position is not a single number"
            raise InvalidValue(f"locked.{name}", value, allowed)
        if not abs(value) < NO_LIMIT:
            raise InvalidValue(f"locked.{name}", value, f"a joint position within +-{NO_LIMIT:g}")


def _lock_others(
    model: pin.Model, description: Description, moving: Iterable[str], locked: Mapping[str, float]
) -> pin.Model:
    """Return a model in which only the listed joints move; the others stay at `_locked_positions`."""
    free = set(moving)
    positions = _locked_positions(description, locked)
    reference = pin.neutral(model)
    others = [index for index in range(1, model.njoints) if model.names[index] not in free]
    if not others:
        return model
    for index in others:
        name = model.names[index]
        joint = model.joints[index]
        if joint.nq == 1:
            reference[joint.idx_q] = positions[name]
        elif joint.nv == 1:
            reference[joint.idx_q : joint.idx_q + 2] = np.cos(positions[name]), np.sin(positions[name])
    # Pinocchio cannot reduce a model in which a link and a joint share a name.
    suffix = "\n"  # no name in a description has one
    for frame in model.frames:
        if frame.type == pin.FrameType.BODY:
            frame.name += suffix
    try:
        reduced = pin.buildReducedModel(model, others, reference)
    except (ValueError, RuntimeError) as error:
        raise URDFError(description.source, "<robot>", f"cannot be reduced to one chain: {error}") from None
    for frame in reduced.frames:
        frame.name = frame.name.removesuffix(suffix)
    return reduced


def _locked_positions(description: Description, locked: Mapping[str, float]) -> dict[str, float]:
    """Return the position of each joint if locked [rad or m].

    That is its given position, or where its mimic leader puts it, or the position nearest zero within limits.
    """
    named = {joint.name: joint for joint in description.joints if joint.type != "fixed"}

    def position(joint: JointDescription, above: frozenset[str]) -> float:
        if joint.name in locked:
            return locked[joint.name]
        follows = joint.follows
        if follows is None or follows.joint not in named or follows.joint in above:
            return min(max(0.0, joint.lower), joint.upper)
        leader = position(named[follows.joint], above | {joint.name})
        return follows.multiplier * leader + follows.offset

    return {name: position(joint, frozenset({name})) for name, joint in named.items()}


def _lock_warnings(
    description: Description, base: str, tip: str, moving: Iterable[str], locked: Mapping[str, float]
) -> list[str]:
    """Report joints without limits, limits that may be in degrees, and joints locked without a request."""
    free = set(moving)
    chain = description.chain(base, tip)
    on_chain = {joint.name for joint in chain}
    before = description.chain(description.root, base)
    messages = [
        f"joint {joint.name!r} ({joint.type}) at the base of the arm is treated as fixed"
        for joint in (*before, *chain)
        if joint.type in MULTI_DOF_JOINTS
    ]
    stuck = [j.name for j in chain if j.type != "fixed" and not j.moves and j.name not in locked]
    if stuck:
        messages.append(f"limits that allow a single position lock {quote_joints(stuck)} on the chain")
    limited = [joint for joint in chain if joint.name in free and joint.type in ("revolute", "prismatic")]
    endless = [joint.name for joint in limited if joint.lower == -np.inf and joint.upper == np.inf]
    if endless:
        messages.append(f"no limits are given for {quote_joints(endless)}; treated as unlimited")
    unset = [joint.name for joint in chain if joint.name in free and joint.velocity == 0.0]
    if unset:
        messages.append(f"the velocity limit of {quote_joints(unset)} is 0; treated as no limit")
    turns = {j.name: max(-j.lower, j.upper) for j in chain if j.type == "revolute" and j.name in free}
    wide = {name: turn for name, turn in turns.items() if SUSPECT.limits[0] < turn <= SUSPECT.limits[1]}
    if wide:
        largest = f"up to {max(wide.values()):g} rad"
        messages.append(f"limits of {quote_joints([*wide])} are {largest}; are they in degrees?")
    still = [
        joint
        for joint in description.joints
        if joint.moves
        and joint.name not in on_chain
        and joint.name not in locked
        and not (joint in before and joint.type in MULTI_DOF_JOINTS)
    ]
    if still:
        messages.append(_off_chain(description, base, tip, still))
    named = {joint.name: joint for joint in description.joints}
    led = [joint.name for joint in still if joint.follows and leading_joint(joint, named).name in free]
    if led:
        what = "mimic joints on it, but are locked where those are at zero"
        messages.append(f"{quote_joints(led)} off the chain {what}")
    lost = [joint.name for joint in still if joint.follows is not None and joint.follows.joint not in named]
    if lost:
        messages.append(f"{quote_joints(lost)} off the chain mimic joints that do not exist")
    return messages


def _off_chain(description: Description, base: str, tip: str, still: list[JointDescription]) -> str:
    """Describe the locked joints off the chain, by the link of the chain at which their branches begin."""
    links = {base, *(joint.child for joint in description.chain(base, tip))}
    branches = defaultdict[str, list[str]](list)
    for joint in still:
        link = joint.parent
        while link not in links and link != description.root:
            link = description.joint_before[link].parent
        branches[link].append(joint.name)
    locked = (f"{len(names)} at link {link!r} ({quote_names(names, 3)})" for link, names in branches.items())
    listed = enumerated(locked, between="; ")
    return f"{count_joints(len(still))} off the chain from {base!r} to {tip!r} locked: {listed}"


def _set_limits(model: pin.Model, moving: Sequence[JointDescription]) -> None:
    """Set position limits; Pinocchio reads a <limit> without lower and upper, i.e. no limits, as (0, 0)."""
    for joint in moving:
        index = model.joints[model.getJointId(joint.name)]
        if index.nq == 1:
            model.lowerPositionLimit[index.idx_q] = joint.lower
            model.upperPositionLimit[index.idx_q] = joint.upper


def _modules_to_links(model: pin.Model, skeleton: Skeleton, links: Sequence[str]) -> Segmentation:
    """Return the modules that end at the origins of links, given from base to tip.

    A joint whose axis passes through the origin of a link does not move that origin, so it belongs to the
    next module; usually this is the joint that carries the link.
    """
    bodies = {frame.name: frame for frame in model.frames if frame.type == pin.FrameType.BODY}
    placements = neutral_placements(model)
    n = len(skeleton.names)
    ends = [0]
    for link in links:
        require_known("link", link, bodies)
        frame = bodies[link]
        name = str(model.names[frame.parentJoint])
        end = skeleton.names.index(name) + 1 if name in skeleton.names else 0
        if end and link != links[-1] and skeleton.revolute[end - 1]:
            arm = frame_position(frame, placements) - skeleton.stations[end - 1]
            lever = np.cross(skeleton.axes[end - 1], arm)
            end -= int(np.linalg.norm(lever) <= ON_AXIS * skeleton.length)
        if end <= ends[-1]:
            allowed = (
                "links in order from base to tip, each moved by a joint that does not move the previous one"
            )
            raise InvalidValue(f"split: link {link!r}", f"moved by {end} joints of the chain", allowed)
        ends.append(end)
    if ends[-1] != n:
        allowed = f"a link moved by all {n} joints of the chain"
        raise InvalidValue(f"split: last link {links[-1]!r}", f"moved by {ends[-1]} of them", allowed)
    sizes = tuple(b - a for a, b in pairwise(ends))
    return Segmentation(sizes, "modules end at the links that were given")


def _add_end_frames(
    model: pin.Model, joints: Sequence[str], tip: str, sizes: Sequence[int], links: Sequence[str]
) -> tuple[str, ...]:
    """Add a frame where each module ends: at its link, if given, or at the next joint, or at the tip.

    Returns:
        Names of the frames: "module_01" and so on, with more underscores after "module" if those are taken.
    """
    ids = [model.getJointId(name) for name in joints]
    ends = np.cumsum(sizes)
    taken = {frame.name for frame in model.frames}
    prefix = "module_"
    while taken & set(names := [f"{prefix}{k:02d}" for k in range(1, len(ends) + 1)]):
        prefix += "_"
    for k, (name, end) in enumerate(zip(names, ends, strict=True)):
        if links or end == len(ids):
            link = links[k] if links else tip
            frame = model.frames[model.getFrameId(link, pin.FrameType.BODY)]
            parent = frame.parentJoint
            placement = frame.placement
            if parent != ids[end - 1]:  # the link turns about its own origin: attach to the previous body
                parent, placement = model.parents[parent], model.jointPlacements[parent] * placement
        else:
            parent = model.parents[ids[end]]
            placement = model.jointPlacements[ids[end]]
        model.addFrame(pin.Frame(name, parent, placement, pin.FrameType.OP_FRAME))
    return tuple(names)
