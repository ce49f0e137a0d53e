"""TOML text: the line of every key, and edits that preserve the rest of a file.

tomlkit edits the entries of a section. Files are divided into sections here, so that the comments above a
header move with the section, and unchanged sections are neither parsed nor written.
"""

from __future__ import annotations

import re
from bisect import bisect_right
from collections.abc import Callable, Mapping, Sequence
from difflib import SequenceMatcher
from itertools import count
from typing import Any, NamedTuple

import tomlkit
from tomlkit.items import AbstractTable, Array, InlineTable, Item, Trivia, Whitespace

from pinposture.schema import KeyPath, is_table
from pinposture.storage import parse_toml

# The lines on which tables, keys and list items begin, which tomlkit does not provide.

_BASIC = r'"(?:[^"\\\n]|\\.)*"'
_LITERAL = r"'[^'\n]*'"
_BLANK = re.compile(r"(?:\s|,|#[^\n]*)*")


def lines_of_toml(text: str) -> dict[KeyPath, int]:
    """Find the lines of all tables, keys and list items in a text that is known to be TOML.

    The line of a table that is opened several times, as by dotted keys, is the first one.

    Args:
        text: the text; lines end in a line feed.

    Returns:
        Lines by key path; the first line is 1.
    """
    return _Scanner(text).lines


class _Scanner:
    """One pass through a text that is assumed to be valid.

    Attributes:
        lines: the line of each key path.
        headers: the line and the key path of each header.
    """

    def __init__(self, text: str) -> None:
        self.lines: dict[KeyPath, int] = {}
        self.headers: list[tuple[int, KeyPath]] = []
        self._text = text
        self._at = 0
        self._breaks = [match.start() for match in re.finditer("\n", text)]
        self._last_items: dict[KeyPath, int] = {}  # of each list of tables
        table: KeyPath = ()
        self._skip(_BLANK)
        while self._at < len(text):
            if text[self._at] == "[":
                table = self._header()
            else:
                self._entry(table)
            self._skip(_BLANK)

    def _header(self) -> KeyPath:
        line = self._line()
        brackets = 2 if self._text.startswith("[[", self._at) else 1
        self._at += brackets
        self._skip(_BLANK)
        key_path: KeyPath = ()
        names = self._key()
        for number, name in enumerate(names, start=1):
            key_path = (*key_path, name)
            self.lines.setdefault(key_path, line)
            if brackets == 2 and number == len(names):
                self._last_items[key_path] = self._last_items.get(key_path, -1) + 1
            if key_path in self._last_items:
                key_path = (*key_path, self._last_items[key_path])
            self.lines.setdefault(key_path, line)
        self._skip(_BLANK)
        self._at += brackets
        self.headers.append((line, key_path))
        return key_path

    def _entry(self, key_path: KeyPath) -> None:
        line = self._line()
        for name in self._key():
            key_path = (*key_path, name)
            self.lines.setdefault(key_path, line)
        self._at = self._text.index("=", self._at) + 1
        self._value(key_path)

    def _value(self, key_path: KeyPath) -> None:
        self._skip(_BLANK)
        begin = self._text[self._at]
        if begin not in "[{":
            bare = r"[^,\]}#\n]*"
            string = r'"""(?:[^\\]|\\.)*?""""{0,2}' + r"|'''.*?''''{0,2}" + rf"|{_BASIC}|{_LITERAL}"
            self._skip(re.compile(string, re.DOTALL) if begin in "\"'" else re.compile(bare))
            return
        self._at += 1
        self._skip(_BLANK)
        numbers = count()
        while self._text[self._at] not in "]}":
            if begin == "{":
                self._entry(key_path)
            else:
                item = (*key_path, next(numbers))
                self.lines[item] = self._line()
                self._value(item)
            self._skip(_BLANK)
        self._at += 1

    def _key(self) -> list[str]:
        begin = self._at
        name = rf"(?:[A-Za-z0-9_-]+|{_BASIC}|{_LITERAL})"
        self._skip(re.compile(rf"{name}(?:[ \t]*\.[ \t]*{name})*"))
        table = parse_toml(f"{self._text[begin : self._at]} = 0")
        names = []
        while isinstance(table, dict):
            ((name, table),) = table.items()
            names.append(name)
        return names

    def _line(self) -> int:
        return bisect_right(self._breaks, self._at) + 1

    def _skip(self, pattern: re.Pattern[str]) -> None:
        match = pattern.match(self._text, self._at)
        if match is None:
            raise ValueError(f"not TOML from character {self._at}")
        self._at = match.end()


