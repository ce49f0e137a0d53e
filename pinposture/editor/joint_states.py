"""Where an arm is measured to be, told by lines of JSON as they come."""

from __future__ import annotations

import logging
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from threading import Event, Lock, Thread
from types import TracebackType

import numpy as np
from numpy.typing import NDArray

from pinposture.arm import Arm
from pinposture.editor.joint_lines import JointLines
from pinposture.editor.line_source import Lines, LineSource
from pinposture.errors import InvalidValue

Array = NDArray[np.float64]

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
        self._source, self._lines = LineSource(source), JointLines(arm)
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
