"""Numbers and text in the notation that TOML and JSON share, and how much of it goes on a line."""

from __future__ import annotations

import json
import math

WIDTH = 110
"""The longest line, where what is on it can be broken."""

_WHOLE = 1e15
"""Size below which a whole number is written without a point."""


def scalar(value: object) -> str:
    """A truth value, a number or text.

    Numbers are as short as they can be while they read back the same, to the last bit.

    Raises:
        ValueError: a number that is not finite, or something else.
    """
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        # TOML wants that one escaped, too.
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, int):
        return str(value)
    if not isinstance(value, float) or not math.isfinite(value):
        raise ValueError(f"{value!r} has no notation")
    whole = value.is_integer() and abs(value) < _WHOLE and (value != 0.0 or math.copysign(1.0, value) > 0.0)
    return str(int(value)) if whole else repr(value)


def filled(items: list[str], indent: str) -> str:
    """Items on as few lines as they fit on, each indented, with a comma after all but the last."""
    lines = [indent + items[0]]
    for item in items[1:]:
        if len(lines[-1]) + len(item) + 3 <= WIDTH:
            lines[-1] += f", {item}"
        else:
            lines[-1] += ","
            lines.append(indent + item)
    return "\n".join(lines)
