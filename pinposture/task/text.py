"""Plain data as TOML and JSON text, laid out as a person would."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator, Mapping
from typing import Any

# Numbers and text in the notation that TOML and JSON share, and how much of it goes on a line.

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


# Plain data as JSON, laid out as a person would: what fits on a line is on one.

_STEP = "  "


def json_text(values: Mapping[str, Any]) -> str:
    """A JSON file.

    Args:
        values: what the file is to hold: text, finite numbers, truth values, lists and tables of these.

    Raises:
        ValueError: something else among them.
    """
    return f"{_json_broken(values, '')}\n"


def _json_value(value: Any, indent: str, before: int) -> str:
    text = _json_inline(value)
    return text if before + len(text) < WIDTH else _json_broken(value, indent)


def _json_inline(value: Any) -> str:
    if isinstance(value, Mapping):
        inner = ", ".join(f"{scalar(key)}: {_json_inline(each)}" for key, each in value.items())
        return f"{{{inner}}}"
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(_json_inline, value))}]"
    return scalar(value)


def _json_broken(value: Any, indent: str) -> str:
    within = indent + _STEP
    if isinstance(value, Mapping) and value:
        entries = []
        for key, each in value.items():
            begin = f"{within}{scalar(key)}: "
            entries.append(begin + _json_value(each, within, len(begin)))
        inner, brackets = ",\n".join(entries), "{}"
    elif isinstance(value, list | tuple) and value:
        nested = any(isinstance(each, Mapping | list | tuple) for each in value)
        items = [_json_value(each, within, len(within)) for each in value]
        inner = ",\n".join(within + item for item in items) if nested else filled(items, within)
        brackets = "[]"
    else:
        return _json_inline(value)
    return f"{brackets[0]}\n{inner}\n{indent}{brackets[1]}"


# Plain data as TOML, laid out as a person would: tables under headings, what is within them on one line.

_BARE = re.compile(r"[A-Za-z0-9_-]+")
_INDENT = "    "


def toml_text(values: Mapping[str, Any]) -> str:
    """A TOML file.

    Tables become sections, and so do lists of tables, and tables that hold nothing but tables. All others are
    written within a line. A line that would be too long is broken within its lists, where TOML allows it.

    Args:
        values: what the file is to hold: text, finite numbers, truth values, lists and tables of these.

    Raises:
        ValueError: something else among them.
    """
    sections = {key: value for key, value in values.items() if _is_section(value)}
    blocks = [_entries({key: value for key, value in values.items() if key not in sections})]
    for key, value in sections.items():
        if isinstance(value, Mapping):
            blocks += _table(_key(key), value)
        else:
            blocks += [f"[[{_key(key)}]]\n{_entries(each)}" for each in value]
    return "\n".join(filter(None, blocks))


def _is_section(value: object) -> bool:
    listed = isinstance(value, list) and value and all(isinstance(each, Mapping) for each in value)
    return isinstance(value, Mapping) or bool(listed)


def _table(place: str, values: Mapping[str, Any]) -> Iterator[str]:
    """A section, and those of the tables of tables within it."""
    nested = {
        key: value
        for key, value in values.items()
        if isinstance(value, Mapping) and value and all(isinstance(each, Mapping) for each in value.values())
    }
    own = {key: value for key, value in values.items() if key not in nested}
    if own or not nested:
        yield f"[{place}]\n{_entries(own)}"
    for key, tables in nested.items():
        for name, table in tables.items():
            yield from _table(f"{place}.{_key(key)}.{_key(name)}", table)


def _entries(values: Mapping[str, Any]) -> str:
    return "".join(
        f"{_key(key)} = {_toml_value(value, len(_key(key)) + 3)}\n" for key, value in values.items()
    )


def _key(name: str) -> str:
    return name if _BARE.fullmatch(name) else scalar(name)


def _toml_value(value: Any, before: int) -> str:
    """A value after so many characters: in a line if it fits, or else with its long lists over several."""
    text = _toml_inline(value)
    return text if before + len(text) <= WIDTH else _toml_broken(value)


def _toml_inline(value: Any) -> str:
    if isinstance(value, Mapping):
        inner = ", ".join(f"{_key(key)} = {_toml_inline(each)}" for key, each in value.items())
        return f"{{ {inner} }}" if inner else "{}"
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(_toml_inline, value))}]"
    return scalar(value)


def _toml_broken(value: Any) -> str:
    if isinstance(value, Mapping):
        inner = ", ".join(f"{_key(key)} = {_toml_broken(each)}" for key, each in value.items())
        return f"{{ {inner} }}" if inner else "{}"
    text = _toml_inline(value)
    if not isinstance(value, list | tuple) or len(text) <= WIDTH // 2:
        return text
    items = [_toml_inline(each) for each in value]
    if any(isinstance(each, Mapping | list | tuple) for each in value):
        return "[\n" + "".join(f"{_INDENT}{item},\n" for item in items) + "]"
    return f"[\n{filled(items, _INDENT)},\n]"
