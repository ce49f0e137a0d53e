"""What a driver says of itself: how punctual its cycles are, and messages of diagnostics."""

from __future__ import annotations

import re
from collections import deque
from collections.abc import Mapping
from math import inf, isfinite
from typing import Any

import numpy as np

from pinposture.motion.ros import NANOSECONDS


class CycleTimes:
    """Counts the cycles of a loop, those that it missed, and how late its commands are.

    Attributes:
        cycles: number of cycles.
        missed: number of cycles that did not take place, as others came too late.
        latencies: times from the measurement of the joints to the command that follows from it [s], the
            latest 100,000.

    Args:
        period: nominal time between cycles [s].
    """

    def __init__(self, period: float) -> None:
        self.cycles = 0
        self.missed = 0
        self.latencies: deque[float] = deque(maxlen=100_000)  # 16 minutes at 100 Hz
        self._period = period
        self._last: int | None = None
        self._told = 0

    def begin(self, now: int) -> float:
        """Begin a cycle at a time [ns].

        Returns:
            The time since the cycle before [s]: the nominal one for the first cycle, 0 or less after a jump
            of the clock.
        """
        passed = self._period if self._last is None else (now - self._last) / NANOSECONDS
        self._last = now
        self.cycles += 1
        self.missed += max(0, round(passed / self._period) - 1)
        return passed

    def sent(self, measured: int, now: int) -> None:
        """Note that a command was sent, given the times of the measurement and of now [ns]."""
        self.latencies.append((now - measured) / NANOSECONDS)
        self._told += 1

    def recent_latencies(self) -> dict[str, float]:
        """Return median and largest latency since the last call [s]; nothing if no command was sent."""
        count = min(self._told, len(self.latencies))
        self._told = 0
        if not count:
            return {}
        recent = np.array(self.latencies)[-count:]
        return {"latency, median": float(np.median(recent)), "latency, most": float(recent.max())}


class Occurrences:
    """Tells which words are worth a line in a log: those that were not heard for a while.

    Numbers in them do not count, so that what comes and goes from cycle to cycle is said once.
    """

    def __init__(self) -> None:
        self._heard: dict[str, float] = {}

    def begin(self, words: str, now: float) -> bool:
        """Hear words at a time [s]; return whether an occurrence begins."""
        kind = re.sub(r"(?<!\w)[-+]?\d[\d.]*(e[-+]?\d+)?", "", words)  # without numbers that are no names
        # On a busy machine, a plan or a step that is not ready in time comes and goes several times a second.
        pause = 10.0
        begun = now - self._heard.get(kind, -inf) > pause
        self._heard = {old: at for old, at in self._heard.items() if now - at <= pause}
        self._heard[kind] = now
        return begun


def diagnostics(name: str, hardware: str, level: int, message: str, values: Mapping[str, Any]) -> Any:
    """Return a `diagnostic_msgs/msg/DiagnosticArray` with one status; its stamp is not set.

    Args:
        name: name of what is diagnosed.
        hardware: name of the arm.
        level: 0: all is well. 1: warning. 2: error.
        message: what is the matter, in a line.
        values: more of it, by name; times [s].
    """
    from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

    status = DiagnosticStatus(level=bytes([level]), name=name, message=message, hardware_id=hardware)
    status.values = [KeyValue(key=key, value=_in_words(value)) for key, value in values.items()]
    return DiagnosticArray(status=[status])


def _in_words(value: object) -> str:
    if isinstance(value, float):
        return f"{value:.4g}" if isfinite(value) else "unknown"
    return "unknown" if value is None else str(value)
