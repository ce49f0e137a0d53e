"""Where an arm is measured to be, told by lines of JSON from a file, a pipe or the standard input."""

from __future__ import annotations

import json
import logging
import os
import select
import stat
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from threading import Event, Lock, Thread
from types import TracebackType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pinposture.arm import Arm
from pinposture.arm.configurations import UNLIMITED
from pinposture.errors import FileError, InvalidValue

# What a line of JSON says of where the joints of an arm are.

Array = NDArray[np.float64]

ALLOWED = 'an object: {"name": [...], "position": [...]}, {"position": [...]} of all joints, or {"q": [...]}'
_SECONDS = (("sec", "nanosec"), ("secs", "nsecs"))  # as ROS 2 writes a time, and ROS 1


class Told(NamedTuple):
    """What a line says.

    Attributes:
        columns: the degrees of freedom that it tells of, (k,); none, if it tells of none of this arm.
        positions: where these are, (k,) [rad or m].
        unknown: names of joints that the arm has not.
        stamp: when that was, by the clock of who wrote it [s]; None if it does not say.
    """

    columns: NDArray[np.intp]
    positions: Array
    unknown: tuple[str, ...]
    stamp: float | None


class JointStateLines:
    """Reads lines for an arm.

    Attributes:
        columns: degree of freedom of each joint that has one, by its name.
    """

    def __init__(self, arm: Arm) -> None:
        self._arm, self._all = arm, np.arange(arm.nv)
        joints = zip(list(arm.model.joints)[1:], list(arm.model.names)[1:], strict=True)
        self.columns = {str(name): int(joint.idx_v) for joint, name in joints if joint.nv == 1}

    def read(self, line: bytes) -> Told:
        """What a line says; whatever else a message has, velocities for instance, is not looked at.

        Raises:
            InvalidValue: it is no such line; names what is wrong and what is allowed.
        """
        try:
            said = json.loads(line.decode("utf-8-sig"))
        except json.JSONDecodeError as error:
            raise InvalidValue(
                f"the line ({error.msg}, column {error.colno})", _text(line), ALLOWED
            ) from None
        except (ValueError, RecursionError):  # no UTF-8, a number of thousands of digits, lists without end
            raise InvalidValue("the line", _text(line), ALLOWED) from None
        if not isinstance(said, dict) or not {"position", "q"} & said.keys():
            raise InvalidValue("the line", said, ALLOWED)
        if {"position", "q"} <= said.keys():
            raise InvalidValue("the line", "both position and q", "one of them")
        stamp = _stamp(said)
        if "q" in said:
            q = self._arm.checked(_numbers("q", said["q"], self._arm.nq), "q")
            return Told(self._all, self._arm.positions(q), (), stamp)
        if "name" not in said:
            positions = _numbers("position", said["position"], self._arm.nv)
            return Told(self._all, np.array(positions), (), stamp)
        return self._named(said["name"], said["position"], stamp)

    def _named(self, names: Any, positions: Any, stamp: float | None) -> Told:
        if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
            raise InvalidValue("name", names, "a list of names of joints")
        if len(set(names)) < len(names):
            twice = next(name for name in names if names.count(name) > 1)
            raise InvalidValue("name", twice, "each joint once")
        if positions == []:  # a message may tell velocities alone
            names = []
        positions = _numbers("position", positions, len(names))
        known = [(self.columns[name], k) for k, name in enumerate(names) if name in self.columns]
        columns = np.array([column for column, _ in known], dtype=np.intp)
        unknown = tuple(name for name in names if name not in self.columns)
        return Told(columns, np.array([positions[k] for _, k in known]), unknown, stamp)


def _numbers(name: str, values: Any, count: int) -> list[float]:
    """So many finite numbers."""
    if not isinstance(values, list):
        raise InvalidValue(name, values, f"a list of {count} numbers")
    if len(values) != count:
        raise InvalidValue(f"{name} (length)", len(values), f"{count}")
    for k, value in enumerate(values):
        # NaN is in no order to anything; a truth value is no number here.
        if type(value) not in (float, int) or not -UNLIMITED <= value <= UNLIMITED:
            raise InvalidValue(f"{name}[{k}]", value, f"a finite number within {UNLIMITED:g} either way")
    return [float(value) for value in values]


