"""On which line of a TOML file each of its tables, keys and list items begins."""

from __future__ import annotations

import re
import sys
from bisect import bisect_right

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

Place = tuple[str | int, ...]
"""A way through a file: names of keys, and numbers of list items from 0."""

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
    """One passage through a file, which is not checked on the way."""

    def __init__(self, text: str) -> None:
        self.found: dict[Place, int] = {}
        self._text, self._at = text, 0
        self._breaks = [match.start() for match in re.finditer("\n", text)]
        self._last: dict[Place, int] = {}  # the last of each list of tables so far

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
