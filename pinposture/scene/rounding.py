"""Cylinders whose two ends are rounded by balls of the same radius are capsules, and their balls are spare.

Snake arms are commonly described as a ball at each joint and a tube from there to the next. Together they are
exactly a chain of capsules, which have half as many solids, and distances in closed form.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pinposture.scene.collision_geometry import LinkShape
from pinposture.scene.obstacles import Capsule, Cylinder, Sphere

Array = NDArray[np.float64]

_SAME = 1e-9
"""How far apart the same point, or how different the same radius, may be, relative to the radius."""


def rounded(model: pin.Model, shapes: Sequence[LinkShape]) -> list[LinkShape]:
    """The same solid arm with capsules in place of cylinders whose ends are round, without the spare balls.

    A ball on the axis of its joint stands still when that joint turns, so it rounds the body before as well.

    Args:
        model: the arm.
        shapes: its solids.

    Returns:
        Solids with the same union at every configuration, in the same order.
    """
    if not any(isinstance(shape, Cylinder) for _, _, shape in shapes):
        return list(shapes)
    postures = _two_postures(model)
    balls = [
        (place, joint, shape.radius, index)
        for index, (_, at, shape) in enumerate(shapes)
        if isinstance(shape, Sphere)
        for joint, place in _resting_places(model, at, shape, postures)
    ]
    merged, spare = list(shapes), set[int]()
    for index, (link, joint, shape) in enumerate(shapes):
        if not isinstance(shape, Cylinder):
            continue
        near = _SAME * shape.radius
        ends = [
            [
                ball
                for place, at, radius, ball in balls
                if at == joint and abs(radius - shape.radius) <= near and np.abs(place - end).max() <= near
            ]
            for end in (shape.start, shape.end)
        ]
        if all(ends):
            merged[index] = LinkShape(link, joint, Capsule(shape.start, shape.end, shape.radius))
            spare.update(ends[0] + ends[1])
    return [shape for index, shape in enumerate(merged) if index not in spare]


def _resting_places(
    model: pin.Model, joint: int, ball: Sphere, postures: Sequence[list[pin.SE3]]
) -> list[tuple[int, Array]]:
    """Where a ball is in the frame of its joint, and of those before in whose frames it never moves."""
    place = np.array(ball.center)
    places = [(joint, place)]
    while joint > 0:
        one, other = (posture[joint].act(place) for posture in postures)
        if np.abs(one - other).max() > _SAME * ball.radius:
            break
        joint, place = int(model.parents[joint]), one
        places.append((joint, place))
    return places


def _two_postures(model: pin.Model) -> list[list[pin.SE3]]:
    """Placement of each joint in the frame of the one before, with all joints at zero, and all at one."""
    at = pin.neutral(model)
    postures = []
    for q in (at, pin.integrate(model, at, np.ones(model.nv))):
        placements = [pin.SE3.Identity()]
        for joint in range(1, model.njoints):  # one by one: a pin.Data is huge for long arms
            moved = model.joints[joint].createData()
            model.joints[joint].calc(moved, q)
            placements.append(model.jointPlacements[joint] * moved.M)
        postures.append(placements)
    return postures
