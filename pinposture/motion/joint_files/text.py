"""Text files, and what can be wrong with them before they are understood."""

from __future__ import annotations

from pathlib import Path

from pinposture.errors import FileError


def read_text(path: Path) -> str:
    """The text of a file in UTF-8, with its line ends as they are.

    Raises:
        FileError: it is missing, unreadable, or holds something else.
    """
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            return file.read()
    except FileNotFoundError:
        raise FileError(path, "no such file") from None
    except UnicodeDecodeError as error:
        raise FileError(path, f"not UTF-8 text: {error.reason} at byte {error.start}") from error
    except OSError as error:
        raise FileError(path, f"cannot be read ({error.strerror or error})") from error
