"""The tab for the arm: what moves it, within what, and what of it is shown."""

from __future__ import annotations

import time
from functools import partial

import numpy as np
import viser

from pinposture.control import CONTROLLERS
from pinposture.editor.edits import with_controller, with_limits
from pinposture.editor.live import Live
from pinposture.editor.page.arm import ArmDrawing
from pinposture.editor.page.ellipsoids import Ellipsoids
from pinposture.editor.page.painting import WAYS, near_singular, paint
from pinposture.editor.page.part import Post, on_change, put
from pinposture.editor.page.typed import Typed
from pinposture.editor.session import Session

PAUSE = 0.25
"""How long facts stay as they are, for people to read them [s]."""

NAMED = 4
"""How many stretches are listed."""


class ArmTab:
    """Controls for the arm.

    Args:
        server: the page; the controls are made where it is at.
        drawing: the arm in the page.
        post: leaves a request for the loop.
    """

    def __init__(self, server: viser.ViserServer, drawing: ArmDrawing, post: Post) -> None:
        self._drawing, self._post, gui = drawing, post, server.gui
        self._ellipsoids = Ellipsoids(server, drawing.arm)
        self._steps, self._due = -1, 0.0
        self._facts = gui.add_markdown("")
        self._controller = gui.add_dropdown("Controller", tuple(CONTROLLERS), hint="What moves the arm")
        speed = gui.add_number(
            "Speed [rad/s]", 0.0, min=0.0, step=0.1, hint="Of each joint at most; 0: as the arm is described"
        )
        acceleration = gui.add_number(
            "Accel. [rad/s²]", 0.0, min=0.0, step=1.0, hint="Of each joint at most; 0: no limit"
        )
        self._at_once = gui.add_checkbox(
            "At once", False, hint="Take each shape at once, whatever the limits"
        )
        self._way = gui.add_dropdown("Colours", WAYS, hint="Red: at a limit, or near singular")
        self._balls = gui.add_checkbox("Ellipsoids", False, hint="Manipulability; red and flat: singular")
        on_change(self._controller, self._controlled)
        self._limits = (
            Typed(speed, partial(self._limited, "velocity", "speed")),
            Typed(acceleration, partial(self._limited, "acceleration", "acceleration")),
        )
        on_change(self._at_once, self._hurried)

    def show(self, session: Session, live: Live) -> None:
        """Bring it up to date."""
        limits = session.task.limits
        put(self._controller, value=session.task.controller.name)
        for field, limit in zip(self._limits, (limits.velocity, limits.acceleration), strict=True):
            several = np.ndim(limit if limit is not None else 0.0) > 0
            field.show(0.0 if limit is None else round(float(np.min(limit)), 6), disabled=several)
        put(self._at_once, value=session.at_once)
        now = time.monotonic()
        if live.steps != self._steps and now >= self._due:
            self._steps, self._due = live.steps, now + PAUSE
            put(self._facts, content=_facts(live))
        self._drawing.paint(paint(self._way.value, live, self._drawing.shades))
        self._ellipsoids.show(live.state, live.steps, self._balls.value)

    def _controlled(self, name: str) -> None:
        self._post(lambda session: session.edit(with_controller(name), f"controller {name}"))

    def _limited(self, key: str, what: str, value: float, over: bool) -> None:
        del over
        limit = None if value == 0.0 else float(value)
        text = f"{what} {value:g}" if limit else f"no limit of {what} of our own"
        self._post(lambda session: session.edit(with_limits(**{key: limit}), text))

    def _hurried(self, value: bool) -> None:
        def request(session: Session) -> None:
            session.at_once = value
            session.touch()

        self._post(request)


def _facts(live: Live) -> str:
    """The arm in a few words."""
    arm = live.arm
    stretches = near_singular(live.state)
    listed = ", ".join(f"{a}" if a == b else f"{a} to {b}" for a, b in stretches[:NAMED])
    more = " ..." if len(stretches) > NAMED else ""
    bound = int(np.count_nonzero(live.at_limit))
    lag = "..." if live.lag is None else f"{1000.0 * live.lag:.0f} ms"
    return (
        f"**{arm.n_modules} modules, {arm.nv} joints, {arm.length:.3g} m**\n\n"
        f"Near singular: {f'modules {listed}{more}' if listed else 'nowhere'}\n\n"
        f"Joints at a limit: {bound or 'none'}\n\n"
        f"First step after a change: {lag}"
    )