# Writing: only parts with new values change.

MAX_LINE_WIDTH = 110
"""Longest line, if its content can be wrapped."""


class Usual(NamedTuple):
    """A value that need not be written, because it is the default.

    Attributes:
        value: the value, as plain data.
    """

    value: Any


def drop_defaults(value: Any) -> Any:
    """Return plain data without the entries of tables that are `Usual`."""
    if isinstance(value, Mapping):
        return {key: drop_defaults(entry) for key, entry in value.items() if not isinstance(entry, Usual)}
    return [drop_defaults(entry) for entry in value] if isinstance(value, list) else value


class TomlLayout(NamedTuple):
    """The text of a TOML file, and its values.

    Attributes:
        text: the text.
        describe: returns its values, as plain data with `Usual` for defaults; called when they are needed.
    """

    text: str
    describe: Callable[[], Mapping[str, Any]]


def toml_text(values: Mapping[str, Any], layout: TomlLayout | None = None) -> str:
    """Return the text of a TOML file.

    Tables become sections, as do lists of tables and tables of tables. All others are written on one line, or
    with the items of long lists on separate lines.

    Args:
        values: the values of the file: text, finite numbers, truth values, lists and tables of these, and
            `Usual` for defaults.
        layout: a file whose comments and layout are preserved. Values that differ from `values` are changed;
            keys in neither `values` nor those of the layout stay.

    Raises:
        ValueError: any other value.
    """
    former = "" if layout is None else layout.text
    old = {} if layout is None else layout.describe()
    text = former.replace("\r\n", "\n")
    editor = _Editor(_sections(text))
    editor.update((), old, values)
    changed = editor.text()
    if not text.endswith("\n\n") and changed.strip():
        changed = changed.rstrip("\n") + "\n" * (changed != text or text.endswith("\n"))
    return changed if text == former else changed.replace("\n", "\r\n")


class _Section(NamedTuple):
    """A section of a file.

    Attributes:
        number: its number in the file.
        header: the comments above it, and the header itself.
        body: its entries.
        tail: blank lines and comments after the last entry, up to what belongs to the next header.
    """

    number: int
    header: str
    body: str
    tail: str


def _sections(text: str) -> dict[KeyPath, _Section]:
    """Divide a file at its headers; return sections by key path, the entries above all headers at ()."""
    headers = _Scanner(text).headers
    lines = re.findall(r"[^\n]*\n|[^\n]+", text)
    sections: dict[KeyPath, _Section] = {}
    key_path: KeyPath = ()
    header = ""
    begin = 0
    for number, (line, following) in enumerate([*headers, (len(lines) + 1, ())]):
        end = entries = line - 1
        while entries > begin and lines[entries - 1].lstrip(" \t")[:1] in ("#", "\n", ""):
            entries -= 1
        blank = (at for at in range(entries, end) if not lines[at].strip())
        lead = end if number == len(headers) else next(blank, entries - 1) + 1
        body = "".join(lines[begin:entries])
        tail = "".join(lines[entries:lead])
        if not key_path and not body:  # what precedes everything else stays there
            header = "".join(lines[:end])
            tail = ""
            lead = end
        sections[key_path] = _Section(number, header, body, tail)
        key_path = following
        header = "".join(lines[lead : end + 1])
        begin = end + 1
    return sections


