"""Saving and opening task files, and exporting motions."""

from __future__ import annotations

import io
import logging
import re
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import Thread
from typing import NamedTuple

from pinposture.arm import Arm
from pinposture.editor.autosave import Autosave, Recovered, put_aside, recover, version_of
from pinposture.editor.edits import keyframes_of
from pinposture.editor.session import Session
from pinposture.errors import FileError, PostureError, UnknownName
from pinposture.motion import Motion, save
from pinposture.storage import settled
from pinposture.task import Task

# Saving and opening task files, for the loop: what takes time is done in threads.

logger = logging.getLogger(__name__)


class Files:
    """The task file of a session, and what is kept beside it.

    Args:
        post: leaves a request for the loop.
        path: the task file, as it was read a moment ago; None if there is none.
    """

    def __init__(self, post: Callable[[Callable[[Session], None]], None], path: Path | None = None) -> None:
        self._post = post
        self._autosave = Autosave()
        self._kept: Task | None = None
        self._complained = ""
        self._version = None if path is None else version_of(path)  # the file as it is known here

    def watch(self, session: Session) -> None:
        """Keep what was changed; called by the loop whenever it likes."""
        if self._kept is None:
            self._kept = session.task
        if session.path is not None and session.task is not self._kept:
            self._kept = session.task
            if session.changed:
                self._autosave.keep(session.task, session.path)
            else:
                self._autosave.forget(session.path)
        if self._autosave.complaint != self._complained:
            self._complained = self._autosave.complaint
            if self._complained:
                session.say(self._complained, "error")

    def save(self, session: Session, path: Path | None = None) -> None:
        """Save the task in its file, or in another one, which then is its file.

        Raises:
            FileError: it cannot be written, another file has that name, or somebody else changed the file:
                that is told once, and saving again replaces it. Nothing changes.
        """
        path = session.path if path is None else path
        if path is None:
            raise FileError("the task", "has no file yet; give it a name, such as task.toml")
        path = path.absolute()
        there = version_of(path)
        if path != session.path and there is not None:
            raise FileError(
                path, "exists already; allowed: a name that is free, or that of the file being edited"
            )
        if there is not None and there != self._version:
            self._version = there
            raise FileError(path, "somebody else changed it; save again to replace that, or save elsewhere")
        arm = path.with_suffix(".urdf")
        if arm.is_symlink() and not arm.exists():  # the arm may be written there
            raise FileError(arm, "is a link to nowhere; remove it, or save elsewhere")
        session.task.save(path)
        before, session.path, session.saved = session.path, path, session.task
        self._version = version_of(path)
        self._autosave.forget(path)
        if before is not None and before != path:
            self._autosave.forget(before)
        session.say(f"saved as {path.name}")

    def open(self, session: Session, path: Path) -> None:
        """Open another task file; the loop goes on meanwhile."""
        path = path.absolute()
        session.say(f"opening {path.name} ...")

        def work() -> None:
            self._autosave.finish()  # it may be that of the file that is opened again
            version = version_of(path)
            try:
                put = open_task(path)
            except Exception as error:
                if not isinstance(error, PostureError):  # a fault of ours, which has to be told, too
                    logger.exception("%s could not be opened", path)
                reason = str(error)
                self._post(lambda session: session.say(f"not opened: {reason}", "error"))
                return

            def opened(session: Session) -> None:
                put(session)
                self._version = version

            self._post(opened)

        Thread(target=work, name="pinposture-open", daemon=True).start()

    def close(self) -> None:
        """Finish writing."""
        self._autosave.close()


def open_task(path: Path) -> Callable[[Session], None]:
    """Read a task file, and what was left beside it; gives what puts it in place of the task of a session.

    Raises:
        FileError: it cannot be read.
        TaskError: it has no keyframes.
    """
    task = Task.load(path)
    keyframes_of(task)

    def put(session: Session) -> None:
        session.replace(task, path, saved=True)
        session.say(f"opened {path.name}")
        restore(session)

    return put


def restore(session: Session) -> None:
    """Take up what was changed and not saved when an editor of the same file ended; undo takes it back.

    Where the file was written after that, it counts, and redo takes the changes up.
    """
    left = None if session.path is None else recover(session.path)
    if left is None:
        return
    if left.task is None:
        session.say(_unreadable(left), "error")
        return
    task = _kept_of(left.task, session.task, left.path)
    session.take_up(task, min(session.selected, len(keyframes_of(task)) - 1))
    if left.older:
        session.undo()
        text = f"{left.path.name} holds changes from before the file was written; redo takes them up"
    else:
        back = "takes that back" if session.saved is None else "goes back to the file"
        text = f"recovered what was not saved (from {left.path.name}); undo {back}"
    session.say(text, "warning")


