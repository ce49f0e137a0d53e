"""Plain data as JSON, laid out as a person would: what fits on a line is on one."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pinposture.task.writing.notation import WIDTH, filled, scalar

_STEP = "  "


def json_text(values: Mapping[str, Any]) -> str:
    """A JSON file.

    Args:
        values: what the file is to hold: text, finite numbers, truth values, lists and tables of these.

    Raises:
        ValueError: something else among them.
    """
    return f"{_broken(values, '')}\n"


def _value(value: Any, indent: str, before: int) -> str:
    text = _inline(value)
    return text if before + len(text) < WIDTH else _broken(value, indent)


def _inline(value: Any) -> str:
    if isinstance(value, Mapping):
        inner = ", ".join(f"{scalar(key)}: {_inline(each)}" for key, each in value.items())
        return f"{{{inner}}}"
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(_inline, value))}]"
    return scalar(value)


def _broken(value: Any, indent: str) -> str:
    within = indent + _STEP
    if isinstance(value, Mapping) and value:
        entries = []
        for key, each in value.items():
            begin = f"{within}{scalar(key)}: "
            entries.append(begin + _value(each, within, len(begin)))
        inner, brackets = ",\n".join(entries), "{}"
    elif isinstance(value, list | tuple) and value:
        nested = any(isinstance(each, Mapping | list | tuple) for each in value)
        items = [_value(each, within, len(within)) for each in value]
        inner = ",\n".join(within + item for item in items) if nested else filled(items, within)
        brackets = "[]"
    else:
        return _inline(value)
    return f"{brackets[0]}\n{inner}\n{indent}{brackets[1]}"
