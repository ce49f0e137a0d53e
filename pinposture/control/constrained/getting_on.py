"""The usual step in one call: along the way, where nothing but the limits has a say."""

from __future__ import annotations

import numpy as np

from pinposture import kernels
from pinposture.arm import ArmState
from pinposture.control.constrained.course import DISTURBED, Course
from pinposture.control.constrained.path import FARTHEST
from pinposture.control.controller import Diagnostics, Memory, Step
from pinposture.control.joint_bounds import JointBounds
from pinposture.control.limits import ROUNDING

ARRIVED = 1e-9
"""Joint motion left at which a way is behind the arm, in `Arm.joint_units`."""

RISES = 1e-12
"""By how much the posture error rises if it does, in arm lengths: less is rounding."""


def get_on(course: Course, state: ArmState, bounds: JointBounds) -> Step | None:
    """The step that `ConstrainedQP` takes where it is simply the next one on a way.

    It is looked for first, because most steps are such. What else they may be, the long way round finds out:
    limits that cannot be kept, an arm that is not where it should be, a way that is at its end or leads out
    of what limits allow.

    Args:
        course: where the arm is on its way, with nothing to avoid.
        state: where the arm is.
        bounds: what the limits mean for its joints.

    Returns:
        The step; None if it is not that simple.
    """
    posture, path = course.posture, course.path
    if course.arrived or course.pace is not None or not posture.plain:
        return None
    arm, placed, chain, wanted = state.arm, state.placed, state.arm.kinematics, posture.chain
    expected = placed.positions if course.expected is None else course.expected
    if len(wanted.which) < len(chain.columns):
        return None
    dq, reached, at_limit = np.zeros(arm.nv), np.empty(arm.nv), np.empty(arm.nv, dtype=np.bool_)
    simple, place, before, after = kernels.advance(
        chain.constants,
        chain.endless,
        bounds.units,
        bounds.leaning,
        bounds.edges,
        bounds.bound,
        placed.positions,
        placed.points,
        path.offsets,
        path.positions,
        course.place,
        expected,
        DISTURBED,
        ARRIVED,
        ROUNDING,
        FARTHEST,
        wanted.targets,
        wanted.flags,
        dq,
        reached,
        at_limit,
    )
    if not simple or not np.isfinite(after):
        return None
    course = course.gone_to(place, bounds.travel, place <= course.place, reached)
    diagnostics = Diagnostics(
        0.0,
        0.0,
        0.0,
        len(posture.active) * arm.dimension,
        (),
        1.0,
        at_limit,
        "",
        escape=after > before + RISES * arm.length,
        on_way=course.waited == 0.0,
    )
    return Step(dq, posture.active, diagnostics, Memory(dq, course))
