"""Plain data as TOML, laid out as a person would: tables under headings, what is within them on one line."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from typing import Any

from pinposture.task.writing.notation import WIDTH, filled, scalar

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
    return "".join(f"{_key(key)} = {_value(value, len(_key(key)) + 3)}\n" for key, value in values.items())


def _key(name: str) -> str:
    return name if _BARE.fullmatch(name) else scalar(name)


def _value(value: Any, before: int) -> str:
    """A value after so many characters: in a line if it fits, or else with its long lists over several."""
    text = _inline(value)
    return text if before + len(text) <= WIDTH else _broken(value)


def _inline(value: Any) -> str:
    if isinstance(value, Mapping):
        inner = ", ".join(f"{_key(key)} = {_inline(each)}" for key, each in value.items())
        return f"{{ {inner} }}" if inner else "{}"
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(_inline, value))}]"
    return scalar(value)


def _broken(value: Any) -> str:
    if isinstance(value, Mapping):
        inner = ", ".join(f"{_key(key)} = {_broken(each)}" for key, each in value.items())
        return f"{{ {inner} }}" if inner else "{}"
    text = _inline(value)
    if not isinstance(value, list | tuple) or len(text) <= WIDTH // 2:
        return text
    items = [_inline(each) for each in value]
    if any(isinstance(each, Mapping | list | tuple) for each in value):
        return "[\n" + "".join(f"{_INDENT}{item},\n" for item in items) + "]"
    return f"[\n{filled(items, _INDENT)},\n]"