class _Editor:
    """Edits a file section by section.

    The pieces of the new text are sorted by the section to which they belong or which they follow, then by
    their order.
    """

    def __init__(self, sections: Mapping[KeyPath, _Section]) -> None:
        self._sections = sections
        self._pieces: dict[tuple[int, int], tuple[str, bool]] = {}
        self._count = count(1)

    def text(self) -> str:
        """Join the pieces, with blank lines around new ones."""
        text = ""
        apart = False
        for _, (piece, new) in sorted(self._pieces.items()):
            if text and piece and (new or apart) and not text.endswith("\n\n"):
                text += "\n" if text.endswith("\n") else "\n\n"
            text += piece
            apart = new if piece else apart
        return text

    def _insert(self, after: int, text: str, new: bool = True) -> None:
        self._pieces[after, next(self._count)] = text, new

    def _within(self, key_path: KeyPath) -> list[_Section]:
        """Return the sections at and below a key path, in the order of the file."""
        return [section for other, section in self._sections.items() if other[: len(key_path)] == key_path]

    def _children(self, key_path: KeyPath) -> dict[str, bool]:
        """Return the keys of sections below a key path, and whether each is a list of tables."""
        depth = len(key_path)
        kept = dict[str, bool]()
        for other in self._sections:
            if len(other) > depth and other[:depth] == key_path:
                kept[str(other[depth])] = len(other) > depth + 1 and isinstance(other[depth + 1], int)
        return kept

    def update(self, key_path: KeyPath, old: Mapping[str, Any], new: Mapping[str, Any]) -> None:
        """Write the sections at and below a key path with new values."""
        section = self._sections.get(key_path)
        children = self._children(key_path)
        kept = {
            key
            for key, listed in children.items()
            if (_is_list_of_tables if listed else is_table)(new.get(key))
        }
        own_old = {key: value for key, value in old.items() if key not in kept}
        own = {key: value for key, value in new.items() if key not in kept}
        present = own if own_old == own else parse_toml(section.body) if section else {}
        added = {key for key in own if key not in present and not _unchanged(own_old, own, key)}
        outermost = not key_path
        headless = section is None
        sections = {key for key in added if _is_section(own[key], outermost, headless)}
        own = {key: value for key, value in own.items() if key not in sections}
        if section:
            at = (section.number, 0)
            body = section.body if own_old == own else _edited(section.body, own_old, own)
            begun = outermost and bool(body) and not section.body
            self._pieces[at] = (section.header + body + section.tail, begun)
        else:
            at = (self._within(key_path)[0].number - 1, next(self._count))
            if drop_defaults(own).keys() & added:
                self._pieces[at] = (
                    _new_section(key_path, {key: own[key] for key in own if key in added}),
                    True,
                )
        for key, value in new.items():
            child = (*key_path, key)
            if key in sections:
                self._add(child, value, at[0])
            elif key in kept:
                if children[key]:
                    self._update_list(child, old.get(key), value)
                else:
                    self.update(child, old.get(key, {}), value)
                at = max(at, (self._within(child)[-1].number, 0))
        for key in children.keys() - new.keys() - old.keys():  # the user's own
            for part in self._within((*key_path, key)):
                self._pieces[part.number, 0] = (part.header + part.body + part.tail, False)

    def _add(self, key_path: KeyPath, value: Any, after: int) -> None:
        """Write a new section, or a list of them."""
        if not isinstance(value, Mapping):
            for entry in value:
                self._insert(after, _new_section(key_path, entry, listed=True))
            return
        nested = {key: entry for key, entry in value.items() if _is_section(entry)}
        own = {key: each for key, each in value.items() if key not in nested}
        if own or not nested:
            self._insert(after, _new_section(key_path, own))
        for key, tables in nested.items():
            for name, table in tables.items():
                self._add((*key_path, key, name), table, after)

    def _update_list(self, key_path: KeyPath, old: Any, new: Any) -> None:
        """Write a list of sections, some of which may be new, removed, or reordered."""
        items = {other[: len(key_path) + 1] for other in self._sections if other[: len(key_path)] == key_path}
        same_count = isinstance(old, list) and len(old) == len(items)
        origins = _matches(old, new) if same_count else [None] * len(new)
        first = self._within(key_path)[0].number
        before = -1
        in_place = origins == list(range(len(items)))
        for origin, value in zip(origins, new, strict=True):
            if origin is None:
                self._insert(first, _new_section(key_path, value, listed=True))
            elif in_place:
                self.update((*key_path, origin), old[origin], value)
            else:
                item = _Editor(self._sections)
                item.update((*key_path, origin), old[origin], value)
                self._insert(first, item.text(), origin != before + 1)
            before = -2 if origin is None else origin


