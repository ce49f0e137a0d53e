"""Module templates: what one module of an arm is made of, as data.

At zero joint positions a module stretches along +x of its base. Joint i is followed by link i, which lies
along the local x axis; the next joint sits at the end of that link. An RyRz module is thus a joint about y,
a link l1, a joint about z and a link l2, whose end is the posture control point of the module (6.1).
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any

from pinposture.errors import InvalidValue, UnknownName

JOINT_TYPES = ("revolute", "prismatic", "continuous")

_UNIT_VECTORS = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}
_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_.-]*")
_FULL_TURN = (-math.pi, math.pi)
_NO_LIMITS = (-math.inf, math.inf)


@dataclass(frozen=True)
class JointSpec:
    """One joint of a module.

    Attributes:
        axis: "x", "y" or "z", or any vector (3,) that is not zero; in the frame of the link before the joint.
        type: "revolute", "prismatic" or "continuous" (revolute without limits).
        lower: smallest position [rad], or [m] if prismatic; -inf if continuous.
        upper: largest position [rad], or [m] if prismatic; inf if continuous.
        velocity: largest speed [rad/s], or [m/s] if prismatic; the default is a placeholder.
        effort: largest torque [N m], or force [N] if prismatic; the default is a placeholder.

    Raises:
        InvalidValue: a value other than described, or a prismatic joint without limits of its own.
    """

    axis: str | Sequence[float]
    type: str = "revolute"
    lower: float = -math.pi
    upper: float = math.pi
    velocity: float = 2.0
    effort: float = 100.0

    def __post_init__(self) -> None:
        if self.type not in JOINT_TYPES:
            raise InvalidValue("joint type", self.type, ", ".join(JOINT_TYPES))
        if not isinstance(self.axis, str):
            object.__setattr__(self, "axis", _axis_vector(self.axis))
        elif self.axis not in _UNIT_VECTORS:
            raise InvalidValue("joint axis", self.axis, "'x', 'y', 'z' or three numbers")
        self._settle_limits()
        for name in ("velocity", "effort"):
            value = _number(name, getattr(self, name), "a finite number above 0", lowest=math.ulp(0.0))
            object.__setattr__(self, name, value)

    def _settle_limits(self) -> None:
        if self.type == "continuous":
            if (self.lower, self.upper) not in (_FULL_TURN, _NO_LIMITS):
                given = (self.lower, self.upper)
                raise InvalidValue("limits of a continuous joint", given, "none; a revolute joint has limits")
            lower, upper = _NO_LIMITS
        else:
            if self.type == "prismatic" and (self.lower, self.upper) == _FULL_TURN:
                raise InvalidValue("limits of a prismatic joint", None, "lower= and upper= [m], both given")
            lower = _number("lower", self.lower, "a finite number")
            upper = _number("upper", self.upper, "a finite number")
            if lower >= upper:
                raise InvalidValue("joint limits", (lower, upper), "lower < upper")
        object.__setattr__(self, "lower", lower)
        object.__setattr__(self, "upper", upper)

    @property
    def direction(self) -> tuple[float, float, float]:
        """Unit vector along the axis, (3,), in the frame of the link before the joint."""
        if isinstance(self.axis, str):
            return _UNIT_VECTORS[self.axis]
        x, y, z = self.axis
        return x, y, z


@dataclass(frozen=True)
class ModuleTemplate:
    """What one module is made of; make a new kind by writing one down.

        ModuleTemplate(
            "RxRyP",
            joints=(JointSpec("x"), JointSpec("y"), JointSpec("x", type="prismatic", lower=0.0, upper=0.05)),
            link_lengths=(0.0, 0.02, 0.03),
        )

    Attributes:
        name: what the template is called: letters, digits, "_", "-" and ".", beginning with a letter or "_".
        joints: the joints from base to end, (n,).
        link_lengths: length of the link that follows each joint, (n,) [m]; 0 puts two joints in one place.
        radius: radius of the links and of the joints between them [m].

    Raises:
        InvalidValue: no joints, not one length for each joint, or a value other than described.
    """

    name: str
    joints: Sequence[JointSpec]
    link_lengths: Sequence[float]
    radius: float = 0.01

    def __post_init__(self) -> None:
        if not isinstance(self.name, str) or not _NAME.fullmatch(self.name):
            raise InvalidValue("template name", self.name, "letters, digits, _ - . and a letter or _ first")
        joints = _items(self.joints, "joints", "a sequence of JointSpec")
        if not joints or not all(isinstance(joint, JointSpec) for joint in joints):
            raise InvalidValue("joints", self.joints, "at least one JointSpec, and nothing else")
        allowed = f"{len(joints)} lengths [m], one for each joint"
        lengths = _items(self.link_lengths, "link_lengths", allowed)
        if len(lengths) != len(joints):
            raise InvalidValue("link_lengths", self.link_lengths, allowed)
        # Outside these bounds the inertia of a link would in the end under- or overflow.
        checked = tuple(
            _number(f"link_lengths[{i}]", length, "0 to 1e6 m", lowest=0.0, highest=1e6)
            for i, length in enumerate(lengths)
        )
        radius = _number("radius", self.radius, "1e-6 to 1e6 m", lowest=1e-6, highest=1e6)
        object.__setattr__(self, "joints", joints)
        object.__setattr__(self, "link_lengths", checked)
        object.__setattr__(self, "radius", radius)

    @property
    def length(self) -> float:
        """Length of the module when it is straight [m]."""
        return math.fsum(self.link_lengths)

    def with_lengths(self, link_lengths: Sequence[float]) -> ModuleTemplate:
        """The same module with other link lengths.

        Args:
            link_lengths: length of the link that follows each joint, (n,) [m].

        Raises:
            InvalidValue: not one length of 0 to 1e6 m for each joint.
        """
        return replace(self, link_lengths=link_lengths)

    def with_limits(self, lower: float, upper: float) -> ModuleTemplate:
        """The same module with other limits on each of its revolute joints; other joints keep theirs.

        Args:
            lower: smallest position [rad].
            upper: largest position [rad].

        Raises:
            InvalidValue: not finite, or not lower < upper.
        """
        joints = (replace(j, lower=lower, upper=upper) if j.type == "revolute" else j for j in self.joints)
        return replace(self, joints=tuple(joints))


def _number(
    name: str, value: Any, allowed: str, lowest: float = -math.inf, highest: float = math.inf
) -> float:
    """A finite number within bounds, as a plain float and never -0.0."""
    try:
        number = math.nan if isinstance(value, (bool, str, bytes)) else float(value) + 0.0
    except (TypeError, ValueError, OverflowError):
        number = math.nan
    if not math.isfinite(number) or not lowest <= number <= highest:
        raise InvalidValue(name, value, allowed)
    return number


def _items(values: Any, name: str, allowed: str) -> tuple[Any, ...]:
    if isinstance(values, (str, bytes)):
        raise InvalidValue(name, values, allowed)
    try:
        return tuple(values)
    except TypeError:
        raise InvalidValue(name, values, allowed) from None


def _axis_vector(axis: Any) -> tuple[float, float, float]:
    allowed = "'x', 'y', 'z' or three finite numbers, not all 0"
    vector = [_number("joint axis", value, allowed) for value in _items(axis, "joint axis", allowed)]
    largest = max(map(abs, vector), default=0.0)
    if len(vector) != 3 or largest == 0.0:
        raise InvalidValue("joint axis", axis, allowed)
    x, y, z = (value / largest for value in vector)  # so that no square over- or underflows
    norm = math.hypot(x, y, z)
    return x / norm, y / norm, z / norm


def _planar(name: str) -> ModuleTemplate:
    joints = name.count("R")
    return ModuleTemplate(name, (JointSpec("z"),) * joints, (0.15,) * joints, radius=0.02)


TEMPLATES: Mapping[str, ModuleTemplate] = MappingProxyType(
    {
        "RyRz": ModuleTemplate("RyRz", (JointSpec("y"), JointSpec("z")), (0.025, 0.025)),
        "RzRy": ModuleTemplate("RzRy", (JointSpec("z"), JointSpec("y")), (0.025, 0.025)),
        "Rz": _planar("Rz"),
        "RzRz": _planar("RzRz"),
        "RzRzRz": _planar("RzRzRz"),
    }
)
"""The templates that ship, by name. The spatial ones reach in space, those of "Rz" alone in a plane."""


def template(name: str) -> ModuleTemplate:
    """Look up a template that ships.

    Args:
        name: for instance "RyRz".

    Raises:
        UnknownName: there is no such template.
    """
    if not isinstance(name, str) or name not in TEMPLATES:
        raise UnknownName("template", name, TEMPLATES)
    return TEMPLATES[name]
