"""From a file or a string to the XML elements of a robot, safely."""

from __future__ import annotations

import os
import re
import xml.etree.ElementTree as ET
from pathlib import Path
from xml.parsers import expat

from pinposture.errors import FileError, InvalidValue, URDFError

_BLANK = "\ufeff \t\r\n"
_DEEPEST = 400  # the XML parser behind Pinocchio gives up a little below 500
_VECTOR_ATTRIBUTE = re.compile(r"""\b(?:xyz|rpy)\s*=\s*(?:"[^"<]*"|'[^'<]*')""")
_INFINITE_ATTRIBUTE = re.compile(r"""(\b(?:velocity|effort)\s*=\s*["'])\+?inf(?:inity)?(?=["'])""", re.I)


def load_text(source: str | Path) -> tuple[str, str]:
    """Read a description without looking at what it says.

    Args:
        source: path of a file, or the text itself if it begins with "<".

    Returns:
        The text, and what to call it in messages: the path or "URDF text".

    Raises:
        InvalidValue: neither a path nor text.
        FileError: the file is missing, not readable, not UTF-8 text, or empty.
        URDFError: text of several lines, thus not a path, that does not begin with "<".
    """
    if not isinstance(source, (str, os.PathLike)):
        raise InvalidValue("source", source, "path of a URDF file, or URDF text")
    if isinstance(source, str):
        text = source.lstrip(_BLANK)
        if text.startswith("<"):
            return source, "URDF text"
        if "\n" in text:
            raise URDFError("URDF text", "line 1", f"begins with {text[:20]!r}; allowed: '<'")
    path = Path(source)
    try:
        text = path.read_bytes().decode("utf-8")
    except FileNotFoundError:
        raise FileError(path, "no such file") from None
    except IsADirectoryError:
        raise FileError(path, "is a directory; allowed: a URDF file") from None
    except UnicodeDecodeError as error:
        raise FileError(path, f"is not UTF-8 text (byte {error.start})") from None
    except (OSError, ValueError) as error:
        raise FileError(path, f"cannot be read: {getattr(error, 'strerror', None) or error}") from None
    if not text.strip(_BLANK):
        raise FileError(path, "is empty")
    return text, str(path)


def parse_xml(text: str, source: str) -> ET.Element:
    """Parse XML, refusing what could fetch files or blow up.

    Args:
        text: the XML; blanks may precede it.
        source: what to call it in messages.

    Returns:
        The root element. Names keep their namespace prefixes, because extensions of URDF use prefixes that
        they never declare.

    Raises:
        URDFError: malformed (names the line), with a document type, or nested too deep.
    """
    body = text.lstrip(_BLANK)
    if _declares_document_type(body):
        raise URDFError(source, "<!DOCTYPE>", "is refused, for it can define entities; remove it")
    builder, parser = ET.TreeBuilder(), expat.ParserCreate("utf-8")
    depth = 0

    def start(tag: str, attributes: dict[str, str]) -> None:
        nonlocal depth
        depth += 1
        if depth > _DEEPEST:
            raise URDFError(source, f"<{tag}>", f"is nested too deep; allowed: {_DEEPEST} levels")
        builder.start(tag, attributes)

    def end(tag: str) -> None:
        nonlocal depth
        depth -= 1
        builder.end(tag)

    parser.StartElementHandler, parser.EndElementHandler = start, end
    parser.CharacterDataHandler = builder.data
    try:
        parser.Parse(body, True)
    except expat.ExpatError as error:
        line = error.lineno + text[: len(text) - len(body)].count("\n")
        reason = f"is not well-formed XML: {expat.ErrorString(error.code)}"
        raise URDFError(source, f"line {line}", reason) from None
    except UnicodeEncodeError as error:
        raise URDFError(source, f"character {error.start}", "is half of a surrogate pair") from None
    return builder.close()


def text_for_pinocchio(text: str) -> str:
    """The same XML as Pinocchio can read it.

    Each vector is on one line, for Pinocchio splits them at blanks only; an infinite speed or effort is a
    huge number, for it reads digits only.
    """
    text = _VECTOR_ATTRIBUTE.sub(lambda match: re.sub(r"[\t\r\n]", " ", match[0]), text.lstrip(_BLANK))
    return _INFINITE_ATTRIBUTE.sub(r"\g<1>1e300", text)


def _declares_document_type(text: str) -> bool:
    # Answered without the parser, which expands entities even when a handler has raised.
    at = text.find("<")
    while at >= 0:
        if text.startswith("<!--", at):
            at = text.find("-->", at + 4)
        elif text.startswith("<?", at):
            at = text.find("?>", at + 2)
        else:
            return text.startswith("<!DOCTYPE", at)
        at = text.find("<", at) if at >= 0 else at
    return False
