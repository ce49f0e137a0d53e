"""One joint of a robot description: its fields, and everything that can be wrong with them."""

from __future__ import annotations

import math
import re
import xml.etree.ElementTree as ET
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

from pinposture.errors import URDFError

Vector = tuple[float, float, float]
Fault = Callable[[str], URDFError]

CHAIN_JOINTS = ("revolute", "continuous", "prismatic")
JOINT_TYPES = (*CHAIN_JOINTS, "fixed", "floating", "planar")

# What Pinocchio takes for a number; Python alone would take "1_0" and "inf" as well.
_NUMBER = re.compile(r"[ \t\r\n]*[+-]?([0-9]+(\.[0-9]*)?|\.[0-9]+)([eE][+-]?[0-9]+)?")
_INFINITE = re.compile(r"\+?inf(inity)?", re.IGNORECASE)
# The parts of a joint that hold numbers: attributes that must be there, and those that may.
_PARTS: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "limit": (("effort", "velocity"), ("lower", "upper")),
    "safety_controller": (("k_velocity",), ("soft_lower_limit", "soft_upper_limit", "k_position")),
    "calibration": ((), ("rising", "falling")),
    "dynamics": ((), ("damping", "friction")),
    "mimic": ((), ("multiplier", "offset")),
}


class Follows(NamedTuple):
    """What <mimic> says: position = multiplier * position of another joint + offset.

    Attributes:
        joint: name of the joint that is followed.
        multiplier: factor of its position; 1 if not given.
        offset: added to it [rad or m]; 0 if not given.
    """

    joint: str
    multiplier: float
    offset: float


@dataclass(frozen=True)
class JointDescription:
    """A joint as the description has it.

    Attributes:
        name: its name.
        type: one of `JOINT_TYPES`.
        parent: the link before it.
        child: the link after it.
        origin: where the joint sits in the frame of the link before it, (3,) [m].
        rpy: how its frame is turned there: roll, pitch, yaw, (3,) [rad].
        axis: unit vector, (3,), in the frame of the joint; x if the description gives none.
        lower: smallest position [rad or m]; -inf without limits, 0 if fixed.
        upper: largest position [rad or m]; inf without limits, 0 if fixed.
        velocity: largest speed [rad/s or m/s], may be infinite; None without <limit>.
        follows: how it follows another joint; None if it moves by itself.
    """

    name: str
    type: str
    parent: str
    child: str
    origin: Vector
    rpy: Vector
    axis: Vector
    lower: float
    upper: float
    velocity: float | None
    follows: Follows | None

    @property
    def mimic(self) -> bool:
        """True if it follows another joint."""
        return self.follows is not None

    @property
    def moves(self) -> bool:
        """False if it is fixed, or if its limits leave it a single position."""
        return self.lower < self.upper


def read_joint(element: ET.Element, source: str) -> JointDescription:
    """Read and check a <joint> that has a name.

    Args:
        element: the XML element.
        source: what to call the description in messages.

    Raises:
        URDFError: a field is missing or cannot be used.
    """
    name, kind = element.get("name", ""), element.get("type")
    fault = partial(URDFError, source, f"joint {name!r}")
    if kind not in JOINT_TYPES:
        raise fault(f"type is {kind!r}; allowed: {', '.join(JOINT_TYPES)}")
    if name == "universe" and kind != "fixed":
        raise fault("has the name that Pinocchio gives to the world; rename it")
    parent, child = _end(element, "parent", fault), _end(element, "child", fault)
    if parent == child:
        raise fault(f"has link {parent!r} for its parent and for its child")
    origin = _vector(element, "origin", "xyz", (0.0, 0.0, 0.0), fault)
    rpy = _vector(element, "origin", "rpy", (0.0, 0.0, 0.0), fault)
    axis: Vector = (1.0, 0.0, 0.0)
    if kind not in ("fixed", "floating"):
        axis = _unit(_vector(element, "axis", "xyz", axis, fault), fault)
    numbers = {tag: _part(element, tag, fault) for tag in _PARTS}
    lower, upper = _limits(kind, numbers["limit"], fault)
    velocity = (numbers["limit"] or {}).get("velocity")
    follows, mimic = None, element.find("mimic")
    if mimic is not None:
        given = {"multiplier": 1.0, "offset": 0.0, **(numbers["mimic"] or {})}
        follows = Follows(mimic.attrib["joint"], **given)
    return JointDescription(name, kind, parent, child, origin, rpy, axis, lower, upper, velocity, follows)


def _end(element: ET.Element, role: str, fault: Fault) -> str:
    end = element.find(role)
    link = "" if end is None else end.get("link", "")
    if not link:
        raise fault(f'names no {role} link; allowed: <{role} link="..."/>')
    return link


def _number(text: str, what: str, fault: Fault) -> float:
    number = float(text) if _NUMBER.fullmatch(text) else math.nan
    if not math.isfinite(number):
        raise fault(f"{what} is {text[:40]!r}; allowed: a finite number, no blank after it")
    return number


def _vector(element: ET.Element, tag: str, attribute: str, default: Vector, fault: Fault) -> Vector:
    part = element.find(tag)
    text = None if part is None else part.get(attribute)
    if text is None:
        return default
    what = f"<{tag}> {attribute}"
    numbers = [_number(piece, what, fault) for piece in text.split(" ") if piece]
    if len(numbers) != 3:
        raise fault(f"{what} is {text[:40]!r}; allowed: three numbers with blanks between them")
    if max(map(abs, numbers)) > 1e100:
        raise fault(f"{what} is {text[:40]!r}; allowed: numbers that can be squared")
    x, y, z = numbers
    return x, y, z


def _unit(vector: Vector, fault: Fault) -> Vector:
    norm = math.hypot(*vector)
    if norm < 1e-100:
        raise fault(f"<axis> xyz is {vector}; allowed: a vector that is not zero")
    x, y, z = vector
    return x / norm, y / norm, z / norm


def _part(element: ET.Element, tag: str, fault: Fault) -> dict[str, float] | None:
    part = element.find(tag)
    if part is None:
        return None
    required, optional = _PARTS[tag]
    for attribute in required:
        if attribute not in part.attrib:
            raise fault(f"<{tag}> has no {attribute}; it must have {' and '.join(required)}")
    if tag == "mimic" and "joint" not in part.attrib:
        raise fault("<mimic> names no joint")
    given = [attribute for attribute in required + optional if attribute in part.attrib]
    if tag == "dynamics" and not given:
        raise fault("<dynamics> has neither damping nor friction")
    return {
        name: math.inf
        if name in ("effort", "velocity") and _INFINITE.fullmatch(part.attrib[name])
        else _number(part.attrib[name], f"<{tag}> {name}", fault)
        for name in given
    }


def _limits(kind: str, limit: dict[str, float] | None, fault: Fault) -> tuple[float, float]:
    if kind == "fixed":
        return 0.0, 0.0
    for attribute in ("effort", "velocity"):
        if limit and limit[attribute] < 0.0:
            raise fault(f"<limit> {attribute} is {limit[attribute]}; allowed: 0 or more")
    if kind not in ("revolute", "prismatic"):
        return -math.inf, math.inf
    if limit is None:
        free = "; a joint that turns for ever is continuous" if kind == "revolute" else ""
        raise fault(f"is {kind} and has no <limit>{free}")
    if "lower" not in limit and "upper" not in limit:
        return -math.inf, math.inf
    lower, upper = limit.get("lower", 0.0), limit.get("upper", 0.0)
    if lower > upper:
        raise fault(f"<limit> lower is {lower} and upper {upper}; allowed: lower <= upper (0 if not given)")
    return lower, upper
