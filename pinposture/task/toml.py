"""TOML text: where everything stands in it, and changes that leave the rest as the user wrote it.

tomlkit changes the entries of a section. Sections are cut apart and put together here, so that the comments
above a header go where the section goes, and sections that do not change are neither read nor written.
"""

from __future__ import annotations

import re
import sys
from bisect import bisect_right
from collections.abc import Callable, Iterator, Mapping, Sequence
from difflib import SequenceMatcher
from itertools import count
from operator import eq
from typing import Any, NamedTuple

import tomlkit
from tomlkit.items import AbstractTable, Array, InlineTable, Item

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

Place = tuple[str | int, ...]
"""A way through a file: names of keys, and numbers of list items from 0."""

# On which line each table, key and list item begins. tomlkit does not tell.

_BASIC, _LITERAL = r'"(?:[^"\\\n]|\\.)*"', r"'[^'\n]*'"
_NAME = rf"(?:[A-Za-z0-9_-]+|{_BASIC}|{_LITERAL})"
_KEY = re.compile(rf"{_NAME}(?:[ \t]*\.[ \t]*{_NAME})*")
_STRING = re.compile(
    r'"""(?:[^\\]|\\.)*?""""{0,2}' + r"|'''.*?''''{0,2}" + rf"|{_BASIC}|{_LITERAL}", re.DOTALL
)
_BARE = re.compile(r"[^,\]}#\n]*")
_BETWEEN = re.compile(r"(?:\s|,|#[^\n]*)*")


def lines_of_toml(text: str) -> dict[Place, int]:
    """Find where everything begins in a file that is known to be TOML.

    A table that is begun several times, as dotted keys do, counts from where it is first seen.

    Args:
        text: what the file holds; lines end in a line feed.

    Returns:
        Lines, the first of which is 1.
    """
    scan = _Scan(text)
    scan.file()
    return scan.found


class _Scan:
    """One passage through a file, which is not checked on the way.

    Attributes:
        found: the line of each place.
        headers: the line and the place of each header.
    """

    def __init__(self, text: str) -> None:
        self.found: dict[Place, int] = {}
        self._text, self._at = text, 0
        self._breaks = [match.start() for match in re.finditer("\n", text)]
        self._last: dict[Place, int] = {}  # the last of each list of tables so far
        self.headers: list[tuple[int, Place]] = []

    def file(self) -> None:
        inside: Place = ()
        self._pass(_BETWEEN)
        while self._at < len(self._text):
            if self._text[self._at] == "[":
                inside = self._header()
            else:
                self._entry(inside)
            self._pass(_BETWEEN)

    def _header(self) -> Place:
        brackets = 2 if self._text.startswith("[[", self._at) else 1
        place: Place = ()
        line = self._line()
        self._at += brackets
        self._pass(_BETWEEN)
        names = self._key()
        for number, name in enumerate(names, start=1):
            place = (*place, name)
            self.found.setdefault(place, line)
            if brackets == 2 and number == len(names):
                self._last[place] = self._last.get(place, -1) + 1
            if place in self._last:
                place = (*place, self._last[place])
            self.found.setdefault(place, line)
        self._pass(_BETWEEN)
        self._at += brackets
        self.headers.append((line, place))
        return place

    def _entry(self, inside: Place) -> None:
        line = self._line()
        for name in self._key():
            inside = (*inside, name)
            self.found.setdefault(inside, line)
        self._at = self._text.index("=", self._at) + 1
        self._value(inside)

    def _value(self, place: Place) -> None:
        self._pass(_BETWEEN)
        begin = self._text[self._at]
        if begin in "[{":
            self._at += 1
            self._pass(_BETWEEN)
            number = 0
            while self._text[self._at] not in "]}":
                if begin == "{":
                    self._entry(place)
                else:
                    item = (*place, number)
                    self.found[item] = self._line()
                    self._value(item)
                    number += 1
                self._pass(_BETWEEN)
            self._at += 1
        else:
            self._pass(_STRING if begin in "\"'" else _BARE)

    def _key(self) -> list[str]:
        begin = self._at
        self._pass(_KEY)
        table, names = tomllib.loads(f"{self._text[begin : self._at]} = 0"), []
        while isinstance(table, dict):
            ((name, table),) = table.items()
            names.append(name)
        return names

    def _line(self) -> int:
        return bisect_right(self._breaks, self._at) + 1

    def _pass(self, what: re.Pattern[str]) -> None:
        match = what.match(self._text, self._at)
        assert match is not None  # the file was read before
        self._at = match.end()


# Writing: a text is changed where what it says has changed.

WIDTH = 110
"""The longest line, where what is on it can be broken."""


class Usual(NamedTuple):
    """A value that need not be written: it is what is read where nothing is said.

    Attributes:
        value: the value, as plain data.
    """

    value: Any


