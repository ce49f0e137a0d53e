"""The File tab: open and save, exports of the motion, and a tour for new users."""

from __future__ import annotations

import time
from functools import partial
from html import escape
from pathlib import Path
from threading import Event
from typing import Any, NamedTuple

import viser

from pinposture.editor.files import EXPORT_KINDS, Files, export, task_files, within
from pinposture.editor.session import Session
from pinposture.editor.solver import Live
from pinposture.editor.ui.parts import Post, on_change, on_click, put
from pinposture.motion import Trajectory
from pinposture.motion.latest import EXPECTED_ERRORS, Done, Latest
from pinposture.task import Task

NO_FILE = "choose a task file"  # shown where none is chosen

TOUR_SEEN_KEY = "pinposture-tour"  # in the storage of each browser that has shown the tour

TOUR = (
    (
        "Draw a curve, and the arm takes its shape",
        "The arm follows the curve of the selected keyframe, within its limits.\n\n"
        "Turn the picture with the left mouse button, move it with the right one, zoom with the wheel.",
    ),
    (
        "Drag the blue balls",
        "They control the curve. Drag one with the mouse, or click on it and use its axes, the numbers in "
        "*Shape*, or Shift and the arrow keys. Shift and a click selects several. "
        "`I` inserts a point, `Delete` deletes one.\n\n"
        "A curve that the arm cannot take turns red, with the reason; if you release it, nothing changes.",
    ),
    (
        "What the colours say",
        "Dots on the arm are posture control points: green is on target, red is far off. An orange ring "
        "marks those that the controller moves now. Red bodies have a joint at a limit.\n\n"
        "The arm does not reach the grey end of the curve, which is longer than the arm.",
    ),
    (
        "Keyframes make a motion",
        "*Keyframes* lists postures and their times. Add some, then press *Play* under the picture. The "
        "motion keeps the velocity and acceleration limits; the plots show how close it comes to them.",
    ),
    (
        "Undo, save, autosave",
        "`Ctrl+Z` undoes, `Ctrl+S` saves the task file, which `pinposture run` performs. Changes are "
        "autosaved next to it. To see this tour again, open *File*.",
    ),
)


def offer_tour(server: viser.ViserServer) -> None:
    """Show the tour in every browser that connects for the first time."""

    @server.on_client_connect
    def _(client: viser.ClientHandle) -> None:  # called in a thread of its own, so it may wait
        try:
            if client.local_storage.get_item(TOUR_SEEN_KEY, timeout=5.0) is None:
                show_tour(client)
        except (TimeoutError, RuntimeError):  # it left, or does not answer
            return


def show_tour(client: viser.ClientHandle, step: int = 0) -> None:
    """Show a step of the tour in one browser, with buttons to go on and to end it."""
    title, text = TOUR[step]
    modal = client.gui.add_modal(title)
    with modal:
        client.gui.add_markdown(text)
        labels = ("Skip", "Next") if step == 0 else ("Back", "Done" if step == len(TOUR) - 1 else "Next")
        buttons = client.gui.add_button_group(f"{step + 1} of {len(TOUR)}", labels)

    async def clicked(event: Any) -> None:
        modal.close()
        label = event.target.value
        if label in ("Skip", "Done"):
            client.local_storage.set_item(TOUR_SEEN_KEY, "yes")
        else:
            show_tour(client, step + (1 if label == "Next" else -1))

    buttons.on_click(clicked)


class FileTab:
    """Controls for the task file."""

    def __init__(self, server: viser.ViserServer, files: Files, post: Post) -> None:
        self._files = files
        self._post = post
        gui = server.gui
        self._about = gui.add_html("")
        hint = "Task files in the folder and its subfolders; type to filter, then open the chosen one"
        self._choice: Any = gui.add_dropdown("Choose", (NO_FILE,), hint=hint)
        self._path = gui.add_text("Task file", "", hint="File to open or to save as: .toml or .json")
        save_as = gui.add_button("Save under this name")
        open_file = gui.add_button("Open this file", icon=viser.Icon.FOLDER_OPEN)
        gui.add_button("Show the tour").on_click(_show_tour_again)
        self._typed = ""
        self._due = 0.0
        self._shown: Path | None = None
        on_change(self._choice, self._choose)
        on_change(self._path, self._type)
        on_click(save_as, self._save_as)
        on_click(open_file, self._open)

    def show(self, session: Session, _: Live) -> None:
        """Bring it up to date."""
        name = "no file yet" if session.path is None else f"<b>{escape(session.path.name)}</b>"
        state = "unsaved changes (autosaved)" if session.changed else "saved"
        style = "font-size:14px;line-height:1.35;padding:2px 10px 10px 10px"
        put(self._about, content=f'<div style="{style}">{name}: {state}</div>')
        if session.path is not None and session.path != self._shown:
            self._shown = session.path
            self._typed = _relative_name(session.path, session.folder)
            put(self._path, value=self._typed)
        if time.monotonic() >= self._due:
            self._due = time.monotonic() + 2.0  # [s]
            put(self._choice, options=(NO_FILE, *task_files(session.folder)))

    def _choose(self, name: str) -> None:
        if name != NO_FILE:
            self._typed = name
            self._post(lambda _: put(self._path, value=name))

    def _type(self, text: str) -> None:
        self._typed = text

    def _save_as(self) -> None:
        name = self._typed.strip()
        self._post(lambda session: self._files.save(session, within(session.folder, name)))

    def _open(self) -> None:
        name = self._typed.strip()
        self._post(lambda session: self._files.open(session, within(session.folder, name)))


