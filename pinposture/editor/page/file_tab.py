"""The tab for the task file: open, save, undo."""

from __future__ import annotations

from html import escape
from pathlib import Path
from typing import Any

import viser

from pinposture.editor.files import Files, within
from pinposture.editor.live import Live
from pinposture.editor.page.part import Post, on_change, on_click, put
from pinposture.editor.page.tour import show_tour
from pinposture.editor.session import Session


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