class TomlLayout(NamedTuple):
    """The text of a TOML file, and what it says.

    Attributes:
        text: the text.
        says: the same in the words of the writer of such files: plain data, with `Usual` for what need not
            be said.
    """

    text: str
    says: Mapping[str, Any]


def toml_text(values: Mapping[str, Any], layout: TomlLayout | None = None) -> str:
    """A TOML file.

    Tables become sections, and so do lists of tables, and tables that hold nothing but tables. All others are
    written within a line, or with the items of long lists on lines of their own.

    Args:
        values: what the file is to say: text, finite numbers, truth values, lists and tables of these, and
            `Usual` for what need not be said.
        layout: a file, the comments and layout of which are to stay. What it says otherwise than `values` is
            changed, keys of which neither `values` nor `layout.says` know stay.

    Raises:
        ValueError: something else among the values.
    """
    given, says = ("", {}) if layout is None else layout
    text = given.replace("\r\n", "\n")
    root = _sections(text)
    pieces = _Pieces()
    pieces.change(root, says, values, ())
    changed = pieces.text()
    if not text.endswith("\n\n") and changed.strip():
        changed = changed.rstrip("\n") + "\n" * (changed != text or text.endswith("\n"))
    return changed if text == given else changed.replace("\n", "\r\n")


class _Section:
    """A section of a file, and those within it.

    Attributes:
        number: which of the sections of the file it is.
        header: the comments above it, and the header itself; None if there is none, as of "a" in [a.b].
        body: its entries.
        tail: blank lines and comments after the last entry, up to what belongs to the next header.
        within: sections within this one by their keys; a list for a list of tables.
    """

    def __init__(self) -> None:
        self.number, self.header, self.body, self.tail = -1, "", "", ""
        self.written = False
        self.within: dict[str, _Section | list[_Section]] = {}

    def all(self) -> Iterator[_Section]:
        """This section and those within, in any order."""
        yield self
        for child in self.within.values():
            for each in child if isinstance(child, list) else [child]:
                yield from each.all()

    @property
    def last(self) -> int:
        """Number of the last section in here."""
        return max(each.number for each in self.all())


def _sections(text: str) -> _Section:
    """A file, cut at its headers."""
    scan = _Scan(text)
    scan.file()
    lines = re.findall(r"[^\n]*\n|[^\n]+", text)
    root = _Section()
    ends = [line - 1 for line, _ in scan.headers] + [len(lines)]
    root.number, root.written, lead = 0, True, 0
    section, begin = root, 0
    for number, end in enumerate(ends):
        entries = end
        while entries > begin and lines[entries - 1].lstrip(" \t")[:1] in ("#", "\n", ""):
            entries -= 1
        blank = (at for at in range(entries, end) if not lines[at].strip())
        lead = end if number == len(ends) - 1 else next(blank, entries - 1) + 1
        section.body, section.tail = "".join(lines[begin:entries]), "".join(lines[entries:lead])
        if section is root and not section.body:  # what stands above all else stays there
            section.header, section.tail, lead = "".join(lines[:end]), "", end
        if number < len(scan.headers):
            section = _within(root, scan.headers[number][1])
            section.header = "".join(lines[lead : end + 1])
            section.number, section.written, begin = number + 1, True, end + 1
    return root


def _within(section: _Section, place: Place) -> _Section:
    """The section at a place, made where there is none yet."""
    for key, number in zip(place, (*place[1:], None), strict=True):
        if isinstance(key, int):
            continue
        if isinstance(number, int):
            listed = section.within.setdefault(key, [])
            assert isinstance(listed, list)
            listed.extend(_Section() for _ in range(len(listed), number + 1))
            section = listed[number]
        else:
            child = section.within.setdefault(key, _Section())
            assert isinstance(child, _Section)
            section = child
    return section


