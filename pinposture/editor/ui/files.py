"""The tab for the task file, and the buttons to export the motion."""

from __future__ import annotations

import logging
from functools import partial
from html import escape
from pathlib import Path
from threading import Thread
from typing import Any, NamedTuple

import viser

from pinposture.editor.files import EXPORT_KINDS, Files, export, within
from pinposture.editor.session import Session
from pinposture.editor.solver import Live
from pinposture.editor.ui.parts import Post, on_change, on_click, put
from pinposture.errors import PostureError
from pinposture.motion import Motion
from pinposture.task import Task

# A short tour for whoever is here for the first time; each browser remembers that it had it.

SEEN = "pinposture-tour"

STEPS = (
    (
        "Draw a curve, and the arm takes its shape",
        "The arm follows the curve of the selected keyframe, within its limits.\n\n"
        "Turn the picture with the left mouse button, move it with the right one, zoom with the wheel.",
    ),
    (
        "Drag the blue balls",
        "They control the curve. Drag one with the mouse, or click on it and use its axes, the numbers in "
        "*Shape*, or Shift and the arrow keys. `I` inserts a point, `Delete` deletes one.\n\n"
        "A curve that the arm cannot take turns red and says why; let go, and it is as it was.",
    ),
    (
        "What the colours say",
        "Dots on the arm are posture control points: green is where it belongs, red is far off. An orange "
        "ring marks those that the controller moves at the moment. Red bodies have a joint at a limit.\n\n"
        "The arm leaves the grey part of the curve: there the curve is longer than the arm.",
    ),
    (
        "Keyframes make a motion",
        "*Keyframes* lists postures and their times. Add some, then press *Play* under the picture: limits "
        "of speed and acceleration are kept, and the plots show how near they are.",
    ),
    (
        "Nothing is lost",
        "`Ctrl+Z` takes back, `Ctrl+S` saves the task file, which `pinposture run` performs. Changes are "
        "kept beside it all the time. The tour is in *File* if you want it again.",
    ),
)


def offer_tour(server: viser.ViserServer) -> None:
    """Show the tour to every browser that comes for the first time."""

    @server.on_client_connect
    def _(client: viser.ClientHandle) -> None:  # called in a thread of its own, so it may wait
        try:
            if client.local_storage.get_item(SEEN, timeout=5.0) is None:
                show_tour(client)
        except (TimeoutError, RuntimeError):  # it left, or does not answer
            return


def show_tour(client: viser.ClientHandle, step: int = 0) -> None:
    """Show a step of the tour in one browser, with ways to go on and to end it."""
    title, text = STEPS[step]
    modal = client.gui.add_modal(title)
    with modal:
        client.gui.add_markdown(text)
        ways = ("Skip", "Next") if step == 0 else ("Back", "Done" if step == len(STEPS) - 1 else "Next")
        buttons = client.gui.add_button_group(f"{step + 1} of {len(STEPS)}", ways)

    async def turn(event: Any) -> None:
        modal.close()
        way = event.target.value
        if way in ("Skip", "Done"):
            client.local_storage.set_item(SEEN, "yes")
        else:
            show_tour(client, step + (1 if way == "Next" else -1))

    buttons.on_click(turn)


# The tab for the task file: open, save, undo.


