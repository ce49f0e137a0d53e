"""Reading files with clear errors, writing them atomically, and relative paths."""

from __future__ import annotations

import codecs
import csv
import io
import json
import os
import re
import sys
import uuid
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pinposture.errors import FileError

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

if TYPE_CHECKING:
    from matplotlib.figure import Figure

RESULT_FORMATS = ("npz", "csv", "json", "png", "html")
"""Formats of a saved motion: complete, joints as a table and for ROS, plot, animation."""


def write_bytes(path: Path, content: bytes) -> None:
    """Write a file atomically: as a draft next to its destination, which then replaces it.

    If writing fails, an existing file stays unchanged, and no reader sees a partial file. Missing directories
    are created; a link is followed, not replaced.

    Raises:
        FileError: it cannot be written, or a directory or device has that name.
    """
    check_writable(path.parent)
    if path.exists() and not path.is_file():
        kind = "a directory" if path.is_dir() else "a device"
        raise FileError(path, f"is {kind}; allowed: a file, or a new name")
    try:
        final = path.resolve()
    except RuntimeError:  # links in a circle; from Python 3.13 on, these are left as they are
        final = path
    if final.is_symlink():
        raise FileError(path, "cannot be written (its links lead in a circle)")
    draft = final.with_name(f".{final.name}.{uuid.uuid4().hex}")
    try:
        final.parent.mkdir(parents=True, exist_ok=True)
        try:
            with draft.open("xb") as file:
                file.write(content)
                file.flush()
                os.fsync(file.fileno())
            draft.replace(final)
        finally:
            draft.unlink(missing_ok=True)
    except OSError as error:
        raise FileError(path, f"cannot be written ({error.strerror or error})") from error


def read_bytes(path: Path) -> bytes:
    """Return the content of a file.

    Raises:
        FileError: it is missing or cannot be read.
    """
    try:
        return path.read_bytes()
    except FileNotFoundError:
        raise FileError(path, "no such file") from None
    except OSError as error:
        raise FileError(path, f"cannot be read ({error.strerror or error})") from error
    except ValueError as error:  # a name with a null byte
        raise FileError(path, f"cannot be read ({error})") from error


def read_text(path: Path) -> str:
    """Return the text of a UTF-8 file, with its own line ends and without a byte order mark.

    Raises:
        FileError: it is missing, cannot be read, or is not UTF-8 text.
    """
    try:
        return read_bytes(path).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise FileError(path, f"is not UTF-8 text (byte {error.start})") from None


_DECLARATION = re.compile(r"""(\s*<\?xml\b[^>]*?)\s+encoding\s*=\s*(["'])\s*([A-Za-z0-9._:-]*)\s*\2""")


def read_xml(path: Path) -> str:
    """Return the text of an XML file; see `decode_xml`.

    Raises:
        FileError: it is missing, cannot be read, or is not text in its encoding.
    """
    return decode_xml(read_bytes(path), path)


def decode_xml(content: bytes, source: str | Path) -> str:
    """Return XML as text, decoded as its byte order mark or its declaration says; UTF-8 without either.

    Args:
        content: the bytes.
        source: the file, or its name in error messages.

    Returns:
        The text, which no longer declares an encoding, except UTF-8.

    Raises:
        FileError: an unknown encoding, or bytes that are none of its characters.
    """
    head = content[:400]  # a declaration comes first
    declared = _DECLARATION.match(head.decode("latin-1"))
    # First bytes, and the encoding that they mean whatever is declared.
    marks = (
        (codecs.BOM_UTF8, "utf-8-sig"),
        (codecs.BOM_UTF32_LE, "utf-32"),  # before UTF-16, whose mark is the beginning of it
        (codecs.BOM_UTF32_BE, "utf-32"),
        (codecs.BOM_UTF16_LE, "utf-16"),
        (codecs.BOM_UTF16_BE, "utf-16"),
        ("<?".encode("utf-16-le"), "utf-16-le"),
        ("<?".encode("utf-16-be"), "utf-16-be"),
    )
    marked = next((name for label, name in marks if head.startswith(label)), None)
    encoding = marked or (declared[3] if declared else "utf-8")
    if marked is None and encoding.lower().startswith(("utf-16", "utf16", "utf-32", "ucs", "iso-10646-ucs")):
        encoding = "utf-8"  # a declaration of single bytes contradicts itself
    try:
        text = content.decode(encoding)
    except UnicodeError as error:
        what = f"byte {error.start}" if isinstance(error, UnicodeDecodeError) else str(error)
        said = ", the encoding that it declares" if declared and not marked else ""
        spoken = "UTF-8" if encoding.lower().replace("_", "-") in ("utf-8", "utf8", "utf-8-sig") else encoding
        raise FileError(source, f"is not {spoken} text ({what}){said}") from None
    except (LookupError, ValueError):
        reason = f"declares the encoding {encoding!r}, which is unknown; save the file as UTF-8"
        raise FileError(source, reason) from None
    return without_encoding(text)


