"""Control points on the command line: their numbers as pictures show them, from 1 at the base to the tip."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pinposture.errors import InvalidValue

if TYPE_CHECKING:
    from pinposture.arm import Arm


def read_region(name: str, text: str, arm: Arm) -> tuple[int, int]:
    """Indices, 0-based, of the first and the last control point of a region given as "first-last", 1-based.

    Args:
        name: the option, for the message.
        text: two numbers with a hyphen between them.
        arm: whose control points they are.

    Raises:
        InvalidValue: anything else, or numbers that are not in order or that no control point has.
    """
    first, hyphen, last = text.partition("-")
    if hyphen and first.strip().isdecimal() and last.strip().isdecimal():
        begin, end = int(first) - 1, int(last) - 1
        if 0 <= begin <= end < arm.n_modules:
            return begin, end
    allowed = f"two numbers of control points from 1 to {arm.n_modules}, in order, as in 1-{arm.n_modules}"
    raise InvalidValue(name, text, allowed)


def read_points(name: str, text: str, arm: Arm) -> tuple[int, ...]:
    """Indices, 0-based, of the control points in a list of their numbers, 1-based.

    Args:
        name: the option, for the message.
        text: numbers separated by commas, or "all".
        arm: whose control points they are.

    Raises:
        InvalidValue: anything else, or a number that is given twice or that no control point has.
    """
    if text.strip() == "all":
        return tuple(range(arm.n_modules))
    try:
        points = tuple(int(field) - 1 for field in text.split(","))
    except ValueError:
        points = ()
    valid = all(0 <= point < arm.n_modules for point in points) and len(set(points)) == len(points)
    if not (points and valid):
        allowed = (
            f"numbers of control points from 1 to {arm.n_modules}, each once, separated by commas, or all"
        )
        raise InvalidValue(name, text, allowed)
    return points