class FileTab:
    """Controls for the task file.

    Args:
        server: the page; the controls are made where it is at.
        files: what saves and opens.
        post: leaves a request for the loop.
    """

    def __init__(self, server: viser.ViserServer, files: Files, post: Post) -> None:
        self._files, self._post, gui = files, post, server.gui
        self._about = gui.add_html("")
        self._undo = gui.add_button("Undo", icon=viser.Icon.ARROW_BACK_UP, hint="Ctrl+Z")
        self._redo = gui.add_button("Redo", icon=viser.Icon.ARROW_FORWARD_UP, hint="Ctrl+Shift+Z")
        self._save = gui.add_button("Save", icon=viser.Icon.DEVICE_FLOPPY, hint="Ctrl+S")
        self._path = gui.add_text("Task file", "", hint="To save as or to open: .toml or .json")
        self._save_as = gui.add_button("Save under this name")
        self._open = gui.add_button("Open this file", icon=viser.Icon.FOLDER_OPEN)
        self._tour = gui.add_button("Show the tour")
        self._tour.on_click(_toured)
        self._typed = ""
        on_change(self._path, self._type)
        on_click(self._undo, lambda: post(Session.undo))
        on_click(self._redo, lambda: post(Session.redo))
        on_click(self._save, lambda: post(files.save))
        on_click(self._save_as, self._saved_as)
        on_click(self._open, self._opened)
        self._shown: Path | None = None

    def show(self, session: Session, live: Live) -> None:
        """Bring it up to date."""
        del live
        undoable, redoable = session.history.undoable, session.history.redoable
        put(self._undo, disabled=not undoable, label=f"Undo: {undoable}" if undoable else "Undo")
        put(self._redo, disabled=not redoable, label=f"Redo: {redoable}" if redoable else "Redo")
        put(self._save, disabled=not session.changed or session.path is None)
        put(self._about, content=_about(session))
        if session.path is not None and session.path != self._shown:
            self._shown = session.path
            self._typed = _shortly(session.path, session.folder)
            put(self._path, value=self._typed)

    def _type(self, text: str) -> None:
        self._typed = text

    def _saved_as(self) -> None:
        name = self._typed.strip()
        self._post(lambda session: self._files.save(session, within(session.folder, name)))

    def _opened(self) -> None:
        name = self._typed.strip()
        self._post(lambda session: self._files.open(session, within(session.folder, name)))


async def _toured(event: Any) -> None:
    if event.client is not None:
        show_tour(event.client)


def _shortly(path: Path, folder: Path) -> str:
    """A path as it is typed: from the folder that files are opened and saved in."""
    for file, root in ((path, folder), (path.resolve(), folder.resolve())):
        if file.is_relative_to(root):
            return str(file.relative_to(root))
    return path.name


def _about(session: Session) -> str:
    name = "not in a file yet" if session.path is None else f"<b>{escape(session.path.name)}</b>"
    state = "changes are kept beside it, not saved yet" if session.changed else "saved"
    return f'<div style="font-size:14px;line-height:1.35;padding:2px 10px 10px 10px">{name}: {state}</div>'


# Buttons to take the motion away as a file; part of the tab for files.

logger = logging.getLogger(__name__)

NUMBERS, PICTURES = ("npz", "CSV", "ROS JSON"), ("Picture", "Animation")

HINT = "Of the motion of the whole task as it stands; it is worked out first, if need be"


class Wanted(NamedTuple):
    """A file that somebody waits for.

    Attributes:
        kind: one of `EXPORT_KINDS`.
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
        if event.client is not None and event.target.value in EXPORT_KINDS:
            self._post(partial(self._want, event.target.value, event.client))

    def _want(self, kind: str, client: viser.ClientHandle, session: Session) -> None:
        stem = session.path.stem if session.path is not None else session.task.name or "motion"
        self._wanted.append(Wanted(kind, client, session.task, stem))
        session.playback.rehearse(session.task)

    def _make(self, wanted: Wanted, motion: Motion) -> None:
        try:
            made = export(motion, wanted.kind, wanted.stem)
            wanted.client.send_file_download(made.name, made.content, save_immediately=True)
        except PostureError as error:
            self._post(partial(say, f"{wanted.kind}: not made: {error}", "error"))
        except Exception as error:  # a fault of ours; whoever waits for it has to be told
            logger.exception("an export failed")
            self._post(partial(say, f"{wanted.kind}: not made ({error})", "error"))
        else:
            self._post(partial(say, made.summary, "info"))


def say(text: str, kind: str, session: Session) -> None:
    """Say something."""
    session.say(text, kind)
