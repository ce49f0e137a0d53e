"""Joints that hold still: those off the chain, and those that the user or the file locks."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping

import numpy as np
import pinocchio as pin

from pinposture.arm.default_tip import leading_joint
from pinposture.arm.description import Description, JointDescription
from pinposture.arm.limits import UNLIMITED
from pinposture.errors import InvalidValue, UnknownName, URDFError

_MARK = "\n"  # no name in a description has one


def checked_locks(description: Description, locked: Mapping[str, float]) -> dict[str, float]:
    """Positions of the joints that the user locks, [rad or m].

    Raises:
        UnknownName: no such joint, or one that cannot move.
        InvalidValue: not a number, or one out of range, or a joint whose position is not one number.
    """
    known = {joint.name: joint for joint in description.joints if joint.type != "fixed"}
    checked = {}
    for name, value in locked.items():
        if name not in known:
            raise UnknownName("moving joint", name, known)
        if known[name].type in ("floating", "planar"):
            allowed = f"nothing: it is {known[name].type}, its position is not one number"
            raise InvalidValue(f"locked[{name!r}]", value, allowed)
        try:
            checked[name] = float(value)
        except (TypeError, ValueError):
            checked[name] = np.nan
        if not abs(checked[name]) < UNLIMITED:
            raise InvalidValue(f"locked[{name!r}]", value, f"a joint position within +-{UNLIMITED:g}")
    return checked


def hold(
    model: pin.Model, description: Description, moving: Iterable[str], locked: Mapping[str, float]
) -> pin.Model:
    """A model in which only the listed joints move.

    The others stay at their locked position, or where the joint that they mimic puts them, or at the position
    nearest zero within their limits.

    Raises:
        URDFError: Pinocchio cannot reduce the model.
    """
    free = set(moving)
    positions = held_positions(description, locked)
    reference = pin.neutral(model)
    held = []
    for index in range(1, model.njoints):
        name, joint = model.names[index], model.joints[index]
        if name in free:
            continue
        held.append(index)
        if joint.nq == 1:
            reference[joint.idx_q] = positions[name]
        elif joint.nv == 1:
            reference[joint.idx_q : joint.idx_q + 2] = np.cos(positions[name]), np.sin(positions[name])
    if not held:
        return model
    # Pinocchio cannot reduce a model in which a link and a joint have the same name.
    for frame in model.frames:
        if frame.type == pin.FrameType.BODY:
            frame.name += _MARK
    try:
        reduced = pin.buildReducedModel(model, held, reference)
    except (ValueError, RuntimeError) as error:
        raise URDFError(description.source, "<robot>", f"cannot be reduced to one chain: {error}") from None
    for frame in reduced.frames:
        frame.name = frame.name.removesuffix(_MARK)
    return reduced


def held_positions(description: Description, locked: Mapping[str, float]) -> dict[str, float]:
    """Where each joint with one degree of freedom stays if it is held [rad or m]."""
    named = {joint.name: joint for joint in description.joints if joint.type != "fixed"}
    positions: dict[str, float] = {}

    def position(joint: JointDescription, above: frozenset[str]) -> float:
        if joint.name in locked:
            return locked[joint.name]
        follows = joint.follows
        if follows is None or follows.joint not in named or follows.joint in above:
            return min(max(0.0, joint.lower), joint.upper)
        leader = position(named[follows.joint], above | {joint.name})
        return follows.multiplier * leader + follows.offset

    for name, joint in named.items():
        positions[name] = position(joint, frozenset({name}))
    return positions


def holding_warnings(
    description: Description,
    base: str,
    tip: str,
    moving: Iterable[str],
    locked: Mapping[str, float],
) -> list[str]:
    """What the user should know about the joints that hold still without having been asked to."""
    free, chain = set(moving), description.chain(base, tip)
    on_chain = {joint.name for joint in chain}
    before = description.chain(description.root, base)
    messages = [
        f"joint {joint.name!r} ({joint.type}) at the base of the arm is treated as fixed"
        for joint in (*before, *chain)
        if joint.type in ("floating", "planar")
    ]
    stuck = [joint.name for joint in chain if joint.type != "fixed" and not joint.moves]
    stuck = [name for name in stuck if name not in locked]
    if stuck:
        messages.append(f"limits that leave one position lock {_joints(stuck)} on the chain")
    endless = [joint.name for joint in chain if joint.name in free and _lacks_limits(joint)]
    if endless:
        messages.append(f"no limits are given for {_joints(endless)}; taken as unlimited")
    still = [
        joint
        for joint in description.joints
        if joint.moves and joint.name not in on_chain and joint.name not in locked
    ]
    still = [joint for joint in still if joint not in before or joint.type not in ("floating", "planar")]
    if still:
        messages.append(_off_chain(description, base, tip, still))
    named = {joint.name: joint for joint in description.joints}
    led = [joint.name for joint in still if joint.mimic and leading_joint(joint, named).name in free]
    if led:
        messages.append(
            f"{_joints(led)} off the chain mimic joints on it, but are held where those are at zero"
        )
    lost = [joint.name for joint in still if joint.follows is not None and joint.follows.joint not in named]
    if lost:
        messages.append(f"{_joints(lost)} off the chain mimic joints that do not exist")
    return messages


def _lacks_limits(joint: JointDescription) -> bool:
    return joint.type in ("revolute", "prismatic") and joint.lower == -np.inf and joint.upper == np.inf


def _off_chain(description: Description, base: str, tip: str, still: list[JointDescription]) -> str:
    """How many joints off the chain are held, and at which link of the chain their branches begin."""
    links = {base, *(joint.child for joint in description.chain(base, tip))}
    parents = {joint.child: joint.parent for joint in description.joints}
    branches = defaultdict[str, list[str]](list)
    for joint in still:
        link = joint.parent
        while link not in links and link != description.root:
            link = parents[link]
        branches[link].append(joint.name)
    places = [f"{len(names)} at link {link!r} ({_few(names)})" for link, names in branches.items()]
    count = "1 joint" if len(still) == 1 else f"{len(still)} joints"
    return f"{count} off the chain from {base!r} to {tip!r} held still: {'; '.join(places[:6])}" + (
        "; ..." if len(places) > 6 else ""
    )


def _joints(names: list[str]) -> str:
    return ("joint " if len(names) == 1 else "joints ") + _few(names, 8)


def _few(names: list[str], most: int = 3) -> str:
    return ", ".join(map(repr, names[:most])) + (", ..." if len(names) > most else "")
