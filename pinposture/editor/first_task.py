"""A first task for an arm: straight, then slightly bent, ready to be dragged."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pinposture.arm import Arm
from pinposture.control import Limits
from pinposture.curve import Curve
from pinposture.editor.edits import FIT_TOLERANCE, MAX_SHAPE_POINTS, Shape
from pinposture.editor.solver import judge
from pinposture.errors import PostureError, TaskError
from pinposture.placement.target import arm_axis
from pinposture.task import Keyframe, Task
from pinposture.task.specification import DEFAULT_CYCLE
from pinposture.viz.body import backbone

Array = NDArray[np.float64]

BENDS = (1.4, 0.8, 0.4, 0.2)  # turn of the curve between its ends [rad]; the first that the arm can take
CONTROL_POINTS = 6
JOINT_SHARES = (0.3, 0.15, 0.05, 0.0)  # of joint ranges, for a shape where no bent line can be taken
CURVE_LENGTH = 1.08  # relative to the arm, since modules cut corners
ACCELERATION = 20.0  # limit of each joint [rad/s^2 or m/s^2]: smooth, and fast enough for a hand
BENT_TIME = 3.0  # of the second keyframe [s]


def first_task(arm: Arm, name: str = "") -> Task:
    """Return a task for an arm of which nothing is known: straight, and three seconds later bent.

    Args:
        arm: the arm.
        name: of the task.

    Raises:
        TaskError: no shape was found that the arm can take.
    """
    straight = _first_feasible(arm, [_line(arm), *_along_arm(arm, (0.0,))])
    bent = _first_feasible(arm, [*(_arc(arm, bend) for bend in BENDS), *_along_arm(arm, JOINT_SHARES)])
    if straight is None or bent is None:
        raise TaskError("the arm", "no curve was found that it can take; begin with a task file")
    keyframes = (
        Keyframe(straight.curve, name="straight", placement="as_is", trim=True),
        Keyframe(bent.curve, time=BENT_TIME, name="bent", placement="as_is", trim=True),
    )
    limits = Limits(step=None, dt=DEFAULT_CYCLE, acceleration=ACCELERATION)
    return Task(arm=arm, motion=keyframes, limits=limits, name=name)


def _first_feasible(arm: Arm, shapes: list[Shape]) -> Shape | None:
    for shape in shapes:
        keyframe = Keyframe(shape.curve, placement="as_is", trim=True)
        if judge(arm, keyframe, None).target is not None:
            return shape
    return None


def _line(arm: Arm) -> Shape:
    along = np.linspace(0.0, CURVE_LENGTH * arm.length, CONTROL_POINTS)
    return Shape(_round_points(arm, arm.chain.base + along[:, None] * arm_axis(arm)))


def _arc(arm: Arm, bend: float) -> Shape:
    """Return a shape that leaves along the arm, and turns upwards if it can."""
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
    leg = CURVE_LENGTH * arm.length / (CONTROL_POINTS - 1)
    headings = np.concatenate([[0.0], np.linspace(0.0, bend, CONTROL_POINTS - 2)])
    steps = leg * (np.cos(headings)[:, None] * ahead + np.sin(headings)[:, None] * side)
    return Shape(_round_points(arm, arm.chain.base + np.vstack([np.zeros(3), np.cumsum(steps, axis=0)])))


def _round_points(arm: Arm, points: Array) -> Array:
    """Round points (n, 3) [m] to a few digits, for legible files; the first stays where it is."""
    digits = 4 - int(np.floor(np.log10(arm.length)))
    return np.vstack([points[:1], np.round(points[1:], digits)])


def _along_arm(arm: Arm, shares: tuple[float, ...]) -> list[Shape]:
    """Return shapes along the stretched arm with its joints moved by shares of their ranges."""
    shapes: list[Shape] = []
    start = arm.straight()
    lower, upper = (np.clip(edge, -np.pi, np.pi) for edge in (arm.limits.lower, arm.limits.upper))
    for share in shares:
        middle = np.clip(0.5 * (lower + upper) - arm.positions(start), -1.0, 1.0) * arm.moved
        try:
            line = backbone(arm, arm.integrate(start, share * middle))
            kept = line[np.append(True, np.linalg.norm(np.diff(line, axis=0), axis=1) > 1e-6 * arm.length)]
            end = kept[-1] + (kept[-1] - kept[-2]) / np.linalg.norm(kept[-1] - kept[-2]) * 0.05 * arm.length
            through = Curve.points(np.vstack([kept, end]))
            tolerance = 2.0 * FIT_TOLERANCE * float(arm.chain.module_lengths.mean())
            fitted = through.controlled_within(tolerance, most=MAX_SHAPE_POINTS)
            shapes.append(Shape(np.array(fitted.coefficients)))
        except PostureError:
            continue
    return shapes