class _Pieces:
    """The pieces of the text that is to be written, by where they go."""

    def __init__(self) -> None:
        self._pieces: dict[tuple[int, int], tuple[str, bool]] = {}
        self._count = count(1)

    def text(self) -> str:
        """All of them; new ones with blank lines around."""
        text, apart = "", False
        for _, (piece, new) in sorted(self._pieces.items()):
            if text and piece and (new or apart) and not text.endswith("\n\n"):
                text += "\n" if text.endswith("\n") else "\n\n"
            text += piece
            apart = new if piece else apart
        return text

    def change(
        self, section: _Section, says: Mapping[str, Any], values: Mapping[str, Any], place: Place
    ) -> None:
        """Write a section that is there, and those within, with other values."""
        within = {key: child for key, child in section.within.items() if _fits(child, values.get(key))}
        said = {key: value for key, value in says.items() if key not in within}
        own = {key: value for key, value in values.items() if key not in within}
        there = tomllib.loads(section.body) if said != own else own
        new = {key for key, value in own.items() if key not in there and not _same(said, key, value)}
        sections = {key for key in new if _is_section(own[key], place, section.written)}
        own = {key: value for key, value in own.items() if key not in sections}
        at = (section.number, 0)
        if section.written:
            body = section.body if said == own else _changed(section.body, said, own)
            begun = not place and bool(body) and not section.body
            self._pieces[at] = (section.header + body + section.tail, begun)
        else:
            at = (min(each.number for each in section.all() if each.written) - 1, next(self._count))
            if _said(own).keys() & new:
                self._pieces[at] = (_section(place, {key: own[key] for key in own if key in new}), True)
        for key, value in values.items():
            child = within.get(key)
            if key in sections:
                self._add((*place, key), value, at[0])
            elif isinstance(child, list):
                self._change_list(child, says.get(key), value, (*place, key))
                at = max(at, (max(each.last for each in child), 0))
            elif child is not None:
                self.change(child, says.get(key, {}), value, (*place, key))
                at = max(at, (child.last, 0))
        for key, child in section.within.items():
            if key not in values and key not in says:
                for listed in child if isinstance(child, list) else [child]:
                    self._keep(listed)

    def _keep(self, section: _Section) -> None:
        for each in section.all():
            if each.written:
                self._pieces[each.number, 0] = (each.header + each.body + each.tail, False)

    def _add(self, place: Place, value: Any, after: int) -> None:
        """Write a new section, or a list of them."""
        if isinstance(value, Mapping):
            nested = {key: each for key, each in value.items() if _is_section(each, place, True)}
            own = {key: each for key, each in value.items() if key not in nested}
            if own or not nested:
                self._pieces[after, next(self._count)] = (_section(place, own), True)
            for key, tables in nested.items():
                for name, table in tables.items():
                    self._add((*place, key, name), table, after)
        else:
            for each in value:
                self._pieces[after, next(self._count)] = (_section(place, each, listed=True), True)

    def _change_list(self, there: list[_Section], says: Any, values: Any, place: Place) -> None:
        """Write a list of sections, some of which may be new, gone, or elsewhere in it."""
        of = (
            _matches(says, values)
            if isinstance(says, list) and len(says) == len(there)
            else [None] * len(values)
        )
        first = min(each.number for section in there for each in section.all() if each.written)
        still = of == list(range(len(there)))
        before = -1
        for number, value in zip(of, values, strict=True):
            if number is None:
                self._pieces[first, next(self._count)] = (_section(place, value, listed=True), True)
            elif still:
                self.change(there[number], says[number], value, place)
            else:
                own = _Pieces()
                own.change(there[number], says[number], value, place)
                self._pieces[first, next(self._count)] = (own.text(), number != before + 1)
            before = -2 if number is None else number


def _fits(child: _Section | list[_Section], value: object) -> bool:
    """Whether a value can stand in the sections that are there."""
    if isinstance(child, list):
        return isinstance(value, list) and bool(value) and all(isinstance(each, Mapping) for each in value)
    return isinstance(value, Mapping)


def _is_section(value: object, place: Place, written: bool) -> bool:
    """Whether a new value becomes a section, and not an entry of the section at a place."""
    if isinstance(value, list):
        return not place and bool(value) and all(isinstance(each, Mapping) for each in value)
    if not isinstance(value, Mapping):
        return False
    nested = bool(value) and all(isinstance(each, Mapping) for each in value.values())
    return not place or not written or nested


def _matches(says: Sequence[Any], values: Sequence[Any]) -> list[int | None]:
    """For each table of a list, which one it was before: the same, or one that is alike."""
    left, found = list(range(len(says))), dict[int, int]()

    def alike(key: str, named: bool) -> Callable[[Any, Any], bool]:
        return lambda one, other: one.get(key) == other.get(key) and (key in one) == named

    tests = (
        (eq, False),
        (alike("name", True), False),
        (alike("curve", True), True),
        (alike("name", False), True),
    )
    for same, ordered in tests:
        for at, value in enumerate(values):
            if at in found:
                continue
            lowest = max((found[each] for each in found if each < at), default=-1) if ordered else -1
            highest = (
                min((found[each] for each in found if each > at), default=len(says)) if ordered else len(says)
            )
            old = next((i for i in left if lowest < i < highest and same(says[i], value)), None)
            if old is not None:
                found[at] = old
                left.remove(old)
    return [found.get(at) for at in range(len(values))]


def _same(says: Mapping[str, Any], key: str, value: Any) -> bool:
    """Whether a key has this value already, said or not."""
    return key in says and bool(says[key] == value)


def _said(values: Mapping[str, Any]) -> dict[str, Any]:
    """The values without those that need not be said."""
    return {key: value for key, value in values.items() if not isinstance(value, Usual)}


