"""What a line of JSON says of where the joints of an arm are."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pinposture.arm import Arm
from pinposture.arm.configurations import UNLIMITED
from pinposture.errors import InvalidValue

Array = NDArray[np.float64]

ALLOWED = 'an object: {"name": [...], "position": [...]}, {"position": [...]} of all joints, or {"q": [...]}'
_SECONDS = (("sec", "nanosec"), ("secs", "nsecs"))  # as ROS 2 writes a time, and ROS 1


class Told(NamedTuple):
    """What a line says.

    Attributes:
        columns: the degrees of freedom that it tells of, (k,); none, if it tells of none of this arm.
        positions: where these are, (k,) [rad or m].
        unknown: names of joints that the arm has not.
        stamp: when that was, by the clock of who wrote it [s]; None if it does not say.
    """

    columns: NDArray[np.intp]
    positions: Array
    unknown: tuple[str, ...]
    stamp: float | None


class JointLines:
    """Reads lines for an arm.

    Attributes:
        columns: degree of freedom of each joint that has one, by its name.
    """

    def __init__(self, arm: Arm) -> None:
        self._arm, self._all = arm, np.arange(arm.nv)
        joints = zip(list(arm.model.joints)[1:], list(arm.model.names)[1:], strict=True)
        self.columns = {str(name): int(joint.idx_v) for joint, name in joints if joint.nv == 1}

    def read(self, line: bytes) -> Told:
        """What a line says; whatever else a message has, velocities for instance, is not looked at.

        Raises:
            InvalidValue: it is no such line; names what is wrong and what is allowed.
        """
        try:
            said = json.loads(line.decode("utf-8-sig"))
        except json.JSONDecodeError as error:
            raise InvalidValue(
                f"the line ({error.msg}, column {error.colno})", _text(line), ALLOWED
            ) from None
        except (ValueError, RecursionError):  # no UTF-8, a number of thousands of digits, lists without end
            raise InvalidValue("the line", _text(line), ALLOWED) from None
        if not isinstance(said, dict) or not {"position", "q"} & said.keys():
            raise InvalidValue("the line", said, ALLOWED)
        if {"position", "q"} <= said.keys():
            raise InvalidValue("the line", "both position and q", "one of them")
        stamp = _stamp(said)
        if "q" in said:
            q = self._arm.checked(_numbers("q", said["q"], self._arm.nq), "q")
            return Told(self._all, self._arm.positions(q), (), stamp)
        if "name" not in said:
            positions = _numbers("position", said["position"], self._arm.nv)
            return Told(self._all, np.array(positions), (), stamp)
        return self._named(said["name"], said["position"], stamp)

    def _named(self, names: Any, positions: Any, stamp: float | None) -> Told:
        if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
            raise InvalidValue("name", names, "a list of names of joints")
        if len(set(names)) < len(names):
            twice = next(name for name in names if names.count(name) > 1)
            raise InvalidValue("name", twice, "each joint once")
        if positions == []:  # a message may tell velocities alone
            names = []
        positions = _numbers("position", positions, len(names))
        known = [(self.columns[name], k) for k, name in enumerate(names) if name in self.columns]
        columns = np.array([column for column, _ in known], dtype=np.intp)
        unknown = tuple(name for name in names if name not in self.columns)
        return Told(columns, np.array([positions[k] for _, k in known]), unknown, stamp)


def _numbers(name: str, values: Any, count: int) -> list[float]:
    """So many finite numbers."""
    if not isinstance(values, list):
        raise InvalidValue(name, values, f"a list of {count} numbers")
    if len(values) != count:
        raise InvalidValue(f"{name} (length)", len(values), f"{count}")
    for k, value in enumerate(values):
        # NaN is in no order to anything; a truth value is no number here.
        if type(value) not in (float, int) or not -UNLIMITED <= value <= UNLIMITED:
            raise InvalidValue(f"{name}[{k}]", value, f"a finite number within {UNLIMITED:g} either way")
    return [float(value) for value in values]


def _stamp(said: Mapping[str, Any]) -> float | None:
    """When a line says that it was: as `time` or `stamp`, or in the header that messages of ROS have."""
    header = said.get("header")
    for name, value in (
        ("time", said.get("time")),
        ("stamp", said.get("stamp")),
        ("header.stamp", header.get("stamp") if isinstance(header, dict) else None),
    ):
        if value is None:
            continue
        parts = [value, 0]
        if isinstance(value, dict):
            parts = next(([value[s], value[ns]] for s, ns in _SECONDS if {s, ns} <= value.keys()), [None])
        if all(type(part) in (float, int) and -1e18 < part < 1e18 for part in parts):
            return float(parts[0]) + 1e-9 * float(parts[1])
        raise InvalidValue(name, value, "seconds, or an object with sec and nanosec")
    return None


def _text(line: bytes) -> str:
    return line[:200].decode("utf-8", "replace")
