"""The tip of the arm, dragged: the shape becomes that of a posture that brings it there."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pinposture.arm import Arm
from pinposture.control.reach import ReachedPosture, reach, reach_from
from pinposture.curve import Curve
from pinposture.editor.edits import required_length, with_keyframe
from pinposture.editor.session import JOINT_DIGITS, Session
from pinposture.errors import PostureError, ReachError

Array = NDArray[np.float64]

REACH_BUDGET = 1.0  # of the search when the tip is let go and no clear posture is near [s]


def drag_tip(place: Array, start: Array, final: bool, session: Session, keyframe: int | None = None) -> None:
    """Propose the shape of a clear posture that has the tip at a place.

    While the hand is dragging, only the posture that is near the present one is looked for; where there is
    none, the arm stays at the last one. When it lets go, others are tried, too.

    Args:
        place: where the tip should be, (3,) [m], world frame.
        start: the present posture, (nq,).
        final: whether it is to be accepted; else the hand is still dragging.
        session: the session.
        keyframe: the one that is dragged; nothing is done if another was selected meanwhile. None: the one
            that is selected.
    """
    if keyframe is not None and keyframe != session.selected:
        return
    arm, scene, limits = session.arm, session.task.scene, session.task.limits
    try:
        if arm.dimension == 2:
            place = arm.chain.base + arm.plane.T @ (arm.plane @ (place - arm.chain.base))
        found = reach_from(arm, place, start, scene, limits)
        if found is None and final:
            found = reach(arm, place, scene=scene, limits=limits, budget=REACH_BUDGET)[0]
        if found is None:
            raise ReachError(place, "no clear posture is near; let go there to have others tried")
        curve = posture_curve(arm, found)
    except PostureError as error:
        if final:
            session.proposal = None
            session.say(str(error), "error")
            session.touch()
        elif session.notice.text != " ".join(str(error).split()):
            session.say(str(error), "warning")
        return
    joints = tuple(np.round(arm.positions(found.q), JOINT_DIGITS).tolist())
    edit = with_keyframe(session.selected, curve=curve, placement="as_is", roll=0.0, trim=True, joints=joints)
    at = ", ".join(f"{each:.4g}" for each in place)
    session.propose(edit, f"reached for ({at}) m", final)


def posture_curve(arm: Arm, posture: ReachedPosture) -> Curve:
    """Return a curve from the base through all control points of a posture, and a little straight on.

    Raises:
        CurveError: control points that coincide.
    """
    points = np.vstack([arm.chain.base, posture.target.points])
    ahead = (points[-1] - points[-2]) / np.linalg.norm(points[-1] - points[-2])
    more = required_length(arm) - arm.length
    return Curve.spline(np.vstack([points, points[-1] + more * ahead]), through=True)


def hold_tip(session: Session) -> None:
    """Select the tip, instead of a control point or an obstacle."""
    session.take_hold(None)
    session.obstacle, session.tip = None, True