def without_encoding(text: str) -> str:
    """Return XML without the encoding that it declares, because text has none; UTF-8 is left."""
    declared = _DECLARATION.match(text)
    if declared is None or declared[3].lower() in ("utf-8", "utf8"):
        return text
    return declared[1] + text[declared.end() :]


def parse_json(path: Path, text: str, **options: Any) -> Any:
    """Return the content of a JSON text; `options` are those of `json.loads`.

    Raises:
        FileError: it is malformed; names the file, and the line if that is known.
    """
    try:
        return json.loads(text, **options)
    except json.JSONDecodeError as error:
        raise FileError(path, f"line {error.lineno}, column {error.colno}: {error.msg}") from error
    except ValueError as error:  # a number of thousands of digits
        raise FileError(path, str(error)) from error
    except RecursionError as error:
        raise FileError(path, "lists or objects are nested too deep") from error


def parse_toml(text: str) -> dict[str, Any]:
    """Return the content of a TOML text; raises a ValueError that names the line, or a RecursionError."""
    content: dict[str, Any] = tomllib.loads(text)
    return content


def write_text(path: Path, text: str) -> None:
    """Write a UTF-8 text file as `write_bytes` does."""
    write_bytes(path, text.encode())


def write_table(path: Path, rows: Iterable[Sequence[object]]) -> None:
    """Write a CSV file as `write_text` does: floats at full precision, None as an empty cell."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(rows)
    write_text(path, text.getvalue())


def write_figure(path: Path, figure: Figure) -> None:
    """Write a matplotlib figure as PNG, as `write_bytes` does, whatever the suffix."""
    picture = io.BytesIO()
    figure.savefig(picture, format="png")
    write_bytes(path, picture.getvalue())


def require_suffix(path: Path, *allowed: str, hint: str = "") -> str:
    """Return the suffix of a file in lower case; raise FileError, with a hint, if it is not allowed."""
    suffix = path.suffix.lower()
    if suffix not in allowed:
        raise FileError(path, f"the name ends in {path.suffix!r}; allowed: {', '.join(allowed)}{hint}")
    return suffix


def with_suffix(path: Path, *allowed: str, hint: str = "") -> Path:
    """Return the path of a file to write, with the first of these suffixes if it has none.

    Raises:
        FileError: it has another suffix, or no name at all.
    """
    if not path.name:
        raise FileError(path, "is a directory; allowed: the name of a file")
    if not path.suffix:
        return path.with_name(path.name + allowed[0])
    require_suffix(path, *allowed, hint=f", or no ending{hint}")
    return path


def check_writable(directory: Path) -> None:
    """Check that files can be created in a directory, for instance before a long computation.

    Args:
        directory: the directory; it need not exist yet.

    Raises:
        FileError: it is a file, or it is not writable, or cannot be created.
    """
    there = directory.absolute()
    while not there.exists() and there != there.parent:
        there = there.parent
    if not there.is_dir():
        raise FileError(there, "is a file; allowed: a directory")
    if not os.access(there, os.W_OK):
        raise FileError(there, "cannot be written (permission denied)")


def settled(path: str | Path) -> Path:
    """Return the absolute path of a file, without links and dots in its parent; a link itself is kept."""
    given = Path(path)
    try:
        return Path(os.path.realpath(given.parent)) / given.name
    except (OSError, ValueError):  # the path cannot be resolved
        return given.absolute()


def relative(path: Path, folder: Path) -> str:
    """Return the path of a file relative to a folder, with slashes on every system; absolute if need be."""
    there = settled(path)
    try:
        words = Path(os.path.relpath(there, os.path.realpath(folder))).as_posix()
    except ValueError:  # on another drive
        return there.as_posix()
    return there.as_posix() if words.startswith("~") else words  # which would stand for a home directory
