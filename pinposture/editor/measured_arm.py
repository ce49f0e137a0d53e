"""The measured configuration of an arm, read as lines of JSON from a file, a pipe or the standard input."""

from __future__ import annotations

import json
import os
import select
import stat
import sys
import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from threading import Event, Lock
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pinposture._validation import require_instance
from pinposture.arm import Arm
from pinposture.arm.configurations import NO_LIMIT
from pinposture.errors import FileError, InvalidValue, enumerated
from pinposture.motion.latest import Done, Latest

Array = NDArray[np.float64]

LINE_FORMAT = (
    'an object: {"name": [...], "position": [...]}, {"position": [...]} of all joints, or {"q": [...]}'
)


class ReadingSettings(NamedTuple):
    """How lines of joint states are read."""

    poll: float = 0.05
    """Time between two looks for more lines [s]."""

    longest_line: int = 2**20
    """Longest line; longer ones are cut off [bytes]."""

    cut_line: int = 200
    """How much is kept of a line that is cut off [bytes]."""

    most_read: int = 2**23
    """How much is read at once [bytes]."""

    most_lines: int = 1000
    """Most lines that are read at once; older ones are read only for joints that these lack."""


READING = ReadingSettings()


class JointPositions(NamedTuple):
    """The content of a line."""

    columns: NDArray[np.intp]  # the degrees of freedom with positions, (k,); perhaps none of this arm
    positions: Array  # of these, (k,) [rad or m]
    unknown: tuple[str, ...]  # names of joints that the arm does not have
    stamp: float | None  # time of the measurement, by the clock of the writer [s]; None if not given


class JointStateLines:
    """Reads lines for an arm.

    Attributes:
        names: names of the joints that lines can hold: those that drives move, and all others of the arm.
    """

    def __init__(self, arm: Arm) -> None:
        self._arm = arm
        self._all = np.arange(arm.nv)
        coupled = [coupling.joint for coupling in arm.couplings]
        self.names = tuple(dict.fromkeys([*arm.drives.names, *arm.joint_names, *coupled]))

    def read(self, line: bytes) -> JointPositions:
        """Read a line; other values of a message, velocities for instance, are ignored.

        Raises:
            InvalidValue: it is malformed; names what is wrong and what is allowed.
        """
        text = line[:200].decode("utf-8", "replace")
        try:
            content = json.loads(line.decode("utf-8-sig"))
        except json.JSONDecodeError as error:
            where = f"the line ({error.msg}, column {error.colno})"
            raise InvalidValue(where, text, LINE_FORMAT) from None
        except (ValueError, RecursionError):  # no UTF-8, a number of thousands of digits, lists without end
            raise InvalidValue("the line", text, LINE_FORMAT) from None
        if not isinstance(content, dict) or not {"position", "q"} & content.keys():
            raise InvalidValue("the line", content, LINE_FORMAT)
        if {"position", "q"} <= content.keys():
            raise InvalidValue("the line", "both position and q", "one of them")
        stamp = _stamp(content)
        if "q" in content:
            q = self._arm.checked(_numbers("q", content["q"], self._arm.nq), "q")
            return JointPositions(self._all, self._arm.positions(q), (), stamp)
        if "name" not in content:
            positions = _numbers("position", content["position"], self._arm.nv)
            return JointPositions(self._all, np.array(positions), (), stamp)
        return self._read_named(content["name"], content["position"], stamp)

    def _read_named(self, names: Any, positions: Any, stamp: float | None) -> JointPositions:
        if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
            raise InvalidValue("name", names, "a list of joint names")
        if len(set(names)) < len(names):
            twice = next(name for name in names if names.count(name) > 1)
            raise InvalidValue("name", twice, "each joint once")
        if positions == []:  # a message may hold velocities only
            names = []
        positions = _numbers("position", positions, len(names))
        known = self._arm.drives.find(dict(zip(names, positions, strict=True)))
        unknown = tuple(name for name in names if name not in self.names)
        return JointPositions(np.array([*known], dtype=np.intp), np.array([*known.values()]), unknown, stamp)


def _numbers(name: str, values: Any, count: int) -> list[float]:
    """Return so many finite numbers, or raise InvalidValue."""
    require_instance(name, values, list, f"a list of {count} numbers")
    if len(values) != count:
        raise InvalidValue(f"{name} (length)", len(values), f"{count}")
    for k, value in enumerate(values):
        # NaN fails every comparison; a bool is no number here.
        if type(value) not in (float, int) or not -NO_LIMIT <= value <= NO_LIMIT:
            raise InvalidValue(f"{name}[{k}]", value, f"a finite number from {-NO_LIMIT:g} to {NO_LIMIT:g}")
    return [float(value) for value in values]


