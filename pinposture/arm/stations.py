"""Control points of a loaded arm: frames at the ends of its modules."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import pinocchio as pin

from pinposture.arm.segmentation import Segmentation
from pinposture.arm.skeleton import ON_AXIS, Skeleton, neutral_placements
from pinposture.errors import InvalidValue, UnknownName


def modules_to_links(model: pin.Model, skeleton: Skeleton, links: Sequence[str]) -> Segmentation:
    """Modules that end at the origins of links.

    A joint that turns about an axis through the origin of a link does not move it, so it belongs to the next
    module: the origin of a link is where the joint that carries it sits.

    Args:
        model: the arm, reduced to its chain.
        skeleton: its joints.
        links: names of links from base to tip; the last one is moved by the last joint.

    Raises:
        UnknownName: there is no such link.
        InvalidValue: links that are not in order along the chain, or that leave joints over.
    """
    bodies = {frame.name: frame for frame in model.frames if frame.type == pin.FrameType.BODY}
    placements = neutral_placements(model)
    n, ends = len(skeleton.names), [0]
    for link in links:
        if link not in bodies:
            raise UnknownName("link", link, bodies)
        frame = bodies[link]
        name = str(model.names[frame.parentJoint])
        end = skeleton.names.index(name) + 1 if name in skeleton.names else 0
        place = (placements[frame.parentJoint] * frame.placement).translation
        if end and link != links[-1] and skeleton.revolute[end - 1]:
            lever = np.cross(skeleton.axes[end - 1], place - skeleton.stations[end - 1])
            end -= int(np.linalg.norm(lever) <= ON_AXIS * skeleton.length)
        if end <= ends[-1]:
            allowed = (
                "links in order from base to tip, each moved by a joint that does not move the one before"
            )
            raise InvalidValue(f"modules: link {link!r}", f"moved by {end} joints of the chain", allowed)
        ends.append(end)
    if ends[-1] != n:
        allowed = f"a link moved by all {n} joints of the chain"
        raise InvalidValue(f"modules: last link {links[-1]!r}", f"moved by {ends[-1]} of them", allowed)
    sizes = tuple(b - a for a, b in pairwise(ends))
    return Segmentation(sizes, "modules end at the links that were given")


def end_frames(
    model: pin.Model, joints: Sequence[str], tip: str, sizes: Sequence[int], links: Sequence[str]
) -> tuple[str, ...]:
    """Add a frame where each module ends: at its link, or where the next joint sits, or at the tip.

    Args:
        model: the arm, reduced to its chain; frames are added to it.
        joints: names of the joints of the chain.
        tip: link at which the chain ends.
        sizes: number of joints of each module.
        links: the links at which modules end, if they were given.

    Returns:
        Names of the frames: "module_01" and so on, with as many underscores after "module" as it takes for
        them to be new.
    """
    ids = [model.getJointId(name) for name in joints]
    ends = np.cumsum(sizes)
    taken = {frame.name for frame in model.frames}
    prefix = "module_"
    while any(name in taken for name in _names(prefix, len(ends))):
        prefix += "_"
    names = _names(prefix, len(ends))
    for k, (name, end) in enumerate(zip(names, ends, strict=True)):
        if links or end == len(ids):
            link = links[k] if links else tip
            frame = model.frames[model.getFrameId(link, pin.FrameType.BODY)]
            parent, placement = frame.parentJoint, frame.placement
            if parent != ids[end - 1]:  # the link turns about its own origin: the point is on the body before
                parent, placement = model.parents[parent], model.jointPlacements[parent] * placement
        else:
            parent, placement = model.parents[ids[end]], model.jointPlacements[ids[end]]
        model.addFrame(pin.Frame(name, parent, placement, pin.FrameType.OP_FRAME))
    return names


def _names(prefix: str, count: int) -> tuple[str, ...]:
    return tuple(f"{prefix}{k:02d}" for k in range(1, count + 1))
