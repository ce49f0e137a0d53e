"""What a file says, shown in a message: on one line, and not all of it."""

from __future__ import annotations

LONGEST = 100
"""Characters of a value that are shown."""


def shown(value: object) -> str:
    """A value in the notation of Python, cut short."""
    return cut(repr(value))


def shown_key(key: str) -> str:
    """A key as it is, or in quotes if it could be taken for something else."""
    return cut(key if key.isprintable() and key.strip() == key != "" else repr(key))


def cut(text: str) -> str:
    """The beginning of a text, and all of it if it is short."""
    return text if len(text) <= LONGEST else text[: LONGEST - 4] + " ..."