def _stamp(content: Mapping[str, Any]) -> float | None:
    """Return the time of a line [s]: its `time` or `stamp`, or the stamp in the header of a ROS message."""
    header = content.get("header")
    for name, value in (
        ("time", content.get("time")),
        ("stamp", content.get("stamp")),
        ("header.stamp", header.get("stamp") if isinstance(header, dict) else None),
    ):
        if value is None:
            continue
        parts = [value, 0]
        if isinstance(value, dict):
            keys = (("sec", "nanosec"), ("secs", "nsecs"))  # of ROS 2 and ROS 1
            parts = next(([value[s], value[ns]] for s, ns in keys if {s, ns} <= value.keys()), [None])
        if all(type(part) in (float, int) and -1e18 < part < 1e18 for part in parts):
            return float(parts[0]) + 1e-9 * float(parts[1])
        raise InvalidValue(name, value, "seconds, or an object with sec and nanosec")
    return None


class Lines(NamedTuple):
    """Lines of a source."""

    first: int  # number of the first of them in the source, from 1
    lines: list[bytes]  # the lines, without their ends
    partial: bytes  # the beginning of the next line, if it has grown; perhaps all of a file's last line
    restarted: bool  # whether the source was read from its start again


class LineSource:
    """A source of lines.

    A file is followed: what is appended to it is read, and when it gets shorter or another file takes its
    name, it is read from the start. A pipe is read until it is closed here, even if its writers change; the
    standard input, until it ends.

    A library that watches files tells only that one has changed: to read on, to see that another file took
    the name, to keep half a line, and pipes would be left to do.
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
        self._is_file = stat.S_ISREG(os.fstat(self._fd).st_mode)
        self._offset = 0
        self._number = 0
        self._partial = b""
        self._cut = False

    def next(self, stop: Event) -> Lines | None:
        """Return new lines, after a short wait if there are none; None when no more can come.

        Args:
            stop: ends the wait.

        Raises:
            OSError: the source can no longer be read.
        """
        restarted = self._is_file and self._restarts()
        if restarted:
            self._partial = b""
            self._number = 0
            self._offset = 0
            self._cut = False
        content, ended = self._read()
        if ended and not self._is_file:
            if not content and not self._partial and self._path is None:
                return None
            if (self._partial + content)[-1:] not in (b"", b"\n"):
                content += b"\n"  # the writer has gone, and with it the rest of the line
        *lines, partial = (self._partial + content).split(b"\n")
        first = self._number + 1
        self._number += len(lines)
        if lines and self._cut:  # the rest of a line whose beginning has been returned
            del lines[0]
            first = first + 1
            self._cut = False
        if len(partial) > READING.longest_line:
            if not self._cut:
                lines.append(partial[: READING.cut_line])
            partial = b""
            self._cut = True
        self._partial = b"" if self._cut else partial
        if not content:
            stop.wait(READING.poll)
        return Lines(first, lines, self._partial if content else b"", restarted)

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
            # Otherwise a named pipe would wait for a writer.
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

    def _read(self) -> tuple[bytes, bool]:
        """Read what there is now; returns it, and whether the source is at an end."""
        if not self._is_file:
            poll = select.poll()
            poll.register(self._fd, select.POLLIN)
            if not poll.poll(1000.0 * READING.poll):
                return b"", False
        try:
            content = os.read(self._fd, READING.most_read)
        except BlockingIOError:
            return b"", False
        self._offset += len(content)
        return content, not content

    def _restarts(self) -> bool:
        """Return whether the file is to be read from the start; if another has its name, open that."""
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


@dataclass(frozen=True, eq=False)
class Measured:
    """The latest measurement of an arm."""

    q: Array  # its configuration, (nq,) [rad or m]; read-only. Joints without a measurement are at zero
    age: float  # time since the last line with positions of this arm [s]; infinite if there was none
    count: int  # number of lines with positions of this arm
    complaint: str  # the last error, with the number of its line and what is allowed; empty if there was none
    refused: int  # number of malformed lines
    skipped: int  # number of lines without positions of this arm, or older than lines that came with them
    stamp: float | None  # time of the measurement, by the clock of the writer [s]; None if not given
    unheard: tuple[str, ...]  # names of joints that drives move without a measurement


class JointStates:
    """Reads joint states as they come, and keeps the latest; close it, or use it in a `with`.

    Each line is an object of JSON: `{"name": ["j1", ...], "position": [...]}`, as in the JointState of ROS,
    of some joints that drives move (`Arm.drives`) in any order; `{"position": [...]}` of all joints in the
    order of `Arm.joint_names`; or
    `{"q": [...]}`, a configuration. Joints that a line does not contain keep their position. `time` or
    `stamp` may give the time [s].

    No content of a source makes it fail: lines that are malformed or not finite are counted and reported.

    Attributes:
        arm: the arm.

    Args:
        arm: the arm.
        source: name of a file, which is followed as it grows; of a named pipe; or "-" for the standard input.

    Raises:
        InvalidValue: not an arm, or not a name.
        FileError: the source is missing or cannot be read.
    """

    def __init__(self, arm: Arm, source: str | Path) -> None:
        require_instance("arm", arm, Arm, "an Arm")
        require_instance("source", source, str | Path, 'the name of a file or of a pipe, or "-"')
        self.arm = arm
        self._lines = JointStateLines(arm)
        self._positions = np.zeros(arm.nv)
        self._heard = np.zeros(arm.nv, dtype=np.bool_)
        self._unknown: set[str] = set()
        self._read_partial = b""
        self._lock = Lock()
        self._received = -np.inf
        self._latest = Measured(_read_only(arm.neutral()), np.inf, 0, "", 0, 0, None, self._unheard())
        self._reading: Latest[LineSource, None] = Latest(
            self._read, "pinposture-joint-states", deliver=self._end
        )
        self._reading.ask(LineSource(source))

    @property
    def latest(self) -> Measured:
        """The latest measurement; returns at once."""
        with self._lock:
            latest = self._latest
            received = self._received
        complaint = latest.complaint
        if latest.count and latest.unheard and not complaint:
            complaint = f"no positions yet, shown at zero: {enumerated(map(repr, latest.unheard))}"
        return replace(latest, age=time.monotonic() - received, complaint=complaint)

    @property
    def ended(self) -> bool:
        """Whether no more lines will be read."""
        return not self._reading.working

    def close(self) -> None:
        """Stop reading; what was read is kept."""
        self._reading.close()

    def __enter__(self) -> JointStates:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _read(self, source: LineSource, stop: Event) -> None:
        try:
            while not stop.is_set():
                came = source.next(stop)
                if came is None:
                    break
                if came.lines or came.partial or came.restarted:
                    self._take(came, stop)
        finally:
            source.close()

    def _end(self, done: Done[LineSource, None]) -> None:
        """Say why reading has ended, unless it was closed; else the last posture would look current."""
        error = done.error
        if error is None:
            return
        complaint = f"reading ended ({type(error).__name__}: {error})"
        if isinstance(error, OSError):
            complaint = f"{done.request.name} can no longer be read ({error.strerror or error})"
        with self._lock:
            self._latest = replace(self._latest, complaint=complaint)

    def _take(self, came: Lines, stop: Event) -> None:
        """Read lines, newest first: older ones only add joints that newer ones lack."""
        batch = _Batch(self.arm.nv)
        before = b"" if came.restarted else self._read_partial
        self._read_partial = b"" if came.lines else before
        # The last line of a file may never be ended; one that is half an object has to wait.
        partial = came.partial.strip()
        if partial.endswith(b"}") and partial != self._read_partial:
            try:
                self._add(batch, came.first + len(came.lines), partial)
                self._read_partial = partial
            except InvalidValue:
                pass
        for k in reversed(range(len(came.lines))):
            if len(came.lines) - k > READING.most_lines and batch.heard.all():
                batch.skipped += sum(1 for line in came.lines[: k + 1] if line.strip())
                break
            line = came.lines[k].strip()
            if k == 0 and before and line.startswith(before):  # which was read before its end came
                line = line[len(before) :].strip()
            if not line:
                continue
            try:
                self._add(batch, came.first + k, line)
            except InvalidValue as error:
                batch.refused += 1
                batch.complaint = batch.complaint or f"line {came.first + k}: {error}"
            if stop.is_set():
                return
        self._publish(batch)

    def _add(self, batch: _Batch, number: int, line: bytes) -> None:
        """Add the content of a line to that of newer ones.

        Raises:
            InvalidValue: it is malformed.
        """
        read = self._lines.read(line)
        unknown = [name for name in read.unknown if name not in self._unknown]
        if unknown:
            self._unknown.update(unknown)
            joints = (
                f"{enumerated(map(repr, unknown))}; the arm has {enumerated(map(repr, self._lines.names))}"
            )
            batch.complaint = batch.complaint or f"line {number} names unknown joints: {joints}"
        if not len(read.columns):
            batch.skipped += 1
            return
        if not batch.count:
            batch.stamp = read.stamp
        batch.count += 1
        new = ~batch.heard[read.columns]
        batch.positions[read.columns[new]] = read.positions[new]
        batch.heard[read.columns] = True

    def _publish(self, batch: _Batch) -> None:
        self._positions = np.where(batch.heard, batch.positions, self._positions)
        self._heard |= batch.heard
        before = self._latest
        latest = Measured(
            q=_read_only(self.arm.configuration(self._positions)) if batch.count else before.q,
            age=np.inf,
            count=before.count + batch.count,
            complaint=batch.complaint or before.complaint,
            refused=before.refused + batch.refused,
            skipped=before.skipped + batch.skipped,
            stamp=batch.stamp if batch.count else before.stamp,
            unheard=self._unheard(),
        )
        with self._lock:
            self._latest = latest
            if batch.count:
                self._received = time.monotonic()

    def _unheard(self) -> tuple[str, ...]:
        names = self.arm.drives.names
        return tuple(names[column] for column in self.arm.columns if not self._heard[column])


class _Batch:
    """The content of lines that came together: as in `Measured`, and which joints they contain."""

    def __init__(self, nv: int) -> None:
        self.positions = np.zeros(nv)
        self.heard = np.zeros(nv, dtype=np.bool_)
        self.count = 0
        self.refused = 0
        self.skipped = 0
        self.complaint = ""
        self.stamp: float | None = None


def _read_only(q: Array) -> Array:
    q.flags.writeable = False
    return q