def _is_list_of_tables(value: object) -> bool:
    return isinstance(value, list) and bool(value) and all(map(is_table, value))


def _is_section(value: object, outermost: bool = False, headless: bool = False) -> bool:
    """Whether a new value becomes a section, and not an entry of the section that it is in."""
    if not isinstance(value, Mapping):
        return outermost and _is_list_of_tables(value)
    return outermost or headless or (bool(value) and all(map(is_table, value.values())))


def _matches(old: Sequence[Any], new: Sequence[Any]) -> list[int | None]:
    """Return the previous index of each table of a list: that of an equal table, or of a similar one."""
    left = list(range(len(old)))
    matches = dict[int, int]()

    def alike(key: str, present: bool) -> Callable[[Any, Any], bool]:
        return lambda one, other: one.get(key) == other.get(key) and (key in one) == present

    tests: list[tuple[Callable[[Any, Any], bool], bool]] = [
        (lambda one, other: bool(one == other), False),
        (alike("name", True), False),
        (alike("curve", True), True),
        (alike("name", False), True),
    ]
    for similar, ordered in tests:
        for at, value in enumerate(new):
            if at in matches:
                continue
            low = -1
            high = len(old)
            if ordered:  # between the tables that are matched already
                low = max((matches[index] for index in matches if index < at), default=low)
                high = min((matches[index] for index in matches if index > at), default=high)
            origin = next((i for i in left if low < i < high and similar(old[i], value)), None)
            if origin is not None:
                matches[at] = origin
                left.remove(origin)
    return [matches.get(at) for at in range(len(new))]


def _unchanged(old: Mapping[str, Any], new: Mapping[str, Any], key: str) -> bool:
    return key in old and bool(old[key] == new[key])


def _new_section(key_path: KeyPath, values: Mapping[str, Any], listed: bool = False) -> str:
    document = tomlkit.document()
    for key, value in drop_defaults(values).items():
        document.append(key, _entry(key, value))
    name = ".".join(tomlkit.key(key).as_string() for key in key_path if isinstance(key, str))
    header = "" if not key_path else f"[[{name}]]\n" if listed else f"[{name}]\n"
    return header + document.as_string()


# Entries of a section, by tomlkit.


def _edited(body: str, old: Mapping[str, Any], new: Mapping[str, Any]) -> str:
    """Return the entries of a section with new values."""
    document = tomlkit.parse(body)
    _edit_table(document, old, new)
    text = document.as_string()
    return text if text.endswith("\n") or not text else f"{text}\n"


def _edit_table(table: Any, old: Mapping[str, Any], new: Mapping[str, Any]) -> None:
    for key in list(table):
        before: Any = old.get(key, {})
        after: Any = new.get(key)
        if (key not in new and key in old) or (isinstance(after, Usual) and before != after):
            del table[key]
        elif key in new and not _unchanged(old, new, key):
            item = table[key]
            if isinstance(item, AbstractTable) and not isinstance(item, InlineTable):
                _edit_table(item, before, after)  # of dotted keys
            else:
                _replace(table, key, _edited_item(item, before, after, key))
    for key, value in drop_defaults(new).items():
        if key not in table and not _unchanged(old, new, key):
            table.append(key, _entry(key, value))