def _section(place: Place, values: Mapping[str, Any], listed: bool = False) -> str:
    """The text of a new section."""
    document = tomlkit.document()
    for key, value in _said(values).items():
        document.append(key, _entry(key, value))
    name = ".".join(tomlkit.key(str(key)).as_string() for key in place)
    header = "" if not place else f"[[{name}]]\n" if listed else f"[{name}]\n"
    return header + document.as_string()


def _changed(body: str, says: Mapping[str, Any], values: Mapping[str, Any]) -> str:
    """The entries of a section with other values."""
    document = tomlkit.parse(body)
    _change_table(document, says, values)
    text = document.as_string()
    return text if text.endswith("\n") or not text else f"{text}\n"


def _change_table(table: Any, says: Mapping[str, Any], values: Mapping[str, Any]) -> None:
    for key in list(table):
        old: Any = says.get(key, {})
        new: Any = values.get(key)
        if (key not in values and key in says) or (isinstance(new, Usual) and old != new):
            del table[key]
        elif key in values and not _same(says, key, new):
            item = table[key]
            if isinstance(item, AbstractTable) and not isinstance(item, InlineTable):
                _change_table(item, old, new)  # of dotted keys
            else:
                changed = _changed_item(item, old, new, key)
                if changed is not item:
                    table[key] = changed
    for key, value in _said(values).items():
        if key not in table and not _same(says, key, value):
            table.append(key, _entry(key, value))


def _changed_item(item: Any, old: Any, new: Any, key: str = "") -> Any:
    """An item that says something else; the same item as far as it still holds."""
    if old == new:
        return item
    if isinstance(item, InlineTable) and isinstance(old, Mapping) and isinstance(new, Mapping):
        if item.keys() == new.keys():
            for name in new:
                changed = _changed_item(item[name], old.get(name), new[name])
                if changed is not item[name]:
                    item[name] = changed
            return item
        table = tomlkit.inline_table()
        for name in (*(name for name in item if name in new), *(name for name in new if name not in item)):
            kept = name in item and name in old
            table.append(name, _changed_item(item[name], old[name], new[name]) if kept else _item(new[name]))
        return table
    if isinstance(item, Array) and isinstance(new, list) and _says(item, old):
        _change_list(item, old, new)
        return item
    return _entry(key, new)


def _says(item: Any, value: Any) -> bool:
    """Whether an item may well say a value: text may be a number with its unit."""
    if isinstance(item, list) and isinstance(value, list):
        return len(item) == len(value) and all(map(_says, item, value))
    if isinstance(item, str) and isinstance(value, int | float):
        return True
    return isinstance(item, Mapping) or bool(item == value)


def _change_list(array: Array, old: list[Any], new: list[Any]) -> None:
    """Change items of a list in their places, with the comments beside them."""
    matcher = SequenceMatcher(
        None, [repr(each) for each in old], [repr(each) for each in new], autojunk=False
    )
    everything = [("replace", 0, len(old), 0, len(new))]
    for _, i1, i2, j1, j2 in everything if len(old) == len(new) else reversed(matcher.get_opcodes()):
        both = min(i2 - i1, j2 - j1)
        for at in reversed(range(i1 + both, i2)):
            del array[at]
        for at in range(j1 + both, j2):
            array.insert(i1 + at - j1, _item(new[at]))
        for at in range(both):
            changed = _changed_item(array[i1 + at], old[i1 + at], new[j1 + at])
            if changed is not array[i1 + at]:
                array[i1 + at] = changed


def _entry(key: str, value: Any) -> Item:
    """An item to stand after a key: within a line if it fits, or else with its long lists over several."""
    item = _item(value)
    before = len(tomlkit.key(key).as_string()) + 3 if key else 0
    return item if before + len(item.as_string()) <= WIDTH else _item(value, broken=True)


def _item(value: Any, broken: bool = False) -> Item:
    if isinstance(value, Mapping):
        table = tomlkit.inline_table()
        for key, each in _said(value).items():
            table.append(key, _item(each, broken))
        return table
    if isinstance(value, list | tuple):
        return _array([_item(each) for each in value], broken)
    item: Item = tomlkit.item(value)
    return item


def _array(items: list[Item], broken: bool) -> Array:
    array = tomlkit.array()
    texts = [item.as_string() for item in items]
    if not broken or sum(map(len, texts)) + 2 * len(texts) <= WIDTH // 2:
        array.extend(items)
        return array
    nested = any(isinstance(item, Array | InlineTable) for item in items)
    line: list[Item] = []
    width = 0
    for item, text in zip(items, texts, strict=True):
        if line and (nested or width + len(text) + 4 > WIDTH):
            array.add_line(*line)
            line, width = [], 0
        line.append(item)
        width += len(text) + 2
    array.add_line(*line)
    array.add_line(indent="")
    return array
