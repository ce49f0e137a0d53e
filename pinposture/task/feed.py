"""An arm on a feed: a slide that pushes the whole arm along its own axis, and the arm that it carries."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from pinposture.arm import Arm
from pinposture.errors import InvalidValue
from pinposture.target.placement import arm_axis

Array = NDArray[np.float64]

NEEDED = (
    "an arm whose first joint is a slide along the straight arm and whose second is not, as "
    "Arm.from_modules([feed, *modules]) makes it of a feed with one prismatic joint about x"
)
ALONG = 1e-6
"""How far the axis of the feed may be off that of the straight arm, sine of the angle between them."""

STRAIGHT = 1e-6
"""How far a joint may be from where the arm is straight to count as being there, in `Arm.joint_units`."""

WITHOUT_LENGTH = 1e-9
"""Links shorter than this count as none, relative to the arm."""


@dataclass(frozen=True, eq=False)
class Fed:
    """An arm on a feed, taken apart.

    Attributes:
        arm: the whole arm.
        start: the configuration to begin in, (nq,): straight.
        column: index of the feed in the tangent space of the arm.
        sense: 1 if larger positions of the feed push the arm out, -1 if smaller ones do.
        travel: how far the feed can push from the start [m].
        body: the arm without its feed, where the start puts it; its control points are those of the arm that
            bending moves.
        links: the same with a control point at the end of each link, so at each joint and at the tip.
        columns: index in the tangent space of the arm of each degree of freedom of the body, (nv - 1,).
        straight: joint positions of the body at the start, (nv - 1,) [rad or m].
        axis: direction in which the feed pushes, unit vector (3,), world frame.
        tip: where the tip is at the start, (3,) [m], world frame.
    """

    arm: Arm
    start: Array
    column: int
    sense: float
    travel: float
    body: Arm
    links: Arm
    columns: NDArray[np.intp]
    straight: Array
    axis: Array
    tip: Array

    @property
    def length(self) -> float:
        """Length of what the feed carries, from its first joint to the tip [m]."""
        return self.body.length


def taken_apart(arm: Arm, start: ArrayLike | None = None) -> Fed:
    """Find the feed of an arm.

    Args:
        arm: the arm.
        start: configuration to begin in, straight, (nq,); if None, the feed is pulled back as far as it goes
            and the arm is stretched.

    Raises:
        InvalidValue: not an arm on a feed, a feed without limits, or a start that is not straight.
    """
    if not isinstance(arm, Arm):
        raise InvalidValue("arm", arm, NEEDED)
    chain = arm.chain
    if len(chain.joints) < 2 or chain.revolute[0] or not chain.revolute[1]:
        kinds = ["revolute" if turns else "prismatic" for turns in chain.revolute[:2]]
        first = ", ".join(f"{name} ({kind})" for name, kind in zip(chain.joints, kinds, strict=False))
        raise InvalidValue("first joints of the arm", first, NEEDED)
    column = int(chain.columns[0])
    lower, upper = float(arm.limits.lower[column]), float(arm.limits.upper[column])
    if not (np.isfinite(lower) and np.isfinite(upper)):
        raise InvalidValue(f"limits of the feed {chain.joints[0]!r}", (lower, upper), "finite positions [m]")
    columns = np.delete(np.arange(arm.nv), column)
    rest = arm.positions(arm.neutral() if start is None else arm.checked(start, "start"))
    body, links = _carried(arm, rest)
    axis, stretched = arm_axis(body), body.positions(body.straight())
    along = float(chain.axes[0] @ axis)
    if float(np.linalg.norm(np.cross(chain.axes[0], axis))) > ALONG:
        angle = float(np.degrees(np.arccos(np.clip(abs(along), 0.0, 1.0))))
        text = f"{angle:.3g} degrees off the straight arm"
        raise InvalidValue(f"axis of the feed {chain.joints[0]!r}", text, NEEDED)
    if start is None:
        rest[column], rest[columns] = lower if along > 0.0 else upper, stretched
        body, links = _carried(arm, rest)
    else:
        bent = np.abs(rest[columns] - stretched) / body.joint_units
        if bent.max() > STRAIGHT or not arm.within_limits(arm.configuration(rest)):
            straight = "the straight arm, within its limits, wherever the feed is"
            raise InvalidValue("start", start, straight)
    return Fed(
        arm=arm,
        start=arm.configuration(rest),
        column=column,
        sense=1.0 if along > 0.0 else -1.0,
        travel=upper - float(rest[column]) if along > 0.0 else float(rest[column]) - lower,
        body=body,
        links=links,
        columns=columns,
        straight=rest[columns],
        axis=axis,
        tip=body.at(body.configuration(rest[columns])).points[-1],
    )


def _carried(arm: Arm, positions: Array) -> tuple[Arm, Arm]:
    """The arm with its feed locked: with its own control points, and with one at the end of each link."""
    chain = arm.chain
    feed = arm.model.getJointId(chain.joints[0])
    model = pin.buildReducedModel(arm.model, [feed], arm.configuration(positions))
    # A first module that is the feed alone has nothing left to move its control point.
    first = 1 if len(chain.module_starts) > 1 and chain.module_starts[1] == 1 else 0
    body = Arm.from_model(model, arm.control_points[first:])
    places = [pin.SE3.Identity()]
    for joint in range(1, model.njoints):
        places.append(places[model.parents[joint]] * model.jointPlacements[joint])
    ends, names = [*body.chain.origins[1:], body.chain.points[-1]], []
    for name, begin, end in zip(body.chain.joints, body.chain.origins, ends, strict=True):
        if np.linalg.norm(end - begin) > WITHOUT_LENGTH * body.length:
            joint = model.getJointId(name)
            there = places[joint].inverse() * pin.SE3(np.eye(3), np.asarray(end))
            names.append(f"end of the link after {name}")
            model.addFrame(pin.Frame(names[-1], joint, there, pin.FrameType.OP_FRAME))
    return body, Arm.from_model(model, names)