async def _show_tour_again(event: Any) -> None:
    if event.client is not None:
        show_tour(event.client)


def _relative_name(path: Path, folder: Path) -> str:
    """Return a path as it is typed: from the folder that files are opened and saved in."""
    for file, root in ((path, folder), (path.resolve(), folder.resolve())):
        if file.is_relative_to(root):
            return str(file.relative_to(root))
    return path.name


class RequestedExport(NamedTuple):
    """A file that a user waits for."""

    kind: str  # one of `EXPORT_KINDS`
    client: viser.ClientHandle  # whose browser it goes to
    task: Task  # whose motion
    stem: str  # of the file name


class ExportButtons:
    """Buttons to download the motion, and the progress of that."""

    def __init__(self, server: viser.ViserServer, post: Post) -> None:
        self._post = post
        self._queue: list[RequestedExport] = []
        self._writing: RequestedExport | None = None
        self._files: Latest[tuple[RequestedExport, Trajectory], str] = Latest(
            _send, "pinposture-export", deliver=lambda done: post(partial(self._report, done))
        )
        hint = "The motion of the whole task as it is now; it is computed first if necessary"
        groups = (("Motion as", ("npz", "CSV", "ROS JSON")), ("Shown as", ("Picture", "Animation")))
        for label, kinds in groups:
            server.gui.add_button_group(label, kinds, hint=hint).on_click(self._on_click)
        self._bar = server.gui.add_progress_bar(0.0, visible=False, animated=True)
        self._text = server.gui.add_markdown("", visible=False)

    def show(self, session: Session, _: Live) -> None:
        """Bring it up to date, and start the next export."""
        if self._queue and self._writing is None:
            self._start_next(session)
        running = self._writing is not None
        now = self._queue[0] if self._queue and not running else self._writing
        put(self._bar, visible=now is not None)
        put(self._text, visible=now is not None)
        if now is not None:
            progress = session.playback.preview.progress
            put(self._bar, value=100.0 if running else float(round(100.0 * progress)))
            doing = "writing" if running else "computing the motion"
            put(self._text, content=f"*{now.kind}: {doing}*")

    def _start_next(self, session: Session) -> None:
        export = self._queue[0]
        preview = session.playback.preview
        working = preview.working
        done = preview.of(export.task)
        if done is not None:
            self._queue.pop(0)
            if done.motion is not None:  # else a message has said why not
                self._writing = export
                self._files.ask((export, done.motion))
        elif export.task is not session.whole or not working:
            self._queue.pop(0)
            text = f"{export.kind}: not exported, the task changed or the motion was cancelled"
            session.say(text, "warning")

    async def _on_click(self, event: Any) -> None:
        if event.client is not None and event.target.value in EXPORT_KINDS:
            self._post(partial(self._request, event.target.value, event.client))

    def _request(self, kind: str, client: viser.ClientHandle, session: Session) -> None:
        stem = session.path.stem if session.path is not None else session.task.name or "motion"
        self._queue.append(RequestedExport(kind, client, session.whole, stem))
        session.playback.compute_preview(session.whole)

    def _report(self, done: Done[tuple[RequestedExport, Trajectory], str], session: Session) -> None:
        export = done.request[0]
        self._writing = None
        if done.answer is not None:
            session.say(done.answer)
            return
        expected = isinstance(done.error, EXPECTED_ERRORS)
        reason = f": {done.error}" if expected else f" ({done.error})"
        session.say(f"{export.kind}: not exported{reason}", "error")


def _send(asked: tuple[RequestedExport, Trajectory], _: Event) -> str:
    """Write the file of a motion, and send it; returns what it is, in words."""
    requested, motion = asked
    made = export(motion, requested.kind, requested.stem)
    requested.client.send_file_download(made.name, made.content, save_immediately=True)
    return made.summary