def _replace(container: Any, key: str | int, item: Any) -> None:
    """Replace an item, unless it is the same: tomlkit would lose the layout around it."""
    if container[key] is not item:
        container[key] = item


def _edited_item(item: Any, old: Any, new: Any, key: str = "") -> Any:
    """Return an item with a new value; the same item if possible."""
    if old == new:
        return item
    if isinstance(item, InlineTable) and isinstance(old, Mapping) and isinstance(new, Mapping):
        if item.keys() == new.keys():
            for name in new:
                _replace(item, name, _edited_item(item[name], old.get(name), new[name]))
            return item
        table = tomlkit.inline_table()
        for name in (*(name for name in item if name in new), *(name for name in new if name not in item)):
            kept = name in item and name in old
            table.append(name, _edited_item(item[name], old[name], new[name]) if kept else _item(new[name]))
        return table
    if isinstance(item, Array) and isinstance(new, list) and _may_mean(item, old):
        _edit_list(item, old, new)
        return item
    return _entry(key, new)


def _may_mean(item: Any, value: Any) -> bool:
    """Whether an item may stand for a value: text may be a number with its unit."""
    if isinstance(item, list) and isinstance(value, list):
        return len(item) == len(value) and all(map(_may_mean, item, value))
    if isinstance(item, str) and isinstance(value, int | float):
        return True
    return isinstance(item, Mapping) or bool(item == value)


def _edit_list(array: Array, old: list[Any], new: list[Any]) -> None:
    """Change items of a list in place, which preserves comments next to them."""
    changes: Sequence[tuple[str, int, int, int, int]] = [("replace", 0, len(old), 0, len(new))]
    if len(old) != len(new):
        matcher = SequenceMatcher(None, list(map(repr, old)), list(map(repr, new)), autojunk=False)
        changes = matcher.get_opcodes()[::-1]
    for _, i1, i2, j1, j2 in changes:
        both = min(i2 - i1, j2 - j1)
        for at in reversed(range(i1 + both, i2)):
            del array[at]
        for at in range(j1 + both, j2):
            array.insert(i1 + at - j1, _item(new[at]))
        for at in range(both):
            _replace(array, i1 + at, _edited_item(array[i1 + at], old[i1 + at], new[j1 + at]))


def _entry(key: str, value: Any) -> Item:
    """Return the item of a key: on one line if it fits, otherwise with long lists on several."""
    item = _item(value)
    before = len(tomlkit.key(key).as_string()) + 3 if key else 0
    return item if before + len(item.as_string()) <= MAX_LINE_WIDTH else _item(value, broken=True)


def _item(value: Any, broken: bool = False) -> Item:
    if isinstance(value, Mapping):
        table = tomlkit.inline_table()
        for key, entry in drop_defaults(value).items():
            table.append(key, _item(entry, broken))
        return table
    if isinstance(value, list | tuple):
        return _array([_item(entry) for entry in value], broken)
    item: Item = tomlkit.item(value)
    return item


def _array(items: list[Item], broken: bool) -> Array:
    """Return a list as it is written; built at once, as tomlkit counts all parts anew for each insertion."""
    texts = [item.as_string() for item in items]
    lines = broken and sum(map(len, texts)) + 2 * len(texts) > MAX_LINE_WIDTH // 2
    nested = any(isinstance(item, Array | InlineTable) for item in items)
    parts: list[Item] = []
    width = 0
    for item, text in zip(items, texts, strict=True):
        begins = lines and (not parts or nested or width + len(text) + 4 > MAX_LINE_WIDTH)
        between = "\n    " if begins else " "
        if parts:
            parts.append(Whitespace(","))
        if parts or begins:
            parts.append(Whitespace(between))
        parts.append(item)
        width = (0 if begins else width) + len(text) + 2
    if lines:
        parts += [Whitespace(","), Whitespace("\n")]
    return Array(parts, Trivia())
