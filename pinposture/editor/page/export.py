"""Buttons to take the motion away as a file; part of the tab for files."""

from __future__ import annotations

import logging
from functools import partial
from threading import Thread
from typing import Any, NamedTuple

import viser

from pinposture.editor.exports import KINDS, exported
from pinposture.editor.live import Live
from pinposture.editor.page.part import Post, put
from pinposture.editor.session import Session
from pinposture.errors import PostureError
from pinposture.motion import Motion
from pinposture.task import Task

logger = logging.getLogger(__name__)

NUMBERS, PICTURES = ("npz", "CSV", "ROS JSON"), ("Picture", "Animation")

HINT = "Of the motion of the whole task as it stands; it is worked out first, if need be"


class Wanted(NamedTuple):
    """A file that somebody waits for.

    Attributes:
        kind: one of `KINDS`.
        client: whose browser it goes to.
        task: whose motion.
        stem: what to call it.
    """

    kind: str
    client: viser.ClientHandle
    task: Task
    stem: str


class ExportButtons:
    """Buttons to take the motion away, and what is being made.

    Args:
        server: the page; the buttons are made where it is at.
        post: leaves a request for the loop.
    """

    def __init__(self, server: viser.ViserServer, post: Post) -> None:
        self._post = post
        self._wanted: list[Wanted] = []
        self._making: tuple[Wanted, Thread] | None = None
        for label, kinds in (("Motion as", NUMBERS), ("Shown as", PICTURES)):
            server.gui.add_button_group(label, kinds, hint=HINT).on_click(self._pressed)
        self._bar = server.gui.add_progress_bar(0.0, visible=False, animated=True)
        self._told = server.gui.add_markdown("", visible=False)

    def show(self, session: Session, live: Live) -> None:
        """Bring it up to date, and begin with what can be begun."""
        del live
        if self._making is not None and not self._making[1].is_alive():
            self._making = None
        if self._wanted and self._making is None:
            self._next(session)
        now = self._making[0] if self._making is not None else self._wanted[0] if self._wanted else None
        put(self._bar, visible=now is not None)
        put(self._told, visible=now is not None)
        if now is not None:
            rehearsal = session.playback.rehearsal
            making = self._making is not None
            put(self._bar, value=100.0 if making else float(round(100.0 * rehearsal.progress)))
            put(
                self._told,
                content=f"*{now.kind}: " + ("being made*" if making else "the motion is worked out*"),
            )

    def _next(self, session: Session) -> None:
        wanted, rehearsal = self._wanted[0], session.playback.rehearsal
        done = rehearsal.of(wanted.task)
        if done is not None:
            self._wanted.pop(0)
            if done.motion is not None:  # else it was told why not
                thread = Thread(
                    target=self._make, args=(wanted, done.motion), name="pinposture-export", daemon=True
                )
                self._making = wanted, thread
                thread.start()
        elif wanted.task is not session.task or not rehearsal.working:
            self._wanted.pop(0)
            session.say(
                f"{wanted.kind}: not made, the task was changed, or the motion was given up", "warning"
            )

    async def _pressed(self, event: Any) -> None:
        if event.client is not None and event.target.value in KINDS:
            self._post(partial(self._want, event.target.value, event.client))

    def _want(self, kind: str, client: viser.ClientHandle, session: Session) -> None:
        stem = session.path.stem if session.path is not None else session.task.name or "motion"
        self._wanted.append(Wanted(kind, client, session.task, stem))
        session.playback.rehearse(session.task)

    def _make(self, wanted: Wanted, motion: Motion) -> None:
        try:
            made = exported(motion, wanted.kind, wanted.stem)
            wanted.client.send_file_download(made.name, made.content, save_immediately=True)
        except PostureError as error:
            self._post(partial(say, f"{wanted.kind}: not made: {error}", "error"))
        except Exception as error:  # a fault of ours; whoever waits for it has to be told
            logger.exception("an export failed")
            self._post(partial(say, f"{wanted.kind}: not made ({error})", "error"))
        else:
            self._post(partial(say, made.told, "info"))


def say(text: str, kind: str, session: Session) -> None:
    """Say something."""
    session.say(text, kind)
