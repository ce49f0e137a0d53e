"""Files that appear whole or not at all."""

from __future__ import annotations

import os
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from pinposture.errors import FileError


@contextmanager
def replacing(path: Path) -> Iterator[BinaryIO]:
    """Write a file beside its final place, and put it there when the block ends without error.

    A file of that name stays as it was until then, and for good if the block raises; no reader ever sees
    half of the new one. Missing directories are made.

    Args:
        path: the file to write.

    Yields:
        The file to write to.

    Raises:
        FileError: it cannot be written.
    """
    draft = path.with_name(f".{path.name}.{uuid.uuid4().hex}")
    try:
        if path.exists() and not path.is_file():  # a directory, or a device
            raise FileError(path, "is not a file; allowed: a file, or a name that is free")
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            with draft.open("xb") as file:
                yield file
                file.flush()
                os.fsync(file.fileno())
            draft.replace(path)
        finally:
            draft.unlink(missing_ok=True)
    except FileError:
        raise
    except OSError as error:
        raise FileError(path, f"cannot be written ({error.strerror or error})") from error


def write_text(path: Path, text: str) -> None:
    """Write a UTF-8 text file in the way of `replacing`."""
    with replacing(path) as file:
        file.write(text.encode())
