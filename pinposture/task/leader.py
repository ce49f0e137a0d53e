"""What following the leader is asked for."""

from __future__ import annotations

from typing import Any, NamedTuple

from pinposture.arm import Arm
from pinposture.control.checks import require_positive
from pinposture.curve import Curve
from pinposture.errors import InvalidValue, UnknownName
from pinposture.task.sliding_window import METHODS

PLACEMENTS = ("align", "as_is")
"""How a path may be put to the tip of the arm."""

MOST = 1000
"""How many arms long a path is at most, and how many pipe radii an arm."""


class Leader(NamedTuple):
    """What `follow_leader` is asked for.

    Attributes:
        path: where the tip goes.
        speed: largest speed of the feed [m/s].
        depth: how far to go in [m]; None: to the end.
        placement: as for `follow_leader`; None for what `usual_placement` says of the scene.
        method: as for `follow_leader`.
        and_back: whether to come out again.
        pipe: radius of the pipe around the path, in which the arm has to stay [m]; None: there is none.
    """

    path: Curve
    speed: float
    depth: float | None = None
    placement: Any = None
    method: Any = "closest"
    and_back: bool = False
    pipe: float | None = None


def check_leader(leader: Leader, arm: Arm) -> None:
    """Refuse what makes no motion, and sizes that are beside all reason for the arm.

    Raises:
        InvalidValue: names the attribute.
        UnknownName: a `placement` or `method` that does not exist.
    """
    if not isinstance(leader.path, Curve):
        raise InvalidValue("path", leader.path, "a Curve")
    require_positive("speed", leader.speed)
    for name in ("depth", "pipe"):
        if getattr(leader, name) is not None:
            require_positive(name, getattr(leader, name))
    for name, allowed in (("placement", PLACEMENTS), ("method", tuple(METHODS))):
        if getattr(leader, name) not in allowed and not (name == "placement" and leader.placement is None):
            raise UnknownName(name, getattr(leader, name), allowed)
    if not isinstance(leader.and_back, bool):
        raise InvalidValue("and_back", leader.and_back, "True or False")
    if leader.path.length > MOST * arm.length:
        longest = f"{MOST * arm.length:.4g} m, {MOST} times the arm"
        raise InvalidValue("length of the path [m]", leader.path.length, longest)
    if leader.pipe is not None and leader.pipe < arm.length / MOST:
        raise InvalidValue("pipe", leader.pipe, f"{arm.length / MOST:.4g} m or more, 1/{MOST} of the arm")
