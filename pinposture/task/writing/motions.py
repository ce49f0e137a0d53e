"""What stands in a task file for keyframes, or for the path that the leader takes."""

from __future__ import annotations

from typing import Any

import pinocchio as pin

from pinposture.control import EndEffector
from pinposture.curve import Curve
from pinposture.errors import PostureError
from pinposture.task.keyframe import Keyframe
from pinposture.task.leader import Leader
from pinposture.task.reading.motions import read_curve, read_tip
from pinposture.task.writing.placements import roll_pitch_yaw
from pinposture.task.writing.wording import Wording

_USUAL: dict[str, Any] = {"trim": False, "roll": 0.0, "method": "auto"}
_OF_A_LEADER: dict[str, Any] = {
    "depth": None,
    "method": "closest",
    "and_back": False,
    "pipe": None,
}
_OF_A_TIP: dict[str, Any] = {"weight": 1.0, "strict": False, "axis_only": False, "length": None}


def write_keyframe(keyframe: Keyframe, usual: str, wording: Wording) -> dict[str, Any]:
    """A table for a keyframe, without what is as usual; `usual` is how its curve would be laid."""
    described: dict[str, Any] = {}
    if keyframe.name:
        described["name"] = keyframe.name
    for key in ("time", "duration"):
        if getattr(keyframe, key) is not None:
            described[key] = getattr(keyframe, key)
    if keyframe.hold:
        described["hold"] = keyframe.hold
    described["curve"] = write_curve(keyframe.curve, "curve", wording)
    described |= _unusual(keyframe, {"placement": usual, **_USUAL})
    if keyframe.region is not None:
        described["region"] = [end + 1 for end in keyframe.region]
    if keyframe.joints is not None:
        described["joints"] = list(keyframe.joints)
    if keyframe.tip is not None:
        described["tip"] = _write_tip(keyframe.tip, wording)
    return described


def write_leader(leader: Leader, usual: str, wording: Wording) -> dict[str, Any]:
    """A table for what the leader does, without what is as usual; `usual` is how its path would be laid."""
    described: dict[str, Any] = {"path": write_curve(leader.path, "path", wording), "speed": leader.speed}
    return described | _unusual(leader, {"placement": usual, **_OF_A_LEADER})


def write_curve(curve: Curve, key: str, wording: Wording) -> Any:
    """A curve as it was described, or by its control points, or by its knots and coefficients."""
    told = wording.told(curve, key, lambda table: read_curve(table, key))
    if told is not None:
        return told
    points = curve.control_points
    if points is not None:
        listed = points.tolist()
        described: dict[str, Any] = {"type": "spline", "control_points": listed, "degree": curve.degree}
        if curve.degree == 1 and len(listed) == 2:
            described = {"type": "line", "a": listed[0], "b": listed[1]}
        if _gives(described, curve):
            if curve.degree == 3:
                del described["degree"]
            return described
    return curve.to_dict()


def _gives(described: dict[str, Any], curve: Curve) -> bool:
    """Whether a description gives a curve back to the last bit; points may be too close, knots rounded."""
    try:
        return Curve.from_dict(described) == curve
    except PostureError:
        return False


def _write_tip(tip: EndEffector, wording: Wording) -> Any:
    told = wording.told(tip, "tip", lambda table: read_tip(table.table("tip")))
    if told is not None:
        return told
    described: dict[str, Any] = {}
    if tip.pose is None:
        described["position"] = tip.position
    else:
        pose = pin.SE3(tip.pose)
        described |= {"position": pose.translation, "rotation": roll_pitch_yaw(pose.rotation)}
    if tip.point != -1:
        counted = isinstance(tip.point, int) and tip.point >= 0
        described["point"] = tip.point + 1 if counted else tip.point  # type: ignore[operator]
    return described | _unusual(tip, _OF_A_TIP)


def _unusual(whole: object, usual: dict[str, Any]) -> dict[str, Any]:
    """Attributes that are not as usual."""
    values = {key: getattr(whole, key) for key in usual}
    return {key: value for key, value in values.items() if value != usual[key]}
