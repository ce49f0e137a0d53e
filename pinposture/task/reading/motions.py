"""What a task file says of the motion: keyframes, or the path that the leader takes."""

from __future__ import annotations

from collections.abc import Mapping
from difflib import get_close_matches
from pathlib import Path
from typing import Any

from pinposture.arm import Arm
from pinposture.arm.ellipsoid import chosen_points
from pinposture.control import EndEffector
from pinposture.curve import Curve
from pinposture.target.resolve import METHODS, PLACEMENTS
from pinposture.task.keyframe import Keyframe
from pinposture.task.leader import MOST, Leader
from pinposture.task.leader import PLACEMENTS as ENTRIES
from pinposture.task.reading.arms import placement_in_si, read_placement
from pinposture.task.reading.document import Table
from pinposture.task.reading.showing import shown
from pinposture.task.sliding_window import METHODS as WINDOWS
from pinposture.thesis.curves import CURVES

_KEYFRAME = (
    "name",
    "curve",
    "time",
    "duration",
    "hold",
    "placement",
    "roll",
    "method",
    "trim",
    "region",
    "tip",
    "joints",
)
_TIP = ("position", "rotation", "point", "weight", "strict", "axis_only", "length")
_LEADER = ("path", "speed", "depth", "placement", "method", "and_back", "pipe")
_QUANTITIES = {
    **dict.fromkeys(("radius", "pitch", "smoothing", "a", "b", "center"), "length"),
    "phase": "angle",
}


def read_keyframes(tables: list[Table], usual: str, arm: Arm) -> tuple[Keyframe, ...]:
    """The keyframes, each checked by itself; `usual` is how curves are laid where the file does not say."""
    return tuple(_keyframe(table, usual, arm) for table in tables)


def _keyframe(table: Table, usual: str, arm: Arm) -> Keyframe:
    table.only(*_KEYFRAME)
    region = table.value("region", None)
    if region is not None:
        count = isinstance(region, list) and len(region) == 2
        if not (count and all(isinstance(each, int) and not isinstance(each, bool) for each in region)):
            allowed = "two whole numbers: the first and the last control point, counted from 1 at the base"
            raise table.fault("region", f"is {shown(region)}; allowed: {allowed}")
        if not 1 <= region[0] <= region[1]:
            raise table.fault("region", f"is {region}; allowed: 1 or more, the last not before the first")
        region = (region[0] - 1, region[1] - 1)
    values: dict[str, Any] = {
        "name": table.text("name", ""),
        "time": table.quantity("time", "time", default=None),
        "duration": table.quantity("duration", "time", default=None),
        "hold": table.quantity("hold", "time", default=0.0),
        "placement": table.text("placement", usual, PLACEMENTS),
        "roll": table.quantity("roll", "angle", default=0.0),
        "method": table.text("method", "auto", METHODS),
        "trim": table.flag("trim", False),
        "region": region,
        "joints": _read_joints(table, arm),
        "tip": read_tip(table.table("tip")) if "tip" in table else None,
    }
    curve = read_curve(table, "curve")
    with table.blaming():
        return Keyframe(curve, **values)


def _read_joints(table: Table, arm: Arm) -> list[float] | None:
    """Joint positions near which a posture is taken; those of another arm are read, and ignored later."""
    listed = table.value("joints", None)
    if not isinstance(listed, list):
        return None if listed is None else table.quantities("joints", ["angle"] * arm.nv)  # which raises
    own = ["length" if slides else "angle" for slides in arm.slides]
    kinds = own if len(listed) == len(own) else ["angle"] * len(listed)
    positions: list[float] = table.quantities("joints", kinds)
    return positions


def read_tip(table: Table) -> EndEffector:
    """What is asked of the tip, or of another control point."""
    table.only(*_TIP)
    point = table.value("point", -1)
    if not isinstance(point, str):
        if isinstance(point, bool) or not isinstance(point, int) or point == 0:
            allowed = "1 or more, counted from the base; -1 or less, counted from the tip; or a name"
            raise table.fault("point", f"is {shown(point)}; allowed: {allowed}")
        point -= point > 0  # the library counts from 0
    if "position" not in table:
        raise table.fault(None, "the key 'position' is missing; 'rotation' goes with it, if it matters")
    where = read_placement(table.part("position", "rotation"))
    options = {
        "point": point,
        "weight": table.number("weight", 1.0),
        "strict": table.flag("strict", False),
        "axis_only": table.flag("axis_only", False),
        "length": table.above_zero("length", "length", default=None),
    }
    place = {"pose": where} if "rotation" in table else {"position": where.translation}
    with table.blaming():
        tip = EndEffector(**place, **options)
    plain = placement_in_si(table)
    if "length" in table:
        plain["length"] = tip.length
    return table.says(tip, plain)


def check_points(table: Table, keyframe: Keyframe, arm: Arm) -> None:
    """Refuse control points of a keyframe that the arm does not have."""
    m = arm.n_modules
    if keyframe.region is not None and keyframe.region[1] >= m:
        raise table.fault("region", f"is {table.value('region')}; the arm has control points 1 to {m}")
    if keyframe.tip is not None:
        point, tip = keyframe.tip.point, table.table("tip")
        if isinstance(point, str):
            with tip.blaming("point"):
                chosen_points(arm.control_points, point)
        elif not -m <= point < m:
            allowed = f"1 to {m} from the base, -1 to -{m} from the tip, or a name"
            raise tip.fault("point", f"is {tip.value('point')}; allowed: {allowed}")


def read_curve(table: Table, key: str) -> Curve:
    """A curve: a preset, a file, or a description as in `Curve.from_dict`."""
    value = table.value(key)
    if isinstance(value, str):
        if value in CURVES:
            return table.says(CURVES[value], value)
        if not Path(value).suffix:
            close = get_close_matches(value, CURVES, n=1)
            hint = f" (did you mean {close[0]!r}?)" if close else ""
            allowed = f"{', '.join(CURVES)}, a .json, .csv or .txt file, or a table with a type"
            raise table.fault(key, f"is {shown(value)}{hint}; allowed: {allowed}")
        return table.says(table.file(key, Curve.load), table.place(key, value))
    if not isinstance(value, Mapping):
        raise table.fault(key, f"is {shown(value)}; allowed: a name, a file, or a table with a type")
    described = table.table(key)
    plain = described.in_si(_QUANTITIES)
    with described.blaming():
        return table.says(Curve.from_dict(plain), plain)


def read_leader(table: Table, usual: str) -> Leader:
    """What the leader does; `usual` is how its path is laid where the file does not say."""
    table.only(*_LEADER)
    return Leader(
        path=read_curve(table, "path"),
        speed=table.above_zero("speed", "speed"),
        depth=table.above_zero("depth", "length", default=None),
        placement=table.text("placement", usual, ENTRIES),
        method=table.text("method", "closest", tuple(WINDOWS)),
        and_back=table.flag("and_back", False),
        pipe=table.above_zero("pipe", "length", default=None),
    )


def check_path(table: Table, leader: Leader, arm: Arm) -> None:
    """Refuse sizes that are beside all reason for the arm, and would take hours to find that out."""
    longest, narrowest = MOST * arm.length, arm.length / MOST
    if leader.path.length > longest:
        reason = f"is {leader.path.length:.4g} m long; allowed: {longest:.4g} m, {MOST} times the arm"
        raise table.fault("path", reason)
    if leader.pipe is not None and leader.pipe < narrowest:
        allowed = f"{narrowest:.4g} m or more, 1/{MOST} of the arm"
        raise table.fault("pipe", f"is {shown(table.value('pipe'))}; allowed: {allowed}")
