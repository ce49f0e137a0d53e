"""What a task file says of the motion: keyframes, or the path that the leader takes."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from pinposture.control import EndEffector
from pinposture.curve import Curve
from pinposture.target.resolve import METHODS, PLACEMENTS
from pinposture.task.keyframe import Keyframe
from pinposture.task.reading.document import Table
from pinposture.task.reading.robots import read_placement
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
)
_TIP = ("position", "rotation", "point", "weight", "strict", "axis_only")
_LEADER = ("path", "speed", "depth", "placement", "method", "and_back", "pipe")
_LENGTHS, _ANGLES = ("radius", "pitch", "smoothing"), ("phase",)


class Leader(NamedTuple):
    """What `follow_leader` is asked for.

    Attributes:
        path: where the tip goes.
        speed: largest speed of the feed [m/s].
        depth: how far to go in [m]; None: to the end.
        placement: as for `follow_leader`.
        method: as for `follow_leader`.
        and_back: whether to come out again.
        pipe: radius of the pipe around the path, in which the arm has to stay [m]; None: there is none.
    """

    path: Curve
    speed: float
    depth: float | None
    placement: Any
    method: Any
    and_back: bool
    pipe: float | None


def read_keyframes(tables: list[Table]) -> tuple[Keyframe, ...]:
    """The keyframes, each checked by itself."""
    return tuple(_keyframe(table) for table in tables)


def _keyframe(table: Table) -> Keyframe:
    table.only(*_KEYFRAME)
    region = table.value("region", None)
    if region is not None:
        count = isinstance(region, list) and len(region) == 2
        if not (count and all(isinstance(each, int) and not isinstance(each, bool) for each in region)):
            allowed = "two whole numbers: the first and the last control point, counted from 1 at the base"
            raise table.fault("region", f"is {region!r}; allowed: {allowed}")
        if not 1 <= region[0] <= region[1]:
            raise table.fault("region", f"is {region!r}; allowed: 1 or more, the last not before the first")
        region = (region[0] - 1, region[1] - 1)
    values: dict[str, Any] = {
        "name": table.text("name", ""),
        "time": table.quantity("time", "time", default=None),
        "duration": table.quantity("duration", "time", default=None),
        "hold": table.quantity("hold", "time", default=0.0),
        "placement": table.text("placement", "align", PLACEMENTS),
        "roll": table.quantity("roll", "angle", default=0.0),
        "method": table.text("method", "auto", METHODS),
        "trim": table.flag("trim", False),
        "region": region,
        "tip": _tip(table.table("tip")) if "tip" in table else None,
    }
    curve = read_curve(table, "curve")
    with table.blaming():
        return Keyframe(curve, **values)


def _tip(table: Table) -> EndEffector:
    """What is asked of the tip, or of another control point."""
    table.only(*_TIP)
    point = table.value("point", -1)
    if isinstance(point, int) and not isinstance(point, bool) and point > 0:
        point -= 1  # counted from 1 at the base, as everywhere in these files
    options = {
        "point": point,
        "weight": table.number("weight", 1.0),
        "strict": table.flag("strict", False),
        "axis_only": table.flag("axis_only", False),
    }
    where = read_placement(table.part("position", "rotation"))
    with table.blaming():
        if "rotation" in table:
            return EndEffector(pose=where, **options)
        return EndEffector(position=table.quantities("position", 3, "length"), **options)


def read_curve(table: Table, key: str) -> Curve:
    """A curve: a preset, a file, or a description as in `Curve.from_dict`."""
    value = table.value(key)
    if isinstance(value, str):
        if value in CURVES:
            return CURVES[value]
        if not Path(value).suffix:
            allowed = f"{', '.join(CURVES)}, a .json, .csv or .txt file, or a table with a type"
            raise table.fault(key, f"is {value!r}; allowed: {allowed}")
        return table.file(key, Curve.load)
    if not isinstance(value, Mapping):
        raise table.fault(key, f"is {value!r}; allowed: a name, a file, or a table with a type")
    described = table.table(key)
    plain = described.plain()
    for names, kind in ((_LENGTHS, "length"), (_ANGLES, "angle")):
        for name in names:
            if isinstance(plain.get(name), str):
                plain[name] = described.quantity(name, kind)
    with described.blaming():
        return Curve.from_dict(plain)


def read_leader(table: Table) -> Leader:
    """What the leader does."""
    table.only(*_LEADER)
    return Leader(
        path=read_curve(table, "path"),
        speed=table.quantity("speed", "speed"),
        depth=table.quantity("depth", "length", default=None),
        placement=table.text("placement", "align", ("align", "as_is")),
        method=table.text("method", "closest", tuple(WINDOWS)),
        and_back=table.flag("and_back", False),
        pipe=table.quantity("pipe", "length", default=None),
    )