def _stamp(said: Mapping[str, Any]) -> float | None:
    """When a line says that it was: as `time` or `stamp`, or in the header that messages of ROS have."""
    header = said.get("header")
    for name, value in (
        ("time", said.get("time")),
        ("stamp", said.get("stamp")),
        ("header.stamp", header.get("stamp") if isinstance(header, dict) else None),
    ):
        if value is None:
            continue
        parts = [value, 0]
        if isinstance(value, dict):
            parts = next(([value[s], value[ns]] for s, ns in _SECONDS if {s, ns} <= value.keys()), [None])
        if all(type(part) in (float, int) and -1e18 < part < 1e18 for part in parts):
            return float(parts[0]) + 1e-9 * float(parts[1])
        raise InvalidValue(name, value, "seconds, or an object with sec and nanosec")
    return None


def _text(line: bytes) -> str:
    return line[:200].decode("utf-8", "replace")


# Lines as they come: from a file that grows, a named pipe, or the standard input.

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


# Where an arm is measured to be, told by lines of JSON as they come.

logger = logging.getLogger(__name__)

LOOKED_AT = 1000
"""Of many lines that came at once so many are looked at, and older ones only for joints that these lack."""
_NAMED = 6  # joints that a complaint names


@dataclass(frozen=True, eq=False)
class Measured:
    """The latest that is known of an arm.

    Attributes:
        q: its configuration, (nq,) [rad or m]; read-only. Joints that nobody told of are at zero.
        age: how long ago a line last told something of this arm [s]; infinite if none has.
        count: how many lines told something.
        complaint: what was last wrong, with the number of its line and what is allowed; empty if nothing was.
        refused: how many lines were malformed.
        skipped: how many told nothing of this arm, or were overtaken before they were looked at.
        stamp: when it was measured, by the clock of who wrote it [s]; None if it was not said.
        unheard: names of joints of the chain that no line has told of.
    """

    q: Array
    age: float
    count: int
    complaint: str
    refused: int
    skipped: int
    stamp: float | None
    unheard: tuple[str, ...]


