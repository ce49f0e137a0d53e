"""Lines as they come: from a file that grows, a named pipe, or the standard input."""

from __future__ import annotations

import os
import select
import stat
import sys
from pathlib import Path
from threading import Event
from typing import NamedTuple

from pinposture.errors import FileError

POLL = 0.05
"""How often is looked for more [s]."""
LONGEST = 2**20
"""Bytes from which on a line is cut off."""
_CHUNK, _MOST = 2**16, 2**23  # bytes that are read at once, and before lines are handed out
_BEGINNING = 200  # bytes that are left of a line that is cut off


class Lines(NamedTuple):
    """Lines that came.

    Attributes:
        first: number of the first of them in the source, from 1.
        lines: the lines, without their ends.
        begun: what there is of the line after them, if there is more of it than before. What a file ends with
            may be all of that line.
        anew: whether the source was read from its start again.
    """

    first: int
    lines: list[bytes]
    begun: bytes
    anew: bool


class LineSource:
    """A source of lines.

    A file is followed: what is added to it comes, and when it is shorter than before or another file has
    taken its name, it is read from the start. A pipe is read until it is closed here, whoever writes into it;
    the standard input, until it ends.
    """

    def __init__(self, source: str | Path) -> None:
        """Open a source.

        Args:
            source: name of a file or of a named pipe; "-" for the standard input.

        Raises:
            FileError: missing, a directory, not readable, or there is no standard input.
        """
        self.name = "standard input" if source == "-" else str(source)
        self._path = None if source == "-" else Path(source)
        self._fd = self._open()
        self._file = stat.S_ISREG(os.fstat(self._fd).st_mode)
        self._offset, self._number, self._begun, self._cut = 0, 0, b"", False

    def next(self, stop: Event) -> Lines | None:
        """The lines that have come since, after a short wait if there are none; None when no more can come.

        Args:
            stop: ends the wait.

        Raises:
            OSError: the source cannot be read any more.
        """
        anew = self._file and self._begins_anew()
        if anew:
            self._begun, self._number, self._offset, self._cut = b"", 0, 0, False
        content, ended = self._read(stop)
        if ended and not self._file:
            if not content and not self._begun and self._path is None:
                return None
            if (self._begun + content)[-1:] not in (b"", b"\n"):
                content += b"\n"  # who wrote into it has gone, and with it the rest of the line
        *lines, begun = (self._begun + content).split(b"\n")
        first = self._number + 1
        self._number += len(lines)
        if lines and self._cut:  # the rest of a line of which the beginning has been handed out
            del lines[0]
            first, self._cut = first + 1, False
        if len(begun) > LONGEST:
            if not self._cut:
                lines.append(begun[:_BEGINNING])
            begun, self._cut = b"", True
        self._begun = b"" if self._cut else begun
        if not content:
            stop.wait(POLL)
        return Lines(first, lines, self._begun if content else b"", anew)

    def close(self) -> None:
        """Close it, unless it is the standard input."""
        if self._path is not None and self._fd >= 0:
            os.close(self._fd)
            self._fd = -1

    def _open(self) -> int:
        if self._path is None:
            try:
                return sys.stdin.fileno()
            except (AttributeError, ValueError, OSError):
                raise FileError("-", "there is no standard input") from None
        try:
            # A named pipe would else wait for somebody to write into it.
            descriptor = os.open(self._path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0))
        except FileNotFoundError:
            raise FileError(self._path, "no such file") from None
        except (OSError, ValueError) as error:
            reason = getattr(error, "strerror", None) or error
            raise FileError(self._path, f"cannot be read ({reason})") from error
        if stat.S_ISDIR(os.fstat(descriptor).st_mode):
            os.close(descriptor)
            raise FileError(self._path, "is a directory; allowed: a file, a named pipe, or -")
        return descriptor

    def _read(self, stop: Event) -> tuple[bytes, bool]:
        """What there is to read now, and whether it is at an end."""
        parts: list[bytes] = []
        size, ended = 0, False
        while size < _MOST and not ended and not stop.is_set():
            if not self._file and not self._ready(0.0 if parts else POLL):
                break
            try:
                part = os.read(self._fd, _CHUNK)
            except BlockingIOError:
                break
            parts.append(part)
            size += len(part)
            ended = not part
        self._offset += size
        return b"".join(parts), ended

    def _ready(self, timeout: float) -> bool:
        """Whether there is something to read, or an end, after a wait at most."""
        poll = select.poll()
        poll.register(self._fd, select.POLLIN)
        return bool(poll.poll(1000.0 * timeout))

    def _begins_anew(self) -> bool:
        """Whether the file is to be read from the start; if another has its name, opens that."""
        now = os.fstat(self._fd)
        if now.st_size > self._offset:
            return False
        if self._path is not None:
            try:
                named = self._path.stat()
            except OSError:  # it has been removed, or another is about to take its name
                return False
            if stat.S_ISREG(named.st_mode) and not os.path.samestat(now, named):
                try:
                    other = self._open()
                except FileError:
                    return False
                os.close(self._fd)
                self._fd = other
                return True
        if now.st_size < self._offset:
            os.lseek(self._fd, 0, os.SEEK_SET)
            return True
        return False
