"""What operators hold: keys, buttons or sticks of one page, which count while the page goes on telling."""

from __future__ import annotations

import json
from threading import Lock
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pinposture._validation import as_number, require_whole
from pinposture.errors import InvalidValue, PostureError

Array = NDArray[np.float64]


class ControlSettings(NamedTuple):
    """The times within which an arm is held."""

    period: float = 0.02
    """Time between two messages of a page while something is held [s]."""

    lost: float = 0.07
    """Time without a message after which nothing counts as held any more [s]. With a cycle of 20 ms, the arm
    brakes within 90 ms. It is three messages and a half: with half of it, one page in a browser without a GPU
    lost its input again and again (tests/operate/test_page.py)."""

    most_wishes: int = 20
    """Number of wishes that wait at most."""


CONTROL = ControlSettings()

DIRECTIONS = ("ahead", "left", "up")
"""Where a tip can be moved, in the order of `Order.direction`."""


WISHES = ("keep", "next", "out")
"""What the page that has control can ask for beside: to keep the posture, to plan the next step, or the way
out of an arm with a joint that fails."""


NOTHING_HELD = "nothing is held"


class Order(NamedTuple):
    """What is held.

    Attributes:
        direction: shares of the full speed ahead, to the left and up, (3,), each from -1 to 1.
        override: share of the speed that the operator allows, from 0 to 1.
        along: share of the speed along the way that is planned, from -1, back, to 1.
        way: the number of that way.
    """

    direction: Array
    override: float
    along: float = 0.0
    way: int = 0


class Control:
    """Who has control of an arm, and what is held.

        control = Control()
        reply = control.take("page 1", '{"do": "hold", "ahead": 1, "left": 0, "up": 0, "override": 0.5}', now)
        order = control.order(now)  # None: nothing is held

    One page has control; the first that asks gets it, another one if the first gives it away, or leaves. What
    it holds counts for `ControlSettings.lost` seconds, and then not before it was released and is held anew;
    so it is with a page that was just given control. May be called from any thread.

    Messages of a page are objects of JSON with a key `do`: "hold" with shares `ahead`, `left`, `up` and
    `override`, "release", which a page also tells from time to time while nothing is held, "ask" for control,
    and "give" it to the page that asks, or to none. To drive the way that is planned, "hold" has its number
    as `way`, and the share `along`; and `WISHES` prepare ways.

    Attributes:
        reason: why nothing counts as held; empty while something does.
    """

    def __init__(self) -> None:
        self._lock = Lock()
        self._holder = ""
        self._asker = ""
        self._order: Order | None = None
        self._heard = 0.0
        self._to_release = False
        self._wishes: list[str] = []
        self.reason = "no page has control"

    def take(self, page: str, message: str | bytes, now: float) -> dict[str, Any]:
        """Take a message of a page.

        Args:
            page: what tells it from others.
            message: the message.
            now: the time [s].

        Returns:
            What the page is told: `control`, "yours", "free" or "taken"; `asked`, whether another page asks
            for it; and `held`, whether what it holds counts.

        Raises:
            InvalidValue: it is malformed; if the page has control, nothing is held any more.
        """
        with self._lock:
            try:
                self._do(page, _read(message), now)
            except PostureError:
                if page == self._holder:
                    self._lose("the page sent what is no message; release, and hold again")
                raise
            return {
                "control": "yours" if page == self._holder else "taken" if self._holder else "free",
                "asked": bool(self._asker) and page == self._holder,
                "held": self._order is not None and page == self._holder,
            }

    def leave(self, page: str) -> None:
        """Tell that a page is gone; if it had control, the page that asks for it gets it."""
        with self._lock:
            if page == self._asker:
                self._asker = ""
            if page == self._holder:
                self._give()

    def order(self, now: float) -> Order | None:
        """Return what is held at a time [s]; None if nothing is, or it cannot be known."""
        with self._lock:
            self._expire(now)
            return self._order

    def lose(self, reason: str) -> None:
        """Let what is held not count any more, until it was released, for a reason."""
        with self._lock:
            self._lose(reason)

    def wishes(self) -> list[str]:
        """Return what was asked for since the last call, of `WISHES`."""
        with self._lock:
            asked = self._wishes
            self._wishes = []
            return asked

    def _do(self, page: str, message: dict[str, Any], now: float) -> None:
        """Do what a message says."""
        what = message["do"]
        if what == "ask" and not self._holder:
            self._asker = page
            self._give()
        elif what == "ask" and page != self._holder:
            self._asker = page
        if page != self._holder:
            return
        self._expire(now)
        self._heard = now
        if what == "give":
            self._give()
        elif what == "release":
            self._order = None
            self._to_release = False
            self.reason = NOTHING_HELD
        elif what == "hold" and self._to_release and self.reason == NOTHING_HELD:
            self.reason = "it was held before the page had control; release, and hold again"
        elif what == "hold" and not self._to_release:
            direction = np.array([message[name] for name in DIRECTIONS])
            self._order = Order(direction, message["override"], message["along"], message["way"])
            self.reason = ""
        elif what in WISHES and len(self._wishes) < CONTROL.most_wishes:
            self._wishes.append(what)

    def _expire(self, now: float) -> None:
        """Lose what is held if the page has not told of it for too long."""
        if self._order is not None and now - self._heard > CONTROL.lost:
            self._lose(
                f"nothing was heard of the page for {1e3 * CONTROL.lost:.0f} ms; release, and hold again"
            )

    def _lose(self, reason: str) -> None:
        self._order = None
        self._to_release = True
        self.reason = reason

    def _give(self) -> None:
        """Give control to the page that asks for it, or to none."""
        self._holder = self._asker
        self._asker = ""
        self._lose(NOTHING_HELD if self._holder else "no page has control")


def _read(message: str | bytes) -> dict[str, Any]:
    """Return a message of a page, with shares as numbers."""
    try:
        read = json.loads(message)
    except (ValueError, RecursionError) as error:
        raise InvalidValue("message", message[:40], "an object of JSON") from error
    done = ("hold", "release", "ask", "give", *WISHES)
    if not isinstance(read, dict) or read.get("do") not in done:
        allowed = f"an object with do: {', '.join(done)}"
        raise InvalidValue("message", str(read)[:40], allowed)
    if read["do"] != "hold":
        return {"do": read["do"]}
    shares = {
        name: as_number(name, read.get(name), "a number from -1 to 1", lambda x: -1.0 <= x <= 1.0)
        for name in DIRECTIONS
    }
    along = as_number("along", read.get("along", 0.0), "a number from -1 to 1", lambda x: -1.0 <= x <= 1.0)
    way = require_whole("way", read.get("way", 0), 0)
    override = as_number("override", read.get("override"), "a number from 0 to 1", lambda x: 0.0 <= x <= 1.0)
    return {"do": "hold", "override": override, "along": along, "way": way, **shares}