class JointStates:
    """Reads joint states in a thread of its own, and keeps the latest; close it, or use it in a `with`.

    Each line is an object of JSON: `{"name": ["j1", ...], "position": [...]}`, as ROS has it in its
    JointState, of some joints in any order; `{"position": [...]}` of all joints in the order of
    `Arm.joint_names`; or `{"q": [...]}`, a configuration. Joints that a line does not tell of keep the
    position they had. `time` or `stamp` may say when that was [s].

    Nothing that a source says makes it fail: lines that are malformed or not finite are counted and told of.

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
        if not isinstance(arm, Arm):
            raise InvalidValue("arm", arm, "an Arm")
        if not isinstance(source, (str, Path)):
            raise InvalidValue("source", source, 'the name of a file or of a pipe, or "-"')
        self.arm = arm
        self._source, self._lines = LineSource(source), JointStateLines(arm)
        self._positions, self._heard = np.zeros(arm.nv), np.zeros(arm.nv, dtype=np.bool_)
        self._unknown: set[str] = set()
        self._taken = b""
        self._lock, self._stop = Lock(), Event()
        self._received = -np.inf
        self._latest = Measured(_fixed(arm.neutral()), np.inf, 0, "", 0, 0, None, self._unheard())
        self._thread = Thread(target=self._run, name="pinposture-joint-states", daemon=True)
        self._thread.start()

    @property
    def latest(self) -> Measured:
        """The latest that is known; returns at once."""
        with self._lock:
            latest, received = self._latest, self._received
        complaint = latest.complaint
        if latest.count and latest.unheard and not complaint:
            complaint = f"never told of, and taken to be at zero: {_listed(latest.unheard)}"
        return replace(latest, age=time.monotonic() - received, complaint=complaint)

    @property
    def ended(self) -> bool:
        """Whether no more will come."""
        return not self._thread.is_alive()

    def close(self) -> None:
        """Read no more; what was read is kept."""
        self._stop.set()
        self._thread.join(timeout=5.0)

    def __enter__(self) -> JointStates:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _run(self) -> None:
        try:
            while not self._stop.is_set():
                came = self._source.next(self._stop)
                if came is None:
                    break
                if came.lines or came.begun or came.anew:
                    self._take(came)
        except OSError as error:
            self._complain(f"{self._source.name} cannot be read any more ({error.strerror or error})")
        except Exception as error:  # a thread that ends without a word would leave a posture that looks alive
            logger.exception("reading joint states ended")
            self._complain(f"reading ended ({type(error).__name__}: {error})")
        finally:
            self._source.close()

    def _complain(self, complaint: str) -> None:
        with self._lock:
            self._latest = replace(self._latest, complaint=complaint)

    def _take(self, came: Lines) -> None:
        """Take in lines, the newest first: what they tell, older ones cannot change."""
        news = _News(self.arm.nv)
        taken = b"" if came.anew else self._taken
        self._taken = b"" if came.lines else taken
        # The last line of a file may lack its end for good; half of an object is none, and has to wait.
        begun = came.begun.strip()
        if begun.endswith(b"}") and begun != self._taken:
            try:
                self._tell(news, came.first + len(came.lines), begun)
                self._taken = begun
            except InvalidValue:
                pass
        for k in reversed(range(len(came.lines))):
            if len(came.lines) - k > LOOKED_AT and news.told.all():
                news.skipped += sum(1 for line in came.lines[: k + 1] if line.strip())
                break
            line = came.lines[k].strip()
            if k == 0 and taken and line.startswith(taken):  # that was told before its end came
                line = line[len(taken) :].strip()
            if not line:
                continue
            try:
                self._tell(news, came.first + k, line)
            except InvalidValue as error:
                news.refused += 1
                news.complaint = news.complaint or f"line {came.first + k}: {error}"
            if self._stop.is_set():
                return
        self._publish(news)

    def _tell(self, news: _News, number: int, line: bytes) -> None:
        """Add what a line tells to what newer ones do.

        Raises:
            InvalidValue: it is malformed.
        """
        told = self._lines.read(line)
        strange = [name for name in told.unknown if name not in self._unknown]
        if strange:
            self._unknown.update(strange)
            joints = f"{_listed(strange)}; the arm has {_listed(tuple(self._lines.columns))}"
            news.complaint = news.complaint or f"line {number} names joints that the arm has not: {joints}"
        if not len(told.columns):
            news.skipped += 1
            return
        if not news.count:
            news.stamp = told.stamp
        news.count += 1
        new = ~news.told[told.columns]
        news.positions[told.columns[new]] = told.positions[new]
        news.told[told.columns] = True

    def _publish(self, news: _News) -> None:
        self._positions = np.where(news.told, news.positions, self._positions)
        self._heard |= news.told
        before = self._latest
        q = _fixed(self.arm.configuration(self._positions)) if news.count else before.q
        latest = Measured(
            q=q,
            age=np.inf,
            count=before.count + news.count,
            complaint=news.complaint or before.complaint,
            refused=before.refused + news.refused,
            skipped=before.skipped + news.skipped,
            stamp=news.stamp if news.count else before.stamp,
            unheard=self._unheard(),
        )
        with self._lock:
            self._latest = latest
            if news.count:
                self._received = time.monotonic()

    def _unheard(self) -> tuple[str, ...]:
        chain = self.arm.chain
        return tuple(
            name for name, column in zip(chain.joints, chain.columns, strict=True) if not self._heard[column]
        )


class _News:
    """What lines that came together tell: like `Measured`, and of which joints."""

    def __init__(self, nv: int) -> None:
        self.positions, self.told = np.zeros(nv), np.zeros(nv, dtype=np.bool_)
        self.count, self.refused, self.skipped = 0, 0, 0
        self.complaint = ""
        self.stamp: float | None = None


def _fixed(q: Array) -> Array:
    q.flags.writeable = False
    return q


def _listed(names: Sequence[str]) -> str:
    more = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
    return ", ".join(map(repr, names[:_NAMED])) + more