def _unreadable(left: Recovered) -> str:
    """Say what became of changes that cannot be read; they are not written over."""
    try:
        name = put_aside(left.path).name
    except OSError as error:
        name = f"{left.path.name}, which is going to be replaced ({error.strerror or error})"
    return f"changes that were not saved cannot be read, and are in {name}: {left.complaint}"


def _kept_of(task: Task, there: Task, kept: Path) -> Task:
    """A task that was kept, with the arm that is there if it is the same one: it need not begin anew then.

    A URDF file that was kept beside the task goes when that is saved, and is not relied on.
    """
    arm, other = task.arm, there.arm
    if arm.spec is None or other.spec is None:
        return task
    aside = {"urdf": arm.urdf, "package_dirs": ()}
    if arm.urdf == other.urdf and arm.spec.model_copy(update=aside) == other.spec.model_copy(update=aside):
        return task.edited(arm=other)
    if arm.spec.urdf == settled(kept.with_suffix(".urdf")):
        spec = arm.spec.model_copy(update={"urdf": arm.urdf})
        parts = (
            arm.model,
            arm.control_points,
            arm.base_placement,
            arm.urdf,
            arm.report,
            arm.characteristic_length,
        )
        return task.edited(arm=Arm(*parts, spec))
    return task


def within(folder: Path, name: str, start: Path | None = None) -> Path:
    """The file that a name from the page means. The only way from what is typed to a path.

    Args:
        folder: where it has to be, or in folders in there.
        name: the name, which may lead through folders.
        start: the folder in there that the name counts from; `folder` itself if None.

    Raises:
        FileError: a name that leads, or might lead, out of the folder: from the root, from somebody's home,
            by "..", or by a link; or one that no file can have.
    """
    leads, path = Path(name), (folder if start is None else start) / name
    outside = bool(leads.anchor) or name.startswith("~") or ".." in leads.parts
    try:
        outside = outside or not path.resolve().is_relative_to(folder.resolve())
    except (OSError, RuntimeError, ValueError) as error:  # a null byte, links in a circle
        raise FileError(name, f"cannot be found ({error})") from None
    if outside:
        allowed = "allowed: names in there, or another --folder at the start"
        raise FileError(name, f"is not a file in {folder}; {allowed}")
    return path


# A motion as files to take away: the same that `pinposture run` and `pinposture export` write.


class ExportKind(NamedTuple):
    """A kind of file.

    Attributes:
        suffix: what its name ends in.
        noun: what it is, in words.
        write: makes one of a motion, at a path.
    """

    suffix: str
    noun: str
    write: Callable[[Motion, Path], object]


class Export(NamedTuple):
    """A file to take away.

    Attributes:
        name: of the file.
        content: what is in it.
        told: what it is and how long the motion is, in words.
    """

    name: str
    content: bytes
    told: str


def exported(motion: Motion, kind: str, stem: str) -> Export:
    """A motion as a file.

    Args:
        motion: the motion.
        kind: one of `KINDS`.
        stem: what to call the file; letters that are not good in names of files are replaced.

    Raises:
        UnknownName: no such kind.
        MotionError: joints of a motion that is not fit for a robot; `pinposture export --force` writes them.
        FileError: it cannot be made.
        InvalidValue: times that the format cannot hold.
    """
    if kind not in KINDS:
        raise UnknownName("kind of export", kind, KINDS)
    suffix, noun, write = KINDS[kind]
    name = f"{re.sub(r'[^A-Za-z0-9._-]+', '_', stem).strip('._') or 'motion'}{suffix}"
    with TemporaryDirectory(prefix="pinposture-") as folder:
        path = Path(folder) / f"motion{suffix}"
        write(motion, path)
        content = path.read_bytes()
    size = f"{len(content) / 1000.0:,.0f} kB" if len(content) >= 1000 else f"{len(content)} bytes"
    ended = "" if motion.converged else "; it does not end as it should"
    return Export(
        name, content, f"{name}: {noun} of {motion.time[-1]:.4g} s, {motion.steps} cycles, {size}{ended}"
    )


def _write_joints(motion: Motion, path: Path) -> None:
    save(motion.joint_trajectory(), path)


def _write_picture(motion: Motion, path: Path) -> None:
    from pinposture.viz import plot  # takes a while to import

    picture = io.BytesIO()
    plot(motion).savefig(picture, format="png")
    path.write_bytes(picture.getvalue())


def _write_animation(motion: Motion, path: Path) -> None:
    from pinposture.viz import save_html

    save_html(motion.arm, motion, path)


KINDS = {
    "npz": ExportKind(".npz", "the motion", save),
    "CSV": ExportKind(".csv", "joint positions, speeds and accelerations", _write_joints),
    "ROS JSON": ExportKind(".json", "a JointTrajectory message", _write_joints),
    "Picture": ExportKind(".png", "a picture", _write_picture),
    "Animation": ExportKind(".html", "an animation", _write_animation),
}
"""What a motion can be taken away as, by the names of its buttons."""
