"""The task that an arm begins with: it lies straight, then it is bent a little, ready to be dragged."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pinposture.arm import Arm
from pinposture.control import Limits
from pinposture.curve import Curve
from pinposture.editor.shape import FINE, MOST_POINTS, Shape
from pinposture.editor.verdict import judge
from pinposture.errors import PostureError, TaskError
from pinposture.placement.curve_placement import arm_axis
from pinposture.task import Keyframe, Task
from pinposture.task.perform import DEFAULT_CYCLE
from pinposture.viz.body import backbone

Array = NDArray[np.float64]

BENDS = (1.4, 0.8, 0.4, 0.2)
"""How far the curve turns between its ends [rad]; the first that the arm can take."""

POINTS = 6
"""Control points of it."""

NUDGES = (0.3, 0.15, 0.05, 0.0)
"""How far joints are moved for a shape where no bent line can be taken, as shares of their ranges."""

LONGER = 1.08
"""How much of the arm's length the curve has: where it bends, modules cover more of it than they are long."""

ACCELERATION = 20.0
"""Of each joint at most [rad/s^2 or m/s^2]: the arm moves smoothly, and follows a hand."""

TIME = 3.0
"""When it is to be taken [s]."""


def first_task(arm: Arm, name: str = "") -> Task:
    """A task for an arm that nothing is known of: straight, and three seconds later bent.

    Args:
        arm: the arm.
        name: what to call it.

    Raises:
        TaskError: no shape was found that the arm can take.
    """
    straight = _first(arm, [_line(arm), *_own(arm, (0.0,))])
    bent = _first(arm, [*(_arc(arm, bend) for bend in BENDS), *_own(arm, NUDGES)])
    if straight is None or bent is None:
        raise TaskError("the arm", "no curve was found that it can take; begin with a task file")
    keyframes = (
        Keyframe(straight.curve, name="straight", placement="as_is", trim=True),
        Keyframe(bent.curve, time=TIME, name="bent", placement="as_is", trim=True),
    )
    return Task(
        arm=arm,
        motion=keyframes,
        limits=Limits(step=None, dt=DEFAULT_CYCLE, acceleration=ACCELERATION),
        name=name,
    )


def _first(arm: Arm, shapes: list[Shape | None]) -> Shape | None:
    """The first shape that the arm can take."""
    for shape in shapes:
        if shape is not None:
            keyframe = Keyframe(shape.curve, placement="as_is", trim=True)
            if judge(arm, keyframe, None).target is not None:
                return shape
    return None


def _line(arm: Arm) -> Shape:
    along = np.linspace(0.0, LONGER * arm.length, POINTS)
    return Shape(_neat(arm, arm.chain.base + along[:, None] * arm_axis(arm)))


def _arc(arm: Arm, bend: float) -> Shape:
    """Control points of a curve that leaves along the arm, and turns upwards if it can."""
    ahead = arm_axis(arm)
    up = np.array([0.0, 0.0, 1.0])
    if arm.dimension == 2:
        up = arm.plane.T @ (arm.plane @ up)
        if float(np.linalg.norm(up)) < 0.1:
            up = arm.plane[1]
    side = up - (up @ ahead) * ahead
    if float(np.linalg.norm(side)) < 0.1:
        side = arm.plane.T @ (arm.plane @ np.array([1.0, 0.3, 0.0]))
        side -= (side @ ahead) * ahead
    side /= np.linalg.norm(side)
    # Straight for the first leg, so that the first module need not turn; then an arc.
    leg = LONGER * arm.length / (POINTS - 1)
    headings = np.concatenate([[0.0], np.linspace(0.0, bend, POINTS - 2)])
    steps = leg * (np.cos(headings)[:, None] * ahead + np.sin(headings)[:, None] * side)
    return Shape(_neat(arm, arm.chain.base + np.vstack([np.zeros(3), np.cumsum(steps, axis=0)])))


def _neat(arm: Arm, points: Array) -> Array:
    """Points (n, 3) [m] with few digits, as a person would write them; the first stays where it is."""
    digits = 4 - int(np.floor(np.log10(arm.length)))
    return np.vstack([points[:1], np.round(points[1:], digits)])


def _own(arm: Arm, shares: tuple[float, ...]) -> list[Shape | None]:
    """Shapes along the arm itself, joints moved by shares of their ranges from where it is stretched."""
    shapes: list[Shape | None] = []
    start = arm.straight()
    lower, upper = (np.clip(edge, -np.pi, np.pi) for edge in (arm.limits.lower, arm.limits.upper))
    for share in shares:
        middle = np.clip(0.5 * (lower + upper) - arm.positions(start), -1.0, 1.0) * arm.moved
        try:
            line = backbone(arm, arm.integrate(start, share * middle))
            kept = line[np.append(True, np.linalg.norm(np.diff(line, axis=0), axis=1) > 1e-6 * arm.length)]
            end = kept[-1] + (kept[-1] - kept[-2]) / np.linalg.norm(kept[-1] - kept[-2]) * 0.05 * arm.length
            through = Curve.points(np.vstack([kept, end]))
            tolerance = 2.0 * FINE * float(arm.chain.module_lengths.mean())
            few = through.controlled_within(tolerance, most=MOST_POINTS)
            shapes.append(Shape(np.array(few.coefficients)))
        except PostureError:
            shapes.append(None)
    return shapes
