"""What was said of parts of a task, where that still holds, in the words of a new file."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Hashable, Mapping
from operator import eq
from pathlib import Path
from typing import Any, TypeVar

from pinposture.errors import PostureError, PostureWarning
from pinposture.task.paths import relative
from pinposture.task.reading.content import Content
from pinposture.task.reading.document import Document, Table
from pinposture.task.reading.showing import shown

Part = TypeVar("Part", bound=Hashable)


class Wording:
    """Descriptions of parts of a task, to be written into a file.

    Attributes:
        file: the file that is to be written.
    """

    def __init__(self, file: Path, described: Mapping[Hashable, object]) -> None:
        """Prepare for a file.

        Args:
            file: the file that is to be written.
            described: as in `Task`.
        """
        self.file, self._described = file, described

    @property
    def folder(self) -> Path:
        """Where paths in the file begin."""
        return self.file.parent

    def told(
        self,
        part: Part,
        key: str,
        read: Callable[[Table], object],
        same: Callable[[Any, Part], bool] = eq,
    ) -> Any:
        """What is to stand in the file for a part, if that was said and is still true; else None.

        Args:
            part: the part.
            key: what it stands under.
            read: what makes the part of a table with that key.
            same: whether two parts are equal.
        """
        if part not in self._described:
            return None
        plain = plain_in(self._described[part], self.folder)
        why = "which gives another one now"
        try:
            if same(read(self.table(key, plain)), part):
                return plain
        except PostureError as error:
            why = f"but {getattr(error, 'reason', error)}"
        message = f"{self.file}: {key} was {shown(plain)}, {why}; it is written out"
        warnings.warn(message, PostureWarning, stacklevel=5)
        return None

    def table(self, key: str, plain: object) -> Table:
        """A table of the file that holds nothing but this."""
        return Document(self.file, Content({key: plain}, None)).root


def plain_in(value: Any, folder: Path) -> Any:
    """Plain data with paths in the words of a file in this folder."""
    if isinstance(value, Path):
        return relative(value, folder)
    if isinstance(value, Mapping):
        return {key: plain_in(each, folder) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [plain_in(each, folder) for each in value]
    return value
