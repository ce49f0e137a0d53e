"""Postures that become keyframes: with the tip where it is dragged, taught, and as curves."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pinposture.arm import Arm
from pinposture.control.reach import reach, reach_from
from pinposture.curve import Curve
from pinposture.editor import edits
from pinposture.editor.session import Session
from pinposture.errors import PostureError, ReachError
from pinposture.task import Task
from pinposture.viz.body import backbone

Array = NDArray[np.float64]


def drag_tip(
    position: Array, start: Array, final: bool, session: Session, keyframe: int | None = None
) -> None:
    """Propose the shape of a clear posture that has the tip at a point; a taught keyframe stays one.

    During a drag only a posture close to the present one is searched for; where there is none, the arm stays
    at the last one. On release, others are tried, too.

    Args:
        position: where the tip should be, (3,) [m], world frame.
        start: the present posture, (nq,).
        final: whether it is to be accepted; else the drag continues.
        session: the session.
        keyframe: the one that is dragged; nothing is done if another was selected meanwhile. None: the one
            that is selected.
    """
    if keyframe is not None and keyframe != session.selected:
        return
    arm = session.arm
    limits = session.task.limits
    scene = session.task.effective_scene
    try:
        position = edits.into_plane(arm, position)
        state = reach_from(arm, position, start, scene, limits)
        if state is None and final:
            state = reach(arm, position, scene=scene, limits=limits, budget=1.0)[0]
        if state is None:
            raise ReachError(
                position, "no clear posture is close to the present one; release the tip to search for others"
            )
        edit = edits.taught(session.selected, state.q)
        if session.keyframe.curve is not None:
            edit = with_posture_curve(arm, session.selected, state.q)
    except PostureError as error:
        if final:
            session.proposal = None
            session.say(str(error), "error")
            session.touch()
        elif session.notice.text != " ".join(str(error).split()):
            session.say(str(error), "warning")
        return
    at = ", ".join(f"{coordinate:.4g}" for coordinate in position)
    session.propose(edit, f"reached for ({at}) m", final)


def with_posture_curve(arm: Arm, index: int, q: Array) -> edits.Edit:
    """Give a keyframe, 0-based, a curve through all control points at a configuration (nq,).

    The curve begins at the base, and goes straight on a little behind the tip.

    Raises:
        CurveError: control points that coincide.
    """
    points = np.vstack([arm.chain.base, arm.at(q).points])
    ahead = (points[-1] - points[-2]) / np.linalg.norm(points[-1] - points[-2])
    more = edits.required_length(arm) - arm.length
    through = Curve.spline(np.vstack([points, points[-1] + more * ahead]), through=True)
    curve = Curve(through.knots, edits.rounded(through.coefficients), through.degree)
    joints = edits.joints_at(arm, q)
    return edits.with_keyframe(index, curve=curve, placement="as_is", roll=0.0, trim=True, joints=joints)


def arm_line(arm: Arm, q: Array) -> Array:
    """Return the line along an arm at a configuration (nq,), without repeated points, (p, 3) [m]."""
    line = backbone(arm, q)
    apart = np.linalg.norm(np.diff(line, axis=0), axis=1) > 1e-6 * arm.length
    return np.asarray(line[np.append(True, apart)])


def draw_curve(session: Session) -> None:
    """Propose a curve through the posture of the selected keyframe, in place of a taught configuration."""
    index = session.selected
    keyframe = session.keyframe
    if keyframe.curve is not None:
        session.say(f"keyframe {index + 1} already has a curve", "warning")
        return
    edit = with_posture_curve(session.arm, index, edits.configuration_of(session.arm, keyframe))
    session.propose(edit, f"drew a curve through keyframe {index + 1}")


def teach(q: Array, session: Session) -> None:
    """Teach the selected keyframe a configuration (nq,), in place of its curve if it has one."""
    index = session.selected
    session.edit(edits.taught(index, q), f"taught keyframe {index + 1} the present posture")


def add_taught(q: Array, session: Session) -> None:
    """Add a keyframe after the selected one, taught a configuration (nq,)."""
    index = session.selected

    def edit(task: Task) -> Task:
        return edits.taught(index + 1, q)(edits.added(index)(task))

    session.edit(edit, f"added keyframe {index + 2}, taught the present posture", select=index + 1)


def hold_tip(session: Session) -> None:
    """Select the tip, instead of a control point or an obstacle."""
    session.take_hold(None)
    session.obstacle = None
    session.tip = True
